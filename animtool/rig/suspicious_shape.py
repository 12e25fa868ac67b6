"""Warnings about rigs whose size or up axis look mistaken."""

from __future__ import annotations

import re

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.quantities import length_text
from animtool.core.units import LengthUnit, UpAxis, unit_name
from animtool.documents.document import Document
from animtool.maths import so3
from animtool.rig.skeleton import MAX_SIZE, Rig

# Joints that every body with limbs has.
HINGE_NAMES = re.compile("knee|elbow", re.IGNORECASE)
# No body is smaller; a wrong unit is off by a factor of 39 or more [m].
MIN_BODY = 0.05
# A rig smaller than this in metres is smaller than an ant [m].
MIN_SIZE = 1e-3
# Joints that are below the others where a body stands, and joints above them.
FEET = re.compile("foot|feet|ankle|toe|paw|hoof|heel", re.IGNORECASE)
ABOVE = re.compile("head|neck|chest|spine|torso|pelvis|hips?(?![a-z])", re.IGNORECASE)
# Cosines to the up axis and to the other one of a body that stands along the other.
LYING, STANDING = 0.3, 0.8


def rest_pose(rig: Rig) -> tuple[FloatArray, FloatArray]:
    """Return world positions ``(J, 3)`` [m] and rotations ``(J, 4)`` at rest.

    One step for all joints of a depth: rigs are checked without the kernels.
    """
    depths = np.zeros(len(rig.joints), np.int64)
    for i, joint in enumerate(rig.joints):
        depths[i] = 0 if joint.parent < 0 else depths[joint.parent] + 1
    positions, rotations = rig.rest_translations.copy(), rig.rest_rotations.copy()
    for depth in range(1, int(depths.max(initial=0)) + 1):
        at_depth = np.flatnonzero(depths == depth)
        above = rig.parents[at_depth]
        turned = so3.rotate(rotations[above], positions[at_depth])
        positions[at_depth] = positions[above] + turned
        rotations[at_depth] = so3.multiply(rotations[above], rotations[at_depth])
    return positions, rotations


def warn_of_shape(document: Document, rig: Rig) -> None:
    """Warn of an implausible size and of a body that stands along another axis."""
    if len(rig.joints) < 2:
        return
    positions, _ = rest_pose(rig)
    size = float(np.linalg.norm(np.ptp(positions, axis=0)))
    _warn_of_size(document, rig, size)
    _warn_of_up(document, rig, positions)


def _warn_of_size(document: Document, rig: Rig, size: float) -> None:
    """Warn of a size that fits another unit better (RIG217)."""
    unit = rig.meters_per_unit
    is_body = any(map(HINGE_NAMES.search, rig.names))
    low = MIN_BODY if is_body else (MIN_SIZE if unit == 1.0 else unit)
    if not size or low <= size <= MAX_SIZE:
        return
    number = size / unit
    fitting_units = [
        str(other)
        for other in LengthUnit
        if MIN_BODY <= number * other.meters <= MAX_SIZE and other.meters != unit
    ]
    at = ("units", "length") if "units" in document.value else ("joints",)
    message = f"the rig measures {length_text(size)}, with lengths in {unit_name(unit)}"
    hint = f"try length: {' or '.join(fitting_units)}" if fitting_units else None
    document.warn("RIG217", at, message, hint)


def _warn_of_up(document: Document, rig: Rig, positions: FloatArray) -> None:
    """Warn of a body that stands along the axis that is not up (RIG111)."""
    feet = [j for j, name in enumerate(rig.names) if FEET.search(name)]
    above = [j for j, name in enumerate(rig.names) if ABOVE.search(name)]
    above = [j for j in above if j not in feet]
    if not (feet and above):
        return
    other = UpAxis.Z if rig.up is UpAxis.Y else UpAxis.Y
    offset = positions[above].mean(axis=0) - positions[feet].mean(axis=0)
    length = float(np.linalg.norm(offset))
    if not length or offset @ rig.up.vector > LYING * length:
        return
    if offset @ other.vector < STANDING * length:
        return
    message = (
        f"{rig.names[above[0]]!r} is {length_text(float(offset @ other.vector))} above "
        f"{rig.names[feet[0]]!r} along {other}, but the up axis is {rig.up}"
    )
    at = ("up",) if "up" in document.value else ("joints",)
    hint = f"write 'up: {other}', or keep {rig.up} if the body lies at rest"
    document.warn("RIG111", at, message, hint)
