"""An entry of the table of integrators."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from typing import TypeAlias

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.sim.equations import Equations
from animtool.sim.stability import Limit


class Form(StrEnum):
    """The form of equations that a method needs.

    Attributes:
        RATES: Rates of the whole state; any system has them.
        ACCELERATIONS: Positions, velocities and accelerations apart.
    """

    RATES = "rates"
    ACCELERATIONS = "accelerations"


class StepControl(StrEnum):
    """How the step size is chosen.

    Attributes:
        FIXED: The caller.
        ADAPTIVE: The method, from its estimate of the error of each.
        SCIPY: A solver of scipy's, behind its own interface.
    """

    FIXED = "fixed"
    ADAPTIVE = "adaptive"
    SCIPY = "scipy"


@dataclass(frozen=True, slots=True)
class Step:
    """The result of a step."""

    state: FloatArray  # after the step
    memory: object = None  # passed to the next step
    # Error estimate in the state's shape; None without an estimate.
    error: FloatArray | None = None


# Maps equations, time [s], state, step [s] and memory to the result. Memory is None at
# the start and after the state was changed from outside; the result is None if an
# implicit step did not converge.
StepFunction: TypeAlias = Callable[
    [Equations, float, FloatArray, float, object], Step | None
]


@dataclass(frozen=True, slots=True)
class Integrator:
    """An entry of the table of integrators.

    Attributes:
        name: As options write it.
        summary: What it does, one line.
        order: Halving the step divides the error by 2 to this power.
        form: What of a system it uses.
        control: Who chooses the steps.
        step: One step; None of solvers of scipy's.
        limit: Largest stable step; None where a method that chooses its steps keeps
            to it by itself.
        growth: Polynomial R, coefficients in ascending order: of ``y' = λ y`` a step
            makes R(h λ) y. Empty of methods that are not explicit ones for rates.
        drag_order: Order where accelerations depend on velocities; None is `order`.
        evaluations: Of rates or accelerations in a step; None of methods for which
            that varies.
        error_order: A step's estimate of its error goes with the step to this power;
            0 of methods that have none.
        multistep: Whether a step needs those before it.
        implicit: Whether a step solves equations.
        symplectic: Whether areas of position and velocity stay: energy of systems
            without drag then swings, and does not drift.
        reversible: Whether a step back undoes a step, but for rounding.
        solver: Class of scipy's that does it, ``module:object``.
    """

    name: str
    summary: str
    order: int
    form: Form = Form.RATES
    control: StepControl = StepControl.FIXED
    step: StepFunction | None = None
    limit: Limit | None = None
    growth: tuple[float, ...] = ()
    drag_order: int | None = None
    evaluations: int | None = None
    error_order: int = 0
    multistep: bool = False
    implicit: bool = False
    symplectic: bool = False
    reversible: bool = False
    solver: str = ""

    def largest_step(self, omega: float, damping_ratio: float = 0.0) -> float | None:
        """Return the largest stable step of ``x'' + 2 ζ ω x' + ω² x = 0`` [s].

        Args:
            omega: Angular frequency ω [rad/s], above 0.
            damping_ratio: ζ [1], 0 or more.

        0 where none is stable, infinite where all are, None where the method keeps
        to its limit by itself.
        """
        return None if self.limit is None else self.limit(omega, damping_ratio)
