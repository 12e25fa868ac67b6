"""Shoulders that people turn in a jam: how far, how smoothly, and what is seen."""

from __future__ import annotations

import numpy as np
import pytest
from systems.crowds.test_bodies import level, library

from animtool import _kernels
from animtool.maths import so3
from animtool.rig.kinematics import forward_kinematics
from animtool.systems.crowds.bodies import AgentBodies
from animtool.systems.crowds.shoulders import (
    DEPTH_RATIO,
    MAX_YAW,
    shoulder_vectors,
    step_shoulders,
)

RADIUS = 0.22


def stepped(
    x: np.ndarray, wanted: np.ndarray, v: np.ndarray, shoulders: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """Return a step of agents without walls, whose shoulders are along lines."""
    count = len(x)
    return _kernels.crowd_step(
        x, v, wanted, np.full(count, RADIUS), np.full(count, 1.7), np.ones(count),
        shoulders, DEPTH_RATIO, np.full(count, -1, np.int32), np.zeros(count, np.uint8),
        np.zeros(count + 1, np.int32), np.zeros((0, 4)), 3.0, 10, 2.0, 0.0, 0.0, 0.5,
        0.0, 0.05, 100, 1e-6,
    )  # fmt: skip


@pytest.mark.parametrize(("angle", "wide"), [(0.0, 1.0), (np.pi / 2, DEPTH_RATIO)])
def test_who_is_turned_is_an_ellipse(angle: float, wide: float) -> None:
    x = np.array([[0.0, 0.0], [0.05, 0.0]])
    still = np.zeros_like(x)
    along = np.tile([np.cos(angle), -np.sin(angle)], (2, 1))
    points, _, overlap, _ = stepped(x, still, still, along)
    assert overlap < 1e-6
    far = np.linalg.norm(points[1] - points[0])
    assert far == pytest.approx(2 * RADIUS * wide, abs=1e-5)


def test_who_is_not_turned_is_a_disc() -> None:
    x = np.array([[0.0, 0.0], [0.1, 0.02]])
    still = np.zeros_like(x)
    points, _, _, pressed = stepped(x, still, still, still)
    assert np.linalg.norm(points[1] - points[0]) == pytest.approx(2 * RADIUS, abs=1e-5)
    assert not pressed.any()


def test_only_who_is_held_up_by_those_against_it_is_to_turn() -> None:
    x = np.array([[0.0, 0.0], [0.1, 0.5]])
    against = np.array([[0.0, 1.3], [0.0, -1.3]])
    still = np.zeros_like(x)
    *_, held = stepped(x, against, still, still)
    # The other is on the left of each.
    assert (held > 0.2).all()
    *_, free = stepped(x, against, against, still)
    assert not free.any()
    alike = np.array([[0.0, 1.3], [0.0, 1.3]])
    *_, behind = stepped(x, alike, still, still)
    assert not behind.any()


def test_shoulders_turn_smoothly_no_farther_than_the_most_and_back() -> None:
    shoulders, seen = np.zeros(2), []
    for k in range(200):
        pressed = np.array([1.0, -1.0]) * (k < 100) * (1.0 if k % 7 else 0.4)
        shoulders = step_shoulders(shoulders, pressed, 1 / 24)
        seen.append(shoulders)
    angles = np.array(seen)
    assert np.abs(angles).max() <= MAX_YAW
    assert angles[99, 0] > 0.7 * MAX_YAW
    assert angles[99, 1] < -0.7 * MAX_YAW
    assert np.abs(np.diff(angles, axis=0)).max() < 0.2 * MAX_YAW
    assert not angles[-1].any()


def test_lines_are_as_long_as_shoulders_are_turned() -> None:
    headings, shoulders = (
        np.array([0.0, 1.0, 2.0]),
        np.array([0.0, MAX_YAW, -MAX_YAW / 2]),
    )
    along = shoulder_vectors(headings, shoulders)
    assert np.linalg.norm(along, axis=1) == pytest.approx([0, 1, 0.5])
    assert along[1] == pytest.approx([np.cos(1 + MAX_YAW), -np.sin(1 + MAX_YAW)])


def test_the_chest_turns_as_far_and_the_head_looks_ahead() -> None:
    gaits = library("stand", "walk")
    bodies = AgentBodies(gaits, np.ones(2), level)
    rig = gaits.walker.rig
    turns = np.repeat(rig.rest_rotations[None], 2, axis=0)
    angles = np.array([0.0, MAX_YAW])
    bodies.trunk.rotate_shoulders(rig.parents, turns, angles)
    places = np.repeat(rig.rest_translations[None], 2, axis=0)
    world = forward_kinematics(rig, places, turns).rotations
    names = [joint.name for joint in rig.joints]

    def turned(name: str) -> float:
        joint = names.index(name)
        off = so3.multiply(world[1, joint], so3.conjugate(world[0, joint]))
        return float(so3.log(off)[1])

    assert turned("spine_4") == pytest.approx(MAX_YAW)
    assert turned("head") == pytest.approx(0.0, abs=1e-6)
    assert set(bodies.trunk.joints) <= set(bodies.animated_joints)
