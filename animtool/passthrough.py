"""Tracks of a take, kept aside while a pass runs that has no use for them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace

from animtool.errors import Fault, OptionError, listed
from animtool.motion import Channel, Motion
from animtool.take import TakeStream
from animtool.transforms import Track

MAX_NAMED = 6


class PassthroughTracks:
    """Takes the tracks out of a take, and puts them back frame by frame.

    Attributes:
        stream: The take without them.
    """

    def __init__(self, stream: TakeStream) -> None:
        self._tracks, curve = stream.tracks, stream.curve
        self._waiting: deque[Channel] = deque()
        self.stream = replace(stream, tracks=(), blocks=self._without(stream.blocks))
        if curve is not None:
            self.stream.curve = lambda times: replace(curve(times), track_times=None)

    def _without(self, blocks: Iterator[Motion]) -> Iterator[Motion]:
        for block in blocks:
            assert block.track_times is not None
            self._waiting.append(block.track_times)
            yield replace(block, track_times=None)

    def restore(self, stream: TakeStream) -> TakeStream:
        """Return what a pass made of the take, of as many frames, with its tracks."""
        blocks = self._with(stream.blocks)
        return replace(stream, tracks=self._tracks, blocks=blocks)

    def _with(self, blocks: Iterator[Motion]) -> Iterator[Motion]:
        for block in blocks:
            yield replace(block, track_times=self._next(block.frames))

    def _next(self, frames: int) -> Channel:
        """Return the times of the frames that come next."""
        taken: list[Channel] = []
        while frames:
            first = self._waiting.popleft()
            if len(first.values) > frames:
                self._waiting.appendleft(first.select(slice(frames, None)))
                first = first.select(slice(frames))
            taken.append(first)
            frames -= len(first.values)
        return Channel.concatenate(taken)


def checked_tracks(
    stream: TakeStream, before: Sequence[Track], name: str
) -> TakeStream:
    """Return what a pass made of a take, refused where it has lost the tracks.

    Args:
        stream: What it made.
        before: The tracks that there were.
        name: Of the pass.

    Raises:
        OptionError: Perhaps only while the blocks are read: it has (SCN045).
    """
    if not before:
        return stream
    paths = listed([track.path for track in before], MAX_NAMED)
    message = f"the pass {name} changes the clock, and loses {paths}"
    hint = "it must treat track_times as the other channels of a motion"
    lost = OptionError(Fault("SCN045", message, hint=hint))
    if not stream.tracks:
        raise lost

    def checked(blocks: Iterator[Motion]) -> Iterator[Motion]:
        for block in blocks:
            if block.track_times is None:
                raise lost
            yield block

    return replace(stream, blocks=checked(stream.blocks))
