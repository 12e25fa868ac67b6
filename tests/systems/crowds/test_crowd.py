"""Crowds as scenes have them: who avoids whom, ways to goals, what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree
from support.faults import raises
from support.simulated import Simulator

from animtool.core.errors import AnimtoolError
from animtool.scene.systems.run import SystemRun
from animtool.scene.systems.simulation import open_systems
from animtool.systems.crowds import crowd as crowds
from animtool.systems.crowds.steering import DEPARTED_STAGE
from animtool.systems.framework.run import SimulationRun

FPS = 20
RADIUS = 0.25
# What two agents may be in each other [m].
TOUCHING = 0.01


@pytest.fixture
def simulator(tmp_path: Path) -> Simulator:
    return Simulator(tmp_path)


def crowd(populations: list[dict[str, Any]], **keys: Any) -> list[dict[str, Any]]:
    label = [{"name": f"p{i}", **one} for i, one in enumerate(populations)]
    return [{"crowds": {"name": "it", "step": 0.05, "populations": label, **keys}}]


def goal(name: str, x: float, z: float, **keys: Any) -> dict[str, Any]:
    return {"name": name, "at": [x, 0, z], **keys}


def box(x: float, z: float, wide: float, deep: float, **keys: Any) -> dict[str, Any]:
    shape = {"box": {"size": [wide, 3, deep]}}
    return {"shape": shape, "at": [x, 1.5, z], **keys}


def door(end: list[float], *opens: list[float]) -> dict[str, Any]:
    return {"begin": [0, 0, 0], "end": end, "opens": list(opens)}


def times(seconds: float) -> list[float]:
    return (np.arange(round(seconds * FPS) + 1) / FPS).tolist()


def tracks(rows: list[Any]) -> np.ndarray:
    """Return x and z of agents over time ``(F, N, 2)``."""
    return np.stack([row.points[:, [0, 2]] for row in rows])


def closest(track: np.ndarray) -> float:
    """Return how near any two agents ever are [m]."""
    return min(float(cKDTree(x).query(x, 2)[0][:, 1].min()) for x in track)


def notices(simulator: Simulator, systems: list[dict[str, Any]]) -> dict[str, str]:
    """Return what is warned of at the beginning, by code."""
    scene = simulator.scene(systems)
    run = SystemRun(scene.systems, 0.0, None, None)
    list(run.coded_frames([scene.bake.frame_range.first], 1, FPS))  # type: ignore[union-attr]
    return {fault.code: fault.message for fault in run.notices}


def placed(folder: Path, points: np.ndarray) -> str:
    np.savez(folder / "agents.npz", points=points)
    return str(folder / "agents.npz")


def test_streams_cross_without_a_touch_and_arrive(simulator: Simulator) -> None:
    """Four streams meet in the middle: RVO's plain agents overlap there by 4 cm."""
    ends = [(-14, 0), (14, 0), (0, -14), (0, 14)]
    goals = [
        goal(f"g{i}", -40 * int(np.sign(x)), -40 * int(np.sign(z)))
        for i, (x, z) in enumerate(ends)
    ]
    populations = [
        {
            "count": 40,
            "at": [x, 0, z],
            "place": {"box": {"size": [10, 0, 10]}},
            "route": [f"g{i}"],
            "seed": i,
            "radius": RADIUS,
        }
        for i, (x, z) in enumerate(ends)
    ]
    rows = simulator.simulate(crowd(populations, goals=goals), times(16))["it"]
    track = tracks(rows)
    assert closest(track) > 2 * RADIUS - TOUCHING
    ways = -np.sign(ends).repeat(40, axis=0)
    progress = ((track[-1] - track[0]) * ways).sum(axis=1)
    # At two thirds of the speed that they like.
    assert progress.mean() > 0.65 * 1.34 * 16
    assert progress.min() > 5


def test_a_way_around_a_wall_is_hardly_longer_than_the_shortest(
    simulator: Simulator,
) -> None:
    """From (-4, 0) to (4, 0) around the end of a wall, at its clearance."""
    systems = crowd(
        [
            {
                "points": placed(simulator.folder, np.array([[-4.0, 0, 0]])),
                "route": ["g"],
            }
        ],
        goals=[goal("g", 4, 0, radius=0.2)],
        colliders=[box(0, 2, 0.4, 8)],
    )
    track = tracks(simulator.simulate(systems, times(14))["it"])[:, 0]
    length = np.linalg.norm(np.diff(track, axis=0), axis=1).sum()
    corner = np.array([0.2, -2.0])
    # Around the corner in a circle of the agent's radius.
    far, radius = np.hypot(4 - 0.2, 2), 0.22
    bend = np.arctan2(2, 4 - 0.2) + np.arcsin(radius / far)
    shortest = 2 * np.sqrt(far**2 - radius**2) + 2 * bend * radius + 0.4 - 0.2
    assert np.linalg.norm(track[-1] - [4, 0]) < 0.25
    assert length < 1.06 * shortest
    assert np.linalg.norm(track - corner, axis=1).min() > radius - 1e-3


@pytest.mark.slow
def test_agents_far_apart_find_ways_around_what_is_near(simulator: Simulator) -> None:
    """One grid over all of them would have cells of 150 m, and 4 million of these."""
    near, far = np.array([[-12.0, 0, 0]]), np.array([[2e5, 0, 2e5]])
    np.savez(simulator.folder / "far.npz", points=far)
    systems = crowd(
        [
            {"points": placed(simulator.folder, near), "route": ["g"]},
            {"points": str(simulator.folder / "far.npz"), "route": ["there"]},
        ],
        goals=[goal("g", 12, 0, radius=0.2), goal("there", 2e5 + 5, 2e5, radius=0.2)],
        colliders=[box(0, 2, 0.4, 8)],
    )
    track = tracks(simulator.simulate(systems, times(26))["it"])
    length = np.linalg.norm(np.diff(track[:, 0], axis=0), axis=1).sum()
    assert np.linalg.norm(track[-1, 0] - [12, 0]) < 0.25
    assert length < 1.06 * 2 * np.hypot(12, 2.22)
    assert np.linalg.norm(track[-1, 1] - [2e5 + 5, 2e5]) < 0.25


def test_who_walks_abreast_keeps_the_speed_of_one_alone(simulator: Simulator) -> None:
    """Headway is of those ahead on the same line: a second one behind them slows."""
    side = np.array([[0.0, 0, 0], [0.2, 0, 0.8]])
    behind = np.array([[0.0, 0, 0], [0.6, 0, 0]])
    walked = []
    for points in (side[:1], side, behind):
        people = {"points": placed(simulator.folder, points), "route": ["g"]}
        systems = crowd([people], goals=[goal("g", 60, 0)], avoidance={"headway": 1.5})
        track = tracks(simulator.simulate(systems, times(4))["it"])
        walked.append(track[-1, 0, 0] - track[0, 0, 0])
    alone, abreast, following = walked
    assert abreast == pytest.approx(alone, rel=0.03)
    assert following < 0.9 * alone


@pytest.mark.slow
def test_flow_through_a_door_is_as_published(simulator: Simulator) -> None:
    """From 1.2 to 1.9 persons a metre and second (Seyfried et al., 2009)."""
    width = 1.2
    k = np.arange(120)
    points = np.stack([(k % 12 - 5.5) * 0.6, 0 * k, -1.5 - (k // 12) * 0.6], axis=1)
    systems = crowd(
        [{"points": placed(simulator.folder, points), "route": ["g"], "radius": 0.2}],
        goals=[goal("g", 0, 12)],
        colliders=[box(s * (5 + width / 2), 0, 10, 0.3) for s in (-1, 1)],
    )
    track = tracks(simulator.simulate(systems, times(50))["it"])
    through = np.sort(np.argmax(track[:, :, 1] > 0, axis=0) / FPS)
    through = through[through > 0]
    assert len(through) > 80
    first, last = len(through) // 5, len(through) * 4 // 5
    flow = (last - first) / (through[last] - through[first]) / width
    assert 1.0 < flow < 2.0
    assert closest(track) > 2 * 0.2 - TOUCHING
    # Nobody is in a wall: they begin at half the width.
    inside = (np.abs(track[..., 1]) < 0.15 + 0.2 - TOUCHING) & (
        np.abs(track[..., 0]) > width / 2 + TOUCHING
    )
    assert not inside.any()


@pytest.mark.slow
@pytest.mark.parametrize("density", [1.0, 2.0])
def test_who_is_crowded_walks_as_slowly_as_people(
    simulator: Simulator, density: float
) -> None:
    """Weidmann's fundamental diagram (1993), within a fifth."""
    wide, long = 4.0, 40.0
    columns = round(wide * np.sqrt(density))
    k = np.arange(round(density * wide * long))
    apart = wide / columns
    points = np.stack(
        [(k % columns + 0.5) * apart - wide / 2, 0 * k, k // columns / density / apart],
        axis=1,
    )
    points[:, [0, 2]] += np.random.default_rng(0).uniform(-0.05, 0.05, (len(k), 2))
    systems = crowd(
        [{"points": placed(simulator.folder, points), "route": ["g"], "radius": 0.22}],
        goals=[goal("g", 0, 200)],
        colliders=[box(s * (wide / 2 + 0.4), 50, 0.3, 200) for s in (-1, 1)],
        cell=0.5,
    )
    track = tracks(simulator.simulate(systems, times(10))["it"])
    behind = points[:, 2] < long / 2
    speed = (track[-1] - track[-20])[behind, 1].mean() / (19 / FPS)
    published = 1.34 * (1 - np.exp(-1.913 * (1 / density - 1 / 5.4)))
    assert speed == pytest.approx(published, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(("width", "count", "yaw"), [(3.2, 60, 0.0), (2.8, 40, 0.8)])
def test_two_streams_in_a_corridor_get_by_each_other(
    simulator: Simulator, width: float, count: int, yaw: float
) -> None:
    """People form lanes (Zhang et al., 2012): most are through, past a pillar."""
    rng = np.random.default_rng(7)
    half = count // 2
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    rotate = [float(np.cos(yaw / 2)), 0, float(np.sin(yaw / 2)), 0]
    populations, goals = [], []
    for k, way in enumerate((-1, 1)):
        along = way * rng.uniform(5, 11, half)
        across = rng.uniform(0.4 - width / 2, width / 2 - 0.4, half)
        starts = np.insert(np.stack([along, across], axis=1) @ turn, 1, 0.0, axis=1)
        np.savez(simulator.folder / f"stream{k}.npz", points=starts)
        file = str(simulator.folder / f"stream{k}.npz")
        populations.append({"points": file, "route": [f"g{k}"], "seed": k})
        x, z = (np.array([-14.0 * way, 0]) @ turn).tolist()
        goals.append(goal(f"g{k}", x, z, radius=1.5))
    walls = []
    for way in (-1, 1):
        x, z = (np.array([0, way * (width / 2 + 0.1)]) @ turn).tolist()
        walls.append(box(x, z, 40, 0.2, rotate=rotate))
    x, z = (np.array([0.0, 0.2]) @ turn).tolist()
    pillar = {"shape": {"capsule": {"radius": 0.3, "length": 3}}, "at": [x, 1.5, z]}
    systems = crowd(populations, goals=goals, colliders=[*walls, pillar])
    track = tracks(simulator.simulate(systems, times(45))["it"])
    along = (track[-1] @ turn.T)[:, 0] * np.repeat([1, -1], half)
    assert (along > 9).sum() >= count * 5 / 6
    assert closest(track) > 2 * 0.22 - TOUCHING


@pytest.mark.slow(0.5)
def test_queues_serve_one_at_a_time_and_doors_let_nobody_through_shut(
    simulator: Simulator,
) -> None:
    desk = goal("desk", 0, 0, wait=2, radius=0.3, queue={"direction": [0, 0, -1]})
    door = {"begin": [-2, 0, 3], "end": [2, 0, 3], "opens": [[9, 12]]}
    systems = crowd(
        [
            {
                "count": 5,
                "at": [0, 0, -6],
                "place": {"disc": {"radius": 2}},
                "route": ["desk", "out"],
            }
        ],
        goals=[desk, goal("out", 0, 8)],
        doors=[door],
        colliders=[box(s * 5, 3, 6, 0.3) for s in (-1, 1)],
    )
    track = tracks(simulator.simulate(systems, times(24))["it"])
    at_desk = np.linalg.norm(track, axis=2) < 0.3
    # Nobody is at the desk along with another, and each is for two seconds.
    assert at_desk.sum(axis=1).max() == 1
    assert (at_desk.sum(axis=0) >= 2 * FPS).sum() >= 4
    beyond = track[..., 1] > 3
    crossed = np.flatnonzero(np.diff(beyond.sum(axis=1)) > 0) / FPS
    assert len(crossed)
    assert crossed.min() >= 9
    assert crossed.max() <= 12 + 1 / FPS


def test_groups_stay_together_and_who_leaves_is_gone(simulator: Simulator) -> None:
    systems = crowd(
        [
            {"count": 12, "group": 3, "place": {"disc": {"radius": 5}}, "route": ["g"]},
            {"count": 4, "at": [0, 0, 9], "route": ["g"], "then": "leave"},
        ],
        goals=[goal("g", 0, 14, radius=2)],
    )
    rows = simulator.simulate(systems, times(7))["it"]
    assert len(rows[0].ids) == 16
    assert len(rows[-1].ids) == 12
    together = rows[-1].points[:12, [0, 2]].reshape(4, 3, 2)
    assert np.linalg.norm(together - together.mean(axis=1)[:, None], axis=2).max() < 1.5


def test_what_moves_is_avoided_and_never_entered(simulator: Simulator) -> None:
    rock = {
        "shape": {"sphere": {"radius": 0.8}},
        "at": [0, 0.8, -6],
        "moves": [[0, 0, 0, 0], [8, 0, 0, 16]],
    }
    systems = crowd(
        [{"count": 40, "place": {"disc": {"radius": 4}}, "radius": RADIUS}],
        colliders=[rock],
    )
    track = tracks(simulator.simulate(systems, times(8))["it"])
    rocks = np.stack(
        [0 * np.arange(len(track)), -6 + 2 * np.arange(len(track)) / FPS], 1
    )
    far = np.linalg.norm(track - rocks[:, None], axis=2)
    assert far.min() > 0.8 + RADIUS - 2 * TOUCHING
    assert closest(track) > 2 * RADIUS - TOUCHING


def ground(folder: Path) -> dict[str, Any]:
    """Return a square that rises by .2 along x, with a hole of 2 m in its middle."""
    x = np.array([-10.0, -1.0, 1.0, 10.0])
    points = np.array([[a, 0.2 * a, b] for a in x for b in x])
    faces = [
        corner
        for i in range(3)
        for j in range(3)
        if (i, j) != (1, 1)
        for a in [4 * i + j]
        for corner in ([a, a + 1, a + 4], [a + 1, a + 5, a + 4])
    ]
    np.savez(folder / "ground.npz", points=points, triangles=np.array(faces))
    file = str(folder / "ground.npz")
    return {"shape": {"mesh": {"points": file, "triangles": file}}}


@pytest.mark.slow
def test_agents_walk_on_a_mesh_and_around_its_holes(simulator: Simulator) -> None:
    systems = crowd(
        [
            {
                "count": 30,
                "at": [-7, 0, 0],
                "place": {"disc": {"radius": 2}},
                "route": ["g"],
            }
        ],
        goals=[goal("g", 8, 0, radius=1.5)],
        ground=ground(simulator.folder),
    )
    rows = simulator.simulate(systems, times(20))["it"]
    points = np.stack([row.points for row in rows])
    assert np.abs(points[..., 1] - 0.2 * points[..., 0]).max() < 1e-12
    assert np.abs(points[..., [0, 2]]).max(axis=2).min() > 1
    assert (points[-1, :, 0] > 2).all()
    steps = np.stack([row.velocities for row in rows])
    assert np.abs(steps[..., 1] - 0.2 * steps[..., 0]).max() < 1e-12


@pytest.mark.slow
def test_what_is_odd_is_named_and_mended(simulator: Simulator) -> None:
    odd = np.array([[0.0, 0, 0], [0.1, 0, 0], [5, 0, 0]])
    systems = crowd(
        [{"points": placed(simulator.folder, odd), "route": ["inside", "closed"]}],
        goals=[goal("inside", 5, 5), goal("closed", 20, 0)],
        colliders=[
            {**box(5, 0, 2, 2), "name": "block"},
            box(5, 5, 2, 2),
            *(box(20 + x, z, *size) for x, z, *size in (
                (-3, 0, 0.5, 6.5), (3, 0, 0.5, 6.5), (0, -3, 6.5, 0.5), (0, 3, 6.5, 0.5)
            )),
        ],
    )  # fmt: skip
    said = notices(simulator, systems)
    assert said.keys() == {"SIM146", "SIM147", "SIM148"}
    assert "2 agents would start inside each other" in said["SIM147"]
    assert "1 agent would start in an obstacle or off the ground" in said["SIM148"]
    assert "agent 2 of 'p0'" in said["SIM148"]
    assert "'closed'" in said["SIM146"]
    track = tracks(simulator.simulate(systems, times(25))["it"])
    assert closest(track) > 2 * 0.22 - TOUCHING
    # Near to the goal in the block, then to that behind walls.
    assert track[-1, :, 0].min() > 12


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"goals": [goal("g", 0, 0), goal("g", 1, 1)]}, "two goals are named 'g'"),
        ({"doors": [door([1, 0, 0], [3, 1])]}, "from 3 s to 1 s"),
        ({"doors": [door([0, 0, 0])]}, "are at the same position on the ground"),
        ({"doors": [door([0, 2, 0])]}, "are at the same position on the ground"),
        (
            {"ground": {"moves": [[0, 0, 0, 0], [1, 0, 1, 0]]}},
            "the ground cannot move",
        ),
        (
            {"ground": {"shape": {"sphere": {"radius": 1}}}},
            "the ground must be a mesh, a height_field or, without a shape, a plane",
        ),
        (
            {"goals": [goal("g", 0, 0, queue={"direction": [0, 1, 0]})]},
            "the direction of a queue is vertical",
        ),
    ],
)
def test_what_makes_no_sense_is_refused(
    simulator: Simulator, keys: dict[str, Any], message: str
) -> None:
    with raises(AnimtoolError, "SIM145", match=message) as error:
        simulator.simulate(crowd([{"count": 1}], **keys), [0.0])
    assert [fault.code for fault in error.value.faults] == ["SIM145"]
    assert all(fault.lines for fault in error.value.faults)


def test_routes_lead_to_known_goals(simulator: Simulator) -> None:
    with raises(AnimtoolError, "SIM145", match=r"\.route\[0\]: .*'no'"):
        simulator.simulate(crowd([{"count": 1, "route": ["no"]}]), [0.0])


def test_the_population_that_does_not_fit_is_named(simulator: Simulator) -> None:
    region = {"place": {"disc": {"radius": 1}}, "route": ["g"]}
    few, many = {**region, "count": 2, "at": [50, 0, 0]}, {**region, "count": 200}
    people = crowd([few, many], goals=[goal("g", 9, 0)])
    assert "'p1'" in notices(simulator, people)["SIM147"]


def test_a_route_leads_through_no_door(simulator: Simulator) -> None:
    goals, doors = [goal("g", 0, 0)], [{**door([1, 0, 0]), "name": "gate"}]
    people = crowd([{"count": 1, "route": ["g", "gate"]}], goals=goals, doors=doors)
    with raises(AnimtoolError, "SIM145", match=r"\.route\[1\]: 'gate' is a door"):
        simulator.simulate(people, [0.0])


def test_a_run_goes_on_from_its_state(simulator: Simulator) -> None:
    systems = crowd(
        [{"count": 20, "place": {"disc": {"radius": 3}}, "route": ["g"]}],
        goals=[goal("g", 6, 0)],
        colliders=[box(3, 0, 0.5, 2)],
    )

    def run(state: Any = None) -> SimulationRun:
        (made,) = open_systems(simulator.scene(systems).systems, 4.0)
        assert isinstance(made, SimulationRun)
        return SimulationRun("it", made.simulation, 0.0, 0.05, state)

    whole = run()
    whole.at(2.0)
    rest = run(whole.state)
    np.testing.assert_array_equal(rest.at(4.0).points, whole.at(4.0).points)


def test_crowds_and_rocks_go_on_from_their_states(simulator: Simulator) -> None:
    """Where both are resumed nothing is known of the rocks before."""
    rocks = {
        "name": "rocks",
        "bodies": [
            {
                "name": "rock",
                "shape": {"sphere": {"radius": 0.5}},
                "at": [0, 0.5, -4],
                "velocity": [0, 0, 3],
            }
        ],
        "colliders": [{"shape": {"plane": {}}}],
    }
    people = crowd(
        [{"count": 12, "place": {"disc": {"radius": 2}}}], systems=[{"system": "rocks"}]
    )[0]["crowds"]

    def points(kept: dict[str, Any], times: list[float]) -> list[np.ndarray]:
        systems = [
            {"rigid": {**rocks, **{k: f"rocks_{v}" for k, v in kept.items()}}},
            {"crowds": {**people, **{k: f"people_{v}" for k, v in kept.items()}}},
        ]
        run = SystemRun(simulator.scene(systems).systems, times[-1], None, None)
        codes = [round(t * 24) for t in times]
        rows = [row[1].points for _, row in run.coded_frames(codes, 0, 24)]  # type: ignore[arg-type]
        run.save_states(simulator.folder)
        return rows

    whole = points({}, [0.5, 1.0, 1.5, 2.0])
    points({"save": "a.npz"}, [0.5, 1.0])
    rest = points({"resume": "a.npz"}, [1.0, 1.5, 2.0])
    for one, other in zip(whole[1:], rest, strict=True):
        np.testing.assert_array_equal(one, other)


def test_who_is_squeezed_is_moved_apart_in_a_hundred_rounds(
    simulator: Simulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A row, each deep in the next: a round less leaves more, one more less."""
    points = np.zeros((120, 3))
    points[:, 0] = np.arange(120)
    row = crowd([{"radius": RADIUS, "points": placed(simulator.folder, points)}])
    (made,) = open_systems(simulator.scene(row).systems, 0.05)
    assert isinstance(made, SimulationRun)
    begun = made.simulation.initial_state()
    squeezed = replace(begun, points=0.001 * begun.points)
    seen: list[dict[str, Any]] = []
    step = crowds._kernels.crowd_step

    def spy(**given: Any) -> Any:
        seen.append(given)
        return step(**given)

    monkeypatch.setattr(crowds._kernels, "crowd_step", spy)
    left = made.simulation.step(squeezed, 0.0, 0.05).overlap
    (given,) = seen
    fewer, same, more = (
        step(**{**given, "max_passes": rounds})[2] for rounds in (99, 100, 101)
    )
    assert left == same
    assert fewer > left > more > 0


def test_who_is_knocked_down_falls_as_he_stood_and_was_about_to_walk() -> None:
    """Two of three, by 1.5 and -2 m/s for half a second; the hit moves nobody."""
    x = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    v = np.array([[1.5, 0.0], [9.0, 9.0], [0.0, -2.0]])
    state: Any = SimpleNamespace(
        points=x, velocities=v, headings=np.array([0.1, 0.2, 0.3]), bodies="stood"
    )
    hits = []

    def next_(bodies: str, here: Any, ahead: Any, dt: float, hit: np.ndarray) -> str:
        hits.append((bodies, dt, hit.tolist()))
        np.testing.assert_array_equal(here.points, x)
        np.testing.assert_array_equal(ahead.headings, here.headings)
        return "walked"

    own: Any = SimpleNamespace(
        cast=SimpleNamespace(advance=next_),
        fall_simulator=SimpleNamespace(add_falls=lambda *given: given),
        _world=lambda bodies, going, i: (bodies, going.points[i].tolist()),
    )
    made: Any = crowds.Crowd._add_falls(own, state, "falls", np.array([0, 2]), 0.5)  # type: ignore[arg-type]
    assert hits == [("stood", 0.5, [False] * 3)]
    falls, fell, now, soon, dt = made
    assert (falls, fell.tolist(), dt) == ("falls", [0, 2], 0.5)
    assert now == [("stood", [1.0, 2.0]), ("stood", [5.0, 6.0])]
    assert soon == [("walked", [1.75, 2.0]), ("walked", [5.0, 5.0])]


def test_who_fell_stays_and_who_left_is_out(
    simulator: Simulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the kernel knows them: 0 walks, 1 keeps its room, 2 is nowhere."""
    points = np.array([[0.0, 0, 0], [2.0, 0, 0], [4.0, 0, 0]])
    row = crowd([{"radius": RADIUS, "points": placed(simulator.folder, points)}])
    (made,) = open_systems(simulator.scene(row).systems, 0.05)
    assert isinstance(made, SimulationRun)
    begun = made.simulation.initial_state()
    stages = np.array([0, 0, DEPARTED_STAGE])
    progress = replace(begun.progress, stages=stages)
    fell: Any = SimpleNamespace(agents=np.array([1]))
    seen: list[list[int]] = []
    step = crowds._kernels.crowd_step

    def spy(**given: Any) -> Any:
        seen.append(given["modes"].tolist())
        return step(**given)

    monkeypatch.setattr(crowds._kernels, "crowd_step", spy)
    made.simulation.step(replace(begun, progress=progress, falls=fell), 0.0, 0.05)
    assert seen == [[0, 1, 2]]


@pytest.mark.parametrize(
    ("x", "message"),
    [
        (5.0, "1 m inside the collider 'block'"),
        (3.95, "50 mm from the collider 'block', less than the agents' radius"),
        (0.0, None),
    ],
)
def test_a_goal_in_an_obstacle_names_it(
    simulator: Simulator, x: float, message: str | None
) -> None:
    systems = crowd(
        [{"count": 1, "at": [-7, 0, 0], "route": ["g"]}],
        goals=[goal("far", -5, 0), goal("g", x, 0)],
        colliders=[{**box(5, 0, 2, 2), "name": "block"}],
    )
    scene = simulator.scene(systems)
    run = SystemRun(scene.systems, 0.0, None, None)
    list(run.coded_frames([scene.bake.frame_range.first], 1, FPS))  # type: ignore[union-attr]
    assert [one.code for one in run.notices] == ["SIM146"] * (message is not None)
    for notice in run.notices:
        assert str(notice.where).endswith("goals[1].at")
        assert message is not None
        assert message in notice.message
        assert "agents go to [" in notice.message
