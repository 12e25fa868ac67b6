"""A system's equations of motion: evaluations counted, fixed particles held."""

from __future__ import annotations

from typing import cast

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.sim.system import FirstOrder, Matrix, SecondOrder


class Equations:
    """The rate of a first- or second-order system.

    Rates at the anchored state and at the last evaluated one are cached: this saves
    evaluations in retried steps, and where the last stage of a step is the first of
    the next. Arrays are compared by identity.
    """

    def __init__(self, system: FirstOrder | SecondOrder) -> None:
        self.system = system
        # Told apart by one attribute each: an isinstance check of a protocol takes as
        # long as a step.
        second, first = (hasattr(system, name) for name in ("acceleration", "rate"))
        self.second = cast("SecondOrder", system) if second else None
        self.first = cast("FirstOrder", system) if first else None
        self.evaluations = 0
        fixed = None if self.second is None else self.second.fixed
        self._fixed = None if fixed is None else np.asarray(fixed, bool)[:, None]
        self._anchor: tuple[float, FloatArray] | None = None
        self._anchored: FloatArray | None = None
        self._last: tuple[float, FloatArray, FloatArray] | None = None

    def anchor(self, t: float, y: FloatArray) -> None:
        """Cache the rate at a state once it is evaluated."""
        if self._anchor and self._anchor[1] is y and self._anchor[0] == t:
            return
        last = self._last
        known = last is not None and last[1] is y and last[0] == t
        self._anchor = (t, y)
        self._anchored = last[2] if last is not None and known else None

    def rate(self, t: float, y: FloatArray) -> FloatArray:
        """Return the time derivative of a state, in its shape."""
        anchor = self._anchor
        if anchor is not None and anchor[1] is y and anchor[0] == t:
            if self._anchored is None:
                self._anchored = self._evaluate(t, y)
            return self._anchored
        rates = self._evaluate(t, y)
        self._last = (t, y, rates)
        return rates

    def _evaluate(self, t: float, y: FloatArray) -> FloatArray:
        if self.first is not None:
            self.evaluations += 1
            return self.first.rate(t, y)
        x, v = y
        return np.array((v, self.acceleration(t, x, v)))

    def acceleration(self, t: float, x: FloatArray, v: FloatArray) -> FloatArray:
        """Return accelerations ``(N, d)``, 0 for fixed particles."""
        assert self.second is not None
        self.evaluations += 1
        accelerations = self.second.acceleration(t, x, v)
        return (
            accelerations
            if self._fixed is None
            else np.where(self._fixed, 0.0, accelerations)
        )

    def jacobian(self, t: float, y: FloatArray) -> Matrix | None:
        """Return the Jacobian of a first-order rate; None if unknown."""
        assert self.first is not None
        return self.first.jacobian(t, y)

    def jacobians(
        self, t: float, x: FloatArray, v: FloatArray
    ) -> tuple[Matrix, Matrix] | None:
        """Return Jacobians of the accelerations, 0 for fixed particles."""
        assert self.second is not None
        matrices = self.second.jacobians(t, x, v)
        if matrices is None or self._fixed is None:
            return matrices
        free = np.broadcast_to(~self._fixed, x.shape).ravel().astype(np.float64)
        by_x, by_v = (_scaled_rows(matrix, free) for matrix in matrices)
        return by_x, by_v


def _scaled_rows(matrix: Matrix, factors: FloatArray) -> Matrix:
    if isinstance(matrix, np.ndarray):
        return factors[:, None] * matrix
    from scipy.sparse import diags_array

    return diags_array(factors) @ matrix
