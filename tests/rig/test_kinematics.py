from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.core.array_types import FloatArray
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms, forward, rest_world
from animtool.rig.skeleton import Joint, Rig


def tree(count: int, seed: int = 0) -> Rig:
    """Return a random tree with random rest transforms."""
    rng = np.random.default_rng(seed)
    joints = []
    for i in range(count):
        parent = -1 if i == 0 else int(rng.integers(0, i))
        q = so3.normalize(rng.normal(size=4))
        joints.append(
            Joint(
                f"j{i}",
                parent,
                translation=tuple(rng.normal(size=3)),
                rotation=tuple(q),
            )
        )
    return Rig("tree", tuple(joints))


def by_matrices(
    rig: Rig, t: FloatArray, r: FloatArray, s: FloatArray | None
) -> FloatArray:
    """Multiply 4x4 matrices, joint by joint: the reference."""
    local = np.zeros((*t.shape[:2], 4, 4))
    local[..., :3, :3] = so3.to_matrix(r)
    if s is not None:
        local[..., :3, :3] *= s[..., None, :]
    local[..., :3, 3] = t
    local[..., 3, 3] = 1
    world = local.copy()
    for i, joint in enumerate(rig.joints):
        if joint.parent >= 0:
            world[:, i] = world[:, joint.parent] @ local[:, i]
    return world


@pytest.mark.parametrize("scaled", [False, True])
def test_against_matrices(scaled: bool) -> None:
    rig, rng = tree(30), np.random.default_rng(1)
    t, r = rng.normal(size=(7, 30, 3)), so3.normalize(rng.normal(size=(7, 30, 4)))
    s = rng.uniform(0.5, 2, (7, 30, 3)) if scaled else None
    world, truth = forward(rig, t, r, s), by_matrices(rig, t, r, s)
    assert_allclose(world.positions, truth[..., :3, 3], rtol=1e-12, atol=1e-12)
    assert_allclose(world.linear, truth[..., :3, :3], rtol=1e-12, atol=1e-12)


def test_results_into_given_arrays() -> None:
    rig, rng = tree(9), np.random.default_rng(3)
    t, r = rng.normal(size=(5, 9, 3)), so3.normalize(rng.normal(size=(5, 9, 4)))
    fresh = forward(rig, t, r)
    kept = WorldTransforms(np.full((5, 9, 3), np.nan), np.full((5, 9, 3, 3), np.nan))
    assert forward(rig, t, r, out=kept) is kept
    np.testing.assert_array_equal(kept.positions, fresh.positions)
    np.testing.assert_array_equal(kept.linear, fresh.linear)
    with pytest.raises(ValueError, match=r"\(3, 9, 3\), not \(5, 9, 3\)"):
        forward(rig, t, r, out=forward(rig, t[:3], r[:3]))


def test_a_chain_of_a_thousand_joints() -> None:
    # All turn by the same angle about Z: the ends lie on a circle, in closed form.
    count, angle = 1000, 2 * np.pi / 1000
    joints = [
        Joint(f"j{i}", i - 1, translation=(float(i > 0), 0, 0)) for i in range(count)
    ]
    rig = Rig("chain", tuple(joints))
    turn = so3.from_axis_angle([0.0, 0.0, 1.0], angle)
    world = forward(rig, rig.rest_translations[None], np.tile(turn, (1, count, 1)))
    steps = np.cumsum(np.exp(1j * angle * np.arange(1, count)))
    found = world.positions[0, 1:, 0] + 1j * world.positions[0, 1:, 1]
    assert np.abs(found - steps).max() < 1e-12 * count
    assert_allclose(np.linalg.det(world.linear[0]), 1.0, atol=1e-12)


def test_rest_and_frames() -> None:
    rig = tree(5)
    rest = rest_world(rig)
    many = forward(
        rig,
        np.tile(rig.rest_translations, (3, 1, 1)),
        np.tile(rig.rest_rotations, (3, 1, 1)),
    )
    assert_allclose(many.positions, np.tile(rest.positions, (3, 1, 1)), atol=0)


def test_shapes_are_checked() -> None:
    with pytest.raises(ValueError, match="rotations must have shape"):
        forward(tree(2), np.zeros((1, 2, 3)), np.zeros((1, 3, 4)))
