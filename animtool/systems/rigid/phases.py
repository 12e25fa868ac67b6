"""Bodies and joints as the kernel has them, until one is released or breaks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.sim.colliders import Collider, Colliders
from animtool.systems.rigid.bodies import Bodies
from animtool.systems.rigid.joints import Joints
from animtool.systems.rigid.surroundings import Surroundings

# Share of a step that a release may be before its end.
ON_TIME = 1e-9


@dataclass(frozen=True)
class Phase:
    """What is moved for a while, and by which joints.

    Attributes:
        number: Of the phase; contacts of another one are of other shapes.
        bodies: Those that are held go as they are told.
        free: Which of all that are ever moved ``(N,)``.
        joints: Those that hold.
        holding: Which these are of all ``(H,)``.
        surroundings: Colliders, with bodies that go as they are told.
        kernel: All of it.
        shapes: What shapes and colliders are numbered without phases ``(S,)``.
    """

    number: int
    bodies: Bodies
    free: BoolArray
    joints: Joints
    holding: IntArray
    surroundings: Surroundings
    kernel: Any
    shapes: IntArray

    @property
    def whole(self) -> bool:
        """Whether nothing is held."""
        return bool(self.free.all())

    def shapes_of(self, found: IntArray) -> IntArray:
        """Return numbers of shapes and colliders without phases."""
        inner = np.minimum(found, len(self.shapes) - 1)
        over = found - len(self.shapes)
        count = int(self.shapes.max(initial=-1)) + 1
        return np.where(over < 0, self.shapes[inner], count + over)

    def with_numbers(
        self, numbers: FloatArray, inertias: FloatArray | float = 1.0
    ) -> Any:
        """Return the kernel with other numbers of all joints, and factors on masses."""
        joints, first = self.joints, self.surroundings.first
        apart = self.bodies.apart(joints.apart, first)
        return self.bodies.kernel(joints.rows, numbers[self.holding], apart, inertias)


class Phases:
    """Phases of bodies, each built when it is first asked for.

    Args:
        bodies: As they are when all are released.
        joints_of: Returns the joints of bodies, and which of all they are.
        given: Colliders that come before those of bodies.
        still: Colliders behind these.
        around: Surfaces and bodies of other systems.
    """

    def __init__(
        self,
        bodies: Bodies,
        joints_of: Callable[[Bodies], tuple[Joints, IntArray]],
        given: Sequence[Collider],
        still: Sequence[Collider],
        around: Colliders,
    ) -> None:
        self._bodies, self._joints_of = bodies, joints_of
        self._given, self._still, self._around = list(given), list(still), around
        releases = bodies.releases[bodies.dynamic]
        self._releases = releases
        self._times = np.unique(releases[np.isfinite(releases)])
        self._known: dict[tuple[int, bytes], Phase] = {}

    @property
    def last(self) -> int:
        """The number of the phase in which nothing is held any more."""
        return len(self._times)

    def number(self, t: float, dt: float) -> int:
        """Return the number of the phase that a step at a time [s] is of."""
        reached = t + ON_TIME * dt
        return int(np.searchsorted(self._times, reached, side="right"))

    def free(self, t: float, dt: float) -> BoolArray:
        """Return who moves by itself in a step [s] at a time [s] ``(N,)``."""
        found: BoolArray = self._releases <= t + ON_TIME * dt
        return found

    def at(self, number: int, broken: BoolArray) -> Phase:
        """Return a phase without joints that are broken ``(K,)``."""
        key = number, broken.tobytes()
        if key not in self._known:
            if len(self._known) > 1:
                self._known.pop(next(iter(self._known)))
            self._known[key] = self._made(number, broken)
        return self._known[key]

    def _made(self, number: int, broken: BoolArray) -> Phase:
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
            [*self._given, *bodies.colliders(), *self._still],
            self._around.sheets,
            self._around.bodies,
        )
        first = len(self._given)
        apart = bodies.apart(joints.apart, first)
        kernel = bodies.kernel(joints.rows, joints.numbers, apart)
        surroundings = Surroundings(colliders, first)
        shapes = self._shapes(bodies, len(colliders))
        return Phase(
            number, bodies, free, joints, holding, surroundings, kernel, shapes
        )

    def _shapes(self, bodies: Bodies, colliders: int) -> IntArray:
        """Return what shapes and rigid colliders are numbered without phases."""
        full, first = self._bodies, len(self._given)
        if bodies is full:
            return np.arange(len(full.shapes[1]) + colliders)
        place = {int(i): k for k, i in enumerate(full.dynamic)}
        count = len(full.shapes[1])
        begins = np.searchsorted(full.shapes[1], np.arange(len(full.dynamic)))
        made: list[int] = []
        for i in bodies.dynamic.tolist():
            made += range(
                begins[place[i]],
                begins[place[i]] + len(full.kinds[full.of[i]].cores),
            )
        behind = count + first
        own: list[int] = []
        for i in np.flatnonzero(~bodies.moved).tolist():
            shapes = len(full.kinds[full.of[i]].shapes)
            if full.moved[i]:
                own += range(begins[place[i]], begins[place[i]] + shapes)
            else:
                own += range(behind, behind + shapes)
                behind += shapes
        rest = range(behind, behind + len(self._still))
        return np.array([*made, *range(count, count + first), *own, *rest], np.int64)


def held_states(bodies: Bodies, numbers: IntArray, t: float, dt: float) -> FloatArray:
    """Return states of bodies that go as they are told ``(H, 14)`` at a time [s].

    With the velocity that they come with, of the step [s] before.
    """
    rows = np.zeros((len(numbers), 14))
    for row, number in zip(rows, numbers.tolist(), strict=True):
        row[:] = bodies.told(number, t, dt)
    return rows
