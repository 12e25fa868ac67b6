"""Collects faults and notices of a robot file, and parses its numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import field
from pathlib import Path

from animtool.core.errors import Fault, FormatError, Severity, counted, excerpt
from animtool.core.record import dataclass
from animtool.formats.robots.xml import XmlElement

# Maximum number of faults; more usually have one cause.
MAX_FAULTS = 50
# Largest value of lengths [m], angles and masses.
MAX_VALUE = 1e9
_NUMBER_PATTERN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


@dataclass(slots=True, eq=False)
class XmlDiagnostics:
    """Faults and notices of a robot's file, collected while it is read."""

    path: Path  # path of the file
    number_code: str  # code of an attribute that is not a number
    faults: list[Fault] = field(default_factory=list)  # errors, in the order found
    notices: list[Fault] = field(default_factory=list)  # warnings and notes
    # Labels of contents that are not read.
    ignored_labels: dict[str, None] = field(default_factory=dict)

    def add(
        self,
        code: str,
        element: XmlElement | None,
        message: str,
        hint: str | None = None,
        *,
        location: str | None = None,
        joint: str | None = None,
        severity: Severity = Severity.ERROR,
    ) -> None:
        """Record a fault at an element, or at the file if that is None."""
        path = str(self.path if element is None else element.path)
        lines = () if element is None else (element.line,)
        column = None if element is None else element.column
        fault = Fault(
            code, message, path, lines, hint, severity, column, location, joint=joint
        )
        (self.faults if severity is Severity.ERROR else self.notices).append(fault)

    def raise_faults(self) -> None:
        """Raise the first recorded faults as a `FormatError`, if there are any."""
        if not self.faults:
            return
        first_faults = self.faults[:MAX_FAULTS]
        omitted_count = len(self.faults) - len(first_faults)
        if omitted_count:
            last_fault = first_faults[-1]
            omitted_faults = counted(omitted_count, "more fault")
            message = f"and {omitted_faults} of this kind or another"
            first_faults.append(Fault(last_fault.code, message, str(self.path)))
        raise FormatError(first_faults)

    def read_numbers(
        self,
        element: XmlElement,
        name: str,
        count: int,
        default: tuple[float, ...],
        location: str,
        max_value: float = MAX_VALUE,
    ) -> tuple[float, ...]:
        """Return the numbers of an attribute, or the default.

        Numbers beyond ``max_value`` or not finite are recorded as faults.
        """
        text = element.attributes.get(name)
        if text is None:
            return default
        number_texts = text.split()
        problem, hint = "", f"write {'a number' if count == 1 else f'{count} numbers'}"
        if len(number_texts) != count:
            problem = f"{counted(len(number_texts), 'value')}, not {count}"
            if "," in text:
                hint = "separate numbers by blanks, and write decimals with a point"
        numbers = []
        for number_text in number_texts:
            number = to_number(number_text)
            if number is None:
                problem = problem or f"{excerpt(number_text)} is not a number"
                if "," in number_text:
                    hint = "separate numbers by blanks, and write decimals with a point"
            elif not math.isfinite(number):
                problem = problem or f"{excerpt(number_text)} is not finite"
            elif abs(number) > max_value:
                problem = problem or f"{excerpt(number_text)} is beyond {max_value:g}"
            else:
                numbers.append(number)
        if problem:
            message = f"{name} of <{element.tag}> is {excerpt(text)}: {problem}"
            self.add(self.number_code, element, message, hint, location=location)
            return default
        return tuple(numbers)

    def read_number(
        self, element: XmlElement, name: str, default: float, location: str
    ) -> float:
        """Return the number of an attribute; see `read_numbers`."""
        return self.read_numbers(element, name, 1, (default,), location)[0]

    def record_ignored(self, labels: Iterable[str]) -> None:
        """Record labels of contents that are not read, for one notice."""
        self.ignored_labels.update(dict.fromkeys(labels))


def to_number(text: str) -> float | None:
    """Parse a decimal number, including inf and nan; None for other text.

    >>> to_number("1e-3"), to_number("1_0"), to_number("0x1p3")
    (0.001, None, None)
    """
    if _NUMBER_PATTERN.fullmatch(text):
        return float(text)
    if text.lower().lstrip("+-") in {"nan", "inf", "infinity"}:
        return math.nan
    return None


def element_label(kind: str, name: str) -> str:
    """Return a joint's or link's label for messages.

    >>> element_label("joint", "elbow flex")
    "joint 'elbow flex'"
    """
    return f"{kind} {excerpt(name)}"
