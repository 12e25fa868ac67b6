"""Bodies that are placed for twice their size."""

from __future__ import annotations

from pathlib import Path

import pytest

from animtool.validation.run import validate

SCENE = """\
scene: animtool/1
fps: 24
range: [1, 2]
systems:
- rigid:
    name: row
    bodies:
{bodies}
    colliders: [{{shape: {{plane: }}}}]
output: {{file: row.usda}}
"""
BOX = (
    "    - {{name: b{k}, shape: {{box: {{size: [0.1, {h}, 0.1]}}}}, at: [{k}, {y}, 0]}}"
)
BALL = "    - {{name: b{k}, shape: {{sphere: {{radius: {h}}}}}, at: [{k}, {y}, 0]}}"


@pytest.mark.parametrize(
    ("shape", "height", "ys", "written"),
    [
        (BOX, 0.2, (0.2, 0.2), "size: [200 mm, 400 mm, 200 mm]"),
        (BALL, 0.1, (0.2, 0.2, 0.6), "radius: 200 mm"),
        (BOX, 0.2, (0.2,), ""),  # one may be dropped
        (BOX, 0.2, (0.1, 0.2), ""),  # one stands on the ground
        (BOX, 0.2, (0.25, 0.25), ""),
        (BOX, 0.2, (0.1, 0.1), ""),
    ],
)
def test_half_extents(
    tmp_path: Path, shape: str, height: float, ys: tuple[float, ...], written: str
) -> None:
    rows = [shape.format(k=k, h=height, y=y) for k, y in enumerate(ys)]
    path = tmp_path / "row.scene.yaml"
    path.write_text(SCENE.format(bodies="\n".join(rows)), "utf-8")
    hints = [str(fault.hint) for fault in validate(path) if fault.code == "SIM200"]
    assert [hint.partition("write ")[2] for hint in hints] == [written] * bool(written)


def test_height_is_that_above_the_ground_whatever_is_up(tmp_path: Path) -> None:
    box = (
        "    - {{name: b{k}, shape: {{box: {{size: [0.1, 0.1, 0.3]}}}}, "
        "at: [{k}, 0, {z}]}}"
    )
    codes = []
    for z in (0.3, 0.2):  # half of its height above the ground; half of its width
        rows = "\n".join(box.format(k=k, z=z) for k in range(3))
        text = SCENE.format(bodies=rows).replace(
            "plane: ", "plane: {normal: [0, 0, 1]}"
        )
        path = tmp_path / "row.scene.yaml"
        path.write_text(text, "utf-8")
        codes.append([f.code for f in validate(path) if f.code == "SIM200"])
    assert codes == [["SIM200"], []]
