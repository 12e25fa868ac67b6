"""A planted fault a code in a clean USD layer: fixed in a copy, and nothing else."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pxr import Sdf, Usd, UsdGeom, UsdSkel, UsdUtils, Vt
from support.clean_layer import (
    ANIMATION,
    MESH,
    ROOT,
    SKELETON,
    attribute,
    make_layer,
    rotations,
)
from support.cli import animtool
from support.suite import some_quick

from animtool.core.errors import FormatError, OptionError
from animtool.report.compare import compare
from animtool.usd.fixes.table import EDITS_BY_CODE
from animtool.validation.fixes.plan import mark_fixable
from animtool.validation.fixes.run import fix_copy, fix_files
from animtool.validation.options import ValidateOptions
from animtool.validation.run import validate, validate_files

FRAMES = 12
Plant = Callable[[Any], None]


def flip_signs(layer: Any) -> None:
    for code in (4, 5, 9):
        turn(layer, code, -1.0)


def lengthen(layer: Any) -> None:
    turn(layer, 3, 1.25)


def turn(layer: Any, code: int, factor: float) -> None:
    rows = rotations(FRAMES)[code - 1]
    rows[1] *= factor
    path = f"{ANIMATION}.rotations"
    layer.SetTimeSample(path, code, Vt.QuatfArray.FromNumpy(rows))


def loosen(layer: Any) -> None:
    weights = [1, 0, 0.5, 0.4, 0.25, 0.75, 0, 2]
    attribute(layer, f"{MESH}.primvars:skel:jointWeights").default = weights


def shrink(layer: Any) -> None:
    layer.SetTimeSample(f"{ROOT}.extent", 5, Vt.Vec3fArray([(0, 0, 0), (0, 1, 0)]))


def drop(path: str) -> Plant:
    def plant(layer: Any) -> None:
        spec = attribute(layer, path)
        spec.owner.RemoveProperty(spec)

    return plant


def posed_by_nothing(layer: Any) -> None:
    """Leave the layer without rest transforms, and its animation without a joint."""
    drop(f"{SKELETON}.restTransforms")(layer)
    # What it spans follows from the rest pose.
    drop(f"{ROOT}.extent")(layer)
    path = f"{ANIMATION}.joints"
    attribute(layer, path).default = list(attribute(layer, path).default)[:-1]
    for name in ("translations", "rotations", "scales"):
        spec = attribute(layer, f"{ANIMATION}.{name}")
        for code in layer.ListTimeSamplesForPath(spec.path):
            rows = layer.QueryTimeSample(spec.path, code)
            layer.SetTimeSample(spec.path, code, rows[:-1])
        if spec.HasDefaultValue():
            spec.default = spec.default[:-1]


def hold(layer: Any) -> None:
    spec = attribute(layer, f"{ANIMATION}.joints")
    value = spec.default
    spec.ClearDefaultValue()
    for code in (1, 5):
        layer.SetTimeSample(spec.path, code, value)


def unbind(layer: Any) -> None:
    layer.GetPrimAtPath(MESH).ClearInfo("apiSchemas")


def clear(*names: str) -> Plant:
    def plant(layer: Any) -> None:
        for name in names:
            layer.pseudoRoot.ClearInfo(name)

    return plant


def stated(start: float, end: float) -> Plant:
    def plant(layer: Any) -> None:
        layer.startTimeCode, layer.endTimeCode = start, end

    return plant


def drift_times(layer: Any) -> None:
    """Let samples come later and later, as float steps that add up do."""
    for path in (f"{ANIMATION}.rotations", f"{ROOT}.extent"):
        codes = layer.ListTimeSamplesForPath(path)
        values = [layer.QueryTimeSample(path, code) for code in codes]
        for code in codes:
            layer.EraseTimeSample(path, code)
        for code, value in zip(codes, values, strict=True):
            layer.SetTimeSample(path, code * (1 + 1e-5), value)


# By code: what goes wrong, what the copy may differ in from the file before that.
PLANTS: dict[str, Plant] = {
    "MOT216": drift_times,
    "MOT217": stated(-5, FRAMES),
    "USD201": drop(f"{ANIMATION}.scales"),
    "USD203": lengthen,
    "USD204": flip_signs,
    "USD211": hold,
    "USD229": drop(f"{SKELETON}.restTransforms"),
    "USD232": loosen,
    "USD236": unbind,
    "USD239": posed_by_nothing,
    "USD250": drop(f"{ROOT}.extent"),
    "USD251": shrink,
    "USD252": clear("framesPerSecond"),
    "USD254": stated(FRAMES, 1),
    "USD255": clear("startTimeCode", "endTimeCode"),
    "USD256": stated(3, 5),
    "USD259": clear("defaultPrim"),
    "USD289": stated(0.5, FRAMES + 0.5),
}


def planted(path: Path, plant: Plant) -> Path:
    make_layer(path, FRAMES)
    layer = Sdf.Layer.FindOrOpen(str(path))
    plant(layer)
    layer.Save()
    return path


def texts(path: Path) -> str:
    """Return a layer as text, each number as its file has it."""
    return Sdf.Layer.OpenAsAnonymous(str(path)).ExportToString()


def test_every_edit_has_a_planted_fault() -> None:
    assert PLANTS.keys() == EDITS_BY_CODE.keys()


# A sum that is lost cannot be known again, nor the last bit of a rotation, nor a rest
# pose that is not the bind pose.
LOST = {
    "USD203": {"3"},
    "USD229": {"restTransforms"},
    "USD232": {"primvars:skel:jointWeights"},
    "USD239": {
        "joints",
        "restTransforms",
        "scales",
        "translations",
        *map(str, range(1, FRAMES + 1)),
    },
}


@pytest.mark.parametrize("code", some_quick(PLANTS, 3))
def test_a_fault_is_fixed_in_a_copy_and_all_else_stays(
    code: str, tmp_path: Path
) -> None:
    clean = make_layer(tmp_path / "clean.usdc", FRAMES)
    path = planted(tmp_path / "wrong.usdc", PLANTS[code])
    before = path.read_bytes()
    assert code in {fault.code for fault in validate(path)}
    fixes = fix_copy(path, tmp_path / "new.usdc")
    assert {fault.code for fault, _ in fixes.report.mended} >= {code}
    assert [str(fault) for fault in fixes.report.findings] == []
    assert path.read_bytes() == before
    new, old = texts(tmp_path / "new.usdc"), texts(clean)
    assert different(old, new) == LOST.get(code, set())
    assert len(old.splitlines()) == len(new.splitlines())


def different(old: str, new: str) -> set[str]:
    """Return which lines of two texts differ: a property or a sample's time code."""
    lines = set(old.splitlines()) ^ set(new.splitlines())
    return {re.split(r"[=(]|: \[", line)[0].split()[-1].rstrip(":") for line in lines}


def test_a_rest_pose_that_is_lost_is_the_bind_pose(tmp_path: Path) -> None:
    path = planted(tmp_path / "wrong.usda", PLANTS["USD229"])
    fix_copy(path, tmp_path / "new.usda")
    stage = Usd.Stage.Open(str(tmp_path / "new.usda"))
    skeleton = UsdSkel.Skeleton.Get(stage, SKELETON)
    rest = np.array(skeleton.GetRestTransformsAttr().Get())
    bind = np.array(skeleton.GetBindTransformsAttr().Get())
    world = [rest[0], rest[1] @ rest[0], rest[2] @ rest[1] @ rest[0]]
    assert_allclose(world, bind, atol=1e-12)


def test_weights_are_divided_by_their_sums(tmp_path: Path) -> None:
    path = planted(tmp_path / "wrong.usda", loosen)
    fixes = fix_copy(path, tmp_path / "new.usda")
    [(_, done)] = fixes.report.mended
    assert "2 of 4 points" in done
    assert "largest change 1" in done
    stage = Usd.Stage.Open(str(tmp_path / "new.usda"))
    attr = stage.GetAttributeAtPath(f"{MESH}.primvars:skel:jointWeights")
    expected = np.array([[1, 0], [5 / 9, 4 / 9], [0.25, 0.75], [0, 1]], np.float32)
    assert np.allclose(np.array(attr.Get()).reshape(4, 2), expected, rtol=2e-7)


def test_extents_are_those_of_the_plugin_to_the_last_bit(tmp_path: Path) -> None:
    path = planted(tmp_path / "wrong.usdc", shrink)
    fix_copy(path, tmp_path / "new.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "new.usdc"))
    bounded = UsdGeom.Boundable(stage.GetPrimAtPath(ROOT))
    for code in range(1, FRAMES + 1):
        computed = UsdGeom.Boundable.ComputeExtentFromPlugins(bounded, code)
        assert bounded.GetExtentAttr().Get(code) == computed


def test_an_extent_that_was_missing_differs_from_none(tmp_path: Path) -> None:
    path = planted(tmp_path / "wrong.usdc", PLANTS["USD250"])
    fixes = fix_copy(path, tmp_path / "new.usdc")
    [(_, done)] = fixes.report.mended
    assert done == f"{ROOT}: computes the extent at {FRAMES} samples"


@pytest.mark.parametrize("roots", [[ROOT, MESH], [MESH]])
def test_extents_of_meshes_come_before_those_of_their_skel_root(
    roots: list[str], tmp_path: Path
) -> None:
    def plant(layer: Any) -> None:
        attribute(layer, f"{MESH}.points").default = [(0, y, 3) for y in range(4)]
        for path in roots:
            drop(f"{path}.extent")(layer)

    path = planted(tmp_path / "wrong.usdc", plant)
    fixes = fix_copy(path, tmp_path / "new.usdc")
    assert "USD250" in {fault.code for fault, _ in fixes.report.mended}
    assert fixes.unfixed_findings == ()
    assert [str(fault) for fault in fixes.report.findings] == []


def test_signs_of_one_joint_change_alone(tmp_path: Path) -> None:
    path = planted(tmp_path / "wrong.usdc", flip_signs)
    fixes = fix_copy(path, tmp_path / "new.usdc")
    [(fault, done)] = fixes.report.mended
    assert (fault.code, fault.where) == ("USD204", f"{ANIMATION}.rotations")
    assert "3 quaternions in 3 of 12 samples" in done
    found = compare(path, tmp_path / "new.usdc")
    assert found.within(1e-6, 1e-4)


def test_a_layer_without_findings_is_copied_byte_for_byte(tmp_path: Path) -> None:
    path = make_layer(tmp_path / "clean.usdc", FRAMES)
    fixes = fix_copy(path, tmp_path / "new.usdc")
    assert not fixes.report.mended
    assert (tmp_path / "new.usdc").read_bytes() == path.read_bytes()


def test_the_format_and_the_metadata_of_a_layer_stay(tmp_path: Path) -> None:
    path = planted(tmp_path / "wrong.usda", flip_signs)
    path = path.rename(tmp_path / "wrong.usd")
    fix_copy(path, tmp_path / "new.usd")
    text = (tmp_path / "new.usd").read_text("utf-8")
    assert text.startswith("#usda")
    assert "made by hand" in text
    assert 'note = "keep me"' in text


def test_only_selected_codes_are_fixed(tmp_path: Path) -> None:
    def plant(layer: Any) -> None:
        flip_signs(layer)
        loosen(layer)

    path = planted(tmp_path / "wrong.usdc", plant)
    options = ValidateOptions(ignore=("USD232",))
    fixes = fix_copy(path, tmp_path / "new.usdc", options)
    assert [fault.code for fault, _ in fixes.report.mended] == ["USD204"]
    assert [fault.code for fault in validate(tmp_path / "new.usdc")] == ["USD232"]


def test_a_value_of_a_sublayer_stays_and_its_file_is_named(tmp_path: Path) -> None:
    planted(tmp_path / "rig.usdc", loosen)
    layer = Sdf.Layer.CreateNew(str(tmp_path / "shot.usda"))
    layer.subLayerPaths = ["./rig.usdc"]
    layer.TransferContent(shot_of(layer, tmp_path / "rig.usdc"))
    layer.Save()
    fixes = fix_copy(tmp_path / "shot.usda", tmp_path / "new.usda")
    [(fault, reason)] = fixes.unfixed_findings
    assert fault.code == "USD232"
    assert "rig.usdc" in reason
    assert "./rig.usdc" in (tmp_path / "new.usda").read_text("utf-8")


def shot_of(layer: Any, rig: Path) -> Any:
    """Return a layer with another's metadata over it, but for its prims."""
    made = Sdf.Layer.CreateAnonymous(".usda")
    made.TransferContent(layer)
    source = Sdf.Layer.FindOrOpen(str(rig))
    for name in source.pseudoRoot.ListInfoKeys():
        if name != "primChildren":
            made.pseudoRoot.SetInfo(name, source.pseudoRoot.GetInfo(name))
    made.subLayerPaths = list(layer.subLayerPaths)
    return made


def test_an_extent_of_a_sublayer_gets_an_over(tmp_path: Path) -> None:
    planted(tmp_path / "rig.usdc", shrink)
    layer = Sdf.Layer.CreateNew(str(tmp_path / "shot.usda"))
    layer.subLayerPaths = ["./rig.usdc"]
    layer.TransferContent(shot_of(layer, tmp_path / "rig.usdc"))
    layer.Save()
    fixes = fix_copy(tmp_path / "shot.usda", tmp_path / "new.usda")
    assert [fault.code for fault, _ in fixes.report.mended] == ["USD251"]
    assert fixes.report.findings == ()
    made = Sdf.Layer.FindOrOpen(str(tmp_path / "new.usda"))
    assert made.GetPrimAtPath(ROOT).specifier == Sdf.SpecifierOver


def test_relative_paths_lead_from_another_folder_too(tmp_path: Path) -> None:
    planted(tmp_path / "rig.usdc", shrink)
    (tmp_path / "deep").mkdir()
    layer = Sdf.Layer.CreateNew(str(tmp_path / "shot.usda"))
    layer.subLayerPaths = ["./rig.usdc"]
    layer.TransferContent(shot_of(layer, tmp_path / "rig.usdc"))
    layer.Save()
    fixes = fix_copy(tmp_path / "shot.usda", tmp_path / "deep/new.usda")
    assert fixes.notes[0].startswith("rewrites 1 relative asset path for")
    assert fixes.report.findings == ()
    assert "@../rig.usdc@" in (tmp_path / "deep/new.usda").read_text("utf-8")


def test_the_layer_in_memory_is_the_file_again(tmp_path: Path) -> None:
    path = planted(tmp_path / "wrong.usdc", flip_signs)
    layer = Sdf.Layer.FindOrOpen(str(path))
    before = layer.ExportToString()
    fix_copy(path, tmp_path / "new.usdc")
    assert not layer.dirty
    assert layer.ExportToString() == before


def test_usd_files_stay_unless_they_may_be_replaced(tmp_path: Path) -> None:
    path = planted(tmp_path / "wrong.usdc", flip_signs)
    before = path.read_bytes()
    fixes = fix_files([path])
    assert path.read_bytes() == before
    assert "1 finding can be fixed" in fixes.notes[0]
    assert [fault.code for fault in fixes.report.findings] == ["USD204"]
    held = Sdf.Layer.FindOrOpen(str(path))
    fixes = fix_files([path], overwrite=True)
    assert not held.dirty
    assert [fault.code for fault, _ in fixes.report.mended] == ["USD204"]
    assert fixes.report.findings == ()
    assert validate(path) == []


def test_the_command_writes_a_copy_and_reports_it(tmp_path: Path) -> None:
    path = planted(tmp_path / "wrong.usdc", flip_signs)
    new = tmp_path / "new.usdc"
    shown = animtool("validate", path, "--diff")
    assert shown.code == 1, shown.stderr
    assert "USD204" in shown.stdout
    assert animtool("validate", path, "--fix", "--strict").code == 1
    done = animtool("validate", path, "--fix", "-o", new, "--format", "json")
    assert done.code == 0, done.stderr
    report = json.loads(done.stdout)
    assert [entry["code"] for entry in report["mended"]] == ["USD204"]
    assert report["files"] == [str(new)]
    assert report["findings"] == []


def test_the_command_refuses_before_the_work(tmp_path: Path) -> None:
    path = planted(tmp_path / "wrong.usdc", flip_signs)
    before = path.read_bytes()
    new = tmp_path / "new.usdc"
    new.write_bytes(b"mine")
    done = animtool("validate", path, "--fix", "-o", new)
    assert (done.code, new.read_bytes()) == (2, b"mine")
    assert "OUT001" in done.stderr
    assert "OUT003" in animtool("validate", path, "--fix", "-o", path).stderr
    assert "OUT004" in animtool("validate", path, "--fix", "-o", "a.usdz").stderr
    assert animtool("validate", path, "-o", new).code == 2
    assert animtool("validate", path, path.parent, "--fix", "-o", new).code == 2
    assert path.read_bytes() == before
    done = animtool("validate", path, "--fix", "-o", new, "--overwrite")
    assert done.code == 0
    assert validate(new) == []
    assert not list(tmp_path.glob(".animtool*"))


def shot_over(rig: Path, path: Path) -> Path:
    """Write a layer that has another as its sublayer, and return its path."""
    path.write_text(f"#usda 1.0\n(\n    subLayers = [@./{rig.name}@]\n)\n", "utf-8")
    return path


def test_a_copy_never_replaces_a_layer_that_the_source_brings_in(
    tmp_path: Path,
) -> None:
    rig = planted(tmp_path / "rig.usdc", flip_signs)
    shot, before = shot_over(rig, tmp_path / "shot.usda"), rig.read_bytes()
    with pytest.raises(OptionError) as caught:
        fix_copy(shot, rig, overwrite=True)
    assert caught.value.faults[0].code == "OUT003"
    assert rig.read_bytes() == before


def drift(layer: Any) -> None:
    path = f"{ANIMATION}.rotations"
    for code in (3, 4, 5):
        value = layer.QueryTimeSample(path, code)
        layer.EraseTimeSample(path, code)
        layer.SetTimeSample(path, code + 0.004, value)


def test_samples_of_a_sublayer_off_the_frames_name_its_file(tmp_path: Path) -> None:
    rig = planted(tmp_path / "rig.usdc", drift)
    shot = Sdf.Layer.CreateNew(str(tmp_path / "shot.usda"))
    shot.subLayerPaths = ["./rig.usdc"]
    shot.TransferContent(shot_of(shot, rig))
    shot.Save()
    fixes = fix_copy(tmp_path / "shot.usda", tmp_path / "new.usda")
    assert [(f.code, "rig.usdc" in why) for f, why in fixes.unfixed_findings] == [
        ("MOT216", True)
    ]


def test_samples_far_off_the_frames_stay_and_the_reason_is_given(
    tmp_path: Path,
) -> None:
    def shift(layer: Any) -> None:
        path = f"{ANIMATION}.rotations"
        for code in layer.ListTimeSamplesForPath(path):
            value = layer.QueryTimeSample(path, code)
            layer.EraseTimeSample(path, code)
            layer.SetTimeSample(path, code + 0.3, value)

    path = planted(tmp_path / "wrong.usdc", shift)
    fixes = fix_copy(path, tmp_path / "new.usdc", ValidateOptions(select=("MOT216",)))
    assert [
        (fault.code, why.partition(": ")[2]) for fault, why in fixes.unfixed_findings
    ] == [("MOT216", "samples more than 0.05 off a whole frame may be intentional")]


def test_a_package_is_no_layer_to_fix(tmp_path: Path) -> None:
    path = planted(tmp_path / "wrong.usdc", flip_signs)
    package = tmp_path / "wrong.usdz"
    assert UsdUtils.CreateNewUsdzPackage(str(path), str(package))
    before = package.read_bytes()
    fixes = fix_files([package], overwrite=True)
    assert "unpack it" in fixes.notes[0]
    assert package.read_bytes() == before
    assert mark_fixable(validate_files([package])).fixable == frozenset()


@pytest.mark.parametrize(
    ("start", "end", "after"),
    [
        (100, 200, (1, FRAMES)),
        (-9, -3, (1, FRAMES)),
        (0.5, FRAMES + 0.25, (1, FRAMES)),
        (1.5, FRAMES - 0.5, (1, FRAMES)),
        (3.25, 6.75, (1, FRAMES)),
        (-40, 5, (1, FRAMES)),
    ],
)
def test_a_range_off_the_samples_is_moved_to_them(
    start: float, end: float, after: tuple[float, float], tmp_path: Path
) -> None:
    path = planted(tmp_path / "wrong.usda", stated(start, end))
    fixes = fix_copy(path, tmp_path / "new.usda")
    assert [str(fault) for fault in fixes.report.findings] == []
    layer = Sdf.Layer.OpenAsAnonymous(str(tmp_path / "new.usda"))
    assert (layer.startTimeCode, layer.endTimeCode) == after


def test_a_range_moves_with_its_samples(tmp_path: Path) -> None:
    path = planted(tmp_path / "wrong.usda", drift_times)
    layer = Sdf.Layer.FindOrOpen(str(path))
    layer.startTimeCode, layer.endTimeCode = 1 + 1e-5, FRAMES * (1 + 1e-5)
    layer.Save()
    fixes = fix_copy(path, tmp_path / "new.usda")
    assert [str(fault) for fault in fixes.report.findings] == []
    layer = Sdf.Layer.OpenAsAnonymous(str(tmp_path / "new.usda"))
    assert (layer.startTimeCode, layer.endTimeCode) == (1, FRAMES)


# Samples of names are ignored, so that nothing moves before they are a default.
@pytest.mark.parametrize(
    "code", some_quick(sorted(PLANTS.keys() - {"USD211", "USD239"}), 3, 1)
)
def test_a_file_equals_its_own_fix(code: str, tmp_path: Path) -> None:
    path = planted(tmp_path / "wrong.usda", PLANTS[code])
    fix_copy(path, tmp_path / "new.usda")
    try:
        difference = compare(path, tmp_path / "new.usda")
    except FormatError:
        # Nothing to compare with: it is refused until it is fixed.
        assert code in {"USD201", "USD254"}
        return
    assert difference.within(1e-7, 1e-5), difference
    assert difference.mismatches == []


def test_samples_astray_equal_their_own_fix(tmp_path: Path) -> None:
    path = make_layer(tmp_path / "wrong.usda", FRAMES)
    layer = Sdf.Layer.FindOrOpen(str(path))
    for name in ("rotations", "translations"):
        where = f"{ANIMATION}.{name}"
        for time, moved in ((4.0, 4.04), (9.0, 8.97)):
            value = layer.QueryTimeSample(where, time)
            if value is not None:
                layer.EraseTimeSample(where, time)
                layer.SetTimeSample(where, moved, value)
    layer.Save()
    fixes = fix_copy(path, tmp_path / "new.usda")
    assert "MOT216" in {fault.code for fault, _ in fixes.report.mended}
    difference = compare(path, tmp_path / "new.usda")
    assert difference.rotation.value == 0.0
    assert difference.within(0.0, 0.0), difference
