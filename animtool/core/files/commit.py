"""Commits written files: one file atomically, and a set completely or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from collections.abc import Sequence
from pathlib import Path

from animtool.core.arguments import argument
from animtool.core.errors import Fault, OptionError, OutputError
from animtool.core.files.leftovers import (
    TEMPORARY_NAME,
    Journal,
    StagedFile,
    new_temporary_path,
)
from animtool.core.files.reading import FileState
from animtool.core.record import dataclass

# Error codes of disks without hard links.
_NO_LINK_ERRORS = frozenset(
    {errno.EPERM, errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL}
    | {errno.EMLINK}
)


# Where files can be written instead, if a folder permits none.
WRITE_HINT = f"choose another {argument('output')}, or allow writing there: chmod u+w"
_ERROR_HINTS = {
    errno.ENOSPC: "free some space",
    errno.EDQUOT: "free some space",
    errno.EACCES: WRITE_HINT,
    errno.EPERM: WRITE_HINT,
    errno.EROFS: f"choose another {argument('output')}, on a disk that is writable",
    errno.ENAMETOOLONG: "choose a shorter name",
}


def output_error(path: Path, error: BaseException | str) -> OutputError:
    """Return the error for an output that could not be written."""
    reason = error if isinstance(error, str) else str(error)
    if isinstance(error, OSError):
        reason = error.strerror or str(error)
    reason = TEMPORARY_NAME.sub(lambda _: path.name, reason)
    hint = _ERROR_HINTS.get(getattr(error, "errno", 0))
    return OutputError(
        Fault("OUT002", f"cannot be written: {reason}", str(path), (), hint)
    )


@dataclass(frozen=True, slots=True)
class OutputTarget:
    """An output path as the user spells it, and the file it leads to."""

    path: Path  # the path as spelled by the user
    final_path: Path  # the file, with links followed


def output_target(path: Path) -> OutputTarget:
    """Return the file that an output path leads to (not a file: OUT002, OUT005)."""
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        if path.is_symlink():
            message = "is a link to a file that does not exist"
            hint = "remove the link, or name the file itself"
            raise OutputError(Fault("OUT005", message, str(path), (), hint)) from None
        return OutputTarget(path, path.resolve())
    except OSError as error:
        if error.errno == errno.ELOOP:
            message, hint = "is a link to itself", "remove the link"
            fault = Fault("OUT005", message, str(path), (), hint)
            raise OutputError(fault) from error
        raise output_error(path, error) from error
    except ValueError as error:
        raise output_error(path, "its name contains a NUL byte") from error
    _refuse_special_file(path, status)
    return OutputTarget(path, path.resolve())


_SPECIAL_FILES = {
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFLNK: "a link",
}


def _refuse_special_file(path: Path, status: os.stat_result) -> None:
    """Raise an error if the path to overwrite is not a regular file."""
    hint = "write the name of a file"
    if stat.S_ISDIR(status.st_mode):
        raise OutputError(Fault("OUT002", "is a folder", str(path), (), hint))
    if not stat.S_ISREG(status.st_mode):
        kind = _SPECIAL_FILES.get(stat.S_IFMT(status.st_mode), "something else")
        message = f"is {kind}, not a file"
        raise OutputError(Fault("OUT005", message, str(path), (), hint))


@dataclass(slots=True)
class WrittenFile:
    """A complete temporary file that will replace an output."""

    path: Path  # the path as spelled by the user
    final_path: Path  # its final path
    temporary_path: Path  # its temporary path
    state: FileState = FileState(0, 0, 0)  # after flushing

    def flush_to_disk(self) -> None:
        """Flush the file to disk, with the mode and owner of the replaced file."""
        status = None
        with contextlib.suppress(FileNotFoundError):
            status = self.final_path.lstat()
            _refuse_special_file(self.path, status)
        try:
            descriptor = os.open(self.temporary_path, os.O_RDWR)
            try:
                if status is not None and os.name != "nt":
                    _copy_mode_and_owner(descriptor, status)
                os.fsync(descriptor)
                self.state = FileState.of_stat(os.fstat(descriptor))
            finally:
                os.close(descriptor)
        except OSError as error:
            raise output_error(self.path, error) from error

    def commit(self, *, must_be_new: bool) -> None:
        """Rename the temporary file to its final name.

        With ``must_be_new``, that name must be unused (OUT001).
        """
        try:
            if must_be_new:
                _rename_new(self.temporary_path, self.final_path)
            else:
                self.temporary_path.replace(self.final_path)
        except FileExistsError as error:
            message = "already exists: another process wrote it in the meantime"
            hint = f"{argument('overwrite', True)} replaces it"
            fault = Fault("OUT001", message, str(self.path), (), hint)
            raise OptionError(fault) from error
        except OSError as error:
            raise output_error(self.path, error) from error

    def remove(self) -> None:
        """Remove the file if it is not committed."""
        with contextlib.suppress(OSError):
            self.temporary_path.unlink(missing_ok=True)


def _copy_mode_and_owner(descriptor: int, status: os.stat_result) -> None:
    """Give an open file the mode of another file and, if permitted, its owner."""
    current_status = os.fstat(descriptor)
    if (current_status.st_uid, current_status.st_gid) != (status.st_uid, status.st_gid):
        with contextlib.suppress(OSError):
            os.fchown(descriptor, status.st_uid, status.st_gid)
    # A setuid file runs with its owner's rights; never inherit that bit.
    mode = stat.S_IMODE(status.st_mode) & 0o777
    if stat.S_IMODE(current_status.st_mode) != mode:
        os.fchmod(descriptor, mode)


def _rename_new(temporary_path: Path, final_path: Path) -> None:
    """Rename a file to an unused name; if several processes do so, one succeeds."""
    if os.name == "nt":
        temporary_path.rename(final_path)
        return
    try:
        os.link(temporary_path, final_path)
    except OSError as error:
        if isinstance(error, FileExistsError) or error.errno not in _NO_LINK_ERRORS:
            raise
        # Without hard links, the name is reserved first. A kill at this moment leaves
        # it empty.
        descriptor = os.open(final_path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
        try:
            os.close(descriptor)
            temporary_path.replace(final_path)
        except BaseException:
            final_path.unlink()
            raise
    else:
        with contextlib.suppress(OSError):
            temporary_path.unlink()


def commit_files(files: Sequence[WrittenFile], new_paths: frozenset[Path]) -> None:
    """Commit flushed files in any number of folders: all of them or none.

    If one of the ``new_paths`` exists (OUT001), or a file cannot be renamed, the
    previous state is restored.
    """
    if len(files) > 1:
        _commit_set(files, new_paths)
    else:
        for file in files:
            file.commit(must_be_new=file.final_path in new_paths)
            _flush_folder(file.final_path.parent)


def _commit_set(files: Sequence[WrittenFile], new_paths: frozenset[Path]) -> None:
    staged_files = [
        StagedFile(
            f.final_path, f.temporary_path, f.state, new_temporary_path(f.final_path)
        )
        for f in files
    ]
    try:
        journal = Journal.begin(staged_files)
    except OSError as error:
        raise output_error(files[0].path, error) from error
    try:
        for file, staged_file in zip(files, staged_files, strict=True):
            if file.final_path not in new_paths:
                _back_up(file, staged_file)
            file.commit(must_be_new=file.final_path in new_paths)
    except BaseException:
        if all([_try_roll_back(staged_file) for staged_file in reversed(staged_files)]):
            journal.remove()
        raise
    for folder in journal.folders:
        _flush_folder(folder)
    journal.remove()
    for staged_file in staged_files:
        with contextlib.suppress(OSError):
            staged_file.backup_path.unlink(missing_ok=True)


def _try_roll_back(staged_file: StagedFile) -> bool:
    try:
        staged_file.roll_back()
    except OSError:
        # The journal stays, so that a later process can roll it back.
        return False
    return True


def _back_up(file: WrittenFile, staged_file: StagedFile) -> None:
    """Rename a file that will be replaced to its backup name."""
    try:
        os.link(staged_file.final_path, staged_file.backup_path)
    except FileNotFoundError:
        return
    except OSError as error:
        if error.errno not in _NO_LINK_ERRORS:
            raise output_error(file.path, error) from error
        try:
            staged_file.final_path.replace(staged_file.backup_path)
        except OSError as link_error:
            raise output_error(file.path, link_error) from link_error


def _flush_folder(folder: Path) -> None:
    """Flush the directory entries of a folder to disk, if possible."""
    if os.name == "nt":
        return  # Windows cannot flush a folder.
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
