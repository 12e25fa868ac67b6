"""Where the joints of a written stage already stand, as its prims record it.

A stage that is written from a placed source has that place in its joints, and no
transform says so. ``customData`` does: that of the SkelAnimation for its samples, that
of the Skeleton for the rest pose::

    animtool = { dictionary stands = { double3 translate, quatd rotate, bool rides } }

Lengths are metres, along the axes of the layer.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from pxr import Gf

from animtool.maths import so3
from animtool.rig.placed import placed_rig
from animtool.rig.placement import Placement
from animtool.rig.skeleton import Rig
from animtool.usd.layers.sdf import quaternion

if TYPE_CHECKING:
    from animtool.usd.layers.faults import Spot

KEY = "stands"


def place_record(rig: Rig, resting: Rig | None = None) -> dict[str, Any]:
    """Return what a file records of where a rig stands; empty where it does not.

    resting: the rig whose rest pose the file has; None is the same. Where that stands
    somewhere, so is recorded who does not.
    """
    others = (rig,) if resting is None else (rig, resting)
    if all(one.stands is None and not one.rides for one in others):
        return {}
    stands = rig.stands or Placement.turn(so3.IDENTITY)
    record: dict[str, Any] = {
        "translate": Gf.Vec3d(*stands.translations[0].tolist()),
        "rotate": quaternion(stands.rotations[0]),
    }
    return record | ({"rides": True} if rig.rides else {})


def with_recorded_place(rig: Rig, skeleton: Any, animation: Any, where: Spot) -> Rig:
    """Return a rig, as its numbers are, that stands where its motion is recorded to.

    skeleton: the prim of its rest pose; None is none; animation: that of its motion;
    None is the rest pose.
    """
    resting = None if skeleton is None else _recorded(skeleton, where)
    moving = resting if animation is None else _recorded(animation, where)
    if moving is None:
        return rig
    stands, rides = moving
    if skeleton is not None and resting is not moving:
        # The rest pose is another take's of a library, or has no place.
        back = stands if resting is None else stands.after(resting[0].inverse())
        rig = placed_rig(rig, back)
    return replace(rig, stands=None if stands.is_none else stands, rides=rides)


def _recorded(prim: Any, where: Spot) -> tuple[Placement, bool] | None:
    """Return what a prim records, and whether it rides; None where it does not."""
    # What writes needs nothing of stages.
    from animtool.usd.rigs.prims import stored_data

    record = stored_data(prim).get(KEY)
    if record is None:
        return None
    place, turn = (
        record.get(key) if isinstance(record, dict) else None
        for key in ("translate", "rotate")
    )
    if not isinstance(place, Gf.Vec3d) or not isinstance(turn, Gf.Quatd):
        where.fail("USD007", f"customData animtool:{KEY} is malformed")
    rotation = np.array([*turn.GetImaginary(), turn.GetReal()], float)
    translation = np.array(place, float)
    length = float(np.linalg.norm(rotation))
    if not np.isfinite(translation).all() or not abs(length - 1.0) < 1e-3:
        where.fail("USD007", f"customData animtool:{KEY} is malformed")
    placement = Placement(translation[None], rotation[None] / length, np.ones(1))
    return placement, bool(record.get("rides", False))
