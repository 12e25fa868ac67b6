"""A character whose meshes and strands are written as points."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, FormatError
from animtool.core.record import dataclass
from animtool.core.units import up_from_up
from animtool.motion.motion import Motion, TimedBlocks, split_blocks
from animtool.rig.kinematics import bind_matrices
from animtool.rig.mesh_sizes import mesh_size_warnings
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import (
    Strands,
    Surface,
    rotate_unskinned,
    strands_of,
    surfaces_of,
)
from animtool.scene.bake.frames import TakePlan
from animtool.scene.sources.open import is_usd
from animtool.skin.character import CharacterMesh, character_meshes, character_strands

if TYPE_CHECKING:
    from animtool.usd.rigs.joint_map import RigJointMap
    from animtool.usd.rigs.target import RigTarget

# Frames per piece of a motion; 60 joints take 1.5 MB.
CHUNK_FRAMES = 256


@dataclass(frozen=True, slots=True)
class DeformedCharacter:
    """Meshes and strands that a bake deforms, with the rig that moves them."""

    rig: Rig  # the joints that carry the meshes
    surfaces: tuple[Surface, ...]
    strands: tuple[Strands, ...]  # meshes that follow single joints
    # Maps the take's joints to the rig; None if they are the rig's own.
    joint_map: RigJointMap | None
    meshes: tuple[CharacterMesh, ...]  # deformable meshes, then strands
    origin: str  # source of the meshes, for reports

    def with_meshes(
        self, surfaces: Sequence[str], strands: Sequence[str]
    ) -> DeformedCharacter:
        """Return a copy with only the named surfaces and strands, in the same order."""
        is_selected = [mesh.name in surfaces for mesh in self.surfaces]
        is_selected += [mesh.name in strands for mesh in self.strands]
        return replace(
            self,
            surfaces=tuple(mesh for mesh in self.surfaces if mesh.name in surfaces),
            strands=tuple(mesh for mesh in self.strands if mesh.name in strands),
            meshes=tuple(itertools.compress(self.meshes, is_selected)),
        )


def open_character(take: TakePlan, target: RigTarget | None) -> DeformedCharacter:
    """Return the meshes and strands that a take deforms.

    The meshes and strands are from the take's rig if it has meshes, else from the rig
    layer, else from the USD file that the take was read from.
    """
    source, joint_map, options = take.source, take.joint_map, take.options
    rig = take.stream.rig
    shapes = tuple(shape.name for shape in rig.shapes)
    if rig.meshes or (target is None and not is_usd(source)):
        surfaces, strands, bind = surfaces_of(rig), strands_of(rig), bind_matrices(rig)
        source_label, joint_map = f"rig {rig.name!r} of the take", None
    else:
        from animtool.usd.rigs.mesh_read import read_source_meshes, read_target_meshes

        if target is not None:
            assert joint_map is not None
            shapes = joint_map.shapes
            rig, source_label = target.skeleton.rig, str(target.path)
            stage_meshes = read_target_meshes(target)
        else:
            source_label = str(source)
            prim_path = options.source.prim_path
            stage_meshes = read_source_meshes(source, prim_path, options.placement)
        take.notices.extend(stage_meshes.notices)
        rotation = up_from_up(rig.up, stage_meshes.up)
        surfaces = rotate_unskinned(stage_meshes.surfaces, rotation)
        strands, bind = stage_meshes.strands, stage_meshes.bind
    if all(notice.code != "RIG218" for notice in take.stream.notices):
        take.notices.extend(mesh_size_warnings(rig, surfaces))
    if options.normals is False:
        surfaces = tuple(replace(surface, normals=None) for surface in surfaces)
    if not surfaces and not strands:
        message = "there is no mesh to deform"
        hint = f"use a rig with meshes: in the clip, or with {argument('source.rig')} "
        hint += f"or {argument('rig_layer')}"
        raise FormatError(Fault("USD040", message, str(source), (), hint))
    meshes = character_meshes(surfaces, rig.names, bind, shapes)
    meshes += character_strands(strands, rig.names, bind)
    character_parts = (surfaces, strands, joint_map, tuple(meshes))
    return DeformedCharacter(rig, *character_parts, source_label)


def motion_chunks(
    blocks: TimedBlocks, *, includes_neighbour_frames: bool
) -> Iterator[tuple[FloatArray, Motion, slice]]:
    """Yield a motion in short chunks, each with the slice of the frames to write.

    With ``includes_neighbour_frames``, chunks include the frame on either side.
    """
    previous_frame: tuple[FloatArray, Motion] | None = None
    chunk_iterator = split_blocks(blocks, CHUNK_FRAMES)
    chunk = next(chunk_iterator, None)
    while chunk is not None:
        next_chunk = next(chunk_iterator, None)
        codes, motion = chunk
        chunks = [chunk]
        if includes_neighbour_frames and previous_frame is not None:
            chunks.insert(0, previous_frame)
        if includes_neighbour_frames and next_chunk is not None:
            chunks.append((next_chunk[0][:1], next_chunk[1].select(slice(0, 1))))
        if len(chunks) > 1:
            codes = np.concatenate([codes for codes, _ in chunks])
            motion = Motion.concatenate([motion for _, motion in chunks])
        lead_count = (
            1 if includes_neighbour_frames and previous_frame is not None else 0
        )
        yield codes, motion, slice(lead_count, lead_count + len(chunk[0]))
        previous_frame = chunk[0][-1:], chunk[1].select(slice(-1, None))
        chunk = next_chunk
