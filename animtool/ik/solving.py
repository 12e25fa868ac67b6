"""Solves IK problems with a suitable method."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import wraps
from typing import ParamSpec, TypeVar

import numpy as np

from animtool import _kernels
from animtool.core.array_types import ArrayLike, FloatArray
from animtool.core.errors import Fault, OptionError, listed
from animtool.core.loaded import check_loaded
from animtool.core.quantities import angle_text, length_text
from animtool.ik.chain import joint_steps
from animtool.ik.goals import Targets, pack
from animtool.ik.options import IkMethod, IkOptions
from animtool.ik.problem import Problem
from animtool.ik.result import IkResult, IkStatus
from animtool.ik.rig_solver import (
    CLOSED_FORM_METHODS,
    KernelSolution,
    build_solver,
    two_bone_obstacle,
)
from animtool.ik.sub_rig import with_mimics
from animtool.maths import so3
from animtool.rig.joints import local_from_coordinates
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.skeleton import JointType

P = ParamSpec("P")
Result = TypeVar("Result")


def checks_arguments(
    options_class: type,
) -> Callable[[Callable[P, Result]], Callable[P, Result]]:
    """Return a decorator that checks the types of problem, start, targets and options.

    The functions raise `TypeError` for an argument of another kind, or in the place of
    another.
    """

    def decorate(
        function: Callable[P, Result],
    ) -> Callable[P, Result]:
        name = function.__name__

        @wraps(function)
        def checked(*args: P.args, **kwargs: P.kwargs) -> Result:
            names = ("problem", "start", "targets", "options")
            values = dict(zip(names, args, strict=False)) | kwargs
            if "problem" in values:
                check_loaded(values["problem"], Problem, "problem")
            if isinstance(values.get("start"), Targets):
                message = f"start is Targets, not a pose; write {name}(problem, None, "
                raise TypeError(f"{message}targets) to start at the rest pose")
            if "targets" in values and "start" not in values:
                message = f"{name}() has no start; write {name}(problem, None, targets)"
                raise TypeError(f"{message} to start at the rest pose")
            if "targets" in values:
                check_loaded(values["targets"], Targets, "targets")
            if values.get("options") is not None:
                check_loaded(values["options"], options_class, "options")
            return function(*args, **kwargs)

        return checked

    return decorate


_KERNEL_STATUSES = (
    IkStatus.CONVERGED,
    IkStatus.NEAREST,
    IkStatus.BUDGET,
    IkStatus.NOT_FINITE,
    IkStatus.YIELDED,
    IkStatus.CONFLICT,
    IkStatus.STALLED,
)
# Decreasing weights that pull restarted poses towards the start.
PULL_WEIGHTS = (1e-2, 1e-3, 1e-4, 0.0)
# Values of joints that do not move may differ by this much [rad], [m].
FIXED_POSE_TOLERANCE = 1e-6
# Range of each option in the kernel.
OPTION_RANGES = {
    "iterations": (1, 2**31 - 1),
    "restarts": (0, 2**31 - 1),
    "seed": (0, 2**64 - 1),
}


@checks_arguments(IkOptions)
def solve(
    problem: Problem,
    start: ArrayLike | None,
    targets: Targets,
    options: IkOptions | None = None,
    *,
    prefer: ArrayLike | None = None,
) -> IkResult:
    """Return the poses nearest to the goals within joint limits.

    Args:
        problem: E goals over a rig of Q coordinates.
        start: ``(Q,)`` for all, or ``(B, Q)``; None is the problem's pose. Clamped to
            the limits. Joints that do not move have their values in the problem's pose.
        targets: Targets of B problems.
        options: Tolerances, budget, seed.
        prefer: Preferred pose ``(Q,)`` or ``(B, Q)``, weighted by the problem's
            ``rest_weight``; None is the start.

    With ``near``, a pose found by a restart is then pulled towards the preferred one as
    far as the goals leave it free, unless ``seconds`` is set.

    Raises:
        OptionError: Targets are missing, of another shape (IK010) or not finite
            (TGT007); a start is of another shape (IK012), not finite (IK013), or has
            other values than the problem's pose for joints above the goals that do not
            move (IK016); an option is invalid (IK014), or the method does not support
            this problem (IK015).

    Limits of the method: for a goal that no descent reached, the best pose found is
    returned, which need not be the global optimum.

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
    check_fixed_joints(problem, start)
    return solve_in_frame(problem, start, targets, options, prefer=prefer)


def solve_in_frame(
    problem: Problem,
    start: ArrayLike | None,
    targets: Targets,
    options: IkOptions | None = None,
    *,
    prefer: ArrayLike | None = None,
) -> IkResult:
    """Solve targets relative to the problem's pose, wherever starts have its frame."""
    options = options or IkOptions()
    raise_faults(option_faults(options))
    check_method(problem, options.method)
    packed_targets = pack(targets, problem.goals)
    starts = pose_rows(problem, start, len(packed_targets), "start")
    if prefer is not None:
        prefer = pose_rows(problem, prefer, len(packed_targets), "prefer")
    solver = build_solver(problem, options)
    solution = solver.solve(starts, packed_targets, prefer, returns_joint_poses=False)
    result = result_of_kernel(problem, solution)
    if options.near and options.method in CLOSED_FORM_METHODS | {IkMethod.DAMPED}:
        preferred_poses = starts if prefer is None else prefer
        return _pull_to_preferred(
            problem, packed_targets, preferred_poses, options, result
        )
    return result


def result_of_kernel(problem: Problem, solution: KernelSolution) -> IkResult:
    """Convert the output of a kernel solver to a result."""
    (
        coordinates,
        misses,
        reports,
        seconds,
        reached,
        bone_scales,
        world_positions,
        linear,
    ) = solution
    if problem.rig.is_driven:
        coordinates = with_mimics(problem.rig, coordinates, problem.joints)
        world_positions = world_positions[:0]
    result = IkResult(
        problem,
        coordinates,
        tuple([_KERNEL_STATUSES[status] for status in reports[:, 0].tolist()]),
        reports[:, 1],
        reports[:, 2],
        seconds,
        misses,
        reached,
        bone_scales,
    )
    if not len(world_positions):
        return result
    return result.with_world(WorldTransforms(world_positions, linear))


def pack_for_chain(problem: Problem, targets: Targets) -> FloatArray:
    """Return targets packed in the chain's units and frames ``(B, E, W)``."""
    packed_targets = pack(targets, problem.goals)
    chain = problem.chain
    _kernels.to_chain_targets(packed_targets, chain.goal_rotations, chain.length)
    return packed_targets


def _pull_to_preferred(
    problem: Problem,
    packed_targets: FloatArray,
    preferred_poses: FloatArray,
    options: IkOptions,
    result: IkResult,
) -> IkResult:
    """Pull poses found by restarts towards preferred ones while goals stay reached.

    Otherwise redundant joints would be as random as the starts.
    """
    is_redundant = problem.degrees > problem.rows
    restarted_rows = np.flatnonzero((result.descents > 1) & result.reached.all(axis=1))
    has_preference = problem.rest_weight > 0 or options.seconds > 0
    if not is_redundant or has_preference or not len(restarted_rows):
        return result
    pull_options = replace(options, method=IkMethod.DAMPED, restarts=0)
    targets, preferred_poses = (
        packed_targets[restarted_rows],
        preferred_poses[restarted_rows],
    )
    poses, pulled_result = result.coordinates[restarted_rows], result
    for weight in PULL_WEIGHTS:
        solver = build_solver(replace(problem, rest_weight=weight), pull_options)
        solution = solver.solve(
            poses, targets, preferred_poses, returns_joint_poses=False
        )
        pulled_result = result_of_kernel(problem, solution)
        poses = pulled_result.coordinates
    chain = problem.chain
    preferred_coordinates = chain.from_rig(preferred_poses)
    distance_before, distance_after = (
        np.linalg.norm(joint_steps(chain, preferred_coordinates, q), axis=1)
        for q in (
            chain.from_rig(result.coordinates[restarted_rows]),
            chain.from_rig(poses),
        )
    )
    is_improved = pulled_result.reached.all(axis=1) & (distance_after < distance_before)
    result.coordinates[restarted_rows[is_improved]] = poses[is_improved]
    result.misses[restarted_rows[is_improved]] = pulled_result.misses[is_improved]
    return result


def option_faults(options: IkOptions) -> dict[str, list[Fault]]:
    """Return faults that do not depend on the problem, by option."""
    faults_by_option: dict[str, list[Fault]] = {}
    for name in ("tolerance", "angle_tolerance"):
        value = getattr(options, name)
        faults_by_option[name] = _fault_unless(value > 0, name, "more than 0", value)
    for name, (low, high) in OPTION_RANGES.items():
        value = getattr(options, name)
        is_valid = bool(isinstance(value, (int, np.integer)) and low <= value <= high)
        rule = f"a whole number from {low} to {high}"
        faults_by_option[name] = _fault_unless(is_valid, name, rule, value)
    seconds = options.seconds
    faults_by_option["seconds"] = _fault_unless(
        seconds >= 0, "seconds", "at least 0", seconds
    )
    return faults_by_option


def _fault_unless(is_valid: bool, name: str, rule: str, value: float) -> list[Fault]:
    """Return a fault of an option if it is invalid, else no fault."""
    message = f"{name} must be {rule}, not {value}"
    return [] if is_valid else [Fault("IK014", message)]


def raise_faults(faults_by_option: Mapping[str, list[Fault]]) -> None:
    """Raise all faults in the options together."""
    faults = [fault for faults in faults_by_option.values() for fault in faults]
    if faults:
        raise OptionError(faults)


def pose_rows(
    problem: Problem, pose: ArrayLike | None, batch_size: int, argument_name: str
) -> FloatArray:
    """Return poses ``(B, Q)``, by default the problem's; a single pose is repeated."""
    coordinate_count = problem.coordinates
    poses = problem.pose if pose is None else np.asarray(pose, np.float64)
    if poses.shape not in {(coordinate_count,), (batch_size, coordinate_count)}:
        message = f"{argument_name} must have shape ({coordinate_count},) or "
        message += f"({batch_size}, {coordinate_count})"
        raise OptionError(Fault("IK012", f"{message}, not {poses.shape}"))
    if not np.isfinite(poses).all():
        raise OptionError(Fault("IK013", f"{argument_name} is not finite"))
    repeated_rows = np.empty((batch_size, coordinate_count))
    repeated_rows[:] = poses
    return repeated_rows


def check_fixed_joints(problem: Problem, start: ArrayLike | None) -> None:
    """Raise if a joint that does not move has another value in a start (IK016).

    A start of another shape or not finite is refused by the solve.
    """
    rig, columns = problem.rig, problem.fixed_columns
    if start is None or not columns.size:
        return
    rows = np.atleast_2d(np.asarray(start, np.float64))
    if rows.ndim != 2 or rows.shape[1] != problem.coordinates:
        return
    offsets = np.abs(rows.take(columns, axis=-1) - problem.pose[columns])
    is_equal = offsets.max(initial=0.0) <= FIXED_POSE_TOLERANCE
    if is_equal or not np.isfinite(rows).all():
        return
    # Several coordinates may be one rotation.
    joints = problem.fixed_joints
    poses, pose = (
        local_from_coordinates(rig, each) for each in (rows, problem.pose[None])
    )
    distances = np.linalg.norm(poses.translations - pose.translations, axis=-1)
    angles = so3.angle_between(poses.rotations, pose.rotations)
    differences = np.maximum(distances, angles)[:, joints]
    if differences.max() <= FIXED_POSE_TOLERANCE:
        return
    row, i = divmod(int(differences.argmax()), len(joints))
    distance, angle = distances[row, joints[i]], angles[row, joints[i]]
    amount = angle_text(math.degrees(angle))
    if distance > angle:
        amount = length_text(distance)
    message = f"{rig.names[joints[i]]!r} does not move, but in start it is {amount} "
    message += "from where the pose of the problem has it"
    hint = "write build(..., pose=start)"
    if np.ptp(rows.take(columns, axis=-1), axis=0).max() > FIXED_POSE_TOLERANCE:
        hint = "solve each start with its own problem, as a Session does"
    raise OptionError(Fault("IK016", message, hint=hint))


def supported_methods(problem: Problem) -> list[IkMethod]:
    """Return the methods that support a problem.

    >>> from animtool.ik.goals import Goal
    >>> from animtool.ik.problem import build
    >>> from animtool.rig.skeleton import Joint, JointType, Rig
    >>> door = Rig("door", (Joint("hinge", -1, JointType.PIN),))
    >>> problem = build(door, [Goal("hinge", position=0.0, orientation=1.0)])
    >>> [str(method) for method in supported_methods(problem)]
    ['auto', 'damped', 'gradient', 'newton', 'ccd']
    """
    return [method for method in IkMethod if _method_obstacle(problem, method) is None]


def check_method(problem: Problem, method: IkMethod) -> None:
    """Raise if a method does not support a problem."""
    if method not in set(IkMethod):
        hint = f"methods for this problem: {', '.join(supported_methods(problem))}"
        raise OptionError(Fault("IK015", f"unknown method {method!r}", hint=hint))
    obstacle = _method_obstacle(problem, method)
    if obstacle is None:
        return
    hint = f"methods for this problem: {', '.join(supported_methods(problem))}"
    if method == IkMethod.FABRIK and _translating_joints(problem):
        hint += "; or choose joints that do not translate, or a root below them"
    raise OptionError(Fault("IK015", f"{method} {obstacle}", hint=hint))


def _method_obstacle(problem: Problem, method: IkMethod) -> str | None:
    """Return why a method does not support a problem; None if it does."""
    if method in {IkMethod.AUTO, IkMethod.DAMPED}:
        return None
    if method == IkMethod.TWO_BONE:
        reason = two_bone_obstacle(problem)
        return reason and f"does not apply: {reason}"
    simple_methods = {IkMethod.CCD, IkMethod.FABRIK}
    goal_kinds = [kind for goal in problem.goals for kind in goal.kinds]
    sliding_names = listed(_translating_joints(problem))
    has_priorities = bool(problem.chain.goal_nodes[:, 3].any())
    rules = [
        (
            has_priorities,
            {*simple_methods, IkMethod.GRADIENT, IkMethod.NEWTON},
            "ignores priorities",
        ),
        (problem.rest_weight > 0, simple_methods, "ignores the preferred pose"),
        *(
            (not kind.supports_ccd, simple_methods, f"ignores {kind.targets_field}")
            for kind in goal_kinds
        ),
        (
            any(kind.depends_on_rotation for kind in goal_kinds),
            {IkMethod.FABRIK},
            "is for positions only",
        ),
        (
            bool(sliding_names),
            {IkMethod.FABRIK},
            f"is for joints that only rotate, but {sliding_names} may translate",
        ),
    ]
    matching_rules = (
        obstacle
        for is_applicable, methods, obstacle in rules
        if is_applicable and method in methods
    )
    return next(matching_rules, None)


def _translating_joints(problem: Problem) -> list[str]:
    """Return the names of the problem's joints that translate."""
    rig = problem.rig
    kinds = {JointType.FREE, JointType.PRISMATIC}
    return [n for n in problem.joints if rig.joints[rig.index(n)].type in kinds]
