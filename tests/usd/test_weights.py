"""Weights of shapes: what UsdSkel computes of them, and how they come back."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from numpy.testing import assert_array_equal
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt
from support.faults import raises
from support.surfaces import shaped_rig
from support.usd import open_stage, skeleton_query, validation_errors

from animtool.core.errors import FormatError, OutputError
from animtool.motion.motion import Channel, Motion
from animtool.rig.skeleton import Joint, Rig
from animtool.usd.layers.jobs import LayerForm, UsdJob, UsdResult, UsdTake
from animtool.usd.layers.names import RigPaths, joint_names
from animtool.usd.rigs.joint_map import map_joints, match_shapes
from animtool.usd.rigs.layer import write_rig_layer
from animtool.usd.rigs.target import open_target
from animtool.usd.takes.author import author, write_usd
from animtool.usd.takes.joint_writer import round_blocks
from animtool.usd.takes.read import read_usd

SHAPES = ("smile", "blink", "frown", "jaw")
RIG = Rig("hero", (Joint("Hips", -1), Joint("Spine", 0, translation=(0, 1, 0))))


def motion(weights: npt.NDArray[np.float64] | None, frames: int = 7) -> Motion:
    """Return the rig at rest, with weights ``(F, S)``."""
    return Motion(
        Channel.from_dense(np.repeat(RIG.rest_translations[None], frames, axis=0)),
        Channel.from_dense(np.repeat(RIG.rest_rotations[None], frames, axis=0)),
        weights=None if weights is None else Channel.from_dense(weights[..., None]),
    )


def moving(frames: int = 7) -> npt.NDArray[np.float64]:
    """Return weights: one that moves, one that stands, two that are zero."""
    weights = np.zeros((frames, len(SHAPES)))
    weights[:, 1] = np.linspace(-0.5, 1.7, frames) ** 2
    weights[:, 3] = 0.3
    return weights


def job(output: Path, **fields: Any) -> UsdJob:
    names = joint_names(RIG.joints, 0)
    made = UsdJob(
        form=LayerForm.STAGE,
        output=output,
        rig=RIG,
        names=names,
        joints=RIG.paths(names.names),
        paths=RigPaths.from_model("/hero"),
        fps=Fraction(24),
        meters_per_unit=1.0,
    )
    return replace(made, **fields)


def write(made: UsdJob, taken: Motion, split: int = 0) -> UsdResult:
    codes = np.arange(1.0, taken.frames + 1.0)
    parts = [slice(0, split), slice(split, None)] if split else [slice(None)]
    blocks = ((codes[part], taken.select(part)) for part in parts)
    rounded = round_blocks(blocks, made.rig, made.meters_per_unit)
    one = UsdTake(rounded, Fraction(1), Fraction(1), shapes=SHAPES)
    authored, result = author(made, [one])
    write_usd(made, authored, result)
    return result


def computed(stage: Usd.Stage, code: float) -> dict[str, float]:
    """Return the weights that UsdSkel computes, by shape."""
    query = skeleton_query(stage).GetAnimQuery()
    values = query.ComputeBlendShapeWeights(Usd.TimeCode(code))
    return dict(zip(query.GetBlendShapeOrder(), values, strict=True))


@pytest.mark.parametrize("split", [0, 1, 4])
@pytest.mark.parametrize("suffix", ["usda", "usdc"])
def test_usdskel_computes_the_weights(tmp_path: Path, split: int, suffix: str) -> None:
    path, weights = tmp_path / f"o.{suffix}", moving()
    result = write(job(path), motion(weights), split)
    assert result.sampled == ["blendShapeWeights"]
    stage = open_stage(path)
    for frame, row in enumerate(weights.astype(np.float32)):
        assert computed(stage, frame + 1) == {"blink": row[1], "jaw": row[3]}
    assert validation_errors(stage) == []
    order = stage.GetPrimAtPath("/hero/Rig/Anim").GetAttribute("blendShapes")
    assert order.GetVariability() == Sdf.VariabilityUniform


def test_weights_that_stand_are_a_default(tmp_path: Path) -> None:
    weights = np.tile([0.0, 0.25, -1.0, 0.0], (5, 1))
    result = write(job(tmp_path / "o.usda"), motion(weights, 5), 2)
    assert result.sampled == []
    stage = open_stage(tmp_path / "o.usda")
    attr = stage.GetPrimAtPath("/hero/Rig/Anim").GetAttribute("blendShapeWeights")
    assert attr.GetNumTimeSamples() == 0
    assert computed(stage, 3) == {"blink": 0.25, "frown": -1.0}


@pytest.mark.parametrize("weights", [None, np.zeros((7, 4))])
def test_without_weights_nothing_is_written(
    tmp_path: Path, weights: npt.NDArray[np.float64] | None
) -> None:
    write(job(tmp_path / "o.usda"), motion(weights))
    assert "blendShape" not in (tmp_path / "o.usda").read_text()
    assert read_usd(tmp_path / "o.usda").collect().motion.weights is None


def test_a_weight_beyond_float32_is_refused(tmp_path: Path) -> None:
    weights = moving()
    weights[2, 0] = 1e39
    with raises(OutputError, "USD170", match="shape 0 at frame 3 is 1e"):
        write(job(tmp_path / "o.usda"), motion(weights))


def test_weights_come_back(tmp_path: Path) -> None:
    write(job(tmp_path / "o.usdc"), motion(moving()))
    stream = read_usd(tmp_path / "o.usdc")
    take = stream.collect()
    assert [shape.name for shape in stream.rig.shapes] == ["blink", "jaw"]
    assert take.clock.count == 7
    assert take.motion.weights is not None
    assert take.motion.weights.animated.tolist() == [0]
    expected = moving()[:, [1, 3], None].astype(np.float32)
    assert_array_equal(take.motion.weights.dense(), expected)


def test_weights_between_the_joints_samples_make_the_grid(tmp_path: Path) -> None:
    write(job(tmp_path / "o.usda"), motion(moving(3), 3))
    stage = open_stage(tmp_path / "o.usda")
    attr = stage.GetPrimAtPath("/hero/Rig/Anim").GetAttribute("blendShapeWeights")
    attr.Set(Vt.FloatArray([0.5, 0.0]), 1.5)
    stage.Save()
    take = read_usd(tmp_path / "o.usda").collect()
    assert (take.clock.step, take.clock.count) == (Fraction(1, 2), 5)
    assert take.motion.weights is not None
    assert take.motion.weights.dense()[1, 0, 0] == 0.5


@pytest.mark.parametrize(
    ("code", "value"), [("USD206", [0.5]), ("USD202", [np.nan, 0.0])]
)
def test_wrong_weights_are_refused(
    tmp_path: Path, code: str, value: list[float]
) -> None:
    write(job(tmp_path / "o.usda"), motion(moving()))
    stage = open_stage(tmp_path / "o.usda")
    attr = stage.GetPrimAtPath("/hero/Rig/Anim").GetAttribute("blendShapeWeights")
    attr.Set(Vt.FloatArray(value), 2)
    stage.Save()
    with pytest.raises(FormatError) as caught:
        read_usd(tmp_path / "o.usda")
    assert caught.value.code == code


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    """Return a rig with a mesh that has two of the shapes."""
    path = tmp_path / "rig.usda"
    write(job(path), motion(None))
    stage = open_stage(path)
    mesh = UsdGeom.Mesh.Define(stage, "/hero/Rig/Face")
    mesh.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
    mesh.CreateFaceVertexCountsAttr([3])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2])
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateJointIndicesPrimvar(True, 1).Set([0])
    binding.CreateJointWeightsPrimvar(True, 1).Set([1.0])
    targets = []
    for name in ("blink", "smile"):
        shape = UsdSkel.BlendShape.Define(stage, f"/hero/Rig/Face/{name}")
        shape.CreateOffsetsAttr([Gf.Vec3f(0, 0, 1)] * 3)
        targets.append(shape.GetPath())
    binding.CreateBlendShapesAttr(["blink", "smile"])
    binding.CreateBlendShapeTargetsRel().SetTargets(targets)
    stage.RemovePrim("/hero/Rig/Anim")
    stage.Save()
    return path


@pytest.mark.parametrize("prim_path", [None, "/World/cast/hero"])
def test_a_layer_moves_the_shapes_of_its_rig(
    tmp_path: Path, rig_file: Path, prim_path: str | None
) -> None:
    target = open_target(rig_file, prim_path)
    taken = map_joints(RIG, target, 0).map_motion(motion(moving()))
    assert taken.weights is not None
    over = job(
        tmp_path / "over.usda",
        form=LayerForm.LAYER,
        joints=target.skeleton.tokens,
        paths=target.paths,
        target=target,
    )
    write(over, taken)
    shot = Usd.Stage.CreateInMemory()
    shot.SetTimeCodesPerSecond(24)
    if prim_path is None:
        shot.GetRootLayer().subLayerPaths = [str(over.output), str(rig_file)]
    else:
        shot.GetRootLayer().subLayerPaths = [str(over.output)]
        shot.DefinePrim(prim_path).GetReferences().AddReference(str(rig_file))
    row = moving().astype(np.float32)[4]
    assert computed(shot, 5) == {"blink": row[1], "jaw": row[3]}
    errors = validation_errors(shot)
    assert [e for e in errors if "StageMetadataChecker" not in e] == []
    mesh = next(p for p in shot.Traverse() if p.IsA(UsdGeom.Mesh))
    root = UsdSkel.Root.Find(mesh)
    assert UsdSkel.BakeSkinning(root, Gf.Interval(5, 5))
    points = np.array(UsdGeom.Mesh(mesh).GetPointsAttr().Get(5))
    assert points[0, 2] == pytest.approx(row[1])
    names, (fault,) = match_shapes(target, ["blink", "jaw"])
    assert names == ("blink", "jaw")
    assert fault.code == "USD114"
    assert "jaw" in fault.message
    assert "blink" not in fault.message


def test_a_rig_without_meshes_lacks_no_shape(tmp_path: Path) -> None:
    write(job(tmp_path / "rig.usda", show_bones=True), motion(None))
    target = open_target(tmp_path / "rig.usda", None)
    assert match_shapes(target, SHAPES) == (tuple(SHAPES), [])


def test_shapes_of_arkit_are_found_however_they_are_spelled(tmp_path: Path) -> None:
    rig = shaped_rig()
    names = ("eyeBlink_L", "JawOpen", "both")
    shapes = (*(replace(s, name=n) for s, n in zip(rig.shapes, names, strict=False)),)
    body = replace(rig, shapes=(*shapes[:2], replace(shapes[2], combine=())))
    write_rig_layer(body, tmp_path / "rig.usda")
    target = open_target(tmp_path / "rig.usda", None)
    wanted = ["eyeBlinkLeft", "jaw_open", "both", "jawOpen", "grin"]
    found, notices = match_shapes(target, wanted)
    assert found == ("eyeBlink_L", "JawOpen", "both", "jawOpen", "grin")
    assert [notice.code for notice in notices] == ["USD114", "USD118"]
    assert "grin" in notices[0].message
    assert "eyeBlinkLeft as eyeBlink_L" in notices[1].message


def test_controls_pass_through_the_map(rig_file: Path) -> None:
    controls = Channel.from_dense(np.ones((7, 1, 1)))
    taken = replace(motion(moving()), controls=controls)
    assert map_joints(RIG, open_target(rig_file, None), 0).map_motion(
        taken
    ).controls is (controls)
