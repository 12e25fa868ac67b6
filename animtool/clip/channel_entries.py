"""Parsing of a curve's keys into a channel."""

from __future__ import annotations

from collections.abc import Collection, Sequence

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
        default_interp = Interp.SPLINE if is_quaternion else Interp.BEZIER
        if isinstance(model.keys, PlainKeys):
            plain_channel = self._plain_channel(location, model, target, kind, unit)
            if plain_channel is not None:
                return plain_channel
            if model.keys.name:
                self._add_array_fault(
                    location, model, target, is_quaternion, components
                )
                return None
            key_models = [
                KeyModel.model_construct(**entry) for entry in model.keys.entries()
            ]
            model = model.model_copy(update={"keys": key_models})
        interps = tuple(
            Interp(k.interp or model.interp or default_interp)
            for k in _key_models(model)
        )
        has_allowed_interps = self._check_interps(
            location,
            model,
            target,
            _QUATERNION_INTERPS if is_quaternion else _NUMBER_INTERPS,
        )
        if is_quaternion and has_allowed_interps:
            self._check_no_slopes(location, model, _key_models(model))
        if not is_quaternion and has_allowed_interps:
            self._warn_of_unused_handles(location, model, interps)
        values = self._read_values(location, model, components, kind == "scale")
        is_positive = kind == "scale"
        handles = [
            self._read_handles(
                (*location, "keys", k), key, model, components, unit, is_positive
            )
            for k, key in enumerate(_key_models(model))
        ]
        if values is None:
            return None
        return ClipChannel(
            target,
            np.array([key.t for key in _key_models(model)]),
            self._read_quaternions(location, values)
            if is_quaternion
            else values * unit,
            interps,
            tuple(
                (tangent_before, tangent_after)
                for tangent_before, _, tangent_after, _ in handles
            ),
            np.array([handle for _, handle, _, _ in handles]),
            np.array([handle for *_, handle in handles]),
            np.array([key.tcb or [0.0, 0.0, 0.0] for key in _key_models(model)]),
            Parametrization(model.parametrization),
            model.euler or "",
            Extrapolation(model.pre),
            Extrapolation(model.post),
        )

    def _plain_channel(
        self, location: Location, model: CurveModel, target: str, kind: str, unit: float
    ) -> ClipChannel | None:
        """Return the channel of plain keys; record a fault and return None if bad."""
        keys = model.keys
        assert isinstance(keys, PlainKeys)
        is_quaternion = kind == "rotation" and model.euler is None
        components = 4 if is_quaternion else _WIDTHS[kind]
        interp = Interp(
            model.interp or (Interp.SPLINE if is_quaternion else Interp.BEZIER)
        )
        values = keys.values
        if kind == "scale" and values.shape[1] == 1:
            values = np.repeat(values, components, axis=1)
        if interp not in (_QUATERNION_INTERPS if is_quaternion else _NUMBER_INTERPS):
            return None
        if values.shape[1] != components:
            return None
        if is_quaternion:
            self._check_no_slopes(location, model, ())
        else:
            self._warn_of_path(location, model, {interp})
        count, tangent = len(keys), Tangent(model.tangents)
        no_handles = np.zeros((count, 1 + components))
        return ClipChannel(
            target,
            keys.times,
            self._read_quaternions(location, values, keys.name)
            if is_quaternion
            else values * unit,
            (interp,) * count,
            ((tangent, tangent),) * count,
            no_handles,
            no_handles,
            np.zeros((count, 3)),
            Parametrization(model.parametrization),
            model.euler or "",
            Extrapolation(model.pre),
            Extrapolation(model.post),
        )

    def _add_array_fault(
        self,
        location: Location,
        model: CurveModel,
        target: str,
        is_quaternion: bool,
        components: int,
    ) -> None:
        """Record a fault that states why an array's keys do not fit their target."""
        keys = model.keys
        assert isinstance(keys, PlainKeys)
        self._check_interps(
            location,
            model,
            target,
            _QUATERNION_INTERPS if is_quaternion else _NUMBER_INTERPS,
        )
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
            is_duplicate = times[k] == times[previous]
            problem = (
                "appears twice"
                if is_duplicate
                else (f"comes before the key at {times[previous]:g}")
            )
            location = (*curve_location, "keys", k, "t")
            hint = "key times must ascend"
            self.document.add(
                "CLIP004", location, f"frame {times[k]:g} {problem}", hint
            )

    def _add_time_fault(self, location: Location, keys: PlainKeys) -> None:
        """Record the first invalid time of an array of keys."""
        times = keys.times
        rows_beyond = np.flatnonzero(np.abs(times) > MAX_FRAME)
        if len(rows_beyond):
            row = rows_beyond[0]
            message = f"frame {times[row]:g} in row {row} of {keys.name!r}"
            self.document.add(
                "CLIP004", location, f"{message} is beyond {MAX_FRAME:.0e}"
            )
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
                    self.document.warn(
                        "CLIP104", (*curve_location, "keys", k, name), message, hint
                    )
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
        self,
        curve_location: Location,
        model: CurveModel,
        components: int,
        is_positive: bool,
    ) -> FloatArray | None:
        """Return the values of keys ``(K, D)``; None with a fault otherwise."""
        value_rows = []
        shown_hints: set[str] = set()  # hints that hold for the channel
        for k, key in enumerate(_key_models(model)):
            value_row = key.v if isinstance(key.v, list) else [key.v]
            if components == 3 and len(value_row) == 1 and is_positive:
                value_row = value_row * 3
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

    def _read_handles(
        self,
        key_location: Location,
        key: KeyModel,
        model: CurveModel,
        components: int,
        unit: float,
        is_positive: bool,
    ) -> tuple[Tangent, list[float], Tangent, list[float]]:
        """Return in-tangent, in-handle, out-tangent and out-handle of a key."""
        if components == 4:
            default_tangent = Tangent(model.tangents)
            no_handle = [0.0] * (1 + components)
            return default_tangent, no_handle, default_tangent, no_handle
        both_sides: list[tuple[Tangent, list[float]]] = []
        for name, handle in (("in", key.in_), ("out", key.out)):
            no_handle = [0.0] * (1 + components)
            if handle is None or isinstance(handle, str):
                both_sides.append((Tangent(handle or model.tangents), no_handle))
                continue
            dt, dv = handle
            values = dv if isinstance(dv, list) else [dv]
            if components == 3 and len(values) == 1 and is_positive:
                values = values * 3
            if isinstance(dt, list) or len(values) != components:
                message = f"the handle is not a time and {counted(components, 'value')}"
                zeros = [0] * components if components > 1 else 0
                handle_text = flow_text(name, [-2 if name == "in" else 2, zeros])
                hint = f"for example {handle_text}"
                self.document.add("CLIP007", (*key_location, name), message, hint)
                both_sides.append((Tangent.FREE, no_handle))
                continue
            both_sides.append((Tangent.FREE, [dt, *(value * unit for value in values)]))
        (in_tangent_type, in_handle), (out_tangent_type, out_handle) = both_sides
        return in_tangent_type, in_handle, out_tangent_type, out_handle

    def _read_quaternions(
        self, curve_location: Location, values: FloatArray, array_name: str = ""
    ) -> FloatArray:
        """Convert quaternions [w, x, y, z] to unit (x, y, z, w); record zero ones."""
        rotations, zero_rows = file_quaternions(values)
        if not zero_rows and len(values):
            k = int(np.abs(np.linalg.norm(values, axis=1) - 1.0).argmax())
            location = (
                (*curve_location, "keys")
                if array_name
                else (*curve_location, "keys", k, "v")
            )
            warn_of_quaternion_length(self.document, location, values[k].tolist())
        if array_name and zero_rows:
            message = (
                f"row {zero_rows[0]} of {array_name!r} is a quaternion of zero length"
            )
            self.document.add("RIG006", (*curve_location, "keys"), message)
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
