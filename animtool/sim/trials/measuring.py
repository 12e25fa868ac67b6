"""Every setting of a simulation against a finer one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field, replace
from itertools import pairwise
from typing import ClassVar

import numpy as np

from animtool.core.errors import Fault, OptionError, warning
from animtool.core.quantities import length_text
from animtool.core.record import dataclass
from animtool.sim.system import Energy
from animtool.sim.trajectory import Status
from animtool.sim.trials.trial import (
    Cost,
    Distances,
    Outcome,
    Setting,
    Trial,
    best_of,
    distances,
    extent_of,
    order_seen,
    reach_of,
    recommended_of,
)

# A motion that halving the steps does not bring nearer by a power of this is sensitive.
MIN_ORDER = 0.5
# Beside the size of a motion, distances that rounding makes, and those that nobody
# sees: such make no motion sensitive.
ROUNDING, UNSEEN = 1e-13, 1e-6
# Beside it, an error that is no error any more: the motion has blown up.
FAR = 10.0
# Share of points that only one of two motions has, from which on likewise.
MAX_APART = 0.5
# Where the chosen setting blows up, an error that will do, likewise.
ENOUGH = 0.01
# As long as they take less together, short runs are taken again, so often at most, and
# the shortest counts [s].
SHORT, REPEATS = 0.3, 3


@dataclass(frozen=True, slots=True)
class Reference:
    """The motion that others are compared with."""

    setting: Setting  # of it
    error: Distances  # how far it may well be off itself, from the two finest
    # Power of the step that its error goes with, from the three finest; None where they
    # do not differ.
    order: float | None
    # Whether halving the steps hardly brings it nearer: then nothing is near, and
    # errors say little.
    sensitive: bool
    json_keys: ClassVar[str] = "*setting error order sensitive"


@dataclass(frozen=True, slots=True)
class TrialRow:
    """A setting, and what it comes to."""

    setting: Setting  # what is tried
    # Wall time of the simulation [s]; 0 where the method is not for it.
    seconds: float = 0.0
    steps: int = 0  # that were taken
    status: Status | None = None  # how it ended; None where the method is not for it
    # Why it stopped, or is not for it; empty where it did what it should.
    reason: str = ""
    stable_step: float | None = None  # as in `Outcome`
    # Distances from the reference; None where it did not get to the end, or there is no
    # reference.
    error: Distances | None = None
    # Most that the energy differed from that of the start, in the largest that there
    # was [1]; None where it may come and go.
    energy_drift: float | None = None
    # As in `Outcome`; None too where it did not get to the end.
    stretch: float | None = None
    chosen: bool = False  # whether the file has it so
    best: bool = False  # whether no other that is as exact is faster
    recommended: bool = False  # whether to take it in place of the chosen one
    span: float = 0.0  # how long it simulates [s]
    json_keys: ClassVar[str] = (
        "*setting status=ended reason stable_step seconds~ simulated_per_second steps "
        "error energy_drift stretch chosen best recommended"
    )

    @property
    def ended(self) -> str:
        """How it ended, in words."""
        if self.status is None:
            return "left out"
        return "blew up" if self.status == "unstable" else str(self.status)

    @property
    def simulated_per_second(self) -> float | None:
        """How much a second simulates [s]; None where it took no time."""
        return self.span / self.seconds if self.seconds else None


@dataclass(frozen=True, slots=True)
class TrialTable:
    """The settings of one simulation."""

    name: str  # what it is called
    kind: str  # what it is
    span: float  # how long it was simulated [s]
    instants: int  # at how many times points were compared
    points: int  # how many there were, at most
    extent: float  # diagonal of the box that they stayed in [m]
    # What they were compared with; None where every fine one stopped.
    reference: Reference | None
    rows: list[TrialRow]  # in the order tried
    notices: list[Fault] = field(default_factory=list)  # what is odd about it
    json_keys: ClassVar[str] = "name kind span instants points extent reference rows"

    @property
    def tried(self) -> list[TrialRow]:
        """The rows of methods that are for it."""
        return [row for row in self.rows if row.status is not None]

    @property
    def has_lone(self) -> bool:
        """Whether points are compared that only one of two has."""
        return any(row.error is not None and row.error.apart for row in self.tried)


def measure(
    trial: Trial, *, progress: Callable[[float], None] | None = None
) -> TrialTable:
    """Simulate something in several ways, and measure each.

    Args:
        trial: What, and which ways there are.
        progress: Called with the share done, 0 to 1.

    Raises:
        OptionError: Something makes no sense, whatever the setting.
    """
    settings = list(dict.fromkeys([*trial.settings(), trial.chosen]))
    whole = len({*settings, *trial.references()[0]})
    runs = _Runs(trial, whole, progress)
    reference, truth = _reference(trial, runs)
    rows = [_row(runs, setting, truth) for setting in settings]
    rows = [replace(row, chosen=row.setting == trial.chosen) for row in rows]
    extent = 0.0 if truth is None else extent_of(truth.shots)
    if reference is not None and not reference.sensitive:
        reach = 0.0 if truth is None else reach_of(truth.shots)
        rows = _marked(rows, reference, extent, reach)
    return TrialTable(
        trial.name,
        trial.kind,
        trial.span,
        0 if truth is None else len(truth.shots),
        0 if truth is None else max(len(shot.points) for shot in truth.shots),
        extent,
        reference,
        rows,
        _notices(trial, reference),
    )


class _Runs:
    """Runs each setting once."""

    def __init__(
        self, trial: Trial, whole: int, progress: Callable[[float], None] | None
    ) -> None:
        self._trial, self._whole, self._progress = trial, whole, progress
        self._done: dict[Setting, Outcome] = {}

    def of(self, setting: Setting) -> Outcome:
        """Return what a setting comes to."""
        if setting not in self._done:
            self._done[setting] = self._run(setting)
            if self._progress is not None:
                self._progress(min(1.0, len(self._done) / self._whole))
        return self._done[setting]

    def _run(self, setting: Setting) -> Outcome:
        with np.errstate(all="ignore"):
            done = self._trial.run(setting)
            spent = [done.seconds]
            while len(spent) < REPEATS and sum(spent) < SHORT:
                spent.append(self._trial.run(setting).seconds)
        return replace(done, seconds=min(spent))


def _reference(trial: Trial, runs: _Runs) -> tuple[Reference | None, Outcome | None]:
    for settings in trial.references():
        outcomes = []
        for setting in settings:
            outcomes.append(runs.of(setting))
            if outcomes[-1].status is not Status.OK:
                break
        else:
            return _judged(settings[-1], outcomes), outcomes[-1]
    return None, None


def _judged(setting: Setting, outcomes: list[Outcome]) -> Reference:
    """Return how near the finest of motions is, each in half the steps of the last."""
    gaps = [distances(fine.shots, rough.shots) for rough, fine in pairwise(outcomes)]
    reach = reach_of(outcomes[-1].shots)
    coarse, fine = (gap.with_reach(reach) for gap in gaps[-2:])
    extent = extent_of(outcomes[-1].shots) + reach
    order = order_seen(coarse, fine) if fine > ROUNDING * extent else None
    sensitive = order is not None and order < MIN_ORDER and fine > UNSEEN * extent
    share = 1.0 if order is None else max(2**order - 1, 1.0)
    return Reference(setting, gaps[-1].scaled(1 / share), order, sensitive)


def _row(runs: _Runs, setting: Setting, truth: Outcome | None) -> TrialRow:
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
    )
    if done.status is not Status.OK:
        return row
    row = replace(row, energy_drift=_drift(done.energies), stretch=done.stretch)
    if truth is None:
        return row
    error = distances(truth.shots, done.shots)
    sign = _sign(error, extent_of(truth.shots))
    if not sign:
        return replace(row, error=error)
    return replace(
        row,
        status=Status.UNSTABLE,
        reason=sign,
        stable_step=done.stable_step,
        energy_drift=None,
        stretch=None,
    )


def _sign(error: Distances, extent: float) -> str:
    """Return why a motion that went on to the end is none, empty where it is one."""
    if error.apart > MAX_APART:
        return f"it has other points, by {error.apart:.0%}"
    if not error.largest <= FAR * extent:
        return f"it is off by {length_text(error.largest)}"
    return ""


def _drift(energies: Sequence[Energy] | None) -> float | None:
    """Return the most that energy differs from the first, in the largest there is."""
    if not energies:
        return None
    totals = np.array([energy.total for energy in energies])
    kinetic = max(energy.kinetic for energy in energies)
    most = max(kinetic, abs(float(totals[0])))
    return float(np.abs(totals - totals[0]).max()) / most if most > 0 else None


def _notices(trial: Trial, reference: Reference | None) -> list[Fault]:
    if reference is None:
        message = f"{trial.name}: there is no motion to compare with: each blew up"
        hint = "shorten the step, or choose an implicit method: it is then refined"
        return [warning("SIM056", message, hint)]
    if not reference.sensitive:
        return []
    off = reference.error.rms
    message = (
        f"{trial.name}: half the steps lead elsewhere, by {1000 * off:.3g} mm (rms): "
        "the motion is sensitive, and errors are not small with any setting"
    )
    hint = "judge settings by how they look; a shorter range may still tell them apart"
    return [warning("SIM055", message, hint)]


def _marked(
    rows: list[TrialRow], reference: Reference, extent: float, reach: float
) -> list[TrialRow]:
    """Return rows with the best marked, and the one to take."""
    # What is nearer to the reference than that is to the truth is as good.
    extent += reach
    least = max(reference.error.with_reach(reach), ROUNDING * extent)
    costs = [
        None
        if row.error is None
        else Cost(row.seconds, max(row.error.with_reach(reach), least))
        for row in rows
    ]
    best = best_of(costs)
    chosen = next(i for i, row in enumerate(rows) if row.chosen)
    better = recommended_of(costs, chosen, ENOUGH * extent)
    return [
        replace(row, best=i in best, recommended=i == better)
        for i, row in enumerate(rows)
    ]
