"""Bodies of a spec: copies, masses, where they begin, and what the kernel takes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from animtool import _kernels
from animtool._types import BoolArray, FloatArray, IntArray
from animtool.errors import Fault, OptionError, Severity, refuse
from animtool.frames import MeshFrame
from animtool.maths import so3
from animtool.maths.faces import triangulated
from animtool.sim.colliders import Collider, Mesh, Poses, Shape
from animtool.systems.rigid.cores import (
    Core,
    Solid,
    convex,
    core_of,
    shown,
    solid_of,
    together,
)
from animtool.systems.rigid.spec import BodyModel

# What moments of inertia may break the triangle inequality by, of their sum: rounding.
ROUNDING = 1e-9
# What is beside the diagonal and less than this share of the sum is rounding.
ALIKE = 1e-12
NO_PAIRS = np.zeros((0, 2), np.int64)
# Bodies of a system; more take gigabytes.
MOST = 1_000_000


@dataclass(frozen=True, slots=True)
class Outlines:
    """C shapes of all bodies, as others run into them."""

    colliders: Sequence[Collider]
    of: IntArray  # the body of each (C,)
    at: FloatArray  # origins in the frames of the bodies (C, 3) [m]
    turns: FloatArray  # quaternions there (C, 4)


@dataclass(frozen=True)
class Kind:
    """What copies of one body have in common, in the frame of the body."""

    model: BodyModel
    shapes: Sequence[tuple[Shape, FloatArray, FloatArray]]  # with origin and quaternion
    cores: Sequence[Core]
    mass: float  # [kg]
    centre: FloatArray  # of mass (3,) [m]
    moments: FloatArray  # about its principal axes (3,) [kg m²]
    axes: FloatArray  # body_from_principal, a quaternion (4,)
    meshes: tuple[MeshFrame, ...]
    notices: Sequence[Fault] = ()

    @cached_property
    def reach(self) -> float:
        """How far it reaches from its centre of mass [m]."""
        return max(
            float(np.linalg.norm(core.points - self.centre, axis=1).max()) + core.radius
            for core in self.cores
        )

    def core_at_centre(self, core: Core) -> Core:
        """Return a core in the frame of its principal axes."""
        back = so3.conjugate(self.axes)
        return core.placed(-so3.rotate(back, self.centre), back)


def kind_of(model: BodyModel, parts: Mapping[str, Any]) -> Kind:
    """Return what a model says, its own faults raised (SIM061)."""
    for key in ("velocity", "spin") if model.kinematic else ():
        if key in model.model_fields_set:
            message = f"{model.name!r} is kinematic: its moves say how fast it is"
            refuse("SIM061", message, key, f"no {key}")
    if model.mass is not None and "density" in model.model_fields_set:
        message = f"{model.name!r} has a mass and a density"
        refuse("SIM061", message, "density", "keep one")
    several = zip(model.shapes, parts.get("shapes", ()), strict=True)
    shapes = [
        (
            part["shape"],
            np.array(own.at, np.float64),
            _turn(own.rotate, model.name, f"shapes[{k}].rotate"),
        )
        for k, (own, part) in enumerate(several)
    ]
    if model.shape is not None:
        if shapes:
            message = f"{model.name!r} has a shape and shapes"
            refuse("SIM061", message, "shapes", "keep one")
        shapes = [(parts["shape"], np.zeros(3), so3.IDENTITY)]
    if not shapes:
        message = f"{model.name!r} has no shape"
        refuse("SIM061", message, hint="shape: {sphere: {radius: 0.1}}")
    cores, solids, notices = [], [], []
    for k, (shape, at, turn) in enumerate(shapes):
        key = "shape" if model.shape is not None else f"shapes[{k}]"
        if "height_field" in (model.shape or model.shapes[k].shape):
            message = f"a shape of {model.name!r}: a height field has no inside"
            refuse("SIM061", message, key, "it is a collider, not a body")
        try:
            core = core_of(shape)
        except ValueError as error:
            refuse("SIM061", f"a shape of {model.name!r}: {error}", key)
        solid = solid_of(shape, core)
        if isinstance(shape, Mesh) and not convex(shape, solid):
            message = (
                f"a mesh of {model.name!r} is not convex, or open: its hull is met"
            )
            hint = "make it of several convex shapes"
            fault = Fault("SIM125", message, hint=hint, severity=Severity.WARNING)
            notices.append(replace(fault, where=key))
        cores.append(core.placed(at, turn))
        solids.append(solid.placed(at, turn))
    mass, centre, inertia = _weighed(model, solids)
    moments, axes = principal(inertia)
    shows = parts.get("shows")
    meshes = tuple(shows()) if shows is not None else (_mesh(cores),)
    return Kind(model, shapes, cores, mass, centre, moments, axes, meshes[:1], notices)


def _weighed(
    model: BodyModel, solids: Sequence[Solid]
) -> tuple[float, FloatArray, FloatArray]:
    """Return mass [kg], centre [m] and inertia about it ``(3, 3)`` [kg m²]."""
    own = [each.density or model.density for each in model.shapes] or [model.density]
    whole = together(solids, own)
    mass = whole.volume if model.mass is None else model.mass
    inertia = whole.inertia * (mass / whole.volume)
    centre = whole.centre
    if model.centre is not None:
        centre = np.array(model.centre, np.float64)
        off = whole.centre - centre
        inertia = inertia + mass * (off @ off * np.eye(3) - np.outer(off, off))
    if model.inertia is not None:
        moments = np.array(model.inertia, np.float64)
        if 2 * moments.max() > moments.sum() * (1 + ROUNDING):
            message = f"no body has the moments of {model.name!r}, {model.inertia}: "
            message = f"{message}one is more than the sum of the others"
            refuse("SIM061", message, "inertia")
        if np.count_nonzero(moments) < 2:
            message = f"{model.name!r} must have two moments of inertia above 0"
            refuse("SIM061", message, "inertia", "a rod has one of 0")
        turn = so3.to_matrix(_turn(model.inertia_axes, model.name, "inertia_axes"))
        inertia = turn @ np.diag(moments) @ turn.T
    return mass, centre, inertia


def principal(inertia: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return moments ``(3,)`` and axes of inertia, a quaternion ``(4,)``.

    Axes that are those of the frame but for rounding stay so.
    """
    size = float(np.trace(inertia))
    if np.abs(inertia - np.diag(np.diag(inertia))).max() <= ALIKE * size:
        return np.diag(inertia).copy(), so3.IDENTITY.copy()
    moments, axes = np.linalg.eigh(inertia)
    # The axis nearest to x comes first and so on, so that small changes change little.
    order = [int(np.argmax(np.abs(axes[0])))]
    rest = [k for k in range(3) if k not in order]
    order += sorted(rest, key=lambda k: -abs(float(axes[1, k])))
    axes = axes[:, order] * np.sign(np.diag(axes[:, order]) + 1e-300)
    if np.linalg.det(axes) < 0:
        axes[:, 2] = -axes[:, 2]
    return moments[order], so3.from_matrix(axes)


def _mesh(cores: Sequence[Core]) -> MeshFrame:
    points, counts, corners, base = [], [], [], 0
    for core in cores:
        own, count, corner = shown(core)
        points.append(own)
        counts.append(count)
        corners.append(corner + base)
        base += len(own)
    places = np.concatenate(points)
    return MeshFrame(
        places,
        np.zeros_like(places),
        np.concatenate(counts),
        np.concatenate(corners),
        closed=True,
    )


def _check_moved(model: BodyModel) -> None:
    """Refuse what does not go with how a body is moved."""
    for key in ("moves", "turns", "prim"):
        if getattr(model, key) and not model.kinematic:
            message = f"{model.name!r} is moved by what happens to it, not by {key}"
            refuse("SIM061", message, key, "kinematic: true")
    if model.pushes and model.kinematic:
        refuse("SIM061", f"{model.name!r} is kinematic: nothing pushes it", "pushes")
    for k, push in enumerate(model.pushes):
        start, end = push.start, push.end
        if start is not None and end is not None and end <= start:
            message = f"a push of {model.name!r} begins at {start:g} s, and ends at "
            refuse("SIM061", f"{message}{end:g} s", f"pushes[{k}].end")


def copies(model: BodyModel, parts: Mapping[str, Any]) -> tuple[FloatArray, FloatArray]:
    """Return where copies of a body are in its frame: ``(C, 3)`` and ``(C, 4)``."""
    points, rotations = parts.get("points"), parts.get("rotations")
    if model.grid is not None:
        if points is not None:
            message = f"{model.name!r} has a grid and points"
            refuse("SIM061", message, "points", "keep one")
        counts = np.array(model.grid.count)
        if counts.prod() > MOST:
            refuse("SIM061", f"{model.name!r} has more than {MOST} copies", "grid")
        x, y, z = np.meshgrid(*(np.arange(n) for n in counts), indexing="ij")
        cells = np.stack([x, y, z], axis=-1).transpose(1, 2, 0, 3).reshape(-1, 3) * 1.0
        cells[:, 0] += model.grid.stagger * (cells[:, 1] % 2)
        points = cells * np.array(model.grid.spacing)
    if points is None:
        if rotations is not None:
            refuse("SIM061", "rotations are of points, and there are none", "rotations")
        return np.zeros((1, 3)), so3.IDENTITY[None]
    count = len(points)
    turns = np.tile(so3.IDENTITY, (count, 1))
    if rotations is not None:
        turns = np.asarray(rotations, np.float64)
        if turns.shape == (count, 4):
            turns = turns[:, [1, 2, 3, 0]]
    for name, array, width in (("points", points, 3), ("rotations", turns, 4)):
        if array.shape != (count, width) or not np.isfinite(array).all():
            message = f"{name} of {model.name!r} are of shape {array.shape} or not "
            refuse("SIM061", f"{message}finite: they must be {(count, width)}", name)
    if not turns.any(axis=1).all():
        refuse("SIM061", f"a rotation of {model.name!r} is all 0", "rotations")
    return np.asarray(points, np.float64), so3.normalize(turns)


@dataclass(frozen=True)
class Bodies:
    """All bodies of a system; N of them are moved, others go as they are told.

    Attributes:
        kinds: Of each entry of the file.
        names: Of all.
        of: The kind of each ``(B,)``.
        moved: Whether each is moved ``(B,)``.
        poses: Of each, over time; of those that are moved only where they begin.
    """

    kinds: Sequence[Kind]
    names: Sequence[str]
    of: IntArray
    moved: BoolArray
    poses: Sequence[Poses]
    begin: float
    dynamic: IntArray = field(init=False)  # which are moved (N,)

    def __post_init__(self) -> None:
        """Number those that are moved."""
        object.__setattr__(self, "dynamic", np.flatnonzero(self.moved))

    @staticmethod
    def of_models(
        models: Sequence[BodyModel], parts: Sequence[Mapping[str, Any]], begin: float
    ) -> Bodies:
        """Return the bodies of a spec."""
        kinds: list[Kind] = []
        names, of, moved, poses = [], [], [], []
        for number, (model, part) in enumerate(zip(models, parts, strict=True)):
            place = f"bodies[{number}]"
            with _entry(place):
                if model.name in {kind.model.name for kind in kinds}:
                    refuse("SIM061", f"two bodies are named {model.name!r}", "name")
                _check_moved(model)
                kind = kind_of(model, part)
                points, turns = copies(model, part)
            notices = [replace(n, where=f"{place}.{n.where}") for n in kind.notices]
            kinds.append(replace(kind, notices=notices))
            own: Poses = part["poses"]
            for k, (point, turn) in enumerate(zip(points, turns, strict=True)):
                several = len(points) > 1 or model.grid is not None
                names.append(f"{model.name}[{k}]" if several else model.name)
                of.append(number)
                moved.append(not model.kinematic)
                poses.append(placed_on(own, point, turn))
        if len(names) > MOST:
            message = f"there are {len(names)} bodies, and {MOST} at most"
            refuse("SIM061", message, "bodies")
        return Bodies(
            kinds, names, np.array(of), np.array(moved, np.bool_), poses, begin
        )

    @cached_property
    def still(self) -> frozenset[int]:
        """Those that go as they are told, which is nowhere."""
        told = np.flatnonzero(~self.moved).tolist()
        return frozenset(i for i in told if len(self.poses[i].moments) == 1)

    @cached_property
    def masses(self) -> FloatArray:
        """Masses of those that are moved ``(N,)`` [kg]."""
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
        """Their centres of mass, in their frames ``(N, 3)`` [m]."""
        return np.array([kind.centre for kind in self.kinds])[self.of[self.dynamic]]

    @cached_property
    def reaches(self) -> FloatArray:
        """How far they reach ``(N,)`` [m]."""
        return np.array([kind.reach for kind in self.kinds])[self.of[self.dynamic]]

    @cached_property
    def start(self) -> FloatArray:
        """Where they begin, as the kernel has states ``(N, 14)``."""
        rows = np.array([self.poses[i].at(self.begin) for i in self.dynamic])
        rows = rows.reshape(-1, 7)
        models = [self.kinds[k].model for k in self.of[self.dynamic]]
        velocities = np.array([m.velocity for m in models], np.float64).reshape(-1, 3)
        spins = np.radians([m.spin for m in models]).reshape(-1, 3)
        at = rows[:, :3] + so3.rotate(rows[:, 3:], self.centres)
        turns = so3.multiply(rows[:, 3:], self.axes)
        own = so3.rotate(so3.conjugate(turns), spins)
        momenta = so3.rotate(turns, own * self.moments)
        idle = np.zeros((len(rows), 1))
        return np.concatenate([at, turns, velocities, momenta, idle], axis=1)

    def spins(self, state: FloatArray) -> FloatArray:
        """Return angular velocities of the world ``(N, 3)`` [rad/s]."""
        own = so3.rotate(so3.conjugate(state[:, 3:7]), state[:, 10:13])
        moments = self.moments
        own = np.divide(own, moments, out=np.zeros_like(own), where=moments > 0)
        return so3.rotate(state[:, 3:7], own)

    def placed(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return origins ``(N, 3)`` [m] and quaternions ``(N, 4)`` of their frames."""
        turns = so3.multiply(state[:, 3:7], so3.conjugate(self.axes))
        return state[:, :3] - so3.rotate(turns, self.centres), turns

    def colliders(self) -> list[Collider]:
        """Return those that go as they are told, as others run into them."""
        return [
            Collider(
                shape,
                placed_on(self.poses[i], at, turn),
                name=self.names[i],
                restitution=kind.model.restitution,
                friction=kind.model.friction,
            )
            for i in np.flatnonzero(~self.moved).tolist()
            for kind in [self.kinds[self.of[i]]]
            for shape, at, turn in kind.shapes
        ]

    @cached_property
    def outlines(self) -> Outlines:
        """All as others run into them; of meshes their hulls."""
        rows = [
            (Collider(outline(shape), name=self.names[i]), i, at, turn)
            for i, k in enumerate(self.of.tolist())
            for shape, at, turn in self.kinds[k].shapes
        ]
        colliders, of, at, turns = zip(*rows, strict=True)
        return Outlines(colliders, np.array(of), np.array(at), np.array(turns))

    @cached_property
    def shapes(self) -> tuple[list[Core], IntArray]:
        """Cores of those that are moved, and the body of each ``(S,)``."""
        cores: list[Core] = []
        owners: list[int] = []
        own = [[k.core_at_centre(core) for core in k.cores] for k in self.kinds]
        for number, i in enumerate(self.dynamic.tolist()):
            cores += own[self.of[i]]
            owners += [number] * len(own[self.of[i]])
        return cores, np.array(owners, np.int64)

    def kernel(
        self, joints: IntArray, numbers: FloatArray, apart: IntArray = NO_PAIRS
    ) -> Any:
        """Return them as the kernel takes them.

        With joints ``(K, 3)`` and ``(K, 26)``, and pairs that do not meet ``(P, 2)``.
        """
        cores, owners = self.shapes
        faces = [face for core in cores for face in core.faces]
        models = [self.kinds[self.of[self.dynamic[i]]].model for i in owners]
        rows = [
            (core.radius, m.restitution, m.friction)
            for core, m in zip(cores, models, strict=True)
        ]
        empty = np.zeros((0, 3))
        return _kernels.RigidBodies(
            np.concatenate([self.masses[:, None], self.moments], axis=1),
            owners,
            np.array(rows, np.float64).reshape(-1, 3),
            np.concatenate([empty, *(core.points for core in cores)]),
            _starts([len(core.points) for core in cores]),
            _starts([len(core.faces) for core in cores]),
            _starts([len(face) for face in faces]),
            np.concatenate([np.zeros(0, np.int64), *faces]).astype(np.int64),
            joints,
            numbers,
            apart,
        )

    @cached_property
    def _numbers(self) -> Mapping[str, int]:
        return {name: i for i, name in enumerate(self.names)}

    def find(self, name: str, key: str) -> int:
        """Return the number of a body of a name (SIM061)."""
        if name not in self._numbers:
            from animtool.documents.names import nearest

            hint = nearest(name, list(self.names)) or ""
            refuse("SIM061", f"no body is named {name!r}", key, hint)
        return self._numbers[name]


def outline(shape: Shape) -> Shape:
    """Return a shape as others run into it: of a mesh, its hull."""
    if not isinstance(shape, Mesh):
        return shape
    points, counts, corners = shown(core_of(shape))
    return Mesh(points, triangulated(counts, corners))


def placed_on(poses: Poses, at: FloatArray, turn: FloatArray) -> Poses:
    """Return the poses of what is somewhere in a frame that moves."""
    if not at.any() and turn[3] == 1:
        return poses
    rows = poses.rows
    return Poses(
        poses.moments,
        rows[:, :3] + so3.rotate(rows[:, 3:], at),
        so3.multiply(rows[:, 3:], turn),
    )


def _starts(counts: Sequence[int]) -> IntArray:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _turn(wxyz: Sequence[float], name: str, key: str) -> FloatArray:
    turn = np.array(wxyz, np.float64)[[1, 2, 3, 0]]
    if not turn.any():
        refuse("SIM061", f"a rotation of {name!r} is all 0", key)
    return so3.normalize(turn)


@contextmanager
def _entry(place: str) -> Iterator[None]:
    """Give refusals of an entry its place, in front of the key that they name."""
    try:
        yield
    except OptionError as error:
        faults = [
            replace(fault, where=f"{place}.{fault.where}" if fault.where else place)
            for fault in error.faults
        ]
        raise OptionError(faults) from error
