"""Tables of settings, of things whose errors are known."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from animtool.core.errors import Fault, OptionError
from animtool.sim.system import Energy
from animtool.sim.trajectory import Status
from animtool.sim.trials.measuring import measure
from animtool.sim.trials.trial import (
    REFERENCE_FACTORS,
    CostMeasure,
    ErrorMeasure,
    Figure,
    Setting,
    Snapshot,
    Trial,
    TrialOutcome,
    rounded_multiples,
)


def setting(method: str, step: float) -> Setting:
    return Setting(method, (("step", step),))


class Known:
    """A point that goes 1 m, and is off by a function of method and step."""

    name, kind, span = "known", "points", 1.0

    def __init__(self, off: Callable[[str, float], float]) -> None:
        self.off = off
        self.chosen = setting("second", 0.1)
        self.ran: list[Setting] = []

    def settings(self) -> list[Setting]:
        return [
            setting(name, h)
            for name in ("first", "second")
            for h in rounded_multiples(0.1)
        ]

    def references(self) -> list[list[Setting]]:
        return [
            [
                setting("fourth", share * h)
                for h in rounded_multiples(0.1, REFERENCE_FACTORS)
            ]
            for share in (1.0, 0.125)
        ]

    def trial(self) -> Trial:
        return Trial(
            self.name,
            self.kind,
            self.span,
            self.chosen,
            self.settings,
            self.references,
            self.run,
        )

    def run(self, given: Setting) -> TrialOutcome:
        self.ran.append(given)
        step = dict(given.options)["step"]
        off = self.off(given.method, step)
        points = [np.array([[x, off * x, 0.0]]) for x in (0.0, 0.5, 1.0)]
        count = round(1 / step)
        energies = [Energy(1.0 + off * k, 0.0) for k in range(3)]
        return TrialOutcome(
            1e-6 * count, count, [Snapshot(p) for p in points], energies=energies
        )


ORDERS = {"first": 1, "second": 2, "fourth": 4}


def converging(method: str, step: float) -> float:
    return step ** ORDERS[method]


def test_errors_are_those_that_settings_make() -> None:
    table = measure(Known(converging).trial())
    assert (table.name, table.kind, table.span) == ("known", "points", 1.0)
    assert (table.instants, table.points) == (3, 1)
    assert table.reference is not None
    assert table.reference.setting == setting("fourth", 0.0125)
    assert table.reference.order == pytest.approx(4, abs=0.01)
    assert not table.reference.sensitive
    # Its own error is what is left of it.
    assert table.reference.error.largest == pytest.approx(0.0125**4, rel=0.1)
    for row in table.rows:
        method, step = row.setting.method, dict(row.setting.options)["step"]
        assert row.error is not None
        off = converging(method, step)
        assert row.error.largest == pytest.approx(off, rel=0.01)
        assert row.energy_drift == pytest.approx(2 * off / (1 + 2 * off))
    assert [row.setting for row in table.rows if row.chosen] == [setting("second", 0.1)]
    # In as many steps, the second order has less error.
    assert {row.setting.method for row in table.rows if row.is_pareto_optimal} == {
        "second"
    }
    assert not table.notices


def test_every_setting_is_run_often_enough_and_shows_progress() -> None:
    trial, shares = Known(converging), []
    measure(trial.trial(), progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1
    assert len({*trial.ran}) == len(shares) == 11


def test_a_chosen_setting_that_is_not_on_the_ladder_is_a_row() -> None:
    trial = Known(converging)
    trial.chosen = setting("second", 0.03)
    rows = measure(trial.trial()).rows
    assert [row.setting for row in rows if row.chosen] == [trial.chosen]


def test_what_does_not_converge_is_called_sensitive() -> None:
    table = measure(Known(lambda _, step: float(np.sin(1e5 * step))).trial())
    assert table.reference is not None
    assert table.reference.sensitive
    assert [notice.code for notice in table.notices] == ["SIM055"]
    assert not any(row.recommended for row in table.rows)
    assert any(row.chosen for row in table.rows)


def test_what_does_not_move_is_not_sensitive() -> None:
    table = measure(Known(lambda *_: 0.0).trial())
    assert table.reference is not None
    assert (table.reference.order, table.reference.sensitive) == (None, False)


def test_what_is_nowhere_near_has_blown_up() -> None:
    def off(method: str, step: float) -> float:
        return 1e6 if method == "second" and step > 0.05 else converging(method, step)

    table = measure(Known(off).trial())
    lost = [row for row in table.rows if row.status is Status.UNSTABLE]
    assert [dict(row.setting.options)["step"] for row in lost] == [0.4, 0.2, 0.1]
    assert all(row.error is None and row.reason for row in lost)
    # The chosen one is among them: what will do is recommended.
    (better,) = [row for row in table.rows if row.recommended]
    assert better.error is not None
    assert better.error.rms < 0.01


class Unfit(Known):
    """Methods that are not for it, or that blow up."""

    def run(self, given: Setting) -> TrialOutcome:
        step = dict(given.options)["step"]
        if given.method == "first":
            raise OptionError(Fault("SIM006", "it is not for such things"))
        if given.method == "fourth" and step > self.limit:
            return TrialOutcome(0.1, 3, [], Status.UNSTABLE, "too far", self.limit)
        return super().run(given)

    limit = 0.01


def test_what_a_method_is_not_for_is_left_out() -> None:
    rows = measure(Unfit(converging).trial()).rows
    left = [row for row in rows if row.setting.method == "first"]
    assert all(row.status is None and "not for" in row.reason for row in left)


def test_the_reference_is_refined_until_it_is_stable() -> None:
    table = measure(Unfit(converging).trial())
    assert table.reference is not None
    (_, step), *_ = table.reference.setting.options
    assert step == pytest.approx(0.0125 / 8)


def test_without_a_reference_there_are_no_errors() -> None:
    trial = Unfit(converging)
    trial.limit = 0.0
    table = measure(trial.trial())
    assert table.reference is None
    assert [notice.code for notice in table.notices] == ["SIM056"]
    assert all(row.error is None for row in table.rows)
    assert not any(row.recommended for row in table.rows)


def test_a_source_that_is_known_is_a_reference_of_its_own() -> None:
    exact = setting("exact", 0.1)

    def off(method: str, step: float) -> float:
        return 0.0 if method == "exact" else step

    known = Known(off)
    trial = replace(known.trial(), references=lambda: [[exact]])
    table = measure(trial)
    assert table.reference is not None
    assert table.reference.setting == exact
    assert (table.reference.order, table.reference.sensitive) == (None, False)
    assert table.reference.error.largest == 0
    row = next(row for row in table.rows if row.setting == setting("first", 0.4))
    assert row.error is not None
    assert row.error.largest == pytest.approx(0.4)


def test_a_budget_is_kept_by_the_cheapest() -> None:
    trial = replace(
        Known(converging).trial(),
        request_lines=lambda setting: [f"step: {setting['step']}"],
    )
    # Of first order .05 is .05 m off at most, of second .2 is .04 m.
    table = measure(replace(trial, error_measure=ErrorMeasure.LARGEST), budget=0.045)
    assert table.recommended is not None
    assert table.recommended.setting == setting("second", 0.2)
    assert (table.budget, table.lines) == (0.045, ("step: 0.2",))
    # The root of the mean of squares over 0, .5 and 1 s is sqrt(5 / 12) of that.
    table = measure(trial, budget=0.045)
    assert table.recommended is not None
    assert table.recommended.setting == setting("second", 0.2)
    table = measure(trial, budget=0.11)
    assert table.recommended is not None
    assert table.recommended.setting == setting("second", 0.4)
    assert measure(trial, budget=1e-9).recommended is None


def test_what_is_present_is_asked_for_by_no_lines() -> None:
    trial = replace(Known(converging).trial(), request_lines=lambda _: ["never"])
    trial = replace(trial, settings=lambda: [])
    table = measure(trial, budget=1.0)
    assert table.recommended is table.chosen
    assert table.lines == ()


def test_a_method_that_takes_too_long_is_tried_no_finer() -> None:
    known = Known(converging)

    def run(given: Setting) -> TrialOutcome:
        slow = 50.0 if given.method == "first" else 1e-3
        return replace(known.run(given), seconds=slow)

    table = measure(replace(known.trial(), run=run))
    first = [row for row in table.rows if row.setting.method == "first"]
    assert [row.error is None for row in first] == [False, True, True, True]
    assert first[1].status is None
    assert "50 s" in first[1].reason
    second = [row for row in table.rows if row.setting.method == "second"]
    assert all(row.error is not None for row in second)


def test_time_marks_nothing_that_costs_bytes() -> None:
    known = Known(converging)

    def run(seconds: float) -> Callable[[Setting], TrialOutcome]:
        return lambda one: replace(known.run(one), seconds=seconds, bytes=100)

    trial = replace(known.trial(), cost_measure=CostMeasure.BYTES)
    quick, slow = (measure(replace(trial, run=run(t))) for t in (1e-3, 500.0))
    assert [replace(row, seconds=0) for row in quick.rows] == [
        replace(row, seconds=0) for row in slow.rows
    ]
    assert all(row.error is not None for row in slow.rows)


def test_sensitive_motions_are_marked_by_their_figures() -> None:
    # What is no nearer with half the steps is judged by stretch alone.
    stretch = {0.4: 0.5, 0.2: 0.1, 0.1: 0.1005, 0.05: 0.1}
    known = Known(lambda _, step: 1.0 + (hash_of(step) % 2))

    def run(given: Setting) -> TrialOutcome:
        done = known.run(given)
        figures = {Figure.STRETCH: stretch.get(given["step"], 0.1)}
        return replace(done, figures=figures, energies=None)

    table = measure(replace(known.trial(), run=run))
    assert table.reference is not None
    assert table.reference.sensitive
    best = {row.setting["step"] for row in table.rows if row.is_pareto_optimal}
    # A half at .4 is cheapest and worst; a tenth is reached first at .2.
    assert best == {0.4, 0.2}
    assert table.recommended is None


def hash_of(step: float) -> int:
    """Return a number that is odd for every second halving."""
    return round(-math.log2(step / 0.4))


def test_turns_count_as_far_as_what_is_placed_reaches() -> None:
    half = math.sqrt(0.5)
    still, turned = np.array([[0.0, 0, 0, 1]]), np.array([[0.0, 0, half, half]])
    here = np.zeros((1, 3))

    def run(given: Setting) -> TrialOutcome:
        off = given.method == "first"
        shot = Snapshot(here, orientations=turned if off else still, reach=0.5)
        return TrialOutcome(1e-3, 1, [shot])

    trial = replace(Known(converging).trial(), run=run)
    table = measure(
        replace(trial, references=lambda: [[trial.chosen_setting]]), budget=0.7
    )
    assert table.recommended is not None
    # A quarter of a turn half a metre out is .785 m.
    first = next(row for row in table.rows if row.setting.method == "first")
    assert table.error_of(first) == pytest.approx(0.25 * math.pi)
    assert table.recommended.setting.method == "second"


def test_where_nothing_moves_the_present_setting_will_do() -> None:
    trial = Known(lambda _, __: 0.0).trial()
    table = measure(trial)
    assert not any(row.is_pareto_optimal or row.recommended for row in table.rows)
    table = measure(trial, budget=1e-3)
    assert table.recommended is table.chosen
