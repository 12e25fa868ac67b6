"""Rigid bodies: balls, capsules, tetrahedra and boxes, joints between them."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from animtool import _kernels
from fuzz.kernels import Maker
from fuzz.kernels.colliders import colliders
from fuzz.kernels.curves import rotations

Rng = np.random.Generator

_BOX = [
    [1, 3, 7, 5],
    [0, 4, 6, 2],
    [2, 6, 7, 3],
    [0, 1, 5, 4],
    [4, 5, 7, 6],
    [0, 2, 3, 1],
]
_CORNERS = np.array([c[::-1] for c in product((-1.0, 1.0), repeat=3)])
_TETRAHEDRON = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
_SIMPLEX = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
_SHAPES: list[tuple[Any, Any]] = [
    (np.zeros((1, 3)), []),
    (np.array([[0, -0.5, 0], [0, 0.5, 0]]), []),
    (_SIMPLEX, _TETRAHEDRON),
    (_CORNERS, _BOX),
]


def _starts(counts: list[int]) -> Any:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _bodies(rng: Rng) -> dict[str, Any]:
    count = int(rng.integers(1, 7))
    shapes = [_SHAPES[i] for i in rng.integers(0, 4, count)]
    faces = [face for _, own in shapes for face in own]
    joined = min(int(rng.integers(0, 3)), count - 1)
    joints = np.zeros((joined, 3), np.int64)
    joints[:, 0] = rng.integers(0, 4, joined)
    joints[:, 1] = rng.choice([-1, 0], joined)
    joints[:, 2] = 1 + np.arange(joined)
    numbers = np.zeros((joined, 27))
    numbers[:, :3], numbers[:, 7:10] = rng.normal(size=(2, joined, 3))
    for at in (3, 10, 19):
        numbers[:, at : at + 4] = rotations(rng, joined)
    numbers[:, 14:16] = rng.choice([-1.0, 0.5], (joined, 2))
    numbers[:, 16:18] = rng.choice([-1.0, 0.7])
    numbers[:, 23:25] = rng.choice([0.0, 10.0], (joined, 2))
    numbers[:, 25] = rng.choice([-1.0, 3.0])
    numbers[:, 26] = rng.choice([0.0, 2.0])
    corners = [np.array(face) for face in faces]
    return {
        "inertias": np.concatenate(
            [rng.uniform(0.1, 9, (count, 1)), rng.uniform(0.1, 1, (count, 3))], axis=1
        ),
        "bodies": np.arange(count),
        "shape_numbers": np.stack(
            [rng.uniform(0.01, 0.3, count), *rng.uniform(0, 1, (2, count))], axis=1
        ),
        "points": np.concatenate(
            [np.zeros((0, 3)), *(p * rng.uniform(0.1, 1) for p, _ in shapes)]
        ),
        "point_starts": _starts([len(points) for points, _ in shapes]),
        "face_starts": _starts([len(own) for _, own in shapes]),
        "corner_starts": _starts([len(face) for face in faces]),
        "corners": np.concatenate([np.zeros(0, np.int64), *corners]).astype(np.int64),
        "joints": joints,
        "joint_numbers": numbers,
        "excluded_pairs": rng.integers(0, count, (int(rng.integers(0, 3)), 2)),
    }


def _step(rng: Rng) -> dict[str, Any]:
    made = _bodies(rng)
    count, joined = len(made["bodies"]), len(made["joints"])
    state = np.zeros((count, 14))
    state[:, :3] = rng.normal(size=(count, 3))
    state[:, 3:7] = rotations(rng, count)
    state[:, 7:13] = rng.normal(scale=rng.choice([0.0, 5.0]), size=(count, 6))
    state[:, 13] = rng.choice([0.0, 1.0], count)
    touching = min(int(rng.integers(0, 4)), count)
    pairs = np.stack([np.arange(touching), rng.permutation(count)[:touching]], axis=1)
    anchors = np.zeros((joined, 2, 7))
    anchors[..., :3] = rng.normal(size=(joined, 2, 3))
    anchors[..., 3:] = rotations(rng, joined, 2)
    return {
        "bodies": _kernels.RigidBodies(**made),
        "state": state,
        "pairs": pairs,
        "contacts": rng.normal(size=(touching, 6)),
        "joint_impulses": rng.normal(size=(joined, 12)),
        "forces": rng.normal(size=(count, 6)),
        "colliders": colliders(rng),
        "anchors": anchors,
        "step": 0.01,
        # Others, which spoiled numbers have too, blow up where bodies turn by some
        # radians in a small step.
        "method": 0,
        "substeps": int(rng.integers(1, 4)),
        "max_iterations": int(rng.integers(1, 4)),
        "tolerance": 1e-4,
        "sleep_speed": float(rng.choice([0.0, 0.1])),
        "sleep_time": 0.5,
    }


CALLS: dict[str, Maker] = {"RigidBodies": _bodies, "step_rigid": _step}
UNBOUNDED: frozenset[str] = frozenset()
