"""What makes the items of a batch: the table of executors, and the workers of dask."""

from __future__ import annotations

import importlib.util
import pickle
import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, TypeAlias, cast
from uuid import uuid4

from animtool.batch.item import Item, ItemTask
from animtool.batch.pool import run_processes
from animtool.batch.records import RecordError, json_of_file, text_in
from animtool.batch.spec import Limits, made_by
from animtool.batch.work import ItemBuilder, Outcome
from animtool.batch.worker_process import WorkerProcess, WorkerTask
from animtool.core.errors import Fault, OptionError, OutputError, excerpt
from animtool.core.names import nearest
from animtool.core.plugins import load_object, load_plugin, plugin_points

PLUGIN_GROUP = "animtool.executors"


@dataclass(frozen=True, slots=True)
class Work:
    """What an executor is given.

    Attributes:
        builder: Makes an item, whatever happens short of the end of its process; it
            can be sent to other processes.
        items: What is to be made. One is to be taken only when it can be begun:
            taking it says that it is.
        limits: What each may take.
        jobs: How many may be made at a time.
        argument: What the user wrote behind the executor's name and ``=``.
        asked: How many at a time the user asked for; None is as many as there is
            room for.
    """

    builder: ItemBuilder
    items: Iterator[Item]
    limits: Limits
    jobs: int
    argument: str = ""
    asked: int | None = None


# Yields what became of each item as it ends; closing the iterator ends the work.
Run: TypeAlias = Callable[[Work], Iterator[Outcome]]


@dataclass(frozen=True, slots=True)
class Executor:
    """One entry of the table of executors.

    Attributes:
        about: How it makes items, one line.
        run: ``module:object`` of a function from `Work` to outcomes.
        ready: ``module:object`` of a function from a `ItemTask` that begins, and does
            not wait for, what takes long before the first item; empty is nothing.
    """

    about: str
    run: str
    ready: str = ""

    def load(self) -> Run:
        """Return the function that makes items."""
        return cast(Run, load_object(self.run))

    def get_ready(self, item_task: ItemTask) -> None:
        """Begin what takes long before the first item, of a batch that has some."""
        if self.ready:
            cast(Callable[[ItemTask], None], load_object(self.ready))(item_task)


EXECUTORS = {
    "dask": Executor(
        "the workers of a dask cluster: dask=ADDRESS (extra: farm)",
        "animtool.batch.executors:dask",
    ),
    "processes": Executor(
        "several processes on this machine",
        "animtool.batch.executors:processes",
        "animtool.batch.pool:preload",
    ),
    "serial": Executor(
        "one after another, in animtool's own process",
        "animtool.batch.executors:serial",
    ),
}


def processes(work: Work) -> Iterator[Outcome]:
    """Yield what becomes of items, made by several processes of this machine."""
    if work.argument:
        raise _argument("processes", "-j says how many")
    return run_processes(work.builder, work.items, work.limits, work.jobs)


def serial(work: Work) -> Iterator[Outcome]:
    """Yield what becomes of items, made one after another in this process."""
    if work.argument:
        raise _argument("serial", "it takes none")
    if work.limits != Limits():
        message = "serial makes items in its own process, which cannot be limited"
        hint = "processes keeps limits, with -j 1 too"
        raise OptionError(Fault("BAT031", message, hint=hint))
    return map(work.builder.build, work.items)


def _argument(name: str, hint: str) -> OptionError:
    return OptionError(Fault("BAT031", f"{name} has no argument", hint=hint))


def find_executor(name: str) -> Executor:
    """Return an executor by its name, those of plug-ins included.

    >>> find_executor("serial").about
    "one after another, in animtool's own process"
    """
    if name in EXECUTORS:
        return EXECUTORS[name]
    points = plugin_points(PLUGIN_GROUP)
    if name in points:
        return load_plugin(points[name], Executor)
    hint = nearest(name, sorted({*EXECUTORS, *points}))
    message = f"no executor is named {excerpt(name)}"
    raise OptionError(Fault("BAT030", message, hint=hint))


@dataclass(frozen=True, slots=True)
class ListedExecutor:
    """An executor as `animtool plugins` lists it."""

    name: str  # as the command line writes it
    source: str  # ``animtool``, or the object that an entry point names
    loads: bool  # whether it can be loaded
    about: str  # how it makes items, or why it cannot be loaded


def listed_executors() -> list[ListedExecutor]:
    """Return every executor, animtool's own first, those of plug-ins loaded.

    >>> [entry.name for entry in listed_executors()][:3]
    ['dask', 'processes', 'serial']
    """
    executors = [
        ListedExecutor(name, "animtool", True, entry.about)
        for name, entry in EXECUTORS.items()
    ]
    for name, point in sorted(plugin_points(PLUGIN_GROUP).items()):
        if name in EXECUTORS:
            continue
        try:
            about, loads = find_executor(name).about, True
        except OptionError as error:
            about, loads = error.faults[0].message, False
        executors.append(ListedExecutor(name, point.value, loads, about))
    return executors


# A scheduler that has not answered by then is not there [s].
TIMEOUT = 10.0
# How often the workers that there are are counted where nothing ends [s].
POLL_INTERVAL = 1.0
# A nanny starts a lost worker anew within seconds, and clusters that grow by demand
# start machines within minutes; what takes longer may never come [s].
WORKERLESS = 300.0
# A scheduler writes a kilobyte about itself, and some for each worker.
MAX_SCHEDULER = 16_000_000
ADDRESS = re.compile(r"([a-z]+://.+)|(.+:[0-9]+)")


def dask(work: Work) -> Iterator[Outcome]:
    """Yield what becomes of items, made by the workers of a dask cluster.

    Each of its threads has a program of its own beside it, whose process makes one item
    after another: limits, and what an item costs that ends its process, are those of
    `run_processes`. As many items are begun as the cluster has threads, or as were
    asked for. The folders of inputs and outputs must be there under the same names.
    """
    about = work.argument
    file = about.endswith(".json")
    if not (file or ADDRESS.fullmatch(about)):
        message = f"{excerpt(about)} is no address of a dask scheduler"
        hint = "such as dask=tcp://host:8786, or dask=scheduler.json"
        raise OptionError(Fault("BAT031", message, hint=hint))
    if importlib.util.find_spec("distributed") is None:
        message = "the executor dask needs the package distributed"
        hint = "pip install 'animtool[farm]'"
        raise OptionError(Fault("IO005", message, hint=hint))
    return _outcomes(work, _address(Path(about)) if file else about)


def _address(path: Path) -> str:
    """Return the address that a scheduler has written to a file."""
    try:
        address = text_in(json_of_file(path, MAX_SCHEDULER), "address", 1000)
    except RecordError as error:
        raise _unreachable(str(path), error) from error
    if not ADDRESS.fullmatch(address):
        raise _unreachable(str(path), RecordError(f"{excerpt(address)} is no address"))
    return address


def _outcomes(work: Work, address: str) -> Iterator[Outcome]:
    client = _client(address)
    name = f"animtool-{uuid4().hex}"
    try:
        task = WorkerTask(work.builder, work.limits, str(Path.cwd()))
        _prepare(client, work.argument, name, task)
        yield from _made(client, name, work)
    finally:
        _left(client, name)


def _left(client: Any, name: str) -> None:
    """Let workers end what they are at, whether or not all was made, and leave them.

    A scheduler that does not answer is not waited for.
    """

    def leave() -> None:
        with suppress(Exception):
            client.unregister_worker_plugin(name)

    leaving = Thread(target=leave, daemon=True)
    leaving.start()
    leaving.join(TIMEOUT)
    with suppress(TimeoutError):
        client.close(TIMEOUT)


def _client(address: str) -> Any:
    from distributed import Client

    try:
        return Client(address, timeout=TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise _unreachable(address, error) from error


def _prepare(client: Any, about: str, name: str, task: WorkerTask) -> None:
    """Let each worker, of now and of later, know how items are made."""
    from distributed import WorkerPlugin

    class WorkerProcesses(_WorkerProcesses, WorkerPlugin):  # type: ignore[misc]
        """What every worker of the cluster has."""

    plugin = WorkerProcesses(task, made_by())
    try:
        client.register_plugin(plugin, name=name)
    except Exception as error:
        raise _unreachable(about, error) from error


def _unreachable(about: str, error: Exception) -> OutputError:
    kind = type(error).__name__
    hint = "its workers need the same animtool, and its scheduler the same distributed"
    return _unusable(about, f"{kind}: {excerpt(str(error), 200)}", hint)


def _unusable(about: str, why: str, hint: str) -> OutputError:
    message = f"no dask cluster at {about} can be used: {why}"
    return OutputError(Fault("BAT035", message, hint=hint))


def _made(client: Any, name: str, work: Work) -> Iterator[Outcome]:
    """Begin an item whenever a thread is free; yield what became of those that end.

    What was at a worker that is lost is begun again by the scheduler. No wait is longer
    than `POLL_INTERVAL`: between two, the workers are counted.
    """
    make, watch = _sent(name), _Watch(client, work.argument)
    going: dict[Any, Item] = {}
    ended: SimpleQueue[Any] = SimpleQueue()
    while True:
        places = work.asked or max(1, watch.threads())
        while len(going) < places:
            item = next(work.items, None)
            if item is None:
                break
            future = client.submit(make, pickle.dumps(item), pure=False)
            going[future] = item
            future.add_done_callback(ended.put)
        if not going:
            return
        try:
            future = ended.get(timeout=POLL_INTERVAL)
        except Empty:
            watch.threads()
        else:
            yield _outcome(future, going.pop(future))


@dataclass(slots=True)
class _Watch:
    """Whether there is still somebody who makes items."""

    client: Any  # the way to the cluster
    about: str  # what the user called it
    _seen: float = field(default_factory=time.monotonic)

    def threads(self) -> int:
        """Return how many threads the workers of now have."""
        hint = "what was made is recorded; the same command goes on with the rest"
        if self.client.status in {"closing", "closed"}:
            raise _unusable(self.about, "its scheduler is gone", hint)
        try:
            count = int(sum(self.client.nthreads(callback_timeout=TIMEOUT).values()))
        except (OSError, RuntimeError):
            # The client looks for its scheduler again, and closes where it is gone.
            count = 0
        now = time.monotonic()
        if count:
            self._seen = now
        elif now - self._seen > WORKERLESS:
            why = f"it has had no worker for {WORKERLESS:g} s"
            raise _unusable(self.about, why, hint)
        return count


def _sent(name: str) -> Callable[[bytes], Outcome]:
    """Return what makes an item, on a worker, by the lanes that are there.

    A worker drops out of its cluster where it cannot import what a message to it names.
    So this is sent by its code, and items as bytes: one that cannot import animtool
    fails what it is given, and says why.
    """

    def make(pickled: bytes) -> Outcome:
        import pickle

        from distributed import get_worker

        item = pickle.loads(pickled)
        processes: _WorkerProcesses = get_worker().plugins[name]
        return processes.make(item)

    return make


def _outcome(future: Any, item: Item) -> Outcome:
    try:
        outcome: object = future.result()
    except Exception as error:
        why = f"{type(error).__name__}: {excerpt(str(error), 200)}"
    else:
        if isinstance(outcome, Outcome) and outcome.number == item.number:
            return outcome
        why = "what it returned is no outcome of it"
    message = f"no worker of the cluster made it: {why}"
    return Outcome.failed(item, Fault("BAT020", message, str(item.file.path)))


@dataclass(slots=True)
class _WorkerProcesses:
    """The programs of a worker that make items: as many as it has threads at work."""

    task: WorkerTask  # how they make items
    versions: Mapping[str, str]  # of what items are made by, where the run is
    _idle: list[WorkerProcess] = field(default_factory=list)
    _busy: list[WorkerProcess] = field(default_factory=list)

    def make(self, item: Item) -> Outcome:
        """Return what became of an item."""
        other = _differences(self.versions, made_by())
        if other:
            import platform

            message = f"{platform.node()} has other versions than the run: {other}"
            hint = "the same on every machine makes the same bytes"
            return Outcome.failed(item, Fault("BAT036", message, hint=hint))
        # Both are atomic among threads.
        process = self._idle.pop() if self._idle else WorkerProcess(self.task)
        self._busy.append(process)
        try:
            outcome = process.make(item)
        except OSError as error:
            self._busy.remove(process)
            process.end()
            message = f"cannot be made here: {error}"
            return Outcome.failed(item, Fault("BAT020", message, str(item.file.path)))
        self._busy.remove(process)
        self._idle.append(process)
        return outcome

    def teardown(self, worker: object) -> None:
        """End the programs, and what they are at."""
        del worker
        for process in [*self._idle, *self._busy]:
            process.end()


def _differences(expected: Mapping[str, str], actual: Mapping[str, str]) -> str:
    return ", ".join(
        f"{name} {actual.get(name) or 'none'} for {expected.get(name) or 'none'}"
        for name in sorted({*expected, *actual})
        if expected.get(name) != actual.get(name)
    )
