"""How long an item may take, and how much memory."""

from __future__ import annotations

import re
from dataclasses import dataclass

from animtool.errors import excerpt

# Beyond what anybody waits for, and within what systems can count.
MAX_SECONDS = 1e9
MAX_BYTES = 10**18

_UNITS = {
    **{name: 1000**i for i, name in enumerate(("B", "KB", "MB", "GB", "TB"))},
    **{name: 1024**i for i, name in enumerate(("KiB", "MiB", "GiB", "TiB"), 1)},
}
_SIZE = re.compile(r"([0-9]+(?:\.[0-9]+)?)\s*([KMGT]i?B|B)")


@dataclass(frozen=True, slots=True)
class Limits:
    """What an item may take.

    Attributes:
        seconds: Of wall time; None is as long as it takes.
        memory: Of the process that makes it, all told [bytes]; None is any.
    """

    seconds: float | None = None
    memory: int | None = None


def parse_bytes(text: str) -> int:
    """Return the size [bytes] of a text such as ``2GB`` or ``512MiB``.

    Raises:
        ValueError: It is none.

    >>> parse_bytes("1.5GB"), parse_bytes("2 KiB")
    (1500000000, 2048)
    """
    found = _SIZE.fullmatch(text.strip())
    size = float(found[1]) * _UNITS[found[2]] if found else 0.0
    if not 1 <= size <= MAX_BYTES:
        raise ValueError(f"{excerpt(text)} is no size such as 2GB or 512MiB")
    return int(size)


def parse_seconds(text: str) -> float:
    """Return the time [s] of a text.

    Raises:
        ValueError: It is none that is above 0, and up to `MAX_SECONDS`.
    """
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0 < seconds <= MAX_SECONDS:
        raise ValueError(f"{excerpt(text)} is no number of seconds above 0")
    return seconds


def bytes_text(size: int) -> str:
    """Return a size in words.

    >>> bytes_text(1_500_000_000), bytes_text(20)
    ('1.5 GB', '20 B')
    """
    value, names = float(size), ["B", "KB", "MB", "GB", "TB"]
    while value >= 1000 and len(names) > 1:
        value, names = value / 1000, names[1:]
    return f"{value:.3g} {names[0]}"
