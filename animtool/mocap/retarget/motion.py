"""A take of one skeleton as a take of another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from animtool._types import BoolArray, FloatArray
from animtool.maths import so3
from animtool.mocap.contacts import FootContacts, find_contacts
from animtool.mocap.retarget.feet import (
    Foot,
    Placed,
    bend_at_pin,
    bend_leg,
    place_feet,
)
from animtool.mocap.retarget.map import JointMap
from animtool.mocap.retarget.transfer import Person, Transfer, middle_of_hips
from animtool.motion import Channel, Motion
from animtool.rig.kinematics import WorldTransforms, forward
from animtool.rig.limits import BallLimit, RangeLimit, swing_twist
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.take import Take
from animtool.units import UpAxis

# Numbers that differ by less are one but for rounding [1], [m].
ROUNDING = 1e-13


@dataclass(frozen=True, slots=True)
class Retargeted:
    """A take on another rig, and what became of it."""

    take: Take
    transfer: Transfer
    placed: Placed | None  # None where there are no legs
    world: WorldTransforms  # of the target
    clamped: Mapping[int, float]  # joints that their limits held, in shares of frames
    source: WorldTransforms
    sides: str  # of the legs, such as "lr"
    contacts: Sequence[FootContacts]  # of each of these


def retarget_take(
    take: Take,
    rig: Rig,
    found: JointMap,
    *,
    rest: FloatArray | None = None,
    lock: bool = True,
) -> Retargeted:
    """Return a take on another rig.

    Args:
        take: The source.
        rig: The target.
        found: Which joints follow which.
        rest: Local turns of the source's joints in its rest pose ``(J, 4)``; None is
            that of its rig.
        lock: Whether feet stay where they stand.
    """
    source = Person.of(take.rig, found.source.roles, rest)
    target = Person.of(rig, found.target.roles)
    transfer = Transfer.of(source, target, found)
    motion = take.motion
    ours = forward(take.rig, motion.translations.dense(), motion.rotations.dense())
    turns = transfer.turns(ours.rotations)
    turns = _hinged(target, turns)
    up = 1 if rig.up is UpAxis.Y else 2
    local, clamped = _local(transfer, turns)
    turns = _world(rig, local)
    bones = transfer.bones(ours.rotations, motion.translations.dense(), turns)
    about = _about_hips(target, turns, bones)
    legs = [side for side in "lr" if target.leg(side) and source.leg(side)]
    hips = transfer.hips(ours.positions)
    fps = float(take.clock.fps / take.clock.step)
    feet = [
        _foot(transfer, side, ours.positions, turns, about, fps, up) for side in legs
    ]
    placed = None
    if legs and lock and not transfer.alike:
        # The ground of the source, scaled, is that of the target.
        off = [foot.height - transfer.scale * foot.contacts.ground for foot in feet]
        hips[:, up] += float(np.mean(off))
        placed = place_feet(hips, feet, fps, up)
        hips = placed.hips
        for k, side in enumerate(legs):
            leg = target.leg(side)
            assert leg is not None
            thigh, shin, foot, _ = leg
            goal = placed.ankles[k]
            if rig.joints[shin].type is JointType.PIN:
                turns[:, thigh], turns[:, shin] = _pin_leg(
                    rig, leg, hips + about[:, thigh], goal, turns
                )
            else:
                hinge = so3.rotate(turns[:, shin], _hinge(target, shin))
                turns[:, thigh], turns[:, shin] = bend_leg(
                    hips + about[:, thigh],
                    (hips + about[:, shin], hips + about[:, foot]),
                    goal,
                    (turns[:, thigh], turns[:, shin]),
                    hinge,
                )
            turns[:, foot] = placed.turns[k]
        local, clamped = _local(transfer, turns)
    _twist(transfer, local)
    root = _root(target, hips, _world(rig, local), bones)
    translations = np.broadcast_to(bones, (len(turns), *bones.shape[1:])).copy()
    translations[:, root[0]] = root[1]
    local = so3.align_signs(local)
    # What moves by rounding alone does not move.
    for values in (local, translations):
        still = (np.abs(values - values[:1]) < ROUNDING).all(axis=(0, 2))
        values[:, still] = values[:1, still]
    made = Motion(Channel.from_dense(translations), Channel.from_dense(local))
    world = forward(rig, translations, local)
    after = replace(take, rig=rig, motion=made)
    contacts = [foot.contacts for foot in feet]
    return Retargeted(
        after, transfer, placed, world, clamped, ours, "".join(legs), contacts
    )


def _about_hips(target: Person, turns: FloatArray, bones: FloatArray) -> FloatArray:
    """Return where joints are about the middle of the hips ``(F, K, 3)`` [m]."""
    rig = target.rig
    places = np.zeros((len(turns), len(rig.joints), 3))
    for j, parent in enumerate(rig.parents.tolist()):
        if parent >= 0:
            bone = so3.rotate(turns[:, parent], bones[:, j])
            places[:, j] = places[:, parent] + bone
    return np.asarray(places - middle_of_hips(target, places)[:, None])


def _foot(
    transfer: Transfer,
    side: str,
    positions: FloatArray,
    turns: FloatArray,
    about: FloatArray,
    fps: float,
    up: int,
) -> Foot:
    """Return a foot of the target, and when that of the source stands."""
    own, other = transfer.target.leg(side), transfer.source.leg(side)
    assert own is not None
    assert other is not None
    upright = so3.rotate(transfer.upright, positions[:, list(other)])
    toe = upright[:, 3] if other[3] >= 0 else None
    length = transfer.source.leg_length(side)
    contacts = find_contacts(upright[:, 2], toe, fps, length, up)
    thigh, _, foot, tip = own
    level = transfer.aligned[foot]
    return Foot(
        contacts,
        about[:, thigh],
        about[:, foot],
        about[:, tip] if tip >= 0 else None,
        turns[:, foot],
        level,
        _standing(transfer, side, contacts.ground, up),
        _reach(transfer.target, own),
        _straight(positions[:, list(other[:3])], length),
    )


def _reach(target: Person, leg: tuple[int, int, int, int]) -> float:
    """Return how far a leg reaches [m]: a pin may not let it be straight."""
    rig, (_, shin, foot, _) = target.rig, leg
    joint, rest = rig.joints[shin], rig.rest_rotations[shin]
    upper, lower = rig.rest_translations[shin], rig.rest_translations[foot]
    if joint.type is not JointType.PIN:
        return float(np.linalg.norm(upper) + np.linalg.norm(lower))
    low, high = -np.pi, np.pi
    if isinstance(joint.limits, RangeLimit):
        low, high = joint.limits.low, joint.limits.high
    angles = np.linspace(low, high, ANGLES)
    turns = so3.from_axis_angle(np.array(joint.axis, np.float64), angles)
    tips = upper + so3.rotate(so3.multiply(rest, turns), lower)
    return float(np.linalg.norm(tips, axis=1).max())


# Angles of a knee that are tried for its longest reach: within a hundredth of a degree.
ANGLES = 20_001


def _straight(leg: FloatArray, length: float) -> FloatArray:
    """Return the share of its length that a leg ``(F, 3, 3)`` reaches ``(F,)``."""
    reach = np.linalg.norm(leg[:, 2] - leg[:, 0], axis=1)
    return np.minimum(reach / length, 1.0) if length > 0 else np.ones(len(leg))


def _standing(transfer: Transfer, side: str, ground: float, up: int) -> float:
    """Return how high an ankle stands above the ground [m]."""
    target, source = transfer.target, transfer.source
    own, other = target.leg(side), source.leg(side)
    assert own is not None
    assert other is not None
    low = float(target.positions[:, up].min())
    ankle = float(target.positions[own[2], up])
    # A rig that stands on the ground at rest says how high its ankles are.
    if abs(low) < 0.1 * target.leg_length(side):
        return ankle
    scale = 1.0
    if own[3] >= 0 and other[3] >= 0:
        feet = [
            float(np.linalg.norm(one.positions[leg[3]] - one.positions[leg[2]]))
            for one, leg in ((target, own), (source, other))
        ]
        scale = feet[0] / feet[1] if feet[1] > 0 else 1.0
    return ground * scale


def _pin_leg(
    rig: Rig,
    leg: tuple[int, int, int, int],
    hip: FloatArray,
    goal: FloatArray,
    turns: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return turns of thigh and shin in the world, of a knee that is a pin."""
    thigh, shin, foot, _ = leg
    joint, rest = rig.joints[shin], rig.rest_rotations[shin]
    own = so3.multiply(so3.conjugate(turns[:, thigh]), turns[:, shin])
    pin = np.array(joint.axis, np.float64)
    angle = swing_twist(so3.multiply(so3.conjugate(rest), own), joint.axis)[1]
    bones = rig.rest_translations[shin], so3.rotate(rest, rig.rest_translations[foot])
    upper, bent = bend_at_pin(
        hip, goal, turns[:, thigh], bones, so3.rotate(rest, pin), angle
    )
    if isinstance(joint.limits, RangeLimit):
        bent = joint.limits.clamped(bent)
    lower = so3.multiply(upper, so3.multiply(rest, so3.from_axis_angle(pin, bent)))
    return upper, lower


def _hinge(target: Person, shin: int) -> FloatArray:
    """Return what a knee turns about, in its own frame ``(3,)``."""
    joint = target.rig.joints[shin]
    if joint.type is JointType.PIN:
        return np.array(joint.axis, np.float64)
    facing = target.facing
    left = np.eye(3)[0] if facing is None else facing[0]
    return so3.rotate(so3.conjugate(target.turns[shin]), left)


def _hinged(target: Person, turns: FloatArray) -> FloatArray:
    """Return turns where what bends at a pin is across its axis ``(F, K, 4)``.

    The joint above twists about its own bone, so that the bone below the pin points
    where it did; a straight limb does not say how, and keeps its twist.
    """
    rig, made = target.rig, turns
    for j, joint in enumerate(rig.joints):
        parent = int(rig.parents[j])
        bone = target.bone(j)
        if joint.type is not JointType.PIN or parent < 0 or bone is None:
            continue
        if rig.joints[parent].type is not JointType.BALL:
            continue
        upper = so3.rotate(made[:, parent], _unit(rig.rest_translations[j]))
        own = so3.rotate(so3.conjugate(target.turns[j]), bone)
        way = so3.rotate(made[:, j], own)
        rest = so3.rotate(rig.rest_rotations[j], np.array(joint.axis, np.float64))
        axis = so3.rotate(made[:, parent], rest)
        normal = np.cross(upper, way)
        sine = np.linalg.norm(normal, axis=1)
        normal = normal / np.maximum(sine, 1e-12)[:, None]
        # It bends the way that its limits let it, or else that is nearer to the axis.
        side = np.where((normal * axis).sum(axis=1) < 0, -1.0, 1.0)[:, None]
        if isinstance(joint.limits, RangeLimit):
            side = np.full_like(side, _bends(joint.limits))
        across = axis - (axis * upper).sum(axis=1)[:, None] * upper
        angle = np.arctan2(
            (np.cross(across, normal * side) * upper).sum(axis=1),
            (across * normal * side).sum(axis=1),
        )
        bent = np.clip((sine - BENT[0]) / (BENT[1] - BENT[0]), 0.0, 1.0)
        angle = angle * bent * bent * (3 - 2 * bent)
        twist = so3.from_axis_angle(upper, angle)
        made[:, parent] = so3.multiply(twist, made[:, parent])
    return made


def _bends(limits: RangeLimit) -> float:
    """Return which way a pin bends: 1 for angles above 0, -1 for those below."""
    return 1.0 if limits.low + limits.high >= 0 else -1.0


# Sines of a bend below and above which a limb is straight, and is not.
BENT = (0.05, 0.2)


def _unit(vector: FloatArray) -> FloatArray:
    size = float(np.linalg.norm(vector))
    return vector / size if size > 0 else np.array([0.0, 1.0, 0.0])


def _local(
    transfer: Transfer, turns: FloatArray
) -> tuple[FloatArray, dict[int, float]]:
    """Return local turns ``(F, K, 4)`` within limits, and whom these held how often.

    What a limit takes from a joint, the joints below it make up for; who follows
    nobody rests.
    """
    target = transfer.target
    rig = target.rig
    made, actual = np.zeros_like(turns), np.zeros_like(turns)
    held: dict[int, float] = {}
    for j, joint in enumerate(rig.joints):
        parent, rest = int(rig.parents[j]), rig.rest_rotations[j]
        above = actual[:, parent] if parent >= 0 else None
        back = so3.IDENTITY if above is None else so3.conjugate(above)
        own = np.broadcast_to(rest, made[:, j].shape)
        if transfer.follows[j] >= 0:
            own = so3.multiply(back, turns[:, j])
            twisted = _twisted(target, j)
            if twisted >= 0:
                below = so3.conjugate(rig.rest_rotations[twisted])
                own = so3.multiply(back, so3.multiply(turns[:, twisted], below))
        own, stopped = _within(joint, rest, own)
        if stopped.any():
            held[j] = float(stopped.mean())
        made[:, j] = own
        actual[:, j] = own if above is None else so3.multiply(above, own)
    return made, held


# Cosine from which on a pin's axis is along its bone, which it twists.
ALONG = 0.9


def _twisted(target: Person, j: int) -> int:
    """Return the joint whose twist a pin along its bone has; -1 where it is no such."""
    joint, rig = target.rig.joints[j], target.rig
    if joint.type is not JointType.PIN:
        return -1
    below = [k for k, parent in enumerate(rig.parents) if parent == j]
    known = [k for k in below if target.roles[k] not in {"", "twist", "end"}]
    if len(known) != 1 or target.roles[known[0]] == target.roles[j]:
        return -1
    bone = _unit(rig.rest_translations[known[0]])
    return known[0] if abs(float(bone @ np.array(joint.axis))) > ALONG else -1


# Coordinates that are beyond their limits by less are within them, but for rounding.
HELD = 1e-6


def _within(
    joint: Joint, rest: FloatArray, local: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return local turns that a joint can have ``(F, 4)``, and where limits stop it."""
    free = np.zeros(len(local), np.bool_)
    limits = joint.limits
    if joint.type is JointType.FREE or (
        joint.type is JointType.BALL and limits is None
    ):
        return local, free
    own = so3.multiply(so3.conjugate(rest), local)
    if joint.type is JointType.PIN:
        angle = swing_twist(own, joint.axis)[1]
        if isinstance(limits, RangeLimit):
            free = np.abs(limits.excess(angle)) > HELD
            angle = limits.clamped(angle)
        own = so3.from_axis_angle(np.array(joint.axis, np.float64), angle)
    elif isinstance(limits, BallLimit):
        kept = limits.clamped(own)
        free, own = so3.angle_between(kept, own) > HELD, kept
    else:
        own = np.broadcast_to(so3.IDENTITY, own.shape)
    return so3.multiply(rest, own), free


def _world(rig: Rig, local: FloatArray) -> FloatArray:
    made = local.copy()
    for j, parent in enumerate(rig.parents.tolist()):
        if parent >= 0:
            made[:, j] = so3.multiply(made[:, parent], local[:, j])
    return made


def _twist(transfer: Transfer, local: FloatArray) -> None:
    """Give twist joints their share of the turn of the joint at the bone's end."""
    rig = transfer.target.rig
    for joint, bone, below, share in transfer.twists:
        del bone
        axis = _unit(rig.rest_translations[below])
        own = so3.multiply(so3.conjugate(rig.rest_rotations[below]), local[:, below])
        ahead = so3.rotate(so3.conjugate(rig.rest_rotations[below]), axis)
        angle = np.unwrap(swing_twist(own, tuple(ahead))[1])
        turn = so3.from_axis_angle(axis, share * angle)
        local[:, joint] = so3.multiply(turn, rig.rest_rotations[joint])


def _root(
    target: Person, hips: FloatArray, turns: FloatArray, bones: FloatArray
) -> tuple[int, FloatArray]:
    """Return the joint that carries the hips, and its local translations ``(F, 3)``."""
    rig = target.rig
    root = max(target.first("hips"), 0)
    moves = root
    about = _about_hips(target, turns, bones)
    place = hips + about[:, moves]
    parent = int(rig.parents[moves])
    if parent < 0:
        return moves, place
    above = np.zeros((len(hips), 3))
    chain = []
    while parent >= 0:
        chain.append(parent)
        parent = int(rig.parents[parent])
    for j in reversed(chain):
        outer = int(rig.parents[j])
        bone = bones[:, j]
        above = above + (bone if outer < 0 else so3.rotate(turns[:, outer], bone))
    own = so3.rotate(so3.conjugate(turns[:, chain[0]]), place - above)
    return moves, own
