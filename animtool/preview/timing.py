"""Aligns the files of a page on one timeline of integer frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction

from animtool.core.arguments import argument
from animtool.core.clock import frame_label
from animtool.core.errors import Fault, OptionError, Severity, listed, warning
from animtool.core.names import has_kind_suffix
from animtool.core.rates import rate_label
from animtool.core.record import dataclass
from animtool.core.shot import FrameList, FrameRange
from animtool.edit.resample import missing_frames_fault
from animtool.motion.take import TakeStream
from animtool.preview.draft import Timeline
from animtool.preview.open_file import OpenFile, TakeToShow
from animtool.preview.options import PreviewOptions
from animtool.preview.takes import BufferedMotion
from animtool.scene.bake.first_frame import start_frame_at_rate
from animtool.scene.bake.frames import TakePlan, resample_for_output
from animtool.scene.bake.options import BakeOptions

# Frames of a page.
MAX_FRAMES = 1_000_000
# Maximum distance of a listed frame from the sample that shows it [frame].
MAX_FRAME_DISTANCE = 0.5
FEWER_FRAMES_HINT = (
    f"{argument('frame_range', '1-240x2')} shows fewer frames, "
    f"{argument('prim_path')} a part of a stage"
)


@dataclass(slots=True)
class TimelineTake:
    """A take with its position on the timeline."""

    file_index: int
    take: TakeToShow
    stream: TakeStream
    motion: BufferedMotion
    first_frame: Fraction  # page frame of the take's first frame
    clip_origin: Fraction  # page frame of the file's first frame, also if not shown
    shift: Fraction = Fraction(0)  # offset from its own frames to page frames

    @property
    def last(self) -> Fraction:
        """Last page frame of the take."""
        return self.first_frame + max(0, self.motion.frames - 1) * self.stream.step


def fit_to_page(
    file_index: int,
    file: OpenFile,
    take: TakeToShow,
    fps: Fraction,
    options: PreviewOptions,
    notices: list[Fault],
) -> TimelineTake:
    """Return a take resampled to the frames and the rate of the page.

    Args:
        file_index: Index of its file.
        file: The file.
        take: The take.
        fps: Frames per second of the page.
        options: Options of the page.
        notices: Receives warnings and notes.
    """
    stream = take.stream
    start = Fraction(1)
    if stream.start is not None:
        start = start_frame_at_rate(stream.start, stream.fps, fps, is_rounded=True)
    clip_origin = start
    # A rig at rest fits any frame range and rate.
    is_rig = has_kind_suffix(file.path, "rig")
    resampled_rate = None if is_rig or (stream.fps == fps and stream.step == 1) else fps
    frame_range = None if is_rig else options.frame_range
    has_fractional_frames = stream.step != 1 or start.denominator != 1
    ignored_codes = {"SCN202"}
    if (
        frame_range is None
        and has_fractional_frames
        and (stage_range := _authored_range(file, fps)) is not None
    ):
        ignored_codes = {"SCN202", "TAKE008"}
        # Resample to the frames of the stage.
        frame_range = FrameRange(math.ceil(stage_range[0]), math.floor(stage_range[1]))
        resampled_rate = None if stream.fps == fps else fps
    if resampled_rate is not None or frame_range is not None:
        bake_options = BakeOptions(fps=resampled_rate, frame_range=frame_range)
        faults: list[Fault] = []
        rate = resampled_rate or stream.fps
        stream = resample_for_output(
            TakePlan(file.path, "", stream, None, bake_options, rate, start, faults)
        )
        # The duration of the take need not be a whole number of frames.
        notices += [fault for fault in faults if fault.code not in ignored_codes]
        start = stream.first_frame
    if resampled_rate is not None and take.stream.fps != fps:
        message = (
            f"has {rate_label(take.stream.fps)}, but is shown at {rate_label(fps)}"
        )
        note = Fault("PRV103", message, str(file.path), severity=Severity.NOTE)
        notices.append(note)
    motion = BufferedMotion(stream.blocks, stream.rig.meters_per_unit)
    notices += map(file.relocated_to_scene, stream.notices)
    return TimelineTake(file_index, take, stream, motion, start, clip_origin)


def align_takes(timeline_takes: list[TimelineTake]) -> list[Fault]:
    """Move takes that do not overlap the first take to its start; return notices."""
    notices = []
    for timeline_take in timeline_takes[1:]:
        first_take = timeline_takes[0]
        if (
            timeline_take.first_frame > first_take.last
            or timeline_take.last < first_take.first_frame
        ):
            message = (
                f"take {timeline_take.take.name!r} begins at frame "
                f"{frame_label(timeline_take.first_frame)}, "
                f"but is shown from frame {frame_label(first_take.first_frame)}"
            )
            notices.append(Fault("PRV104", message, severity=Severity.NOTE))
            timeline_take.shift = first_take.first_frame - timeline_take.first_frame
            timeline_take.clip_origin += timeline_take.shift
            timeline_take.first_frame = first_take.first_frame
    return notices


def timeline_of(
    files: Sequence[OpenFile],
    timeline_takes: Sequence[TimelineTake],
    fps: Fraction,
    options: PreviewOptions,
    notices: list[Fault],
) -> Timeline:
    """Return the timeline that covers all files; add a warning to the notices."""
    covered_ranges = [
        _range_in_stage(
            timeline_take, _authored_range(files[timeline_take.file_index], fps)
        )
        for timeline_take in timeline_takes
        if timeline_take.motion.frames > 1
    ]
    step = Fraction(1)
    for file in files:
        contents = file.contents
        if contents is not None and (
            any(prim.is_animated for prim in contents.prims) or contents.cameras()
        ):
            rate_ratio = fps / contents.fps
            start, end = contents.span
            covered_ranges.append((start * rate_ratio, end * rate_ratio))
        if file.markers is not None:
            file_span = file.markers.clock.span
            rate_ratio = fps / file_span.fps
            covered_ranges.append(
                (file_span.first * rate_ratio, file_span.last * rate_ratio)
            )
        if file.targets is not None and all(
            timeline_take.motion.frames < 2 for timeline_take in timeline_takes
        ):
            file_span = file.targets.clock.span
            rate_ratio = (
                Fraction(1) if file.targets.fps is None else fps / file_span.fps
            )
            covered_ranges.append(
                (file_span.first * rate_ratio, file_span.last * rate_ratio)
            )
    first = min(
        (span_start for span_start, _ in covered_ranges),
        default=timeline_takes[0].first_frame if timeline_takes else Fraction(1),
    )
    last = max((span_end for _, span_end in covered_ranges), default=first)
    frame_range = options.frame_range
    if isinstance(frame_range, FrameList):
        start = min([first, *(take.clip_origin for take in timeline_takes)])
        _check_listed_frames(frame_range, start, last, files)
    if frame_range is not None:
        start, end = first, last
        last = min(last, Fraction(frame_range.last))
        first = max(first, Fraction(frame_range.first))
        step = Fraction(frame_range.step)
        if last < first:
            raise OptionError(
                missing_frames_fault(frame_range, start, end, noun="file")
            )
    count = int((last - first) / step) + 1
    if frame_range is not None and covered_ranges:
        notices += _range_notice(frame_range, first, first + (count - 1) * step)
    if count > MAX_FRAMES:
        message = f"the page would have {count} frames; the limit is {MAX_FRAMES}"
        raise OptionError(Fault("PRV003", message, hint=FEWER_FRAMES_HINT))
    return Timeline(fps, first, step, count)


def _check_listed_frames(
    frame_list: FrameList, first: Fraction, last: Fraction, files: Sequence[OpenFile]
) -> None:
    """Raise an error if listed frames are before the first or after the last frame."""
    missing_frames = [
        frame
        for frame in frame_list.frames
        if not -MAX_FRAME_DISTANCE <= frame - first <= last - first + MAX_FRAME_DISTANCE
    ]
    if not missing_frames:
        return
    is_one = len(missing_frames) == 1
    frames_text = f"frame{'' if is_one else 's'} {listed(missing_frames)}"
    message = (
        f"{argument('frame_range')}: {frames_text} {'is' if is_one else 'are'} not in "
    )
    message += "the file" if len(files) == 1 else "the files"
    verb = "has" if len(files) == 1 else "have"
    # A take is read up to the last listed frame.
    if max(missing_frames) > last:
        message += f", which {verb} frames {frame_label(first)}-{frame_label(last)}"
    else:
        message += f", whose first frame is {frame_label(first)}"
    path = str(files[0].path) if len(files) == 1 else None
    raise OptionError(Fault("CLI005", message, path))


def _range_notice(
    frame_range: FrameRange, first: Fraction, last: Fraction
) -> list[Fault]:
    """Return a warning if a range extends beyond the frames that are shown."""
    extends_beyond_end = frame_range.last - last >= frame_range.step
    if isinstance(frame_range, FrameList) or (
        first - frame_range.first < 1 and not extends_beyond_end
    ):
        return []
    range_text = f"{frame_range.first}-{frame_range.last}"
    message = f"{argument('frame_range', range_text)} extends beyond the files; "
    message += f"{frame_label(first)} to {frame_label(last)} are shown"
    return [warning("SCN202", message)]


def _range_in_stage(
    timeline_take: TimelineTake, stage_range: tuple[Fraction, Fraction] | None
) -> tuple[Fraction, Fraction]:
    """Return the first and last frame of a take, limited to the range of its stage."""
    if stage_range is None or timeline_take.shift:
        return timeline_take.first_frame, timeline_take.last
    first = max(timeline_take.first_frame, stage_range[0])
    last = min(timeline_take.last, stage_range[1])
    return (
        (first, last)
        if first <= last
        else (timeline_take.first_frame, timeline_take.last)
    )


def _authored_range(file: OpenFile, fps: Fraction) -> tuple[Fraction, Fraction] | None:
    """Return the authored frame range of a stage; None if it has none."""
    contents = file.contents
    authored_span = None if contents is None else contents.authored_span
    if contents is None or authored_span is None:
        return None
    rate_ratio = fps / contents.fps
    return authored_span[0] * rate_ratio, authored_span[1] * rate_ratio
