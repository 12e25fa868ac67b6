"""Detects feet that penetrate the ground or float above it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault
from animtool.maths.runs import runs
from animtool.rig.body_size import find_feet
from animtool.validation.motion.body import body_joints, hips_of
from animtool.validation.motion.contacts import (
    MIN_CONTACT_FRAMES,
    PLANTED_HEIGHT,
    FootStances,
    find_contacts,
)
from animtool.validation.motion.size import tilted_stance
from animtool.validation.motion.subject import MotionSubject

# A foot is below ground if it is this far below its contact height [size], for this
# long [s].
MIN_SUNK_DEPTH, MIN_SUNK_SECONDS = 0.04, 0.05
# Longest jump [s] of a person-sized character (2.2 m); for others it scales with the
# square root of their size.
MAX_JUMP_SECONDS, PERSON_SIZE = 1.2, 2.2
# Minimum height of all joints in the air [size].
MIN_AIR_HEIGHT = 0.05
# On stairs, one foot is on a step within this interval of the other on the ground [s],
# and steps have at least this height [size].
STEP_SECONDS, MIN_STEP_HEIGHT = 0.8, 0.0375
# If the rig rests on 0 of the up axis within this distance, its feet are planted at
# their rest height [size]. Contacts this far above it float; contacts this far below it
# are underground.
ZERO_REST_TOLERANCE, MAX_ZERO_OFFSET = 0.06, 0.05
# Otherwise 0 is assumed to be the ground too, but contacts this far from it have
# another origin, such as the hips [size].
OTHER_ORIGIN_OFFSET = 0.25
# A leg hangs at rest if it extends downwards by this fraction of its length; spread
# legs do not show the height of feet [1]. Then ankles and toes are at most this high
# [size], and at least this fraction of it [1].
HANGING_FRACTION, MIN_HEIGHT_FRACTION = 0.95, 0.3
MAX_ANKLE_HEIGHT, MAX_TOE_HEIGHT = 0.08, 0.03
# Contacts must last this long to show that a complete take is off the ground [s].
MIN_CONTACT_SECONDS = 0.3


def feet_off_ground(subject: MotionSubject) -> Iterator[Fault]:
    """Yield faults for feet that penetrate the ground or float above it (MOT209).

    The ground is 0 of the up axis if the rig rests on it, else the most common height
    of planted feet.
    """
    subject = subject.without_first_pose
    contacts = find_contacts(subject)
    if contacts is None or tilted_stance(subject):
        return
    # The reader of a file reports it when it is baked, too.
    if any(notice.code == "MOT209" for notice in subject.take.notices):
        return
    offset_faults = list(_offset_fault(subject, contacts))
    yield from offset_faults or [
        *_sunk_foot_fault(subject, contacts),
        *_floating_fault(subject, contacts),
    ]


def _offset_fault(subject: MotionSubject, contacts: FootStances) -> Iterator[Fault]:
    """Yield a fault if all contacts are at an equal distance from the ground at 0."""
    if not subject.has_rest:
        return
    contact_counts = contacts.is_static.sum(axis=0)
    min_count = max(MIN_CONTACT_FRAMES, round(MIN_CONTACT_SECONDS / subject.interval))
    contact_feet = np.flatnonzero(
        (contact_counts >= min_count) & contacts.has_same_height
    )
    if not len(contact_feet):
        return
    min_clearance, max_clearance, is_resting_at_zero = _clearances(
        subject, contacts.feet[contact_feet]
    )
    ground = contacts.ground[contact_feet]
    offsets = np.where(
        ground < min_clearance,
        ground - min_clearance,
        np.maximum(ground - max_clearance, 0.0),
    )
    # A heel may stay up: the foot nearest to the ground counts. If the contact heights
    # of feet are unknown, the lowest foot shows them best.
    nearest_foot = int((np.abs(offsets) if is_resting_at_zero else ground).argmin())
    offset = float(offsets[nearest_foot])
    if -MIN_SUNK_DEPTH * subject.size < offset < MAX_ZERO_OFFSET * subject.size:
        return
    lowest_heights = subject.heights[:, contacts.feet].min(axis=1)
    tolerance = PLANTED_HEIGHT * subject.size if is_resting_at_zero else 0.0
    if offset > 0.0 and float(np.percentile(lowest_heights, 5)) < offset - tolerance:
        return
    if not is_resting_at_zero and abs(offset) > OTHER_ORIGIN_OFFSET * subject.size:
        return
    joint = int(contacts.feet[contact_feet[nearest_foot]])
    frame = int(contacts.is_static[:, contact_feet].any(axis=1).argmax())
    side = "below" if offset < 0.0 else "above"
    message = (
        f"the feet are {abs(offset):.3g} m {side} the ground, 0 of the up axis; "
        f"{subject.take.rig.joints[joint].name!r} is nearest to it"
    )
    hint = "lift or lower the root, or convert the take's units"
    yield subject.fault("MOT209", joint, frame, message, hint)


def _clearances(
    subject: MotionSubject, feet: IntArray
) -> tuple[FloatArray, FloatArray, bool]:
    """Return the heights that foot joints may have above the ground when planted.

    Minimum and maximum ``(E,)`` [m], and whether the rig rests on 0 of the up axis.
    Legs that hang at rest define the height; for others only flat feet are assumed.
    """
    rig, rest_size = subject.take.rig, subject.rest_size
    scale = subject.size / rest_size
    rest_positions = subject.rest_positions
    heights = rest_positions @ subject.up_vector
    lowest = float(heights.min())
    parents, hips = rig.parents, hips_of(subject)
    min_clearance = np.zeros(len(feet))
    max_clearance = np.zeros(len(feet))
    are_hanging = True
    foot_joints = set(find_feet(rig.names).tolist())
    for column, joint in enumerate(feet.tolist()):
        is_toe = int(parents[joint]) in foot_joints
        max_height = MAX_TOE_HEIGHT if is_toe else MAX_ANKLE_HEIGHT
        max_clearance[column] = max_height * rest_size
        leg = _leg_joints(parents.tolist(), foot_joints, hips, joint)
        if _is_hanging(rest_positions, heights, leg):
            min_clearance[column] = heights[joint] - lowest
        else:
            are_hanging = False
    is_resting_at_zero = (
        are_hanging
        and -MIN_SUNK_DEPTH < 2.0 * lowest / rest_size < 2.0 * ZERO_REST_TOLERANCE
    )
    if is_resting_at_zero:
        min_clearance = max_clearance = heights[feet]
    else:
        min_ankle_height = MIN_HEIGHT_FRACTION * max_clearance
        max_clearance = np.maximum(min_clearance, max_clearance)
        min_clearance = np.maximum(min_clearance, min_ankle_height)
    return min_clearance * scale, max_clearance * scale, is_resting_at_zero


def _leg_joints(parents: list[int], feet: set[int], hips: int, foot: int) -> list[int]:
    """Return the joints of the leg of a foot, from ankle to thigh.

    >>> _leg_joints([-1, 0, 1, 2, 3], {3, 4}, 0, 4)
    [3, 2, 1]
    """
    joint = foot
    while parents[joint] in feet:
        joint = parents[joint]
    leg = [joint]
    while parents[joint] not in (-1, hips):
        joint = parents[joint]
        leg.append(joint)
    return leg


def _is_hanging(
    rest_positions: FloatArray, heights: FloatArray, leg: list[int]
) -> bool:
    """Return whether a leg hangs straight down in the rest pose."""
    bone_lengths = np.linalg.norm(np.diff(rest_positions[leg], axis=0), axis=1)
    leg_height = heights[leg[-1]] - heights[leg[0]]
    return bool(leg_height > HANGING_FRACTION * bone_lengths.sum() > 0.0)


def _sunk_foot_fault(subject: MotionSubject, contacts: FootStances) -> Iterator[Fault]:
    """Yield a fault at the foot that is deepest below the ground of its contacts."""
    heights = subject.heights[:, contacts.feet]
    ground, has_ground = _foot_ground(subject, contacts)
    depths = (ground - heights) * has_ground
    is_deep = depths > MIN_SUNK_DEPTH * subject.size
    min_frames = max(2, round(MIN_SUNK_SECONDS / subject.interval))
    sunk_runs = []
    for column in range(len(contacts.feet)):
        for first_frame, end_frame in runs(is_deep[:, column]):
            if end_frame - first_frame >= min_frames:
                max_depth = float(depths[first_frame:end_frame, column].max())
                sunk_runs.append((max_depth, column, first_frame, end_frame - 1))
    if not sunk_runs:
        return
    max_depth, column, first_frame, last_frame = max(sunk_runs)
    joint = int(contacts.feet[column])
    foot_text = "the foot" if contacts.has_same_height[column] else "the other foot"
    message = (
        f"{subject.take.rig.joints[joint].name!r} is up to {max_depth:.3g} m below the "
        f"ground from frame {subject.time_text(first_frame)} to "
        f"{subject.time_text(last_frame)}; the ground, at {ground[column]:.3g} m, is "
        f"taken from the height of {foot_text} in other frames"
    )
    hint = "raise the root there, or hold the foot with IK"
    yield subject.fault("MOT209", joint, first_frame, message, hint)


def _foot_ground(
    subject: MotionSubject, contacts: FootStances
) -> tuple[FloatArray, BoolArray]:
    """Return the ground height of each foot, and a mask of known heights ``(E,)``.

    If one foot is planted at 0 of the up axis, as at rest, and the other one lower, 0
    is the ground of both.
    """
    ground_heights, has_ground = contacts.ground.copy(), contacts.has_same_height.copy()
    if not subject.has_rest or has_ground.all():
        return ground_heights, has_ground
    _, shared_ground, is_resting_at_zero = _clearances(subject, contacts.feet)
    higher_ground = np.maximum(ground_heights, ground_heights[contacts.partners])
    is_split = contacts.is_level & contacts.is_level[contacts.partners] & ~has_ground
    is_split &= np.abs(higher_ground - shared_ground) < PLANTED_HEIGHT * subject.size
    if is_resting_at_zero:
        ground_heights = np.where(is_split, higher_ground, ground_heights)
        has_ground = has_ground | is_split
    return ground_heights, has_ground


def _floating_fault(subject: MotionSubject, contacts: FootStances) -> Iterator[Fault]:
    """Yield a fault if no joint is near the ground for longer than a jump takes."""
    has_floor = np.isfinite(contacts.floor)
    if not has_floor.any():
        return
    ground = float(contacts.floor[has_floor].min())
    clearance = subject.heights[:, contacts.feet[has_floor]] - contacts.floor[has_floor]
    lowest_heights = subject.heights[:, body_joints(subject)].min(axis=1) - ground
    is_airborne = clearance.min(axis=1) > MIN_AIR_HEIGHT * subject.size
    is_airborne &= lowest_heights > MIN_AIR_HEIGHT * subject.size
    is_static = contacts.is_static[:, has_floor]
    # A file without units may contain a person, whatever its numbers.
    body_size = subject.size if subject.has_units else max(subject.size, PERSON_SIZE)
    max_seconds = MAX_JUMP_SECONDS * np.sqrt(body_size / PERSON_SIZE)
    for first, end in runs(is_airborne):
        last_frame, seconds = end - 1, (end - first) * subject.interval
        if seconds <= max_seconds or _is_climbing(
            subject, is_static, clearance, first, last_frame
        ):
            continue
        min_height = float(lowest_heights[first : last_frame + 1].min())
        joint = int(contacts.feet[has_floor][clearance[first].argmin()])
        message = (
            f"no foot is closer than {min_height:.3g} m to the ground from frame "
            f"{subject.time_text(first)} to {subject.time_text(last_frame)}, for "
            f"{seconds:.2g} s; the ground, at {ground:.3g} m, is taken from the height "
            "of the feet in other frames"
        )
        hint = "lower the root there; no jump lasts that long"
        yield subject.fault("MOT209", joint, first, message, hint)
        return


def _is_climbing(
    subject: MotionSubject,
    is_static: BoolArray,
    clearance: FloatArray,
    first: int,
    last: int,
) -> bool:
    """Return whether the feet climb one by one, as on stairs and ladders.

    Their first or last contacts in a run are at several heights; or shortly before or
    after the run, one foot is high and the other on the ground. ``is_static`` and
    ``clearance`` ``(F, E)`` [m].
    """
    size = subject.size
    window = max(1, round(STEP_SECONDS / subject.interval))
    is_high = clearance > MIN_AIR_HEIGHT * size
    is_low = np.abs(clearance) < PLANTED_HEIGHT * size
    is_step = np.asarray(
        (is_static & is_high).any(axis=1) & (is_static & is_low).any(axis=1)
    )
    steps_before, steps_after = (
        is_step[max(first - window, 0) : first],
        is_step[last + 1 :],
    )
    if steps_before.any() or steps_after[:window].any():
        return True
    run_contacts, run_heights = is_static[first : last + 1], clearance[first : last + 1]
    columns = np.flatnonzero(run_contacts.any(axis=0))
    for direction in (slice(None), slice(None, None, -1)):
        first_contacts = np.argmax(run_contacts[direction], axis=0)[columns]
        contact_heights = run_heights[direction][first_contacts, columns]
        if len(columns) and float(np.ptp(contact_heights)) > MIN_STEP_HEIGHT * size:
            return True
    return False
