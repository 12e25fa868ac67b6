"""Systems made of plain functions."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from animtool._types import ArrayLike, BoolArray, FloatArray
from animtool.sim.system import Energy, FirstOrder, Matrix, SecondOrder

Rate: TypeAlias = Callable[[float, FloatArray], FloatArray]
Acceleration: TypeAlias = Callable[[float, FloatArray, FloatArray], FloatArray]
EnergyOf: TypeAlias = Callable[[float, FloatArray], Energy]
Jacobian: TypeAlias = Callable[[float, FloatArray], Matrix]
Jacobians: TypeAlias = Callable[[float, FloatArray, FloatArray], tuple[Matrix, Matrix]]


class _Known:
    """What of a system is given as functions and values."""

    def __init__(
        self, state: FloatArray, energy: EnergyOf | None, frequencies: ArrayLike | None
    ) -> None:
        self._state = state
        self._energy = energy
        self._frequencies = (
            None
            if frequencies is None
            else np.atleast_2d(np.asarray(frequencies, np.float64))
        )

    @property
    def state(self) -> FloatArray:
        """Where it starts."""
        return self._state

    def energy(self, t: float, state: FloatArray) -> Energy | None:
        """Return the energy of a state."""
        return None if self._energy is None else self._energy(t, state)

    def frequencies(self, t: float, state: FloatArray) -> FloatArray | None:  # noqa: ARG002
        """Return the fastest motions ``(M, 2)``."""
        return self._frequencies


class RateSystem(_Known, FirstOrder):
    """A function of time and state to the state's rate; a velocity field, say.

    Args:
        rate: From time [s] and state to its rate of change.
        state: Where it starts, of any shape: for N particles in a field ``(N, d)``.
        jacobian: Derivative of the rate by the state, flat.
        energy: Of a time and state, or another quantity that ought to stay.
        frequencies: Its fastest motions, see `System.frequencies`.

    >>> whirl = RateSystem(lambda t, y: np.stack([-y[:, 1], y[:, 0]], 1), [[1.0, 0.0]])
    >>> whirl.rate(0.0, whirl.state).tolist()
    [[-0.0, 1.0]]
    """

    def __init__(
        self,
        rate: Rate,
        state: ArrayLike,
        *,
        jacobian: Jacobian | None = None,
        energy: EnergyOf | None = None,
        frequencies: ArrayLike | None = None,
    ) -> None:
        super().__init__(np.array(state, np.float64), energy, frequencies)
        self._rate = rate
        self._jacobian = jacobian

    def rate(self, t: float, y: FloatArray) -> FloatArray:
        """Return the rate of change of a state."""
        return self._rate(t, y)

    def jacobian(self, t: float, y: FloatArray) -> Matrix | None:
        """Return the derivative of the rate by the state."""
        return None if self._jacobian is None else self._jacobian(t, y)


class ForceSystem(_Known, SecondOrder):
    """A function of time, positions and velocities to accelerations.

    Args:
        acceleration: From time [s], positions and velocities ``(N, d)`` to
            accelerations ``(N, d)`` [m/s²].
        positions: At the start ``(N, d)`` [m].
        velocities: At the start ``(N, d)`` [m/s]; None is at rest.
        jacobians: Derivatives of accelerations by positions and by velocities.
        energy: Of a time and state.
        frequencies: Its fastest motions, see `System.frequencies`.
        fixed: Particles that keep their velocity ``(N,)``.
        velocity_dependent: Whether accelerations depend on velocities.

    >>> fall = ForceSystem(lambda t, x, v: np.full_like(x, -9.81), [[0.0]])
    >>> fall.state.shape
    (2, 1, 1)
    """

    def __init__(
        self,
        acceleration: Acceleration,
        positions: ArrayLike,
        velocities: ArrayLike | None = None,
        *,
        jacobians: Jacobians | None = None,
        energy: EnergyOf | None = None,
        frequencies: ArrayLike | None = None,
        fixed: BoolArray | None = None,
        velocity_dependent: bool = True,
    ) -> None:
        places = np.asarray(positions, np.float64)
        speeds = np.zeros_like(places) if velocities is None else velocities
        super().__init__(
            np.stack([places, np.asarray(speeds, np.float64)]), energy, frequencies
        )
        self._acceleration = acceleration
        self._jacobians = jacobians
        self.fixed = fixed
        self.velocity_dependent = velocity_dependent

    def acceleration(self, t: float, x: FloatArray, v: FloatArray) -> FloatArray:
        """Return accelerations at positions and velocities."""
        return self._acceleration(t, x, v)

    def jacobians(
        self, t: float, x: FloatArray, v: FloatArray
    ) -> tuple[Matrix, Matrix] | None:
        """Return the derivatives of accelerations by positions and by velocities."""
        return None if self._jacobians is None else self._jacobians(t, x, v)

    def suspect(self, t: float, state: FloatArray) -> str:
        """Return which particle is accelerated most."""
        pulls = np.linalg.norm(self._acceleration(t, *state), axis=1)
        return f"particle {int(np.argmax(pulls))} is accelerated most"
