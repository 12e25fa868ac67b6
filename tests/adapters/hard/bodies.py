"""Hard cases of bodies that attract each other."""

from __future__ import annotations

import numpy as np
import pytest
from adapters.hard.subsystem import Subsystem
from adapters.nbody import nbody
from support.faults import raises

from animtool.core.array_types import FloatArray
from animtool.core.errors import OptionError, ToleranceError
from animtool.systems.framework.run import SimulationRun
from animtool.systems.nbody.nbody import Nbody

__all__ = ["BODIES"]

METHODS = ["velocity_verlet", "position_verlet", "rk4", "rk45"]
MASSES = np.array([0.5, 0.5])
UNJOINED = "no springs join bodies"
NOTHING_MET = "bodies run into nothing"


def two(
    method: str, x: FloatArray, v: FloatArray, soft: float, **keys: object
) -> Nbody:
    return nbody(x, v, MASSES, 1.0, soft, 1 / 96, method=method, **keys)


def around(eccentricity: float) -> tuple[FloatArray, FloatArray]:
    """Return two bodies as far apart as they come, with a mean distance of 1."""
    e = eccentricity
    speed = np.sqrt((1 - e) / (1 + e))
    place, velocity = np.array([1 + e, 0, 0]), np.array([0, speed, 0])
    return np.stack([-place, place]) / 2, np.stack([-velocity, velocity]) / 2


def _close_encounter(method: str) -> None:
    # From rest they meet after this time.
    apart = np.array([[-0.5, 0, 0], [0.5, 0, 0]])
    contact = np.pi / 2**1.5
    head_on = two(
        method,
        apart,
        np.zeros((2, 3)),
        0.0,
        tolerance=1e-8 if method == "rk45" else None,
    )
    run = SimulationRun("it", head_on, 0.0, 1 / 96)
    with pytest.raises(ToleranceError) as error:
        run.at(2.0)
    message = error.value.faults[-1].message
    assert error.value.code == ("SIM103" if method == "rk45" else "SIM110")
    assert "bodies 0 and 1" in message
    assert run.step_time(run.state.step_count) == pytest.approx(contact, abs=2 / 96)
    x, v = run.state.state.motion
    assert np.abs(x).max() <= 0.5  # nobody was thrown out
    bound = 0.25 / np.linalg.norm(x[0] - x[1])
    energy = 0.25 * (v**2).sum() - bound
    assert energy == pytest.approx(-0.25, abs=1e-2 * bound)
    # What the hint says is enough.
    if method != "rk45":
        hint = error.value.faults[-1].hint
        assert hint is not None
        soft = float(hint.split("softening: ")[1].split(",")[0])
        eased = two(method, apart, np.zeros((2, 3)), soft)
        frame = SimulationRun("it", eased, 0.0, 1 / 96).at(2.0)
        assert np.abs(frame.points).max() < 0.7
    _followed(method)


def _followed(method: str) -> None:
    """An orbit that is nearly a line is followed around its end, without ejection."""
    more = {"tolerance": 1e-9} if method == "rk45" else {"substeps": 4096}
    made = two(method, *around(0.99), 0.0, **more)
    run = SimulationRun("it", made, 0.0, 1 / 96)
    farthest = max(
        np.linalg.norm(np.diff(run.at(t).points, axis=0))
        for t in np.linspace(0, 2 * np.pi, 25)
    )
    assert farthest == pytest.approx(1.99, rel=2e-2)
    assert abs(run.diagnostics.values["energy_drift"]) < 2e-2


def _coincident(method: str) -> None:
    for soft in (0.0, 0.1):
        with raises(OptionError, "SIM070", match="bodies 0 and 1") as error:
            two(method, np.ones((2, 3)), np.zeros((2, 3)), soft)
        assert error.value.code == "SIM070"


def _zero_mass(method: str) -> None:
    x, v = around(0.5)
    for mass in (0.0, -1.0, np.nan):
        with raises(OptionError, "SIM070", match="body 1"):
            nbody(x, v, np.array([1.0, mass]), 1.0, 0.1, 0.01, method=method)


def _run(method: str) -> SimulationRun:
    return SimulationRun("it", two(method, *around(0.5), 0.1), 0.0, 1 / 96)


def _dt_zero(method: str) -> None:
    run = _run(method)
    first, again = run.at(0.51), run.at(0.51)
    assert first.points.tobytes() == again.points.tobytes()
    assert first.velocities.tobytes() == again.velocities.tobytes()


def _dt_negative(method: str) -> None:
    run = _run(method)
    run.at(0.5)
    with pytest.raises(OptionError) as error:
        run.at(0.4)
    assert error.value.code == "SIM002"


def _dt_spike(method: str) -> None:
    every, spike = _run(method), _run(method)
    frames = [every.at(k / 24) for k in range(25)]
    for k in (0, 6, 18, 24):
        assert spike.at(k / 24).points.tobytes() == frames[k].points.tobytes()


BODIES = Subsystem(
    "bodies",
    METHODS,
    {
        "close_encounter": _close_encounter,
        "coincident_particles": _coincident,
        "all_coincident": _coincident,
        "zero_mass_unpinned": _zero_mass,
        "dt_zero": _dt_zero,
        "dt_negative": _dt_negative,
        "dt_spike": _dt_spike,
    },
    {
        **dict.fromkeys(
            ["zero_rest_length", "both_ends_pinned", "stiff_and_heavy"], UNJOINED
        ),
        **dict.fromkeys(
            ["collider_teleport", "rest_contact", "deep_start_penetration", "pinched"],
            NOTHING_MET,
        ),
    },
)
