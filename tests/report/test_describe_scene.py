"""What is said of a scene before anything of it is read."""

from __future__ import annotations

import json
from pathlib import Path

from support.bvh import random_rows, small_bvh
from support.cli import animtool
from support.props import write_props

from animtool.core.values import plain_value
from animtool.report.describe_scene import describe_scene
from animtool.scene.file.read import load_scene

SYSTEMS = """\
scene: animtool/1
fps: 24000/1001
range: [1, 12]
systems:
- cloth:
    name: flag
    mass: 0.3
    across: [1, 0, 0]
    resolution: [4, 3]
    springs: {structural: {stiffness: 100}}
    solver: xpbd
    step: 0.01
    colliders: [{shape: {plane: {}}}]
- rope:
    name: cord
    from: [0, 1, 0]
    to: [1, 1, 0]
    count: 5
    mass: 0.1
    springs: {structural: {stiffness: 100}}
    pins: [{particles: [start], to: {system: flag, particles: [0]}}]
- particles:
    name: snow
    max_particles: 50
    emitters: [{rate: 20, speed: 1}]
    forces: [{gravity: }]
    systems: [{system: flag}]
output: {file: snow.usdc, chunk: 5}
"""


def described(folder: Path, text: str) -> dict[str, object]:
    path = folder / "shot.scene.yaml"
    path.write_text(text, "utf-8")
    return plain_value(describe_scene(load_scene(path)))  # type: ignore[no-any-return]


def test_systems_in_numbers(tmp_path: Path) -> None:
    found = described(tmp_path, SYSTEMS)
    flag, cord, snow = found["systems"]
    assert flag["counts"] == {"particles": 12, "springs": 17, "faces": 6}
    assert (flag["kind"], flag["method"], flag["step"]) == ("cloth", "xpbd", 0.01)
    assert (flag["colliders"], flag["joined"], flag["line"]) == (1, [], 6)
    assert cord["counts"] == {"particles": 5, "springs": 4, "curves": 1}
    assert (cord["method"], cord["step"], cord["joined"]) == ("auto", None, ["flag"])
    assert snow["counts"] == {"emitters": 1, "forces": 1, "max_particles": 50}
    assert (snow["method"], snow["meets"]) == ("midpoint", ["flag"])
    assert (found["first"], found["last"], found["rate"]) == (1, 12, "24000/1001")
    (output,) = found["outputs"]
    assert output["systems"] == ["flag", "cord", "snow"]
    assert (output["kind"], output["form"], output["chunk"]) == ("usd", "stage", 5)
    assert output["there"] == []


def test_sources_passes_and_outputs(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text(small_bvh(random_rows(6)))
    (tmp_path / "keys.clip.yaml").write_text("")
    found = described(
        tmp_path,
        "scene: animtool/1\nvariables: {who: cord}\nsource: {file: walk.bvh}\n"
        "passes: [{mirror: {}}, {loop: {}}]\n"
        "systems:\n"
        "- rope: {name: '${who}', from: [0, 1, 0], to: [1, 1, 0], count: 3, mass: 1,\n"
        "    springs: {structural: {stiffness: 9}}, characters: [{source: true}]}\n"
        "output:\n- {file: shot.usdc, deform: true}\n- {file: keys.clip.yaml}\n",
    )
    assert [Path(name).name for name in found["sources"]] == ["walk.bvh"]
    passes = [(entry["name"], entry["line"]) for entry in found["passes"]]
    assert passes == [("mirror", 4), ("loop", 4)]
    (rope,) = found["systems"]
    assert (rope["character"], rope["files"]) == (True, [])
    shot, keys = found["outputs"]
    assert (shot["points"], shot["systems"]) == (True, ["cord"])
    assert (keys["kind"], keys["form"], keys["systems"]) == ("clip", "", [])
    assert [Path(name).name for name in keys["there"]] == ["keys.clip.yaml"]
    assert (found["fps"], found["first"]) == (None, None)
    assert found["variables"] == ["who"]


def test_meshes_of_files_are_colliders_too(tmp_path: Path) -> None:
    (tmp_path / "set.usda").write_text(
        "#usda 1.0\n"
        'def Mesh "Rock" {\npoint3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]\n'
        "int[] faceVertexCounts = [3]\nint[] faceVertexIndices = [0, 1, 2]\n}\n"
    )
    mesh = "    meshes: [{file: set.usda, prim: /Rock}]\n"
    text = SYSTEMS.replace("    forces:", mesh + "    forces:")
    flag, _, snow = described(
        tmp_path, text.replace("    solver: xpbd\n", mesh + "    solver: xpbd\n")
    )["systems"]
    assert (flag["colliders"], snow["colliders"]) == (2, 1)


def test_info_of_scenes(tmp_path: Path) -> None:
    path = tmp_path / "shot.scene.yaml"
    path.write_text(SYSTEMS.replace("name: snow", "name: '${what}'"), "utf-8")
    refused = animtool("info", path)
    assert (refused.code, "what" in refused.stderr) == (3, True)
    done = animtool("info", path, "--set", "what=snow")
    assert done.code == 0, done.stderr
    lines = done.stdout.splitlines()
    assert (
        "  cloth     flag: 12 particles, 17 springs, 6 faces, xpbd in steps of "
        "0.01 s, 1 collider" in lines
    )
    assert (
        "  particles snow: 1 emitter, 1 force, at most 50 at once, midpoint in "
        "steps of 0.01 s, collides with flag" in lines
    )
    assert "  frames    1 to 12 at 24000/1001 fps" in lines
    assert lines[-1].endswith("stage, with flag, cord, snow, 5 samples per file")
    done = animtool("info", path, "--set", "what=snow", "--format", "json")
    (found,) = json.loads(done.stdout)["files"]
    assert [system["name"] for system in found["systems"]] == ["flag", "cord", "snow"]
    unused = animtool("info", path, "--set", "what=snow", "--set", "shot=1")
    assert (unused.code, "shot" in unused.stderr) == (2, True)


def test_an_output_without_a_file_is_props_the_scene(tmp_path: Path) -> None:
    text = SYSTEMS.replace("output: {file: snow.usdc, chunk: 5}\n", "")
    (output,) = described(tmp_path, text)["outputs"]
    assert Path(output["file"]) == tmp_path / "shot.usdc"


def test_a_set_is_its_file_its_prim_and_where_it_is_written(tmp_path: Path) -> None:
    write_props(tmp_path / "set.usda")
    (tmp_path / "walk.bvh").write_text(small_bvh(random_rows(6)))
    (found,) = described(
        tmp_path,
        "scene: animtool/1\nsource: {file: walk.bvh}\n"
        "props: [{from: set.usda, prim: /Set/box, path: /shot/crate}]\n",
    )["props"]
    assert Path(found["file"]).name == "set.usda"
    assert (found["prim"], found["path"]) == ("/Set/box", "/shot/crate")
