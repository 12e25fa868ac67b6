"""A take as a clip of sparse keys, which gives it back on a rig."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from animtool._types import FloatArray
from animtool.clip.clip import Clip
from animtool.clip.points import SHELL, carried_points, joint_bounds, point_errors
from animtool.clip.pose import pose_of
from animtool.clip.reduce import reduce_motion
from animtool.clip.reduced_clip import clip_of_reduction
from animtool.clip.reduction import ChannelKind, ReducedChannel, Reduction
from animtool.clip.sample import sample_channels
from animtool.clip.tracks import euler_order, tracks_of
from animtool.maths import euler
from animtool.maths.fit import fit_keys
from animtool.rig.controls import evaluate_controls
from animtool.rig.shapes import combination_order, own_weights
from animtool.rig.skeleton import Rig
from animtool.take import Channel, Motion, Take

__all__ = ["KeyedTake", "keyed_take"]

# Largest error of a shape's weight that anyone sees [1].
WEIGHT_TOLERANCE = 1e-3
# Weights that come of other shapes and of controls differ by less: float32 samples.
SAME_WEIGHT = 1e-6
# Numbers of ten digits may leave a tolerance that was just held [1].
ROUNDING = 1e-6


@dataclass(frozen=True, slots=True)
class KeyedTake:
    """A clip, and how far it is from its take.

    Attributes:
        clip: For the rig.
        reduction: Its keys; the errors are those of the clip sampled on the rig.
    """

    clip: Clip
    reduction: Reduction


def keyed_take(
    take: Take,
    rig: Rig,
    name: str,
    tolerance: float,
    *,
    joint_tolerances: Mapping[str, float] | None = None,
    base: Take | None = None,
) -> KeyedTake:
    """Return a clip that gives a take back on a rig.

    Keys hold joints as a whole. Where a control's default, or a joint that another
    follows, would move one that is at rest in the take, one key holds it there. The
    keys of a shape are what is left of its weight without what controls add and
    without the product of the shapes that it combines.

    Args:
        take: With at least one frame.
        rig: Its rig, as it will be read with the clip.
        name: What the clip is called.
        tolerance: Largest error of any joint > 0 [m].
        joint_tolerances: Other tolerances, by names of joints or patterns > 0 [m].
        base: For an additive take what it is put on.

    Raises:
        OptionError: A joint is unknown or a tolerance not above 0 (CLIP020).
        FormatError: An expression of the rig has no value at rest (CLIP015).
    """
    others = joint_tolerances or {}
    bare = replace(take, motion=replace(take.motion, weights=_own(take, rig)))
    reduction = reduce_motion(
        bare,
        tolerance,
        joint_tolerances=others,
        weight_tolerance=WEIGHT_TOLERANCE / _growth(rig, bare.motion.weights),
        base=base,
    )
    while True:
        clip = clip_of_reduction(reduction, rig, name)
        sampled = sample_channels(clip.channels, rig, take.clock.times)
        strays = _strays(reduction, rig, sampled.motion)
        if not strays:
            break
        reduction = replace(reduction, channels=(*reduction.channels, *strays))
    bounds = joint_bounds(rig, tolerance, others)
    return KeyedTake(clip, _measured(reduction, take, sampled.motion, base, bounds))


def _own(take: Take, rig: Rig) -> Channel | None:
    """Return the weights that keys must give, besides what comes by itself."""
    if not rig.shapes:
        return take.motion.weights
    names = [shape.name for shape in rig.shapes]
    found = take.motion.weights
    values = np.zeros((1, len(names))) if found is None else found.dense()[..., 0]
    total = dict(zip(names, values.T, strict=True))
    own = own_weights(rig.shapes, total)
    driven = evaluate_controls(rig.controls, {}).targets
    for shape in rig.shapes:
        added = driven.get(f"shape/{shape.name}", np.zeros(1))
        left = own[shape.name] - added
        comes = bool(shape.combine) or added.any()
        nothing = comes and (np.abs(left) <= SAME_WEIGHT).all()
        own[shape.name] = np.zeros_like(left) if nothing else left
    if found is None and not any(value.any() for value in own.values()):
        return None
    columns = np.stack([own[shape] for shape in names], axis=-1)[..., None]
    return Channel.from_dense(
        np.broadcast_to(columns, (take.motion.frames, *columns.shape[1:]))
    )


def _growth(rig: Rig, own: Channel | None) -> float:
    """Return how many tolerances a weight from 0 to 1 may be off, 1 at least."""
    if own is None or not rig.shapes:
        return 1.0
    keyed = own.rest[:, 0] != 0
    keyed[own.animated] = True
    parts = {s.name: float(k) for s, k in zip(rig.shapes, keyed, strict=True)}
    for shape in combination_order(rig.shapes):
        parts[shape.name] += sum(parts[name] for name in shape.combine)
    return max(1.0, *parts.values())


def _strays(reduction: Reduction, rig: Rig, found: Motion) -> list[ReducedChannel]:
    """Return keys that hold at rest what no channel holds and something moves."""
    held = {(channel.kind, channel.index) for channel in reduction.channels}
    rest = reduction.rest
    return [
        _at_rest(rig, track.kind, track.index, rest)
        for track in tracks_of(rig, replace(found, scales=None, weights=None), rest)
        if (track.kind, track.index) not in held
    ]


def _at_rest(rig: Rig, kind: ChannelKind, index: int, rest: Motion) -> ReducedChannel:
    turns = kind is ChannelKind.ROTATION
    joint = rig.joints[index]
    values = (rest.rotations if turns else rest.translations).rest[index, None]
    order = euler_order(joint, values) if turns else None
    if order is not None:
        values = euler.from_quaternion(values, order)
    keys = fit_keys(values, 1.0)
    return ReducedChannel(f"{joint.name}.{kind}", kind, index, joint.name, order, keys)


def _measured(
    reduction: Reduction,
    take: Take,
    found: Motion,
    base: Take | None,
    bounds: FloatArray,
) -> Reduction:
    """Return a reduction with the errors of a motion that came of it."""
    below = None if base is None else base.motion
    truth, made = (
        pose_of(take.rig, motion, below).world() for motion in (take.motion, found)
    )
    errors = point_errors(carried_points(take.rig, SHELL), truth, made)
    frame, joint = divmod(int(np.argmax(errors)), len(bounds))
    return replace(
        reduction,
        error=float(errors[frame, joint]),
        joint=take.rig.joints[joint].name,
        frame=frame,
        held=bool((errors / bounds).max() <= 1 + ROUNDING),
        weight_error=_weight_error(take.motion.weights, found.weights),
    )


def _weight_error(wanted: Channel | None, found: Channel | None) -> float:
    zero = np.zeros(1)
    dense = [zero if c is None else c.dense() for c in (wanted, found)]
    return float(np.abs(dense[0] - dense[1]).max(initial=0.0))
