"""Clip file reader, ``*.clip.yaml``."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import NoReturn

import numpy as np

from animtool.clip.channel_entries import CurveReader
from animtool.clip.channels import (
    ClipChannel,
    ClipUnits,
    lacks_most_targets,
    missing_targets_text,
    rig_file_has_all,
    target_kind,
    unknown_targets,
)
from animtool.clip.clip import Clip
from animtool.clip.schema import ChannelModel, ClipModel, PlainKeys
from animtool.clip.suspicions import warn_of_numbers
from animtool.clip.suspicious_times import warn_of_times
from animtool.core.arguments import argument, clause
from animtool.core.config import project_roots
from animtool.core.errors import Fault, FormatError, OptionError
from animtool.core.files.reading import exists, not_a_file_reason
from animtool.core.rates import RateError, parse_rate
from animtool.core.record import dataclass
from animtool.core.units import LengthUnit
from animtool.documents.arrays import Archives
from animtool.documents.check import validate_file
from animtool.documents.document import Document, Location, read_document
from animtool.documents.fields import MAX_FRAME, MAX_NUMBER
from animtool.documents.references import (
    resolve_reference,
    similar_file_hint,
    split_reference,
)
from animtool.rig.joints import split_part
from animtool.rig.skeleton import Rig

# Motion parts and the local parts that replace them; a joint has only one of them.
_LOCAL_PART_BY_PART = {
    "translation": "local_translation",
    "slide": "local_translation",
    "rotation": "local_rotation",
    "angle": "local_rotation",
}
# Array name of a reference without a name.
DEFAULT_ARRAY_NAME = "keys"


@dataclass(frozen=True, slots=True)
class ClipFile:
    """An unchecked clip file."""

    # Its text, with locations and with the faults of its keys and types.
    document: Document
    model: ClipModel  # content of the file
    rig_path: Path | None  # resolved path of the clip's rig file; None if it names none

    def required_rig_path(self) -> Path:
        """Return the path of the rig file that the clip names."""
        if self.rig_path is None:
            check_clip(self)
            path = str(self.document.path)
            hint = "write 'rig: hero.rig.yaml' into it, or pass a rig "
            hint += f"({argument('source.rig')})"
            raise OptionError(Fault("CLIP011", "names no rig", path, (), hint))
        return self.rig_path


def open_clip(path: Path | str) -> ClipFile:
    """Read a clip file; `load_clip` checks it against its rig."""
    return clip_of_document(read_document(Path(path), "clip"))


def clip_of_document(document: Document) -> ClipFile:
    """Return the unchecked clip file of a document; see `open_clip`."""
    model = _with_array_keys(document, validate_file(document, "clip", ClipModel))
    rig_path = None
    if model.rig is not None:
        roots = project_roots(document.path)
        rig_path = resolve_reference(document, ("rig",), model.rig, roots)
    return ClipFile(document, model, rig_path)


def _with_array_keys(document: Document, model: ClipModel) -> ClipModel:
    """Return a clip whose references to arrays are replaced by their keys.

    Channels whose array is faulty have no keys (CLIP016, DOC014, DOC015).
    """
    channels = list(model.channels)
    with Archives() as archives:
        for i, channel in enumerate(channels):
            keys: object = channel.keys
            if isinstance(keys, str):
                location = ("channels", i, "keys")
                array_keys = _load_keys(document, location, keys, archives)
                channels[i] = channel.model_copy(update={"keys": array_keys})
    return model.model_copy(update={"channels": channels})


def _load_keys(
    document: Document, location: Location, reference_text: str, archives: Archives
) -> PlainKeys | list[object]:
    """Return the keys of an array reference; an empty list if it is faulty."""
    file_name, array_name = split_reference(reference_text, DEFAULT_ARRAY_NAME)
    if document.is_placeholder(location):
        return []
    array_path = resolve_reference(
        document, location, file_name, project_roots(document.path)
    )
    reason = None if array_path is None else not_a_file_reason(array_path)
    if reason is not None:
        hint = similar_file_hint(document, file_name)
        document.add("DOC015", location, f"{file_name!r} {reason}", hint)
    if array_path is None or reason is not None:
        return []
    try:
        key_rows = archives.load(array_path, array_name)
    except ValueError as error:
        document.add("CLIP016", location, str(error))
        return []
    if key_rows.ndim != 2 or not len(key_rows) or key_rows.shape[1] < 2:
        message = f"{reference_text!r} has shape {key_rows.shape}, not (K, 1 + D)"
        hint = "write a row for each key: its time, then its value"
        document.add("CLIP016", location, message, hint)
        return []
    if not (np.abs(key_rows) <= MAX_NUMBER).all():
        message = f"{reference_text!r} has a number beyond {MAX_NUMBER:.0e}"
        document.add("CLIP016", location, message)
        return []
    times, values = map(np.ascontiguousarray, (key_rows[:, 0], key_rows[:, 1:]))
    return PlainKeys(times, values, reference_text)


def load_clip_rig(file: ClipFile, path: Path | None = None) -> Rig:
    """Return a clip file's rig: the file at ``path``, or else the one it names."""
    rig_path = file.required_rig_path() if path is None else path
    if path is None and not exists(rig_path):
        _raise_missing_rig(file)
    try:
        return Rig.load(rig_path)
    except FormatError as error:
        try:
            check_clip(file)
        except FormatError as clip_error:
            raise FormatError([*clip_error.faults, *error.faults]) from error
        raise


def _raise_missing_rig(file: ClipFile) -> NoReturn:
    """Raise the faults of a clip whose rig file is missing."""
    message = f"{file.model.rig!r} does not exist"
    suggestion = similar_file_hint(file.document, file.model.rig or "")
    other_rig_text = f"pass another rig with {argument('source.rig')}"
    hint = clause(other_rig_text)
    if suggestion:
        hint = suggestion + clause(f" or {other_rig_text}")
    file.document.add("DOC015", ("rig",), message, hint)
    check_clip(file)
    raise AssertionError(message)


def load_clip(file: ClipFile, rig: Rig) -> Clip:
    """Check a clip file against a rig and return the clip."""
    return _ClipReader(file.document, file.model, rig, file.rig_path).read_clip()


def load_clip_of(path: Path | str, rig: Rig | Path | str | None = None) -> Clip:
    """Load a clip file for a rig, a rig file or the rig that it names."""
    file = open_clip(path)
    if not isinstance(rig, Rig):
        rig = load_clip_rig(file, None if rig is None else Path(rig))
    return load_clip(file, rig)


def check_clip(file: ClipFile) -> None:
    """Check a clip file without its rig: any target is valid."""
    _ClipReader(file.document, file.model, None).read_clip()


def file_units(model: ClipModel, rig: Rig | None) -> ClipUnits:
    """Return the units of a clip's numbers, by default those of its rig."""
    length, angle = model.units.length, model.units.angle
    units = ClipUnits(1.0, 1.0)
    if rig is not None:
        units = ClipUnits(rig.meters_per_unit, rig.radians_per_unit)
    if length is not None:
        units = replace(units, length=LengthUnit(length).meters)
    if angle is not None:
        radians = math.radians(1.0) if angle == "deg" else 1.0
        units = replace(units, angle=radians)
    return units


class _ClipReader:
    """Reads the channels of a validated clip document."""

    def __init__(
        self,
        document: Document,
        model: ClipModel,
        rig: Rig | None,
        named_rig_path: Path | None = None,
    ) -> None:
        self.document, self.model, self.rig = document, model, rig
        self.named_rig_path = named_rig_path
        self.units = file_units(model, rig)

    def read_clip(self) -> Clip:
        """Return the clip; record its faults."""
        fps = self._read_rate()
        channel_of_target: dict[str, int] = {}
        channels = []
        for i, model in enumerate(self.model.channels):
            location = ("channels", i)
            self._check_duplicate(model.target, channel_of_target, i)
            channel = self._read_channel(location, model)
            if channel is not None:
                channels.append(channel)
        if not self.model.channels and self.model.range is None:
            hint = "with a range, it holds its rig at rest"
            message = "the clip has no channels"
            self.document.add("CLIP013", ("channels",), message, hint)
        first, last = self._read_range(channels)
        self._add_rig_fault()
        self.document.check()
        warn_of_times(self.document, channels, fps, first, last)
        units, has_unit = self.units, self.model.units.length is not None
        warn_of_numbers(
            self.document, channels, fps, units, self.rig, has_unit=has_unit
        )
        name = self.model.name or self.document.path.name.partition(".")[0]
        notices = tuple(self.document.notices)
        path = self.named_rig_path
        return Clip(name, fps, first, last, tuple(channels), notices, path)

    def _add_rig_fault(self) -> None:
        """Replace faults of channels by a single one if the clip is for another rig."""
        faults, channel_count = self.document.faults, len(self.model.channels)
        target_faults = [fault for fault in faults if fault.code == "CLIP002"]
        if self.rig is None or not target_faults:
            return
        targets = [channel.target for channel in self.model.channels]
        missing_targets = unknown_targets(targets, self.rig)
        is_for_other_rig = lacks_most_targets(missing_targets, channel_count, self.rig)
        is_for_named_rig = self._named_rig_has_all()
        if not is_for_other_rig and not is_for_named_rig:
            return
        message = missing_targets_text(missing_targets, channel_count, self.rig)
        hint = "is it the right rig?"
        rig_fault = replace(target_faults[0], message=message, hint=hint)
        if is_for_named_rig:
            hint = (
                f"the clip is for {self.model.rig}, which has them; animtool retarget, "
                "or the pass retarget of a scene, moves its take to another rig"
            )
            rig_fault = self.document.fault("CLIP002", ("rig",), message, hint)
        elif self.model.rig is not None:
            hint = f"the clip names {self.model.rig}; {hint}"
            rig_fault = replace(rig_fault, hint=hint)
        other_faults = [fault for fault in faults if fault not in target_faults]
        self.document.faults[:] = [rig_fault, *other_faults]

    def _named_rig_has_all(self) -> bool:
        """Return whether the rig that the clip names has all of its targets."""
        targets = [channel.target for channel in self.model.channels]
        return rig_file_has_all(self.named_rig_path, targets)

    def _read_rate(self) -> Fraction:
        """Return the frame rate; record an invalid one."""
        try:
            return parse_rate(self.model.fps)
        except RateError as error:
            self.document.add(error.code, ("fps",), str(error))
            return Fraction(24)

    def _read_range(self, channels: list[ClipChannel]) -> tuple[Fraction, Fraction]:
        """Return the range of the clip, by default that of its keys."""
        if self.model.range is None:
            first_time = min((c.times[0] for c in channels), default=1.0)
            last_time = max((c.times[-1] for c in channels), default=1.0)
            return Fraction(first_time), Fraction(last_time)
        first, last = self.model.range
        return read_range(self.document, first, last)

    def _check_duplicate(
        self, target: str, channel_of_target: dict[str, int], i: int
    ) -> None:
        """Record a duplicate target, or a joint keyed both from rest and locally."""
        name, part = split_part(target, _LOCAL_PART_BY_PART)
        local_target = f"{name}.{_LOCAL_PART_BY_PART[part]}" if part else target
        other_index = channel_of_target.setdefault(local_target, i)
        if other_index != i:
            other_target = self.model.channels[other_index].target
            message = f"target {target!r} and {other_target!r} are the same target"
            if other_target == target:
                message = f"target {target!r} appears twice"
            line, _ = self.document.position(("channels", other_index))
            hint = f"the other is on line {line}"
            self.document.add("CLIP010", ("channels", i, "target"), message, hint)

    def _read_channel(
        self, location: Location, model: ChannelModel
    ) -> ClipChannel | None:
        """Return the channel of an entry; None if it has no keys or is faulty."""
        if not len(model.keys):
            return None
        reader = CurveReader(self.document, location, model)
        reader.check()
        target_location = (*location, "target")
        kind = target_kind(model.target, self.rig)
        if isinstance(kind, Fault):
            self.document.add(kind.code, target_location, kind.message, kind.hint)
            return None
        if self.document.is_placeholder(target_location):
            return None
        unit = self.units.unit_of(model.target, model.euler or "")
        return reader.read_channel(model.target, kind, unit)


def read_range(
    document: Document, first: float, last: float
) -> tuple[Fraction, Fraction]:
    """Return first and last frame of a document's range; record its faults."""
    if first > last:
        message = f"the range from {first:g} to {last:g} is reversed"
        hint = f"write [{last:g}, {first:g}]"
        document.add("CLIP006", ("range",), message, hint)
    if max(abs(first), abs(last)) > MAX_FRAME:
        message = f"a frame is beyond {MAX_FRAME:.0e}"
        document.add("CLIP006", ("range",), message)
    return Fraction(first), Fraction(last)
