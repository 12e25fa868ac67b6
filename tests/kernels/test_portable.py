"""Processors with and without registers of four doubles give the same bytes."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from animtool import _kernels
from animtool.sim.colliders import Capsule, Collider, Colliders, Sphere
from animtool.systems.springs.body import PrescribedMotion, SpringForces, Springs

HELD = np.array([0, 7])
PARTICLES = 111
NOBODY = np.zeros((0, 3), np.int64)


def network(rng: np.random.Generator) -> tuple[Any, int]:
    """Return a chain in bands of springs, two held, some twice, and springs alone."""
    count = 71
    ends = [np.arange(count - k)[:, None] + [0, k] for k in (1, 2, 9)]
    alone = np.arange(count, PARTICLES).reshape(-1, 2)
    ends = np.concatenate([*ends, ends[0][:3], [[0, 50], [20, 64]], alone])
    ends = np.ascontiguousarray(ends[_kernels.spring_order(ends, PARTICLES)])
    numbers = rng.uniform(0.5, 2, (len(ends), 4)) * [1, 90, 1, np.inf]
    weights = rng.uniform(0.5, 2, PARTICLES)
    weights[HELD] = 0
    drags, places = rng.uniform(0, 1, PARTICLES), rng.normal(size=(1, 2, 3))
    made, gravity = Springs(ends, *numbers.T.copy()), np.array([0.1, -0.2, -9.81])
    loads = SpringForces(weights, drags, made, NOBODY, gravity, (0.0, 0.0), HELD)
    paths = PrescribedMotion(
        np.zeros(1), places, np.zeros((1, 0, 3)), np.zeros((1, 1, 3))
    )
    return loads.network(paths), len(ends)


def springs(rng: np.random.Generator) -> list[np.ndarray]:
    made, count = network(rng)
    state = rng.normal(size=(2, PARTICLES, 3))
    state[0, [33, 79]] = state[0, [34, 80]]
    state[1, [79, 80]] = 0
    torn = np.zeros(count, np.uint8)
    rates = _kernels.spring_accelerations(made, 0.0, 1e-3, state, torn)
    # A spring that is gone leaves its band, and what is left of it goes one by one.
    torn[5] = 1
    one = _kernels.spring_accelerations(made, 0.0, 1e-3, state, torn)
    stepped = _kernels.step_springs(made, state, torn, 0.0, 0, 0.01, 2, 3, None)[0]
    projected = _kernels.project_springs(
        made, state, torn, 0.0, 0, 0.01, 2, 3, 0, 1, 4, 0.5, None, None, NOBODY
    )[0]
    return [rates, one, stepped, projected]


def flocks(rng: np.random.Generator) -> list[np.ndarray]:
    x, v = rng.uniform(0, 4, (301, 3)), rng.normal(size=(301, 3))
    pull, far, open_ = np.array([0.8, 1.0]), np.array([0.8, 9.0]), np.zeros((2, 3))
    return [
        _kernels.flock_accelerations(
            x, v, None, None, 1.0, cosine, 0, radii, radii, pull, 0.1, open_, 1e9
        )[0]
        for cosine, radii in ((-0.5, pull), (-1.0, far))
    ]


def bodies(rng: np.random.Generator) -> list[np.ndarray]:
    x, masses = rng.normal(size=(1501, 3)), rng.uniform(0.1, 2, 1501)
    return [
        array
        for accuracy in (0.0, 1e-3)
        for array in _kernels.gravity(x, masses, 0.7, 0.02, accuracy)
    ]


def molecules(rng: np.random.Generator) -> list[np.ndarray]:
    box, count = np.array([5.0, 6.0, 7.0]), 211
    x = rng.uniform(-3, 9, (count, 3))
    kinds = rng.integers(0, 2, count).astype(np.int32)
    laws = np.array([[[1e-3, 1e-2], [2e-3, 1e-2]], [[2e-3, 1e-2], [1e-3, 3e-2]]])
    pairs = _kernels.molecule_pairs(x, box, 2.4, 10**6)
    found: list[np.ndarray] = list(pairs)
    for laws_of, kinds_of, charges in (
        (laws, kinds, rng.normal(size=count)),
        (laws[:1, :1].copy(), 0 * kinds, None),
    ):
        for onset in (1.5, 2.0):
            forces, energies, virial = _kernels.molecule_forces(
                x, *pairs, box, kinds_of, laws_of, charges, 2.0, onset, 0.3
            )
            found += [forces, energies, np.array(virial)]
    return found


def fluids(rng: np.random.Generator) -> list[np.ndarray]:
    x = np.stack(np.meshgrid(*[np.arange(7.0)] * 3), axis=-1).reshape(-1, 3)
    state = np.stack(
        [0.1 * x + rng.uniform(0, 0.03, x.shape), rng.normal(size=x.shape)]
    )
    pull, ball = np.tile([0.0, -9.81, 0.0], (len(x), 1)), Collider(Sphere(0.25))
    return [
        array
        for tension in (0.0, 0.4)
        for array in _kernels.fluid_steps(
            Colliders([ball]).kernel_arrays(0.0, 0.01), np.full(1, -1, np.int32),
            np.zeros((0, 13)), state, pull, 0.1, 1000.0, 0.01, tension, 30.0, 0.01, 5,
        )[:2]
    ]  # fmt: skip


def strands(rng: np.random.Generator) -> list[np.ndarray]:
    places = np.cumsum(rng.uniform(-0.02, 0.03, (6, 7, 3)), axis=1)
    rests = np.linalg.norm(np.diff(places, axis=1), axis=-1)
    folds = np.linalg.norm(places[:, 2:] - places[:, :-2], axis=-1)
    made = _kernels.SpringStrands(
        rests, folds, np.array([0.0, -9.81, 0]), 0.5, 1e12, 150.0, 150.0, 7.0, 0.01,
    )  # fmt: skip
    flat = places.reshape(-1, 3)
    goal = flat + np.linspace(0, 1, 5)[:, None, None] * [0.01, 0.02, -0.01]
    rods = Colliders([Collider(Capsule(0.03, 0.1), friction=0.3)]).kernel_arrays(
        0.0, 0.0
    )
    poses = np.tile([0.02, -0.01, 0.01, 0, 0, 0, 1], (4, 1, 2, 1))
    poses[..., 0] += np.linspace(0, 0.02, 4)[:, None, None]
    colliders = rods, poses, 0.0, None, 1e-6, []
    state = np.stack([flat, rng.normal(size=flat.shape)])
    found, *counts = _kernels.follow_strands(made, goal, state, 1 / 24, 5, colliders)
    assert counts[0] > 0
    return [found, np.array(counts)]


def skins(rng: np.random.Generator) -> list[np.ndarray]:
    joints = rng.integers(0, 5, 50).astype(np.int32)
    first = np.array([0, 3, 3, 11, 50])
    results = []
    for frames in (1, 2, 7):
        moves = rng.normal(size=(frames, 5, 3, 4))
        weights = rng.uniform(-0.2, 1, 50)
        for rests in {1, frames}:
            points = rng.normal(size=(rests, 4, 3))
            for normalize in (False, True):
                out = np.zeros((frames, 4, 3))
                _kernels.skin_linear(
                    points, first, joints, weights, moves, normalize, out
                )
                results.append(out)
    return results


def digests() -> dict[str, list[str]]:
    kinds: list[Callable[[np.random.Generator], list[np.ndarray]]] = [
        springs, strands, skins, flocks, fluids, bodies, molecules,
    ]  # fmt: skip
    return {
        kind.__name__: [
            hashlib.sha256(array.tobytes()).hexdigest()
            for array in kind(np.random.default_rng(1))
        ]
        for kind in kinds
    }


def test_processors_give_the_same_bytes() -> None:
    found = subprocess.run(
        [sys.executable, __file__],
        env={**os.environ, "ANIMTOOL_PORTABLE": "1"},
        check=True,
        capture_output=True,
        text=True,
    )
    assert json.loads(found.stdout) == digests()


if __name__ == "__main__":
    sys.stdout.write(json.dumps(digests()))
