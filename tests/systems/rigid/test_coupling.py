"""What runs into rigid bodies, and pushes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.faults import raises
from support.rigid import FLOOR, ball, box
from support.simulated import Simulator
from support.suite import some_quick

from animtool import BakeOptions
from animtool.core.errors import FormatError
from animtool.scene.systems.simulation import open_systems

FRAMES = (np.arange(25) / 24).tolist()


def bodies(*several: dict[str, Any], **keys: Any) -> dict[str, Any]:
    entry = {"name": "it", "bodies": list(several), "forces": [], **keys}
    return {"rigid": {"sleep": {"speed": 0}, **entry}}


def shots(
    several: list[dict[str, Any]], restitution: float = 0.0, **keys: Any
) -> dict[str, Any]:
    met = {"system": "it", "two_way": True, "restitution": restitution}
    emitters = [{"bursts": [[0, 1]], **one} for one in several]
    return {
        "particles": {"name": "shots", "emitters": emitters, "systems": [met], **keys}
    }


@pytest.mark.parametrize("mass", some_quick([1e-3, 1.0, 50.0], 3))
@pytest.mark.parametrize("restitution", [0.0, 0.6, 1.0])
def test_two_that_meet_part_as_the_textbook_says(
    tmp_path: Path, mass: float, restitution: float
) -> None:
    target = ball(0.2, mass=2.0)
    shot = {"at": [-1, 0, 0], "direction": [1, 0, 0], "speed": 3, "mass": mass}
    run = Simulator(tmp_path).simulate([bodies(target), shots([shot], restitution)],
                                       FRAMES)  # fmt: skip
    after = run["shots"][-1].velocities[0], run["it"][-1].velocities[0]
    middle = 3 * mass / (mass + 2)
    wanted = (
        [middle - restitution * 3 * 2 / (mass + 2), 0, 0],
        [middle + restitution * 3 * mass / (mass + 2), 0, 0],
    )
    assert_allclose(after, wanted, atol=1e-12)


def test_momenta_are_kept_where_many_meet_several(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    targets = [
        box([0.5, 0.3, 0.4], name=f"box{k}", mass=3.0, at=[0.7 * k, 0, 0])
        for k in range(3)
    ]
    several = [
        {
            "at": [*rng.uniform([-0.2, -0.2], [1.6, 0.2]), -1.0 - 0.05 * k],
            "direction": [0, 0, 1],
            "speed": 4.0,
            "mass": 0.05 * (1 + k % 3),
            "radius": 0.01,
        }
        for k in range(40)
    ]
    several = [{**one, "at": one["at"][:2] + one["at"][2:]} for one in several]
    entries = [bodies(*targets, colliders=[]), shots(several, 0.3)]
    simulator = Simulator(tmp_path)
    opened = open_systems(simulator.scene(entries).systems, 1e3)
    rigid, drops = opened
    found = []
    for t in (1 / 24, 0.75):
        drops.at(t)
        rigid.at(t)
        state, flying = rigid.apply_pushes().state.motion, drops.state.state
        masses = flying.particles.masses[:, None]
        x, v = flying.state
        momentum = 3 * state[:, 7:10].sum(axis=0) + (masses * v).sum(axis=0)
        spin = state[:, 10:13] + 3 * np.cross(state[:, :3], state[:, 7:10])
        spin = spin.sum(axis=0) + (masses * np.cross(x, v)).sum(axis=0)
        found.append(np.concatenate([momentum, spin]))
    assert np.linalg.norm(state[:, 10:13]) > 0.01
    assert_allclose(found[1][:3], found[0][:3], atol=1e-12)
    # Where bodies are pushed is known to the square of a step.
    assert_allclose(found[1][3:], found[0][3:], atol=2e-3)


RAIN = [
    {
        "rate": 300,
        "bursts": [],
        "place": {"box": {"size": [0.6, 0.1, 0.6]}},
        "at": [0.1, 1, 0],
        "direction": [0, -1, 0],
        "speed": 3,
        "mass": 0.02,
    }
]
CRATE = box([0.5, 0.3, 0.4], mass=2.0, at=[0, 0.4, 0])
FALL = {"forces": [{"gravity": None}]}


@pytest.mark.slow
@pytest.mark.parametrize("step", [1 / 240, 1 / 96, 0.0031])
def test_frames_do_not_matter(tmp_path: Path, step: float) -> None:
    entries = [
        bodies(CRATE, colliders=[FLOOR], **FALL), shots(RAIN, step=step, **FALL)
    ]  # fmt: skip
    simulator = Simulator(tmp_path)
    coarse = simulator.simulate(entries, (np.arange(13) / 24).tolist())
    fine = simulator.simulate(entries, (np.arange(61) / 120).tolist())
    alone = simulator.simulate(entries[:1], (np.arange(13) / 24).tolist())
    for name in ("it", "shots"):
        for k, row in enumerate(coarse[name]):
            assert_array_equal(row.points, fine[name][5 * k].points)
    assert np.abs(coarse["it"][-1].points - alone["it"][-1].points).max() > 1e-3


@pytest.mark.slow(0.5)
def test_saved_states_go_on_bit_for_bit(tmp_path: Path) -> None:
    rigid = {**bodies(CRATE, colliders=[FLOOR], **FALL)["rigid"], "step": 1 / 240}
    rain = {**shots(RAIN, **FALL)["particles"], "step": 1 / 120}
    simulator = Simulator(tmp_path)
    times = (np.arange(25) / 24).tolist()
    whole = simulator.simulate([{"rigid": rigid}, {"particles": rain}], times)
    saving = {"save_at": 8}
    simulator.baked(
        [
            {"rigid": {**rigid, "save": "a.npz", **saving}},
            {"particles": {**rain, "save": "b.npz", **saving}},
        ],
        BakeOptions(),
    )
    resumed = [
        {"rigid": {**rigid, "resume": "a.npz"}},
        {"particles": {**rain, "resume": "b.npz"}},
    ]
    rows = simulator.simulate(resumed, times[8:])
    for name in ("it", "shots"):
        for k, row in enumerate(rows[name]):
            assert_array_equal(row.points, whole[name][8 + k].points)


def test_only_rigid_bodies_are_pushed(tmp_path: Path) -> None:
    flag = {
        "name": "it",
        "across": [1, 0, 0],
        "mass": 0.3,
        "springs": {"structural": {"stiffness": 1000}},
    }
    with raises(FormatError, "SCN063", match="two_way"):
        Simulator(tmp_path).scene([{"cloth": flag}, shots(RAIN)])


def sheet(**keys: Any) -> dict[str, Any]:
    """Return a cloth that lies flat and free, without weight."""
    return {
        "cloth": {
            "name": "sheet",
            "corner": [-0.5, 0, -0.5],
            "across": [1, 0, 0],
            "up": [0, 0, 1],
            "resolution": [11, 11],
            "mass": 0.5,
            "gravity": [0, 0, 0],
            "springs": {"structural": {"stiffness": 500}},
            "systems": [{"system": "it", "two_way": True, "friction": 0.3}],
            **keys,
        }
    }  # fmt: skip


@pytest.mark.slow(0.5)
@pytest.mark.parametrize("solver", ["symplectic_euler", "xpbd", "bdf2"])
def test_cloth_and_ball_keep_their_momentum(tmp_path: Path, solver: str) -> None:
    thrown = ball(0.15, mass=2.0, at=[0.05, 0.3, 0.02], velocity=[0.2, -2, 0.1])
    entries = [bodies(thrown), sheet(solver=solver)]
    rigid, cloth = open_systems(Simulator(tmp_path).scene(entries).systems, 1.0)
    cloth.at(0.0)
    taken = 0.5 / 121 * cloth.at(0.75).velocities.sum(axis=0)
    rigid.at(0.75)
    left = 2.0 * rigid.apply_pushes().state.motion[0, 7:10]
    assert np.linalg.norm(taken) > 0.1
    assert_allclose(left + taken, 2.0 * np.array([0.2, -2, 0.1]), atol=1e-11)


def caught(folder: Path, rate: int) -> np.ndarray:
    """Return how high a ball is in a hammock, by steps of both."""
    dropped = ball(0.3, mass=5.0, at=[0, 0.6, 0])
    hammock = sheet(
        corner=[-1, 0, -1], across=[2, 0, 0], up=[0, 0, 2], resolution=[7, 7],
        gravity=[0, -9.81, 0],
        pins=[{"particles": ["left", "right"]}], solver="bdf2", step=1 / rate,
        springs={"structural": {"stiffness": 2000, "ratio": 0.05}},
    )  # fmt: skip
    entries = [bodies(dropped, step=1 / rate, **FALL), hammock]
    rows = Simulator(folder).simulate(entries, FRAMES[:13])["it"]
    return np.array([row.points[0, 1] for row in rows])


@pytest.mark.slow(0.5)
def test_shorter_steps_come_nearer_to_how_a_hammock_catches(tmp_path: Path) -> None:
    heights = [caught(tmp_path, rate) for rate in (240, 480, 960)]
    first, second = (float(np.abs(heights[k + 1] - heights[k]).max()) for k in range(2))
    assert heights[2].min() < -0.1
    assert second < 0.6 * first


def test_a_body_is_not_thrown_off_by_what_is_heavier(tmp_path: Path) -> None:
    light = ball(0.15, mass=0.01, at=[0, 0.3, 0])
    falling = sheet(mass=50.0, corner=[-0.5, 1.0, -0.5], gravity=[0, -9.81, 0])
    opened = open_systems(
        Simulator(tmp_path).scene([bodies(light), falling]).systems, 1.0
    )
    speeds = []
    for t in FRAMES:
        opened[1].at(t)
        speeds.append(float(np.linalg.norm(opened[0].at(t).velocities)))
    # The cloth falls, and comes with some 3 m/s.
    assert 1.0 < max(speeds) < 12.0
    assert "SIM135" in [notice.code for notice in opened[1].notices]


def test_frames_do_not_matter_to_cloth(tmp_path: Path) -> None:
    thrown = ball(0.15, mass=2.0, at=[0.05, 0.3, 0.02], velocity=[0.2, -2, 0.1])
    entries = [bodies(thrown), sheet()]
    simulator = Simulator(tmp_path)
    coarse = simulator.simulate(entries, (np.arange(13) / 24).tolist())
    fine = simulator.simulate(entries, (np.arange(61) / 120).tolist())
    for name in ("it", "sheet"):
        for k, row in enumerate(coarse[name]):
            assert_array_equal(row.points, fine[name][5 * k].points)


def test_an_error_is_not_kept_where_bodies_are_pushed(tmp_path: Path) -> None:
    with raises(FormatError, "SIM063"):
        Simulator(tmp_path).scene([bodies(CRATE), sheet(error=1e-3)])


def test_systems_do_not_run_into_each_other_in_a_circle(tmp_path: Path) -> None:
    one = sheet(systems=[{"system": "other"}])
    other = sheet(name="other", systems=[{"system": "sheet"}])
    with raises(FormatError, "SCN063", match=r"\[0\]"):
        Simulator(tmp_path).scene([one, other])
