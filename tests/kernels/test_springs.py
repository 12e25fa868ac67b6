"""Loops over springs: their order, and what they do in it."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from animtool import _kernels
from animtool.systems.springs.body import (
    PrescribedMotion,
    SpringForces,
    Springs,
    TargetSprings,
)

CALM = (0.0, 0.0)
NO_FACES = np.zeros((0, 3), np.int64)
SEEDS = st.integers(0, 2**31)


def random_ends(seed: int) -> tuple[np.ndarray, int]:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 60))
    ends = rng.integers(0, count, (int(rng.integers(0, 200)), 2))
    return ends[ends[:, 0] != ends[:, 1]], count


@given(SEEDS)
def test_springs_that_share_a_particle_keep_their_order(seed: int) -> None:
    ends, count = random_ends(seed)
    order = _kernels.spring_order(ends, count)
    assert sorted(order.tolist()) == list(range(len(ends)))
    low, high = np.sort(ends, axis=1).T
    place = np.argsort(order)
    for particle in range(count):
        mine = np.flatnonzero((ends == particle).any(axis=1))
        by_particles = mine[np.lexsort((mine, high[mine], low[mine]))]
        assert (np.diff(place[by_particles]) > 0).all()


@given(SEEDS)
def test_the_order_is_of_the_springs_and_not_of_their_list(seed: int) -> None:
    ends, count = random_ends(seed)
    ends = np.unique(np.sort(ends, axis=1), axis=0)
    mixed = np.random.default_rng(seed).permutation(len(ends))
    one = ends[_kernels.spring_order(ends, count)]
    other = ends[mixed][_kernels.spring_order(ends[mixed], count)]
    assert one.tolist() == other.tolist()


def random_springs(ends: np.ndarray, rng: np.random.Generator) -> Springs:
    """Return springs that never tear."""
    rest, stiffness, damping, _ = rng.uniform(0.5, 2, (len(ends), 4)).T.copy()
    return Springs(ends, rest, stiffness, damping, np.full(len(ends), np.inf))


def network(ends: np.ndarray, count: int, rng: np.random.Generator) -> object:
    springs, nowhere = random_springs(ends, rng), np.zeros((1, 0, 3))
    weights, still = rng.uniform(0.5, 2, count), np.zeros(3)
    loads = SpringForces(weights, np.zeros(count), springs, NO_FACES, still, CALM)
    return loads.network(
        PrescribedMotion(np.zeros(1), nowhere, nowhere, np.zeros((1, 1, 3)))
    )


def projected(ends: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Return where one step of each spring in its order leads, in plain numpy."""
    rng = np.random.default_rng(seed)
    numbers = rng.uniform(0.5, 2, (len(ends), 4))
    weights = rng.uniform(0.5, 2, count)
    x, v = rng.normal(size=(2, count, 3))
    h, before = 0.01, x.copy()
    x = x + h * v
    for (i, j), (rest, k, c, _) in zip(ends, numbers, strict=True):
        d = x[j] - x[i]
        length = np.linalg.norm(d)
        u, whole = d / length, (k * h * h + c * h) * (weights[i] + weights[j]) + 1
        went = u @ (d - (before[j] - before[i]))
        pull = (k * h * h * (length - rest) + c * h * went) / whole
        x[i] += weights[i] * pull * u
        x[j] -= weights[j] * pull * u
    return np.stack([x, (x - before) / h])


@given(SEEDS)
def test_springs_are_projected_one_after_the_other(seed: int) -> None:
    ends, count = random_ends(seed)
    ends = np.ascontiguousarray(ends[_kernels.spring_order(ends, count)])
    rng = np.random.default_rng(seed)
    made = network(ends, count, rng)
    state = rng.normal(size=(2, count, 3))
    found = _kernels.project_springs(
        made,
        state,
        np.zeros(len(ends), np.uint8),
        0.0,
        0,
        0.01,
        1,
        1,
        0,
        1,
        1,
        np.inf,
        None,
        None,
        np.zeros((0, 3), np.int64),
    )[0]
    np.testing.assert_allclose(found, projected(ends, count, seed), atol=1e-9)


def banded_ends(seed: int) -> tuple[np.ndarray, int]:
    """Return springs that mostly lie a few places on, some missing, some twice."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 700))
    parts = [random_ends(seed)[0] % count]
    for offset in rng.integers(1, 40, int(rng.integers(0, 5))).tolist():
        first = np.arange(int(rng.integers(0, 60)), count - offset)
        first = first[rng.random(len(first)) < rng.uniform(0.3, 1.1)]
        parts.append(np.stack([first, first + offset], axis=1))
    ends = np.concatenate(parts)
    swapped = rng.random(len(ends)) < 0.5
    ends[swapped] = ends[swapped, ::-1]
    return np.ascontiguousarray(ends[ends[:, 0] != ends[:, 1]]), count


def pulled(
    ends: np.ndarray, count: int, seed: int, torn: np.ndarray, state: np.ndarray
) -> np.ndarray:
    """Return accelerations in plain numpy."""
    rng = np.random.default_rng(seed)
    numbers = rng.uniform(0.5, 2, (len(ends), 4))[torn == 0]
    weights = rng.uniform(0.5, 2, count)
    i, j = ends[torn == 0].T
    rest, k, c, _ = numbers.T
    d, e = state[:, j] - state[:, i]
    length = np.linalg.norm(d, axis=1)
    over = np.divide(1, length, out=np.zeros(len(d)), where=length > 0)
    pull = k * (1 - rest * over) + c * np.einsum("sk,sk->s", d, e) * over**2
    forces = np.zeros((count, 3))
    np.add.at(forces, i, pull[:, None] * d)
    np.subtract.at(forces, j, pull[:, None] * d)
    return forces * weights[:, None]


@given(SEEDS)
def test_forces_are_those_of_all_springs_that_are_whole(seed: int) -> None:
    ends, count = banded_ends(seed)
    made = network(ends, count, np.random.default_rng(seed))
    rng = np.random.default_rng(seed + 1)
    state = rng.normal(size=(2, count, 3))
    alike = rng.integers(0, count, 10)
    state[0, alike] = state[0, 0]
    torn = (rng.random(len(ends)) < rng.choice([0, 0.1])).astype(np.uint8)
    found = _kernels.spring_accelerations(made, 0.0, 1e-6, state, torn)
    true = pulled(ends, count, seed, torn, state)
    np.testing.assert_allclose(found, true, rtol=1e-9, atol=1e-9)
    again = _kernels.spring_accelerations(made, 0.0, 1e-6, state, torn)
    assert again.tobytes() == found.tobytes()


def led(ends: np.ndarray, count: int, rng: np.random.Generator) -> tuple[object, dict]:
    """Return springs with pins and targets on their way, in gravity and drag."""
    springs = random_springs(ends, rng)
    held = np.flatnonzero(rng.random(count) < 0.1)
    drawn = np.flatnonzero(rng.random(count) < rng.choice([0, 0.1]))
    weights = rng.uniform(0.5, 2, count)
    weights[held] = 0
    ways = [rng.normal(size=(2, len(some), 3)) for some in (held, drawn)]
    drags = rng.uniform(0, 1, count)
    draws = TargetSprings(drawn, *rng.uniform(0.5, 2, (len(drawn), 2)).T.copy())
    paths = PrescribedMotion(np.array([0.0, 1.0]), *ways, np.zeros((2, 1, 3)))
    gravity = np.array([0, 0, -9.81])
    loads = SpringForces(weights, drags, springs, NO_FACES, gravity, CALM, held, draws)
    return loads.network(paths), {"held": held, "way": ways[0]}


@given(SEEDS, st.sampled_from([(1, 3), (3, 1)]))
def test_explicit_steps_are_those_of_accelerations(
    seed: int, split: tuple[int, int]
) -> None:
    ends, count = banded_ends(seed)
    made, pins = led(ends, count, np.random.default_rng(seed))
    torn = np.zeros(len(ends), np.uint8)
    state = np.random.default_rng(seed + 1).normal(size=(2, count, 3))
    cells, substeps = split
    h = 0.01 / substeps
    found = _kernels.step_springs(
        made, state, torn, 0.0, 0, 0.01, cells, substeps, None
    )[0]
    x, v = state.copy()
    for step in range(cells * substeps):
        t = step * h
        rates = _kernels.spring_accelerations(made, t, h, np.stack([x, v]), torn)
        v = v + h * rates
        before, x = x, x + h * v
        start, end = pins["way"]
        x[pins["held"]] = start + (end - start) * (t + h)
        v[pins["held"]] = (x - before)[pins["held"]] / h
    np.testing.assert_allclose(found, np.stack([x, v]), rtol=1e-9, atol=1e-9)
