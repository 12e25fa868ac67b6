"""Numerical energy loss of a solver."""

from __future__ import annotations

from animtool.core.errors import Fault, percent_text, warning
from animtool.core.quantities import plain_number
from animtool.core.record import dataclass
from animtool.sim.system import Energy
from animtool.systems.springs.records import Solver

# First-order solvers, which dissipate the energy of any motion.
DAMPING_SOLVERS = frozenset({Solver.XPBD, Solver.IMPLICIT_EULER})
# Smallest reported loss, relative to the kinetic energy [1].
MIN_REPORTED_FRACTION = 0.02
# Speed below which the system counts as at rest [m/s].
REST_SPEED = 1e-3


@dataclass(slots=True)
class EnergyLoss:
    """Measures the numerical energy loss of a conservative system.

    Attributes:
        mass: Moving mass [kg].
    """

    mass: float
    _begin: tuple[float, float] | None = None  # time [s] and energy [J]
    _max_kinetic: float = 0.0  # largest kinetic energy so far [J]
    _lost_energy: float = 0.0  # energy lost so far [J]
    _duration: float = 0.0  # time since the start [s]

    def record(self, t: float, energy: Energy) -> None:
        """Record the energy at a time [s]."""
        if self._begin is None:
            self._begin = t, energy.total
        begin, total = self._begin
        self._max_kinetic = max(self._max_kinetic, energy.kinetic)
        self._lost_energy, self._duration = total - energy.total, t - begin

    @property
    def fraction(self) -> float:
        """Lost energy as a fraction of the largest kinetic energy so far [1]."""
        if not self._max_kinetic > 0.5 * self.mass * REST_SPEED**2:
            return 0.0
        return max(self._lost_energy, 0.0) / max(self._lost_energy, self._max_kinetic)

    def notices(self, solver: Solver) -> list[Fault]:
        """Return a warning if a solver dissipates much energy (SIM196)."""
        if not self.fraction >= MIN_REPORTED_FRACTION:
            return []
        loss = percent_text(self.fraction)
        message = f"{solver} damps the motion: it dissipated {loss} of its energy "
        message += f"within {plain_number(self._duration)} s, but no drag or "
        message += "damping is given"
        hint = "use auto or bdf2, which conserve it, or a shorter step"
        return [warning("SIM196", message, hint)]
