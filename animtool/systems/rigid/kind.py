"""Shared properties of a body's copies: shapes, mass, inertia."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import (
    Fault,
    Problem,
    RefusalCollector,
    Severity,
    counted,
    refuse,
    refuse_all,
    warning,
)
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.frames import MeshFrame
from animtool.sim.colliders import Mesh, Shape
from animtool.systems.rigid.cores import (
    INSTALL_COMMAND,
    ConvexCore,
    SolidProperties,
    can_decompose,
    combine_solids,
    convex_pieces,
    core_mesh,
    core_of,
    core_solid,
    excess_volume,
    is_convex,
    mesh_solid,
    point_inertia,
)
from animtool.systems.rigid.spec import BodyModel

# Rounding tolerance of the triangle inequality of moments, relative to their sum.
MASS_ROUNDING = 1e-9
# Smaller masses overflow impulses.
MIN_MASS = 1e-30  # [kg]
MIN_MOMENT = 1e-100  # [kg m²]
# Off-diagonal elements of an inertia below this fraction of its trace are rounding.
DIAGONAL_TOLERANCE = 1e-12
# Largest number of bodies of a system; more take gigabytes.
MAX_BODIES = 1_000_000


@dataclass(frozen=True)
class BodyKind:
    """Properties that all copies of a body share, in the frame of the body."""

    model: BodyModel
    # Shapes, each with its origin and rotation.
    shapes: Sequence[tuple[Shape, FloatArray, FloatArray]]
    cores: Sequence[ConvexCore]
    mass: float  # [kg]
    centre: FloatArray  # centre of mass (3,) [m]
    moments: FloatArray  # principal moments of inertia (3,) [kg m²]
    axes: FloatArray  # rotation from principal axes to the body (4,)
    mesh: MeshFrame  # displayed mesh
    notices: Sequence[Fault] = ()
    location: str = ""  # its entry of the file
    origin: str | None = None  # prim that the entry names, if any

    @cached_property
    def principal_frame(self) -> FloatArray:
        """Centre of mass and principal axes, in the frame of the body ``(7,)``."""
        return np.concatenate([self.centre, self.axes])

    @cached_property
    def bounding_radius(self) -> float:
        """Bounding radius about the centre of mass [m]."""
        return max(
            float(np.linalg.norm(core.points - self.centre, axis=1).max()) + core.radius
            for core in self.cores
        )

    def core_at_centre(self, core: ConvexCore) -> ConvexCore:
        """Return a core in the frame of the centre of mass and principal axes."""
        to_principal = so3.conjugate(self.axes)
        return core.transformed(-so3.rotate(to_principal, self.centre), to_principal)


def build_body_kind(model: BodyModel, body_data: Mapping[str, Any]) -> BodyKind:
    """Return the shared properties of a body model; raise SIM061 if it is invalid."""
    refusals = RefusalCollector()
    with refusals.collect():
        refuse_all("SIM061", _mass_problems(model))
    with refusals.collect():
        shapes = _body_shapes(model, body_data)
    refusals.check()
    uses_hull = [
        bool(shape_data.get("hull")) for shape_data in body_data.get("shapes", ())
    ] or [False]
    cores, solids, notices, collision_shapes = [], [], [], []
    display_shapes: list[tuple[Mesh | None, ConvexCore, FloatArray, FloatArray]] = []
    for k, (shape, origin, rotation) in enumerate(shapes):
        key = "shape" if model.shape is not None else f"shapes[{k}]"
        if "height_field" in (model.shape or model.shapes[k].shape):
            message = f"a shape of {model.name!r}: a height field has no inside"
            refuse("SIM061", message, key, "use it as a collider, not as a body")
        try:
            core = core_of(shape)
        except ValueError as error:
            refuse("SIM061", f"a shape of {model.name!r}: {error}", key)
        solid = core_solid(shape, core)
        collision_pieces: Sequence[tuple[Shape, ConvexCore]] = [(shape, core)]
        if isinstance(shape, Mesh) and not is_convex(shape, solid):
            is_dynamic = not model.kinematic or model.release is not None
            decomposition: list[tuple[Mesh, ConvexCore]] = []
            if is_dynamic and not uses_hull[k] and can_decompose():
                decomposition = convex_pieces(shape)
            notice = _concave_notice(model.name, shape, decomposition)
            notices.append(replace(notice, where=key))
            if decomposition:
                collision_pieces, solid = decomposition, mesh_solid(shape)
        cores += [core.transformed(origin, rotation) for _, core in collision_pieces]
        collision_shapes += [(piece, origin, rotation) for piece, _ in collision_pieces]
        is_split = len(collision_pieces) > 1
        split_mesh = shape if is_split and isinstance(shape, Mesh) else None
        placed_core = core.transformed(origin, rotation)
        display_shapes.append((split_mesh, placed_core, origin, rotation))
        solids.append(solid.transformed(origin, rotation))
    mass, centre, inertia = _mass_properties(model, solids)
    moments, axes = principal_inertia(inertia)
    prototype = body_data.get("shows")
    mesh = prototype()[0] if prototype else _display_mesh(display_shapes)
    return BodyKind(
        model, collision_shapes, cores, mass, centre, moments, axes, mesh, notices
    )


def _mass_problems(model: BodyModel) -> Iterator[Problem]:
    """Yield conflicts between mass, density and inertia of a body."""
    if model.mass is not None and "density" in model.model_fields_set:
        yield f"{model.name!r} has both a mass and a density", "density", "keep one"
    if model.inertia is None:
        return
    smallest, middle, largest = sorted(model.inertia)
    if 2 * largest > (smallest + middle + largest) * (1 + MASS_ROUNDING):
        message = f"no body can have the moments of {model.name!r}, {model.inertia}: "
        yield f"{message}one is larger than the sum of the others", "inertia", None
    elif not middle:
        message = f"{model.name!r} must have two moments of inertia above 0"
        yield message, "inertia", "only a rod has one of 0"


def _body_shapes(
    model: BodyModel, body_data: Mapping[str, Any]
) -> list[tuple[Shape, FloatArray, FloatArray]]:
    """Return the shapes of a body, each with its origin and rotation."""
    entries = zip(model.shapes, body_data.get("shapes", ()), strict=True)
    shapes = [
        (
            shape_data["shape"],
            np.array(shape.at, np.float64),
            _rotation(shape.rotate, model.name, f"shapes[{k}].rotate"),
        )
        for k, (shape, shape_data) in enumerate(entries)
    ]
    if model.shape is not None:
        if shapes:
            message = f"{model.name!r} has both a shape and shapes"
            refuse("SIM061", message, "shapes", "keep one")
        shapes = [(body_data["shape"], np.zeros(3), so3.IDENTITY)]
    if not shapes:
        hint = "shape: {sphere: {radius: 0.1}}"
        refuse("SIM061", f"{model.name!r} has no shape", hint=hint)
    return shapes


def _concave_notice(
    name: str, mesh: Mesh, pieces: Sequence[tuple[Shape, ConvexCore]]
) -> Fault:
    """Return a notice about the collision shape of a concave mesh (SIM125, SIM198)."""
    if pieces:
        excess = excess_volume(mesh, [core for _, core in pieces])
        message = f"a mesh of {name!r} collides as "
        message += f"{counted(len(pieces), 'convex piece')}, {excess:+.1%} of its "
        message += "volume"
        return Fault("SIM198", message, severity=Severity.NOTE)
    message = f"a mesh of {name!r} is not convex, or open: its convex hull collides"
    hint = "build it from several convex shapes"
    if not can_decompose():
        hint += f", or install coacd: {INSTALL_COMMAND}"
    return warning("SIM125", message, hint)


def _mass_properties(
    model: BodyModel, solids: Sequence[SolidProperties]
) -> tuple[float, FloatArray, FloatArray]:
    """Return mass [kg], centre of mass [m] and inertia about it ``(3, 3)`` [kg m²]."""
    densities = [shape.density or model.density for shape in model.shapes]
    densities = densities or [model.density]
    total_mass = sum(
        solid.volume * density for solid, density in zip(solids, densities, strict=True)
    )
    if min(total_mass, total_mass if model.mass is None else model.mass) < MIN_MASS:
        message = f"{model.name!r} must weigh {MIN_MASS:g} kg or more"
        refuse("SIM061", message, hint="are its lengths in metres?")
    combined_solid = combine_solids(solids, densities)
    mass = combined_solid.volume if model.mass is None else model.mass
    inertia = combined_solid.inertia * (mass / combined_solid.volume)
    centre = combined_solid.centre
    if model.centre is not None:
        centre = np.array(model.centre, np.float64)
        offset = combined_solid.centre - centre
        inertia = inertia + point_inertia(mass, offset)
    if model.inertia is not None:
        moments = np.array(model.inertia, np.float64)
        axes = so3.to_matrix(_rotation(model.inertia_axes, model.name, "inertia_axes"))
        inertia = axes @ np.diag(moments) @ axes.T
    if np.trace(inertia) < MIN_MOMENT:
        message = f"{model.name!r} must have moments of {MIN_MOMENT:g} kg m² or more"
        refuse("SIM061", message, hint="are its lengths in metres?")
    return mass, centre, inertia


def principal_inertia(inertia: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return principal moments ``(3,)``, and principal axes as a quaternion ``(4,)``.

    Inertias that are diagonal up to rounding keep the axes of the frame.
    """
    trace = float(np.trace(inertia))
    if np.abs(inertia - np.diag(np.diag(inertia))).max() <= DIAGONAL_TOLERANCE * trace:
        return np.diag(inertia).copy(), so3.IDENTITY.copy()
    moments, axes = np.linalg.eigh(inertia)
    # The axis nearest to x comes first, and so on: small changes stay small.
    axis_order = [int(np.argmax(np.abs(axes[0])))]
    other_axes = [k for k in range(3) if k not in axis_order]
    axis_order += sorted(other_axes, key=lambda k: -abs(float(axes[1, k])))
    axes = axes[:, axis_order] * np.sign(np.diag(axes[:, axis_order]) + 1e-300)
    if np.linalg.det(axes) < 0:
        axes[:, 2] = -axes[:, 2]
    # Rounding far from the centre may make small ones negative.
    return np.maximum(moments[axis_order], 0.0), so3.from_matrix(axes)


def _display_mesh(
    display_shapes: Sequence[tuple[Mesh | None, ConvexCore, FloatArray, FloatArray]],
) -> MeshFrame:
    """Return the display mesh of a body; decomposed meshes keep their faces."""
    points, counts, corners, first_index = [], [], [], 0
    for mesh, core, origin, rotation in display_shapes:
        shape_points, shape_counts, shape_corners = core_mesh(core)
        if mesh is not None:
            vertices, triangles = mesh.weld()
            shape_points = origin + so3.rotate(rotation, vertices)
            shape_counts = np.full(len(triangles), 3)
            shape_corners = triangles.ravel().astype(np.int64)
        points.append(shape_points)
        counts.append(shape_counts)
        corners.append(shape_corners + first_index)
        first_index += len(shape_points)
    vertices = np.concatenate(points)
    return MeshFrame(
        vertices,
        np.zeros_like(vertices),
        np.concatenate(counts),
        np.concatenate(corners),
        closed=True,
    )


def motion_key_problems(model: BodyModel) -> Iterator[Problem]:
    """Yield a problem for each key that contradicts how a body moves."""
    for key in ("moves", "turns", "prim"):
        if getattr(model, key) and not model.kinematic:
            message = f"{model.name!r} is dynamic, so it cannot have {key}"
            yield message, key, f"write kinematic: true, or remove {key}"
    for key in ("velocity", "spin") if model.kinematic else ():
        if key in model.model_fields_set:
            message = f"{model.name!r} is kinematic: its moves set its velocity"
            yield message, key, f"remove {key}, or kinematic"
    if model.release is not None and not model.kinematic:
        message = f"{model.name!r} is dynamic, so it cannot be released"
        yield message, "release", "write kinematic: true, or remove release"
    if model.pushes and model.kinematic and model.release is None:
        yield f"{model.name!r} is kinematic: forces do not act on it", "pushes", None
    for k, push in enumerate(model.pushes):
        start, end = push.start, push.end
        if start is not None and end is not None and end <= start:
            message = f"a force on {model.name!r} starts at {start:g} s, but ends at "
            yield f"{message}{end:g} s", f"pushes[{k}].end", None


def copy_placements(
    model: BodyModel, body_data: Mapping[str, Any]
) -> tuple[FloatArray, FloatArray]:
    """Return positions ``(C, 3)`` and rotations ``(C, 4)`` of copies of a body."""
    points, rotations = body_data.get("points"), body_data.get("rotations")
    if model.grid is not None:
        if points is not None:
            message = f"{model.name!r} has both a grid and points"
            refuse("SIM061", message, "points", "keep one")
        grid_counts = np.array(model.grid.count)
        if grid_counts.prod() > MAX_BODIES:
            message = f"{model.name!r} has more than {MAX_BODIES} copies"
            refuse("SIM061", message, "grid")
        x, y, z = np.meshgrid(*(np.arange(n) for n in grid_counts), indexing="ij")
        grid_positions = (
            np.stack([x, y, z], axis=-1).transpose(1, 2, 0, 3).reshape(-1, 3) * 1.0
        )
        grid_positions[:, 0] += model.grid.stagger * (grid_positions[:, 1] % 2)
        points = grid_positions * np.array(model.grid.spacing)
    if points is None:
        if rotations is not None:
            refuse("SIM061", "rotations need points", "rotations")
        return np.zeros((1, 3)), so3.IDENTITY[None]
    count = len(points)
    quaternions = np.tile(so3.IDENTITY, (count, 1))
    if rotations is not None:
        quaternions = np.asarray(rotations, np.float64)
        if quaternions.shape == (count, 4):
            quaternions = quaternions[:, [1, 2, 3, 0]]
    for name, array, width in (("points", points, 3), ("rotations", quaternions, 4)):
        if array.shape != (count, width):
            message = f"{name} of {model.name!r} have shape {array.shape}, not "
            hint = None
            if array.ndim == 2 and array.shape[1] == width:
                hint = f"give as many {name} as points, of which there are {count}"
            refuse("SIM061", f"{message}{(count, width)}", name, hint)
        is_finite = np.isfinite(array).all(axis=1)
        if not is_finite.all():
            index = int(np.argmin(is_finite))
            message = f"{name} of {model.name!r} are not finite at index {index}"
            refuse("SIM061", message, name)
    if not quaternions.any(axis=1).all():
        message = f"a rotation of {model.name!r} is a zero quaternion"
        refuse("SIM061", message, "rotations")
    return np.asarray(points, np.float64), so3.normalize(quaternions)


def _rotation(wxyz: Sequence[float], name: str, key: str) -> FloatArray:
    """Return a quaternion w, x, y, z as a unit x, y, z, w; raise SIM061 if it is 0."""
    rotation = np.array(wxyz, np.float64)[[1, 2, 3, 0]]
    if not rotation.any():
        refuse("SIM061", f"a rotation of {name!r} is a zero quaternion", key)
    return so3.normalize(rotation)
