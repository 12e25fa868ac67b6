"""Solves blend-shape weights from landmarks: bounded, robust and smooth.

Each frame is solved for weights and a head pose that put the shaped face on its
landmarks. Frames are coupled by a cost of changes, so a take is solved in windows that
overlap by more than a change propagates: results do not depend on block sizes.

References:
    P. J. Huber, Robust Statistics, 1981, chapter 7 (reweighted least squares).
    D. P. Bertsekas, Projected Newton methods for optimization problems with simple
    constraints, 1982.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import compress
from typing import TypeAlias

import numpy as np

from animtool import _kernels
from animtool.capture.face.fit import MISPLACED_FRACTION, FaceFit, FrameStatus
from animtool.capture.face.model import MIN_LANDMARK_MOTION, FaceModel, rms_spread
from animtool.capture.face.poses import (
    estimate_camera_pose,
    estimate_head_poses,
    interpolate_poses,
)
from animtool.core.arguments import argument
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import (
    Fault,
    OptionError,
    Severity,
    counted,
    listed,
    names_fault,
    refuse,
)
from animtool.core.quantities import plain_number
from animtool.maths import so3

# Frames of a window, and its overlap on both sides: a change propagates over a few
# frames only.
WINDOW_FRAMES, OVERLAP_FRAMES = 256, 32
# Minimum landmarks in a frame for a pose and a weight.
MIN_LANDMARKS = 4
# Frames for the noise estimate.
NOISE_FRAMES = 200
# Median length of noise vectors of standard deviation 1 in three directions, and in
# two.
MEDIAN_LENGTH_3D, MEDIAN_LENGTH_2D = 1.538, 1.1774
# Residuals longer than this many standard deviations are downweighted: 3 % of good
# ones.
ROBUST_DEVIATIONS = 3.0
# Minimum noise relative to the face's size: below, weights are exact to a thousandth.
MIN_NOISE = 1e-5
# Speed of weights of a lively face [1/s].
TYPICAL_SPEED = 3.0
# Typical deviation of weights from 0: weights that landmarks do not show stay small.
TYPICAL_WEIGHT = 0.5
# Convergence threshold of a weight's change.
CONVERGED_CHANGE = 1e-5
MAX_ROUNDS = 30
# Rounds for in-betweens and correctives.
MAX_NONLINEAR_ROUNDS = 6
NONLINEAR_CONVERGED_CHANGE = 1e-4
# Maximum distance of a swapped landmark from the neutral position of the other, over
# the distance of their neutral positions [1].
SWAP_DISTANCE = 0.25
# Largest size ratio between capture and face: beyond, their units differ.
MAX_SIZE_RATIO = 3.0
MAX_LISTED_FRAMES = 12
# Weights, poses, residuals and robust weights over frames, rounds, and largest change.
_FitResult: TypeAlias = tuple[
    FloatArray, FloatArray, FloatArray, FloatArray, int, float
]


def fit_face(
    model: FaceModel,
    observed: FloatArray,
    fps: float,
    *,
    smooth: float = 1.0,
    camera: FloatArray | None = None,
    progress: Callable[[float], None] | None = None,
) -> FaceFit:
    """Fit blend-shape weights and head poses to the landmarks of a face.

    Args:
        model: The face.
        observed: Landmarks in the world, in the model's order, NaN where missing [m]
            ``(F, N, 3)``; with a camera, undistorted pixels [px] ``(F, N, 2)``.
        fps: Frames a second.
        smooth: Penalty on changes between frames: 1 suits typical noise and a lively
            face, 0 disables it.
        camera: fx, fy, cx, cy of a camera that looks along +Z with Y down [px].
        progress: Called with the fraction done, 0 to 1.

    Raises:
        OptionError: Landmarks do not fit the model (FAC004), no frame has enough
            (FAC005), sizes differ as those of different units do (FAC006), no shape
            moves a landmark (FAC007), or the camera sees no face (FAC010).

    >>> model = FaceModel(tuple("abcd"), ("up",), np.eye(4)[:, :3], np.ones((1, 4, 3)))
    >>> model = FaceModel(model.names, ("x",), model.neutral, np.eye(4, 3, 1)[None])
    >>> seen = model.points(np.full((2, 1), 0.5))
    >>> fit_face(model, seen, 60.0).weights.round(4).tolist()
    [[0.5], [0.5]]
    """
    _check_landmarks(model, observed, camera)
    is_visible: BoolArray = np.asarray(np.isfinite(observed).all(axis=-1))
    is_usable = is_visible.sum(axis=1) >= MIN_LANDMARKS
    if not is_usable.any():
        refuse("FAC005", f"no frame has {MIN_LANDMARKS} landmarks or more")
    is_moving = model.shapes_with_motion()
    if not is_moving.any():
        message = "no shape moves a landmark"
        hint = "are the landmarks on the mesh of the shapes?"
        raise OptionError(Fault("FAC007", message, hint=hint))
    # Shapes with similar displacements are solved as one, and split evenly. Shapes with
    # in-betweens or correctives are solved separately.
    is_solved, representative_of_shape = _merge_shapes(model, is_moving)
    face = model.select(is_solved)
    representatives = representative_of_shape[is_moving]
    merged_counts = np.bincount(representatives, minlength=len(model.shapes))[is_solved]
    face = replace(face, deltas=face.deltas * merged_counts[:, None, None])
    usable_landmarks = np.where(is_usable[:, None, None], observed, np.nan)
    solver = _FaceSolver(face, usable_landmarks, fps, smooth, camera)
    weights, poses, residuals, robust_weights, rounds, change = solver.solve(progress)
    all_weights = np.zeros((len(observed), len(model.shapes)))
    columns = np.cumsum(is_solved) - 1
    all_weights[:, is_moving] = weights[:, columns[representative_of_shape[is_moving]]]
    rotations, translations = interpolate_poses(poses, is_usable)
    misplaced_counts = (robust_weights < MISPLACED_FRACTION).sum(axis=1)
    matching_counts = (robust_weights >= MISPLACED_FRACTION).sum(axis=1)
    is_poor = is_usable & (misplaced_counts > 0.5 * len(model.names))
    is_poor &= matching_counts < 0.5 * is_visible.sum(axis=1)
    status = np.where(is_poor, FrameStatus.POOR, FrameStatus.SOLVED)
    status = np.where(is_usable, status, "gap")
    head_points = None
    if camera is None:
        offsets = observed - translations[:, None]
        head_points = so3.rotate(so3.conjugate(rotations)[:, None], offsets)
    notices = _notices(
        model, is_visible, is_usable, is_poor, robust_weights, head_points
    )
    return FaceFit(
        model,
        all_weights,
        rotations,
        translations,
        residuals,
        robust_weights,
        tuple(FrameStatus(s) for s in status.tolist()),
        solver.noise,
        rounds,
        change,
        (*model.notices(), *notices),
    )


def _merge_shapes(model: FaceModel, is_moving: BoolArray) -> tuple[BoolArray, IntArray]:
    """Merge shapes with equal deltas, so that one of each group is solved.

    Return a mask of the solved shapes, and the solved shape that represents each
    shape, both ``(S,)``.
    """
    is_solved, representative_of_shape = is_moving.copy(), np.arange(len(is_moving))
    for a, b in model.similar_shapes() if model.nonlinear_shapes is None else ():
        distance = np.linalg.norm(model.deltas[a] - model.deltas[b])
        max_distance = MIN_LANDMARK_MOTION * np.linalg.norm(model.deltas[a])
        if representative_of_shape[a] == a and distance <= max_distance:
            representative_of_shape[b], is_solved[b] = a, False
    return is_solved, representative_of_shape


def _check_landmarks(
    model: FaceModel, observed: FloatArray, camera: FloatArray | None
) -> None:
    """Raise if landmarks do not match the face model in number, size or unit."""
    component_count = 3 if camera is None else 2
    shape = (len(model.names), component_count)
    if observed.ndim != 3 or observed.shape[1:] != shape or not len(observed):
        message = f"landmarks have shape {observed.shape}, but the face has "
        message += f"{counted(len(model.names), 'landmark')}: (F, {shape[0]}, "
        message += f"{component_count})"
        raise OptionError(Fault("FAC004", message))
    if len(model.names) < MIN_LANDMARKS:
        message = f"the face has {counted(len(model.names), 'landmark')}"
        hint = f"a pose and weights need at least {MIN_LANDMARKS}"
        raise OptionError(Fault("FAC004", message, hint=hint))
    if camera is not None or rms_spread(model.neutral) == 0:
        return
    is_visible: BoolArray = np.asarray(np.isfinite(observed).all(axis=-1))
    sampled_frames = np.flatnonzero(is_visible.sum(axis=1) >= MIN_LANDMARKS)
    sampled_frames = sampled_frames[:: max(1, len(is_visible) // 50)]
    ratios = [
        rms_spread(observed[f, is_visible[f]])
        / max(rms_spread(model.neutral[is_visible[f]]), 1e-300)
        for f in sampled_frames.tolist()
    ]
    ratio = float(np.median(ratios)) if ratios else 1.0
    if not 1 / MAX_SIZE_RATIO <= ratio <= MAX_SIZE_RATIO:
        message = f"the captured face is {plain_number(ratio)} times the size of the "
        message += "rig's"
        hint = f"set the unit of the landmarks with {argument('source.unit')}"
        for factor, (unit, unit_as_read) in UNITS_BY_FACTOR.items():
            if 1 / MAX_SIZE_RATIO < ratio / factor < MAX_SIZE_RATIO:
                message += f", as with {unit} that are read as {unit_as_read}"
                hint = f"set {argument('source.unit', unit)}, or write it in the name "
                hint += f"of the array: landmarks_{unit}"
                break
        raise OptionError(Fault("FAC006", message, hint=hint))


# Units by how many times too large they are if read as another.
UNITS_BY_FACTOR = {
    10.0: ("mm", "cm"),
    100.0: ("cm", "m"),
    1000.0: ("mm", "m"),
    0.1: ("cm", "mm"),
    0.01: ("m", "cm"),
    0.001: ("m", "mm"),
}


class _FaceSolver:
    """Fits a face's weights and poses: measures the noise, then solves all windows."""

    def __init__(
        self,
        face: FaceModel,
        observed: FloatArray,
        fps: float,
        smooth: float,
        camera: FloatArray | None,
    ) -> None:
        self.face, self.camera = face, camera
        self.observed = np.ascontiguousarray(observed, np.float64)
        self.deltas = np.ascontiguousarray(face.deltas)
        self.start_poses = self._initial_poses()
        # The image scale at the face's median distance [px/m].
        self.pixels_per_unit = 1.0
        if camera is not None:
            self.pixels_per_unit = float(camera[0] / np.median(self.start_poses[:, 6]))
        self.noise = self._measure_noise()
        speed = TYPICAL_SPEED / fps
        self.smooth = smooth * (self.noise / speed) ** 2
        self.rest_penalty = (self.noise / TYPICAL_WEIGHT) ** 2

    def _initial_poses(self) -> FloatArray:
        """Estimate initial head poses from landmarks or, with a camera, pixels."""
        if self.camera is None:
            return estimate_head_poses(self.face.neutral, self.observed)
        median_points = np.full(self.observed.shape[1:], np.nan)
        has_landmarks = np.isfinite(self.observed[..., 0]).any(axis=0)
        observed = self.observed[:, has_landmarks]
        median_points[has_landmarks] = np.nanmedian(observed, axis=0)
        pose = estimate_camera_pose(self.face.neutral, median_points, self.camera)
        if pose is None or not pose[6] > 0:
            message = "no face in the camera matches the rig's"
            hint = "are the landmarks in pixels of this camera, in the order of their "
            raise OptionError(Fault("FAC010", message, hint=f"{hint}names?"))
        return np.repeat(pose[None], len(self.observed), axis=0)

    def _run_kernel(
        self,
        frames: slice | FloatArray,
        threshold: float,
        smooth: float,
        max_rounds: int,
        neutral: FloatArray | None = None,
        start: tuple[FloatArray, FloatArray] | None = None,
    ) -> _FitResult:
        """Fit some frames with the kernel, from given weights and poses or from rest.

        Residuals above ``threshold`` [m] or [px] are downweighted.
        """
        observed = self.observed[frames]
        shape = (len(observed), len(self.face.shapes))
        weights, poses = start or (np.zeros(shape), self.start_poses[frames])
        neutral_points = self.face.neutral[None] if neutral is None else neutral
        return _kernels.fit_face(
            np.ascontiguousarray(neutral_points),
            self.deltas,
            np.ascontiguousarray(observed),
            self.camera,
            np.ascontiguousarray(poses),
            np.ascontiguousarray(weights),
            threshold,
            smooth,
            self.rest_penalty,
            CONVERGED_CHANGE,
            max_rounds,
            start is not None,
        )

    def _measure_noise(self) -> float:
        """Estimate landmark noise in one direction, [m] or [px], from single frames."""
        visible_frames = np.flatnonzero(np.isfinite(self.observed[..., 0]).any(axis=1))
        rows = np.linspace(0, len(visible_frames) - 1, NOISE_FRAMES).astype(int)
        frames = np.unique(visible_frames[rows])
        min_noise = MIN_NOISE * self.face.size * self.pixels_per_unit
        self.rest_penalty = (min_noise * 10 / TYPICAL_WEIGHT) ** 2
        threshold = 0.1 * self.face.size * self.pixels_per_unit
        noise = min_noise
        for _ in range(3):
            weights, _, residuals, *_ = self._run_kernel(frames, threshold, 0.0, 6)
            is_visible = np.isfinite(residuals)
            width = self.observed.shape[-1]
            residual_count = width * is_visible.sum()
            # Each pose, and each weight inside its bounds, takes one residual.
            parameter_count = 6 * len(frames) + ((weights > 0) & (weights < 1)).sum()
            free_fraction = max(1.0 - parameter_count / max(residual_count, 1), 0.05)
            unit_median = MEDIAN_LENGTH_3D if width == 3 else MEDIAN_LENGTH_2D
            typical_residual = float(np.median(residuals[is_visible])) / unit_median
            noise = max(typical_residual / np.sqrt(free_fraction), min_noise)
            threshold = ROBUST_DEVIATIONS * noise
        return noise

    def solve(self, progress: Callable[[float], None] | None) -> _FitResult:
        """Solve the take in overlapping windows, and join their middle frames."""
        frame_count, landmark_count = self.observed.shape[:2]
        widths = (len(self.face.shapes), 7, landmark_count, landmark_count)
        outputs = [np.zeros((frame_count, width)) for width in widths]
        rounds, change = 0, 0.0
        for first in range(0, frame_count, WINDOW_FRAMES):
            begin = max(0, first - OVERLAP_FRAMES)
            end = min(frame_count, first + WINDOW_FRAMES + OVERLAP_FRAMES)
            result = self._solve_window(slice(begin, end))
            output_frames = slice(first, min(frame_count, first + WINDOW_FRAMES))
            window_rows = slice(first - begin, output_frames.stop - begin)
            for output, values in zip(outputs, result[:4], strict=True):
                output[output_frames] = values[window_rows]
            rounds, change = max(rounds, result[4]), max(change, result[5])
            if progress is not None:
                progress(output_frames.stop / frame_count)
        weights, poses, residuals, robust_weights = outputs
        return weights, poses, residuals, robust_weights, rounds, change

    def _solve_window(self, frames: slice) -> _FitResult:
        """Solve one window; iterate if the face has in-betweens or correctives."""
        threshold = ROBUST_DEVIATIONS * self.noise
        result = self._run_kernel(frames, threshold, self.smooth, MAX_ROUNDS)
        if self.face.nonlinear_shapes is None:
            return result
        for _ in range(MAX_NONLINEAR_ROUNDS):
            weights, poses = result[0], result[1]
            neutral = self.face.neutral + self.face.nonlinear_offsets(weights)
            result = self._run_kernel(
                frames, threshold, self.smooth, MAX_ROUNDS, neutral, (weights, poses)
            )
            if np.abs(result[0] - weights).max() < NONLINEAR_CONVERGED_CHANGE:
                break
        return result


def _notices(
    model: FaceModel,
    is_visible: BoolArray,
    is_usable: BoolArray,
    is_poor: BoolArray,
    robust_weights: FloatArray,
    head_points: FloatArray | None,
) -> list[Fault]:
    """Return warnings about gaps, poor frames and misplaced landmarks (FAC103-105).

    ``head_points`` ``(F, N, 3)``: The observed landmarks in the frame of the head.
    """
    notices = []
    for is_affected, code, problem in (
        (~is_usable, "FAC103", f"fewer than {MIN_LANDMARKS} landmarks"),
        (is_poor, "FAC104", "landmarks that are mostly outliers"),
    ):
        frames = np.flatnonzero(is_affected).tolist()
        if frames:
            verb = "has" if len(frames) == 1 else "have"
            message = f"{counted(len(frames), 'frame')} {verb} {problem}"
            if code == "FAC103":
                verb = "is" if len(frames) == 1 else "are"
                message += f" and {verb} interpolated"
            message += f": {listed(frames, MAX_LISTED_FRAMES)}"
            hint = "track the face again in these frames"
            notices.append(Fault(code, message, hint=hint, severity=Severity.WARNING))
    is_used = is_visible & is_usable[:, None]
    used_counts = is_used.sum(axis=0)
    misplaced_counts = (is_used & (robust_weights < MISPLACED_FRACTION)).sum(axis=0)
    is_misplaced = misplaced_counts > MISPLACED_FRACTION * np.maximum(used_counts, 1)
    landmark_problems = (
        (list(compress(model.names, used_counts == 0)), ("is", "are"), "never seen"),
        (
            list(compress(model.names, is_misplaced)),
            ("does", "do"),
            "not match the face in most frames",
        ),
    )
    for names, verbs, problem in landmark_problems:
        if names:
            verb = verbs[len(names) > 1]
            message = f"{counted(len(names), 'landmark')} {verb} {problem}: "
            fault = names_fault("FAC105", message, names, severity=Severity.WARNING)
            notices.append(fault)
    if head_points is not None and is_misplaced.any():
        swap_hint = _swap_hint(model, head_points[is_usable], is_misplaced)
        notices[-1] = replace(notices[-1], hint=swap_hint)
    return notices


def _swap_hint(
    model: FaceModel, head_points: FloatArray, is_misplaced: BoolArray
) -> str | None:
    """Return a hint to swap misplaced landmarks that are at each other's position.

    ``head_points`` ``(F, N, 3)`` are the observed landmarks in the frame of the head.
    """
    misplaced_landmarks = np.flatnonzero(is_misplaced)
    neutral = model.neutral[misplaced_landmarks]
    median_points = np.nanmedian(head_points[:, misplaced_landmarks], axis=0)
    distances = np.linalg.norm(median_points[:, None] - neutral[None], axis=-1)
    nearest = distances.argmin(axis=1)
    spacing = np.linalg.norm(neutral[:, None] - neutral[None], axis=-1)
    names = [model.names[n] for n in misplaced_landmarks]
    pairs = [
        f"{names[i]!r} and {names[j]!r}"
        for i, j in enumerate(nearest.tolist())
        if i < j
        and nearest[j] == i
        and max(distances[i, j], distances[j, i]) < SWAP_DISTANCE * spacing[i, j]
    ]
    return f"exchange {listed(pairs)}" if pairs else None
