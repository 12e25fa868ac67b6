"""Output files: safe names, checks before the work, and atomic writes."""

from __future__ import annotations

import contextlib
import os
import re
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import field
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, BinaryIO

from animtool.core.arguments import argument, clause
from animtool.core.errors import Fault, OptionError, OutputError, counted
from animtool.core.files.commit import (
    WRITE_HINT,
    OutputTarget,
    WrittenFile,
    commit_files,
    output_error,
    output_target,
)
from animtool.core.files.leftovers import new_temporary_path, roll_back_folder
from animtool.core.files.reading import check_inputs, recorded_inputs
from animtool.core.process.signals import (
    deferred_signals,
    ending_signal,
    reraise_signal,
)
from animtool.core.process.supervisor import record_folder, record_output
from animtool.core.record import dataclass

if TYPE_CHECKING:
    import numpy.typing as npt

# Maximum length of a name in a folder, on nearly every disk [byte].
MAX_NAME_BYTES = 255
# The output that is no file, as commands name it.
STDOUT = Path("-")
# Windows reserves these names for devices, whatever the suffix.
_DEVICE_NAMES = frozenset(
    {"con", "prn", "aux", "nul", "conin$", "conout$"}
    | {f"{port}{number}" for port in ("com", "lpt") for number in "0123456789¹²³"}
)
# Prefix of records and of files that are being written.
_RECORD_PREFIX = ".animtool"


def name_problem(name: str) -> str | None:
    r"""Return what is wrong with a file or folder name; None if nothing is.

    Names must be valid on every system, so that outputs can be moved.

    >>> name_problem("sh010"), name_problem(".."), name_problem("a/b")
    (None, 'means a folder', 'has the separator /')
    >>> name_problem("aux.usdc"), name_problem("walk.")
    ('is the name of a device on Windows', 'ends with a dot or a space')
    """
    return next((text for is_problem, text in _name_problems(name) if is_problem), None)


def _name_problems(name: str) -> Iterator[tuple[bool, str]]:
    separators = sorted(set("/\\").intersection(name))
    controls = [c for c in name if unicodedata.category(c) == "Cc"]
    size = len(name.encode("utf-8", "surrogatepass"))
    yield not name, "is empty"
    yield name in {".", ".."}, "means a folder"
    yield bool(separators), f"has the separator {' and '.join(separators)}"
    yield bool(controls), f"has the control character {''.join(controls[:1])!r}"
    yield name[-1:] in {".", " "}, "ends with a dot or a space"
    yield size > MAX_NAME_BYTES, f"has more than {MAX_NAME_BYTES} bytes"
    yield not is_utf8(name), "contains bytes that are not UTF-8"
    is_device_name = name.partition(".")[0].rstrip().casefold() in _DEVICE_NAMES
    yield is_device_name, "is the name of a device on Windows"
    yield (
        name.casefold().startswith(_RECORD_PREFIX),
        f"starts with {_RECORD_PREFIX!r}, which records use",
    )


def is_utf8(name: str) -> bool:
    r"""Return whether a name is UTF-8 text; file names may contain other bytes.

    >>> is_utf8("walk"), is_utf8("walk\udcff")
    (True, False)
    """
    return re.search("[\ud800-\udfff]", name) is None


def name_key(path: PurePath | str) -> str:
    """Return a key that is equal for paths that any disk treats as the same file.

    Some disks do not distinguish names by case or by the encoding of accents.

    >>> name_key("Ä.usda") == name_key("a\N{COMBINING DIAERESIS}.USDA")
    True
    """
    text = os.fspath(path)
    if text.isascii():
        return text.lower()
    normalised_text = unicodedata.normalize("NFD", text).casefold()
    return unicodedata.normalize("NFC", normalised_text)


def is_inside(path: Path, folder: Path) -> bool:
    """Return whether a path is inside a folder, with links resolved."""
    try:
        return path.resolve().is_relative_to(folder.resolve())
    except RuntimeError as error:
        raise OSError(f"{path} is a link to itself") from error


# Final paths that were free when checked, and must not be replaced: another process
# that writes one meanwhile wins.
_new_paths: ContextVar[frozenset[Path]] = ContextVar("_new_paths", default=frozenset())


# If more outputs exist, the first are listed, with the number of the others.
MAX_LISTED_OUTPUTS = 3


def check_outputs(
    outputs: Sequence[Path], inputs: Sequence[Path], *, overwrite: bool
) -> None:
    """Raise an error for outputs that cannot be written or must not be.

    Refused are outputs that exist without ``overwrite`` (OUT001) or are inputs
    (OUT003), equal outputs (OUT007), outputs in folders that are missing or not
    writable (OUT002), and paths that are not files (OUT005). All faults of one kind are
    raised together.
    """
    targets: list[OutputTarget] = []
    for path in outputs:
        _require_writable_folder(path.parent, path)
        targets.append(output_target(path))
    _refuse_inputs(targets, inputs)
    _refuse_duplicates(targets)
    existing_outputs: list[Path] = []
    for output in targets:
        roll_back_folder(output.final_path.parent)
        if output.path.exists():
            if not overwrite:
                existing_outputs.append(output.path)
            elif not os.access(output.path, os.W_OK):
                message = "cannot be written: it is read-only"
                raise OutputError(Fault("OUT002", message, str(output.path)))
    if existing_outputs:
        hint = f"{argument('overwrite', True)} replaces it"
        if len(existing_outputs) == len(outputs):
            hint += clause(f", {argument('command.skip_existing', True)} leaves it")
        message, reported_paths = "already exists", existing_outputs
        if len(existing_outputs) > MAX_LISTED_OUTPUTS:
            other_text = counted(len(existing_outputs) - 1, "other output")
            message = f"already exists, and so do {other_text}"
            reported_paths = existing_outputs[:1]
            hint = hint.replace("s it", "s them")
        raise OptionError(
            [Fault("OUT001", message, str(path), (), hint) for path in reported_paths]
        )
    final_paths = {output.final_path for output in targets}
    _new_paths.set(
        _new_paths.get() - final_paths if overwrite else _new_paths.get() | final_paths
    )


def _require_writable_folder(folder: Path, path: Path) -> None:
    """Raise an error if the folder of an output is missing or not writable."""
    try:
        problem = "" if folder.is_dir() else "does not exist"
        if problem and folder.exists():
            problem = "is not a folder"
    except OSError as error:
        raise output_error(path, error) from error
    if problem:
        message = f"cannot be written: its folder {str(folder)!r} {problem}"
        hint = "make the folder first"
        if problem == "is not a folder":
            hint = f"choose another {argument('output')}"
        raise OutputError(Fault("OUT002", message, str(path), (), hint))
    if not os.access(folder, os.W_OK | os.X_OK):
        message = f"cannot be written: no permission in {str(folder)!r}"
        raise OutputError(Fault("OUT002", message, str(path), (), WRITE_HINT))


@contextlib.contextmanager
def protect_inputs(outputs: Sequence[Path]) -> Iterator[None]:
    """Raise OUT003 at the end of the block if it read an output as an input.

    A layer that is included by a USD file may be an output, since a shot is read to
    bake one of its layers again.
    """
    with recorded_inputs() as inputs:
        yield
    _refuse_inputs([output_target(path) for path in outputs], inputs.opened_paths)


def _refuse_inputs(targets: Iterable[OutputTarget], inputs: Iterable[Path]) -> None:
    input_by_key: dict[str, Path] = {}
    for path in inputs:
        # Broken links are reported when they are read.
        with contextlib.suppress(OSError, RuntimeError, ValueError):
            input_by_key[name_key(path.resolve())] = path
    for output in targets:
        input_path = input_by_key.get(name_key(output.final_path))
        if input_path is None or not input_path.exists():
            continue  # reading says that it does not exist
        if same_file(output.final_path, input_path):
            message = "is an input of this command"
            hint = f"choose another {argument('output')}"
            raise OptionError(Fault("OUT003", message, str(output.path), (), hint))


def _refuse_duplicates(targets: Iterable[OutputTarget | WrittenFile]) -> None:
    """Raise an error for two outputs that are the same file on any kind of disk."""
    path_by_key: dict[str, Path] = {}
    for output in targets:
        first_path = path_by_key.setdefault(name_key(output.final_path), output.path)
        if first_path is not output.path:
            message, hint = "is the output of two writers", "name another file for one"
            if str(first_path) != str(output.path):
                message = f"is the same file as {str(first_path)!r}"
            fault = Fault("OUT007", message, str(output.path), (), hint)
            raise OptionError(fault)


def same_file(path: Path, other_path: Path) -> bool:
    """Return whether two paths lead to the same file."""
    try:
        return path == other_path.resolve() or path.samefile(other_path)
    except OSError:
        return False


@dataclass(frozen=True, slots=True)
class _OutputSet:
    """Files of an open `atomic_outputs` block, which appear together at its end."""

    # Complete files that wait to be renamed.
    files: list[WrittenFile] = field(default_factory=list)
    # Actions after the files are renamed.
    commit_actions: list[Callable[[], object]] = field(default_factory=list)
    # New files that are already renamed.
    early_paths: list[Path] = field(default_factory=list)


_pending_outputs: ContextVar[_OutputSet | None] = ContextVar(
    "_pending_outputs", default=None
)


def write_parts(output: Path, parts: Iterable[bytes]) -> None:
    """Write a file atomically from an iterable of bytes (else OUT002)."""
    with _open_replacement(output) as file:
        for part in parts:
            file.write(part)


def write_arrays(output: Path, arrays: Mapping[str, npt.NDArray[Any]]) -> None:
    """Write named arrays to an npz file atomically (else OUT002)."""
    import numpy as np

    with _open_replacement(output) as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


@contextlib.contextmanager
def _open_replacement(output: Path) -> Iterator[BinaryIO]:
    """Yield an open file that replaces an output at the end of the block."""
    with replacement_path(output) as temporary_path:
        try:
            with temporary_path.open("wb") as file:
                yield file
        except OSError as error:
            raise output_error(output, error) from error


@contextlib.contextmanager
def replacement_path(path: Path) -> Iterator[Path]:
    """Yield a temporary path that is renamed to ``path`` at the end of the block.

    The file is flushed and renamed when the block succeeds, and removed when it fails,
    so that ``path`` is always absent, unchanged, or complete. Inside `atomic_outputs`,
    it is renamed at the end of that block. Recorded inputs must not have changed since
    they were read (IO004).
    """
    # Links stay: their target is replaced.
    final_path = output_target(path).final_path
    written_file = WrittenFile(path, final_path, new_temporary_path(final_path))
    pending_set = _pending_outputs.get()
    record_folder(final_path.parent)
    has_succeeded, initial_signal = False, ending_signal()
    try:
        yield written_file.temporary_path
        if ending_signal() and not initial_signal:
            # A library swallowed the signal's exception.
            reraise_signal()
        check_inputs()
        written_file.flush_to_disk()
        if pending_set is None:
            _commit_outputs([written_file])
        else:
            pending_set.files.append(written_file)
        has_succeeded = True
    finally:
        if pending_set is None or not has_succeeded:
            written_file.remove()


def _commit_outputs(files: Sequence[WrittenFile]) -> None:
    final_paths = {file.final_path for file in files}
    _refuse_duplicates(files)
    record_output()
    try:
        commit_files(files, _new_paths.get() & final_paths)
    finally:
        _new_paths.set(_new_paths.get() - final_paths)


def written_size(path: Path) -> int:
    """Return the size of a written file, whether it is committed or not [byte]."""
    pending_set = _pending_outputs.get()
    for written_file in [] if pending_set is None else reversed(pending_set.files):
        if written_file.path == path:
            return written_file.temporary_path.stat().st_size
    return path.stat().st_size


@contextlib.contextmanager
def atomic_outputs() -> Iterator[None]:
    """Commit all files that the block writes together, at its end.

    The files are renamed in the order of writing; if the block fails, none of them is.
    In a nested block, the outer one commits them. Inputs of the block must not change
    (IO004), no other process may write one of the outputs (OUT001), and no two outputs
    may be the same file (OUT007).
    """
    if _pending_outputs.get() is not None:
        yield
        return
    pending_set = _OutputSet()
    token = _pending_outputs.set(pending_set)
    try:
        with recorded_inputs():
            yield
            check_inputs()
        # A signal between renames would leave an incomplete set.
        with deferred_signals():
            _commit_outputs(pending_set.files)
            for action in pending_set.commit_actions:
                action()
    except BaseException:
        _remove_files(pending_set.early_paths)
        raise
    finally:
        _pending_outputs.reset(token)
        for written_file in pending_set.files:
            written_file.remove()


@contextlib.contextmanager
def early_outputs(paths: Sequence[Path]) -> Iterator[None]:
    """Commit new files that the block writes at its end, before all others.

    This is for files that are read again before the files that refer to them are
    written. The files are removed if the block, or an enclosing `atomic_outputs`,
    fails.
    """
    pending_set = _pending_outputs.get()
    token = _pending_outputs.set(None)
    try:
        yield
    except BaseException:
        _remove_files(paths)
        raise
    finally:
        _pending_outputs.reset(token)
    if pending_set is not None:
        pending_set.early_paths.extend(paths)


def _remove_files(paths: Iterable[Path]) -> None:
    for path in paths:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)


def after_commit(action: Callable[[], object]) -> None:
    """Call a function after the files of the current block are committed.

    It is called now, or inside `atomic_outputs` at its end, if that succeeds.
    """
    pending_set = _pending_outputs.get()
    if pending_set is None:
        action()
    else:
        pending_set.commit_actions.append(action)
