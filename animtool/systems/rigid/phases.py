"""Dynamic bodies and active joints over time, split at releases and breaks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.sim.colliders import Collider, Colliders
from animtool.systems.rigid.bodies import RigidBodies
from animtool.systems.rigid.joints import Joints
from animtool.systems.rigid.surroundings import StepColliders

# Tolerance of release times before the end of a step, in steps.
RELEASE_TOLERANCE = 1e-9


@dataclass(frozen=True)
class BodyPhase:
    """Dynamic bodies and active joints during one phase.

    Attributes:
        number: Index of the phase; contacts of other phases refer to other shapes.
        bodies: The bodies; those not released yet are kinematic.
        free: Mask of dynamic bodies among those that are ever dynamic ``(N,)``.
        joints: Intact joints.
        holding: Their indices among all joints ``(H,)``.
        surroundings: Colliders, with kinematic bodies.
        kernel: The kernel's arrays.
        shapes: Numbers of shapes and colliders in the full system ``(S,)``.
    """

    number: int
    bodies: RigidBodies
    is_free: BoolArray
    joints: Joints
    holding: IntArray
    surroundings: StepColliders
    kernel: Any
    shapes: IntArray

    @property
    def full(self) -> bool:
        """Whether all bodies are dynamic."""
        return bool(self.is_free.all())

    def shapes_of(self, numbers: IntArray) -> IntArray:
        """Return numbers of shapes and colliders in the full system."""
        index = np.minimum(numbers, len(self.shapes) - 1)
        excess = numbers - len(self.shapes)
        count = int(self.shapes.max(initial=-1)) + 1
        return np.where(excess < 0, self.shapes[index], count + excess)

    def with_parameters(
        self, numbers: FloatArray, inertias: FloatArray | float = 1.0
    ) -> Any:
        """Return kernel arrays with other joint numbers and mass factors."""
        joints, first = self.joints, self.surroundings.first
        excluded = self.bodies.excluded_pairs(joints.excluded_pairs, first)
        return self.bodies.kernel(
            joints.rows, numbers[self.holding], excluded, inertias
        )


class BodyPhases:
    """Phases of a system, built when first used.

    Args:
        bodies: Bodies after all releases.
        joints_of: Returns the joints of bodies, and their indices among all joints.
        colliders: Colliders before those of kinematic bodies.
        static: Colliders after those of kinematic bodies.
        around: Surfaces and bodies of other systems.
    """

    def __init__(
        self,
        bodies: RigidBodies,
        joints_of: Callable[[RigidBodies], tuple[Joints, IntArray]],
        colliders: Sequence[Collider],
        static: Sequence[Collider],
        around: Colliders,
    ) -> None:
        self._bodies, self._joints_of = bodies, joints_of
        self._colliders, self._static, self._around = (
            list(colliders),
            list(static),
            around,
        )
        releases = bodies.releases[bodies.dynamic]
        self._releases = releases
        self._times = np.unique(releases[np.isfinite(releases)])
        self._phases: dict[tuple[int, bytes], BodyPhase] = {}

    @property
    def last(self) -> int:
        """The number of the phase after all releases."""
        return len(self._times)

    def number(self, t: float, dt: float) -> int:
        """Return the phase of a step that starts at a time [s]."""
        time = t + RELEASE_TOLERANCE * dt
        return int(np.searchsorted(self._times, time, side="right"))

    def is_free(self, t: float, dt: float) -> BoolArray:
        """Return a mask of the bodies dynamic in a step [s] at a time [s] ``(N,)``."""
        free: BoolArray = self._releases <= t + RELEASE_TOLERANCE * dt
        return free

    def at(self, number: int, broken: BoolArray) -> BodyPhase:
        """Return a phase without broken joints ``(K,)``."""
        key = number, broken.tobytes()
        if key not in self._phases:
            if len(self._phases) > 1:
                self._phases.pop(next(iter(self._phases)))
            self._phases[key] = self._build(number, broken)
        return self._phases[key]

    def _build(self, number: int, broken: BoolArray) -> BodyPhase:
        last = self._times[number - 1] if number else -np.inf
        free = np.asarray(~(self._releases > last), np.bool_)
        bodies = self._bodies
        if not free.all():
            is_dynamic = bodies.is_dynamic.copy()
            is_dynamic[bodies.dynamic[~free]] = False
            bodies = replace(bodies, is_dynamic=is_dynamic)
        joints, holding = self._joints_of(bodies)
        intact = np.flatnonzero(~broken[holding]) if len(broken) else holding
        if len(intact) < len(holding):
            joints, holding = joints.subset(intact), holding[intact]
        colliders = Colliders(
            [*self._colliders, *bodies.colliders(), *self._static],
            self._around.sheets,
            self._around.bodies,
        )
        first = len(self._colliders)
        excluded = bodies.excluded_pairs(joints.excluded_pairs, first)
        kernel = bodies.kernel(joints.rows, joints.numbers, excluded)
        surroundings = StepColliders(colliders, first)
        shapes = self._shapes(bodies, len(colliders))
        return BodyPhase(
            number, bodies, free, joints, holding, surroundings, kernel, shapes
        )

    def _shapes(self, bodies: RigidBodies, colliders: int) -> IntArray:
        """Return the numbers of shapes and rigid colliders in the full system."""
        all_bodies, first = self._bodies, len(self._colliders)
        if bodies is all_bodies:
            return np.arange(len(all_bodies.shapes[1]) + colliders)
        dynamic_indices = {int(i): k for k, i in enumerate(all_bodies.dynamic)}
        count = len(all_bodies.shapes[1])
        first_shapes = np.searchsorted(
            all_bodies.shapes[1], np.arange(len(all_bodies.dynamic))
        )
        dynamic: list[int] = []
        for i in bodies.dynamic.tolist():
            dynamic += range(
                first_shapes[dynamic_indices[i]],
                first_shapes[dynamic_indices[i]]
                + len(all_bodies.kinds[all_bodies.of[i]].cores),
            )
        next_collider = count + first
        kinematic: list[int] = []
        for i in np.flatnonzero(~bodies.is_dynamic).tolist():
            shapes = len(all_bodies.kinds[all_bodies.of[i]].shapes)
            if all_bodies.is_dynamic[i]:
                kinematic += range(
                    first_shapes[dynamic_indices[i]],
                    first_shapes[dynamic_indices[i]] + shapes,
                )
            else:
                kinematic += range(next_collider, next_collider + shapes)
                next_collider += shapes
        static_range = range(next_collider, next_collider + len(self._static))
        return np.array(
            [*dynamic, *range(count, count + first), *kinematic, *static_range],
            np.int64,
        )


def kinematic_states(
    bodies: RigidBodies, numbers: IntArray, t: float, dt: float
) -> FloatArray:
    """Return states of kinematic bodies ``(H, 14)`` at a time [s].

    Velocities are those of the previous step [s].
    """
    rows = np.zeros((len(numbers), 14))
    for row, number in zip(rows, numbers.tolist(), strict=True):
        row[:] = bodies.kinematic_state(number, t, dt)
    return rows
