"""Springs that begin at rest stay there under every solver."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from animtool import BakeOptions, bake
from animtool.scene.file.read import load_scene
from animtool.systems.springs import Solver

ROPE = """\
- rope:
    name: line
    from: [0, 2, 0]
    to: [0, 1, 0]
    count: {count}
    mass: 0.1
    tip_mass: {tip}
    springs: {{structural: {{axial_stiffness: {axial}, ratio: 0.2}}}}
    pins: [{{particles: [start]}}]
"""
CLOTH = """\
- cloth:
    name: line
    corner: [0, 1, 0]
    across: [1, 0, 0]
    up: [0, 1, 0]
    resolution: [7, 7]
    mass: 0.3
    springs: {structural: {stiffness: 500}, diagonals: {stiffness: 200}}
    pins: [{particles: [top]}]
"""


def points(folder: Path, entry: str, solver: str) -> tuple[np.ndarray, set[str]]:
    """Return points ``(F, N, 3)`` of a system that settles, and what was said."""
    path = folder / "shot.scene.yaml"
    text = f"scene: animtool/1\nfps: 24\nrange: [1, 49]\nsystems:\n{entry}"
    text += f"    settle: true\n    solver: {solver}\noutput: {{file: shot.usdc}}\n"
    path.write_text(text, "utf-8")
    report = bake(load_scene(path), folder / "shot.usdc", BakeOptions(overwrite=True))
    stage = Usd.Stage.Open(str(folder / "shot.usdc"))
    prim = UsdGeom.PointBased(stage.GetPrimAtPath("/shot/line"))
    rows = [prim.GetPointsAttr().Get(code) for code in range(1, 50)]
    codes = {n.code for n in report.notices} - {"SIM130"}
    return np.array(rows, np.float64), codes


@pytest.mark.parametrize("solver", list(Solver))
@pytest.mark.parametrize(
    "entry",
    [
        ROPE.format(count=11, tip=1.0, axial=2e3),
        ROPE.format(count=41, tip=0.5, axial=5e3),
        CLOTH,
    ],
    ids=["short", "long", "cloth"],
)
def test_what_settles_stays_under_every_solver(
    tmp_path: Path, entry: str, solver: str
) -> None:
    found, codes = points(tmp_path, entry, solver)
    assert np.abs(found - found[0]).max() < 1e-5
    assert codes <= {"SIM199", "SIM161"}


@pytest.mark.parametrize(
    ("count", "tip", "axial"), [(31, 5.0, 2e4), (151, 5.0, 2e4), (81, 1.0, 4e3)]
)
def test_auto_stretches_as_the_law_says(
    tmp_path: Path, count: int, tip: float, axial: float
) -> None:
    found, codes = points(
        tmp_path, ROPE.format(count=count, tip=tip, axial=axial), "auto"
    )
    lengths = np.linalg.norm(np.diff(found, axis=1), axis=2).sum(axis=1)
    # Of each spring what hangs below its middle; the first particle bears nothing.
    each = 0.1 / count
    below = tip + each * (np.arange(count - 1))
    law = 9.81 * below.sum() / (count - 1) / axial
    np.testing.assert_allclose(lengths - 1, law, atol=1e-5)
    assert codes == set()


@pytest.mark.slow
def test_a_rest_of_xpbd_that_is_lower_is_said(tmp_path: Path) -> None:
    entry = ROPE.format(count=151, tip=5.0, axial=2e4)
    found, codes = points(tmp_path, entry, "xpbd")
    assert np.abs(found - found[0]).max() < 1e-5
    assert codes == {"SIM199"}


def test_auto_rests_as_near_as_shorter_steps_bring_it(tmp_path: Path) -> None:
    contact = "    self_contact: {thickness: 0.01}\n"
    found, codes = points(tmp_path, CLOTH + contact, "auto")
    assert np.abs(found - found[0]).max() < 1e-5
    free, _ = points(tmp_path, CLOTH, "auto")
    assert np.abs(found[0] - free[0]).max() < 2e-3
    assert codes <= {"SIM179", "SIM161"}
