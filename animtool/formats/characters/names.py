"""Makes unique names for joints and shapes of a character."""

from __future__ import annotations

import re
from collections.abc import Iterable

from animtool.core.errors import Fault, Severity, counted, excerpt, listed
from animtool.core.names import numbered_names, unused_name
from animtool.core.quantities import CONTROL_CHARACTERS
from animtool.formats.characters.nodes import Node

MAX_LISTED_JOINTS = 6
_CONTROL_PATTERN = re.compile(f"[{CONTROL_CHARACTERS}]")


def joint_names(
    nodes: list[Node], node_indices: list[int]
) -> tuple[list[str], list[tuple[str, str]]]:
    """Return unique joint names, and pairs of old and new names that differ.

    Characters that text files cannot contain are replaced.
    """
    valid_names = []
    for node, node_index in zip(nodes, node_indices, strict=True):
        name = _CONTROL_PATTERN.sub("_", node.name or "").strip()
        valid_names.append(name or f"node_{node_index}")
    names = numbered_names(valid_names)
    renamed_joints = [
        (node.name, name)
        for node, name in zip(nodes, names, strict=True)
        if node.name is not None and node.name != name
    ]
    return names, renamed_joints


def renamed_joints_notice(
    code: str, renamed_joints: list[tuple[str, str]], path: str
) -> list[Fault]:
    """Return a note about joints whose names differ from the file's."""
    if not renamed_joints:
        return []
    changes = [f"{excerpt(old)} to {new!r}" for old, new in renamed_joints]
    message = f"renamed {counted(len(renamed_joints), 'joint')} to make names unique: "
    message += listed(changes, MAX_LISTED_JOINTS)
    return [Fault(code, message, path, severity=Severity.NOTE)]


def replace_unprintable(text: str) -> str:
    """Return a stripped text with ``_`` in place of unprintable characters."""
    return "".join(c if c.isprintable() else "_" for c in text).strip()


def unique_take_names(names: Iterable[str], noun: str) -> list[str]:
    """Return unique printable names of takes; unnamed ones are numbered after a noun.

    >>> unique_take_names(["walk", "", "walk"], "take")
    ['walk', 'take_2', 'walk_2']
    """
    printable_names = map(replace_unprintable, names)
    return numbered_names(n or f"{noun}_{i}" for i, n in enumerate(printable_names, 1))


def shape_names(shapes: Iterable[tuple[str, str, str]]) -> list[str]:
    """Return unique shape names, prefixed with the mesh if ambiguous.

    Each of ``shapes`` is the name in the file, a default name, and the mesh's name.
    """
    used_names: dict[str, None] = {}
    for file_name, default_name, mesh in shapes:
        name = replace_unprintable(file_name) or default_name
        name = f"{mesh}_{name}" if name in used_names else name
        used_names[unused_name(name, used_names)] = None
    return list(used_names)
