"""What flows through animtool: a clock, and the motion of a rig.

A take arrives as a `TakeStream` of blocks of frames, so that a long one is never
held whole, or is gathered into one `Take` where an operation needs all of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from fractions import Fraction

from animtool._types import FloatArray
from animtool.clock import Clock
from animtool.errors import Fault, OptionError, counted
from animtool.maths.curves import Curves
from animtool.motion import Channel, Motion
from animtool.rates import rate_label
from animtool.rig.kinematics import WorldTransforms, forward
from animtool.rig.skeleton import Rig
from animtool.take_checks import impossible_values, misfits
from animtool.transforms import Track


@dataclass(frozen=True, slots=True)
class Take:
    """The motion of one rig, whole.

    Attributes:
        rig: J joints.
        clock: When its F frames are.
        motion: What they hold.
        notices: Warnings and notes about where it comes from.
        tracks: Things beside the rig; most takes have none.

    Raises:
        OptionError: The motion's arrays are not of the rig's joints, shapes and
            controls, of the tracks, or not of the clock's frames (TAKE001), or a
            channel's joints do not ascend (TAKE002), with every such fault; else a
            value is not finite (TAKE004) or a rotation no unit quaternion (TAKE005).
    """

    rig: Rig
    clock: Clock
    motion: Motion
    notices: tuple[Fault, ...] = ()
    tracks: tuple[Track, ...] = ()

    def __post_init__(self) -> None:
        """Check that rig, clock and motion fit together."""
        parts = self.rig, self.clock, self.motion, self.tracks
        faults = misfits(*parts) or impossible_values(*parts)
        if faults:
            raise OptionError(faults)

    def world(self) -> WorldTransforms:
        """Return where every joint is in every frame, world space.

        >>> from animtool.rig.skeleton import Joint
        >>> rig = Rig("arm", (Joint("a", -1), Joint("b", 0, translation=(0, 2, 0))))
        >>> still = Motion(
        ...     Channel.from_dense(rig.rest_translations[None]),
        ...     Channel.from_dense(rig.rest_rotations[None]),
        ... )
        >>> clock = Clock(Fraction(24), Fraction(1), Fraction(1), 1)
        >>> Take(rig, clock, still).world().positions[0].tolist()
        [[0.0, 0.0, 0.0], [0.0, 2.0, 0.0]]
        """
        return forward(self.rig, *self.motion.dense())

    def __repr__(self) -> str:
        """Return the rig's name, the frames and the joints."""
        clock, joints = self.clock, counted(len(self.rig.joints), "joint")
        last = clock.start + clock.step * (clock.count - 1)
        every = "" if clock.step == 1 else f" every {float(clock.step):g}"
        frames = counted(clock.count, "frame")
        return (
            f"<Take of {self.rig.name!r}: {frames} from "
            f"{float(clock.start):g} to {float(last):g}{every} "
            f"at {rate_label(clock.fps)}, {joints}>"
        )


@dataclass(slots=True)
class TakeStream:
    """A take that arrives block by block, once.

    Attributes:
        rig: J joints.
        fps: Time codes a second.
        start: Time code of the first frame; None where the source states none.
        step: Time codes from one frame to the next.
        blocks: Motions of consecutive frames that share their rest and animated
            joints. Reading them may raise `animtool.errors.FormatError`.
        notices: Warnings and notes about the source; complete once the blocks are
            read.
        details: What the source states beyond this, for reports.
        curve: Where the source is a function of time, gives its motion at any times
            ``(F,)`` [time codes of the source]; None where it has samples only.
        count: Number of frames, where ``curve`` is given.
        control_curves: The curves that controls were keyed with, by name, one each,
            over time codes of the source; those that still hold.
        tracks: Things beside the rig, whose times are in the blocks; most takes have
            none.
        points: Names of the meshes and strands whose points the motions hold.
        simulated: What became of each thing that was simulated, as plain values;
            complete once the blocks are read.
    """

    rig: Rig
    fps: Fraction
    start: Fraction | None
    step: Fraction
    blocks: Iterator[Motion]
    notices: list[Fault] = field(default_factory=list)
    details: dict[str, object] = field(default_factory=dict)
    curve: Callable[[FloatArray], Motion] | None = None
    count: int = 0
    control_curves: dict[str, Curves] = field(default_factory=dict)
    tracks: tuple[Track, ...] = ()
    points: frozenset[str] = frozenset()
    simulated: list[dict[str, object]] = field(default_factory=list)

    def collect(self) -> Take:
        """Return the whole take, static joints stored once."""
        motion = Motion.concatenate(list(self.blocks)).map(Channel.compact)
        start = Fraction(1) if self.start is None else self.start
        clock = Clock(self.fps, start, self.step, motion.frames)
        return Take(self.rig, clock, motion, tuple(self.notices), self.tracks)

    @staticmethod
    def of(take: Take) -> TakeStream:
        """Return a stream of one block."""
        clock = take.clock
        return TakeStream(
            take.rig,
            clock.fps,
            clock.start,
            clock.step,
            iter([take.motion]),
            list(take.notices),
            tracks=take.tracks,
            points=frozenset(take.motion.points),
        )
