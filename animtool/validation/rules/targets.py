"""Rules on targets: the requested goals, and whether effectors can reach them.

A targets file names no rig. The rules on reach use the scenes that name both.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import combinations

import numpy as np

from animtool.clip.suspicious_times import keys_without_effect
from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, listed
from animtool.core.record import dataclass
from animtool.core.rules import Kind
from animtool.core.units import LengthUnit, unit_name
from animtool.documents.document import Document, Location, read_document
from animtool.ik.file import targets_of_document
from animtool.ik.goals import Goal, Targets
from animtool.ik.tracks import GoalTrack, TargetTracks
from animtool.ik.values import ArrayRows, ConstantValue, KeyedValue, SampledValue, Span
from animtool.motion.take import Take
from animtool.rig.kinematics import WorldTransforms, rest_size
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.validation.subjects.scene import SceneSubject
from animtool.validation.subjects.subject import CheckedFile, DocumentSubject

# Largest number of pairs of equal goals that are reported.
MAX_COMPARED_PAIRS = 1000


@dataclass(frozen=True, eq=False)
class TargetsSubject(DocumentSubject):
    """A targets file that was read without a rig."""

    targets: TargetTracks  # its content, for an unknown rig

    def range_fault(
        self, goal: int, key: Location, message: str, first: float, last: float
    ) -> Fault:
        """Return a fault of keys outside the file's range (TGT201)."""
        message += f"; the range is {first:g} to {last:g}"
        hint = "widen the range, or remove it"
        return self.fault("TGT201", ("goals", goal, *key), message, hint)


def open_targets(document: Document) -> CheckedFile:
    """Read a targets file for the rules; it is checked without a rig."""
    targets = targets_of_document(document, None)
    subject = TargetsSubject(document, targets)
    return CheckedFile(Kind.TARGETS, list(targets.notices), subject)


def keys_outside_range(subject: TargetsSubject) -> Iterator[Fault]:
    """Report keys and spans outside the range of the file (TGT201)."""
    range_first, range_last = subject.targets.first, subject.targets.last
    if range_first is None or range_last is None:
        return
    first_frame, last_frame = float(range_first), float(range_last)
    for i, goal in enumerate(subject.targets.goals):
        for key, times, are_keys in _keys_outside(goal, first_frame, last_frame):
            keys_text = f"{key} of {goal.name!r}"
            message = f"{keys_text} from {times[0]:g} to {times[-1]:g} is never met"
            if are_keys:
                times_text = listed([f"{time:g}" for time in times])
                message = f"keys of the {keys_text} are never used: {times_text}"
            yield subject.range_fault(i, (key,), message, first_frame, last_frame)


def _keys_outside(
    goal: GoalTrack, first: float, last: float
) -> Iterator[tuple[str, Sequence[float], bool]]:
    """Yield key name, times, and whether they are keys, outside a frame range."""
    for goal_kind, value in goal.values.items():
        if isinstance(value, KeyedValue):
            unused_keys = keys_without_effect(value.channel, first, last)
            if len(unused_keys):
                yield goal_kind, value.channel.times[unused_keys].tolist(), True
    for key, spans in (("hold", goal.spans), ("during", goal.during)):
        for span in spans:
            if span[1] < first or span[0] > last:
                yield key, span, False


def duplicate_goals(subject: TargetsSubject) -> Iterator[Fault]:
    """Report goals that constrain an effector in the same way as another (TGT202)."""
    goals = subject.targets.goals
    indices_by_effector: dict[tuple[object, ...], list[int]] = {}
    for i, goal in enumerate(goals):
        effector_key = goal.name, goal.goal.offset, goal.goal.root, goal.goal.priority
        indices_by_effector.setdefault(effector_key, []).append(i)
    pairs = [
        pair
        for group in indices_by_effector.values()
        for pair in combinations(group, 2)
    ]
    for first_index, second_index in sorted(pairs)[:MAX_COMPARED_PAIRS]:
        first, second = goals[first_index], goals[second_index]
        shared_kinds = [
            kind.name for kind in first.goal.kinds if kind in second.goal.kinds
        ]
        if not shared_kinds or not _spans_overlap(first.during, second.during):
            continue
        name, kinds_text = second.name, listed(shared_kinds)
        if all(_equal_values(first.values[k], second.values[k]) for k in shared_kinds):
            message = f"targets the {kinds_text} of {name!r} a second time"
            hint = "remove one of them; weight sets how much it counts"
        else:
            message = (
                f"targets another {kinds_text} of {name!r} than the goal on line "
                f"{first.location[0]}: both are missed"
            )
            hint = "remove one, give it another priority, or other frames: during"
        location = ("goals", second_index, "effector")
        yield subject.fault("TGT202", location, message, hint)


def _spans_overlap(first: Sequence[Span], second: Sequence[Span]) -> bool:
    """Return whether spans have common frames; no spans means all frames."""
    if not first or not second:
        return True
    return any(
        first_start <= second_end and second_start <= first_end
        for first_start, first_end in first
        for second_start, second_end in second
    )


def _equal_values(first: SampledValue | None, second: SampledValue | None) -> bool:
    match first, second:
        case ConstantValue(value=a), ConstantValue(value=b):
            return a == b
        case KeyedValue(channel=c), KeyedValue(channel=d):
            has_equal_times = np.array_equal(c.times, d.times)
            return has_equal_times and np.array_equal(c.values, d.values)
        case ArrayRows(values=e), ArrayRows(values=f):
            return np.array_equal(e, f)
        case _:
            return first is None and second is None


def weightless_parts(subject: TargetsSubject) -> Iterator[Fault]:
    """Report goal parts whose weight is 0 in all frames (TGT203)."""
    for i, goal in enumerate(subject.targets.goals):
        for kind_name, weight in goal.weights.items():
            match weight:
                case ConstantValue(value=(0.0,)):
                    pass
                case KeyedValue(channel=channel) if not channel.values.any():
                    pass
                case _:
                    continue
            if getattr(goal.goal, kind_name) > 0:
                part_text = f"the {kind_name}"
                message = f"{part_text} of {goal.name!r} has the weight 0 throughout"
                location = ("goals", i, "weight", kind_name)
                yield subject.fault("TGT203", location, message, f"remove {part_text}")


def idle_holds(subject: TargetsSubject) -> Iterator[Fault]:
    """Report hold spans without an active goal (TGT204)."""
    for i, goal in enumerate(subject.targets.goals):
        for span in goal.spans:
            if not _spans_overlap([span], goal.during):
                frames = f"from {span[0]:g} to {span[1]:g}"
                message = f"{goal.name!r} is held {frames}, when it is not active"
                hint = "hold applies only inside the spans of during"
                yield subject.fault("TGT204", ("goals", i, "hold"), message, hint)


# Tolerance of a chain's reach, for rounding and for limits with a tolerance [1].
REACH_TOLERANCE = 1e-3
# If all points are farther from the root joint than this many rig sizes, they are in
# another unit if that puts them within the second number [1].
MIN_FAR_SIZES, MAX_LIKELY_SIZES = 8.0, 2.0


@dataclass(frozen=True, slots=True)
class _SampledTargets:
    """Targets of a scene, sampled at the frames of its take."""

    document: Document  # their file
    take: Take  # F frames
    tracks: TargetTracks  # E goals
    world: WorldTransforms  # world transforms of the joints without the goals
    targets: Targets  # sampled targets of the goals

    def points(self, goal_index: int) -> tuple[FloatArray, BoolArray]:
        """Return a goal's target points ``(F, 3)`` [m] and a mask of active frames."""
        weights = np.asarray(self.targets.weights)[:, goal_index, 0]
        is_active = (weights > 0) & (self.tracks.goals[goal_index].goal.position > 0)
        return np.asarray(self.targets.positions)[:, goal_index], np.asarray(is_active)

    @property
    def unit(self) -> float:
        """Length unit of the file [m]."""
        unit = self.document.value.get("units", {}).get("length")
        return LengthUnit(unit).meters if unit else self.take.rig.meters_per_unit

    def fault(
        self, code: str, goal_index: int, key: str, message: str, hint: str
    ) -> Fault:
        """Return a fault of a goal, in the targets file."""
        return self.document.fault(code, ("goals", goal_index, key), message, hint)


@lru_cache(maxsize=1)
def _sampled_targets(subject: SceneSubject) -> tuple[_SampledTargets, ...]:
    goals = []
    for take, tracks in subject.sampled_targets:
        world = take.world()
        targets = tracks.sample(take.rig, take.clock, world)
        document = read_document(tracks.path)
        goals.append(_SampledTargets(document, take, tracks, world, targets))
    return tuple(goals)


def goals_out_of_reach(subject: SceneSubject) -> Iterator[Fault]:
    """Report goals beyond the reach of the fully extended chain (TGT205)."""
    for sampled_targets in _sampled_targets(subject):
        rig, times = sampled_targets.take.rig, sampled_targets.take.clock.times
        goal_joints = _goal_joints(rig, sampled_targets.tracks.goals)
        for goal_index, track in enumerate(sampled_targets.tracks.goals):
            points, is_active = sampled_targets.points(goal_index)
            chain = _chain_joints(rig, track.goal, goal_joints)
            if chain is None or not is_active.any():
                continue
            world = sampled_targets.world
            root_positions, lengths = _chain_reach(rig, world, track.goal, chain)
            distances = np.linalg.norm(points - root_positions, axis=1)
            is_beyond = is_active & (distances > lengths * (1.0 + REACH_TOLERANCE))
            frame_count = int(is_beyond.sum())
            if not frame_count:
                continue
            excess = distances - lengths
            worst_frame = int(np.where(is_active, excess, -np.inf).argmax())
            message = (
                f"{track.name!r} is {excess[worst_frame]:.3g} m out of reach at frame "
                f"{times[worst_frame]:g}: {rig.joints[chain[0]].name!r} is "
                f"{distances[worst_frame]:.3g} m away, and the chain is "
                f"{lengths[worst_frame]:.3g} m long"
            )
            if frame_count > 1:
                message += f"; also in {frame_count} frames in total"
            hint = "move it closer, or let joints above move: root, or goals for them"
            fault = sampled_targets.fault(
                "TGT205", goal_index, "position", message, hint
            )
            yield replace(fault, frame=float(times[worst_frame]))


def _goal_joints(rig: Rig, goals: Sequence[GoalTrack]) -> frozenset[int]:
    """Return the indices of joints, fixed ones excluded, that a goal may move."""
    goal_joints: set[int] = set()
    for track in goals:
        joint = rig.index(track.goal.joint)
        root = -1 if track.goal.root is None else rig.index(track.goal.root)
        while joint >= 0:
            goal_joints.add(joint)
            joint = -1 if joint == root else rig.joints[joint].parent
    return frozenset(
        joint for joint in goal_joints if rig.joints[joint].type is not JointType.FIXED
    )


def _chain_joints(
    rig: Rig, goal: Goal, goal_joints: frozenset[int]
) -> list[int] | None:
    """Return the chain of joints from the topmost movable joint to the effector.

    None if no joint moves or the chain has no maximum length.
    """
    root_path = [rig.index(goal.joint)]
    while rig.joints[root_path[-1]].parent >= 0:
        root_path.append(rig.joints[root_path[-1]].parent)
    moving_indices = [k for k, j in enumerate(root_path) if j in goal_joints]
    if not moving_indices or goal.stretch:
        return None
    chain = root_path[moving_indices[-1] :: -1]
    if any(j in goal_joints and _slides_freely(rig.joints[j]) for j in chain):
        return None
    return chain


def _slides_freely(joint: Joint) -> bool:
    is_unlimited = joint.type is JointType.PRISMATIC and not isinstance(
        joint.limits, RangeLimit
    )
    return is_unlimited or joint.type is JointType.FREE


def _chain_reach(
    rig: Rig, world: WorldTransforms, goal: Goal, chain: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """Return the root positions ``(F, 3)`` and maximum length ``(F,)`` of a chain.

    The chain is straight, with every slide at its end; limits of joints may allow less.
    """
    joint_positions = world.positions[:, list(chain)]
    bone_length = np.linalg.norm(np.diff(joint_positions, axis=1), axis=2).sum(axis=1)
    slide_length = sum(
        limits.high - limits.low
        for j in chain
        if rig.joints[j].type is JointType.PRISMATIC
        and isinstance(limits := rig.joints[j].limits, RangeLimit)
    )
    length = bone_length + slide_length + float(np.linalg.norm(goal.offset))
    return joint_positions[:, 0], length


def mismatched_unit(subject: SceneSubject) -> Iterator[Fault]:
    """Report targets whose points would fit the rig in another length unit (TGT206)."""
    for sampled_targets in _sampled_targets(subject):
        rig, file_unit = sampled_targets.take.rig, sampled_targets.unit
        size = rest_size(rig)
        # Goals whose points are numbers of the file, not a prim's.
        goal_indices = [
            goal_index
            for goal_index, track in enumerate(sampled_targets.tracks.goals)
            if isinstance(
                track.values["position"], ConstantValue | KeyedValue | ArrayRows
            )
        ]
        point_sets = [np.zeros((0, 3))]
        for goal_points, is_active in map(sampled_targets.points, goal_indices):
            point_sets.append(goal_points[is_active])
        all_points = np.concatenate(point_sets)
        if not len(all_points):
            continue
        root = sampled_targets.world.positions[0, rig.roots[0]]
        if np.linalg.norm(all_points - root, axis=1).min() <= MIN_FAR_SIZES * size:
            continue
        fitting_units = []
        for unit in LengthUnit:
            offsets = all_points * (unit.meters / file_unit) - root
            if np.linalg.norm(offsets, axis=1).max() <= MAX_LIKELY_SIZES * size:
                fitting_units.append(unit)
        if fitting_units:
            message = (
                f"the points are in {unit_name(file_unit)}, and all are farther from "
                f"the rig than {MIN_FAR_SIZES:g} times its size"
            )
            hint = f"units: {{length: {fitting_units[0]}}} is more plausible"
            yield sampled_targets.fault(
                "TGT206", goal_indices[0], "position", message, hint
            )


def targets_beyond_take(subject: SceneSubject) -> Iterator[Fault]:
    """Report targets in frames outside the take (TGT207)."""
    for sampled_targets in _sampled_targets(subject):
        times = sampled_targets.take.clock.times
        first_time, last_time = float(times[0]), float(times[-1])
        for goal_index, track in enumerate(sampled_targets.tracks.goals):
            for key, frames, are_keys in _keys_outside(track, first_time, last_time):
                frames_text = f"from {frames[0]:g} to {frames[-1]:g} is"
                if are_keys:
                    frames_text = f"has a key at {frames[0]:g}, which is used"
                message = (
                    f"the {key} of {track.name!r} {frames_text} in no frame of the "
                    f"take, which has {first_time:g} to {last_time:g}"
                )
                hint = "frame numbers of targets are those of the take"
                yield sampled_targets.fault("TGT207", goal_index, key, message, hint)
