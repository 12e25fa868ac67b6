"""Lazy imports of public names and of objects by name; entry points."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping
from operator import attrgetter
from typing import TYPE_CHECKING, TypeVar

from animtool.core.errors import Fault, OptionError, excerpt

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


def lazy_names(
    package: str, modules: Mapping[str, str]
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return a package's ``__getattr__`` and ``__dir__``, by modules of its names.

    A module that is imported becomes an attribute of its package, so that none may have
    the name of something else in it. A name of a module is the module's own.

    >>> get, _ = lazy_names("animtool", {"Fault": "animtool.core.errors"})
    >>> get("Fault")
    <class 'animtool.core.errors.Fault'>
    """
    names = vars(sys.modules[package])

    def get(name: str) -> object:
        """Import a public name when it is first used."""
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = importlib.import_module(modules[name])
        is_module = modules[name] == f"{package}.{name}"
        names[name] = module if is_module else getattr(module, name)
        return names[name]

    def listed() -> list[str]:
        return sorted(modules)

    return get, listed


Kind = TypeVar("Kind")


def load_object(path: str) -> object:
    """Return the object named ``module:object``, importing its module.

    >>> load_object("fractions:Fraction")
    <class 'fractions.Fraction'>
    """
    module, _, attribute = path.partition(":")
    value: object = attrgetter(attribute)(importlib.import_module(module))
    return value


def plugin_points(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group by name.

    Reading them takes tens of milliseconds, so it is left to what a table lacks, and
    to where a package has some.
    """
    if not may_have(group):
        return {}
    from importlib.metadata import entry_points

    return {point.name: point for point in entry_points(group=group)}


def may_have(group: str) -> bool:
    """Return whether a package has entry points of a group, without loading it.

    Where packages may be anywhere else than in folders, they may.
    """
    from pathlib import Path

    if sum(hasattr(finder, "find_distributions") for finder in sys.meta_path) > 1:
        return True
    for folder in map(Path, sys.path):
        if folder.is_file():
            return True
        for entry in folder.glob("*.*"):
            if entry.suffix == ".egg":
                return True
            if entry.suffix in {".dist-info", ".egg-info"}:
                listed = entry / "entry_points.txt"
                if listed.is_file() and group.encode() in listed.read_bytes():
                    return True
    return False


def load_plugin(point: EntryPoint, kind: type[Kind]) -> Kind:
    """Return the object of an entry point, of a type (else IO003)."""
    try:
        loaded: object = point.load()
    except Exception as error:
        raise _broken(point, kind, str(error)) from error
    if not isinstance(loaded, kind):
        why = f"a {type(loaded).__name__}, no {kind.__name__}"
        raise _broken(point, kind, why)
    return loaded


def _broken(point: EntryPoint, kind: type[object], why: str) -> OptionError:
    what = f"plug-in {kind.__name__.lower()} {excerpt(point.name)} ({point.value})"
    message = f"the {what} cannot be loaded: {why}"
    return OptionError(Fault("IO003", message, hint="repair or remove the plug-in"))
