"""Frame rates of timelines: stated, requested, or inferred from clips."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

from animtool.batch.edl import Edl
from animtool.batch.timeline import MAX_MEDIA_RATE, MIN_MEDIA_RATE, exact_rate
from animtool.core.arguments import argument
from animtool.core.config import find_config
from animtool.core.errors import Fault, FormatError, OptionError, Severity
from animtool.core.rates import rate_from_float, rate_label

SET_RATE_HINT = (
    f"set it with {argument('fps', '{}')} (or {{}}), `fps` in the scene or in the "
    "batch file's options, or `fps` under [timeline] in animtool.toml"
)
COMMON_RATES_HINT = SET_RATE_HINT.format("24", "25, 30000/1001, 30")


def edl_rate(edl: Edl, requested_fps: Fraction | None) -> Fraction:
    """Return the frame rate that the time codes of an EDL count.

    The rate is that of a comment (``* FPS: 25``), else the requested rate, else the
    project's rate.
    """
    path = str(edl.path)
    if edl.fps is not None:
        return _checked_rate(edl.fps, requested_fps, path)
    configured_fps = requested_fps or find_config(edl.path).timeline.fps
    if configured_fps is not None:
        return configured_fps
    message = "states no frame rate, which its time codes need"
    hint = COMMON_RATES_HINT
    if edl.has_drop_frame:
        message += "; drop-frame time codes are of 30000/1001 (29.97) or 60000/1001 fps"
        hint = SET_RATE_HINT.format("30000/1001", "60000/1001")
    elif (label := edl.max_frame_label) > 0:
        message += f"; the highest frame label is {label:02d}, so the rate is above "
        message += f"{label} fps"
    raise OptionError(Fault("BAT054", message, path, (), hint))


def timeline_rate(
    timeline: Any,
    path: Path,
    stated_rate: Fraction | None,
    requested_fps: Fraction | None,
) -> tuple[Fraction, list[Fault]]:
    """Return the rate of a timeline's shots, and a warning for mixed rates.

    The rate is the stated one, else that of the global start time, else the requested
    one, else the project's, else the rate of all, or more than half, of the clips and
    gaps.

    Args:
        timeline: The OpenTimelineIO timeline.
        path: Its file.
        stated_rate: Rate that its metadata states.
        requested_fps: Rate that options request.
    """
    path_text, global_start = str(path), timeline.global_start_time
    if stated_rate is None and global_start is not None and global_start.rate > 0:
        try:
            stated_rate = exact_rate(global_start.rate)
        except ValueError as error:
            message = f"invalid global start time: {error}"
            raise FormatError(Fault("BAT041", message, path_text)) from error
    if stated_rate is not None:
        return _checked_rate(stated_rate, requested_fps, path_text), []
    configured_fps = requested_fps or find_config(path).timeline.fps
    if configured_fps is not None:
        return configured_fps, []
    rate_counts = Counter(video_rates(timeline.tracks))
    clip_count = sum(rate_counts.values())
    if not clip_count:
        # No clip has a visible range; each clip is reported.
        return Fraction(1), []
    common_rate, common_count = rate_counts.most_common(1)[0]
    if len(rate_counts) == 1:
        return common_rate, []
    count_texts = (
        f"{count} at {rate_label(rate)}" for rate, count in rate_counts.most_common()
    )
    rate_list = ", ".join(count_texts)
    message = f"states no rate, and its clips and gaps use several: {rate_list}"
    if 2 * common_count <= clip_count:
        raise OptionError(Fault("BAT054", message, path_text, (), COMMON_RATES_HINT))
    message += f"; using {rate_label(common_rate)}"
    fault_arguments = (
        "BAT049",
        message,
        path_text,
        (),
        COMMON_RATES_HINT,
        Severity.WARNING,
    )
    return common_rate, [Fault(*fault_arguments)]


def _checked_rate(
    stated_rate: Fraction, requested_rate: Fraction | None, path: str
) -> Fraction:
    """Return the stated rate; raise BAT051 if another rate is requested."""
    if requested_rate is not None and requested_rate != stated_rate:
        message = f"has {rate_label(stated_rate)}, but "
        message += f"{rate_label(requested_rate)} was requested"
        hint = "shots are written at the rate of their timeline"
        raise OptionError(Fault("BAT051", message, path, (), hint))
    return stated_rate


def video_rates(composition: Any) -> Iterator[Fraction]:
    """Yield the rate of every clip and gap on video tracks.

    A clip without a source range counts at the rate of its media range.
    """
    for child in composition:
        if hasattr(child, "find_children"):
            if getattr(child, "kind", "Video") == "Video":
                yield from video_rates(child)
            continue
        time_range = getattr(child, "source_range", None)
        if time_range is None:
            media = getattr(child, "media_reference", None)
            time_range = getattr(media, "available_range", None)
        rate = 0.0 if time_range is None else time_range.start_time.rate
        if MIN_MEDIA_RATE <= rate <= MAX_MEDIA_RATE:
            yield rate_from_float(rate)
