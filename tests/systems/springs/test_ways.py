"""Springs by every solver, with errors that go as they should."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.simulated import Simulator

from animtool.sim.trajectory import Status
from animtool.sim.trials.measuring import measure
from animtool.sim.trials.table import TrialRow
from animtool.sim.trials.trial import Figure, Setting, Trial


@pytest.fixture(autouse=True)
def _once(monkeypatch: pytest.MonkeyPatch) -> None:
    # How long anything takes is of no interest here.
    monkeypatch.setattr("animtool.sim.trials.measuring.MAX_REPEATS", 1)


def trial(folder: Path, stiffness: float = 200.0, **keys: Any) -> Trial:
    """Return a rope that hangs and swings."""
    rope = {
        "name": "lead",
        "from": [0, 0, 0],
        "to": [0.3, -1, 0],
        "count": 4,
        "mass": 2,
        "springs": {"structural": {"stiffness": stiffness}},
        "pins": [{"particles": ["start"]}],
        "preroll": 0.1,
        **keys,
    }
    return Simulator(folder).trial([{"rope": rope}], np.linspace(0, 0.25, 7).tolist())


def rows_of(rows: list[TrialRow], method: str) -> list[TrialRow]:
    return [row for row in rows if row.setting.method == method]


def test_errors_go_with_the_order_of_each_solver(tmp_path: Path) -> None:
    table = measure(trial(tmp_path))
    assert (table.name, table.kind, table.points) == ("lead", "rope", 4)
    assert table.span == pytest.approx(0.35)
    assert table.reference is not None
    assert table.reference.order == pytest.approx(2, abs=0.2)
    for solver, order in (("symplectic_euler", 1), ("bdf2", 2), ("implicit_euler", 1)):
        sizes = [row.error.rms for row in rows_of(table.rows, solver) if row.error]
        assert math.log2(sizes[-2] / sizes[-1]) == pytest.approx(order, abs=0.3)
    (chosen,) = [row for row in table.rows if row.chosen]
    assert chosen.setting.method == "symplectic_euler"
    assert chosen.energy_drift is not None
    assert chosen.energy_drift < 0.05
    assert chosen.figures[Figure.STRETCH] > 0


def test_the_solver_that_is_left_open_is_chosen_as_it_is_simulated(
    tmp_path: Path,
) -> None:
    auto = trial(tmp_path)
    asked = {"solver": auto.chosen_setting.method, "step": auto.chosen_setting["step"]}
    same = trial(tmp_path, **asked)
    assert same.chosen_setting == auto.chosen_setting
    one, other = auto.run(auto.chosen_setting), same.run(same.chosen_setting)
    np.testing.assert_allclose(
        one.snapshots[-1].points, other.snapshots[-1].points, atol=1e-12
    )
    assert one.steps == other.steps


def test_an_error_is_kept_by_the_steps_that_it_came_to(tmp_path: Path) -> None:
    kept = trial(tmp_path, error=0.001)
    (step,) = [value for name, value in kept.chosen_setting.options if name == "step"]
    assert step < 1 / 240
    assert kept.run(kept.chosen_setting).status is Status.OK


def test_steps_beyond_the_limit_blow_up_and_say_so(tmp_path: Path) -> None:
    ours = trial(tmp_path, 1e6, solver="xpbd")
    done = ours.run(Setting("symplectic_euler", (("step", 0.01),)))
    assert done.status is Status.UNSTABLE
    assert done.reason
    assert done.stable_step is not None
    assert 0 < done.stable_step < 0.01
    assert ours.chosen_setting.method == "xpbd"


def test_energy_is_told_where_nothing_takes_it(tmp_path: Path) -> None:
    slowed = trial(tmp_path, drag=0.5)
    assert slowed.run(slowed.chosen_setting).energies is None
    free = trial(tmp_path)
    energies = free.run(free.chosen_setting).energies
    assert energies is not None
    assert len(energies) == 7


def test_where_no_implicit_step_is_solved_explicit_ones_serve(tmp_path: Path) -> None:
    ours = trial(tmp_path)
    methods = [settings[0].method for settings in ours.references()]
    assert methods == ["bdf2", "symplectic_euler"]
    for settings in ours.references():
        steps = [dict(setting.options)["step"] for setting in settings]
        assert steps == pytest.approx([steps[0], steps[0] / 2, steps[0] / 4])


def test_what_only_one_solver_can_is_compared_with_its_own_finer_steps(
    tmp_path: Path,
) -> None:
    cloth = {
        "name": "flag",
        "corner": [0, 1, 0],
        "across": [1, 0, 0],
        "up": [0, 0.6, 0],
        "resolution": [5, 4],
        "mass": 0.1,
        "springs": {"structural": {"stiffness": 300, "ratio": 0.05}},
        "pins": [{"particles": ["left"]}],
        "self_contact": {"thickness": 0.01},
        "radius": 0.01,
    }
    table = measure(Simulator(tmp_path).trial([{"cloth": cloth}], [0.0, 0.05, 0.1]))
    assert {row.setting.method for row in table.rows} == {"xpbd"}
    assert table.reference is not None
    assert table.reference.setting.method == "xpbd"
    assert all(row.error is not None for row in table.rows)
