"""Members of a flock by those that they see, each pair looked at in numpy too."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from support.suite import examples

from animtool import _kernels

SEEDS = st.integers(0, 2**32 - 1)
OPEN = np.zeros((2, 3))
PULLS = (np.array([0.8, 1.3]), np.array([1.5, 0.9]), np.array([0.2, 0.7]))


def flock(
    x: np.ndarray, v: np.ndarray, /, **changes: Any
) -> tuple[np.ndarray, np.ndarray, float]:
    attraction, alignment, repulsion = PULLS
    arguments = {
        "members": None, "others": None, "radius": 1.3, "cosine": -1.0, "nearest": 0,
        "attraction": attraction, "alignment": alignment, "repulsion": repulsion,
        "softening": 0.1, "period": OPEN, "max_tests": 1e12, **changes,
    }  # fmt: skip
    return _kernels.flock_accelerations(x, v, **arguments)


def pair_by_pair(
    x: np.ndarray, v: np.ndarray, seen: np.ndarray, off: np.ndarray
) -> np.ndarray:
    """Return what members do by those that they see ``(N, N)``, in numpy."""
    far = np.linalg.norm(off, axis=2)
    whole = np.zeros_like(x)
    for (weight, radius), ways in zip(PULLS[:2], (off, v - v[:, None]), strict=True):
        near = seen & (far <= radius)
        count = np.maximum(near.sum(axis=1), 1)[:, None]
        whole += weight * (ways * near[..., None]).sum(axis=1) / count
    weight, radius = PULLS[2]
    push = np.where(seen & (far <= radius), 1 / (far**2 + 0.01), 0)
    return whole - weight * (off * push[..., None]).sum(axis=1)


@given(
    SEEDS,
    st.integers(1, 60),
    st.sampled_from([-1.0, -0.3, 0.5]),
    st.sampled_from([0, 1, 5]),
    st.sampled_from([(0.0, 0.0, 0.0), (5.0, 0.0, 3.0), (2.6, 2.6, 2.6)]),
    st.booleans(),
)
@settings(max_examples=examples(60), deadline=None)
def test_it_is_what_each_pair_says(
    seed: int,
    count: int,
    cosine: float,
    nearest: int,
    size: tuple[float, float, float],
    some: bool,
) -> None:
    rng = np.random.default_rng(seed)
    x = rng.uniform(-3, 3, (count, 3)) * rng.choice([0.2, 1, 30])
    v = rng.normal(size=(count, 3))
    period = np.array([[-1.0, -2, 0.5], size])
    members = np.arange(count, dtype=np.int32)[:: 2 if some else 1]
    others = np.flatnonzero(rng.random(count) < 0.7).astype(np.int32) if some else None
    off = x - x[:, None]
    for k in range(3):
        if size[k]:
            off[..., k] -= size[k] * np.round(off[..., k] / size[k])
    far = np.linalg.norm(off, axis=2)
    seen = (far <= 1.3) & ~np.eye(count, dtype=bool)
    if others is not None:
        seen &= np.isin(np.arange(count), others)
    ahead = (off * v[:, None]).sum(axis=2)
    if cosine > -1:
        seen &= ahead >= cosine * np.linalg.norm(v, axis=1)[:, None] * far
    if nearest:
        order = np.argsort(np.where(seen, far, np.inf), axis=1, kind="stable")
        ranks = np.argsort(order, axis=1)
        seen &= ranks < nearest
    found, counts, looked = flock(
        x, v, members=members if some else None, others=others, cosine=cosine,
        nearest=nearest, period=period,
    )  # fmt: skip
    assert_array_equal(counts, seen.sum(axis=1)[members])
    assert_allclose(found, pair_by_pair(x, v, seen, off)[members], atol=1e-10)
    assert looked >= seen[members].sum()


@pytest.mark.parametrize("count", [0, 1, 2, 500])
def test_all_alike_are_done_pair_by_pair_too(count: int) -> None:
    """Where all do the same by each other, each pair is looked at once."""
    rng = np.random.default_rng(count)
    x, v = rng.uniform(0, 4, (count, 3)), rng.normal(size=(count, 3))
    wide = (np.array([0.8, 9.0]), np.array([1.5, 9.0]))
    one = flock(x, v, attraction=wide[0], alignment=wide[1])
    other = flock(
        x, v, attraction=wide[0], alignment=wide[1],
        members=np.arange(count, dtype=np.int32),
    )  # fmt: skip
    assert_array_equal(one[1], other[1])
    assert_allclose(one[0], other[0], atol=1e-12)
    halves = [
        flock(x, v, attraction=wide[0], alignment=wide[1], members=part)
        for part in np.array_split(np.arange(count, dtype=np.int32), 3)
    ]
    assert_array_equal(np.concatenate([half[0] for half in halves]), other[0])
    # What each does to the other is the same: nothing is won.
    away = flock(x, v, attraction=np.zeros(2), alignment=np.zeros(2))[0]
    assert_allclose(away.sum(axis=0), 0, atol=1e-9)


def test_far_apart_and_all_in_one_place() -> None:
    """Neither takes a table of cells, nor divides by 0."""
    x = np.array([[0, 0, 0], [1e300, -1e300, 1e18], [0.5, 0, 0], [0, 0, 0]], float)
    found, counts, _ = flock(x, np.zeros_like(x))
    assert counts.tolist() == [2, 0, 2, 2]
    assert np.isfinite(found).all()
    assert_array_equal(found[0], found[3])
    x[1] = np.nan
    assert flock(x, np.zeros_like(x))[1].tolist() == [2, 0, 2, 2]


def test_too_many_at_one_place_are_not_looked_at() -> None:
    x = np.zeros((3000, 3))
    found, counts, looked = flock(x, x, max_tests=1000.0)
    assert looked > 1000
    assert found.shape == (3000, 3)
    assert counts.max() <= 3000


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("radius", 0.0),
        ("radius", np.nan),
        ("radius", np.inf),
        ("cosine", 1.5),
        ("cosine", np.nan),
        ("nearest", -1),
        ("softening", -0.1),
        ("attraction", np.array([1.0, -1.0])),
        ("alignment", np.array([np.nan, 1.0])),
        ("repulsion", np.zeros(3)),
        ("members", np.array([4], np.int32)),
        ("others", np.array([-1], np.int32)),
        ("period", np.array([[0.0] * 3, [2.5, 0, 0]])),
        ("period", np.array([[0.0] * 3, [-9.0, 0, 0]])),
        ("period", np.array([[np.nan] * 3, [9.0, 9, 9]])),
    ],
)
def test_what_cannot_be_is_refused_by_its_name(name: str, value: Any) -> None:
    x = np.zeros((4, 3))
    with pytest.raises(ValueError, match=f"^{name}: "):
        flock(x, x, **{name: value})
