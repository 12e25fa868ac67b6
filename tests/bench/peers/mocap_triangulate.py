"""Triangulation as aniposelib and OpenCV do it, called as their authors would.

``mocap_triangulate.py ROUTE GIVEN MADE``: ``GIVEN`` has pixels ``(C, N, 2)`` and
cameras ``(C, 27)`` as the kernels of animtool have them; ``MADE`` gets the points
``(N, 3)``.
"""

from __future__ import annotations

import itertools
import json
import sys
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from clock import timed


def lens(row: Any) -> tuple[Any, Any, Any]:
    """Return camera matrix, distortion and the first three columns' pose ``(3, 4)``."""
    fx, fy, cx, cy, skew = row[:5]
    matrix = np.array([[fx, skew, cx], [0, fy, cy], [0, 0, 1]])
    pose = np.column_stack([row[13:22].reshape(3, 3), row[22:25]])
    return matrix, row[5:10], pose


def aniposelib(pixels: Any, cameras: Any, *, fast: bool) -> Callable[[], Any]:
    """Return its `CameraGroup.triangulate`."""
    from aniposelib.cameras import Camera, CameraGroup

    made = []
    for row in cameras:
        matrix, distortion, pose = lens(row)
        turn = cv2.Rodrigues(pose[:, :3])[0].ravel()
        made.append(
            Camera(matrix=matrix, dist=distortion, rvec=turn, tvec=pose[:, 3].copy())
        )
    group = CameraGroup(made)
    return lambda: group.triangulate(pixels, undistort=True, fast=fast)


def opencv(pixels: Any, cameras: Any) -> Any:
    """Return the median of the points of all pairs of cameras."""
    straight, poses = [], []
    for seen, row in zip(pixels, cameras, strict=True):
        matrix, distortion, pose = lens(row)
        points = cv2.undistortPoints(seen[:, None], matrix, distortion)
        straight.append(points[:, 0].T)
        poses.append(pose)
    found = []
    for i, j in itertools.combinations(range(len(poses)), 2):
        made = cv2.triangulatePoints(poses[i], poses[j], straight[i], straight[j])
        found.append((made[:3] / made[3]).T)
    return np.nanmedian(found, axis=0)


def main() -> None:
    """Time one route and keep its points."""
    route, given, made = sys.argv[1:]
    with np.load(given) as arrays:
        pixels, cameras = arrays["pixels"], arrays["cameras"]
    work: Callable[[], Any]
    if route == "opencv":
        work = lambda: opencv(pixels, cameras)  # noqa: E731
    else:
        work = aniposelib(pixels, cameras, fast=route == "fast")
    kept: list[Any] = []
    cv2.setNumThreads(1)
    taken = timed(lambda: kept.append(work()))
    np.save(made, kept[0])
    print(json.dumps({"taken": [[taken.wall, taken.cpu]]}))


if __name__ == "__main__":
    main()
