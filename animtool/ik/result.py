"""What a solve achieved."""

from __future__ import annotations

from collections import Counter
from enum import StrEnum
from fractions import Fraction
from typing import ClassVar

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.clock import Clock
from animtool.core.rates import FractionLike, rate_option
from animtool.core.record import dataclass
from animtool.ik.goals import PARTS
from animtool.ik.jumps import Jump
from animtool.ik.problem import Problem
from animtool.maths import so3
from animtool.motion.driving import driven_take
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.joints import coordinate_slices, local_from_coordinates
from animtool.rig.kinematics import WorldTransforms, forward
from animtool.rig.limits import BallLimit, RangeLimit

# A coordinate this near to its limit is on it [rad] or [m]: farther than what counts as
# inside a narrower one.
ON_LIMIT = 1e-8


class IkStatus(StrEnum):
    """How a solve ended.

    Attributes:
        CONVERGED: Every goal is reached.
        NEAREST: A goal that is missed is out of reach by itself too, and no other
            start ended nearer to it by a millimetre.
        STEADIER: Likewise, and another pose is nearer, but on a path that jumps.
        YIELDED: Goals are missed only for harder ones, for the pose preferred, or for
            an extension that eases out.
        CONFLICT: Every goal can be reached, but not those of one priority together:
            the pose has the least sum of squares.
        STALLED: A method for comparison made no more headway; nothing is known of what
            can be reached.
        BUDGET: Steps or time ran out on the way.
        NOT_FINITE: A target is so far that its distance is no number.
    """

    CONVERGED = "converged"
    NEAREST = "at the nearest reachable pose"
    STEADIER = "out of reach, on a smoother path"
    YIELDED = "yields to what is preferred"
    CONFLICT = "between contradicting goals"
    STALLED = "stopped early"
    BUDGET = "out of budget"
    NOT_FINITE = "numbers beyond range"


@dataclass(frozen=True)
class IkResult:
    """Poses for B problems, and how near to the goals they are.

    Attributes:
        problem: What was asked.
        coordinates: Of the whole rig ``(B, Q)``; limits are kept.
        statuses: ``(B,)``.
        iterations: ``(B,)``.
        descents: Starts tried ``(B,)``.
        seconds: Time of each ``(B,)`` [s], 0 of a closed form; the one part that
            differs between runs.
        misses: What each goal misses of its position [m], orientation, aim and pole
            [rad] ``(B, E, 4)``; 0 of what it does not ask for.
        reached: Which goals are, within the tolerances ``(B, E)``.
        stretches: What the bones of each goal's limb are multiplied by ``(B, E)``: 1
            where none stretch.
        jumps: Of a clip that was followed.
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
    # Of a result of a session: no field, so that one with other coordinates has none.
    _placed: ClassVar[WorldTransforms | None] = None

    def world(self) -> WorldTransforms:
        """Return where every joint of the rig is in the poses, bones stretched."""
        if self._placed is not None:
            return self._placed
        rig = self.problem.rig
        rotations = local_from_coordinates(rig, self.coordinates).rotations
        return forward(rig, self.local_translations(), rotations)

    def with_world(self, world: WorldTransforms) -> IkResult:
        """Return itself, knowing where the joints are."""
        object.__setattr__(self, "_placed", world)
        return self

    @property
    def positions(self) -> FloatArray:
        """What each goal misses of its position ``(B, E)`` [m]; 0 if it has none."""
        return self.misses[:, :, PARTS.index("position")]

    @property
    def orientations(self) -> FloatArray:
        """What each goal misses of its orientation ``(B, E)`` [rad]."""
        return self.misses[:, :, PARTS.index("orientation")]

    @property
    def aims(self) -> FloatArray:
        """What each goal misses of its aim ``(B, E)`` [rad]."""
        return self.misses[:, :, PARTS.index("aim")]

    @property
    def poles(self) -> FloatArray:
        """What each goal misses of its pole ``(B, E)`` [rad]."""
        return self.misses[:, :, PARTS.index("pole")]

    @property
    def converged(self) -> BoolArray:
        """Which problems reached every goal within the tolerance ``(B,)``."""
        return np.array([s is IkStatus.CONVERGED for s in self.statuses], np.bool_)

    @property
    def missed(self) -> list[tuple[int, int]]:
        """Return problem and goal of every goal that is not reached.

        At the status NEAREST, what they miss in ``positions`` is the distance from the
        nearest point that can be reached.
        """
        return [(int(b), int(e)) for b, e in np.argwhere(~self.reached)]

    def local_translations(self) -> FloatArray:
        """Return the joints' translations, stretched ``(B, J, 3)`` [m], from parents.

        With the rotations of ``coordinates`` they put the goals' points where the
        solver had them.
        """
        rig = self.problem.rig
        local = local_from_coordinates(rig, self.coordinates).translations.copy()
        for limb in self.problem.limbs:
            local[:, list(limb.joints)] *= self.stretches[:, limb.goal, None, None]
        return local

    def take(
        self,
        fps: FractionLike = 24,
        start: Fraction | int = 1,
    ) -> Take:
        """Return the poses as a take of B frames, one after the other.

        Args:
            fps: Frames a second, such as 24, ``"23.976"`` or ``Fraction(24000,
                1001)``.
            start: Number of the first frame.

        Raises:
            OptionError: The rate is none (SCN022), or there is no pose (TAKE001).
        """
        clock = Clock(
            rate_option(fps),
            Fraction(start),
            Fraction(1),
            len(self.coordinates),
        )
        rig = self.problem.rig
        rotations = local_from_coordinates(rig, self.coordinates).rotations
        motion = Motion(
            Channel.from_dense(self.local_translations()),
            Channel.from_dense(so3.align_signs(rotations)),
        )
        return driven_take(Take(rig, clock, motion))

    def limits_active(self, index: int = 0) -> list[str]:
        """Return the joints that stand on a limit in one of the poses."""
        row = self.coordinates[index][None]
        names = frames_on_limits(self.problem, row)
        return [name for name, on in names.items() if on[0]]

    def __repr__(self) -> str:
        """Return how many ended how, and the worst miss."""
        counts = Counter(map(str, self.statuses))
        ends = ", ".join(f"{count} {status}" for status, count in counts.items())
        worst = float(self.positions.max(initial=0.0))
        missed = f"; goals missed: {len(self.missed)}" if self.missed else ""
        return f"<IkResult: {ends}{missed}; worst position {worst:.3g} m>"


def frames_on_limits(problem: Problem, coordinates: FloatArray) -> dict[str, BoolArray]:
    """Return by joint in which poses it stands on a limit ``(B,)``.

    ``coordinates`` ``(B, Q)``.
    """
    rig, names = problem.rig, set(problem.joints)
    return {
        joint.name: _on_limit(joint.limits, coordinates[:, place])
        for joint, place in zip(rig.joints, coordinate_slices(rig), strict=True)
        if joint.name in names and joint.limits is not None
    }


def _on_limit(limit: RangeLimit | BallLimit, own: FloatArray) -> BoolArray:
    if isinstance(limit, RangeLimit):
        room = np.minimum(own[:, 0] - limit.low, limit.high - own[:, 0])
        return np.asarray(room <= ON_LIMIT)
    # What a limit a little narrower takes back stands on the true one.
    swing, twist = limit.swing, limit.twist
    if swing is not None:
        swing = (max(swing[0] - ON_LIMIT, 0.0), max(swing[1] - ON_LIMIT, 0.0))
    if twist is not None and twist[1] - twist[0] > 2 * ON_LIMIT:
        twist = (twist[0] + ON_LIMIT, twist[1] - ON_LIMIT)
    inner = BallLimit(swing, twist, limit.twist_axis)
    return np.asarray(inner.excess(own[:, -4:]) > ON_LIMIT / 10)
