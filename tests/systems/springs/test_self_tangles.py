"""Cloth that is hard to keep apart from itself, and what is said of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.piercing import pierced
from support.suite import examples
from support.tangles import STEP, TANGLES

from animtool import _kernels
from animtool.core.array_types import FloatArray
from animtool.systems.springs import (
    Body,
    Pins,
    SelfContact,
    SpringMotion,
    SpringOptions,
    Springs,
    SpringSystem,
    simulate_springs,
)

TIMES = np.arange(25) / 30
FEW = SpringOptions("xpbd", STEP, stretch=1.0)


def crossings(motion: SpringMotion, system: SpringSystem) -> int:
    triangles = system.body.triangles
    return max(_kernels.pierced_edges(x, triangles) for x in motion.positions)


@pytest.mark.slow
@pytest.mark.parametrize("name", TANGLES)
def test_no_edge_goes_through_a_triangle(name: str) -> None:
    system = TANGLES[name](True)
    motion = simulate_springs(system, TIMES, FEW)
    assert (motion.passed, motion.cut, motion.notices) == (0, 0, ())
    assert crossings(motion, system) == 0


@pytest.mark.parametrize("name", TANGLES)
def test_without_contact_edges_go_through(name: str) -> None:
    system = TANGLES[name](False)
    assert crossings(simulate_springs(system, TIMES, FEW), system) >= 5


@pytest.mark.parametrize("name", ["whirled flag 8x8", "crossed ribbons"])
def test_in_parts_the_bytes_are_those_of_the_whole(name: str) -> None:
    system = TANGLES[name](True)
    whole = simulate_springs(system, TIMES, FEW)
    first = simulate_springs(system, TIMES[:14], FEW)
    rest = simulate_springs(system, TIMES[13:], FEW, first.checkpoint)
    assert rest.states.tobytes() == whole.states[13:].tobytes()


def test_a_blow_gives_no_energy() -> None:
    system = TANGLES["crossed ribbons"](True)
    motion = simulate_springs(system, TIMES, FEW)
    assert motion.energies.max() <= motion.energies[0] * (1 + 1e-9)


# Two crossed edges, each with a corner behind it.
CROSSED = np.array(
    [[-0.5, 0, 0], [0.5, 0, 0], [0, 0, -1], [0, -0.5, 0], [0, 0.5, 0], [0, 0, 1]]
)


def pair(
    gap: float, masses: FloatArray, friction: float, pins: tuple[int, ...] = ()
) -> SpringSystem:
    """Return two triangles, an edge of one above an edge of the other."""
    x = CROSSED + [[0, 0, gap * (n >= 3)] for n in range(6)]
    body = Body(x, masses, Springs.none(), np.array([[0, 1, 2], [3, 4, 5]]))
    contact = SelfContact(0.02, friction, rest=x * 1e3)
    return SpringSystem(body, gravity=(0, 0, 0), pins=Pins(pins), self_contact=contact)


def parted(system: SpringSystem, way: FloatArray, h: float = 0.01) -> FloatArray:
    """Return the state after a step along ways ``(N, 3)``."""
    x = system.body.positions
    state = np.stack([x + way, way / h])
    assert system.kernel_self_contact is not None
    return _kernels.part_springs(
        system.network(0), system.kernel_self_contact, x, state, h
    )


shares = st.floats(-1, 1)
ways = st.lists(st.tuples(shares, shares, shares), min_size=6, max_size=6)
weights = st.lists(st.floats(0.1, 10), min_size=6, max_size=6)


@pytest.mark.slow
@given(ways, weights, st.floats(0, 1))
@settings(max_examples=examples(100))
def test_edges_keep_momentum_and_without_friction_their_spin(
    moved: list[tuple[float, ...]], heavy: list[float], friction: float
) -> None:
    masses, way = np.array(heavy), np.array(moved) * 0.01
    way[3:, 2] -= 0.02
    for rubbing in (0.0, friction):
        system = pair(0.018, masses, rubbing)
        before, after = system.body.positions + way, parted(system, way)[0]
        taken = masses[:, None] * (after - before)
        np.testing.assert_allclose(taken.sum(axis=0), 0, atol=1e-13)
        if not rubbing:
            spin = np.cross(before, taken).sum(axis=0)
            np.testing.assert_allclose(spin, 0, atol=1e-13)


@pytest.mark.slow
@given(ways, weights)
@settings(max_examples=examples(100))
def test_edges_are_parted_alike_whichever_comes_first(
    moved: list[tuple[float, ...]], heavy: list[float]
) -> None:
    masses, way = np.array(heavy), np.array(moved) * 0.01
    way[3:, 2] -= 0.01
    system = pair(0.016, masses, 0.3)
    other = [3, 4, 5, 0, 1, 2]
    turned = SpringSystem(
        replace(
            system.body, positions=system.body.positions[other], masses=masses[other]
        ),
        gravity=(0, 0, 0),
        self_contact=SelfContact(0.02, 0.3, rest=system.body.positions[other] * 1e3),
    )
    made, again = parted(system, way), parted(turned, way[other])
    np.testing.assert_allclose(again[:, other], made, atol=1e-12)


@given(st.floats(1e-4, 0.014), weights)
@settings(max_examples=examples(50))
def test_what_rests_too_near_gains_no_speed(gap: float, heavy: list[float]) -> None:
    system = pair(gap, np.array(heavy), 0.3)
    x, v = parted(system, np.zeros((6, 3)))
    assert np.abs(v).max() < 1e-12
    # Apart, by what the speed of coming apart allows in a step.
    height = x[3:5, 2].mean() - x[:2, 2].mean()
    assert gap < height < gap + 0.2 * 0.01 * 1.01


def test_edges_do_not_cut_through_each_other() -> None:
    for friction in (0.0, 0.5):
        system = pair(0.018, np.ones(6), friction)
        way = np.zeros((6, 3))
        way[3:, 2] = -0.05
        x = parted(system, way)[0]
        assert x[3:5, 2].mean() - x[:2, 2].mean() == pytest.approx(0.015, abs=1e-6)


def test_edges_that_went_through_are_moved_back() -> None:
    system = pair(-0.005, np.ones(6), 0.2, pins=(0, 1, 2, 5))
    options = SpringOptions("xpbd")
    start = simulate_springs(system, [0, 1 / 240], options).checkpoint
    # Edges in order: 0-1, 0-2, 1-2, 3-4 and so on.
    for side in (1, -1):
        passages = np.array([[6, 3, side]])
        state = replace(start.memory.state, passages=passages, motion=system.state)
        known = replace(start.memory, state=state, index=0)
        motion = simulate_springs(
            system, np.arange(13) / 24, options, replace(start, time=0.0, memory=known)
        )
        height = motion.positions[-1, 3:5, 2].mean()
        # Heights are those of the first over the second, along the cross of their ways.
        assert height == pytest.approx(-side * 0.015, abs=1e-3)
        assert np.abs(motion.velocities).max() < 1e-9


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=examples(50))
def test_pierced_edges_are_those_of_all_pairs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = rng.uniform(size=(20, 3))
    triangles = np.stack([rng.choice(20, 3, replace=False) for _ in range(12)])
    assert _kernels.pierced_edges(x, triangles) == pierced(x, triangles)


def test_a_start_in_a_tangle_is_said() -> None:
    system = pair(-0.1, np.ones(6), 0.2)
    motion = simulate_springs(system, [0, 0.01], SpringOptions("xpbd"))
    (notice,) = (one for one in motion.notices if one.code == "SIM166")
    assert "in 2 places" in notice.message
    free = SpringSystem(system.body, gravity=(0, 0, 0))
    assert not simulate_springs(free, [0, 0.01]).notices


def test_what_is_too_fast_is_said_with_the_steps_that_it_takes() -> None:
    system = pair(0.1, np.ones(6), 0.2)
    system.state[1, 3:, 2] = -50.0
    fast = simulate_springs(system, [0, 0.01], SpringOptions("xpbd", 1 / 240))
    (notice,) = (one for one in fast.notices if one.code == "SIM165")
    rate = int((notice.hint or "").split()[1])
    assert rate == pytest.approx(50 / (4 * 0.02), abs=2)
    system.state[1, 3:, 2] = -50.0
    enough = simulate_springs(system, [0, 0.01], SpringOptions("xpbd", 1 / (rate + 1)))
    assert not enough.notices
    assert enough.cut == 0
