"""Goals of targets by themselves: whether they ask anything, once, and when."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np

from animtool.errors import Fault, listed
from animtool.ik.tracks import GoalTrack
from animtool.ik.values import Keyed, Rows, Span, Still, Value
from animtool.validation.rules.clip import beyond
from animtool.validation.subjects.targets import TargetsSubject

# Of many goals that ask the same, the first pairs say all.
MAX_PAIRS = 1000


def outside_range(subject: TargetsSubject) -> Iterator[Fault]:
    """Yield keys and spans outside the range of the file (TGT201)."""
    first, last = subject.targets.first, subject.targets.last
    if first is None or last is None:
        return
    low, high = float(first), float(last)
    for i, goal in enumerate(subject.targets.goals):
        for part, value in goal.values.items():
            if isinstance(value, Keyed):
                outside = beyond(value.channel, low, high)
                if len(outside):
                    frames = listed([f"{t:g}" for t in value.channel.times[outside]])
                    message = f"keys of the {part} of {goal.name!r} are never met: "
                    message += f"{frames}"
                    yield subject.outside(i, (part,), message, low, high)
        for key, spans in (("hold", goal.spans), ("during", goal.during)):
            for a, b in spans:
                if b < low or a > high:
                    message = f"{key} of {goal.name!r} from {a:g} to {b:g} is never met"
                    yield subject.outside(i, (key,), message, low, high)


def twice(subject: TargetsSubject) -> Iterator[Fault]:
    """Yield goals that ask the same of an effector as another (TGT202)."""
    goals = subject.targets.goals
    alike: dict[tuple[object, ...], list[int]] = {}
    for i, goal in enumerate(goals):
        alike.setdefault(_effector(goal), []).append(i)
    pairs = [pair for group in alike.values() for pair in combinations(group, 2)]
    for first, i in sorted(pairs)[:MAX_PAIRS]:
        one, two = goals[first], goals[i]
        kinds = [kind for kind in one.goal.kinds if kind in two.goal.kinds]
        parts = [kind.name for kind in kinds]
        if not parts or not _meet(one.during, two.during):
            continue
        if all(_equal(one.values, two.values, part) for part in parts):
            message = f"asks the {listed(parts)} of {two.name!r} a second time"
            hint = "leave one of them out; weight says how much it counts"
        else:
            message = f"asks another {listed(parts)} of {two.name!r} than the goal of "
            message += f"line {one.place[0]}: both are missed"
            hint = "leave one out, give it another priority, or other frames: during"
        yield subject.fault("TGT202", ("goals", i, "effector"), message, hint)


def _effector(goal: GoalTrack) -> tuple[object, ...]:
    return goal.name, goal.goal.offset, goal.goal.root, goal.goal.priority


def _meet(one: Sequence[Span], two: Sequence[Span]) -> bool:
    """Return whether spans have frames in common; none are all frames."""
    if not one or not two:
        return True
    return any(a <= d and c <= b for a, b in one for c, d in two)


def _equal(
    one: Mapping[str, Value | None], two: Mapping[str, Value | None], part: str
) -> bool:
    match one[part], two[part]:
        case Still(value=a), Still(value=b):
            return a == b
        case Keyed(channel=c), Keyed(channel=d):
            return np.array_equal(c.times, d.times) and np.array_equal(
                c.values, d.values
            )
        case Rows(values=e), Rows(values=f):
            return np.array_equal(e, f)
        case a, b:
            return a is None and b is None


def weightless(subject: TargetsSubject) -> Iterator[Fault]:
    """Yield parts of goals whose weight is 0 in all frames (TGT203)."""
    for i, goal in enumerate(subject.targets.goals):
        for part, weight in goal.weights.items():
            match weight:
                case Still(value=(0.0,)):
                    pass
                case Keyed(channel=channel) if not channel.values.any():
                    pass
                case _:
                    continue
            if getattr(goal.goal, part) > 0:
                message = f"the {part} of {goal.name!r} has the weight 0 throughout"
                hint = f"leave the {part} out"
                at = ("goals", i, "weight", part)
                yield subject.fault("TGT203", at, message, hint)


def idle_holds(subject: TargetsSubject) -> Iterator[Fault]:
    """Yield held spans in which nothing is asked (TGT204)."""
    for i, goal in enumerate(subject.targets.goals):
        for span in goal.spans:
            if not _meet([span], goal.during):
                first, last = span
                message = f"{goal.name!r} is held from {first:g} to {last:g}, where it "
                message += "is not asked for"
                hint = "hold counts inside the spans of during alone"
                yield subject.fault("TGT204", ("goals", i, "hold"), message, hint)
