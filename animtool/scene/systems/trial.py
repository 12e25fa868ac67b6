"""Systems of derived kinds simulated in several ways: methods, steps and tolerances."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault, OptionError, ToleranceError
from animtool.frames import Frame, PointsFrame, TransformsFrame
from animtool.plugins import load_object
from animtool.scene.entries import SceneSystem
from animtool.scene.systems.derived import SpecSetup, run_spec
from animtool.scene.systems.simulation import Opening
from animtool.sim.integrators import INTEGRATORS, find_integrator
from animtool.sim.integrators.integrator import Control
from animtool.sim.options import TOLERANCE
from animtool.sim.trajectory import Status
from animtool.sim.trials.trial import FINER, Outcome, Setting, Shot, ladder, stepwise
from animtool.systems.simulation import SimulationRun, StoppedError

# What the exact method has over the step of the file, where that is not enough.
MUCH_FINER = 1 / 8
# Tolerances over the usual one, and what methods that choose their steps have for the
# longest, over the step of the file.
TOLERANCES = (100.0, 1.0, 0.01)
LONGER = 4.0
# Unknowns up to which implicit methods are tried: forces do not say their derivatives,
# which take as many evaluations.
MAX_UNKNOWNS = 30
# Evaluations in a step that are enough to tell that a method is not for it.
MAX_EVALUATIONS = 1000


def spec_trial(
    members: Sequence[SceneSystem], rebuild: Callable[[], Opening], times: FloatArray
) -> SpecTrial:
    """Return a system that can be simulated in several ways."""
    (member,) = members
    return SpecTrial(member, rebuild, times)


class SpecTrial:
    """A system with the method and the step of its file, and with others."""

    def __init__(
        self, member: SceneSystem, rebuild: Callable[[], Opening], times: FloatArray
    ) -> None:
        setup = cast(SpecSetup, member.setup)
        spec = self._spec = setup.spec
        self.name, self.kind = member.name, member.kind
        self.span = float(times[-1]) + spec.preroll
        self._member, self._rebuild, self._times = member, rebuild, times
        tolerance = getattr(spec, "tolerance", None)
        self._usual = TOLERANCE if tolerance is None else tolerance
        own = {} if _is_fixed(setup.method) else {"tolerance": self._usual}
        self.chosen = Setting.of(setup.method, step=spec.step, **own)
        self._most = 0  # points at once in any run so far

    def settings(self) -> list[Setting]:
        """Return each method with several steps or tolerances."""
        methods, step = self._spec.methods, self._spec.step
        found = []
        for method in INTEGRATORS if methods is None else methods or [self._method]:
            if _is_fixed(method):
                found += stepwise(method, step)
                continue
            own = method == self._method
            longest, usual = (step, self._usual) if own else (LONGER * step, TOLERANCE)
            found += [
                Setting.of(method, step=longest, tolerance=value)
                for value in ladder(usual, TOLERANCES)
            ]
        return found

    def references(self) -> list[list[Setting]]:
        """Return finer and finer steps of the exact method, else of that of the file.

        Where the exact one is not stable, those of the file's own, or far shorter ones.
        """
        exact, own = self._spec.exact, self._method
        shares = [(exact, 1.0), (exact, MUCH_FINER)] if exact else []
        if own != exact and _is_fixed(own):
            shares.insert(1, (own, 1.0))
        step = self._spec.step
        return [stepwise(method, share * step, FINER) for method, share in shares]

    def run(self, setting: Setting) -> Outcome:
        """Simulate it in one way.

        Raises:
            OptionError: The method is not for it (SIM006), or for so much (SIM024).
        """
        run = self._begun(setting)
        began = time.perf_counter()
        shots: list[Shot] = []
        energies, status, reason, stable = [], Status.OK, "", None
        try:
            for t in self._times.tolist():
                shots.append(_shot(run.at(t)))
                energies.append(run.diagnostics.energy)
        except ToleranceError as error:
            status, reason = Status.UNSTABLE, error.faults[0].message
            if isinstance(error, StoppedError):
                stats = error.stats
                status, reason, stable = stats.status, stats.reason, stats.stable_step
        seconds = time.perf_counter() - began
        self._most = max([self._most, *(len(shot.points) for shot in shots)])
        last = run.simulation.diagnostics(run.state.state, run.time(run.state.steps))
        known = [energy for energy in energies if energy is not None]
        whole = len(known) == len(shots) and _same(shots)
        return Outcome(
            seconds,
            run.taken if last.steps is None else last.steps,
            shots,
            status,
            reason,
            last.stable_step() if stable is None else stable,
            known if whole else None,
        )

    @property
    def _method(self) -> str:
        return self.chosen.method

    def _begun(self, setting: Setting) -> SimulationRun:
        """Return it at its beginning, in one way."""
        changes: dict[str, Any] = dict(setting.options)
        budget = None
        if setting.method in INTEGRATORS:
            integrator, own = find_integrator(setting.method), self._method
            unknowns = 3 * self._most
            other = setting.method != own
            if other and integrator.implicit and unknowns > MAX_UNKNOWNS:
                message = f"{setting.method} would solve for {unknowns} unknowns at "
                raise OptionError(Fault("SIM024", f"{message}once", where="method"))
            if integrator.solver:
                # What it takes to import is no part of the simulation.
                load_object(integrator.solver)
            budget = MAX_EVALUATIONS if other else None
        fields = type(self._spec).model_fields
        changes |= {"method": setting.method} if "method" in fields else {}
        if "tolerance" in fields:
            changes.setdefault("tolerance", None)
        spec = self._spec.model_copy(update=changes)
        return run_spec(self._member, self._rebuild(), spec, budget)


def _is_fixed(method: str) -> bool:
    """Return whether a method takes steps of one length; those of a kind's own do."""
    known = method in INTEGRATORS
    return not known or find_integrator(method).control is Control.FIXED


def _same(shots: Sequence[Shot]) -> bool:
    """Return whether no point comes or goes."""
    ids = [shot.ids for shot in shots if shot.ids is not None]
    return all(np.array_equal(each, ids[0]) for each in ids)


def _shot(frame: Frame) -> Shot:
    """Return what a table compares of a frame."""
    if isinstance(frame, TransformsFrame):
        arms = [np.linalg.norm(mesh.points, axis=1) for mesh in frame.meshes]
        sizes = np.abs(frame.scales).max(initial=0.0)
        reach = float(max((arm.max(initial=0.0) for arm in arms), default=0.0) * sizes)
        return Shot(frame.points, frame.ids, frame.rotations, reach)
    ids = frame.ids if isinstance(frame, PointsFrame) else None
    return Shot(frame.points, ids)
