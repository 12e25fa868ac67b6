"""Steps from one frame to the next that the motion around them does not predict."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray

# A smaller difference to the motion around is seen as a part of it [rad].
MIN_TURN = math.radians(17.0)
# No motion at the rates in use turns a joint so far in one frame [rad].
FLIP = math.radians(120.0)
# A pop is as many times rougher than the motion around: kicks, claps and landings at
# 24 to 120 fps come to 6, and 20 degrees in a smooth walk to 9 and more [1]. Motion is
# never taken for smoother than this, which is the noise of captures [rad].
STANDS_OUT = 8.0
TURN_NOISE = math.radians(1.0)
# Of the steps beside it [1]; fast motion begins and ends over several frames.
ABOVE_NEIGHBOURS = 5.5
# A move is as many times what the speed changes by: a ball that bounces turns its speed
# round in one step, and that is the jump [1].
ABOVE_CHANGE = 2.5
# Smooth motion explains some of a surprise that is a pop, but leaves this part of the
# least one [1].
LEFT = 0.6
# A step is a part of fast motion where the next one is this part of it [1].
ALONG = 0.4
# Motion around: this long before and after, but some steps at least [s], [1].
REACH_SECONDS, MIN_STEPS = 0.12, 12
# Steps beside a pop that it disturbs itself [1].
GAP = 2
# Fewer frames do not show what is usual in them.
MIN_FRAMES = 8


def turn_pops(
    turns: FloatArray, interval: float, cuts: BoolArray
) -> tuple[BoolArray, FloatArray]:
    """Return the steps at which joints pop ``(S, N)``, and their surprise [rad].

    Args:
        turns: Rotation vectors from each frame to the next ``(S, N, 3)`` [rad].
        interval: Time of a step [s].
        cuts: Steps that are no motion ``(S,)``.

    Fewer than 8 frames have no pops.
    """
    if len(turns) + 1 < MIN_FRAMES or not turns.shape[1]:
        empty = np.zeros(turns.shape[:2])
        return empty.astype(bool), empty
    amounts = surprises(turns, cuts)
    flags = stands_out(turns, amounts, cuts, MIN_TURN, TURN_NOISE, interval)
    # Where every other step is one, none is above what is around it.
    flips = np.linalg.norm(turns, axis=2) > FLIP
    flags |= flips & (amounts > MIN_TURN + 2.0 * np.median(amounts, axis=0))
    return flags, amounts


def shift_pops(
    shifts: FloatArray, interval: float, cuts: BoolArray, least: float, noise: float
) -> tuple[BoolArray, FloatArray]:
    """Return the steps at which joints pop ``(S, N)``, and their surprise [m].

    As `turn_pops`, of moves ``(S, N, 3)`` [m] against the parent. ``least`` is the
    smallest surprise that counts and ``noise`` what is no motion [m].
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
    """Return where surprises are far above those around ``(S, N)``.

    ``steps`` ``(S, N, 3)`` and their surprises, ``amounts`` ``(S, N)``.
    """
    candidates = (amounts > least).any(axis=0)
    flags = np.zeros(amounts.shape, bool)
    if not candidates.any():
        return flags
    amounts = amounts[:, candidates]
    steps = _without(steps[:, candidates], cuts)
    # Of steps beyond numbers nothing is explained.
    with np.errstate(over="ignore", invalid="ignore"):
        left, apart = _unexplained(steps, amounts)
        reach = max(MIN_STEPS, round(REACH_SECONDS / interval))
        usual = noise + mean_around(left, reach, GAP)
    flags[:, candidates] = (
        (amounts > least)
        & (left > LEFT * least)
        & (left > STANDS_OUT * usual)
        & (left > ABOVE_NEIGHBOURS * around(apart))
    )
    return flags


def surprises(steps: FloatArray, cuts: BoolArray) -> FloatArray:
    """Return how far each step is from those around it ``(S, N)``.

    The prediction is the mean of the middle two of the two steps before and the two
    after, by component, so that one bad step does not spoil that of its neighbours.

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
    """Return what fast motion that is smooth leaves of surprises ``(S, N)``, twice.

    Cubics go through four steps about each: those next to it, or without the one before
    or after, which a frame that is off disturbs as well; and straight lines through the
    two steps before or after, where the nearer one is as fast, as a strike that ends
    gets faster until then. What these lines leave of all steps is the second one: it is
    of the steps beside a pop, which the lines on their other sides do not know of.
    """
    a, b, c, d, e, f = (_shifted(steps, offset) for offset in (-3, -2, -1, 1, 2, 3))
    left = amounts
    for cubic in (
        (4.0 * (c + d) - b - e) / 6.0,
        c - 0.3 * b + 0.5 * e - 0.2 * f,
        d - 0.3 * e + 0.5 * b - 0.2 * a,
    ):
        left = np.fmin(left, _lengths(steps - cubic))
    apart = left
    own = np.einsum("snc,snc->sn", steps, steps)
    for nearer, farther in ((c, b), (d, e)):
        off = _lengths(steps - (2.0 * nearer - farther))
        along = np.einsum("snc,snc->sn", nearer, nearer) > ALONG**2 * own
        left = np.where(along, np.fmin(left, off), left)
        apart = np.fmin(apart, off)
    return left, apart


def _shifted(steps: FloatArray, offset: int) -> FloatArray:
    """Return the step that is so many after each, held at the ends ``(S, N, 3)``."""
    rows = np.arange(len(steps)) + offset
    return np.asarray(steps[rows.clip(0, len(steps) - 1)])


def _lengths(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.einsum("snc,snc->sn", vectors, vectors)))


def _without(steps: FloatArray, cuts: BoolArray) -> FloatArray:
    """Return steps in which cuts do what the nearest other step does."""
    if not cuts.any() or cuts.all():
        return steps
    kept = np.flatnonzero(~cuts)
    place = np.searchsorted(kept, np.arange(len(steps))).clip(0, len(kept) - 1)
    return np.asarray(steps[kept[place]])


def mean_around(values: FloatArray, reach: int, gap: int) -> FloatArray:
    """Return the mean of the rows within reach, the nearest left out ``(S, N)``.

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
    """Return the larger of the values beside a step that may stay or come back.

    A joint that jumps and stays makes one bad step, one that is back in the next
    frame makes two: of the ways to leave such a neighbour out, the one that leaves
    the least counts.

    ``values`` ``(S, N)``.
    """
    rows = np.pad(values, ((2, 2), (0, 0)))
    before2, before, after, after2 = rows[:-4], rows[1:-3], rows[3:-1], rows[4:]
    stays = np.maximum(before, after)
    comes_back = np.maximum(before, after2)
    came_back = np.maximum(before2, after)
    return np.asarray(np.minimum(stays, np.minimum(comes_back, came_back)))


def changes(steps: FloatArray) -> FloatArray:
    """Return how far the steps after each differ from those before ``(S, N)``.

    A ball that bounces goes on another way, and a root that jumps goes on as before.
    As in `around`, of the ways to leave out a neighbour the best one counts.

    ``steps`` ``(S, N, 3)``.
    """
    rows = np.pad(steps, ((2, 2), (0, 0), (0, 0)), mode="edge")
    before2, before, after, after2 = rows[:-4], rows[1:-3], rows[3:-1], rows[4:]
    pairs = ((before, after), (before, after2), (before2, after))
    return np.asarray(
        np.min([np.linalg.norm(late - early, axis=2) for early, late in pairs], axis=0)
    )
