"""Particles on the fields with a reference answer, and in the hard cases."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.data import data_files

from animtool.errors import OptionError
from animtool.sim import IntegrateOptions
from animtool.sim.colliders import Capsule, Collider, Plane, Poses, Sphere, Touch
from animtool.sim.particles import (
    Emitter,
    ParticleRun,
    Particles,
    VelocityField,
    find_force,
)

GRAVITY = find_force("gravity")()


def field_of(kind: str, params: dict[str, float]) -> VelocityField:
    if kind == "rigid_rotation":
        omega = params["omega"]
        return VelocityField(f"-{omega!r} * y", f"{omega!r} * x")
    k, u = 2 * np.pi / params["length"], params["U"]
    x = f"{u!r} * sin({float(k)!r} * x) * cos({float(k)!r} * y)"
    y = f"-{u!r} * cos({float(k)!r} * x) * sin({float(k)!r} * y)"
    return VelocityField(x, y)


@pytest.mark.parametrize("path", data_files("sim", "vortex_particle*.json"))
def test_a_particle_in_a_field_goes_where_it_should(path: Path) -> None:
    for case in json.loads(path.read_text("utf-8"))["instances"]:
        start = (case["initial"]["x"], case["initial"]["y"], 0.0)
        setup = Particles(
            [Emitter(poses=Poses.fixed(start), bursts=[(0, 1)])],
            velocity=field_of(case["field"], case["params"]),
            options=IntegrateOptions("rk45", step=1 / 96, tolerance=1e-11),
        )
        run = ParticleRun(setup)
        found = np.array([run.at(t).points[0] for t in case["t"]])
        wanted = np.stack([case["reference"]["x"], case["reference"]["y"]], axis=1)
        np.testing.assert_allclose(found[:, :2], wanted, rtol=0, atol=1e-8)
        assert not found[:, 2].any()


def thrown(**options: object) -> Particles:
    given = {"bursts": [(0, 5)], "speed": 3.0, "spread": 0.5, **options}
    floor = Collider(Plane((0, 1, 0), -0.2), restitution=0.5, friction=0.3)
    return Particles([Emitter(**given)], [GRAVITY], colliders=[floor])  # type: ignore[arg-type]


def _zero_mass() -> None:
    for mass in (0.0, -1.0, np.nan):
        with pytest.raises(OptionError) as error:
            ParticleRun(thrown(name="jet", mass=mass))
        (fault,) = error.value.faults
        assert (fault.code, fault.where) == ("SIM021", "jet")


def _dt_zero() -> None:
    run = ParticleRun(thrown())
    first, again = run.at(0.51), run.at(0.51)
    assert first.points.tobytes() == again.points.tobytes()
    assert first.velocities.tobytes() == again.velocities.tobytes()


def _dt_negative() -> None:
    run = ParticleRun(thrown())
    run.at(0.5)
    with pytest.raises(OptionError) as error:
        run.at(0.4)
    assert error.value.code == "SIM002"


def _dt_spike() -> None:
    every, spike = ParticleRun(thrown()), ParticleRun(thrown())
    frames = [every.at(k / 24) for k in range(25)]
    for k in (0, 6, 18, 24):
        assert spike.at(k / 24).points.tobytes() == frames[k].points.tobytes()


def _teleport() -> None:
    poses = Poses(
        [0, 1, 1 + 1 / 24], [[0, 0, 0], [0, 0, 0], [100, 0, 0]], [[0, 0, 0, 1]] * 3
    )
    jumping = Collider(Capsule(0.5, 1, (1, 0, 0)), poses, restitution=1.0)
    on_top = Emitter(poses=Poses.fixed((0, 0.6, 0)), bursts=[(0, 1)])
    inside = Emitter(poses=Poses.fixed((100, 0.3, 0)), bursts=[(0, 1)])
    between = Emitter(poses=Poses.fixed((50, 0, 0)), bursts=[(0, 1)])
    run = ParticleRun(Particles([on_top, inside, between], colliders=[jumping]))
    frame = run.at(2.0)
    assert np.linalg.norm(frame.velocities, axis=1).max() < 1e-9
    assert frame.points[2].tolist() == [50, 0, 0]
    assert np.isfinite(frame.points).all()
    assert [notice.code for notice in run.notices] == ["SIM120"]


def _rest_contact() -> None:
    floor = Collider(Plane(), restitution=0.5, friction=0.5)
    still = Emitter(poses=Poses.fixed((0, 0.005, 0)), bursts=[(0, 1)])
    run = ParticleRun(Particles([still], [GRAVITY], colliders=[floor]))
    for k in range(60 * 24):
        frame = run.at(k / 24)
        assert np.abs(frame.velocities).max() < 1e-6
        assert abs(frame.points[0, 1] - 0.005) < 1e-8


def _deep_start() -> None:
    ball = Collider(Sphere(1.0), depenetration=0.5)
    deep = Emitter(poses=Poses.fixed((0.5, 0, 0)), bursts=[(0, 1)])
    run = ParticleRun(Particles([deep], colliders=[ball]))
    places = np.array([run.at(k / 24).points[0, 0] for k in range(49)])
    assert np.diff(places).max() <= 0.5 / 24 + 1e-9
    assert places[-1] == pytest.approx(1.005, abs=1e-6)


def _pinched() -> None:
    def closing(side: float) -> Collider:
        origins = [[-0.5 * side, 0, 0], [0, 0, 0]]
        poses = Poses([0, 1], origins, [[0, 0, 0, 1]] * 2)
        return Collider(Capsule(0.2, 1), poses, restitution=0.5)

    pea = Emitter(poses=Poses.fixed((0.01, 0, 0)), bursts=[(0, 1)])
    run = ParticleRun(Particles([pea], colliders=[closing(-1), closing(1)]))
    touches = set()
    for k in range(25):
        frame = run.at(k / 24)
        assert np.isfinite(frame.points).all()
        assert np.abs(frame.velocities).max() <= 10.0
        if run.contacts is not None:
            touches |= set(run.contacts.touches.tolist())
    assert Touch.UNRESOLVED in touches


CASES: dict[str, Callable[[], None]] = {
    "zero_mass_unpinned": _zero_mass,
    "dt_zero": _dt_zero,
    "dt_negative": _dt_negative,
    "dt_spike": _dt_spike,
    "collider_teleport": _teleport,
    "rest_contact": _rest_contact,
    "deep_start_penetration": _deep_start,
    "pinched": _pinched,
}


def hard_cases() -> list[object]:
    """Return a parameter a hard case that particles have."""
    found: list[object] = []
    for param in data_files("sim", "hard_cases*.json"):
        (path,) = param.values
        if path is None:
            return [param]
        listed = json.loads(path.read_text("utf-8"))["instances"]
        found += [
            pytest.param(entry["id"], id=entry["id"])
            for entry in listed
            if entry["id"] in CASES
        ]
    return found


@pytest.mark.parametrize("case", hard_cases())
def test_hard_cases_of_particles(case: str) -> None:
    CASES[case]()
