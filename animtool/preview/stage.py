"""Adds the visible prims of a stage to a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.motion.transforms import PropRequest, Track
from animtool.preview.draft import PageDraft, skip_unreadable
from animtool.preview.meshes import mesh_entry
from animtool.preview.streams import QuantizedValues, quantize_range, quantize_units
from animtool.usd.caches.reader import PointSample
from animtool.usd.caches.shown import StageContents, VisibleMesh, VisiblePrim
from animtool.usd.layers.sdf import usd_errors
from animtool.usd.layers.stderr import without_usd_warnings
from animtool.usd.props.reader import open_prop

# From this many instances on, they are small on a page; without a color they are drawn
# dark.
MIN_SMALL_INSTANCES, DARK_COLOR = 100, (0.03, 0.04, 0.06)
# Quantization error allowed for instance scales [1].
SCALE_TOLERANCE = 1e-4


def add_stage(draft: PageDraft, contents: StageContents) -> None:
    """Add the visible prims of a stage to a page, except characters."""
    with usd_errors(contents.path), without_usd_warnings():
        codes = draft.timeline.codes * float(contents.fps / draft.timeline.fps)
        for prim in contents.prims:
            _ADD_BY_KIND[prim.kind](draft, prim, codes)
    _add_cameras(draft, contents, codes)


def _add_mesh(draft: PageDraft, prim: VisiblePrim, codes: FloatArray) -> None:
    """Add a mesh that is static, rigid, or has animated points."""
    if prim.is_deforming and prim.has_changing_faces:
        draft.add_notice(
            f"mesh {prim.name!r} changes its faces: only its points are drawn"
        )
        _add_points(draft, prim, codes)
        return
    mesh = prim.local_mesh()
    if mesh is None:
        draft.add_notice(f"mesh {prim.name!r} has no valid faces: it is not drawn")
        return
    if not prim.is_deforming:
        _add_rigid(draft, prim, mesh, codes)
        return
    entry = _stage_mesh_entry(draft, prim.name, mesh)
    entry["cache"] = _point_stream(draft, prim, codes, len(mesh.points))
    entry["visible"] = draft.add_mask(prim.visibility(codes))
    draft.meshes.append(entry)


def _stage_mesh_entry(draft: PageDraft, name: str, mesh: VisibleMesh) -> dict[str, Any]:
    """Return the manifest entry of a stage's mesh."""
    return mesh_entry(
        draft,
        name,
        mesh.points,
        mesh.counts,
        mesh.indices,
        mesh.color,
        colors=mesh.colors,
    )


def _add_rigid(
    draft: PageDraft, prim: VisiblePrim, mesh: VisibleMesh, codes: FloatArray
) -> None:
    """Add a mesh that only moves rigidly, as an instanced mesh with one instance."""
    sampled_codes = codes if prim.is_moving else codes[:1]
    matrices = np.stack([prim.world(code) for code in sampled_codes.tolist()])
    if not np.isfinite(matrices).all():
        draft.add_notice(
            f"{prim.name!r} has a transform that is not finite: it is not drawn"
        )
        return
    visibility = draft.add_mask(prim.visibility(codes))
    if not prim.is_moving and visibility is None:
        world_points = mesh.points @ matrices[0, :3, :3].T + matrices[0, :3, 3]
        rigid_mesh = replace(mesh, points=world_points)
        draft.meshes.append(_stage_mesh_entry(draft, prim.name, rigid_mesh))
        return
    rotations, scales = so3.split_scale(matrices[:, :3, :3])
    entry = _add_prototype(
        draft,
        prim.name,
        mesh,
        matrices[:, None, :3, 3],
        rotations[:, None],
        scales[:, None],
    )
    entry["visible"] = visibility


def _add_prototype(
    draft: PageDraft,
    name: str,
    mesh: VisibleMesh,
    positions: FloatArray,
    rotations: FloatArray,
    scales: FloatArray,
) -> dict[str, Any]:
    """Add a mesh and N instances of it in F frames; return the instances' entry.

    ``positions`` ``(F, N, 3)`` [m], ``rotations`` ``(F, N, 4)``, ``scales``
    ``(F, N, 3)``.
    """
    draft.meshes.append(_stage_mesh_entry(draft, name, mesh) | {"prototype": True})
    frame_count = len(positions)
    units = quantize_units(so3.align_signs(rotations).reshape(frame_count, -1))
    draft.record_error(rotation=2 * units.error)
    scale_rows = scales.reshape(frame_count, -1)
    entry = {
        "name": name,
        "mesh": len(draft.meshes) - 1,
        "t": draft.add_positions(positions),
        "r": draft.packer.add(units),
        "s": None
        if np.allclose(scale_rows, 1.0, atol=1e-6)
        else draft.packer.add(
            quantize_range(scale_rows, SCALE_TOLERANCE, column_period=3)
        ),
        "visible": None,
    }
    draft.instances.append(entry)
    return entry


def _point_stream(
    draft: PageDraft, prim: VisiblePrim, codes: FloatArray, point_count: int
) -> int:
    """Return the stream index of animated points.

    A sample with another number of points is replaced by the previous one.
    """
    frame_rows = np.empty((len(codes), 3 * point_count), np.float32)
    for i, code in enumerate(codes.tolist()):
        points = prim.points(code)
        if len(points) == point_count:
            frame_rows[i] = points.reshape(-1)
        else:
            frame_rows[i] = frame_rows[i - 1] if i else 0.0
            draft.add_notice(
                f"{prim.name!r} has a different number of points in some frames"
            )
    return draft.add_positions(frame_rows)


def _add_curves(draft: PageDraft, prim: VisiblePrim, codes: FloatArray) -> None:
    """Add curves as strands with widths."""
    if prim.has_changing_faces:
        draft.add_notice(
            f"the number of curves {prim.name!r} changes: points are drawn"
        )
        _add_points(draft, prim, codes)
        return
    counts = prim.curve_counts()
    sampled_codes = codes if prim.is_animated else codes[:1]
    point_count = len(prim.points(float(codes[0])))
    if not point_count or counts.sum() != point_count:
        return
    widths = prim.widths(float(codes[0]))
    draft.curves.append(
        {
            "name": prim.name,
            "take": None,
            "joint": None,
            "bind": None,
            "counts": draft.packer.add_static(counts, "u32"),
            "points": _point_stream(draft, prim, sampled_codes, point_count),
            "width": _finite_mean(widths),
            "color": None if prim.color is None else list(prim.color),
        }
    )


def _add_points(draft: PageDraft, prim: VisiblePrim, codes: FloatArray) -> None:
    """Add points with widths and colors; each point keeps its slot."""
    sampled_codes = (codes if prim.is_animated else codes[:1]).tolist()
    slots = PointSlots()
    slotted_points = [
        (slots.assign(prim.ids(t), p := prim.points(t)), p) for t in sampled_codes
    ]
    if not slots.count:
        return
    positions = _spread_to_slots(slotted_points, slots.count)
    widths = _slot_values(
        slotted_points, [prim.widths(t) for t in sampled_codes], slots.count
    )
    colors = _slot_values(
        slotted_points, [prim.colors(t) for t in sampled_codes], slots.count
    )
    draft.add_points(
        prim.name,
        draft.add_positions(positions),
        radius=0.0 if widths is None else _finite_mean(widths) / 2,
        radius_stream=None
        if widths is None or np.ptp(widths) == 0
        else draft.packer.add_static(widths / 2, "f32"),
        color=prim.color,
        color_stream=None
        if colors is None or not np.ptp(colors, axis=0).any()
        else draft.packer.add_static(np.rint(colors.clip(0, 1) * 255), "u8"),
    )


def _finite_mean(values: FloatArray) -> float:
    """Return the mean of the finite values; 0 if there are none."""
    finite_values = values[np.isfinite(values)]
    return float(finite_values.mean()) if finite_values.size else 0.0


class PointSlots:
    """Assigns columns (slots) to points that appear and disappear, and reuses them."""

    def __init__(self) -> None:
        self.count = 0
        self._slot_by_id: dict[int, int] = {}

    def assign(self, ids: IntArray | None, points: FloatArray) -> IntArray:
        """Return the slot of each point of a frame ``(N,)``, adding new points."""
        point_ids = (
            range(len(points))
            if ids is None or len(ids) != len(points)
            else ids.tolist()
        )
        previous_slot_by_id, self._slot_by_id = self._slot_by_id, {}
        reused_slot_by_id = {
            point_id: previous_slot_by_id[point_id]
            for point_id in point_ids
            if point_id in previous_slot_by_id
        }
        used_slots = set(reused_slot_by_id.values())
        free_slots = (
            slot for slot in range(self.count + len(points)) if slot not in used_slots
        )
        for point_id in point_ids:
            self._slot_by_id[point_id] = (
                reused_slot_by_id[point_id]
                if point_id in reused_slot_by_id
                else next(free_slots)
            )
        slots = np.array(
            [self._slot_by_id[point_id] for point_id in point_ids], np.int64
        )
        self.count = max(self.count, int(slots.max(initial=-1)) + 1)
        return slots


def _spread_to_slots(
    slotted_points: list[tuple[IntArray, FloatArray]], slot_count: int
) -> FloatArray:
    """Return positions arranged by slot ``(F, 3 S)``, with NaN in empty slots."""
    slot_positions = np.full((len(slotted_points), slot_count, 3), np.nan)
    for frame_positions, (slots, points) in zip(
        slot_positions, slotted_points, strict=True
    ):
        frame_positions[slots] = points
    return slot_positions.reshape(len(slotted_points), -1)


def _slot_values(
    slotted_points: list[tuple[IntArray, FloatArray]],
    values_by_frame: list[FloatArray],
    slot_count: int,
) -> FloatArray | None:
    """Return one value per slot, from its last point; None if there are no values."""
    first_values = next(
        (frame_values for frame_values in values_by_frame if len(frame_values)), None
    )
    if first_values is None:
        return None
    slot_values = np.zeros((slot_count, *first_values.shape[1:]))
    for (slots, _), frame_values in zip(slotted_points, values_by_frame, strict=True):
        if len(frame_values) in {1, len(slots)} and len(slots):
            slot_values[slots] = frame_values
    return slot_values


def _add_instances(draft: PageDraft, prim: VisiblePrim, codes: FloatArray) -> None:
    """Add the instances of a point instancer, one mesh per prototype."""
    prototypes = prim.prototypes()
    sampled_codes = (codes if prim.is_animated else codes[:1]).tolist()
    instance_samples = [prim.instances(code) for code in sampled_codes]
    slots = PointSlots()
    sample_slots = [
        slots.assign(sample.ids, sample.points) for sample in instance_samples
    ]
    instances = _SlotInstances(instance_samples, sample_slots, slots.count)
    for k, meshes in enumerate(prototypes):
        # A slot shows the mesh of its point, which may change over frames.
        uses_prototype = instances.prototype_indices == k
        used_slots = np.flatnonzero(uses_prototype.any(axis=0))
        if not len(used_slots):
            continue
        for i, (mesh, matrix) in enumerate(meshes):
            name = f"{prim.name} {k + 1}" + (f".{i + 1}" if len(meshes) > 1 else "")
            points = mesh.points @ matrix[:3, :3].T + matrix[:3, 3]
            default_color = (
                DARK_COLOR if len(used_slots) > MIN_SMALL_INSTANCES else None
            )
            color = mesh.color or prim.color or default_color
            prototype = replace(mesh, points=points, color=color)
            entry = _add_prototype(
                draft,
                name,
                prototype,
                instances.points[:, used_slots],
                instances.rotations[:, used_slots],
                instances.scales[:, used_slots],
            )
            is_visible = uses_prototype[:, used_slots]
            if not is_visible.all():
                quantized = QuantizedValues(is_visible.astype("<u1"), "u8")
                entry["visible"] = draft.packer.add(quantized)


class _SlotInstances:
    """Transforms of instances by slot; a removed instance keeps its last transform."""

    def __init__(
        self, samples: list[PointSample], sample_slots: list[IntArray], slot_count: int
    ) -> None:
        """Arrange instances by slot; each sample has the slots of its instances."""
        shape = len(samples), slot_count
        self.points = np.zeros((*shape, 3))
        self.rotations = np.tile([0.0, 0.0, 0.0, 1.0], (*shape, 1))
        self.scales = np.ones((*shape, 3))
        self.prototype_indices = np.full(shape, -1)
        for f, (sample, slots) in enumerate(zip(samples, sample_slots, strict=True)):
            if f:
                for values in (self.points, self.rotations, self.scales):
                    values[f] = values[f - 1]
            self.points[f, slots] = sample.points
            self.rotations[f, slots] = sample.orientations
            self.scales[f, slots] = sample.scales
            self.prototype_indices[f, slots] = sample.prototype_indices


def _add_cameras(draft: PageDraft, contents: StageContents, codes: FloatArray) -> None:
    """Add the cameras of a stage; skip unreadable ones with a notice."""
    for path in contents.cameras():
        with skip_unreadable(draft, f"camera {path!r}"):
            prop = open_prop(PropRequest(contents.path, path, path), UpAxis.Y)
            add_camera(draft, prop.track, codes)


def add_camera(draft: PageDraft, track: Track, times: FloatArray) -> None:
    """Add a camera to a page, sampled at track times for each frame ``(F,)``."""
    attribute_names = [attribute.name for attribute in track.attributes]
    camera_samples = track.at(times if track.is_animated else times[:1])
    # Lenses are in tenths of a stage unit, which is metres here.
    lens_values_by_name = {
        name: camera_samples.values[attribute_names.index(name)] * 100
        for name in ("focalLength", "horizontalAperture", "verticalAperture")
        if name in attribute_names
    }
    focal_lengths = lens_values_by_name.get("focalLength", np.full((1, 1), 50.0))
    rotations = quantize_units(camera_samples.rotations)
    positions = quantize_range(camera_samples.translations)
    draft.record_error(position=positions.error, rotation=2 * rotations.error)
    draft.cameras.append(
        {
            "name": track.path,
            "t": draft.packer.add(positions),
            "r": draft.packer.add(rotations),
            "focal_mm": float(focal_lengths[0, 0]),
            "focal": None
            if np.ptp(focal_lengths) == 0
            else draft.packer.add(QuantizedValues(focal_lengths.astype("<f4"), "f32")),
            "aperture_mm": [
                float(lens_values_by_name[name][0, 0])
                if name in lens_values_by_name
                else default_aperture
                for name, default_aperture in (
                    ("horizontalAperture", 20.955),
                    ("verticalAperture", 15.2908),
                )
            ],
        }
    )


_ADD_BY_KIND: dict[str, Callable[[PageDraft, VisiblePrim, FloatArray], None]] = {
    "mesh": _add_mesh,
    "curves": _add_curves,
    "points": _add_points,
    "copies": _add_instances,
}
