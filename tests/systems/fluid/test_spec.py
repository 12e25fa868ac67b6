"""What of a fluid need not be given, and what makes no sense together."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from animtool.core.errors import OptionError
from animtool.sim.colliders import Colliders
from animtool.systems.fluid import surface
from animtool.systems.fluid.fluid import Fluid, build
from animtool.systems.fluid.spec import FluidModel

BOX = {"shape": {"box": {"size": [1, 1, 1]}}}


def test_what_a_fluid_is_where_nothing_is_given() -> None:
    own = FluidModel.model_validate(
        {
            "name": "it",
            "spacing": 0.1,
            "emitters": [{"radius": 1}],
            "fills": [BOX],
            "surface": {},
        }
    )
    assert (own.density, own.viscosity, own.tension) == (1000, 1e-6, 0)
    assert (own.compression, own.max_particles, own.step) == (0.01, 1_000_000, 0.01)
    assert own.forces == [{"gravity": None}]
    assert own.primvars == []
    (tap,), (fill,) = own.emitters, own.fills
    assert (tap.speed, tap.size, tap.opens) == (1, None, [])
    assert (fill.name, fill.velocity, fill.points) == ("", [0, 0, 0], None)
    assert own.surface is not None
    assert (own.surface.smoothing, own.surface.max_cells) == (1, 50_000_000)
    assert own.surface.cell is None
    assert own.counts == {
        "fills": 1,
        "emitters": 1,
        "drains": 0,
        "max_particles": 1_000_000,
    }
    assert own.reads[:2] == [
        "1 fill",
        "1 emitter",
    ]
    drained = FluidModel.model_validate(
        {"name": "it", "spacing": 0.1, "fills": [BOX, BOX], "drains": [BOX]}
    )
    assert drained.reads[:2] == ["2 fills", "1 drain"]


@pytest.mark.parametrize(
    ("keys", "wheres"),
    [
        ({"fills": [BOX]}, []),
        ({}, ["fills"]),
        ({"emitters": [{"radius": 1}]}, []),
        ({"emitters": [{"radius": 1, "size": [1, 1]}]}, ["emitters[0]"]),
        ({"emitters": [{"radius": 1}, {}]}, ["emitters[1]"]),
        (
            {"emitters": [{"radius": 1, "opens": [[1, 1], [2, 1]]}]},
            ["emitters[0].opens"],
        ),
        ({"fills": [BOX, {}]}, ["fills[1]"]),
        ({"fills": [{**BOX, "points": "a"}]}, ["fills[0]"]),
        ({"fills": [{"points": "a", "velocities": "b"}]}, []),
        ({"fills": [{**BOX, "velocities": "b"}]}, ["fills[0].velocities"]),
        ({"fills": [{"shape": {"plane": {}}}, BOX]}, ["fills[0].shape"]),
        ({"fills": [{"shape": {"height_field": {}}}]}, ["fills[0].shape"]),
    ],
)
def test_keys_that_make_no_sense_together(keys: Any, wheres: list[str]) -> None:
    own = FluidModel.model_validate({"name": "it", "spacing": 0.1, **keys})
    assert [where for _, where, _ in own.problems()] == wheres


def test_a_surface_needs_what_makes_it_and_points_do_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(surface, "find_spec", lambda _: None)

    class Context:
        begin, colliders = 0.0, Colliders([])
        entry_data = {"fills": [{"points": np.zeros((1, 3))}]}  # noqa: RUF012

    def made(**keys: Any) -> Fluid:
        given = {"name": "it", "spacing": 0.1, "fills": [{"points": "a"}], **keys}
        return build(FluidModel.model_validate(given), Context())  # type: ignore[arg-type]

    assert made()
    with pytest.raises(OptionError) as error:
        made(surface={})
    assert error.value.code == "SIM065"
