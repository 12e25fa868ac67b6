"""What layers make of a property."""

from __future__ import annotations

import numpy as np
import pytest

from animtool.formats.fbx.layers import (
    ADDITIVE,
    OVERRIDE,
    PASSTHROUGH,
    SCALING,
    TRANSLATION,
    Layer,
    LayerValues,
    PropertyTrack,
)

TICKS = np.zeros(1, np.int64)


def over(name: str, layer: Layer, low: float, high: float) -> float:
    """Return what a layer makes of a value below it."""
    curves = [None] * 3
    layers = [
        LayerValues(Layer(), True, [low] * 3, curves),
        LayerValues(layer, False, [high] * 3, curves),
    ]
    return float(PropertyTrack(name, layers).evaluate(np.zeros(3), TICKS)[0, 0])


@pytest.mark.parametrize(
    ("mode", "expected"), [(ADDITIVE, 3.0), (OVERRIDE, 4.0), (PASSTHROUGH, 2.5)]
)
def test_a_layer_at_half_weight(mode: int, expected: float) -> None:
    assert over(TRANSLATION, Layer(0.5, mode=mode), 1.0, 4.0) == expected


@pytest.mark.parametrize(
    ("mode", "weight", "high", "expected"),
    [
        (ADDITIVE, 0.5, 4.0, 6.0),
        (ADDITIVE, 0.0, -4.0, 3.0),
        (ADDITIVE, 1.0, -4.0, -12.0),
        (PASSTHROUGH, 0.5, 12.0, 6.0),
        (PASSTHROUGH, 0.0, -5.0, 3.0),
    ],
)
def test_scales_by_product(
    mode: int, weight: float, high: float, expected: float
) -> None:
    layer = Layer(weight, mode=mode, accumulates_scales=True)
    assert over(SCALING, layer, 3.0, high) == pytest.approx(expected)


def test_a_nearly_whole_weight_is_whole() -> None:
    assert over(TRANSLATION, Layer(0.999995, mode=PASSTHROUGH), 1.0, 4.0) == 4.0
