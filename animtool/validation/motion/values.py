"""Values that no motion needs: none at all, zero scales, weights far beyond 1."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from animtool.errors import Fault, counted, listed
from animtool.validation.motion.subject import MotionSubject

# Fewer frames are a pose.
POSE_FRAMES = 2
# A smaller scale leaves nothing to see [1].
ZERO = 1e-4
# Weights beyond 1 exaggerate; further than this they are percent, or a fault [1].
LARGEST_WEIGHT, SMALLEST_WEIGHT = 2.0, -1.0
PERCENT = 10.0
# Bones may differ by this factor between bind and rest; of this share of them, and
# the bind pose may stand so many sizes away [1].
OTHER_LENGTH, MAX_BONES, AWAY = 2.0, 0.5, 1.5
SHORT = 0.02


def motionless(subject: MotionSubject) -> Iterator[Fault]:
    """Yield that nothing moves in any frame (MOT201)."""
    motion = subject.take.motion
    if motion.frames < POSE_FRAMES:
        return
    channels = (motion.translations, motion.rotations, motion.scales, motion.weights)
    if any(channel is not None and len(channel.animated) for channel in channels):
        return
    message = f"nothing moves in {motion.frames} frames"
    hint = "export the take again; a pose is one frame"
    joint = 0 if subject.take.rig.joints else None
    yield subject.fault("MOT201", joint, None, message, hint)


def zero_scale(subject: MotionSubject) -> Iterator[Fault]:
    """Yield joints that are scaled to nothing (MOT218)."""
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
    hint = "what hangs from it vanishes; hide meshes by their visibility"
    yield subject.fault("MOT218", int(joints[0]), int(frames[0]), message, hint)


def large_weights(subject: MotionSubject) -> Iterator[Fault]:
    """Yield shapes whose weights are far outside of 0 to 1 (MOT219)."""
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
    hint = "weights are from 0 to 1" + ("; these seem to be percent" if percent else "")
    yield subject.fault("MOT219", None, int(frame), message, hint)


def bind_far_from_rest(subject: MotionSubject) -> Iterator[Fault]:
    """Yield that the bind pose is of another size or place than the rest (MOT220)."""
    if subject.bind is None or not subject.has_rest:
        return
    rig, bind, rest = subject.take.rig, subject.bind, subject.rest
    away = float(np.linalg.norm(bind.mean(axis=0) - rest.mean(axis=0)))
    parents = rig.parents
    bones = np.flatnonzero(parents >= 0)
    own = np.linalg.norm(rest[bones] - rest[parents[bones]], axis=1)
    kept = own > SHORT * subject.size
    bones, own = bones[kept], own[kept]
    ratios = np.linalg.norm(bind[bones] - bind[parents[bones]], axis=1) / own
    other = (ratios > OTHER_LENGTH) | (ratios < 1.0 / OTHER_LENGTH)
    hint = (
        "bind transforms are in world space, where the joints stood when it was bound"
    )
    if len(bones) and float(other.mean()) > MAX_BONES:
        worst = int(np.abs(np.log(np.maximum(ratios, 1e-12))).argmax())
        joint = int(bones[worst])
        message = (
            f"{np.count_nonzero(other)} of {len(bones)} bones have another length in "
            f"the bind pose; that to {rig.joints[joint].name!r} is {ratios[worst]:.3g} "
            "times as long as at rest"
        )
        yield subject.fault("MOT220", joint, None, message, hint)
        return
    if away > AWAY * subject.size:
        message = (
            f"the bind pose stands {away:.3g} m from the rest pose, of a skeleton that "
            f"spans {subject.size:.3g} m"
        )
        yield subject.fault("MOT220", int(rig.roots[0]), None, message, hint)
        return
    apart = np.linalg.norm(bind - rest, axis=1)
    joint = int(apart.argmax())
    if apart[joint] > AWAY * subject.size:
        message = (
            f"{rig.joints[joint].name!r} is {apart[joint]:.3g} m from its rest in the "
            f"bind pose, of a skeleton that spans {subject.size:.3g} m"
        )
        yield subject.fault("MOT220", joint, None, message, hint)


def no_influence(subject: MotionSubject) -> Iterator[Fault]:
    """Yield the joints that carry no point of a mesh (MOT221)."""
    if subject.influencing is None:
        return
    rig = subject.take.rig
    idle = [name for name in rig.names if name not in subject.influencing]
    if not idle:
        return
    message = (
        f"{counted(len(idle), 'joint')} of {len(rig.joints)} "
        f"{'moves' if len(idle) == 1 else 'move'} no mesh: {listed(idle)}"
    )
    hint = "paint weights for them, or leave them out of the export"
    yield subject.fault("MOT221", rig.index(idle[0]), None, message, hint)
