"""Particles in several ways: integrators, their steps and tolerances."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault, OptionError, ToleranceError
from animtool.plugins import load_object
from animtool.sim.integrators import INTEGRATORS, find_integrator
from animtool.sim.integrators.integrator import Control
from animtool.sim.options import TOLERANCE, IntegrateOptions
from animtool.sim.system import Energy
from animtool.sim.trajectory import Status
from animtool.sim.trials.trial import FINER, Outcome, Setting, Shot, ladder, stepwise
from animtool.systems.particles.run import ParticleFrame, ParticleRun
from animtool.systems.particles.setup import Particles
from animtool.systems.simulation import StoppedError

# What others are compared with: of high order, and yet with a step that ends at each
# contact.
EXACT = "rk4"
MUCH_FINER = 1 / 8
# Tolerances over the usual one, and what methods that choose their steps have for the
# longest, over the chosen step.
TOLERANCES = (100.0, 1.0, 0.01)
LONGER = 4.0
# Unknowns up to which implicit methods are tried: forces do not say their derivatives,
# which take as many evaluations.
MAX_UNKNOWNS = 30
# Evaluations in a step that are enough to tell that a method is not for it.
MAX_EVALUATIONS = 1000


class ParticleTrial:
    """Particles, in the way of their file and in others.

    Attributes:
        name: Of them.
        kind: ``particles``.
        span: How long they are simulated [s].
        chosen: The way of the file.

    Args:
        made: Returns what there is, simulated as options say, each time at its
            beginning; None is as the file says.
        begin: Time of the first step [s].
        times: When to look, ascending ``(F,)`` [s].
    """

    kind = "particles"

    def __init__(
        self,
        made: Callable[[IntegrateOptions | None], Particles],
        begin: float,
        times: FloatArray,
    ) -> None:
        setup = made(None)
        self.name = setup.name
        self.span = float(times[-1]) - begin
        self._setup, self._made = setup, made
        self._begin, self._times = begin, times
        assert setup.options.step is not None
        self._step = setup.options.step
        self.chosen = self._setting(setup.options)
        # Particles at once in any run so far.
        self._most = 0

    def settings(self) -> list[Setting]:
        """Return each integrator with several steps or tolerances."""
        options = self._setup.options
        found = []
        for method in INTEGRATORS:
            integrator = find_integrator(method)
            own = method == options.method
            if integrator.control is Control.FIXED:
                found += stepwise(method, self._step)
                continue
            longest = self._step if own else LONGER * self._step
            usual = options.relative if own else TOLERANCE
            found += [
                Setting.of(method, step=longest, tolerance=value)
                for value in ladder(usual, TOLERANCES)
            ]
        return found

    def references(self) -> list[list[Setting]]:
        """Return finer and finer steps of the classical method of order four.

        Where it is not stable, those of the file's own method, or far shorter ones.
        """
        own = self._setup.options.method
        methods = [(EXACT, 1.0), (EXACT, MUCH_FINER)]
        if own != EXACT and find_integrator(own).control is Control.FIXED:
            methods.insert(1, (own, 1.0))
        return [
            stepwise(method, share * self._step, FINER) for method, share in methods
        ]

    def run(self, setting: Setting) -> Outcome:
        """Simulate the particles in one way.

        Raises:
            OptionError: The method is not for them (SIM006), or for so many (SIM024).
        """
        self._check_size(setting)
        setup = self._made(self._options(setting))
        solver = find_integrator(setting.method).solver
        if solver:
            # What it takes to import is no part of the simulation.
            load_object(solver)
        began = time.perf_counter()
        run = ParticleRun(setup, self._begin)
        frames: list[ParticleFrame] = []
        energies: list[Energy | None] = []
        stats, reason = None, ""
        try:
            for t in self._times.tolist():
                frames.append(run.at(t))
                energies.append(run.diagnostics.energy)
        except ToleranceError as error:
            stats = error.stats if isinstance(error, StoppedError) else None
            reason = stats.reason if stats else error.faults[0].message
        seconds = time.perf_counter() - began
        self._most = max([self._most, *(len(frame.ids) for frame in frames)])
        stable = None if stats is None else stats.stable_step
        if stable is None:
            last = run.simulation.diagnostics(run.state.state, run.begin)
            stable = last.stable_step()
        return Outcome(
            seconds,
            run.diagnostics.steps or 0,
            [Shot(frame.points, frame.ids) for frame in frames],
            Status.OK if stats is None else stats.status,
            reason,
            stable,
            _held(frames, energies),
        )

    def _check_size(self, setting: Setting) -> None:
        unknowns = 3 * self._most
        integrator = find_integrator(setting.method)
        if setting.method == self.chosen.method or not integrator.implicit:
            return
        if unknowns > MAX_UNKNOWNS:
            message = f"{setting.method} would solve for {unknowns} unknowns at once"
            raise OptionError(Fault("SIM024", message, where="method"))

    def _setting(self, options: IntegrateOptions) -> Setting:
        pairs = [("step", self._step)]
        if find_integrator(options.method).control is not Control.FIXED:
            pairs.append(("tolerance", options.relative))
        return Setting(options.method, tuple(pairs))

    def _options(self, setting: Setting) -> IntegrateOptions:
        own = self._setup.options
        given = dict(setting.options)
        tolerance = given.get("tolerance")
        budget = own.budget
        if setting.method != own.method:
            budget = min(budget, MAX_EVALUATIONS)
        # What is absolute goes with the tolerance where the file says both.
        absolute = own.absolute
        if absolute is not None and tolerance is not None:
            absolute *= tolerance / own.relative
        return replace(
            own,
            method=setting.method,
            step=given["step"],
            tolerance=tolerance,
            absolute=None if tolerance is None else absolute,
            budget=budget,
        )


def _held(
    frames: Sequence[ParticleFrame], energies: Sequence[Energy | None]
) -> list[Energy] | None:
    """Return energies, if they are all known and of the same particles."""
    known = [energy for energy in energies if energy is not None]
    same = all(np.array_equal(frame.ids, frames[0].ids) for frame in frames)
    return known if same and len(known) == len(frames) else None
