"""Fluids as scenes have them: walls, bodies that float, nozzles, what is refused."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pxr import Usd, UsdGeom, Vt
from support.simulated import Array, Point, Simulator

from animtool import BakeOptions, _kernels
from animtool.core.errors import AnimtoolError, Fault, ToleranceError
from animtool.motion.frames import MeshFrame
from animtool.scene.systems.simulation import open_systems
from animtool.sim.colliders import Box, Collider, Colliders, Plane, Poses, Sphere
from animtool.sim.colliders.shapes import shape_bounds
from animtool.systems.fluid.filling import (
    JET_DROP_RATIO,
    Nozzle,
    _read_points,
    coarse_drop_warnings,
    coarse_fill_warnings,
)
from animtool.systems.fluid.fluid import Fluid, PressureResult
from animtool.systems.fluid.spec import FluidEmitterModel, FluidModel
from animtool.systems.framework.run import SimulationRun

FRAMES = (np.arange(13) / 24).tolist()
TANK = {
    "name": "tank",
    "shape": {"box": {"size": [0.6, 2, 0.6]}},
    "at": [0.3, 1, 0.3],
    "container": True,
}
POOL = {"shape": {"box": {"size": [0.6, 0.5, 0.6]}}, "at": [0.3, 0.25, 0.3]}

# Of the density of a lattice, in a corner of three walls.
AT_WALLS = 0.03


@pytest.fixture
def simulator(tmp_path: Path) -> Simulator:
    return Simulator(tmp_path)


def fluid(**keys: Any) -> list[dict[str, Any]]:
    own = {"name": "it", "spacing": 0.1, "fills": [POOL], "colliders": [TANK]}
    return [{"fluid": {**own, **keys}}]


def refused(simulator: Simulator, **keys: Any) -> str:
    with pytest.raises(AnimtoolError) as error:
        simulator.simulate(fluid(**keys), FRAMES[:2])
    (fault,) = error.value.faults[:1]
    return f"{fault.code} {fault.message}"


def lattice(*counts: int) -> np.ndarray:
    axes = np.meshgrid(*(np.arange(n) + 0.5 for n in counts), indexing="ij")
    return np.stack(axes, axis=-1).reshape(-1, 3) * 0.1


def densities(points: np.ndarray, *colliders: Collider) -> np.ndarray:
    arrays = Colliders(colliders).kernel_arrays(0.0, 0.0)
    return _kernels.fluid_densities(arrays, points, 0.1)


def test_a_lattice_is_as_dense_at_walls_edges_and_corners_as_within() -> None:
    """But for a fiftieth of a spacing that walls count further off."""
    tank = Collider(Box((0.6, 2, 0.6)), Poses.fixed((0.3, 1, 0.3)), container=True)
    found = densities(lattice(6, 8, 6), tank)
    below = lattice(6, 8, 6)[:, 1] < 0.7
    assert_allclose(found[below], 1.0, atol=AT_WALLS)
    assert found.max() < 1.006
    assert (found[~below] < 0.95).all()
    # Planes are the same walls.
    walls = [Collider(Plane(normal)) for normal in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
    near = lattice(6, 8, 6).max(axis=1) < 0.4
    assert_allclose(densities(lattice(6, 8, 6), *walls)[near], 1.0, atol=AT_WALLS)


@pytest.mark.parametrize("shape", [Plane(), Box((1, 1, 1)), Sphere(0.4)])
def test_walls_fade_smoothly_with_distance(shape: Any) -> None:
    """By finite differences nothing jumps, within and outside."""
    heights = np.linspace(-0.1, 0.3, 401)
    begin = {Plane: 0.0, Box: 0.5, Sphere: 0.4}[type(shape)]
    each = [
        densities(np.array([[0.0, begin + h, 0.0]]), Collider(shape))[0]
        for h in heights
    ]
    steps = np.diff(each)
    assert (steps <= 1e-12).all()
    assert np.abs(np.diff(steps)).max() < 5e-3
    alone = densities(np.array([[0.0, 9.0, 0.0]]), Collider(shape))[0]
    assert_allclose(each[-1], alone)


@pytest.mark.slow
def test_water_at_rest_stays_and_its_pressure_is_that_of_its_depth(
    simulator: Simulator,
) -> None:
    """By least squares over particles and frames, and of layers two by two.

    One layer at a wall has some of the pressure of the next.
    """
    own = fluid(primvars=["pressure"], viscosity=0.002, spacing=0.05)
    rows = simulator.simulate(own, (np.arange(40) / 100 + 0.8).tolist())["it"]
    y = np.concatenate([row.points[:, 1] for row in rows])
    pressure = np.concatenate([row.primvars["pressure"] for row in rows])
    assert abs(y.mean() - 0.25) < 0.05 * 0.25
    wanted = 9810 * np.maximum(0.5 - y, 0.0)
    share = (pressure @ wanted) / (wanted @ wanted)
    assert share == pytest.approx(1.0, rel=0.05)
    for low in np.arange(0.0, 0.4, 0.1):
        layer = (y >= low) & (y < low + 0.1)
        assert pressure[layer].mean() == pytest.approx(wanted[layer].mean(), rel=0.07)


@pytest.mark.slow
@pytest.mark.parametrize("viscosity", [1e-6, 1e-3])
@pytest.mark.parametrize(("spacing", "deep"), [(0.1, 0.5), (0.06, 0.24)])
def test_a_pool_comes_to_rest(
    simulator: Simulator, spacing: float, deep: float, viscosity: float
) -> None:
    """By positions: within a few millimetres a second from four seconds on."""
    pool = {"shape": {"box": {"size": [0.6, deep, 0.6]}}, "at": [0.3, deep / 2, 0.3]}
    own = fluid(spacing=spacing, fills=[pool], viscosity=viscosity)
    rows = simulator.simulate(own, [0.0, *(4 + np.arange(13) / 24)])["it"][1:]
    ways = np.diff([row.points for row in rows], axis=0) * 24
    assert np.sqrt((ways**2).sum(axis=2).mean()) < 0.005
    assert rows[-1].points[:, 1].mean() == pytest.approx(deep / 2, rel=0.04)


@pytest.mark.slow(1)
@pytest.mark.parametrize(("radius", "at"), [(0.12, 0.3), (0.18, 0.3), (0.1, 0.1)])
def test_water_under_a_ball_on_the_floor_comes_to_rest(
    simulator: Simulator, radius: float, at: float
) -> None:
    """Floor and ball hold what is in the wedge between; each pushes it to the other."""
    pool = {"shape": {"box": {"size": [0.6, 0.36, 0.6]}}, "at": [0.3, 0.18, 0.3]}
    ball = {"name": "ball", "shape": {"sphere": {"radius": radius}}}
    ball["at"] = [at, radius, at]
    own = fluid(spacing=0.04, fills=[pool], viscosity=1e-6, colliders=[TANK, ball])
    rows = simulator.simulate(own, [0.0, *(4 + np.arange(13) / 24)])["it"][1:]
    ways = np.diff([row.points for row in rows], axis=0) * 24
    assert np.sqrt((ways**2).sum(axis=2).mean()) < 0.005
    speeds = np.array([row.velocities for row in rows])
    assert np.sqrt((speeds**2).sum(axis=2).mean()) < 0.006


def floated(simulator: Simulator, density: float, high: float) -> np.ndarray:
    """Return how high a box .3 m wide is over time, put in water .5 m deep."""
    body = {
        "name": "box",
        "shape": {"box": {"size": [0.3, high, 0.3]}},
        "density": density,
        "at": [0.3, 0.55, 0.3],
    }
    met = {"system": "boxes", "two_way": True}
    systems = [
        {"rigid": {"name": "boxes", "bodies": [body], "colliders": [TANK]}},
        *fluid(spacing=0.05, viscosity=0.005, systems=[met]),
    ]
    rows = simulator.simulate(systems, (np.arange(40) / 20).tolist())["boxes"]
    return np.array([row.points[0, 1] for row in rows])


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.4, 0.5, 0.7])
def test_a_box_is_sunk_by_its_share_of_the_density(
    simulator: Simulator, share: float
) -> None:
    """Flat, so that it does not turn over; six particles wide and three high."""
    heights = floated(simulator, 1000 * share, 0.15)[-20:]
    count = 12 * 12 * 10 - 6 * 6
    surface = (count * 0.05**3 + share * 0.3**2 * 0.15) / 0.6**2
    sunk = (surface - heights) / 0.15 + 0.5
    assert sunk.mean() == pytest.approx(share, abs=0.04)
    assert np.ptp(sunk) < 0.1


@pytest.mark.slow
def test_twice_as_dense_it_sinks(simulator: Simulator) -> None:
    assert floated(simulator, 2000.0, 0.3)[-1] < 0.25


def test_nozzles_bring_as_much_as_their_speed_says(simulator: Simulator) -> None:
    tap = {
        "at": [0.3, 1.5, 0.3],
        "rotate": [0, 1, 0, 0],
        "size": [0.2, 0.2],
        "speed": 2,
    }
    rows = simulator.simulate(fluid(emitters=[tap], fills=[]), FRAMES)["it"]
    # Four a layer, twenty layers a second.
    assert abs(len(rows[-1].ids) - 4 * 20 * FRAMES[-1]) <= 4
    assert_array_equal(rows[-1].ids, np.arange(len(rows[-1].ids)))
    drain = {"shape": {"plane": {"offset": 1.0}}}
    less = simulator.simulate(fluid(emitters=[tap], fills=[], drains=[drain]), FRAMES)[
        "it"
    ]
    assert (less[-1].points[:, 1] >= 1.0).all()
    assert 0 < len(less[-1].ids) < len(rows[-1].ids)


def test_fills_end_at_colliders_and_nothing_gets_in(simulator: Simulator) -> None:
    """Even where a pillar goes through a pool."""
    pillar = {
        "shape": {"sphere": {"radius": 0.15}},
        "at": [0.3, 0.2, 0.3],
        "moves": [[0, 0, 0, 0], [1, 0, 0.3, 0.2]],
    }
    own = fluid(colliders=[TANK, pillar], spacing=0.05)
    rows = simulator.simulate(own, FRAMES)["it"]
    for t, row in zip(FRAMES, rows, strict=True):
        middle = np.array([0.3, 0.2 + 0.3 * t, 0.3 + 0.2 * t])
        assert np.linalg.norm(row.points - middle, axis=1).min() > 0.15 + 0.02
        assert (np.abs(row.points - [0.3, 1, 0.3]) <= [0.3, 1, 0.3]).all()


@pytest.mark.slow
def test_a_closed_mesh_that_moves_pushes_it(
    simulator: Simulator, tmp_path: Path
) -> None:
    """A box of triangles goes through a pool by half a meter a second."""
    stage = Usd.Stage.CreateNew(str(tmp_path / "set.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(24)
    corners = np.array(list(product((0.05, 0.25), (0.05, 0.25), (0.2, 0.4))))
    mesh = UsdGeom.Mesh.Define(stage, "/box")
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4],
             [1, 5, 7, 3]]  # fmt: skip
    mesh.CreateFaceVertexCountsAttr([4] * 6)
    mesh.CreateFaceVertexIndicesAttr(np.ravel(faces).tolist())
    for code, far in ((0, 0.0), (12, 0.25)):
        moved = np.add(corners, [far, 0, 0]).astype("f")
        mesh.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(moved), code)
    stage.Save()
    one = {"file": "set.usda", "prim": "/box", "radius": 0.005, "closed": True}
    own = fluid(spacing=0.05, meshes=[one])
    rows = simulator.simulate(own, FRAMES)["it"]
    for t, row in zip(FRAMES, rows, strict=True):
        middle = np.array([0.15 + 0.5 * t, 0.15, 0.3])
        beyond = (np.abs(row.points - middle) - 0.1).max(axis=1)
        assert beyond.min() > (0 if t else -0.1)
        assert (np.abs(row.points - [0.3, 1, 0.3]) <= [0.3, 1, 0.3]).all()
    ahead = np.abs(rows[-1].points - [0.55, 0.15, 0.3]).max(axis=1) < 0.2
    assert rows[-1].velocities[ahead, 0].max() > 0.1


def test_viscosity_slows_shear_as_the_laplacian_says() -> None:
    """A sine of velocities fades by exp(-nu k² t), where it is seen from all sides."""
    points = lattice(16, 16, 16)
    k = 2 * np.pi / 0.8
    speeds = np.zeros_like(points)
    speeds[:, 0] = 1e-3 * np.sin(k * points[:, 1])
    step, nu = 0.01, 0.02
    none = (np.zeros((0, 13)), np.stack([points, speeds]), np.zeros_like(points))
    arrays = Colliders([]).kernel_arrays(0.0, step)
    state, *_ = _kernels.fluid_steps(
        arrays, np.zeros(0, np.int32), *none, 0.1, 1000.0, nu, 0.0, 5.0, step, 4
    )
    within = (np.abs(points - 0.8) < 0.5).all(axis=1)
    before, after = speeds[within, 0], state[1][within, 0]
    faded = (after @ before) / (before @ before)
    assert -np.log(faded) / step == pytest.approx(nu * k * k, rel=0.1)


def test_what_cannot_be_is_refused_by_name(simulator: Simulator) -> None:
    two = np.array([[0.3, 0.3, 0.3], [0.3, 0.3, 0.3001]])
    message = refused(simulator, fills=[{"name": "drop", "points": Point(two)}])
    assert message.startswith("SIM064 particle 0 of 'drop' and particle 1 of 'drop'")
    out = np.array([[0.3, 0.3, 0.3], [0.9, 0.3, 0.3]])
    message = refused(simulator, fills=[{"points": Point(out)}])
    assert "particle 1 of fill 0 starts 0.3 m outside the container 'tank'" in message
    bad = np.array([[0.3, np.nan, 0.3]])
    assert "not finite" in refused(simulator, fills=[{"points": Point(bad)}])
    assert "SIM064" in refused(simulator, spacing=1e-6)
    assert "the limit is 10" in refused(simulator, max_particles=10)
    outside = refused(simulator, fills=[{**POOL, "at": [9, 9, 9]}])
    assert "is outside the container 'tank'" in outside
    assert "SIM064" in refused(simulator, fills=[])
    assert "SIM064" in refused(simulator, fills=[{"shape": {"plane": {}}}])
    assert "radius" in refused(simulator, emitters=[{"at": [0.3, 1, 0.3]}])


def test_what_is_squeezed_stops_by_name(simulator: Simulator) -> None:
    """A lid that comes down on a full tank; numbers stay finite."""
    lid = {
        "shape": {"box": {"size": [2, 0.4, 2]}},
        "at": [0.3, 0.8, 0.3],
        "moves": [[0, 0, 0, 0], [0.5, 0, -0.4, 0]],
    }
    with pytest.raises(ToleranceError) as error:
        simulator.simulate(fluid(colliders=[TANK, lid]), FRAMES)
    assert error.value.faults[-1].code == "SIM108"


def test_a_force_too_strong_for_the_step_says_so(simulator: Simulator) -> None:
    pull = {"gravity": {"acceleration": [0, -1e9, 0]}}
    with pytest.raises(ToleranceError) as error:
        simulator.simulate(fluid(forces=[pull]), FRAMES)
    assert error.value.faults[-1].code == "SIM102"
    assert "substeps" in error.value.faults[-1].message


@pytest.mark.slow
def test_the_step_that_is_proposed_works(simulator: Simulator) -> None:
    keys = {"forces": [{"gravity": {"acceleration": [0, -1e7, 0]}}]}
    with pytest.raises(ToleranceError) as error:
        simulator.simulate(fluid(**keys), FRAMES[:3])
    hint = error.value.faults[-1].hint or ""
    step = float(hint.split(",")[0].removeprefix("step: "))
    assert simulator.simulate(fluid(**keys, step=step), FRAMES[:3])["it"]


def test_a_blocked_nozzle_holds_back(simulator: Simulator) -> None:
    tap = {"at": [0.3, 0.25, 0.3], "radius": 0.1, "speed": 0.5}
    rows = simulator.simulate(fluid(emitters=[tap]), FRAMES[:4])["it"]
    last = rows[-1].points
    gaps = np.linalg.norm(last[:, None] - last[None], axis=2)
    assert gaps[~np.eye(len(last), dtype=bool)].min() > 0.02


def test_colours_are_those_of_a_quantity(simulator: Simulator) -> None:
    ramp = [[0, 0, 0], [1, 0, 0], [1, 1, 1]]
    colour = {"by": "speed", "range": [0, 2], "ramp": ramp}
    rows = simulator.simulate(fluid(colour=colour, colliders=[]), FRAMES[:9])["it"]
    for row in rows:
        speed = np.linalg.norm(row.velocities, axis=1)
        found = row.primvars["displayColor"]
        assert_allclose(found[:, 0], np.clip(speed, 0, 1))
        assert_allclose(found[:, 1], np.clip(speed - 1, 0, 1))
    assert found[:, 1].max() > 0
    wrong = {"by": "taste", "range": [0, 2]}
    assert "unknown quantity" in refused(simulator, colour=wrong)
    assert "need a range" in refused(simulator, colour={"by": "speed"})


def test_what_is_saved_goes_on_bit_for_bit(simulator: Simulator) -> None:
    tap = {"at": [0.3, 1, 0.3], "rotate": [0, 1, 0, 0], "radius": 0.1, "speed": 2}
    keys: dict[str, Any] = {"emitters": [tap], "primvars": ["pressure"]}
    whole = simulator.simulate(fluid(**keys), FRAMES)["it"]
    simulator.baked(fluid(**keys, save="it.npz", save_at=6), BakeOptions())
    later = simulator.simulate(fluid(**keys, resume="it.npz"), FRAMES[5:])["it"]
    for one, other in zip(later, whole[5:], strict=True):
        assert_array_equal(one.ids, other.ids)
        assert_array_equal(one.points, other.points)
        assert_array_equal(one.velocities, other.velocities)
        assert_array_equal(one.primvars["pressure"], other.primvars["pressure"])


def test_without_forces_it_stays(simulator: Simulator) -> None:
    first, *_, last = simulator.simulate(fluid(forces=[]), FRAMES)["it"]
    assert_allclose(last.points, first.points, atol=1e-3)


def test_bounds_hold_shapes() -> None:
    assert_allclose(shape_bounds(Sphere(2.0, (1, 0, 0))), [[-1, -2, -2], [3, 2, 2]])
    assert_allclose(shape_bounds(Box((2, 4, 6))), [[-1, -2, -3], [1, 2, 3]])


def test_a_surface_is_closed_and_has_the_volume(simulator: Simulator) -> None:
    pytest.importorskip("skimage", reason="surfaces are made by scikit-image")
    own = fluid(surface={}, fills=[{**POOL, "at": [0.3, 0.6, 0.3]}], colliders=[])
    mesh = simulator.simulate(own, [0.0])["it"][0]
    assert isinstance(mesh, MeshFrame)
    a, b, c = mesh.points[mesh.indices.reshape(-1, 3)].swapaxes(0, 1)
    volume = float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6
    assert 0.9 < volume / (0.6 * 0.5 * 0.6) < 1.6
    sides = np.sort(mesh.indices.reshape(-1, 3)[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2))
    assert (np.unique(sides, axis=0, return_counts=True)[1] == 2).all()


def test_a_fluid_in_the_open_falls(simulator: Simulator) -> None:
    """Colliders may be left out: what nothing holds falls as one."""
    (entry,) = fluid()
    del entry["fluid"]["colliders"]
    rows = simulator.simulate([entry], FRAMES[:6])["it"]
    heights = [np.mean(row.points[:, 1]) for row in rows]
    falls = heights[0] - 0.5 * 9.81 * np.array(FRAMES[:6]) ** 2
    assert_allclose(heights, falls, atol=0.02)


WATER = 0.072


def ball(radius: float, spacing: float, at: Any = (0, 0, 0)) -> np.ndarray:
    """Return a lattice within a ball, off the middle of its cells."""
    axis = (np.arange(-12, 12) + 0.5) * spacing
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    grid = grid.reshape(-1, 3)
    return grid[np.linalg.norm(grid, axis=1) < radius] + at


def drop(points: np.ndarray, velocities: Any = None, **keys: Any) -> Any:
    fill = {"points": Point(points)}
    if velocities is not None:
        fill["velocities"] = Array(velocities)
    own = {"fills": [fill], "colliders": [], "forces": [], "tension": WATER}
    return fluid(**{**own, **keys})


def stretched(points: np.ndarray) -> float:
    """Return how much longer it is along z than across, as a quadrupole."""
    off = points - points.mean(axis=0)
    return float((off[:, 2] ** 2 - (off[:, 0] ** 2 + off[:, 1] ** 2) / 2).mean())


@pytest.mark.slow(0.5)
@pytest.mark.parametrize("radius", [0.002, 0.01, 0.05])
def test_a_drop_swings_as_rayleigh_says_at_any_size(
    simulator: Simulator, radius: float
) -> None:
    """By a least-squares fit of a damped swing; its momentum and spin stay."""
    from scipy.optimize import curve_fit

    spacing = radius / 6
    points = ball(radius, spacing)
    alike = (len(points) * spacing**3 * 0.75 / np.pi) ** (1 / 3)
    pulse = np.sqrt(8 * WATER / (1000 * alike**3))
    motion = 0.05 * pulse * points * [-1, -1, 2] + np.array([3 * radius, 0, 0])
    times = np.linspace(0, 4 * np.pi / pulse, 49)
    moved = points + np.array([0.1, -0.03, 0.017])
    own = drop(moved, motion, spacing=spacing)
    rows = simulator.simulate(own, times.tolist())["it"]
    turns = times * pulse

    def swing(t: np.ndarray, *of: float) -> np.ndarray:
        a, b, rate, fades, rest, creep = of
        wave = a * np.cos(rate * t) + b * np.sin(rate * t)
        return np.exp(-fades * t) * wave + rest + creep * t

    found = [stretched(row.points) / alike**2 for row in rows]
    fitted, _ = curve_fit(swing, turns, found, [0, 0.05, 1, 0.1, 0, 0])
    assert 1 / fitted[2] == pytest.approx(1, rel=0.1)
    assert fitted[3] < 0.15
    velocities = rows[-1].velocities
    assert_allclose(velocities.mean(axis=0), [3 * radius, 0, 0], atol=1e-9)
    off = rows[-1].points - rows[-1].points.mean(axis=0)
    spin = np.cross(off, velocities - velocities.mean(axis=0)).mean(axis=0)
    assert np.abs(spin).max() < 1e-4 * pulse * alike**2


@pytest.mark.slow
def test_a_drop_at_rest_is_round_and_has_the_pressure_of_laplace(
    simulator: Simulator,
) -> None:
    """From a cube, whose energy never grows: it keeps its volume, and none leave it."""
    axis = (np.arange(10) - 4.5) * 0.001
    cube = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    own = drop(cube, spacing=0.001, primvars=["pressure"], viscosity=5e-5)
    rows = simulator.simulate(own, (np.arange(61) / 100).tolist())["it"]
    energies = [
        WATER * _kernels.fluid_area(row.points, 0.001)
        + 0.5e-6 * (row.velocities**2).sum()
        for row in rows
    ]
    assert np.diff(energies).max() < 1e-3 * energies[0]
    alike = 0.01 * (0.75 / np.pi) ** (1 / 3)
    points = rows[-1].points
    sides = np.linalg.eigvalsh(np.cov(points.T))
    assert sides == pytest.approx(np.full(3, sides.mean()), rel=0.04)
    assert np.sqrt(5 * sides.mean()) == pytest.approx(alike, rel=0.03)
    assert _kernels.fluid_area(points, 0.001) == pytest.approx(
        4 * np.pi * alike**2, rel=0.1
    )
    within = np.linalg.norm(points, axis=1) < 0.5 * alike
    pressures = [row.primvars["pressure"][within].mean() for row in rows[-30:]]
    assert np.mean(pressures) == pytest.approx(2 * WATER / alike, rel=0.1)


def test_the_area_of_a_surface_is_that_of_its_shape() -> None:
    """But for the steps of a lattice; what is far apart adds up."""
    for count in (8, 12):
        points = ball(count * 0.1, 0.1, at=(7.31, -2.05, 0.4))
        found = _kernels.fluid_area(points, 0.1)
        assert found == pytest.approx(4 * np.pi * (count * 0.1) ** 2, rel=0.12)
    pair = np.array([[0.0, 0, 0], [40.0, 0, 0]])
    assert _kernels.fluid_area(pair, 0.1) == pytest.approx(
        2 * _kernels.fluid_area(pair[:1], 0.1)
    )


@pytest.mark.parametrize(("radius", "codes"), [(0.35, ["SIM175"]), (0.5, [])])
def test_a_drop_of_too_few_particles_says_so(radius: float, codes: list[str]) -> None:
    """With a spacing that is not said to be too large."""
    spec = FluidModel.model_validate(
        {
            "name": "it",
            "spacing": 0.1,
            "tension": WATER,
            "fills": [{"shape": {"sphere": {"radius": radius}}}],
        }
    )
    found = list(coarse_drop_warnings(spec, [{"shape": Sphere(radius)}]))
    assert [fault.code for fault in found] == codes
    for fault in found:
        finer = float(str(fault.hint).split()[-2]) / 1000
        finely = spec.model_copy(update={"spacing": finer})
        assert not list(coarse_drop_warnings(finely, [{"shape": Sphere(radius)}]))


def coarse_fills(size: Any, spacing: float, *colliders: Collider) -> list[Fault]:
    """Return the warnings about a box of fluid around the origin."""
    fills = [{"shape": {"box": {"size": size}}}]
    spec = FluidModel(**{"name": "it", "spacing": spacing, "fills": fills})
    data = [{"shape": Box(size), "poses": Poses()}]
    return list(coarse_fill_warnings(spec, data, Colliders([*colliders]), 0.0))


@pytest.mark.parametrize(
    ("size", "codes"), [((1, 0.09, 1), ["SIM204"]), ((1, 0.1, 1), [])]
)
def test_a_fill_thinner_than_the_spacing(size: Any, codes: list[str]) -> None:
    assert [fault.code for fault in coarse_fills(size, 0.1)] == codes


@pytest.mark.parametrize(
    ("spacing", "percents"), [(0.3, ["63%"]), (0.1, []), (0.05, [])]
)
def test_a_spacing_that_loses_the_volume_of_a_fill(
    spacing: float, percents: list[str]
) -> None:
    """A tank as wide as the fill keeps particles half a spacing from its walls."""
    tank = Collider(Box((2.4, 2.0, 0.8)), container=True)
    faults = coarse_fills((0.6, 0.9, 0.8), spacing, tank)
    assert [fault.message.split(": ")[-1].split()[0] for fault in faults] == percents
    for fault in faults:
        millimetres = float(str(fault.hint).split()[4])
        assert not coarse_fills((0.6, 0.9, 0.8), millimetres / 1000, tank)


@pytest.mark.parametrize(("radius", "codes"), [(0.26, ["SIM175"]), (0.27, [])])
def test_drops_of_a_jet_are_wider_than_it(radius: float, codes: list[str]) -> None:
    """Rayleigh: 4.508 widths of a jet become a drop, of 1.89 of its radius."""
    # A ball of as much volume: r³ is 3/4 of the radius squared times the length.
    assert pytest.approx((0.75 * 4.508 * 2) ** (1 / 3), rel=1e-3) == JET_DROP_RATIO
    tap = {"radius": radius, "speed": 1}
    spec = FluidModel.model_validate(
        {"name": "it", "spacing": 0.1, "tension": WATER, "emitters": [tap]}
    )
    found = list(coarse_drop_warnings(spec, []))
    assert [fault.code for fault in found] == codes
    for fault in found:
        assert fault.message.startswith("a drop of nozzle 0")


def test_a_nozzle_that_is_narrower_than_the_spacing_brings_one_by_one() -> None:
    """Of 1 m by 5 cm every tenth of a second ten in a row, of 3 cm one."""
    for size, expected in (
        ({"size": [1.0, 0.05]}, np.arange(10) * 0.1 - 0.45),
        ({"size": [0.03, 0.03]}, [0.0]),
        ({"radius": 0.01}, [0.0]),
    ):
        tap = FluidEmitterModel.model_validate({"speed": 1, **size})
        spec = FluidModel.model_validate(
            {"name": "it", "spacing": 0.1, "emitters": [{"speed": 1, **size}]}
        )
        nozzle = Nozzle(spec, tap, Poses.fixed(), 0.0)
        found = nozzle.inflow(0.0, 0.05, np.zeros(3), 1000)
        assert found.skipped_count == 0
        assert_allclose(found.state[0, :, 0], expected, atol=1e-12)
        assert_allclose(found.state[0, :, 2], 0, atol=1e-12)


def test_points_of_a_file_that_are_no_numbers_are_named_by_their_row() -> None:
    points = np.zeros((4, 3))
    points[2, 1] = np.nan
    (fill,) = FluidModel.model_validate(
        {"name": "it", "spacing": 0.1, "fills": [{"points": "a.npz"}]}
    ).fills
    with pytest.raises(AnimtoolError, match="points of pool: row 2 is not") as error:
        _read_points(fill, {"points": points}, "pool", "fills[0]")
    assert error.value.faults[0].code == "SIM064"
    found = _read_points(fill, {"points": points[:2]}, "pool", "fills[0]")
    assert_array_equal(found, np.stack([points[:2], 0 * points[:2]]))


@pytest.mark.parametrize(
    ("opens", "refused"), [([1, 2], False), ([2, 2], False), ([2, 1.5], True)]
)
def test_a_nozzle_that_closes_before_it_opens_is_refused(
    simulator: Simulator, opens: list[float], refused: bool
) -> None:
    tap = {"at": [0.3, 1.5, 0.3], "size": [0.2, 0.2], "speed": 1, "opens": [opens]}
    systems = fluid(emitters=[tap])
    if not refused:
        simulator.scene(systems)
        return
    with pytest.raises(AnimtoolError, match=r"closes at 1\.5 s, before 2 s") as error:
        open_systems(simulator.scene(systems).systems, 10.0)
    assert error.value.faults[0].code == "SIM064"


def test_before_its_first_step_nothing_is_dense_or_parted(
    simulator: Simulator,
) -> None:
    """What is reported is the densest of all steps, and the parts of the last."""
    (run,) = open_systems(simulator.scene(fluid(colliders=[TANK])).systems, 10.0)
    assert isinstance(run, SimulationRun)
    own = run.simulation
    state = own.initial_state()
    values = own.diagnostics(state, 0.0).values
    assert (values["densest"], values["parts"], values["compression"]) == (0, 0, 0)
    densest = 0.0
    for k in range(3):
        state = own.step(state, k / 48, 1 / 48).state
        values = own.diagnostics(state, (k + 1) / 48).values
        densest = max(densest, values["compression"])
        assert values["densest"] == densest < 0.1
        assert values["parts"] >= 1


@pytest.mark.parametrize(
    ("found", "doublings", "codes"),
    [
        ([0.0199], 0, []),
        ([0.021, 0.0105], 1, []),
        ([0.08, 0.04, 0.0199], 2, []),
        ([0.03, 0.023, 0.0225], 1, ["SIM137"]),  # the third is hardly any better
        ([0.021, 0.0209], 0, ["SIM137"]),
    ],
)
def test_parts_are_doubled_beyond_the_density_that_is_allowed(
    simulator: Simulator,
    monkeypatch: pytest.MonkeyPatch,
    found: list[float],
    doublings: int,
    codes: list[str],
) -> None:
    """Where 2 % are, as long as it becomes less dense by a fifth each time."""
    systems = fluid(compression=0.02, colliders=[])
    (run,) = open_systems(simulator.scene(systems).systems, 10.0)
    assert isinstance(run, SimulationRun)
    own = run.simulation
    assert isinstance(own, Fluid)
    state, asked = own.initial_state(), list[tuple[float, int]]()

    def steps(*given: Any) -> PressureResult:
        asked.append(given[-2:])
        dense = found[len(asked) - 1]
        return PressureResult(state.motion, state.pressures, dense, ())

    monkeypatch.setattr(own, "_run_kernel", steps)
    notices: list[Fault] = []
    still = np.zeros_like(state.motion[0])
    after, _ = own._solve_pressure(state, 0.0, 0.01, still, notices)
    assert len(asked) == len(found)
    sound, parts = asked[0]
    assert asked == [(sound * 2**k, parts * 2**k) for k in range(len(found))]
    assert (after.sound, after.substep_count) == asked[doublings]
    assert after.compression == found[doublings]
    assert [fault.code for fault in notices] == codes
