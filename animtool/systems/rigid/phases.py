"""Dynamic bodies and active joints over time, split at releases and breaks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.sim.colliders import Collider, Colliders
from animtool.systems.rigid.bodies import RigidBodies
from animtool.systems.rigid.joints import Joints, subset_joints
from animtool.systems.rigid.surroundings import StepColliders

# Rounding tolerance of release times at the start of a step, in steps [1].
RELEASE_TOLERANCE = 1e-9


@dataclass(frozen=True)
class BodyPhase:
    """The dynamic bodies and intact joints between two releases or breaks."""

    # Index of the phase; contacts of other phases refer to other shapes.
    phase_index: int
    bodies: RigidBodies  # all bodies; those not released yet are kinematic
    is_free: BoolArray  # mask of dynamic bodies among those that are ever dynamic (N,)
    joints: Joints  # intact joints
    intact_joints: IntArray  # indices of intact joints among all joints (H,)
    surroundings: StepColliders  # colliders, with kinematic bodies
    kernel: Any  # bodies and joints as a kernel object
    shapes: IntArray  # indices of shapes and colliders in the full system (S,)

    def full_shape_indices(self, indices: IntArray) -> IntArray:
        """Convert shape and collider indices to those of the full system."""
        full_indices = self.shapes[np.minimum(indices, len(self.shapes) - 1)]
        collider_indices = indices - len(self.shapes)
        count = int(self.shapes.max(initial=-1)) + 1
        return np.where(collider_indices < 0, full_indices, count + collider_indices)

    def with_parameters(
        self, joint_parameters: FloatArray, mass_factors: FloatArray | float = 1.0
    ) -> Any:
        """Return the kernel object with other parameters of the intact joints."""
        joints, first = self.joints, self.surroundings.first
        excluded = self.bodies.excluded_pairs(joints.excluded_pairs, first)
        return self.bodies.kernel(joints.rows, joint_parameters, excluded, mass_factors)


class BodyPhases:
    """Phases of a system, each built on first use.

    Args:
        bodies: Bodies after all releases.
        joints: All joints.
        colliders: Colliders before those of kinematic bodies, and other systems.
        static: Colliders after those of kinematic bodies.
    """

    def __init__(
        self,
        bodies: RigidBodies,
        joints: Joints,
        colliders: Colliders,
        static: Sequence[Collider],
    ) -> None:
        self._bodies, self._joints = bodies, joints
        self._colliders, self._static = colliders, static
        releases = bodies.releases[bodies.dynamic]
        self._releases = releases
        self._times = np.unique(releases[np.isfinite(releases)])
        self._phases: dict[tuple[int, bytes], BodyPhase] = {}

    @property
    def last_index(self) -> int:
        """Index of the phase after all releases."""
        return len(self._times)

    def phase_index(self, t: float, dt: float) -> int:
        """Return the index of the phase of a step that starts at a time [s]."""
        time = t + RELEASE_TOLERANCE * dt
        return int(np.searchsorted(self._times, time, side="right"))

    def is_free(self, t: float, dt: float) -> BoolArray:
        """Return a mask of bodies that are dynamic in a step at a time [s] ``(N,)``."""
        is_free: BoolArray = self._releases <= t + RELEASE_TOLERANCE * dt
        return is_free

    def phase(self, index: int, is_broken: BoolArray) -> BodyPhase:
        """Return a phase without the broken joints; mask ``(K,)``."""
        key = index, is_broken.tobytes()
        if key not in self._phases:
            if len(self._phases) > 1:
                self._phases.pop(next(iter(self._phases)))
            self._phases[key] = self._build(index, is_broken)
        return self._phases[key]

    def _build(self, index: int, is_broken: BoolArray) -> BodyPhase:
        """Build a phase without the broken joints."""
        release_time = self._times[index - 1] if index else -np.inf
        is_free = np.asarray(~(self._releases > release_time), np.bool_)
        bodies = self._bodies
        if not is_free.all():
            is_dynamic = bodies.is_dynamic.copy()
            is_dynamic[bodies.dynamic[~is_free]] = False
            bodies = replace(bodies, is_dynamic=is_dynamic)
        joints, intact_joints = subset_joints(self._joints, self._bodies, bodies)
        if len(is_broken) and is_broken[intact_joints].any():
            intact = np.flatnonzero(~is_broken[intact_joints])
            joints, intact_joints = joints.subset(intact), intact_joints[intact]
        colliders = Colliders(
            [*self._colliders, *bodies.colliders(), *self._static],
            self._colliders.sheets,
            self._colliders.bodies,
        )
        first = len(self._colliders)
        excluded = bodies.excluded_pairs(joints.excluded_pairs, first)
        kernel = bodies.kernel(joints.rows, joints.numbers, excluded)
        surroundings = StepColliders(colliders, first)
        shapes = self._shapes(bodies, len(colliders))
        return BodyPhase(
            index, bodies, is_free, joints, intact_joints, surroundings, kernel, shapes
        )

    def _shapes(self, bodies: RigidBodies, colliders: int) -> IntArray:
        """Return the indices of shapes and rigid colliders in the full system."""
        all_bodies, first = self._bodies, len(self._colliders)
        owners = all_bodies.shapes[1]
        if bodies is all_bodies:
            return np.arange(len(owners) + colliders)
        first_shapes = np.searchsorted(owners, np.arange(len(all_bodies.dynamic)))
        dynamic = all_bodies.dynamic.tolist()
        first_shape_of_body = dict(zip(dynamic, first_shapes.tolist(), strict=True))
        shapes: list[int] = []
        for i in bodies.dynamic.tolist():
            start = first_shape_of_body[i]
            shapes += range(start, start + len(all_bodies.kind_of(i).cores))
        next_collider = len(owners) + first
        shapes += range(len(owners), next_collider)
        for i in np.flatnonzero(~bodies.is_dynamic).tolist():
            # Bodies that are never dynamic only have colliders.
            start = first_shape_of_body.get(i, next_collider)
            count = len(all_bodies.kind_of(i).shapes)
            shapes += range(start, start + count)
            next_collider += 0 if i in first_shape_of_body else count
        shapes += range(next_collider, next_collider + len(self._static))
        return np.array(shapes, np.int64)
