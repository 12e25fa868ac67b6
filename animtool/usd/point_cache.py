"""Authoring deformed points as point caches: a stage of meshes, or overs on a rig."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pxr import Sdf, Vt

from animtool._types import Float32Array, FloatArray
from animtool.rig.surfaces import Strands, Surface
from animtool.shot import Shot
from animtool.skin.deform import Deformed
from animtool.units import UpAxis
from animtool.usd.finite import Labels, rounded
from animtool.usd.layers import (
    StageMetadata,
    author_metadata,
    new_layer,
    prim,
)
from animtool.usd.meshes import author_meshes, mesh_names
from animtool.usd.paths import RigPaths
from animtool.usd.point_space import PointSpace
from animtool.usd.samples import Samples
from animtool.usd.strands import author_strands, strand_paths

if TYPE_CHECKING:
    from animtool.usd.cache_target import CacheTarget

_TYPES = Sdf.ValueTypeNames


@dataclass(frozen=True, slots=True)
class PointBlock:
    """Frames of one mesh, or of strands, as the layer will hold them, in its unit.

    Attributes:
        mesh: The mesh's place in the job.
        codes: Time codes ``(F,)``.
        points: ``(F, V, 3)`` float32, in the mesh's own space.
        extents: Bounds of the points, or of curves about them ``(F, 2, 3)`` float32.
        normals: ``(F, V, 3)`` float32; None where they are not written.
        velocities: ``(F, V, 3)`` float32, per second; None likewise.
        error: Largest distance that rounding moved a point [m].
        error_code: Time code of that.
        error_vertex: The point that moved.
    """

    mesh: int
    codes: FloatArray
    points: Float32Array
    extents: Float32Array
    normals: Float32Array | None
    velocities: Float32Array | None
    error: float
    error_code: float
    error_vertex: int

    def select(self, frames: slice) -> PointBlock:
        """Return some of the frames; the error stays that of all."""
        return replace(
            self,
            codes=self.codes[frames],
            points=self.points[frames],
            extents=self.extents[frames],
            normals=None if self.normals is None else self.normals[frames],
            velocities=None if self.velocities is None else self.velocities[frames],
        )


@dataclass(frozen=True, slots=True)
class CacheJob:
    """What `author_cache` needs beside the blocks.

    Attributes:
        output: The file; None is usda for stdout.
        paths: The character's prims.
        meshes: Paths of the prims of meshes, then of strands, as the blocks count them.
        fps: Time codes a second.
        frames: First and last time code; None takes those of the samples.
        meters_per_unit: Unit of the layer's numbers [m].
        up: Up axis of a stage.
        surfaces: Of a stage, the meshes.
        strands: Of a stage, likewise.
        normals: Of a layer, whether the blocks have those of meshes that have them;
            False blocks those of the rig.
        target: Of a layer, the rig; None is a stage.
        shot: The shot that is written; None is no shot.
    """

    output: Path | None
    paths: RigPaths
    meshes: tuple[str, ...]
    fps: Fraction
    frames: tuple[Fraction, Fraction] | None
    meters_per_unit: float
    up: UpAxis
    surfaces: tuple[Surface, ...] = ()
    strands: tuple[Strands, ...] = ()
    normals: bool = True
    target: CacheTarget | None = None
    shot: Shot | None = None


@dataclass(slots=True)
class CachedMesh:
    """What was written of a mesh, or of strands.

    Attributes:
        path: Its prim.
        vertices: Number of its points.
        samples: Time samples of its points; 0 where it never moves.
        bytes: Size of its samples in memory.
        sampled: Names of the attributes that change.
        error: Largest distance that rounding moved a point [m].
        error_code: Time code of that.
        error_vertex: The point that moved.
    """

    path: str
    vertices: int = 0
    samples: int = 0
    bytes: int = 0
    sampled: list[str] = field(default_factory=list)
    error: float = 0.0
    error_code: float = 0.0
    error_vertex: int = 0

    def add(self, block: PointBlock) -> None:
        """Count a block, and keep the larger error."""
        self.vertices = block.points.shape[1]
        self.samples += len(block.codes)
        if block.error > self.error:
            self.error, self.error_code = block.error, block.error_code
            self.error_vertex = block.error_vertex


def mesh_paths(
    surfaces: Sequence[Surface], strands: Sequence[Strands], paths: RigPaths
) -> tuple[str, ...]:
    """Return where a stage has meshes, then strands: as a stage with a skeleton."""
    return (*mesh_names(surfaces, paths)[0], *strand_paths(strands, paths))


def round_points(
    mesh: int,
    codes: FloatArray,
    deformed: Deformed,
    meters_per_unit: float,
    space: PointSpace,
) -> PointBlock:
    """Return frames of a mesh rounded to what USD holds, and what the rounding did.

    Args:
        mesh: The mesh's place in the job.
        codes: Time codes ``(F,)``.
        deformed: Its frames [m].
        meters_per_unit: Unit of the layer [m].
        space: Where they are written.

    Raises:
        OutputError: USD holds a value as no finite number (USD170).
    """
    points, extents = deformed.points, deformed.extents
    velocities, normals = deformed.velocities, deformed.normals
    placement = space.placement
    if placement is not None:
        linear, shift = placement[:3, :3], placement[:3, 3] * meters_per_unit
        points = points @ linear.T + shift
        extents = np.stack([points.min(axis=1), points.max(axis=1)], axis=1)
        velocities = None if velocities is None else velocities @ linear.T
        normals = None if normals is None else _turned(normals, linear)
    made, error, frame, vertex = rounded(
        points, meters_per_unit, Labels("points", "point"), codes
    )

    def alike(name: str, values: FloatArray, unit: float) -> Float32Array:
        return rounded(values, unit, Labels(name, "point"), codes)[0]

    return PointBlock(
        mesh,
        codes,
        made,
        _widened(alike("extent", extents, meters_per_unit), space.margin),
        None if normals is None else alike("normals", normals, 1.0),
        None
        if velocities is None
        else alike("velocities", velocities, meters_per_unit),
        error,
        float(codes[frame]),
        vertex,
    )


def _widened(extents: Float32Array, margin: float) -> Float32Array:
    """Return bounds of what is drawn about points, as `UsdGeom.Curves` has them."""
    with np.errstate(over="ignore"):
        return extents + np.array([[-margin], [margin]], np.float32)


def _turned(normals: FloatArray, linear: FloatArray) -> FloatArray:
    turned = normals @ np.linalg.inv(linear)
    length = np.linalg.norm(turned, axis=-1, keepdims=True)
    return np.asarray(turned / np.where(length > 0, length, 1.0))


def author_cache(
    job: CacheJob, blocks: Iterator[PointBlock]
) -> tuple[Any, list[CachedMesh]]:
    """Author a layer in memory; nothing is written yet.

    A stage has ``Xform`` prims where one with a skeleton has the model and the
    SkelRoot, and meshes and strands at the same paths, bound to nothing. A layer makes
    the SkelRoot of its rig an ``Xform``, so that UsdSkel does not deform what is
    deformed already.

    Raises:
        OutputError: The rig's own opinions would win (USD042).
    """
    layer = new_layer(job.output or Path("stdout.usda"))
    with Sdf.ChangeBlock():
        specs = author_prims(layer, job)
        writers = [MeshWriter(specs[path]) for path in job.meshes]
        whole = job.target is None
        first, last = np.inf, -np.inf
        for block in blocks:
            writers[block.mesh].add(block)
            first, last = min(first, block.codes[0]), max(last, block.codes[-1])
        reports = [writer.finish(rest=whole) for writer in writers]
        author_metadata(layer, cache_metadata(job, first, last))
    if job.target is not None:
        job.target.check(layer)
    return layer, reports


def author_prims(layer: Any, job: CacheJob) -> Mapping[str, Any]:
    """Write everything but points; return the meshes' prims by path."""
    if job.target is None:
        return _author_stage(layer, job)
    return job.target.author(layer, normals=job.normals)


def cache_metadata(job: CacheJob, first: float, last: float) -> StageMetadata:
    """Return what a layer of a cache states, for frames from first to last."""
    frames = job.frames or (Fraction(first), Fraction(last))
    default = Sdf.Path(job.paths.model).GetPrefixes()[0].name
    unit, up = job.meters_per_unit, job.up
    if job.target is not None:
        unit, up = job.target.unit, job.target.up
    return StageMetadata(default, job.fps, *frames, unit, up, job.shot)


def _author_stage(layer: Any, job: CacheJob) -> Mapping[str, Any]:
    model = Sdf.Path(job.paths.model)
    for ancestor in model.GetAncestorsRange():
        if not ancestor.IsAbsoluteRootPath():
            kind = "component" if ancestor == model else "group"
            prim(layer, str(ancestor), "Xform").SetInfo("kind", kind)
    prim(layer, job.paths.root, "Xform")
    unit = job.meters_per_unit
    author_meshes(layer, job.surfaces, job.paths, {}, unit, bound=False)
    author_strands(layer, job.strands, job.paths, {}, unit, bound=False)
    return {path: layer.GetPrimAtPath(path) for path in job.meshes}


class MeshWriter:
    """Writes a mesh: samples of what changes, a default of what does not."""

    def __init__(self, spec: Any) -> None:
        self._spec = spec
        self._report = CachedMesh(str(spec.path))
        self._channels: dict[str, Samples] = {}

    def add(self, block: PointBlock) -> None:
        """Write a block of frames."""
        self._report.add(block)
        for name, rows in (
            ("points", block.points),
            ("extent", block.extents),
            ("normals", block.normals),
            ("velocities", block.velocities),
        ):
            if rows is not None:
                self._channel(name).add(block.codes, rows)
                self._report.bytes += rows.nbytes

    def _channel(self, name: str) -> Samples:
        if name not in self._channels:
            self._channels[name] = empty_attribute(self._spec, name)
        return self._channels[name]

    def release(self) -> None:
        """Sample everything, whether it changes or not."""
        for channel in self._channels.values():
            channel.release()

    def rest(self) -> None:
        """Write defaults of what has samples, but for velocities: a mesh at no time."""
        for name, channel in self._channels.items():
            if name != "velocities":
                channel.rest()

    def finish(self, *, rest: bool) -> CachedMesh:
        """Write the defaults of what never changed; return what there is now.

        Args:
            rest: Whether what has samples has a default too; a rig has its own.
        """
        report, channels = self._report, self._channels
        velocities = channels.pop("velocities", None)
        moves = bool(channels) and channels["points"].sampled
        if velocities is not None:
            if moves:
                # UsdGeomPointBased uses them beside points of the same times only.
                velocities.release()
                channels["velocities"] = velocities
            else:
                _remove(self._spec, "velocities")
        if rest:
            self.rest()
        nothing = np.zeros((0, 3), np.float32)
        for channel in channels.values():
            channel.finish(nothing)
        report.sampled = [name for name, made in channels.items() if made.sampled]
        if not moves:
            report.samples = report.bytes = 0
        return report


def empty_attribute(spec: Any, name: str) -> Samples:
    """Return an attribute without value in place of what a mesh at rest has."""
    _remove(spec, name)
    kinds = {
        "points": _TYPES.Point3fArray,
        "extent": _TYPES.Float3Array,
        "normals": _TYPES.Normal3fArray,
        "velocities": _TYPES.Vector3fArray,
    }
    interpolation = "vertex" if name == "normals" else ""
    return Samples(
        spec, name, kinds[name], Vt.Vec3fArray.FromNumpy, interpolation=interpolation
    )


def _remove(spec: Any, name: str) -> None:
    if name in spec.attributes:
        spec.RemoveProperty(spec.attributes[name])
