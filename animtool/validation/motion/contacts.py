"""Detects ground contacts: foot joints, stance frames, and ground height."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.validation.motion.body import body, feet_of
from animtool.validation.motion.subject import MotionSubject

Scalar = TypeVar("Scalar", np.float64, np.bool_)

# A foot is planted this close to its lowest resting height, of the size [1].
NEAR = 0.025
# A planted foot moves less than this distance over this time [s], [size].
STATIC_SECONDS, STATIC_MOVE = 0.1, 0.012
# Fewer static frames, or a smaller fraction of all frames, show no ground: feet pause
# in the air, too [1].
MIN_CONTACTS, SELDOM = 4, 0.1
# A foot that is seldom static slides throughout: it is planted at the height that it
# is near for this fraction of the frames [1].
MOSTLY_LOW = 0.25
# A foot carries the body if no other joint is lower by more, of the size [1].
LOWEST = 0.05
# A body also crawls, kneels or lies, and drags its feet, if a hand, a knee or the trunk
# is this close to the ground: joints that rest this far above the feet [size].
LIES, ABOVE_FEET = 0.12, 0.15
# The same before and after: feet take or release the weight while a body goes down or
# gets up [s]. The ground is the lowest foot height in this time: in the air a knee may
# be as low as the feet.
GOES_DOWN, STRIDE = 0.15, 0.3
# Fraction of a foot's contacts at one height if its ground is flat; and at two heights,
# each, if part of the take floats or is on a step [1].
AT_ONE_HEIGHT, AT_TWO_HEIGHTS, AT_EACH = 0.5, 0.85, 0.2


@dataclass(frozen=True, slots=True)
class FootStances:
    """Foot contacts of a take.

    Attributes:
        feet: Indices of the joints ``(E,)``.
        partners: The opposite foot, or itself ``(E,)``.
        ground: Contact height of each foot ``(E,)`` [m].
        level: Whether most of its contacts are at that height ``(E,)``.
        flat: Whether a foot and its opposite have one contact height ``(E,)``.
        floor: The lower of two common contact heights; else the ground; infinite for
            more than two ``(E,)`` [m].
        carries: Whether no other joint is much lower ``(F, E)``.
        near: Whether a foot carries the body near flat ground ``(F, E)``.
        static: Whether it carries the body without moving ``(F, E)``.
    """

    feet: IntArray
    partners: IntArray
    ground: FloatArray
    level: BoolArray
    flat: BoolArray
    floor: FloatArray
    carries: BoolArray
    near: BoolArray
    static: BoolArray


def contacts_of(subject: MotionSubject) -> FootStances | None:
    """Return the foot contacts; None if there are no feet or stance frames."""
    feet = feet_of(subject.take.rig.names)
    if not len(feet) or subject.frames < MIN_CONTACTS:
        return None
    heights = subject.heights[:, feet]
    lowest = subject.heights[:, body(subject)].min(axis=1, keepdims=True)
    carries = heights < lowest + LOWEST * subject.size
    carries &= ~_lies(subject, feet)[:, None]
    static = carries & _static(subject, subject.positions[:, feet])
    ground = np.zeros(len(feet))
    floor = np.full(len(feet), np.inf)
    flat = np.zeros(len(feet), bool)
    for e in range(len(feet)):
        stands = heights[static[:, e], e]
        if len(stands) >= max(MIN_CONTACTS, SELDOM * subject.frames):
            ground[e], fraction = _level(stands, NEAR * subject.size)
            flat[e] = fraction > AT_ONE_HEIGHT
            floor[e] = _floor(stands, NEAR * subject.size)
        else:
            ground[e] = np.percentile(heights[:, e], 5)
            low = np.abs(heights[:, e] - ground[e]) < NEAR * subject.size
            flat[e] = low.mean() > MOSTLY_LOW
            floor[e] = ground[e] if flat[e] else np.inf
    partners = _partners(subject, feet)
    level, within = flat, NEAR * subject.size
    flat = level & _agrees(ground, partners, within)
    floor[~_agrees(floor, partners, within)] = np.inf
    near = carries & flat & (np.abs(heights - ground) < within)
    return FootStances(
        feet, partners, ground, level, flat, floor, carries, near, static
    )


def _level(heights: FloatArray, within: float) -> tuple[float, float]:
    """Return the most common height, and the fraction of values near it.

    >>> _level(np.array([0.0, 0.1, 0.2, 5.0]), 0.5)
    (0.1, 0.75)
    """
    ordered = np.sort(heights)
    ends = np.searchsorted(ordered, ordered + 2.0 * within, "right")
    many = ends - np.arange(len(ordered))
    first = int(many.argmax())
    chosen = ordered[first : first + int(many[first])]
    return float(np.median(chosen)), len(chosen) / len(ordered)


def _floor(heights: FloatArray, within: float) -> float:
    """Return the lower of two heights that nearly all values are near; else infinity.

    >>> _floor(np.array([0.0, 0.1, 5.0, 5.1, 5.2]), 0.5)
    0.05
    """
    one, fraction = _level(heights, within)
    rest = heights[np.abs(heights - one) > 2.0 * within]
    if len(rest) < AT_EACH * len(heights):
        return one if fraction > AT_ONE_HEIGHT else np.inf
    other, part = _level(rest, within)
    part *= len(rest) / len(heights)
    if part < AT_EACH:
        return one if fraction > AT_ONE_HEIGHT else np.inf
    return min(one, other) if fraction + part > AT_TWO_HEIGHTS else np.inf


def _lies(subject: MotionSubject, feet: IntArray) -> BoolArray:
    """Return frames in which joints other than feet are near the ground ``(F,)``."""
    parents = subject.take.rig.parents
    others = body(subject)
    leg = set(feet.tolist())
    for joint in range(len(parents)):
        if parents[joint] in leg:
            leg.add(joint)
    others[list(leg)] = False
    if subject.has_rest:
        rests = subject.rest @ subject.up
        others &= rests > rests[feet].min() + ABOVE_FEET * subject.rest_size
    if not others.any():
        return np.zeros(subject.frames, bool)
    lowest = subject.heights[:, feet].min(axis=1)
    trunk = subject.heights[:, others].min(axis=1)
    ground = _windows(lowest, STRIDE / subject.interval).min(axis=1)
    lies = trunk < ground + LIES * subject.size
    return np.asarray(_windows(lies, GOES_DOWN / subject.interval).any(axis=1))


def _windows(values: NDArray[Scalar], reach: float) -> NDArray[Scalar]:
    """Return sliding windows over frames, padded at the ends ``(F, W)``."""
    frames = round(reach)
    padded = np.pad(values, frames, mode="edge")
    return sliding_window_view(padded, 2 * frames + 1)


def _partners(subject: MotionSubject, feet: IntArray) -> IntArray:
    """Return the opposite foot of each foot, or itself ``(E,)``."""
    columns = {int(joint): e for e, joint in enumerate(feet)}
    partners = subject.sides.partners[feet].tolist()
    return np.array([columns.get(joint, e) for e, joint in enumerate(partners)])


def _agrees(ground: FloatArray, partners: IntArray, within: float) -> BoolArray:
    """Return whether each foot stands as high as its opposite ``(E,)``."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(ground - ground[partners]) < within)


def moves_over(
    subject: MotionSubject, points: FloatArray, span: float
) -> tuple[FloatArray, IntArray]:
    """Return displacements of points ``(F, E, 3)`` around each frame, and their spans.

    span: about how long [s]. Moves ``(F, E, 3)`` [m] and frames ``(F,)``.
    """
    count, reach = len(points), max(1, round(0.5 * span / subject.interval))
    before = np.clip(np.arange(count) - reach, 0, count - 1)
    behind = np.clip(np.arange(count) + reach, 0, count - 1)
    return points[behind] - points[before], behind - before


def _static(subject: MotionSubject, points: FloatArray) -> BoolArray:
    """Return where points ``(F, E, 3)`` are nearly static ``(F, E)``."""
    moves, frames = moves_over(subject, points, STATIC_SECONDS)
    # At low rates a frame is longer than the time to look at.
    allowed = STATIC_MOVE * frames * subject.interval / STATIC_SECONDS
    lengths = np.linalg.norm(moves, axis=2)
    return np.asarray(lengths < allowed[:, None] * subject.size)
