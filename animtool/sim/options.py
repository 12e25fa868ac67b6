"""Integration options."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from animtool.core.errors import Fault, OptionError
from animtool.core.options import above, at_least, range_faults
from animtool.core.record import dataclass
from animtool.sim.integrators.integrator import Integrator, StepControl, find_integrator

# Default tolerance of adaptive methods.
DEFAULT_TOLERANCE = 1e-6
# SciPy's solvers accept no smaller tolerance.
MIN_TOLERANCE = 3e-14
# Factors of the step and of the tolerance of a finer run, for comparison.
FINER_STEP, FINER_TOLERANCE = 0.5, 0.01


@dataclass(frozen=True, slots=True)
class IntegrateOptions:
    """Options of an integration.

    Attributes:
        method: A name of `INTEGRATORS`.
        step: Longest step [s]: fixed-step methods divide the time between two
            samples equally; for adaptive methods it is a bound, None for no bound.
        tolerance: Largest relative error of an adaptive step in any component [1];
            None is 1e-6.
        absolute: Absolute tolerance in the state's units, added to the relative one;
            None is `tolerance`.
        base: Method whose steps ``adaptive_doubling`` uses.
        floor: Shortest step of adaptive methods [s].
        budget: Largest number of evaluations of rates or accelerations.
        growth: Gain of energy at which a motion has blown up, relative to the initial
            and the supplied energy. With stable steps just below the limit, energy may
            still vary a hundredfold.
        stretch: Length of a spring over its rest length at which it has blown up.
        estimate: Whether to integrate again with half the step or a hundredth of the
            tolerance, to estimate the error; takes about three times as long.
    """

    method: str = "rk45"
    step: Annotated[float | None, above(0, "SIM004", finite=True)] = None
    tolerance: Annotated[
        float | None, at_least(MIN_TOLERANCE, "SIM004", finite=True)
    ] = None
    absolute: Annotated[float | None, at_least(0, "SIM004")] = None
    base: str = "rk4"
    floor: Annotated[float, at_least(0, "SIM004")] = 1e-12
    budget: Annotated[int, at_least(1, "SIM004")] = 10_000_000
    growth: Annotated[float, above(0, "SIM004")] = 100.0
    stretch: Annotated[float, above(1, "SIM004")] = 10.0
    estimate: bool = False

    @property
    def rtol(self) -> float:
        """Relative tolerance of adaptive methods [1]."""
        return DEFAULT_TOLERANCE if self.tolerance is None else self.tolerance

    @property
    def atol(self) -> float:
        """Absolute tolerance of adaptive methods, in units of the state."""
        return self.rtol if self.absolute is None else self.absolute


def checked_integrator(options: IntegrateOptions) -> Integrator:
    """Return the integrator that options name; raise if they are invalid."""
    integrator = _find_named_integrator(options)
    is_fixed = integrator.control is StepControl.FIXED
    faults = range_faults(options) + _method_faults(options, is_fixed=is_fixed)
    if faults:
        raise OptionError(faults)
    return integrator


def finer_options(options: IntegrateOptions) -> IntegrateOptions:
    """Return the options of a more accurate run that estimates the error.

    >>> finer_options(IntegrateOptions("rk4", step=0.1)).step
    0.05
    """
    if _find_named_integrator(options).control is StepControl.FIXED:
        assert options.step is not None
        return replace(options, step=options.step * FINER_STEP, estimate=False)
    return replace(
        options,
        tolerance=max(options.rtol * FINER_TOLERANCE, MIN_TOLERANCE),
        absolute=options.atol * FINER_TOLERANCE,
        estimate=False,
    )


def _find_named_integrator(options: IntegrateOptions) -> Integrator:
    """Return the integrator that options name."""
    integrator = find_integrator(options.method)
    if options.method == "adaptive_doubling" and options.base != "rk4":
        from animtool.sim.integrators.adaptive import step_doubling

        return step_doubling(find_integrator(options.base))
    return integrator


def _method_faults(options: IntegrateOptions, *, is_fixed: bool) -> list[Fault]:
    """Return a fault for each option that is missing or that the method ignores."""
    faults = []
    if is_fixed and options.step is None:
        message = f"{options.method} needs a step"
        hint = "set one in seconds, or use an adaptive method, such as rk45"
        faults.append(Fault("SIM005", message, where="step", hint=hint))
    tolerances = {"tolerance": options.tolerance, "absolute": options.absolute}
    for name in [
        name for name, value in tolerances.items() if is_fixed and value is not None
    ]:
        message = f"{options.method} has a fixed step and ignores {name}"
        hint = f"remove {name}, or use an adaptive method, such as rk45"
        faults.append(Fault("SIM005", message, where=name, hint=hint))
    return faults
