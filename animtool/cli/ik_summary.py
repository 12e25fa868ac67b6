"""Text report of ``animtool ik``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from animtool.cli.summary import channel_lines
from animtool.core.errors import counted
from animtool.core.quantities import angle_text, length_text
from animtool.ik.report import OVERFLOW_DISTANCE, status_text
from animtool.report.text import SECONDS, Each, Template

if TYPE_CHECKING:
    from animtool.ik.report import MissStatistics


def _miss_text(miss: MissStatistics, statistic: str) -> str:
    """Format a statistic of goal errors as a length or an angle."""
    value = getattr(miss, statistic)
    if miss.is_length and not math.isfinite(value):
        return f"over {OVERFLOW_DISTANCE:g} m"
    return length_text(value) if miss.is_length else angle_text(math.degrees(value))


def _limit_texts(counts: dict[str, int]) -> list[str]:
    most_frequent = sorted(counts.items(), key=lambda item: -item[1])
    return [f"{name} ({counted(count, 'frame')})" for name, count in most_frequent]


SOLVE_TEMPLATE = Template(
    "animtool.scene.solves.ik:IkReport",
    (
        "{solution.tracks.path}: [{goals:n goal}|0 goals], {span}",
        "  {solution.problem.joints:n joint moves/joints move}, "
        "{solution.problem.degrees:n degree} of freedom for "
        "{solution.problem.rows:n condition}",
        "  [{solution:ends}]; {solution.mean_iterations:plain} iterations per frame, "
        "{solution.restarts:n restart}, "
        "{solution.seconds_per_frame:duration} per frame",
        Each(
            "goals",
            (
                "[{!misses}  {name}: never active]",
                Each(
                    "misses",
                    (
                        "  {name} {part}: largest error {self:size max} (frame "
                        "{frame:frame}), 95th percentile {self:size p95}, mean "
                        "{self:size mean} over {frames:n frame}",
                    ),
                ),
            ),
        ),
        "[  at their limits: {solution.limit_counts:limits | list 8}]",
        "[  written: {outputs:join}]",
        Each("channels:channels", ("    {self}",)),
        "[{?is_renumbered}  goals and joints have solved frames "
        "{solution.take.clock.span}; frame {solution.take.clock.start:frame} is "
        "written as {span.first:frame}]",
    ),
    {
        "size": _miss_text,
        "ends": status_text,
        "limits": _limit_texts,
        "channels": channel_lines,
    },
    ("joints that move: {solution.problem.joints:join}", SECONDS),
)
MATCH_TEMPLATE = Template(
    "animtool.scene.solves.ik_match:MatchReport",
    (
        "[{tracks.goals:n chain}|0 chains] matched, {clock.span}",
        Each("tracks.goals", ("  {name}: [{parts:join}] of {goal.joint:repr}",)),
        "  written: {outputs:join}",
    ),
    details=(SECONDS,),
)
