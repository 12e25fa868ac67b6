"""What ``animtool ik`` reports, in words and in JSON."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from animtool.cli.console import finite
from animtool.cli.convert_summary import channel_lines, channels_json
from animtool.core.clock import frame_label
from animtool.core.errors import counted, listed
from animtool.core.quantities import angle_text, duration_text, length_text, plain
from animtool.ik.report import BEYOND, limit_counts, status_counts, status_text

if TYPE_CHECKING:
    from animtool.ik.report import GoalReport, Misses
    from animtool.ik.tracks import GoalTrack
    from animtool.scene.solves.ik import IkReport
    from animtool.scene.solves.ik_match import MatchReport
    from animtool.scene.tables.ik import IkTable, IkTableRow

MAX_NAMED = 8


def _size(miss: Misses, value: float) -> str:
    """Return a miss as people read it."""
    if miss.metric:
        if not math.isfinite(value):
            return f"over {BEYOND:g} m"
        return length_text(value)
    return angle_text(math.degrees(value))


def ik_text(report: IkReport) -> list[str]:
    """Return the lines of a summary."""
    solved = report.solved
    clock, problem = solved.take.clock, solved.problem
    frames = len(solved.statuses)
    ends = status_text(solved)
    restarts = int((solved.descents - 1).clip(min=0).sum())
    lines = [
        f"{solved.tracks.path}: {counted(len(report.goals), 'goal')}, {report.span}",
        f"  {counted(len(problem.joints), 'joint moves', 'joints move')}, "
        f"{counted(problem.degrees, 'degree')} of freedom for "
        f"{counted(problem.rows, 'condition')}",
        f"  {ends}; {plain(solved.iterations.mean())} iterations a frame, "
        f"{counted(restarts, 'restart')}, {duration_text(solved.seconds / frames)} a "
        "frame",
    ]
    for goal in report.goals:
        lines += _goal_text(goal)
    limits = limit_counts(solved)
    if limits:
        most = sorted(limits.items(), key=lambda item: -item[1])
        names = [f"{name} ({counted(count, 'frame')})" for name, count in most]
        lines.append(f"  on their limits: {listed(names, MAX_NAMED)}")
    if report.written is not None:
        lines.append(f"  written: {', '.join(map(str, _outputs(report)))}")
        if not hasattr(report.written, "result"):
            lines += [f"    {line}" for line in channel_lines(report.written)]
        if report.span.first != clock.start or report.span.fps != clock.fps:
            lines.append(
                f"  frames of goals and joints are those solved, {clock.span}; "
                f"frame {frame_label(clock.start)} is written as "
                f"{frame_label(report.span.first)}"
            )
    return lines


def _goal_text(goal: GoalReport) -> list[str]:
    if not goal.misses:
        return [f"  {goal.name}: never asked for"]
    lines = []
    for miss in goal.misses:
        sizes = [_size(miss, value) for value in (miss.mean, miss.p95, miss.max)]
        lines.append(
            f"  {goal.name} {miss.part}: {sizes[2]} off at most "
            f"(frame {frame_label(miss.frame)}), {sizes[1]} in 95 %, "
            f"{sizes[0]} in the mean of {counted(miss.frames, 'frame')}"
        )
    return lines


def ik_details(report: IkReport) -> list[str]:
    """Return what is said with -v: which joints move, and where the time went."""
    spent = [f"{stage}: {seconds:.3f} s" for stage, seconds in report.seconds.items()]
    return [f"joints that move: {', '.join(report.solved.problem.joints)}", *spent]


def _outputs(report: IkReport) -> list[str]:
    written: Any = report.written
    if written is None:
        return []
    if hasattr(written, "result"):
        return [str(path) for path in written.result.outputs] or ["stdout"]
    return [str(written.output)]


def ik_json(report: IkReport) -> dict[str, object]:
    """Return a summary as plain values; lengths in metres, angles in radians."""
    solved = report.solved
    clock, frames = solved.take.clock, len(solved.statuses)
    return {
        "ik": "animtool/1",
        "targets": str(solved.tracks.path),
        "outputs": _outputs(report),
        "frames": frames,
        "first": float(report.span.first),
        "last": float(report.span.last),
        "fps": str(report.span.fps),
        "solved": {
            "first": float(clock.span.first),
            "last": float(clock.span.last),
            "fps": str(clock.span.fps),
        },
        "joints": list(solved.problem.joints),
        "degrees_of_freedom": solved.problem.degrees,
        "conditions": solved.problem.rows,
        "statuses": status_counts(solved),
        "iterations": {
            "mean": float(solved.iterations.mean()),
            "max": int(solved.iterations.max()),
        },
        "restarts": int((solved.descents - 1).clip(min=0).sum()),
        "microseconds_per_frame": 1e6 * solved.seconds / frames,
        "goals": [_goal_json(goal) for goal in report.goals],
        "on_limits": limit_counts(solved),
        "jumps": [
            {
                "frame": float(clock.times[jump.frame]),
                "joint": jump.joint,
                "unit": "m" if jump.slides else "rad",
                "size": jump.size,
                "source": jump.source,
                "by_goals": jump.by_goals,
            }
            for jump in solved.jumps
        ],
        **_written_json(report),
        "notices": [notice.as_dict() for notice in report.notices],
    }


def _written_json(report: IkReport) -> dict[str, object]:
    """Return the channels of a clip that was written, nothing for other outputs."""
    written: Any = report.written
    return (
        {} if written is None or hasattr(written, "result") else channels_json(written)
    )


def _goal_json(goal: GoalReport) -> dict[str, object]:
    spans = [
        {
            **asdict(span),
            "distance": finite(span.distance),
            "angle": finite(span.angle),
            "status": str(span.status),
        }
        for span in goal.spans
    ]
    return {
        "effector": goal.name,
        "joint": goal.joint,
        "residuals": {miss.part: _miss_json(miss) for miss in goal.misses},
        "missed": spans,
    }


def _miss_json(miss: Misses) -> dict[str, object]:
    return {
        "unit": "m" if miss.metric else "rad",
        "frames": miss.frames,
        "mean": finite(miss.mean),
        "p95": finite(miss.p95),
        "max": finite(miss.max),
        "frame": miss.frame,
    }


_HEAD = ("µs/frame", "worst mm", "worst deg", "iterations", "converged")


def ik_table_text(table: IkTable) -> list[str]:
    """Return the lines of a table of time against error."""
    lines = [
        f"{counted(table.frames, 'frame')}, {table.degrees} degrees of freedom; "
        "tolerances in shares of the chain and in radians"
    ]
    for name, rows in (("tolerance", table.tolerances), ("method", table.methods)):
        lines += ["", "".join(f"{head:>12}" for head in (name, *_HEAD))]
        lines += [_row_text(row) for row in rows]
    return lines


def _row_text(row: IkTableRow) -> str:
    if row.refused:
        return f"{row.setting:>12}  cannot: {row.refused}"
    cells = (
        plain(row.microseconds),
        plain(row.position * 1000),
        plain(math.degrees(row.angle)),
        plain(row.iterations),
        f"{row.converged:.1%}",
    )
    return "".join(f"{cell:>12}" for cell in (row.setting, *cells))


def ik_table_json(table: IkTable) -> dict[str, object]:
    """Return a table as plain values; lengths in metres, angles in radians."""
    return {
        "ik_table": "animtool/1",
        "frames": table.frames,
        "degrees_of_freedom": table.degrees,
        "tolerances": [_row_json(row) for row in table.tolerances],
        "methods": [_row_json(row) for row in table.methods],
    }


def _row_json(row: IkTableRow) -> dict[str, object]:
    misses = {"position": finite(row.position), "angle": finite(row.angle)}
    return {**asdict(row), **misses, "method": str(row.method)}


def match_text(report: MatchReport) -> list[str]:
    """Return the lines on what was matched."""
    chains = counted(len(report.tracks.goals), "chain")
    lines = [f"{chains} matched, {report.clock.span}"]
    lines += [
        f"  {goal.name}: {', '.join(_parts(goal))} of {goal.goal.joint!r}"
        for goal in report.tracks.goals
    ]
    return [*lines, f"  written: {', '.join(map(str, report.outputs))}"]


def _parts(goal: GoalTrack) -> list[str]:
    return [part for part, value in goal.values.items() if value is not None]


def match_json(report: MatchReport) -> dict[str, object]:
    """Return what was matched, for machines."""
    clock = report.clock
    return {
        "ik": "animtool/1",
        "outputs": [str(path) for path in report.outputs],
        "frames": clock.count,
        "first": float(clock.start),
        "fps": str(clock.fps),
        "matched": [
            {"chain": goal.name, "joint": goal.goal.joint, "parts": _parts(goal)}
            for goal in report.tracks.goals
        ],
        "notices": [notice.as_dict() for notice in report.notices],
    }
