"""Public names of a package, imported when they are first used."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping


def lazy_names(
    package: str, places: Mapping[str, str]
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return the ``__getattr__`` and ``__dir__`` of a package.

    A module that is imported becomes an attribute of its package, so that none may
    have the name of something else in it.

    Args:
        package: Its name.
        places: The module of each public name; one of a module is the module's own.

    >>> get, _ = lazy_names("animtool", {"Fault": "animtool.errors"})
    >>> get("Fault")
    <class 'animtool.errors.Fault'>
    """
    names = vars(sys.modules[package])

    def get(name: str) -> object:
        """Import a public name when it is first used."""
        if name not in places:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = importlib.import_module(places[name])
        is_module = places[name] == f"{package}.{name}"
        names[name] = module if is_module else getattr(module, name)
        return names[name]

    def listed() -> list[str]:
        return [*names, *places]

    return get, listed
