"""Rigid bodies of a spec: initial poses, and the kernel's arrays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import field, replace
from functools import cached_property
from typing import Any, NoReturn

import numpy as np

from animtool import _kernels
from animtool.core.array_types import ArrayLike, BoolArray, FloatArray, IntArray
from animtool.core.errors import (
    Fault,
    OptionError,
    RefusalCollector,
    counted,
    refuse,
    refuse_all,
)
from animtool.core.names import name_hint
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.faces import triangulate
from animtool.sim.colliders import Collider, Mesh, Poses, Shape
from animtool.systems.rigid.cores import ConvexCore, core_mesh, core_of
from animtool.systems.rigid.kind import (
    MAX_BODIES,
    BodyKind,
    build_body_kind,
    copy_placements,
    motion_key_problems,
)
from animtool.systems.rigid.spec import BodyModel

NO_PAIRS = np.zeros((0, 2), np.int64)


@dataclass(frozen=True, slots=True)
class CollisionShapes:
    """Collision shapes of all bodies, as colliders of other systems."""

    colliders: Sequence[Collider]
    body_of_shape: IntArray  # body of each shape (C,)
    origins: FloatArray  # origins in the frames of the bodies (C, 3) [m]
    rotations: FloatArray  # quaternions in the frames of the bodies (C, 4)


@dataclass(frozen=True)
class RigidBodies:
    """All bodies of a system: N dynamic bodies; all others are kinematic."""

    kinds: Sequence[BodyKind]  # body kind of each entry of the file
    names: Sequence[str]  # names of all bodies
    kind_of_body: IntArray  # kind index of each body (B,)
    is_dynamic: BoolArray  # mask of dynamic bodies (B,)
    # Poses of each body over time; of a dynamic one the initial pose.
    poses: Sequence[Poses]
    begin: float
    dynamic_indices: IntArray = field(init=False)  # indices of dynamic bodies (N,)

    def __post_init__(self) -> None:
        """Find the dynamic bodies."""
        object.__setattr__(self, "dynamic_indices", np.flatnonzero(self.is_dynamic))

    @staticmethod
    def from_models(
        models: Sequence[BodyModel],
        body_data: Sequence[Mapping[str, Any]],
        begin: float,
    ) -> RigidBodies:
        """Return the bodies described by the models of a spec, copies included."""
        kinds: list[BodyKind] = []
        names, entry_indices, is_dynamic, poses = [], [], [], []
        used_names: set[str] = set()
        refusals = RefusalCollector()
        for entry_index, (model, entry_data) in enumerate(
            zip(models, body_data, strict=True)
        ):
            location = entry_data.get("entry", f"bodies[{entry_index}]")
            origin = entry_data.get("origin")
            with refusals.collect(), _entry_faults(location, origin):
                if model.name in used_names:
                    refuse("SIM061", f"two bodies are named {model.name!r}", "name")
            with refusals.collect(), _entry_faults(location, origin):
                refuse_all("SIM061", motion_key_problems(model))
            with refusals.collect(), _entry_faults(location, origin):
                kind = build_body_kind(model, entry_data)
                points, rotations = copy_placements(model, entry_data)
            used_names.add(model.name)
            if refusals.faults:
                continue
            notices = [
                locate_fault(notice, location, origin) for notice in kind.notices
            ]
            kinds.append(
                replace(kind, notices=notices, location=location, origin=origin)
            )
            entry_poses: Poses = entry_data["poses"]
            for k, (point, rotation) in enumerate(zip(points, rotations, strict=True)):
                is_numbered = len(points) > 1 or model.grid is not None
                names.append(f"{model.name}[{k}]" if is_numbered else model.name)
                entry_indices.append(entry_index)
                is_dynamic.append(not model.kinematic or model.release is not None)
                poses.append(offset_poses(entry_poses, point, rotation))
        refusals.check()
        if len(names) > MAX_BODIES:
            message = f"there are {len(names)} bodies; the limit is {MAX_BODIES}"
            refuse("SIM061", message, "bodies")
        return RigidBodies(
            kinds,
            names,
            np.array(entry_indices),
            np.array(is_dynamic, np.bool_),
            poses,
            begin,
        )

    @cached_property
    def release_times(self) -> FloatArray:
        """Time at which each body is released ``(B,)`` [s]; -infinity if none is set.

        Without a release, dynamic bodies move freely from the start, and kinematic
        bodies never do.
        """
        times = [kind.model.release for kind in self.kinds]
        times_by_kind = [-np.inf if time is None else time for time in times]
        return np.array(times_by_kind, np.float64)[self.kind_of_body]

    @cached_property
    def static_bodies(self) -> frozenset[int]:
        """Indices of kinematic bodies that never move."""
        kinematic_indices = np.flatnonzero(~self.is_dynamic).tolist()
        return frozenset(i for i in kinematic_indices if self.poses[i].is_fixed)

    @cached_property
    def masses(self) -> FloatArray:
        """Masses of dynamic bodies ``(N,)`` [kg]."""
        return self._per_dynamic_body([kind.mass for kind in self.kinds])

    @cached_property
    def moments(self) -> FloatArray:
        """Principal moments of inertia of dynamic bodies ``(N, 3)`` [kg m²]."""
        return self._per_dynamic_body([kind.moments for kind in self.kinds])

    @cached_property
    def inverse_inertias(self) -> FloatArray:
        """Inverses of `moments` ``(N, 3)`` [1/(kg m²)]; 0 where a moment is 0."""
        moments = self.moments
        return np.divide(1.0, moments, out=np.zeros_like(moments), where=moments > 0)

    @cached_property
    def axes(self) -> FloatArray:
        """Rotations from principal axes to the frames of dynamic bodies ``(N, 4)``."""
        return self._per_dynamic_body([kind.axes for kind in self.kinds])

    @cached_property
    def centres(self) -> FloatArray:
        """Centres of mass of dynamic bodies, in body frames ``(N, 3)`` [m]."""
        return self._per_dynamic_body([kind.centre for kind in self.kinds])

    @cached_property
    def bounding_radii(self) -> FloatArray:
        """Bounding radii of dynamic bodies about the centre of mass ``(N,)`` [m]."""
        return self._per_dynamic_body([kind.bounding_radius for kind in self.kinds])

    def _per_dynamic_body(self, values_by_kind: Sequence[ArrayLike]) -> FloatArray:
        """Return the value of each dynamic body, from those of the kinds ``(N, …)``."""
        return np.array(values_by_kind)[self.kind_of_body[self.dynamic_indices]]

    def kind_of(self, body: int) -> BodyKind:
        """Return the kind of a body, by its index among all bodies."""
        return self.kinds[int(self.kind_of_body[body])]

    @cached_property
    def initial_states(self) -> FloatArray:
        """Initial states of dynamic bodies, in the kernel's layout ``(N, 14)``."""
        poses = np.array([self.poses[i].at(self.begin) for i in self.dynamic_indices])
        poses = poses.reshape(-1, 7)
        models = [self.kind_of(i).model for i in self.dynamic_indices]
        velocities = np.array([m.velocity for m in models], np.float64).reshape(-1, 3)
        spins = np.radians([m.spin for m in models]).reshape(-1, 3)
        centres = poses[:, :3] + so3.rotate(poses[:, 3:], self.centres)
        rotations = so3.multiply(poses[:, 3:], self.axes)
        spins_local = so3.rotate(so3.conjugate(rotations), spins)
        momenta = so3.rotate(rotations, spins_local * self.moments)
        columns = [centres, rotations, velocities, momenta, np.zeros((len(poses), 1))]
        return np.concatenate(columns, axis=1)

    def kinematic_state(self, dynamic_index: int, t: float, dt: float) -> FloatArray:
        """Return the state of a body that is not released yet ``(14,)``.

        The velocities are averages over the step [s] before ``t``.
        """
        i = int(self.dynamic_indices[dynamic_index])
        previous_pose, pose = self.poses[i].at(t - dt), self.poses[i].at(t)
        offset, moments = self.centres[dynamic_index], self.moments[dynamic_index]
        previous_centre = previous_pose[:3] + so3.rotate(previous_pose[3:], offset)
        centre = pose[:3] + so3.rotate(pose[3:], offset)
        spin = so3.log(so3.multiply(pose[3:], so3.conjugate(previous_pose[3:]))) / dt
        rotation = so3.multiply(pose[3:], self.axes[dynamic_index])
        momentum_local = so3.rotate(so3.conjugate(rotation), spin) * moments
        velocity = (centre - previous_centre) / dt
        momentum = so3.rotate(rotation, momentum_local)
        return np.concatenate([centre, rotation, velocity, momentum, [0.0]])

    def spins(self, state: FloatArray) -> FloatArray:
        """Return world angular velocities of dynamic bodies ``(N, 3)`` [rad/s]."""
        spins = so3.rotate(so3.conjugate(state[:, 3:7]), state[:, 10:13])
        moments = self.moments
        spins = np.divide(spins, moments, out=np.zeros_like(spins), where=moments > 0)
        return so3.rotate(state[:, 3:7], spins)

    def body_frames(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return origins ``(N, 3)`` [m] and rotations ``(N, 4)`` of body frames."""
        rotations = so3.multiply(state[:, 3:7], so3.conjugate(self.axes))
        return state[:, :3] - so3.rotate(rotations, self.centres), rotations

    def colliders(self) -> list[Collider]:
        """Return the shapes of kinematic bodies as colliders."""
        return [
            Collider(
                shape,
                offset_poses(self.poses[i], origin, rotation),
                name=self.names[i],
                restitution=kind.model.restitution,
                friction=kind.model.friction,
            )
            for i in np.flatnonzero(~self.is_dynamic).tolist()
            for kind in [self.kind_of(i)]
            for shape, origin, rotation in kind.shapes
        ]

    def excluded_pairs(self, pairs: IntArray, static_count: int) -> IntArray:
        """Return pairs that do not collide, as kernel indices ``(Q, 2)``.

        ``pairs`` are indices of all bodies ``(P, 2)``; ``static_count`` is the index
        of the first of `colliders` among all colliders.
        """
        shape_counts = np.array([len(kind.shapes) for kind in self.kinds], np.int64)
        collider_counts = np.where(self.is_dynamic, 0, shape_counts[self.kind_of_body])
        first_index = len(self.dynamic_indices) + static_count
        first_shapes = first_index + np.cumsum(collider_counts) - collider_counts
        dynamic_indices = np.cumsum(self.is_dynamic) - 1
        kernel_pairs: list[tuple[int, int]] = []
        for first_body, second_body in pairs.tolist():
            a, b = first_body, second_body
            if not self.is_dynamic[a]:
                a, b = b, a
            if self.is_dynamic[b]:
                kernel_pairs.append((int(dynamic_indices[a]), int(dynamic_indices[b])))
            elif self.is_dynamic[a]:
                shapes = range(
                    int(first_shapes[b]), int(first_shapes[b] + collider_counts[b])
                )
                kernel_pairs += [(int(dynamic_indices[a]), shape) for shape in shapes]
        return np.array(kernel_pairs, np.int64).reshape(-1, 2)

    @cached_property
    def collision_shapes(self) -> CollisionShapes:
        """Collision shapes of all bodies; mesh shapes are convex hulls."""
        shapes = [
            (Collider(collider_shape(shape), name=self.names[i]), i, origin, rotation)
            for i in range(len(self.names))
            for shape, origin, rotation in self.kind_of(i).shapes
        ]
        colliders, body_indices, origins, rotations = zip(*shapes, strict=True)
        arrays = np.array(body_indices), np.array(origins), np.array(rotations)
        return CollisionShapes(colliders, *arrays)

    @cached_property
    def cores_and_bodies(self) -> tuple[list[ConvexCore], IntArray]:
        """Convex cores of dynamic bodies, and the body of each core ``(S,)``."""
        cores: list[ConvexCore] = []
        body_indices: list[int] = []
        cores_by_kind = [
            [k.core_at_centre(core) for core in k.cores] for k in self.kinds
        ]
        for dynamic_index, i in enumerate(self.dynamic_indices.tolist()):
            cores += cores_by_kind[self.kind_of_body[i]]
            body_indices += [dynamic_index] * len(cores_by_kind[self.kind_of_body[i]])
        return cores, np.array(body_indices, np.int64)

    def build_kernel(
        self,
        joints: IntArray,
        parameters: FloatArray,
        excluded_pairs: IntArray,
        mass_factors: FloatArray | float,
    ) -> Any:
        """Return bodies and joints as a kernel object.

        Joints are ``(K, 3)``, their parameters ``(K, 27)``, pairs from `excluded_pairs`
        ``(Q, 2)``, and factors on the masses ``(N,)``.
        """
        masses = (self.masses * mass_factors)[:, None]
        masses = np.concatenate([masses, self.moments], axis=1)
        arrays: list[Any] = [
            masses,
            *self._shape_arrays,
            joints,
            parameters,
            excluded_pairs,
        ]
        return _kernels.RigidBodies(*arrays)

    @cached_property
    def _shape_arrays(self) -> tuple[Any, ...]:
        """Shapes of dynamic bodies, in the layout of the kernel."""
        cores, owners = self.cores_and_bodies
        faces = [face for core in cores for face in core.faces]
        models = [self.kind_of(self.dynamic_indices[i]).model for i in owners]
        materials = [
            (core.radius, m.restitution, m.friction)
            for core, m in zip(cores, models, strict=True)
        ]
        empty = np.zeros((0, 3))
        return (
            owners,
            np.array(materials, np.float64).reshape(-1, 3),
            np.concatenate([empty, *(core.points for core in cores)]),
            _first_indices([len(core.points) for core in cores]),
            _first_indices([len(core.faces) for core in cores]),
            _first_indices([len(face) for face in faces]),
            np.concatenate([np.zeros(0, np.int64), *faces]).astype(np.int64),
        )

    @cached_property
    def _indices_by_name(self) -> Mapping[str, int]:
        return {name: i for i, name in enumerate(self.names)}

    def body_index(self, name: str, key: str) -> int:
        """Return the index of a body by name; raise SIM061 if it is unknown."""
        if name not in self._indices_by_name:
            refuse_unknown(name, list(self.names), key)
        return self._indices_by_name[name]


def refuse_unknown(name: str, known_names: Sequence[str], key: str) -> NoReturn:
    """Raise SIM061 for an unknown body name."""
    copy_numbers = [
        int(number[:-1])
        for other_name, _, number in (known.rpartition("[") for known in known_names)
        if other_name == name and number[:-1].isdigit()
    ]
    hint = name_hint(name, known_names) or ""
    if copy_numbers:
        hint = f"{name!r} has {counted(len(copy_numbers), 'copy', 'copies')}: write "
        hint += f"'{name}[0]'"
        hint += f" to '{name}[{max(copy_numbers)}]'" if len(copy_numbers) > 1 else ""
    refuse("SIM061", f"unknown body {name!r}", key, hint)


def collider_shape(shape: Shape) -> Shape:
    """Return a shape as a collider; for a mesh, its convex hull."""
    if not isinstance(shape, Mesh):
        return shape
    points, counts, corners = core_mesh(core_of(shape))
    return Mesh(points, triangulate(counts, corners), closed=True)


def offset_poses(poses: Poses, offset: FloatArray, rotation: FloatArray) -> Poses:
    """Return poses over time, with a fixed offset in the local frame."""
    if not offset.any() and rotation[3] == 1:
        return poses
    pose_rows = poses.rows
    return Poses(
        poses.sample_times,
        pose_rows[:, :3] + so3.rotate(pose_rows[:, 3:], offset),
        so3.multiply(pose_rows[:, 3:], rotation),
    )


def _first_indices(counts: Sequence[int]) -> IntArray:
    """Return the start index of each group from the group sizes, and the total."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


@contextmanager
def _entry_faults(location: str, origin: str | None) -> Iterator[None]:
    """Locate the faults that are raised inside the context at an entry."""
    try:
        yield
    except OptionError as error:
        faults = [locate_fault(fault, location, origin) for fault in error.faults]
        raise OptionError(faults) from error


def locate_fault(fault: Fault, location: str, origin: str | None) -> Fault:
    """Return a fault located at an entry, or at the prim that the entry names."""
    if origin is not None:
        return replace(fault, where=location, message=f"{origin}: " + fault.message)
    return replace(
        fault, where=f"{location}.{fault.where}" if fault.where else location
    )
