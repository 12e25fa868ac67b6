"""The poses that inverse kinematics starts from: a clip on a rig, or its rest pose."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from animtool.clip.clip import Clip
from animtool.core.clock import Clock
from animtool.core.errors import Fault, OptionError, Severity, listed
from animtool.core.shot import Shot
from animtool.motion.driving import driven_take
from animtool.motion.motion import Channel, Motion
from animtool.motion.reorient import reorient
from animtool.motion.take import Take
from animtool.rig.skeleton import Rig
from animtool.scene.bake.progress import Progress
from animtool.scene.sources.onto_rig import map_names
from animtool.scene.sources.open import (
    SourceOptions,
    open_source,
    takes_option,
)

MAX_NAMED = 6


def rest_take(rig: Rig, clock: Clock) -> Take:
    """Return a take that stays where controls at their defaults leave the rig."""
    last = clock.start + clock.step * (clock.count - 1)
    still = Clip("rest", clock.fps, clock.start, last, ())
    return still.sample(rig, step=clock.step)


def open_start(
    path: Path,
    rig: Rig,
    rig_path: Path,
    options: SourceOptions,
    *,
    progress: Progress = None,
) -> Take:
    """Return a take of a rig: a clip for it, or motion of joints of the same names.

    Joints that the motion lacks stay at rest; what it has beside the rig's is left
    out. Both are said in the take's notices.
    """
    if options.rig is None and takes_option(path, "rig"):
        options = replace(options, rig=rig_path)
    stream = reorient(open_source(path, options, progress=progress), rig.up)
    # What its blocks notice is known when all are read.
    take = _within(stream.collect(), options.shot)
    if take.rig.names == rig.names and take.rig.controls == rig.controls:
        return driven_take(replace(take, rig=rig))
    motion, odd = _mapped(take, rig, path)
    return driven_take(Take(rig, take.clock, motion, (*take.notices, *odd)))


def _within(take: Take, shot: Shot | None) -> Take:
    """Return the samples that the frames of a shot lie between."""
    if shot is None:
        return take
    clock = take.clock
    first = math.floor((shot.start - clock.start) / clock.step)
    last = math.ceil((shot.end - clock.start) / clock.step)
    kept = slice(max(first, 0), min(last, clock.count - 1) + 1)
    if kept.start >= kept.stop:
        return take
    start = clock.start + kept.start * clock.step
    clock = replace(clock, start=start, count=kept.stop - kept.start)
    return replace(take, clock=clock, motion=take.motion.select(kept))


def _mapped(take: Take, rig: Rig, path: Path) -> tuple[Motion, list[Fault]]:
    """Return the motion of the joints that both have, and what is left out."""
    names = map_names(rig, take.rig)
    if (names.joints < 0).all():
        message = f"has no joint of {rig.name!r}"
        hint = f"its joints are {listed(take.rig.names, MAX_NAMED)}"
        raise OptionError(Fault("TGT017", message, str(path), (), hint))
    notices = []
    lacking = [rig.names[j] for j in np.flatnonzero(names.joints < 0).tolist()]
    spare = [take.rig.names[j] for j in names.spare]
    for which, what in (
        (lacking, "has no {}: they stay at rest"),
        (spare, "moves {}, which the rig lacks: they are left out"),
    ):
        if which:
            message = what.format(listed(which, MAX_NAMED))
            fault = Fault("TGT102", message, str(path), severity=Severity.WARNING)
            notices.append(fault)
    motion = replace(names.apply(take.motion), weights=None, controls=None)
    return motion.map(Channel.compact), notices
