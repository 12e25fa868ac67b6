"""Faults, errors and exit codes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import field, replace
from enum import IntEnum, StrEnum
from typing import ClassVar, NoReturn, TypeAlias

from animtool.core.arguments import ArgumentNamer, as_text, name_arguments
from animtool.core.quantities import escaped
from animtool.core.record import dataclass
from animtool.core.values import template_values

# Number of names in a brief message.
MAX_BRIEF_NAMES = 12


class ExitCode(IntEnum):
    """Exit codes of all commands."""

    OK = 0
    FINDINGS = 1
    USAGE = 2
    MALFORMED = 3
    TOLERANCE = 4
    NOTHING_MATCHED = 5
    INTERNAL = 70
    INTERRUPTED = 130
    TERMINATED = 143


class Severity(StrEnum):
    """Severity of a fault: an error stops the work, a warning only if strict."""

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault and its location.

    Attributes:
        code: Stable identifier, such as ``BVH010``.
        message: What is wrong, with the name, the value and the allowed values.
        path: Path of the file, as spelled by the user.
        lines: 1-based lines at fault, the main one first.
        hint: How to correct it.
        severity: Error, warning or note.
        column: 1-based column in the main line.
        where: Location in a structured file, such as ``joints[3].axis``.
        brief: Shorter message for a terminal without ``-v``; empty to use the message.
        frame: Frame number in the file; the first of several.
        joint: Name of the joint at fault.
    """

    code: str
    message: str
    path: str | None = None
    lines: tuple[int, ...] = ()
    hint: str | None = None
    severity: Severity = Severity.ERROR
    column: int | None = None
    where: str | None = None
    brief: str = field(default="", repr=False, compare=False)
    frame: float | None = field(default=None, repr=False)
    joint: str | None = field(default=None, repr=False)
    json_keys: ClassVar[str] = (
        "code severity message path lines column where frame joint hint"
    )

    def __post_init__(self) -> None:
        """Convert texts with argument markers to `TextWithArguments`."""
        for name in ("message", "hint", "brief"):
            text = getattr(self, name)
            if text:
                object.__setattr__(self, name, as_text(text))

    def with_argument_names(self, namer: ArgumentNamer) -> Fault:
        """Return a copy whose texts name arguments as an interface does."""
        message, brief = (
            name_arguments(text, namer) for text in (self.message, self.brief)
        )
        hint = self.hint and name_arguments(self.hint, namer)
        return replace(self, message=message, hint=hint, brief=brief)

    def in_file(self, path: object) -> Fault:
        """Return a copy located in a file, unless the fault names a file."""
        return self if self.path else replace(self, path=str(path))

    def __str__(self) -> str:
        """Return the known parts of ``file:line:column: CODE where: message; hint``.

        Severities other than error precede the code. The result is one line, escaped by
        `escaped`, with arguments named as in Python.
        """
        prefix = ""
        if self.path is not None:
            column = [] if self.column is None else [self.column]
            prefix = ":".join(map(str, [self.path, *self.lines[:1], *column])) + ": "
        location = f"{self.where}: " if self.where else ""
        hint_text = f"; {self.hint}" if self.hint else ""
        if self.severity is not Severity.ERROR:
            prefix += f"{self.severity}: "
        return escaped(f"{prefix}{self.code} {location}{self.message}{hint_text}")

    def as_dict(self) -> dict[str, object]:
        """Return the fault as plain values for a JSON report."""
        return template_values(self, self.json_keys)


def warning(
    code: str, message: str, hint: str | None = None, where: str | None = None
) -> Fault:
    """Return a fault of severity warning."""
    return Fault(code, message, hint=hint, where=where, severity=Severity.WARNING)


class AnimtoolError(Exception):
    """Base class of all animtool errors.

    Attributes:
        faults: At least one fault, in the order found.
        exit_code: Exit code of the command line.
    """

    exit_code: ClassVar[ExitCode] = ExitCode.INTERNAL

    def __init__(self, faults: Fault | Sequence[Fault]) -> None:
        self.faults: tuple[Fault, ...] = (
            (faults,) if isinstance(faults, Fault) else tuple(faults)
        )
        super().__init__("\n".join(map(str, self.faults)))

    def __reduce__(self) -> tuple[type[AnimtoolError], tuple[tuple[Fault, ...]]]:
        """Keep the faults when the error is pickled."""
        return type(self), (self.faults,)

    @property
    def code(self) -> str:
        """Code of the first fault."""
        return self.faults[0].code

    def add(self, faults: Sequence[Fault]) -> None:
        """Append faults to the error."""
        self.faults += tuple(faults)
        self.args = ("\n".join(map(str, self.faults)), *self.args[1:])


class FormatError(AnimtoolError):
    """An input is malformed or cannot be read."""

    exit_code = ExitCode.MALFORMED


class OutputError(AnimtoolError):
    """An output cannot be written."""

    exit_code = ExitCode.MALFORMED


class LockedError(OutputError):
    """Another run holds the lock of this output."""


class OptionError(AnimtoolError):
    """An option, or a combination of options, is invalid."""

    exit_code = ExitCode.USAGE


@contextmanager
def faults_in(path: object) -> Iterator[None]:
    """Add a file to the faults raised in the block that do not name one."""
    try:
        yield
    except (FormatError, OptionError) as error:
        raise type(error)([fault.in_file(path) for fault in error.faults]) from error


@contextmanager
def with_notices(notices: Sequence[Fault]) -> Iterator[None]:
    """Add earlier warnings to errors raised in the block; they may be the cause."""
    try:
        yield
    except (FormatError, OptionError, ToleranceError) as error:
        error.add([w for w in _warnings_of(notices) if w not in error.faults])
        raise


def refuse(
    code: str, message: str, where: str | None = None, hint: str | None = None
) -> NoReturn:
    """Raise `OptionError` for an invalid option."""
    raise OptionError(Fault(code, message, where=where, hint=hint))


# Message, key, and hint of a fault.
Problem: TypeAlias = tuple[str, str | None, str | None]


class RefusalCollector:
    """Collects the refusals of independent checks to raise them together.

    Attributes:
        faults: Faults of the checks so far, in order.
    """

    def __init__(self) -> None:
        self.faults: list[Fault] = []

    @contextmanager
    def collect(self) -> Iterator[None]:
        """Record an `OptionError` of the block, instead of raising it."""
        try:
            yield
        except OptionError as error:
            self.faults += error.faults

    def check(self) -> None:
        """Raise `OptionError` with every distinct fault, if there are any."""
        if self.faults:
            raise OptionError(list(dict.fromkeys(self.faults)))


def refuse_all(code: str, problems: Iterable[Problem]) -> None:
    """Raise `OptionError` with one fault for each problem, if there are any."""
    faults = [Fault(code, text, where=key, hint=hint) for text, key, hint in problems]
    if faults:
        raise OptionError(faults)


class NoMatchError(AnimtoolError):
    """No file matches the given names or patterns."""

    exit_code = ExitCode.NOTHING_MATCHED


class StrictError(AnimtoolError):
    """There are warnings, and ``strict`` allows none."""

    exit_code = ExitCode.FINDINGS


class ToleranceError(AnimtoolError):
    """A solve missed its tolerance, and the caller requires that it is met."""

    exit_code = ExitCode.TOLERANCE


def first_faults(
    faults: Sequence[Fault],
    max_faults: int,
    path: str | None = None,
    extra_text: str = "",
) -> list[Fault]:
    """Return the first faults, and one more that counts the others.

    extra_text: Text to append to the count.
    """
    if len(faults) <= max_faults:
        return list(faults)
    summary = f"{len(faults) - max_faults} more faults are not shown{extra_text}"
    return [*faults[:max_faults], Fault("DOC011", summary, path)]


def listed(items: Sequence[object], max_items: int = 5) -> str:
    """Return the first items separated by commas, with an ellipsis if there are more.

    >>> listed(["a", "b"]), listed(range(9), max_items=2)
    ('a, b', '0, 1 …')
    """
    ellipsis = " …" if len(items) > max_items else ""
    return ", ".join(map(str, items[:max_items])) + ellipsis


def names_fault(
    code: str,
    message: str,
    names: Sequence[str],
    path: str | None = None,
    hint: str | None = None,
    severity: Severity = Severity.ERROR,
) -> Fault:
    """Return a fault that lists all names; its brief form lists the first few.

    >>> names_fault("USD102", "missing: ", list("abcdefghijklmn")).brief
    'missing: a, b, c, d, e, f, g, h, i, j, k, l …'
    """
    full_message = message + listed(names, len(names))
    brief = message + listed(names, MAX_BRIEF_NAMES)
    return Fault(code, full_message, path, (), hint, severity, brief=brief)


def counted(count: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun in the singular or plural.

    >>> counted(1, "joint"), counted(3, "joint"), counted(2, "mesh", "meshes")
    ('1 joint', '3 joints', '2 meshes')
    """
    return f"{count} {noun}" if count == 1 else f"{count} {plural or noun + 's'}"


def cycle_text(names: Sequence[str]) -> str:
    """Return the names of a cycle joined by arrows, shortened if there are many.

    >>> cycle_text(["a", "b", "a"])
    'a → b → a'
    """
    shown_names = list(names)
    if len(shown_names) > MAX_BRIEF_NAMES:
        shown_names = [
            *shown_names[: MAX_BRIEF_NAMES - 2],
            f"… {len(names) - MAX_BRIEF_NAMES} more",
            *shown_names[-1:],
        ]
    return " → ".join(shown_names)


def percent_text(fraction: float) -> str:
    """Return a fraction in percent, to two significant digits.

    >>> percent_text(0.0123), percent_text(5.4973), percent_text(2e-12)
    ('1.2%', '550%', '0%')
    """
    percent = float(f"{100 * fraction:.2g}")
    return f"{percent:.12g}%" if percent >= 1e-4 else "0%"


def refuse_warnings(notices: Sequence[Fault], *, strict: bool) -> None:
    """Raise `StrictError` if there are warnings and ``strict`` is on."""
    warnings = _warnings_of(notices)
    if strict and warnings:
        raise StrictError(warnings)


def _warnings_of(notices: Iterable[Fault]) -> list[Fault]:
    return [notice for notice in notices if notice.severity is Severity.WARNING]


def excerpt(text: str, limit: int = 40) -> str:
    """Return quoted text for use in a message, shortened to fit on a line.

    >>> excerpt("12x")
    "'12x'"
    >>> excerpt("a" * 100, limit=4)
    "'aaaa…'"
    """
    return repr(text if len(text) <= limit else text[:limit] + "…")


def value_excerpt(value: object, limit: int = 40) -> str:
    """Return a value for use in a message, shortened; only text is quoted.

    >>> value_excerpt("5"), value_excerpt([1, 2])
    ("'5'", '[1, 2]')
    """
    if isinstance(value, str):
        return excerpt(value, limit)
    text = repr(value)
    return text if len(text) <= limit else text[:limit] + "…"
