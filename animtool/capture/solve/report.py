"""How well markers were solved."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from animtool.capture.solve.model import MIN_MARKERS
from animtool.capture.solve.sampling import ROBUST
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths.runs import runs

# Share of a frame's markers that must fit for it not to be poor.
MIN_FITTED = 0.5


@dataclass(frozen=True, slots=True)
class MarkerScore:
    """How well one marker fits.

    Attributes:
        name: In the template.
        rms: How far it is off its place on the bone [m], outliers left out; NaN where
            it is never seen.
        seen: Share of frames in which it has a position.
        outliers: Share of these in which that is none of the marker's.
    """

    name: str
    rms: float
    seen: float
    outliers: float


@dataclass(frozen=True, slots=True)
class ExchangedLabels:
    """Frames in which a marker has the position of another label.

    Attributes:
        marker: The marker.
        label: The name that the capture has there.
        first: Index of the first frame.
        last: Index of the last one.
    """

    marker: str
    label: str
    first: int
    last: int


@dataclass
class SolveScore:
    """How well the markers of F frames fit; complete when all are solved.

    Attributes:
        names: Of the E markers.
        frames: F.
        noise: How far each marker is off as a rule ``(E,)`` [m].
        rms: Over the markers of each frame that fit ``(F,)`` [m], NaN without any.
        sparse: Frames with fewer than 3 markers, by index.
        poor: Frames most of whose markers do not fit, by index.
        searched: Frames that were looked for anew, by index.
        markers: By marker.
        exchanged: Labels that were mixed up.
        total: Over all markers that fit [m].
    """

    names: list[str]
    frames: int
    noise: FloatArray
    rms: FloatArray = field(init=False)
    sparse: IntArray = field(init=False)
    poor: IntArray = field(init=False)
    searched: IntArray = field(init=False)
    markers: list[MarkerScore] = field(init=False, default_factory=list)
    exchanged: list[ExchangedLabels] = field(init=False, default_factory=list)
    total: float = field(init=False, default=float("nan"))
    _misses: FloatArray = field(init=False, repr=False)
    _taken: IntArray = field(init=False, repr=False)
    _visible: BoolArray = field(init=False, repr=False)
    _begun: BoolArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Make room for the frames."""
        shape = self.frames, len(self.names)
        self._misses = np.zeros(shape)
        self._taken = np.broadcast_to(np.arange(shape[1]), shape).copy()
        self._visible = np.zeros(shape, np.bool_)
        self._begun = np.zeros(shape[0], np.bool_)

    def add(
        self,
        first: int,
        misses: FloatArray,
        taken: IntArray,
        searched: BoolArray,
        visible: BoolArray,
    ) -> None:
        """Note what was found of some frames ``(N, E)``, from one on."""
        rows = slice(first, first + len(misses))
        self._misses[rows], self._taken[rows] = misses, taken
        self._begun[rows], self._visible[rows] = searched, visible

    def finish(self) -> None:
        """Sum up."""
        indices = np.arange(len(self.names))
        # A marker that took the position of another label has one.
        has = np.where(
            self._taken == indices,
            self._visible,
            (self._taken >= 0) & (self._taken != indices),
        )
        fits = has & (self._misses <= ROBUST * self.noise)
        squares = np.where(fits, self._misses**2, 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            self.rms = np.sqrt(squares.sum(axis=1) / fits.sum(axis=1))
            by_marker = np.sqrt(squares.sum(axis=0) / fits.sum(axis=0))
            self.total = float(np.sqrt(squares.sum() / fits.sum()))
        counts = has.sum(axis=1)
        self.sparse = np.flatnonzero(counts < MIN_MARKERS)
        lost = fits.sum(axis=1) < MIN_FITTED * counts
        self.poor = np.flatnonzero((counts >= MIN_MARKERS) & lost)
        self.searched = np.flatnonzero(self._begun)
        self.markers = [
            MarkerScore(
                name,
                float(by_marker[e]),
                float(self._visible[:, e].mean()),
                1.0 - float(fits[:, e].sum()) / max(int(has[:, e].sum()), 1),
            )
            for e, name in enumerate(self.names)
        ]
        self.exchanged = [
            ExchangedLabels(self.names[e], self.names[label], first, end - 1)
            for e in indices.tolist()
            for label in np.unique(self._taken[:, e]).tolist()
            if label not in (e, -1)
            for first, end in runs(self._taken[:, e] == label)
        ]
