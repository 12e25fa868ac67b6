"""Faults of ropes, strands, cloth and volumes in scene files, and where they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from support.suite import some_quick

from animtool.core.errors import Fault, FormatError
from animtool.scene.file.read import load_scene

SCENE = """\
scene: animtool/1
range: [1, 4]
systems:
- rope:
    name: lead
    from: [0, 2, 0]
    to: [1, 2, 0]
    count: 11
    mass: 0.1
    springs: {structural: {stiffness: 1000, ratio: 0.1}, bend: {stiffness: 5}}
    pins: [{particles: [start]}]
- cloth:
    name: flag
    across: [1, 0, 0]
    up: [0, 0.5, 0]
    resolution: [5, 4]
    mass: 0.2
    springs: {structural: {stiffness: 300}}
    pins: [{particles: [left]}]
    wind: {velocity: [4, 0, 1]}
- volume:
    name: jelly
    size: [0.4, 0.4, 0.4]
    resolution: [3, 3, 3]
    mass: 0.3
    springs: {structural: {stiffness: 500}}
- strands:
    points: hair.npz
    mass: 0.05
    springs: {structural: {stiffness: 100}}
output: {file: o.usdc}
"""
# The pin of the rope.
PIN = "[{particles: [start]}]"
NPZ = "hair.npz"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with what the scene reads."""
    points = np.zeros((2, 4, 3)) + np.arange(4)[:, None]
    cells = [[0, 1, 2, 3]]
    jelly = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    np.savez(
        tmp_path / "hair.npz",
        points=points,
        flat=np.zeros((4, 3)),
        bald=np.zeros((0, 4, 3)),
        jelly=jelly,
        lost=[*jelly, [5.0, 5, 5]],
        cells=cells,
        beyond=[[0, 1, 2, 9]],
        pins=np.array([0, 99]),
    )
    stage = Usd.Stage.CreateNew(str(tmp_path / "set.usda"))
    mesh(stage, "/Set/good", [[0, 1, 2]])
    mesh(stage, "/Set/loose", [[0, 1, 3]])
    mesh(stage, "/Set/beyond", [[0, 1, 7]])
    mesh(stage, "/Set/line", [[0, 1]])
    mesh(stage, "/Set/flat", [[0, 0, 1], [2, 2, 3]])
    mesh(stage, "/Set/none", [])
    UsdGeom.Xform.Define(stage, "/Set/hook")
    stage.Save()
    return tmp_path


def mesh(stage: Usd.Stage, path: str, faces: list[list[int]]) -> None:
    """Write a mesh of three points, or of four where a face has the last."""
    made = UsdGeom.Mesh.Define(stage, path)
    corners = [corner for face in faces for corner in face]
    count = 4 if 3 in corners else 3
    made.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)][:count])
    made.CreateFaceVertexCountsAttr([len(face) for face in faces])
    made.CreateFaceVertexIndicesAttr(corners)


def faults(folder: Path, text: str) -> list[Fault]:
    path = folder / "shot.scene.yaml"
    path.write_text(text, "utf-8")
    with pytest.raises(FormatError) as error:
        load_scene(path)
    return list(error.value.faults)


def cloth_of(prim: str) -> tuple[str, str]:
    """Return what makes the flag one of a mesh."""
    old = "    across: [1, 0, 0]\n    up: [0, 0.5, 0]\n    resolution: [5, 4]\n"
    return old, f"    mesh: {{file: set.usda, prim: {prim}}}\n"


def block_of(points: str, cells: str) -> tuple[str, str]:
    """Return what makes the jelly one of tetrahedra."""
    old = "    size: [0.4, 0.4, 0.4]\n    resolution: [3, 3, 3]\n"
    names = f"points: {NPZ}#{points}, cells: {NPZ}#{cells}"
    return old, f"    tetrahedra: {{{names}}}\n"


CASES = {
    "no mass": ("mass: 0.1", "mass: 0", ["SIM040"]),
    "a mass below nothing": ("mass: 0.2", "mass: -1", ["SIM040"]),
    "a mass that is not a number": ("mass: 0.1", "mass: .nan", ["DOC022"]),
    "a tip of no mass": ("mass: 0.1", "mass: 0.1\n    tip_mass: 0", ["SIM040"]),
    "one particle": ("count: 11", "count: 1", ["SIM050"]),
    "no length": ("to: [1, 2, 0]", "to: [0, 2, 0]", ["SIM050"]),
    "no springs": (
        "{structural: {stiffness: 300}}", "{}", ["SIM050"]
    ),
    "a spring that pushes": ("stiffness: 1000", "stiffness: -1", ["SIM042"]),
    "damping below nothing": ("ratio: 0.1", "ratio: -0.1", ["SIM042"]),
    "a length below nothing": ("ratio: 0.1", "rest: -1", ["SIM042"]),
    "torn at once": ("ratio: 0.1", "rest: 0, tear: 1", ["SIM042"]),
    "torn before": ("ratio: 0.1", "tear: 0", ["SIM042"]),
    "a family of none": ("bend:", "bned:", ["DOC020"]),
    "a row of cloth": ("resolution: [5, 4]", "resolution: [5, 1]", ["SIM050"]),
    "no area": ("up: [0, 0.5, 0]", "up: [2, 0, 0]", ["SIM050"]),
    "no height": ("up: [0, 0.5, 0]", "up: [0, 0, 0]", ["SIM050"]),
    "no volume": ("size: [0.4, 0.4, 0.4]", "size: [0.4, 0, 0.4]", ["SIM050"]),
    "a layer": ("resolution: [3, 3, 3]", "resolution: [3, 1, 3]", ["SIM050"]),
    "drag below nothing": ("mass: 0.1", "mass: 0.1\n    drag: -1", ["SIM050"]),
    "air below nothing": ("velocity: [4, 0, 1]", "density: -1", ["SIM050"]),
    "gusts backwards": (
        "velocity: [4, 0, 1]", "gusts: [[1, 0, 0, 0], [0, 1, 0, 0]]", ["SIM044"]
    ),
    "no step": ("mass: 0.1", "mass: 0.1\n    step: 0", ["SIM004"]),
    "no solver": ("mass: 0.1", "mass: 0.1\n    solver: rk4", ["DOC022"]),
    "no collider": (
        "mass: 0.1", "mass: 0.1\n    colliders: [{shape: {plain: }}]", ["SIM020"]
    ),
    "no character": (
        "mass: 0.1", "mass: 0.1\n    characters: [{file: no.clip.yaml}]", ["DOC015"]
    ),
    "strands of no file": (f"points: {NPZ}", "points: no.npz", ["DOC015"]),
    "strands of no array": (f"points: {NPZ}", f"points: {NPZ}#p", ["RIG018"]),
    "strands of one": (f"points: {NPZ}", f"points: {NPZ}#flat", ["SIM050"]),
    "no strands": (f"points: {NPZ}", f"points: {NPZ}#bald", ["SIM050"]),
    "a mesh and a sheet": (
        "mass: 0.2",
        "mass: 0.2\n    mesh: {file: set.usda, prim: /Set/good}",
        ["SIM050", "SIM050", "SIM050"],
    ),
    "no prim": (*cloth_of("/Set/god"), ["SIM051"]),
    "a prim that is no mesh": (*cloth_of("/Set/hook"), ["SIM051"]),
    "a loose point": (*cloth_of("/Set/loose"), ["SIM051"]),
    "a corner of none": (*cloth_of("/Set/beyond"), ["SIM051"]),
    "a face of two": (*cloth_of("/Set/line"), ["SIM051"]),
    "faces without area": (*cloth_of("/Set/flat"), ["SIM051"]),
    "no faces": (*cloth_of("/Set/none"), ["SIM051"]),
    "a loose particle": (*block_of("lost", "cells"), ["SIM051"]),
    "a cell of none": (*block_of("jelly", "beyond"), ["SIM051"]),
    "cells of three": (*block_of("jelly", "jelly"), ["SIM051"]),
    "points of no shape": (*block_of("points", "cells"), ["SIM051"]),
    "no such place": (PIN, "[{particles: [strat]}]", ["SIM052"]),
    "no such number": (PIN, "[{particles: [11, -12]}]", ["SIM052", "SIM052"]),
    "an array of no particles": (PIN, f"[{{particles: ['{NPZ}#pins']}}]", ["SIM052"]),
    "numbered twice": (PIN, "[{particles: [3, 0, 3]}]", ["SIM052"]),
    "held in two ways": (
        PIN,
        "[{particles: [0]}, {particles: [start], moves: [[0, 0, 0, 0]]}]",
        ["SIM052"],
    ),
    "two ways": (
        PIN,
        "[{particles: [0], moves: [[0, 0, 0, 0]], prim: {file: set.usda, "
        "prim: /Set/hook}}]",
        ["SIM052", "SIM052"],
    ),
    "moves backwards": (
        PIN, "[{particles: [0], moves: [[1, 0, 0, 0], [0, 0, 0, 0]]}]", ["SIM044"]
    ),
    "no thickness": (
        "- strands:",
        "- cloth: {name: sail, mass: 1, springs: {structural: {stiffness: 9}}, "
        "self_contact: {thickness: 0, friction: -1}}\n- strands:",
        ["DOC022", "DOC022"],
    ),
    "a limit of nothing": ("mass: 0.1", "mass: 0.1\n    speed_limit: 0", ["SIM050"]),
    "drawn by less than nothing": (
        PIN, "[{particles: [0], stiffness: -1}]", ["SIM042"]
    ),
    "no prim to hold": (
        PIN, "[{particles: [0], prim: {file: set.usda, prim: /Set/hok}}]", ["SIM053"]
    ),
    "no file to hold": (
        PIN, "[{particles: [0], joint: {file: no.bvh, joint: hips}}]", ["DOC015"]
    ),
    "joined to nobody": (
        PIN, "[{particles: [0], to: {system: flg, particles: [0]}}]", ["SCN063"]
    ),
    "joined to itself": (
        PIN, "[{particles: [0], to: {system: lead, particles: [0]}}]", ["SCN063"]
    ),
    "joined to one of two": (
        PIN,
        "[{particles: [0], to: {system: flag, particles: [0]}}]\n- rope: {name: flag, "
        "from: [0, 0, 0], to: [1, 0, 0], count: 3, mass: 1, springs: {structural: "
        "{stiffness: 9}}}",
        ["SCN063"],
    ),
    "joined to no particle": (
        PIN, "[{particles: [0], to: {system: flag, particles: [end]}}]", ["SIM052"]
    ),
    "joined by another number": (
        PIN, "[{particles: [0], to: {system: flag, particles: [0, 1]}}]", ["SIM054"]
    ),
    "joined and moved": (
        PIN,
        "[{particles: [0], moves: [[0, 0, 0, 0]], to: {system: flag, particles: [0]}}]",
        ["SIM052"],
    ),
    "rain on a rope": (
        "- strands:",
        "- particles: {emitters: [{rate: 1}], systems: [{system: lead}]}\n- strands:",
        ["SCN063"],
    ),
    "rain on nothing": (
        "- strands:",
        "- particles: {emitters: [{rate: 1}], systems: [{system: flg}]}\n- strands:",
        ["SCN063"],
    ),
    "rain that leaps": (
        "- strands:",
        "- particles: {emitters: [{rate: 1}], systems: [{system: flag, friction: -1}]}"
        "\n- strands:",
        ["SIM020"],
    ),
    "joined to what comes and goes": (
        PIN,
        "[{particles: [0], to: {system: rain, particles: [0]}}]\n"
        "- particles: {name: rain, emitters: [{rate: 1}]}",
        ["SCN063"],
    ),
    "joined, with another solver": (
        PIN,
        "[{particles: [0], to: {system: flag, particles: [0]}}]\n    solver: xpbd",
        [],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", some_quick(CASES, 3))
def test_a_fault_has_its_code_and_place(folder: Path, name: str) -> None:
    old, new, expected = CASES[name]
    assert old in SCENE
    text = SCENE.replace(old, new, 1)
    if not expected:
        path = folder / "shot.scene.yaml"
        path.write_text(text, "utf-8")
        load_scene(path)
        return
    found = faults(folder, text)
    assert sorted(fault.code for fault in found) == expected
    assert all(fault.lines and fault.column for fault in found)


def test_joined_systems_agree(folder: Path) -> None:
    joined = "[{particles: [0], to: {system: flag, particles: [0]}}]"
    text = SCENE.replace(PIN, f"{joined}\n    gravity: [0, 0, 0]")
    text = text.replace("mass: 0.2", "mass: 0.2\n    gravity: [0, -1, 0]")
    (fault,) = faults(folder, text)
    assert (fault.code, fault.where) == ("SIM054", "systems[1].cloth.gravity")


def test_names_that_are_nearly_right_are_given(folder: Path) -> None:
    (fault,) = faults(folder, SCENE.replace(PIN, "[{particles: [strat]}]"))
    assert "start" in (fault.hint or "")
    (fault,) = faults(folder, SCENE.replace("[left]", "[lefft]"))
    assert "left" in (fault.hint or "")
    joined = "[{particles: [0], to: {system: flg, particles: [0]}}]"
    (fault,) = faults(folder, SCENE.replace(PIN, joined))
    assert "flag" in (fault.hint or "")


def test_a_joint_and_a_vertex_are_those_of_the_rig(root: Path, folder: Path) -> None:
    (folder / "animtool.toml").write_text(f"roots = [{str(root)!r}]\n", "utf-8")
    clip = str(root / "samples/stride/stride.clip.yaml")
    pins = (
        f"[{{particles: [0], joint: {{file: {clip!r}, joint: hipz}}}}, "
        f"{{particles: [1], vertex: {{file: {clip!r}, mesh: nose, vertex: 0}}}}, "
        f"{{particles: [2], vertex: {{file: {clip!r}, mesh: body, vertex: 99999}}}}]"
    )
    found = faults(folder, SCENE.replace(PIN, pins))
    assert [fault.code for fault in found] == ["SIM053"] * 3
    assert "hips" in (found[0].hint or "")


def test_every_fault_is_said_at_once(folder: Path) -> None:
    text = SCENE.replace("mass: 0.1", "mass: 0").replace("mass: 0.2", "mass: -2")
    text = text.replace("[left]", "[lefft]").replace("size: [0.4,", "size: [0,")
    joined = "[{particles: [0], to: {system: jely, particles: [0]}}]"
    found = [fault.code for fault in faults(folder, text.replace(PIN, joined))]
    assert sorted(found) == ["SCN063", "SIM040", "SIM040", "SIM050", "SIM052"]


@pytest.mark.parametrize(
    ("family", "at"),
    [
        ("{stiffness: 10, axial_stiffness: 5}", "springs.structural.axial_stiffness"),
        ("{ratio: 0.1}", "springs.structural"),
        ("{axial_stiffness: 5, rest: 0}", "springs.structural.axial_stiffness"),
        ("{stiffness: 10, frequency: 5}", "springs.structural.frequency"),
    ],
)
@pytest.mark.parametrize("kind", ["rope", "strands"])
def test_springs_of_lines_have_one_stiffness(
    folder: Path, family: str, at: str, kind: str
) -> None:
    old = {"rope": "{stiffness: 1000, ratio: 0.1}", "strands": "{stiffness: 100}"}[kind]
    (folder / "s.scene.yaml").write_text(SCENE.replace(old, family))
    with pytest.raises(FormatError) as caught:
        load_scene(folder / "s.scene.yaml").open()
    (fault,) = caught.value.faults
    assert fault.code == "SIM190"
    assert str(fault.where).endswith(f"{kind}.{at}")


def test_axial_stiffness_is_for_ropes_and_strands(folder: Path) -> None:
    text = SCENE.replace("{stiffness: 1000, ratio: 0.1}", "{axial_stiffness: 1000}")
    text = text.replace("{stiffness: 100}", "{axial_stiffness: 100, damping: 1}")
    (folder / "s.scene.yaml").write_text(text)
    assert load_scene(folder / "s.scene.yaml").systems
    (folder / "s.scene.yaml").write_text(
        text.replace("{stiffness: 300}", "{stiffness: 300, axial_stiffness: 1}")
    )
    with pytest.raises(FormatError) as caught:
        load_scene(folder / "s.scene.yaml").open()
    assert "axial_stiffness" in str(caught.value.faults[0].where)


@pytest.mark.parametrize(
    "pins",
    [
        "[{particles: [top, bottom, left, right]}]",
        "[{particles: [top, bottom]}, {particles: [left, right]}]",
        "[{particles: [left]}, {particles: [top]}, {particles: [left, right, bottom]}]",
        "[{particles: [top, bottom, left, right]}, {particles: [0]}]",
    ],
)
def test_pins_of_places_hold_their_union(tmp_path: Path, pins: str) -> None:
    path = tmp_path / "net.scene.yaml"
    path.write_text(
        "scene: animtool/1\nfps: 24\nrange: [1, 2]\nsystems:\n- cloth:\n"
        "    name: net\n    resolution: [6, 4]\n    mass: 1\n"
        "    springs: {structural: {stiffness: 9}}\n"
        f"    pins: {pins}\noutput: {{file: net.usdc}}\n",
        "utf-8",
    )
    (system,) = load_scene(path).systems
    held = np.concatenate([pin.particles for pin in system.setup.record.pins])
    rim = np.ones((4, 6), bool)
    rim[1:-1, 1:-1] = False
    assert sorted(held.tolist()) == np.flatnonzero(rim).tolist()
