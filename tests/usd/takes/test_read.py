from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt
from support.bvh import TIP, random_rows, small_bvh
from support.cli import animtool
from support.drifting import author_samples
from support.skinned_rig import write_pair
from support.usd import joint_positions

from animtool.core.errors import FormatError
from animtool.core.shot import FrameRange
from animtool.formats.bvh.read import read_bvh
from animtool.report.compare import compare_takes
from animtool.scene.bake.bake import bake
from animtool.scene.bake.options import BakeOptions
from animtool.scene.convert.takes import convert
from animtool.usd.takes.read import read_usd


@pytest.fixture
def take(tmp_path: Path) -> Path:
    path = tmp_path / "hero.bvh"
    path.write_text(small_bvh(random_rows(13), frame_time="0.0083333"))
    return path


@pytest.mark.parametrize(
    "options",
    [
        BakeOptions(),
        BakeOptions(form="split"),
        BakeOptions(sparse=True),
        BakeOptions(root_motion=True),
        BakeOptions(bones=True, prim_path="/World/hero"),
        BakeOptions(start=Fraction(-3)),
    ],
)
def test_what_was_written_comes_back(
    take: Path, tmp_path: Path, options: BakeOptions
) -> None:
    bake(take, tmp_path / "o.usda", options)
    back = read_usd(tmp_path / "o.usda").collect()
    found = compare_takes(read_bvh(take).collect(), back)
    assert found.mismatches == []
    assert found.world.value < 3e-7
    assert found.rotation.value < 1e-4
    assert back.clock.start == (options.start or 1)
    assert back.rig.joints[0].channels == read_bvh(take).rig.joints[0].channels
    assert_allclose(back.rig.joints[1].tips, 0.01 * np.array([TIP]), rtol=1e-6)


def test_kept_samples_come_back_with_their_step(take: Path, tmp_path: Path) -> None:
    bake(take, tmp_path / "rig.usda", BakeOptions(form="split", fps=Fraction(24)))
    options = BakeOptions(rig_layer=tmp_path / "rig.rig.usda", keep_samples=True)
    bake(take, tmp_path / "layer.usda", options)
    shot = Sdf.Layer.CreateNew(str(tmp_path / "shot.usda"))
    shot.subLayerPaths = ["./layer.usda", "./rig.rig.usda"]
    shot.timeCodesPerSecond, shot.defaultPrim = 24, "hero"
    shot.pseudoRoot.SetInfo("metersPerUnit", 0.01)
    shot.Save()
    back = read_usd(tmp_path / "shot.usda").collect()
    assert (back.clock.step, back.clock.rate) == (Fraction(1, 5), 120)
    found = compare_takes(read_bvh(take).collect(), back)
    assert found.mismatches == []
    assert found.world.value < 3e-7


def test_a_layer_alone_has_a_rig_of_its_own(take: Path, tmp_path: Path) -> None:
    bake(take, tmp_path / "rig.usda", BakeOptions(form="split"))
    options = BakeOptions(rig_layer=tmp_path / "rig.rig.usda")
    bake(take, tmp_path / "layer.usda", options)
    back = read_usd(tmp_path / "layer.usda").collect()
    assert back.rig.names == ["Hips", "Spine"]
    found = compare_takes(read_bvh(take).collect(), back)
    assert found.world.value < 3e-7


def test_a_layer_alone_that_moves_its_skelroot_says_so(
    take: Path, tmp_path: Path
) -> None:
    bake(take, tmp_path / "rig.usda", BakeOptions(form="split"))
    options = BakeOptions(rig_layer=tmp_path / "rig.rig.usda", root_motion=True)
    bake(take, tmp_path / "layer.usda", options)
    assert [n.code for n in read_usd(tmp_path / "layer.usda").notices] == ["USD113"]


@pytest.fixture
def stage(tmp_path: Path) -> Usd.Stage:
    """Return a stage made by USD's own schemas, with a rest rotation and scales."""
    stage = Usd.Stage.CreateNew(str(tmp_path / "made.usda"))
    stage.SetTimeCodesPerSecond(24)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdSkel.Root.Define(stage, "/c/R")
    stage.SetDefaultPrim(stage.GetPrimAtPath("/c"))
    skeleton = UsdSkel.Skeleton.Define(stage, "/c/R/S")
    skeleton.CreateJointsAttr(["a", "a/b", "a/b/c"])
    turned = Gf.Matrix4d().SetRotate(
        Gf.Rotation((0, 0, 1), 90)
    ) * Gf.Matrix4d().SetTranslate((0, 1, 0))
    rest = [Gf.Matrix4d(1), turned, turned]
    skeleton.CreateRestTransformsAttr(rest)
    skeleton.CreateBindTransformsAttr(rest)
    animation = UsdSkel.Animation.Define(stage, "/c/R/A")
    animation.CreateJointsAttr(["a/b", "a"])
    for code in (1, 2, 4):
        turn = Gf.Quatf(Gf.Rotation((1, 0, 0), 10.0 * code).GetQuat())
        animation.CreateRotationsAttr().Set(Vt.QuatfArray([turn, Gf.Quatf(1)]), code)
        animation.CreateTranslationsAttr().Set([(0, 2, 0), (code, 0, 0)], code)
        scale = Vt.Vec3hArray([Gf.Vec3h(code, 1, 1), Gf.Vec3h(1)])
        animation.CreateScalesAttr().Set(scale, code)
    binding = UsdSkel.BindingAPI.Apply(root.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    return stage


def path_of(stage: Usd.Stage) -> Path:
    stage.Save()
    return Path(stage.GetRootLayer().realPath)


def test_order_rest_and_scales(stage: Usd.Stage) -> None:
    stream = read_usd(path_of(stage))
    take = stream.collect()
    assert take.clock.count == 4  # every time code from 1 to 4
    assert [n.code for n in stream.notices] == ["USD105"]
    translations = take.motion.translations.dense()
    assert_allclose(translations[0], [[1, 0, 0], [0, 2, 0], [0, 1, 0]], atol=1e-7)
    assert_allclose(translations[2, 0], [3, 0, 0])
    assert_allclose(
        take.motion.rotations.dense()[:, 2],
        np.tile([0, 0, 0.5**0.5, 0.5**0.5], (4, 1)),
        atol=1e-7,
    )
    assert take.motion.scales is not None
    assert_allclose(take.motion.scales.dense()[:, 1, 0], [1, 2, 3, 4])


SPOILT = {
    "USD201": ("A", "scales", None),
    "USD200": ("A", "translations", [(0, 0, 0)]),
    "USD202": ("A", "translations", [(np.nan, 0, 0)] * 2),
    "USD223": ("S", "restTransforms", [Gf.Matrix4d(1)]),
    "USD220": ("S", "joints", ["a", "a", "b"]),
    "USD221": ("S", "joints", ["a/b", "a", "c"]),
    "USD002": ("S", "joints", []),
}


@pytest.mark.parametrize("code", SPOILT)
def test_what_usdskel_would_ignore_is_said(stage: Usd.Stage, code: str) -> None:
    where, name, value = SPOILT[code]
    prim = stage.GetPrimAtPath(f"/c/R/{where}")
    if value is None:
        prim.RemoveProperty(name)
    elif where == "A":
        prim.GetAttribute(name).Set(value, 2)
    else:
        prim.GetAttribute(name).Set(value)
    with pytest.raises(FormatError) as caught:
        read_usd(path_of(stage))
    assert caught.value.code == code


def test_a_stage_without_a_character(stage: Usd.Stage) -> None:
    stage.RemovePrim("/c")
    with pytest.raises(FormatError) as caught:
        read_usd(path_of(stage))
    assert caught.value.code == "USD008"


@pytest.mark.parametrize(
    "content", [b"", b"#usda 1.0\n(", b"PXR-USDC\0\0", b"nonsense"]
)
@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_files_that_are_no_usd(tmp_path: Path, content: bytes, suffix: str) -> None:
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(content)
    with pytest.raises(FormatError) as caught:
        read_usd(path)
    assert caught.value.code in {"USD001", "USD008"}


def test_a_rig_without_animation_rests(take: Path, tmp_path: Path) -> None:
    bake(take, tmp_path / "rig.usda", BakeOptions(form="split"))
    stream = read_usd(tmp_path / "rig.rig.usda")
    back = stream.collect()
    assert back.clock.count == 1
    assert [n.code for n in stream.notices] == ["USD103"]
    assert_allclose(back.motion.translations.dense()[0], back.rig.rest_translations)


def test_a_take_on_twos_keeps_its_time_codes(tmp_path: Path) -> None:
    options = BakeOptions(frame_range=FrameRange(1, 13, 2), fps=Fraction(24))
    slow = tmp_path / "slow.bvh"
    slow.write_text(small_bvh(random_rows(13), frame_time="0.0416667"))
    bake(slow, tmp_path / "twos.usda", options)
    report = bake(tmp_path / "twos.usda", tmp_path / "again.usda")
    assert (report.fps, report.span.first, report.span.last) == (24, 1, 13)
    anim = [
        Sdf.Layer.FindOrOpen(str(tmp_path / name)).ListTimeSamplesForPath(path)
        for name, path in (
            ("twos.usda", "/slow/Rig/Anim.rotations"),
            ("again.usda", "/slow/Rig/Anim.rotations"),
        )
    ]
    assert anim[0] == anim[1] == [1, 3, 5, 7, 9, 11, 13]
    convert(tmp_path / "twos.usda", tmp_path / "ones.bvh")
    back = read_bvh(tmp_path / "ones.bvh").collect()
    assert (back.clock.count, back.clock.rate) == (13, 24)


def test_sub_frame_samples_start_at_the_first_frame(take: Path, tmp_path: Path) -> None:
    offsets = (Fraction(-1, 4), Fraction(0), Fraction(1, 4))
    bake(
        take, tmp_path / "fine.usda", BakeOptions(samples=offsets, start=Fraction(1001))
    )
    back = read_usd(tmp_path / "fine.usda").collect()
    assert (back.clock.start, back.clock.step) == (1001, Fraction(1, 4))
    found = compare_takes(read_bvh(take).collect(), back)
    assert found.world.value > 0  # other rates are said, and compared by time
    assert any("fps" in text for text in found.mismatches)
    slow = compare_takes(back, read_bvh(take).collect())
    assert slow.world.value < 2e-3


def test_a_take_that_never_moves_lasts(tmp_path: Path) -> None:
    path = tmp_path / "still.bvh"
    path.write_text(small_bvh(np.tile(random_rows(1), (60, 1))))
    bake(path, tmp_path / "o.usda")
    convert(tmp_path / "o.usda", tmp_path / "back.bvh")
    found = compare_takes(
        read_bvh(path).collect(), read_bvh(tmp_path / "back.bvh").collect()
    )
    assert (found.mismatches, found.frames) == ([], 60)


@pytest.mark.parametrize("scale", [(0.5, 0.5, 0.5), (1.0, 2.0, 1.0)])
def test_a_skelroot_that_moves_and_is_scaled(
    take: Path, tmp_path: Path, scale: tuple[float, ...]
) -> None:
    bake(take, tmp_path / "o.usda")
    stage = Usd.Stage.Open(str(tmp_path / "o.usda"))
    root = UsdGeom.Xformable(stage.GetPrimAtPath("/hero/Rig"))
    move = root.AddTranslateOp()
    move.Set((0, 0, 0), 1)
    move.Set((120, 0, 0), 13)
    root.AddScaleOp().Set(scale)
    stage.Export(str(tmp_path / "scaled.usda"))
    if len(set(scale)) > 1:
        with pytest.raises(FormatError) as caught:
            read_usd(tmp_path / "scaled.usda")
        assert caught.value.code == "USD035"
        assert "1 x 2 x 1" in str(caught.value)
        return
    stream = read_usd(tmp_path / "scaled.usda")
    found = stream.collect()
    truth = joint_positions(
        Usd.Stage.Open(str(tmp_path / "scaled.usda")), found.clock.times
    )
    # Lengths have the scale.
    assert found.motion.scales is None
    assert stream.notices == []
    assert_allclose(found.world().positions / 0.01, truth, atol=1e-4)


@pytest.mark.parametrize("times", [[1.0], [1.0, 4.0, 7.0, 10.0]])
def test_a_turntable_of_two_keys_is_a_circle(
    tmp_path: Path, times: list[float]
) -> None:
    path = author_samples(tmp_path / "take.usda", times)
    stage = Usd.Stage.Open(str(path))
    table = UsdGeom.Xformable(stage.GetPrimAtPath("/hero"))
    table.AddTranslateOp().Set((30, 0, 0))
    turn = table.AddRotateYOp()
    turn.Set(0.0, 1)
    turn.Set(180.0, 10)
    stage.Save()
    found = read_usd(path).collect()
    assert found.clock.times.tolist() == list(range(1, 11))
    truth = joint_positions(Usd.Stage.Open(str(path)), found.clock.times)
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    assert_allclose(found.world().positions / unit, truth, atol=1e-4)


def test_a_placement_that_only_moves_keeps_the_samples(tmp_path: Path) -> None:
    path = author_samples(tmp_path / "take.usda", [1.0, 4.0, 7.0, 10.0])
    stage = Usd.Stage.Open(str(path))
    move = UsdGeom.Xformable(stage.GetPrimAtPath("/hero")).AddTranslateOp()
    move.Set((0, 0, 0), 1)
    move.Set((9, 0, 0), 10)
    stage.Save()
    assert read_usd(path).collect().clock.times.tolist() == [1, 4, 7, 10]


@pytest.mark.parametrize(
    ("times", "code"),
    [([0, 1, 2, 3_000_000], "USD016"), ([0, 0.1, 0.3, 2 / 7, 9.77], "")],
)
def test_irregular_times(stage: Usd.Stage, times: list[float], code: str) -> None:
    attr = stage.GetPrimAtPath("/c/R/A").GetAttribute("translations")
    for time in times:
        attr.Set([(0, 2, 0), (time, 0, 0)], time)
    if code:
        with pytest.raises(FormatError) as caught:
            read_usd(path_of(stage))
        assert caught.value.code == code
        return
    assert read_usd(path_of(stage)).collect().clock.count >= 10


def test_values_of_another_type(stage: Usd.Stage) -> None:
    path = path_of(stage)
    text = path.read_text().replace("float3[] translations", "string translations")
    path.with_name("spoilt.usda").write_text(text)
    with pytest.raises(FormatError):
        read_usd(path.with_name("spoilt.usda"))


@pytest.mark.parametrize(
    ("name", "value", "code"),
    [
        ("timeCodesPerSecond", 0.0, "USD253"),
        ("timeCodesPerSecond", -24.0, "USD253"),
        ("metersPerUnit", 0.0, "USD260"),
        ("metersPerUnit", -1.0, "USD260"),
        ("metersPerUnit", float("nan"), "USD260"),
        ("upAxis", "X", "USD260"),
        ("startTimeCode", float("nan"), "USD254"),
        ("endTimeCode", float("inf"), "USD254"),
    ],
)
def test_metadata_that_is_none(
    stage: Usd.Stage, name: str, value: object, code: str
) -> None:
    stage.SetMetadata(name, value)
    with pytest.raises(FormatError) as caught:
        read_usd(path_of(stage))
    assert caught.value.code == code


@pytest.mark.parametrize(
    "data",
    [
        {"names": "x"},
        {"joints": "{"},
        {"joints": "[]"},
        {"joints": '{"animtool":1,"joints":[]}'},
        {"joints": '{"animtool":1,"joints":{"c":{"channels":5}}}'},
        {"joints": '{"animtool":1,"joints":{"c":{"tips":[[1]]}}}'},
        {"joints": '{"animtool":2,"joints":{}}'},
    ],
)
def test_custom_data_of_other_shapes(stage: Usd.Stage, data: object) -> None:
    stage.GetPrimAtPath("/c/R/S").SetCustomDataByKey("animtool", data)
    with pytest.raises(FormatError) as caught:
        read_usd(path_of(stage))
    assert caught.value.code == "USD007"


def test_several_characters_are_named(take: Path, tmp_path: Path) -> None:
    bake(take, tmp_path / "one.usda", BakeOptions(prim_path="/World/a"))
    stage = Usd.Stage.Open(str(tmp_path / "one.usda"))
    stage.DefinePrim("/World/b").GetReferences().AddInternalReference("/World/a")
    stage.Export(str(tmp_path / "two.usda"))
    stream = read_usd(tmp_path / "two.usda")
    assert [n.code for n in stream.notices] == ["USD107"]
    assert "/World/b/Rig/Skel" in stream.notices[0].message
    chosen = read_usd(tmp_path / "two.usda", prim_path="/World/b")
    assert (chosen.rig.name, chosen.notices) == ("b", [])


def test_what_carries_the_root_must_be_finite(take: Path, tmp_path: Path) -> None:
    bake(take, tmp_path / "o.usda", BakeOptions(root_motion=True))
    stage = Usd.Stage.Open(str(tmp_path / "o.usda"))
    attr = stage.GetPrimAtPath("/hero/Rig").GetAttribute("xformOp:translate:rootMotion")
    attr.Set((np.nan, 0, 0), 3)
    with pytest.raises(FormatError) as caught:
        read_usd(path_of(stage))
    assert caught.value.code == "USD171"


def test_layers_that_are_missing_are_named(
    take: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bake(take, tmp_path / "o.usda")
    layer = Sdf.Layer.CreateNew(str(tmp_path / "shot.usda"))
    layer.subLayerPaths = ["./gone.usda", "./o.usda"]
    layer.Save()
    stream = read_usd(tmp_path / "shot.usda")
    assert [n.code for n in stream.notices] == ["USD112"]
    assert "gone.usda" in stream.notices[0].message
    assert capfd.readouterr().err == ""


def test_layers_in_a_circle_are_named(
    take: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bake(take, tmp_path / "o.usda")
    for name, others in (("a", ["./b.usda", "./o.usda"]), ("b", ["./a.usda"])):
        layer = Sdf.Layer.CreateNew(str(tmp_path / f"{name}.usda"))
        layer.subLayerPaths = others
        layer.Save()
    stream = read_usd(tmp_path / "a.usda")
    assert [n.code for n in stream.notices] == ["USD112"]
    assert "has cycles" in stream.notices[0].message
    assert capfd.readouterr().err == ""


def test_a_path_of_no_character_names_those_there(take: Path, tmp_path: Path) -> None:
    bake(take, tmp_path / "one.usda", BakeOptions(prim_path="/World/a"))
    with pytest.raises(FormatError) as caught:
        read_usd(tmp_path / "one.usda", prim_path="/World/b")
    assert caught.value.code == "USD008"
    assert "/World/a" in str(caught.value.faults[0].hint)


@pytest.mark.parametrize("value", [[(0, 0, 0)], [(np.nan, 0, 0)] * 2])
def test_what_does_not_change_has_no_time_code(
    take: Path, tmp_path: Path, value: list[tuple[float, float, float]]
) -> None:
    bake(take, tmp_path / "o.usda")
    stage = Usd.Stage.Open(str(tmp_path / "o.usda"))
    prim = next(p for p in stage.Traverse() if p.IsA(UsdSkel.Animation))
    attr = prim.GetAttribute("translations")
    attr.Clear()
    attr.Set(value)
    stage.Save()
    with pytest.raises(FormatError) as caught:
        read_usd(tmp_path / "o.usda")
    assert caught.value.code in {"USD200", "USD202"}
    assert "time code" not in str(caught.value)


def test_a_binding_without_its_schema_is_named(tmp_path: Path) -> None:
    path = author_samples(tmp_path / "take.usda", [1.0, 2.0, 3.0])
    layer = Sdf.Layer.FindOrOpen(str(path))
    layer.GetPrimAtPath("/hero/Rig/Skel").ClearInfo("apiSchemas")
    layer.Save()
    stream = read_usd(path)
    (notice,) = stream.notices
    assert notice.code == "USD103"
    for text in ("/hero/Rig/Skel", "SkelBindingAPI"):
        assert text in notice.message
    assert stream.collect().clock.count == 1


def test_an_animation_outside_a_skel_root_is_read(tmp_path: Path) -> None:
    path = author_samples(tmp_path / "take.usda", [1.0, 2.0, 3.0])
    expected = read_usd(path).collect()
    layer = Sdf.Layer.FindOrOpen(str(path))
    layer.GetPrimAtPath("/hero/Rig").typeName = "Xform"
    layer.Save()
    stream = read_usd(path)
    (notice,) = stream.notices
    assert notice.code == "USD237"
    take = stream.collect()
    assert take.clock == expected.clock
    assert_array_equal(
        take.motion.translations.dense(), expected.motion.translations.dense()
    )


def test_a_binding_to_a_prim_that_does_not_exist_is_named(tmp_path: Path) -> None:
    path = author_samples(tmp_path / "take.usda", [1.0, 2.0, 3.0])
    layer = Sdf.Layer.FindOrOpen(str(path))
    source = layer.GetRelationshipAtPath("/hero/Rig/Skel.skel:animationSource")
    source.targetPathList.explicitItems = ["/hero/Rig/Anm"]
    layer.Save()
    stream = read_usd(path)
    (notice,) = stream.notices
    assert notice.code == "USD103"
    assert "/hero/Rig/Anm" in notice.message


def test_an_animation_that_is_deactivated_does_not_play(tmp_path: Path) -> None:
    path = author_samples(tmp_path / "take.usda", [1.0, 2.0, 3.0])
    stage = Usd.Stage.Open(str(path))
    (target,) = (
        UsdSkel.BindingAPI(stage.GetPrimAtPath("/hero/Rig/Skel"))
        .GetAnimationSourceRel()
        .GetTargets()
    )
    stage.GetPrimAtPath(target).SetActive(False)
    stage.Save()
    stream = read_usd(path)
    (notice,) = stream.notices
    assert notice.code == "USD103"
    assert f"{target} is deactivated" in notice.message
    assert stream.collect().clock.count == 1


def test_meshes_without_the_binding_schema_are_named(tmp_path: Path) -> None:
    clip = write_pair(tmp_path)
    rig = tmp_path / "pair.usda"
    assert animtool("bake", clip, "-o", rig).code == 0
    layer = Sdf.Layer.FindOrOpen(str(rig))
    stage = Usd.Stage.Open(layer)
    mesh = next(prim for prim in stage.Traverse() if prim.GetName() == "sleeve")
    layer.GetPrimAtPath(mesh.GetPath()).ClearInfo("apiSchemas")
    layer.Save()
    for options in (
        ("--rig-layer", rig, "-o", tmp_path / "layer.usda"),
        ("--rig-layer", rig, "--deform", "-o", tmp_path / "cache.usda"),
    ):
        done = animtool("bake", clip, *options)
        assert done.code == 0, done.stderr
        assert done.stderr.count("USD144") == 1
        assert str(mesh.GetPath()) in done.stderr
    # Its motion alone says nothing of meshes.
    assert [notice.code for notice in read_usd(rig).notices] == []
