"""A particle simulation in Python, stepped on demand."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.motion.frames import PointsFrame
from animtool.sim.colliders.colliding import Contacts
from animtool.systems.framework.run import ReachedState, SimulationRun
from animtool.systems.particles.setup import Particles
from animtool.systems.particles.simulation import ParticleRunState, ParticleSimulation


@dataclass(frozen=True, slots=True)
class ParticleFrame(PointsFrame):
    """The particles of a simulation at one time.

    Attributes:
        ids: ``(N,)``, ascending.
        points: ``(N, 3)`` [m].
        velocities: ``(N, 3)`` [m/s].
        radii: ``(N,)`` [m].
        time: [s].
    """

    time: float = 0.0

    @property
    def ages(self) -> FloatArray:
        """Time since the birth of each particle ``(N,)`` [s]."""
        return np.asarray(self.primvars["age"], np.float64)


class ParticleRun(SimulationRun):
    """A particle simulation in fixed steps, sampled at arbitrary times.

    Attributes:
        state: State at the end of the last full step.
        notices: Warnings collected so far.

    Args:
        setup: The particle system.
        begin: Time of the first step [s].
        state: State to resume from, instead of the beginning.

    Raises:
        OptionError: The setup is invalid (SIM001, SIM004 to SIM006, SIM020 to SIM024).
    """

    def __init__(
        self,
        setup: Particles,
        begin: float = 0.0,
        state: ReachedState[ParticleRunState] | None = None,
    ) -> None:
        self._particles = ParticleSimulation(setup, begin)
        step = setup.options.step
        assert step is not None
        super().__init__(setup.name, self._particles, begin, step, state)

    @property
    def contacts(self) -> Contacts | None:
        """Contacts of the last step; None before the first step.

        Contacts do not include particles born in the step.
        """
        return self._particles.contacts

    def at(self, t: float) -> ParticleFrame:
        """Return the particles at a time [s]; times must not decrease.

        Raises:
            OptionError: Time runs backwards (SIM002).
            ToleranceError: The simulation diverged (SIM102), or a method stopped.
        """
        frame = super().at(t)
        assert isinstance(frame, PointsFrame)
        return ParticleFrame(
            frame.ids,
            frame.points,
            frame.velocities,
            frame.radii,
            frame.primvars,
            max(t, self.step_time(self.state.step_count)),
        )
