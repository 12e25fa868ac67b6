"""The number of substeps of a fluid step."""

from __future__ import annotations

import math

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.sim.colliders import Colliders
from animtool.systems.fluid.spec import FluidModel

# One pressure iteration per substep acts like sound that travels one spacing in it.
# Compression is pressure over density and the squared speed of sound. Its mean is less
# than half its maximum, which leaves a margin.
COMPRESSION_SAFETY_FACTOR = 1.1
# Largest motion in a substep, in spacings.
MAX_SUBSTEP_TRAVEL = 0.25
# Largest substep relative to squared spacing over viscosity; above 0.23 diffusion is
# unstable.
MAX_DIFFUSION = 0.1
# Largest substep relative to the period of the shortest ripples, over 2 π.
MAX_RIPPLE_PHASE = 0.4
# Time constants of the speed of sound, falling and rising [s]: sudden changes release
# elastic energy.
SOUND_FALL_TIME, SOUND_RISE_TIME = 1.0, 0.05
# Largest ratio between the speed of sound and the required one. A stiffness that
# follows the pressure would add energy.
SOUND_TOLERANCE = 1.2
# Fraction of the fastest, and of the most compressed, particles that is ignored.
IGNORED_QUANTILE = 0.005
# Motion of sheets between collisions, in spacings, and largest number of collisions.
SHEET_TRAVEL, MAX_SHEET_COLLISIONS = 0.5, 32
MAX_SUBSTEPS = 4096
# Smallest depth for which the speed of sound is chosen, in spacings.
MIN_LAYERS = 2.0
# Radius of the smallest drop whose Laplace pressure the fluid can resist, in spacings.
MIN_DROP_RADIUS = 5.0


class Substeps:
    """Computes the speed of sound and the number of substeps of a fluid."""

    def __init__(self, spec: FluidModel) -> None:
        self.max_substeps = MAX_SUBSTEPS  # largest number of substeps
        self._spec = spec
        # Laplace pressure of a drop, over the density [m²/s²].
        self._drop_pressure = (
            2 * spec.tension / (spec.density * MIN_DROP_RADIUS * spec.spacing)
        )

    def initial_sound_speed(
        self, points: FloatArray, accelerations: FloatArray
    ) -> float:
        """Return the initial speed of sound [m/s]."""
        if not len(points):
            return 0.0
        potentials = points @ accelerations.mean(axis=0)
        pressure_ratio = max(
            float(potentials.max() - potentials.min()), self._drop_pressure
        )
        return (
            self._sound_speed(pressure_ratio) if math.isfinite(pressure_ratio) else 0.0
        )

    def _sound_speed(self, pressure_ratio: float) -> float:
        """Return the sound speed [m/s] for a ratio of pressure to density [m²/s²]."""
        return math.sqrt(
            pressure_ratio * COMPRESSION_SAFETY_FACTOR / self._spec.compression
        )

    def step_sound_speed(
        self,
        previous_sound_speed: float,
        pressures: FloatArray,
        speeds: FloatArray,
        max_acceleration: float,
        dt: float,
    ) -> float:
        """Return the speed of sound for a step [m/s].

        ``previous_sound_speed`` is that of the last step, or 0. Particles have
        pressures [Pa] and largest approach speeds [m/s] ``(N,)``;
        ``max_acceleration`` is the largest external one [m/s²].
        """
        quantile_index = len(pressures) - 1 - int(IGNORED_QUANTILE * len(pressures))
        pressure, speed = (
            np.partition(a, quantile_index)[quantile_index] for a in (pressures, speeds)
        )
        pressure_head = float(pressure) / self._spec.density
        max_speed = float(speed) + max_acceleration * dt
        layer_head = MIN_LAYERS * self._spec.spacing * max_acceleration
        static_head = max(pressure_head, layer_head, self._drop_pressure)
        required_speed = self._sound_speed(static_head + max_speed**2 / 2)
        min_sound = required_speed / SOUND_TOLERANCE
        if (
            previous_sound_speed
            and min_sound <= previous_sound_speed <= required_speed * SOUND_TOLERANCE
        ):
            return previous_sound_speed
        min_speed = previous_sound_speed * math.exp(-dt / SOUND_FALL_TIME)
        max_allowed = previous_sound_speed * math.exp(dt / SOUND_RISE_TIME)
        if previous_sound_speed:
            required_speed = min(required_speed, max_allowed)
        sound_speed = max(min_speed, required_speed)
        # Without pressure, one substep is as stiff as possible.
        return sound_speed or self._spec.spacing / dt

    def substep_count(self, dt: float, max_speed: float, sound_speed: float) -> float:
        """Return the number of substeps of a step; infinite on numerical overflow."""
        spec = self._spec
        min_rates = [
            sound_speed / spec.spacing,
            max_speed / (MAX_SUBSTEP_TRAVEL * spec.spacing),
        ]
        min_rates.append(spec.viscosity / (MAX_DIFFUSION * spec.spacing**2))
        if spec.tension:
            mass = spec.density * spec.spacing**3
            squared_frequency = 2 * math.pi * spec.tension / mass
            min_rates.append(math.sqrt(squared_frequency) / MAX_RIPPLE_PHASE)
        count = dt * max(min_rates)
        return max(math.ceil(count), 1) if count < 2**31 else math.inf

    def collision_substeps(
        self, colliders: Colliders, substep_count: int, dt: float
    ) -> int:
        """Return the number of collisions with sheets in a step."""
        if not colliders.sheets:
            return 1
        travel = dt * max(colliders.surfaces.max_speed, 1.0)
        count = math.ceil(travel / (SHEET_TRAVEL * self._spec.spacing))
        return max(1, min(count, substep_count, MAX_SHEET_COLLISIONS))
