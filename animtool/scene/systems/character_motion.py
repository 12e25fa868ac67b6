"""Characters as colliders of systems: poses, capsules and skins over time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import Clock, time_codes
from animtool.core.errors import Fault, OptionError
from animtool.core.names import has_kind_suffix, name_hint
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.documents.fields import record_from_model
from animtool.maths.faces import triangulate
from animtool.motion.motion import Motion
from animtool.motion.reorient import reorient
from animtool.motion.take import Take, TakeStream
from animtool.rig.kinematics import WorldTransforms, bind_matrices
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import surfaces_of
from animtool.scene.sources.open import open_source
from animtool.sim.colliders import Collider, Sheet, Sphere, rig_colliders
from animtool.skin.character import character_meshes
from animtool.skin.deform import DeformedFrames, DeformedMesh, deform_blocks
from animtool.systems.framework.fields import CharacterModel


@dataclass(frozen=True, slots=True)
class CharacterMotion:
    """A Y-up character over F frames; held at its first and last pose outside them."""

    path: Path  # its file
    rig: Rig
    motion: Motion  # poses and shape weights
    world: WorldTransforms  # of its joints
    times: FloatArray  # times of the frames, the first at 0 s ``(F,)`` [s]

    def colliders(self, template: Collider) -> list[Collider]:
        """Return the capsules of its rig over all frames, as moving colliders [m]."""
        if not self.rig.colliders:
            message = f"the rig {self.rig.name!r} has no colliders"
            hint = "particles collide with the capsules listed in its rig file"
            raise OptionError(Fault("SIM020", message, str(self.path), (), hint))
        return rig_colliders(self.rig, self.world, self.times, template)


@dataclass
class CharacterMotions:
    """Cache of character motions by file, including the scene's own character."""

    by_path: dict[Path, CharacterMotion] = field(default_factory=dict)

    def for_file(self, path: Path) -> CharacterMotion:
        """Return the character of a clip or scene file; read it once."""
        if path not in self.by_path:
            self.by_path[path] = motion_from_take(path, open_take(path).collect())
        return self.by_path[path]


def motion_from_take(path: Path, take: Take) -> CharacterMotion:
    """Return a take as character motion, the first frame at 0 s."""
    if take.rig.up is not UpAxis.Y:
        take = reorient(TakeStream.of(take), UpAxis.Y).collect()
    clock = take.clock
    times = np.arange(clock.count, dtype=np.float64) * float(clock.step / clock.fps)
    return CharacterMotion(path, take.rig, take.motion, take.world(), times)


def open_take(path: Path) -> TakeStream:
    """Return the take of a clip, or of a scene with its passes."""
    if not has_kind_suffix(path, "scene"):
        return open_source(path)
    from animtool.scene.file.read import load_scene

    return load_scene(path).open(writes_files=False)


# Number of cached frames: two for this step and two for the previous one.
CACHED_FRAME_COUNT = 4


def missing_mesh_fault(rig: Rig, name: str) -> Fault | None:
    """Return a fault if a rig lacks a mesh (SIM053), else None."""
    mesh_names = [surface.name for surface in surfaces_of(rig)]
    if name in mesh_names:
        return None
    message = f"unknown mesh {name!r} of {rig.name!r}"
    return Fault("SIM053", message, hint=name_hint(name, mesh_names), where="mesh")


class CharacterSkin:
    """A mesh of a character over its F frames, found by name.

    Attributes:
        surface: The mesh at rest.

    Raises:
        OptionError: It has no such mesh (SIM053).
    """

    def __init__(self, character: CharacterMotion, name: str) -> None:
        rig = character.rig
        fault = missing_mesh_fault(rig, name)
        if fault is not None:
            raise OptionError(fault)
        (self.surface,) = [
            surface for surface in surfaces_of(rig) if surface.name == name
        ]
        shapes = [shape.name for shape in rig.shapes]
        matrices, surfaces = bind_matrices(rig), [self.surface]
        (mesh,) = character_meshes(surfaces, rig.names, matrices, shapes)
        self._mesh: DeformedMesh = mesh.mesh
        self._world = character.world
        self._weights: FloatArray | None = None
        if (weights := character.motion.weights) is not None:
            self._weights = mesh.weights(weights.dense()[..., 0])

    def blocks(self) -> Iterator[DeformedFrames]:
        """Yield all frames in blocks that reuse one buffer."""
        return deform_blocks(self._mesh, self._weights, self._world, normals=False)

    def frame(self, i: int) -> FloatArray:
        """Return the points ``(V, 3)`` [m] of the mesh at a frame."""
        frame = slice(i, i + 1)
        world = WorldTransforms(self._world.positions[frame], self._world.linear[frame])
        weights = None if self._weights is None else self._weights[frame]
        (deformed_mesh,) = deform_blocks(self._mesh, weights, world, normals=False)
        return np.array(deformed_mesh.points[0], np.float64)


class SkinMotion:
    """A character's mesh over time, linear between frames and clamped outside.

    Raises:
        OptionError: The character has no mesh of that name (SIM053).
    """

    def __init__(self, character: CharacterMotion, name: str) -> None:
        self._skin = CharacterSkin(character, name)
        self._times = character.times
        surface = self._skin.surface
        self._faces = triangulate(surface.counts, surface.indices)
        self._frame = lru_cache(CACHED_FRAME_COUNT)(self._skin.frame)

    def points(self, t: float) -> FloatArray:
        """Return the points ``(V, 3)`` [m] of the mesh at a time [s]."""
        times = self._times
        i = int(np.clip(np.searchsorted(times, t, "right") - 1, 0, len(times) - 1))
        frame_points = self._frame(i)
        if not times[0] < t < times[-1] or t == times[i]:
            return frame_points
        fraction = (t - times[i]) / (times[i + 1] - times[i])
        return np.asarray(frame_points + (self._frame(i + 1) - frame_points) * fraction)

    @property
    def faces(self) -> tuple[IntArray, IntArray]:
        """Vertex counts of the faces ``(M,)``, and their corner indices."""
        surface = self._skin.surface
        return surface.counts, surface.indices

    def triangles(self, t: float) -> IntArray:  # noqa: ARG002
        """Return the point indices of the triangles ``(T, 3)``."""
        return self._faces

    def forget(self, t: float) -> None:
        """Discard data before a time; earlier times are not sampled again [s]."""


def character_colliders(
    models: Sequence[CharacterModel], characters: CharacterMotions
) -> tuple[list[Collider], list[Sheet]]:
    """Return the capsules and meshes of characters, without duplicates."""
    distinct_models: dict[tuple[str, str | None], CharacterModel] = {}
    for model in models:
        distinct_models.setdefault((str(model.file), model.mesh), model)
    colliders: list[Collider] = []
    sheets: list[Sheet] = []
    for (file, mesh), model in distinct_models.items():
        character = characters.for_file(Path(file))
        if mesh is None:
            template = record_from_model(Collider, model, shape=Sphere(1.0))
            colliders += character.colliders(template)
        else:
            values = {"motion": SkinMotion(character, mesh), "name": mesh}
            sheets.append(
                record_from_model(Sheet, model, radius=model.margin, **values)
            )
    return colliders, sheets


class CharacterRecorder:
    """Records the written time codes of a take, and optionally its motion.

    The writer reads the frames once, and the recorder records the blocks as they pass.
    A source that is sampled as a function of time has no blocks, so the recorder
    samples it itself.

    Attributes:
        records_motion: Whether the motion is recorded.
    """

    def __init__(self, *, records_motion: bool) -> None:
        self.records_motion = records_motion
        self._codes: list[FloatArray] = []
        self._blocks: list[Motion] = []
        self._stream: TakeStream | None = None

    @property
    def codes(self) -> FloatArray:
        """Time codes that were written, ascending ``(F,)``."""
        return np.concatenate(self._codes)

    def record_while_read(self, stream: TakeStream) -> TakeStream:
        """Return a take that records its frames while it is read."""
        if not self.records_motion:
            return stream
        self._stream = stream
        return replace(stream, blocks=self._record_blocks(stream.blocks))

    def record_codes(self, codes: FloatArray) -> None:
        """Append the time codes of a written block ``(F,)``."""
        self._codes.append(codes)

    def motion(self, path: Path) -> CharacterMotion | None:
        """Return the complete motion after reading; None if not recorded."""
        stream = self._stream
        if stream is None:
            return None
        if self._blocks:
            motion = Motion.concatenate(self._blocks)
        else:
            assert stream.curve is not None
            times = time_codes(stream.first_frame, stream.step, stream.count)
            motion = _joints_and_shapes(stream.curve(times))
        clock = Clock(stream.fps, stream.first_frame, stream.step, motion.frames)
        return motion_from_take(path, Take(stream.rig, clock, motion))

    def _record_blocks(self, blocks: Iterator[Motion]) -> Iterator[Motion]:
        for block in blocks:
            self._blocks.append(_joints_and_shapes(block))
            yield block


def _joints_and_shapes(motion: Motion) -> Motion:
    """Return a motion with only its joints and shapes."""
    return replace(motion, controls=None, track_times=None, points={})
