"""Interface between integrators and systems, and systems defined by functions.

A system defines how its state changes; everything else is optional. Systems derive from
`FirstOrder` or `SecondOrder`, which have defaults for optional methods. Methods take
and return arrays of all N particles, and change none in place.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeAlias

import numpy as np

from animtool.core.array_types import ArrayLike, BoolArray, FloatArray
from animtool.core.errors import Fault
from animtool.core.record import dataclass

# A Jacobian: dense, or from scipy.sparse.
Matrix: TypeAlias = Any
# Maps time [s], state, step [s] and step count to the state after them.
NativeAdvance: TypeAlias = Callable[[float, FloatArray, float, int], FloatArray]


@dataclass(frozen=True, slots=True)
class Energy:
    """The energy of a state.

    Attributes:
        kinetic: Kinetic energy [J].
        potential: Potential energy of springs and fields, from any zero [J].
        supply: Energy that external forces (wind, motors, moving pins) may add [J]; 0
            without any. The order of magnitude is enough: a gain far beyond it counts
            as divergence.
    """

    kinetic: float
    potential: float = 0.0
    supply: float = 0.0

    @property
    def total(self) -> float:
        """Sum of kinetic and potential energy [J]."""
        return self.kinetic + self.potential


class System(Protocol):
    """A system with a state that changes over time.

    In all methods ``t`` is a time [s] and ``state`` has the shape of the initial state:
    any shape for `FirstOrder`, ``(2, N, d)`` for `SecondOrder`.

    Attributes:
        settles: Whether `settle` does anything; False by default.
    """

    settles: bool = False

    @property
    def state(self) -> FloatArray:
        """The initial state."""
        ...

    def energy(self, t: float, state: FloatArray) -> Energy | None:
        """Return the energy of a state; None if it is undefined or not meaningful."""
        return None

    def stretch(self, t: float, state: FloatArray) -> float | None:
        """Return the largest ratio of spring length to rest length [1], if known."""
        return None

    def frequencies(self, t: float, state: FloatArray) -> FloatArray | None:
        """Return the angular frequency [rad/s] and damping ratio of the fastest modes.

        One row (ω, ζ) of ``x'' + 2 ζ ω x' + ω² x = 0`` for each mode ``(M, 2)``; a
        decay ``y' = -k y`` is (k, 1), a rotation ``y' = i ω y`` is (ω, 0). Only modes
        that limit the step are needed: the stiffest, and for methods stabilised by
        damping also the least damped.
        """
        return None

    def settle(
        self, t: float, h: float, before: FloatArray, after: FloatArray
    ) -> FloatArray:
        """Return the state after a step's contacts, constraints and pins.

        Called after every accepted step of a system that `settles`.

        Args:
            t: Time at the end of the step [s].
            h: The step [s].
            before: State at the start of the step.
            after: State after the step; the same object is returned if unchanged.
        """
        return after

    def native(self, method: str) -> NativeAdvance | None:
        """Return a compiled loop that takes many steps in one call, if there is one.

        The loop must give the same result as the named method, including `settle`.
        """
        return None

    def notices(self) -> list[Fault]:
        """Return warnings about the initial state and the inputs."""
        return []

    def suspected_cause(self, t: float, state: FloatArray) -> str:
        """Return the likely cause of a failure, for messages; may be empty."""
        return ""


class FirstOrder(System, Protocol):
    """A system ``y' = rate(t, y)`` with a state of any shape."""

    def rate(self, t: float, y: FloatArray) -> FloatArray:
        """Return the time derivative of a state, in the shape of the state [1/s]."""
        ...

    def jacobian(self, t: float, y: FloatArray) -> Matrix | None:
        """Return the Jacobian of the flattened rate ``(n, n)``.

        Dense or sparse; None lets implicit methods use finite differences.
        """
        return None


class SecondOrder(System, Protocol):
    """N particles in d dimensions with ``x'' = acceleration(t, x, v)``.

    The state is ``(2, N, d)``: positions [m], then velocities [m/s].

    Attributes:
        fixed: Mask of particles of infinite mass, which keep their velocity ``(N,)``;
            None if there are none.
        velocity_dependent: Whether accelerations depend on velocities; if not, methods
            may evaluate them less often. True by default.
    """

    fixed: BoolArray | None = None
    velocity_dependent: bool = True

    def acceleration(self, t: float, x: FloatArray, v: FloatArray) -> FloatArray:
        """Return accelerations ``(N, d)`` [m/s²] at positions and velocities.

        Args:
            t: Time [s].
            x: Positions ``(N, d)`` [m].
            v: Velocities ``(N, d)`` [m/s].
        """
        ...

    def jacobians(
        self, t: float, x: FloatArray, v: FloatArray
    ) -> tuple[Matrix, Matrix] | None:
        """Return Jacobians of acceleration with respect to positions and velocities.

        Both ``(N d, N d)``, dense or sparse; None lets implicit methods use finite
        differences.
        """
        return None


Rate: TypeAlias = Callable[[float, FloatArray], FloatArray]
Acceleration: TypeAlias = Callable[[float, FloatArray, FloatArray], FloatArray]
EnergyOf: TypeAlias = Callable[[float, FloatArray], Energy]
Jacobian: TypeAlias = Callable[[float, FloatArray], Matrix]
Jacobians: TypeAlias = Callable[[float, FloatArray, FloatArray], tuple[Matrix, Matrix]]


class _FunctionSystem:
    """Optional parts of a system defined by functions."""

    def __init__(
        self, state: FloatArray, energy: EnergyOf | None, frequencies: ArrayLike | None
    ) -> None:
        self._state = state
        self._energy = energy
        self._frequencies = None
        if frequencies is not None:
            self._frequencies = np.atleast_2d(np.asarray(frequencies, np.float64))

    @property
    def state(self) -> FloatArray:
        """The initial state."""
        return self._state

    def energy(self, t: float, state: FloatArray) -> Energy | None:
        """Return the energy of a state."""
        return None if self._energy is None else self._energy(t, state)

    def frequencies(self, t: float, state: FloatArray) -> FloatArray | None:
        """Return the fastest modes ``(M, 2)``."""
        return self._frequencies


class RateSystem(_FunctionSystem, FirstOrder):
    """A first-order system from a function, such as a velocity field.

    Args:
        rate: Function of time [s] and state that returns the rate of change.
        state: Initial state of any shape; ``(N, d)`` for N particles in a field.
        jacobian: Function that returns the Jacobian of the flattened rate.
        energy: Function that returns the energy or another conserved quantity.
        frequencies: The fastest modes, see `System.frequencies`.

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
        """Return the time derivative of a state."""
        return self._rate(t, y)

    def jacobian(self, t: float, y: FloatArray) -> Matrix | None:
        """Return the Jacobian of the rate."""
        return None if self._jacobian is None else self._jacobian(t, y)


class ForceSystem(_FunctionSystem, SecondOrder):
    """A second-order system from a function that returns accelerations.

    Args:
        acceleration: Function of time [s], positions and velocities ``(N, d)`` that
            returns accelerations ``(N, d)`` [m/s²].
        positions: Initial positions ``(N, d)`` [m].
        velocities: Initial velocities ``(N, d)`` [m/s]; None is at rest.
        jacobians: Function that returns the Jacobians by positions and velocities.
        energy: Function that returns the energy of a time and state.
        frequencies: The fastest modes, see `System.frequencies`.
        fixed: Mask of particles that keep their velocity ``(N,)``.
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
        x = np.asarray(positions, np.float64)
        v = np.zeros_like(x) if velocities is None else np.asarray(velocities, float)
        super().__init__(np.stack([x, v]), energy, frequencies)
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
        """Return Jacobians of acceleration with respect to positions and velocities."""
        return None if self._jacobians is None else self._jacobians(t, x, v)

    def suspected_cause(self, t: float, state: FloatArray) -> str:
        """Return the particle with the largest acceleration."""
        magnitudes = np.linalg.norm(self._acceleration(t, *state), axis=1)
        return f"particle {int(np.argmax(magnitudes))} has the largest acceleration"
