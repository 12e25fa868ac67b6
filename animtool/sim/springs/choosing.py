"""Which solver takes springs through time, and in which steps."""

from __future__ import annotations

import math
from dataclasses import dataclass

from animtool._types import FloatArray
from animtool.sim.integrators import find_integrator
from animtool.sim.modes import allowed_step
from animtool.sim.springs.options import (
    Solver,
    SpringOptions,
    check_keeping_apart,
)
from animtool.sim.springs.system import SpringSystem

__all__ = ["SAFE", "Choice", "choose", "explicit_limit"]

# Cells of time where nothing else is said [s]: whole numbers of them are frames of 24,
# 30, 48, 60 and 120 a second.
CELL = 1 / 240
# Of the limit of explicit steps, what is taken.
SAFE = 0.8
# Explicit steps a second up to which nothing is cheaper for what it gives: xpbd takes
# as long with half as many, and is far less accurate. With an error to keep, up to
# which implicit steps are dearer.
CHEAP, CHEAP_EXACT = 4_800, 19_200
# Springs times steps a second of what is small enough to be done explicitly anyway: it
# takes about a tenth of a second.
SMALL = 10_000_000
# Steps in a cell to begin with.
FIRST = {Solver.XPBD: 2, Solver.BDF2: 4, Solver.IMPLICIT_EULER: 2}


@dataclass(frozen=True, slots=True)
class Choice:
    """A solver and its steps.

    Attributes:
        solver: Not `Solver.AUTO`.
        cell: Of time [s].
        substeps: Steps in a cell.
        reason: Why, in words.
        limit: The largest stable step of semi-implicit Euler [s].
    """

    solver: Solver
    cell: float
    substeps: int
    reason: str
    limit: float


def explicit_limit(system: SpringSystem, t: float, state: FloatArray) -> float:
    """Return the largest stable step of semi-implicit Euler [s]."""
    modes = system.frequencies(t, state)
    if modes is None:
        return math.inf
    limit = allowed_step(find_integrator("symplectic_euler"), modes)
    return math.inf if limit is None else limit


def choose(
    system: SpringSystem,
    options: SpringOptions,
    wanted: Solver,
    t: float,
    state: FloatArray,
) -> Choice:
    """Return the solver that is wanted, or the cheapest that is stable and near enough.

    Args:
        system: Of springs.
        options: With a step or without.
        wanted: Of options.
        t: Time of the start [s].
        state: There.

    Raises:
        OptionError: The one that is wanted does not keep a surface apart from itself
            (SIM046).
    """
    limit = explicit_limit(system, t, state)
    rate = 0.0 if math.isinf(limit) else 1 / (SAFE * limit)
    solver, reason = wanted, "it was asked for"
    if system.self_contact is not None:
        check_keeping_apart(wanted)
        if wanted is Solver.AUTO:
            solver, reason = Solver.XPBD, "it keeps surfaces apart from themselves"
    elif wanted is Solver.AUTO:
        springs = len(system.body.springs.rest)
        solver, reason = _cheapest(options, limit, rate, springs)
    if options.step is not None:
        return Choice(solver, options.step, 1, reason, limit)
    if solver is Solver.SYMPLECTIC_EULER:
        steps = max(1, math.ceil(CELL * rate))
        return Choice(solver, CELL, steps, reason, limit)
    return Choice(solver, CELL, FIRST[solver], reason, limit)


def _cheapest(
    options: SpringOptions, limit: float, rate: float, springs: int
) -> tuple[Solver, str]:
    most = CHEAP if options.error is None else CHEAP_EXACT
    if options.step is not None:
        stable = options.step <= SAFE * limit
        says = f"semi-implicit Euler is stable with steps up to {limit:.3g} s"
    else:
        stable = rate <= most or rate * springs <= SMALL
        says = f"semi-implicit Euler needs {rate:.0f} steps a second"
    if stable:
        return Solver.SYMPLECTIC_EULER, says
    if options.error is None:
        return Solver.XPBD, f"{says}, and xpbd is stable with any"
    return Solver.BDF2, f"{says}, and bdf2 is as accurate with fewer"
