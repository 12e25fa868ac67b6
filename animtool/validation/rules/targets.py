"""Rules on targets: requested goals, and whether effectors can reach them.

A targets file names no rig. These look at the scenes that name both.
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

# Of many goals that ask the same, the first pairs say all.
MAX_PAIRS = 1000


@dataclass(frozen=True, eq=False)
class TargetsSubject(DocumentSubject):
    """A targets file and its rig."""

    targets: TargetTracks  # what it makes, of a rig that is not known

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
    first, last = subject.targets.first, subject.targets.last
    if first is None or last is None:
        return
    low, high = float(first), float(last)
    for i, goal in enumerate(subject.targets.goals):
        for key, times, keyed in _outside(goal, low, high):
            message = f"{key} of {goal.name!r} from {times[0]:g} to {times[-1]:g} is "
            message += "never met"
            if keyed:
                message = f"keys of the {key} of {goal.name!r} are never used: "
                message += listed([f"{t:g}" for t in times])
            yield subject.outside(i, (key,), message, low, high)


def _outside(
    goal: GoalTrack, first: float, last: float
) -> Iterator[tuple[str, Sequence[float], bool]]:
    """Yield keys or spans of a goal outside a frame range."""
    for part, value in goal.values.items():
        if isinstance(value, Keyed):
            outside = keys_beyond(value.channel, first, last)
            if len(outside):
                yield part, value.channel.times[outside].tolist(), True
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
    pairs = [pair for group in by_effector.values() for pair in combinations(group, 2)]
    for first, i in sorted(pairs)[:MAX_PAIRS]:
        one, two = goals[first], goals[i]
        kinds = [kind for kind in one.goal.kinds if kind in two.goal.kinds]
        parts = [kind.name for kind in kinds]
        if not parts or not _overlap(one.during, two.during):
            continue
        if all(_equal(one.values, two.values, part) for part in parts):
            message = f"targets the {listed(parts)} of {two.name!r} a second time"
            hint = "remove one of them; weight sets how much it counts"
        else:
            message = (
                f"targets another {listed(parts)} of {two.name!r} than the goal on "
            )
            message += f"line {one.location[0]}: both are missed"
            hint = "remove one, give it another priority, or other frames: during"
        yield subject.fault("TGT202", ("goals", i, "effector"), message, hint)


def _overlap(one: Sequence[Span], two: Sequence[Span]) -> bool:
    """Return whether spans have common frames; no spans are all frames."""
    if not one or not two:
        return True
    return any(a <= d and c <= b for a, b in one for c, d in two)


def _equal(
    one: Mapping[str, Value | None], two: Mapping[str, Value | None], part: str
) -> bool:
    match one[part], two[part]:
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
                at = ("goals", i, "weight", part)
                yield subject.fault("TGT203", at, message, hint)


def idle_holds(subject: TargetsSubject) -> Iterator[Fault]:
    """Yield hold spans without an active goal (TGT204)."""
    for i, goal in enumerate(subject.targets.goals):
        for span in goal.spans:
            if not _overlap([span], goal.during):
                first, last = span
                message = f"{goal.name!r} is held from {first:g} to {last:g}, when it "
                message += "is not active"
                hint = "hold applies only inside the spans of during"
                yield subject.fault("TGT204", ("goals", i, "hold"), message, hint)


# Of a chain's reach, beyond rounding and what limits of a tolerance leave [1].
SLACK = 1e-3
# Points farther from the root joint than so many sizes of the rig, all of them, are in
# another unit, in which they would be nearer than LIKELY sizes [1].
FAR, LIKELY = 8.0, 2.0


@dataclass(frozen=True, slots=True)
class _Asked:
    """Targets of a scene, sampled over the frames of its take."""

    document: Document  # their file
    take: Take  # F frames
    tracks: TargetTracks  # E goals
    world: WorldTransforms  # where the joints are without them
    targets: Targets  # where the goals are

    def points(self, e: int) -> tuple[FloatArray, BoolArray]:
        """Return a goal's target points ``(F, 3)``, and its active frames."""
        weights = np.asarray(self.targets.weights)[:, e, 0]
        asked = (weights > 0) & (self.tracks.goals[e].goal.position > 0)
        return np.asarray(self.targets.positions)[:, e], np.asarray(asked)

    @property
    def unit(self) -> float:
        """Length unit of the file [m]."""
        unit = self.document.value.get("units", {}).get("length")
        return LengthUnit(unit).meters if unit else self.take.rig.meters_per_unit

    def fault(self, code: str, e: int, key: str, message: str, hint: str) -> Fault:
        """Return a fault of a goal, in the targets file."""
        return self.document.fault(code, ("goals", e, key), message, hint)


@lru_cache(maxsize=1)
def _all_asked(subject: SceneSubject) -> tuple[_Asked, ...]:
    goals = []
    for take, tracks in subject.asked:
        world = take.world()
        targets = tracks.sample(take.rig, take.clock, world)
        document = read_document(tracks.path)
        goals.append(_Asked(document, take, tracks, world, targets))
    return tuple(goals)


def out_of_reach(subject: SceneSubject) -> Iterator[Fault]:
    """Yield goals beyond the reach of the fully extended chain (TGT205)."""
    for asked in _all_asked(subject):
        rig, times = asked.take.rig, asked.take.clock.times
        moving = _moving(rig, asked.tracks.goals)
        for e, track in enumerate(asked.tracks.goals):
            points, when = asked.points(e)
            chain = _chain(rig, track.goal, moving)
            if chain is None or not when.any():
                continue
            base, reach = _reach(rig, asked.world, track.goal, chain)
            far = np.linalg.norm(points - base, axis=1)
            over = np.where(when, far - reach * (1.0 + SLACK), 0.0)
            frames = np.flatnonzero(over > 0)
            if not len(frames):
                continue
            worst = int(np.argmax(far - reach + np.where(when, 0.0, -np.inf)))
            message = (
                f"{track.name!r} is {far[worst] - reach[worst]:.3g} m out of reach at "
                f"frame {times[worst]:g}: {rig.joints[chain[0]].name!r} is "
                f"{far[worst]:.3g} m away, and the chain is {reach[worst]:.3g} m long"
            )
            if len(frames) > 1:
                message += f"; also in {len(frames)} frames in total"
            hint = "move it closer, or let joints above move: root, or goals for them"
            fault = asked.fault("TGT205", e, "position", message, hint)
            yield replace(fault, frame=float(times[worst]))


def _moving(rig: Rig, goals: Sequence[GoalTrack]) -> frozenset[int]:
    """Return the joints that some goal may move."""
    moving: set[int] = set()
    for track in goals:
        j = rig.index(track.goal.joint)
        root = -1 if track.goal.root is None else rig.index(track.goal.root)
        while j >= 0:
            moving.add(j)
            j = -1 if j == root else rig.joints[j].parent
    return frozenset(j for j in moving if rig.joints[j].type is not JointType.FIXED)


def _chain(rig: Rig, goal: Goal, moving: frozenset[int]) -> list[int] | None:
    """Return the joints from the topmost moving one to the effector.

    None where its length has no bound, or nothing moves.
    """
    path = [rig.index(goal.joint)]
    while rig.joints[path[-1]].parent >= 0:
        path.append(rig.joints[path[-1]].parent)
    tops = [k for k, j in enumerate(path) if j in moving]
    if not tops or goal.stretch:
        return None
    chain = path[tops[-1] :: -1]
    if any(j in moving and _slides_freely(rig.joints[j]) for j in chain):
        return None
    return chain


def _slides_freely(joint: Joint) -> bool:
    free = joint.type is JointType.PRISMATIC and not isinstance(
        joint.limits, RangeLimit
    )
    return free or joint.type is JointType.FREE


def _reach(
    rig: Rig, world: WorldTransforms, goal: Goal, chain: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """Return a chain's root positions ``(F, 3)``, and its maximum length ``(F,)``.

    Straight, with every slide at its end: what limits of joints leave is less.
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
    for asked in _all_asked(subject):
        size = rest_size(asked.take.rig)
        stated = asked.unit
        # Those whose points are numbers of the file, not a prim's.
        positions = [
            e
            for e, track in enumerate(asked.tracks.goals)
            if isinstance(track.values["position"], Constant | Keyed | ArrayRows)
        ]
        points = [asked.points(e)[0][asked.points(e)[1]] for e in positions]
        cloud = np.concatenate(points) if points else np.zeros((0, 3))
        if not len(cloud):
            continue
        root = asked.world.positions[0, asked.take.rig.roots[0]]
        if np.linalg.norm(cloud - root, axis=1).min() <= FAR * size:
            continue
        fitting = [
            unit
            for unit in LengthUnit
            if np.linalg.norm(cloud * (unit.meters / stated) - root, axis=1).max()
            <= LIKELY * size
        ]
        if fitting:
            message = (
                f"the points are in {unit_name(stated)}, and all are farther from the "
                f"rig than {FAR:g} times its size"
            )
            hint = f"units: {{length: {fitting[0]}}} is more plausible"
            yield asked.fault("TGT206", positions[0], "position", message, hint)


def beyond_take(subject: SceneSubject) -> Iterator[Fault]:
    """Yield targets in frames outside the take (TGT207)."""
    for asked in _all_asked(subject):
        times = asked.take.clock.times
        first, last = float(times[0]), float(times[-1])
        for e, track in enumerate(asked.tracks.goals):
            for key, at, keyed in _outside(track, first, last):
                what = f"from {at[0]:g} to {at[-1]:g} is"
                what = f"has a key at {at[0]:g}, which is used" if keyed else what
                message = f"the {key} of {track.name!r} {what} in no frame of the take,"
                message += f" which has {first:g} to {last:g}"
                hint = "frame numbers of targets are those of the take"
                yield asked.fault("TGT207", e, key, message, hint)
