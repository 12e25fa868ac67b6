"""Visibility of characters and their meshes over time."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import BoolArray
from animtool.core.clock import time_codes
from animtool.preview.draft import PageDraft
from animtool.preview.open_file import OpenFile
from animtool.preview.streams import Quantized
from animtool.preview.takes import PageTake
from animtool.preview.timing import TimelineTake


def add_visibility(
    draft: PageDraft, file: OpenFile, timeline_take: TimelineTake, page_take: PageTake
) -> None:
    """Add the visible frames of a take and its meshes.

    Args:
        draft: The page, with the take and its meshes.
        file: The file of the take.
        timeline_take: The take on the timeline.
        page_take: The take on the page.
    """
    contents, prim = file.contents, timeline_take.take.prim
    if contents is None or not prim:
        return
    codes = time_codes(
        timeline_take.first_frame - timeline_take.shift,
        timeline_take.stream.step,
        page_take.frames,
    )
    codes = codes * float(contents.fps / draft.timeline.fps)
    prim_visible = contents.visibility(prim, codes)
    page_take.entry["visible"] = visibility_stream(draft, prim_visible)
    if not prim_visible.any():
        draft.add_notice(
            f"{timeline_take.take.name!r} is hidden in every frame: it is not drawn"
        )
    meshes = [mesh for mesh in draft.meshes if mesh["take"] == page_take.index]
    visible_by_mesh = contents.mesh_visibility(prim, codes) if meshes else {}
    for mesh in meshes:
        mesh_visible = visible_by_mesh.get(mesh["name"], prim_visible)
        if not np.array_equal(mesh_visible, prim_visible):
            mesh["visible"] = visibility_stream(draft, mesh_visible)


def visibility_stream(draft: PageDraft, visible: BoolArray) -> int | None:
    """Return the stream index of a visibility mask ``(F,)``; None if always visible."""
    if visible.all():
        return None
    rows = visible[:, None] if visible.any() else visible[:1, None]
    return draft.packer.add(Quantized(rows.astype("<u1"), "u8"))
