"""Goals that come and go: laws of the way from the free motion to the targets."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from support.targets import HEAD, legs, point_of, tracks_of, walk_of

from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.ik.goals import GOAL_KINDS, Goal, Targets
from animtool.ik.on_take import solve_take
from animtool.ik.result import IkStatus
from animtool.ik.tracks import FreeEffector, swing_towards
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.scene.solves.ik import rest_take

POSITION, _, _, POLE, *_ = GOAL_KINDS
FIRST, LAST, EASE = 14, 26, 6
VALUES = (
    "position: {keys: [{t: 1, v: [0.1, 0.3, 0]}, {t: 40, v: [0.5, 0.5, 0.3]}]}, "
    "orientation: {euler: XYZ, keys: [{t: 1, v: [9, 0, 0]}, {t: 40, v: [0, 50, 9]}]}, "
    "aim: {axis: [0, 1, 0], at: {keys: [{t: 1, v: [1, 2, 0]}, {t: 40, v: [0, 2, 1]}]}},"
    " "
    "pole: {keys: [{t: 1, v: [0.5, 0.5, 2]}, {t: 40, v: [0.1, 0.5, 2]}]}"
)
ALWAYS = f"- {{effector: leg_l, {VALUES}}}\n"
TIMED = f"- {{effector: leg_l, {VALUES}, during: [[{FIRST}, {LAST}]], ease: {EASE}}}\n"
HAND = (
    "- {effector: leg_l, position: {interp: linear, keys: [{t: 1, v: [0.1, 0.3, 0.1]}, "
    "{t: 40, v: [0.4, 0.5, 0.2]}]}, during: [[14, 26]], ease: 6}\n"
)


def sampled(folder: Path, goals: str, step: Fraction = Fraction(1)) -> Targets:
    take = fine(step)
    tracks = tracks_of(folder, goals)
    return tracks.sample(take.rig, take.clock, take.world())


def fine(step: Fraction) -> Take:
    return walk_of(legs(), int(39 / step) + 1, step)


def parts_of(targets: Targets) -> list[FloatArray]:
    given = (targets.positions, targets.rotations, targets.aims, targets.poles)
    return [np.asarray(part)[:, 0] for part in given]


def test_inside_a_span_the_targets_are_those_of_the_track(tmp_path: Path) -> None:
    always, timed = sampled(tmp_path, ALWAYS), sampled(tmp_path, TIMED)
    for theirs, ours in zip(parts_of(always), parts_of(timed), strict=True):
        assert_array_equal(ours[FIRST - 1 : LAST], theirs[FIRST - 1 : LAST])
    weights = np.asarray(timed.weights)[:, 0, :4]
    times = np.arange(1, 41)
    asked = (times > FIRST - EASE) & (times < LAST + EASE)
    assert_array_equal(weights > 0, np.tile(asked[:, None], 4))


@pytest.mark.parametrize("rate", [2, 5])
def test_targets_do_not_depend_on_the_rate(tmp_path: Path, rate: int) -> None:
    whole = sampled(tmp_path, TIMED)
    parts = sampled(tmp_path, TIMED, Fraction(1, rate))
    for theirs, ours in zip(parts_of(whole), parts_of(parts), strict=True):
        asked = slice(FIRST - EASE, LAST + EASE - 2)
        assert_allclose(ours[::rate][asked], theirs[asked], atol=1e-12)


def test_targets_join_the_free_motion_and_the_track_smoothly(tmp_path: Path) -> None:
    step = Fraction(1, 200)
    take = fine(step)
    always, timed = sampled(tmp_path, ALWAYS, step), sampled(tmp_path, TIMED, step)
    goal = tracks_of(tmp_path, TIMED).goals[0].goal
    free = FreeEffector(take.rig, goal, take.world())
    for i, loose in enumerate((free.position(), free.orientation())):
        track, ours = parts_of(always)[i], parts_of(timed)[i]
        for frame, like in ((FIRST - EASE, loose), (FIRST, track)):
            at = int((frame - 1) / step)
            rows = slice(at - 2, at + 3)
            # Within a hundredth of a frame, an ease of the third order is nothing.
            aligned = so3.align_signs(like[rows], ours[at]) if i else like[rows]
            near = rows if frame == FIRST else slice(at + 1, at + 3)
            skip = near.start - rows.start
            assert_allclose(ours[near], aligned[skip:], atol=1e-6)


@given(
    st.lists(st.floats(-1, 1), min_size=6, max_size=6),
    st.floats(0, 1),
    st.booleans(),
)
def test_directions_turn_from_one_to_the_other(
    numbers: list[float], share: float, opposite: bool
) -> None:
    start = np.add([numbers[:3]], [0.0, 0.0, 1.5])
    end = -2 * start if opposite else np.add([numbers[3:]], [0.0, 1.5, 0.0])
    found = swing_towards(start, end, np.array([share]))
    assert_allclose(np.linalg.norm(found), np.linalg.norm(end), rtol=1e-12)

    def angle(a: FloatArray, b: FloatArray) -> float:
        return float(np.arctan2(np.linalg.norm(np.cross(a, b)), (a * b).sum()))

    assert_allclose(angle(start, found), share * angle(start, end), atol=1e-7)
    assert_allclose(swing_towards(start, end, np.ones(1)), end, atol=1e-7)


def straight_arm(elbow: JointType) -> Rig:
    joints = (
        Joint("shoulder", -1, JointType.BALL),
        Joint("elbow", 0, elbow, translation=(0.3, 0.0, 0.0), axis=(0.0, 0.0, 1.0)),
        Joint("wrist", 1, JointType.FIXED, translation=(0.25, 0.0, 0.0)),
    )
    return Rig("arm", joints)


@pytest.mark.parametrize("elbow", [JointType.PIN, JointType.BALL])
@pytest.mark.parametrize("place", ["[0.3, 0.2, 0.1]", "[-0.2, 0.3, 0.1]"])
def test_a_straight_limb_starts_and_stops_softly(
    tmp_path: Path, elbow: JointType, place: str
) -> None:
    rig = straight_arm(elbow)
    goal = f"- {{effector: wrist, position: {place}, during: [[20, 24]], ease: 8}}\n"
    tracks = tracks_of(tmp_path, goal, rig, f"{HEAD}range: [1, 40]\n")
    found = solve_take(rest_take(rig, tracks.clock), tracks, static=True)
    assert set(found.statuses) == {IkStatus.CONVERGED}
    turns = found.take.motion.rotations.dense()
    steps = so3.angle_between(turns[1:, 1], turns[:-1, 1])
    bend = so3.angle_between(turns[19, 1], turns[0, 1])
    # An ease of the third order is steepest at 15/8 of its mean.
    assert steps.max() < 1.9 * bend / 8
    assert np.abs(np.diff(steps)).max() < 0.8 * steps.max()
    assert steps[:11].max() < 1e-6
    # The frame behind the ease asks nothing, and stays where the last one ended.
    assert_allclose(steps[12:19], steps[29:22:-1], atol=1e-4)


def test_limbs_that_bend_and_those_that_hang_from_others_go_straight() -> None:
    take = walk_of(legs())
    there, share = np.full((40, 3), 0.3), np.full(40, 0.5)
    for root in ("hip_l", None):
        free = FreeEffector(take.rig, Goal("ankle_l", root=root), take.world())
        found = free.blend_from_free_motion(POSITION, there, share)
        assert_allclose(found, (free.position() + there) / 2, atol=1e-12)


def test_a_pole_begins_where_the_limb_bends() -> None:
    take = walk_of(legs())
    goal = Goal("ankle_l", root="hip_l", pole=1.0)
    free = FreeEffector(take.rig, goal, take.world())
    far = np.tile([0.0, 0.5, 9.0], (40, 1))
    found = free.blend_from_free_motion(POLE, far, np.full(40, 1e-12))
    root, knee, tip = (point_of(take, f"{j}_l") for j in ("hip", "knee", "ankle"))
    sides = [np.cross(tip - root, point - root) for point in (found, knee)]
    units = [side / np.linalg.norm(side, axis=1, keepdims=True) for side in sides]
    assert_allclose(units[0], units[1], atol=1e-9)


def pops(points: FloatArray) -> float:
    """Return the largest change of a step, in shares of the largest step."""
    steps = np.diff(points, axis=0)
    return float(np.abs(np.diff(steps, axis=0)).max() / np.abs(steps).max())


@pytest.mark.parametrize("still", [False, True])
def test_an_effector_comes_and_goes_without_a_pop(tmp_path: Path, still: bool) -> None:
    take = fine(Fraction(1, 10))
    if still:
        kept = [
            Channel.from_dense(np.repeat(channel.dense()[:1], take.clock.count, axis=0))
            for channel in (take.motion.translations, take.motion.rotations)
        ]
        take = replace(take, motion=Motion(*kept))
    found = solve_take(take, tracks_of(tmp_path, HAND), static=still)
    assert set(found.statuses) == {IkStatus.CONVERGED}
    assert not found.jumps
    ankle = point_of(found.take, "ankle_l")
    assert pops(ankle) < 0.3
    assert pops(point_of(found.take, "knee_l")) < 0.3
    times = take.clock.times
    if not still:
        away = (times <= FIRST - EASE) | (times >= LAST + EASE)
        assert_array_equal(ankle[away], point_of(take, "ankle_l")[away])


def test_goals_of_other_spans_see_each_other(tmp_path: Path) -> None:
    # The tail hangs from the hips that the leg's goal moves.
    take = walk_of(legs())
    leg = HAND.replace("leg_l, ", "ankle_l, root: hips, ").replace(
        "[14, 26]", "[4, 36]"
    )
    tail = "- {effector: tail, root: tail, orientation: [1, 0, 0, 0], "
    tail += "during: [[16, 22]], ease: 4}\n"
    told: list[float] = []
    found = solve_take(take, tracks_of(tmp_path, leg + tail), progress=told.append)
    alone = solve_take(take, tracks_of(tmp_path, leg))
    assert told == sorted(told)
    assert told[-1] == 1
    j = take.rig.index("tail")
    ours, theirs = (one.take.motion.rotations.dense()[:, j] for one in (found, alone))
    assert_allclose(ours[[11, 26]], theirs[[11, 26]], atol=1e-5)
    assert np.abs(ours[15] - theirs[15]).max() > 0.01


def test_one_frame_is_as_in_the_whole(tmp_path: Path) -> None:
    take = walk_of(legs())
    tracks = tracks_of(tmp_path, HAND)
    whole = solve_take(take, tracks)
    for frame in (5, 10, 20):
        one = solve_take(take, tracks, only=frame)
        ours = point_of(one.take, "ankle_l")[0]
        assert_allclose(ours, point_of(whole.take, "ankle_l")[frame], atol=5e-6)


def test_spans_say_which_frames_a_file_is_about(tmp_path: Path) -> None:
    goal = "- {effector: leg_l, position: [0.1, 0.3, 0.1], during: [[3, 9], [14, 26]]}"
    clock = tracks_of(tmp_path, goal).clock
    assert clock == Clock(Fraction(24), Fraction(3), Fraction(1), 24)


def bent_arm(bend: float) -> FreeEffector:
    """Return bones of 0.3 m and 0.25 m, bent by degrees, whose tip is along x."""
    rig, angle = straight_arm(JointType.PIN), np.radians(bend)
    turns = np.tile(so3.IDENTITY, (1, 3, 1))
    tip = np.arctan2(0.25 * np.sin(angle), 0.3 + 0.25 * np.cos(angle))
    turns[0, 0] = so3.from_axis_angle([0.0, 0.0, 1.0], -tip)
    turns[0, 1] = so3.from_axis_angle([0.0, 0.0, 1.0], angle)
    world = forward_kinematics(rig, rig.rest_translations[None], turns)
    return FreeEffector(rig, Goal("wrist", root="shoulder"), world)


@pytest.mark.parametrize(
    ("bend", "straight"),
    [(0.0, 0.0), (5.0, 0.0), (12.5, 0.5), (20.0, 1.0), (90.0, 1.0)],
)
def test_limbs_go_straight_from_20_degrees_and_evenly_up_to_5(
    bend: float, straight: float
) -> None:
    """Half of the way to a quarter turn: as far off as half of the bend between."""
    free, far = bent_arm(bend), 0.4
    here = free.position()[0]
    wanted = np.arccos((far**2 - 0.3**2 - 0.25**2) / (2 * 0.3 * 0.25))
    middle = (np.radians(bend) + wanted) / 2
    away = np.sqrt(0.3**2 + 0.25**2 + 2 * 0.3 * 0.25 * np.cos(middle))
    about = away * np.sqrt(0.5) * np.array([1.0, 1.0, 0.0])
    there = np.array([0.0, far, 0.0])
    line = (here + there) / 2
    found = free.blend_from_free_motion(POSITION, there[None], np.array([0.5]))
    assert_allclose(found[0], about + straight * (line - about), atol=1e-12)


def test_a_straight_limb_goes_evenly_beyond_its_reach() -> None:
    """Of 0.55 m to a metre: three quarters of the way are 0.8875 m."""
    found = bent_arm(0.0).blend_from_free_motion(
        POSITION, np.array([[1.0, 0, 0]]), np.array([0.75])
    )
    assert_allclose(found, [[0.8875, 0, 0]], atol=1e-12)
