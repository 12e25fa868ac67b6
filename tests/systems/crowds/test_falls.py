"""People who are knocked down: how they fly, when they rest, and their poses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms, forward_kinematics
from animtool.rig.placed import transform_rig
from animtool.rig.placement import Placement
from animtool.rig.skeleton import Rig
from animtool.sim.colliders import Colliders
from animtool.systems.crowds.falls import (
    GRAVITY,
    MAX_FALL_SPEED,
    REST_TIME,
    Falls,
    FallSimulator,
    _step_ragdoll,
)
from animtool.systems.crowds.ground import GroundFrame, Terrain

STEP = 1 / 96


@pytest.fixture(scope="module")
def biped(root: Path) -> Rig:
    return Rig.load(root / "rigs/biped/biped.rig.yaml")


def falling(rig: Rig, size: float = 1.0) -> FallSimulator:
    """Return what moves two of a rig over a level ground that is turned about y."""
    frame = GroundFrame(np.array([1.0, 0.0, 2.0]), so3.exp(np.array([0.0, 0.7, 0.0])))
    return FallSimulator(
        [rig, rig], np.array([1.0, size]), frame, Terrain(), Colliders([]), STEP
    )


def pose(rig: Rig, place: list[float]) -> WorldTransforms:
    """Return the rest pose of a rig, its first joint at a place, turned about y."""
    places, turns = rig.rest_translations.copy(), rig.rest_rotations.copy()
    places[0] = place
    turns[0] = so3.multiply(so3.exp(np.array([0.0, 0.4, 0.0])), turns[0])
    return forward_kinematics(rig, places[None], turns[None])


def thrown(rig: Rig, speed: list[float]) -> tuple[FallSimulator, Falls]:
    """Return one who begins to fall high up with a speed [m/s]."""
    own = falling(rig)
    first = np.array([3.0, 50.0, -2.0])
    pair = [pose(rig, (first + k * STEP * np.array(speed)).tolist()) for k in (0, 1)]
    begun = own.add_falls(own.empty_falls(), np.array([1]), [pair[0]], [pair[1]], STEP)
    return own, begun


def world(rig: Rig, own: FallSimulator, falls: Falls) -> np.ndarray:
    places, turns = own.poses(falls, 0)
    return np.asarray(forward_kinematics(rig, places[None], turns[None]).positions[0])


def test_who_is_thrown_flies_as_a_stone_does(biped: Rig) -> None:
    """All joints by the speed and half of g times the square of the time."""
    speed = [2.0, 5.0, -1.0]
    own, falls = thrown(biped, speed)
    assert falls.agents.tolist() == [1]
    begun = world(biped, own, falls)
    assert_allclose(begun, falls.positions[0], atol=1e-9)
    count = 24
    for k in range(count):
        falls = own.step(falls, k * STEP, STEP)
    t = count * STEP
    flown = world(biped, own, falls) - begun
    expected = np.array(speed) * t - np.array([0, GRAVITY * t * t / 2, 0])
    # Steps of 2.5 ms fall by half of one more.
    assert_allclose(flown, np.broadcast_to(expected, flown.shape), atol=0.02)
    # Who looks twice sees the same, and another time another one.
    assert_allclose(world(biped, own, falls), begun + flown)
    assert np.abs(world(biped, own, own.step(falls, t, STEP)) - begun - flown).max() > 0


def test_who_is_larger_than_the_rig_falls_as_large(biped: Rig) -> None:
    """The second of two, by a fifth: bodies and joints, from the first step on."""
    size = Placement(np.zeros((1, 3)), so3.IDENTITY[None], np.array([1.2]))
    own, large = falling(biped, 1.2), transform_rig(biped, size)
    stands = pose(large, [3.0, 50.0, -2.0])
    falls = own.add_falls(own.empty_falls(), np.array([1]), [stands], [stands], STEP)
    assert_allclose(world(large, own, falls), stands.positions[0], atol=1e-9)
    falls = own.step(falls, 0.0, STEP)
    fell = world(large, own, falls) - stands.positions[0]
    assert_allclose(fell, np.broadcast_to(fell[0], fell.shape), atol=1e-4)
    assert fell[0, 1] < 0
    masses = [
        own._ragdoll(k, one.positions[0], one.rotations[0])[0].bodies.masses
        for k, one in ((0, pose(biped, [0, 50, 0])), (1, stands))
    ]
    assert_allclose(masses[1], 1.2**3 * masses[0])


def test_who_is_slow_for_long_rests(biped: Rig) -> None:
    """From rest one is slow for a step, as g times the step is below 15 cm/s."""
    own, falls = thrown(biped, [0.0, 0.0, 0.0])
    assert falls.slow.tolist() == [0.0]
    falls = own.step(falls, 0.0, STEP)
    assert falls.slow.tolist() == [pytest.approx(STEP)]
    assert not (falls.slow >= REST_TIME).any()
    falls = own.step(falls, STEP, STEP)
    assert falls.slow.tolist() == [0.0]
    still = Falls(
        falls.agents, falls.positions, falls.turns, falls.motion, np.array([REST_TIME])
    )
    after = own.step(still, 2 * STEP, STEP)
    assert_allclose(after.motion, still.motion, rtol=0, atol=0)
    assert after.slow.tolist() == [REST_TIME]


def test_who_fell_lies_on_the_ground_and_rests(biped: Rig) -> None:
    """Dropped by half a metre: still within three seconds, and nothing is below."""
    own = falling(biped)
    standing = pose(biped, [3.0, 1.4, -2.0])
    tilt = so3.to_matrix(so3.exp(np.array([0.0, 0.0, 0.6])))
    at = standing.positions[0, 0]
    leaning = WorldTransforms(
        (standing.positions - at) @ tilt.T + at, tilt @ standing.linear
    )
    falls = own.add_falls(own.empty_falls(), np.array([0]), [leaning], [leaning], STEP)
    for k in range(3 * 96):
        falls = own.step(falls, k * STEP, STEP)
        if (falls.slow >= REST_TIME).all():
            break
    assert (falls.slow >= REST_TIME).all()
    heights = world(biped, own, falls)[:, 1]
    assert heights.max() < 0.6
    assert heights.min() > -0.05


def test_who_begins_to_fall_goes_on_as_he_moved(biped: Rig) -> None:
    """From the first of two poses, and by the second after a step, but for gravity.

    Of one who goes by 3 m/s, spins by 2 rad/s and bends a knee by 4 rad/s.
    """
    own, knee = falling(biped), biped.index("knee_l")
    pair = []
    for t in (0.0, STEP):
        places, turns = biped.rest_translations.copy(), biped.rest_rotations.copy()
        places[0] = [3.0, 50.0, 3.0 * t]
        turns[0] = so3.exp(np.array([0.0, 2.0 * t, 0.0]))
        turns[knee] = so3.exp(np.array([0.5 + 4.0 * t, 0.0, 0.0]))
        pair.append(forward_kinematics(biped, places[None], turns[None]))
    falls = own.add_falls(own.empty_falls(), np.array([0]), [pair[0]], [pair[1]], STEP)
    assert_allclose(falls.positions[0], pair[0].positions[0])
    assert_allclose(world(biped, own, falls), pair[0].positions[0], atol=1e-9)
    falls = own.step(falls, 0.0, STEP)
    off = world(biped, own, falls) - pair[1].positions[0]
    assert_allclose(off, 0.0, atol=2e-3)


def test_who_walks_beyond_his_limits_is_not_pulled_back_as_he_falls(
    biped: Rig,
) -> None:
    """A foot twisted by 43 degrees, where its rig has 20, is so after a step too."""
    own, foot = falling(biped), biped.index("ankle_r")
    turns = biped.rest_rotations.copy()
    turns[foot] = so3.exp(np.radians([0.0, 43.0, 0.0]))
    places = biped.rest_translations.copy()
    places[0] = [3.0, 50.0, -2.0]
    stands = forward_kinematics(biped, places[None], turns[None])
    falls = own.add_falls(own.empty_falls(), np.array([0]), [stands], [stands], STEP)
    for k in range(2):
        shown = own.poses(falls, 0)[1][foot]
        assert np.degrees(so3.angle_between(shown, turns[foot])) < 0.01
        falls = own.step(falls, k * STEP, STEP)


def test_joints_of_who_is_torn_apart_are_shown_as_they_can_be(biped: Rig) -> None:
    """A toe that is turned about x by 150 degrees and out by 60: it ends at 30."""
    own, toe = falling(biped), biped.index("toe_r")
    stands = pose(biped, [3.0, 50.0, -2.0])
    falls = own.add_falls(own.empty_falls(), np.array([0]), [stands], [stands], STEP)
    ragdoll = own._ragdoll(0, falls.positions[0], falls.turns[0])[0]
    body = ragdoll.joints.tolist().index(toe)
    torn = so3.multiply(
        so3.exp(np.radians([150.0, 0.0, 0.0])), so3.exp(np.radians([0.0, 60.0, 0.0]))
    )
    motion = falls.motion.copy()
    before = so3.from_matrix(stands.linear[0, toe])
    off = so3.multiply(so3.multiply(before, torn), so3.conjugate(before))
    motion[0, body, 3:7] = so3.multiply(off, motion[0, body, 3:7])
    falls = Falls(falls.agents, falls.positions, falls.turns, motion, falls.slow)
    shown = own.poses(falls, 0)[1][toe]
    assert_allclose(np.degrees(so3.log(shown)), [30.0, 0.0, 0.0], atol=1e-6)


@pytest.mark.parametrize(("longest", "expected"), [(0.8, 0.8), (0.1, 0.8), (0.09, 0.0)])
def test_who_would_fall_too_fast_takes_the_step_in_eight_parts(
    longest: float, expected: float
) -> None:
    """By 1 m/s, but too fast in longer steps; who still is stays, and stops."""

    def step(state: Any, t: float, dt: float) -> Any:
        motion = state.motion.copy()
        assert t == pytest.approx(motion[0, 0])
        motion[0, 0] += dt
        motion[0, 7] = 1.0 if dt <= longest else MAX_FALL_SPEED
        return replace(state, motion=motion)

    begun = Falls(
        *(np.zeros(shape) for shape in ((0,), (0, 1, 3), (0, 1, 4), (0, 1, 14), (0,)))
    )
    simulation: Any = SimpleNamespace(initial_state=lambda: begun, step=step)
    motion = np.zeros((1, 14))
    motion[0, 7] = 2.0
    made = _step_ragdoll(simulation, motion, 0.0, 0.8)
    assert made[0, 0] == pytest.approx(expected)
    assert made[0, 7] == (1.0 if expected else 0.0)
    assert motion[0, 7] == 2.0
