"""Running a bake whose output is point caches."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from animtool._types import FloatArray
from animtool.errors import Fault, FormatError, refuse_warnings
from animtool.motion import Motion
from animtool.output import size_of, together
from animtool.prefetch import prefetch
from animtool.rig.kinematics import rest_size
from animtool.scene.deform import Character, PointStream
from animtool.scene.frames import TimedTake, timed_blocks
from animtool.scene.plan import BakePlan
from animtool.scene.progress import Progress, share_of
from animtool.scene.report import BakeReport, MeshReport, TakeReport
from animtool.scene.sources import motion_bytes
from animtool.units import UpAxis
from animtool.usd.animation import Rounding
from animtool.usd.author_props import PropSamples, author_props, prop_placements
from animtool.usd.jobs import UsdResult, WrittenTake, layer_span
from animtool.usd.names import legal_name
from animtool.usd.paths import RigPaths
from animtool.usd.point_cache import (
    CachedMesh,
    CacheJob,
    PointBlock,
    author_cache,
    mesh_paths,
)
from animtool.usd.point_chunks import write_chunks
from animtool.usd.point_space import PointSpace
from animtool.usd.strands import WIDTH

if TYPE_CHECKING:
    from animtool.scene.systems.run import Save
    from animtool.scene.systems.with_take import WrittenSystems


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


def run_point_bake(
    plan: BakePlan, character: Character, *, progress: Progress = None
) -> BakeReport:
    """Run a planned bake of point caches: read, deform, author, write.

    Args:
        plan: Of the bake.
        character: What is deformed.
        progress: Called with the share done, 0 to 1, of what comes after the take.

    Raises:
        FormatError: The rows of the source are malformed, or meshes do not fit those
            of the rig layer.
        OptionError: The range has no frame of the take.
        OutputError: The output cannot be written.
        StrictError: There were warnings, and ``strict`` is on.
    """
    began = time.perf_counter()
    stream, frames = plan.takes[0].stream, _Frames()
    opened = _timed(plan, frames)
    timed = opened.blocks
    job, character, spaces = _job(plan, character, opened.frames)
    prop_samples = PropSamples(stream.tracks)
    if stream.tracks:
        timed = prop_samples.watched(timed)
    props: list[str] = []
    points = PointStream(
        character,
        job.meters_per_unit,
        float(plan.fps),
        spaces,
        plan.options.velocities,
    )

    def check(layer: Any) -> None:
        if stream.tracks:
            props.extend(
                _author_props(layer, plan, job, prop_samples, character.rig.up)
            )
        refuse_warnings(stream.notices + plan.notices, strict=plan.options.strict)

    ahead = prefetch(points.blocks(frames.of_output(timed)))
    with closing(ahead):
        made = _write(plan, job, ahead, check, progress)
    authored = made.authored - began
    seconds = {"read": sum(points.seconds), "author": authored}
    result = _result(made, frames.samples)
    result.takes[0].props = props
    seconds["total"] = time.perf_counter() - began
    seconds["save"] = seconds["total"] - seconds["author"]
    report = _take_report(plan, character, result.takes[0], made.meshes, points, frames)
    report.between = 0 if opened.times is None else opened.times.between
    notices = stream.notices + plan.notices
    if made.systems is not None:
        report.meshes += made.systems.reports
        report.simulated = report.simulated + made.systems.simulated
        notices += made.systems.notices
    return BakeReport(
        [report],
        result,
        f"point caches as a {plan.form} ({plan.reason})",
        len(stream.rig.joints),
        job.meters_per_unit,
        job.up.value,
        rest_size(character.rig),
        notices,
        seconds,
        plan.options.shot,
    )


def _timed(plan: BakePlan, frames: _Frames) -> TimedTake:
    """Return what is to be written with its time codes."""
    take = plan.takes[0]
    stream = replace(take.stream, blocks=frames.of_source(take.stream.blocks))
    if plan.with_take is None:
        return timed_blocks(take, stream)
    timed = timed_blocks(take, plan.with_take.watch.read(stream))
    return replace(timed, blocks=plan.with_take.watch.written(timed.blocks))


def _author_props(
    layer: Any, plan: BakePlan, job: CacheJob, prop_samples: PropSamples, up: UpAxis
) -> list[str]:
    """Write things beside the character to a layer; return their prims."""
    places = prop_placements(job.paths, plan.target, None, job.meters_per_unit, up)
    props, notices = author_props(layer, prop_samples, places, plan.output)
    plan.notices.extend(notices)
    return props


def _take_report(
    plan: BakePlan,
    character: Character,
    take_written: WrittenTake,
    written: Sequence[CachedMesh],
    points: PointStream,
    frames: _Frames,
) -> TakeReport:
    """Return what became of the take and of each of its meshes."""
    take = plan.takes[0]
    stream = take.stream
    surfaces = len(character.surfaces)
    kinds = ["mesh"] * surfaces + ["strands"] * (len(character.meshes) - surfaces)
    return TakeReport(
        take.source,
        take_written,
        stream.count or frames.source,
        stream.fps / stream.step,
        "",
        plan.options.source.unit is None and "units" not in stream.details,
        motion_bytes(take.source),
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


@dataclass(frozen=True, slots=True)
class _Written:
    """What was written.

    Attributes:
        layer: The one that has the rest, or joins it.
        meshes: Of each mesh.
        systems: Beside the take.
        outputs: The files.
        size: Of all [byte].
        authored: When all but the systems and the layer was.
    """

    layer: Any
    meshes: list[CachedMesh]
    systems: WrittenSystems | None
    outputs: list[Path]
    size: int
    authored: float


def _write(
    plan: BakePlan,
    job: CacheJob,
    blocks: Iterator[PointBlock],
    check: Callable[[Any], None],
    progress: Progress,
) -> _Written:
    """Write a cache, in one file or in several, and what is simulated beside it."""
    systems: list[WrittenSystems | None] = []
    sizes: list[int] = []
    times: list[float] = []

    def finish(layer: Any, *, whole: bool) -> None:
        check(layer)
        times.append(time.perf_counter())

        def write(save: Save) -> None:
            # One that joins chunks is written with them.
            if whole:
                sizes.append(save(layer, plan.output))

        systems.append(plan.finish(layer, write, share_of(progress, 1, 2)))

    with together():
        if plan.options.chunk is None:
            layer, meshes = author_cache(job, blocks)
            finish(layer, whole=True)
            outputs = [] if plan.output is None else [plan.output]
        else:
            outputs, meshes, layer = write_chunks(
                job, blocks, plan.options.chunk, partial(finish, whole=False)
            )
    (prop_samples,) = systems
    outputs = ([] if prop_samples is None else prop_samples.files) + outputs
    size = sum(map(size_of, outputs)) or sum(sizes)
    return _Written(layer, meshes, prop_samples, outputs, size, times[0])


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
        shot=options.shot,
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
        shot=plan.options.shot,
    )
    character = character.only(
        [mesh.name for mesh in target.meshes], [part.name for part in target.strands]
    )
    return job, character, [part.space for part in target.prims]


def _result(made: _Written, samples: int) -> UsdResult:
    span = layer_span(made.layer)
    worst = max(made.meshes, key=lambda mesh: mesh.error)
    sampled = [name for mesh in made.meshes for name in mesh.sampled]
    take = WrittenTake(
        "",
        samples=samples,
        first=span.first,
        last=span.last,
        sampled=list(dict.fromkeys(sampled)),
        rounding=Rounding(worst.error, worst.error_code),
    )
    return UsdResult(span, made.outputs, made.size, [take])
