"""Reading a clip file, ``*.clip.yaml``."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import NoReturn

import numpy as np

from animtool._types import FloatArray
from animtool.clip.clip import (
    Clip,
    ClipChannel,
    Interp,
    Parametrization,
    Tangent,
)
from animtool.clip.schema import ChannelModel, ClipModel, KeyModel
from animtool.clip.targets import target_kind
from animtool.clip.units import ClipUnits
from animtool.config import project_roots
from animtool.documents.arrays import referred
from animtool.documents.check import check_version, validated
from animtool.documents.document import Document, Location, read_document
from animtool.errors import Fault, FormatError, OptionError, counted
from animtool.maths import so3
from animtool.maths.extrapolation import Extrapolation
from animtool.rates import parse_rate
from animtool.rig.joint_entries import UNIT_LENGTH
from animtool.rig.skeleton import Rig
from animtool.rig.targets import split_part
from animtool.units import LengthUnit

__all__ = ["ClipFile", "check_clip", "load_clip", "load_rig_of", "open_clip"]

_ROTATING = frozenset({Interp.STEP, Interp.SLERP, Interp.SQUAD, Interp.SPLINE})
_SCALAR = frozenset(Interp) - {Interp.SLERP, Interp.SQUAD, Interp.SPLINE}
# Whose segments have handles.
_HANDLED = {Interp.BEZIER, Interp.HERMITE}
# Motion, and what takes its place: one of them may hold a joint.
_REPLACED = {
    "translation": "local_translation",
    "slide": "local_translation",
    "rotation": "local_rotation",
    "angle": "local_rotation",
}
# Components of a value; of a rotation, those of Euler angles.
_WIDTHS = {
    **dict.fromkeys(("control", "shape", "angle", "slide"), 1),
    **dict.fromkeys(("translation", "rotation", "scale"), 3),
}
# Beyond, frames are no longer exact in float64 with fractions of a thousandth.
FARTHEST_FRAME = 1e9
# Beyond, differences of values and their slopes leave float64.
LARGEST_VALUE = 1e100
# Shorter, a quaternion is a slip and not a rotation.
SHORTEST = 1e-9


@dataclass(frozen=True, slots=True)
class ClipFile:
    """A clip file, not checked yet.

    Attributes:
        document: Its text, with places and with the faults of its keys and types.
        model: Its content.
        rig: The rig file that it names, resolved; None where it names none.
    """

    document: Document
    model: ClipModel
    rig: Path | None

    def needed_rig(self) -> Path:
        """Return the rig that the clip names.

        Raises:
            FormatError: It names none, and has other faults.
            OptionError: It names none (CLIP011).
        """
        if self.rig is None:
            check_clip(self)
            path = str(self.document.path)
            hint = "write 'rig: hero.rig.yaml' into it, or give a rig (--rig)"
            raise OptionError(Fault("CLIP011", "names no rig", path, (), hint))
        return self.rig


def open_clip(path: Path | str) -> ClipFile:
    """Read a clip file; `load_clip` checks it and puts it on its rig.

    Raises:
        FormatError: It is no clip file of a version that is known.
    """
    document = read_document(Path(path))
    check_version(document, "clip")
    model = validated(document, ClipModel)
    rig = None
    if model.rig is not None:
        roots = project_roots(document.path)
        rig = referred(document, ("rig",), model.rig, roots, "CLIP012")
    return ClipFile(document, model, rig)


def load_rig_of(file: ClipFile, path: Path | None = None) -> Rig:
    """Return the rig of a clip file.

    Args:
        file: The clip.
        path: The rig's file; None is the one that the clip names.

    Raises:
        FormatError: With every fault of the rig, and those of the clip that can be
            told without it.
        OptionError: No rig is named (CLIP011).
    """
    named = file.needed_rig() if path is None else path
    if path is None and not named.exists():
        _note_missing(file)
    try:
        return Rig.load(named)
    except FormatError as error:
        try:
            check_clip(file)
        except FormatError as other:
            raise FormatError([*other.faults, *error.faults]) from error
        raise


def _note_missing(file: ClipFile) -> NoReturn:
    """Raise what is wrong with a clip whose rig is not there."""
    message = f"{file.model.rig!r} does not exist"
    file.document.add("CLIP012", ("rig",), message, "give another rig with --rig")
    check_clip(file)
    raise AssertionError(message)


def load_clip(file: ClipFile, rig: Rig) -> Clip:
    """Return the clip of a file, for a rig.

    Args:
        file: Its content.
        rig: Whose controls, shapes and joints its targets are.

    Raises:
        FormatError: With every fault: unknown keys, values of the wrong type or width,
            unknown targets, key times out of order, handles that point backwards.
    """
    return _ClipReader(file.document, file.model, rig).clip()


def check_clip(file: ClipFile) -> None:
    """Check a clip file without its rig: its targets may be anything.

    Raises:
        FormatError: With every fault but those that need the rig.
    """
    _ClipReader(file.document, file.model, None).clip()


class _ClipReader:
    def __init__(self, document: Document, model: ClipModel, rig: Rig | None) -> None:
        self.document, self.model, self.rig = document, model, rig
        length, angle = model.units.length, model.units.angle
        units = ClipUnits(1.0, 1.0)
        if rig is not None:
            units = ClipUnits(rig.meters_per_unit, rig.radians_per_unit)
        if length is not None:
            units = replace(units, length=LengthUnit(length).meters)
        if angle is not None:
            radians = math.radians(1.0) if angle == "deg" else 1.0
            units = replace(units, angle=radians)
        self.units = units

    def clip(self) -> Clip:
        fps = self._fps()
        seen: dict[str, int] = {}
        channels = []
        for i, model in enumerate(self.model.channels):
            at = ("channels", i)
            self._once((*at, "target"), model.target, seen, i)
            made = self._channel(at, model)
            if made is not None:
                channels.append(made)
        if not self.model.channels and self.model.range is None:
            hint = "with a range it holds its rig at rest"
            message = "the clip has no channels"
            self.document.add("CLIP013", ("channels",), message, hint)
        first, last = self._range(channels)
        self.document.check()
        name = self.model.name or self.document.path.name.partition(".")[0]
        notices = tuple(self.document.notices)
        return Clip(name, fps, first, last, tuple(channels), notices)

    def _fps(self) -> Fraction:
        try:
            return parse_rate(self.model.fps)
        except ValueError as error:
            self.document.add("CLIP008", ("fps",), str(error))
            return Fraction(24)

    def _range(self, channels: list[ClipChannel]) -> tuple[Fraction, Fraction]:
        if self.model.range is None:
            ends = [t for c in channels for t in (c.times[0], c.times[-1])] or [1.0]
            return Fraction(min(ends)), Fraction(max(ends))
        first, last = self.model.range
        if first > last:
            message = f"the range from {first:g} to {last:g} is reversed"
            hint = f"write [{last:g}, {first:g}]"
            self.document.add("CLIP006", ("range",), message, hint)
        if max(abs(first), abs(last)) > FARTHEST_FRAME:
            message = f"a frame is beyond {FARTHEST_FRAME:.0e}"
            self.document.add("CLIP006", ("range",), message)
        return Fraction(first), Fraction(last)

    def _once(self, at: Location, target: str, seen: dict[str, int], i: int) -> None:
        """Refuse a target twice, or motion and its replacement on one joint."""
        name, part = split_part(target, _REPLACED)
        claim = f"{name}.{_REPLACED[part]}" if part else target
        if claim in seen:
            other = self.model.channels[seen[claim]].target
            line = self.document.place(("channels", seen[claim]))[0]
            what = "stands twice" if other == target else f"and {other!r} are the same"
            hint = f"the other in line {line}"
            self.document.add("CLIP010", at, f"target {target!r} {what}", hint)
        seen.setdefault(claim, i)

    def _channel(self, at: Location, model: ChannelModel) -> ClipChannel | None:
        times = np.array([key.t for key in model.keys])
        self._check_times(at, times)
        self._check_handles(at, model)
        kind = self._kind((*at, "target"), model.target)
        if kind is None or self.document.doubtful((*at, "target")):
            return None
        turning = kind == "rotation" and model.euler is None
        width = 4 if turning else _WIDTHS[kind]
        unit = self.units.of(model.target, model.euler or "")
        if model.euler is not None and kind != "rotation":
            message = f"{model.target!r} is no rotation"
            self.document.add("CLIP009", (*at, "euler"), message, "leave euler out")
        usual = Interp.SPLINE if turning else Interp.BEZIER
        interps = tuple(Interp(k.interp or model.interp or usual) for k in model.keys)
        fits = self._check_interps(at, model, _ROTATING if turning else _SCALAR)
        if turning and fits:
            self._refuse_slopes(at, model)
        if not turning and fits:
            self._warn_of_idle(at, model, interps)
        values = self._values(at, model, width)
        handles = [self._handle((*at, "keys", k), key, model, width, unit)
                   for k, key in enumerate(model.keys)]  # fmt: skip
        if values is None:
            return None
        return ClipChannel(
            model.target,
            times,
            _quaternions(self.document, at, values) if turning else values * unit,
            interps,
            tuple((before, behind) for before, _, behind, _ in handles),
            np.array([handle for _, handle, _, _ in handles]),
            np.array([handle for *_, handle in handles]),
            np.array([key.tcb or [0.0, 0.0, 0.0] for key in model.keys]),
            Parametrization(model.parametrization),
            model.euler or "",
            Extrapolation(model.pre),
            Extrapolation(model.post),
        )

    def _kind(self, at: Location, target: str) -> str | None:
        found = target_kind(target, self.rig)
        if isinstance(found, Fault):
            self.document.add(found.code, at, found.message, found.hint)
            return None
        return found

    def _check_interps(
        self, at: Location, model: ChannelModel, allowed: frozenset[Interp]
    ) -> bool:
        places: list[tuple[Location, str | None]] = [((*at, "interp"), model.interp)]
        places += [
            ((*at, "keys", k, "interp"), key.interp) for k, key in enumerate(model.keys)
        ]
        wrong = [
            (place, name)
            for place, name in places
            if name is not None and Interp(name) not in allowed
        ]
        for place, name in wrong:
            hint = f"allowed: {', '.join(sorted(allowed))}"
            message = f"{name} does not fit {model.target!r}"
            self.document.add("CLIP009", place, message, hint)
        return not wrong

    def _check_times(self, at: Location, times: FloatArray) -> None:
        for k in np.flatnonzero(np.abs(times) > FARTHEST_FRAME).tolist():
            message = f"frame {times[k]:g} is beyond {FARTHEST_FRAME:.0e}"
            self.document.add("CLIP004", (*at, "keys", k, "t"), message)
        for k, before in self.document.descents((*at, "keys"), times.tolist(), "t"):
            same = times[k] == times[before]
            what = "stands twice" if same else f"stands behind {times[before]:g}"
            place = (*at, "keys", k, "t")
            hint = "key times ascend"
            self.document.add("CLIP004", place, f"frame {times[k]:g} {what}", hint)

    def _check_handles(self, at: Location, model: ChannelModel) -> None:
        """Refuse handles on the wrong side of their keys."""
        for k, key in enumerate(model.keys):
            for name, given, sign in (("in", key.in_, -1), ("out", key.out, 1)):
                if not isinstance(given, list) or isinstance(given[0], list):
                    continue
                if given[0] * sign < 0:
                    where = "before" if sign < 0 else "behind"
                    message = f"the handle's time {given[0]:g} points backwards"
                    hint = f"'{name}' lies {where} its key"
                    place = (*at, "keys", k, name)
                    self.document.add("CLIP005", place, message, hint)

    def _refuse_slopes(self, at: Location, model: ChannelModel) -> None:
        """Refuse what shapes the curves of numbers, on quaternions."""
        hint = "euler: XYZ makes it three angles, which have them"
        spots: list[tuple[Location, ChannelModel | KeyModel, tuple[str, ...]]]
        spots = [(at, model, ("tangents", "parametrization"))]
        spots += [
            ((*at, "keys", k), key, ("in_", "out", "tcb"))
            for k, key in enumerate(model.keys)
        ]
        for spot, entry, names in spots:
            for name in names:
                if name in entry.model_fields_set:
                    key = name.rstrip("_")
                    message = f"quaternions have no {key}"
                    self.document.add("CLIP009", (*spot, key), message, hint)

    def _warn_of_idle(
        self, at: Location, model: ChannelModel, interps: tuple[Interp, ...]
    ) -> None:
        """Warn of what shapes curves of another kind than those beside its key.

        Handles before the first key and behind the last wait for keys to come.
        """
        for k, key in enumerate(model.keys):
            before, behind = interps[:k][-1:], interps[k:-1][:1]
            for name, given, beside, wanted in (
                ("in", key.in_, before, _HANDLED),
                ("out", key.out, behind, _HANDLED),
                ("tcb", key.tcb, before + behind, {Interp.TCB}),
            ):
                if given is not None and beside and not wanted & {*beside}:
                    kinds = " and ".join(dict.fromkeys(beside))
                    message = f"'{name}' does nothing, beside it is {kinds}"
                    hint = f"it is for {' and '.join(sorted(wanted))}"
                    self.document.warn("CLIP104", (*at, "keys", k, name), message, hint)
        segments = interps[:-1] or interps
        named = "parametrization" in model.model_fields_set
        if named and Interp.CATMULL_ROM not in segments:
            message = "'parametrization' does nothing without catmull_rom"
            self.document.warn("CLIP104", (*at, "parametrization"), message)

    def _values(
        self, at: Location, model: ChannelModel, width: int
    ) -> FloatArray | None:
        rows = []
        for k, key in enumerate(model.keys):
            row = key.v if isinstance(key.v, list) else [key.v]
            if width == 3 and len(row) == 1 and model.target.endswith(".scale"):
                row = row * 3
            if len(row) != width:
                place = (*at, "keys", k, "v")
                wanted = "1 is" if width == 1 else f"{width} are"
                message = f"{counted(len(row), 'number')} where {wanted} wanted"
                self.document.add("CLIP007", place, message)
                continue
            if max(map(abs, row)) > LARGEST_VALUE:
                message = f"a value is beyond {LARGEST_VALUE:.0e}"
                self.document.add("CLIP007", (*at, "keys", k, "v"), message)
            rows.append(row)
        if len(rows) < len(model.keys):
            return None
        return np.array(rows, np.float64)

    def _handle(
        self, at: Location, key: KeyModel, model: ChannelModel, width: int, unit: float
    ) -> tuple[Tangent, list[float], Tangent, list[float]]:
        """Return tangent and handle before a key, and behind it."""
        if width == 4:
            usual, none = Tangent(model.tangents), [0.0] * (1 + width)
            return usual, none, usual, none
        found: list[tuple[Tangent, list[float]]] = []
        for name, given in (("in", key.in_), ("out", key.out)):
            none = [0.0] * (1 + width)
            if given is None or isinstance(given, str):
                found.append((Tangent(given or model.tangents), none))
                continue
            dt, dv = given
            values = dv if isinstance(dv, list) else [dv]
            if max(map(abs, [0.0, *values])) > LARGEST_VALUE:
                message = f"a value is beyond {LARGEST_VALUE:.0e}"
                self.document.add("CLIP007", (*at, name), message)
            if width == 3 and len(values) == 1 and model.target.endswith(".scale"):
                values = values * 3
            if isinstance(dt, list) or len(values) != width:
                message = f"the handle is not a time and {width} values"
                self.document.add("CLIP007", (*at, name), message)
                found.append((Tangent.FREE, none))
                continue
            found.append((Tangent.FREE, [dt, *(value * unit for value in values)]))
        (before, first), (behind, second) = found
        return before, first, behind, second


def _quaternions(document: Document, at: Location, values: FloatArray) -> FloatArray:
    """Return unit (x, y, z, w) of [w, x, y, z]."""
    lengths = np.linalg.norm(values, axis=1)
    for k in np.flatnonzero(~(lengths > SHORTEST)).tolist():
        message = f"quaternion {values[k].tolist()} has no length"
        document.add("CLIP014", (*at, "keys", k, "v"), message)
    rotations = values[:, [1, 2, 3, 0]]
    close = np.abs(lengths - 1.0) <= UNIT_LENGTH
    rotations[~close] = so3.normalize(rotations[~close])
    return so3.align_signs(rotations)
