"""From directions of bones to rotations of joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from support.attached import moved, simulated, tail_rig, take_of

from animtool.maths import so3
from animtool.systems.attach.chains import chain_rotations, shortest_rotations

SEEDS = st.integers(0, 2**31)


@given(SEEDS)
def test_the_least_turn_points_one_way_to_the_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    before, after = rng.normal(size=(2, 8, 3))
    after[0], after[1] = -3 * before[0], 2 * before[1]
    turns = shortest_rotations(before, after)
    pointed = so3.rotate(turns, before)
    ways = [part / np.linalg.norm(part, axis=-1)[:, None] for part in (pointed, after)]
    assert_allclose(*ways, atol=1e-7)
    # It turns about an axis across both: it does not twist.
    assert_allclose(np.sum(turns[:, :3] * before, axis=-1), 0, atol=1e-7)
    assert_allclose(turns[1], so3.IDENTITY, atol=1e-7)


def test_what_has_no_length_is_not_turned() -> None:
    turns = shortest_rotations(np.zeros((2, 3)), np.array([[1.0, 0, 0], [0, 0, 0]]))
    assert_allclose(turns, np.tile(so3.IDENTITY, (2, 1)))


@given(SEEDS)
def test_bones_point_to_where_they_were_moved(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rig = tail_rig(4, 0.3)
    turned = {name: tuple(rng.normal(0, 0.5, 3).tolist()) for name in rig.names[1:]}
    take = take_of(rig, 24, 0.0, turn=lambda t: rng.normal(0, 1, (len(t), 3)), **turned)
    wanted = so3.rotate(so3.exp(rng.normal(0, 1, 3)), rng.normal(size=(4, 3)))
    wanted *= 0.3 / np.linalg.norm(wanted, axis=1, keepdims=True)
    own = moved(take)
    places = own[0, 0] + np.concatenate([np.zeros((1, 3)), np.cumsum(wanted, axis=0)])
    joints = np.arange(1, 5)
    rotations = take.motion.rotations.dense()
    found = chain_rotations(rig, joints, rotations, own, places[None])
    values = rotations.copy()
    values[:, joints] = found
    channel = take.motion.rotations.from_dense(values)
    made = replace(take, motion=replace(take.motion, rotations=channel))
    assert_allclose(moved(made)[0], places, atol=1e-6)


def test_nothing_moved_is_nothing_turned() -> None:
    take = take_of(tail_rig(3, 0.2), 24, 0.5, tail_2=(0.3, 0.2, 0.1))
    own, rotations = moved(take), take.motion.rotations.dense()
    found = chain_rotations(take.rig, np.arange(1, 4), rotations, own, own)
    assert so3.angle_between(found, rotations[:, 1:]).max() < 1e-12


def test_a_bend_frequency_does_not_change_a_chain() -> None:
    """A pass may set it for the cloth and strands that it simulates, too."""
    take = take_of(tail_rig(3, 0.2), 24, 0.5)
    bent, _ = simulated(take, bend=10.0, frequency=0.5)
    assert_array_equal(moved(bent), moved(simulated(take, frequency=0.5)[0]))
