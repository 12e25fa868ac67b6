"""Meshes and strands of a rig, prepared for deformation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, FormatError
from animtool.core.record import dataclass
from animtool.rig.surfaces import Strands, Surface, SurfaceShape
from animtool.skin.deform import DeformedMesh
from animtool.skin.shapes import prepare_shapes
from animtool.skin.skinning import Binding, SkinMethod, prepare_skin


@dataclass(frozen=True, slots=True, eq=False)
class CharacterMesh:
    """A mesh or strands of a rig, with the rig's blend shapes that deform it."""

    name: str  # name in the rig
    mesh: DeformedMesh  # prepared mesh, in [m]
    # Column of each mesh shape in the weights of the rig's shapes ``(S,)``; -1 if
    # its weight is always 0.
    shape_columns: IntArray

    def weights(self, rig_weights: FloatArray | None) -> FloatArray | None:
        """Return the weights of the mesh's shapes ``(F, S)``; None if all are 0.

        Args:
            rig_weights: Weights of the rig's shapes, in rig order ``(F, shapes)`` [1].
        """
        if rig_weights is None or not (self.shape_columns >= 0).any():
            return None
        mesh_weights = rig_weights[:, self.shape_columns]
        mesh_weights[:, self.shape_columns < 0] = 0.0
        return mesh_weights


def character_meshes(
    surfaces: Sequence[Surface],
    joints: Sequence[str],
    bind: FloatArray,
    shapes: Sequence[str],
) -> list[CharacterMesh]:
    """Return meshes prepared for deformation by joints and shape weights.

    Args:
        surfaces: The meshes.
        joints: Names of the J joints of the skeleton.
        bind: World transforms of the joints at bind time ``(J, 4, 4)`` [m].
        shapes: Names of the weighted shapes.
    """
    joint_indices = {name: i for i, name in enumerate(joints)}
    column_of_shape = {name: i for i, name in enumerate(shapes)}
    meshes: list[CharacterMesh] = []
    faults: list[Fault] = []
    for surface in surfaces:
        columns = [
            _shape_column(surface, shape, column_of_shape) for shape in surface.shapes
        ]
        with _collect_faults(faults, f"mesh {surface.name!r}"):
            mesh = _prepare_mesh(surface, joint_indices, bind)
            meshes.append(
                CharacterMesh(surface.name, mesh, np.array(columns, np.int64))
            )
    if faults:
        raise FormatError(faults)
    return meshes


def character_strands(
    strands: Sequence[Strands], joints: Sequence[str], bind: FloatArray
) -> list[CharacterMesh]:
    """Return strands prepared to move rigidly with their joint.

    Args:
        strands: ``(S, K, 3)`` points each, flattened to one row of vertices.
        joints: Names of the J joints of the skeleton.
        bind: World transforms of the joints at bind time ``(J, 4, 4)`` [m].
    """
    meshes: list[CharacterMesh] = []
    faults: list[Fault] = []
    no_shapes = np.zeros(0, np.int64)
    for strand_set in strands:
        points = strand_set.points.reshape(-1, 3)
        carrier_joint = np.array([joints.index(strand_set.joint)])
        binding = Binding([[0]], [[1.0]], bind, carrier_joint)
        with _collect_faults(faults, f"strands {strand_set.name!r}"):
            skin = prepare_skin(binding, len(points))
            mesh = DeformedMesh(np.ascontiguousarray(points), skin=skin)
            meshes.append(CharacterMesh(strand_set.name, mesh, no_shapes))
    if faults:
        raise FormatError(faults)
    return meshes


@contextmanager
def _collect_faults(faults: list[Fault], label: str) -> Iterator[None]:
    """Collect format errors raised in the context, with a label before each message."""
    try:
        yield
    except FormatError as error:
        faults += [
            replace(fault, message=f"{label}: {fault.message}")
            for fault in error.faults
        ]


def _shape_column(
    surface: Surface, shape: SurfaceShape, column_of_shape: dict[str, int]
) -> int:
    """Return the column of a shape, whose name may start with that of its mesh."""
    short_name = shape.name.removeprefix(f"{surface.name}_")
    return column_of_shape.get(shape.name, column_of_shape.get(short_name, -1))


def _prepare_mesh(
    surface: Surface, joint_indices: dict[str, int], bind: FloatArray
) -> DeformedMesh:
    """Return a surface prepared for deformation, with its shapes and skin."""
    shapes = skin = None
    if surface.shapes:
        shapes = prepare_shapes(surface.shapes, surface.points, surface.normals)
    if surface.skin is not None:
        binding = Binding(
            surface.skin.indices,
            surface.skin.weights,
            bind,
            np.array([joint_indices[name] for name in surface.skin.joints], np.int64),
            surface.geom_bind,
            SkinMethod(surface.skin.method),
        )
        skin = prepare_skin(binding, len(surface.points))
    return DeformedMesh(surface.points, shapes, skin, surface.normals)
