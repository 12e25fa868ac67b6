"""A cloud of markers and the skeleton it is of, as animtool takes them."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from animtool.capture.templates import MarkerTemplate, TemplateMarker
from animtool.core.clock import Clock
from animtool.motion.markers import Markers
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig


@dataclass(frozen=True)
class Case:
    """A skeleton, and markers ``(F, M, 3)`` [m]."""

    skeleton: dict[str, Any]
    fps: int
    positions: np.ndarray

    def rig(self) -> Rig:
        """Return the rig; pins have limits, as in every tool."""
        joints = []
        for entry in self.skeleton["joints"]:
            given: dict[str, Any] = {}
            if (pin := entry["pin"]) is not None:
                ends = math.radians(pin["lo_deg"]), math.radians(pin["hi_deg"])
                axis = tuple(float(value) for value in pin["axis"])
                given = {"axis": axis, "limits": RangeLimit(*ends)}
            x, y, z = entry["offset"]
            kind = JointType(entry["type"])
            joints.append(
                Joint(entry["name"], entry["parent"], kind, (x, y, z), **given)
            )
        return Rig("subject", tuple(joints))

    def template(self) -> MarkerTemplate:
        """Return where the markers are."""
        return MarkerTemplate(
            tuple(
                TemplateMarker(entry["name"], entry["joint"], tuple(entry["offset"]))
                for entry in self.skeleton["markers"]
            )
        )

    def markers(self) -> Markers:
        """Return the capture."""
        names = tuple(entry["name"] for entry in self.skeleton["markers"])
        clock = Clock(Fraction(self.fps), 1, 1, len(self.positions))
        return Markers(names, clock, self.positions)


def case_of(path: Path) -> Case:
    """Return the case of a file that `mocap_solve.py` wrote."""
    with np.load(path) as arrays:
        skeleton = json.loads(str(arrays["skeleton"]))
        return Case(skeleton, int(arrays["fps"]), arrays["positions"])
