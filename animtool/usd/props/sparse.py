"""Removes poses that interpolation reproduces from animations."""

from __future__ import annotations

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray, Float32Array, FloatArray, IntArray
from animtool.core.record import dataclass

# Largest joint error of a removed pose, relative to the extent of the rig: 2.5 cm for a
# person.
JOINT_TOLERANCE = 0.018
# The same for planted feet (1 mm for a person), and for hips.
FOOT_TOLERANCE, HIP_TOLERANCE = 0.0006, 0.004
# A joint is static if its rotation moves its descendants by less than this, relative to
# the extent of the rig.
STATIC_DISTANCE = 0.003
# Lengths of spans between samples [frames], and the shorter consecutive spans that must
# be valid before each is tested.
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
class PoseSkeleton:
    """Skeleton of the joints that define a pose, without static joints between them.

    Attributes:
        parents: Index of each joint's parent among them, -1 for none ``(S,)``.
        rotation_indices: Index of each rotation in a pose, -1 for rest ``(S,)``.
        positions: Position in the frame of the parent ``(S, 3)`` [m].
        parent_rotations: Fixed rotation from the parent ``(S, 4)``.
        rest_rotations: Rest rotation of each joint ``(S, 4)``.
        feet: A joint of each foot ``(2,)``.
        rig_extent: Largest extent of the rig at rest [m].
    """

    parents: IntArray
    rotation_indices: IntArray
    positions: FloatArray
    parent_rotations: FloatArray
    rest_rotations: FloatArray
    feet: IntArray
    rig_extent: float

    def find_valid_spans(
        self,
        rotations: FloatArray,
        is_planted: BoolArray,
        start_frames: IntArray,
        span_length: int,
    ) -> tuple[BoolArray, FloatArray]:
        """Return which spans slerp fits within tolerance, and their joint offsets."""
        tolerances = (
            fraction * self.rig_extent
            for fraction in (JOINT_TOLERANCE, FOOT_TOLERANCE, HIP_TOLERANCE)
        )
        return _kernels.fitting_spans(
            rotations, self.parents, self.rotation_indices, self.positions,
            self.parent_rotations, self.rest_rotations, self.feet, is_planted,
            start_frames, span_length, *tolerances,
        )  # fmt: skip


def select_samples(
    rotations: Float32Array, pose_skeleton: PoseSkeleton, is_planted: BoolArray
) -> tuple[BoolArray, FloatArray]:
    """Return which poses ``(F, M, 4)`` of a character to write ``(F,)``.

    The result has the fewest samples within the tolerances, with slerp between samples.
    Also returns the offset of all joints in each pose that keeps the feet in place
    ``(F, 3)`` [m]. Signs of quaternions must be continuous.

    Args:
        rotations: Rotations of the joints.
        pose_skeleton: The joints, with their rest pose.
        is_planted: Whether each foot is on or near the ground ``(F, 2)``.
    """
    exact_rotations = rotations.astype(np.float64)
    frame_count = len(rotations)
    offsets = np.zeros((frame_count, 3))
    checked_spans: dict[int, tuple[IntArray, FloatArray]] = {}
    valid_spans = {1: np.ones(frame_count, np.bool_)}
    for span, sub_spans in SPAN_SPLITS.items():
        is_candidate = np.ones(max(frame_count - span, 0), np.bool_)
        span_offset = 0
        for length in sub_spans:
            is_candidate &= valid_spans[length][
                span_offset : span_offset + len(is_candidate)
            ]
            span_offset += length
        candidate_frames = np.flatnonzero(is_candidate)
        valid_spans[span] = np.zeros(frame_count, np.bool_)
        if len(candidate_frames):
            is_valid, span_offsets = pose_skeleton.find_valid_spans(
                exact_rotations, is_planted, candidate_frames, span
            )
            valid_spans[span][candidate_frames] = is_valid
            checked_spans[span] = candidate_frames, span_offsets
    is_selected = _shortest_path(valid_spans)
    key_frames = np.flatnonzero(is_selected)
    for begin, span in zip(
        key_frames.tolist(), np.diff(key_frames).tolist(), strict=False
    ):
        if span > 1:
            candidate_frames, span_offsets = checked_spans[span]
            candidate_index = int(np.searchsorted(candidate_frames, begin))
            offsets[begin + 1 : begin + span] = span_offsets[candidate_index]
    return is_selected, offsets


def _shortest_path(spans_by_length: dict[int, BoolArray]) -> BoolArray:
    """Return a mask of the fewest frames that valid spans connect, first to last."""
    frame_count = len(spans_by_length[1])
    next_steps, sample_counts = [1] * frame_count, [0] * frame_count
    valid_spans = {
        span: is_valid.tolist() for span, is_valid in spans_by_length.items()
    }
    for frame in range(frame_count - 2, -1, -1):
        fewest_samples = frame_count
        for span, is_valid in valid_spans.items():
            if (
                is_valid[frame]
                and frame + span < frame_count
                and sample_counts[frame + span] < fewest_samples
            ):
                fewest_samples, next_steps[frame] = sample_counts[frame + span], span
        sample_counts[frame] = fewest_samples + 1
    is_selected = np.zeros(frame_count, bool)
    frame = 0
    while frame < frame_count:
        is_selected[frame] = True
        frame += next_steps[frame]
    return is_selected


def slerp(first: FloatArray, last: FloatArray, fraction: FloatArray) -> FloatArray:
    """Return the slerp of unit quaternions ``(…, 4)`` that lie in one hemisphere."""
    cosine = np.clip(np.einsum("...k,...k->...", first, last), -1.0, 1.0)
    angle = np.arccos(cosine)
    sine = np.sin(angle)
    is_small = sine < 1e-6
    safe_sine = np.where(is_small, 1.0, sine)
    first_weight = np.where(
        is_small, 1 - fraction, np.sin((1 - fraction) * angle) / safe_sine
    )
    last_weight = np.where(is_small, fraction, np.sin(fraction * angle) / safe_sine)
    return np.asarray(first_weight[..., None] * first + last_weight[..., None] * last)


def find_rotating_joints(
    rotations: Float32Array, subtree_radii: FloatArray, rig_extent: float
) -> BoolArray:
    """Return which joints rotate perceptibly ``(M,)`` in poses ``(F, M, 4)``.

    A rotation counts if it moves the farthest descendant of the joint by more than
    `STATIC_DISTANCE` times ``rig_extent``.
    """
    cosine = np.abs((rotations * rotations[:1]).sum(axis=-1)).min(axis=0)
    angles = 2 * np.arccos(np.clip(cosine, 0.0, 1.0))
    return np.asarray(angles * subtree_radii > STATIC_DISTANCE * rig_extent)
