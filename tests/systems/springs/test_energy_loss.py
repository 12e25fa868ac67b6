"""Energy that solvers take by themselves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from animtool import BakeOptions, bake
from animtool.core.shot import FrameRange
from animtool.scene.file.read import load_scene
from animtool.sim.system import Energy
from animtool.systems.springs.notices import (
    MIN_REPORTED_FRACTION,
    REST_SPEED,
    EnergyLoss,
)
from animtool.systems.springs.records import Solver

SWING = """\
scene: animtool/1
fps: 24
range: [1, {frames}]
systems:
- rope:
    name: r
    from: [0, 2, 0]
    to: [{side}, {low}, 0]
    count: {count}
    mass: {mass}
    springs: {{structural: {{stiffness: {stiffness}}}}}
    pins: [{{particles: [start]}}]
{more}output: {{file: shot.usdc}}
"""


def baked(folder: Path, more: str = "", **changes: float) -> list[str]:
    """Return codes of a rope that swings."""
    values = {"side": 0.5, "low": 1.2, "count": 11, "mass": 0.2, "stiffness": 2000}
    values |= {"frames": 121} | changes
    path = folder / "shot.scene.yaml"
    path.write_text(SWING.format(**values, more=more), "utf-8")
    last = int(values["frames"])
    options = BakeOptions(overwrite=True, frame_range=FrameRange(1, last))
    report = bake(load_scene(path), folder / "shot.usdc", options)
    return sorted({n.code for n in report.notices} - {"SIM130"})


@pytest.mark.parametrize("solver", ["xpbd", "implicit_euler"])
@pytest.mark.parametrize(
    "changes", [{}, {"mass": 2.0, "count": 6}, {"stiffness": 2e4, "low": 0.5}]
)
def test_what_damps_a_swing_is_said(
    tmp_path: Path, solver: str, changes: dict[str, float]
) -> None:
    assert "SIM196" in baked(tmp_path, f"    solver: {solver}\n", **changes)


@pytest.mark.parametrize("more", ["", "    solver: bdf2\n", "    step: 0.01\n"])
def test_what_keeps_a_swing_says_nothing(tmp_path: Path, more: str) -> None:
    assert baked(tmp_path, more) == []


@pytest.mark.parametrize(
    "keys", ["drag: 0.5", "settle: true", "wind: {velocity: [1, 0, 0]}"]
)
def test_what_is_slowed_or_at_rest_is_not_said(tmp_path: Path, keys: str) -> None:
    assert "SIM196" not in baked(tmp_path, f"    solver: xpbd\n    {keys}\n", frames=25)


def test_the_share_is_of_the_energy_that_moves() -> None:
    losses = EnergyLoss(mass=2.0)
    for t, kinetic, potential in [(0, 0, 5), (1, 4, 1), (2, 0, 4.5)]:
        losses.record(t, Energy(kinetic, potential))
    assert losses.fraction == pytest.approx(0.5 / 4)
    (notice,) = losses.notices(Solver.XPBD)
    assert notice.code == "SIM196"
    losses.record(3, Energy(0.0, 5 - 0.9 * MIN_REPORTED_FRACTION * 4))
    assert losses.notices(Solver.XPBD) == []


def test_what_hardly_moves_loses_nothing() -> None:
    losses = EnergyLoss(mass=2.0)
    losses.record(0, Energy(0.9 * REST_SPEED**2, 1.0))
    losses.record(1, Energy(0.0, 0.0))
    assert losses.fraction == 0.0
    assert np.isfinite(losses.fraction)


@pytest.mark.parametrize(("kinetic", "share"), [(0.9e-6, 0.0), (1.5e-6, 0.2)])
def test_what_goes_slower_than_a_millimetre_a_second_rests(
    kinetic: float, share: float
) -> None:
    """Of 2 kg that is a millionth of a joule."""
    losses = EnergyLoss(mass=2.0)
    losses.record(0.0, Energy(0.0, 1.0))
    losses.record(1.0, Energy(kinetic, 1.0 - 1.2 * kinetic))
    assert losses.fraction == pytest.approx(share, rel=1e-6)
