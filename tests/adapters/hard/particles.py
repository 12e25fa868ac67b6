"""Hard cases of particles."""

from __future__ import annotations

import numpy as np
import pytest
from adapters.hard.subsystem import Subsystem, resting_seconds

from animtool.core.errors import OptionError
from animtool.sim import IntegrateOptions
from animtool.sim.colliders import Capsule, Collider, ContactKind, Plane, Poses, Sphere
from animtool.systems.particles import Emitter, ParticleRun, Particles, find_force

__all__ = ["PARTICLES"]

GRAVITY = find_force("gravity")()
# Methods that leave room for contacts.
METHODS = ["midpoint", "symplectic_euler", "rk4", "implicit_euler", "rk45"]


def options_for(method: str) -> IntegrateOptions:
    return IntegrateOptions(method, step=1 / 96)


def thrown(method: str, **more: object) -> Particles:
    given = {"bursts": [(0, 5)], "speed": 3.0, "spread": 0.5, **more}
    floor = Collider(Plane((0, 1, 0), -0.2), restitution=0.5, friction=0.3)
    return Particles(
        [Emitter(**given)],  # type: ignore[arg-type]
        [GRAVITY],
        colliders=[floor],
        options=options_for(method),
    )


def _coincident(method: str) -> None:
    at_one = Emitter(bursts=[(0, 4)], charge=1e-6, mass=0.01)
    forces = [find_force("charges")(), find_force("spring")(k=5.0, rest=0.2)]
    setup = Particles([at_one], forces, options=options_for(method))
    found, again = (ParticleRun(setup).at(0.5) for _ in range(2))
    assert np.isfinite(found.points).all()
    assert found.points.tobytes() == again.points.tobytes()


def _no_length(method: str) -> None:
    still = Emitter(poses=Poses.fixed((1, 2, 3)), bursts=[(0, 2)])
    forces = [find_force("spring")(k=100.0)]
    run = ParticleRun(Particles([still], forces, options=options_for(method)))
    frame = run.at(0.5)
    assert frame.points.tolist() == [[1, 2, 3]] * 2
    assert not frame.velocities.any()


def _zero_mass(method: str) -> None:
    for mass in (0.0, -1.0, np.nan):
        with pytest.raises(OptionError) as error:
            ParticleRun(thrown(method, name="jet", mass=mass))
        (fault,) = error.value.faults
        assert (fault.code, fault.where) == ("SIM021", "jet")


def _dt_zero(method: str) -> None:
    run = ParticleRun(thrown(method))
    first, again = run.at(0.51), run.at(0.51)
    assert first.points.tobytes() == again.points.tobytes()
    assert first.velocities.tobytes() == again.velocities.tobytes()


def _dt_negative(method: str) -> None:
    run = ParticleRun(thrown(method))
    run.at(0.5)
    with pytest.raises(OptionError) as error:
        run.at(0.4)
    assert error.value.code == "SIM002"


def _dt_spike(method: str) -> None:
    every, spike = ParticleRun(thrown(method)), ParticleRun(thrown(method))
    frames = [every.at(k / 24) for k in range(25)]
    for k in (0, 6, 18, 24):
        assert spike.at(k / 24).points.tobytes() == frames[k].points.tobytes()


def _teleport(method: str) -> None:
    poses = Poses(
        [0, 1, 1 + 1 / 24], [[0, 0, 0], [0, 0, 0], [100, 0, 0]], [[0, 0, 0, 1]] * 3
    )
    jumping = Collider(Capsule(0.5, 1, (1, 0, 0)), poses, restitution=1.0)
    on_top = Emitter(poses=Poses.fixed((0, 0.6, 0)), bursts=[(0, 1)])
    inside = Emitter(poses=Poses.fixed((100, 0.3, 0)), bursts=[(0, 1)])
    between = Emitter(poses=Poses.fixed((50, 0, 0)), bursts=[(0, 1)])
    run = ParticleRun(
        Particles(
            [on_top, inside, between], colliders=[jumping], options=options_for(method)
        )
    )
    frame = run.at(2.0)
    assert np.linalg.norm(frame.velocities, axis=1).max() < 1e-9
    assert frame.points[2].tolist() == [50, 0, 0]
    assert np.isfinite(frame.points).all()
    assert [notice.code for notice in run.notices] == ["SIM120", "SIM123"]


def _rest_contact(method: str) -> None:
    floor = Collider(Plane(), restitution=0.5, friction=0.5)
    still = Emitter(poses=Poses.fixed((0, 0.005, 0)), bursts=[(0, 1)])
    options = IntegrateOptions(method, step=1 / 12)
    run = ParticleRun(Particles([still], [GRAVITY], colliders=[floor], options=options))
    for t in range(0, resting_seconds(method, METHODS) + 1, 4):
        frame = run.at(t)
        assert np.abs(frame.velocities).max() < 1e-6
        assert abs(frame.points[0, 1] - 0.005) < 1e-8


def _deep_start(method: str) -> None:
    ball = Collider(Sphere(1.0), depenetration=0.5)
    deep = Emitter(poses=Poses.fixed((0.5, 0, 0)), bursts=[(0, 1)])
    run = ParticleRun(Particles([deep], colliders=[ball], options=options_for(method)))
    places = np.array([run.at(k / 24).points[0, 0] for k in range(49)])
    assert np.diff(places).max() <= 0.5 / 24 + 1e-9
    assert places[-1] == pytest.approx(1.005, abs=1e-6)


def _pinched(method: str) -> None:
    def closing(side: float) -> Collider:
        origins = [[-0.5 * side, 0, 0], [0, 0, 0]]
        poses = Poses([0, 1], origins, [[0, 0, 0, 1]] * 2)
        return Collider(Capsule(0.2, 1), poses, restitution=0.5)

    pea = Emitter(poses=Poses.fixed((0.01, 0, 0)), bursts=[(0, 1)])
    run = ParticleRun(
        Particles(
            [pea], colliders=[closing(-1), closing(1)], options=options_for(method)
        )
    )
    touches = set()
    for k in range(25):
        frame = run.at(k / 24)
        assert np.isfinite(frame.points).all()
        assert np.abs(frame.velocities).max() <= 10.0
        if run.contacts is not None:
            touches |= set(run.contacts.touches.tolist())
    assert ContactKind.UNRESOLVED in touches
    assert [notice.code for notice in run.notices] == ["SIM123"]


PARTICLES = Subsystem(
    "particles",
    METHODS,
    {
        "coincident_particles": _coincident,
        "zero_rest_length": _no_length,
        "zero_mass_unpinned": _zero_mass,
        "dt_zero": _dt_zero,
        "dt_negative": _dt_negative,
        "dt_spike": _dt_spike,
        "collider_teleport": _teleport,
        "rest_contact": _rest_contact,
        "deep_start_penetration": _deep_start,
        "pinched": _pinched,
    },
    {
        "all_coincident": "particles that springs do not join may be at one place",
        "both_ends_pinned": "no particle is held",
        "stiff_and_heavy": "springs lead from a particle to a point, not to others",
    },
)
