"""A shot: its frames, its rate and the times of its media.

A shot counts **shot frames**: integers at the shot's rate. Every command, file and
report that names a frame of a shot means this number.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from fractions import Fraction
from numbers import Integral
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

from animtool.core.rates import NO_FRACTION, OptionalFraction, rate_label, rate_option
from animtool.core.record import dataclass
from animtool.core.timecode import timecode_label

# Number of a shot's first frame, unless stated otherwise.
SHOT_START = 1001
# Timelines store times as floats: a time this near to a frame is that frame [frame].
FRAME_TOLERANCE = Fraction(1, 10_000)


@dataclass(frozen=True, slots=True)
class MediaTimecode:
    """Time codes of a shot's media, as its timeline counts them.

    Attributes:
        rate: Frame rate of the labels.
        first: Time of the media's first frame [s].
        drop_frame: Whether labels are drop-frame.
    """

    rate: Fraction
    first: Fraction = Fraction(0)
    drop_frame: bool = False

    def label(self, seconds: Fraction) -> str:
        """Return the time code at a media time [s], or the seconds if it has no rate.

        >>> MediaTimecode(Fraction(25), Fraction(3600)).label(Fraction(1, 2))
        '01:00:00:12'
        """
        time = self.first + seconds
        try:
            frame = math.floor(time * self.rate + FRAME_TOLERANCE)
            return timecode_label(frame, self.rate, is_drop_frame=self.drop_frame)
        except ValueError:
            return f"{float(time):.7g} s"


@dataclass(frozen=True, slots=True)
class Shot:
    """The frames of a shot, all in shot frames; first and last are included.

    Attributes:
        cut_in: First frame of the cut.
        cut_out: Last frame of the cut.
        head: Number of frames of the handle before the cut.
        tail: Number of frames of the handle after the cut.
        name: Name of the shot; empty if it has none.
        fps: Shot frames per second; a number or text becomes a fraction. None uses the
            rate of the output.
        media_in: Media time shown at ``cut_in``, 0 for its first frame [s]; None if the
            shot does not place its media.
        speed: Playback speed of the media; negative plays backwards, and 0 holds the
            pose at ``media_in``.
        timecode: Time codes of the media in its timeline; None if unknown.

    Raises:
        OptionError: fps is not a valid rate (SCN022).

    >>> shot = Shot(1009, 1056, 8, 8, fps=24, media_in=Fraction(2))
    >>> shot.start, shot.end, float(shot.seconds_at(1033))
    (1001, 1064, 3.0)
    """

    cut_in: int
    cut_out: int
    head: int = 0
    tail: int = 0
    name: str = ""
    fps: OptionalFraction = NO_FRACTION
    media_in: Fraction | None = None
    speed: Fraction = Fraction(1)
    timecode: MediaTimecode | None = None

    def __post_init__(self) -> None:
        """Convert the rate from a number or text."""
        fps: Any = self.fps
        if not isinstance(fps, Fraction | None):
            object.__setattr__(self, "fps", rate_option(fps))

    @property
    def start(self) -> int:
        """First frame, including the head handle."""
        return self.cut_in - self.head

    @property
    def end(self) -> int:
        """Last frame, including the tail handle."""
        return self.cut_out + self.tail

    @property
    def places_media(self) -> bool:
        """Whether the shot states which media time its frames show."""
        return self.media_in is not None

    def seconds_at(self, frame: Fraction | int) -> Fraction:
        """Return the media time of a frame [s]."""
        fps, media_in = self._rate_and_media_in()
        return media_in + (frame - self.cut_in) * self.speed / fps

    def frame_at(self, seconds: Fraction | int) -> Fraction:
        """Return the frame, possibly fractional, of a media time [s].

        A shot that holds a pose has no such frame.

        >>> shot = Shot(1001, 1024, fps=Fraction(24), media_in=Fraction(2))
        >>> shot.frame_at(Fraction(5, 2))
        Fraction(1013, 1)
        """
        fps, media_in = self._rate_and_media_in()
        return self.cut_in + (seconds - media_in) * fps / self.speed

    def _rate_and_media_in(self) -> tuple[Fraction, Fraction]:
        if self.fps is None or self.media_in is None:
            raise ValueError("the shot has no media times")
        return self.fps, self.media_in

    def recut(self, cut_in: int, cut_out: int, head: int, tail: int) -> Shot:
        """Return the shot with another cut; each frame keeps its media time.

        Args:
            cut_in: First frame of the cut.
            cut_out: Last frame of the cut.
            head: Frames before the cut.
            tail: Frames after it.

        >>> shot = Shot(1001, 1024, fps=Fraction(24), media_in=Fraction(2))
        >>> shot.recut(1013, 1020, 4, 4).media_in
        Fraction(5, 2)
        """
        media_in = self.seconds_at(cut_in) if self.places_media else None
        return replace(
            self,
            cut_in=cut_in,
            cut_out=cut_out,
            head=head,
            tail=tail,
            media_in=media_in,
        )

    @property
    def label(self) -> str:
        """The shot as one line of a report.

        >>> Shot(1009, 1056, 8, 4, "sh010", Fraction(24)).label
        'shot sh010: cut 1009 to 1056, handles 8 and 4, 24 fps'
        """
        text = f"shot {self.name}" if self.name else "shot"
        text += f": cut {self.cut_in} to {self.cut_out}"
        text += f", handles {self.head} and {self.tail}"
        if self.fps is not None:
            text += f", {rate_label(self.fps)}"
        if times := self.media_times:
            text += f", {times['media_in']:.6g} s to {times['media_out']:.6g} s"
            text += " of its media"
        return text

    @property
    def media_times(self) -> dict[str, float]:
        """Media times and speed; empty if no media are placed."""
        if not self.places_media:
            return {}
        return {
            "media_in": float(self.seconds_at(self.cut_in)),
            "media_out": float(self.seconds_at(self.cut_out)),
            "speed": float(self.speed),
        }

    json_keys: ClassVar[str] = (
        "name start end cut_in cut_out head tail fps? rate=fps?# *media_times"
    )

    def names(self) -> dict[str, str]:
        """Return the frames and times of a shot by the names that scenes can use.

        >>> names = Shot(1009, 1056, 8, 8, fps=Fraction(24)).names()
        >>> names["begin"], names["first"], names["last"], names["end"]
        ('1001', '1009', '1056', '1064')
        """
        values = {
            "first": str(self.cut_in),
            "last": str(self.cut_out),
            "begin": str(self.start),
            "end": str(self.end),
            "head": str(self.head),
            "tail": str(self.tail),
            "handles": str(max(self.head, self.tail)),
            "fps": "" if self.fps is None else str(self.fps),
            "speed": f"{float(self.speed):.12g}",
        }
        media_texts = {name: f"{x:.12g}" for name, x in self.media_times.items()}
        return values | media_texts


def frames_within(seconds: Fraction, fps: Fraction) -> int:
    """Return the number of frames that begin within a duration; at least 1.

    >>> fps = Fraction(24)
    >>> frames_within(Fraction(3), fps), frames_within(Fraction(0), fps)
    (72, 1)
    """
    return max(1, math.ceil(seconds * fps - FRAME_TOLERANCE))


def frame_spans(frames: Iterable[int], step: int = 1) -> str:
    """Return frame numbers as text, with consecutive frames as spans.

    >>> frame_spans([1, 2, 3, 9, 11, 12])
    '1 to 3, 9, 11 to 12'
    """
    spans: list[list[int]] = []
    for frame in frames:
        if spans and frame == spans[-1][-1] + step:
            spans[-1].append(frame)
        else:
            spans.append([frame])
    span_ends = [dict.fromkeys((span[0], span[-1])) for span in spans]
    return ", ".join(" to ".join(map(str, bounds)) for bounds in span_ends)


@dataclass(frozen=True, slots=True)
class FrameRange:
    """Every ``step``-th frame from ``first`` to ``last`` inclusive [time codes]."""

    first: int
    last: int
    step: int = 1

    @staticmethod
    def of(frames: FrameRangeLike) -> FrameRange:
        """Return a range from its first and last frame and an optional step.

        >>> FrameRange.of((1, 40))
        FrameRange(first=1, last=40, step=1)
        """
        if isinstance(frames, FrameRange):
            return frames
        numbers: tuple[Any, ...] = tuple(frames)
        are_integers = all(isinstance(value, Integral) for value in numbers)
        if len(numbers) not in {2, 3} or not are_integers:
            raise ValueError(f"{frames!r} is not a range such as (1, 40) or (1, 40, 2)")
        frame_range = FrameRange(*map(int, numbers))
        if frame_range.last < frame_range.first or frame_range.step < 1:
            raise ValueError(f"{frames!r} contains no frame")
        return frame_range


@dataclass(frozen=True, slots=True)
class FrameList(FrameRange):
    """A list of frames in any order, and the range that contains them."""

    frames: tuple[int, ...] = ()

    @staticmethod
    def of_frames(frames: Iterable[int]) -> FrameList:
        """Return a list of single frames, in the given order.

        >>> FrameList.of_frames([40, 1, 20])
        FrameList(first=1, last=40, step=1, frames=(40, 1, 20))
        """
        frame_tuple = tuple(frames)
        return FrameList(min(frame_tuple), max(frame_tuple), 1, frame_tuple)


# First and last frame, and the step; options of a bake also accept text such as
# `1-40x2`.
FrameRangeLike: TypeAlias = FrameRange | tuple[int, int] | tuple[int, int, int] | str


class OptionalRange:
    """Type of a field that accepts a range or its numbers and stores a range.

    Like `animtool.core.rates.OptionalFraction`, a descriptor only for type checkers.
    """

    if TYPE_CHECKING:

        def __get__(
            self, record: object, owner: type | None = None
        ) -> FrameRange | None: ...

        def __set__(self, record: object, value: FrameRangeLike | None) -> None: ...
