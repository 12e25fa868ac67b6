"""Finds the characters of a file, and chooses one of them."""

from __future__ import annotations

from animtool.core.arguments import argument
from animtool.core.errors import Fault, FormatError, Severity, counted, listed
from animtool.core.names import most_similar, name_hint, numbered_names
from animtool.core.record import dataclass
from animtool.formats.characters.nodes import (
    NodeTree,
    find_root_nodes,
    sort_parents_first,
)

# Path that selects all nodes of a file.
ROOT_PATH = "/"
MAX_LISTED_CHARACTERS = 8


@dataclass(frozen=True, slots=True)
class CharacterNodes:
    """The unique path of a character in its file, and the nodes that it has."""

    path: str  # such as ``/hero``; ``/`` is the complete file
    nodes: tuple[int, ...]  # nodes of the character, parents first


def find_characters(file: NodeTree) -> tuple[CharacterNodes, ...]:
    """Return the characters of a file: one for the file, or one per skeleton.

    Node trees belong to the same character if a skin of a mesh in one uses joints of
    the other.
    """
    nodes_parents_first, root_of_node = (
        sort_parents_first(file.nodes),
        find_root_nodes(file.nodes),
    )
    group_parents = {root: root for root in set(root_of_node)}

    def find_group(root: int) -> int:
        while group_parents[root] != root:
            group_parents[root] = group_parents[group_parents[root]]
            root = group_parents[root]
        return root

    def merge_groups(a: int, b: int) -> None:
        lower_root, upper_root = sorted(
            (find_group(root_of_node[a]), find_group(root_of_node[b]))
        )
        group_parents[upper_root] = lower_root

    for skin in file.skins:
        for joint in skin.joints[1:]:
            merge_groups(skin.joints[0], joint)
    for i, tree_node in enumerate(file.nodes):
        if tree_node.skin >= 0:
            merge_groups(i, file.skins[tree_node.skin].joints[0])
    first_joints = [joint for skin in file.skins for joint in skin.joints[:1]]
    groups = sorted({find_group(root_of_node[joint]) for joint in first_joints})
    if len(groups) < 2:
        return (CharacterNodes(ROOT_PATH, tuple(nodes_parents_first)),)
    nodes_by_group: dict[int, list[int]] = {root: [] for root in groups}
    for node in nodes_parents_first:
        node_group = find_group(root_of_node[node])
        if node_group in nodes_by_group:
            nodes_by_group[node_group].append(node)
    paths = _character_paths(file, nodes_by_group)
    return tuple(
        CharacterNodes(path, tuple(nodes))
        for path, nodes in zip(paths, nodes_by_group.values(), strict=True)
    )


def _character_paths(file: NodeTree, nodes_by_group: dict[int, list[int]]) -> list[str]:
    """Return a unique path for each character, from the name of its root node."""
    root_names = []
    joints = {joint for skin in file.skins for joint in skin.joints}
    for root, nodes in nodes_by_group.items():
        top_joint = next((node for node in nodes if node in joints), root)
        while file.nodes[top_joint].parent >= 0:
            top_joint = file.nodes[top_joint].parent
        root_names.append(file.nodes[top_joint].name or f"node_{top_joint}")
    return [f"/{name}" for name in numbered_names(root_names)]


def choose_character(
    file: NodeTree, prim_path: str | None, unknown_code: str, skipped_code: str
) -> tuple[CharacterNodes, list[Fault]]:
    """Return the character to read, and a note about the characters not read.

    Args:
        file: The file.
        prim_path: Path or name of the character, or the name of a node in it; ``/`` is
            the complete file. None is the first character of the default scene.
        unknown_code: Code of the error for an unknown character.
        skipped_code: Code of the note about characters that are not read.
    """
    path_text = str(file.path)
    if not file.nodes:
        message = "the file has no nodes, so nothing moves"
        raise FormatError(Fault(unknown_code, message, path_text))
    candidates = find_characters(file)
    if prim_path is None:
        character = candidates[0]
        if len(candidates) > 1 and file.default_scene >= 0:
            scene_roots = set(file.scenes[file.default_scene])
            scene_characters = (c for c in candidates if scene_roots & set(c.nodes))
            character = next(scene_characters, character)
        other_paths = [c.path for c in candidates if c is not character]
        if not other_paths:
            return character, []
        message = f"reading {character.path} of "
        message += f"{counted(len(candidates), 'character')}: others are "
        message += listed(other_paths, MAX_LISTED_CHARACTERS)
        hint = f"choose one with {argument('source.prim_path')}; / is the whole file"
        return character, [
            Fault(skipped_code, message, path_text, (), hint, Severity.NOTE)
        ]
    if prim_path.strip() == ROOT_PATH:
        return CharacterNodes(ROOT_PATH, tuple(sort_parents_first(file.nodes))), []
    name = prim_path.strip("/")
    for candidate in candidates:
        if candidate.path.strip("/") == name and len(candidates) > 1:
            return candidate, []
    for candidate in candidates:
        if any(file.nodes[node].name == name for node in candidate.nodes):
            return candidate, []
    option = argument("source.prim_path", prim_path)
    message = f"{option} names no character or node of the file"
    hint = _character_hint(file, prim_path, candidates)
    raise FormatError(Fault(unknown_code, message, path_text, (), hint))


def _character_hint(
    file: NodeTree, prim_path: str, candidates: tuple[CharacterNodes, ...]
) -> str:
    """Return a hint on what to write for an unknown character."""
    # The last name of a path, such as that of the prim in a USD file of the character.
    name = prim_path.strip("/").rpartition("/")[2]
    nodes = (file.nodes[node] for c in candidates for node in c.nodes)
    node_names = [node.name for node in nodes if node.name]
    node_name = name if name in node_names else most_similar(name, node_names)
    if len(candidates) == 1:
        if node_name:
            return f"did you mean {node_name!r}?"
        return f"the file has one character: leave out {argument('source.prim_path')}"
    paths = [candidate.path for candidate in candidates]
    best_path = most_similar(f"/{name}", paths)
    if best_path or node_name:
        return f"did you mean {(best_path or node_name)!r}?"
    return name_hint(prim_path, paths)
