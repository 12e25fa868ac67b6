"""Choice of a solver and its steps, and the settings of work-precision tables."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import OptionError, refuse
from animtool.core.record import dataclass
from animtool.sim.integrators.integrator import allowed_step, find_integrator
from animtool.sim.trials.trial import REFERENCE_FACTORS, Setting, step_settings
from animtool.systems.framework.simulation import TrialSettings
from animtool.systems.springs.body_coupling import BodyCoupling
from animtool.systems.springs.checks import check_supports_self_contact
from animtool.systems.springs.motion import MAX_SUBSTEPS_PER_CELL
from animtool.systems.springs.records import Solver, SpringOptions
from animtool.systems.springs.system import SpringSystem

# Default cell [s]: frames at 24, 30, 48, 60 and 120 per second are multiples of it.
CELL = 1 / 240
# Safety factor of the explicit step limit.
STEP_SAFETY_FACTOR = 0.8
# Compute time per second of motion below which explicit steps are always used [s].
NEGLIGIBLE_TIME = 0.03
# Explicit step rate above which implicit solves lose precision in float64 [1/s].
MAX_SOLVABLE_RATE = 1e9
# Initial steps per cell of time.
INITIAL_SUBSTEPS = {Solver.XPBD: 2, Solver.BDF2: 4, Solver.IMPLICIT_EULER: 2}
# Time of a step per spring of a 20 by 20 sheet [s], on one core of a server of 2024
# (tests/bench/results/sim_springs.csv). With few springs the cost per spring is higher
# in all solvers alike; only the ratio matters.
STEP_COSTS = {
    # Forces of neighbouring springs are computed four at a time.
    Solver.SYMPLECTIC_EULER: 2.8e-9,
    # Newton corrections of about ten matrix products each; more for stiff systems, see
    # `bdf2_step_cost`.
    Solver.BDF2: 150e-9,
}
# The same for chains, which are solved directly [s].
CHAIN_COST = 500e-9
# Largest index distance of spring ends in a chain; the kernels use the same limit.
MAX_CHAIN_BANDWIDTH = 4
# Reference solver of a table, of second order and stable.
REFERENCE_SOLVER = Solver.BDF2
# Reference solver for springs too stiff for implicit steps.
STIFF_REFERENCE_SOLVER = Solver.SYMPLECTIC_EULER


@dataclass(frozen=True, slots=True)
class SolverChoice:
    """A solver with its cells and steps."""

    solver: Solver  # not `Solver.AUTO`
    cell: float  # length of a cell of time [s]
    substeps: int  # steps in a cell
    reason: str  # why this solver, in words
    limit: float  # largest stable step of semi-implicit Euler [s]


def explicit_limit(system: SpringSystem, t: float, state: FloatArray) -> float:
    """Return the largest stable step of semi-implicit Euler [s]."""
    modes = system.frequencies(t, state)
    if modes is None:
        return math.inf
    limit = allowed_step(find_integrator("symplectic_euler"), modes)
    return math.inf if limit is None else limit


def choose_solver(
    system: SpringSystem,
    options: SpringOptions,
    requested_solver: Solver,
    t: float,
    state: FloatArray,
) -> SolverChoice:
    """Return the requested solver with its steps; for ``auto``, the fastest."""
    limit = explicit_limit(system, t, state)
    rate = 1 / (STEP_SAFETY_FACTOR * limit) if limit > 0 else math.inf
    solver, reason = requested_solver, "it was requested"
    if system.self_contact is not None:
        check_supports_self_contact(requested_solver)
        if requested_solver is Solver.AUTO:
            solver, reason = Solver.XPBD, "it has self-contact"
    elif system.coupling is not None:
        return choose_coupled_solver(
            system.coupling, options, requested_solver, t, limit
        )
    elif requested_solver is Solver.AUTO:
        solver, reason = _choose_cheapest(system, options, rate)
    if options.step is not None:
        steps = 1
        if requested_solver is Solver.AUTO and solver is Solver.SYMPLECTIC_EULER:
            steps = max(1, math.ceil(options.step * rate))
        return SolverChoice(solver, options.step, steps, reason, limit)
    if solver is Solver.SYMPLECTIC_EULER:
        max_rate = MAX_SUBSTEPS_PER_CELL / CELL
        if rate > max_rate:
            message = f"{solver} needs {rate:.3g} steps per second, but the limit is "
            message += f"{max_rate:.3g} at most"
            hint = "use bdf2 or auto, less stiffness or damping, or more mass"
            refuse("SIM004", message, "solver", hint)
        steps = max(1, math.ceil(CELL * rate))
        return SolverChoice(solver, CELL, steps, reason, limit)
    return SolverChoice(solver, CELL, INITIAL_SUBSTEPS[solver], reason, limit)


def choose_coupled_solver(
    coupling: BodyCoupling,
    options: SpringOptions,
    requested_solver: Solver,
    begin: float,
    limit: float,
) -> SolverChoice:
    """Return a solver whose cells align with the steps of bodies that carry pins."""
    solver, reason = requested_solver, "it was requested"
    if requested_solver is Solver.AUTO:
        solver, reason = Solver.BDF2, "rigid bodies hold its pins"
    lengths = sorted({carrier.step for carrier in coupling.carriers})
    max_length = lengths[-1]
    cell = max_length
    min_substeps = INITIAL_SUBSTEPS[solver]
    substeps = max(min_substeps, math.ceil(cell / CELL * min_substeps))
    if options.step is not None:
        cell = max(options.step, max_length)
        substeps = max(1, round(cell / options.step))
    is_aligned = all(_is_integer(cell / length) for length in lengths)
    is_aligned &= options.step is None or _is_integer(cell / options.step)
    if not is_aligned:
        lengths_text = " and ".join(f"{length:g}" for length in lengths)
        message = f"steps of {options.step or cell:g} s and those of the bodies that "
        message += f"hold its pins, of {lengths_text} s, do not end together"
        hint = f"use step: {max_length:g}, a multiple of it, or a fraction"
        refuse("SIM164", message, "step", hint)
    for carrier in coupling.carriers:
        if carrier.begin > begin or not _is_integer((begin - carrier.begin) / cell):
            message = f"it starts at {begin:g} s, but the bodies of its pins "
            message += f"at {carrier.begin:g} s"
            refuse("SIM164", message, "preroll", "give both the same preroll")
    return SolverChoice(solver, cell, substeps, reason, limit)


def _is_integer(ratio: float) -> bool:
    """Return whether a ratio is an integer up to rounding."""
    return abs(ratio - round(ratio)) <= 1e-9 * max(1.0, abs(ratio))


def bdf2_step_cost(system: SpringSystem, ratio: float) -> float:
    """Return the compute time of a bdf2 step per spring [s].

    The ratio is the number of semi-implicit Euler steps that one step replaces: matrix
    products grow with its square root.
    """
    bandwidth = np.abs(np.diff(system.body.springs.ends, axis=1)).max(initial=0)
    if bandwidth <= MAX_CHAIN_BANDWIDTH:
        return CHAIN_COST
    return STEP_COSTS[Solver.BDF2] * math.sqrt(max(ratio, 1.0))


def _choose_cheapest(
    system: SpringSystem, options: SpringOptions, rate: float
) -> tuple[Solver, str]:
    """Return the second-order solver that is expected to be fastest, and why.

    Stable explicit steps and bdf2 conserve energy equally well, so that steps times
    their cost decide. A requested step is an upper limit: explicit steps are as short
    as stability needs. With an error tolerance, bdf2 steps count at their lowest cost.
    """
    step = options.step
    stability_text = f"symplectic_euler needs at least {rate:.0f} steps per second"
    cell = CELL if step is None else step
    steps = INITIAL_SUBSTEPS[Solver.BDF2] / CELL if step is None else 1 / step
    if rate > MAX_SOLVABLE_RATE:
        return Solver.XPBD, f"{stability_text}, and bdf2 converges with no step"
    if math.ceil(cell * rate) > MAX_SUBSTEPS_PER_CELL:
        return Solver.BDF2, f"{stability_text}, which are too many"
    explicit_cost = max(rate, 1 / cell) * STEP_COSTS[Solver.SYMPLECTIC_EULER]
    ratio = rate / steps if options.error is None else 1.0
    implicit_cost = steps * bdf2_step_cost(system, ratio)
    alternative = f"about {steps:.0f} of {Solver.BDF2}"
    if explicit_cost * len(system.body.springs.rest) <= NEGLIGIBLE_TIME:
        cost_text = "little time"
    elif explicit_cost <= implicit_cost:
        cost_text = f"less time than {alternative}"
    else:
        fraction = f"{implicit_cost / explicit_cost:.0%}"
        comparison = f"{alternative} takes {fraction} of their time"
        return Solver.BDF2, f"{stability_text}, and {comparison}"
    return Solver.SYMPLECTIC_EULER, f"{stability_text}, which take {cost_text}"


def trial_settings(
    system: SpringSystem, options: SpringOptions, begin: float
) -> TrialSettings:
    """Return the settings to compare: solvers with steps around their defaults."""

    def setting_of(solver: Solver, solver_options: SpringOptions) -> Setting:
        """Return a solver with its default step."""
        choice = choose_solver(system, solver_options, solver, begin, system.state)
        return Setting.of(choice.solver, step=choice.cell / choice.substeps)

    current = setting_of(Solver(options.solver), options)
    default_steps: dict[str, float] = {}
    for solver in Solver:
        # Solvers that cannot simulate the springs are left out.
        with suppress(OptionError):
            if solver is not Solver.AUTO:
                setting = setting_of(solver, replace(options, step=None))
                default_steps[solver] = setting["step"]
    settings = [
        row
        for method, step in default_steps.items()
        for row in step_settings(
            method, current["step"] if method == current.method else step
        )
    ]
    # Finer steps of bdf2, of explicit Euler, and of the chosen solver.
    solvers: tuple[str, ...] = (REFERENCE_SOLVER, STIFF_REFERENCE_SOLVER)
    steps = {name: default_steps[name] for name in solvers if name in default_steps}
    if REFERENCE_SOLVER in steps:
        steps[REFERENCE_SOLVER] = min(current["step"], steps[REFERENCE_SOLVER])
    if current.method not in solvers:
        steps[current.method] = current["step"]
    references = [
        step_settings(method, step, REFERENCE_FACTORS) for method, step in steps.items()
    ]

    def changed_keys(setting: Setting) -> Mapping[str, Any]:
        if setting == current:
            return {"error": None, "solver": options.solver, "step": options.step}
        return {"error": None, "solver": setting.method, "step": setting["step"]}

    return TrialSettings(current, lambda: settings, lambda: references, changed_keys)
