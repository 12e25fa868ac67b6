"""Forces on rigid bodies against closed forms, from soft to stiff for the step."""

from __future__ import annotations

import math
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.rigid import FLOOR, GRAVITY, Rigid, ball, box

from animtool.core.errors import ToleranceError
from animtool.systems.rigid.loads import StepForceSolver

STEP, MASS, UNTIL = 0.01, 0.01, 0.5
FALL: dict[str, Any] = {"gravity": None}
AWAKE: dict[str, Any] = {"sleep": {"speed": 0}}
# Damping over mass, or frequency, times the step.
DECADES = [1e-3, 1e-2, 1e-1, 1.0, 1e1, 1e2, 1e3]
# The most of the errors that are measured, over the exact value.
LINEAR, QUADRATIC, SPRING = 1e-10, 1e-4, 1e-10


@pytest.mark.parametrize("stiff", DECADES)
def test_a_fall_under_drag(tmp_path: Path, stiff: float) -> None:
    rate = stiff / STEP
    drag = {"drag": {"linear": rate * MASS}}
    one = ball(0.05, mass=MASS, velocity=[3, 0, 0])
    x, y, _ = Rigid(tmp_path, one, forces=[FALL, drag], **AWAKE).to(UNTIL)[0]
    decayed = -math.expm1(-rate * UNTIL) / rate
    assert x == pytest.approx(3 * decayed, rel=LINEAR)
    # The difference of two that are nearly equal where drag is weak.
    fallen = -GRAVITY / rate * (UNTIL - decayed)
    assert y == pytest.approx(fallen, rel=LINEAR / min(stiff, 1))


@pytest.mark.parametrize("stiff", DECADES)
def test_wind_takes_a_body_along(tmp_path: Path, stiff: float) -> None:
    rate = stiff / STEP
    wind = {"wind": {"velocity": [3, 0, -1], "drag": rate * MASS}}
    x, y, z = Rigid(tmp_path, ball(0.05, mass=MASS), forces=[wind], **AWAKE).to(UNTIL)[
        0
    ]
    went = UNTIL + math.expm1(-rate * UNTIL) / rate
    assert_allclose([x, y, z], [3 * went, 0, -went], rtol=LINEAR / min(stiff, 1))


@pytest.mark.parametrize("stiff", DECADES)
def test_a_fall_to_the_terminal_velocity(tmp_path: Path, stiff: float) -> None:
    terminal = 2 * GRAVITY * STEP / stiff
    drag = {"drag": {"quadratic": MASS * GRAVITY / terminal**2}}
    found = Rigid(tmp_path, ball(0.05, mass=MASS), forces=[FALL, drag], **AWAKE)
    y, s = found.to(UNTIL)[0, 1], GRAVITY * UNTIL / terminal
    cosh = s + math.log1p(math.exp(-2 * s)) - math.log(2)
    assert y == pytest.approx(-(terminal**2) / GRAVITY * cosh, rel=QUADRATIC)
    speed = terminal * math.tanh(s)
    assert found.velocities()[0, 1] == pytest.approx(-speed, rel=QUADRATIC)


@pytest.mark.parametrize("stiff", DECADES)
def test_speed_is_lost_to_quadratic_drag(tmp_path: Path, stiff: float) -> None:
    drag = {"drag": {"quadratic": stiff / STEP * MASS}}
    one = ball(0.05, mass=MASS, velocity=[0, 0, 1])
    found = Rigid(tmp_path, one, forces=[drag], **AWAKE)
    found.to(2 * STEP)
    speed = 1 / (1 + 2 * stiff)
    assert found.velocities()[0, 2] == pytest.approx(speed, rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("stiff", DECADES[:-1])
def test_a_spring_swings_at_its_frequency(tmp_path: Path, stiff: float) -> None:
    rate = stiff / STEP
    spring = {"spring": {"anchor": [0, 0, 0], "k": MASS * rate**2}}
    one = ball(0.05, mass=MASS, at=[1, 0, 0], velocity=[0, rate / 2, 0])
    times = np.arange(1, 6) * STEP
    path = Rigid(tmp_path, one, forces=[spring], **AWAKE).path(times)[:, 0]
    ellipse = [np.cos(rate * times), np.sin(rate * times) / 2, 0 * times]
    assert_allclose(path, np.stack(ellipse, 1), atol=SPRING)


@pytest.mark.parametrize("stiff", DECADES)
def test_a_damped_spring_comes_to_rest(tmp_path: Path, stiff: float) -> None:
    """Overdamped: both rates are real, and no part of a step is too long."""
    fast, slow = stiff / STEP, 2.0
    spring = {"spring": {"anchor": [0, 0, 0], "k": MASS * fast * slow}}
    drag = {"drag": {"linear": MASS * (fast + slow)}}
    one = ball(0.05, mass=MASS, at=[1, 0, 0])
    x = Rigid(tmp_path, one, forces=[spring, drag], **AWAKE).to(UNTIL)[0, 0]
    both = fast * math.exp(-slow * UNTIL) - slow * math.exp(-fast * UNTIL)
    assert x == pytest.approx(both / (fast - slow), rel=1e-9)


def test_what_swings_too_fast_is_refused_with_a_step_that_works(tmp_path: Path) -> None:
    def swung(step: float) -> float:
        folder = tmp_path / f"{step}"
        folder.mkdir()
        spring = {"spring": {"anchor": [0, 0, 0], "k": MASS * 1e10}}
        one = ball(0.05, mass=MASS, at=[1, 0, 0])
        found = Rigid(folder, one, forces=[spring], step=step, **AWAKE)
        return float(found.to(step)[0, 0])

    with pytest.raises(ToleranceError) as error:
        swung(STEP)
    (fault,) = error.value.faults
    assert (fault.code, "'ball'" in fault.message) == ("SIM102", True)
    (step,) = re.findall(r"step: ([\d.e-]+)", fault.hint or "")
    assert 0.5 * STEP * 128e-5 / STEP < float(step) <= 128e-5
    assert swung(float(step)) == pytest.approx(math.cos(1e5 * float(step)), abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize("stiff", [0.1, 5.0, 50.0])
def test_wind_presses_a_leaf_to_a_wall(
    tmp_path: Path, stiff: float, restitution: float
) -> None:
    drag = stiff / STEP * MASS
    wall = {"shape": {"box": {"size": [1, 9, 9]}}, "at": [0.6, 0, 0]}
    leaf = box((0.06, 0.06, 0.06), mass=MASS, restitution=restitution)
    wind = {"wind": {"velocity": [3, 0, 0], "drag": drag}}
    found = Rigid(tmp_path, leaf, forces=[wind], colliders=[wall], **AWAKE)
    found.to(0.3)
    late = found.path([0.31, 0.32, 0.33])[:, 0, 0]
    assert_allclose(late, 0.07, atol=1e-4)
    force = found.state.contacts[:, 3:].sum(axis=0)
    assert force[0] == pytest.approx(3 * drag, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("stiff", [0.01, 0.3, 2.0, 50.0])
def test_drag_on_what_slides_down(tmp_path: Path, stiff: float) -> None:
    rate, slope = stiff / STEP, math.radians(25)
    tilt = [math.cos(-slope / 2), 0, 0, math.sin(-slope / 2)]
    up = np.array([math.sin(slope), math.cos(slope), 0])
    block = box((0.5, 0.2, 0.4), mass=1, friction=0.2, at=list(0.1 * up), rotate=tilt)
    forces = [FALL, {"drag": {"linear": rate}}]
    floor = {**FLOOR, "rotate": tilt}
    found = Rigid(tmp_path, block, colliders=[floor], forces=forces, **AWAKE)
    found.to(UNTIL)
    pull = GRAVITY * (math.sin(slope) - 0.2 * math.cos(slope))
    speed = pull / rate * -math.expm1(-rate * UNTIL)
    down = found.velocities()[0] @ [math.cos(slope), -math.sin(slope), 0]
    assert down == pytest.approx(speed, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("stiff", [0.1, 1.0, 20.0])
def test_a_canopy_slows_what_hangs_on_it(tmp_path: Path, stiff: float) -> None:
    """Drag on a light body is borne by the heavy one that is joined to it."""
    drag = stiff / STEP * 0.1
    canopy = {**ball(0.3, mass=0.1, at=[0, 2, 0]), "name": "canopy"}
    load = {**ball(0.3, mass=20), "name": "load"}
    joint = {"type": "ball", "body": "load", "to": "canopy", "at": [0, 1, 0]}
    # Of the light one alone.
    lift = {"field": {"y": f"-vy * {drag} * max(0, 1 - mass) / 0.9"}}
    found = Rigid(tmp_path, canopy, load, joints=[joint], forces=[FALL, lift], **AWAKE)
    found.to(UNTIL)
    fastest = 20.1 * GRAVITY / drag
    speed = fastest * -math.expm1(-drag * UNTIL / 20.1)
    assert_allclose(found.velocities()[:, 1], -speed, rtol=2e-3)


def test_what_is_thrown_at_others_is_as_heavy_as_it_is(tmp_path: Path) -> None:
    """Who flies under drag hits with his own mass, and momentum is kept."""
    one = ball(0.1, mass=1, velocity=[2, 0, 0], restitution=1, friction=0)
    other = {**ball(0.1, mass=3, at=[0.205, 0, 0], restitution=1), "name": "other"}
    forces = [{"drag": {"linear": 5.0}}]
    found = Rigid(tmp_path, one, other, forces=forces, **AWAKE)
    found.to(0.02)
    first, second = found.velocities()[:, 0]
    assert first + 3 * second == pytest.approx(2, rel=0.1)
    assert second == pytest.approx(1, rel=0.1)


@pytest.mark.parametrize("moment", [1e-2, 1e-4, 1e-6, 1e-8])
def test_what_hangs_under_a_pull_swings_as_a_pendulum(
    tmp_path: Path, moment: float
) -> None:
    pull, arm = 0.1, 0.05
    push = {"force": [0, pull, 0], "at": [arm, 0, 0]}
    one = ball(0.05, mass=0.01, inertia=[moment] * 3, pushes=[push])
    found = Rigid(tmp_path, one, forces=[], **AWAKE)
    spins = []
    for k in range(1, 31):
        found.to(k / 60)
        spins.append(abs(float(found.spins()[0, 2])))
    # From level to upright.
    assert max(spins) < math.sqrt(2 * pull * arm / moment) * 1.05


@pytest.mark.slow
@pytest.mark.parametrize("pull", [5.0, 500.0, 5e4])
@pytest.mark.parametrize("name", ["friction", "propulsion"])
def test_what_brakes_stops(tmp_path: Path, name: str, pull: float) -> None:
    one = ball(0.05, mass=MASS, velocity=[1, 0, 0])
    keys = {"deceleration": pull} if name == "friction" else {"thrust": -pull * MASS}
    found = Rigid(tmp_path, one, forces=[{name: keys}], **AWAKE)
    assert found.to(0.22)[0, 0] == pytest.approx(0.5 / pull, abs=2e-4)
    assert abs(found.velocities()).max() < 1e-6


def test_the_same_at_any_rate(tmp_path: Path) -> None:
    turned, grid = [0.9, 0.1, 0.3, 0.2], {"count": [2, 2, 2], "spacing": [0.05] * 3}
    leaves = box(
        (0.06, 0.01, 0.04), mass=1e-3, at=[0, 0.3, 0], rotate=turned, grid=grid
    )
    forces = [FALL, {"wind": {"velocity": [1, -1, 0], "drag": 0.1}}]
    runs = [Rigid(tmp_path, leaves, colliders=[FLOOR], forces=forces) for _ in range(2)]
    slow, fast = runs[0].path(np.arange(5) / 12), runs[1].path(np.arange(9) / 24)
    np.testing.assert_array_equal(slow, fast[::2])


@pytest.mark.parametrize("mass", [1e-14, 1e-24, 1e-29])
def test_what_leaves_all_scenes_stops_by_name(tmp_path: Path, mass: float) -> None:
    flung = {"uniform": {"push": [1e18, 0, 0]}}
    found = Rigid(tmp_path, ball(0.1, mass=mass), forces=[flung])
    with pytest.raises(ToleranceError) as error:
        found.to(UNTIL)
    assert [fault.code for fault in error.value.faults] == ["SIM102"]
    assert "it blew up at" in error.value.faults[0].message


@pytest.mark.parametrize(
    ("swings", "spins", "dt", "parts"),
    [
        ([1.0, 2.4], [0.1, 0.0], 0.2, 1),
        ([5.0, 2.6], [0.1, 0.0], 0.2, 2),
        ([2.6, 0.0], [0.0, 9.0], 0.2, 4),
        ([0.0, 0.0], [0.0, 1e9], 0.2, 256),
        ([640.0, 0.0], [0.0, 0.0], 0.2, 256),
        ([], [], 0.2, 1),
    ],
)
def test_a_step_has_parts_in_which_bodies_swing_by_half_a_radian(
    swings: list[float], spins: list[float], dt: float, parts: int
) -> None:
    """Who only spins asks for as many as there may be at most."""
    rates = np.array(swings), np.array(spins)
    own: Any = SimpleNamespace(
        _oscillation_and_spin_rates=lambda *_: rates, _body_label=lambda k: f"body {k}"
    )
    assert (
        StepForceSolver.required_substep_count(own, 1.0, dt, np.zeros((2, 14))) == parts
    )
    stopped: list[tuple[Any, ...]] = []
    own._stop = lambda *given: stopped.append(given)
    rates = np.array([0.0, 1280.0]), np.zeros(2)
    StepForceSolver.required_substep_count(own, 1.0, dt, np.zeros((2, 14)))
    ((t, message, hint),) = stopped
    assert t == 1.0
    assert "body 1" in message
    assert hint.startswith("use step: 0.1,")
