"""Which nodes of a glTF are a character: of a file with several, each skeleton."""

from __future__ import annotations

from animtool.core.arguments import argument
from animtool.core.errors import Fault, FormatError, Severity, counted, listed
from animtool.core.names import nearest
from animtool.core.record import dataclass
from animtool.formats.gltf.document import Gltf
from animtool.formats.gltf.nodes import parents_first

# The path that means the whole file.
WHOLE = "/"
MAX_NAMED = 8


@dataclass(frozen=True, slots=True)
class Character:
    """A skeleton, or whatever else moves, of a file."""

    path: str  # such as ``/hero``; ``/`` is the whole file
    nodes: tuple[int, ...]  # all below its roots, parents first


def characters(gltf: Gltf) -> tuple[Character, ...]:
    """Return the characters of a file: the whole of it, unless several are skinned.

    Trees of nodes belong together where a skin names joints of one for a mesh of
    another.
    """
    order = parents_first(gltf.nodes)
    tree = list(range(len(gltf.nodes)))  # the root of each node
    for node in order:
        parent = gltf.nodes[node].parent
        tree[node] = node if parent < 0 else tree[parent]
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
    for skin in gltf.skins:
        for joint in skin.joints[1:]:
            join(skin.joints[0], joint)
    for i, own in enumerate(gltf.nodes):
        if own.skin >= 0:
            join(i, gltf.skins[own.skin].joints[0])
    for skin in gltf.skins:
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
        for path, nodes in zip(_paths(gltf, members), members.values(), strict=True)
    )


def _paths(gltf: Gltf, members: dict[int, list[int]]) -> list[str]:
    """Return distinct paths of characters, after the roots of their joints."""
    from animtool.core.similar import distinct

    names = []
    joints = {joint for skin in gltf.skins for joint in skin.joints}
    for root, nodes in members.items():
        top = next((node for node in nodes if node in joints), root)
        while gltf.nodes[top].parent >= 0:
            top = gltf.nodes[top].parent
        names.append(gltf.nodes[top].name or f"node_{top}")
    return [f"/{name}" for name in distinct(names)]


def chosen(gltf: Gltf, prim_path: str | None) -> tuple[Character, list[Fault]]:
    """Return the character to read, and a note of the others.

    Args:
        gltf: The file.
        prim_path: Its path or name, or the name of a node in it; ``/`` is the whole
            file. None is the first of the scene that is shown.

    Raises:
        FormatError: Nothing is called so, or there are no nodes (GLT014).
    """
    where = str(gltf.path)
    if not gltf.nodes:
        message = "the file holds no nodes: there is nothing that moves"
        raise FormatError(Fault("GLT014", message, where))
    found = characters(gltf)
    if prim_path is None:
        best = found[0]
        if len(found) > 1 and gltf.default_scene >= 0:
            shown = set(gltf.scenes[gltf.default_scene])
            best = next((one for one in found if shown & set(one.nodes)), best)
        return best, _others(found, best, where)
    if prim_path.strip() == WHOLE:
        return Character(WHOLE, tuple(parents_first(gltf.nodes))), []
    name = prim_path.strip("/")
    for one in found:
        if one.path.strip("/") == name and len(found) > 1:
            return one, []
    for one in found:
        if any(gltf.nodes[node].name == name for node in one.nodes):
            return one, []
    known = [one.path for one in found]
    message = f"no character or node is called {name!r}"
    raise FormatError(Fault("GLT014", message, where, (), nearest(prim_path, known)))


def _others(found: tuple[Character, ...], best: Character, where: str) -> list[Fault]:
    others = [one.path for one in found if one is not best]
    if not others:
        return []
    message = f"{best.path} is read of {counted(len(found), 'character')}: "
    message += f"others are {listed(others, MAX_NAMED)}"
    hint = f"{argument('source.prim_path')} names one; / is the whole file"
    return [Fault("GLT109", message, where, (), hint, Severity.NOTE)]
