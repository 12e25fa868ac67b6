"""Skinning over frames: linear blend and dual quaternions, as in UsdSkel.

Matrices multiply column vectors. Points are in skeleton space: the rig's world.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from animtool import _kernels
from animtool.core.array_types import (
    ArrayLike,
    FloatArray,
    IntArray,
    as_floats,
    output_array,
)
from animtool.core.errors import Fault, FormatError, listed
from animtool.core.record import dataclass
from animtool.rig.kinematics import WorldTransforms
from animtool.skin.influences import Influences, read_influences

# A bind matrix is singular if the determinant of its linear part, relative to the cube
# of its largest element, is smaller than this.
SINGULAR_DETERMINANT = 1e-12

# Stretches closer to identity are rounding and ignored, as in UsdSkel.
STRETCH_TOLERANCE = 1e-6


class SkinMethod(StrEnum):
    """Method of blending joint transforms."""

    LINEAR = "linear"
    DUAL_QUATERNION = "dual_quaternion"


@dataclass(frozen=True, slots=True)
class Binding:
    """The binding of a mesh to joints, as stored in files."""

    # Joint indices ``(V, I)``, or ``(1, I)`` for all vertices.
    indices: ArrayLike
    weights: ArrayLike  # same shape as the indices [1]
    # World transforms of the skeleton's J joints at bind time ``(J, 4, 4)``.
    bind: ArrayLike
    # Skeleton joint of each index ``(U,)``; None if indices are skeleton joints.
    joints: ArrayLike | None = None
    # World transform of the points at bind time ``(4, 4)``; None is identity.
    geom_bind: ArrayLike | None = None
    method: SkinMethod = SkinMethod.LINEAR  # linear blend or dual quaternions


@dataclass(frozen=True, slots=True)
class PreparedSkin:
    """A binding prepared for evaluation."""

    method: SkinMethod  # linear blend or dual quaternions
    influences: Influences  # per vertex; joint indices refer to ``joints``
    joints: IntArray  # skeleton joints that the mesh uses ``(U,)``
    # Inverse bind transforms of the used joints ``(U, 4, 4)``.
    joint_from_world: FloatArray
    world_from_points: FloatArray  # transform of the points at bind time ``(4, 4)``

    @property
    def vertex_count(self) -> int:
        """Number of vertices that the skin was prepared for."""
        return self.influences.vertex_count


def prepare_skin(binding: Binding, vertex_count: int) -> PreparedSkin:
    """Return a binding prepared for evaluation, with only the joints it uses."""
    bind = np.asarray(binding.bind, np.float64)
    geom_bind = (
        np.eye(4) if binding.geom_bind is None else np.asarray(binding.geom_bind)
    )
    geom_bind = geom_bind.astype(np.float64)
    _check_matrices(bind, geom_bind)
    mesh_joints = np.arange(len(bind))
    if binding.joints is not None:
        mesh_joints = np.asarray(binding.joints)
        _check_mesh_joints(mesh_joints, len(bind))
    influences, _ = read_influences(
        binding.indices, binding.weights, len(mesh_joints), vertex_count=vertex_count
    )
    used_joints, compact_joints = np.unique(influences.joints, return_inverse=True)
    joints = mesh_joints[used_joints].astype(np.int64)
    _check_invertible(bind, joints)
    used_influences = Influences(
        influences.row_starts, compact_joints.astype(np.int32), influences.weights
    )
    joint_from_world = np.linalg.inv(bind[joints]).astype(np.float64)
    return PreparedSkin(
        binding.method, used_influences, joints, joint_from_world, geom_bind
    )


def skin_points(
    skin: PreparedSkin,
    points: ArrayLike,
    world: WorldTransforms,
    *,
    out: FloatArray | None = None,
) -> FloatArray:
    """Return skinned points ``(F, V, 3)``.

    Linear blend: ``p' = Σ w · world_from_joint · joint_from_world · geom_bind · p``.
    Dual quaternions: each joint's transform from the bind pose is a rotation after a
    stretch (the polar decomposition; a mirror is a negative stretch). Stretches are
    blended linearly and move the point first; the rigid transforms are blended as dual
    quaternions, each with the sign nearest to the strongest joint's.

    Limits of the method: linear blend loses volume at bends and collapses at rotations
    of 180 degrees. With dual quaternions, as in UsdSkel, a joint whose transform has a
    determinant below 1e-10 is dropped from the blend, so that a point without other
    joints stays at its bind position.

    ``points``: ``(F, V, 3)``, or ``(1, V, 3)`` if they are equal in all frames;
    ``out`` ``(F, V, 3)``.
    """
    source = as_floats(points, ("F", skin.vertex_count, 3), "points")
    return _skin_values(skin, source, world, out, are_normals=False)


def skin_normals(
    skin: PreparedSkin,
    normals: ArrayLike,
    world: WorldTransforms,
    *,
    out: FloatArray | None = None,
) -> FloatArray:
    """Return skinned unit normals ``(F, V, 3)``.

    Linear blend sums the inverse transposes of joint transforms, as in UsdSkel; dual
    quaternions rotate by the blended rotation, after the inverse stretch. A normal that
    a joint of zero scale leaves without direction is zero.

    ``normals``: ``(F, V, 3)``, or ``(1, V, 3)`` if they are equal in all frames;
    ``out`` ``(F, V, 3)``.
    """
    source = as_floats(normals, ("F", skin.vertex_count, 3), "normals")
    return _skin_values(skin, source, world, out, are_normals=True)


def _skin_values(
    skin: PreparedSkin,
    source: FloatArray,
    world: WorldTransforms,
    out: FloatArray | None,
    *,
    are_normals: bool,
) -> FloatArray:
    """Return skinned points or normals ``(F, V, 3)``."""
    influences = skin.influences
    skinned_values = output_array(
        out, (len(world.positions), influences.vertex_count, 3)
    )
    if skin.method is SkinMethod.LINEAR:
        joint_from_points = skin.joint_from_world @ skin.world_from_points
        transforms = _skinning_matrices(skin, joint_from_points[:, :3], world)
        if are_normals:
            transforms[..., :3] = _inverse_transposes(transforms[..., :3])
            transforms[..., 3] = 0.0
        _kernels.skin_linear(
            source,
            influences.row_starts,
            influences.joints,
            influences.weights,
            transforms,
            are_normals,
            skinned_values,
        )
        return skinned_values
    transforms = _skinning_matrices(skin, skin.joint_from_world[:, :3], world)
    rotations, stretches = _kernels.split_stretch(
        np.ascontiguousarray(transforms[..., :3])
    )
    translations = np.ascontiguousarray(transforms[..., 3])
    if are_normals:
        normal_transform = _inverse_transposes(skin.world_from_points[:3, :3])
        source = source @ normal_transform.T
        stretches = _inverse_transposes(stretches)
        translations[:] = 0.0
    else:
        source = _to_world(source, skin.world_from_points)
    _kernels.skin_dual_quaternion(
        source,
        influences.row_starts,
        influences.joints,
        influences.weights,
        rotations,
        translations,
        _remove_rounding(stretches),
        are_normals,
        skinned_values,
    )
    return skinned_values


def _to_world(points: FloatArray, world_from_points: FloatArray) -> FloatArray:
    """Return points transformed to world space at bind time."""
    if (world_from_points == np.eye(4)).all():
        return points
    return points @ world_from_points[:3, :3].T + world_from_points[:3, 3]


def _skinning_matrices(
    skin: PreparedSkin, joint_from_source: FloatArray, world: WorldTransforms
) -> FloatArray:
    """Return each joint's world transform times its matrix ``(F, U, 3, 4)``."""
    linear, origins = world.linear[:, skin.joints], world.positions[:, skin.joints]
    _check_finite(skin, linear, origins)
    transforms: FloatArray = np.matmul(linear, joint_from_source)
    transforms[..., 3] += origins
    return transforms


def _remove_rounding(stretches: FloatArray) -> FloatArray | None:
    """Return stretches with rounding errors removed; None if nothing is stretched."""
    distance = np.abs(stretches - np.eye(3)).max(axis=(1, 2, 3), initial=0.0)
    is_stretched = distance > STRETCH_TOLERANCE
    if not is_stretched.any():
        return None
    stretches[~is_stretched] = np.eye(3)
    return stretches


def _inverse_transposes(linear: FloatArray) -> FloatArray:
    """Return inverse transposes ``(…, 3, 3)``; scaled cofactors if singular."""
    a, b, c = np.moveaxis(linear, -2, 0)
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-2)
    determinant = (a * cofactors[..., 0, :]).sum(axis=-1)[..., None, None]
    size = np.linalg.norm(cofactors, axis=(-2, -1), keepdims=True)
    largest = np.abs(linear).max(axis=(-2, -1), keepdims=True)
    is_regular = np.abs(determinant) > SINGULAR_DETERMINANT * largest**3
    divisor = np.where(is_regular, determinant, np.where(size > 0, size, 1.0))
    return np.asarray(cofactors / divisor)


def _check_matrices(bind: FloatArray, geom_bind: FloatArray) -> None:
    """Raise if a bind matrix has the wrong shape or is not finite."""
    faults = []
    for name, matrix, shape in (
        ("bind transforms", bind, (len(bind), 4, 4) if bind.ndim else (0, 4, 4)),
        ("the bind transform of the points", geom_bind, (4, 4)),
    ):
        if matrix.shape != shape:
            message = f"{name}: shape {matrix.shape}, but must be {shape}"
            faults.append(Fault("SKIN001", message))
        elif not np.isfinite(matrix).all():
            invalid_joints = np.flatnonzero(
                ~np.isfinite(matrix).all(axis=(-2, -1))
            ).tolist()
            joints = f", of joints {listed(invalid_joints)}" if matrix.ndim == 3 else ""
            faults.append(Fault("SKIN003", f"{name} are not finite{joints}"))
    if faults:
        raise FormatError(faults)


def _check_mesh_joints(mesh_joints: IntArray, joint_count: int) -> None:
    """Raise if a joint of a mesh is not an index of a skeleton joint."""
    if mesh_joints.ndim != 1 or not np.issubdtype(mesh_joints.dtype, np.integer):
        message = (
            f"the mesh's joint order is {mesh_joints.dtype} {mesh_joints.shape}, not "
            "integers (U,)"
        )
        raise FormatError(Fault("SKIN001", message))
    out_of_range = mesh_joints[
        (mesh_joints < 0) | (mesh_joints >= joint_count)
    ].tolist()
    if out_of_range:
        message = f"the mesh's joint order has joints outside 0…{joint_count - 1}: "
        raise FormatError(Fault("SKIN002", message + listed(out_of_range)))


def _check_invertible(bind: FloatArray, joints: IntArray) -> None:
    """Raise if the bind transform of a joint has no inverse."""
    linear = bind[joints, :3, :3]
    largest = np.abs(linear).max(axis=(1, 2), initial=0.0)
    is_singular = np.abs(np.linalg.det(linear)) <= SINGULAR_DETERMINANT * largest**3
    if is_singular.any():
        singular_joints = listed(joints[is_singular].tolist())
        message = f"bind transforms of joints {singular_joints} have no inverse"
        hint = "none of their axes may have length 0"
        raise FormatError(Fault("USD226", message, hint=hint))


def _check_finite(skin: PreparedSkin, linear: FloatArray, origins: FloatArray) -> None:
    """Raise if the transform of a joint is not finite in some frame."""
    is_finite = np.isfinite(linear).all(axis=(2, 3)) & np.isfinite(origins).all(axis=2)
    if not is_finite.all():
        frame, joint = np.argwhere(~is_finite)[0].tolist()
        message = f"joint {skin.joints[joint]} is not finite in frame {frame}"
        raise FormatError(Fault("SKIN003", message))
