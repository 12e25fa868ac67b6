"""What a written file holds, by the rules of the USD output."""

from __future__ import annotations

import re
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pxr import Sdf, Usd, UsdGeom, UsdSkel
from support.bvh import HEADER, SPINE, random_rows, small_bvh
from support.usd import joint_positions, open_stage, skeleton_query, validation_errors

from animtool.core.errors import AnimtoolError
from animtool.core.shot import FrameRange
from animtool.core.units import LengthUnit, UpAxis
from animtool.scene.bake.bake import bake
from animtool.scene.bake.options import BakeOptions
from animtool.scene.sources.open import SourceOptions, open_source
from animtool.usd import write


@pytest.fixture
def take(tmp_path: Path) -> Path:
    path = tmp_path / "hero.bvh"
    path.write_text(small_bvh(random_rows(13), frame_time="0.0083333"))
    return path


def samples(stage: Usd.Stage, name: str = "rotations") -> list[float]:
    prim = next(p for p in stage.Traverse() if p.IsA(UsdSkel.Animation))
    return list(prim.GetAttribute(name).GetTimeSamples())


def test_places_and_metadata(take: Path, tmp_path: Path) -> None:
    bake(take, tmp_path / "o.usda")
    stage = open_stage(tmp_path / "o.usda")
    assert str(stage.GetDefaultPrim().GetPath()) == "/hero"
    assert Usd.ModelAPI(stage.GetDefaultPrim()).GetKind() == "component"
    kinds = {str(p.GetPath()): p.GetTypeName() for p in stage.Traverse()}
    assert kinds == {
        "/hero": "Xform",
        "/hero/Rig": "SkelRoot",
        "/hero/Rig/Skel": "Skeleton",
        "/hero/Rig/Anim": "SkelAnimation",
    }
    assert samples(stage) == list(range(1, 14))
    assert samples(stage, "scales") == []
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (1, 13)
    assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == 120


def test_what_never_moves_is_a_default(tmp_path: Path) -> None:
    path = tmp_path / "still.bvh"
    path.write_text(small_bvh(np.tile(random_rows(1), (5, 1))))
    bake(path, tmp_path / "o.usda")
    stage = open_stage(tmp_path / "o.usda")
    for name in ("translations", "rotations", "scales"):
        assert samples(stage, name) == []
        assert (
            stage.GetPrimAtPath("/still/Rig/Anim").GetAttribute(name).Get() is not None
        )
    assert stage.GetEndTimeCode() == 5
    assert skeleton_query(stage).GetAnimQuery()


def test_motion_that_starts_late_is_sampled_from_the_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from animtool.formats.bvh import lines as lines_module

    rows = np.ones((9, 9))
    rows[6:, 8] = 5.0
    path = tmp_path / "late.bvh"
    path.write_text(small_bvh(rows))
    bake(path, tmp_path / "a.usda")
    assert samples(open_stage(tmp_path / "a.usda")) == list(range(1, 10))
    monkeypatch.setattr(lines_module, "BLOCK_VALUES", 18)
    bake(path, tmp_path / "b.usda")
    assert (tmp_path / "a.usda").read_bytes() == (tmp_path / "b.usda").read_bytes()


def test_split(take: Path, tmp_path: Path) -> None:
    report = bake(take, tmp_path / "o.usdc", BakeOptions(form="split"))
    names = [path.name for path in report.result.outputs]
    assert names == ["o.rig.usda", "o.anim.usdc", "o.usdc"]
    root = Sdf.Layer.FindOrOpen(str(tmp_path / "o.usdc"))
    assert list(root.subLayerPaths) == ["./o.anim.usdc", "./o.rig.usda"]
    for path in report.result.outputs:
        layer = Sdf.Layer.FindOrOpen(str(path))
        assert layer.timeCodesPerSecond == layer.framesPerSecond == 120
        assert (layer.startTimeCode, layer.endTimeCode) == (1, 13)
        assert layer.defaultPrim == "hero"
        assert layer.pseudoRoot.GetInfo("metersPerUnit") == 0.01
    assert validation_errors(open_stage(tmp_path / "o.usdc")) == []


def layer_over(take: Path, tmp_path: Path, **options: object) -> Sdf.Layer:
    """Bake a layer over a 24 fps rig that starts at 1001."""
    rig_bvh = tmp_path / "rig.bvh"
    rig_bvh.write_text(small_bvh(random_rows(3, seed=5), frame_time="0.0416667"))
    rig = BakeOptions(form="split", start=Fraction(1001), overwrite=True)
    bake(rig_bvh, tmp_path / "rig.usda", rig)
    settings = BakeOptions(rig_layer=tmp_path / "rig.rig.usda", overwrite=True)
    bake(take, tmp_path / "layer.usda", replace(settings, **options))  # type: ignore[arg-type]
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "layer.usda"))
    layer.Reload(force=True)
    return layer


@pytest.mark.parametrize("keep", [False, True])
def test_a_fast_take_over_a_slow_rig(take: Path, tmp_path: Path, keep: bool) -> None:
    layer = layer_over(take, tmp_path, keep_samples=keep)
    assert layer.timeCodesPerSecond == layer.framesPerSecond == 24
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().subLayerPaths = [
        layer.identifier,
        str(tmp_path / "rig.rig.usda"),
    ]
    stage.SetTimeCodesPerSecond(24)
    found = samples(stage)
    if keep:
        assert found == [float(1001 + Fraction(i, 5)) for i in range(13)]
        assert layer.endTimeCode == float(1001 + Fraction(12, 5))
    else:
        assert found == [1001.0, 1002.0, 1003.0]
        assert layer.endTimeCode == 1003
    assert layer.startTimeCode == 1001
    # Where they coincide, the samples are the source's own, exactly.
    bake(take, tmp_path / "own.usda")
    own_stage = open_stage(tmp_path / "own.usda")
    own = own_stage.GetPrimAtPath("/hero/Rig/Anim")
    anim = stage.GetPrimAtPath("/rig/Rig/Anim")
    for source, code in ((1, 1001), (6, 1002), (11, 1003)):
        for name in ("rotations", "translations"):
            mine, theirs = (
                anim.GetAttribute(name).Get(code),
                own.GetAttribute(name).Get(source),
            )
            assert mine == theirs


def test_a_layer_holds_only_its_animation(take: Path, tmp_path: Path) -> None:
    layer = layer_over(take, tmp_path)
    text = (tmp_path / "layer.usda").read_text()
    assert re.findall(r"^ *def .*", text, re.M) == ['        def SkelAnimation "Anim"']
    assert "@" not in text
    assert str(tmp_path) not in text
    root = layer.GetPrimAtPath("/rig/Rig")
    assert root.specifier == Sdf.SpecifierOver
    assert "restTransforms" not in text


@pytest.mark.parametrize("prim", ["/World/hero", "/rig"])
def test_prim_path_of_a_layer(take: Path, tmp_path: Path, prim: str) -> None:
    layer = layer_over(take, tmp_path, prim_path=prim)
    shot = Usd.Stage.CreateInMemory()
    shot.SetTimeCodesPerSecond(24)
    hero = shot.DefinePrim(prim)
    hero.GetReferences().AddReference(str(tmp_path / "rig.rig.usda"))
    shot.GetRootLayer().subLayerPaths = [layer.identifier]
    query = skeleton_query(shot)
    assert str(query.GetAnimQuery().GetPrim().GetPath()) == f"{prim}/Rig/Anim"
    assert layer.defaultPrim == prim.split("/")[1]
    root = UsdGeom.Boundable(shot.GetPrimAtPath(f"{prim}/Rig"))
    for code in (1001, 1003):
        written = np.array(root.GetExtentAttr().Get(code))
        computed = UsdGeom.Boundable.ComputeExtentFromPlugins(root, Usd.TimeCode(code))
        assert_allclose(written, np.array(computed), rtol=1e-6, atol=1e-6)


def test_over_a_shot_that_holds_the_rig(take: Path, tmp_path: Path) -> None:
    layer_over(take, tmp_path)
    shot = Usd.Stage.CreateNew(str(tmp_path / "shot.usda"))
    shot.DefinePrim("/World/a/hero").GetReferences().AddReference("./rig.rig.usda")
    shot.SetTimeCodesPerSecond(24)
    shot.SetStartTimeCode(1009)
    UsdGeom.SetStageUpAxis(shot, "Z")
    UsdGeom.SetStageMetersPerUnit(shot, 1.0)
    shot.Save()
    options = BakeOptions(rig_layer=tmp_path / "shot.usda", prim_path="/World/a/hero")
    report = bake(take, tmp_path / "over.usda", options)
    # The layer states what the shot states; its numbers are those of the skeleton.
    assert (report.result.first, report.up, report.meters_per_unit) == (1009, "Y", 0.01)
    assert [n.code for n in report.notices] == ["USD110", "TAKE006"]
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "over.usda"))
    root = layer.pseudoRoot
    assert (root.GetInfo("metersPerUnit"), root.GetInfo("upAxis")) == (1.0, "Z")
    shot.GetRootLayer().subLayerPaths = ["./over.usda"]
    bake(take, tmp_path / "own.usda", BakeOptions(fps=Fraction(24)))
    own = joint_positions(open_stage(tmp_path / "own.usda"), [1, 2])
    assert_allclose(joint_positions(shot, [1009, 1010]), own, atol=2e-5)
    assert layer.GetPrimAtPath("/World/a/hero/Rig/Anim").specifier == Sdf.SpecifierDef


def test_the_binding_goes_where_the_rig_has_it(take: Path, tmp_path: Path) -> None:
    layer_over(take, tmp_path)
    rig = Sdf.Layer.FindOrOpen(str(tmp_path / "rig.rig.usda"))
    skel = Sdf.RelationshipSpec(
        rig.GetPrimAtPath("/rig/Rig/Skel"), "skel:animationSource"
    )
    skel.targetPathList.explicitItems = [Sdf.Path("/rig/Rig/Other")]
    rig.Export(str(tmp_path / "bound.usda"))
    options = BakeOptions(rig_layer=tmp_path / "bound.usda")
    bake(take, tmp_path / "over.usda", options)
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "over.usda"))
    binding = layer.GetPrimAtPath("/rig/Rig/Skel").relationships["skel:animationSource"]
    assert list(binding.targetPathList.explicitItems) == [Sdf.Path("/rig/Rig/Anim")]


def test_joints_that_only_one_side_has(take: Path, tmp_path: Path) -> None:
    path = tmp_path / "other.bvh"
    path.write_text(small_bvh(random_rows(13), header=HEADER.replace("Spine", "Tail")))
    layer_over(take, tmp_path)
    options = BakeOptions(rig_layer=tmp_path / "rig.rig.usda")
    report = bake(path, tmp_path / "over.usda", options)
    codes = ["USD102", "USD111", "TAKE006", "TAKE007"]
    assert [n.code for n in report.notices] == codes
    assert report.result.joints == 1
    none = tmp_path / "none.bvh"
    renamed = HEADER.replace("Spine", "Tail").replace("Hips", "Base")
    none.write_text(small_bvh(random_rows(2), header=renamed))
    with pytest.raises(AnimtoolError) as caught:
        bake(none, tmp_path / "none.usda", options)
    assert caught.value.code == "USD010"


@pytest.mark.parametrize("units", list(LengthUnit))
def test_units(take: Path, tmp_path: Path, units: LengthUnit) -> None:
    stated = BakeOptions(source=SourceOptions(unit=units))
    bake(take, tmp_path / "stated.usda", stated)
    bake(take, tmp_path / "plain.usda")
    one, two = open_stage(tmp_path / "stated.usda"), open_stage(tmp_path / "plain.usda")
    # Declared, the numbers stay.
    assert UsdGeom.GetStageMetersPerUnit(one) == units.meters
    assert_allclose(joint_positions(one, [3]), joint_positions(two, [3]), rtol=1e-6)
    bake(take, tmp_path / "to.usda", BakeOptions(to_units=units))
    three = open_stage(tmp_path / "to.usda")
    assert UsdGeom.GetStageMetersPerUnit(three) == units.meters
    assert_allclose(
        joint_positions(three, [3]) * units.meters,
        joint_positions(two, [3]) * 0.01,
        rtol=1e-6,
    )
    bind = skeleton_query(three).GetSkeleton().GetBindTransformsAttr().Get()
    spine = np.subtract(*np.array(bind)[[1, 0], 3, :3])
    assert_allclose(spine * units.meters, 0.01 * np.array(SPINE))


def test_up(take: Path, tmp_path: Path) -> None:
    bake(take, tmp_path / "y.usda")
    bake(take, tmp_path / "z.usda", BakeOptions(to_up=UpAxis.Z))
    y, z = open_stage(tmp_path / "y.usda"), open_stage(tmp_path / "z.usda")
    assert UsdGeom.GetStageUpAxis(z) == "Z"
    a, b = joint_positions(y, [1, 9]), joint_positions(z, [1, 9])
    turned = np.stack([a[..., 0], -a[..., 2], a[..., 1]], axis=-1)
    assert_allclose(b, turned, atol=1e-5)


def test_rest_of_a_frame(take: Path, tmp_path: Path) -> None:
    bake(take, tmp_path / "o.usda", BakeOptions(rest_frame=4))
    stage = open_stage(tmp_path / "o.usda")
    query = skeleton_query(stage)
    rest = np.array(query.ComputeJointLocalTransforms(Usd.TimeCode(4), True))
    posed = np.array(query.ComputeJointLocalTransforms(Usd.TimeCode(4), False))
    assert_allclose(rest, posed, atol=1e-6)
    bind = np.array(query.GetSkeleton().GetBindTransformsAttr().Get())
    assert_allclose(bind[:, 3, :3], joint_positions(stage, [4])[0], atol=1e-5)


def test_several_roots_with_root_motion(tmp_path: Path) -> None:
    prop = "ROOT Prop\n{\nOFFSET 0 0 0\nCHANNELS 3 Xposition Yposition Zposition\n}\n"
    path = tmp_path / "two.bvh"
    path.write_text(small_bvh(random_rows(6, 12), header=HEADER + prop))
    bake(path, tmp_path / "a.usda")
    bake(path, tmp_path / "b.usda", BakeOptions(root_motion=True, sparse=True))
    codes = np.arange(1, 7)
    one = joint_positions(open_stage(tmp_path / "a.usda"), codes)
    two = joint_positions(open_stage(tmp_path / "b.usda"), codes)
    assert_allclose(one, two, atol=2e-5)


def test_range_and_sub_frames(take: Path, tmp_path: Path) -> None:
    options = BakeOptions(frame_range=FrameRange(1003, 1009, 3), start=Fraction(1001))
    bake(take, tmp_path / "o.usda", options)
    stage = open_stage(tmp_path / "o.usda")
    assert samples(stage) == [1003, 1006, 1009]
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (1003, 1009)
    offsets = (Fraction(-1, 4), Fraction(0), Fraction(1, 4))
    options = replace(options, samples=offsets, overwrite=True)
    bake(take, tmp_path / "o2.usda", options)
    stage = open_stage(tmp_path / "o2.usda")
    assert samples(stage) == [
        c + o for c in (1003, 1006, 1009) for o in (-0.25, 0, 0.25)
    ]
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (1003, 1009)


def test_names_and_their_originals(tmp_path: Path) -> None:
    path = tmp_path / "take 1.bvh"
    path.write_text(
        small_bvh(random_rows(2), header=HEADER.replace("Spine", "ns:Spi.ne"))
    )
    bake(path, tmp_path / "o.usda")
    stage = open_stage(tmp_path / "o.usda")
    skeleton = stage.GetPrimAtPath("/take_1/Rig/Skel")
    assert list(skeleton.GetAttribute("joints").Get()) == ["Hips", "Hips/ns_Spi_ne"]
    names = skeleton.GetCustomDataByKey("animtool:names")
    assert dict(names) == {"ns_Spi_ne": "ns:Spi.ne"}


@pytest.mark.parametrize("stage_path", ["/World/chars/hero", "/solo"])
def test_prim_path_of_a_stage(take: Path, tmp_path: Path, stage_path: str) -> None:
    bake(take, tmp_path / "o.usda", BakeOptions(prim_path=stage_path))
    stage = open_stage(tmp_path / "o.usda")
    assert stage.GetPrimAtPath(f"{stage_path}/Rig/Anim").IsA(UsdSkel.Animation)
    assert validation_errors(stage) == []
    assert str(stage.GetDefaultPrim().GetPath()) == "/" + stage_path.split("/")[1]


def test_the_largest_float32_is_written(tmp_path: Path) -> None:
    text = small_bvh(np.ones((3, 9))).splitlines()
    text[-1] = "1e39 1 1 1 1 1 1 1 1"
    path = tmp_path / "far.bvh"
    path.write_text("\n".join(text))
    report = bake(path, tmp_path / "o.usda")
    assert [n.code for n in report.notices] == ["BVH104"]
    stage = open_stage(tmp_path / "o.usda")
    anim = stage.GetPrimAtPath("/far/Rig/Anim")
    assert anim.GetAttribute("translations").Get(3)[0][0] == np.finfo(np.float32).max
    assert np.isfinite(report.result.rounding.error)


def over(layer: Path, rig: Path, fps: float = 120) -> Usd.Stage:
    """Compose a layer over the file that holds its rig."""
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().subLayerPaths = [str(layer), str(rig)]
    stage.SetTimeCodesPerSecond(fps)
    return stage


@pytest.mark.parametrize("again", [False, True])
def test_a_take_replaces_the_motion_of_a_skelroot(
    take: Path, tmp_path: Path, again: bool
) -> None:
    bake(take, tmp_path / "rig.usda", BakeOptions(root_motion=True))
    settings = BakeOptions(rig_layer=tmp_path / "rig.usda", root_motion=again)
    report = bake(take, tmp_path / "layer.usda", settings)
    assert [n.code for n in report.notices] == ["USD108"]
    bake(take, tmp_path / "own.usda")
    own = joint_positions(open_stage(tmp_path / "own.usda"), [1, 7, 13])
    stage = over(tmp_path / "layer.usda", tmp_path / "rig.usda")
    assert_allclose(joint_positions(stage, [1, 7, 13]), own, atol=2e-5)


def test_where_a_skelroot_stands_is_kept(take: Path, tmp_path: Path) -> None:
    bake(take, tmp_path / "rig.usda")
    stage = open_stage(tmp_path / "rig.usda")
    root = UsdGeom.Xformable(stage.GetPrimAtPath("/hero/Rig"))
    root.AddTranslateOp().Set((100, 0, 0))
    stage.Export(str(tmp_path / "placed.usda"))
    before = joint_positions(open_stage(tmp_path / "placed.usda"), [1, 9])
    # Its own take back over it: the place counts once.
    for root_motion in (False, True):
        layer = tmp_path / f"layer_{root_motion}.usda"
        options = BakeOptions(
            rig_layer=tmp_path / "placed.usda", root_motion=root_motion
        )
        bake(tmp_path / "placed.usda", layer, options)
        found = joint_positions(over(layer, tmp_path / "placed.usda"), [1, 9])
        assert_allclose(found, before, atol=1e-5)


def test_motion_of_a_skelroot_that_never_changes(tmp_path: Path) -> None:
    path = tmp_path / "still.bvh"
    path.write_text(small_bvh(np.tile(random_rows(1), (5, 1))))
    bake(path, tmp_path / "o.usda", BakeOptions(root_motion=True))
    stage = open_stage(tmp_path / "o.usda")
    root = UsdGeom.Xformable(stage.GetPrimAtPath("/still/Rig"))
    assert len(root.GetOrderedXformOps()) == 2
    assert not root.TransformMightBeTimeVarying()


TWO_HANDS = """HIERARCHY
ROOT Hips { OFFSET 0 0 0 CHANNELS 3 Xposition Yposition Zposition
JOINT Hand { OFFSET 1 0 0 CHANNELS 3 Zrotation Xrotation Yrotation }
JOINT Arm { OFFSET 0 1 0 CHANNELS 3 Zrotation Xrotation Yrotation
JOINT Hand { OFFSET 0 2 0 CHANNELS 3 Zrotation Xrotation Yrotation } } }
"""


def test_equal_names_in_two_branches(tmp_path: Path) -> None:
    path = tmp_path / "two.bvh"
    path.write_text(small_bvh(random_rows(6, 12), header=TWO_HANDS))
    bake(path, tmp_path / "rig.usda")
    stage = open_stage(tmp_path / "rig.usda")
    # As other tools write it: the same name below two parents.
    tokens = ["Hips", "Hips/Hand", "Hips/Arm", "Hips/Arm/Hand"]
    stage.GetPrimAtPath("/two/Rig/Skel").GetAttribute("joints").Set(tokens)
    stage.GetPrimAtPath("/two/Rig/Anim").GetAttribute("joints").Set(tokens)
    stage.Export(str(tmp_path / "same.usda"))
    before = joint_positions(open_stage(tmp_path / "same.usda"), [1, 6])
    options = BakeOptions(rig_layer=tmp_path / "same.usda")
    for source in (path, tmp_path / "same.usda"):
        report = bake(source, tmp_path / f"{source.suffix[1:]}.usda", options)
        assert [n.code for n in report.notices] == (
            ["BVH103"] if source == path else []
        )
        stage = over(tmp_path / f"{source.suffix[1:]}.usda", tmp_path / "same.usda", 30)
        assert_allclose(joint_positions(stage, [1, 6]), before, atol=1e-5)


@pytest.mark.parametrize("fps", [24, 120])
def test_rest_between_frames_of_the_source(
    take: Path, tmp_path: Path, fps: int
) -> None:
    bake(
        take, tmp_path / "o.usda", BakeOptions(rest_frame=2, fps=Fraction(fps) * 10 / 7)
    )
    query = skeleton_query(open_stage(tmp_path / "o.usda"))
    rest = np.array(query.ComputeJointLocalTransforms(Usd.TimeCode(2), True))
    posed = np.array(query.ComputeJointLocalTransforms(Usd.TimeCode(2), False))
    assert_allclose(rest, posed, atol=1e-6)


@pytest.mark.parametrize(("fps", "found"), [("1/24", True), ("24", False)])
def test_a_clock_of_frame_times(
    take: Path, tmp_path: Path, fps: str, found: bool
) -> None:
    own = open_source(take).collect()
    timed = replace(own, clock=replace(own.clock, fps=Fraction(fps)))
    notices = write(timed, tmp_path / "o.usda").notices
    rates = [notice for notice in notices if notice.code == "TAKE009"]
    assert len(rates) == found
    assert all("write 24" in str(notice.hint) for notice in rates)
