"""Signs of a blow-up, of particles that come and go."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from animtool.core.errors import OptionError, ToleranceError
from animtool.sim import IntegrateOptions
from animtool.sim.colliders import Box, Collider, Plane, Poses, Sphere
from animtool.systems.particles import (
    Emitter,
    Force,
    KillRegion,
    ParticleRun,
    Particles,
    find_force,
)

STEP = 1 / 96
GRAVITY = find_force("gravity")()
# Just beyond 2/h, and just within it.
BEYOND, WITHIN = (2 * share / STEP for share in (1.001, 0.95))
# Particles are removed before they are no numbers any more, and after they blew up.
NEAR = KillRegion(Collider(Sphere(2.0), container=True))


def swinging(omega: float, *forces: Force, **more: object) -> ParticleRun:
    jet = Emitter(rate=50, speed=1, spread=np.pi, mass=1, lifetime=3)
    spring = find_force("spring")(k=omega**2)
    options = IntegrateOptions("velocity_verlet", step=STEP)
    setup = Particles([jet], [spring, *forces], kills=[NEAR], options=options)
    return ParticleRun(setup, **more)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "forces", [[], [find_force("turbulence")(strength=0.1)]], ids=["alone", "swirls"]
)
def test_a_slow_blow_up_is_seen_before_particles_are_removed(
    forces: list[Force],
) -> None:
    run = swinging(BEYOND, *forces)
    with pytest.raises(ToleranceError) as error:
        run.at(20.0)
    codes = [fault.code for fault in error.value.faults]
    assert codes == ["SIM101", "SIM102"]
    assert pickle.loads(pickle.dumps(error.value)).faults == error.value.faults
    assert [notice.code for notice in run.notices] == ["SIM101"]
    hint = error.value.faults[-1].hint
    assert hint is not None
    assert "stable up to steps of" in hint


@pytest.mark.slow
def test_births_and_removals_are_no_gain() -> None:
    run = swinging(WITHIN)
    assert len(run.at(12.0).ids) == pytest.approx(150, abs=2)
    assert not run.notices


def test_what_goes_on_from_the_middle_is_watched() -> None:
    first = swinging(BEYOND)
    first.at(0.05)
    with pytest.raises(ToleranceError):
        swinging(BEYOND, state=first.state).at(20.0)


def test_what_a_piston_gives_is_no_blow_up() -> None:
    times, ways = [0, 1, 2], [[0, -1, 0], [0, -1, 0], [0, 60, 0]]
    piston = Collider(
        Box((4, 1, 4)), Poses(times, ways, [[0, 0, 0, 1]] * 3), restitution=1.0
    )
    still = Emitter(poses=Poses.fixed((0, 0.2, 0)), bursts=[(0, 3)])
    run = ParticleRun(Particles([still], colliders=[piston]))
    assert run.at(2.0).velocities[:, 1] == pytest.approx(122, rel=0.01)


def test_what_is_moved_out_may_fall() -> None:
    ball = Collider(Sphere(0.5), Poses.fixed((0, 0.4, 0)), name="ball")
    inside = Emitter(poses=Poses.fixed((0.1, 0.5, 0)), bursts=[(0, 3)])
    floor = Collider(Plane(offset=-20.0))
    run = ParticleRun(Particles([inside], [GRAVITY], colliders=[ball, floor]))
    frame = run.at(6.0)
    assert frame.points[:, 1] == pytest.approx(-20, abs=0.01)
    (notice,) = run.notices
    assert notice.code == "SIM123"
    assert "'ball'" in notice.message
    assert "particle 0" in notice.message


def test_a_force_that_is_no_number_is_no_blow_up() -> None:
    field = find_force("field")(x="1 / (t - t)")
    run = ParticleRun(Particles([Emitter(bursts=[(0, 1)])], [field]))
    with pytest.raises(OptionError) as error:
        run.at(1.0)
    assert error.value.code == "SIM003"


@pytest.mark.slow
@pytest.mark.parametrize("method", ["midpoint", "rk45", "radau"])
def test_particles_that_go_with_the_air_are_looked_at(method: str) -> None:
    wind = find_force("wind")(velocity=(30, 0, 0), drag=0.01)
    options = IntegrateOptions(method, step=STEP)
    setup = Particles([Emitter(rate=5, lifetime=2)], [wind], options=options)
    frame = ParticleRun(setup).at(3.0)
    assert np.isfinite(frame.points).all()
    assert frame.velocities[:, 0].max() == pytest.approx(30, rel=0.01)
