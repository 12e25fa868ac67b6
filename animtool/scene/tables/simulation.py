"""Time against error of what a scene simulates, over methods and steps."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from animtool.clip.reduction.points import SHELL, attached_points
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError
from animtool.core.record import dataclass
from animtool.motion.motion import Motion
from animtool.motion.take import Take, TakeStream
from animtool.rig.kinematics import forward
from animtool.rig.skeleton import Rig
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.plan import plan_stage
from animtool.scene.bake.prims import BakePlan
from animtool.scene.bake.progress import Progress, share_of
from animtool.scene.file.entries import Place, ScenePass
from animtool.scene.scene import Scene
from animtool.scene.systems.bake import SystemPrims
from animtool.scene.systems.character_motion import CharacterMotion, motion_of
from animtool.scene.systems.trial import system_trials
from animtool.sim.trajectory import Status
from animtool.sim.trials.measuring import TrialTable, measure
from animtool.sim.trials.trial import COARSER, FINER, Outcome, Setting, Shot, Trial
from animtool.systems.attach.bodies import Body, ChainBody, SurfaceBody, bodies_of
from animtool.systems.attach.settings import SimulateOptions
from animtool.systems.attach.take_pass import moves

METHOD = "xpbd"
# Steps over those of the chosen setting: they are mostly more than need be.
COARSEST = 8.0

# Frames that are compared, evenly over the range.
MAX_INSTANTS = 100


@dataclass(frozen=True, slots=True)
class SimulationTable:
    """What a scene simulates, one table each."""

    source: Path  # the scene
    tables: list[TrialTable]  # in its order
    json_keys: ClassVar[str] = "'simulation_table' source simulated=tables notices"

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
    trials: list[tuple[Place, Trial]] = []
    if scene.sources:
        trials += _attach_trials(scene, MAX_INSTANTS)
    if scene.systems:
        times, own = _times(scene, options)
        picked = np.linspace(0, len(times) - 1, min(len(times), MAX_INSTANTS))
        looked = times[picked.astype(np.int64)]
        trials += [
            (system.place, trial)
            for system, trial in system_trials(scene.systems, looked, own)
        ]
    return trials


def _times(
    scene: Scene, options: BakeOptions
) -> tuple[FloatArray, CharacterMotion | None]:
    """Return when systems are looked at [s], and the character beside them."""
    # Nothing is written: chunks would need a file.
    first = scene.outputs[0]
    plain = replace(first, bake=replace(first.bake, chunk=None))
    plan = plan_stage(replace(scene, outputs=(plain,)), None, options)
    if plan.takes:
        own = motion_of(scene.path, plan.takes[0].stream.collect())
        return _within(own.times, plan), own
    (systems,) = plan.prims
    assert isinstance(systems, SystemPrims)
    return np.array([systems.seconds(code) for code in systems.codes]), None


def _within(times: FloatArray, plan: BakePlan) -> FloatArray:
    """Return those of a take's times [s] that are in the range of an output."""
    frame_range = plan.options.frame_range
    if frame_range is None:
        return times
    codes = float(plan.start) + times * float(plan.fps)
    inside = (codes >= frame_range.first) & (codes <= frame_range.last)
    return times[inside] if inside.any() else times


def _attach_trials(scene: Scene, instants: int) -> list[tuple[Place, Trial]]:
    """Return the attachments that passes of a scene simulate, at their entries.

    Raises:
        FormatError: A source is malformed, or a pass cannot be applied to it.
        OptionError: An option does not apply to the source.
    """
    measured = [i for i, entry in enumerate(scene.passes) if _simulates(entry)]
    scene = replace(scene, passes=scene.passes[: max(measured, default=-1) + 1])
    trials = []
    for entry, (take, _) in zip(scene.passes, scene.steps(), strict=False):
        if not _simulates(entry):
            continue
        with entry.place.located():
            bodies = bodies_of(take.rig, entry.options.what)
        for body in bodies:
            options = replace(entry.options, what=(body.name,))
            own = replace(entry, options=options)
            trials.append(
                (entry.place, _attach_trial(scene, own, take, body, instants))
            )
    return trials


def _simulates(entry: ScenePass) -> bool:
    return isinstance(entry.options, SimulateOptions) and moves(entry.options)


def _attach_trial(
    scene: Scene, entry: ScenePass, take: Take, body: Body, instants: int
) -> Trial:
    """Return an attachment in the steps of its pass, and in more or fewer."""
    clock = take.clock
    spread = np.linspace(0, clock.count - 1, min(clock.count, instants))
    frames = np.unique(spread.astype(np.int64))

    def passed(motion: Motion, **options: float) -> tuple[Motion, dict[str, Any]]:
        """Return what the pass with some options makes of a motion, and its report."""
        stream = replace(TakeStream.of(take), blocks=iter([motion]))
        changed = replace(entry.options, **options)
        done = scene.passed(stream, replace(entry, options=changed))
        simulated = Motion.concatenate(list(done.blocks))
        (report,) = done.simulated
        return simulated, report

    _, report = passed(take.motion.select(slice(0, 1)))
    frame_rate = float(clock.rate)
    rate = frame_rate * report["steps"]

    def settings(shares: Sequence[float]) -> list[Setting]:
        # A frame has a whole number of steps.
        steps = [math.ceil(rate / share / frame_rate - 1e-9) for share in shares]
        counts = dict.fromkeys(steps)
        return [Setting.of(METHOD, rate=count * frame_rate) for count in counts]

    def run(setting: Setting) -> Outcome:
        began = time.perf_counter()
        motion, report = passed(take.motion, rate=setting["rate"])
        seconds = time.perf_counter() - began
        points = _attached(take.rig, body, motion.select(frames))
        shots = [Shot(each) for each in points]
        sound = bool(np.isfinite(points).all())
        return Outcome(
            seconds,
            report["steps"] * motion.frames,
            shots,
            Status.OK if sound else Status.UNSTABLE,
            "" if sound else "its state is not finite",
            stretch=report["stretch"],
        )

    return Trial(
        body.name,
        str(body.kind),
        float(clock.duration),
        Setting.of(METHOD, rate=rate),
        lambda: settings((COARSEST, *COARSER)),
        lambda: [settings(FINER)],
        run,
    )


def _attached(rig: Rig, body: Body, motion: Motion) -> FloatArray:
    """Return the points of an attachment that are compared ``(F, N, 3)`` [m]."""
    if isinstance(body, SurfaceBody):
        return motion.points[body.mesh.name].dense()
    assert isinstance(body, ChainBody)
    world = forward(rig, *motion.dense())
    shell = attached_points(rig, SHELL)[body.joints, :, None]
    turned = world.linear[:, body.joints, None] * shell
    points = world.positions[:, body.joints, None] + turned.sum(axis=-1)
    whole: FloatArray = points.reshape(motion.frames, -1, 3)
    return whole
