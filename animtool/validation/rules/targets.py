"""Rules on targets: requested goals, and whether effectors can reach them.

A targets file names no rig. The rules on reach use the scenes that name both.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import combinations

import numpy as np

from animtool.clip.suspicious_times import keys_beyond
from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, listed
from animtool.core.record import dataclass
from animtool.core.rules import Kind
from animtool.core.units import LengthUnit, unit_name
from animtool.documents.document import Document, Location, read_document
from animtool.ik.file import targets_of_document
from animtool.ik.goals import Goal, Targets
from animtool.ik.tracks import GoalTrack, TargetTracks
from animtool.ik.values import ArrayRows, Constant, Keyed, Span, Value
from animtool.motion.take import Take
from animtool.rig.kinematics import WorldTransforms, rest_size
from animtool.rig.limits import RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.validation.subjects.scene import SceneSubject
from animtool.validation.subjects.subject import CheckedFile, DocumentSubject

# Largest number of pairs of equal goals that are reported.
MAX_PAIRS = 1000


@dataclass(frozen=True, eq=False)
class TargetsSubject(DocumentSubject):
    """A targets file and its rig."""

    targets: TargetTracks  # its content, for an unknown rig

    def outside(
        self, goal: int, key: Location, message: str, first: float, last: float
    ) -> Fault:
        """Return a fault of keys outside the file's range (TGT201)."""
        message += f"; the range is {first:g} to {last:g}"
        hint = "widen the range, or remove it"
        return self.fault("TGT201", ("goals", goal, *key), message, hint)


def open_targets(document: Document) -> CheckedFile:
    """Return the subject of a targets file."""
    targets = targets_of_document(document, None)
    subject = TargetsSubject(document, targets)
    return CheckedFile(Kind.TARGETS, list(targets.notices), subject)


def outside_range(subject: TargetsSubject) -> Iterator[Fault]:
    """Yield keys and spans outside the range of the file (TGT201)."""
    range_first, range_last = subject.targets.first, subject.targets.last
    if range_first is None or range_last is None:
        return
    first_frame, last_frame = float(range_first), float(range_last)
    for i, goal in enumerate(subject.targets.goals):
        for key, times, times_outside in _keys_outside(goal, first_frame, last_frame):
            message = f"{key} of {goal.name!r} from {times[0]:g} to {times[-1]:g} is "
            message += "never met"
            if times_outside:
                message = f"keys of the {key} of {goal.name!r} are never used: "
                message += listed([f"{t:g}" for t in times])
            yield subject.outside(i, (key,), message, first_frame, last_frame)


def _keys_outside(
    goal: GoalTrack, first: float, last: float
) -> Iterator[tuple[str, Sequence[float], bool]]:
    """Yield keys or spans of a goal outside a frame range."""
    for part, value in goal.values.items():
        if isinstance(value, Keyed):
            unused_keys = keys_beyond(value.channel, first, last)
            if len(unused_keys):
                yield part, value.channel.times[unused_keys].tolist(), True
    for key, spans in (("hold", goal.spans), ("during", goal.during)):
        for span in spans:
            if span[1] < first or span[0] > last:
                yield key, span, False


def twice(subject: TargetsSubject) -> Iterator[Fault]:
    """Yield goals that request the same of an effector as another (TGT202)."""
    goals = subject.targets.goals
    by_effector: dict[tuple[object, ...], list[int]] = {}
    for i, goal in enumerate(goals):
        effector = goal.name, goal.goal.offset, goal.goal.root, goal.goal.priority
        by_effector.setdefault(effector, []).append(i)
    equal_candidates = [
        pair for group in by_effector.values() for pair in combinations(group, 2)
    ]
    for earlier, i in sorted(equal_candidates)[:MAX_PAIRS]:
        first_goal, second_goal = goals[earlier], goals[i]
        common_kinds = [
            kind for kind in first_goal.goal.kinds if kind in second_goal.goal.kinds
        ]
        part_names = [kind.name for kind in common_kinds]
        if not part_names or not _overlap(first_goal.during, second_goal.during):
            continue
        if all(
            _equal(first_goal.values, second_goal.values, part) for part in part_names
        ):
            message = (
                f"targets the {listed(part_names)} of {second_goal.name!r} a second "
                "time"
            )
            hint = "remove one of them; weight sets how much it counts"
        else:
            message = (
                f"targets another {listed(part_names)} of {second_goal.name!r} than "
                "the goal on "
            )
            message += f"line {first_goal.location[0]}: both are missed"
            hint = "remove one, give it another priority, or other frames: during"
        yield subject.fault("TGT202", ("goals", i, "effector"), message, hint)


def _overlap(first: Sequence[Span], second: Sequence[Span]) -> bool:
    """Return whether spans have common frames; no spans means all frames."""
    if not first or not second:
        return True
    return any(a <= d and c <= b for a, b in first for c, d in second)


def _equal(
    first: Mapping[str, Value | None], second: Mapping[str, Value | None], part: str
) -> bool:
    match first[part], second[part]:
        case Constant(value=a), Constant(value=b):
            return a == b
        case Keyed(channel=c), Keyed(channel=d):
            return np.array_equal(c.times, d.times) and np.array_equal(
                c.values, d.values
            )
        case ArrayRows(values=e), ArrayRows(values=f):
            return np.array_equal(e, f)
        case a, b:
            return a is None and b is None


def weightless(subject: TargetsSubject) -> Iterator[Fault]:
    """Yield goal parts whose weight is 0 in all frames (TGT203)."""
    for i, goal in enumerate(subject.targets.goals):
        for part, weight in goal.weights.items():
            match weight:
                case Constant(value=(0.0,)):
                    pass
                case Keyed(channel=channel) if not channel.values.any():
                    pass
                case _:
                    continue
            if getattr(goal.goal, part) > 0:
                message = f"the {part} of {goal.name!r} has the weight 0 throughout"
                hint = f"remove the {part}"
                location = ("goals", i, "weight", part)
                yield subject.fault("TGT203", location, message, hint)


def idle_holds(subject: TargetsSubject) -> Iterator[Fault]:
    """Yield hold spans without an active goal (TGT204)."""
    for i, goal in enumerate(subject.targets.goals):
        for span in goal.spans:
            if not _overlap([span], goal.during):
                span_first, span_last = span
                message = (
                    f"{goal.name!r} is held from {span_first:g} to {span_last:g}, when "
                    "it "
                )
                message += "is not active"
                hint = "hold applies only inside the spans of during"
                yield subject.fault("TGT204", ("goals", i, "hold"), message, hint)


# Tolerance of a chain's reach, for rounding and for limits with a tolerance [1].
REACH_TOLERANCE = 1e-3
# If all points are farther from the root joint than this many rig sizes, they are in
# another unit if that puts them within LIKELY sizes [1].
FAR_SIZES, LIKELY_SIZES = 8.0, 2.0


@dataclass(frozen=True, slots=True)
class _SampledTargets:
    """Targets of a scene, sampled over the frames of its take."""

    document: Document  # their file
    take: Take  # F frames
    tracks: TargetTracks  # E goals
    world: WorldTransforms  # world transforms of the joints without the goals
    targets: Targets  # sampled targets of the goals

    def points(self, e: int) -> tuple[FloatArray, BoolArray]:
        """Return a goal's target points ``(F, 3)``, and its active frames."""
        weights = np.asarray(self.targets.weights)[:, e, 0]
        is_active = (weights > 0) & (self.tracks.goals[e].goal.position > 0)
        return np.asarray(self.targets.positions)[:, e], np.asarray(is_active)

    @property
    def unit(self) -> float:
        """Length unit of the file [m]."""
        unit = self.document.value.get("units", {}).get("length")
        return LengthUnit(unit).meters if unit else self.take.rig.meters_per_unit

    def fault(self, code: str, e: int, key: str, message: str, hint: str) -> Fault:
        """Return a fault of a goal, in the targets file."""
        return self.document.fault(code, ("goals", e, key), message, hint)


@lru_cache(maxsize=1)
def _all_sampled(subject: SceneSubject) -> tuple[_SampledTargets, ...]:
    goals = []
    for take, tracks in subject.sampled_targets:
        world = take.world()
        targets = tracks.sample(take.rig, take.clock, world)
        document = read_document(tracks.path)
        goals.append(_SampledTargets(document, take, tracks, world, targets))
    return tuple(goals)


def out_of_reach(subject: SceneSubject) -> Iterator[Fault]:
    """Yield goals beyond the reach of the fully extended chain (TGT205)."""
    for sampled_targets in _all_sampled(subject):
        rig, times = sampled_targets.take.rig, sampled_targets.take.clock.times
        goal_joints = _goal_joints(rig, sampled_targets.tracks.goals)
        for e, track in enumerate(sampled_targets.tracks.goals):
            points, is_active = sampled_targets.points(e)
            chain = _chain(rig, track.goal, goal_joints)
            if chain is None or not is_active.any():
                continue
            base, lengths = _reach(rig, sampled_targets.world, track.goal, chain)
            distances = np.linalg.norm(points - base, axis=1)
            excess = np.where(
                is_active, distances - lengths * (1.0 + REACH_TOLERANCE), 0.0
            )
            frames = np.flatnonzero(excess > 0)
            if not len(frames):
                continue
            worst_frame = int(
                np.argmax(distances - lengths + np.where(is_active, 0.0, -np.inf))
            )
            message = (
                f"{track.name!r} is "
                f"{distances[worst_frame] - lengths[worst_frame]:.3g} m out of reach "
                f"at frame {times[worst_frame]:g}: {rig.joints[chain[0]].name!r} is "
                f"{distances[worst_frame]:.3g} m away, and the chain is "
                f"{lengths[worst_frame]:.3g} m long"
            )
            if len(frames) > 1:
                message += f"; also in {len(frames)} frames in total"
            hint = "move it closer, or let joints above move: root, or goals for them"
            fault = sampled_targets.fault("TGT205", e, "position", message, hint)
            yield replace(fault, frame=float(times[worst_frame]))


def _goal_joints(rig: Rig, goals: Sequence[GoalTrack]) -> frozenset[int]:
    """Return the joints that some goal may move."""
    goal_joints: set[int] = set()
    for track in goals:
        j = rig.index(track.goal.joint)
        root = -1 if track.goal.root is None else rig.index(track.goal.root)
        while j >= 0:
            goal_joints.add(j)
            j = -1 if j == root else rig.joints[j].parent
    return frozenset(
        j for j in goal_joints if rig.joints[j].type is not JointType.FIXED
    )


def _chain(rig: Rig, goal: Goal, goal_joints: frozenset[int]) -> list[int] | None:
    """Return the joints from the topmost moving one to the effector.

    None where its length has no bound, or nothing moves.
    """
    path = [rig.index(goal.joint)]
    while rig.joints[path[-1]].parent >= 0:
        path.append(rig.joints[path[-1]].parent)
    topmost = [k for k, j in enumerate(path) if j in goal_joints]
    if not topmost or goal.stretch:
        return None
    chain = path[topmost[-1] :: -1]
    if any(j in goal_joints and _slides_freely(rig.joints[j]) for j in chain):
        return None
    return chain


def _slides_freely(joint: Joint) -> bool:
    is_unlimited = joint.type is JointType.PRISMATIC and not isinstance(
        joint.limits, RangeLimit
    )
    return is_unlimited or joint.type is JointType.FREE


def _reach(
    rig: Rig, world: WorldTransforms, goal: Goal, chain: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """Return a chain's root positions ``(F, 3)``, and its maximum length ``(F,)``.

    The chain is straight, with every slide at its end; limits of joints may allow less.
    """
    joints = world.positions[:, list(chain)]
    bones = np.linalg.norm(np.diff(joints, axis=1), axis=2).sum(axis=1)
    slides = sum(
        limits.high - limits.low
        for j in chain
        if rig.joints[j].type is JointType.PRISMATIC
        and isinstance(limits := rig.joints[j].limits, RangeLimit)
    )
    return joints[:, 0], bones + slides + float(np.linalg.norm(goal.offset))


def mismatched_unit(subject: SceneSubject) -> Iterator[Fault]:
    """Yield targets whose points fit the rig in another unit (TGT206)."""
    for sampled_targets in _all_sampled(subject):
        size = rest_size(sampled_targets.take.rig)
        file_unit = sampled_targets.unit
        # Goals whose points are numbers of the file, not a prim's.
        positions = [
            e
            for e, track in enumerate(sampled_targets.tracks.goals)
            if isinstance(track.values["position"], Constant | Keyed | ArrayRows)
        ]
        points = [
            sampled_targets.points(e)[0][sampled_targets.points(e)[1]]
            for e in positions
        ]
        cloud = np.concatenate(points) if points else np.zeros((0, 3))
        if not len(cloud):
            continue
        root = sampled_targets.world.positions[0, sampled_targets.take.rig.roots[0]]
        if np.linalg.norm(cloud - root, axis=1).min() <= FAR_SIZES * size:
            continue
        fitting_units = [
            unit
            for unit in LengthUnit
            if np.linalg.norm(cloud * (unit.meters / file_unit) - root, axis=1).max()
            <= LIKELY_SIZES * size
        ]
        if fitting_units:
            message = (
                f"the points are in {unit_name(file_unit)}, and all are farther from "
                f"the rig than {FAR_SIZES:g} times its size"
            )
            hint = f"units: {{length: {fitting_units[0]}}} is more plausible"
            yield sampled_targets.fault(
                "TGT206", positions[0], "position", message, hint
            )


def beyond_take(subject: SceneSubject) -> Iterator[Fault]:
    """Yield targets in frames outside the take (TGT207)."""
    for sampled_targets in _all_sampled(subject):
        times = sampled_targets.take.clock.times
        first_time, last_time = float(times[0]), float(times[-1])
        for e, track in enumerate(sampled_targets.tracks.goals):
            for key, outside_times, are_keys in _keys_outside(
                track, first_time, last_time
            ):
                frames_text = f"from {outside_times[0]:g} to {outside_times[-1]:g} is"
                frames_text = (
                    f"has a key at {outside_times[0]:g}, which is used"
                    if are_keys
                    else frames_text
                )
                message = (
                    f"the {key} of {track.name!r} {frames_text} in no frame of the "
                    "take,"
                )
                message += f" which has {first_time:g} to {last_time:g}"
                hint = "frame numbers of targets are those of the take"
                yield sampled_targets.fault("TGT207", e, key, message, hint)
