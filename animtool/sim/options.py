"""Integration options."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from animtool.core.errors import Fault, OptionError
from animtool.core.options import above, at_least, range_faults
from animtool.core.record import dataclass
from animtool.sim.integrators.adaptive import doubled
from animtool.sim.integrators.integrator import Integrator, StepControl
from animtool.sim.integrators.table import find_integrator

# Default tolerance of adaptive methods.
TOLERANCE = 1e-6
# SciPy's solvers accept no smaller tolerance.
MIN_TOLERANCE = 3e-14
# Factors of a finer run for comparison: of the step, and of the tolerance.
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
        absolute: The same, in the state's own units, added; None is `tolerance`.
        base: Method that ``adaptive_doubling`` takes its steps with.
        floor: Shortest step of adaptive methods [s].
        budget: Most evaluations of rates or accelerations.
        growth: Energy gained, in those of the start and what may be supplied, from
            which on a motion has blown up. Just below their limits, steps that are
            stable let energy swing by as much as a hundredfold.
        stretch: Length of a spring, in rest lengths, from which on it has.
        estimate: Integrate again, with half the step or a hundredth of the tolerance,
            and say how far the two are apart; takes about three times as long.
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
    def relative(self) -> float:
        """Relative tolerance of adaptive methods [1]."""
        return TOLERANCE if self.tolerance is None else self.tolerance

    @property
    def least(self) -> float:
        """Absolute tolerance, in units of the state."""
        return self.relative if self.absolute is None else self.absolute


def check_options(options: IntegrateOptions) -> Integrator:
    """Return the integrator that options name; raise if they are invalid.

    Raises:
        OptionError: All that is wrong (SIM001, SIM004, SIM005, SIM006).
    """
    integrator = _chosen(options)
    faults = _faults(options, integrator.control)
    if faults:
        raise OptionError(faults)
    return integrator


def finer(options: IntegrateOptions) -> IntegrateOptions:
    """Return options of a more accurate run, to compare with.

    >>> finer(IntegrateOptions("rk4", step=0.1)).step
    0.05
    """
    if _chosen(options).control is StepControl.FIXED:
        assert options.step is not None
        return replace(options, step=options.step * FINER_STEP, estimate=False)
    return replace(
        options,
        tolerance=max(options.relative * FINER_TOLERANCE, MIN_TOLERANCE),
        absolute=options.least * FINER_TOLERANCE,
        estimate=False,
    )


def _chosen(options: IntegrateOptions) -> Integrator:
    """Return the integrator that options name.

    Raises:
        OptionError: There is none of that name (SIM001), or it cannot be the base of
            step doubling (SIM006).
    """
    integrator = find_integrator(options.method)
    if options.method == "adaptive_doubling" and options.base != "rk4":
        return doubled(find_integrator(options.base))
    return integrator


def _faults(options: IntegrateOptions, control: StepControl) -> list[Fault]:
    """Return faults of options, for a kind of method."""
    return range_faults(options) + _unfit(options, fixed=control is StepControl.FIXED)


def _unfit(options: IntegrateOptions, *, fixed: bool) -> list[Fault]:
    """Return faults of options that a method requires or ignores."""
    faults = []
    if fixed and options.step is None:
        message = f"{options.method} needs a step"
        hint = "set one in seconds, or use an adaptive method, such as rk45"
        faults.append(Fault("SIM005", message, where="step", hint=hint))
    tolerances = {"tolerance": options.tolerance, "absolute": options.absolute}
    for name in [
        name for name, value in tolerances.items() if fixed and value is not None
    ]:
        message = f"{options.method} has a fixed step and ignores {name}"
        hint = f"remove {name}, or use an adaptive method, such as rk45"
        faults.append(Fault("SIM005", message, where=name, hint=hint))
    return faults
