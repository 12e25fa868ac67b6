"""Explicit methods: Euler, its variants, and those of which a tableau says all.

The velocity at the end is ``v + h a``, so positions move by ``h v + h² a / 2``.

References:
    J. C. Butcher, Numerical Methods for Ordinary Differential Equations, 2016, 23.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import Form, Integrator, Step
from animtool.sim.stability import jury_limit, rate_limit


@dataclass(frozen=True, slots=True)
class Tableau:
    """An explicit method of S stages.

    Attributes:
        nodes: Where in the step each stage is ``(S,)`` [1]; the first is 0.
        rows: Weights of the stages before each, S tuples.
        weights: Of the stages in the step ``(S,)``.
        errors: Of the stages in the estimate of the error ``(S,)``; none of methods
            without one.
    """

    nodes: tuple[float, ...]
    rows: tuple[tuple[float, ...], ...]
    weights: tuple[float, ...]
    errors: tuple[float, ...] = ()

    def step(
        self,
        equations: Equations,
        t: float,
        y: FloatArray,
        h: float,
        memory: object,
    ) -> Step:
        """Return where a step leads; of every product, step times weight comes first.

        A last stage at the step's end is the state itself, whose rate the next step
        begins with.
        """
        rates: list[FloatArray] = []
        at = y
        for node, row in zip(self.nodes, self.rows, strict=True):
            at = _moved(y, h, row, rates)
            rates.append(equations.rate(t + node * h, at))
        ends = self.rows[-1] + (0.0,) == self.weights
        state = at if ends else _moved(y, h, self.weights, rates)
        if not self.errors:
            return Step(state)
        return Step(state, error=_moved(np.zeros_like(y), h, self.errors, rates))

    def growth(self) -> tuple[float, ...]:
        """Return the polynomial R of which ``y' = λ y`` grows by R(h λ) a step.

        >>> Tableau((0.0, 0.5), ((), (0.5,)), (0.0, 1.0)).growth()
        (1.0, 1.0, 0.5)
        """
        stages = len(self.nodes)
        matrix = np.zeros((stages, stages))
        for i, row in enumerate(self.rows):
            matrix[i, : len(row)] = row
        reached, coefficients = np.ones(stages), [1.0]
        for _ in range(stages):
            coefficients.append(float(np.dot(self.weights, reached)))
            reached = matrix @ reached
        return tuple(coefficients)


def _moved(
    y: FloatArray, h: float, weights: tuple[float, ...], rates: list[FloatArray]
) -> FloatArray:
    for weight, rate in zip(weights, rates, strict=False):
        if weight:
            y = y + (h * weight) * rate
    return y


EULER_TABLEAU = Tableau((0.0,), ((),), (1.0,))

EULER = Integrator(
    "euler",
    "along the rate at the start; grows without damping, for comparison only",
    order=1,
    step=EULER_TABLEAU.step,
    limit=rate_limit(EULER_TABLEAU.growth()),
    growth=EULER_TABLEAU.growth(),
    evaluations=1,
)


def _step(
    equations: Equations,
    t: float,
    y: FloatArray,
    h: float,
    memory: object,
) -> Step:
    x, v = y
    after = v + h * equations.acceleration(t, x, v)
    return Step(np.array((x + (0.5 * h) * (v + after), after)))


MODIFIED_EULER = Integrator(
    "modified_euler",
    "along the mean of the velocities at both ends; exact in a uniform field",
    order=1,
    form=Form.ACCELERATIONS,
    step=_step,
    limit=jury_limit(lambda z: [2, -2 * z, -0.5], lambda z: [1, -2 * z, 0.5]),
    evaluations=1,
)


MIDPOINT_TABLEAU = Tableau((0.0, 0.5), ((), (0.5,)), (0.0, 1.0))

MIDPOINT = Integrator(
    "midpoint",
    "along the rate at the middle of Euler's step",
    order=2,
    step=MIDPOINT_TABLEAU.step,
    limit=rate_limit(MIDPOINT_TABLEAU.growth()),
    growth=MIDPOINT_TABLEAU.growth(),
    evaluations=2,
)


HEUN_TABLEAU = Tableau((0.0, 1.0), ((), (1.0,)), (0.5, 0.5))

HEUN = Integrator(
    "heun",
    "along the mean of the rates at both ends of Euler's step",
    order=2,
    step=HEUN_TABLEAU.step,
    limit=rate_limit(HEUN_TABLEAU.growth()),
    growth=HEUN_TABLEAU.growth(),
    evaluations=2,
)


RK4_TABLEAU = Tableau(
    (0.0, 0.5, 0.5, 1.0),
    ((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)),
    (1 / 6, 1 / 3, 1 / 3, 1 / 6),
)

RK4 = Integrator(
    "rk4",
    "four rates a step: exact where steps are fixed and forces smooth",
    order=4,
    step=RK4_TABLEAU.step,
    limit=rate_limit(RK4_TABLEAU.growth()),
    growth=RK4_TABLEAU.growth(),
    evaluations=4,
)
