"""glTF files as rigs and streams: character, clip, unit, rate, and numbers."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.cli import animtool
from support.faults import raises
from support.gltf import (
    Maker,
    as_glb,
    chain,
    skinned,
    small_gltf,
    turned,
    write_small,
)

from animtool.core.errors import FormatError
from animtool.core.units import LengthUnit, UpAxis
from animtool.edit.resample import resampled
from animtool.formats.gltf.document import open_gltf
from animtool.formats.gltf.read import read_gltf, read_gltf_rig
from animtool.retarget.anatomy import find_anatomy
from animtool.rig.kinematics import rest_world
from animtool.scene.sources.onto_rig import open_rig
from animtool.scene.sources.open import SourceOptions, open_source


@pytest.fixture
def plain(tmp_path: Path) -> Path:
    return write_small(tmp_path / "hero.glb")


def codes(stream_or_rig: object) -> set[str]:
    return {notice.code for notice in stream_or_rig.notices}  # type: ignore[attr-defined]


@pytest.mark.parametrize("suffix", [".glb", ".gltf", ".vrm"])
def test_a_character_with_a_skin_and_shapes(tmp_path: Path, suffix: str) -> None:
    path = write_small(tmp_path / f"hero{suffix}")
    take = read_gltf(path).collect()
    assert take.rig.names == ["hips", "chest", "head"]
    assert [shape.name for shape in take.rig.shapes] == ["a", "b"]
    (mesh,) = take.rig.meshes
    assert mesh.name == "body"
    assert mesh.skin is not None
    assert mesh.skin.joints == ("hips", "chest", "head")
    # Keys at 0, 0.5 and 1 s are on frames at 24 a second; time 0 is frame 0.
    assert (take.fps, take.clock.start, take.clock.count) == (24, 0, 25)
    ends = take.motion.translations.dense()[[0, 12, 24], 0]
    np.testing.assert_allclose(ends, np.eye(3), atol=1e-6)
    halfway = take.motion.rotations.dense()[6, 1]
    np.testing.assert_allclose(halfway, turned(2, 25)[0], atol=1e-6)
    assert take.motion.weights is not None
    weights = take.motion.weights.dense()[[0, 12, 24], :, 0]
    np.testing.assert_allclose(weights, [[0, 0], [1, 0.5], [0, 0]], atol=1e-6)
    assert take.motion.scales is not None
    # A step holds until the next key.
    assert take.motion.scales.dense()[[11, 12, 23, 24], 2, 0].tolist() == [1, 2, 2, 1]


def test_the_clip_is_chosen(plain: Path) -> None:
    assert codes(read_gltf(plain)) >= {"GLT121"}
    stream = read_gltf(plain, take="nod")
    assert stream.details["take"] == "nod"
    assert stream.details["takes"] == ["wave", "nod"]
    assert stream.collect().motion.rotations.animated.tolist() == [2]
    with raises(FormatError, "GLT015", match="wave"):
        read_gltf(plain, take="wav")


def test_a_clip_that_starts_late_is_named(tmp_path: Path) -> None:
    for first, expected in ((0.5, set()), (40.0, {"GLT122"})):
        gltf, times = Maker(), first + np.array([0.0, 0.5, 1.0])
        joints = chain(gltf, ["hips", "chest"])
        rows = turned(2, 0, 50, 10)
        gltf.animation("nod", (joints[1], "rotation", "LINEAR", times, rows))
        gltf.json["scenes"] = [{"nodes": joints[:1]}]
        path = tmp_path / f"{first:g}.glb"
        path.write_bytes(as_glb(*gltf.done()))
        stream = read_gltf(path)
        assert codes(stream) & {"GLT122"} == expected
        assert stream.collect().clock.count == int((first + 1.0) * 24) + 1


def test_the_rate_of_even_keys_off_frames_is_named(tmp_path: Path) -> None:
    gltf = Maker()
    (joint,) = chain(gltf, ["arm"])
    times, rows = np.arange(10.0, 14.0) / 24.024, turned(2, 0, 10, 20, 60)
    gltf.animation("wave", (joint, "rotation", "LINEAR", times, rows))
    gltf.json["scenes"] = [{"nodes": [joint]}]
    path = tmp_path / "odd.glb"
    path.write_bytes(as_glb(*gltf.done()))
    stream = read_gltf(path)
    (notice,) = [n for n in stream.notices if n.code == "GLT110"]
    assert "24.024" in str(notice.hint)
    assert "GLT110" not in codes(read_gltf(path, fps="24.024"))


def test_a_clip_of_a_control_alone_is_not_the_default(tmp_path: Path) -> None:
    gltf, times = Maker(), np.array([0.0, 0.5, 1.0])
    joints = chain(gltf, [f"bone_{k}" for k in range(7)])
    gltf.animation("place", (joints[0], "translation", "LINEAR", times, np.eye(3)))
    rotations = turned(2, 0, 50, 10)
    gltf.animation(
        "run", *((j, "rotation", "LINEAR", times, rotations) for j in joints)
    )
    gltf.json["scenes"] = [{"nodes": joints[:1]}]
    path = tmp_path / "snake.glb"
    path.write_bytes(as_glb(*gltf.done()))
    assert read_gltf(path).details["take"] == "run"
    assert read_gltf(path, take="place").details["take"] == "place"


def test_the_character_is_chosen(tmp_path: Path) -> None:
    path = write_small(tmp_path / "two.glb", "skins")
    # The whole scene's first one, and its own clip.
    assert read_gltf(path).rig.names == ["hips", "chest", "head"]
    assert "GLT109" in codes(read_gltf(path))
    other = read_gltf(path, prim_path="tail")
    assert other.rig.names == ["hips", "tail"]
    assert other.details["take"] == "wag"
    whole = read_gltf(path, prim_path="/")
    assert whole.rig.names == ["hips", "chest", "head", "hips_2", "tail"]
    assert "GLT113" in codes(whole)
    for unknown, hint in (
        ("/zzz", "allowed: /"),
        ("/World/hips_2", "did you mean '/hips_2'?"),
        ("/World/tail", "did you mean 'tail'?"),
    ):
        with raises(FormatError, "GLT014") as caught:
            read_gltf(path, prim_path=unknown)
        (fault,) = caught.value.faults
        assert f'prim_path="{unknown}"' in fault.message
        assert hint in (fault.hint or "")
    rig, _ = open_rig(path, "/hips_2")
    assert rig.names == ["hips", "tail"]


def test_unit_up_and_rate_are_told(plain: Path) -> None:
    options = SourceOptions(unit=LengthUnit.CM, up=UpAxis.Z, fps=48)
    take = open_source(plain, options).collect()
    assert take.rig.meters_per_unit == 0.01
    assert take.rig.up is UpAxis.Z
    assert (take.fps, take.clock.count) == (48, 49)
    assert take.rig.rest_translations[1].tolist() == [0.0, 0.01, 0.0]


def test_keys_between_frames_are_read_at_any_time(tmp_path: Path) -> None:
    made = Maker()
    (node,) = chain(made, ["box"])
    times, values = [0.0, 0.3137, 1.0], [[0, 0, 0], [0, 0, 1], [0, 0, 0]]
    made.animation("hop", (node, "translation", "LINEAR", times, values))
    path = tmp_path / "box.glb"
    path.write_bytes(as_glb(*made.done()))
    stream = read_gltf(path)
    assert "GLT110" in codes(stream)
    assert stream.fps == 30
    assert stream.curve is not None
    peak = stream.curve(np.array([0.3137 * 30]))
    np.testing.assert_allclose(peak.translations.dense()[0, 0, 2], 1.0, atol=1e-6)
    take = resampled(stream.collect(), Fraction(1000))
    assert take.motion.translations.dense()[:, 0, 2].max() > 0.999


def test_even_scales_go_into_lengths(tmp_path: Path) -> None:
    made = Maker()
    first, second = chain(made, ["armature", "hips"])
    made.json["nodes"][first]["scale"] = [0.01, 0.01, 0.01]
    made.json["nodes"][second]["translation"] = [0, 95, 0]
    times = [0.0, 1.0]
    values = [[0, 95, 0], [0, 90, 0]]
    made.animation("sit", (second, "translation", "LINEAR", times, values))
    path = tmp_path / "cm.glb"
    path.write_bytes(as_glb(*made.done()))
    take = read_gltf(path).collect()
    assert take.motion.scales is None
    np.testing.assert_allclose(rest_world(take.rig).positions[0, 1], [0, 0.95, 0])
    np.testing.assert_allclose(take.world().positions[-1, 1], [0, 0.9, 0])
    assert "GLT111" not in codes(read_gltf_rig(path))


def test_uneven_scales_stay_in_the_take(tmp_path: Path) -> None:
    made = Maker()
    first, _ = chain(made, ["a", "b"])
    made.json["nodes"][first]["scale"] = [1, 3, 1]
    path = tmp_path / "uneven.glb"
    path.write_bytes(as_glb(*made.done()))
    take = read_gltf(path).collect()
    np.testing.assert_allclose(take.world().positions[0, 1], [0, 3, 0])
    assert "GLT116" in codes(read_gltf(path))
    assert "GLT111" in codes(read_gltf_rig(path))


@pytest.mark.parametrize(
    ("uri", "code"),
    [
        ("../other.bin", "GLT007"),
        ("/etc/passwd", "GLT007"),
        ("%2e%2e/other.bin", "GLT007"),
        ("http://localhost/other.bin", "GLT007"),
        ("file:///etc/passwd", "GLT007"),
        ("missing.bin", "GLT007"),
        ("sub/link.bin", "GLT007"),
    ],
)
def test_no_file_outside_of_the_folder_is_opened(
    tmp_path: Path, uri: str, code: str
) -> None:
    folder = tmp_path / "in"
    (folder / "sub").mkdir(parents=True)
    document, binary = small_gltf()
    (tmp_path / "other.bin").write_bytes(binary)
    (folder / "sub/link.bin").symlink_to(tmp_path / "other.bin")
    document["buffers"][0]["uri"] = uri
    path = folder / "hero.gltf"
    path.write_text(json.dumps(document))
    with raises(FormatError, code) as caught:
        open_gltf(path)
    assert caught.value.faults[0].where == "/buffers/0/uri"


def test_a_file_in_the_same_folder_is_opened(tmp_path: Path) -> None:
    document, binary = small_gltf()
    document["buffers"][0]["uri"] = "my%20numbers.bin"
    (tmp_path / "my numbers.bin").write_bytes(binary)
    path = tmp_path / "hero.gltf"
    path.write_text(json.dumps(document))
    assert len(read_gltf(path).collect()) == 25


@pytest.mark.parametrize(
    "extension", ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "X_any"]
)
def test_an_extension_that_is_needed_is_named(tmp_path: Path, extension: str) -> None:
    document, binary = small_gltf()
    document["extensionsRequired"] = document["extensionsUsed"] = [extension]
    path = tmp_path / "packed.glb"
    path.write_bytes(as_glb(document, binary))
    with raises(FormatError, "GLT004", match=extension) as caught:
        open_gltf(path)
    hint = caught.value.faults[0].hint or ""
    assert ("packed.glb" in hint) == (extension != "X_any")


def test_numbers_that_no_bytes_stand_for_are_not_made(tmp_path: Path) -> None:
    document, binary = small_gltf()
    sampler = document["animations"][0]["samplers"][0]
    entry = document["accessors"][sampler["input"]]
    del entry["bufferView"]
    entry["count"] = 2_000_000_000
    path = tmp_path / "huge.glb"
    path.write_bytes(as_glb(document, binary))
    with raises(FormatError, "GLT013"):
        open_gltf(path)


def test_a_clip_of_very_many_frames_is_refused(tmp_path: Path) -> None:
    made = Maker()
    (node,) = chain(made, ["box"])
    values = [[0, 0, 0], [0, 0, 1]]
    made.animation("long", (node, "translation", "LINEAR", [0.0, 1e9], values))
    path = tmp_path / "long.glb"
    path.write_bytes(as_glb(*made.done()))
    with raises(FormatError, "GLT013"):
        read_gltf(path)
    assert len(read_gltf(path, fps="0.001").collect()) == 1_000_001


def test_what_a_file_holds_is_listed(tmp_path: Path, plain: Path) -> None:
    done = animtool("info", plain, "--format", "json")
    (found,) = json.loads(done.stdout)["files"]
    assert found["contents"]["nodes"] == 4
    assert [clip["name"] for clip in found["contents"]["clips"]] == ["wave", "nod"]
    empty = tmp_path / "empty.gltf"
    empty.write_text('{"asset": {"version": "2.0"}}')
    done = animtool("info", empty, "--format", "json")
    assert done.code == 0
    (found,) = json.loads(done.stdout)["files"]
    assert found["contents"]["nodes"] == 0


def test_rules_look_at_every_clip(plain: Path) -> None:
    done = animtool("validate", plain, "--format", "json")
    assert done.code == 0
    path = write_small(plain.with_name("still.glb"))
    document, binary = small_gltf()
    sampler = document["animations"][1]["samplers"][0]
    first = document["animations"][0]["samplers"][1]
    rows = turned(0, 0, 0, 0).astype("<f4").tobytes()
    view = document["bufferViews"][
        document["accessors"][sampler["output"]]["bufferView"]
    ]
    at = view["byteOffset"]
    del first
    path.write_bytes(as_glb(document, binary[:at] + rows + binary[at + len(rows) :]))
    done = animtool("validate", path)
    assert "MOT201 /animations/1" in done.stdout


def _first_weights(document: dict[str, Any]) -> dict[str, Any]:
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    return document["accessors"][attributes["WEIGHTS_0"]]


def _undeclared(document: dict[str, Any]) -> None:
    document["nodes"][0]["extensions"] = {"X_own": {}}


def _not_second(document: dict[str, Any]) -> None:
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    attributes["WEIGHTS_0"] = attributes["JOINTS_0"]


def _stride(document: dict[str, Any]) -> None:
    output = document["animations"][0]["samplers"][0]["output"]
    view = document["accessors"][output]["bufferView"]
    document["bufferViews"][view]["byteStride"] = 12


@pytest.mark.parametrize(
    ("change", "code", "where"),
    [
        (_undeclared, "GLT106", "/nodes/0/extensions/X_own"),
        (
            lambda d: d.update(extensionsUsed=["KHR_mesh_quantization"]),
            "GLT106",
            "/extensionsUsed/0",
        ),
        (
            lambda d: d.update(extensionsRequired=["KHR_materials_unlit"]),
            "GLT106",
            "/extensionsRequired/0",
        ),
        (lambda d: d["nodes"][0].update(name=None), "GLT106", "/nodes/0/name"),
        (
            lambda d: d["scenes"][0]["nodes"].append(0),
            "GLT106",
            "/scenes/0/nodes/2",
        ),
        (lambda d: d.update(scenes=[{"nodes": [3]}]), "GLT106", "/nodes/3"),
        (
            lambda d: d["meshes"][0]["primitives"][0]["targets"][1].clear(),
            "GLT106",
            "/meshes/0/primitives/0/targets/1",
        ),
        (
            lambda d: d["meshes"][0]["primitives"][0].update(mode=7),
            "GLT106",
            "/meshes/0/primitives/0/mode",
        ),
        (
            _not_second,
            "GLT104",
            "/meshes/0/primitives/0/attributes/WEIGHTS_0",
        ),
        (_stride, "GLT105", "/animations/0/samplers/0/output"),
        (lambda d: d["accessors"][0].update(min=[0]), "GLT102", "/accessors/0/min"),
    ],
)
def test_what_is_harmless_is_put_right_and_said(
    tmp_path: Path, change: Callable[[dict[str, Any]], object], code: str, where: str
) -> None:
    document, binary = small_gltf()
    change(document)
    path = tmp_path / "odd.glb"
    path.write_bytes(as_glb(document, binary))
    faults = open_gltf(path).diagnostics.notices
    assert (code, where) in {(fault.code, fault.where) for fault in faults}


def test_a_chunk_header_that_ends_with_the_file_is_placed_there(tmp_path: Path) -> None:
    content = as_glb(*small_gltf()) + bytes(4)
    path = tmp_path / "cut.glb"
    path.write_bytes(content[:8] + len(content).to_bytes(4, "little") + content[12:])
    with raises(FormatError, "GLT002") as caught:
        open_gltf(path)
    assert caught.value.faults[0].where == f"byte {len(content)}"


def test_what_is_not_read_is_named_once(tmp_path: Path) -> None:
    document, binary = small_gltf()
    instances = {"attributes": {"TRANSLATION": 0}}
    document["nodes"][3]["extensions"] = {
        "EXT_mesh_gpu_instancing": instances,
        "KHR_node_visibility": {"visible": False},
    }
    document["extensionsUsed"] = ["EXT_mesh_gpu_instancing", "KHR_node_visibility"]
    path = tmp_path / "forest.glb"
    path.write_bytes(as_glb(document, binary))
    (note,) = [n for n in read_gltf(path).notices if n.code == "GLT108"]
    assert "EXT_mesh_gpu_instancing" in note.message
    assert "'body'" in note.message or "body" in note.message


def test_keys_off_the_frame_late_keys_and_idle_joints_are_found(
    tmp_path: Path, plain: Path
) -> None:
    made = Maker()
    joints = chain(made, ["hips", "chest", "head", "helper"])
    skinned(made, joints[:3], "body")
    made.json["skins"][0]["joints"].append(joints[3])
    inverse = np.tile(np.eye(4), (4, 1, 1))
    inverse[:3, 3, 1] = -9.0 * np.arange(3)
    inverse[3, 3, 1] = -3.0
    matrices = made.accessor(inverse.reshape(-1, 16))
    made.json["skins"][0]["inverseBindMatrices"] = matrices
    times = (60 + np.arange(40.0)) / 24
    times[7] += 0.01
    turns = turned(2, *np.linspace(0, 60, 40))
    made.animation("late", (joints[1], "rotation", "LINEAR", times, turns))
    made.json["animations"][0]["extras"] = {"animtool": {"fps": "24"}}
    made.json["scenes"], made.json["scene"] = [{"nodes": [joints[0], 4]}], 0
    path = tmp_path / "late.glb"
    path.write_bytes(as_glb(*made.done()))
    found = animtool("validate", path).stdout
    for code in ("MOT216", "MOT217", "MOT220", "MOT221"):
        assert f"{code} /animations/0" in found
    assert "helper" in found
    assert "MOT2" not in animtool("validate", plain).stdout


def test_one_of_several_characters_is_shown_and_compared(tmp_path: Path) -> None:
    path = write_small(tmp_path / "two.glb", "skins")
    page = tmp_path / "page.html"
    done = animtool("preview", path, "--source-prim", "/hips_2", "-o", page)
    assert done.code == 0
    assert "GLT109" not in done.stderr
    done = animtool(
        "diff", path, path, "--source-prim-a", "/hips_2", "--source-prim-b", "/hips"
    )
    assert done.code == 1


def test_humanoid_bones_say_which_joint_is_which(tmp_path: Path) -> None:
    bones = ["hips", "spine", "chest", "upperChest", "neck", "head", "jaw"]
    made = Maker()
    nodes = chain(made, [f"bone_{k}" for k in range(len(bones))])
    entries = {bone: {"node": node} for bone, node in zip(bones, nodes, strict=True)}
    made.json["extensionsUsed"] = ["VRMC_vrm"]
    made.json["extensions"] = {
        "VRMC_vrm": {"specVersion": "1.0", "humanoid": {"humanBones": entries}}
    }
    path = tmp_path / "hero.vrm"
    path.write_bytes(as_glb(*made.done()))
    rig = read_gltf_rig(path)
    assert [joint.humanoid for joint in rig.joints] == bones
    found = find_anatomy(rig)
    assert found.preset == "vrm1"
    assert [found.roles[k] for k in (0, 4, 5)] == ["hips", "neck", "head"]


def test_json_edited_by_hand_is_repaired_at_its_line(tmp_path: Path) -> None:
    path = tmp_path / "a.gltf"
    path.write_text('{\n  "asset": {"version": "2.0",\n  }\n}\n')
    with pytest.raises(FormatError) as caught:
        read_gltf(path)
    (fault,) = caught.value.faults
    assert (fault.code, fault.lines, fault.column) == ("GLT001", (2,), 29)
    assert fault.hint == "remove the comma"


def test_json_of_a_glb_is_exported_again(tmp_path: Path) -> None:
    chunk = b'{"asset": {},} '.ljust(16)
    header = struct.pack("<4sIIII", b"glTF", 2, 20 + len(chunk), len(chunk), 0x4E4F534A)
    path = tmp_path / "a.glb"
    path.write_bytes(header + chunk)
    with pytest.raises(FormatError) as caught:
        read_gltf(path)
    (fault,) = caught.value.faults
    assert (fault.code, fault.lines) == ("GLT001", ())
    assert "line 1, column 13" in fault.message
