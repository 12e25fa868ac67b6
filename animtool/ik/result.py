"""Results of a solve."""

from __future__ import annotations

from collections import Counter
from dataclasses import fields, replace
from enum import StrEnum
from fractions import Fraction
from typing import ClassVar

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.clock import Clock
from animtool.core.errors import Fault, warning
from animtool.core.quantities import length_text
from animtool.core.rates import FractionLike, rate_option
from animtool.core.record import dataclass
from animtool.ik.goals import GOAL_PARTS
from animtool.ik.jumps import Jump
from animtool.ik.problem import Problem
from animtool.maths import so3
from animtool.motion.driving import drive_take
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.joints import coordinate_slices, local_from_coordinates
from animtool.rig.kinematics import WorldTransforms, forward_kinematics, rest_size
from animtool.rig.limits import BallLimit, RangeLimit

# A coordinate within this distance of its limit is on it [rad] or [m]; must exceed the
# tolerance of limits.
LIMIT_TOLERANCE = 1e-8


class IkStatus(StrEnum):
    """Status of a solve: whether goals are reached, or why not.

    Attributes:
        CONVERGED: Every goal is reached.
        NEAREST: A missed goal cannot be reached on its own either, and no other start
            got a millimetre nearer to it.
        STEADIER: Likewise, but a nearer pose exists on a path that jumps.
        YIELDED: Goals are missed only in favour of goals of higher priority, the
            preferred pose or soft extension.
        CONFLICT: Each goal can be reached, but not all of one priority together: the
            pose has the least sum of squares.
        STALLED: A method for comparison stopped making progress; reachability is
            unknown.
        BUDGET: Iterations or time ran out.
        NOT_FINITE: A target is so far away that its distance overflows.
    """

    CONVERGED = "converged"
    NEAREST = "at the nearest reachable pose"
    STEADIER = "out of reach, on a smoother path"
    YIELDED = "yields to what is preferred"
    CONFLICT = "between contradicting goals"
    STALLED = "stopped early"
    BUDGET = "out of budget"
    NOT_FINITE = "numbers beyond range"


# Goals that are missed by more than this are in another unit, or another place [size].
MAX_GOAL_DISTANCE = 10.0


@dataclass(frozen=True)
class IkResult:
    """Solved poses of B problems, and their misses.

    Attributes:
        problem: The problem.
        coordinates: Rig coordinates within limits ``(B, Q)``.
        statuses: Status of each problem ``(B,)``.
        iterations: Number of iterations ``(B,)``.
        descents: Number of starts tried ``(B,)``.
        seconds: Solve time ``(B,)`` [s], 0 for a closed form; the only field that
            differs between runs.
        misses: Misses of each goal's position [m], orientation, aim and pole [rad]
            ``(B, E, 4)``; 0 for unused parts.
        reached: Mask of the goals within tolerances ``(B, E)``.
        stretches: Bone length scales of each goal's limb ``(B, E)``, 1 if unstretched.
        jumps: Jumps of a clip.
    """

    problem: Problem
    coordinates: FloatArray
    statuses: tuple[IkStatus, ...]
    iterations: IntArray
    descents: IntArray
    seconds: FloatArray
    misses: FloatArray
    reached: BoolArray
    stretches: FloatArray
    jumps: tuple[Jump, ...] = ()
    # World transforms of a session's result. Not a field, so that `replace` drops them.
    _cached_world: ClassVar[WorldTransforms | None] = None

    def world(self) -> WorldTransforms:
        """Return the joints' world transforms in the poses, with stretched bones."""
        if self._cached_world is not None:
            return self._cached_world
        rig = self.problem.rig
        rotations = local_from_coordinates(rig, self.coordinates).rotations
        return forward_kinematics(rig, self.local_translations(), rotations)

    def with_world(self, world: WorldTransforms) -> IkResult:
        """Cache the world transforms of the joints; return the result itself."""
        object.__setattr__(self, "_cached_world", world)
        return self

    @property
    def positions(self) -> FloatArray:
        """Position misses of each goal ``(B, E)`` [m]; 0 if it has no position."""
        return self.misses[:, :, GOAL_PARTS.index("position")]

    @property
    def orientations(self) -> FloatArray:
        """Orientation misses of each goal ``(B, E)`` [rad]."""
        return self.misses[:, :, GOAL_PARTS.index("orientation")]

    @property
    def aims(self) -> FloatArray:
        """Aim misses of each goal ``(B, E)`` [rad]."""
        return self.misses[:, :, GOAL_PARTS.index("aim")]

    @property
    def poles(self) -> FloatArray:
        """Pole misses of each goal ``(B, E)`` [rad]."""
        return self.misses[:, :, GOAL_PARTS.index("pole")]

    @property
    def converged(self) -> BoolArray:
        """Mask of the problems that reach every goal ``(B,)``."""
        return np.array([s is IkStatus.CONVERGED for s in self.statuses], np.bool_)

    @property
    def missed(self) -> list[tuple[int, int]]:
        """Pairs of problem and goal for every missed goal.

        With status NEAREST, ``positions`` is the distance from the nearest reachable
        point.
        """
        return [(int(b), int(e)) for b, e in np.argwhere(~self.reached)]

    @property
    def notices(self) -> list[Fault]:
        """Warning about goals so far away that their unit looks wrong (IK104)."""
        rig = self.problem.rig
        rig_size = rest_size(rig)
        largest_misses = self.positions.max(axis=0, initial=0.0)
        far_goals = np.flatnonzero(
            largest_misses > MAX_GOAL_DISTANCE * rig_size
        ).tolist()
        if not rig_size or not far_goals:
            return []
        goal = max(far_goals, key=lambda i: float(largest_misses[i]))
        name = self.problem.goals[goal].joint
        message = (
            f"the goal of {name!r} is {length_text(float(largest_misses[goal]))} out "
        )
        message += f"of reach, and {rig.name!r} measures {length_text(rig_size)}"
        hint = "positions are in metres: divide those in centimetres by 100"
        return [warning("IK104", message, hint)]

    def local_translations(self) -> FloatArray:
        """Return the joints' local translations with stretch ``(B, J, 3)`` [m].

        With the rotations of ``coordinates`` they reproduce the solver's goal points.
        """
        rig = self.problem.rig
        local = local_from_coordinates(rig, self.coordinates).translations.copy()
        for limb in self.problem.limbs:
            local[:, list(limb.joints)] *= self.stretches[:, limb.goal, None, None]
        return local

    def take(self, fps: FractionLike = 24, start: Fraction | int = 1) -> Take:
        """Return the poses as a take of B consecutive frames.

        Args:
            fps: Frames a second, such as 24, ``"23.976"`` or ``Fraction(24000,
                1001)``.
            start: Number of the first frame.

        Raises:
            OptionError: The rate is invalid (SCN022), or there is no pose (TAKE001).
        """
        pose_count = len(self.coordinates)
        clock = Clock(rate_option(fps), Fraction(start), Fraction(1), pose_count)
        rig = self.problem.rig
        rotations = local_from_coordinates(rig, self.coordinates).rotations
        translations = Channel.from_dense(self.local_translations())
        motion = Motion(translations, Channel.from_dense(so3.align_signs(rotations)))
        return drive_take(Take(rig, clock, motion))

    def select(self, rows: IntArray | slice) -> IkResult:
        """Return the result of the selected problems, with the same jumps."""
        array_by_field = {
            name: getattr(self, name)[rows] for name in PER_PROBLEM_ARRAYS
        }
        statuses = tuple(np.array(self.statuses, object)[rows].tolist())
        return replace(self, statuses=statuses, **array_by_field)

    def limits_active(self, index: int = 0) -> list[str]:
        """Return the names of the joints that are at a limit in pose ``index``."""
        row = self.coordinates[index][None]
        masks_by_joint = frames_on_limits(self.problem, row)
        return [name for name, is_on_limit in masks_by_joint.items() if is_on_limit[0]]

    def __repr__(self) -> str:
        """Return the number of problems by status, and the worst miss."""
        count_by_status = Counter(map(str, self.statuses))
        status_text = ", ".join(
            f"{count} {status}" for status, count in count_by_status.items()
        )
        worst_position = float(self.positions.max(initial=0.0))
        missed_text = f"; goals missed: {len(self.missed)}" if self.missed else ""
        worst_text = f"worst position {worst_position:.3g} m"
        if self.missed:
            goal = int(self.positions.max(axis=0, initial=0.0).argmax())
            worst_text += f" of {self.problem.goals[goal].joint!r}"
        return f"<IkResult: {status_text}{missed_text}; {worst_text}>"


# Names of the arrays that have a row for each problem.
PER_PROBLEM_ARRAYS = tuple(
    field.name
    for field in fields(IkResult)
    if field.name not in {"problem", "statuses", "jumps"}
)


def frames_on_limits(problem: Problem, coordinates: FloatArray) -> dict[str, BoolArray]:
    """Return masks by joint of the poses in which it is on a limit ``(B,)``.

    ``coordinates`` ``(B, Q)``.
    """
    rig, names = problem.rig, set(problem.joints)
    return {
        joint.name: _is_on_limit(joint.limits, coordinates[:, columns])
        for joint, columns in zip(rig.joints, coordinate_slices(rig), strict=True)
        if joint.name in names and joint.limits is not None
    }


def _is_on_limit(limit: RangeLimit | BallLimit, coordinates: FloatArray) -> BoolArray:
    """Return a mask of the poses in which a coordinate is at its limit ``(B,)``."""
    if isinstance(limit, RangeLimit):
        values = coordinates[:, 0]
        distance = np.minimum(values - limit.low, limit.high - values)
        return np.asarray(distance <= LIMIT_TOLERANCE)
    # A pose outside a slightly narrower limit is on the true one.
    swing, twist = limit.swing, limit.twist
    if swing is not None:
        a, b = (max(angle - LIMIT_TOLERANCE, 0.0) for angle in swing)
        swing = (a, b)
    if twist is not None and twist[1] - twist[0] > 2 * LIMIT_TOLERANCE:
        twist = (twist[0] + LIMIT_TOLERANCE, twist[1] - LIMIT_TOLERANCE)
    narrower_limit = BallLimit(swing, twist, limit.twist_axis)
    return np.asarray(narrower_limit.excess(coordinates[:, -4:]) > LIMIT_TOLERANCE / 10)
