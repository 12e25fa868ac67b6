"""Output files: checked before the work, whole or absent after it."""

from __future__ import annotations

import contextlib
import errno
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cache
from hashlib import sha256
from pathlib import Path
from uuid import uuid4

from animtool.errors import Fault, OptionError, OutputError
from animtool.inputs import check_inputs, recorded_inputs

__all__ = [
    "check_outputs",
    "is_running",
    "once_named",
    "output_error",
    "remove_leftovers",
    "replacing",
    "size_of",
    "sparing_inputs",
    "temporary_prefix",
    "together",
]

_OWNER = re.compile(r"\.animtool-(?P<host>[0-9a-f]{8})-(?P<process>[0-9]+)-")


def check_outputs(
    outputs: Sequence[Path], inputs: Sequence[Path], *, overwrite: bool
) -> None:
    """Refuse outputs that cannot or must not be written.

    Raises:
        OptionError: An output exists and overwrite is off, with a fault for each
            that does; or one is also an input.
        OutputError: Its folder does not exist or may not be written to.
    """
    _refuse_inputs(outputs, inputs)
    there: list[Path] = []
    for path in outputs:
        if path.is_dir():
            raise OutputError(
                Fault("OUT002", "is a folder", str(path), (), "name a file")
            )
        folder = path.parent
        try:
            exists = path.exists()
        except OSError as error:
            raise output_error(path, error) from error
        if not folder.is_dir():
            reason = "is no folder" if folder.exists() else "does not exist"
            message = f"cannot be written: {str(folder)!r} {reason}"
            hint = "make the folder first"
            raise OutputError(Fault("OUT002", message, str(path), (), hint))
        if not os.access(folder, os.W_OK | os.X_OK):
            message = f"cannot be written: no permission in {str(folder)!r}"
            raise OutputError(Fault("OUT002", message, str(path)))
        if exists and overwrite and not os.access(path, os.W_OK):
            message = "cannot be written: it is read-only"
            raise OutputError(Fault("OUT002", message, str(path)))
        if exists and not overwrite:
            there.append(path)
    if there:
        hint = "--overwrite replaces it"
        if len(there) == len(outputs):
            hint += ", --skip-existing leaves it"
        raise OptionError(
            [Fault("OUT001", "already exists", str(p), (), hint) for p in there]
        )


@contextlib.contextmanager
def sparing_inputs(outputs: Sequence[Path]) -> Iterator[None]:
    """Refuse outputs that the block reads, whatever file names them.

    A layer that a USD file brings in may be an output: a shot is read to bake one of
    its layers anew.

    Raises:
        OptionError: An output is among what was read (OUT003), as the block ends.
    """
    with recorded_inputs() as inputs:
        yield
    _refuse_inputs(outputs, inputs.opened)


def _refuse_inputs(outputs: Iterable[Path], inputs: Iterable[Path]) -> None:
    taken = {path.resolve() for path in inputs}
    for path in outputs:
        if path.resolve() in taken:
            message = "is an input of this very command"
            raise OptionError(
                Fault("OUT003", message, str(path), (), "name another -o")
            )


def output_error(path: Path, error: BaseException | str) -> OutputError:
    """Return the error of an output that could not be written."""
    reason = error if isinstance(error, str) else str(error)
    if isinstance(error, OSError):
        reason = error.strerror or str(error)
    hint = "free some space" if getattr(error, "errno", 0) == errno.ENOSPC else None
    return OutputError(
        Fault("OUT002", f"cannot be written: {reason}", str(path), (), hint)
    )


def temporary_prefix(process: int | None = None) -> str:
    """Return how the names begin of the files that a process of this host writes.

    Args:
        process: Its number; None is this one.
    """
    return f".animtool-{_host()}-{process or os.getpid()}-"


def remove_leftovers(folders: Iterable[Path], process: int | None = None) -> list[Path]:
    """Remove what killed processes of this host began to write; return what that was.

    Args:
        folders: Where outputs go; those that are not there are passed over.
        process: One that is dead; None is all that are.
    """
    removed = []
    for folder in dict.fromkeys(folders):
        for path in _temporary(folder):
            found = _OWNER.match(path.name)
            if found is None or found["host"] != _host():
                continue
            number = int(found["process"])
            if number == process or (process is None and not is_running(number)):
                with contextlib.suppress(OSError):
                    path.unlink()
                    removed.append(path)
    return removed


def _temporary(folder: Path) -> list[Path]:
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        return [Path(e.path) for e in entries if e.name.startswith(".animtool-")]
    return []


def is_running(process: int) -> bool:
    """Return whether a process of this host runs; where nothing says it, it does."""
    if os.name == "nt":
        # There, a signal of 0 would end the process.
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    # One that ended stays in the table until its parent asks; some containers never do.
    return _state(process) != "Z"


def _state(process: int) -> str:
    """Return the state of a process as Linux names it; empty where nothing says it."""
    try:
        said = Path(f"/proc/{process}/stat").read_text("utf-8", "replace")
    except OSError:
        return ""
    return said.rpartition(")")[2].split()[0]


@cache
def _host() -> str:
    import platform

    return sha256(platform.node().encode()).hexdigest()[:8]


@dataclass(frozen=True, slots=True)
class _Whole:
    """A file that is written.

    Attributes:
        temporary: Where it is.
        final: Where it belongs.
        path: What the user calls that.
    """

    temporary: Path
    final: Path
    path: Path

    def rename(self) -> None:
        """Give it its name.

        Raises:
            OutputError: It cannot be renamed.
        """
        try:
            self.temporary.replace(self.final)
        except OSError as error:
            raise output_error(self.path, error) from error
        with contextlib.suppress(OSError):
            _flush(self.final.parent)

    def remove(self) -> None:
        """Remove it, if it has not got its name."""
        with contextlib.suppress(OSError):
            self.temporary.unlink(missing_ok=True)


@dataclass(frozen=True, slots=True)
class _Block:
    """Files that get their names together.

    Attributes:
        files: Those that are whole, and wait for their names.
        after: What is to be done when they have them.
    """

    files: list[_Whole] = field(default_factory=list)
    after: list[Callable[[], object]] = field(default_factory=list)


_waiting: ContextVar[_Block | None] = ContextVar("_waiting", default=None)


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path in the same folder that becomes ``path`` at the end.

    The file is flushed to the disk and renamed when the block ends well, and
    removed when it does not, so that ``path`` is at all times absent, as it was,
    or whole. Inside of `together` it is renamed at the end of that.

    Raises:
        FormatError: Inputs are recorded, and one changed since it was read (IO004).
        OutputError: It cannot be flushed or renamed.
    """
    # A link stays one: what it leads to is replaced.
    final = path.resolve()
    # Unique over threads, processes and hosts that share a folder.
    temporary = final.with_name(f"{temporary_prefix()}{uuid4().hex[:12]}{final.suffix}")
    whole, waiting = _Whole(temporary, final, path), _waiting.get()
    done = False
    try:
        yield temporary
        check_inputs()
        try:
            _flush(temporary)
        except OSError as error:
            raise output_error(path, error) from error
        if waiting is None:
            whole.rename()
        else:
            waiting.files.append(whole)
        done = True
    finally:
        if waiting is None or not done:
            whole.remove()


def size_of(path: Path) -> int:
    """Return the size of a file that was written, if it has its name yet or not [byte].

    Raises:
        OSError: There is no such file.
    """
    waiting = _waiting.get()
    for whole in [] if waiting is None else reversed(waiting.files):
        if whole.path == path:
            return whole.temporary.stat().st_size
    return path.stat().st_size


@contextlib.contextmanager
def together() -> Iterator[None]:
    """Let the files that `replacing` makes in a block get their names at its end.

    They get them in the order made, or none does where the block does not end well. A
    block within another leaves them to that.

    Raises:
        FormatError: Inputs are recorded, and one changed since it was read (IO004).
        OutputError: One cannot be renamed.
    """
    if _waiting.get() is not None:
        yield
        return
    waiting = _Block()
    token = _waiting.set(waiting)
    try:
        yield
        check_inputs()
        for whole in waiting.files:
            whole.rename()
    finally:
        _waiting.reset(token)
        for whole in waiting.files:
            whole.remove()
    for action in waiting.after:
        action()


def once_named(action: Callable[[], object]) -> None:
    """Do something when the files that are made have their names.

    That is now, or inside of `together` at the end of that, if it ends well.
    """
    waiting = _waiting.get()
    if waiting is None:
        action()
    else:
        waiting.after.append(action)


def _flush(path: Path) -> None:
    if path.is_dir() and os.name == "nt":
        return  # Windows has no handle on a folder to flush.
    handle = os.open(path, os.O_RDWR if path.is_file() else os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
