"""Explicit methods: Euler, its variants, and Runge-Kutta tableaus.

The modified Euler method sets ``v + h a``, and positions move by ``h v + h² a / 2``.

References:
    J. C. Butcher, Numerical Methods for Ordinary Differential Equations, 2016, 23.
"""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import (
    EquationForm,
    Integrator,
    StepControl,
    StepResult,
)
from animtool.sim.stability import jury_limit, rate_limit


@dataclass(frozen=True, slots=True)
class Tableau:
    """An explicit Runge-Kutta method of S stages."""

    # Stage times within the step ``(S,)`` [1]; the first is 0.
    nodes: tuple[float, ...]
    stage_weights: tuple[
        tuple[float, ...], ...
    ]  # weights of the previous stages, S tuples
    weights: tuple[float, ...]  # weights of the stages ``(S,)``
    # Error weights ``(S,)``; empty if it has no embedded estimate.
    error_weights: tuple[float, ...] = ()

    def step(
        self, equations: Equations, t: float, y: FloatArray, h: float, memory: object
    ) -> StepResult:
        """Return the state after one step of the Runge-Kutta method.

        If the last stage is at the step's end, it is the new state; its rate is reused
        by the next step.
        """
        rates: list[FloatArray] = []
        stage = y
        for node, row in zip(self.nodes, self.stage_weights, strict=True):
            stage = _add_rates(y, h, row, rates)
            rates.append(equations.rate(t + node * h, stage))
        state = stage if self.first_as_last else _add_rates(y, h, self.weights, rates)
        if not self.error_weights:
            return StepResult(state)
        error = _add_rates(np.zeros_like(y), h, self.error_weights, rates)
        return StepResult(state, error=error)

    @property
    def first_as_last(self) -> bool:
        """Whether the method is FSAL: the last stage is at the end of the step."""
        return self.stage_weights[-1] + (0.0,) == self.weights

    def integrator(self, name: str, summary: str, order: int) -> Integrator:
        """Return the method's table entry; error weights make it adaptive."""
        stability_polynomial = self.stability_polynomial()
        return Integrator(
            name,
            summary,
            order=order,
            control=StepControl.ADAPTIVE if self.error_weights else StepControl.FIXED,
            step=self.step,
            limit=rate_limit(stability_polynomial),
            stability_polynomial=stability_polynomial,
            evaluations=len(self.nodes) - self.first_as_last,
            error_order=order if self.error_weights else 0,
        )

    def stability_polynomial(self) -> tuple[float, ...]:
        """Return the stability polynomial R: a step multiplies ``y' = λ y`` by R(h λ).

        >>> Tableau((0.0, 0.5), ((), (0.5,)), (0.0, 1.0)).stability_polynomial()
        (1.0, 1.0, 0.5)
        """
        stage_count = len(self.nodes)
        matrix = np.zeros((stage_count, stage_count))
        for i, row in enumerate(self.stage_weights):
            matrix[i, : len(row)] = row
        powers, coefficients = np.ones(stage_count), [1.0]
        for _ in range(stage_count):
            coefficients.append(float(np.dot(self.weights, powers)))
            powers = matrix @ powers
        return tuple(coefficients)


def _add_rates(
    y: FloatArray, h: float, weights: tuple[float, ...], rates: list[FloatArray]
) -> FloatArray:
    """Return the state ``y`` plus the step times the weighted sum of stage rates."""
    for weight, rate in zip(weights, rates, strict=False):
        if weight:
            y = y + (h * weight) * rate
    return y


EULER = Tableau((0.0,), ((),), (1.0,)).integrator(
    "euler", "uses the rate at the start; gains energy, for comparison only", 1
)
MIDPOINT = Tableau((0.0, 0.5), ((), (0.5,)), (0.0, 1.0)).integrator(
    "midpoint", "uses the rate at the midpoint", 2
)
HEUN = Tableau((0.0, 1.0), ((), (1.0,)), (0.5, 0.5)).integrator(
    "heun", "uses the mean of the rates at both ends of an Euler step", 2
)
RK4 = Tableau(
    (0.0, 0.5, 0.5, 1.0),
    ((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)),
    (1 / 6, 1 / 3, 1 / 3, 1 / 6),
).integrator(
    "rk4", "four rates per step: accurate with fixed steps and smooth forces", 4
)


def modified_euler(
    equations: Equations, t: float, y: FloatArray, h: float, memory: object
) -> StepResult:
    """Advance a second-order state by one step of the modified Euler method.

    The position advances along the mean of the velocities at both ends.
    """
    x, v = y
    v_end = v + h * equations.acceleration(t, x, v)
    return StepResult(np.array((x + (0.5 * h) * (v + v_end), v_end)))


MODIFIED_EULER = Integrator(
    "modified_euler",
    "uses the mean of the velocities at both ends; exact in a uniform field",
    order=1,
    form=EquationForm.ACCELERATIONS,
    step=modified_euler,
    limit=jury_limit(lambda z: [2, -2 * z, -0.5], lambda z: [1, -2 * z, 0.5]),
    evaluations=1,
)
