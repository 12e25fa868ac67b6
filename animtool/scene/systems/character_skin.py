"""Meshes of characters in motion, as their joints and shapes deform them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.documents.names import nearest
from animtool.errors import Fault, OptionError
from animtool.maths.faces import triangulated
from animtool.rig.kinematics import WorldTransforms, bind_matrices
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import surfaces_of
from animtool.scene.systems.character_motion import CharacterMotion
from animtool.skin.character import character_meshes
from animtool.skin.deform import Deformed, DeformedMesh, deform_blocks

# Frames of which the points are kept: both ends of a step, and those of the one before.
KEPT = 4


def no_mesh(rig: Rig, name: str) -> Fault | None:
    """Return that a rig has no such mesh (SIM053); None where it has."""
    names = [surface.name for surface in surfaces_of(rig)]
    if name in names:
        return None
    message = f"no mesh of {rig.name!r} is {name!r}"
    return Fault("SIM053", message, hint=nearest(name, names), where="mesh")


class CharacterSkin:
    """A mesh of a character over its F frames.

    Attributes:
        surface: The mesh at rest.

    Args:
        character: In motion.
        name: Of the mesh.

    Raises:
        OptionError: It has no such mesh (SIM053).
    """

    def __init__(self, character: CharacterMotion, name: str) -> None:
        rig = character.rig
        fault = no_mesh(rig, name)
        if fault is not None:
            raise OptionError(fault)
        (self.surface,) = [one for one in surfaces_of(rig) if one.name == name]
        shapes = [shape.name for shape in rig.shapes]
        (mesh,) = character_meshes(
            [self.surface], rig.names, bind_matrices(rig), shapes
        )
        weights = character.motion.weights
        self._mesh: DeformedMesh = mesh.mesh
        self._world = character.world
        self._weights = (
            None if weights is None else mesh.weights(weights.dense()[..., 0])
        )

    def blocks(self) -> Iterator[Deformed]:
        """Yield all frames in blocks that share their memory."""
        return deform_blocks(self._mesh, self._weights, self._world, normals=False)

    def frame(self, i: int) -> FloatArray:
        """Return its points at a frame ``(V, 3)`` [m]."""
        world = WorldTransforms(
            self._world.positions[i : i + 1], self._world.linear[i : i + 1]
        )
        weights = None if self._weights is None else self._weights[i : i + 1]
        (made,) = deform_blocks(self._mesh, weights, world, normals=False)
        return np.array(made.points[0], np.float64)


class SkinMotion:
    """A mesh of a character over time, straight from frame to frame and held outside.

    Args:
        character: In motion.
        name: Of the mesh.

    Raises:
        OptionError: It has no such mesh (SIM053).
    """

    def __init__(self, character: CharacterMotion, name: str) -> None:
        self._skin = CharacterSkin(character, name)
        self._times = character.times
        surface = self._skin.surface
        self._faces = triangulated(surface.counts, surface.indices)
        self._kept: OrderedDict[int, FloatArray] = OrderedDict()

    def points(self, t: float) -> FloatArray:
        """Return its points ``(V, 3)`` at a time [s] [m]."""
        times = self._times
        i = int(np.clip(np.searchsorted(times, t, "right") - 1, 0, len(times) - 1))
        before = self._frame(i)
        if not times[0] < t < times[-1] or t == times[i]:
            return before
        share = (t - times[i]) / (times[i + 1] - times[i])
        return np.asarray(before + (self._frame(i + 1) - before) * share)

    def _frame(self, i: int) -> FloatArray:
        if i not in self._kept:
            self._kept[i] = self._skin.frame(i)
            while len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        return self._kept[i]

    def triangles(self, t: float) -> IntArray:  # noqa: ARG002
        """Return corners of its triangles ``(T, 3)``: always the same."""
        return self._faces

    def forget(self, t: float) -> None:
        """Take note that no time before one will be asked for [s]."""
