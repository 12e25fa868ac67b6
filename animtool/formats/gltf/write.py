"""Writes a rig and its takes as one .glb or .gltf file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError
from animtool.core.units import UpAxis
from animtool.formats.gltf.glb import GlbBuilder
from animtool.formats.gltf.write_clip import write_clip
from animtool.formats.gltf.write_rig import write_rig
from animtool.motion.reorient import reorient
from animtool.motion.take import Take, TakeStream
from animtool.motion.take_files import TakeFiles, WriteOptions


def build_gltf_files(take: Take, path: Path, options: WriteOptions) -> TakeFiles:
    """Return a rig and its takes as a glTF file with skins, shapes and animations.

    Args:
        take: The first take; its rig has the meshes.
        path: ``.glb``, or ``.gltf`` with the numbers as a data URI.
        options: Other takes of the same rig, names of all takes, and a tolerance for
            keys.
    """
    takes = [_rotate_to_y_up(written_take) for written_take in (take, *options.others)]
    first_take = takes[0]
    rig = first_take.rig
    if not rig.joints and not rig.meshes:
        message = f"{rig.name!r} has no joints and no meshes"
        raise OptionError(Fault("RIG044", message, hint="write USD, or a .clip.yaml"))
    builder = GlbBuilder({"asset": {"version": "2.0", "generator": "animtool"}})
    scales = _rest_scales(first_take)
    rig_indices = write_rig(builder, rig, scales, _rest_weights(first_take))
    names = options.names or (path.stem,)
    notices = list(rig_indices.notices)
    for written_take, name in zip(takes, names, strict=True):
        notices += write_clip(
            builder, written_take, name, rig_indices, scales, options.tolerance
        )
    is_gltf = path.suffix.lower() == ".gltf"
    chunks: Any = builder.gltf_chunks() if is_gltf else builder.glb_chunks()
    return TakeFiles({path: chunks}, take.clock.span, len(rig.joints), notices)


def _rotate_to_y_up(take: Take) -> Take:
    """Return a take rotated to Y up."""
    if take.rig.up is UpAxis.Y:
        return take
    return reorient(TakeStream.of(take), UpAxis.Y).collect()


def _rest_scales(take: Take) -> FloatArray:
    """Return the joint scales of the first frame ``(J, 3)``."""
    scales = take.motion.scales
    if scales is None:
        return np.ones((len(take.rig.joints), 3))
    rest = scales.rest.copy()
    if len(scales.values):
        rest[scales.animated] = scales.values[0]
    return rest


def _rest_weights(take: Take) -> dict[str, float]:
    weights = take.motion.weights
    names = [shape.name for shape in take.rig.shapes]
    if weights is None:
        return {}
    rest = weights.rest.copy()
    rest[weights.animated] = 0.0
    return dict(zip(names, rest[:, 0].tolist(), strict=True))
