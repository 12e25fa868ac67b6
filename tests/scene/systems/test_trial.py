"""Particles by every integrator, with errors that go as they should."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.faults import raises
from support.simulated import Simulator

from animtool.core.errors import OptionError
from animtool.sim.trajectory import Status
from animtool.sim.trials.measuring import measure
from animtool.sim.trials.table import TrialRow
from animtool.sim.trials.trial import Setting, Trial

FLOOR = [{"shape": {"plane": {}}, "at": [0, -5, 0]}]


@pytest.fixture(autouse=True)
def _once(monkeypatch: pytest.MonkeyPatch) -> None:
    # How long anything takes is of no interest here.
    monkeypatch.setattr("animtool.sim.trials.measuring.MAX_REPEATS", 1)


def orbits(count: int = 2, mass: float = 1.0, **given: Any) -> dict[str, Any]:
    """Return keys of particles around a centre."""
    emitter = {
        "at": [1, 0, 0],
        "bursts": [[0, count]],
        "direction": [0, 0, 1],
        "speed": 0.9,
        "speed_spread": 0.1,
        "mass": mass,
    }
    forces = [{"central": {"strength": 1}}]
    return {"emitters": [emitter], "forces": forces, "step": 0.02, **given}


def trial(
    folder: Path, keys: dict[str, Any], seconds: float = 0.5, frames: int = 6
) -> Trial:
    times = np.linspace(0, seconds, frames).tolist()
    return Simulator(folder).trial([{"particles": keys}], times)


def rows_of(rows: list[TrialRow], method: str) -> list[TrialRow]:
    return [row for row in rows if row.setting.method == method]


@pytest.mark.slow
def test_errors_go_with_the_order_of_each_method(tmp_path: Path) -> None:
    table = measure(trial(tmp_path, orbits()))
    assert table.reference is not None
    assert not table.reference.sensitive
    for method, order in (
        ("euler", 1),
        ("symplectic_euler", 1),
        ("midpoint", 2),
        ("velocity_verlet", 2),
        ("trapezoid", 2),
        ("rk4", 4),
    ):
        errors = [row.error for row in rows_of(table.rows, method)]
        sizes = [error.rms for error in errors if error]
        assert len(sizes) == 4
        assert math.log2(sizes[-2] / sizes[-1]) == pytest.approx(order, abs=0.35)
    (chosen,) = [row for row in table.rows if row.chosen]
    assert chosen.setting == Setting("midpoint", (("step", 0.02),))
    assert all(row.steps > 0 for row in table.rows if row.status is Status.OK)


def test_methods_that_choose_their_steps_have_tolerances(
    tmp_path: Path,
) -> None:
    found = trial(tmp_path, orbits()).settings()
    tried = [setting.options for setting in found if setting.method == "rk45"]
    assert tried == [
        (("step", 0.08), ("tolerance", value)) for value in (1e-4, 1e-6, 1e-8)
    ]
    own = orbits(method="rk45", tolerance=1e-3)
    ours = trial(tmp_path, own)
    assert ours.chosen_setting == Setting("rk45", (("step", 0.02), ("tolerance", 1e-3)))
    assert ours.chosen_setting in ours.settings()


def test_energy_is_told_where_nothing_takes_or_brings_it(tmp_path: Path) -> None:
    drifts = []
    for method in ("euler", "symplectic_euler"):
        done = trial(tmp_path, orbits(), 6.0).run(Setting(method, (("step", 0.01),)))
        assert done.energies is not None
        assert len(done.energies) == 6
        drifts.append(done.energies[-1].total - done.energies[0].total)
    assert drifts[0] > 10 * abs(drifts[1])
    for setup in (
        orbits(colliders=FLOOR),
        orbits(forces=[{"drag": {"linear": 0.1}}]),
        orbits(emitters=[{"bursts": [[0, 1], [0.2, 1]], "mass": 1}], forces=[]),
        orbits(forces=[{"spring": {"anchor": [0, 0, 0], "k": 1, "kd": 0.5}}]),
    ):
        done = trial(tmp_path, setup).run(trial(tmp_path, setup).chosen_setting)
        assert done.energies is None


@pytest.mark.slow
def test_a_stiff_spring_blows_up_and_says_which_step_is_stable(tmp_path: Path) -> None:
    # ω is 100 / s: semi-implicit Euler is stable up to 0.02 s.
    setup = orbits(
        mass=0.001,
        forces=[{"spring": {"anchor": [0, 0, 0], "k": 10}}],
        method="implicit_euler",
        step=0.03,
    )
    table = measure(trial(tmp_path, setup, 0.96, 3))
    explicit = rows_of(table.rows, "symplectic_euler")
    lost = [row for row in explicit if row.status is Status.UNSTABLE]
    assert [dict(row.setting.options)["step"] for row in lost] == [0.12, 0.06, 0.03]
    assert [row.stable_step for row in lost] == [pytest.approx(0.02)] * 3
    calm = rows_of(table.rows, "implicit_euler")
    assert all(row.status is Status.OK for row in calm)


def test_a_method_that_is_not_for_them_is_left_early(tmp_path: Path) -> None:
    stiff = orbits(forces=[{"spring": {"k": 1e12}}], method="implicit_euler")
    done = trial(tmp_path, stiff).run(Setting.of("rk45", step=0.08, tolerance=1e-6))
    assert done.status is Status.OUT_OF_BUDGET
    assert done.steps < 1000


@pytest.mark.slow
def test_particles_that_come_and_go_are_compared_by_their_ids(tmp_path: Path) -> None:
    emitter = {"rate": 200, "speed": 2, "spread": math.degrees(0.3)}
    emitter |= {"lifetime": 0.2, "lifetime_spread": 0.1}
    floor = {"shape": {"plane": {}}, "restitution": 0.5}
    setup: dict[str, Any] = {"emitters": [emitter], "forces": [{"gravity": {}}]}
    setup |= {"colliders": [floor], "step": 0.02}
    table = measure(trial(tmp_path, setup, 0.6, 8))
    (chosen,) = [row for row in table.rows if row.chosen]
    assert chosen.error is not None
    assert chosen.error.unmatched == 0
    assert chosen.error.rms < 0.1
    assert table.points > 20


def test_what_cannot_serve_them_is_left_out(tmp_path: Path) -> None:
    ours = trial(tmp_path, orbits(40))
    ours.run(ours.chosen_setting)
    with raises(OptionError, "SIM024", match="120"):
        ours.run(Setting("radau", (("step", 0.02), ("tolerance", 1e-6))))
    stopped = trial(tmp_path, orbits(colliders=FLOOR))
    with raises(OptionError, "SIM006"):
        stopped.run(Setting("dop853", (("step", 0.02), ("tolerance", 1e-6))))


def test_the_tolerance_of_a_file_is_for_its_own_method(tmp_path: Path) -> None:
    keys = {"name": "fish", "species": [{"name": "fish", "count": 3}]}
    keys |= {"method": "rk45", "tolerance": 1e-4}
    ours = Simulator(tmp_path).trial([{"flocks": keys}], [0.0, 0.02])
    assert ours.chosen_setting == Setting.of("rk45", step=0.01, tolerance=1e-4)
    (finer,) = ours.references()
    assert {setting.method for setting in finer} == {"rk45"}
    for setting in (ours.chosen_setting, ours.settings()[0], finer[0]):
        assert ours.run(setting).status is Status.OK
