"""Random meshes on random joints, and skinning written out plainly."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms
from animtool.skin.skinning import Binding, SkinMethod

Array = npt.NDArray[np.float64]


def matrices(linear: Array, origins: Array) -> Array:
    """Return ``(…, 4, 4)`` for column vectors."""
    made = np.zeros((*linear.shape[:-2], 4, 4))
    made[..., :3, :3], made[..., :3, 3], made[..., 3, 3] = linear, origins, 1.0
    return made


def of_world(world: WorldTransforms) -> Array:
    return matrices(world.linear, world.positions)


def as_world(made: Array) -> WorldTransforms:
    return WorldTransforms(made[..., :3, 3].copy(), made[..., :3, :3].copy())


def rotations(rng: np.random.Generator, *shape: int) -> Array:
    """Return random rotation matrices ``(…, 3, 3)``."""
    return so3.to_matrix(so3.normalize(rng.normal(size=(*shape, 4))))


def rigid(rng: np.random.Generator, *shape: int) -> Array:
    """Return random rigid transforms ``(…, 4, 4)``."""
    return matrices(rotations(rng, *shape), rng.normal(size=(*shape, 3)))


def affine(rng: np.random.Generator, *shape: int) -> Array:
    """Return random transforms with scale and shear, some of them mirrors."""
    scales = rng.uniform(0.4, 2.0, (*shape, 3)) * rng.choice([-1, 1, 1], (*shape, 1))
    linear = rotations(rng, *shape) * scales[..., None, :] @ rotations(rng, *shape)
    return matrices(linear, rng.normal(size=(*shape, 3)))


@dataclass(frozen=True)
class Case:
    """A mesh of V points that follows J joints over F frames."""

    points: Array
    binding: Binding
    world: WorldTransforms

    def with_method(self, method: SkinMethod) -> Case:
        return replace(self, binding=replace(self.binding, method=method))


def random_case(
    seed: int,
    *,
    frames: int = 3,
    joints: int = 5,
    vertices: int = 17,
    influences: int = 4,
    scaled: bool = False,
) -> Case:
    rng = np.random.default_rng(seed)
    weights = rng.random((vertices, influences)) + 0.01
    weights /= weights.sum(axis=1, keepdims=True)
    picks = [rng.permutation(joints)[:influences] for _ in range(vertices)]
    binding = Binding(
        np.array(picks),
        weights,
        rigid(rng, joints),
        geom_bind=affine(rng) if scaled else rigid(rng),
    )
    world = affine(rng, frames, joints) if scaled else rigid(rng, frames, joints)
    return Case(rng.normal(size=(vertices, 3)), binding, as_world(world))


def homogeneous(points: Array) -> Array:
    return np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)


def plain_linear(case: Case) -> Array:
    """Return ``Σ w · world · bind⁻¹ · geom · p``, one product after the other."""
    binding = case.binding
    bind, geom = np.asarray(binding.bind), np.asarray(binding.geom_bind)
    moved = of_world(case.world) @ np.linalg.inv(bind) @ geom
    each = (
        moved[:, np.asarray(binding.indices)]
        @ homogeneous(case.points)[:, None, :, None]
    )
    return (np.asarray(binding.weights)[..., None, None] * each).sum(axis=2)[..., :3, 0]
