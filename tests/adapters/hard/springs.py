"""Hard cases of springs, by their own solvers and by integrators."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from adapters.hard.subsystem import Subsystem, resting_seconds

from animtool.core.errors import OptionError
from animtool.sim import (
    INTEGRATORS,
    Checkpoint,
    IntegrateOptions,
    Status,
    Trajectory,
    find_integrator,
    integrate,
)
from animtool.sim.colliders import Capsule, Collider, ContactKind, Plane, Poses, Sphere
from animtool.sim.integrators.integrator import StepControl
from animtool.systems.springs import (
    Body,
    Family,
    Pins,
    Solver,
    SpringOptions,
    Springs,
    SpringSystem,
    rope,
    sheet,
    simulate_springs,
    springs_between,
)

__all__ = ["BY_INTEGRATORS", "BY_SOLVERS"]

FRAME = 1 / 24
UP = (0.0, 0.0, 1.0)
STILL = (0.0, 0.0, 0.0, 1.0)
CONTROLS = {name: find_integrator(name).control for name in INTEGRATORS}
# scipy's solvers leave no room for contacts and pins that move.
METHODS = [
    name for name, control in CONTROLS.items() if control is not StepControl.SCIPY
]
WAYS = [f"integrate {name}" for name in METHODS]
SOFT = Family(100.0, 0.1)
# Steps of implicit methods, which cost more and are stable with any [s].
LONG = 1 / 96
# With less, some explicit methods are not stable at this step [1/s].
DRAG = 5.0
# Within the film frame of methods that are stable with any step [N/m].
STIFF, HEAVY = 1e6, 1e3


def taken(
    system: SpringSystem, way: str, times: Any, step: float = 1 / 480
) -> Trajectory:
    """Return a motion by a solver, or an integrator."""
    *integrator, name = way.split()
    if integrator:
        return by_integrator(system, name, times, step)
    return simulate_springs(system, times, SpringOptions(name))


def by_integrator(
    system: SpringSystem,
    name: str,
    times: Any,
    step: float,
    checkpoint: Checkpoint | None = None,
) -> Trajectory:
    if CONTROLS[name] is StepControl.FIXED:
        if find_integrator(name).is_implicit:
            step = max(step, LONG)
        options = IntegrateOptions(name, step=step)
    else:
        options = IntegrateOptions(name, tolerance=1e-7)
    return integrate(system, times, options, checkpoint)


def codes(motion: Trajectory) -> list[str]:
    return [notice.code for notice in motion.notices]


def line(count: int, rest: float | None, mass: float = 0.1) -> Body:
    """Return a rope whose particles are all at one place."""
    places = np.ones((count, 3))
    ends = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
    springs = springs_between(ends, SOFT, places, np.ones(count), rest)
    masses = np.full(count, mass)
    return Body(places, masses, springs, np.zeros((0, 3), np.int64))


def alone(place: tuple[float, float, float], *colliders: Collider) -> SpringSystem:
    """Return a particle without springs."""
    none = np.zeros((0, 3), np.int64)
    body = Body(np.array([place]), np.ones(1), Springs.none(), none)
    return SpringSystem(body, colliders=colliders)


def hung() -> Body:
    return rope([0, 0, 0], [0, 0, -0.5], 6, Family(1e3, ratio=0.5), mass=0.05)


def _coincident(way: str) -> None:
    for count in (2, 5):
        system = SpringSystem(line(count, 0.5))
        found, again = (taken(system, way, [0, 0.125]) for _ in range(2))
        assert np.isfinite(found.states).all()
        assert found.states.tobytes() == again.states.tobytes()
        assert "SIM140" in codes(found)


def _all_coincident(way: str) -> None:
    flat = sheet(4, 4, mass=0.16, structural=SOFT, diagonals=SOFT, bend=SOFT)
    at_one = replace(flat, positions=np.zeros_like(flat.positions))
    system = SpringSystem(at_one, pins=Pins([0]))
    found, again = (taken(system, way, [0, 0.125]) for _ in range(2))
    assert np.isfinite(found.states).all()
    assert found.states.tobytes() == again.states.tobytes()
    (notice,) = [notice for notice in found.notices if notice.code == "SIM140"]
    assert "every spring" in notice.message


def _no_length(way: str) -> None:
    system = SpringSystem(line(3, 0.0), gravity=(0, 0, 0))
    assert not system.acceleration(0.0, *system.state).any()
    motion = taken(system, way, [0, 0.25])
    assert motion.states[0].tobytes() == motion.states[1].tobytes()
    assert "SIM140" not in codes(motion)


def _no_mass(way: str) -> None:  # noqa: ARG001 - before any way
    for mass in (0.0, -1.0, np.nan):
        with pytest.raises(OptionError) as error:
            SpringSystem(line(3, 0.5, mass))
        assert {fault.code for fault in error.value.faults} == {"SIM040"}
        assert "particle 0" in error.value.faults[0].message


def _held_ends(way: str) -> None:
    body = rope([0, 0, 0], [0, 0, -0.2], 3, SOFT, mass=0.1)
    system = SpringSystem(body, pins=Pins([0, 1]))
    motion = taken(system, way, [0, 0.25])
    assert np.isfinite(motion.states).all()
    np.testing.assert_array_equal(motion.positions[1, :2], body.positions[:2])


def swinging() -> SpringSystem:
    return SpringSystem(hung(), pins=Pins([0]), drag=DRAG, gravity=(2, 0, -9.81))


def _dt_zero(way: str) -> None:
    found = taken(swinging(), way, np.array([0, 1, 1, 2, 2]) * FRAME)
    once = taken(swinging(), way, np.array([0, 1, 2]) * FRAME)
    assert found.states[1].tobytes() == found.states[2].tobytes()
    assert found.states[[0, 1, 3]].tobytes() == once.states.tobytes()


def _dt_negative(way: str) -> None:
    with pytest.raises(OptionError) as error:
        taken(swinging(), way, [0, FRAME, 0])
    assert error.value.code == "SIM002"


def _dt_spike(way: str) -> None:
    every = np.arange(8) / 24
    kept = np.append(np.arange(2), np.arange(6, 8))
    whole = taken(swinging(), way, every)
    found = taken(swinging(), way, every[kept])
    if CONTROLS.get(way.rsplit(maxsplit=1)[-1]) is StepControl.ADAPTIVE:
        # Its steps end on the times that are asked for.
        np.testing.assert_allclose(found.states, whole.states[kept], atol=1e-5)
        return
    assert found.states.tobytes() == whole.states[kept].tobytes()


def _teleport(way: str) -> None:
    body, times = hung(), [0, FRAME, 2 * FRAME, 9]
    far = np.array([100.0, 0, 0])
    places = np.stack([body.positions[:1] + shift for shift in (0, 0, far, far)])
    frames = np.arange(13) * FRAME
    pinned = SpringSystem(body, pins=Pins([0], places, times), drag=DRAG)
    jumped = taken(pinned, way, frames)
    assert jumped.stats.status is Status.OK
    assert "SIM122" in codes(jumped)
    assert stretch(jumped) < 0.05
    assert np.linalg.norm(jumped.velocities, axis=2).max() < 1
    poses = Poses(times, [[-50, 0, -0.2], [-50, 0, -0.2], [50, 0, -0.2], [50, 0, -0.2]],
                  [STILL] * 4)  # fmt: skip
    ball = Collider(Capsule(0.1, 0.2), poses)
    hit = taken(
        SpringSystem(body, pins=Pins([0]), drag=DRAG, colliders=[ball]), way, frames
    )
    assert hit.stats.status is Status.OK
    assert "SIM120" in codes(hit)
    assert stretch(hit) < 0.05
    assert np.linalg.norm(hit.velocities, axis=2).max() < 1


def stretch(motion: Trajectory) -> float:
    lengths = np.linalg.norm(np.diff(motion.positions, axis=1), axis=2)
    return float(lengths.max() / 0.1 - 1)


def stiff_and_heavy() -> SpringSystem:
    """Return the stiffest rope of the references, level at first."""
    body = rope(
        [0, 0, 0], [0.9, 0, 0], 10, Family(STIFF, 2.0), mass=0.01, tip_mass=0.01 * HEAVY
    )
    return SpringSystem(body, pins=Pins([0]), resistance=0.005)


def _stiff(way: str) -> None:
    frames = np.arange(25) * FRAME
    motion = taken(stiff_and_heavy(), way, frames, FRAME)
    assert motion.stats.status is Status.OK
    assert stretch(motion) < 0.01
    if way in list(Solver) and way not in {Solver.AUTO, Solver.SYMPLECTIC_EULER}:
        options = SpringOptions(way, step=FRAME)
        assert stretch(simulate_springs(stiff_and_heavy(), frames, options)) < 0.01


def _rests(way: str) -> None:
    floor = Collider(Plane(UP), friction=0.5, restitution=0.3)
    times = np.arange(0, resting_seconds(way, WAYS) + 1, 4)
    motion = taken(alone((0, 0, 0), floor), way, times, 1 / 4)
    assert np.abs(motion.velocities[1:]).max() < 1e-6
    assert np.abs(motion.positions[1:]).max() < 1e-6


def _deep(way: str) -> None:
    speed = 0.8
    ball = Collider(Sphere(1.0), depenetration=speed)
    motion = taken(alone((0, 0, 0.5), ball), way, np.arange(25) * FRAME, 1 / 96)
    ways = np.linalg.norm(np.diff(motion.positions[:, 0], axis=0), axis=1)
    apart = np.linalg.norm(motion.positions[:, 0], axis=1)
    inside = apart[1:] < 1 - 1e-6
    assert ways[inside].max() <= speed * FRAME * 1.001
    assert apart[-1] >= 1 - 1e-6
    # Beside the surface it is carried by nothing but its weight.
    assert np.linalg.norm(motion.velocities[:, 0], axis=1).max() < 9.81


def _pinched(way: str) -> None:
    shut = np.array([0.3, 0.05, 0.05])
    closing = [
        Collider(
            Capsule(0.1, 1.0, (1.0, 0, 0)),
            Poses([0.0, 0.5, 1.0], np.outer(side * shut, UP), [STILL] * 3),
        )
        for side in (1, -1)
    ]
    system = alone((0, 0, 0), *closing)
    if not way.startswith("integrate"):
        motion = taken(system, way, np.arange(25) * FRAME)
        assert "SIM123" in codes(motion)
        check_pinched(motion)
        return
    checkpoint, touches = None, set()
    for k in range(24):
        times = np.array([k, k + 1]) * FRAME
        motion = by_integrator(system, way.split()[1], times, FRAME / 4, checkpoint)
        check_pinched(motion)
        checkpoint = motion.checkpoint
        assert system.contacts is not None
        touches |= set(system.contacts.touches.tolist())
    assert ContactKind.UNRESOLVED in touches


def check_pinched(motion: Trajectory) -> None:
    assert np.isfinite(motion.states).all()
    assert np.linalg.norm(motion.velocities, axis=2).max() < 10


CASES = {
    "coincident_particles": _coincident,
    "all_coincident": _all_coincident,
    "zero_rest_length": _no_length,
    "zero_mass_unpinned": _no_mass,
    "both_ends_pinned": _held_ends,
    "dt_zero": _dt_zero,
    "dt_negative": _dt_negative,
    "dt_spike": _dt_spike,
    "collider_teleport": _teleport,
    "stiff_and_heavy": _stiff,
    "rest_contact": _rests,
    "deep_start_penetration": _deep,
    "pinched": _pinched,
}
BY_SOLVERS = Subsystem("springs", list(map(str, Solver)), CASES, {})


def _lags(way: str) -> bool:
    """Return whether places lag velocities by a step: weight is not seen to rest."""
    return way.split()[1] == "euler"


def _not_for_stiff(way: str) -> bool:
    """Return whether a method needs tens of thousands of steps in a film's frame."""
    return way.split()[1] not in {"implicit_euler", "bdf2"}


BY_INTEGRATORS = Subsystem(
    "springs, integrated",
    WAYS,
    CASES,
    {},
    {"stiff_and_heavy": _not_for_stiff, "rest_contact": _lags},
)
