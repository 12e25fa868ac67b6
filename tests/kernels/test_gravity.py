"""Sums of gravity: closed forms, all pairs, and what a tree leaves of its budget."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from animtool import _kernels


def disc(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    r, angle = np.sqrt(rng.uniform(0.01, 1, n)), rng.uniform(0, 2 * np.pi, n)
    x = np.stack([r * np.cos(angle), 0.02 * rng.normal(size=n), r * np.sin(angle)], 1)
    masses = np.full(n, 0.1 / n)
    x[0], masses[0] = 0, 1
    return x, masses


def ball(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    r = 1 / np.sqrt(rng.uniform(0.01, 1, n) ** (-2 / 3) - 0.99)
    ways = rng.normal(size=(n, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    return r[:, None] * ways, rng.uniform(0.5, 1.5, n)


def pair_of_balls(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    x, masses = ball(rng, n)
    x[: n // 3] = 0.1 * x[: n // 3] + [30, 5, -8]
    return x, masses


def summed(
    x: np.ndarray, m: np.ndarray, soft: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    off = x[None] - x[:, None]
    squares = (off**2).sum(axis=2)
    np.fill_diagonal(squares, np.inf)
    inverse = (squares + soft**2) ** -0.5
    made = ((m * inverse**3)[:, :, None] * np.where(np.isfinite(off), off, 0)).sum(1)
    rates = ((m + m[:, None]) * inverse**3).max(axis=1)
    return made, -(m * inverse).sum(axis=1), rates


def test_two_bodies_have_the_closed_form() -> None:
    x = np.array([[1.0, 2, 3], [4, 6, 3]])
    found, potentials, rates = _kernels.gravity(x, np.array([2.0, 3]), 0.5, 12, 0)
    assert_allclose(found[0], 0.5 * 3 * np.array([3, 4, 0]) / 13**3, rtol=1e-15)
    assert_allclose(found[1], -0.5 * 2 * np.array([3, 4, 0]) / 13**3, rtol=1e-15)
    assert_allclose(potentials, [-0.5 * 3 / 13, -0.5 * 2 / 13], rtol=1e-15)
    assert_allclose(rates, 0.5 * 5 / 13**3, rtol=1e-15)


@pytest.mark.parametrize("size", [1e-12, 1.0, 1e20])
@pytest.mark.parametrize("soft", [0.0, 0.05])
def test_a_direct_sum_has_all_digits(size: float, soft: float) -> None:
    x, m = ball(np.random.default_rng(1), 203)
    expected, potentials, rates = summed(x, m, soft)
    found = _kernels.gravity(x * size, m, 1.0, soft * size, 0.0)
    assert_allclose(found[0], expected / size**2, rtol=1e-11, atol=0)
    assert_allclose(found[1], potentials / size, rtol=1e-13)
    assert_allclose(found[2], rates / size**3, rtol=1e-13)


def test_momentum_stays_to_the_last_digits() -> None:
    x, m = ball(np.random.default_rng(2), 400)
    found = _kernels.gravity(x, m, 1.0, 0.0, 0.0)[0]
    pulls = m[:, None] * found
    assert np.abs(pulls.sum(axis=0)).max() < 1e-13 * np.abs(pulls).sum()


@pytest.mark.parametrize("make", [disc, ball, pair_of_balls])
@pytest.mark.parametrize("accuracy", [1e-2, 1e-3, 1e-4, 1e-5])
def test_a_tree_keeps_its_budget(make: object, accuracy: float) -> None:
    x, m = make(np.random.default_rng(3), 3000)  # type: ignore[operator]
    exact, potentials, _ = _kernels.gravity(x, m, 1.0, 0.01, 0.0)
    found, others, _ = _kernels.gravity(x, m, 1.0, 0.01, accuracy)
    errors = np.linalg.norm(found - exact, axis=1) / np.linalg.norm(exact, axis=1)
    assert np.sqrt((errors**2).mean()) < 1.5 * accuracy
    assert_allclose(others, potentials, rtol=20 * accuracy)
    assert not np.array_equal(found, exact)


def test_a_tree_sees_the_closest_pairs() -> None:
    x, m = ball(np.random.default_rng(4), 2000)
    x[7] = x[1300] + [1e-7, 0, 0]
    rates = _kernels.gravity(x, m, 1.0, 0.0, 1e-3)[2]
    expected = _kernels.gravity(x, m, 1.0, 0.0, 0.0)[2]
    assert set(np.argsort(rates)[-2:]) == {7, 1300}
    assert_allclose(rates[[7, 1300]], expected[[7, 1300]], rtol=1e-6)


def test_bodies_at_one_place_and_alone_are_finite() -> None:
    x, m = np.ones((500, 3)), np.full(500, 2.0)
    for accuracy in (0.0, 1e-3):
        for soft in (0.0, 0.1):
            for found in _kernels.gravity(x, m, 1.0, soft, accuracy):
                assert_array_equal(found, 0)
    for count in (0, 1):
        found = _kernels.gravity(x[:count], m[:count], 1.0, 0.1, 1e-3)[0]
        assert_array_equal(found, np.zeros((count, 3)))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("points", np.full((2, 3), np.nan)),
        ("masses", np.array([1.0, -1.0])),
        ("masses", np.ones(3)),
        ("constant", -1.0),
        ("softening", np.inf),
        ("accuracy", 0.2),
    ],
)
def test_what_makes_no_sense_is_refused(name: str, value: object) -> None:
    given = {"points": np.eye(2, 3), "masses": np.ones(2), "constant": 1.0}
    given |= {"softening": 0.1, "accuracy": 0.0, name: value}  # type: ignore[dict-item]
    with pytest.raises(ValueError, match=f"^{name}: "):
        _kernels.gravity(**given)
