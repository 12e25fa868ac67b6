"""Names of joints, meshes and shapes of a character."""

from __future__ import annotations

import re
from collections.abc import Iterable

from animtool.core.errors import Fault, Severity, counted, excerpt, listed
from animtool.core.names import numbered_names
from animtool.core.quantities import CONTROL
from animtool.formats.characters.nodes import Node

MAX_NAMED = 6
_CONTROL = re.compile(f"[{CONTROL}]")


def joint_names(
    nodes: list[Node], numbers: list[int]
) -> tuple[list[str], list[tuple[str, str]]]:
    """Return distinct joint names, and those that differ from the file's.

    Characters that text files cannot contain are replaced.
    """
    valid_names = []
    for node, number in zip(nodes, numbers, strict=True):
        name = _CONTROL.sub("_", node.name or "").strip()
        valid_names.append(name or f"node_{number}")
    names = numbered_names(valid_names)
    renamed = [
        (node.name, name)
        for node, name in zip(nodes, names, strict=True)
        if node.name is not None and node.name != name
    ]
    return names, renamed


def renamed_notice(code: str, renamed: list[tuple[str, str]], path: str) -> list[Fault]:
    """Return a note about joints whose names differ from the file's."""
    if not renamed:
        return []
    shown = listed([f"{excerpt(a)} is {b!r}" for a, b in renamed], MAX_NAMED)
    message = f"{counted(len(renamed), 'joint')} renamed to make names unique: {shown}"
    return [Fault(code, message, path, severity=Severity.NOTE)]


def printable(text: str) -> str:
    """Return a text with ``_`` for characters that cannot be printed, stripped."""
    return "".join(c if c.isprintable() else "_" for c in text).strip()


def shape_names(shapes: Iterable[tuple[str, str, str]]) -> list[str]:
    """Return distinct shape names, prefixed with the mesh if ambiguous.

    ``shapes`` has for each its name in the file, a default name, and its mesh's name.
    """
    taken: dict[str, None] = {}
    for text, default, mesh in shapes:
        name = printable(text) or default
        name = f"{mesh}_{name}" if name in taken else name
        unique, number = name, 2
        while unique in taken:
            unique, number = f"{name}_{number}", number + 1
        taken[unique] = None
    return list(taken)
