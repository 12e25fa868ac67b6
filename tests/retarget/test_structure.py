"""Ways, branches and ends of skeletons, of which the first letters say nothing."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.core.units import UpAxis
from animtool.retarget.roles import CONTROL, END, TWIST
from animtool.retarget.structure import (
    SkeletonTree,
    _similar_subtrees,
    find_left_direction,
    find_up_direction,
)
from animtool.rig.skeleton import Joint, Rig


def tree() -> Rig:
    """Return a trunk of 2 m with two limbs of 1.5 m, a twist joint and an end."""
    return Rig(
        "tree",
        (
            Joint("0", -1, translation=(9.0, 0.0, 0.0)),
            Joint("1", 0, translation=(0.0, 2.0, 0.0)),
            Joint("2", 1, translation=(0.5, 0.0, 0.0)),
            Joint("3", 2, translation=(1.0, 0, 0), tips=((0.0, 0, 0.3), (0.0, 0.1, 0))),
            Joint("4", 1, translation=(-0.5, 0.0, 0.0)),
            Joint("5", 4, translation=(-1.0, 0.0, 0.0)),
            Joint("6", 4, translation=(-0.5, 0.0, 0.0)),
            Joint("7", 1, translation=(0.0, 0.4, 0.0)),
        ),
    )  # fmt: skip


def body(*kinds: tuple[int, str]) -> SkeletonTree:
    known = dict(kinds)
    return SkeletonTree.of(tree(), [{}] * 8, [known.get(j, "") for j in range(8)])


def test_lengths_and_ways_of_a_skeleton() -> None:
    own = body()
    assert own.children == [[1], [2, 4, 7], [3], [], [5, 6], [], [], []]
    assert_allclose(own.lengths, [0, 2, 0.5, 1, 0.5, 1, 0.5, 0.4])
    assert_allclose(own.tip_lengths, [0, 0, 0, 0.3, 0, 0, 0, 0])
    assert_allclose(own.reach, [3.8, 1.8, 1.3, 0.3, 1, 0, 0, 0])
    assert own.size == pytest.approx(3.8)
    assert own.subtree_sizes == [8, 7, 2, 1, 3, 1, 1, 1]
    assert own.path(1, 3) == [1, 2, 3]
    assert own.path(2, 5) == []
    assert (
        own.lowest_common_ancestor([3, 5]),
        own.lowest_common_ancestor([5, 6]),
        own.lowest_common_ancestor([3]),
    ) == (1, 4, 3)
    assert own.length_through_joint(2) == pytest.approx(1.8)
    # What lies along the bone to a sibling, nearer than that, twists it.
    assert own.limb_children(4) == [5]
    assert own.limb_children(1) == [2, 4, 7]
    assert own.longest_path(1) == [1, 2, 3]
    assert own.widest_branching([1, 2, 3]) == (1, 3)


def test_controls_that_carry_nothing_and_ends_are_no_bones() -> None:
    own = body((7, CONTROL), (5, END), (6, TWIST), (2, CONTROL))
    assert own.children[1] == [4]
    assert own.limb_children(4) == [6]
    assert own.reach[0] == pytest.approx(3.5)
    # A control that carries a joint with a role is a bone.
    votes = [{"hand_l": 1.0} if j == 3 else {} for j in range(8)]
    kinds = [CONTROL if j == 2 else "" for j in range(8)]
    assert SkeletonTree.of(tree(), votes, kinds).children[1] == [2, 4, 7]


def standing(toes: float, up: UpAxis = UpAxis.Y) -> SkeletonTree:
    """Return who stands along y, feet that point to z by a length."""
    rows = [
        (-1, (0, 1, 0)), (0, (0, 0.6, 0)), (0, (0.1, -0.5, 0)), (2, (0, -0.4, 0)),
        (3, (0, -0.05, toes)), (0, (-0.1, -0.5, 0)), (5, (0, -0.4, 0)),
        (6, (0, -0.05, toes)),
        (1, (0.3, 0, 0)), (1, (-0.3, 0, 0)),
    ]  # fmt: skip
    joints = tuple(
        Joint(str(j), parent, translation=tuple(map(float, way)))
        for j, (parent, way) in enumerate(rows)
    )
    rig = Rig("person", joints, up=up)
    return SkeletonTree.of(rig, [{}] * 10, [""] * 10)


TIPS = {"leg_l": 4, "leg_r": 7, "arm_l": 8, "arm_r": 9}


def test_who_stands_has_a_way_up_and_a_left() -> None:
    own = standing(0.2)
    up = find_up_direction(own, TIPS)
    assert up is not None
    assert_allclose(up / np.linalg.norm(up), [0, 1, 0], atol=0.1)
    assert find_up_direction(own, {"leg_l": 4, "leg_r": 7}) is None
    assert_allclose(
        find_left_direction(own, TIPS, up, is_rest_pose=True), [1, 0, 0], atol=1e-12
    )
    back = standing(-0.2)
    assert_allclose(
        find_left_direction(back, TIPS, up, is_rest_pose=True), [-1, 0, 0], atol=1e-12
    )
    # Who hangs head down has the left on the other side.
    down = np.array([0.1, -1.0, 0.2])
    assert_allclose(
        find_left_direction(own, TIPS, down, is_rest_pose=True), [-1, 0, 0], atol=1e-12
    )
    # Feet that only hang say nothing: then it is z that is ahead.
    none = standing(0.0)
    assert_allclose(
        find_left_direction(none, TIPS, None, is_rest_pose=True), [1, 0, 0], atol=1e-12
    )
    lying = find_left_direction(standing(0.0, UpAxis.Z), {}, None, is_rest_pose=True)
    assert_allclose(lying, [1, 0, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("way", "twists"),
    [
        ((-1.04, 0.0, 0.0), True),
        ((-1.06, 0.0, 0.0), False),
        ((-0.5, 0.3, 0.0), False),
        ((0.0, 0.0, 0.0), True),
        ((-0.5, 0.01, 0.0), True),
    ],
)
def test_what_lies_along_a_bone_to_its_sibling_twists_it(
    way: tuple[float, float, float], twists: bool
) -> None:
    """No farther than a twentieth beyond it; and what is in the joint itself."""
    rows = list(tree().joints)
    rows[6] = Joint("6", 4, translation=way)
    rows[5] = Joint("5", 4, translation=(-1.0, 0, 0), tips=((-0.4, 0.0, 0.0),))
    own = SkeletonTree.of(Rig("tree", tuple(rows)), [{}] * 8, [""] * 8)
    assert own.limb_children(4) == ([5] if twists else [5, 6])
    votes = [{"hand_l": 1.0} if j == 6 else {} for j in range(8)]
    named = SkeletonTree.of(Rig("tree", tuple(rows)), votes, [""] * 8)
    assert named.limb_children(4) == [5, 6]


@pytest.mark.parametrize(
    ("other", "alike"), [(0.86, True), (0.84, False), (1.17, True)]
)
def test_branches_alike_within_a_sixth_of_their_length_are_a_pair(
    other: float, alike: bool
) -> None:
    joints = [Joint("hips", -1)]
    for side, length in ((1.0, 1.0), (-1.0, other)):
        first = len(joints)
        joints.append(Joint(f"a{side}", 0, translation=(0.2 * side * length, 0, 0)))
        for k in range(3):
            way = (0.0, -length * 0.8 / 3, 0.0)
            joints.append(Joint(f"{k}{side}", first + k, translation=way))
    rig = Rig("two", tuple(joints))
    own = SkeletonTree.of(rig, [{} for _ in joints], [""] * len(joints))
    assert [sorted(pair) for pair in _similar_subtrees(own)] == (
        [[1, 5]] if alike else []
    )


@pytest.mark.parametrize(
    ("joints", "alike"),
    [((5, 8), True), ((5, 9), False), ((9, 5), False), ((10, 14), True)],
)
def test_branches_of_a_pair_have_about_as_many_joints(
    joints: tuple[int, int], alike: bool
) -> None:
    """Two more than a fifth more at most; both are a metre long."""
    made = [Joint("hips", -1)]
    for side, count in zip((1.0, -1.0), joints, strict=True):
        first = len(made)
        made.append(Joint(f"a{side}", 0, translation=(0.2 * side, 0, 0)))
        for k in range(count - 1):
            way = (0.0, -0.8 / (count - 1), 0.0)
            made.append(Joint(f"{k}{side}", first + k, translation=way))
    rig = Rig("two", tuple(made))
    own = SkeletonTree.of(rig, [{} for _ in made], [""] * len(made))
    assert [own.subtree_sizes[1], own.subtree_sizes[1 + joints[0]]] == [*joints]
    assert bool(_similar_subtrees(own)) == alike
