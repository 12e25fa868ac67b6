"""Equations of motion of a system, with an evaluation count and fixed particles."""

from __future__ import annotations

from typing import cast

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.sim.system import FirstOrder, Matrix, SecondOrder


class Equations:
    """The rate of a first- or second-order system.

    Rates at the anchored and at the last evaluated state are cached. This saves
    evaluations when a step is retried, and when the last stage of a step is the first
    of the next one. States are compared by identity.
    """

    def __init__(self, system: FirstOrder | SecondOrder) -> None:
        self.system = system
        # Distinguished by one attribute each: an isinstance check of a protocol takes
        # as long as a step.
        second_order, first_order = (
            hasattr(system, name) for name in ("acceleration", "rate")
        )
        self.second_order = cast("SecondOrder", system) if second_order else None
        self.first_order = cast("FirstOrder", system) if first_order else None
        self.evaluations = 0
        fixed = None if self.second_order is None else self.second_order.fixed
        self._fixed = None if fixed is None else np.asarray(fixed, bool)[:, None]
        self._anchor: tuple[float, FloatArray] | None = None
        self._anchor_rate: FloatArray | None = None
        self._last_rate: tuple[float, FloatArray, FloatArray] | None = None

    def set_anchor(self, t: float, y: FloatArray) -> None:
        """Mark a state whose rate is cached once it has been evaluated."""
        if self._anchor and self._anchor[1] is y and self._anchor[0] == t:
            return
        last = self._last_rate
        is_same_state = last is not None and last[1] is y and last[0] == t
        self._anchor = (t, y)
        self._anchor_rate = last[2] if last is not None and is_same_state else None

    def rate(self, t: float, y: FloatArray) -> FloatArray:
        """Return the time derivative of a state, in the shape of the state."""
        anchor = self._anchor
        if anchor is not None and anchor[1] is y and anchor[0] == t:
            if self._anchor_rate is None:
                self._anchor_rate = self._evaluate(t, y)
            return self._anchor_rate
        rates = self._evaluate(t, y)
        self._last_rate = (t, y, rates)
        return rates

    def _evaluate(self, t: float, y: FloatArray) -> FloatArray:
        """Evaluate the time derivative of a state."""
        if self.first_order is not None:
            self.evaluations += 1
            return self.first_order.rate(t, y)
        x, v = y
        return np.array((v, self.acceleration(t, x, v)))

    def acceleration(self, t: float, x: FloatArray, v: FloatArray) -> FloatArray:
        """Return accelerations ``(N, d)``; those of fixed particles are 0."""
        assert self.second_order is not None
        self.evaluations += 1
        accelerations = self.second_order.acceleration(t, x, v)
        if self._fixed is None:
            return accelerations
        return np.where(self._fixed, 0.0, accelerations)

    def jacobian(self, t: float, y: FloatArray) -> Matrix | None:
        """Return the Jacobian of a first-order rate; None if unknown."""
        assert self.first_order is not None
        return self.first_order.jacobian(t, y)

    def jacobians(
        self, t: float, x: FloatArray, v: FloatArray
    ) -> tuple[Matrix, Matrix] | None:
        """Return Jacobians of the accelerations; rows of fixed particles are 0."""
        assert self.second_order is not None
        matrices = self.second_order.jacobians(t, x, v)
        if matrices is None or self._fixed is None:
            return matrices
        is_free = np.broadcast_to(~self._fixed, x.shape).ravel().astype(np.float64)
        da_dx, da_dv = (_scale_rows(matrix, is_free) for matrix in matrices)
        return da_dx, da_dv


def _scale_rows(matrix: Matrix, factors: FloatArray) -> Matrix:
    """Return a matrix with each row multiplied by a factor."""
    if isinstance(matrix, np.ndarray):
        return factors[:, None] * matrix
    from scipy.sparse import diags_array

    return diags_array(factors) @ matrix
