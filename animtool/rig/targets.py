"""Names of what a channel or a control moves: ``joint/elbow_l.angle``."""

from __future__ import annotations

from collections.abc import Iterable

from animtool.rig.skeleton import JointType
from animtool.similar import LONGEST, similar

_TURNS = (JointType.FREE, JointType.BALL)
_EVERY = tuple(JointType)

# Parts that a control may add to, and the joints that have them.
DRIVEN_PARTS: dict[str, tuple[JointType, ...]] = {
    "angle": (JointType.PIN,),
    "slide": (JointType.PRISMATIC,),
    **{f"rotation.{axis}": _TURNS for axis in "xyz"},
    **{f"translation.{axis}": (JointType.FREE,) for axis in "xyz"},
}
# Parts that a channel of a clip may hold.
KEYED_PARTS: dict[str, tuple[JointType, ...]] = {
    "angle": (JointType.PIN,),
    "slide": (JointType.PRISMATIC,),
    "rotation": _TURNS,
    "translation": (JointType.FREE,),
    "local_translation": _EVERY,
    "local_rotation": _EVERY,
    "scale": _EVERY,
}


def nearest_part(text: str, parts: Iterable[str]) -> str | None:
    """Return a hint that names the part that a joint's misspelt part is nearest to.

    >>> nearest_part("elbow_l.angel", KEYED_PARTS)
    "did you mean '.angle'?"
    """
    words = text[-LONGEST:].split(".")
    tails = [".".join(words[i:]) for i in range(1, len(words))]
    names = list(parts)
    near = next(filter(None, (similar(tail, names) for tail in tails)), None)
    return f"did you mean '.{near}'?" if near else None


def split_part(text: str, parts: Iterable[str]) -> tuple[str, str]:
    """Return a joint's name and its part, the part empty where there is none.

    >>> split_part("arm.l.rotation.x", DRIVEN_PARTS)
    ('arm.l', 'rotation.x')
    """
    for part in sorted(parts, key=len, reverse=True):
        if text.endswith(f".{part}"):
            return text[: -len(part) - 1], part
    return text, ""
