"""From a problem, starts and targets to poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool import _kernels
from animtool._types import ArrayLike, FloatArray
from animtool.errors import Fault, OptionError
from animtool.ik.goals import Targets, pack
from animtool.ik.problem import Problem, rest_pose
from animtool.ik.result import IkResult, IkStatus
from animtool.maths import so3

__all__ = ["IkOptions", "solve"]

_STATUSES = (
    IkStatus.CONVERGED,
    IkStatus.NEAREST,
    IkStatus.BUDGET,
    IkStatus.NOT_FINITE,
)
# Damping of the first step: far from the goals, and beside them.
COLD_DAMPING, WARM_DAMPING = 1e-3, 1e-6


@dataclass(frozen=True, slots=True)
class IkOptions:
    """How to solve.

    Attributes:
        tolerance: A position is reached within this share of the problem's length.
        angle_tolerance: An orientation, aim or pole is reached within this [rad].
        iterations: Most steps for one problem, restarts included.
        restarts: Most new starts where a descent ends short of the goals.
        seed: Of the new starts; the same seed gives the same poses.
        seconds: Most time for one problem [s]; 0 is no bound. With a bound, what is
            found depends on the machine.
        warm: Each problem starts where the one before it ended, as frames of a clip.
    """

    tolerance: float = 1e-6
    angle_tolerance: float = 1e-6
    iterations: int = 5000
    restarts: int = 200
    seed: int = 0
    seconds: float = 0.0
    warm: bool = False


def solve(
    problem: Problem,
    start: ArrayLike | None,
    targets: Targets,
    options: IkOptions | None = None,
    *,
    prefer: ArrayLike | None = None,
) -> IkResult:
    """Return poses that come as near to the goals as the joints and limits let them.

    Args:
        problem: E goals over a rig of Q coordinates.
        start: ``(Q,)`` for all, or ``(B, Q)``; None is the rest pose. Brought inside the
            limits first.
        targets: Of B problems.
        options: Tolerances, budget, seed.
        prefer: Pose ``(Q,)`` or ``(B, Q)`` that the problem's ``rest_weight`` draws
            to; None is the start.

    Raises:
        OptionError: Targets are missing, of another shape (IK010) or not finite
            (IK011); a start is of another shape (IK012) or not finite (IK013); an
            option makes no sense (IK014).

    Limits of the method: a goal that no descent reached is answered with the best pose
    found, which need not be the best there is.

    >>> from animtool.ik.goals import Goal
    >>> from animtool.ik.problem import build
    >>> from animtool.rig.skeleton import Joint, JointType, Rig
    >>> upper = Joint("upper", -1, JointType.PIN)
    >>> lower = Joint("lower", 0, JointType.PIN, translation=(1, 0, 0))
    >>> problem = build(Rig("arm", (upper, lower)), [Goal("lower", offset=(1, 0, 0))])
    >>> result = solve(problem, None, Targets(positions=[[[1, 1, 0]]]))
    >>> result.statuses[0], bool(result.positions.max() < 2e-6)
    (<IkStatus.CONVERGED: 'converged'>, True)
    """
    options = options or IkOptions()
    _check(options)
    packed = pack(targets, problem.goals)
    starts = _rows(problem, start, len(packed), "start")
    wished = starts if prefer is None else _rows(problem, prefer, len(packed), "prefer")
    chain = problem.chain
    packed[:, :, [0, 1, 2, 7, 8, 9, 10, 11, 12]] /= chain.length
    packed[:, :, 3:7] = so3.multiply(packed[:, :, 3:7], so3.conjugate(chain.goal_frames))
    solved, misses, reports, seconds = _kernels.solve_ik(
        chain.nodes,
        chain.numbers,
        chain.goals,
        chain.goal_numbers,
        chain.from_rig(starts),
        packed,
        chain.from_rig(wished),
        problem.rest_weight,
        options.tolerance,
        options.angle_tolerance,
        WARM_DAMPING if options.warm else COLD_DAMPING,
        options.iterations,
        options.restarts,
        options.seed,
        options.seconds,
        options.warm,
    )
    return IkResult(
        problem,
        chain.into_rig(solved, starts),
        tuple(_STATUSES[status] for status in reports[:, 0]),
        reports[:, 1],
        reports[:, 2],
        seconds,
        misses[:, :, 0] * chain.length,
        misses[:, :, 1],
        misses[:, :, 2],
        misses[:, :, 3],
    )


def _check(options: IkOptions) -> None:
    faults = [
        Fault("IK014", f"{name} must be more than 0, not {getattr(options, name)}")
        for name in ("tolerance", "angle_tolerance", "iterations")
        if not getattr(options, name) > 0
    ]
    faults += [
        Fault("IK014", f"{name} must be at least 0, not {getattr(options, name)}")
        for name in ("restarts", "seed", "seconds")
        if not getattr(options, name) >= 0
    ]
    if faults:
        raise OptionError(faults)


def _rows(
    problem: Problem, given: ArrayLike | None, batch: int, name: str
) -> FloatArray:
    """Return poses ``(B, Q)``, one for all repeated."""
    width = problem.coordinates
    rows = rest_pose(problem) if given is None else np.asarray(given, np.float64)
    if rows.shape not in {(width,), (batch, width)}:
        message = f"{name} must have shape ({width},) or ({batch}, {width})"
        raise OptionError(Fault("IK012", f"{message}, not {rows.shape}"))
    if not np.isfinite(rows).all():
        raise OptionError(Fault("IK013", f"{name} is not finite"))
    return np.array(np.broadcast_to(rows, (batch, width)))
