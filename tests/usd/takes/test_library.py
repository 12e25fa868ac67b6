"""Clip libraries: what variants bind, and how each take comes back."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from pxr import Sdf, Usd, UsdGeom, UsdSkel
from support.bvh import HEADER, random_rows, small_bvh
from support.example_rig import write_example_rig
from support.suite import examples
from support.takes import assert_same_motion, motion_of, takes
from support.usd import joint_positions, open_stage, skeleton_query, validation_errors

from animtool.core.errors import AnimtoolError
from animtool.core.shot import FrameRange
from animtool.motion.take import Take
from animtool.scene.bake.bake import bake
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.prims import BakeReport
from animtool.usd.layers.jobs import LayerForm, UsdJob, UsdTake
from animtool.usd.layers.names import RigPaths, joint_names
from animtool.usd.takes.author import author, write_usd
from animtool.usd.takes.joint_writer import round_blocks
from animtool.usd.takes.library import stored_take_range
from animtool.usd.takes.read import read_usd

FRAMES = {"walk": 13, "run": 5, "idle": 9}
LONGEST = max(FRAMES.values())


@pytest.fixture
def sources(tmp_path: Path) -> list[Path]:
    """Return three takes of one skeleton; the last never moves."""
    paths = []
    for seed, (name, frames) in enumerate(FRAMES.items()):
        rows = random_rows(frames, seed=seed)
        if name == "idle":
            rows = np.tile(rows[:1], (frames, 1))
        path = tmp_path / f"{name}.bvh"
        path.write_text(small_bvh(rows))
        paths.append(path)
    return paths


def library(
    sources: list[Path], output: Path, options: BakeOptions | None = None
) -> BakeReport:
    return bake(sources, output, options)


def model(stage: Usd.Stage) -> Usd.Prim:
    return next(p for p in stage.Traverse() if p.GetVariantSets().HasVariantSet("take"))


def select(stage: Usd.Stage, name: str) -> None:
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        assert model(stage).GetVariantSet("take").SetVariantSelection(name)


def bound(stage: Usd.Stage) -> str:
    return str(skeleton_query(stage).GetAnimQuery().GetPrim().GetPath())


def assert_same_take(found: Take, expected: Take) -> None:
    assert_same_motion(found, expected)
    assert found.rig.names == expected.rig.names
    assert_allclose(found.rig.rest_translations, expected.rig.rest_translations)


def test_places(sources: list[Path], tmp_path: Path) -> None:
    library(sources, tmp_path / "hero.usda")
    stage = open_stage(tmp_path / "hero.usda")
    kinds = {str(p.GetPath()): p.GetTypeName() for p in stage.Traverse()}
    assert kinds == {
        "/hero": "Xform",
        "/hero/Rig": "SkelRoot",
        "/hero/Rig/Skel": "Skeleton",
        "/hero/Rig/Anim_walk": "SkelAnimation",
        "/hero/Rig/Anim_run": "SkelAnimation",
        "/hero/Rig/Anim_idle": "SkelAnimation",
    }
    takes = model(stage).GetVariantSet("take")
    assert takes.GetVariantNames() == sorted(FRAMES)
    assert takes.GetVariantSelection() == "walk"
    assert bound(stage) == "/hero/Rig/Anim_walk"
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (1, LONGEST)
    for name, frames in FRAMES.items():
        anim = UsdSkel.Animation(stage.GetPrimAtPath(f"/hero/Rig/Anim_{name}"))
        assert stored_take_range(anim) == (1, frames)
        data = anim.GetPrim().GetCustomDataByKey("animtool:take")
        assert data["name"] == name


@pytest.mark.parametrize("form", ["stage", "split"])
@pytest.mark.parametrize("root_motion", [False, True])
@pytest.mark.parametrize("bones", [False, True])
def test_usdskel_plays_each_take_as_if_alone(
    sources: list[Path], tmp_path: Path, form: str, root_motion: bool, bones: bool
) -> None:
    options = BakeOptions(form=form, root_motion=root_motion, bones=bones)
    library(sources, tmp_path / "lib.usda", options)
    stage = open_stage(tmp_path / "lib.usda")
    assert validation_errors(stage) == []
    for source, (name, frames) in zip(sources, FRAMES.items(), strict=True):
        bake(source, tmp_path / f"{name}.usda", replace(options, form="stage"))
        alone = open_stage(tmp_path / f"{name}.usda")
        select(stage, name)
        assert bound(stage) == f"/lib/Rig/Anim_{name}"
        codes = np.arange(1, frames + 1)
        found, expected = joint_positions(stage, codes), joint_positions(alone, codes)
        size = float(np.abs(expected).max())
        assert_allclose(found, expected, rtol=0, atol=1e-6 * size)
        root = UsdGeom.Boundable(stage.GetPrimAtPath("/lib/Rig"))
        own = UsdGeom.Boundable(alone.GetPrimAtPath(f"/{name}/Rig"))
        for code in codes.tolist():
            extent = np.array(root.GetExtentAttr().Get(code))
            assert_allclose(extent, np.array(own.GetExtentAttr().Get(code)))
            computed = UsdGeom.Boundable.ComputeExtentFromPlugins(
                root, Usd.TimeCode(code)
            )
            assert_allclose(extent, np.array(computed), rtol=1e-6, atol=1e-5)


def test_nothing_of_a_take_stands_outside_of_its_variant(
    sources: list[Path], tmp_path: Path
) -> None:
    library(sources, tmp_path / "lib.usda", BakeOptions(root_motion=True))
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "lib.usda"))
    root = layer.GetPrimAtPath("/lib/Rig")
    assert list(root.properties.keys()) == ["skel:skeleton"]
    for name in FRAMES:
        inside = layer.GetPrimAtPath(f"/lib{{take={name}}}Rig")
        assert set(inside.properties.keys()) == {
            "skel:animationSource",
            "extent",
            "xformOpOrder",
            "xformOp:translate:rootMotion",
            "xformOp:orient:rootMotion",
        }


def test_variants_of_a_split_stand_in_the_animation_layer(
    sources: list[Path], tmp_path: Path
) -> None:
    library(sources, tmp_path / "lib.usda", BakeOptions(form="split"))
    rig = (tmp_path / "lib.rig.usda").read_text()
    assert "variant" not in rig
    assert "variant" not in (tmp_path / "lib.usda").read_text()
    anim = Sdf.Layer.FindOrOpen(str(tmp_path / "lib.anim.usdc"))
    spec = anim.GetPrimAtPath("/lib")
    assert spec.specifier == Sdf.SpecifierOver
    assert sorted(spec.variantSets["take"].variants.keys()) == sorted(FRAMES)
    # A stronger layer chooses another take.
    top = Usd.Stage.CreateInMemory()
    top.GetRootLayer().subLayerPaths = [str(tmp_path / "lib.usda")]
    top.SetTimeCodesPerSecond(30)
    model(top).GetVariantSet("take").SetVariantSelection("run")
    assert bound(top) == "/lib/Rig/Anim_run"


@pytest.mark.parametrize(
    "options",
    [
        BakeOptions(),
        BakeOptions(form="split"),
        BakeOptions(root_motion=True),
        BakeOptions(sparse=True),
        BakeOptions(bones=True, prim_path="/World/cast/hero"),
        BakeOptions(fps=Fraction(24)),
        BakeOptions(reduce=0.05),
        BakeOptions(samples=(Fraction(-1, 4), Fraction(0), Fraction(1, 4))),
        BakeOptions(fps=Fraction(24), keep_samples=True),
        BakeOptions(start=Fraction(1001), frame_range=FrameRange(1002, 1004)),
    ],
    ids=[
        "stage", "split", "root_motion", "sparse", "prim_path", "fps", "reduce",
        "samples", "keep_samples", "range",
    ],
)  # fmt: skip
def test_a_take_read_back_is_the_take_baked_alone(
    sources: list[Path], tmp_path: Path, options: BakeOptions
) -> None:
    library(sources, tmp_path / "lib.usda", options)
    for source, name in zip(sources, FRAMES, strict=True):
        bake(source, tmp_path / f"{name}.usda", options)
        alone = read_usd(tmp_path / f"{name}.usda").collect()
        found = read_usd(tmp_path / "lib.usda", take=name)
        assert found.details["takes"] == sorted(FRAMES)
        assert found.details["take"] == name
        assert_same_take(found.collect(), alone)


def test_the_selected_take_is_read_where_none_is_named(
    sources: list[Path], tmp_path: Path
) -> None:
    library(sources, tmp_path / "lib.usda")
    first = read_usd(tmp_path / "lib.usda").collect()
    assert first.clock.count == FRAMES["walk"]
    with pytest.raises(AnimtoolError) as caught:
        read_usd(tmp_path / "lib.usda", take="runn")
    assert caught.value.code == "USD031"
    hint = str(caught.value.faults[0].hint)
    assert "did you mean 'run'" in hint
    assert all(name in hint for name in FRAMES)
    bake(sources[0], tmp_path / "one.usda")
    with pytest.raises(AnimtoolError) as caught:
        read_usd(tmp_path / "one.usda", take="walk")
    assert caught.value.code == "USD031"


def test_the_character_is_named_by_its_rig_or_by_the_output(
    sources: list[Path], tmp_path: Path
) -> None:
    for source in sources:
        bake(source, source.with_suffix(".usda"), BakeOptions(prim_path="/bob"))
    library([s.with_suffix(".usda") for s in sources], tmp_path / "lib.usda")
    assert model(open_stage(tmp_path / "lib.usda")).GetName() == "bob"


def test_rates_become_that_of_the_first(sources: list[Path], tmp_path: Path) -> None:
    fast = tmp_path / "fast.bvh"
    fast.write_text(small_bvh(random_rows(41, seed=7), frame_time="0.0083333"))
    report = library([sources[0], fast], tmp_path / "lib.usda")
    assert [n.code for n in report.notices] == ["USD131"]
    assert [t.written.samples for t in report.takes] == [13, 11]
    assert [t.source_frames for t in report.takes] == [13, 41]
    bake(fast, tmp_path / "fast.usda", BakeOptions(fps=Fraction(30)))
    alone = read_usd(tmp_path / "fast.usda").collect()
    assert_same_take(read_usd(tmp_path / "lib.usda", take="fast").collect(), alone)
    report = library(
        [sources[0], fast], tmp_path / "60.usda", BakeOptions(fps=Fraction(60))
    )
    assert [t.written.samples for t in report.takes] == [25, 21]


def spoilt(header: str, old: str, new: str) -> str:
    assert old in header
    return header.replace(old, new)


@pytest.mark.parametrize(
    ("header", "columns", "said"),
    [
        (spoilt(HEADER, "Spine", "Tail"), 9, "no joint 'Spine'"),
        (
            HEADER + "ROOT Prop\n{\nOFFSET 0 0 0\nCHANNELS 1 Xposition\n}\n",
            10,
            "joint 'Prop' is not in",
        ),
        (
            "HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition "
            "Zposition Zrotation Xrotation Yrotation\n}\nROOT Spine\n{\nOFFSET 0 10 0\n"
            "CHANNELS 3 Zrotation Xrotation Yrotation\n}\n",
            9,
            "'Spine' is a root, but in",
        ),
    ],
)
def test_takes_of_other_joints_are_refused(
    sources: list[Path], tmp_path: Path, header: str, columns: int, said: str
) -> None:
    other = tmp_path / "other.bvh"
    other.write_text(small_bvh(random_rows(3, columns), header=header))
    before = sorted(tmp_path.iterdir())
    with pytest.raises(AnimtoolError) as caught:
        library([*sources, other], tmp_path / "lib.usda")
    (fault,) = caught.value.faults
    assert (fault.code, fault.path) == ("USD030", str(other))
    assert said in fault.message
    assert str(sources[0]) in fault.message
    assert sorted(tmp_path.iterdir()) == before


TWO = (
    "JOINT {} {{ OFFSET {} 1 0 CHANNELS 3 Zrotation Xrotation Yrotation "
    "End Site {{ OFFSET 0 1 0 }} }}\n"
)


def test_joints_in_another_order_are_put_in_that_of_the_first(tmp_path: Path) -> None:
    head = (
        "HIERARCHY\nROOT Hips { OFFSET 0 0 0 CHANNELS 3 Xposition Yposition Zposition\n"
    )
    left, right = TWO.format("L", 1), TWO.format("R", -1)
    rows = random_rows(6)
    turned = rows[:, [0, 1, 2, 6, 7, 8, 3, 4, 5]]
    one, two = tmp_path / "one.bvh", tmp_path / "two.bvh"
    one.write_text(small_bvh(rows, header=f"{head}{left}{right}}}\n"))
    two.write_text(small_bvh(turned, header=f"{head}{right}{left}}}\n"))
    report = library([one, two], tmp_path / "lib.usda")
    assert report.notices == []
    first = read_usd(tmp_path / "lib.usda", take="one").collect()
    assert_same_take(read_usd(tmp_path / "lib.usda", take="two").collect(), first)


def test_joints_are_compared_as_usd_has_them(tmp_path: Path) -> None:
    paths = [tmp_path / "one.bvh", tmp_path / "two.bvh"]
    for path, name in zip(paths, ("a:Spi.ne", "b:Spi.ne"), strict=True):
        header = spoilt(HEADER, "Spine", name)
        path.write_text(small_bvh(random_rows(3), header=header))
    bake(paths[0], tmp_path / "back.usda")
    library([paths[0], tmp_path / "back.usda"], tmp_path / "lib.usda")
    with pytest.raises(AnimtoolError) as caught:
        library(paths, tmp_path / "no.usda")
    assert caught.value.code == "USD030"
    library(paths, tmp_path / "yes.usda", BakeOptions(strip_namespace=1))


@pytest.mark.parametrize("rest_frame", [None, 2])
def test_rest_poses_that_differ_are_said(
    sources: list[Path], tmp_path: Path, rest_frame: int | None
) -> None:
    other = tmp_path / "tall.bvh"
    header = spoilt(HEADER, "OFFSET 1 10 -2", "OFFSET 1 12 -2")
    other.write_text(small_bvh(random_rows(4), header=header))
    options = BakeOptions(rest_frame=rest_frame, sparse=True)
    report = library([sources[0], other], tmp_path / "lib.usda", options)
    expected = [] if rest_frame else [("USD130", str(other))]
    assert [(n.code, n.path) for n in report.notices] == expected
    # Its motion is its own all the same.
    bake(other, tmp_path / "tall.usda")
    stage = open_stage(tmp_path / "lib.usda")
    select(stage, "tall")
    alone = joint_positions(open_stage(tmp_path / "tall.usda"), [1, 4])
    assert_allclose(joint_positions(stage, [1, 4]), alone, atol=2e-5)


def test_names_of_takes_are_legal_and_distinct(tmp_path: Path) -> None:
    paths = []
    for i, name in enumerate(["take 1", "a/take-1", "b/take 1", "Brüst", "2nd"]):
        path = tmp_path / f"{name}.bvh"
        path.parent.mkdir(exist_ok=True)
        path.write_text(small_bvh(random_rows(3, seed=i)))
        paths.append(path)
    report = library(paths, tmp_path / "lib.usda")
    names = ["take_1", "take_1_2", "take_1_3", "Brüst", "_2nd"]
    assert [take.written.name for take in report.takes] == names
    said = [(notice.code, notice.path) for notice in report.notices]
    assert said == [("USD101", str(path)) for path in paths[1:3]]
    stage = open_stage(tmp_path / "lib.usda")
    for name in names:
        select(stage, name)
        assert bound(stage) == f"/lib/Rig/Anim_{name}"
    data = stage.GetPrimAtPath("/lib/Rig/Anim__2nd").GetCustomDataByKey("animtool:take")
    assert data["name"] == "2nd"


def test_every_source_is_checked_before_one_is_baked(
    sources: list[Path], tmp_path: Path
) -> None:
    (tmp_path / "bad.bvh").write_text("HIERARCHY\n")
    (tmp_path / "worse.bvh").write_text("")
    # The rows of the first would fail, were they read.
    sources[0].write_text(sources[0].read_text() + "1 2 3\n")
    given = [
        *sources,
        tmp_path / "bad.bvh",
        tmp_path / "worse.bvh",
        tmp_path / "no.usd",
    ]
    before = sorted(tmp_path.iterdir())
    with pytest.raises(AnimtoolError) as caught:
        library(given, tmp_path / "lib.usda")
    found = [Path(str(fault.path)).name for fault in caught.value.faults]
    assert found == ["bad.bvh", "worse.bvh", "no.usd"]
    with pytest.raises(AnimtoolError) as caught:
        library(sources, tmp_path / "lib.usda")
    assert caught.value.code == "BVH010"
    assert sorted(tmp_path.iterdir()) == before


@pytest.fixture
def rig(sources: list[Path], tmp_path: Path) -> Path:
    """Return a rig layer without an animation, at 24 fps from 1001."""
    options = BakeOptions(form="split", start=Fraction(1001), fps=Fraction(24))
    bake(sources[0], tmp_path / "rig.usda", replace(options, prim_path="/hero"))
    return tmp_path / "rig.rig.usda"


def shot_over(rig: Path, layer: Path, prim: str) -> Usd.Stage:
    shot = Usd.Stage.CreateInMemory()
    shot.SetTimeCodesPerSecond(24)
    shot.GetRootLayer().subLayerPaths = [str(layer)]
    if prim == "/hero":
        shot.GetRootLayer().subLayerPaths.append(str(rig))
    else:
        shot.DefinePrim(prim).GetReferences().AddReference(str(rig))
    return shot


@pytest.mark.parametrize("prim", ["/hero", "/World/cast/hero"])
@pytest.mark.parametrize("root_motion", [False, True])
def test_a_library_over_a_rig(
    sources: list[Path], rig: Path, tmp_path: Path, prim: str, root_motion: bool
) -> None:
    options = BakeOptions(rig_layer=rig, prim_path=prim, root_motion=root_motion)
    report = library(sources, tmp_path / "lib.usda", options)
    assert report.form.startswith("layer")
    text = (tmp_path / "lib.usda").read_text()
    assert text.count("def ") == text.count("def SkelAnimation") == len(FRAMES)
    assert "@" not in text
    stage = shot_over(rig, tmp_path / "lib.usda", prim)
    for source, name in zip(sources, FRAMES, strict=True):
        bake(source, tmp_path / f"{name}.usda", BakeOptions(fps=Fraction(24)))
        alone = open_stage(tmp_path / f"{name}.usda")
        select(stage, name)
        assert bound(stage) == f"{prim}/Rig/Anim_{name}"
        codes = np.arange(int(alone.GetEndTimeCode()))
        found = joint_positions(stage, codes + 1001)
        assert_allclose(found, joint_positions(alone, codes + 1), atol=2e-5)
        root = UsdGeom.Boundable(stage.GetPrimAtPath(f"{prim}/Rig"))
        computed = UsdGeom.Boundable.ComputeExtentFromPlugins(root, Usd.TimeCode(1002))
        assert_allclose(np.array(root.GetExtentAttr().Get(1002)), np.array(computed))
    # Alone, the layer still knows its takes.
    if not root_motion:
        assert read_usd(tmp_path / "lib.usda", take="idle").collect().clock.count == 7


@pytest.mark.parametrize("prim", ["/hero", "/World/hero"])
@pytest.mark.parametrize(
    ("name", "code"),
    [("skel:animationSource", "USD011"), ("extent", "USD032")],
)
def test_a_rig_whose_own_opinions_are_stronger_than_variants(
    sources: list[Path], rig: Path, tmp_path: Path, prim: str, name: str, code: str
) -> None:
    layer = Sdf.Layer.OpenAsAnonymous(str(rig))
    root = layer.GetPrimAtPath("/hero/Rig")
    if name == "extent":
        Sdf.AttributeSpec(root, name, Sdf.ValueTypeNames.Float3Array).default = [
            (0, 0, 0), (1, 1, 1),
        ]  # fmt: skip
    else:
        own = Sdf.RelationshipSpec(root, name)
        own.targetPathList.explicitItems = [Sdf.Path("/hero/Rig/Own")]
        # Unless it is applied, UsdSkel does not look.
        root.SetInfo("apiSchemas", Sdf.TokenListOp.Create(["SkelBindingAPI"]))
    layer.Export(str(tmp_path / "own.usda"))
    options = BakeOptions(rig_layer=tmp_path / "own.usda", prim_path=prim)
    if prim == "/World/hero":
        # Under a reference, the variants are the stronger.
        library(sources, tmp_path / "lib.usda", options)
        stage = shot_over(tmp_path / "own.usda", tmp_path / "lib.usda", prim)
        assert bound(stage) == "/World/hero/Rig/Anim_walk"
        return
    before = sorted(tmp_path.iterdir())
    with pytest.raises(AnimtoolError) as caught:
        library(sources, tmp_path / "lib.usda", options)
    assert caught.value.code == code
    assert "prim_path" in str(caught.value)
    assert sorted(tmp_path.iterdir()) == before


def test_takes_over_a_rig_may_have_other_joints(
    sources: list[Path], rig: Path, tmp_path: Path
) -> None:
    hips = tmp_path / "hips.bvh"
    hips.write_text(small_bvh(random_rows(5), header=spoilt(HEADER, "Spine", "Tail")))
    options = BakeOptions(rig_layer=rig)
    report = library([sources[0], hips], tmp_path / "lib.usda", options)
    # Each of the takes ends between two frames of the rig's rate.
    codes = sorted(n.code for n in report.notices)
    assert codes == ["TAKE006", "TAKE006", "TAKE007", "TAKE007", "USD102", "USD111"]
    assert [take.written.joints for take in report.takes] == [2, 1]


def test_a_library_is_a_rig_layer_too(sources: list[Path], tmp_path: Path) -> None:
    library(sources, tmp_path / "lib.usda")
    options = BakeOptions(rig_layer=tmp_path / "lib.usda")
    bake(sources[1], tmp_path / "over.usda", options)
    shot = Usd.Stage.CreateInMemory()
    shot.SetTimeCodesPerSecond(30)
    shot.GetRootLayer().subLayerPaths = [
        str(tmp_path / "over.usda"),
        str(tmp_path / "lib.usda"),
    ]
    for name in FRAMES:
        select(shot, name)
        assert bound(shot) == "/lib/Rig/Anim"


@pytest.mark.parametrize("name", FRAMES)
def test_an_offset_shifts_the_range_of_a_take(
    sources: list[Path], tmp_path: Path, name: str
) -> None:
    library(sources, tmp_path / "lib.usda")
    layer = Sdf.Layer.CreateNew(str(tmp_path / "shot.usda"))
    layer.subLayerPaths = ["./lib.usda"]
    layer.subLayerOffsets[0] = Sdf.LayerOffset(100)
    layer.timeCodesPerSecond = 30
    layer.Save()
    clock = read_usd(tmp_path / "shot.usda", take=name).collect().clock
    assert (clock.start, clock.count) == (101, FRAMES[name])


def test_meshes_stand_in_the_extent_of_each_take(tmp_path: Path) -> None:
    write_example_rig(tmp_path)
    paths = []
    for name, turn in (("bow", 40), ("wave", 120)):
        path = tmp_path / f"{name}.clip.yaml"
        path.write_text(
            "clip: animtool/1\nrig: hero.rig.yaml\nfps: 24\nchannels:\n"
            "- {target: joint/elbow_l.angle,"
            f" keys: [{{t: 1, v: 0}}, {{t: 6, v: {turn}}}]}}\n"
            "- {target: control/grin, keys: [{t: 1, v: 0}, {t: 6, v: 1}]}\n"
        )
        paths.append(path)
    library(paths, tmp_path / "lib.usda")
    stage = open_stage(tmp_path / "lib.usda")
    assert validation_errors(stage) == []
    root = UsdGeom.Boundable(stage.GetPrimAtPath("/hero/Rig"))
    for name in ("bow", "wave"):
        select(stage, name)
        assert bound(stage) == f"/hero/Rig/Anim_{name}"
        for code in (1, 3, 6):
            computed = UsdGeom.Boundable.ComputeExtentFromPlugins(
                root, Usd.TimeCode(code)
            )
            extent = np.array(root.GetExtentAttr().Get(code))
            assert_allclose(extent, np.array(computed), rtol=1e-5, atol=1e-6)


@pytest.mark.slow(0.5)
@settings(max_examples=examples(25))
@given(takes(), st.integers(2, 9), st.integers(0, 2**31), st.booleans())
def test_any_takes_come_back_as_if_alone(
    tmp_path_factory: pytest.TempPathFactory,
    one: Take,
    frames: int,
    seed: int,
    scaled: bool,
) -> None:
    folder = tmp_path_factory.mktemp("law")
    rng = np.random.default_rng(seed)
    second = motion_of(one.rig, frames, rng, scaled, False)
    two = replace(one, clock=replace(one.clock, count=frames), motion=second)
    names = joint_names(one.rig.joints)

    def job(output: Path) -> UsdJob:
        return UsdJob(
            form=LayerForm.STAGE,
            output=output,
            rig=one.rig,
            names=names,
            joints=one.rig.paths(names.names),
            paths=RigPaths.from_model("/any"),
            fps=one.clock.fps,
            meters_per_unit=1.0,
        )

    def part(take: Take, name: str = "") -> UsdTake:
        clock = take.clock
        blocks = round_blocks(iter([(clock.times, take.motion)]), take.rig, 1.0)
        shapes = tuple(shape.name for shape in take.rig.shapes)
        return UsdTake(
            blocks, clock.start, clock.step, shapes=shapes, name=name, source_name=name
        )

    def write(output: Path, *parts: UsdTake) -> Path:
        authored, result = author(job(output), parts)
        write_usd(job(output), authored, result)
        return output

    whole = write(folder / "lib.usdc", part(one, "one"), part(two, "two"))
    for name, take in (("one", one), ("two", two)):
        alone = read_usd(write(folder / f"{name}.usdc", part(take))).collect()
        assert_same_motion(read_usd(whole, take=name).collect(), alone)


@pytest.mark.parametrize(
    "data", [None, {}, {"start": "x", "end": 3.0}, {"start": 9.0, "end": 3.0},
             {"start": float("nan"), "end": 3.0}]
)  # fmt: skip
def test_a_range_that_is_none_is_passed_over(data: dict[str, Any] | None) -> None:
    stage = Usd.Stage.CreateInMemory()
    anim = UsdSkel.Animation.Define(stage, "/A")
    if data is not None:
        anim.GetPrim().SetCustomDataByKey("animtool", {"take": data})
    assert stored_take_range(anim) is None
