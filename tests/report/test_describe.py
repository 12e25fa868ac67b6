from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pxr import Usd
from support.bvh import random_rows, read_reference, small_bvh
from support.cli import animtool
from support.drifting import author_samples

from animtool.cli.info import TEMPLATES
from animtool.core.files.reading import recorded_inputs
from animtool.core.values import plain_value
from animtool.report import describe as module
from animtool.report.describe import describe
from animtool.usd.caches.info import describe_points


def test_numbers(tmp_path: Path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "take.bvh"
    rows = random_rows(30)
    rows[:, 6:] = 5.0
    path.write_text(small_bvh(rows, frame_time="0.0417083750417"))
    monkeypatch.setattr(module, "BLOCK_FRAMES", 7)
    found = describe(path)
    truth = read_reference(path).positions(np.arange(30))
    assert_allclose(found.bounds[0], truth.min(axis=(0, 1)), rtol=1e-12)
    assert_allclose(found.bounds[1], truth.max(axis=(0, 1)), rtol=1e-12)
    assert found.animated == {"translation": 1, "rotation": 1}
    values = plain_value(found)
    assert values["rate"] == "24000/1001"
    assert json.dumps(values)


def test_frames_between_time_codes(tmp_path: Path) -> None:
    """The rate is that of frames, and what lies between time codes its step."""
    times = [1 + 1.25 * i for i in range(9)]
    found = describe(author_samples(tmp_path / "in.usda", times, rate=30))
    assert (found.fps, found.step, found.frames) == (24, Fraction(5, 4), 9)
    assert (found.start, found.end, found.duration) == (1, 11, Fraction(1, 3))


SCENE = """\
scene: animtool/1
fps: 24
range: [1, 9]
systems:
- particles:
    name: embers
    emitters: [{rate: 200, speed: 3, lifetime: 0.2}]
- cloth:
    name: flag
    mass: 0.3
    across: [1, 0, 0]
    resolution: [4, 3]
    springs: {structural: {stiffness: 100}}
- rope:
    name: cord
    from: [0, 1, 0]
    to: [1, 1, 0]
    count: 5
    mass: 0.1
    springs: {structural: {stiffness: 100}}
"""


def baked(folder: Path, *options: object) -> Path:
    (folder / "shot.scene.yaml").write_text(SCENE, "utf-8")
    done = animtool("bake", "shot.scene.yaml", "-o", "shot.usdc", *options, cwd=folder)
    assert done.code == 0, done.stderr
    return folder / "shot.usdc"


def test_what_is_simulated_in_numbers(tmp_path: Path) -> None:
    path = baked(tmp_path)
    found = describe_points(path)
    assert found is not None
    assert found.types == {"Points": 1, "Mesh": 1, "BasisCurves": 1}
    assert (found.frames, found.fps, found.units, found.up) == (9, 24, "m", "Y")
    assert (found.start, found.end, found.duration) == (1, 9, 8 / found.fps)
    embers, flag, cord = found.prims
    assert embers.points[0] < embers.points[1] == 40
    assert (embers.fixed, embers.ids, embers.widths) == (False, True, True)
    assert embers.primvars == ["age"]
    assert (flag.points, flag.pieces, flag.piece_count) == ((12, 12), "faces", (6, 6))
    assert (flag.fixed, flag.velocities, flag.ids) == (True, True, False)
    assert (cord.points, cord.piece_count, cord.samples) == ((5, 5), (1, 1), 9)
    stage = Usd.Stage.Open(str(path))
    extents = stage.GetPrimAtPath("/shot/flag").GetAttribute("extent")
    corners = [extents.Get(code) for code in range(1, 10)]
    assert flag.extent is not None
    assert flag.extent[0][1] == min(low[1] for low, _ in corners)
    assert flag.extent[1][1] == max(high[1] for _, high in corners)


def test_chunks_say_what_one_file_says(tmp_path: Path) -> None:
    whole = describe_points(baked(tmp_path))
    path = baked(tmp_path, "--chunk", 4, "--overwrite")
    joined = describe_points(path)
    assert whole is not None
    assert joined is not None
    assert joined.prims == whole.prims
    ((name, files),) = [(chunk.name, chunk.files) for chunk in joined.chunks]
    assert (name, len(files), whole.chunks) == ("systems", 3, [])
    part = describe_points(tmp_path / "shot.systems.0001.usdc")
    assert part is not None
    assert (part.types, part.frames) == ({"": 3}, 5)


def test_a_chunk_that_is_not_there_is_named(tmp_path: Path) -> None:
    path = baked(tmp_path, "--chunk", 4)
    (tmp_path / "shot.systems.0002.usdc").unlink()
    found = describe_points(path)
    assert found is not None
    assert [len(chunk.missing) for chunk in found.chunks] == [1]
    assert [notice.code for notice in found.notices] == ["USD276"]
    assert [prim.points for prim in found.prims][1:] == [(12, 12), (5, 5)]


def test_one_mesh_of_copies_is_one_mesh(tmp_path: Path) -> None:
    scene = tmp_path / "crate.scene.yaml"
    scene.write_text(
        "scene: animtool/1\nrange: [1, 2]\nsystems:\n- rigid: {name: crates, bodies: "
        "[{name: crate, shape: {box: {size: [1, 1, 1]}}}]}\n",
        "utf-8",
    )
    assert animtool("bake", scene).code == 0
    done = animtool("info", tmp_path / "crate.usdc")
    assert "crates: 1 point, 1 mesh, 2 samples" in done.stdout


def test_info_of_points(tmp_path: Path) -> None:
    path = baked(tmp_path, "--chunk", 4)
    done = animtool("info", path)
    assert done.code == 0, done.stderr
    lines = done.stdout.splitlines()
    assert "  prims     1 Points, 1 Mesh, 1 BasisCurves" in lines
    assert "  frames    9 at 24 fps, 0.3333 s, time codes 1 to 9" in lines
    assert "  chunks    systems of /shot: 3 files" in lines
    (mesh,) = [line for line in lines if line.startswith("  mesh ")]
    assert mesh.startswith(
        "  mesh      /shot/flag: 12 points, 6 faces, 9 samples, time codes 1 to 9, "
        "with velocities, normals, from ("
    )
    (points,) = [line for line in lines if line.startswith("  points ")]
    assert "velocities, widths, ids, age, not the same all along" in points
    done = animtool("info", path, "--format", "json")
    (found,) = json.loads(done.stdout)["files"]
    assert found["prims"][1]["points"] == [12, 12]
    assert found["chunks"][0]["missing"] == []


def test_of_a_still_mesh_that_there_is_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "set.usda"
    path.write_text(
        '#usda 1.0\n(metersPerUnit = 0.01\nupAxis = "Z")\n'
        'def Mesh "Rock" {\npoint3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]\n'
        "int[] faceVertexCounts = [3]\nint[] faceVertexIndices = [0, 1, 2]\n}\n"
    )
    found = describe_points(path)
    assert found is not None
    (rock,) = found.prims
    assert (rock.samples, rock.first, rock.extent) == (0, None, None)
    assert (found.frames, found.units, found.up) == (0, "cm", "Z")
    text = animtool("info", path).stdout
    assert "  mesh      /Rock: 3 points, 1 face, never move\n" in text


@pytest.mark.parametrize("count", [20, 21])
def test_many_prims_are_counted_beyond_the_first(tmp_path: Path, count: int) -> None:
    path = tmp_path / "many.usda"
    mesh = "{\npoint3f[] points = [(0, 0, 0)]\n}\n"
    prims = "".join(f'def Mesh "m{i}" {mesh}' for i in range(count))
    path.write_text("#usda 1.0\n" + prims)
    with recorded_inputs() as inputs:
        found = describe_points(path)
    assert path in inputs.states
    assert found is not None
    more = [
        line
        for line in TEMPLATES["PointsDescription"].text(found)
        if line.startswith("  and ")
    ]
    assert more == ["  and       1 more"] * (count - 20)


def test_a_stage_of_neither_is_refused_as_before(tmp_path: Path) -> None:
    path = tmp_path / "bare.usda"
    path.write_text('#usda 1.0\ndef Xform "World" {}\n')
    assert describe_points(path) is None
    done = animtool("info", path)
    assert (done.code, "USD008" in done.stderr) == (3, True)


def test_points_props_a_character_have_a_line(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text(small_bvh(random_rows(6)))
    path = tmp_path / "shot.scene.yaml"
    props = SCENE.replace("range: [1, 9]\n", "source: {file: walk.bvh}\n")
    path.write_text(props, "utf-8")
    assert animtool("bake", path, "-o", tmp_path / "shot.usdc").code == 0
    assert describe_points(tmp_path / "shot.usdc") is None
    done = animtool("info", tmp_path / "shot.usdc")
    assert "  joints    2 below Hips" in done.stdout
    assert "/flag: 12 points, 6 faces, " in done.stdout
    done = animtool("info", tmp_path / "shot.usdc", "--format", "json")
    (found,) = json.loads(done.stdout)["files"]
    assert [prim["type"] for prim in found["points"]] == [
        "Points", "Mesh", "BasisCurves",
    ]  # fmt: skip
