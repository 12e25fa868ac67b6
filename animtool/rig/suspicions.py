"""Warnings about rig files whose numbers suggest another unit or order."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from animtool.core.array_types import ArrayLike, BoolArray, FloatArray
from animtool.core.errors import counted
from animtool.core.quantities import percent_hint
from animtool.documents.document import Document, Location
from animtool.rig.controls import Control, Drive
from animtool.rig.drivers import Driver, split_coordinate
from animtool.rig.joint_schema import BallJointModel, JointModel, PinJointModel
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import JointType, Rig
from animtool.rig.suspicious_shape import HINGE_NAMES

# Names of the angle units.
ANGLE_NAMES = {"deg": "degrees", "rad": "radians"}
# A driver with more inputs is not checked at their ends.
MAX_INPUTS = 4
OTHER_ANGLE_UNIT_AND_FACTOR = {
    "deg": ("rad", math.degrees(1.0)),
    "rad": ("deg", math.radians(1.0)),
}
# Half a revolution in radians, rounded up: the largest limit of most joints [rad].
HALF_REVOLUTION = 3.2
# A limit between these is a full revolution in radians, as of a robot's flange [rad].
REVOLUTION_RANGE = (6.27, 6.29)
# Limits this small are tight in any unit, such as those of a spine [file's angle].
TIGHT_LIMIT = 0.3
# Minimum number of joints whose limits are all within half a revolution in radians: one
# or two may be stiff.
MIN_JOINTS = 3
# Knees and elbows bend by far more than this on every creature [deg].
MIN_HINGE_RANGE = 2 * HALF_REVOLUTION
# Multiples of 15 degrees in radians, with at least three decimals, and of 5 with four.
ANGLE_STEP, STEP_TOLERANCE = math.radians(15), 6e-4
FINE_STEP, FINE_TOLERANCE = math.radians(5), 6e-5
# Limits in radians exceed a full revolution only for joints that wind up [rad].
FULL_REVOLUTION, MAX_DEGREES = 6.4, 360.0
HALF_REVOLUTION_ABOUT_Z = [0.0, 0.0, 0.0, 1.0]
# Rounding to two decimals changes the length of a quaternion by 0.01 at most [1].
MAX_LENGTH_ERROR = 0.02
# A smaller number beside an axis of length 1 is hardly an angle in degrees [deg].
MIN_AXIS_ANGLE = 2.0
# A number between, other than 1, may be one in radians [rad].
MIN_AXIS_RADIANS = 0.5
# Arms of cartoons stretch to a few times their length; more is a percentage [1].
MIN_PERCENT_STRETCH = 5.0
# Multiples of 90 degrees in radians are told at two decimals, such as 1.57.
QUARTER_ROUNDING = 2e-3


class AngleLimit(NamedTuple):
    """Angle limits of a joint, with their location in the file."""

    location: Location
    joint: str  # name
    values: list[float]  # ends or half-angles [file's angle]

    @property
    def largest_value(self) -> float:
        """Largest absolute value."""
        return max(map(abs, self.values))

    def values_text(self, factor: float = 1.0) -> str:
        """Return the values as text, multiplied by a factor."""
        numbers = ", ".join(f"{value * factor:.4g}" for value in self.values)
        return numbers if len(self.values) == 1 else f"[{numbers}]"


def warn_of_angles(
    document: Document, joints: Sequence[JointModel], angle_unit: str
) -> None:
    """Warn of limits in radians where degrees are declared, and vice versa (RIG107)."""
    intended_unit, unit_factor = OTHER_ANGLE_UNIT_AND_FACTOR[angle_unit]
    suspicious_limits = limits_in_other_unit(_joint_limits(joints), angle_unit)
    if not suspicious_limits:
        return
    largest_limit = max(suspicious_limits, key=lambda limit: limit.largest_value)
    joint_names = {limit.joint for limit in suspicious_limits}
    message = (
        f"the limits of {counted(len(joint_names), 'joint')} look like "
        f"{ANGLE_NAMES[intended_unit]}, but "
        f"units.angle is {angle_unit}: {largest_limit.joint!r} has "
        f"{largest_limit.values_text()}"
    )
    hint = (
        f"write 'angle: {intended_unit}' under units, or this limit in "
        f"{ANGLE_NAMES[angle_unit]}: "
        f"{largest_limit.values_text(unit_factor)}"
    )
    document.warn("RIG107", largest_limit.location, message, hint)


def limits_in_other_unit(
    limits: Iterable[AngleLimit], angle_unit: str
) -> list[AngleLimit]:
    """Return the limits that seem to be in the other unit than ``angle_unit``."""
    limits = [limit for limit in limits if limit.largest_value > 0]
    find_limits = _limits_in_radians if angle_unit == "deg" else _limits_in_degrees
    return find_limits(limits)


def are_multiples(values: ArrayLike) -> BoolArray:
    """Return a mask of numbers that, as radians, are multiples of 15 or just 5 degrees.

    >>> are_multiples([1.5708, 0.785, 1.5, 1.3963, 1.396]).tolist()
    [True, True, False, True, False]
    """
    array = np.asarray(values, np.float64)
    is_multiple = np.zeros(array.shape, np.bool_)
    for step, tolerance in (ANGLE_STEP, STEP_TOLERANCE), (FINE_STEP, FINE_TOLERANCE):
        steps = np.round(array / step)
        is_multiple |= (np.abs(array - steps * step) < tolerance) & (steps != 0)
    return is_multiple


def warn_of_w_last(document: Document, joints: Sequence[JointModel]) -> None:
    """Warn of [0, 0, 0, 1], which is the identity only if w is last (RIG108)."""
    rotations = [joint.rotate for joint in joints if "rotate" in joint.model_fields_set]
    if any(abs(w) > abs(z) for w, _, _, z in rotations):
        return
    for i, joint in enumerate(joints):
        if joint.rotate == HALF_REVOLUTION_ABOUT_Z:
            warn_of_quaternion(document, "RIG108", ("joints", i, "rotate"))
            return


def warn_of_quaternion(document: Document, code: str, location: Location) -> None:
    """Warn of [0, 0, 0, 1] at a location."""
    message = "[0, 0, 0, 1] is half a turn about z: quaternions are [w, x, y, z], w "
    message += "first"
    hint = "no rotation is [1, 0, 0, 0]; write [0, 0, 0, -1] if half a turn is meant"
    document.warn(code, location, message, hint)


def _joint_limits(joints: Sequence[JointModel]) -> Iterator[AngleLimit]:
    """Yield the limits of joints: ranges, swings and twists."""
    for i, joint in enumerate(joints):
        location: Location = ("joints", i, "limits")
        if isinstance(joint, PinJointModel) and joint.limits is not None:
            yield AngleLimit(location, joint.name, joint.limits)
        if isinstance(joint, BallJointModel) and joint.limits is not None:
            swing, twist = joint.limits.swing, joint.limits.twist
            if swing is not None:
                swings = swing if isinstance(swing, list) else [swing]
                yield AngleLimit((*location, "swing"), joint.name, swings)
            if isinstance(twist, list):
                yield AngleLimit((*location, "twist"), joint.name, twist)


def _limits_in_radians(limits: list[AngleLimit]) -> list[AngleLimit]:
    """Return the limits that look like radians; none if degrees are plausible."""
    low, high = REVOLUTION_RANGE
    if any(
        limit.largest_value > HALF_REVOLUTION and not low <= limit.largest_value <= high
        for limit in limits
    ):
        return [
            limit
            for limit in limits
            if (
                HINGE_NAMES.search(limit.joint)
                and len(limit.values) == 2
                and 0 < limit.values[1] - limit.values[0] < MIN_HINGE_RANGE
                and limit.largest_value <= HALF_REVOLUTION
            )
        ]
    joints = {limit.joint for limit in limits}
    largest_value = max((limit.largest_value for limit in limits), default=0.0)
    values = [value for limit in limits for value in limit.values]
    has_multiple = bool(are_multiples(values).any())
    has_hinge = any(HINGE_NAMES.search(limit.joint) for limit in limits)
    is_plausible = len(joints) < MIN_JOINTS and not has_multiple and not has_hinge
    return [] if is_plausible or largest_value < TIGHT_LIMIT else limits


def _limits_in_degrees(limits: list[AngleLimit]) -> list[AngleLimit]:
    """Return the limits that look like degrees."""
    return [
        limit
        for limit in limits
        if FULL_REVOLUTION < limit.largest_value <= MAX_DEGREES
        and (
            HINGE_NAMES.search(limit.joint)
            or all(map(_is_multiple_of_half, limit.values))
        )
    ]


def warn_of_quaternion_length(
    document: Document, location: Location, wxyz: Sequence[float]
) -> None:
    """Warn once of a quaternion whose length is not 1 (RIG110)."""
    length = math.hypot(*wxyz)
    is_reported = any(notice.code == "RIG110" for notice in document.notices)
    if is_reported or not 0 < length < math.inf or abs(length - 1) <= MAX_LENGTH_ERROR:
        return
    written_text, unit_text = (
        ", ".join(f"{number:.4g}" for number in numbers)
        for numbers in (wxyz, [number / length for number in wxyz])
    )
    message = f"quaternion [{written_text}] has length {length:.3g}; "
    message += f"it is read as [{unit_text}]"
    hint = f"write [{unit_text}], w first"
    if rotation := _axis_angle_text(wxyz):
        hint = rotation
    elif document.value.keys().isdisjoint({"rig", "scene"}):
        hint += "; for degrees, write three Euler angles"
    document.warn("RIG110", location, message, hint)


def _axis_angle_text(numbers: Sequence[float]) -> str | None:
    """Return a hint if four numbers look like an angle and an axis.

    A small angle other than 1 is assumed to be in radians.

    >>> _axis_angle_text([30.0, 0.0, 0.0, 1.0])
    'for 30° about [0, 0, 1] write [0.9659, 0, 0, 0.2588]'
    """
    for angle, axis in (numbers[0], numbers[1:]), (numbers[3], numbers[:3]):
        is_axis = abs(math.hypot(*axis) - 1) <= MAX_LENGTH_ERROR
        is_small = MIN_AXIS_RADIANS <= abs(angle) < MIN_AXIS_ANGLE
        is_radian = is_small and abs(abs(angle) - 1) > MAX_LENGTH_ERROR
        degrees = round(math.degrees(angle), 1) if is_radian else angle
        if not is_axis or not MIN_AXIS_ANGLE <= abs(degrees) <= MAX_DEGREES:
            continue
        half_angle = math.radians(degrees) / 2
        wxyz = [
            math.cos(half_angle),
            *(math.sin(half_angle) * number for number in axis),
        ]
        axis_text = ", ".join(f"{number:.4g}" for number in axis)
        text = ", ".join(f"{round(number, 4) + 0.0:g}" for number in wxyz)
        return f"for {degrees:.4g}° about [{axis_text}] write [{text}]"
    return None


def warn_of_stretch_percent(
    document: Document, location: Location, stretch: float
) -> None:
    """Warn once of a stretch that looks like a percentage (RIG114)."""
    is_reported = any(notice.code == "RIG114" for notice in document.notices)
    if is_reported or stretch < MIN_PERCENT_STRETCH:
        return
    message = f"stretch {stretch:.4g} lets the limb stretch to {1 + stretch:.4g} "
    message += "times its length"
    hint = percent_hint(stretch)
    document.warn("RIG114", location, message, hint)


def warn_of_drives(document: Document, rig: Rig) -> None:
    """Warn of drives and drivers that give radians in a rig in degrees (RIG112).

    The same for degrees in a rig in radians.
    """
    declared_unit = "deg" if rig.radians_per_unit != 1.0 else "rad"
    intended_unit, unit_factor = OTHER_ANGLE_UNIT_AND_FACTOR[declared_unit]
    default_by_control = {
        control.name: np.array([control.default]) for control in rig.controls
    }
    for control in rig.controls:
        for k, drive in enumerate(control.drives):
            if not drive.is_angle:
                continue
            largest_value = _max_drive_value(control, drive, default_by_control)
            if not _is_in_other_unit(rig, largest_value, drive.target):
                continue
            message = (
                f"{control.name!r} drives {drive.target!r} by {largest_value:.4g}, "
                f"which looks like {ANGLE_NAMES[intended_unit]}, "
                f"but units.angle is {declared_unit}"
            )
            hint = f"for {ANGLE_NAMES[declared_unit]} the result is "
            hint += f"{largest_value * unit_factor:.4g}; "
            hint += f"multiply the expression by {unit_factor:.6g}"
            control_names = [entry.get("name") for entry in document.value["controls"]]
            location = ("controls", control_names.index(control.name), "drives", k)
            document.warn("RIG112", location, message, hint)
            return
    entry_index_by_joint = {
        entry.get("name"): i for i, entry in enumerate(document.value.get("joints", ()))
    }
    for joint in rig.joints:
        if joint.driven is None or joint.type is not JointType.PIN:
            continue
        target = f"joint/{joint.name}.angle"
        largest_value = _max_driver_value(rig, joint.driven)
        if joint.name not in entry_index_by_joint or not _is_in_other_unit(
            rig, largest_value, target
        ):
            continue
        message = (
            f"{joint.name!r} is driven to {largest_value:.4g}, which looks like "
            f"{ANGLE_NAMES[intended_unit]}, but units.angle is {declared_unit}"
        )
        hint = (
            f"multiply the expression by {unit_factor:.6g}, or declare the other unit"
        )
        i = entry_index_by_joint[joint.name]
        document.warn("RIG112", ("joints", i, "driven"), message, hint)
        return


def _is_in_other_unit(rig: Rig, value: float, target: str) -> bool:
    """Return whether a target's value looks like degrees in a rig in radians.

    In a rig in degrees, return whether it looks like radians.
    """
    is_in_degrees = rig.radians_per_unit != 1.0
    return _is_radians(value) if is_in_degrees else _is_degrees(value, target)


def _max_driver_value(rig: Rig, driver: Driver) -> float:
    """Return a driver's largest value at the limits of its inputs [file's angle].

    Return 0 if an input has no limits, or there are many inputs.
    """
    input_ends = [_input_ends(rig, name) for name in driver.names]
    if len(input_ends) > MAX_INPUTS or not all(input_ends):
        return 0.0
    combinations = np.array(list(itertools.product(*input_ends))).reshape(
        -1, len(input_ends)
    )
    values_by_input = {name: combinations[:, i] for i, name in enumerate(driver.names)}
    values = np.abs(driver.evaluate(values_by_input) / driver.unit)
    return float(values.max()) if np.isfinite(values).all() else 0.0


def _input_ends(rig: Rig, name: str) -> tuple[float, ...]:
    """Return the limits of a driver's input [rad], [m], [1]; empty if it has none."""
    joint, _ = split_coordinate(name)
    if not joint:
        for control in rig.controls:
            if control.name == name and None not in (control.low, control.high):
                return (control.low or 0.0, control.high or 0.0)
        return ()
    limits = rig.joints[rig.index(joint)].limits if joint in rig.names else None
    return (limits.low, limits.high) if isinstance(limits, RangeLimit) else ()


def _max_drive_value(
    control: Control, drive: Drive, default_by_control: dict[str, FloatArray]
) -> float:
    """Return a drive's largest value over its control's range [file's angle]."""
    if control.low is None or control.high is None:
        return 0.0
    values_by_control = {
        **default_by_control,
        control.name: np.array([control.low, control.high]),
    }
    values = np.abs(drive.evaluate(control.name, values_by_control) / drive.unit)
    return float(values.max()) if np.isfinite(values).all() else 0.0


def _is_radians(value: float) -> bool:
    """Return whether a value is a common angle, such as 15 or 90°, in radians."""
    right_angle = math.radians(90)
    nearest_multiple = round(value / right_angle) * right_angle
    difference = abs(value - nearest_multiple)
    is_near = nearest_multiple != 0 and difference < QUARTER_ROUNDING
    return value <= HALF_REVOLUTION and (is_near or bool(are_multiples(value)))


def _is_degrees(value: float, target: str) -> bool:
    """Return whether a value of a target looks like degrees."""
    # A crank winds up; the angles of a ball joint do not.
    is_plausible = target.endswith(".angle") and not _is_multiple_of_half(value)
    return FULL_REVOLUTION < value <= MAX_DEGREES and not is_plausible


def _is_multiple_of_half(value: float) -> bool:
    """Return whether a number is a multiple of 0.5, as handwritten degrees are."""
    return float(2 * value).is_integer()
