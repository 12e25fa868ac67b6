"""Types of keys that files of several kinds have."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from annotated_types import Len
from pydantic import Field

from animtool.documents.check import FileModel

# The largest number in a file, in its own unit. The square of one is held by float32,
# which USD has, in any unit; the product of sixteen by float64.
MAX_NUMBER = 1e18
# A year at 30 frames a second; time codes there are still apart by 1e-7.
MAX_FRAME = 1e9
# Whole numbers up to here are the same as floats.
MAX_WHOLE = 2**53
# Whole numbers among options, where a seed has 64 bits.
MAX_SEED = 2**64

Real = Annotated[float, Field(ge=-MAX_NUMBER, le=MAX_NUMBER)]
Whole = Annotated[int, Field(ge=-MAX_WHOLE, le=MAX_WHOLE)]
Frame = Annotated[float, Field(ge=-MAX_FRAME, le=MAX_FRAME)]
WholeFrame = Annotated[int, Field(ge=-int(MAX_FRAME), le=int(MAX_FRAME))]
# On one line: control characters are in no text that is read. No path is longer.
Name = Annotated[str, Field(min_length=1, max_length=4096, pattern=r"^[^\n\t]*$")]
Pair = Annotated[list[Real], Len(2, 2)]
Vector = Annotated[list[Real], Len(3, 3)]
# w, x, y, z.
Quaternion = Annotated[list[Real], Len(4, 4)]


def check_numbers(value: Any) -> Any:
    """Return options as they are, where no number in them is beyond `MAX_NUMBER`.

    Raises:
        ValueError: One is, or is not finite.

    >>> check_numbers({"drag": [{"linear": 1e39}]})
    Traceback (most recent call last):
    ValueError: drag.linear is 1e+39, not a finite number up to 1e+18
    """
    for keys, number in _numbers(value, ()):
        most = MAX_NUMBER if isinstance(number, float) else MAX_SEED
        if not -most <= number <= most:
            name = ".".join(keys)
            shown = f"{number:g}" if isinstance(number, float) else _digits(number)
            allowed = f"a finite number up to {most:g}"
            raise ValueError(f"{name} is {shown}, not {allowed}")
    return value


def _digits(number: int) -> str:
    # The text of a very long number in decimals takes as long as the square of it.
    return f"{number:#x}"[:20] + "…"


def _numbers(
    value: Any, keys: tuple[str, ...]
) -> Iterator[tuple[tuple[str, ...], float]]:
    """Yield the numbers in mappings and lists, each with the keys that lead to it."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _numbers(item, (*keys, str(key)))
    elif isinstance(value, list):
        for item in value:
            yield from _numbers(item, keys)
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield keys, value


class IgnoreModel(FileModel):
    """A finding of `animtool validate` that is known and stays."""

    code: str = Field(min_length=1, description="Of the finding.", examples=["RIG201"])
    where: str | None = Field(
        default=None,
        min_length=1,
        description="Where it is, as the finding says it, or a place around that; an "
        "entry of a list by number or name, `*` for anything. Not given: anywhere in "
        "the file.",
        examples=["joints[knee_l].limits"],
    )
    why: str = Field(
        min_length=1,
        description="Why it stays: for those who read the file next.",
        examples=["this crouch is the rest pose"],
    )
