"""Unit of the joint ranges of an MJCF: degrees unless its compiler says otherwise."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from animtool.core.errors import Severity, counted
from animtool.formats.robots.notes import XmlNotes
from animtool.formats.robots.xml import XmlElement
from animtool.rig.suspicions import (
    ANGLE_NAMES,
    OTHER_ANGLE_UNITS,
    AngleLimit,
    limits_in_other_unit,
)

_HINGE = 3


def warn_of_range_unit(root: XmlElement, model: Any, notes: XmlNotes) -> None:
    """Record hinges whose ranges look like radians in degrees, or the reverse (MJC110).

    Args:
        root: The file, with its includes.
        model: The compiled model, whose ranges are in radians.
        notes: Notices of the file.
    """
    angle = "deg"
    for compiler in root.all("compiler"):
        if "angle" in compiler.attributes:
            angle = "rad" if compiler.attributes["angle"] == "radian" else "deg"
    factor = math.degrees(1.0) if angle == "deg" else 1.0
    # Without the rounding of the conversion.
    limits = [
        AngleLimit(
            (),
            model.joint(j).name,
            [round(float(end), 9) for end in np.array(model.jnt_range[j]) * factor],
        )
        for j in range(model.njnt)
        if model.jnt_limited[j] and model.jnt_type[j] == _HINGE
    ]
    suspects = limits_in_other_unit(limits, angle)
    if not suspects:
        return
    largest = max(suspects, key=lambda limit: limit.largest_value)
    element = next(
        (
            element
            for element in root.walk()
            if element.tag == "joint"
            and element.attributes.get("name") == largest.joint
        ),
        None,
    )
    likely, ratio = OTHER_ANGLE_UNITS[angle]
    low, high = largest.values
    message = (
        f"the ranges of {counted(len(suspects), 'joint')} look like "
        f"{ANGLE_NAMES[likely]}, but the unit is {ANGLE_NAMES[angle]}: "
        f"{largest.joint!r} has {low:.4g} to {high:.4g}"
    )
    setting = '<compiler angle="radian"/>'
    hint = f"write {setting}" if likely == "rad" else f"remove {setting}"
    hint += f', or write range="{low * ratio:.4g} {high * ratio:.4g}"'
    if likely == "deg":
        hint = hint.replace(setting, 'angle="radian" of <compiler>')
    notes.add("MJC110", element, message, hint, severity=Severity.WARNING)
