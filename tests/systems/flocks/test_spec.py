"""What of a flock need not be given."""

from __future__ import annotations

from animtool.systems.flocks.spec import FlocksModel, SpeciesModel


def test_what_members_do_where_nothing_is_given() -> None:
    own = SpeciesModel.model_validate({"name": "s"})
    assert (own.count, own.spread, own.seed, own.beat, own.banking) == (
        100,
        20,
        0,
        0,
        1,
    )
    assert (own.radius, own.mass) == (0.1, 0.1)
    assert own.place == {"sphere": {"radius": 2.0}}
    vision, repulsion, speed = own.vision, own.repulsion, own.speed
    assert (vision.radius, vision.angle, vision.nearest) == (2, 360, None)
    assert (own.attraction.weight, own.alignment.weight) == (0.8, 1.5)
    assert (repulsion.weight, repulsion.softening, repulsion.least) == (0.15, 0.1, None)
    assert (speed.cruise, speed.weight, speed.least, speed.most) == (3, 0.2, 0, None)
    assert (own.avoidance.distance, own.avoidance.weight) == (1.5, 10)
    ways = {
        "goals": [{"at": [1, 2, 3], "weight": 1}],
        "paths": [{"points": [[0, 0, 0], [1, 0, 0]]}],
    }
    own = SpeciesModel.model_validate({"name": "s", **ways})
    (goal,), (path,) = own.goals, own.paths
    assert (goal.radius, goal.limit) == (0, None)
    assert (path.closed, path.weight, path.ahead, path.radius) == (False, 0.5, 2, 0)
    spec = FlocksModel.model_validate(
        {"name": "it", "species": [{"name": "s"}], "domain": {"size": [9, 9, 9]}}
    )
    assert (spec.step, spec.method) == (0.01, "midpoint")
    assert spec.domain is not None
    assert (spec.domain.at, spec.domain.wrap) == ([0, 0, 0], False)
