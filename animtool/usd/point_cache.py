"""Authoring deformed points as point caches: a stage of meshes, or overs on a rig."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pxr import Sdf

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
from animtool.usd.point_based import BlockWriter, CachedMesh, PointBlock, PointSpace
from animtool.usd.strands import author_strands, strand_paths

if TYPE_CHECKING:
    from animtool.usd.cache_target import CacheTarget


@dataclass(frozen=True, slots=True)
class CacheJob:
    """What `author_cache` needs beside the blocks."""

    output: Path | None  # the file; None is usda for stdout
    paths: RigPaths
    meshes: tuple[str, ...]  # prims of meshes, then of strands, as blocks count them
    fps: Fraction  # time codes a second
    frames: tuple[Fraction, Fraction] | None  # first and last; None takes the samples'
    meters_per_unit: float  # of the layer [m]
    up: UpAxis  # of a stage
    surfaces: tuple[Surface, ...] = ()  # of a stage
    strands: tuple[Strands, ...] = ()  # of a stage
    # Of a layer, whether blocks have those of meshes that have them; False blocks the
    # rig's.
    normals: bool = True
    target: CacheTarget | None = None  # of a layer, the rig; None is a stage
    shot: Shot | None = None  # that is written


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
        writers = [BlockWriter(specs[path]) for path in job.meshes]
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
