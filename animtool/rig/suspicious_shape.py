"""Warnings about rigs whose size, offsets or up axis look mistaken."""

from __future__ import annotations

import re

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.quantities import length_text
from animtool.core.units import LengthUnit, UpAxis, unit_name
from animtool.documents.document import Document, Location
from animtool.maths import so3
from animtool.rig.sides import pair_sides, reflect_vector
from animtool.rig.skeleton import MAX_RIG_SIZE, Rig

# Joints that every body with limbs has.
HINGE_NAMES = re.compile("knee|elbow", re.IGNORECASE)
# No body is smaller; a wrong unit is off by a factor of 39 or more [m].
MIN_BODY_SIZE = 0.05
# Sizes of people and most animals [m].
BODY_SIZES = (0.3, 3.0)
# A rig smaller than this in metres is smaller than an ant [m].
MIN_SIZE = 1e-3
# Joints that are below the others where a body stands, and joints above them.
FOOT_NAMES = re.compile("foot|feet|ankle|toe|paw|hoof|heel", re.IGNORECASE)
UPPER_BODY_NAMES = re.compile(
    "head|neck|chest|spine|torso|pelvis|hips?(?![a-z])", re.IGNORECASE
)
# Cosines to the up axis and to the other one of a body that stands along the other.
MAX_LYING_COSINE, MIN_STANDING_COSINE = 0.3, 0.8
# Distances of joints to their parents, relative to their distances to the origin, if
# offsets are world positions: of any rig with branches, and of one whose feet are only
# then at the bottom. Rigs of characters have 0.7 or more, lizards and hands 0.37.
MAX_WORLD_RATIO, MAX_BODY_RATIO = 0.3, 0.6
# Fewer offsets, or ones that repeat, tell nothing.
MIN_OFFSETS, MIN_WORLD_BONE = 3, 1e-3
# Joints closer than this fraction of the rig's size are in the same place [1].
SAME_POSITION_FRACTION = 1e-4


def rest_pose_without_kernels(rig: Rig) -> tuple[FloatArray, FloatArray]:
    """Return world positions ``(J, 3)`` [m] and rotations ``(J, 4)`` at rest.

    Joints of equal depth are computed together in numpy, since rigs are checked without
    the kernels.
    """
    depths = np.zeros(len(rig.joints), np.int64)
    for i, joint in enumerate(rig.joints):
        depths[i] = 0 if joint.parent < 0 else depths[joint.parent] + 1
    positions, rotations = rig.rest_translations.copy(), rig.rest_rotations.copy()
    for depth in range(1, int(depths.max(initial=0)) + 1):
        joints_at_depth = np.flatnonzero(depths == depth)
        parents = rig.parents[joints_at_depth]
        rotated_offsets = so3.rotate(rotations[parents], positions[joints_at_depth])
        positions[joints_at_depth] = positions[parents] + rotated_offsets
        rotations[joints_at_depth] = so3.multiply(
            rotations[parents], rotations[joints_at_depth]
        )
    return positions, rotations


def warn_of_shape(document: Document, rig: Rig) -> None:
    """Warn of an implausible size, offsets, up axis or sides of a rig."""
    if len(rig.joints) < 2:
        return
    rest_positions, _ = rest_pose_without_kernels(rig)
    size = float(np.linalg.norm(np.ptp(rest_positions, axis=0)))
    if _warn_of_world_offsets(document, rig, rest_positions):
        return
    _warn_of_size(document, rig, size)
    _warn_of_up(document, rig, rest_positions)
    _warn_of_equal_sides(document, rig, rest_positions)


def _warn_of_size(document: Document, rig: Rig, rig_size: float) -> None:
    """Warn of a size that fits another unit better (RIG217)."""
    if any(notice.code == "RIG217" for notice in rig.notices):
        return
    unit = rig.meters_per_unit
    is_body = any(map(HINGE_NAMES.search, rig.names))
    min_size = MIN_BODY_SIZE if is_body else (MIN_SIZE if unit == 1.0 else unit)
    if not rig_size or min_size <= rig_size <= MAX_RIG_SIZE:
        return
    location = ("units", "length") if "units" in document.value else ("joints",)
    message = (
        f"the rig measures {length_text(rig_size)}, with lengths in {unit_name(unit)}"
    )
    hint = fitting_unit_hint(rig_size, unit, is_body=is_body)
    document.warn("RIG217", location, message, hint)


def fitting_unit_hint(size: float, unit: float, *, is_body: bool) -> str | None:
    """Return a hint with the units that give a plausible size; None if none does.

    Args:
        size: The rig's size [m].
        unit: Unit in which it is read [m].
        is_body: Whether it is a person or an animal.

    >>> fitting_unit_hint(151.0, 1.0, is_body=True)
    "write 'units: {length: cm}': 1.51 m"
    """
    size_ranges = [BODY_SIZES] if is_body else []
    for smallest, largest in (*size_ranges, (MIN_BODY_SIZE, MAX_RIG_SIZE)):
        units_and_sizes = [
            (other_unit, size / unit * other_unit.meters)
            for other_unit in LengthUnit
            if other_unit.meters != unit
            and smallest <= size / unit * other_unit.meters <= largest
        ]
        if units_and_sizes:
            return "write " + ", or ".join(
                f"'units: {{length: {other_unit}}}': {length_text(new_size)}"
                for other_unit, new_size in units_and_sizes
            )
    return None


def _warn_of_world_offsets(document: Document, rig: Rig, positions: FloatArray) -> bool:
    """Warn of joints whose offsets seem to be world positions (RIG113)."""
    rest_offsets, parents = rig.rest_translations, rig.parents
    child_joints = np.flatnonzero(parents >= 0)
    # Offsets from a joint at the origin are its children's positions as well.
    child_joints = child_joints[rest_offsets[parents[child_joints]].any(axis=1)]
    if len(child_joints) < MIN_OFFSETS:
        return False
    offset_lengths = np.linalg.norm(rest_offsets[child_joints], axis=1)
    bone_lengths = np.linalg.norm(
        rest_offsets[child_joints] - rest_offsets[parents[child_joints]], axis=1
    )
    total_length = float(offset_lengths.sum())
    has_branches = len({*parents[child_joints].tolist()}) < len(child_joints)
    if (
        bone_lengths.sum() > MAX_BODY_RATIO * total_length
        or (bone_lengths < MIN_WORLD_BONE * offset_lengths).any()
    ):
        return False
    if not has_branches or (
        bone_lengths.sum() > MAX_WORLD_RATIO * total_length
        and not (_is_upright(rig, rest_offsets) and not _is_upright(rig, positions))
    ):
        return False
    distances = np.linalg.norm(positions[child_joints], axis=1)
    j = int(child_joints[(distances - offset_lengths).argmax()])
    name, parent = rig.names[j], rig.names[int(parents[j])]
    bone = (rest_offsets[j] - rest_offsets[parents[j]]) / rig.meters_per_unit
    size_texts = (
        length_text(float(np.linalg.norm(np.ptp(points, axis=0))))
        for points in (positions, rest_offsets)
    )
    message = (
        f"the offsets of {len(child_joints)} joints look like world positions: the rig "
        "measures {}, and {} if they are".format(*size_texts)
    )
    hint = f"write positions relative to the parent; for {name!r}, from {parent!r}: "
    hint += f"translate: {_numbers_text(bone)}"
    document.warn("RIG113", _translate_location(document, name), message, hint)
    return True


def _translate_location(document: Document, name: str) -> Location:
    """Return the location of a joint's offset, or of the joints if it is inherited."""
    for i, entry in enumerate(document.value["joints"]):
        if entry.get("name") == name:
            return ("joints", i, "translate")
    return ("joints",)


def _numbers_text(numbers: FloatArray) -> str:
    return f"[{', '.join(f'{number + 0.0:.4g}' for number in numbers.tolist())}]"


def _is_upright(rig: Rig, positions: FloatArray) -> bool:
    """Return whether the feet of a body are below all of its torso."""
    feet, torso = _feet_and_torso(rig)
    if not (feet and torso):
        return False
    heights = positions @ rig.up.vector
    return bool(heights[feet].max() < heights[torso].min())


def _feet_and_torso(rig: Rig) -> tuple[list[int], list[int]]:
    """Return the joints of the feet, and those of the upper body, by name."""
    feet = [j for j, name in enumerate(rig.names) if FOOT_NAMES.search(name)]
    torso = [j for j, name in enumerate(rig.names) if UPPER_BODY_NAMES.search(name)]
    return feet, [j for j in torso if j not in feet]


def _warn_of_up(document: Document, rig: Rig, positions: FloatArray) -> None:
    """Warn of a body that stands along the axis that is not up (RIG111)."""
    feet, torso = _feet_and_torso(rig)
    if not (feet and torso):
        return
    feet_to_torso: FloatArray = positions[torso].mean(axis=0) - positions[feet].mean(
        axis=0
    )
    other_axis = UpAxis.Z if rig.up is UpAxis.Y else UpAxis.Y
    length = float(np.linalg.norm(feet_to_torso))
    if not length or feet_to_torso @ rig.up.vector > MAX_LYING_COSINE * length:
        return
    if feet_to_torso @ other_axis.vector < MIN_STANDING_COSINE * length:
        return
    message = (
        f"{rig.names[torso[0]]!r} is "
        f"{length_text(float(feet_to_torso @ other_axis.vector))} above "
        f"{rig.names[feet[0]]!r} along {other_axis}, but the up axis is {rig.up}"
    )
    location = ("up",) if "up" in document.value else ("joints",)
    hint = f"write 'up: {other_axis}', or keep {rig.up} if the body lies at rest"
    document.warn("RIG111", location, message, hint)


def _warn_of_equal_sides(document: Document, rig: Rig, positions: FloatArray) -> None:
    """Warn of a left joint at the position of the right one (RIG118).

    Pairs in the plane x = 0, such as collarbones that begin at the breastbone, may
    coincide.
    """
    for left, right in equal_sides(rig, positions):
        name = rig.names[right]
        message = f"{name!r} is where {rig.names[left]!r} is at rest"
        offset = reflect_vector(rig.rest_translations[right]) / rig.meters_per_unit
        hint = f"for the other side write translate: {_numbers_text(offset)}, or "
        hint += f"create it with 'mirror: {name}' in {rig.names[left]!r}"
        document.warn("RIG118", _translate_location(document, name), message, hint)


def equal_sides(rig: Rig, positions: FloatArray) -> list[tuple[int, int]]:
    """Return pairs of a left and a right joint with equal offsets across x = 0.

    Args:
        rig: Rig of J joints.
        positions: World positions at rest ``(J, 3)`` [m].
    """
    tolerance = SAME_POSITION_FRACTION * float(
        np.ptp(positions, axis=0).max(initial=0.0)
    )
    pairs = pair_sides(rig.names, rig.parents)
    return [
        (left, right)
        for left in pairs.left
        for right in [int(pairs.partners[left])]
        if rig.parents[left] == rig.parents[right] >= 0
        and not rig.joints[left].mirror
        and np.abs(positions[left] - positions[right]).max() <= tolerance
        and abs(positions[left, 0] - positions[rig.parents[left], 0]) > tolerance
    ]
