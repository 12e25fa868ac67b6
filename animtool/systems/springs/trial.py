"""Springs in several ways: solvers and their steps."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from animtool._types import FloatArray
from animtool.sim.system import Energy
from animtool.sim.trials.trial import FINER, Outcome, Setting, Shot, Trial, stepwise
from animtool.systems.springs.motion import SpringMotion
from animtool.systems.springs.records import Solver, SpringOptions
from animtool.systems.springs.simulating import simulate_springs
from animtool.systems.springs.solvers import choose
from animtool.systems.springs.system import SpringSystem

# What others are compared with: of the second order, and stable.
EXACT = Solver.BDF2
# Of a trial, instead, where the stiffest springs let no implicit step be solved.
EXPLICIT = Solver.SYMPLECTIC_EULER


def trial_of(
    name: str,
    kind: str,
    system: SpringSystem,
    options: SpringOptions,
    begin: float,
    times: FloatArray,
) -> Trial:
    """Return springs in the way of their file and in others.

    Times are when to look, ascending ``(F,)``, not before the beginning [s]. Where the
    file keeps an error, options have the solver and the step that this came to.
    """
    own = replace(options, error=None)
    free = replace(own, step=None)

    def usual(solver: Solver, options: SpringOptions = free) -> Setting:
        """Return a solver with the step that options come to."""
        choice = choose(system, options, solver, begin, system.state)
        return Setting.of(choice.solver, step=choice.cell / choice.substeps)

    chosen = usual(Solver(options.solver), own)

    def settings() -> list[Setting]:
        """Return each solver in several steps, about those that it takes itself."""
        each = [usual(solver) for solver in Solver if solver is not Solver.AUTO]
        each = [chosen if one.method == chosen.method else one for one in each]
        return [
            setting for one in each for setting in stepwise(one.method, one["step"])
        ]

    def references() -> list[list[Setting]]:
        """Return shorter and shorter steps of backward differences.

        Where these cannot be solved, of semi-implicit Euler.
        """
        step = min(chosen["step"], usual(EXACT)["step"])
        return [
            stepwise(EXACT, step, FINER),
            stepwise(EXPLICIT, usual(EXPLICIT)["step"], FINER),
        ]

    def run(setting: Setting) -> Outcome:
        options = own
        if setting != chosen:
            options = replace(own, solver=setting.method, step=setting["step"])
        began = time.perf_counter()
        motion = simulate_springs(system, [begin, *times.tolist()], options)
        seconds = time.perf_counter() - began
        return Outcome(
            seconds,
            motion.stats.steps,
            [Shot(points) for points in motion.positions[1:]],
            motion.stats.status,
            motion.stats.reason,
            motion.stats.stable_step,
            _energies(system, motion),
            _stretch(system, motion),
        )

    span = float(times[-1]) - begin
    return Trial(name, kind, span, chosen, settings, references, run)


def _energies(system: SpringSystem, motion: SpringMotion) -> list[Energy] | None:
    """Return energies, where nothing takes or brings any."""
    slowed = [system.drags, system.body.springs.damping, system.draws.damping]
    slowed.append(np.array(system.pressures))
    if (
        any(values.any() for values in slowed)
        or motion.torn.any()
        or system.colliders.meet
    ):
        return None
    energies = [
        system.energy(t, state)
        for t, state in zip(motion.times[1:], motion.states[1:], strict=True)
    ]
    return None if any(energy.supply for energy in energies) else energies


def _stretch(system: SpringSystem, motion: SpringMotion) -> float | None:
    """Return the most that a whole spring is longer than at rest [1]."""
    whole = system.without_springs(motion.torn) if motion.torn.any() else system
    ratios = [
        ratio
        for t, state in zip(motion.times, motion.states, strict=True)
        if (ratio := whole.stretch(t, state)) is not None
    ]
    return max(max(ratios) - 1, 0.0) if ratios else None
