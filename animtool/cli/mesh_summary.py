"""What became of each mesh and of strands of a bake, in words and in JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.clock import frame_label
from animtool.errors import counted
from animtool.quantities import duration_text, length_text, size_text

if TYPE_CHECKING:
    from animtool.scene.report import MeshReport, TakeReport


def mesh_text(take: TakeReport) -> list[str]:
    """Return a line on whose meshes or systems they are, and one on each."""
    lines = []
    for simulated, title in ((False, _deformed(take)), (True, _simulated(take))):
        meshes = [mesh for mesh in take.meshes if mesh.simulated is simulated]
        if meshes:
            lines += [title, *(_line(mesh) for mesh in meshes)]
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


def _line(mesh: MeshReport) -> str:
    written = mesh.written
    where = ""
    if written.error:
        where = (
            f" (vertex {written.error_vertex}, frame {frame_label(written.error_code)})"
        )
    moves = "still, no samples"
    if written.samples:
        moves = f"{counted(written.samples, 'frame')}, {size_text(written.bytes)}"
    many = counted(written.vertices, "vertex", "vertices")
    if mesh.simulated:
        many = counted(written.vertices, "particle")
        many = f"up to {many}" if mesh.kind == "particles" else many
    return (
        f"    {mesh.name}: {many}, {moves}, "
        f"{duration_text(_milliseconds(mesh) / 1e3)} a frame, largest error of float32 "
        f"{length_text(written.error, 2)}{where}"
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
