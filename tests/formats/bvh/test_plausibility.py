"""Implausible rotations, root channels and offsets of a BVH, and plausible ones."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

from animtool.core.errors import Severity
from animtool.formats.bvh.read import read_bvh
from animtool.validation.run import validate

WALK = Path(__file__).parents[3] / "samples/walk/walk.bvh"

Change = Callable[[np.ndarray], np.ndarray]


def changed(path: Path, change: Change, scale: float = 1.0) -> Path:
    """Write the walk with other rows, and with offsets in another unit."""
    head, _, motion = WALK.read_text("utf-8").partition("MOTION\n")
    frames, time, *lines = motion.splitlines()
    rows = change(np.array([[float(x) for x in line.split()] for line in lines]))
    words = [line.split() for line in head.splitlines()]
    head = "".join(
        f"OFFSET {' '.join(str(scale * float(x)) for x in row[1:])}\n"
        if row[:1] == ["OFFSET"]
        else f"{' '.join(row)}\n"
        for row in words
    )
    rows[:, :3] *= scale
    text = "\n".join(" ".join(f"{x:.6f}" for x in row) for row in rows)
    path.write_text(f"{head}MOTION\n{frames}\n{time}\n{text}\n", "utf-8")
    return path


def rotations(factor: float, travel: float = 1.0) -> Change:
    def change(rows: np.ndarray) -> np.ndarray:
        root = rows[:1, :3] + travel * (rows[:, :3] - rows[:1, :3])
        return np.hstack([root, factor * rows[:, 3:]])

    return change


@pytest.mark.parametrize(
    ("factor", "travel", "scale", "found"),
    [
        (math.radians(1), 1.0, 1.0, True),
        (math.radians(1), 1.0, 0.01, True),  # in metres
        (math.radians(1), 1.0, 1e-3, True),  # an insect
        (1.0, 1.0, 1.0, False),
        (1.0, 1.0, 0.01, False),
        (math.radians(1), 0.05, 1.0, True),  # in place
        (0.002, 1.0, 1.0, False),  # a statue that slides
        (0.3, 3.0, 1.0, False),  # a skier who crouches
    ],
)
def test_rotations_in_radians(
    factor: float, travel: float, scale: float, found: bool, tmp_path: Path
) -> None:
    path = changed(tmp_path / "a.bvh", rotations(factor, travel), scale)
    stream = read_bvh(path)
    list(stream.blocks)
    severities = [n.severity for n in stream.notices if n.code == "BVH112"]
    is_in_place = travel < 0.5
    expected = Severity.NOTE if is_in_place else Severity.WARNING
    assert severities == [expected] * found


@pytest.mark.parametrize(("positions", "found"), [("offsets", True), (None, False)])
def test_positions_that_no_joint_has(positions: str | None, found: bool) -> None:
    codes = [notice.code for notice in read_bvh(WALK, positions=positions).notices]
    assert codes.count("BVH113") == found


def test_positions_below_a_root_are_ignored_without_a_note(tmp_path: Path) -> None:
    text = (
        "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\n"
        "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n"
        "JOINT b\n{\nOFFSET 0 9 0\n"
        "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n"
        "End Site\n{\nOFFSET 0 1 0\n}\n}\n}\n"
        "MOTION\nFrames: 1\nFrame Time: 0.04\n" + "0 " * 12 + "\n"
    )
    path = tmp_path / "a.bvh"
    path.write_text(text, "utf-8")
    assert "BVH113" not in [n.code for n in read_bvh(path, positions="offsets").notices]


def swapped(rows: np.ndarray) -> np.ndarray:
    return np.hstack([rows[:, 3:6], rows[:, :3], rows[:, 6:]])


@pytest.mark.parametrize(
    ("scale", "change", "found"),
    [
        (1.0, swapped, True),
        (1.0, lambda rows: rows, False),
        (1.0, lambda rows: swapped(rows)[:1], False),
    ],
)
def test_swapped_root_channels(
    scale: float, change: Change, found: bool, tmp_path: Path
) -> None:
    path = changed(tmp_path / "a.bvh", change, scale)
    codes = [fault.code for fault in validate(path)]
    assert codes.count("BVH115") == found
    if found:
        assert "MOT214" not in codes


@pytest.mark.parametrize("order", list(permutations("ZXY")))
def test_channels_in_another_order_than_the_angles(
    order: tuple[str, ...], tmp_path: Path
) -> None:
    """The walk has Z, X, Y; its feet stand still in that order alone."""
    channels, right = (
        " ".join(f"{letter}rotation" for letter in letters)
        for letters in (order, "ZXY")
    )
    text, path = WALK.read_text("utf-8"), tmp_path / "a.bvh"
    path.write_text(text.replace(right, channels), "utf-8")
    faults = validate(path)
    found = [fault for fault in faults if fault.code == "BVH117"]
    assert len(found) == (channels != right)
    for fault in found:
        assert fault.message.endswith(f"CHANNELS {channels} are those of {right}")
        assert "MOT214" not in [fault.code for fault in faults]


def test_too_few_frames_show_no_standing_foot(tmp_path: Path) -> None:
    for frames, count in ((19, 0), (64, 1)):
        path = changed(tmp_path / "a.bvh", lambda rows, n=frames: rows[:n])
        text = path.read_text("utf-8").replace("Frames: 64", f"Frames: {frames}")
        path.write_text(text.replace("Zrotation Xrotation", "Xrotation Zrotation"))
        stream = read_bvh(path)
        list(stream.blocks)
        assert [n.code for n in stream.notices].count("BVH117") == count


@pytest.mark.parametrize(
    ("old", "new", "joint"),
    [
        ("0.0000 -44.0000 0.0000", "0.0000 44.0000 0.0000", "LeftLeg"),
        ("29.0000 0.0000 0.0000", "-29.0000 0.0000 0.0000", "LeftForeArm"),
        ("0.0000 -44.0000 0.0000", "0.0000 -46.0000 0.0000", None),
    ],
)
def test_an_offset_with_the_sign_of_the_other_side(
    old: str, new: str, joint: str | None, tmp_path: Path
) -> None:
    path = tmp_path / "a.bvh"
    path.write_text(WALK.read_text("utf-8").replace(old, new, 1), "utf-8")
    notices = read_bvh(path).notices
    found = [notice for notice in notices if notice.code == "BVH116"]
    assert len(found) == (joint is not None)
    for notice in found:
        assert repr(joint) in (notice.hint or "")


def test_a_body_without_offsets_has_no_leg_length(tmp_path: Path) -> None:
    text = re.sub(r"OFFSET .*", "OFFSET 0 0 0", WALK.read_text("utf-8"))
    path = tmp_path / "a.bvh"
    path.write_text(text, "utf-8")
    stream = read_bvh(path)
    list(stream.blocks)
    assert "BVH115" not in [notice.code for notice in stream.notices]
