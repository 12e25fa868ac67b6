"""Poses that are left out, where interpolation between others finds them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from animtool._types import BoolArray, Float32Array, FloatArray, IntArray

# How far a joint may be from where it should be where a pose is left out: a part of the
# extent of its rig, two and a half centimetres of a person. That is a foot in the air,
# for a frame, of someone far away.
NEAR = 0.018
# A foot that stands may be off by this part, a millimetre, hips by this, to keep it.
NEAR_STANDING, NEAR_HIPS = 0.0006, 0.004
# A joint that turns so little that nothing moves farther by it does not turn.
NEAR_STILL = 0.003
# How many frames may lie between two samples, and the spans that must fit before.
SPANS = {2: (1,), 3: (2,), 4: (3,), 6: (3, 3), 9: (4, 4), 16: (9, 6), 32: (16, 16)}


@dataclass(frozen=True)
class KeptSamples:
    """Which of F poses are kept, and what becomes of the others.

    Attributes:
        rows: Which ``(F,)``.
        put_right: How far all joints are moved so that feet stay ``(F, 3)`` [m].
        error: The most that a joint is off then [m].
        slide: The same of feet that stand [m].
    """

    rows: BoolArray
    put_right: FloatArray
    error: float
    slide: float


def kept_samples(
    turns: Float32Array,
    joints: Callable[[FloatArray], FloatArray],
    feet: tuple[tuple[int, int], BoolArray],
) -> KeptSamples:
    """Return which poses ``(F, M, 4)`` of a character must be written.

    Signs of quaternions are continuous. Between two of them USD turns each joint the
    short way, evenly. Of all that leave joints near, the fewest samples are chosen.

    Args:
        turns: Of joints.
        joints: From K poses to places of joints ``(K, J, 3)`` [m].
        feet: Two joints, and when each stands ``(F, 2)``.
    """
    exact = turns.astype(np.float64)
    true = joints(exact)
    size = float(np.ptp(true[0], axis=0).max())
    count = len(turns)
    found: dict[int, _Spans] = {}
    fits = {1: np.ones(count, bool)}
    for wide, parts in SPANS.items():
        begins = np.ones(max(count - wide, 0), bool)
        first = 0
        for part in parts:
            begins &= fits[part][first : first + len(begins)]
            first += part
        begins = np.flatnonzero(begins)
        inside = begins[:, None] + np.arange(1, wide)
        shares = np.arange(1, wide)[:, None] / wide
        made = slerped(exact[begins, None], exact[begins + wide, None], shares)
        off = true[inside] - joints(made.reshape(-1, *exact.shape[1:])).reshape(
            *inside.shape, *true.shape[1:]
        )
        back, error, slide = _put_right(off, feet[0], feet[1][inside])
        good = (error <= NEAR * size) & (slide <= NEAR_STANDING * size)
        good &= np.linalg.norm(back, axis=-1) <= NEAR_HIPS * size
        fits[wide] = np.zeros(count, bool)
        fits[wide][begins] = good.all(axis=1)
        found[wide] = _Spans(begins, back, error, slide)
    rows = _fewest(fits)
    moved = np.zeros((count, 3))
    worst = slid = 0.0
    keys = np.flatnonzero(rows)
    for begin, wide in zip(keys.tolist(), np.diff(keys).tolist(), strict=False):
        if wide > 1:
            spans = found[wide]
            at = int(np.searchsorted(spans.begins, begin))
            moved[begin + 1 : begin + wide] = spans.back[at]
            worst = max(worst, float(spans.error[at].max()))
            slid = max(slid, float(spans.slide[at].max()))
    return KeptSamples(rows, moved, worst, slid)


@dataclass(frozen=True)
class _Spans:
    """Spans of one length, and what is off in them."""

    begins: IntArray  # (B,)
    back: FloatArray  # (B, S - 1, 3)
    error: FloatArray  # (B, S - 1)
    slide: FloatArray  # (B, S - 1)


def _fewest(fits: dict[int, BoolArray]) -> BoolArray:
    """Return the fewest frames that lead from the first to the last by spans."""
    count = len(fits[1])
    steps, best = [1] * count, [0] * count
    known = {wide: good.tolist() for wide, good in fits.items()}
    for k in range(count - 2, -1, -1):
        fewest = count
        for wide, good in known.items():
            if good[k] and k + wide < count and best[k + wide] < fewest:
                fewest, steps[k] = best[k + wide], wide
        best[k] = fewest + 1
    rows = np.zeros(count, bool)
    k = 0
    while k < count:
        rows[k] = True
        k += steps[k]
    return rows


def _put_right(
    off: FloatArray, feet: tuple[int, int], stands: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return how far to move poses so that feet stay, and what is off then.

    ``off``: from where joints are to where they should be ``(…, J, 3)`` [m].
    """
    both = off[..., feet, :]
    count = np.maximum(stands.sum(axis=-1), 1)[..., None]
    back = (both * stands[..., None]).sum(axis=-2) / count
    left = off - back[..., None, :]
    far = np.sqrt(np.einsum("...k,...k->...", left, left))
    return back, far.max(axis=-1), (far[..., feet] * stands).max(axis=-1)


def slerped(a: FloatArray, b: FloatArray, share: FloatArray) -> FloatArray:
    """Return unit quaternions ``(…, 4)`` between two, whose product is not below 0."""
    cosine = np.clip(np.einsum("...k,...k->...", a, b), -1.0, 1.0)
    angle = np.arccos(cosine)
    sine = np.sin(angle)
    near = sine < 1e-6
    safe = np.where(near, 1.0, sine)
    first = np.where(near, 1 - share, np.sin((1 - share) * angle) / safe)
    last = np.where(near, share, np.sin(share * angle) / safe)
    return np.asarray(first[..., None] * a + last[..., None] * b)


def turning(turns: Float32Array, arms: FloatArray, size: float) -> BoolArray:
    """Return which joints turn ``(M,)``, of poses ``(F, M, 4)``.

    ``arms``: how far what is below each reaches ``(M,)`` [m]; ``size``: of the rig [m].
    """
    cosine = np.abs((turns * turns[:1]).sum(axis=-1)).min(axis=0)
    angles = 2 * np.arccos(np.clip(cosine, 0.0, 1.0))
    return np.asarray(angles * arms > NEAR_STILL * size)
