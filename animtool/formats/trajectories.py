"""A capture file that is being read: names, unit, rate and missing positions."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import field
from fractions import Fraction

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import (
    Fault,
    FormatError,
    Severity,
    counted,
    excerpt,
    names_fault,
)
from animtool.core.names import numbered_names
from animtool.core.quantities import length_text
from animtool.core.rates import (
    MAX_STATED_RATE,
    MIN_STATED_RATE,
    FractionLike,
    rate_from_float,
    rate_option,
)
from animtool.core.record import dataclass
from animtool.core.units import LengthUnit, UpAxis
from animtool.formats import FLOAT32_MAX
from animtool.motion.marker_size import (
    is_person_size,
    is_plausible_size,
    rescaled_text,
    subject_size,
)

# Names of unlabelled points, besides an empty name.
_UNLABELLED_PATTERN = re.compile(
    r"\*\d*|uname\*\d*|unlabell?ed[\W_]*\d*|unidentified[\W_]*\d*|unknown[\W_]*\d*",
    re.IGNORECASE | re.ASCII,
)
_UNITS = {
    "mm": LengthUnit.MM, "millimeter": LengthUnit.MM, "millimetre": LengthUnit.MM,
    "cm": LengthUnit.CM, "centimeter": LengthUnit.CM, "centimetre": LengthUnit.CM,
    "m": LengthUnit.M, "meter": LengthUnit.M, "metre": LengthUnit.M,
    "in": LengthUnit.IN, "inch": LengthUnit.IN, "inche": LengthUnit.IN,
    '"': LengthUnit.IN,
}  # fmt: skip


@dataclass(slots=True)
class CaptureFile:
    """A file of markers or motion that is being read, and its warnings so far."""

    path: str
    notices: list[Fault] = field(default_factory=list)
    # Unit in which lengths are read, the one that the file states, and where, such as
    # in the name of an array.
    unit: LengthUnit | None = None
    stated_unit: LengthUnit | None = None
    unit_source: str = ""

    def error(
        self, code: str, message: str, hint: str | None = None, line: int | None = None
    ) -> FormatError:
        """Return a `FormatError` about the file, or about one of its lines."""
        lines = () if line is None else (line,)
        return FormatError(Fault(code, message, self.path, lines, hint))

    def warn(
        self, code: str, message: str, hint: str | None = None, *lines: int
    ) -> None:
        """Add a warning about the file, or about some of its lines."""
        warning = Severity.WARNING
        self.notices.append(Fault(code, message, self.path, lines, hint, warning))

    def warn_of_names(
        self, code: str, message: str, names: Sequence[str], hint: str
    ) -> None:
        """Add a warning about the file that lists names."""
        warning = Severity.WARNING
        self.notices.append(names_fault(code, message, names, self.path, hint, warning))

    def note(self, code: str, message: str, hint: str | None = None) -> None:
        """Add a note about the file."""
        self.notices.append(Fault(code, message, self.path, (), hint, Severity.NOTE))

    def choose_rate(
        self, stated_rate: float | None, fps: FractionLike | None
    ) -> Fraction:
        """Return the frame rate: the option if given, otherwise the stated rate."""
        if fps is not None:
            return rate_option(fps)
        rate = stated_rate or 0.0
        if MIN_STATED_RATE <= rate <= MAX_STATED_RATE:
            return rate_from_float(rate)
        message = "the file states no frame rate"
        if stated_rate:
            message = f"the stated frame rate {stated_rate:g} is not usable"
        hint = f"set the rate with {argument('source.fps')}"
        raise self.error("MKR010", message, hint)

    def choose_unit(
        self, stated_unit: str | None, unit: LengthUnit | None, default: LengthUnit
    ) -> LengthUnit:
        """Return the length unit: the option, else the stated one, else the default."""
        if stated_unit is not None and stated_unit.strip():
            self.stated_unit = _parse_unit(stated_unit.strip().lower().rstrip("s."))
            if self.stated_unit is None and unit is None:
                message = f"unknown unit {excerpt(stated_unit)}"
                hint = f"set one of {', '.join(LengthUnit)} with "
                raise self.error("MKR011", message, hint + argument("source.unit"))
        elif unit is None:
            message = f"the file states no unit; using {default}"
            self.note("MKR104", message, f"set the unit with {argument('source.unit')}")
        self.unit = self.stated_unit or default if unit is None else LengthUnit(unit)
        return self.unit

    def choose_up(self, stated_up: UpAxis | None, up: UpAxis | None) -> UpAxis:
        """Return the up axis: the option, else the stated one, else Y."""
        if up is not None:
            return UpAxis(up)
        if stated_up is None:
            message = "the file states no up axis; using Y"
            self.note("MKR103", message, f"set Z up with {argument('source.up', 'Z')}")
            return UpAxis.Y
        return stated_up

    def unique_names(
        self, labels: Sequence[str], subject: str | None
    ) -> tuple[str, ...]:
        """Return unique marker names; those of unlabelled points begin with ``*``.

        The prefix of a subject, as in ``Anna:LFHD``, is removed if all labels have the
        same, or if it is the requested subject. Duplicate names get a number (MKR101).
        """
        clean_labels = [label.strip() for label in labels]
        prefixes = {n.rpartition(":")[0] for n in clean_labels if not is_unlabelled(n)}
        if subject is None and len(prefixes) == 1:
            subject = next(iter(prefixes))
        if subject:
            clean_labels = [name.removeprefix(f"{subject}:") for name in clean_labels]
        names = [
            f"*{i}" if is_unlabelled(name) else name
            for i, name in enumerate(clean_labels)
        ]
        unique_labels = numbered_names(names)
        renamed_labels = [
            unique_label
            for name, unique_label in zip(names, unique_labels, strict=True)
            if name != unique_label
        ]
        if renamed_labels:
            hint = "rename them in the capture software"
            message = "duplicate names; later ones became "
            self.warn_of_names("MKR101", message, renamed_labels, hint)
        return tuple(unique_labels)

    def clean_positions(
        self, positions: FloatArray, meters_per_unit: float
    ) -> FloatArray:
        """Return positions [m] with NaN for invalid ones.

        A point is invalid if it has a number beyond float32, the same large number in
        all coordinates, such as 9999999 (MKR102), or lies exactly at the origin
        (MKR105). Capture systems write these values for missing points.

        ``positions`` ``(F, M, 3)``, in file units, are changed in place.
        """
        with np.errstate(invalid="ignore"):
            is_beyond_float32 = (np.abs(positions) > FLOAT32_MAX).any(axis=-1)
            is_at_origin = (positions == 0.0).all(axis=-1)
            is_missing_code = (positions == positions[..., :1]).all(axis=-1)
            is_missing_code &= (
                np.abs(positions[..., 0]) * meters_per_unit > MAX_COORDINATE
            )
            is_missing_code &= ~is_beyond_float32
        if is_beyond_float32.any():
            count = counted(int(is_beyond_float32.sum()), "position")
            message = f"{count} beyond the largest float32, treated as missing"
            self.warn("MKR102", message, "export the file again")
        if is_at_origin.any():
            count = counted(int(is_at_origin.sum()), "position")
            message = f"{count} at exactly 0, 0, 0, treated as missing"
            self.note("MKR105", message)
        if is_missing_code.any():
            count = counted(int(is_missing_code.sum()), "position")
            value = float(positions[is_missing_code][0, 0])
            message = f"{count} at {value:g} in every coordinate, treated as missing"
            self.warn("MKR102", message, "the number is a code for missing points")
        is_missing = is_beyond_float32 | is_at_origin | is_missing_code
        positions[is_missing | np.isnan(positions).any(axis=-1)] = np.nan
        positions *= meters_per_unit
        self._check_size(positions)
        return positions

    def _check_size(self, positions: FloatArray) -> None:
        """Warn if positions ``(F, M, 3)`` [m] seem to be in another unit.

        Their size is implausible (MKR117), or the user's unit is not that of the file
        (MKR118), unless only the user's gives the size of a person.
        """
        size = subject_size(positions)
        if size is None or self.unit is None:
            return
        if self.stated_unit is not None and self.stated_unit is not self.unit:
            stated_size = size / self.unit.meters * self.stated_unit.meters
            option = argument("source.unit", self.unit)
            message = f"the file states {self.stated_unit}, but {option} was given: "
            message += f"the markers of a frame span {length_text(size)} instead of "
            message += length_text(stated_size)
            hint = f"leave out {argument('source.unit')}"
            if not is_person_size(size) and is_person_size(stated_size):
                self.warn("MKR118", message, hint)
            elif is_person_size(size) == is_person_size(stated_size):
                self.note("MKR118", message, f"{hint} if the file is right")
            return
        if is_plausible_size(size):
            return
        message = f"the markers of a frame span {length_text(size)}"
        hint = f"set the unit of the file with {argument('source.unit')}"
        for unit in LengthUnit:
            fitting_size = size / self.unit.meters * unit.meters
            if is_person_size(fitting_size):
                message += f", with lengths in {self.unit}{self.unit_source}; in "
                message += f"{unit} it would be {length_text(fitting_size)}"
                hint = f"set {argument('source.unit', unit)}"
                break
        else:
            message += rescaled_text(size)
        self.warn("MKR117", message, hint)


def _parse_unit(text: str) -> LengthUnit | None:
    """Parse a unit name, which writers may truncate; None if unknown."""
    if text in _UNITS or len(text) < 4:
        return _UNITS.get(text)
    matching_units = {unit for name, unit in _UNITS.items() if name.startswith(text)}
    return matching_units.pop() if len(matching_units) == 1 else None


# Three equal coordinates beyond this are a code for a missing point [m].
MAX_COORDINATE = 1000.0
# Maximum positions of a take; larger files are refused before memory is allocated. An
# hour of 100 markers at 240 Hz has 86 million.
MAX_POSITIONS = 200_000_000


def is_unlabelled(name: str) -> bool:
    """Return whether a name belongs to an unlabelled point.

    >>> is_unlabelled("*12"), is_unlabelled(""), is_unlabelled("LFHD")
    (True, True, False)
    """
    return not name or _UNLABELLED_PATTERN.fullmatch(name) is not None
