"""Animation layers over rigs in shots, as UsdSkel plays them."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from pxr import Usd, UsdSkel
from support.bvh import random_rows, read_reference, small_bvh
from support.suite import some_quick

from animtool.core.errors import AnimtoolError, OptionError
from animtool.scene.bake.bake import bake
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.prims import BakeReport

Floats = npt.NDArray[np.float64]

FRAMES = 9
# A rig that sways by itself, one unit a time code from 1001 on.
RIG = """#usda 1.0
(
    defaultPrim = "hero"
    metersPerUnit = 0.01
    upAxis = "Y"
    startTimeCode = 1001
    endTimeCode = 1011
    timeCodesPerSecond = 30
    framesPerSecond = 30
)

def Xform "hero" (
    kind = "component"MODEL_META
)
{MODEL
    def SkelRoot "Rig" (
        prepend apiSchemas = ["SkelBindingAPI"]ROOT_META
    )
    {
        rel skel:skeleton = </hero/Rig/Group/Skel>ROOT

        def Xform "Group" (
            prepend apiSchemas = ["SkelBindingAPI"]
        )
        {GROUP
            def Skeleton "Skel" (
                prepend apiSchemas = ["SkelBindingAPI"]
            )
            {SKEL
                uniform token[] joints = ["Hips", "Hips/Spine"]
                uniform matrix4d[] bindTransforms = [
                    ((0, 0, -1, 0), (0, 1, 0, 0), (1, 0, 0, 0), (3, -7, 11, 1)),
                    ((0, 1, 0, 0), (-1, 0, 0, 0), (0, 0, 1, 0), (4, 2, 9, 1)),
                ]
                uniform matrix4d[] restTransforms = [
                    ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (3, -7, 11, 1)),
                    ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (1, 10, -2, 1)),
                ]
            }
        }

        def SkelAnimation "Own"
        {
            uniform token[] joints = ["Hips", "Hips/Spine"]
            float3[] translations.timeSamples = {
                1001: [(3, -7, 11), (1, 10, -2)],
                1011: [(13, -7, 11), (1, 10, -2)],
            }
            quatf[] rotations = [(1, 0, 0, 0), (1, 0, 0, 0)]
            half3[] scales = [(1, 1, 1), (1, 1, 1)]
        }
    }
}
"""
OWN = "\nrel skel:animationSource = </hero/Rig/Own>\n"
APPLIED = '\nprepend apiSchemas = ["SkelBindingAPI"]'
PLACES = ("MODEL_META", "MODEL", "ROOT_META", "ROOT", "GROUP", "SKEL")
HEAD = """#usda 1.0
(
    metersPerUnit = 0.01
    upAxis = "Y"
    startTimeCode = START
    endTimeCode = 2000
    timeCodesPerSecond = RATE
    framesPerSecond = RATE
LAYERS)
"""


def rig_text(**places: str) -> str:
    text = RIG
    for name in PLACES:
        text = text.replace(name, places.get(name, ""))
    return text


def head(layers: str = "", start: int = 1009, rate: int = 30) -> str:
    listed = f"    subLayers = [{layers}]\n" if layers else ""
    text = HEAD.replace("START", str(start)).replace("RATE", str(rate))
    return text.replace("LAYERS", listed)


REFERS = "prepend references = @./rig.usda@"


def prim_text(name: str, meta: str = "", *inside: str, kind: str = "") -> str:
    """Return a prim as usda wants it, in lines."""
    return "\n".join([f'def {kind} "{name}" (', meta, ")", "{", *inside, "}", ""])


def world(meta: str = REFERS, *inside: str) -> str:
    """Return a shot's prims: a hero, brought in by its metadata."""
    return prim_text("World", "", prim_text("hero", meta, *inside))


@pytest.fixture
def take(tmp_path: Path) -> Path:
    path = tmp_path / "take.bvh"
    path.write_text(small_bvh(random_rows(FRAMES)))
    return path


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.usda"
    path.write_text(rig_text(ROOT=OWN))
    return path


def truth(take: Path) -> Floats:
    """Return where the joints of a take are in its frames ``(F, J, 3)``."""
    return read_reference(take).positions(np.arange(FRAMES))


def own(codes: npt.ArrayLike) -> Floats:
    """Return where the rig's own animation has its joints at its time codes."""
    sway = np.clip(np.asarray(codes, float) - 1001, 0, 10)
    places = np.tile([(3.0, -7.0, 11.0), (4.0, 3.0, 9.0)], (len(sway), 1, 1))
    places[..., 0] += sway[:, None]
    return places


def played(shot: Path | Usd.Stage, root: str, codes: npt.ArrayLike) -> Floats:
    """Return where UsdSkel has the joints of a SkelRoot, in its space."""
    stage = Usd.Stage.Open(str(shot)) if isinstance(shot, Path) else shot
    query = query_of(stage, root)
    return np.array(
        [
            np.array(query.ComputeJointSkelTransforms(Usd.TimeCode(code)))[:, 3, :3]
            for code in np.asarray(codes, float)
        ]
    )


def query_of(stage: Usd.Stage, root: str) -> UsdSkel.SkeletonQuery:
    prim = stage.GetPrimAtPath(root)
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root(prim), Usd.TraverseInstanceProxies())
    found = Usd.PrimRange(prim, Usd.TraverseInstanceProxies())
    skeleton = next(p for p in found if p.IsA(UsdSkel.Skeleton))
    return cache.GetSkelQuery(UsdSkel.Skeleton(skeleton))


def assert_near(found: Floats, expected: Floats) -> None:
    size = float(np.abs(expected).max())
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * size)


def layer_for(
    take: Path, rig_layer: Path, prim: str | None = None, name: str = "layer.usda"
) -> BakeReport:
    options = BakeOptions(rig_layer=rig_layer, prim_path=prim)
    return bake(take, rig_layer.with_name(name), options)


# How a rig may bind its animation, and where the layer must.
VARIANT = """
    variantSet "use" = {
        "own" {
            over "Rig" {
                over "Group" {
                    over "Skel" {
                        rel skel:animationSource = </hero/Rig/Own>
                    }
                }
            }
        }
    }
"""
CHOSEN = '\nvariants = { string use = "own" }\nprepend variantSets = "use"'
CLASS = """
class "_binds" (
    prepend apiSchemas = ["SkelBindingAPI"]
)
{
    rel skel:animationSource = </hero/Rig/Own>
}
"""
BINDINGS = {
    "nowhere": ({}, "Rig"),
    "SkelRoot": ({"ROOT": OWN}, "Rig"),
    "between": ({"GROUP": OWN}, "Rig/Group"),
    "Skeleton": ({"SKEL": OWN}, "Rig/Group/Skel"),
    "model": ({"MODEL": OWN, "MODEL_META": APPLIED}, ""),
    "both": ({"ROOT": OWN, "SKEL": OWN}, "Rig/Group/Skel"),
    "variant": ({"MODEL": VARIANT, "MODEL_META": CHOSEN}, "Rig/Group/Skel"),
    "inherits": ({"ROOT_META": "\nprepend inherits = </_binds>"}, "Rig"),
}


@pytest.mark.parametrize("binding", BINDINGS)
@pytest.mark.parametrize(
    "way", some_quick(["sublayer", "reference", "shot", "library"], 2)
)
def test_the_layer_binds_where_the_rig_does(
    take: Path, tmp_path: Path, binding: str, way: str
) -> None:
    places, expected = BINDINGS[binding]
    rig = tmp_path / "rig.usda"
    rig.write_text(rig_text(**places) + (CLASS if binding == "inherits" else ""))
    shot = tmp_path / "shot.usda"
    prim = "/hero" if way == "sublayer" else "/World/hero"
    if way == "sublayer":
        layer_for(take, rig)
        shot.write_text(head("@./layer.usda@, @./rig.usda@"))
    else:
        text = world()
        shot.write_text(head() + text)
        source = shot if way == "shot" else rig
        if way == "library":
            second = tmp_path / "second.bvh"
            second.write_text(take.read_text())
            options = BakeOptions(rig_layer=rig, prim_path=prim)
            bake([second, take], tmp_path / "layer.usda", options)
            text = world(f'{REFERS}\nvariants = {{\nstring take = "take"\n}}')
        else:
            layer_for(take, source, prim)
        shot.write_text(head("@./layer.usda@") + text)
    stage = Usd.Stage.Open(str(shot))
    start = 1009 if way == "shot" else 1001
    codes = start + np.arange(FRAMES)
    assert_near(played(stage, f"{prim}/Rig", codes), truth(take))
    where = f"{prim}/{expected}".rstrip("/")
    binds = stage.GetPrimAtPath(where).GetRelationship("skel:animationSource")
    strongest = binds.GetPropertyStack()[0]
    assert strongest.layer.identifier.endswith("layer.usda")
    name = "Anim_take" if way == "library" else "Anim"
    assert [str(path) for path in binds.GetTargets()] == [f"{prim}/Rig/{name}"]


def test_what_binds_above_the_model_is_left_alone(
    take: Path, rig: Path, tmp_path: Path
) -> None:
    rig.write_text(rig_text())
    shot = tmp_path / "shot.usda"
    text = prim_text(
        "World",
        'prepend apiSchemas = ["SkelBindingAPI"]',
        "rel skel:animationSource = </World/a/Rig/Own>",
        prim_text("a", REFERS),
        prim_text("b", REFERS),
    )
    shot.write_text(head() + text)
    layer_for(take, shot, "/World/b")
    shot.write_text(head("@./layer.usda@") + text)
    codes = 1009 + np.arange(FRAMES)
    assert_near(played(shot, "/World/b/Rig", codes), truth(take))
    assert_near(played(shot, "/World/a/Rig", codes), own(codes))


def test_a_rig_that_stands_elsewhere(take: Path, rig: Path, tmp_path: Path) -> None:
    shot = tmp_path / "shot.usda"
    stands = [
        "double3 xformOp:translate = (50, 0, -20)",
        'uniform token[] xformOpOrder = ["xformOp:translate"]',
    ]
    inside = prim_text("set", "", *stands, prim_text("hero", REFERS), kind="Xform")
    text = prim_text("World", "", inside, kind="Xform")
    shot.write_text(head() + text)
    report = layer_for(take, shot, "/World/set/hero")
    assert report.notices == []
    assert rig.is_file()
    shot.write_text(head("@./layer.usda@") + text)
    stage = Usd.Stage.Open(str(shot))
    codes = 1009 + np.arange(FRAMES)
    local = played(stage, "/World/set/hero/Rig", codes)
    assert_near(local, truth(take))
    root = stage.GetPrimAtPath("/World/set/hero/Rig")
    skeleton = query_of(stage, "/World/set/hero/Rig").GetSkeleton()
    placed = np.array(skeleton.ComputeLocalToWorldTransform(Usd.TimeCode(1010)))
    np.testing.assert_allclose(placed[3, :3], [50, 0, -20])
    assert root.GetAttribute("extent").GetTimeSamples() == codes.tolist()


TWICE = prim_text("World", "", prim_text("a", REFERS), prim_text("b", REFERS))


def test_a_rig_that_a_shot_refers_to_twice(
    take: Path, rig: Path, tmp_path: Path
) -> None:
    assert rig.is_file()
    other = tmp_path / "other.bvh"
    other.write_text(small_bvh(random_rows(FRAMES, seed=3)))
    shot = tmp_path / "shot.usda"
    shot.write_text(head() + TWICE)
    codes = 1009 + np.arange(FRAMES)
    for source, name in ((take, "a"), (other, "b")):
        report = layer_for(source, shot, f"/World/{name}", f"{name}.usda")
        assert report.notices == []
    for layers, a, b in (
        ("@./a.usda@", truth(take), own(codes)),
        ("@./b.usda@", own(codes), truth(other)),
        ("@./a.usda@, @./b.usda@", truth(take), truth(other)),
    ):
        shot.write_text(head(layers) + TWICE)
        stage = Usd.Stage.Open(str(shot))
        stage.Reload()
        assert_near(played(stage, "/World/a/Rig", codes), a)
        assert_near(played(stage, "/World/b/Rig", codes), b)


@pytest.mark.parametrize("prim", ["/World/hero", "/World"])
@pytest.mark.parametrize("many", [False, True])
def test_an_instance_is_refused_before_anything_is_written(
    take: Path, rig: Path, tmp_path: Path, prim: str, many: bool
) -> None:
    assert rig.is_file()
    shot = tmp_path / "shot.usda"
    shot.write_text(head() + world(f"instanceable = true\n{REFERS}"))
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    options = BakeOptions(rig_layer=shot, prim_path=prim)
    with pytest.raises(AnimtoolError) as caught:
        bake([take] * (2 if many else 1), tmp_path / "layer.usda", options)
    assert caught.value.code == "USD011"
    assert "instanced" in str(caught.value.faults[0].hint)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("how", ["reference", "sublayer"])
def test_offsets_of_the_rig_do_not_touch_the_layer(
    take: Path, rig: Path, tmp_path: Path, how: str
) -> None:
    assert rig.is_file()
    shot, prim = tmp_path / "shot.usda", "/World/hero"
    shifted = "@./rig.usda@ (offset = 10; scale = 2)"
    text = world(f"prepend references = {shifted}")
    props = "@./layer.usda@"
    if how == "sublayer":
        prim, text, props = "/hero", "", f"@./layer.usda@, {shifted}"
        shot.write_text(head(shifted))
    else:
        shot.write_text(head() + text)
    # The rig's own animation is shifted and stretched by what brings it in.
    codes = np.arange(2012.0, 2032.0)
    assert_near(played(shot, f"{prim}/Rig", codes), own((codes - 10) / 2))
    report = layer_for(take, shot, prim)
    assert (report.span.first, report.fps) == (1009, 30)
    shot.write_text(head(props) + text)
    stage = Usd.Stage.Open(str(shot))
    stage.Reload()
    codes = 1009 + np.arange(FRAMES)
    assert_near(played(stage, f"{prim}/Rig", codes), truth(take))


@pytest.mark.parametrize(("offset", "scale"), [(10, 1), (-1000, 1), (5, 2), (0, 0.5)])
def test_a_layer_that_a_shot_shifts_plays_shifted(
    take: Path, rig: Path, tmp_path: Path, offset: float, scale: float
) -> None:
    layer_for(take, rig)
    shot = tmp_path / "shot.usda"
    shifted = f"@./layer.usda@ (offset = {offset}; scale = {scale})"
    shot.write_text(head(f"{shifted}, @./rig.usda@"))
    codes = offset + scale * (1001 + np.arange(FRAMES))
    stage = Usd.Stage.Open(str(shot))
    assert_near(played(stage, "/hero/Rig", codes), truth(take))
    extent = stage.GetPrimAtPath("/hero/Rig").GetAttribute("extent")
    assert extent.GetTimeSamples() == codes.tolist()


def test_a_shot_of_another_rate_and_start_with_offsets(
    take: Path, rig: Path, tmp_path: Path
) -> None:
    assert rig.is_file()
    shot = tmp_path / "shot.usda"
    shifted = "@./rig.usda@ (offset = -400; scale = 3)"
    shot.write_text(head(shifted, start=17, rate=15))
    report = layer_for(take, shot)
    assert (report.span.first, report.span.last) == (17, 21)
    assert report.fps == Fraction(15)
    top = tmp_path / "top.usda"
    top.write_text(head("@./layer.usda@, @./shot.usda@", start=17, rate=15))
    # Every second frame of the take is one of the shot's.
    assert_near(played(top, "/hero/Rig", 17 + np.arange(5)), truth(take)[::2])


def test_a_shot_that_binds_an_animation_itself(
    take: Path, rig: Path, tmp_path: Path
) -> None:
    assert rig.is_file()
    shot, top = tmp_path / "shot.usda", tmp_path / "top.usda"
    binds = "rel skel:animationSource = </World/hero/Rig/Own>"
    text = world(REFERS, prim_text("Rig", "", binds).replace("def", "over"))
    shot.write_text(head() + text)
    report = layer_for(take, shot, "/World/hero")
    assert [notice.code for notice in report.notices] == ["USD132"]
    codes = 1009 + np.arange(FRAMES)
    shot.write_text(head("@./layer.usda@") + text)
    below = Usd.Stage.Open(str(shot))
    below.Reload()
    # As the warning says: not as a sublayer of it, but above it.
    assert_near(played(below, "/World/hero/Rig", codes), own(codes))
    shot.write_text(head() + text)
    top.write_text(head("@./layer.usda@, @./shot.usda@"))
    above = Usd.Stage.Open(str(top))
    above.Reload()
    assert_near(played(above, "/World/hero/Rig", codes), truth(take))


@pytest.mark.parametrize("prim", ["/World/heor", "/World/hero/Rig/typo", "/Wrold/hero"])
@pytest.mark.parametrize("strict", [False, True])
def test_a_path_of_no_character_in_a_shot_is_refused(
    take: Path, rig: Path, tmp_path: Path, prim: str, strict: bool
) -> None:
    assert rig.is_file()
    shot = tmp_path / "shot.usda"
    shot.write_text(head() + world())
    options = BakeOptions(rig_layer=shot, prim_path=prim, strict=strict)
    with pytest.raises(OptionError) as caught:
        bake(take, tmp_path / "layer.usda", options)
    assert caught.value.code == "USD033"
    assert "/World/hero" in caught.value.faults[0].message
    assert not (tmp_path / "layer.usda").exists()


@pytest.mark.parametrize("prim", ["/World/c", "/c", "/World/a/Rig/Own"])
def test_a_path_of_no_character_among_several_is_refused(
    take: Path, rig: Path, tmp_path: Path, prim: str
) -> None:
    assert rig.is_file()
    shot = tmp_path / "shot.usda"
    shot.write_text(head() + TWICE)
    with pytest.raises(OptionError) as caught:
        layer_for(take, shot, prim)
    assert caught.value.code == "USD033"
    assert "/World/a, /World/b" in caught.value.faults[0].message


def test_a_prim_of_the_shot_without_a_character_is_refused(
    take: Path, rig: Path, tmp_path: Path
) -> None:
    assert rig.is_file()
    shot = tmp_path / "shot.usda"
    inside = (prim_text("hero", REFERS), prim_text("set", ""))
    shot.write_text(head() + prim_text("World", "", *inside))
    with pytest.raises(OptionError) as caught:
        layer_for(take, shot, "/World/set")
    assert caught.value.code == "USD033"
