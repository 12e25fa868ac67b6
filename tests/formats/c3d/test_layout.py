"""Of counts that contradict each other, those are read that fill the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.c3d_bytes import DEC, INTEL, SGI, C3dFile

from animtool.core.errors import FormatError
from animtool.formats.c3d.read import read_c3d
from animtool.motion.markers import Markers

FRAMES, POINTS, CHANNELS, SAMPLES = 150, 5, 4, 7


def moving(frames: int = FRAMES, points: int = POINTS) -> Any:
    """Return points that move as markers do [mm], one of which is not seen at times."""
    times = np.arange(frames)[:, None, None] / 50
    phases = np.linspace(0, 5, points)[None, :, None] + np.array([0, 1, 2])
    values = 300 * np.sin(times + phases) + 100 * np.arange(1, points + 1)[:, None]
    values[20:30, 0] = np.nan
    return values


def analog(frames: int = FRAMES) -> Any:
    """Return analogue numbers of all channels and samples."""
    shape = (frames, CHANNELS * SAMPLES)
    return np.round(np.random.default_rng(3).normal(size=shape) * 200)


def take(**changes: Any) -> C3dFile:
    """Return a file with analogue numbers, whose counts agree but for the changes."""
    names = [f"M{i}" for i in range(POINTS)]
    settings = {"analog": analog(), "samples": SAMPLES, "padded": True, "rate": 100.0}
    return C3dFile(moving(), names, **{**settings, **changes})


def read(folder: Path, file: C3dFile) -> Markers:
    path = folder / "take.c3d"
    path.write_bytes(file.build())
    return read_c3d(path)


def codes(markers: Markers) -> list[str]:
    return [each.code for each in markers.notices if each.code.startswith("C3D")]


def number(value: int) -> Any:
    return np.array([value], np.int64)


def point(**entries: Any) -> dict[str, Any]:
    return {"groups": {"POINT": entries}}


def trial(end: list[int]) -> dict[str, Any]:
    fields = {"ACTUAL_START_FIELD": np.array([1, 0]), "ACTUAL_END_FIELD": np.array(end)}
    return {"groups": {"TRIAL": fields}}


# Files whose counts contradict each other, by what is wrong.
CONTRADICTED: dict[str, dict[str, Any]] = {
    "word 3 counts channels": {"words": {3: CHANNELS}},
    "word 3 is 0": {"words": {3: 0}},
    "word 3 is too large": {"words": {3: 61}},
    "word 3 is full": {"words": {3: 65535}},
    "LONG_FRAMES is stale": point(LONG_FRAMES=np.array([2963], np.float32)),
    "LONG_FRAMES is less": point(LONG_FRAMES=np.array([20], np.float32)),
    "TRIAL is stale": trial([2963, 0]),
    "TRIAL is full": trial([65535, 65535]),
    "FRAMES is stale": point(FRAMES=number(400)),
    "FRAMES is less": point(FRAMES=number(40)),
    "words 4 and 5 are stale": {"declared": 400},
    "words 4 and 5 are less": {"declared": 40},
    "words 4 and 5 are 0": {"words": {4: 0, 5: 0}},
    "USED is more": point(USED=number(POINTS + 1)),
    "USED is less": point(USED=number(POINTS - 1)),
    "word 2 is more": {"words": {2: POINTS + 1}},
    "word 2 is less": {"words": {2: POINTS - 1}},
    "USED and word 2 are wrong": {"used": POINTS + 2},
    "ANALOG:USED is wrong": {"groups": {"ANALOG": {"USED": number(CHANNELS + 1)}}},
    "ANALOG:USED is 0": {"groups": {"ANALOG": {"USED": number(0)}}},
    "ANALOG:RATE is wrong": {"groups": {"ANALOG": {"RATE": np.float32([300])}}},
    "word 9 is wrong": {"words": {9: 6}},
    "word 9 is early": {"words": {9: 2}},
    "DATA_START is wrong": point(DATA_START=number(6)),
    "word 9 and DATA_START are wrong": {"words": {9: 2}, **point(DATA_START=number(2))},
    "the scale of the header has another sign": {"header_scale": 0.1, "scale": -0.1},
    "POINT:SCALE has another sign": point(SCALE=np.array([0.1], np.float32)),
}  # fmt: skip
# What no warning is owed for: a count that is not read, or that cannot be larger.
SILENT = {"words 4 and 5 are 0", "TRIAL is full"}


@pytest.mark.parametrize("processor", [INTEL, DEC, SGI])
@pytest.mark.parametrize("what", CONTRADICTED)
def test_what_fills_the_file_is_read(tmp_path: Path, what: str, processor: int) -> None:
    markers = read(tmp_path, take(processor=processor, **CONTRADICTED[what]))
    np.testing.assert_allclose(markers.positions, moving() / 1000, atol=1e-6)
    warned = codes(markers).count("C3D101")
    assert warned == 1 or what in SILENT


@pytest.mark.parametrize("what", CONTRADICTED)
def test_of_integers_too(tmp_path: Path, what: str) -> None:
    changes = {"scale": 0.1, **CONTRADICTED[what]}
    if "sign" in what:
        other = point(SCALE=np.array([-0.1], np.float32))
        changes = {
            "scale": 0.1,
            **({"header_scale": -0.1} if "header" in what else other),
        }
    markers = read(tmp_path, take(**changes))
    np.testing.assert_allclose(markers.positions, moving() / 1000, atol=6e-5)


def test_a_file_without_contradiction(tmp_path: Path) -> None:
    for changes in ({}, {"padded": False}, {"gap": 2}, {"scale": 0.1}, {"first": 101}):
        markers = read(tmp_path, take(**changes))
        assert markers.positions.shape == (FRAMES, POINTS, 3)
        assert codes(markers) == []


@pytest.mark.parametrize("section", ["none", "empty"])
@pytest.mark.parametrize("processor", [INTEL, DEC, SGI])
@pytest.mark.parametrize("scale", [-0.1, 0.1])
def test_without_parameters(
    tmp_path: Path, section: str, processor: int, scale: float
) -> None:
    file = take(section=section, processor=processor, scale=scale)
    markers = read(tmp_path, file)
    np.testing.assert_allclose(markers.positions, moving() / 1000, atol=6e-5)
    assert markers.names == tuple(f"*{i}" for i in range(POINTS))
    assert codes(markers) == ["C3D107", "C3D102"]


def long_take(frames: int, **changes: Any) -> tuple[Any, C3dFile]:
    values = moving(frames, 1)
    values[20:30, 0] = 0.5
    return values, C3dFile(values, ["A"], scale=0.1, **changes)


@pytest.mark.parametrize("padded", [False, True])
@pytest.mark.parametrize(
    "changes",
    [
        {"words": {5: 65535}, **point(FRAMES=number(-1))},
        {"words": {5: 65535}, **point(FRAMES=number(32767))},
        {"words": {5: 65535}, **trial([65535, 0])},
        {"words": {5: 65535}, **trial([65535, 65535])},
        {"words": {5: 4464}, **point(FRAMES=number(4464))},
        {"words": {5: 65535}, **point(LONG_FRAMES=np.array([70000], np.float32))},
        {"words": {5: 65535}, **trial([4464, 1])},
    ],
)
def test_more_frames_than_16_bits_count(
    tmp_path: Path, changes: dict[str, Any], padded: bool
) -> None:
    values, file = long_take(70_000, padded=padded, **changes)
    markers = read(tmp_path, file)
    np.testing.assert_allclose(markers.positions, values / 1000, atol=6e-5)


def test_bytes_behind_the_frames_are_reported(tmp_path: Path) -> None:
    path = tmp_path / "take.c3d"
    path.write_bytes(take(padded=True).build() + bytes(range(256)) * 20)
    markers = read_c3d(path)
    assert len(markers) == FRAMES
    assert codes(markers) == ["C3D108"]


@pytest.mark.parametrize(
    ("blocks", "found"), [(b"\0" * 512, []), (b"\0" * 1024, ["C3D108"])]
)
def test_a_block_of_zeros_behind_full_blocks(
    tmp_path: Path, blocks: bytes, found: list[str]
) -> None:
    data = C3dFile(moving(32, 4)[10:18], ["a", "b", "c", "d"]).build()
    assert len(data) % 512 == 0
    path = tmp_path / "take.c3d"
    path.write_bytes(data + blocks)
    assert codes(read_c3d(path)) == found


def test_rotations_behind_the_points(tmp_path: Path) -> None:
    data = take().build()
    after = number(len(data) // 512 + 1)
    rotation = {"ROTATION": {"USED": number(2), "DATA_START": after}}
    path = tmp_path / "take.c3d"
    path.write_bytes(take(groups=rotation).build() + bytes(range(256)) * 20)
    markers = read_c3d(path)
    np.testing.assert_allclose(markers.positions, moving() / 1000, atol=1e-6)
    assert codes(markers) == []


@pytest.mark.parametrize("part", [0.2, 0.5, 0.9, 0.999])
@pytest.mark.parametrize(
    "what", [None, "LONG_FRAMES is stale", "FRAMES is less", "ANALOG:RATE is wrong"]
)
def test_what_is_cut_short_is_refused(
    tmp_path: Path, part: float, what: str | None
) -> None:
    data = take(padded=False, **(CONTRADICTED[what] if what else {})).build()
    begin = 1024
    path = tmp_path / "take.c3d"
    path.write_bytes(data[: begin + 2 + int(part * (len(data) - begin))])
    with pytest.raises(FormatError) as caught:
        read_c3d(path)
    assert caught.value.code in {"C3D002", "C3D003"}


def test_counts_that_leave_much_and_give_no_positions(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).normal(size=(FRAMES, POINTS, 3))
    file = C3dFile(noise, [], declared=FRAMES // 2)
    file.groups["POINT"] = {"FRAMES": number(FRAMES // 2)}
    with pytest.raises(FormatError) as caught:
        read(tmp_path, file)
    assert caught.value.code == "C3D003"


def test_scales_of_integers_that_differ(tmp_path: Path) -> None:
    markers = read(tmp_path, take(scale=0.1, header_scale=0.2))
    np.testing.assert_allclose(markers.positions, moving() / 1000, atol=6e-5)
    assert codes(markers) == ["C3D101"]
