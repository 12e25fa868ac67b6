"""Writes motion as a SkelAnimation, block by block."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from itertools import compress
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Vt

from animtool import _kernels
from animtool.core.array_types import BoolArray, Float32Array, FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.motion import Motion, TimedBlocks, split_blocks
from animtool.rig.skeleton import Rig
from animtool.usd.layers.finite import ValueLabels, narrow_floats
from animtool.usd.layers.jobs import RootTrajectory, RoundingError, WrittenBlock
from animtool.usd.layers.names import RigPaths
from animtool.usd.layers.sdf import (
    SampleWriter,
    attribute_spec,
    author_xform_order,
    gf_quaternion,
    gf_vector,
    prim_spec,
)

# Maximum joint transforms in memory at once: 10 MB in float64.
MAX_DENSE_JOINTS = 1 << 17


def round_blocks(
    blocks: TimedBlocks,
    rig: Rig,
    meters_per_unit: float,  # unit of the layer [m]
    *,
    has_root_motion: bool = False,
    rig_scale: float = 1.0,
) -> Iterator[WrittenBlock]:
    """Yield blocks rounded to USD's precision, and the rounding errors.

    ``rig_scale`` is the scale of the rig on its stage; errors are in stage metres.
    """
    # A clip is a single block.
    block_frames = max(1, MAX_DENSE_JOINTS // max(len(rig.joints), 1))
    for codes, motion in split_blocks(blocks, block_frames):
        translations, rotations, scales = motion.dense()
        translations /= meters_per_unit
        root_trajectory = None
        if has_root_motion and rig.roots:
            root_trajectory = _extract_root_motion(
                rig, translations, rotations, meters_per_unit
            )
        names = rig.names
        stored_translations = narrow_floats(
            translations, "f", ValueLabels("translations", "joint", names), codes
        )
        stored_rotations = narrow_floats(
            rotations, "f", ValueLabels("rotations", "joint", names), codes
        )
        stored_scales = None
        if scales is not None:
            labels = ValueLabels("scales", "joint", names)
            stored_scales = narrow_floats(scales, "h", labels, codes)
        extents, error, frame, joint_index = _kernels.measure_rounding(
            rig.parents,
            translations,
            rotations,
            scales,
            stored_translations,
            stored_rotations,
            None if stored_scales is None else stored_scales.astype(np.float32),
        )
        if not rig.joints:
            extents = np.zeros_like(extents)
        bounds = narrow_floats(extents, "f", ValueLabels("extent"), codes)
        yield WrittenBlock(
            codes,
            stored_translations,
            stored_rotations,
            stored_scales,
            bounds,
            root_trajectory,
            error * meters_per_unit * rig_scale,
            float(codes[frame]),
            joint_index,
            _round_weights(motion, rig, codes),
            _scale_error(scales, stored_scales),
        )


def _scale_error(scales: FloatArray | None, stored_scales: FloatArray | None) -> float:
    """Return the largest relative change of scales ``(F, J, 3)`` by rounding."""
    if scales is None or stored_scales is None:
        return 0.0
    changes = np.abs(stored_scales - scales)
    is_changed = changes > 0.0
    ratios = changes[is_changed] / np.abs(scales[is_changed])
    return float(ratios.max(initial=0.0))


def _round_weights(motion: Motion, rig: Rig, codes: FloatArray) -> Float32Array | None:
    if motion.weights is None:
        return None
    weights = motion.weights.dense()[..., 0]
    names = [shape.name for shape in rig.shapes]
    return narrow_floats(weights, "f", ValueLabels("weights", "shape", names), codes)


def _extract_root_motion(
    rig: Rig, translations: FloatArray, rotations: FloatArray, meters_per_unit: float
) -> RootTrajectory:
    """Move the motion of the first root joint to the SkelRoot; edit joints in place.

    The SkelRoot's transform X and the local transforms M' of the roots satisfy X · M' =
    M, with M' of the first root at rest.
    """
    first_root, *other_roots = rig.roots
    rest_translation = rig.rest_translations[first_root] / meters_per_unit
    rest_rotation = rig.rest_rotations[first_root]
    root_rotations = so3.multiply(
        rotations[:, first_root], so3.conjugate(rest_rotation)
    )
    root_translations = translations[:, first_root] - so3.rotate(
        root_rotations, rest_translation
    )
    translations[:, first_root] = rest_translation
    rotations[:, first_root] = rest_rotation
    inverse_rotations = so3.conjugate(root_rotations)
    for root in other_roots:
        translations[:, root] = so3.rotate(
            inverse_rotations, translations[:, root] - root_translations
        )
        rotations[:, root] = so3.multiply(inverse_rotations, rotations[:, root])
    return RootTrajectory(root_translations, root_rotations)


_TRANSFORM_ATTRIBUTES = {
    "translations": (Sdf.ValueTypeNames.Float3Array, Vt.Vec3fArray.FromNumpy),
    "rotations": (Sdf.ValueTypeNames.QuatfArray, Vt.QuatfArray.FromNumpy),
    "scales": (Sdf.ValueTypeNames.Half3Array, Vt.Vec3hArray.FromNumpy),
}


@dataclass
class AnimationWriter:
    """Writes a SkelAnimation and the motion and extent of its SkelRoot."""

    layer: Any
    paths: RigPaths  # prim paths of the character
    joints: list[str]  # paths of the J joints in the Skeleton
    joint_mask: BoolArray | None = None  # joints to write ``(J,)``; None is all
    # Names of the rig's S shapes; empty writes no weights.
    shapes: tuple[str, ...] = ()
    rounding: RoundingError = field(
        default_factory=RoundingError
    )  # rounding errors so far
    # Time codes of every sample, one array per block.
    codes: list[FloatArray] = field(default_factory=list)
    # Shape weights ``(F, S)``, one array per block; empty if there are no shapes.
    weights: list[Float32Array] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Create the SkelAnimation prim and its attributes."""
        spec = prim_spec(self.layer, self.paths.animation, "SkelAnimation")
        types = Sdf.ValueTypeNames
        names = self.joints
        if self.joint_mask is not None:
            names = list(compress(names, self.joint_mask))
        self._joint_count = len(names)
        self._transform_writers: dict[str, SampleWriter] = {}
        if names:
            tokens = Vt.TokenArray(names)
            attribute_spec(spec, "joints", types.TokenArray, tokens, is_uniform=True)
            self._transform_writers = {
                name: SampleWriter(
                    attribute_spec(spec, name, kind),
                    convert,
                    are_quaternions=name == "rotations",
                    noun="joint",
                    names=names,
                )
                for name, (kind, convert) in _TRANSFORM_ATTRIBUTES.items()
            }
        self._weight_writer: SampleWriter | None = None
        self._extents: list[Float32Array] = []
        self._root_trajectories: list[RootTrajectory] = []

    def add(self, block: WrittenBlock) -> None:
        """Write a block of frames of the animation."""
        self.rounding.add_block(block)
        columns = slice(None) if self.joint_mask is None else self.joint_mask
        arrays: dict[str, npt.NDArray[Any] | None] = {
            "translations": block.translations,
            "rotations": block.rotations,
            "scales": block.scales,
        }
        for name, writer in self._transform_writers.items():
            values = arrays[name]
            if values is not None:
                writer.add(block.codes, values[:, columns])
        if self.shapes and block.weights is not None:
            self.weights.append(block.weights)
        self.codes.append(block.codes)
        self._extents.append(block.extents)
        if block.root is not None:
            self._root_trajectories.append(block.root)

    @property
    def sampled_names(self) -> list[str]:
        """Names of the attributes that change over time."""
        writers = {**self._transform_writers, "blendShapeWeights": self._weight_writer}
        return [
            name for name, writer in writers.items() if writer and writer.has_samples
        ]

    def finish(self, placing_ops: list[str], *, disables_root_motion: bool) -> None:
        """Author constant values as defaults, and the SkelRoot's motion.

        ``disables_root_motion`` removes root motion operations of the SkelRoot.
        """
        unit_scales = np.ones((self._joint_count, 3), np.float16)
        for writer in self._transform_writers.values():
            writer.finish(unit_scales)
        if self.weights:
            self._author_weights()
        if self._root_trajectories:
            self._author_root(placing_ops)
        elif disables_root_motion:
            author_xform_order(self.layer.GetPrimAtPath(self.paths.root), *placing_ops)

    def padded_bounds(self, padding: float | np.float32) -> list[Float32Array]:
        """Return padded joint bounds ``(F, 2, 3)``, one array per block."""
        pad = np.array([[-padding] * 3, [padding] * 3], np.float32)
        with np.errstate(over="ignore"):
            return [extents + pad for extents in self._extents]

    def author_bounds(self, extents: list[Float32Array]) -> None:
        """Author the SkelRoot's bounds ``(F, 2, 3)``, one array per block."""
        spec = self.layer.GetPrimAtPath(self.paths.root)
        attr = attribute_spec(spec, "extent", Sdf.ValueTypeNames.Float3Array)
        writer = SampleWriter(attr, Vt.Vec3fArray.FromNumpy)
        for codes, bounds in zip(self.codes, extents, strict=True):
            writer.add(codes, bounds)
        writer.finish(np.zeros((2, 3), np.float32))

    def _author_weights(self) -> None:
        """Author the weights of shapes that are nonzero in any frame."""
        is_used = np.any([(rows != 0.0).any(axis=0) for rows in self.weights], axis=0)
        if not is_used.any():
            return
        spec = self.layer.GetPrimAtPath(self.paths.animation)
        types = Sdf.ValueTypeNames
        names = list(compress(self.shapes, is_used))
        tokens = Vt.TokenArray(names)
        attribute_spec(spec, "blendShapes", types.TokenArray, tokens, is_uniform=True)
        attr = attribute_spec(spec, "blendShapeWeights", types.FloatArray)
        writer = SampleWriter(attr, Vt.FloatArray.FromNumpy)
        for codes, rows in zip(self.codes, self.weights, strict=True):
            writer.add(codes, rows[:, is_used])
        writer.finish(np.zeros(len(names), np.float32))
        self._weight_writer = writer

    def _author_root(self, placing_ops: list[str]) -> None:
        """Author the SkelRoot's motion after its placing operations."""
        spec = self.layer.GetPrimAtPath(self.paths.root)
        types = Sdf.ValueTypeNames
        op_names = ["xformOp:translate:rootMotion", "xformOp:orient:rootMotion"]
        translation_writer = SampleWriter(
            attribute_spec(spec, op_names[0], types.Double3), gf_vector
        )
        rotation_writer = SampleWriter(
            attribute_spec(spec, op_names[1], types.Quatd),
            gf_quaternion,
            are_quaternions=True,
        )
        author_xform_order(spec, *placing_ops, *op_names)
        for codes, root_trajectory in zip(
            self.codes, self._root_trajectories, strict=True
        ):
            translation_writer.add(codes, root_trajectory.translations)
            rotation_writer.add(codes, root_trajectory.rotations)
        translation_writer.finish(np.zeros(3))
        rotation_writer.finish(so3.IDENTITY)
