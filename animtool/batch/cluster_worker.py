"""Code that runs on the workers of a cluster: a check, then items.

Nothing of dask is imported: a worker is any object with ``plugins``, whose ``teardown``
it calls at its end.
"""

from __future__ import annotations

import hashlib
import os
import pickle
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field
from functools import cache
from pathlib import Path
from typing import Any

import animtool
from animtool.batch.item import Item
from animtool.batch.manifest import file_digest
from animtool.batch.spec import package_versions
from animtool.batch.work import ItemOutcome
from animtool.batch.worker_process import WorkerProcess, WorkerTask
from animtool.core.errors import AnimtoolError, Fault, excerpt, listed
from animtool.core.files.reading import read_input
from animtool.core.record import dataclass

# Codes of reasons for excluding a worker.
VERSIONS_CODE, INPUTS_CODE, DISK_CODE = "BAT036", "BAT074", "BAT075"


@dataclass(frozen=True, slots=True)
class InputCheck:
    """An input file and its state on the machine that runs the batch."""

    path: str  # absolute
    size: int  # [bytes]
    sha256: str = ""  # digest of its content; empty for no comparison


@dataclass(frozen=True, slots=True)
class WorkerCheck:
    """Requirements that a worker must meet before it is sent an item."""

    task: WorkerTask  # how it builds items
    inputs: tuple[InputCheck, ...]  # required files
    # Content by path of files that the run has just written to the output folders.
    tokens: Mapping[str, str]


def builder_versions() -> dict[str, str]:
    """Return the versions that affect results, and a digest of animtool's code.

    Includes a digest, since a checkout has the same version before and after a change.
    """
    return {**package_versions(), "animtool code": _code_digest()}


@cache
def _code_digest() -> str:
    digest = hashlib.sha256()
    folder = Path(animtool.__file__).parent
    for path in sorted(folder.rglob("*.py")):
        # Line ends differ between a checkout and a wheel on some systems.
        text = read_input(path, recorded=False).replace(b"\r\n", b"\n")
        digest.update(f"{path.relative_to(folder).as_posix()}\0{len(text)}\0".encode())
        digest.update(text)
    return digest.hexdigest()[:12]


def version_differences(
    expected_versions: Mapping[str, str], actual_versions: Mapping[str, str]
) -> str:
    """Return a text with the versions that differ; "" if all versions are equal.

    >>> version_differences({"numpy": "2.1"}, {"numpy": "1.9"})
    'numpy 1.9 instead of 2.1'
    """
    return ", ".join(
        f"{name} {actual_versions.get(name) or 'none'} instead of "
        f"{expected_versions.get(name) or 'none'}"
        for name in sorted({*expected_versions, *actual_versions})
        if expected_versions.get(name) != actual_versions.get(name)
    )


def prepare_worker(
    worker: Any, name: str, versions: Mapping[str, str], pickled: bytes
) -> tuple[str, str]:
    """Prepare a worker for a run; return a code and a reason if it is unfit.

    Args:
        worker: The worker, which keeps the prepared state in its ``plugins``.
        name: Name of the run.
        versions: Result of `builder_versions` on the machine of the run.
        pickled: A `WorkerCheck`, read only if the versions are equal.
    """
    differences_text = version_differences(versions, builder_versions())
    if differences_text:
        return VERSIONS_CODE, f"it has {differences_text}"
    check: WorkerCheck = pickle.loads(pickled)
    for code, reason in _unfit_reasons(check):
        return code, reason
    worker.plugins[name] = WorkerProcesses(check.task)
    return "", ""


def _unfit_reasons(check: WorkerCheck) -> Iterator[tuple[str, str]]:
    if not Path(check.task.folder).is_dir():
        yield INPUTS_CODE, f"it has no folder {excerpt(check.task.folder, 200)}"
    missing_paths = [
        expected_input.path
        for expected_input in check.inputs
        if not os.access(expected_input.path, os.R_OK)
    ]
    if missing_paths:
        count, total = len(missing_paths), len(check.inputs)
        yield (
            INPUTS_CODE,
            f"it cannot read {count} of {total} inputs: {listed(missing_paths, 2)}",
        )
    different_paths = [
        expected_input.path
        for expected_input in check.inputs
        if not _is_same(expected_input)
    ]
    if different_paths:
        yield (
            INPUTS_CODE,
            f"it has different files with the same names: {listed(different_paths, 2)}",
        )
    for path, text in check.tokens.items():
        folder = Path(path).parent
        try:
            is_same = read_input(Path(path), recorded=False) == text.encode()
        except AnimtoolError:
            is_same = False
        if not is_same:
            yield DISK_CODE, f"its {str(folder)!r} is not the folder of this machine"
        elif not os.access(folder, os.W_OK | os.X_OK):
            yield DISK_CODE, f"it has no permission to write to {str(folder)!r}"


def _is_same(expected_check: InputCheck) -> bool:
    try:
        path = Path(expected_check.path)
        if path.stat().st_size != expected_check.size:
            return False
        return not expected_check.sha256 or file_digest(path) == expected_check.sha256
    except (OSError, AnimtoolError):
        return False


def build_on(worker: Any, name: str, item: Item) -> ItemOutcome | None:
    """Build an item on a worker and return its outcome; None if it is unprepared."""
    processes: WorkerProcesses | None = worker.plugins.get(name)
    return None if processes is None else processes.build(item)


def release(worker: Any, name: str) -> None:
    """Stop the work of a run on a worker."""
    processes: WorkerProcesses | None = worker.plugins.pop(name, None)
    if processes is not None:
        processes.teardown(worker)


@dataclass(slots=True)
class WorkerProcesses:
    """Subprocesses of a worker that build items; each busy thread uses one."""

    task: WorkerTask  # how they build items
    _idle: list[WorkerProcess] = field(default_factory=list)
    _busy: list[WorkerProcess] = field(default_factory=list)

    def build(self, item: Item) -> ItemOutcome:
        """Build an item and return its outcome."""
        # Both operations are atomic among threads.
        process = self._idle.pop() if self._idle else WorkerProcess(self.task)
        self._busy.append(process)
        try:
            outcome = process.build_item(item)
        except OSError as error:
            self._busy.remove(process)
            process.end()
            message = f"cannot be built there: {error}"
            return ItemOutcome.failed(
                item, Fault("BAT020", message, str(item.file.path))
            )
        self._busy.remove(process)
        self._idle.append(process)
        return outcome

    def teardown(self, worker: object) -> None:
        """Stop the subprocesses and their work."""
        del worker
        for process in [*self._idle, *self._busy]:
            process.end()


def check_task(
    name: str, versions: Mapping[str, str]
) -> Callable[[bytes], tuple[str, str, str]]:
    """Return a task that checks a worker: it returns the host, and a code and reason.

    A worker that cannot import names in a message leaves its cluster. Therefore the
    function is sent as code, and its animtool arguments as bytes.
    """

    def check_worker(pickled: bytes) -> tuple[str, str, str]:
        import platform

        from distributed import get_worker

        host = platform.node()
        try:
            from animtool.batch.cluster_worker import prepare_worker

            return (host, *prepare_worker(get_worker(), name, versions, pickled))
        except Exception as error:
            from importlib.metadata import PackageNotFoundError, version

            try:
                actual = f"animtool {version('animtool')}"
            except PackageNotFoundError:
                actual = "no animtool"
            reason = f"it has {actual} instead of {versions['animtool']}: "
            return host, "BAT036", f"{reason}{type(error).__name__}: {error}"

    return check_worker


def build_task(name: str) -> Callable[[bytes], ItemOutcome | None]:
    """Return a task that builds an item on a checked worker, sent as code."""

    def build_item(pickled: bytes) -> ItemOutcome | None:
        import pickle

        from distributed import get_worker

        from animtool.batch.cluster_worker import build_on

        return build_on(get_worker(), name, pickle.loads(pickled))

    return build_item
