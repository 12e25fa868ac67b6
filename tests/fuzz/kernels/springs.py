"""Springs and strands."""

from __future__ import annotations

from typing import Any

import numpy as np

from animtool import _kernels
from fuzz.kernels import Maker
from fuzz.kernels.colliders import colliders as any_colliders
from fuzz.kernels.colliders import mesh
from fuzz.kernels.curves import rotations

Rng = np.random.Generator

# Large enough for springs in bands, and small enough for a millisecond.
_ROWS, _SOME = 6, 8


class Cloth:
    """A sheet of particles with springs, some held and some drawn.

    Attributes:
        points: ``(N, 3)``.
        ends: Of springs ``(S, 2)``.
        arguments: Of the network.
    """

    def __init__(self, rng: Rng) -> None:
        wide, high = (int(n) for n in rng.integers(1, _ROWS, 2))
        number = np.arange(wide * high).reshape(high, wide)
        count = number.size
        x, y = np.meshgrid(np.arange(wide), np.arange(high))
        flat = np.stack([x.ravel(), y.ravel(), np.zeros(count)], axis=1)
        self.points = 0.1 * flat + rng.normal(scale=0.02, size=(count, 3))
        pairs = [
            np.stack([number[:, :-1], number[:, 1:]], axis=-1).reshape(-1, 2),
            np.stack([number[:-1], number[1:]], axis=-1).reshape(-1, 2),
        ]
        ends = np.concatenate(pairs)
        order = _kernels.spring_order(ends, count)
        self.ends = np.ascontiguousarray(ends[order])
        corners = (number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:])
        a, b, c, d = (each.ravel() for each in corners)
        faces = np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])
        self.arguments = self._arguments(rng, faces)

    def _arguments(self, rng: Rng, faces: Any) -> dict[str, Any]:
        count, springs = len(self.points), len(self.ends)
        held, anchors = (rng.permutation(count)[: rng.integers(3)] for _ in range(2))
        knots = np.sort(rng.uniform(0, 0.1, int(rng.integers(1, 5))))
        inverse = rng.uniform(1, 100, count)
        inverse[held] = 0
        air = rng.choice([0.0, 0.6], 2).tolist()
        return {
            "inverse_masses": inverse,
            "drags": rng.uniform(0, 1, count),
            "ends": self.ends,
            "rest": rng.uniform(0.05, 0.15, springs),
            "stiffness": 10.0 ** rng.uniform(0, 4, springs),
            "damping": rng.choice([0.0, 0.1], springs),
            "limit": np.full(springs, rng.choice([np.inf, 0.2])),
            "triangles": faces,
            "gravity": np.array([0, -9.81, 0]),
            "air_drag": air[0],
            "air_lift": air[1],
            "knots": knots,
            "pinned": held,
            "pinned_path": self._path(rng, knots, held),
            "anchors": anchors,
            "anchor_stiffness": rng.uniform(0, 100, len(anchors)),
            "anchor_damping": rng.uniform(0, 100, len(anchors)),
            "anchor_path": self._path(rng, knots, anchors),
            "winds": rng.normal(size=(rng.choice([1, len(knots)]), 1, 3)),
        }

    def _path(self, rng: Rng, knots: Any, particles: Any) -> Any:
        rows = int(rng.choice([1, len(knots)]))
        ways = rng.normal(scale=0.1, size=(rows, 1, 3))
        return self.points[particles][None] + ways

    def network(self) -> Any:
        """Return what kernels step."""
        return _kernels.SpringNetwork(**self.arguments)

    def layers(self) -> Any:
        """Return what keeps it apart from itself."""
        return _kernels.SpringLayers(self.network(), self.points, 0.05, 0.2, 0.2)

    def state(self, rng: Rng) -> Any:
        """Return positions and velocities ``(2, N, 3)``."""
        return np.stack([self.points, rng.normal(size=self.points.shape)])

    def torn(self, rng: Rng) -> Any:
        """Return which springs are ``(S,)``."""
        return (rng.random(len(self.ends)) < rng.choice([0, 0.1])).astype(np.uint8)


def _met(rng: Rng, cells: int, particles: int, *, surfaces: bool) -> Any:
    """Return colliders over cells of time, or None."""
    if rng.integers(2):
        return None
    arrays = any_colliders(rng)
    count = len(arrays[0])
    poses = np.zeros((cells, count, 2, 7))
    poses[..., :3] = rng.normal(size=(count, 1, 3)) - [0, 1, 0]
    poses[..., 3:] = rotations(rng, count)[:, None]
    depths = -rng.uniform(0, 0.1, (count, particles)) if rng.integers(2) else None
    moving = []
    if surfaces and cells and rng.integers(2):
        made = mesh(rng)
        lasts = int(rng.integers(1, 3))
        first = int(rng.integers(lasts))
        knots = -(-(first + cells) // lasts) + 1
        points = np.tile(made["points"], (knots, 1, 1))
        numbers = [0.1, 0.3, 0.0, 1.0, 200.0]
        moving.append((_kernels.MeshSurface(**made), points, numbers, lasts, first))
    return arrays, poses, 0.01, depths, 1e-6, moving


def _cells(rng: Rng, cloth: Cloth) -> dict[str, Any]:
    cells = int(rng.integers(0, 4))
    return {
        "network": cloth.network(),
        "state": cloth.state(rng),
        "is_torn": cloth.torn(rng),
        "origin": float(rng.choice([0.0, -0.1])),
        "first_interval": int(rng.integers(3)),
        "interval_duration": 1 / 240,
        "interval_count": cells,
        "substeps": int(rng.integers(1, _SOME)),
        "colliders": _met(rng, cells, len(cloth.points), surfaces=True),
    }


def _network(rng: Rng) -> dict[str, Any]:
    return Cloth(rng).arguments


def _lead(rng: Rng) -> dict[str, Any]:
    cloth = Cloth(rng)
    paths = {
        name: cloth.arguments[name].copy() for name in ("pinned_path", "anchor_path")
    }
    return {"self": cloth.network(), **paths}


def _layers(rng: Rng) -> dict[str, Any]:
    cloth = Cloth(rng)
    return {
        "network": cloth.network(),
        "rest_positions": cloth.points,
        "thickness": 0.05,
        "friction": 0.2,
        "separation_speed": 0.2,
    }


def _least(rng: Rng) -> dict[str, Any]:
    cloth = Cloth(rng)
    while not len(cloth.arguments["triangles"]):
        cloth = Cloth(rng)
    return {"self": cloth.layers(), "triangle": 0, "particle": 1}


def _least_of_edges(rng: Rng) -> dict[str, Any]:
    cloth = _least(rng)
    return {"self": cloth["self"], "first": 0, "second": int(rng.integers(2))}


def _part(rng: Rng) -> dict[str, Any]:
    cloth = Cloth(rng)
    return {
        "network": cloth.network(),
        "layers": cloth.layers(),
        "before": cloth.points,
        "after": cloth.state(rng),
        "h": 0.01,
    }


def _pierced(rng: Rng) -> dict[str, Any]:
    cloth = Cloth(rng)
    return {"positions": cloth.points, "triangles": cloth.arguments["triangles"]}


def _order(rng: Rng) -> dict[str, Any]:
    cloth = Cloth(rng)
    return {"ends": cloth.ends, "particles": len(cloth.points)}


def _accelerations(rng: Rng) -> dict[str, Any]:
    cloth = Cloth(rng)
    return {
        "network": cloth.network(),
        "t": float(rng.uniform(-0.1, 0.2)),
        "h": 1e-6,
        "state": cloth.state(rng),
        "is_torn": cloth.torn(rng),
    }


def _energy(rng: Rng) -> dict[str, Any]:
    cloth = Cloth(rng)
    return {"network": cloth.network(), "positions": cloth.points}


def _step(rng: Rng) -> dict[str, Any]:
    return _cells(rng, Cloth(rng))


def _project(rng: Rng) -> dict[str, Any]:
    cloth = Cloth(rng)
    layers = cloth.layers() if rng.integers(2) else None
    made = {**_cells(rng, cloth), "layers": layers}
    crossed = np.zeros((0, 3), np.int64)
    if layers is not None and len(cloth.arguments["triangles"]):
        crossed = np.array([[0, 0, 1], [len(cloth.points), 1, -1]])
    steps = {
        "low_strain_count": 0,
        "min_substeps": 1,
        "max_substeps": 16,
        "repeat_strain": 0.01,
        "initial_intersections": crossed,
    }
    return {**made, **steps}


def _solve(rng: Rng) -> dict[str, Any]:
    cloth = Cloth(rng)
    before = cloth.state(rng) if rng.integers(2) else None
    others = {
        "earlier_state": before,
        "uses_bdf2": bool(rng.integers(2)),
        "tolerance": 1e-6,
    }
    return {**_cells(rng, cloth), "substeps": int(rng.integers(1, 3)), **others}


def _strands(rng: Rng) -> dict[str, Any]:
    strands, points = int(rng.integers(1, 10)), int(rng.integers(1, 8))
    return {
        "rests": rng.uniform(0.05, 0.1, (strands, points - 1)),
        "folds": rng.uniform(0.1, 0.2, (strands, max(points - 2, 0))),
        "gravity": np.array([0, -9.81, 0]),
        "drag": 0.5,
        "stiffness": 1e12,
        "fold_stiffness": float(rng.choice([0.0, 150.0])),
        "draw_stiffness": float(rng.choice([0.0, 150.0])),
        "draw_damping": 2.0,
        "stretch": 0.05,
    }


def _follow(rng: Rng) -> dict[str, Any]:
    made, cells = _strands(rng), int(rng.integers(1, 4))
    shape = (*np.add(made["rests"].shape, (0, 1)), 3)
    points = np.cumsum(rng.normal(scale=0.05, size=shape), axis=1).reshape(-1, 3)
    ways = np.arange(cells + 1)[:, None, None] * rng.normal(scale=0.1, size=3)
    return {
        "strands": _kernels.SpringStrands(**made),
        "targets": points + ways,
        "state": np.stack([points, rng.normal(size=points.shape)]),
        "frame_duration": 1 / 24,
        "substeps": int(rng.integers(1, _SOME)),
        "colliders": _met(rng, cells, len(points), surfaces=False),
        "thread_count": int(rng.integers(1, 3)),
    }


CALLS: dict[str, Maker] = {
    "SpringNetwork": _network,
    "SpringNetwork.set_paths": _lead,
    "SpringLayers": _layers,
    "SpringLayers.distance": _least,
    "SpringLayers.edge_distance": _least_of_edges,
    "SpringStrands": _strands,
    "follow_strands": _follow,
    "part_springs": _part,
    "pierced_edges": _pierced,
    "spring_order": _order,
    "spring_accelerations": _accelerations,
    "spring_energy": _energy,
    "step_springs": _step,
    "project_springs": _project,
    "solve_springs": _solve,
}
# Explicit steps of stiff springs blow up; the caller looks for that.
UNBOUNDED: frozenset[str] = frozenset({"step_springs"})
