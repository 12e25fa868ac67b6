"""How a skeleton follows another, and what is measured of it, in numbers."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from animtool.core.shot import FrameRange
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.motion.scores import PassScores, Score, ScoreUnit
from animtool.retarget.drift import (
    _angle_about_up,
    _integrate,
    _least_squares_rate,
    _root_correction,
    _StanceTracks,
    _windowed_medians,
)
from animtool.retarget.map import JointMap, JointPair
from animtool.retarget.poses import (
    LocalRotations,
    _clamp_to_limits,
    _normalize,
    _twist_joint,
    relative_to_hips,
    root_translations,
    twist_to_hinge_axes,
    world_rotations,
)
from animtool.retarget.report import (
    ContactFrames,
    FitMeter,
    _drift_in_contacts,
    _mean_clamped,
    _reach_errors,
    fit_scores,
)
from animtool.retarget.roled_skeleton import Ball, RoledSkeleton
from animtool.retarget.roles import RoleSource
from animtool.retarget.transfer import (
    Transfer,
    _fraction_middles,
    _heading_alignment,
    _leg_ratio,
    equal_name_pairs,
    middle_of_hips,
)
from animtool.retarget.verdict import FrameNumbers, TakeStatus, assess_take
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig

X, Y, Z = np.eye(3)
ROLES = (
    "hips", "spine", "head", "thigh_l", "shin_l", "foot_l", "thigh_r", "shin_r",
    "foot_r", "upper_arm_l", "forearm_l", "hand_l", "",
)  # fmt: skip


def turn(axis: np.ndarray, degrees: float) -> np.ndarray:
    return so3.from_axis_angle(axis, np.radians(degrees))


def body(size: float = 1.0, shin: float = 0.4, up: UpAxis = UpAxis.Y) -> RoledSkeleton:
    """Return a person who faces z, of bones of their own lengths."""
    rows: list[tuple[str, int, tuple[float, float, float]]] = [
        ("hips", -1, (0, 1, 0)), ("spine", 0, (0, 0.2, 0)), ("head", 1, (0, 0.4, 0)),
        ("lt", 0, (0.1, -0.05, 0)), ("ls", 3, (0, -0.45, 0)), ("lf", 4, (0, -shin, 0)),
        ("rt", 0, (-0.1, -0.05, 0)), ("rs", 6, (0, -0.45, 0)), ("rf", 7, (0, -shin, 0)),
        ("la", 1, (0.2, 0.3, 0)), ("lw", 9, (0.3, 0, 0)), ("lh", 10, (0.25, 0, 0)),
        ("tail", 0, (0, 0, -0.3)),
    ]  # fmt: skip
    joints = [
        Joint(name, parent, translation=tuple(size * np.array(way)))
        for name, parent, way in rows
    ]
    return RoledSkeleton.of(Rig("body", tuple(joints), up=up), ROLES)


def pair(source: int, target: int, role: str = "") -> JointPair:
    return JointPair(source, target, role, RoleSource.NAME, 1.0)


def mapped(pairs: list[JointPair], **keys: Any) -> JointMap:
    given: dict[str, Any] = {
        "pairs": tuple(pairs), "chains": (), "twists": (), "unmapped_source": (),
        "unmapped_target": (), "source": None, "target": None, "notices": (),
    }  # fmt: skip
    return JointMap(**{**given, **keys})


WHOLE = [pair(j, j, role) for j, role in enumerate(ROLES[:-1])]


def test_lengths_and_directions_of_a_person() -> None:
    own = body()
    assert own.leg_length("l") == pytest.approx(0.85)
    assert own.leg_length("x") == 0
    assert own.leg("l") == (3, 4, 5, -1)
    assert (
        own.first_joint("spine"),
        own.first_joint("jaw"),
        own.last_joint("jaw"),
    ) == (1, -1, -1)
    assert own.size == pytest.approx(1.5)
    ways = own.chain_lengths
    assert ways[0] == 0
    assert ways[[5, 11]] == pytest.approx(
        [np.hypot(0.1, 0.05) + 0.85, 0.2 + np.hypot(0.2, 0.3) + 0.55]
    )
    assert_allclose(own.facing_axes, np.eye(3), atol=1e-12)
    assert_allclose(own.leg_bone_lengths("l"), [0.45, 0.4])
    balled = replace(own, balls={"l": Ball(-1, np.array([0, 0, 0.2]))})
    assert_allclose(balled.leg_bone_lengths("l"), [0.45, 0.4, 0.2])
    assert_allclose(balled.bone_direction(5), Z)
    assert own.bone_direction(5) is None
    assert_allclose(own.bone_direction(9), X)
    assert_allclose(own.offset(0, 4), [0.1, -0.5, 0], atol=1e-12)
    assert own.are_distinct(0, 1)
    assert not own.are_distinct(1, 1)


# No joint follows another.
NONE = np.full(13, -1)


def test_the_scale_is_that_of_legs_or_of_what_there_is_of_a_body() -> None:
    assert _leg_ratio(body(), body(2.0), NONE) == pytest.approx(2)
    assert _leg_ratio(body(), body(1.0, 0.6), NONE) == pytest.approx(1.05 / 0.85)

    def armed(person: RoledSkeleton) -> RoledSkeleton:
        roles = tuple("" if "_" in r and r != "upper_arm_l" else r for r in ROLES)
        return replace(person, roles=roles)

    longer = armed(body(3.0))
    assert _leg_ratio(armed(body()), longer, NONE) == pytest.approx(3)
    nothing = replace(body(), roles=("",) * 13)
    assert _leg_ratio(nothing, nothing, NONE) == 1
    larger = replace(body(2.0), roles=("",) * 13)
    assert _leg_ratio(nothing, larger, NONE) == 1
    assert _leg_ratio(nothing, larger, np.arange(13)) == pytest.approx(2)


def test_middles_and_what_hangs_below() -> None:
    assert_allclose(_fraction_middles([0.0, 0.2, 0.6]), [0.1, 0.4, 0.8])
    own = body()
    below = [own.children_with_role(joint)[:1] for joint in (9, 4, 2, 0)]
    assert below == [[10], [5], [], [1]]
    assert_allclose(middle_of_hips(own, own.positions[None]), [[0, 0.95, 0]])
    one = replace(own, roles=(*ROLES[:6], *("",) * 7))
    assert_allclose(middle_of_hips(one, one.positions[None]), [[0, 1, 0]])
    rigs = own.rig, own.rig
    follows = np.full(13, -1)
    follows[:4] = np.arange(4)
    assert equal_name_pairs(*rigs, follows)[0] == (4, 4)
    follows[:] = np.arange(13)
    follows[12] = -1
    assert equal_name_pairs(*rigs, follows) == [(12, 12)]
    follows[3] = 12
    assert equal_name_pairs(*rigs, follows) == []


def test_who_faces_another_way_is_turned_about_the_vertical() -> None:
    own = body()
    other = RoledSkeleton.of(own.rig, ROLES, np.concatenate(
        [turn(Y, 70)[None], np.tile(so3.IDENTITY, (12, 1))]
    ))  # fmt: skip
    for one, two, degrees in ((other, own, 70), (own, other, -70)):
        found = _heading_alignment(one, two, so3.IDENTITY, Y)
        assert so3.angle_between(found, turn(Y, degrees)) < 1e-9
    lying = RoledSkeleton.of(own.rig, ROLES, np.concatenate(
        [turn(X, 90)[None], np.tile(so3.IDENTITY, (12, 1))]
    ))  # fmt: skip
    found = _heading_alignment(lying, own, so3.IDENTITY, Y)
    assert so3.angle_between(found, turn(X, 90)) == pytest.approx(0, abs=1e-9)
    leaning = RoledSkeleton.of(own.rig, ROLES, np.concatenate(
        [turn(X, 30)[None], np.tile(so3.IDENTITY, (12, 1))]
    ))  # fmt: skip
    assert_allclose(
        _heading_alignment(leaning, own, so3.IDENTITY, Y), so3.IDENTITY, atol=1e-9
    )


def test_turns_follow_by_the_change_from_rest() -> None:
    own = body()
    made = Transfer.of(own, body(2.0), mapped(WHOLE))
    assert made.scale == pytest.approx(2)
    assert made.has_similar_legs
    assert made.source_joints.tolist() == list(range(13))  # tails have one name
    world = np.tile(so3.IDENTITY, (1, 13, 1))
    world[0, 3:6] = turn(X, 40)
    found = made.rotations(world)
    assert_allclose(found[0], world[0], atol=1e-12)
    assert_allclose(made.hips(own.positions[None]), [[0, 1.9, 0]])
    less = Transfer.of(own, body(), mapped([p for p in WHOLE if p.target != 4]))
    # A shin that follows none, but for its name.
    assert less.source_joints[4] == 4
    free = replace(
        less, source_joints=np.where(np.arange(13) == 4, -1, less.source_joints)
    )
    assert_allclose(free.rotations(world)[0, 4], turn(X, 40), atol=1e-12)
    halved = replace(
        less,
        next_source_joints=np.where(np.arange(13) == 1, 3, less.next_source_joints),
        next_weights=np.full(13, 0.25),
    )
    assert_allclose(halved.rotations(world)[0, 1], turn(X, 10), atol=1e-9)


def test_axes_of_the_target_are_those_of_its_up() -> None:
    own, tall = body(), body(up=UpAxis.Z)
    made = Transfer.of(own, tall, mapped(WHOLE))
    assert_allclose(
        made.to_target_axes(np.array([[1.0, 2, 3]])), [[1, -3, 2]], atol=1e-12
    )
    world = np.tile(turn(Y, 30), (1, 13, 1))
    changed = so3.multiply(made.rotations(world), so3.conjugate(made.rest_alignment))
    assert_allclose(np.abs(changed[0, 0]), np.abs(turn(Z, 30)), atol=1e-9)
    same = Transfer.of(own, own, mapped(WHOLE))
    points = np.ones((2, 3))
    assert same.to_target_axes(points) is points


def test_bones_that_stretch_do_so_by_the_scale() -> None:
    own = body()
    made = Transfer.of(own, body(2.0), mapped(WHOLE))
    places = np.repeat(own.rig.rest_translations[None], 2, axis=0)
    world = np.tile(so3.IDENTITY, (2, 13, 1))
    turns = np.tile(turn(X, 90), (2, 13, 1))
    assert_array_equal(
        made.bones(world, places, turns), made.target.rig.rest_translations[None]
    )
    places[1, 5] += [0, -0.1, 0]
    places[1, 0] += [5, 5, 5]
    found = made.bones(world, places, turns)
    rest = made.target.rig.rest_translations
    assert_allclose(found[0], rest)
    off = found[1] - rest
    # A quarter about x: down in the world is along z of who is turned so.
    assert_allclose(
        off[5], so3.rotate(so3.conjugate(turn(X, 90)), [0, -0.2, 0]), atol=1e-12
    )
    assert_allclose(np.delete(off, 5, axis=0), 0)


@pytest.mark.parametrize(
    ("target", "balls", "alike"),
    [
        (body(3.0), ({}, {}), True),
        (body(1.0, 0.42), ({}, {}), False),
        (body(), ({"l": Ball(2, Z)}, {"l": Ball(-1, Z)}), False),
        (body(), ({"l": Ball(2, Z)}, {"l": Ball(3, Z)}), True),
        (body(), ({"l": Ball(2, Z)}, {"l": Ball(3, 1.1 * Z)}), False),
        (body(), ({"l": Ball(2, Z)}, {}), False),
    ],
)
def test_legs_are_alike_but_for_their_size(
    target: RoledSkeleton, balls: Any, alike: bool
) -> None:
    made = Transfer.of(body(), target, mapped(WHOLE))
    own, other = (
        replace(p, balls=b)
        for p, b in zip((made.target, made.source), balls, strict=True)
    )
    assert replace(made, target=own, source=other).has_similar_legs is alike


def test_places_about_the_hips_and_those_of_the_root() -> None:
    own = body()
    bones = own.rig.rest_translations[None]
    turns = np.tile(so3.IDENTITY, (1, 13, 1))
    turns[0, 3] = turn(X, 90)
    found = relative_to_hips(own, turns, bones, [5, 3, 6])
    expected = own.positions - [0, 0.95, 0]
    assert_allclose(found[0, [0, 3, 6]], expected[[0, 3, 6]], atol=1e-12)
    assert_allclose(found[0, 4], expected[3] + [0, 0, -0.45], atol=1e-12)
    assert_allclose(found[0, 5], expected[3] + [0, -0.4, -0.45], atol=1e-12)
    # Nobody asked for an arm: it is left at the root.
    assert_allclose(found[0, 11], expected[0], atol=1e-12)
    hips = np.array([[1.0, 2, 3]])
    root, place = root_translations(own, hips, turns, bones, found)
    assert root == 0
    assert_allclose(place, [[1, 2.05, 3]])
    # Hips below a root that is turned, and off.
    joints = (
        Joint("root", -1, translation=(0.0, 0.0, 5.0)),
        Joint("cog", 0, translation=(1.0, 0.0, 0.0)),
        Joint("hips", 1, translation=(0.0, 1.0, 0.0)),
    )
    rooted = RoledSkeleton.of(Rig("rooted", joints), ("root", "", "hips"))
    turns = np.array([[turn(Y, 90), turn(Y, 90), so3.IDENTITY]])
    bones = rooted.rig.rest_translations[None]
    root, place = root_translations(rooted, hips, turns, bones, np.zeros((1, 3, 3)))
    assert root == 2
    # The one between is at (0, 0, 4), and turned by a quarter.
    assert_allclose(place, so3.rotate(turn(Y, -90), [[1, 2, -1]]), atol=1e-12)
    local = np.array([[turn(Y, 90), turn(X, 10), turn(Z, 20)]])
    made = world_rotations(rooted.rig, local)
    whole = so3.multiply(local[:, 0], so3.multiply(local[:, 1], local[:, 2]))
    assert_allclose(made[:, 2], whole, atol=1e-12)


def pinned(axis: Any, limits: Any = None) -> Any:
    """Return how an upper arm with a pin below it follows: bones along x."""
    joints = (
        Joint("upper", -1, JointType.BALL),
        Joint(
            "pin", 0, JointType.PIN, translation=(0.3, 0, 0), axis=axis, limits=limits
        ),
        Joint("hand", 1, translation=(0.2, 0, 0)),
    )
    person = RoledSkeleton.of(
        Rig("arm", joints), ("upper_arm_l", "forearm_l", "hand_l")
    )
    return SimpleNamespace(target=person, source_joints=np.arange(3))


@pytest.mark.parametrize(
    ("limits", "side"),
    [(None, 1.0), (RangeLimit(0.0, 2.0), 1.0), (RangeLimit(-2.0, 0.0), -1.0)],
)
def test_what_bends_at_a_pin_is_twisted_so_that_it_can(
    limits: Any, side: float
) -> None:
    """The forearm is bent by 60 degrees about z, and its pin is along y."""
    turns = np.array([[so3.IDENTITY, turn(Z, 60), turn(Z, 60)]])
    made = twist_to_hinge_axes(pinned((0.0, 1.0, 0.0), limits), turns)
    twist = turn(X, 90 * side)
    assert so3.angle_between(made[0, 0], twist) == pytest.approx(0, abs=1e-9)
    slight = np.array([[so3.IDENTITY, turn(Z, 2), so3.IDENTITY]])
    assert_allclose(
        twist_to_hinge_axes(pinned((0.0, 1.0, 0.0), limits), slight)[0, 0], so3.IDENTITY
    )
    half = np.degrees(np.arcsin(0.125))
    between = np.array([[so3.IDENTITY, turn(Z, half), so3.IDENTITY]])
    found = twist_to_hinge_axes(pinned((0.0, 1.0, 0.0), limits), between)
    assert so3.angle_between(found[0, 0], so3.IDENTITY) == pytest.approx(np.pi / 4)


def test_pins_along_a_bone_twist_as_what_is_below_them() -> None:
    def told(axis: Any, **keys: Any) -> int:
        made = pinned(axis).target
        return _twist_joint(replace(made, **keys), 1)

    assert told((1.0, 0.0, 0.0)) == 2
    assert told((-0.95, 0.31, 0.0)) == 2
    assert told((0.8, 0.6, 0.0)) == -1
    assert told((1.0, 0.0, 0.0), roles=("upper_arm_l", "forearm_l", "twist")) == -1
    assert told((1.0, 0.0, 0.0), roles=("upper_arm_l", "hand_l", "hand_l")) == -1
    assert _twist_joint(pinned((1.0, 0.0, 0.0)).target, 0) == -1
    assert_array_equal(_normalize(np.zeros(3)), Y)
    assert_allclose(_normalize(np.array([0, 0, 4.0])), Z)


def test_what_joints_of_each_type_can_have() -> None:
    rest, own = turn(Z, 20), np.tile(turn(X, 50), (2, 1))
    local = so3.multiply(rest, own)
    for kind, expected in (
        (JointType.FREE, local), (JointType.BALL, local), (JointType.FIXED, [rest] * 2),
        (JointType.PIN, local),
    ):  # fmt: skip
        joint = Joint("j", -1, kind, axis=(1.0, 0.0, 0.0))
        found, held = _clamp_to_limits(joint, rest, local)
        assert so3.angle_between(found, np.array(expected)).max() < 1e-9
        assert held.tolist() == [False] * 2


def test_rows_of_turns_are_taken_and_put_with_who_was_held() -> None:
    whole = LocalRotations(
        np.zeros((4, 2, 4)), np.zeros((4, 2, 4)), {0: np.array([1, 1, 0, 0], bool)}
    )
    frames = np.array([1, 2])
    assert whole.select(frames).clamped_frames[0].tolist() == [True, False]
    other = LocalRotations(
        np.ones((2, 2, 4)), 2 * np.ones((2, 2, 4)), {1: np.array([1, 0], bool)}
    )
    whole.replace_frames(frames, other)
    assert whole.local[:, 0, 0].tolist() == [0, 1, 1, 0]
    assert whole.world[:, 0, 0].tolist() == [0, 2, 2, 0]
    assert whole.clamped_frames[0].tolist() == [True, False, False, False]
    assert whole.clamped_frames[1].tolist() == [False, True, False, False]


def test_drift_is_on_the_ground_and_reach_is_of_the_arm() -> None:
    points = np.array([[0.0, 9, 0], [4, 5, 0], [2, 1, 3], [7, 7, 7], [1, 2, 3]])
    stands = np.array([1, 1, 0, 0, 1], bool)
    found = _drift_in_contacts(points, stands, 1)
    assert_allclose(found, [2, 2, np.nan, np.nan, 0])
    assert_allclose(_drift_in_contacts(points, stands, 2)[:2], np.hypot(2, 2))
    own = body()
    straight, bent = own.positions[None].copy(), 2 * own.positions[None].copy()
    bent[0, 11] = bent[0, 10] + [0, 0, 0.5]
    share = np.hypot(0.3, 0.25) / 0.55
    both = [(own, straight, 1.0), (own, bent, 9.0)]
    assert_allclose(_reach_errors(both), [1 - share])
    none = replace(own, roles=("",) * 13)
    assert np.isnan(_reach_errors([(own, straight, 1.0), (none, bent, 1.0)])).all()
    found = mapped([*WHOLE, pair(12, 12, "index_1_l")])
    assert _mean_clamped(found, {3: 0.6, 4: 0.3, 12: 1.0}) == pytest.approx(0.9 / 12)
    assert _mean_clamped(mapped([]), {3: 1.0}) == 0


def meter(target: RoledSkeleton, sides: str = "") -> FitMeter:
    made = Transfer.of(body(), target, mapped(WHOLE))
    return FitMeter(made, mapped(WHOLE), ContactFrames(sides, (), None))


def world_of(positions: Any) -> Any:
    turns = np.tile(so3.IDENTITY, (len(positions), 13, 1))
    return SimpleNamespace(positions=positions, rotations=turns)


def test_what_is_measured_adds_up_over_blocks() -> None:
    """Angles of limbs, accelerations over the source's: in one block, or in three."""
    own = body()
    rng = np.random.default_rng(3)
    source = own.positions + rng.normal(0, 0.01, (7, 13, 3))
    target = own.positions + rng.normal(0, 0.02, (7, 13, 3))
    reports = []
    for cuts in ((0, 7), (0, 1, 3, 7)):
        made = meter(own)
        for begin, end in pairwise(cuts):
            part = slice(begin, end)
            balls = np.zeros((end - begin, 0, 3))
            made.add_frames(begin, world_of(target[part]), source[part], balls)
        reports.append(made.report({3: 0.6}))
    first, second = reports
    assert first.frames == second.frames == 7
    angles = []
    for a, b in ((9, 10), (10, 11), (3, 4), (4, 5), (6, 7), (7, 8)):
        ways = [x[:, b] - x[:, a] for x in (target, source)]
        units = [w / np.linalg.norm(w, axis=1)[:, None] for w in ways]
        angles.append(np.arccos((units[0] * units[1]).sum(axis=1)))
    fast = [
        np.linalg.norm(np.diff(x[:, :12], 2, axis=0), axis=2).max()
        for x in (target, source)
    ]
    for one in reports:
        assert one.bone_angle_mean == pytest.approx(np.mean(angles), rel=1e-6)
        assert one.bone_angle_max == pytest.approx(np.max(angles), rel=1e-6)
        assert one.acceleration == pytest.approx(fast[0] / fast[1])
        assert one.held == {"lt": 0.6}
        assert one.held_mean == pytest.approx(0.05)
        assert (one.scale, one.pairs, one.lowered) == (1, 12, 0)
    verdict = made.verdict({}, ())
    assert verdict.status in set(TakeStatus)
    names = {score.name: score for score in fit_scores(first).scores}
    assert names["not mapped"].value == 0
    assert {name: score.ideal for name, score in names.items()} == {
        "drift": 0, "soles": 0, "hands": 0, "limbs": 0, "acceleration": 1,
        "limits": 0, "not mapped": 0,
    }  # fmt: skip
    assert {name: score.usual for name, score in names.items()} == pytest.approx(
        {
            "drift": 1e-3, "soles": 1e-3, "hands": 0.01, "limbs": np.radians(3),
            "acceleration": 1.25, "limits": 0.05, "not mapped": 0.2,
        }
    )  # fmt: skip
    lost = replace(first, unmapped_source=("a", "b", "c"))
    found = {score.name: score.value for score in fit_scores(lost).scores}
    assert found["not mapped"] == pytest.approx(3 / 15)


def test_scores_are_looked_at_beyond_three_times_the_usual() -> None:
    """From the ideal on; runs that are four frames apart are one."""
    for value, status in ((1.74, TakeStatus.GOOD), (1.76, TakeStatus.LOOK)):
        scores = PassScores(
            (
                Score("acceleration", value, ScoreUnit.RATIO, 1.25, 1.0),
                Score("limbs", np.radians(30.0) * 0.1, ScoreUnit.ANGLE, 0.05),
            )
        )
        own = np.zeros(20)
        own[[0, 4, 9, 19]] = 1.8
        found = assess_take(scores, {"acceleration": own}, {})
        assert found.status is status
        if found.reasons:
            assert found.reasons[0].frames == ((0, 4), (9, 9), (19, 19))
    limbs = [Score("limbs", np.radians(d), ScoreUnit.ANGLE, 9.0) for d in (29.9, 30.1)]
    statuses = [assess_take(PassScores((one,)), {}, {}).status for one in limbs]
    assert statuses == [TakeStatus.GOOD, TakeStatus.UNUSABLE]
    assert FrameNumbers().numbers_of_run(0, 3) == (1, 4)
    assert FrameNumbers(frames=FrameRange(5, 9)).numbers_of_run(0, 3) is None
    assert FrameNumbers(frames=FrameRange(4, 9)).numbers_of_run(0, 3) == (4, 4)
    assert FrameNumbers(frames=FrameRange(0, 1)).numbers_of_run(0, 3) == (1, 1)


def test_integrals_slopes_and_medians_of_drift() -> None:
    assert_allclose(_integrate(np.array([2.0, 4, 0]), 2.0), [0, 1.5, 2.5])
    values = np.stack([3.0 * np.arange(5), 7 - np.arange(5.0)], axis=1)
    assert_allclose(_least_squares_rate(values, 10.0), [30, -10])
    turns = np.array([turn(Y, a) for a in (0, 90, -170, 190)])
    assert_allclose(np.degrees(_angle_about_up(turns, 1)), [0, 90, -170, -170])
    assert_allclose(_angle_about_up(turns, 2), 0, atol=1e-12)
    rows = np.array([[0.0, 1, 5], [10, 1, 7], [20, 3, 9], [31, 1, -4]])
    # Of those within ten frames, by how long they are.
    assert _windowed_medians(rows, 2, 10.0).tolist() == [5, 9, 9, -4]
    assert _windowed_medians(rows, 2, 11.0).tolist() == [5, 9, 9, 9]


@pytest.mark.parametrize("place", [True, False])
def test_a_root_goes_back_as_fast_as_feet_drift(place: bool) -> None:
    """By 2 and 1 m/s; what spins about the origin turns back about where it stands."""
    count, rate = 11, 10.0
    take: Any = SimpleNamespace(
        clock=SimpleNamespace(rate=rate), rig=SimpleNamespace(up=UpAxis.Y)
    )
    still, turns = np.zeros(count), np.tile(so3.IDENTITY, (count, 1))
    options: Any = SimpleNamespace(place=place, closed=False)
    stance = _StanceTracks(still + 0j, still + (2 + 1j), still, still)
    root = still + (3 + 4j)
    angle, shift = _root_correction(take, options, stance, root, turns)
    assert_allclose(angle, 0)
    assert_allclose(shift, -(2 + 1j) * np.arange(count) / rate * place, atol=1e-12)
    spun = _StanceTracks(still + (1 + 1j), still + 0j, still + 0.4, still)
    angle, shift = _root_correction(take, options, spun, root, turns)
    assert_allclose(angle, -0.04 * np.arange(count))
    assert_allclose(shift, 0, atol=1e-12)
    closed: Any = SimpleNamespace(place=place, closed=True)
    way = still + (0.5 - 0.3j) * np.arange(count)
    turns = np.array([turn(Y, 3 * k) for k in range(count)])
    angle, shift = _root_correction(take, closed, stance, way, turns)
    ends = np.exp(1j * angle) * way + shift
    assert ends[-1] == pytest.approx(ends[0])
    assert_allclose(np.degrees(angle), -3 * np.arange(count), atol=1e-9)
