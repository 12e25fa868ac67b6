"""Initial fluid, and inflow from nozzles."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import (
    Fault,
    RefusalCollector,
    counted,
    percent_text,
    refuse,
    warning,
)
from animtool.core.quantities import floor_to_two_digits, length_text
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.sim.colliders import Capsule, Collider, Colliders, Plane, Poses, Sphere
from animtool.sim.colliders.shapes import shape_bounds
from animtool.systems.fluid.spec import FillModel, FluidEmitterModel, FluidModel

# Largest number of lattice points per particle in a shape.
MAX_REJECTED_POINTS = 8
# Smallest distance of particles at the start, in spacings.
MIN_SPACING = 0.25
# Smallest distance of entering particles from others, in spacings.
MIN_INFLOW_DISTANCE = 0.6
# Relative rounding tolerance of radii, and of the time between layers [1].
RELATIVE_ROUNDING = 1e-6
# A fill of more spacings across than this has about its volume in particles. Others may
# lack or gain this fraction of it [1], estimated from samples along each side.
COARSE_SIDE, MAX_VOLUME_ERROR, VOLUME_SAMPLES = 8.0, 1 / 3, 16
# Spacings across the shortest side of a fill, in hints.
FINE_SIDE = 10.0
# Radius of drops whose surface tension has an error of 10 %, in spacings.
RESOLVED_RADIUS = 5.0
# Radius of the drops of a jet relative to that of the jet (Rayleigh 1879).
JET_DROP_RATIO = 1.89
# Interval for measuring the motion of a nozzle [s].
VELOCITY_INTERVAL = 1e-4


def initial_fluid(
    spec: FluidModel,
    fill_data: Sequence[Mapping[str, Any]],
    colliders: Colliders,
    t: float,
) -> FloatArray:
    """Return positions and velocities of the initial fluid ``(2, N, 3)``."""
    fill_states, refusals = [np.zeros((2, 0, 3))], RefusalCollector()
    for i, data in enumerate(fill_data):
        with refusals.collect():
            fill_states.append(_fill_motion(spec, i, data, colliders, t))
    refusals.check()
    state = np.concatenate(fill_states, axis=1)
    _check_count(spec, state.shape[1], "fills")
    _check_distinct(
        spec, state[0], np.cumsum([fill.shape[1] for fill in fill_states[1:]])
    )
    return state


def coarse_drop_warnings(
    spec: FluidModel, fill_data: Sequence[Mapping[str, Any]]
) -> Iterator[Fault]:
    """Yield a warning about drops with too few particles for tension (SIM175)."""
    if not spec.tension:
        return
    radii = []
    for i, data in enumerate(fill_data):
        if isinstance(data.get("shape"), Sphere | Capsule):
            min_size = float(np.diff(shape_bounds(data["shape"]), axis=0).min())
            radii.append((_fill_label(spec, i), min_size / 2))
    nozzle_radii = [
        emitter.radius for emitter in spec.emitters if emitter.radius is not None
    ]
    for i, nozzle_radius in enumerate(nozzle_radii):
        radii.append((f"a drop of nozzle {i}", JET_DROP_RATIO * nozzle_radius))
    for name, radius in radii:
        radius_in_spacings = radius / spec.spacing
        if radius_in_spacings >= RESOLVED_RADIUS * (1 - RELATIVE_ROUNDING):
            continue
        message = f"{name} has a radius of {radius:.3g} m, {radius_in_spacings:.2g} "
        message += "spacings: below "
        message += f"{RESOLVED_RADIUS:g}, surface tension may be off by a tenth or more"
        resolved_spacing = floor_to_two_digits(radius / RESOLVED_RADIUS)
        hint = f"use a spacing of {length_text(resolved_spacing)}"
        yield warning("SIM175", message, hint, "spacing")
        return


def coarse_fill_warnings(
    spec: FluidModel,
    fill_data: Sequence[Mapping[str, Any]],
    colliders: Colliders,
    t: float,
) -> Iterator[Fault]:
    """Yield a warning about the first fill that the spacing is too large for (SIM204).

    It is thinner than the spacing, or has a third more or less volume than its
    particles.
    """
    spacing = spec.spacing
    for i, data in enumerate(fill_data):
        if data.get("shape") is None:
            continue
        sides = np.diff(shape_bounds(data["shape"]), axis=0)[0]
        side, label = float(sides.min()), _fill_label(spec, i)
        if side < (1 - RELATIVE_ROUNDING) * spacing:
            message = f"{label} is {length_text(side)} thick, less than "
            message += f"the spacing of particles, {length_text(spacing)}: its "
            message += "particles stand for more fluid than it has"
            half = floor_to_two_digits(side / 2)
            hint = f"use a spacing of {length_text(half)}, or a larger fill"
            yield warning("SIM204", message, hint, f"fills[{i}].shape")
            return
        if side > COARSE_SIDE * spacing:
            continue
        count = _fill_motion(spec, i, data, colliders, t).shape[1]
        volume = _free_volume(data["shape"], data["poses"], colliders, t)
        ratio = count * spacing**3 / volume if volume else 1.0
        if abs(ratio - 1.0) <= MAX_VOLUME_ERROR:
            continue
        message = f"{label} has {volume:.3g} m³ of room, but gets "
        message += f"{counted(count, 'particle')} of {length_text(spacing)}, "
        message += f"{count * spacing**3:.3g} m³: "
        message += f"{percent_text(abs(ratio - 1.0))} of the fluid is "
        message += "missing" if ratio < 1.0 else "too much"
        fine = floor_to_two_digits(side / FINE_SIDE)
        hint = f"use a spacing of {length_text(fine)}, a tenth of its shortest side"
        yield warning("SIM204", message, hint, "spacing")
        return


def _free_volume(shape: Any, poses: Poses, colliders: Colliders, t: float) -> float:
    """Return the volume of a shape outside colliders [m³], by sampling."""
    low, high = shape_bounds(shape)
    axis = (np.arange(VOLUME_SAMPLES) + 0.5) / VOLUME_SAMPLES
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    points = low + (high - low) * grid.reshape(-1, 3)
    is_free = Colliders([Collider(shape).as_solid()]).sample(points, 0.0).distances < 0
    pose = poses.at(t)
    if colliders.rigid_colliders:
        world_points = so3.rotate(pose[3:], points) + pose[:3]
        gaps = colliders.as_solids.sample(world_points, t).distances
        is_free = np.concatenate([is_free, gaps >= 0])
    return float(is_free.all(axis=0).mean() * np.prod(high - low))


def _fill_motion(
    spec: FluidModel,
    fill_index: int,
    data: Mapping[str, Any],
    colliders: Colliders,
    t: float,
) -> FloatArray:
    """Return positions and velocities of a fill ``(2, N, 3)``."""
    name, fill = _fill_label(spec, fill_index), spec.fills[fill_index]
    location = f"fills[{fill_index}]"
    if data.get("points") is not None:
        state = _read_points(fill, data, name, location)
        _check_outside(state[0], colliders, t, name, location)
        return state
    points = _lattice_points(spec, data["shape"], data["poses"], t)
    if colliders.rigid_colliders and len(points):
        gaps = colliders.as_solids.sample(points, t).distances
        is_free = gaps.min(axis=0) >= (1 - RELATIVE_ROUNDING) * spec.spacing / 2
        if (gaps < 0).all(axis=1).any():
            _refuse_enclosed(name, gaps, colliders, location)
        points = points[is_free]
    if not len(points):
        message = f"{name} has no particles: it is thinner than the spacing of "
        message += f"{spec.spacing:g} m, or inside colliders"
        refuse("SIM064", message, location, "use a smaller spacing, or a larger fill")
    velocities = np.broadcast_to(np.asarray(fill.velocity, np.float64), points.shape)
    return np.stack([points, velocities])


def _refuse_enclosed(
    name: str, gaps: FloatArray, colliders: Colliders, location: str
) -> None:
    """Raise SIM064 for a fill inside a solid collider or outside a container."""
    collider_index = int(np.argmax((gaps < 0).all(axis=1)))
    collider, collider_name = (
        colliders.rigid_colliders[collider_index],
        colliders.label(collider_index),
    )
    if collider.container:
        message = f"{name} is outside the container {collider_name}"
        refuse("SIM064", message, location, "move it inside")
    message = f"{name} is inside the collider {collider_name}, which is solid"
    hint = "move it out"
    if not isinstance(collider.shape, Plane):
        hint = "for a tank that holds it, add 'container: true' to the collider"
    refuse("SIM064", message, location, hint)


def _fill_label(spec: FluidModel, i: int) -> str:
    """Return the name of a fill for messages."""
    return repr(spec.fills[i].name) if spec.fills[i].name else f"fill {i}"


def _read_points(
    fill: FillModel, data: Mapping[str, Any], name: str, location: str
) -> FloatArray:
    """Return positions and velocities from arrays of files ``(2, N, 3)``."""
    points, velocities = data["points"], data.get("velocities")
    if velocities is None:
        velocities = np.broadcast_to(np.array(fill.velocity), (len(points), 3))
    for label, array in (("points", points), ("velocities", velocities)):
        shape = (len(points), 3)
        if array.shape != shape:
            message = f"{label} of {name} have shape {array.shape}, not {shape}"
            refuse("SIM064", message, f"{location}.{label}")
        is_invalid = ~np.isfinite(array).all(axis=1)
        if is_invalid.any():
            i = int(np.argmax(is_invalid))
            message = f"{label} of {name}: row {i} is not finite"
            refuse("SIM064", message, f"{location}.{label}")
    return np.stack([points, velocities])


def _check_outside(
    points: FloatArray, colliders: Colliders, t: float, name: str, location: str
) -> None:
    """Raise SIM064 if points start inside colliders, or outside a container."""
    if not colliders.rigid_colliders or not len(points):
        return
    gaps = colliders.as_solids.sample(points, t).distances
    is_inside = gaps < 0
    if not is_inside.any():
        return
    collider_index, particle = (int(k) for k in np.argwhere(is_inside)[0])
    is_container = colliders.rigid_colliders[collider_index].container
    relation = "outside the container" if is_container else "inside"
    depth = -gaps[collider_index, particle]
    message = f"particle {particle} of {name} starts {depth:g} m {relation} "
    message += colliders.label(collider_index)
    other_count = int(is_inside.any(axis=0).sum()) - 1
    if other_count:
        message += f", and {counted(other_count, 'other')} start in colliders too"
    refuse("SIM064", message, location, "move it, or remove it")


def _check_distinct(spec: FluidModel, points: FloatArray, fill_ends: IntArray) -> None:
    """Raise SIM064 if particles are closer than pressure can separate."""
    from scipy.spatial import cKDTree

    if len(points) < 2:
        return
    min_gap = MIN_SPACING * spec.spacing
    pairs = cKDTree(points).query_pairs(min_gap, output_type="ndarray")
    if not len(pairs):
        return
    first_particle, second_particle = sorted(
        pairs[np.lexsort(pairs.T[::-1])[0]].tolist()
    )
    particle_labels = []
    for i in (first_particle, second_particle):
        k = int(np.searchsorted(fill_ends, i, side="right"))
        begin = int(fill_ends[k - 1]) if k else 0
        particle_labels.append(f"particle {i - begin} of {_fill_label(spec, k)}")
    gap = float(np.linalg.norm(points[first_particle] - points[second_particle]))
    message = f"{particle_labels[0]} and {particle_labels[1]} start {gap:g} m apart, "
    message += f"but the spacing is {spec.spacing:g} m"
    hint = "keep fills from overlapping, and remove duplicates"
    refuse("SIM064", message, "fills", hint)


def _check_count(spec: FluidModel, count: float, key: str) -> None:
    """Raise SIM064 if the number of particles exceeds the limit."""
    if count > spec.max_particles:
        message = f"{key} need {count:,.0f} particles at a spacing of "
        message += f"{length_text(spec.spacing)}, but the limit is "
        message += f"{spec.max_particles:,}"
        min_spacing = spec.spacing * (count / spec.max_particles) ** (1 / 3)
        unit = 10.0 ** (math.floor(math.log10(min_spacing)) - 2)
        min_spacing = math.ceil(min_spacing / unit - RELATIVE_ROUNDING) * unit
        hint = f"use a spacing of {length_text(min_spacing)} or more, or raise "
        hint += "max_particles"
        refuse("SIM064", message, "spacing", hint)


def _lattice_points(spec: FluidModel, shape: Any, poses: Poses, t: float) -> FloatArray:
    """Return lattice points inside a shape ``(N, 3)`` [m]."""
    low, high = shape_bounds(shape)
    point_counts = np.maximum(np.round((high - low) / spec.spacing), 1.0)
    _check_count(spec, float(np.prod(point_counts)) / MAX_REJECTED_POINTS, "fills")
    axis_coordinates = [
        (np.arange(int(n)) + 0.5 - n / 2) * spec.spacing + (a + b) / 2
        for n, a, b in zip(point_counts, low, high, strict=True)
    ]
    grid = np.stack(np.meshgrid(*axis_coordinates, indexing="ij"), axis=-1).reshape(
        -1, 3
    )
    is_inside = (
        Colliders([Collider(shape).as_solid()]).sample(grid, 0.0).distances[0] < 0
    )
    pose = poses.at(t)
    return so3.rotate(pose[3:], grid[is_inside]) + pose[:3]


@dataclass(frozen=True, slots=True)
class Inflow:
    """Fluid that enters in a step."""

    state: FloatArray  # positions and velocities at the end of the step (2, N, 3)
    births: FloatArray  # birth times (N,) [s]
    skipped_count: int  # number of particles above the limit


class Nozzle:
    """An emitter that releases fluid in lattice layers."""

    def __init__(
        self, spec: FluidModel, emitter: FluidEmitterModel, poses: Poses, begin: float
    ) -> None:
        self._poses, self._speed = poses, emitter.speed
        self._layer_period = spec.spacing / emitter.speed  # time between layers [s]
        opens: Sequence[Sequence[float]] = emitter.opens or [(begin, math.inf)]
        self._open_intervals = [(max(a, begin), b) for a, b in opens]
        self._layer_points = self._layer_positions(spec, emitter)

    def _layer_positions(
        self, spec: FluidModel, emitter: FluidEmitterModel
    ) -> FloatArray:
        """Return the lattice points of a layer ``(M, 3)`` [m]."""
        radius = emitter.radius
        width, depth = emitter.size or (2 * (radius or 0.0), 2 * (radius or 0.0))
        counts = [max(round(side / spec.spacing), 1) for side in (width, depth)]
        min_count = float(counts[0]) * counts[1] / MAX_REJECTED_POINTS
        _check_count(spec, min_count, "emitters")
        x, z = ((np.arange(count) + 0.5 - count / 2) * spec.spacing for count in counts)
        grid = np.stack(np.meshgrid(x, [0.0], z, indexing="ij"), axis=-1).reshape(-1, 3)
        if radius is None or len(grid) == 1:
            return grid
        return np.asarray(grid[np.linalg.norm(grid, axis=1) < radius])

    def _layer_count(self, interval: Sequence[float], t: float) -> int:
        """Return the number of layers released in an interval before a time."""
        duration = min(t, interval[1]) - interval[0]
        return max(math.ceil(duration / self._layer_period - RELATIVE_ROUNDING), 0)

    def inflow(
        self, start: float, end: float, gravity: FloatArray, capacity: int
    ) -> Inflow:
        """Return the fluid released between two times [s], under gravity ``(3,)``."""
        states, births = [np.zeros((2, 0, 3))], [np.zeros(0)]
        layer_size, skipped_count = len(self._layer_points), 0
        for interval in self._open_intervals:
            first_layer = self._layer_count(interval, start)
            last_layer = self._layer_count(interval, end)
            count = min(last_layer - first_layer, capacity // layer_size)
            skipped_count += (last_layer - first_layer - count) * layer_size
            capacity -= count * layer_size
            if count <= 0:
                continue
            layer_indices = first_layer + np.arange(count)
            release_times: FloatArray = (
                interval[0] + np.float64(self._layer_period) * layer_indices
            )
            states.append(self._released_layers(release_times, end, gravity))
            births.append(np.repeat(release_times, layer_size))
        state = np.concatenate(states, axis=1)
        return Inflow(state, np.concatenate(births), skipped_count)

    def _released_layers(
        self, release_times: FloatArray, end: float, gravity: FloatArray
    ) -> FloatArray:
        """Return layers released at given times, moved to ``end`` ``(2, K M, 3)``."""
        poses = self._poses.at_times(release_times)
        earlier_poses = self._poses.at_times(release_times - VELOCITY_INTERVAL)
        layer_size = len(self._layer_points)
        emitter_velocity = (poses[:, :3] - earlier_poses[:, :3]) / VELOCITY_INTERVAL
        rotations = np.repeat(poses[:, 3:], layer_size, axis=0)
        emitter_velocity = np.repeat(emitter_velocity, layer_size, axis=0)
        layer_points = np.tile(self._layer_points, (len(release_times), 1))
        outflow = np.broadcast_to([0.0, self._speed, 0.0], layer_points.shape)
        origins = np.repeat(poses[:, :3], layer_size, axis=0)
        x = so3.rotate(rotations, layer_points) + origins
        v = so3.rotate(rotations, outflow) + emitter_velocity
        elapsed_times = np.repeat(end - release_times, layer_size)[:, None]
        end_points = x + elapsed_times * (v + elapsed_times / 2 * gravity)
        return np.stack([end_points, v + elapsed_times * gravity])


def find_clear_points(
    points: FloatArray,
    particles: FloatArray,
    colliders: Colliders,
    t: float,
    spacing: float,
) -> Any:
    """Return a mask of points ``(M, 3)`` clear of particles and colliders ``(M,)``."""
    from scipy.spatial import cKDTree

    is_free = np.ones(len(points), bool)
    if not len(points):
        return is_free
    low, high = points.min(axis=0) - spacing, points.max(axis=0) + spacing
    neighbours = particles[((particles >= low) & (particles <= high)).all(axis=1)]
    if len(neighbours):
        gaps, _ = cKDTree(neighbours).query(points)
        is_free = gaps >= MIN_INFLOW_DISTANCE * spacing
    if colliders.rigid_colliders:
        gaps = colliders.as_solids.sample(points, t).distances
        is_free = is_free & (gaps >= 0).all(axis=0)
    return is_free
