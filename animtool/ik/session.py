"""Solves the same goals pose by pose, as in a viewer's or a script's loop."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from animtool.core.array_types import ArrayLike, FloatArray
from animtool.core.errors import Fault, OptionError, excerpt, listed, refuse
from animtool.core.names import name_hint
from animtool.core.record import dataclass
from animtool.ik.goals import (
    GOAL_KINDS,
    TARGET_COLUMNS,
    WEIGHT_COLUMNS,
    Goal,
    Targets,
    pack,
)
from animtool.ik.options import IkOptions
from animtool.ik.problem import Problem, build
from animtool.ik.result import IkResult
from animtool.ik.rig_solver import ClosedForm, build_solver, closed_form
from animtool.ik.solving import (
    option_faults,
    pose_rows,
    raise_faults,
    result_of_kernel,
    solve,
)

if TYPE_CHECKING:
    from animtool import _kernels
    from animtool.rig.skeleton import Rig

# Differences below are rounding [rad], [m].
POSE_TOLERANCE = 1e-12
# Kinds of a plain joint goal: a position, a rotation, or both.
JOINT_KINDS = (GOAL_KINDS[0], GOAL_KINDS[1])
# The goals of a call in order, each with a mask of its kinds.
RequestedKinds: TypeAlias = tuple[tuple[str, tuple[bool, ...]], ...]


@dataclass(frozen=True, slots=True)
class _PackedProblem:
    """A problem with its kernel solver and a target buffer that each call fills."""

    problem: Problem
    solver: _kernels.RigSolver
    has_branches: bool
    targets: FloatArray  # packed target buffer ``(1, E, W)``
    target_views: tuple[FloatArray, ...]  # views into the buffer, one per used part

    def fits(self, pose: FloatArray) -> bool:
        """Return whether a pose ``(Q,)`` leaves the static joints where they are.

        An invalid pose fits: the solve refuses it.
        """
        columns, problem_pose = self.problem.fixed_columns, self.problem.pose
        if pose is problem_pose or not columns.size or pose.shape != problem_pose.shape:
            return True
        offsets = np.abs(pose.take(columns) - problem_pose.take(columns))
        return bool(offsets.max() <= POSE_TOLERANCE) or not np.isfinite(pose).all()


class Session:
    """Goals of a rig that are solved repeatedly, one pose per call.

    The first call with a set of goals builds their problem; later calls only fill in
    the targets. Poses, statuses and misses equal those of `solve` bit for bit.

    With joint drivers, or ``near`` in the options, each call is a call of `solve`.

    Args:
        rig: J joints, Q coordinates.
        goals: Names of chains of the rig, whose tips reach, or of joints, with targets
            for position, rotation, or both; or a `Goal` for anything else.
        joints: Names of the joints that may move; None selects every joint that moves a
            goal.
        pose: Coordinates ``(Q,)`` of the joints that do not move, see `build`.
        options: Tolerances, budget, seed.
        rest_weight: Weight of the preferred pose, see `build`.

    Raises:
        OptionError: No goals (IK006), a duplicate goal (IK006), a joint or
            chain that the rig lacks (TGT001), or an invalid option (IK014).

    >>> from animtool.rig.skeleton import Joint, JointType, Rig
    >>> upper = Joint("upper", -1, JointType.PIN)
    >>> lower = Joint("lower", 0, JointType.PIN, translation=(1, 0, 0))
    >>> rig = Rig("arm", (upper, lower, Joint("tip", 1, translation=(1, 0, 0))))
    >>> session = Session(rig, "tip", joints=["upper", "lower"])
    >>> result = session.solve(tip=[1, 1, 0])
    >>> result.world().positions[0, 2].round(6).tolist()
    [1.0, 1.0, 0.0]
    >>> str(session.solve(tip=[1, 1.1, 0], start=result.coordinates[0]).statuses[0])
    'converged'
    """

    def __init__(
        self,
        rig: Rig,
        *goals: str | Goal,
        joints: Collection[str] | None = None,
        pose: ArrayLike | None = None,
        options: IkOptions | None = None,
        rest_weight: float = 0.0,
    ) -> None:
        """Store the rig, goals and options that all calls share."""
        self.rig = rig
        self.options = options or IkOptions()
        raise_faults(option_faults(self.options))
        self._joints = None if joints is None else tuple(joints)
        self._pose, self._rest_weight = pose, rest_weight
        self._goals = _goals_by_name(rig, goals, self._joints or ())
        self._packed_problems: dict[RequestedKinds, _PackedProblem] = {}

    def __repr__(self) -> str:
        """Return the rig's name and the goals."""
        return f"<Session of {self.rig.name!r}: {listed(list(self._goals))}>"

    def solve(
        self,
        targets: Mapping[str, Any] | None = None,
        /,
        *,
        start: ArrayLike | None = None,
        prefer: ArrayLike | None = None,
        **named: Any,
    ) -> IkResult:
        """Return the pose nearest to the goals within joint limits.

        Args:
            targets: Targets by goal name, for names that are not Python identifiers.
            start: Pose ``(Q,)``, also of the joints that do not move; None is the
                ``pose`` of the session. A call in which those have other values than
                in the call before takes as long as a first one.
            prefer: Preferred pose ``(Q,)`` of ``rest_weight``; None is the start.
            named: Targets by keyword. For a joint a world point ``(3,)`` [m], or a pair
                of that and a quaternion x y z w, either of them None; for a `Goal` the
                values of its kinds in their order, or the value if it has one kind.
                Goals without a target are inactive.

        Raises:
            OptionError: As for `build` and `solve`.
        """
        values_by_goal = self._values_by_goal(targets, named)
        packed_problem, buffer = self._fill_buffer(values_by_goal, start)
        problem, solver = packed_problem.problem, packed_problem.solver
        if self.options.near or self.rig.is_driven:
            buffered_targets = _targets_of_buffer(buffer)
            start = self._pose if start is None else start
            return solve(problem, start, buffered_targets, self.options, prefer=prefer)
        start_rows = np.asarray(self._pose if start is None else start, np.float64)[
            None
        ]
        preferred_rows = None
        if prefer is not None:
            preferred_rows = np.asarray(prefer, np.float64)[None]
        try:
            solution = solver.solve(
                start_rows, buffer, preferred_rows, returns_joint_poses=True
            )
        except (TypeError, ValueError):
            # Invalid numbers or shapes: packing again raises the full error.
            buffer = pack(_targets_of_buffer(buffer), problem.goals)
            start_rows = pose_rows(problem, start, 1, "start")
            if prefer is not None:
                preferred_rows = pose_rows(problem, prefer, 1, "prefer")
            solution = solver.solve(
                start_rows, buffer, preferred_rows, returns_joint_poses=True
            )
        return result_of_kernel(problem, solution)

    def branches(
        self,
        targets: Mapping[str, Any] | None = None,
        /,
        *,
        start: ArrayLike | None = None,
        **named: Any,
    ) -> FloatArray:
        """Return all poses ``(N, Q)`` with which an arm's end reaches a target pose.

        Within the limits, the nearest to ``start`` first; angles that are free, where
        axes align, are those of the start.

        Raises:
            OptionError: The arm has no closed form (IK015): six pins in a row, of which
                the last three meet or the middle ones are parallel; and as for `solve`.
        """
        values_by_goal = self._values_by_goal(targets, named)
        packed_problem, target_buffer = self._fill_buffer(values_by_goal, start)
        problem = packed_problem.problem
        if not packed_problem.has_branches:
            goal_names = ", ".join(values_by_goal)
            message = f"{goal_names} ends no arm whose poses have a closed form"
            hint = "six pins in a row, the last three meeting in a point or the second "
            hint += "to fourth parallel, with a position and a rotation to reach"
            raise OptionError(Fault("IK015", message, hint=hint))
        start_pose = np.asarray(self._pose if start is None else start, np.float64)
        try:
            return packed_problem.solver.branches(start_pose, target_buffer[0])
        except (TypeError, ValueError):
            # As in `solve`.
            repacked_targets = pack(_targets_of_buffer(target_buffer), problem.goals)
            start_pose = pose_rows(problem, start, 1, "start")[0]
            return packed_problem.solver.branches(start_pose, repacked_targets[0])

    def _values_by_goal(
        self, targets: object, named: Mapping[str, Any]
    ) -> Mapping[str, Any]:
        """Return the targets of both arguments by the names of their goals."""
        if targets is None:
            return named
        if not isinstance(targets, Mapping):
            name = next(iter(self._goals), "GOAL")
            message = f"targets is a {type(targets).__name__}, not a mapping; write "
            raise TypeError(f"{message}{{{name!r}: TARGET}}")
        return {**targets, **named}

    def _fill_buffer(
        self, values_by_goal: Mapping[str, Any], start: ArrayLike | None
    ) -> tuple[_PackedProblem, FloatArray]:
        """Fill the target buffer of a call's goals; return it after their problem.

        Problems are kept, and used again by calls with goals of the same kinds, while
        the joints that do not move have the same values in the start.
        """
        requested_kinds: list[tuple[str, tuple[bool, ...]]] = []
        target_values: list[Any] = []
        for name, value in values_by_goal.items():
            if name not in self._goals:
                message = f"the session has no goal {excerpt(name)}"
                refuse("TGT001", message, hint=name_hint(name, self._goals))
            goal_targets, kind_mask = _split_targets(name, self._goals[name], value)
            requested_kinds.append((name, kind_mask))
            target_values += goal_targets
        packed_problem = self._packed_problems.get(key := tuple(requested_kinds))
        if packed_problem is None:
            packed_problem = self._pack_problem(key, self._pose)
            self._pose = packed_problem.problem.pose
        try:
            pose = np.asarray(self._pose if start is None else start, np.float64)
        except (TypeError, ValueError):
            pose = packed_problem.problem.pose  # refused by the solve
        if not packed_problem.fits(pose):
            packed_problem = self._pack_problem(key, pose)
        self._packed_problems[key] = packed_problem
        try:
            for view, target in zip(
                packed_problem.target_views, target_values, strict=True
            ):
                if len(target) != len(view):
                    raise ValueError  # noqa: TRY301 - of the same kind as numpy's
                view[:] = target
        except (TypeError, ValueError) as error:
            raise _shape_error(values_by_goal) from error
        return packed_problem, packed_problem.targets

    def _pack_problem(
        self, requested_kinds: RequestedKinds, pose: ArrayLike | None
    ) -> _PackedProblem:
        """Return the packed problem of the given goals, with a target buffer."""
        goals = [
            self._goals[name] or _goal_of_call(self.rig, name, kind_mask)
            for name, kind_mask in requested_kinds
        ]
        problem = build(
            self.rig,
            goals,
            joints=self._joints,
            pose=pose,
            rest_weight=self._rest_weight,
        )
        target_buffer = np.zeros((1, len(goals), WEIGHT_COLUMNS.stop))
        target_buffer[:, :, TARGET_COLUMNS["orientation"].stop - 1] = 1.0
        target_buffer[:, :, WEIGHT_COLUMNS] = 1.0
        views = [
            target_buffer[0, e, TARGET_COLUMNS[kind.name]]
            for e, goal in enumerate(goals)
            for kind in goal.kinds
        ]
        solver = build_solver(problem, self.options)
        has_branches = closed_form(problem) is ClosedForm.ARM
        return _PackedProblem(
            problem, solver, has_branches, target_buffer, tuple(views)
        )


def _goals_by_name(
    rig: Rig, goals: Sequence[str | Goal], joints: Sequence[str]
) -> dict[str, Goal | None]:
    """Return goals by name; None where each call decides which parts are solved."""
    if not goals:
        raise OptionError(Fault("IK006", "there are no goals"))
    goals_by_name: dict[str, Goal | None] = {}
    faults = []
    for goal in goals:
        name = goal if isinstance(goal, str) else goal.joint
        if name in goals_by_name:
            faults.append(Fault("IK006", f"{name!r} has two goals"))
        goals_by_name[name] = None if isinstance(goal, str) else goal
    chain_names = [chain.name for chain in rig.chains]
    for name, named_goal in goals_by_name.items():
        allowed_names = rig.names if named_goal else [*chain_names, *rig.names]
        faults += _unknown_joint_faults(rig, name, allowed_names)
    for name in joints:
        faults += _unknown_joint_faults(rig, name, rig.names)
    if faults:
        raise OptionError(faults)
    return goals_by_name


def _unknown_joint_faults(
    rig: Rig, name: str, allowed_names: Sequence[str]
) -> list[Fault]:
    """Return a fault unless a name is one of the allowed names (TGT001)."""
    if name in allowed_names:
        return []
    message = f"no joint of {rig.name!r} is {excerpt(name)}"
    return [Fault("TGT001", message, hint=name_hint(name, allowed_names))]


def _split_targets(
    goal_name: str, goal: Goal | None, goal_value: Any
) -> tuple[Sequence[Any], tuple[bool, ...]]:
    """Split the value of a goal into targets, and a mask of the kinds they set."""
    if goal is None and (not isinstance(goal_value, tuple) or len(goal_value) == 3):
        return (goal_value,), (True, False)
    kinds = JOINT_KINDS if goal is None else goal.kinds
    if len(kinds) == 1:
        return (goal_value,), (True,)
    if not isinstance(goal_value, (tuple, list)) or len(goal_value) != len(kinds):
        raise _shape_error({goal_name: goal_value})
    kind_mask = tuple([target is not None for target in goal_value])
    if goal is not None and not all(kind_mask):
        raise _shape_error({goal_name: goal_value})
    return [target for target in goal_value if target is not None], kind_mask


def _goal_of_call(rig: Rig, name: str, kind_mask: tuple[bool, ...]) -> Goal:
    """Return the goal of a chain or joint, with the kinds of a call's targets."""
    goal = Goal(name, position=float(kind_mask[0]), orientation=float(kind_mask[1]))
    for chain in rig.chains:
        if chain.name == name:
            return replace(
                goal, joint=chain.tip, root=chain.root, stretch=chain.stretch
            )
    return goal


def _shape_error(values_by_goal: Mapping[str, Any]) -> OptionError:
    """Return the error for targets whose shapes do not match the goals."""
    message = f"targets of {', '.join(values_by_goal)} are not what their goals ask for"
    hint = "of a joint a point (3,), or the pair of that and a quaternion (4,); of a "
    hint += "Goal a value for each of its kinds"
    return OptionError(Fault("IK010", message, hint=hint))


def _targets_of_buffer(target_buffer: FloatArray) -> Targets:
    """Return targets from a packed buffer."""
    values_by_field = {
        kind.targets_field: target_buffer[:, :, TARGET_COLUMNS[kind.name]]
        for kind in GOAL_KINDS
    }
    return Targets(**values_by_field, weights=target_buffer[:, :, WEIGHT_COLUMNS])
