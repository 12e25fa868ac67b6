"""What has a state over time, as integrators see it, and systems made of functions.

A system says how its state changes; everything else is optional. Classes of systems
derive from `FirstOrder` or `SecondOrder` and so have what they leave out. Arrays go
in and come out whole: one call serves all N particles, and none is changed in place.
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
Native: TypeAlias = Callable[[float, FloatArray, float, int], FloatArray]


@dataclass(frozen=True, slots=True)
class Energy:
    """The energy of a state.

    Attributes:
        kinetic: [J]
        potential: [J], of springs and fields, from any zero.
        supply: What forces from outside (wind, motors, moved pins) may well bring in
            [J]; 0 where there are none. It need only be of the right size: growth far
            beyond it is taken for a blow-up.
    """

    kinetic: float
    potential: float = 0.0
    supply: float = 0.0

    @property
    def total(self) -> float:
        """Kinetic and potential energy together [J]."""
        return self.kinetic + self.potential


class System(Protocol):
    """A system with a state that changes over time.

    In all methods ``t`` is a time [s] and ``state`` has the shape of the one that it
    starts with: any of `FirstOrder`, ``(2, N, d)`` of `SecondOrder`.

    Attributes:
        settles: Whether `settle` does anything; False by default.
    """

    settles: bool = False

    @property
    def state(self) -> FloatArray:
        """The initial state."""
        ...

    def energy(self, t: float, state: FloatArray) -> Energy | None:
        """Return the energy of a state; None if it has no useful one."""
        return None

    def stretch(self, t: float, state: FloatArray) -> float | None:
        """Return the largest spring length over its rest length [1]."""
        return None

    def frequencies(self, t: float, state: FloatArray) -> FloatArray | None:
        """Return the fastest modes: angular frequency [rad/s], damping ratio.

        One row (ω, ζ) of ``x'' + 2 ζ ω x' + ω² x = 0`` a mode ``(M, 2)``; a decay
        ``y' = -k y`` is (k, 1), a rotation ``y' = i ω y`` is (ω, 0). Only modes that
        limit the step are needed: the stiffest, and for methods stabilised by damping
        also the least damped.
        """
        return None

    def settle(
        self, t: float, h: float, before: FloatArray, after: FloatArray
    ) -> FloatArray:
        """Return the state after a step's contacts, constraints and pins.

        Called after every step that is kept, of a system that `settles`.

        Args:
            t: Time at the end of the step [s].
            h: The step [s].
            before: State that the step began with.
            after: State that it led to; returned itself where nothing is to change.
        """
        return after

    def native(self, method: str) -> Native | None:
        """Return a compiled loop that takes many steps; None if there is none.

        It does what the method of that name does, and `settle` too.
        """
        return None

    def notices(self) -> list[Fault]:
        """Return warnings about the initial state and the inputs."""
        return []

    def suspect(self, t: float, state: FloatArray) -> str:
        """Return the likely cause of a failure, for messages; may be empty."""
        return ""


class FirstOrder(System, Protocol):
    """A system ``y' = rate(t, y)`` with a state of any shape."""

    def rate(self, t: float, y: FloatArray) -> FloatArray:
        """Return the time derivative of a state, in its shape [1/s]."""
        ...

    def jacobian(self, t: float, y: FloatArray) -> Matrix | None:
        """Return the Jacobian of the flattened rate ``(n, n)``.

        Dense or sparse; None where implicit methods are to take differences.
        """
        return None


class SecondOrder(System, Protocol):
    """N particles in d dimensions with ``x'' = acceleration(t, x, v)``.

    The state is ``(2, N, d)``: positions [m], then velocities [m/s].

    Attributes:
        fixed: Particles of infinite mass ``(N,)``: whatever their acceleration, they
            keep their velocity. None where there are none.
        velocity_dependent: Whether accelerations depend on velocities. Where they do
            not, methods may evaluate them less often. True by default.
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
        """Return Jacobians of accelerations by positions and by velocities.

        Both ``(N d, N d)``, dense or sparse; None where implicit methods are to take
        differences.
        """
        return None


Rate: TypeAlias = Callable[[float, FloatArray], FloatArray]
Acceleration: TypeAlias = Callable[[float, FloatArray, FloatArray], FloatArray]
EnergyOf: TypeAlias = Callable[[float, FloatArray], Energy]
Jacobian: TypeAlias = Callable[[float, FloatArray], Matrix]
Jacobians: TypeAlias = Callable[[float, FloatArray, FloatArray], tuple[Matrix, Matrix]]


class _StateFunctions:
    """The optional parts of a system made of functions."""

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
        """The initial state."""
        return self._state

    def energy(self, t: float, state: FloatArray) -> Energy | None:
        """Return the energy of a state."""
        return None if self._energy is None else self._energy(t, state)

    def frequencies(self, t: float, state: FloatArray) -> FloatArray | None:
        """Return the fastest modes ``(M, 2)``."""
        return self._frequencies


class RateSystem(_StateFunctions, FirstOrder):
    """A first-order system from a function, such as a velocity field.

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
        """Return the time derivative of a state."""
        return self._rate(t, y)

    def jacobian(self, t: float, y: FloatArray) -> Matrix | None:
        """Return the Jacobian of the rate."""
        return None if self._jacobian is None else self._jacobian(t, y)


class ForceSystem(_StateFunctions, SecondOrder):
    """A second-order system from a function to accelerations.

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
        starts = np.asarray(positions, np.float64)
        speeds = np.zeros_like(starts) if velocities is None else velocities
        super().__init__(
            np.stack([starts, np.asarray(speeds, np.float64)]), energy, frequencies
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
        """Return Jacobians of accelerations by positions and by velocities."""
        return None if self._jacobians is None else self._jacobians(t, x, v)

    def suspect(self, t: float, state: FloatArray) -> str:
        """Return the particle with the largest acceleration."""
        pulls = np.linalg.norm(self._acceleration(t, *state), axis=1)
        return f"particle {int(np.argmax(pulls))} has the largest acceleration"
