"""Which nodes of a file are a character: of a file with several, each skeleton."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from animtool.core.arguments import argument
from animtool.core.errors import Fault, FormatError, Severity, counted, listed
from animtool.core.names import nearest
from animtool.core.record import dataclass
from animtool.formats.gltf.meshes import SkinEntry
from animtool.formats.gltf.nodes import Node, parents_first, roots

# The path that means the whole file.
WHOLE = "/"
MAX_NAMED = 8


class NodeTree(Protocol):
    """A file of nodes and skins."""

    @property
    def path(self) -> Path:
        """The file."""

    @property
    def nodes(self) -> tuple[Node, ...]:
        """In the order of the file."""

    @property
    def skins(self) -> tuple[SkinEntry, ...]:
        """Likewise."""

    @property
    def scenes(self) -> list[list[int]]:
        """Root nodes of each scene."""

    @property
    def default_scene(self) -> int:
        """The one that is shown; -1 where there is none."""


@dataclass(frozen=True, slots=True)
class Character:
    """A skeleton, or whatever else moves, of a file."""

    path: str  # such as ``/hero``; ``/`` is the whole file
    nodes: tuple[int, ...]  # all below its roots, parents first


def characters(file: NodeTree) -> tuple[Character, ...]:
    """Return the characters of a file: the whole of it, unless several are skinned.

    Trees of nodes belong together where a skin names joints of one for a mesh of
    another.
    """
    order, tree = parents_first(file.nodes), roots(file.nodes)
    group = {root: root for root in set(tree)}

    def found(root: int) -> int:
        while group[root] != root:
            group[root] = group[group[root]]
            root = group[root]
        return root

    def join(a: int, b: int) -> None:
        first, second = sorted((found(tree[a]), found(tree[b])))
        group[second] = first

    skinned: set[int] = set()
    for skin in file.skins:
        for joint in skin.joints[1:]:
            join(skin.joints[0], joint)
    for i, own in enumerate(file.nodes):
        if own.skin >= 0:
            join(i, file.skins[own.skin].joints[0])
    for skin in file.skins:
        skinned.update(skin.joints[:1])
    groups = sorted({found(tree[joint]) for joint in skinned})
    if len(groups) < 2:
        return (Character(WHOLE, tuple(order)),)
    members: dict[int, list[int]] = {root: [] for root in groups}
    for node in order:
        of = found(tree[node])
        if of in members:
            members[of].append(node)
    return tuple(
        Character(path, tuple(nodes))
        for path, nodes in zip(_paths(file, members), members.values(), strict=True)
    )


def _paths(file: NodeTree, members: dict[int, list[int]]) -> list[str]:
    """Return distinct paths of characters, after the roots of their joints."""
    from animtool.core.similar import distinct

    names = []
    joints = {joint for skin in file.skins for joint in skin.joints}
    for root, nodes in members.items():
        top = next((node for node in nodes if node in joints), root)
        while file.nodes[top].parent >= 0:
            top = file.nodes[top].parent
        names.append(file.nodes[top].name or f"node_{top}")
    return [f"/{name}" for name in distinct(names)]


def chosen(
    file: NodeTree,
    prim_path: str | None,
    unknown: str = "GLT014",
    several: str = "GLT109",
) -> tuple[Character, list[Fault]]:
    """Return the character to read, and a note of the others.

    Args:
        file: The file.
        prim_path: Its path or name, or the name of a node in it; ``/`` is the whole
            file. None is the first of the scene that is shown.
        unknown: Code of a character that the file has not.
        several: Code of the note.

    Raises:
        FormatError: Nothing is called so, or there are no nodes (`unknown`).
    """
    where = str(file.path)
    if not file.nodes:
        message = "the file has no nodes, so nothing moves"
        raise FormatError(Fault(unknown, message, where))
    found = characters(file)
    if prim_path is None:
        best = found[0]
        if len(found) > 1 and file.default_scene >= 0:
            shown = set(file.scenes[file.default_scene])
            best = next((one for one in found if shown & set(one.nodes)), best)
        return best, _others(found, best, where, several)
    if prim_path.strip() == WHOLE:
        return Character(WHOLE, tuple(parents_first(file.nodes))), []
    name = prim_path.strip("/")
    for one in found:
        if one.path.strip("/") == name and len(found) > 1:
            return one, []
    for one in found:
        if any(file.nodes[node].name == name for node in one.nodes):
            return one, []
    known = [one.path for one in found]
    message = f"unknown character or node {name!r}"
    raise FormatError(Fault(unknown, message, where, (), nearest(prim_path, known)))


def _others(
    found: tuple[Character, ...], best: Character, where: str, several: str
) -> list[Fault]:
    others = [one.path for one in found if one is not best]
    if not others:
        return []
    message = f"reading {best.path} of {counted(len(found), 'character')}: "
    message += f"others are {listed(others, MAX_NAMED)}"
    hint = f"choose one with {argument('source.prim_path')}; / is the whole file"
    return [Fault(several, message, where, (), hint, Severity.NOTE)]
