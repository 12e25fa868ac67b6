"""Clouds of markers, as observed, onto skeletons whose motion is known."""

from __future__ import annotations

import json
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from support.data import data_files
from support.mocap_skeleton import rig_of, template_of
from support.suite import one_of, some_quick

from animtool.capture.solve import calibrate, solve_markers
from animtool.capture.templates import MarkerTemplate
from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.motion.markers import Markers
from animtool.rig.skeleton import Rig

HEADER = (
    f"{'cloud':14} {'skeleton':10} {'RMS [mm]':>9} {'p99 [mm]':>9} {'max [mm]':>9} "
    f"{'markers [mm]':>12}"
)


class Cloud:
    """A cloud, its truth, and the skeleton it is of."""

    def __init__(self, path: Path) -> None:
        """Read them."""
        self.stem = path.name.removesuffix(".truth.json")
        truth = json.loads(path.read_text("utf-8"))
        self.skeleton = truth["skeleton"]
        with np.load(path.with_name(f"{self.stem}.npz")) as arrays:
            names, fps = arrays["marker_names"].tolist(), Fraction(int(arrays["fs"]))
            self.markers, self.static = (
                Markers(tuple(names), Clock(fps, 1, 1, len(each)), each / 1000.0)
                for each in (
                    arrays["markers_mm"].astype(np.float64),
                    arrays["static_mm"].astype(np.float64),
                )
            )
        with np.load(path.with_name(f"{self.stem}.truth.npz")) as arrays:
            self.joints = arrays["joint_pos_mm"].astype(np.float64)

    def errors(self, rig: Rig, template: MarkerTemplate) -> tuple[FloatArray, float]:
        """Return how far joints are off [mm], and markers as the solve says [mm]."""
        solve = solve_markers(self.markers, rig, template)
        positions = solve.take().world().positions
        away = np.linalg.norm(1000 * positions - self.joints, axis=2)
        return away, 1000 * solve.score.total


def row(cloud: Cloud, skeleton: str, away: FloatArray, markers: float) -> str:
    """Return a line of the table."""
    p99 = float(np.percentile(away, 99))
    return (
        f"{cloud.stem[:14]:14} {skeleton:10} {rms(away):9.3f} {p99:9.3f} "
        f"{away.max():9.3f} {markers:12.3f}"
    )


# Clouds of all folders that hold some.
CLOUDS = [
    each
    for folder in ("mocap", "mocap_more")
    for each in data_files(folder, "cloud_*.truth.json")
]


def rms(away: FloatArray) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt((away**2).mean()))


@pytest.mark.slow
@pytest.mark.parametrize("path", some_quick(CLOUDS, 3))
def test_joints_of_the_true_skeleton(
    path: Path, record_property: Callable[[str, object], None]
) -> None:
    cloud = Cloud(path)
    rig = rig_of(cloud.skeleton, "subject")
    away, markers = cloud.errors(rig, template_of(cloud.skeleton))
    record_property(HEADER, row(cloud, "true", away, markers))
    assert rms(away) <= 2.0
    assert np.percentile(away, 99) <= 6.0


@pytest.mark.slow
@pytest.mark.parametrize("path", one_of(CLOUDS, 2))
def test_joints_of_a_calibrated_one(
    path: Path, record_property: Callable[[str, object], None]
) -> None:
    cloud = Cloud(path)
    generic = json.loads(path.with_name("template_skeleton.json").read_text("utf-8"))
    found = calibrate(
        cloud.markers,
        rig_of(generic, "generic"),
        template_of(generic),
        static=cloud.static,
    )
    away, markers = cloud.errors(found.rig, found.template)
    record_property(HEADER, row(cloud, "calibrated", away, markers))
    assert rms(away) <= 5.0
