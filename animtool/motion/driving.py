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
REPEATED = frozenset({"RIG103", "RIG105"})


def driven_take(take: Take) -> Take:
    """Return a take with driven joints, shapes and controls evaluated.

    Limits that drivers would exceed are added to its notices, once a joint.

    Raises:
        FormatError: A driver has no value at some frame (CLIP015).
    """
    if not take.rig.is_driven:
        return take
    from animtool.motion.driver_run import DriverRun

    run = DriverRun(take.rig)
    motion = run.drive(take.motion, np.asarray(take.clock.times, np.float64))
    new = unsaid(run.notices(), take.notices)
    return replace(take, motion=motion, notices=(*take.notices, *new))


def driven_stream(stream: TakeStream, *, replaced: bool = False) -> TakeStream:
    """Return a stream with driven joints, shapes and controls evaluated.

    What drivers report is among its notices once the blocks are read.

    Args:
        stream: Of any rig; a rig without drivers is returned unchanged.
        replaced: Whether to report source motion that drivers replace.
    """
    if not stream.rig.is_driven:
        return stream
    from animtool.motion.driver_run import DriverRun

    run = DriverRun(stream.rig, replaced)
    start = float(stream.start or 1)

    def blocks() -> Iterator[Motion]:
        done = 0
        for block in stream.blocks:
            numbers = np.arange(done, done + block.frames, dtype=np.float64)
            times = start + float(stream.step) * numbers
            done += block.frames
            yield run.drive(block, times)
        stream.notices.extend(unsaid(run.notices(), stream.notices))

    out = replace(stream, blocks=blocks())
    curve = stream.curve
    if curve is not None:
        out.curve = _driven_curve(stream.rig, curve)
    return out


def _driven_curve(
    rig: Rig, curve: Callable[[FloatArray], Motion]
) -> Callable[[FloatArray], Motion]:
    from animtool.motion.driver_run import DriverRun

    return lambda times: DriverRun(rig).drive(curve(times), times)


def unsaid(notices: Iterable[Fault], said: Iterable[Fault]) -> list[Fault]:
    """Return notices without driver warnings that are already known."""
    known = {(one.code, _named(one)) for one in said if one.code in REPEATED}
    return [
        one
        for one in notices
        if one.code not in REPEATED or (one.code, _named(one)) not in known
    ]


def _named(notice: Fault) -> str:
    """Return the joint or control that a driver's notice names first."""
    parts = notice.message.split("'")
    return parts[1] if len(parts) > 2 else notice.message.split(" ")[0]
