"""Calibrations of other programs, and the keypoints that their cameras see."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from support.stage import ring

from animtool.capture.cameras import Camera, load_cameras, project, read_keypoints
from animtool.core.errors import AnimtoolError
from animtool.maths.so3 import from_matrix, log
from fuzz.mutations import pick, spoil

ABOUT = "calibrations (JSON, OpenCV, TOML) and OpenPose keypoints, read"
STAGE = ring(3)


def _matrix(camera: Camera) -> list[list[float]]:
    (fx, fy), (cx, cy) = camera.focal, camera.centre
    return [[fx, camera.skew, cx], [0, fy, cy], [0, 0, 1]]


def _listed() -> str:
    entries = [
        {
            "name": c.name, "size": [1920, 1080], "K": _matrix(c),
            "R": c.rotation.tolist(), "t": c.translation.tolist(),
            "dist": list(c.distortion[:5]),
        }
        for c in STAGE.cameras
    ]  # fmt: skip
    return json.dumps({"units": "mm", "cameras": entries})


def _toml(camera: Camera) -> str:
    rows = [list(map(float, row)) for row in _matrix(camera)]
    turn = log(from_matrix(camera.rotation)).tolist()
    return (
        f"[{camera.name}]\nname = '{camera.name}'\nsize = [1920.0, 1080.0]\n"
        f"matrix = {rows}\ndistortions = {list(camera.distortion[:5])}\n"
        f"rotation = {turn}\ntranslation = {camera.translation.tolist()}\n"
        "fisheye = false\n"
    )


def _opencv(camera: Camera) -> str:
    def array(key: str, values: object) -> str:
        found = np.asarray(values, np.float64).reshape(-1, 1)
        rows = len(found)
        return (
            f"{key}: !!opencv-matrix\n   rows: {rows}\n   cols: 1\n   dt: d\n"
            f"   data: {found.ravel().tolist()}\n"
        )

    return (
        "%YAML:1.0\n---\nimage_width: 1920\nimage_height: 1080\n"
        + array("camera_matrix", _matrix(camera)).replace(
            "rows: 9\n   cols: 1", "rows: 3\n   cols: 3"
        )
        + array("distortion_coefficients", camera.distortion[:5])
        + array("rvec", log(from_matrix(camera.rotation)))
        + array("tvec", camera.translation)
    )


def _people(camera: Camera) -> str:
    points = np.random.default_rng(3).normal((0, 1, 0), 0.3, (18, 3))
    rows = np.column_stack([project(camera, points), np.full(18, 0.9)])
    return json.dumps({"people": [{"pose_keypoints_2d": rows.ravel().tolist()}]})


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    seeds = [
        (".json", _listed()),
        (".toml", "".join(map(_toml, STAGE.cameras))),
        (".yaml", _opencv(STAGE.cameras[0])),
    ]
    frames = []
    for camera in STAGE.cameras:
        (folder / "keypoints" / camera.name).mkdir(parents=True)
        for f in range(2):
            name = f"take_{f:012d}_keypoints.json"
            path = folder / "keypoints" / camera.name / name
            path.write_text(_people(camera), "utf-8")
            frames.append((path, path.read_bytes()))

    def calibration(rng: np.random.Generator) -> None:
        suffix, text = pick(rng, seeds)
        path = folder / f"stage{suffix}"
        path.write_bytes(spoil(rng, text.encode()))
        for camera in load_cameras(path).cameras:
            assert np.isfinite(camera.kernel_parameters).all()

    def keypoints(rng: np.random.Generator) -> None:
        path, data = pick(rng, frames)
        path.write_bytes(spoil(rng, data))
        try:
            seen = read_keypoints(folder / "keypoints", STAGE, fps=30)
        finally:
            path.write_bytes(data)
        assert not np.isinf(seen.stored).any()

    def run(rng: np.random.Generator) -> str:
        try:
            calibration(rng) if rng.integers(2) else keypoints(rng)
        except AnimtoolError as error:
            return error.code
        return "read"

    return run
