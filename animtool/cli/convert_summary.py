"""The summary of a conversion, and what passes score, in words and in JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from animtool.core.errors import counted, listed
from animtool.core.quantities import length_text, plain

if TYPE_CHECKING:
    from animtool.clip.key_report import ChannelError
    from animtool.clip.reduction.keys import Reduction
    from animtool.motion.scores import PassScores
    from animtool.scene.bake.files import ConvertReport
    from animtool.scene.bake.prims import BakeReport

# Errors of channels that are not worth a line, in their units.
ROUNDING = 1e-9
# Of names in a line.
MAX_NAMED = 8


def shot_text(report: BakeReport | ConvertReport) -> list[str]:
    """Return the line of the shot that was written, if it is one."""
    return [] if report.shot is None else [f"  {report.shot.label}"]


def shot_json(report: BakeReport | ConvertReport) -> dict[str, object]:
    """Return the shot that was written as plain values, if it is one."""
    return {} if report.shot is None else {"shot": report.shot.as_dict()}


def convert_text(report: ConvertReport) -> list[str]:
    """Return the lines of a summary of a conversion."""
    frames, joints = counted(report.frames, "frame"), counted(report.joints, "joint")
    lines = [f"{report.output}: {frames}, {joints}", f"  {report.span}"]
    lines += shot_text(report)
    lines += [f"  {line}" for line in scores_text(report.scores)]
    if report.reduction is not None:
        reduction = _reduction_text(report.reduction, report.frames)
        lines += [f"  {line}" for line in reduction]
    return lines + [f"  {line}" for line in channel_lines(report)]


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
    return {
        command: "animtool/1",
        "output": str(report.output),
        "frames": report.frames,
        "start": float(report.span.first),
        "end": float(report.span.last),
        "fps": float(report.span.fps),
        "rate": str(report.span.fps),
        "joints": report.joints,
        **shot_json(report),
        **scores_json(report.scores),
        **_reduction_json(report.reduction),
        **channels_json(report),
        "notices": [notice.as_dict() for notice in report.notices],
    }


def channels_json(report: ConvertReport) -> dict[str, object]:
    """Return the channels of a clip and their errors, nothing for other outputs."""
    if report.keyed is None:
        return {}
    return {
        "channels": [
            {
                "target": error.target,
                "error": error.error,
                "unit": error.unit or None,
                "frame": error.frame,
            }
            for error in report.keyed.errors
        ]
    }


def _reduction_text(reduction: Reduction, frames: int) -> list[str]:
    """Return what a reduction came to, and its error where there is one."""
    keys = counted(reduction.keys, "key")
    if not reduction.samples:
        text = f"{keys}, for what is not at rest" if reduction.keys else "no keys"
        lines = [f"nothing moves: {text}"]
    else:
        lines = [
            f"{counted(reduction.samples, 'sample')} of what moves became {keys}: "
            f"{reduction.samples_per_key:.3g} a key"
        ]
    where = ""
    if reduction.error:
        where = f" (joint {reduction.joint!r}, frame {reduction.frame + 1} of {frames})"
    lines.append(f"largest error: {length_text(reduction.error)}{where}")
    if reduction.weight_error:
        lines.append(
            f"largest error of a shape's weight: {plain(reduction.weight_error)}"
        )
    return lines


def _reduction_json(reduction: Reduction | None) -> dict[str, object]:
    """Return what a reduction came to, nothing where there was none."""
    if reduction is None:
        return {}
    return {
        "reduction": {
            "samples": reduction.samples,
            "keys": reduction.keys,
            "error": {"meters": reduction.error, "joint": reduction.joint},
            "weight_error": reduction.weight_error,
            "held": reduction.held,
        }
    }


def scores_text(scores: Sequence[PassScores]) -> list[str]:
    """Return the lines of the passes of a take."""
    lines = []
    for one in scores:
        shown = ", ".join(f"{score.name} {score.text}" for score in one.scores)
        lines.append(f"{one.pass_name}: {shown}")
        lines += [
            f"  {what}: {listed(list(names), MAX_NAMED)}"
            for what, names in one.names.items()
        ]
    return lines


def scores_json(scores: Sequence[PassScores]) -> dict[str, object]:
    """Return how well passes did as plain values, if they say it."""
    return {"scores": [one.as_dict() for one in scores]} if scores else {}
