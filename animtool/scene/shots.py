"""A take in a shot: where its samples stand."""

from __future__ import annotations

from dataclasses import replace

from animtool._types import FloatArray
from animtool.motion import Motion
from animtool.shot import Shot
from animtool.take import TakeStream


def in_shot(stream: TakeStream, shot: Shot | None) -> TakeStream:
    """Return a take whose time codes are shot frames, each sample at its own time.

    Nothing is resampled or left out; a shot that does not place its media leaves the
    take as it is.
    """
    if shot is None or shot.fps is None or not shot.places_media:
        return stream
    start = shot.frame_at(0)
    step = stream.step / stream.fps * shot.fps / shot.speed
    ratio = stream.step / step
    curve, first = stream.curve, float(1 if stream.start is None else stream.start)

    def shifted(times: FloatArray) -> Motion:
        assert curve is not None
        return curve(first + (times - float(start)) * float(ratio))

    return replace(
        stream,
        fps=shot.fps,
        start=start,
        step=step,
        curve=None if curve is None else shifted,
        control_curves={
            name: curves.retimed(first, float(1 / ratio), float(start))
            for name, curves in stream.control_curves.items()
        },
    )
