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
from animtool.core.clock import Clock
from animtool.core.errors import Fault, OptionError
from animtool.core.record import dataclass
from animtool.edit.frames import frame_index
from animtool.edit.loop_options import LoopOptions
from animtool.edit.travel import joint_frame, rest_rotation, traveller, twist
from animtool.maths import so3
from animtool.motion.take import Take
from animtool.rig.kinematics import rest_size
from animtool.rig.skeleton import Rig

# A speed difference counts as the position difference it makes in this time [s].
SPEED_TIME = 0.1
# Frame rate of the coarse comparison; the best pair is then refined.
SEARCH_RATE = Fraction(30)
# Least extent of a cycle, as a fraction of the take's variation.
MIN_EXTENT = 0.25
# Differences below this fraction of the rig's size are static.
STATIC = 1e-4
# Among nearly equal cycles the shortest is chosen, not a multiple of it:
# how much worse, as factor and offset, and how much longer the best near it is.
NEARLY, NEARLY_EQUAL, NEAR = 1.5, 0.01, 1.25
BLOCK_FRAMES = 1024


@dataclass(frozen=True, slots=True)
class Cycle:
    """A part of a take that ends as it began."""

    first: float  # time code of its first frame
    last: float  # time code of the frame that shows the first pose again
    apart: float  # distance of the two poses [m], see `animtool.edit.cycle`
    # Largest distance of the frames between from the first [m], at least a ten
    # thousandth of the rig's size.
    moved: float

    @property
    def share(self) -> float:
        """Difference of the ends over the cycle's extent [1]."""
        return self.apart / self.moved


_DEFAULTS = LoopOptions()


def find_cycle(
    take: Take,
    first: float | None = None,
    last: float | None = None,
    *,
    shortest: float = _DEFAULTS.shortest,
    longest: float = _DEFAULTS.longest,
) -> Cycle:
    """Return the cycle of a take whose ends match best, relative to its extent.

    Among nearly equal cycles the shortest is taken, then the earliest. Time grows with
    the frames and with ``longest``, memory with the frames alone.

    Limits: shape weights and controls are ignored.

    Args:
        take: F frames.
        first: Time code where the search begins; None is the take's first frame.
        last: Time code where it ends; None is the take's last.
        shortest: Least length of a cycle [s].
        longest: Most [s].

    Raises:
        OptionError: A frame is outside the take (SCN013), or there is no cycle of
            such a length (SCN018).
    """
    clock = take.clock
    low, high = _ends(clock, first, last)
    stride = max(1, int(clock.rate // SEARCH_RATE))
    frames = np.arange(low, high + 1, stride)
    rate = float(clock.rate) / stride
    least = max(2, math.ceil(_length(shortest, "shortest") * rate))
    most = min(len(frames) - 1, math.floor(_length(longest, "longest") * rate))
    if least > most:
        seconds = (high - low) / float(clock.rate)
        message = f"of {shortest:g} to {longest:g} s in a take of {seconds:.3g} s"
        if shortest > longest:
            message = f"of at least {shortest:g} s and at most {longest:g} s"
        hint = f"use a longer take, or lower {argument('shortest')}"
        if len(frames) == 1:
            hint = "a cycle needs several frames: choose another take"
        raise _none(message, hint)
    eye = _PoseView.of(take)
    best = _best(eye.see(frames), least, most, eye.static_extent)
    if best is None:
        raise _none("where nothing moves")
    start, lag, extent = best
    pairs = _nearby(frames[start], frames[start + lag], stride, (low, high))
    length = pairs[1] - pairs[0]
    within = (length >= least * stride) & (length <= most * stride)
    i, j, distance = _closest(eye, pairs[:, within])
    return _cycle(clock, i, j, distance, max(distance, extent))


def measure_cycle(
    take: Take, first: float | None = None, last: float | None = None
) -> Cycle:
    """Return how well the two ends of a cycle match."""
    low, high = _ends(take.clock, first, last)
    if low >= high:
        raise _none(f"from frame {first} to {last}")
    eye = _PoseView.of(take)
    stride = max(1, int(take.clock.rate // SEARCH_RATE))
    begin = eye.see(np.array([low]))
    distance = float(_pose_distance(begin, eye.see(np.array([high])))[0])
    extents = _pose_distance(begin, eye.see(np.arange(low, high + 1, stride)))
    far = max(distance, float(extents.max()), eye.static_extent)
    return _cycle(take.clock, low, high, distance, far)


def _ends(clock: Clock, first: float | None, last: float | None) -> tuple[int, int]:
    low = 0 if first is None else frame_index(clock, first, "first")
    high = clock.count - 1 if last is None else frame_index(clock, last, "last")
    return low, high


def _length(seconds: float, option: str) -> float:
    if not 0 < seconds < math.inf:
        raise _none(f"with {option} {seconds:g} s")
    return seconds


def _none(message: str, hint: str | None = None) -> OptionError:
    return OptionError(Fault("SCN018", f"no cycle can be found {message}", hint=hint))


def _cycle(clock: Clock, i: int, j: int, distance: float, extent: float) -> Cycle:
    first, last = (float(clock.start + k * clock.step) for k in (i, j))
    return Cycle(first, last, distance, extent)


@dataclass(frozen=True, slots=True)
class _PoseView:
    """Frames of a take as columns of comparable numbers [m]."""

    take: Take
    chief: int
    leaves: IntArray
    reach: FloatArray  # how far the points beside a leaf are from it (N,) [m]
    weights: FloatArray  # of joints, then of the points beside leaves (P,)
    static_extent: float  # distances below are static [m]

    @staticmethod
    def of(take: Take) -> _PoseView:
        rig = take.rig
        if not rig.joints:
            raise _none("without joints: a cycle is found from their positions")
        leaves = np.setdiff1d(np.arange(len(rig.joints)), rig.parents)
        bones = np.linalg.norm(rig.rest_translations, axis=-1)
        bones = np.where(rig.parents < 0, 0.0, bones)
        weights = bones / 2
        below = rig.parents >= 0
        np.add.at(weights, rig.parents[below], bones[below] / 2)
        if not weights.any():
            weights = np.ones(len(bones))
        size = rest_size(rig) or 1.0
        reach = np.where(bones[leaves] > 0, bones[leaves], size)
        # A leaf counts by its origin and a point along two of its axes.
        weights[leaves] /= 3
        weights = np.concatenate([weights, np.tile(weights[leaves], 2)])
        travellers = [traveller(rig, take.motion, root) for root in rig.roots]
        chief = next((j for j in travellers if j is not None), rig.roots[0])
        weights /= weights.sum()
        return _PoseView(take, chief, leaves, reach, weights, STATIC * size)

    def see(self, frames: IntArray) -> FloatArray:
        """Return frames as columns ``(6 · P, N)``, block by block."""
        parts = [
            self._columns(frames[begin : begin + BLOCK_FRAMES])
            for begin in range(0, len(frames), BLOCK_FRAMES)
        ]
        return np.concatenate(parts, axis=1)

    def _columns(self, frames: IntArray) -> FloatArray:
        count = self.take.clock.count
        # At the ends of the take, speed follows from the three frames there.
        middle = np.clip(frames, 1, max(1, count - 2))
        around = [np.clip(middle + k, 0, count - 1) for k in (-1, 0, 1)]
        before, here, after = (self._points(each) for each in around)
        beyond = (frames - middle)[:, None, None]
        speed = (after - before) / 2 + beyond * (after - 2 * here + before)
        points = np.where(beyond < 0, before, np.where(beyond > 0, after, here))
        ground, heading = self._standing(frames)
        back = so3.conjugate(heading)[:, None]
        led = speed * (SPEED_TIME * float(self.take.clock.rate))
        parts = [so3.rotate(back, points - ground[:, None]), so3.rotate(back, led)]
        table = np.stack(parts, axis=1) * np.sqrt(self.weights)[:, None]
        return np.ascontiguousarray(table.reshape(len(frames), -1).T)

    def _points(self, frames: IntArray) -> FloatArray:
        """Return joints and points beside leaves in the world ``(N, P, 3)``."""
        world = self.take.motion.select(frames).world(self.take.rig)
        origins, axes = world.positions, world.linear[:, self.leaves]
        neighbours = [
            origins[:, self.leaves] + axes[..., k] * self.reach[:, None] for k in (0, 1)
        ]
        return np.concatenate([origins, *neighbours], axis=1)

    def _standing(self, frames: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the character's ground position ``(N, 3)`` and heading ``(N, 4)``."""
        rig: Rig = self.take.rig
        up = np.array(rig.up.vector)
        frame = joint_frame(rig, self.take.motion.select(frames), self.chief)
        rest = so3.conjugate(rest_rotation(rig, self.chief))
        heading = twist(so3.multiply(frame.rotation, rest), up)
        return np.where(up == 0, frame.position, 0.0), heading


def _pose_distance(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the distance of columns ``(D, N)``: ``(N,)`` [m]."""
    # Sums over rows in order round the same on every machine.
    away = a - b
    np.multiply(away, away, out=away)
    return np.asarray(np.sqrt(away.sum(axis=0)))


def _best(
    table: FloatArray, least: int, most: int, static_extent: float
) -> tuple[int, int, float] | None:
    """Return start, length and extent of the best cycle, in columns."""
    count = table.shape[1]
    variety = _pose_distance(table, table.mean(axis=1, keepdims=True))
    enough = max(static_extent, MIN_EXTENT * math.sqrt(float(np.mean(variety**2))))
    extents = np.zeros(count)
    scores = np.full(most + 1, np.inf)
    starts = np.zeros(most + 1, np.int64)
    reached = np.zeros(most + 1)
    # One step a length: all pairs of that length at once.
    for lag in range(1, most + 1):
        distances = _pose_distances_by(table, lag)
        extents = np.maximum(extents[: count - lag], distances)
        if lag >= least:
            far = extents > enough
            shares = np.where(far, distances / np.where(far, extents, 1), np.inf)
            scores[lag], k = _least(shares)
            starts[lag], reached[lag] = k, extents[k]
    if not np.isfinite(scores).any():
        return None
    lag = _shortest(scores)
    return int(starts[lag]), lag, float(reached[lag])


def _pose_distances_by(table: FloatArray, lag: int) -> FloatArray:
    """Return the distance of columns ``lag`` apart, in cache-sized blocks."""
    count = table.shape[1] - lag
    begins = range(0, count, BLOCK_FRAMES)
    ranges = [(begin, min(begin + BLOCK_FRAMES, count)) for begin in begins]
    return np.concatenate(
        [_pose_distance(table[:, a + lag : b + lag], table[:, a:b]) for a, b in ranges]
    )


def _least(values: FloatArray) -> tuple[float, int]:
    """Return the least value, to a thousandth, and its first index."""
    # Else rounding, which differs between machines, would decide.
    coarse = np.round(values, 3)
    index = int(np.argmin(coarse))
    return float(coarse[index]), index


def _shortest(scores: FloatArray) -> int:
    """Return the length of the shortest cycle that is nearly as good as the best."""
    short = int(np.argmax(scores <= NEARLY * scores.min() + NEARLY_EQUAL))
    near = scores[short : math.floor(short * NEAR) + 1]
    return short + int(np.argmin(near))


def _nearby(i: int, j: int, stride: int, ends: tuple[int, int]) -> IntArray:
    """Return the pairs of frames around a coarse pair ``(2, N)``."""
    around = np.arange(1 - stride, stride)
    sides = (np.unique(np.clip(frame + around, *ends)) for frame in (i, j))
    return np.stack([grid.ravel() for grid in np.meshgrid(*sides, indexing="ij")])


def _closest(eye: _PoseView, pairs: IntArray) -> tuple[int, int, float]:
    """Return the best-matching pair of frames, and its distance [m]."""
    frames, at = np.unique(pairs, return_inverse=True)
    table, (starts, ends) = eye.see(frames), at.reshape(pairs.shape)
    distances = _pose_distance(table[:, starts], table[:, ends])
    _, best = _least(distances / eye.static_extent)
    return int(pairs[0, best]), int(pairs[1, best]), float(distances[best])
