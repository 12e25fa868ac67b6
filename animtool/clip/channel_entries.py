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
from animtool.maths import so3
from animtool.maths.curves import Extrapolation, Interp
from animtool.maths.tangents import Parametrization, Tangent
from animtool.rig.joint_entries import UNIT_LENGTH

_ROTATING = frozenset({Interp.STEP, Interp.SLERP, Interp.SQUAD, Interp.SPLINE})
_SCALAR = frozenset(Interp) - {Interp.SLERP, Interp.SQUAD, Interp.SPLINE}
# Interpolations with handles.
_HANDLED = {Interp.BEZIER, Interp.HERMITE}
# Number of components; of a rotation, its Euler angles.
_WIDTHS = {
    **dict.fromkeys(("control", "shape", "angle", "slide"), 1),
    **dict.fromkeys(("translation", "rotation", "scale"), 3),
}
# Shorter quaternions are mistakes, not rotations.
SHORTEST = 1e-9


@dataclass(frozen=True, slots=True)
class ChannelReader:
    """Builds channels from a document's curves; records faults in the document."""

    document: Document  # the file

    def check(self, at: Location, model: CurveModel) -> None:
        """Record unordered times, and handles on the wrong side of their keys."""
        self._check_times(at, model, key_times(model))
        self._check_handles(at, model)

    def channel(
        self, at: Location, model: CurveModel, target: str, kind: str, unit: float
    ) -> ClipChannel | None:
        """Return the channel of a curve; None if its values have the wrong width.

        Args:
            at: Location of the curve.
            model: The curve.
            target: Its target, for the channel and messages.
            kind: Its kind, such as ``angle``, ``translation`` or ``rotation``.
            unit: What a value of 1 means.
        """
        turning = kind == "rotation" and model.euler is None
        width = 4 if turning else _WIDTHS[kind]
        if model.euler is not None and kind != "rotation":
            message = f"{target!r} is not a rotation"
            self.document.add("CLIP009", (*at, "euler"), message, "remove euler")
        default_interp = Interp.SPLINE if turning else Interp.BEZIER
        if isinstance(model.keys, PlainKeys):
            plain = self._plain(at, model, target, kind, unit)
            if plain is not None:
                return plain
            if model.keys.name:
                self._refuse_array(at, model, target, turning, width)
                return None
            each = [KeyModel.model_construct(**one) for one in model.keys.entries()]
            model = model.model_copy(update={"keys": each})
        interps = tuple(
            Interp(k.interp or model.interp or default_interp) for k in _each(model)
        )
        fits = self._check_interps(at, model, target, _ROTATING if turning else _SCALAR)
        if turning and fits:
            self._refuse_slopes(at, model, _each(model))
        if not turning and fits:
            self._warn_of_idle(at, model, interps)
        values = self._values(at, model, width, kind == "scale")
        even = kind == "scale"
        handles = [
            self._handle((*at, "keys", k), key, model, width, unit, even)
            for k, key in enumerate(_each(model))
        ]
        if values is None:
            return None
        return ClipChannel(
            target,
            np.array([key.t for key in _each(model)]),
            self._quaternions(at, values) if turning else values * unit,
            interps,
            tuple((before, behind) for before, _, behind, _ in handles),
            np.array([handle for _, handle, _, _ in handles]),
            np.array([handle for *_, handle in handles]),
            np.array([key.tcb or [0.0, 0.0, 0.0] for key in _each(model)]),
            Parametrization(model.parametrization),
            model.euler or "",
            Extrapolation(model.pre),
            Extrapolation(model.post),
        )

    def _plain(
        self, at: Location, model: CurveModel, target: str, kind: str, unit: float
    ) -> ClipChannel | None:
        """Return the channel of plain keys; None on a fault."""
        keys = model.keys
        assert isinstance(keys, PlainKeys)
        turning = kind == "rotation" and model.euler is None
        width = 4 if turning else _WIDTHS[kind]
        interp = Interp(model.interp or (Interp.SPLINE if turning else Interp.BEZIER))
        values = keys.values
        if kind == "scale" and values.shape[1] == 1:
            values = np.repeat(values, width, axis=1)
        if interp not in (_ROTATING if turning else _SCALAR):
            return None
        if values.shape[1] != width:
            return None
        if turning:
            self._refuse_slopes(at, model, ())
        else:
            self._warn_of_path(at, model, {interp})
        count, tangent = len(keys), Tangent(model.tangents)
        none = np.zeros((count, 1 + width))
        return ClipChannel(
            target,
            keys.times,
            self._quaternions(at, values, keys.name) if turning else values * unit,
            (interp,) * count,
            ((tangent, tangent),) * count,
            none,
            none,
            np.zeros((count, 3)),
            Parametrization(model.parametrization),
            model.euler or "",
            Extrapolation(model.pre),
            Extrapolation(model.post),
        )

    def _refuse_array(
        self, at: Location, model: CurveModel, target: str, turning: bool, width: int
    ) -> None:
        """Record why the keys of an array do not fit their target."""
        keys = model.keys
        assert isinstance(keys, PlainKeys)
        self._check_interps(at, model, target, _ROTATING if turning else _SCALAR)
        if keys.values.shape[1] != width:
            message = f"rows of {keys.name!r} have {keys.values.shape[1] + 1} numbers "
            message += f"instead of {width + 1}: a time, then the value"
            self.document.add("CLIP007", (*at, "keys"), message)

    def _check_interps(
        self,
        at: Location,
        model: CurveModel,
        target: str,
        allowed: frozenset[Interp],
    ) -> bool:
        named: list[tuple[Location, str | None]] = [((*at, "interp"), model.interp)]
        named += [
            ((*at, "keys", k, "interp"), key.interp)
            for k, key in enumerate(_each(model))
        ]
        wrong = [
            (location, name)
            for location, name in named
            if name is not None and Interp(name) not in allowed
        ]
        for location, name in wrong:
            hint = f"allowed: {', '.join(sorted(allowed))}"
            if name == Interp.SPLINE:
                hint = f"spline is for quaternions; for numbers, {hint}"
            message = f"{name} does not apply to {target!r}"
            self.document.add("CLIP009", location, message, hint)
        return not wrong

    def _check_times(self, at: Location, model: CurveModel, times: FloatArray) -> None:
        if (np.abs(times) <= MAX_FRAME).all() and (np.diff(times) > 0).all():
            return
        if isinstance(model.keys, PlainKeys) and model.keys.name:
            self._refuse_times((*at, "keys"), model.keys)
            return
        for k in np.flatnonzero(np.abs(times) > MAX_FRAME).tolist():
            message = f"frame {times[k]:g} is beyond {MAX_FRAME:.0e}"
            self.document.add("CLIP004", (*at, "keys", k, "t"), message)
        for k, before in self.document.descents((*at, "keys"), times.tolist(), "t"):
            same = times[k] == times[before]
            what = (
                "appears twice"
                if same
                else (f"comes before the key at {times[before]:g}")
            )
            location = (*at, "keys", k, "t")
            hint = "key times must ascend"
            self.document.add("CLIP004", location, f"frame {times[k]:g} {what}", hint)

    def _refuse_times(self, at: Location, keys: PlainKeys) -> None:
        """Record the first wrong time of an array."""
        times = keys.times
        far = np.flatnonzero(np.abs(times) > MAX_FRAME)
        if len(far):
            message = f"frame {times[far[0]]:g} in row {far[0]} of {keys.name!r}"
            self.document.add("CLIP004", at, f"{message} is beyond {MAX_FRAME:.0e}")
            return
        row = int(np.argmax(np.diff(times) <= 0)) + 1
        message = f"frame {times[row]:g} in row {row} of {keys.name!r} follows frame "
        hint = "key times must ascend"
        self.document.add("CLIP004", at, f"{message}{times[row - 1]:g}", hint)

    def _check_handles(self, at: Location, model: CurveModel) -> None:
        """Refuse handles on the wrong side of their keys."""
        for k, key in enumerate(_each(model)):
            for name, handle, sign in (("in", key.in_, -1), ("out", key.out, 1)):
                if not isinstance(handle, list) or isinstance(handle[0], list):
                    continue
                if handle[0] * sign < 0:
                    where = "before" if sign < 0 else "behind"
                    message = f"the handle's time {handle[0]:g} points the wrong way"
                    hint = f"'{name}' is {where} its key"
                    location = (*at, "keys", k, name)
                    self.document.add("CLIP005", location, message, hint)

    def _refuse_slopes(
        self, at: Location, model: CurveModel, keys: Sequence[KeyModel]
    ) -> None:
        """Refuse handles and tangents on quaternion keys."""
        hint = "write euler: XYZ to key three angles, which have them"
        spots: list[tuple[Location, CurveModel | KeyModel, tuple[str, ...]]]
        spots = [(at, model, ("tangents", "parametrization"))]
        spots += [
            ((*at, "keys", k), key, ("in_", "out", "tcb")) for k, key in enumerate(keys)
        ]
        for spot, entry, names in spots:
            for name in names:
                if name in entry.model_fields_set:
                    key = name.rstrip("_")
                    message = f"quaternions have no {key}"
                    self.document.add("CLIP009", (*spot, key), message, hint)

    def _warn_of_idle(
        self, at: Location, model: CurveModel, interps: tuple[Interp, ...]
    ) -> None:
        """Warn of handles that the adjacent interpolation does not use.

        Handles before the first and after the last key are allowed.
        """
        inner = interps[:-1]
        for k, key in enumerate(_each(model)):
            before, behind = interps[max(k - 1, 0) : k], inner[k : k + 1]
            for name, handle, props, expected in (
                ("in", key.in_, before, _HANDLED),
                ("out", key.out, behind, _HANDLED),
                ("tcb", key.tcb, before + behind, {Interp.TCB}),
            ):
                if handle is not None and props and not expected & {*props}:
                    kinds = " and ".join(dict.fromkeys(props))
                    message = f"'{name}' has no effect with {kinds}"
                    hint = f"it applies to {' and '.join(sorted(expected))}"
                    self.document.warn("CLIP104", (*at, "keys", k, name), message, hint)
        self._warn_of_path(at, model, {*(interps[:-1] or interps)})

    def _warn_of_path(
        self, at: Location, model: CurveModel, segments: Collection[Interp]
    ) -> None:
        """Warn of a Catmull-Rom parametrization without Catmull-Rom keys."""
        named = "parametrization" in model.model_fields_set
        if named and Interp.CATMULL_ROM not in segments:
            message = "'parametrization' has no effect without catmull_rom"
            self.document.warn("CLIP104", (*at, "parametrization"), message)

    def _values(
        self, at: Location, model: CurveModel, width: int, even: bool
    ) -> FloatArray | None:
        rows = []
        shown: set[str] = set()  # hints that hold for the whole channel
        for k, key in enumerate(_each(model)):
            row = key.v if isinstance(key.v, list) else [key.v]
            if width == 3 and len(row) == 1 and even:
                row = row * 3
            if len(row) != width:
                location = (*at, "keys", k, "v")
                hint = _form_hint(model, len(row), width)
                if hint not in shown:
                    message = f"{counted(len(row), 'number')} instead of {width}"
                    hint = hint or self.document.decimal_commas(location, width)
                    self.document.add("CLIP007", location, message, hint)
                    shown |= {hint} if hint else set()
                continue
            rows.append(row)
        if len(rows) < len(_each(model)):
            return None
        return np.array(rows, np.float64)

    def _handle(
        self,
        at: Location,
        key: KeyModel,
        model: CurveModel,
        width: int,
        unit: float,
        even: bool,
    ) -> tuple[Tangent, list[float], Tangent, list[float]]:
        """Return in-tangent, in-handle, out-tangent and out-handle of a key."""
        if width == 4:
            default, none = Tangent(model.tangents), [0.0] * (1 + width)
            return default, none, default, none
        sides: list[tuple[Tangent, list[float]]] = []
        for name, handle in (("in", key.in_), ("out", key.out)):
            none = [0.0] * (1 + width)
            if handle is None or isinstance(handle, str):
                sides.append((Tangent(handle or model.tangents), none))
                continue
            dt, dv = handle
            values = dv if isinstance(dv, list) else [dv]
            if width == 3 and len(values) == 1 and even:
                values = values * 3
            if isinstance(dt, list) or len(values) != width:
                message = f"the handle is not a time and {counted(width, 'value')}"
                self.document.add("CLIP007", (*at, name), message)
                sides.append((Tangent.FREE, none))
                continue
            sides.append((Tangent.FREE, [dt, *(value * unit for value in values)]))
        (before, first), (behind, second) = sides
        return before, first, behind, second

    def _quaternions(
        self, at: Location, values: FloatArray, array: str = ""
    ) -> FloatArray:
        """Return unit (x, y, z, w) of [w, x, y, z]."""
        rotations, wrong = file_quaternions(values)
        if array and wrong:
            message = f"row {wrong[0]} of {array!r} is a quaternion of zero length"
            self.document.add("RIG006", (*at, "keys"), message)
            return rotations
        for k in wrong:
            message = f"quaternion {values[k].tolist()} has zero length"
            self.document.add("RIG006", (*at, "keys", k, "v"), message)
        return rotations


def _form_hint(model: CurveModel, count: int, width: int) -> str | None:
    """Return a hint where a rotation's keys have the form of another kind."""
    if width == 4 and count == 3:
        return "add 'euler: XYZ' to the channel, or write quaternions [w, x, y, z]"
    if model.euler and count == 4:
        return "remove 'euler' for quaternions, or write three angles"
    return None


def _each(model: CurveModel) -> list[KeyModel]:
    """Return the keys as models."""
    return [] if isinstance(model.keys, PlainKeys) else model.keys


def file_quaternions(values: FloatArray) -> tuple[FloatArray, list[int]]:
    """Return unit (x, y, z, w) of rows [w, x, y, z], and a mask of zero ones.

    Signs continue from row to row.

    >>> file_quaternions(np.array([[2.0, 0, 0, 0], [0, 0, 0, 0]]))[1]
    [1]
    """
    lengths = np.linalg.norm(values, axis=1)
    rotations = values[:, [1, 2, 3, 0]]
    close = np.abs(lengths - 1.0) <= UNIT_LENGTH
    rotations[~close] = so3.normalize(rotations[~close])
    wrong = np.flatnonzero(~(lengths > SHORTEST)).tolist()
    return so3.align_signs(rotations), wrong
