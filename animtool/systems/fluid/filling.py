"""Initial fluid, and inflow of emitters."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, Refusals, counted, refuse, warning
from animtool.core.quantities import floor_to_two_digits, plain_number
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.sim.colliders import Capsule, Collider, Colliders, Poses, Sphere
from animtool.sim.colliders.shapes import shape_bounds
from animtool.systems.fluid.spec import FillModel, FluidEmitterModel, FluidModel

# Largest number of lattice points for each particle.
MAX_REJECTED_POINTS = 8
# Closer particles count as coincident, in spacings.
MIN_SPACING = 0.25
# Least distance of entering particles from others, in spacings.
MIN_INFLOW_DISTANCE = 0.6
# Rounding tolerance of a radius, or of the time between layers.
ROUNDING = 1e-6
# Radius of a drop, in spacings, above which the error of its tension is below 10 %.
RESOLVED_RADIUS = 5.0
# Radius of the drops of a jet relative to that of the jet (Rayleigh 1879).
JET_DROP_RATIO = 1.89
# Interval for measuring the motion of a nozzle [s].
VELOCITY_INTERVAL = 1e-4


def initial_fluid(
    spec: FluidModel, parts: Sequence[Mapping[str, Any]], colliders: Colliders, t: float
) -> FloatArray:
    """Return positions and velocities of the initial fluid ``(2, N, 3)``."""
    fills, refusals = [np.zeros((2, 0, 3))], Refusals()
    for i, part in enumerate(parts):
        with refusals.collect():
            fills.append(_fill_motion(spec, i, part, colliders, t))
    refusals.check()
    state = np.concatenate(fills, axis=1)
    _check_count(spec, state.shape[1], "fills")
    _check_distinct(spec, state[0], np.cumsum([fill.shape[1] for fill in fills[1:]]))
    return state


def coarse_drops(
    spec: FluidModel, parts: Sequence[Mapping[str, Any]]
) -> Iterator[Fault]:
    """Yield drops with too few particles for surface tension (SIM175)."""
    if not spec.tension:
        return
    radii = [
        (
            _fill_label(spec, i),
            float(np.diff(shape_bounds(part["shape"]), axis=0).min()) / 2,
        )
        for i, part in enumerate(parts)
        if isinstance(part.get("shape"), Sphere | Capsule)
    ]
    nozzles = [
        emitter.radius for emitter in spec.emitters if emitter.radius is not None
    ]
    radii += [
        (f"a drop of nozzle {i}", JET_DROP_RATIO * r) for i, r in enumerate(nozzles)
    ]
    for name, radius in radii:
        radius_in_spacings = radius / spec.spacing
        if radius_in_spacings >= RESOLVED_RADIUS * (1 - ROUNDING):
            continue
        message = f"{name} has a radius of {radius:.3g} m, {radius_in_spacings:.2g} "
        message += "spacings: below "
        message += f"{RESOLVED_RADIUS:g}, surface tension may be off by a tenth or more"
        hint = f"spacing: {plain_number(floor_to_two_digits(radius / RESOLVED_RADIUS))}"
        yield warning("SIM175", message, hint, "spacing")
        return


def _fill_motion(
    spec: FluidModel, i: int, part: Mapping[str, Any], colliders: Colliders, t: float
) -> FloatArray:
    """Return positions and velocities of one fill ``(2, N, 3)``."""
    name, fill = _fill_label(spec, i), spec.fills[i]
    if part.get("points") is not None:
        state = _points_of_file(fill, part, name)
        _check_outside(state[0], colliders, t, name)
        return state
    points = _lattice_points(spec, part["shape"], part["poses"], t)
    if colliders.rigid:
        gaps = colliders.volumes.sample(points, t).distances.min(axis=0)
        points = points[gaps >= (1 - ROUNDING) * spec.spacing / 2]
    if not len(points):
        message = f"{name} has no particles: it is thinner than the spacing of "
        message += f"{spec.spacing:g} m, or inside colliders"
        refuse("SIM064", message, "fills", "use a smaller spacing, or a larger fill")
    speeds = np.broadcast_to(np.asarray(fill.velocity, np.float64), points.shape)
    return np.stack([points, speeds])


def _fill_label(spec: FluidModel, i: int) -> str:
    return repr(spec.fills[i].name) if spec.fills[i].name else f"fill {i}"


def _points_of_file(fill: FillModel, part: Mapping[str, Any], name: str) -> FloatArray:
    """Return positions and velocities from arrays ``(2, N, 3)``."""
    points, velocities = part["points"], part.get("velocities")
    if velocities is None:
        velocities = np.broadcast_to(np.array(fill.velocity), (len(points), 3))
    for label, array in (("points", points), ("velocities", velocities)):
        shape = (len(points), 3)
        if array.shape != shape:
            message = f"{label} of {name} have shape {array.shape}, not {shape}"
            refuse("SIM064", message, "fills")
        invalid = ~np.isfinite(array).all(axis=1)
        if invalid.any():
            i = int(np.argmax(invalid))
            refuse("SIM064", f"{label} of {name}: row {i} is not finite", "fills")
    return np.stack([points, velocities])


def _check_outside(
    points: FloatArray, colliders: Colliders, t: float, name: str
) -> None:
    """Refuse points inside colliders, or outside a container."""
    if not colliders.rigid or not len(points):
        return
    gaps = colliders.volumes.sample(points, t).distances
    is_inside = gaps < 0
    if not is_inside.any():
        return
    c, i = (int(k) for k in np.argwhere(is_inside)[0])
    bodies = [shape for system in colliders.bodies for shape in system.colliders]
    collider = [*colliders, *bodies][c]
    collider_name = repr(collider.name) if collider.name else f"colliders[{c}]"
    relation = "outside the container" if collider.container else "inside"
    message = (
        f"particle {i} of {name} starts {-gaps[c, i]:g} m {relation} {collider_name}"
    )
    other_count = int(is_inside.any(axis=0).sum()) - 1
    message += (
        f", and {counted(other_count, 'other')} start in colliders too"
        if other_count
        else ""
    )
    refuse("SIM064", message, "fills", "move it, or remove it")


def _check_distinct(spec: FluidModel, points: FloatArray, ends: IntArray) -> None:
    """Refuse particles closer than pressure can separate."""
    from scipy.spatial import cKDTree

    if len(points) < 2:
        return
    pairs = cKDTree(points).query_pairs(
        MIN_SPACING * spec.spacing, output_type="ndarray"
    )
    if not len(pairs):
        return
    first, second = sorted(pairs[np.lexsort(pairs.T[::-1])[0]].tolist())
    names = []
    for i in (first, second):
        k = int(np.searchsorted(ends, i, side="right"))
        begin = int(ends[k - 1]) if k else 0
        names.append(f"particle {i - begin} of {_fill_label(spec, k)}")
    gap = float(np.linalg.norm(points[first] - points[second]))
    message = f"{names[0]} and {names[1]} start {gap:g} m apart, but the spacing is "
    message += f"{spec.spacing:g} m"
    refuse(
        "SIM064", message, "fills", "keep fills from overlapping, and remove duplicates"
    )


def _check_count(spec: FluidModel, count: float, key: str) -> None:
    if count > spec.max_particles:
        message = f"it needs {count:,.0f} particles at a spacing of {spec.spacing:g} "
        message += f"m, but the limit is {spec.max_particles:,}"
        min_spacing = spec.spacing * (count / spec.max_particles) ** (1 / 3)
        hint = (
            f"spacing: {math.ceil(min_spacing * 1e3) / 1e3:g}, or raise max_particles"
        )
        refuse("SIM064", message, key, hint)


def _lattice_points(spec: FluidModel, shape: Any, poses: Poses, t: float) -> FloatArray:
    """Return lattice points inside a shape ``(N, 3)`` [m]."""
    low, high = shape_bounds(shape)
    sizes = np.maximum(np.round((high - low) / spec.spacing), 1.0)
    _check_count(spec, float(np.prod(sizes)) / MAX_REJECTED_POINTS, "fills")
    axes = [
        (np.arange(int(n)) + 0.5 - n / 2) * spec.spacing + (a + b) / 2
        for n, a, b in zip(sizes, low, high, strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = Colliders([Collider(shape).volume()]).sample(grid, 0.0).distances[0] < 0
    pose = poses.at(t)
    return so3.rotate(pose[3:], grid[inside]) + pose[:3]


@dataclass(frozen=True, slots=True)
class Inflow:
    """Fluid that enters within a step."""

    state: FloatArray  # positions and velocities at its end (2, N, 3)
    births: FloatArray  # birth times (N,) [s]
    missed: int  # number of particles above the limit


class Nozzle:
    """An emitter that releases lattice layers one after another."""

    def __init__(
        self, spec: FluidModel, emitter: FluidEmitterModel, poses: Poses, begin: float
    ) -> None:
        self._poses, self._speed = poses, emitter.speed
        self._period = spec.spacing / emitter.speed  # time between layers [s]
        opens: Sequence[Sequence[float]] = emitter.opens or [(begin, math.inf)]
        self._spans = [(max(a, begin), b) for a, b in opens]
        self._layer_points = self._layer_positions(spec, emitter)

    def _layer_positions(
        self, spec: FluidModel, emitter: FluidEmitterModel
    ) -> FloatArray:
        """Return the positions in a layer ``(M, 3)`` [m]."""
        radius = emitter.radius
        width, depth = emitter.size or (2 * (radius or 0.0), 2 * (radius or 0.0))
        counts = [max(round(side / spec.spacing), 1) for side in (width, depth)]
        _check_count(
            spec, float(counts[0]) * counts[1] / MAX_REJECTED_POINTS, "emitters"
        )
        x, z = ((np.arange(count) + 0.5 - count / 2) * spec.spacing for count in counts)
        grid = np.stack(np.meshgrid(x, [0.0], z, indexing="ij"), axis=-1).reshape(-1, 3)
        if radius is None or len(grid) == 1:
            return grid
        return np.asarray(grid[np.linalg.norm(grid, axis=1) < radius])

    def _layer_count(self, span: Sequence[float], t: float) -> int:
        """Return the number of layers released before a time."""
        duration = min(t, span[1]) - span[0]
        return max(math.ceil(duration / self._period - ROUNDING), 0)

    def inflow(
        self, start: float, end: float, gravity: FloatArray, capacity: int
    ) -> Inflow:
        """Return fluid released between two times [s], under gravity ``(3,)``."""
        states, births = [np.zeros((2, 0, 3))], [np.zeros(0)]
        size, missed = len(self._layer_points), 0
        for span in self._spans:
            first_layer, last_layer = (
                self._layer_count(span, start),
                self._layer_count(span, end),
            )
            count = min(last_layer - first_layer, capacity // size)
            missed += (last_layer - first_layer - count) * size
            capacity -= count * size
            if count <= 0:
                continue
            layers = first_layer + np.arange(count)
            times: FloatArray = span[0] + np.float64(self._period) * layers
            states.append(self._released_layers(times, end, gravity))
            births.append(np.repeat(times, size))
        return Inflow(np.concatenate(states, axis=1), np.concatenate(births), missed)

    def _released_layers(
        self, times: FloatArray, end: float, gravity: FloatArray
    ) -> FloatArray:
        """Return layers that were released at ``times``, at ``end`` ``(2, K M, 3)``."""
        poses, earlier_poses = (
            self._poses.at_times(times),
            self._poses.at_times(times - VELOCITY_INTERVAL),
        )
        size, emitter_velocity = (
            len(self._layer_points),
            (poses[:, :3] - earlier_poses[:, :3]) / VELOCITY_INTERVAL,
        )
        rotations, emitter_velocity = (
            np.repeat(poses[:, 3:], size, axis=0),
            np.repeat(emitter_velocity, size, axis=0),
        )
        positions = np.tile(self._layer_points, (len(times), 1))
        outflow = np.broadcast_to([0.0, self._speed, 0.0], positions.shape)
        x = so3.rotate(rotations, positions) + np.repeat(poses[:, :3], size, axis=0)
        v = so3.rotate(rotations, outflow) + emitter_velocity
        elapsed = np.repeat(end - times, size)[:, None]
        return np.stack(
            [x + elapsed * (v + elapsed / 2 * gravity), v + elapsed * gravity]
        )


def has_room(
    points: FloatArray,
    others: FloatArray,
    colliders: Colliders,
    t: float,
    spacing: float,
) -> Any:
    """Return a mask of points ``(M, 3)`` that are far enough from others ``(N, 3)``."""
    from scipy.spatial import cKDTree

    mask = np.ones(len(points), bool)
    if not len(points):
        return mask
    low, high = points.min(axis=0) - spacing, points.max(axis=0) + spacing
    neighbours = others[((others >= low) & (others <= high)).all(axis=1)]
    if len(neighbours):
        gaps, _ = cKDTree(neighbours).query(points)
        mask = gaps >= MIN_INFLOW_DISTANCE * spacing
    if colliders.rigid:
        gaps = colliders.volumes.sample(points, t).distances
        mask = mask & (gaps >= 0).all(axis=0)
    return mask
