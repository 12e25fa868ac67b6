"""Camera files, and calibrations of other programs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.stage import cameras_text, ring

from animtool.capture.cameras import Camera, Cameras, load_cameras
from animtool.capture.cameras.file import load_all_cameras
from animtool.core.errors import FormatError
from animtool.core.units import LengthUnit, UpAxis
from animtool.maths.so3 import from_matrix, log, to_matrix

STAGE = ring(3)


def same(found: Cameras, wanted: Cameras = STAGE) -> None:
    assert found.names == wanted.names
    for one, other in zip(found.cameras, wanted.cameras, strict=True):
        np.testing.assert_allclose(
            one.kernel_parameters, other.kernel_parameters, atol=1e-9
        )


def written(path: Path, text: str) -> Path:
    path.write_text(text, "utf-8")
    return path


def matrix(camera: Camera) -> list[list[float]]:
    (fx, fy), (cx, cy) = camera.focal, camera.centre
    return [[fx, camera.skew, cx], [0, fy, cy], [0, 0, 1]]


def test_our_files(tmp_path: Path) -> None:
    same(load_cameras(written(tmp_path / "a.cameras.yaml", cameras_text(STAGE))))


def test_lists_of_arrays(tmp_path: Path) -> None:
    entries = [
        {
            "name": c.name, "width": 1920, "height": 1080, "K": matrix(c),
            "R": c.rotation.tolist(), "t": (1000 * c.translation).tolist(),
            "dist": c.distortion[:5],
        }
        for c in STAGE.cameras
    ]  # fmt: skip
    text = json.dumps({"units": "mm", "cameras": entries})
    same(load_cameras(written(tmp_path / "a.cameras.json", text)))


def toml_of(camera: Camera, scale: float) -> str:
    turn = log(from_matrix(camera.rotation)).tolist()
    return (
        f"[{camera.name}]\nname = '{camera.name}'\nsize = [1920.0, 1080.0]\n"
        f"matrix = {[list(map(float, row)) for row in matrix(camera)]}\n"
        f"distortions = {list(camera.distortion[:5])}\nrotation = {turn}\n"
        f"translation = {(scale * camera.translation).tolist()}\nfisheye = false\n\n"
    )


def test_toml(tmp_path: Path) -> None:
    text = "".join(toml_of(c, 1000) for c in STAGE.cameras)
    path = written(tmp_path / "a.toml", f"{text}[metadata]\nadjusted = false\n")
    found = load_cameras(path, unit=LengthUnit.MM, up=UpAxis.Z)
    same(found)
    assert found.up is UpAxis.Z


def opencv(camera: Camera) -> str:
    def stored(values: Any) -> str:
        values = np.atleast_2d(np.array(values, float))
        rows, columns = values.shape
        data = ", ".join(
            f"{v:.17g}" + ("." if v == int(v) else "") for v in values.flat
        )
        return (
            f"!!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n"
            f"   data: [ {data} ]\n"
        )

    return (
        "%YAML:1.0\n---\nimage_width: 1920\nimage_height: 1080\n"
        f"camera_matrix: {stored(matrix(camera))}"
        f"distortion_coefficients: {stored(camera.distortion[:5])}"
        f"R: {stored(camera.rotation)}T: {stored(camera.translation[:, None])}"
    )


def test_a_template_is_not_a_cameras_file(tmp_path: Path) -> None:
    path = written(tmp_path / "hero.markers.yaml", "markers: animtool/1\nrig: a.yaml\n")
    with pytest.raises(FormatError) as caught:
        load_all_cameras([path])
    (fault,) = caught.value.faults
    assert (fault.code, fault.lines) == ("DOC009", (1,))
    assert "--template" in (fault.hint or "")


def test_opencv(tmp_path: Path) -> None:
    paths = [
        written(tmp_path / f"{camera.name}.yml", opencv(camera))
        for camera in STAGE.cameras
    ]
    several = load_all_cameras(paths)
    same(several)
    assert (several.path, several.up) == (str(paths[0]), UpAxis.Y)
    assert load_all_cameras(paths, up=UpAxis.Z).up == UpAxis.Z
    lying = cameras_text(Cameras(STAGE.cameras[2:])).replace("views", "up: Z\nviews")
    paths[2] = written(tmp_path / "z.cameras.yaml", lying)
    with pytest.raises(FormatError, match="its up axis is Z, but that of") as refused:
        load_all_cameras(paths)
    assert [fault.code for fault in refused.value.faults] == ["CAM003"]
    camera = STAGE.cameras[0]
    both = {
        camera.name: {
            "cameraMatrix": {"type_id": "opencv-matrix", "rows": 3, "cols": 3,
                             "data": np.ravel(matrix(camera)).tolist()},
            "distCoeffs": list(camera.distortion),
            "rvec": log(from_matrix(camera.rotation)).tolist(),
            "tvec": [[v] for v in camera.translation.tolist()],
            "image_size": [1920, 1080],
        }
    }  # fmt: skip
    found = load_cameras(written(tmp_path / "both.json", json.dumps(both)))
    same(found, Cameras(STAGE.cameras[:1]))


GOOD = """\
cameras: animtool/1
views:
- {name: a, focal: [1300, 1300], centre: [960, 540], rotation: [1, 0, 0, 0], translation: [0, 0, 4]}
- {name: b, focal: [1300, 1300], centre: [960, 540], rotation: [[0,0,1],[0,1,0],[-1,0,0]], translation: [0, 0, 4]}
"""  # noqa: E501


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("name: b", "name: a", "CAM002"),
        ("[1, 0, 0, 0]", "[2, 0, 0, 0]", "CAM001"),
        ("[0,1,0]", "[0,-1,0]", "CAM001"),
        ("[0,1,0]", "[0,1,1]", "CAM001"),
        ("focal: [1300, 1300]", "focal: [0, 1300]", "DOC022"),
        ("focal: [1300, 1300]", "focal: [.nan, 1300]", "DOC022"),
        ("[0, 0, 4]", "[0, 0, .inf]", "DOC022"),
        ("[0, 0, 4]", "[0, 0]", "DOC022"),
        ("centre", "center", "DOC020"),
        ("animtool/1", "animtool/7", "DOC012"),
    ],
)
def test_faults_have_lines(tmp_path: Path, old: str, new: str, code: str) -> None:
    path = written(tmp_path / "a.cameras.yaml", GOOD)
    assert len(load_cameras(path)) == 2
    written(path, GOOD.replace(old, new, 1))
    with pytest.raises(FormatError) as caught:
        load_cameras(path)
    (fault,) = caught.value.faults
    assert fault.code == code
    assert fault.lines


def spoil(entry: dict[str, Any], key: str, value: Any) -> dict[str, Any]:
    changed = {**entry, key: value}
    return {k: v for k, v in changed.items() if v is not None}


@pytest.mark.parametrize(
    ("key", "value", "code"),
    [
        ("K", None, "CAM003"),
        ("K", [[1, 0, 0], [0, 0, 0], [0, 0, 1]], "CAM003"),
        ("K", [[1e3, 0, 5], [0, 1e3, 5], [0, 0, 0]], "CAM003"),
        ("K", [[1e3, 0, 5], [0, float("nan"), 5], [0, 0, 1]], "CAM003"),
        ("K", "none", "CAM003"),
        ("K", [[1, 2], [3]], "CAM003"),
        ("R", None, "CAM003"),
        ("R", np.diag([1, 1, -1]).tolist(), "CAM001"),
        ("R", np.diag([1, 1, 1.1]).tolist(), "CAM001"),
        ("R", [[1e300] * 3] * 3, "CAM003"),
        ("R", [1, 2], "CAM001"),
        ("t", [1, 2], "CAM003"),
        ("t", [1, 2, float("inf")], "CAM003"),
        ("t", [1, 2, 1e300], "CAM003"),
        ("R", [1e308, 1e308, 0], "CAM003"),
        ("t", [1, 2, 10**400], "DOC001"),
        ("dist", [0.1], None),
        ("dist", [0] * 12, None),
        ("dist", [0] * 11 + [1], "CAM003"),
        ("dist", [0] * 13, "CAM003"),
        ("width", -1, "CAM003"),
        ("fisheye", True, "CAM003"),
    ],
)
def test_faults_of_others(
    tmp_path: Path, key: str, value: Any, code: str | None
) -> None:
    camera = STAGE.cameras[0]
    entry = {
        "name": "a", "width": 1920, "height": 1080, "K": matrix(camera),
        "R": camera.rotation.tolist(), "t": camera.translation.tolist(),
        "dist": [0, 0, 0, 0, 0],
    }  # fmt: skip
    text = json.dumps({"cameras": [spoil(entry, key, value)]})
    text = text.replace("NaN", ".nan").replace("Infinity", ".inf")
    path = written(tmp_path / "a.yaml", text)
    if code is None:
        assert len(load_cameras(path)) == 1
        return
    with pytest.raises(FormatError) as caught:
        load_cameras(path)
    assert [fault.code for fault in caught.value.faults] == [code]
    assert caught.value.faults[0].path == str(path)


@pytest.mark.parametrize(
    ("units", "ahead"),
    [("mm", 0.004), ({"length": "cm"}, 0.04), (None, 4), (["mm"], None), ("ell", None)],
)
def test_units_of_a_calibration(
    tmp_path: Path, units: Any, ahead: float | None
) -> None:
    camera = STAGE.cameras[0]
    entry = {"K": matrix(camera), "R": camera.rotation.tolist(), "t": [0, 0, 4]}
    text = json.dumps({"units": units, "cameras": [entry]})
    path = written(tmp_path / "a.json", text)
    if ahead is not None:
        (found,) = load_cameras(path).cameras
        assert found.translation[2] == pytest.approx(ahead)
        return
    with pytest.raises(FormatError) as caught:
        load_cameras(path)
    assert caught.value.code == "CAM003"


def test_what_is_no_calibration(tmp_path: Path) -> None:
    for name, text, code in (
        ("a.toml", "[cam\n", "CAM003"),
        ("b.toml", "", "CAM003"),
        ("c.yaml", "rig: animtool/1\n", "DOC009"),
        ("d.json", '{"cameras": []}', "CAM003"),
        ("e.yml", "%YAML:1.0\n---\nK: !!opencv-matrix\n", "CAM003"),
        ("f.json", "[1, 2]", "DOC007"),
        ("deep.toml", f"{'.'.join('a' * 20_000)} = 1", "CAM003"),
    ):
        with pytest.raises(FormatError) as caught:
            load_cameras(written(tmp_path / name, text))
        assert caught.value.code == code, name
    table = toml_of(STAGE.cameras[0], 1)
    path = written(
        tmp_path / "g.toml", f"# a\n{table}{table.replace('cam0', 'cam1', 1)}"
    )
    with pytest.raises(FormatError) as caught:
        load_cameras(path)
    assert (caught.value.code, caught.value.faults[0].lines) == ("CAM002", (11,))


@pytest.mark.parametrize(
    ("unit", "far"), [("m", 4.0), ("cm", 0.04), ("mm", 0.004), ("in", 0.1016)]
)
def test_ours_are_in_the_unit_that_they_say(
    tmp_path: Path, unit: str, far: float
) -> None:
    """Translations are; what a camera has of its lens is filled up with zeros."""
    text = GOOD.replace("views:", f"units: {{length: {unit}}}\nup: Z\nviews:")
    text = text.replace(
        "name: a,", "name: a, skew: 2, distortion: [0.1, 0.2, 0.3, 0.4],"
    )
    found = load_cameras(written(tmp_path / "a.cameras.yaml", text))
    first, second = found.cameras
    np.testing.assert_allclose(first.translation, [0, 0, far])
    np.testing.assert_allclose(second.rotation, [[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    assert (first.focal, first.centre, first.size) == ((1300, 1300), (960, 540), None)
    assert (first.skew, first.distortion) == (2, (0.1, 0.2, 0.3, 0.4, 0, 0, 0, 0))
    assert found.up is UpAxis.Z


def test_a_quaternion_that_is_nearly_of_length_1_is_a_rotation(tmp_path: Path) -> None:
    """Within a hundredth of it, written w first."""
    turn = np.array([0.5, -0.5, 0.1, 0.7])
    unit = turn / np.linalg.norm(turn)
    for length, good in ((1.009, True), (0.991, True), (1.011, False), (0.989, False)):
        q = ", ".join(map(repr, (length * unit).tolist()))
        text = GOOD.replace("[1, 0, 0, 0]", f"[{q}]")
        path = written(tmp_path / "a.cameras.yaml", text)
        if not good:
            with pytest.raises(FormatError, match="CAM001"):
                load_cameras(path)
            continue
        found = load_cameras(path).cameras[0].rotation
        np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(found, to_matrix(np.roll(unit, -1)), atol=1e-12)


@pytest.mark.parametrize(
    ("focal", "size", "hint"),
    [
        (24, "[1920, 1080]", "24 * 1920 / 36 = 1280"),
        (85, "", "85 * 1920 / 36 = 4533"),
        (0.7, "[1280, 1080]", "0.7 * 1280 = 896"),
        (300, "[1920, 1080]", None),
        (1300, "", None),
    ],
)
def test_focal_lengths_in_millimetres(
    tmp_path: Path, focal: float, size: str, hint: str | None
) -> None:
    text = GOOD.replace("1300", str(focal))
    text = text.replace("name: a,", f"name: a, size: {size}," if size else "name: a,")
    notices = load_cameras(written(tmp_path / "a.cameras.yaml", text)).notices
    assert [one.code for one in notices] == ["CAM114"] * (hint is not None)
    for notice in notices:
        assert notice.where == "views[0].focal"
        assert hint is not None
        assert hint in str(notice.hint)


def spread_warnings(path: Path, unit: LengthUnit | None = None) -> list[str]:
    notices = load_cameras(path, unit=unit).notices
    assert {notice.code for notice in notices} <= {"CAM113"}
    return [f"{notice.message}; {notice.hint}" for notice in notices]


def test_cameras_too_far_apart_are_in_another_unit(tmp_path: Path) -> None:
    """Theirs are 4.5 m from the middle."""
    far = [Camera(c.name, c.focal, c.centre, c.rotation, 1000 * c.translation)
           for c in STAGE.cameras]  # fmt: skip
    path = written(tmp_path / "a.cameras.yaml", cameras_text(Cameras(tuple(far))))
    (text,) = spread_warnings(path)
    assert "in mm it would be 7.8" in text or "in mm it would be 7.9" in text
    assert "write units: {length: mm} in the file" in text
    # An argument is the unit of a file that states none.
    assert not spread_warnings(path, LengthUnit.MM)
    read = load_cameras(path, unit=LengthUnit.MM).cameras[1]
    np.testing.assert_allclose(read.position, STAGE.cameras[1].position, atol=1e-9)
    stated = path.read_text("utf-8").replace("views:", "units: {length: m}\nviews:")
    (text,) = spread_warnings(written(path, stated), LengthUnit.MM)
    assert text.endswith("write units: {length: mm} in the file")
    close = path.read_text("utf-8").replace("length: m}", "length: mm}")
    assert not spread_warnings(written(path, close))
    entries = [{"K": matrix(c), "R": c.rotation.tolist(), "t": c.translation.tolist()}
               for c in far]  # fmt: skip
    path = written(tmp_path / "a.json", json.dumps({"cameras": entries}))
    assert len(spread_warnings(path)) == 1
    assert not spread_warnings(path, LengthUnit.MM)


def test_a_stadium_and_a_pair_of_lenses_are_plausible(tmp_path: Path) -> None:
    for scale in (0.01, 30.0):
        cameras = [Camera(c.name, c.focal, c.centre, c.rotation, scale * c.translation)
                   for c in STAGE.cameras]  # fmt: skip
        text = cameras_text(Cameras(tuple(cameras)))
        assert not spread_warnings(written(tmp_path / "a.cameras.yaml", text))


def test_an_option_that_contradicts_the_unit_of_a_calibration(tmp_path: Path) -> None:
    entries = [{"K": matrix(c), "R": c.rotation.tolist(), "t": c.translation.tolist()}
               for c in STAGE.cameras]  # fmt: skip
    text = json.dumps({"units": "m", "cameras": entries})
    (warning,) = spread_warnings(written(tmp_path / "a.json", text), LengthUnit.MM)
    assert warning.endswith("the file states m")
