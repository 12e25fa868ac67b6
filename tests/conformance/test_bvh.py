"""Every real BVH, in every form: what UsdSkel makes of it is what the file says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdSkel
from support.bvh import beginning, read_reference
from support.data import data_files
from support.suite import at_night, some_quick
from support.usd import joint_positions, open_stage, skeleton_query, validation_errors

from animtool.core.rates import rate_from_frame_time
from animtool.report.compare import compare_takes
from animtool.rig.skeleton import CHANNEL_NAMES
from animtool.scene.bake.bake import bake
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.prims import BakeReport
from animtool.scene.convert.takes import convert
from animtool.usd.takes.read import read_usd

# Joints may be this far from float64 forward kinematics, as a share of the
# skeleton's size: float32 holds 6e-8, and errors add up along a chain.
POSITION_TOLERANCE = 1e-6
FRAMES_CHECKED = 25
# Forms in the default profile: each way to write is in one of the first, which long
# takes have; the others take turns.
LONG = 300
FEW_FORMS = ["usda", "sparse", "split", "sparse layer"]
OTHER_FORMS = ["usda", "sparse", "usdc", "skelroot", "bones", "split", "layer"]

_CHANNELS = {name.lower(): name for name in CHANNEL_NAMES}

FILES = data_files("bvh", "*.bvh")


def forms(folder: Path) -> dict[str, tuple[BakeOptions, Path]]:
    """Return options and output of each form."""
    plain = BakeOptions()
    rig = folder / "split.rig.usda"
    return {
        "usda": (plain, folder / "stage.usda"),
        "usdc": (plain, folder / "stage.usdc"),
        "sparse": (replace(plain, sparse=True), folder / "sparse.usdc"),
        "skelroot": (replace(plain, root_motion=True), folder / "skelroot.usdc"),
        "bones": (replace(plain, bones=True), folder / "bones.usdc"),
        "split": (replace(plain, form="split"), folder / "split.usda"),
        "layer": (replace(plain, rig_layer=rig), folder / "layer.usdc"),
        "sparse layer": (
            replace(plain, rig_layer=rig, sparse=True, root_motion=True),
            folder / "sparse_layer.usda",
        ),
    }


def compose(report: BakeReport, folder: Path) -> Usd.Stage:
    """Open what was written; a layer over its rig."""
    output = report.result.outputs[-1]
    if not report.form.startswith("layer"):
        return open_stage(output)
    shot = Sdf.Layer.CreateNew(str(folder / f"{output.stem}.shot.usda"))
    shot.subLayerPaths = [f"./{output.name}", "./split.rig.usda"]
    layer = Sdf.Layer.FindOrOpen(str(output))
    for name in ("timeCodesPerSecond", "framesPerSecond", "defaultPrim"):
        setattr(shot, name, getattr(layer, name))
    for name in ("upAxis", "metersPerUnit"):
        shot.pseudoRoot.SetInfo(name, layer.pseudoRoot.GetInfo(name))
    shot.startTimeCode, shot.endTimeCode = layer.startTimeCode, layer.endTimeCode
    shot.Save()
    return Usd.Stage.Open(shot)


@pytest.mark.slow
@pytest.mark.parametrize("path", some_quick(FILES, 6))
def test_bake(path: Path, tmp_path: Path) -> None:
    reference = read_reference(path)
    count = len(reference.rows)
    frames = np.unique(np.linspace(0, count - 1, FRAMES_CHECKED).astype(int))
    truth = reference.positions(frames)
    tolerance = POSITION_TOLERANCE * reference.size()
    time = path.read_text("latin-1").split("Frame Time:")[1].split()[0]
    rate = rate_from_frame_time(time).fps
    reports = {}
    turn = [file.id for file in FILES].index(path.name)
    few = FEW_FORMS if count > LONG or turn % 2 else OTHER_FORMS
    names = at_night([*forms(tmp_path)], few)
    for name in names:
        options, output = forms(tmp_path)[name]
        report = bake(path, output, options)
        stage = compose(report, tmp_path)
        assert validation_errors(stage) == [], name
        found = joint_positions(stage, 1 + frames)
        error = np.linalg.norm(found - truth, axis=-1).max()
        assert error <= tolerance, f"{name}: {error / reference.size():.2e} of the size"
        # The error that the bake reports bounds what UsdSkel finds.
        assert error <= report.result.rounding.error / 0.01 + 1e-7 * reference.size()
        assert stage.GetStartTimeCode() == 1
        assert stage.GetEndTimeCode() == count
        assert stage.GetTimeCodesPerSecond() == float(rate)
        assert stage.GetFramesPerSecond() == float(rate)
        assert UsdGeom.GetStageUpAxis(stage) == "Y"
        assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01
        assert extent_error(stage, report) <= 2e-6, name
        reports[name] = report
    check_sparse(reports["usda"], reports["sparse"])


def extent_error(stage: Usd.Stage, report: BakeReport) -> float:
    """Return how far extents are from what UsdSkel computes, over their size."""
    root = UsdGeom.Boundable(next(p for p in stage.Traverse() if p.IsA(UsdSkel.Root)))
    errors = []
    for code in (report.result.first, report.result.last):
        time = Usd.TimeCode(float(code))
        written = np.array(root.GetExtentAttr().Get(time))
        computed = np.array(UsdGeom.Boundable.ComputeExtentFromPlugins(root, time))
        scale = max(1.0, np.abs(computed).max())
        errors.append(np.abs(written - computed).max() / scale)
    return float(np.max(errors))


def check_sparse(whole: BakeReport, sparse: BakeReport) -> None:
    """Check that what rests is left out."""
    assert sparse.result.joints <= whole.result.joints
    query = skeleton_query(open_stage(sparse.result.outputs[-1]))
    assert len(query.GetAnimQuery().GetJointOrder()) == sparse.result.joints


@pytest.mark.parametrize("path", some_quick(FILES, 3, 1))
def test_there_and_back(path: Path, tmp_path: Path) -> None:
    first, text, second = (tmp_path / name for name in ("a.usdc", "b.bvh", "c.usdc"))
    path = at_night(path, beginning(path, LONG, tmp_path / path.name))
    convert(path, first)
    convert(first, text)
    convert(text, second)
    one, two = read_usd(first).collect(), read_usd(second).collect()
    source = read_reference(path)
    again = read_reference(text)
    assert again.names == source.names
    assert again.channels == [
        [_CHANNELS[name.lower()] for name in names] for names in source.channels
    ]
    found = compare_takes(one, two)
    assert found.mismatches == []
    size = source.size() * 0.01
    reach = max(size, float(np.abs(one.motion.translations.dense()).max()))
    for mine, theirs in zip(one.rig.joints, two.rig.joints, strict=True):
        assert np.allclose(
            mine.tips, theirs.tips, rtol=0, atol=POSITION_TOLERANCE * reach
        )
    # Twice the rounding of float32, along the chain.
    assert found.world.value <= 2 * POSITION_TOLERANCE * reach
    assert found.translation.value <= 2.4e-7 * reach
    assert found.rotation.value <= 3e-5
