"""Adaptive methods: step doubling, an embedded pair, and SciPy's solvers.

References:
    J. R. Dormand, P. J. Prince, A family of embedded Runge-Kutta formulae, Journal of
    Computational and Applied Mathematics 6, 1980, table 2 (RK5(4)7M).
"""

from __future__ import annotations

from dataclasses import replace

from numpy.polynomial import polynomial as poly

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError
from animtool.sim.equations import Equations
from animtool.sim.integrators.explicit import RK4, Tableau
from animtool.sim.integrators.integrator import Integrator, StepControl, StepResult
from animtool.sim.stability import rate_limit


def step_doubling(base: Integrator) -> Integrator:
    """Return a fixed-step method made adaptive by step doubling.

    The error of the two half steps is estimated from their difference to the full step,
    and added to the state: so the order is one more than that of the base.
    """
    step = base.step
    if step is None or base.control is not StepControl.FIXED or base.is_multistep:
        message = f"{base.name} cannot be the base of adaptive_doubling"
        hint = "use one with fixed steps, such as rk4 or implicit_euler"
        raise OptionError(Fault("SIM006", message, where="base", hint=hint))
    error_factor = 1 / (2**base.order - 1)
    stability_polynomial = _doubling_polynomial(base.stability_polynomial, error_factor)

    def doubled_step(
        equations: Equations, t: float, y: FloatArray, h: float, memory: object
    ) -> StepResult | None:
        full_step = step(equations, t, y, h, None)
        first_half = step(equations, t, y, h / 2, None)
        if full_step is None or first_half is None:
            return None
        second_half = step(
            equations, t + h / 2, first_half.state, h / 2, first_half.memory
        )
        if second_half is None:
            return None
        error = error_factor * (second_half.state - full_step.state)
        return StepResult(second_half.state + error, error=error)

    return replace(
        base,
        name="adaptive_doubling",
        summary="one step and two half steps, until they agree",
        order=base.order + 1,
        control=StepControl.ADAPTIVE,
        step=doubled_step,
        limit=rate_limit(stability_polynomial) if stability_polynomial else None,
        stability_polynomial=stability_polynomial,
        drag_order=None,
        evaluations=base.evaluations and 3 * base.evaluations,
        error_order=base.order + 1,
        is_symplectic=False,
        is_reversible=False,
    )


def _doubling_polynomial(
    base_polynomial: tuple[float, ...], error_factor: float
) -> tuple[float, ...]:
    """Return the stability polynomial of two corrected half steps; may be empty."""
    if not base_polynomial:
        return ()
    half_step_polynomial = [c / 2**i for i, c in enumerate(base_polynomial)]
    squared_polynomial = poly.polymul(half_step_polynomial, half_step_polynomial)
    polynomial = poly.polyadd(
        squared_polynomial * (1 + error_factor),
        poly.polymul(base_polynomial, [-error_factor]),
    )
    return tuple(polynomial.tolist())


ADAPTIVE_DOUBLING = step_doubling(RK4)

_FIFTH_ORDER_WEIGHTS = (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84)
_FOURTH_ORDER_WEIGHTS = (
    *(5179 / 57600, 0.0, 7571 / 16695, 393 / 640),
    *(-92097 / 339200, 187 / 2100, 1 / 40),
)
RK45 = Tableau(
    (0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0),
    (
        (),
        (1 / 5,),
        (3 / 40, 9 / 40),
        (44 / 45, -56 / 15, 32 / 9),
        (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
        (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
        _FIFTH_ORDER_WEIGHTS,
    ),
    (*_FIFTH_ORDER_WEIGHTS, 0.0),
    tuple(
        a - b
        for a, b in zip(
            (*_FIFTH_ORDER_WEIGHTS, 0.0), _FOURTH_ORDER_WEIGHTS, strict=True
        )
    ),
).integrator("rk45", "adaptive, six rates per step: for smooth motion, try it first", 5)
DOP853 = Integrator(
    "dop853",
    "scipy's, adaptive: for smooth motion to many digits",
    order=8,
    control=StepControl.SCIPY,
    solver="scipy.integrate:DOP853",
)
LSODA = Integrator(
    "lsoda",
    "scipy's, switches between methods for stiff and non-stiff systems",
    order=5,
    control=StepControl.SCIPY,
    is_implicit=True,
    solver="scipy.integrate:LSODA",
)
RADAU = Integrator(
    "radau",
    "scipy's, implicit, adaptive: for stiff systems",
    order=5,
    control=StepControl.SCIPY,
    is_implicit=True,
    solver="scipy.integrate:Radau",
)
