"""The summary of a bake, in words and in JSON."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from animtool.cli.convert_summary import (
    SCORES,
    SHOT,
    convert_json,
    convert_text,
    scores_json,
    scores_lines,
    shot_json,
)
from animtool.cli.plan_summary import mesh_json, mesh_text
from animtool.core.clock import FrameSpan, frame_label
from animtool.core.errors import counted, listed
from animtool.core.quantities import length_text, plain
from animtool.core.rates import rate_label
from animtool.core.units import unit_name
from animtool.report.text import Each, Line, render
from animtool.report.values import picked, plain_value

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from animtool.scene.bake.files import ConvertReport
    from animtool.scene.bake.prims import BakeReport, TakeReport
    from animtool.usd.takes.splines import CurveReport


# A stage in three files names all; chunks can be thousands.
MAX_FILES = 3


def _files_text(files: Sequence[Path]) -> str:
    """Return the files of an output, or the one to open and the number of the rest."""
    if len(files) <= MAX_FILES:
        return ", ".join(map(str, files)) or "stdout"
    return f"{files[-1]} and {len(files) - 1} more files"


def _extras(indent: str) -> tuple[Line, ...]:
    """Return the lines of what only some bakes do to a take."""
    return (
        scores_lines(indent),
        f"[{indent}{{thinned.samples:n sample}} reduced to {{thinned.kept:len}}: "
        "largest error between them {thinned.error:length}"
        "[{?thinned.error} (joint {thinned_joint:repr}, frame {thinned.code:frame})]]",
        f"[{indent}{{written.curves:n curve of a control/curves of controls}} kept, "
        "{written.curves:knots}: largest difference {written.curves:difference}]",
    )


_LINES: tuple[Line, ...] = (
    "{files}: {form}",
    "  [{frames}|{takes:n take}, {span}]",
    SHOT,
    "[{?posed}  {result.joints:n joint}, {moving} animated]",
    Each("parts", ("{self}",)),
    "  {up} up, lengths in {unit}[{?unstated}; the source taken to be in cm (--units)]",
    "  {result.bytes:size} written in {total:duration}"
    "[{?posed}{?source_bytes}, {speed:size}/s of source]",
    "[{?posed}  largest error of {worst:rounded}[{?beyond} (without values beyond it)]:"
    " {worst:error}[{?many} (take {worst.written.name:repr}, {worst:place})"
    "|{?worst.written.rounding.error} ({worst:place})]]",
    Each("alone", _extras("  ")),
    Each(
        "several",
        (
            "  take {written.name}: {self:frames}",
            "    error of {self:rounded}: {self:error}"
            "[{?written.rounding.error} ({self:place})]",
            *_extras("    "),
        ),
    ),
)
_DETAILS: tuple[Line, ...] = (
    Each(
        "takes",
        (
            "  source: [{details:stated}]",
            "  animation: [{written.animation}]",
            Each("simulated", ("  simulated: [{self:stated}]",)),
        ),
    ),
    "  seconds: [{seconds:seconds}] (read runs beside author)",
    "  skeleton at rest: {size:length 4} across",
)


def bake_text(report: BakeReport) -> list[str]:
    """Return the lines of a summary."""
    takes, total = report.takes, report.seconds["total"]
    one = takes[0] if len(takes) == 1 else None
    posed = one is None or not one.meshes or bool(one.written.animation)
    parts = [_props_text(report), mesh_text(one) if one and one.meshes else []]
    return render(
        report,
        _LINES,
        {**_PRINTERS, "frames": lambda take: _frames_text(report, take)},
        files=_files_text(report.result.outputs),
        frames=None if one is None else _frames_text(report, one),
        posed=posed,
        moving=" and ".join(report.result.sampled) or "nothing",
        parts=[line for part in (parts if posed else parts[::-1]) for line in part],
        unit=unit_name(report.meters_per_unit),
        unstated=any(take.unit_assumed for take in takes),
        total=total,
        speed=report.source_bytes / total,
        beyond=any(notice.code == "BVH104" for notice in report.notices),
        many=one is None and report.worst.written.rounding.error,
        alone=[] if one is None or not posed else takes,
        several=takes if one is None else [],
    )


def _frames_text(report: BakeReport, take: TakeReport) -> str:
    """Return what was written of a take, and of what."""
    written, span = take.written, report.span
    if written.name:
        span = FrameSpan(written.first, written.last, span.fps)
    text = f"{counted(written.samples, 'sample')}, {span}"
    if take.source_fps != span.fps or take.source_frames != written.samples:
        text += f", from {counted(take.source_frames, 'frame')}"
        text += f" at {rate_label(take.source_fps)}"
    if take.between:
        text += f", {take.between} of which fall between frames"
    return text


def _place(take: TakeReport) -> str:
    """Return where rounding moved a take most."""
    frame = frame_label(take.written.rounding.code)
    return f"joint {take.error_joint!r}, frame {frame}"


def _difference(curves: Sequence[CurveReport]) -> str:
    """Return how far curves are off at most, and which."""
    worst = max(curves, key=lambda curve: curve.difference)
    where = f" (control {worst.name!r})" if worst.difference else ""
    return f"{plain(worst.difference, 2)}{where}"


_PRINTERS: dict[str, Callable[..., str]] = {
    **SCORES,
    "rounded": lambda take: (
        "float32 and half scales" if take.written.rounding.scales else "float32"
    ),
    "error": lambda take: length_text(take.written.rounding.error, 2),
    "place": _place,
    "knots": lambda curves: counted(sum(curve.knots for curve in curves), "knot"),
    "difference": _difference,
    "stated": lambda values: ", ".join(f"{key} {own}" for key, own in values.items()),
    "seconds": lambda values: ", ".join(f"{k} {own:.3f}" for k, own in values.items()),
}


def bake_details(report: BakeReport) -> list[str]:
    """Return what only the verbose are told."""
    return render(report, _DETAILS, _PRINTERS)


def _props_text(report: BakeReport) -> list[str]:
    """Return the line of what is written beside the characters, if there is any."""
    paths = [path for take in report.takes for path in take.written.props]
    return [f"  beside: {listed(paths)}"] if paths else []


def bake_json(report: BakeReport) -> dict[str, object]:
    """Return the summary as plain values.

    Of a library ``takes`` says what became of each; what stands beside it is of all.
    """
    takes, span, stopped = report.takes, report.span, report.stopped
    several = [_take_json(report, take) for take in takes] if len(takes) > 1 else []
    return {
        "bake": "animtool/1",
        **({} if several else _take_json(report, takes[0])),
        **picked(report, "outputs=result.outputs form samples=result.samples"),
        **picked(span, "start=first end=last fps"),
        "rate": str(span.fps),
        **picked(report, "joints joints_written=result.joints animated=result.sampled"),
        "meters_per_unit": report.meters_per_unit,
        "units": unit_name(report.meters_per_unit),
        **picked(report, "up bytes=result.bytes"),
        **shot_json(report),
        "seconds": {name: round(value, 6) for name, value in report.seconds.items()},
        "megabytes_per_second": _speed(report),
        "error": _error_json(report, report.worst),
        **({"takes": several} if several else {}),
        "notices": plain_value(report.notices),
        **({} if stopped is None else {"stopped": plain_value(stopped.faults)}),
    }


def _speed(report: BakeReport) -> float | None:
    """Return how fast sources were read [MB/s]; None where none is a file of motion."""
    if not report.source_bytes:
        return None
    return round(report.source_bytes / 1e6 / report.seconds["total"], 3)


def _error_json(report: BakeReport, take: TakeReport) -> dict[str, object]:
    error = take.written.rounding.error
    return {
        **({"take": take.written.name} if take.written.name else {}),
        "meters": plain_value(error),
        "relative": plain_value(error / (report.size or math.inf)),
        **picked(
            take,
            "joint=error_joint frame=written.rounding.code "
            "half_scales=written.rounding.scales",
        ),
    }


def _take_json(report: BakeReport, take: TakeReport) -> dict[str, object]:
    """Return what became of one source."""
    written = take.written
    values: dict[str, object] = {
        **picked(take, "source source_frames"),
        "source_rate": str(take.source_fps),
        **picked(take, "between_frames=between animation=written.animation"),
        **({"props": written.props} if written.props else {}),
    }
    if "fit" in take.details:
        values["fit"] = take.details["fit"]
    if written.name:
        values = {
            "take": written.name,
            **values,
            **picked(
                written,
                "samples start=first end=last joints_written=joints animated=sampled",
            ),
            "error": _error_json(report, take),
        }
    if take.meshes:
        values["meshes"] = mesh_json(take)
    if take.simulated:
        values["simulated"] = take.simulated
    values |= scores_json(take.scores)
    if take.thinned is not None:
        values["reduction"] = {
            "samples": take.thinned.samples,
            "kept": len(take.thinned.kept),
            "error": picked(
                take, "meters=thinned.error joint=thinned_joint frame=thinned.code"
            ),
            "weight_error": take.thinned.weight_error,
        }
    if written.curves:
        names = "control=name knots split difference seam"
        values["curves"] = [picked(curve, names) for curve in written.curves]
    return values


def output_text(report: BakeReport | ConvertReport) -> list[str]:
    """Return the lines of a summary of one of several outputs."""
    from animtool.scene.bake.files import ConvertReport

    return (
        convert_text(report) if isinstance(report, ConvertReport) else bake_text(report)
    )


def output_json(report: BakeReport | ConvertReport) -> dict[str, object]:
    """Return the summary of one of several outputs as plain values."""
    from animtool.scene.bake.files import ConvertReport

    return (
        convert_json(report) if isinstance(report, ConvertReport) else bake_json(report)
    )
