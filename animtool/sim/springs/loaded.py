"""What bounds and derivatives need to know of particles and what acts on them."""

from __future__ import annotations

from typing import Protocol

from animtool._types import BoolArray, FloatArray, IntArray
from animtool.sim.springs.body import Body


class LoadedBody(Protocol):
    """A body of N particles with what holds, draws and slows them."""

    @property
    def body(self) -> Body:
        """Particles, springs and triangles."""

    @property
    def fixed(self) -> BoolArray:
        """Which particles are held ``(N,)``."""

    @property
    def inverse_masses(self) -> FloatArray:
        """Of particles ``(N,)`` [1/kg], 0 of those that are held."""

    @property
    def drags(self) -> FloatArray:
        """What slows each particle, over its mass and speed ``(N,)`` [1/s]."""

    @property
    def drawn(self) -> IntArray:
        """Particles that are drawn to targets ``(A,)``."""

    @property
    def draws(self) -> FloatArray:
        """Stiffness [N/m] and damping [N s/m] of these targets ``(A, 2)``."""

    @property
    def gravity(self) -> FloatArray:
        """``(3,)`` [m/s²]."""

    @property
    def pressures(self) -> tuple[float, float]:
        """Drag and lift of triangles, over area and the square of speed."""

    def wind(self, t: float) -> FloatArray:
        """Return the velocity of the air at a time ``(1, 3)`` [m/s]."""
