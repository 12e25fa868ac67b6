"""What has a state over time, as integrators see it.

A system says how its state changes; everything else is optional. Classes of systems
derive from `FirstOrder` or `SecondOrder` and so have what they leave out. Arrays go
in and come out whole: one call serves all N particles, and none is changed in place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, runtime_checkable

from animtool._types import BoolArray, FloatArray
from animtool.errors import Fault

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

    Attributes:
        settles: Whether `settle` does anything.
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
        self,
        t: float,
        h: float,
        before: FloatArray,
        after: FloatArray,
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


@runtime_checkable
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


@runtime_checkable
class SecondOrder(System, Protocol):
    """N particles in d dimensions with ``x'' = acceleration(t, x, v)``.

    The state is ``(2, N, d)``: positions [m], then velocities [m/s].

    Attributes:
        fixed: Particles of infinite mass ``(N,)``: whatever their acceleration, they
            keep their velocity. None where there are none.
        velocity_dependent: Whether accelerations depend on velocities. Where they do
            not, methods may evaluate them less often.
    """

    fixed: BoolArray | None = None
    velocity_dependent: bool = True

    def acceleration(self, t: float, x: FloatArray, v: FloatArray) -> FloatArray:
        """Return accelerations ``(N, d)`` [m/s²] at positions and velocities."""
        ...

    def jacobians(
        self,
        t: float,
        x: FloatArray,
        v: FloatArray,
    ) -> tuple[Matrix, Matrix] | None:
        """Return the derivatives of accelerations by positions and by velocities.

        Both ``(N d, N d)``, dense or sparse; None where implicit methods are to take
        differences.
        """
        return None
