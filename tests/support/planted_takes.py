"""Faults planted in takes of the samples: what is changed, and the code expected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.core.rules import builtin_rules
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.motion.motion import Channel
from animtool.motion.take import Take
from animtool.rig.kinematics import rest_size
from animtool.rig.sides import pair_sides
from animtool.validation.motion.subject import MotionSubject

Edit = Callable[[Take], Take]


@dataclass(frozen=True)
class Planted:
    """One fault in one sample.

    Attributes:
        name: What is wrong.
        sample: Key of the sample's take.
        edit: Plants it.
        code: Of the rule that must find it.
        extra: Codes of what follows from it.
    """

    name: str
    sample: str
    edit: Edit
    code: str
    extra: frozenset[str] = field(default_factory=frozenset)


def edited(
    take: Take,
    translations: FloatArray | None = None,
    rotations: FloatArray | None = None,
) -> Take:
    """Return a take with other values, and as many frames as they have."""
    moves = take.motion.translations.dense() if translations is None else translations
    turns = take.motion.rotations.dense() if rotations is None else rotations
    motion = replace(
        take.motion,
        translations=Channel.from_dense(moves),
        rotations=Channel.from_dense(so3.align_signs(turns)),
        controls=None,
        scales=None,
    )
    rig = replace(take.rig, controls=(), chains=())
    return replace(
        take, rig=rig, motion=motion, clock=replace(take.clock, count=len(turns))
    )


def at_frames(take: Take, frames: FloatArray | list[int]) -> Take:
    """Return a take that shows some frames, in an order."""
    which = np.asarray(frames, np.int64)
    moves, turns, _ = take.motion.dense()
    return edited(take, moves[which], turns[which])


def turned(joint: str, degrees: float, frames: slice, axis: int = 0) -> Edit:
    """Turn a joint in some frames."""

    def edit(take: Take) -> Take:
        turns = take.motion.rotations.dense()
        vector = np.eye(3)[axis] * np.radians(degrees)
        j = take.rig.index(joint)
        turns[frames, j] = so3.multiply(so3.exp(vector), turns[frames, j])
        return edited(take, rotations=turns)

    return edit


def moved(offset: Callable[[int, float], FloatArray]) -> Edit:
    """Add to the root what a function of frame count and size gives ``(F, 3)``."""

    def edit(take: Take) -> Take:
        moves = take.motion.translations.dense()
        moves[:, take.rig.roots[0]] += offset(len(moves), rest_size(take.rig))
        return edited(take, translations=moves)

    return edit


def step(share: float, axis: int, first: float = 0.5, last: float = 1.0) -> Edit:
    """Displace the root by a share of the size from one part of the take to another."""

    def offset(count: int, size: float) -> FloatArray:
        found = np.zeros((count, 3))
        found[
            int(first * count) : max(int(last * count), int(first * count) + 1), axis
        ] = share * size
        return found

    return moved(offset)


def eased(share: float, axis: int, first: float, last: float) -> Edit:
    """Displace the root between two parts of the take, eased over a tenth of it."""

    def offset(count: int, size: float) -> FloatArray:
        t = np.linspace(0.0, 1.0, count)
        part = np.clip(np.minimum(t - first, last - t) / 0.1, 0.0, 1.0)
        found = np.zeros((count, 3))
        found[:, axis] = share * size * part * part * (3.0 - 2.0 * part)
        return found

    return moved(offset)


def drift(share: float, axis: int) -> Edit:
    """Move the root along by a share of the size over the take."""
    return moved(
        lambda count, size: np.outer(
            np.linspace(0.0, share * size, count), np.eye(3)[axis]
        )
    )


def travel(factor: float) -> Edit:
    """Scale how far the root goes along the ground."""

    def edit(take: Take) -> Take:
        moves = take.motion.translations.dense()
        root = take.rig.roots[0]
        way = moves[:, root] - moves[0, root]
        way[:, 1] = 0.0
        moves[:, root] += (factor - 1.0) * way
        return edited(take, translations=moves)

    return edit


def without(*frames: int) -> Edit:
    return lambda take: at_frames(
        take, np.setdiff1d(np.arange(take.motion.frames), frames)
    )


def held(first: int, count: int) -> Edit:
    def edit(take: Take) -> Take:
        frames = np.arange(take.motion.frames)
        frames[first : first + count] = first
        return at_frames(take, frames)

    return edit


def repeated(every: int) -> Edit:
    """Repeat each frame before every so many."""

    def edit(take: Take) -> Take:
        frames = np.arange(take.motion.frames)
        return at_frames(take, frames - (frames % every == every - 1))

    return edit


def sides_swapped(first: float, last: float = 1.0, only: str = "") -> Edit:
    """Swap the channels of left and right joints in part of the take."""

    def edit(take: Take) -> Take:
        turns = take.motion.rotations.dense()
        partners = pair_sides(take.rig.names, take.rig.parents).partners
        part = slice(int(first * len(turns)), int(last * len(turns)))
        order = [
            int(partners[i]) if only.lower() in name.lower() else i
            for i, name in enumerate(take.rig.names)
        ]
        turns[part] = turns[part][:, order]
        return edited(take, rotations=turns)

    return edit


def sides_renamed(take: Take) -> Take:
    """Give left joints the names of right ones."""
    partners = pair_sides(take.rig.names, take.rig.parents).partners
    names = [take.rig.names[i] for i in partners]
    joints = tuple(
        replace(joint, name=name, mirror=None, limits=None, mimic=None)
        for joint, name in zip(take.rig.joints, names, strict=True)
    )
    bare = edited(take)
    return replace(bare, rig=replace(bare.rig, joints=joints))


def mirrored(take: Take) -> Take:
    """Reflect positions and rotations in x = 0 and leave the names."""
    flip = np.array([-1.0, 1.0, 1.0])
    turns = take.motion.rotations.dense() * np.array([1.0, -1.0, -1.0, 1.0])
    joints = []
    for joint in take.rig.joints:
        x, y, z = joint.translation
        a, b, c, w = joint.rotation
        joints.append(
            replace(joint, translation=(-x, y, z), rotation=(a, -b, -c, w), tips=())
        )
    bare = edited(take, take.motion.translations.dense() * flip, turns)
    return replace(bare, rig=replace(bare.rig, joints=tuple(joints)))


def dead(*joints: str) -> Edit:
    def edit(take: Take) -> Take:
        turns = take.motion.rotations.dense()
        for joint in joints:
            turns[:, take.rig.index(joint)] = turns[0, take.rig.index(joint)]
        return edited(take, rotations=turns)

    return edit


def stretched(joint: str, factor: float) -> Edit:
    def edit(take: Take) -> Take:
        moves = take.motion.translations.dense()
        moves[:, take.rig.index(joint)] *= np.linspace(1.0, factor, len(moves))[:, None]
        return edited(take, translations=moves)

    return edit


def scaled_motion(factor: float, *, root_only: bool = False) -> Edit:
    """Scale the translations of a take, and not its rig."""

    def edit(take: Take) -> Take:
        moves = take.motion.translations.dense()
        which = list(take.rig.roots) if root_only else slice(None)
        moves[:, which] *= factor
        return edited(take, translations=moves)

    return edit


def scaled(factor: float) -> Edit:
    """Scale a take and its rig."""

    def edit(take: Take) -> Take:
        joints = tuple(
            replace(joint, translation=tuple(factor * x for x in joint.translation))
            for joint in take.rig.joints
        )
        bare = edited(take, take.motion.translations.dense() * factor)
        return replace(bare, rig=replace(bare.rig, joints=joints, bind={}))

    return edit


def rolled(degrees: float) -> Edit:
    """Turn the root's motion about x, as another up axis does."""

    def edit(take: Take) -> Take:
        turn = so3.from_axis_angle([1.0, 0.0, 0.0], np.radians(degrees))
        moves, turns, _ = take.motion.dense()
        root = take.rig.roots[0]
        moves[:, root] = so3.rotate(turn, moves[:, root])
        turns[:, root] = so3.multiply(turn, turns[:, root])
        return edited(take, moves, turns)

    return edit


def up_z(take: Take) -> Take:
    return replace(take, rig=replace(take.rig, up=UpAxis.Z))


def reference_first(take: Take) -> Take:
    """Put the rest pose before the first frame."""
    moves, turns, _ = take.motion.dense()
    # Arms spread, legs apart: what the walk is far from in most joints.
    pose = so3.multiply(so3.exp([0.0, 0.0, 1.2]), turns[:1])
    pose[:, list(take.rig.roots)] = turns[:1, list(take.rig.roots)]
    return edited(
        take, np.concatenate([moves[:1], moves]), np.concatenate([pose, turns])
    )


def under_a_root(take: Take) -> Take:
    """Hang the skeleton from a root that stays at the origin, as armatures do."""
    bare = edited(take)
    first = replace(bare.rig.joints[0], parent=-1, translation=(0.0, 0.0, 0.0))
    first = replace(first, name="Armature", rotation=(0.0, 0.0, 0.0, 1.0), tips=())
    joints = tuple(
        replace(joint, parent=joint.parent + 1, mirror=None)
        for joint in bare.rig.joints
    )
    moves, turns, _ = bare.motion.dense()
    moves = np.concatenate([np.zeros((len(moves), 1, 3)), moves], axis=1)
    still = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(turns), 1, 4))
    turns = np.concatenate([still, turns], axis=1)
    motion = replace(
        bare.motion,
        translations=Channel.from_dense(moves),
        rotations=Channel.from_dense(turns),
    )
    rig = replace(bare.rig, joints=(first, *joints), bind={})
    return replace(bare, rig=rig, motion=motion)


def rests_with_legs_spread(take: Take) -> Take:
    """Turn the thighs of the rest pose to the sides by 70 degrees, and no motion."""
    sides = pair_sides(take.rig.names, take.rig.parents).left
    bare = edited(take)
    joints = list(bare.rig.joints)
    for left in sides:
        if "UpLeg" in joints[left].name:
            right = int(pair_sides(take.rig.names, take.rig.parents).partners[left])
            for joint, angle in ((left, 1.2), (right, -1.2)):
                turn = so3.from_axis_angle([0.0, 0.0, 1.0], angle)
                a, b, c, w = so3.multiply(turn, joints[joint].rotation).tolist()
                joints[joint] = replace(joints[joint], rotation=(a, b, c, w))
    return replace(bare, rig=replace(bare.rig, joints=tuple(joints)))


def scaled_root(factor: float) -> Edit:
    """Scale the root of the motion, and neither rig nor translations."""

    def edit(take: Take) -> Take:
        bare = edited(take)
        scales = np.ones((bare.motion.frames, len(bare.rig.joints), 3))
        scales[:, bare.rig.roots[0]] = factor
        return replace(
            bare, motion=replace(bare.motion, scales=Channel.from_dense(scales))
        )

    return edit


def with_w_last(take: Take) -> Take:
    """Return a take whose quaternions were read in the other order."""
    return edited(take, rotations=np.roll(take.motion.rotations.dense(), -1, axis=2))


_JUMPS = frozenset({"MOT202", "MOT203"})
_FEET = frozenset({"MOT208", "MOT209"})

TAKES = [
    Planted("a pose of 64 frames", "walk", held(0, 64), "MOT201"),
    Planted("a knee 20° off in one frame", "walk",
            turned("LeftLeg", 20, slice(44, 45)), "MOT202"),
    Planted("an elbow 25° off from a frame on", "walk",
            turned("RightForeArm", 25, slice(40, None), 2), "MOT202"),
    Planted("a forearm turned over", "walk",
            turned("LeftForeArm", 178, slice(20, None), 1), "MOT202"),
    Planted("a head 20° off in two frames", "stride",
            turned("head", 20, slice(12, 14), 1), "MOT202"),
    Planted("a finger 40° off in one frame", "carry",
            turned("index_1_l", 40, slice(60, 61)), "MOT202"),
    Planted("a hand 20° off in one frame, of a wave", "wave1",
            turned("hand", 20, slice(33, 34)), "MOT202"),
    Planted("a rod 25° off in one frame, of a machine", "press",
            turned("lever", 25, slice(20, 21), 2), "MOT202"),
    Planted("the root displaced sideways from a frame on", "walk",
            step(0.08, 0), "MOT203", _FEET),
    Planted("the root lifted in one frame", "walk",
            step(0.06, 1, 0.5, 0.5), "MOT203", _FEET),
    Planted("the root 5% ahead in one frame", "stride", step(0.05, 2, 0.5, 0.5),
            "MOT203", _FEET),
    Planted("the root turned by 30° in one frame", "walk",
            turned("Hips", 30, slice(30, 31), 1), "MOT203", _FEET),
    Planted("the root displaced, of a biped", "stride",
            step(0.07, 0), "MOT203", _FEET),
    Planted("a reference pose before the first frame", "walk",
            reference_first, "MOT204"),
    Planted("one frame lost", "walk", without(33), "MOT205", _JUMPS),
    Planted("two frames lost", "walk", without(40, 41), "MOT205", _JUMPS),
    Planted("one frame lost, of a biped", "carry", without(50), "MOT205"),
    Planted("five frames frozen", "walk", held(30, 5), "MOT206", _JUMPS | _FEET),
    Planted("one frame frozen", "walk", held(44, 2), "MOT206", _JUMPS | _FEET),
    Planted("frozen, of a machine", "press", held(20, 4), "MOT206", _JUMPS),
    Planted("24 frames a second in a take of 30", "walk", repeated(5), "MOT207",
            _JUMPS | _FEET),
    Planted("every second frame repeated", "walk", repeated(2), "MOT207",
            _JUMPS | _FEET),
    Planted("the root goes 1.4 times as far", "walk", travel(1.4), "MOT208"),
    Planted("the root goes 0.7 times as far", "walk", travel(0.7), "MOT208"),
    Planted("the root walks backwards", "walk", travel(-1.0), "MOT208"),
    Planted("a side drift of half the size", "walk", drift(0.5, 0), "MOT208"),
    Planted("the root goes 1.5 times as far, of a biped", "stride", travel(1.5),
            "MOT208"),
    Planted("sunk by a tenth for a while", "walk", eased(-0.1, 1, 0.3, 0.6), "MOT209",
            frozenset({"MOT208"})),
    Planted("sunk by 7% for a while", "walk", eased(-0.07, 1, 0.45, 0.8), "MOT209",
            frozenset({"MOT208"})),
    Planted("sunk by 5% for a while", "walk", eased(-0.05, 1, 0.4, 0.7), "MOT209",
            frozenset({"MOT208"})),
    Planted("all of it sunk by 6%", "walk", step(-0.06, 1, 0.0), "MOT209"),
    Planted("all of it sunk, at rest with legs spread", "walk",
            lambda take: step(-0.08, 1, 0.0)(rests_with_legs_spread(take)), "MOT209"),
    Planted("the hips below an armature displaced", "walk",
            lambda take: under_a_root(step(0.08, 0)(take)), "MOT203", _FEET),
    Planted("all of it sunk", "stride", step(-0.08, 1, 0.0), "MOT209"),
    Planted("all of it floating", "stride", step(0.1, 1, 0.0), "MOT209"),
    Planted("all of it floating, carrying", "carry", step(0.08, 1, 0.0), "MOT209"),
    Planted("names of left and right swapped", "walk", sides_renamed, "MOT210"),
    Planted("names of a biped swapped", "stride", sides_renamed, "MOT210"),
    Planted("mirrored without the names", "walk", mirrored, "MOT210"),
    Planted("sides exchanged from the middle on", "walk", sides_swapped(0.5),
            "MOT210", _JUMPS | _FEET),
    Planted("legs exchanged for a while", "walk", sides_swapped(0.45, 0.7, "leg"),
            "MOT210", _JUMPS | _FEET),
    Planted("an arm without motion", "walk", dead("LeftArm"), "MOT211"),
    Planted("a leg without motion", "walk", dead("RightUpLeg", "RightLeg"), "MOT211",
            _FEET),
    Planted("a shin that grows to twice its length", "walk",
            stretched("LeftFoot", 2.0), "MOT212", _FEET),
    Planted("a shin that shrinks to two fifths", "walk",
            stretched("LeftFoot", 0.4), "MOT212", _FEET),
    Planted("an animation in centimetres over metres", "walk", scaled_motion(100.0),
            "MOT213", _FEET),
    Planted("an animation in metres over centimetres", "stride", scaled_motion(0.01),
            "MOT213", _FEET),
    Planted("a root in centimetres", "stride", scaled_motion(100.0, root_only=True),
            "MOT213", _FEET),
    Planted("a character 100 times too large", "stride", scaled(100.0), "MOT213"),
    Planted("a character 100 times too small", "carry", scaled(0.01), "MOT213"),
    Planted("a root scaled by 100", "stride", scaled_root(100.0), "MOT213"),
    Planted("a root scaled by 1/100", "walk", scaled_root(0.01), "MOT213"),
    Planted("a character of 1.2 mm", "stride", scaled(0.0005), "MOT213"),
    Planted("a machine of 0.7 mm", "press", scaled(0.0005), "MOT215"),
    Planted("Z up, stated as Y", "walk", rolled(90.0), "MOT214"),
    Planted("Y up, stated as Z", "stride", up_z, "MOT214"),
    Planted("upside down", "walk", rolled(180.0), "MOT214"),
    Planted("quaternions with w last", "walk", with_w_last, "MOT222"),
    Planted("the origin moved by a kilometre", "walk",
            moved(lambda _t, _h: np.array([1000.0, 0.0, -300.0])), "MOT223"),
]  # fmt: skip

TAKE_RULES = [rule for rule in builtin_rules().values() if rule.takes]


def codes(take: Take) -> set[str]:
    """Return the codes that the rules of takes find in one, seen alone."""

    def fault_at(
        code: str, joint: str, frame: float | None, message: str, hint: str
    ) -> Fault:
        del joint, frame
        return Fault(code, message, hint=hint)

    # A rig of another size is another character, and not in another unit.
    subject = MotionSubject(take, fault_at)
    return {fault.code for rule in TAKE_RULES for fault in rule.load()(subject)}
