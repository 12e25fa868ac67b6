"""Joints that follow others, in a solved pose."""

from __future__ import annotations

from collections.abc import Collection

from animtool._types import FloatArray
from animtool.rig.joints import coordinate_slices
from animtool.rig.skeleton import Rig


def mimics(rig: Rig, moved: Collection[str]) -> list[str]:
    """Return the joints that follow one of some joints, or one that does, in order.

    >>> from animtool.rig.skeleton import Joint, JointType, Mimic
    >>> lead = Joint("lead", -1, JointType.PIN)
    >>> tail = Joint("tail", -1, JointType.PIN, mimic=Mimic("lead"))
    >>> mimics(Rig("pair", (lead, tail)), ["lead"])
    ['tail']
    """
    found = set(moved)
    left = {j.name: j.mimic.joint for j in rig.joints if j.mimic is not None}
    while new := {name for name, lead in left.items() if lead in found} - found:
        found |= new
    return [name for name in rig.names if name in found and name in left]


def following(rig: Rig, coordinates: FloatArray, moved: Collection[str]) -> FloatArray:
    """Return coordinates ``(B, Q)`` whose followers are where moved joints put them."""
    names = mimics(rig, moved)
    if not names:
        return coordinates
    slices = coordinate_slices(rig)
    out = coordinates.copy()
    # Once for each, so that the last of a row of followers has its leader's too.
    for _ in names:
        for name in names:
            mimic = rig.joints[rig.index(name)].mimic
            assert mimic is not None
            lead = out[:, slices[rig.index(mimic.joint)]]
            out[:, slices[rig.index(name)]] = mimic.gain * lead + mimic.offset
    return out
