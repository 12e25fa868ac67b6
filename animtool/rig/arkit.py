"""The names of the 52 face shapes that Apple's ARKit tracks, however they are spelled.

References:
    Apple, ARKit documentation, ``ARFaceAnchor.BlendShapeLocation``.
"""

from __future__ import annotations

import re

_SIDED = """
browDown browOuterUp cheekSquint eyeBlink eyeLookDown eyeLookIn eyeLookOut eyeLookUp
eyeSquint eyeWide jaw mouth mouthDimple mouthFrown mouthLowerDown mouthPress mouthSmile
mouthStretch mouthUpperUp noseSneer
"""
_WHOLE = """
browInnerUp cheekPuff jawForward jawOpen mouthClose mouthFunnel mouthPucker
mouthRollLower mouthRollUpper mouthShrugLower mouthShrugUpper tongueOut
"""

ARKIT_SHAPES: tuple[str, ...] = tuple(
    sorted(
        [*_WHOLE.split(), *(n + s for n in _SIDED.split() for s in ("Left", "Right"))]
    )
)


def _spelled(name: str) -> str:
    """Return a name without case, underlines and what stands before it."""
    return re.sub(r"[\s_-]", "", re.split(r"[.:|/]", name)[-1]).lower()


_NAMES = {_spelled(name): name for name in ARKIT_SHAPES} | {
    _spelled(stem + side[0]): stem + side
    for stem in _SIDED.split()
    for side in ("Left", "Right")
}


def arkit_name(name: str) -> str | None:
    """Return ARKit's own spelling of a shape's name; None where it is none of these.

    >>> arkit_name("blendShape1.eye_blink_L"), arkit_name("JawOpen"), arkit_name("grin")
    ('eyeBlinkLeft', 'jawOpen', None)
    """
    return _NAMES.get(_spelled(name))
