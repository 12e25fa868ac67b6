"""Puts the files of a page on one timeline of integer frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING

from animtool.core.arguments import argument
from animtool.core.clock import frame_label
from animtool.core.errors import Fault, OptionError, Severity
from animtool.core.names import is_named
from animtool.core.rates import rate_label
from animtool.core.record import dataclass
from animtool.core.shot import FrameRange
from animtool.edit.resample import outside_take
from animtool.motion.take import TakeStream
from animtool.preview.draft import Timeline
from animtool.preview.open_file import OpenFile, ShownTake
from animtool.preview.options import PreviewOptions
from animtool.preview.takes import Gathered
from animtool.scene.bake.first_frame import frame_start
from animtool.scene.bake.frames import TakePlan, in_frames
from animtool.scene.bake.options import BakeOptions

if TYPE_CHECKING:
    from animtool.usd.caches.shown import StageContents

# Frames of a page.
MAX_FRAMES = 1_000_000
FEWER = (
    f"{argument('frame_range', '1-240x2')} shows fewer frames, "
    f"{argument('prim_path')} a part of a stage"
)


@dataclass(slots=True)
class TimedPart:
    """A take with its position on the timeline."""

    file: int
    take: ShownTake
    stream: TakeStream
    gathered: Gathered
    first: Fraction  # frame of the page that its first one is
    origin: Fraction  # the same of its file's first frame, which may be left out
    shift: Fraction = Fraction(0)  # from its own frames to those that it is shown at

    @property
    def last(self) -> Fraction:
        """Last page frame of the take."""
        return self.first + max(0, self.gathered.frames - 1) * self.stream.step


def gathered_part(
    number: int,
    file: OpenFile,
    take: ShownTake,
    fps: Fraction,
    options: PreviewOptions,
    notices: list[Fault],
) -> TimedPart:
    """Return a take resampled to the page's frames and rate.

    Args:
        number: Of its file.
        file: That file.
        take: The take.
        fps: Frames a second of the page.
        options: Of the page.
        notices: Where warnings and notes go.
    """
    stream = take.stream
    start = Fraction(1)
    if stream.start is not None:
        start = frame_start(stream.start, stream.fps, fps, on_frame=True)
    origin = start
    # A rig at rest is of any frame and rate.
    rests = is_named(file.path, "rig")
    asked = None if rests or (stream.fps == fps and stream.step == 1) else fps
    chosen = None if rests else options.frame_range
    uneven = stream.step != 1 or start.denominator != 1
    quiet = {"SCN202"}
    if chosen is None and uneven and (span := _stated(file, fps)) is not None:
        quiet = {"SCN202", "TAKE008"}
        # Samples of any times, at the frames of their stage.
        chosen = FrameRange(math.ceil(span[0]), math.floor(span[1]))
        asked = None if stream.fps == fps else fps
    if asked is not None or chosen is not None:
        bake = BakeOptions(fps=asked, frame_range=chosen)
        said: list[Fault] = []
        rate = asked or stream.fps
        stream = in_frames(
            TakePlan(file.path, "", stream, None, bake, rate, start, said)
        )
        # It may last as long as it does.
        notices += [one for one in said if one.code not in quiet]
        start = Fraction(1) if stream.start is None else stream.start
    if asked is not None and take.stream.fps != fps:
        message = (
            f"has {rate_label(take.stream.fps)}, but is shown at {rate_label(fps)}"
        )
        note = Fault("PRV103", message, str(file.path), severity=Severity.NOTE)
        notices.append(note)
    gathered = Gathered(stream.blocks, stream.rig.meters_per_unit)
    notices += map(file.located, stream.notices)
    return TimedPart(number, take, stream, gathered, start, origin)


def align(parts: list[TimedPart]) -> list[Fault]:
    """Shift takes that share no frame with the first to its start; return notices."""
    notices = []
    for part in parts[1:]:
        lead = parts[0]
        if part.first > lead.last or part.last < lead.first:
            message = (
                f"take {part.take.name!r} begins at frame {frame_label(part.first)}, "
                f"but is shown from frame {frame_label(lead.first)}"
            )
            notices.append(Fault("PRV104", message, severity=Severity.NOTE))
            part.shift = lead.first - part.first
            part.origin += part.shift
            part.first = lead.first
    return notices


def timeline_of(
    opened: Sequence[OpenFile],
    parts: Sequence[TimedPart],
    fps: Fraction,
    options: PreviewOptions,
) -> Timeline:
    """Return the timeline that covers all files.

    Raises:
        OptionError: None of them is asked for (CLI005), or there are too many (PRV003).
    """
    spans = [
        _within(part, _stated(opened[part.file], fps))
        for part in parts
        if part.gathered.frames > 1
    ]
    step = Fraction(1)
    for file in opened:
        if file.contents is not None and (span := _moving_span(file.contents)):
            ratio = fps / file.contents.fps
            spans.append((span[0] * ratio, span[1] * ratio))
        if file.markers is not None:
            clock = file.markers.clock
            ratio = fps / clock.fps
            last = clock.start + (clock.count - 1) * clock.step
            spans.append((clock.start * ratio, last * ratio))
        if file.targets is not None and all(part.gathered.frames < 2 for part in parts):
            clock = file.targets.clock
            ratio = Fraction(1) if file.targets.fps is None else fps / clock.fps
            last = clock.start + (clock.count - 1) * clock.step
            spans.append((clock.start * ratio, last * ratio))
    first = min((a for a, _ in spans), default=parts[0].first if parts else Fraction(1))
    last = max((b for _, b in spans), default=first)
    frames = options.frame_range
    if frames is not None:
        start, end = first, last
        last = min(last, Fraction(frames.last))
        first, step = max(first, Fraction(frames.first)), Fraction(frames.step)
        if last < first:
            raise OptionError(outside_take(frames, start, end, whole="file"))
    count = int((last - first) / step) + 1
    if count > MAX_FRAMES:
        message = f"the page would have {count} frames; the limit is {MAX_FRAMES}"
        raise OptionError(Fault("PRV003", message, hint=FEWER))
    return Timeline(fps, first, step, count)


def _within(
    part: TimedPart, stated: tuple[Fraction, Fraction] | None
) -> tuple[Fraction, Fraction]:
    """Return the frames of a take inside the range of its stage."""
    if stated is None or part.shift:
        return part.first, part.last
    first, last = max(part.first, stated[0]), min(part.last, stated[1])
    return (first, last) if first <= last else (part.first, part.last)


def _stated(file: OpenFile, fps: Fraction) -> tuple[Fraction, Fraction] | None:
    """Return the authored range of a stage; None for other files."""
    contents = file.contents
    span = None if contents is None else contents.stated_span
    if contents is None or span is None:
        return None
    ratio = fps / contents.fps
    return span[0] * ratio, span[1] * ratio


def _moving_span(contents: StageContents) -> tuple[Fraction, Fraction] | None:
    moving = any(prim.deforms or prim.travels for prim in contents.prims)
    return contents.span if moving or contents.cameras() else None
