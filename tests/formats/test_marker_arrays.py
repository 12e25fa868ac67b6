"""npz files of markers: there and back, which array, and what is none."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from animtool.core.clock import Clock
from animtool.core.errors import FormatError
from animtool.core.units import UpAxis
from animtool.formats.marker_arrays import read_markers, write_marker_arrays
from animtool.motion.markers import Markers


def test_there_and_back(tmp_path: Path) -> None:
    positions = np.random.default_rng(3).normal(size=(9, 2, 3))
    positions[4, 1] = np.nan
    filled = np.zeros((9, 2), bool)
    filled[2, 0] = True
    clock = Clock(Fraction(30000, 1001), Fraction(1001), Fraction(1), 9)
    markers = Markers(("A", "B"), clock, positions, UpAxis.Z, filled=filled)
    paths = [tmp_path / "a.npz", tmp_path / "b.npz"]
    for path in paths:
        write_marker_arrays(markers, path)
    back = read_markers(paths[0])
    assert (back.names, back.clock, back.up) == (markers.names, clock, UpAxis.Z)
    np.testing.assert_array_equal(back.positions, positions)
    np.testing.assert_array_equal(back.filled, filled)
    assert paths[0].read_bytes() == paths[1].read_bytes()


def save(path: Path, **arrays: Any) -> Path:
    np.savez(path, **arrays)
    return path


def test_an_array_is_named_and_its_unit_with_it(tmp_path: Path) -> None:
    path = save(
        tmp_path / "a.npz",
        fs=120,
        marker_names=np.array(["A"]),
        markers_mm=np.full((2, 1, 3), 500.0),
        cloud_cm=np.full((2, 3, 3), 50.0),
    )
    assert read_markers(path).positions[0, 0, 0] == 0.5
    cloud = read_markers(f"{path}#cloud_cm")
    assert cloud.names == ("*0", "*1", "*2")
    assert cloud.positions[0, 0, 0] == 0.5


@pytest.mark.parametrize(
    ("code", "arrays"),
    [
        ("MKR012", {"fs": 120}),
        ("MKR012", {"fs": 120, "markers_mm": np.ones((2, 3))}),
        ("MKR012", {"fs": 120, "markers_mm": np.array([[["a"] * 3]])}),
        ("MKR010", {"markers_mm": np.ones((2, 1, 3))}),
        ("MKR010", {"fs": np.nan, "markers_mm": np.ones((2, 1, 3))}),
        ("MKR013", {"fs": 120, "markers_mm": np.ones((0, 1, 3))}),
    ],
)
def test_what_is_no_file_of_markers(
    tmp_path: Path, code: str, arrays: dict[str, Any]
) -> None:
    with pytest.raises(FormatError) as caught:
        read_markers(save(tmp_path / "a.npz", **arrays))
    assert caught.value.code == code
