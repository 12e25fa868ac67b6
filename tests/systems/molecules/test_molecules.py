"""Atoms in a box: energy, heat, pressure, crystals, liquids, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from adapters.nbody import _Context
from numpy.testing import assert_allclose, assert_array_equal
from support.faults import raises
from support.simulated import Simulator
from support.suite import nightly

from animtool.core.errors import AnimtoolError, ToleranceError
from animtool.scene.systems.simulation import open_systems
from animtool.sim.colliders import Poses
from animtool.systems.framework.run import ReachedState, SimulationRun
from animtool.systems.molecules.atoms import (
    BOLTZMANN_CONSTANT,
    COULOMB_CONSTANT,
    Atoms,
    PeriodicBox,
    _read_motion,
    pair_coefficients,
)
from animtool.systems.molecules.molecules import (
    MEGAPASCALS_PER_UNIT,
    Interactions,
    Molecules,
    MoleculeState,
    build,
    thermostat_factor,
)
from animtool.systems.molecules.spec import MoleculesModel, ThermostatModel

ARGON = {"name": "argon", "count": 256}
# Of solid argon at its melting point [nm].
SIDE = 4 * 0.5461


@pytest.fixture
def simulator(tmp_path: Path) -> Simulator:
    return Simulator(tmp_path)


def molecules(**keys: Any) -> Molecules:
    given = {"name": "it", "species": [ARGON], "box": [SIDE] * 3, "cutoff": 0.85}
    spec = MoleculesModel.model_validate({**given, "step": 0.01, **keys})
    parts = {"species": [{}] * len(spec.species), "traps": [{"poses": Poses.fixed()}]}
    parts["traps"] *= len(spec.traps)
    return build(spec, _Context(parts))


def after(made: Molecules, steps: int, dt: float) -> list[MoleculeState]:
    states = [made.initial_state()]
    for k in range(steps):
        states.append(made.step(states[-1], k * dt, dt))
    return states


def test_a_crystal_has_the_energy_and_pressure_of_its_lattice() -> None:
    """The sums of the face-centred lattice are 14.4539 / r^6 and 12.1319 / r^12."""
    made = molecules(box=[10 * 0.54] * 3, species=[{**ARGON, "count": 4000}],
                     cutoff=2.69, switch=2.69)  # fmt: skip
    values = made.values(made.initial_state(), 0.0)
    near = 0.54 / np.sqrt(2) / 0.3405
    each = 2 * 0.9961 * (12.13188 / near**12 - 14.45392 / near**6)
    # What is beyond the cut-off, as an even density of atoms has it.
    beyond = 8 / 3 * np.pi * 4 / 0.54**3 * 0.3405**3 * 0.9961 * -((0.3405 / 2.69) ** 3)
    assert values["potential_energy"] / 4000 + beyond == pytest.approx(each, rel=2e-4)
    assert values["temperature"] == 0
    virial = 2 * 0.9961 * (12 * 12.13188 / near**12 - 6 * 14.45392 / near**6)
    pressure = (virial + 2 * 3 * beyond) * 4 / 0.54**3 / 3 * MEGAPASCALS_PER_UNIT
    assert values["pressure"] == pytest.approx(pressure, rel=2e-2)


def test_salt_has_the_energy_of_its_lattice() -> None:
    """Madelung's constant of rock salt, by charges that are damped and shifted."""
    ions = [
        {"name": name, "count": 2048, "charge": charge, "epsilon": 0}
        for name, charge in (("sodium", 1.0), ("chlorine", -1.0))
    ]
    side = 16 * 0.282
    made = molecules(
        species=ions, box=[side] * 3, lattice="cubic", cutoff=2.2, damping=1.5
    )
    energy = made.values(made.initial_state(), 0.0)["potential_energy"]
    assert -energy / 2048 * 0.282 / COULOMB_CONSTANT == pytest.approx(
        1.747565, rel=2e-3
    )


def drift(steps: int) -> float:
    made = molecules(temperature=120, seed=2)
    states = [made.initial_state()]
    worst = 0.0
    for k in range(steps):
        states = [made.step(states[-1], k * 0.005, 0.005)]
        if k % 100 == 99:
            values = made.values(states[-1], 0.0)
            worst = max(worst, abs(values["energy_drift"]))
    assert values["temperature"] < 100
    momentum = made.atoms.masses @ states[-1].motion[1]
    assert np.abs(momentum).max() < 1e-9
    return worst


@pytest.mark.slow
def test_energy_stays() -> None:
    assert drift(1500) < 1e-4


@nightly
def test_energy_stays_for_a_hundred_thousand_steps() -> None:
    assert drift(100_000) < 1e-4


@pytest.mark.slow
def test_a_bath_brings_its_temperature_and_its_spread() -> None:
    """The kinetic energy is spread as that of the canonical ensemble."""
    bath = ThermostatModel(temperatures=[[0, 100]], relaxation=0.2)
    freedom, kinetic, found = 30, 1e-3, []
    for step in range(20_000):
        factor = thermostat_factor(bath, 5, step, 1.0, 0.1, kinetic, freedom)
        kinetic *= factor**2
        found.append(kinetic)
    mean = freedom * BOLTZMANN_CONSTANT * 100 / 2
    assert np.mean(found[100:]) == pytest.approx(mean, rel=0.02)
    spread = np.sqrt(freedom / 2) * BOLTZMANN_CONSTANT * 100
    assert np.std(found[100:]) == pytest.approx(spread, rel=0.05)
    cold = ThermostatModel(temperatures=[[0, 0]], relaxation=0.2)
    factor = thermostat_factor(cold, 5, 1, 1.0, 0.2, 1.0, freedom)
    assert factor**2 == pytest.approx(np.exp(-1))


def test_heat_is_counted() -> None:
    bath = {"temperatures": [[0, 10], [5, 200]], "relaxation": 0.1}
    made = molecules(thermostat=bath, temperature=10, species=[{**ARGON, "count": 108}],
                     box=[0.75 * SIDE] * 3, cutoff=0.8)  # fmt: skip
    last = after(made, 400, 0.01)[-1]
    values = made.values(last, 4.0)
    assert 100 < values["temperature"] < 220
    assert last.heat > 50
    assert abs(values["energy_drift"]) < 2e-3


def radial(
    made: Molecules, states: list[MoleculeState]
) -> tuple[np.ndarray, np.ndarray]:
    """Return distances [nm] and the radial distribution of states."""
    from scipy.spatial import cKDTree

    edges = np.linspace(0.25, 1.0, 151)
    box = made._periodic_box.size
    counts = np.zeros(150)
    for state in states:
        tree = cKDTree(state.motion[0] % box % box, boxsize=box)
        counts += np.diff(tree.count_neighbors(tree, edges))
    count = len(made.atoms.masses)
    shells = 4 / 3 * np.pi * np.diff(edges**3) * count / box.prod()
    return (edges[1:] + edges[:-1]) / 2, counts / (len(states) * count * shells)


@nightly
def test_liquid_argon_has_its_neighbours_where_rahman_found_them() -> None:
    """A. Rahman, Physical Review 136, 1964: 864 atoms, 94.4 K, 1.374 g/cm³.

    The first peak is at 3.7 Å, the next ones at 7.0 and 10.4 Å.
    """
    side = (864 * 39.948 / (1.374 * 602.214)) ** (1 / 3)
    keys = {"species": [{**ARGON, "count": 864}], "box": [side] * 3, "cutoff": 0.85}
    bath = {"temperatures": [[0, 300], [5, 94.4]], "relaxation": 0.2}
    made = molecules(**keys, temperature=300, thermostat=bath)
    states = after(made, 2000, 0.01)[1200::20]
    r, g = radial(made, states)
    assert r[np.argmax(g)] == pytest.approx(0.37, abs=0.01)
    assert 2.6 < g.max() < 3.3
    second = (r > 0.55) & (r < 0.85)
    assert r[second][np.argmax(g[second])] == pytest.approx(0.70, abs=0.03)
    assert g[r < 0.3].max() < 0.01


def opened(simulator: Simulator, **keys: Any) -> SimulationRun:
    given = {
        "name": "it",
        "species": [ARGON],
        "box": [SIDE] * 3,
        "cutoff": 0.85,
        **keys,
    }
    (run,) = open_systems(simulator.scene([{"molecules": given}]).systems, 10.0)
    assert isinstance(run, SimulationRun)
    return run


def test_gone_on_from_the_middle_it_is_the_same(simulator: Simulator) -> None:
    bath = {"temperatures": [[0, 200]]}
    whole = opened(simulator, temperature=100, thermostat=bath, skin=0.02)
    whole.at(0.2)
    middle = whole.state
    assert isinstance(middle, ReachedState)
    end = whole.at(0.5)
    (other,) = open_systems(
        simulator.scene(
            [
                {
                    "molecules": {
                        "name": "it", "species": [ARGON], "box": [SIDE] * 3,
                        "cutoff": 0.85, "temperature": 100, "thermostat": bath,
                        "skin": 0.02,
                    }
                }
            ]
        ).systems,
        10.0,
    )  # fmt: skip
    assert isinstance(other, SimulationRun)
    again = SimulationRun("it", other.simulation, 0.0, whole.step_length, middle)
    found = again.at(0.5)
    assert_array_equal(found.points, end.points)
    assert_array_equal(found.velocities, end.velocities)


@pytest.mark.slow
def test_atoms_stay_in_the_box_and_a_trap_draws_them(simulator: Simulator) -> None:
    trap = {"at": [0.4, 5, 0], "stiffness": 300, "radius": 1.4}
    keys = {"at": [0, 5, 0], "scale": 0.5, "pace": 4, "step": 0.0025, "temperature": 60}
    keys |= {"species": [{**ARGON, "count": 20}], "box": [3, 3, 3]}
    run = opened(simulator, **keys, traps=[trap])
    frames = [run.at(t) for t in (0.0, 2.0)]
    for frame in frames:
        assert (np.abs(frame.points - [0, 5, 0]) <= 0.75 + 1e-12).all()
    near = [(np.linalg.norm(f.points - trap["at"], axis=1) < 0.4).sum() for f in frames]
    assert near[1] > near[0]
    for by in ("speed", "temperature", "density", "energy", "species"):
        frame = opened(simulator, **keys, colour={"by": by}).at(0.1)
        assert frame.primvars["displayColor"].shape == (20, 3)


def test_atoms_say_their_species_where_there_are_two() -> None:
    xenon = {"name": "xenon", "count": 256, "sigma": 0.4, "epsilon": 1.8, "mass": 131}
    for species, expected in (([ARGON], {}), ([ARGON, xenon], {0: 256, 1: 256})):
        made = molecules(species=species)
        primvars = made.frame(made.initial_state(), 0.0).primvars
        kinds = np.array(primvars.get("species", []), int)
        assert dict(zip(*np.unique(kinds, return_counts=True), strict=True)) == expected


def test_mixtures_alternate_or_are_mixed() -> None:
    both = [{**ARGON, "count": 32}, {**ARGON, "name": "krypton", "count": 32}]
    made = molecules(species=both, lattice="cubic", box=[2, 2, 2])
    x = np.round(made.atoms.points / 0.5 - 0.5)
    odd = x.sum(axis=1) % 2
    assert set(odd[:32]) == {0}
    assert set(odd[32:]) == {1}
    found = molecules(species=both, box=[2, 2, 2]).atoms.points
    assert len(np.unique(found, axis=0)) == 64
    assert_allclose(found.mean(axis=0), [1, 1, 1], atol=0.2)


PLACES = np.array([[0.0, 0, 0], [0.5, 0, 0]])
FARTHER = np.array([[0.9, 0, 0], [0, 0, 0], [0, 0, 0]])


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"cutoff": 1.2}, "box is 2.1844 nm wide, but twice the cut-off is 2.4 nm"),
        ({"box": [2.3e-9] * 3}, r"are in nm: write \[2.3, 2.3, 2.3\]"),
        (
            {"species": [{**ARGON, "sigma": 3.4}], "cutoff": None},
            r"species\[0\]\.sigma: .* 0\.34$",
        ),
        (
            {"species": [{**ARGON, "sigma": 340.5}], "cutoff": None},
            r"\.sigma: .* 0\.3405$",
        ),
        ({"temperature": -193}, "for -193 °C write 80.15"),
        ({"switch": 0.9}, "the switch starts at 0.9 nm, beyond the cut-off"),
        ({"block": [3, 1, 1]}, "the block is larger than the box"),
        ({"thermostat": {"temperatures": [[1, 9], [0, 9]]}}, "do not ascend"),
        ({"thermostat": {"temperatures": [[0, -9]]}}, "below absolute zero"),
        ({"colour": {"by": "taste"}}, "unknown quantity"),
        ({"step": 0.5}, "a step of 0.5 ps is too long"),
        ({"species": [{**ARGON, "charge": 1}]}, r"charges have a sum of 256 e"),
        ({"species": [{**ARGON, "charge": -1}]}, r"charges have a sum of -256 e"),
        (
            {"species": [{**ARGON, "points": 9 + PLACES}]},
            "atom 0 of 'argon' is outside",
        ),
        (
            {"species": [{**ARGON, "points": 0 * PLACES}]},
            "atoms 0 and 1 start 0 nm apart",
        ),
        ({"species": [{**ARGON, "points": 0.1 * PLACES}]}, "start 0.05 nm apart"),
        (
            {"species": [{**ARGON, "points": 0.1 * PLACES[[0, 0, 1]] + FARTHER}]},
            "atoms 1 and 2 start 0.05 nm apart",
        ),
        ({"species": [{**ARGON, "points": PLACES[:, :1]}]}, r"have shape \(2, 1\)"),
        ({"species": [{**ARGON, "velocities": PLACES}]}, "velocities need points"),
    ],
)
def test_what_makes_no_sense_is_refused(
    simulator: Simulator, keys: dict[str, Any], text: str
) -> None:
    with raises(AnimtoolError, "SIM071", match=text):
        opened(simulator, **keys)


def test_a_step_that_is_too_long_stops_with_one_that_is_not(
    simulator: Simulator,
) -> None:
    run = opened(simulator, temperature=60_000, step=0.08)
    with pytest.raises(ToleranceError) as error:
        run.at(4.0)
    fault = error.value.faults[-1]
    assert fault.code == "SIM102"
    assert fault.hint is not None
    step = float(fault.hint.split("step: ")[1])
    assert 1e-3 < step < 0.03


def test_two_kinds_act_by_the_mean_sigma_and_the_geometric_mean_epsilon() -> None:
    """Lorentz and Berthelot: sigma is 0.35 nm of 0.3 and 0.4, epsilon 2 of 1 and 4."""
    kinds = [
        {"name": "a", "sigma": 0.3, "epsilon": 1.0, "count": 1},
        {"name": "b", "sigma": 0.4, "epsilon": 4.0, "count": 1},
    ]
    spec = MoleculesModel(
        name="it", species=kinds, box=[4, 4, 4], cutoff=1.5, step=0.01
    )
    c12, c6 = np.moveaxis(pair_coefficients(spec), -1, 0)
    assert_allclose(c6 / c12, np.array([[0.3, 0.35], [0.35, 0.4]]) ** -6.0)
    assert_allclose(c6**2 / (4 * c12), [[1, 2], [2, 4]])
    # At the sixth root of 2 of sigma they rest, and that far down.
    placing = PeriodicBox(spec)
    for (i, j), depth in (((0, 0), 1.0), ((0, 1), 2.0), ((1, 1), 4.0)):
        near = 2 ** (1 / 6) * (kinds[i]["sigma"] + kinds[j]["sigma"]) / 2
        atoms = Atoms(
            np.array([[2.0, 2, 2], [2, 2 + near, 2]]),
            np.zeros((2, 3)),
            np.ones(2),
            np.array([i, j], np.int32),
            np.zeros(2),
            np.ones(2),
        )
        acting = Interactions(spec, atoms, placing).forces_at(
            atoms.points, atoms.points
        )
        assert acting.energies.sum() == pytest.approx(-depth)
        assert_allclose(acting.forces, 0, atol=1e-9)


def test_atoms_of_unequal_mass_are_as_warm_and_rest_as_a_whole() -> None:
    """Maxwell: squares of speeds go with 1/m, so that each kind has one temperature."""
    kinds = [{**ARGON, "mass": 4.0}, {**ARGON, "name": "heavy", "mass": 400.0}]
    spec = MoleculesModel(
        name="it", species=kinds, box=[4, 4, 4], step=0.001, temperature=120
    )
    atoms = Atoms.from_spec(spec, [{}, {}], PeriodicBox(spec))
    m, v = atoms.masses, atoms.velocities
    assert np.abs(m @ v).max() < 1e-10 * (m @ np.abs(v)).max()
    twice = m * (v**2).sum(axis=1)
    # Three of the degrees of freedom are those of the whole.
    assert twice.sum() / ((3 * 512 - 3) * BOLTZMANN_CONSTANT) == pytest.approx(120)
    for kind in (0, 1):
        own = twice[atoms.entry_indices == kind].mean() / (3 * BOLTZMANN_CONSTANT)
        assert own == pytest.approx(120, rel=0.1)


def test_what_is_reported_of_a_few_atoms_leaves_out_the_whole() -> None:
    """The mean of kinetic energy is over 3 N - 3 degrees of freedom, here 9."""
    few = {**ARGON, "count": 4, "mass": 20.0, "radius": 0.7}
    made = molecules(species=[few], temperature=90, scale=0.5)
    state = made.initial_state()
    values = made.values(state, 0.0)
    assert values["temperature"] == pytest.approx(90)
    assert values["kinetic_energy"] == pytest.approx(4.5 * BOLTZMANN_CONSTANT * 90)
    # Of each alone it is over three.
    squares = (state.motion[1] ** 2).sum(axis=1)
    found = made._quantities(state, 0.0)
    own = 20 * squares / (3 * BOLTZMANN_CONSTANT)
    assert_allclose(found["temperature"](), own)
    assert own.mean() == pytest.approx(90 * 9 / 12)
    assert_allclose(made.atoms.radii, 0.7)
    # Half of sigma, as large as a nanometre is shown.
    made = molecules(species=[{**ARGON, "count": 4}], scale=0.5)
    assert_allclose(made.atoms.radii, 0.3405 / 2 * 0.5)


def test_a_step_is_judged_by_the_stiffest_kind() -> None:
    """Of a crystal ω² is 8 k / m; k is how steeply force falls where two rest."""
    kinds = [
        {"name": "a", "sigma": 0.3, "epsilon": 0.5, "mass": 20.0, "count": 1},
        {"name": "b", "sigma": 0.4, "epsilon": 2.0, "mass": 10.0, "count": 1},
    ]
    stiffest = 0.0
    for one in kinds:
        spec = MoleculesModel(
            name="it", species=[one], box=[4, 4, 4], cutoff=1.9, switch=1.9, step=0.01
        )
        near = 2 ** (1 / 6) * one["sigma"]
        two = np.zeros(2, np.int32)
        pulls = []
        for off in (-1e-6, 1e-6):
            x = np.array([[2.0, 2, 2], [2, 2 + near + off, 2]])
            atoms = Atoms(x, 0 * x, np.ones(2), two, np.zeros(2), np.ones(2))
            pulls.append(
                Interactions(spec, atoms, PeriodicBox(spec))
                .forces_at(x, x)
                .forces[1, 1]
            )
        square = 8 * (pulls[0] - pulls[1]) / 2e-6 / one["mass"]
        stiffest = max(stiffest, np.sqrt(square))
        made = molecules(species=[one], box=[4, 4, 4], cutoff=1.9)
        assert made._max_frequency == pytest.approx(np.sqrt(square), rel=1e-4)
    both = molecules(species=kinds, box=[4, 4, 4], cutoff=1.9)
    assert both._max_frequency == pytest.approx(stiffest, rel=1e-4)


def test_lattices_have_as_long_cells_along_each_side() -> None:
    """64 atoms of a face-centred one in 4 by 2 by 2 nm are 16 cells of a nanometre."""
    species = [{**ARGON, "count": 64}]
    x = molecules(species=species, box=[4, 2, 2], cutoff=0.8).atoms.points
    for axis, count in enumerate((8, 4, 4)):
        expected = 0.25 + 0.5 * np.arange(count)
        assert_allclose(np.unique(np.round(x[:, axis], 9)), expected)
    # A block is in the middle of the box, with cells of its own.
    x = molecules(species=species, box=[4, 4, 4], block=[2, 1, 1]).atoms.points
    low, high = x.min(axis=0), x.max(axis=0)
    assert_allclose(low, [1.125, 1.625, 1.625])
    assert_allclose(high - low, [1.75, 0.75, 0.75])
    flat = {"box": [1000, 0.1, 0.1], "species": [{**ARGON, "count": 8}]}
    with raises(AnimtoolError, "SIM071", match="8 atoms do not fill a lattice"):
        molecules(**flat)


def test_kinds_that_alternate_keep_the_order_of_the_lattice() -> None:
    both = [{**ARGON, "count": 500}, {**ARGON, "name": "krypton", "count": 500}]
    x = molecules(species=both, lattice="cubic", box=[5, 5, 5]).atoms.points
    for kind in (x[:500], x[500:]):
        assert_array_equal(np.lexsort(kind.T[::-1]), np.arange(500))


def test_a_bath_warms_nothing_that_stands_still() -> None:
    bath = ThermostatModel(temperatures=[[0, 100]], relaxation=0.2)
    assert thermostat_factor(bath, 5, 0, 1.0, 0.1, 0.0, 30) == 1.0
    assert thermostat_factor(bath, 5, 0, 1.0, 0.1, 2.0, 0) == 1.0
    assert thermostat_factor(bath, 5, 0, 1.0, 0.0, 2.0, 30) == 1.0


@pytest.mark.parametrize("out", [[0, -1.5001, 0], [1.5001, 0, 0], [0, 0, -9]])
def test_one_atom_outside_of_the_box_is_refused(out: list[float]) -> None:
    """Half of 3 nm from its middle on; at the end itself it is within."""
    spec = MoleculesModel.model_validate(
        {"name": "it", "species": [{"name": "a"}], "box": [3, 3, 3]}
    )
    points = np.array([[1.5, 0, 0], [0, -1.5, 0.4], out], float)
    with raises(AnimtoolError, "SIM071"):
        _read_motion(spec.species[0], {"points": points}, PeriodicBox(spec))
    found, speeds = _read_motion(
        spec.species[0], {"points": points[:2]}, PeriodicBox(spec)
    )
    assert speeds is None
    assert_allclose(found, points[:2] + 1.5)
