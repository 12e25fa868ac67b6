"""A take in a shot: where its samples stand, and which frames it lacks."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from animtool._types import FloatArray
from animtool.errors import Fault, OptionError, Severity
from animtool.shot import Shot, frame_spans
from animtool.take import Clock, Motion, TakeStream

if TYPE_CHECKING:
    from animtool.scene.take_plan import TakePlan

__all__ = ["in_shot", "missing_frames"]


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


def missing_frames(plan: TakePlan, shot: Shot, clock: Clock) -> list[Fault]:
    """Name the frames of a shot that a take lacks; their nearest pose is held.

    The last frame of a take lasts until the next would begin.

    Raises:
        OptionError: The take has no frame of the shot (SCN042).
    """
    wanted, where = plan.options.frame_range, str(plan.source)
    assert wanted is not None
    asked = range(wanted.first, wanted.last + 1, wanted.step)
    step = plan.fps / clock.rate
    last = plan.start + (clock.count - 1) * step
    missing = [n for n in asked if not plan.start <= n < last + step]
    if not missing:
        return []
    named = f"shot {shot.name}: " if shot.name else ""
    hint = f"the take has {float(plan.start):.7g} to {float(last):.7g}"
    if len(missing) == len(asked):
        message = f"{named}the take has no frame from {asked[0]} to {asked[-1]}"
        at = None if shot.places_media else "shot.cut"
        raise OptionError(Fault("SCN042", message, where, (), hint, where=at))
    cut = [n for n in missing if shot.cut_in <= n <= shot.cut_out]
    handles = [n for n in missing if n not in cut]
    found = []
    for code, what, key, frames in (
        ("SCN074", "frames of the cut", "shot.cut", cut),
        ("SCN106", "handle frames", "shot.handles", handles),
    ):
        if frames:
            message = f"{named}the take lacks {what} {frame_spans(frames, wanted.step)}"
            message += "; the nearest pose is held"
            warning = Severity.WARNING
            at = None if shot.places_media else key
            found.append(Fault(code, message, where, (), hint, warning, where=at))
    return found
