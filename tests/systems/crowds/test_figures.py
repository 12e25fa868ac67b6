"""Figures of small irregular crowds: bodies that are pushed on bumps, and runs."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.figures import check_figures
from support.simulated import Simulator
from systems.crowds.test_bodies import CLIPS, TAKES, bumpy, library

from animtool.maths import so3
from animtool.scene.systems.simulation import open_systems
from animtool.systems.crowds.agents import AgentMotion
from animtool.systems.crowds.bodies import AgentBodies
from animtool.systems.crowds.poses import body_poses
from animtool.systems.framework.run import SimulationRun

BIPED = Path(__file__).parents[3] / "rigs/biped/biped.rig.yaml"
STEP = 0.1


def goings(count: int) -> list[AgentMotion]:
    """Return five who walk, run in a circle, spin, are pushed to a side, and back."""
    t = np.arange(count) * STEP
    headings = np.stack([0.3 * t, 0.9 * t - 2, 3.4 * t, 0 * t + 1, 0.4 + 0 * t])
    ahead = np.stack(
        [np.minimum(t, 1.3), np.minimum(2 * t, 2.4), 0.1 * t, 0 * t, -0.5 * (t > 0.6)]
    )
    left = np.stack([0 * t, 0.1 * t, 0 * t, 0.7 * (t > 0.4) * (t < 2), -0.2 * (t > 1)])
    sine, cosine = np.sin(headings), np.cos(headings)
    v = np.stack([ahead * sine + left * cosine, ahead * cosine - left * sine], axis=-1)
    x = np.cumsum(v, axis=1) * STEP + np.arange(5)[:, None, None] * [2.0, -1.0]
    return [AgentMotion(x[:, i], v[:, i], headings[:, i]) for i in range(count)]


@pytest.mark.slow
def test_bodies_that_are_pushed_and_turn_on_bumpy_ground() -> None:
    gaits = library("walk", "run", "turn", "stand", "stumble")
    bodies = AgentBodies(gaits, np.array([1.0, 1.1, 0.9, 1.05, 0.97]), bumpy)
    ways = goings(42)
    state = bodies.initial_state(ways[0], np.array([0.1, 0.35, 0.5, 0.77, 0.9]))
    states, poses, feet = [], [], []
    for i, (before, after) in enumerate(pairwise(ways)):
        hit = np.array([i == 7, False, i == 5, False, False])
        state = bodies.advance(state, before, after, STEP, hit if i % 2 else None)
        states.append(state)
        if i % 3 == 2:
            state.shoulders[:] = [0.0, 0.2, -0.4, 0.5, 0.0]
            poses.append(body_poses(bodies, state, after))
            feet.append(bodies.foot_poses(state, after))
            state.shoulders[:] = 0.0
    check_figures(__file__, "bodies", {"states": states, "feet": feet})
    check_figures(__file__, "poses", poses)


@pytest.mark.slow
def test_gaits_of_clips() -> None:
    gaits = library("walk", "run", "turn", "stand", "stumble")
    all_ = [*gaits.cycles, gaits.idle, *gaits.reactions]
    check_figures(__file__, "gaits", {one.name: one for one in all_})


@pytest.fixture
def simulator(tmp_path: Path) -> Simulator:
    return Simulator(tmp_path)


def test_agents_among_walls_doors_and_queues(simulator: Simulator) -> None:
    heights = np.random.default_rng(3).uniform(-0.1, 0.1, (9, 11))
    ground = {"shape": {"height_field": {"heights": heights, "size": [20, 16]}}}
    turned = so3.exp(np.array([0.0, 0.4, 0.0]))[[3, 0, 1, 2]].tolist()
    goals = [
        {"name": "desk", "at": [2, 0, 1], "wait": 0.6, "radius": 0.4,
         "queue": {"direction": [1, 0, -2], "spacing": 0.7}},
        {"name": "far", "at": [-6, 0, 3], "radius": 1.5, "wait": 0.3},
        {"name": "out", "at": [3, 0, -5]},
    ]  # fmt: skip
    place = {"box": {"size": [4, 0, 3]}}
    people = [
        {"name": "a", "count": 9, "at": [1, 0, -3], "place": place, "seed": 3,
         "route": ["desk", "far"], "then": "repeat", "delay": 1.0},
        {"name": "b", "count": 6, "at": [-3, 0, 0], "group": 3, "route": ["far"],
         "then": "leave", "speed": {"mean": 1.5, "spread": 0.3}, "radius": 0.27,
         "place": {"disc": {"radius": 2}}, "acceleration": 0.3},
        {"name": "c", "count": 4, "at": [-1, 0, 4], "route": ["out"], "seed": 8},
    ]  # fmt: skip
    crowd = {
        "name": "it", "step": 0.1, "populations": people, "goals": goals,
        "ground": {**ground, "slope": 30}, "cell": 0.4,
        "doors": [{"begin": [-2, 0, 2], "end": [0, 0, 1], "opens": [[2, 9]]}],
        "avoidance": {"side": "left", "sight": 2.5, "push": 0.4},
        "colliders": [
            {"shape": {"box": {"size": [1, 3, 2]}}, "at": [0, 1, -1],
             "rotate": turned},
            {"shape": {"sphere": {"radius": 0.6}}, "at": [3, 0.5, -2],
             "moves": [[0, 0, 0, 0], [6, -5, 0, 3]]},
        ],
    }  # fmt: skip
    (run,) = open_systems(simulator.scene([{"crowds": crowd}]).systems, 7.0)
    assert isinstance(run, SimulationRun)
    begun = run.simulation.initial_state()
    rows = [run.at(t) for t in (0.0, 1.5, 3.0, 4.5, 6.0)]
    found = [begun, rows, run.state.state, run.notices]
    check_figures(__file__, "agents", found)


@pytest.mark.slow
def test_people_whom_a_rock_knocks_down(simulator: Simulator) -> None:
    root = BIPED.parents[2]
    (simulator.folder / "animtool.toml").write_text(f'roots = ["{root}"]\n')
    clips = [str(TAKES / "walk.bvh"), str(CLIPS / "stand.bvh")]
    people = {
        "name": "p", "count": 3, "place": {"disc": {"radius": 0.9}}, "size": 0.05,
        "gaits": {"rig": str(BIPED), "clips": clips}, "route": ["g"],
    }  # fmt: skip
    rock = {
        "shape": {"sphere": {"radius": 0.5}}, "at": [-3, 0.6, 0.3],
        "moves": [[0, 0, 0, 0], [1, 5, 0, 0]],
    }  # fmt: skip
    turned = so3.exp(np.array([0.0, 0.8, 0.0]))[[3, 0, 1, 2]].tolist()
    crowd = {
        "name": "it", "step": 0.1, "populations": [people], "colliders": [rock],
        "goals": [{"name": "g", "at": [1, 0, 5]}],
        "ground": {"at": [0.5, 0.1, 0], "rotate": turned},
    }  # fmt: skip
    (run,) = open_systems(simulator.scene([{"crowds": crowd}]).systems, 2.0)
    assert isinstance(run, SimulationRun)
    rows: list[Any] = [run.at(t) for t in (0.0, 0.4, 0.7, 1.1)]
    kept = [
        {name: getattr(row, name) for name in type(row).__slots__ if name != "casts"}
        for row in rows
    ]
    # Tumbling bodies amplify the rounding of a processor: their motion is left out.
    check_figures(__file__, "knocked", kept)
