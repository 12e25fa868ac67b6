"""Evaluates drivers on the motion of rigs; driven values replace the source's.

The result depends only on the pose and controls of each frame, so evaluating again
changes nothing. Angles of unlimited pins are the one exception: revolutions are counted
from the first frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.motion.motion import Motion
from animtool.motion.take import Take, TakeStream
from animtool.rig.skeleton import Rig

# Codes that drivers report again for the same joint after every pass.
REPEATED_CODES = frozenset({"RIG103", "RIG105"})


def drive_take(take: Take) -> Take:
    """Return a take with driven joints, shapes and controls evaluated.

    Adds a notice for each joint whose driver exceeds its limits.

    Raises:
        FormatError: A driver has no value at some frame (CLIP015).
    """
    if not take.rig.is_driven:
        return take
    from animtool.motion.driver_run import DriverRun

    run = DriverRun(take.rig)
    motion = run.drive(take.motion, np.asarray(take.clock.times, np.float64))
    new = drop_repeated_notices(run.notices(), take.notices)
    return replace(take, motion=motion, notices=(*take.notices, *new))


def drive_stream(stream: TakeStream, *, report_replaced: bool = False) -> TakeStream:
    """Return a stream with driven joints, shapes and controls evaluated.

    Warnings of drivers are added to its notices once the blocks are read.

    Args:
        stream: Take of any rig; without drivers it is returned unchanged.
        report_replaced: Whether to report source motion that drivers replace.
    """
    if not stream.rig.is_driven:
        return stream
    from animtool.motion.driver_run import DriverRun

    run = DriverRun(stream.rig, report_replaced)
    start = float(stream.start or 1)

    def blocks() -> Iterator[Motion]:
        frames_done = 0
        for block in stream.blocks:
            indices = np.arange(
                frames_done, frames_done + block.frames, dtype=np.float64
            )
            times = start + float(stream.step) * indices
            frames_done += block.frames
            yield run.drive(block, times)
        stream.notices.extend(drop_repeated_notices(run.notices(), stream.notices))

    result = replace(stream, blocks=blocks())
    curve = stream.curve
    if curve is not None:
        result.curve = _driven_curve(stream.rig, curve)
    return result


def _driven_curve(
    rig: Rig, curve: Callable[[FloatArray], Motion]
) -> Callable[[FloatArray], Motion]:
    from animtool.motion.driver_run import DriverRun

    return lambda times: DriverRun(rig).drive(curve(times), times)


def drop_repeated_notices(
    notices: Iterable[Fault], reported: Iterable[Fault]
) -> list[Fault]:
    """Return notices without driver warnings that are already known."""
    known = {
        (notice.code, _first_name(notice))
        for notice in reported
        if notice.code in REPEATED_CODES
    }
    return [
        notice
        for notice in notices
        if notice.code not in REPEATED_CODES
        or (notice.code, _first_name(notice)) not in known
    ]


def _first_name(notice: Fault) -> str:
    """Return the joint or control that a driver's notice names first."""
    parts = notice.message.split("'")
    return parts[1] if len(parts) > 2 else notice.message.split(" ")[0]
