"""Forces between molecules: all pairs by numpy, images, lists, slopes of energies."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import erfc

from animtool import _kernels

BOX = np.array([6.1, 7.3, 6.7])
CUTOFF, SKIN, DAMPING = 2.5, 0.3, 0.4
LAWS = np.array([[[4.0, 4.0], [3.0, 5.0]], [[3.0, 5.0], [2.0, 1.0]]])


def crystal() -> np.ndarray:
    """Return molecules that are apart, near their sites, from any image."""
    rng = np.random.default_rng(5)
    sites = np.stack(np.meshgrid(*[np.arange(5)] * 3, indexing="ij"), -1)
    x = (sites.reshape(-1, 3) + 0.5) / 5 * BOX + rng.normal(scale=0.1, size=(125, 3))
    return x + BOX * rng.integers(-3, 4, x.shape)


KINDS = np.random.default_rng(6).integers(0, 2, 125).astype(np.int32)
CHARGES = np.random.default_rng(7).normal(size=125)


def by_kernel(
    x: np.ndarray, onset: float, charges: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, float]:
    pairs = _kernels.molecule_pairs(x, BOX, CUTOFF + SKIN, 10**6)
    return _kernels.molecule_forces(
        x, *pairs, BOX, KINDS, LAWS, charges, CUTOFF, onset, DAMPING
    )


def by_numpy(
    x: np.ndarray, onset: float, charges: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, float]:
    off = x[:, None] - x
    off -= BOX * np.round(off / BOX)
    r = np.sqrt((off**2).sum(axis=2))
    np.fill_diagonal(r, 2 * CUTOFF)
    twelve, six = np.moveaxis(LAWS[KINDS[:, None], KINDS], -1, 0)
    energy = twelve / r**12 - six / r**6
    pull = 12 * twelve / r**13 - 6 * six / r**7
    far = np.clip(r, onset, CUTOFF)
    if onset < CUTOFF:
        gap = (CUTOFF**2 - onset**2) ** 3
        left = CUTOFF**2 - far**2
        share = left**2 * (CUTOFF**2 + 2 * far**2 - 3 * onset**2) / gap
        slope = 12 * far * left * (onset**2 - far**2) / gap
        pull = share * pull - slope * energy
        energy = share * energy
    if charges is not None:
        both = charges[:, None] * charges
        bend = 2 * DAMPING / np.sqrt(np.pi)

        def force(r: np.ndarray | float) -> np.ndarray:
            return erfc(DAMPING * r) / r**2 + bend * np.exp(-((DAMPING * r) ** 2)) / r

        rest = erfc(DAMPING * CUTOFF) / CUTOFF - force(CUTOFF) * (r - CUTOFF)
        energy = energy + both * (erfc(DAMPING * r) / r - rest)
        pull = pull + both * (force(r) - force(CUTOFF))
    energy, pull = (np.where(r < CUTOFF, one, 0) for one in (energy, pull))
    forces = ((pull / r)[:, :, None] * off).sum(axis=1)
    return forces, energy.sum(axis=1) / 2, float((pull * r).sum() / 2)


@pytest.mark.parametrize("onset", [2.0, CUTOFF])
@pytest.mark.parametrize("charges", [None, CHARGES])
def test_forces_are_those_of_all_pairs(
    onset: float, charges: np.ndarray | None
) -> None:
    x = crystal()
    found, expected = by_kernel(x, onset, charges), by_numpy(x, onset, charges)
    assert_allclose(found[0], expected[0], atol=1e-12 * np.abs(expected[0]).max())
    assert_allclose(found[1], expected[1], atol=1e-11)
    assert found[2] == pytest.approx(expected[2], rel=1e-12)
    assert np.abs(found[0].sum(axis=0)).max() < 1e-11 * np.abs(found[0]).max()


def test_forces_are_slopes_of_the_energy() -> None:
    x, step = crystal(), 1e-5
    forces = by_kernel(x, 2.0, CHARGES)[0]
    rng = np.random.default_rng(8)
    for _ in range(5):
        way = rng.normal(size=x.shape)
        up, down = (
            by_kernel(x + s * step * way, 2.0, CHARGES)[1].sum() for s in (1, -1)
        )
        assert (up - down) / (2 * step) == pytest.approx(
            -(forces * way).sum(), rel=1e-5, abs=1e-5
        )


def test_a_list_holds_while_nobody_moves_by_half_the_skin() -> None:
    x = crystal()
    pairs = _kernels.molecule_pairs(x, BOX, CUTOFF + SKIN, 10**6)
    rng = np.random.default_rng(9)
    ways = rng.normal(size=x.shape)
    ways *= 0.499 * SKIN / np.linalg.norm(ways, axis=1)[:, None]
    arguments = BOX, KINDS, LAWS, None, CUTOFF, 2.0, DAMPING
    found = _kernels.molecule_forces(x + ways, *pairs, *arguments)[0]
    expected = by_numpy(x + ways, 2.0, None)[0]
    assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


def test_pairs_are_those_within_reach_once_each() -> None:
    x = crystal()
    order, starts, partners = _kernels.molecule_pairs(x, BOX, 2.8, 10**6)
    assert sorted(order) == list(range(125))
    assert not (starts % 4).any()
    found = {
        tuple(sorted((int(order[i]), int(order[j]))))
        for i in range(125)
        for j in partners[starts[i] : starts[i + 1]]
        if j < 125
    }
    off = x[:, None] - x
    off -= BOX * np.round(off / BOX)
    near = np.argwhere(np.triu((off**2).sum(axis=2) <= 2.8**2, 1))
    assert found == {tuple(pair) for pair in near.tolist()}
    assert (partners < 125).sum() == len(near)


def test_what_makes_no_sense_is_refused() -> None:
    x = crystal()
    with pytest.raises(ValueError, match=r"^box: 6.1 is not twice"):
        _kernels.molecule_pairs(x, BOX, 3.1, 10**6)
    with pytest.raises(ValueError, match=r"^points: nan"):
        _kernels.molecule_pairs(np.full((2, 3), np.nan), BOX, 2, 10**6)
    with pytest.raises(ValueError, match=r"^max_pairs: "):
        _kernels.molecule_pairs(x, BOX, 2.5, 10)
    order, starts, partners = _kernels.molecule_pairs(x, BOX, 2.8, 10**6)
    rest = BOX, KINDS, LAWS, None, CUTOFF, 2.0, DAMPING
    with pytest.raises(ValueError, match=r"^partners: "):
        _kernels.molecule_forces(x, order, starts, partners + 1, *rest)
    with pytest.raises(ValueError, match=r"^order: "):
        _kernels.molecule_forces(x, order + 1, starts, partners, *rest)
    with pytest.raises(ValueError, match=r"^starts: "):
        _kernels.molecule_forces(x, order, starts[:-1], partners, *rest)
    with pytest.raises(ValueError, match=r"^onset: "):
        _kernels.molecule_forces(
            x, order, starts, partners, BOX, KINDS, LAWS, None, CUTOFF, 2.6, 0
        )
