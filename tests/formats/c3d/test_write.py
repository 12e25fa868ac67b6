"""What is written as C3D is read back, here and by ezc3d."""

from __future__ import annotations

import itertools
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from animtool.core.clock import Clock
from animtool.core.errors import OptionError
from animtool.core.units import UpAxis
from animtool.formats.c3d.read import read_c3d
from animtool.formats.c3d.write import write_c3d
from animtool.motion.markers import Markers


def made(frames: int = 20, count: int = 3) -> Markers:
    rng = np.random.default_rng(1)
    positions = rng.normal(size=(frames, count, 3))
    positions[3, 1] = np.nan
    filled = np.zeros((frames, count), bool)
    filled[5:8, 2] = True
    residuals = np.full((frames, count), 0.0004)
    residuals[filled] = np.nan
    cameras = np.full((frames, count), 3)
    cameras[3, 1] = 0
    cameras[filled] = 0
    names = tuple(f"M{i}" for i in range(count))
    clock = Clock(Fraction(120000, 1001), Fraction(7), Fraction(1), frames)
    return Markers(names, clock, positions, UpAxis.Z, cameras, residuals, filled)


def test_there_and_back(tmp_path: Path) -> None:
    markers, path = made(), tmp_path / "take.c3d"
    assert not write_c3d(markers, path)
    back = read_c3d(path)
    assert (back.names, back.clock, back.up) == (markers.names, markers.clock, UpAxis.Z)
    np.testing.assert_allclose(back.positions, markers.positions, atol=1e-6)
    np.testing.assert_array_equal(back.filled, markers.filled)
    np.testing.assert_allclose(back.residuals, np.where(
        markers.visible, markers.residuals, np.nan), rtol=1e-6)  # fmt: skip
    np.testing.assert_array_equal(back.cameras, markers.cameras)
    assert not back.notices


def stored(markers: Markers) -> np.ndarray:
    """Return positions as floats of the file [mm]."""
    return (markers.positions * 1000.0).astype(np.float32)


def long_take(frames: int, start: int = 1, count: int = 1) -> Markers:
    clock = Clock(Fraction(240), Fraction(start), Fraction(1), frames)
    positions = np.random.default_rng(2).normal(size=(frames, count, 3))
    return Markers(tuple(f"M{i}" for i in range(count)), clock, positions)


# One frame more than a full block of padding holds would be read of the second.
LONG = [(65_535, 1, 1), (66_000, 1, 1), (66_048, 1, 2), (70_000, 101, 1)]


def test_ezc3d_reads_the_same(tmp_path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d is not installed")
    markers, path = made(count=300), tmp_path / "take.c3d"
    write_c3d(markers, path)
    found = ezc3d.c3d(str(path))
    positions = found["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_array_equal(positions.astype(np.float32), stored(markers))
    parameters = found["parameters"]["POINT"]
    labels = [*parameters["LABELS"]["value"], *parameters["LABELS2"]["value"]]
    assert tuple(labels) == markers.names
    assert found["header"]["points"]["first_frame"] == 6


@pytest.mark.parametrize(("frames", "start", "count"), LONG)
def test_ezc3d_reads_as_many_frames(
    tmp_path: Path, frames: int, start: int, count: int
) -> None:
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d is not installed")
    markers, path = long_take(frames, start, count), tmp_path / "take.c3d"
    write_c3d(markers, path)
    positions = ezc3d.c3d(str(path))["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_array_equal(positions.astype(np.float32), stored(markers))


@pytest.mark.parametrize(("frames", "start", "count"), [(20, 7, 3), LONG[0], LONG[3]])
@pytest.mark.filterwarnings("ignore:No analog data")
def test_py_c3d_reads_the_same(
    tmp_path: Path, frames: int, start: int, count: int
) -> None:
    c3d = pytest.importorskip("c3d", reason="c3d (py-c3d) is not installed")
    markers, path = long_take(frames, start, count), tmp_path / "take.c3d"
    write_c3d(markers, path)
    with path.open("rb") as opened:
        reader = c3d.Reader(opened)
        assert (reader.first_frame, reader.frame_count) == (start, frames)
        # It reads frame by frame, slowly.
        some = itertools.islice(reader.read_frames(), 500)
        rows = [points[:, :3].copy() for _, points, _ in some]
    np.testing.assert_array_equal(np.array(rows), stored(markers)[:500])


@pytest.mark.parametrize(("frames", "start", "count"), [*LONG, (1000, 70_000, 1)])
def test_a_long_take(tmp_path: Path, frames: int, start: int, count: int) -> None:
    markers, path = long_take(frames, start, count), tmp_path / "long.c3d"
    write_c3d(markers, path)
    back = read_c3d(path)
    assert back.clock == markers.clock
    assert not [each for each in back.notices if each.code.startswith("C3D")]


def test_what_does_not_fit(tmp_path: Path) -> None:
    clock = Clock(Fraction(24), Fraction(1), Fraction(1), 1)
    names = tuple(f"{i:0255d}" for i in range(600))
    with pytest.raises(OptionError) as caught:
        write_c3d(Markers(names, clock, np.ones((1, 600, 3))), tmp_path / "a.c3d")
    assert caught.value.code == "C3D010"
    assert not list(tmp_path.iterdir())


def test_positions_beyond_float32_are_not_written(tmp_path: Path) -> None:
    markers, path = long_take(4, count=2), tmp_path / "far.c3d"
    markers.positions[1, 0] = 1e37
    (fault,) = write_c3d(markers, path)
    assert fault.code == "C3D104"
    back = read_c3d(path)
    assert back.visible.sum() == 7
    np.testing.assert_allclose(back.positions[0], markers.positions[0], rtol=1e-6)


@pytest.mark.parametrize(("cameras", "lost"), [(8, True), (7, False)])
def test_more_cameras_than_a_c3d_holds(
    tmp_path: Path, cameras: int, lost: bool
) -> None:
    markers = long_take(4, count=2)
    markers = replace(markers, cameras=np.full((4, 2), cameras))
    faults = write_c3d(markers, tmp_path / "a.c3d")
    assert [fault.code for fault in faults] == ["C3D104"] * lost
    assert all("here up to 8" in fault.message for fault in faults)
