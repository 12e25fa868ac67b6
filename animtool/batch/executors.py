"""The table of executors that build the items of a batch, and the local executors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeAlias, cast

from animtool.batch.item import Item, ItemTask
from animtool.batch.pool import run_processes
from animtool.batch.spec import Limits
from animtool.batch.work import ItemBuilder, ItemOutcome
from animtool.core.arguments import argument
from animtool.core.errors import Fault, OptionError
from animtool.core.names import check_known_name
from animtool.core.plugins import (
    ListedEntry,
    describe_entries,
    load_object,
    load_plugin,
    plugin_entry_points,
)
from animtool.core.record import dataclass

PLUGIN_GROUP = "animtool.executors"


@dataclass(frozen=True, slots=True)
class Work:
    """The items that an executor builds, and how many at once.

    Attributes:
        builder: Builds an item, and raises only to end its process; can be sent to
            other processes.
        items: Items to build. Take one only when it can be started, since taking it
            reports its start.
        limits: Limits of each item.
        jobs: Maximum number of simultaneous items.
        argument: Text after the executor's name and ``=``.
        requested_jobs: Number of simultaneous items that the user requested; None if
            unspecified.
        inputs: Files that every machine must see: those of the items, and those that
            all items are built with.
        folders: Output folders of the items, and the folder of the records.
        queue_next: Whether items may be queued before the number of failures is known.
    """

    builder: ItemBuilder
    items: Iterator[Item]
    limits: Limits
    jobs: int
    argument: str = ""
    requested_jobs: int | None = None
    inputs: tuple[Path, ...] = ()
    folders: tuple[Path, ...] = ()
    queue_next: bool = True


# Yields the outcome of each item as it ends, and warnings about workers. Closing the
# iterator ends the work.
ExecutorFunction: TypeAlias = Callable[[Work], Iterator[ItemOutcome | Fault]]


@dataclass(frozen=True, slots=True)
class Executor:
    """A way to build items: in this process, in several, or on a cluster.

    Attributes:
        about: One-line description.
        run: ``module:object`` of a function from `Work` to outcomes.
        ready: ``module:object`` of a function from an `ItemTask` that starts slow
            preparations without waiting for them; empty for none.
    """

    about: str
    run: str
    ready: str = ""

    def load(self) -> ExecutorFunction:
        """Return the function that builds items."""
        return cast(ExecutorFunction, load_object(self.run))

    def prepare(self, item_task: ItemTask) -> None:
        """Start slow preparations, such as a preloaded process, and return at once."""
        if self.ready:
            cast(Callable[[ItemTask], None], load_object(self.ready))(item_task)


EXECUTORS = {
    "dask": Executor(
        "the workers of a dask cluster: dask=ADDRESS (extra: farm)",
        "animtool.batch.cluster:dask",
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


def processes(work: Work) -> Iterator[ItemOutcome]:
    """Yield the outcomes of items as several local processes build them."""
    if work.argument:
        raise _argument_error("processes", f"{argument('jobs')} sets how many")
    return run_processes(work.builder, work.items, work.limits, work.jobs)


def serial(work: Work) -> Iterator[ItemOutcome]:
    """Yield the outcomes of items as this process builds them one after another."""
    if work.argument:
        raise _argument_error("serial", "it takes no argument")
    if work.limits != Limits():
        message = "serial builds items in its own process, which cannot be limited"
        hint = f"processes applies limits, even with {argument('jobs', 1)}"
        raise OptionError(Fault("BAT031", message, hint=hint))
    return map(work.builder.build, work.items)


def _argument_error(name: str, hint: str) -> OptionError:
    return OptionError(Fault("BAT031", f"{name} takes no argument", hint=hint))


def find_executor(name: str) -> Executor:
    """Return a built-in executor, or one of a plug-in, by its name.

    >>> find_executor("serial").about
    "one after another, in animtool's own process"
    """
    if name in EXECUTORS:
        return EXECUTORS[name]
    entry_points = plugin_entry_points(PLUGIN_GROUP)
    check_known_name(name, sorted({*EXECUTORS, *entry_points}), "executor", "BAT030")
    return load_plugin(entry_points[name], Executor)


def listed_executors() -> list[ListedEntry]:
    """Return every executor and whether it loads, built-in ones first.

    >>> [entry.name for entry in listed_executors()][:3]
    ['dask', 'processes', 'serial']
    """
    entry_points = plugin_entry_points(PLUGIN_GROUP)
    return describe_entries(
        EXECUTORS, entry_points, find_executor, lambda entry: (True, entry.about), False
    )
