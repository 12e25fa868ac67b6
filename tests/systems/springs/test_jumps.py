"""Pins and targets that are put elsewhere at once."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.suite import examples

from animtool.core.array_types import FloatArray
from animtool.core.errors import OptionError
from animtool.maths import so3
from animtool.sim import IntegrateOptions, Status, Trajectory, integrate
from animtool.systems.springs import (
    Body,
    Family,
    Pins,
    PointTargets,
    Solver,
    SpringOptions,
    SpringSystem,
    join,
    rope,
    sheet,
    simulate_springs,
)

FRAME = 1 / 24
SOLVERS = [solver for solver in Solver if solver is not Solver.AUTO]
METHODS = ["symplectic_euler", "velocity_verlet", "rk4", "implicit_euler", "rk45"]
WAYS = [*map(str, SOLVERS), *(f"integrate {method}" for method in METHODS)]


def line(x: float = 0.0) -> Body:
    return rope([x, 0, 0], [x + 0.5, 0, 0], 6, Family(500.0, ratio=0.1), mass=0.05)


def path(at: float, far: FloatArray, places: FloatArray) -> Pins:
    """Return pins of a rope's first particles that jump between two frames."""
    times = [0.0, at - FRAME, at, 9.0]
    there = places + far
    return Pins(np.arange(len(places)), [places, places, there, there], times)


def hung(far: FloatArray, at: float = 0.5, **more: float) -> SpringSystem:
    body = line()
    return SpringSystem(body, pins=path(at, far, body.positions[:1]), drag=0.5, **more)


def taken(system: SpringSystem, way: str, times: FloatArray) -> Trajectory:
    *integrates, name = way.split()
    if integrates:
        fixed = name != "rk45"
        # Implicit ones are stable with any step.
        step = 1 / 96 if name == "implicit_euler" else 1 / 480
        options = IntegrateOptions(
            name, step=step if fixed else None, tolerance=None if fixed else 1e-9
        )
        return integrate(system, times, options)
    return simulate_springs(system, times, SpringOptions(name))


@pytest.mark.slow
@pytest.mark.parametrize("way", WAYS)
def test_what_hangs_on_a_pin_goes_along(way: str) -> None:
    far = np.array([100.0, -20.0, 3.0])
    times = np.arange(25) * FRAME
    found = taken(hung(far), way, times)
    still = taken(hung(0 * far), way, times)
    assert found.stats.status is Status.OK
    own = found.positions - far * (times >= 0.5)[:, None, None]
    # Two steps back begin anew behind a jump.
    near = 1e-4 if way == Solver.BDF2 else 1e-6
    np.testing.assert_allclose(own, still.positions, atol=near)
    np.testing.assert_allclose(found.velocities, still.velocities, atol=100 * near)
    assert found.notices[0].code == "SIM122"


@settings(max_examples=examples(5))
@given(at=st.floats(0.1, 0.9), split=st.integers(1, 23))
def test_a_motion_in_parts_is_the_whole(at: float, split: int) -> None:
    system = hung(np.array([100.0, 0, 0]), at)
    options = SpringOptions("symplectic_euler")
    times = np.arange(25) * FRAME
    whole = simulate_springs(system, times, options)
    first = simulate_springs(system, times[: split + 1], options)
    rest = simulate_springs(system, times[split:], options, first.checkpoint)
    assert rest.states.tobytes() == whole.states[split:].tobytes()
    coarse = simulate_springs(system, times[::6], options)
    assert coarse.states.tobytes() == whole.states[::6].tobytes()


def test_a_sheet_turns_with_its_pins() -> None:
    body = sheet(4, 4, mass=0.16, structural=Family(100.0))
    turn = so3.exp(np.array([0.3, -1.0, 2.0]))
    corners = np.array([0, 3, 12])
    places = body.positions[corners]
    there = np.add(so3.rotate(turn, places), [50.0, 0, 0])
    pins = Pins(corners, [places, places, there, there], [0, 0.1, 0.1 + FRAME, 1])
    system = SpringSystem(body, pins=pins, gravity=(0, 0, 0))
    motion = simulate_springs(system, [0, 0.25])
    wanted = np.add(so3.rotate(turn, body.positions), [50.0, 0, 0])
    np.testing.assert_allclose(motion.positions[-1], wanted, atol=1e-9)
    assert np.abs(motion.velocities[-1]).max() < 1e-6


def test_what_hangs_elsewhere_stays() -> None:
    body = join([line(), line(3.0)])
    places = body.positions[[0, 6]]
    there = np.add(places, [[100.0, 0, 0], [0.2, 0, 0]])
    times = [0, 0.5 - FRAME, 0.5, 9]
    options = SpringOptions("symplectic_euler")
    motion = simulate_springs(
        SpringSystem(body, pins=Pins([0, 6], [places, places, there, there], times)),
        np.arange(25) * FRAME,
        options,
    )
    alone = simulate_springs(
        SpringSystem(
            line(3.0), pins=Pins([0], [p[1:] for p in (places, places, there, there)],
                                 times)
        ),
        np.arange(25) * FRAME,
        options,
    )  # fmt: skip
    assert motion.positions[:, 6:].tobytes() == alone.positions.tobytes()
    assert np.linalg.norm(np.diff(motion.positions[-1, :6], axis=0), axis=1).max() < 0.2


@pytest.mark.parametrize("way", SOLVERS)
def test_what_is_drawn_to_targets_goes_along(way: str) -> None:
    body = line()
    times = [0, 0.5 - FRAME, 0.5, 9]
    far = np.array([0, 0, 100.0])

    def drawn(shift: FloatArray) -> SpringSystem:
        places = [body.positions, body.positions]
        places += [body.positions + shift] * 2
        targets = PointTargets(np.arange(6), places, 2.0, 0.1, times)
        return SpringSystem(body, targets=targets)

    frames = np.arange(25) * FRAME
    found, still = (taken(drawn(shift), way, frames) for shift in (far, 0 * far))
    assert found.stats.status is Status.OK
    own = found.positions - far * (frames >= 0.5)[:, None, None]
    np.testing.assert_allclose(own, still.positions, atol=1e-4)
    (notice,) = found.notices
    assert (notice.code, notice.where) == ("SIM122", "targets")


def test_a_limit_may_be_raised_or_lowered() -> None:
    times = np.arange(15) * FRAME
    near = np.array([1.0, 0, 0])
    pulled = taken(hung(near), "symplectic_euler", times)
    # It is drawn on: the spring is more than twice as long for a moment.
    assert [notice.code for notice in pulled.notices] == ["SIM187"]
    slow = taken(hung(near, speed_limit=10.0), "symplectic_euler", times)
    assert [notice.code for notice in slow.notices] == ["SIM122"]
    assert np.abs(pulled.velocities[-1]).max() > np.abs(slow.velocities[-1]).max()


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan")])
def test_a_limit_is_above_0(limit: float) -> None:
    with pytest.raises(OptionError) as error:
        SpringSystem(line(), speed_limit=limit)
    assert error.value.code == "SIM004"
