"""Ways to spoil valid inputs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

# What parsers stumble over, as bytes of text.
WORDS = [
    *(b"nan", b"-inf", b"1e309", b"-1e39", b"1e-400", b"0x7f", b"1_000", b"--1"),
    *(b"9" * 30, b"-1", b"4294967296", b"9223372036854775808", b"0.0", b"1e5"),
    *(b"\x00", b"\r", b"\n", b"\r\n", b"\t", b"\x1b]0;title\x07", b"\x7f", b"\x9b"),
    *(
        "\ufeff\u2028\u202e\U0001f9b4".encode(),
        b"\xff\xfe",
        b"\xc3\x28",
        b"\xed\xa0\x80",
    ),
    *(
        b"{",
        b"}",
        b"[",
        b"]",
        b'"',
        b"'",
        b"(",
        b")",
        b"<",
        b">",
        b":",
        b"#",
        b"&",
        b"*",
    ),
    *(b"../../../../etc/passwd", b"/dev/zero", b"/dev/stdin", b"~", b".", b"", b"%s"),
    *(b"\n::error::mine\n", b"null", b"true", b"{" * 200, b"[" * 200, b"a" * 5000),
]


def spoil(rng: np.random.Generator, data: bytes, most: int = 6) -> bytes:
    """Return data with up to ``most`` changes, the fewer the likelier."""
    changed = bytearray(data)
    for _ in range(int(min(rng.geometric(0.5), most))):
        _CHANGES[rng.integers(len(_CHANGES))](rng, changed)
    return bytes(changed)


def _span(rng: np.random.Generator, data: bytearray, most: int = 64) -> slice:
    """Return a piece of the data, short ones the likeliest."""
    begin = int(rng.integers(len(data) + 1))
    return slice(begin, begin + int(min(rng.geometric(0.1), most)))


def _flip(rng: np.random.Generator, data: bytearray) -> None:
    if data:
        data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))


def _byte(rng: np.random.Generator, data: bytearray) -> None:
    if data:
        data[rng.integers(len(data))] = int(rng.integers(256))


def _remove(rng: np.random.Generator, data: bytearray) -> None:
    del data[_span(rng, data)]


def _repeat(rng: np.random.Generator, data: bytearray) -> None:
    piece = _span(rng, data)
    data[piece.start : piece.start] = data[piece] * int(min(rng.geometric(0.2), 50))


def _move(rng: np.random.Generator, data: bytearray) -> None:
    piece = bytes(data[_span(rng, data)])
    place = int(rng.integers(len(data) + 1))
    data[place:place] = piece


def _word(rng: np.random.Generator, data: bytearray) -> None:
    piece = _span(rng, data, 12)
    if rng.integers(2):
        piece = slice(piece.start, piece.start)
    data[piece] = WORDS[rng.integers(len(WORDS))]


def _number(rng: np.random.Generator, data: bytearray) -> None:
    """Put little-endian integers of any size where sizes and offsets stand."""
    width = int(rng.choice([1, 2, 4, 8]))
    near = int(rng.choice([0, 1, 2**7, 2**15, 2**31, 2**63, 2**64 - 1]))
    value = (near + int(rng.integers(-2, 3))) % 2 ** (8 * width)
    begin = int(rng.integers(len(data) + 1))
    data[begin : begin + width] = value.to_bytes(width, "little")


def _cut(rng: np.random.Generator, data: bytearray) -> None:
    if rng.random() < 0.3:
        del data[rng.integers(len(data) + 1) :]


def _line(rng: np.random.Generator, data: bytearray) -> None:
    """Remove, repeat or swap whole lines."""
    lines = bytes(data).splitlines(keepends=True)
    if len(lines) > 1:
        a, b = rng.integers(len(lines), size=2)
        kind = rng.integers(3)
        if kind == 0:
            del lines[a]
        elif kind == 1:
            lines.insert(b, lines[a])
        else:
            lines[a], lines[b] = lines[b], lines[a]
        data[:] = b"".join(lines)


_CHANGES = (_flip, _byte, _remove, _repeat, _move, _word, _word, _number, _cut, _line)


def pick(rng: np.random.Generator, seeds: Sequence[bytes]) -> bytes:
    """Return one of the valid inputs."""
    return seeds[int(rng.integers(len(seeds)))]


# What stands where another value should.
VALUES: list[object] = [
    *(None, True, False, 0, 1, -1, 2**31, 2**63, 10**30, -(10**19)),
    *(0.5, -0.0, 1e308, float("nan"), float("inf"), float("-inf")),
    *("", "a", "0", "nan", "/", "..", "../" * 40 + "a", "/dev/zero", "a\0b", "\ud800"),
    *("\x1b]0;title\x07", "\u202e\U0001f9b4", "a" * 5000, "file://host/a", "%00", "~"),
    *([], {}, [[]], [None], [1, "a"], {"": 1}, {"a": {"b": []}}),
]


def spoil_values(rng: np.random.Generator, value: object, most: int = 4) -> object:
    """Return plain values, as JSON has them, with up to ``most`` changes."""
    for _ in range(int(min(rng.geometric(0.6), most))):
        value = _spoilt(rng, value)
    return value


def _spoilt(rng: np.random.Generator, value: object) -> object:
    pairs: list[tuple[Any, object]] = []
    if isinstance(value, dict):
        pairs = list(value.items())
    elif isinstance(value, list):
        pairs = list(enumerate(value))
    if not pairs or rng.random() < 0.15:
        return _odd(rng, value)
    i = int(rng.integers(len(pairs)))
    key, inner = pairs[i]
    kind = rng.integers(8)
    if kind == 0:
        del pairs[i]
    elif kind == 1:
        pairs.insert(i, (_odd_value(rng), inner))
    else:
        pairs[i] = key, _spoilt(rng, inner)
    if isinstance(value, dict):
        return {str(k): v for k, v in pairs}
    return [v for _, v in pairs]


def _odd(rng: np.random.Generator, value: object) -> object:
    """Return another value: of another kind, of another size, or deep inside."""
    kind = rng.integers(6)
    if kind == 0 and isinstance(value, int | float):
        return value * float(rng.choice([-1.0, 0.0, 1e6, 1e-6, 1e300]))
    if kind == 1:
        for _ in range(int(rng.choice([2, 50, 200]))):
            value = [value] if rng.integers(2) else {"a": value}
        return value
    if kind == 2 and isinstance(value, str):
        return value + value[: int(rng.integers(len(value) + 1))]
    return _odd_value(rng)


def _odd_value(rng: np.random.Generator) -> object:
    return VALUES[int(rng.integers(len(VALUES)))]
