"""The surfaces of a rig in a motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from picture import triangulated

from animtool.clip.channels import ClipChannel
from animtool.clip.clip import Clip
from animtool.clip.sample import sample_channels
from animtool.maths import so3
from animtool.maths.curves import Interp
from animtool.maths.tangents import Tangent
from animtool.motion.motion import Motion
from animtool.rig.file import load_rig
from animtool.rig.kinematics import bind_world, forward, rest_world
from animtool.rig.parts import Attachment, Mesh
from animtool.rig.skeleton import Rig
from animtool.skin.deform import DeformedMesh, deform
from animtool.skin.shapes import InbetweenDeltas, ShapeDeltas, prepare_shapes
from animtool.skin.skinning import Binding, SkinMethod, prepare_skin

Array = NDArray[np.float64]


def posed(rig: Rig, values: Mapping[str, float | Sequence[float]]) -> Motion:
    """Return one frame of a rig.

    Args:
        rig: The rig.
        values: By target: of ``control/NAME`` and ``shape/NAME`` as they are, of
            ``joint/NAME.angle`` degrees, of ``joint/NAME.rotation`` a rotation vector
            in degrees.
    """
    channels = []
    for target, value in values.items():
        row = np.atleast_2d(np.asarray(value, np.float64))
        if target.startswith("joint/"):
            row = np.radians(row)
        if target.endswith(".rotation"):
            row = so3.exp(row)
        none = np.zeros((1, 1 + row.shape[1]))
        channels.append(
            ClipChannel(
                target,
                np.zeros(1),
                row,
                (Interp.STEP,),
                ((Tangent.FLAT, Tangent.FLAT),),
                none,
                none,
                np.zeros((1, 3)),
            )
        )
    clip = Clip("pose", Fraction(24), Fraction(0), Fraction(0), tuple(channels))
    return sample_channels(clip.channels, rig, np.zeros(1)).motion


@dataclass(frozen=True, slots=True)
class Puppet:
    """A rig with its surfaces at hand.

    Attributes:
        rig: The rig.
        meshes: What deforms, by name.
    """

    rig: Rig
    meshes: dict[str, DeformedMesh]

    @classmethod
    def load(cls, path: Path) -> Puppet:
        """Return the rig of a file, its arrays read."""
        rig = load_rig(path)
        return cls(rig, {mesh.name: deformed(rig, mesh) for mesh in rig.meshes})

    def triangles(self, mesh: Mesh) -> NDArray[np.int64]:
        """Return the triangles of a mesh ``(T, 3)``."""
        return triangulated(mesh.faces.load().astype(np.int64))

    def points(self, mesh: Mesh, motion: Motion, frame: int = 0) -> Array:
        """Return the points of a mesh in a frame of a motion ``(V, 3)``."""
        world = forward(
            self.rig,
            motion.translations.dense()[[frame]],
            motion.rotations.dense()[[frame]],
        )
        weights = None
        if motion.weights is not None:
            own = [shape.mesh == mesh.name for shape in self.rig.shapes]
            weights = motion.weights.dense()[[frame], :, 0][:, own]
        return deform(self.meshes[mesh.name], weights, world).points[0]

    def strands(self, entry: Attachment, motion: Motion, frame: int = 0) -> Array:
        """Return strands as their joint carries them in a frame ``(S, K, 3)``."""
        assert entry.points is not None
        world = forward(
            self.rig,
            motion.translations.dense()[[frame]],
            motion.rotations.dense()[[frame]],
        )
        bind, joint = bind_world(self.rig), self.rig.index(entry.joints[0])
        points = entry.points.load() * self.rig.meters_per_unit
        local = (points - bind.positions[0, joint]) @ bind.linear[0, joint]
        turned = local @ world.linear[0, joint].T
        return np.asarray(turned + world.positions[0, joint])


def deformed(rig: Rig, mesh: Mesh) -> DeformedMesh:
    """Return a mesh of a rig with its shapes and its skin, bound at rest."""
    points = mesh.points.load()
    shapes = [
        ShapeDeltas(
            shape.name,
            shape.deltas.load(),
            inbetweens=tuple(
                InbetweenDeltas(step.at, step.deltas.load())
                for step in shape.inbetweens
            ),
        )
        for shape in rig.shapes
        if shape.mesh == mesh.name and shape.deltas is not None
    ]
    skin = None
    if mesh.skin is not None:
        rest = rest_world(rig)
        bind = np.tile(np.eye(4), (len(rig.joints), 1, 1))
        bind[:, :3, :3], bind[:, :3, 3] = rest.linear[0], rest.positions[0]
        binding = Binding(
            mesh.skin.indices.load().astype(np.int64),
            mesh.skin.weights.load(),
            bind,
            np.array([rig.index(name) for name in mesh.skin.joints]),
            method=SkinMethod(mesh.skin.method),
        )
        skin = prepare_skin(binding, len(points))
    return DeformedMesh(points, prepare_shapes(shapes, points), skin)
