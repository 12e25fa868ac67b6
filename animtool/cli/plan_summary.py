"""The steps and the meshes of a bake, and what they cost, in words and in JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from animtool.core.clock import frame_label
from animtool.core.errors import counted, excerpt
from animtool.core.quantities import duration_text, length_text, plain, size_text
from animtool.report.text import columns

if TYPE_CHECKING:
    from animtool.scene.bake.files import ConvertReport
    from animtool.scene.bake.prims import BakeReport, MeshReport, TakeReport
    from animtool.scene.bake.progress import StageCost
    from animtool.scene.bake.steps import Step


def mesh_text(take: TakeReport) -> list[str]:
    """Return a line on whose meshes or systems they are, and some on each."""
    lines = []
    for simulated, title in ((False, _deformed(take)), (True, _simulated(take))):
        meshes = [mesh for mesh in take.meshes if mesh.simulated is simulated]
        if meshes:
            lines += [title, *(line for mesh in meshes for line in _lines(mesh))]
    return lines


def _deformed(take: TakeReport) -> str:
    kinds = [mesh.kind for mesh in take.meshes if not mesh.simulated]
    strands = kinds.count("strands")
    shown = counted(len(kinds) - strands, "mesh", "meshes")
    if strands:
        shown += f" and {counted(strands, 'set', 'sets')} of strands"
    return f"  {shown} of {take.meshes_of}, deformed"


def _simulated(take: TakeReport) -> str:
    count = sum(mesh.simulated for mesh in take.meshes)
    return f"  {counted(count, 'system')} of {take.source.name}, simulated"


def _lines(mesh: MeshReport) -> list[str]:
    written = mesh.written
    where = ""
    if written.error:
        point = written.error_vertex
        which = (
            f"body {excerpt(written.names[point])}"
            if written.names
            else f"vertex {point}"
        )
        where = f" ({which}, frame {frame_label(written.error_code)})"
    moves = "still, no samples"
    if written.samples:
        moves = f"{counted(written.samples, 'frame')}, {size_text(written.bytes)}"
    many = counted(written.vertices, "vertex", "vertices")
    if mesh.simulated:
        nouns = _NOUNS.get(mesh.kind, ("particle",))
        many = counted(written.vertices, *nouns)
        many = f"up to {many}" if mesh.kind == "particles" else many
    if written.characters is not None:
        first, *more = _characters_text(mesh)
        return [f"    {mesh.name}: {many}, {first}", *more]
    return [
        f"    {mesh.name}: {many}, {moves}, "
        f"{duration_text(_milliseconds(mesh) / 1e3)} a frame, largest error of float32 "
        f"{length_text(written.error, 2)}{where}"
    ]


# What is counted of a kind of system.
_NOUNS = {"rigid": ("body", "bodies"), "crowds": ("agent",)}


def _characters_text(mesh: MeshReport) -> list[str]:
    """Return how characters were written, in lines."""
    characters = mesh.written.characters
    assert characters is not None
    kept = (
        f"{characters.samples / characters.frames:.0%}" if characters.frames else "none"
    )
    return [
        f"{counted(mesh.written.samples, 'frame')}, "
        f"{duration_text(_milliseconds(mesh) / 1e3)} a frame",
        f"      {characters.own} with an animation of their own, {kept} of poses "
        f"written: joints within {length_text(characters.error, 2)}, standing feet "
        f"{length_text(characters.slide, 2)}",
        f"      {characters.shared} with a part in an animation of who stands",
    ]


def _milliseconds(mesh: MeshReport) -> float:
    return mesh.seconds * 1e3 / max(mesh.frames, 1)


def _characters_json(mesh: MeshReport) -> dict[str, object]:
    """Return how characters were written; nothing of other meshes."""
    characters = mesh.written.characters
    return {} if characters is None else {"characters": asdict(characters)}


def mesh_json(take: TakeReport) -> list[dict[str, object]]:
    """Return what became of each mesh as plain values."""
    return [
        {
            "mesh": mesh.name,
            "kind": mesh.kind,
            "prim": mesh.written.path,
            "of": take.source.name if mesh.simulated else take.meshes_of,
            "vertices": mesh.written.vertices,
            **_characters_json(mesh),
            "samples": mesh.written.samples,
            "animated": mesh.written.sampled,
            "bytes": mesh.written.bytes,
            "milliseconds_per_frame": round(_milliseconds(mesh), 6),
            "error": {
                "meters": mesh.written.error,
                "vertex": mesh.written.error_vertex,
                "frame": mesh.written.error_code,
            },
        }
        for mesh in take.meshes
    ]


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
    return columns(rows, {0})


def _length(meters: float | None) -> str:
    return "" if meters is None else plain(meters * 1000)


def stats_json(
    stages: Sequence[StageCost], reports: Sequence[BakeReport | ConvertReport]
) -> list[dict[str, object]]:
    """Return what stages and outputs cost as plain values."""
    stats: list[dict[str, object]] = [
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
        stats.append({"output": name, "seconds": seconds, "error": error})
    return stats


def _output(
    report: BakeReport | ConvertReport,
) -> tuple[str, float | None, float | None]:
    """Return the file, the seconds and the error of an output, as far as known."""
    from animtool.scene.bake.files import ConvertReport

    if isinstance(report, ConvertReport):
        error = None if report.reduction is None else report.reduction.error
        return str(report.output), None, error
    files = [str(path) for path in report.result.outputs[-1:]] or ["stdout"]
    return files[0], report.seconds["total"], report.worst.written.rounding.error
