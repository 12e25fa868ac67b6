"""Adds a stage's visible prims to a page: meshes, caches, curves, points, cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.motion.transforms import PropRequest, Track
from animtool.preview.draft import PageDraft, skipped
from animtool.preview.meshes import mesh_entry
from animtool.preview.streams import (
    Quantized,
    quantized_range,
    quantized_units,
)
from animtool.preview.visibility import visibility_stream
from animtool.usd.caches.reader import PointSample
from animtool.usd.caches.shown import ShownFaces, ShownPrim, StageContents
from animtool.usd.layers.sdf import usd_errors
from animtool.usd.layers.stderr import without_usd_warnings
from animtool.usd.props.reader import open_prop

# This many instances are small on a page: without a color they are drawn dark.
MANY, DARK = 100, (0.03, 0.04, 0.06)
# Scales of copies may be off by as much [1].
SCALE_ERROR = 1e-4


def add_stage(draft: PageDraft, contents: StageContents) -> None:
    """Add the visible prims of a stage, except characters, to a page."""
    with usd_errors(contents.path), without_usd_warnings():
        codes = draft.timeline.codes * float(contents.fps / draft.timeline.fps)
        for prim in contents.prims:
            _ADD[prim.kind](draft, prim, codes)
    _add_cameras(draft, contents, codes)


def _add_mesh(draft: PageDraft, prim: ShownPrim, codes: FloatArray) -> None:
    if prim.deforms and prim.changes_faces:
        draft.note(f"mesh {prim.name!r} changes its faces: only its points are drawn")
        _add_points(draft, prim, codes)
        return
    faces = prim.faces()
    if faces is None:
        draft.note(f"mesh {prim.name!r} has no valid faces: it is not drawn")
        return
    if not prim.deforms:
        _add_rigid(draft, prim, faces, codes)
        return
    entry = _entry(draft, prim.name, faces)
    entry["cache"] = _cache(draft, prim, codes, len(faces.points))
    entry["visible"] = _visible(draft, prim, codes)
    draft.meshes.append(entry)


def _entry(draft: PageDraft, name: str, faces: ShownFaces) -> dict[str, Any]:
    return mesh_entry(
        draft,
        name,
        faces.points,
        faces.counts,
        faces.indices,
        faces.color,
        double_sided=faces.double_sided,
        colors=faces.colors,
    )


def _add_rigid(
    draft: PageDraft, prim: ShownPrim, faces: ShownFaces, codes: FloatArray
) -> None:
    """Add a rigidly moving mesh as one instance."""
    times = codes if prim.travels else codes[:1]
    matrices = np.stack([prim.world(code) for code in times.tolist()])
    if not np.isfinite(matrices).all():
        draft.note(f"{prim.name!r} has a transform that is not finite: it is not drawn")
        return
    shown = _visible(draft, prim, codes)
    if not prim.travels and shown is None:
        placed = faces.points @ matrices[0, :3, :3].T + matrices[0, :3, 3]
        rigid = replace(faces, points=placed)
        draft.meshes.append(_entry(draft, prim.name, rigid))
        return
    rotations, scales = so3.split_scale(matrices[:, :3, :3])
    draft.meshes.append(_entry(draft, prim.name, faces) | {"prototype": True})
    draft.instances.append(
        {
            "name": prim.name,
            "mesh": len(draft.meshes) - 1,
            **_placed(
                draft, matrices[:, None, :3, 3], rotations[:, None], scales[:, None]
            ),
            "visible": shown,
            "names": None,
        }
    )


def _placed(
    draft: PageDraft, positions: FloatArray, rotations: FloatArray, scales: FloatArray
) -> dict[str, Any]:
    """Return instance streams ``(F, N, 3)``, ``(F, N, 4)``, ``(F, N, 3)``."""
    frames = len(positions)
    where = quantized_range(positions.reshape(frames, -1), period=3)
    quantized = quantized_units(so3.align_signs(rotations).reshape(frames, -1))
    draft.off(position=where.error, rotation=2 * quantized.error)
    sizes = scales.reshape(frames, -1)
    return {
        "t": draft.packer.add(where),
        "r": draft.packer.add(quantized),
        "s": None
        if np.allclose(sizes, 1.0, atol=1e-6)
        else draft.packer.add(quantized_range(sizes, SCALE_ERROR, period=3)),
    }


def _cache(draft: PageDraft, prim: ShownPrim, codes: FloatArray, count: int) -> int:
    """Return the stream of animated points; samples of another length are held."""
    rows = np.empty((len(codes), 3 * count), np.float32)
    for i, code in enumerate(codes.tolist()):
        points = prim.points(code)
        if len(points) == count:
            rows[i] = points.reshape(-1)
        else:
            rows[i] = rows[i - 1] if i else 0.0
            draft.note(f"{prim.name!r} has a different number of points in some frames")
    stored = quantized_range(rows, period=3)
    draft.off(position=stored.error)
    return draft.packer.add(stored)


def _visible(draft: PageDraft, prim: ShownPrim, codes: FloatArray) -> int | None:
    return visibility_stream(draft, prim.visible(codes))


def _add_curves(draft: PageDraft, prim: ShownPrim, codes: FloatArray) -> None:
    if prim.changes_faces:
        draft.note(f"the number of curves {prim.name!r} changes: points are drawn")
        _add_points(draft, prim, codes)
        return
    counts = prim.counts()
    moves = prim.deforms or prim.travels
    times = codes if moves else codes[:1]
    count = len(prim.points(float(codes[0])))
    if not count or counts.sum() != count:
        return
    widths = prim.widths(float(codes[0]))
    draft.curves.append(
        {
            "name": prim.name,
            "take": None,
            "joint": None,
            "bind": None,
            "counts": draft.packer.static(counts, "u32"),
            "points": _cache(draft, prim, times, count),
            "width": _mean(widths),
            "color": None if prim.color is None else list(prim.color),
        }
    )


def _add_points(draft: PageDraft, prim: ShownPrim, codes: FloatArray) -> None:
    moves = prim.deforms or prim.travels
    times = (codes if moves else codes[:1]).tolist()
    slots = Slots()
    rows = [(slots.take(prim.ids(t), p := prim.points(t)), p) for t in times]
    if not slots.count:
        return
    positions = _in_slots(rows, slots.count)
    widths = _slot_values(rows, [prim.widths(t) for t in times], slots.count)
    colors = _slot_values(rows, [prim.colors(t) for t in times], slots.count)
    stored = quantized_range(positions, period=3)
    draft.off(position=stored.error)
    draft.points.append(
        {
            "name": prim.name,
            "positions": draft.packer.add(stored),
            "radius": 0.0 if widths is None else _mean(widths) / 2,
            "radii": None
            if widths is None or np.ptp(widths) == 0
            else draft.packer.static(widths / 2, "f32"),
            "color": None if prim.color is None else list(prim.color),
            "colors": None
            if colors is None or not np.ptp(colors, axis=0).any()
            else draft.packer.static(np.rint(colors.clip(0, 1) * 255), "u8"),
            "names": None,
        }
    )


def _mean(values: FloatArray) -> float:
    """Return the mean of the finite values; 0 without any."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else 0.0


class Slots:
    """Columns for points that appear and disappear, reused over time."""

    def __init__(self) -> None:
        self.count = 0
        self._of: dict[int, int] = {}

    def take(self, ids: IntArray | None, rows: FloatArray) -> IntArray:
        """Return the column of each point of a frame ``(N,)``."""
        names = (
            range(len(rows)) if ids is None or len(ids) != len(rows) else ids.tolist()
        )
        before, self._of = self._of, {}
        kept = {name: before[name] for name in names if name in before}
        used = set(kept.values())
        free = (slot for slot in range(self.count + len(rows)) if slot not in used)
        for name in names:
            self._of[name] = kept[name] if name in kept else next(free)
        columns = np.array([self._of[name] for name in names], np.int64)
        self.count = max(self.count, int(columns.max(initial=-1)) + 1)
        return columns


def _in_slots(rows: list[tuple[IntArray, FloatArray]], count: int) -> FloatArray:
    placed = np.full((len(rows), count, 3), np.nan)
    for frame, (slots, values) in zip(placed, rows, strict=True):
        frame[slots] = values
    return placed.reshape(len(rows), -1)


def _slot_values(
    rows: list[tuple[IntArray, FloatArray]], values: list[FloatArray], count: int
) -> FloatArray | None:
    """Return a value per slot, from its last point; None if there are none."""
    known = next((one for one in values if len(one)), None)
    if known is None:
        return None
    filled = np.zeros((count, *known.shape[1:]))
    for (slots, _), rows_values in zip(rows, values, strict=True):
        if len(rows_values) in {1, len(slots)} and len(slots):
            filled[slots] = rows_values
    return filled


def _add_copies(draft: PageDraft, prim: ShownPrim, codes: FloatArray) -> None:
    prototypes = prim.prototypes()
    times = (codes if prim.deforms or prim.travels else codes[:1]).tolist()
    samples = [prim.copies(code) for code in times]
    slots = Slots()
    rows = [slots.take(sample.ids, sample.points) for sample in samples]
    copies = _Copies.of(samples, rows, slots.count)
    for k, parts in enumerate(prototypes):
        # A slot shows the mesh of its point, whichever that is in a frame.
        shown = copies.copied == k
        columns = np.flatnonzero(shown.any(axis=0))
        if not len(columns):
            continue
        for i, (faces, matrix) in enumerate(parts):
            name = f"{prim.name} {k + 1}" + (f".{i + 1}" if len(parts) > 1 else "")
            placed = faces.points @ matrix[:3, :3].T + matrix[:3, 3]
            dark = DARK if len(columns) > MANY else None
            color = faces.color or prim.color or dark
            prototype = replace(faces, points=placed, color=color)
            draft.meshes.append(_entry(draft, name, prototype) | {"prototype": True})
            visible = shown[:, columns]
            draft.instances.append(
                {
                    "name": name,
                    "mesh": len(draft.meshes) - 1,
                    **_placed(
                        draft,
                        copies.points[:, columns],
                        copies.rotations[:, columns],
                        copies.scales[:, columns],
                    ),
                    "visible": None
                    if visible.all()
                    else draft.packer.add(Quantized(visible.astype("<u1"), "u8")),
                    "names": None,
                }
            )


class _Copies:
    """Instances by slot; a removed one keeps its last transform."""

    def __init__(self, frames: int, count: int) -> None:
        self.points = np.zeros((frames, count, 3))
        self.rotations = np.tile([0.0, 0.0, 0.0, 1.0], (frames, count, 1))
        self.scales = np.ones((frames, count, 3))
        self.copied = np.full((frames, count), -1)

    @classmethod
    def of(
        cls, samples: list[PointSample], rows: list[IntArray], count: int
    ) -> _Copies:
        """Return the instances of samples; rows: the slot of each."""
        copies = cls(len(samples), count)
        for f, (sample, slots) in enumerate(zip(samples, rows, strict=True)):
            if f:
                for values in (copies.points, copies.rotations, copies.scales):
                    values[f] = values[f - 1]
            copies.points[f, slots] = sample.points
            copies.rotations[f, slots] = sample.orientations
            copies.scales[f, slots] = sample.scales
            copies.copied[f, slots] = sample.copied
        return copies


def _add_cameras(draft: PageDraft, contents: StageContents, codes: FloatArray) -> None:
    for path in contents.cameras():
        with skipped(draft, f"camera {path!r}"):
            prop = open_prop(PropRequest(contents.path, path, path), UpAxis.Y)
            add_camera(draft, prop.track, codes)


def add_camera(draft: PageDraft, track: Track, times: FloatArray) -> None:
    """Add a camera to a page; times: of its track ``(F,)``, at each frame."""
    names = [attribute.name for attribute in track.attributes]
    there = track.at(times if track.moves else times[:1])
    # Lenses are in tenths of the unit of the stage, which is in metres by now.
    lens = {
        name: there.values[names.index(name)] * 100
        for name in ("focalLength", "horizontalAperture", "verticalAperture")
        if name in names
    }
    focal = lens.get("focalLength", np.full((1, 1), 50.0))
    quantized = quantized_units(there.rotations)
    where = quantized_range(there.translations)
    draft.off(position=where.error, rotation=2 * quantized.error)
    clip = [0.01, 1e5]
    if "clippingRange" in names:
        clip = there.values[names.index("clippingRange")][0].tolist()
    draft.cameras.append(
        {
            "name": track.path,
            "t": draft.packer.add(where),
            "r": draft.packer.add(quantized),
            "focal_mm": float(focal[0, 0]),
            "focal": None
            if np.ptp(focal) == 0
            else draft.packer.add(Quantized(focal.astype("<f4"), "f32")),
            "aperture_mm": [
                float(lens[name][0, 0]) if name in lens else default
                for name, default in (
                    ("horizontalAperture", 20.955),
                    ("verticalAperture", 15.2908),
                )
            ],
            "clip": clip,
        }
    )


_ADD: dict[str, Callable[[PageDraft, ShownPrim, FloatArray], None]] = {
    "mesh": _add_mesh,
    "curves": _add_curves,
    "points": _add_points,
    "copies": _add_copies,
}
