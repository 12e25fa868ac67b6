"""Limbs, hands and trunk of a skeleton, found from its tree and bone lengths.

Names, where they tell anything, are votes that the same search weighs.
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
from animtool.core.units import UpAxis
from animtool.retarget.roles import CONTROL, END, SIDES, TWIST
from animtool.rig.kinematics import forward
from animtool.rig.skeleton import Rig

# Bones shorter than this fraction of the skeleton have no length.
_ZERO = 1e-4
# Limbs of a pair differ in reach by less than this fraction.
_PAIR_TOLERANCE = 0.15
# Least reach of a pair of limbs over the skeleton's size.
_LIMB = 0.2
# Most joints of a limb to assign; time grows with the fourth power.
_MAX_LIMB_JOINTS = 16
# Largest cosine between trunk and legs of a standing body.
_UPRIGHT = -0.7
# Cosine from which a leaf lies along its sibling's bone, as a twist joint does.
_ALONG = 0.97


# Two like subtrees below one joint.
Pair = tuple[int, int]


@dataclass(frozen=True)
class SkeletonTree:
    """A skeleton prepared for the anatomy search."""

    rig: Rig
    # Joint positions in the searched pose ``(J, 3)`` [m], world.
    positions: FloatArray
    last_bones: FloatArray  # at rest, zero for none ``(J, 3)`` [m], world
    kinds: tuple[str, ...]  # of joints that have no role, by their names ``(J,)``
    votes: tuple[dict[str, float], ...]  # weights of roles by names ``(J,)``

    @classmethod
    def of(
        cls, rig: Rig, votes: Sequence[dict[str, float]], kinds: Sequence[str]
    ) -> SkeletonTree:
        """Return the tree of a skeleton at rest."""
        rest = forward(rig, rig.rest_translations[None], rig.rest_rotations[None])
        tips = np.zeros((len(rig.joints), 3))
        for j, joint in enumerate(rig.joints):
            if joint.tips:
                farthest = max(joint.tips, key=lambda tip: sum(x * x for x in tip))
                tips[j] = rest.linear[0, j] @ np.asarray(farthest)
        return cls(rig, rest.positions[0], tips, tuple(kinds), tuple(votes))

    @cached_property
    def children(self) -> list[list[int]]:
        """Children of each joint, without controls that carry no joint with a role."""
        below: list[list[int]] = [[] for _ in self.rig.joints]
        used = [kind != CONTROL for kind in self.kinds]
        for j in range(len(used) - 1, -1, -1):
            parent = self.rig.joints[j].parent
            if used[j] and parent >= 0:
                below[parent].insert(0, j)
                # A control above a joint with a role is an extra bone.
                used[parent] |= bool(self.votes[j]) or bool(below[j])
        return below

    @cached_property
    def lengths(self) -> FloatArray:
        """Lengths of the offsets ``(J,)`` [m]; a root has none."""
        lengths = np.linalg.norm(self.rig.rest_translations, axis=1)
        lengths[self.rig.parents < 0] = 0.0
        return np.asarray(lengths)

    @cached_property
    def tips(self) -> FloatArray:
        """Lengths of the last bones, of joints that carry one ``(J,)`` [m]."""
        return np.asarray(np.linalg.norm(self.last_bones, axis=1))

    @cached_property
    def reach(self) -> FloatArray:
        """Length of the longest path down from each joint ``(J,)`` [m]."""
        reach = self.tips.copy()
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
    def counts(self) -> list[int]:
        """Number of joints in the subtree of each."""
        counts = [1] * len(self.rig.joints)
        for j in range(len(counts) - 1, -1, -1):
            if self.rig.joints[j].parent >= 0:
                counts[self.rig.joints[j].parent] += counts[j]
        return counts

    def path(self, top: int, bottom: int) -> list[int]:
        """Return the joints from one to another below it; empty if it is not below."""
        path = self.rig.upwards(bottom)[::-1]
        return path[path.index(top) :] if top in path else []

    def common(self, joints: Sequence[int]) -> int:
        """Return the lowest common ancestor of joints; -1 for none."""
        shared = set(self.rig.upwards(joints[0]))
        for j in joints[1:]:
            shared &= set(self.rig.upwards(j))
        return max(shared, default=-1)

    def limb_children(self, joint: int) -> list[int]:
        """Return the children that continue a limb: no bone ends, no twist joints."""
        below = [c for c in self.children[joint] if not self._is_end(c)]
        if len(below) < 2:
            return below
        longest = max(below, key=self.extent)
        return [c for c in below if c == longest or not self._along(c, longest)]

    def _is_end(self, joint: int) -> bool:
        if self.children[joint] or self.votes[joint]:
            return False
        return self.kinds[joint] == END or self.is_tip(joint)

    def is_tip(self, joint: int) -> bool:
        """Return whether a leaf only marks the end of the bone above it."""
        tips = self.rig.joints[joint].tips
        if not tips or not self._marked or self.children[joint]:
            return False
        return float(self.tips[joint]) <= _ZERO * self.size

    @cached_property
    def _marked(self) -> bool:
        """Whether leaves with a zero-length bone are bone ends, not joints.

        Some files give no last bone a length; there, fingers of four joints show that
        the last ones are ends.
        """
        leaves = [j for j, below in enumerate(self.children) if not below]
        if any(self.tips[j] > _ZERO * self.size for j in leaves):
            return True
        return sum(self._run(leaf) >= 4 for leaf in leaves) >= 6

    def _run(self, leaf: int) -> int:
        """Return the number of joints from a leaf up to the start of its chain."""
        above = self.rig.upwards(leaf)
        forks = [i for i, j in enumerate(above) if len(self.children[j]) > 1]
        return min(forks, default=len(above))

    def _along(self, leaf: int, other: int) -> bool:
        """Return whether a joint lies on its sibling's bone, or at the joint itself."""
        if self.votes[leaf] or self.kinds[leaf] == TWIST:
            return not self.votes[leaf]
        if self.children[leaf] or self.rig.joints[leaf].tips:
            return False
        length, bone = float(self.lengths[leaf]), float(self.lengths[other])
        if length <= _ZERO * self.size:
            return True
        offsets = self.rig.rest_translations
        cosine = float(offsets[leaf] @ offsets[other]) / max(length * bone, 1e-30)
        return cosine > _ALONG and length <= 1.05 * bone

    def extent(self, joint: int) -> float:
        """Return the longest path length from a joint's parent through it [m]."""
        return float(self.lengths[joint] + self.reach[joint])

    def heaviest(self, joint: int) -> list[int]:
        """Return the longest path down from a joint, itself first."""
        path = [joint]
        while below := self.limb_children(path[-1]):
            path.append(max(below, key=self.extent))
        return path

    def branches(self, path: Sequence[int]) -> tuple[int, int]:
        """Return the joint of a path with the most branches, and their number."""
        counts = [len(self.limb_children(j)) for j in path]
        most = max(counts)
        return path[counts.index(most)], most


def limb_pairs(body: SkeletonTree) -> tuple[Pair | None, Pair | None]:
    """Return the pairs of legs and of arms, as far as the tree shows them."""
    outer: list[Pair] = []
    for pair in sorted(_pairs(body), key=lambda pair: -body.extent(pair[0])):
        above = set(body.rig.upwards(pair[0]))
        if not any(above & set(other) for other in outer):
            outer.append(pair)
    if len(outer) > 1:
        return max(permutations(outer[:4], 2), key=lambda two: _leg_score(body, *two))
    if outer:
        hand = max(body.branches(body.heaviest(c))[1] for c in outer[0])
        return (None, outer[0]) if hand >= 4 else (outer[0], None)
    return None, None


def _pairs(body: SkeletonTree) -> list[Pair]:
    """Return pairs of similar subtrees, each joint with its most similar one."""
    pairs = []
    for below in body.children:
        long = [
            c
            for c in below
            if body.counts[c] > 1 and body.extent(c) >= _LIMB * body.size
        ]
        for a, b in combinations(sorted(long, key=body.extent)[-_MAX_LIMB_JOINTS:], 2):
            low, high = sorted((body.extent(a), body.extent(b)))
            fewer, more = sorted((body.counts[a], body.counts[b]))
            if high - low <= _PAIR_TOLERANCE * high and more <= 1.2 * fewer + 2:
                pairs.append((more - fewer, high - low, (a, b)))
    best: list[Pair] = []
    for _, _, pair in sorted(pairs):
        if not any(set(pair) & set(other) for other in best):
            best.append(pair)
    return best


def _leg_score(body: SkeletonTree, legs: Pair, arms: Pair) -> float:
    """Return how well two pairs fit as legs and arms."""
    hips, chest = (body.rig.joints[pair[0]].parent for pair in (legs, arms))
    paths = [body.rig.upwards(hips), body.rig.upwards(chest)]
    score = 2.0 * (hips in paths[1]) - 2.0 * (chest in paths[0][1:])
    score += float(np.sign(len(paths[1]) - len(paths[0])))
    fingers = [
        max(body.branches(body.heaviest(c))[1] for c in pair) for pair in (legs, arms)
    ]
    score += 1.5 * float(np.sign(fingers[1] - fingers[0]))
    # The head is another branch where the arms are.
    long = [c for c in body.children[chest] if body.extent(c) > 0.04 * body.size]
    score += 0.5 * (len(long) > 2)
    return score + (body.extent(legs[0]) + body.extent(arms[0])) / max(body.size, 1e-30)


def upright(body: SkeletonTree, tips: Mapping[str, int]) -> FloatArray | None:
    """Return the up direction of a standing body ``(3,)``; None if it does not stand.

    Limbs are given by their lowest joints: ``leg_l``, ``arm_r`` …
    """
    positions = body.positions
    if len(tips) < 4:
        return None
    legs, arms = ([tips[f"{limb}_{side}"] for side in SIDES] for limb in ("leg", "arm"))
    hips, chest = body.common(legs), body.common(arms)
    trunk = positions[chest] - positions[hips]
    # Toes and hands point anywhere: mean limb positions are more reliable.
    drops = [
        positions[body.path(hips, leg)].mean(axis=0) - positions[hips] for leg in legs
    ]
    drop = np.asarray(drops).mean(axis=0)
    lengths = float(np.linalg.norm(trunk)), float(np.linalg.norm(drop))
    if min(lengths) <= 0.05 * body.size:
        return None
    cosine = float(trunk @ drop) / (lengths[0] * lengths[1])
    return trunk / lengths[0] - drop / lengths[1] if cosine < _UPRIGHT else None


def left_of(
    body: SkeletonTree, tips: Mapping[str, int], up: FloatArray | None, *, at_rest: bool
) -> FloatArray:
    """Return a body's left direction ``(3,)``, from feet and trunk."""
    if up is None:
        is_y = body.rig.up is UpAxis.Y
        up = np.array([0.0, 1.0, 0.0] if is_y else [0.0, 0.0, 1.0])
    # A body standing along an axis faces that axis's conventional forward.
    axis = int(np.argmax(np.abs(up)))
    forward: FloatArray = np.array([0.0, 0.0, 1.0] if axis == 1 else [0.0, -1.0, 0.0])
    unit = np.eye(3)[axis] * np.sign(up[axis])
    feet: FloatArray = np.zeros(3)
    for name in sorted({"leg_l", "leg_r"} & tips.keys()):
        toe = tips[name]
        bones = body.positions[toe] - body.positions[body.rig.joints[toe].parent]
        tip = body.last_bones[toe] if at_rest else np.zeros(3)
        for bone in (bones, tip):
            level = bone - unit * float(bone @ unit)
            # A leaning shin or ankle does not tell where feet point.
            if np.linalg.norm(level) > 0.6 * max(float(np.linalg.norm(bone)), 1e-30):
                feet += level
    if np.linalg.norm(feet) > 0.01 * body.size:
        forward = feet / np.linalg.norm(feet)
    return np.cross(unit, forward)


@dataclass(frozen=True, slots=True)
class LimbShape:
    """Names and typical bone lengths of a limb's joints."""

    roles: tuple[str, ...]  # before it, its two long bones, its end, beyond it
    ratio: float  # of the upper long bone to the lower one
    before: float  # length before it, of the upper bone's
    end: float  # length from the end's joint on, of the lower bone's
    led: bool  # whether most skeletons have a joint above it


# How far the logarithms of those lengths vary.
_RATIO_SPREAD, _BEFORE_SPREAD, _END_SPREAD = 0.2, 0.7, 0.5


def split_limb(
    body: SkeletonTree, path: Sequence[int], limb: LimbShape, branch: int = -1
) -> list[str]:
    """Return the role of each joint along a limb, in the order of its roles.

    Args:
        body: The skeleton.
        path: Joints of the limb, downwards.
        limb: What it is.
        branch: The joint where the end begins, where the tree shows it.
    """
    beyond, path = path[_MAX_LIMB_JOINTS:], path[:_MAX_LIMB_JOINTS]
    n = len(path)
    at = np.cumsum([0.0, *body.lengths[path[1:]], body.tips[path[-1]]])
    best, best_score = [""] * n, -np.inf
    for upper, lower, end in combinations_with_replacement(range(n + 1), 3):
        for last in range(min(end + 1, n), n + 1):
            parts = [0, upper, lower, end, last, n]
            labels = [
                role
                for role, (a, b) in zip(limb.roles, pairwise(parts), strict=True)
                for _ in range(b - a)
            ]
            score = _named(body, path, labels) + _shaped(at, parts, limb)
            if branch >= 0:
                score += 4.0 if end < n and path[end] == branch else -4.0
            elif not limb.led and end < n - 1:
                score += _bend(body, [path[lower], path[end], path[end + 1]])
            if score > best_score:
                best, best_score = labels, score
    return best + [""] * len(beyond)


def _named(body: SkeletonTree, path: Sequence[int], labels: Sequence[str]) -> float:
    """Return how well names agree with roles; a role's first joint counts most."""
    score, before = 0.0, ""
    for j, label in zip(path, labels, strict=True):
        votes = body.votes[j]
        if label in votes:
            score += (20.0 if label != before else 12.0) * votes[label]
        elif votes:
            score -= 12.0
        before = label
    return score


def _shaped(at: FloatArray, parts: Sequence[int], limb: LimbShape) -> float:
    """Return how well a limb's lengths and joint counts fit a human one."""
    _, upper, lower, end, _, n = parts
    counts = [b - a for a, b in pairwise(parts)]
    score = -0.4 * max(counts[1] - 1, 0) - 0.4 * max(counts[2] - 1, 0)
    score -= 2.0 * (counts[1] == 0) + 2.0 * (counts[2] == 0) + 2.0 * (counts[3] == 0)
    score -= 0.5 * abs(counts[0] - limb.led)
    score -= 0.5 * max(counts[3] - 1, 0) + 0.5 * max(counts[4] - 1, 0)
    before, up = float(at[upper] - at[0]), float(at[lower] - at[upper])
    low, behind = float(at[end] - at[lower]), float(at[n] - at[end])
    if up > 0 and low > 0:
        score -= _off(up / low, limb.ratio, _RATIO_SPREAD)
    elif at[n] > 0:
        score -= 8.0
    if before > 0 and up > 0:
        score -= _off(max(before / up, 0.3 * limb.before), limb.before, _BEFORE_SPREAD)
    if behind > 0 and low > 0:
        least = 0.0 if end < n and limb.roles[4] else limb.end
        score -= _off(max(behind / low, least), limb.end, _END_SPREAD)
    return float(score)


def _off(value: float, expected: float, spread: float) -> float:
    """Return half the squared deviation of a ratio, in spreads, up to 12."""
    return min(0.5 * float(np.log(value / expected) / spread) ** 2, 12.0)


def _bend(body: SkeletonTree, joints: Sequence[int]) -> float:
    """Return 0 to 1: how much the path through three joints bends, as at an ankle."""
    first, second = np.diff(body.positions[list(joints)], axis=0)
    size = float(np.linalg.norm(first) * np.linalg.norm(second))
    if size <= 0:
        return 0.0
    return float(np.clip(1.0 - (first @ second) / size, 0.0, 1.0))
