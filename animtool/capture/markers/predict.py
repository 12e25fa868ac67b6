"""Where a marker is that was not seen: by the markers around it, or by a skeleton.

References:
    Rasmussen, C. E. and Williams, C. K. I., "Gaussian Processes for Machine Learning",
    MIT Press, 2006, section 2.2.
    Gløersen, Ø. and Federolf, P., "Predicting Missing Marker Trajectories in Human
    Motion Data Using Marker Intercorrelations", PLOS ONE 11(3), 2016.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from animtool.capture.markers.geometry import fitted, mean_shape
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass

if TYPE_CHECKING:
    from animtool.capture.markers.skeleton import SkeletonMarkers

# Frames on either side of a gap that show how a marker moves with the others [s].
WINDOW = 6.0
# Frames learnt from, next to the gap and farther off.
MAX_TRAINING, DENSE = 180, 16
MIN_TRAINING = 12
# Markers that give the frame, and those that give the pose.
FRAME_MARKERS, POSE_MARKERS = (3, 4), (0, 5, 9)
# Noise of a position [m].
NOISE = 0.0005
# The same squared is not below this share of how alike a frame is to itself [1]: what
# float64 can factor.
ROUNDING = 1e-12
# How a marker strays from where the pose has it [m], and for how long [s].
STRAYS = ((0.004, 0.12), (0.03, 0.35))
# The same where a joint is held by nothing.
LOOSE = (*STRAYS, (0.05, 1.0))
# The same of where a skeleton has it: not at all, or as skin moves.
SKIN = ((0.0, 1.0), *product((0.001, 0.004), (0.1, 0.3, 1.0)))
# How much of the pose changes before what was learnt is forgotten, of its spread [1];
# 0 is never: a marker moves with the pose in straight lines.
REACHES = (0.0, 1.0, 3.0)
# Spans that are left out to see how good a model is.
CHECKS = 6


@dataclass(frozen=True, slots=True)
class Prediction:
    """Positions of a marker in a gap.

    Attributes:
        positions: ``(G, 3)`` [m].
        off: How far it is off spans of the same length that were left out [m].
    """

    positions: FloatArray
    off: float


def predict(
    positions: FloatArray,
    visible: BoolArray,
    marker: int,
    gap: slice,
    spread: FloatArray,
    rate: float,
) -> Prediction | None:
    """Return where a marker is in a gap; None where too little is seen to say.

    The marker is looked at in the frame of those around it that are most rigid with it.
    How it moves there with the pose of the others is learnt from the frames in which it
    is seen: a Gaussian process over the pose, plus one over time that joins the ends.

    positions: ``(F, M, 3)`` [m], filled gaps included. seen: ``(F, M)``. spread: How
    much the distance to each marker varies ``(M,)``. rate: [frame/s].
    """
    near = _near(visible, marker, gap, spread)
    if len(near) < 3:
        return None
    training = _training(visible, marker, gap, near, rate)
    if len(training) < MIN_TRAINING:
        return None
    frames = np.concatenate([training, np.arange(gap.start, gap.stop)])
    predictions = []
    for count in FRAME_MARKERS:
        if count <= len(near):
            local, pose, back = _local(positions, frames, marker, near, count)
            best = _best(local, pose, frames, gap, rate, STRAYS, count)
            predictions.append(Prediction(back(best.positions), best.off))
    return min(predictions, key=lambda each: each.off)


def _best(
    local: FloatArray,
    pose: FloatArray,
    frames: IntArray,
    gap: slice,
    rate: float,
    strays: tuple[tuple[float, float], ...],
    least: int = 1,
) -> Prediction:
    """Return what the kernel has of a marker that is best where it is left out.

    local: The marker in some frame of reference ``(F, 3)``, seen in all but the frames
    of the gap, which are last. pose: Others there, the most rigid first ``(F, K, 3)``.
    least: So many of them are looked at where any are.
    """
    known = len(frames) - (gap.stop - gap.start)
    best: Prediction | None = None
    for many in POSE_MARKERS:
        if many > pose.shape[1]:
            continue
        part = pose[:, : max(many, least)].reshape(len(frames), -1)
        for reach, (stray, time) in product(REACHES, strays):
            if not many and reach != REACHES[0]:
                continue
            kernel = _kernel(part, frames / rate, reach, stray, time, local[:known])
            off, values = _regressed(local[:known], kernel, frames, gap)
            if best is None or off < best.off:
                best = Prediction(values, off)
    assert best is not None
    return best


def predict_in_parent(
    skeleton: SkeletonMarkers,
    positions: FloatArray,
    visible: BoolArray,
    marker: int,
    gap: slice,
    spread: FloatArray,
    rate: float,
) -> Prediction | None:
    """Return where a marker is whose joint no other marker holds; None if unknown.

    It is looked at in the frame of the joint above, and in one that is turned towards a
    marker on the same joint if there is any. How it moves there is learnt, as of
    `predict`. Arguments are those of it.
    """
    near = _near(visible, marker, gap, spread)
    training = _training(visible, marker, gap, near, rate)
    if len(training) < MIN_TRAINING or not skeleton.above(marker):
        return None
    frames = np.concatenate([training, np.arange(gap.start, gap.stop)])
    known = len(training)
    origin, above = skeleton.origins[frames, marker], skeleton.parents[frames, marker]
    rotations = [above]
    visible_throughout = np.asarray(visible[gap].all(axis=0))
    for mate in skeleton.mates(marker, visible_throughout):
        if np.isin(training, np.flatnonzero(visible[:, mate])).all():
            rotations.append(_towards(above, positions[frames, mate] - origin))
    predictions = []
    for rotation in rotations:
        local = np.einsum("fji,fj->fi", rotation, positions[frames, marker] - origin)
        around = positions[frames][:, near] - origin[:, None]
        pose = np.einsum("fji,fkj->fki", rotation, around)
        best = _best(local, pose, frames, gap, rate, LOOSE)
        back = np.einsum("fij,fj->fi", rotation[known:], best.positions)
        predictions.append(Prediction(back + origin[known:], best.off))
    return min(predictions, key=lambda each: each.off)


def _towards(above: FloatArray, arms: FloatArray) -> FloatArray:
    """Return frames ``(F, 3, 3)`` turned the shortest way as a point of them is."""
    local = np.einsum("fji,fj->fi", above, arms)
    local /= np.linalg.norm(local, axis=1, keepdims=True)
    home = local.mean(axis=0)
    home /= np.linalg.norm(home)
    axis = np.cross(home, local)
    bent = np.zeros((len(local), 3, 3))
    bent[:, 0, 1], bent[:, 0, 2], bent[:, 1, 2] = -axis[:, 2], axis[:, 1], -axis[:, 0]
    bent -= bent.transpose(0, 2, 1)
    cosine = np.maximum(local @ home, -0.99)
    swing = np.eye(3) + bent + bent @ bent / (1.0 + cosine)[:, None, None]
    return np.asarray(above @ swing)


def follow(
    skeleton: SkeletonMarkers,
    positions: FloatArray,
    visible: BoolArray,
    marker: int,
    gap: slice,
    rate: float,
) -> Prediction:
    """Return where a marker is in a gap that a skeleton tells.

    That is where the skeleton has it, and what the marker is off there: a Gaussian
    process over time, in the frame of its joint, that joins the ends. How far and how
    fast skin strays is what predicts spans best that are left out.

    positions: ``(F, M, 3)`` [m]. seen: Measured ones ``(F, M)``. rate: [frame/s].
    """
    training = _training(visible, marker, gap, np.zeros(0, np.int64), rate)
    frames = np.concatenate([training, np.arange(gap.start, gap.stop)])
    rotations, points = skeleton.rotations[frames, marker], skeleton.positions[frames]
    path, known = points[:, marker], len(training)
    off = np.einsum(
        "fji,fj->fi", rotations[:known], positions[training, marker] - path[:known]
    )
    correction = np.zeros((gap.stop - gap.start, 3))
    least = np.inf
    nothing = np.zeros((len(frames), 0))
    for stray, time in SKIN if known >= MIN_TRAINING else ():
        kernel = _kernel(nothing, frames / rate, REACHES[0], stray, time, off)
        missed, values = _regressed(off, kernel, frames, gap)
        if missed < least:
            least, correction = missed, values
    back = np.einsum("fij,fj->fi", rotations[known:], correction)
    return Prediction(np.asarray(path[known:] + back, np.float64), least)


def _near(visible: BoolArray, marker: int, gap: slice, spread: FloatArray) -> IntArray:
    """Return the markers that are seen in all of a gap, the most rigid ones first."""
    usable = visible[gap].all(axis=0) & np.isfinite(spread)
    usable[marker] = False
    order = np.argsort(np.where(usable, spread, np.inf), kind="stable")
    return np.asarray(order[: min(max(POSE_MARKERS), int(usable.sum()))])


def _training(
    visible: BoolArray, marker: int, gap: slice, near: IntArray, rate: float
) -> IntArray:
    """Return the frames to learn from: all next to the gap, and some farther off."""
    reach = int(WINDOW * rate)
    begin, end = max(gap.start - reach, 0), min(gap.stop + reach, len(visible))
    usable = visible[begin:end, marker] & visible[begin:end][:, near].all(axis=1)
    frames = np.flatnonzero(usable) + begin
    frames = frames[(frames < gap.start) | (frames >= gap.stop)]
    away = np.where(frames < gap.start, gap.start - frames, frames - gap.stop + 1)
    close = frames[away <= DENSE]
    rest = frames[away > DENSE]
    count = MAX_TRAINING - len(close)
    if len(rest) > count:
        rest = rest[np.linspace(0, len(rest) - 1, count).astype(np.int64)]
    return np.sort(np.concatenate([close, rest]))


def _local(
    positions: FloatArray, frames: IntArray, marker: int, near: IntArray, count: int
) -> tuple[FloatArray, FloatArray, Callable[[FloatArray], FloatArray]]:
    """Return the marker and the pose in the frame of the nearest, and the way back."""
    around = positions[frames][:, near]
    shape = mean_shape(around[:, :count])
    rotation, shift = fitted(around[:, :count], shape)
    pose = np.einsum("fji,fkj->fki", rotation, around - shift[:, None])
    offset = positions[frames, marker] - shift
    local = np.einsum("fji,fj->fi", rotation, offset)

    def back(values: FloatArray) -> FloatArray:
        gapped = rotation[-len(values) :], shift[-len(values) :]
        return np.asarray(np.einsum("fij,fj->fi", gapped[0], values) + gapped[1])

    return local, pose, back


def _regressed(
    local: FloatArray, kernel: FloatArray, frames: IntArray, gap: slice
) -> tuple[float, FloatArray]:
    """Return positions in the frames behind the known ones, and how good they are.

    The measure is how far known positions are off that are left out, in spans as long
    as the gap [m].
    """
    from scipy.linalg import cho_factor, cho_solve

    known = len(local)
    mean = local.mean(axis=0)
    # What is as far off as a wild sample is told to less than the noise of others.
    noise = max(NOISE**2, ROUNDING * float(np.trace(kernel[:known])) / known)
    factor = cho_factor(kernel[:known] + noise * np.eye(known))
    inverse = cho_solve(factor, np.eye(known))
    weights = inverse @ (local - mean)
    values = kernel[known:] @ weights + mean
    length = gap.stop - gap.start
    training = frames[:known]
    off = []
    for begin in _spans(training, gap):
        left_out = np.flatnonzero((training >= begin) & (training < begin + length))
        if 0 < len(left_out) < known - MIN_TRAINING:
            block = inverse[np.ix_(left_out, left_out)]
            missed = np.linalg.solve(block, weights[left_out])
            off.append((missed**2).sum(axis=1).mean())
    return (float(np.sqrt(np.mean(off))) if off else np.inf), values


def _spans(training: IntArray, gap: slice) -> list[int]:
    """Return where spans begin that are left out, on both sides of a gap."""
    length = gap.stop - gap.start
    begins = []
    for k in range(CHECKS // 2):
        begins.append(gap.start - (k + 1) * (length + 2))
        begins.append(gap.stop + k * (length + 2) + 2)
    return [b for b in begins if b + length > training[0] and b <= training[-1]]


def _kernel(
    pose: FloatArray,
    times: FloatArray,
    reach: float,
    stray: float,
    stray_time: float,
    local: FloatArray,
) -> FloatArray:
    """Return how alike all frames are to the known ones ``(F, known)`` [m^2]."""
    known = len(local)
    variance = max(float(((local - local.mean(axis=0)) ** 2).mean()), NOISE**2)
    lag = np.sqrt(5.0) * np.abs(times[:, None] - times[None, :known]) / stray_time
    over_time = stray**2 * (1.0 + lag + lag**2 / 3.0) * np.exp(-lag)
    centred = pose - pose[:known].mean(axis=0)
    features = centred / (np.sqrt((centred[:known] ** 2).sum(axis=1).mean()) + 1e-9)
    products = features @ features[:known].T
    if reach:
        square = (features**2).sum(axis=1)
        squares = np.maximum(
            square[:, None] + square[None, :known] - 2.0 * products, 0.0
        )
        products = products + np.exp(-0.5 * squares / reach**2)
    return np.asarray(variance * products + over_time)
