"""Meshes and strands of a take as point caches, frame by frame."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import field
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, FormatError
from animtool.core.files.output import written_size
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.motion.motion import Channel, TimedBlocks
from animtool.rig.kinematics import WorldTransforms, rest_size
from animtool.scene.bake.deformed_character import DeformedCharacter, motion_chunks
from animtool.scene.bake.frames import BakedTake
from animtool.scene.bake.prims import (
    BakePlan,
    BakeState,
    MeshReport,
    SaveLayer,
    take_report,
    write_single_file,
)
from animtool.scene.bake.progress import prefetch
from animtool.skin.character import CharacterMesh
from animtool.skin.deform import (
    DeformedFrames,
    block_frames,
    deform,
    deform_blocks,
    replace_points,
)
from animtool.usd.caches.point_cache import (
    CacheJob,
    ChunkedCache,
    author_cache,
    mesh_paths,
    round_points,
    write_chunks,
)
from animtool.usd.caches.writer import CachedMesh, FrameBlock, PointSpace
from animtool.usd.layers.jobs import RoundingError, UsdResult, WrittenTake
from animtool.usd.layers.sdf import layer_span
from animtool.usd.props.placement import build_prop_placements
from animtool.usd.props.writer import author_props
from animtool.usd.rigs.skeleton import STRAND_WIDTH


@dataclass
class PointStream:
    """Computes the deformed points of a character block by block."""

    character: DeformedCharacter
    meters_per_unit: float  # unit of the output [m]
    rate: float  # time codes a second
    spaces: Sequence[PointSpace]  # space in which each mesh is written
    has_velocities: bool = False  # whether to compute velocities
    # Time spent on each mesh so far, without joints [s].
    seconds: list[float] = field(default_factory=list)

    def blocks(self, timed_blocks: TimedBlocks) -> Iterator[FrameBlock]:
        """Yield blocks of frames of all meshes, in time order."""
        character = self.character
        self.seconds = [0.0] * len(character.meshes)
        for codes, motion, written_frames in motion_chunks(
            timed_blocks, includes_neighbour_frames=self.has_velocities
        ):
            mapped_motion = motion
            if character.joint_map is not None:
                mapped_motion = character.joint_map.map_placed_motion(codes, motion)
            world = mapped_motion.world(character.rig)
            weights = None if motion.weights is None else motion.weights.dense()[..., 0]
            for i, mesh in enumerate(character.meshes):
                frames = self._deform_frames(mesh, codes, mesh.weights(weights), world)
                if mesh.name in mapped_motion.points:
                    points = mapped_motion.points[mesh.name]
                    frames = self._displaced_frames(i, frames, codes, points)
                yield from self._float32_blocks(i, codes, frames, written_frames)

    def _displaced_frames(
        self,
        mesh_index: int,
        deformed_blocks: Iterator[DeformedFrames],
        codes: FloatArray,
        points: Channel,
    ) -> Iterator[DeformedFrames]:
        """Yield frames of a mesh with its points replaced by displaced ones."""
        surfaces = self.character.surfaces
        surface = surfaces[mesh_index] if mesh_index < len(surfaces) else None
        times = codes / self.rate if self.has_velocities else None
        frames_done = 0
        for deformed_block in deformed_blocks:
            frames = slice(frames_done, frames_done + len(deformed_block.points))
            yield replace_points(deformed_block, points, frames, surface, times)
            frames_done = frames.stop

    def _float32_blocks(
        self,
        mesh_index: int,
        codes: FloatArray,
        deformed_blocks: Iterator[DeformedFrames],
        written_frames: slice,
    ) -> Iterator[FrameBlock]:
        """Yield float32 blocks of the frames to write, without neighbouring frames."""
        frames_done = 0
        start_time = time.perf_counter()
        for deformed_block in deformed_blocks:
            first = max(written_frames.start - frames_done, 0)
            last = max(written_frames.stop - frames_done, 0)
            written_block = deformed_block.select(slice(first, last))
            begin = frames_done + first
            block_codes = codes[begin : begin + len(written_block.points)]
            frames_done += len(deformed_block.points)
            if not len(block_codes):
                continue
            space = (self.meters_per_unit, self.spaces[mesh_index])
            block = round_points(mesh_index, block_codes, written_block, *space)
            self.seconds[mesh_index] += time.perf_counter() - start_time
            yield block
            start_time = time.perf_counter()
        self.seconds[mesh_index] += time.perf_counter() - start_time

    def _deform_frames(
        self,
        mesh: CharacterMesh,
        codes: FloatArray,
        weights: FloatArray | None,
        world: WorldTransforms,
    ) -> Iterator[DeformedFrames]:
        """Yield blocks of the deformed frames of a mesh."""
        deformed_mesh = mesh.mesh
        times = codes / self.rate if self.has_velocities else None
        has_normals = deformed_mesh.normals is not None
        if not _is_static(mesh, weights, world):
            return deform_blocks(
                deformed_mesh, weights, world, normals=has_normals, times=times
            )
        # One frame represents all of them, at no further cost.
        weights = None if weights is None else weights[:1]
        world = WorldTransforms(world.positions[:1], world.linear[:1])
        times = None if times is None else times[:1]
        first_frame = deform(
            deformed_mesh, weights, world, normals=has_normals, times=times
        )
        return _repeat_first_frame(first_frame, len(codes))


def _is_static(
    mesh: CharacterMesh, weights: FloatArray | None, world: WorldTransforms
) -> bool:
    """Return whether a mesh has the same points in every frame."""
    if weights is not None and (weights != weights[:1]).any():
        return False
    skin = mesh.mesh.skin
    if skin is None:
        return True
    return all(
        bool((values == values[:1]).all())
        for values in (world.positions[:, skin.joints], world.linear[:, skin.joints])
    )


def _repeat_first_frame(
    frame: DeformedFrames, frame_count: int
) -> Iterator[DeformedFrames]:
    """Yield a number of frames in blocks, all equal to a single frame."""
    block_size = block_frames(frame.points.shape[1])

    def repeat(values: FloatArray | None, count: int) -> Any:
        return None if values is None else np.repeat(values, count, axis=0)

    for begin in range(0, frame_count, block_size):
        count = min(block_size, frame_count - begin)
        names = ("points", "extents", "normals", "velocities")
        yield DeformedFrames(*(repeat(getattr(frame, name), count) for name in names))


@dataclass(frozen=True, slots=True)
class PointPrims:
    """Prims of the deformed meshes and strands of a character."""

    character: DeformedCharacter

    def author(self, state: BakeState) -> None:
        """Author the prims; if chunks are requested, also write the chunk files."""
        plan, (baked_take,) = state.plan, state.baked_takes
        stream, sampled_take = baked_take.plan.stream, baked_take.open()
        job, character, spaces = _cache_job(
            plan, self.character, sampled_take.first_and_last
        )
        unit, velocities = job.meters_per_unit, plan.options.velocities
        point_stream = PointStream(character, unit, float(plan.fps), spaces, velocities)
        with closing(prefetch(point_stream.blocks(sampled_take.blocks))) as blocks:
            if plan.options.chunk is None:
                layer, meshes = author_cache(job, blocks)
                result = _usd_result(layer, meshes, baked_take)
                state.write_files = partial(
                    write_single_file, layer, plan.output, result
                )
            else:
                cache = write_chunks(job, blocks, plan.options.chunk)
                layer, meshes = cache.layer, cache.reports
                result = _usd_result(layer, meshes, baked_take)
                state.write_files = partial(_write_chunk_files, cache, result)
        state.layer = layer
        if baked_take.props is not None:
            up = character.rig.up
            result.takes[0].props = _author_props(layer, plan, job, baked_take, up)
        state.read_seconds += point_stream.seconds
        surface_count = len(character.surfaces)
        kinds = ["mesh"] * surface_count + ["strands"] * (
            len(character.meshes) - surface_count
        )
        reports = [
            MeshReport(
                mesh.name,
                prim,
                seconds,
                baked_take.sample_count,
                kind,
                of=character.origin,
            )
            for mesh, prim, seconds, kind in zip(
                character.meshes, meshes, point_stream.seconds, kinds, strict=True
            )
        ]
        state.report = plan.report(
            [take_report(baked_take, result.takes[0], "", reports)],
            result,
            stream.notices + plan.notices,
            joints=len(stream.rig.joints),
            size=rest_size(character.rig),
            meters_per_unit=job.meters_per_unit,
            up=job.up,
            form_name="point caches as a ",
        )


def _write_chunk_files(cache: ChunkedCache, result: UsdResult, save: SaveLayer) -> None:
    """Write the manifest of the chunks, and the layer that refers to them."""
    result.outputs += cache.finish(save)
    result.bytes = sum(map(written_size, result.outputs))


def _author_props(
    layer: Any, plan: BakePlan, job: CacheJob, baked_take: BakedTake, up: UpAxis
) -> list[str]:
    """Author the props of the take in a layer and return their prim paths."""
    assert baked_take.props is not None
    joint_map = plan.takes[0].joint_map
    placements = build_prop_placements(
        job.paths,
        plan.target,
        None,
        job.meters_per_unit,
        up,
        rig_from_take=None if joint_map is None else joint_map.rig_from_take,
    )
    props, notices = author_props(layer, baked_take.props, placements, plan.output)
    plan.notices.extend(notices)
    return props


def _cache_job(
    plan: BakePlan, character: DeformedCharacter, span: tuple[Fraction, Fraction] | None
) -> tuple[CacheJob, DeformedCharacter, Sequence[PointSpace]]:
    """Return the writer's settings, the character, and the space of each mesh."""
    if plan.target is not None:
        return _rig_layer_job(plan, character, span)
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
    spaces += [PointSpace(margin=STRAND_WIDTH / unit / 2)] * len(character.strands)
    return job, character, spaces


def _rig_layer_job(
    plan: BakePlan, character: DeformedCharacter, span: tuple[Fraction, Fraction] | None
) -> tuple[CacheJob, DeformedCharacter, Sequence[PointSpace]]:
    """Return the settings for a layer over a rig, with only meshes that it has."""
    from animtool.usd.caches.target import open_cache_target

    assert plan.target is not None
    # A mesh without joints stays where the rig has it.
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
        location = (str(plan.target.path), ())
        raise FormatError(Fault("USD040", message, *location, "nothing would deform"))
    job = CacheJob(
        plan.output,
        plan.target.paths,
        tuple(prim.path for prim in target.prims),
        plan.fps,
        span,
        plan.meters_per_unit,
        plan.target.up,
        has_normals=plan.options.normals is not False,
        target=target,
        shot=plan.options.shot,
    )
    names = ([prim.name for prim in prims] for prims in (target.meshes, target.strands))
    return job, character.with_meshes(*names), [prim.space for prim in target.prims]


def _usd_result(
    layer: Any, meshes: Sequence[CachedMesh], baked_take: BakedTake
) -> UsdResult:
    """Return the span, samples and rounding of a layer of point caches."""
    span = layer_span(layer)
    worst_mesh = max(meshes, key=lambda mesh: mesh.error)
    take = WrittenTake(
        "",
        span,
        samples=baked_take.sample_count,
        sampled=list(dict.fromkeys(name for mesh in meshes for name in mesh.sampled)),
        rounding=RoundingError(worst_mesh.error, worst_mesh.error_code),
    )
    return UsdResult(span, takes=[take])
