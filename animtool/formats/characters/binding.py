"""Computes one bind pose of the joints for all skins of a file.

A file has an inverse bind matrix for each joint of each skin; a rig has one bind pose,
and a transform of the points of each mesh. With the inverse bind matrix ``B`` of a
joint, ``bind = geom_bind · B⁻¹``: a transform common to all joints of a skin becomes
that of the mesh. If skins disagree about a joint, a static helper joint below it
deforms the mesh. glTF does not store the transform of a mesh at bind time; other
formats pass it as ``mesh_worlds``.
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
from animtool.rig.parts import LoadedArray, Mesh, Shape, Skin
from animtool.rig.skeleton import Joint, Pose, Rig

# Tolerance of equal bind matrices, relative to their largest number [1].
BIND_TOLERANCE = 1e-5
# Tolerance for rigid bind transforms; smaller deviations are rounding [1].
RIGID_TOLERANCE = 1e-3
# Tolerance of a bind pose equal to rest, for float32 rounding [1], [rad].
REST_TOLERANCE = 3e-7


class SkinBinder:
    """Computes a bind pose that the skins of a file share, skin by skin."""

    def __init__(
        self,
        file: NodeTree,
        rig: Rig,
        joints: IntArray,
        baked_scales: FloatArray,
        mesh_worlds: Sequence[FloatArray] = (),
    ) -> None:
        """Start with a rig without meshes, and the node data of its joints.

        ``mesh_worlds`` are the world transforms ``(4, 4)`` of each skin's mesh at bind
        time.
        """
        self.file, self.mesh_worlds = file, mesh_worlds
        self.joints, self.baked_scales = joints, baked_scales
        self.notices: list[Fault] = []
        self._rig = rig
        self._bind_worlds: dict[int, FloatArray] = {}  # by joint, in file units
        self._helper_joints: list[tuple[int, FloatArray]] = []
        self._skins: dict[int, tuple[FloatArray, list[int]]] = {}

    def bind_skin(self, index: int) -> tuple[FloatArray, list[int]]:
        """Return the ``geom_bind`` of a skin's mesh, and the rig joints of the skin."""
        if index not in self._skins:
            skin = self.file.skins[index]
            nodes = np.array(skin.joints)
            joints = self.joints[nodes]
            matrices = skin.inverse_bind.copy()
            matrices[:, :3] *= self.baked_scales[nodes][:, None, None]
            mesh_world = self.mesh_worlds[index] if self.mesh_worlds else None
            self._skins[index] = self._bind_joints(
                matrices, joints.tolist(), skin.location, mesh_world
            )
        return self._skins[index]

    def bind_node(self, node: int, point_count: int) -> tuple[Skin, FloatArray]:
        """Return the skin of a mesh that follows a node, and its ``geom_bind``."""
        matrix = np.eye(4)
        matrix[:3] *= self.baked_scales[node]
        geom_bind, joints = self._bind_joints(
            matrix[None], [int(self.joints[node])], ""
        )
        indices, weights = np.zeros((point_count, 1)), np.ones((point_count, 1))
        return self.build_skin("linear", joints, indices, weights), geom_bind

    def build_skin(
        self,
        method: str,
        joints: list[int],
        indices: FloatArray | IntArray,
        weights: FloatArray,
    ) -> Skin:
        """Return a skin of rig joints, with point weights ``(V, I)``."""
        names = self.joint_names()
        return Skin(
            method,
            tuple(names[joint] for joint in joints),
            LoadedArray(indices.astype(np.float64)),
            LoadedArray(weights),
        )

    def _bind_joints(
        self,
        matrices: FloatArray,
        joints: list[int],
        location: str,
        mesh_world: FloatArray | None = None,
    ) -> tuple[FloatArray, list[int]]:
        """Return the ``geom_bind`` of a skin, and rig joints with its transforms."""
        matrix_sizes = np.abs(matrices[:, :3, :3]).max(axis=(1, 2), initial=1e-300)
        determinants = np.linalg.det(matrices[:, :3, :3] / matrix_sizes[:, None, None])
        is_singular = np.abs(determinants) < 1e-12
        if is_singular.any():
            if location:
                message = f"{int(is_singular.sum())} inverse bind matrices are "
                message += "singular: using the identity"
                path, note = str(self.file.path), Severity.NOTE
                location = f"{location}/inverseBindMatrices"
                fault = Fault("GLT114", message, path, severity=note, where=location)
                self.notices.append(fault)
            matrices = np.where(is_singular[:, None, None], np.eye(4), matrices)
        bind_matrices = np.asarray(np.linalg.inv(matrices), np.float64)
        if mesh_world is None:
            geom_bind = self._rigid_geom_bind(bind_matrices)
        else:
            geom_bind = self._rigid_geom_bind(mesh_world @ bind_matrices) @ mesh_world
        joint_binds = geom_bind @ bind_matrices
        common_index = next(
            (k for k, joint in enumerate(joints) if joint in self._bind_worlds), None
        )
        if common_index is not None:
            # Align with the previous skins at the first common joint.
            alignment = self._bind_worlds[joints[common_index]] @ np.linalg.inv(
                joint_binds[common_index]
            )
            geom_bind, joint_binds = alignment @ geom_bind, alignment @ joint_binds
        bound_joints = []
        for joint, bind in zip(joints, joint_binds, strict=True):
            joint_bind = self._bind_worlds.setdefault(joint, bind)
            max_magnitude = max(1e-300, float(np.abs(joint_bind).max()))
            if np.abs(joint_bind - bind).max() <= BIND_TOLERANCE * max_magnitude:
                bound_joints.append(joint)
                continue
            self._helper_joints.append((joint, bind))
            bound_joints.append(len(self._rig.joints) + len(self._helper_joints) - 1)
        return geom_bind, bound_joints

    def _rigid_geom_bind(self, bind_matrices: FloatArray) -> FloatArray:
        """Return the mesh transform that makes all binds rigid, else the identity."""
        linear = bind_matrices[:, :3, :3]
        squared_linear = linear @ linear.swapaxes(1, 2)
        max_magnitude = float(np.abs(squared_linear).max())
        geom_bind = np.eye(4)
        deviation = np.abs(squared_linear - squared_linear[0]).max() / max_magnitude
        is_rigid = np.abs(squared_linear[0] - np.eye(3)).max() <= RIGID_TOLERANCE
        if deviation <= RIGID_TOLERANCE and not is_rigid:
            eigenvalues, eigenvectors = np.linalg.eigh(squared_linear[0])
            if eigenvalues.min() > 1e-12 * eigenvalues.max():
                geom_bind[:3, :3] = (
                    eigenvectors @ np.diag(eigenvalues**-0.5) @ eigenvectors.T
                )
        return geom_bind

    def joint_names(self) -> list[str]:
        """Return unique names of the rig's joints, those of helper joints last."""
        names = self._rig.names
        helper_names = [f"{names[parent]}_bind" for parent, _ in self._helper_joints]
        return numbered_names([*names, *helper_names])

    def build_rig(self, meshes: tuple[Mesh, ...], shapes: tuple[Shape, ...]) -> Rig:
        """Return the rig with bind pose, meshes and shapes."""
        rig, names = self._rig, self.joint_names()
        named_helpers = zip(names[len(rig.joints) :], self._helper_joints, strict=True)
        helper_joints = [Joint(name, parent) for name, (parent, _) in named_helpers]
        rig = replace(rig, joints=(*rig.joints, *helper_joints))
        helpers = enumerate(self._helper_joints, len(self._rig.joints))
        bind_worlds = self._bind_worlds | {
            j: bind_world for j, (_, bind_world) in helpers
        }
        bind = _bind_poses(rig, bind_worlds)
        return replace(rig, bind=bind, meshes=meshes, shapes=shapes)


def _bind_poses(rig: Rig, bind_worlds: dict[int, FloatArray]) -> dict[str, Pose]:
    """Return bind poses that differ from rest, computed from world bind transforms."""
    if not bind_worlds:
        return {}
    joint_count, parents = len(rig.joints), rig.parents
    rest = np.tile(np.eye(4), (joint_count, 1, 1))
    rest[:, :3, :3] = so3.to_matrix(rig.rest_rotations)
    rest[:, :3, 3] = rig.rest_translations
    joints = np.array(sorted(bind_worlds))
    bind = np.array([bind_worlds[j] for j in joints.tolist()])
    rigid_binds = bind.copy()
    rigid_binds[:, :3, :3] = so3.to_matrix(so3.split_scale(bind[:, :3, :3])[0])
    rigid_binds[:, :3, 3] *= rig.meters_per_unit
    stretches = np.tile(np.eye(3), (joint_count, 1, 1))
    stretches[joints] = rigid_binds[:, :3, :3].swapaxes(1, 2) @ bind[:, :3, :3]
    world = np.zeros((joint_count, 4, 4))
    world[joints] = rigid_binds
    for j in range(joint_count):
        if j not in bind_worlds:
            # Joints in no skin keep their rest transform relative to their parent.
            parent = parents[j]
            world[j] = rest[j] if parent < 0 else world[parent] @ rest[j]
    parent_worlds = np.where((parents < 0)[:, None, None], np.eye(4), world[parents])
    inverse_rotations = parent_worlds[:, :3, :3].swapaxes(1, 2)
    offsets = world[:, :3, 3] - parent_worlds[:, :3, 3]
    positions = (inverse_rotations @ offsets[:, :, None])[:, :, 0]
    rotations = so3.from_matrix(inverse_rotations @ world[:, :3, :3])
    extent = float(np.abs(rest_world(rig).positions).max(initial=0.0)) or 1.0
    distances = np.abs(positions - rig.rest_translations).max(axis=1)
    is_off_rest = distances > REST_TOLERANCE * extent
    is_off_rest |= so3.angle_between(rotations, rig.rest_rotations) > REST_TOLERANCE
    is_stretched = np.abs(stretches - np.eye(3)).max(axis=(1, 2)) > 1e-12
    poses: dict[str, Pose] = {}
    for j in np.flatnonzero(is_off_rest | is_stretched).tolist():
        joint = rig.joints[j]
        (x, y, z), (a, b, c, w) = joint.translation, joint.rotation
        if is_off_rest[j]:
            x, y, z = positions[j].tolist()
            a, b, c, w = rotations[j].tolist()
        stretch = tuple(stretches[j].ravel().tolist()) if is_stretched[j] else None
        poses[rig.names[j]] = Pose((x, y, z), (a, b, c, w), stretch)
    return poses
