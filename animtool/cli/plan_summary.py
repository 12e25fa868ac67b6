"""The steps of a bake and what they cost, in words and in JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from animtool.quantities import plain

if TYPE_CHECKING:
    from animtool.scene.convert import ConvertReport
    from animtool.scene.report import BakeReport
    from animtool.scene.stats import StageCost
    from animtool.scene.steps import Step


def steps_text(steps: Sequence[Step]) -> list[str]:
    """Return the lines of a plan."""
    lines = []
    for number, step in enumerate(steps, 1):
        where = f" ({step.where})" if step.where else ""
        lines.append(f"{number}  {step.kind} {step.name}{where}")
        for word, entries in (
            ("reads", step.reads),
            ("makes", step.makes),
        ):
            if entries and entries != (step.name,):
                lines.append(f"     {word} {', '.join(entries)}")
        lines += [f"     leaves out {entry}" for entry in step.left_out]
    return lines


def steps_json(steps: Sequence[Step]) -> dict[str, object]:
    """Return a plan as plain values."""
    return {
        "plan": "animtool/1",
        "steps": [
            {
                "kind": str(step.kind),
                "name": step.name,
                "where": step.where,
                "reads": list(step.reads),
                "makes": list(step.makes),
                "left_out": list(step.left_out),
            }
            for step in steps
        ],
    }


def stats_text(
    stages: Sequence[StageCost], reports: Sequence[BakeReport | ConvertReport]
) -> list[str]:
    """Return a table of stages and outputs: time, memory, error."""
    rows = [("stage", "seconds", "peak MB", "error mm")]
    for stage in stages:
        name = f"{stage.name} ({stage.where})"
        cells = (
            f"{stage.seconds:.3f}",
            "" if stage.peak is None else f"{stage.peak / 1e6:.1f}",
            _length(stage.error),
        )
        rows.append((name, *cells))
    for report in reports:
        name, seconds, error = _output(report)
        spent = "" if seconds is None else f"{seconds:.3f}"
        rows.append((name, spent, "", _length(error)))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def _length(meters: float | None) -> str:
    return "" if meters is None else plain(meters * 1000)


def stats_json(
    stages: Sequence[StageCost], reports: Sequence[BakeReport | ConvertReport]
) -> list[dict[str, object]]:
    """Return what stages and outputs cost as plain values."""
    found: list[dict[str, object]] = [
        {
            "stage": stage.name,
            "where": stage.where,
            "seconds": round(stage.seconds, 6),
            "peak_bytes": stage.peak,
            "error": stage.error,
        }
        for stage in stages
    ]
    for report in reports:
        name, seconds, error = _output(report)
        found.append({"output": name, "seconds": seconds, "error": error})
    return found


def _output(
    report: BakeReport | ConvertReport,
) -> tuple[str, float | None, float | None]:
    """Return the file, the seconds and the error of an output, as far as known."""
    from animtool.scene.convert import ConvertReport

    if isinstance(report, ConvertReport):
        error = None if report.reduction is None else report.reduction.error
        return str(report.output), None, error
    files = [str(path) for path in report.result.outputs[-1:]] or ["stdout"]
    return files[0], report.seconds["total"], report.worst.written.rounding.error
