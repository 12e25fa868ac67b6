"""Energy that a solver dissipates numerically."""

from __future__ import annotations

from animtool.core.errors import Fault, percent_text, warning
from animtool.core.quantities import plain_number
from animtool.core.record import dataclass
from animtool.sim.system import Energy
from animtool.systems.springs.records import Solver

# First-order solvers, which dissipate energy of all motion.
DAMPING = frozenset({Solver.XPBD, Solver.IMPLICIT_EULER})
# Fraction of the energy of motion above which a loss is reported [1].
REPORTED = 0.02
# Speed below which the system counts as at rest [m/s].
RESTING = 1e-3


@dataclass(slots=True)
class Losses:
    """Energy loss of a system without drag, damping or supply.

    Attributes:
        mass: Moving mass [kg].
    """

    mass: float
    _begin: tuple[float, float] | None = None  # time [s] and energy [J]
    _most: float = 0.0  # largest kinetic energy so far [J]
    _lost: float = 0.0  # lost so far [J]
    _span: float = 0.0  # since the start [s]

    def look(self, t: float, energy: Energy) -> None:
        """Record the energy at a time [s]."""
        if self._begin is None:
            self._begin = t, energy.total
        begin, total = self._begin
        self._most = max(self._most, energy.kinetic)
        self._lost, self._span = total - energy.total, t - begin

    @property
    def fraction(self) -> float:
        """Lost fraction of the energy of motion [1]."""
        if not self._most > 0.5 * self.mass * RESTING**2:
            return 0.0
        return max(self._lost, 0.0) / max(self._lost, self._most)

    def notices(self, solver: Solver) -> list[Fault]:
        """Return a warning if a solver dissipates much energy (SIM196)."""
        if not self.fraction >= REPORTED:
            return []
        message = (
            f"{solver} damps the motion: it dissipated "
            f"{percent_text(self.fraction)} of its "
        )
        message += (
            f"energy within {plain_number(self._span)} s, but no drag or damping is "
        )
        message += "given"
        hint = "use auto or bdf2, which conserve it, or a shorter step"
        return [warning("SIM196", message, hint)]
