"""Nodes and skins of a glTF or FBX file, and the order and roots of its node tree."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass

# Tolerance of equal scales, for float32 rounding [1].
SCALE_TOLERANCE = 3e-7
# Translation, rotation and scale of a node that does not move its children.
NO_TRANSFORM = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), (1.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True)
class Node:
    """A node of a glTF or FBX file, with its rest transform."""

    name: str | None  # name in the file; None if it has no name
    parent: int  # index of the parent node; -1 for a root
    children: tuple[int, ...]  # indices of the child nodes
    translation: tuple[float, float, float]  # relative to the parent [m]
    rotation: tuple[float, float, float, float]  # relative to the parent (x, y, z, w)
    scale: tuple[float, float, float]  # relative to the parent [1]
    mesh: int = -1  # index of the node's mesh; -1 if it has no mesh
    skin: int = -1  # index of the node's skin; -1 if it has no skin
    # Weights of the morph targets; None uses the weights of the mesh.
    weights: tuple[float, ...] | None = None
    # Whether the node is visible if all its ancestors are.
    is_visible: bool = True
    has_matrix: bool = False  # whether the file stores its transform as a matrix
    # Whether animtool inserted it above the roots of a rig, outside the rig.
    is_inserted: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class FileSkin:
    """A skin of a glTF or FBX file: its joints and inverse bind matrices."""

    name: str | None
    joints: tuple[int, ...]  # node indices
    skeleton: int  # index of the root node; -1 if not stated
    inverse_bind: FloatArray  # ``(J, 4, 4)``, for column vectors
    location: str  # of the skin in the file


class NodeTree(Protocol):
    """A glTF or FBX file as nodes, skins and scenes."""

    @property
    def path(self) -> Path:
        """Path of the file."""

    @property
    def nodes(self) -> tuple[Node, ...]:
        """Nodes in file order."""

    @property
    def skins(self) -> tuple[FileSkin, ...]:
        """Skins in file order."""

    @property
    def scenes(self) -> list[list[int]]:
        """Root nodes of each scene."""

    @property
    def default_scene(self) -> int:
        """Index of the default scene; -1 if there is none."""


def is_uniform_scale(scales: FloatArray) -> BoolArray:
    """Return whether scales ``(N, 3)`` are positive and equal on all axes ``(N,)``."""
    smallest, largest = scales.min(axis=1), scales.max(axis=1)
    is_equal = largest - smallest <= SCALE_TOLERANCE * np.abs(largest)
    return np.asarray((smallest > 0) & is_equal)


def find_root_nodes(nodes: tuple[Node, ...]) -> list[int]:
    """Return the index of each node's root; a root is its own root."""
    roots = list(range(len(nodes)))
    for node in sort_parents_first(nodes):
        parent = nodes[node].parent
        roots[node] = node if parent < 0 else roots[parent]
    return roots


def sort_parents_first(nodes: tuple[Node, ...]) -> list[int]:
    """Return all node indices depth-first, parents before children."""
    order: list[int] = []
    stack = [i for i in range(len(nodes) - 1, -1, -1) if nodes[i].parent < 0]
    while stack:
        node = stack.pop()
        order.append(node)
        stack.extend(reversed(nodes[node].children))
    return order
