"""Drops poses that interpolation between the others reproduces."""

from __future__ import annotations

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray, Float32Array, FloatArray, IntArray
from animtool.core.record import dataclass

# Largest joint error of a dropped pose, relative to the extent of the rig: two and a
# half centimetres for a person, for a foot in the air seen from far away.
JOINT_TOLERANCE = 0.018
# The same for planted feet (a millimetre), and for hips.
FOOT_TOLERANCE, HIP_TOLERANCE = 0.0006, 0.004
# A joint is static if its rotation moves its descendants by less than this, relative to
# the rig.
STATIC_DISTANCE = 0.003
# Distances of samples in frames, with the shorter spans that must fit before each is
# tried.
SPAN_SPLITS = {
    2: (1,),
    3: (2,),
    4: (3,),
    6: (3, 3),
    9: (4, 4),
    16: (9, 6),
    32: (16, 16),
}


@dataclass(frozen=True)
class RotationChain:
    """Joints that define a pose, as input of `fitting_spans`.

    Attributes:
        parents: Index of each joint's parent among them, -1 for none ``(S,)``.
        numbers: Index of each joint's rotation in a pose, -1 for its rest ``(S,)``.
        positions: Position in the frame of the parent ``(S, 3)`` [m].
        before: Fixed rotation from the parent ``(S, 4)``.
        rest: Rest rotation of each joint ``(S, 4)``.
        feet: A joint of each foot ``(2,)``.
        size: Reach of the rig [m].
    """

    parents: IntArray
    numbers: IntArray
    positions: FloatArray
    before: FloatArray
    rest: FloatArray
    feet: IntArray
    size: float

    def fitting(
        self,
        rotations: FloatArray,
        is_planted: BoolArray,
        begins: IntArray,
        span: int,
    ) -> tuple[BoolArray, FloatArray]:
        """Return which spans interpolate well, and the joint errors in them."""
        tolerances = (
            fraction * self.size
            for fraction in (JOINT_TOLERANCE, FOOT_TOLERANCE, HIP_TOLERANCE)
        )
        return _kernels.fitting_spans(
            rotations, self.parents, self.numbers, self.positions, self.before,
            self.rest, self.feet, is_planted, begins, span, *tolerances,
        )  # fmt: skip


def kept_samples(
    rotations: Float32Array, chain: RotationChain, is_planted: BoolArray
) -> tuple[BoolArray, FloatArray]:
    """Return which poses ``(F, M, 4)`` of a character must be written ``(F,)``.

    Also returns the offset of all joints in each pose that keeps the feet in place
    ``(F, 3)`` [m]. Signs of quaternions are continuous, and USD slerps each joint
    between two samples. The result has the fewest samples within the tolerances.

    Args:
        rotations: Rotations of the joints.
        chain: The joints.
        is_planted: When each foot is on the ground, or close to it ``(F, 2)``.
    """
    exact = rotations.astype(np.float64)
    count = len(rotations)
    offsets = np.zeros((count, 3))
    checked_spans: dict[int, tuple[IntArray, FloatArray]] = {}
    valid_spans = {1: np.ones(count, np.bool_)}
    for span, parts in SPAN_SPLITS.items():
        can_begin = np.ones(max(count - span, 0), np.bool_)
        start = 0
        for length in parts:
            can_begin &= valid_spans[length][start : start + len(can_begin)]
            start += length
        begins = np.flatnonzero(can_begin)
        valid_spans[span] = np.zeros(count, np.bool_)
        if len(begins):
            fits_, corrections = chain.fitting(exact, is_planted, begins, span)
            valid_spans[span][begins] = fits_
            checked_spans[span] = begins, corrections
    rows = _fewest_frames(valid_spans)
    keys = np.flatnonzero(rows)
    for begin, span in zip(keys.tolist(), np.diff(keys).tolist(), strict=False):
        if span > 1:
            begins, corrections = checked_spans[span]
            at = int(np.searchsorted(begins, begin))
            offsets[begin + 1 : begin + span] = corrections[at]
    return rows, offsets


def _fewest_frames(spans_: dict[int, BoolArray]) -> BoolArray:
    """Return the fewest frames that connect first and last by valid spans."""
    count = len(spans_[1])
    steps, best = [1] * count, [0] * count
    valid_spans = {span: is_valid.tolist() for span, is_valid in spans_.items()}
    for k in range(count - 2, -1, -1):
        fewest_samples = count
        for span, is_valid in valid_spans.items():
            if is_valid[k] and k + span < count and best[k + span] < fewest_samples:
                fewest_samples, steps[k] = best[k + span], span
        best[k] = fewest_samples + 1
    rows = np.zeros(count, bool)
    k = 0
    while k < count:
        rows[k] = True
        k += steps[k]
    return rows


def slerp(a: FloatArray, b: FloatArray, fraction: FloatArray) -> FloatArray:
    """Return the slerp of unit quaternions ``(…, 4)`` in one hemisphere."""
    cosine = np.clip(np.einsum("...k,...k->...", a, b), -1.0, 1.0)
    angle = np.arccos(cosine)
    sine = np.sin(angle)
    is_small = sine < 1e-6
    safe_sine = np.where(is_small, 1.0, sine)
    first_weight = np.where(
        is_small, 1 - fraction, np.sin((1 - fraction) * angle) / safe_sine
    )
    last_weight = np.where(is_small, fraction, np.sin(fraction * angle) / safe_sine)
    return np.asarray(first_weight[..., None] * a + last_weight[..., None] * b)


def rotating_joints(
    rotations: Float32Array, arms: FloatArray, size: float
) -> BoolArray:
    """Return which joints rotate ``(M,)`` in poses ``(F, M, 4)``.

    ``arms`` are the reaches of each joint's descendants ``(M,)`` [m], ``size`` that of
    the rig [m].
    """
    cosine = np.abs((rotations * rotations[:1]).sum(axis=-1)).min(axis=0)
    angles = 2 * np.arccos(np.clip(cosine, 0.0, 1.0))
    return np.asarray(angles * arms > STATIC_DISTANCE * size)
