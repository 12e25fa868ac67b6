"""Evaluation of a rig's drivers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.rig.driver_plan import DriverPlan
from animtool.rig.drivers import (
    ANGLE,
    SLIDE,
    SWING,
    SWING_PARTS,
    TWIST,
    split_coordinate,
)
from animtool.rig.joints import coordinate_slices
from animtool.rig.limits import BallLimit, RangeLimit, swing_twist
from animtool.rig.skeleton import Joint, JointType, Mimic, Rig

# A twist range within this of a full revolution has no middle [rad].
REVOLUTION_TOLERANCE = 1e-6
# Maps the name of a coordinate to its values ``(F,)`` or ``(1,)`` [rad], [m].
ReadCoordinate = Callable[[str], FloatArray]


@dataclass(frozen=True, slots=True)
class DriverValues:
    """Driver values ``(F,)``, or ``(1,)`` if constant.

    Values that are not finite are kept; the caller has to check.
    """

    joints: dict[int, FloatArray]  # coordinates within the limits [rad], [m]
    excess: dict[int, FloatArray]  # amount by which limits changed them [rad], [m]
    controls: dict[str, FloatArray]
    shapes: dict[str, FloatArray]  # weights, without contributions of combined shapes


def evaluate_drivers(
    plan: DriverPlan,
    read_coordinate: ReadCoordinate,
    controls: Mapping[str, FloatArray],
    skipped_targets: Collection[str] = (),
) -> DriverValues:
    """Evaluate all drivers.

    Args:
        plan: Driver plan of the rig.
        read_coordinate: Maps the name of an undriven joint's coordinate to its values.
        controls: Values of all controls ``(F,)`` or ``(1,)``; those of driven controls
            are ignored.
        skipped_targets: Targets whose drivers are skipped; their joints are read as if
            undriven.
    """
    rig = plan.rig
    control_values = dict(controls)
    result = DriverValues({}, {}, {}, {})
    default_by_control = {control.name: control.default for control in rig.controls}
    for target in (*plan.order, *(f"shape/{name}" for name in plan.shapes)):
        if target in skipped_targets:
            continue
        kind, _, name = target.partition("/")
        inputs = _DriverInputs(plan, read_coordinate, control_values, result)
        if kind == "joint":
            _evaluate_joint_driver(plan, rig.index(name), inputs, result)
            continue
        driver = rig.drivers.get(target)
        if driver is not None:
            value = driver.evaluate(inputs)
        else:
            value = _control_contribution(rig, target, control_values)
        if kind == "shape":
            result.shapes[name] = value
            continue
        if driver is None:
            value = np.array([default_by_control[name]]) + value
        control_values[name] = result.controls[name] = value
    return result


def _evaluate_joint_driver(
    plan: DriverPlan,
    j: int,
    inputs: Mapping[str, FloatArray],
    driver_values: DriverValues,
) -> None:
    """Add the value of a joint's driver or mimic to the result, within its limits."""
    joints = plan.rig.joints
    driver = plan.driver_of(j)
    if isinstance(driver, Mimic):
        leader = joints[plan.rig.index(driver.joint)]
        part = SLIDE if leader.type is JointType.PRISMATIC else ANGLE
        value = driver.gain * inputs[f"{leader.name}.{part}"] + driver.offset
    else:
        value = driver.evaluate(inputs)
    limits = joints[j].limits
    clamped_value = limits.clamped(value) if isinstance(limits, RangeLimit) else value
    driver_values.joints[j] = np.where(np.isfinite(value), clamped_value, value)
    driver_values.excess[j] = (
        value - driver_values.joints[j] if np.isfinite(value).all() else value
    )


class _DriverInputs(dict[str, FloatArray]):
    """Values of driver inputs by name; joint coordinates are read when accessed."""

    def __init__(
        self,
        plan: DriverPlan,
        read_coordinate: ReadCoordinate,
        controls: Mapping[str, FloatArray],
        computed_values: DriverValues,
    ) -> None:
        super().__init__(controls)
        self._plan = plan
        self._read_coordinate = read_coordinate
        self._computed_values = computed_values

    def __missing__(self, name: str) -> FloatArray:
        joint = self._plan.rig.index(split_coordinate(name)[0])
        if joint in self._computed_values.joints:
            return self._computed_values.joints[joint]
        return self._read_coordinate(name)


def _control_contribution(
    rig: Rig, target: str, control_values: Mapping[str, FloatArray]
) -> FloatArray:
    """Return the controls' contribution to a target."""
    contribution = np.zeros(1)
    for control in rig.controls:
        for drive in control.drives:
            if drive.target == target:
                contribution = contribution + drive.evaluate(
                    control.name, control_values
                )
    return contribution


def ball_part_values(joint: Joint, part: str, rotations: FloatArray) -> FloatArray:
    """Return a ball's twist or swing part ``(F,)`` [rad] from rotations ``(F, 4)``.

    The twist is within half a revolution of the middle of its limits, or of 0 if it has
    none. At a swing of half a revolution it is undefined, and near it, it changes
    quickly.

    >>> ball = Joint("shoulder", -1, JointType.BALL, limits=BallLimit())
    >>> turn = so3.from_axis_angle((0, 1, 0), np.array([0.5]))
    >>> ball_part_values(ball, "twist", turn).round(12).tolist()
    [0.5]
    """
    limits = joint.limits
    assert isinstance(limits, BallLimit)
    swing, twist = swing_twist(rotations, limits.twist_axis)
    if part == TWIST:
        twist_low, twist_high = limits.twist or (-np.inf, np.inf)
        middle = 0.0
        if twist_high - twist_low < 2 * np.pi - REVOLUTION_TOLERANCE:
            middle = (twist_low + twist_high) / 2
        return np.asarray(twist - 2 * np.pi * np.round((twist - middle) / (2 * np.pi)))
    vector = so3.log(swing)
    if part == SWING:
        return np.asarray(np.linalg.norm(vector, axis=-1))
    return np.asarray(vector[:, SWING_PARTS.index(part)])


def driven_coordinates(plan: DriverPlan, coordinates: FloatArray) -> FloatArray:
    """Return coordinates ``(B, Q)`` with driven joints set by their drivers.

    Controls have their default values.
    """
    rig, slices = plan.rig, coordinate_slices(plan.rig)
    updated_coordinates = coordinates.copy()

    def read_coordinate(name: str) -> FloatArray:
        """Return a coordinate of an undriven joint."""
        joint, part = split_coordinate(name)
        j = rig.index(joint)
        columns = coordinates[:, slices[j]]
        if rig.joints[j].type is JointType.BALL:
            return ball_part_values(rig.joints[j], part, columns)
        return columns[:, 0]

    control_values = {
        control.name: np.array([control.default]) for control in rig.controls
    }
    for j, value in evaluate_drivers(
        plan, read_coordinate, control_values
    ).joints.items():
        updated_coordinates[:, slices[j].start] = value
    return updated_coordinates
