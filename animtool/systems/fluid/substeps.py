"""The number of substeps of a fluid step."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.sim.colliders import Colliders
from animtool.systems.fluid.spec import FluidModel

# One pressure iteration per substep acts like sound that travels one spacing per
# substep; compression is pressure over that speed squared. The mean of particles is
# less than half the maximum, which leaves a margin.
MEAN = 1.1
# Largest motion in a substep, in spacings.
TRAVEL = 0.25
# Largest substep over squared spacing / viscosity: diffusion is unstable above 0.23.
DIFFUSION = 0.1
# Largest substep over the period of the shortest ripples.
RIPPLE = 0.4
# Time constants of the speed of sound, falling and rising [s]: sudden changes release
# elastic energy.
FORGET, GAIN = 1.0, 0.05
# The speed of sound stays within this factor of the needed one: stiffness that varies
# with pressure would pump the fluid.
SLACK = 1.2
# Quantile of speed and pressure that substeps must resolve.
FEW = 0.005
# Motion of sheets between collisions, in spacings, and the most collisions in a step.
PIECE, MAX_PIECES = 0.5, 32
MAX_PARTS = 4096
# Hydrostatic layers whose pressure is always assumed.
LAYERS = 2.0
# Radius of the smallest drop whose pressure is always assumed, in spacings.
SMALLEST = 5.0


class Substeps:
    """Substeps from speed, pressure and the fluid's properties."""

    def __init__(self, spec: FluidModel) -> None:
        self.most = MAX_PARTS  # largest number of substeps
        self._spec = spec
        # Laplace pressure of a drop, over the density [m²/s²].
        self._pulled = 2 * spec.tension / (spec.density * SMALLEST * spec.spacing)

    def first_sound(self, points: FloatArray, pull: FloatArray) -> float:
        """Return the initial speed of sound [m/s]."""
        if not len(points):
            return 0.0
        along = points @ pull.mean(axis=0)
        head = max(float(along.max() - along.min()), self._pulled)
        return self._sound(head) if math.isfinite(head) else 0.0

    def _sound(self, head: float) -> float:
        """Return the squared speed of sound that bears a pressure [m²/s²]."""
        return math.sqrt(head * MEAN / self._spec.compression)

    def sound(
        self,
        before: float,
        pressures: FloatArray,
        speeds: FloatArray,
        pull: float,
        dt: float,
    ) -> float:
        """Return the speed of sound for a step [m/s].

        ``before`` it was as fast, with pressures ``(N,)`` [Pa]; particles approach
        what they meet by ``speeds`` ``(N,)`` [m/s], and ``pull`` [m/s²] adds to them.
        """
        few = len(pressures) - 1 - int(FEW * len(pressures))
        pressure, fast = (np.partition(a, few)[few] for a in (pressures, speeds))
        head, fastest = float(pressure) / self._spec.density, float(fast) + pull * dt
        layers = LAYERS * self._spec.spacing * pull
        head = max(head, layers, self._pulled) + fastest**2 / 2
        needed = self._sound(head)
        if before and needed / SLACK <= before <= needed * SLACK:
            return before
        slower, faster = before * math.exp(-dt / FORGET), before * math.exp(dt / GAIN)
        sound = max(slower, min(needed, faster) if before else needed)
        # Without pressure, one substep is as stiff as possible.
        return sound or self._spec.spacing / dt

    def parts(self, dt: float, fastest: float, sound: float) -> float:
        """Return the number of substeps; infinite if it overflows."""
        spec = self._spec
        rates = [sound / spec.spacing, fastest / (TRAVEL * spec.spacing)]
        rates.append(spec.viscosity / (DIFFUSION * spec.spacing**2))
        if spec.tension:
            ripple = 2 * math.pi * spec.tension / (spec.density * spec.spacing**3)
            rates.append(math.sqrt(ripple) / RIPPLE)
        count = dt * max(rates)
        return max(math.ceil(count), 1) if count < 2**31 else math.inf

    def collision_substeps(self, around: Colliders, parts: int, dt: float) -> int:
        """Return how often sheets collide in a step."""
        if not around.sheets:
            return 1
        travel = dt * max(around.surfaces.fastest, 1.0)
        count = math.ceil(travel / (PIECE * self._spec.spacing))
        return max(1, min(count, parts, MAX_PIECES))
