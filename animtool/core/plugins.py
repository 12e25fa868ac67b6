"""Lazy imports, entry points of plug-ins, and the tables of formats they extend."""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping
from operator import attrgetter
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from animtool.core.errors import Fault, OptionError, excerpt
from animtool.core.record import dataclass

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


def lazy_names(
    package: str,
    modules: Mapping[str, str],
    old_names: Mapping[str, str] = MappingProxyType({}),
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return the ``__getattr__`` and ``__dir__`` of a package with lazy imports.

    An imported module becomes an attribute of its package, so that no public name may
    equal a module name. Names of modules are looked up as modules. An old name returns
    the object of its new name, with a warning.

    >>> import_name, _ = lazy_names("animtool", {"Fault": "animtool.core.errors"})
    >>> import_name("Fault")
    <class 'animtool.core.errors.Fault'>
    """
    package_names = vars(sys.modules[package])

    def import_name(name: str) -> object:
        """Import the module of a public name when the name is first used."""
        if name in old_names:
            text = f"{name} is now called {old_names[name]}"
            warnings.warn(text, DeprecationWarning, stacklevel=2)
            return import_name(old_names[name])
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = importlib.import_module(modules[name])
        is_module = modules[name] == f"{package}.{name}"
        package_names[name] = module if is_module else getattr(module, name)
        return package_names[name]

    def list_names() -> list[str]:
        return sorted(modules)

    return import_name, list_names


PluginT = TypeVar("PluginT")


def load_object(path: str) -> object:
    """Import a module and return the object in it, named ``module:object``.

    >>> load_object("fractions:Fraction")
    <class 'fractions.Fraction'>
    """
    module_name, _, attribute = path.partition(":")
    loaded_object: object = attrgetter(attribute)(importlib.import_module(module_name))
    return loaded_object


def plugin_entry_points(group: str) -> dict[str, EntryPoint]:
    """Return the installed plug-ins of an entry point group, by name.

    Reading them takes tens of milliseconds; it is therefore deferred until a table
    lacks an entry, or `may_have_plugins` reports some.
    """
    if not may_have_plugins(group):
        return {}
    from importlib.metadata import entry_points

    return {point.name: point for point in entry_points(group=group)}


def may_have_plugins(group: str) -> bool:
    """Return whether any package has entry points of a group, without loading them.

    If packages are not all in folders, it returns True.
    """
    if sum(hasattr(finder, "find_distributions") for finder in sys.meta_path) > 1:
        return True
    for folder in map(Path, sys.path):
        if folder.is_file():
            return True
        for path in folder.glob("*.*"):
            if path.suffix == ".egg":
                return True
            if path.suffix in {".dist-info", ".egg-info"}:
                entry_file = path / "entry_points.txt"
                if entry_file.is_file() and group.encode() in entry_file.read_bytes():
                    return True
    return False


def load_plugin(point: EntryPoint, plugin_class: type[PluginT]) -> PluginT:
    """Load the object of an entry point and check its type (else IO003)."""
    try:
        plugin: object = point.load()
    except Exception as error:
        raise _plugin_error(point, plugin_class, str(error)) from error
    if not isinstance(plugin, plugin_class):
        reason = f"a {type(plugin).__name__}, no {plugin_class.__name__}"
        raise _plugin_error(point, plugin_class, reason)
    return plugin


def _plugin_error(point: EntryPoint, kind: type[object], reason: str) -> OptionError:
    description = f"{kind.__name__.lower()} {excerpt(point.name)} ({point.value})"
    message = f"the plug-in {description} cannot be loaded: {reason}"
    return OptionError(Fault("IO003", message, hint="repair or remove the plug-in"))


EntryT = TypeVar("EntryT")


@dataclass(frozen=True, slots=True)
class ListedEntry:
    """An entry of a table as `animtool plugins` lists it."""

    name: str
    source: str  # ``animtool``, or the object that an entry point names
    uses: Any  # what it can be used for; empty if it cannot be loaded
    about: str  # its description, or why it cannot be loaded


def describe_entries(
    builtin_names: Iterable[str],
    entry_points: Mapping[str, EntryPoint],
    find: Callable[[str], EntryT],
    describe: Callable[[EntryT], tuple[Any, str]],
    uses_if_broken: Any,
) -> list[ListedEntry]:
    """Return all entries of a table, built-in ones first, with plug-ins loaded.

    ``find`` returns an entry by its name, and ``describe`` its uses and description; an
    entry that cannot be loaded has ``uses_if_broken``.
    """
    sources = dict.fromkeys(builtin_names, "animtool")
    for name, point in sorted(entry_points.items()):
        sources.setdefault(name, point.value)
    listed = []
    for name, source in sources.items():
        try:
            uses, about = describe(find(name))
        except OptionError as error:
            uses, about = uses_if_broken, error.faults[0].message
        listed.append(ListedEntry(name, source, uses, about))
    return listed


@dataclass(frozen=True)
class FormatTable(Generic[EntryT]):
    """A table of formats by suffix; built-in entries precede those of plug-ins."""

    builtin: Mapping[str, EntryT]  # by suffix, including the dot
    group: str  # group of the entry points
    kind: type[EntryT]

    def find(self, path: Path) -> EntryT | None:
        """Return the entry for the suffix of a file; None if there is none."""
        suffix = path.suffix.lower()
        if suffix in self.builtin:
            return self.builtin[suffix]
        point = self._entry_points_by_suffix().get(suffix) if suffix else None
        return None if point is None else load_plugin(point, self.kind)

    def _entry_points_by_suffix(self) -> dict[str, EntryPoint]:
        """Return the plug-ins by the file suffix that each supports, with its dot."""
        points = sorted(plugin_entry_points(self.group).items())
        return {f".{name}": point for name, point in points}

    def plugin_suffixes(self) -> list[str]:
        """Return the suffixes that only plug-ins support."""
        return [s for s in self._entry_points_by_suffix() if s not in self.builtin]

    def listed(
        self, uses: Callable[[EntryT], tuple[str, ...]], about: Callable[[EntryT], str]
    ) -> list[ListedEntry]:
        """Return all entries, built-in ones first, with plug-ins loaded."""
        points = self._entry_points_by_suffix()

        def find(suffix: str) -> EntryT:
            if suffix in self.builtin:
                return self.builtin[suffix]
            return load_plugin(points[suffix], self.kind)

        return describe_entries(
            self.builtin, points, find, lambda entry: (uses(entry), about(entry)), ()
        )


def suffix_text(path: Path) -> str:
    """Return the suffix of a file as text for a message.

    >>> suffix_text(Path("walk.txt")), suffix_text(Path("walk"))
    ("suffix '.txt'", 'a name without suffix')
    """
    return f"suffix {path.suffix!r}" if path.suffix else "a name without suffix"
