"""Takes at their targets: what is reached, and what is left alone."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.faults import raises
from support.targets import HEAD, legs, point_of, tracks_of, walk_of

from animtool.core.clock import Clock
from animtool.core.errors import FormatError, OptionError, Severity
from animtool.ik.on_take import solve_take
from animtool.ik.options import TakeOptions
from animtool.ik.report import goal_reports, independent_frame_notices
from animtool.ik.result import IkStatus
from animtool.ik.sub_rig import with_joint_data_of
from animtool.ik.take_run import TakeIk
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Joint, JointType, Mimic, Rig

FEET = "- {effector: leg_l, hold: [[8, 20]]}\n- {effector: leg_r, hold: [[24, 36]]}\n"
NO_FRACTION = "targets: animtool/1\nunits: {length: m}\n"


def held(folder: Path, take: Take, goals: str = FEET, head: str = HEAD) -> TakeIk:
    return solve_take(take, tracks_of(folder, goals, take.rig, head))


def test_held_feet_stay_where_they_are(tmp_path: Path) -> None:
    take = walk_of(legs())
    found = held(tmp_path, take)
    assert set(found.statuses) == {IkStatus.CONVERGED}
    for name, first, last in (("ankle_l", 8, 20), ("ankle_r", 24, 36)):
        before, after = point_of(take, name), point_of(found.take, name)
        span = slice(first - 1, last)
        assert np.ptp(before[span], axis=0).max() > 0.05
        assert np.ptp(after[span], axis=0).max() < 5e-6
        assert_allclose(after[span], np.tile(before[first - 1], (13, 1)), atol=5e-6)
        j = take.rig.index(name)
        turns = so3.from_matrix(found.take.world().linear[span, j])
        assert so3.angle_between(turns, turns[0]).max() < 5e-6


def test_all_else_is_left_alone(tmp_path: Path) -> None:
    take = walk_of(legs())
    found = held(tmp_path, take)
    moved = set(found.problem.joints)
    assert moved == {f"{j}_{s}" for j in ("hip", "knee", "ankle") for s in "lr"}
    for kind in ("translations", "rotations"):
        ours, theirs = (getattr(one.motion, kind).dense() for one in (found.take, take))
        for j, name in enumerate(take.rig.names):
            if name not in moved:
                assert_array_equal(ours[:, j], theirs[:, j])
        # Neither foot is held or eased here.
        assert_array_equal(ours[:3], theirs[:3])


def test_eased_holds_do_not_pop(tmp_path: Path) -> None:
    take = walk_of(legs(), count=400, step=Fraction(1, 10))
    found = held(tmp_path, take)

    def jerk(points: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float:
        return float(np.abs(np.diff(points, 2, axis=0)).max())

    for name in ("ankle_l", "knee_l"):
        # Steps of a tenth of a frame: what jumps in speed stays as large as a step.
        step = np.abs(np.diff(point_of(found.take, name), axis=0)).max()
        assert jerk(point_of(found.take, name)) < 0.3 * step


def test_the_rate_of_the_take_does_not_matter(tmp_path: Path) -> None:
    whole = held(tmp_path, walk_of(legs()))
    halves = held(tmp_path, walk_of(legs(), count=79, step=Fraction(1, 2)))
    for name in ("ankle_l", "knee_r"):
        every = point_of(halves.take, name)[::2]
        assert_allclose(every, point_of(whole.take, name), atol=2e-5)


def test_targets_move_and_are_reached(tmp_path: Path) -> None:
    take = walk_of(legs())
    goal = (
        "- {effector: leg_l, offset: [0, 0, 0.05], position: {keys: [{t: 1, v: [0.1, "
        "0.1, 0.1]}, {t: 20, v: [0.3, 0.2, 0.3]}, {t: 40, v: [0.5, 0.1, 0.3]}]}}\n"
    )
    tracks = tracks_of(tmp_path, goal, take.rig)
    found = solve_take(take, tracks)
    world = found.take.world()
    j = take.rig.index("ankle_l")
    points = world.positions[:, j] + world.linear[:, j] @ [0, 0, 0.05]
    targets = tracks.sample(take.rig, take.clock, take.world())
    apart = np.linalg.norm(points - np.asarray(targets.positions)[:, 0], axis=1)
    assert_allclose(apart, found.misses[:, 0, 0], atol=1e-9)
    assert apart.max() < 2e-6


def test_what_is_out_of_reach_is_as_near_as_can_be(tmp_path: Path) -> None:
    take = walk_of(legs(), count=3)
    found = held(tmp_path, take, "- {effector: leg_l, position: [0, 9, 0]}")
    assert set(found.statuses) == {IkStatus.NEAREST}
    root = point_of(take, "hip_l")
    reach = sum(np.linalg.norm([[0, -0.42, 0.01], [0, -0.4, -0.02]], axis=1))
    expected = np.linalg.norm([0, 9, 0] - root, axis=1) - reach
    # The knee is straight at its limit but for the bones' small offsets.
    assert_allclose(found.misses[:, 0, 0], expected, atol=2e-3)
    apart = np.linalg.norm(point_of(found.take, "ankle_l") - [0, 9, 0], axis=1)
    assert_allclose(apart, found.misses[:, 0, 0], atol=1e-9)


def test_goals_that_contradict_each_other_are_named_and_finite(tmp_path: Path) -> None:
    goals = (
        "- {effector: ankle_l, root: hip_l, position: [0.3, 0.2, 0]}\n"
        "- {effector: ankle_l, root: hip_l, position: [0.1, 0.2, 0]}\n"
    )
    found = held(tmp_path, walk_of(legs(), count=2), goals)
    assert IkStatus.CONVERGED not in found.statuses
    assert np.isfinite(found.take.motion.rotations.dense()).all()
    assert_allclose(found.misses[:, :, 0], 0.1, atol=1e-3)


def test_a_goal_of_a_higher_number_gives_way(tmp_path: Path) -> None:
    goals = (
        "- {effector: ankle_l, root: hip_l, position: [0.3, 0.2, 0]}\n"
        "- {effector: ankle_l, root: hip_l, position: [0.1, 0.2, 0], priority: 1}\n"
    )
    found = held(tmp_path, walk_of(legs(), count=2), goals)
    assert found.misses[:, 0, 0].max() < 2e-6
    assert_allclose(found.misses[:, 1, 0], 0.2, atol=1e-5)
    hard, soft = goal_reports(found)
    assert (hard.spans, soft.spans) == ((), ())


def test_bones_stretch_where_they_may(tmp_path: Path) -> None:
    take = walk_of(legs(), count=3)
    goal = "- {effector: leg_l, position: [0.1, -0.05, 0], stretch: 0.5}\n"
    found = held(tmp_path, take, goal)
    # The knee's limit keeps it from being quite straight, as its reach would have it.
    apart = np.linalg.norm(point_of(found.take, "ankle_l") - [0.1, -0.05, 0], axis=1)
    assert_allclose(apart, found.misses[:, 0, 0], atol=1e-9)
    assert apart.max() < 1e-3
    knee = take.rig.index("knee_l")
    longer = found.take.motion.translations.dense()[:, knee]
    ratio = np.linalg.norm(longer, axis=1) / np.linalg.norm(
        take.rig.rest_translations[knee]
    )
    assert (ratio > 1.01).all()
    assert (ratio < 1.5).all()


def test_bones_of_no_length_end_in_a_status(tmp_path: Path) -> None:
    rig = legs()
    joints = tuple(
        joint if joint.parent < 0 else replace(joint, translation=(0.0, 0.0, 0.0))
        for joint in rig.joints
    )
    flat = replace(rig, joints=joints)
    take = replace(walk_of(flat, count=2), rig=flat)
    places = np.repeat(flat.rest_translations[None], 2, axis=0)
    motion = replace(take.motion, translations=Channel.from_dense(places))
    found = held(
        tmp_path,
        replace(take, motion=motion),
        "- {effector: knee_l, position: [0.1, 0.5, 0], root: hips}",
    )
    assert found.misses[..., 0].max() < 1e-5  # the hips travel there
    with pytest.raises(OptionError) as caught:
        held(tmp_path, replace(take, motion=motion),
             "- {effector: leg_l, position: [0.1, 0.5, 0]}")  # fmt: skip
    assert caught.value.code == "IK003"


def test_a_chain_that_cannot_move_is_refused(tmp_path: Path) -> None:
    take = walk_of(legs(), count=2)
    tracks = tracks_of(tmp_path, "- {effector: leg_l, position: [0, 0, 0]}", take.rig)
    with pytest.raises(OptionError) as caught:
        solve_take(take, tracks, TakeOptions(joints=("tail",)))
    (fault,) = caught.value.faults
    assert (fault.code, fault.where) == ("IK003", "goals[0]")
    assert fault.path == str(tracks.path)
    with raises(OptionError, "TGT001", match="'tail'") as caught:
        solve_take(take, tracks, TakeOptions(joints=("tale",)))


def test_limits_that_are_reversed_are_refused(tmp_path: Path) -> None:
    rig = legs()
    knee = replace(rig.joints[2], limits=RangeLimit(2.0, 1.0))
    jump_frame = replace(rig, joints=(*rig.joints[:2], knee, *rig.joints[3:]))
    take = replace(walk_of(rig, count=2), rig=jump_frame)
    with pytest.raises(OptionError) as caught:
        held(tmp_path, take, "- {effector: leg_l, position: [0, 0, 0]}")
    assert caught.value.code == "IK005"


def test_poses_are_moved_inside_limits(tmp_path: Path) -> None:
    rig = legs()
    knee = replace(rig.joints[2], limits=RangeLimit(0.0, 0.9))
    stiff = replace(rig, joints=(*rig.joints[:2], knee, *rig.joints[3:]))
    take = replace(walk_of(rig), rig=stiff)
    found = held(tmp_path, take, "- {effector: leg_l, hold: [[8, 9]]}")
    turns = found.take.motion.rotations.dense()[:, 2]
    assert so3.angle_between(turns, so3.IDENTITY).max() < 0.9 + 1e-9
    assert found.on_limits["knee_l"].any()


def test_only_some_joints_may_move(tmp_path: Path) -> None:
    take = walk_of(legs())
    tracks = tracks_of(
        tmp_path, "- {effector: ankle_l, position: [0.2, 0.3, 0.2]}", take.rig
    )
    found = solve_take(take, tracks, TakeOptions(joints=("hip_l", "hips")))
    assert found.problem.joints == ("hips", "hip_l")
    assert_array_equal(
        found.take.motion.rotations.dense()[:, 2], take.motion.rotations.dense()[:, 2]
    )
    assert found.misses[..., 0].max() < 2e-6
    # A knee that no goal moves bends from frame to frame between joints that it does.
    points = point_of(found.take, "ankle_l")
    assert_allclose(points, np.tile([0.2, 0.3, 0.2], (40, 1)), atol=2e-6)
    assert found.moving_between == ("knee_l",)


def test_frames_on_their_own_are_counted(tmp_path: Path) -> None:
    take = walk_of(legs())
    goal = "- {effector: ankle_l, position: [0.2, 0.3, 0.2]}"
    options = TakeOptions(joints=("hip_l", "hips"))
    found = solve_take(take, tracks_of(tmp_path, goal, take.rig), options)
    (note,) = independent_frame_notices(found)
    assert (note.code, note.severity) == ("TGT105", Severity.NOTE)
    assert "40 frames" in note.message
    assert "'knee_l'" in note.message
    (warning,) = independent_frame_notices(found, is_smoothed=True)
    assert warning.severity is Severity.WARNING
    assert independent_frame_notices(held(tmp_path, take, goal)) == []


def test_a_joint_that_turns_about_its_goal_leaves_frames_together(
    tmp_path: Path,
) -> None:
    take = walk_of(legs())
    turned = held(tmp_path, take, "- {effector: ankle_l, position: [0.2, 0.3, 0.2]}")
    assert turned.moving_between == ()
    assert turned.misses[..., 0].max() < 2e-6
    ankle = take.rig.index("ankle_l")
    ours, theirs = (one.motion.rotations.dense() for one in (turned.take, take))
    assert_array_equal(ours[:, ankle], theirs[:, ankle])
    goal = "- {effector: ankle_l, position: [0.2, 0.3, 0.2], offset: [0, 0, 0.1]}"
    tracks = tracks_of(tmp_path, goal, take.rig)
    props = solve_take(take, tracks, TakeOptions(joints=("hip_l", "knee_l", "hips")))
    assert props.moving_between == ("ankle_l",)
    assert props.misses[..., 0].max() < 2e-6


def test_what_joints_do_props_their_types_is_kept(tmp_path: Path) -> None:
    take = walk_of(legs())
    places, turns, _ = take.motion.dense()
    wobble = np.sin(np.arange(40) / 3.0)
    knee = take.rig.index("knee_l")
    places[:, knee, 0] += 0.01 * wobble
    sideways = so3.from_axis_angle([0, 0, 1], 0.1 * wobble)
    turns[:, knee] = so3.multiply(sideways, turns[:, knee])
    motion = replace(
        take.motion,
        translations=Channel.from_dense(places),
        rotations=Channel.from_dense(turns),
    )
    found = held(tmp_path, replace(take, motion=motion))
    span = slice(7, 20)
    assert np.ptp(point_of(found.take, "ankle_l")[span], axis=0).max() < 5e-6
    assert_array_equal(found.take.motion.translations.dense()[:, knee], places[:, knee])


def test_one_frame_of_many(tmp_path: Path) -> None:
    take = walk_of(legs())
    tracks = tracks_of(tmp_path, FEET, take.rig)
    one = solve_take(take, tracks, only=14)
    assert (one.take.clock.count, one.take.clock.start) == (1, 15)
    whole = solve_take(take, tracks)
    assert_allclose(
        point_of(one.take, "ankle_l")[0], point_of(whole.take, "ankle_l")[14], atol=2e-6
    )


def loose_legs(way: float) -> Rig:
    """Return legs whose knees bend in any direction, the left one's chain in one."""
    rig = legs()
    balls = tuple(
        replace(joint, type=JointType.BALL, limits=None)
        if joint.type is JointType.PIN
        else joint
        for joint in rig.joints
    )
    chain = replace(rig.chains[0], pole_dir=(0.0, 0.0, way))
    return replace(rig, joints=balls, chains=(chain,))


def resting(rig: Rig, count: int) -> Take:
    rest = Motion(
        Channel.from_dense(np.repeat(rig.rest_translations[None], count, axis=0)),
        Channel.from_dense(np.repeat(rig.rest_rotations[None], count, axis=0)),
    )
    return Take(rig, Clock(Fraction(24), Fraction(1), Fraction(1), count), rest)


def test_chains_bend_towards_their_pole_from_rest(tmp_path: Path) -> None:
    goal = "- {effector: leg_l, position: [0.1, 0.3, 0.0]}"
    for way in (1.0, -1.0):
        loose = loose_legs(way)
        tracks = tracks_of(tmp_path, goal, loose)
        found = solve_take(resting(loose, 1), tracks, static=True)
        assert found.misses[..., 0].max() < 2e-6
        assert way * point_of(found.take, "knee_l")[0, 2] > 0.1


@pytest.mark.parametrize("count", [1, 6])
def test_a_preference_is_for_the_rest_pose(tmp_path: Path, count: int) -> None:
    loose = loose_legs(1.0)
    tracks = tracks_of(
        tmp_path, "- {effector: leg_l, position: [0.1, 0.3, 0.0]}", loose
    )
    still = resting(loose, count)
    found = solve_take(still, tracks, TakeOptions(rest_weight=1e3), static=True)
    knee = point_of(found.take, "knee_l")
    assert_allclose(knee, point_of(still, "knee_l"), atol=0.005)


def test_a_chain_goes_on_from_the_side_that_it_bends_to(tmp_path: Path) -> None:
    goal = "- {effector: leg_l, position: {keys: [{t: 1, v: [0.1, 0.3, 0]}, "
    goal += "{t: 24, v: [0.3, 0.5, 0.2]}]}}"
    loose = loose_legs(1.0)
    found = solve_take(
        resting(loose, 24), tracks_of(tmp_path, goal, loose), static=True
    )
    assert found.misses[..., 0].max() < 2e-6
    knee = point_of(found.take, "knee_l")
    assert knee[:, 2].min() > 0.1
    assert np.linalg.norm(np.diff(knee, axis=0), axis=1).max() < 0.03
    assert found.descents.max() <= 1
    assert found.iterations[1:].max() < 10


def test_the_same_seed_gives_the_same_poses(tmp_path: Path) -> None:
    take = walk_of(legs())
    goals = "- {effector: leg_l, position: [3, 0, 0]}"
    one, two = (held(tmp_path, take, goals).take for _ in range(2))
    assert_array_equal(one.motion.rotations.dense(), two.motion.rotations.dense())


def test_scaled_joints_are_refused(tmp_path: Path) -> None:
    take = walk_of(legs(), count=3)
    scales = np.ones((3, len(take.rig.joints), 3))
    scales[:, 7] = 2.0  # the tail
    tail = replace(take.motion, scales=Channel.from_dense(scales))
    assert held(tmp_path, replace(take, motion=tail)).misses.max() < 2e-6
    scales[:, 0] = 2.0
    hips = replace(take.motion, scales=Channel.from_dense(scales))
    with raises(OptionError, "TGT016", match="'hips'"):
        held(tmp_path, replace(take, motion=hips))


def test_joints_that_follow_are_taken_along(tmp_path: Path) -> None:
    rig = Rig(
        "pair",
        (
            Joint("a", -1, JointType.PIN),
            Joint("b", 0, JointType.PIN, translation=(1, 0, 0), mimic=Mimic("a", 0.5)),
            Joint("end", 1, JointType.FIXED, translation=(1, 0, 0)),
            Joint("dial", -1, JointType.PIN, mimic=Mimic("a", -2.0)),
        ),
    )
    rest = Motion(
        Channel.from_dense(rig.rest_translations[None]),
        Channel.from_dense(rig.rest_rotations[None]),
    )
    take = Take(rig, Clock(Fraction(24), Fraction(1), Fraction(1), 1), rest)
    end = [np.cos(0.4) + np.cos(0.6), np.sin(0.4) + np.sin(0.6), 0]
    goal = f"- {{effector: end, position: {[float(x) for x in end]}}}"
    found = solve_take(take, tracks_of(tmp_path, goal, rig), static=True)
    assert_allclose(point_of(found.take, "end")[0], end, atol=3e-6)
    dial = so3.log(found.take.motion.rotations.dense()[0, 3])
    assert_allclose(dial, [0, 0, -0.8], atol=1e-5)


def test_joints_without_types_turn_about_their_parents(tmp_path: Path) -> None:
    rig = legs()
    plain = replace(
        rig,
        joints=tuple(replace(j, type=JointType.FREE) for j in rig.joints),
        chains=(),
    )
    take = replace(walk_of(rig), rig=plain)
    goals = "- {effector: ankle_l, root: hip_l, hold: [[8, 20]]}"
    found = held(tmp_path, take, goals)
    assert_array_equal(
        found.take.motion.translations.dense(), take.motion.translations.dense()
    )
    assert np.ptp(point_of(found.take, "ankle_l")[7:20], axis=0).max() < 5e-6
    # What another rig says of them is used where it is given.
    typed = with_joint_data_of(plain, rig)
    assert [joint.type for joint in typed.joints] == [j.type for j in rig.joints]
    assert typed.chains == rig.chains


def test_a_take_of_another_rate_is_refused(tmp_path: Path) -> None:
    take = walk_of(legs())
    other = replace(take, clock=replace(take.clock, fps=Fraction(30)))
    with pytest.raises(OptionError) as caught:
        held(tmp_path, other)
    assert caught.value.code == "TGT014"
    assert held(tmp_path, other, head=NO_FRACTION).misses.max() < 2e-6


def test_arrays_that_end_before_the_take_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", position=np.zeros((10, 3)))
    take = walk_of(legs())
    for head in (HEAD, f"{HEAD}range: [1, 10]\n"):
        with pytest.raises(OptionError) as caught:
            held(tmp_path, take, "- {effector: leg_l, position: a.npz}", head)
        (fault,) = caught.value.faults
        line = len(head.splitlines()) + 2
        assert (fault.code, fault.lines, fault.column) == ("TGT015", (line,), 31)
        assert fault.path == str(tmp_path / "feet.targets.yaml")
    with pytest.raises(FormatError):
        held(tmp_path, take, "- {effector: leg_l, position: a.npz}",
             f"{HEAD}range: [1, 40]\n")  # fmt: skip


def test_progress_ends_with_all(tmp_path: Path) -> None:
    take = walk_of(legs())
    told: list[float] = []
    tracks = tracks_of(tmp_path, FEET, take.rig)
    solve_take(take, tracks, progress=told.append)
    assert told[-1] == 1.0
