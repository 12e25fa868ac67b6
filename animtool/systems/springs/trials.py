"""Solver settings of springs for work-precision tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from animtool.core.errors import OptionError
from animtool.sim.trials.trial import REFERENCE_FACTORS, Setting, step_settings
from animtool.systems.framework.simulation import TrialSettings
from animtool.systems.springs.records import Solver, SpringOptions
from animtool.systems.springs.solvers import choose
from animtool.systems.springs.system import SpringSystem

# Reference method of a table: second order and stable.
EXACT = Solver.BDF2
# Reference for springs too stiff for implicit steps.
EXPLICIT = Solver.SYMPLECTIC_EULER


def trial_settings(
    system: SpringSystem, configured: SpringOptions, begin: float
) -> TrialSettings:
    """Return solvers with several step lengths around their defaults."""
    defaults = replace(configured, step=None)

    def default_setting(solver: Solver, options: SpringOptions = defaults) -> Setting:
        """Return a solver with its default step."""
        choice = choose(system, options, solver, begin, system.state)
        return Setting.of(choice.solver, step=choice.cell / choice.substeps)

    chosen = default_setting(Solver(configured.solver), configured)

    def default_settings(solver: Solver) -> list[Setting]:
        """Return the setting of a solver; empty if it cannot simulate the springs."""
        try:
            return [default_setting(solver)]
        except OptionError:
            return []

    def settings() -> list[Setting]:
        solver_settings = [
            setting
            for s in Solver
            if s is not Solver.AUTO
            for setting in default_settings(s)
        ]
        solver_settings = [
            chosen if setting.method == chosen.method else setting
            for setting in solver_settings
        ]
        return [
            row
            for setting in solver_settings
            for row in step_settings(setting.method, setting["step"])
        ]

    def references() -> list[list[Setting]]:
        """Return finer steps of bdf2, of explicit Euler, and of the chosen solver."""
        exact = [
            min(chosen["step"], setting["step"]) for setting in default_settings(EXACT)
        ]
        groups = [step_settings(EXACT, step, REFERENCE_FACTORS) for step in exact]
        groups += [
            step_settings(EXPLICIT, setting["step"], REFERENCE_FACTORS)
            for setting in default_settings(EXPLICIT)
        ]
        if chosen.method not in {EXACT, EXPLICIT}:
            groups.append(
                step_settings(chosen.method, chosen["step"], REFERENCE_FACTORS)
            )
        return groups

    def changes(setting: Setting) -> Mapping[str, Any]:
        if setting == chosen:
            return {"error": None, "solver": configured.solver, "step": configured.step}
        return {"error": None, "solver": setting.method, "step": setting["step"]}

    return TrialSettings(chosen, settings, references, changes)
