"""What makes the items of a batch: the table of executors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias, cast

from animtool.batch.pool import run_processes
from animtool.batch.recipe import Item, Recipe
from animtool.batch.spec import Limits
from animtool.batch.work import Maker, Outcome
from animtool.documents.names import nearest
from animtool.errors import Fault, OptionError, excerpt
from animtool.plugins import load_object, load_plugin, plugin_points

PLUGIN_GROUP = "animtool.executors"


@dataclass(frozen=True, slots=True)
class Work:
    """What an executor is given.

    Attributes:
        maker: Makes an item, whatever happens short of the end of its process; it
            can be sent to other processes.
        items: What is to be made. One is to be taken only when it can be begun:
            taking it says that it is.
        limits: What each may take.
        jobs: How many may be made at a time.
        argument: What the user wrote behind the executor's name and ``=``.
        asked: How many at a time the user asked for; None is as many as there is
            room for.
    """

    maker: Maker
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
        ready: ``module:object`` of a function from a `Recipe` that begins, and does
            not wait for, what takes long before the first item; empty is nothing.
    """

    about: str
    run: str
    ready: str = ""

    def load(self) -> Run:
        """Return the function that makes items."""
        return cast(Run, load_object(self.run))

    def get_ready(self, recipe: Recipe) -> None:
        """Begin what takes long before the first item, of a batch that has some."""
        if self.ready:
            cast(Callable[[Recipe], None], load_object(self.ready))(recipe)


EXECUTORS = {
    "dask": Executor(
        "the workers of a dask cluster: dask=ADDRESS (extra: farm)",
        "animtool.batch.cluster:dask",
    ),
    "processes": Executor(
        "several processes on this machine",
        "animtool.batch.executors:processes",
        "animtool.batch.pool:warm_up",
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
    return run_processes(work.maker, work.items, work.limits, work.jobs)


def serial(work: Work) -> Iterator[Outcome]:
    """Yield what becomes of items, made one after another in this process.

    Raises:
        OptionError: There are limits, which it cannot keep (BAT031).
    """
    if work.argument:
        raise _argument("serial", "it takes none")
    if work.limits != Limits():
        message = "serial makes items in its own process, which cannot be limited"
        hint = "processes keeps limits, with -j 1 too"
        raise OptionError(Fault("BAT031", message, hint=hint))
    return map(work.maker.make, work.items)


def _argument(name: str, hint: str) -> OptionError:
    return OptionError(Fault("BAT031", f"{name} has no argument", hint=hint))


def find_executor(name: str) -> Executor:
    """Return an executor by its name, those of plug-ins included.

    Raises:
        OptionError: There is none of that name (BAT030), or the plug-in that has it
            cannot be loaded (BAT032).

    >>> find_executor("serial").about
    "one after another, in animtool's own process"
    """
    if name in EXECUTORS:
        return EXECUTORS[name]
    found = plugin_points(PLUGIN_GROUP)
    if name in found:
        return load_plugin(found[name], Executor, "BAT032")
    hint = nearest(name, sorted({*EXECUTORS, *found}))
    message = f"no executor is named {excerpt(name)}"
    raise OptionError(Fault("BAT030", message, hint=hint))


@dataclass(frozen=True, slots=True)
class ListedExecutor:
    """An executor as `animtool plugins` lists it.

    Attributes:
        name: As the command line writes it.
        source: ``animtool``, or the object that an entry point names.
        loads: Whether it can be loaded.
        about: How it makes items, or why it cannot be loaded.
    """

    name: str
    source: str
    loads: bool
    about: str


def listed_executors() -> list[ListedExecutor]:
    """Return every executor, animtool's own first, those of plug-ins loaded.

    >>> [entry.name for entry in listed_executors()][:3]
    ['dask', 'processes', 'serial']
    """
    found = [
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
        found.append(ListedExecutor(name, point.value, loads, about))
    return found
