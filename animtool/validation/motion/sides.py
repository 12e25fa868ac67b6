"""Implausible values, and body sides that are swapped or static."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, counted, listed
from animtool.maths import so3
from animtool.validation.motion.body import carriers, feet_of
from animtool.validation.motion.subject import MotionSubject

# Shorter takes show only a pose, in which a foot may be static [s].
POSE_FRAMES = 2
# A smaller scale is invisible [1].
ZERO = 1e-4
# Weights beyond 1 exaggerate; larger ones are percent, or a fault [1].
LARGEST_WEIGHT, SMALLEST_WEIGHT = 2.0, -1.0
PERCENT = 10.0
# Bones may differ by this factor between bind and rest, for this fraction of them; and
# the bind pose may be this many sizes away [1].
OTHER_LENGTH, MAX_BONES, AWAY = 2.0, 0.5, 1.5
SHORT = 0.02


def motionless(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if nothing moves (MOT201)."""
    motion = subject.take.motion
    if motion.frames < POSE_FRAMES:
        return
    channels = (motion.translations, motion.rotations, motion.scales, motion.weights)
    if any(channel is not None and len(channel.animated) for channel in channels):
        return
    message = f"nothing moves in {motion.frames} frames"
    hint = "export the take again; a pose needs one frame"
    joint = 0 if subject.take.rig.joints else None
    yield subject.fault("MOT201", joint, None, message, hint)


def zero_scale(subject: MotionSubject) -> Iterator[Fault]:
    """Yield joints with zero scale (MOT218)."""
    scales = subject.take.motion.scales
    if scales is None:
        return
    values = scales.dense()
    gone = np.asarray(np.abs(values).min(axis=2) < ZERO)
    joints = np.flatnonzero(gone.any(axis=0))
    if not len(joints):
        return
    names = [subject.take.rig.joints[j].name for j in joints.tolist()]
    frames = np.flatnonzero(gone.any(axis=1))
    message = (
        f"{listed([repr(name) for name in names])} scaled to 0 in "
        f"{counted(len(frames), 'frame')}, first at {subject.at(int(frames[0]))}"
    )
    hint = "everything below it vanishes; hide meshes with their visibility"
    yield subject.fault("MOT218", int(joints[0]), int(frames[0]), message, hint)


def large_weights(subject: MotionSubject) -> Iterator[Fault]:
    """Yield shapes with weights far outside 0 to 1 (MOT219)."""
    weights = subject.take.motion.weights
    if weights is None:
        return
    values = weights.dense()[..., 0]
    far = (values > LARGEST_WEIGHT) | (values < SMALLEST_WEIGHT)
    if not far.any():
        return
    frame, shape = np.unravel_index(int(np.where(far, np.abs(values), 0).argmax()),
                                    values.shape)  # fmt: skip
    names = [subject.take.rig.shapes[s].name for s in np.flatnonzero(far.any(axis=0))]
    name = subject.take.rig.shapes[int(shape)].name
    others = [repr(other) for other in names if other != name]
    message = (
        f"shape {name!r} has weight {values[frame, shape]:.4g} at frame "
        f"{subject.at(int(frame))}"
    )
    message += f"; also {listed(others)}" if others else ""
    percent = float(np.abs(values).max()) > PERCENT
    hint = "weights must be from 0 to 1" + (
        "; these look like percentages" if percent else ""
    )
    yield subject.fault("MOT219", None, int(frame), message, hint)


def bind_far_from_rest(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if bind and rest pose differ in size or position (MOT220)."""
    if subject.bind is None or not subject.has_rest:
        return
    rig, bind, rest = subject.take.rig, subject.bind, subject.rest
    away = float(np.linalg.norm(bind.mean(axis=0) - rest.mean(axis=0)))
    parents = rig.parents
    bones = np.flatnonzero(parents >= 0)
    lengths = np.linalg.norm(rest[bones] - rest[parents[bones]], axis=1)
    kept = lengths > SHORT * subject.size
    bones, lengths = bones[kept], lengths[kept]
    ratios = np.linalg.norm(bind[bones] - bind[parents[bones]], axis=1) / lengths
    other = (ratios > OTHER_LENGTH) | (ratios < 1.0 / OTHER_LENGTH)
    hint = "bind transforms are in world space, in the pose in which the mesh was bound"
    if len(bones) and float(other.mean()) > MAX_BONES:
        worst = int(np.abs(np.log(np.maximum(ratios, 1e-12))).argmax())
        joint = int(bones[worst])
        message = (
            f"{np.count_nonzero(other)} of {len(bones)} bones have a different "
            f"length in the bind pose; that to {rig.joints[joint].name!r} is "
            f"{ratios[worst]:.3g} times its rest length"
        )
        yield subject.fault("MOT220", joint, None, message, hint)
        return
    if away > AWAY * subject.size:
        message = (
            f"the bind pose is {away:.3g} m from the rest pose, of a skeleton that "
            f"spans {subject.size:.3g} m"
        )
        yield subject.fault("MOT220", int(rig.roots[0]), None, message, hint)
        return
    offsets = np.linalg.norm(bind - rest, axis=1)
    joint = int(offsets.argmax())
    if offsets[joint] > AWAY * subject.size:
        message = (
            f"{rig.joints[joint].name!r} is {offsets[joint]:.3g} m from its rest "
            f"position in the bind pose, of a skeleton that spans {subject.size:.3g} "
            "m"
        )
        yield subject.fault("MOT220", joint, None, message, hint)


def no_influence(subject: MotionSubject) -> Iterator[Fault]:
    """Yield the joints that influence no point of a mesh (MOT221)."""
    if subject.influencing is None:
        return
    rig = subject.take.rig
    idle = [name for name in rig.names if name not in subject.influencing]
    if not idle:
        return
    message = (
        f"{counted(len(idle), 'joint')} of {len(rig.joints)} "
        f"{'deforms' if len(idle) == 1 else 'deform'} no mesh: {listed(idle)}"
    )
    hint = "paint weights for them, or exclude them from the export"
    yield subject.fault("MOT221", rig.index(idle[0]), None, message, hint)


# A joint is static if it rotates less in all frames; its opposite is active if it
# rotates more [rad].
STATIC_ANGLE, ALIVE = 1e-6, math.radians(20.0)
# Fewer frames are a pose.
SHORTEST = 0.2
# Fraction of the frames with left on the right, for a swap [1].
MOSTLY = 0.9
# Frames count with the hips above the feet within 26 degrees, if there are enough
# of them [1].
UPRIGHT, KNOWN = 0.9, 0.3
# Toes point forward, and knees bend, by at least this much of the size [1].
MIN_FACING = 0.01
# Swapped joints rotate by this much at least, and all of them together by more [rad].
MIN_EXCHANGE, MIN_TOTAL_EXCHANGE = math.radians(8.0), math.radians(30.0)
# Fewer frames do not show that both sides move before and after.
MIN_STEPS = 5
# Fewer pairs that swap at once are just a pose.
MIN_PAIRS = 2
# When two joints swap, continuing as the other leaves this fraction of the deviation
# from continuing as itself [1].
EXCHANGED = 0.35
# For a single pair the fraction is lower, and the step larger [1], [rad].
SURELY, SURE_EXCHANGE = 0.1, math.radians(20.0)


def _pairs(subject: MotionSubject) -> list[tuple[int, int]]:
    """Return the joints with an opposite side, left first."""
    partners = subject.sides.partners
    return [(left, int(partners[left])) for left in subject.sides.left]


def swapped_sides(subject: MotionSubject) -> Iterator[Fault]:
    """Yield a fault if left and right are swapped, in all or some frames (MOT210)."""
    subject = subject.main
    pairs = _pairs(subject)
    if not pairs:
        return
    of_take = list(_full_take(subject, pairs))
    yield from of_take or _exchanged(subject, pairs)


def _full_take(subject: MotionSubject, pairs: list[tuple[int, int]]) -> Iterator[Fault]:
    """Yield a fault if left joints are on the right of a body facing forward."""
    facing = _facing(subject)
    hips = _hips(subject, pairs)
    if facing is None or hips is None:
        return
    left, right = hips
    positions = subject.positions
    feet = feet_of(subject.take.rig.names)
    trunk = 0.5 * (positions[:, left] + positions[:, right])
    upwards = trunk - positions[:, feet].mean(axis=1)
    across = np.cross(upwards, facing)
    side = np.einsum("fc,fc->f", across, positions[:, left] - positions[:, right])
    known = np.linalg.norm(facing, axis=1) > MIN_FACING * subject.size
    # A crawling or lying body has feet beside its hips that point anywhere.
    known &= upwards @ subject.up > UPRIGHT * np.linalg.norm(upwards, axis=1)
    if np.count_nonzero(known) < max(1.0, KNOWN * len(known)):
        return
    wrong = known & (side < 0.0)
    if np.count_nonzero(wrong) <= MOSTLY * np.count_nonzero(known):
        return
    names = subject.take.rig.names
    message = (
        f"{names[left]!r} is on the right of the body, and {names[right]!r} on the "
        f"left, in {np.count_nonzero(wrong)} of {subject.frames} frames, by the "
        "direction of the feet"
    )
    hint = "the names are swapped, or the motion is mirrored: the pass mirror swaps it"
    yield subject.fault("MOT210", left, int(np.flatnonzero(wrong)[0]), message, hint)


def _facing(subject: MotionSubject) -> FloatArray | None:
    """Return the mean direction of the feet ``(F, 3)`` [m]; None without toes."""
    rig = subject.take.rig
    feet = set(feet_of(rig.names).tolist())
    ends = [i for i in feet if rig.joints[i].parent in feet]
    ends = [i for i in ends if "toe" in rig.names[i].lower()]
    if not ends:
        return None
    toes = np.array(ends)
    bones = subject.positions[:, toes] - subject.positions[:, rig.parents[toes]]
    rises = bones @ subject.up
    level = bones - rises[..., None] * subject.up
    # Toes of a foot that hangs, or is lifted behind, point down.
    lies = np.abs(rises) < np.linalg.norm(level, axis=2)
    return np.asarray(np.where(lies[..., None], level, 0.0).mean(axis=1))


def _hips(
    subject: MotionSubject, pairs: list[tuple[int, int]]
) -> tuple[int, int] | None:
    """Return the pair of joints above the feet that is nearest to the root."""
    rig = subject.take.rig
    feet = set(feet_of(rig.names).tolist())
    partners = dict(pairs)
    for left in sorted(feet):
        chain = []
        joint = left
        while joint >= 0:
            if joint in partners:
                chain.append(joint)
            joint = rig.joints[joint].parent
        # Joints nearest to the root may be at its position.
        for top in reversed(chain):
            bone = subject.rest[top] - subject.rest[partners[top]]
            if np.linalg.norm(bone) > MIN_FACING * subject.size:
                return top, partners[top]
    return None


def _exchanged(subject: MotionSubject, pairs: list[tuple[int, int]]) -> Iterator[Fault]:
    """Yield the step at which joints of two sides swap their motion."""
    rotations = subject.take.motion.rotations
    moves = set(rotations.animated.tolist())
    pairs = [pair for pair in pairs if moves.issuperset(pair)]
    if not pairs or subject.frames < MIN_STEPS:
        return
    left = rotations.gather(np.array([pair[0] for pair in pairs]))
    right = rotations.gather(np.array([pair[1] for pair in pairs]))
    steps = so3.angle_between(left[1:], left[:-1])
    steps = np.minimum(steps, so3.angle_between(right[1:], right[:-1]))
    same_side, across = _offs(left, right)
    same_side_back, across_back = (off[::-1] for off in _offs(left[::-1], right[::-1]))
    across = np.minimum(across, across_back)
    swaps = (same_side > MIN_EXCHANGE) & (across < EXCHANGED * same_side)
    swaps &= (
        _neighbor_moves(steps, same_side, same_side_back) & ~subject.cuts()[:, None]
    )
    far = np.where(swaps, same_side, 0.0).sum(axis=1) > MIN_TOTAL_EXCHANGE
    many = swaps.sum(axis=1) >= min(MIN_PAIRS, len(pairs))
    sure = (same_side > SURE_EXCHANGE) & (across < SURELY * same_side)
    swaps &= (far & many)[:, None] | sure
    steps_swapped = np.flatnonzero(swaps.any(axis=1))
    if not len(steps_swapped):
        return
    step = int(steps_swapped[0])
    names = [
        f"{subject.take.rig.names[pairs[i][0]]!r} and "
        f"{subject.take.rig.names[pairs[i][1]]!r}"
        for i in np.flatnonzero(swaps[step]).tolist()
    ]
    until = (
        f", until frame {subject.at(int(steps_swapped[1]))}"
        if len(steps_swapped) > 1
        else ""
    )
    message = f"{listed(names)} swap at frame {subject.at(step + 1)}{until}"
    hint = "swap their channels there; markers of the two sides were mixed up"
    joint = pairs[int(np.flatnonzero(swaps[step])[0])][0]
    yield subject.fault("MOT210", joint, step, message, hint)


def _offs(left: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far sides are from continuing as themselves, and as each other."""
    same_side = np.minimum(_off(left, left), _off(right, right))
    return same_side, np.maximum(_off(left, right), _off(right, left))


def _off(side: FloatArray, other: FloatArray) -> FloatArray:
    """Return the angle of rotations from the extrapolation of others.

    ``(F, P, 4)`` each, result ``(F - 1, P)`` [rad]. The others stay, or turn on as in
    the step before: the smaller difference counts.
    """
    turned = so3.multiply(other[1:-1], so3.conjugate(other[:-2]))
    predicted = other[:-1].copy()
    predicted[1:] = so3.multiply(turned, other[1:-1])
    off = so3.angle_between(side[1:], predicted)
    return np.minimum(off, so3.angle_between(side[1:], other[:-1]))


def _neighbor_moves(steps: FloatArray, off: FloatArray, back: FloatArray) -> BoolArray:
    """Return where the neighbor steps are continuous motion ``(F - 1, P)``.

    Poses of a library that are held, or take turns, exchange sides by intent. ``off``
    is from what was before each step, and ``back`` from what comes after it.
    """
    rows = np.pad(steps, ((1, 1), (0, 0)))
    moving = np.minimum(rows[:-2], rows[2:]) > STATIC_ANGLE
    rest = np.zeros((1, steps.shape[1]))
    before = np.concatenate([rest, off[:-1]])
    after = np.concatenate([back[1:], rest])
    return np.asarray(moving & (np.maximum(before, after) < EXCHANGED * off))


def dead_side(subject: MotionSubject) -> Iterator[Fault]:
    """Yield joints that never rotate while their opposites do (MOT211)."""
    channel = subject.take.motion.rotations
    roots = {*subject.take.rig.roots, *carriers(subject)}
    # Where the root stays put, parts were keyed one by one, and one arm may wave.
    if (subject.frames - 1) * subject.interval < SHORTEST or roots.isdisjoint(
        [*subject.turning.tolist(), *subject.moving.tolist()]
    ):
        return
    spreads = np.zeros(len(subject.take.rig.joints))
    away = so3.angle_between(channel.values, channel.values[:1])
    # One frame that is off is no motion.
    spreads[channel.animated] = np.maximum(
        np.percentile(away, 90, axis=0) if len(channel.animated) else 0.0,
        np.minimum(away.max(axis=0, initial=0.0), 2.0 * STATIC_ANGLE),
    )
    pairs: list[tuple[int, int]] = []
    for left, right in _pairs(subject):
        for mine, other in ((left, right), (right, left)):
            if spreads[mine] <= STATIC_ANGLE and spreads[other] >= ALIVE:
                pairs.append((mine, other))
    if not pairs:
        return
    names = subject.take.rig.names
    mine, other = pairs[0]
    more = [names[i] for i, _ in pairs[1:]]
    message = (
        f"{names[mine]!r} never rotates, but {names[other]!r} does, by "
        f"{math.degrees(spreads[other]):.0f}°"
    )
    message += f"; nor do {listed(more)}" if more else ""
    hint = "its sensor or its channels were lost"
    yield subject.fault("MOT211", mine, None, message, hint)
