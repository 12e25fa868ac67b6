"""What of molecules need not be given, and the constants of their units."""

from __future__ import annotations

from math import pi

import pytest
from scipy import constants

from animtool.systems.molecules.atoms import BOLTZMANN_CONSTANT, COULOMB_CONSTANT
from animtool.systems.molecules.molecules import MEGAPASCALS_PER_UNIT
from animtool.systems.molecules.spec import (
    AtomsModel,
    MoleculesModel,
    ThermostatModel,
    TrapModel,
)


def test_constants_are_those_of_nanometres_picoseconds_and_kilojoules_a_mole() -> None:
    mole = constants.Avogadro / 1000
    coulomb = constants.e**2 / (4 * pi * constants.epsilon_0)
    assert pytest.approx(constants.k * mole, rel=1e-9) == BOLTZMANN_CONSTANT
    assert pytest.approx(coulomb * mole * 1e9, rel=1e-8) == COULOMB_CONSTANT
    assert pytest.approx(1e27 / mole / 1e6, rel=1e-8) == MEGAPASCALS_PER_UNIT


def test_what_atoms_and_their_box_are_where_nothing_is_given() -> None:
    own = AtomsModel(name="argon")
    assert (own.count, own.mass) == (256, 39.948)
    assert (own.sigma, own.epsilon, own.charge) == (0.3405, 0.9961, 0)
    assert (own.points, own.velocities, own.radius) == (None, None, None)
    assert ThermostatModel(temperatures=[[0, 1]]).relaxation == 0.2
    assert TrapModel(stiffness=1).radius == 0.5
    box = {"name": "it", "species": [{"name": "argon"}], "box": [3, 3, 3]}
    whole = MoleculesModel.model_validate(box)
    assert (whole.at, whole.lattice, whole.block) == ([0, 0, 0], "fcc", None)
    assert (whole.scale, whole.pace, whole.temperature) == (1, 1, 0)
    assert (whole.thermostat, whole.cutoff, whole.switch) == (None, None, None)
    assert (whole.damping, whole.skin, whole.traps) == (2, 0.12, [])
    assert (whole.seed, whole.method, whole.colour) == (0, "velocity_verlet", None)
    assert whole.cutoff_distance == pytest.approx(2.5 * 0.3405)
    species = [{"name": "a", "sigma": 0.2}, {"name": "b", "sigma": 0.4}]
    assert (
        MoleculesModel.model_validate({**box, "species": species}).cutoff_distance
        == 1.0
    )


def test_kilograms_and_angstroms_are_named() -> None:
    box = {"name": "it", "box": [2.3, 2.3, 2.3]}
    for entry, key, hint in (
        ({"mass": 6.63e-26, "sigma": 0.3}, "species[0].mass", "write 39.93"),
        ({"sigma": 3.405}, "species[0].sigma", "ångström write sigma: 0.3405"),
        ({"sigma": 340.5}, "species[0].sigma", "pm write sigma: 0.3405"),
        ({"sigma": 0.9}, "box", "use cutoff: 1.15, or a larger box"),
    ):
        species = [{"name": "argon", **entry}]
        model = MoleculesModel.model_validate({**box, "species": species})
        ((_, found_key, found_hint),) = model.problems()
        assert (found_key, str(found_hint).endswith(hint)) == (key, True)
