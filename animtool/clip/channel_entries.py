"""Parsing of a curve's keys into a channel."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from animtool.clip.channels import ClipChannel
from animtool.clip.plain_keys import PlainKeys
from animtool.clip.schema import CurveModel, KeyModel, key_times
from animtool.core.array_types import FloatArray
from animtool.core.errors import counted
from animtool.core.record import dataclass
from animtool.documents.document import Document, Location
from animtool.documents.fields import MAX_FRAME
from animtool.documents.yaml_text import flow_text
from animtool.maths import so3
from animtool.maths.curves import Extrapolation, Interp
from animtool.maths.tangents import Parametrization, Tangent
from animtool.rig.joint_entries import UNIT_TOLERANCE
from animtool.rig.suspicions import warn_of_quaternion_length

_QUATERNION_INTERPS = frozenset(
    {Interp.STEP, Interp.SLERP, Interp.SQUAD, Interp.SPLINE}
)
_NUMBER_INTERPS = frozenset(Interp) - {Interp.SLERP, Interp.SQUAD, Interp.SPLINE}
# Interpolations with handles.
_HANDLE_INTERPS = {Interp.BEZIER, Interp.HERMITE}
# Number of components; for rotations, of Euler angles.
_WIDTHS = {
    **dict.fromkeys(("control", "shape", "angle", "slide"), 1),
    **dict.fromkeys(("translation", "rotation", "scale"), 3),
}
# Shorter quaternions are mistakes, not rotations.
MIN_QUATERNION = 1e-9


@dataclass(frozen=True, slots=True)
class ChannelReader:
    """Builds channels from a document's curves; records faults in the document."""

    document: Document  # the file

    def check_curve(self, location: Location, model: CurveModel) -> None:
        """Record unordered times, and handles on the wrong side of their keys."""
        self._check_times(location, model, key_times(model))
        self._check_handles(location, model)

    def read_channel(
        self, location: Location, model: CurveModel, target: str, kind: str, unit: float
    ) -> ClipChannel | None:
        """Return the channel of a curve; None if its values have the wrong width.

        Args:
            location: Location of the curve.
            model: The curve.
            target: Target of the channel, also for messages.
            kind: Target kind, such as ``angle``, ``translation`` or ``rotation``.
            unit: Size of a value of 1.
        """
        is_quaternion = kind == "rotation" and model.euler is None
        components = 4 if is_quaternion else _WIDTHS[kind]
        if model.euler is not None and kind != "rotation":
            message = f"{target!r} is not a rotation"
            self.document.add("CLIP009", (*location, "euler"), message, "remove euler")
        allowed_interps = _QUATERNION_INTERPS if is_quaternion else _NUMBER_INTERPS
        default_interp = Interp.SPLINE if is_quaternion else Interp.BEZIER
        interp, tangent = (
            Interp(model.interp or default_interp),
            Tangent(model.tangents),
        )
        repeats = components if kind == "scale" else 1  # of a single number
        keys, array_name = model.keys, ""
        if isinstance(keys, PlainKeys):
            array_name = keys.name
            is_single = keys.values.shape[1] == 1
            values = np.repeat(keys.values, repeats if is_single else 1, axis=1)
            is_valid = interp in allowed_interps and values.shape[1] == components
            if array_name and not is_valid:
                self._check_interps(location, model, target, allowed_interps)
                self._check_row_width(location, keys, components)
                return None
            if not is_valid:
                entries = keys.entries()
                keys = [KeyModel.model_construct(**entry) for entry in entries]
                model = model.model_copy(update={"keys": keys})
        if isinstance(keys, PlainKeys):
            if is_quaternion:
                self._check_no_slopes(location, model, ())
            else:
                self._warn_of_path(location, model, {interp})
            count, times = len(keys), keys.times
            interps, tangents = (interp,) * count, ((tangent, tangent),) * count
            ins = outs = np.zeros((count, 1 + components))
            tcb = np.zeros((count, 3))
        else:
            interps = tuple(Interp(k.interp) if k.interp else interp for k in keys)
            if self._check_interps(location, model, target, allowed_interps):
                if is_quaternion:
                    self._check_no_slopes(location, model, keys)
                else:
                    self._warn_of_unused_handles(location, model, interps)
            read_values = self._read_values(location, model, components, repeats)
            handles = [
                [
                    (tangent, [0.0] * (1 + components))
                    if is_quaternion or handle is None
                    else self._read_handle(
                        (*location, "keys", k, name), handle, components, repeats, unit
                    )
                    for name, handle in (("in", key.in_), ("out", key.out))
                ]
                for k, key in enumerate(keys)
            ]
            if read_values is None:
                return None
            values, times = read_values, np.array([key.t for key in keys])
            tangents = tuple((before[0], after[0]) for before, after in handles)
            ins = np.array([before[1] for before, _ in handles])
            outs = np.array([after[1] for _, after in handles])
            tcb = np.array([key.tcb or [0.0, 0.0, 0.0] for key in keys])
        return ClipChannel(
            target,
            times,
            self._read_quaternions(location, values, array_name)
            if is_quaternion
            else values * unit,
            interps,
            tangents,
            ins,
            outs,
            tcb,
            Parametrization(model.parametrization),
            model.euler or "",
            Extrapolation(model.pre),
            Extrapolation(model.post),
        )

    def _check_row_width(
        self, location: Location, keys: PlainKeys, components: int
    ) -> None:
        """Record a fault if the rows of an array do not have a value's components."""
        if keys.values.shape[1] != components:
            message = f"rows of {keys.name!r} have {keys.values.shape[1] + 1} numbers "
            message += f"instead of {components + 1}: a time, then the value"
            self.document.add("CLIP007", (*location, "keys"), message)

    def _check_interps(
        self,
        curve_location: Location,
        model: CurveModel,
        target: str,
        allowed_interps: frozenset[Interp],
    ) -> bool:
        """Return whether all interpolations apply; record those that do not."""
        named_interps: list[tuple[Location, str | None]] = [
            ((*curve_location, "interp"), model.interp)
        ]
        named_interps += [
            ((*curve_location, "keys", k, "interp"), key.interp)
            for k, key in enumerate(_key_models(model))
        ]
        not_allowed = [
            (location, name)
            for location, name in named_interps
            if name is not None and Interp(name) not in allowed_interps
        ]
        for location, name in not_allowed:
            hint = f"allowed: {', '.join(sorted(allowed_interps))}"
            if name == Interp.SPLINE:
                hint = f"spline is for quaternions; for numbers, {hint}"
            message = f"{name} does not apply to {target!r}"
            self.document.add("CLIP009", location, message, hint)
        return not not_allowed

    def _check_times(
        self, curve_location: Location, model: CurveModel, times: FloatArray
    ) -> None:
        """Record times beyond the limit, and times that do not ascend."""
        if (np.abs(times) <= MAX_FRAME).all() and (np.diff(times) > 0).all():
            return
        if isinstance(model.keys, PlainKeys) and model.keys.name:
            self._add_time_fault((*curve_location, "keys"), model.keys)
            return
        for k in np.flatnonzero(np.abs(times) > MAX_FRAME).tolist():
            message = f"frame {times[k]:g} is beyond {MAX_FRAME:.0e}"
            self.document.add("CLIP004", (*curve_location, "keys", k, "t"), message)
        for k, previous in self.document.not_ascending(
            (*curve_location, "keys"), times.tolist(), "t"
        ):
            message = f"frame {times[k]:g} comes before the key at {times[previous]:g}"
            if times[k] == times[previous]:
                message = f"frame {times[k]:g} appears twice"
            location = (*curve_location, "keys", k, "t")
            self.document.add("CLIP004", location, message, "key times must ascend")

    def _add_time_fault(self, location: Location, keys: PlainKeys) -> None:
        """Record the first invalid time of an array of keys."""
        times = keys.times
        rows_beyond = np.flatnonzero(np.abs(times) > MAX_FRAME)
        if len(rows_beyond):
            row = rows_beyond[0]
            message = f"frame {times[row]:g} in row {row} of {keys.name!r} is beyond "
            self.document.add("CLIP004", location, f"{message}{MAX_FRAME:.0e}")
            return
        k = int(np.argmax(np.diff(times) <= 0)) + 1
        message = f"frame {times[k]:g} in row {k} of {keys.name!r} follows frame "
        hint = "key times must ascend"
        self.document.add("CLIP004", location, f"{message}{times[k - 1]:g}", hint)

    def _check_handles(self, curve_location: Location, model: CurveModel) -> None:
        """Record handles that point to the wrong side of their keys."""
        for k, key in enumerate(_key_models(model)):
            for name, handle, sign in (("in", key.in_, -1), ("out", key.out, 1)):
                if not isinstance(handle, list) or isinstance(handle[0], list):
                    continue
                if handle[0] * sign < 0:
                    side_text = "before" if sign < 0 else "after"
                    message = f"the handle's time {handle[0]:g} points the wrong way"
                    handle_text = flow_text(name, [-handle[0], handle[1]])
                    hint = f"write {handle_text}: '{name}' is {side_text} its key"
                    location = (*curve_location, "keys", k, name)
                    self.document.add("CLIP005", location, message, hint)

    def _check_no_slopes(
        self, curve_location: Location, model: CurveModel, keys: Sequence[KeyModel]
    ) -> None:
        """Record handles and tangents of quaternion keys, which do not support them."""
        hint = "write euler: XYZ to key three angles, which have them"
        locations: list[tuple[Location, CurveModel | KeyModel, tuple[str, ...]]]
        locations = [(curve_location, model, ("tangents", "parametrization"))]
        locations += [
            ((*curve_location, "keys", k), key, ("in_", "out", "tcb"))
            for k, key in enumerate(keys)
        ]
        for location, entry, names in locations:
            for name in names:
                if name in entry.model_fields_set:
                    key = name.rstrip("_")
                    message = f"quaternions have no {key}"
                    self.document.add("CLIP009", (*location, key), message, hint)

    def _warn_of_unused_handles(
        self, curve_location: Location, model: CurveModel, interps: tuple[Interp, ...]
    ) -> None:
        """Warn of handles that the adjacent interpolation does not use.

        Handles before the first and after the last key are allowed.
        """
        inner_interps = interps[:-1]
        for k, key in enumerate(_key_models(model)):
            interp_before = interps[max(k - 1, 0) : k]
            interp_after = inner_interps[k : k + 1]
            for name, handle, props, expected in (
                ("in", key.in_, interp_before, _HANDLE_INTERPS),
                ("out", key.out, interp_after, _HANDLE_INTERPS),
                ("tcb", key.tcb, interp_before + interp_after, {Interp.TCB}),
            ):
                if handle is not None and props and not expected & {*props}:
                    property_names = " and ".join(dict.fromkeys(props))
                    message = f"'{name}' has no effect with {property_names}"
                    hint = f"it applies to {' and '.join(sorted(expected))}"
                    location = (*curve_location, "keys", k, name)
                    self.document.warn("CLIP104", location, message, hint)
        self._warn_of_path(curve_location, model, {*(interps[:-1] or interps)})

    def _warn_of_path(
        self, location: Location, model: CurveModel, segments: Collection[Interp]
    ) -> None:
        """Warn of a Catmull-Rom parametrization without Catmull-Rom keys."""
        is_set = "parametrization" in model.model_fields_set
        if is_set and Interp.CATMULL_ROM not in segments:
            message = "'parametrization' has no effect without catmull_rom"
            self.document.warn("CLIP104", (*location, "parametrization"), message)

    def _read_values(
        self, curve_location: Location, model: CurveModel, components: int, repeats: int
    ) -> FloatArray | None:
        """Return the values of keys ``(K, D)``; None with a fault otherwise."""
        value_rows = []
        shown_hints: set[str] = set()  # hints that hold for the channel
        for k, key in enumerate(_key_models(model)):
            value_row = _value_row(key.v, repeats)
            if len(value_row) != components:
                location = (*curve_location, "keys", k, "v")
                hint = _form_hint(model, len(value_row), components)
                if hint not in shown_hints:
                    count = counted(len(value_row), "number")
                    message = f"{count} instead of {components}"
                    hint = hint or self.document.decimal_commas(location, components)
                    self.document.add("CLIP007", location, message, hint)
                    shown_hints |= {hint} if hint else set()
                continue
            value_rows.append(value_row)
        if len(value_rows) < len(_key_models(model)):
            return None
        return np.array(value_rows, np.float64)

    def _read_handle(
        self,
        location: Location,
        handle: str | list[Any],
        components: int,
        repeats: int,
        unit: float,
    ) -> tuple[Tangent, list[float]]:
        """Return the tangent and the offsets of a handle; record a wrong width."""
        no_handle = [0.0] * (1 + components)
        if isinstance(handle, str):
            return Tangent(handle), no_handle
        dt, dv = handle
        values = _value_row(dv, repeats)
        if not isinstance(dt, list) and len(values) == components:
            return Tangent.FREE, [dt, *(value * unit for value in values)]
        name = str(location[-1])
        message = f"the handle is not a time and {counted(components, 'value')}"
        zeros = [0] * components if components > 1 else 0
        hint = f"for example {flow_text(name, [-2 if name == 'in' else 2, zeros])}"
        self.document.add("CLIP007", location, message, hint)
        return Tangent.FREE, no_handle

    def _read_quaternions(
        self, curve_location: Location, values: FloatArray, array_name: str
    ) -> FloatArray:
        """Convert quaternions [w, x, y, z] to unit (x, y, z, w); record zero ones."""
        rotations, zero_rows = file_quaternions(values)
        if not zero_rows and len(values):
            k = int(np.abs(np.linalg.norm(values, axis=1) - 1.0).argmax())
            row_location = () if array_name else (k, "v")
            location = (*curve_location, "keys", *row_location)
            warn_of_quaternion_length(self.document, location, values[k].tolist())
        if array_name and zero_rows:
            message = f"row {zero_rows[0]} of {array_name!r} is a quaternion of "
            location = (*curve_location, "keys")
            self.document.add("RIG006", location, f"{message}zero length")
            return rotations
        for k in zero_rows:
            message = f"quaternion {values[k].tolist()} has zero length"
            self.document.add("RIG006", (*curve_location, "keys", k, "v"), message)
        return rotations


def _form_hint(model: CurveModel, count: int, components: int) -> str | None:
    """Return a hint if a rotation's keys have the width of another representation."""
    if components == 4 and count == 3:
        return "add 'euler: XYZ' to the channel, or write quaternions [w, x, y, z]"
    if model.euler and count == 4:
        return "remove 'euler' for quaternions, or write three angles"
    return None


def _value_row(value: float | list[float], repeats: int) -> list[float]:
    """Return a value as a list; a single number as often as ``repeats``."""
    values = value if isinstance(value, list) else [value]
    return values * repeats if len(values) == 1 else values


def _key_models(model: CurveModel) -> list[KeyModel]:
    """Return the keys as models."""
    return [] if isinstance(model.keys, PlainKeys) else model.keys


def file_quaternions(values: FloatArray) -> tuple[FloatArray, list[int]]:
    """Convert rows [w, x, y, z] to unit (x, y, z, w); also return rows of zeros.

    Signs are continuous from row to row.

    >>> file_quaternions(np.array([[2.0, 0, 0, 0], [0, 0, 0, 0]]))[1]
    [1]
    """
    lengths = np.linalg.norm(values, axis=1)
    rotations = values[:, [1, 2, 3, 0]]
    is_near_unit = np.abs(lengths - 1.0) <= UNIT_TOLERANCE
    rotations[~is_near_unit] = so3.normalize(rotations[~is_near_unit])
    zero_rows = np.flatnonzero(~(lengths > MIN_QUATERNION)).tolist()
    return so3.align_signs(rotations), zero_rows
