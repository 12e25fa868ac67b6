"""Scores of a marker solve: residuals and outliers by marker and frame."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from animtool.capture.solve.model import MIN_MARKERS
from animtool.capture.solve.sampling import ROBUST_DEVIATIONS
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths.runs import runs

# A frame is poor if a smaller fraction of its markers fits.
MIN_FITTED_FRACTION = 0.5


@dataclass(frozen=True, slots=True)
class MarkerScore:
    """Residuals and outliers of one marker."""

    name: str  # name in the template
    # Distance from its position on the bone [m], without outliers; NaN if it is never
    # visible.
    rms: float
    seen: float  # fraction of frames in which it has a position
    outliers: float  # fraction of these frames in which the position is an outlier


@dataclass(frozen=True, slots=True)
class SwappedLabels:
    """Frames in which a marker has the position of another label."""

    marker: str  # the marker
    label: str  # the name that the capture has there
    first: int  # index of the first frame
    last: int  # index of the last one


@dataclass
class SolveScore:
    """Residuals of the markers over F frames; complete when all frames are solved."""

    names: list[str]  # names of the E markers
    frames: int  # F
    noise: FloatArray  # typical deviation of each marker ``(E,)`` [m]
    # Root mean square residual of the fitting markers of each frame ``(F,)`` [m], NaN
    # if there are none.
    rms: FloatArray = field(init=False)
    sparse: IntArray = field(init=False)  # frames with fewer than 3 markers, by index
    # Frames most of whose markers do not fit, by index.
    poor: IntArray = field(init=False)
    searched: IntArray = field(init=False)  # frames with a second search, by index
    # Fit by marker.
    markers: list[MarkerScore] = field(init=False, default_factory=list)
    # Swapped labels.
    swapped: list[SwappedLabels] = field(init=False, default_factory=list)
    # Root mean square residual over all fitting markers [m].
    total: float = field(init=False, default=float("nan"))
    _residuals: FloatArray = field(init=False, repr=False)
    _target_indices: IntArray = field(init=False, repr=False)
    _is_visible: BoolArray = field(init=False, repr=False)
    _is_restarted: BoolArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Allocate arrays for the residuals of all frames, filled by `add`."""
        array_shape = self.frames, len(self.names)
        self._residuals = np.zeros(array_shape)
        self._target_indices = np.broadcast_to(
            np.arange(array_shape[1]), array_shape
        ).copy()
        self._is_visible = np.zeros(array_shape, np.bool_)
        self._is_restarted = np.zeros(array_shape[0], np.bool_)

    def add(
        self,
        first: int,
        residuals: FloatArray,
        target_indices: IntArray,
        is_restarted: BoolArray,
        is_visible: BoolArray,
    ) -> None:
        """Record the fits ``(N, E)`` of N frames, the first of which is ``first``."""
        frames = slice(first, first + len(residuals))
        self._residuals[frames], self._target_indices[frames] = (
            residuals,
            target_indices,
        )
        self._is_restarted[frames], self._is_visible[frames] = is_restarted, is_visible

    def finish(self) -> None:
        """Compute the scores of markers and frames once all frames are added."""
        marker_indices = np.arange(len(self.names))
        # A marker with the position of another label counts as visible.
        is_visible = np.where(
            self._target_indices == marker_indices,
            self._is_visible,
            (self._target_indices >= 0) & (self._target_indices != marker_indices),
        )
        is_fitting = is_visible & (self._residuals <= ROBUST_DEVIATIONS * self.noise)
        squared_residuals = np.where(is_fitting, self._residuals**2, 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            self.rms = np.sqrt(squared_residuals.sum(axis=1) / is_fitting.sum(axis=1))
            marker_rms = np.sqrt(squared_residuals.sum(axis=0) / is_fitting.sum(axis=0))
            self.total = float(np.sqrt(squared_residuals.sum() / is_fitting.sum()))
        marker_counts = is_visible.sum(axis=1)
        self.sparse = np.flatnonzero(marker_counts < MIN_MARKERS)
        is_poor = is_fitting.sum(axis=1) < MIN_FITTED_FRACTION * marker_counts
        self.poor = np.flatnonzero((marker_counts >= MIN_MARKERS) & is_poor)
        self.searched = np.flatnonzero(self._is_restarted)
        self.markers = [
            MarkerScore(
                name,
                float(marker_rms[e]),
                float(self._is_visible[:, e].mean()),
                1.0
                - float(is_fitting[:, e].sum()) / max(int(is_visible[:, e].sum()), 1),
            )
            for e, name in enumerate(self.names)
        ]
        self.swapped = [
            SwappedLabels(self.names[e], self.names[label], first, end - 1)
            for e in marker_indices.tolist()
            for label in np.unique(self._target_indices[:, e]).tolist()
            if label not in (e, -1)
            for first, end in runs(self._target_indices[:, e] == label)
        ]
