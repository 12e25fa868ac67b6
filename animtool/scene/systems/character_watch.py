"""A take on its way to a writer, looked at by what is simulated beside it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool._types import FloatArray
from animtool.clock import Clock, time_codes
from animtool.motion import Motion
from animtool.scene.systems.character_motion import CharacterMotion, motion_of
from animtool.take import Take, TakeStream


class CharacterWatch:
    """Keeps the time codes that are written of a take, and its motion if need be.

    Frames are read once: by the writer, whose blocks it sees pass. Of a source that is
    sampled as a function of time, and has no blocks read, it asks for its frames.

    Attributes:
        wanted: Whether the motion is kept.
    """

    def __init__(self, *, wanted: bool) -> None:
        self.wanted = wanted
        self._codes: list[FloatArray] = []
        self._blocks: list[Motion] = []
        self._stream: TakeStream | None = None

    @property
    def codes(self) -> FloatArray:
        """Time codes that were written, ascending ``(F,)``."""
        return np.concatenate(self._codes)

    def read(self, stream: TakeStream) -> TakeStream:
        """Return a take whose frames are seen as they are read."""
        if not self.wanted:
            return stream
        self._stream = stream
        return replace(stream, blocks=self._seen(stream.blocks))

    def see(self, codes: FloatArray) -> None:
        """Keep time codes of frames that are written ``(F,)``."""
        self._codes.append(codes)

    def motion(self, path: Path) -> CharacterMotion | None:
        """Return the whole motion, when all is read; None where it is not wanted."""
        stream = self._stream
        if stream is None:
            return None
        motion = self._whole(stream)
        start = Fraction(1) if stream.start is None else stream.start
        clock = Clock(stream.fps, start, stream.step, motion.frames)
        return motion_of(path, Take(stream.rig, clock, motion))

    def _whole(self, stream: TakeStream) -> Motion:
        if self._blocks:
            return Motion.concatenate(self._blocks)
        assert stream.curve is not None
        start = Fraction(1) if stream.start is None else stream.start
        return _bare(stream.curve(time_codes(start, stream.step, stream.count)))

    def _seen(self, blocks: Iterator[Motion]) -> Iterator[Motion]:
        for block in blocks:
            self._blocks.append(_bare(block))
            yield block


def _bare(motion: Motion) -> Motion:
    """Return joints and shapes alone."""
    return replace(motion, controls=None, track_times=None, points={})
