"""What became of each mesh and of strands of a bake, in words and in JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.errors import counted
from animtool.units import unit_name

if TYPE_CHECKING:
    from animtool.scene.report import MeshReport, TakeReport

__all__ = ["mesh_json", "mesh_text"]


def mesh_text(take: TakeReport, meters_per_unit: float) -> list[str]:
    """Return a line on whose meshes or systems they are, and one on each.

    Args:
        take: What became of it.
        meters_per_unit: Unit of the output [m].
    """
    lines = []
    for simulated, title in ((False, _deformed(take)), (True, _simulated(take))):
        meshes = [mesh for mesh in take.meshes if mesh.simulated is simulated]
        if meshes:
            lines += [title, *(_line(mesh, meters_per_unit) for mesh in meshes)]
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


def _line(mesh: MeshReport, meters_per_unit: float) -> str:
    written = mesh.written
    error, unit = written.error / meters_per_unit, unit_name(meters_per_unit)
    where = ""
    if error:
        where = f" (vertex {written.error_vertex}, frame {written.error_code:g})"
    moves = "still, no samples"
    if written.samples:
        moves = f"{counted(written.samples, 'frame')}, {written.bytes / 1e6:.3g} MB"
    many = counted(written.vertices, "vertex", "vertices")
    if mesh.simulated:
        many = counted(written.vertices, "particle")
        many = f"up to {many}" if mesh.kind == "particles" else many
    return (
        f"    {mesh.name}: {many}, {moves}, "
        f"{_milliseconds(mesh):.3g} ms a frame, largest error of float32 {error:.2g} "
        f"{unit}{where}"
    )


def _milliseconds(mesh: MeshReport) -> float:
    return mesh.seconds * 1e3 / max(mesh.frames, 1)


def mesh_json(take: TakeReport) -> list[dict[str, object]]:
    """Return what became of each mesh as plain values."""
    return [
        {
            "mesh": mesh.name,
            "kind": mesh.kind,
            "prim": mesh.written.path,
            "of": take.source.name if mesh.simulated else take.meshes_of,
            "vertices": mesh.written.vertices,
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
