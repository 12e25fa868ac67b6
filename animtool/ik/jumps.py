"""Joints that step farther in one frame than the motion a solve started from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.pops import shift_pops, turn_pops
from animtool.rig.joints import LocalTransforms

# A joint jumps that moves by more than this [rad], or share of the chain's length, and
# this a second; at low rates a turn by more than the most is one all the same.
MIN_JUMP, MIN_SPEED, MAX_TURN = 0.1, 8.0, 0.5
# Goals explain a step up to so many times what they move by, and a little more.
MORE_THAN_TARGETS = 2.0
# Slower ones are named too, where the joint moves so many times farther than within
# so many frames before and after.
MORE_THAN_NEIGHBOURS, NEIGHBOURS = 4.0, 2
# Slides that the motion around does not predict, and noise [chain lengths]: half of
# what rule MOT202 takes, as a chain may be longer than its rig at rest.
MIN_SLIDE, SLIDE_NOISE = 0.1, 0.001


@dataclass(frozen=True, slots=True)
class Jump:
    """A joint that moves much farther in a frame than it did before the solve.

    Attributes:
        frame: Index of the frame that is jumped to.
        joint: Its name.
        size: How far the joint turns [rad], or slides [m].
        source: How far it does in the motion that the solve started from.
        slides: Whether these are lengths.
        by_goals: Whether the goals move far enough in this frame to explain it.
    """

    frame: int
    joint: str
    size: float
    source: float = 0.0
    slides: bool = False
    by_goals: bool = False
    json_keys: ClassVar[str] = "frame joint unit size source by_goals"

    @property
    def unit(self) -> str:
        """The unit of the sizes."""
        return "m" if self.slides else "rad"


def largest_step(fps: float) -> float:
    """Return how far a joint may turn in a frame [rad], or slide [chain lengths]."""
    return min(MIN_JUMP + MIN_SPEED / fps, MAX_TURN)


def find_jumps(
    names: Sequence[str],
    before: LocalTransforms | None,
    after: LocalTransforms,
    goal_moves: FloatArray,
    *,
    fps: float,
    length: float,
    windings: FloatArray | None = None,
) -> tuple[Jump, ...]:
    """Return the jumps of joints, by frame and joint.

    A joint jumps where it turns by more than `largest_step` beyond what the source
    does, or by more than .5 rad and .1 rad beyond it; where it jerks, slower, out of
    rest and back to it; and where the motion around a step does not predict it, as
    rule MOT202 has it.

    Args:
        names: Of J joints.
        before: The F poses that the solve started from; None is one pose for all.
        after: The poses that it found.
        goal_moves: How far the goals move from frame to frame ``(F - 1,)`` [rad],
            [chain lengths].
        fps: Frames a second.
        length: Of the chain [m].
        windings: Whole turns of joints from frame to frame ``(F - 1, J)`` [rad], which
            rotations do not show; None is none.
    """
    count = len(after.rotations)
    if count < 2:
        return ()
    moving = _moving(before, after, windings)
    if not len(moving):
        return ()
    names = [names[j] for j in moving]
    after = _selected(after, moving)
    before = None if before is None else _selected(before, moving)
    windings = None if windings is None else windings[:, moving]
    cuts = np.zeros(count - 1, np.bool_)
    moves = goal_moves[:, None]
    turns, old = _turns(after.rotations), _turns(after.rotations[:1].repeat(count, 0))
    if before is not None:
        old = _turns(before.rotations)
    angles, old_angles = np.linalg.norm(turns, axis=2), np.linalg.norm(old, axis=2)
    if windings is not None:
        angles = angles + windings
    excess = angles - old_angles
    flags = (angles > MAX_TURN) & (excess > MIN_JUMP)
    flags |= (excess > largest_step(fps)) | _jerking(excess, moves)
    pops = turn_pops(turns, 1.0 / fps, cuts)[0]
    flags |= pops & ~turn_pops(old, 1.0 / fps, cuts)[0]
    found = _named(names, flags, angles, old_angles, moves)
    shifts = np.diff(after.translations, axis=0)
    old = np.zeros_like(shifts)
    if before is not None:
        old = np.diff(before.translations, axis=0)
    sizes, old_sizes = (np.linalg.norm(rows, axis=2) / length for rows in (shifts, old))
    excess = sizes - old_sizes
    flags = (excess > largest_step(fps)) | _jerking(excess, moves)
    limits = (1.0 / fps, cuts, MIN_SLIDE * length, SLIDE_NOISE * length)
    flags |= shift_pops(shifts, *limits)[0] & ~shift_pops(old, *limits)[0]
    found += _named(names, flags, sizes, old_sizes, moves, length=length)
    return tuple(sorted(found, key=lambda jump: jump.frame))


def _moving(
    before: LocalTransforms | None,
    after: LocalTransforms,
    windings: FloatArray | None,
) -> IntArray:
    """Return the joints that are not the same in all frames: others cannot jump."""
    moves = np.zeros(after.rotations.shape[1], np.bool_)
    for poses in (after, before):
        if poses is not None:
            for values in (poses.rotations, poses.translations):
                moves |= (values != values[:1]).any(axis=(0, 2))
    if windings is not None:
        moves |= windings.any(axis=0)
    return np.asarray(np.flatnonzero(moves))


def _selected(poses: LocalTransforms, joints: IntArray) -> LocalTransforms:
    return LocalTransforms(poses.translations[:, joints], poses.rotations[:, joints])


def _turns(rotations: FloatArray) -> FloatArray:
    """Return rotation vectors from frame to frame ``(F - 1, J, 3)``."""
    return so3.log(so3.multiply(rotations[1:], so3.conjugate(rotations[:-1])))


def _jerking(steps: FloatArray, goal_moves: FloatArray) -> BoolArray:
    """Return which steps ``(F - 1, N)`` are far larger than those about them."""
    around = np.zeros_like(steps)
    for away in range(1, NEIGHBOURS + 1):
        around[away:] = np.maximum(around[away:], steps[:-away])
        around[:-away] = np.maximum(around[:-away], steps[away:])
    least = np.maximum(
        MORE_THAN_NEIGHBOURS * around, MIN_JUMP + MORE_THAN_TARGETS * goal_moves
    )
    jerks = steps > least
    # Of the first and the last, nothing is known on one side.
    jerks[:1] = jerks[-1:] = False
    return np.asarray(jerks, np.bool_)


def _named(
    names: Sequence[str],
    flags: BoolArray,
    steps: FloatArray,
    old: FloatArray,
    goal_moves: FloatArray,
    length: float | None = None,
) -> list[Jump]:
    """Return the steps that are flagged ``(F - 1, J)``: with a length, slides."""
    explained = steps - old <= MIN_JUMP + MORE_THAN_TARGETS * goal_moves
    places: IntArray = np.argwhere(flags)
    return [
        Jump(
            int(t) + 1,
            names[int(j)],
            float(steps[t, j]) * (length or 1.0),
            float(old[t, j]) * (length or 1.0),
            length is not None,
            bool(explained[t, j]) and bool(goal_moves[t, 0] > 0),
        )
        for t, j in places
    ]
