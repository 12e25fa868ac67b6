"""The summary of a bake, in words and in JSON."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import TYPE_CHECKING

from animtool.rates import rate_label
from animtool.units import unit_name

if TYPE_CHECKING:
    from animtool.scene.bake import BakeReport
    from animtool.scene.table import BakeTable

__all__ = ["bake_details", "bake_json", "bake_text", "table_json", "table_text"]


def _number(value: Fraction) -> str:
    return str(value) if value.denominator == 1 else f"{float(value):.6g}"


def _finite(value: float) -> float | None:
    """Return the value, or None where JSON has no number for it."""
    return value if math.isfinite(value) else None


def bake_text(report: BakeReport) -> list[str]:
    """Return the lines of a summary."""
    result, total = report.result, report.seconds["total"]
    files = ", ".join(map(str, result.outputs)) or "stdout"
    unit = unit_name(report.meters_per_unit)
    samples = "1 sample" if result.samples == 1 else f"{result.samples} samples"
    frames = f"{samples}, frames {_number(result.first)} to {_number(result.last)}"
    frames += f" at {rate_label(report.fps)}"
    if report.source_fps != report.fps or report.source_frames != result.samples:
        source = f"{report.source_frames} frames at {rate_label(report.source_fps)}"
        frames += f", from {source}"
    error = result.rounding.error / report.meters_per_unit
    where = ""
    if error:
        where = f" (joint {report.error_joint!r}, frame {result.rounding.code:g})"
    moving = " and ".join(result.sampled) or "nothing"
    assumed = "; the source taken to be in cm (--units)" if report.unit_assumed else ""
    return [
        f"{files}: {report.form}",
        f"  {frames}",
        f"  {result.joints} joints, {moving} animated",
        f"  {report.up} up, lengths in {unit}{assumed}",
        f"  {result.bytes / 1e6:.3g} MB written in {total:.2f} s, "
        f"{report.source_bytes / 1e6 / total:.3g} MB/s of source",
        f"  largest error of float32: {error:.2g} {unit}{where}",
        *_thinned_text(report, unit),
        *_curves_text(report),
    ]


def _thinned_text(report: BakeReport, unit: str) -> list[str]:
    thinned = report.thinned
    if thinned is None:
        return []
    error = thinned.error / report.meters_per_unit
    where = (
        f" (joint {report.thinned_joint!r}, frame {thinned.code:g})" if error else ""
    )
    return [
        f"  {thinned.samples} samples reduced to {len(thinned.kept)}: largest error "
        f"between them {error:.3g} {unit}{where}"
    ]


def _curves_text(report: BakeReport) -> list[str]:
    curves = report.result.curves
    if not curves:
        return []
    worst = max(curves, key=lambda curve: curve.difference)
    where = f" (control {worst.name!r})" if worst.difference else ""
    knots = sum(curve.knots for curve in curves)
    return [
        f"  {len(curves)} curves of controls kept, {knots} knots: largest difference "
        f"{worst.difference:.2g}{where}"
    ]


def bake_details(report: BakeReport) -> list[str]:
    """Return what only the verbose are told."""
    seconds = ", ".join(f"{name} {value:.3f}" for name, value in report.seconds.items())
    stated = ", ".join(f"{key} {value}" for key, value in report.details.items())
    return [
        f"  source: {stated}",
        f"  seconds: {seconds} (read runs beside author)",
        f"  skeleton at rest: {report.size:.4g} m across",
    ]


def bake_json(report: BakeReport) -> dict[str, object]:
    """Return the summary as plain values."""
    result = report.result
    return {
        "bake": "animtool/1",
        "source": str(report.source),
        "outputs": [str(path) for path in result.outputs],
        "form": report.form,
        "source_frames": report.source_frames,
        "source_rate": str(report.source_fps),
        "samples": result.samples,
        "start": float(result.first),
        "end": float(result.last),
        "fps": float(report.fps),
        "rate": str(report.fps),
        "joints": report.joints,
        "joints_written": result.joints,
        "animated": result.sampled,
        "meters_per_unit": report.meters_per_unit,
        "units": unit_name(report.meters_per_unit),
        "up": report.up,
        "bytes": result.bytes,
        "seconds": {name: round(value, 6) for name, value in report.seconds.items()},
        "megabytes_per_second": round(
            report.source_bytes / 1e6 / report.seconds["total"], 3
        ),
        "error": {
            "meters": _finite(result.rounding.error),
            "relative": _finite(result.rounding.error / (report.size or math.inf)),
            "joint": report.error_joint,
            "frame": result.rounding.code,
        },
        **_extras_json(report),
        "notices": [notice.as_dict() for notice in report.notices],
    }


def _extras_json(report: BakeReport) -> dict[str, object]:
    """Return what only some bakes do."""
    found: dict[str, object] = {}
    if report.thinned is not None:
        found["reduction"] = {
            "samples": report.thinned.samples,
            "kept": len(report.thinned.kept),
            "error": {
                "meters": report.thinned.error,
                "joint": report.thinned_joint,
                "frame": report.thinned.code,
            },
            "weight_error": report.thinned.weight_error,
        }
    if report.result.curves:
        found["curves"] = [
            {
                "control": curve.name,
                "knots": curve.knots,
                "split": curve.split,
                "difference": curve.difference,
                "seam": curve.seam,
            }
            for curve in report.result.curves
        ]
    return found


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
            f"{row.error * 1000:.3g}",
            f"{row.joint} at {row.time:.2f} s",
        )
        for row in table.rows
    ]
    widths = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
    lines = []
    for cells in (heads, *rows):
        padded = [
            cell.ljust(width) if i in {0, 1, 6} else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(cells, widths, strict=True))
        ]
        lines.append("  ".join(padded).rstrip())
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
