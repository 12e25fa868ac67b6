"""Chains of inverse kinematics: whether they can bend, and which way."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault
from animtool.maths import so3
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.parts import IkChain
from animtool.rig.skeleton import Joint, JointType
from animtool.validation.subjects.rig import RigSubject

# Limits narrower than this leave no bend to speak of [rad], [m].
STILL = 1e-3
# Directions nearer than this are one; sin 0.6°.
PARALLEL = 0.01


def cannot_bend(rig: RigSubject) -> Iterator[Fault]:
    """Yield chains of which only the root can move the tip (RIG214)."""
    for chain in rig.rig.ik:
        joints = _joints(rig, chain)
        inner = joints[1:-1]
        if not inner or any(_bends(rig, i, joints[-1]) for i in inner):
            continue
        at = rig.at("ik", chain.name)
        reasons = sorted({_reason(rig.rig.joints[i]) for i in inner})
        message = (
            f"{chain.name!r} cannot bend: no joint between {chain.root!r} and "
            f"{chain.tip!r} moves the tip ({', '.join(reasons)})"
        )
        hint = "a pin across its bone, a ball joint or a slide bends it"
        yield rig.fault("RIG214", at, message, hint)


def open_bend(rig: RigSubject) -> Iterator[Fault]:
    """Yield chains that are straight at rest and may bend any way (RIG215)."""
    positions, rotations = rig.rest
    for chain in rig.rig.ik:
        joints = _joints(rig, chain)
        inner = [rig.rig.joints[i] for i in joints[1:-1]]
        reach = positions[joints[-1]] - positions[joints[0]]
        length = float(np.linalg.norm(reach))
        moving = [j for j in inner if j.type is not JointType.FIXED]
        if not length or not moving:
            continue
        away = positions[joints[1:-1]] - positions[joints[0]]
        off = np.linalg.norm(np.cross(away, reach / length), axis=1)
        if (off > PARALLEL * length).any():
            continue
        at = rig.at("ik", chain.name)
        if chain.pole_dir is None:
            if all(j.type in {JointType.BALL, JointType.FREE} for j in moving):
                message = f"{chain.name!r} is straight at rest and may bend any way"
                hint = "pole_dir says where its middle points"
                yield rig.fault("RIG215", at, message, hint)
            continue
        parent = rig.rig.parents[joints[0]]
        frame = so3.IDENTITY if parent < 0 else rotations[parent]
        pole = so3.rotate(frame, np.array(chain.pole_dir))
        if float(np.linalg.norm(np.cross(pole, reach / length))) < PARALLEL:
            message = f"the pole_dir of {chain.name!r} points along the chain"
            hint = "it says which way the middle goes: across the chain"
            yield rig.fault("RIG215", (*at, "pole_dir"), message, hint)


def _joints(rig: RigSubject, chain: IkChain) -> list[int]:
    """Return the joints of a chain, from root to tip."""
    root, place = rig.rig.index(chain.root), rig.rig.index(chain.tip)
    found = [place]
    while place != root:
        place = rig.rig.joints[place].parent
        found.append(place)
    return found[::-1]


def _bends(rig: RigSubject, i: int, tip: int) -> bool:
    """Return whether a joint can bring the tip nearer to what is above it."""
    joint = rig.rig.joints[i]
    if joint.type is JointType.FIXED:
        return False
    away = _to_tip(rig, i, tip)
    match joint.type, joint.limits:
        case JointType.PRISMATIC, limits:
            return not isinstance(limits, RangeLimit) or _wide(limits)
        case JointType.PIN, limits:
            still = isinstance(limits, RangeLimit) and not _wide(limits)
            return not still and not _parallel(away, np.array(joint.axis))
        case JointType.BALL, BallLimit(swing=swing, twist=twist, twist_axis=axis):
            twists = twist is None or twist[1] - twist[0] > STILL
            swings = swing is None or max(swing) > STILL
            return swings or (twists and not _parallel(away, np.array(axis)))
        case _:
            return True


def _to_tip(rig: RigSubject, i: int, tip: int) -> FloatArray:
    """Return where the tip is at rest, in a joint's frame."""
    positions, rotations = rig.rest
    away = positions[tip] - positions[i]
    return so3.rotate(so3.conjugate(rotations[i]), away)


def _parallel(vector: FloatArray, axis: FloatArray) -> bool:
    length = float(np.linalg.norm(vector))
    return float(np.linalg.norm(np.cross(vector, axis))) <= PARALLEL * length


def _wide(limits: RangeLimit) -> bool:
    return limits.high - limits.low > STILL


def _reason(joint: Joint) -> str:
    if joint.type is JointType.FIXED:
        return f"{joint.name} is fixed"
    if isinstance(joint.limits, RangeLimit) and not _wide(joint.limits):
        return f"{joint.name} has limits without width"
    if joint.type is JointType.PIN:
        return f"{joint.name} turns about its own bone"
    return f"{joint.name} may not swing"
