"""Explicit Runge-Kutta methods, of which a tableau says all.

References:
    J. C. Butcher, Numerical Methods for Ordinary Differential Equations, 2016, 23.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animtool._types import FloatArray
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import Step


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
