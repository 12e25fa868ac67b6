"""Frame rates as exact fractions, parsed from files and options."""

from __future__ import annotations

from decimal import Decimal, InvalidOperation
from enum import StrEnum
from fractions import Fraction
from numbers import Rational
from typing import TYPE_CHECKING, Any, TypeAlias

from animtool.core.arguments import argument
from animtool.core.errors import Fault, OptionError, Severity, excerpt
from animtool.core.record import dataclass

# Beyond it a frame is no frame: times between frames would be lost to rounding.
LARGEST_FRAME = 10**9
# Exporters print frame times to 6 or more digits: the error left in a rate up to
# 1000 is below this, and neighbouring broadcast rates are 1e-3 apart.
NEAREST_RATE_TOLERANCE = Fraction(25, 100_000)
# Metadata says 29.97 for 30000/1001, which is 1e-6 off; 1000/1001 apart is 1e-3.
METADATA_TOLERANCE = Fraction(5, 1_000_000)
# Powers of ten [s] beyond which a time between frames is none.
FRAME_TIME_EXPONENTS = (-9, 6)
LOWEST_WRITTEN_RATE, HIGHEST_WRITTEN_RATE = Fraction(1, 1000), Fraction(100_000)
HIGHEST_RATE = 1000
# Captures and displays are slower; a larger number is probably not a frame rate.
MAX_PLAUSIBLE_RATE = 2000
# Taken first where a time is printed so coarsely that several integers fit.
MAX_DIGITS = 100
COMMON_RATES = frozenset({12, 24, 25, 30, 48, 50, 60, 90, 100, 120, 200, 240})

# A rate or frame as people write it: 24, 23.976, "24000/1001", Fraction(24000, 1001).
FractionLike: TypeAlias = int | float | str | Fraction


class OptionalFraction:
    """Field type: accepts a number or text and stores a fraction.

    Type checkers alone know it as a descriptor; `__post_init__` of the record makes
    the fraction.
    """

    if TYPE_CHECKING:

        def __get__(
            self, record: object, owner: type | None = None
        ) -> Fraction | None: ...

        def __set__(self, record: object, value: FractionLike | None) -> None: ...


NO_FRACTION: Any = None  # the default of such a field


class RateError(ValueError):
    """A value is not a frame rate."""

    code = "SCN022"


class RateKind(StrEnum):
    """How a rate was determined."""

    REPRINTED = "reprinted"
    NEAREST = "nearest"
    PRINTED = "printed"


@dataclass(frozen=True, slots=True)
class RateChoice:
    """A frame rate chosen for a printed frame time."""

    fps: Fraction  # frames a second, exact
    # ``reprinted``: the reciprocal rounds to what is printed; ``nearest``: the closest
    # usual rate; ``printed``: the printed number taken as it is.
    kind: RateKind
    rivals: tuple[int, ...] = ()  # other integer rates that would have printed the same


def rate_from_frame_time(text: str) -> RateChoice:
    """Return the rate of a printed frame time [s].

    An integer whose reciprocal, rounded to the digits printed, is the printed
    value (of several, the exact one, else a usual one, else the nearest); else the
    nearest of the integers 1 to 1000 and N·1000/1001 within 2.5e-4; else the
    reciprocal of the printed decimal.

    Raises:
        ValueError: The text is not a positive finite decimal number.

    >>> str(rate_from_frame_time("0.0333333").fps)
    '30'
    >>> str(rate_from_frame_time("0.0417083750417").fps)
    '24000/1001'
    """
    try:
        printed = Decimal("x" if "_" in text else text)
    except InvalidOperation as error:
        raise ValueError(f"{text!r} is not a number") from error
    if not printed.is_finite() or printed <= 0:
        raise ValueError(f"{text!r} is not a positive number")
    low, high = FRAME_TIME_EXPONENTS
    if not low <= printed.adjusted() <= high:
        raise ValueError(f"{text!r} is not a number of seconds between two frames")
    digits = max(0, -int(printed.as_tuple().exponent))
    exact = 1 / Fraction(printed)

    fitting = _integers_that_print(Fraction(printed), digits)
    if fitting:
        common = [] if exact in fitting else [n for n in fitting if n in COMMON_RATES]
        best = min(common or fitting, key=lambda n: abs(n - exact))
        rivals = () if best == exact else tuple(n for n in fitting if n != best)
        return RateChoice(Fraction(best), RateKind.REPRINTED, rivals)

    candidates = [Fraction(n) for n in _around(exact)]
    candidates += [Fraction(n * 1000, 1001) for n in _around(exact * 1001 / 1000)]
    if candidates:
        best_rate = min(candidates, key=lambda rate: abs(rate - exact))
        if abs(best_rate - exact) <= NEAREST_RATE_TOLERANCE * best_rate:
            return RateChoice(best_rate, RateKind.NEAREST)
    return RateChoice(exact, RateKind.PRINTED)


def _around(rate: Fraction) -> list[int]:
    return [n for n in (int(rate), int(rate) + 1) if 1 <= n <= HIGHEST_RATE]


def _integers_that_print(printed: Fraction, digits: int) -> list[int]:
    """Integers n in 1..1000 with 1/n, rounded half up to digits, as printed."""
    half = Fraction(1, 2 * 10**digits) if digits < 400 else Fraction(0)
    low, high = printed - half, printed + half
    first = int(1 / high)
    last = int(1 / low) + 1 if low > 0 else HIGHEST_RATE
    return [
        n
        for n in range(max(1, first), min(HIGHEST_RATE, last) + 1)
        if low <= Fraction(1, n) < high
    ]


def rate_from_float(fps: float) -> Fraction:
    """Return the exact rate of a float in file metadata.

    An integer or N·1000/1001 where the float is one of them to 5e-6, or the
    decimal that is usually written for one; else the float's exact value rounded to
    a denominator below 1e6.

    Raises:
        ValueError: The rate is not positive and finite.

    >>> rate_from_float(23.976023976023978)
    Fraction(24000, 1001)
    """
    if not 0 < fps < float("inf"):
        raise ValueError(f"{fps!r} is not a positive number")
    exact = Fraction(fps)
    fixed = _BROADCAST.get(f"{fps:g}")
    if fixed is not None:
        return fixed
    integer, broadcast = round(exact), round(exact * 1001 / 1000)
    nearest = min(
        (Fraction(integer), Fraction(broadcast * 1000, 1001)),
        key=lambda rate: abs(rate - exact),
    )
    if abs(nearest - exact) <= nearest * METADATA_TOLERANCE:
        return nearest
    return exact.limit_denominator(1_000_000)


# The decimals that people write for the broadcast rates.
_BROADCAST = {
    "23.976": Fraction(24000, 1001),
    "23.98": Fraction(24000, 1001),
    "29.97": Fraction(30000, 1001),
    "47.952": Fraction(48000, 1001),
    "47.95": Fraction(48000, 1001),
    "59.94": Fraction(60000, 1001),
    "119.88": Fraction(120000, 1001),
}


def exact_number(text: FractionLike) -> Fraction:
    """Return an exact number from ``24``, ``23.976`` or ``24000/1001``.

    Raises:
        ValueError: It is none, or has more digits than a number that anybody writes.

    >>> exact_number("1e-3")
    Fraction(1, 1000)
    """
    text = (text if isinstance(text, str) else _digits(text)).strip()
    exponent = text.lower().partition("e")[2]
    # What has millions of digits takes hours to work out.
    if len(text) > MAX_DIGITS or len(exponent) > len("-300"):
        raise ValueError(f"{excerpt(text)} has too many digits")
    return Fraction(text)


def parse_rate(text: FractionLike) -> Fraction:
    """Return a rate from ``24``, ``23.976`` or ``24000/1001``.

    A fraction is taken as it is.

    Raises:
        RateError: It is not a positive number.

    >>> parse_rate("29.97")
    Fraction(30000, 1001)
    """
    if not isinstance(text, str):
        text = _digits(text)
    text = text.strip()
    if text in _BROADCAST:
        return _BROADCAST[text]
    try:
        rate = exact_number(text)
    except (ValueError, ArithmeticError) as error:
        raise RateError(
            f"{excerpt(text)} is not a frame rate such as 24, 23.976 or 24000/1001"
        ) from error
    if not LOWEST_WRITTEN_RATE <= rate <= HIGHEST_WRITTEN_RATE:
        shown = excerpt(text).strip("'")
        raise RateError(f"a frame rate is between 0.001 and 100000, not {shown}")
    return rate


def _digits(number: object) -> str:
    """Return a number as text for `Fraction`; anything else unchanged."""
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
    """Return a rate as text.

    >>> rate_label(Fraction(24000, 1001)), rate_label(Fraction(30))
    ('24000/1001 (23.976) fps', '30 fps')
    """
    if fps.denominator == 1:
        return f"{fps.numerator} fps"
    if len(str(fps.denominator)) <= 4:
        return f"{fps} ({float(fps):.5g}) fps"
    return f"{float(fps):.7g} fps"


def rate_warning(fps: Fraction, name: str | None = "fps") -> list[Fault]:
    """Return a warning about an implausible number of frames a second (TAKE009).

    name: Of the argument that sets the rate; None where only the file does.
    """
    if 1 <= fps <= MAX_PLAUSIBLE_RATE:
        return []
    stated = f"{float(fps):g}"
    stated = f"fps {stated}" if name is None else argument(name, stated)
    message = (
        f"{stated} is implausible; film has 24 frames a second, captures up to 1000"
    )
    hint = "use the number of frames in one second, not their total or a frame time"
    return [Fault("TAKE009", message, hint=hint, severity=Severity.WARNING)]
