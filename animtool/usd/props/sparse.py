"""Drops poses that interpolation between the others reproduces."""

from __future__ import annotations

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray, Float32Array, FloatArray, IntArray
from animtool.core.record import dataclass

# How far a joint may be from where it should be where a pose is left out: a part of the
# extent of its rig, two and a half centimetres of a person. That is a foot in the air,
# for a frame, of someone far away.
NEAR = 0.018
# Tolerances of a planted foot (a millimetre), and of hips.
NEAR_STANDING, NEAR_HIPS = 0.0006, 0.004
# A joint is static if its rotation moves nothing farther than this.
STATIC_MOVE = 0.003
# How many frames may lie between two samples, and the spans that must fit before.
SPANS = {2: (1,), 3: (2,), 4: (3,), 6: (3, 3), 9: (4, 4), 16: (9, 6), 32: (16, 16)}


@dataclass(frozen=True)
class RotationChain:
    """Joints that define a pose, as input of `fitting_spans`.

    Attributes:
        parents: Which of them is above each, -1 for none ``(S,)``.
        numbers: Which rotation of a pose each has, -1 for its own at rest ``(S,)``.
        positions: In the frame of the one above ``(S, 3)`` [m].
        before: How that is turned there ``(S, 4)``.
        rest: Own rotations at rest ``(S, 4)``.
        feet: A joint of each foot ``(2,)``.
        size: How far the rig reaches [m].
    """

    parents: IntArray
    numbers: IntArray
    positions: FloatArray
    before: FloatArray
    rest: FloatArray
    feet: IntArray
    size: float

    def fitting(
        self, rotations: FloatArray, stands: BoolArray, begins: IntArray, wide: int
    ) -> tuple[BoolArray, FloatArray]:
        """Return which spans interpolate well, and the joint errors in them."""
        near = (part * self.size for part in (NEAR, NEAR_STANDING, NEAR_HIPS))
        return _kernels.fitting_spans(
            rotations, self.parents, self.numbers, self.positions, self.before,
            self.rest, self.feet, stands, begins, wide, *near,
        )  # fmt: skip


def kept_samples(
    rotations: Float32Array, chain: RotationChain, stands: BoolArray
) -> tuple[BoolArray, FloatArray]:
    """Return which poses ``(F, M, 4)`` of a character must be written ``(F,)``.

    With how far all joints are moved in each, so that feet stay ``(F, 3)`` [m]. Signs
    of quaternions are continuous. Between two samples USD turns each joint the short
    way, evenly. Of all that leave joints near, the fewest samples are chosen.

    Args:
        rotations: Of joints.
        chain: These joints.
        stands: When each foot is on the ground, or close to it ``(F, 2)``.
    """
    exact = rotations.astype(np.float64)
    count = len(rotations)
    moved = np.zeros((count, 3))
    kept: dict[int, tuple[IntArray, FloatArray]] = {}
    fits = {1: np.ones(count, np.bool_)}
    for wide, parts in SPANS.items():
        begun = np.ones(max(count - wide, 0), np.bool_)
        first = 0
        for part in parts:
            begun &= fits[part][first : first + len(begun)]
            first += part
        begins = np.flatnonzero(begun)
        fits[wide] = np.zeros(count, np.bool_)
        if len(begins):
            good, back = chain.fitting(exact, stands, begins, wide)
            fits[wide][begins] = good
            kept[wide] = begins, back
    rows = _fewest(fits)
    keys = np.flatnonzero(rows)
    for begin, wide in zip(keys.tolist(), np.diff(keys).tolist(), strict=False):
        if wide > 1:
            begins, back = kept[wide]
            at = int(np.searchsorted(begins, begin))
            moved[begin + 1 : begin + wide] = back[at]
    return rows, moved


def _fewest(fits: dict[int, BoolArray]) -> BoolArray:
    """Return the fewest frames that connect first and last by valid spans."""
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


def slerped(a: FloatArray, b: FloatArray, fraction: FloatArray) -> FloatArray:
    """Return the slerp of unit quaternions ``(…, 4)`` in one hemisphere."""
    cosine = np.clip(np.einsum("...k,...k->...", a, b), -1.0, 1.0)
    angle = np.arccos(cosine)
    sine = np.sin(angle)
    near = sine < 1e-6
    safe = np.where(near, 1.0, sine)
    first = np.where(near, 1 - fraction, np.sin((1 - fraction) * angle) / safe)
    last = np.where(near, fraction, np.sin(fraction * angle) / safe)
    return np.asarray(first[..., None] * a + last[..., None] * b)


def turning(rotations: Float32Array, arms: FloatArray, size: float) -> BoolArray:
    """Return which joints rotate ``(M,)`` in poses ``(F, M, 4)``.

    ``arms``: how far what is below each reaches ``(M,)`` [m]; ``size``: of the rig [m].
    """
    cosine = np.abs((rotations * rotations[:1]).sum(axis=-1)).min(axis=0)
    angles = 2 * np.arccos(np.clip(cosine, 0.0, 1.0))
    return np.asarray(angles * arms > STATIC_MOVE * size)
