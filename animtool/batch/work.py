"""Building items, in this process or in a worker process."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import field
from enum import StrEnum
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING

from animtool.batch.item import Item, ItemTask
from animtool.batch.manifest import FileRecord, record_of
from animtool.batch.spec import relative_name
from animtool.core.arguments import argument
from animtool.core.errors import AnimtoolError, Fault, excerpt
from animtool.core.files.placing import output_error
from animtool.core.files.reading import FileState, Inputs, note_input, recorded_inputs
from animtool.core.names import is_named
from animtool.core.process.supervisor import follow_parent, report_reading
from animtool.core.readers import BVH, DOCUMENT, READERS, USD
from animtool.core.record import dataclass
from animtool.motion.scores import PassScores

if TYPE_CHECKING:
    from animtool.scene.bake.bake import OutputReport


class ItemStatus(StrEnum):
    """Status of an item."""

    DONE = "done"
    SKIPPED = "skipped"
    FAILED = "failed"
    NOT_RUN = "not run"


@dataclass(frozen=True, slots=True)
class Measured:
    """Measurements of a bake."""

    samples: int  # written
    error: float  # largest distance between a joint and where its file has it [m]
    joint: str  # which joint's


@dataclass(frozen=True, slots=True)
class ItemOutcome:
    """Outcome of an item that was due."""

    number: int  # the item's
    status: ItemStatus  # done or failed
    seconds: float  # wall time of making it
    faults: tuple[Fault, ...] = ()  # why it failed
    notices: tuple[Fault, ...] = ()  # warnings and notes
    measured: Measured | None = None  # measurements of the bake
    scores: tuple[PassScores, ...] = ()  # how well passes did
    inputs: tuple[FileRecord, ...] = ()  # the files that were looked at
    outputs: tuple[FileRecord, ...] = ()  # the files that were written
    at: int = 0  # when, by the clock of the disk that it was written to [ns]
    retired: bool = False  # whether the process that made it had better make no other

    @classmethod
    def failed(cls, item: Item, *faults: Fault, seconds: float = 0.0) -> ItemOutcome:
        """Return the outcome of an item that failed after some time [s]."""
        return cls(item.number, ItemStatus.FAILED, seconds, faults)


@dataclass(slots=True)
class ItemBuilder:
    """Builds the items of a batch one after another."""

    item_task: ItemTask  # how
    root: Path  # folder from which records name files
    _digests: dict[FileState, FileRecord] = field(default_factory=dict)

    def build(self, item: Item) -> ItemOutcome:
        """Return the outcome of an item; raise only to end the process."""
        began = time.perf_counter()
        retired = False
        try:
            return self._build(item, began)
        except AnimtoolError as error:
            faults = tuple(fault.in_file(_named(item)) for fault in error.faults)
        except MemoryError:
            retired = True
            faults = (Fault("BAT022", "out of memory", _named(item)),)
        except OSError as error:
            message = f"cannot be read or written: {error.strerror or error}"
            faults = (Fault("BAT023", message, error.filename or _named(item)),)
        except Exception as error:
            kind, retired = type(error).__name__, True
            message = f"internal error: {kind}: {excerpt(str(error), 200)}"
            hint = (
                f"please report it; {argument('executor', 'serial')} "
                f"{argument('debug', True)} shows where"
            )
            faults = (Fault("BAT023", message, _named(item), (), hint),)
        finally:
            _forget_layers()
        seconds = time.perf_counter() - began
        return ItemOutcome(
            item.number, ItemStatus.FAILED, seconds, faults, retired=retired
        )

    def _build(self, item: Item, began: float) -> ItemOutcome:
        from animtool.scene.bake.prims import raise_stopped

        with recorded_inputs() as inputs:
            note_input(item.file.path)
            for folder in item.folders:
                try:
                    folder.mkdir(parents=True, exist_ok=True)
                except OSError as error:
                    raise output_error(folder, error) from error
            reports = self.item_task.bake(item)
            raise_stopped(reports)
        paths = dict.fromkeys(path for report in reports for path in report.files)
        outputs = tuple(self._output(path) for path in paths)
        at = max(file.state.changed for file in outputs if file.state is not None)
        return ItemOutcome(
            item.number,
            ItemStatus.DONE,
            time.perf_counter() - began,
            (),
            tuple(dict.fromkeys(n for report in reports for n in report.notices)),
            _measured(reports),
            tuple(reports[0].scores),
            self._inputs(inputs, at),
            outputs,
            at,
        )

    def _inputs(self, inputs: Inputs, at: int) -> tuple[FileRecord, ...]:
        """Return records of the files that were read, sorted by name."""
        records = []
        for path, state in sorted(inputs.states.items()):
            known = None if state is None else self._digests.get(state)
            name = relative_name(path, self.root)
            if known is None or known.path != name:
                known = record_of(path, name, state)
                # Of a younger one the same state may mean another content later.
                if state is not None and state.changed < at:
                    self._digests[state] = known
            records.append(known)
        # The file read again for its digest is unchanged.
        inputs.check()
        return tuple(records)

    def _output(self, path: Path) -> FileRecord:
        return record_of(path, relative_name(path, self.root), FileState.of(path))


def _measured(reports: Sequence[OutputReport]) -> Measured:
    """Return the measurements of all outputs: total samples, largest error."""
    measured = [_one_measured(report) for report in reports]
    worst = max(measured, key=lambda one: one.error)
    return Measured(sum(one.samples for one in measured), worst.error, worst.joint)


def _one_measured(report: OutputReport) -> Measured:
    from animtool.scene.bake.prims import BakeReport

    if isinstance(report, BakeReport):
        worst = report.worst
        error = worst.written.rounding.error
        return Measured(report.result.samples, error, worst.error_joint)
    if report.reduction is None:
        return Measured(report.frames, 0.0, "")
    return Measured(report.frames, report.reduction.error, report.reduction.joint)


def _named(item: Item) -> str:
    return str(item.file.path)


def _forget_layers() -> None:
    """Release USD layers that are still open, which may be stale."""
    if "animtool.usd.layers.sdf" in sys.modules:
        from animtool.usd.layers.sdf import forget_layers

        forget_layers()


# The last one freezes the imported objects.
PRELOAD = "animtool.batch.preload"
ALWAYS = (
    "animtool.batch.work",
    "animtool.scene.bake.bake",
    "animtool.usd.takes.author",
)
READING = {
    BVH: ("animtool.formats.bvh.read",),
    DOCUMENT: (
        "animtool.clip.file",
        "animtool.rig.file",
        "animtool.scene.sources.clips",
    ),
    USD: ("animtool.usd.takes.read",),
}
LAYERS = ("animtool.usd.rigs.target",)
# A scene may read anything, and most change its time.
SCENES = (
    "animtool.scene.file.read",
    *(module for modules in READING.values() for module in modules),
    *LAYERS,
    "animtool.edit.looping",
    "animtool.edit.thin",
    "animtool.edit.retiming",
    "animtool.scene.bake.library",
    "animtool.scene.bake.plan",
    "animtool.usd.rigs.meshes",
)


def needed_modules(item_task: ItemTask) -> list[str]:
    """Return the modules to import before the first item.

    >>> from pathlib import Path
    >>> needed_modules(ItemTask(kinds=(Path("walk.bvh"),)))[-2:]
    ['animtool.formats.bvh.read', 'animtool.batch.preload']
    """
    return [*dict.fromkeys([*ALWAYS, *_by_kind(item_task), PRELOAD])]


def _by_kind(item_task: ItemTask) -> Iterator[str]:
    scenes = any(is_named(path, "scene") for path in item_task.kinds)
    if item_task.scene is not None or scenes:
        yield from SCENES
    if item_task.options.rig_layer is not None:
        yield from LAYERS
    for path in item_task.kinds:
        reader = READERS.get(path.suffix.lower())
        yield from READING.get(reader, ()) if reader is not None else ()


# What a worker sends once it can take items.
READY = "ready"


@dataclass(frozen=True, slots=True)
class FileBeingRead:
    """Message: the file that USD reads in a worker; empty after reading."""

    path: str


def serve(connection: Connection, builder: ItemBuilder, memory: int | None) -> None:
    """Build the items that arrive, and send their outcomes, until none arrives.

    ``memory`` [bytes].
    """
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    follow_parent()
    # What is imported before the first item takes none of its time.
    for name in needed_modules(builder.item_task):
        import_module(name)
    from animtool.usd.layers.sdf import compute_alone

    compute_alone()
    if memory is not None:
        _limit_memory(memory)
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        connection.send(READY)
        report_reading(lambda path: connection.send(FileBeingRead(path)))
        while (item := connection.recv()) is not None:
            outcome = builder.build(item)
            connection.send(outcome)
            if outcome.retired:
                return


def _limit_memory(memory: int) -> None:
    """Make allocations beyond a limit fail, where systems support that.

    What is mapped already counts twice in part: the limit errs on the large side, and
    the run watches what is really used.
    """
    if sys.platform == "win32":
        return
    import resource

    mapped = mapped_bytes()
    if mapped is not None:
        with contextlib.suppress(OSError, ValueError):
            most = resource.getrlimit(resource.RLIMIT_AS)[1]
            limit = mapped + memory
            if most != resource.RLIM_INFINITY:
                limit = min(limit, most)
            resource.setrlimit(resource.RLIMIT_AS, (limit, most))


def mapped_bytes() -> int | None:
    """Return the mapped memory of this process [bytes]; None where unknown."""
    try:
        with open("/proc/self/statm", "rb") as file:  # noqa: PTH123
            return int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return None
