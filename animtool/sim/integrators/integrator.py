"""The table of integrators, imported when first used, and its entries."""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import StrEnum
from typing import TypeAlias, cast

from animtool.core.array_types import FloatArray
from animtool.core.names import check_known_name
from animtool.core.plugins import load_object
from animtool.core.record import dataclass
from animtool.sim.equations import Equations
from animtool.sim.stability import Limit


class EquationForm(StrEnum):
    """The form of equations that a method needs.

    Attributes:
        RATES: Rates of the full state, which every system has.
        ACCELERATIONS: Separate positions, velocities and accelerations.
    """

    RATES = "rates"
    ACCELERATIONS = "accelerations"


class StepControl(StrEnum):
    """How the step size is chosen.

    Attributes:
        FIXED: By the caller.
        ADAPTIVE: By the method, from error estimates.
        SCIPY: By a solver of SciPy.
    """

    FIXED = "fixed"
    ADAPTIVE = "adaptive"
    SCIPY = "scipy"


@dataclass(frozen=True, slots=True)
class StepResult:
    """State after a step, with the error estimate and memory of the method."""

    state: FloatArray  # state after the step
    memory: object = None  # data for the next step
    # Error estimate in the state's shape; None if there is no estimate.
    error: FloatArray | None = None


# Function of equations, time [s], state, step [s] and memory that returns the result.
# Memory is None at the start and after the state was changed from outside; the result
# is None if an implicit step did not converge.
StepFunction: TypeAlias = Callable[
    [Equations, float, FloatArray, float, object], StepResult | None
]


@dataclass(frozen=True, slots=True)
class Integrator:
    """An entry of the table of integrators.

    Attributes:
        name: Name in options.
        summary: Description of one line.
        order: Order of accuracy: halving the step divides the error by 2 to this power.
        form: Form of equations that it needs.
        control: How the step size is chosen.
        step: Function of one step; None for SciPy's solvers.
        limit: Largest stable step; None if the method controls its steps itself.
        stability_polynomial: Coefficients of R, ascending: a step multiplies
            ``y' = λ y`` by R(h λ). Empty unless the method is explicit and uses rates.
        drag_order: Order if accelerations depend on velocities; None is `order`.
        evaluations: Evaluations of rates or accelerations in a step; None if it varies.
        error_order: Power of the step size to which the error estimate is proportional;
            0 if there is no estimate.
        is_multistep: Whether a step uses previous steps.
        is_implicit: Whether a step solves equations.
        is_symplectic: Whether it preserves phase-space area: the energy of systems
            without drag then oscillates, but does not drift.
        is_reversible: Whether a backward step undoes a step, up to rounding.
        solver: Class of the SciPy solver, ``module:object``.
    """

    name: str
    summary: str
    order: int
    form: EquationForm = EquationForm.RATES
    control: StepControl = StepControl.FIXED
    step: StepFunction | None = None
    limit: Limit | None = None
    stability_polynomial: tuple[float, ...] = ()
    drag_order: int | None = None
    evaluations: int | None = None
    error_order: int = 0
    is_multistep: bool = False
    is_implicit: bool = False
    is_symplectic: bool = False
    is_reversible: bool = False
    solver: str = ""

    def largest_step(self, omega: float, damping_ratio: float = 0.0) -> float | None:
        """Return the largest stable step of ``x'' + 2 ζ ω x' + ω² x = 0`` [s].

        Args:
            omega: Angular frequency ω [rad/s], above 0.
            damping_ratio: ζ [1], 0 or more.

        0 if no step is stable, infinite if all are, None if the method controls its
        steps itself.
        """
        return None if self.limit is None else self.limit(omega, damping_ratio)


def allowed_step(integrator: Integrator, modes: FloatArray) -> float | None:
    """Return the largest step that is stable for all modes [s].

    ``modes``: angular frequencies [rad/s] and damping ratios [1] ``(M, 2)``.

    >>> import numpy as np
    >>> slow = np.array([[100.0, 0.0]])
    >>> round(allowed_step(find_integrator("symplectic_euler"), slow), 9)
    0.02
    """
    oscillating_modes = modes[modes[:, 0] > 0].tolist()
    steps = [
        integrator.largest_step(omega, max(0.0, damping))
        for omega, damping in oscillating_modes
    ]
    limits = [step for step in steps if step is not None]
    if len(limits) < len(steps):
        return None
    return min(limits, default=math.inf)


_PACKAGE = "animtool.sim.integrators"
# Modules of the integrators, sorted from simple to complex.
_MODULE_BY_NAME = {
    "euler": "explicit",
    "modified_euler": "explicit",
    "midpoint": "explicit",
    "heun": "explicit",
    "symplectic_euler": "symplectic",
    "velocity_verlet": "symplectic",
    "position_verlet": "symplectic",
    "rk4": "explicit",
    "adaptive_doubling": "adaptive",
    "rk45": "adaptive",
    "implicit_euler": "implicit",
    "trapezoid": "implicit",
    "bdf2": "implicit",
    "dop853": "adaptive",
    "lsoda": "adaptive",
    "radau": "adaptive",
}
INTEGRATORS: dict[str, str] = {
    name: f"{_PACKAGE}.{family}:{name.upper()}"
    for name, family in _MODULE_BY_NAME.items()
}


def find_integrator(name: str) -> Integrator:
    """Return an integrator by name.

    Raises:
        OptionError: The integrator is unknown (SIM001).

    >>> find_integrator("rk4").order
    4
    """
    check_known_name(name, INTEGRATORS, "integrator", "SIM001")
    return cast(Integrator, load_object(INTEGRATORS[name]))
