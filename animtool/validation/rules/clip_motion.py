"""What a clip does from frame to frame: jumps, and feet that slide."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from animtool._types import BoolArray, FloatArray
from animtool.clip.channels import Interp
from animtool.errors import Fault
from animtool.rig.kinematics import forward, rest_size
from animtool.validation.rules.leaps import leaps
from animtool.validation.subjects.clip import ClipSubject
from animtool.validation.subjects.steps import steps_of

__all__ = ["foot_slide", "jumps"]

_FOOT = re.compile(r"(?i)foot|toe|ankle|heel")
# Of the rig's size: how near to the ground a foot stands, how fast it may rise a frame,
# how far it may slide while it stands, and how far a clip must travel not to be one on
# the spot, whose feet slide by intent.
GROUND, RISE, SLIDE, TRAVEL = 0.02, 0.002, 0.05, 0.2
# Fewer frames are a foot that passes.
FEWEST_FRAMES = 4


def jumps(subject: ClipSubject) -> Iterator[Fault]:
    """Yield joints that leap in one frame, apart from steps (CLIP203)."""
    for leap in leaps(steps_of(subject.take), _stepping(subject)):
        name = subject.rig.joints[leap.joint].name
        at = subject.at(name, subject.frames[leap.frame])
        hint = "interp: step says that it is meant"
        yield subject.fault("CLIP203", at, leap.message(subject.take), hint)


def foot_slide(subject: ClipSubject) -> Iterator[Fault]:
    """Yield feet that slide while they stand, in a clip that travels (CLIP204)."""
    rig, motion = subject.rig, subject.take.motion
    feet = [i for i, joint in enumerate(rig.joints) if _FOOT.search(joint.name)]
    if not feet or len(subject.frames) < FEWEST_FRAMES:
        return
    positions = forward(rig, *motion.dense()).positions
    size = rest_size(rig)
    up = np.array(rig.up.vector)
    root = _level(positions[:, rig.roots[0]], up)
    if not size or float(np.linalg.norm(root[-1] - root[0])) < TRAVEL * size:
        return
    for j in feet:
        height = positions[:, j] @ up
        near = height <= height.min() + GROUND * size
        rising = np.abs(np.diff(height, append=height[-1])) > RISE * size
        level = _level(positions[:, j], up)
        for start, end in _runs(near & ~rising):
            far = float(np.linalg.norm(level[end] - level[start]))
            if end - start + 1 < FEWEST_FRAMES or far < SLIDE * size:
                continue
            name = rig.joints[j].name
            first, last = subject.frames[start], subject.frames[end]
            message = f"{name!r} slides {far:.3g} m from frame {first:g} to {last:g}"
            hint = "hold it with IK, or let the clip stay on the spot"
            yield subject.fault("CLIP204", subject.at(name, first), message, hint)
            break


def _stepping(subject: ClipSubject) -> BoolArray:
    """Return from which frames to the next a step is keyed ``(F - 1,)``."""
    frames = np.array(subject.frames)
    meant = np.zeros(len(frames) - 1, bool)
    for channel in subject.clip.channels:
        for k, interp in enumerate(channel.interps[:-1]):
            if interp is Interp.STEP:
                at = channel.times[k + 1]
                meant |= (frames[:-1] < at) & (at <= frames[1:])
    return meant


def _level(points: FloatArray, up: FloatArray) -> FloatArray:
    """Return points ``(F, 3)`` without their height."""
    return np.asarray(points - (points @ up)[:, None] * up)


def _runs(standing: BoolArray) -> Iterator[tuple[int, int]]:
    """Yield first and last frame of each run."""
    edges = np.flatnonzero(np.diff(standing.astype(int), prepend=0, append=0))
    for start, behind in edges.reshape(-1, 2).tolist():
        yield start, behind - 1
