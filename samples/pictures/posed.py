"""The surfaces of a rig in a motion: blend shapes and linear skinning."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animtool.clip.clip import Clip, ClipChannel, Interp, Tangent
from animtool.clip.sample import sample_clip
from animtool.documents.arrays import load_array
from animtool.maths import so3
from animtool.rig.kinematics import forward, rest_world
from animtool.rig.parts import ArrayRef, Mesh, Shape
from animtool.rig.skeleton import Rig
from animtool.take import Motion

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
    return sample_clip(clip, rig, np.zeros(1)).motion


@dataclass(slots=True)
class Puppet:
    """A rig with its arrays at hand, each read once.

    Attributes:
        rig: The rig.
        arrays: Those read so far, by file and name.
    """

    rig: Rig
    arrays: dict[tuple[Path, str], Array] = field(default_factory=dict)

    def array(self, ref: ArrayRef) -> Array:
        """Return an array that the rig refers to."""
        key = (ref.path, ref.key)
        if key not in self.arrays:
            self.arrays[key] = load_array(*key)
        return self.arrays[key]

    def points(self, mesh: Mesh, motion: Motion, frame: int = 0) -> Array:
        """Return the points of a mesh in a frame of a motion ``(V, 3)``."""
        points = self.array(mesh.points).copy()
        if motion.weights is not None:
            weights = motion.weights.dense()[frame, :, 0]
            for shape, weight in zip(self.rig.shapes, weights, strict=True):
                if shape.mesh == mesh.name and weight:
                    points += self.moved(shape, float(weight))
        return (
            points if mesh.skin is None else self._skinned(mesh, points, motion, frame)
        )

    def moved(self, shape: Shape, weight: float) -> Array:
        """Return what a shape adds at a weight, through its inbetweens ``(V, 3)``."""
        refs = [step.deltas for step in shape.inbetweens]
        refs += [shape.deltas] if shape.deltas else []
        ends = np.array([0.0, *(step.at for step in shape.inbetweens), 1.0])
        k = int(np.clip(np.searchsorted(ends, weight) - 1, 0, len(ends) - 2))
        share = (weight - ends[k]) / (ends[k + 1] - ends[k])
        before = self.array(refs[k - 1]) if k else 0.0
        return np.asarray((1 - share) * before + share * self.array(refs[k]))

    def _skinned(self, mesh: Mesh, points: Array, motion: Motion, frame: int) -> Array:
        assert mesh.skin is not None
        now = forward(
            self.rig,
            motion.translations.dense()[[frame]],
            motion.rotations.dense()[[frame]],
        )
        rest = rest_world(self.rig)
        linear = now.linear @ np.linalg.inv(rest.linear)
        linear = linear.reshape(-1, 3, 3)
        away = now.positions.reshape(-1, 3) - np.einsum(
            "jab,jb->ja", linear, rest.positions[0]
        )
        order = np.array([self.rig.index(name) for name in mesh.skin.joints])
        joints = order[self.array(mesh.skin.indices).astype(np.int64)]
        shares = self.array(mesh.skin.weights)
        made = np.zeros_like(points)
        for k in range(shares.shape[1]):
            turned = np.einsum("vab,vb->va", linear[joints[:, k]], points)
            made += shares[:, [k]] * (turned + away[joints[:, k]])
        return made
