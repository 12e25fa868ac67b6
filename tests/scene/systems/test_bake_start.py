from __future__ import annotations

import re
from pathlib import Path

import pytest
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


@pytest.mark.parametrize(
    ("options", "count"),
    [
        ((), 0),
        (("--start", 9), 0),
        (("--start", 10), 1),
        (("--start", 1001), 1),
        (("--start", 1001, "--range", "1001-1009"), 0),
        (("--start", 1001, "--range", "5"), 1),
    ],
)
def test_frames_that_are_all_before_0_s(
    tmp_path: Path, options: tuple[object, ...], count: int
) -> None:
    scene = tmp_path / "e.scene.yaml"
    scene.write_text(SCENE)
    done = animtool("bake", scene, "-o", tmp_path / "a.usda", *options)
    assert done.code == 0, done.stderr
    assert done.stderr.count("SIM203") == count


@pytest.mark.parametrize(
    ("frames", "preroll", "count"),
    [("[1, 1]", 0, 1), ("[1, 1]", 1, 0), ("[1, 2]", 0, 0)],
)
def test_a_scene_of_the_first_frame_alone(
    tmp_path: Path, frames: str, preroll: int, count: int
) -> None:
    scene = tmp_path / "e.scene.yaml"
    text = SCENE.replace("name: embers", f"name: embers\n    preroll: {preroll}")
    text = re.sub("range: .*", f"range: {frames}", text)
    scene.write_text(f"{text}output: {{file: a.usda}}\n")
    assert animtool("validate", scene).stdout.count("SIM203") == count


@pytest.mark.slow
def test_the_start_of_a_scene_is_after_its_frames(tmp_path: Path) -> None:
    scene = tmp_path / "e.scene.yaml"
    for start, preroll, count in ((1001, 0, 1), (1001, 60, 0), (9, 0, 0)):
        text = SCENE.replace("name: embers", f"name: embers\n    preroll: {preroll}")
        scene.write_text(f"{text}output: {{file: a.usda, start: {start}}}\n")
        for command in ("validate", "bake"):
            done = animtool(command, scene, *["--overwrite"] * (command == "bake"))
            assert (done.stdout + done.stderr).count("SIM203") == count
