"""An inverse kinematics problem: goals, and the joints that move them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import field, replace
from functools import cached_property
from typing import Any

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import ArrayLike, FloatArray, IntArray, as_floats
from animtool.core.errors import Fault, OptionError, counted, excerpt, listed
from animtool.core.loaded import check_loaded
from animtool.core.record import dataclass
from animtool.ik.assembly import assemble_chain
from animtool.ik.chain import Chain
from animtool.ik.driver_programs import with_driver_sources
from animtool.ik.goals import MAX_COORDINATE, Goal, goal_faults
from animtool.ik.limbs import GoalLimb, find_limbs
from animtool.ik.sub_rig import leader_of, start_coordinates, with_mimics
from animtool.rig.driver_plan import plan_of
from animtool.rig.joints import coordinate_slices
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import JointType, Rig


@dataclass(frozen=True)
class Problem:
    """An IK problem, to inspect and to pass to `solve`.

    Attributes:
        rig: The rig.
        goals: E goals.
        joints: Names of the joints that move a goal, parents first; no others are in
            the problem.
        degrees: Degrees of freedom D: 1 for a pin or prismatic joint, 3 for a ball, 6
            for a free joint; 0 for mimic and driven joints.
        rows: Number of residuals M: 3 for a position, 3 for an orientation, 2 for an
            aim, 1 for a pole.
        length: Unit of lengths inside the solver: the longest bone path to a goal [m].
        rest_weight: Weight of the preferred pose in the sum of squares.
        chain: The kinematic chain of the joints.
        pose: Pose ``(Q,)`` of the joints that do not move, and the default start.
        limbs: Soft and stretching limbs.
        solver_cache: Cached solver inputs, by name.
    """

    rig: Rig
    goals: tuple[Goal, ...]
    joints: tuple[str, ...]
    degrees: int
    rows: int
    length: float
    rest_weight: float
    chain: Chain = field(repr=False)
    pose: FloatArray = field(repr=False, compare=False)
    limbs: tuple[GoalLimb, ...] = field(default=(), repr=False)
    solver_cache: dict[str, Any] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def __repr__(self) -> str:
        """Return the rig's name and the numbers of goals, joints and degrees."""
        goal_text = counted(len(self.goals), "goal")
        joint_text = counted(len(self.joints), "joint")
        degree_noun = "degree" if self.degrees == 1 else "degrees"
        name = self.rig.name
        freedom_text = f"{self.degrees} {degree_noun} of freedom"
        return f"<Problem of {name!r}: {goal_text}, {joint_text}, {freedom_text}>"

    @cached_property
    def coordinates(self) -> int:
        """Number Q of joint coordinates of the rig."""
        return self.rig.coordinates

    @cached_property
    def fixed_joints(self) -> list[int]:
        """Indices of joints that do not move, but would move a goal.

        Of driven joints, the joints that drive them.
        """
        goals = [replace(goal, root=None) for goal in self.goals]
        joints = find_moving_joints(self.rig, goals)
        if self.rig.is_driven:
            joints = joints.difference(plan_of(self.rig).joints)
        names = set(self.joints)
        return sorted(j for j in joints if self.rig.joints[j].name not in names)

    @cached_property
    def fixed_columns(self) -> IntArray:
        """Columns of these joints in a pose ``(C,)``."""
        slices = coordinate_slices(self.rig)
        columns = [np.arange(self.coordinates)[slices[j]] for j in self.fixed_joints]
        return np.concatenate([np.zeros(0, np.int64), *columns])

    @property
    def limits(self) -> dict[str, RangeLimit | BallLimit]:
        """Limits by joint name; unlimited joints are left out."""
        joints = (self.rig.joints[self.rig.index(name)] for name in self.joints)
        return {joint.name: joint.limits for joint in joints if joint.limits}


def build(
    rig: Rig,
    goals: Sequence[Goal],
    *,
    joints: Collection[str] | None = None,
    pose: ArrayLike | None = None,
    rest_weight: float = 0.0,
) -> Problem:
    """Return the IK problem of a rig and goals.

    Args:
        rig: J joints, Q coordinates.
        goals: At least one goal.
        joints: Names of the joints that may move; None selects every joint that moves a
            goal.
        pose: Coordinates ``(Q,)`` of the joints that do not move; None is the rest
            pose, with joints that it has outside their limits at the nearest one.
        rest_weight: Weight of the pose passed to `solve` as ``prefer``: of squared
            angles and relative lengths from it. Goals are then missed by about as much.

    Raises:
        OptionError: With every fault: a joint that the rig lacks (TGT001), a goal that
            asks for nothing (TGT002), a weight that is not finite or less than 0
            (TGT007), an aim axis not of length 1 (TGT008), another option out of its
            range (IK002), a goal that no joint moves (IK003), a pole without a limb of
            two bones (IK004), reversed limits (IK005), no goals (IK006), a goal's root
            that is not above its joint (TGT012), a limb that is soft or stretches but
            slides, has a root that is moved, or shares its bones with another that
            stretches (IK008), a bone longer than 1e100 m (IK009), or
            ``rest_weight`` less than 0 (IK014).
        ValueError: ``pose`` does not fit the rig.

    >>> from animtool.rig.skeleton import Joint, JointType
    >>> upper = Joint("upper", -1, JointType.PIN)
    >>> lower = Joint("lower", 0, JointType.PIN, translation=(1, 0, 0))
    >>> other = Joint("other", 0, JointType.PIN, translation=(0, 1, 0))
    >>> rig = Rig("arm", (upper, lower, other))
    >>> problem = build(rig, [Goal("lower", offset=(1, 0, 0))])
    >>> problem.joints, problem.degrees, problem.length
    (('upper', 'lower'), 2, 2.0)
    """
    check_loaded(rig, Rig, "rig")
    if isinstance(goals, str | Goal):
        form = "goals" if isinstance(goals, Goal) else f"Goal({goals!r})"
        raise TypeError(f"goals is not a list; write [{form}]")
    for i, goal in enumerate(goals):
        check_loaded(goal, Goal, f"goals[{i}]")
    faults = _input_faults(rig, goals, joints, rest_weight)
    if faults:
        raise OptionError(faults)
    if pose is None:
        pose_coordinates = start_coordinates(rig)[0]
    else:
        pose_coordinates = as_floats(pose, (rig.coordinates,), "pose")
    moving_joints = find_moving_joints(rig, goals, joints)
    faults = _immovable_faults(rig, goals, moving_joints, joints)
    if faults:
        raise OptionError(faults)
    joint_names = tuple(rig.names[j] for j in sorted(moving_joints))
    # As in results.
    pose_coordinates = with_mimics(rig, pose_coordinates[None], joint_names)[0]
    chain, faults = assemble_chain(rig, goals, moving_joints, pose_coordinates)
    limbs: tuple[GoalLimb, ...] = ()
    if not faults:
        limbs, faults = find_limbs(rig, goals, moving_joints, chain)
    if faults:
        raise OptionError(faults)
    return Problem(
        rig,
        tuple(goals),
        joint_names,
        chain.degrees,
        sum(goal.rows for goal in goals),
        chain.length,
        rest_weight,
        chain,
        pose_coordinates,
        limbs,
    )


def _input_faults(
    rig: Rig, goals: Sequence[Goal], joints: Collection[str] | None, rest_weight: float
) -> list[Fault]:
    """Return the faults in goals and options that need no geometry to find."""
    faults = [] if goals else [Fault("IK006", "the problem has no goals")]
    joint_names = set(rig.names)
    for i, goal in enumerate(goals):
        faults += goal_faults(goal, rig, f"goals[{i}]")
    if isinstance(joints, str):
        message = f"joints must be a list of names, such as [{joints!r}], not text"
        faults.append(Fault("TGT001", message))
        joints = ()
    for name in joints or ():
        if name not in joint_names:
            message = f"unknown joint {excerpt(name)} of {rig.name!r}"
            faults.append(Fault("TGT001", message, hint=rig.joint_hint(name)))
    faults += rest_weight_faults(rest_weight)
    for joint in rig.joints:
        if _is_reversed(joint.limits):
            message = f"the limits of {joint.name!r} are reversed or not numbers"
            faults.append(Fault("IK005", message))
        if not max(map(abs, joint.translation)) <= MAX_COORDINATE:
            distance = f"more than {MAX_COORDINATE:g} m"
            message = f"{joint.name!r} is {distance} from its parent"
            faults.append(Fault("IK009", message, hint="a Rig is in metres"))
    return faults


def rest_weight_faults(weight: float) -> list[Fault]:
    """Return the faults in a rest weight."""
    if np.isfinite(weight) and weight >= 0:
        return []
    return [Fault("IK014", f"rest_weight must be at least 0, not {weight}")]


def _is_reversed(limits: RangeLimit | BallLimit | None) -> bool:
    """Return whether limits are reversed."""
    match limits:
        case RangeLimit(low, high):
            return not low <= high
        case BallLimit(swing, twist):
            is_swing_valid = swing is None or min(swing) >= 0
            return not (is_swing_valid and (twist is None or twist[0] <= twist[1]))
    return False


def find_moving_joints(
    rig: Rig, goals: Sequence[Goal], joints: Collection[str] | None = None
) -> set[int]:
    """Return the allowed joints that move a goal; None allows all joints.

    Above a goal, joints that follow a moving joint or lead it are moving, too.
    """
    moving_joints: set[int] = set()
    for goal in goals:
        j = rig.index(goal.joint)
        # A joint does not move a point at its origin.
        ignores_rotation = goal.ignores_joint_rotation
        while j >= 0:
            rig_joint = rig.joints[j]
            is_rotating = rig_joint.type in {JointType.PIN, JointType.BALL}
            is_allowed = joints is None or rig_joint.name in joints
            is_fixed = rig_joint.type is JointType.FIXED
            if is_allowed and not is_fixed and not (ignores_rotation and is_rotating):
                moving_joints.add(j)
            is_sliding = rig_joint.type in {JointType.FREE, JointType.PRISMATIC}
            if is_sliding or any(rig_joint.translation):
                ignores_rotation = False
            j = -1 if rig_joint.name == goal.root else rig_joint.parent
    moving_joints = _with_followers(rig, goals, joints, moving_joints)
    if rig.is_driven:
        moving_joints = with_driver_sources(rig, moving_joints, goals, joints)
        moving_joints = _with_followers(rig, goals, joints, moving_joints)
    return moving_joints


def _with_followers(
    rig: Rig,
    goals: Sequence[Goal],
    joints: Collection[str] | None,
    moving_joints: set[int],
) -> set[int]:
    """Return moving joints with the mimic joints above goals that move with them."""
    if joints is None and not any(goal.root for goal in goals):
        return moving_joints
    leaders = {leader_of(rig, j)[0] for j in moving_joints}
    all_joints = find_moving_joints(rig, [replace(goal, root=None) for goal in goals])
    return moving_joints | {j for j in all_joints if leader_of(rig, j)[0] in leaders}


def _immovable_faults(
    rig: Rig,
    goals: Sequence[Goal],
    moving_joints: set[int],
    allowed_joints: Collection[str] | None,
) -> list[Fault]:
    """Return a fault for each goal that no joint moves."""
    faults = []
    for i, goal in enumerate(goals):
        joints_above = rig.upwards(rig.index(goal.joint))
        if moving_joints.intersection(joints_above):
            continue
        # The nearest joint is the first.
        movable_names = [
            rig.joints[j].name
            for j in sorted(find_moving_joints(rig, [goal]), reverse=True)
        ]
        hint = "a joint cannot move a position at its own origin: set an offset"
        if movable_names and allowed_joints is not None:
            hint = f"add to {argument('joints')} one that can: {listed(movable_names)}"
        elif movable_names:
            hint = f"these joints could, but must not: {listed(movable_names)}"
        elif not any(rig.joints[j].type is not JointType.FIXED for j in joints_above):
            hint = "only fixed joints are above it"
        message = f"no joint moves {goal.joint!r}"
        faults.append(Fault("IK003", message, hint=hint, where=f"goals[{i}]"))
    return faults
