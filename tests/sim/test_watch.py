from __future__ import annotations

import numpy as np

from animtool.sim import Energy, ForceSystem, IntegrateOptions
from animtool.sim.checks import EnergyWatch

STATE = np.zeros((2, 1, 1))


def watch(*energies: Energy) -> list[str]:
    """Return the signs seen in energies, the first being the start's."""
    system = ForceSystem(
        lambda _t, x, _v: x, [[0.0]], energy=lambda t, _y: energies[int(t)]
    )
    seen = EnergyWatch(system, IntegrateOptions(growth=10))
    seen.start(0.0, STATE)
    return [seen.divergence_reason(float(i), STATE) for i in range(1, len(energies))]


def test_energy_that_stays_is_no_sign() -> None:
    assert watch(Energy(1, 1), Energy(2, 0), Energy(0, 2), Energy(0, 0)) == [""] * 3


def test_energy_that_grows_is_one() -> None:
    assert watch(Energy(0, 1), Energy(9, 1), Energy(20, 2))[0] == ""
    assert "22 J" in watch(Energy(0, 1), Energy(9, 1), Energy(20, 2))[1]
    assert watch(Energy(0, 1), Energy(np.inf, 1)) != [""]
    assert watch(Energy(0, 1), Energy(np.nan, 1)) != [""]


def test_a_fall_from_any_zero_is_no_sign_and_its_blow_up_is_one() -> None:
    fall = [Energy(k, -k) for k in (0.0, 1.0, 100.0, 1e4)]
    assert watch(*fall) == [""] * 3
    assert watch(*fall, Energy(1e6, -1e4))[-1]


def test_what_may_be_supplied_is_no_sign() -> None:
    still = Energy(0, 0, supply=10)
    assert watch(still, Energy(90, 0, supply=10)) == [""]
    assert watch(still, Energy(110, 0, supply=10)) != [""]


def test_a_start_without_energy_is_not_judged_by_it() -> None:
    assert watch(Energy(0), Energy(1e-20), Energy(5.0)) == ["", ""]
