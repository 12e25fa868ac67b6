"""Skeletons and markers of the data, as rigs and templates."""

from __future__ import annotations

import math
from typing import Any

from animtool.capture.templates import MarkerTemplate, TemplateMarker
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig

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
