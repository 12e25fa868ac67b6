"""Observations with known truth: as near to it as what is wrong in them allows."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np
import pytest
from support.data import data_files

from animtool.capture.cameras import (
    Observations,
    TriangulateOptions,
    Triangulation,
    load_cameras,
    read_observations,
    triangulate,
)
from animtool.core.array_types import BoolArray, FloatArray
from animtool.maths import so3
from animtool.validation.run import validate

# Against the root mean square of a solve that knows which observations are wrong.
MAX_RATIO = 1.005
# How far any point may be off [mm].
MAX_ERROR = 5.0
HEAD = (
    f"{'data':24}{'points':>8}{'rms mm':>9}{'clean':>9}{'ratio':>9}{'p99.9':>8}"
    f"{'max':>8}{'missing':>9}{'points/s':>10}{'px':>8}{'mm':>8}"
)


@pytest.mark.parametrize("path", data_files("mocap", "cam_*.npz"))
def test_points_are_as_near_as_clean_observations(
    path: Path, record_property: Callable[[str, object], None]
) -> None:
    cameras = load_cameras(path.with_suffix(".cameras.json"))
    seen = read_observations(path)
    begun = process_time()
    found = triangulate(seen, cameras)
    seconds = process_time() - begun
    with np.load(path) as arrays:
        truth = arrays["xyz_true_mm"].astype(np.float64)
        shape = tuple(arrays["flag_shape"])
        wrong = sum(
            np.unpackbits(arrays[key])[: np.prod(shape)].reshape(shape)
            for key in ("outlier", "swapped")
        ).astype(bool)
    clean = triangulate(
        _without(seen, wrong), cameras, TriangulateOptions(noise=0.5, gate=1e6)
    )
    error, best = _off(found, truth), _off(clean, truth)
    rms, floor = (float(np.sqrt(np.nanmean(e**2))) for e in (error, best))
    worst, p999 = float(np.nanmax(error)), float(np.nanquantile(error, 0.999))
    record_property(
        HEAD,
        f"{path.stem:24}{found.triangulated:8d}{rms:9.4f}{floor:9.4f}{rms / floor:9.5f}"
        f"{p999:8.3f}{worst:8.3f}{found.visible - found.triangulated:9d}"
        f"{found.triangulated / seconds:10.0f}"
        f"{found.error_px:8.3f}{found.error_mm:8.3f}",
    )
    assert rms <= MAX_RATIO * floor
    assert worst <= max(MAX_ERROR, float(np.nanmax(best)))
    assert found.triangulated == found.visible
    assert not [f for f in found.notices if f.severity != "note"]


@pytest.mark.slow
@pytest.mark.parametrize("path", data_files("mocap", "*.cameras.json"))
def test_cameras_of_other_tools_are_checked(path: Path) -> None:
    assert "DOC009" not in {fault.code for fault in validate(path)}


@pytest.mark.parametrize("path", data_files("mocap", "cam_*.cameras.json"))
def test_a_camera_that_is_stale_is_named(path: Path, tmp_path: Path) -> None:
    observations = path.with_name(path.name.replace(".cameras.json", ".npz"))
    seen = read_observations(observations)
    seen = replace(
        seen,
        stored=seen.stored[::8],
        clock=replace(seen.clock, count=len(seen.stored[::8])),
    )
    value = json.loads(path.read_text("utf-8"))
    for c in range(0, len(value["cameras"]), 3):
        changed = json.loads(path.read_text("utf-8"))
        entry = changed["cameras"][c]
        turn = so3.to_matrix(so3.exp([0, 0, 0.01]))
        entry["R"] = (turn @ np.array(entry["R"])).tolist()
        entry["t"] = (turn @ np.array(entry["t"]) + [0.01, 0.02, 0]).tolist()
        stale = tmp_path / f"{c}.json"
        stale.write_text(json.dumps(changed), "utf-8")
        found = triangulate(seen, load_cameras(stale))
        assert [bool(report.shifts) for report in found.cameras] == [
            i == c for i in range(len(found.cameras))
        ]
        assert found.triangulated > 0.99 * found.visible


def _without(seen: Observations, wrong: BoolArray) -> Observations:
    pixels = seen.pixels(0, len(seen.stored))
    pixels[wrong] = np.nan
    return replace(seen, stored=pixels, unit=1.0, missing=None)


def _off(found: Triangulation, truth: FloatArray) -> FloatArray:
    """Return how far points are from the truth [mm] ``(F, M)``."""
    return np.asarray(np.linalg.norm(1000 * found.markers.positions - truth, axis=-1))
