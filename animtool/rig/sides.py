"""Left and right joints of a rig: pairing by name, and reflection."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.rig.limits import BallLimit
from animtool.rig.parts import Vector
from animtool.rig.skeleton import Joint, Pose

# Words for the left side, and the corresponding words for the right side.
SIDE_WORDS = {
    "left": "right",
    "lft": "rgt",
    "lf": "rt",
    "lt": "rt",
    "l": "r",
    "左": "右",
}
_OTHER_SIDE = {right: left for left, right in SIDE_WORDS.items()} | SIDE_WORDS
_LEFT_PATTERN, _RIGHT_PATTERN = (
    rf"(?<![A-Za-z]){word}|{word.capitalize()}|(?<![A-Za-z]){word.upper()}(?![a-z])"
    for word in ("left", "right")
)
# A letter separated by other characters, or by the case of its neighbours.
_SIDE_LETTER = (
    r"(?<![A-Za-z0-9])[{0}{1}](?![A-Za-z0-9])"
    r"|(?<![A-Za-z])[{0}{1}](?=[A-Z][a-z])|(?<![A-Za-z0-9]){0}(?=[A-Z])"
    r"|(?<=[a-z]){1}(?![A-Za-z0-9])"
)
_LEFT_MARK = re.compile(f"{_LEFT_PATTERN}|左|" + _SIDE_LETTER.format("l", "L"))
_RIGHT_MARK = re.compile(f"{_RIGHT_PATTERN}|右|" + _SIDE_LETTER.format("r", "R"))
# Patterns of left names, most reliable first. The last ones also match unrelated
# letters, but a partner with the other name must exist anyway.
_SIDE_PATTERNS = tuple(
    re.compile(pattern)
    for pattern in (
        f"{_LEFT_PATTERN}|左",
        _SIDE_LETTER.format("l", "L"),
        r"Left|LEFT|left|(?<![A-Za-z])[Ll](?:ft|f|t)(?![a-z])|Lft|Lf(?![a-z])",
        r"(?<![A-Za-z])[lL](?![A-Za-z])|(?<=[a-z0-9])L(?![a-z])",
        r"(?<![A-Za-z])[lL](?=[A-Za-z])",
        r"(?<=[A-Za-z0-9])[lL](?![A-Za-z])",
    )
)


@dataclass(frozen=True, slots=True)
class SidePairs:
    """Partners of joints or other named parts."""

    # Index of each partner ``(J,)``, or of the joint itself if it has none.
    partners: IntArray
    left: tuple[int, ...]  # indices of the left ones among the pairs found by name
    # Left or right names without a partner.
    unpaired_indices: tuple[int, ...]


def pair_sides(
    names: Sequence[str],
    parents: Sequence[int] | IntArray | None = None,
    stated_pairs: Sequence[tuple[str, str]] = (),
) -> SidePairs:
    """Pair left and right names of J joints.

    Two names are a pair if both exist, neither has another partner, and their parents
    are the same or partners (None: no hierarchy). Stated pairs take precedence over
    names.

    >>> pair_sides(["hips", "lfemur", "rfemur", "arm.L", "arm.R"]).partners.tolist()
    [0, 2, 1, 4, 3]
    >>> pair_sides(["rib", "tail_l"]).unpaired_indices
    (1,)
    """
    indices_by_name = {name: i for i, name in enumerate(names)}
    parent_list = [-1] * len(names) if parents is None else [int(p) for p in parents]
    partners = np.arange(len(names))
    unpaired_indices = set(range(len(names)))
    for a, b in ((indices_by_name[a], indices_by_name[b]) for a, b in stated_pairs):
        if a in unpaired_indices and b in unpaired_indices:
            partners[a], partners[b] = b, a
            unpaired_indices -= {a, b}
    left_indices: list[int] = []
    for _, _, left, right in sorted(
        _candidate_pairs(names, indices_by_name, _joint_depths(parent_list))
    ):
        parent = parent_list[left]
        partner_of_parent = int(partners[parent]) if parent >= 0 else -1
        if (
            left in unpaired_indices
            and right in unpaired_indices
            and partner_of_parent == parent_list[right]
        ):
            partners[left], partners[right] = right, left
            unpaired_indices -= {left, right}
            left_indices.append(left)
    unpaired_with_side = [i for i in sorted(unpaired_indices) if _has_side(names[i])]
    return SidePairs(partners, tuple(sorted(left_indices)), tuple(unpaired_with_side))


def find_likely_pairs(names: Sequence[str], pairs: SidePairs) -> list[tuple[str, str]]:
    """Return unpaired names that are probably left and right partners.

    >>> names = ["armLeft", "arm_right"]
    >>> find_likely_pairs(names, pair_sides(names))
    [('armLeft', 'arm_right')]
    """
    unpaired_names = [names[i] for i in pairs.unpaired_indices]
    left_names = [name for name in unpaired_names if _LEFT_MARK.search(name)]
    right_names = [name for name in unpaired_names if name not in left_names]
    likely_pairs = []
    for name in left_names:
        key = _without_side(name)
        candidates = [other for other in right_names if _without_side(other) == key]
        if len(candidates) == 1:
            likely_pairs.append((name, candidates[0]))
            right_names.remove(candidates[0])
    return likely_pairs


def mirrored_name(name: str) -> str | None:
    """Return the name of the same part on the other side; None without a clear side.

    >>> mirrored_name("shoulder_l"), mirrored_name("RightArm"), mirrored_name("spine")
    ('shoulder_r', 'LeftArm', None)
    """
    marks = [*_LEFT_MARK.finditer(name), *_RIGHT_MARK.finditer(name)]
    if len(marks) != 1:
        return None
    mark = marks[0]
    return name[: mark.start()] + _opposite_mark(mark[0]) + name[mark.end() :]


def name_side(name: str) -> str:
    """Return the side that a name clearly states: ``l``, ``r`` or empty.

    >>> name_side("LeftArm"), name_side("shoulder_r"), name_side("spine")
    ('l', 'r', '')
    """
    if mirrored_name(name) is None:
        return ""
    return "l" if _LEFT_MARK.search(name) else "r"


def _without_side(name: str) -> str:
    """Return a name without its side, in lower case."""
    without_words = _RIGHT_MARK.sub("", _LEFT_MARK.sub("", name))
    return re.sub(r"[^a-z0-9]", "", without_words.casefold())


def _has_side(name: str) -> bool:
    """Return whether a name contains a mark for left or right."""
    return bool(_LEFT_MARK.search(name) or _RIGHT_MARK.search(name))


def _joint_depths(parents: Sequence[int]) -> list[int]:
    """Return the number of ancestors of each joint."""
    depths: list[int] = []
    for parent in parents:
        depths.append(depths[parent] + 1 if parent >= 0 else 0)
    return depths


def _candidate_pairs(
    names: Sequence[str], indices_by_name: dict[str, int], depths: Sequence[int]
) -> Iterator[tuple[int, int, int, int]]:
    """Yield each possible pair as depth, rank of the naming, left and right index."""
    indices_by_fold: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        indices_by_fold.setdefault(name.casefold(), []).append(i)
    for left, name in enumerate(names):
        for rank, right_name in _partner_names(name):
            if right_name in indices_by_name:
                yield depths[left], rank, left, indices_by_name[right_name]
            elif (
                len(matches := indices_by_fold.get(right_name.casefold(), [])) == 1
                and rank < 3
            ):
                yield depths[left], rank + len(_SIDE_PATTERNS), left, matches[0]


def _partner_names(name: str) -> Iterator[tuple[int, str]]:
    """Yield rank and name of possible right partners of a left name."""
    for rank, pattern in enumerate(_SIDE_PATTERNS):
        side_marks = list(pattern.finditer(name))
        if len(side_marks) > 1:
            yield rank, pattern.sub(_right_mark, name)
        for side_mark in side_marks:
            prefix, suffix = name[: side_mark.start()], name[side_mark.end() :]
            yield rank, prefix + _right_mark(side_mark) + suffix


def _right_mark(side_mark: re.Match[str]) -> str:
    """Return the right-hand mark for a left-hand mark, in the same case."""
    return _opposite_mark(side_mark[0])


def _opposite_mark(word: str) -> str:
    """Return the other side's mark in the same case, such as Right for Left."""
    other_word = _OTHER_SIDE[word.lower()]
    if word.isupper():
        return other_word.upper()
    return other_word.capitalize() if word[0].isupper() else other_word


# Translation and rotation, world space.
PoseArrays = tuple[FloatArray, FloatArray]
ORIGIN: PoseArrays = (np.zeros(3), so3.IDENTITY)

# The plane x = 0: left and right are along X, whichever axis is up.
_MIRROR_SIGNS = np.array([-1.0, 1.0, 1.0])

# Smaller differences are rounding [m], [rad]; the file's own numbers are kept.
POSITION_TOLERANCE = 1e-12


def reflect_vector(vector: FloatArray) -> FloatArray:
    """Return vectors ``(..., 3)`` reflected in the plane x = 0."""
    return np.asarray(vector * _MIRROR_SIGNS)


def reflect_rotation(rotation: FloatArray) -> FloatArray:
    """Return rotations ``(..., 4)`` conjugated by the reflection in x = 0.

    >>> reflect_rotation(np.array([0.6, 0.0, 0.0, 0.8])).tolist()
    [0.6, -0.0, -0.0, 0.8]
    """
    return np.asarray(rotation * np.array([1.0, -1.0, -1.0, 1.0]))


def world_transform_below(parent_world: PoseArrays, pose: Pose) -> PoseArrays:
    """Return the world transform of a local transform below a parent."""
    position, rotation = parent_world
    position = position + so3.rotate(rotation, pose.translation)
    return position, so3.multiply(rotation, pose.rotation)


def mirror_pose(pose: Pose, world: PoseArrays, parent_world: PoseArrays) -> Pose:
    """Return the local pose of the partner joint, a reflection in world space."""
    translation = reflect_vector(np.array(pose.translation)) + 0.0
    local_rotation = reflect_rotation(np.array(pose.rotation)) + 0.0
    inverse_parent = so3.conjugate(parent_world[1])
    offset = so3.rotate(inverse_parent, reflect_vector(world[0]) - parent_world[0])
    rotation = so3.multiply(inverse_parent, reflect_rotation(world[1]))
    if (
        np.abs(offset - translation).max() > POSITION_TOLERANCE
        or so3.angle_between(rotation, local_rotation) > POSITION_TOLERANCE
    ):
        # The parents are not mirror images of each other.
        translation, local_rotation = offset + 0.0, rotation + 0.0
    a, b, c, d = local_rotation.tolist()
    return Pose(_float_tuple(translation), (a, b, c, d))


def mirror_joint(
    joint: Joint, world: PoseArrays, parent: int, parent_world: PoseArrays
) -> Joint:
    """Return the joint named ``joint.mirror``: the reflection of a joint at rest.

    A pin's axis is reflected so that equal coordinates are mirror images: both
    elbows bend by positive angles, and limits carry over.
    """
    pose = mirror_pose(joint.rest_pose, world, parent_world)
    limits = joint.limits
    if isinstance(limits, BallLimit):
        limits = replace(limits, twist_axis=_reflected_axis(limits.twist_axis))
    is_sliding = joint.type == "prismatic"
    return replace(
        joint,
        name=joint.mirror,
        mirror=joint.name,
        parent=parent,
        translation=pose.translation,
        rotation=pose.rotation,
        axis=_float_tuple(reflect_vector(np.array(joint.axis)))
        if is_sliding
        else _reflected_axis(joint.axis),
        tips=tuple(_float_tuple(reflect_vector(np.array(tip))) for tip in joint.tips),
        limits=limits,
        source_name="",
    )


def _reflected_axis(axis: Vector) -> Vector:
    """Return the reflected axis about which equal angles are mirror images."""
    return _float_tuple(-reflect_vector(np.array(axis)))


def _float_tuple(values: FloatArray) -> Vector:
    """Return three numbers as a tuple, without negative zeros."""
    x, y, z = (values + 0.0).tolist()
    return (x, y, z)
