"""Ropes, strands, cloth and volumes of scenes: read, baked, joined, torn."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom
from support.faults import raises

import animtool
from animtool import BakeOptions, bake
from animtool.cli.summary import BAKE_TEMPLATE
from animtool.core.errors import FormatError, Severity, ToleranceError
from animtool.core.shot import FrameRange
from animtool.core.values import plain_value
from animtool.rig.kinematics import forward_kinematics
from animtool.scene.file.read import load_scene
from animtool.scene.systems.run import SystemRun
from animtool.scene.systems.simulation import open_systems
from animtool.systems.framework.kinds import SYSTEM_KINDS
from animtool.systems.springs import Family, Pins, SpringSystem, rope, simulate_springs

HEAD = "scene: animtool/1\nfps: 24\nrange: [1, 12]\nsystems:\n"
ROPE = """\
- rope:
    name: lead
    from: [0, 2, 0]
    to: [1, 2, 0]
    count: 11
    mass: 0.1
    radius: 0.01
    springs: {structural: {stiffness: 1000, ratio: 0.1}, bend: {stiffness: 5}}
    pins: [{particles: [start]}]
"""
CLOTH = """\
- cloth:
    name: flag
    corner: [0, 1, 0]
    across: [1, 0, 0]
    up: [0, 0.6, 0]
    resolution: [11, 7]
    mass: 0.1
    springs:
      structural: {stiffness: 300, ratio: 0.05}
      diagonals: {stiffness: 100, ways: one}
      bend: {stiffness: 1}
    pins: [{particles: [left]}]
    wind: {velocity: [4, 0, 1]}
"""
VOLUME = """\
- volume:
    name: jelly
    corner: [3, 0.1, 0]
    size: [0.4, 0.3, 0.4]
    resolution: [4, 3, 4]
    mass: 0.5
    springs: {structural: {stiffness: 500, ratio: 0.1}, body_diagonals: {stiffness: 99}}
    colliders: [{shape: {plane: {}}, friction: 0.5}]
"""
STRANDS = """\
- strands:
    points: hair.npz
    mass: 0.05
    springs: {structural: {stiffness: 100, ratio: 0.1}}
    pins: [{particles: [roots]}]
"""


def written(folder: Path, systems: str, name: str = "shot.scene.yaml") -> Path:
    path = folder / name
    path.write_text(f"{HEAD}{systems}output: {{file: shot.usdc}}\n", "utf-8")
    points = np.zeros((3, 6, 3))
    points[..., 0] = np.arange(3)[:, None] * 0.1
    points[..., 1] = 2 - np.arange(6) * 0.05
    np.savez(folder / "hair.npz", points=points)
    return path


def baked(folder: Path, systems: str, name: str = "shot.usda") -> Usd.Stage:
    bake(written(folder, systems), folder / name)
    return Usd.Stage.Open(str(folder / name))


def values(stage: Usd.Stage, path: str, name: str, code: float) -> np.ndarray:
    return np.array(stage.GetPrimAtPath(path).GetAttribute(name).Get(code))


def test_each_kind_is_written_as_its_prim(tmp_path: Path) -> None:
    stage = baked(tmp_path, ROPE + CLOTH + VOLUME + STRANDS)
    kinds = {prim.GetName(): prim.GetTypeName() for prim in stage.Traverse()}
    assert kinds == {
        "shot": "Xform",
        "lead": "BasisCurves",
        "flag": "Mesh",
        "jelly": "Mesh",
        "strands": "BasisCurves",
    }
    rope = UsdGeom.BasisCurves(stage.GetPrimAtPath("/shot/lead"))
    assert list(rope.GetCurveVertexCountsAttr().Get()) == [11]
    assert rope.GetWidthsAttr().Get()[0] == pytest.approx(0.02)
    assert rope.GetTypeAttr().Get() == "linear"
    hair = UsdGeom.BasisCurves(stage.GetPrimAtPath("/shot/strands"))
    assert list(hair.GetCurveVertexCountsAttr().Get()) == [6, 6, 6]
    flag = UsdGeom.Mesh(stage.GetPrimAtPath("/shot/flag"))
    assert len(flag.GetFaceVertexCountsAttr().Get()) == 60
    assert set(flag.GetFaceVertexCountsAttr().Get()) == {4}
    assert flag.GetDoubleSidedAttr().Get()
    jelly = UsdGeom.Mesh(stage.GetPrimAtPath("/shot/jelly"))
    assert not jelly.GetDoubleSidedAttr().Get()
    for prim in (rope, hair, flag, jelly):
        assert prim.GetPointsAttr().GetTimeSamples() == list(range(1, 13))
        for code in (1, 12):
            extent = UsdGeom.Boundable.ComputeExtentFromPlugins(prim, code)
            np.testing.assert_allclose(
                prim.GetExtentAttr().Get(code), extent, atol=1e-6
            )


def test_what_is_written_has_no_findings(tmp_path: Path) -> None:
    bake(written(tmp_path, ROPE + CLOTH + VOLUME + STRANDS), tmp_path / "o.usdc")
    assert not animtool.validate(tmp_path / "o.usdc")


def test_faces_point_away_from_the_inside(tmp_path: Path) -> None:
    stage = baked(tmp_path, VOLUME)
    points = values(stage, "/shot/jelly", "points", 1)
    corners = values(stage, "/shot/jelly", "faceVertexIndices", 1).reshape(-1, 3)
    a, b, c = (points[corners] - points.mean(axis=0)).swapaxes(0, 1)
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert volume == pytest.approx(0.4 * 0.3 * 0.4, rel=1e-3)


def test_velocities_are_those_of_points(tmp_path: Path) -> None:
    path = written(tmp_path, ROPE + CLOTH)
    fine = BakeOptions(fps=480, frame_range=FrameRange(1, 40))
    bake(path, tmp_path / "o.usda", fine)
    stage = Usd.Stage.Open(str(tmp_path / "o.usda"))
    for prim in ("/shot/lead", "/shot/flag"):
        before, after = (values(stage, prim, "points", code) for code in (29, 31))
        speeds = values(stage, prim, "velocities", 30)
        np.testing.assert_allclose((after - before) * 240, speeds, atol=0.05)


def test_the_bytes_are_the_same_and_frames_do_not_matter(tmp_path: Path) -> None:
    scene = written(tmp_path, ROPE + CLOTH)
    for name in ("a.usdc", "b.usdc"):
        bake(scene, tmp_path / name)
    assert (tmp_path / "a.usdc").read_bytes() == (tmp_path / "b.usdc").read_bytes()
    bake(scene, tmp_path / "whole.usda")
    bake(scene, tmp_path / "part.usda", BakeOptions(frame_range=FrameRange(7, 9)))
    double = BakeOptions(fps=48, frame_range=FrameRange(1, 24))
    bake(scene, tmp_path / "double.usda", double)
    whole, part, fast = (
        Sdf.Layer.FindOrOpen(str(tmp_path / f"{name}.usda"))
        for name in ("whole", "part", "double")
    )
    for prim in ("lead", "flag"):
        path = f"/shot/{prim}.points"
        frame = whole.QueryTimeSample(path, 8)
        assert frame == part.QueryTimeSample(path, 8)
        assert frame == fast.QueryTimeSample(path, 15)


def test_the_report_says_which_solver_and_why(tmp_path: Path) -> None:
    report = bake(written(tmp_path, ROPE), tmp_path / "o.usdc")
    (said,) = plain_value(report)["simulated"]
    assert (said["name"], said["kind"], said["particles"]) == ("lead", "rope", 11)
    assert said["solver"] == "symplectic_euler"
    assert "steps per second" in said["reason"]
    assert 0 < said["stretch"] < 0.1
    (note,) = report.notices
    assert (note.code, note.severity) == ("SIM130", Severity.NOTE)
    assert note.lines == (6,)
    assert any("lead: 11 particles" in line for line in BAKE_TEMPLATE.text(report))


def test_a_scene_is_what_python_simulates(tmp_path: Path) -> None:
    stage = baked(tmp_path, ROPE)
    line = rope(
        [0, 2, 0], [1, 2, 0], 11, Family(1000, ratio=0.1), mass=0.1 / 11,
        bend=Family(5),
    )  # fmt: skip
    system = SpringSystem(line, pins=Pins([0]), gravity=(0, -9.81, 0))
    motion = simulate_springs(system, np.arange(12) / 24)
    for code in (1, 5, 12):
        found = values(stage, "/shot/lead", "points", code)
        np.testing.assert_allclose(found, motion.positions[code - 1], atol=1e-6)


def test_a_pin_moves_and_holds(tmp_path: Path) -> None:
    moves = "moves: [[0, 0, 0, 0], [0.25, 1, 0, 0]]"
    stage = baked(tmp_path, ROPE.replace("[start]}", f"[start], {moves}}}"))
    for code in range(1, 13):
        place = values(stage, "/shot/lead", "points", code)[0]
        x = min((code - 1) / 24 / 0.25, 1.0)
        np.testing.assert_allclose(place, [x, 2, 0], atol=1e-6)


def test_what_is_drawn_stays_behind(tmp_path: Path) -> None:
    drawn = ROPE.replace("[start]}", "[start], stiffness: 50, damping: 1}")
    place = values(baked(tmp_path, drawn), "/shot/lead", "points", 12)[0]
    assert 1.5 < place[1] < 2


def test_settled_ropes_hang_still(tmp_path: Path) -> None:
    text = ROPE.replace("[1, 2, 0]", "[0, 1, 0]") + "    settle: true\n"
    stage = baked(tmp_path, text)
    first, last = (values(stage, "/shot/lead", "points", code) for code in (1, 12))
    assert first[-1, 1] < 1 - 1e-4
    np.testing.assert_allclose(first, last, atol=1e-5)


def test_springs_of_no_length_draw_together(tmp_path: Path) -> None:
    text = (
        ROPE.replace("ratio: 0.1}", "ratio: 1, rest: 0}") + "    gravity: [0, 0, 0]\n"
    )
    text = text.replace("bend: {stiffness: 5}", "").replace(", }", "}")
    points = values(baked(tmp_path, text), "/shot/lead", "points", 12)
    assert np.linalg.norm(points[-1] - points[0]) < 0.6


def test_wind_takes_ropes_along(tmp_path: Path) -> None:
    still = ROPE + "    gravity: [0, 0, 0]\n    drag: 2\n"
    blown = still + "    wind: {velocity: [0, 0, 3]}\n"
    gust = still + "    wind: {gusts: [[0, 0, 0, 3], [0.5, 0, 0, 3]]}\n"
    ends = [
        values(baked(tmp_path, text, f"{i}.usda"), "/shot/lead", "points", 12)[-1]
        for i, text in enumerate((still, blown, gust))
    ]
    assert abs(ends[0][2]) < 1e-9
    assert ends[1][2] > 0.3
    np.testing.assert_allclose(ends[1], ends[2], atol=1e-3)


def test_a_torn_rope_is_two_curves(tmp_path: Path) -> None:
    text = ROPE.replace("ratio: 0.1}", "ratio: 0.1, tear: 0.02}")
    text = text.replace("bend: {stiffness: 5}", "").replace(", }", "}")
    text += "    tip_mass: 3\n"
    scene = written(tmp_path, text)
    report = bake(scene, tmp_path / "o.usda")
    stage = Usd.Stage.Open(str(tmp_path / "o.usda"))
    counts = values(stage, "/shot/lead", "curveVertexCounts", 12)
    points = values(stage, "/shot/lead", "points", 12)
    assert list(values(stage, "/shot/lead", "curveVertexCounts", 1)) == [11]
    assert len(counts) >= 1
    assert counts.sum() == len(points) < 12
    assert counts.min() >= 2
    assert "torn" in report.notices[-1].message
    assert not animtool.validate(tmp_path / "o.usda")


GALE = (
    CLOTH.replace("ratio: 0.05}", "ratio: 0.05, tear: 0.05}")
    .replace("ways: one}", "tear: 0.05}")
    .replace("1}\n    pins", "1, tear: 0.05}\n    pins")
    .replace("velocity: [4, 0, 1]", "velocity: [40, 0, 10]")
)


def torn_at(folder: Path, text: str, frames: int) -> np.ndarray:
    """Return which springs of the first system are torn at the last frame."""
    systems = load_scene(written(folder, text)).systems
    run, *_ = opened = open_systems(systems, (frames - 1) / 24)
    for frame in range(frames):
        for system in opened:
            system.at(frame / 24)
    return run.run.simulation.system.torn(run.run.state.state.torn)


def test_cloth_parts_where_springs_tear(tmp_path: Path) -> None:
    stage = baked(tmp_path, GALE)
    mesh = stage.GetPrimAtPath("/shot/flag")
    counts, corners = (
        mesh.GetAttribute(f"faceVertex{name}") for name in ("Counts", "Indices")
    )
    assert not counts.GetNumTimeSamples()
    assert not corners.GetNumTimeSamples()
    sizes, indices = np.array(counts.Get()), np.array(corners.Get())
    assert len(sizes) > 60
    assert sizes.sum() == len(indices)
    drawn = [values(stage, "/shot/flag", "points", code) for code in range(1, 13)]
    assert {len(points) for points in drawn} == {indices.max() + 1}
    # It hangs together at first, and not at last: halves of sides meet, then do not.
    torn = torn_at(tmp_path, GALE, 12)
    sides = (indices.max() + 1 - 77) // 2
    assert 0 < sides <= torn.sum()
    halves = [points[77 : 77 + 2 * 5].reshape(-1, 2, 3) for points in drawn]
    assert np.array_equal(halves[0][:, 0], halves[0][:, 1])
    assert (np.linalg.norm(np.diff(halves[-1], axis=1), axis=2) > 0.01).any()
    assert not animtool.validate(tmp_path / "shot.usda")


def test_what_parts_is_of_the_same_bytes_each_time(tmp_path: Path) -> None:
    first, second = (tmp_path / name for name in ("a", "b"))
    for folder in (first, second):
        folder.mkdir()
        baked(folder, GALE, "shot.usdc")
    assert (first / "shot.usdc").read_bytes() == (second / "shot.usdc").read_bytes()


def test_what_does_not_tear_is_drawn_as_it_is(tmp_path: Path) -> None:
    calm = GALE.replace("velocity: [40, 0, 10]", "velocity: [0, 0, 0]")
    stage = baked(tmp_path, calm.replace("tear: 0.05", "tear: 0.5"))
    assert len(values(stage, "/shot/flag", "points", 12)) == 77
    assert len(values(stage, "/shot/flag", "faceVertexCounts", 1)) == 60


@pytest.mark.slow
def test_who_runs_into_it_does_not_change_where_it_tears(tmp_path: Path) -> None:
    snow = """\
- particles:
    name: snow
    emitters: [{rate: 50, speed: 1, place: {sphere: {radius: 1}}, at: [0.5, 1, 0]}]
    systems: [{system: flag}]
"""
    alone = torn_at(tmp_path, GALE, 12)
    assert alone.any()
    assert np.array_equal(torn_at(tmp_path, GALE + snow, 12), alone)
    radius = GALE.replace("mass: 0.1\n", "mass: 0.1\n    radius: 0.01\n")
    stage = baked(tmp_path, radius + snow, "met.usda")
    mesh = stage.GetPrimAtPath("/shot/flag")
    assert not mesh.GetAttribute("faceVertexCounts").GetNumTimeSamples()


def test_an_error_is_kept_over_the_whole_motion(tmp_path: Path) -> None:
    found = []
    for error in ("1.0e-2", "1.0e-3"):
        text = ROPE + f"    error: {error}\n"
        report = bake(written(tmp_path, text), tmp_path / f"{error}.usda")
        (said,) = report.takes[0].simulated
        assert said["error"] <= float(error)  # type: ignore[operator]
        found.append(said["step"])
    assert found[1] <= found[0]


def test_what_blows_up_is_not_written(tmp_path: Path) -> None:
    text = ROPE + "    solver: symplectic_euler\n    step: 0.05\n"
    with pytest.raises(ToleranceError) as error:
        bake(written(tmp_path, text), tmp_path / "o.usdc")
    assert "SIM102" in {fault.code for fault in error.value.faults}
    assert not (tmp_path / "o.usdc").exists()


def test_it_runs_into_colliders(tmp_path: Path) -> None:
    text = ROPE + "    colliders: [{shape: {plane: {offset: 1.8}}}]\n"
    points = values(baked(tmp_path, text), "/shot/lead", "points", 12)
    assert points[:, 1].min() > 1.8 + 0.01 - 1e-5


# Pins to what moves


FOLDED = """\
- cloth:
    name: sheet
    corner: [0, 0.02, 0]
    across: [1, 0, 0]
    up: [0, 0, -0.5]
    resolution: [17, 9]
    mass: 0.2
    radius: 0.02
    drag: 1
    springs: {structural: {stiffness: 300, ratio: 0.1}, bend: {stiffness: 1}}
    pins:
    - {particles: [left]}
    - particles: [right]
      moves: [[0, 0, 0, 0], [0.6, -0.4, 0.5, 0], [1.2, -0.95, 0.1, 0]]
    colliders: [{shape: {plane: {}}, friction: 0.3}]
"""
CONTACT = "    self_contact: {thickness: 0.03}\n"


def between_layers(stage: Usd.Stage) -> float:
    """Return how much higher the upper layer lies on the floor than the lower one."""
    points = stage.GetPrimAtPath("/shot/sheet").GetAttribute("points").Get(48)
    grid = np.array(points).reshape(9, 17, 3)
    # Beside its rims: these may lie next to each other.
    return float(grid[2:-2, 11:14, 1].mean() - grid[2:-2, 3:6, 1].mean())


@pytest.mark.slow(0.5)
@pytest.mark.parametrize("solver", ["", "    solver: xpbd\n"])
def test_folds_keep_apart_where_they_are_to(tmp_path: Path, solver: str) -> None:
    longer = HEAD.replace("12", "48")
    path = written(tmp_path, FOLDED + CONTACT + solver)
    path.write_text(path.read_text().replace(HEAD, longer), "utf-8")
    report = bake(path, tmp_path / "apart.usda")
    assert any("it has self-contact" in fault.message for fault in report.notices) == (
        not solver
    )
    found = between_layers(Usd.Stage.Open(str(tmp_path / "apart.usda")))
    path.write_text(path.read_text().replace(CONTACT, ""), "utf-8")
    bake(path, tmp_path / "through.usda")
    without = between_layers(Usd.Stage.Open(str(tmp_path / "through.usda")))
    assert found > 0.9 * 0.03
    assert without < 0.5 * 0.03


def test_a_solver_that_keeps_nothing_apart_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, FOLDED + CONTACT + "    solver: bdf2\n")
    with raises(FormatError, "SIM046") as error:
        load_scene(path)
    (fault,) = error.value.faults
    (line,) = fault.lines
    assert "solver: bdf2" in path.read_text("utf-8").splitlines()[line - 1]
    assert str(fault.where).endswith(".solver")


def test_a_solver_that_keeps_nothing_apart_is_that_of_joined_systems_too(
    tmp_path: Path,
) -> None:
    joined = "[start], to: {system: sheet, particles: [0]}}"
    cord = ROPE.replace("[start]}", joined) + "    solver: bdf2\n"
    path = written(tmp_path, FOLDED + CONTACT + cord)
    with pytest.raises(FormatError) as error:
        load_scene(path)
    (fault,) = [fault for fault in error.value.faults if fault.code == "SIM046"]
    (line,) = fault.lines
    assert "solver: bdf2" in path.read_text("utf-8").splitlines()[line - 1]


def test_what_is_odd_at_a_key_has_its_line(tmp_path: Path) -> None:
    moved = ROPE.replace("[start]}", "[start], moves: [[0, 0, 0.5, 0]]}")
    path = written(tmp_path, moved)
    systems = load_scene(path, {"at": str(tmp_path)}).systems
    run = SystemRun(systems, 0.1)
    (apart,) = [fault for fault in run.notices if fault.code == "SIM150"]
    (line,) = apart.lines
    assert "moves:" in "".join(path.read_text("utf-8").splitlines()[line - 2 : line])
    assert str(apart.where).endswith(".pins")


def test_a_blow_up_has_the_line_of_its_system(tmp_path: Path) -> None:
    text = ROPE + "    solver: symplectic_euler\n    step: 0.04\n"
    path = written(tmp_path, text)
    with pytest.raises(ToleranceError) as error:
        bake(path, tmp_path / "shot.usda")
    assert {fault.path for fault in error.value.faults} == {str(path)}


@pytest.mark.slow
def test_a_joint_carries(root: Path, tmp_path: Path) -> None:
    clip = root / "samples/stride/stride.clip.yaml"
    take = animtool.open_source(clip).collect()
    name = take.rig.names[-1]
    joint = f"joint: {{file: {str(clip)!r}, joint: {name}, offset: [0, 0, 0]}}"
    text = ROPE.replace("[start]}", f"[start], {joint}}}")
    path = written(tmp_path, text)
    systems = load_scene(path, {"at": str(root)}).systems
    (lead,) = open_systems(systems, 0.5)
    world = forward_kinematics(take.rig, *take.motion.dense())
    for frame in (0, 5, 10):
        t = frame / float(take.clock.fps)
        place = lead.at(t).points[0]
        np.testing.assert_allclose(
            place, world.positions[frame, take.rig.index(name)], atol=1e-9
        )
    assert not [n for n in lead.notices if n.code == "SIM150"]


@pytest.mark.slow
def test_a_vertex_of_a_character_carries(root: Path, tmp_path: Path) -> None:
    clip = root / "samples/stride/stride.clip.yaml"
    vertex = (
        f"vertex: {{file: {str(clip)!r}, mesh: body, vertex: 7, offset: [0, 0, 0]}}"
    )
    text = ROPE.replace("[start]}", f"[start], {vertex}}}")
    systems = load_scene(written(tmp_path, text), {"at": str(root)}).systems
    (lead,) = open_systems(systems, 0.5)
    deformed = tmp_path / "body.usda"
    bake(clip, deformed, BakeOptions(deform=True))
    stage = Usd.Stage.Open(str(deformed))
    (body,) = [p for p in stage.Traverse() if p.GetName() == "body"]
    fps = stage.GetTimeCodesPerSecond()
    for frame in (0, 4, 9):
        points = np.array(body.GetAttribute("points").Get(1 + frame))
        np.testing.assert_allclose(lead.at(frame / fps).points[0], points[7], atol=1e-6)


def test_a_prim_carries_and_turns(tmp_path: Path) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "props.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stage.SetTimeCodesPerSecond(24)
    stage.SetStartTimeCode(101)
    stage.SetEndTimeCode(125)
    hook = UsdGeom.Xform.Define(stage, "/Set/hook")
    turn = hook.AddRotateYOp()
    turn.Set(0.0, 101)
    turn.Set(90.0, 125)
    stage.Save()
    prim = "prim: {file: props.usda, prim: /Set/hook}"
    text = ROPE.replace("[start]}", f"[end], {prim}}}")
    found = baked(tmp_path, text)
    for code in (1, 7, 12):
        angle = np.radians(90 * (code - 1) / 24)
        place = values(found, "/shot/lead", "points", code)[-1]
        np.testing.assert_allclose(place, [np.cos(angle), 2, -np.sin(angle)], atol=1e-4)


def test_what_is_put_elsewhere_takes_all_along(tmp_path: Path) -> None:
    still = baked(tmp_path, ROPE)
    row = "[[0, 0, 0, 0], [0.2, 0, 0, 0], [0.25, 100, 5, 0], [1, 100, 5, 0]]"
    text = ROPE.replace("[start]}", f"[start], moves: {row}}}")
    report = bake(written(tmp_path, text), tmp_path / "o.usda")
    assert "SIM122" in [notice.code for notice in report.notices]
    moved = Usd.Stage.Open(str(tmp_path / "o.usda"))
    for code in (6, 7, 8, 12):
        way = [100, 5, 0] if code >= 7 else [0, 0, 0]
        for name, shift in (("points", way), ("velocities", [0, 0, 0])):
            found = values(moved, "/shot/lead", name, code)
            wanted = values(still, "/shot/lead", name, code) + shift
            np.testing.assert_allclose(found, wanted, atol=2e-3)


def test_a_limit_that_is_raised_pulls(tmp_path: Path) -> None:
    row = "[[0, 0, 0, 0], [0.2, 0, 0, 0], [0.25, 100, 5, 0]]"
    text = ROPE.replace("[start]}", f"[start], moves: {row}}}")
    text += "    speed_limit: 1.0e+9\n"
    with pytest.raises(ToleranceError) as error:
        bake(written(tmp_path, text), tmp_path / "o.usda")
    assert "SIM102" in {fault.code for fault in error.value.faults}


def test_two_hands_hold_both_ends(tmp_path: Path) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "props.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 1)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    for name, place in (("a", (5, 1, 0)), ("b", (5, 1, 1))):
        UsdGeom.Xform.Define(stage, f"/{name}").AddTranslateOp().Set(place)
    stage.Save()
    pins = "".join(
        f"    - particles: [{end}]\n"
        f"      prim: {{file: props.usda, prim: /{name}, offset: [0, 0, 0]}}\n"
        for end, name in (("start", "a"), ("end", "b"))
    )
    text = ROPE.split("    pins:", maxsplit=1)[0] + "    pins:\n" + pins
    report = bake(written(tmp_path, text), tmp_path / "o.usda")
    points = values(Usd.Stage.Open(str(tmp_path / "o.usda")), "/shot/lead", "points", 1)
    wanted = np.linspace([5, 1, 0], [5, 1, 1], 11)
    np.testing.assert_allclose(points, wanted, atol=1e-5)
    assert [notice.code for notice in report.notices] == ["SIM130"]


def test_pins_that_stretch_are_said(tmp_path: Path) -> None:
    moves = "moves: [[0, 0, 0.2, 0]]"
    text = ROPE.replace("[start]}", f"[start], {moves}}}")
    report = bake(written(tmp_path, text), tmp_path / "o.usda")
    assert "SIM150" in [notice.code for notice in report.notices]


# Meshes


def table(folder: Path, points: list[list[float]], faces: list[list[int]]) -> str:
    stage = Usd.Stage.CreateNew(str(folder / "table.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    mesh = UsdGeom.Mesh.Define(stage, "/Set/top")
    mesh.CreatePointsAttr([tuple(point) for point in points])
    mesh.CreateFaceVertexCountsAttr([len(face) for face in faces])
    mesh.CreateFaceVertexIndicesAttr([corner for face in faces for corner in face])
    mesh.AddTranslateOp().Set((0, 0, 100))
    stage.Save()
    return (
        CLOTH.replace("    corner: [0, 1, 0]\n", "")
        .replace(
            "    across: [1, 0, 0]\n    up: [0, 0.6, 0]\n    resolution: [11, 7]\n",
            "    mesh: {file: table.usda, prim: /Set/top}\n",
        )
        .replace("[left]", "[0]")
    )


SQUARE = [[0.0, 0, 0], [100, 0, 0], [100, 100, 0], [0, 100, 0]]


def test_cloth_of_a_mesh_stands_in_metres_and_y_up(tmp_path: Path) -> None:
    stage = baked(tmp_path, table(tmp_path, SQUARE, [[0, 1, 2], [0, 2, 3]]))
    points = values(stage, "/shot/flag", "points", 1)
    np.testing.assert_allclose(
        points, [[0, 1, 0], [1, 1, 0], [1, 1, -1], [0, 1, -1]], atol=1e-6
    )
    assert list(values(stage, "/shot/flag", "faceVertexCounts", 1)) == [3, 3]


def test_mass_is_spread_over_the_area(tmp_path: Path) -> None:
    points = [*SQUARE, [200.0, 0, 0]]
    text = table(tmp_path, points, [[0, 1, 2, 3], [1, 4, 2]])
    (system,) = load_scene(written(tmp_path, text)).systems
    masses = system.setup.record.body.body.masses  # type: ignore[attr-defined]
    assert masses.sum() == pytest.approx(0.1)
    np.testing.assert_allclose(
        masses * 15, [0.25, 0.25 + 1 / 6, 0.25 + 1 / 6, 0.25, 1 / 6]
    )


def test_odd_meshes_are_said(tmp_path: Path) -> None:
    points = [*SQUARE, [0.0, 0, 0], [50, 50, 50]]
    faces = [[0, 1, 2], [0, 2, 3], [4, 2, 5], [0, 2, 5], [4, 5, 5]]
    text = table(tmp_path, points, faces)
    report = bake(written(tmp_path, text), tmp_path / "o.usda")
    said = [notice.message for notice in report.notices if notice.code == "SIM153"]
    assert len(said) == 3
    assert any("0, 4" in message for message in said)


def test_tetrahedra_are_written_as_their_skin(tmp_path: Path) -> None:
    points = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]
    cells = [[0, 1, 2, 3], [1, 2, 3, 4]]
    np.savez(tmp_path / "jelly.npz", points=points, cells=cells)
    text = VOLUME.replace("    corner: [3, 0.1, 0]\n", "").replace(
        "    size: [0.4, 0.3, 0.4]\n    resolution: [4, 3, 4]\n",
        "    tetrahedra: {points: jelly.npz, cells: jelly.npz}\n",
    )
    text = text.replace(", body_diagonals: {stiffness: 99}", "")
    stage = baked(tmp_path, text)
    assert len(values(stage, "/shot/jelly", "faceVertexCounts", 1)) == 6


# Joined systems

CORD = (
    ROPE.replace("[0, 2, 0]", "[1, 1, 0]")
    .replace("[1, 2, 0]", "[1, 0, 0]")
    .replace(
        "pins: [{particles: [start]}]",
        "pins: [{particles: [start], to: {system: flag, particles: [bottom_right]}}]",
    )
)


def test_joined_particles_are_one(tmp_path: Path) -> None:
    for order in (CLOTH + CORD, CORD + CLOTH):
        stage = baked(tmp_path, order, f"{order[2]}.usda")
        for code in (1, 6, 12):
            rope, flag = (
                values(stage, f"/shot/{name}", "points", code)
                for name in ("lead", "flag")
            )
            assert (rope[0] == flag[10]).all()


def test_the_joined_move_each_other(tmp_path: Path) -> None:
    alone = values(baked(tmp_path, CLOTH), "/shot/flag", "points", 12)[10]
    heavy = CORD + "    tip_mass: 1\n"
    pulled = values(
        baked(tmp_path, CLOTH + heavy, "b.usda"), "/shot/flag", "points", 12
    )
    assert pulled[10, 1] < alone[1] - 0.01


def test_what_is_joined_apart_is_said(tmp_path: Path) -> None:
    text = CLOTH + CORD.replace("from: [1, 1, 0]", "from: [1, 0.9, 0]")
    report = bake(written(tmp_path, text), tmp_path / "o.usda")
    assert "SIM150" in [notice.code for notice in report.notices]


# Particles that run into cloth

RAIN = """\
- particles:
    name: rain
    step: 0.01
    emitters:
    - place: {box: {size: [0.6, 0.01, 0.3]}}
      at: [0.5, 1.5, -0.3]
      rate: 200
      radius: 0.01
    forces: [{gravity: }]
    systems: [{system: flag, friction: 0.5}]
"""
AWNING = CLOTH.replace("up: [0, 0.6, 0]", "up: [0, 0, -0.6]").replace(
    "[{particles: [left]}]", "[{particles: [left, right]}]"
).replace("velocity: [4, 0, 1]", "velocity: [0, 0, 0]")  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("order", ["awning first", "rain first"])
def test_particles_stay_on_cloth(tmp_path: Path, order: str) -> None:
    text = AWNING + RAIN if order == "awning first" else RAIN + AWNING
    scene = written(tmp_path, text)
    bake(scene, tmp_path / "o.usda", BakeOptions(frame_range=FrameRange(1, 24)))
    stage = Usd.Stage.Open(str(tmp_path / "o.usda"))
    cloth = values(stage, "/shot/flag", "points", 24)
    drops = values(stage, "/shot/rain", "points", 24)
    ages = values(stage, "/shot/rain", "primvars:age", 24)
    old = drops[ages > 0.5]
    assert len(old) > 20
    for drop in old:
        near = cloth[np.linalg.norm((cloth - drop)[:, [0, 2]], axis=1).argmin()]
        assert drop[1] > near[1] - 0.02


def test_the_order_of_systems_changes_nothing(tmp_path: Path) -> None:
    one = baked(tmp_path, AWNING + RAIN, "a.usda")
    two = baked(tmp_path, RAIN + AWNING, "b.usda")
    alone = baked(tmp_path, AWNING, "c.usda")
    for code in (6, 12):
        for prim in ("flag", "rain"):
            path = f"/shot/{prim}"
            assert (values(one, path, "points", code) == values(
                two, path, "points", code)).all()  # fmt: skip
        assert (values(one, "/shot/flag", "points", code) == values(
            alone, "/shot/flag", "points", code)).all()  # fmt: skip


@pytest.mark.slow
def test_two_kinds_of_rain_meet_one_cloth(tmp_path: Path) -> None:
    other = RAIN.replace("name: rain", "name: hail").replace("0.01\n", "0.007\n", 1)
    both = baked(tmp_path, RAIN + other + AWNING, "a.usda")
    alone = baked(tmp_path, AWNING + other, "b.usda")
    np.testing.assert_allclose(
        values(both, "/shot/hail", "points", 12),
        values(alone, "/shot/hail", "points", 12),
        atol=1e-7,
    )


# Bakes scenes, each in a process of its own; what all of them need is imported once.
LOADED = """
import json, os, sys
import numpy
from pxr import Usd, UsdGeom, UsdSkel
from animtool.cli.main import run

for scene in sys.argv[1:]:
    child = os.fork()
    if child:
        os.waitpid(child, 0)
        continue
    assert run(["bake", scene, "-o", scene.replace(".scene.yaml", ".usdc")]) == 0
    folders = ("animtool.sim.", "animtool.systems.")
    found = sorted(m for m in sys.modules if m.startswith(folders))
    print(json.dumps(found), flush=True)
    os._exit(0)
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="POSIX processes")
def test_only_what_a_scene_has_is_loaded(walk: Path, tmp_path: Path) -> None:
    (tmp_path / walk.name).write_bytes(walk.read_bytes())
    plain = tmp_path / "plain.scene.yaml"
    plain.write_text(f"scene: animtool/1\nsource: {{file: {walk.name}}}\n", "utf-8")
    rain = RAIN.split("    systems:", maxsplit=1)[0]
    scenes = (
        plain,
        written(tmp_path, ROPE, "rope.scene.yaml"),
        written(tmp_path, rain, "rain.scene.yaml"),
    )
    command = [sys.executable, "-P", "-c", LOADED, *map(str, scenes)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    lines = [line for line in done.stdout.splitlines() if line.startswith("[")]
    nothing, springs, particles = map(json.loads, lines)
    # What keys share and count is part of reading scenes.
    above = "animtool.systems.framework"
    shared = [f"{above}.{name}" for name in ("conversion", "fields", "kinds", "spec")]
    assert nothing == ["animtool.sim.contact", above, *shared]
    assert "animtool.systems.springs.system" in springs
    assert "animtool.systems.particles.simulation" in particles
    specs = [kind.spec.partition(":")[0] for kind in SYSTEM_KINDS.values()]
    assert set(springs).intersection(specs) == {"animtool.systems.springs.spec"}
    assert set(particles).intersection(specs) == {"animtool.systems.particles.spec"}
    assert {p.stem for p in tmp_path.glob("*.usdc")} == {"plain", "rope", "rain"}


@pytest.mark.parametrize(
    ("diagonals", "across"),
    [
        ("", 0),
        (", diagonals: {stiffness: 90}", 12),
        (", diagonals: {stiffness: 90, ways: both}", 12),
        (", diagonals: {stiffness: 90, ways: one}", 6),
    ],
)
def test_cloth_has_a_spring_a_cell_or_two_that_cross(
    tmp_path: Path, diagonals: str, across: int
) -> None:
    """Of four by three particles: 17 between neighbours, and a cell for six."""
    text = (
        "- cloth:\n    corner: [0, 0, 0]\n    across: [3, 0, 0]\n    up: [0, 2, 0]\n"
        "    resolution: [4, 3]\n    mass: 1\n"
        f"    springs: {{structural: {{stiffness: 100}}{diagonals}}}\n"
    )
    (run,) = open_systems(load_scene(written(tmp_path, text)).systems, 0.0)
    run.at(0.0)
    springs = run.run.simulation.system.body.springs
    longer = springs.rest > 1.1
    assert (int((~longer).sum()), int(longer.sum())) == (17, across)
    np.testing.assert_allclose(springs.rest[longer], np.sqrt(2))
    np.testing.assert_allclose(springs.stiffness[longer], 90)


@pytest.mark.parametrize(("stiffness", "found"), [(33, True), (3000, False)])
def test_ropes_that_stretch_while_they_settle(
    tmp_path: Path, stiffness: int, found: bool
) -> None:
    text = ROPE.replace("[1, 2, 0]", "[0, 1, 0]") + "    settle: true\n"
    text += "    tip_mass: 1\n"
    text = text.replace("stiffness: 1000", f"stiffness: {stiffness}")
    report = bake(written(tmp_path, text), tmp_path / "a.usda")
    faults = [notice for notice in report.notices if notice.code == "SIM187"]
    assert len(faults) == found
    assert all("a stiffness of 33 N/m" in fault.message for fault in faults)
