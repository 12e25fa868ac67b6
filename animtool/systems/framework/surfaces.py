"""A simulation as a collider of others: its mesh or its bodies."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths.faces import triangulate
from animtool.motion.frames import MeshFrame
from animtool.sim.colliders import Collider
from animtool.sim.colliders.bodies import Pusher, Wrenches


class ObservedRun(Protocol):
    """A simulation run whose present and past states can be sampled."""

    def past_state(self, t: float, *, with_pushes: bool = False) -> tuple[Any, float]:
        """Return the state at a time [s] and its time, before or after pushes."""

    def forget(self) -> None:
        """Drop past states that no observer needs."""

    def push(self, t: float, pusher_index: int, wrenches: Wrenches) -> None:
        """Queue impulses on the bodies of the run at a time [s]."""

    def register_pusher(self, pusher: Pusher) -> int:
        """Register a system that pushes the bodies; return the index of the pusher."""

    def add_puller(self, bodies: Any, puller: Any) -> None:
        """Register a system whose particles are attached to the bodies."""


@dataclass(frozen=True, eq=False)
class SystemBodies:
    """Names, masses and shapes of B rigid bodies, for other systems."""

    names: Sequence[str]  # (B,)
    dynamic_indices: IntArray  # indices of dynamic bodies (count,)
    masses: FloatArray  # masses of dynamic bodies (count,) [kg]
    bounding_radii: Sequence[float]  # about the centres of mass (B,) [m]
    shapes: Sequence[Collider]  # shapes of all bodies (C,)
    shape_bodies: IntArray  # body index of each shape (C,)

    @property
    def count(self) -> int:
        """Number of dynamic bodies, which other systems can push."""
        return len(self.dynamic_indices)

    @property
    def owners(self) -> IntArray:
        """Index of each shape's body among the dynamic bodies (C,); -1 if kinematic."""
        numbers = np.full(len(self.names), -1)
        numbers[self.dynamic_indices] = np.arange(self.count)
        return numbers[self.shape_bodies]


@runtime_checkable
class RigidSystem(Protocol):
    """A simulation of rigid bodies that other systems collide with, push or pull."""

    @property
    def shared(self) -> SystemBodies:
        """Names, masses and shapes of the bodies."""

    def initial_state(self) -> Any:
        """Return the state at the time of the first step."""

    def step(self, state: Any, t: float, dt: float) -> Any:
        """Return a new state, a step [s] after a time [s]."""

    def body_poses(self, state: Any, t: float) -> FloatArray:
        """Return the poses of all bodies ``(B, 7)`` at a time [s]."""

    def poses(self, state: Any, t: float) -> FloatArray:
        """Return the poses of the shapes ``(C, 7)`` at a time [s]."""

    def body_velocities(self, state: Any) -> FloatArray:
        """Return linear and angular velocities of dynamic bodies ``(count, 6)``."""

    def is_free(self, t: float) -> BoolArray:
        """Return a mask of bodies dynamic at and after a time [s] ``(count,)``."""

    def pushed(self, state: Any, wrenches: Wrenches) -> Any:
        """Return a state with impulses applied to the bodies."""

    def push_to(self, state: Any, target: Any) -> Wrenches:
        """Return the impulses that change one state to another at the same time."""

    def inverse_masses(
        self, state: Any, owners: IntArray, points: FloatArray, directions: FloatArray
    ) -> FloatArray:
        """Return inverse effective masses of bodies at points ``(K,)`` [1/kg]."""

    def inertias(self, state: Any) -> tuple[FloatArray, FloatArray]:
        """Return centres ``(count, 3)`` and inverse inertias ``(count, 3, 3)``."""


@runtime_checkable
class HasCollisionSurface(Protocol):
    """A simulation whose collision surface differs from its frame."""

    radius: float  # collision radius: half the thickness of the surface [m]
    closed: bool  # whether collisions are from outside only

    def surface(self, state: Any, t: float) -> MeshFrame:
        """Return the collision surface; equal topology returns the same index array."""


# Default half thickness of a surface [m].
DEFAULT_RADIUS = 1e-3
# Number of cached times: both ends of a step, and some within.
CACHED_TIMES = 4
Sample = TypeVar("Sample")


class _RecentSamples(Generic[Sample]):
    """Caches the samples at the most recently requested times."""

    def __init__(self, past_state: Callable[[float], Sample]) -> None:
        self._sample_at = past_state
        self._samples: dict[float, Sample] = {}

    def __call__(self, t: float) -> Sample:
        if t not in self._samples:
            while len(self._samples) >= CACHED_TIMES:
                del self._samples[min(self._samples)]
            self._samples[t] = self._sample_at(t)
        return self._samples[t]


class _StateObserver:
    """Samples present and past states of a run."""

    def __init__(self, run: ObservedRun) -> None:
        self._run = run
        self.earliest_time = -math.inf  # earliest time that may still be requested [s]

    def forget(self, t: float) -> None:
        """Let the run drop states before a time [s]."""
        if t > self.earliest_time:
            self.earliest_time = t
            self._run.forget()


class SystemSurface(_StateObserver):
    """The surface of a simulation, or of one of its entries, as a collider."""

    def __init__(self, run: ObservedRun, view: Any) -> None:
        super().__init__(run)
        has_surface = isinstance(view, HasCollisionSurface)
        self.radius: float = view.radius if has_surface else DEFAULT_RADIUS
        self.closed: bool = view.closed if has_surface else True
        frame_of = view.surface if has_surface else view.frame
        self._frames: _RecentSamples[MeshFrame] = _RecentSamples(
            lambda t: frame_of(*run.past_state(t))
        )
        self._indices = self._faces = np.zeros((0, 3), np.int64)

    def points(self, t: float) -> FloatArray:
        """Return the points of the surface ``(N, 3)`` [m] at a time [s]."""
        return self._frames(t).points

    def triangles(self, t: float) -> IntArray:
        """Return the triangles ``(T, 3)``; the same array while unchanged."""
        frame = self._frames(t)
        if frame.indices is not self._indices:
            self._indices = frame.indices
            self._faces = triangulate(frame.counts, frame.indices)
        return self._faces


class BodyColliders(_StateObserver):
    """The rigid bodies of a simulation as colliders (`MovingBodies`)."""

    def __init__(
        self,
        run: ObservedRun,
        simulation: RigidSystem,
        restitution: float,
        friction: float,
        *,
        two_way: bool,
    ) -> None:
        super().__init__(run)
        self._simulation, shared = simulation, simulation.shared
        self.colliders: Sequence[Collider] = [
            replace(shape, restitution=restitution, friction=friction)
            for shape in shared.shapes
        ]
        self.owners = shared.owners
        self.count = shared.count
        self.masses = shared.masses
        if not two_way:
            self.owners, self.count = np.full_like(self.owners, -1), 0
            self.masses = np.zeros(0)
        self.max_speed = 0.0
        self._states = _RecentSamples(run.past_state)
        self._poses = _RecentSamples(lambda t: simulation.poses(*self._states(t)))
        self._step_start_poses = _RecentSamples(
            lambda t: simulation.poses(*run.past_state(t, with_pushes=True))
        )
        self._pusher_index = 0

    def end_poses(self, t0: float, t1: float) -> FloatArray:
        """Return the poses of shapes at both ends of a step ``(C, 2, 7)``."""
        ends = np.stack([self._step_start_poses(t0), self._poses(t1)], axis=1)
        if t1 > t0 and len(ends):
            distances = np.linalg.norm(ends[:, 1, :3] - ends[:, 0, :3], axis=1)
            self.max_speed = max(self.max_speed, float(distances.max()) / (t1 - t0))
        return ends

    def inverse_masses(
        self, t: float, owners: IntArray, points: FloatArray, directions: FloatArray
    ) -> FloatArray:
        """Return inverse effective masses ``(K,)`` [1/kg] at a time [s].

        Masses are of bodies ``(K,)`` at points ``(K, 3)`` [m], along unit vectors
        ``(K, 3)``.
        """
        state, _ = self._states(t)
        return self._simulation.inverse_masses(state, owners, points, directions)

    def inertias(
        self, t: float, *, is_step_start: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Return centres ``(count, 3)`` [m] and inverse inertias ``(count, 3, 3)``.

        At a time [s], at the start or end of a step; inertias in the world [1/(kg m²)].
        """
        state, _ = (
            self._run.past_state(t, with_pushes=True)
            if is_step_start
            else self._states(t)
        )
        return self._simulation.inertias(state)

    def register_pusher(self, pusher: Pusher) -> None:
        """Register a system that pushes the bodies."""
        if self.count:
            self._pusher_index = self._run.register_pusher(pusher)

    def push(self, t: float, wrenches: Wrenches) -> None:
        """Queue impulses on the bodies at a time [s], for the next step."""
        self._run.push(t, self._pusher_index, wrenches)
