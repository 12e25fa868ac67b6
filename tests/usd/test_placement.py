"""Whatever places a character, each command has it where pxr composes it."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from pxr import Usd, UsdGeom, UsdSkel
from support.cli import animtool
from support.usd import joint_positions

from animtool import open_source
from animtool.errors import FormatError
from animtool.maths import so3
from animtool.report.describe import describe
from animtool.rig.placement import Placement
from animtool.rig.skeleton import Rig
from animtool.scene.bake import bake
from animtool.scene.convert import convert
from animtool.scene.options import BakeOptions
from animtool.scene.retarget import RetargetJob, run_retarget
from animtool.scene.sources import SourceOptions
from animtool.units import LengthUnit, UpAxis

Floats = npt.NDArray[np.float64]

FRAMES = 5
CODES = np.arange(1.0, FRAMES + 1)
STAGE = """#usda 1.0
(
    defaultPrim = "set"
    startTimeCode = 1
    endTimeCode = {last}
    metersPerUnit = {unit}
    upAxis = "{up}"
    timeCodesPerSecond = {fps}
)
def Xform "set"
{{
{set}
    def SkelRoot "char"
    {{
{char}
        def Skeleton "skel" (prepend apiSchemas = ["SkelBindingAPI"])
        {{
{skel}
            uniform token[] joints = ["Hips", "Hips/Spine", "Hips/Spine/Head"]
            uniform matrix4d[] bindTransforms = [{bind}]
            uniform matrix4d[] restTransforms = [{rest}]
            rel skel:animationSource = </set/char/anim>
        }}
        def SkelAnimation "anim"
        {{
            uniform token[] joints = ["Hips", "Hips/Spine", "Hips/Spine/Head"]
            float3[] translations.timeSamples = {{ {moves} }}
            quatf[] rotations.timeSamples = {{ {turns} }}
            half3[] scales = [(1, 1, 1), (1, 1, 1), (1, 1, 1)]
        }}
        def Mesh "body" (prepend apiSchemas = ["SkelBindingAPI"])
        {{
            int[] faceVertexCounts = [3, 3]
            int[] faceVertexIndices = [0, 1, 2, 1, 3, 2]
            point3f[] points = [{points}]
            int[] primvars:skel:jointIndices = [0, 1, 1, 2, 2, 1, 0, 2] (
                elementSize = 2
                interpolation = "vertex"
            )
            float[] primvars:skel:jointWeights = [.7, .3, .5, .5, .9, .1, .4, .6] (
                elementSize = 2
                interpolation = "vertex"
            )
            rel skel:skeleton = </set/char/skel>
            uniform token subdivisionScheme = "none"
        }}
    }}
}}
"""


def stage_text(
    where: str = "",
    ops: str = "",
    *,
    up: str = "Y",
    unit: float = 0.01,
    fps: int = 24,
    size: float = 1.0,
) -> str:
    """Return a stage of a leg of .9 m, with transforms on one of its prims."""
    long = 0.01 / unit / size

    def vector(x: float, y: float, z: float) -> str:
        # Up is the stage's axis.
        y, z = (y, z) if up == "Y" else (-z, y)
        return f"({x * long:.9g}, {y * long:.9g}, {z * long:.9g})"

    def matrix(x: float, y: float, z: float) -> str:
        rows = "(1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0)"
        return f"({rows}, {vector(x, y, z)[:-1]}, 1))"

    moves, turns = [], []
    for i, code in enumerate(CODES):
        places = vector(2 * i, 90, i), vector(1, -40, 2), vector(0, -40, 1)
        moves.append(f"{code:g}: [{', '.join(places)}]")
        half = np.radians(6.0 * i)
        x, y, z = np.sin(half) * np.array([0.6, 0.0, 0.8])
        turn = f"({np.cos(half):.9g}, {x:.9g}, {y:.9g}, {z:.9g})"
        turns.append(f"{code:g}: [{turn}, {turn}, (1, 0, 0, 0)]")
    rest = [(0, 90, 0), (1, -40, 2), (0, -40, 1)]
    bind = np.cumsum(rest, axis=0).tolist()
    points = [(5, 85, 3), (6, 50, -4), (-5, 45, 6), (2, 8, 9)]
    texts = {"set": "", "char": "", "skel": ""} | ({where: ops} if where else {})
    return STAGE.format(
        last=FRAMES,
        unit=unit,
        up=up,
        fps=fps,
        bind=", ".join(matrix(*row) for row in bind),
        rest=", ".join(matrix(*row) for row in rest),
        moves=", ".join(moves),
        turns=", ".join(turns),
        points=", ".join(vector(*row) for row in points),
        **texts,
    )


def op_text(kind: str, moves: bool, unit: float) -> str:
    """Return operations of a prim: placed 3 m away, turned, half its size, or all."""
    metre = 1.0 / unit

    def op(spelled: str, name: str, one: object, other: object) -> str:
        value = f" = {one}"
        if moves:
            value = f".timeSamples = {{ 1: {one}, {FRAMES}: {other} }}"
        return f"{spelled} xformOp:{name}{value}\n"

    kinds = {
        "translate": op(
            "double3", "translate", (3 * metre, metre, 0), (metre, 0, 2 * metre)
        ),
        "rotate": op("float3", "rotateXYZ", (90, 20, 10), (70, 50, -10)),
        "scale": op("float3", "scale", (0.5, 0.5, 0.5), (0.75, 0.75, 0.75)),
    }
    chosen = list(kinds) if kind == "all" else [kind]
    names = {"rotate": "rotateXYZ"}
    order = ", ".join(f'"xformOp:{names.get(one, one)}"' for one in chosen)
    text = "".join(kinds[one] for one in chosen)
    return f"{text}uniform token[] xformOpOrder = [{order}]"


def composed(path: Path | Usd.Stage, codes: Floats = CODES) -> Floats:
    """Return joints where pxr has them ``(F, J, 3)`` [m], Y up."""
    stage = Usd.Stage.Open(str(path)) if isinstance(path, Path) else path
    places = joint_positions(stage, codes) * UsdGeom.GetStageMetersPerUnit(stage)
    return upright(places, UsdGeom.GetStageUpAxis(stage))


def upright(places: Floats, up: str) -> Floats:
    if up == "Y":
        return places
    return np.stack([places[..., 0], places[..., 2], -places[..., 1]], axis=-1)


def skinned(path: Path) -> Floats:
    """Return points where pxr skins them ``(F, V, 3)`` [m], Y up."""
    stage = Usd.Stage.Open(str(path))
    root = UsdSkel.Root(stage.GetPrimAtPath("/set/char"))
    UsdSkel.BakeSkinning(root)
    return points_of(stage)


def points_of(stage: Usd.Stage) -> Floats:
    prim = next(p for p in stage.Traverse() if p.GetName() == "body")
    rows = []
    for code in CODES:
        points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(code), float)
        cache = UsdGeom.XformCache(code)
        world = np.array(cache.GetLocalToWorldTransform(prim))
        rows.append(points @ world[:3, :3] + world[3, :3])
    places = np.array(rows) * UsdGeom.GetStageMetersPerUnit(stage)
    return upright(places, UsdGeom.GetStageUpAxis(stage))


def over(layer: Path, rig: Path) -> Usd.Stage:
    """Return a layer over its rig."""
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().subLayerPaths = [str(layer), str(rig)]
    below = Usd.Stage.Open(str(rig))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.GetStageUpAxis(below))
    UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.GetStageMetersPerUnit(below))
    stage.SetTimeCodesPerSecond(below.GetTimeCodesPerSecond())
    return stage


PLACES = ("set", "char", "skel")
KINDS = ("translate", "rotate", "scale", "all")
SETTINGS = list(itertools.product("YZ", (1.0, 0.01), (24, 25, 30)))


def covering() -> list[tuple[str, str, bool, str, float, int]]:
    """Return cases in which every two values of two factors come together."""
    factors: list[tuple[Any, ...]] = [
        PLACES,
        KINDS,
        (False, True),
        ("Y", "Z"),
        (1.0, 0.01),
        (24, 25, 30),
    ]
    every = list(itertools.product(*factors))
    places = list(itertools.combinations(range(len(factors)), 2))
    left = {(i, j, case[i], case[j]) for case in every for i, j in places}
    chosen = []
    while left:
        counts = [
            sum((i, j, case[i], case[j]) in left for i, j in places) for case in every
        ]
        case = every[int(np.argmax(counts))]
        left -= {(i, j, case[i], case[j]) for i, j in places}
        chosen.append(case)
    return chosen


@pytest.mark.parametrize("where", PLACES)
@pytest.mark.parametrize("kind", KINDS[:3])
@pytest.mark.parametrize("moves", [False, True])
def test_a_bake_has_a_character_where_pxr_has_it(
    tmp_path: Path, where: str, kind: str, moves: bool
) -> None:
    for up, unit, fps in SETTINGS:
        source = tmp_path / f"{up}{unit}{fps}.usda"
        ops = op_text(kind, moves, unit)
        source.write_text(stage_text(where, ops, up=up, unit=unit, fps=fps))
        output = source.with_suffix(".usdc")
        bake(source, output)
        near = 1.5e-3 if moves and kind == "scale" else 2e-6
        found = composed(output)
        name = f"{up} up, {unit} m, {fps} a second"
        truth = composed(source)
        np.testing.assert_allclose(found, truth, atol=near, err_msg=name)


@pytest.mark.parametrize(("where", "kind", "moves", "up", "unit", "fps"), covering())
def test_each_command_has_a_character_where_pxr_has_it(
    tmp_path: Path,
    where: str,
    kind: str,
    moves: bool,
    up: str,
    unit: float,
    fps: int,
) -> None:
    source, rig = tmp_path / "source.usda", tmp_path / "rig.usda"
    ops = op_text(kind, moves, unit)
    source.write_text(stage_text(where, ops, up=up, unit=unit, fps=fps))
    rig.write_text(stage_text(up=up, unit=unit, fps=fps, size=1.0))
    truth = composed(source)
    # A size that changes is a scale of the root, which USD has in half precision.
    near = 1.5e-3 if moves and kind in {"scale", "all"} else 2e-6
    take = open_source(source).collect()
    assert take.clock.count == FRAMES
    places = upright(take.world().positions, take.rig.up)
    np.testing.assert_allclose(places, truth, atol=2e-6)

    bake(source, tmp_path / "stage.usda")
    np.testing.assert_allclose(composed(tmp_path / "stage.usda"), truth, atol=near)

    bake(source, tmp_path / "cache.usda", BakeOptions(deform=True))
    cache = points_of(Usd.Stage.Open(str(tmp_path / "cache.usda")))
    np.testing.assert_allclose(cache, skinned(source), atol=4e-6)

    for name, below in (("self", source), ("plain", rig)):
        layer = tmp_path / f"{name}.usda"
        bake(source, layer, BakeOptions(rig_layer=below, force_fit=True))
        found = composed(over(layer, below))
        np.testing.assert_allclose(found, truth, atol=near)
    if where != "char" or not moves:
        # The rig has all of it: its own numbers come back.
        stages = [Usd.Stage.Open(str(p)) for p in (source, tmp_path / "self.usda")]
        raw = stages[0].GetPrimAtPath("/set/char/anim")
        prim = next(p for p in stages[1].TraverseAll() if p.IsA(UsdSkel.Animation))
        for code in CODES:
            np.testing.assert_allclose(
                np.array(prim.GetAttribute("translations").Get(code)),
                np.array(raw.GetAttribute("translations").Get(code)),
                atol=2e-5 / unit,
            )

    if not (moves and kind in {"scale", "all"}):
        # A BVH has no scale that changes.
        convert(source, tmp_path / "out.bvh")
        reading = SourceOptions(unit=LengthUnit.M if unit == 1.0 else LengthUnit.CM)
        back = open_source(tmp_path / "out.bvh", reading).collect()
        places = upright(back.world().positions, take.rig.up)
        np.testing.assert_allclose(places, truth, atol=1e-5)


RETARGETED = [
    (where, kind, moves, *settings)
    for (where, (kind, moves)), settings in zip(
        itertools.product(
            PLACES,
            # A size that changes is no proportion of a body.
            (
                *(("translate", False), ("translate", True), ("rotate", True)),
                *(("scale", False), ("all", False)),
            ),
        ),
        itertools.cycle(SETTINGS),
        strict=False,
    )
]


@pytest.mark.parametrize(("where", "kind", "moves", "up", "unit", "fps"), RETARGETED)
def test_a_source_that_is_placed_goes_onto_a_rig_from_where_it_is(
    tmp_path: Path, where: str, kind: str, moves: bool, up: str, unit: float, fps: int
) -> None:
    source, rig = tmp_path / "source.usda", tmp_path / "rig.usda"
    ops = op_text(kind, moves, unit).replace("(90, 20, 10)", "(4, 20, 10)")
    source.write_text(stage_text(where, ops, up=up, unit=unit, fps=fps))
    rig.write_text(stage_text(up=up, unit=unit, fps=fps))
    output = tmp_path / "out.usda"
    run_retarget(RetargetJob(source, rig, output=output))
    truth, found = composed(source), composed(output)
    size = 0.5 if kind in {"scale", "all"} else 1.0
    # Bones are as long as the rig's: what they span is the source's, by its size.
    spans = (truth - truth[:, :1]) / size
    np.testing.assert_allclose(found - found[:, :1], spans, atol=2e-5)
    np.testing.assert_allclose(found[:, 0], truth[:, 0] / size, atol=2e-5)


@pytest.mark.parametrize("where", PLACES)
@pytest.mark.parametrize(
    ("kind", "moves"), [("translate", False), ("all", False), ("translate", True)]
)
def test_a_retargeted_layer_rides_on_its_rig_once(
    tmp_path: Path, where: str, kind: str, moves: bool
) -> None:
    source, plain = tmp_path / "source.usda", tmp_path / "plain.usda"
    ops = op_text(kind, moves, 0.01).replace("(90, 20, 10)", "(4, 20, 10)")
    source.write_text(stage_text(where, ops))
    plain.write_text(stage_text(size=2.0 if kind == "all" else 1.0))
    for choice in (None, "keep", "drop"):
        output = tmp_path / f"{choice}.usda"
        options = BakeOptions(rig_layer=source, placement=choice)
        run_retarget(RetargetJob(source, source, output=output, bake=options))
        found = composed(over(output, source))
        np.testing.assert_allclose(found, composed(source), atol=2e-5)
    # What has no place does not ride, whatever its rig does.
    report = run_retarget(
        RetargetJob(plain, source, output=tmp_path / "plain-out.usda")
    )
    assert "USD124" not in [notice.code for notice in report.notices]
    take = open_source(tmp_path / "plain-out.usda")
    assert take.rig.stands is None
    assert not take.rig.rides


def test_a_placed_rig_takes_what_stands_elsewhere(tmp_path: Path) -> None:
    plain, rig = tmp_path / "plain.usda", tmp_path / "rig.usda"
    plain.write_text(stage_text())
    ops = op_text("all", False, 0.01).replace("(90, 20, 10)", "(0, 20, 0)")
    # As large as the other, by its scale.
    rig.write_text(stage_text("char", ops, size=0.5))
    truth = composed(plain)
    bake(plain, tmp_path / "drop.usda", BakeOptions(rig_layer=rig))
    turn = so3.from_axis_angle([0.0, 1.0, 0.0], np.radians(20.0))
    moved = so3.rotate(turn, truth) + np.array([3.0, 1.0, 0.0])
    np.testing.assert_allclose(
        composed(over(tmp_path / "drop.usda", rig)), moved, atol=2e-6
    )
    options = BakeOptions(rig_layer=rig, placement="keep")
    bake(plain, tmp_path / "keep.usda", options)
    np.testing.assert_allclose(
        composed(over(tmp_path / "keep.usda", rig)), truth, atol=2e-6
    )


@pytest.mark.parametrize(
    ("where", "moves"),
    [("set", False), ("set", True), ("char", False), ("skel", False)],
)
def test_a_place_can_be_dropped(tmp_path: Path, where: str, moves: bool) -> None:
    source, plain = tmp_path / "source.usda", tmp_path / "plain.usda"
    source.write_text(stage_text(where, op_text("translate", moves, 0.01)))
    plain.write_text(stage_text())
    report = bake(source, tmp_path / "o.usda", BakeOptions(placement="drop"))
    np.testing.assert_allclose(
        composed(tmp_path / "o.usda"), composed(plain), atol=2e-6
    )
    assert not [n for n in report.notices if n.severity.value == "warning"]


def test_what_moves_the_skelroot_is_no_place(tmp_path: Path) -> None:
    source = tmp_path / "source.usda"
    source.write_text(stage_text("char", op_text("translate", True, 0.01)))
    bake(source, tmp_path / "o.usda", BakeOptions(placement="drop"))
    found = composed(tmp_path / "o.usda")
    np.testing.assert_allclose(found, composed(source), atol=2e-6)


def test_what_becomes_of_a_place_is_reported_once(tmp_path: Path) -> None:
    source, rig = tmp_path / "source.usda", tmp_path / "rig.usda"
    source.write_text(stage_text("set", op_text("translate", False, 0.01)))
    rig.write_text(stage_text())
    for options, word in (
        (BakeOptions(), "kept"),
        (BakeOptions(placement="drop"), "dropped"),
        (BakeOptions(rig_layer=rig), "kept"),
        (BakeOptions(rig_layer=source), "dropped"),
        (BakeOptions(rig_layer=source, placement="keep"), "kept"),
    ):
        report = bake(source, tmp_path / "o.usda", options)
        found = [n.message for n in report.notices if n.code == "USD124"]
        assert len(found) == 1, (options, found)
        assert all(word in message and "(3, 1, 0) m" in message for message in found)
        (tmp_path / "o.usda").unlink()


UNEVEN = {
    "scaled": ("(1, 2, 1)", "1 x 2 x 1"),
    "mirrored": ("(-1, 1, 1)", "mirrored"),
    "flat": ("(1, 0, 1)", "flat"),
}


@pytest.mark.parametrize("kind", UNEVEN)
def test_what_joints_cannot_hold_is_refused_with_numbers(
    tmp_path: Path, kind: str
) -> None:
    factors, said = UNEVEN[kind]
    source, plain = tmp_path / "source.usda", tmp_path / "plain.usda"
    ops = f"float3 xformOp:scale = {factors}\n"
    ops += 'uniform token[] xformOpOrder = ["xformOp:scale"]'
    source.write_text(stage_text("set", ops))
    plain.write_text(stage_text())
    for work in (
        lambda: bake(source, tmp_path / "o.usda"),
        lambda: convert(source, tmp_path / "o.bvh"),
        lambda: run_retarget(RetargetJob(source, plain)),
    ):
        with pytest.raises(FormatError) as caught:
            work()
        assert caught.value.code == "USD035"
        assert said in str(caught.value)
    report = bake(source, tmp_path / "o.usda", BakeOptions(placement="drop"))
    assert [n.code for n in report.notices] == ["USD109"]
    assert said in report.notices[0].message
    np.testing.assert_allclose(composed(tmp_path / "o.usda"), composed(plain))
    assert [n.code for n in describe(source).notices] == ["USD109"]
    # A layer over the very rig lacks nothing.
    report = bake(source, tmp_path / "layer.usda", BakeOptions(rig_layer=source))
    assert "USD109" not in [n.code for n in report.notices]
    found = composed(over(tmp_path / "layer.usda", source))
    np.testing.assert_allclose(found, composed(source), atol=2e-6)


def test_a_shear_is_refused_with_its_angle(tmp_path: Path) -> None:
    source = tmp_path / "source.usda"
    rows = "((1, 0, 0, 0), (0.1, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))"
    ops = f"matrix4d xformOp:transform = {rows}\n"
    ops += 'uniform token[] xformOpOrder = ["xformOp:transform"]'
    source.write_text(stage_text("char", ops))
    with pytest.raises(FormatError, match=r"sheared by 5\.71"):
        open_source(source)


def test_a_rig_of_a_stage_is_as_large_as_there(tmp_path: Path) -> None:
    path = tmp_path / "rig.usda"
    path.write_text(stage_text("set", op_text("all", False, 0.01)))
    rig = Rig.load(path)
    take = open_source(path).collect()
    np.testing.assert_allclose(rig.rest_translations, take.rig.rest_translations)
    np.testing.assert_allclose(
        np.linalg.norm(rig.rest_translations[2]), 0.5 * np.hypot(0.4, 0.01)
    )
    assert rig.meshes[0].geom_bind is not None


def test_a_shot_that_makes_metres_of_centimetres_changes_nothing(
    tmp_path: Path,
) -> None:
    (tmp_path / "rig.usda").write_text(stage_text())
    shot = tmp_path / "shot.usda"
    shot.write_text(
        '#usda 1.0\n(\nmetersPerUnit = 1\nupAxis = "Z"\ntimeCodesPerSecond = 24\n)\n'
        'def "hero" (prepend references = @./rig.usda@</set>)\n{\n'
        "float3 xformOp:scale = (0.01, 0.01, 0.01)\nfloat xformOp:rotateX = 90\n"
        'uniform token[] xformOpOrder = ["xformOp:rotateX", "xformOp:scale"]\n}\n'
    )
    bake(tmp_path / "rig.usda", tmp_path / "one.usda", BakeOptions(prim_path="/x"))
    report = bake(shot, tmp_path / "two.usda", BakeOptions(prim_path="/x"))
    assert (tmp_path / "one.usda").read_bytes() == (tmp_path / "two.usda").read_bytes()
    assert [n.code for n in report.notices] == []


def test_a_placement_is_undone_by_its_inverse() -> None:
    rng = np.random.default_rng(4)
    turns = so3.normalize(rng.normal(size=(6, 4)))
    placement = Placement(rng.normal(size=(6, 3)), turns, rng.uniform(0.5, 2, 6))
    same = placement.inverse().after(placement)
    np.testing.assert_allclose(same.translations, 0.0, atol=1e-12)
    np.testing.assert_allclose(np.abs(same.rotations[:, 3]), 1.0)
    np.testing.assert_allclose(same.sizes, 1.0)
    stands, sized = placement.split(UpAxis.Z)
    again = stands.after(sized)
    points = rng.normal(size=(6, 9, 3))
    np.testing.assert_allclose(again.points(points), placement.points(points))
    assert (stands.sizes == 1.0).all()


WRITTEN = ("usda", "bvh")
PLACED = [
    (where, kind, moves, up, suffix)
    for where, kind, moves, up, suffix in itertools.product(
        ("set", "char", "skel"), ("translate", "all"), (False, True), "YZ", WRITTEN
    )
    # A size that changes is no length of a rest pose, and a BVH states no up axis.
    if not (moves and kind == "all") and (suffix, up) != ("bvh", "Z")
]


@pytest.mark.parametrize(("where", "kind", "moves", "up", "suffix"), PLACED)
def test_what_was_written_from_a_placed_source_rides_on_it_once(
    tmp_path: Path, where: str, kind: str, moves: bool, up: str, suffix: str
) -> None:
    source, written = tmp_path / "source.usda", tmp_path / f"written.{suffix}"
    ops = op_text(kind, moves, 0.01).replace("(90, 20, 10)", "(4, 20, 10)")
    source.write_text(stage_text(where, ops, up=up))
    if suffix == "bvh":
        convert(source, written)
    else:
        bake(source, written)
    layer = tmp_path / "layer.usda"
    bake(written, layer, BakeOptions(rig_layer=source))
    found = composed(over(layer, source))
    np.testing.assert_allclose(found, composed(source), atol=2e-6)


@pytest.mark.parametrize(
    ("command", "given"),
    [
        ("bake", ["-o"]),
        ("convert", []),
        ("loop", ["--first", "1", "--last", "4", "-o"]),
        ("ik", ["--targets", "head.targets.yaml", "-o"]),
    ],
)
def test_each_command_drops_a_place_and_says_so(
    tmp_path: Path, command: str, given: list[str]
) -> None:
    source, plain = tmp_path / "source.usda", tmp_path / "plain.usda"
    source.write_text(stage_text("set", op_text("translate", False, 0.01)))
    plain.write_text(stage_text())
    # Where the head is, so that nothing needs to move.
    goal = "{effector: Head, position: [0, 0, 0], weight: 1e-9}"
    head = f"targets: animtool/1\nfps: 24\nunits: {{length: m}}\ngoals: [{goal}]\n"
    (tmp_path / "head.targets.yaml").write_text(head)
    outputs = []
    for path, choice in ((source, ["--placement", "drop"]), (plain, [])):
        named = [path.name]
        if command == "ik":
            named = [plain.name, "--clip", path.name]
        output = f"{path.stem}-out.usda"
        done = animtool(command, *named, *given, output, *choice, cwd=tmp_path)
        assert done.code == 0, done.stderr
        assert ("USD124" in done.stderr) == bool(choice)
        assert ("which is dropped" in done.stderr) == bool(choice)
        outputs.append(tmp_path / output)
    codes = CODES[:3]
    one, other = (composed(path, codes) for path in outputs)
    np.testing.assert_allclose(one, other, atol=2e-6)


@pytest.mark.parametrize("up", "YZ")
@pytest.mark.parametrize("where", ["set", "char", "skel"])
def test_a_place_that_a_file_records_can_be_dropped(
    tmp_path: Path, where: str, up: str
) -> None:
    source, written = tmp_path / "source.usda", tmp_path / "written.usda"
    ops = op_text("all", False, 0.01).replace("(90, 20, 10)", "(4, 20, 10)")
    source.write_text(stage_text(where, ops, up=up))
    bake(source, written)
    drop = BakeOptions(placement="drop")
    report = bake(written, tmp_path / "one.usda", drop)
    assert "USD124" in [notice.code for notice in report.notices]
    bake(source, tmp_path / "other.usda", drop)
    one, other = (composed(tmp_path / f"{name}.usda") for name in ("one", "other"))
    np.testing.assert_allclose(one, other, atol=2e-6)
    # Nothing is left of it: it is recorded no more.
    assert open_source(tmp_path / "one.usda").rig.stands is None


@pytest.mark.parametrize("up", "YZ")
def test_each_take_of_a_library_has_its_own_place(tmp_path: Path, up: str) -> None:
    source, plain, other = (tmp_path / f"{name}.usda" for name in ("s", "p", "o"))
    ops = op_text("all", False, 0.01).replace("(90, 20, 10)", "(4, 20, 10)")
    source.write_text(stage_text("set", ops, up=up))
    plain.write_text(stage_text(up=up, size=2.0))
    ops = ops.replace("(300.0, 100.0, 0)", "(-50, 20, 10)")
    assert "(-50, 20, 10)" in ops
    other.write_text(stage_text("char", ops, up=up))
    library = tmp_path / "library.usda"
    bake([source, plain, other], library, BakeOptions(form="library"))
    for path in (source, plain, other):
        reading = SourceOptions(take=path.stem)
        for name, given, options in (
            ("take", library, BakeOptions(source=reading, rig_layer=source)),
            ("own", path, BakeOptions(rig_layer=source)),
        ):
            bake(given, tmp_path / f"{path.stem}-{name}.usda", options)
        found, truth = (
            composed(over(tmp_path / f"{path.stem}-{name}.usda", source))
            for name in ("take", "own")
        )
        np.testing.assert_allclose(found, truth, atol=2e-6)


def test_a_malformed_record_of_a_place_is_refused(tmp_path: Path) -> None:
    source, written = tmp_path / "source.usda", tmp_path / "written.usda"
    source.write_text(stage_text("set", op_text("translate", False, 0.01)))
    bake(source, written)
    text = written.read_text()
    assert text.count("quatd rotate = (1, 0, 0, 0)") == 2
    written.write_text(text.replace("rotate = (1, 0, 0, 0)", "rotate = (3, 0, 0, 0)"))
    with pytest.raises(FormatError) as caught:
        open_source(written)
    assert caught.value.code == "USD007"


def test_lengths_are_those_of_the_world(tmp_path: Path) -> None:
    plain, rig = tmp_path / "plain.usda", tmp_path / "rig.usda"
    plain.write_text(stage_text())
    ops = "float3 xformOp:scale = (0.01, 0.01, 0.01)\n"
    ops += 'uniform token[] xformOpOrder = ["xformOp:scale"]'
    rig.write_text(stage_text("char", ops, size=0.01))
    reports = []
    for below in (None, rig):
        output = tmp_path / "o.usda"
        options = BakeOptions(rig_layer=below, reduce=0.005, overwrite=True)
        reports.append(bake(plain, output, options).takes[0])
    one, other = (report.thinned for report in reports)
    assert one is not None
    assert other is not None
    assert one.kept.tolist() == other.kept.tolist() != list(range(FRAMES))
    np.testing.assert_allclose(one.error, other.error, rtol=0.1)
    errors = [report.written.rounding.error for report in reports]
    assert max(errors) < 1e-6


def test_a_cache_over_a_scaled_rig_is_where_its_skin_would_be(tmp_path: Path) -> None:
    plain, rig = tmp_path / "plain.usda", tmp_path / "rig.usda"
    plain.write_text(stage_text())
    ops = op_text("all", False, 0.01).replace("(90, 20, 10)", "(0, 20, 0)")
    rig.write_text(stage_text("char", ops, size=0.5))
    options = BakeOptions(rig_layer=rig, deform=True, placement="keep")
    bake(plain, tmp_path / "cache.usda", options)
    found = points_of(over(tmp_path / "cache.usda", rig))
    np.testing.assert_allclose(found, skinned(plain), atol=4e-6)


TOOL = """
def Xform "tool"
{
    double3 xformOp:translate.timeSamples = { 1: (4, 5, 6), 5: (9, -5, 7) }
    float3 xformOp:rotateXYZ = (10, 40, -20)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
}
"""
PATHS = {"Props/tool": "/set/Props/tool", "/Props/tool": "/Props/tool"}


def beside_hips(path: Path | Usd.Stage, prim: str) -> Floats:
    """Return a prim in the frame of the hips ``(F, 4, 4)``, lengths [m]."""
    stage = Usd.Stage.Open(str(path)) if isinstance(path, Path) else path
    rows = []
    for code in CODES:
        xforms = UsdGeom.XformCache(code)
        own = np.array(xforms.GetLocalToWorldTransform(stage.GetPrimAtPath(prim)))
        own = rigid(own, stage)
        rows.append(own @ np.linalg.inv(hips_matrix(stage, code)))
    return np.array(rows)


def hips_matrix(stage: Usd.Stage, code: float) -> Floats:
    """Return the root joint where pxr has it, row vectors, [m]."""
    skeleton = UsdSkel.Skeleton(
        next(p for p in stage.Traverse() if UsdSkel.Skeleton(p))
    )
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root.Find(skeleton.GetPrim()), Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(skeleton)
    joints = query.ComputeJointWorldTransforms(UsdGeom.XformCache(code))
    return rigid(np.array(joints[0]), stage)


def rigid(matrix: Floats, stage: Usd.Stage) -> Floats:
    """Return a matrix without its scale, lengths [m]."""
    matrix[:3, :3] /= np.cbrt(abs(np.linalg.det(matrix[:3, :3])))
    matrix[3, :3] *= UsdGeom.GetStageMetersPerUnit(stage)
    return matrix


def shot_of(source: Path, path: str) -> Path:
    """Return a scene of a stage whose tool goes along."""
    scene = source.with_suffix(".scene.yaml")
    entry = f"{{from: {source.name}, prim: /tool, path: {path}}}"
    scene.write_text(
        f"scene: animtool/1\nsource: {{file: {source.name}}}\nprops: [{entry}]\n"
        "output: {file: unused.usda}\n"
    )
    (source.parent / "animtool.toml").touch()
    return scene


SYSTEM = """systems:
- particles:
    name: dust
    emitters: [{bursts: [[0, 1]], at: [1, 2, 3], speed: 0}]
"""
CARRIED = list(
    zip(
        itertools.product(("set", "char", "skel"), (False, True)),
        itertools.cycle(itertools.product(PATHS, "YZ")),
        strict=False,
    )
)


@pytest.mark.parametrize("case", CARRIED)
def test_props_of_a_source_stay_beside_its_character(
    tmp_path: Path, case: tuple[tuple[str, bool], tuple[str, str]]
) -> None:
    (where, moves), (path, up) = case
    source, plain, other = (tmp_path / f"{name}.usda" for name in ("s", "p", "o"))
    kind = "translate" if moves else "all"
    size = 1.0 if moves else 2.0
    ops = op_text(kind, moves, 0.01).replace("(90, 20, 10)", "(4, 20, 10)")
    source.write_text(stage_text(where, ops, up=up) + TOOL)
    plain.write_text(stage_text(up=up, size=size))
    ops = "double3 xformOp:translate = (7, 8, 9)\nfloat xformOp:rotateY = 35\n"
    ops += 'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateY"]'
    other.write_text(stage_text("char", ops, up=up, size=size))
    truth = beside_hips(source, "/tool")
    scene = shot_of(source, path)
    for below, choice in itertools.product(
        (None, source, plain, other), (None, "keep", "drop")
    ):
        name = f"{below and below.stem} {choice}"
        output = tmp_path / f"{name}.usda"
        model = None if below else "/set"
        bake(
            scene,
            output,
            BakeOptions(rig_layer=below, placement=choice, prim_path=model),
        )
        stage = over(output, below) if below else Usd.Stage.Open(str(output))
        found = beside_hips(stage, PATHS[path])
        np.testing.assert_allclose(found, truth, atol=1e-5, err_msg=name)


@pytest.mark.parametrize("up", "YZ")
@pytest.mark.parametrize("where", ["set", "char", "skel"])
def test_what_is_simulated_goes_where_its_rig_is(
    tmp_path: Path, where: str, up: str
) -> None:
    source, rig = tmp_path / "source.usda", tmp_path / "rig.usda"
    source.write_text(stage_text(up=up))
    for moves, kind in ((False, "all"), (True, "translate")):
        ops = op_text(kind, moves, 0.01).replace("(90, 20, 10)", "(4, 20, 10)")
        rig.write_text(stage_text(where, ops, up=up, size=1.0 if moves else 0.5))
        scene = tmp_path / f"{kind}.scene.yaml"
        text = f"scene: animtool/1\nsource: {{file: {source.name}}}\n{SYSTEM}"
        scene.write_text(f"{text}output: {{file: unused.usda}}\n")
        plain = tmp_path / f"{kind}-plain.usda"
        bake(scene, plain, BakeOptions(prim_path="/set"))
        truth = relative_dust(Usd.Stage.Open(str(plain)))
        for choice in ("keep", "drop"):
            output = tmp_path / f"{kind}-{choice}.usda"
            bake(scene, output, BakeOptions(rig_layer=rig, placement=choice))
            found = relative_dust(over(output, rig))
            np.testing.assert_allclose(
                found, truth, atol=1e-5, err_msg=f"{kind} {choice}"
            )


def relative_dust(stage: Usd.Stage) -> Floats:
    """Return where a particle is in the frame of the hips at the last frame [m]."""
    code = CODES[-1]
    prim = stage.GetPrimAtPath("/set/dust")
    point = np.array(prim.GetAttribute("points").Get(code)[0], float)
    world = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(prim))
    point = point @ world[:3, :3] + world[3, :3]
    point *= UsdGeom.GetStageMetersPerUnit(stage)
    hips = np.linalg.inv(hips_matrix(stage, code))
    return point @ hips[:3, :3] + hips[3, :3]
