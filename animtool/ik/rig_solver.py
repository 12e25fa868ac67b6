"""Builds the kernel solver of an IK problem."""

from __future__ import annotations

from enum import IntEnum
from typing import Any, TypeAlias

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.ik.limbs import limb_arrays
from animtool.ik.options import IkMethod, IkOptions
from animtool.ik.problem import Problem
from animtool.ik.sub_rig import find_mimics
from animtool.ik.two_bone import incompatibility
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


class ClosedForm(IntEnum):
    """Closed-form solutions, with their numbers in the kernel."""

    NONE = 0
    LIMB = 1  # two bones and a position
    ARM = 2  # six pins and a pose


def closed_form(problem: Problem) -> ClosedForm:
    """Return the closed form of a problem, or NONE; the problem caches it."""
    if "closed" not in problem.solver_cache:
        arrays, form = problem.chain.kernel_arrays, ClosedForm.NONE
        if incompatibility(problem) is None:
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
