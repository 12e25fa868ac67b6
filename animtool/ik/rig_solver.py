"""Builds the kernel solver of an IK problem."""

from __future__ import annotations

from enum import IntEnum
from typing import Any, TypeAlias

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.ik.chain import BALL, PIN, Chain
from animtool.ik.limbs import limb_arrays
from animtool.ik.options import IkMethod, IkOptions
from animtool.ik.problem import Problem
from animtool.ik.sub_rig import find_mimics
from animtool.rig.joints import coordinate_slices
from animtool.rig.skeleton import Rig

# Coordinates, misses, reports, seconds, mask of reached goals, bone length scales,
# positions and linear parts of the joints.
KernelSolution: TypeAlias = tuple[
    FloatArray,
    FloatArray,
    IntArray,
    FloatArray,
    BoolArray,
    FloatArray,
    FloatArray,
    FloatArray,
]

# Number of each method in the kernel.
KERNEL_METHODS = {
    IkMethod.AUTO: 0,
    IkMethod.DAMPED: 0,
    IkMethod.TWO_BONE: 0,
    IkMethod.GRADIENT: 1,
    IkMethod.NEWTON: 2,
    IkMethod.CCD: 3,
    IkMethod.FABRIK: 4,
}
# Methods that may use the closed form.
CLOSED_FORM_METHODS = {IkMethod.AUTO, IkMethod.TWO_BONE}
# Damping of the first step: far from the goals, and near them.
COLD_DAMPING, WARM_DAMPING = 1e-3, 1e-6
# Cosine below which a pin axis is perpendicular to a bone [1].
PERPENDICULAR_COSINE = 1e-12
# Lengths below this fraction of the limb's count as zero.
ZERO_LENGTH = 1e-12


class ClosedForm(IntEnum):
    """Closed-form solutions, with their numbers in the kernel."""

    NONE = 0
    LIMB = 1  # two bones and a position
    ARM = 2  # six pins and a pose


def closed_form(problem: Problem) -> ClosedForm:
    """Return the closed form of a problem, or NONE; the problem caches it."""
    if "closed" not in problem.solver_cache:
        arrays, form = problem.chain.kernel_arrays, ClosedForm.NONE
        if two_bone_obstacle(problem) is None:
            form = ClosedForm.LIMB
        elif _kernels.arm_kind(*arrays, problem.rest_weight):
            form = ClosedForm.ARM
        problem.solver_cache["closed"] = form
    return ClosedForm(problem.solver_cache["closed"])


def build_solver(problem: Problem, options: IkOptions) -> _kernels.RigSolver:
    """Build the kernel solver of a problem; it caches the last solved frame."""
    form = ClosedForm.NONE
    if options.method in CLOSED_FORM_METHODS:
        form = closed_form(problem)
    if "arrays" not in problem.solver_cache:
        problem.solver_cache["arrays"] = _kernel_arrays(problem)
    return _kernels.RigSolver(
        **problem.solver_cache["arrays"],
        rest_weight=problem.rest_weight,
        closed=int(form),
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


def _kernel_arrays(problem: Problem) -> dict[str, Any]:
    """Return the kernel arguments of a problem's chain, goals, limbs and rig."""
    chain, rig = problem.chain, problem.rig
    limbs, limb_numbers = limb_arrays(problem.limbs)
    stretching_bones = [[j, limb.goal] for limb in problem.limbs for j in limb.joints]
    mimic_columns, mimic_numbers = _mimic_columns(rig, problem.joints)
    types, joint_columns, joint_axes = rig.joint_arrays
    return {
        "nodes": chain.nodes,
        "numbers": chain.node_numbers,
        "goals": chain.goal_nodes,
        "goal_numbers": chain.goal_numbers,
        "goal_frames": chain.goal_rotations,
        "length": chain.length,
        "columns": chain.rig_columns,
        "scales": chain.scales,
        "periods": chain.periods,
        "balls": np.array([first for first, _ in chain.ball_rotations], np.int64),
        "ball_frames": np.array([q for _, q in chain.ball_rotations]).reshape(-1, 4),
        "mimics": mimic_columns,
        "mimic_numbers": mimic_numbers,
        "limbs": limbs,
        "limb_numbers": limb_numbers,
        "limb_joints": np.array(stretching_bones, np.int64).reshape(-1, 2),
        "parents": rig.parents,
        "types": types,
        "joint_columns": joint_columns,
        "axes": joint_axes,
        "rest_translations": rig.rest_translations,
        "rest_rotations": rig.rest_rotations,
    }


def _mimic_columns(
    rig: Rig, moving_names: tuple[str, ...]
) -> tuple[IntArray, FloatArray]:
    """Return columns of mimic and lead joints ``(M, 2)``, gains and offsets ``(M, 2)``.

    Lead joints come before their mimics. A rig with drivers has none: drivers evaluate
    mimics too.
    """
    follower_names = [] if rig.is_driven else find_mimics(rig, moving_names)
    slices = coordinate_slices(rig)
    columns, gains_and_offsets = [], []
    ready_names = set(rig.names) - set(follower_names)
    mimic_of = {j.name: j.mimic for j in rig.joints if j.mimic is not None}
    while follower_names:
        ready_mimics = [
            n for n in follower_names if mimic_of[n].joint in ready_names
        ] or follower_names
        for name in ready_mimics:
            mimic_and_leader = rig.index(name), rig.index(mimic_of[name].joint)
            columns.append([slices[index].start for index in mimic_and_leader])
            gains_and_offsets.append([mimic_of[name].gain, mimic_of[name].offset])
        ready_names.update(ready_mimics)
        follower_names = [name for name in follower_names if name not in ready_names]
    return (
        np.array(columns, np.int64).reshape(-1, 2),
        np.array(gains_and_offsets, np.float64).reshape(-1, 2),
    )


def two_bone_obstacle(problem: Problem) -> str | None:
    """Return why the two-bone closed form does not apply; None if it does."""
    nodes, goal = problem.chain.nodes, problem.goals[0]
    if len(problem.goals) != 1:
        return "the problem has more than one goal"
    kinds = {kind.name for kind in goal.kinds}
    if "position" not in kinds or not kinds <= {"position", "pole"}:
        return "the goal is not a position, with or without a pole"
    if problem.rest_weight > 0:
        return "a pose is preferred"
    # A ball at the root, and an independent joint below it.
    if nodes[:, :2].tolist() != [[BALL, -1], [nodes[-1, 0], 0]] or nodes[1, 3]:
        return "the joints that move are not a ball joint and a child of it"
    return _joint_obstacle(problem.chain)


def _joint_obstacle(chain: Chain) -> str | None:
    """Return why the joints cannot bend and rotate the limb fully; None if they can."""
    if not _is_unlimited(chain.node_numbers[0]):
        return "its first joint has limits"
    upper_bone = chain.node_numbers[1, 9:12]
    lower_bone = chain.goal_numbers[0, :3] + chain.goal_numbers[0, 3:6]
    if min(np.linalg.norm(upper_bone), np.linalg.norm(lower_bone)) < ZERO_LENGTH:
        return "a bone has no length"
    if chain.nodes[1, 0] == BALL:
        is_limited = not _is_unlimited(chain.node_numbers[1])
        return "its second joint is a ball with limits" if is_limited else None
    axis = chain.node_numbers[1, :9].reshape(3, 3)[:, 2]
    bone_along_axis = chain.goal_numbers[0, 2]
    tool_along_axis = chain.goal_numbers[0, 5]
    cosines = abs(axis @ upper_bone), abs(bone_along_axis), abs(tool_along_axis)
    is_across = max(cosines) < PERPENDICULAR_COSINE
    is_unscaled = chain.node_numbers[1, 12] == 1 and chain.node_numbers[1, 13] == 0
    if chain.nodes[1, 0] == PIN and is_unscaled and is_across:
        return None
    return "its second joint does not rotate about an axis across both bones"


def _is_unlimited(node_numbers: FloatArray) -> bool:
    """Return whether the node numbers of a joint contain no limits."""
    no_limits = np.array([np.inf, np.inf, -np.inf, np.inf])
    return bool((node_numbers[14:18] == no_limits).all())
