"""Deformed bakes beside skinned ones of the same take, through the command line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom
from support.cli import animtool
from support.point_caches import bindings, layered, skinned_points, world_points
from support.skinned_rig import STRANDS, VERTICES, write_pair
from support.usd import validation_errors

from animtool import BakeOptions, bake
from animtool.core.errors import OptionError

# What float32 joints, weights and points leave, as a share of the size.
TOLERANCE = 2e-6
CODES = [float(code) for code in range(1, 10)]
MOVING = ["body", "face", "sleeve"]
HAIR = "Strands/hair"

methods = pytest.mark.parametrize("method", ["linear", "dual_quaternion"])


def baked(folder: Path, name: str, *options: object, source: object = "") -> Usd.Stage:
    source = source or "pair.clip.yaml"
    done = animtool("bake", source, "-o", name, *options, cwd=folder)
    assert done.code == 0, done.stderr
    return Usd.Stage.Open(str(folder / name))


def near(points: np.ndarray, truth: np.ndarray) -> bool:
    return bool(np.abs(points - truth).max() <= TOLERANCE * np.abs(truth).max())


@methods
@pytest.mark.parametrize(
    "options",
    [
        (),
        ("--to-units", "m", "--to-up", "Z"),
        ("--fps", "30", "--range", "1-9"),
        ("--prim-path", "/World/cast/pair"),
    ],
)
def test_points_are_where_the_skinned_stage_has_them(
    method: str, options: tuple[str, ...], tmp_path: Path
) -> None:
    write_pair(tmp_path, method)
    cache = baked(tmp_path, "cache.usdc", "--deform", *options)
    baked(tmp_path, "skinned.usdc", *options)
    truth = skinned_points(tmp_path / "skinned.usdc", CODES)
    assert len(truth) == 5
    for path, points in truth.items():
        assert near(world_points(cache, path, CODES), points), path
    assert not bindings(cache)
    assert not validation_errors(cache)


@methods
def test_normals_turn_as_those_that_usdskel_bakes(method: str, tmp_path: Path) -> None:
    from pxr import UsdSkel

    write_pair(tmp_path, method)
    cache = baked(tmp_path, "cache.usdc", "--deform")
    skinned = baked(tmp_path, "skinned.usdc")
    made = Usd.Stage.Open(skinned.Flatten())
    root = UsdSkel.Root(made.GetPrimAtPath("/pair/Rig"))
    assert UsdSkel.BakeSkinning(root, Gf.Interval(1, 9))
    for name in ("body", "face"):
        ours, theirs = (
            UsdGeom.Mesh(stage.GetPrimAtPath(f"/pair/Rig/{name}"))
            for stage in (cache, made)
        )
        assert ours.GetNormalsInterpolation() == "vertex"
        for code in CODES:
            truth = np.array(theirs.GetNormalsAttr().Get(code), np.float64)
            truth /= np.linalg.norm(truth, axis=1, keepdims=True)
            found = np.array(ours.GetNormalsAttr().Get(code), np.float64)
            assert np.abs(found - truth).max() <= 2e-5
    assert (
        not UsdGeom.Mesh(cache.GetPrimAtPath("/pair/Rig/sleeve")).GetNormalsAttr().Get()
    )


def test_what_follows_nothing_that_moves_has_a_default_alone(tmp_path: Path) -> None:
    write_pair(tmp_path)
    cache = baked(tmp_path, "cache.usda", "--deform", "--velocities")
    for prim in cache.Traverse():
        if not prim.IsA(UsdGeom.PointBased):
            continue
        mesh = UsdGeom.PointBased(prim)
        samples = [
            attr.GetNumTimeSamples()
            for attr in (mesh.GetPointsAttr(), mesh.GetExtentAttr())
        ]
        still = prim.GetName() == "rock"
        assert samples == ([0, 0] if still else [9, 9])
        assert mesh.GetVelocitiesAttr().GetNumTimeSamples() == samples[0]
        for code in CODES:
            points = mesh.GetPointsAttr().Get(code)
            extent = UsdGeom.PointBased.ComputeExtent(points)
            if prim.IsA(UsdGeom.Curves):
                widths = UsdGeom.Curves(prim).GetWidthsAttr().Get()
                extent = UsdGeom.Curves.ComputeExtent(points, widths)
            assert mesh.GetExtentAttr().Get(code) == extent


@pytest.mark.parametrize("samples", [None, "-.25,0,.5"])
def test_velocities_are_differences_of_points_a_second(
    samples: str | None, tmp_path: Path
) -> None:
    write_pair(tmp_path)
    more = [] if samples is None else [f"--samples={samples}"]
    cache = baked(tmp_path, "cache.usdc", "--deform", "--velocities", *more)
    for name in [*MOVING, HAIR]:
        mesh = UsdGeom.PointBased(cache.GetPrimAtPath(f"/pair/Rig/{name}"))
        codes = mesh.GetPointsAttr().GetTimeSamples()
        assert mesh.GetVelocitiesAttr().GetTimeSamples() == codes
        assert len(codes) == (9 if samples is None else 27)
        points = np.array([mesh.GetPointsAttr().Get(code) for code in codes])
        seconds = np.array(codes) / 24
        truth = np.gradient(points.astype(np.float64), seconds, axis=0)
        found = np.array([mesh.GetVelocitiesAttr().Get(code) for code in codes])
        assert np.abs(found - truth).max() <= 1e-3


def test_normals_can_be_left_out(tmp_path: Path) -> None:
    write_pair(tmp_path)
    stage = baked(tmp_path, "cache.usda", "--deform", "--no-normals")
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh):
            assert not UsdGeom.Mesh(prim).GetNormalsAttr().Get(5)


def write_scene(folder: Path, output: str) -> str:
    write_pair(folder)
    text = f"scene: animtool/1\nsource: {{file: pair.clip.yaml}}\noutput: {output}\n"
    (folder / "pair.scene.yaml").write_text(text, "utf-8")
    return "pair.scene.yaml"


def test_a_scene_asks_for_points(tmp_path: Path) -> None:
    output = "{deform: true, velocities: true, normals: false, chunk: 4}"
    scene = write_scene(tmp_path, output)
    for folder, source, options in (
        ("asked", "pair.clip.yaml", ("--velocities", "--no-normals", "--chunk", 4)),
        ("scene", scene, ()),
    ):
        (tmp_path / folder).mkdir()
        more = ["--deform", *options] if options else []
        baked(tmp_path, f"{folder}/o.usdc", *more, source=source)
    asked, found = (
        {path.name: path.read_bytes() for path in (tmp_path / name).iterdir()}
        for name in ("asked", "scene")
    )
    assert len(asked) == 5
    assert found == asked


def test_the_command_line_comes_before_what_a_scene_asks(tmp_path: Path) -> None:
    scene = write_scene(tmp_path, "{deform: true, normals: false, chunk: 4}")
    options = ("--normals", "--chunk", "9")
    stage = baked(tmp_path, "o.usdc", *options, source=scene)
    assert len(list(tmp_path.glob("o.points.*"))) == 1
    body = UsdGeom.Mesh(stage.GetPrimAtPath("/pair/Rig/body"))
    assert body.GetNormalsAttr().Get(5)


def test_a_table_of_a_scene_of_points_is_refused(tmp_path: Path) -> None:
    scene = write_scene(tmp_path, "{deform: true}")
    done = animtool("bake", scene, "--table", cwd=tmp_path)
    assert done.code == 2
    assert "CLI002" in done.stderr


def test_a_scene_whose_chunks_are_empty_is_refused(tmp_path: Path) -> None:
    scene = write_scene(tmp_path, "{deform: true, chunk: 0}")
    done = animtool("bake", scene, cwd=tmp_path)
    assert done.code == 3
    assert "pair.scene.yaml:3" in done.stderr
    assert "DOC022" in done.stderr
    with pytest.raises(OptionError):
        bake(tmp_path / "pair.clip.yaml", None, BakeOptions(deform=True, chunk=0))


def rig_layer(folder: Path) -> Path:
    done = animtool("convert", "pair.rig.yaml", "pair.usda", cwd=folder)
    assert done.code == 0, done.stderr
    return folder / "pair.usda"


@methods
@pytest.mark.parametrize("normals", [True, False])
def test_a_layer_shows_in_a_shot_what_the_skinned_layer_shows(
    method: str, normals: bool, tmp_path: Path
) -> None:
    write_pair(tmp_path, method)
    rig = rig_layer(tmp_path)
    over = ("--rig-layer", rig)
    more = [] if normals else ["--no-normals"]
    baked(tmp_path, "cache.usdc", *over, "--deform", *more)
    baked(tmp_path, "skinned.usdc", *over)
    truth = skinned_points(layered(tmp_path, tmp_path / "skinned.usdc", rig), CODES)
    shot = Usd.Stage.Open(str(layered(tmp_path, tmp_path / "cache.usdc", rig)))
    assert set(truth) == {f"/pair/Rig/{name}" for name in [*MOVING, "rock", HAIR]}
    for path, points in truth.items():
        assert near(world_points(shot, path, CODES), points), path
    assert not bindings(shot)
    body = UsdGeom.Mesh(shot.GetPrimAtPath("/pair/Rig/body"))
    assert bool(body.GetNormalsAttr().Get(5)) is normals


def test_a_layer_holds_overs_alone(tmp_path: Path) -> None:
    write_pair(tmp_path)
    rig = rig_layer(tmp_path)
    baked(tmp_path, "cache.usda", "--rig-layer", rig, "--deform")
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "cache.usda"))
    specs: list[Sdf.PrimSpec] = []
    layer.Traverse(
        "/",
        lambda path: path.IsPrimPath() and specs.append(layer.GetPrimAtPath(path)),
    )
    assert {str(spec.path) for spec in specs} == {
        "/pair",
        "/pair/Rig",
        *(f"/pair/Rig/{name}" for name in [*MOVING, "rock", "Strands", HAIR]),
    }
    assert all(spec.specifier == Sdf.SpecifierOver for spec in specs)
    assert layer.GetPrimAtPath("/pair/Rig").typeName == "Xform"


def test_in_a_shot_that_holds_the_rig_elsewhere(tmp_path: Path) -> None:
    write_pair(tmp_path)
    rig_layer(tmp_path)
    shot = Usd.Stage.CreateNew(str(tmp_path / "set.usda"))
    UsdGeom.SetStageMetersPerUnit(shot, 0.01)
    UsdGeom.SetStageUpAxis(shot, "Y")
    shot.SetTimeCodesPerSecond(24)
    world = UsdGeom.Xform.Define(shot, "/World")
    shot.SetDefaultPrim(world.GetPrim())
    hero = UsdGeom.Xform.Define(shot, "/World/hero")
    hero.GetPrim().GetReferences().AddReference("./pair.usda")
    hero.AddTranslateOp().Set((100, 0, 30))
    shot.Save()
    options = ("--rig-layer", "set.usda", "--prim-path", "/World/hero")
    baked(tmp_path, "cache.usdc", *options, "--deform")
    baked(tmp_path, "skinned.usdc", *options)
    under = tmp_path / "set.usda"
    truth = skinned_points(layered(tmp_path, tmp_path / "skinned.usdc", under), CODES)
    made = Usd.Stage.Open(str(layered(tmp_path, tmp_path / "cache.usdc", under)))
    for path, points in truth.items():
        assert path.startswith("/World/hero/Rig/")
        assert near(world_points(made, path, CODES), points), path


def test_a_take_without_meshes_deforms_those_of_the_rig_layer(tmp_path: Path) -> None:
    write_pair(tmp_path)
    rig = rig_layer(tmp_path)
    baked(tmp_path, "take.usdc")
    done = animtool(
        *("bake", "take.usdc", "-o", "cache.usdc", "--rig-layer", rig, "--deform"),
        *("--format", "json"),
        cwd=tmp_path,
    )
    assert done.code == 0, done.stderr
    report = json.loads(done.stdout)
    assert {mesh["of"] for mesh in report["meshes"]} == {str(rig)}
    truth = skinned_points(tmp_path / "take.usdc", CODES)
    shot = Usd.Stage.Open(str(layered(tmp_path, tmp_path / "cache.usdc", rig)))
    for path, points in truth.items():
        assert near(world_points(shot, path, CODES), points), path


@pytest.mark.parametrize("options", [(), ("--to-up", "Z", "--to-units", "m")])
def test_a_skinned_stage_deforms_its_own_meshes(
    options: tuple[str, ...], tmp_path: Path
) -> None:
    write_pair(tmp_path)
    baked(tmp_path, "take.usdc")
    cache = baked(tmp_path, "cache.usdc", "--deform", *options, source="take.usdc")
    baked(tmp_path, "skinned.usdc", *options)
    for path, points in skinned_points(tmp_path / "skinned.usdc", CODES).items():
        assert near(world_points(cache, path, CODES), points), path


def test_several_takes_are_refused(tmp_path: Path) -> None:
    clip = write_pair(tmp_path)
    done = animtool("bake", clip, clip, "-o", "o.usdc", "--deform", cwd=tmp_path)
    assert done.code == 2
    assert "CLI002" in done.stderr


def test_a_mesh_that_stands_by_itself_below_the_root(tmp_path: Path) -> None:
    write_pair(tmp_path)
    rig = rig_layer(tmp_path)
    stage = Usd.Stage.Open(str(rig))
    body = UsdGeom.Xformable(stage.GetPrimAtPath("/pair/Rig/body"))
    body.AddTranslateOp().Set((3, 4, 5))
    body.AddRotateXYZOp().Set((20, 30, 40))
    body.AddScaleOp().Set((1, 2, 1))
    stage.GetRootLayer().Save()
    options = ("--rig-layer", rig)
    baked(tmp_path, "cache.usdc", *options, "--deform", "--velocities")
    baked(tmp_path, "skinned.usdc", *options)
    truth = skinned_points(layered(tmp_path, tmp_path / "skinned.usdc", rig), CODES)
    shot = Usd.Stage.Open(str(layered(tmp_path, tmp_path / "cache.usdc", rig)))
    path = "/pair/Rig/body"
    assert near(world_points(shot, path, CODES), truth[path])
    mesh = UsdGeom.Mesh(shot.GetPrimAtPath(path))
    extent = UsdGeom.PointBased.ComputeExtent(mesh.GetPointsAttr().Get(3))
    assert mesh.GetExtentAttr().Get(3) == extent


def test_meshes_that_the_rig_layer_lacks_are_named(tmp_path: Path) -> None:
    write_pair(tmp_path)
    rig = rig_layer(tmp_path)
    stage = Usd.Stage.Open(str(rig))
    stage.RemovePrim("/pair/Rig/sleeve")
    stage.GetRootLayer().Save()
    done = animtool(
        *("bake", "pair.clip.yaml", "-o", "cache.usdc", "--rig-layer", rig),
        *("--deform", "--format", "json"),
        cwd=tmp_path,
    )
    assert done.code == 0, done.stderr
    notices = {n["code"]: n["message"] for n in json.loads(done.stdout)["notices"]}
    assert "sleeve" in notices["USD141"]


def test_strands_that_the_rig_layer_lacks_are_named(tmp_path: Path) -> None:
    write_pair(tmp_path)
    rig = rig_layer(tmp_path)
    stage = Usd.Stage.Open(str(rig))
    stage.RemovePrim(f"/pair/Rig/{HAIR}")
    stage.GetRootLayer().Save()
    done = animtool(
        *("bake", "pair.clip.yaml", "-o", "cache.usdc", "--rig-layer", rig, "--deform"),
        cwd=tmp_path,
    )
    assert done.code == 0, done.stderr
    assert "USD141" in done.stderr
    assert "hair" in done.stderr


def test_curves_of_the_rig_layer_have_their_own_width_and_lose_normals(
    tmp_path: Path,
) -> None:
    write_pair(tmp_path)
    rig = rig_layer(tmp_path)
    stage = Usd.Stage.Open(str(rig))
    curves = UsdGeom.BasisCurves(stage.GetPrimAtPath(f"/pair/Rig/{HAIR}"))
    curves.GetWidthsAttr().Set([3.0])
    curves.GetNormalsAttr().Set([(0, 1, 0)] * (STRANDS[0] * STRANDS[1]))
    curves.AddTranslateOp().Set((3, 4, 5))
    stage.GetRootLayer().Save()
    baked(tmp_path, "cache.usdc", "--rig-layer", rig, "--deform")
    baked(tmp_path, "skinned.usdc", "--rig-layer", rig)
    truth = skinned_points(layered(tmp_path, tmp_path / "skinned.usdc", rig), CODES)
    shot = Usd.Stage.Open(str(layered(tmp_path, tmp_path / "cache.usdc", rig)))
    path = f"/pair/Rig/{HAIR}"
    assert near(world_points(shot, path, CODES), truth[path])
    found = UsdGeom.BasisCurves(shot.GetPrimAtPath(path))
    extent = UsdGeom.Curves.ComputeExtent(found.GetPointsAttr().Get(3), [3.0])
    assert found.GetExtentAttr().Get(3) == extent
    assert not found.GetNormalsAttr().Get(3)


def test_a_rig_of_strands_alone(tmp_path: Path) -> None:
    write_pair(tmp_path)
    path = tmp_path / "pair.rig.yaml"
    text = path.read_text("utf-8")
    meshes, attach = text.index("meshes:"), text.index("attach:")
    path.write_text(text[:meshes] + text[attach:], "utf-8")
    clip = tmp_path / "pair.clip.yaml"
    lines = clip.read_text("utf-8").splitlines(keepends=True)
    clip.write_text("".join(x for x in lines if "shape/" not in x), "utf-8")
    cache = baked(tmp_path, "cache.usdc", "--deform")
    baked(tmp_path, "skinned.usdc")
    truth = skinned_points(tmp_path / "skinned.usdc", CODES)
    assert set(truth) == {f"/pair/Rig/{HAIR}"}
    for where, points in truth.items():
        assert near(world_points(cache, where, CODES), points)


def test_what_stops_following_is_named(tmp_path: Path) -> None:
    write_pair(tmp_path)
    rig = rig_layer(tmp_path)
    stage = Usd.Stage.Open(str(rig))
    layer = stage.GetRootLayer()
    Sdf.CopySpec(layer, "/pair/Rig/body", layer, "/pair/Rig/beard")
    layer.Save()
    done = animtool(
        *("bake", "pair.clip.yaml", "-o", "cache.usdc", "--rig-layer", rig),
        *("--deform", "--format", "json"),
        cwd=tmp_path,
    )
    assert done.code == 0, done.stderr
    notices = {n["code"]: n["message"] for n in json.loads(done.stdout)["notices"]}
    assert "/pair/Rig/beard" in notices["USD142"]


def fewer_points(mesh: UsdGeom.PointBased) -> None:
    mesh.GetPointsAttr().Set([(0, 0, 0)] * 3)


def longer_strands(curves: UsdGeom.PointBased) -> None:
    counts = [STRANDS[0]] * STRANDS[1]
    UsdGeom.Curves(curves.GetPrim()).GetCurveVertexCountsAttr().Set(counts)


def moving(mesh: UsdGeom.PointBased) -> None:
    operation = mesh.AddTranslateOp()
    operation.Set((1, 2, 3), 1)
    operation.Set((2, 2, 3), 5)


@pytest.mark.parametrize(
    ("name", "edit", "code"),
    [
        ("body", fewer_points, "USD041"),
        ("body", moving, "USD043"),
        (HAIR, longer_strands, "USD041"),
        (HAIR, moving, "USD043"),
    ],
)
def test_a_rig_layer_that_does_not_fit(
    name: str, edit: Callable[[UsdGeom.PointBased], None], code: str, tmp_path: Path
) -> None:
    write_pair(tmp_path)
    rig = rig_layer(tmp_path)
    stage = Usd.Stage.Open(str(rig))
    edit(UsdGeom.PointBased(stage.GetPrimAtPath(f"/pair/Rig/{name}")))
    stage.GetRootLayer().Save()
    before = sorted(tmp_path.iterdir())
    done = animtool(
        *("bake", "pair.clip.yaml", "-o", "cache.usdc", "--rig-layer", rig),
        "--deform",
        cwd=tmp_path,
    )
    assert done.code == 3
    assert code in done.stderr
    assert sorted(tmp_path.iterdir()) == before


def test_an_instanced_rig_is_out_of_reach(tmp_path: Path) -> None:
    write_pair(tmp_path)
    rig_layer(tmp_path)
    shot = Usd.Stage.CreateNew(str(tmp_path / "set.usda"))
    UsdGeom.SetStageMetersPerUnit(shot, 0.01)
    UsdGeom.SetStageUpAxis(shot, "Y")
    shot.SetTimeCodesPerSecond(24)
    hero = UsdGeom.Xform.Define(shot, "/hero").GetPrim()
    shot.SetDefaultPrim(hero)
    hero.GetReferences().AddReference("./pair.usda")
    hero.SetInstanceable(True)
    shot.Save()
    done = animtool(
        *("bake", "pair.clip.yaml", "-o", "cache.usdc", "--rig-layer", "set.usda"),
        "--deform",
        cwd=tmp_path,
    )
    assert done.code == 3
    assert "USD042" in done.stderr
    assert not (tmp_path / "cache.usdc").exists()


def test_a_take_without_meshes_is_refused(walk: Path, tmp_path: Path) -> None:
    done = animtool("bake", walk, "-o", tmp_path / "o.usdc", "--deform")
    assert done.code == 3
    assert "USD040" in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "option",
    ["--split", "--bones", "--sparse", "--reduce=1mm", "--root-motion=skelroot"],
)
def test_what_is_of_joints_is_refused(option: str, tmp_path: Path) -> None:
    write_pair(tmp_path)
    done = animtool("bake", "pair.clip.yaml", "--deform", option, cwd=tmp_path)
    assert done.code == 2
    assert "CLI002" in done.stderr


@pytest.mark.parametrize("option", ["--velocities", "--no-normals"])
def test_what_goes_with_deform_alone(option: str, tmp_path: Path) -> None:
    write_pair(tmp_path)
    done = animtool("bake", "pair.clip.yaml", option, cwd=tmp_path)
    assert done.code == 2
    assert "CLI002" in done.stderr


def test_tables_are_of_joints(tmp_path: Path) -> None:
    write_pair(tmp_path)
    done = animtool("bake", "pair.clip.yaml", "--deform", "--table", cwd=tmp_path)
    assert done.code == 2


def test_bind_transforms_without_inverse_are_said_of_skeletons(tmp_path: Path) -> None:
    write_pair(tmp_path)
    rig = rig_layer(tmp_path)
    stage = Usd.Stage.Open(str(rig))
    skeleton = stage.GetPrimAtPath("/pair/Rig/Skel")
    binds = list(skeleton.GetAttribute("bindTransforms").Get())
    binds[2] = Gf.Matrix4d(0)
    skeleton.GetAttribute("bindTransforms").Set(binds)
    stage.GetRootLayer().Save()
    done = animtool("bake", rig, "-o", "cache.usdc", "--deform", cwd=tmp_path)
    assert done.code == 3
    assert "USD226 /pair/Rig/Skel.bindTransforms: 1 bindTransforms" in done.stderr
    assert not (tmp_path / "cache.usdc").exists()


def test_the_report(tmp_path: Path) -> None:
    write_pair(tmp_path)
    done = animtool(
        *("bake", "pair.clip.yaml", "-o", "c.usdc", "--deform", "--format", "json"),
        cwd=tmp_path,
    )
    meshes = {mesh["mesh"]: mesh for mesh in json.loads(done.stdout)["meshes"]}
    assert set(meshes) == {*MOVING, "rock", "hair"}
    assert {m["mesh"] for m in meshes.values() if m["kind"] == "strands"} == {"hair"}
    assert meshes["hair"]["animated"] == ["points", "extent"]
    body = meshes["body"]
    assert body["vertices"] == VERTICES
    assert body["samples"] == 9
    assert body["animated"] == ["points", "extent", "normals"]
    assert body["bytes"] == 9 * (2 * VERTICES + 2) * 12
    # Half a step of float32 at some metres.
    assert 0 < body["error"]["meters"] < 2e-7
    assert meshes["rock"]["samples"] == meshes["rock"]["bytes"] == 0
