"""Sets of dynamic bodies and intact joints, which change at releases and breaks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from itertools import compress
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
class ActiveSet:
    """The dynamic bodies and intact joints between two releases or breaks."""

    # Number of releases before it; contacts of other sets refer to other shapes.
    set_index: int
    bodies: RigidBodies  # all bodies; those not released yet are kinematic
    is_free: BoolArray  # mask of dynamic bodies among those that are ever dynamic (N,)
    joints: Joints  # intact joints
    intact_joints: IntArray  # indices of intact joints among all joints (H,)
    surroundings: StepColliders  # colliders, with kinematic bodies
    shape_indices: IntArray  # indices of shapes and colliders in the full system (S,)

    def full_shape_indices(self, indices: IntArray) -> IntArray:
        """Convert shape and collider indices to those of the full system."""
        full_indices = self.shape_indices[
            np.minimum(indices, len(self.shape_indices) - 1)
        ]
        collider_indices = indices - len(self.shape_indices)
        count = int(self.shape_indices.max(initial=-1)) + 1
        return np.where(collider_indices < 0, full_indices, count + collider_indices)

    @cached_property
    def kernel(self) -> Any:
        """Bodies and joints as a kernel object."""
        return self.with_parameters(self.joints.parameters)

    def with_parameters(
        self, joint_parameters: FloatArray, mass_factors: FloatArray | float = 1.0
    ) -> Any:
        """Return the kernel object with other parameters of the intact joints."""
        joints, static_count = self.joints, self.surroundings.first_collider
        excluded_pairs = self.bodies.excluded_pairs(joints.excluded_pairs, static_count)
        return self.bodies.build_kernel(
            joints.kinds_and_bodies, joint_parameters, excluded_pairs, mass_factors
        )


class ActiveSets:
    """Active sets of a rigid system, each built on first use.

    Args:
        bodies: Bodies after all releases.
        joints: All joints.
        colliders: Colliders before those of kinematic bodies, and other systems.
        stage_colliders: Colliders after those of kinematic bodies.
    """

    def __init__(
        self,
        bodies: RigidBodies,
        joints: Joints,
        colliders: Colliders,
        stage_colliders: Sequence[Collider],
    ) -> None:
        self._bodies, self._joints = bodies, joints
        self._colliders, self._stage_colliders = colliders, stage_colliders
        release_times = bodies.release_times[bodies.dynamic_indices]
        self._release_times = release_times
        self._set_starts = np.unique(release_times[np.isfinite(release_times)])
        self._active_sets: dict[tuple[int, bytes], ActiveSet] = {}

    @property
    def last_index(self) -> int:
        """Index of the set after all releases."""
        return len(self._set_starts)

    def set_index(self, t: float, dt: float) -> int:
        """Return the index of the set in a step that starts at a time [s]."""
        time = t + RELEASE_TOLERANCE * dt
        return int(np.searchsorted(self._set_starts, time, side="right"))

    def is_free(self, t: float, dt: float) -> BoolArray:
        """Return a mask of bodies that are dynamic in a step at a time [s] ``(N,)``."""
        is_free: BoolArray = self._release_times <= t + RELEASE_TOLERANCE * dt
        return is_free

    def active_set(self, index: int, is_broken: BoolArray) -> ActiveSet:
        """Return the set of an index, without the broken joints of a mask ``(K,)``."""
        key = index, is_broken.tobytes()
        if key not in self._active_sets:
            if len(self._active_sets) > 1:
                self._active_sets.pop(next(iter(self._active_sets)))
            self._active_sets[key] = self._build_set(index, is_broken)
        return self._active_sets[key]

    def _build_set(self, index: int, is_broken: BoolArray) -> ActiveSet:
        """Build the set of an index, without the broken joints of a mask ``(K,)``."""
        release_time = self._set_starts[index - 1] if index else -np.inf
        is_free = np.asarray(~(self._release_times > release_time), np.bool_)
        bodies = self._bodies
        if not is_free.all():
            is_dynamic = bodies.is_dynamic.copy()
            is_dynamic[bodies.dynamic_indices[~is_free]] = False
            bodies = replace(bodies, is_dynamic=is_dynamic)
        joints, intact_joints = subset_joints(self._joints, self._bodies, bodies)
        if len(is_broken) and is_broken[intact_joints].any():
            is_intact = ~is_broken[intact_joints]
            joints = replace(joints, members=list(compress(joints.members, is_intact)))
            intact_joints = intact_joints[is_intact]
        colliders = Colliders(
            [*self._colliders, *bodies.colliders(), *self._stage_colliders],
            self._colliders.sheets,
            self._colliders.bodies,
        )
        static_count = len(self._colliders)
        surroundings = StepColliders(colliders, static_count)
        shape_indices = self._shape_indices(bodies, len(colliders))
        return ActiveSet(
            index, bodies, is_free, joints, intact_joints, surroundings, shape_indices
        )

    def _shape_indices(self, bodies: RigidBodies, collider_count: int) -> IntArray:
        """Return the indices of shapes and rigid colliders in the full system."""
        all_bodies, static_count = self._bodies, len(self._colliders)
        owners = all_bodies.cores_and_bodies[1]
        if bodies is all_bodies:
            return np.arange(len(owners) + collider_count)
        first_shape_indices = np.searchsorted(
            owners, np.arange(len(all_bodies.dynamic_indices))
        )
        dynamic_bodies = all_bodies.dynamic_indices.tolist()
        first_shape_of_body = dict(
            zip(dynamic_bodies, first_shape_indices.tolist(), strict=True)
        )
        shape_indices: list[int] = []
        for i in bodies.dynamic_indices.tolist():
            first_shape = first_shape_of_body[i]
            shape_indices += range(
                first_shape, first_shape + len(all_bodies.kind_of(i).cores)
            )
        next_collider = len(owners) + static_count
        shape_indices += range(len(owners), next_collider)
        for i in np.flatnonzero(~bodies.is_dynamic).tolist():
            # Bodies that are never dynamic only have colliders.
            first_shape = first_shape_of_body.get(i, next_collider)
            count = len(all_bodies.kind_of(i).shapes)
            shape_indices += range(first_shape, first_shape + count)
            next_collider += 0 if i in first_shape_of_body else count
        shape_indices += range(
            next_collider, next_collider + len(self._stage_colliders)
        )
        return np.array(shape_indices, np.int64)
