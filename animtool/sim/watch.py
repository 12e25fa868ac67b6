"""Signs that a motion has blown up."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from animtool._types import FloatArray
from animtool.sim.options import IntegrateOptions
from animtool.sim.system import Energy, System


class Signs(Protocol):
    """What looks for signs of a blow-up."""

    def sign(self, t: float, state: FloatArray) -> str:
        """Return why a state is beyond bounds, empty where it is not."""
        ...


class Watch:
    """Looks at states for numbers, energy and stretch beyond bounds.

    Attributes:
        energy: Of the state that was looked at last.

    Energy counts from the start, in the largest of: the energies there, what may be
    supplied, and the potential energy released since. A motion that starts without
    any is not judged by it.
    """

    def __init__(self, system: System, options: IntegrateOptions) -> None:
        self._system = system
        self._options = options
        self._first: Energy | None = None
        self.energy: Energy | None = None
        self._usual = 0.0

    def start(self, t: float, state: FloatArray) -> None:
        """Take a state for what is usual."""
        first = self._system.energy(t, state)
        self._first = self.energy = first
        if first is not None:
            self._usual = max(
                abs(first.total), first.kinetic, abs(first.potential), first.supply
            )

    def look_at(self, system: System) -> None:
        """Look at another system from now on, such as what is left of the first."""
        self._system = system

    def sign(self, t: float, state: FloatArray) -> str:
        """Return why a state is beyond bounds, empty where it is not."""
        if not np.isfinite(state).all():
            return "its state is not finite"
        return self._grown(t, state) or self._stretched(t, state)

    def _grown(self, t: float, state: FloatArray) -> str:
        first, now = self._first, self._system.energy(t, state)
        self.energy = now
        if first is None or now is None:
            return ""
        released = first.potential - now.potential
        self._usual = max(self._usual, now.supply, released)
        most = self._options.growth * self._usual
        gained = now.total - first.total
        if self._usual > 0 and not gained <= most:
            return f"its energy is {now.total:.3g} J, and was {first.total:.3g} J"
        return ""

    def _stretched(self, t: float, state: FloatArray) -> str:
        if np.isinf(self._options.stretch):
            return ""
        ratio = self._system.stretch(t, state)
        if ratio is not None and not ratio <= self._options.stretch:
            return f"a spring is {ratio:.3g} times as long as at rest"
        return ""
