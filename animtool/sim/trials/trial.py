"""What can be simulated in several ways, and what a way comes to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from animtool._types import FloatArray, IntArray
from animtool.sim.system import Energy
from animtool.sim.trajectory import Status

# Steps over the chosen one: of settings to try, and of the motion that they are
# compared with, each of which is half of the one before.
COARSER = (4.0, 2.0, 1.0, 0.5)
FINER = (0.5, 0.25, 0.125)


@dataclass(frozen=True, slots=True)
class Setting:
    """A way to simulate.

    Attributes:
        method: An integrator or a solver.
        options: Names and values that go with it, as the scene file writes them.
    """

    method: str
    options: tuple[tuple[str, float], ...]

    def __str__(self) -> str:
        """Return it as the scene file writes it.

        >>> str(Setting("rk4", (("step", 0.01),)))
        'rk4, step 0.01'
        """
        options = [f"{name} {value:.6g}" for name, value in self.options]
        return ", ".join([self.method, *options])


@dataclass(frozen=True, slots=True)
class Shot:
    """Points at a time.

    Attributes:
        points: ``(N, 3)`` [m].
        ids: Which point is which, ascending ``(N,)``; None where they are always the
            same.
    """

    points: FloatArray
    ids: IntArray | None = None


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a setting came to.

    Attributes:
        seconds: Wall time of the simulation [s].
        steps: That were taken.
        shots: At the times that were reached.
        status: How it ended.
        reason: Why it stopped, empty where it did not.
        stable_step: The largest that is stable where it ended [s]: 0 where none is,
            infinite where all are, None where it is not known.
        energies: At these times; None where energy may come and go.
        stretch: Most that a spring was longer than at rest, over that [1]; None where
            there are no springs.
    """

    seconds: float
    steps: int
    shots: Sequence[Shot]
    status: Status = Status.OK
    reason: str = ""
    stable_step: float | None = None
    energies: Sequence[Energy] | None = None
    stretch: float | None = None


class Trial(Protocol):
    """What is simulated, in the way that its file chooses and in others.

    Attributes:
        name: What it is called.
        kind: What it is: ``particles``, ``cloth``.
        span: How long it is simulated [s], with what comes before the first frame.
        chosen: The way of the file.
    """

    name: str
    kind: str
    span: float
    chosen: Setting

    def settings(self) -> list[Setting]:
        """Return ways to try, the coarsest of each method first."""
        ...

    def references(self) -> list[list[Setting]]:
        """Return what others can be compared with, the first that works to be taken.

        Of a method each, its steps being half of those before.
        """
        ...

    def run(self, setting: Setting) -> Outcome:
        """Simulate it in one way.

        Raises:
            OptionError: The method is not for it.
        """
        ...


def ladder(value: float, shares: Sequence[float] = COARSER) -> list[float]:
    """Return values in some shares of one, as they would be written.

    >>> ladder(0.03)
    [0.12, 0.06, 0.03, 0.015]
    """
    return [value if share == 1 else float(f"{value * share:.12g}") for share in shares]
