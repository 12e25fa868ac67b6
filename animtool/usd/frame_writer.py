"""Prims of what is simulated: each frame is a record of a prim's values."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from animtool._types import Float32Array, FloatArray, IntArray
from animtool.frames import CharactersFrame, Frame, TransformsFrame
from animtool.maths import so3
from animtool.maths.faces import triangulated
from animtool.usd.finite import (
    Labels,
    check_value,
    largest,
    narrowed,
    rounded,
)
from animtool.usd.frame_forms import form_of, part_names, place_of
from animtool.usd.layers import attribute, prim
from animtool.usd.point_based import ATTRIBUTES, CachedMesh, Kind

if TYPE_CHECKING:
    from animtool.usd.characters import Characters


class FrameWriter:
    """Writes the frames of one prim: its attributes once, then all of every frame."""

    def __init__(
        self,
        path: str,
        meters_per_unit: float,
        turn: FloatArray | None = None,
        fps: float = 24.0,
    ) -> None:
        self.report = CachedMesh(path)
        self.unit = meters_per_unit  # of the layer [m]
        # How the prim stands in the layer (4,).
        self.turn = so3.IDENTITY if turn is None else turn
        self.fps = fps  # time codes a second
        self._characters: Characters | None = None
        self._first: Any = None
        self._kinds: dict[str, Kind] = {}  # of what every frame has, in order
        self._letters: dict[str, str] = {}  # of what has a default

    @cached_property
    def triangles(self) -> IntArray:
        """Faces of the first frame as triangles ``(T, 3)``."""
        return triangulated(self._first.counts, self._first.indices)

    @cached_property
    def parts(self) -> list[str]:
        """Names of the prims below, of a frame that has names."""
        return part_names(self._first.names).names

    def begin(self, layer: Any, frame: Frame) -> None:
        """Write the prim of a first frame: attributes, and what no frame changes."""
        self._first = frame
        if isinstance(frame, CharactersFrame):
            from animtool.usd.characters import Characters

            self._characters = Characters(self.report.path, self.unit, self.fps)
            self._characters.begin(layer, frame)
            return
        form = form_of(frame)
        if isinstance(frame, TransformsFrame):
            self.report.names = frame.names
            if frame.xforms:
                self.report.notices += part_names(frame.names).notices
        self._kinds = form.kinds(frame)
        spec = prim(layer, self.report.path, form.type_name)
        form.divide(spec, frame)
        for name, kind in self._kinds.items():
            place, own = place_of(self.report.path, name)
            owner = layer.GetPrimAtPath(place)
            attribute(owner, own, kind.type_name, interpolation=kind.interpolation)
        self.report.sampled = list(self._kinds)
        tears = form.tears(frame)
        for name, values in form.shape(frame).items():
            kind = ATTRIBUTES[name]
            value = None if tears else kind.make(values)
            attribute(spec, name, kind.type_name, value)
            self.report.sampled += [name] if tears else []
        form.describe(self, spec, frame)

    def values(self, code: float, frame: Frame) -> tuple[dict[str, Any], int]:
        """Return attributes of a frame, counted in the report, and their bytes."""
        report = self.report
        if isinstance(frame, CharactersFrame):
            assert self._characters is not None
            self._characters.add(code, frame)
            return {}, 0
        form = form_of(frame)
        if not form.points:
            held = dict(form.values(self, frame, np.zeros((0, 3), np.float32), code))
            size = 28 * len(held)  # half of them three doubles, half of them four
            report.vertices = len(frame.points)
            report.samples += 1
            report.bytes += size
            return held, size
        points, error, vertex = self._rounded(form.points, frame.points, code)
        values = {form.points: points, **form.values(self, frame, points, code)}
        for name, array in frame.primvars.items():
            values[f"primvars:{name}"] = (
                array.astype(np.int32)
                if np.issubdtype(array.dtype, np.integer)
                else self.narrowed(f"primvars:{name}", array, code)
            )
        values["velocities"] = self._rounded("velocities", frame.velocities, code)[0]
        size = sum(array.nbytes for array in values.values())
        held = {name: kind.make(values[name]) for name, kind in self._kinds.items()}
        for name, array in form.shape(frame).items() if form.tears(frame) else ():
            held[name] = ATTRIBUTES[name].make(array)
            size += array.nbytes
        report.vertices = max(report.vertices, len(points))
        report.samples += 1
        report.bytes += size
        report.moved(error, code, vertex)
        return held, size

    def write(self, layer: Any, code: float, values: Mapping[str, Any]) -> None:
        """Write attributes of a frame to a layer that has the prim."""
        for name, value in values.items():
            self.put(layer, code, name, value)

    def finish(self, layer: Any) -> None:
        """Write what shows only behind the last frame."""
        if self._characters is not None:
            self._characters.finish(layer)
            report = self._characters.report
            self.report.characters = report
            self.report.vertices = report.own + report.shared
            self.report.samples = len(self._characters.codes)
            self.report.error = report.error

    def put(self, layer: Any, code: float, name: str, value: Any) -> None:
        """Write the value of an attribute at a time code; the first is its default."""
        path = ".".join(place_of(self.report.path, name))
        if name not in self._letters:
            spec = layer.GetAttributeAtPath(path)
            self._letters[name] = largest(spec.typeName)
            spec.default = value
        if letter := self._letters[name]:
            check_value(value, letter, self._labels(name), code)
        layer.SetTimeSample(path, code, value)

    def narrowed(
        self, name: str, values: npt.NDArray[Any], code: float
    ) -> Float32Array:
        """Return values ``(N,)`` or ``(N, 3)`` of an attribute in float32."""
        labels, codes = self._labels(name), np.array([code])
        return np.asarray(narrowed(values[None], "f", labels, codes)[0], np.float32)

    def _rounded(
        self, name: str, values: FloatArray, code: float
    ) -> tuple[Float32Array, float, int]:
        """Return ``(N, 3)`` in the layer's unit, the largest error [m], its point."""
        labels, codes = self._labels(name), np.array([code])
        rows, error, _, vertex = rounded(values[None], self.unit, labels, codes)
        return rows[0], error, vertex

    def _labels(self, name: str) -> Labels:
        place, own = place_of(self.report.path, name)
        names = () if name == "extent" else self.report.names
        of = "body" if names else "point"
        return Labels(f"{place}.{own}", "" if "." in name else of, names)

    def write_still(self, layer: Any, path: str, frame: Frame) -> None:
        """Write a frame as a prim that never moves."""
        writer = FrameWriter(path, self.unit)
        writer.begin(layer, frame)
        spec = layer.GetPrimAtPath(path)
        spec.RemoveProperty(spec.attributes["velocities"])
        for name, value in writer.values(0.0, frame)[0].items():
            if name != "velocities":
                spec.attributes[name].default = value
