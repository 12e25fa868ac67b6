"""Rigid bodies that carry particles of another system, two-way coupled."""

from __future__ import annotations

from dataclasses import field, replace
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError, listed
from animtool.core.names import nearest
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.sim.colliders import Colliders, Poses
from animtool.sim.colliders.bodies import Wrenches
from animtool.systems.framework.surfaces import BodyColliders, ObservedRun, RigidSystem

# Displacement by a pull over a step, relative to step times gained speed: 0.5 is a
# constant force, a little more damps stiff motion.
PULL_DISPLACEMENT = 0.52


@dataclass(frozen=True, slots=True)
class BodyCarrier:
    """A rigid body of the scene that carries particles."""

    system: str  # name of the system
    body: str  # name of the body
    where: str = field(default="", compare=False)  # its key


class TiedBodies(BodyColliders):
    """Rigid bodies of a simulation run that carry particles.

    Attributes:
        step: Step of their simulation [s].
        begin: Time of their first step [s].
    """

    def __init__(
        self, run: ObservedRun, simulation: RigidSystem, begin: float, step: float
    ) -> None:
        super().__init__(run, simulation, 0.0, 0.0, two_way=True)
        self.system = simulation
        self.begin, self.step = begin, step
        self._start: Any = simulation.initial()

    def number(self, carrier: BodyCarrier) -> int:
        """Return the index of a body; raise SIM162 if the name is unknown."""
        names = list(self.system.shared.names)
        if carrier.body in names:
            return names.index(carrier.body)
        message = f"unknown body {carrier.body!r} of {carrier.system!r}"
        hint = nearest(carrier.body, names) or f"it has {listed(names, 12)}"
        fault = Fault("SIM162", message, hint=hint, where=carrier.where)
        raise OptionError(fault)

    def start(self, carrier: BodyCarrier) -> Poses:
        """Return the initial pose of a body."""
        frames = self.system.frames(self._start, self.begin)
        row = frames[self.number(carrier)]
        return Poses.fixed(row[:3], row[3:])

    def gap(self, carrier: BodyCarrier, points: FloatArray) -> tuple[float, float]:
        """Return the initial distance of points ``(P, 3)`` from a body's surface [m].

        The distance is that of the nearest point, 0 inside the body. Also returns the
        size of the body [m].
        """
        shared, number = self.system.shared, self.number(carrier)
        (shape_indices,) = np.nonzero(shared.shape_bodies == number)
        poses = self.system.poses(self._start, self.begin)
        shapes = [
            replace(shared.shapes[i], poses=Poses.fixed(poses[i, :3], poses[i, 3:]))
            for i in shape_indices.tolist()
        ]
        if not shapes:
            return 0.0, np.inf
        distances = Colliders(shapes).sample(points, self.begin).distances
        return max(float(distances.min()), 0.0), float(shared.reaches[number])

    def register_pusher(self, pusher: Any) -> None:
        """Register a system whose particles are attached to the bodies."""
        super().register_pusher(pusher)
        self._run.add_puller(self, pusher)

    def pulled_by(self, puller: Any, state: Any, t: float) -> Any:
        """Return a state at a time [s] within a step, with the pull applied."""
        pull = puller.pull(t, self)
        if pull is None:
            return state
        wrenches, begin, end = pull
        end_state, _ = self._run.past_state(end)
        centres = self.system.inertias(end_state)[0]
        fraction, current = (t - begin) / (end - begin), self.system.inertias(state)[0]

        def scaled(rows_: FloatArray, fraction: float) -> FloatArray:
            rows = fraction * rows_
            rows[:, 3:] += so3.cross(current - centres, rows[:, :3])
            return rows

        impulses, delayed = (
            scaled(wrenches.impulses, fraction),
            scaled(wrenches.delayed, fraction**2),
        )
        return self.system.pushed(state, Wrenches(impulses, delayed))

    def over(self, t0: float, t1: float) -> TiedStep:
        """Return the bodies over a step [s], without the pull."""
        start_state, _ = self._run.past_state(t0, begins=True)
        end_state, _ = self._run.past_state(t1)
        return TiedStep(self.system, start_state, end_state, t0, t1)


class TiedStep:
    """Bodies over a step with a pull by particles."""

    def __init__(
        self, simulation: RigidSystem, begins: Any, ends: Any, t0: float, t1: float
    ) -> None:
        self._simulation, self._ends, self._t1 = simulation, ends, t1
        self.begins = simulation.frames(begins, t0)  # poses of all bodies ``(B, 7)``
        self.begun, self.span = begins, t1 - t0  # state at the start; duration [s]
        self.free = simulation.free(t0)  # free bodies ``(count,)``
        self.inertias = simulation.inertias(ends)
        self._speeds = simulation.speeds(ends)[:, :3]
        self._pull_time = PULL_DISPLACEMENT * self.span

    @property
    def angle(self) -> float:
        """Largest rotation of a body [rad]."""
        spins = self._simulation.speeds(self.begun)[self.free, 3:]
        return self.span * float(np.linalg.norm(spins, axis=1).max(initial=0.0))

    def part(self, state: Any, t: float, dt: float) -> TiedStep:
        """Return the bodies over a part of the step [s], from a given state."""
        ends = self._simulation.step(state, t, dt)
        return TiedStep(self._simulation, state, ends, t, t + dt)

    def leading_to(self, state: Any) -> Wrenches:
        """Return the impulses at the end of the step that result in a given state."""
        return self._simulation.push_to(self._ends, state)

    def speeds_at(self, state: Any, number: int, points: FloatArray) -> FloatArray:
        """Return velocities of points ``(P, 3)`` on a dynamic body [m/s]."""
        speeds = self._simulation.speeds(state)[number]
        centre = self._simulation.inertias(state)[0][number]
        velocities: FloatArray = speeds[:3] + so3.cross(speeds[3:], points - centre)
        return velocities

    def begun_at(self, number: int, points: FloatArray) -> FloatArray:
        """Return velocities of points at the start [m/s]."""
        return self.speeds_at(self.begun, number, points)

    def turning(self, number: int, pull: FloatArray) -> FloatArray:
        """Return the moment of a pull ``(6,)`` about the displaced centre."""
        centre = self.inertias[0][number] - self._pull_time * self._speeds[number]
        moment: FloatArray = pull[3:] - so3.cross(centre, pull[:3])
        return moment

    def wrenches(self, pulls: FloatArray) -> Wrenches:
        """Return impulses and moments about the centres ``(count, 6)`` as a push."""
        impulses = pulls.copy()
        impulses[:, 3:] += so3.cross(self.inertias[0], pulls[:, :3])
        return Wrenches(impulses, self._pull_time * impulses)

    def pulled(self, wrenches: Wrenches) -> tuple[Any, FloatArray]:
        """Return the end state after a push, and poses of all bodies ``(B, 7)``."""
        state = self._simulation.pushed(self._ends, wrenches)
        return state, self._simulation.frames(state, self._t1)


def to_world(frame: FloatArray, local_points: FloatArray) -> FloatArray:
    """Transform points ``(P, 3)`` from a frame ``(7,)`` to the world [m]."""
    points: FloatArray = frame[:3] + so3.rotate(frame[3:], local_points)
    return points
