"""Joints and roots that jump in one frame of motion that is otherwise smooth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from animtool._types import BoolArray, FloatArray, IntArray
from animtool.errors import Fault, listed
from animtool.validation.motion.subject import MotionSubject


def surprises(steps: FloatArray, cuts: BoolArray) -> FloatArray:
    """Return how far each step is from those around it ``(S, N)``.

    The prediction is the mean of the middle two of the two steps before and the two
    after, by component, so that one bad step does not spoil that of its neighbours.

    ``steps`` ``(S, N, 3)``, ``cuts`` ``(S,)``.
    """
    if len(steps) < 3:
        return np.zeros(steps.shape[:2])
    steps = _without(steps, cuts)
    rows = np.pad(steps, ((2, 2), (0, 0), (0, 0)), mode="edge")
    a, b, c, d = rows[:-4], rows[1:-3], rows[3:-1], rows[4:]
    most = np.maximum(np.maximum(a, b), np.maximum(c, d))
    least = np.minimum(np.minimum(a, b), np.minimum(c, d))
    off = steps - 0.5 * (a + b + c + d - most - least)
    return np.asarray(np.sqrt(np.einsum("snc,snc->sn", off, off)))


def _without(steps: FloatArray, cuts: BoolArray) -> FloatArray:
    """Return steps in which cuts do what the nearest other step does."""
    if not cuts.any() or cuts.all():
        return steps
    kept = np.flatnonzero(~cuts)
    place = np.searchsorted(kept, np.arange(len(steps))).clip(0, len(kept) - 1)
    return np.asarray(steps[kept[place]])


def mean_around(values: FloatArray, reach: int, gap: int) -> FloatArray:
    """Return the mean of the rows within reach, the nearest left out ``(S, N)``.

    ``values`` ``(S, N)``.
    """
    count = len(values)
    total = np.concatenate([np.zeros((1, *values.shape[1:])), values.cumsum(axis=0)])
    i = np.arange(count)
    low = np.clip(np.stack([i - reach, i + gap + 1]), 0, count)
    high = np.maximum(np.clip(np.stack([i - gap, i + reach + 1]), 0, count), low)
    sums = (total[high] - total[low]).sum(axis=0)
    return np.asarray(sums / np.maximum((high - low).sum(axis=0), 1)[:, None])


def around(values: FloatArray) -> FloatArray:
    """Return the larger of the values beside a step that may stay or come back.

    A joint that jumps and stays makes one bad step, one that is back in the next
    frame makes two: of the ways to leave such a neighbour out, the one that leaves
    the least counts.

    ``values`` ``(S, N)``.
    """
    rows = np.pad(values, ((2, 2), (0, 0)))
    before2, before, after, after2 = rows[:-4], rows[1:-3], rows[3:-1], rows[4:]
    stays = np.maximum(before, after)
    comes_back = np.maximum(before, after2)
    came_back = np.maximum(before2, after)
    return np.asarray(np.minimum(stays, np.minimum(comes_back, came_back)))


def changes(steps: FloatArray) -> FloatArray:
    """Return how far the steps after each differ from those before ``(S, N)``.

    A ball that bounces goes on another way, and a root that jumps goes on as before.
    As in `around`, of the ways to leave out a neighbour the best one counts.

    ``steps`` ``(S, N, 3)``.
    """
    rows = np.pad(steps, ((2, 2), (0, 0), (0, 0)), mode="edge")
    before2, before, after, after2 = rows[:-4], rows[1:-3], rows[3:-1], rows[4:]
    pairs = ((before, after), (before, after2), (before2, after))
    return np.asarray(
        np.min([np.linalg.norm(late - early, axis=2) for early, late in pairs], axis=0)
    )


def runs(flags: BoolArray) -> Iterator[tuple[int, int]]:
    """Yield the first and last index of each run of true values.

    >>> list(runs(np.array([True, False, True, True])))
    [(0, 0), (2, 3)]
    """
    edges = np.flatnonzero(np.diff(flags.astype(np.int8), prepend=0, append=0))
    for start, end in edges.reshape(-1, 2).tolist():
        yield start, end - 1


# A smaller difference to the motion around is seen as a part of it [rad].
MIN_TURN = math.radians(18.5)
# The same of moves, of the rig's size: of a joint against its parent, where rigs that
# slide and stretch do so on purpose; and of a root, which is seen sooner [1].
MIN_SHIFT, MIN_ROOT_SHIFT = 0.2, 0.02
# No motion at the rates in use turns a joint so far in one frame [rad].
FLIP = math.radians(120.0)
# A pop is as many times rougher than the motion around: kicks, claps and landings at
# 24 to 120 fps come to 6, and 20 degrees in a smooth walk to 9 and more [1]. Motion is
# never taken for smoother than this, which is the noise of captures [rad], [size].
STANDS_OUT = 8.0
TURN_NOISE, SHIFT_NOISE = math.radians(1.0), 0.002
# Of the steps beside it [1]; fast motion begins and ends over several frames.
ABOVE_NEIGHBOURS = 5.5
# Motion around: this long before and after, but some steps at least [s], [1].
REACH_SECONDS, MIN_STEPS = 0.12, 12
# A move is as many times what the speed changes by: a ball that bounces turns its speed
# round in one step, and that is the jump [1].
ABOVE_CHANGE = 2.5
# Steps beside a pop that it disturbs itself [1].
GAP = 2
# Fewer frames do not show what is usual in them.
MIN_FRAMES = 8
# So many joints that jump from the first frame are a reference pose.
REFERENCE_JOINTS = 3
# Below this many degrees a joint starts from rest, and does not leave a pose.
REFERENCE_TURN = math.radians(30.0)


@dataclass(frozen=True, slots=True)
class _Pops:
    """Steps at which joints jump."""

    joints: IntArray  # of the columns ``(N,)``
    flags: BoolArray  # where ``(S, N)``
    amounts: FloatArray  # how far each step is from the motion around ``(S, N)``
    unit: str  # ``rad`` or ``m``

    def worst(self) -> tuple[int, int]:
        """Return step and column of the largest jump."""
        amounts = np.where(self.flags, self.amounts, -1.0)
        step, column = np.unravel_index(int(amounts.argmax()), amounts.shape)
        return int(step), int(column)

    def much(self, step: int, column: int) -> str:
        """Return how far a joint jumps, with its unit."""
        amount = float(self.amounts[step, column])
        if self.unit == "m":
            return f"{amount:.3g} m"
        return f"{math.degrees(min(amount, math.pi)):.0f}\N{DEGREE SIGN}"


def joint_pops(subject: MotionSubject) -> Iterator[Fault]:
    """Yield the joints below the roots that jump in one frame (MOT202)."""
    hint = "correct the frames around it; a cut that is meant has interp: step"
    pops = _pops(subject, MIN_SHIFT, roots=False)
    yield from _reported(subject, "MOT202", pops, hint)


def root_pops(subject: MotionSubject) -> Iterator[Fault]:
    """Yield the roots that jump in one frame: the whole character does (MOT203)."""
    hint = "correct the frames around it, or cut the take there"
    pops = _pops(subject, MIN_ROOT_SHIFT, roots=True)
    yield from _reported(subject, "MOT203", pops, hint)


def _pops(subject: MotionSubject, least: float, *, roots: bool) -> list[_Pops]:
    """Return jumps of turning, and of moving joints: of the roots, or of all others."""
    own = list(subject.take.rig.roots)
    turning, moving = (
        np.flatnonzero(np.isin(joints, own) == roots)
        for joints in (subject.turning, subject.moving)
    )
    return [_turn_pops(subject, turning), _shift_pops(subject, moving, least)]


def _reported(
    subject: MotionSubject, code: str, all_pops: list[_Pops], hint: str
) -> Iterator[Fault]:
    """Yield one fault for all jumps of a kind, which names the largest."""
    all_pops = [pops for pops in all_pops if pops.flags.any()]
    if not all_pops:
        return
    pops = all_pops[0]
    step, column = pops.worst()
    joint = int(pops.joints[column])
    names = {
        subject.take.rig.joints[int(entry.joints[i])].name: None
        for entry in all_pops
        for i in np.flatnonzero(entry.flags.any(axis=0))
    }
    name = subject.take.rig.joints[joint].name
    steps = np.concatenate([np.flatnonzero(p.flags.any(axis=1)) for p in all_pops])
    often = len(np.unique(steps))
    message = (
        f"{name!r} jumps by {pops.much(step, column)} from frame {subject.at(step)} "
        f"to {subject.at(step + 1)}, against the motion around it"
    )
    others = [other for other in names if other != name]
    if often > 1:
        message += f"; there are {often} such steps in all"
    if others:
        message += f"; also {listed(others)}"
    yield subject.fault(code, joint, step, message, hint)


def _turn_pops(subject: MotionSubject, columns: IntArray) -> _Pops:
    joints = subject.turning[columns]
    if subject.frames < MIN_FRAMES or not len(columns):
        return _no_pops(joints)
    turns = subject.turns[:, columns]
    amounts = surprises(turns, _ignored(subject))
    flags = _stands_out(subject, amounts, MIN_TURN, TURN_NOISE)
    # Where every other step is one, none is above what is around it.
    flips = np.linalg.norm(turns, axis=2) > FLIP
    flags |= flips & (amounts > MIN_TURN + 2.0 * np.median(amounts, axis=0))
    return _Pops(joints, flags, amounts, "rad")


def _shift_pops(subject: MotionSubject, columns: IntArray, least: float) -> _Pops:
    joints = subject.moving[columns]
    if subject.frames < MIN_FRAMES or not len(columns):
        return _no_pops(joints)
    shifts = subject.shifts[:, columns]
    amounts = surprises(shifts, _ignored(subject))
    size = subject.size
    flags = _stands_out(subject, amounts, least * size, SHIFT_NOISE * size)
    flags &= amounts > ABOVE_CHANGE * changes(shifts)
    return _Pops(joints, flags, amounts, "m")


def _no_pops(joints: IntArray) -> _Pops:
    empty = np.zeros((0, len(joints)))
    return _Pops(joints, empty.astype(bool), empty, "rad")


def _ignored(subject: MotionSubject) -> BoolArray:
    """Return cuts, and the first step: many captures begin with a pose of its own."""
    cuts = subject.cuts()
    cuts[:1] = True
    return cuts


def _stands_out(
    subject: MotionSubject, amounts: FloatArray, least: float, noise: float
) -> BoolArray:
    """Return where surprises are far above those around ``(S, N)``."""
    candidates = (amounts > least).any(axis=0)
    flags = np.zeros(amounts.shape, bool)
    if not candidates.any():
        return flags
    amounts = amounts[:, candidates]
    reach = max(MIN_STEPS, round(REACH_SECONDS / subject.interval))
    usual = noise + mean_around(amounts, reach, GAP)
    flags[:, candidates] = (
        (amounts > least)
        & (amounts > STANDS_OUT * usual)
        & (amounts > ABOVE_NEIGHBOURS * around(amounts))
    )
    return flags


def _leaving_first(subject: MotionSubject) -> IntArray:
    """Return the joints that jump from the first frame to the second."""
    if subject.frames < MIN_FRAMES or not len(subject.turning):
        return np.zeros(0, np.int64)
    sizes = np.linalg.norm(subject.turns[:MIN_FRAMES], axis=2)
    usual = sizes[1:].max(axis=0)
    away = (sizes[0] > REFERENCE_TURN) & (sizes[0] > STANDS_OUT * usual)
    return np.asarray(subject.turning[away])


def reference_pose(subject: MotionSubject) -> Iterator[Fault]:
    """Yield that the first frame is a pose of its own (MOT204)."""
    pose = _leaving_first(subject)
    if len(pose) < REFERENCE_JOINTS or subject.cuts()[0]:
        return
    first, second = subject.at(0), subject.at(1)
    message = (
        f"frame {first} is a pose of its own: {len(pose)} joints jump to that of "
        f"frame {second}"
    )
    hint = f"the pass trim: {{first: {second}}} leaves it out"
    yield subject.fault("MOT204", int(pose[0]), 0, message, hint)
