"""Target values of a targets file, sampled at any frame, with holds and eases."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field
from fractions import Fraction
from pathlib import Path
from typing import Protocol, TypeAlias, cast

import numpy as np

from animtool.clip.channel_entries import CurveReader, file_quaternions
from animtool.clip.channels import ClipChannel, ClipUnits, evaluate_channels
from animtool.clip.schema import CurveModel
from animtool.core.array_types import FloatArray
from animtool.core.errors import AnimtoolError, Fault, OptionError, counted
from animtool.core.files.reading import exists, not_a_file_reason
from animtool.core.readers import find_reader
from animtool.core.record import dataclass
from animtool.documents.arrays import Archives
from animtool.documents.document import Document, Location
from animtool.documents.references import (
    resolve_reference,
    similar_file_hint,
    split_reference,
)
from animtool.ik.schema import ValueModel
from animtool.maths import so3
from animtool.rig.skeleton import Rig
from animtool.rig.suspicions import warn_of_quaternion_length

Span = tuple[float, float]
# Returns positions [m] ``(F, 3)`` and rotations ``(F, 4)`` of a prim, in the rig's
# world space, at seconds ``(F,)``.
PrimMotion: TypeAlias = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
# A time within this distance of a row is on the row [frame].
ROW_TOLERANCE = 1e-9
# Keys of values that follow a prim, and of values with keys.
_PRIM_KEYS = ("file", "space", "offset", "rotate")
_CURVE_KEYS = ("interp", "tangents", "parametrization", "euler", "pre", "post")


def smoothstep(fraction: FloatArray) -> FloatArray:
    """Ease fractions from 0 to 1 with zero speed and acceleration at both ends.

    >>> smoothstep(np.array([-1.0, 0.5, 2.0])).tolist()
    [0.0, 0.5, 1.0]
    """
    u = np.clip(fraction, 0.0, 1.0)
    # Rounding may lead past 1.
    return np.minimum(u * u * u * (u * (6.0 * u - 15.0) + 10.0), 1.0)


def hold_weights(times: FloatArray, spans: Sequence[Span], ease: float) -> FloatArray:
    """Return the hold weights of H spans at times ``(H, F)``, 0 to 1.

    They are 1 inside the span. Where two spans are nearer than both eases, each eases
    over half of the gap, so that at most one holds at a time.

    ``times`` [frame] ``(F,)``, ``ease`` [frame].

    >>> hold_weights(np.array([0.0, 2.0, 4.0, 9.0]), [(4.0, 6.0)], 4.0).tolist()
    [[0.0, 0.5, 1.0, 0.103515625]]
    """
    weights = np.zeros((len(spans), len(times)))
    for i, (first, last) in enumerate(spans):
        ease_in = ease_out = ease
        if i > 0:
            ease_in = min(ease, (first - spans[i - 1][1]) / 2)
        if i + 1 < len(spans):
            ease_out = min(ease, (spans[i + 1][0] - last) / 2)
        is_inside = (times >= first) & (times <= last)
        weights[i, is_inside] = 1.0
        for length, distance in ((ease_in, first - times), (ease_out, times - last)):
            is_easing = (distance > 0) & (distance < length)
            weights[i, is_easing] = smoothstep(1.0 - distance[is_easing] / length)
    return weights


def blend_holds(
    values: FloatArray, weights: FloatArray, hold_values: FloatArray
) -> FloatArray:
    """Blend a motion towards the values that spans hold.

    Args:
        values: The free motion ``(F, 3)``, or rotations ``(F, 4)``, which take the
            shortest arc to the held one.
        weights: Hold weights from `hold_weights` ``(H, F)``.
        hold_values: Value that each span holds ``(H, 3)`` or ``(H, 4)``.

    >>> weights = np.array([[0.5, 1.0]])
    >>> blend_holds(np.zeros((2, 3)), weights, np.ones((1, 3)))[:, 0].tolist()
    [0.5, 1.0]
    """
    blended_values = values.copy()
    for weight, hold_value in zip(weights, hold_values, strict=True):
        is_blending = (weight > 0) & (weight < 1)
        fraction, free_values = weight[is_blending], blended_values[is_blending]
        if values.shape[1] == 4:
            hold_rotations = np.broadcast_to(hold_value, free_values.shape)
            new_values = so3.slerp(free_values, hold_rotations, fraction)
        else:
            new_values = free_values + fraction[:, None] * (hold_value - free_values)
        blended_values[is_blending] = new_values
        blended_values[weight >= 1] = hold_value
    return so3.align_signs(blended_values) if values.shape[1] == 4 else blended_values


@dataclass(frozen=True, slots=True)
class SampleFrames:
    """Times at which values are sampled."""

    times: FloatArray  # sample times [frame] ``(F,)``
    fps: Fraction  # frames a second

    @property
    def seconds(self) -> FloatArray:
        """The times [s]; frame 0 is second 0."""
        return np.asarray(self.times / float(self.fps))


class SampledValue(Protocol):
    """Points ``(F, 3)`` [m], rotations ``(F, 4)`` or weights ``(F, 1)`` over frames."""

    def sample(self, frames: SampleFrames) -> FloatArray:
        """Return the values at the sample times."""
        ...


@dataclass(frozen=True, slots=True)
class ConstantValue:
    """A value that is the same in every frame."""

    value: tuple[float, ...]

    def sample(self, frames: SampleFrames) -> FloatArray:
        """Return the constant repeated for each sample time."""
        return np.tile(np.array(self.value, np.float64), (len(frames.times), 1))


@dataclass(frozen=True, slots=True)
class KeyedValue:
    """A value sampled from a key curve, as in a clip."""

    channel: ClipChannel

    def sample(self, frames: SampleFrames) -> FloatArray:
        """Return the values of the key curve at the sample times."""
        values = evaluate_channels([self.channel], frames.times)[self.channel.target]
        return np.array(np.broadcast_to(values, (len(frames.times), values.shape[1])))


@dataclass(frozen=True, slots=True)
class ArrayRows:
    """A value stored as an array with a row per frame, interpolated between rows."""

    name: str  # array reference as the file spells it
    values: FloatArray = field(repr=False)  # array rows ``(R, 3)`` or ``(R, 4)``
    first: Fraction | None  # frame of the first row; None is 1
    location: tuple[int, int] = (1, 1)  # line and column of the name in the file

    def sample(self, frames: SampleFrames) -> FloatArray:
        """Return the array's values at the sample times, interpolated between rows.

        Raises:
            OptionError: There is no row for a time (TGT015).
        """
        first = 1.0 if self.first is None else float(self.first)
        row_numbers = frames.times - first
        last = len(self.values) - 1
        is_outside = row_numbers < -ROW_TOLERANCE
        is_outside |= row_numbers > last + ROW_TOLERANCE
        if is_outside.any():
            frame = frames.times[is_outside][0]
            message = f"{self.name!r} has {last + 1} rows, for the frames {first:g} to "
            message += f"{first + last:g}, but none for frame {frame:g}"
            hint = "add range to the targets, or use an array of that length"
            raise OptionError(self.rows_fault(message, hint))
        return interpolate_rows(self.values, row_numbers)

    def rows_fault(self, message: str, hint: str, path: str | None = None) -> Fault:
        """Return a fault about an array's rows, located at its name (TGT015)."""
        line, column = self.location
        return Fault("TGT015", message, path, (line,), hint, column=column)


def interpolate_rows(values: FloatArray, row_numbers: FloatArray) -> FloatArray:
    """Interpolate rows at fractional row numbers ``(F,)``, clamped at both ends.

    Rotations ``(R, 4)`` are interpolated along the shortest arc, points linearly.

    >>> interpolate_rows(np.array([[0.0], [2.0]]), np.array([0.25, 9.0])).tolist()
    [[0.5], [2.0]]
    """
    row_numbers = np.clip(row_numbers, 0.0, len(values) - 1.0)
    nearest_row = np.round(row_numbers)
    is_on_row = np.abs(row_numbers - nearest_row) <= ROW_TOLERANCE
    row_numbers = np.where(is_on_row, nearest_row, row_numbers)
    lower_rows = np.floor(row_numbers).astype(np.int64)
    fractions = row_numbers - lower_rows
    interpolated_values = values[lower_rows]
    is_fractional = fractions > 0
    if is_fractional.any():
        values_below = interpolated_values[is_fractional]
        fractions = fractions[is_fractional]
        values_above = values[lower_rows[is_fractional] + 1]
        if values.shape[1] == 4:
            new_values = so3.slerp(values_below, values_above, fractions)
        else:
            difference = values_above - values_below
            new_values = values_below + fractions[:, None] * difference
        interpolated_values[is_fractional] = new_values
    return interpolated_values


@dataclass(frozen=True, slots=True)
class PrimPoint:
    """A point that moves with a USD prim."""

    motion: PrimMotion  # motion of the prim
    offset: tuple[float, ...]  # the point in the prim's frame [m]

    def sample(self, frames: SampleFrames) -> FloatArray:
        """Return the world positions of the point at the sample times ``(F, 3)``."""
        positions, rotations = self.motion(frames.seconds)
        return np.asarray(positions + so3.rotate(rotations, np.array(self.offset)))


@dataclass(frozen=True, slots=True)
class PrimRotation:
    """A rotation that follows a USD prim."""

    motion: PrimMotion  # motion of the prim
    rotation: tuple[float, ...]  # quaternion relative to the prim's frame

    def sample(self, frames: SampleFrames) -> FloatArray:
        """Return the rotations that follow the prim at the sample times ``(F, 4)``."""
        _, prim_rotations = self.motion(frames.seconds)
        return so3.align_signs(so3.multiply(prim_rotations, np.array(self.rotation)))


@dataclass(frozen=True, slots=True)
class ValueReader:
    """Builds target values from a document, and records faults in the document."""

    document: Document  # the file
    rig: Rig | None  # prims are read in its world space; None reads no prims
    units: ClipUnits  # units of the file
    reference_roots: Sequence[Path]  # folders that references may lead into
    archives: Archives  # opens arrays while values are read
    first: Fraction | None  # frame of the first row of arrays; None for no range
    row_count: int | None  # required number of rows; None for no range

    def read_curve(
        self, location: Location, model: CurveModel, key: str
    ) -> KeyedValue | None:
        """Return the value or weight of a curve, or None after recording a fault."""
        reader = CurveReader(self.document, location, model)
        reader.check()
        kind = {"orientation": "rotation", "weight": "control"}.get(key, "translation")
        target = "control/x" if kind == "control" else f"joint/x.{kind}"
        unit = self.units.unit_of(target, model.euler or "")
        channel = reader.read_channel(key, kind, unit)
        return None if channel is None else KeyedValue(channel)

    def read_value(
        self, location: Location, model: list[float] | str | ValueModel | None, key: str
    ) -> SampledValue | None:
        """Return the value of a file entry of any form; None if absent or faulty."""
        if model is None or self.document.is_placeholder(location):
            return None
        if isinstance(model, str):
            return self._read_array(location, model, key)
        if isinstance(model, ValueModel):
            return self._read_keyed_or_prim(location, model, key)
        if key == "orientation":
            return self._read_rotation(location, model)
        return ConstantValue(tuple(value * self.units.length for value in model))

    def _read_rotation(
        self, location: Location, numbers: list[float]
    ) -> ConstantValue | None:
        """Return a constant rotation; record a fault and return None if it is zero."""
        rotations, is_invalid = file_quaternions(np.array([numbers], np.float64))
        if is_invalid:
            message = f"quaternion {numbers} has zero length"
            self.document.add("TGT007", location, message)
            return None
        warn_of_quaternion_length(self.document, location, numbers)
        return ConstantValue(tuple(rotations[0].tolist()))

    def _read_keyed_or_prim(
        self, location: Location, model: ValueModel, key: str
    ) -> SampledValue | None:
        """Return a value from keys or from a prim, or None after recording a fault."""
        if (model.keys is None) == (model.prim is None):
            message = "has neither keys nor a prim"
            if model.prim:
                message = "has both keys and a prim"
            self.document.add("TGT009", location, message, "write one of them")
            return None
        unsupported_keys = _PRIM_KEYS if model.keys is not None else _CURVE_KEYS
        unused_keys = [
            unused_key
            for unused_key in unsupported_keys
            if unused_key in model.model_fields_set
        ]
        if model.prim is not None and key != "orientation" and model.rotate:
            unused_keys.append("rotate")
        if key == "orientation" and model.offset:
            unused_keys.append("offset")
        for unused_key in dict.fromkeys(unused_keys):
            clause = "keys have" if model.keys is not None else "only a prim has here"
            self.document.add(
                "TGT009", (*location, unused_key), f"{clause} no {unused_key}"
            )
        if model.keys is not None:
            curve_options = {
                unused_key: getattr(model, unused_key)
                for unused_key in CurveModel.model_fields
                if unused_key in model.model_fields_set
            }
            curve = CurveModel.model_construct(**curve_options)
            return self.read_curve(location, curve, key)
        return self._read_prim(location, model, key)

    def _read_prim(
        self, location: Location, model: ValueModel, key: str
    ) -> SampledValue | None:
        """Return a value that follows a prim, or None after recording a fault."""
        motion = self._open_prim_motion(location, model)
        if motion is None:
            return None
        if key != "orientation":
            x, y, z = (v * self.units.length for v in model.offset or (0.0, 0.0, 0.0))
            return PrimPoint(motion, (x, y, z))
        numbers = model.rotate or [1.0, 0.0, 0.0, 0.0]
        rotation = self._read_rotation((*location, "rotate"), numbers)
        return None if rotation is None else PrimRotation(motion, rotation.value)

    def _open_prim_motion(
        self, location: Location, model: ValueModel
    ) -> PrimMotion | None:
        """Return the motion of a prim; None if it is unreadable, or there is no rig."""
        path = self._find_stage(location, model)
        if path is None:
            return None
        rig = self.rig or Rig("", ())
        try:
            open_prim = find_reader(path).prim_opener(path)
            motion = cast(PrimMotion, open_prim(path, model.prim, rig, model.space))
        except AnimtoolError as error:
            for fault in error.faults:
                location_key = "space" if fault.where == "space" else "prim"
                message = f"{model.file!r}: " + fault.message
                self.document.add(
                    "TGT011", (*location, location_key), message, fault.hint
                )
            return None
        return None if self.rig is None else motion

    def _find_stage(self, value_location: Location, model: ValueModel) -> Path | None:
        """Return the file of a prim; None if missing."""
        if model.file is None:
            message = f"prim {model.prim!r} has no file"
            self.document.add("TGT009", value_location, message, "add file: shot.usda")
            return None
        location = (*value_location, "file")
        path = resolve_reference(
            self.document, location, model.file, self.reference_roots
        )
        reason = None if path is None else not_a_file_reason(path)
        if reason is not None:
            hint = similar_file_hint(self.document, model.file)
            self.document.add("DOC015", location, f"{model.file!r} {reason}", hint)
            return None
        return path

    def _read_array(
        self, location: Location, reference_text: str, key: str
    ) -> ArrayRows | None:
        """Return the rows of an array that a text such as `file.npz#name` refers to."""
        file_name, array_name = split_reference(reference_text, key)
        path = resolve_reference(
            self.document, location, file_name, self.reference_roots
        )
        if path is None:
            return None
        try:
            values = np.asarray(self.archives.load_stored(path, array_name), np.float64)
        except ValueError as error:
            hint = None
            if not exists(path):
                numbers = "[w, x, y, z]" if key == "orientation" else "[x, y, z]"
                hint = similar_file_hint(self.document, file_name)
                hint = hint or f"write {numbers}, or an array, such as hands.npz#left"
            self.document.add("TGT006", location, str(error), hint)
            return None
        component_count = 4 if key == "orientation" else 3
        row_count = self.row_count
        if values.ndim != 2 or values.shape[1] != component_count or not len(values):
            row_text = "F" if row_count is None else row_count
            message = f"{reference_text!r} has shape {values.shape}, "
            message += f"not ({row_text}, {component_count})"
            self.document.add("TGT006", location, message)
            return None
        if row_count is not None and len(values) != row_count:
            rows_text = counted(len(values), "row")
            message = f"{reference_text!r} has {rows_text}, but the range has "
            message += counted(row_count, "frame")
            self.document.add("TGT006", location, message, "write a row for each frame")
            return None
        return self._check_finite(location, reference_text, values)

    def _check_finite(
        self, array_location: Location, reference_text: str, values: FloatArray
    ) -> ArrayRows | None:
        """Return finite rows of an array, or None after recording a fault."""
        invalid_rows = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if invalid_rows.size:
            i = int(invalid_rows[0])
            message = (
                f"{reference_text!r} holds {values[i].tolist()} in row {i}, not finite "
            )
            message += "numbers"
            self.document.add("TGT007", array_location, message)
            return None
        location = self.document.position(array_location)
        if values.shape[1] == 3:
            return ArrayRows(
                reference_text, values * self.units.length, self.first, location
            )
        rotations, is_invalid = file_quaternions(values)
        if is_invalid:
            row = is_invalid[0]
            message = (
                f"{reference_text!r} contains a quaternion of zero length in row {row}"
            )
            self.document.add("TGT007", array_location, message)
            return None
        k = int(np.abs(np.linalg.norm(values, axis=1) - 1.0).argmax())
        warn_of_quaternion_length(self.document, array_location, values[k].tolist())
        return ArrayRows(reference_text, rotations, self.first, location)
