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
class WorkerRequirements:
    """Requirements that a worker must meet before it is sent an item."""

    task: WorkerTask
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
        text = read_input(path, is_recorded=False).replace(b"\r\n", b"\n")
        digest.update(f"{path.relative_to(folder).as_posix()}\0{len(text)}\0".encode())
        digest.update(text)
    return digest.hexdigest()[:12]


def version_differences(
    expected_versions: Mapping[str, str], actual_versions: Mapping[str, str]
) -> str:
    """Return the packages whose versions differ, as text; "" if there are none.

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
    worker: Any, run_name: str, versions: Mapping[str, str], pickled_requirements: bytes
) -> tuple[str, str]:
    """Prepare a worker for a run; return a code and a reason if it is unfit.

    Args:
        worker: The worker, which keeps the prepared state in its ``plugins``.
        run_name: Name of the run.
        versions: Result of `builder_versions` on the machine of the run.
        pickled_requirements: A `WorkerRequirements`, read only if versions are equal.
    """
    differences = version_differences(versions, builder_versions())
    if differences:
        return VERSIONS_CODE, f"it has {differences}"
    requirements: WorkerRequirements = pickle.loads(pickled_requirements)
    code, reason = next(_unfit_reasons(requirements), ("", ""))
    if not code:
        worker.plugins[run_name] = WorkerProcesses(requirements.task)
    return code, reason


def _unfit_reasons(requirements: WorkerRequirements) -> Iterator[tuple[str, str]]:
    """Yield a code and a reason for each requirement that this worker does not meet."""
    if not Path(requirements.task.folder).is_dir():
        yield INPUTS_CODE, f"it has no folder {excerpt(requirements.task.folder, 200)}"
    paths = [input_check.path for input_check in requirements.inputs]
    missing_paths = [path for path in paths if not os.access(path, os.R_OK)]
    if missing_paths:
        counts_text = f"{len(missing_paths)} of {len(paths)} inputs"
        yield INPUTS_CODE, f"it cannot read {counts_text}: {listed(missing_paths, 2)}"
    different_paths = [
        input_check.path
        for input_check in requirements.inputs
        if not _has_expected_content(input_check)
    ]
    if different_paths:
        reason = "it has different files with the same names: "
        yield INPUTS_CODE, reason + listed(different_paths, 2)
    for path, text in requirements.tokens.items():
        folder = Path(path).parent
        try:
            has_token = read_input(Path(path), is_recorded=False) == text.encode()
        except AnimtoolError:
            has_token = False
        if not has_token:
            yield DISK_CODE, f"its {str(folder)!r} is not the folder of this machine"
        elif not os.access(folder, os.W_OK | os.X_OK):
            yield DISK_CODE, f"it has no permission to write to {str(folder)!r}"


def _has_expected_content(expected_input: InputCheck) -> bool:
    """Return whether a file on this machine has the expected size and content."""
    try:
        path = Path(expected_input.path)
        if path.stat().st_size != expected_input.size:
            return False
        return not expected_input.sha256 or file_digest(path) == expected_input.sha256
    except (OSError, AnimtoolError):
        return False


def build_on_worker(worker: Any, run_name: str, item: Item) -> ItemOutcome | None:
    """Build an item on a worker; return None if it is not prepared for the run."""
    processes: WorkerProcesses | None = worker.plugins.get(run_name)
    return None if processes is None else processes.build(item)


def stop_run(worker: Any, run_name: str) -> None:
    """Stop the work of a run on a worker."""
    processes: WorkerProcesses | None = worker.plugins.pop(run_name, None)
    if processes is not None:
        processes.teardown(worker)


@dataclass(slots=True)
class WorkerProcesses:
    """The subprocesses in which the threads of a worker build items."""

    task: WorkerTask
    _idle_processes: list[WorkerProcess] = field(default_factory=list)
    _busy_processes: list[WorkerProcess] = field(default_factory=list)

    def build(self, item: Item) -> ItemOutcome:
        """Build an item in an idle subprocess, or a new one; return its outcome."""
        # Both operations are atomic among threads.
        process = (
            self._idle_processes.pop()
            if self._idle_processes
            else WorkerProcess(self.task)
        )
        self._busy_processes.append(process)
        try:
            outcome = process.build_item(item)
        except OSError as error:
            self._busy_processes.remove(process)
            process.end()
            message = f"cannot be built there: {error}"
            fault = Fault("BAT020", message, str(item.file.path))
            return ItemOutcome.failed(item, fault)
        self._busy_processes.remove(process)
        self._idle_processes.append(process)
        return outcome

    def teardown(self, worker: object) -> None:
        """Kill the subprocesses; dask calls this when the worker closes."""
        del worker
        for process in [*self._idle_processes, *self._busy_processes]:
            process.end()


def check_task(
    run_name: str, versions: Mapping[str, str]
) -> Callable[[bytes], tuple[str, str, str]]:
    """Return a function that checks a worker; it returns host, code and reason.

    A worker that cannot import names in a message leaves its cluster. Therefore the
    function is sent as code, and its animtool arguments as bytes.
    """

    def check_worker(pickled_requirements: bytes) -> tuple[str, str, str]:
        import platform

        from distributed import get_worker

        host = platform.node()
        try:
            from animtool.batch.cluster_worker import prepare_worker

            return (
                host,
                *prepare_worker(get_worker(), run_name, versions, pickled_requirements),
            )
        except Exception as error:
            from importlib.metadata import PackageNotFoundError, version

            try:
                installed_version = f"animtool {version('animtool')}"
            except PackageNotFoundError:
                installed_version = "no animtool"
            reason = f"it has {installed_version} instead of {versions['animtool']}: "
            return host, "BAT036", f"{reason}{type(error).__name__}: {error}"

    return check_worker


def build_task(run_name: str) -> Callable[[bytes], ItemOutcome | None]:
    """Return a function that builds a pickled item on a checked worker."""

    def build_item(pickled_item: bytes) -> ItemOutcome | None:
        import pickle

        from distributed import get_worker

        from animtool.batch.cluster_worker import build_on_worker

        return build_on_worker(get_worker(), run_name, pickle.loads(pickled_item))

    return build_item
