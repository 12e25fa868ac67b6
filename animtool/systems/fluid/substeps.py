"""The number of substeps of a fluid step."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.sim.colliders import Colliders
from animtool.systems.fluid.spec import FluidModel

# One pressure iteration per substep acts like sound that travels one spacing per
# substep; compression is pressure over its squared speed. The mean compression is less
# than half the maximum, which leaves a margin.
COMPRESSION_MARGIN = 1.1
# Largest motion in a substep, in spacings.
MAX_SUBSTEP_TRAVEL = 0.25
# Largest substep over squared spacing / viscosity: diffusion is unstable above 0.23.
MAX_DIFFUSION = 0.1
# Largest substep over the period of the shortest ripples.
MAX_RIPPLE_PHASE = 0.4
# Time constants of the speed of sound, falling and rising [s]: sudden changes release
# elastic energy.
SOUND_FALL_TIME, SOUND_RISE_TIME = 1.0, 0.05
# The speed of sound stays within this factor of the needed one: stiffness that varies
# with pressure would pump the fluid.
SOUND_TOLERANCE = 1.2
# Quantile of speed and pressure that substeps must resolve.
IGNORED_QUANTILE = 0.005
# Motion of sheets between collisions, in spacings, and largest number of collisions.
SHEET_TRAVEL, MAX_SHEET_COLLISIONS = 0.5, 32
MAX_SUBSTEPS = 4096
# Hydrostatic layers whose pressure is always assumed.
MIN_LAYERS = 2.0
# Radius of the smallest drop whose pressure is always assumed, in spacings.
MIN_DROP_RADIUS = 5.0


class Substeps:
    """Substeps from speed, pressure and the fluid's properties."""

    def __init__(self, spec: FluidModel) -> None:
        self.max_substeps = MAX_SUBSTEPS  # largest number of substeps
        self._spec = spec
        # Laplace pressure of a drop, over the density [m²/s²].
        self._drop_pressure = (
            2 * spec.tension / (spec.density * MIN_DROP_RADIUS * spec.spacing)
        )

    def first_sound(self, points: FloatArray, accelerations: FloatArray) -> float:
        """Return the initial speed of sound [m/s]."""
        if not len(points):
            return 0.0
        potentials = points @ accelerations.mean(axis=0)
        head = max(float(potentials.max() - potentials.min()), self._drop_pressure)
        return self._sound(head) if math.isfinite(head) else 0.0

    def _sound(self, head: float) -> float:
        """Return the speed of sound [m/s] for a pressure over density [m²/s²]."""
        return math.sqrt(head * COMPRESSION_MARGIN / self._spec.compression)

    def sound(
        self,
        previous: float,
        pressures: FloatArray,
        speeds: FloatArray,
        acceleration: float,
        dt: float,
    ) -> float:
        """Return the speed of sound for a step [m/s].

        ``previous``: speed of sound of the last step [m/s]. ``pressures`` ``(N,)``
        [Pa]; ``speeds``: approach speeds of particles ``(N,)`` [m/s]; ``acceleration``:
        the largest external one [m/s²].
        """
        index = len(pressures) - 1 - int(IGNORED_QUANTILE * len(pressures))
        pressure, speed = (np.partition(a, index)[index] for a in (pressures, speeds))
        head, max_speed = (
            float(pressure) / self._spec.density,
            float(speed) + acceleration * dt,
        )
        layers = MIN_LAYERS * self._spec.spacing * acceleration
        head = max(head, layers, self._drop_pressure) + max_speed**2 / 2
        required = self._sound(head)
        if (
            previous
            and required / SOUND_TOLERANCE <= previous <= required * SOUND_TOLERANCE
        ):
            return previous
        lowest, highest = (
            previous * math.exp(-dt / SOUND_FALL_TIME),
            previous * math.exp(dt / SOUND_RISE_TIME),
        )
        sound = max(lowest, min(required, highest) if previous else required)
        # Without pressure, one substep is as stiff as possible.
        return sound or self._spec.spacing / dt

    def parts(self, dt: float, fastest: float, sound: float) -> float:
        """Return the number of substeps; infinite if it overflows."""
        spec = self._spec
        rates = [sound / spec.spacing, fastest / (MAX_SUBSTEP_TRAVEL * spec.spacing)]
        rates.append(spec.viscosity / (MAX_DIFFUSION * spec.spacing**2))
        if spec.tension:
            ripple = 2 * math.pi * spec.tension / (spec.density * spec.spacing**3)
            rates.append(math.sqrt(ripple) / MAX_RIPPLE_PHASE)
        count = dt * max(rates)
        return max(math.ceil(count), 1) if count < 2**31 else math.inf

    def collision_substeps(self, colliders: Colliders, parts: int, dt: float) -> int:
        """Return the number of collisions with sheets in a step."""
        if not colliders.sheets:
            return 1
        travel = dt * max(colliders.surfaces.fastest, 1.0)
        count = math.ceil(travel / (SHEET_TRAVEL * self._spec.spacing))
        return max(1, min(count, parts, MAX_SHEET_COLLISIONS))
