"""Settings of springs that a table of trials compares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from animtool.sim.trials.trial import FINER, Setting, stepwise
from animtool.systems.framework.simulation import TrialSettings
from animtool.systems.springs.records import Solver, SpringOptions
from animtool.systems.springs.solvers import choose
from animtool.systems.springs.system import SpringSystem

# What settings of a table are compared with: of the second order, and stable.
EXACT = Solver.BDF2
# Instead, where the stiffest springs let no implicit step be solved.
EXPLICIT = Solver.SYMPLECTIC_EULER


def trial_settings(
    system: SpringSystem, own: SpringOptions, begin: float
) -> TrialSettings:
    """Return solvers in several steps, about those that each takes itself."""
    free = replace(own, step=None)

    def usual(solver: Solver, options: SpringOptions = free) -> Setting:
        """Return a solver with the step that options come to."""
        choice = choose(system, options, solver, begin, system.state)
        return Setting.of(choice.solver, step=choice.cell / choice.substeps)

    chosen = usual(Solver(own.solver), own)

    def settings() -> list[Setting]:
        each = [usual(solver) for solver in Solver if solver is not Solver.AUTO]
        each = [chosen if one.method == chosen.method else one for one in each]
        return [way for one in each for way in stepwise(one.method, one["step"])]

    def references() -> list[list[Setting]]:
        """Return ever shorter steps of bdf2; of the explicit where that fails."""
        step = min(chosen["step"], usual(EXACT)["step"])
        return [
            stepwise(EXACT, step, FINER),
            stepwise(EXPLICIT, usual(EXPLICIT)["step"], FINER),
        ]

    def changes(setting: Setting) -> Mapping[str, Any]:
        if setting == chosen:
            return {"error": None, "solver": own.solver, "step": own.step}
        return {"error": None, "solver": setting.method, "step": setting["step"]}

    return TrialSettings(chosen, settings, references, changes)
