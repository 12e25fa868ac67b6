"""What commands print, without what they measured of themselves.

Replaced are durations, speeds per second and peaks of memory, in lines, tables and
JSON; marks and advice that tell which of several methods was fastest; and the order in
which items of a batch end. Nothing else is.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

__all__ = ["normalise"]

_NUMBER = r"\d[\d.]*"
_DURATION = rf"{_NUMBER} (?:ns|µs|ms|s|min|h)"
_KEYS = "|".join(
    (
        *("seconds", "megabytes_per_second", "milliseconds_per_frame", "peak_bytes"),
        *("microseconds_per_frame", "simulated_per_second"),
    )
)
_MEASURED = [
    (rf"(?m)( written in ){_DURATION}(?:, {_NUMBER} [kMG]?B/s of source)?$", r"\1#"),
    (rf"(?m), {_DURATION} per frame(?=,|$)", ", # per frame"),
    (rf"(?m), {_NUMBER} frames per second$", ", # frames per second"),
    (rf"(?m)^(\[\d+/\d+\] .*\)) {_NUMBER} s$", r"\1 #"),
    (rf"(?m)^(\d+ items?: .* in ){_NUMBER} s$", r"\1#"),
    (r"(?m)^  slowest: .*$", "  slowest: #"),
    (r"(?m)^  .* is as accurate in \d+% of the time$", "  # of the time"),
    (r"(?m)^  nothing tried is as exact and much faster .*$", "  # of the time"),
    (rf'("(?:{_KEYS})": )(?:-?{_NUMBER}(?:e[-+]\d+)?|null)', r"\1#"),
    (r'("seconds": )\{[^{}]*\}', r"\1#"),
]
_COLUMNS = ("seconds", "sim s/s", "peak MB", "µs/frame")
_ITEM = re.compile(r"\[\d+(/\d+\] .*)")


def normalise(text: str) -> str:
    """Return printed text with ``#`` in place of what was measured."""
    for pattern, replacement in _MEASURED:
        text = re.sub(pattern, replacement, text)
    return "\n".join(_in_order(_without_columns(text.split("\n"))))


def _without_columns(lines: list[str]) -> Iterator[str]:
    """Yield lines, measured columns of tables replaced and their spaces collapsed."""
    ends: list[int] = []
    for line in lines:
        heads = [
            found.end()
            for column in _COLUMNS
            if (found := re.search(rf"(?:^|  ){column}(?=  |$)", line))
        ]
        if not line.strip():
            ends = []
        ends = heads or ends
        yield _without_cells(line, ends) if ends else line


def _without_cells(line: str, ends: list[int]) -> str:
    """Return a row without the numbers that end there and marks of the fastest."""
    for end in sorted(ends, reverse=True):
        cell = re.search(rf"(?<= ){_NUMBER}$", line[:end])
        if cell:
            line = f"{line[: cell.start()]}#{line[end:]}"
    line = re.sub(r"^ *(>?)[*+]* +", r"\1 ", line)
    return re.sub(" {2,}", "  ", line)


def _in_order(lines: Iterator[str]) -> Iterator[str]:
    """Yield lines, those of items of a batch sorted and without their turn."""
    items: list[str] = []
    for line in lines:
        if found := _ITEM.fullmatch(line):
            items.append(f"[#{found[1]}")
            continue
        yield from sorted(items)
        items = []
        yield line
    yield from sorted(items)
