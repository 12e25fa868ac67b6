"""Tables of readers and writers by suffix, plug-ins included."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Generic, TypeVar

from animtool.core.errors import OptionError
from animtool.core.plugins import load_plugin, plugin_points
from animtool.core.record import dataclass

Entry = TypeVar("Entry")


@dataclass(frozen=True, slots=True)
class ListedFormat:
    """An entry as `animtool plugins` lists it."""

    suffix: str  # of the files
    source: str  # ``animtool``, or the object that an entry point names
    can: tuple[str, ...]  # its operations; empty if it cannot be loaded
    about: str  # its description, or why it cannot be loaded


@dataclass(frozen=True)
class FormatTable(Generic[Entry]):
    """A table whose built-in entries precede those of plug-ins."""

    builtin: Mapping[str, Entry]  # by suffix, with its dot
    group: str  # of the entry points
    kind: type[Entry]

    def find(self, path: Path) -> Entry | None:
        """Return the entry of a file's suffix; None without one.

        Raises:
            OptionError: The plug-in that has it cannot be loaded (IO003).
        """
        suffix = path.suffix.lower()
        if suffix in self.builtin:
            return self.builtin[suffix]
        points = plugin_points(self.group) if suffix else {}
        point = points.get(suffix.removeprefix("."))
        return None if point is None else load_plugin(point, self.kind)

    def plugin_suffixes(self) -> list[str]:
        """Return the suffixes that only plug-ins have."""
        names = sorted(plugin_points(self.group))
        return [f".{name}" for name in names if f".{name}" not in self.builtin]

    def listed(
        self, uses: Callable[[Entry], tuple[str, ...]], about: Callable[[Entry], str]
    ) -> list[ListedFormat]:
        """Return every entry, built-in ones first, plug-ins loaded."""
        rows = [
            ListedFormat(suffix, "animtool", uses(entry), about(entry))
            for suffix, entry in self.builtin.items()
        ]
        points = plugin_points(self.group)
        for suffix in self.plugin_suffixes():
            point = points[suffix.removeprefix(".")]
            can: tuple[str, ...] = ()
            try:
                entry = load_plugin(point, self.kind)
                can, text = uses(entry), about(entry)
            except OptionError as error:
                text = error.faults[0].message
            rows.append(ListedFormat(suffix, point.value, can, text))
        return rows


def suffix_text(path: Path) -> str:
    """Return the name of a file's suffix for messages.

    >>> suffix_text(Path("walk.txt")), suffix_text(Path("walk"))
    ("suffix '.txt'", 'a name without suffix')
    """
    return f"suffix {path.suffix!r}" if path.suffix else "a name without suffix"
