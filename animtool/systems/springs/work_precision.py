"""Solver settings of springs for work-precision tables."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
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

    def setting_of(solver: Solver, solver_options: SpringOptions) -> Setting:
        """Return a solver with its default step."""
        choice = choose_solver(system, solver_options, solver, begin, system.state)
        return Setting.of(choice.solver, step=choice.cell / choice.substeps)

    configured = setting_of(Solver(options.solver), options)
    defaults: dict[str, Setting] = {}
    for solver in Solver:
        # Solvers that cannot simulate the springs are left out.
        with suppress(OptionError):
            if solver is not Solver.AUTO:
                defaults[solver] = setting_of(solver, replace(options, step=None))
    settings = [
        row
        for method, setting in defaults.items()
        for row in step_settings(
            method, (configured if method == configured.method else setting)["step"]
        )
    ]
    # Finer steps of bdf2, of explicit Euler, and of the chosen solver.
    reference_steps: dict[str, float] = {}
    if REFERENCE_SOLVER in defaults:
        step = min(configured["step"], defaults[REFERENCE_SOLVER]["step"])
        reference_steps[REFERENCE_SOLVER] = step
    if STIFF_REFERENCE_SOLVER in defaults:
        step = defaults[STIFF_REFERENCE_SOLVER]["step"]
        reference_steps[STIFF_REFERENCE_SOLVER] = step
    if configured.method not in {REFERENCE_SOLVER, STIFF_REFERENCE_SOLVER}:
        reference_steps[configured.method] = configured["step"]
    references = [
        step_settings(method, step, REFERENCE_FACTORS)
        for method, step in reference_steps.items()
    ]

    def changed_keys(setting: Setting) -> Mapping[str, Any]:
        if setting == configured:
            return {"error": None, "solver": options.solver, "step": options.step}
        return {"error": None, "solver": setting.method, "step": setting["step"]}

    return TrialSettings(configured, lambda: settings, lambda: references, changed_keys)
