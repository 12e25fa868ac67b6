"""Key reduction of a sampled take within a world-space tolerance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from animtool.clip.reduction.keys import ChannelKind, ReducedChannel, Reduction
from animtool.clip.reduction.points import (
    SHELL,
    Budget,
    attached_points,
    joint_bounds,
    point_errors,
    reach,
    subtree_largest,
)
from animtool.clip.reduction.tolerance import WEIGHT_TOLERANCE
from animtool.clip.reduction.tracks import KeyTrack, ReducedPose, pose_of, tracks_of
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths.fit import FittedKeys, evaluate_keys, fit_keys
from animtool.maths.so3 import IDENTITY
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.limits import BallLimit
from animtool.rig.skeleton import Rig

# Levers are only a first guess: the first rounds scale each channel's tolerance by
# what came of it in the world, the others tighten where that was too much.
CALIBRATING = 3
ROUNDS = 40
# From this round on no key moves, so that each adds keys and the errors go down.
SPLITTING = 8
# Keys of balls keep their limits to within this between samples [rad], measured so many
# times a frame.
LIMIT_SLACK, BETWEEN = 1e-4, 4
# Fraction of frames beyond the tolerance after calibration [1].
QUANTILE = 0.95


def reduce_motion(
    take: Take,
    tolerance: float,
    *,
    shell: float = SHELL,
    joint_tolerances: Mapping[str, float] | None = None,
    weight_tolerance: float = WEIGHT_TOLERANCE,
    base: Take | None = None,
    tracks: Sequence[KeyTrack] | None = None,
    start: Motion | None = None,
) -> Reduction:
    """Return sparse keys of a take whose world error is within a tolerance.

    The error of a joint is the largest distance, at any frame of the take, of its
    origin, of points off it along its three axes and of its bone's tips from where
    they were. So it sees a twist that leaves all origins in place, as the measure
    of ACL does. Inherited scale grows the shell too.

    Each channel is fitted by `animtool.maths.fit.fit_keys` with a tolerance of its
    own. These start from levers, are scaled by what comes of them in the world, and
    where a joint is then off by too much, the channels of its chain that have the
    largest part in it are tightened around that frame. Same take, same bytes.

    Pins and slides keep their limits between frames too, and balls theirs to within
    some hundredths of a degree, or tenths where they turn by over 10 degrees a frame,
    as the shortest arc from frame to frame does; where all that they do is keyed.

    Limits: between frames no error is measured. A tolerance near rounding
    (1e-12 of the rig's size) may not be reached; ``held`` says so. Controls are left
    out, as joints and weights hold what they drive.

    Args:
        take: At least one frame.
        tolerance: Largest error of any joint > 0 [m].
        shell: How far off the joint's origin to measure as well, > 0 [m].
        joint_tolerances: Other tolerances, by the names of joints or patterns of
            them such as ``hand_*`` > 0 [m].
        weight_tolerance: Largest error of a shape's weight > 0 [1].
        base: For a take of additive deltas what they are added to, frame by frame:
            translations are summed, rotations stand behind the base's, scales are
            multiplied. Rest is then no delta. None is a take that stands alone.
        tracks: The channels to key; None is all that is not at rest, each joint as a
            whole.
        start: What joints without a track do in the end; None is what the take does.

    Returns:
        Keys and what they reached; `animtool.clip.reduction.keys.evaluate_reduction`
        gives the motion back where ``tracks`` is None.

    Raises:
        OptionError: Unknown joint or a tolerance not above 0 (CLIP020).
        ValueError: The take has no frame, or the base's joints or frames differ.

    References:
        N. Frechette, Animation Compression Library, 2017: error on a shell around
        each joint, in world space.
    """
    rig, motion = take.rig, take.motion
    _check(take, base, shell)
    if not (np.isfinite(weight_tolerance) and weight_tolerance > 0):
        raise ValueError(f"weight_tolerance must be above 0, not {weight_tolerance}")
    rest = _rest(rig, motion, additive=base is not None)
    bounds = joint_bounds(rig, tolerance, joint_tolerances or {})
    tracks = tracks_of(rig, motion, rest) if tracks is None else tracks
    weights = [t for t in tracks if t.kind is ChannelKind.WEIGHT]
    local = [t for t in tracks if t.kind is not ChannelKind.WEIGHT]

    below = None if base is None else base.motion
    budgets: list[Budget] = []
    reached = _Reached([], np.zeros((motion.frames, 1)), 0.0, 0)
    if rig.joints:
        world = _World(rig, motion, below, shell, bounds)
        if start is not None:
            world.pose = pose_of(rig, start, below)
        budgets = [Budget.of(t, world.first_tolerance(t)) for t in local if t.moves]
        reached = _search(world, budgets)
    shapes = [Budget.of(track, weight_tolerance) for track in weights if track.moves]

    frame, joint = divmod(int(np.argmax(reached.errors)), reached.errors.shape[1])
    return Reduction(
        clock=take.clock,
        rest=rest,
        channels=_channels(rig, local + weights, [*budgets, *shapes]),
        samples=motion.frames * sum(track.moves for track in tracks),
        error=float(reached.errors[frame, joint]),
        joint=rig.joints[joint].name if rig.joints else "",
        frame=frame,
        held=reached.ratio <= 1,
        weight_error=max((float(shape.errors.max()) for shape in shapes), default=0.0),
        rounds=reached.rounds,
    )


@dataclass(frozen=True, slots=True)
class _Reached:
    keys: list[FittedKeys]
    errors: FloatArray
    ratio: float
    rounds: int


class _World:
    """World-space points of a rig: original and from keys."""

    def __init__(
        self,
        rig: Rig,
        motion: Motion,
        base: Motion | None,
        shell: float,
        bounds: FloatArray,
    ) -> None:
        self.rig, self.bounds = rig, bounds
        self.pose: ReducedPose = pose_of(rig, motion, base)
        self.truth = self.pose.world()
        self.reduced_world: WorldTransforms | None = None
        self.points = attached_points(rig, shell)
        self.reach = reach(self.points)
        self.below = _descendants(rig)
        self.pose = self.pose.copy()

    def first_tolerance(self, track: KeyTrack) -> float:
        """Return a channel's initial tolerance by the lever arms of its descendants."""
        below = np.flatnonzero(self.below[track.index])
        frames = np.linspace(0, len(self.truth.positions) - 1, 8).astype(np.int64)
        positions = self.truth.positions[frames]
        arms = np.linalg.norm(
            positions[:, below] - positions[:, track.index, None], axis=-1
        )
        lever = arms.max(axis=0) + self.reach[below]
        if track.kind is ChannelKind.TRANSLATION:
            return float(self.bounds[below].min() / 2)
        tolerance = float((self.bounds[below] / (2 * lever.clip(min=1e-9))).min())
        rotates = track.kind is ChannelKind.ROTATION
        return float(np.degrees(tolerance)) if rotates else tolerance

    def measure(self, budgets: list[Budget]) -> FloatArray:
        """Return the error of every joint ``(F, J)`` [m] with some tracks replaced."""
        for budget in budgets:
            self.pose.set(budget.track, budget.values)
        self.reduced_world = self.pose.world(self.reduced_world)
        return point_errors(self.points, self.truth, self.reduced_world)

    def arms(self, joint: int, frames: IntArray, ends: IntArray) -> FloatArray:
        """Return the distances of points of joints ``ends`` from a joint [m]."""
        positions = self.truth.positions
        offsets = positions[frames, ends] - positions[frames, joint]
        return np.asarray(np.linalg.norm(offsets, axis=-1) + self.reach[ends])


def _search(world: _World, budgets: list[Budget]) -> _Reached:
    """Calibrate and tighten channel tolerances; return the keys."""
    errors = world.measure(budgets)
    rounds = 1
    for _ in range(CALIBRATING if budgets else 0):
        used = subtree_largest(world.rig.parents, errors / world.bounds)
        for budget in budgets:
            typical = float(np.quantile(used[:, budget.track.index], QUANTILE))
            budget.scale(float(np.clip(0.9 / max(typical, 1e-9), 0.25, 4.0)))
        errors = world.measure(budgets)
        rounds += 1
    ratio = float((errors / world.bounds).max())
    while rounds < ROUNDS:
        changed = []
        if ratio > 1:
            changed = _tighten(world, budgets, errors, spread=rounds < SPLITTING)
        for budget in budgets:
            frames = _beyond_limits(budget)
            if len(frames):
                budget.straighten(frames)
                changed.append(budget)
        if not changed:
            break
        errors = world.measure(changed)
        ratio = float((errors / world.bounds).max())
        rounds += 1
    return _Reached([b.keys for b in budgets], errors, ratio, rounds)


def _beyond_limits(budget: Budget) -> IntArray:
    """Return the frames after which a ball's keys exceed its limits between samples.

    Samples beyond the limits are kept, and so are values between them.
    """
    track = budget.track
    if not isinstance(track.limits, BallLimit) or len(track.samples) < 2:
        return np.zeros(0, np.int64)
    at_samples = track.excess(track.samples)
    most = (
        np.repeat(np.maximum(at_samples[:-1], at_samples[1:]), BETWEEN - 1)
        + LIMIT_SLACK
    )
    at = np.arange(1, BETWEEN * (len(at_samples) - 1))
    between = at[at % BETWEEN != 0] / BETWEEN
    beyond = track.excess(evaluate_keys(budget.keys, between)) > most
    first = np.unique(np.floor(between[beyond]).astype(np.int64))
    return np.setdiff1d(first, budget.straight)


def _tighten(
    world: _World, budgets: list[Budget], errors: FloatArray, *, spread: bool
) -> list[Budget]:
    """Tighten the channels that contribute most to each excessive error."""
    frames, ends = np.argwhere(errors > world.bounds).T.astype(np.int64)
    excess = errors[frames, ends] / world.bounds[ends]
    parts = np.zeros((len(budgets), len(frames)))
    for i, budget in enumerate(budgets):
        joint = budget.track.index
        hit = np.flatnonzero(world.below[joint, ends])
        arms = world.arms(joint, frames[hit], ends[hit])
        parts[i, hit] = budget.unit_motion(arms) * budget.errors[frames[hit]]
    located = (parts >= 0.5 * parts.max(axis=0, initial=0.0)) & (parts > 0)
    changed = []
    for i, budget in enumerate(budgets):
        hit = np.flatnonzero(located[i])
        if len(hit):
            at, inverse = np.unique(frames[hit], return_inverse=True)
            worst = np.zeros(len(at))
            np.maximum.at(worst, inverse, excess[hit])
            budget.tighten(at, budget.errors[at] * 0.9 / worst, spread=spread)
            changed.append(budget)
    return changed


def _channels(
    rig: Rig, tracks: list[KeyTrack], budgets: list[Budget]
) -> tuple[ReducedChannel, ...]:
    """Return one channel per track, with one key if static."""
    keys = {(b.track.kind, b.track.index): b.keys for b in budgets}
    return tuple(
        _channel(
            rig,
            track,
            keys[track.kind, track.index]
            if track.moves
            else fit_keys(track.samples, 1.0),
        )
        for track in tracks
    )


def _channel(rig: Rig, track: KeyTrack, keys: FittedKeys) -> ReducedChannel:
    if track.kind is ChannelKind.WEIGHT:
        target, joint = f"weight[{track.index}]", None
    else:
        joint = rig.joints[track.index].name
        target = f"{joint}.{track.kind}"
    return ReducedChannel(
        target, track.kind, track.index, joint, track.order, keys, track.part
    )


def _descendants(rig: Rig) -> BoolArray:
    """Return whether joint k is joint j or its descendant ``(J, J)``, at [j, k]."""
    below = np.eye(len(rig.joints), dtype=np.bool_)
    for joint, parent in enumerate(rig.parents):
        if parent >= 0:
            below[:, joint] |= below[:, parent]
    return below


def _rest(rig: Rig, motion: Motion, *, additive: bool) -> Motion:
    """Return one frame of the values without keys."""
    joints = len(rig.joints)
    constant = Channel.static
    return Motion(
        constant(np.zeros((joints, 3)) if additive else rig.rest_translations),
        constant(np.tile(IDENTITY, (joints, 1)) if additive else rig.rest_rotations),
        None if motion.scales is None else constant(np.ones((joints, 3))),
        None
        if motion.weights is None
        else constant(np.zeros_like(motion.weights.rest)),
    )


def _check(take: Take, base: Take | None, shell: float) -> None:
    if not take.motion.frames:
        raise ValueError("the take has no frame")
    if not (np.isfinite(shell) and shell > 0):
        raise ValueError(f"shell must be above 0 and finite, not {shell}")
    if base is not None and (
        base.rig.names != take.rig.names or base.motion.frames != take.motion.frames
    ):
        raise ValueError("the base has other joints or a different number of frames")
