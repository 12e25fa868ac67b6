"""Characters of a file: one per skeleton, if a file has several."""

from __future__ import annotations

from animtool.core.arguments import argument
from animtool.core.errors import Fault, FormatError, Severity, counted, listed
from animtool.core.names import nearest
from animtool.core.record import dataclass
from animtool.formats.characters.nodes import NodeTree, parents_first, root_nodes

# The path that means the whole file.
FILE_PATH = "/"
MAX_LISTED_CHARACTERS = 8


@dataclass(frozen=True, slots=True)
class CharacterNodes:
    """The nodes of a skeleton, or of everything else that moves."""

    path: str  # such as ``/hero``; ``/`` is the complete file
    nodes: tuple[int, ...]  # its nodes, parents first


def characters(file: NodeTree) -> tuple[CharacterNodes, ...]:
    """Return the characters of a file: one for the file, or one per skeleton.

    Node trees belong to the same character if a skin of a mesh in one uses joints of
    the other.
    """
    order, tree = parents_first(file.nodes), root_nodes(file.nodes)
    group = {root: root for root in set(tree)}

    def group_of(root: int) -> int:
        while group[root] != root:
            group[root] = group[group[root]]
            root = group[root]
        return root

    def join(a: int, b: int) -> None:
        lower, upper = sorted((group_of(tree[a]), group_of(tree[b])))
        group[upper] = lower

    skin_nodes: set[int] = set()
    for skin in file.skins:
        for joint in skin.joints[1:]:
            join(skin.joints[0], joint)
    for i, node_ in enumerate(file.nodes):
        if node_.skin >= 0:
            join(i, file.skins[node_.skin].joints[0])
    for skin in file.skins:
        skin_nodes.update(skin.joints[:1])
    groups = sorted({group_of(tree[joint]) for joint in skin_nodes})
    if len(groups) < 2:
        return (CharacterNodes(FILE_PATH, tuple(order)),)
    members: dict[int, list[int]] = {root: [] for root in groups}
    for node in order:
        of = group_of(tree[node])
        if of in members:
            members[of].append(node)
    return tuple(
        CharacterNodes(path, tuple(nodes))
        for path, nodes in zip(
            _character_paths(file, members), members.values(), strict=True
        )
    )


def _character_paths(file: NodeTree, members: dict[int, list[int]]) -> list[str]:
    """Return distinct paths of characters, from the names of their root joints."""
    from animtool.core.names import numbered_names

    names = []
    joints = {joint for skin in file.skins for joint in skin.joints}
    for root, nodes in members.items():
        top_joint = next((node for node in nodes if node in joints), root)
        while file.nodes[top_joint].parent >= 0:
            top_joint = file.nodes[top_joint].parent
        names.append(file.nodes[top_joint].name or f"node_{top_joint}")
    return [f"/{name}" for name in numbered_names(names)]


def choose_character(
    file: NodeTree,
    prim_path: str | None,
    unknown: str,
    several: str,
) -> tuple[CharacterNodes, list[Fault]]:
    """Return the character to read, and a note about the others.

    Args:
        file: The file.
        prim_path: Path or name of the character, or the name of a node in it; ``/`` is
            the complete file. None is the first character of the default scene.
        unknown: Code of the error for an unknown character.
        several: Code of the note about other characters.
    """
    where = str(file.path)
    if not file.nodes:
        message = "the file has no nodes, so nothing moves"
        raise FormatError(Fault(unknown, message, where))
    candidates = characters(file)
    if prim_path is None:
        best_candidate = candidates[0]
        if len(candidates) > 1 and file.default_scene >= 0:
            scene_roots = set(file.scenes[file.default_scene])
            best_candidate = next(
                (
                    candidate
                    for candidate in candidates
                    if scene_roots & set(candidate.nodes)
                ),
                best_candidate,
            )
        return best_candidate, _others_note(candidates, best_candidate, where, several)
    if prim_path.strip() == FILE_PATH:
        return CharacterNodes(FILE_PATH, tuple(parents_first(file.nodes))), []
    name = prim_path.strip("/")
    for candidate in candidates:
        if candidate.path.strip("/") == name and len(candidates) > 1:
            return candidate, []
    for candidate in candidates:
        if any(file.nodes[node].name == name for node in candidate.nodes):
            return candidate, []
    paths = [candidate.path for candidate in candidates]
    message = f"unknown character or node {name!r}"
    raise FormatError(Fault(unknown, message, where, (), nearest(prim_path, paths)))


def _others_note(
    candidates: tuple[CharacterNodes, ...],
    best: CharacterNodes,
    where: str,
    several: str,
) -> list[Fault]:
    other_paths = [candidate.path for candidate in candidates if candidate is not best]
    if not other_paths:
        return []
    message = f"reading {best.path} of {counted(len(candidates), 'character')}: "
    message += f"others are {listed(other_paths, MAX_LISTED_CHARACTERS)}"
    hint = f"choose one with {argument('source.prim_path')}; / is the whole file"
    return [Fault(several, message, where, (), hint, Severity.NOTE)]
