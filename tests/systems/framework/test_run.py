"""A run tells warnings of steps once, whoever makes the steps."""

from __future__ import annotations

import numpy as np
import pytest
from support.faults import raises

from animtool.core.errors import Fault, OptionError, ToleranceError, warning
from animtool.motion.frames import PointsFrame
from animtool.systems.framework.run import SimulationRun
from animtool.systems.framework.simulation import Diagnostics, SteppedState


class Counter:
    """A point whose place is how many steps it took; each step warns of its number."""

    def __init__(self, largest: float = np.inf) -> None:
        self._largest = largest

    def initial_state(self) -> float:
        return 0.0

    def step(self, state: float, *_: float) -> SteppedState[float]:
        after = state + 1.0
        place = after if after <= self._largest else np.nan
        odd = warning("SIM137", f"step {after:g}") if after % 2 else None
        even = warning("SIM138", f"step {after:g}")
        return SteppedState(place, (), [even, *([odd] if odd else []), even])

    def frame(self, state: float, *_: float) -> PointsFrame:
        points = np.array([[state, 0.0, 0.0]])
        return PointsFrame(np.zeros(1, int), points, points, np.ones(1))

    def diagnostics(self, *_: float) -> Diagnostics:
        return Diagnostics(notices=[warning("SIM175", "as it was built")])


class ManyCounter(Counter):
    def steps(
        self, state: float, t: float, dt: float, count: int
    ) -> SteppedState[float]:
        return SteppedState(state + count, (), self.step(state, t, dt).notices)


def told(run: SimulationRun) -> list[tuple[str, str]]:
    notices: list[Fault] = run.notices
    return [(one.code, one.message) for one in notices]


@pytest.mark.parametrize("simulation", [Counter(), ManyCounter()])
def test_the_first_warning_of_each_code_is_told(simulation: Counter) -> None:
    run = SimulationRun("it", simulation, 0.0, 0.1)
    assert told(run) == [("SIM175", "as it was built")]
    assert run.at(1.0).points[0, 0] == 10
    assert told(run) == [
        ("SIM175", "as it was built"),
        ("SIM138", "step 1"),
        ("SIM137", "step 1"),
    ]


def test_a_step_that_is_not_finite_names_a_shorter_one() -> None:
    run = SimulationRun("it", Counter(largest=3), 0.0, 0.1)
    run.at(0.3)
    with pytest.raises(ToleranceError) as caught:
        run.at(0.4)
    (fault,) = caught.value.faults
    assert (fault.code, fault.hint) == ("SIM102", "use step: 0.05, or weaker forces")


def test_a_number_that_no_file_holds_is_a_blow_up() -> None:
    class Far(Counter):
        def step(self, *_: float) -> SteppedState[float]:
            return SteppedState(1e31)

    run = SimulationRun("it", Far(), 0.0, 0.1)
    with raises(ToleranceError, "SIM102"):
        run.at(0.1)


def test_time_does_not_run_backwards() -> None:
    run = SimulationRun("it", Counter(), 0.0, 0.1)
    run.at(0.5)
    with raises(OptionError, "SIM002"):
        run.at(0.2)
