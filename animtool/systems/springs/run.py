"""Springs of a scene through time, and what others see of them."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from animtool._types import FloatArray, IntArray
from animtool.errors import Fault, OptionError, Severity, ToleranceError
from animtool.maths.faces import triangulated
from animtool.sim.trajectory import Checkpoint, Status
from animtool.systems.springs.drawing import Faces
from animtool.systems.springs.motion import Grid, SpringMotion
from animtool.systems.springs.records import SpringOptions
from animtool.systems.springs.simulating import ON_GRID, simulate_springs
from animtool.systems.springs.system import SpringSystem

# Told how far it is; None where nobody looks.
Progress: TypeAlias = Callable[[float], None] | None
# Times of a whole motion that are compared with those of one in half steps.
COMPARED = 64
# Notices whose message says how much it is so far.
_GROWING = {"SIM131", "SIM123"}
# Times this near to each other are one [s].
SAME = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """Particles at a time."""

    time: float  # [s]
    points: FloatArray  # ``(N, 3)`` [m]
    torn: npt.NDArray[np.bool_]  # which springs are ``(S,)``


@dataclass(slots=True)
class Keeping:
    """Times that somebody looks back to."""

    begin: float  # the first [s]
    step: float  # what lies between two [s]
    since: float  # none before is looked back to any more [s]

    def between(self, now: float, t: float) -> list[float]:
        """Return those that lie between two times."""
        first = math.floor((now - self.begin) / self.step) - 1
        last = math.ceil((t - self.begin) / self.step) + 1
        every = (self.begin + k * self.step for k in range(max(first, 0), last + 1))
        return [at for at in every if now + SAME < at < t - SAME]


class SpringRun:
    """Springs under way, until the last time that will be asked for [s].

    Where an error is to be kept, phases give what each motion that is compared tells
    its share.

    Raises:
        OptionError: An option makes no sense.
        ToleranceError: It blew up.
    """

    def __init__(
        self,
        system: SpringSystem,
        options: SpringOptions,
        begin: float,
        last: float,
        phase: Callable[[], Progress] | None = None,
    ) -> None:
        self.clock: Progress = None  # told the time that was reached [s]
        self.system = system
        self._said: dict[str, Fault] = {}
        self.error: float | None = None  # of positions, where it was asked for [m]
        reason = ""
        if options.error is not None:
            options, reason = self._fine_enough(options, begin, last, phase)
        self.options = options
        self.step, self.steps, self.stretch, self.unresolved = np.inf, 0, 0.0, 0
        self._checkpoint: Checkpoint | None = None
        self._keepings: list[Keeping] = []
        self._kept: list[Moment] = []
        self._state, self.torn = system.state, np.zeros(0, np.bool_)
        self._begin = begin
        motion = self._to(begin, begin)
        self.begun = self.stretch
        self.solver, self.reason = motion.solver, reason or motion.reason

    def _fine_enough(
        self,
        options: SpringOptions,
        begin: float,
        last: float,
        phase: Callable[[], Progress] | None,
    ) -> tuple[SpringOptions, str]:
        """Return options whose steps keep the error over the whole motion, and why."""
        times = np.linspace(begin, max(last, begin), COMPARED)
        progress = None if phase is None else _by_motions(phase, begin, last)
        motion = simulate_springs(self.system, times, options, progress=progress)
        self._check(motion)
        self.error = motion.stats.error
        fine = replace(options, solver=motion.solver, step=motion.step, error=None)
        return fine, motion.reason

    @property
    def notices(self) -> list[Fault]:
        """What is odd so far."""
        return list(self._said.values())

    def at(self, t: float) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
        """Return the state at a time, and which springs are torn.

        Before the beginning it is that of the beginning.

        Raises:
            OptionError: Time runs backwards (SIM002).
            ToleranceError: It blew up (SIM102), or could not go on.
        """
        assert self._checkpoint is not None
        now = self._checkpoint.time
        t = max(t, self._begin)
        if t < now:
            message = f"time {t:g} s is before that of the simulation"
            raise OptionError(Fault("SIM002", message, hint="begin again"))
        if t > now:
            self._on(now, t)
        return self._state, self.torn

    def advance(self, t: float) -> None:
        """Cross all cells of time that end at a time [s] or before."""
        assert self._checkpoint is not None
        grid = self._checkpoint.memory
        assert isinstance(grid, Grid)
        cells = math.floor((t - grid.origin) / grid.cell + ON_GRID)
        end = grid.origin + cells * grid.cell
        if end > self._checkpoint.time and not self._under_way:
            self.at(end)

    def keep(self, begin: float, step: float) -> Keeping:
        """Keep particles at times from now on, a step apart [s], for `look`."""
        self._keepings.append(Keeping(begin, step, -math.inf))
        return self._keepings[-1]

    def look(self, t: float) -> Moment:
        """Return particles at a time, straight between those that are kept [s].

        What is looked at does not change the motion.
        """
        assert self._checkpoint is not None
        if t > self._checkpoint.time + SAME:
            self.at(t)
        times = [moment.time for moment in self._kept]
        after = min(bisect_left(times, t - SAME), len(times) - 1)
        later = self._kept[after]
        if after == 0 or abs(later.time - t) <= SAME or later.time < t:
            return later
        before = self._kept[after - 1]
        share = (t - before.time) / (later.time - before.time)
        points = before.points + (later.points - before.points) * share
        return Moment(t, points, before.torn)

    def _on(self, now: float, t: float) -> None:
        """Go on to a time, past all that are kept."""
        stops = {at for keeping in self._keepings for at in keeping.between(now, t)}
        for stop in (*sorted(stops), t):
            self._to(now, stop)
            now = stop
        if not self._keepings:
            self._kept = self._kept[-1:]
            return
        since = min(keeping.since for keeping in self._keepings)
        first = bisect_left([moment.time for moment in self._kept], since - SAME)
        # The one before lies on the way to a time between two.
        self._kept = self._kept[max(first - 1, 0) :]

    def _to(self, now: float, t: float) -> SpringMotion:
        times = [now] if t == now else [now, t]
        self._under_way = True
        motion = simulate_springs(
            self.system, times, self.options, self._checkpoint, progress=self.clock
        )
        self._under_way = False
        self._check(motion)
        self._checkpoint, self._state = motion.checkpoint, motion.states[-1]
        self.torn = motion.torn
        self._kept.append(Moment(t, self._state[0], self.torn))
        self.step = min(self.step, motion.step)
        self.steps += motion.stats.steps
        self.unresolved = max(self.unresolved, motion.unresolved)
        self.stretch = max(self.stretch, self._stretched())
        return motion

    def _check(self, motion: SpringMotion) -> None:
        """Keep what a motion says, the worst of each kind, and stop where it ended."""
        if motion.stats.status is not Status.OK:
            raise ToleranceError(
                [replace(fault, severity=Severity.ERROR) for fault in motion.notices]
            )
        for fault in motion.notices:
            # Of what has a number that changes, the first, or the worst.
            key = fault.code if fault.code in _GROWING else str(fault)
            worse = fault.code == "SIM131" and motion.stretch >= self._worst
            if key not in self._said or worse:
                self._said[key] = fault
        self._worst = max(self._worst, motion.stretch)

    _worst = 0.0
    _under_way = False  # what is asked meanwhile finds all cells crossed that can be

    def _stretched(self) -> float:
        springs = self.system.body.springs
        whole = ~self.torn & (springs.rest > 0)
        if not whole.any():
            return 0.0
        x, ends = self._state[0], springs.ends[whole]
        lengths = np.linalg.norm(x[ends[:, 1]] - x[ends[:, 0]], axis=1)
        return max(float((lengths / springs.rest[whole]).max()) - 1.0, 0.0)


def _by_motions(
    phase: Callable[[], Progress], begin: float, last: float
) -> Callable[[float], None]:
    """Return a function of the time reached; each motion it sees is a phase."""
    span, before, tell = max(last - begin, 1e-9), np.inf, None

    def show(t: float) -> None:
        nonlocal before, tell
        if t < before:
            tell = phase()
        before = t
        if tell is not None:
            tell((t - begin) / span)

    return show


class Watched:
    """A surface that is looked at between frames, on a grid of times."""

    def __init__(
        self,
        run: SpringRun,
        shape: Faces,
        rows: IntArray,
        springs: slice,
        grid: tuple[float, float],
    ) -> None:
        self._run, self._shape, self._rows, self._springs = run, shape, rows, springs
        self._keeping: Keeping = run.keep(*grid)
        self._faces = triangulated(shape.counts, shape.indices)
        self._gone = 0

    def points(self, t: float) -> FloatArray:
        """Return its points ``(N, 3)`` at a time [s] [m]."""
        found: FloatArray = self._run.look(t).points[self._rows]
        return found

    def triangles(self, t: float) -> IntArray:
        """Return corners of those of its triangles ``(T, 3)`` that are not torn."""
        torn: npt.NDArray[np.bool_] = self._run.look(t).torn[self._springs]
        gone = int(torn.sum())
        if gone != self._gone:
            self._gone, self._faces = gone, triangulated(*self._shape.whole(torn))
        return self._faces

    def forget(self, t: float) -> None:
        """Take note that no time before one will be asked for [s]."""
        self._keeping.since = max(self._keeping.since, t)
