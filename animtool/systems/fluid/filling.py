"""Initial fluid, and inflow of emitters."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, Refusals, counted, refuse, warning
from animtool.core.quantities import floored, plain
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.sim.colliders import Capsule, Collider, Colliders, Poses, Sphere
from animtool.sim.colliders.shapes import bounds
from animtool.systems.fluid.spec import FillModel, FluidEmitterModel, FluidModel

# Largest number of tried lattice points for each kept one.
SPARSE = 8
# Closer particles count as coincident, in spacings.
MIN_SPACING = 0.25
# Least distance of inflow to other particles, in spacings.
ROOM = 0.6
# Rounding tolerance of a radius, or of the time between layers.
ROUNDING = 1e-6
# Radius in spacings above which a drop's tension is right within 10 %.
RESOLVED = 5.0
# Radius of a jet's drops over the jet's (Rayleigh 1879).
JET = 1.89
# Interval for measuring the motion of a nozzle [s].
BRIEF = 1e-4


def filled(
    spec: FluidModel, parts: Sequence[Mapping[str, Any]], colliders: Colliders, t: float
) -> FloatArray:
    """Return positions and velocities of the initial fluid ``(2, N, 3)``.

    Raises:
        OptionError: A fill is too large, has nothing, or begins where it cannot be
            (SIM064).
    """
    fills, refusals = [np.zeros((2, 0, 3))], Refusals()
    for i, part in enumerate(parts):
        with refusals.collect():
            fills.append(_filled(spec, i, part, colliders, t))
    refusals.check()
    state = np.concatenate(fills, axis=1)
    _check_count(spec, state.shape[1], "fills")
    _check_distinct(spec, state[0], np.cumsum([one.shape[1] for one in fills[1:]]))
    return state


def coarse_drops(
    spec: FluidModel, parts: Sequence[Mapping[str, Any]]
) -> Iterator[Fault]:
    """Yield drops with too few particles for surface tension (SIM175)."""
    if not spec.tension:
        return
    radii = [
        (_named(spec, i), float(np.diff(bounds(part["shape"]), axis=0).min()) / 2)
        for i, part in enumerate(parts)
        if isinstance(part.get("shape"), Sphere | Capsule)
    ]
    nozzles = [one.radius for one in spec.emitters if one.radius is not None]
    radii += [(f"a drop of nozzle {i}", JET * r) for i, r in enumerate(nozzles)]
    for name, radius in radii:
        count = radius / spec.spacing
        if count >= RESOLVED * (1 - ROUNDING):
            continue
        message = f"{name} has a radius of {radius:.3g} m, {count:.2g} spacings: below "
        message += f"{RESOLVED:g}, surface tension may be off by a tenth or more"
        hint = f"spacing: {plain(floored(radius / RESOLVED))}"
        yield warning("SIM175", message, hint, "spacing")
        return


def _filled(
    spec: FluidModel, i: int, part: Mapping[str, Any], colliders: Colliders, t: float
) -> FloatArray:
    """Return positions and velocities of one fill ``(2, N, 3)``."""
    name, fill = _named(spec, i), spec.fills[i]
    if part.get("points") is not None:
        state = _points_of_file(fill, part, name)
        _check_outside(state[0], colliders, t, name)
        return state
    points = _lattice(spec, part["shape"], part["poses"], t)
    if colliders.rigid:
        gaps = colliders.volumes.sample(points, t).distances.min(axis=0)
        points = points[gaps >= (1 - ROUNDING) * spec.spacing / 2]
    if not len(points):
        message = f"{name} has no particles: it is thinner than the spacing of "
        message += f"{spec.spacing:g} m, or inside colliders"
        refuse("SIM064", message, "fills", "use a smaller spacing, or a larger fill")
    speeds = np.broadcast_to(np.asarray(fill.velocity, np.float64), points.shape)
    return np.stack([points, speeds])


def _named(spec: FluidModel, i: int) -> str:
    return repr(spec.fills[i].name) if spec.fills[i].name else f"fill {i}"


def _points_of_file(fill: FillModel, part: Mapping[str, Any], name: str) -> FloatArray:
    """Return positions and velocities from arrays ``(2, N, 3)``."""
    points, velocities = part["points"], part.get("velocities")
    if velocities is None:
        velocities = np.broadcast_to(np.array(fill.velocity), (len(points), 3))
    for what, array in (("points", points), ("velocities", velocities)):
        shape = (len(points), 3)
        if array.shape != shape:
            message = f"{what} of {name} have shape {array.shape}, not {shape}"
            refuse("SIM064", message, "fills")
        bad = ~np.isfinite(array).all(axis=1)
        if bad.any():
            i = int(np.argmax(bad))
            refuse("SIM064", f"{what} of {name}: row {i} is not finite", "fills")
    return np.stack([points, velocities])


def _check_outside(
    points: FloatArray, colliders: Colliders, t: float, name: str
) -> None:
    """Refuse points inside colliders, or outside a container."""
    if not colliders.rigid or not len(points):
        return
    gaps = colliders.volumes.sample(points, t).distances
    within = gaps < 0
    if not within.any():
        return
    c, i = (int(k) for k in np.argwhere(within)[0])
    bodies = [one for system in colliders.bodies for one in system.colliders]
    collider = [*colliders, *bodies][c]
    what = repr(collider.name) if collider.name else f"colliders[{c}]"
    where = "outside the container" if collider.container else "inside"
    message = f"particle {i} of {name} starts {-gaps[c, i]:g} m {where} {what}"
    more = int(within.any(axis=0).sum()) - 1
    message += f", and {counted(more, 'other')} start in colliders too" if more else ""
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
    one, other = sorted(pairs[np.lexsort(pairs.T[::-1])[0]].tolist())
    names = []
    for i in (one, other):
        k = int(np.searchsorted(ends, i, side="right"))
        begin = int(ends[k - 1]) if k else 0
        names.append(f"particle {i - begin} of {_named(spec, k)}")
    gap = float(np.linalg.norm(points[one] - points[other]))
    message = f"{names[0]} and {names[1]} start {gap:g} m apart, but the spacing is "
    message += f"{spec.spacing:g} m"
    refuse(
        "SIM064", message, "fills", "keep fills from overlapping, and remove duplicates"
    )


def _check_count(spec: FluidModel, count: float, key: str) -> None:
    if count > spec.max_particles:
        message = f"it needs {count:,.0f} particles at a spacing of {spec.spacing:g} "
        message += f"m, but the limit is {spec.max_particles:,}"
        wider = spec.spacing * (count / spec.max_particles) ** (1 / 3)
        hint = f"spacing: {math.ceil(wider * 1e3) / 1e3:g}, or raise max_particles"
        refuse("SIM064", message, key, hint)


def _lattice(spec: FluidModel, shape: Any, poses: Poses, t: float) -> FloatArray:
    """Return lattice points inside a shape ``(N, 3)`` [m]."""
    low, high = bounds(shape)
    sizes = np.maximum(np.round((high - low) / spec.spacing), 1.0)
    _check_count(spec, float(np.prod(sizes)) / SPARSE, "fills")
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
    missed: int  # number that found no room


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
        wide, deep = emitter.size or (2 * (radius or 0.0), 2 * (radius or 0.0))
        counts = [max(round(side / spec.spacing), 1) for side in (wide, deep)]
        _check_count(spec, float(counts[0]) * counts[1] / SPARSE, "emitters")
        x, z = ((np.arange(count) + 0.5 - count / 2) * spec.spacing for count in counts)
        grid = np.stack(np.meshgrid(x, [0.0], z, indexing="ij"), axis=-1).reshape(-1, 3)
        if radius is None or len(grid) == 1:
            return grid
        return np.asarray(grid[np.linalg.norm(grid, axis=1) < radius])

    def _layer_count(self, span: Sequence[float], t: float) -> int:
        """Return the number of layers released before a time."""
        lasts = min(t, span[1]) - span[0]
        return max(math.ceil(lasts / self._period - ROUNDING), 0)

    def inflow(self, after: float, until: float, pull: FloatArray, room: int) -> Inflow:
        """Return fluid released between two times [s], under gravity ``(3,)``."""
        states, births = [np.zeros((2, 0, 3))], [np.zeros(0)]
        size, missed = len(self._layer_points), 0
        for span in self._spans:
            first, last = self._layer_count(span, after), self._layer_count(span, until)
            kept = min(last - first, room // size)
            missed += (last - first - kept) * size
            room -= kept * size
            if kept <= 0:
                continue
            layers = first + np.arange(kept)
            times: FloatArray = span[0] + np.float64(self._period) * layers
            states.append(self._layers(times, until, pull))
            births.append(np.repeat(times, size))
        return Inflow(np.concatenate(states, axis=1), np.concatenate(births), missed)

    def _layers(self, times: FloatArray, until: float, pull: FloatArray) -> FloatArray:
        """Return layers released at given times, at a later one ``(2, K M, 3)``."""
        now, before = self._poses.at_times(times), self._poses.at_times(times - BRIEF)
        size, emitter_velocity = (
            len(self._layer_points),
            (now[:, :3] - before[:, :3]) / BRIEF,
        )
        rotations, emitter_velocity = (
            np.repeat(now[:, 3:], size, axis=0),
            np.repeat(emitter_velocity, size, axis=0),
        )
        positions = np.tile(self._layer_points, (len(times), 1))
        outflow = np.broadcast_to([0.0, self._speed, 0.0], positions.shape)
        x = so3.rotate(rotations, positions) + np.repeat(now[:, :3], size, axis=0)
        v = so3.rotate(rotations, outflow) + emitter_velocity
        since = np.repeat(until - times, size)[:, None]
        return np.stack([x + since * (v + since / 2 * pull), v + since * pull])


def has_room(
    points: FloatArray, others: FloatArray, colliders: Colliders, t: float, space: float
) -> Any:
    """Return which points ``(M, 3)`` keep a distance from others ``(N, 3)``."""
    from scipy.spatial import cKDTree

    kept = np.ones(len(points), bool)
    if not len(points):
        return kept
    low, high = points.min(axis=0) - space, points.max(axis=0) + space
    near = others[((others >= low) & (others <= high)).all(axis=1)]
    if len(near):
        gaps, _ = cKDTree(near).query(points)
        kept = gaps >= ROOM * space
    if colliders.rigid:
        gaps = colliders.volumes.sample(points, t).distances
        kept = kept & (gaps >= 0).all(axis=0)
    return kept
