"""Builds items and measures them, in this process or in a worker process."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import field, replace
from enum import StrEnum
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING

from animtool.batch.item import Item, ItemTask
from animtool.batch.manifest import FileRecord, record_file
from animtool.batch.spec import relative_name
from animtool.core.arguments import argument
from animtool.core.errors import AnimtoolError, Fault, excerpt
from animtool.core.files.commit import output_error
from animtool.core.files.reading import (
    FileState,
    RecordedInputs,
    record_input,
    recorded_inputs,
)
from animtool.core.names import has_kind_suffix
from animtool.core.process.supervisor import follow_parent, report_reading
from animtool.core.readers import BVH, READERS, RIG_AND_CLIP_FILES, USD
from animtool.core.record import dataclass
from animtool.motion.scores import PassScores

if TYPE_CHECKING:
    from animtool.scene.bake.bake import OutputReport

# Hint of errors that end a run.
RESUME_HINT = "finished items are recorded; run the same command again to resume"


class ItemStatus(StrEnum):
    """Status of an item after a run."""

    DONE = "done"
    SKIPPED = "skipped"
    FAILED = "failed"
    NOT_RUN = "not run"


@dataclass(frozen=True, slots=True)
class BakeMeasurements:
    """Number of samples of a bake, and its largest error."""

    sample_count: int  # number of written samples
    error: float  # largest distance between a joint and its written position [m]
    joint: str  # name of that joint


@dataclass(frozen=True, slots=True)
class ItemOutcome:
    """Result of building an item: files, measurements and notices, or faults."""

    number: int  # of the item
    status: ItemStatus  # done or failed
    seconds: float  # wall time
    faults: tuple[Fault, ...] = ()  # why it failed
    notices: tuple[Fault, ...] = ()  # warnings and notes
    measurements: BakeMeasurements | None = None  # measurements of the bake
    scores: tuple[PassScores, ...] = ()  # scores of its passes
    inputs: tuple[FileRecord, ...] = ()  # accessed files
    outputs: tuple[FileRecord, ...] = ()  # written files
    written_at: int = 0  # time by the clock of the output's disk [ns]
    is_retired: bool = False  # whether the process should build no more items

    @classmethod
    def failed(cls, item: Item, *faults: Fault, seconds: float = 0.0) -> ItemOutcome:
        """Return the outcome of an item that failed after a time in seconds."""
        return cls(item.number, ItemStatus.FAILED, seconds, faults)


@dataclass(slots=True)
class ItemBuilder:
    """Builds items in this process, and records the files that each accesses."""

    item_task: ItemTask  # how to build
    root: Path  # root of the paths in records
    _records_by_state: dict[FileState, FileRecord] = field(default_factory=dict)

    def build(self, item: Item) -> ItemOutcome:
        """Build an item and return its outcome; raise only to end the process."""
        start_time = time.perf_counter()
        is_retired = False
        try:
            return self._build(item, start_time)
        except AnimtoolError as error:
            faults = tuple(fault.in_file(_item_path(item)) for fault in error.faults)
        except MemoryError:
            is_retired = True
            faults = (Fault("BAT022", "out of memory", _item_path(item)),)
        except OSError as error:
            message = f"cannot be read or written: {error.strerror or error}"
            faults = (Fault("BAT023", message, error.filename or _item_path(item)),)
        except Exception as error:
            error_name, is_retired = type(error).__name__, True
            message = f"internal error: {error_name}: {excerpt(str(error), 200)}"
            hint = f"please report it; {argument('executor', 'serial')} "
            hint += f"{argument('debug', True)} shows where"
            faults = (Fault("BAT023", message, _item_path(item), (), hint),)
        finally:
            _forget_layers()
        seconds = time.perf_counter() - start_time
        return ItemOutcome(
            item.number, ItemStatus.FAILED, seconds, faults, is_retired=is_retired
        )

    def _build(self, item: Item, start_time: float) -> ItemOutcome:
        from animtool.scene.bake.prims import raise_stopped

        with recorded_inputs() as inputs:
            record_input(item.file.path)
            for folder in item.folders:
                try:
                    folder.mkdir(parents=True, exist_ok=True)
                except OSError as error:
                    raise output_error(folder, error) from error
            reports = self.item_task.bake(item)
            raise_stopped(reports)
        paths = dict.fromkeys(path for report in reports for path in report.files)
        outputs = tuple(
            record_file(path, relative_name(path, self.root), FileState.of(path))
            for path in paths
        )
        written_at = max(file.state.changed_at for file in outputs if file.state)
        notices = (notice for report in reports for notice in report.notices)
        return ItemOutcome(
            item.number,
            ItemStatus.DONE,
            time.perf_counter() - start_time,
            (),
            tuple(dict.fromkeys(notices)),
            _measurements(reports),
            tuple(reports[0].scores),
            self._input_records(inputs, written_at),
            outputs,
            written_at,
        )

    def _input_records(
        self, inputs: RecordedInputs, written_at: int
    ) -> tuple[FileRecord, ...]:
        """Return records of the files that were read, sorted by name."""
        records = []
        for path, state in sorted(inputs.states.items()):
            cached_record = None if state is None else self._records_by_state.get(state)
            name = relative_name(path, self.root)
            if cached_record is None or cached_record.path != name:
                cached_record = record_file(path, name, state)
                # A younger file may later have the same state with another content.
                if state is not None and state.changed_at < written_at:
                    self._records_by_state[state] = cached_record
            records.append(cached_record)
        # The file is unchanged after reading it again for its digest.
        inputs.check()
        return tuple(records)


def _measurements(reports: Sequence[OutputReport]) -> BakeMeasurements:
    """Return the total number of samples and the largest error of all outputs."""
    measurements = [_output_measurements(report) for report in reports]
    worst_measurement = max(measurements, key=lambda output: output.error)
    return replace(
        worst_measurement,
        sample_count=sum(output.sample_count for output in measurements),
    )


def _output_measurements(report: OutputReport) -> BakeMeasurements:
    from animtool.scene.bake.prims import BakeReport

    if isinstance(report, BakeReport):
        worst_take = report.worst
        error = worst_take.written.rounding.error
        return BakeMeasurements(report.result.samples, error, worst_take.error_joint)
    reduction = report.reduction
    if reduction is None:
        return BakeMeasurements(report.frames, 0.0, "")
    return BakeMeasurements(report.frames, reduction.error, reduction.joint)


def _item_path(item: Item) -> str:
    return str(item.file.path)


def _forget_layers() -> None:
    """Release USD layers in memory: their files may change before the next item."""
    if "animtool.usd.layers.sdf" in sys.modules:
        from animtool.usd.layers.sdf import forget_layers

        forget_layers()


# Module that is imported last and freezes the imported objects.
FREEZE_MODULE = "animtool.batch.preload"
COMMON_MODULES = (
    "animtool.batch.work",
    "animtool.scene.bake.bake",
    "animtool.usd.takes.author",
)
READER_MODULES = {
    BVH: ("animtool.formats.bvh.read",),
    RIG_AND_CLIP_FILES: (
        "animtool.clip.file",
        "animtool.rig.file",
        "animtool.scene.sources.clips",
    ),
    USD: ("animtool.usd.takes.read",),
}
LAYER_MODULES = ("animtool.usd.rigs.target",)
# A scene may read any format, and most change timing.
SCENE_MODULES = (
    "animtool.scene.file.read",
    *(module for modules in READER_MODULES.values() for module in modules),
    *LAYER_MODULES,
    "animtool.edit.looping",
    "animtool.edit.thin",
    "animtool.edit.retiming",
    "animtool.scene.bake.library",
    "animtool.scene.bake.plan",
    "animtool.usd.rigs.meshes",
)


def required_modules(item_task: ItemTask) -> list[str]:
    """Return the modules that a worker imports before its first item.

    >>> from pathlib import Path
    >>> required_modules(ItemTask(example_paths=(Path("walk.bvh"),)))[-2:]
    ['animtool.formats.bvh.read', 'animtool.batch.preload']
    """
    return [
        *dict.fromkeys([*COMMON_MODULES, *_modules_of_kinds(item_task), FREEZE_MODULE])
    ]


def _modules_of_kinds(item_task: ItemTask) -> Iterator[str]:
    has_scenes = any(has_kind_suffix(path, "scene") for path in item_task.example_paths)
    if item_task.scene is not None or has_scenes:
        yield from SCENE_MODULES
    if item_task.options.rig_layer is not None:
        yield from LAYER_MODULES
    for path in item_task.example_paths:
        reader = READERS.get(path.suffix.lower())
        yield from READER_MODULES.get(reader, ()) if reader is not None else ()


# Message of a worker that is ready for items.
READY_MESSAGE = "ready"


@dataclass(frozen=True, slots=True)
class FileBeingRead:
    """Message of a worker: the file that USD reads, or "" after reading."""

    path: str


def serve(
    connection: Connection, builder: ItemBuilder, memory_limit: int | None
) -> None:
    """Receive items, build them and send their outcomes until None is received.

    ``memory_limit`` is the memory limit of this process [bytes]; None for no limit.
    """
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    follow_parent()
    # Imports before the first item do not count as its time.
    for name in required_modules(builder.item_task):
        import_module(name)
    from animtool.usd.layers.sdf import limit_usd_threads

    limit_usd_threads()
    if memory_limit is not None:
        _limit_memory(memory_limit)
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        connection.send(READY_MESSAGE)
        report_reading(lambda path: connection.send(FileBeingRead(path)))
        while (item := connection.recv()) is not None:
            outcome = builder.build(item)
            connection.send(outcome)
            if outcome.is_retired:
                return


def _limit_memory(memory_limit: int) -> None:
    """Make memory allocations beyond a limit fail, if the system supports that.

    Mapped memory is partly counted twice, so the limit tends to be too large; the run
    also checks the used memory.
    """
    if sys.platform == "win32":
        return
    import resource

    if process_memory := memory_bytes():
        with contextlib.suppress(OSError, ValueError):
            hard_limit = resource.getrlimit(resource.RLIMIT_AS)[1]
            limit = process_memory[0] + memory_limit
            if hard_limit != resource.RLIM_INFINITY:
                limit = min(limit, hard_limit)
            resource.setrlimit(resource.RLIMIT_AS, (limit, hard_limit))


def memory_bytes(process_id: int | None = None) -> tuple[int, int] | None:
    """Return the mapped and the resident memory of a process [bytes].

    Without an id it is this process. Returns None if the memory is unknown.
    """
    try:
        with open(f"/proc/{process_id or 'self'}/statm", "rb") as file:  # noqa: PTH123
            mapped_pages, resident_pages = map(int, file.read().split()[:2])
    except (OSError, ValueError):
        return None
    page_size = os.sysconf("SC_PAGE_SIZE")
    return mapped_pages * page_size, resident_pages * page_size
