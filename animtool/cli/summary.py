"""The summary of a bake, in words and in JSON."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from animtool.cli.console import columns, finite
from animtool.cli.convert_summary import (
    convert_json,
    convert_text,
    scores_json,
    scores_text,
    shot_json,
    shot_text,
)
from animtool.cli.plan_summary import mesh_json, mesh_text
from animtool.core.clock import FrameSpan, frame_label
from animtool.core.errors import counted, listed
from animtool.core.quantities import duration_text, length_text, plain, size_text
from animtool.core.rates import rate_label
from animtool.core.units import unit_name

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from animtool.scene.bake.files import ConvertReport
    from animtool.scene.bake.prims import BakeReport, TakeReport
    from animtool.scene.tables.bake import BakeTable


# A stage in three files names all; chunks can be thousands.
MAX_FILES = 3


def _files_text(files: Sequence[Path]) -> str:
    """Return the files of an output, or the one to open and the number of the rest."""
    if len(files) <= MAX_FILES:
        return ", ".join(map(str, files)) or "stdout"
    return f"{files[-1]} and {len(files) - 1} more files"


def bake_text(report: BakeReport) -> list[str]:
    """Return the lines of a summary."""
    result, total = report.result, report.seconds["total"]
    speed = report.source_bytes / total
    files = _files_text(result.outputs)
    unit = unit_name(report.meters_per_unit)
    unstated = any(take.unit_assumed for take in report.takes)
    assumed = "; the source taken to be in cm (--units)" if unstated else ""
    takes = report.takes
    one = takes[0] if len(takes) == 1 else None
    if one is not None and one.meshes and not one.written.animation:
        return [
            f"{files}: {report.form}",
            f"  {_frames_text(report, one)}",
            *shot_text(report),
            *mesh_text(one),
            *_props_text(report),
            f"  {report.up} up, lengths in {unit}{assumed}",
            f"  {size_text(result.bytes)} written in {duration_text(total)}",
        ]
    moving = " and ".join(result.sampled) or "nothing"
    lines = [f"{files}: {report.form}"]
    if one is not None:
        lines.append(f"  {_frames_text(report, one)}")
        lines += shot_text(report)
    else:
        lines.append(f"  {len(takes)} takes, {report.span}")
    lines += [
        f"  {counted(result.joints, 'joint')}, {moving} animated",
        *_props_text(report),
        *(mesh_text(one) if one and one.meshes else []),
        f"  {report.up} up, lengths in {unit}{assumed}",
        f"  {size_text(result.bytes)} written in {duration_text(total)}"
        + (f", {size_text(speed)}/s of source" if speed else ""),
        f"  largest error of {_rounded_to(report.worst)}{_clamped_text(report)}: "
        + _error_text(report.worst, "" if one else report.worst.written.name),
    ]
    if one is not None:
        return lines + [f"  {line}" for line in _extras_text(one)]
    for take in takes:
        lines.append(f"  take {take.written.name}: {_frames_text(report, take)}")
        error = _error_text(take)
        lines.append(f"    error of {_rounded_to(take)}: {error}")
        lines += [f"    {line}" for line in _extras_text(take)]
    return lines


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


def _rounded_to(take: TakeReport) -> str:
    """Return what the numbers of a take were rounded to."""
    return "float32 and half scales" if take.written.rounding.scales else "float32"


def _clamped_text(report: BakeReport) -> str:
    """Say that errors leave out values beyond float32, if there are any."""
    beyond = any(notice.code == "BVH104" for notice in report.notices)
    return " (without values beyond it)" if beyond else ""


def _error_text(take: TakeReport, name: str = "") -> str:
    """Return the largest error of a take, and where; with its name, if given."""
    rounding = take.written.rounding
    text = length_text(rounding.error, 2)
    if not rounding.error:
        return text
    of = f"take {name!r}, " if name else ""
    return (
        f"{text} ({of}joint {take.error_joint!r}, frame {frame_label(rounding.code)})"
    )


def _extras_text(take: TakeReport) -> list[str]:
    """Return what only some bakes do to a take."""
    lines, thinned = scores_text(take.scores), take.thinned
    curves = take.written.curves
    if thinned is not None:
        where = f" (joint {take.thinned_joint!r}, frame {frame_label(thinned.code)})"
        lines.append(
            f"{counted(thinned.samples, 'sample')} reduced to {len(thinned.kept)}: "
            f"largest error between them {length_text(thinned.error)}"
            + (where if thinned.error else "")
        )
    if curves:
        worst = max(curves, key=lambda curve: curve.difference)
        where = f" (control {worst.name!r})" if worst.difference else ""
        knots = counted(sum(curve.knots for curve in curves), "knot")
        kept = "curve of a control" if len(curves) == 1 else "curves of controls"
        lines.append(
            f"{len(curves)} {kept} kept, {knots}: largest difference "
            f"{plain(worst.difference, 2)}{where}"
        )
    return lines


def bake_details(report: BakeReport) -> list[str]:
    """Return what only the verbose are told."""
    seconds = ", ".join(f"{name} {value:.3f}" for name, value in report.seconds.items())
    lines = []
    for take in report.takes:
        stated = ", ".join(f"{key} {value}" for key, value in take.details.items())
        lines.append(f"  source: {stated}")
        lines.append(f"  animation: {take.written.animation}")
        lines += [
            f"  simulated: {', '.join(f'{key} {value}' for key, value in one.items())}"
            for one in take.simulated
        ]
    return [
        *lines,
        f"  seconds: {seconds} (read runs beside author)",
        f"  skeleton at rest: {length_text(report.size, 4)} across",
    ]


def _props_text(report: BakeReport) -> list[str]:
    """Return the line of what is written beside the characters, if there is any."""
    paths = [path for take in report.takes for path in take.written.props]
    return [f"  beside: {listed(paths)}"] if paths else []


def bake_json(report: BakeReport) -> dict[str, object]:
    """Return the summary as plain values.

    Of a library ``takes`` says what became of each; what stands beside it is of all.
    """
    result, takes = report.result, report.takes
    return {
        "bake": "animtool/1",
        **(_take_json(report, takes[0]) if len(takes) == 1 else {}),
        "outputs": [str(path) for path in result.outputs],
        "form": report.form,
        "samples": result.samples,
        "start": float(report.span.first),
        "end": float(report.span.last),
        "fps": float(report.span.fps),
        "rate": str(report.span.fps),
        "joints": report.joints,
        "joints_written": result.joints,
        "animated": result.sampled,
        "meters_per_unit": report.meters_per_unit,
        "units": unit_name(report.meters_per_unit),
        "up": report.up,
        "bytes": result.bytes,
        **shot_json(report),
        "seconds": {name: round(value, 6) for name, value in report.seconds.items()},
        "megabytes_per_second": _speed(report),
        "error": _error_json(report, report.worst),
        **(
            {"takes": [_take_json(report, take) for take in takes]}
            if len(takes) > 1
            else {}
        ),
        "notices": [notice.as_dict() for notice in report.notices],
        **(
            {"stopped": [fault.as_dict() for fault in report.stopped.faults]}
            if report.stopped is not None
            else {}
        ),
    }


def _speed(report: BakeReport) -> float | None:
    """Return how fast sources were read [MB/s]; None where none is a file of motion."""
    if not report.source_bytes:
        return None
    return round(report.source_bytes / 1e6 / report.seconds["total"], 3)


def _error_json(report: BakeReport, take: TakeReport) -> dict[str, object]:
    rounding = take.written.rounding
    return {
        **({"take": take.written.name} if take.written.name else {}),
        "meters": finite(rounding.error),
        "relative": finite(rounding.error / (report.size or math.inf)),
        "joint": take.error_joint,
        "frame": rounding.code,
        "half_scales": rounding.scales,
    }


def _take_json(report: BakeReport, take: TakeReport) -> dict[str, object]:
    """Return what became of one source."""
    written = take.written
    values: dict[str, object] = {
        "source": str(take.source),
        "source_frames": take.source_frames,
        "source_rate": str(take.source_fps),
        "between_frames": take.between,
        "animation": written.animation,
        **({"props": written.props} if written.props else {}),
    }
    if "fit" in take.details:
        values["fit"] = take.details["fit"]
    if written.name:
        values = {
            "take": written.name,
            **values,
            "samples": written.samples,
            "start": float(written.first),
            "end": float(written.last),
            "joints_written": written.joints,
            "animated": written.sampled,
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
            "error": {
                "meters": take.thinned.error,
                "joint": take.thinned_joint,
                "frame": take.thinned.code,
            },
            "weight_error": take.thinned.weight_error,
        }
    if written.curves:
        values["curves"] = [
            {
                "control": curve.name,
                "knots": curve.knots,
                "split": curve.split,
                "difference": curve.difference,
                "seam": curve.seam,
            }
            for curve in written.curves
        ]
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


def table_text(table: BakeTable) -> list[str]:
    """Return a table of settings, their cost and their error."""
    heads = ("", "setting", "count", "seconds", "kB", "error mm", "worst")
    rows = [
        (
            row.kind.value,
            row.setting,
            str(row.count),
            f"{row.seconds:.3f}",
            f"{row.bytes / 1e3:.0f}" if row.bytes else "",
            plain(row.error * 1000),
            f"{row.joint} at {row.time:.2f} s",
        )
        for row in table.rows
    ]
    lines = columns([heads, *rows], {0, 1, 6})
    return [*lines, f"samples compared with the source at {table.instants} instants"]


def table_json(table: BakeTable) -> dict[str, object]:
    """Return the table as plain values."""
    return {
        "table": "animtool/1",
        "source": str(table.source),
        "instants": table.instants,
        "rows": [
            {
                "kind": row.kind.value,
                "setting": row.setting,
                "count": row.count,
                "seconds": round(row.seconds, 6),
                "bytes": row.bytes,
                "error": {"meters": row.error, "joint": row.joint, "time": row.time},
            }
            for row in table.rows
        ],
    }
