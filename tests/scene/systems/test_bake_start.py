from __future__ import annotations

from pathlib import Path

from pxr import Sdf
from support.cli import animtool

SCENE = """\
scene: animtool/1
fps: 24
range: [1, 9]
systems:
- particles:
    name: embers
    emitters: [{rate: 200, speed: 3, lifetime: 0.2}]
"""


def points(path: Path) -> dict[float, list[tuple[float, ...]]]:
    layer = Sdf.Layer.FindOrOpen(str(path))
    at = next(
        found
        for found in _paths(layer)
        if found.name == "points" and layer.GetNumTimeSamplesForPath(found)
    )
    return {
        code: [tuple(point) for point in layer.QueryTimeSample(at, code)]
        for code in layer.ListTimeSamplesForPath(at)
    }


def _paths(layer: Sdf.Layer) -> list[Sdf.Path]:
    paths: list[Sdf.Path] = []
    layer.Traverse(Sdf.Path.absoluteRootPath, paths.append)
    return paths


def test_start_is_the_time_code_of_0_s(tmp_path: Path) -> None:
    """So a range that is shifted by as much has the same motion; help says so."""
    scene = tmp_path / "e.scene.yaml"
    scene.write_text(SCENE)
    given = ["--start", 12, "--range", "12-20"]
    for name, options in (("a", []), ("b", given)):
        done = animtool("bake", scene, "-o", tmp_path / f"{name}.usda", *options)
        assert done.code == 0, done.stderr
    one, two = points(tmp_path / "a.usda"), points(tmp_path / "b.usda")
    assert one[9.0]
    assert {code + 11: row for code, row in one.items()} == two
    text = " ".join(animtool("bake", "--help").stdout.split())
    assert "that of 0 s, when the simulation starts" in text
