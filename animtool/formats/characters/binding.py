"""One bind pose of the joints that fits all skins of a file.

A file has an inverse bind matrix for each joint of each skin; a rig has one bind pose,
and for each mesh a transform of its points. With ``B`` the matrix that a joint of a
skin applies, ``bind = geom_bind · B⁻¹``: the part common to the joints of a skin goes
to the mesh, the remainder to the joints. If skins disagree about a joint, a static
helper joint below it carries the mesh. glTF does not store the position of a mesh at
bind time; formats that do keep it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, Severity
from animtool.core.names import numbered_names
from animtool.formats.characters.nodes import NodeTree
from animtool.maths import so3
from animtool.rig.kinematics import rest_world
from animtool.rig.parts import Mesh, Shape
from animtool.rig.skeleton import Joint, Pose, Rig

# Matrices agree within this, relative to the size of the character [1].
AGREE_TOLERANCE = 1e-5
# Tolerance for rigid bind transforms; smaller deviations are rounding [1].
RIGID_TOLERANCE = 1e-3
# A bind pose this close to rest equals rest, up to float32 rounding [1], [rad].
REST_TOLERANCE = 3e-7


class Binder:
    """Collects joint bind transforms from skins."""

    def __init__(
        self,
        file: NodeTree,
        rig: Rig,
        joints: IntArray,
        folded_scales: FloatArray,
        scales: FloatArray,
        worlds: Sequence[FloatArray] = (),
    ) -> None:
        """Take a rig without meshes, and the other fields of `GltfRig`.

        ``worlds`` are the world transforms of each skin's mesh at bind time ``(4, 4)``.
        """
        self.file, self.worlds = file, worlds
        self.joints, self.folded_scales, self.scales = joints, folded_scales, scales
        self.notices: list[Fault] = []
        self._rig = rig
        self._bind: dict[int, FloatArray] = {}  # by joint, in file units
        self._helpers: list[tuple[int, FloatArray]] = []
        self._skins: dict[int, tuple[FloatArray, list[int]]] = {}

    def skin(self, index: int) -> tuple[FloatArray, list[int]]:
        """Return the point transform of a skin, and joint indices for its joints."""
        if index not in self._skins:
            skin = self.file.skins[index]
            nodes = np.array(skin.joints)
            joints = self.joints[nodes]
            matrices = skin.inverse_bind.copy()
            matrices[:, :3] *= self.folded_scales[nodes][:, None, None]
            mesh_world = self.worlds[index] if self.worlds else None
            bound = self._bound(matrices, joints.tolist(), skin.where, mesh_world)
            self._skins[index] = bound
        return self._skins[index]

    def node(self, node: int) -> tuple[FloatArray, int]:
        """Return the point transform of a mesh attached to a node."""
        matrix = np.eye(4)
        matrix[:3] *= self.folded_scales[node]
        geometry, joints = self._bound(matrix[None], [int(self.joints[node])], "")
        return geometry, joints[0]

    def _bound(
        self,
        matrices: FloatArray,
        joints: list[int],
        where: str,
        mesh_world: FloatArray | None = None,
    ) -> tuple[FloatArray, list[int]]:
        """Return ``geom_bind`` of a skin, and joints whose binds agree."""
        sizes = np.abs(matrices[:, :3, :3]).max(axis=(1, 2), initial=1e-300)
        singular = (
            np.abs(np.linalg.det(matrices[:, :3, :3] / sizes[:, None, None])) < 1e-12
        )
        if singular.any():
            if where:
                message = (
                    f"{int(singular.sum())} inverse bind matrices are singular: using "
                    "the identity"
                )
                path = str(self.file.path)
                at = f"{where}/inverseBindMatrices"
                note = Fault("GLT114", message, path, where=at, severity=Severity.NOTE)
                self.notices.append(note)
            matrices = np.where(singular[:, None, None], np.eye(4), matrices)
        bind_matrices = np.asarray(np.linalg.inv(matrices), np.float64)
        if mesh_world is None:
            geometry = self._geometry(bind_matrices)
        else:
            geometry = self._geometry(mesh_world @ bind_matrices) @ mesh_world
        binds = geometry @ bind_matrices
        common = [k for k, joint in enumerate(joints) if joint in self._bind]
        if common:
            # Aligned with the previous skin at their first common joint.
            first = common[0]
            step = self._bind[joints[first]] @ np.linalg.inv(binds[first])
            geometry, binds = step @ geometry, step @ binds
        bound_joints = []
        for joint, bind in zip(joints, binds, strict=True):
            joint_bind = self._bind.setdefault(joint, bind)
            size = max(1e-300, float(np.abs(joint_bind).max()))
            if np.abs(joint_bind - bind).max() <= AGREE_TOLERANCE * size:
                bound_joints.append(joint)
                continue
            self._helpers.append((joint, bind))
            bound_joints.append(len(self._rig.joints) + len(self._helpers) - 1)
        return geometry, bound_joints

    def _geometry(self, bind_matrices: FloatArray) -> FloatArray:
        """Return the transform that makes a skin's binds rigid, if one does."""
        linear = bind_matrices[:, :3, :3]
        squares = linear @ linear.swapaxes(1, 2)
        size = float(np.abs(squares).max())
        geometry = np.eye(4)
        spread = np.abs(squares - squares[0]).max() / size
        if (
            spread <= RIGID_TOLERANCE
            and np.abs(squares[0] - np.eye(3)).max() > RIGID_TOLERANCE
        ):
            values, vectors = np.linalg.eigh(squares[0])
            if values.min() > 1e-12 * values.max():
                geometry[:3, :3] = vectors @ np.diag(values**-0.5) @ vectors.T
        return geometry

    def nodes(self, nodes: IntArray) -> IntArray:
        """Return the node of each joint, -1 for helper joints that carry meshes."""
        return np.concatenate([nodes, np.full(len(self._helpers), -1, np.int64)])

    def names(self) -> list[str]:
        """Return joint names, helper joints last."""
        names = self._rig.names
        carriers = [f"{names[carrier]}_bind" for carrier, _ in self._helpers]
        return numbered_names([*names, *carriers])

    def rig(self, meshes: tuple[Mesh, ...], shapes: tuple[Shape, ...]) -> Rig:
        """Return the rig with bind pose, meshes and shapes."""
        rig, names = self._rig, self.names()
        joints = list(rig.joints)
        for name, (carrier, _) in zip(names[len(joints) :], self._helpers, strict=True):
            joints.append(Joint(name, carrier))
        rig = replace(rig, joints=tuple(joints))
        binds = dict(self._bind)
        binds |= {
            len(self._rig.joints) + i: b for i, (_, b) in enumerate(self._helpers)
        }
        bind = _poses(rig, binds)
        return replace(rig, bind=bind, meshes=meshes, shapes=shapes)


def _poses(rig: Rig, bind_worlds: dict[int, FloatArray]) -> dict[str, Pose]:
    """Return bind poses that differ from rest, from world transforms."""
    if not bind_worlds:
        return {}
    count, parents = len(rig.joints), rig.parents
    rest = np.tile(np.eye(4), (count, 1, 1))
    rest[:, :3, :3] = so3.to_matrix(rig.rest_rotations)
    rest[:, :3, 3] = rig.rest_translations
    joints = np.array(sorted(bind_worlds))
    bind = np.array([bind_worlds[j] for j in joints.tolist()])
    rigid = bind.copy()
    rigid[:, :3, :3] = so3.to_matrix(so3.split_scale(bind[:, :3, :3])[0])
    rigid[:, :3, 3] *= rig.meters_per_unit
    stretches = np.tile(np.eye(3), (count, 1, 1))
    stretches[joints] = rigid[:, :3, :3].swapaxes(1, 2) @ bind[:, :3, :3]
    world = np.zeros((count, 4, 4))
    world[joints] = rigid
    for j in range(count):
        if j not in bind_worlds:
            # Joints in no skin keep their rest transform relative to their parent.
            parent = parents[j]
            world[j] = rest[j] if parent < 0 else world[parent] @ rest[j]
    upper = np.where((parents < 0)[:, None, None], np.eye(4), world[parents])
    inverse_rotations = upper[:, :3, :3].swapaxes(1, 2)
    positions = (inverse_rotations @ (world[:, :3, 3] - upper[:, :3, 3])[:, :, None])[
        :, :, 0
    ]
    rotations = so3.from_matrix(inverse_rotations @ world[:, :3, :3])
    size = float(np.abs(rest_world(rig).positions).max(initial=0.0)) or 1.0
    is_moved = (
        np.abs(positions - rig.rest_translations).max(axis=1) > REST_TOLERANCE * size
    )
    is_moved |= so3.angle_between(rotations, rig.rest_rotations) > REST_TOLERANCE
    is_stretched = np.abs(stretches - np.eye(3)).max(axis=(1, 2)) > 1e-12
    poses: dict[str, Pose] = {}
    for j in np.flatnonzero(is_moved | is_stretched).tolist():
        joint = rig.joints[j]
        (x, y, z), (a, b, c, w) = joint.translation, joint.rotation
        if is_moved[j]:
            x, y, z = positions[j].tolist()
            a, b, c, w = rotations[j].tolist()
        stretch = tuple(stretches[j].ravel().tolist()) if is_stretched[j] else None
        poses[rig.names[j]] = Pose((x, y, z), (a, b, c, w), stretch)
    return poses
