"""Solver settings of springs for work-precision tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from animtool.core.errors import OptionError
from animtool.sim.trials.trial import REFERENCE_FACTORS, Setting, step_settings
from animtool.systems.framework.simulation import TrialSettings
from animtool.systems.springs.records import Solver, SpringOptions
from animtool.systems.springs.solvers import choose_solver
from animtool.systems.springs.system import SpringSystem

# Reference solver of a table, of second order and stable.
REFERENCE_SOLVER = Solver.BDF2
# Reference solver for springs too stiff for implicit steps.
STIFF_REFERENCE_SOLVER = Solver.SYMPLECTIC_EULER


def trial_settings(
    system: SpringSystem, options: SpringOptions, begin: float
) -> TrialSettings:
    """Return the settings to compare: solvers with steps around their defaults."""
    defaults = replace(options, step=None)

    def default_setting(
        solver: Solver, solver_options: SpringOptions = defaults
    ) -> Setting:
        """Return a solver with its default step."""
        choice = choose_solver(system, solver_options, solver, begin, system.state)
        return Setting.of(choice.solver, step=choice.cell / choice.substeps)

    configured_setting = default_setting(Solver(options.solver), options)

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
            configured_setting
            if setting.method == configured_setting.method
            else setting
            for setting in solver_settings
        ]
        return [
            row
            for setting in solver_settings
            for row in step_settings(setting.method, setting["step"])
        ]

    def references() -> list[list[Setting]]:
        """Return finer steps of bdf2, of explicit Euler, and of the chosen solver."""
        reference_steps = [
            min(configured_setting["step"], setting["step"])
            for setting in default_settings(REFERENCE_SOLVER)
        ]
        setting_groups = [
            step_settings(REFERENCE_SOLVER, step, REFERENCE_FACTORS)
            for step in reference_steps
        ]
        setting_groups += [
            step_settings(STIFF_REFERENCE_SOLVER, setting["step"], REFERENCE_FACTORS)
            for setting in default_settings(STIFF_REFERENCE_SOLVER)
        ]
        if configured_setting.method not in {REFERENCE_SOLVER, STIFF_REFERENCE_SOLVER}:
            setting_groups.append(
                step_settings(
                    configured_setting.method,
                    configured_setting["step"],
                    REFERENCE_FACTORS,
                )
            )
        return setting_groups

    def changed_keys(setting: Setting) -> Mapping[str, Any]:
        if setting == configured_setting:
            return {"error": None, "solver": options.solver, "step": options.step}
        return {"error": None, "solver": setting.method, "step": setting["step"]}

    return TrialSettings(configured_setting, settings, references, changed_keys)
