"""Evaluates the drivers of a rig over its motion, block by block."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, FormatError, Severity, listed, warning
from animtool.core.quantities import length_text
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.rig.controls import undefined_faults
from animtool.rig.driver_plan import DriverPlan, plan_of
from animtool.rig.drivers import TWIST, split_coordinate
from animtool.rig.driving import DriverValues, ball_part_values, evaluate_drivers
from animtool.rig.limits import RangeLimit
from animtool.rig.shapes import add_combinations, subtract_combinations
from animtool.rig.skeleton import Joint, JointType, Rig

# Smaller differences are float32 rounding [rad], [m]; of weights and controls [1].
COORDINATE_ROUNDING, WEIGHT_ROUNDING = 1e-5, 1e-6
# Twists that step by more between frames wrapped at 180 degrees [rad].
HALF_REVOLUTION = np.pi


@dataclass(slots=True)
class LargestAmount:
    """Running maximum of an amount, and the frame at which it occurs."""

    amount: float = 0.0
    frame: float = 0.0

    def keep_larger(self, amounts: FloatArray, times: FloatArray) -> None:
        """Keep the largest of the amounts ``(F,)`` or ``(1,)`` and its time."""
        if not len(times) or not len(amounts):
            return
        worst_index = int(np.argmax(amounts))
        if amounts[worst_index] > self.amount:
            self.amount = float(amounts[worst_index])
            self.frame = float(times[worst_index if len(amounts) > 1 else 0])


@dataclass(slots=True)
class DriverRun:
    """Evaluates the drivers of a rig on consecutive blocks of its motion."""

    rig: Rig  # a rig with drivers
    # Whether to report source motion that drivers replace.
    reports_replaced: bool = False
    plan: DriverPlan = field(init=False)
    # Angle of each unlimited pin at the end of the last block [rad].
    _last_angle_by_joint: dict[int, float] = field(default_factory=dict, init=False)
    # Each twist at the end of the last block [rad], and its first wrap [frame].
    _last_twist_by_coordinate: dict[str, float] = field(
        default_factory=dict, init=False
    )
    _wrap_frame_by_coordinate: dict[str, float] = field(
        default_factory=dict, init=False
    )
    _limit_excess_by_joint: dict[str, LargestAmount] = field(
        default_factory=dict, init=False
    )
    _replaced_amount_by_target: dict[str, LargestAmount] = field(
        default_factory=dict, init=False
    )
    _targets_keeping_source: set[str] = field(default_factory=set, init=False)

    def __post_init__(self) -> None:
        """Determine the evaluation order of the rig's drivers."""
        self.plan = plan_of(self.rig)

    def evaluate(
        self,
        motion: Motion,
        times: FloatArray,
        coordinates: Mapping[str, FloatArray] | None = None,
    ) -> Motion:
        """Return a motion with driven joints, shapes and controls evaluated.

        The motion's frames continue those before; the times are for reports.
        ``coordinates`` are unwrapped joint coordinates by name, such as
        ``elbow.angle``, that override the motion's.
        """
        if motion.frames == 1:
            # Twice, as one frame does not distinguish moving from static values.
            two_samples = motion.select(np.zeros(2, np.int64))
            driven_samples = self.evaluate(
                two_samples, np.repeat(times, 2), coordinates
            )
            return driven_samples.select(slice(1))
        rig = self.rig
        controls = self._current_controls(motion)
        read_coordinate = _CoordinateReader(self, motion, times, coordinates or {})
        kept_targets = self._find_targets_to_keep(motion)
        driver_values = evaluate_drivers(
            self.plan, read_coordinate, controls, kept_targets
        )
        _check_defined(rig, driver_values, times)
        for j, excess in driver_values.excess.items():
            largest_excess = self._limit_excess_by_joint.setdefault(
                rig.names[j], LargestAmount()
            )
            largest_excess.keep_larger(np.abs(excess), times)
        return replace(
            self._driven_joints(motion, driver_values, times),
            weights=self._driven_weights(motion, driver_values, times),
            controls=self._driven_controls(motion, driver_values, times),
        )

    def notices(self) -> list[Fault]:
        """Return the warnings about drivers collected so far."""
        return [fault for fault, _, _ in self.located_notices()]

    def located_notices(self) -> list[tuple[Fault, str, float]]:
        """Return the warnings about drivers, with their targets and worst frames."""
        notices = []
        for name, largest_amount in self._limit_excess_by_joint.items():
            joint = self.rig.joints[self.rig.index(name)]
            if largest_amount.amount > COORDINATE_ROUNDING:
                message = (
                    f"the driver of {name!r} exceeds its limits by "
                    f"{_amount_text(joint, largest_amount.amount)} at frame "
                    f"{largest_amount.frame:g}; the joint is clamped"
                )
                hint = "widen the limits, or reduce the driver"
                fault = warning("RIG103", message, hint)
                notices.append((fault, f"joint/{name}", largest_amount.frame))
        for name, frame in self._wrap_frame_by_coordinate.items():
            message = f"{name} crosses 180 degrees at frame {frame:g}: what it drives "
            message += "jumps there"
            hint = "the limits of the joint's twist place the seam"
            fault = warning("RIG105", message, hint)
            notices.append((fault, f"joint/{split_coordinate(name)[0]}", frame))
        if self._targets_keeping_source and self.reports_replaced:
            targets = self._targets_keeping_source
            target_names = sorted(target.partition("/")[2] for target in targets)
            message = "the take contains no controls for its drivers to read: "
            message += f"{listed(target_names)} keep the take's values"
            fault = Fault("RIG106", message, severity=Severity.NOTE)
            notices.append((fault, min(targets), 0.0))
        for target, largest_amount in self._replaced_amount_by_target.items():
            kind, _, name = target.partition("/")
            amount = f"{largest_amount.amount:.4g}"
            if kind == "joint":
                joint = self.rig.joints[self.rig.index(name)]
                amount = _amount_text(joint, largest_amount.amount)
            message = (
                f"{kind} {name!r} is driven, which replaces the source's motion of it; "
                f"the largest difference is {amount}, at frame "
                f"{largest_amount.frame:g}"
            )
            hint = "remove its `driven` from the rig to keep the source's motion"
            notices.append(
                (warning("RIG104", message, hint), target, largest_amount.frame)
            )
        return notices

    def unwrap_angles(self, j: int, angles: FloatArray) -> FloatArray:
        """Return the angles ``(F,)`` of a hinge without limits, made continuous."""
        last_angle = self._last_angle_by_joint.get(j, 0.0)
        unwrapped_angles = np.unwrap(np.concatenate([[last_angle], angles]))[1:]
        if len(unwrapped_angles):
            self._last_angle_by_joint[j] = float(unwrapped_angles[-1])
        return unwrapped_angles

    def record_wrap(
        self, coordinate_name: str, twists: FloatArray, times: FloatArray
    ) -> None:
        """Record the first frame at which a twist jumps by over half a revolution."""
        if not len(twists):
            return
        steps = np.abs(
            np.diff(
                twists,
                prepend=self._last_twist_by_coordinate.get(coordinate_name, twists[0]),
            )
        )
        if (steps > HALF_REVOLUTION).any():
            wrap_index = int(np.argmax(steps > HALF_REVOLUTION))
            self._wrap_frame_by_coordinate.setdefault(
                coordinate_name, float(times[wrap_index])
            )
        self._last_twist_by_coordinate[coordinate_name] = float(twists[-1])

    def _find_targets_to_keep(self, motion: Motion) -> set[str]:
        """Return targets that keep the motion's values if the motion has no controls.

        Those values were driven by controls when the motion was made, so they are
        better than values from default controls.
        """
        kept_targets = set[str]()
        rig = self.rig
        for target in self.plan.controlled_targets if motion.controls is None else ():
            kind, _, name = target.partition("/")
            is_posed = False
            if kind == "joint":
                j = rig.index(name)
                if rig.joints[j].type is JointType.PRISMATIC:
                    rest_translation = rig.rest_translations[j]
                    is_posed = _is_posed(motion.translations, j, rest_translation)
                else:
                    is_posed = _is_posed(motion.rotations, j, rig.rest_rotations[j])
            elif kind == "shape" and motion.weights is not None:
                shape_names = [shape.name for shape in rig.shapes]
                is_posed = _is_posed(
                    motion.weights, shape_names.index(name), np.zeros(1)
                )
            if is_posed:
                kept_targets.add(target)
        self._targets_keeping_source |= kept_targets
        return kept_targets

    def _current_controls(self, motion: Motion) -> dict[str, FloatArray]:
        """Return the motion's control values, or the defaults if it has none."""
        if motion.controls is None:
            return {c.name: np.array([c.default]) for c in self.rig.controls}
        return {
            control.name: _column_values(motion.controls, i)
            for i, control in enumerate(self.rig.controls)
        }

    def _driven_joints(
        self, motion: Motion, driver_values: DriverValues, times: FloatArray
    ) -> Motion:
        """Return a motion with the driven joints replaced."""
        rig = self.rig
        rotations_by_joint: dict[int, FloatArray] = {}
        translations_by_joint: dict[int, FloatArray] = {}
        for j, value in driver_values.joints.items():
            joint = rig.joints[j]
            rest_rotation = np.array(joint.rotation)
            if joint.type is JointType.PRISMATIC:
                slide = so3.rotate(rest_rotation, value[:, None] * np.array(joint.axis))
                translations_by_joint[j] = np.array(joint.translation) + slide
            else:
                rotation = so3.from_axis_angle(joint.axis, value)
                rotations_by_joint[j] = so3.multiply(rest_rotation, rotation)
        for j, driven_values in [
            *rotations_by_joint.items(),
            *translations_by_joint.items(),
        ]:
            is_rotation = j in rotations_by_joint
            channel = motion.rotations if is_rotation else motion.translations
            current_values = _joint_rows(channel, j)
            rest_values = rig.rest_rotations if is_rotation else rig.rest_translations
            distance = so3.angle_between if is_rotation else _translation_distance
            rest_distances = distance(current_values, rest_values[j][None])
            is_off_rest = rest_distances.max(initial=0.0) > COORDINATE_ROUNDING
            if is_off_rest and rig.joints[j].driven is not None:
                target = f"joint/{rig.names[j]}"
                differences = distance(current_values, driven_values)
                self._record_replaced(target, differences, times, COORDINATE_ROUNDING)
        return replace(
            motion,
            rotations=_with_joint_rows(motion.rotations, rotations_by_joint),
            translations=_with_joint_rows(motion.translations, translations_by_joint),
        )

    def _driven_weights(
        self, motion: Motion, driver_values: DriverValues, times: FloatArray
    ) -> Channel | None:
        """Return the weights with driven and combined shapes replaced."""
        plan, shapes = self.plan, self.rig.shapes
        if not plan.shapes:
            return motion.weights
        channel = motion.weights
        if channel is None:
            channel = Channel.static(np.zeros((len(shapes), 1)), motion.frames)
        source_weights_by_shape = {
            shape.name: _column_values(channel, i) for i, shape in enumerate(shapes)
        }
        uncombined_weights = subtract_combinations(shapes, source_weights_by_shape)
        uncombined_weights |= driver_values.shapes
        new_weights = add_combinations(shapes, uncombined_weights)
        index_by_shape = {shape.name: i for i, shape in enumerate(shapes)}
        changed_shapes = dict.fromkeys(
            [*driver_values.shapes, *plan.combination_shapes]
        )
        for name in driver_values.shapes:
            if source_weights_by_shape[name].any():
                differences = np.abs(new_weights[name] - source_weights_by_shape[name])
                target = f"shape/{name}"
                self._record_replaced(target, differences, times, WEIGHT_ROUNDING)
        rows_by_shape_index = {
            index_by_shape[name]: new_weights[name][:, None] for name in changed_shapes
        }
        return _with_joint_rows(channel, rows_by_shape_index)

    def _driven_controls(
        self, motion: Motion, driver_values: DriverValues, times: FloatArray
    ) -> Channel | None:
        """Return the controls with driven values replaced; None if there are none."""
        controls, channel = self.rig.controls, motion.controls
        if not driver_values.controls or channel is None:
            return channel
        rows_by_control_index = {
            i: driver_values.controls[control.name][:, None]
            for i, control in enumerate(controls)
            if control.name in driver_values.controls
        }
        for i, value in rows_by_control_index.items():
            source_values = _column_values(channel, i)
            if (source_values != controls[i].default).any():
                differences = np.abs(value[:, 0] - source_values)
                target = f"control/{controls[i].name}"
                self._record_replaced(target, differences, times, WEIGHT_ROUNDING)
        return _with_joint_rows(channel, rows_by_control_index)

    def _record_replaced(
        self, target: str, differences: FloatArray, times: FloatArray, tolerance: float
    ) -> None:
        """Record the difference between a target's source motion and driven motion."""
        if self.reports_replaced and differences.max(initial=0.0) > tolerance:
            largest_difference = self._replaced_amount_by_target.setdefault(
                target, LargestAmount()
            )
            largest_difference.keep_larger(differences, times)


@dataclass(frozen=True, slots=True)
class _CoordinateReader:
    """Reads joint coordinates from a motion."""

    run: DriverRun
    motion: Motion
    times: FloatArray
    known_coordinates: Mapping[str, FloatArray]
    # By name, as angles may be unwrapped only once a block.
    values_by_coordinate: dict[str, FloatArray] = field(default_factory=dict)

    def __call__(self, name: str) -> FloatArray:
        """Return a coordinate's values ``(F,)``, or ``(1,)`` if the joint is static."""
        if name in self.known_coordinates:
            return self.known_coordinates[name]
        if name not in self.values_by_coordinate:
            self.values_by_coordinate[name] = self._read_coordinate(name)
        return self.values_by_coordinate[name]

    def _read_coordinate(self, coordinate_name: str) -> FloatArray:
        """Return a coordinate from the motion's transforms."""
        rig = self.run.rig
        joint_name, part = split_coordinate(coordinate_name)
        j = rig.index(joint_name)
        joint = rig.joints[j]
        inverse_rest = so3.conjugate(rig.rest_rotations[j])
        if joint.type is JointType.PRISMATIC:
            offset = _joint_rows(self.motion.translations, j) - rig.rest_translations[j]
            return np.asarray(so3.rotate(inverse_rest, offset) @ np.array(joint.axis))
        rotation = so3.multiply(inverse_rest, _joint_rows(self.motion.rotations, j))
        if joint.type is JointType.BALL:
            values = ball_part_values(joint, part, rotation)
            if part == TWIST:
                self.run.record_wrap(coordinate_name, values, self.times)
            return values
        sine = rotation[:, :3] @ np.array(joint.axis)
        angles = 2.0 * np.arctan2(sine, rotation[:, 3])
        if isinstance(joint.limits, RangeLimit):
            middle = (joint.limits.low + joint.limits.high) / 2
            range_width = joint.limits.high - joint.limits.low
            if range_width <= 2 * np.pi:
                revolutions = np.round((angles - middle) / (2 * np.pi))
                return np.asarray(angles - 2 * np.pi * revolutions)
        return self.run.unwrap_angles(j, angles)


def _check_defined(rig: Rig, driver_values: DriverValues, times: FloatArray) -> None:
    """Raise if a driver's value is not finite."""
    values_by_target = {
        **{f"joint {rig.names[j]!r}": v for j, v in driver_values.joints.items()},
        **{f"control {name!r}": v for name, v in driver_values.controls.items()},
        **{f"shape {name!r}": v for name, v in driver_values.shapes.items()},
    }
    faults = undefined_faults(
        {f"the driver of {name}": v for name, v in values_by_target.items()}, times
    )
    if faults:
        raise FormatError(faults)


def _joint_rows(channel: Channel, i: int) -> FloatArray:
    """Return one joint's values ``(F, K)`` of a channel, or ``(1, K)`` if static."""
    column_index = int(np.searchsorted(channel.animated, i))
    if column_index < len(channel.animated) and channel.animated[column_index] == i:
        return np.asarray(channel.values[:, column_index])
    return np.asarray(channel.rest[i][None])


def _is_posed(channel: Channel, i: int, rest_value: FloatArray) -> bool:
    """Return whether a joint of a channel moves or differs from rest."""
    rest = channel.rest[i]
    difference = min(np.abs(rest - sign * rest_value).max() for sign in (1, -1))
    return i in channel.animated or bool(difference > COORDINATE_ROUNDING)


def _column_values(channel: Channel, i: int) -> FloatArray:
    """Return a shape's or control's values ``(F,)``, or ``(1,)`` if static."""
    return _joint_rows(channel, i)[:, 0]


def _with_joint_rows(
    channel: Channel, rows_by_joint: Mapping[int, FloatArray]
) -> Channel:
    """Return the channel with joints set to values ``(F, K)``, or static ``(1, K)``."""
    if not rows_by_joint:
        return channel
    frame_count = len(channel.values)
    static_rows = [
        i for i, values in rows_by_joint.items() if len(values) == 1 != frame_count
    ]
    animated_rows = sorted(rows_by_joint.keys() - static_rows)
    rest_values = channel.rest.copy()
    for i in static_rows:
        rest_values[i] = rows_by_joint[i][0]
    is_animated = ~np.isin(channel.animated, static_rows)
    kept_values = channel.values[:, is_animated]
    result = Channel(rest_values, channel.animated[is_animated], kept_values)
    if not animated_rows:
        return result
    shape = (frame_count, rest_values.shape[1])
    values = [np.broadcast_to(rows_by_joint[i], shape) for i in animated_rows]
    return result.put(np.array(animated_rows, np.int64), np.stack(values, axis=1))


def _translation_distance(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the distances between two translations in each frame ``(F,)`` [m]."""
    return np.asarray(np.linalg.norm(a - b, axis=-1))


def _amount_text(joint: Joint, amount: float) -> str:
    """Format an amount: a length for a prismatic joint's slide, else degrees."""
    if joint.type is JointType.PRISMATIC:
        return length_text(amount, 4)
    return f"{np.degrees(amount):.4g}\N{DEGREE SIGN}"
