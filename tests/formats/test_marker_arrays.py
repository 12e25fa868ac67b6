"""npz files of markers: there and back, which array, and what is none."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from animtool.core.clock import Clock
from animtool.core.errors import FormatError, OptionError
from animtool.core.units import LengthUnit, UpAxis
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


def codes(markers: Markers) -> list[str]:
    return [notice.code for notice in markers.notices]


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
        ("MKR012", {"fs": 120, "uv": np.ones((2, 2, 1, 2))}),
    ],
)
def test_what_is_no_file_of_markers(
    tmp_path: Path, code: str, arrays: dict[str, Any]
) -> None:
    with pytest.raises(FormatError) as caught:
        read_markers(save(tmp_path / "a.npz", **arrays))
    assert caught.value.code == code
    assert caught.value.faults[0].path == str(tmp_path / "a.npz")


def test_pixels_name_both_files_that_a_bake_needs(tmp_path: Path) -> None:
    path = save(tmp_path / "a.npz", fs=120, uv=np.ones((2, 2, 1, 2)))
    with pytest.raises(FormatError) as caught:
        read_markers(path)
    hint = caught.value.faults[0].hint or ""
    assert hint.endswith("--cameras FILE --template FILE")


def test_swapped_frames_and_markers_are_refused(tmp_path: Path) -> None:
    names = np.array(["A", "B", "C"])
    take = {"fs": 120, "marker_names": names}
    with pytest.raises(FormatError) as caught:
        read_markers(save(tmp_path / "a.npz", markers_mm=np.ones((3, 7, 3)), **take))
    (fault,) = caught.value.faults
    assert (fault.code, fault.hint) == (
        "MKR012",
        "transpose it to (frames, markers, 3)",
    )
    for shape in ((7, 3, 3), (3, 3, 3)):
        found = read_markers(
            save(tmp_path / "a.npz", markers_mm=np.ones(shape), **take)
        )
        assert found.names == ("A", "B", "C")
        assert "MKR106" not in codes(found)
    # A cloud besides the markers may have as many frames as there are names.
    arrays = take | {"markers_mm": np.ones((3, 3, 3)), "cloud_mm": np.ones((3, 7, 3))}
    save(tmp_path / "a.npz", **arrays)
    assert "MKR106" not in codes(read_markers(f"{tmp_path / 'a.npz'}#cloud_mm"))


@pytest.mark.parametrize(
    ("arrays", "code"),
    [
        ({"names": np.array(["A", "B"])}, "MKR106"),
        ({"labels": np.array(["A", "B"])}, "MKR106"),
        ({"marker_names": np.array(["A"])}, "MKR106"),
        ({"names": np.array(["A", "B", "C"])}, ""),
        ({"names": np.array([1.0, 2.0])}, ""),
        ({"names": np.array(["A", "B"]), "marker_names": np.array(["C", "D"])}, ""),
        ({}, ""),
    ],
)
def test_names_in_another_array(
    tmp_path: Path, arrays: dict[str, Any], code: str
) -> None:
    path = save(tmp_path / "a.npz", fs=120, markers_mm=np.ones((5, 2, 3)), **arrays)
    found = read_markers(path)
    assert [one for one in codes(found) if one != "MKR103"] == ([code] if code else [])
    assert found.names[0] == ("C" if len(arrays) == 2 else "*0")


def test_an_incomplete_archive(tmp_path: Path) -> None:
    path = save(tmp_path / "a.npz", fs=120, markers_mm=np.ones((5, 2, 3)))
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(FormatError, match="is incomplete") as caught:
        read_markers(path)
    assert caught.value.code == "MKR012"
    path.write_bytes(b"walk")
    with pytest.raises(FormatError, match="not an archive of arrays"):
        read_markers(path)


def test_arrays_that_do_not_match_name_the_file(tmp_path: Path) -> None:
    arrays = {"fs": 120, "markers_mm": np.ones((2, 1, 3)), "cameras": np.ones((1, 2))}
    with pytest.raises(OptionError) as caught:
        read_markers(save(tmp_path / "a.npz", **arrays))
    (fault,) = caught.value.faults
    assert (fault.code, fault.path) == ("MKR001", str(tmp_path / "a.npz"))


@pytest.mark.parametrize(
    ("scale", "unit", "severities"),
    [
        (1.0, None, []),
        (1e-3, None, [("MKR117", "warning")]),
        (1e-3, LengthUnit.M, []),
        (1.0, LengthUnit.CM, [("MKR118", "warning")]),
        (0.1, LengthUnit.M, [("MKR118", "note")]),
    ],
)
def test_units_that_do_not_fit_a_person(
    tmp_path: Path,
    scale: float,
    unit: LengthUnit | None,
    severities: list[tuple[str, str]],
) -> None:
    rng = np.random.default_rng(5)
    body = rng.uniform(-1, 1, size=(1, 9, 3)) * [250.0, 900.0, 150.0]
    path = save(
        tmp_path / "a.npz",
        fs=120,
        marker_names=np.array([f"M{i}" for i in range(9)]),
        markers_mm=scale * np.repeat(body, 20, axis=0),
    )
    notices = [
        notice
        for notice in read_markers(path, unit=unit).notices
        if notice.code in {"MKR117", "MKR118"}
    ]
    assert [(one.code, str(one.severity)) for one in notices] == severities
    assert all(one.code != "MKR117" or "'markers_mm'" in one.message for one in notices)
