"""Measurement of all settings of a trial against a reference run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from animtool.core.errors import Fault, OptionError, warning
from animtool.core.quantities import length_text
from animtool.sim.system import Energy
from animtool.sim.trajectory import Status
from animtool.sim.trials.costs import (
    Cost,
    cheapest_index,
    pareto_optimal,
    recommended_index,
)
from animtool.sim.trials.table import Reference, TrialRow, TrialTable
from animtool.sim.trials.trial import (
    CostMeasure,
    ErrorMeasure,
    Figure,
    PointDistances,
    Setting,
    Trial,
    TrialOutcome,
    max_instance_extent,
    observed_order,
    points_extent,
    run_distances,
)

# A run with an observed order of convergence below this is chaotic.
MIN_CONVERGENCE_ORDER = 0.5
# Differences relative to the extent that are rounding, or invisible: they do not make a
# run chaotic.
RELATIVE_ROUNDING, INVISIBLE_ERROR = 1e-13, 1e-6
# Larger errors, relative to the extent, mean that the run has diverged.
DIVERGED_ERROR = 10.0
# A run has also diverged if this fraction of points exists in only one of two runs.
MAX_UNMATCHED_FRACTION = 0.5
# The accepted error if the chosen setting diverges, relative to the extent.
FALLBACK_TOLERANCE = 0.01
# Short runs are repeated within this time [s], at most this often; the fastest counts.
REPEAT_TIME, MAX_REPEATS = 0.3, 3
# Finer settings of a method are skipped once it took this many times as long as the
# reference.
SLOW_RUN_FACTOR = 10.0
# Differences of figures that do not count [1], [m], [pairs].
FIGURE_TOLERANCES = {Figure.STRETCH: 1e-3, Figure.DEPTH: 1e-4, Figure.PIERCED: 1.0}
ENERGY_TOLERANCE = 1e-3


def measure(
    trial: Trial,
    *,
    budget: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> TrialTable:
    """Run all settings of a trial, and measure each.

    Args:
        trial: The simulation and its settings.
        budget: Largest acceptable error [m]: the cheapest setting within it is
            recommended. None recommends a cheaper setting as accurate as the chosen
            one.
        progress: Called with the fraction done, 0 to 1.
    """
    settings = list(dict.fromkeys([*trial.settings(), trial.chosen_setting]))
    count = len({*settings, *trial.references()[0]})
    cache = _RunCache(trial, count, progress)
    reference, reference_outcome = _find_reference(trial, cache)
    rows = _trial_rows(trial, cache, settings, reference_outcome)
    snapshots = () if reference_outcome is None else reference_outcome.snapshots
    extent, instance_extent = points_extent(snapshots), max_instance_extent(snapshots)
    notices = [*trial.notices, *_trial_notices(trial, reference)]
    if reference_outcome is not None and reference is not None:
        if reference.sensitive:
            rows = _rank_by_figures(rows, reference_outcome, trial.cost_measure)
        else:
            rows = _mark_recommended(
                rows, trial, reference, extent, instance_extent, budget
            )
    table = TrialTable(
        trial.name,
        trial.kind,
        trial.span,
        len(snapshots),
        max((len(snapshot.points) for snapshot in snapshots), default=0),
        extent,
        reference,
        rows,
        notices,
        trial.error_measure,
        trial.cost_measure,
        trial.unit,
        budget,
        reach=instance_extent,
    )
    row = table.recommended
    if row is None or row.chosen or trial.request_lines is None:
        return table
    return replace(table, lines=tuple(trial.request_lines(row.setting)))


class _RunCache:
    """Runs each setting once, and caches the result."""

    def __init__(
        self, trial: Trial, setting_count: int, progress: Callable[[float], None] | None
    ) -> None:
        self._trial, self._setting_count = trial, setting_count
        self._progress = progress
        self._outcomes: dict[Setting, TrialOutcome] = {}

    def is_done(self, setting: Setting) -> bool:
        """Return whether a setting has been run."""
        return setting in self._outcomes

    def outcome(self, setting: Setting) -> TrialOutcome:
        """Return the result of a setting."""
        if setting not in self._outcomes:
            self._outcomes[setting] = self._run(setting)
            if self._progress is not None:
                self._progress(min(1.0, len(self._outcomes) / self._setting_count))
        return self._outcomes[setting]

    def _run(self, setting: Setting) -> TrialOutcome:
        """Run a setting; short runs are repeated for their timing."""
        with np.errstate(all="ignore"):
            outcome = self._trial.run(setting)
            timings = [outcome.seconds]
            max_runs = (
                MAX_REPEATS if self._trial.cost_measure is CostMeasure.SECONDS else 1
            )
            while len(timings) < max_runs and sum(timings) < REPEAT_TIME:
                timings.append(self._trial.run(setting).seconds)
        return replace(outcome, seconds=min(timings))


def _find_reference(
    trial: Trial, cache: _RunCache
) -> tuple[Reference | None, TrialOutcome | None]:
    """Return the first reference whose runs all succeed, and its most accurate run."""
    for settings in trial.references():
        outcomes: list[TrialOutcome] = []
        for setting in settings:
            try:
                outcomes.append(cache.outcome(setting))
            except OptionError:
                break  # the method does not apply; another may
            if outcomes[-1].status is not Status.OK:
                break
        else:
            return _build_reference(
                settings[-1], outcomes, trial.error_measure
            ), outcomes[-1]
    return None, None


def _build_reference(
    setting: Setting, outcomes: list[TrialOutcome], measure: ErrorMeasure
) -> Reference:
    """Return the reference with an error estimate, from runs with halved steps."""
    if len(outcomes) == 1:
        return Reference(setting, PointDistances(0.0, 0.0, 0.0), None, False)
    differences = [
        run_distances(fine_run.snapshots, coarse_run.snapshots)
        for coarse_run, fine_run in pairwise(outcomes)
    ]
    instance_extent = max_instance_extent(outcomes[-1].snapshots)
    coarse_error = differences[0].error(measure, instance_extent)
    fine_error = differences[-1].error(measure, instance_extent)
    extent = points_extent(outcomes[-1].snapshots) + instance_extent
    order = None
    if fine_error > RELATIVE_ROUNDING * extent:
        order = observed_order(coarse_error, fine_error)
    is_chaotic = order is not None and order < MIN_CONVERGENCE_ORDER
    is_sensitive = is_chaotic and fine_error > INVISIBLE_ERROR * extent
    factor = 1.0 if order is None else max(2**order - 1, 1.0)
    return Reference(
        setting, differences[-1].scaled_by(1 / factor), order, is_sensitive
    )


def _trial_rows(
    trial: Trial,
    cache: _RunCache,
    settings: Sequence[Setting],
    reference_outcome: TrialOutcome | None,
) -> list[TrialRow]:
    """Return a row for each setting, skipping those far slower than the reference."""
    rows: list[TrialRow] = []
    slow_rows: dict[str, TrialRow] = {}
    # Rows depend on timings only if time is the cost.
    is_timed = (
        reference_outcome is not None and trial.cost_measure is CostMeasure.SECONDS
    )
    time_limit = None
    if reference_outcome and is_timed:
        time_limit = SLOW_RUN_FACTOR * max(reference_outcome.seconds, REPEAT_TIME)
    for setting in settings:
        row = slow_rows.get(setting.method)
        if (
            row is not None
            and setting != trial.chosen_setting
            and not cache.is_done(setting)
        ):
            reason = f"skipped: {row.setting} took {row.seconds:.3g} s"
            rows.append(TrialRow(setting, reason=reason))
            continue
        row = _trial_row(trial, cache, setting, reference_outcome)
        row = replace(row, chosen=setting == trial.chosen_setting)
        if time_limit is not None and row.seconds > time_limit:
            slow_rows[setting.method] = row
        rows.append(row)
    return rows


def _trial_row(
    trial: Trial,
    cache: _RunCache,
    setting: Setting,
    reference_outcome: TrialOutcome | None,
) -> TrialRow:
    """Return the results of a setting, compared with the reference."""
    try:
        outcome = cache.outcome(setting)
    except OptionError as refusal:
        return TrialRow(setting, reason=refusal.faults[0].message)
    row = TrialRow(
        setting,
        outcome.seconds,
        outcome.steps,
        outcome.status,
        outcome.reason,
        None if outcome.status is Status.OK else outcome.stable_step,
        bytes=outcome.bytes,
    )
    if outcome.status is not Status.OK:
        return row
    drift = _energy_drift(outcome.energies)
    completed_row = replace(row, energy_drift=drift, figures=outcome.figures)
    if outcome.error is not None:
        return replace(completed_row, error=outcome.error, worst=outcome.worst)
    if reference_outcome is None:
        return completed_row
    error = run_distances(reference_outcome.snapshots, outcome.snapshots)
    reason = _failure_reason(error, points_extent(reference_outcome.snapshots))
    if reason:
        failed_row = replace(row, status=Status.UNSTABLE, reason=reason)
        return replace(failed_row, stable_step=outcome.stable_step)
    worst = ""
    if trial.point_label is not None and error.worst_at is not None:
        worst = trial.point_label(*error.worst_at)
    return replace(completed_row, error=error, worst=worst)


def _failure_reason(error: PointDistances, extent: float) -> str:
    """Return why a completed run is unusable; empty if it is usable."""
    if error.unmatched > MAX_UNMATCHED_FRACTION:
        return f"{error.unmatched:.0%} of its points differ"
    if not error.largest <= DIVERGED_ERROR * extent:
        return f"its error is {length_text(error.largest)}"
    return ""


def _energy_drift(energies: Sequence[Energy] | None) -> float | None:
    """Return the largest change of total energy, relative to the largest energy."""
    if not energies:
        return None
    totals = np.array([energy.total for energy in energies])
    max_kinetic_energy = max(energy.kinetic for energy in energies)
    max_energy = max(max_kinetic_energy, abs(float(totals[0])))
    return (
        float(np.abs(totals - totals[0]).max()) / max_energy if max_energy > 0 else None
    )


def _trial_notices(trial: Trial, reference: Reference | None) -> list[Fault]:
    """Return a warning about a missing reference or a chaotic motion."""
    if reference is None:
        message = f"{trial.name}: there is no motion to compare with: every setting "
        message += "blew up"
        hint = "shorten the step, or use an implicit method: it is then refined"
        return [warning("SIM056", message, hint)]
    if not reference.sensitive:
        return []
    rms = reference.error.rms
    message = f"{trial.name}: half the step changes the motion by {1000 * rms:.3g} mm "
    message += "(rms): it is sensitive, and no setting has a small error"
    hint = "compare settings by eye; a shorter range may still separate them"
    return [warning("SIM055", message, hint)]


def _mark_recommended(
    rows: list[TrialRow],
    trial: Trial,
    reference: Reference,
    extent: float,
    instance_extent: float,
    budget: float | None,
) -> list[TrialRow]:
    """Return rows with the Pareto-optimal and the recommended settings marked."""
    if not any(row.error is not None and row.error.largest for row in rows):
        # Nothing moves: all settings are equal, and timings are noise.
        if budget is None:
            return rows
        return [replace(row, recommended=row.chosen) for row in rows]
    # Errors below the error estimate of the reference count as equal.
    extent += instance_extent
    min_error = max(
        reference.error.error(trial.error_measure, instance_extent),
        RELATIVE_ROUNDING * extent,
    )
    costs: list[Cost | None] = []
    for row in rows:
        cost = None
        if row.error is not None:
            error = row.error.error(trial.error_measure, instance_extent)
            cost = _row_cost(row, trial.cost_measure, max(error, min_error))
        costs.append(cost)
    optimal_indices = pareto_optimal(costs)
    current_index = next(i for i, row in enumerate(rows) if row.chosen)
    if budget is None:
        best_index = recommended_index(
            costs, current_index, FALLBACK_TOLERANCE * extent
        )
    else:
        best_index = cheapest_index(costs, budget)
    return [
        replace(
            row, is_pareto_optimal=i in optimal_indices, recommended=i == best_index
        )
        for i, row in enumerate(rows)
    ]


def _rank_by_figures(
    rows: list[TrialRow], reference_outcome: TrialOutcome, measure: CostMeasure
) -> list[TrialRow]:
    """Return rows of a chaotic motion, with the Pareto-optimal settings marked.

    The error of a row is the largest excess of one of its figures over that of the
    reference, relative to the figure's tolerance. Errors below 1 count as equal.
    """
    drift = _energy_drift(reference_outcome.energies)
    reference_figures = _relative_figures(drift, reference_outcome.figures)
    if not reference_figures:
        return rows
    costs: list[Cost | None] = []
    for row in rows:
        figures = _relative_figures(row.energy_drift, row.figures)
        if row.status is not Status.OK or figures.keys() != reference_figures.keys():
            costs.append(None)
            continue
        figure_names = reference_figures.keys()
        excesses = [
            max(0.0, figures[name] - reference_figures[name]) for name in figure_names
        ]
        costs.append(_row_cost(row, measure, max(1.0, *excesses)))
    optimal_indices = pareto_optimal(costs)
    return [
        replace(row, is_pareto_optimal=i in optimal_indices)
        for i, row in enumerate(rows)
    ]


def _relative_figures(
    drift: float | None, figures: Mapping[Figure, float]
) -> dict[str, float]:
    """Return each figure and the energy drift divided by its tolerance."""
    ratios = {
        str(k): x / FIGURE_TOLERANCES[k]
        for k, x in figures.items()
        if k in FIGURE_TOLERANCES
    }
    return ratios if drift is None else {**ratios, "energy": drift / ENERGY_TOLERANCE}


def _row_cost(row: TrialRow, measure: CostMeasure, error: float) -> Cost:
    """Return the cost of a row by the given measure, paired with its error."""
    value = {
        CostMeasure.SECONDS: row.seconds,
        CostMeasure.BYTES: float(row.bytes),
        CostMeasure.STEPS: float(row.steps),
    }[measure]
    return Cost(value, error, row.steps)
