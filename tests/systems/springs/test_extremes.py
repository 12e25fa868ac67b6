"""Numbers of systems that nothing can be simulated with."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fuzz.targets.springs import _COMMON as COMMON
from fuzz.targets.springs import _SYSTEMS as SYSTEMS

from animtool.core.errors import AnimtoolError
from animtool.scene.file.read import load_scene
from animtool.scene.systems.simulation import open_systems
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
    assert notice.code == "SIM165"
    assert "shorter" in (notice.hint or "")
