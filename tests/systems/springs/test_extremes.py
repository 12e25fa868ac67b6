"""Numbers of systems that nothing can be simulated with."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fuzz.targets.springs import _COMMON as COMMON
from fuzz.targets.springs import _SYSTEMS as SYSTEMS
from support.simulated import Simulator

from animtool.core.errors import AnimtoolError, Severity
from animtool.scene.file.read import load_scene
from animtool.scene.systems.simulation import open_systems
from animtool.systems.framework.meter import PeakValue
from animtool.systems.springs.motion import Piercing, piercing_notices


def last_points(folder: Path, kind: str, changes: dict[str, Any]) -> np.ndarray:
    """Return where a system is after some frames, with keys by their ways."""
    entry = copy.deepcopy(SYSTEMS[kind]) | (COMMON if kind != "particles" else {})
    for way, value in changes.items():
        *owners, last = way.split(".")
        at: Any = entry
        for key in owners:
            at = at[int(key) if key.isdigit() else key]
        at[int(last) if last.isdigit() else last] = value
    scene = {
        "scene": "animtool/1",
        "fps": 24,
        "range": [1, 3],
        "systems": [{kind: entry}],
        "output": {"file": "shot.usdc"},
    }
    path = folder / "shot.scene.yaml"
    path.write_text(json.dumps(scene), "utf-8")
    opened = open_systems(load_scene(path).systems, 2 / 24)
    (system,) = opened
    return np.asarray(system.at(2 / 24).points)


@pytest.mark.parametrize(
    ("kind", "changes", "code", "where"),
    [
        ("rope", {"mass": 1e-300}, "SIM040", "mass"),
        ("rope", {"tip_mass": 1e-310}, "SIM040", "tip_mass"),
        ("cloth", {"self_contact.thickness": 0.0}, "DOC022", "thickness"),
        ("particles", {"emitters.0.rate": 1e12}, "DOC022", "rate"),
        ("particles", {"emitters.0.direction.1": 5e-324}, "SIM021", "direction"),
        (
            "rope",
            {"springs.structural.stiffness": 1e12, "solver": "symplectic_euler"},
            "SIM004",
            "",
        ),
        ("cloth", {"step": 1e6}, "SIM102", ""),
        (
            "rope",
            {"springs.structural.stiffness": 1e18, "mass": 1e-18},
            "SIM178",
            "",
        ),
    ],
)
def test_numbers_beyond_bounds_have_a_code_and_a_place(
    tmp_path: Path, kind: str, changes: dict[str, Any], code: str, where: str
) -> None:
    with pytest.raises(AnimtoolError) as raised:
        last_points(tmp_path, kind, changes)
    faults = [fault for fault in raised.value.faults if fault.code == code]
    assert faults
    assert where in str(faults[0])


@pytest.mark.parametrize(
    ("kind", "changes"),
    [
        ("rope", {"springs.structural.stiffness": 1e12}),
        ("rope", {"mass": 1e-12}),
        ("rope", {"step": 1000.0, "solver": "xpbd"}),
        ("particles", {"emitters.0.bursts.0.1": 1e12}),
        ("particles", {"emitters.0.rate": 1e9}),
    ],
)
def test_numbers_within_bounds_come_to_numbers(
    tmp_path: Path, kind: str, changes: dict[str, Any]
) -> None:
    assert np.isfinite(last_points(tmp_path, kind, changes)).all()


def test_surfaces_that_went_on_without_end_have_a_hint() -> None:
    (notice,) = piercing_notices(Piercing(rate=float("inf")))
    assert (notice.code, notice.severity) == ("SIM165", Severity.WARNING)
    assert "shorter" in (notice.hint or "")


def test_fast_surfaces_that_nothing_pierces_are_a_note() -> None:
    (notice,) = piercing_notices(Piercing(rate=900.0), is_intact=True)
    assert (notice.code, notice.severity) == ("SIM165", Severity.NOTE)
    passed = piercing_notices(Piercing(passed=1, rate=900.0), is_intact=True)
    assert [one.severity for one in passed] == 2 * [Severity.WARNING]


@pytest.mark.parametrize(("pierced", "severity"), [(0.0, "note"), (2.0, "warning")])
def test_fast_cloth_is_judged_by_the_frames_of_a_scene(
    tmp_path: Path, pierced: float, severity: str
) -> None:
    cloth = {
        **{"mass": 0.1, "corner": [0, 1, 0], "across": [0.4, 0, 0], "up": [0, 0, 0.4]},
        **{"resolution": [5, 5], "springs": {"structural": {"stiffness": 50}}},
        **{"self_contact": {"thickness": 0.04}, "solver": "xpbd"},
    }
    (system,) = Simulator(tmp_path).scene([{"cloth": cloth}]).systems
    (entry,) = open_systems([system], 0.1)
    entry.at(0.0)
    simulation: Any = entry.run.simulation
    simulation.grid = replace(simulation.grid, piercing=Piercing(rate=900.0))
    (view,) = simulation.views
    view._meter.pierced = PeakValue(pierced)
    (notice,) = (one for one in simulation.notices if one.code == "SIM165")
    assert str(notice.severity) == severity
