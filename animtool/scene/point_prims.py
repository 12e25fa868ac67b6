"""Deformed meshes and strands of a take, as point caches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from animtool.errors import Fault, FormatError
from animtool.output import size_of
from animtool.rig.kinematics import rest_size
from animtool.scene.deform import Character, PointStream
from animtool.scene.prims import BakePlan, BakeReport, Draft, MeshReport, Save, TakeRun
from animtool.signals import prefetch
from animtool.units import UpAxis
from animtool.usd.author_props import author_props, prop_placements
from animtool.usd.jobs import Rounding, UsdResult, WrittenTake
from animtool.usd.layers import layer_span
from animtool.usd.meshes import WIDTH
from animtool.usd.point_based import CachedMesh, PointSpace
from animtool.usd.point_cache import CacheJob, author_cache, mesh_paths, write_chunks


@dataclass(frozen=True, slots=True)
class PointPrims:
    """Meshes and strands of a character that the bake deforms."""

    character: Character

    def author(self, draft: Draft) -> Callable[[], None]:
        """Author the prims; points in chunks are written already."""
        plan, (run,) = draft.plan, draft.runs
        stream, timed = run.plan.stream, run.open()
        job, character, spaces = _job(plan, self.character, timed.frames)
        points = PointStream(
            character,
            job.meters_per_unit,
            float(plan.fps),
            spaces,
            plan.options.velocities,
        )
        with closing(prefetch(points.blocks(timed.blocks))) as blocks:
            if plan.options.chunk is None:
                layer, meshes = author_cache(job, blocks)
                result = _result(layer, meshes, run)

                def write(save: Save) -> None:
                    result.bytes = save(layer, plan.output)
                    result.outputs += [] if plan.output is None else [plan.output]
            else:
                written = write_chunks(job, blocks, plan.options.chunk)
                layer, meshes = written.layer, written.reports
                result = _result(layer, meshes, run)

                def write(save: Save) -> None:
                    result.outputs += written.finish(save)
                    result.bytes = sum(map(size_of, result.outputs))

        if run.props is not None:
            result.takes[0].props = _author_props(
                layer, plan, job, run, character.rig.up
            )
        draft.layer, draft.write = layer, write
        draft.read += points.seconds
        surfaces = len(character.surfaces)
        kinds = ["mesh"] * surfaces + ["strands"] * (len(character.meshes) - surfaces)
        reports = [
            MeshReport(mesh.name, report, spent, run.samples, kind)
            for mesh, report, spent, kind in zip(
                character.meshes, meshes, points.seconds, kinds, strict=True
            )
        ]
        draft.report = BakeReport(
            [run.report(result.takes[0], "", reports, character.origin)],
            result,
            f"point caches as a {plan.form} ({plan.reason})",
            len(stream.rig.joints),
            job.meters_per_unit,
            job.up.value,
            rest_size(character.rig),
            stream.notices + plan.notices,
            shot=plan.options.shot,
        )
        return lambda: None


def _author_props(
    layer: Any, plan: BakePlan, job: CacheJob, run: TakeRun, up: UpAxis
) -> list[str]:
    """Write props of the take to a layer; return their prims."""
    assert run.props is not None
    places = prop_placements(job.paths, plan.target, None, job.meters_per_unit, up)
    props, notices = author_props(layer, run.props, places, plan.output)
    plan.notices.extend(notices)
    return props


def _job(
    plan: BakePlan, character: Character, span: tuple[Fraction, Fraction] | None
) -> tuple[CacheJob, Character, Sequence[PointSpace]]:
    """Return what the writer is to do, with which meshes, and where these stand."""
    if plan.target is not None:
        return _layer_job(plan, character, span)
    paths, unit = plan.paths, plan.meters_per_unit
    job = CacheJob(
        plan.output,
        paths,
        mesh_paths(character.surfaces, character.strands, paths),
        plan.fps,
        span,
        unit,
        plan.rig.up,
        character.surfaces,
        character.strands,
        shot=plan.options.shot,
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
    paths = {
        surface.name: len(surface.points)
        for surface in character.surfaces
        if surface.skin is not None or surface.shapes
    }
    strands = {entry.name: entry.points.shape[:2] for entry in character.strands}
    target = open_cache_target(plan.target, paths, strands)
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
        plan.meters_per_unit,
        plan.target.up,
        normals=plan.options.normals is not False,
        target=target,
        shot=plan.options.shot,
    )
    character = character.only(
        [mesh.name for mesh in target.meshes], [part.name for part in target.strands]
    )
    return job, character, [part.space for part in target.prims]


def _result(layer: Any, meshes: Sequence[CachedMesh], run: TakeRun) -> UsdResult:
    span = layer_span(layer)
    worst = max(meshes, key=lambda mesh: mesh.error)
    sampled = [name for mesh in meshes for name in mesh.sampled]
    take = WrittenTake(
        "",
        samples=run.samples,
        first=span.first,
        last=span.last,
        sampled=list(dict.fromkeys(sampled)),
        rounding=Rounding(worst.error, worst.error_code),
    )
    return UsdResult(span, takes=[take])
