"""Feet that slide while they carry the body, and feet below or above the ground."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault
from animtool.validation.motion.contacts import (
    MIN_CONTACTS,
    Contacts,
    contacts_of,
    moves_over,
)
from animtool.validation.motion.pops import runs
from animtool.validation.motion.size import body_axis
from animtool.validation.motion.subject import MotionSubject

# A take that travels less is one on the spot, whose feet slide on purpose [size].
TRAVEL = 0.2
# The foot that carries slides at this speed [size/s], for so long at least [s].
SLIDE_SPEED, SLIDE_SECONDS = 0.12, 0.1
# Over this way at once, or over the lesser one so many times [size], [1].
SLIDE_WAY, OFTEN_WAY, OFTEN = 0.08, 0.035, 3
# Or it never stands: in four of five frames on the ground it moves at this speed
# [size/s], which is twice that of the roughest capture, for so long in all [s].
SKATE_SPEED, SKATE_SHARE, SKATE_SECONDS = 0.012, 0.2, 1.0
# The speed is that over this time [s]: shorter, it is noise.
SPEED_SECONDS = 0.1
# A foot is sunk that is this far below its ground [size], for so long [s].
SUNK, SUNK_SECONDS = 0.04, 0.05
# Of a character as tall as a person, the longest jump [s] for a size of 2.2 m; of
# others as the root of their size.
LONGEST_JUMP, PERSON_SIZE = 1.2, 2.2
# No foot, and no other joint, is nearer to the ground in the air [size].
AIR = 0.05
# At rest the lowest foot is this near to 0 of the up axis, where the ground is then;
# contacts this far from it are not on it [size].
STANDS_AT_ZERO, OFF_ZERO = 0.06, 0.05
# Fewer seconds of contacts do not show that a whole take is off the ground.
SHOWN_SECONDS = 0.3


def foot_slide(subject: MotionSubject) -> Iterator[Fault]:
    """Yield that the foot that carries the body slides (MOT208).

    Of the feet on the ground the slowest counts: one may be dragged while the other
    stands, and a heel turns about its toes.
    """
    contacts = contacts_of(subject)
    if (
        contacts is None
        or body_axis(subject)
        or _travel(subject) < TRAVEL * subject.size
    ):
        return
    level = subject.level(contacts.feet)
    speeds = _speeds(subject, level)
    speeds = np.where(contacts.carries, speeds, np.inf)
    slowest = speeds.min(axis=1)
    sliding = contacts.near.any(axis=1) & (slowest > SLIDE_SPEED * subject.size)
    ways = []
    for first, last in runs(sliding):
        seconds = (last - first + 1) * subject.interval
        way = float(slowest[first : last + 1].sum()) * subject.interval
        if way >= OFTEN_WAY * subject.size and seconds >= SLIDE_SECONDS:
            ways.append((way, first, last))
    if len(ways) < OFTEN and not any(w >= SLIDE_WAY * subject.size for w, *_ in ways):
        yield from _skating(subject, contacts, slowest)
        return
    way, first, last = max(ways)
    foot = int(contacts.feet[int(speeds[first : last + 1].mean(axis=0).argmin())])
    more = f"; feet slide {len(ways) - 1} times more" if len(ways) > 1 else ""
    message = (
        f"{subject.take.rig.joints[foot].name!r} stands and slides {way:.3g} m from "
        f"frame {subject.at(first)} to {subject.at(last)}{more}"
    )
    hint = "hold it with IK, or let a cycle stay on the spot"
    yield subject.fault("MOT208", foot, first, message, hint)


def _skating(
    subject: MotionSubject, contacts: Contacts, slowest: FloatArray
) -> Iterator[Fault]:
    """Yield that no foot ever stands still, though each slides a little alone."""
    standing = np.flatnonzero(contacts.near.any(axis=1))
    if len(standing) * subject.interval < SKATE_SECONDS:
        return
    speeds = slowest[standing]
    if np.quantile(speeds, SKATE_SHARE) < SKATE_SPEED * subject.size:
        return
    usual = float(np.median(speeds))
    frame = int(standing[int(np.abs(speeds - usual).argmin())])
    foot = int(contacts.feet[int(contacts.near[frame].argmax())])
    message = (
        f"no foot stands still on the ground: the slowest moves at {usual:.2g} m/s in "
        f"the middle of {len(standing)} frames, such as "
        f"{subject.take.rig.joints[foot].name!r} at frame {subject.at(frame)}"
    )
    hint = "hold feet with IK while they stand"
    yield subject.fault("MOT208", foot, frame, message, hint)


def _travel(subject: MotionSubject) -> float:
    """Return how far the roots go along the ground, from corner to corner [m]."""
    points = subject.level(np.array(subject.take.rig.roots[:1]))[:, 0]
    return float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))


def _speeds(subject: MotionSubject, points: FloatArray) -> FloatArray:
    """Return the speeds of points ``(F, E, 3)`` over a short time ``(F, E)`` [m/s]."""
    moves, frames = moves_over(subject, points, SPEED_SECONDS)
    return np.asarray(moves / (frames * subject.interval)[:, None])


def feet_off_ground(subject: MotionSubject) -> Iterator[Fault]:
    """Yield feet that sink into the ground or float above it (MOT209).

    The ground is 0 of the up axis where the rig rests standing on that, else the
    height at which the feet stand most.
    """
    contacts = contacts_of(subject)
    if contacts is None or body_axis(subject):
        return
    whole = list(_whole_take(subject, contacts))
    yield from whole or [*_sunk(subject, contacts), *_floating(subject, contacts)]


def _whole_take(subject: MotionSubject, contacts: Contacts) -> Iterator[Fault]:
    """Yield that all contacts are off the ground that the rig rests on."""
    if not subject.has_rest:
        return
    rests = subject.rest[contacts.feet] @ subject.up
    lowest = float((subject.rest @ subject.up).min())
    if abs(lowest) > STANDS_AT_ZERO * subject.size:
        return
    often = contacts.still.sum(axis=0)
    fewest = max(MIN_CONTACTS, round(SHOWN_SECONDS / subject.interval))
    shown = (often >= fewest) & contacts.flat
    if not shown.any():
        return
    offs = (contacts.ground - rests)[shown]
    # A heel may be up for good: the foot nearest to the ground counts.
    off = float(offs[np.abs(offs).argmin()])
    if abs(off) < OFF_ZERO * subject.size:
        return
    foot = int(contacts.feet[shown][np.abs(offs).argmin()])
    frame = int(np.flatnonzero(contacts.still[:, shown].any(axis=1))[0])
    how = "below" if off < 0.0 else "above"
    message = (
        f"the feet stand {abs(off):.3g} m {how} the ground, 0 of the up axis, on which "
        f"the rig rests; {subject.take.rig.joints[foot].name!r} is nearest to it"
    )
    hint = "lift or lower the root, or convert the take's units"
    yield subject.fault("MOT209", foot, frame, message, hint)


def _sunk(subject: MotionSubject, contacts: Contacts) -> Iterator[Fault]:
    """Yield the foot that is furthest below the ground of its contacts."""
    heights = subject.heights[:, contacts.feet]
    below = (contacts.ground - heights) * contacts.flat
    deep = below > SUNK * subject.size
    fewest = max(2, round(SUNK_SECONDS / subject.interval))
    sunk = []
    for e in range(len(contacts.feet)):
        for first, last in runs(deep[:, e]):
            if last - first + 1 >= fewest:
                depth = float(below[first : last + 1, e].max())
                sunk.append((depth, e, first, last))
    if not sunk:
        return
    depth, e, first, last = max(sunk)
    foot = int(contacts.feet[e])
    message = (
        f"{subject.take.rig.joints[foot].name!r} is up to {depth:.3g} m below the "
        f"ground from frame {subject.at(first)} to {subject.at(last)}; the ground is "
        f"where it stands in other frames, {contacts.ground[e]:.3g} m"
    )
    hint = "lift the root there, or hold the foot with IK"
    yield subject.fault("MOT209", foot, first, message, hint)


def _floating(subject: MotionSubject, contacts: Contacts) -> Iterator[Fault]:
    """Yield that no joint comes near to the ground for longer than a jump lasts."""
    flat = contacts.flat
    if not flat.any():
        return
    ground = float(contacts.ground[flat].min())
    above = subject.heights[:, contacts.feet[flat]] - contacts.ground[flat]
    lowest = subject.heights.min(axis=1) - ground
    air = (above.min(axis=1) > AIR * subject.size) & (lowest > AIR * subject.size)
    longest = LONGEST_JUMP * np.sqrt(subject.size / PERSON_SIZE)
    for first, last in runs(air):
        seconds = (last - first + 1) * subject.interval
        if seconds <= longest:
            continue
        height = float(lowest[first : last + 1].min())
        foot = int(contacts.feet[flat][above[first].argmin()])
        message = (
            f"no foot is nearer than {height:.3g} m to the ground from frame "
            f"{subject.at(first)} to {subject.at(last)}, for {seconds:.2g} s; the "
            f"ground is where they stand in other frames, {ground:.3g} m"
        )
        hint = "lower the root there; a jump does not last so long"
        yield subject.fault("MOT209", foot, first, message, hint)
        return
