"""What ``metadata.animtool`` of a timeline, or of a clip in it, says of its shots."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from fractions import Fraction
from typing import Any

from animtool.documents.names import nearest
from animtool.errors import excerpt
from animtool.rates import LARGEST_FRAME, parse_rate


@dataclass(frozen=True, slots=True)
class CutMetadata:
    """What is stated of shots; None is not stated.

    Attributes:
        start_frame: First frame of the shot, that of its head handle.
        handles: Shot frames before and after the cut.
        fps: Of a timeline: the rate of its shots.
    """

    start_frame: int | None = None
    handles: int | None = None
    fps: Fraction | None = None


def cut_metadata(
    metadata: Mapping[str, Any], named: str, *, rate: bool = False
) -> tuple[CutMetadata, list[tuple[str, str]]]:
    """Return what metadata says, and what is wrong with it and what to do.

    Args:
        metadata: Of a clip or a timeline.
        named: What that is called in messages.
        rate: Whether it may state the rate of shots, as timelines do.

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
    found: dict[str, Any] = {}
    faults = []
    for key, value in given.items():
        if key not in names:
            faults.append((f"{where} has no key {excerpt(key)}", nearest(key, names)))
            continue
        try:
            found[key] = parse_rate(value) if key == "fps" else _whole(key, value)
        except (TypeError, ValueError) as error:
            hint = f"write a number such as {EXAMPLES[key]}"
            faults.append((f"{where}: {key}: {error}", hint))
    return CutMetadata(**found), faults


EXAMPLES = {"start_frame": "1001", "handles": "8", "fps": "24 or 24000/1001"}


def _whole(key: str, value: object) -> int:
    shown = excerpt(str(value))
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{shown} is not a whole number")
    if abs(value) > LARGEST_FRAME or value != int(value):
        raise ValueError(f"{shown} is not a whole number up to {LARGEST_FRAME}")
    if key == "handles" and value < 0:
        raise ValueError(f"{shown} is below 0")
    return int(value)
