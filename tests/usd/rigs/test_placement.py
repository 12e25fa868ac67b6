"""Whatever places a character, each command has it where pxr composes it."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdSkel
from support.cli import animtool
from support.faults import raises
from support.placed import (
    CODES,
    FRAMES,
    PLACES,
    composed,
    op_text,
    over,
    points_of,
    skinned,
    stage_text,
    upright,
)
from support.suite import some_quick

from animtool import open_source
from animtool.core.errors import FormatError
from animtool.core.units import LengthUnit, UpAxis
from animtool.maths import so3
from animtool.report.describe import describe
from animtool.rig.placement import Placement
from animtool.rig.skeleton import Rig
from animtool.scene.bake.bake import bake
from animtool.scene.bake.options import BakeOptions
from animtool.scene.convert.takes import convert
from animtool.scene.solves.retarget import RetargetJob, run_retarget
from animtool.scene.sources.open import SourceOptions

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


@pytest.mark.slow
@pytest.mark.parametrize("where", PLACES)
@pytest.mark.parametrize("kind", some_quick(KINDS[:3], 3, 2))
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


@pytest.mark.parametrize(
    ("where", "kind", "moves", "up", "unit", "fps"),
    some_quick((pytest.param(*row) for row in covering()), 3),
)
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


@pytest.mark.parametrize(
    ("where", "kind", "moves", "up", "unit", "fps"),
    some_quick((pytest.param(*row) for row in RETARGETED), 2),
)
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


@pytest.mark.parametrize("where", some_quick(PLACES, 3))
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
    assert take.rig.placement is None
    assert not take.rig.has_animated_parents


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
    assert [n.code for n in report.notices] == ["USD109", "USD127"]
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
    with raises(FormatError, "USD035", match=r"5\.71"):
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
    assert [n.code for n in report.notices] == ["USD127"]


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
    np.testing.assert_allclose(
        again.transform_points(points), placement.transform_points(points)
    )
    assert (stands.sizes == 1.0).all()


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
    assert (
        one.kept_samples.tolist() == other.kept_samples.tolist() != list(range(FRAMES))
    )
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
