"""The table of a trial: its settings, with the results of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import ClassVar

from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.sim.trajectory import Status
from animtool.sim.trials.trial import (
    CostMeasure,
    ErrorMeasure,
    Figure,
    PointDistances,
    Setting,
)


@dataclass(frozen=True, slots=True)
class Reference:
    """The run that all other runs are compared with."""

    setting: Setting  # the setting of the reference run
    error: PointDistances  # error estimate of the reference, from the two finest runs
    # Observed order of convergence, from the three finest runs; None if they are equal.
    order: float | None
    # Whether the motion is chaotic: halving the step hardly reduces the difference.
    sensitive: bool
    json_keys: ClassVar[str] = "*setting error order sensitive"


@dataclass(frozen=True, slots=True)
class TrialRow:
    """A setting, with the results of its run."""

    setting: Setting  # setting of the run
    # Wall time of the simulation [s]; 0 if the method does not apply.
    seconds: float = 0.0
    steps: int = 0  # number of steps
    status: Status | None = None  # how the run ended; None if the method does not apply
    # Why the run stopped or the method does not apply; empty on success.
    reason: str = ""
    stable_step: float | None = None  # as in `TrialOutcome`
    # Distances from the reference; None after an early stop or without a reference.
    error: PointDistances | None = None
    # Largest energy change, relative to the largest energy [1]; None if not conserved.
    energy_drift: float | None = None
    bytes: int = 0  # as in `TrialOutcome`
    # As in `TrialOutcome`; empty if the run stopped early.
    figures: Mapping[Figure, float] = field(default_factory=dict)
    worst: str = ""  # location of the largest distance; may be empty
    chosen: bool = False  # whether the file requests this setting
    is_pareto_optimal: bool = False  # whether no cheaper setting is as accurate
    # Whether the setting is recommended, or the cheapest within a budget.
    recommended: bool = False
    json_keys: ClassVar[str] = (
        "*setting status=ended reason stable_step seconds~ steps bytes "
        "error energy_drift figures worst chosen best=is_pareto_optimal recommended"
    )

    @property
    def ended(self) -> str:
        """How the run ended, in words."""
        if self.status is None:
            return "left out"
        return "blew up" if self.status == "unstable" else str(self.status)


@dataclass(frozen=True, slots=True)
class TrialTable:
    """The results of all settings of a trial."""

    name: str  # name of the simulation
    kind: str  # kind of simulation
    span: float  # simulated time [s]
    instants: int  # number of compared times
    points: int  # largest number of points
    extent: float  # diagonal of the bounding box [m]
    # The reference; None if every fine run stopped early.
    reference: Reference | None
    rows: list[TrialRow]  # results of the settings, in the order tried
    notices: list[Fault] = field(default_factory=list)  # warnings
    error: ErrorMeasure = ErrorMeasure.RMS  # the error that rows are ranked by
    cost: CostMeasure = CostMeasure.SECONDS
    unit: str = "steps"  # unit of the counted work
    budget: float | None = None  # largest acceptable error [m]
    # How to request the recommended setting; empty if none.
    lines: tuple[str, ...] = ()
    reach: float = 0.0  # largest extent of instances from their points [m]
    json_keys: ClassVar[str] = (
        "name kind span instants points extent measure=error cost unit lines reference "
        "rows"
    )

    def error_of(self, row: TrialRow | Reference) -> float | None:
        """Return a row's error, rotations included [m]; None if unknown."""
        return None if row.error is None else row.error.error(self.error, self.reach)

    @property
    def chosen(self) -> TrialRow:
        """The row of the file's setting."""
        return next(row for row in self.rows if row.chosen)

    @property
    def recommended(self) -> TrialRow | None:
        """The recommended row; None if the chosen setting is best, or unknown."""
        return next((row for row in self.rows if row.recommended), None)

    @property
    def applicable(self) -> list[TrialRow]:
        """The rows of settings whose method supports the system."""
        return [row for row in self.rows if row.status is not None]

    @property
    def by_rms(self) -> bool:
        """Whether errors are root-mean-square distances, not the largest one."""
        return self.error is ErrorMeasure.RMS

    @property
    def has_unmatched(self) -> bool:
        """Whether any run has points that do not match those of the reference."""
        return any(
            row.error is not None and row.error.unmatched for row in self.applicable
        )
