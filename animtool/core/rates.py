"""Frame rates as exact fractions, read from files and options."""

from __future__ import annotations

from decimal import Decimal, InvalidOperation
from enum import StrEnum
from fractions import Fraction
from numbers import Rational
from typing import TYPE_CHECKING, Any, TypeAlias

from animtool.core.arguments import argument
from animtool.core.errors import Fault, OptionError, Severity, excerpt
from animtool.core.record import dataclass

# Largest frame number; beyond it, times between frames are lost to rounding.
MAX_FRAME_NUMBER = 10**9
# Exporters print frame times with 6 or more digits: the resulting error of a rate up to
# 1000 is below this, and neighbouring broadcast rates are 1e-3 apart.
NEAREST_RATE_TOLERANCE = Fraction(25, 100_000)
# Metadata has 29.97 for 30000/1001, a relative error of 1e-6; a factor of 1000/1001
# differs by 1e-3.
METADATA_TOLERANCE = Fraction(5, 1_000_000)
# Powers of ten that limit a valid frame time [s].
FRAME_TIME_EXPONENTS = (-9, 6)
# Range of rates that options and files may state [frame/s].
MIN_STATED_RATE, MAX_STATED_RATE = Fraction(1, 1000), Fraction(100_000)
# Largest integer rate that an inexact frame time is matched with [frame/s].
MAX_INTEGER_RATE = 1000
# Captures and displays are slower; a larger number is probably no rate [frame/s].
MAX_PLAUSIBLE_RATE = 2000
# Maximum number of digits of a frame time.
MAX_NUMBER_DIGITS = 100
# Preferred if a time is printed so coarsely that several integers match.
COMMON_RATES = frozenset({12, 24, 25, 30, 48, 50, 60, 90, 100, 120, 200, 240})

# A rate or frame as people write it: 24, 23.976, "24000/1001", Fraction(24000, 1001).
FractionLike: TypeAlias = int | float | str | Fraction


class OptionalFraction:
    """Type of a field that accepts a number or text and stores a fraction.

    Only type checkers see a descriptor; the record's `__post_init__` converts the
    value.
    """

    if TYPE_CHECKING:

        def __get__(
            self, record: object, owner: type | None = None
        ) -> Fraction | None: ...

        def __set__(self, record: object, value: FractionLike | None) -> None: ...


NO_FRACTION: Any = None  # default of such a field


class RateError(ValueError):
    """A value is not a frame rate."""

    code = "SCN022"


class RateKind(StrEnum):
    """How a frame rate was determined from a printed frame time."""

    REPRINTED = "reprinted"
    NEAREST = "nearest"
    PRINTED = "printed"


@dataclass(frozen=True, slots=True)
class RateChoice:
    """The rate inferred from a printed frame time, and others with the same text."""

    fps: Fraction  # exact frames per second
    # ``reprinted``: the reciprocal rounds to the printed time; ``nearest``: the closest
    # common rate; ``printed``: the printed number as it is.
    kind: RateKind
    ambiguous_rates: tuple[int, ...] = ()  # other integer rates with the same text


def rate_from_frame_time(text: str) -> RateChoice:
    """Return the rate of a printed frame time [s].

    The rate is the integer whose reciprocal, rounded to the printed digits, equals the
    printed value; of several, the exact one, else a common one, else the nearest. If
    there is none, it is the nearest of the integers 1 to 1000 and N·1000/1001 within
    2.5e-4, else the reciprocal of the printed decimal.

    >>> str(rate_from_frame_time("0.0333333").fps)
    '30'
    >>> str(rate_from_frame_time("0.0417083750417").fps)
    '24000/1001'
    """
    try:
        frame_time = Decimal("x" if "_" in text else text)
    except InvalidOperation as error:
        raise ValueError(f"{text!r} is not a number") from error
    if not frame_time.is_finite() or frame_time <= 0:
        raise ValueError(f"{text!r} is not a positive number")
    low, high = FRAME_TIME_EXPONENTS
    if not low <= frame_time.adjusted() <= high:
        raise ValueError(f"{text!r} is not a number of seconds between two frames")
    digits = max(0, -int(frame_time.as_tuple().exponent))
    exact_rate = 1 / Fraction(frame_time)

    matching_rates = _integers_that_print(Fraction(frame_time), digits)
    common_rates = [n for n in matching_rates if n in COMMON_RATES]
    if exact_rate in matching_rates:
        # A common rate may be written with few digits, as 0.04.
        other_rates = () if exact_rate in common_rates else tuple(common_rates)
        return RateChoice(exact_rate, RateKind.REPRINTED, other_rates)
    if matching_rates:
        best_integer_rate = min(
            common_rates or matching_rates, key=lambda n: abs(n - exact_rate)
        )
        other_rates = tuple(n for n in matching_rates if n != best_integer_rate)
        return RateChoice(Fraction(best_integer_rate), RateKind.REPRINTED, other_rates)

    broadcast_counts = _adjacent_integers(exact_rate * 1001 / 1000)
    candidates = [Fraction(n) for n in _adjacent_integers(exact_rate)]
    candidates += [Fraction(n * 1000, 1001) for n in broadcast_counts]
    if candidates:
        best_rate = min(candidates, key=lambda rate: abs(rate - exact_rate))
        if abs(best_rate - exact_rate) <= NEAREST_RATE_TOLERANCE * best_rate:
            return RateChoice(best_rate, RateKind.NEAREST)
    return RateChoice(exact_rate, RateKind.PRINTED)


def _adjacent_integers(rate: Fraction) -> list[int]:
    """Return the integer rates just below and above a rate."""
    return [n for n in (int(rate), int(rate) + 1) if 1 <= n <= MAX_INTEGER_RATE]


def _integers_that_print(printed_time: Fraction, digits: int) -> list[int]:
    """Return the integers from 1 to 1000 whose reciprocals round to a printed time."""
    half_digit = Fraction(1, 2 * 10**digits) if digits < 400 else Fraction(0)
    min_time, max_time = printed_time - half_digit, printed_time + half_digit
    smallest_rate = int(1 / max_time)
    largest_rate = int(1 / min_time) + 1 if min_time > 0 else MAX_INTEGER_RATE
    return [
        n
        for n in range(max(1, smallest_rate), min(MAX_INTEGER_RATE, largest_rate) + 1)
        if min_time <= Fraction(1, n) < max_time
    ]


def rate_from_float(fps: float) -> Fraction:
    """Return the exact rate that a float in file metadata approximates.

    The rate is an integer or N·1000/1001 if the float equals one of them to 5e-6, or is
    the usual decimal for one. Otherwise it is the float's exact value, rounded to a
    denominator below 1e6.

    >>> rate_from_float(23.976023976023978)
    Fraction(24000, 1001)
    """
    if not 0 < fps < float("inf"):
        raise ValueError(f"{fps!r} is not a positive number")
    exact_rate = Fraction(fps)
    known_rate = _BROADCAST_RATES.get(f"{fps:g}")
    if known_rate is not None:
        return known_rate
    nearest_integer = round(exact_rate)
    broadcast_count = round(exact_rate * 1001 / 1000)
    nearest_rate = min(
        (Fraction(nearest_integer), Fraction(broadcast_count * 1000, 1001)),
        key=lambda rate: abs(rate - exact_rate),
    )
    if abs(nearest_rate - exact_rate) <= nearest_rate * METADATA_TOLERANCE:
        return nearest_rate
    return exact_rate.limit_denominator(1_000_000)


# Common decimals for the broadcast rates.
_BROADCAST_RATES = {
    "23.976": Fraction(24000, 1001),
    "23.98": Fraction(24000, 1001),
    "29.97": Fraction(30000, 1001),
    "47.952": Fraction(48000, 1001),
    "47.95": Fraction(48000, 1001),
    "59.94": Fraction(60000, 1001),
    "119.88": Fraction(120000, 1001),
}


def exact_number(number: FractionLike) -> Fraction:
    """Return an exact number from ``24``, ``23.976`` or ``24000/1001``.

    >>> exact_number("1e-3")
    Fraction(1, 1000)
    """
    text = (number if isinstance(number, str) else _number_text(number)).strip()
    exponent = text.lower().partition("e")[2]
    # Numbers of millions of digits would take hours.
    if len(text) > MAX_NUMBER_DIGITS or len(exponent) > len("-300"):
        raise ValueError(f"{excerpt(text)} has too many digits")
    return Fraction(text)


def parse_rate(rate: FractionLike) -> Fraction:
    """Return a rate from ``24``, ``23.976`` or ``24000/1001``.

    A fraction is used as it is.

    >>> parse_rate("29.97")
    Fraction(30000, 1001)
    """
    text = (rate if isinstance(rate, str) else _number_text(rate)).strip()
    if text in _BROADCAST_RATES:
        return _BROADCAST_RATES[text]
    try:
        exact_rate = exact_number(text)
    except (ValueError, ArithmeticError) as error:
        raise RateError(
            f"{excerpt(text)} is not a frame rate such as 24, 23.976 or 24000/1001"
        ) from error
    if not MIN_STATED_RATE <= exact_rate <= MAX_STATED_RATE:
        rate_text = excerpt(text).strip("'")
        raise RateError(
            f"a frame rate is between 0.001 and 100000, such as 24, not {rate_text}"
        )
    return exact_rate


def _number_text(number: object) -> str:
    """Return a number as text for `Fraction`; return other values unchanged."""
    if isinstance(number, float):
        return f"{number:.12g}"
    is_rate = isinstance(number, Rational) and not isinstance(number, bool)
    return str(number) if is_rate else repr(number)


def rate_option(fps: FractionLike) -> Fraction:
    """Return the rate of the option ``fps``, see `parse_rate` (else SCN022).

    >>> rate_option("29.97")
    Fraction(30000, 1001)
    """
    try:
        return parse_rate(fps)
    except RateError as error:
        raise OptionError(Fault(error.code, f"fps: {error}")) from error


def rate_label(fps: Fraction) -> str:
    """Return a rate as text, with a decimal next to a fraction.

    >>> rate_label(Fraction(24000, 1001)), rate_label(Fraction(30))
    ('24000/1001 (23.976) fps', '30 fps')
    """
    if fps.denominator == 1:
        return f"{fps.numerator} fps"
    if len(str(fps.denominator)) <= 4:
        return f"{fps} ({float(fps):.5g}) fps"
    return f"{float(fps):.7g} fps"


def is_common_rate(fps: Fraction) -> bool:
    """Return whether a rate is common in film, broadcast, displays or capture.

    >>> is_common_rate(Fraction(24000, 1001)), is_common_rate(Fraction(31))
    (True, False)
    """
    return fps in COMMON_RATES or fps in _BROADCAST_RATES.values()


def rate_of_milliseconds(text: str) -> Fraction | None:
    """Return the common rate of a printed frame time in milliseconds, else None.

    A number that is a common rate itself is not taken for milliseconds.

    >>> str(rate_of_milliseconds("33.3333")), rate_of_milliseconds("50")
    ('30', None)
    """
    try:
        if is_common_rate(rate_from_float(float(text))):
            return None
        rate = rate_from_frame_time(str(Decimal(text).scaleb(-3))).fps
    except ValueError:
        return None
    return rate if is_common_rate(rate) else None


def rate_warning(fps: Fraction, name: str | None = "fps") -> list[Fault]:
    """Return a warning if a number of frames a second is implausible (TAKE009).

    name: Name of the argument that sets the rate; None if only the file sets it.
    """
    if 1 <= fps <= MAX_PLAUSIBLE_RATE:
        return []
    rate_text = f"{float(fps):g}"
    rate_text = f"fps {rate_text}" if name is None else argument(name, rate_text)
    message = (
        f"{rate_text} is implausible; film has 24 frames a second, captures up to 1000"
    )
    hint = "use the number of frames in one second, not their total or a frame time"
    if MIN_STATED_RATE <= fps < 1:
        inverse_rate = rate_from_frame_time(f"{float(fps):.12g}").fps
        if is_common_rate(inverse_rate):
            hint = f"it looks like the frame time of {rate_label(inverse_rate)}; "
            hint += f"write {inverse_rate}"
    return [Fault("TAKE009", message, hint=hint, severity=Severity.WARNING)]
