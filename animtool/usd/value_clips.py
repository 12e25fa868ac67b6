"""Value clips: the layer that joins chunks, each with the samples of a time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pxr import Sdf, Vt

from animtool.usd.clip_files import ClipFiles


def author_clips(
    layer: Any,
    path: str,
    files: ClipFiles,
    starts: Sequence[float],
    last: float,
) -> None:
    """Let a prim, and what is below it, have the values of chunks.

    Args:
        layer: The layer of the prim; the files are named as it sees them.
        path: Of the prim, the same in every chunk.
        files: The chunks.
        starts: First time code of each.
        last: Last time code of all.
    """
    chunks = [Sdf.AssetPath(f"./{files.chunk(i).name}") for i in range(len(starts))]
    clips = {
        "assetPaths": Sdf.AssetPathArray(chunks),
        "primPath": path,
        "manifestAssetPath": Sdf.AssetPath(f"./{files.manifest.name}"),
        "active": Vt.Vec2dArray([(code, i) for i, code in enumerate(starts)]),
        "times": Vt.Vec2dArray([(code, code) for code in (starts[0], last)]),
    }
    layer.GetPrimAtPath(path).SetInfo("clips", {files.name: clips})
