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
ON_TIME = 1e-9


@dataclass(frozen=True)
class BodyPhase:
    """Dynamic bodies and active joints during one phase.

    Attributes:
        number: Of the phase; contacts of other phases refer to other shapes.
        bodies: The bodies, those not released yet kinematic.
        free: Which bodies are dynamic, of all that ever are ``(N,)``.
        joints: Intact joints.
        holding: Their indices among all joints ``(H,)``.
        surroundings: Colliders, with kinematic bodies.
        kernel: The kernel's arrays.
        shapes: Numbers of shapes and colliders in the full system ``(S,)``.
    """

    number: int
    bodies: RigidBodies
    free: BoolArray
    joints: Joints
    holding: IntArray
    surroundings: StepColliders
    kernel: Any
    shapes: IntArray

    @property
    def full(self) -> bool:
        """Whether all bodies are dynamic."""
        return bool(self.free.all())

    def shapes_of(self, numbers: IntArray) -> IntArray:
        """Return numbers of shapes and colliders in the full system."""
        inner = np.minimum(numbers, len(self.shapes) - 1)
        over = numbers - len(self.shapes)
        count = int(self.shapes.max(initial=-1)) + 1
        return np.where(over < 0, self.shapes[inner], count + over)

    def with_numbers(
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
        bodies: As they are when all are released.
        joints_of: Returns the joints of bodies, and which of all they are.
        given: Colliders that come before those of bodies.
        still: Colliders behind these.
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
        self._known: dict[tuple[int, bytes], BodyPhase] = {}

    @property
    def last(self) -> int:
        """The number of the phase after all releases."""
        return len(self._times)

    def number(self, t: float, dt: float) -> int:
        """Return the phase of a step that starts at a time [s]."""
        reached = t + ON_TIME * dt
        return int(np.searchsorted(self._times, reached, side="right"))

    def free(self, t: float, dt: float) -> BoolArray:
        """Return which bodies are dynamic in a step [s] at a time [s] ``(N,)``."""
        free: BoolArray = self._releases <= t + ON_TIME * dt
        return free

    def at(self, number: int, broken: BoolArray) -> BodyPhase:
        """Return a phase without broken joints ``(K,)``."""
        key = number, broken.tobytes()
        if key not in self._known:
            if len(self._known) > 1:
                self._known.pop(next(iter(self._known)))
            self._known[key] = self._built(number, broken)
        return self._known[key]

    def _built(self, number: int, broken: BoolArray) -> BodyPhase:
        last = self._times[number - 1] if number else -np.inf
        free = np.asarray(~(self._releases > last), np.bool_)
        bodies = self._bodies
        if not free.all():
            moved = bodies.moved.copy()
            moved[bodies.dynamic[~free]] = False
            bodies = replace(bodies, moved=moved)
        joints, holding = self._joints_of(bodies)
        kept = np.flatnonzero(~broken[holding]) if len(broken) else holding
        if len(kept) < len(holding):
            joints, holding = joints.some(kept), holding[kept]
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
        full, first = self._bodies, len(self._colliders)
        if bodies is full:
            return np.arange(len(full.shapes[1]) + colliders)
        numbers = {int(i): k for k, i in enumerate(full.dynamic)}
        count = len(full.shapes[1])
        begins = np.searchsorted(full.shapes[1], np.arange(len(full.dynamic)))
        dynamic: list[int] = []
        for i in bodies.dynamic.tolist():
            dynamic += range(
                begins[numbers[i]],
                begins[numbers[i]] + len(full.kinds[full.of[i]].cores),
            )
        behind = count + first
        kinematic: list[int] = []
        for i in np.flatnonzero(~bodies.moved).tolist():
            shapes = len(full.kinds[full.of[i]].shapes)
            if full.moved[i]:
                kinematic += range(begins[numbers[i]], begins[numbers[i]] + shapes)
            else:
                kinematic += range(behind, behind + shapes)
                behind += shapes
        rest = range(behind, behind + len(self._static))
        return np.array(
            [*dynamic, *range(count, count + first), *kinematic, *rest], np.int64
        )


def kinematic_states(
    bodies: RigidBodies, numbers: IntArray, t: float, dt: float
) -> FloatArray:
    """Return states of kinematic bodies ``(H, 14)`` at a time [s].

    With the velocity that they come with, of the step [s] before.
    """
    rows = np.zeros((len(numbers), 14))
    for row, number in zip(rows, numbers.tolist(), strict=True):
        row[:] = bodies.kinematic_state(number, t, dt)
    return rows
