"""The pass that lets a rig fall: where it begins, what it keeps, what it refuses."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.rigid import GRAVITY

from animtool.clock import Clock
from animtool.errors import OptionError
from animtool.maths import so3
from animtool.motion import Channel, Motion
from animtool.passes import PassContext
from animtool.rig.joints import LocalTransforms, coordinates_from_local
from animtool.rig.kinematics import forward
from animtool.rig.limits import RangeLimit
from animtool.rig.parts import Capsule, Collider
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.systems.rigid.ragdoll import RagdollCollider, RagdollOptions, ragdoll
from animtool.take import Take

LENGTH = 0.5
GROUND = RagdollCollider({"plane": None}, at=(0.0, -2.0, 0.0))


def chain(links: int = 3, limits: Any = None) -> Rig:
    """Return a hip and links on pins that hang down from it, with a stiff end."""
    pin = {"type": JointType.PIN, "axis": (0.0, 0.0, 1.0), "limits": limits}
    joints = [Joint("hip", -1, translation=(0.0, 1.0, 0.0))]
    for k in range(links):
        joints.append(
            Joint(f"link {k}", k, translation=(0.0, -LENGTH * (k > 0), 0.0), **pin)
        )
    joints.append(Joint("end", links, JointType.FIXED, (0.0, -LENGTH, 0.0)))
    bone = Capsule(0.03, LENGTH - 0.1, (0.0, 1.0, 0.0), (0.0, -LENGTH / 2, 0.0))
    colliders = [Collider("hip", Capsule(0.1, 0.2))]
    colliders += [Collider(f"link {k}", bone) for k in range(links)]
    return Rig("chain", tuple(joints), colliders=tuple(colliders))


def still(rig: Rig, frames: int = 25, fps: int = 24, speed: float = 0.0) -> Take:
    """Return a take of a rig at rest that slides along x [m/s]."""
    places = np.repeat(rig.rest_translations[None], frames, axis=0)
    places[:, 0, 0] += speed * np.arange(frames) / fps
    turns = np.repeat(rig.rest_rotations[None], frames, axis=0)
    motion = Motion(Channel.from_dense(places), Channel.from_dense(turns))
    return Take(rig, Clock(Fraction(fps), Fraction(1), Fraction(1), frames), motion)


def fallen(take: Take, **options: Any) -> Take:
    context = PassContext(lambda _: take, Path())
    made = ragdoll(take, RagdollOptions(**{"blend": 0.0, **options}), context)
    return replace(made, notices=tuple(context.notices))


def hips(take: Take) -> np.ndarray:
    return take.motion.translations.dense()[:, 0]


def test_what_nothing_holds_falls_as_a_whole() -> None:
    take = fallen(still(chain(), speed=2.0), start=7.0)
    times = np.arange(25) / 24
    late = np.maximum(times - 6 / 24, 0)
    expected = [2 * times, 1 - GRAVITY / 2 * late**2, 0 * times]
    assert_allclose(hips(take), np.stack(expected, axis=1), atol=1e-3)
    turns = take.motion.rotations.dense()
    assert so3.angle_between(turns, chain().rest_rotations).max() < 1e-3
    assert [notice.code for notice in take.notices] == ["SIM128"]


def test_before_it_begins_all_stays() -> None:
    before = still(chain(), speed=1.0)
    after = fallen(before, start=12.0)
    for name in ("translations", "rotations"):
        was, now = (getattr(t.motion, name).dense()[:12] for t in (before, after))
        assert_array_equal(was, now)


def test_it_comes_to_rest_on_the_ground_and_bones_keep_their_length() -> None:
    begun = still(chain(), 145)
    turns = begun.motion.rotations.dense()
    turns[:, 0] = so3.exp(np.array([0.0, 0.0, 0.4]))
    motion = replace(begun.motion, rotations=Channel.from_dense(turns))
    take = fallen(replace(begun, motion=motion), colliders=(GROUND,), mass=12.0)
    world = forward(take.rig, *take.motion.dense()[:2])
    lengths = np.linalg.norm(np.diff(world.positions[:, 1:], axis=1), axis=2)
    assert_allclose(lengths, LENGTH, atol=1e-12)
    assert world.positions[-1, :, 1].max() < -1.5
    assert world.positions[..., 1].min() > -2.05
    assert np.abs(np.diff(world.positions[-10:], axis=0)).max() < 2e-3


@pytest.mark.parametrize("side", [-1, 1])
def test_limits_are_kept(side: int) -> None:
    limits = RangeLimit(-0.2, 0.3)
    take = still(chain(2, limits), 73)
    turns = take.motion.rotations.dense()
    lying = so3.exp(np.array([0.0, 0.0, side * math.pi / 2]))
    turns[:, 0] = lying
    take = replace(
        take, motion=replace(take.motion, rotations=Channel.from_dense(turns))
    )
    post = RagdollCollider({"box": {"size": [0.2, 1.0, 1.0]}}, at=(0.0, 0.35, 0.0))
    found = fallen(take, colliders=(post, GROUND))
    angles = coordinates_from_local(
        found.rig, LocalTransforms(*found.motion.dense()[:2])
    )[:, 7:]
    assert np.abs(angles).max() > 0.1
    assert angles.min() > -0.2 - math.radians(1)
    assert angles.max() < 0.3 + math.radians(1)


def test_the_rate_of_frames_changes_nothing() -> None:
    rig = chain()
    slow = fallen(still(rig, 25, 24), colliders=(GROUND,))
    fast = fallen(still(rig, 61, 60), colliders=(GROUND,))
    for name in ("translations", "rotations"):
        one, other = (getattr(t.motion, name).dense() for t in (slow, fast))
        assert_allclose(one[::2], other[::5], atol=1e-12)


def test_a_stiff_one_keeps_the_pose_of_the_take() -> None:
    take = still(chain(), 49)
    wave = 0.4 * np.sin(np.arange(49) / 6)
    turns = take.motion.rotations.dense()
    turns[:, 2] = so3.exp(wave[:, None] * [0.0, 0, 1])
    take = replace(
        take, motion=replace(take.motion, rotations=Channel.from_dense(turns))
    )

    def off(**options: Any) -> float:
        found = fallen(take, gravity=0.0, start=5.0, **options)
        angle = so3.angle_between(found.motion.rotations.dense()[5:, 2], turns[5:, 2])
        return float(angle.max())

    assert off(stiffness=200.0, damping=5.0) < 0.15
    assert off() > 0.3


def test_it_blends_in_and_the_take_comes_back() -> None:
    before = still(chain(), 49)
    hard = fallen(before, start=5.0)
    soft = fallen(before, start=5.0, end=25.0, blend=8.0)
    heights = [hips(take)[:, 1] for take in (before, hard, soft)]
    assert_allclose(heights[2][12:24], heights[1][12:24], atol=1e-12)
    assert (heights[2][5:12] > heights[1][5:12]).all()
    assert_allclose(heights[2][32:], heights[0][32:], atol=1e-12)


def test_joints_below_the_last_body_go_on() -> None:
    take = still(chain(), 25)
    turns = take.motion.rotations.dense()
    turns[:, 4] = so3.exp(np.arange(25)[:, None] * [0.05, 0.0, 0.0])
    take = replace(
        take, motion=replace(take.motion, rotations=Channel.from_dense(turns))
    )
    found = fallen(take).motion.rotations.dense()
    assert_allclose(found[:, 4], turns[:, 4], atol=1e-15)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"start": 99.0}, "start is frame 99, and the take has 1 to 25"),
        ({"start": 3.5}, "start"),
        ({"start": 9.0, "end": 9.0}, "not behind start"),
        ({"mass": 0.0}, "mass"),
        ({"density": -1.0}, "density"),
        ({"step": 0.0}, "step"),
        ({"colliders": (RagdollCollider({"cone": None}),)}, "no shape is 'cone'"),
        ({"colliders": (RagdollCollider({"box": {"size": "x"}}),)}, "size"),
        (
            {"colliders": (RagdollCollider({"plane": None}, rotate=(0, 0, 0, 0)),)},
            "all 0",
        ),
    ],
)
def test_what_makes_no_sense_is_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(OptionError, match=words) as error:
        fallen(still(chain()), **options)
    assert error.value.code == "SIM062"


def test_a_rig_without_colliders_is_refused() -> None:
    with pytest.raises(OptionError, match="none of the joints") as error:
        fallen(still(replace(chain(), colliders=())))
    assert error.value.code == "SIM062"
