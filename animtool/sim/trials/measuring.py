"""Measurement of all settings of a trial against a reference run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from itertools import pairwise
from typing import ClassVar

import numpy as np

from animtool.core.errors import Fault, OptionError, warning
from animtool.core.quantities import length_text
from animtool.core.record import dataclass
from animtool.sim.system import Energy
from animtool.sim.trajectory import Status
from animtool.sim.trials.costs import Cost, best_of, cheapest_of, recommended_of
from animtool.sim.trials.trial import (
    CostMeasure,
    ErrorMeasure,
    Figure,
    PointDistances,
    Setting,
    Trial,
    TrialOutcome,
    distances,
    extent_of,
    observed_order,
    reach_of,
)

# If halving the step reduces the difference by less than this power, the run is
# chaotic.
MIN_ORDER = 0.5
# Differences below these, relative to the extent, are rounding or invisible, and do not
# make a run chaotic.
ROUNDING, UNSEEN = 1e-13, 1e-6
# Larger errors, relative to the extent, mean that the run has diverged.
FAR = 10.0
# Likewise for the fraction of points that only one of two runs has.
MAX_UNMATCHED = 0.5
# The accepted error if the chosen setting diverges, relative to the extent.
FALLBACK_TOLERANCE = 0.01
# Short runs are repeated within this time, up to this often, and the shortest counts
# [s].
SHORT, REPEATS = 0.3, 3
# Finer settings of a method are skipped once it took this many times as long as the
# reference.
TOO_SLOW = 10.0
# Smaller differences of figures do not count: fractions, metres and pairs.
FIGURE_TOLERANCES = {Figure.STRETCH: 1e-3, Figure.DEPTH: 1e-4, Figure.PIERCED: 1.0}
ENERGY_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True)
class Reference:
    """The run that others are compared with."""

    setting: Setting  # the setting of the reference run
    error: PointDistances  # error estimate of the reference, from the two finest runs
    # Observed order of convergence, from the three finest runs; None if they are equal.
    order: float | None
    # Whether the motion is chaotic: halving the step hardly reduces the difference.
    sensitive: bool
    json_keys: ClassVar[str] = "*setting error order sensitive"


@dataclass(frozen=True, slots=True)
class TrialRow:
    """A setting and its results."""

    setting: Setting  # the tried setting
    # Wall time of the simulation [s]; 0 if the method does not apply.
    seconds: float = 0.0
    steps: int = 0  # number of steps
    status: Status | None = None  # how it ended; None if the method does not apply
    # Why it stopped or does not apply; empty on success.
    reason: str = ""
    stable_step: float | None = None  # as in `Outcome`
    # Distances from the reference; None if it stopped early or there is no reference.
    error: PointDistances | None = None
    # Largest energy change, relative to the largest energy [1]; None if not conserved.
    energy_drift: float | None = None
    bytes: int = 0  # as in `Outcome`
    # As in `TrialOutcome`; empty if it stopped early.
    figures: Mapping[Figure, float] = field(default_factory=dict)
    worst: str = ""  # where the largest distance is; may be empty
    chosen: bool = False  # whether the file uses it
    best: bool = False  # whether no cheaper setting is as accurate
    # Whether it is recommended, or the cheapest within a budget.
    recommended: bool = False
    json_keys: ClassVar[str] = (
        "*setting status=ended reason stable_step seconds~ steps bytes "
        "error energy_drift figures worst chosen best recommended"
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

    name: str  # what it is called
    kind: str  # what it is
    span: float  # how long it was simulated [s]
    instants: int  # number of compared times
    points: int  # largest number of points
    extent: float  # diagonal of the bounding box [m]
    # The reference; None if every fine run stopped early.
    reference: Reference | None
    rows: list[TrialRow]  # in the order tried
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
        """The recommended row; None if the chosen one is best, or unknown."""
        return next((row for row in self.rows if row.recommended), None)

    @property
    def tried(self) -> list[TrialRow]:
        """The rows of settings that the trial offers."""
        return [row for row in self.rows if row.status is not None]

    @property
    def by_rms(self) -> bool:
        """Whether errors are root mean squares, not the largest distance."""
        return self.error is ErrorMeasure.RMS

    @property
    def has_lone(self) -> bool:
        """Whether some compared runs have unmatched points."""
        return any(row.error is not None and row.error.unmatched for row in self.tried)


def measure(
    trial: Trial,
    *,
    budget: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> TrialTable:
    """Run all settings of a trial, and measure each.

    Args:
        trial: What, and which ways there are.
        budget: The largest error that will do [m]: then the cheapest within is
            recommended. None recommends what is as exact as the chosen one, and
            cheaper.
        progress: Called with the share done, 0 to 1.

    Raises:
        OptionError: Something makes no sense, whatever the setting.
    """
    settings = list(dict.fromkeys([*trial.settings(), trial.chosen]))
    count = len({*settings, *trial.references()[0]})
    runs = _Runs(trial, count, progress)
    reference, truth = _reference(trial, runs)
    rows = _rows(trial, runs, settings, truth)
    extent = 0.0 if truth is None else extent_of(truth.shots)
    reach = 0.0 if truth is None else reach_of(truth.shots)
    notices = [*trial.notices, *_notices(trial, reference)]
    if truth is not None and reference is not None:
        if reference.sensitive:
            rows = _marked_by_figures(rows, truth, trial.cost)
        else:
            rows = _marked(rows, trial, reference, extent, reach, budget)
    table = TrialTable(
        trial.name,
        trial.kind,
        trial.span,
        0 if truth is None else len(truth.shots),
        0 if truth is None else max(len(shot.points) for shot in truth.shots),
        extent,
        reference,
        rows,
        notices,
        trial.error,
        trial.cost,
        trial.unit,
        budget,
        reach=reach,
    )
    row = table.recommended
    if row is None or row.chosen or trial.lines is None:
        return table
    return replace(table, lines=tuple(trial.lines(row.setting)))


class _Runs:
    """Runs each setting once, and caches the result."""

    def __init__(
        self, trial: Trial, count: int, progress: Callable[[float], None] | None
    ) -> None:
        self._trial, self._count, self._progress = trial, count, progress
        self._done: dict[Setting, TrialOutcome] = {}

    def has(self, setting: Setting) -> bool:
        """Return whether a setting has been run."""
        return setting in self._done

    def of(self, setting: Setting) -> TrialOutcome:
        """Return the result of a setting."""
        if setting not in self._done:
            self._done[setting] = self._run(setting)
            if self._progress is not None:
                self._progress(min(1.0, len(self._done) / self._count))
        return self._done[setting]

    def _run(self, setting: Setting) -> TrialOutcome:
        with np.errstate(all="ignore"):
            done = self._trial.run(setting)
            spent = [done.seconds]
            timed = self._trial.cost is CostMeasure.SECONDS
            while timed and len(spent) < REPEATS and sum(spent) < SHORT:
                spent.append(self._trial.run(setting).seconds)
        return replace(done, seconds=min(spent))


def _reference(
    trial: Trial, runs: _Runs
) -> tuple[Reference | None, TrialOutcome | None]:
    for settings in trial.references():
        outcomes: list[TrialOutcome] = []
        for setting in settings:
            try:
                outcomes.append(runs.of(setting))
            except OptionError:
                break  # the method does not apply; another may
            if outcomes[-1].status is not Status.OK:
                break
        else:
            return _judged(settings[-1], outcomes, trial.error), outcomes[-1]
    return None, None


def _judged(
    setting: Setting, outcomes: list[TrialOutcome], measure: ErrorMeasure
) -> Reference:
    """Return the reference and its error estimate, from runs of halved steps."""
    if len(outcomes) == 1:
        return Reference(setting, PointDistances(0.0, 0.0, 0.0), None, False)
    gaps = [distances(fine.shots, rough.shots) for rough, fine in pairwise(outcomes)]
    reach = reach_of(outcomes[-1].shots)
    coarse, fine = (gap.error(measure, reach) for gap in (gaps[0], gaps[-1]))
    extent = extent_of(outcomes[-1].shots) + reach
    order = observed_order(coarse, fine) if fine > ROUNDING * extent else None
    sensitive = order is not None and order < MIN_ORDER and fine > UNSEEN * extent
    gain = 1.0 if order is None else max(2**order - 1, 1.0)
    return Reference(setting, gaps[-1].scaled(1 / gain), order, sensitive)


def _rows(
    trial: Trial, runs: _Runs, settings: Sequence[Setting], truth: TrialOutcome | None
) -> list[TrialRow]:
    rows: list[TrialRow] = []
    slow: dict[str, TrialRow] = {}
    # Rows depend on time only where time is what they cost.
    timed = truth is not None and trial.cost is CostMeasure.SECONDS
    limit = TOO_SLOW * max(truth.seconds, SHORT) if truth and timed else None
    for setting in settings:
        row = slow.get(setting.method)
        if row is not None and setting != trial.chosen and not runs.has(setting):
            reason = f"skipped: {row.setting} took {row.seconds:.3g} s"
            rows.append(TrialRow(setting, reason=reason))
            continue
        row = replace(_row(trial, runs, setting, truth), chosen=setting == trial.chosen)
        if limit is not None and row.seconds > limit:
            slow[setting.method] = row
        rows.append(row)
    return rows


def _row(
    trial: Trial, runs: _Runs, setting: Setting, truth: TrialOutcome | None
) -> TrialRow:
    try:
        done = runs.of(setting)
    except OptionError as refusal:
        return TrialRow(setting, reason=refusal.faults[0].message)
    row = TrialRow(
        setting,
        done.seconds,
        done.steps,
        done.status,
        done.reason,
        None if done.status is Status.OK else done.stable_step,
        bytes=done.bytes,
    )
    if done.status is not Status.OK:
        return row
    complete = replace(row, energy_drift=_drift(done.energies), figures=done.figures)
    if done.error is not None:
        return replace(complete, error=done.error, worst=done.worst)
    if truth is None:
        return complete
    error = distances(truth.shots, done.shots)
    sign = _sign(error, extent_of(truth.shots))
    if sign:
        return replace(
            row, status=Status.UNSTABLE, reason=sign, stable_step=done.stable_step
        )
    worst = "" if trial.where is None or error.at is None else trial.where(*error.at)
    return replace(complete, error=error, worst=worst)


def _sign(error: PointDistances, extent: float) -> str:
    """Return why a completed run is unusable; empty if it is fine."""
    if error.unmatched > MAX_UNMATCHED:
        return f"{error.unmatched:.0%} of its points differ"
    if not error.largest <= FAR * extent:
        return f"its error is {length_text(error.largest)}"
    return ""


def _drift(energies: Sequence[Energy] | None) -> float | None:
    """Return the largest energy change, relative to the largest energy."""
    if not energies:
        return None
    totals = np.array([energy.total for energy in energies])
    kinetic = max(energy.kinetic for energy in energies)
    most = max(kinetic, abs(float(totals[0])))
    return float(np.abs(totals - totals[0]).max()) / most if most > 0 else None


def _notices(trial: Trial, reference: Reference | None) -> list[Fault]:
    if reference is None:
        message = f"{trial.name}: there is no motion to compare with: every setting "
        message += "blew up"
        hint = "shorten the step, or use an implicit method: it is then refined"
        return [warning("SIM056", message, hint)]
    if not reference.sensitive:
        return []
    off = reference.error.rms
    message = f"{trial.name}: half the step changes the motion by {1000 * off:.3g} mm "
    message += "(rms): it is sensitive, and no setting has a small error"
    hint = "compare settings by eye; a shorter range may still separate them"
    return [warning("SIM055", message, hint)]


def _marked(
    rows: list[TrialRow],
    trial: Trial,
    reference: Reference,
    extent: float,
    reach: float,
    budget: float | None,
) -> list[TrialRow]:
    """Return rows with the best marked, and the recommended one."""
    if not any(row.error is not None and row.error.largest for row in rows):
        # Nothing moves: all settings are equal, and times are noise.
        if budget is None:
            return rows
        return [replace(row, recommended=row.chosen) for row in rows]
    # Closer to the reference than its own error estimate is as good.
    extent += reach
    floor = max(reference.error.error(trial.error, reach), ROUNDING * extent)
    costs = [
        None
        if row.error is None
        else _cost(row, trial.cost, max(row.error.error(trial.error, reach), floor))
        for row in rows
    ]
    best = best_of(costs)
    chosen = next(i for i, row in enumerate(rows) if row.chosen)
    if budget is None:
        taken = recommended_of(costs, chosen, FALLBACK_TOLERANCE * extent)
    else:
        taken = cheapest_of(costs, budget)
    return [
        replace(row, best=i in best, recommended=i == taken)
        for i, row in enumerate(rows)
    ]


def _marked_by_figures(
    rows: list[TrialRow], truth: TrialOutcome, measure: CostMeasure
) -> list[TrialRow]:
    """Return rows of a chaotic motion, marked by energy, strain, depth.

    The error of a row is the most that one of its figures is above that of the
    reference, over what makes no difference. Rows with less than one are as good.
    """
    true_figures = _figures(_drift(truth.energies), truth.figures)
    if not true_figures:
        return rows
    costs: list[Cost | None] = []
    for row in rows:
        metrics = _figures(row.energy_drift, row.figures)
        if row.status is not Status.OK or metrics.keys() != true_figures.keys():
            costs.append(None)
            continue
        above = [max(0.0, metrics[name] - true_figures[name]) for name in true_figures]
        costs.append(_cost(row, measure, max(1.0, *above)))
    best = best_of(costs)
    return [replace(row, best=i in best) for i, row in enumerate(rows)]


def _figures(drift: float | None, figures: Mapping[Figure, float]) -> dict[str, float]:
    """Return figures relative to their tolerances."""
    shares = {
        str(k): x / FIGURE_TOLERANCES[k]
        for k, x in figures.items()
        if k in FIGURE_TOLERANCES
    }
    return shares if drift is None else {**shares, "energy": drift / ENERGY_TOLERANCE}


def _cost(row: TrialRow, measure: CostMeasure, error: float) -> Cost:
    value = {
        CostMeasure.SECONDS: row.seconds,
        CostMeasure.BYTES: float(row.bytes),
        CostMeasure.STEPS: float(row.steps),
    }[measure]
    return Cost(value, error, row.steps)
