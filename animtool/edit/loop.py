"""Making a cycle of a part of a take, and repeating it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.edit.frames import check_count, frame_index
from animtool.edit.signs import continuous
from animtool.errors import Fault, OptionError
from animtool.maths import so3
from animtool.passes import Pass, PassContext, Scope
from animtool.rig.skeleton import Rig
from animtool.take import Channel, Take
from animtool.units import UpAxis

__all__ = ["PASS", "LoopOptions", "loop"]


@dataclass(frozen=True, slots=True)
class LoopOptions:
    """The cycle and how often it is repeated.

    Attributes:
        first: Time code of the cycle's first frame; None is the take's.
        last: Time code of the frame that shows the first pose again; None is the
            take's last.
        repeats: How often the cycle is shown.
        blend: Frames before the seam over which the poses are brought together.
    """

    first: float | None = None
    last: float | None = None
    repeats: int = 1
    blend: int = 10


def loop(
    take: Take,
    first: float | None = None,
    last: float | None = None,
    *,
    repeats: int = 1,
    blend: int = 10,
) -> Take:
    """Return a cycle of the take, repeated.

    The frame ``last`` is the first of the next cycle and is not shown itself. Over
    the ``blend`` frames before it, what it lacks of the first pose is added with a
    smoothstep weight. Roots keep their travel: each cycle goes on, over the ground
    and about the up axis, from where the one before it ended. A take of one frame
    stays as it is.

    Limits: poses are matched, speeds only as far as the cycle's ends agree in them.

    Raises:
        OptionError: A frame is outside the take (SCN013), or there is no cycle or
            repeat (SCN018).
    """
    clock = take.clock
    if clock.count == 1:
        return take
    i = 0 if first is None else frame_index(clock, first, "first")
    j = clock.count - 1 if last is None else frame_index(clock, last, "last")
    if j <= i or repeats < 1 or blend < 0:
        message = f"{j - i} frames, {repeats} repeats and a blend of {blend}"
        raise OptionError(Fault("SCN018", f"no cycle can be made of {message}"))
    length = j - i
    check_count(length * repeats)
    s = np.clip((np.arange(length) - (length - blend)) / max(blend, 1), 0, 1)
    weight = (s * s * (3 - 2 * s))[:, None, None]
    motion = take.motion.select(slice(i, j + 1))
    turns, slides, bring = _travel(take.rig, motion.translations, motion.rotations)

    def line(channel: Channel) -> Channel:
        values = channel.values
        lacks = values[0] - values[-1]
        cycle = values[:-1] + weight * lacks
        return replace(channel, values=np.concatenate([cycle] * repeats))

    def goes(channel: Channel, turning: bool) -> Channel:
        values, joints = channel.values, channel.animated
        turn, slide = turns[joints], slides[joints]
        if turning:
            target = so3.multiply(turn, values[0])
            lacks = so3.multiply(so3.conjugate(values[-1]), target)
            part = so3.slerp(so3.IDENTITY, lacks, weight[..., 0])
            cycle = so3.multiply(values[:-1], part)
        else:
            target = bring(values[0], joints)
            cycle = values[:-1] + weight * (target - values[-1])
        parts = [cycle]
        # One step a repeat: each is the travel of the one before it.
        for _ in range(repeats - 1):
            before = parts[-1]
            after = so3.multiply(turn, before) if turning else so3.rotate(turn, before)
            parts.append(after if turning else after + slide)
        return replace(channel, values=np.concatenate(parts))

    whole = replace(
        motion.map(line),
        translations=goes(motion.translations, False),
        rotations=goes(motion.rotations, True),
    )
    start = clock.start + i * clock.step
    return replace(
        take,
        clock=replace(clock, start=start, count=length * repeats),
        motion=continuous(whole).map(Channel.compact),
    )


@dataclass(frozen=True, slots=True)
class _Bring:
    turns: FloatArray
    slides: FloatArray

    def __call__(self, values: FloatArray, joints: IntArray) -> FloatArray:
        return so3.rotate(self.turns[joints], values) + self.slides[joints]


def _travel(
    rig: Rig, translations: Channel, rotations: Channel
) -> tuple[FloatArray, FloatArray, _Bring]:
    """Return turn ``(J, 4)`` and slide ``(J, 3)`` of a cycle; roots only have some."""
    up = np.array([0.0, 0.0, 1.0] if rig.up is UpAxis.Z else [0.0, 1.0, 0.0])
    places, poses = (
        c.select(np.array([0, -1])).dense() for c in (translations, rotations)
    )
    whole = so3.multiply(poses[1], so3.conjugate(poses[0]))
    along = (whole[:, :3] @ up)[:, None] * up
    turns = so3.normalize(np.concatenate([along, whole[:, 3:]], axis=-1))
    roots = (rig.parents < 0)[:, None]
    turns = np.where(roots, turns, so3.IDENTITY)
    slides = places[1] - so3.rotate(turns, places[0])
    slides = np.where(roots, slides - (slides @ up)[:, None] * up, 0.0)
    return turns, slides, _Bring(turns, slides)


def _run(take: Take, options: LoopOptions, _: PassContext) -> Take:
    return loop(
        take,
        options.first,
        options.last,
        repeats=options.repeats,
        blend=options.blend,
    )


PASS = Pass("loop", "Make and repeat a cycle", LoopOptions, Scope.CLIP, _run)
