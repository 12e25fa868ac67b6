"""Combination shapes, and ARKit shape names.

References:
    Apple, ARKit documentation, ``ARFaceAnchor.BlendShapeLocation``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from animtool.core.array_types import FloatArray
from animtool.rig.parts import Shape, dependency_order

_SIDED_NAMES = """
browDown browOuterUp cheekSquint eyeBlink eyeLookDown eyeLookIn eyeLookOut eyeLookUp
eyeSquint eyeWide jaw mouth mouthDimple mouthFrown mouthLowerDown mouthPress mouthSmile
mouthStretch mouthUpperUp noseSneer
"""
_UNSIDED_NAMES = """
browInnerUp cheekPuff jawForward jawOpen mouthClose mouthFunnel mouthPucker
mouthRollLower mouthRollUpper mouthShrugLower mouthShrugUpper tongueOut
"""

ARKIT_SHAPES: tuple[str, ...] = tuple(
    sorted(
        [
            *_UNSIDED_NAMES.split(),
            *(n + s for n in _SIDED_NAMES.split() for s in ("Left", "Right")),
        ]
    )
)


def _normalize_name(name: str) -> str:
    """Lowercase a name; strip its namespace, spaces, hyphens and underscores."""
    return re.sub(r"[\s_-]", "", re.split(r"[.:|/]", name)[-1]).lower()


_ARKIT_NAME_BY_NORMALIZED = {_normalize_name(name): name for name in ARKIT_SHAPES} | {
    _normalize_name(stem + side[0]): stem + side
    for stem in _SIDED_NAMES.split()
    for side in ("Left", "Right")
}


def arkit_name(name: str) -> str | None:
    """Return ARKit's spelling of a shape name; None if it is not an ARKit name.

    >>> arkit_name("blendShape1.eye_blink_L"), arkit_name("JawOpen"), arkit_name("grin")
    ('eyeBlinkLeft', 'jawOpen', None)
    """
    return _ARKIT_NAME_BY_NORMALIZED.get(_normalize_name(name))


def combination_order(shapes: Sequence[Shape]) -> list[Shape]:
    """Return shapes in dependency order.

    >>> smile, both = Shape("smile"), Shape("both", combine=("smile",))
    >>> [shape.name for shape in combination_order([both, smile])]
    ['smile', 'both']
    """
    shapes_by_name = {shape.name: shape for shape in shapes}
    dependencies_by_shape = {
        shape.name: [name for name in shape.combine if name in shapes_by_name]
        for shape in shapes
    }
    return [shapes_by_name[name] for name in dependency_order(dependencies_by_shape)]


def add_combinations(
    shapes: Sequence[Shape], uncombined_weights: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """Add products of combination shapes to weights [1], ``(F,)`` or ``(1,)``.

    >>> import numpy as np
    >>> shapes = [Shape("a"), Shape("b"), Shape("both", combine=("a", "b"))]
    >>> own = {"a": np.array([0.5, 1.0]), "b": np.array([0.5]), "both": np.zeros(1)}
    >>> add_combinations(shapes, own)["both"].tolist()
    [0.25, 0.5]
    """
    weights_by_shape = {shape.name: uncombined_weights[shape.name] for shape in shapes}
    for shape in combination_order(shapes):
        if shape.combine:
            weights_by_shape[shape.name] = weights_by_shape[shape.name] + _product(
                shape, weights_by_shape
            )
    return weights_by_shape


def subtract_combinations(
    shapes: Sequence[Shape], total_weights: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """Subtract the products of combination shapes: the inverse of `add_combinations`.

    >>> import numpy as np
    >>> shapes = [Shape("a"), Shape("both", combine=("a",))]
    >>> total = {"a": np.array([0.5]), "both": np.array([0.75])}
    >>> subtract_combinations(shapes, total)["both"]
    array([0.25])
    """
    return {
        shape.name: total_weights[shape.name] - _product(shape, total_weights)
        if shape.combine
        else total_weights[shape.name]
        for shape in shapes
    }


def _product(shape: Shape, weights_by_shape: Mapping[str, FloatArray]) -> FloatArray:
    """Return the product of the weights that a shape combines."""
    product, *other_weights = (weights_by_shape[name] for name in shape.combine)
    for weight in other_weights:
        product = product * weight
    return product
