"""Feet that stay where they stand: the root's way and the legs made to fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.runs import runs
from animtool.motion.contacts import (
    RAISED,
    FootContacts,
    smoothed,
    without_short,
)
from animtool.rig.limits import RangeLimit

# The hips go over from one foot to the other within this time of a contact [s].
HANDOVER = 0.15
# The hips do not follow what feet ask of them within this time [s].
SMOOTH = 0.15
# Weight of what nothing else decides: hips stay where the source has them.
LOOSE = 1e-6
# Weight of rows that are known.
PINNED = 1e9
# A knee near its stop goes fast: by this factor legs are less straight than those of
# the source, where feet are held.
BENT = 1.4
# Shares of a leg's length below which its knee is far from its stop.
FAR_FROM_STRAIGHT = 0.98
# How often feet in the air are raised, and how far below the ground they may stay [m].
RISES, SUNK = 3, 1e-4
# What corrects a foot in the air fades within this time [s].
FADE = 0.06
# A foot that leans more than this where it stands is not on level ground [rad].
LEVEL = np.radians(20.0)
# A leg is never straighter than this share of its length.
STRAIGHT = 0.9995
# Legs are as straight as those of the source are within this time of it, smoothed by a
# Gaussian of that width [s]: a second from a cut nothing may show of either.
STRAIGHT_WINDOW, STRAIGHT_SMOOTH = 0.75, 0.05
# The hips come down within about this time for a leg that does not reach [s].
LOWERING = 0.07
# How often that is put right at most, and by how much legs may fail to reach [m].
PINS, COVERED = 12, 1e-5


@dataclass(frozen=True, slots=True)
class Foot:
    """A foot of the target as its turns bring it, about the middle of the hips."""

    contacts: FootContacts
    hip: FloatArray  # beginning of the thigh (F, 3) [m]
    ankle: FloatArray  # (F, 3) [m]
    toe: FloatArray | None  # (F, 3) [m]
    rotation: FloatArray  # of the foot in the world (F, 4)
    # Its turn where it stands at rest (4,); None where it stands as it is.
    level: FloatArray | None
    height: float  # of the ankle above the ground where it stands [m]
    length: float  # how far the leg reaches [m]
    shortest: float  # how near to the hip the ankle comes [m]
    above: FloatArray  # ankle of the source above where it stands, scaled (F,) [m]
    straight: FloatArray  # share of it that the leg of the source reaches (F,)


@dataclass(frozen=True, slots=True)
class Placed:
    """Where hips and feet are to be."""

    hips: FloatArray  # the middle between the thighs (F, 3) [m]
    ankles: Sequence[FloatArray]  # of each foot (F, 3) [m]
    rotations: Sequence[FloatArray]  # (F, 4)
    locked: Sequence[BoolArray]  # frames in which each stands (F,)
    rolls: Sequence[FloatArray]  # how far the toe is what stands, 0 to 1 (F,)
    soles: Sequence[float]  # how high each toe stands, of none the ankle [m]
    lowered: float  # how far hips came down for legs that are too short, at most [m]


def plant_feet(hips: FloatArray, feet: Sequence[Foot], fps: float, up: int) -> Placed:
    """Return where hips and feet are, with feet that stay where they stand.

    The hips go the way of the source's, scaled, so that a part of a take goes the same
    way as in the whole; they rise and sink so that standing feet need no other pose of
    their legs, as far as that is smooth. What is left is a correction of each foot,
    which is constant where it stands, and as smooth as can be between.

    Args:
        hips: The middle between the thighs as the source's, scaled ``(F, 3)`` [m]; the
            ground at 0.
        feet: About these hips.
        fps: Frames a second.
        up: Component that points up.
    """
    rotations = [_settled(foot, fps, up) for foot in feet]
    bones = [
        _bone(foot, rotation) for foot, rotation in zip(feet, rotations, strict=True)
    ]
    # Who rolls over the toe holds that; else it is the ankle.
    pinned = [
        foot.ankle if foot.toe is None else foot.toe - bone
        for foot, bone in zip(feet, bones, strict=True)
    ]
    hips = hips.copy()
    raised = [_raised(foot, bone, up) for foot, bone in zip(feet, bones, strict=True)]
    hips[:, up] += _lift(hips, feet, pinned, raised, fps, up)
    locked = [foot.contacts.any for foot in feet]
    ankles = [
        _locked(hips + ankle, bone, foot, fps, up)
        for foot, ankle, bone in zip(feet, pinned, bones, strict=True)
    ]
    down, rise = _reaching(hips, feet, ankles, fps, up)
    hips[:, up] += rise - down
    soles = [foot.height + _level_bone(foot, up) for foot in feet]
    rolls = [_rolls(foot.contacts.toe, fps) for foot in feet]
    return Placed(
        hips,
        ankles,
        rotations,
        locked,
        rolls,
        soles,
        max(float(down.max(initial=0.0)), 0.0),
    )


def _settled(foot: Foot, fps: float, up: int) -> FloatArray:
    """Return turns of a foot, constant and level where all of it stands ``(F, 4)``."""
    flat = without_short(foot.contacts.ankle & foot.contacts.toe, fps)
    correction = np.zeros((len(flat), 3))
    for start, end in runs(flat):
        # The mean of turns that are near to each other.
        mean = so3.normalize(so3.align_signs(foot.rotation[start:end]).sum(axis=0))
        aim = mean
        if foot.level is not None:
            lean = so3.multiply(mean, so3.conjugate(foot.level))
            level = so3.multiply(_heading(lean, up), foot.level)
            aim = mean if so3.angle_between(level, mean) > LEVEL else level
        back = so3.conjugate(foot.rotation[start:end])
        correction[start:end] = so3.log(so3.multiply(aim, back))
    between(correction, flat, fps)
    return so3.align_signs(so3.multiply(so3.exp(correction), foot.rotation))


def _rolls(toe: BoolArray, fps: float) -> FloatArray:
    """Return 1 where a toe stands, which fades to 0 about it ``(F,)``."""
    rolls = toe[:, None].astype(np.float64)
    between(rolls, toe, fps)
    return np.asarray(np.clip(rolls[:, 0], 0.0, 1.0))


def _heading(rotation: FloatArray, up: int) -> FloatArray:
    """Return the part of a turn that is about the vertical ``(4,)``."""
    heading = np.zeros(4)
    heading[up], heading[3] = rotation[up], rotation[3]
    size = float(np.linalg.norm(heading))
    return heading / size if size > 0 else so3.IDENTITY.copy()


def _bone(foot: Foot, rotation: FloatArray) -> FloatArray:
    """Return the way from the ankle to the toe as the turned foot has it ``(F, 3)``."""
    if foot.toe is None:
        return np.zeros_like(foot.ankle)
    change = so3.multiply(rotation, so3.conjugate(foot.rotation))
    return so3.rotate(change, foot.toe - foot.ankle)


def _raised(foot: Foot, bone: FloatArray, up: int) -> FloatArray:
    """Return how far the ankle is raised where the toe alone stands ``(F,)`` [m]."""
    alone = foot.contacts.toe & ~foot.contacts.ankle
    return np.where(alone, _level_bone(foot, up) - bone[:, up], 0.0)


def _lift(
    hips: FloatArray,
    feet: Sequence[Foot],
    relative: Sequence[FloatArray],
    raised: Sequence[FloatArray],
    fps: float,
    up: int,
) -> FloatArray:
    """Return how far the standing feet lift the hips, smoothly ``(F,)`` [m]."""
    weights = np.array([_weight(foot.contacts.any, fps) for foot in feet])
    lift = np.zeros((len(hips), 1))
    for weight, foot, ankle, more in zip(weights, feet, relative, raised, strict=True):
        lift[:, 0] += weight * (foot.height + more - ankle[:, up] - hips[:, up])
    return _smoothest(weights.sum(axis=0), lift, (SMOOTH * fps) ** 4)[:, 0]


def _smoothest(draw: FloatArray, weighted: FloatArray, stiff: float) -> FloatArray:
    """Return the way ``(F, K)`` that is best at once by its places and bends.

    It has the least sum of weighted squares: of its places beside the given ones, and
    of its second differences.

    Args:
        draw: Weights of places ``(F,)``.
        weighted: These, each times its weight ``(F, K)``.
        stiff: Weight of second differences.
    """
    from scipy.linalg import solveh_banded

    count = len(draw)
    if count < 3 or not draw.any():
        return np.zeros_like(weighted)
    band = np.zeros((3, count))
    band[2] = draw + LOOSE
    for offset, pattern in ((0, (1.0, 4.0, 1.0)), (1, (-2.0, -2.0)), (2, (1.0,))):
        for k, value in enumerate(pattern):
            band[2 - offset, offset + k : count - 2 + offset + k] += stiff * value
    return np.asarray(solveh_banded(band, weighted))


def _weight(stands: BoolArray, fps: float) -> FloatArray:
    """Return how much a foot carries ``(F,)``: it comes and goes within its contact."""
    weight = np.zeros(len(stands))
    for start, end in runs(stands):
        frames = np.arange(start, end)
        ramp = max(min(HANDOVER * fps, (end - start) / 2), 1.0)
        # What the take cuts off went on.
        since = np.inf if start == 0 else frames - start
        left = np.inf if end == len(stands) else end - 1 - frames
        weight[start:end] = _smooth(np.minimum(since, left) / ramp)
    return weight


def _smooth(fraction: FloatArray) -> FloatArray:
    """Return a step from 0 to 1 of class C2."""
    t = np.clip(fraction, 0.0, 1.0)
    return np.asarray(t**3 * (10 - 15 * t + 6 * t * t))


def _level_bone(foot: Foot, up: int) -> float:
    """Return how much higher the toe is than the ankle where the foot is level [m]."""
    if foot.toe is None:
        return 0.0
    if foot.level is None:
        flat = foot.contacts.ankle & foot.contacts.toe
        bones = (foot.toe - foot.ankle)[flat if flat.any() else slice(None), up]
        return float(np.median(bones))
    rotation = so3.multiply(foot.level, so3.conjugate(foot.rotation[:1]))
    return float(so3.rotate(rotation, (foot.toe - foot.ankle)[:1])[0, up])


def _locked(
    ankle: FloatArray, bone: FloatArray, foot: Foot, fps: float, up: int
) -> FloatArray:
    """Return the way of an ankle that stays where the foot stands ``(F, 3)``.

    The toe stays where it stands with the heel, or alone; a heel that stands alone
    stays where it is as the toe comes down.
    """
    contacts = foot.contacts
    stands = contacts.any
    correction = np.zeros_like(ankle)
    level = foot.height + _level_bone(foot, up)
    for start, end in runs(stands):
        path, toe_offset = ankle[start:end], bone[start:end].copy()
        heel, toe = contacts.ankle[start:end], contacts.toe[start:end]
        flat = np.flatnonzero(heel & toe)
        if not len(flat):
            flat = np.arange(end - start)
        # A heel that stands alone is where it is in the nearest frame with the toe.
        alone = np.flatnonzero(heel & ~toe)
        behind = np.searchsorted(flat, alone)
        before = flat[np.maximum(behind - 1, 0)]
        after = flat[np.minimum(behind, len(flat) - 1)]
        toe_offset[alone] = toe_offset[
            np.where(alone - before <= after - alone, before, after)
        ]
        goal = (path + toe_offset)[flat].mean(axis=0)
        goal[up] = level
        if foot.toe is None:
            # Who kneels stands on the toes, though there is no joint of them.
            high = float(np.median(foot.above[start:end]))
            goal[up] += high if high > RAISED * foot.length else 0.0
        correction[start:end] = goal - toe_offset - path
    between(correction, stands, fps)
    _above_ground(correction[:, up], (ankle + bone)[:, up], level, stands, fps)
    return ankle + correction


def _above_ground(
    correction: FloatArray,
    toe: FloatArray,
    level: float,
    stands: BoolArray,
    fps: float,
) -> None:
    """Change a correction ``(F,)`` [m] so that no toe is below the ground in the air.

    Args:
        correction: Of the height of a foot.
        toe: Its height without that ``(F,)`` [m].
        level: How low it may be [m].
        stands: When it does ``(F,)``.
        fps: Frames a second.
    """
    if not stands.any():
        return  # nothing says where the ground is
    known = stands.copy()
    for _ in range(RISES):
        low = ~stands & (toe + correction < level - SUNK)
        if not low.any():
            return
        correction[low] = (level - toe)[low]
        known |= low
        rows = correction[:, None].copy()
        between(rows, known, fps)
        correction[:] = rows[:, 0]


def between(
    values: FloatArray, known: BoolArray, fps: float, fade: float = FADE
) -> None:
    """Fill rows ``(F, K)`` that are not known: they fade to 0 within a time [s]."""
    if known.all() or not known.any():
        return
    draw = np.where(known, PINNED, 1.0)
    weighted = values * np.where(known, PINNED, 0.0)[:, None]
    rows = _smoothest(draw, weighted, (fade * fps) ** 4)
    values[~known] = rows[~known]


def _reaching(
    hips: FloatArray,
    feet: Sequence[Foot],
    ankles: Sequence[FloatArray],
    fps: float,
    up: int,
) -> tuple[FloatArray, FloatArray]:
    """Return how far hips come down and up so that legs reach, both ``(F,)`` [m]."""
    down, rise = np.full((2, len(hips)), -np.inf)
    for foot, ankle in zip(feet, ankles, strict=True):
        offset = hips + foot.hip - ankle
        most = upper(foot.straight, STRAIGHT_WINDOW * fps, STRAIGHT_SMOOTH * fps)
        # The same leg may be as straight as it was.
        bent = BENT if foot.level is not None else 1.0
        fraction = np.clip(1 - bent * (1 - most), FAR_FROM_STRAIGHT, STRAIGHT)
        flat = offset.copy()
        flat[:, up] = 0.0
        across = (flat**2).sum(axis=1)
        high = np.sqrt(np.maximum((fraction * foot.length) ** 2 - across, 0.0))
        down = np.maximum(down, offset[:, up] - high)
        low = np.sqrt(np.maximum(foot.shortest**2 - across, 0.0))
        # Who hangs by the feet is not turned over.
        upright = (offset[:, up] > 0) & (low > 0)
        rise = np.maximum(rise, np.where(upright, low - offset[:, up], 0.0))
    return covering(down, LOWERING * fps), covering(rise, LOWERING * fps)


def covering(values: FloatArray, width: float) -> FloatArray:
    """Return what bends least, is no less than values, and else near 0 ``(F,)``.

    It is 0 where no value is above 0; it goes back there within a width [frames].
    """
    cover, pinned = np.zeros((len(values), 1)), np.zeros(len(values), np.bool_)
    for _ in range(PINS):
        low = values > cover[:, 0] + COVERED
        if not low.any():
            break
        pinned |= low & _peaks(values - cover[:, 0])
        draw = np.where(pinned, PINNED, 1.0)
        weighted = np.where(pinned, PINNED * values, 0.0)[:, None]
        cover = _smoothest(draw, weighted, max(width, 1.0) ** 4)
    return np.asarray(cover[:, 0])


def _peaks(values: FloatArray) -> BoolArray:
    """Return where values are above 0 and no less than their neighbours ``(F,)``."""
    padded = np.pad(values, 1, constant_values=-np.inf)
    high = (values >= padded[:-2]) & (values >= padded[2:])
    return np.asarray(high & (values > 0))


def upper(values: FloatArray, width: float, smooth: float | None = None) -> FloatArray:
    """Return what is smooth and above values ``(F,)`` within a width [frames].

    It is smoothed by a Gaussian of a width [frames]; None is a quarter of the other.
    """
    reach = int(np.ceil(width))
    padded = np.pad(values, reach, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)
    return smoothed(windows.max(axis=1), width / 4 if smooth is None else smooth)


def bend_limb(
    hip: FloatArray,
    joints: tuple[FloatArray, FloatArray],
    goal: FloatArray,
    rotations: tuple[FloatArray, FloatArray],
    hinge: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return turns of thigh and shin that bring an ankle to its goal, each ``(F, 4)``.

    The knee opens or closes in its own plane, then the leg turns as a whole by the
    shortest way.

    Args:
        hip: Where the thigh begins ``(F, 3)`` [m].
        joints: Knee and ankle as they are ``(F, 3)`` [m].
        goal: Where the ankle is to be ``(F, 3)`` [m].
        rotations: Of thigh and shin in the world ``(F, 4)``.
        hinge: What the knee turns about where the leg is straight ``(F, 3)``.
    """
    knee, ankle = joints
    thigh, shin = knee - hip, ankle - knee
    a, b = (np.linalg.norm(bone, axis=1) for bone in (thigh, shin))
    goal_distance = np.linalg.norm(goal - hip, axis=1)
    low, high = np.abs(a - b) * (1 + 1e-9), (a + b) * STRAIGHT
    # A leg that was straighter than that may stay so.
    high = np.maximum(high, np.minimum(np.linalg.norm(ankle - hip, axis=1), a + b))
    goal_distance = np.clip(goal_distance, low, high)
    axis = np.cross(thigh, shin)
    size = np.linalg.norm(axis, axis=1, keepdims=True)
    axis = np.where(
        size > 1e-3 * (a * b)[:, None], axis / np.maximum(size, 1e-300), hinge
    )
    cosine = np.clip((goal_distance**2 - a**2 - b**2) / (2 * a * b), -1.0, 1.0)
    now = np.arctan2(
        (np.cross(thigh, shin) * axis).sum(axis=1), (thigh * shin).sum(axis=1)
    )
    bend = so3.from_axis_angle(axis, np.arccos(cosine) - now)
    tip = thigh + so3.rotate(bend, shin)
    swing = shortest(tip, goal - hip)
    return (
        so3.multiply(swing, rotations[0]),
        so3.multiply(swing, so3.multiply(bend, rotations[1])),
    )


def bend_at_pin(
    hip: FloatArray,
    goal: FloatArray,
    thigh: FloatArray,
    bones: tuple[FloatArray, FloatArray],
    axis: FloatArray,
    angle: FloatArray,
    limits: RangeLimit | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return turns of the thigh ``(F, 4)`` and angles of the knee ``(F,)`` [rad].

    The knee opens until the ankle is as far off as its goal, then the thigh brings it
    there by the shortest way, or as near as limits of the knee let it.

    Args:
        hip: Where the thigh begins ``(F, 3)`` [m].
        goal: Where the ankle is to be ``(F, 3)`` [m].
        thigh: Its turns in the world as they are ``(F, 4)``.
        bones: Of the thigh, and of the shin where the knee rests, both in the frame of
            the thigh ``(3,)`` [m].
        axis: Of the knee there, of length 1 ``(3,)``.
        angle: Of the knee as it is ``(F,)`` [rad].
        limits: Of the knee: it bends the way that they let it, or else as it does.
    """
    upper, lower = bones
    along = float((upper @ axis) * (lower @ axis))
    cosine, sine = float(upper @ lower) - along, float(upper @ np.cross(axis, lower))
    size = float(np.hypot(cosine, sine))
    if not size:
        return thigh, angle
    reach = np.linalg.norm(goal - hip, axis=1)
    middle = (reach**2 - upper @ upper - lower @ lower) / 2 - along
    open_by = np.arccos(np.clip(middle / size, -1.0, 1.0))
    zero = float(np.arctan2(sine, cosine))
    both = np.stack([zero + open_by, zero - open_by])
    both -= 2 * np.pi * np.round((both - angle) / (2 * np.pi))
    off = np.abs(both - angle)
    if limits is not None:
        # Next to straight, either way is as near; beyond its stop no knee bends.
        off += BEYOND * np.abs(limits.excess(both))
    bent = np.where(off[0] <= off[1], *both)
    if limits is not None:
        bent = limits.clamped(bent)
    tip = upper + so3.rotate(so3.from_axis_angle(axis, bent), lower)
    return so3.multiply(shortest(so3.rotate(thigh, tip), goal - hip), thigh), bent


def shortest(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the shortest turns ``(F, 4)`` of directions ``(F, 3)`` to others."""
    a = before / np.linalg.norm(before, axis=1, keepdims=True)
    b = after / np.linalg.norm(after, axis=1, keepdims=True)
    quaternions = np.concatenate(
        [np.cross(a, b), 1 + (a * b).sum(axis=1)[:, None]], axis=1
    )
    known = np.abs(quaternions).max(axis=1)[:, None] > OPPOSITE
    return so3.normalize(np.where(known, quaternions, [1.0, 0.0, 0.0, 0.0]))


# How much more a knee beyond its stop counts than one that goes far [1].
BEYOND = 100.0
# Directions whose product is nearer to -1 are opposite.
OPPOSITE = 1e-9
