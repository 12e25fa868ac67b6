"""PointBased prims that joints deform, blocks of frames of one shape.

Each attribute is sampled where it changes; attributes that simulated prims have too are
declared once, for both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pxr import Sdf, Vt

from animtool._types import Float32Array, FloatArray
from animtool.errors import Fault
from animtool.usd.layers import Samples, attribute

_TYPES = Sdf.ValueTypeNames


@dataclass(frozen=True, slots=True)
class Kind:
    """Type of an attribute, how an array becomes its value, and its interpolation."""

    type_name: Any
    make: Callable[[Any], Any]
    interpolation: str = ""


_INTEGERS = Kind(_TYPES.IntArray, Vt.IntArray.FromNumpy)
ATTRIBUTES = {
    "points": Kind(_TYPES.Point3fArray, Vt.Vec3fArray.FromNumpy),
    "velocities": Kind(_TYPES.Vector3fArray, Vt.Vec3fArray.FromNumpy),
    "extent": Kind(_TYPES.Float3Array, Vt.Vec3fArray.FromNumpy),
    "normals": Kind(_TYPES.Normal3fArray, Vt.Vec3fArray.FromNumpy, "vertex"),
    "ids": Kind(_TYPES.Int64Array, Vt.Int64Array.FromNumpy),
    "positions": Kind(_TYPES.Point3fArray, Vt.Vec3fArray.FromNumpy),
    "orientationsf": Kind(_TYPES.QuatfArray, Vt.QuatfArray.FromNumpy),
    "angularVelocities": Kind(_TYPES.Vector3fArray, Vt.Vec3fArray.FromNumpy),
    "scales": Kind(_TYPES.Float3Array, Vt.Vec3fArray.FromNumpy),
    "protoIndices": _INTEGERS,
    "widths": Kind(_TYPES.FloatArray, Vt.FloatArray.FromNumpy, "vertex"),
    "curveVertexCounts": _INTEGERS,
    "faceVertexCounts": _INTEGERS,
    "faceVertexIndices": _INTEGERS,
}


@dataclass(slots=True)
class CharactersReport:
    """What was written of characters."""

    own: int = 0  # with an animation of their own
    shared: int = 0  # with a part in one that others have, too
    samples: int = 0  # poses of those with their own
    frames: int = 0  # of these
    error: float = 0.0  # most that a joint is off between samples [m]
    slide: float = 0.0  # likewise a foot that stands [m]


@dataclass(slots=True)
class CachedMesh:
    """What was written of a PointBased prim."""

    path: str
    vertices: int = 0  # of its points, the most at any frame
    samples: int = 0  # time samples of its points; 0 where it never moves
    bytes: int = 0  # size of its samples in memory
    sampled: list[str] = field(default_factory=list)  # attributes that change
    error: float = 0.0  # largest distance that rounding moved a point [m]
    error_code: float = 0.0  # time code of that
    error_vertex: int = 0  # the point that moved
    names: Sequence[str] = ()  # of points that are bodies
    notices: list[Fault] = field(default_factory=list)
    characters: CharactersReport | None = None  # where it has these

    def moved(self, error: float, code: float, vertex: int) -> None:
        """Keep the larger error [m], its time code and point."""
        if error > self.error:
            self.error, self.error_code, self.error_vertex = error, code, vertex


def author_faces(spec: Any, subdivision: str, *, closed: bool) -> None:
    """State how a mesh is subdivided, and that an open one is visible from inside."""
    attribute(spec, "subdivisionScheme", _TYPES.Token, subdivision, uniform=True)
    if not closed:
        attribute(spec, "doubleSided", _TYPES.Bool, True, uniform=True)


def author_linear(spec: Any) -> None:
    """State that curves are polylines with two ends."""
    attribute(spec, "type", _TYPES.Token, "linear", uniform=True)
    attribute(spec, "wrap", _TYPES.Token, "nonperiodic", uniform=True)


def author_width(spec: Any, width: float) -> None:
    """State one width of all curves, in the layer's unit."""
    widths = Vt.FloatArray([width])
    attribute(spec, "widths", _TYPES.FloatArray, widths, interpolation="constant")


@dataclass(frozen=True, slots=True)
class PointSpace:
    """Where the points of a mesh are written."""

    # Mesh from skeleton space, in the layer's unit (4, 4); None where they are one.
    placement: FloatArray | None = None
    margin: float = 0.0  # half the width of curves, in the layer's unit


@dataclass(frozen=True, slots=True)
class PointBlock:
    """Frames of one mesh, or of strands, as the layer will hold them, in its unit."""

    mesh: int  # place in the job
    codes: FloatArray  # time codes (F,)
    points: Float32Array  # (F, V, 3), in the mesh's own space
    extents: Float32Array  # bounds of the points, or of curves about them (F, 2, 3)
    normals: Float32Array | None  # (F, V, 3); None where they are not written
    velocities: Float32Array | None  # (F, V, 3), per second; None likewise
    error: float  # largest distance that rounding moved a point [m]
    error_code: float  # time code of that
    error_vertex: int  # the point that moved

    def values(self) -> Iterator[tuple[str, Float32Array]]:
        """Yield the attributes that frames have, and their values ``(F, …)``."""
        for name, rows in (
            ("points", self.points),
            ("extent", self.extents),
            ("normals", self.normals),
            ("velocities", self.velocities),
        ):
            if rows is not None:
                yield name, rows

    def count(self, report: CachedMesh) -> None:
        """Add these frames to a report."""
        report.vertices = self.points.shape[1]
        report.samples += len(self.codes)
        report.bytes += sum(rows.nbytes for _, rows in self.values())
        report.moved(self.error, self.error_code, self.error_vertex)

    def put(self, writers: Sequence[BlockWriter], frames: slice) -> None:
        """Write some of the frames; the error stays that of all."""
        some = replace(
            self,
            codes=self.codes[frames],
            points=self.points[frames],
            extents=self.extents[frames],
            normals=None if self.normals is None else self.normals[frames],
            velocities=None if self.velocities is None else self.velocities[frames],
        )
        with Sdf.ChangeBlock():
            writers[self.mesh].add(some)


class BlockWriter:
    """Writes blocks of one prim: samples of what changes, a default of what does not.

    The prim is there already, with its shape and what it has at rest.
    """

    def __init__(self, spec: Any) -> None:
        self._spec = spec
        self._report = CachedMesh(str(spec.path))
        self._channels: dict[str, Samples] = {}

    def add(self, block: PointBlock) -> None:
        """Write a block of frames."""
        block.count(self._report)
        for name, rows in block.values():
            if name not in self._channels:
                self._channels[name] = empty_attribute(self._spec, name)
            self._channels[name].add(block.codes, rows)

    def release(self) -> None:
        """Sample everything, whether it changes or not."""
        for channel in self._channels.values():
            channel.release()

    def rest(self) -> None:
        """Write defaults of what has samples, but for velocities: a mesh at no time."""
        for name, channel in self._channels.items():
            if name != "velocities":
                channel.rest()

    def finish(self, *, rest: bool) -> CachedMesh:
        """Write the defaults of what never changed; return what there is now.

        With ``rest``, what has samples has a default too; a rig has its own.
        """
        report, channels = self._report, self._channels
        velocities = channels.pop("velocities", None)
        moves = bool(channels) and channels["points"].sampled
        if velocities is not None:
            if moves:
                # UsdGeomPointBased uses them beside points of the same times only.
                velocities.release()
                channels["velocities"] = velocities
            else:
                _remove(self._spec, "velocities")
        if rest:
            self.rest()
        nothing = np.zeros((0, 3), np.float32)
        for channel in channels.values():
            channel.finish(nothing)
        report.sampled = [name for name, made in channels.items() if made.sampled]
        if not moves:
            report.samples = report.bytes = 0
        return report


def empty_attribute(spec: Any, name: str) -> Samples:
    """Return an attribute without value in place of what a mesh at rest has."""
    _remove(spec, name)
    kind = ATTRIBUTES[name]
    return Samples(
        spec, name, kind.type_name, kind.make, interpolation=kind.interpolation
    )


def _remove(spec: Any, name: str) -> None:
    if name in spec.attributes:
        spec.RemoveProperty(spec.attributes[name])
