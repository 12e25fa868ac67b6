"""Foot planting: root path and legs are solved for feet that stay in place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.runs import runs
from animtool.motion.contacts import (
    RAISED_HEEL_HEIGHT,
    FootContacts,
    gaussian_smoothed,
    without_short_runs,
)
from animtool.rig.limits import RangeLimit

# The hips shift from one foot to the other within this time of a contact [s].
HANDOVER = 0.15
# Smoothing time of the hips' response to the feet [s].
SMOOTH = 0.15
# Weight of the source's hip position, where nothing else decides.
LOOSE = 1e-6
# Weight of known rows.
PINNED = 1e9
# A knee near its stop goes fast: by this factor legs are less straight than those of
# the source, where feet are held.
BENT = 1.4
# Shares of a leg's length below which its knee is far from its stop.
FAR_FROM_STRAIGHT = 0.98
# Times that feet in the air are raised, and how far below the ground they may stay [m].
MAX_ITERATIONS, MAX_PENETRATION = 3, 1e-4
# What corrects a foot in the air fades within this time [s].
FADE = 0.06
# A foot that leans more than this where it stands is not on level ground [rad].
LEVEL = np.radians(20.0)
# Legs are never straighter than this fraction of their length.
STRAIGHT = 0.9995
# Legs are as straight as those of the source are within this time of it, smoothed by a
# Gaussian of that width [s]; both fade within a second, so that no block edge shows.
STRAIGHT_WINDOW, STRAIGHT_SMOOTH = 0.75, 0.05
# The hips come down within about this time for a leg that does not reach [s].
LOWERING = 0.07
# Most iterations of that, and the tolerated reach error [m].
MAX_LOWERING_ITERATIONS, REACH_TOLERANCE = 12, 1e-5


@dataclass(frozen=True, slots=True)
class Foot:
    """A foot of the target before planting, relative to the middle of the hips."""

    contacts: FootContacts
    hip: FloatArray  # beginning of the thigh (F, 3) [m]
    ankle: FloatArray  # (F, 3) [m]
    toe: FloatArray | None  # (F, 3) [m]
    rotation: FloatArray  # of the foot in the world (F, 4)
    # Its rotation planted at rest (4,); None to keep its rotation.
    level: FloatArray | None
    height: float  # of the planted ankle above the ground [m]
    length: float  # how far the leg reaches [m]
    shortest: float  # least distance of ankle and hip [m]
    above: FloatArray  # source ankle above its planted height, scaled (F,) [m]
    straight: FloatArray  # reach of the source's leg over its length (F,)


@dataclass(frozen=True, slots=True)
class Placed:
    """Solved positions of hips and feet."""

    hips: FloatArray  # the middle between the thighs (F, 3) [m]
    ankles: Sequence[FloatArray]  # of each foot (F, 3) [m]
    rotations: Sequence[FloatArray]  # (F, 4)
    locked: Sequence[BoolArray]  # frames in which each is planted (F,)
    rolls: Sequence[FloatArray]  # how far only the toe is planted, 0 to 1 (F,)
    soles: Sequence[float]  # planted height of each toe, or else ankle [m]
    lowered: float  # most that hips sank for legs that are too short [m]


def plant_feet(hips: FloatArray, feet: Sequence[Foot], fps: float, up: int) -> Placed:
    """Return hips and feet such that planted feet stay in place.

    The hips follow the source's scaled path, so that part of a take moves as it does in
    the full take. They rise and sink so that planted feet need no other leg pose, as
    far as that is smooth. The remaining offset of each foot is constant while it is
    planted and as smooth as possible in between.

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
    # A foot that rolls over its toe pins the toe, else the ankle.
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
    """Return a foot's rotations, constant and level while planted flat ``(F, 4)``."""
    flat = without_short_runs(foot.contacts.ankle & foot.contacts.toe, fps)
    correction = np.zeros((len(flat), 3))
    for start, end in runs(flat):
        # The mean of rotations that are near each other.
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
    """Return 1 where only the toe is planted, fading to 0 around it ``(F,)``."""
    rolls = toe[:, None].astype(np.float64)
    between(rolls, toe, fps)
    return np.asarray(np.clip(rolls[:, 0], 0.0, 1.0))


def _heading(rotation: FloatArray, up: int) -> FloatArray:
    """Return the part of a rotation about the vertical ``(4,)``."""
    heading = np.zeros(4)
    heading[up], heading[3] = rotation[up], rotation[3]
    size = float(np.linalg.norm(heading))
    return heading / size if size > 0 else so3.IDENTITY.copy()


def _bone(foot: Foot, rotation: FloatArray) -> FloatArray:
    """Return the vector from ankle to toe for the foot's rotation ``(F, 3)``."""
    if foot.toe is None:
        return np.zeros_like(foot.ankle)
    change = so3.multiply(rotation, so3.conjugate(foot.rotation))
    return so3.rotate(change, foot.toe - foot.ankle)


def _raised(foot: Foot, bone: FloatArray, up: int) -> FloatArray:
    """Return how far the ankle rises where only the toe is planted ``(F,)`` [m]."""
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
    """Return how far planted feet lift the hips, smoothed ``(F,)`` [m]."""
    weights = np.array([_weight(foot.contacts.any, fps) for foot in feet])
    lift = np.zeros((len(hips), 1))
    for weight, foot, ankle, more in zip(weights, feet, relative, raised, strict=True):
        lift[:, 0] += weight * (foot.height + more - ankle[:, up] - hips[:, up])
    return _smoothest(weights.sum(axis=0), lift, (SMOOTH * fps) ** 4)[:, 0]


def _smoothest(draw: FloatArray, weighted: FloatArray, stiff: float) -> FloatArray:
    """Return the path ``(F, K)`` that best balances position targets against curvature.

    It minimises the weighted sum of squared distances to the targets and of squared
    second differences.

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
    """Return how much weight a foot carries ``(F,)``; it fades within its contact."""
    weight = np.zeros(len(stands))
    for start, end in runs(stands):
        frames = np.arange(start, end)
        ramp = max(min(HANDOVER * fps, (end - start) / 2), 1.0)
        # Contacts cut by the ends of the take continue.
        since = np.inf if start == 0 else frames - start
        left = np.inf if end == len(stands) else end - 1 - frames
        weight[start:end] = _smooth(np.minimum(since, left) / ramp)
    return weight


def _smooth(fraction: FloatArray) -> FloatArray:
    """Return a smooth step from 0 to 1 of class C2."""
    t = np.clip(fraction, 0.0, 1.0)
    return np.asarray(t**3 * (10 - 15 * t + 6 * t * t))


def _level_bone(foot: Foot, up: int) -> float:
    """Return the height of the toe above the ankle for a level foot [m]."""
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
    """Return the path of an ankle whose foot is pinned while planted ``(F, 3)``.

    The toe is pinned whenever it is planted, with the heel or alone; a heel that is
    planted alone stays in place while the toe comes down.
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
        # A heel planted alone stays where it is in the nearest frame with the toe.
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
            # A kneeling body rests on its toes, even without toe joints.
            high = float(np.median(foot.above[start:end]))
            goal[up] += high if high > RAISED_HEEL_HEIGHT * foot.length else 0.0
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
    """Raise a height correction ``(F,)`` [m] so that no toe in the air is below ground.

    Args:
        correction: Of the height of a foot.
        toe: Its height without that ``(F,)`` [m].
        level: How low it may be [m].
        stands: When it does ``(F,)``.
        fps: Frames a second.
    """
    if not stands.any():
        return  # the ground is unknown
    known = stands.copy()
    for _ in range(MAX_ITERATIONS):
        low = ~stands & (toe + correction < level - MAX_PENETRATION)
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
    """Fill unknown rows ``(F, K)``: they fade to 0 within a time [s]."""
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
    """Return how far hips sink and rise so that legs reach, each ``(F,)`` [m]."""
    down, rise = np.full((2, len(hips)), -np.inf)
    for foot, ankle in zip(feet, ankles, strict=True):
        offset = hips + foot.hip - ankle
        most = upper(foot.straight, STRAIGHT_WINDOW * fps, STRAIGHT_SMOOTH * fps)
        # A similar leg may be as straight as the source's.
        bent = BENT if foot.level is not None else 1.0
        fraction = np.clip(1 - bent * (1 - most), FAR_FROM_STRAIGHT, STRAIGHT)
        flat = offset.copy()
        flat[:, up] = 0.0
        across = (flat**2).sum(axis=1)
        high = np.sqrt(np.maximum((fraction * foot.length) ** 2 - across, 0.0))
        down = np.maximum(down, offset[:, up] - high)
        low = np.sqrt(np.maximum(foot.shortest**2 - across, 0.0))
        # A body hanging by its feet is not flipped.
        upright = (offset[:, up] > 0) & (low > 0)
        rise = np.maximum(rise, np.where(upright, low - offset[:, up], 0.0))
    return covering(down, LOWERING * fps), covering(rise, LOWERING * fps)


def covering(values: FloatArray, width: float) -> FloatArray:
    """Return the smoothest curve above the values, near 0 elsewhere ``(F,)``.

    It is 0 where no value is above 0, and returns to 0 within a width [frames].
    """
    cover, pinned = np.zeros((len(values), 1)), np.zeros(len(values), np.bool_)
    for _ in range(MAX_LOWERING_ITERATIONS):
        low = values > cover[:, 0] + REACH_TOLERANCE
        if not low.any():
            break
        pinned |= low & _peaks(values - cover[:, 0])
        draw = np.where(pinned, PINNED, 1.0)
        weighted = np.where(pinned, PINNED * values, 0.0)[:, None]
        cover = _smoothest(draw, weighted, max(width, 1.0) ** 4)
    return np.asarray(cover[:, 0])


def _peaks(values: FloatArray) -> BoolArray:
    """Return where values are positive local maxima ``(F,)``."""
    padded = np.pad(values, 1, constant_values=-np.inf)
    high = (values >= padded[:-2]) & (values >= padded[2:])
    return np.asarray(high & (values > 0))


def upper(values: FloatArray, width: float, smooth: float | None = None) -> FloatArray:
    """Return a smooth upper envelope of values ``(F,)`` with a width [frames].

    It is smoothed by a Gaussian of ``smooth`` frames; None is a quarter of the width.
    """
    reach = int(np.ceil(width))
    padded = np.pad(values, reach, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)
    return gaussian_smoothed(
        windows.max(axis=1), width / 4 if smooth is None else smooth
    )


def bend_limb(
    hip: FloatArray,
    joints: tuple[FloatArray, FloatArray],
    goal: FloatArray,
    rotations: tuple[FloatArray, FloatArray],
    hinge: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return rotations of thigh and shin that bring ankles to goals ``(F, 4)``.

    The knee bends in its own plane, then the leg rotates rigidly by the shortest arc.

    Args:
        hip: Where the thigh begins ``(F, 3)`` [m].
        joints: Knee and ankle as they are ``(F, 3)`` [m].
        goal: Ankle goals ``(F, 3)`` [m].
        rotations: World rotations of thigh and shin ``(F, 4)``.
        hinge: Knee axis of a straight leg ``(F, 3)``.
    """
    knee, ankle = joints
    thigh, shin = knee - hip, ankle - knee
    a, b = (np.linalg.norm(bone, axis=1) for bone in (thigh, shin))
    goal_distance = np.linalg.norm(goal - hip, axis=1)
    low, high = np.abs(a - b) * (1 + 1e-9), (a + b) * STRAIGHT
    # A leg that was straighter may stay so.
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
    """Return thigh rotations ``(F, 4)`` and pin-knee angles ``(F,)`` [rad] for a goal.

    The knee opens until the ankle is at its goal's distance, then the thigh brings it
    there by the shortest arc, or as near as the knee's limits allow.

    Args:
        hip: Where the thigh begins ``(F, 3)`` [m].
        goal: Ankle goals ``(F, 3)`` [m].
        thigh: Its current world rotations ``(F, 4)``.
        bones: Of the thigh, and of the shin where the knee rests, both in the frame of
            the thigh ``(3,)`` [m].
        axis: Of the knee there, of length 1 ``(3,)``.
        angle: Current angle of the knee ``(F,)`` [rad].
        limits: Of the knee: it bends as they allow, or else as it is bent.
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
    """Return the shortest rotations ``(F, 4)`` from directions ``(F, 3)`` to others."""
    a = before / np.linalg.norm(before, axis=1, keepdims=True)
    b = after / np.linalg.norm(after, axis=1, keepdims=True)
    quaternions = np.concatenate(
        [np.cross(a, b), 1 + (a * b).sum(axis=1)[:, None]], axis=1
    )
    known = np.abs(quaternions).max(axis=1)[:, None] > OPPOSITE
    return so3.normalize(np.where(known, quaternions, [1.0, 0.0, 0.0, 0.0]))


# Cost of a knee beyond its stop, over that of a large change [1].
BEYOND = 100.0
# Directions with a product nearer to -1 are opposite.
OPPOSITE = 1e-9
