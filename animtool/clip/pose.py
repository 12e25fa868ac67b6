"""The local transforms of a rig while its channels change one by one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.clip.reduction import ChannelKind
from animtool.clip.tracks import Track
from animtool.maths.additive import scaled, shifted, turned
from animtool.motion import Motion
from animtool.rig.kinematics import WorldTransforms, forward
from animtool.rig.skeleton import Rig


@dataclass(slots=True)
class Pose:
    """What a rig does in every frame, on top of a base if there is one.

    Attributes:
        rig: J joints.
        translations: ``(F, J, 3)`` [m].
        rotations: ``(F, J, 4)``.
        scales: ``(F, J, 3)`` [1]; None where nothing is scaled.
        base: What the channels add to; None where they stand alone.
    """

    rig: Rig
    translations: FloatArray
    rotations: FloatArray
    scales: FloatArray | None
    base: Pose | None = None

    def set(self, track: Track, values: FloatArray) -> None:
        """Put the values ``(F, D)`` of a track in place."""
        j, base, local = track.index, self.base, track.local(values)
        if track.kind is ChannelKind.ROTATION:
            self.rotations[:, j] = (
                local if base is None else turned(base.rotations[:, j], local)
            )
        elif track.kind is ChannelKind.TRANSLATION:
            self.translations[:, j] = (
                local if base is None else shifted(base.translations[:, j], local)
            )
        elif track.kind is ChannelKind.SCALE and self.scales is not None:
            below = None if base is None else base.scales
            self.scales[:, j] = local if below is None else scaled(below[:, j], local)

    def world(self, out: WorldTransforms | None = None) -> WorldTransforms:
        """Return where every joint is, in ``out`` if it is given."""
        t, r, s = self.translations, self.rotations, self.scales
        return forward(self.rig, t, r, s, out=out)

    def copy(self) -> Pose:
        """Return one whose channels can change on their own."""
        scales = None if self.scales is None else self.scales.copy()
        return Pose(
            self.rig,
            self.translations.copy(),
            self.rotations.copy(),
            scales,
            self.base,
        )


def pose_of(rig: Rig, motion: Motion, base: Motion | None) -> Pose:
    """Return the pose of a motion, added to its base by the additive convention."""
    if base is None:
        return Pose(rig, *motion.dense())
    below = pose_of(rig, base, None)
    translations, rotations, scales = motion.dense()
    if below.scales is not None:
        scales = below.scales if scales is None else scaled(below.scales, scales)
    return Pose(
        rig,
        shifted(below.translations, translations),
        turned(below.rotations, rotations),
        None if scales is None else np.ascontiguousarray(scales),
        below,
    )
