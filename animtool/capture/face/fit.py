"""The result of a face solve: weights and head poses over frames, and their fit."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from animtool.capture.face.model import FaceModel
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass

# A landmark with less than half weight in this fraction of frames is misplaced.
MISPLACED_FRACTION = 0.5


class FrameStatus(StrEnum):
    """Whether a frame was solved, interpolated or fits poorly."""

    SOLVED = "solved"
    GAP = "gap"  # too few landmarks: weights and pose are interpolated
    POOR = "poor"  # more than half of the landmarks are outliers


@dataclass(frozen=True, slots=True)
class LandmarkScore:
    """Residual and weight of a landmark over the frames."""

    name: str  # of the landmark
    rms: float  # root mean square residual where its weight is at least one half
    seen: int  # frames in which it is visible
    outliers: int  # visible frames in which its weight is below one half


@dataclass(frozen=True, slots=True)
class ShapePeak:
    """Largest weight of a shape over all frames."""

    name: str  # of the shape
    max: float  # its largest weight


@dataclass(frozen=True, slots=True)
class FaceFit:
    """Blend-shape weights and head poses over frames, and their residuals.

    Attributes:
        model: The face.
        weights: Weights of its shapes, 0 to 1 ``(F, S)``.
        rotations: Rotations of the head, world from face ``(F, 4)``.
        translations: Translations of the head [m] ``(F, 3)``.
        residuals: Distance of landmarks from the face in [m], or [px] of a camera ``(F,
            N)``; NaN where missing.
        shares: Robust weight of each landmark, 0 to 1 ``(F, N)``.
        status: Status of each frame.
        noise: Standard deviation of the noise in one direction, in the unit of the
            residuals.
        rounds: Rounds of the slowest window.
        change: Largest change of a weight in the last round of a window.
        notices: Warnings.
    """

    model: FaceModel
    weights: FloatArray
    rotations: FloatArray
    translations: FloatArray
    residuals: FloatArray
    shares: FloatArray
    status: tuple[FrameStatus, ...]
    noise: float
    rounds: int
    change: float
    notices: tuple[Fault, ...] = ()

    @property
    def rms(self) -> float:
        """Root mean square residual of landmarks with weight of at least one half."""
        is_inlier = (self.shares >= MISPLACED_FRACTION) & np.isfinite(self.residuals)
        if is_inlier.any():
            return float(np.sqrt((self.residuals[is_inlier] ** 2).mean()))
        return 0.0

    @property
    def landmarks(self) -> list[LandmarkScore]:
        """Root mean square residual and outlier count of each landmark."""
        is_visible = np.isfinite(self.residuals)
        is_inlier = is_visible & (self.shares >= MISPLACED_FRACTION)
        squared_residuals = np.where(is_inlier, self.residuals, 0.0) ** 2
        rms = np.sqrt(
            squared_residuals.sum(axis=0) / np.maximum(is_inlier.sum(axis=0), 1)
        )
        visible_and_outlier_counts = (
            is_visible.sum(axis=0),
            (is_visible & ~is_inlier).sum(axis=0),
        )
        columns = (
            rms.tolist(),
            *(column.tolist() for column in visible_and_outlier_counts),
        )
        return [
            LandmarkScore(*row) for row in zip(self.model.names, *columns, strict=True)
        ]

    @property
    def peaks(self) -> list[ShapePeak]:
        """Largest weight of each shape over all frames; 0 if it is never positive."""
        maxima = self.weights.max(axis=0, initial=0.0).tolist()
        return [ShapePeak(*row) for row in zip(self.model.shapes, maxima, strict=True)]
