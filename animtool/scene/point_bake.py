"""Running a bake whose output is point caches."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from animtool._types import FloatArray
from animtool.errors import Fault, FormatError, refuse_warnings
from animtool.prefetch import prefetch
from animtool.rig.kinematics import rest_size
from animtool.scene.deform import Character, PointStream
from animtool.scene.frames import timed_blocks
from animtool.scene.plan import BakePlan
from animtool.scene.report import BakeReport, MeshReport, TakeReport
from animtool.take import Motion
from animtool.usd.animation import Rounding
from animtool.usd.beside import Beside, author_things, thing_places
from animtool.usd.jobs import UsdResult, WrittenTake
from animtool.usd.layers import save_layer
from animtool.usd.names import legal_name
from animtool.usd.paths import RigPaths
from animtool.usd.point_cache import (
    CachedMesh,
    CacheJob,
    author_cache,
    mesh_paths,
)
from animtool.usd.point_chunks import write_chunks
from animtool.usd.point_space import PointSpace
from animtool.usd.strands import WIDTH

__all__ = ["run_point_bake"]


class _Frames:
    """Counts frames of a source and samples of an output as they pass."""

    def __init__(self) -> None:
        self.source = self.samples = 0

    def of_source(self, blocks: Iterator[Motion]) -> Iterator[Motion]:
        for block in blocks:
            self.source += block.frames
            yield block

    def of_output(
        self, blocks: Iterator[tuple[FloatArray, Motion]]
    ) -> Iterator[tuple[FloatArray, Motion]]:
        for codes, motion in blocks:
            self.samples += len(codes)
            yield codes, motion


def run_point_bake(plan: BakePlan, character: Character) -> BakeReport:
    """Run a planned bake of point caches: read, deform, author, write.

    Raises:
        FormatError: The rows of the source are malformed, or meshes do not fit those
            of the rig layer.
        OptionError: The range has no frame of the take.
        OutputError: The output cannot be written.
        StrictError: There were warnings, and ``strict`` is on.
    """
    began = time.perf_counter()
    take = plan.takes[0]
    stream, frames = take.stream, _Frames()
    counted = replace(stream, blocks=frames.of_source(stream.blocks))
    timed, span, _ = timed_blocks(take, counted)
    job, character, spaces = _job(plan, character, span)
    beside = Beside(stream.tracks)
    if stream.tracks:
        timed = beside.watched(timed)
    things: list[str] = []
    points = PointStream(
        character,
        job.meters_per_unit,
        float(plan.fps),
        spaces,
        plan.options.velocities,
    )

    def check(layer: Any) -> None:
        if stream.tracks:
            places = thing_places(
                job.paths, plan.target, None, job.meters_per_unit, character.rig.up
            )
            found, said = author_things(layer, beside, places, plan.output)
            things.extend(found)
            plan.notices.extend(said)
        refuse_warnings(stream.notices + plan.notices, strict=plan.options.strict)

    ahead = prefetch(points.blocks(frames.of_output(timed)))
    try:
        if plan.options.chunk is not None:
            outputs, written, layer = write_chunks(
                job, ahead, plan.options.chunk, check
            )
        else:
            layer, written = author_cache(job, ahead)
            check(layer)
            outputs = [] if plan.output is None else [plan.output]
    finally:
        ahead.close()
    seconds = {"read": sum(points.seconds), "author": time.perf_counter() - began}
    if plan.options.chunk is None:
        size = save_layer(layer, plan.output)
    else:
        size = sum(path.stat().st_size for path in outputs)
    result = _result(job, layer, written, frames.samples, outputs, size)
    result.takes[0].things = things
    seconds["total"] = time.perf_counter() - began
    seconds["save"] = seconds["total"] - seconds["author"]
    surfaces = len(character.surfaces)
    kinds = ["mesh"] * surfaces + ["strands"] * (len(character.meshes) - surfaces)
    report = TakeReport(
        take.source,
        result.takes[0],
        stream.count or frames.source,
        stream.fps / stream.step,
        "",
        plan.options.source.unit is None and "units" not in stream.details,
        take.source.stat().st_size,
        stream.details,
        meshes=[
            MeshReport(mesh.name, made, spent, frames.samples, kind)
            for mesh, made, spent, kind in zip(
                character.meshes, written, points.seconds, kinds, strict=True
            )
        ],
        meshes_of=character.origin,
        simulated=stream.simulated,
    )
    return BakeReport(
        [report],
        result,
        f"point caches as a {plan.form} ({plan.reason})",
        plan.fps,
        len(stream.rig.joints),
        job.meters_per_unit,
        job.up.value,
        rest_size(character.rig),
        stream.notices + plan.notices,
        seconds,
    )


def _job(
    plan: BakePlan, character: Character, span: tuple[Fraction, Fraction] | None
) -> tuple[CacheJob, Character, Sequence[PointSpace]]:
    """Return what the writer is to do, with which meshes, and where these stand."""
    options, rig = plan.options, plan.takes[0].stream.rig
    if plan.target is not None:
        return _layer_job(plan, character, span)
    model = options.prim_path or f"/{legal_name(rig.name)}"
    paths = RigPaths.below(model)
    unit = rig.meters_per_unit if options.to_units is None else options.to_units.meters
    job = CacheJob(
        plan.output,
        paths,
        mesh_paths(character.surfaces, character.strands, paths),
        plan.fps,
        span,
        unit,
        rig.up,
        character.surfaces,
        character.strands,
    )
    spaces = [PointSpace()] * len(character.surfaces)
    spaces += [PointSpace(margin=WIDTH / unit / 2)] * len(character.strands)
    return job, character, spaces


def _layer_job(
    plan: BakePlan, character: Character, span: tuple[Fraction, Fraction] | None
) -> tuple[CacheJob, Character, Sequence[PointSpace]]:
    from animtool.usd.cache_target import open_cache_target

    assert plan.target is not None
    # A mesh that follows nothing stays as the rig has it.
    wanted = {
        surface.name: len(surface.points)
        for surface in character.surfaces
        if surface.skin is not None or surface.shapes
    }
    strands = {entry.name: entry.points.shape[:2] for entry in character.strands}
    target = open_cache_target(plan.target, wanted, strands)
    plan.notices.extend(target.notices)
    if not target.prims:
        message = "no mesh of the take is in the rig layer"
        where = str(plan.target.path)
        raise FormatError(Fault("USD040", message, where, (), "nothing would deform"))
    job = CacheJob(
        plan.output,
        plan.target.paths,
        tuple(part.path for part in target.prims),
        plan.fps,
        span,
        plan.target.skeleton.rig.meters_per_unit,
        plan.target.up,
        normals=plan.options.normals is not False,
        target=target,
    )
    character = character.only(
        [mesh.name for mesh in target.meshes], [part.name for part in target.strands]
    )
    return job, character, [part.space for part in target.prims]


def _result(
    job: CacheJob,
    layer: Any,
    written: list[CachedMesh],
    samples: int,
    outputs: list[Path],
    size: int,
) -> UsdResult:
    first, last = job.frames or (layer.startTimeCode, layer.endTimeCode)
    worst = max(written, key=lambda mesh: mesh.error)
    sampled = [name for mesh in written for name in mesh.sampled]
    take = WrittenTake(
        "",
        samples=samples,
        first=Fraction(first),
        last=Fraction(last),
        sampled=list(dict.fromkeys(sampled)),
        rounding=Rounding(worst.error, worst.error_code),
    )
    return UsdResult(outputs, size, [take])
