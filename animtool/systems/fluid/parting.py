"""Into how many parts a step of a fluid is parted."""

from __future__ import annotations

import math

import numpy as np

from animtool._types import FloatArray
from animtool.sim.colliders import Colliders
from animtool.systems.fluid.spec import FluidModel

# One round of pressure in each part makes the fluid as stiff as sound that goes one
# spacing in a part would. Density then rises by pressure over the square of that speed.
# In the mean it rises by less than half of the most.
MEAN = 0.5
# Share of the spacing that anything may move in a part.
TRAVEL = 0.25
# Of squares of spacings over the viscosity that a part may last: its diffusion grows
# beyond 0.23.
DIFFUSION = 0.1
# Of the period of the shortest ripples.
RIPPLE = 0.4
# Times within which the pressure that parts are made for is forgotten [s].
FORGET = 0.1
# Particles that may have more pressure than parts are made for.
FEW = 0.005
# Moves of sheets between looks, in spacings, and looks in a step.
PIECE, MAX_PIECES = 0.5, 32
MAX_PARTS = 4096
# Pressure of this many layers is always reckoned with.
LAYERS = 2.0
# Of the force between particles, which sums to a tension of 1 [N/m]: see `tension`.
COHESION = 1.0


class Parting:
    """Parts of steps, from speed, pressure and what the fluid is.

    Attributes:
        most: Parts that a step may have.
        cohesion: Strength of the force between particles [N].
    """

    def __init__(self, spec: FluidModel) -> None:
        self.most = MAX_PARTS
        self._spec = spec
        self.cohesion = COHESION * spec.tension * spec.spacing

    def first_head(self, points: FloatArray, pull: FloatArray) -> float:
        """Return the pressure over the density of a fluid that begins [m²/s²]."""
        if not len(points):
            return 0.0
        along = points @ pull.mean(axis=0)
        head = float(along.max() - along.min())
        return head if math.isfinite(head) else 0.0

    def next_head(self, head: float, pressures: FloatArray, dt: float) -> float:
        """Return it after a step, which forgets slowly."""
        few = len(pressures) - 1 - int(FEW * len(pressures))
        now = float(np.partition(pressures, few)[few]) / self._spec.density
        return max(now, head * math.exp(-dt / FORGET))

    def parts(self, dt: float, fastest: float, head: float, pull: float) -> float:
        """Return how many parts a step is to have; infinite beyond all numbers.

        Args:
            dt: The step [s].
            fastest: Of anything in it [m/s].
            head: Pressure over the density [m²/s²].
            pull: Most acceleration [m/s²].
        """
        spec = self._spec
        head = max(head, LAYERS * spec.spacing * pull)
        stiff = (head + fastest**2 / 2) * MEAN / spec.compression
        rates = [math.sqrt(stiff) / spec.spacing, fastest / (TRAVEL * spec.spacing)]
        rates.append(spec.viscosity / (DIFFUSION * spec.spacing**2))
        if spec.tension:
            ripple = 2 * math.pi * spec.tension / (spec.density * spec.spacing**3)
            rates.append(math.sqrt(ripple) / RIPPLE)
        whole = dt * max(rates)
        return max(math.ceil(whole), 1) if whole < 2**31 else math.inf

    def pieces(self, around: Colliders, parts: int, dt: float) -> int:
        """Return how often sheets are looked at in a step."""
        if not around.sheets:
            return 1
        way = dt * max(around.surfaces.fastest, 1.0)
        wanted = math.ceil(way / (PIECE * self._spec.spacing))
        return max(1, min(wanted, parts, MAX_PIECES))
