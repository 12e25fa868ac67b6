"""Animation layers: additive and override blending of a property.

References: Autodesk, *FBX SDK documentation*, `FbxAnimLayer`: blend mode, rotation and
scale accumulation mode. Rotations that accumulate by layer are composed as if of order
XYZ, as Maya does; the node's own order counts for the result.
"""

from __future__ import annotations

from dataclasses import field

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.formats.fbx.angles import XYZ, principal_angles, rotations_of
from animtool.formats.fbx.curves import FbxCurve
from animtool.maths import so3

ADDITIVE, OVERRIDE, PASSTHROUGH = range(3)
TRANSLATION, ROTATION, SCALING = "Lcl Translation", "Lcl Rotation", "Lcl Scaling"
PERCENT = "DeformPercent"
# What else of a transform moves: offset and pivot of rotations, then of scales, and
# the rotations before and after.
PIVOTS = ("RotationOffset", "RotationPivot", "ScalingOffset", "ScalingPivot")
OUTER_ROTATIONS = ("PreRotation", "PostRotation")
# From here on a weight is whole [1].
FULL_WEIGHT = 0.99999


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """An animation layer of a take.

    Attributes:
        name: As in the file.
        weight: 1 is whole [1].
        curve: Its weight over time [%]; None is the one above.
        mode: Additive; override, whatever its weight; passthrough, which mixes by it.
        by_layer: Whether rotations accumulate as quaternions.
        by_product: Whether scales accumulate as products.
    """

    name: str
    weight: float = 1.0
    curve: FbxCurve | None = None
    mode: int = ADDITIVE
    by_layer: bool = False
    by_product: bool = False

    def weights(self, ticks: IntArray) -> FloatArray:
        """Return the layer weight at times ``(F,)`` [1]."""
        if self.curve is None:
            return np.full(
                len(ticks), 1.0 if self.weight > FULL_WEIGHT else self.weight
            )
        weights = np.clip(self.curve.at(ticks) / 100.0, 0.0, 1.0)
        return np.where(weights > FULL_WEIGHT, 1.0, weights)


@dataclass(slots=True, eq=False)
class LayerValues:
    """Curves and defaults of a property on one layer."""

    layer: Layer
    is_first: bool  # of its take
    defaults: list[float]  # of parts without a curve
    curves: list[FbxCurve | None]

    def at(self, ticks: IntArray) -> FloatArray:
        """Return the values at times ``(F, width)``."""
        values = np.tile(np.array(self.defaults, np.float64), (len(ticks), 1))
        for part, curve in enumerate(self.curves):
            if curve is not None:
                values[:, part] = curve.at(ticks)
        return values

    def constant(self) -> FloatArray | None:
        """Return its values if they never change, else None."""
        if any(curve is not None and not curve.is_static() for curve in self.curves):
            return None
        return np.asarray(self.at(np.zeros(1, np.int64))[0])


@dataclass(slots=True, eq=False)
class PropertyTrack:
    """A property over time, all layers blended.

    Attributes:
        of: The object, by its id.
        name: As ``Lcl Rotation``.
        layers: From the lowest up.
    """

    of: int | str
    name: str
    layers: list[LayerValues] = field(default_factory=list)

    def constant(self, base: FloatArray) -> FloatArray | None:
        """Return its values if they never change, else None."""
        for one in self.layers:
            weighted = one.layer.mode != OVERRIDE and not one.is_first
            if one.constant() is None or (weighted and one.layer.curve is not None):
                return None
        return np.asarray(self.at(base, np.zeros(1, np.int64))[0])

    def at(self, base: FloatArray, ticks: IntArray) -> FloatArray:
        """Return the values at times ``(F, width)``.

        base: what it is without animation ``(width,)``.
        """
        result = np.tile(base, (len(ticks), 1))
        for one in self.layers:
            values = one.at(ticks)
            if one.is_first or one.layer.mode == OVERRIDE:
                result = values
            else:
                weights = one.layer.weights(ticks)[:, None]
                result = self._combined(one.layer, result, values, weights)
        return result

    def _combined(
        self, layer: Layer, low: FloatArray, high: FloatArray, weights: FloatArray
    ) -> FloatArray:
        additive = layer.mode == ADDITIVE
        if self.name == ROTATION and layer.by_layer:
            a, b = (rotations_of(one, XYZ) for one in (low, high))
            if additive:
                identity = np.broadcast_to([0.0, 0.0, 0.0, 1.0], b.shape)
                combined = so3.multiply(a, so3.slerp(identity, b, weights[:, 0]))
            else:
                combined = so3.slerp(a, b, weights[:, 0])
            return principal_angles(combined)
        if self.name == SCALING and layer.by_product:
            size = _power(high, weights)
            return size * (low if additive else _power(low, 1.0 - weights))
        if additive:
            return low + weights * high
        return low + weights * (high - low)


def _power(scales: FloatArray, weights: FloatArray) -> FloatArray:
    """Return scales raised to a weight, signs kept; weight 0 gives 1."""
    sign = np.where((scales < 0) & (weights > 0), -1.0, 1.0)
    return np.asarray(np.abs(scales) ** weights * sign)
