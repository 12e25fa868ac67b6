"""The bind pose and the size of a rig."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from animtool.errors import Fault
from animtool.maths import so3
from animtool.quantities import length_text
from animtool.units import LengthUnit, unit_name
from animtool.validation.subjects.rig import RigSubject

# A bind pose that differs by less of the rig's size, and by a smaller angle, is a slip.
SLIP = 1e-3
SLIP_ANGLE = math.radians(0.5)
# Characters are of such a size [m]; a unit that is wrong is wrong by 39 or more.
LIKELY_METERS = (0.05, 30.0)
# Fewer joints are a prop, of any size.
MIN_JOINTS = 8


def nearly_rest(rig: RigSubject) -> Iterator[Fault]:
    """Yield bind poses that are the rest pose but for a hair (RIG216)."""
    for name in rig.document.value.get("bind", {}):
        if name not in rig.rig.bind or not rig.size:
            continue
        pose, joint = rig.rig.bind[name], rig.rig.joints[rig.rig.index(name)]
        away = math.dist(pose.translation, joint.translation)
        rotations = np.array([pose.rotation]), np.array([joint.rotation])
        turn = float(so3.angle_between(*rotations)[0])
        if away <= SLIP * rig.size and turn <= SLIP_ANGLE:
            message = (
                f"the bind pose of {name!r} is its rest pose but for "
                f"{length_text(away)} and {math.degrees(turn):.3g}\N{DEGREE SIGN}"
            )
            hint = "leave it out, or write the pose that the skin was made in"
            yield rig.fault("RIG216", ("bind", name), message, hint)


def without_rest(rig: RigSubject) -> Iterator[Fault]:
    """Yield joints that have a bind pose, and none at rest (RIG222)."""
    bind = rig.document.value.get("bind", {})
    if "from" in rig.document.value:
        return
    for i, entry in enumerate(rig.written("joints")):
        pose = bind.get(entry["name"], {})
        if any(pose.get("translate") or ()) and not {"translate", "rotate"} & {*entry}:
            name, above = entry["name"], entry.get("parent")
            place = f"where {above!r} is" if above else "at the origin"
            message = f"{name!r} has a bind pose and none at rest: it rests {place}"
            hint = f"translate: {pose['translate']} is its place in the bind pose"
            yield rig.fault("RIG222", ("joints", i), message, hint)


def odd_size(rig: RigSubject) -> Iterator[Fault]:
    """Yield a size that fits another unit better (RIG217)."""
    low, high = LIKELY_METERS
    if len(rig.rig.joints) < MIN_JOINTS or low <= rig.size <= high or not rig.size:
        return
    own = rig.rig.meters_per_unit
    fitting = [
        str(unit)
        for unit in LengthUnit
        if low <= rig.size / own * unit.meters <= high and unit.meters != own
    ]
    at = ("units", "length") if "units" in rig.document.value else ("joints",)
    message = (
        f"the rig measures {length_text(rig.size)}, its lengths being {unit_name(own)}"
    )
    hint = f"length: {' or '.join(fitting)} fits better" if fitting else None
    yield rig.fault("RIG217", at, message, hint)
