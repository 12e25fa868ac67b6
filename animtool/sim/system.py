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

# Of derivatives: a dense array, or one of scipy.sparse.
Matrix: TypeAlias = Any
# From time [s], state, step [s] and a number of steps to the state after them.
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
    """What has a state over time.

    In all methods ``t`` is a time [s] and ``state`` has the shape of the one that it
    starts with: any of `FirstOrder`, ``(2, N, d)`` of `SecondOrder`.

    Attributes:
        settles: Whether `settle` does anything; False by default.
    """

    settles: bool = False

    @property
    def state(self) -> FloatArray:
        """Where it starts."""
        ...

    def energy(self, t: float, state: FloatArray) -> Energy | None:
        """Return the energy of a state, None where it has none that is of use."""
        return None

    def stretch(self, t: float, state: FloatArray) -> float | None:
        """Return the largest length of a spring over its rest length [1]."""
        return None

    def frequencies(self, t: float, state: FloatArray) -> FloatArray | None:
        """Return the fastest motions: angular frequency [rad/s] and damping ratio.

        Of ``x'' + 2 ζ ω x' + ω² x = 0`` one row (ω, ζ) a motion ``(M, 2)``; a rate
        ``y' = -k y`` is (k, 1), a turning ``y' = i ω y`` is (ω, 0). Those whose steps
        must be the shortest are enough: the stiffest, and of methods that damping
        steadies also the least damped.
        """
        return None

    def settle(
        self, t: float, h: float, before: FloatArray, after: FloatArray
    ) -> FloatArray:
        """Return the state to go on with after a step: contacts, constraints, pins.

        Called after every step that is kept, of a system that `settles`.

        Args:
            t: Time at the end of the step [s].
            h: The step [s].
            before: State that the step began with.
            after: State that it led to; returned itself where nothing is to change.
        """
        return after

    def native(self, method: str) -> Native | None:
        """Return what takes many steps of a method at once, None where nothing does.

        It does what the method of that name does, and `settle` too.
        """
        return None

    def notices(self) -> list[Fault]:
        """Return what is odd about its start, and about what is to come."""
        return []

    def suspect(self, t: float, state: FloatArray) -> str:
        """Return what makes a state hard to go on from, for a message; may be empty."""
        return ""


class FirstOrder(System, Protocol):
    """A system whose state has a rate, ``y' = rate(t, y)``; the state has any shape."""

    def rate(self, t: float, y: FloatArray) -> FloatArray:
        """Return the rate of change of a state, of its shape [1/s]."""
        ...

    def jacobian(self, t: float, y: FloatArray) -> Matrix | None:
        """Return the derivative of the rate, flat, by the state ``(n, n)``.

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
        """Return the derivatives of accelerations by positions and by velocities.

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

    def frequencies(self, t: float, state: FloatArray) -> FloatArray | None:
        """Return the fastest motions ``(M, 2)``."""
        return self._frequencies


class RateSystem(_StateFunctions, FirstOrder):
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


class ForceSystem(_StateFunctions, SecondOrder):
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
        return f"particle {int(np.argmax(pulls))} has the largest acceleration"
