"""Detects limbs, hands and trunk of a skeleton from its tree and bone lengths.

Names, if informative, are votes in the same search.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import (
    combinations,
    combinations_with_replacement,
    pairwise,
    permutations,
)

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.retarget.roles import CONTROL, END, SIDES, TWIST
from animtool.rig.kinematics import rest_world
from animtool.rig.skeleton import Rig

# Bones shorter than this fraction of the skeleton have zero length.
_MIN_BONE_LENGTH = 1e-4
# The reaches of two paired limbs differ by less than this fraction.
_PAIR_TOLERANCE = 0.15
# Minimum reach of a pair of limbs relative to the skeleton's size.
_MIN_LIMB_REACH = 0.2
# Maximum number of joints of a limb to assign; time grows with the fourth power.
_MAX_LIMB_JOINTS = 16
# Largest cosine between trunk and legs of a standing body.
_MAX_UPRIGHT_COSINE = -0.7
# Cosine above which a leaf lies along its sibling's bone, as a twist joint does.
_MIN_TWIST_COSINE = 0.97


# Two similar subtrees below one joint.
SubtreePair = tuple[int, int]


@dataclass(frozen=True)
class SkeletonTree:
    """A skeleton's tree and bone lengths, with the roles that joint names suggest."""

    rig: Rig
    # World positions of joints in the searched pose (J, 3) [m].
    positions: FloatArray
    last_bones: FloatArray  # world vectors of last bones at rest, or 0 (J, 3) [m]
    joint_kinds: tuple[str, ...]  # kind of each joint's name, such as twist (J,)
    # Weights of the roles that each name suggests (J,).
    votes: tuple[dict[str, float], ...]

    @classmethod
    def of(
        cls, rig: Rig, votes: Sequence[dict[str, float]], joint_kinds: Sequence[str]
    ) -> SkeletonTree:
        """Return the tree of a skeleton at rest."""
        rest_transforms = rest_world(rig)
        tips = np.zeros((len(rig.joints), 3))
        for j, joint in enumerate(rig.joints):
            if joint.tips:
                farthest = max(joint.tips, key=lambda tip: sum(x * x for x in tip))
                tips[j] = rest_transforms.linear[0, j] @ np.asarray(farthest)
        positions = rest_transforms.positions[0]
        return cls(rig, positions, tips, tuple(joint_kinds), tuple(votes))

    @cached_property
    def children(self) -> list[list[int]]:
        """Children of each joint; controls count only above joints with a role."""
        child_lists: list[list[int]] = [[] for _ in self.rig.joints]
        is_used = [kind != CONTROL for kind in self.joint_kinds]
        for j in range(len(is_used) - 1, -1, -1):
            parent = self.rig.joints[j].parent
            if is_used[j] and parent >= 0:
                child_lists[parent].insert(0, j)
                # A control above a joint with a role is an extra bone.
                is_used[parent] |= bool(self.votes[j]) or bool(child_lists[j])
        return child_lists

    @cached_property
    def lengths(self) -> FloatArray:
        """Distance of each joint from its parent at rest ``(J,)`` [m]; 0 for a root."""
        lengths = np.linalg.norm(self.rig.rest_translations, axis=1)
        lengths[self.rig.parents < 0] = 0.0
        return np.asarray(lengths)

    @cached_property
    def tip_lengths(self) -> FloatArray:
        """Length of each joint's last bone ``(J,)`` [m]; 0 if it has none."""
        return np.asarray(np.linalg.norm(self.last_bones, axis=1))

    @cached_property
    def reach(self) -> FloatArray:
        """Length of the longest path down from each joint ``(J,)`` [m]."""
        reach = self.tip_lengths.copy()
        for j in range(len(reach) - 1, -1, -1):
            parent = self.rig.joints[j].parent
            if parent >= 0 and j in self.children[parent]:
                reach[parent] = max(reach[parent], self.lengths[j] + reach[j])
        return reach

    @cached_property
    def size(self) -> float:
        """Length of the longest path through the skeleton from a root [m]."""
        return float(max(self.reach[self.rig.roots], default=0.0))

    @cached_property
    def subtree_sizes(self) -> list[int]:
        """Number of joints in the subtree of each joint, including itself."""
        counts = [1] * len(self.rig.joints)
        for j in range(len(counts) - 1, -1, -1):
            if self.rig.joints[j].parent >= 0:
                counts[self.rig.joints[j].parent] += counts[j]
        return counts

    def path(self, top: int, bottom: int) -> list[int]:
        """Return the joints from top to bottom; empty if bottom is not below top."""
        path = self.rig.upwards(bottom)[::-1]
        return path[path.index(top) :] if top in path else []

    def lowest_common_ancestor(self, joints: Sequence[int]) -> int:
        """Return the deepest joint whose subtree contains all joints, or -1."""
        common_ancestors = set(self.rig.upwards(joints[0]))
        for j in joints[1:]:
            common_ancestors &= set(self.rig.upwards(j))
        return max(common_ancestors, default=-1)

    def limb_children(self, joint: int) -> list[int]:
        """Return the children that continue a limb: no bone ends, no twist joints."""
        children = [c for c in self.children[joint] if not self._is_end(c)]
        if len(children) < 2:
            return children
        longest = max(children, key=self.length_through_joint)
        return [
            c for c in children if c == longest or not self._lies_on_bone(c, longest)
        ]

    def _is_end(self, joint: int) -> bool:
        """Return whether a leaf is a bone end or a twist joint."""
        if self.children[joint] or self.votes[joint]:
            return False
        return self.joint_kinds[joint] == END or self.is_tip(joint)

    def is_tip(self, joint: int) -> bool:
        """Return whether a leaf only marks the end of the bone above it."""
        tips = self.rig.joints[joint].tips
        if not tips or not self._has_bone_ends or self.children[joint]:
            return False
        return float(self.tip_lengths[joint]) <= _MIN_BONE_LENGTH * self.size

    @cached_property
    def _has_bone_ends(self) -> bool:
        """Whether leaves with a zero-length bone are bone ends instead of joints.

        Some files give no last bone a length; there, fingers of four joints show that
        the last joints are ends.
        """
        leaves = [j for j, children in enumerate(self.children) if not children]
        if any(self.tip_lengths[j] > _MIN_BONE_LENGTH * self.size for j in leaves):
            return True
        return sum(self._chain_length(leaf) >= 4 for leaf in leaves) >= 6

    def _chain_length(self, leaf: int) -> int:
        """Return the number of joints from a leaf up to the start of its chain."""
        ancestors = self.rig.upwards(leaf)
        forks = [i for i, j in enumerate(ancestors) if len(self.children[j]) > 1]
        return min(forks, default=len(ancestors))

    def _lies_on_bone(self, leaf: int, sibling: int) -> bool:
        """Return whether a joint lies on its sibling's bone, or at the joint itself."""
        if self.votes[leaf] or self.joint_kinds[leaf] == TWIST:
            return not self.votes[leaf]
        if self.children[leaf] or self.rig.joints[leaf].tips:
            return False
        length, bone = float(self.lengths[leaf]), float(self.lengths[sibling])
        if length <= _MIN_BONE_LENGTH * self.size:
            return True
        offsets = self.rig.rest_translations
        cosine = float(offsets[leaf] @ offsets[sibling]) / max(length * bone, 1e-30)
        return cosine > _MIN_TWIST_COSINE and length <= 1.05 * bone

    def length_through_joint(self, joint: int) -> float:
        """Return the longest path length from a joint's parent through it [m]."""
        return float(self.lengths[joint] + self.reach[joint])

    def longest_path(self, joint: int) -> list[int]:
        """Return the longest path down from a joint, itself first."""
        path = [joint]
        while children := self.limb_children(path[-1]):
            path.append(max(children, key=self.length_through_joint))
        return path

    def widest_branching(self, path: Sequence[int]) -> tuple[int, int]:
        """Return the joint of a path with the most branches, and their number."""
        branch_counts = [len(self.limb_children(j)) for j in path]
        largest = max(branch_counts)
        return path[branch_counts.index(largest)], largest


def find_limb_pairs(
    body: SkeletonTree,
) -> tuple[SubtreePair | None, SubtreePair | None]:
    """Return the pairs of legs and of arms, as far as the tree shows them."""
    outer_pairs: list[SubtreePair] = []
    for pair in sorted(
        _similar_subtrees(body), key=lambda pair: -body.length_through_joint(pair[0])
    ):
        ancestors = set(body.rig.upwards(pair[0]))
        if not any(ancestors & set(kept_pair) for kept_pair in outer_pairs):
            outer_pairs.append(pair)
    if len(outer_pairs) > 1:
        return max(
            permutations(outer_pairs[:4], 2),
            key=lambda legs_and_arms: _leg_score(body, *legs_and_arms),
        )
    if outer_pairs:
        max_branch_count = max(
            body.widest_branching(body.longest_path(joint))[1]
            for joint in outer_pairs[0]
        )
        has_fingers = max_branch_count >= 4
        return (None, outer_pairs[0]) if has_fingers else (outer_pairs[0], None)
    return None, None


def _similar_subtrees(body: SkeletonTree) -> list[SubtreePair]:
    """Return pairs of sibling joints with subtrees of similar length and size."""
    pairs = []
    for children in body.children:
        min_length, length_of = _MIN_LIMB_REACH * body.size, body.length_through_joint
        limb_roots = [c for c in children if body.subtree_sizes[c] > 1]
        limb_roots = [c for c in limb_roots if length_of(c) >= min_length]
        longest = sorted(limb_roots, key=length_of)[-_MAX_LIMB_JOINTS:]
        for a, b in combinations(longest, 2):
            shorter, longer = sorted(map(body.length_through_joint, (a, b)))
            smaller_size, larger_size = sorted(body.subtree_sizes[j] for j in (a, b))
            has_similar_length = longer - shorter <= _PAIR_TOLERANCE * longer
            if has_similar_length and larger_size <= 1.2 * smaller_size + 2:
                pairs.append((larger_size - smaller_size, longer - shorter, (a, b)))
    best_pairs: list[SubtreePair] = []
    for _, _, pair in sorted(pairs):
        if not any(set(pair) & set(best_pair) for best_pair in best_pairs):
            best_pairs.append(pair)
    return best_pairs


def _leg_score(body: SkeletonTree, legs: SubtreePair, arms: SubtreePair) -> float:
    """Return a score of how well two pairs of limbs fit as legs and arms."""
    hips, chest = (body.rig.joints[pair[0]].parent for pair in (legs, arms))
    paths = [body.rig.upwards(hips), body.rig.upwards(chest)]
    score = 2.0 * (hips in paths[1]) - 2.0 * (chest in paths[0][1:])
    score += float(np.sign(len(paths[1]) - len(paths[0])))
    finger_counts = [
        max(body.widest_branching(body.longest_path(child))[1] for child in pair)
        for pair in (legs, arms)
    ]
    score += 1.5 * float(np.sign(finger_counts[1] - finger_counts[0]))
    # On the side of the arms, the head is another branch.
    long_branches = [
        child
        for child in body.children[chest]
        if body.length_through_joint(child) > 0.04 * body.size
    ]
    score += 0.5 * (len(long_branches) > 2)
    return score + (
        body.length_through_joint(legs[0]) + body.length_through_joint(arms[0])
    ) / max(body.size, 1e-30)


def find_up_direction(
    body: SkeletonTree, tip_by_limb: Mapping[str, int]
) -> FloatArray | None:
    """Return the up direction of a standing body ``(3,)``; None if it does not stand.

    Limbs are given by their lowest joints: ``leg_l``, ``arm_r`` …
    """
    positions = body.positions
    if len(tip_by_limb) < 4:
        return None
    legs, arms = (
        [tip_by_limb[f"{limb}_{side}"] for side in SIDES] for limb in ("leg", "arm")
    )
    hips, chest = body.lowest_common_ancestor(legs), body.lowest_common_ancestor(arms)
    trunk = positions[chest] - positions[hips]
    # Toes and hands point anywhere; mean limb positions are more reliable.
    leg_vectors = [
        positions[body.path(hips, leg)].mean(axis=0) - positions[hips] for leg in legs
    ]
    mean_leg_vector = np.asarray(leg_vectors).mean(axis=0)
    lengths = float(np.linalg.norm(trunk)), float(np.linalg.norm(mean_leg_vector))
    if min(lengths) <= 0.05 * body.size:
        return None
    cosine = float(trunk @ mean_leg_vector) / (lengths[0] * lengths[1])
    if cosine >= _MAX_UPRIGHT_COSINE:
        return None
    return np.asarray(trunk / lengths[0] - mean_leg_vector / lengths[1])


def find_left_direction(
    body: SkeletonTree,
    tip_by_limb: Mapping[str, int],
    up: FloatArray | None,
    *,
    is_rest_pose: bool,
) -> FloatArray:
    """Return a body's left direction ``(3,)``, from feet and trunk."""
    if up is None:
        up = np.array(body.rig.up.vector)
    # A body that stands along an axis faces that axis's conventional forward direction.
    up_index = int(np.argmax(np.abs(up)))
    forward = np.array([0.0, 0.0, 1.0] if up_index == 1 else [0.0, -1.0, 0.0])
    up_axis = np.eye(3)[up_index] * np.sign(up[up_index])
    feet: FloatArray = np.zeros(3)
    for name in sorted({"leg_l", "leg_r"} & tip_by_limb.keys()):
        toe = tip_by_limb[name]
        foot_bone = body.positions[toe] - body.positions[body.rig.joints[toe].parent]
        tip = body.last_bones[toe] if is_rest_pose else np.zeros(3)
        for bone in (foot_bone, tip):
            horizontal_bone = bone - up_axis * float(bone @ up_axis)
            # A leaning shin or ankle does not show where feet point.
            length = max(float(np.linalg.norm(bone)), 1e-30)
            if np.linalg.norm(horizontal_bone) > 0.6 * length:
                feet += horizontal_bone
    if np.linalg.norm(feet) > 0.01 * body.size:
        forward = feet / np.linalg.norm(feet)
    return np.cross(up_axis, forward)


@dataclass(frozen=True, slots=True)
class LimbShape:
    """Names and typical bone lengths of a limb's joints."""

    # Before the limb, its two long bones, its end, beyond the end.
    roles: tuple[str, ...]
    lower_over_upper: float  # of the upper long bone to the lower one
    before_over_upper: float  # length before the limb, relative to the upper bone
    end_over_upper: float  # length from the end's joint on, relative to the lower bone
    has_lead_joint: bool  # whether most skeletons have a joint above it


# Standard deviations of the logarithms of these lengths.
_RATIO_SPREAD, _BEFORE_SPREAD, _END_SPREAD = 0.2, 0.7, 0.5


def split_limb(
    body: SkeletonTree, path: Sequence[int], shape: LimbShape, branch: int = -1
) -> list[str]:
    """Return the most likely role of each joint along a limb, downwards.

    ``branch`` is the joint where the end of the limb begins, if the tree shows it.
    """
    remaining_joints, path = path[_MAX_LIMB_JOINTS:], path[:_MAX_LIMB_JOINTS]
    joint_count = len(path)
    joint_distances = np.cumsum(
        [0.0, *body.lengths[path[1:]], body.tip_lengths[path[-1]]]
    )
    best_labels, best_score = [""] * joint_count, -np.inf
    for upper, lower, end_index in combinations_with_replacement(
        range(joint_count + 1), 3
    ):
        for after_end in range(min(end_index + 1, joint_count), joint_count + 1):
            boundaries = [0, upper, lower, end_index, after_end, joint_count]
            limb_roles = [
                role
                for role, (a, b) in zip(shape.roles, pairwise(boundaries), strict=True)
                for _ in range(b - a)
            ]
            # How well names agree with roles; the first joint of a role counts most.
            score, previous = 0.0, ""
            for j, role_of_joint in zip(path, limb_roles, strict=True):
                votes = body.votes[j]
                if role_of_joint in votes:
                    weight = 20.0 if role_of_joint != previous else 12.0
                    score += weight * votes[role_of_joint]
                elif votes:
                    score -= 12.0
                previous = role_of_joint
            score += _shape_score(joint_distances, boundaries, shape)
            if branch >= 0:
                score += (
                    4.0
                    if end_index < joint_count and path[end_index] == branch
                    else -4.0
                )
            elif not shape.has_lead_joint and end_index < joint_count - 1:
                triple = [path[lower], path[end_index], path[end_index + 1]]
                score += _bend_amount(body, triple)
            if score > best_score:
                best_labels, best_score = limb_roles, score
    return best_labels + [""] * len(remaining_joints)


def _shape_score(
    distances: FloatArray, boundaries: Sequence[int], shape: LimbShape
) -> float:
    """Score how well a limb's bone lengths and joint counts fit a human limb."""
    _, upper, lower, end_index, _, n = boundaries
    counts = [b - a for a, b in pairwise(boundaries)]
    score = -0.4 * max(counts[1] - 1, 0) - 0.4 * max(counts[2] - 1, 0)
    score -= 2.0 * (counts[1] == 0) + 2.0 * (counts[2] == 0) + 2.0 * (counts[3] == 0)
    score -= 0.5 * abs(counts[0] - shape.has_lead_joint)
    score -= 0.5 * max(counts[3] - 1, 0) + 0.5 * max(counts[4] - 1, 0)
    length_before, upper_length, lower_length, end_length = np.diff(
        distances[[0, upper, lower, end_index, n]]
    ).tolist()
    if upper_length > 0 and lower_length > 0:
        ratio = upper_length / lower_length
        score -= _ratio_penalty(ratio, shape.lower_over_upper, _RATIO_SPREAD)
    elif distances[n] > 0:
        score -= 8.0
    if length_before > 0 and upper_length > 0:
        ratio = max(length_before / upper_length, 0.3 * shape.before_over_upper)
        score -= _ratio_penalty(ratio, shape.before_over_upper, _BEFORE_SPREAD)
    if end_length > 0 and lower_length > 0:
        ratio = end_length / lower_length
        if end_index == n or not shape.roles[4]:
            ratio = max(ratio, shape.end_over_upper)
        score -= _ratio_penalty(ratio, shape.end_over_upper, _END_SPREAD)
    return float(score)


def _ratio_penalty(ratio: float, typical_ratio: float, log_deviation: float) -> float:
    """Return half the squared deviation of a ratio in standard deviations, up to 12."""
    return min(0.5 * float(np.log(ratio / typical_ratio) / log_deviation) ** 2, 12.0)


def _bend_amount(body: SkeletonTree, joint_triple: Sequence[int]) -> float:
    """Return the bend of a path through three joints: 0 straight, 1 for 90° or more."""
    first_bone, second_bone = np.diff(body.positions[list(joint_triple)], axis=0)
    length_product = float(np.linalg.norm(first_bone) * np.linalg.norm(second_bone))
    if length_product <= 0:
        return 0.0
    return float(np.clip(1.0 - (first_bone @ second_bone) / length_product, 0.0, 1.0))
