"""A kind that is a spec and a build is read, run, tried and resumed."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.faults import raises
from support.swing import Spec

from animtool.core.errors import FormatError, OptionError, ToleranceError
from animtool.documents.document import Document, read_document
from animtool.motion.frames import TransformsFrame
from animtool.report.tradeoffs import TABLES
from animtool.scene.file.entries import EntryLocation, SceneSystem
from animtool.scene.systems.derived import SystemSetup, read_spec
from animtool.scene.systems.simulation import open_systems
from animtool.scene.systems.trial import system_trials
from animtool.scene.tables.tradeoffs import Tradeoffs
from animtool.sim.colliders import Plane
from animtool.sim.trials.measuring import measure
from animtool.sim.trials.trial import Setting
from animtool.systems.framework.kinds import SYSTEM_KINDS, SystemKind
from animtool.systems.framework.run import SimulationRun
from animtool.systems.particles import Disc, Point
from animtool.systems.particles.forces.air import Wind
from animtool.systems.particles.forces.pulls import Gravity

FLOOR = {"shape": {"plane": None}, "at": [0, 0.25, 0]}
TIMES = np.array([0.0, 0.3, 0.77, 1.0])


@pytest.fixture(autouse=True)
def _kind(monkeypatch: pytest.MonkeyPatch) -> None:
    example: dict[str, Any] = {"speed": 2}
    kind = SystemKind(
        "support.swing:Spec", "support.swing:build", "A point on a circle.", example
    )
    monkeypatch.setitem(SYSTEM_KINDS, "swing", kind)


def read(folder: Path, **keys: Any) -> tuple[SystemSetup | None, Document]:
    """Return the setup of an entry with some keys, and its file."""
    keys = {"name": "it", "speed": 2.0, **keys}
    path = folder / "a.scene.yaml"
    path.write_text(str({"systems": [{"swing": keys}]}).replace("None", "null"))
    document, at = read_document(path), ("systems", 0, "swing")
    return read_spec(document, at, Spec.model_validate(keys), [folder]), document


def system(folder: Path, **keys: Any) -> SceneSystem:
    setup, document = read(folder, **keys)
    assert setup is not None
    return SceneSystem(
        "it", "swing", setup, EntryLocation(document.path, 1, 1, "systems[0]")
    )


def run(folder: Path, **keys: Any) -> SimulationRun:
    (opened,) = open_systems([system(folder, **keys)], 1.0)
    assert isinstance(opened, SimulationRun)
    return opened


def test_looking_more_often_changes_nothing(tmp_path: Path) -> None:
    rarely, often = run(tmp_path), run(tmp_path)
    frames = [rarely.at(t).points for t in TIMES]
    found = {t: often.at(t).points for t in np.union1d(TIMES, np.arange(40) / 41)}
    for t, points in zip(TIMES, frames, strict=True):
        assert_array_equal(found[t], points)
    assert_allclose(frames[-1], [[np.cos(2), np.sin(2), 0]], atol=2e-4)


def test_a_run_is_resumed_from_a_state(tmp_path: Path) -> None:
    whole = run(tmp_path)
    whole.at(0.3)
    rest = SimulationRun("it", whole.simulation, 0.0, 0.01, whole.state)
    assert_array_equal(rest.at(1.0).points, whole.at(1.0).points)
    assert whole.report() == {
        "name": "it",
        "steps": 100,
        "radius": pytest.approx(1, abs=1e-5),
    }
    with raises(OptionError, "SIM002"):
        whole.at(0.5)


def test_it_begins_in_its_preroll(tmp_path: Path) -> None:
    early = run(tmp_path, preroll=0.5)
    assert_allclose(early.at(0.0).points, run(tmp_path).at(0.5).points, atol=1e-12)


def test_colliders_are_read_at_their_places(tmp_path: Path) -> None:
    assert run(tmp_path, colliders=[FLOOR]).at(0.0).points[0, 1] == 0.25
    bad = {**FLOOR, "restitution": 2.0}
    setup, document = read(tmp_path, colliders=[FLOOR, bad])
    assert setup is None
    with pytest.raises(FormatError) as caught:
        document.check()
    (fault,) = caught.value.faults
    assert (fault.code, fault.where) == (
        "SIM020",
        "systems[0].swing.colliders[1].restitution",
    )


def test_keys_are_read_as_their_types_say(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", masses=[1.0, 2.0])
    setup, document = read(
        tmp_path,
        forces=[{"gravity": None}, {"wind": {"velocity": [1, 0, 0], "drag": 2}}],
        masses="a.npz#masses",
        goal={"at": [1, 2, 3]},
        kill=[FLOOR],
        flocks=[{"place": {"disc": {"radius": 2}}}, {"wing": {"plane": None}}],
    )
    assert setup is not None, document
    parts = setup.entries
    assert parts["forces"] == [Gravity(), Wind(velocity=(1.0, 0.0, 0.0), drag=2.0)]
    assert_array_equal(parts["masses"], [1, 2])
    assert_array_equal(parts["goal"]["poses"].rows[0, :3], [1, 2, 3])
    assert_array_equal(parts["kill"][0].poses.rows[0, :3], FLOOR["at"])
    assert parts["flocks"] == [
        {"place": Disc(2.0)},
        {"place": Point(), "wing": Plane()},
    ]
    assert setup.reads == ("2 forces",)


@pytest.mark.parametrize(
    ("keys", "code", "where"),
    [
        ({"forces": [{"gravity": None}, {"wnd": None}]}, "SIM023", "forces[1].wnd"),
        (
            {"forces": [{"drag": {"linear": -1.0}}]},
            "SIM022",
            "forces[0].drag.linear",
        ),
        ({"masses": "b.npz"}, "DOC015", "masses"),
        ({"goal": {"moves": [[1, 0, 0, 0], [0, 0, 0, 0]]}}, "SIM020", "goal.moves"),
        ({"kill": [{**FLOOR, "friction": -1.0}]}, "SIM020", "kill[0].friction"),
        ({"flocks": [{"place": {"disk": None}}]}, "SIM021", "flocks[0].place.disk"),
        (
            {"flocks": [{"place": {"disc": {"radius": -1.0}}}]},
            "SIM020",
            "flocks[0].place",
        ),
        (
            {"flocks": [{"wing": {"sphere": {"radius": 0.0}}}]},
            "SIM020",
            "flocks[0].wing",
        ),
    ],
)
def test_faults_of_keys_are_at_their_places(
    tmp_path: Path, keys: dict[str, Any], code: str, where: str
) -> None:
    setup, document = read(tmp_path, **keys)
    assert setup is None
    with pytest.raises(FormatError) as caught:
        document.check()
    (fault,) = caught.value.faults
    assert (fault.code, fault.where) == (code, f"systems[0].swing.{where}")


def test_methods_and_steps_are_tried_against_finer_ones(tmp_path: Path) -> None:
    ((_, trial),) = system_trials([system(tmp_path)], TIMES)
    rows = measure(trial).rows
    assert trial.chosen_setting in trial.settings()
    for method, order in (("euler", 1), ("midpoint", 2)):
        errors = [row.error.largest for row in rows if row.setting.method == method]
        assert len(errors) == 4
        assert all(a > 1.6**order * b for a, b in pairwise(errors))


def test_a_file_with_a_method_is_simulated_by_it(tmp_path: Path) -> None:
    ((_, trial),) = system_trials([system(tmp_path)], TIMES)
    (setting,) = [
        one for one in trial.settings() if one == Setting.of("euler", step=0.02)
    ]
    euler = run(tmp_path, method="euler", step=0.02)
    for t, shot in zip(TIMES, trial.run(setting).snapshots, strict=True):
        assert_array_equal(euler.at(t).points, shot.points)
    assert system(tmp_path, method="euler").setup.summary == (
        "it, by euler in steps of 0.01 s"
    )


def test_what_blows_up_is_stopped(tmp_path: Path) -> None:
    with (
        np.errstate(all="ignore"),
        raises(ToleranceError, "SIM102", match="point 0"),
    ):
        run(tmp_path, speed=1e18).at(1.0)


@pytest.mark.slow
def test_copies_that_turn_in_place_are_measured_by_angles(tmp_path: Path) -> None:
    ((_, trial),) = system_trials([system(tmp_path, copies=True)], TIMES)
    table = measure(trial)
    assert table.reference is not None
    assert table.reference.order == pytest.approx(2, abs=0.1)
    rows = [row for row in table.rows if row.setting.method == "midpoint"]
    errors = [row.error for row in rows if row.error is not None]
    angles = [error.angle for error in errors if error.angle is not None]
    assert len(angles) == 4
    assert {error.largest for error in errors} == {0.0}
    assert_allclose(angles[:-1], 4 * np.array(angles[1:]), rtol=0.1)
    # One step for all is fast, and yet no more exact.
    assert not any(row.recommended for row in rows if row.setting["step"] > 0.01)
    text = TABLES.text(Tradeoffs(tmp_path, [table]))
    assert any("rms deg" in line for line in text)


@pytest.mark.parametrize("speed", [2.0, 1e18])
def test_copies_that_turn_are_shown_and_stopped(tmp_path: Path, speed: float) -> None:
    opened = run(tmp_path, speed=speed, copies=True, method="euler")
    if speed == 2.0:
        frame = opened.at(0.3)
        assert isinstance(frame, TransformsFrame)
        assert_allclose(np.linalg.norm(frame.rotations, axis=1), 1)
        ((_, trial),) = system_trials([system(tmp_path, copies=True)], TIMES)
        (shot, *_) = trial.run(trial.chosen_setting).snapshots
        assert shot.ids is not None
        return
    with (
        np.errstate(all="ignore"),
        raises(ToleranceError, "SIM102", match="point 0"),
    ):
        opened.at(1.0)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("velocities", {"velocities": np.array([[0.0, 2e30, 0.0]])}),
        ("rotations", {"rotations": np.array([[2e30, 0.0, 0.0, 1.0]])}),
        ("scales", {"scales": np.array([[1.0, -1e200, 1.0]])}),
        ("spins", {"spins": np.array([[np.nan, 0.0, 0.0]])}),
        ("primvars:heat", {"primvars": {"heat": np.array([1e31])}}),
    ],
)
def test_numbers_that_no_file_holds_are_said_by_the_simulation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, field: str, value: dict[str, Any]
) -> None:
    """SIM102 names what it is and when, before a writer would refuse it (USD170)."""
    opened = run(tmp_path, copies=True)
    frame = opened.at(0.05)
    changed = replace(frame, **value)
    monkeypatch.setattr(type(opened.simulation), "frame", lambda *_: changed)
    with raises(ToleranceError, "SIM102", match=rf"{field}\[0\]") as caught:
        opened.at(0.1)
    step = float((caught.value.faults[-1].hint or "").split()[2].rstrip(","))
    assert 0.4 * opened.run.step_length <= step <= 0.5 * opened.run.step_length
