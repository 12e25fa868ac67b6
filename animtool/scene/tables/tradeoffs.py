"""Tables of time against error for all results of a scene or motion file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import ClassVar

from animtool.core.errors import Fault, OptionError, warning
from animtool.core.names import has_kind_suffix
from animtool.core.quantities import length_text
from animtool.core.record import dataclass
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.progress import Progress, part_progress
from animtool.scene.bake.reading import Source, source_file
from animtool.scene.file.entries import EntryLocation
from animtool.scene.file.read import load_scene
from animtool.scene.scene import Scene
from animtool.scene.solves.ik import IkJob
from animtool.scene.tables.ik import job_trial
from animtool.scene.tables.simulation import simulation_trials
from animtool.scene.tables.take import take_trials
from animtool.sim.trials.measuring import measure
from animtool.sim.trials.table import TrialRow, TrialTable
from animtool.sim.trials.trial import Setting, Trial

SUITE_FOLDER = Path(__file__).with_name("suite")
SUITE_FILES = (
    "orbits.scene.yaml",
    "rope.scene.yaml",
    "reach.scene.yaml",
    "arm.clip.yaml",
)


@dataclass(frozen=True, slots=True)
class Tradeoffs:
    """Tables of time against error for an input, one for each result."""

    source: Path  # input file
    tables: list[TrialTable]  # in the order in which a bake produces the results
    notices: list[Fault] = field(default_factory=list)  # warnings about the tables
    budget: float | None = None  # largest acceptable error [m]; None if unspecified
    stage_pairs: list[StagePair] = field(default_factory=list)
    json_keys: ClassVar[str] = "'report' source budget tables notices"


@dataclass(frozen=True, slots=True)
class StagePair:
    """Two settings of a table, written as stages for visual comparison."""

    table_index: int  # index of the table
    settings: tuple[Setting, Setting]  # the current setting, and another
    files: tuple[Path, Path]
    size: float  # size of the figure in the stages [m]; 0 if unknown


def measure_tradeoffs(
    source: Source,
    options: BakeOptions | None = None,
    *,
    budget: float | None = None,
    folder: Path | None = None,
    progress: Progress = None,
) -> Tradeoffs:
    """Measure time against error for all results of an input.

    The settings are integrator, step and tolerance of simulations, method and tolerance
    of IK, and sample rate, reduction and keys of the written take. Each is compared
    with its finest setting.

    Args:
        source: Scene or motion file.
        options: Bake options.
        budget: Largest acceptable error [m]: the cheapest setting within it is
            recommended. None recommends a setting as accurate as the current one.
        folder: Folder for stages of two settings of each table, to compare by eye: the
            current setting, and the recommended or the next cheaper one. None writes
            none.
        progress: Called with the fraction done, 0 to 1.

    Raises:
        FormatError: The source is malformed, or a pass cannot be applied to it.
        OptionError: An option is invalid, or nothing can be traded (SCN071).
    """
    trials = _trials(source, options)
    report = _measure_trials(source_file(source), trials, budget, progress)
    if folder is None:
        return report
    return replace(report, stage_pairs=_write_pairs(trials, report.tables, folder))


def suite_tradeoffs(
    *, budget: float | None = None, progress: Progress = None
) -> Tradeoffs:
    """Measure animtool's own examples; see `measure_tradeoffs`.

    The examples are comets with each integrator, a rope with each solver, a reaching
    arm with each method, and an arm wave as samples and as keys. Times are measured on
    this machine.
    """
    tables: list[TrialTable] = []
    notices: list[Fault] = []
    for i, name in enumerate(SUITE_FILES):
        path = SUITE_FOLDER / name
        source = load_scene(path) if has_kind_suffix(path, "scene") else path
        example_progress = part_progress(progress, i, len(SUITE_FILES))
        report = measure_tradeoffs(source, budget=budget, progress=example_progress)
        tables += report.tables
        notices += report.notices
    return Tradeoffs(Path("suite"), tables, notices, budget)


def simulation_tradeoffs(
    scene: Scene, options: BakeOptions | None = None, *, progress: Progress = None
) -> Tradeoffs:
    """Measure a scene's simulations and solves; see `measure_tradeoffs`."""
    trials = simulation_trials(scene, options)
    return _measure_trials(scene.path, trials, None, progress)


def take_tradeoffs(
    source: Source, options: BakeOptions | None = None, *, progress: Progress = None
) -> Tradeoffs:
    """Measure settings of a take's output; see `measure_tradeoffs`."""
    trials: list[tuple[EntryLocation | None, Trial]] = [
        (None, trial) for trial in take_trials(source, options)
    ]
    return _measure_trials(source_file(source), trials, None, progress)


def ik_tradeoffs(job: IkJob, *, progress: Progress = None) -> Tradeoffs:
    """Measure settings of an IK job; see `measure_tradeoffs`."""
    return _measure_trials(job.targets, [(None, job_trial(job))], None, progress)


def _trials(
    source: Source, options: BakeOptions | None
) -> Sequence[tuple[EntryLocation | None, Trial]]:
    trials: list[tuple[EntryLocation | None, Trial]] = []
    if isinstance(source, Scene):
        trials += simulation_trials(source, options)
        if not source.sources or source.outputs[0].bake.deform:
            return trials
    return trials + [(None, trial) for trial in take_trials(source, options)]


def _measure_trials(
    path: Path,
    trials: Sequence[tuple[EntryLocation | None, Trial]],
    budget: float | None,
    progress: Progress,
) -> Tradeoffs:
    if not trials:
        message = "has no simulation to measure"
        hint = "it has no systems, and no simulate pass with something to move"
        raise OptionError(Fault("SCN071", message, str(path), (), hint))
    tables = []
    for i, (location, trial) in enumerate(trials):
        trial_progress = part_progress(progress, i, len(trials))
        if location is None:
            tables.append(measure(trial, budget=budget, progress=trial_progress))
            continue
        with location.located():
            table = measure(trial, budget=budget, progress=trial_progress)
        notices = [location.locate(notice) for notice in table.notices]
        tables.append(replace(table, notices=notices))
    notices = [notice for table in tables for notice in table.notices]
    return Tradeoffs(
        path, tables, notices + _over_budget_warnings(path, tables), budget
    )


def _write_pairs(
    trials: Sequence[tuple[EntryLocation | None, Trial]],
    tables: Sequence[TrialTable],
    folder: Path,
) -> list[StagePair]:
    """Write the chosen setting of each table and a setting to compare as stages."""
    stage_pairs = []
    for i, ((_, trial), table) in enumerate(zip(trials, tables, strict=True)):
        other_row = _row_to_compare(table)
        if trial.write is None or other_row is None:
            continue
        settings = (table.chosen.setting, other_row.setting)
        chosen_name = f"table{i + 1}_present.usdc"
        other_name = f"table{i + 1}_other.usdc"
        files = (folder / chosen_name, folder / other_name)
        for setting, file in zip(settings, files, strict=True):
            trial.write(setting, file)
        stage_pairs.append(StagePair(i, settings, files, trial.size))
    return stage_pairs


def _row_to_compare(table: TrialTable) -> TrialRow | None:
    """Return the setting to compare with the chosen one; None if there is none."""
    if table.recommended is not None and not table.recommended.chosen:
        return table.recommended
    rows = [row for row in table.rows if row.error is not None and not row.chosen]
    return next(iter([row for row in rows if row.is_pareto_optimal] or rows), None)


def _over_budget_warnings(path: Path, tables: Sequence[TrialTable]) -> list[Fault]:
    """Return a warning for each table without a setting within the budget (SIM176)."""
    faults = []
    for table in tables:
        if table.budget is None or table.recommended is not None:
            continue
        if table.reference is None or table.reference.sensitive:
            continue
        errors = [e for row in table.rows if (e := table.error_of(row)) is not None]
        smallest_error = length_text(min(errors, default=float("inf")))
        message = f"{table.name}, {table.kind}: no setting is within "
        message += f"{length_text(table.budget)}: the smallest {table.error} error is "
        hint = "raise the budget, or try finer settings than the file's"
        notice = warning("SIM176", message + smallest_error, hint)
        faults.append(notice.in_file(path))
    return faults
