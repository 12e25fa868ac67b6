"""Clouds of markers, as observed, onto skeletons whose motion is known."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.data import data_files

from animtool._types import FloatArray
from animtool.clock import Clock
from animtool.markers import Markers
from animtool.mocap.solve import calibrate, solve_markers
from animtool.mocap.template import MarkerTemplate, TemplateMarker
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig

HEADER = (
    f"{'cloud':14} {'skeleton':10} {'RMS [mm]':>9} {'p99 [mm]':>9} {'max [mm]':>9} "
    f"{'markers [mm]':>12}"
)
# The data say limits as angles about each axis; cone and twist that hold those have
# this much room besides [rad], [1].
ROOM, WIDER = 0.1, 1.2


def rig_of(skeleton: dict[str, Any], name: str) -> Rig:
    """Return a skeleton of the data as a rig."""
    return Rig(name, tuple(_joint(entry) for entry in skeleton["joints"]))


def _joint(entry: dict[str, Any]) -> Joint:
    x, y, z = entry["offset"]
    name, parent, kind = entry["name"], entry["parent"], JointType(entry["type"])
    if kind is JointType.PIN:
        pin = entry["pin"]
        low, high = math.radians(pin["lo_deg"]), math.radians(pin["hi_deg"])
        axis = tuple(float(value) for value in pin["axis"])
        limits: Any = RangeLimit(low, high)
        return Joint(name, parent, kind, (x, y, z), axis=axis, limits=limits)  # type: ignore[arg-type]
    limits = None
    if entry["limits_deg"] is not None:
        about = [
            WIDER * math.radians(value) + ROOM * (value > 0)
            for value in entry["limits_deg"]
        ]
        bone = 0 if any(part in name for part in ("Arm", "Hand", "Shoulder")) else 1
        axis = (float(bone == 0), float(bone == 1), 0.0)
        swing = about[(bone + 1) % 3], about[(bone + 2) % 3]
        limits = BallLimit(swing, (-about[bone], about[bone]), axis)
    return Joint(name, parent, kind, (x, y, z), limits=limits)


def template_of(skeleton: dict[str, Any]) -> MarkerTemplate:
    """Return the markers of a skeleton of the data."""
    return MarkerTemplate(
        tuple(
            TemplateMarker(entry["name"], entry["joint"], tuple(entry["offset"]))
            for entry in skeleton["markers"]
        )
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


def rms(away: FloatArray) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt((away**2).mean()))


@pytest.mark.parametrize("path", data_files("mocap", "cloud_*.truth.json"))
def test_joints_of_the_true_skeleton(
    path: Path, record_property: Callable[[str, object], None]
) -> None:
    cloud = Cloud(path)
    rig = rig_of(cloud.skeleton, "subject")
    away, markers = cloud.errors(rig, template_of(cloud.skeleton))
    record_property(HEADER, row(cloud, "true", away, markers))
    assert rms(away) <= 2.0
    assert np.percentile(away, 99) <= 6.0


@pytest.mark.parametrize("path", data_files("mocap", "cloud_*.truth.json"))
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
