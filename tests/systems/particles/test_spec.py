"""What of particles need not be given, and what scenes make of it."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from animtool.sim.colliders import Collider, Colliders, Plane, Poses
from animtool.systems.particles import Emitter, KillRegion, Particles, find_force
from animtool.systems.particles.simulation import ParticleSimulation, build
from animtool.systems.particles.spec import ParticlesModel


def test_what_an_emitter_is_where_nothing_is_given() -> None:
    own = Emitter()
    assert (own.rate, own.speed, own.speed_spread, own.spread) == (0, 0, 0, 0)
    assert (own.inherit, own.lifetime, own.lifetime_spread) == (1, math.inf, 0)
    assert (own.start, own.end, own.bursts) == (-math.inf, math.inf, ())
    assert (own.radius, own.radius_spread, own.mass) == (0.005, 0, 0.001)
    assert (own.charge, own.seed, own.direction, own.name) == (0, 0, None, "")
    whole = Particles([own])
    assert (whole.options.method, whole.options.step) == ("midpoint", 1 / 96)
    assert (whole.max_particles, whole.name) == (1_000_000, "particles")


def test_forces_where_nothing_is_given() -> None:
    zero = (0.0, 0.0, 0.0)
    for name, options in {
        "central": {"centre": zero, "strength": 1.0, "power": -2.0, "softening": 0.01},
        "charges": {"constant": 8.9875517862e9, "softening": 0.01},
        "drag": {"linear": 0.0, "quadratic": 0.0},
        "electromagnetic": {"electric": zero, "magnetic": zero},
        "field": {"x": "0", "y": "0", "z": "0"},
        "friction": {"deceleration": 0.0, "smooth": 0.01},
        "gravity": {"acceleration": (0.0, -9.81, 0.0)},
        "propulsion": {"thrust": 0.0, "direction": None, "duration": math.inf},
        "spring": {"anchor": None, "k": 1.0, "rest": 0.0, "kd": 0.0},
        "turbulence": {
            "strength": 1.0,
            "size": 1.0,
            "change": 0.5,
            "octaves": 2,
            "seed": 0,
        },
        "uniform": {"push": zero},
        "viscosity": {"viscosity": 1e-3},
        "wind": {"velocity": zero, "drag": 0.0},
    }.items():
        force = find_force(name)()
        assert {key: getattr(force, key) for key in options} == options


def test_what_a_scene_makes_of_its_entry() -> None:
    spec = ParticlesModel.model_validate(
        {
            "name": "it", "emitters": [{"rate": 1}], "method": "rk4", "step": 0.02,
            "max_particles": 7, "velocity": {"x": "1"},
        }
    )  # fmt: skip
    region = Collider(Plane(), Poses.fixed((0, 1, 0)))
    parts = {"emitters": [Emitter()], "forces": [], "kill": [region]}
    made = spec.setup(parts)
    assert (made.options.method, made.options.step) == ("rk4", 0.02)
    assert (made.max_particles, made.name, made.velocity) == (7, "it", None)
    assert [kill.region for kill in made.kills] == [region]
    assert spec.faults(parts) == ()
    wrong = spec.model_copy(update={"method": "rk5"})
    assert [(f.code, f.where) for f in wrong.faults(parts)] == [("SIM001", "method")]
    assert spec.reads == ["1 emitter", *spec.reads[1:-1], "a velocity field"]
    assert spec.counts == {"emitters": 1, "forces": 0, "max_particles": 7}
    assert spec.title == "particles"
    plain = ParticlesModel.model_validate({"name": "it", "emitters": [{"rate": 1}]})
    assert (plain.method, plain.step, plain.max_particles) == ("midpoint", 0.01, 10**6)


@pytest.mark.parametrize(
    ("height", "killed"), [(0.999, True), (1.0, False), (1.1, False)]
)
def test_a_region_kills_what_is_in_it(height: float, killed: bool) -> None:
    region = KillRegion(Collider(Plane(), Poses.fixed((0, 1, 0)), container=False))
    setup = Particles([Emitter(bursts=[(0.0, 1)])], kills=[region])
    state = ParticleSimulation(setup, 0.0).initial_state()
    moved = replace(state, state=np.array([[[5.0, height, 0]], [[0, 0, 0]]]))
    kept = ParticleSimulation(setup, 0.0)._remove_particles(moved, 0.0)
    assert len(kept.particles) == (not killed)


@pytest.mark.parametrize("budget", [None, 77])
def test_evaluations_of_a_step_are_as_many_as_the_context_allows(
    budget: int | None,
) -> None:
    spec = ParticlesModel.model_validate({"name": "it", "emitters": [{"rate": 1}]})
    parts = {"emitters": [Emitter(rate=1)], "forces": [], "kill": []}
    floor = Collider(Plane(), Poses.fixed())
    context = SimpleNamespace(
        entry_data=parts, colliders=Colliders([floor]), budget=budget, begin=2.0
    )
    made = build(spec, context)  # type: ignore[arg-type]
    assert made.begin == 2
    assert list(made.setup.colliders) == [floor]
    usual = spec.setup(parts).options.budget
    assert made.setup.options.budget == (usual if budget is None else budget)
