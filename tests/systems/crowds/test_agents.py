"""What agents like, where groups begin, and who may not be in a crowd."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.maths import so3
from animtool.sim.colliders import Poses
from animtool.systems.crowds.agents import _key_problems, _sample_population
from animtool.systems.crowds.ground import GroundFrame
from animtool.systems.crowds.spec import PopulationModel
from animtool.systems.particles import BoxShape

FRAME = GroundFrame(np.array([1.0, 0, 2]), so3.IDENTITY)


def drawn(**keys: Any) -> tuple[Any, ...]:
    population = PopulationModel.model_validate(
        {"name": "all", "route": ["a"], "radius": 0.25, **keys}
    )
    parts = {"place": BoxShape((40.0, 1.0, 40.0)), "poses": Poses.fixed()}
    return tuple(_sample_population(population, parts, 0.0, FRAME, 0).values())


def test_agents_like_speeds_about_the_mean_and_none_less_than_a_third() -> None:
    """Normal ones, cut at two deviations; sizes are as often larger as smaller."""
    speed = {"mean": 1.2, "spread": 0.2}
    _, speeds, _, gives, delays, groups, _, offsets, sizes, chances = drawn(
        count=4000, speed=speed, delay=8.0, size=0.25
    )
    assert speeds.min() == pytest.approx(0.8)
    assert speeds.max() == pytest.approx(1.6)
    assert speeds.mean() == pytest.approx(1.2, abs=0.02)
    # Of normal numbers cut at two the deviation is 0.88 to 0.96.
    assert speeds.std() == pytest.approx(0.192, abs=0.01)
    slow = drawn(count=4000, speed={"mean": 1.2, "spread": 0.9})[1]
    assert slow.min() == pytest.approx(0.4)
    for values, least, most in (
        (gives, 0.2, 1.0), (delays, 0, 8), (chances, 0, 1), (sizes, 0.8, 1.25),
    ):  # fmt: skip
        assert least <= values.min() < least + 0.02 * (most - least)
        assert most >= values.max() > most - 0.02 * (most - least)
    assert np.median(np.log(sizes)) == pytest.approx(0, abs=0.01)
    far = np.linalg.norm(offsets, axis=1)
    # Evenly over a circle of 0.8: half of them beyond 0.8 / √2.
    assert 0.79 < far.max() <= 0.8
    assert np.median(far) == pytest.approx(0.8 / np.sqrt(2), abs=0.02)
    assert (groups == -1).all()


def test_those_of_a_group_begin_side_by_side_about_its_middle() -> None:
    """1.3 of both radii apart; the last has two of three, and all go one way."""
    starts, speeds, _, _, delays, groups, sides, offsets, sizes, chances = drawn(
        count=8, group=3, delay=5.0, size=0.3
    )
    assert groups.tolist() == [0, 0, 0, 1, 1, 1, 2, 2]
    assert_allclose(sides, [-0.65, 0, 0.65, -0.65, 0, 0.65, -0.325, 0.325])
    for own in (slice(0, 3), slice(3, 6), slice(6, 8)):
        gaps = np.linalg.norm(np.diff(starts[own], axis=0), axis=1)
        assert_allclose(gaps, 0.65)
        for values in (speeds, delays, offsets):
            assert_allclose(values[own], values[own][[0]].repeat(gaps.size + 1, axis=0))
        assert len(set(sizes[own])) == gaps.size + 1
        assert len(set(chances[own])) == gaps.size + 1


def test_places_of_a_file_are_seen_from_the_ground() -> None:
    population = PopulationModel.model_validate({"name": "all", "route": ["a"]})
    points = np.array([[1.0, 5, 2], [4, 0, -1]])
    sample = _sample_population(population, {"points": points}, 0.0, FRAME, 0)
    assert_allclose(sample["start_points"], [[0, 0], [3, -3]])


def test_keys_that_do_not_fit_are_told_with_their_place() -> None:
    def one(name: str, **keys: Any) -> Any:
        given = {"route": ["a"], "then": "stay", "shows": None, "gaits": None}
        return SimpleNamespace(name=name, **{**given, **keys})

    spec = SimpleNamespace(
        goals=[SimpleNamespace(name="a"), SimpleNamespace(name="a")],
        populations=[
            one("p", route=["b"], gaits=1),
            one("p", route=["a", "a"], then="repeat", gaits=1),
            one("r"),
        ],
        doors=[SimpleNamespace(name="d", opens=[(0, 1), (2, 2)])],
    )  # fmt: skip
    found = [(message, where) for message, where, _ in _key_problems(spec)]  # type: ignore[arg-type]
    assert [where for _, where in found] == [
        "goals[1]", "populations[1]", "populations[0].route[0]", "populations[1].then",
        "populations", "doors[0]",
    ]  # fmt: skip
    assert "'r' does not" in found[4][0]
    assert "from 2 s to 2 s" in found[5][0]
