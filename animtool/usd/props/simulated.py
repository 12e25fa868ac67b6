"""Writes simulated prims to a layer while the simulation runs.

Each frame is a record of values; `FRAME_ENCODERS` maps each type to its encoder.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt
from pxr import Gf, Sdf

from animtool.core.arguments import argument
from animtool.core.array_types import Float32Array, FloatArray, IntArray
from animtool.core.errors import Fault, OptionError
from animtool.core.files.output import replacement_path
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.faces import triangulate
from animtool.motion.frames import (
    CharactersFrame,
    CurvesFrame,
    Frame,
    MeshFrame,
    PointsFrame,
    TransformsFrame,
)
from animtool.usd.caches.writer import (
    ATTRIBUTE_KINDS,
    POLYLINE_TOKENS,
    CachedMesh,
    FrameBlock,
    FrameEncoder,
    FramePrimWriter,
    PointWriter,
    attribute_kind,
    attribute_labels,
    author_values,
    author_width,
    bounds,
    remove_attribute,
    split_attribute,
)
from animtool.usd.layers.chunks import (
    ChunkedWriter,
    ClipFiles,
    GrowingLayer,
    LayerWriter,
    author_span,
    open_growing_crate,
    write_frames,
)
from animtool.usd.layers.finite import narrow_floats, round_to_float32
from animtool.usd.layers.sdf import (
    SampleWriter,
    StageMetadata,
    attribute_spec,
    author_metadata,
    author_model,
    author_xform_order,
    gf_quaternion,
    new_layer,
    prim_spec,
)
from animtool.usd.props.writer import InstancerEncoder, XformsEncoder, instance_names
from animtool.usd.rigs.meshes import MeshEncoder

if TYPE_CHECKING:
    from animtool.usd.props.characters import CharactersWriter

# Time code of each frame, and the frame of each prim.
FrameRows: TypeAlias = Iterable[tuple[float, Sequence[Frame]]]


class _CurvesEncoder(FrameEncoder[CurvesFrame]):
    type_name = "BasisCurves"
    sampled_names = ("points", "velocities", "extent")

    def topology(self, frame: CurvesFrame) -> Mapping[str, IntArray]:
        """Return the number of points per curve."""
        return {"curveVertexCounts": frame.counts.astype(np.int32)}

    def can_tear(self, frame: CurvesFrame) -> bool:
        """Return whether a curve may split in two."""
        return frame.tears

    def author_constants(
        self, writer: FramePrimWriter, spec: Any, frame: CurvesFrame
    ) -> None:
        """Author type and width of the curves."""
        author_values(spec, POLYLINE_TOKENS)
        author_width(spec, frame.width / writer.unit)

    def values(
        self,
        writer: FramePrimWriter,
        frame: CurvesFrame,
        points: Float32Array,
        code: float,  # noqa: ARG002
    ) -> Mapping[str, npt.NDArray[Any]]:
        """Return the bounds of the points, padded by half the curve width."""
        return {"extent": bounds(points, frame.width / writer.unit / 2)}


class _PointsEncoder(FrameEncoder[PointsFrame]):
    type_name = "Points"
    sampled_names = ("points", "velocities", "ids", "widths")

    def values(
        self,
        writer: FramePrimWriter,
        frame: PointsFrame,
        points: Float32Array,
        code: float,
    ) -> Mapping[str, npt.NDArray[Any]]:
        """Return ids, widths and bounds of the particles."""
        widths = writer.to_float32("widths", 2 * frame.radii / writer.unit, code)
        extent = bounds(points, widths[:, None] / 2)
        return {"ids": frame.ids, "widths": widths, "extent": extent}


FRAME_ENCODERS: dict[type[Frame], FrameEncoder[Any]] = {
    CurvesFrame: _CurvesEncoder(),
    MeshFrame: MeshEncoder(),
    PointsFrame: _PointsEncoder(),
    TransformsFrame: InstancerEncoder(),
}
_XFORMS_ENCODER = XformsEncoder()


def frame_encoder(frame: Frame) -> FrameEncoder[Any]:
    """Return the `FrameEncoder` that writes a frame."""
    has_xforms = isinstance(frame, TransformsFrame) and frame.xforms
    return _XFORMS_ENCODER if has_xforms else FRAME_ENCODERS[type(frame)]


class SimulatedPrim:
    """Writes one simulated prim: its constants, then blocks of frames."""

    def __init__(
        self,
        path: str,
        meters_per_unit: float,
        rotation: FloatArray | None = None,
        fps: float = 24.0,
    ) -> None:
        self.report = CachedMesh(path)
        self.unit = meters_per_unit  # unit of the layer [m]
        # Orientation of the prim in the layer (4,).
        self.rotation = so3.IDENTITY if rotation is None else rotation
        self.fps = fps  # time codes per second
        self._characters: CharactersWriter | None = None
        self._first_frame: Any = None
        self._sampled_names: tuple[str, ...] = ()  # attributes of every frame, in order

    @cached_property
    def triangles(self) -> IntArray:
        """Faces of the first frame as triangles ``(T, 3)``."""
        return triangulate(self._first_frame.counts, self._first_frame.indices)

    @cached_property
    def child_names(self) -> list[str]:
        """Legal, unique names of the child prims, from the names of the first frame."""
        return instance_names(self._first_frame.names).names

    def author_prim(self, layer: Any, frame: Frame) -> None:
        """Write the prim with its attributes and constants, as of the first frame."""
        self._first_frame, report = frame, self.report
        if isinstance(frame, CharactersFrame):
            from animtool.usd.props.characters import CharactersWriter

            self._characters = CharactersWriter(report.path, self.unit, self.fps)
            self._characters.author_prototypes(layer, frame)
            return
        encoder = frame_encoder(frame)
        if isinstance(frame, TransformsFrame):
            report.names = frame.names
            if frame.xforms:
                report.notices += instance_names(frame.names).notices
        spec = prim_spec(layer, report.path, encoder.type_name)
        encoder.author_children(spec, frame)
        attribute_kinds, topology = (
            encoder.attribute_kinds(frame),
            encoder.topology(frame),
        )
        self._sampled_names = tuple(attribute_kinds)
        for name, kind in attribute_kinds.items():
            path, leaf = split_attribute(report.path, name)
            owner_spec = layer.GetPrimAtPath(path)
            attribute_spec(
                owner_spec, leaf, kind.type_name, interpolation=kind.interpolation
            )
        report.sampled = list(attribute_kinds)
        if encoder.can_tear(frame):
            report.sampled += topology
            for name in topology:
                attribute_spec(spec, name, ATTRIBUTE_KINDS[name].type_name)
        else:
            author_values(spec, topology)
        encoder.author_constants(self, spec, frame)

    def build_block(self, prim_index: int, code: float, frame: Frame) -> FrameBlock:
        """Convert a frame to a block of a prim; collect crowds for `finish`."""
        codes = np.array([code])
        if isinstance(frame, CharactersFrame):
            assert self._characters is not None
            self._characters.add(code, frame)
            return FrameBlock(prim_index, codes, {}, 0)
        encoder = frame_encoder(frame)
        if not encoder.points:
            empty_points = np.zeros((0, 3), np.float32)
            frame_values = encoder.values(self, frame, empty_points, code)
            return FrameBlock(
                prim_index, codes, _add_frame_axis(frame_values), len(frame.points)
            )
        points, error, vertex = self._round_points(encoder.points, frame.points, code)
        values = {encoder.points: points, **encoder.values(self, frame, points, code)}
        for name, array in frame.primvars.items():
            values[f"primvars:{name}"] = (
                array.astype(np.int32)
                if np.issubdtype(array.dtype, np.integer)
                else self.to_float32(f"primvars:{name}", array, code)
            )
        velocities, _, _ = self._round_points("velocities", frame.velocities, code)
        values["velocities"] = velocities
        sampled_values = {name: values[name] for name in self._sampled_names}
        if encoder.can_tear(frame):
            sampled_values |= encoder.topology(frame)
        return FrameBlock(
            prim_index,
            codes,
            _add_frame_axis(sampled_values),
            len(points),
            error,
            code,
            vertex,
        )

    def finish(self, layer: Any) -> None:
        """Write the crowd characters, which depend on all frames."""
        if self._characters is not None:
            self._characters.finish(layer)
            report = self._characters.report
            self.report.characters = report
            self.report.vertices = report.own + report.shared
            self.report.samples = len(self._characters.codes)
            self.report.error = report.error

    def to_float32(
        self, name: str, values: npt.NDArray[Any], code: float
    ) -> Float32Array:
        """Return values ``(N,)`` or ``(N, 3)`` of an attribute as float32."""
        labels = attribute_labels(self.report, name)
        rows = narrow_floats(values[None], "f", labels, np.array([code]))
        return np.asarray(rows[0], np.float32)

    def _round_points(
        self, name: str, values: FloatArray, code: float
    ) -> tuple[Float32Array, float, int]:
        """Return rounded points ``(N, 3)``, the largest error [m] and its point."""
        labels = attribute_labels(self.report, name)
        rows, error, _, vertex = round_to_float32(
            values[None], self.unit, labels, np.array([code])
        )
        return rows[0], error, vertex

    def write_static(self, layer: Any, path: str, frame: Frame) -> None:
        """Write a frame as a static prim."""
        prim_writer = SimulatedPrim(path, self.unit)
        prim_writer.author_prim(layer, frame)
        spec = layer.GetPrimAtPath(path)
        remove_attribute(spec, "velocities")
        for name, rows in prim_writer.build_block(0, 0.0, frame).values.items():
            if name != "velocities":
                convert = attribute_kind(name, rows[0]).convert
                SampleWriter(spec.attributes[name], convert).finish(rows[0])


def _add_frame_axis(
    values: Mapping[str, npt.NDArray[Any]],
) -> dict[str, npt.NDArray[Any]]:
    """Return the values of one frame with a leading frame axis ``(1, …)``."""
    return {name: array[None] for name, array in values.items()}


@dataclass(frozen=True, slots=True)
class SimulatedJob:
    """Parent prim, names, units and placement of simulated prims to write."""

    model: str  # path of the parent prim
    names: Sequence[str]  # legal, unique names of the prims
    metadata: StageMetadata  # metadata of the layer
    meters_per_unit: float  # length unit below the model [m]
    # From Y up to the layer's up axis (4,); None for Y.
    rotation: FloatArray | None = None
    # From the world of a take to the space of the model at all time codes: column
    # vectors in the model's unit ``(F, 4, 4)``, or one matrix; None is the identity.
    placement_matrices: FloatArray | None = None
    codes: FloatArray | None = None  # time codes of the placement ``(F,)``

    @property
    def paths(self) -> list[str]:
        """Prim paths below the parent prim, in the order of the names."""
        return [f"{self.model}/{name}" for name in self.names]

    def prim_writers(self) -> list[SimulatedPrim]:
        """Return a new writer for each prim."""
        unit, rotation = self.meters_per_unit, self.rotation
        fps = float(self.metadata.span.fps)
        return [SimulatedPrim(path, unit, rotation, fps) for path in self.paths]


def new_simulated_layer(job: SimulatedJob, output: Path) -> Any:
    """Return a new layer with metadata and the parent prim.

    ``output`` is the path of the file, or `STDOUT` for usda.
    """
    layer = new_layer(output)
    author_model(layer, job.model)
    author_metadata(layer, job.metadata)
    return layer


def write_simulated(
    job: SimulatedJob, rows: FrameRows, growing_layer: GrowingLayer
) -> list[CachedMesh]:
    """Write prims to a layer frame by frame; return a report per prim."""
    prims, layer = job.prim_writers(), growing_layer.layer
    reports = [prim_writer.report for prim_writer in prims]
    writer = LayerWriter(
        [PointWriter(layer, report, writes_every_frame=True) for report in reports]
    )
    write_frames(_write_blocks(job, prims, rows, layer, growing_layer), writer, reports)
    for prim_writer in prims:
        prim_writer.finish(layer)
    return reports


def write_simulated_chunks(
    job: SimulatedJob, rows: FrameRows, layer: Any, files: ClipFiles, chunk_size: int
) -> tuple[list[Path], list[CachedMesh]]:
    """Write samples of prims to chunk files, combined by a layer.

    The in-memory layer has the parent prim; the other prims are added without samples.

    Args:
        job: Settings of the prims.
        rows: Frames of all prims.
        layer: The combining layer.
        files: Paths of the chunks.
        chunk_size: Samples per file.

    Returns:
        The files, and a report per prim.
    """
    prims = job.prim_writers()
    reports = [writer.report for writer in prims]

    @contextmanager
    def open_chunk(path: Path, chunk_index: int) -> Iterator[Sequence[PointWriter]]:
        with (
            replacement_path(path) as temporary_path,
            open_growing_crate(temporary_path, path) as chunk_layer,
        ):
            _declare_attributes(chunk_layer.layer, reports, layer)
            yield [
                PointWriter(
                    chunk_layer.layer,
                    report,
                    writes_every_frame=True,
                    with_default=chunk_index == 0,
                    on_added=chunk_layer.count_bytes,
                )
                for report in reports
            ]
            author_span(chunk_layer.layer, job.metadata)

    with ChunkedWriter(files, chunk_size, len(prims), open_chunk) as chunks:
        write_frames(_write_blocks(job, prims, rows, layer), chunks, reports)
    chunks.author_value_clips(
        layer,
        job.model,
        job.metadata,
        lambda manifest: _declare_attributes(manifest, reports, layer),
        use_defaults=True,
    )
    return chunks.finish(), reports


def _write_blocks(
    job: SimulatedJob,
    prims: Sequence[SimulatedPrim],
    rows: FrameRows,
    layer: Any,
    byte_counter: GrowingLayer | None = None,
) -> Iterator[FrameBlock]:
    """Yield blocks of frames; create the prims at the first frame.

    Prims are rotated to the layer's up axis, or get the placement of a rig.
    ``byte_counter`` counts the bytes of each row; None for chunks.

    Raises:
        OptionError: Characters cannot be written in chunks (SIM151).
    """
    types = Sdf.ValueTypeNames
    for i, (code, frames) in enumerate(rows):
        if byte_counter is None and any(isinstance(f, CharactersFrame) for f in frames):
            message = "characters with rigs are written in one piece, not in chunks"
            hint = f"remove {argument('chunk')}"
            raise OptionError(Fault("SIM151", message, hint=hint))
        for writer, frame in () if i else zip(prims, frames, strict=True):
            writer.author_prim(layer, frame)
            spec = layer.GetPrimAtPath(writer.report.path)
            if job.placement_matrices is not None:
                _author_placement(spec, job, job.placement_matrices)
            elif job.rotation is not None:
                rotation = gf_quaternion(job.rotation)
                attribute_spec(spec, "xformOp:orient", types.Quatd, rotation)
                author_xform_order(spec, "xformOp:orient")
        frame_bytes = 0
        for prim_index, (writer, frame) in enumerate(zip(prims, frames, strict=True)):
            block = writer.build_block(prim_index, code, frame)
            frame_bytes += block.bytes
            yield block
        if byte_counter is not None:
            byte_counter.count_bytes(frame_bytes)


def _author_placement(
    spec: Any, job: SimulatedJob, placement_matrices: FloatArray
) -> None:
    """Author the transform of a prim below a model placed by the rig's stage."""
    assert job.codes is not None
    if job.rotation is not None:
        up_matrix = np.eye(4)
        up_matrix[:3, :3] = so3.to_matrix(job.rotation)
        placement_matrices = placement_matrices @ up_matrix
    rows = np.broadcast_to(placement_matrices.swapaxes(1, 2), (len(job.codes), 4, 4))
    attr = attribute_spec(spec, "xformOp:transform", Sdf.ValueTypeNames.Matrix4d)
    samples = SampleWriter(attr, lambda row: Gf.Matrix4d(row.tolist()))
    samples.add(job.codes, rows)
    samples.finish(rows[0])
    author_xform_order(spec, "xformOp:transform")


def _declare_attributes(
    layer: Any, reports: Sequence[CachedMesh], source_layer: Any
) -> None:
    """Declare the sampled attributes with the types they have in a source layer."""
    for report in reports:
        prim_spec(layer, report.path, is_over=True)
        for name in report.sampled:
            path, leaf = split_attribute(report.path, name)
            kind = source_layer.GetPrimAtPath(path).attributes[leaf].typeName
            attribute_spec(prim_spec(layer, path, is_over=True), leaf, kind)
