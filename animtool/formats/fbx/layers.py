"""Evaluates animated properties, and blends their layers, additive or override.

References: Autodesk, *FBX SDK documentation*, `FbxAnimLayer`: blend mode, rotation and
scale accumulation mode. Rotations that accumulate by layer are composed in XYZ order,
as in Maya; the node's own order applies to the result.
"""

from __future__ import annotations

from dataclasses import field

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.formats.fbx.curves import FbxCurve
from animtool.maths import euler, so3

ADDITIVE, OVERRIDE, PASSTHROUGH = range(3)
TRANSLATION, ROTATION, SCALING = "Lcl Translation", "Lcl Rotation", "Lcl Scaling"
DEFORM_PERCENT = "DeformPercent"
# Other animatable transform properties: offsets and pivots of rotation and scaling, and
# the rotations before and after.
PIVOT_PROPERTIES = ("RotationOffset", "RotationPivot", "ScalingOffset", "ScalingPivot")
OUTER_ROTATIONS = ("PreRotation", "PostRotation")
# Order XYZ as a product: X rotates first, so its factor is last.
XYZ_PRODUCT = "ZYX"
# Weights above this are 1 [1].
MIN_FULL_WEIGHT = 0.99999


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """Weight and blend mode of an animation layer of a take."""

    weight: float = 1.0  # weight without a curve [1]
    # Weight over time [%]; None uses the constant weight.
    weight_curve: FbxCurve | None = None
    # `ADDITIVE`; `OVERRIDE`, which ignores the weight; or `PASSTHROUGH`, which blends.
    mode: int = ADDITIVE
    accumulates_rotations: bool = False  # whether rotations accumulate as quaternions
    accumulates_scales: bool = False  # whether scales accumulate as products

    def weights(self, ticks: IntArray) -> FloatArray:
        """Return the weight of the layer at times ``(F,)`` [1]."""
        if self.weight_curve is None:
            weight = 1.0 if self.weight > MIN_FULL_WEIGHT else self.weight
            return np.full(len(ticks), weight)
        weights = np.clip(self.weight_curve.evaluate(ticks) / 100.0, 0.0, 1.0)
        return np.where(weights > MIN_FULL_WEIGHT, 1.0, weights)


@dataclass(slots=True, eq=False)
class LayerValues:
    """Curves and defaults of a property on one layer."""

    layer: Layer
    is_first: bool  # whether the layer is the first of the take
    defaults: list[float]  # values of components without a curve
    curves: list[FbxCurve | None]

    def evaluate(self, ticks: IntArray) -> FloatArray:
        """Return the values at times ``(F, D)``."""
        values = np.tile(np.array(self.defaults, np.float64), (len(ticks), 1))
        for component, curve in enumerate(self.curves):
            if curve is not None:
                values[:, component] = curve.evaluate(ticks)
        return values

    def is_static(self) -> bool:
        """Return whether no curve of the layer changes its value."""
        return all(curve is None or curve.is_static() for curve in self.curves)


@dataclass(slots=True, eq=False)
class PropertyTrack:
    """The curves of a property with D components, one set of curves per layer."""

    name: str  # name such as ``Lcl Rotation``
    layers: list[LayerValues] = field(default_factory=list)  # layers from bottom to top

    def curves(self) -> list[FbxCurve]:
        """Return the curves of all layers."""
        return [c for v in self.layers for c in v.curves if c is not None]

    def is_static(self) -> bool:
        """Return whether neither values nor effective layer weights ever change."""
        return all(
            values.is_static()
            and (
                values.layer.weight_curve is None
                or values.is_first
                or values.layer.mode == OVERRIDE
            )
            for values in self.layers
        )

    def evaluate(self, base_values: FloatArray, ticks: IntArray) -> FloatArray:
        """Return the values at times ``(F, D)``.

        ``base_values`` are the values without animation ``(D,)``.
        """
        blended_values = np.tile(base_values, (len(ticks), 1))
        for layer_values in self.layers:
            values = layer_values.evaluate(ticks)
            layer = layer_values.layer
            if layer_values.is_first or layer.mode == OVERRIDE:
                blended_values = values
            else:
                weights = layer.weights(ticks)[:, None]
                blended_values = self._blend_layer(
                    layer, blended_values, values, weights
                )
        return blended_values

    def _blend_layer(
        self, layer: Layer, lower: FloatArray, upper: FloatArray, weights: FloatArray
    ) -> FloatArray:
        is_additive = layer.mode == ADDITIVE
        if self.name == ROTATION and layer.accumulates_rotations:
            lower_rotations, upper_rotations = (
                rotations_from_angles(angles, XYZ_PRODUCT) for angles in (lower, upper)
            )
            start_rotations = lower_rotations
            if is_additive:
                start_rotations = np.broadcast_to(
                    [0.0, 0.0, 0.0, 1.0], upper_rotations.shape
                )
            rotations = so3.slerp(start_rotations, upper_rotations, weights[:, 0])
            if is_additive:
                rotations = so3.multiply(lower_rotations, rotations)
            return principal_angles(rotations)
        if self.name == SCALING and layer.accumulates_scales:
            base_scales = lower if is_additive else _scale_power(lower, 1.0 - weights)
            return _scale_power(upper, weights) * base_scales
        if is_additive:
            return lower + weights * upper
        return lower + weights * (upper - lower)


def _scale_power(scales: FloatArray, weights: FloatArray) -> FloatArray:
    """Return scales raised to a weight, signs kept; weight 0 gives 1."""
    sign = np.where((scales < 0) & (weights > 0), -1.0, 1.0)
    return np.asarray(np.abs(scales) ** weights * sign)


def rotations_from_angles(angles: FloatArray, order: str) -> FloatArray:
    """Return quaternions ``(F, 4)`` of angles about X, Y and Z ``(F, 3)`` [deg].

    >>> rotations_from_angles(np.array([[90.0, 0, 0]]), XYZ_PRODUCT).round(4).tolist()
    [[0.7071, 0.0, 0.0, 0.7071]]
    """
    return euler.to_quaternion(angles[:, euler.axes_of(order)], order)


def principal_angles(rotations: FloatArray) -> FloatArray:
    """Return XYZ angles ``(F, 3)`` [deg] of quaternions ``(F, 4)``.

    Of the equivalent triples, this is the one with Y within 90 degrees, independent of
    neighbouring frames. Tools that read the angles in another order expect it.

    >>> rotations = rotations_from_angles(np.array([[10.0, 20, 30]]), XYZ_PRODUCT)
    >>> principal_angles(rotations).round(6).tolist()
    [[10.0, 20.0, 30.0]]
    """
    matrices = so3.to_matrix(rotations)
    sine = np.clip(-matrices[:, 2, 0], -1.0, 1.0)
    y = np.arctan2(sine, np.hypot(matrices[:, 2, 1], matrices[:, 2, 2]))
    x = np.arctan2(matrices[:, 2, 1], matrices[:, 2, 2])
    z = np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0])
    # In gimbal lock only the sum of the other two angles is determined.
    is_gimbal_lock = np.abs(sine) > 1.0 - 1e-12
    x = np.where(is_gimbal_lock, 0.0, x)
    z = np.where(is_gimbal_lock, np.arctan2(-matrices[:, 0, 1], matrices[:, 1, 1]), z)
    return np.asarray(np.degrees(np.stack([x, y, z], axis=1)))
