"""Warnings about parts of a rig in another unit, and about reversed strands."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.quantities import length_text
from animtool.core.units import LengthUnit, unit_name
from animtool.documents.arrays import Archives
from animtool.documents.document import Document, Location
from animtool.rig.drivers import SLIDE, split_coordinate
from animtool.rig.expressions import Expression
from animtool.rig.parts import AttachKind, Attachment, Mesh
from animtool.rig.schema import RigModel
from animtool.rig.skeleton import Rig
from animtool.rig.suspicions import warn_of_stretch_percent
from animtool.rig.suspicious_shape import HINGE_NAMES, rest_pose_without_kernels

# Radii of a body's colliders in the unit that is meant, relative to its size.
RADIUS_RANGE = (0.001, 0.3)
# Mass of a body per cube of its size, from which on it is in grams: people have 5,
# elephants 60, robots of steel 300 [kg/m³].
MAX_BODY_DENSITY = 1000.0
_TRIGONOMETRIC_FUNCTIONS = frozenset({"sin", "cos", "tan"})
# Lengths of ranges in degrees: quarters of a revolution up to a whole one.
_QUARTER_REVOLUTION = 90.0
# Ends of such ranges are multiples of this [deg].
_DEGREE_STEP = 15.0


def warn_of_parts(document: Document, model: RigModel, rig: Rig) -> None:
    """Warn of parts whose numbers suggest another unit, and of reversed strands."""
    for i, chain in enumerate(model.ik):
        warn_of_stretch_percent(document, ("ik", i, "stretch"), chain.stretch)
    _warn_of_degrees(document, rig)
    if any(map(HINGE_NAMES.search, rig.names)):
        positions, _ = rest_pose_without_kernels(rig)
        size = float(np.linalg.norm(np.ptp(positions, axis=0)))
        _warn_of_radii(document, model, size)
        _warn_of_masses(document, model, rig, size)
    _warn_of_strands(document, model, rig)


def _warn_of_radii(document: Document, model: RigModel, rig_size: float) -> None:
    """Warn of colliders that are larger than the body (RIG116)."""
    unit = LengthUnit(model.units.length).meters
    radii = [entry.capsule.radius for entry in model.colliders]
    large_indices = [i for i, radius in enumerate(radii) if radius * unit > rig_size]
    if not rig_size or not large_indices:
        return
    radius = radii[large_indices[0]]
    likely_unit = next(
        (
            other_unit
            for other_unit in (LengthUnit.CM, LengthUnit.MM)
            if other_unit.meters < unit
            and RADIUS_RANGE[0]
            <= radius * other_unit.meters / rig_size
            <= RADIUS_RANGE[1]
        ),
        None,
    )
    message = (
        f"a radius of {length_text(radius * unit)} on a rig that measures "
        f"{length_text(rig_size)}, with lengths in {unit_name(unit)}"
    )
    if len(large_indices) > 1:
        message += f"; {len(large_indices)} colliders are larger than the rig"
    hint = "a collider is about as thick as the limb"
    if likely_unit is not None:
        number = radius * likely_unit.meters / unit
        hint = f"for {radius:.4g} {likely_unit} write {number:.4g}"
    location = ("colliders", large_indices[0], "capsule", "radius")
    document.warn("RIG116", location, message, hint)


def _warn_of_masses(
    document: Document, model: RigModel, rig: Rig, rig_size: float
) -> None:
    """Warn of a body whose masses look like grams (RIG117)."""
    total_mass = sum(mass.mass for mass in rig.masses)
    if not model.masses or total_mass <= MAX_BODY_DENSITY * rig_size**3 or not rig_size:
        return
    i = max(range(len(model.masses)), key=lambda i: model.masses[i].mass)
    largest_mass = model.masses[i].mass
    message = f"the rig weighs {total_mass:.0f} kg and measures {length_text(rig_size)}"
    hint = f"masses are in kg: for {largest_mass:g} g write {largest_mass / 1000:g}"
    document.warn("RIG117", ("masses", i, "mass"), message, hint)


def _warn_of_degrees(document: Document, rig: Rig) -> None:
    """Warn of a trigonometric function whose argument is in degrees (RIG115)."""
    for location, expression in _expressions(document, rig):
        program = expression.postfix_program()
        for (kind, name), (next_kind, function) in pairwise(program):
            is_call = kind == "name" and next_kind == "call"
            if not is_call or function not in _TRIGONOMETRIC_FUNCTIONS:
                continue
            reason = _degrees_reason(rig, str(name))
            if reason is None:
                continue
            message = f"{function}() takes radians, but {reason}"
            hint = f"write {function}({name} * pi / 180)"
            document.warn("RIG115", location, message, hint)
            return


def _expressions(document: Document, rig: Rig) -> Iterator[tuple[Location, Expression]]:
    """Yield the expressions of a rig file with their locations."""
    for i, entry in enumerate(document.value.get("controls", ())):
        control = next((c for c in rig.controls if c.name == entry.get("name")), None)
        drives = () if control is None else control.drives
        for k, drive in enumerate(drives):
            if drive.expression is not None:
                yield ("controls", i, "drives", k, "expr"), drive.expression
    drivers_by_key = {
        "joints": {joint.name: joint.driven for joint in rig.joints},
        "shapes": {shape.name: shape.driven for shape in rig.shapes},
    }
    for key, drivers_by_name in drivers_by_key.items():
        for i, entry in enumerate(document.value.get(key, ())):
            driver = drivers_by_name.get(entry.get("name"))
            if driver is not None and driver.expression is not None:
                yield (key, i, "driven", "expr"), driver.expression


def _degrees_reason(rig: Rig, input_name: str) -> str | None:
    """Return why an input is likely in degrees; None if it is not."""
    joint, part = split_coordinate(input_name)
    if joint:
        is_in_degrees = rig.radians_per_unit != 1.0 and part != SLIDE
        return (
            f"{input_name!r} is in degrees, the unit of the rig"
            if is_in_degrees
            else None
        )
    for control in rig.controls:
        if control.name != input_name or control.low is None or control.high is None:
            continue
        low, high = control.low, control.high
        if low == -high and high > math.pi:
            return f"the range of {input_name!r} is ±{high:g}, as in degrees"
        is_round = all(math.fmod(end, _DEGREE_STEP) == 0 for end in (low, high))
        if is_round and high > low and math.fmod(high - low, _QUARTER_REVOLUTION) == 0:
            return f"the range of {input_name!r} is {low:g} to {high:g}, as in degrees"
    return None


# Number of sampled strands, and of distances that are computed together.
MAX_STRANDS, CHUNK_SIZE = 16, 1_000_000
# Distance of the last point of a reversed strand from the surface, relative to that of
# the first, and distance of the first relative to the strand's length [1].
MAX_LAST_RATIO, MIN_FIRST_RATIO = 0.25, 0.1
# Fraction of the strands that are reversed [1].
MIN_REVERSED_FRACTION = 0.8


def _warn_of_strands(document: Document, model: RigModel, rig: Rig) -> None:
    """Warn of strands whose tips are at the surface, and not their roots (RIG119)."""
    attachments = {entry.name: entry for entry in rig.attach}
    for i, entry in enumerate(model.attach):
        attachment = attachments.get(entry.name)
        if attachment is None or attachment.kind != AttachKind.STRANDS:
            continue
        try:
            with Archives() as archives:
                message = _reversal_text(rig, attachment, archives)
        except ValueError:
            continue
        if message is not None:
            hint = "strands go from root to tip: reverse the points of each, in numpy "
            hint += "points[:, ::-1]"
            document.warn("RIG119", ("attach", i, "points"), message, hint)


def _reversal_text(rig: Rig, attachment: Attachment, archives: Archives) -> str | None:
    """Return a message if strands are reversed, else None."""
    if attachment.points is None or not attachment.joints:
        return None
    strand_points = attachment.points.load(archives)
    strand_points = strand_points[:: -(-len(strand_points) // MAX_STRANDS)]
    first_distances = np.full(len(strand_points), np.inf)
    last_distances = first_distances.copy()
    nearest_meshes = np.zeros(len(strand_points), np.int64)
    nearest_vertices = nearest_meshes.copy()
    for i, mesh in enumerate(rig.meshes):
        vertices = _bind_points(mesh, archives)
        vertex_distances, _ = _nearest_vertices(strand_points[:, 0], vertices)
        first_distances = np.minimum(first_distances, vertex_distances)
        vertex_distances, nearest = _nearest_vertices(strand_points[:, -1], vertices)
        is_nearer = vertex_distances < last_distances
        last_distances = np.minimum(last_distances, vertex_distances)
        nearest_meshes[is_nearer] = i
        nearest_vertices[is_nearer] = nearest[is_nearer]
    lengths = np.linalg.norm(np.diff(strand_points, axis=1), axis=2).sum(axis=1)
    is_reversed = last_distances < MAX_LAST_RATIO * first_distances
    is_reversed &= first_distances > MIN_FIRST_RATIO * lengths
    is_reversed &= np.isfinite(first_distances)
    if float(is_reversed.mean()) < MIN_REVERSED_FRACTION:
        return None
    # The tips of long hair may touch the shoulders.
    carrier_names = _subtree_names(rig, attachment)
    for i in set(nearest_meshes.tolist()):
        strand_indices = np.flatnonzero(nearest_meshes == i)
        vertices_of_mesh = nearest_vertices[strand_indices]
        is_reversed[strand_indices] &= _follows_joints(
            rig.meshes[i], vertices_of_mesh, carrier_names, archives
        )
    if float(is_reversed.mean()) < MIN_REVERSED_FRACTION:
        return None
    first, last = (
        length_text(float(np.median(vertex_distances)) * rig.meters_per_unit)
        for vertex_distances in (first_distances, last_distances)
    )
    return (
        f"first points are typically {first} from the surface, but last points {last}: "
        "the roots seem to be last"
    )


def _subtree_names(rig: Rig, attachment: Attachment) -> frozenset[str]:
    """Return the names of the joint that carries strands and of all joints below it."""
    names = {attachment.joints[0]}
    for joint in rig.joints:
        if joint.parent >= 0 and rig.joints[joint.parent].name in names:
            names.add(joint.name)
    return frozenset(names)


def _bind_points(mesh: Mesh, archives: Archives) -> FloatArray:
    """Return the world positions of a mesh at bind time ``(V, 3)``."""
    points = mesh.points.load(archives)
    if mesh.geom_bind is None:
        return points
    matrix = np.array(mesh.geom_bind).reshape(4, 4)
    return np.asarray(points @ matrix[:3, :3].T + matrix[:3, 3])


def _nearest_vertices(
    points: FloatArray, vertices: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Return the distance and index of the vertex nearest to each point ``(N, 3)``."""
    squared_distances = np.full(len(points), np.inf)
    nearest_indices = np.zeros(len(points), np.int64)
    chunk_size = max(1, CHUNK_SIZE // max(1, len(points)))
    for chunk_start in range(0, len(vertices), chunk_size):
        chunk_vertices = vertices[chunk_start : chunk_start + chunk_size]
        # Without the squares of the points, which change no order.
        chunk_squares = np.einsum("vc,vc->v", chunk_vertices, chunk_vertices)
        chunk_squares = chunk_squares - 2.0 * (points @ chunk_vertices.T)
        indices = chunk_squares.argmin(axis=1)
        offsets = points - chunk_vertices[indices]
        smallest_squares = np.einsum("nc,nc->n", offsets, offsets)
        nearest_indices = np.where(
            smallest_squares < squared_distances, chunk_start + indices, nearest_indices
        )
        squared_distances = np.minimum(squared_distances, smallest_squares)
    return np.sqrt(squared_distances), nearest_indices


def _follows_joints(
    mesh: Mesh, vertices: IntArray, carrier_names: frozenset[str], archives: Archives
) -> BoolArray:
    """Return a mask of the vertices that mostly follow one of the joints ``(N,)``.

    Vertices without a skin may follow any joint.
    """
    if mesh.skin is None:
        return np.ones(len(vertices), bool)
    weights = mesh.skin.weights.load(archives)[vertices]
    columns = mesh.skin.indices.load(archives)[vertices].astype(np.int64)
    largest_influences = columns[np.arange(len(vertices)), weights.argmax(axis=1)]
    is_carrier = np.array([name in carrier_names for name in mesh.skin.joints], bool)
    return np.asarray(is_carrier[largest_influences])
