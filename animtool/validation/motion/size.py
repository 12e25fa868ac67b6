"""Size and stance: units, up axis, bones that change their length."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity
from animtool.retarget.anatomy import anatomy
from animtool.retarget.standing import Stance, stance
from animtool.rig.kinematics import rest_world
from animtool.rig.skeleton import JointType
from animtool.validation.motion.body import body, feet_of, hips_of, placed
from animtool.validation.motion.subject import MotionSubject

# Share of its length that a bone may change by, and of the rig's size below which a
# bone has none to speak of [1].
GROWS, SHORT = 0.5, 0.02
# Factors by which units are mistaken: m, cm, mm and in, and how near to one [1].
FACTORS = (10.0, 100.0, 1000.0, 39.37)
NEAR_FACTOR = 0.15
# A root this many times as high as at rest is of another unit, whatever it does [1].
HIGH = (25.0, 4000.0)
# Or, in the unit that its numbers are of, the lowest joint is this near to 0 of the up
# axis in most frames [size], [1]. Or it comes so near at times, as on stairs, and then
# stands in so many frames [size], [size/s], [1].
ON_ZERO, ON_ZERO_SHARE = 0.06, 0.5
AT_TIMES, TREADS, TREADS_SHARE = 0.05, 0.12, 0.4
# Of animated bones, the share that must have one such factor [1].
MAX_BONES = 0.8
# From a bird to a dinosaur, of rigs with feet [m]: the diagonal of their joints.
CHARACTER = (0.1, 25.0)
# People and most animals [m]; another unit must bring a character into this.
LIKELY = (0.3, 5.0)
# What anything with a skeleton spans, feet or not [m]: from an insect to a ship.
ANYTHING = (0.004, 400.0)
# Fewer joints are a prop, of any size.
MIN_JOINTS = 10
# Fewer frames are a pose, which may lie.
MIN_FRAMES = 8


def stretched(subject: MotionSubject) -> Iterator[Fault]:
    """Yield bones whose length changes by over a half (MOT212)."""
    subject = subject.main
    if not subject.has_rest or _bone_factor(subject) is not None:
        return
    locations = placed(subject)
    worst: tuple[float, int, int, float, float] | None = None
    count = 0
    channel = subject.take.motion.translations
    for a, j in enumerate(channel.animated.tolist()):
        joint = subject.take.rig.joints[j]
        rest = math.hypot(*joint.translation)
        slides = joint.type is JointType.PRISMATIC
        if slides or locations[j] or rest <= SHORT * subject.rest_size:
            continue
        lengths = np.linalg.norm(channel.values[:, a], axis=1)
        off = np.abs(lengths / rest - 1.0)
        frame = int(off.argmax())
        if off[frame] > GROWS:
            count += 1
            strain = (float(off[frame]), j, frame, float(lengths[frame]), rest)
            worst = strain if worst is None or strain[0] > worst[0] else worst
    if worst is None:
        return
    _, j, frame, length, rest = worst
    more = f"; {count - 1} more bones change too" if count > 1 else ""
    message = (
        f"the bone to {subject.take.rig.joints[j].name!r} is {length:.3g} m long at "
        f"frame {subject.at(frame)}, but {rest:.3g} m at rest{more}"
    )
    hint = "translations replace those of the rest pose; they are not added"
    yield subject.fault("MOT212", j, frame, message, hint)


def _bone_factor(subject: MotionSubject) -> float | None:
    """Return the factor between animated bones and those at rest, if it is a unit's."""
    rig, translations = subject.take.rig, subject.take.motion.translations
    bones = np.flatnonzero(~placed(subject))
    rest = np.linalg.norm(rig.rest_translations[bones], axis=1)
    kept = rest > SHORT * subject.rest_size
    bones, rest = bones[kept], rest[kept]
    if not len(bones):
        return None
    lengths = np.linalg.norm(translations.gather(bones), axis=2)
    ratios = np.median(lengths, axis=0) / rest
    return _unit_factor(ratios)


def _unit_factor(ratios: FloatArray) -> float | None:
    """Return the factor of two units that most ratios are near to."""
    if not len(ratios):
        return None
    for factor in (*FACTORS, *(1.0 / factor for factor in FACTORS)):
        near = np.abs(ratios / factor - 1.0) < NEAR_FACTOR
        if float(near.mean()) >= MAX_BONES:
            return factor
    return None


def other_units(subject: MotionSubject) -> Iterator[Fault]:
    """Yield that the motion, or the whole character, is in another unit (MOT213)."""
    subject = subject.main
    factor = _bone_factor(subject) if subject.has_rest else None
    if factor is not None:
        message = (
            f"the bones are {_times(factor)} as long as those of the rig at rest: "
            "the animation uses another unit"
        )
        hint = "convert the animation, or set metersPerUnit of its layer"
        yield subject.fault("MOT213", None, 0, message, hint)
        return
    off = _root_factor(subject)
    if off is not None:
        root, factor = off
        message = (
            f"the root {subject.take.rig.joints[root].name!r} is {_times(factor)} as "
            "high as at rest: its translation uses another unit"
        )
        hint = "convert the root's translations to the unit of the rig"
        yield subject.fault("MOT213", root, 0, message, hint)
        return
    low, high = CHARACTER
    size = subject.size
    if not subject.has_units or not _is_character(subject) or low <= size <= high:
        return
    fitting = [
        factor
        for factor in (*FACTORS[:3], *(1.0 / factor for factor in FACTORS[:3]))
        if LIKELY[0] <= size * factor <= LIKELY[1]
    ]
    if not fitting:
        return
    message = (
        f"the character spans {_length(size)}; {_times(fitting[0])} the size it would "
        f"span {_length(size * fitting[0])}"
    )
    unit = subject.take.rig.meters_per_unit
    hint = f"its unit is {unit:g} m; probably {unit * fitting[0]:g} m is meant"
    yield subject.fault("MOT213", None, None, message, hint)


def _root_factor(subject: MotionSubject) -> tuple[int, float] | None:
    """Return a root that moves at many times its height at rest, and how many.

    Where the rig rests at its hips, these are as high as its legs are long.
    """
    if not subject.has_rest or not _is_character(subject):
        return None
    rig = subject.take.rig
    moving = set(subject.moving.tolist())
    heights = subject.rest @ subject.up
    legs = float(heights[hips_of(subject)] - heights[feet_of(rig.names)].min())
    least = 0.1 * subject.rest_size
    for root in sorted({*rig.roots, hips_of(subject)} & moving):
        rest = float(heights[root])
        at_hips = rest < least
        if max(rest, legs) < least:
            continue
        height = float(np.median(subject.heights[:, root]))
        ratio = height / (legs if at_hips else rest)
        # At 1/100 of its height a root is at 0, where one of another origin is, too.
        factor = _low_factor(subject, root) if ratio < 1.0 else _high(ratio)
        if factor is None and not at_hips:
            factor = _unit_factor(np.array([ratio]))
        if factor is not None and abs(math.log10(factor)) > 1.5:
            return int(root), factor
    return None


def _low_factor(subject: MotionSubject, root: int) -> float | None:
    """Return the part of a unit that a root's numbers are of, if its feet show that.

    Multiplied back, its translation puts the lowest joint on the ground, however the
    body crouches or crawls.
    """
    joints = subject.positions[:, body(subject)]
    lowest = (joints @ subject.up).argmin(axis=1)
    points = joints[np.arange(len(joints)), lowest]
    for factor in FACTORS:
        lift = (factor - 1.0) * subject.positions[:, root]
        above = (points + lift) @ subject.up
        if float((np.abs(above) < ON_ZERO * subject.size).mean()) > ON_ZERO_SHARE:
            return 1.0 / factor
        if abs(float(np.percentile(above, 5))) > AT_TIMES * subject.size:
            continue
        before = joints[np.arange(len(joints) - 1) + 1, lowest[:-1]]
        steps = before + lift[1:] - points[:-1] - lift[:-1]
        slow = np.linalg.norm(steps, axis=1) < TREADS * subject.size * subject.interval
        if float(slow.mean()) > TREADS_SHARE:
            return 1.0 / factor
    return None


def _high(ratio: float) -> float | None:
    """Return the factor of two units that a height is nearest to, if it is one.

    Who crawls or climbs is lower or higher than at rest, and nobody so many times.

    >>> _high(45.0), _high(1700.0), _high(12.0), _high(1e6)
    (39.37, 1000.0, None, None)
    """
    if not HIGH[0] < ratio < HIGH[1]:
        return None
    return min(FACTORS, key=lambda factor: abs(math.log(ratio / factor)))


def _is_character(subject: MotionSubject) -> bool:
    """Return whether a rig has feet and joints enough to be of a person or animal."""
    rig = subject.take.rig
    return len(rig.joints) >= MIN_JOINTS and len(feet_of(rig.names)) > 0


def _times(factor: float) -> str:
    """Return a factor in words.

    >>> _times(100.0), _times(0.01)
    ('100 times', '1/100')
    """
    return f"{factor:.3g} times" if factor >= 1.0 else f"1/{1.0 / factor:.3g}"


def _length(meters: float) -> str:
    """Return a length in a unit that people would say it in.

    >>> _length(0.0012), _length(158.0)
    ('1.2 mm', '158 m')
    """
    if meters < 0.01:
        return f"{1000.0 * meters:.3g} mm"
    if meters < 1.0:
        return f"{100.0 * meters:.3g} cm"
    return f"{meters:.4g} m"


def strange_size(subject: MotionSubject) -> Iterator[Fault]:
    """Yield that a skeleton is smaller or larger than anything that moves (MOT215)."""
    low, high = ANYTHING
    if not subject.has_units:
        return
    if len(subject.take.rig.joints) < 2 or low <= subject.size <= high:
        return
    if _is_character(subject) and next(other_units(subject), None) is not None:
        return
    if subject.size * 1e3 < low * 1e-3:
        # All joints are at one place: a rig of controls, or of one joint.
        return
    message = f"the skeleton spans {_length(subject.size)}"
    unit = subject.take.rig.meters_per_unit
    hint = f"check its unit, {unit:g} m"
    yield subject.fault("MOT215", None, None, message, hint)


def body_axis(subject: MotionSubject) -> Stance | None:
    """Return how a body stands, where that is not along the axis that is up."""
    rig = subject.take.rig
    if subject.frames < MIN_FRAMES or len(rig.joints) < MIN_JOINTS:
        return None
    rest = rest_world(rig).positions[0] if subject.has_rest else None
    found = stance(anatomy(rig).roles, subject.positions, rig.up, rest)
    return None if found.axis is None and not found.upside_down else found


def mismatched_up_axis(subject: MotionSubject) -> Iterator[Fault]:
    """Yield that the body stands along another axis than the up axis (MOT214)."""
    rig, found = subject.take.rig, body_axis(subject)
    if found is None:
        return
    where = "upside down" if found.axis is None else f"along {found.axis}"
    share = 100.0 * found.fraction
    message = f"the body is {where} in {share:.0f}% of the frames; up is {rig.up}"
    hint = "rotate the root"
    if found.axis is not None:
        hint = (
            f"set upAxis {found.axis}, or read the file with "
            f"{argument('source.up', found.axis)}"
        )
    fault = subject.fault("MOT214", int(rig.roots[0]), 0, message, hint)
    # A file that states no up axis is read in the usual one.
    yield fault if subject.has_units else replace(fault, severity=Severity.NOTE)
