"""Nodes and skins of a file, and the order and roots of its node tree."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass

# Scales that differ by less are the same: rounding of float32 [1].
SAME_SCALE = 3e-7


@dataclass(frozen=True, slots=True)
class Node:
    """One node.

    Attributes:
        name: As the file has it; None where it has none.
        parent: Index of the node above, -1 for a root.
        children: Indices of the nodes below.
        translation: In the frame of the parent [m].
        rotation: Likewise (x, y, z, w).
        scale: Likewise [1].
        mesh: Index; -1 for none.
        skin: Index; -1 for none.
        weights: Of the targets of its mesh; None leaves those of the mesh.
        visible: Whether it is shown, if all above it are.
        has_matrix: Whether its transform is a matrix in the file.
        above: Whether animtool put it above the roots of a rig, of which it is none.
    """

    name: str | None
    parent: int
    children: tuple[int, ...]
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float]
    scale: tuple[float, float, float]
    mesh: int = -1
    skin: int = -1
    weights: tuple[float, ...] | None = None
    visible: bool = True
    has_matrix: bool = False
    above: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class SkinEntry:
    """A skin."""

    name: str | None
    joints: tuple[int, ...]  # nodes
    skeleton: int  # a node; -1 where none is named
    inverse_bind: FloatArray  # ``(J, 4, 4)``, of column vectors
    where: str


class NodeTree(Protocol):
    """A file with nodes and skins."""

    @property
    def path(self) -> Path:
        """Path of the file."""

    @property
    def nodes(self) -> tuple[Node, ...]:
        """Nodes in file order."""

    @property
    def skins(self) -> tuple[SkinEntry, ...]:
        """Skins in file order."""

    @property
    def scenes(self) -> list[list[int]]:
        """Root nodes of each scene."""

    @property
    def default_scene(self) -> int:
        """Index of the default scene; -1 if there is none."""


def roots(nodes: tuple[Node, ...]) -> list[int]:
    """Return the root node above each node; a root maps to itself."""
    tree = list(range(len(nodes)))
    for node in parents_first(nodes):
        parent = nodes[node].parent
        tree[node] = node if parent < 0 else tree[parent]
    return tree


def parents_first(nodes: tuple[Node, ...]) -> list[int]:
    """Return all node indices depth-first, parents before children."""
    order: list[int] = []
    stack = [i for i in range(len(nodes) - 1, -1, -1) if nodes[i].parent < 0]
    while stack:
        at = stack.pop()
        order.append(at)
        stack.extend(reversed(nodes[at].children))
    return order
