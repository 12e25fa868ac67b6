"""Observations in npz files, and keypoints of OpenPose with several people."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.stage import observed, ring, walkers, write_observations

from animtool.capture.cameras import (
    project,
    read_keypoints,
    read_observations,
    triangulate,
)
from animtool.core.array_types import FloatArray
from animtool.core.errors import AnimtoolError, FormatError

STAGE = ring(4)
POINTS = walkers(30, 5)
SEEN = observed(STAGE, POINTS)


def test_floats_and_eighths(tmp_path: Path) -> None:
    found = read_observations(write_observations(tmp_path / "a.npz", SEEN))
    assert (found.names, found.cameras) == (SEEN.names, SEEN.cameras)
    assert found.clock.rate == 120
    np.testing.assert_array_equal(found.pixels(0, 30), SEEN.stored)
    eighths = np.round(8 * SEEN.stored).astype(np.uint16)
    eighths[3, 1, 2] = 65535
    path = write_observations(tmp_path / "b.npz", SEEN, uv=None, uv8=eighths)
    pixels = read_observations(path, fps="59.94").pixels(2, 9, 1)
    assert np.isnan(pixels[1, 1, 2]).all()
    assert np.nanmax(abs(pixels - SEEN.stored[2:9])) <= 1 / 16 + 1e-9
    assert read_observations(path, fps="59.94").clock.rate == pytest.approx(
        59.94, rel=1e-4
    )


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"uv": None}, "no array 'uv'"),
        ({"uv": np.zeros((4, 2, 2))}, "shape"),
        ({"uv": np.zeros((0, 4, 5, 2))}, "empty"),
        ({"uv": np.zeros((1, 300, 5, 2))}, "300 cameras"),
        ({"uv": np.zeros((30, 4, 5, 2), np.uint16)}, "floats"),
        ({"uv": np.full((30, 4, 5, 2), np.inf)}, "infinity"),
        ({"marker_names": np.array(["a"])}, "marker_names"),
        ({"camera_names": np.array(["a"])}, "camera_names"),
        ({"marker_names": np.arange(5)}, "is not a list of texts"),
        ({"fs": None}, "no number 'fs'"),
        ({"fs": np.array(np.nan)}, "not a frame rate"),
        ({"fs": np.array([1.0, 2.0])}, "not a frame rate"),
        ({"confidence": np.ones((30, 4))}, "confidence"),
        ({"confidence": np.full((30, 4, 5), np.nan)}, "not finite"),
        ({"uv": np.array([{}])}, "pickled"),
    ],
)
def test_faults(tmp_path: Path, more: dict[str, Any], words: str) -> None:
    path = write_observations(tmp_path / "a.npz", SEEN, **more)
    with pytest.raises(FormatError) as caught:
        read_observations(path)
    assert caught.value.code == "CAM010"
    assert words in caught.value.faults[0].message


def test_files_that_are_cut_short(tmp_path: Path) -> None:
    path = write_observations(tmp_path / "a.npz", SEEN)
    data = path.read_bytes()
    for end in (0, 10, 200, len(data) // 2, len(data) - 5):
        path.write_bytes(data[:end])
        with pytest.raises(FormatError) as caught:
            read_observations(path)
        assert caught.value.code == "CAM010"
    with pytest.raises(FormatError) as caught:
        read_observations(tmp_path / "none.npz")
    assert caught.value.code == "IO001"


def people(frames: int) -> FloatArray:
    """Return two people who pass each other ``(P, F, 25, 3)`` [m]."""
    rng = np.random.default_rng(4)
    body = rng.uniform([-0.3, 0, -0.2], [0.3, 1.7, 0.2], (2, 1, 25, 3))
    along = np.linspace(-1, 1, frames)[None, :, None]
    path = np.zeros((2, frames, 1, 3))
    path[0, ..., 0] = along[0]
    path[1, ..., 0] = -along[0]
    path[..., 2] = np.array([0.5, -0.5])[:, None, None]
    return body + path


def keypoint_folder(folder: Path, bodies: FloatArray) -> Path:
    rng = np.random.default_rng(7)
    for c, camera in enumerate(STAGE.cameras):
        (folder / f"{camera.name}_json").mkdir(parents=True)
        for f in range(bodies.shape[1]):
            entries = []
            for p in rng.permutation(len(bodies)):
                if (f, c, p) in {(5, 1, 0), (9, 2, 1)}:
                    continue
                pixels = project(camera, bodies[p, f]) + rng.normal(0, 2, (25, 2))
                rows = np.column_stack([pixels, rng.uniform(0.5, 1, 25)])
                rows[rng.random(25) < 0.05] = 0
                entries.append({"pose_keypoints_2d": rows.ravel().tolist()})
            if f == 12 and c == 0:
                stray = np.column_stack([rng.uniform(0, 900, (25, 2)), np.ones(25)])
                entries.insert(0, {"pose_keypoints_2d": stray.ravel().tolist()})
            text = json.dumps({"version": 1.3, "people": entries})
            name = f"take_{f + 100:012d}_keypoints.json"
            (folder / f"{camera.name}_json" / name).write_text(text, "utf-8")
    return folder


def test_people_are_told_apart(tmp_path: Path) -> None:
    bodies = people(40)
    folder = keypoint_folder(tmp_path / "pose", bodies)
    seen = read_keypoints(folder, STAGE, fps=30)
    assert len(seen.names) == 50
    assert seen.names[0] == "person1_Nose"
    assert (seen.clock.start, seen.clock.count, seen.clock.rate) == (100, 40, 30)
    found = triangulate(seen, STAGE).markers.positions.reshape(40, 2, 25, 3)
    truth = np.moveaxis(bodies, 0, 1)
    off = np.linalg.norm(found - truth, axis=-1)
    other = np.linalg.norm(found[:, ::-1] - truth, axis=-1)
    best = off if np.nanmedian(off) < np.nanmedian(other) else other
    assert np.nanmax(np.nanmedian(best, axis=2)) < 0.03
    assert np.isfinite(best).mean() > 0.97
    one = read_keypoints(folder, STAGE, fps=30, people=1)
    assert (len(one.names), one.names[8]) == (25, "MidHip")


def test_faults_of_keypoints(tmp_path: Path) -> None:
    folder = keypoint_folder(tmp_path / "pose", people(3))
    path = folder / "cam1_json/take_000000000101_keypoints.json"
    good = path.read_text("utf-8")
    for text in (
        "", "{", "[]", "{}", '{"people": 3}', '{"people": [{}]}', "[" * 100_000,
        '{"people": [{"pose_keypoints_2d": [1, 2]}]}',
        '{"people": [{"pose_keypoints_2d": []}]}',
        '{"people": [{"pose_keypoints_2d": ["a", 1, 1]}]}',
        '{"people": [{"pose_keypoints_2d": [1, 2, 3]}]}',
        json.dumps({"people": [{"pose_keypoints_2d": [1, 2, 3]}] * 200}),
        json.dumps({"people": [{"pose_keypoints_2d": [1.0] * 9000}]}),
    ):  # fmt: skip
        path.write_text(text, "utf-8")
        with pytest.raises(FormatError) as caught:
            read_keypoints(folder, STAGE, fps=30)
        assert caught.value.code == "CAM010"
    path.write_text(good, "utf-8")
    with pytest.raises(AnimtoolError) as fault:
        read_keypoints(folder, STAGE, fps=None)
    assert fault.value.code == "CAM010"
    (folder / "cam1_json").rename(folder / "cam7_json")
    with pytest.raises(AnimtoolError) as fault:
        read_keypoints(folder, STAGE, fps=30)
    assert fault.value.code == "CAM011"
    (tmp_path / "empty").mkdir()
    with pytest.raises(FormatError) as caught:
        read_keypoints(tmp_path / "empty", STAGE, fps=30)
    assert caught.value.code == "CAM010"


@pytest.mark.parametrize(
    ("text", "message", "hint"),
    [
        ('{"people": []}', "a folder of OpenPose keypoints", "mocap triangulate pose/"),
        ('{"cameras": []}', "holds cameras, not observations; pass it as", "npz"),
        ('[{"K": 1}]', "holds cameras, not observations; pass it as", "npz"),
        ("{}", "is a JSON file; observations are", "npz"),
    ],
)
def test_a_json_file_in_place_of_observations_is_told_what_it_is(
    tmp_path: Path, text: str, message: str, hint: str
) -> None:
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(FormatError) as error:
        read_observations(path)
    (fault,) = error.value.faults
    assert fault.code == "CAM010"
    assert message in fault.message
    assert hint in (fault.hint or "")


def test_positions_are_triangulated_already(tmp_path: Path) -> None:
    path = tmp_path / "take.npz"
    np.savez(path, fs=120, markers_m=np.ones((4, 2, 3)))
    c3d = tmp_path / "take.c3d"
    c3d.write_bytes(b"\x02\x50" + bytes(600))
    for file in (path, c3d):
        with pytest.raises(FormatError) as caught:
            read_observations(file)
        (fault,) = caught.value.faults
        assert fault.code == "CAM010"
        assert fault.hint is not None
        assert fault.hint.endswith(f"animtool mocap solve {file}")
    np.savez(path, fs=120, points=np.ones((4, 2, 3)))
    with pytest.raises(FormatError) as caught:
        read_observations(path)
    assert "uv (frames, cameras, markers, 2)" in str(caught.value.faults[0].hint)
    for content, hint in ((b"", "export or copy it again"), (b"PK\x03\x04 ab", None)):
        path.write_bytes(content)
        with pytest.raises(FormatError) as caught:
            read_observations(path)
        assert caught.value.faults[0].hint == hint
