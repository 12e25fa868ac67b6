"""Feet that penetrate the ground, or float above it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault
from animtool.maths.runs import runs
from animtool.validation.motion.body import body, feet_of, hips_of
from animtool.validation.motion.contacts import (
    MIN_CONTACTS,
    NEAR,
    FootStances,
    contacts_of,
)
from animtool.validation.motion.size import body_axis
from animtool.validation.motion.subject import MotionSubject

# A foot is sunk if it is this far below its ground [size], for this long [s].
SUNK, SUNK_SECONDS = 0.04, 0.05
# Longest jump [s] of a person-sized character (2.2 m); for others it scales with the
# square root of their size.
LONGEST_JUMP, PERSON_SIZE = 1.2, 2.2
# In the air no joint is closer to the ground than this [size].
AIR = 0.05
# On stairs one foot is on a step within this time of the other on the ground [s], and
# steps have this height at least [size].
STEP_SECONDS, STEP_HEIGHT = 0.8, 0.0375
# If the rig rests on 0 of the up axis within this, its feet stand at their rest height
# [size]. Contacts this far above it float; sunk ones are below it.
STANDS_AT_ZERO, OFF_ZERO = 0.06, 0.05
# Otherwise 0 counts as the ground too, but contacts this far from it have another
# origin, such as the hips [size].
OTHER_ORIGIN = 0.25
# A leg hangs at rest if it reaches down by this fraction of its length; spread legs do
# not show the height of feet [1]. Then these are no higher than this [size], and no
# lower than this fraction of it [1].
HANGS, ANKLE, TOE, FLAT = 0.95, 0.08, 0.03, 0.3
# Fewer seconds of contacts do not show that a complete take is off the ground.
SHOWN_SECONDS = 0.3


def feet_off_ground(subject: MotionSubject) -> Iterator[Fault]:
    """Yield feet that penetrate the ground or float above it (MOT209).

    The ground is 0 of the up axis if the rig rests on it, else the most common height
    of planted feet.
    """
    subject = subject.main
    contacts = contacts_of(subject)
    if contacts is None or body_axis(subject):
        return
    of_take = list(_full_take(subject, contacts))
    yield from of_take or [*_sunk(subject, contacts), *_floating(subject, contacts)]


def _full_take(subject: MotionSubject, contacts: FootStances) -> Iterator[Fault]:
    """Yield a fault if all contacts are offset from the ground at 0."""
    if not subject.has_rest:
        return
    often = contacts.static.sum(axis=0)
    fewest = max(MIN_CONTACTS, round(SHOWN_SECONDS / subject.interval))
    shown = np.flatnonzero((often >= fewest) & contacts.flat)
    if not len(shown):
        return
    least, most, rests_at_zero = _clearances(subject, contacts.feet[shown])
    ground = contacts.ground[shown]
    offs = np.where(ground < least, ground - least, np.maximum(ground - most, 0.0))
    # A heel may be up for good: the foot nearest to the ground counts. Where how high
    # feet stand is not known, the lowest one shows it best.
    nearest = int((np.abs(offs) if rests_at_zero else ground).argmin())
    off = float(offs[nearest])
    if -SUNK * subject.size < off < OFF_ZERO * subject.size:
        return
    lowest = subject.heights[:, contacts.feet].min(axis=1)
    slack = NEAR * subject.size if rests_at_zero else 0.0
    if off > 0.0 and float(np.percentile(lowest, 5)) < off - slack:
        return
    if not rests_at_zero and abs(off) > OTHER_ORIGIN * subject.size:
        return
    foot = int(contacts.feet[shown[nearest]])
    frame = int(np.flatnonzero(contacts.static[:, shown].any(axis=1))[0])
    how = "below" if off < 0.0 else "above"
    message = (
        f"the feet are {abs(off):.3g} m {how} the ground, 0 of the up axis; "
        f"{subject.take.rig.joints[foot].name!r} is nearest to it"
    )
    hint = "lift or lower the root, or convert the take's units"
    yield subject.fault("MOT209", foot, frame, message, hint)


def _clearances(
    subject: MotionSubject, feet: IntArray
) -> tuple[FloatArray, FloatArray, bool]:
    """Return the heights of foot joints above the ground in stance.

    Minimum and maximum ``(E,)`` [m], and whether the rig rests on 0 of the up axis.
    Legs that hang at rest show it; for others only flat feet are assumed.
    """
    rig, size = subject.take.rig, subject.rest_size
    scale = subject.size / size
    rest = subject.rest
    heights = rest @ subject.up
    lowest = float(heights.min())
    parents, hips = rig.parents, hips_of(subject)
    least = np.zeros(len(feet))
    most = np.zeros(len(feet))
    hangs = True
    known = set(feet_of(rig.names).tolist())
    for e, foot in enumerate(feet.tolist()):
        is_toe = int(parents[foot]) in known
        most[e] = (TOE if is_toe else ANKLE) * size
        if _hangs(rest, heights, _leg(parents.tolist(), known, hips, foot)):
            least[e] = heights[foot] - lowest
        else:
            hangs = False
    on_zero = hangs and -SUNK < 2.0 * lowest / size < 2.0 * STANDS_AT_ZERO
    if on_zero:
        least = most = heights[feet]
    else:
        least, most = np.maximum(least, FLAT * most), np.maximum(least, most)
    return least * scale, most * scale, on_zero


def _leg(parents: list[int], feet: set[int], hips: int, foot: int) -> list[int]:
    """Return the joints of a foot's leg, from ankle up to thigh.

    >>> _leg([-1, 0, 1, 2, 3], {3, 4}, 0, 4)
    [3, 2, 1]
    """
    joint = foot
    while parents[joint] in feet:
        joint = parents[joint]
    chain = [joint]
    while parents[joint] not in (-1, hips):
        joint = parents[joint]
        chain.append(joint)
    return chain


def _hangs(rest: FloatArray, heights: FloatArray, leg: list[int]) -> bool:
    """Return whether a leg hangs straight down at rest."""
    bones = np.linalg.norm(np.diff(rest[leg], axis=0), axis=1)
    return bool(heights[leg[-1]] - heights[leg[0]] > HANGS * bones.sum() > 0.0)


def _sunk(subject: MotionSubject, contacts: FootStances) -> Iterator[Fault]:
    """Yield the foot that is deepest below the ground of its contacts."""
    heights = subject.heights[:, contacts.feet]
    ground, known = _ground_of_pairs(subject, contacts)
    below = (ground - heights) * known
    deep = below > SUNK * subject.size
    fewest = max(2, round(SUNK_SECONDS / subject.interval))
    sunk = []
    for e in range(len(contacts.feet)):
        for first, end in runs(deep[:, e]):
            if end - first >= fewest:
                depth = float(below[first:end, e].max())
                sunk.append((depth, e, first, end - 1))
    if not sunk:
        return
    depth, e, first, last = max(sunk)
    foot = int(contacts.feet[e])
    who = "it" if contacts.flat[e] else "the other one"
    message = (
        f"{subject.take.rig.joints[foot].name!r} is up to {depth:.3g} m below the "
        f"ground from frame {subject.at(first)} to {subject.at(last)}; the ground is "
        f"at the height of {who} in other frames, {ground[e]:.3g} m"
    )
    hint = "lift the root there, or hold the foot with IK"
    yield subject.fault("MOT209", foot, first, message, hint)


def _ground_of_pairs(
    subject: MotionSubject, contacts: FootStances
) -> tuple[FloatArray, BoolArray]:
    """Return the ground height per foot, and whether it is known ``(E,)``.

    If one foot is planted at 0 of the up axis, as at rest, and the other one lower, 0
    is the ground of both.
    """
    ground, known = contacts.ground.copy(), contacts.flat.copy()
    if not subject.has_rest or known.all():
        return ground, known
    _, common, rests_at_zero = _clearances(subject, contacts.feet)
    higher = np.maximum(ground, ground[contacts.partners])
    split = contacts.level & contacts.level[contacts.partners] & ~known
    split &= np.abs(higher - common) < NEAR * subject.size
    if rests_at_zero:
        ground, known = np.where(split, higher, ground), known | split
    return ground, known


def _floating(subject: MotionSubject, contacts: FootStances) -> Iterator[Fault]:
    """Yield a fault if no joint is near the ground for longer than a jump."""
    flat = np.isfinite(contacts.floor)
    if not flat.any():
        return
    ground = float(contacts.floor[flat].min())
    above = subject.heights[:, contacts.feet[flat]] - contacts.floor[flat]
    lowest = subject.heights[:, body(subject)].min(axis=1) - ground
    air = (above.min(axis=1) > AIR * subject.size) & (lowest > AIR * subject.size)
    static = contacts.static[:, flat]
    # A file without units may be of a person, whatever its numbers are.
    tall = subject.size if subject.has_units else max(subject.size, PERSON_SIZE)
    longest = LONGEST_JUMP * np.sqrt(tall / PERSON_SIZE)
    for first, end in runs(air):
        last, seconds = end - 1, (end - first) * subject.interval
        if seconds <= longest or _climbs(subject, static, above, first, last):
            continue
        height = float(lowest[first : last + 1].min())
        foot = int(contacts.feet[flat][above[first].argmin()])
        message = (
            f"no foot is closer than {height:.3g} m to the ground from frame "
            f"{subject.at(first)} to {subject.at(last)}, for {seconds:.2g} s; the "
            f"ground is at their height in other frames, {ground:.3g} m"
        )
        hint = "lower the root there; no jump lasts that long"
        yield subject.fault("MOT209", foot, first, message, hint)
        return


def _climbs(
    subject: MotionSubject, static: BoolArray, above: FloatArray, first: int, last: int
) -> bool:
    """Return whether the feet climb one by one, as on stairs and ladders.

    Their first or last contacts in a run are at several heights; or shortly before or
    after it one foot is high and the other one on the ground. ``static`` and ``above``
    ``(F, E)`` [m].
    """
    size = subject.size
    reach = max(1, round(STEP_SECONDS / subject.interval))
    high, low = above > AIR * size, np.abs(above) < NEAR * size
    steps = (static & high).any(axis=1) & (static & low).any(axis=1)
    steps = np.asarray(steps)
    if steps[max(first - reach, 0) : first].any() or steps[last + 1 :][:reach].any():
        return True
    within, heights = static[first : last + 1], above[first : last + 1]
    stands = np.flatnonzero(within.any(axis=0))
    for rows in (slice(None), slice(None, None, -1)):
        at = np.argmax(within[rows], axis=0)
        contacts = heights[rows][at, np.arange(within.shape[1])][stands]
        if len(stands) and float(np.ptp(contacts)) > STEP_HEIGHT * size:
            return True
    return False
