"""Warnings about rig files whose numbers suggest another unit or order."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from animtool.core.errors import counted
from animtool.documents.document import Document, Location
from animtool.rig.joint_schema import BallJointModel, JointModel, PinJointModel

# Half a revolution in radians, rounded up: the largest limit of most joints [rad].
HALF_CIRCLE = 3.2
# Limits this small are tight in any unit, such as those of a spine [file's angle].
TIGHT_LIMIT = 0.3
# Minimum number of joints whose limits are all within half a revolution in radians: one
# or two may be stiff.
MIN_JOINTS = 3
# Joints that bend by far more than this on every creature [deg].
HINGE_NAMES = re.compile("knee|elbow", re.IGNORECASE)
MIN_HINGE = 2 * HALF_CIRCLE
# Multiples of 15 degrees in radians, with at least three decimals.
ANGLE_STEP, STEP_TOLERANCE = math.radians(15), 6e-4
# Limits in radians exceed a full revolution only for joints that wind up [rad].
FULL_CIRCLE, MAX_DEGREES = 6.4, 360.0
HALF_CIRCLE_Z = [0.0, 0.0, 0.0, 1.0]


class _Limit(NamedTuple):
    location: Location
    joint: str
    values: list[float]

    @property
    def largest(self) -> float:
        return max(map(abs, self.values))

    def text(self, factor: float = 1.0) -> str:
        numbers = ", ".join(f"{value * factor:.4g}" for value in self.values)
        return numbers if len(self.values) == 1 else f"[{numbers}]"


def warn_of_angles(
    document: Document, joints: Sequence[JointModel], angle: str
) -> None:
    """Warn of limits in radians where degrees are declared, and vice versa (RIG107)."""
    limits = [limit for limit in _limits(joints) if limit.largest > 0]
    intended_unit = "rad" if angle == "deg" else "deg"
    suspects = _in_radians(limits) if angle == "deg" else _in_degrees(limits)
    if not suspects:
        return
    largest_limit = max(suspects, key=lambda limit: limit.largest)
    factor = math.degrees(1.0) if angle == "deg" else math.radians(1.0)
    names = {limit.joint for limit in suspects}
    unit = {"deg": "degrees", "rad": "radians"}
    message = (
        f"the limits of {counted(len(names), 'joint')} look like "
        f"{unit[intended_unit]}, but "
        f"units.angle is {angle}: {largest_limit.joint!r} has {largest_limit.text()}"
    )
    hint = (
        f"write 'angle: {intended_unit}' under units, or this limit in {unit[angle]}: "
        f"{largest_limit.text(factor)}"
    )
    document.warn("RIG107", largest_limit.location, message, hint)


def is_multiple(value: float) -> bool:
    """Return whether a number is a multiple of 15 degrees in radians.

    >>> is_multiple(1.5708), is_multiple(0.7854), is_multiple(1.5)
    (True, True, False)
    """
    nearest_step = round(value / ANGLE_STEP)
    return nearest_step != 0 and abs(value - nearest_step * ANGLE_STEP) < STEP_TOLERANCE


def warn_of_order(document: Document, joints: Sequence[JointModel]) -> None:
    """Warn of [0, 0, 0, 1], which is the identity only if w is last (RIG108)."""
    rotations = [joint.rotate for joint in joints if "rotate" in joint.model_fields_set]
    if any(abs(w) > abs(z) for w, _, _, z in rotations):
        return
    for i, joint in enumerate(joints):
        if joint.rotate == HALF_CIRCLE_Z:
            warn_of_quaternion(document, "RIG108", ("joints", i, "rotate"))
            return


def warn_of_quaternion(document: Document, code: str, location: Location) -> None:
    """Warn of [0, 0, 0, 1] at a location."""
    message = (
        "[0, 0, 0, 1] is half a turn about z: quaternions are [w, x, y, z], w first"
    )
    hint = "no rotation is [1, 0, 0, 0]; write [0, 0, 0, -1] if half a turn is meant"
    document.warn(code, location, message, hint)


def _limits(joints: Sequence[JointModel]) -> Iterator[_Limit]:
    for i, joint in enumerate(joints):
        location: Location = ("joints", i, "limits")
        if isinstance(joint, PinJointModel) and joint.limits is not None:
            yield _Limit(location, joint.name, joint.limits)
        if isinstance(joint, BallJointModel) and joint.limits is not None:
            swing, twist = joint.limits.swing, joint.limits.twist
            if swing is not None:
                swings = swing if isinstance(swing, list) else [swing]
                yield _Limit((*location, "swing"), joint.name, swings)
            if isinstance(twist, list):
                yield _Limit((*location, "twist"), joint.name, twist)


def _in_radians(limits: list[_Limit]) -> list[_Limit]:
    if any(limit.largest > HALF_CIRCLE for limit in limits):
        return [
            limit
            for limit in limits
            if (
                HINGE_NAMES.search(limit.joint)
                and len(limit.values) == 2
                and 0 < limit.values[1] - limit.values[0] < MIN_HINGE
                and limit.largest <= HALF_CIRCLE
            )
        ]
    joints = {limit.joint for limit in limits}
    largest = max((limit.largest for limit in limits), default=0.0)
    has_multiple = any(is_multiple(value) for limit in limits for value in limit.values)
    hinge = any(HINGE_NAMES.search(limit.joint) for limit in limits)
    plausible = len(joints) < MIN_JOINTS and not has_multiple and not hinge
    return [] if plausible or largest < TIGHT_LIMIT else limits


def _in_degrees(limits: list[_Limit]) -> list[_Limit]:
    return [
        limit
        for limit in limits
        if FULL_CIRCLE < limit.largest <= MAX_DEGREES
        and all(value.is_integer() for value in limit.values)
    ]
