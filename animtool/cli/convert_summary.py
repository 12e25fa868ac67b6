"""The summary of a conversion, and what passes score, in lines and in JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from animtool.core.errors import counted
from animtool.core.quantities import plain
from animtool.report.text import Each, Line, render
from animtool.report.values import picked, plain_value

if TYPE_CHECKING:
    from animtool.clip.key_report import ChannelError
    from animtool.motion.scores import PassScores
    from animtool.scene.bake.files import ConvertReport
    from animtool.scene.bake.prims import BakeReport

# Errors of channels that are not worth a line, in their units.
ROUNDING = 1e-9
SHOT = "[  {shot.label}]"
# How `scores_lines` prints scores.
SCORES = {
    "scores": lambda scores: ", ".join(f"{one.name} {one.text}" for one in scores)
}


def scores_lines(indent: str) -> Each:
    """Return the lines of the passes of a take: scores, and what they concern."""
    names = Each("names", (indent + "  {key}: [{value:list 8}]",))
    return Each("scores", (indent + "{pass_name}: [{scores:scores}]", names))


_LINES: tuple[Line, ...] = (
    "{output}: {frames:n frame}, {joints:n joint}",
    "  {span}",
    SHOT,
    scores_lines("  "),
    "[{?reduction.samples}  {reduction.samples:n sample} of what moves became "
    "{reduction.keys:n key}: {reduction.samples_per_key:.3g} a key"
    "|{?reduction}  nothing moves: [{?reduction.keys}{reduction.keys:n key}, for what "
    "is not at rest|no keys]]",
    "[  largest error: {reduction.error:length}[{?reduction.error} (joint "
    "{reduction.joint:repr}, frame {frame} of {frames})]]",
    "[{?reduction.weight_error}  largest error of a shape's weight: "
    "{reduction.weight_error:plain}]",
    Each("channels", ("  {self}",)),
)


def convert_text(report: ConvertReport) -> list[str]:
    """Return the lines of a summary of a conversion."""
    frame = None if report.reduction is None else report.reduction.frame + 1
    channels = channel_lines(report)
    return render(report, _LINES, SCORES, frame=frame, channels=channels)


def channel_lines(report: ConvertReport) -> list[str]:
    """Return what the channels of a clip are, and the largest error by their unit."""
    keyed = report.keyed
    if keyed is None or not keyed.errors:
        return []
    groups: dict[str, list[str]] = {}
    for error in keyed.errors:
        group = error.target.partition("/")[0]
        groups.setdefault(group, []).append(error.target)
    nouns = {"control": "control", "joint": "joint channel", "shape": "shape"}
    counts = [counted(len(groups[g]), noun) for g, noun in nouns.items() if g in groups]
    worst: dict[tuple[str, bool], ChannelError] = {}
    for error in keyed.errors:
        key = error.unit, error.target.startswith("control/")
        if key not in worst or error.error > worst[key].error:
            worst[key] = error
    off = [
        f"{' '.join([plain(error.error), error.unit]).strip()} ({error.target})"
        for error in worst.values()
        if error.error > ROUNDING
    ]
    lines = [f"keys on {', '.join(counts)}"]
    return [*lines, f"largest errors of channels: {', '.join(off)}"] if off else lines


def convert_json(report: ConvertReport, command: str = "convert") -> dict[str, object]:
    """Return the summary of a conversion, or of what ends in one, as plain values."""
    values: dict[str, object] = {
        command: "animtool/1",
        **picked(report, "output frames start=span.first end=span.last fps=span.fps"),
        "rate": str(report.span.fps),
        "joints": report.joints,
        **shot_json(report),
        **scores_json(report.scores),
    }
    reduction = report.reduction
    if reduction is not None:
        values["reduction"] = {
            **picked(reduction, "samples keys"),
            "error": picked(reduction, "meters=error joint"),
            **picked(reduction, "weight_error held"),
        }
    return {**values, **channels_json(report), "notices": plain_value(report.notices)}


def shot_json(report: BakeReport | ConvertReport) -> dict[str, object]:
    """Return the shot that was written as plain values, if it is one."""
    return {} if report.shot is None else {"shot": report.shot.as_dict()}


def channels_json(report: ConvertReport) -> dict[str, object]:
    """Return the channels of a clip and their errors, nothing for other outputs."""
    if report.keyed is None:
        return {}
    channels = [
        {**picked(error, "target error unit frame"), "unit": error.unit or None}
        for error in report.keyed.errors
    ]
    return {"channels": channels}


def scores_json(scores: Sequence[PassScores]) -> dict[str, object]:
    """Return how well passes did as plain values, if they say it."""
    return {"scores": [one.as_dict() for one in scores]} if scores else {}
