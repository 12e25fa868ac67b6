"""Bodies of a spec: initial poses, and the kernel's arrays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import field, replace
from functools import cached_property
from typing import Any, NoReturn

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, OptionError, Refusals, refuse
from animtool.core.names import nearest
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.faces import triangulated
from animtool.sim.colliders import Collider, Mesh, Poses, Shape
from animtool.systems.rigid.cores import ConvexCore, core_mesh, core_of
from animtool.systems.rigid.kind import (
    MAX_BODIES,
    BodyKind,
    build_kind,
    check_motion_keys,
    copy_placements,
)
from animtool.systems.rigid.spec import BodyModel

NO_PAIRS = np.zeros((0, 2), np.int64)


@dataclass(frozen=True, slots=True)
class CollisionShapes:
    """C collision shapes of all bodies, for other systems."""

    colliders: Sequence[Collider]
    of: IntArray  # body of each shape (C,)
    at: FloatArray  # origins in the frames of the bodies (C, 3) [m]
    rotations: FloatArray  # their quaternions (C, 4)


@dataclass(frozen=True)
class RigidBodies:
    """All bodies of a system: N dynamic, the others kinematic.

    Attributes:
        kinds: Body kind of each entry of the file.
        names: Names of all bodies.
        of: Kind index of each ``(B,)``.
        is_dynamic: Whether each is dynamic ``(B,)``.
        poses: Poses of each over time; of dynamic ones the initial pose.
    """

    kinds: Sequence[BodyKind]
    names: Sequence[str]
    of: IntArray
    is_dynamic: BoolArray
    poses: Sequence[Poses]
    begin: float
    dynamic: IntArray = field(init=False)  # numbers of dynamic bodies (N,)

    def __post_init__(self) -> None:
        """Number the dynamic bodies."""
        object.__setattr__(self, "dynamic", np.flatnonzero(self.is_dynamic))

    @staticmethod
    def of_models(
        models: Sequence[BodyModel], parts: Sequence[Mapping[str, Any]], begin: float
    ) -> RigidBodies:
        """Return the bodies of a spec."""
        kinds: list[BodyKind] = []
        names, of, is_dynamic, poses = [], [], [], []
        used_names: set[str] = set()
        refusals = Refusals()
        for number, (model, part) in enumerate(zip(models, parts, strict=True)):
            where, origin = part.get("entry", f"bodies[{number}]"), part.get("origin")
            with refusals.collect(), _entry_faults(where, origin):
                if model.name in used_names:
                    refuse("SIM061", f"two bodies are named {model.name!r}", "name")
            with refusals.collect(), _entry_faults(where, origin):
                check_motion_keys(model)
            with refusals.collect(), _entry_faults(where, origin):
                kind = build_kind(model, part)
                points, rotations = copy_placements(model, part)
            used_names.add(model.name)
            if refusals.faults:
                continue
            notices = [_locate_fault(notice, where, origin) for notice in kind.notices]
            kinds.append(replace(kind, notices=notices))
            carrier: Poses = part["poses"]
            for k, (point, rotation) in enumerate(zip(points, rotations, strict=True)):
                is_numbered = len(points) > 1 or model.grid is not None
                names.append(f"{model.name}[{k}]" if is_numbered else model.name)
                of.append(number)
                is_dynamic.append(not model.kinematic or model.release is not None)
                poses.append(offset_poses(carrier, point, rotation))
        refusals.check()
        if len(names) > MAX_BODIES:
            message = f"there are {len(names)} bodies; the limit is {MAX_BODIES}"
            refuse("SIM061", message, "bodies")
        return RigidBodies(
            kinds, names, np.array(of), np.array(is_dynamic, np.bool_), poses, begin
        )

    @cached_property
    def releases(self) -> FloatArray:
        """Release times of bodies that start kinematic ``(B,)`` [s]."""
        times = [kind.model.release for kind in self.kinds]
        per_model = [-np.inf if time is None else time for time in times]
        return np.array(per_model, np.float64)[self.of]

    @cached_property
    def static(self) -> frozenset[int]:
        """Kinematic bodies that never move."""
        kinematic = np.flatnonzero(~self.is_dynamic).tolist()
        return frozenset(i for i in kinematic if len(self.poses[i].sample_times) == 1)

    @cached_property
    def masses(self) -> FloatArray:
        """Masses of dynamic bodies ``(N,)`` [kg]."""
        return np.array([kind.mass for kind in self.kinds])[self.of[self.dynamic]]

    @cached_property
    def moments(self) -> FloatArray:
        """Their principal moments of inertia ``(N, 3)`` [kg m²]."""
        return np.array([kind.moments for kind in self.kinds])[self.of[self.dynamic]]

    @cached_property
    def axes(self) -> FloatArray:
        """Their principal axes: body_from_principal ``(N, 4)``."""
        return np.array([kind.axes for kind in self.kinds])[self.of[self.dynamic]]

    @cached_property
    def centres(self) -> FloatArray:
        """Their centres of mass, in body frames ``(N, 3)`` [m]."""
        return np.array([kind.centre for kind in self.kinds])[self.of[self.dynamic]]

    @cached_property
    def reaches(self) -> FloatArray:
        """Their bounding radii about the centre of mass ``(N,)`` [m]."""
        return np.array([kind.reach for kind in self.kinds])[self.of[self.dynamic]]

    @cached_property
    def start(self) -> FloatArray:
        """Their initial states, in the kernel's layout ``(N, 14)``."""
        rows = np.array([self.poses[i].at(self.begin) for i in self.dynamic])
        rows = rows.reshape(-1, 7)
        models = [self.kinds[k].model for k in self.of[self.dynamic]]
        velocities = np.array([m.velocity for m in models], np.float64).reshape(-1, 3)
        spins = np.radians([m.spin for m in models]).reshape(-1, 3)
        centres = rows[:, :3] + so3.rotate(rows[:, 3:], self.centres)
        rotations = so3.multiply(rows[:, 3:], self.axes)
        spins_local = so3.rotate(so3.conjugate(rotations), spins)
        momenta = so3.rotate(rotations, spins_local * self.moments)
        rest_times = np.zeros((len(rows), 1))
        return np.concatenate(
            [centres, rotations, velocities, momenta, rest_times], axis=1
        )

    def kinematic_state(self, number: int, t: float, dt: float) -> FloatArray:
        """Return the state ``(14,)`` of a dynamic body from its poses.

        Its velocities are those of the time [s] before.
        """
        i = int(self.dynamic[number])
        before, row = self.poses[i].at(t - dt), self.poses[i].at(t)
        centres = [
            p[:3] + so3.rotate(p[3:], self.centres[number]) for p in (before, row)
        ]
        spin = so3.log(so3.multiply(row[3:], so3.conjugate(before[3:]))) / dt
        rotation = so3.multiply(row[3:], self.axes[number])
        momentum_local = (
            so3.rotate(so3.conjugate(rotation), spin) * self.moments[number]
        )
        velocity = (centres[1] - centres[0]) / dt
        momentum = so3.rotate(rotation, momentum_local)
        return np.concatenate([centres[1], rotation, velocity, momentum, [0.0]])

    def spins(self, state: FloatArray) -> FloatArray:
        """Return angular velocities in the world ``(N, 3)`` [rad/s]."""
        local = so3.rotate(so3.conjugate(state[:, 3:7]), state[:, 10:13])
        moments = self.moments
        local = np.divide(local, moments, out=np.zeros_like(local), where=moments > 0)
        return so3.rotate(state[:, 3:7], local)

    def body_frames(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return origins ``(N, 3)`` [m] and quaternions ``(N, 4)`` of body frames."""
        rotations = so3.multiply(state[:, 3:7], so3.conjugate(self.axes))
        return state[:, :3] - so3.rotate(rotations, self.centres), rotations

    def colliders(self) -> list[Collider]:
        """Return kinematic bodies as colliders."""
        return [
            Collider(
                shape,
                offset_poses(self.poses[i], at, rotation),
                name=self.names[i],
                restitution=kind.model.restitution,
                friction=kind.model.friction,
            )
            for i in np.flatnonzero(~self.is_dynamic).tolist()
            for kind in [self.kinds[self.of[i]]]
            for shape, at, rotation in kind.shapes
        ]

    def excluded_pairs(self, pairs: IntArray, first_collider: int) -> IntArray:
        """Return pairs that do not collide, as kernel numbers ``(Q, 2)``.

        Args:
            pairs: Of all bodies ``(P, 2)``.
            first_collider: Number of the first of `colliders` among all.
        """
        shapes_of = np.array([len(kind.shapes) for kind in self.kinds], np.int64)
        counts = np.where(self.is_dynamic, 0, shapes_of[self.of])
        first_shapes = len(self.dynamic) + first_collider + np.cumsum(counts) - counts
        dynamic_indices = np.cumsum(self.is_dynamic) - 1
        rows: list[tuple[int, int]] = []
        for first_body, second_body in pairs.tolist():
            a, b = (
                (first_body, second_body)
                if self.is_dynamic[first_body]
                else (second_body, first_body)
            )
            if self.is_dynamic[b]:
                rows.append((int(dynamic_indices[a]), int(dynamic_indices[b])))
            elif self.is_dynamic[a]:
                shapes = range(int(first_shapes[b]), int(first_shapes[b] + counts[b]))
                rows += [(int(dynamic_indices[a]), shape) for shape in shapes]
        return np.array(rows, np.int64).reshape(-1, 2)

    @cached_property
    def outlines(self) -> CollisionShapes:
        """All bodies as colliders; hulls of meshes."""
        rows = [
            (Collider(collider_shape(shape), name=self.names[i]), i, at, rotation)
            for i, k in enumerate(self.of.tolist())
            for shape, at, rotation in self.kinds[k].shapes
        ]
        colliders, of, at, rotations = zip(*rows, strict=True)
        return CollisionShapes(
            colliders, np.array(of), np.array(at), np.array(rotations)
        )

    @cached_property
    def shapes(self) -> tuple[list[ConvexCore], IntArray]:
        """Convex cores of dynamic bodies, and the body of each ``(S,)``."""
        cores: list[ConvexCore] = []
        owners: list[int] = []
        cores_by_kind = [
            [k.core_at_centre(core) for core in k.cores] for k in self.kinds
        ]
        for number, i in enumerate(self.dynamic.tolist()):
            cores += cores_by_kind[self.of[i]]
            owners += [number] * len(cores_by_kind[self.of[i]])
        return cores, np.array(owners, np.int64)

    def kernel(
        self,
        joints: IntArray,
        numbers: FloatArray,
        excluded: IntArray = NO_PAIRS,
        inertias: FloatArray | float = 1.0,
    ) -> Any:
        """Return the kernel's arrays.

        With joints ``(K, 3)`` and ``(K, 27)``, pairs of `apart` ``(Q, 2)``, and factors
        on their masses ``(N,)``.
        """
        masses = (self.masses * inertias)[:, None]
        weights = np.concatenate([masses, self.moments], axis=1)
        arrays: list[Any] = [weights, *self._shape_arrays, joints, numbers, excluded]
        return _kernels.RigidBodies(*arrays)

    @cached_property
    def _shape_arrays(self) -> tuple[Any, ...]:
        cores, owners = self.shapes
        faces = [face for core in cores for face in core.faces]
        models = [self.kinds[self.of[self.dynamic[i]]].model for i in owners]
        rows = [
            (core.radius, m.restitution, m.friction)
            for core, m in zip(cores, models, strict=True)
        ]
        empty = np.zeros((0, 3))
        return (
            owners,
            np.array(rows, np.float64).reshape(-1, 3),
            np.concatenate([empty, *(core.points for core in cores)]),
            _first_indices([len(core.points) for core in cores]),
            _first_indices([len(core.faces) for core in cores]),
            _first_indices([len(face) for face in faces]),
            np.concatenate([np.zeros(0, np.int64), *faces]).astype(np.int64),
        )

    @cached_property
    def _indices_by_name(self) -> Mapping[str, int]:
        return {name: i for i, name in enumerate(self.names)}

    def find(self, name: str, key: str) -> int:
        """Return the number of a body by name (SIM061)."""
        if name not in self._indices_by_name:
            refuse_unknown(name, list(self.names), key)
        return self._indices_by_name[name]


def refuse_unknown(name: str, names: Sequence[str], key: str) -> NoReturn:
    """Refuse an unknown body name (SIM061)."""
    hint = nearest(name, names) or ""
    refuse("SIM061", f"unknown body {name!r}", key, hint)


def collider_shape(shape: Shape) -> Shape:
    """Return a shape as a collider: the hull of a mesh."""
    if not isinstance(shape, Mesh):
        return shape
    points, counts, corners = core_mesh(core_of(shape))
    return Mesh(points, triangulated(counts, corners), closed=True)


def offset_poses(poses: Poses, at: FloatArray, rotation: FloatArray) -> Poses:
    """Return the poses of a fixed offset in a moving frame."""
    if not at.any() and rotation[3] == 1:
        return poses
    rows = poses.rows
    return Poses(
        poses.sample_times,
        rows[:, :3] + so3.rotate(rows[:, 3:], at),
        so3.multiply(rows[:, 3:], rotation),
    )


def _first_indices(counts: Sequence[int]) -> IntArray:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


@contextmanager
def _entry_faults(where: str, origin: str | None) -> Iterator[None]:
    """Prefix faults raised inside with an entry's location."""
    try:
        yield
    except OptionError as error:
        faults = [_locate_fault(fault, where, origin) for fault in error.faults]
        raise OptionError(faults) from error


def _locate_fault(fault: Fault, where: str, origin: str | None) -> Fault:
    """Return a fault located at an entry, or at the prim the entry names."""
    if origin is not None:
        return replace(fault, where=where, message=f"{origin}: " + fault.message)
    return replace(fault, where=f"{where}.{fault.where}" if fault.where else where)
