"""Who is born when, where and how fast, in numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from animtool.maths import so3
from animtool.sim.colliders import Mesh, Poses
from animtool.systems.particles import BoxShape, Disc, Emitter, MeshSurface, SphereShape
from animtool.systems.particles.emitter import Births, hash64, uniform_samples


def splitmix(state: int) -> int:
    """Return the next number of S. Vigna's splitmix64 after a state."""
    z = (state + 0x9E3779B97F4A7C15) % 2**64
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9 % 2**64
    z = (z ^ z >> 27) * 0x94D049BB133111EB % 2**64
    return z ^ z >> 31


def test_bits_are_mixed_as_splitmix_does() -> None:
    assert hash64(np.array([0], np.uint64))[0] == 0xE220A8397B1DCDAF
    assert hash64(np.array([1234567], np.uint64))[0] == 6457827717110365317
    keys = [0, 7, 2**40 + 3]
    found = uniform_samples(5, np.array(keys), 3)
    for row, key in zip(found, keys, strict=True):
        first = splitmix(key ^ splitmix(5))
        bits = [splitmix((first + k * 0x9E3779B97F4A7C15) % 2**64) for k in range(3)]
        assert row.tolist() == [(one >> 11) / 2**53 for one in bits]


RATE = {"rate": 2.0, "start": 1.0, "end": 3.0}


@pytest.mark.parametrize(
    ("keys", "span", "room", "times", "missed"),
    [
        (RATE, (0.0, None, 9.0), 99, [1.25, 1.75, 2.25, 2.75], 0),
        (RATE, (0.0, 1.25, 2.25), 99, [1.75, 2.25], 0),
        (RATE, (0.0, None, 9.0), 3, [1.25, 1.75, 2.25], 1),
        (RATE, (0.0, None, 1.0), 99, [], 0),
        (RATE, (2.0, None, 9.0), 99, [2.25, 2.75], 0),
        ({"bursts": [(2.0, 2), (1.0, 1)]}, (0.0, None, 2.0), 99, [1, 2, 2], 0),
        ({"bursts": [(0.0, 2)]}, (0.0, None, 0.0), 99, [0, 0], 0),
        ({"bursts": [(1.0, 2)]}, (0.0, 1.0, 2.0), 99, [], 0),
        ({"bursts": [(1.0, 2)]}, (1.5, None, 2.0), 99, [], 0),
        ({"bursts": [(1.0, 9)]}, (0.0, 0.5, 2.0), 4, [1, 1, 1, 1], 5),
        (RATE | {"bursts": [(1.5, 3)]}, (0.0, None, 1.75), 2, None, 1),
    ],
)
def test_who_is_born_is_counted_from_the_middle_of_the_first_span(
    keys: Any, span: Any, room: int, times: list[float] | None, missed: int
) -> None:
    """Half a second apart, from a quarter on; both ends as they are declared."""
    found = Emitter(**keys).births(*span, room)
    if times is None:
        # As many of each as there is room for: who has it is decided by who calls.
        assert_allclose(found.times, [1.25, 1.5, 1.5, 1.75])
        assert found.keys.tolist() == [0, 2**40, 2**40 + 1, 1]
    else:
        assert_allclose(found.times, times)
    assert found.skipped_count == missed


def test_keys_of_bursts_are_apart_from_those_of_the_rate() -> None:
    emitter = Emitter(bursts=[(2.0, 2), (1.0, 1)], **RATE)
    found = emitter.births(0.0, 1.25, 2.0, 99)
    assert found.keys.tolist() == [1, 2**40, 2**40 + 1]
    every = emitter.births(0.0, None, 2.0, 99)
    assert every.keys.tolist() == [2**41, 0, 1, 2**40, 2**40 + 1]


def test_each_draws_speed_life_and_radius_by_its_own_numbers() -> None:
    keys = np.array([3, 9, 2**40])
    emitter = Emitter(
        speed=3.0, speed_spread=0.5, lifetime=2.0, lifetime_spread=3.0, radius=0.2,
        radius_spread=0.1, seed=11,
    )  # fmt: skip
    u = uniform_samples(11, keys, 8)
    x, v, lives, radii = emitter.sample_births(Births(np.zeros(3), keys, 0))
    assert_array_equal(x, np.zeros((3, 3)))
    assert_allclose(v[:, 1], 2.5 + u[:, 5])
    assert_allclose(v[:, [0, 2]], 0, atol=1e-12)
    assert_allclose(lives, np.maximum(6 * u[:, 6] - 1, 0))
    assert_allclose(radii, 0.1 + 0.2 * u[:, 7])


@pytest.mark.parametrize(
    ("direction", "outwards", "middle"),
    [
        (None, None, [0, 1, 0]),
        ((0, 0, 5), None, [0, 0, 1]),
        (None, [[3.0, 0, 4.0]], [0.6, 0, 0.8]),
        ((0, 0, 5), [[3.0, 0, 4.0]], [0, 0, 1]),
        ((3e-200, 0, 4e-200), None, [0.6, 0, 0.8]),
        ((0, 3e151, 4e151), None, [0, 0.6, 0.8]),
    ],
)
def test_directions_are_in_a_cone_about_the_middle(
    direction: Any, outwards: Any, middle: list[float]
) -> None:
    """By chance 0 along it, by 1 on the cone; by another all around, evenly."""
    emitter = Emitter(direction=direction, spread=0.7)
    given = None if outwards is None else np.array(outwards)
    found = emitter._directions(np.array([[0.0, 0.3]]), given)
    assert_allclose(found, [middle], atol=1e-12)
    rows = [
        emitter._directions(np.array([[share, turn]]), given)[0]
        for share, turn in ((1.0, 0.0), (1.0, 0.25), (1.0, 0.5), (0.5, 0.0))
    ]
    heights = np.array(rows) @ middle
    assert_allclose(heights, [*[math.cos(0.7)] * 3, (1 + math.cos(0.7)) / 2])
    assert_allclose(np.linalg.norm(rows, axis=1), 1)
    off = np.array(rows) - heights[:, None] * middle
    assert_allclose(off[0] + off[2], 0, atol=1e-12)
    assert off[0] @ off[1] == pytest.approx(0, abs=1e-12)
    assert off[0] @ off[3] > 0


def test_places_and_speeds_are_of_the_emitters_frame() -> None:
    """Turned by a quarter about z; one that moves adds its own speed, and its spin."""
    quarter = so3.exp(np.array([0.0, 0, np.pi / 2]))
    points, ways = np.array([[1.0, 0, 0]]), np.array([[2.0, 0, 0]])
    still = Emitter(poses=Poses([0], [[5, 6, 7]], [quarter]))
    x, v = still._to_world(np.zeros(1), points, ways)
    assert_allclose(x, [[5, 7, 7]], atol=1e-12)
    assert_allclose(v, [[0, 2, 0]], atol=1e-12)
    poses = Poses([0, 2], [[0, 0, 0], [6, 0, 0]], [quarter, quarter])
    for inherit in (0.0, 1.0, -0.5):
        cart = Emitter(poses=poses, inherit=inherit)
        x, v = cart._to_world(np.array([1.0]), points, ways)
        assert_allclose(x, [[3, 1, 0]], atol=1e-9)
        assert_allclose(v, [[3 * inherit, 2, 0]], atol=1e-6)
    times, turns = np.linspace(0, 1, 11), np.linspace(0, 1, 11)
    spin = [so3.exp(np.array([0.0, 0, 2 * s])) for s in turns]
    wheel = Emitter(poses=Poses(times, np.zeros((11, 3)), spin))
    x, v = wheel._to_world(np.array([0.5]), points, 0 * ways)
    assert_allclose(x, [[np.cos(1), np.sin(1), 0]], atol=1e-6)
    assert_allclose(v, [[-2 * np.sin(1), 2 * np.cos(1), 0]], atol=1e-3)


def test_a_burst_of_its_own_is_drawn_at_a_time() -> None:
    emitter = Emitter(rate=50.0, speed=2.0, place=BoxShape((1, 1, 1)), seed=4)
    x, v = emitter.sample_at(3.0, 5)
    u = uniform_samples(4, 2**40 + np.arange(5), 8)
    assert_allclose(x, u[:, :3] - 0.5)
    assert_allclose(v, np.tile([0.0, 2, 0], (5, 1)))


@pytest.mark.parametrize(
    ("keys", "options"),
    [
        ({"spread": math.pi}, []),
        ({"spread": math.nextafter(math.pi, 4)}, ["spread"]),
        ({"spread": -1e-9}, ["spread"]),
        ({"spread": 20.0}, ["spread"]),
        ({"radius": 0.2, "radius_spread": 0.199}, []),
        ({"radius": 0.2, "radius_spread": 0.2}, ["radius_spread"]),
        ({"start": 2.0, "end": 2.0}, []),
        ({"start": 2.0, "end": 1.9}, ["end"]),
        ({"direction": (0, 2e-150, 0)}, []),
        ({"direction": (0, 1e-151, 0)}, ["direction"]),
        ({"direction": (0, math.inf, 0)}, ["direction"]),
        ({"bursts": [(0.0, 0), (1.0, 10**12)]}, []),
        ({"bursts": [(0.0, 1), (1.0, 10**12 + 1)]}, ["bursts"]),
        ({"bursts": [(0.0, -1), (math.inf, 2)]}, ["bursts", "bursts"]),
        ({"place": Disc(0.0)}, ["place"]),
        ({"place": BoxShape((0, 0, 0))}, []),
    ],
)
def test_ends_of_what_an_emitter_may_be(keys: Any, options: list[str]) -> None:
    found = Emitter(**keys).problems()
    assert [option for option, _ in found] == options
    assert ("burst 1" in str(found)) is ("bursts" in options)
    assert ("write 0.349" in str(found)) is (keys.get("spread") == 20)


def test_places_by_their_chances() -> None:
    """Of a disc and a ball the roots make them even; a mesh is folded at its middle."""
    x, out = Disc(2.0).points(np.array([[0.25, 0.25, 0.9], [1.0, 0.5, 0.9]]))
    assert_allclose(x, [[0, 0, 1], [-2, 0, 0]], atol=1e-12)
    assert out is None
    chances = np.array([[0.5, 0.0, 0.125], [1.0, 0.3, 1.0], [0.8, 0.25, 1.0]])
    x, out = SphereShape(2.0).points(chances)
    assert_allclose(x, [[1, 0, 0], [0, 2, 0], [0, 1.2, 1.6]], atol=1e-12)
    assert out is None
    x, out = SphereShape(2.0, hollow=True).points(chances)
    assert_allclose(x, [[2, 0, 0], [0, 2, 0], [0, 1.2, 1.6]], atol=1e-12)
    assert_allclose(out, x / 2, atol=1e-12)
    x, _ = BoxShape((2, 4, 6)).points(np.array([[0.0, 0.5, 1.0]]))
    assert_allclose(x, [[-1, 0, 3]])
    # One of an area of 1, and one of 3 that is turned the other way.
    corners = [[0, 0, 0], [0, 0, 2], [1, 0, 0], [0, 0, -6]]
    surface = MeshSurface(Mesh(corners, [[0, 1, 2], [0, 3, 2]]))
    chances = np.array([[0.24, 0.25, 0.5], [0.24, 0.75, 1.0], [0.26, 0.5, 0.25]])
    x, out = surface.points(chances)
    places, rows = surface.mesh.weld()
    expected = []
    for which, u, v in ((0, 0.25, 0.5), (0, 0.25, 0.0), (1, 0.5, 0.25)):
        a, b, c = places[rows[which]]
        expected.append(a + u * (b - a) + v * (c - a))
    assert_allclose(x, expected, atol=1e-12)
    assert_allclose(out, [[0, 1, 0], [0, 1, 0], [0, -1, 0]], atol=1e-12)
    last, _ = surface.points(np.array([[1.0, 0.0, 0.0]]))
    assert_allclose(last, [places[rows[1]][0]])
