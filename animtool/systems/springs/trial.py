"""Springs in several ways: solvers and their steps."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from animtool._types import FloatArray
from animtool.sim.system import Energy
from animtool.sim.trials.trial import FINER, Outcome, Setting, Shot, stepwise
from animtool.systems.springs.motion import SpringMotion
from animtool.systems.springs.records import Solver, SpringOptions
from animtool.systems.springs.simulating import simulate_springs
from animtool.systems.springs.solvers import choose
from animtool.systems.springs.system import SpringSystem

# What others are compared with: of the second order, and stable.
EXACT = Solver.BDF2
# Of a trial, instead, where the stiffest springs let no implicit step be solved.
EXPLICIT = Solver.SYMPLECTIC_EULER


class SpringTrial:
    """Springs, in the way of their file and in others.

    Times are when to look, ascending ``(F,)``, not before the beginning [s]. Where the
    file keeps an error, options have the solver and the step that this came to.
    """

    def __init__(
        self,
        name: str,
        kind: str,
        system: SpringSystem,
        options: SpringOptions,
        begin: float,
        times: FloatArray,
    ) -> None:
        self.name, self.kind = name, kind
        self.span = float(times[-1]) - begin
        self._system, self._own = system, replace(options, error=None)
        self._begin, self._times = begin, times
        self.chosen = self._usual(Solver(options.solver), self._own)

    def settings(self) -> list[Setting]:
        """Return each solver in several steps, about those that it takes itself."""
        settings = []
        for solver in Solver:
            if solver is Solver.AUTO:
                continue
            usual = self._usual(solver, replace(self._own, step=None))
            if solver == self.chosen.method:
                usual = self.chosen
            settings += stepwise(usual.method, usual["step"])
        return settings

    def references(self) -> list[list[Setting]]:
        """Return shorter and shorter steps of backward differences.

        Where these cannot be solved, of semi-implicit Euler.
        """
        least = replace(self._own, step=None)
        step = min(self.chosen["step"], self._usual(EXACT, least)["step"])
        explicit = self._usual(EXPLICIT, least)
        return [
            stepwise(EXACT, step, FINER),
            stepwise(EXPLICIT, explicit["step"], FINER),
        ]

    def run(self, setting: Setting) -> Outcome:
        """Simulate the springs in one way."""
        options = self._own
        if setting != self.chosen:
            options = replace(options, solver=setting.method, step=setting["step"])
        began = time.perf_counter()
        motion = simulate_springs(
            self._system, [self._begin, *self._times.tolist()], options
        )
        seconds = time.perf_counter() - began
        return Outcome(
            seconds,
            motion.stats.steps,
            [Shot(points) for points in motion.positions[1:]],
            motion.stats.status,
            motion.stats.reason,
            motion.stats.stable_step,
            self._energies(motion),
            self._stretch(motion),
        )

    def _usual(self, solver: Solver, options: SpringOptions) -> Setting:
        """Return a solver with the step that options come to."""
        choice = choose(self._system, options, solver, self._begin, self._system.state)
        return Setting.of(choice.solver, step=choice.cell / choice.substeps)

    def _energies(self, motion: SpringMotion) -> list[Energy] | None:
        """Return energies, where nothing takes or brings any."""
        system = self._system
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

    def _stretch(self, motion: SpringMotion) -> float | None:
        """Return the most that a whole spring is longer than at rest [1]."""
        system = self._system
        whole = system.without_springs(motion.torn) if motion.torn.any() else system
        ratios = [
            ratio
            for t, state in zip(motion.times, motion.states, strict=True)
            if (ratio := whole.stretch(t, state)) is not None
        ]
        return max(max(ratios) - 1, 0.0) if ratios else None
