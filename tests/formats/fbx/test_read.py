"""A small FBX, binary and ASCII: what it reads as, and how broken ones are refused."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.fbx import (
    MAGIC,
    TICKS,
    Tree,
    array,
    as_binary,
    as_text,
    small_5000,
    small_6100,
    small_fbx,
    with_pose_take,
)

from animtool.core.errors import FormatError, OptionError, Severity
from animtool.core.readers import EXPORT_HINTS, find_reader
from animtool.core.units import LengthUnit, UpAxis
from animtool.core.writers import take_writer
from animtool.formats.fbx.poses import NodeTransforms
from animtool.formats.fbx.read import read_fbx, read_fbx_rig, take_names
from animtool.formats.fbx.scene import open_fbx
from animtool.maths import so3

FORMS: list[Callable[[list[Tree]], bytes]] = [
    as_text,
    as_binary,
    lambda trees: as_binary(trees, 7500),
    lambda trees: as_binary(trees, 7700, inflated=True),
]


def written(folder: Path, content: bytes) -> Path:
    """Write a file."""
    path = folder / "arm.fbx"
    path.write_bytes(content)
    return path


def part(trees: list[Tree], name: str, own: int | None = None) -> list[Any]:
    """Return what is below an element, of objects by number."""
    (found,) = [
        tree
        for top in trees
        for tree in (top, *top[2])
        if tree[0] == name and (own is None or tree[1][0] == own)
    ]
    return found[2]


def put(below: list[Any], name: str, *values: Any) -> None:
    """Replace the values of an element."""
    (at,) = [i for i, tree in enumerate(below) if tree[0] == name]
    below[at] = (name, list(values), below[at][2])


def code_of(folder: Path, content: bytes) -> tuple[str, str]:
    """Return code and place of the fault that a file is refused with."""
    with pytest.raises(FormatError) as caught:
        read_fbx(written(folder, content)).collect()
    (fault,) = caught.value.faults
    return fault.code, fault.where or ""


@pytest.mark.parametrize("form", FORMS)
def test_the_arm_bends_as_its_layers_say(
    tmp_path: Path, form: Callable[[list[Tree]], bytes]
) -> None:
    stream = read_fbx(written(tmp_path, form(small_fbx())))
    assert list(stream.rig.names) == ["arm", "fore"]
    assert (stream.fps, stream.start) == (Fraction(24), Fraction(0))
    take = stream.collect()
    assert take.motion.frames == 25
    assert take.rig.joints[1].translation == (0.0, 0.1, 0.0)
    angles = so3.angle_between(
        take.motion.rotations.dense()[:, 1], np.array([0, 0, 0, 1.0])
    )
    expected = np.radians(10.0 + 90.0 * np.arange(25) / 24)
    np.testing.assert_allclose(angles, expected, atol=1e-6)
    assert take.motion.weights is not None
    np.testing.assert_allclose(take.motion.weights.rest, 0.25)


def test_a_take_that_moves_nothing_is_not_the_default(tmp_path: Path) -> None:
    path = written(tmp_path, as_binary(with_pose_take(small_fbx())))
    stream = read_fbx(path)
    assert stream.details["takes"] == ["pose", "bend"]
    assert stream.details["take"] == "bend"
    assert "FBX122" in {notice.code for notice in stream.notices}
    assert read_fbx(path, take="pose").details["take"] == "pose"


@pytest.mark.parametrize("form", [as_text, as_binary])
@pytest.mark.parametrize("old", [small_6100, small_5000])
def test_old_layouts_read_as_the_new_one(
    tmp_path: Path,
    old: Callable[[], list[Tree]],
    form: Callable[..., bytes],
) -> None:
    content = form(old(), 6100 if old is small_6100 else 3000)
    stream = read_fbx(written(tmp_path, content))
    assert list(stream.rig.names) == ["arm", "fore", "skin"]
    assert stream.rig.joints[1].translation == (0.0, 0.1, 0.0)
    (mesh,) = stream.rig.meshes
    assert mesh.skin is not None
    assert mesh.skin.joints == ("fore", "skin")
    take = stream.collect()
    turned = so3.angle_between(
        take.motion.rotations.dense()[:, 1], np.array([0, 0, 0, 1.0])
    )
    np.testing.assert_allclose(turned, np.radians(90.0 * np.arange(25) / 24), atol=1e-9)


def test_points_without_a_weight_follow_the_node_of_the_mesh(tmp_path: Path) -> None:
    trees = small_fbx()
    put(part(trees, "Deformer", 7), "Indexes", array([2], "<i4"))
    put(part(trees, "Deformer", 7), "Weights", array([1.0], "<f8"))
    rig = read_fbx_rig(written(tmp_path, as_binary(trees)))
    (mesh,) = rig.meshes
    assert mesh.skin is not None
    joint = mesh.skin.joints[int(mesh.skin.indices.load()[3, 0])]
    assert joint == "skin"


def test_unit_and_axis_can_be_told(tmp_path: Path) -> None:
    path = written(tmp_path, as_text(small_fbx()))
    stream = read_fbx(path, unit=LengthUnit.M, up=UpAxis.Z, fps=48)
    assert stream.rig.up is UpAxis.Z
    assert stream.rig.joints[1].translation == (0.0, 10.0, 0.0)
    assert stream.collect().motion.frames == 49
    assert take_names(path) == ["bend"]


def in_new_ticks(trees: list[Tree], definition: int) -> list[Tree]:
    """Return a file whose times count 141,120,000 ticks per second."""
    put_flags = ("OtherFlags", [], [("TCDefinition", [definition], [])])
    part(trees, "FBXHeaderExtension").append(put_flags)
    for own in (16, 17):
        put(part(trees, "AnimationCurve", own), "KeyTime", array([0, 141120000], "<i8"))
    rows = part(trees, "AnimationStack", 11)[0][2]
    rows[1][1][-1] = 141_120_000
    return trees


@pytest.mark.parametrize("form", [as_text, as_binary])
def test_files_that_count_other_ticks(
    tmp_path: Path, form: Callable[..., bytes]
) -> None:
    path = written(tmp_path, form(in_new_ticks(small_fbx(), 0), 7700))
    stream = read_fbx(path)
    take = stream.collect()
    same = read_fbx(written(tmp_path, form(small_fbx(), 7700))).collect()
    assert not stream.notices
    assert take.motion.frames == same.motion.frames == 25
    mine, theirs = (one.motion.rotations.dense() for one in (take, same))
    np.testing.assert_allclose(mine, theirs, atol=1e-12)


@pytest.mark.parametrize(
    ("span", "frames", "severity"),
    [
        ((0.0, 1.0), (0, 25), None),
        ((0.0, 0.5), (0, 13), Severity.NOTE),
        ((5.0, 6.0), (120, 25), Severity.WARNING),
    ],
)
def test_keys_outside_the_span_of_a_take_are_named(
    tmp_path: Path,
    span: tuple[float, float],
    frames: tuple[int, int],
    severity: Severity | None,
) -> None:
    trees = small_fbx()
    rows = part(trees, "AnimationStack", 11)[0][2]
    for row, time in zip(rows, span, strict=True):
        row[1][-1] = round(time * TICKS)
    stream = read_fbx(written(tmp_path, as_binary(trees)))
    found = [n.severity for n in stream.notices if n.code == "FBX123"]
    assert found == ([] if severity is None else [severity])
    assert (stream.start, stream.collect().motion.frames) == frames


def test_an_unknown_time_definition_or_mode_is_named(tmp_path: Path) -> None:
    content = as_binary(in_new_ticks(small_fbx(), 5), 7700)
    codes = [one.code for one in read_fbx(written(tmp_path, content)).notices]
    assert "FBX106" in codes
    trees = small_fbx()
    (row,) = (r for r in part(trees, "GlobalSettings")[0][2] if r[1][0] == "TimeMode")
    row[1][-1] = 99
    stream = read_fbx(written(tmp_path, as_binary(trees)))
    (notice,) = stream.notices
    assert notice.code == "FBX106"
    assert f"using {stream.fps} " in notice.message


def test_another_take_or_character_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, as_text(small_fbx()))
    for options, code in (({"take": "run"}, "FBX015"), ({"prim_path": "x"}, "FBX014")):
        with pytest.raises(FormatError) as caught:
            read_fbx(path, **options)  # type: ignore[arg-type]
        (fault,) = caught.value.faults
        assert fault.code == code
    assert 'prim_path="x"' in fault.message
    assert "one character: leave out prim_path" in (fault.hint or "")


def test_a_scale_that_is_not_inherited_gets_a_joint_of_its_own(tmp_path: Path) -> None:
    trees = small_fbx()
    for own, rows in (
        (1, [("P", ["Lcl Scaling", "", "", "A", 1.0, 2.0, 1.0], [])]),
        (2, [("P", ["InheritType", "enum", "", "", 2], [])]),
    ):
        part(trees, "Model", own)[0][2].extend(rows)
    stream = read_fbx(written(tmp_path, as_binary(trees)))
    assert list(stream.rig.names) == ["arm", "fore_unscaled", "fore"]
    assert [n.code for n in stream.notices if n.code == "FBX112"]
    world = stream.collect().world()
    # The bone is twice as far up, and as large as it is alone.
    np.testing.assert_allclose(world.positions[0, 2], [0, 0.2, 0], atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(world.linear[:, 2]), 1.0, atol=1e-9)


def instead(
    kind: str, own: int, name: str, values: Any, dtype: str
) -> Callable[[list[Tree]], None]:
    """Return what replaces an array of an object."""
    return lambda trees: put(part(trees, kind, own), name, array(values, dtype))


SPOILED: dict[str, tuple[str, Callable[[list[Tree]], None]]] = {
    "times": (
        "FBX006",
        instead("AnimationCurve", 16, "KeyTime", [5, 4], "<i8"),
    ),
    "counts": (
        "FBX006",
        lambda t: put(
            part(t, "AnimationCurve", 16), "KeyAttrRefCount", array([9], "<i4")
        ),
    ),
    "slopes": (
        "FBX006",
        lambda t: (
            put(part(t, "AnimationCurve", 17), "KeyAttrFlags", array([520], "<i4")),
            put(
                part(t, "AnimationCurve", 17),
                "KeyAttrDataFloat",
                array([np.nan, 0.0, 0.0, 0.0], "<f4").view("<i4"),
            ),
        )[0],
    ),
    "faces": (
        "FBX008",
        lambda t: put(
            part(t, "Geometry", 4), "PolygonVertexIndex", array([0, ~9], "<i4")
        ),
    ),
    "numbers": (
        "FBX005",
        instead("Geometry", 4, "Vertices", [np.nan] * 12, "<f8"),
    ),
    "weights": (
        "FBX008",
        instead("Deformer", 6, "Weights", [1.0], "<f8"),
    ),
    "bind": (
        "FBX008",
        lambda t: put(
            part(t, "Deformer", 6), "TransformLink", array([0.0] * 16, "<f8")
        ),
    ),
    "loop": (
        "FBX009",
        lambda t: part(t, "Connections").append(("C", ["OO", 1, 2], [])),
    ),
    "axes": (
        "FBX007",
        lambda t: part(t, "GlobalSettings")[0][2].append(
            ("P", ["UpAxis", "int", "", "", 2], [])
        ),
    ),
    "order": (
        "FBX004",
        lambda t: part(t, "Model", 2)[0][2].extend(
            [
                ("P", ["RotationActive", "bool", "", "", 1], []),
                ("P", ["RotationOrder", "enum", "", "", 6], []),
            ]
        ),
    ),
}


@pytest.mark.parametrize("name", SPOILED)
@pytest.mark.parametrize("form", FORMS[:2])
def test_what_is_broken_is_refused_at_its_place(
    tmp_path: Path, form: Callable[[list[Tree]], bytes], name: str
) -> None:
    code, spoil = SPOILED[name]
    trees = small_fbx()
    spoil(trees)
    found, where = code_of(tmp_path, form(trees))
    assert found == code
    assert where.startswith("line " if form is as_text else "byte ")


@pytest.mark.parametrize("form", FORMS[:2])
def test_integers_may_be_written_as_floats(
    tmp_path: Path, form: Callable[[list[Tree]], bytes]
) -> None:
    trees = small_fbx()
    put(part(trees, "AnimationCurve", 16), "KeyTime", array([0.0, TICKS], "<f8"))
    read_fbx(written(tmp_path, form(trees)))
    for time in (0.5, np.nan, 1e300):
        put(part(trees, "AnimationCurve", 16), "KeyTime", array([0.0, time], "<f8"))
        assert code_of(tmp_path, form(trees))[0] == "FBX005"


def test_lengths_that_lead_out_of_the_file_are_refused(tmp_path: Path) -> None:
    content = bytearray(as_binary(small_fbx()))
    for at, code in ((27, "FBX002"), (31, "FBX002"), (35, "FBX002")):
        broken = bytearray(content)
        broken[at : at + 4] = struct.pack("<I", 2**31)
        assert code_of(tmp_path, bytes(broken))[0] == code
    assert code_of(tmp_path, bytes(content[:400]))[0] == "FBX002"


def test_an_array_is_not_inflated_beyond_what_it_can_hold(tmp_path: Path) -> None:
    content = as_binary(small_fbx())
    at = content.index(b"Vertices") + len(b"Vertices")
    huge = content[: at + 1] + struct.pack("<I", 2**28) + content[at + 5 :]
    assert code_of(tmp_path, huge)[0] == "FBX002"


@pytest.mark.parametrize(
    ("content", "code"),
    [
        (b"nothing of the kind", "FBX001"),
        (MAGIC + struct.pack("<I", 3000) + bytes(13), "FBX003"),
        (MAGIC[:-1] + b"\x01" + struct.pack("<I", 7400), "FBX003"),
        (b"; FBX 7.4.0 project file\nObjects: {\n", "FBX001"),
        (b"; FBX 7.4.0 project file\nObjects: }\n", "FBX001"),
        (b"; FBX 7.4.0 project file\nA: 1,2,3,4,5,6,7,8-9\n", "FBX001"),
    ],
)
def test_what_is_no_fbx_is_refused(tmp_path: Path, content: bytes, code: str) -> None:
    assert code_of(tmp_path, content)[0] == code


def test_what_drives_the_pose_is_named(tmp_path: Path) -> None:
    trees = small_fbx()
    part(trees, "Objects").append(("Constraint", [99, "aim\x00\x01Constraint", ""], []))
    stream = read_fbx(written(tmp_path, as_text(trees)))
    (fault,) = [n for n in stream.notices if n.code == "FBX107"]
    assert fault.severity is Severity.WARNING
    assert "aim" in fault.message


@pytest.mark.parametrize("suffix", sorted(EXPORT_HINTS.keys() - {".xacro", ".sdf"}))
def test_files_of_tools_are_refused_with_their_export(
    tmp_path: Path, suffix: str
) -> None:
    path = tmp_path / f"hero{suffix}"
    path.write_bytes(b"")
    with pytest.raises(OptionError) as caught:
        find_reader(path)
    (fault,) = caught.value.faults
    assert fault.code == "IO002"
    assert "export" in (fault.hint or "")


def test_fbx_is_not_written() -> None:
    with pytest.raises(OptionError) as caught:
        take_writer(Path("walk.fbx"))
    (fault,) = caught.value.faults
    assert fault.code == "OUT004"
    assert ".usdc" in (fault.hint or "")


def test_keys_between_frames_are_named_with_what_is_lost(tmp_path: Path) -> None:
    trees = small_fbx()
    tip = ("Model", [20, "tip\x00\x01Model", "LimbNode"], [])
    row = ("P", ["Lcl Translation", "", "", "A", 0.0, 10.0, 0.0], [])
    tip[2].append(("Properties70", [], [row]))
    part(trees, "Objects").append(tip)
    part(trees, "Connections").append(("C", ["OO", 20, 2], []))
    instead("AnimationCurve", 16, "KeyTime", [0, TICKS // 16], "<i8")(trees)
    stream = read_fbx(written(tmp_path, as_binary(trees)))
    (fault,) = [n for n in stream.notices if n.code == "FBX110"]
    # Half way between two frames, where the turn of 60 degrees a frame stops.
    found = re.search(r"up to ([\d.]+) mm", fault.message)
    assert found is not None
    a, b = np.radians(60.0), np.radians(90.0)
    ends = np.array([[np.sin(a), np.cos(a)], [np.sin(b), np.cos(b)]])
    lost = np.linalg.norm(ends[1] - ends.mean(axis=0)) * 100.0
    assert float(found[1]) == pytest.approx(lost, rel=0.01)


def test_shapes_of_old_layouts(tmp_path: Path) -> None:
    for old, version, name in (
        (small_6100, 6100, "wide"),
        (small_5000, 3000, "wide (Shape)"),
    ):
        trees = old()
        shape = (
            "Shape",
            ["wide"],
            [("Indexes", [2], []), ("Vertices", [4.0, 0, 0], [])],
        )
        holders = [o for t in trees for o in (t, *t[2]) if o[0] == "Model"]
        (mesh,) = [o for o in holders if any(p[0] == "Vertices" for p in o[2])]
        mesh[2].append(shape)
        keys = [("Key", [0, 0.0, "L", TICKS, 50.0, "L"], [])]
        model = ("Model", [mesh[1][0]], [("Channel", [name], keys)])
        (takes,) = [t for t in trees if t[0] == "Takes"]
        takes[2][1][2].append(model)
        take = read_fbx(written(tmp_path, as_binary(trees, version))).collect()
        assert [one.name for one in take.rig.shapes] == ["wide"]
        assert take.motion.weights is not None
        weights = take.motion.weights.dense()[:, 0, 0]
        np.testing.assert_allclose(weights, np.arange(25) / 48, atol=1e-9)


def test_full_weights_of_blender_are_of_points(tmp_path: Path) -> None:
    trees = small_fbx()
    put(part(trees, "Deformer", 9), "FullWeights", array([50.0], "<f8"))
    # Of other tools it is where the shape is full, as a quarter is half of the half.
    stream = read_fbx(written(tmp_path, as_binary(trees)))
    assert stream.rig.shapes[0].deltas.load()[2].tolist() == [4.0, 0.0, 0.0]
    creator = "Blender (stable FBX IO) - 4.0.0 - 5.8.12"
    trees[0][2].append(("Creator", [creator], []))
    stream = read_fbx(written(tmp_path, as_binary(trees)))
    assert stream.rig.shapes[0].deltas.load()[2].tolist() == [2.0, 0.0, 0.0]
    weights = stream.collect().motion.weights
    assert weights is not None
    np.testing.assert_allclose(weights.rest, 0.25)


def test_pivots_and_rotations_before_move_by_curves(tmp_path: Path) -> None:
    for name, far in (("RotationOffset", 0.9), ("RotationPivot", 0.0)):
        trees = small_fbx()
        for link in part(trees, "Connections"):
            if link[1][1:3] == [14, 2]:
                link[1][3] = name
        world = read_fbx(written(tmp_path, as_binary(trees))).collect().world()
        # From 0 to 90 along Z, less what the rotation about it leaves [cm].
        moved = np.linalg.norm(world.positions[-1, 1] - world.positions[0, 1])
        assert moved == pytest.approx(far, abs=1e-9)
    trees = small_fbx()
    row = ("P", ["RotationActive", "bool", "", "", 1], [])
    part(trees, "Model", 2)[0][2].append(row)
    for link in part(trees, "Connections"):
        if link[1][1:3] == [14, 2]:
            link[1][3] = "PreRotation"
    turns = read_fbx(written(tmp_path, as_binary(trees))).collect().motion.rotations
    apart = so3.angle_between(turns.dense()[-1, 1], turns.dense()[0, 1])
    assert apart == pytest.approx(np.pi / 2)


def test_a_rotation_order_over_time_is_refused(tmp_path: Path) -> None:
    trees = small_fbx()
    for link in part(trees, "Connections"):
        if link[1][1:3] == [14, 2]:
            link[1][3] = "RotationOrder"
    assert code_of(tmp_path, as_binary(trees))[0] == "FBX004"


def test_scales_of_mixed_inherit_types(tmp_path: Path) -> None:
    """A bone leaves out its parent's own scale, and keeps what that took over."""
    trees = small_fbx()
    tip = ("Model", [20, "tip\x00\x01Model", "LimbNode"], [("Properties70", [], [])])
    part(trees, "Objects").append(tip)
    part(trees, "Connections").append(("C", ["OO", 20, 2], []))
    for own, scale, inherit in ((1, 2.0, 1), (2, 3.0, 0), (20, 1.0, 2)):
        rows = part(trees, "Model", own)[0][2]
        rows.append(("P", ["Lcl Scaling", "", "", "A", scale, scale, scale], []))
        rows.append(("P", ["InheritType", "enum", "", "", inherit], []))
    scene = open_fbx(written(tmp_path, as_binary(trees)))
    state = NodeTransforms(scene, None, np.zeros(1, np.int64))
    sizes = [
        np.cbrt(np.linalg.det(state.world_matrices(i)[0, :3, :3])) for i in range(3)
    ]
    assert [m.name for m in scene.models[:3]] == ["arm", "fore", "tip"]
    np.testing.assert_allclose(sizes, [2.0, 6.0, 2.0])


def test_a_scale_of_zero_is_left_out_too(tmp_path: Path) -> None:
    trees = small_fbx()
    for own, rows in (
        (1, [("P", ["Lcl Scaling", "", "", "A", 0.0, 0.0, 0.0], [])]),
        (2, [("P", ["InheritType", "enum", "", "", 2], [])]),
    ):
        part(trees, "Model", own)[0][2].extend(rows)
    take = read_fbx(written(tmp_path, as_binary(trees))).collect()
    fore = take.rig.names.index("fore")
    assert np.linalg.det(take.world().linear[0, fore]) == pytest.approx(1.0, abs=1e-6)


def test_a_take_of_days_is_refused_with_its_frames(tmp_path: Path) -> None:
    trees = small_fbx()
    (stop,) = [r for r in part(trees, "AnimationStack", 11)[0][2] if "Stop" in r[1][0]]
    stop[1][-1] = 48 * 3600 * TICKS
    code, _ = code_of(tmp_path, as_binary(trees))
    assert code == "FBX013"
    assert read_fbx(written(tmp_path, as_binary(trees)), fps=1).rig.names


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('Objects: {\n Model: 1, "Model::mixa', "ends in the middle of a text"),
        ("Objects: {\n Model: 1 {\n", "ends in the middle of Model"),
        ("Objects: {\n Model: 1, 5 ~ }\n}\n", "unexpected '~ }"),
    ],
)
def test_incomplete_text(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "half.fbx"
    path.write_text(f"; FBX 7.4.0 project file\nFBXVersion: 7400\n{text}", "utf-8")
    with pytest.raises(FormatError) as caught:
        read_fbx(path)
    (fault,) = caught.value.faults
    assert fault.code == "FBX001"
    assert message in fault.message
    assert fault.hint == "copy or export it again"
