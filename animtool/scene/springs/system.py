"""Ropes, strands, cloth and volumes of a scene under way, joined ones as one."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from animtool._types import FloatArray, IntArray
from animtool.errors import Fault, Severity, counted, percent
from animtool.quantities import length_text, plain
from animtool.scene.entries import SceneSystem
from animtool.scene.progress import Progress
from animtool.scene.springs.pins import (
    Tie,
    Ties,
    air_of,
    moved_to_pins,
    ties_of,
    wind_ties,
)
from animtool.scene.springs.setup import (
    SpringSetup,
    contact_of,
    join_pairs,
    options_of,
    shared,
    wind_of,
)
from animtool.scene.systems.simulation import Opening
from animtool.scene.systems.surroundings import Surroundings
from animtool.sim.trials.trial import Trial
from animtool.systems.springs import Body, SpringSystem, Welded, find_rest, join, weld
from animtool.systems.springs.drawing import Faces, TornMesh
from animtool.systems.springs.run import SpringRun, Watched
from animtool.systems.springs.solvers import CELL
from animtool.systems.springs.spec_parts import FaceWindModel
from animtool.systems.springs.trial import trial_of

# Particles that are put together, or held, this far from where they are built are
# said to be apart [m].
APART = 1e-4
# Over how long they were at the beginning, springs that are as long as this are
# hardly meant: no rope or cloth becomes twice as long [1].
LONG = 2.0


def open_springs(
    members: Sequence[SceneSystem], opening: Opening
) -> list[RunningSprings]:
    """Return systems that are joined, or one alone, at their beginning.

    Raises:
        FormatError: The file of a character is malformed.
        OptionError: Something makes no sense.
        ToleranceError: It blew up at once.
    """
    setups = [cast(SpringSetup, member.setup) for member in members]
    names = [member.name for member in members]
    whole = _Whole(names, setups, opening)
    run = SpringRun(
        whole.system,
        options_of(whole.spec),
        whole.begin,
        opening.last,
        opening.phase if opening.progress else None,
    )
    run.clock = opening.clock(whole.begin)
    for bodies in whole.system.colliders.bodies:
        bodies.pushed_by(run)
    running: list[RunningSprings] = []
    springs = 0
    for member, setup, rows in zip(members, setups, whole.rows, strict=True):
        own = slice(springs, springs + len(setup.body.body.springs.rest))
        springs = own.stop
        first = not running
        notices = (*setup.body.notices, *(whole.notices if first else ()))
        running.append(RunningSprings(member, setup, run, rows, own, notices, first))
    return running


def spring_trial(
    members: Sequence[SceneSystem], rebuild: Callable[[], Opening], times: FloatArray
) -> Trial:
    """Return systems that are joined, or one alone, to be simulated in several ways.

    Raises:
        FormatError: The file of a character is malformed.
        OptionError: Something makes no sense.
        ToleranceError: An error is to be kept, and it blew up at once.
    """
    names = [member.name for member in members]
    setups = [cast(SpringSetup, member.setup) for member in members]
    opening = rebuild()
    whole = _Whole(names, setups, opening)
    kinds = dict.fromkeys(member.kind for member in members)
    options = options_of(whole.spec)
    if options.error is not None:
        run = SpringRun(whole.system, options, whole.begin, opening.last)
        options = run.options
    return trial_of(
        " + ".join(names), " + ".join(kinds), whole.system, options, whole.begin, times
    )


class _Whole:
    """Bodies that are one system of particles."""

    def __init__(
        self, names: Sequence[str], setups: Sequence[SpringSetup], opening: Opening
    ) -> None:
        self.spec = shared(setups)
        self.begin = -self.spec.preroll
        self.notices: list[Fault] = []  # what is odd about them together
        bodies, ties = self._placed(setups, opening)
        starts = np.cumsum([0, *(len(body.positions) for body in bodies)])
        pairs = join_pairs(names, setups, starts)
        welded = weld(join(bodies), pairs)
        self._say_apart("particles that are joined are", welded.gap)
        self.rows = [  # of each body, its particles in the system ``(N,)``
            welded.rows[start : start + len(body.positions)]
            for start, body in zip(starts, bodies, strict=False)
        ]
        self.system = self._system(setups, opening, welded, ties)

    def _placed(
        self, setups: Sequence[SpringSetup], opening: Opening
    ) -> tuple[list[Body], list[list[Tie]]]:
        """Return bodies where pins have them, and what ties each."""
        bodies, ties = [], []
        for setup in setups:
            body, pins = setup.body.body, setup.pins
            poses = [pin.poses(opening.characters) for pin in pins]
            points = moved_to_pins(pins, poses, body.positions, self.begin)
            own = ties_of(pins, poses, points, self.begin)
            held = points.copy()
            for tie in own:
                if tie.stiffness is None:
                    held[tie.particles] = tie.start
            gap = float(np.linalg.norm(held - points, axis=1).max())
            self._say_apart("pins hold particles", gap)
            windy = isinstance(wind_of(setup.spec), FaceWindModel)
            faces = windy or contact_of(setup.spec) is not None
            none = np.zeros((0, 3), np.int64)
            triangles = body.triangles if faces else none
            bodies.append(replace(body, positions=held, triangles=triangles))
            ties.append(own)
        return bodies, ties

    def _system(
        self,
        setups: Sequence[SpringSetup],
        opening: Opening,
        welded: Welded,
        ties: Sequence[Sequence[Tie]],
    ) -> SpringSystem:
        every, count = Ties(), len(welded.body.positions)
        resistance = np.zeros(count)
        for setup, rows, own in zip(setups, self.rows, ties, strict=True):
            for tie in own:
                every.add(tie, rows)
            slowing = setup.spec.drag * setup.body.body.masses
            wind = wind_of(setup.spec)
            if wind is not None and not isinstance(wind, FaceWindModel):
                span = self.begin, opening.last
                points = welded.body.positions[rows]
                every.add(wind_ties(wind, points, slowing, span), rows)
            else:
                np.add.at(resistance, rows, slowing)
        wind = wind_of(self.spec)
        colliders = _around(setups).built(opening, self.begin, CELL)
        system = SpringSystem(
            welded.body,
            pins=every.pins,
            targets=every.targets,
            gravity=self.spec.gravity,
            resistance=resistance,
            air=air_of(wind) if isinstance(wind, FaceWindModel) else None,
            colliders=colliders,
            radius=self.spec.radius,
            speed_limit=self.spec.speed_limit,
            self_contact=contact_of(self.spec),
        )
        if self.spec.settle:
            return self._settled(system, opening.phase())
        return system

    def _settled(self, system: SpringSystem, progress: Progress) -> SpringSystem:
        """Return a system that begins where it comes to rest."""
        rest = find_rest(system, self.begin, progress=progress)
        if not rest.solved:
            message = f"no rest was found: forces of {rest.residual:.2g} N are left"
            hint = "let it settle in a preroll, with drag"
            self._warn("SIM152", message, hint, "settle")
        return system.starting_at(rest.positions)

    def _say_apart(self, what: str, gap: float) -> None:
        if gap > APART:
            message = (
                f"{what} {length_text(gap)} from where they are built: springs pull"
            )
            hint = "place them so that they fit, or give pins an offset"
            self._warn("SIM150", message, hint, "pins")

    def _warn(self, code: str, message: str, hint: str, key: str) -> None:
        warning = Severity.WARNING
        fault = Fault(code, message, where=key, hint=hint, severity=warning)
        self.notices.append(fault)


def _around(setups: Sequence[SpringSetup]) -> Surroundings:
    """Return what any of them runs into."""
    return Surroundings(
        tuple(each for setup in setups for each in setup.around.colliders),
        tuple(each for setup in setups for each in setup.around.characters),
        tuple(each for setup in setups for each in setup.around.surfaces),
        tuple(each for setup in setups for each in setup.around.meshes),
    )


@dataclass
class RunningSprings:
    """A rope, strands, cloth or a volume under way."""

    member: SceneSystem  # its entry
    setup: SpringSetup  # what it is made of
    run: SpringRun  # what takes it, and what it is joined to, through time
    rows: IntArray  # its particles in the run ``(N,)``
    springs: slice  # its springs there
    own: Sequence[Fault]  # what is odd about it alone
    first: bool  # whether it speaks for all that it is joined to
    _torn_mesh: TornMesh | Faces | None = None

    @property
    def tears(self) -> bool:
        """Whether it is a surface that may part."""
        shape = self.setup.body.shape
        return isinstance(shape, Faces) and shape.tears

    @property
    def torn(self) -> npt.NDArray[np.bool_]:
        """Which of its springs are torn so far ``(S,)``."""
        return self.run.torn[self.springs]

    def part(self, torn: npt.NDArray[np.bool_]) -> None:
        """Draw it so that it can part where springs of it will tear ``(S,)``."""
        body = self.setup.body
        self._torn_mesh = cast(Faces, body.shape).parted(torn, body.body.positions)

    def at(self, t: float) -> Any:
        """Return what is drawn of it at a time [s], not before the last one."""
        state, torn = self.run.at(t)
        points: FloatArray = state[0, self.rows]
        shape = self._torn_mesh or self.setup.body.shape
        return shape.row(points, state[1, self.rows], torn[self.springs])

    @property
    def radius(self) -> float:
        """Half its thickness [m]."""
        return self.setup.spec.radius

    @property
    def closed(self) -> bool:
        """Whether only its outside is run into."""
        return getattr(self.setup.body.shape, "closed", False)

    def watched(self, begin: float, step: float) -> Watched:
        """Return its surface from a time on, looked at in steps [s]."""
        shape = cast(Faces, self.setup.body.shape)
        return Watched(self.run, shape, self.rows, self.springs, (begin, step))

    @property
    def notices(self) -> list[Fault]:
        """What is odd so far, and what it came to."""
        if not self.first:
            return list(self.own)
        return [*self.own, *self.run.notices, *self._warnings(), self._note()]

    def _warnings(self) -> list[Fault]:
        """Return a warning where springs that never tear became very long (SIM187)."""
        run = self.run
        tears = np.isfinite(run.system.body.springs.limit).any()
        if tears or 1 + run.stretch <= LONG * (1 + run.begun):
            return []
        message = f"{self.member.name}: springs become {percent(run.stretch)} longer"
        message += " than at rest"
        hint = "raise the stiffness [N/m], which is that of each spring, or lower the "
        hint += "mass [kg]"
        return [Fault("SIM187", message, hint=hint, severity=Severity.WARNING)]

    def _note(self) -> Fault:
        run = self.run
        parts = [
            f"{run.solver} ({run.reason})",
            f"steps of {plain(run.step)} s and more",
            f"springs up to {percent(run.stretch)} longer than at rest",
        ]
        if run.error is not None and math.isfinite(run.error):
            parts.append(f"error {length_text(run.error)}")
        if run.torn.any():
            parts.append(f"{counted(int(run.torn.sum()), 'spring')} torn")
        message = f"{self.member.name}: {', '.join(parts)}"
        return Fault("SIM130", message, severity=Severity.NOTE)

    def report(self) -> dict[str, object]:
        """Return what became of it, as plain values."""
        run, body = self.run, self.setup.body.body
        report: dict[str, object] = {
            "name": self.member.name,
            "kind": self.member.kind,
            "particles": len(body.positions),
            "springs": len(body.springs.rest),
            "solver": str(run.solver),
            "reason": run.reason,
            "step": run.step,
            "steps": run.steps,
            "stretch": run.stretch,
            "torn": int(run.torn[self.springs].sum()),
            "unresolved": run.unresolved,
        }
        if run.error is not None:
            report["error"] = run.error if math.isfinite(run.error) else None
        return report
