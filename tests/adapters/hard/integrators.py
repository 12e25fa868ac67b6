"""Hard cases of integrators, on systems of functions."""

from __future__ import annotations

import numpy as np
import pytest
from adapters.hard.subsystem import Subsystem
from adapters.sim import kepler_system

from animtool.core.array_types import FloatArray
from animtool.core.errors import OptionError
from animtool.sim import (
    INTEGRATORS,
    ForceSystem,
    IntegrateOptions,
    Status,
    find_integrator,
    integrate,
)
from animtool.sim.integrators.integrator import StepControl

__all__ = ["INTEGRATING"]

NO_PARTICLES = "functions have neither springs nor masses: springs are held apart"
NO_CONTACTS = "functions have no colliders: springs and particles are held apart"


def falling() -> ForceSystem:
    """Return a damped spring in a field that swings with time."""
    return ForceSystem(
        lambda t, x, v: -40 * x - 0.8 * v + np.sin(3 * t), [[1.0]], [[0.0]]
    )


def options_for(name: str) -> IntegrateOptions:
    if find_integrator(name).control is StepControl.FIXED:
        return IntegrateOptions(name, step=1 / 480)
    return IntegrateOptions(name, tolerance=1e-10)


def _dt_zero(name: str) -> None:
    times = np.array([0, 1, 1, 1, 2, 3, 3]) / 24
    found = integrate(falling(), times, options_for(name))
    assert found.states[1].tobytes() == found.states[2].tobytes()
    assert found.states[1].tobytes() == found.states[3].tobytes()
    assert found.states[5].tobytes() == found.states[6].tobytes()
    once = integrate(falling(), np.unique(times), options_for(name))
    assert once.states.tobytes() == found.states[[0, 1, 4, 5]].tobytes()


def _dt_negative(name: str) -> None:
    with pytest.raises(OptionError) as error:
        integrate(falling(), [0, 1 / 24, 0], options_for(name))
    assert error.value.code == "SIM002"


def _dt_spike(name: str) -> None:
    every = np.arange(25) / 24
    spike = np.concatenate([every[:7], every[18:]])
    whole = integrate(falling(), every, options_for(name)).states
    found = integrate(falling(), spike, options_for(name)).states
    kept: FloatArray = np.concatenate([whole[:7], whole[18:]])
    if find_integrator(name).control is StepControl.FIXED:
        assert found.tobytes() == kept.tobytes()
    np.testing.assert_allclose(found, kept, rtol=0, atol=1e-7)


def _close_encounter(name: str) -> None:
    # From rest it meets the mass at the origin after this time.
    head_on = kepler_system(1.0, [1.0, 0.0], [0.0, 0.0])
    contact = np.pi / 2**1.5
    options = IntegrateOptions(name, tolerance=1e-8, floor=1e-7, growth=np.inf)
    found = integrate(head_on, [0, 1, 2], options)
    assert found.stats.status is Status.STEP_TOO_SMALL
    assert found.stats.time == pytest.approx(contact, abs=1e-3)
    assert found.notices[-1].code == "SIM103"
    assert "particle 0" in found.notices[-1].message
    assert f"{found.stats.time:.6g} s" in found.notices[-1].message
    assert found.times.tolist() == [0, 1]


def _of_fixed_steps(name: str) -> bool:
    """Return whether a method cannot say that its step is too long."""
    return find_integrator(name).control is StepControl.FIXED


INTEGRATING = Subsystem(
    "integrators",
    list(INTEGRATORS),
    {
        "dt_zero": _dt_zero,
        "dt_negative": _dt_negative,
        "dt_spike": _dt_spike,
        "close_encounter": _close_encounter,
    },
    {
        **dict.fromkeys(
            [
                "coincident_particles",
                "all_coincident",
                "zero_rest_length",
                "zero_mass_unpinned",
                "both_ends_pinned",
                "stiff_and_heavy",
            ],
            NO_PARTICLES,
        ),
        **dict.fromkeys(
            ["collider_teleport", "rest_contact", "deep_start_penetration", "pinched"],
            NO_CONTACTS,
        ),
    },
    {"close_encounter": _of_fixed_steps},
)
