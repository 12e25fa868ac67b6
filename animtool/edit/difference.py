"""What a take does beyond another, as an additive take."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool.clock import Clock
from animtool.edit.combine import check_same_rig, continuous, other_frames, subtract
from animtool.edit.frames import frame_index
from animtool.errors import Fault, OptionError
from animtool.motion import Channel, Motion
from animtool.passes import MOTION_PARTS, Pass, PassContext, Scope
from animtool.rig.skeleton import Rig
from animtool.take import Take, TakeStream


@dataclass(frozen=True, slots=True)
class DifferenceOptions:
    """What the take is compared with.

    Attributes:
        base: File of the base take; none is the rest pose of the rig.
        frame: Time code of the base whose pose is the base; none compares frame by
            frame, first frame with first.
    """

    base: Path | None = None
    frame: float | None = None


def difference(
    take: Take, base: Take | None = None, frame: float | None = None
) -> Take:
    """Return the additive take that makes ``take`` when it is put on ``base``.

    The layer pass puts it back, with the convention of `animtool.maths.additive`.

    Args:
        take: F frames.
        base: Resampled to the take's rate and held at its ends; None is the rest
            pose.
        frame: Time code of the base whose pose is the base; None is frame by frame.

    Raises:
        OptionError: The base has no such frame (SCN013), is of another rig
            (SCN017), or a scale of it is 0 (SCN023).
    """
    below = rest_take(take.rig, take.clock) if base is None else base
    return _without(TakeStream.of(take), _base(below, frame)).collect()


def rest_take(rig: Rig, clock: Clock) -> Take:
    """Return one frame of a rig at rest, on the rate of a clock."""
    nobody = np.zeros(0, np.int64)
    motion = Motion(
        Channel(rig.rest_translations, nobody, np.zeros((1, 0, 3))),
        Channel(rig.rest_rotations, nobody, np.zeros((1, 0, 4))),
    )
    return Take(rig, replace(clock, count=1), motion)


def _base(base: Take, frame: float | None) -> Take:
    if frame is not None:
        index = frame_index(base.clock, frame, "frame")
        motion = base.motion.select(slice(index, index + 1)).map(Channel.compact)
        base = replace(base, clock=replace(base.clock, count=1), motion=motion)
    scales = base.motion.scales
    if scales is not None:
        flat = (scales.dense() == 0).any(axis=(0, 2))
        if flat.any():
            name = base.rig.names[int(np.argmax(flat))]
            message = f"the scale of joint {name!r} is 0 in the base"
            raise OptionError(Fault("SCN023", message))
    return base


def _without(stream: TakeStream, base: Take) -> TakeStream:
    check_same_rig(stream.rig, base.rig)
    return replace(stream, blocks=_blocks(stream, base))


def _blocks(stream: TakeStream, base: Take) -> Iterator[Motion]:
    first, previous = 0, None
    rate = stream.fps / stream.step
    for block in stream.blocks:
        below = other_frames(base, rate, first, block.frames)
        motion = continuous(subtract(block, below), previous)
        yield motion
        first, previous = first + block.frames, motion.rotations.values[-1]


def _run(
    stream: TakeStream, options: DifferenceOptions, context: PassContext
) -> TakeStream:
    if options.base is None:
        start = Fraction(1) if stream.start is None else stream.start
        base = rest_take(stream.rig, Clock(stream.fps, start, stream.step, 1))
    else:
        base = context.take(options.base, "base")
    return _without(stream, _base(base, options.frame))


PASS = Pass(
    "difference",
    "Make an additive take",
    DifferenceOptions,
    Scope.FRAME,
    _run,
    changes=MOTION_PARTS,
)
