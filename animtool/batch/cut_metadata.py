"""What a timeline and its clips state for animtool: ``metadata.animtool``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from fractions import Fraction
from typing import Any

from animtool.core.errors import excerpt
from animtool.core.names import nearest
from animtool.core.rates import LARGEST_FRAME, parse_rate
from animtool.core.timecode import is_timecode


@dataclass(frozen=True, slots=True)
class CutMetadata:
    """What is stated of shots; None is not stated."""

    start_frame: int | None = None  # first frame of the shot, that of its head handle
    cut_start: int | None = None  # first frame of the cut, behind the head handle
    handles: int | None = None  # shot frames before and after the cut
    first_timecode: str | None = None  # of the media, such as 01:00:00:00
    fps: Fraction | None = None  # of a timeline: the rate of its shots


def cut_metadata(
    metadata: Mapping[str, Any], named: str, *, rate: bool = False
) -> tuple[CutMetadata, list[tuple[str, str]]]:
    """Return what metadata says, and what is wrong with it and what to do.

    >>> cut_metadata({"animtool": {"handles": 8.0}}, "clip 'a'")[0].handles
    8
    >>> cut_metadata({"animtool": {"handels": 8}}, "clip 'a'")[1]
    [("metadata.animtool of clip 'a' has no key 'handels'", "did you mean 'handles'?")]
    """
    given = metadata.get("animtool")
    if given is None:
        return CutMetadata(), []
    where = f"metadata.animtool of {named}"
    names = [f.name for f in fields(CutMetadata) if rate or f.name != "fps"]
    if not isinstance(given, Mapping):
        return CutMetadata(), [(f"{where} is not a table", f"keys: {', '.join(names)}")]
    values: dict[str, Any] = {}
    faults = []
    for key, value in given.items():
        if key not in names:
            faults.append((f"{where} has no key {excerpt(key)}", nearest(key, names)))
            continue
        try:
            values[key] = _READ.get(key, _whole)(key, value)
        except (TypeError, ValueError) as error:
            hint = f"write a value such as {EXAMPLES[key]}"
            faults.append((f"{where}: {key}: {error}", hint))
    return CutMetadata(**values), faults


EXAMPLES = {
    "start_frame": "1001",
    "cut_start": "1009",
    "handles": "8",
    "first_timecode": '"01:00:00:00"',
    "fps": "24 or 24000/1001",
}


def _whole(key: str, value: object) -> int:
    shown = excerpt(str(value))
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{shown} is not a whole number")
    if abs(value) > LARGEST_FRAME or value != int(value):
        raise ValueError(f"{shown} is not a whole number up to {LARGEST_FRAME}")
    if key == "handles" and value < 0:
        raise ValueError(f"{shown} is below 0")
    return int(value)


def _timecode(_key: str, value: object) -> str:
    if not is_timecode(value):
        shown = excerpt(str(value))
        raise ValueError(f"{shown} is no time code such as 01:00:00:00 or 01:00:00;02")
    return str(value).strip()


_READ: dict[str, Callable[[str, Any], Any]] = {
    "fps": lambda _, value: parse_rate(value),
    "first_timecode": _timecode,
}
