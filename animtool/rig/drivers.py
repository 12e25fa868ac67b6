"""Drivers: values computed from joint coordinates and controls.

A driver has no state: in every frame its value follows from the pose and the controls
of that frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.rig.expressions import Expression, parse_expression

CurvePoints = tuple[tuple[float, float], ...]

# Joint parts that a driver reads: of a pin; of a prismatic joint; and of a ball, whose
# motion is swing · twist about the ``twist_axis`` of its limits: the twist, the swing's
# angle, and its rotation vector in the joint's rest frame.
ANGLE, SLIDE, TWIST, SWING = "angle", "slide", "twist", "swing"
SWING_PARTS = ("swing_x", "swing_y", "swing_z")


@dataclass(frozen=True, slots=True)
class Driver:
    """Computes a value from joint coordinates and controls."""

    # Expression over controls and coordinates, JOINT.PART; None if there is a curve.
    expression: Expression | None = None
    # Name of the control or coordinate that the curve reads.
    curve_input: str = ""
    # Points (input, value), ascending, constant beyond the ends.
    curve: CurvePoints = ()
    # Whether a monotone cubic joins the points, instead of straight lines.
    is_smooth: bool = False
    # Size of a value of 1: radians or metres per unit of the file, or 1.
    unit: float = 1.0
    # Unit of the slides and of the angles that it reads [m], [rad].
    length_unit: float = 1.0
    angle_unit: float = 1.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the controls and coordinates that it reads."""
        return (self.curve_input,) if self.expression is None else self.expression.names

    def unit_of(self, name: str) -> float:
        """Return the unit of an input [m], [rad], [1]."""
        joint, part = split_coordinate(name)
        if not joint:
            return 1.0
        return self.length_unit if part == SLIDE else self.angle_unit

    def evaluate(self, values_by_name: Mapping[str, FloatArray]) -> FloatArray:
        """Evaluate the driver [rad], [m], [1] on arrays ``(F,)`` or ``(1,)`` by name.

        >>> from animtool.rig.expressions import parse_expression
        >>> half = parse_expression("wrist.twist / 2", allows_coordinates=True)
        >>> Driver(half).evaluate({"wrist.twist": np.array([0.5])}).tolist()
        [0.25]
        """
        values_in_units = {
            name: values_by_name[name] / self.unit_of(name) for name in self.names
        }
        if self.expression is not None:
            # A constant expression.
            return np.atleast_1d(self.expression.evaluate(values_in_units)) * self.unit
        x = values_in_units[self.curve_input]
        return curve_values(self.curve, x, is_smooth=self.is_smooth) * self.unit

    def mirrored(self, partner_by_joint: Mapping[str, str]) -> Driver:
        """Return the mirrored driver, with partner joints by name.

        Equal angles, slides and twists are mirror images, and so are swings about X;
        swings about the other axes are mirror images with opposite signs.
        """
        sign_by_input = {
            name: -1.0
            for name in self.names
            if split_coordinate(name)[1] in SWING_PARTS[1:]
        }
        mirrored_driver = self
        if sign_by_input and self.expression is not None:
            text = self.expression.scaled_text(sign_by_input, 1.0)
            mirrored_driver = replace(
                self, expression=parse_expression(text, allows_coordinates=True)
            )
        elif sign_by_input:
            points = tuple((-x, y) for x, y in reversed(self.curve))
            mirrored_driver = replace(self, curve=points)
        return mirrored_driver.with_renamed_joints(partner_by_joint)

    def with_renamed_joints(self, new_name_by_joint: Mapping[str, str]) -> Driver:
        """Return the driver with new joint names in its inputs; others are kept."""
        new_names = renamed_coordinates(self.names, new_name_by_joint)
        if self.expression is not None:
            return replace(
                self, expression=self.expression.with_renamed_inputs(new_names)
            )
        return replace(self, curve_input=new_names[self.curve_input])


def split_coordinate(name: str) -> tuple[str, str]:
    """Split a name into joint and part; both empty for a control.

    >>> split_coordinate("arm.l.twist"), split_coordinate("grip")
    (('arm.l', 'twist'), ('', ''))
    """
    joint, _, part = name.rpartition(".")
    return (joint, part) if joint else ("", "")


def renamed_coordinates(
    input_names: Sequence[str], new_name_by_joint: Mapping[str, str]
) -> dict[str, str]:
    """Map coordinate and control names to their names after joints are renamed.

    >>> renamed_coordinates(["elbow.angle", "grip"], {"elbow": "knee"})
    {'elbow.angle': 'knee.angle', 'grip': 'grip'}
    """
    new_name_by_input = {}
    for name in input_names:
        joint, part = split_coordinate(name)
        new_name_by_input[name] = (
            f"{new_name_by_joint.get(joint, joint)}.{part}" if joint else name
        )
    return new_name_by_input


def curve_values(
    points: CurvePoints, x: FloatArray, *, is_smooth: bool = False
) -> FloatArray:
    """Evaluate a curve through points at ``x`` ``(F,)``, constant beyond its ends.

    Points are joined by straight lines, or if ``is_smooth``, by cubic Hermite segments
    whose slopes are those of `animtool.maths.tangents.auto_clamped`, and 0 at the ends.
    That has a continuous slope everywhere and never overshoots a point.

    >>> ease = ((0.0, 0.0), (1.0, 2.0))
    >>> curve_values(ease, np.array([-1.0, 0.25, 0.5, 3.0]), is_smooth=True).tolist()
    [0.0, 0.3125, 1.0, 2.0]
    """
    point_table = np.array(points, np.float64)
    if not is_smooth or len(point_table) == 1:
        return np.asarray(np.interp(x, point_table[:, 0], point_table[:, 1]))
    from animtool.maths.curves import cubic_curves, evaluate

    # Constant beyond the ends; NaN stays NaN.
    clamped_x = np.clip(x, point_table[0, 0], point_table[-1, 0])
    is_nan = np.isnan(clamped_x)
    thirds = np.diff(point_table[:, 0]) / 3
    slopes = smooth_slopes(points)
    in_handles = -slopes * np.append(0.0, thirds)
    out_handles = slopes * np.append(thirds, 0.0)
    cubic_curve = cubic_curves(
        point_table[:, 0], point_table[:, 1:], in_handles[:, None], out_handles[:, None]
    )
    values = evaluate(cubic_curve, np.where(is_nan, point_table[0, 0], clamped_x))[0]
    return np.where(is_nan, np.nan, values)


def smooth_slopes(points: CurvePoints) -> FloatArray:
    """Return the slopes ``(K,)`` of a smooth curve at its points."""
    from animtool.maths.tangents import auto_clamped

    table = np.array(points, np.float64)
    slopes = auto_clamped(table[:, 0], table[:, 1:])[:, 0]
    slopes[0] = slopes[-1] = 0.0
    return slopes
