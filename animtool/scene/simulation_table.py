"""Time against error of what a scene simulates, over methods and steps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault, OptionError
from animtool.scene.bake import plan_bake
from animtool.scene.entries import Place
from animtool.scene.options import BakeOptions
from animtool.scene.prims import BakePlan
from animtool.scene.progress import Progress, share_of
from animtool.scene.scene import Scene
from animtool.scene.systems.bake import SystemPrims
from animtool.scene.systems.character_motion import CharacterMotion, motion_of
from animtool.scene.systems.simulation import system_trials
from animtool.sim.trials.measuring import TrialTable, measure
from animtool.sim.trials.trial import Trial

# Frames that are compared, evenly over the range.
MAX_INSTANTS = 100


@dataclass(frozen=True, slots=True)
class SimulationTable:
    """What a scene simulates, one table each."""

    source: Path  # the scene
    tables: list[TrialTable]  # in its order

    @property
    def notices(self) -> list[Fault]:
        """What is odd about them."""
        return [notice for table in self.tables for notice in table.notices]


def simulates(scene: Scene) -> bool:
    """Return whether there is anything to simulate in a scene."""
    return bool(scene.systems) or any(
        entry.pass_.name == "simulate" for entry in scene.passes
    )


def simulation_table(
    scene: Scene, options: BakeOptions | None = None, *, progress: Progress = None
) -> SimulationTable:
    """Simulate what a scene does in several ways, and measure each.

    Args:
        scene: It has systems, or passes that simulate.
        options: Of the bake: of systems, which frames.
        progress: Called with the share done, 0 to 1.

    Raises:
        FormatError: A source is malformed, or a pass cannot be applied to it.
        OptionError: An option makes no sense, or nothing is simulated (SCN071).
    """
    trials = _trials(scene, options or BakeOptions())
    if not trials:
        message = "simulates nothing that could be measured"
        hint = "it has no systems, and no simulate pass with what to move"
        raise OptionError(Fault("SCN071", message, str(scene.path), (), hint))
    tables = []
    for i, (place, trial) in enumerate(trials):
        shown = share_of(progress, i, len(trials))
        with place.located():
            table = measure(trial, progress=shown)
        notices = [place.put(notice) for notice in table.notices]
        tables.append(replace(table, notices=notices))
    return SimulationTable(scene.path, tables)


def _trials(scene: Scene, options: BakeOptions) -> list[tuple[Place, Trial]]:
    found: list[tuple[Place, Trial]] = []
    if scene.sources:
        from animtool.scene.attach_trial import attach_trials

        found += attach_trials(scene, MAX_INSTANTS)
    if scene.systems:
        times, own = _times(scene, options)
        picked = np.linspace(0, len(times) - 1, min(len(times), MAX_INSTANTS))
        looked = times[picked.astype(np.int64)]
        found += [
            (system.place, trial)
            for system, trial in system_trials(scene.systems, looked, own)
        ]
    return found


def _times(
    scene: Scene, options: BakeOptions
) -> tuple[FloatArray, CharacterMotion | None]:
    """Return when systems are looked at [s], and the character beside them."""
    # Nothing is written: chunks would need a file.
    first = scene.outputs[0]
    plain = replace(first, bake=replace(first.bake, chunk=None))
    plan = plan_bake(replace(scene, outputs=(plain,)), None, options)
    if plan.takes:
        own = motion_of(scene.path, plan.takes[0].stream.collect())
        return _within(own.times, plan), own
    (systems,) = plan.prims
    assert isinstance(systems, SystemPrims)
    return np.array([systems.seconds(code) for code in systems.codes]), None


def _within(times: FloatArray, plan: BakePlan) -> FloatArray:
    """Return those of a take's times [s] that are in the range of an output."""
    wanted = plan.options.frame_range
    if wanted is None:
        return times
    codes = float(plan.start) + times * float(plan.fps)
    inside = (codes >= wanted.first) & (codes <= wanted.last)
    return times[inside] if inside.any() else times
