"""SciPy's ODE solvers, sampled by their dense output."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.plugins import load_object
from animtool.core.quantities import plain_number
from animtool.core.record import dataclass
from animtool.sim.run import IntegrationRun
from animtool.sim.system import Matrix
from animtool.sim.trajectory import Status

# Solvers without support for sparse Jacobians; they use finite differences instead.
DENSE_JACOBIAN_SOLVERS = {"scipy.integrate:LSODA"}


@dataclass(slots=True)
class _SolverMemory:
    """A running SciPy solver with the dense output of its last step."""

    solver: Any
    dense_output: Any = None


def advance_scipy(run: IntegrationRun, target: float) -> Status:
    """Integrate until ``target`` [s], which may lie between two steps."""
    memory = run.memory if isinstance(run.memory, _SolverMemory) else _start_solver(run)
    solver, shape = memory.solver, run.state.shape
    while solver.t < target:
        start, memory.dense_output = solver.t, None
        reason = _take_step(solver)
        if reason:
            run.time = start
            return run.stop(Status.STEP_TOO_SMALL, reason)
        h = float(solver.t - start)
        run.memory, run.state = memory, solver.y.reshape(shape)
        status = run.record_steps(float(solver.t), h, 1)
        if status is not Status.OK:
            return status
        if h < run.options.floor and solver.t < run.end:
            reason = f"the tolerance needs a step of {plain_number(h)} s"
            return run.stop(Status.STEP_TOO_SMALL, reason)
    run.time, run.state = target, _dense_value(memory, target).reshape(shape)
    return Status.OK


def _dense_value(memory: _SolverMemory, t: float) -> FloatArray:
    """Return the state at a time within the last step, from the dense output."""
    if t == memory.solver.t:
        return np.array(memory.solver.y)
    if memory.dense_output is None:
        memory.dense_output = memory.solver.dense_output()
    return np.array(memory.dense_output(t))


def _take_step(solver: Any) -> str:
    """Take one solver step; return why it failed, empty on success."""
    with warnings.catch_warnings(record=True) as caught_warnings:
        warnings.simplefilter("always")
        message = solver.step()
    if solver.status != "failed":
        return ""
    return str(
        message
        or (caught_warnings[-1].message if caught_warnings else "its solver failed")
    )


def _start_solver(run: IntegrationRun) -> _SolverMemory:
    """Return a SciPy solver started at the state of a run."""
    options, shape = run.options, run.state.shape
    equations = run.equations

    def rate(t: float, flat_state: FloatArray) -> FloatArray:
        return equations.rate(t, flat_state.reshape(shape)).ravel()

    settings: dict[str, Any] = {
        "rtol": options.rtol,
        "atol": options.atol,
        "max_step": math.inf if options.step is None else options.step,
    }
    jacobian = _flat_jacobian(run) if run.integrator.is_implicit else None
    if jacobian is not None:
        settings["jac"] = jacobian
    solver_class: Any = load_object(run.integrator.solver)
    solver = solver_class(rate, run.time, run.state.ravel(), run.end, **settings)
    run.memory = memory = _SolverMemory(solver)
    return memory


def _flat_jacobian(run: IntegrationRun) -> Callable[[float, FloatArray], Matrix] | None:
    """Return the Jacobian of the flattened rate; None if unavailable."""
    equations, shape = run.equations, run.state.shape

    def rate_jacobian(t: float, flat_state: FloatArray) -> Matrix:
        return equations.jacobian(t, flat_state.reshape(shape))

    def acceleration_jacobian(t: float, flat_state: FloatArray) -> Matrix:
        matrices = equations.jacobians(t, *flat_state.reshape(shape))
        assert matrices is not None
        return _block_jacobian(*matrices)

    if equations.second_order is None:
        sample_jacobian = equations.jacobian(run.time, run.state)
        jacobian = rate_jacobian
    else:
        jacobian_pair = equations.jacobians(run.time, *run.state)
        sample_jacobian = None if jacobian_pair is None else jacobian_pair[0]
        jacobian = acceleration_jacobian
    needs_dense = run.integrator.solver in DENSE_JACOBIAN_SOLVERS
    if sample_jacobian is None or (
        needs_dense and not isinstance(sample_jacobian, np.ndarray)
    ):
        return None
    return jacobian


def _block_jacobian(da_dx: Matrix, da_dv: Matrix) -> Matrix:
    """Return the Jacobian of velocities and accelerations to the full state."""
    if isinstance(da_dx, np.ndarray):
        zero = np.zeros_like(da_dx)
        return np.block([[zero, np.eye(len(da_dx))], [da_dx, da_dv]])
    from scipy.sparse import block_array, eye_array

    return block_array(
        [[None, eye_array(da_dx.shape[0])], [da_dx, da_dv]], format="csc"
    )
