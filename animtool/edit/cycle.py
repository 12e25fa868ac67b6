"""Search for a cycle: two frames of a take with similar poses and speeds.

Frames are compared by joint positions and velocities relative to the joint that carries
the character: its ground position and heading. Joints are weighted by the length of the
bones they move, velocities by the distance covered in a tenth of a second. The
difference is a root mean square [m].
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import Clock, frame_label
from animtool.core.errors import Fault, OptionError
from animtool.core.loaded import check_loaded
from animtool.core.quantities import MIN_SUSPECT_SECONDS
from animtool.core.record import dataclass
from animtool.edit.frames import frame_index
from animtool.edit.loop_options import LoopOptions
from animtool.edit.travel import (
    joint_frame,
    rest_rotation,
    travelling_joint,
    vertical_twist,
)
from animtool.maths import so3
from animtool.motion.take import Take
from animtool.rig.kinematics import rest_size
from animtool.rig.skeleton import Rig

# Interval that converts a speed difference to a position difference [s].
SPEED_INTERVAL = 0.1
# Frame rate of the coarse comparison; then the best pair is refined.
SEARCH_RATE = Fraction(30)
# Minimum extent of a cycle, as a fraction of the take's variation.
MIN_EXTENT = 0.25
# Differences below this fraction of the rig's size are static.
STATIC_FRACTION = 1e-4
# Among nearly equal cycles, the shortest is chosen instead of a multiple of it: factor
# and offset of the accepted difference, and the length range that is searched around
# it.
EQUAL_FACTOR, EQUAL_OFFSET, LENGTH_RANGE = 1.5, 0.01, 1.25
BLOCK_FRAMES = 1024


@dataclass(frozen=True, slots=True)
class Cycle:
    """A frame range of a take to repeat, and the difference between its ends."""

    first: float  # time code of the first frame
    last: float  # time code of the frame that shows the first pose again
    apart: float  # distance between the two poses [m], see `animtool.edit.cycle`
    # Largest distance of the frames in between from the first [m], at least a
    # ten-thousandth of the rig's size.
    moved: float

    @property
    def share(self) -> float:
        """Difference between the ends over the cycle's extent [1]."""
        return self.apart / self.moved


_DEFAULT_OPTIONS = LoopOptions()


def find_cycle(
    take: Take,
    first: float | None = None,
    last: float | None = None,
    *,
    shortest: float = _DEFAULT_OPTIONS.shortest,
    longest: float = _DEFAULT_OPTIONS.longest,
) -> Cycle:
    """Return the cycle of a take whose ends match best, relative to its extent.

    Among nearly equal cycles the shortest is chosen, then the earliest. Time grows with
    the frames and with ``longest``, memory only with the frames.

    Limits: shape weights and controls are ignored.

    Args:
        take: F frames.
        first: First time code of the search range; None uses the take's first frame.
        last: Last time code of the search range; None uses the take's last.
        shortest: Minimum length of a cycle [s].
        longest: Maximum length [s].

    Raises:
        OptionError: A frame is outside the take (SCN013), or there is no cycle of
            such a length (SCN018).
    """
    check_loaded(take, Take, "take")
    clock = take.clock
    first_index, last_index = range_end_indices(clock, first, last)
    stride = max(1, int(clock.rate // SEARCH_RATE))
    frames = np.arange(first_index, last_index + 1, stride)
    rate = float(clock.rate) / stride
    if first_index >= last_index and clock.count > 1:
        raise empty_cycle_error(clock, first_index, last_index)
    min_lag = max(2, math.ceil(_checked_seconds(shortest, "shortest") * rate))
    max_lag = math.floor(_checked_seconds(longest, "longest") * rate)
    max_lag = min(len(frames) - 1, max_lag)
    if min_lag > max_lag:
        seconds = (last_index - first_index) / float(clock.rate)
        message = f"of {shortest:g} to {longest:g} s in a take of {seconds:.3g} s"
        if shortest > longest:
            message = f"of at least {shortest:g} s and at most {longest:g} s"
        hint = f"use a longer take, or lower {argument('shortest')}"
        if shortest > longest:
            hint = f"lower {argument('shortest')}, or raise {argument('longest')}"
        hint = _frames_hint(shortest, longest, float(clock.rate), seconds) or hint
        if len(frames) == 1:
            hint = "a cycle needs several frames: choose another take"
        raise _no_cycle_error(message, hint)
    pose_view = _PoseView.from_take(take)
    columns = pose_view.columns_of_frames(frames)
    coarse_cycle = _best_cycle(columns, min_lag, max_lag, pose_view.static_extent)
    if coarse_cycle is None:
        raise _no_cycle_error("where nothing moves")
    start, lag, extent = coarse_cycle
    end_frames = (first_index, last_index)
    pairs = _nearby_pairs(frames[start], frames[start + lag], stride, end_frames)
    lengths = pairs[1] - pairs[0]
    is_valid_length = (lengths >= min_lag * stride) & (lengths <= max_lag * stride)
    i, j, distance = _closest_pair(pose_view, pairs[:, is_valid_length])
    return _build_cycle(clock, i, j, distance, max(distance, extent))


def _frames_hint(
    shortest: float, longest: float, rate: float, seconds: float
) -> str | None:
    """Return a hint if the lengths of a cycle seem to be in frames, or None.

    seconds: Length of the take [s].
    """
    are_frame_counts = [
        length >= MIN_SUSPECT_SECONDS and length == round(length)
        for length in (shortest, longest)
    ]
    if not are_frame_counts[0] or shortest / rate > seconds:
        return None
    options_text = argument("shortest", f"{shortest / rate:.3g}")
    frames_text = f"{shortest:g}"
    if are_frame_counts[1] and longest >= shortest:
        frames_text += f" to {longest:g}"
        options_text += f", {argument('longest', f'{longest / rate:.3g}')}"
    return f"lengths are in seconds: for {frames_text} frames write {options_text}"


def measure_cycle(
    take: Take, first: float | None = None, last: float | None = None
) -> Cycle:
    """Measure the pose difference between the first and last frame of a cycle."""
    first_index, last_index = range_end_indices(take.clock, first, last)
    if first_index >= last_index:
        raise empty_cycle_error(take.clock, first_index, last_index)
    pose_view = _PoseView.from_take(take)
    stride = max(1, int(take.clock.rate // SEARCH_RATE))
    first_column, last_column, all_columns = (
        pose_view.columns_of_frames(np.array(frames))
        for frames in (
            [first_index],
            [last_index],
            range(first_index, last_index + 1, stride),
        )
    )
    distance = float(_pose_distance(first_column, last_column)[0])
    extents = _pose_distance(first_column, all_columns)
    largest_extent = max(distance, float(extents.max()), pose_view.static_extent)
    return _build_cycle(take.clock, first_index, last_index, distance, largest_extent)


def range_end_indices(
    clock: Clock, first: float | None, last: float | None
) -> tuple[int, int]:
    """Return the indices of the first and last frame of a range of time codes."""
    first_index = 0 if first is None else frame_index(clock, first, "first")
    last_index = clock.count - 1 if last is None else frame_index(clock, last, "last")
    return first_index, last_index


def empty_cycle_error(clock: Clock, first_index: int, last_index: int) -> OptionError:
    """Return the error for a cycle that ends where it begins, or earlier (SCN018)."""
    first, last = (clock.start + i * clock.step for i in (first_index, last_index))
    begin, end = argument("first"), argument("last")
    message = f"{begin} and {end} are both frame {frame_label(first)}: the cycle has "
    message += "no length"
    hint = f"{end} is a later frame, which shows the first pose again"
    if clock.count == 1:
        message, hint = "the take has one frame: it has no cycle", "use a longer take"
    elif first_index == clock.count - 1:
        hint = f"{begin} must be before the take's last frame, {frame_label(last)}"
    if first > last:
        message = f"{begin} is frame {frame_label(first)}, after {end}, frame "
        message += frame_label(last)
        hint = "exchange them"
    return OptionError(Fault("SCN018", message, hint=hint))


def _checked_seconds(seconds: float, option: str) -> float:
    """Return a length option in seconds; refuse a negative or non-finite one."""
    if not 0 < seconds < math.inf:
        raise _no_cycle_error(f"with {option} {seconds:g} s")
    return seconds


def _no_cycle_error(message: str, hint: str | None = None) -> OptionError:
    """Return the error for a take that has no cycle (SCN018)."""
    return OptionError(Fault("SCN018", f"no cycle can be found {message}", hint=hint))


def _build_cycle(clock: Clock, i: int, j: int, distance: float, extent: float) -> Cycle:
    """Return a cycle from frame indices."""
    first, last = (float(clock.start + k * clock.step) for k in (i, j))
    return Cycle(first, last, distance, extent)


@dataclass(frozen=True, slots=True)
class _PoseView:
    """Frames of a take as columns of weighted positions and velocities [m]."""

    take: Take
    main_joint: int
    leaf_joints: IntArray
    # distance of the extra points at a leaf from it (N,) [m]
    leaf_distances: FloatArray
    weights: FloatArray  # weights of joints, then of the extra points at leaves (P,)
    static_extent: float  # distances below this are static [m]

    @staticmethod
    def from_take(take: Take) -> _PoseView:
        """Return a view of a take: the points to compare and their weights."""
        rig = take.rig
        if not rig.joints:
            message = "without joints: a cycle is found from their positions"
            raise _no_cycle_error(message)
        leaf_joints = np.setdiff1d(np.arange(len(rig.joints)), rig.parents)
        bone_lengths = np.linalg.norm(rig.rest_translations, axis=-1)
        bone_lengths = np.where(rig.parents < 0, 0.0, bone_lengths)
        weights = bone_lengths / 2
        has_parent = rig.parents >= 0
        np.add.at(weights, rig.parents[has_parent], bone_lengths[has_parent] / 2)
        if not weights.any():
            weights = np.ones(len(bone_lengths))
        size_or_one = rest_size(rig) or 1.0
        leaf_distances = np.where(
            bone_lengths[leaf_joints] > 0, bone_lengths[leaf_joints], size_or_one
        )
        # A leaf is represented by its origin and a point along two of its axes.
        weights[leaf_joints] /= 3
        weights = np.concatenate([weights, np.tile(weights[leaf_joints], 2)])
        moving_joints = [travelling_joint(rig, take.motion, root) for root in rig.roots]
        main_joint = next((j for j in moving_joints if j is not None), rig.roots[0])
        weights /= weights.sum()
        return _PoseView(
            take,
            main_joint,
            leaf_joints,
            leaf_distances,
            weights,
            STATIC_FRACTION * size_or_one,
        )

    def columns_of_frames(self, frames: IntArray) -> FloatArray:
        """Return frames as columns ``(6 · P, N)``, block by block."""
        blocks = [
            self._columns_of_block(frames[start : start + BLOCK_FRAMES])
            for start in range(0, len(frames), BLOCK_FRAMES)
        ]
        return np.concatenate(blocks, axis=1)

    def _columns_of_block(self, frames: IntArray) -> FloatArray:
        """Return the columns of a block of frames: positions, then velocities."""
        frame_count = self.take.clock.count
        # At the ends of the take, speed follows from the three frames there.
        inner_frames = np.clip(frames, 1, max(1, frame_count - 2))
        neighbour_frames = [
            np.clip(inner_frames + k, 0, frame_count - 1) for k in (-1, 0, 1)
        ]
        points_before, points_in_middle, points_after = (
            self._points(frame_indices) for frame_indices in neighbour_frames
        )
        end_offset = (frames - inner_frames)[:, None, None]
        second_differences = points_after - 2 * points_in_middle + points_before
        velocities = (points_after - points_before) / 2
        velocities = velocities + end_offset * second_differences
        current_points = np.where(end_offset > 0, points_after, points_in_middle)
        current_points = np.where(end_offset < 0, points_before, current_points)
        ground, heading = self._ground_pose(frames)
        inverse_heading = so3.conjugate(heading)[:, None]
        speed_as_distance = velocities * (SPEED_INTERVAL * float(self.take.clock.rate))
        columns = [
            so3.rotate(inverse_heading, current_points - ground[:, None]),
            so3.rotate(inverse_heading, speed_as_distance),
        ]
        weighted_columns = np.stack(columns, axis=1) * np.sqrt(self.weights)[:, None]
        return np.ascontiguousarray(weighted_columns.reshape(len(frames), -1).T)

    def _points(self, frames: IntArray) -> FloatArray:
        """Return world positions of joints and extra leaf points ``(N, P, 3)``."""
        world = self.take.motion.select(frames).world(self.take.rig)
        origins, axes = world.positions, world.linear[:, self.leaf_joints]
        neighbours = [
            origins[:, self.leaf_joints] + axes[..., k] * self.leaf_distances[:, None]
            for k in (0, 1)
        ]
        return np.concatenate([origins, *neighbours], axis=1)

    def _ground_pose(self, frames: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the character's ground position ``(N, 3)`` and heading ``(N, 4)``."""
        rig: Rig = self.take.rig
        up = np.array(rig.up.vector)
        main_joint_pose = joint_frame(
            rig, self.take.motion.select(frames), self.main_joint
        )
        inverse_rest = so3.conjugate(rest_rotation(rig, self.main_joint))
        heading = vertical_twist(
            so3.multiply(main_joint_pose.rotation, inverse_rest), up
        )
        return np.where(up == 0, main_joint_pose.position, 0.0), heading


def _pose_distance(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return distances ``(N,)`` between corresponding columns ``(D, N)`` [m]."""
    # Summing rows in order rounds equally on every machine.
    difference = a - b
    np.multiply(difference, difference, out=difference)
    return np.asarray(np.sqrt(difference.sum(axis=0)))


def _best_cycle(
    columns: FloatArray, min_lag: int, max_lag: int, static_extent: float
) -> tuple[int, int, float] | None:
    """Return start, length [columns] and extent [m] of the best cycle."""
    column_count = columns.shape[1]
    distances_from_mean = _pose_distance(columns, columns.mean(axis=1, keepdims=True))
    deviation = math.sqrt(float(np.mean(distances_from_mean**2)))
    min_extent = max(static_extent, MIN_EXTENT * deviation)
    extents = np.zeros(column_count)
    score_by_lag = np.full(max_lag + 1, np.inf)
    start_by_lag = np.zeros(max_lag + 1, np.int64)
    largest_extents = np.zeros(max_lag + 1)
    # One step per length: all pairs of that length at once.
    for lag in range(1, max_lag + 1):
        distances = _pose_distances_at_lag(columns, lag)
        extents = np.maximum(extents[: column_count - lag], distances)
        if lag >= min_lag:
            is_large = extents > min_extent
            ratios = distances / np.where(is_large, extents, 1)
            ratios = np.where(is_large, ratios, np.inf)
            score_by_lag[lag], start_index = _first_minimum(ratios)
            start_by_lag[lag], largest_extents[lag] = start_index, extents[start_index]
    if not np.isfinite(score_by_lag).any():
        return None
    # The shortest cycle that is nearly as good as the best.
    is_acceptable = score_by_lag <= EQUAL_FACTOR * score_by_lag.min() + EQUAL_OFFSET
    shortest_lag = int(np.argmax(is_acceptable))
    nearby_scores = score_by_lag[
        shortest_lag : math.floor(shortest_lag * LENGTH_RANGE) + 1
    ]
    lag = shortest_lag + int(np.argmin(nearby_scores))
    return int(start_by_lag[lag]), lag, float(largest_extents[lag])


def _pose_distances_at_lag(columns: FloatArray, lag: int) -> FloatArray:
    """Return distances between all columns ``lag`` apart, in cache-sized blocks."""
    later, earlier = columns[:, lag:], columns[:, : columns.shape[1] - lag]
    starts = range(0, later.shape[1], BLOCK_FRAMES)
    blocks = [slice(start, start + BLOCK_FRAMES) for start in starts]
    return np.concatenate(
        [_pose_distance(later[:, block], earlier[:, block]) for block in blocks]
    )


def _first_minimum(values: FloatArray) -> tuple[float, int]:
    """Return the minimum, and the first index within a thousandth of it."""
    # Otherwise rounding, which differs between machines, would decide.
    rounded_values = np.round(values, 3)
    index = int(np.argmin(rounded_values))
    return float(rounded_values[index]), index


def _nearby_pairs(i: int, j: int, stride: int, end_frames: tuple[int, int]) -> IntArray:
    """Return all pairs of frames near a pair of the coarse search ``(2, N)``."""
    offsets = np.arange(1 - stride, stride)
    choices = (np.unique(np.clip(frame + offsets, *end_frames)) for frame in (i, j))
    return np.stack([grid.ravel() for grid in np.meshgrid(*choices, indexing="ij")])


def _closest_pair(pose_view: _PoseView, pairs: IntArray) -> tuple[int, int, float]:
    """Return the best-matching pair of frames, and its distance [m]."""
    frames, pair_columns = np.unique(pairs, return_inverse=True)
    pose_columns = pose_view.columns_of_frames(frames)
    start_columns, end_columns = pair_columns.reshape(pairs.shape)
    distances = _pose_distance(
        pose_columns[:, start_columns], pose_columns[:, end_columns]
    )
    _, best_index = _first_minimum(distances / pose_view.static_extent)
    i, j = pairs[:, best_index].tolist()
    return i, j, float(distances[best_index])
