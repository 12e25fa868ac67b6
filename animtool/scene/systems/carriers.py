"""Carriers of pinned particles: joints, vertices and prims in motion."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.motion.transforms import PropRequest
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import surfaces_of
from animtool.scene.file.entries import EntryLocation
from animtool.scene.systems.character_motion import (
    CharacterMotions,
    CharacterSkin,
    missing_mesh_fault,
)
from animtool.sim.colliders import Poses, joint_poses
from animtool.systems.framework.fields import PlacedModel

# Samples a second of a prim's poses, which are linear between them [1/s].
PRIM_SAMPLE_RATE = 120
# Maximum number of sampled times of a prim.
MAX_PRIM_SAMPLES = 100_000


@dataclass(frozen=True, slots=True)
class JointCarrier:
    """A joint of a character."""

    file: Path  # a clip or a scene
    joint: str
    # Location of the entry that names it.
    location: EntryLocation | None = field(default=None, compare=False, repr=False)

    def fault(self, rig: Rig) -> Fault | None:
        """Return a fault at the key of the joint if the rig lacks it, else None."""
        if self.joint in rig.names:
            return None
        message = f"unknown joint {self.joint!r} of {rig.name!r}"
        hint = rig.joint_hint(self.joint)
        return Fault("SIM053", message, hint=hint, where="joint")

    def poses(self, characters: CharacterMotions) -> Poses:
        """Return the poses of the joint at the frames of its character."""
        character = characters.for_file(self.file)
        _raise_fault(self.fault(character.rig), self.location)
        return joint_poses(
            character.world, character.rig.index(self.joint), character.times
        )


@dataclass(frozen=True, slots=True)
class VertexCarrier:
    """A vertex of a character's mesh."""

    file: Path  # a clip or a scene
    mesh: str
    vertex: int  # index of the vertex
    # Location of the entry that names it.
    location: EntryLocation | None = field(default=None, compare=False, repr=False)

    def fault(self, rig: Rig) -> Fault | None:
        """Return a fault at the key of the vertex if it does not exist, else None."""
        fault = missing_mesh_fault(rig, self.mesh)
        if fault is not None:
            return fault
        (mesh,) = [surface for surface in surfaces_of(rig) if surface.name == self.mesh]
        last = len(mesh.points) - 1
        if self.vertex <= last:
            return None
        message = f"{self.mesh!r} has no vertex {self.vertex}: vertices are 0 to {last}"
        return Fault("SIM053", message, where="vertex")

    def poses(self, characters: CharacterMotions) -> Poses:
        """Return the vertex positions over time, with constant rotation."""
        character = characters.for_file(self.file)
        _raise_fault(self.fault(character.rig), self.location)
        # The next block reuses the buffer of the last one.
        position_blocks = [
            block.points[:, self.vertex].copy()
            for block in CharacterSkin(character, self.mesh).blocks()
        ]
        positions = np.concatenate(position_blocks)
        return _translated_poses(character.times, positions)


def _translated_poses(times: FloatArray, positions: FloatArray) -> Poses:
    """Return unrotated poses at positions ``(N, 3)`` and times ``(N,)`` [s]."""
    return Poses(times, positions, np.tile(so3.IDENTITY, (len(positions), 1)))


def _raise_fault(fault: Fault | None, location: EntryLocation | None) -> None:
    """Raise a fault, located at an entry; do nothing for None."""
    if fault is not None:
        raise OptionError(fault if location is None else location.locate(fault))


@dataclass(frozen=True, slots=True)
class PrimCarrier:
    """A prim of a USD file."""

    file: Path
    prim: str  # path of the prim
    frame: float | None = None  # time code at 0 s; None is the first

    def poses(self, characters: CharacterMotions) -> Poses:  # noqa: ARG002
        """Return the poses of the prim; characters are not needed."""
        return self.sample_poses()

    def sample_poses(self) -> Poses:
        """Return the poses of the prim over time, with a sample at 0 s."""
        from animtool.usd.props.reader import open_prop

        prop = open_prop(PropRequest(self.file, self.prim, self.prim), UpAxis.Y)
        codes, start = np.zeros(1), 0.0
        if prop.span is not None:
            first, last = map(float, prop.span)
            start = first if self.frame is None else self.frame
            seconds = (last - first) / float(prop.fps)
            sample_count = min(
                int(np.ceil(seconds * PRIM_SAMPLE_RATE)) + 1, MAX_PRIM_SAMPLES
            )
            codes = np.linspace(first, last, max(sample_count, 2))
            codes = np.unique(np.concatenate([codes, prop.keys]))
            codes = codes[(codes >= first) & (codes <= last)]
        sample = prop.track.sample(codes)
        times = (codes - start) / float(prop.fps)
        return Poses(times, sample.translations, so3.align_signs(sample.rotations))


def keyed_poses(model: PlacedModel, entry_poses: Poses) -> Poses:
    """Return the poses of an entry, moved by its translation and rotation keys."""
    translation_keys = np.array(model.moves or [[0.0] * 4])
    rotation_keys = np.array(model.turns or [[0.0, 1.0, 0.0, 0.0, 0.0]])
    origins = np.zeros((len(rotation_keys), 3))
    translated_poses = _translated_poses(
        translation_keys[:, 0], translation_keys[:, 1:]
    )
    rotated_poses = Poses(rotation_keys[:, 0], origins, rotation_keys[:, [2, 3, 4, 1]])
    # Each is linear between its own keys, so both are linear between the union of them.
    times = translation_keys[:, 0] if not model.turns else rotation_keys[:, 0]
    if model.moves and model.turns:
        times = np.union1d(translation_keys[:, 0], rotation_keys[:, 0])
    offset = entry_poses.rows[0]
    return Poses(
        times,
        translated_poses.at_times(times)[:, :3] + offset[:3],
        so3.multiply(rotated_poses.at_times(times)[:, 3:], offset[3:]),
    )
