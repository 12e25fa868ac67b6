"""Writes motion as a SkelAnimation, block by block."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Vt

from animtool import _kernels
from animtool.core.array_types import BoolArray, Float32Array, FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.motion import Motion
from animtool.rig.skeleton import Rig
from animtool.usd.layers.finite import Labels, narrowed
from animtool.usd.layers.jobs import RootPath, Rounding, WrittenBlock
from animtool.usd.layers.names import RigPaths
from animtool.usd.layers.sdf import (
    SampleWriter,
    attribute,
    author_order,
    prim,
    quaternion,
    vector,
)

# Transforms of joints that are dense in memory at once: 10 MB in float64.
DENSE_JOINTS = 1 << 17


def round_blocks(
    blocks: Iterator[tuple[FloatArray, Motion]],
    rig: Rig,
    meters_per_unit: float,  # unit of the layer [m]
    *,
    root_motion: bool = False,
    size: float = 1.0,
) -> Iterator[WrittenBlock]:
    """Yield blocks rounded to USD's precision, and the rounding errors.

    size: what the rig's stage scales it by, where the error is seen.
    """
    for codes, motion in _split(blocks, len(rig.joints)):
        translations, rotations, scales = motion.dense()
        translations /= meters_per_unit
        root = None
        if root_motion and rig.roots:
            root = _move_root(rig, translations, rotations, meters_per_unit)
        names = rig.names
        written_t = narrowed(
            translations, "f", Labels("translations", "joint", names), codes
        )
        written_r = narrowed(rotations, "f", Labels("rotations", "joint", names), codes)
        written_s = None
        if scales is not None:
            labels = Labels("scales", "joint", names)
            written_s = narrowed(scales, "h", labels, codes)
        extents, error, frame, joint = _kernels.measure_rounding(
            rig.parents,
            translations,
            rotations,
            scales,
            written_t,
            written_r,
            None if written_s is None else written_s.astype(np.float32),
        )
        if not rig.joints:
            extents = np.zeros_like(extents)
        bounds = narrowed(extents, "f", Labels("extent"), codes)
        yield WrittenBlock(
            codes,
            written_t,
            written_r,
            written_s,
            bounds,
            root,
            error * meters_per_unit * size,
            float(codes[frame]),
            joint,
            _weights(motion, rig, codes),
            scales is not None and bool((scales != written_s).any()),
        )


def _split(
    blocks: Iterator[tuple[FloatArray, Motion]], joints: int
) -> Iterator[tuple[FloatArray, Motion]]:
    """Yield blocks in parts of `DENSE_JOINTS`: a clip comes as one block."""
    size = max(1, DENSE_JOINTS // max(joints, 1))
    for codes, motion in blocks:
        for start in range(0, len(codes), size):
            part = slice(start, start + size)
            yield codes[part], motion.select(part)


def _weights(motion: Motion, rig: Rig, codes: FloatArray) -> Float32Array | None:
    if motion.weights is None:
        return None
    weights = motion.weights.dense()[..., 0]
    names = [shape.name for shape in rig.shapes]
    return narrowed(weights, "f", Labels("weights", "shape", names), codes)


def _move_root(
    rig: Rig, translations: FloatArray, rotations: FloatArray, meters_per_unit: float
) -> RootPath:
    """Put the first root joint at rest in place; return the removed root motion.

    The SkelRoot's transform X and the local transforms M' of the roots satisfy
    X · M' = M, with M' of the first root at rest.
    """
    first, *others = rig.roots
    rest_t = rig.rest_translations[first] / meters_per_unit
    rest_r = rig.rest_rotations[first]
    rotation = so3.multiply(rotations[:, first], so3.conjugate(rest_r))
    move = translations[:, first] - so3.rotate(rotation, rest_t)
    translations[:, first], rotations[:, first] = rest_t, rest_r
    back = so3.conjugate(rotation)
    for other in others:
        translations[:, other] = so3.rotate(back, translations[:, other] - move)
        rotations[:, other] = so3.multiply(back, rotations[:, other])
    return RootPath(move, rotation)


_TRANSFORMS = {
    "translations": (Sdf.ValueTypeNames.Float3Array, Vt.Vec3fArray.FromNumpy),
    "rotations": (Sdf.ValueTypeNames.QuatfArray, Vt.QuatfArray.FromNumpy),
    "scales": (Sdf.ValueTypeNames.Half3Array, Vt.Vec3hArray.FromNumpy),
}


@dataclass
class AnimationWriter:
    """Writer of a SkelAnimation and the related SkelRoot values."""

    layer: Any
    paths: RigPaths  # the character's prims
    joints: list[str]  # their paths as the Skeleton has them, J of them
    written_joints: BoolArray | None = None  # joints to write ``(J,)``; None is all
    # Names of the rig's shapes, S of them; without, no weights are written.
    shapes: tuple[str, ...] = ()
    rounding: Rounding = field(default_factory=Rounding)  # what rounding did so far

    def __post_init__(self) -> None:
        """Create the prim and its attributes."""
        spec = prim(self.layer, self.paths.animation, "SkelAnimation")
        types = Sdf.ValueTypeNames
        names = self.joints
        if self.written_joints is not None:
            names = [
                n for n, keep in zip(names, self.written_joints, strict=True) if keep
            ]
        self._count = len(names)
        self._transforms: dict[str, SampleWriter] = {}
        if names:
            tokens = Vt.TokenArray(names)
            attribute(spec, "joints", types.TokenArray, tokens, uniform=True)
            self._transforms = {
                name: SampleWriter(
                    attribute(spec, name, kind),
                    make,
                    quaternions=name == "rotations",
                    noun="joint",
                    names=names,
                )
                for name, (kind, make) in _TRANSFORMS.items()
            }
        self._weights: list[Float32Array] = []
        self._weight_samples: SampleWriter | None = None
        self._codes: list[FloatArray] = []
        self._extents: list[Float32Array] = []
        self._root_path: list[RootPath] = []

    def add(self, block: WrittenBlock) -> None:
        """Write a block of frames."""
        keep = slice(None) if self.written_joints is None else self.written_joints
        arrays: dict[str, npt.NDArray[Any] | None] = {
            "translations": block.translations,
            "rotations": block.rotations,
            "scales": block.scales,
        }
        for name, samples in self._transforms.items():
            values = arrays[name]
            if values is not None:
                samples.add(block.codes, values[:, keep])
        if self.shapes and block.weights is not None:
            self._weights.append(block.weights)
        self._codes.append(block.codes)
        self._extents.append(block.extents)
        if block.root is not None:
            self._root_path.append(block.root)

    @property
    def sampled(self) -> list[str]:
        """Names of the attributes that change over time."""
        named = {**self._transforms, "blendShapeWeights": self._weight_samples}
        return [n for n, samples in named.items() if samples and samples.sampled]

    def finish(self, placing: list[str], *, replaces_motion: bool) -> None:
        """Author constant values as defaults, and the SkelRoot's motion.

        replaces_motion: whether it has others, which must no longer move it.
        """
        ones = np.ones((self._count, 3), np.float16)
        for samples in self._transforms.values():
            samples.finish(ones)
        if self._weights:
            self._author_weights()
        if self._root_path:
            self._author_root(placing)
        elif replaces_motion:
            author_order(self.layer.GetPrimAtPath(self.paths.root), *placing)

    def padded_bounds(self, padding: float | np.float32) -> list[Float32Array]:
        """Return padded joint bounds ``(F, 2, 3)``, one array per block."""
        pad = np.array([[-padding] * 3, [padding] * 3], np.float32)
        with np.errstate(over="ignore"):
            return [extents + pad for extents in self._extents]

    def author_bounds(self, extents: list[Float32Array]) -> None:
        """Author the SkelRoot's bounds ``(F, 2, 3)``, one array per block."""
        spec = self.layer.GetPrimAtPath(self.paths.root)
        attr = attribute(spec, "extent", Sdf.ValueTypeNames.Float3Array)
        samples = SampleWriter(attr, Vt.Vec3fArray.FromNumpy)
        for codes, bounds in zip(self._codes, extents, strict=True):
            samples.add(codes, bounds)
        samples.finish(np.zeros((2, 3), np.float32))

    @property
    def codes(self) -> list[FloatArray]:
        """Time codes of every sample, one array per block."""
        return self._codes

    @property
    def weights(self) -> list[Float32Array]:
        """Shape weights ``(F, S)``, one array per block; none if constant."""
        return self._weights

    def _author_weights(self) -> None:
        """Author the weights of shapes that are nonzero in some frame."""
        used = np.any([(rows != 0.0).any(axis=0) for rows in self._weights], axis=0)
        if not used.any():
            return
        spec = self.layer.GetPrimAtPath(self.paths.animation)
        types = Sdf.ValueTypeNames
        names = [n for n, keep in zip(self.shapes, used, strict=True) if keep]
        tokens = Vt.TokenArray(names)
        attribute(spec, "blendShapes", types.TokenArray, tokens, uniform=True)
        attr = attribute(spec, "blendShapeWeights", types.FloatArray)
        samples = SampleWriter(attr, Vt.FloatArray.FromNumpy)
        for codes, rows in zip(self._codes, self._weights, strict=True):
            samples.add(codes, rows[:, used])
        samples.finish(np.zeros(len(names), np.float32))
        self._weight_samples = samples

    def _author_root(self, placing: list[str]) -> None:
        """Author the SkelRoot's motion after its placing operations."""
        spec = self.layer.GetPrimAtPath(self.paths.root)
        types = Sdf.ValueTypeNames
        names = ["xformOp:translate:rootMotion", "xformOp:orient:rootMotion"]
        move = SampleWriter(attribute(spec, names[0], types.Double3), vector)
        samples = SampleWriter(
            attribute(spec, names[1], types.Quatd), quaternion, quaternions=True
        )
        author_order(spec, *placing, *names)
        for codes, path in zip(self._codes, self._root_path, strict=True):
            move.add(codes, path.translations)
            samples.add(codes, path.rotations)
        move.finish(np.zeros(3))
        samples.finish(so3.IDENTITY)
