"""Numbers of goals, of their ways over frames, of limbs, and of what is said."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.ik import arm, limb

from animtool.core.errors import OptionError
from animtool.ik import Goal, IkStatus, Targets, build, result, take_run
from animtool.ik.chain_frame import check_scales
from animtool.ik.clip_path import ClipPath
from animtool.ik.goals import (
    GOAL_KINDS,
    GOAL_PARTS,
    MAX_COORDINATE,
    TARGET_COLUMNS,
    WEIGHT_COLUMNS,
    goal_faults,
    pack,
    targets_of_frames,
)
from animtool.ik.jumps import Jump
from animtool.ik.limbs import bend_angle, limb_joints
from animtool.ik.match_take import (
    _joints_off_rest,
    match_chains,
    untracked_motion_notices,
)
from animtool.ik.matching import (
    _BendingLimb,
    _normalize,
    _pole_positions,
    perpendicular_vectors,
)
from animtool.ik.nearest import (
    _joint_limit_poses,
    _replace_rows,
    frames_out_of_reach,
)
from animtool.ik.report import (
    GoalReport,
    MissedSpan,
    _miss_statistics,
    _missed_spans,
    _straightening_goal,
    far_target_notices,
    jump_notices,
    missed_notices,
    span_notices,
    take_notices,
)
from animtool.ik.result import IkResult
from animtool.ik.rig_solver import two_bone_obstacle
from animtool.ik.tracks import FreeEffector, GoalTrack, TargetTracks, swing_towards
from animtool.ik.values import (
    ArrayRows,
    ConstantValue,
    PrimPoint,
    PrimRotation,
    SampleFrames,
    blend_holds,
    hold_weights,
    interpolate_rows,
)
from animtool.maths import so3
from animtool.motion.motion import Channel
from animtool.rig.kinematics import forward_kinematics, rest_world
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.parts import IkChain
from animtool.rig.skeleton import Joint, JointType, Rig

X, Y, Z = np.eye(3)
HALF = so3.exp(np.array([0.0, 0, np.pi / 2]))


def test_a_pole_is_along_its_direction_as_the_joint_above_is_turned() -> None:
    """Off the root of a limb by ten times how far its tip is."""
    rig = Rig(
        "r",
        (
            Joint("top", -1, JointType.BALL, translation=(1.0, 2.0, 3.0)),
            Joint("a", 0, JointType.BALL, translation=(0.0, 1.0, 0.0)),
            Joint("b", 1, JointType.PIN, translation=(0.0, 2.0, 0.0)),
        ),
    )
    turns = np.stack([HALF, so3.IDENTITY, so3.IDENTITY])[None]
    world = forward_kinematics(rig, rig.rest_translations[None], turns)
    chain = IkChain("limb", "a", "b", "pose", (0.6, 0.0, 0.8))
    track: Any = SimpleNamespace(chain=chain)
    found = take_run._distant_pole(rig, track, world, 0)
    # Half a right angle about z takes x to y.
    expected = np.array([0.0, 2.0, 3.0]) + 20.0 * np.array([0, 0.6, 0.8])
    assert_allclose(found, expected, atol=1e-12)


def test_a_twist_is_at_its_limit_where_there_is_room_to_be_off_it() -> None:
    still = so3.IDENTITY[None]
    for wide, at in ((2.5, True), (1.5, False)):
        limit = BallLimit(None, (0.0, wide * result.LIMIT_TOLERANCE), (0.0, 1.0, 0.0))
        assert result._is_on_limit(limit, still).tolist() == [at]


def test_spans_hold_and_share_the_gap_between_them() -> None:
    """An ease is five frames; of a gap of four each has two."""
    times = np.arange(0.0, 31)
    first, second = hold_weights(times, [(6.0, 8.0), (12.0, 20.0)], 5.0)
    step = [0.05792, 0.31744, 0.68256, 0.94208]  # of t³ (10 - 15 t + 6 t²), by fifths
    assert_allclose(first[:13], [0, 0, *step, 1, 1, 1, 0.5, 0, 0, 0], atol=1e-12)
    assert_allclose(second[9:21], [0, 0, 0.5, *[1] * 9], atol=1e-12)
    assert_allclose(second[20:27], [1, *step[::-1], 0, 0], atol=1e-12)


def test_what_is_held_is_come_to_by_the_shortest_way() -> None:
    shares = np.array([[0.0, 0.25, 1.0]])
    points = blend_holds(np.full((3, 3), 2.0), shares, np.array([[6.0, 2, -2]]))
    assert_allclose(points, [[2, 2, 2], [3, 2, 1], [6, 2, -2]])
    turns = blend_holds(np.tile(so3.IDENTITY, (3, 1)), shares, -HALF[None])
    expected = [so3.IDENTITY, so3.exp(np.array([0, 0, np.pi / 8])), HALF]
    assert so3.angle_between(turns, np.array(expected)).max() < 1e-7


def test_rows_stand_at_frames_and_between_them() -> None:
    rows = np.array([[0.0, 0, 0], [4, 0, 8], [8, 2, 8]])
    own = ArrayRows("a.npz#b", rows, Fraction(10), (7, 3))
    frames = SampleFrames(np.array([10.0, 10.25, 12.0, 12 + 1e-10]), Fraction(24))
    assert_allclose(own.sample(frames), [rows[0], [1, 0, 2], rows[2], rows[2]])
    for beyond in (9.9, 12.1):
        with pytest.raises(
            OptionError, match="3 rows, for the frames 10 to 12"
        ) as error:
            own.sample(SampleFrames(np.array([11.0, beyond]), Fraction(24)))
        (fault,) = error.value.faults
        assert (fault.code, fault.lines, fault.column) == ("TGT015", (7,), 3)
        assert f"frame {beyond:g}" in fault.message
    free = replace(own, first=None)
    assert_allclose(
        free.sample(SampleFrames(np.array([1.0, 3.0]), Fraction(24))), rows[[0, 2]]
    )
    turns = interpolate_rows(
        np.array([so3.IDENTITY, HALF]), np.array([-1.0, 0.5, 0.9999999999])
    )
    expected = np.array([so3.IDENTITY, so3.exp(np.array([0, 0, np.pi / 4])), HALF])
    assert so3.angle_between(turns, expected).max() < 1e-7
    assert_array_equal(turns[2], HALF)


def test_what_a_prim_carries_is_asked_for_in_seconds() -> None:
    asked = []

    def motion(seconds: Any) -> Any:
        asked.append(seconds.tolist())
        return np.array([[1.0, 2, 3]] * 2), np.array([HALF, HALF])

    frames = SampleFrames(np.array([12.0, 36.0]), Fraction(24))
    assert_allclose(PrimPoint(motion, (1.0, 0, 5)).sample(frames), [[1, 3, 8]] * 2)
    turn = so3.exp(np.array([0.3, 0, 0]))
    found = PrimRotation(motion, tuple(turn.tolist())).sample(frames)
    assert_allclose(found, [so3.multiply(HALF, turn)] * 2, atol=1e-12)
    assert asked == [[0.5, 1.5]] * 2
    assert ConstantValue((1.0, 2.0)).sample(frames).tolist() == [[1, 2]] * 2


def test_vectors_swing_by_a_share_of_their_angle() -> None:
    found = swing_towards(
        np.array([2 * X, X, X]),
        np.array([4 * Y, 3 * X, -3 * X]),
        np.array([1 / 3, 0.5, 0.5]),
    )
    assert_allclose(found[0], [4 * np.cos(np.pi / 6), 2, 0], atol=1e-12)
    assert_allclose(found[1], 3 * X, atol=1e-12)
    assert np.linalg.norm(found[2]) == pytest.approx(3)
    assert found[2] @ X == pytest.approx(0, abs=1e-12)


def effector(**keys: Any) -> FreeEffector:
    """Return the tip of a limb of 0.3 m and 0.4 m that is bent by a right angle."""
    joints = (
        Joint("root", -1, JointType.BALL, translation=(1.0, 0.0, 0.0)),
        Joint("mid", 0, JointType.BALL, translation=(0.3, 0.0, 0.0)),
        Joint("tip", 1, JointType.BALL, translation=(0.0, 0.4, 0.0)),
    )
    rig = Rig("limb", joints)
    return FreeEffector(rig, Goal("tip", **keys), rest_world(rig))


def test_a_point_on_the_way_to_its_target_goes_straight_where_the_limb_is_bent() -> (
    None
):
    own = effector(offset=(0.0, 0.1, 0.0))
    assert_allclose(own.position(), [[1.3, 0.5, 0]])
    values = np.array([[1.7, 0.1, 0.4]])
    position, orientation, aim, pole = GOAL_KINDS
    for share, expected in (
        (0.0, values[0]),
        (0.25, [1.4, 0.4, 0.1]),
        (1.0, values[0]),
    ):
        found = own.blend_from_free_motion(position, values, np.array([share]))
        assert_allclose(found, [expected], atol=1e-12)
    turned = own.blend_from_free_motion(orientation, HALF[None], np.array([0.5]))
    assert so3.angle_between(turned, so3.exp(np.array([0, 0, np.pi / 4]))) < 1e-7
    # From z about the point, as far as its target is.
    found = own.blend_from_free_motion(aim, own.position() + 3 * X, np.array([0.5]))
    assert_allclose(
        found - own.position(), [[3 * 0.5**0.5, 0, 3 * 0.5**0.5]], atol=1e-12
    )
    # The middle stands off the line from the root to the tip, which it goes about.
    own = effector()
    root, line = np.array([1.0, 0, 0]), np.array([0.3, 0.4, 0])
    off = 0.3 * X - 0.09 / 0.25 * line
    found = own.blend_from_free_motion(pole, (root + 2 * Z)[None], np.array([0.5]))
    half = off / np.linalg.norm(off) + Z
    assert_allclose(found[0] - root, 2 * half / np.linalg.norm(half), atol=1e-9)


def test_a_straight_limb_goes_about_its_root_as_it_bends_evenly() -> None:
    joints = (
        Joint("root", -1, JointType.BALL),
        Joint("mid", 0, JointType.BALL, translation=(0.5, 0.0, 0.0)),
        Joint("tip", 1, JointType.BALL, translation=(0.5, 0.0, 0.0)),
    )
    rig = Rig("limb", joints)
    own = FreeEffector(rig, Goal("tip"), rest_world(rig))
    found = own.blend_from_free_motion(
        GOAL_KINDS[0], np.array([[0.0, 0.6, 0]]), np.array([0.5])
    )
    # It ends bent by 2 acos(0.6): half of that leaves cos(acos(0.6) / 2) of a metre.
    far = np.cos(np.arccos(0.6) / 2)
    assert_allclose(found, [[far * 0.5**0.5, far * 0.5**0.5, 0]], atol=1e-9)
    # What is out of reach is gone to beyond it.
    found = own.blend_from_free_motion(
        GOAL_KINDS[0], np.array([[0.0, 3.0, 0]]), np.array([0.5])
    )
    assert np.linalg.norm(found) == pytest.approx(2.0)
    assert own._has_fixed_root(0)
    assert not own._has_fixed_root(1)
    assert FreeEffector(rig, Goal("tip", root="mid"), own.world)._has_fixed_root(1)


def track(**keys: Any) -> GoalTrack:
    goal = Goal("tip")
    given: dict[str, Any] = {
        "name": "hand", "goal": goal, "chain": None,
        "values": dict.fromkeys(GOAL_PARTS)
        | {"position": ConstantValue((1.0, 2.0, 3.0))},
        "weights": {}, "spans": (), "ease": 2.0, "hold_parts": frozenset(),
    }  # fmt: skip
    return GoalTrack(**{**given, **keys})


def test_frames_of_a_targets_file_are_its_range_or_what_it_mentions() -> None:
    goals = (track(spans=((5.0, 9.0),)), track(during=((2.0, 30.0),)))
    own = TargetTracks(Path("a"), None, None, None, goals)
    clock = own.clock
    assert (clock.start, clock.count, clock.fps) == (2, 29, 24)
    ranged = replace(own, first=Fraction(3), last=Fraction(6), fps=Fraction(30)).clock
    assert (ranged.start, ranged.count, ranged.fps) == (3, 4, 30)
    assert replace(own, goals=(track(),)).clock.count == 1
    most = replace(own, first=Fraction(1), last=Fraction(10_000_001))
    with pytest.raises(OptionError) as error:
        assert most.clock
    assert error.value.code == "CLIP006"
    assert replace(most, last=Fraction(10_000_000)).clock.count == 10_000_000


def test_what_is_asked_in_spans_comes_and_goes_with_its_weight() -> None:
    rig, world = effector().rig, effector().world
    clock = replace(TargetTracks(Path("a"), None, Fraction(1), Fraction(9), ()).clock)
    every = np.repeat(world.positions, 9, 0), np.repeat(world.linear, 9, 0)
    whole = replace(world, positions=every[0], linear=every[1])
    goal = track(during=((4.0, 6.0),), weights={"position": ConstantValue((-0.5,))})
    plain = track(goal=Goal("tip", pole=0.0), during=((4.0, 6.0),))
    made = TargetTracks(Path("a"), None, None, None, (goal, plain)).sample(
        rig, clock, whole
    )
    weights = np.asarray(made.weights)
    assert not weights[:, 0, 0].any()
    assert weights[:, 1, 0].tolist() == [0, 0, 1, 1, 1, 1, 1, 0, 0]
    found = np.asarray(made.positions)[:, 1]
    assert_allclose(found[3:6], [[1, 2, 3]] * 3)
    start = effector().position()[0]
    assert_allclose(found[2], start + 0.5 * (np.array([1, 2, 3]) - start))
    assert_array_equal(np.asarray(made.rotations)[..., 3], 1)


@pytest.mark.parametrize(
    ("keys", "codes"),
    [
        ({}, []),
        ({"joint": "mip"}, ["TGT001"]),
        ({"root": "mip"}, ["TGT001"]),
        ({"root": "tip"}, []),
        ({"root": "root"}, []),
        ({"joint": "mid", "root": "tip"}, ["TGT012"]),
        ({"position": 0.0}, ["TGT002"]),
        ({"position": -1.0}, ["TGT007"]),
        ({"position": np.inf}, ["TGT007"]),
        ({"priority": -1}, ["IK002"]),
        ({"priority": 1.5}, ["IK002"]),
        ({"priority": 3}, []),
        ({"soft": 0.999}, []),
        ({"soft": 1.0}, ["IK002"]),
        ({"soft": -0.001}, ["IK002"]),
        ({"stretch": 0.0}, []),
        ({"stretch": np.inf}, ["IK002"]),
        ({"stretch": -0.1}, ["IK002"]),
        ({"offset": (1.0, 2.0)}, ["IK002"]),
        ({"offset": (MAX_COORDINATE, 0.0, 0.0)}, []),
        ({"offset": (2 * MAX_COORDINATE, 0.0, 0.0)}, ["IK002"]),
        ({"offset": (np.nan, 0.0, 0.0)}, ["IK002"]),
        ({"aim": 1.0, "aim_axis": (0.0, 0.0, 1.1)}, ["TGT008"]),
        ({"aim": 1.0, "aim_axis": (0.0, 0.0, 1 + 0.9e-6)}, []),
        ({"aim": 0.0, "aim_axis": (0.0, 0.0, 9.0)}, []),
    ],
)
def test_ends_of_what_a_goal_may_ask(keys: Any, codes: list[str]) -> None:
    goal = Goal(**{"joint": "tip", **keys})
    found = goal_faults(goal, effector().rig, "goals[4]")
    assert [fault.code for fault in found] == codes
    assert all(fault.where == "goals[4]" for fault in found)


def test_goals_count_their_residuals_and_say_whether_they_pivot() -> None:
    rows = {"position": 3, "orientation": 3, "aim": 2, "pole": 1}
    for part, count in rows.items():
        own = Goal("tip", **{"position": 0.0, part: 2.0})
        assert (own.rows, [kind.name for kind in own.kinds]) == (count, [part])
    whole = Goal("tip", orientation=1.0, aim=2.0, pole=3.0)
    assert (whole.rows, whole.weights) == (9, (1.0, 1.0, 2.0, 3.0))
    assert Goal("tip").ignores_joint_rotation
    assert Goal("tip", pole=1.0).ignores_joint_rotation
    for keys in ({"offset": (0.0, 0, 1e-9)}, {"orientation": 1.0}, {"aim": 1.0}):
        assert not Goal("tip", **keys).ignores_joint_rotation


def test_targets_side_by_side() -> None:
    goals = (Goal("a"), Goal("b", position=0.0, aim=1.0))
    x = np.arange(6.0).reshape(1, 2, 3)
    packed = pack(Targets(x, aims=x * 1e120, weights=[[[1, 2, 3, 4]] * 2]), goals)
    assert packed.shape == (1, 2, WEIGHT_COLUMNS.stop)
    assert_array_equal(packed[0, :, TARGET_COLUMNS["position"]], x[0])
    assert_array_equal(packed[0, :, TARGET_COLUMNS["orientation"]], [so3.IDENTITY] * 2)
    assert_array_equal(packed[0, :, WEIGHT_COLUMNS], [[1, 2, 3, 4]] * 2)
    # Of aims directions count alone: they are brought in to where they have squares.
    assert_allclose(
        packed[0, 1, TARGET_COLUMNS["aim"]], MAX_COORDINATE * np.array([0.6, 0.8, 1])
    )
    assert pack(Targets(x, aims=x), goals)[0, 0, WEIGHT_COLUMNS].tolist() == [1] * 4
    some = targets_of_frames(Targets(np.arange(5.0)), np.array([3, 1]))
    assert np.asarray(some.positions).tolist() == [3, 1]
    assert some.rotations is None


@pytest.mark.parametrize(
    ("given", "code", "text"),
    [
        ({"aims": 1}, "IK010", "goal 0 needs positions"),
        ({"positions": 1}, "IK010", "goal 1 needs aims"),
        ({"positions": 2, "aims": 3}, "IK010", r"targets of \[2, 3\] problems"),
        (
            {"positions": 1, "aims": 1, "weights": [[[1, 1, -1, 1]] * 2]},
            "TGT007", r"weights\[0, 0\]",
        ),
        ({"positions": [[[0, 0, 0], [np.nan, 0, 0]]], "aims": 1}, None, ""),
        (
            {"positions": [[[0, np.inf, 0], [0, 0, 0]]], "aims": 1},
            "TGT007", r"positions\[0, 0\] are",
        ),
        ({"positions": [["a"]], "aims": 1}, "IK010", "positions must be numbers"),
        ({"positions": [[0, 0, 0]], "aims": 1}, "IK010", r"\(B, 2, 3\), not \(1, 3\)"),
    ],
)  # fmt: skip
def test_targets_that_are_missing_or_no_numbers(
    given: Any, code: Any, text: str
) -> None:
    goals = (Goal("a"), Goal("b", position=0.0, aim=1.0))
    own = {k: np.ones((v, 2, 3)) if isinstance(v, int) else v for k, v in given.items()}
    if code is None:
        assert np.isfinite(pack(Targets(**own), goals)).all()
        return
    with pytest.raises(OptionError, match=text) as error:
        pack(Targets(**own), goals)
    assert code in [fault.code for fault in error.value.faults]


def test_a_limb_is_told_by_the_joints_next_above_or_halfway_to_its_root() -> None:
    rig = arm(5)
    origins = np.array([[0.0, 0, 0], [4, 0, 0], [5, 0, 0], [5, 0, 0], [9, 0, 0]])
    every, point = set(range(5)), np.array([10.0, 0, 0])
    assert limb_joints(rig, Goal("b4"), every, origins, point) == (3, 4)
    assert limb_joints(rig, Goal("b4"), every, origins, origins[4]) == (1, 3)
    assert limb_joints(rig, Goal("b4", root="b0"), every, origins, point) == (0, 3)
    assert limb_joints(rig, Goal("b4", root="b0"), {0, 1, 4}, origins, point) == (0, 1)
    assert limb_joints(rig, Goal("b4", root="b4"), every, origins, point) is None
    assert limb_joints(rig, Goal("b4"), {0}, origins, point) is None


def test_angles_of_two_bones() -> None:
    a, b = np.full(5, 0.3), np.full(5, 0.4)
    found = bend_angle(a, b, np.array([0.7, 9.0, 0.5, 0.1, 0.0]))
    assert_allclose(found, [0, 0, np.pi / 2, np.pi, np.pi], atol=1e-7)
    ways = perpendicular_vectors(np.array([X, 3 * Y, X + Y]))
    assert_allclose((ways * [X, 3 * Y, X + Y]).sum(axis=1), 0, atol=1e-12)


@pytest.mark.parametrize(
    ("goal", "fits"),
    [
        ({}, True), ({"pole": 1.0}, True), ({"orientation": 1.0}, False),
        ({"position": 0.0, "pole": 1.0}, False),
    ],
)  # fmt: skip
def test_a_limb_of_two_bones_has_one_position(goal: Any, fits: bool) -> None:
    own = Goal("elbow", (0.27, 0.0, 0.0), **goal)
    assert (two_bone_obstacle(build(limb(), [own])) is None) is fits
    bent = limb()
    limited = replace(bent.joints[1], limits=RangeLimit(-1.0, 1.0))
    held_ = replace(bent, joints=(bent.joints[0], limited))
    assert two_bone_obstacle(build(held_, [Goal("elbow", (0.27, 0.0, 0.0))])) is None
    assert two_bone_obstacle(build(bent, [Goal("elbow", (0.27, 0.0, 0.1))]))


def test_poles_stand_half_a_limb_off_its_line() -> None:
    """Where it is straight on the side it had before; without any on its usual one."""
    unit, longer = _normalize(np.array([[3.0, 0, 4], [0, 0, 0.1]]), 0.1)
    assert_allclose(unit[0], [0.6, 0, 0.8])
    assert longer.tolist() == [True, False]

    def poles(middles: Any, usual: Any = Y, hinge: Any = (0, 0, 0)) -> np.ndarray:
        places = np.array([[[0.0, 0, 0], m, [2, 0, 0]] for m in middles])
        linear = np.tile(np.eye(3), (len(places), 3, 1, 1))
        own = _BendingLimb(0, 1, 2, 2.4, np.array(usual, float), np.array(hinge, float))
        world: Any = SimpleNamespace(positions=places, linear=linear)
        return _pole_positions(own, world)

    found = poles([[0.5, 0, -0.3], [1, 0, 0], [1, 0.2, 0], [1.5, 0, 0]])
    assert_allclose(found, [[0.5, 0, -1.2], [1, 0, -1.2], [1, 1.2, 0], [1.5, 1.2, 0]])
    found = poles([[1, 0, 0], [1, 0.2, 0]])
    assert_allclose(found, [[1, 1.2, 0], [1, 1.2, 0]])
    assert_allclose(poles([[1, 0, 0]]), [[1, 1.2, 0]])
    assert_allclose(poles([[1, 0, 0]], Y + Z, Z), [[1, 1.2, 0]])
    # Within five millionths of the limb it has no side.
    assert_allclose(poles([[1, 0, 1.1e-5]]), [[1, 1.2, 0]], atol=1e-4)
    assert_allclose(poles([[1, 0, 1.3e-5]]), [[1, 0, 1.2]], atol=1e-4)
    # What is usual lies along the limb: any side will do.
    (pole,) = poles([[1, 0, 0]], X)
    assert np.linalg.norm(pole - X) == pytest.approx(1.2)
    assert pole[0] == pytest.approx(1)


def test_joints_that_leave_their_rest_in_any_frame_and_along_any_axis() -> None:
    rest = np.zeros((3, 3))
    values = np.zeros((4, 3, 3))
    values[2, 1, 2] = 2e-6
    values[3, 2, 0] = 0.5e-6
    assert _joints_off_rest(Channel.from_dense(values), rest, {0, 1, 2}) == {1}
    assert _joints_off_rest(Channel.from_dense(values), rest, {0, 2}) == set()
    turns = np.tile(so3.IDENTITY, (4, 3, 1))
    turns[1, 2] = so3.exp(np.array([0, 0, 3e-6]))
    own = np.tile(so3.IDENTITY, (3, 1))
    assert _joints_off_rest(Channel.from_dense(turns), own, {0, 1, 2}) == {2}


def test_chains_are_named_or_all() -> None:
    chains = tuple(IkChain(n, "b0", "b1") for n in ("arm_l", "arm_r", "leg_l"))
    rig = replace(arm(2), chains=chains)
    assert match_chains(rig) == chains
    assert [c.name for c in match_chains(rig, ["*_l", "arm_r"])] == [
        "arm_l",
        "arm_r",
        "leg_l",
    ]
    with pytest.raises(OptionError) as error:
        match_chains(rig, ["arm*", "foot", "hand?"])
    assert [fault.code for fault in error.value.faults] == ["TGT001"] * 2
    with pytest.raises(OptionError) as error:
        match_chains(arm(2))
    assert error.value.code == "TGT019"


def test_what_targets_leave_out_is_what_carries_chains_or_does_not_stretch() -> None:
    rig = arm(4)
    for stretch, moves, named in (
        (0.0, {0: "t"}, ["b0"]), (0.0, {0: "r"}, ["b0"]), (0.0, {1: "r"}, []),
        (0.0, {1: "t"}, ["b1"]), (0.0, {2: "t"}, ["b2"]), (0.5, {2: "t"}, []),
        (0.5, {1: "t"}, ["b1"]), (0.0, {3: "t"}, []),
    ):  # fmt: skip
        places = np.repeat(rig.rest_translations[None], 3, axis=0)
        turns = np.repeat(rig.rest_rotations[None], 3, axis=0)
        for j, kind in moves.items():
            if kind == "t":
                places[1, j] += 0.1
            else:
                turns[1, j] = so3.multiply(turns[1, j], HALF)
        motion = SimpleNamespace(
            translations=Channel.from_dense(places), rotations=Channel.from_dense(turns)
        )
        take: Any = SimpleNamespace(rig=rig, motion=motion)
        found = untracked_motion_notices(
            take, [IkChain("c", "b1", "b2", stretch=stretch)]
        )
        assert [fault.code for fault in found] == ["TGT103"] * bool(named)
        assert all(name in found[0].message for name in named)


def test_misses_and_their_spans() -> None:
    times = np.array([10.0, 11, 12, 13, 14])
    found = _miss_statistics("aim", times, np.array([0.1, 0.5, 0.2, 0.5, 0.0]))
    assert (found.frames, found.max, found.frame, found.is_length) == (
        5,
        0.5,
        11,
        False,
    )
    assert found.mean == pytest.approx(0.26)
    assert _miss_statistics("position", times[:1], np.ones(1)).is_length
    rows = np.zeros((5, 4))
    rows[:, 0] = [0.3, 0.1, 0, 0, 0.2]
    rows[:, 1] = [0.0, 0.5, 0, 0, 0.1]
    statuses = [IkStatus.NEAREST, IkStatus.BUDGET, IkStatus.CONVERGED] + [
        IkStatus.STEADIER
    ] * 2
    solved: Any = SimpleNamespace(
        take=SimpleNamespace(clock=SimpleNamespace(times=times)),
        statuses=tuple(statuses),
    )
    one, two = _missed_spans(solved, rows, np.array([1, 1, 0, 0, 1], bool))
    assert (one.first, one.last, one.frame) == (10, 11, 11)
    assert (one.distance, one.angle, one.status) == (0.3, 0.5, IkStatus.BUDGET)
    assert (two.first, two.last, two.status) == (14, 14, IkStatus.STEADIER)


@pytest.mark.parametrize(
    ("span", "told"),
    [((1.0, 9.9), 1), ((1.0, 10.0), 0), ((14.0, 20.0), 0), ((14.1, 20.0), 1)],
)
def test_spans_to_hold_that_no_frame_is_in_are_told(span: Any, told: int) -> None:
    tracks = TargetTracks(Path("a"), None, None, None, (track(spans=(span,)),))
    for times, count in ((np.arange(10.0, 15), told), (np.array([12.0]), 0)):
        clock = SimpleNamespace(times=times)
        solved: Any = SimpleNamespace(take=SimpleNamespace(clock=clock), tracks=tracks)
        assert [f.code for f in span_notices(solved)] == ["TGT104"] * count


def outcome(count: int) -> IkResult:
    problem = build(limb(), [Goal("elbow", (0.27, 0.0, 0.0), stretch=0.5)])
    rows = np.arange(float(count))[:, None]
    return IkResult(
        problem, np.tile(np.array([0.0, 0, 0, 1, 0.3]), (count, 1)),
        (IkStatus.NEAREST,) * count, rows[:, 0].astype(int), rows[:, 0].astype(int),
        rows[:, 0], np.tile(rows[:, :, None], (1, 1, 4)), rows > 9, 1 + rows,
    )  # fmt: skip


def test_rows_of_a_result_are_picked_and_placed() -> None:
    whole, other = outcome(5), replace(outcome(2), statuses=(IkStatus.BUDGET,) * 2)
    some = whole.select(np.array([4, 2]))
    assert some.seconds.tolist() == [4, 2]
    made = _replace_rows(whole, other, np.array([3]), np.array([1]))
    assert made.seconds.tolist() == [0, 1, 2, 1, 4]
    assert made.statuses[3] is IkStatus.BUDGET
    assert [s is IkStatus.NEAREST for s in made.statuses].count(True) == 4
    assert _replace_rows(whole, other, np.zeros(0, int), np.zeros(0, int)) is whole
    free: Any = SimpleNamespace(seconds=0.0, restarts=4)
    assert frames_out_of_reach(made, free).tolist() == [0, 1, 2, 4]
    for keys in ({"seconds": 1.0, "restarts": 4}, {"seconds": 0.0, "restarts": 0}):
        assert not len(frames_out_of_reach(made, SimpleNamespace(**keys)))  # type: ignore[arg-type]
    assert [whole.positions[2, 0], whole.aims[3, 0]] == [2, 3]
    assert whole.missed == [(b, 0) for b in range(5)]
    lengths = np.linalg.norm(whole.local_translations(), axis=2)
    rest = np.linalg.norm(limb().rest_translations, axis=1)
    assert_allclose(lengths[:, 1], rest[1] * (1 + np.arange(5)))
    assert_allclose(lengths[:, 0], rest[0])


def test_starts_are_ends_and_middles_of_limits() -> None:
    rig = arm(4, 1.0)
    problem = build(rig, [Goal("b3", (0.4, 0.0, 0.0))])
    home = problem.chain.from_rig(np.full((1, 4), 0.25))[0]
    found = np.array(list(_joint_limit_poses(problem.chain, home, 27)))
    assert found.shape == (27, 4)
    assert sorted({*found[:, 0].tolist()}) == pytest.approx([-1, 0, 1], abs=1e-9)
    assert_allclose(found[:, 3], home[3])
    assert len(list(_joint_limit_poses(problem.chain, home, 3))) == 3
    assert len(list(_joint_limit_poses(problem.chain, home, 2))) == 1


@pytest.mark.parametrize(
    ("rest", "moving", "refused"),
    [(1.0, 1.0, False), (1.0, 1.1, True), (2.0, None, True), (1.0, None, False)],
)
def test_what_hangs_from_a_scaled_joint_is_refused(
    rest: float, moving: float | None, refused: bool
) -> None:
    """In any frame, along any axis, and above the effector alone."""
    rig = arm(3)
    rests = np.ones((3, 3))
    rests[1, 2] = rest
    values = np.ones((4, 1, 3))
    values[2, 0, 1] = moving or 1.0
    animated = np.array([1] if moving else [], np.int64)
    channel = Channel(rests, animated, values[:, : len(animated)])
    take: Any = SimpleNamespace(rig=rig, motion=SimpleNamespace(scales=channel))
    check_scales(take, [("hand", "b0")])
    if not refused:
        check_scales(take, [("hand", "b2")])
        return
    with pytest.raises(OptionError, match="'hand' is below 'b1'") as error:
        check_scales(take, [("hand", "b2")])
    assert error.value.code == "TGT016"
    bare: Any = SimpleNamespace(rig=rig, motion=SimpleNamespace(scales=None))
    check_scales(bare, [("hand", "b2")])


def told(**keys: Any) -> Any:
    """Return what was solved of a limb, as reports see it."""
    problem = build(limb(), [Goal("elbow", (0.27, 0.0, 0.0))])
    own = track(name="hand", goal=problem.goals[0])
    given = {
        "problem": problem,
        "take": SimpleNamespace(
            rig=problem.rig, clock=SimpleNamespace(times=np.arange(10.0, 15), fps=24)
        ),
        "tracks": SimpleNamespace(goals=(own,), path=Path("p")),
        "statuses": (IkStatus.CONVERGED,) * 5,
        "misses": np.zeros((5, 1, 4)), "active": np.ones((5, 1, 4), bool),
        "away": [19.0], "size": 1.0, "moving_between": (), "jumps": (),
        "steadier": None,
        "on_limits": {}, "open_poles": None,
    }  # fmt: skip
    return SimpleNamespace(**{**given, **keys})


def span(**keys: Any) -> MissedSpan:
    given = {
        "first": 10.0, "last": 12.0, "distance": 0.0, "angle": 0.0, "frame": 11.0,
        "status": IkStatus.NEAREST,
    }  # fmt: skip
    return MissedSpan(**{**given, **keys})


def test_targets_twenty_sizes_away_are_told_where_they_are_not_missed() -> None:
    fine = [GoalReport("hand", "elbow", (3, 4), (), ())]
    assert far_target_notices(told(target_distances=[20.0]), fine) == []
    (found,) = far_target_notices(told(target_distances=[20.1]), fine)
    assert (found.code, found.lines, found.column, found.where) == (
        "TGT106", (1,), 1, "goals[0]"
    )  # fmt: skip
    assert "20.1 m from its start, but the rig is 1 m large" in found.message
    missed = [replace(fine[0], spans=(span(),))]
    assert far_target_notices(told(target_distances=[20.1]), missed) == []
    assert [n.code for n in take_notices(told(target_distances=[20.1]), fine)] == [
        "TGT106"
    ]


def test_what_is_missed_is_told_in_lengths_and_angles() -> None:
    rows = (span(distance=0.25), span(first=14.0, last=14.0, angle=np.radians(30.0)))
    (found,) = missed_notices(told(), [GoalReport("hand", "elbow", (3, 4), (), rows)])
    assert found.code == "IK101"
    assert found.message.startswith(
        "'hand' does not reach its target at frames 10 to 12, frame 14: "
    )
    assert "30" in found.message
    assert found.hint is None
    both = (span(distance=0.25, angle=np.radians(2.0)),)
    (found,) = missed_notices(told(), [GoalReport("hand", "elbow", (3, 4), (), both)])
    assert "25 cm and 2" in found.message or "250 mm and 2" in found.message
    for rows in ((span(distance=0.25),), (span(angle=np.radians(2.0)),)):
        (found,) = missed_notices(
            told(), [GoalReport("hand", "elbow", (3, 4), (), rows)]
        )
        assert " and " not in found.message.partition(" off ")[0]
    for status, word in (
        (IkStatus.BUDGET, "the step or time limit was reached: raise"),
        (IkStatus.NEAREST, "far out"),
    ):
        far = 100.0 if status is IkStatus.NEAREST else 0.1
        rows = (span(distance=far, status=status),)
        (found,) = missed_notices(
            told(), [GoalReport("hand", "elbow", (3, 4), (), rows)]
        )
        assert word in str(found.hint)


@pytest.mark.parametrize(
    ("joint", "missed", "asked", "soft", "snaps"),
    [
        ("elbow", (0.0, 0.1), True, 0.0, True),
        ("elbow", (0.1, 0.0), True, 0.0, True),
        ("elbow", (0.1, 0.1), True, 0.0, False),
        ("elbow", (0.0, 0.1), False, 0.0, False),
        ("elbow", (0.0, 0.1), True, 0.2, False),
        ("shoulder", (0.0, 0.1), True, 0.0, False),
    ],
)
def test_a_pin_that_snaps_where_its_goal_comes_out_of_reach_may_be_eased(
    joint: str, missed: Any, asked: bool, soft: float, snaps: bool
) -> None:
    misses, wanted = np.zeros((5, 1, 4)), np.ones((5, 1, 4), bool)
    misses[1:3, 0, 0] = missed
    wanted[2, 0, 0] = asked
    own = told(misses=misses, active=wanted)
    goal = replace(own.problem.goals[0], soft=soft)
    own.tracks.goals = (track(name="hand", goal=goal),)
    names = own.problem.rig.names
    jump = Jump(2, joint if joint in names else names[0], 0.9)
    assert _straightening_goal(own, jump) == ("hand" if snaps else None)
    hint = jump_notices(SimpleNamespace(**{**vars(own), "jumps": (jump,)}))[0].hint
    assert ("'hand' eases it" in str(hint)) is snaps


@pytest.mark.parametrize("offset", [0.1, -0.1])
def test_a_limb_reaches_what_its_last_bone_carries(offset: float) -> None:
    """Bones of 0.32 m and 0.27 m, and a point that no bone stretches to."""
    joints = (*limb().joints, Joint("hand", 1, JointType.FIXED, (0.27, 0.0, 0.0)))
    goal = Goal("hand", (offset, 0.0, 0.0), soft=0.1, stretch=0.2)
    problem = build(Rig("limb", joints), [goal])
    (own,) = problem.limbs
    assert own.max_length * problem.length == pytest.approx(0.59 + offset)
    assert own.bone_length * problem.length == pytest.approx(0.59)
    assert (own.goal, own.joints) == (0, (2, 1))
    assert_allclose(own.origin * problem.length, limb().rest_translations[0])


@pytest.mark.parametrize(
    ("last", "moving", "kept"),
    [(2.0, False, True), (3.0, False, False), (4.0, False, False), (9.0, True, True)],
)
def test_what_comes_after_a_window_is_kept_where_it_ends_as_before(
    last: float, moving: bool, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frame k is at k; a window of frames 1 and 2 ends at another place or does not."""
    names = ClipPath.with_window.__globals__
    monkeypatch.setitem(names, "joint_steps", lambda _, a, b: np.asarray(a - b))
    monkeypatch.setitem(
        names, "with_poses", lambda *_: SimpleNamespace(coordinates=[7])
    )
    monkeypatch.setitem(names, "_concatenate", lambda parts: parts)

    class Path:
        problem = SimpleNamespace(chain=None)
        frame_path = SimpleNamespace(
            select_frames=lambda _: SimpleNamespace(measure_misses=lambda poses: poses)
        )
        start = np.zeros((6, 1))
        chain_poses = staticmethod(lambda _: np.arange(6.0)[:, None])
        solve_frames = staticmethod(
            lambda rest, starts: ("solved", rest.start, starts[0, 0])
        )

        def __len__(self) -> int:
            return 6

    own: Any = Path()
    result: Any = SimpleNamespace(select=lambda rows: (rows.start, rows.stop))
    own.is_motion = moving
    parts = ClipPath.with_window(own, result, slice(1, 3), np.array([[8.0], [last]]))  # type: ignore[arg-type]
    assert parts[0] == (0, 1)  # type: ignore[index]
    assert parts[2:] == ([(3, 6)] if kept else [("solved", 3, 7.0)])  # type: ignore[index]
    own.__class__.__len__ = lambda _: 3
    end = ClipPath.with_window(own, result, slice(1, 3), np.array([[8.0], [last]]))  # type: ignore[arg-type]
    assert len(end) == 2


def test_paths_are_neither_closed_nor_opened_unless_that_is_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What is away from the clip costs its square, by a price."""
    asked: list[Any] = []

    def best(*given: Any, **keys: bool) -> str:
        asked.append((given[2].tolist(), keys))
        return "best"

    names = ClipPath.best_route.__globals__
    monkeypatch.setitem(names, "best_path", best)
    monkeypatch.setitem(
        names, "equalize_near_misses", lambda costs, slack: costs + slack
    )
    monkeypatch.setitem(names, "joint_steps", lambda _, a, b: b - a)
    own: Any = SimpleNamespace(slack=10.0, problem=SimpleNamespace(chain=None))
    interval: Any = SimpleNamespace(reference_poses=np.zeros((2, 3)))
    paths, costs = np.full((1, 2, 3), 2.0), np.array([[1.0, 2]])
    assert ClipPath.best_route(own, interval, paths, costs) == "best"
    assert asked.pop() == ([[11, 12]], {"is_end_fixed": False, "is_start_free": False})
    ClipPath.best_route(
        own,
        interval,
        paths,
        costs,
        is_end_fixed=True,
        is_start_free=True,
        source_weight=0.5,
    )
    assert asked.pop() == ([[17, 18]], {"is_end_fixed": True, "is_start_free": True})
