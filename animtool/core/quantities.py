"""Formats numbers, lengths, durations and texts for reports.

Names, paths and messages may contain anything. Control characters move the cursor or
set a title, bidirectional marks show a name backwards, and a line that begins with
``::`` is a command for some services of continuous integration.

References:
    Unicode Technical Report 36, "Unicode Security Considerations".
    GitHub Docs, "Workflow commands for GitHub Actions"; Microsoft, "Logging commands"
    of Azure Pipelines, which are read anywhere in a line.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable

# An integer of at least this many seconds may be meant in frames.
MIN_SUSPECT_SECONDS = 5
# Shorter steps are not mistaken for a number of steps per second [s].
MIN_SUSPECT_STEP = 1.0
# Character class of a regular expression: characters that names never need.
CONTROL_CHARACTERS = "\x00-\x1f\x7f-\x9f\ud800-\udfff"
# Control characters, line ends, zero-width characters, changes of text direction, and
# joiners except between joined letters.
_INVISIBLE = (
    f"{CONTROL_CHARACTERS}\xad\u061c\u180e\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f"
    "\ufeff\ufff9-\ufffb\ufffe\uffff\U000e0000-\U000e007f"
)
_STRAY_JOINER = "(?<![^\x00-\x7f])[\u200c\u200d]|[\u200c\u200d](?![^\x00-\x7f])"
_PIPELINE_COMMAND = r"#(?=#\w{0,9}\[)"
_CHARACTERS_TO_ESCAPE = re.compile(
    f"[{_INVISIBLE}]|{_STRAY_JOINER}|{_PIPELINE_COMMAND}"
)
_LEADING_COLON = re.compile(r"\A(\s*):(?=:)")
_SHORT_ESCAPES = {"\n": r"\n", "\r": r"\r", "\t": r"\t"}


def escaped(text: str) -> str:
    r"""Return text with characters escaped that are unsafe to print.

    Text without such characters is returned unchanged, and so is escaped text.

    >>> escaped("hip\x1b]0;mine\x07"), escaped("a\n::error::b"), escaped("::error::b")
    ('hip\\x1b]0;mine\\x07', 'a\\n::error::b', '\\x3a:error::b')
    """
    if text.isascii() and text.isprintable() and ":" not in text and "#" not in text:
        return text
    return _LEADING_COLON.sub(r"\1\\x3a", _CHARACTERS_TO_ESCAPE.sub(_escape, text))


def escaped_lines(text: str) -> str:
    r"""Return text of several lines, each escaped by `escaped`.

    >>> escaped_lines("one\n::two\n")
    'one\n\\x3a:two\n'
    """
    return "\n".join(map(escaped, text.split("\n")))


def printable_json(
    value: object, *, indent: int | None = None, is_ascii_only: bool = False
) -> str:
    r"""Return a value as UTF-8 JSON with the escapes of `escaped`.

    >>> printable_json("\x9b\udcff##[error]")
    '"\\u009b\\udcff\\u0023#[error]"'
    """
    text = json.dumps(value, indent=indent, ensure_ascii=is_ascii_only, allow_nan=False)
    # Line ends are only between values; json escapes all others.
    return _CHARACTERS_TO_ESCAPE.sub(_escape_json, text)


def _escape(match: re.Match[str]) -> str:
    code_point = ord(match[0])
    if match[0] in _SHORT_ESCAPES:
        return _SHORT_ESCAPES[match[0]]
    if code_point < 0x100:
        return f"\\x{code_point:02x}"
    return f"\\u{code_point:04x}" if code_point < 0x10000 else f"\\U{code_point:08x}"


def _escape_json(match: re.Match[str]) -> str:
    if match[0] == "\n":
        return "\n"
    return json.dumps(match[0])[1:-1] if match[0] != "#" else "\\u0023"


# Minimum for using a unit, its size, and its name.
_LENGTH_UNITS = (
    (1.0, 1.0, "m"),
    (1e-6, 1e-3, "mm"),
    (1e-9, 1e-6, "µm"),
    (0.0, 1e-9, "nm"),
)
# Largest number of zeros printed before using an exponent.
MAX_PRINTED_ZEROS = 15
# Shorter lengths are rounding errors of float64 [m].
MIN_PRINTED_LENGTH = 1e-12
# Smaller angles are rounding errors of float64 [deg].
MIN_PRINTED_ANGLE = 1e-6
# Largest error in images that is shown as a number [px].
MAX_PRINTED_PIXELS = 100_000
_DURATION_UNITS = ((1.0, 1.0, "s"), (1e-3, 1e-3, "ms"), (0.0, 1e-6, "µs"))
_SIZE_UNITS = ((1e9, 1e9, "GB"), (1e6, 1e6, "MB"), (1e3, 1e3, "kB"), (0.0, 1.0, "B"))


def floor_to_two_digits(value: float) -> float:
    """Return a positive number rounded down to two significant digits.

    >>> floor_to_two_digits(0.00128), floor_to_two_digits(0.0349)
    (0.0012, 0.034)
    """
    exponent = math.floor(math.log10(value)) - 1
    return float(f"{math.floor(value / 10.0**exponent)}e{exponent}")


def plain_number(value: float, digits: int = 3) -> str:
    """Return a number rounded to significant digits, without an exponent.

    Numbers with more than about fifteen zeros have an exponent.

    >>> [plain_number(value) for value in (1614.2, 0.000267, 26.2, 0.0, 5e-324)]
    ['1610', '0.000267', '26.2', '0', '4.94e-324']
    """
    if not math.isfinite(value):
        return f"{value:g}"
    text = f"{value:.{digits}g}"
    if "e" not in text:
        return text
    rounded_number, exponent = float(text), int(text.partition("e")[2])
    if abs(exponent) > MAX_PRINTED_ZEROS:
        return text
    decimals = max(0, digits - 1 - exponent)
    text = f"{rounded_number:.{decimals}f}"
    return text.rstrip("0").rstrip(".") if decimals else text


def vector_text(values: Iterable[float], digits: int = 3) -> str:
    """Return numbers as a list, as in YAML.

    >>> vector_text((20, 0.50001, -0.0))
    '[20, 0.5, 0]'
    """
    return f"[{', '.join(plain_number(value + 0.0, digits) for value in values)}]"


def length_text(meters: float, digits: int = 3) -> str:
    """Return a length in metres, or in a smaller unit if it is short.

    >>> length_text(26.2), length_text(0.00012), length_text(4.1e-8), length_text(0)
    ('26.2 m', '0.12 mm', '0.041 µm', '0 mm')
    """
    if 0 < abs(meters) < MIN_PRINTED_LENGTH:
        return "below 0.001 nm"
    return _unit_text(meters, _LENGTH_UNITS, "mm", digits)


def angle_text(degrees: float, digits: int = 3) -> str:
    """Format an angle in degrees; tiny angles other than 0 are ``below 0.000001°``.

    >>> angle_text(26.25, 4), angle_text(0.000267), angle_text(8.8e-13), angle_text(0)
    ('26.25°', '0.000267°', 'below 0.000001°', '0°')
    """
    if 0 < abs(degrees) < MIN_PRINTED_ANGLE:
        return f"below {plain_number(MIN_PRINTED_ANGLE)}°"
    return f"{plain_number(degrees, digits)}°"


def duration_text(seconds: float, digits: int = 3) -> str:
    """Format a duration [s] in s, ms or µs, the largest that is not above it.

    >>> duration_text(1.61e-3), duration_text(72.4), duration_text(3e-5)
    ('1.61 ms', '72.4 s', '30 µs')
    """
    return _unit_text(seconds, _DURATION_UNITS, "s", digits)


def pixels_text(pixels: float) -> str:
    """Format an error in images [px]; beyond a large image its size means nothing.

    >>> pixels_text(0.437), pixels_text(1.4e154)
    ('0.4 px', 'more than 100,000 px')
    """
    if not abs(pixels) <= MAX_PRINTED_PIXELS:
        return f"more than {MAX_PRINTED_PIXELS:,} px"
    return f"{pixels:.1f} px"


def frames_hint(seconds: float, rate: float) -> str | None:
    """Return a hint if a duration in seconds looks like a number of frames.

    >>> frames_hint(30, 120), frames_hint(0.5, 120)
    ('30 frames at 120 frames per second are 0.25 s', None)
    """
    if seconds < MIN_SUSPECT_SECONDS or seconds != round(seconds):
        return None
    duration = f"{seconds / rate:.3g} s"
    return f"{seconds:g} frames at {rate:.6g} frames per second are {duration}"


def step_hint(step: float) -> str:
    """Return how to write a step [s] that was given in steps per second.

    >>> step_hint(24)
    'step is in seconds: for 24 a second write 0.0417'
    """
    rate = plain_number(step)
    return f"step is in seconds: for {rate} a second write {plain_number(1 / step)}"


def percent_hint(value: float) -> str:
    """Return how to write a fraction that was given in percent.

    >>> percent_hint(60), percent_hint(2.5)
    ('for 60% write 0.6', 'for 2.5% write 0.025')
    """
    return f"for {value:.4g}% write {value / 100:.4g}"


def size_text(size: float, digits: int = 3) -> str:
    """Format a size [B] in B, kB, MB or GB, the largest that is not above it.

    >>> size_text(5160), size_text(20)
    ('5.16 kB', '20 B')
    """
    return _unit_text(size, _SIZE_UNITS, "B", digits)


def _unit_text(
    value: float,
    units: tuple[tuple[float, float, str], ...],
    zero_unit: str,
    digits: int,
) -> str:
    if not value:
        return f"0 {zero_unit}"
    _, unit, name = next(each for each in units if abs(value) >= each[0])
    return f"{plain_number(value / unit, digits)} {name}"
