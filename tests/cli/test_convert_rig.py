"""``convert`` of rigs: to USD, back, and what was edited between."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, data_folder
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, Vt
from support.cli import animtool
from support.suite import some_quick
from support.surfaces import shaped_rig
from support.usd import open_stage, skeleton_query, validation_errors

from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import surfaces_of, with_array_file
from animtool.rig.write import rig_text

RIGS = sorted((ROOT / "rigs").glob("*/*.rig.yaml"))


@pytest.fixture
def hero(tmp_path: Path) -> Path:
    """A rig file with meshes and shapes, its arrays beside it."""
    folder = tmp_path / "rig"
    folder.mkdir()
    rig, arrays = with_array_file(shaped_rig(), folder / "hero.npz")
    np.savez_compressed(folder / "hero.npz", allow_pickle=False, **arrays)
    text = rig_text(rig)
    text += 'controls:\n- {name: grin, drives: [{shape: smile, expr: "grin"}]}\n'
    text += "- {name: curl, drives: [{joint: hand.angle, curve: [[0, 0], [1, 57]]}]}\n"
    text += "ik: [{name: reach, root: arm.l, tip: hand}]\n"
    text += "attach: [{name: hair, kind: spring_chain, joints: [hand]}]\n"
    text += "colliders: [{joint: arm.l, capsule: {radius: .1, length: .2}}]\n"
    (folder / "hero.rig.yaml").write_text(text)
    return folder / "hero.rig.yaml"


@pytest.mark.slow
@pytest.mark.parametrize("path", some_quick(RIGS, 3), ids=lambda path: path.parent.name)
def test_every_shipped_rig_comes_back_equal(path: Path, tmp_path: Path) -> None:
    layer, back = tmp_path / "x.usdc", tmp_path / "x.rig.yaml"
    done = animtool("convert", path, layer, "--physics", "--format", "json")
    assert done.code == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["physics"] == sum(j.type != "free" for j in Rig.load(path).joints)
    for made in report["outputs"]:
        assert validation_errors(open_stage(Path(made))) == []
    done = animtool("convert", layer, back, "--strict")
    assert done.code == 0, done.stderr
    rig, found = Rig.load(path), Rig.load(back)
    assert found.joints == rig.joints
    assert found.controls == rig.controls
    assert found.chains == rig.chains
    for one, other in zip(rig.attach, found.attach, strict=True):
        bare = {"pins": None, "points": None}
        assert replace(one, **bare) == replace(other, **bare)
        for a, b in ((one.pins, other.pins), (one.points, other.points)):
            assert (a is None) is (b is None)
            if a is not None and b is not None:
                np.testing.assert_array_equal(
                    a.load().astype(np.float32), b.load().astype(np.float32)
                )
    assert found.colliders == rig.colliders
    assert [s.name for s in found.shapes] == [s.name for s in rig.shapes]
    assert [s.combine for s in found.shapes] == [s.combine for s in rig.shapes]
    for one, other in zip(surfaces_of(rig), surfaces_of(found), strict=True):
        # Points of USD are float32.
        np.testing.assert_allclose(one.points, other.points, rtol=1e-6, atol=1e-6)


def test_there_and_back_is_the_same_layer(hero: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "a.usda", tmp_path / "b.usda"
    back = tmp_path / "hero.rig.yaml"
    assert animtool("convert", hero, first).code == 0
    assert animtool("convert", first, back).code == 0
    assert (tmp_path / "hero.npz").is_file()
    done = animtool("convert", back, second)
    assert done.code == 0, done.stderr
    assert first.read_bytes() == second.read_bytes()


def test_a_rig_file_moves_with_its_arrays(hero: Path, tmp_path: Path) -> None:
    done = animtool("convert", hero, tmp_path / "other.rig.yaml")
    assert done.code == 0, done.stderr
    moved = Rig.load(tmp_path / "other.rig.yaml")
    assert moved.joints == Rig.load(hero).joints
    assert (tmp_path / "other.npz").is_file()
    for one, other in zip(surfaces_of(Rig.load(hero)), surfaces_of(moved), strict=True):
        np.testing.assert_array_equal(one.points, other.points)


def test_physics_stands_over_the_rig(hero: Path, tmp_path: Path) -> None:
    assert animtool("convert", hero, tmp_path / "hero.usda", "--physics").code == 0
    stage = open_stage(tmp_path / "hero.physics.usda")
    assert stage.GetPrimAtPath("/hero/Rig/Skel")
    joints = [p.GetName() for p in stage.Traverse() if p.IsA(UsdPhysics.Joint)]
    assert joints == ["arm_l", "hand"]
    assert not open_stage(tmp_path / "hero.usda").GetPrimAtPath("/hero/Physics")


def edited(hero: Path, tmp_path: Path, change) -> tuple[Rig, str]:
    """Return the rig and what was said of it, after a change of its layer."""
    path, back = tmp_path / "e.usda", tmp_path / "e.rig.yaml"
    assert animtool("convert", hero, path).code == 0
    layer = Sdf.Layer.FindOrOpen(str(path))
    change(layer.GetPrimAtPath("/hero/Rig/Skel"))
    layer.Save()
    done = animtool("convert", path, back)
    assert done.code == 0, done.stderr
    assert animtool("convert", path, tmp_path / "s.rig.yaml", "--strict").code == (
        1 if "warning:" in done.stderr else 0
    )
    return Rig.load(back), done.stderr


def test_a_unit_changed_in_usd_is_said(hero: Path, tmp_path: Path) -> None:
    def shrink(spec: Sdf.PrimSpec) -> None:
        spec.layer.pseudoRoot.SetInfo("metersPerUnit", 0.01)

    rig, said = edited(hero, tmp_path, shrink)
    assert "USD126" in said
    assert "USD126" in animtool("validate", tmp_path / "e.usda").stdout
    assert "USD117" not in said
    sizes = [np.abs(r.rest_translations).max() for r in (Rig.load(hero), rig)]
    assert sizes[1] == pytest.approx(sizes[0] / 100)


def test_a_joint_moved_in_usd_is_said(hero: Path, tmp_path: Path) -> None:
    def move(spec: Sdf.PrimSpec) -> None:
        attribute = spec.attributes["restTransforms"]
        matrices = list(attribute.default)
        matrices[2] = Gf.Matrix4d(1).SetTranslate((0.75, 0, 0))
        attribute.default = Vt.Matrix4dArray(matrices)

    rig, said = edited(hero, tmp_path, move)
    assert "USD117" in said
    assert "hand" in said
    assert "arm" not in said.split("USD117")[1]
    assert rig.joints[2].translation == (0.75, 0, 0)
    assert rig.joints[2].type == "pin"
    assert len(rig.controls) == 2


def test_a_joint_that_is_gone_takes_its_parts_along(hero: Path, tmp_path: Path) -> None:
    def cut(spec: Sdf.PrimSpec) -> None:
        for name in ("joints", "restTransforms", "bindTransforms"):
            attribute = spec.attributes[name]
            attribute.default = type(attribute.default)(list(attribute.default)[:2])
        parent = spec.nameParent
        del parent.nameChildren["body"]

    rig, said = edited(hero, tmp_path, cut)
    assert "USD117" in said
    assert "removed: hand" in said
    assert rig.names == ["root", "arm.l"]
    assert rig.chains == rig.attach == ()
    assert [len(control.drives) for control in rig.controls] == [1, 0]
    assert len(rig.colliders) == 1


def test_what_was_not_edited_is_not_said(hero: Path, tmp_path: Path) -> None:
    def comment(spec: Sdf.PrimSpec) -> None:
        spec.comment = "cannot be examined"

    _, said = edited(hero, tmp_path, comment)
    assert "USD117" not in said


def test_customdata_that_is_none_is_refused(hero: Path, tmp_path: Path) -> None:
    path = tmp_path / "x.usda"
    assert animtool("convert", hero, path).code == 0
    path.write_text(path.read_text().replace("type: pin", "type: pim"))
    done = animtool("convert", path, tmp_path / "x.rig.yaml")
    assert done.code == 3
    assert "USD007" in done.stderr
    assert not (tmp_path / "x.rig.yaml").exists()


def test_a_bake_shows_the_meshes(hero: Path, tmp_path: Path) -> None:
    clip = hero.with_name("wave.clip.yaml")
    clip.write_text(
        "clip: animtool/1\nrig: hero.rig.yaml\nfps: 24\nchannels:\n"
        "- {target: joint/hand.angle, keys: [{t: 1, v: 0}, {t: 9, v: 50}]}\n"
        "- {target: control/grin, keys: [{t: 1, v: 0}, {t: 9, v: 1}]}\n"
    )
    output = tmp_path / "wave.usda"
    done = animtool("bake", clip, "-o", output, "--to-up", "Z", "--to-units", "cm")
    assert done.code == 0, done.stderr
    stage = open_stage(output)
    assert validation_errors(stage) == []
    meshes = [p.GetName() for p in stage.Traverse() if p.IsA(UsdGeom.Mesh)]
    assert meshes == ["body", "Skel_2"]
    root = UsdGeom.Boundable(stage.GetPrimAtPath("/hero/Rig"))
    for code in (1, 5, 9):
        wanted = UsdGeom.Boundable.ComputeExtentFromPlugins(root, Usd.TimeCode(code))
        np.testing.assert_allclose(
            root.GetExtentAttr().Get(code), wanted, rtol=1e-5, atol=1e-3
        )
    animation = skeleton_query(stage).GetAnimQuery()
    assert list(animation.GetBlendShapeOrder()) == ["smile"]
    assert animation.ComputeBlendShapeWeights(9)[0] == 1.0


def test_an_animation_layer_over_a_rig_layer(hero: Path, tmp_path: Path) -> None:
    layer, output = tmp_path / "hero.usda", tmp_path / "wave.usda"
    assert animtool("convert", hero, layer).code == 0
    clip = hero.with_name("wave.clip.yaml")
    clip.write_text(
        "clip: animtool/1\nrig: hero.rig.yaml\nfps: 24\nchannels:\n"
        "- {target: joint/hand.angle, keys: [{t: 1, v: 0}, {t: 9, v: 50}]}\n"
    )
    done = animtool("bake", clip, "-o", output, "--rig-layer", layer)
    assert done.code == 0, done.stderr
    shot = Sdf.Layer.CreateAnonymous(".usda")
    shot.subLayerPaths = [str(output), str(layer)]
    stage = Usd.Stage.Open(shot)
    assert skeleton_query(stage).GetAnimQuery()
    root = UsdGeom.Boundable(stage.GetPrimAtPath("/hero/Rig"))
    wanted = UsdGeom.Boundable.ComputeExtentFromPlugins(root, Usd.TimeCode(9))
    np.testing.assert_allclose(
        root.GetExtentAttr().Get(9), wanted, rtol=1e-5, atol=1e-5
    )


@pytest.mark.parametrize(
    ("source", "output", "options", "code", "said"),
    [
        ("hero.rig.yaml", "x.bvh", [], 2, "OUT004"),
        (
            "hero.rig.yaml",
            "x.usda",
            ["--reduce", "1mm"],
            2,
            "applies to motion",
        ),
        ("hero.rig.yaml", "x.rig.yaml", ["--physics"], 2, "CLI004"),
        ("none.rig.yaml", "x.usda", [], 3, "IO001"),
        ("hero.rig.yaml", "hero.rig.yaml", [], 2, "OUT003"),
        ("hero.npz", "x.rig.yaml", [], 2, "IO002"),
    ],
)
def test_what_makes_no_sense(
    hero: Path, source: str, output: str, options: list[str], code: int, said: str
) -> None:
    folder = hero.parent
    before = sorted(folder.iterdir())
    done = animtool("convert", folder / source, folder / output, *options)
    assert done.code == code, done.stderr
    assert said in done.stderr
    assert sorted(folder.iterdir()) == before


def test_nothing_is_overwritten(hero: Path, tmp_path: Path) -> None:
    (tmp_path / "hero.npz").write_bytes(b"mine")
    layer = tmp_path / "hero.usda"
    assert animtool("convert", hero, layer).code == 0
    done = animtool("convert", layer, tmp_path / "hero.rig.yaml")
    assert done.code == 2
    assert "OUT001" in done.stderr
    assert (tmp_path / "hero.npz").read_bytes() == b"mine"
    assert not (tmp_path / "hero.rig.yaml").exists()


def test_rigs_of_other_tools(tmp_path: Path) -> None:
    folder = data_folder("rigs")
    if folder is None:
        pytest.skip("ANIMTOOL_DATA has no rigs")
    for path in sorted(folder.glob("*.usda")):
        back, again = tmp_path / f"{path.stem}.rig.yaml", tmp_path / path.name
        assert animtool("convert", path, back).code == 0
        assert animtool("convert", back, again).code == 0
        one, other = surfaces_of(Rig.load(path)), surfaces_of(Rig.load(again))
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a.points, b.points)
            assert [s.name for s in a.shapes] == [s.name for s in b.shapes]


def test_a_take_of_a_stage_has_the_rig_that_it_was_made_for(
    hero: Path, tmp_path: Path
) -> None:
    clip = hero.with_name("wave.clip.yaml")
    clip.write_text(
        "clip: animtool/1\nrig: hero.rig.yaml\nfps: 24\nchannels:\n"
        "- {target: joint/hand.angle, keys: [{t: 1, v: 0}, {t: 9, v: 50}]}\n"
    )
    stage, keys = tmp_path / "wave.usdc", tmp_path / "keys.clip.yaml"
    assert animtool("bake", clip, "-o", stage).code == 0
    done = animtool("convert", stage, keys, "--reduce", "0.1mm")
    assert done.code == 0, done.stderr
    made, rig = Rig.load(tmp_path / "keys.rig.yaml"), Rig.load(hero)
    assert made.joints == rig.joints
    assert made.controls == rig.controls
    assert animtool("bake", keys, "-o", tmp_path / "again.usdc").code == 0


def test_a_stage_of_ours_is_read_without_a_word(tmp_path: Path) -> None:
    stage = tmp_path / "stride.usdc"
    clip = ROOT / "samples/stride/stride.clip.yaml"
    assert animtool("bake", clip, "-o", stage).code == 0
    done = animtool("info", stage)
    assert done.code == 0
    assert done.stderr == ""


def test_one_of_several_characters_by_its_prim(tmp_path: Path) -> None:
    for name in ("arm", "ball"):
        rig = ROOT / f"rigs/{name}/{name}.rig.yaml"
        assert animtool("convert", rig, tmp_path / f"{name}.usda").code == 0
    shot = Usd.Stage.CreateNew(str(tmp_path / "shot.usda"))
    UsdGeom.SetStageMetersPerUnit(shot, 1.0)
    UsdGeom.SetStageUpAxis(shot, "Y")
    for name in ("arm", "ball"):
        prim = UsdGeom.Xform.Define(shot, f"/World/{name}").GetPrim()
        prim.GetReferences().AddReference(f"./{name}.usda")
    shot.Save()
    for name in ("arm", "ball"):
        for suffix in ("rig.yaml", "usdc"):
            output = tmp_path / f"{name}_again.{suffix}"
            options = ("--source-prim", f"/World/{name}")
            more = ("--physics",) if suffix == "usdc" else ()
            shown = tmp_path / "shot.usda"
            done = animtool("convert", shown, output, *options, *more)
            assert done.code == 0, done.stderr
            assert "USD107" not in done.stderr
            names = Rig.load(ROOT / f"rigs/{name}/{name}.rig.yaml").names
            assert Rig.load(output).names == names


def test_a_prim_without_a_character_is_refused(tmp_path: Path) -> None:
    rig = ROOT / "rigs/ball/ball.rig.yaml"
    usd = tmp_path / "ball.usda"
    assert animtool("convert", rig, usd).code == 0
    for source, path, code, number in (
        (usd, "/nowhere", "USD008", 3),
        (usd, "no path", "CLI003", 2),
        (rig, "/ball", "CLI004", 2),
    ):
        output = tmp_path / "o.rig.yaml"
        done = animtool("convert", source, output, "--source-prim", path)
        assert (done.code, code in done.stderr) == (number, True), done.stderr
        assert not output.exists()


def test_what_a_rig_is_from_is_not_replaced(hero: Path, tmp_path: Path) -> None:
    assert animtool("convert", hero, tmp_path / "own.usda").code == 0
    before = (tmp_path / "own.usda").read_bytes()
    sidecar = tmp_path / "side.rig.yaml"
    sidecar.write_text("rig: animtool/1\nname: side\nfrom: own.usda\n")
    done = animtool("convert", sidecar, tmp_path / "own.usda", "--overwrite")
    assert done.code == 2
    assert "OUT003" in done.stderr
    assert (tmp_path / "own.usda").read_bytes() == before
