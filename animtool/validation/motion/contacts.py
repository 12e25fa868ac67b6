"""Feet: which joints they are, when they carry the body, and where the ground is."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from animtool._types import BoolArray, FloatArray, IntArray
from animtool.validation.motion.subject import MotionSubject

# Words for feet, whole or as part of a name put together: not flyWHEEL.
_WORDS = "foot|feet|toe|ankle|heel|paw|hoof"
_FOOT = re.compile(
    rf"(?<![A-Za-z])(?:{_WORDS})|{'|'.join(w.capitalize() for w in _WORDS.split('|'))}"
    rf"|(?<![A-Za-z])(?:{_WORDS.upper()})"
)
# A foot stands that is this near to the lowest height it rests at, of the size [1].
NEAR = 0.025
# Over this long a foot that stands hardly moves [s], [size].
STILL_SECONDS, STILL = 0.1, 0.012
# Fewer frames in which feet are still show no ground.
MIN_CONTACTS = 4
# Where it is never still, it slides all along: it stands at the height that it is
# nearest to for this share of the frames [1].
MOSTLY_LOW = 0.25
# A foot carries the body where no other joint is lower by more, of the size [1].
LOWEST = 0.05


@dataclass(frozen=True, slots=True)
class Contacts:
    """The feet of a take, over its frames.

    Attributes:
        feet: Indices of the joints ``(E,)``.
        ground: Height at which each foot stands, from its contacts ``(E,)`` [m].
        flat: Whether a foot and that of the other side stand at one height ``(E,)``.
        carries: Whether no other joint is much lower ``(F, E)``.
        near: Whether a foot carries, and is near to a ground that is flat ``(F, E)``.
        still: Whether it carries and does not move ``(F, E)``.
    """

    feet: IntArray
    ground: FloatArray
    flat: BoolArray
    carries: BoolArray
    near: BoolArray
    still: BoolArray


def feet_of(names: tuple[str, ...] | list[str]) -> IntArray:
    """Return the indices of the joints that are of feet.

    >>> feet_of(["hips", "LeftFoot", "toe_l", "flywheel", "l_ankle"]).tolist()
    [1, 2, 4]
    """
    feet = [i for i, name in enumerate(names) if _FOOT.search(name)]
    return np.array(feet, np.int64)


def contacts_of(subject: MotionSubject) -> Contacts | None:
    """Return when feet stand; None where there are none, or they never do."""
    feet = feet_of(subject.take.rig.names)
    if not len(feet) or subject.frames < MIN_CONTACTS:
        return None
    heights = subject.heights[:, feet]
    lowest = subject.heights.min(axis=1, keepdims=True)
    carries = heights < lowest + LOWEST * subject.size
    still = carries & _still(subject, subject.positions[:, feet])
    ground = np.zeros(len(feet))
    flat = np.zeros(len(feet), bool)
    for e in range(len(feet)):
        stands = heights[still[:, e], e]
        if len(stands) >= MIN_CONTACTS:
            ground[e] = np.median(stands)
            spread = np.percentile(stands, 75) - np.percentile(stands, 25)
            flat[e] = spread < NEAR * subject.size
        else:
            ground[e] = np.percentile(heights[:, e], 5)
            low = np.abs(heights[:, e] - ground[e]) < NEAR * subject.size
            flat[e] = low.mean() > MOSTLY_LOW
    flat &= _agrees(subject, feet, ground)
    near = carries & flat & (np.abs(heights - ground) < NEAR * subject.size)
    return Contacts(feet, ground, flat, carries, near, still)


def _agrees(subject: MotionSubject, feet: IntArray, ground: FloatArray) -> BoolArray:
    """Return whether each foot stands as high as that of the other side ``(E,)``."""
    places = {int(joint): e for e, joint in enumerate(feet)}
    partners = subject.sides.partners[feet].tolist()
    others = [places.get(joint, e) for e, joint in enumerate(partners)]
    return np.asarray(np.abs(ground - ground[others]) < NEAR * subject.size)


def moves_over(
    subject: MotionSubject, points: FloatArray, span: float
) -> tuple[FloatArray, IntArray]:
    """Return how far points ``(F, E, 3)`` go about each frame, and in how many frames.

    span: about how long [s]. Distances ``(F, E)`` [m] and frames ``(F,)``.
    """
    count, reach = len(points), max(1, round(0.5 * span / subject.interval))
    before = np.clip(np.arange(count) - reach, 0, count - 1)
    behind = np.clip(np.arange(count) + reach, 0, count - 1)
    moves = np.linalg.norm(points[behind] - points[before], axis=2)
    return moves, behind - before


def _still(subject: MotionSubject, points: FloatArray) -> BoolArray:
    """Return where points ``(F, E, 3)`` hardly move around a frame ``(F, E)``."""
    moves, frames = moves_over(subject, points, STILL_SECONDS)
    # At low rates a frame is longer than the time to look at.
    allowed = STILL * frames * subject.interval / STILL_SECONDS
    return np.asarray(moves < allowed[:, None] * subject.size)
