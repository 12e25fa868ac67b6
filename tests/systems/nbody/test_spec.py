"""What of bodies and galaxies need not be given."""

from __future__ import annotations

from animtool.systems.nbody.spec import NbodyModel


def test_what_galaxies_are_where_nothing_is_given() -> None:
    part = {"mass": 1, "radius": 1, "count": 3}
    own = NbodyModel.model_validate(
        {
            "name": "it", "bodies": [{"points": "a"}], "attractors": [{"mass": 1}],
            "galaxies": [{"name": "a", "disc": part, "bulge": part, "halo": part}],
            "encounter": {"separation": 2, "pericentre": 1},
        }
    )  # fmt: skip
    assert (own.gravity_constant, own.softening, own.accuracy) == (1, 0.05, 2e-4)
    assert (own.substeps, own.method, own.step) == (64, "velocity_verlet", 0.01)
    (body,), (mass,), (galaxy,) = own.bodies, own.attractors, own.galaxies
    assert (body.mass, body.radius, mass.softening) == (1, 0.02, 0.1)
    assert (galaxy.shows_halo, galaxy.nucleus, galaxy.seed) == (True, 0, 0)
    assert (galaxy.radius, galaxy.at, galaxy.velocity) == (0.02, [0] * 3, [0] * 3)
    assert galaxy.rotate == [1, 0, 0, 0]
    assert galaxy.disc is not None
    assert galaxy.halo is not None
    disc, halo = galaxy.disc, galaxy.halo
    assert (disc.thickness, disc.cutoff, disc.stability) == (0.1, 5, 1.2)
    assert (halo.profile, halo.cutoff) == ("hernquist", 10)
    assert own.encounter is not None
    assert (own.encounter.eccentricity, own.encounter.at) == (1, [0, 0, 0])
    assert galaxy.hidden_count == 0
    hidden = galaxy.model_copy(update={"shows_halo": False})
    assert hidden.hidden_count == 3
