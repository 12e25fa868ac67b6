"""The summary of a bake, in words and in JSON."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

from animtool.rates import rate_label
from animtool.units import unit_name

if TYPE_CHECKING:
    from animtool.scene.bake import BakeReport

__all__ = ["bake_json", "bake_text"]


def _number(value: Fraction) -> str:
    return str(value) if value.denominator == 1 else f"{float(value):.6g}"


def bake_text(report: BakeReport) -> list[str]:
    """Return the lines of a summary."""
    result, seconds = report.result, report.seconds
    files = ", ".join(map(str, result.outputs)) or "stdout"
    unit = unit_name(report.meters_per_unit)
    first, last = _number(result.first), _number(result.last)
    frames = f"{result.samples} samples, frames {first} to {last}"
    frames += f" at {rate_label(report.fps)}"
    if report.source_fps != report.fps or report.source_frames != result.samples:
        source = f"{report.source_frames} frames at {rate_label(report.source_fps)}"
        frames += f", from {source}"
    megabytes = report.source_bytes / 1e6
    error = result.rounding.error / report.meters_per_unit
    where = (
        f" (joint {report.error_joint!r}, frame {result.rounding.code:g})"
        if error
        else ""
    )
    assumed = " (taken for granted: --units)" if report.unit_assumed else ""
    moving = " and ".join(result.sampled) or "nothing"
    return [
        f"{files}: {report.form}",
        f"  {frames}",
        f"  {result.joints} joints, {moving} animated",
        f"  {report.up} up, lengths in {unit}{assumed}",
        f"  {result.bytes / 1e6:.3g} MB in {seconds['total']:.2f} s "
        f"({megabytes / seconds['total']:.3g} MB/s): read {seconds['read']:.2f} beside "
        f"author {seconds['author']:.2f}, save {seconds['save']:.2f}",
        f"  largest error of float32: {error:.2g} {unit}{where}",
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
            "meters": result.rounding.error,
            "relative": result.rounding.error / report.size if report.size else None,
            "joint": report.error_joint,
            "frame": result.rounding.code,
        },
        "notices": [notice.as_dict() for notice in report.notices],
    }
