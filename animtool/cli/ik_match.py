"""``animtool ik --match``: its options, and what it says."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from animtool.cli.console import Console
from animtool.cli.options import names_of
from animtool.cli.outputs import skipped
from animtool.errors import counted

if TYPE_CHECKING:
    from animtool.ik.tracks import GoalTrack
    from animtool.scene.ik_match import MatchReport

# Options of the command that a match heeds, beside those of its source.
_HEEDED = frozenset(
    {
        "rig",
        "start",
        "match",
        "chains",
        "pose",
        "output",
        "reduce",
        "overwrite",
        "skip_existing",
        "strict",
        "report_format",
        "units",
        "up",
        "source_fps",
        "source_prim",
        "take",
    }
)


def match_command(console: Console, given: Mapping[str, Any], source: Any) -> None:
    """Write the targets of a take, and say what they are."""
    _check(given)
    as_json = given["report_format"] == "json"
    output = given["output"]
    if skipped(console, "ik", given, output, lambda: [output]):
        return
    from animtool.scene.ik_match import MatchJob, run_match

    pose = given["pose"]
    job = MatchJob(
        rig=given["rig"],
        take=given["start"],
        output=output,
        source=source,
        chains=names_of(given["chains"]),
        pose=pose is not None,
        frame=None if isinstance(pose, str) else pose,
        reduce=given["reduce"],
        overwrite=given["overwrite"],
        strict=given["strict"],
    )
    with console.progress(f"match {given['start'].name}") as progress:
        report = run_match(job, progress=progress)
    console.faults(report.notices)
    if as_json:
        console.result_json(_json(report))
        return
    for line in _text(report):
        console.say(line)
    for stage, seconds in report.seconds.items():
        console.detail(f"{stage}: {seconds:.3f} s")


def _check(given: Mapping[str, Any]) -> None:
    """Refuse what a match lacks, and what it would not heed."""
    for name, what in (("start", "--clip"), ("output", "-o")):
        if given[name] is None:
            raise click.UsageError(f"--match wants {what}.")
    if str(given["output"]) == "-":
        raise click.UsageError("--match writes a targets file, not to stdout.")
    context = click.get_current_context()
    default = click.core.ParameterSource.DEFAULT
    for option in context.command.params:
        name = option.name or ""
        idle = name in given and name not in _HEEDED
        if idle and context.get_parameter_source(name) is not default:
            raise click.UsageError(f"{option.opts[-1]} does nothing for --match.")


def _text(report: MatchReport) -> list[str]:
    chains = counted(len(report.tracks.goals), "chain")
    lines = [f"{chains} matched, {report.clock.span}"]
    lines += [
        f"  {goal.name}: {', '.join(_parts(goal))} of {goal.goal.joint!r}"
        for goal in report.tracks.goals
    ]
    return [*lines, f"  written: {', '.join(map(str, report.outputs))}"]


def _parts(goal: GoalTrack) -> list[str]:
    return [part for part, value in goal.values.items() if value is not None]


def _json(report: MatchReport) -> dict[str, object]:
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
