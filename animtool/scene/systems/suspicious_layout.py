"""Warnings about systems that fall freely, start inside colliders, or are Z up."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import percent_text
from animtool.core.quantities import length_text, plain_number, vector_text
from animtool.core.units import UpAxis
from animtool.documents.document import Document, Location, parse_location
from animtool.maths import so3
from animtool.motion.marker_size import UNIT_FACTORS
from animtool.motion.transforms import PropRequest
from animtool.scene.file.entries import SceneSystem
from animtool.scene.systems.carriers import PrimCarrier
from animtool.scene.systems.suspicious_forces import EARTH_GRAVITY, warn_of_weak_gravity
from animtool.sim.colliders import Box, Capsule, Collider, Colliders, Plane, Sphere
from animtool.sim.colliders.shapes import shape_bounds

# A system that falls freely by more leaves the picture [m].
MIN_FALL_DISTANCE = 2.0
# Entries that start deeper than their size, by more than this, do so by mistake [m].
MIN_START_DEPTH = 0.05
# Thickness over width of a slab, and the sine of its slope when it is upright.
MAX_SLAB_RATIO, MAX_UPRIGHT_SINE = 0.1, 0.1
# A box of which half or more is cut was placed by a corner, or beyond a wall; half of a
# sphere may be meant as a dome [1]. Placed as meant, hardly anything is cut [1].
MAX_CUT_FRACTION, MAX_ROUND_CUT_FRACTION, MAX_DISPLACED_CUT_FRACTION = 0.45, 0.55, 0.1
# Sample points along each side of a shape's bounds, for its cut fraction.
FILL_SAMPLES_PER_SIDE = 12
# Height above the ground that no position of a crowd needs [m].
MAX_CROWD_HEIGHT = 2.0
# A prim is in another unit if it would then be this near to the particles that it
# holds, as a fraction of its distance from them [1].
MAX_UNIT_GAP = 0.05
# Names of pins of each kind, in hints.
_PINS = {"rope": "start", "cloth": "top_left"}


class _EntryStart(NamedTuple):
    """Where an entry starts: points, and its radius around each of them."""

    location: Location
    label: str
    points: FloatArray  # (N, 3) [m]
    radius: float  # [m]


def warn_of_layout(
    document: Document, systems: Sequence[SceneSystem], seconds: float
) -> None:
    """Warn of systems in free fall, and of entries that start inside planes.

    Lengths of the systems are in metres. ``seconds`` is the time from the first to the
    last frame; 0 if unknown [s]. The warnings are SIM200, SIM201 and SIM202.
    """
    used_names: set[str] = set()
    for system in systems:
        links = (
            *system.setup.surroundings.needed_systems,
            *system.setup.joined_systems,
        )
        used_names |= {name for name, _ in links}
    for system in systems:
        location = system.setup.location
        spec, surroundings = system.setup.spec, system.setup.surroundings
        if system.kind == "crowds":
            _warn_of_z_up(document, location, spec)
            continue
        if system.kind == "nbody":
            warn_of_weak_gravity(
                document, location, spec, system.setup.entries, seconds
            )
            continue
        _warn_of_prim_units(document, system)
        starts = list(_starts(system.kind, location, spec))
        if not system.setup.carriers and spec.resume is None:
            _warn_of_planes(
                document, location, starts, surroundings.colliders, "colliders"
            )
            kill_colliders = system.setup.entries.get("kill") or ()
            _warn_of_planes(document, location, starts, kill_colliders, "kill")
            if system.kind == "fluid":
                _warn_of_cut_fills(document, system)
        fall_distance = _free_fall_acceleration(system.kind, spec) * seconds**2 / 2
        has_contacts = (
            surroundings.needed_systems
            or surroundings.characters
            or surroundings.meshes
            or surroundings.carrier_ties
        )
        if (
            fall_distance <= MIN_FALL_DISTANCE
            or has_contacts
            or system.name in used_names
        ):
            continue
        if not surroundings.colliders and not system.setup.joined_systems:
            _warn_of_fall(document, location, system, fall_distance)
        elif len(surroundings.colliders) == 1:
            _warn_of_upright(
                document, location, starts, surroundings.colliders[0], fall_distance
            )


def _warn_of_prim_units(document: Document, system: SceneSystem) -> None:
    """Warn of a prim that in another unit of its file would be at its pin (SIM168)."""
    for pin in getattr(system.setup.record, "pinned_points", ()):
        carrier = pin.carrier
        if not isinstance(carrier, PrimCarrier) or document.faults:
            continue
        poses = carrier.sample_poses()
        pose = poses.at(0.0)
        offsets = so3.rotate(pose[3:], pin.local_positions(poses))
        distance = float(np.linalg.norm(offsets, axis=-1).min(initial=math.inf))
        if not 0.0 < distance < math.inf:
            continue
        for factor in UNIT_FACTORS:
            gaps = np.linalg.norm(offsets + (1.0 - factor) * pose[:3], axis=-1)
            if float(gaps.min()) <= MAX_UNIT_GAP * distance:
                _warn_of_prim_unit(document, system, pin, distance, factor)
                return


def _warn_of_prim_unit(
    document: Document,
    system: SceneSystem,
    pin: Any,
    distance: float,
    factor: float,
) -> None:
    """Warn of a prim [m] away from its pin whose file is in another unit."""
    from animtool.usd.props.reader import open_prop

    carrier: PrimCarrier = pin.carrier
    request = PropRequest(
        carrier.file, carrier.prim, carrier.prim, reference=carrier.file
    )
    reference = open_prop(request, UpAxis.Y).track.reference
    assert reference is not None
    unit = reference.meters_per_unit
    message = f"{carrier.prim} is {length_text(distance)} from the particles that it "
    message += f"holds, but at them if all lengths of {carrier.file.name} were "
    message += f"multiplied by {plain_number(factor)}"
    hint = f"it states metersPerUnit = {unit:g}; if that is wrong, write "
    hint += f"{plain_number(unit * factor)}"
    key_location = (*system.setup.location, *parse_location(pin.where), "prim")
    document.warn("SIM168", key_location, message, hint)


def _free_fall_acceleration(kind: str, spec: Any) -> float:
    """Return the acceleration of a system in free fall [m/s²]; 0 if it cannot fall."""
    if kind in {"rope", "strands", "cloth", "volume"}:
        is_supported = spec.pins or spec.air is not None or spec.settle
        return 0.0 if is_supported else math.hypot(*spec.gravity)
    if kind == "rigid":
        are_moving = (
            body.kinematic or body.pushes or any(body.velocity) or any(body.spin)
            for body in spec.bodies
        )
        is_supported = spec.stages or any(joint.to is None for joint in spec.joints)
        return (
            0.0 if is_supported or any(are_moving) else _gravity_of_forces(spec.forces)
        )
    if kind == "fluid":
        are_moving = (fill.velocities or any(fill.velocity) for fill in spec.fills)
        is_supported = spec.emitters or spec.drains
        return (
            0.0 if is_supported or any(are_moving) else _gravity_of_forces(spec.forces)
        )
    return 0.0


def _gravity_of_forces(forces: Sequence[Mapping[str, Any]]) -> float:
    """Return the gravity among forces [m/s²]; 0 if there is any other force."""
    total = np.zeros(3)
    for force in forces:
        ((name, options),) = force.items()
        if name != "gravity":
            return 0.0
        total += (options or {}).get("acceleration", (0.0, -EARTH_GRAVITY, 0.0))
    return float(np.linalg.norm(total))


def _warn_of_fall(
    document: Document, location: Location, system: SceneSystem, fall_distance: float
) -> None:
    """Warn of a system that falls a distance [m] without support (SIM201)."""
    has_pins = hasattr(system.setup.spec, "pins")
    problem = (
        "has no pins and nothing to collide with" if has_pins else "touches nothing"
    )
    message = f"{system.name} {problem}: it falls freely, by "
    message += f"{length_text(fall_distance)} in the range"
    hint = "add a floor: colliders: [{shape: {plane: }}]"
    if system.kind == "fluid":
        hint = "add a floor or a tank under colliders; a tank has container: true"
    elif system.kind in _PINS:
        hint = f"pin it, such as pins: [{{particles: [{_PINS[system.kind]}]}}], or "
        hint += "add colliders"
    document.warn("SIM201", location, message, hint)


def _warn_of_upright(
    document: Document,
    location: Location,
    starts: Sequence[_EntryStart],
    collider: Collider,
    fall_distance: float,
) -> None:
    """Warn of a floor whose rotation makes it a wall (SIM201)."""
    if not isinstance(collider.shape, Box) or collider.container:
        return
    size, pose = np.asarray(collider.shape.size, np.float64), collider.poses.rows[0]
    thin_axis = so3.rotate(pose[3:], np.array([0.0, 1.0, 0.0]))
    is_slab = size[1] <= MAX_SLAB_RATIO * min(size[0], size[2])
    if (
        not is_slab
        or abs(thin_axis[1]) > MAX_UPRIGHT_SINE
        or len(collider.poses.rows) > 1
    ):
        return
    if not starts:
        return
    offsets = np.concatenate([start.points - pose[:3] for start in starts])
    is_outside_slab = (np.abs(offsets[:, [0, 2]]) > size[[0, 2]] / 2).any()
    if is_outside_slab or (offsets[:, 1] < 0).any():
        return
    axis = "XYZ"[int(np.argmax(np.abs(thin_axis)))]
    message = "colliders[0] is a slab that stands upright: its rotate turns its thin "
    message += f"side from Y to {axis}; nothing lies below {starts[0].label}, which "
    message += f"falls by up to {length_text(fall_distance)} in the range"
    hint = "systems have Y up: remove the rotate, and check `at`"
    document.warn("SIM201", (*location, "colliders", 0, "rotate"), message, hint)


def _warn_of_planes(
    document: Document,
    location: Location,
    starts: Sequence[_EntryStart],
    colliders: Sequence[Collider],
    key: str,
) -> None:
    """Warn of entries that start completely below a plane (SIM202)."""
    for c, collider in enumerate(colliders):
        if not isinstance(collider.shape, Plane):
            continue
        name = repr(collider.name) if collider.name else f"{key}[{c}]"
        plane, deep_starts = Colliders([collider]), []
        for start in starts:
            depth = -float(plane.sample(start.points, 0.0).distances.max())
            if depth > start.radius + MIN_START_DEPTH:
                deep_starts.append((depth, start))
        if not deep_starts:
            continue
        depth, start = max(deep_starts, key=lambda entry: entry[0])
        normal = np.asarray(collider.shape.normal, np.float64)
        normal = so3.rotate(collider.poses.rows[0, 3:], normal)
        is_down = normal[1] < -0.9 * np.linalg.norm(normal) and not collider.container
        if is_down and len(deep_starts) == len(starts):
            message = f"the normal of {name} points down: everything above the plane "
            message += f"is inside it, such as {start.label}"
            key_location = (*location, key, c, "shape", "plane", "normal")
            hint = "write normal: [0, 1, 0]"
            if collider.shape.normal[1] > 0:
                message = f"{name} is upside down, as its rotate turns its normal: "
                message += f"everything above it is inside it, such as {start.label}"
                key_location, hint = (*location, key, c, "rotate"), "remove rotate"
            document.warn("SIM202", key_location, message, hint)
            return
        side = "outside" if collider.container else "inside"
        if normal[1] > 0.99 * np.linalg.norm(normal):
            side = "above" if collider.container else "below"
        message = f"{start.label} starts {length_text(depth)} {side} {name}"
        hint = f"move it by more than {length_text(depth + start.radius)}"
        if side == "below":
            hint = f"raise it by {length_text(depth + start.radius)} or more"
            hint += ", or is the sign of its y wrong?" if start.points[0, 1] < 0 else ""
        if key == "kill":
            message = f"{name} removes everything that {start.label} emits: it starts "
            message += f"{length_text(depth)} {side} it"
            hint = "a plane removes what is below it; lower its offset, or turn its "
            hint += "normal"
        document.warn("SIM202", start.location, message, hint)
        return


def _warn_of_cut_fills(document: Document, system: SceneSystem) -> None:
    """Warn of fills of which a container or a plane cuts half or more (SIM202)."""
    location, surroundings = system.setup.location, system.setup.surroundings
    spec: Any = system.setup.spec
    walls = [
        (c, Colliders([collider]))
        for c, collider in enumerate(surroundings.colliders)
        if collider.container or isinstance(collider.shape, Plane)
    ]
    entries_of_fills = system.setup.entries.get("fills") or ()
    for i, (fill, fill_entries) in enumerate(
        zip(spec.fills, entries_of_fills, strict=False)
    ):
        shape = (fill_entries or {}).get("shape")
        if not walls or fill.prim or not isinstance(shape, Box | Sphere | Capsule):
            continue
        points, pose = _fill_samples(shape), fill_entries["poses"].at(0.0)
        points = so3.rotate(pose[3:], points) + pose[:3]
        limit = MAX_CUT_FRACTION if isinstance(shape, Box) else MAX_ROUND_CUT_FRACTION
        for c, wall in walls:
            cut_fraction = _inside_fraction(wall, points)
            # A fill without any particle is refused, and one below a plane reported.
            if cut_fraction < limit or cut_fraction == 1.0:
                continue
            side = "outside the container" if wall[0].container else "inside"
            name = repr(wall[0].name) if wall[0].name else f"colliders[{c}]"
            label = repr(fill.name) if fill.name else f"fill {i}"
            message = f"{percent_text(cut_fraction)} of {label} is {side} "
            message += f"{name}, and is not filled"
            hint = "move it inside, or make it smaller"
            half_size = np.ptp(shape_bounds(shape), axis=0) / 2
            offset = so3.rotate(pose[3:], half_size)
            if _inside_fraction(wall, points + offset) < MAX_DISPLACED_CUT_FRACTION:
                unit = 1.0 if system.unit is None else system.unit.meters
                corner, centre = (
                    vector_text(point / unit, 4)
                    for point in (pose[:3], pose[:3] + offset)
                )
                hint = f"at is its centre: for a corner at {corner} write at: {centre}"
            document.warn("SIM202", (*location, "fills", i, "at"), message, hint)
            break


def _fill_samples(shape: Box | Sphere | Capsule) -> FloatArray:
    """Return points evenly inside a shape ``(N, 3)`` [m]."""
    low, high = shape_bounds(shape)
    axis = (np.arange(FILL_SAMPLES_PER_SIDE) + 0.5) / FILL_SAMPLES_PER_SIDE
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    points = low + (high - low) * grid.reshape(-1, 3)
    is_inside = Colliders([Collider(shape)]).sample(points, 0.0).distances[0] < 0
    return np.asarray(points[is_inside])


def _inside_fraction(wall: Colliders, points: FloatArray) -> float:
    """Return the fraction of points ``(N, 3)`` inside a collider at the start [1]."""
    return float((wall.sample(points, 0.0).distances[0] < 0).mean())


def _starts(kind: str, location: Location, spec: Any) -> Iterator[_EntryStart]:
    """Yield the start of each entry, except entries from files and prims."""
    if kind == "rigid":
        for i, body in enumerate(spec.bodies):
            shape = body.shape
            if shape and not (body.kinematic or body.grid or body.points):
                key_location = (*location, "bodies", i, "at")
                yield _EntryStart(
                    key_location,
                    repr(body.name),
                    np.array([body.at]),
                    _shape_radius(shape),
                )
    elif kind in {"particles", "fluid"}:
        for key, name in (("emitters", "emitter"), ("fills", "fill")):
            for i, entry in enumerate(getattr(spec, key, ())):
                shape = getattr(entry, "place", None) or getattr(entry, "shape", None)
                if entry.prim or getattr(entry, "points", None):
                    continue
                if kind == "fluid" and key == "emitters":
                    max_radius = max([entry.radius or 0.0, *(entry.size or ())])
                    shape = {"disc": {"radius": max_radius}}
                label = repr(entry.name) if entry.name else f"{name} {i}"
                radius_about_origin = _shape_radius(shape or {})
                key_location = (*location, key, i, "at")
                points = np.zeros((1, 3))
                if shape and next(iter(shape)) == "box":
                    points = Box(shape["box"]["size"]).anchors()
                    radius_about_origin = 0.0
                w, x, y, z = entry.rotate
                rotation = so3.normalize(np.array([x, y, z, w]))
                points = np.array(entry.at) + so3.rotate(rotation, points)
                yield _EntryStart(key_location, label, points, radius_about_origin)
    elif kind == "rope":
        points = np.array([spec.start, spec.end])
        yield _EntryStart((*location, "from"), spec.name, points, 0.0)
    elif kind == "cloth" and spec.mesh is None:
        corner, across, up = map(np.array, (spec.corner, spec.across, spec.up))
        points = corner + np.array([0 * up, across, up, across + up])
        yield _EntryStart((*location, "corner"), spec.name, points, 0.0)
    elif kind == "volume" and spec.tetrahedra is None:
        points = np.array([spec.corner, np.add(spec.corner, spec.size)])
        yield _EntryStart((*location, "corner"), spec.name, points, 0.0)


def _shape_radius(shape: Mapping[str, Any]) -> float:
    """Return the radius of a shape about its origin [m]; infinite if unknown."""
    ((name, options),) = shape.items() or (("point", None),)
    values = options or {}
    if name == "box":
        return math.hypot(*values["size"]) / 2
    if name in {"sphere", "capsule", "disc"}:
        centre = math.hypot(*values.get("centre", (0.0, 0.0, 0.0)))
        return float(values["radius"] + values.get("length", 0.0) / 2 + centre)
    return 0.0 if name == "point" else math.inf


def _warn_of_z_up(document: Document, location: Location, spec: Any) -> None:
    """Warn of a crowd whose positions, or goals, vary in y but not in z (SIM200)."""
    ground = spec.ground
    if ground.shape is not None or ground.mesh is not None or ground.prim is not None:
        return
    for keys in (("populations", "goals"), ("goals",)):
        entries = [
            ((*location, key, i, "at"), entry.at)
            for key in keys
            for i, entry in enumerate(getattr(spec, key))
            if not getattr(entry, "points", None) and not getattr(entry, "prim", None)
        ]
        heights = [y - ground.at[1] for _, (_, y, _) in entries]
        largest = max(heights, key=abs, default=0.0)
        if abs(largest) > MAX_CROWD_HEIGHT and not any(z for _, (_, _, z) in entries):
            break
    else:
        return
    key_location, (x, y, z) = entries[heights.index(largest)]
    side = "above" if largest > 0 else "below"
    message = f"[{x:g}, {y:g}, {z:g}] is {length_text(abs(largest))} {side} the ground"
    message += ", which agents walk on: heights are ignored, and all z "
    message += "of goals are 0" if len(keys) == 1 else "are 0"
    hint = "systems have Y up: write positions and sizes [x, y, z] as [x, z, -y], "
    hint += f"here [{x:g}, {z:g}, {-y:g}]"
    document.warn("SIM200", key_location, message, hint)
