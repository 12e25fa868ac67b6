"""How high feet in the air are, and how far soles lean, in numbers."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.maths import so3
from animtool.systems.crowds.poses import (
    MAX_TILT,
    PHASE_COUNT,
    _ankle_targets,
    _hip_lowering,
    _missing_clearance,
    _swing_poses,
    _tilt_rotations,
    idle_frames,
)
from animtool.systems.crowds.reach import MAX_EXTENSION

# Who stands on ankles 0.1 m high, with balls 0.15 m ahead.
WALKER: Any = SimpleNamespace(
    ankle_heights=np.array([0.1, 0.1]), ball_offsets=np.tile([0.0, -0.1, 0.15], (2, 1))
)


@pytest.mark.parametrize(
    ("ahead", "high", "away", "lack"),
    [
        (0.0, 0.0, 0.0, 0.0),
        (0.0, 0.0, 0.004, 0.008),
        (0.0, 0.003, 0.004, 0.005),
        (0.006, 0.0, 0.0, 0.012),
        (0.006, 0.0, 0.002, 0.016),
        (-0.006, 0.0, 0.002, 0.016),
        (9.0, 0.005, 0.0, 0.015),
        (9.0, 1.0, 9.0, 0.0),
    ],
)
def test_a_foot_is_as_high_as_it_is_far_from_where_it_stands(
    ahead: float, high: float, away: float, lack: float
) -> None:
    """By twice how far its place is and it is from that, and by 2 cm at most."""
    lifts = np.array([[0.0, 0.1 + high, ahead]])
    found = _missing_clearance(WALKER, 0, so3.IDENTITY[None], lifts, np.array([away]))
    assert_allclose(found, [lack], atol=1e-12)


def test_the_ball_counts_where_the_heel_is_up() -> None:
    """Turned by 90 degrees it is 0.15 m below the ankle, and 0.1 m behind that."""
    turn = so3.from_axis_angle(np.array([1.0, 0.0, 0.0]), np.array([np.pi / 2]))
    for ahead, high, lack in ((0.25, 0.0, 0.0), (0.254, 0.003, 0.005)):
        lifts = np.array([[0.0, 0.15 + high, ahead]])
        found = _missing_clearance(WALKER, 1, turn, lifts, np.zeros(1))
        assert_allclose(found, [lack], atol=1e-12)


def test_soles_lean_as_the_ground_does_up_to_a_limit() -> None:
    for angle, expected in (
        (0.2, 0.2),
        (-0.3, -0.3),
        (MAX_TILT + 0.4, MAX_TILT),
        (0.0, 0.0),
    ):
        normal = np.array([[0.0, np.cos(angle), np.sin(angle)]])
        turn = so3.from_axis_angle(np.array([1.0, 0.0, 0.0]), expected)
        assert so3.angle_between(_tilt_rotations(normal), turn).max() < 1e-7


def test_who_stands_goes_there_and_back_again() -> None:
    """A clip of 2 s and five rows."""
    idle: Any = SimpleNamespace(rotations=np.zeros((5, 1, 4)), period=2.0)
    clocks = np.array([0.0, 0.5, 2.0, 2.5, 3.5, 4.0, 9.0])
    assert_allclose(idle_frames(idle, clocks), [0, 1, 4, 3, 1, 0, 2])
    idle.rotations = idle.rotations[:1]
    assert_allclose(idle_frames(idle, clocks), 0)


def swinging(swings: list[float], still: list[float]) -> tuple[Any, Any, Any]:
    """Return gaits, state and blend of feet turned by 40 degrees, 0.3 m up."""
    turn = so3.from_axis_angle(np.array([1.0, 0.0, 0.0]), np.radians(40.0))
    lifts = np.zeros((2, PHASE_COUNT, 3))
    lifts[..., 1], lifts[..., 2] = 0.3, np.linspace(-0.4, 0.4, PHASE_COUNT)
    gait = SimpleNamespace(swings=np.tile(turn, (2, PHASE_COUNT, 1)), lifts=lifts)
    count = len(swings)
    state = SimpleNamespace(
        swings=np.tile(np.array(swings)[:, None], 2),
        still=np.array(still),
        phases=np.zeros(count),
        spans=np.full((count, 2), 9.0),
        rates=np.ones(count),
        heels=np.radians(40.0) * np.tile(1.0 - np.array(still)[:, None], 2),
    )
    blend = SimpleNamespace(
        weights=np.ones((count, 1)),
        stride=np.ones(count),
        stance_fractions=np.full((count, 2), 0.5),
        free_rate=np.ones(count),
    )
    return SimpleNamespace(walker=WALKER, cycles=(gait,)), state, blend


def test_feet_in_the_air_lean_as_those_of_the_clip() -> None:
    """Who just stood lifts a flat foot, and low."""
    gaits, state, blend = swinging([0.75, 1.0, 0.75, 0.125], [0.0, 0.0, 1.0, 1.0])
    pitched, lifts = _swing_poses(gaits, state, blend, 0, np.ones(4, np.bool_))
    leans = np.degrees(2 * np.arctan2(pitched[:, 0], pitched[:, 3]))
    assert_allclose(leans, [40, 40, 0, 0], atol=1e-9)
    assert_allclose(lifts[:2], [[0, 0.3, 0.2], [0, 0.3, 0.4]], atol=1e-12)
    # Its ankle is 0.1 m high where it stands, and is lifted by 0.35 of the 0.2 m more
    # of the clip, at first by less: by the smoothest step over 0.7 of the swing.
    u = 0.125 / 0.7
    low = 0.1 + 0.07 * (10 * u**3 - 15 * u**4 + 6 * u**5)
    assert_allclose(lifts[2:], [[0, 0.17, 0], [0, low, 0]], atol=1e-12)


def test_feet_that_stand_lean_as_the_ground_does() -> None:
    """A foot that looks along x stands on ground that rises along z."""
    gaits, state, blend = swinging([-1.0], [0.0])
    bodies: Any = SimpleNamespace(gaits=gaits, heel_pitches=lambda *_: np.zeros(1))
    feet = np.tile([1.0, 2.0, 3.0, np.pi / 2], (1, 2, 1))
    normal = np.array([0.0, np.cos(0.2), -np.sin(0.2)])
    goals, soles = _ankle_targets(
        bodies, state, blend, feet, np.tile(normal, (1, 2, 1)), np.zeros((1, 2))
    )
    assert_allclose(goals[0, 0], np.array([1.0, 2.0, 3.0]) + 0.1 * normal, atol=1e-12)
    assert_allclose(so3.rotate(soles[0, 0], np.array([0.0, 1.0, 0.0])), normal)
    ahead = so3.rotate(soles[0, 0], np.array([0.0, 0.0, 1.0]))
    assert_allclose(ahead, [1.0, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("swing", "before", "lowered"),
    [
        (-1.0, 0.0, 0.02),  # who stands: as far as it takes
        (0.01, 0.0, 0.02),  # as good as landed
        (0.5, 0.0, 0.0),  # halfway: not at all
        (-1.0, 0.03, 0.03),  # hips rise slowly, elsewhere
        (-1.0, 0.3, 0.11),  # no farther than that
    ],
)
def test_hips_are_lowered_for_feet(swing: float, before: float, lowered: float) -> None:
    """Straight legs of 1 m, whose ankles are to be 2 cm beyond their reach."""
    found = hips_lowered(swing, before, MAX_EXTENSION + 0.02)
    assert found == pytest.approx(lowered, abs=1e-4)


def test_hips_are_lowered_for_feet_in_the_air_by_little_in_a_step() -> None:
    """By 4.5% of a leg over what they were; for those that stand by all of it."""
    far = MAX_EXTENSION + 0.1
    assert hips_lowered(0.001, 0.0, far) == pytest.approx(0.045)
    assert hips_lowered(0.001, 0.02, far) == pytest.approx(0.065)
    assert hips_lowered(-1.0, 0.02, far) == pytest.approx(0.1)


def hips_lowered(swing: float, before: float, far: float) -> float:
    """Return how far hips are lowered for one foot so far below the hip [m]."""
    walker: Any = SimpleNamespace(legs=((0, 1, 2, 3), (0, 1, 2, 3)), leg_length=1.0)
    joints = np.array([[[0.0, 1.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.0]]])
    goals = np.array([[[0.0, 1.0 - far, 0.0], [0.0, 0.1, 0.0]]])
    state: Any = SimpleNamespace(
        lowered=np.array([before]), swings=np.array([[swing, -1.0]])
    )
    return float(_hip_lowering(walker, joints, goals, state)[0])
