"""Characters without joints, shapes without offsets, animations without values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom
from support.cli import animtool
from support.shapes_alone import NORMALS_ONLY, write_face, write_still

from animtool import describe, open_source
from animtool.core.errors import FormatError, OptionError
from animtool.rig.skeleton import Rig
from animtool.scene.convert.takes import convert
from animtool.validation.run import validate

WEIGHTS = [[0, 0], [0.5, 0.25], [1.25, 0.75]]


def weights(path: Path) -> np.ndarray:
    found = open_source(path).collect()
    assert not found.rig.joints
    assert [shape.name for shape in found.rig.shapes] == ["smile", "crease"]
    assert found.motion.weights is not None
    return found.motion.weights.dense()[..., 0]


def test_a_skeleton_without_joints_is_read(tmp_path: Path) -> None:
    face = write_face(tmp_path)
    np.testing.assert_allclose(weights(face), WEIGHTS)
    found = describe(face)
    assert (found.joints, found.frames, found.shapes) == (0, 3, 2)
    assert found.moving_shapes == ["smile", "crease"]
    assert "blend shapes alone" in animtool("info", face).stdout
    assert validate(face) == []


def test_a_take_without_meshes_is_asked_for_none(tmp_path: Path) -> None:
    out = tmp_path / "out.usda"
    assert animtool("bake", write_face(tmp_path), "-o", out).code == 0
    assert validate(out) == []


def test_its_rig_goes_to_a_file_and_back(tmp_path: Path) -> None:
    face, out = write_face(tmp_path), tmp_path / "out.rig.yaml"
    assert animtool("convert", face, out).code == 0
    assert validate(out) == []
    assert animtool("convert", out, tmp_path / "back.usda").code == 0
    rigs = [Rig.load(path) for path in (face, out, tmp_path / "back.usda")]
    for rig in rigs:
        assert not rig.joints
        for shape, mine in zip(rig.shapes, rigs[0].shapes, strict=True):
            assert shape.deltas is not None
            assert mine.deltas is not None
            np.testing.assert_array_equal(shape.deltas.load(), mine.deltas.load())


def test_what_needs_joints_says_so(tmp_path: Path) -> None:
    face = write_face(tmp_path)
    with pytest.raises(OptionError) as caught:
        convert(face, tmp_path / "face.bvh")
    assert caught.value.code == "RIG044"
    done = animtool(
        "bake", face, "--root-motion", "skelroot", "-o", tmp_path / "o.usda"
    )
    assert done.code == 2
    assert "CLI002" in done.stderr
    assert not (tmp_path / "o.usda").exists()


def test_neither_joints_nor_shapes_is_nothing_to_read(tmp_path: Path) -> None:
    face = write_face(tmp_path)
    layer = Sdf.Layer.FindOrOpen(str(face))
    mesh = layer.GetPrimAtPath("/Face/Head")
    for name in ("skel:blendShapes", "skel:blendShapeTargets"):
        mesh.RemoveProperty(mesh.properties[name])
    skeleton = layer.GetPrimAtPath("/Face/Skel")
    skeleton.RemoveProperty(skeleton.properties["skel:animationSource"])
    layer.Save()
    for read in (open_source, Rig.load):
        with pytest.raises(FormatError) as caught:
            read(face)
        assert caught.value.code == "USD002"


def test_shapes_over_a_rig_without_them_are_refused(tmp_path: Path) -> None:
    face, still = write_face(tmp_path), write_still(tmp_path)
    for source, rig in ((face, still), (still, face)):
        output = tmp_path / "layer.usda"
        done = animtool("bake", source, "--rig-layer", rig, "-o", output)
        assert done.code == 3
        assert "USD010" in done.stderr
        assert not output.exists()


def test_bounds_hold_every_frame(tmp_path: Path) -> None:
    face, output = write_face(tmp_path), tmp_path / "whole.usda"
    assert animtool("bake", face, "--rig", face, "-o", output).code == 0
    assert validate(output) == []
    stage = Usd.Stage.Open(str(output))
    roots = [prim for prim in stage.Traverse() if prim.GetTypeName() == "SkelRoot"]
    low, high = np.array(UsdGeom.Boundable(roots[0]).GetExtentAttr().Get())
    # The largest weight raises a corner from 2 to 2 + 1.25 * 0.5.
    assert (low <= [-1, 0, 0]).all()
    assert (high >= [1, 2.625, 0]).all()
    assert np.abs([low, high]).max() < 10


def test_shapes_may_turn_normals_alone(tmp_path: Path) -> None:
    shape = Rig.load(write_face(tmp_path)).shapes[1]
    assert shape.name == NORMALS_ONLY
    assert shape.deltas is not None
    assert shape.normals is not None
    np.testing.assert_array_equal(shape.deltas.load(), np.zeros((2, 3)))
    np.testing.assert_array_equal(shape.normals.load(), [[0.5, 0, 0], [-0.5, 0, 0]])


HALF = """uniform vector3f[] inbetweens:half{values} ( weight = 0.5 )
    uniform vector3f[] inbetweens:half:normalOffsets = [(0.2, 0, 0), (0, 0.1, 0)]
"""


@pytest.mark.parametrize("values", ["", " = []"], ids=["none", "empty"])
@pytest.mark.parametrize("full", [True, False], ids=["full", "inbetween"])
def test_inbetweens_may_turn_normals_alone(
    values: str, full: bool, tmp_path: Path
) -> None:
    face = write_face(tmp_path)
    text = face.read_text("utf-8")
    turned = "uniform vector3f[] normalOffsets = [(0.5, 0, 0), (-0.5, 0, 0)]\n"
    assert turned in text
    half = HALF.format(values=values)
    face.write_text(text.replace(turned, turned * full + half), "utf-8")
    assert validate(face) == []
    shape = Rig.load(face).shapes[1]
    assert (shape.normals is not None) is full
    (step,) = shape.inbetweens
    np.testing.assert_array_equal(step.deltas.load(), np.zeros((2, 3)))
    assert step.normals is not None
    output = tmp_path / "out.usda"
    assert animtool("bake", face, "--rig", face, "-o", output).code == 0
    assert validate(output) == []
    cache = tmp_path / "cache.usda"
    assert animtool("bake", face, "--deform", "-o", cache).code == 0
    stage = Usd.Stage.Open(str(cache))
    mesh = next(prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh))
    normals = np.array(UsdGeom.Mesh(mesh).GetNormalsAttr().Get(2))
    # Half way to the inbetween, at a quarter.
    expected = np.array([0.1, 0, 1]) / np.linalg.norm([0.1, 0, 1])
    np.testing.assert_allclose(normals[0], expected, atol=1e-6)


def test_shapes_of_a_rig_file_may_turn_normals_alone(tmp_path: Path) -> None:
    points = [[-1.0, 0, 0], [1, 0, 0], [1, 2, 0], [-1, 2, 0]]
    np.savez(
        tmp_path / "h.npz",
        points=points,
        faces=[[0, 1, 2, 3]],
        normals=np.tile([0.0, 0, 1], (4, 1)),
        crease=[[0.5, 0, 0], [-0.5, 0, 0]],
        at=[0, 1],
    )
    rig, clip = tmp_path / "h.rig.yaml", tmp_path / "h.clip.yaml"
    rig.write_text(
        "rig: animtool/1\nname: head\njoints: [{name: root, type: free}]\n"
        "meshes: [{name: head, points: h.npz, faces: h.npz, normals: h.npz}]\n"
        "shapes: [{name: crease, mesh: head, normals: h.npz#crease,"
        " vertices: h.npz#at}]\n"
    )
    clip.write_text(
        "clip: animtool/1\nrig: h.rig.yaml\nfps: 24\nrange: [1, 3]\nchannels:\n"
        "- {target: shape/crease, keys: [{t: 1, v: 0}, {t: 3, v: 1}]}\n"
    )
    assert validate(rig) == []
    output, cache = tmp_path / "out.usda", tmp_path / "cache.usda"
    assert animtool("bake", clip, "-o", output).code == 0
    assert validate(output) == []
    assert animtool("bake", clip, "--deform", "-o", cache).code == 0
    stage = Usd.Stage.Open(str(cache))
    mesh = next(prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh))
    normals = np.array(UsdGeom.Mesh(mesh).GetNormalsAttr().Get(3))
    expected = np.array([0.5, 0, 1]) / np.linalg.norm([0.5, 0, 1])
    np.testing.assert_allclose(normals[0], expected, atol=1e-6)
    np.testing.assert_allclose(normals[2], [0, 0, 1], atol=1e-6)


def test_a_shape_without_any_offsets_stays_an_error(tmp_path: Path) -> None:
    face = write_face(tmp_path)
    layer = Sdf.Layer.FindOrOpen(str(face))
    shape = layer.GetPrimAtPath("/Face/Head/crease")
    shape.RemoveProperty(shape.properties["normalOffsets"])
    layer.Save()
    assert "USD240" in [fault.code for fault in validate(face)]
    with pytest.raises(FormatError) as caught:
        Rig.load(face)
    assert caught.value.code == "USD240"


def test_an_animation_that_only_names_joints_is_at_rest(tmp_path: Path) -> None:
    still = write_still(tmp_path)
    stream = open_source(still)
    assert [notice.code for notice in stream.notices] == ["USD150"]
    take = stream.collect()
    assert take.clock.count == 5
    np.testing.assert_allclose(take.world().positions[:, 1], [[0, 0.02, 0]] * 5)
    assert [fault.code for fault in validate(still)] == ["USD150"]
    skin = Rig.load(still).meshes[0].skin
    assert skin is not None
    assert skin.method == "dual_quaternion"
    done = animtool("bake", still, "--rig", still, "-o", tmp_path / "out.usda")
    assert done.code == 0, done.stderr
    assert validate(tmp_path / "out.usda") == []


def test_one_of_three_missing_stays_an_error(tmp_path: Path) -> None:
    still = write_still(tmp_path)
    text = still.read_text("utf-8").replace(
        'def SkelAnimation "Animation"\n    {',
        'def SkelAnimation "Animation"\n    {\n'
        "        float3[] translations = [(0, 0, 0), (0, 2, 0)]",
    )
    still.write_text(text, "utf-8")
    with pytest.raises(FormatError) as caught:
        open_source(still)
    assert caught.value.code == "USD201"


def test_a_mesh_whose_faces_are_sampled_is_read(tmp_path: Path) -> None:
    face = write_face(tmp_path)
    text = face.read_text("utf-8").replace(
        "faceVertexCounts = [4]", "faceVertexCounts.timeSamples = {1: [4]}"
    )
    face.write_text(text, "utf-8")
    assert len(Rig.load(face).meshes[0].faces.load()) == 1
