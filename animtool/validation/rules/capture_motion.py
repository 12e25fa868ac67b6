"""What a capture does: nothing at all, half of it nothing, leaps, bones that grow."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from animtool._types import BoolArray
from animtool.errors import Fault
from animtool.maths import so3
from animtool.rig.kinematics import rest_size
from animtool.rig.sides import pair_sides
from animtool.take import Take
from animtool.validation.rules.leaps import leaps
from animtool.validation.subjects.capture import TakeSubject

__all__ = [
    "dead_side",
    "flips",
    "jumps",
    "motionless",
    "reference_pose",
    "stretched",
]

# Nearer to half a turn in one frame, no one can tell which way a joint went [rad].
FLIP = math.radians(150.0)
# Fewer joints that leap from the first frame are a jump of theirs.
REFERENCE_JOINTS = 3
# A joint is still that turns and moves less in all frames [rad], [m]; its other side is
# alive that turns more [rad].
STILL, ALIVE = 1e-6, math.radians(20.0)
# Share of its length that a bone may change by, and of the rig's size below which a
# bone has none to speak of [1].
GROWS, SHORT = 0.5, 0.02
# Fewer frames are a pose; fewer do not show what is usual in them.
POSE_FRAMES, FEWEST_FRAMES = 2, 8


def motionless(subject: TakeSubject) -> Iterator[Fault]:
    """Yield that nothing moves in any frame (BVH202)."""
    motion = subject.take.motion
    moving = len(motion.translations.animated) + len(motion.rotations.animated)
    if motion.frames >= POSE_FRAMES and not moving:
        message = f"nothing moves in {motion.frames} frames"
        hint = "export the take again; a pose is one frame"
        yield subject.fault("BVH202", subject.take.rig.names[0], message, hint)


def jumps(subject: TakeSubject) -> Iterator[Fault]:
    """Yield joints that leap in one frame, but do not turn over (BVH203).

    In the first frame many captures have a reference pose (BVH207).
    """
    take = subject.take
    if take.motion.frames < FEWEST_FRAMES:
        return
    for leap in leaps(subject.steps, _first(take)):
        if leap.angle < FLIP:
            name = take.rig.joints[leap.joint].name
            hint = "fill the frames around it in the program that recorded them"
            yield subject.fault("BVH203", name, leap.message(take), hint)


def flips(subject: TakeSubject) -> Iterator[Fault]:
    """Yield joints that turn over from one frame to the next (BVH204)."""
    take = subject.take
    if take.motion.frames < FEWEST_FRAMES:
        return
    turns = subject.steps.turns
    over = (turns >= FLIP) & ~_first(take)[:, None]
    times = take.clock.times
    for j in np.flatnonzero(over.any(axis=0)).tolist():
        frame = int(over[:, j].argmax())
        name = take.rig.joints[j].name
        often = int(np.count_nonzero(over[:, j]))
        more = f", and {often - 1} times more" if often > 1 else ""
        message = (
            f"{name!r} turns over by {math.degrees(turns[frame, j]):.0f}\N{DEGREE SIGN}"
            f" from frame {times[frame]:g} to {times[frame + 1]:g}{more}"
        )
        hint = "the solver that made it took another of two answers there"
        yield subject.fault("BVH204", name, message, hint)


def reference_pose(subject: TakeSubject) -> Iterator[Fault]:
    """Yield that the first frame is a pose of its own (BVH207)."""
    take = subject.take
    if take.motion.frames < FEWEST_FRAMES:
        return
    found = [leap for leap in leaps(subject.steps, ~_first(take)) if leap.frame == 0]
    if len(found) >= REFERENCE_JOINTS:
        first, second = take.clock.times[:2]
        name = take.rig.joints[found[0].joint].name
        message = f"frame {first:g} is a pose of its own: {len(found)} joints leap to "
        message += f"that of frame {second:g}"
        hint = f"the pass trim: {{first: {second:g}}} leaves it out"
        yield subject.fault("BVH207", name, message, hint)


def _first(take: Take) -> BoolArray:
    """Return the first of the steps from frame to frame ``(F - 1,)``."""
    found = np.zeros(take.motion.frames - 1, bool)
    found[:1] = True
    return found


def stretched(subject: TakeSubject) -> Iterator[Fault]:
    """Yield bones whose length changes by over a half (BVH205)."""
    take = subject.take
    channel = take.motion.translations
    size = rest_size(take.rig)
    for a, j in enumerate(channel.animated.tolist()):
        joint = take.rig.joints[j]
        rest = math.hypot(*joint.translation)
        if joint.parent < 0 or rest <= SHORT * size:
            continue
        lengths = np.linalg.norm(channel.values[:, a], axis=1)
        shares = lengths / rest
        worst = int(np.abs(shares - 1.0).argmax())
        if abs(shares[worst] - 1.0) > GROWS:
            message = (
                f"the bone to {joint.name!r} is {lengths[worst]:.3g} m at frame "
                f"{take.clock.times[worst]:g}, and {rest:.3g} m at rest"
            )
            hint = "position channels take the place of OFFSET, and are not added to it"
            yield subject.fault("BVH205", joint.name, message, hint)


def dead_side(subject: TakeSubject) -> Iterator[Fault]:
    """Yield joints that never turn while those of the other side do (BVH206)."""
    take = subject.take
    if take.motion.frames < POSE_FRAMES:
        return
    channel = take.motion.rotations
    spreads = np.zeros(len(take.rig.joints))
    away = so3.angle_between(channel.values, channel.values[:1])
    spreads[channel.animated] = away.max(axis=0)
    partners = pair_sides(take.rig.names, take.rig.parents).partners.tolist()
    for i, (name, other) in enumerate(zip(take.rig.names, partners, strict=True)):
        if spreads[i] > STILL or spreads[other] < ALIVE:
            continue
        message = (
            f"{name!r} never turns, and {take.rig.names[other]!r} does, by "
            f"{math.degrees(spreads[other]):.0f}\N{DEGREE SIGN}"
        )
        hint = "its sensor or its channels were lost"
        yield subject.fault("BVH206", name, message, hint)
