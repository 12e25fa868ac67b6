"""A trial: the settings of a simulation, and distances between its runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.sim.system import Energy
from animtool.sim.trajectory import Status

# Factors of the chosen step: for settings to try, and for reference runs.
STEP_FACTORS = (4.0, 2.0, 1.0, 0.5)
REFERENCE_FACTORS = (0.5, 0.25, 0.125)


@dataclass(frozen=True, slots=True)
class Setting:
    """A method with its options."""

    method: str  # name of an integrator or solver
    # Options by name, in the notation of the scene file.
    options: tuple[tuple[str, float], ...]
    json_keys: ClassVar[str] = "method options=by_name"

    @property
    def by_name(self) -> dict[str, float]:
        """The options, by name."""
        return dict(self.options)

    @staticmethod
    def of(method: str, **options: float) -> Setting:
        """Return a method with its options.

        >>> Setting.of("rk4", step=0.01)["step"]
        0.01
        """
        return Setting(str(method), tuple(options.items()))

    def __getitem__(self, name: str) -> float:
        """Return the value of an option by name."""
        return dict(self.options)[name]

    def __str__(self) -> str:
        """Return the setting in the notation of scene files.

        >>> str(Setting.of("rk4", step=0.01))
        'rk4, step 0.01'
        """
        options = [f"{name} {value:.6g}" for name, value in self.options]
        return ", ".join([self.method, *options])


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The points of a run at one time."""

    points: FloatArray  # (N, 3) [m]
    # Point ids, ascending (N,); None if constant.
    ids: IntArray | None = None
    orientations: FloatArray | None = None  # x, y, z, w (N, 4); None for plain points
    reach: float = 0.0  # largest extent of instances from their point [m]


class Figure(StrEnum):
    """A scalar quantity measured in a run in addition to its points."""

    STRETCH = "stretch"  # largest spring elongation over its rest length [1]
    DEPTH = "depth"  # largest penetration of cloth [m]
    PIERCED = "pierced"  # largest number of edge-face pairs that intersect
    MISS = "miss"  # largest distance to a position target [m]
    MISS_ANGLE = "miss_angle"  # of orientations, aims and poles [rad]
    REACHED = "reached"  # fraction of frames that reach every target [1]


class ErrorMeasure(StrEnum):
    """The distance that counts as a setting's error."""

    LARGEST = "largest"
    RMS = "rms"


class CostMeasure(StrEnum):
    """The measure of cost: time, file size, or counted work."""

    SECONDS = "seconds"
    BYTES = "bytes"
    STEPS = "steps"


@dataclass(frozen=True, slots=True)
class TrialOutcome:
    """Time, status, points and figures of a run with one setting."""

    seconds: float  # wall time of the simulation [s]
    steps: int  # number of steps
    snapshots: Sequence[Snapshot]  # points at the times reached
    status: Status = Status.OK  # how the run ended
    reason: str = ""  # why the run stopped; empty on success
    # The largest stable step at the end [s]: 0 if none, infinite if all, None if
    # unknown.
    stable_step: float | None = None
    # Energies at these times; None if energy is not conserved.
    energies: Sequence[Energy] | None = None
    bytes: int = 0  # size of the output; 0 if there is none
    # Additional measured figures of the run.
    figures: Mapping[Figure, float] = field(default_factory=dict)
    # The setting's error, if measured directly instead of from snapshots.
    error: PointDistances | None = None
    worst: str = ""  # location of the largest error


@dataclass(frozen=True, slots=True)
class Trial:
    """A simulation that can be run under several settings."""

    name: str
    kind: str  # `particles`, `cloth`, `ik`
    span: float  # duration, with pre-roll [s]
    chosen_setting: Setting  # setting of the file
    # Settings to try, per method from coarse to fine.
    settings: Callable[[], list[Setting]]
    # Candidates for the reference: each a method with successively halved steps. The
    # first one whose runs succeed is used.
    references: Callable[[], list[list[Setting]]]
    # Runs a setting; raises `OptionError` if the method does not apply.
    run: Callable[[Setting], TrialOutcome]
    # Error that settings are ranked by.
    error_measure: ErrorMeasure = ErrorMeasure.RMS
    cost_measure: CostMeasure = CostMeasure.SECONDS
    unit: str = "steps"  # unit of the counted work
    # Name and time of a point of a snapshot; None if points have no names.
    point_label: Callable[[int, int], str] | None = None
    # Keys of the file entry that request a setting; None if there is no entry.
    changed_keys: Callable[[Setting], Mapping[str, Any]] | None = None
    # How to request a setting: scene file lines, or command options.
    request_lines: Callable[[Setting], list[str]] | None = None
    # Writes a setting's result as USD for viewing; None if unavailable.
    write: Callable[[Setting, Path], None] | None = None
    size: float = 0.0  # size of the written figure [m]; 0 is unknown
    notices: tuple[Fault, ...] = ()  # warnings


def rounded_multiples(
    value: float, factors: Sequence[float] = STEP_FACTORS
) -> list[float]:
    """Return multiples of a value, rounded to 12 digits.

    >>> rounded_multiples(0.03)
    [0.12, 0.06, 0.03, 0.015]
    """
    return [
        value if factor == 1 else float(f"{value * factor:.12g}") for factor in factors
    ]


def step_settings(
    method: str, step: float, factors: Sequence[float] = STEP_FACTORS
) -> list[Setting]:
    """Return settings of a method with multiples of a step [s]."""
    steps = rounded_multiples(step, factors)
    return [Setting.of(method, step=multiple) for multiple in steps]


@dataclass(frozen=True, slots=True)
class PointDistances:
    """Distances between the points of two runs, over all times."""

    largest: float  # largest distance [m]
    rms: float  # root mean square distance [m]
    median: float  # median distance [m]
    unmatched: float = 0.0  # fraction of points in only one of the two runs [1]
    # Root mean square of angles between orientations [rad]; None if there are none.
    angle: float | None = None
    # Snapshot and point of the largest distance.
    worst_at: tuple[int, int] | None = None
    json_keys: ClassVar[str] = "largest rms median apart=unmatched angle?"

    def error(self, measure: ErrorMeasure, reach: float) -> float:
        """Return the distance [m] that counts as the error, rotations included.

        Args:
            measure: Distance that counts as the error.
            reach: Distance from the points at which rotations are measured [m].
        """
        distance = self.largest if measure is ErrorMeasure.LARGEST else self.rms
        return distance + (0.0 if self.angle is None else self.angle * reach)

    def scaled_by(self, factor: float) -> PointDistances:
        """Return the distances multiplied by a factor."""
        return PointDistances(
            self.largest * factor,
            self.rms * factor,
            self.median * factor,
            self.unmatched,
            None if self.angle is None else self.angle * factor,
            self.worst_at,
        )


def run_distances(
    references: Sequence[Snapshot], snapshots: Sequence[Snapshot]
) -> PointDistances:
    """Return distances between snapshots at the same times.

    Points are compared by their ids.

    >>> true_rotations = Snapshot(np.zeros((2, 3)))
    >>> rotations = Snapshot(np.array([[0, 0, 3.0], [0, 4, 0]]))
    >>> run_distances([true_rotations], [rotations]).largest
    4.0
    """
    distance_arrays, unmatched, count = [np.zeros(0)], 0, 0
    angles: list[FloatArray] = []
    largest_distance, worst_at = -1.0, None
    for k, (reference, snapshot) in enumerate(zip(references, snapshots, strict=True)):
        a, b = reference.points, snapshot.points
        true_rotations, rotations = reference.orientations, snapshot.orientations
        if reference.ids is not None and snapshot.ids is not None:
            _, i, j = np.intersect1d(
                reference.ids, snapshot.ids, assume_unique=True, return_indices=True
            )
            unmatched += len(a) + len(b) - 2 * len(i)
            count += len(a) + len(b) - len(i)
            a, b, point_indices = a[i], b[j], i
            true_rotations = None if true_rotations is None else true_rotations[i]
            rotations = None if rotations is None else rotations[j]
        else:
            count += len(a)
            point_indices = np.arange(len(a))
        point_distances = np.linalg.norm(b - a, axis=1)
        if len(point_distances) and point_distances.max() > largest_distance:
            farthest = int(point_distances.argmax())
            largest_distance = float(point_distances[farthest])
            worst_at = (k, int(point_indices[farthest]))
        distance_arrays.append(point_distances)
        if true_rotations is not None and rotations is not None:
            angles.append(so3.angle_between(true_rotations, rotations))
    all_distances: FloatArray = np.concatenate(distance_arrays)
    angle = _rms(np.concatenate(angles)) if angles else None
    if not len(all_distances):
        return PointDistances(0.0, 0.0, 0.0, unmatched / max(count, 1), angle)
    largest, median = float(all_distances.max()), float(np.median(all_distances))
    return PointDistances(
        largest, _rms(all_distances), median, unmatched / count, angle, worst_at
    )


def _rms(values: FloatArray) -> float:
    """Return the root mean square of values ``(N,)``, 0 if empty."""
    # Squares of diverged values overflow.
    with np.errstate(over="ignore"):
        return math.sqrt(float(np.mean(values**2))) if len(values) else 0.0


def points_extent(snapshots: Sequence[Snapshot]) -> float:
    """Return the diagonal of the bounding box of the points at all times [m]."""
    point_arrays = [snapshot.points for snapshot in snapshots if len(snapshot.points)]
    if not point_arrays:
        return 0.0
    low = np.min([points.min(axis=0) for points in point_arrays], axis=0)
    high = np.max([points.max(axis=0) for points in point_arrays], axis=0)
    return float(np.linalg.norm(high - low))


def max_instance_extent(snapshots: Sequence[Snapshot]) -> float:
    """Return the largest extent of an instance from its point, over all times [m]."""
    return max((snapshot.reach for snapshot in snapshots), default=0.0)


def observed_order(coarse: float, fine: float) -> float | None:
    """Return the observed order of convergence; None if undefined.

    ``coarse`` is the change of the motion when steps are halved, ``fine`` the change
    when they are halved again [m].

    >>> observed_order(0.4, 0.1)
    2.0
    """
    if not (coarse > 0 and fine > 0 and math.isfinite(coarse / fine)):
        return None
    return math.log2(coarse / fine)
