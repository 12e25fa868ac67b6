"""What ``animtool bake`` says of what was written."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from animtool.cli.console import Console
from animtool.cli.plan_summary import stats_json, stats_text
from animtool.cli.summary import (
    bake_details,
    bake_json,
    bake_text,
    output_json,
    output_text,
)

if TYPE_CHECKING:
    from animtool.scene.convert import ConvertReport
    from animtool.scene.prims import BakeReport
    from animtool.scene.progress import StageCost


def say_bake(
    console: Console,
    report: BakeReport,
    stages: Sequence[StageCost] | None,
    *,
    as_json: bool,
) -> None:
    """Print the summary of a bake."""
    console.faults(report.notices)
    if as_json:
        costs = {} if stages is None else {"stats": stats_json(stages, [report])}
        console.result_json({**bake_json(report), **costs})
        return
    _say(console, bake_text(report))
    for line in bake_details(report):
        console.detail(line)
    if stages is not None:
        _say(console, stats_text(stages, [report]))


def say_outputs(
    console: Console,
    reports: Sequence[BakeReport | ConvertReport],
    stages: Sequence[StageCost] | None,
    *,
    as_json: bool,
) -> None:
    """Print the summary of a scene with several outputs; arguments as `say_bake`."""
    # What the sources and passes say stands in every report.
    notices = [notice for report in reports for notice in report.notices]
    console.faults(dict.fromkeys(notices))
    if as_json:
        written = [output_json(report) for report in reports]
        costs = {} if stages is None else {"stats": stats_json(stages, reports)}
        console.result_json({"bake": "animtool/1", "written": written, **costs})
        return
    for report in reports:
        _say(console, output_text(report))
    if stages is not None:
        _say(console, stats_text(stages, reports))


def _say(console: Console, lines: Iterable[str]) -> None:
    for line in lines:
        console.say(line)
