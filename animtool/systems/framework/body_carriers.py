"""Rigid bodies that carry particles of another system, with two-way coupling."""

from __future__ import annotations

from dataclasses import field, replace
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError, listed
from animtool.core.names import name_hint
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.sim.colliders import Colliders, Poses
from animtool.sim.colliders.bodies import Wrenches
from animtool.systems.framework.surfaces import BodyColliders, ObservedRun, RigidSystem

# Displacement by an impulse over a step, relative to the step times the velocity change
# [1]. A constant force has 0.5; slightly more damps stiff motion.
PULL_DISPLACEMENT = 0.52


@dataclass(frozen=True, slots=True)
class BodyCarrier:
    """A rigid body of the scene that carries particles."""

    system: str  # name of the system
    body: str  # name of the body
    where: str = field(default="", compare=False)  # location in the scene entry


class CarrierBodies(BodyColliders):
    """Rigid bodies of a simulation run that carry particles.

    Attributes:
        step: Step of the simulation of the bodies [s].
        begin: Time of the first step of that simulation [s].
    """

    def __init__(
        self, run: ObservedRun, simulation: RigidSystem, begin: float, step: float
    ) -> None:
        super().__init__(run, simulation, 0.0, 0.0, two_way=True)
        self.system = simulation
        self.begin, self.step = begin, step
        self._start_state: Any = simulation.initial_state()

    def body_index(self, carrier: BodyCarrier) -> int:
        """Return the index of a carrier's body; raise SIM162 if the name is unknown."""
        names = list(self.system.shared.names)
        if carrier.body in names:
            return names.index(carrier.body)
        message = f"unknown body {carrier.body!r} of {carrier.system!r}"
        hint = name_hint(carrier.body, names) or f"it has {listed(names, 12)}"
        fault = Fault("SIM162", message, hint=hint, where=carrier.where)
        raise OptionError(fault)

    def start(self, carrier: BodyCarrier) -> Poses:
        """Return the initial pose of a body."""
        body_poses = self.system.body_poses(self._start_state, self.begin)
        pose = body_poses[self.body_index(carrier)]
        return Poses.fixed(pose[:3], pose[3:])

    def surface_distance(
        self, carrier: BodyCarrier, points: FloatArray
    ) -> tuple[float, float]:
        """Return the initial distance of points ``(P, 3)`` from a body [m].

        The distance is that of the nearest point to the surface, 0 inside the body.
        Also returns the size of the body [m].
        """
        shared, index = self.system.shared, self.body_index(carrier)
        (shape_indices,) = np.nonzero(shared.shape_bodies == index)
        poses = self.system.poses(self._start_state, self.begin)
        shapes = [
            replace(shared.shapes[i], poses=Poses.fixed(poses[i, :3], poses[i, 3:]))
            for i in shape_indices.tolist()
        ]
        if not shapes:
            return 0.0, np.inf
        distances = Colliders(shapes).sample(points, self.begin).distances
        return max(float(distances.min()), 0.0), float(shared.bounding_radii[index])

    def register_pusher(self, pusher: Any) -> None:
        """Register a system whose particles are attached to the bodies."""
        super().register_pusher(pusher)
        self._run.add_puller(self, pusher)

    def pulled_by(self, puller: Any, state: Any, t: float) -> Any:
        """Return a state at a time [s] within a step, with the puller's impulses."""
        pulling_impulses = puller.pull(t, self)
        if pulling_impulses is None:
            return state
        wrenches, begin, end = pulling_impulses
        end_state, _ = self._run.past_state(end)
        end_centres = self.system.inertias(end_state)[0]
        fraction = (t - begin) / (end - begin)
        current_centres = self.system.inertias(state)[0]

        def scale_impulses(impulse_rows: FloatArray, fraction: float) -> FloatArray:
            scaled_rows = fraction * impulse_rows
            scaled_rows[:, 3:] += so3.cross(
                current_centres - end_centres, scaled_rows[:, :3]
            )
            return scaled_rows

        impulses = scale_impulses(wrenches.impulses, fraction)
        time_weighted_impulses = scale_impulses(
            wrenches.time_weighted_impulses, fraction**2
        )
        return self.system.pushed(state, Wrenches(impulses, time_weighted_impulses))

    def step_over(self, t0: float, t1: float) -> CarrierStep:
        """Return the bodies over a step [s], without impulses of pins."""
        start_state, _ = self._run.past_state(t0, with_pushes=True)
        end_state, _ = self._run.past_state(t1)
        return CarrierStep(self.system, start_state, end_state, t0, t1)


class CarrierStep:
    """Rigid bodies over a step, pulled by particles."""

    def __init__(
        self,
        simulation: RigidSystem,
        start_state: Any,
        end_state: Any,
        t0: float,
        t1: float,
    ) -> None:
        self._simulation, self._end_state, self._t1 = simulation, end_state, t1
        # Poses of all bodies ``(B, 7)``.
        self.start_poses = simulation.body_poses(start_state, t0)
        self.start_state = start_state
        self.duration = t1 - t0
        self.is_free = simulation.is_free(t0)  # free bodies ``(count,)``
        self.inertias = simulation.inertias(end_state)
        self._end_velocities = simulation.body_velocities(end_state)[:, :3]
        self._pull_time = PULL_DISPLACEMENT * self.duration

    @property
    def max_angle(self) -> float:
        """Largest rotation of a body in the step [rad]."""
        spins = self._simulation.body_velocities(self.start_state)[self.is_free, 3:]
        return self.duration * float(np.linalg.norm(spins, axis=1).max(initial=0.0))

    def subcell(self, state: Any, t: float, dt: float) -> CarrierStep:
        """Return the bodies over a part ``dt`` [s] of the step, from a given state."""
        end_state = self._simulation.step(state, t, dt)
        return CarrierStep(self._simulation, state, end_state, t, t + dt)

    def push_to(self, state: Any) -> Wrenches:
        """Return the impulses that change the step's end state to a given state."""
        return self._simulation.push_to(self._end_state, state)

    def point_velocities(
        self, state: Any, index: int, points: FloatArray
    ) -> FloatArray:
        """Return velocities of points ``(P, 3)`` on a dynamic body [m/s]."""
        body_velocity = self._simulation.body_velocities(state)[index]
        centre = self._simulation.inertias(state)[0][index]
        velocities: FloatArray = body_velocity[:3] + so3.cross(
            body_velocity[3:], points - centre
        )
        return velocities

    def start_velocities(self, index: int, points: FloatArray) -> FloatArray:
        """Return velocities of points ``(P, 3)`` on a body at the start [m/s]."""
        return self.point_velocities(self.start_state, index, points)

    def moment(self, index: int, impulse: FloatArray) -> FloatArray:
        """Return the moment of an impulse ``(6,)`` about the moving centre of mass."""
        centre = self.inertias[0][index] - self._pull_time * self._end_velocities[index]
        moment: FloatArray = impulse[3:] - so3.cross(centre, impulse[:3])
        return moment

    def wrenches(self, pin_impulses: FloatArray) -> Wrenches:
        """Convert impulses and moments of pins ``(count, 6)`` to those on bodies."""
        impulses = pin_impulses.copy()
        impulses[:, 3:] += so3.cross(self.inertias[0], pin_impulses[:, :3])
        return Wrenches(impulses, self._pull_time * impulses)

    def pushed(self, wrenches: Wrenches) -> tuple[Any, FloatArray]:
        """Return the end state with impulses applied, and all body poses ``(B, 7)``."""
        state = self._simulation.pushed(self._end_state, wrenches)
        return state, self._simulation.body_poses(state, self._t1)


def local_to_world(pose: FloatArray, local_points: FloatArray) -> FloatArray:
    """Transform points ``(P, 3)`` from a frame ``(7,)`` to the world [m]."""
    points: FloatArray = pose[:3] + so3.rotate(pose[3:], local_points)
    return points
