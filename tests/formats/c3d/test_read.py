"""C3D files of every processor and format are read as another reader reads them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.c3d_bytes import DEC, INTEL, SGI, C3dFile, read_points
from support.data import data_files

from animtool.core.errors import AnimtoolError, FormatError
from animtool.core.units import UpAxis
from animtool.formats.c3d.read import read_c3d

FRAMES_TOO = {"groups": {"POINT": {"FRAMES": np.array([60_000])}}}


@pytest.fixture
def points() -> Any:
    values = np.random.default_rng(4).normal(size=(6, 4, 3)) * 500.0
    values[2, 1] = np.nan
    return values


def written(folder: Path, file: C3dFile) -> Path:
    path = folder / "take.c3d"
    path.write_bytes(file.build())
    return path


@pytest.mark.parametrize("processor", [INTEL, DEC, SGI])
@pytest.mark.parametrize("scale", [-0.1, 0.1])
def test_every_format(
    tmp_path: Path, points: Any, processor: int, scale: float
) -> None:
    words = {"residuals": np.full((6, 4), 3), "masks": np.full((6, 4), 0b101)}
    file = C3dFile(points, list("ABCD"), scale=scale, processor=processor, **words)
    path = written(tmp_path, file)
    markers = read_c3d(path)
    expected, rate = read_points(path.read_bytes())
    assert np.array_equal(markers.visible, np.isfinite(points).all(axis=-1))
    np.testing.assert_allclose(markers.positions * 1000.0, expected, atol=1e-9)
    assert float(markers.clock.rate) == rate
    assert markers.names == ("A", "B", "C", "D")
    assert markers.cameras is not None
    assert markers.cameras[0].tolist() == [2] * 4
    assert markers.residuals is not None
    np.testing.assert_allclose(markers.residuals[0], 0.0003, rtol=1e-6)


def test_labels_beyond_255_and_of_one_subject(tmp_path: Path) -> None:
    values = np.ones((2, 600, 3))
    names = [f"Anna:M{i}" for i in range(600)]
    markers = read_c3d(written(tmp_path, C3dFile(values, names)))
    assert markers.names == tuple(f"M{i}" for i in range(600))


def test_subjects_keep_their_prefix_unless_one_is_asked_for(tmp_path: Path) -> None:
    path = written(tmp_path, C3dFile(np.ones((2, 2, 3)), ["Anna:A", "Ben:A"]))
    assert read_c3d(path).names == ("Anna:A", "Ben:A")
    assert read_c3d(path, subject="Ben").names == ("Anna:A", "A")


def test_names_that_stand_twice_or_not_at_all(tmp_path: Path, points: Any) -> None:
    markers = read_c3d(written(tmp_path, C3dFile(points, ["A", "A", ""])))
    assert markers.names == ("A", "A_2", "*2", "*3")
    assert {"MKR101", "C3D102"} <= {notice.code for notice in markers.notices}


def test_results_of_models_are_left_out(tmp_path: Path, points: Any) -> None:
    groups = {"POINT": {"ANGLES": ["B"]}}
    file = C3dFile(points, list("ABCD"), groups=groups)
    assert read_c3d(written(tmp_path, file)).names == ("A", "C", "D")


def test_what_it_states_and_what_options_say(tmp_path: Path, points: Any) -> None:
    groups = {"POINT": {"X_SCREEN": ["+X"], "Y_SCREEN": ["+Z"]}}
    file = C3dFile(points, list("ABCD"), units="m", groups=groups, first=101)
    path = written(tmp_path, file)
    markers = read_c3d(path)
    assert markers.up is UpAxis.Z
    assert markers.clock.start == 101
    np.testing.assert_allclose(markers.positions, points, rtol=1e-6)
    assert read_c3d(path, fps="59.94").clock.rate.denominator == 1001


@pytest.mark.parametrize(
    ("stated", "up", "turned"),
    [
        ("+Y", UpAxis.Y, (1.0, 2.0, 3.0)),
        ("z", UpAxis.Z, (1.0, 2.0, 3.0)),
        ("-Y", UpAxis.Y, (1.0, -2.0, -3.0)),
        ("-Z", UpAxis.Z, (1.0, -2.0, -3.0)),
        ("+X", UpAxis.Y, (-2.0, 1.0, 3.0)),
        ("-x", UpAxis.Y, (2.0, -1.0, 3.0)),
    ],
)
def test_six_axes_point_up(
    tmp_path: Path, stated: str, up: UpAxis, turned: tuple[float, ...]
) -> None:
    values = np.broadcast_to([1.0, 2.0, 3.0], (2, 1, 3))
    groups = {"POINT": {"X_SCREEN": [""], "Y_SCREEN": [stated]}}
    path = written(tmp_path, C3dFile(values, ["A"], units="m", groups=groups))
    markers = read_c3d(path)
    assert (markers.up, tuple(markers.positions[0, 0])) == (up, turned)
    codes = [notice.code for notice in markers.notices]
    assert codes == (["C3D106"] if turned != (1.0, 2.0, 3.0) else [])
    kept = read_c3d(path, up=UpAxis.Z)
    assert (kept.up, tuple(kept.positions[0, 0])) == (UpAxis.Z, (1.0, 2.0, 3.0))
    assert not kept.notices


@pytest.mark.parametrize(
    ("right", "stated", "up", "code"),
    [
        ("+Z", "-Z", UpAxis.Z, "C3D105"),
        ("+Y", "+Y", UpAxis.Y, "C3D105"),
        ("+X", "up", UpAxis.Y, "C3D105"),
        ("+Y", "", UpAxis.Z, "MKR103"),
        ("-X", "", UpAxis.Y, "MKR103"),
    ],
)
def test_axes_that_contradict(
    tmp_path: Path, right: str, stated: str, up: UpAxis, code: str
) -> None:
    groups = {"POINT": {"X_SCREEN": [right], "Y_SCREEN": [stated]}}
    file = C3dFile(np.ones((2, 1, 3)), ["A"], groups=groups)
    markers = read_c3d(written(tmp_path, file))
    assert markers.up is up
    assert code in {notice.code for notice in markers.notices}


@pytest.mark.parametrize(
    ("stated", "meters"),
    [
        *(("mete", 1.0), ("Meters", 1.0), ("METRE", 1.0), ("m.", 1.0)),
        *(("cm", 0.01), ("centimet", 0.01), ("mill", 0.001), ("MM", 0.001)),
        *(("inches", 0.0254), ("in", 0.0254), ("", 0.001), ("   ", 0.001)),
    ],
)
def test_units(tmp_path: Path, stated: str, meters: float) -> None:
    file = C3dFile(np.ones((2, 1, 3)), ["A"], units=stated)
    markers = read_c3d(written(tmp_path, file))
    np.testing.assert_allclose(markers.positions, meters)
    codes = {notice.code for notice in markers.notices}
    assert ("MKR104" in codes) == (not stated.strip())


def test_a_long_take_has_its_length_in_the_trial(tmp_path: Path) -> None:
    values = np.ones((70_000, 1, 3), np.float32)
    groups = {
        "TRIAL": {
            "ACTUAL_START_FIELD": np.array([1, 0], np.int64),
            "ACTUAL_END_FIELD": np.array([70_000 - 65_536, 1], np.int64),
        }
    }
    file = C3dFile(values, ["A"], declared=65_535, groups=groups)
    assert len(read_c3d(written(tmp_path, file))) == 70_000


@pytest.mark.parametrize(
    ("code", "changes"),
    [
        ("MKR010", {"rate": 0.0}),
        ("MKR010", {"rate": float("nan"), "header_rate": float("inf")}),
        ("MKR011", {"units": "furlong"}),
        ("C3D002", {"declared": 60_000, **FRAMES_TOO}),
        ("C3D002", {"used": 60_000, "labels": []}),
        ("MKR013", {"used": 0, "labels": [], "points": np.zeros((6, 0, 3))}),
        ("MKR013", {"points": np.zeros((0, 4, 3))}),
    ],
)
def test_what_cannot_be_read(
    tmp_path: Path, points: Any, code: str, changes: dict[str, Any]
) -> None:
    file = C3dFile(**{"points": points, "labels": list("ABCD"), **changes})
    path = written(tmp_path, file)
    with pytest.raises(AnimtoolError) as caught:
        read_c3d(path)
    assert caught.value.code == code
    assert isinstance(caught.value, FormatError)


def test_a_file_that_is_cut_short_anywhere(tmp_path: Path, points: Any) -> None:
    data = C3dFile(points, list("ABCD")).build()
    path = tmp_path / "cut.c3d"
    for size in (0, 1, 511, 513, 516, 700, len(data) - 1):
        path.write_bytes(data[:size])
        with pytest.raises(FormatError) as caught:
            read_c3d(path)
        assert caught.value.code in {"C3D001", "C3D002"}


@pytest.mark.parametrize("path", data_files("mocap", "**/*.c3d"))
def test_captures_equal_ezc3d(path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d is not installed")
    other = ezc3d.c3d(str(path))
    markers = read_c3d(path, up=UpAxis.Z)
    unit = {"mm": 0.001, "m": 1.0}[other["parameters"]["POINT"]["UNITS"]["value"][0]]
    positions = other["data"]["points"][:3].transpose(2, 1, 0) * unit
    # It turns residuals below 0 into NaN, and leaves points at the origin.
    positions[(positions == 0).all(axis=-1)] = np.nan
    assert markers.positions.shape == positions.shape
    np.testing.assert_allclose(markers.positions, positions, rtol=1e-6, atol=1e-9)
