"""From a problem, starts and targets to poses, by a method that serves it."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from animtool import _kernels
from animtool.core.array_types import ArrayLike, BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, OptionError, listed
from animtool.core.record import dataclass
from animtool.ik.chain import difference
from animtool.ik.goals import Targets, by_unit, pack
from animtool.ik.limbs import Extension, extend
from animtool.ik.options import IkMethod
from animtool.ik.problem import Problem, rest_pose
from animtool.ik.result import IkResult, IkStatus
from animtool.ik.sub_rig import following
from animtool.ik.two_bone import active_goals, fits, misfit, solve_limb
from animtool.rig.skeleton import JointType

# Numbers of the methods in the kernel.
KERNEL_METHODS = {
    IkMethod.AUTO: 0,
    IkMethod.DAMPED: 0,
    IkMethod.TWO_BONE: 0,
    IkMethod.GRADIENT: 1,
    IkMethod.NEWTON: 2,
    IkMethod.CCD: 3,
    IkMethod.FABRIK: 4,
}
_STATUSES = (
    IkStatus.CONVERGED,
    IkStatus.NEAREST,
    IkStatus.BUDGET,
    IkStatus.NOT_FINITE,
    IkStatus.YIELDED,
    IkStatus.CONFLICT,
    IkStatus.STALLED,
)
# Methods that may take the closed form.
_CLOSED = {IkMethod.AUTO, IkMethod.TWO_BONE}
# How much the start draws poses that came of new ones, one after the other.
DRAWN = (1e-2, 1e-3, 1e-4, 0.0)
# Damping of the first step: far from the goals, and beside them.
COLD_DAMPING, WARM_DAMPING = 1e-3, 1e-6
# The least and the most of each, as the kernel has room for.
COUNTS = {
    "iterations": (1, 2**31 - 1),
    "restarts": (0, 2**31 - 1),
    "seed": (0, 2**64 - 1),
}


@dataclass(frozen=True, slots=True)
class IkOptions:
    """How to solve.

    Attributes:
        method: ``auto`` takes the closed form where a limb of two bones fits it, else
            damped least squares; see `IkMethod`.
        tolerance: A position is reached within this share of the problem's length.
        angle_tolerance: An orientation, aim or pole is reached within this [rad].
        iterations: Most steps for one problem, restarts included.
        restarts: Most new starts where damped steps end short of the goals.
        seed: Of the new starts; the same seed gives the same poses.
        seconds: Most time for one problem [s]; 0 is no bound. With a bound, what is
            found depends on the machine.
        ordered: The problems are frames of a clip. One that ends as far from its goals
            as the one before it is not searched all over again.
        warm: They also start where the one before ended, but for the first.
        near: Poses that came of new starts are then drawn to those preferred, while
            goals stay met; that takes longer than finding them.
    """

    method: IkMethod = IkMethod.AUTO
    tolerance: float = 1e-6
    angle_tolerance: float = 1e-6
    iterations: int = 5000
    restarts: int = 200
    seed: int = 0
    seconds: float = 0.0
    ordered: bool = False
    warm: bool = False
    near: bool = False


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
        start: ``(Q,)`` for all, or ``(B, Q)``; None is the rest pose. Brought inside
            the limits first.
        targets: Of B problems.
        options: Tolerances, budget, seed.
        prefer: Pose ``(Q,)`` or ``(B, Q)`` that the problem's ``rest_weight`` draws
            to; None is the start.

    A pose that came of a new start is then drawn to the one preferred, as far as the
    goals leave it free, unless there is a bound of ``seconds``.

    Raises:
        OptionError: Targets are missing, of another shape (IK010) or not finite
            (TGT007); a start is of another shape (IK012) or not finite (IK013); an
            option makes no sense (IK014), or the method is not for this problem
            (IK015).

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
    check_method(problem, options.method)
    packed = chain_targets(problem, targets)
    chain = problem.chain
    starts = pose_rows(problem, start, len(packed), "start")
    own = wished = chain.from_rig(starts)
    if prefer is not None:
        wished = chain.from_rig(pose_rows(problem, prefer, len(packed), "prefer"))
    asked = _Asked(packed, extend(problem.limbs, packed), own, wished)
    if options.method in _CLOSED and fits(problem):
        found = _limbs(problem, asked, options)
    else:
        found = _damped(problem, asked, options)
    if options.near and options.method in _CLOSED | {IkMethod.DAMPED}:
        _settle(problem, asked, options, found)
    reached = _reached(found, options)
    _explain(found, asked, reached)
    return IkResult(
        problem,
        following(
            problem.rig, chain.into_rig(found.coordinates, starts), problem.joints
        ),
        tuple(_STATUSES[status] for status in found.reports[:, 0].tolist()),
        found.reports[:, 1],
        found.reports[:, 2],
        found.seconds,
        found.misses * by_unit(chain.length, 1.0),
        reached,
        asked.limbs.scales,
    )


def chain_targets(problem: Problem, targets: Targets) -> FloatArray:
    """Return targets of a problem's goals as its chain takes them ``(B, E, W)``."""
    packed = pack(targets, problem.goals)
    chain = problem.chain
    _kernels.place_ik_targets(packed, chain.goal_frames, chain.length)
    return packed


@dataclass(frozen=True, slots=True)
class _Solved:
    """What a solver found: chain coordinates, misses, reports, seconds."""

    coordinates: FloatArray
    misses: FloatArray
    reports: IntArray
    seconds: FloatArray


@dataclass(frozen=True, slots=True)
class _Asked:
    """What B problems ask of the chain, as the solvers take it."""

    targets: FloatArray
    limbs: Extension
    starts: FloatArray
    wished: FloatArray

    def __getitem__(self, rows: IntArray) -> _Asked:
        """Return some of the problems."""
        targets, limbs = self.targets[rows], self.limbs[rows]
        return _Asked(targets, limbs, self.starts[rows], self.wished[rows])


def _explain(solved: _Solved, asked: _Asked, reached: BoolArray) -> None:
    """Say of targets that were brought into reach whether they were out of it."""
    status = solved.reports[:, 0]
    short = (status == _STATUSES.index(IkStatus.CONVERGED)) & ~reached.all(axis=1)
    only_eased = (reached | asked.limbs.eased).all(axis=1)
    status[short] = _STATUSES.index(IkStatus.NEAREST)
    status[short & only_eased] = _STATUSES.index(IkStatus.YIELDED)


def _damped(problem: Problem, asked: _Asked, options: IkOptions) -> _Solved:
    chain = problem.chain
    solved = _kernels.solve_ik(
        *chain.arrays,
        starts=asked.starts,
        targets=asked.targets,
        sought=asked.limbs.sought,
        stretches=asked.limbs.scales,
        rests=asked.wished,
        rest_weight=problem.rest_weight,
        length_tolerance=options.tolerance,
        angle_tolerance=options.angle_tolerance,
        damping=WARM_DAMPING if options.warm else COLD_DAMPING,
        iterations=options.iterations,
        restarts=options.restarts,
        seed=options.seed,
        seconds=options.seconds,
        ordered=options.ordered,
        warm=options.warm,
        method=KERNEL_METHODS[options.method],
    )
    return _Solved(*solved)


def _reached(solved: _Solved, options: IkOptions) -> BoolArray:
    """Return which goals are reached ``(B, E)``."""
    tolerances = by_unit(options.tolerance, options.angle_tolerance)
    return np.asarray((solved.misses <= tolerances).all(axis=2), np.bool_)


def _settle(
    problem: Problem, asked: _Asked, options: IkOptions, solved: _Solved
) -> None:
    """Draw poses that came of new starts to those preferred, while goals stay met.

    What the goals leave free would else stay as random as the starts were.
    """
    redundant = problem.degrees > problem.rows
    again = (solved.reports[:, 2] > 1) & _reached(solved, options).all(axis=1)
    rows = np.flatnonzero(again)
    if not redundant or problem.rest_weight > 0 or options.seconds > 0 or not len(rows):
        return
    near = replace(options, method=IkMethod.DAMPED, restarts=0)
    drawn = _Solved(*(getattr(solved, field.name)[rows] for field in fields(_Solved)))
    for weight in DRAWN:
        here = replace(asked[rows], starts=drawn.coordinates)
        drawn = _damped(replace(problem, rest_weight=weight), here, near)
    wished = asked.wished[rows]
    before, after = (
        np.linalg.norm(difference(problem.chain, wished, poses), axis=1)
        for poses in (solved.coordinates[rows], drawn.coordinates)
    )
    kept = _reached(drawn, options).all(axis=1) & (after < before)
    solved.coordinates[rows[kept]] = drawn.coordinates[kept]
    solved.misses[rows[kept]] = drawn.misses[kept]


def _limbs(problem: Problem, asked: _Asked, options: IkOptions) -> _Solved:
    """Solve limbs in closed form, and those that their limits stop by descent."""
    limbs = solve_limb(
        problem, asked.starts, asked.targets, asked.limbs.sought, asked.limbs.scales
    )
    reports = np.zeros((len(asked.starts), 3), np.int64)
    seconds = np.zeros(len(reports))
    closed_form = _Solved(limbs.coordinates, limbs.misses, reports, seconds)
    rest = np.flatnonzero(~limbs.valid)
    if len(rest):
        other = _damped(problem, asked[rest], options)
        closed_form.coordinates[rest] = other.coordinates
        closed_form.misses[rest] = other.misses
        closed_form.reports[rest] = other.reports
        closed_form.seconds[rest] = other.seconds
    if options.warm:
        _stay(closed_form, ~np.logical_or(*active_goals(problem, asked.targets)))
    return closed_form


def _stay(solved: _Solved, idle: BoolArray) -> None:
    """Leave limbs of which a frame asks nothing where the last frame left them."""
    rows = np.arange(len(idle))
    last = np.maximum.accumulate(np.where(idle, -1, rows))
    solved.coordinates[last >= 0] = solved.coordinates[last[last >= 0]]


def option_faults(options: IkOptions) -> dict[str, list[Fault]]:
    """Return what makes no sense whatever the problem is, by option."""
    faults: dict[str, list[Fault]] = {}
    for name in ("tolerance", "angle_tolerance"):
        value = getattr(options, name)
        faults[name] = _unless(value > 0, name, "more than 0", value)
    for name, (low, most) in COUNTS.items():
        value = getattr(options, name)
        good = bool(isinstance(value, (int, np.integer)) and low <= value <= most)
        span = f"a whole number from {low} to {most}"
        faults[name] = _unless(good, name, span, value)
    good = options.seconds >= 0
    faults["seconds"] = _unless(good, "seconds", "at least 0", options.seconds)
    return faults


def _unless(good: bool, name: str, rule: str, value: float) -> list[Fault]:
    """Return the fault of an option that is not good."""
    message = f"{name} must be {rule}, not {value}"
    return [] if good else [Fault("IK014", message)]


def _check(options: IkOptions) -> None:
    faults = [
        fault for of_option in option_faults(options).values() for fault in of_option
    ]
    if faults:
        raise OptionError(faults)


def pose_rows(
    problem: Problem, pose: ArrayLike | None, batch: int, name: str
) -> FloatArray:
    """Return poses ``(B, Q)``, one for all repeated."""
    width = problem.coordinates
    rows = rest_pose(problem) if pose is None else np.asarray(pose, np.float64)
    if rows.shape not in {(width,), (batch, width)}:
        message = f"{name} must have shape ({width},) or ({batch}, {width})"
        raise OptionError(Fault("IK012", f"{message}, not {rows.shape}"))
    if not np.isfinite(rows).all():
        raise OptionError(Fault("IK013", f"{name} is not finite"))
    whole = np.empty((batch, width))
    whole[:] = rows
    return whole


def serving(problem: Problem) -> list[IkMethod]:
    """Return the methods that can serve a problem.

    >>> from animtool.ik.goals import Goal
    >>> from animtool.ik.problem import build
    >>> from animtool.rig.skeleton import Joint, JointType, Rig
    >>> door = Rig("door", (Joint("hinge", -1, JointType.PIN),))
    >>> problem = build(door, [Goal("hinge", position=0.0, orientation=1.0)])
    >>> [str(method) for method in serving(problem)]
    ['auto', 'damped', 'gradient', 'newton', 'ccd']
    """
    return [method for method in IkMethod if _obstacle(problem, method) is None]


def check_method(problem: Problem, method: IkMethod) -> None:
    """Raise where a method cannot serve a problem."""
    if method not in set(IkMethod):
        hint = f"methods for this problem: {', '.join(serving(problem))}"
        raise OptionError(Fault("IK015", f"unknown method {method!r}", hint=hint))
    obstacle = _obstacle(problem, method)
    if obstacle is None:
        return
    hint = f"methods for this problem: {', '.join(serving(problem))}"
    if method == IkMethod.FABRIK and _sliding(problem):
        hint += "; or choose joints that do not translate, or a root below them"
    raise OptionError(Fault("IK015", f"{method} {obstacle}", hint=hint))


def _obstacle(problem: Problem, method: IkMethod) -> str | None:
    """Return what of a problem a method cannot serve."""
    if method in {IkMethod.AUTO, IkMethod.DAMPED}:
        return None
    if method == IkMethod.TWO_BONE:
        reason = misfit(problem)
        return reason and f"does not apply: {reason}"
    plain = {IkMethod.CCD, IkMethod.FABRIK}
    kinds = [kind for goal in problem.goals for kind in goal.kinds]
    slides = _sliding(problem)
    levels = bool(problem.chain.goals[:, 3].any())
    rules = [
        (levels, {*plain, IkMethod.GRADIENT, IkMethod.NEWTON}, "ignores priorities"),
        (problem.rest_weight > 0, plain, "ignores the preferred pose"),
        *((not kind.pulls, plain, f"ignores {kind.targets}") for kind in kinds),
        (
            any(kind.turning for kind in kinds),
            {IkMethod.FABRIK},
            "is for positions only",
        ),
        (bool(slides), {IkMethod.FABRIK}, _stiff(slides)),
    ]
    reasons = (why for holds, methods, why in rules if holds and method in methods)
    return next(reasons, None)


def _sliding(problem: Problem) -> list[str]:
    """Return the names of the problem's joints that travel."""
    rig = problem.rig
    kinds = {JointType.FREE, JointType.PRISMATIC}
    return [n for n in problem.joints if rig.joints[rig.index(n)].type in kinds]


def _stiff(sliding: list[str]) -> str:
    return f"is for joints that only rotate, but {listed(sliding)} may translate"
