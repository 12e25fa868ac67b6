"""At which rate the shots of a timeline count frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

from animtool.batch.edl import Edl
from animtool.batch.timeline import HIGHEST_RATE, LOWEST_RATE, exact_rate
from animtool.core.config import find_config
from animtool.core.errors import Fault, FormatError, OptionError, Severity
from animtool.core.rates import rate_from_float, rate_label

HOW = (
    "state it: --fps {} (or {}), `fps` of the scene or the batch file's options, or "
    "`fps` under [timeline] in animtool.toml"
)
USUAL = HOW.format("24", "25, 30000/1001, 30")


def edl_rate(edl: Edl, asked: Fraction | None) -> Fraction:
    """Return the rate that the time codes of an EDL count.

    It is that of a comment (``* FPS: 25``), else the one asked for, else the project's.

    Raises:
        OptionError: Nothing states it (BAT054), or two do (BAT051).
    """
    place = str(edl.path)
    if edl.fps is not None:
        return _agreed(edl.fps, asked, place)
    found = asked or find_config(edl.path).timeline.fps
    if found is not None:
        return found
    message = "states no rate: its time codes count frames, which are other seconds at "
    message += "each rate"
    how = USUAL
    if edl.drop:
        message += "; drop-frame time codes are of 30000/1001 (29.97) or 60000/1001 fps"
        how = HOW.format("30000/1001", "60000/1001")
    elif edl.last_label > 0:
        message += f"; the highest frame label is {edl.last_label:02d}, so the rate is "
        message += f"above {edl.last_label} fps"
    raise OptionError(Fault("BAT054", message, place, (), how))


def timeline_rate(
    timeline: Any, path: Path, stated: Fraction | None, asked: Fraction | None
) -> tuple[Fraction, list[Fault]]:
    """Return the rate of a timeline's shots, and a warning where others count too.

    It is the stated one, else that of the global start time, else the one asked for,
    else the project's, else the one that all clips and gaps count at, or more than half
    of them.

    Args:
        timeline: As OpenTimelineIO has it.
        path: Its file.
        stated: What its metadata states.
        asked: What options ask for.

    Raises:
        FormatError: Its global start time has no rate (BAT041).
        OptionError: No rate is known (BAT054), or the one asked for is not that of
            the timeline (BAT051).
    """
    place, begin = str(path), timeline.global_start_time
    if stated is None and begin is not None and begin.rate > 0:
        try:
            stated = exact_rate(begin.rate)
        except ValueError as error:
            message = f"its global start time: {error}"
            raise FormatError(Fault("BAT041", message, place)) from error
    if stated is not None:
        return _agreed(stated, asked, place), []
    found = asked or find_config(path).timeline.fps
    if found is not None:
        return found, []
    rates = Counter(picture_rates(timeline.tracks))
    total = sum(rates.values())
    if not total:
        # No clip has a range that could be shown, and each that is there says so.
        return Fraction(1), []
    chosen, count = rates.most_common(1)[0]
    if len(rates) == 1:
        return chosen, []
    each = ", ".join(f"{n} at {rate_label(rate)}" for rate, n in rates.most_common())
    message = f"states no rate, and its clips and gaps count at several: {each}"
    if 2 * count <= total:
        raise OptionError(Fault("BAT054", message, place, (), USUAL))
    message += f"; {rate_label(chosen)} is taken"
    return chosen, [Fault("BAT049", message, place, (), USUAL, Severity.WARNING)]


def _agreed(stated: Fraction, asked: Fraction | None, place: str) -> Fraction:
    """Return a stated rate (BAT051 where another is asked for)."""
    if asked is not None and asked != stated:
        message = f"has {rate_label(stated)}, and {rate_label(asked)} is asked"
        hint = "shots are written at the rate of their timeline"
        raise OptionError(Fault("BAT051", message, place, (), hint))
    return stated


def picture_rates(composition: Any) -> Iterator[Fraction]:
    """Yield the rate of every clip and gap on tracks of pictures.

    A clip without a range of its own counts at the rate of its media's.
    """
    for child in composition:
        if hasattr(child, "find_children"):
            if getattr(child, "kind", "Video") == "Video":
                yield from picture_rates(child)
            continue
        span = getattr(child, "source_range", None)
        if span is None:
            media = getattr(child, "media_reference", None)
            span = getattr(media, "available_range", None)
        if span is not None and LOWEST_RATE <= span.start_time.rate <= HIGHEST_RATE:
            yield rate_from_float(span.start_time.rate)
