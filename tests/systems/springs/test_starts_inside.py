"""A cloth that starts inside a collider has one finding, with the way out."""

from __future__ import annotations

from pathlib import Path

import pytest

from animtool import BakeOptions, bake

SCENE = """\
scene: animtool/1
fps: 24
range: [1, 3]
systems:
- cloth:
    name: sheet
    mass: 0.2
    corner: [-0.5, {y}, 0.5]
    across: [1, 0, 0]
    up: [0, 0, -1]
    resolution: [9, 9]
    springs: {{structural: {{stiffness: 200, ratio: 0.1}}}}
    radius: 0.004
    colliders: [{{shape: {{box: {{size: [0.6, 0.8, 0.6]}}}}, at: [0, 0.4, 0]}}]
output: {{file: sheet.usda}}
"""


@pytest.mark.parametrize(("y", "lift"), [(0.4, 0.45), (0.6, 0.25), (0.85, None)])
def test_the_lift_out_of_a_collider(
    tmp_path: Path, y: float, lift: float | None
) -> None:
    path = tmp_path / "sheet.scene.yaml"
    path.write_text(SCENE.format(y=y), "utf-8")
    report = bake(path, tmp_path / "sheet.usda", BakeOptions())
    notices = [n for n in report.notices if n.code not in {"SIM130", "SIM194"}]
    if lift is None:
        assert "SIM180" not in [notice.code for notice in notices]
        return
    (notice,) = notices
    assert notice.code == "SIM180"
    millimetres = float(str(notice.hint).split("up by ")[1].split()[0])
    assert millimetres / 1000 == pytest.approx(lift, abs=0.05)
    raised = SCENE.format(y=y + millimetres / 1000)
    path.write_text(raised, "utf-8")
    again = bake(path, tmp_path / "out.usda", BakeOptions())
    assert "SIM180" not in [notice.code for notice in again.notices]
