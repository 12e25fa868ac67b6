"""Flocks as scenes have them: who begins where, what they avoid, what is refused."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.nasty import write_nasty_clip
from support.simulated import Simulator
from support.suite import some_quick

from animtool import Rig
from animtool.core.errors import AnimtoolError
from animtool.maths import so3
from animtool.motion.frames import TransformsFrame
from animtool.scene.systems.run import SystemRun
from animtool.scene.systems.simulation import open_systems
from animtool.systems.flocks.rules import min_distance
from animtool.systems.flocks.spec import SpeciesModel
from animtool.systems.framework.run import ReachedState, SimulationRun

FRAMES = (np.arange(24) / 24).tolist()
BIRD = {"name": "bird", "count": 30, "seed": 3}
PLANE = (
    '#usda 1.0\n(\n    metersPerUnit = 1\n)\ndef Mesh "bird" {\n'
    "point3f[] points = [(0, 0, 1), (1, 0, 0), (-1, 0, 0)]\n"
    "point3f[] points.timeSamples = {1: [(0, 0, 1), (1, 0, 0), (-1, 0, 0)], "
    "5: [(0, 0, 1), (1, 1, 0), (-1, 1, 0)], 9: [(0, 0, 1), (1, 0, 0), (-1, 0, 0)]}\n"
    "int[] faceVertexCounts = [3]\nint[] faceVertexIndices = [0, 1, 2]\n}\n"
)


@pytest.fixture
def simulator(tmp_path: Path) -> Simulator:
    return Simulator(tmp_path)


def flock(*species: dict[str, Any], **keys: Any) -> list[dict[str, Any]]:
    return [{"flocks": {"name": "it", "species": list(species), **keys}}]


def test_goals_draw_paths_lead_and_hawks_scatter(simulator: Simulator) -> None:
    def last(**changes: Any) -> np.ndarray:
        rows = simulator.simulate(flock({**BIRD, **changes}), FRAMES)["it"]
        return np.asarray(rows[-1].points)

    alone = last()
    drawn = last(goals=[{"at": [50, 0, 0], "weight": 1, "limit": 5}])
    # A constant pull of 5 m/s² against what keeps the speed.
    assert 0.5 < (drawn - alone).mean(axis=0)[0] < 2.5
    way = [[0, 0, 0], [0, 30, 0]]
    led = last(paths=[{"points": way, "weight": 4}])
    assert (led - alone).mean(axis=0)[1] > 1
    hawk = {"name": "hawk", "count": 1, "place": {"point": None}}
    fled = simulator.simulate(
        flock({**BIRD, "flees": [{"species": "hawk", "weight": 9, "radius": 9}]}, hawk),
        FRAMES,
    )["it"]
    spreads = [
        np.linalg.norm(rows - rows.mean(axis=0), axis=1).mean()
        for rows in (alone, fled[-1].points[:30])
    ]
    assert spreads[1] > 1.5 * spreads[0]
    assert fled[-1].primvars["species"].tolist() == [0] * 30 + [1]


def test_a_hawk_reaches_who_is_slow(simulator: Simulator) -> None:
    hawk = {
        "name": "hawk", "count": 1, "at": [0, 0, -6], "speed": {"cruise": 6},
        "place": {"point": None}, "chases": [{"species": "bird", "weight": 20,
        "radius": 30}],
    }  # fmt: skip
    rows = simulator.simulate(flock({**BIRD, "count": 1}, hawk), np.arange(73) / 24)
    gaps = [np.linalg.norm(row.points[0] - row.points[1]) for row in rows["it"]]
    assert min(gaps) < 0.5


@pytest.mark.parametrize(
    ("method", "step"),
    some_quick(
        [
            pytest.param("symplectic_euler", 0.005),
            pytest.param("symplectic_euler", 0.04),
            pytest.param("rk4", 0.02),
        ],
        3,
        1,
    ),
)
def test_nobody_is_in_an_obstacle_at_any_frame(
    step: float, method: str, simulator: Simulator
) -> None:
    """A tower, a ball that is thrown at them, walls and a ground that rises."""
    tower = np.array([0, 0, 6.0])
    keys = {
        "colliders": [
            {"shape": {"capsule": {"radius": 1, "length": 9}}, "at": tower.tolist()},
            {
                "shape": {"sphere": {"radius": 1.5}},
                "at": [0, 0, 14],
                "moves": [[0, 0, 0, 0], [1, 0, 0, -12]],
            },
            {
                "shape": {"plane": {}},
                "at": [0, -4, 0],
                "moves": [[0, 0, 0, 0], [2, 0, 3, 0]],
            },
        ],
        "domain": {"size": [16, 16, 30]},
        "step": step,
        "method": method,
    }  # fmt: skip
    fast = {**BIRD, "count": 200, "speed": {"cruise": 12, "most": 20}, "radius": 0.1}
    times = np.arange(48) / 24
    for t, row in zip(
        times, simulator.simulate(flock(fast, **keys), times)["it"], strict=True
    ):
        x = row.points
        apart = x - tower
        apart[:, 1] -= np.clip(apart[:, 1], -4.5, 4.5)
        ball = np.array([0, 0, 14 - 12 * min(t, 1)])
        gaps = [
            np.linalg.norm(apart, axis=1) - 1,
            np.linalg.norm(x - ball, axis=1) - 1.5,
            x[:, 1] + 4 - 1.5 * t,
            (np.array([8, 8, 15]) - np.abs(x)).min(axis=1),
        ]
        assert min(gap.min() for gap in gaps) > 0.1 - 1e-6
        assert (np.linalg.norm(row.velocities, axis=1) < 20 + 1e-9 + 12).all()


def test_who_begins_in_a_collider_is_moved_out(simulator: Simulator) -> None:
    ball = {"name": "rock", "shape": {"sphere": {"radius": 1.5}}}
    scene = simulator.scene(flock(BIRD, colliders=[ball]))
    run = SystemRun(scene.systems, 0.0)
    ((_, (row,)),) = run.coded_frames([0], 0, 1)  # type: ignore[list-item,arg-type]
    assert np.linalg.norm(row.points, axis=1).min() >= 1.6
    (notice,) = run.notices
    assert notice.code == "SIM124"
    assert "member" in notice.message


@pytest.mark.parametrize(
    ("domain", "count", "hint"),
    [
        ({"size": [20, 6, 20], "at": [0, 9, 0]}, 12, "with its centre `at` [0, "),
        ({"size": [20, 2.1, 20], "at": [0, 9, 0]}, 12, "a size of [20, 21, 20] m"),
        ({"size": [20, 20, 20]}, 0, ""),
        ({"size": [20, 6, 20], "at": [0, 9, 0], "wrap": True}, 0, ""),
    ],
)
def test_members_outside_of_the_domain_are_one_warning(
    simulator: Simulator, domain: dict[str, Any], count: int, hint: str
) -> None:
    place = {"box": {"size": [2, 2, 2]}}
    bird = {**BIRD, "count": 12, "at": [0, 0, 0], "place": place, "radius": 0.2}
    vision = {"vision": {"radius": 0.8}}
    scene = simulator.scene(flock({**bird, **vision}, domain=domain))
    run = SystemRun(scene.systems, 0.0)
    list(run.coded_frames([0], 0, 1))
    assert [one.code for one in run.notices] == ["SIM124"] * bool(count)
    for notice in run.notices:
        assert notice.message.startswith(f"{count} of 12 members start outside")
        assert "along y" in notice.message
        assert str(notice.where).endswith("domain")
        assert hint in str(notice.hint)


def test_who_finds_no_way_out_of_colliders_is_named(simulator: Simulator) -> None:
    """The second of three, where two boxes overlap: each moves it into the other."""
    boxes = [{"shape": {"box": {"size": [9, 9, 9]}}, "at": [x, 0, 0]} for x in (-4, 4)]
    points = np.array([[0.0, 20, 0], [0, 0, 0], [0, -20, 0]])
    np.savez(simulator.folder / "three.npz", points=points)
    bird = {"name": "bird", "points": "three.npz", "radius": 0.1}
    with pytest.raises(AnimtoolError) as error:
        simulator.simulate(flock(bird, colliders=boxes), FRAMES[:2])
    (fault,) = error.value.faults
    assert fault.code == "SIM060"
    assert "member 1 of 'bird' starts inside" in fault.message


def test_a_domain_that_wraps_keeps_all_and_shows_no_seam(simulator: Simulator) -> None:
    domain = {"at": [1, 2, 3], "size": [6, 5, 7], "wrap": True}
    crowd = {**BIRD, "count": 80, "speed": {"cruise": 9}}
    rows = simulator.simulate(flock(crowd, domain=domain), FRAMES)["it"]
    size = np.array([6, 5, 7])
    low = np.array([1, 2, 3]) - size / 2
    crossed = 0
    for before, after in pairwise(rows):
        assert (after.points >= low).all()
        assert (after.points <= low + size).all()
        jumps = np.abs(after.points - before.points) > 2.5
        crossed += int(jumps.sum())
    assert crossed
    # Put elsewhere by a part of its length, it flies alike.
    moved = {**domain, "at": [1.7, 2, 3]}
    others = simulator.simulate(flock(crowd, domain=moved), FRAMES)["it"]
    off = others[6].points - rows[6].points
    off -= size * np.round(off / size)
    assert_allclose(off, 0, atol=1e-9)


def test_limits_of_speed_and_turning_hold(simulator: Simulator) -> None:
    slow = {
        **BIRD, "speed": {"cruise": 4, "least": 3, "most": 5}, "turning": 90,
        "goals": [{"at": [-40, 0, 0], "weight": 3}], "acceleration": 50,
    }  # fmt: skip
    rows = simulator.simulate(flock(slow, step=0.002), FRAMES)["it"]
    speeds = np.array([np.linalg.norm(row.velocities, axis=1) for row in rows])
    assert (speeds > 3 - 1e-9).all()
    assert (speeds < 5 + 1e-9).all()
    ways = np.array([row.velocities for row in rows]) / speeds[..., None]
    turned = np.degrees(np.arccos(np.clip((ways[1:] * ways[:-1]).sum(axis=2), -1, 1)))
    assert turned.max() * 24 < 90 * 1.01
    assert turned.max() * 24 > 80


def test_gone_on_from_the_middle_it_is_the_same(simulator: Simulator) -> None:
    scene = simulator.scene(flock(BIRD, forces=[{"gravity": None}]))
    (whole,) = open_systems(scene.systems, 1.0)
    assert isinstance(whole, SimulationRun)
    whole.at(0.4)
    middle = whole.state
    assert isinstance(middle, ReachedState)
    end = whole.at(0.8)
    again = SimulationRun("it", whole.simulation, 0.0, whole.step_length, middle)
    assert_array_equal(again.at(0.8).points, end.points)


def test_members_that_show_a_mesh_head_along_their_way(
    simulator: Simulator, tmp_path: Path
) -> None:
    (tmp_path / "bird.usda").write_text(PLANE, "utf-8")
    mesh_indices = {
        **BIRD, "shows": {"file": "bird.usda", "prim": "/bird", "samples": 8},
        "beat": 3, "goals": [{"at": [20, 0, 0], "weight": 1}], "banking": 1,
    }  # fmt: skip
    steps = np.arange(48) / 96
    rows = simulator.simulate(flock(mesh_indices, step=1 / 96), steps)["it"]
    shows = set()
    for before, row in pairwise(rows):
        assert isinstance(row, TransformsFrame)
        assert len(row.meshes) == 8
        shows |= set(row.mesh_indices.tolist())
        ways = row.velocities / np.linalg.norm(row.velocities, axis=1)[:, None]
        assert_allclose(so3.rotate(row.rotations, [0.0, 0, 1]), ways, atol=1e-9)
        # Spinning so for a step, each came to be as it is.
        spun = so3.multiply(so3.exp(row.spins / 96), before.rotations)
        assert so3.angle_between(spun, row.rotations).max() < 1e-7
    assert shows == set(range(8))
    # All turn to x: who leans into it has its up there too.
    assert so3.rotate(rows[24].rotations, [0.0, 1, 0])[:, 0].mean() > 0.1
    still = {**mesh_indices, "banking": 0}
    level = simulator.simulate(flock(still, step=1 / 96), steps)["it"][24]
    tilts = [
        np.abs(so3.rotate(row.rotations, [1.0, 0, 0])[:, 1]).mean()
        for row in (level, rows[24])
    ]
    assert tilts[0] < 0.3 * tilts[1]
    heights = rows[0].meshes[2].points[1, 1], rows[0].meshes[4].points[1, 1]
    assert_allclose(heights, (0.5, 1.0))


TWO = {**BIRD, "name": "other"}
FAULTS = {
    "one position": (
        flock({**BIRD, "place": {"point": None}}), "SIM060", "the same position"
    ),
    "no such species": (flock({**BIRD, "joins": ["brid"]}), "SIM060", "joins[0]"),
    "no such prey": (
        flock({**BIRD, "chases": [{"species": "x", "weight": 1, "radius": 1}]}),
        "SIM060", "species[0].chases[0].species",
    ),
    "two of a name": (flock(BIRD, BIRD), "SIM060", "'bird'"),
    "a cruise that is too fast": (
        flock({**BIRD, "speed": {"cruise": 3, "most": 2}}),
        "SIM060", "species[0].speed.most",
    ),
    "a least speed above the cruise": (
        flock({**BIRD, "speed": {"cruise": 6, "least": 8}}),
        "SIM060", "species[0].speed.least",
    ),
    "a least speed above the most": (
        flock({**BIRD, "speed": {"cruise": 6, "least": 8, "most": 7}}),
        "SIM060", "species[0].speed.least",
    ),
    "a domain that is too small": (
        flock(BIRD, domain={"size": [3, 9, 9], "wrap": True}), "SIM060", "domain"
    ),
    "walls that touch": (
        flock(BIRD, domain={"size": [0.1, 9, 9]}), "SIM060", "domain"
    ),
    "points and meshes": (
        flock(BIRD, {**TWO, "shows": {"file": "bird.usda", "prim": "/bird"}}),
        "SIM060", "mesh",
    ),
    "held by two": (
        flock(
            {**BIRD, "count": 1, "place": {"point": None}},
            colliders=[
                {"shape": {"plane": {"normal": [0, y, 0]}}, "at": [0, -y * 0.01, 0]}
                for y in (1, -1)
            ],
        ),
        "SIM060", "no way out",
    ),
    "no radius": (flock({**BIRD, "vision": {"radius": 0}}), "DOC0", "radius"),
    "no number": (
        flock({**BIRD, "attraction": {"weight": float("nan")}}), "DOC0", "weight"
    ),
    "unknown method": (flock(BIRD, method="rk5"), "SIM001", "rk5"),
    "a method that cannot stop": (flock(BIRD, method="lsoda"), "SIM006", "lsoda"),
    "no file": (
        flock({**BIRD, "shows": {"file": "none.usda", "prim": "/a"}}), "", "none.usda"
    ),
    "a mesh of nothing": (
        flock({**BIRD, "shows": {"file": "bird.usda"}}), "SIM053", "prim"
    ),
    "which does not exist": (
        flock({**BIRD, "shows": {"file": "bird.usda", "prim": "/brid"}}),
        "SIM051", "/brid",
    ),
    "a crowd": (
        flock({**BIRD, "count": 60_000, "place": {"sphere": {"radius": 0.01}}}),
        "SIM107", "close",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", FAULTS)
def test_what_makes_no_sense_is_refused(
    case: str, simulator: Simulator, tmp_path: Path
) -> None:
    (tmp_path / "bird.usda").write_text(PLANE, "utf-8")
    systems, code, word = FAULTS[case]
    with pytest.raises(AnimtoolError) as error:
        simulator.simulate(systems, [0.0, 0.1])
    fault = error.value.faults[0]
    assert fault.code.startswith(code)
    assert word in str(error.value)
    assert fault.lines == (1,)
    assert (fault.where or "").startswith("systems[0].flocks")


def test_velocities_align_as_those_of_cucker_and_smale(simulator: Simulator) -> None:
    """Where all see all, each goes to the mean exponentially (Cucker, Smale, 2007)."""
    alike = {
        **BIRD, "spread": 90, "vision": {"radius": 100}, "attraction": {"weight": 0},
        "repulsion": {"weight": 0}, "alignment": {"weight": 1.5},
        "speed": {"weight": 0, "most": 50},
    }  # fmt: skip
    rows = simulator.simulate(flock(alike, method="rk4", step=1 / 96), FRAMES)["it"]
    velocities = np.array([row.velocities for row in rows])
    middle = velocities.mean(axis=1, keepdims=True)
    assert_allclose(middle, np.broadcast_to(middle[0], middle.shape), atol=1e-12)
    # The mean of the others is farther from one than that of all.
    decay = np.exp(-1.5 * 30 / 29 * np.array(FRAMES))[:, None, None]
    assert_allclose(velocities - middle, decay * (velocities - middle)[0], atol=1e-9)


@pytest.mark.slow
def test_two_keep_the_distance_at_which_pull_and_push_are_equal(
    simulator: Simulator, tmp_path: Path
) -> None:
    np.savez(tmp_path / "two.npz", points=[[0.0, 0, 0], [0.9, 0, 0]])
    np.savez(tmp_path / "still.npz", velocities=np.zeros((2, 3)))
    two = {
        "name": "fish", "points": "two.npz", "velocities": "still.npz#velocities",
        "vision": {"radius": 5}, "attraction": {"weight": 2}, "speed": {"weight": 0},
        "alignment": {"weight": 3}, "repulsion": {"weight": 0.5, "softening": 0.3},
    }  # fmt: skip
    rows = simulator.simulate(flock(two), np.arange(0, 481, 480) / 24)["it"]
    gap = np.linalg.norm(rows[-1].points[1] - rows[-1].points[0])
    assert gap == pytest.approx(np.sqrt(0.5 / 2 - 0.3**2), abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("wrap", [False, True])
def test_no_two_are_nearer_than_their_least_distance(
    simulator: Simulator, wrap: bool
) -> None:
    """Of two species, in a crowd that a goal draws together; without repulsion any."""
    crowd = {
        **BIRD, "count": 80, "radius": 0.15, "attraction": {"weight": 3},
        "goals": [{"at": [0, 0, 2], "weight": 2}], "turning": 200,
    }  # fmt: skip
    large = {**crowd, "name": "crow", "count": 10, "seed": 8, "radius": 0.3}
    keys = {"domain": {"size": [8, 8, 8], "wrap": True}} if wrap else {}

    def nearest(*species: dict[str, Any]) -> float:
        rows = simulator.simulate(flock(*species, **keys), FRAMES)["it"]
        counts = [one["count"] for one in species]
        radii = np.repeat([one["radius"] for one in species], counts)
        shares = []
        for row in rows:
            off = row.points[:, None] - row.points
            off -= 8 * np.round(off / 8) if wrap else 0
            far = np.linalg.norm(off, axis=2) / (radii[:, None] + radii)
            shares.append(far[~np.eye(len(far), dtype=bool)].min())
        return min(shares)

    assert nearest(crowd, large) > 0.99
    free = {"repulsion": {"weight": 0}}
    assert nearest({**crowd, **free}, {**large, **free}) < 0.6


def test_who_is_given_a_place_in_another_is_moved_with_a_word(
    simulator: Simulator, tmp_path: Path
) -> None:
    np.savez(tmp_path / "two.npz", points=[[0.0, 0, 0], [0.05, 0, 0]])
    scene = simulator.scene(flock({"name": "fish", "points": "two.npz", "radius": 0.1}))
    run = SystemRun(scene.systems, 0.0)
    ((_, (row,)),) = run.coded_frames([0], 0, 1)  # type: ignore[list-item,arg-type]
    assert np.linalg.norm(row.points[1] - row.points[0]) >= 0.2
    assert [notice.code for notice in run.notices] == ["SIM147"]


@pytest.mark.slow
def test_random_directions_become_one_in_a_domain_without_walls(
    simulator: Simulator,
) -> None:
    """Without noise all order, as those of Vicsek do (1995), and keep their spacing."""
    crowd = {
        **BIRD, "count": 150, "spread": 180, "place": {"box": {"size": [7.9] * 3}},
        "attraction": {"weight": 0}, "repulsion": {"weight": 0.6, "radius": 1.5},
    }  # fmt: skip
    keys = {"domain": {"size": [8, 8, 8], "wrap": True}, "step": 1 / 48}
    rows = simulator.simulate(flock(crowd, **keys), [0.0, 10.0, 20.0])["it"]
    orders, gaps = [], []
    for row in rows:
        ways = row.velocities / np.linalg.norm(row.velocities, axis=1)[:, None]
        orders.append(np.linalg.norm(ways.mean(axis=0)))
        off = row.points[:, None] - row.points
        off -= 8 * np.round(off / 8)
        gaps.append(np.sort(np.linalg.norm(off, axis=2), axis=1)[:, 1])
    assert orders[0] < 0.2
    assert orders[1] < orders[2]
    assert orders[2] > 0.99
    # They keep apart; of random places many are nearer than this.
    least = 0.55 * (8**3 / 150) ** (1 / 3)
    assert (gaps[0] < least).mean() > 0.25
    assert gaps[2].min() > least


def test_meshes_of_a_clip_are_shown_at_phases_of_its_cycle(
    simulator: Simulator, tmp_path: Path
) -> None:
    clip = write_nasty_clip(tmp_path)
    mesh = Rig.load(tmp_path / "nasty.rig.yaml").meshes[0].name
    mesh_indices = {
        **BIRD,
        "shows": {"file": clip.name, "mesh": mesh, "samples": 5},
        "beat": 2,
    }
    rows = simulator.simulate(flock(mesh_indices), FRAMES)["it"]
    meshes = rows[0].meshes
    assert len(meshes) == 5
    assert any(not np.array_equal(one.points, meshes[0].points) for one in meshes)
    missing = {**mesh_indices, "shows": {"file": clip.name, "mesh": "none"}}
    with pytest.raises(AnimtoolError) as error:
        simulator.simulate(flock(missing), [0.0])
    assert error.value.faults[0].code == "SIM053"


def test_who_flies_one_way_is_in_order_however_fast(simulator: Simulator) -> None:
    fast = {**BIRD, "name": "fast", "spread": 0, "speed": {"cruise": 9}}
    slow = {**BIRD, "name": "slow", "seed": 5, "spread": 0, "speed": {"cruise": 1}}
    (run,) = open_systems(simulator.scene(flock(fast, slow)).systems, 1.0)
    run.at(0.0)
    found = run.diagnostics.values
    assert found["order"] == pytest.approx(1)
    assert found["speed"] == pytest.approx(5)


def test_members_that_show_a_shape_keep_a_distance_without_a_radius() -> None:
    bird = {"file": "bird.usda", "prim": "/bird/body"}
    plain = {"name": "birds"}
    assert min_distance(SpeciesModel.model_validate(plain)) == 0
    mesh_indices = SpeciesModel.model_validate({**plain, "shows": bird})
    assert min_distance(mesh_indices) == pytest.approx(2 * mesh_indices.radius)
    free = {**plain, "shows": bird, "repulsion": {"weight": 0}}
    assert min_distance(SpeciesModel.model_validate(free)) == 0


def test_a_speed_rule_too_stiff_for_the_step_is_said(simulator: Simulator) -> None:
    fast = {"name": "jet", "count": 30, "place": {"sphere": {"radius": 4}}}
    fast["speed"] = {"cruise": 40, "least": 20, "most": 80}
    # 2 · 0.2 · 40² = 640 1/s, and midpoint is stable up to 2 / 640 s.
    for step, codes in ((0.01, ["SIM101"]), (0.003, [])):
        run = SystemRun(simulator.scene(flock(fast, step=step)).systems, 0.0)
        rows = [row for _, (row,) in run.coded_frames(range(13), 0, 24)]  # type: ignore[arg-type]
        assert [notice.code for notice in run.notices] == codes
        lengths = [
            np.linalg.norm(b.points - a.points, axis=1) for a, b in pairwise(rows)
        ]
        # A step that is cut at a frame may turn.
        assert np.max(lengths) * 24 <= 80 + 2 * 80 * step * 24
