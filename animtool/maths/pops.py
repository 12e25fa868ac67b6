"""Detects pops: steps between frames that the motion around does not predict."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray

# Smaller deviations from the motion around are not pops [rad].
MIN_ROTATION = math.radians(17.0)
# No real motion rotates a joint this far in one frame [rad].
FLIP = math.radians(120.0)
# Roughness of a pop relative to the motion around: kicks, claps and landings at 24 to
# 120 fps reach 6, and 20 degrees in a smooth walk 9 and more [1]. The roughness of the
# motion is at least the noise of captures [rad].
STANDS_OUT = 8.0
ROTATION_NOISE = math.radians(1.0)
# Roughness of a pop relative to adjacent steps [1]; fast motion starts and stops over
# several frames.
ABOVE_NEIGHBOURS = 5.5
# Deviation of a translation pop relative to the change of speed: a bouncing ball
# reverses its speed in one step, which is no pop [1].
ABOVE_CHANGE = 2.5
# Part of the smallest pop that a smooth interpolation must leave unexplained [1].
LEFT = 0.6
# A step belongs to fast motion if the adjacent one has this fraction of its length [1].
ALONG = 0.4
# Window of the motion around: seconds before and after, and least number of steps.
REACH_SECONDS, MIN_STEPS = 0.12, 12
# Steps next to a pop that are excluded from the motion around.
GAP = 2
# Fewer frames do not show what is typical.
MIN_FRAMES = 8


def rotation_pops(
    rotations: FloatArray, interval: float, cuts: BoolArray
) -> tuple[BoolArray, FloatArray]:
    """Return a mask of rotation pops ``(S, N)``, and the deviations [rad].

    Args:
        rotations: Rotation vectors from each frame to the next ``(S, N, 3)`` [rad].
        interval: Time of a step [s].
        cuts: Mask of cuts, which are ignored ``(S,)``.

    Fewer than 8 frames have no pops.
    """
    if len(rotations) + 1 < MIN_FRAMES or not rotations.shape[1]:
        empty = np.zeros(rotations.shape[:2])
        return empty.astype(bool), empty
    amounts = surprises(rotations, cuts)
    flags = stands_out(rotations, amounts, cuts, MIN_ROTATION, ROTATION_NOISE, interval)
    # If every other step is a flip, none exceeds the motion around it.
    flips = np.linalg.norm(rotations, axis=2) > FLIP
    flags |= flips & (amounts > MIN_ROTATION + 2.0 * np.median(amounts, axis=0))
    return flags, amounts


def translation_pops(
    shifts: FloatArray, interval: float, cuts: BoolArray, least: float, noise: float
) -> tuple[BoolArray, FloatArray]:
    """Return a mask of translation pops ``(S, N)``, and the deviations [m].

    As `rotation_pops`, for steps ``(S, N, 3)`` [m] in the parent's frame. ``least`` is
    the smallest pop and ``noise`` the noise of the motion [m].
    """
    if len(shifts) + 1 < MIN_FRAMES or not shifts.shape[1]:
        empty = np.zeros(shifts.shape[:2])
        return empty.astype(bool), empty
    amounts = surprises(shifts, cuts)
    flags = stands_out(shifts, amounts, cuts, least, noise, interval)
    return flags & (amounts > ABOVE_CHANGE * changes(shifts)), amounts


def stands_out(
    steps: FloatArray,
    amounts: FloatArray,
    cuts: BoolArray,
    least: float,
    noise: float,
    interval: float,
) -> BoolArray:
    """Return a mask of deviations far above those around ``(S, N)``.

    ``steps`` ``(S, N, 3)`` and their deviations, ``amounts`` ``(S, N)``.
    """
    candidates = (amounts > least).any(axis=0)
    flags = np.zeros(amounts.shape, bool)
    if not candidates.any():
        return flags
    amounts = amounts[:, candidates]
    steps = _without(steps[:, candidates], cuts)
    # Overflowing steps stay unexplained.
    with np.errstate(over="ignore", invalid="ignore"):
        left, near_pops = _unexplained(steps, amounts)
        reach = max(MIN_STEPS, round(REACH_SECONDS / interval))
        typical = noise + mean_around(left, reach, GAP)
    flags[:, candidates] = (
        (amounts > least)
        & (left > LEFT * least)
        & (left > STANDS_OUT * typical)
        & (left > ABOVE_NEIGHBOURS * around(near_pops))
    )
    return flags


def surprises(steps: FloatArray, cuts: BoolArray) -> FloatArray:
    """Return the deviation of each step from the steps around it ``(S, N)``.

    The prediction is the mean of the middle two of the two steps before and the two
    after, by component, so that one bad step does not spoil its neighbours.

    ``steps`` ``(S, N, 3)``, ``cuts`` ``(S,)``.
    """
    if len(steps) < 3:
        return np.zeros(steps.shape[:2])
    steps = _without(steps, cuts)
    a, b, c, d = (_shifted(steps, offset) for offset in (-2, -1, 1, 2))
    most = np.maximum(np.maximum(a, b), np.maximum(c, d))
    least = np.minimum(np.minimum(a, b), np.minimum(c, d))
    return _lengths(steps - 0.5 * (a + b + c + d - most - least))


def _unexplained(
    steps: FloatArray, amounts: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return deviations that smooth fast motion does not explain ``(S, N)``, twice.

    Each step is predicted by cubics through four steps around it: the nearest ones, or
    without the one before or after, which a bad frame also disturbs; and by lines
    through the two steps before or after, if the nearer one is as fast, as a strike
    accelerates until it ends. The second array applies the lines to all steps: it is
    for steps next to a pop, which lines on their far sides do not contain.
    """
    a, b, c, d, e, f = (_shifted(steps, offset) for offset in (-3, -2, -1, 1, 2, 3))
    left = amounts
    for cubic in (
        (4.0 * (c + d) - b - e) / 6.0,
        c - 0.3 * b + 0.5 * e - 0.2 * f,
        d - 0.3 * e + 0.5 * b - 0.2 * a,
    ):
        left = np.fmin(left, _lengths(steps - cubic))
    by_lines = left
    squares = np.einsum("snc,snc->sn", steps, steps)
    for nearer, farther in ((c, b), (d, e)):
        off = _lengths(steps - (2.0 * nearer - farther))
        along = np.einsum("snc,snc->sn", nearer, nearer) > ALONG**2 * squares
        left = np.where(along, np.fmin(left, off), left)
        by_lines = np.fmin(by_lines, off)
    return left, by_lines


def _shifted(steps: FloatArray, offset: int) -> FloatArray:
    """Return the steps shifted by an offset, held at the ends ``(S, N, 3)``."""
    rows = np.arange(len(steps)) + offset
    return np.asarray(steps[rows.clip(0, len(steps) - 1)])


def _lengths(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.einsum("snc,snc->sn", vectors, vectors)))


def _without(steps: FloatArray, cuts: BoolArray) -> FloatArray:
    """Return steps with cuts replaced by the nearest other step."""
    if not cuts.any() or cuts.all():
        return steps
    kept = np.flatnonzero(~cuts)
    nearest = np.searchsorted(kept, np.arange(len(steps))).clip(0, len(kept) - 1)
    return np.asarray(steps[kept[nearest]])


def mean_around(values: FloatArray, reach: int, gap: int) -> FloatArray:
    """Return the mean of the rows within reach, without the nearest ``(S, N)``.

    ``values`` ``(S, N)``.
    """
    count = len(values)
    total = np.concatenate([np.zeros((1, *values.shape[1:])), values.cumsum(axis=0)])
    i = np.arange(count)
    low = np.clip(np.stack([i - reach, i + gap + 1]), 0, count)
    high = np.maximum(np.clip(np.stack([i - gap, i + reach + 1]), 0, count), low)
    sums = (total[high] - total[low]).sum(axis=0)
    return np.asarray(sums / np.maximum((high - low).sum(axis=0), 1)[:, None])


def around(values: FloatArray) -> FloatArray:
    """Return the larger of the values adjacent to a step that may stay or return.

    A joint that jumps and stays makes one bad step, one that returns in the next frame
    makes two: of the choices to skip such a neighbour, the smallest result counts.

    ``values`` ``(S, N)``.
    """
    rows = np.pad(values, ((2, 2), (0, 0)))
    before2, before, after, after2 = rows[:-4], rows[1:-3], rows[3:-1], rows[4:]
    stays = np.maximum(before, after)
    comes_back = np.maximum(before, after2)
    came_back = np.maximum(before2, after)
    return np.asarray(np.minimum(stays, np.minimum(comes_back, came_back)))


def changes(steps: FloatArray) -> FloatArray:
    """Return the change from the steps before to the steps after each ``(S, N)``.

    A bouncing ball continues in another direction, and a root that jumps continues as
    before. As in `around`, the best choice of skipped neighbours counts.

    ``steps`` ``(S, N, 3)``.
    """
    rows = np.pad(steps, ((2, 2), (0, 0), (0, 0)), mode="edge")
    before2, before, after, after2 = rows[:-4], rows[1:-3], rows[3:-1], rows[4:]
    pairs = ((before, after), (before, after2), (before2, after))
    return np.asarray(
        np.min([np.linalg.norm(late - early, axis=2) for early, late in pairs], axis=0)
    )
