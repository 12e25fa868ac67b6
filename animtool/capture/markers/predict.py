"""Prediction of hidden markers, from markers around them or a skeleton.

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

# Training window on either side of a gap [s].
WINDOW = 6.0
# Training frames, next to the gap and in total.
MAX_TRAINING, DENSE = 180, 16
MIN_TRAINING = 12
# Numbers of markers that define the frame, and the pose.
FRAME_MARKERS, POSE_MARKERS = (3, 4), (0, 5, 9)
# Noise of a position [m].
NOISE = 0.0005
# The same squared is not below this share of how alike a frame is to itself [1]: what
# float64 can factor.
ROUNDING = 1e-12
# Amplitude [m] and time scale [s] of a marker's deviation from the pose.
STRAYS = ((0.004, 0.12), (0.03, 0.35))
# The same if nothing determines the joint.
LOOSE = (*STRAYS, (0.05, 1.0))
# The same for a skeleton's prediction: none, or as skin moves.
SKIN = ((0.0, 1.0), *product((0.001, 0.004), (0.1, 0.3, 1.0)))
# How much of the pose changes before what was learnt is forgotten, of its spread [1];
# 0 is never: a marker moves with the pose in straight lines.
REACHES = (0.0, 1.0, 3.0)
# Number of cross-validation spans.
CHECKS = 6


@dataclass(frozen=True, slots=True)
class Prediction:
    """Predicted positions of a marker in a gap.

    Attributes:
        positions: ``(G, 3)`` [m].
        off: Cross-validation error in spans of the same length [m].
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
    """Return a marker's predicted positions in a gap; None if too few are visible.

    The marker is expressed in the frame of those around it that are most rigid with it.
    Its motion there is learnt from the frames in which it is visible: a Gaussian
    process over the others' pose, plus one over time that joins the ends.

    positions: ``(F, M, 3)`` [m], filled gaps included. visible: ``(F, M)``. spread: How
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
    """Return the prediction of the kernel with the least cross-validation error.

    local: The marker in some frame of reference ``(F, 3)``, visible in all but the
    frames of the gap, which are last. pose: Others there, the most rigid first ``(F, K,
    3)``. least: Number of them used whenever any are.
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
    """Return predictions for a marker without mates on its joint; None if unknown.

    It is expressed in the frame of the parent joint, and in one rotated towards a
    marker on the same joint if there is any. Its motion there is learnt as in
    `predict`, with the same arguments.
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
    """Return frames ``(F, 3, 3)`` rotated by the shortest arc towards a point."""
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
    """Return a marker's predicted positions in a gap from a skeleton.

    They are its positions on the skeleton plus its offset there: a Gaussian process
    over time, in the frame of its joint, that joins the ends. Amplitude and speed of
    skin motion are those with the least cross-validation error.

    positions: ``(F, M, 3)`` [m]. visible: Measured ones ``(F, M)``. rate: [frame/s].
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
    """Return the markers visible throughout a gap, the most rigid first."""
    usable = visible[gap].all(axis=0) & np.isfinite(spread)
    usable[marker] = False
    order = np.argsort(np.where(usable, spread, np.inf), kind="stable")
    return np.asarray(order[: min(max(POSE_MARKERS), int(usable.sum()))])


def _training(
    visible: BoolArray, marker: int, gap: slice, near: IntArray, rate: float
) -> IntArray:
    """Return the training frames: all next to the gap, and some farther off."""
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
    """Return marker and pose in the frame of the nearest, and the inverse mapping."""
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
    """Return predictions for the unknown frames, and their error.

    The error is that of known positions left out in spans as long as the gap [m].
    """
    from scipy.linalg import cho_factor, cho_solve

    known = len(local)
    mean = local.mean(axis=0)
    # Rounding of outlying samples exceeds the noise.
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
    """Return the starts of spans to leave out, on both sides of a gap."""
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
    """Return the covariance of all frames with the known ones ``(F, known)`` [m^2]."""
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
