"""Parsing of a curve's keys into a channel."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from animtool.clip.channels import ClipChannel
from animtool.clip.schema import CurveModel, KeyModel, PlainKeys, key_times
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
_COMPONENT_COUNTS = {
    **dict.fromkeys(("control", "shape", "angle", "slide"), 1),
    **dict.fromkeys(("translation", "rotation", "scale"), 3),
}
# Shorter quaternions are mistakes, not rotations.
MIN_QUATERNION_LENGTH = 1e-9


@dataclass(slots=True)
class CurveReader:
    """Builds a channel from a curve of a document; records faults in the document."""

    document: Document  # the file
    location: Location  # location of the curve
    model: CurveModel  # the curve

    def check(self) -> None:
        """Record unordered times, and handles on the wrong side of their keys."""
        self._check_times(key_times(self.model))
        self._check_handles()

    def read_channel(self, target: str, kind: str, unit: float) -> ClipChannel | None:
        """Return the channel of the curve; None if its values have the wrong width.

        ``kind`` is the target's, such as ``angle`` or ``rotation``; ``unit`` the size
        of a value of 1.
        """
        model = self.model
        is_quaternion = kind == "rotation" and model.euler is None
        component_count = 4 if is_quaternion else _COMPONENT_COUNTS[kind]
        if model.euler is not None and kind != "rotation":
            message = f"{target!r} is not a rotation"
            self._add("CLIP009", ("euler",), message, "remove euler")
        allowed_interps = _QUATERNION_INTERPS if is_quaternion else _NUMBER_INTERPS
        default_interp = Interp.SPLINE if is_quaternion else Interp.BEZIER
        interp = Interp(model.interp or default_interp)
        tangent = Tangent(model.tangents)
        repeat_count = component_count if kind == "scale" else 1  # of a single number
        keys, array_name = model.keys, ""
        if isinstance(keys, PlainKeys):
            array_name = keys.name
            is_single = keys.values.shape[1] == 1
            values = np.repeat(keys.values, repeat_count if is_single else 1, axis=1)
            is_valid = interp in allowed_interps and values.shape[1] == component_count
            if array_name and not is_valid:
                self._check_interps(target, allowed_interps)
                self._check_row_width(keys, component_count)
                return None
            if not is_valid:
                entries = keys.entries()
                keys = [KeyModel.model_construct(**entry) for entry in entries]
                self.model = model.model_copy(update={"keys": keys})
        if isinstance(keys, PlainKeys):
            if is_quaternion:
                self._check_no_tangents(())
            else:
                self._warn_of_parametrization({interp})
            key_count, times = len(keys), keys.times
            interps, tangents = (interp,) * key_count, ((tangent, tangent),) * key_count
            in_handles = out_handles = np.zeros((key_count, 1 + component_count))
            tcb = np.zeros((key_count, 3))
        else:
            interps = tuple(Interp(k.interp) if k.interp else interp for k in keys)
            if self._check_interps(target, allowed_interps):
                if is_quaternion:
                    self._check_no_tangents(keys)
                else:
                    self._warn_of_unused_handles(interps)
            key_values = self._read_values(component_count, repeat_count)
            handles = [
                [
                    (tangent, [0.0] * (1 + component_count))
                    if is_quaternion or handle is None
                    else self._read_handle(
                        ("keys", k, name), handle, component_count, repeat_count, unit
                    )
                    for name, handle in (("in", key.in_), ("out", key.out))
                ]
                for k, key in enumerate(keys)
            ]
            if key_values is None:
                return None
            values, times = key_values, np.array([key.t for key in keys])
            tangents = tuple((before[0], after[0]) for before, after in handles)
            in_handles = np.array([before[1] for before, _ in handles])
            out_handles = np.array([after[1] for _, after in handles])
            tcb = np.array([key.tcb or [0.0, 0.0, 0.0] for key in keys])
        return ClipChannel(
            target,
            times,
            self._read_quaternions(values, array_name)
            if is_quaternion
            else values * unit,
            interps,
            tangents,
            in_handles,
            out_handles,
            tcb,
            Parametrization(model.parametrization),
            model.euler or "",
            Extrapolation(model.pre),
            Extrapolation(model.post),
        )

    def _add(
        self, code: str, key: Location, message: str, hint: str | None = None
    ) -> None:
        """Record a fault at a key of the curve."""
        self.document.add(code, (*self.location, *key), message, hint)

    def _check_row_width(self, keys: PlainKeys, component_count: int) -> None:
        """Record a fault if the rows of an array do not have a value's components."""
        if keys.values.shape[1] != component_count:
            message = f"rows of {keys.name!r} have {keys.values.shape[1] + 1} numbers "
            message += f"instead of {component_count + 1}: a time, then the value"
            self._add("CLIP007", ("keys",), message)

    def _check_interps(self, target: str, allowed_interps: frozenset[Interp]) -> bool:
        """Return whether all interpolations apply; record those that do not."""
        interps: list[tuple[Location, str | None]] = [(("interp",), self.model.interp)]
        interps += [
            (("keys", k, "interp"), key.interp)
            for k, key in enumerate(self._key_models)
        ]
        forbidden_interps = [
            (location, name)
            for location, name in interps
            if name is not None and Interp(name) not in allowed_interps
        ]
        for location, name in forbidden_interps:
            hint = f"allowed: {', '.join(sorted(allowed_interps))}"
            if name == Interp.SPLINE:
                hint = f"spline is for quaternions; for numbers, {hint}"
            message = f"{name} does not apply to {target!r}"
            self._add("CLIP009", location, message, hint)
        return not forbidden_interps

    def _check_times(self, times: FloatArray) -> None:
        """Record times beyond the limit, and times that do not ascend."""
        if (np.abs(times) <= MAX_FRAME).all() and (np.diff(times) > 0).all():
            return
        if isinstance(self.model.keys, PlainKeys) and self.model.keys.name:
            self._add_time_fault(self.model.keys)
            return
        for k in np.flatnonzero(np.abs(times) > MAX_FRAME).tolist():
            message = f"frame {times[k]:g} is beyond {MAX_FRAME:.0e}"
            self._add("CLIP004", ("keys", k, "t"), message)
        for k, previous in self.document.unordered_entries(
            (*self.location, "keys"), times.tolist(), "t"
        ):
            if self._is_misplaced(times, previous, k):
                self._add_misplaced_key(times, previous, k)
                continue
            message = f"frame {times[k]:g} comes before the key at {times[previous]:g}"
            if times[k] == times[previous]:
                message = f"frame {times[k]:g} appears twice"
            self._add("CLIP004", ("keys", k, "t"), message, "key times must ascend")

    def _is_misplaced(self, times: FloatArray, k: int, following: int) -> bool:
        """Return whether a key, not the one after it, is at the wrong time.

        Without it the keys around it ascend; and the next but one is before it too, or
        the range of the clip ends before it.
        """
        if k and not times[k - 1] < times[following]:
            return False
        is_outside = False
        match self.document.value.get("range"):
            case [int() | float() as first, int() | float() as last]:
                is_outside = bool(first < last < times[k])
        later_times = times[following + 1 : following + 2]
        return is_outside or bool((later_times < times[k]).any())

    def _add_misplaced_key(self, times: FloatArray, k: int, following: int) -> None:
        """Record a key that is later than the one after it."""
        message = (
            f"frame {times[k]:g} comes after the next key, at {times[following]:g}"
        )
        hint = f"write a frame before {times[following]:g}"
        if k:
            hint = f"write a frame between {times[k - 1]:g} and {times[following]:g}"
            likely_frame = times[k] / 10
            if times[k - 1] < likely_frame < times[following]:
                hint += f", such as {likely_frame:g}"
        self._add("CLIP004", ("keys", k, "t"), message, hint)

    def _add_time_fault(self, keys: PlainKeys) -> None:
        """Record the first invalid time of an array of keys."""
        times = keys.times
        rows_beyond = np.flatnonzero(np.abs(times) > MAX_FRAME)
        if len(rows_beyond):
            row = rows_beyond[0]
            message = f"frame {times[row]:g} in row {row} of {keys.name!r} is beyond "
            self._add("CLIP004", ("keys",), f"{message}{MAX_FRAME:.0e}")
            return
        k = int(np.argmax(np.diff(times) <= 0)) + 1
        message = f"frame {times[k]:g} in row {k} of {keys.name!r} follows frame "
        hint = "key times must ascend"
        self._add("CLIP004", ("keys",), f"{message}{times[k - 1]:g}", hint)

    def _check_handles(self) -> None:
        """Record handles that point to the wrong side of their keys."""
        for k, key in enumerate(self._key_models):
            for name, handle, sign in (("in", key.in_, -1), ("out", key.out, 1)):
                if not isinstance(handle, list) or isinstance(handle[0], list):
                    continue
                if handle[0] * sign < 0:
                    side_text = "before" if sign < 0 else "after"
                    message = f"the handle's time {handle[0]:g} points the wrong way"
                    handle_text = flow_text(name, [-handle[0], handle[1]])
                    hint = f"write {handle_text}: '{name}' is {side_text} its key"
                    self._add("CLIP005", ("keys", k, name), message, hint)

    def _check_no_tangents(self, keys: Sequence[KeyModel]) -> None:
        """Record handles and tangents of quaternion keys, which do not support them."""
        hint = "write euler: XYZ to key three angles, which have them"
        locations: list[tuple[Location, CurveModel | KeyModel, tuple[str, ...]]]
        locations = [((), self.model, ("tangents", "parametrization"))]
        locations += [
            (("keys", k), key, ("in_", "out", "tcb")) for k, key in enumerate(keys)
        ]
        for location, entry, field_names in locations:
            for name in field_names:
                if name in entry.model_fields_set:
                    key = name.rstrip("_")
                    message = f"quaternions have no {key}"
                    self._add("CLIP009", (*location, key), message, hint)

    def _warn_of_unused_handles(self, interps: tuple[Interp, ...]) -> None:
        """Warn of handles that the adjacent interpolation does not use.

        Handles before the first and after the last key are allowed.
        """
        inner_interps = interps[:-1]
        for k, key in enumerate(self._key_models):
            interp_before = interps[max(k - 1, 0) : k]
            interp_after = inner_interps[k : k + 1]
            for name, handle, adjacent_interps, supporting_interps in (
                ("in", key.in_, interp_before, _HANDLE_INTERPS),
                ("out", key.out, interp_after, _HANDLE_INTERPS),
                ("tcb", key.tcb, interp_before + interp_after, {Interp.TCB}),
            ):
                is_set = handle is not None and adjacent_interps
                if is_set and not supporting_interps & {*adjacent_interps}:
                    interp_names = " and ".join(dict.fromkeys(adjacent_interps))
                    message = f"'{name}' has no effect with {interp_names}"
                    hint = f"it applies to {' and '.join(sorted(supporting_interps))}"
                    location = (*self.location, "keys", k, name)
                    self.document.warn("CLIP104", location, message, hint)
        self._warn_of_parametrization({*(interps[:-1] or interps)})

    def _warn_of_parametrization(self, interps: Collection[Interp]) -> None:
        """Warn of a Catmull-Rom parametrization without Catmull-Rom keys."""
        is_set = "parametrization" in self.model.model_fields_set
        if is_set and Interp.CATMULL_ROM not in interps:
            message = "'parametrization' has no effect without catmull_rom"
            location = (*self.location, "parametrization")
            self.document.warn("CLIP104", location, message)

    def _read_values(
        self, component_count: int, repeat_count: int
    ) -> FloatArray | None:
        """Return the values of keys ``(K, D)``, or None after recording a fault."""
        value_rows = []
        shown_hints: set[str] = set()  # hints that hold for the channel
        for k, key in enumerate(self._key_models):
            value_row = _value_row(key.v, repeat_count)
            if len(value_row) != component_count:
                location = (*self.location, "keys", k, "v")
                hint = _rotation_hint(self.model, len(value_row), component_count)
                if hint not in shown_hints:
                    number_text = counted(len(value_row), "number")
                    message = f"{number_text} instead of {component_count}"
                    if not hint:
                        hint = self.document.decimal_comma_hint(
                            location, component_count
                        ) or _form_hint(self.model, component_count)
                    self.document.add("CLIP007", location, message, hint)
                    shown_hints |= {hint} if hint else set()
                continue
            value_rows.append(value_row)
        if len(value_rows) < len(self._key_models):
            return None
        return np.array(value_rows, np.float64)

    def _read_handle(
        self,
        location: Location,
        handle: str | list[Any],
        component_count: int,
        repeat_count: int,
        unit: float,
    ) -> tuple[Tangent, list[float]]:
        """Return the tangent and the offsets of a handle; record a wrong width."""
        no_handle = [0.0] * (1 + component_count)
        if isinstance(handle, str):
            return Tangent(handle), no_handle
        dt, dv = handle
        values = _value_row(dv, repeat_count)
        if not isinstance(dt, list) and len(values) == component_count:
            return Tangent.FREE, [dt, *(value * unit for value in values)]
        name = str(location[-1])
        message = f"the handle is not a time and {counted(component_count, 'value')}"
        zeros = [0] * component_count if component_count > 1 else 0
        hint = f"for example {flow_text(name, [-2 if name == 'in' else 2, zeros])}"
        self._add("CLIP007", location, message, hint)
        return Tangent.FREE, no_handle

    def _read_quaternions(self, values: FloatArray, array_name: str) -> FloatArray:
        """Convert quaternions [w, x, y, z] to unit (x, y, z, w); record zero ones."""
        rotations, zero_rows = file_quaternions(values)
        if not zero_rows and len(values):
            k = int(np.abs(np.linalg.norm(values, axis=1) - 1.0).argmax())
            row_location = () if array_name else (k, "v")
            location = (*self.location, "keys", *row_location)
            warn_of_quaternion_length(self.document, location, values[k].tolist())
        if array_name and zero_rows:
            message = f"row {zero_rows[0]} of {array_name!r} is a quaternion of "
            self._add("RIG006", ("keys",), f"{message}zero length")
            return rotations
        for k in zero_rows:
            message = f"quaternion {values[k].tolist()} has zero length"
            self._add("RIG006", ("keys", k, "v"), message)
        return rotations

    @property
    def _key_models(self) -> list[KeyModel]:
        """The keys as models; empty if they are columns."""
        return [] if isinstance(self.model.keys, PlainKeys) else self.model.keys


def _rotation_hint(
    model: CurveModel, number_count: int, component_count: int
) -> str | None:
    """Return a hint if a rotation's keys have the width of another representation."""
    if component_count == 4 and number_count == 3:
        return "add 'euler: XYZ' to the channel, or write quaternions [w, x, y, z]"
    if model.euler and number_count == 4:
        return "remove 'euler' for quaternions, or write three angles"
    return None


def _form_hint(model: CurveModel, component_count: int) -> str:
    """Return a hint with the form of a key's value."""
    if component_count == 1:
        return "write one number"
    form_by_width = {3: "x, y, z", 4: "w, x, y, z"}
    form = (
        ", ".join(model.euler.lower())
        if model.euler
        else form_by_width[component_count]
    )
    return f"write [{form}]"


def _value_row(value: float | list[float], repeat_count: int) -> list[float]:
    """Return a value as a list; a single number is repeated ``repeat_count`` times."""
    values = value if isinstance(value, list) else [value]
    return values * repeat_count if len(values) == 1 else values


def file_quaternions(values: FloatArray) -> tuple[FloatArray, list[int]]:
    """Convert rows [w, x, y, z] to unit (x, y, z, w); also return the zero rows.

    Signs are continuous from row to row.

    >>> file_quaternions(np.array([[2.0, 0, 0, 0], [0, 0, 0, 0]]))[1]
    [1]
    """
    lengths = np.linalg.norm(values, axis=1)
    rotations = values[:, [1, 2, 3, 0]]
    is_near_unit = np.abs(lengths - 1.0) <= UNIT_TOLERANCE
    rotations[~is_near_unit] = so3.normalize(rotations[~is_near_unit])
    zero_rows = np.flatnonzero(~(lengths > MIN_QUATERNION_LENGTH)).tolist()
    return so3.align_signs(rotations), zero_rows
