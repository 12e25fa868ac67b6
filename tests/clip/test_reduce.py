from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from support.data import data_files
from support.suite import some_quick

from animtool.clip.coordinates import Tolerances, joint_tracks, relative_joint_motions
from animtool.clip.reduction.keys import ReducedChannel, Reduction
from animtool.clip.reduction.points import attached_points, point_errors
from animtool.clip.reduction.reduce import LIMIT_SLACK, reduce_motion
from animtool.clip.reduction.tracks import additive_pose, euler_order
from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import FormatError, OptionError
from animtool.edit import trim
from animtool.formats.bvh.read import read_bvh
from animtool.maths import euler, so3
from animtool.maths.fit import evaluate_keys
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.limits import BallLimit
from animtool.rig.parts import Shape
from animtool.rig.skeleton import Joint, JointType, Rig

ROOM = 1 + 1e-9
# Frames of a real take.
MAX_REAL = 200


def arm(joints: int = 3) -> Rig:
    """Bones of 30 cm in a row, the last with a tip."""
    row = [Joint("j0", -1)]
    row += [Joint(f"j{i}", i - 1, translation=(0, 0.3, 0)) for i in range(1, joints)]
    row[-1] = replace(row[-1], tips=((0.0, 0.3, 0.0),))
    return Rig("arm", tuple(row))


def take_of(rig: Rig, rotations: FloatArray, **others: Channel) -> Take:
    """A take of rotations ``(F, J, 4)`` at rest translations."""
    frames = len(rotations)
    still = np.repeat(rig.rest_translations[None], frames, axis=0)
    motion = Motion(Channel.from_dense(still), Channel.from_dense(rotations), **others)
    return Take(rig, Clock(Fraction(30), Fraction(1), Fraction(1), frames), motion)


def swing(frames: int = 200, joints: int = 3, size: float = 1.0) -> FloatArray:
    """Smooth turns about all axes."""
    t = np.arange(frames)[:, None, None] / 30
    rates = 1 + 0.3 * np.arange(joints * 3).reshape(joints, 3)
    return so3.exp(0.5 * size * np.sin(t * rates))


def world_errors(take: Take, found: Motion, base: Take | None = None) -> FloatArray:
    """Measure the error anew."""
    below = None if base is None else base.motion
    return point_errors(
        attached_points(take.rig, 0.03),
        additive_pose(take.rig, take.motion, below).world_transforms(),
        additive_pose(take.rig, found, below).world_transforms(),
    )


def values_of(channel: ReducedChannel, frames: FloatArray) -> FloatArray:
    """A channel's values at frames, rotations as quaternions."""
    values = evaluate_keys(channel.keys, frames)
    return (
        values if channel.order is None else euler.to_quaternion(values, channel.order)
    )


def evaluated(
    rig: Rig, reduction: Reduction, frames: FloatArray | None = None
) -> Motion:
    """The motion of the keys, and of the rest pose where there are none."""
    frames = np.arange(reduction.clock.count) if frames is None else frames
    joints, count = len(rig.joints), len(frames)
    values = {
        "translation": np.tile(rig.rest_translations, (count, 1, 1)),
        "rotation": np.tile(rig.rest_rotations, (count, 1, 1)),
        "scale": np.ones((count, joints, 3)),
        "weight": np.zeros((count, len(rig.shapes), 1)),
    }
    for channel in reduction.channels:
        group, _, name = channel.target.partition("/")
        if group == "shape":
            part, index = "weight", [s.name for s in rig.shapes].index(name)
        else:
            joint, _, part = name.rpartition(".")
            index = rig.index(joint)
        part = part.removeprefix("local_")
        values[part][:, index] = values_of(channel, frames)
    return Motion(*map(Channel.from_dense, values.values()))


def check(take: Take, reduction: Reduction, tolerance: float) -> FloatArray:
    """The reduction keeps its tolerance, and says what it reached."""
    off = world_errors(take, evaluated(take.rig, reduction))
    assert reduction.held
    assert off.max() <= tolerance * ROOM
    frame, joint = reduction.frame, take.rig.index(reduction.joint)
    assert off.max() == pytest.approx(reduction.error, abs=1e-12)
    assert off[frame, joint] == pytest.approx(reduction.error, abs=1e-12)
    return off


def as_bytes(reduction: Reduction) -> list[bytes]:
    return [
        getattr(c.keys, name).tobytes()
        for c in reduction.channels
        for name in ("frames", "values", "in_handles", "out_handles")
    ]


@pytest.fixture(scope="module")
def walking(walk: Path) -> Take:
    return read_bvh(walk).collect()


@pytest.mark.parametrize("tolerance", [5e-4, 1e-3, 5e-3])
def test_the_walk_stays_within_its_tolerance(walking: Take, tolerance: float) -> None:
    reduction = reduce_motion(walking, tolerance)
    check(walking, reduction, tolerance)
    assert reduction.samples_per_key > 2


def test_the_same_take_gives_the_same_bytes(walking: Take) -> None:
    one, other = reduce_motion(walking, 1e-3), reduce_motion(walking, 1e-3)
    assert as_bytes(one) == as_bytes(other)
    assert [c.target for c in one.channels] == [c.target for c in other.channels]


def test_a_named_joint_is_held_tighter(walking: Take) -> None:
    name = walking.rig.joints[-1].name
    plain = reduce_motion(walking, 5e-3)
    tight = reduce_motion(walking, 5e-3, joint_tolerances={name: 2e-4})
    off = check(walking, tight, 5e-3)
    assert off[:, -1].max() <= 2e-4 * ROOM
    assert tight.keys > plain.keys


@pytest.mark.parametrize("path", some_quick(data_files("bvh", "*.bvh"), 3, 1))
def test_real_takes_stay_within_their_tolerance(path: Path) -> None:
    try:
        take = read_bvh(path).collect()
    except FormatError as error:
        pytest.skip(error.code)
    first, last = take.clock.start, take.clock.start + min(len(take), MAX_REAL) - 1
    take = trim(take, float(first), float(last))
    check(take, reduce_motion(take, 1e-3), 1e-3)


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_short_takes(frames: int) -> None:
    take = take_of(arm(), swing(frames + 5)[5:])
    reduction = reduce_motion(take, 1e-4)
    check(take, reduction, 1e-4)
    assert all(len(c.keys.frames) <= frames for c in reduction.channels)


def test_what_stays_has_one_key_and_rest_has_none() -> None:
    rotations = swing()
    rotations[:, 1] = so3.IDENTITY
    rotations[:, 2] = so3.from_axis_angle([0, 0, 1], 0.5)
    reduction = reduce_motion(take_of(arm(), rotations), 1e-3)
    counts = {c.target: len(c.keys.frames) for c in reduction.channels}
    moving, still = "joint/j0.local_rotation", "joint/j2.local_rotation"
    assert counts.keys() == {moving, still}
    assert counts[still] == 1
    assert counts[moving] > 1
    assert reduction.samples == len(rotations)


def test_many_turns_are_a_straight_line() -> None:
    turns = np.zeros((500, 1, 4))
    turns[:, 0] = euler.to_quaternion(np.linspace(0, [[3600, 0, 0]], 500)[:, 0], "XYZ")
    take = take_of(arm(1), turns)
    reduction = reduce_motion(take, 1e-3)
    check(take, reduction, 1e-3)
    (channel,) = reduction.channels
    assert channel.keys.frames.tolist() == [0, 499]
    assert np.ptp(channel.keys.values) == pytest.approx(3600)


@pytest.mark.parametrize("own", [None, ("Zrotation", "Xrotation", "Yrotation")])
def test_passing_gimbal_lock(own: tuple[str, ...] | None) -> None:
    angles = np.zeros((300, 3))
    angles[:, 0] = 20 * np.sin(np.arange(300) / 40)
    angles[:, 1] = np.linspace(-120, 120, 300)
    rotations = euler.to_quaternion(angles, "ZXY")[:, None]
    rig = Rig("one", (replace(arm(1).joints[0], channels=own),))
    take = take_of(rig, rotations)
    reduction = reduce_motion(take, 1e-3)
    check(take, reduction, 1e-3)
    assert reduction.channels[0].order != "ZXY"


def test_the_own_order_is_kept_away_from_lock() -> None:
    joint = Joint("a", -1, channels=("Yrotation", "Zrotation", "Xrotation"))
    assert euler_order(joint, swing(50, 1, 0.3)[:, 0]) == "YZX"


def test_scales_weights_and_translations() -> None:
    frames = 200
    t = np.arange(frames)[:, None, None] / 30
    rig = replace(arm(), shapes=(Shape("smile"), Shape("jaw")))
    scales = 1 + 0.2 * np.sin(t * [[1.0, 1.5, 2.0]]) * np.ones((1, 3, 1))
    weights = 0.5 + 0.5 * np.sin(t * [[1.0], [2.0]])
    take = take_of(
        rig,
        swing(frames),
        scales=Channel.from_dense(scales),
        weights=Channel.from_dense(weights),
    )
    moved = rig.rest_translations + 0.1 * np.sin(t)
    motion = replace(take.motion, translations=Channel.from_dense(moved))
    take = replace(take, motion=motion)
    reduction = reduce_motion(take, 1e-3, weight_tolerance=0.01)
    check(take, reduction, 1e-3)
    found = evaluated(rig, reduction)
    assert found.weights is not None
    off = np.abs(found.weights.dense() - weights).max()
    assert off == pytest.approx(reduction.weight_error)
    assert 0 < off <= 0.01
    parts = {c.target.rpartition(".")[2] for c in reduction.channels}
    assert {"local_translation", "local_rotation", "scale"} < parts
    assert reduction.channels[-1].target == "shape/jaw"
    assert reduction.keys * 5 < reduction.samples


def test_additive_deltas_are_measured_on_their_base() -> None:
    rig = arm()
    base = take_of(rig, swing())
    deltas = take_of(rig, swing(size=0.2)[:, ::-1].copy())
    nothing = Channel.from_dense(np.zeros((200, 3, 3)))
    deltas = replace(deltas, motion=replace(deltas.motion, translations=nothing))
    reduction = reduce_motion(deltas, 1e-3, base=base)
    unmoved = tuple(replace(joint, translation=(0, 0, 0)) for joint in rig.joints)
    found = evaluated(replace(rig, joints=unmoved), reduction)
    off = world_errors(deltas, found, base)
    assert reduction.held
    assert off.max() <= 1e-3 * ROOM
    assert off.max() == pytest.approx(reduction.error, abs=1e-12)
    assert all(c.target.endswith(".local_rotation") for c in reduction.channels)


def test_keys_between_frames_and_outside() -> None:
    take = take_of(arm(), swing())
    reduction = reduce_motion(take, 1e-3)
    found = evaluated(take.rig, reduction, np.array([-5.0, 0.0, 10.5, 199.0, 300.0]))
    assert found.frames == 5
    turns = found.rotations.dense()
    np.testing.assert_array_equal(turns[0], turns[1])
    # Signs follow the frames asked for.
    assert so3.angle_between(turns[3], turns[4]).max() == 0
    middle = so3.slerp(swing()[10], swing()[11], 0.5)
    assert so3.angle_between(turns[2], middle).max() < 0.02


def test_an_unreachable_tolerance_is_said() -> None:
    reduction = reduce_motion(take_of(arm(), swing(30)), 1e-18)
    assert not reduction.held
    assert 0 < reduction.error < 1e-12


@pytest.mark.parametrize(
    "options",
    [
        {"weight_tolerance": 0.0},
        {"base": take_of(arm(), swing(19))},
        {"base": take_of(arm(4), swing(20, 4))},
    ],
)
def test_wrong_arguments_are_refused(options) -> None:
    take = take_of(arm(), swing(20))
    with pytest.raises(ValueError, match=r"tolerance|base"):
        reduce_motion(take, 1e-3, **options)


@pytest.mark.parametrize(
    "options",
    [
        {"tolerance": 0.0},
        {"tolerance": np.nan},
        {"joint_tolerances": {"x9": 1e-3}},
        {"joint_tolerances": {"j0": -1.0}},
    ],
)
def test_wrong_tolerances_have_a_code(options) -> None:
    with pytest.raises(OptionError) as caught:
        reduce_motion(take_of(arm(), swing(20)), **{"tolerance": 1e-3, **options})
    assert [fault.code for fault in caught.value.faults] == ["CLIP020"]


@pytest.mark.parametrize("tolerance", [1e-4, 5e-3])
def test_keys_of_a_ball_keep_its_limits_between_frames(tolerance: float) -> None:
    limit = BallLimit((0.5, 0.5), (-0.2, 0.2), (0.0, 1.0, 0.0))
    rig = arm(2)
    ball = replace(rig.joints[0], type=JointType.BALL, limits=limit)
    rig = replace(rig, joints=(ball, rig.joints[1]))
    turns = swing(joints=2, size=2.5)
    turns[:, 0] = limit.clamped(turns[:, 0])
    motions = relative_joint_motions(
        rig, take_of(rig, turns).motion, Tolerances(1e-9, 1e-9, 1e-9)
    )
    tracks = joint_tracks(rig, motions, {}, {}, Tolerances(1e-9, 1e-9, 1e-9))
    found = reduce_motion(take_of(rig, turns), tolerance, tracks=tracks)
    assert found.held
    beyond = limit.excess(ball_rotations(found, 8)).max()
    # The slack, and what a straight segment of Euler angles adds at 5 degrees a frame.
    assert beyond < LIMIT_SLACK + 2e-4
    # A fit that does not know of them swings out.
    free = [replace(track, limits=None) for track in tracks]
    loose = reduce_motion(take_of(rig, turns), tolerance, tracks=free)
    assert limit.excess(ball_rotations(loose, 8)).max() > 10 * beyond


def ball_rotations(found: Reduction, times: int) -> FloatArray:
    """Return the rotations of joint j0 at so many times the rate ``(N, 4)``."""
    channel = next(c for c in found.channels if c.target == "joint/j0.rotation")
    last = int(channel.keys.frames[-1])
    return values_of(channel, np.linspace(0, last, times * last + 1))
