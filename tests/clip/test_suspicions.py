"""Warnings about keys in another unit or order."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from animtool.clip.clip import Clip
from animtool.validation.run import validate

RIG = """\
rig: animtool/1
name: leg
units: {length: cm, angle: deg}
joints:
- {name: hips, type: free, translate: [0, 90, 0]}
- {name: thigh, parent: hips, type: ball}
- {name: knee, parent: thigh, type: pin, axis: [1, 0, 0], translate: [0, -42, 0]}
- {name: foot, parent: knee, type: ball, translate: [0, -40, 0]}
"""
KNEE = "joint/knee.angle", "", [0, 60, 0]
ROOT = "joint/hips.translation", ""


def codes(
    folder: Path, *channels: tuple[str, str, list[object]], units: str = "{}"
) -> list[str]:
    (folder / "leg.rig.yaml").write_text(RIG, "utf-8")
    lines = ["clip: animtool/1", "rig: leg.rig.yaml", "fps: 24", f"units: {units}"]
    lines += ["channels:"]
    for target, extra, values in channels:
        keys = ", ".join(f"{{t: {1 + 12 * k}, v: {v}}}" for k, v in enumerate(values))
        lines += [f"- {{target: {target}, {extra}keys: [{keys}]}}"]
    path = folder / "a.clip.yaml"
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return [notice.code for notice in Clip.load(path).notices]


def eulers(scale: float) -> list[tuple[str, str, list[object]]]:
    """Return six moving channels, a knee among them, up to a scale."""
    row = [[0, 0, 0], [scale, 0.3 * scale, 0], [0.1, 0, 0]]
    parts = [("joint/thigh.rotation", "euler: XYZ, ", row)]
    parts += [("joint/foot.rotation", "euler: XYZ, ", row)]
    return [*parts, ("joint/hips.rotation", "euler: XYZ, ", row)]


@pytest.mark.parametrize(
    "channel",
    [
        ("joint/knee.angle", "", [0, 1.5708, 0]),
        ("joint/knee.angle", "", [0.17, 2.27, 0.17]),
        ("joint/thigh.rotation", "euler: XYZ, ", [[0, 0, 0], [-0.7854, 0.2, 0]]),
    ],
)
def test_radians_where_degrees_are_declared(
    tmp_path: Path, channel: tuple[str, str, list[object]]
) -> None:
    assert codes(tmp_path, channel) == ["CLIP107"]
    assert codes(tmp_path, channel, units="{angle: rad}") == []


@pytest.mark.parametrize(
    ("angles", "found"),
    [
        ([[-85, -55, -92], [40, 20, 0], [0, 0, 0]], True),
        ([[-85.4, -55.3, -92.2], [40, 20, 0], [0, 0, 0]], False),
        ([[-85, -55, 0], [0, 0, 0], [0, 0, 0]], False),
    ],
)
def test_single_channels_in_radians(
    tmp_path: Path, angles: list[list[float]], found: bool
) -> None:
    radians: list[object] = [[round(math.radians(a), 3) for a in row] for row in angles]
    thigh, foot, _ = eulers(70.0)
    hips = ("joint/hips.rotation", "euler: XYZ, ", radians)
    assert codes(tmp_path, thigh, foot, hips) == ["CLIP107"] * found


def test_degrees_where_radians_are_declared(tmp_path: Path) -> None:
    assert codes(tmp_path, KNEE, units="{angle: rad}") == ["CLIP107"]
    assert (
        codes(
            tmp_path, ("joint/knee.angle", "", [0, 9.42477, 62.8]), units="{angle: rad}"
        )
        == []
    )


@pytest.mark.parametrize(
    ("values", "found"),
    [
        ([0.0, 37.37, 61.21], True),
        ([0.0, 2.37, 1.21], False),
        ([0.0, 3.3, 6.1], False),
    ],
)
def test_degrees_of_a_hinge_where_radians_are_declared(
    tmp_path: Path, values: list[float], found: bool
) -> None:
    knee = ("joint/knee.angle", "", values)
    channels = [knee, *eulers(max(values))]
    codes_ = codes(tmp_path, *channels, units="{angle: rad}")
    assert codes_ == ["CLIP107"] * found
    wheel = [("joint/thigh.rotation", "euler: XYZ, ", [[0, 0, 0], [31.43, 0.1, 0.2]])]
    assert codes(tmp_path, *wheel, units="{angle: rad}") == []


def test_small_motion_is_plausible(tmp_path: Path) -> None:
    assert codes(tmp_path, ("joint/knee.angle", "", [0, 1.5, 0.4])) == []
    assert codes(tmp_path, *eulers(1.3)) == []


def test_w_last(tmp_path: Path) -> None:
    at = "joint/thigh.rotation", ""
    assert codes(tmp_path, (*at, [[0, 0, 0, 1], [0.3, 0, 0, 0.954]])) == ["CLIP106"]
    assert codes(tmp_path, (*at, [[1, 0, 0, 0], [0, 0, 0, 1]])) == []
    assert codes(tmp_path, (*at, [[0, 0, 0, -1], [0.1, 0, 0, 0.995]])) == []


def test_metres_in_a_clip_in_centimetres(tmp_path: Path) -> None:
    root = (*ROOT, [[0, 0, 0], [0, 0.1, 0.6], [0, 0, 1.2]])
    assert codes(tmp_path, root, KNEE) == ["CLIP108"]
    assert codes(tmp_path, root, KNEE, units="{length: m}") == []
    assert codes(tmp_path, root) == []  # nothing rotates
    sway = (*ROOT, [[0, 0, 0], [0, 0, 1.2], [0, 0, 0]])
    assert codes(tmp_path, sway, KNEE) == []


def test_metres_without_a_unit_on_a_rig_in_centimetres(tmp_path: Path) -> None:
    hop = (*ROOT, [[0, 0, 0], [0, 0.3, 0], [0, 0, 0]])
    assert codes(tmp_path, hop) == ["CLIP108"]
    assert codes(tmp_path, hop, units="{length: cm}") == []
    assert codes(tmp_path, (*ROOT, [[0, 0, 0], [0, 3, 0], [0, 0, 0]])) == []
    assert codes(tmp_path, (*ROOT, [[0, 0.3, 0], [0, 0.3, 0]])) == []


def test_a_root_faster_than_any_fall(tmp_path: Path) -> None:
    assert codes(tmp_path, (*ROOT, [[0, 0, 0], [4800, 0, 0]]), KNEE) == ["CLIP109"]
    assert codes(tmp_path, (*ROOT, [[0, 0, 0], [1000, 0, 0]]), KNEE) == []


@pytest.mark.parametrize(
    ("positions", "mode", "found"),
    [
        ([0, 5.4, 10.8, 16.2, 21.6], "linear", True),  # a stride in cm in metres
        ([0, 0.6, 1.2, 1.8, 2.4], "linear", False),  # a sprint
        ([0, 1.6, 3.2, 4.8, 6.4], "linear", False),  # a skier
        ([0, 0.1, 90, 90.1, 90.2], "linear", False),  # a teleport
        ([0, 40, 10, 50, 20], "step", False),  # cuts
    ],
)
def test_a_root_that_is_fast_at_every_frame(
    tmp_path: Path, positions: list[float], mode: str, found: bool
) -> None:
    keys = ", ".join(f"{{t: {k}, v: [0, 0, {z}]}}" for k, z in enumerate(positions))
    line = f"- {{target: joint/hips.translation, interp: {mode}, keys: [{keys}]}}"
    head = "fps: 24\nunits: {length: m}"
    assert ("CLIP109" in said(tmp_path, head, line)) is found


def said(folder: Path, head: str, *channels: str, rig: str = RIG) -> list[str]:
    """Return the codes of a clip with lines of channels."""
    (folder / "leg.rig.yaml").write_text(rig, "utf-8")
    path = folder / "a.clip.yaml"
    lines = ["clip: animtool/1", "rig: leg.rig.yaml", head, "channels:", *channels]
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return [notice.code for notice in Clip.load(path).notices]


def knee(times: list[float]) -> str:
    keys = ", ".join(f"{{t: {t:.6g}, v: {10 * (k % 3)}}}" for k, t in enumerate(times))
    return f"- {{target: joint/knee.angle, keys: [{keys}]}}"


@pytest.mark.parametrize(
    ("times", "fps", "found"),
    [
        ([0, 0.5, 1.5, 3], 24, True),
        ([0, 0.25], 30, True),
        ([k / 24 for k in range(60)], 24, True),
        ([k / 120 for k in range(60)], 24, True),
        ([0.5, 1.25, 2], 24, True),
        ([0, 1, 2, 3], 24, False),  # a sampled clip
        ([1, 2.5, 4, 12], 24, False),
        ([0, 3.7, 9.2, 15.8, 22.4], 24, False),  # a retimed clip
        ([k / 4 for k in range(200)], 24, False),  # samples between frames
        ([k / 5 for k in range(60)], 24, False),
        ([0, 1.5, 9, 30], 24, False),
    ],
)
def test_key_times_in_seconds(
    tmp_path: Path, times: list[float], fps: int, found: bool
) -> None:
    assert ("CLIP110" in said(tmp_path, f"fps: {fps}", knee(times))) is found


@pytest.mark.parametrize(
    ("fps", "code"), [("2400", "TAKE009"), ("0.04", "TAKE009"), ("240", "")]
)
def test_an_implausible_rate_is_that_of_the_file(
    tmp_path: Path, fps: str, code: str
) -> None:
    assert said(tmp_path, f"fps: {fps}", knee([1, 24])) == [code] * bool(code)


@pytest.mark.parametrize(
    ("ends", "found"),
    [("[3.2, 3.7]", True), ("[3, 3]", False), ("[3.2, 4.7]", False)],
)
def test_a_range_of_one_frame(tmp_path: Path, ends: str, found: bool) -> None:
    codes = said(tmp_path, f"fps: 24\nrange: {ends}", knee([1, 12, 24]))
    assert ("TAKE010" in codes) is found


def test_keys_outside_the_range_warn_once_when_a_clip_is_read(tmp_path: Path) -> None:
    outside = knee([1, 24, 40, 60])
    turn = "[{t: 1, v: [0, 0, 0]}, {t: 30, v: [9, 0, 0]}, {t: 40, v: [0, 0, 0]}]"
    foot = f"- {{target: joint/foot.rotation, euler: XYZ, keys: {turn}}}"
    head = "fps: 24\nrange: [1, 24]"
    assert said(tmp_path, head, outside, foot) == ["CLIP201"]
    cycle = outside.replace("keys:", "post: cycle, keys:")
    assert said(tmp_path, head, cycle) == []
    late = knee([1001, 1012, 1024]).replace("keys:", "pre: cycle_offset, keys:")
    assert said(tmp_path, head, late) == ["CLIP201"]
    assert said(tmp_path, head.replace("24]", "1024]"), late) == []


@pytest.mark.parametrize(
    ("target", "keys", "found"),
    [
        ("hips", "[0, 90, 0], [0, 90, 0]", True),
        ("hips", "[0, 90, 0], [0, 84, 60], [0, 92, 120]", True),
        ("hips", "[0, 0, 0], [0, -12, 40], [0, 3, 90]", False),
        ("hips", "[0, 0, 0], [0, 90, 0], [0, 0, 0]", False),  # a jump of that height
        ("hips", "[0, 40, 0], [0, 50, 0]", False),
    ],
)
def test_positions_that_repeat_rest(
    tmp_path: Path, target: str, keys: str, found: bool
) -> None:
    values = [f"[{row}]" for row in keys.strip("[]").split("], [")]
    rows = ", ".join(f"{{t: {1 + 12 * k}, v: {v}}}" for k, v in enumerate(values))
    for part, wrong in (("translation", found), ("local_translation", False)):
        line = f"- {{target: joint/{target}.{part}, keys: [{rows}]}}"
        assert ("CLIP112" in said(tmp_path, "fps: 24", line)) is wrong


CURL = """\
controls:
- {name: curl, range: [0, 1], drives: [{joint: knee.angle, expr: curl * 90}]}
"""


@pytest.mark.parametrize(
    ("bend", "drawn", "found"),
    [(80, 1, True), (25, 1, True), (8, 1, False), (80, 0, False), (0, 1, False)],
)
def test_a_joint_and_its_control_are_keyed(
    tmp_path: Path, bend: float, drawn: float, found: bool
) -> None:
    lines = (
        f"- {{target: joint/knee.angle, keys: [{{t: 1, v: 0}}, {{t: 9, v: {bend}}}]}}",
        f"- {{target: control/curl, keys: [{{t: 1, v: 0}}, {{t: 9, v: {drawn}}}]}}",
    )
    assert ("CLIP111" in said(tmp_path, "fps: 24", *lines, rig=RIG + CURL)) is found


@pytest.mark.parametrize(
    ("quaternion", "found"),
    [
        ("[1, 0, 1, 0]", True),
        ("[0, 90, 0, 0]", True),
        ("[0.71, 0, 0.71, 0]", False),
        ("[0.7071, 0, 0.7071, 0]", False),
        ("[-1, 0, 0, 0]", False),
    ],
)
def test_quaternions_of_another_length(
    tmp_path: Path, quaternion: str, found: bool
) -> None:
    keys = f"[{{t: 1, v: [1, 0, 0, 0]}}, {{t: 9, v: {quaternion}}}]"
    line = f"- {{target: joint/thigh.rotation, keys: {keys}}}"
    assert ("RIG110" in said(tmp_path, "fps: 24", line)) is found


@pytest.mark.parametrize(
    ("scales", "found"),
    [
        (["[100, 100, 100]"], True),
        (["[100, 100, 100]", "[120, 80, 120]"], True),
        (["[1, 1, 1]", "[60, 60, 60]"], False),  # something that blows up
        (["[20, 20, 20]"], False),  # a giant of 16 m
        (["[0.01, 0.01, 0.01]"], False),
    ],
)
def test_scales_in_percent(tmp_path: Path, scales: list[str], found: bool) -> None:
    keys = ", ".join(f"{{t: {1 + 12 * k}, v: {v}}}" for k, v in enumerate(scales))
    line = f"- {{target: joint/hips.scale, keys: [{keys}]}}"
    assert ("CLIP113" in said(tmp_path, "fps: 24", line)) is found


@pytest.mark.parametrize(
    ("target", "part", "keys", "found"),
    [
        ("hips", "local_translation", "[0, 0, 0], [0, -2, 65]", True),
        ("hips", "local_translation", "[0, -9, 0], [0, -4, 65]", True),  # crouches
        ("knee", "local_translation", "[0, 1, 0], [0, -2, 1]", True),
        ("hips", "local_translation", "[0, 90, 0], [0, 88, 65]", False),
        ("hips", "local_translation", "[0, 9, 0], [0, 8, 65]", False),  # lies
        ("hips", "local_translation", "[0, 90, 0], [0, 0, 65]", False),  # falls
        ("knee", "local_translation", "[0, 0, 0], [0, 1, 0]", True),
        ("thigh", "local_translation", "[0, 0, 0], [0, 1, 0]", False),  # at its parent
        ("hips", "translation", "[0, 0, 0], [0, -2, 65]", False),
    ],
)
def test_moves_from_rest_as_positions(
    tmp_path: Path, target: str, part: str, keys: str, found: bool
) -> None:
    values = [f"[{row}]" for row in keys.strip("[]").split("], [")]
    rows = ", ".join(f"{{t: {1 + 12 * k}, v: {v}}}" for k, v in enumerate(values))
    line = f"- {{target: joint/{target}.{part}, keys: [{rows}]}}"
    codes = said(
        tmp_path,
        "fps: 24",
        line,
        rig=RIG.replace("type: pin, axis: [1, 0, 0]", "type: free"),
    )
    assert ("CLIP122" in codes) is found


@pytest.mark.parametrize(
    ("rows", "found"),
    [
        ([[0, 0, 0], [0, -65, 0], [0, -130, 2]], True),
        ([[0, 0, 0], [0, 65, 0], [0, 130, 2]], False),  # climbs
        ([[0, 0, 0], [0, -32, 0], [0, -130, 0]], False),  # falls
        ([[0, 0, 0], [0, -65, 65], [0, -130, 130]], False),  # descends stairs
        ([[0, 0, 0], [0, -25, 0], [0, -50, 0]], False),  # crouches
        ([[0, 0, 0], [0, -130, 0]], False),
    ],
)
def test_a_root_that_walks_into_the_ground(
    tmp_path: Path, rows: list[list[float]], found: bool
) -> None:
    keys = ", ".join(f"{{t: {1 + 24 * k}, v: {row}}}" for k, row in enumerate(rows))
    line = f"- {{target: joint/hips.translation, keys: [{keys}]}}"
    assert ("CLIP123" in said(tmp_path, "fps: 24", line)) is found


FACE = "shapes:\n- {name: grin}\n"


@pytest.mark.parametrize(("weight", "found"), [(60, True), (1, False), (2.5, False)])
def test_shape_weights_in_percent(tmp_path: Path, weight: float, found: bool) -> None:
    line = f"- {{target: shape/grin, keys: [{{t: 1, v: 0}}, {{t: 9, v: {weight}}}]}}"
    assert ("CLIP121" in said(tmp_path, "fps: 24", line, rig=RIG + FACE)) is found
    codes = [fault.code for fault in validate(tmp_path / "a.clip.yaml")]
    assert codes.count("CLIP121") == found
    assert ("MOT219" in codes) is (weight == 2.5)
