"""Reading props, cameras and attributes."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.props import FRAMES, prop_matrices, write_props

from animtool.core.errors import FormatError, OptionError
from animtool.core.units import UpAxis, up_from_up
from animtool.maths import so3
from animtool.motion.transforms import PropRequest
from animtool.usd.props.reader import PropSource, open_prop

CODES = np.array(FRAMES, np.float64)


def opened(
    path: Path, prim: str, up: UpAxis = UpAxis.Y, **wanted: object
) -> PropSource:
    return open_prop(PropRequest(path, prim, "thing", **wanted), up)  # type: ignore[arg-type]


def in_metres(matrices: np.ndarray, unit: float) -> np.ndarray:
    """Return row vectors of a stage as column vectors in metres."""
    found = matrices.swapaxes(1, 2).copy()
    found[:, :3, 3] *= unit
    return found


@pytest.mark.parametrize("prim", ["/Set/box", "/Set/camera"])
@pytest.mark.parametrize("unit", [0.01, 1.0, 0.0254])
def test_where_it_is(tmp_path: Path, prim: str, unit: float) -> None:
    path = write_props(tmp_path / "props.usda", unit=unit)
    found = opened(path, prim).track.at(CODES)
    expected = in_metres(prop_matrices(path, prim, CODES), unit)
    assert found.matrices is None
    assert_allclose(found.matrix(), expected, rtol=0, atol=1e-14 * 700)
    assert (np.sum(found.rotations[1:] * found.rotations[:-1], axis=1) > 0).all()


@pytest.mark.parametrize(("file", "rig"), [("Y", UpAxis.Z), ("Z", UpAxis.Y)])
def test_another_up_axis(tmp_path: Path, file: str, rig: UpAxis) -> None:
    path = write_props(tmp_path / "props.usda", up=file)
    found = opened(path, "/Set/box", rig).track.at(CODES)
    turn = np.eye(4)
    turn[:3, :3] = so3.to_matrix(up_from_up(rig, UpAxis(file)))
    expected = turn @ in_metres(prop_matrices(path, "/Set/box", CODES), 0.01)
    assert_allclose(found.matrix(), expected, atol=1e-12)


def test_between_keys_it_is_what_usd_says(tmp_path: Path) -> None:
    path = write_props(tmp_path / "props.usda")
    times = np.random.default_rng(0).uniform(1, 40, 50)
    found = opened(path, "/Set/box").track.at(times)
    expected = in_metres(prop_matrices(path, "/Set/box", times), 0.01)
    assert_allclose(found.matrix(), expected, atol=1e-12)


def test_times_that_rounding_left_props_a_key_are_on_it(tmp_path: Path) -> None:
    source = opened(
        write_props(tmp_path / "props.usda"), "/Set/box", attributes=("state",)
    )
    state = source.track.attributes[0]
    near = source.track.at(CODES - 1e-11).values[0]
    assert_array_equal(near, source.track.at(CODES).values[0])
    assert [state.choices[i] for i in near] == ["dry"] * 19 + ["wet"] * 21


def test_shear_is_a_matrix(tmp_path: Path) -> None:
    path = write_props(tmp_path / "props.usda", shear=True)
    source = opened(path, "/Set/box")
    assert source.has_shear
    found = source.track.at(CODES)
    expected = in_metres(prop_matrices(path, "/Set/box", CODES), 0.01)
    assert_allclose(found.matrix(), expected, atol=1e-12)


def test_shear_between_keys_is_measured(tmp_path: Path) -> None:
    path = write_props(tmp_path / "props.usda")
    source = opened(path, "/Set/camera")
    source.track.at(CODES)
    assert source.max_shear() < 1e-11
    # USD blends matrices number by number.
    source.track.at(CODES[:-1] + 0.5)
    assert 1e-9 < source.max_shear() < 1e-3


def test_what_a_camera_has(tmp_path: Path) -> None:
    source = opened(write_props(tmp_path / "props.usda"), "/Set/camera")
    track = source.track
    found = dict(
        zip([a.name for a in track.attributes], track.at(CODES).values, strict=True)
    )
    assert track.type_name == "Camera"
    assert source.fallback_attributes == ()
    assert_allclose(found["focalLength"][:, 0], 0.01 * (35 + CODES / 10), rtol=1e-6)
    assert_allclose(found["clippingRange"], [[0.01, 50]] * 40, rtol=1e-6)
    assert_allclose(found["focusDistance"][:, 0], 6 - 0.04 * CODES, rtol=1e-6)
    assert set(found) == {
        "focalLength",
        "horizontalAperture",
        "verticalAperture",
        "clippingRange",
        "focusDistance",
    }


def test_a_camera_without_values(tmp_path: Path) -> None:
    source = opened(write_props(tmp_path / "props.usda"), "/Bare")
    names = ("focalLength", "horizontalAperture", "verticalAperture")
    assert source.fallback_attributes == names
    assert source.span is None
    values = source.track.at(CODES).values
    assert_allclose(values[0], np.full((40, 1), 0.5))


def test_what_is_still_is_read_once(tmp_path: Path) -> None:
    source = opened(write_props(tmp_path / "props.usda"), "/Post")
    assert not source.track.is_animated
    assert source.span is None
    found = source.track.at(np.array([1.0, 900.0]))
    assert_allclose(found.translations, [[0.01, 0.02, 0.03]] * 2)


def test_attributes_alone(tmp_path: Path) -> None:
    path = write_props(tmp_path / "props.usda")
    track = opened(path, "/Settings", attributes=("level",)).track
    assert not track.has_transform
    assert track.at(CODES[:2]).values[0].tolist() == [[2.5], [2.5]]
    wet = opened(path, "/Set/box", attributes=("wetness",)).track
    assert wet.attributes[0].width == 4
    assert_allclose(wet.at(CODES[:1]).values[0], [[1 / 40, 0, 1, 1 / 9]], rtol=1e-6)


def test_rate_and_range(tmp_path: Path) -> None:
    path = write_props(tmp_path / "props.usda", fps=23.976, first=1001)
    source = opened(path, "/Set/box")
    assert source.fps == Fraction(24000, 1001)
    assert source.span == (1001, 1040)
    assert source.keys[[0, -1]].tolist() == [1001, 1040]


@pytest.mark.parametrize(
    ("prim", "attributes", "code", "hint"),
    [
        ("/Set/bax", (), "SCN048", "/Set/box"),
        ("Set/box", (), "SCN048", "/Set/box"),
        ("/Settings", (), "SCN048", "attributes"),
        ("/Set/box", ("stat",), "SCN049", "state"),
        ("/Settings", ("many",), "SCN049", "numbers"),
        ("/Set/box", ("xformOp:scale",), "SCN049", "remove"),
    ],
)
def test_what_is_refused(
    tmp_path: Path, prim: str, attributes: tuple[str, ...], code: str, hint: str
) -> None:
    path = write_props(tmp_path / "props.usda")
    with pytest.raises(OptionError) as error:
        opened(path, prim, attributes=attributes)
    assert error.value.code == code
    assert hint in str(error.value.faults[0].hint)


def test_what_is_not_finite_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "odd.usda"
    path.write_text(
        "#usda 1.0\n"
        'def Xform "box"\n{\n'
        "    double3 xformOp:translate.timeSamples = {1: (0, 0, 0), 2: (nan, 0, 0)}\n"
        '    uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n'
    )
    with pytest.raises(FormatError) as error:
        opened(path, "/box")
    assert error.value.code == "USD171"


def test_a_reference_needs_a_default_prim(tmp_path: Path) -> None:
    path = write_props(tmp_path / "props.usda")
    other = tmp_path / "empty.usda"
    other.write_text("#usda 1.0\n")
    with pytest.raises(OptionError) as error:
        opened(path, "/Set/box", reference=other)
    assert error.value.code == "SCN048"
