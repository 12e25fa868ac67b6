"""Lazy imports by name, entry points, and tables of formats that they extend."""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Callable, Mapping
from operator import attrgetter
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Generic, TypeVar

from animtool.core.errors import Fault, OptionError, excerpt
from animtool.core.record import dataclass

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


def lazy_names(
    package: str,
    modules: Mapping[str, str],
    old_names: Mapping[str, str] = MappingProxyType({}),
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return a package's ``__getattr__`` and ``__dir__``, by modules of its names.

    An imported module becomes an attribute of its package, so that no public name may
    equal a module name. Names of modules are looked up as modules. An old name returns
    the object of its new name, with a warning.

    >>> get, _ = lazy_names("animtool", {"Fault": "animtool.core.errors"})
    >>> get("Fault")
    <class 'animtool.core.errors.Fault'>
    """
    names = vars(sys.modules[package])

    def get(name: str) -> object:
        """Import a public name when it is first used."""
        if name in old_names:
            text = f"{name} is now called {old_names[name]}"
            warnings.warn(text, DeprecationWarning, stacklevel=2)
            return get(old_names[name])
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

    Reading them takes tens of milliseconds; it is therefore deferred until a table
    lacks an entry, or `may_have` reports some.
    """
    if not may_have(group):
        return {}
    from importlib.metadata import entry_points

    return {point.name: point for point in entry_points(group=group)}


def may_have(group: str) -> bool:
    """Return whether a package has entry points of a group, without loading it.

    If packages are not all in folders, it returns True.
    """
    if sum(hasattr(finder, "find_distributions") for finder in sys.meta_path) > 1:
        return True
    for folder in map(Path, sys.path):
        if folder.is_file():
            return True
        for entry in folder.glob("*.*"):
            if entry.suffix == ".egg":
                return True
            if entry.suffix in {".dist-info", ".egg-info"}:
                entry_file = entry / "entry_points.txt"
                if entry_file.is_file() and group.encode() in entry_file.read_bytes():
                    return True
    return False


def load_plugin(point: EntryPoint, kind: type[Kind]) -> Kind:
    """Return the object of an entry point, checked by type (else IO003)."""
    try:
        plugin: object = point.load()
    except Exception as error:
        raise _broken(point, kind, str(error)) from error
    if not isinstance(plugin, kind):
        reason = f"a {type(plugin).__name__}, no {kind.__name__}"
        raise _broken(point, kind, reason)
    return plugin


def _broken(point: EntryPoint, kind: type[object], reason: str) -> OptionError:
    description = (
        f"plug-in {kind.__name__.lower()} {excerpt(point.name)} ({point.value})"
    )
    message = f"the {description} cannot be loaded: {reason}"
    return OptionError(Fault("IO003", message, hint="repair or remove the plug-in"))


Entry = TypeVar("Entry")


@dataclass(frozen=True, slots=True)
class ListedFormat:
    """An entry as `animtool plugins` lists it."""

    suffix: str  # suffix of the files
    source: str  # ``animtool``, or the object of the entry point
    can: tuple[str, ...]  # its operations; empty if it cannot be loaded
    about: str  # its description, or why it cannot be loaded


@dataclass(frozen=True)
class FormatTable(Generic[Entry]):
    """A table whose built-in entries precede those of plug-ins."""

    builtin: Mapping[str, Entry]  # by suffix, including the dot
    group: str  # group of the entry points
    kind: type[Entry]

    def find(self, path: Path) -> Entry | None:
        """Return the entry of a file's suffix; None if there is none.

        Raises:
            OptionError: The plug-in for it cannot be loaded (IO003).
        """
        suffix = path.suffix.lower()
        if suffix in self.builtin:
            return self.builtin[suffix]
        plugins = plugin_points(self.group) if suffix else {}
        plugin = plugins.get(suffix.removeprefix("."))
        return None if plugin is None else load_plugin(plugin, self.kind)

    def plugin_suffixes(self) -> list[str]:
        """Return the suffixes that only plug-ins support."""
        names = sorted(plugin_points(self.group))
        return [f".{name}" for name in names if f".{name}" not in self.builtin]

    def listed(
        self, uses: Callable[[Entry], tuple[str, ...]], about: Callable[[Entry], str]
    ) -> list[ListedFormat]:
        """Return every entry, built-in ones first, with plug-ins loaded."""
        formats = [
            ListedFormat(suffix, "animtool", uses(entry), about(entry))
            for suffix, entry in self.builtin.items()
        ]
        plugins = plugin_points(self.group)
        for suffix in self.plugin_suffixes():
            plugin = plugins[suffix.removeprefix(".")]
            operations: tuple[str, ...] = ()
            try:
                entry = load_plugin(plugin, self.kind)
                operations, text = uses(entry), about(entry)
            except OptionError as error:
                text = error.faults[0].message
            formats.append(ListedFormat(suffix, plugin.value, operations, text))
        return formats


def suffix_text(path: Path) -> str:
    """Return a file's suffix for messages.

    >>> suffix_text(Path("walk.txt")), suffix_text(Path("walk"))
    ("suffix '.txt'", 'a name without suffix')
    """
    return f"suffix {path.suffix!r}" if path.suffix else "a name without suffix"
