from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from animtool.maths import so3
from animtool.rig.limits import BallLimit
from animtool.rig.sides import mirror_joint, reflect_rotation, reflect_vector
from animtool.rig.skeleton import Joint, JointType

ORIGIN = (np.zeros(3), so3.IDENTITY)


@given(st.integers(0, 10_000))
def test_a_reflected_rotation_turns_reflected_vectors(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, v = so3.normalize(rng.normal(size=4)), rng.normal(size=3)
    found = so3.rotate(reflect_rotation(q), reflect_vector(v))
    assert_allclose(found, reflect_vector(so3.rotate(q, v)), atol=1e-14)
    assert_allclose(reflect_rotation(reflect_rotation(q)), q)


def at_origin(joint: Joint) -> Joint:
    world = (np.array(joint.translation), np.array(joint.rotation))
    return mirror_joint(joint, world, -1, ORIGIN)


def test_axes() -> None:
    pin = Joint("a_l", -1, JointType.PIN, axis=(0.6, 0.0, 0.8), mirror="a_r")
    assert at_origin(pin).axis == (0.6, 0.0, -0.8)
    slider = Joint("a_l", -1, JointType.PRISMATIC, axis=(0.6, 0.0, 0.8), mirror="a_r")
    assert at_origin(slider).axis == (-0.6, 0.0, 0.8)


def test_names_tips_and_limits() -> None:
    limit = BallLimit((1.0, 2.0), (-1.0, 0.5), (0.6, 0.8, 0.0))
    ball = Joint(
        "a_l",
        -1,
        JointType.BALL,
        (1.0, 2.0, 3.0),
        mirror="a_r",
        tips=((1.0, 0.0, 2.0),),
        limits=limit,
        source_name="a.l",
    )
    found = at_origin(ball)
    assert (found.name, found.mirror, found.source_name) == ("a_r", "a_l", "")
    assert found.translation == (-1, 2, 3)
    assert found.tips == ((-1, 0, 2),)
    assert found.limits == BallLimit((1.0, 2.0), (-1.0, 0.5), (0.6, -0.8, 0.0))
    assert "-0.0" not in repr(found)
    assert at_origin(found).limits == limit


def test_parents_that_are_no_mirror_images() -> None:
    joint = Joint("a_l", 0, JointType.FIXED, (1.0, 0.0, 0.0), mirror="a_r")
    parent = (np.array([0.5, 1.0, 0.0]), so3.exp([0.0, 0.0, 0.7]))
    world = (
        parent[0] + so3.rotate(parent[1], joint.translation),
        so3.multiply(parent[1], joint.rotation),
    )
    found = mirror_joint(joint, world, 0, parent)
    position = parent[0] + so3.rotate(parent[1], found.translation)
    turn = so3.multiply(parent[1], found.rotation)
    assert_allclose(position, reflect_vector(world[0]), atol=1e-14)
    assert_allclose(so3.angle_between(turn, reflect_rotation(world[1])), 0, atol=1e-14)
