"""Matching: targets made of poses give the poses back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from adapters.ik import read_groups, read_rig
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from support.data import data_files
from support.ik import random_pose
from support.suite import examples

from animtool import Rig
from animtool.core.array_types import FloatArray
from animtool.ik import Goal, IkOptions, IkStatus, Targets, build, solve
from animtool.ik.matching import Matched, match
from animtool.ik.sub_rig import sub_rig
from animtool.maths import so3
from animtool.rig.joints import (
    LocalTransforms,
    coordinate_slices,
    local_from_coordinates,
    rest_coordinates,
)
from animtool.rig.kinematics import WorldTransforms, forward_kinematics
from animtool.rig.limits import RangeLimit
from animtool.rig.parts import IkChain
from animtool.rig.skeleton import Joint, JointType

EXACT = IkOptions(tolerance=1e-10, angle_tolerance=1e-10)
seeds = st.integers(0, 10**6)


def posed(rig: Rig, q: FloatArray) -> tuple[LocalTransforms, WorldTransforms]:
    local = local_from_coordinates(rig, np.atleast_2d(q))
    return local, forward_kinematics(rig, local.translations, local.rotations)


def limb_of(rig: Rig, chain: IkChain) -> list[int]:
    found = [rig.index(chain.tip)]
    while rig.names[found[-1]] != chain.root:
        found.append(rig.joints[found[-1]].parent)
    return found


def at(targets: Targets, frame: int) -> Targets:
    rows = slice(frame, frame + 1)
    return Targets(
        *(
            np.asarray(getattr(targets, part))[rows]
            for part in ("positions", "rotations")
        ),
        poles=np.asarray(targets.poles)[rows],
    )


def solved(
    rig: Rig, chains: tuple[IkChain, ...], found: Matched, frame: int, q: FloatArray
) -> tuple[LocalTransforms, WorldTransforms]:
    """Return the pose of one frame's targets, the limbs beginning at rest."""
    start = q.copy()
    places = coordinate_slices(rig)
    rest = rest_coordinates(rig, 1)[0]
    for chain in chains:
        for j in limb_of(rig, chain):
            start[places[j]] = rest[places[j]]
    result = solve(
        build(rig, found.goals, pose=start),
        start[None],
        at(found.targets, frame),
        EXACT,
    )
    assert result.statuses == (IkStatus.CONVERGED,)
    return posed(rig, result.coordinates)


def biped() -> tuple[Rig, tuple[IkChain, ...]]:
    whole = Rig.load(Path(__file__).parents[2] / "rigs/biped/biped.rig.yaml")
    rig, _ = sub_rig(whole, [chain.tip for chain in whole.chains])
    return rig, rig.chains


BIPED, CHAINS = biped()


@pytest.mark.slow
@settings(deadline=None, max_examples=examples(40))
@given(seeds)
def test_limbs_of_a_biped_come_back(seed: int) -> None:
    goals = [Goal(chain.tip, orientation=1.0) for chain in CHAINS]
    q = random_pose(build(BIPED, goals), seed)[0]
    local, world = posed(BIPED, q)
    found = match(BIPED, CHAINS, world)
    ours, back = solved(BIPED, CHAINS, found, 0, q)
    tips = [BIPED.index(chain.tip) for chain in CHAINS]
    assert_allclose(back.positions[0, tips], world.positions[0, tips], atol=1e-6)
    # Elbows and knees, and all joints beside them.
    assert_allclose(back.positions, world.positions, atol=1e-5)
    elbows = [BIPED.index(n) for n in ("elbow_l", "elbow_r", "knee_l", "knee_r")]
    bend = so3.angle_between(local.rotations[0, elbows], so3.IDENTITY)
    if bend.min() > 0.02:
        apart = so3.angle_between(ours.rotations, local.rotations)
        assert apart.max() < 1e-4
    again = match(BIPED, CHAINS, back)
    for part in ("positions", "rotations"):
        assert_allclose(
            np.asarray(getattr(again.targets, part)),
            np.asarray(getattr(found.targets, part)),
            atol=1e-6,
        )
    if bend.min() > 0.02:
        assert_allclose(
            np.asarray(again.targets.poles), np.asarray(found.targets.poles), atol=1e-4
        )


@pytest.mark.parametrize("path", data_files("ik", "humanoid_ball*.json"))
@settings(deadline=None, max_examples=examples(15))
@given(seed=seeds)
def test_limbs_of_the_humanoid_have_their_tips_and_middles_back(
    path: Path, seed: int
) -> None:
    group = read_groups(path)[0]
    chains = tuple(
        IkChain(f"{limb}_{side}", f"{side}_{root}", f"{side}_{tip}")
        for side in "lr"
        for limb, root, tip in (("arm", "shoulder", "wrist"), ("leg", "hip", "ankle"))
    )
    rig, _ = sub_rig(read_rig(group.model), [chain.tip for chain in chains])
    q = random_pose(build(rig, [Goal(chain.tip) for chain in chains]), seed)[0]
    _, world = posed(rig, q)
    found = match(rig, chains, world)
    _, back = solved(rig, chains, found, 0, q)
    names = [f"{side}_{j}" for side in "lr" for j in ("elbow", "knee")]
    middles = [rig.index(name) for name in names]
    tips = [rig.index(chain.tip) for chain in chains]
    assert_allclose(back.positions[0, tips], world.positions[0, tips], atol=1e-6)
    assert_allclose(back.positions[0, middles], world.positions[0, middles], atol=1e-5)


@pytest.mark.parametrize("path", data_files("ik", "limb*.json"))
@settings(deadline=None, max_examples=examples(15))
@given(number=st.integers(0, 299))
def test_the_limb_of_the_problem_set_comes_back(path: Path, number: int) -> None:
    group = read_groups(path)[0]
    offset = tuple(group.effectors[0]["offset"])
    arm = read_rig(group.model)
    rig = replace(
        arm,
        joints=(*arm.joints, Joint("hand", 1, JointType.FIXED, translation=offset)),
        chains=(IkChain("arm", "shoulder", "hand", "position"),),
    )
    solution = solve(group.problem, group.starts, group.targets)
    q = solution.coordinates[number % len(solution.coordinates)]
    local, world = posed(rig, q)
    found = match(rig, rig.chains, world)
    ours, back = solved(rig, rig.chains, found, 0, q)
    assert_allclose(back.positions, world.positions, atol=1e-9)
    assert so3.angle_between(ours.rotations, local.rotations).max() < 1e-7


def tentacle(goal: str) -> Rig:
    joints = [
        Joint(
            f"b{i}", i - 1, JointType.BALL, translation=(0.0, 0.3 * (i > 0), 0.02 * i)
        )
        for i in range(6)
    ]
    return Rig("tentacle", tuple(joints), chains=(IkChain("t", "b0", "b5", goal),))


@pytest.mark.parametrize("goal", ["pose", "position"])
@settings(deadline=None, max_examples=examples(15))
@given(seed=seeds)
def test_long_limbs_reach_with_their_middle_towards_its_pole(
    goal: str, seed: int
) -> None:
    rig = tentacle(goal)
    q = random_pose(build(rig, [Goal("b5", orientation=1.0)]), seed)[0]
    _, world = posed(rig, q)
    found = match(rig, rig.chains, world)
    _, back = solved(rig, rig.chains, found, 0, q)
    again = match(rig, rig.chains, back)
    assert_allclose(back.positions[0, 5], world.positions[0, 5], atol=1e-6)
    root = world.positions[0, 0]
    line = world.positions[0, 5] - root

    def side(targets: Targets) -> FloatArray:
        away = np.cross(line, np.asarray(targets.poles)[0, 0] - root)
        return np.asarray(away / np.linalg.norm(away))

    assert_allclose(side(again.targets), side(found.targets), atol=1e-5)


def test_the_middle_of_a_long_limb_is_the_same_in_every_pose() -> None:
    rig = tentacle("pose")
    goal = Goal("b5", orientation=1.0, pole=1.0, root="b0")
    middles = {
        int(build(rig, [goal], pose=q).chain.goal_nodes[0, 2])
        for q in random_pose(build(rig, [goal]), 3, frames=30)
    }
    assert middles == {3}


def leg(pole: tuple[float, float, float] | None = (0.0, 0.0, 1.0)) -> Rig:
    """A hip, a knee that bends both ways, and a foot, straight at rest."""
    return Rig(
        "leg",
        (
            Joint("hip", -1, JointType.BALL, translation=(0.0, 0.8, 0.0)),
            Joint(
                "knee",
                0,
                JointType.PIN,
                translation=(0.0, -0.4, 0.0),
                axis=(1.0, 0.0, 0.0),
                limits=RangeLimit(-1.0, 2.0),
            ),
            Joint("foot", 1, JointType.BALL, translation=(0.0, -0.4, 0.0)),
        ),
        chains=(IkChain("leg", "hip", "foot", "pose", pole),),
    )


def poles_of(
    rig: Rig, angles: list[float], turns: FloatArray | None = None
) -> FloatArray:
    """Return from where the knee is to where its pole is, by its angles."""
    q = np.zeros((len(angles), 9))
    q[:, 3] = q[:, 8] = 1.0
    q[:, 4] = angles
    if turns is not None:
        q[:, :4] = turns
    _, world = posed(rig, q)
    poles = np.asarray(match(rig, rig.chains, world).targets.poles)[:, 0]
    return np.asarray(poles - world.positions[:, 0])


def test_the_pole_of_a_straight_limb_stays_on_its_side() -> None:
    found = poles_of(leg(), [0.5, 1e-3, 1e-9, 0.0, -1e-9, 1e-9, 1e-3, 0.5])
    assert (found[:, 2] > 0.29).all()
    assert_allclose(np.linalg.norm(found[3]), np.hypot(0.4, 0.4), atol=1e-9)


def test_a_limb_that_bends_over_takes_its_pole_along() -> None:
    found = poles_of(leg(), [0.3, 0.0, -0.3, 0.0])
    assert (np.sign(found[:, 2]) == [1, 1, -1, -1]).all()


def test_the_first_frames_of_a_straight_limb_have_the_side_that_comes() -> None:
    found = poles_of(leg((0.0, 0.0, 1.0)), [0.0, 0.0, -0.4])
    assert (found[:, 2] < -0.3).all()


def test_a_straight_limb_that_turns_carries_its_pole() -> None:
    turns = so3.from_axis_angle([0.0, 1.0, 0.0], np.linspace(0, 3.0, 7))
    found = poles_of(leg(), [0.4, *[0.0] * 6], turns)
    flat = found[:, [0, 2]] / np.linalg.norm(found[:, [0, 2]], axis=1)[:, None]
    angles = np.linspace(0, 3.0, 7)
    assert_allclose(flat, np.stack([np.sin(angles), np.cos(angles)], 1), atol=1e-9)


@pytest.mark.parametrize("pole", [(0.0, 0.0, -1.0), (0.8, 0.0, -0.6)])
def test_a_limb_that_never_bends_has_its_pole_direction(
    pole: tuple[float, float, float],
) -> None:
    # Of a hinge as far as that is across it.
    found = poles_of(leg(pole), [0.0, 0.0])
    assert_allclose(found[:, [0, 2]], [[0.0, -0.4]] * 2, atol=1e-12)


def test_a_limb_of_which_nothing_tells_has_some_pole() -> None:
    found = poles_of(leg(None), [0.0])
    assert_allclose(np.linalg.norm(found[0, [0, 2]]), 0.4, atol=1e-12)


def test_a_folded_limb_has_a_pole() -> None:
    rig = leg()
    joints = list(rig.joints)
    joints[1] = replace(joints[1], limits=None)
    found = poles_of(replace(rig, joints=tuple(joints)), [np.pi])
    assert_allclose(found[0], [0.0, -0.4, 0.0], atol=1e-12)


def test_what_a_chain_does_not_ask_for_has_no_goal() -> None:
    rig = leg()
    turned = replace(rig.chains[0], goal="orientation")
    placed = replace(rig.chains[0], goal="position")
    short = replace(rig.chains[0], root="foot")
    _, world = posed(rig, np.array([0.0, 0, 0, 1, 0.5, 0, 0, 0, 1]))
    found = match(rig, [turned, placed, short], world)
    weights = [goal.weights[:4] for goal in found.goals]
    assert weights == [(0, 1, 0, 0), (1, 0, 0, 1), (1, 1, 0, 0)]
    assert not np.any([goal.weights[4:] for goal in found.goals])


def test_stretched_bones_come_back() -> None:
    rig = leg()
    chain = replace(rig.chains[0], goal="position", stretch=0.2)
    rig = replace(rig, chains=(chain,))
    q = np.array([0.0, 0, 0, 1, 0.0, 0, 0, 0, 1])
    local = local_from_coordinates(rig, q[None])
    local.translations[0, 1:] *= 1.1
    world = forward_kinematics(rig, local.translations, local.rotations)
    found = match(rig, rig.chains, world)
    result = solve(build(rig, found.goals, pose=q), q[None], found.targets, EXACT)
    assert_allclose(result.local_translations()[0], local.translations[0], atol=1e-9)
