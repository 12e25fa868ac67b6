"""What ``animtool ik`` reports, in lines and in JSON."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, cast

from animtool.cli.convert_summary import channel_lines, channels_json
from animtool.core.errors import counted
from animtool.core.quantities import angle_text, length_text
from animtool.ik.report import BEYOND, limit_counts, status_counts, status_text
from animtool.report.text import Each, Line, render
from animtool.report.values import picked, plain_value

if TYPE_CHECKING:
    from animtool.ik.report import Misses
    from animtool.ik.tracks import GoalTrack
    from animtool.scene.solves.ik import IkReport
    from animtool.scene.solves.ik_match import MatchReport

_LINES: tuple[Line, ...] = (
    "{solved.tracks.path}: [{goals:n goal}|0 goals], {span}",
    "  {solved.problem.joints:n joint moves/joints move}, "
    "{solved.problem.degrees:n degree} of freedom for "
    "{solved.problem.rows:n condition}",
    "  [{ends}]; {iterations:plain} iterations a frame, {restarts:n restart}, "
    "{spent:duration} a frame",
    Each(
        "goals",
        (
            "[{!misses}  {name}: never asked for]",
            Each(
                "misses",
                (
                    "  {name} {part}: {self:size max} off at most (frame "
                    "{frame:frame}), {self:size p95} in 95 %, {self:size mean} in the "
                    "mean of {frames:n frame}",
                ),
            ),
        ),
    ),
    "[  on their limits: {limits:list 8}]",
    "[{?written}  written: {outputs:join}]",
    Each("channels", ("    {self}",)),
    "[{?moved}  frames of goals and joints are those solved, {solved.take.clock.span}; "
    "frame {solved.take.clock.start:frame} is written as {span.first:frame}]",
)
_MATCH: tuple[Line, ...] = (
    "[{tracks.goals:n chain}|0 chains] matched, {clock.span}",
    Each("tracks.goals", ("  {name}: [{self:parts}] of {goal.joint:repr}",)),
    "  written: {outputs:join}",
)


def _size(miss: Misses, name: str) -> str:
    """Return a miss as people read it."""
    value = getattr(miss, name)
    if miss.metric and not math.isfinite(value):
        return f"over {BEYOND:g} m"
    return length_text(value) if miss.metric else angle_text(math.degrees(value))


def _parts(goal: GoalTrack) -> list[str]:
    return [part for part, value in goal.values.items() if value is not None]


_PRINTERS: dict[str, Callable[..., str]] = {
    "size": _size,
    "parts": lambda goal: ", ".join(_parts(goal)),
}


def ik_text(report: IkReport) -> list[str]:
    """Return the lines of a summary."""
    solved, span = report.solved, report.span
    clock, written = solved.take.clock, cast(Any, report.written)
    limits = sorted(limit_counts(solved).items(), key=lambda item: -item[1])
    return render(
        report,
        _LINES,
        _PRINTERS,
        ends=status_text(solved),
        iterations=solved.iterations.mean(),
        restarts=_restarts(report),
        spent=solved.seconds / len(solved.statuses),
        limits=[f"{name} ({counted(count, 'frame')})" for name, count in limits],
        outputs=_outputs(report),
        channels=channel_lines(written) if _is_converted(written) else [],
        moved=written is not None
        and (span.first, span.fps) != (clock.start, clock.fps),
    )


def ik_details(report: IkReport) -> list[str]:
    """Return what is said with -v: which joints move, and where the time went."""
    spent = [f"{stage}: {seconds:.3f} s" for stage, seconds in report.seconds.items()]
    return [f"joints that move: {', '.join(report.solved.problem.joints)}", *spent]


def _restarts(report: IkReport) -> int:
    return int((report.solved.descents - 1).clip(min=0).sum())


def _is_converted(written: Any) -> bool:
    """Return whether what was written is no USD."""
    return written is not None and not hasattr(written, "result")


def _outputs(report: IkReport) -> list[str]:
    written: Any = report.written
    if written is None:
        return []
    if _is_converted(written):
        return [str(written.output)]
    return [str(path) for path in written.result.outputs] or ["stdout"]


def ik_json(report: IkReport) -> dict[str, object]:
    """Return a summary as plain values; lengths in metres, angles in radians."""
    solved, written = report.solved, cast(Any, report.written)
    clock, frames = solved.take.clock, len(solved.statuses)
    return {
        "ik": "animtool/1",
        "targets": str(solved.tracks.path),
        "outputs": _outputs(report),
        "frames": frames,
        **picked(report.span, "first last"),
        "fps": str(report.span.fps),
        "solved": {**picked(clock.span, "first last"), "fps": str(clock.span.fps)},
        **picked(solved.problem, "joints degrees_of_freedom=degrees conditions=rows"),
        "statuses": status_counts(solved),
        "iterations": {
            "mean": float(solved.iterations.mean()),
            "max": int(solved.iterations.max()),
        },
        "restarts": _restarts(report),
        "microseconds_per_frame": 1e6 * solved.seconds / frames,
        "goals": [
            {
                **picked(goal, "effector=name joint"),
                "residuals": {miss.part: _miss_json(miss) for miss in goal.misses},
                "missed": plain_value(goal.spans),
            }
            for goal in report.goals
        ],
        "on_limits": limit_counts(solved),
        "jumps": [
            {
                "frame": float(clock.times[jump.frame]),
                "joint": jump.joint,
                "unit": "m" if jump.slides else "rad",
                **picked(jump, "size source by_goals"),
            }
            for jump in solved.jumps
        ],
        **(channels_json(written) if _is_converted(written) else {}),
        "notices": plain_value(report.notices),
    }


def _miss_json(miss: Misses) -> dict[str, object]:
    unit = "m" if miss.metric else "rad"
    return {"unit": unit, **picked(miss, "frames mean p95 max frame")}


def match_text(report: MatchReport) -> list[str]:
    """Return the lines on what was matched."""
    return render(report, _MATCH, _PRINTERS)


def match_json(report: MatchReport) -> dict[str, object]:
    """Return what was matched, for machines."""
    return {
        "ik": "animtool/1",
        **picked(report, "outputs frames=clock.count first=clock.start"),
        "fps": str(report.clock.fps),
        "matched": [
            {**picked(goal, "chain=name joint=goal.joint"), "parts": _parts(goal)}
            for goal in report.tracks.goals
        ],
        "notices": plain_value(report.notices),
    }
