"""Work-precision trials of a scene's systems, springs and IK passes."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from animtool.clip.reduction.points import SHELL_DISTANCE, attached_points
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.files.output import STDOUT
from animtool.ik.take_pass import IkPassOptions, rig_and_tracks, solve_options
from animtool.motion.motion import Motion
from animtool.motion.take import Take, TakeStream
from animtool.rig.parts import AttachKind
from animtool.rig.skeleton import Rig
from animtool.scene.bake.bake import run_stage
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.plan import plan_stage
from animtool.scene.bake.prims import BakePlan
from animtool.scene.file.entries import EntryLocation, ScenePass, SceneSystem
from animtool.scene.scene import Scene
from animtool.scene.systems.bake import SystemPrims
from animtool.scene.systems.character_motion import CharacterMotion, motion_from_take
from animtool.scene.systems.trial import system_trials
from animtool.scene.tables.ik import pass_trial
from animtool.sim.trajectory import Status
from animtool.sim.trials.trial import (
    REFERENCE_FACTORS,
    STEP_FACTORS,
    Figure,
    Setting,
    Snapshot,
    Trial,
    TrialOutcome,
)
from animtool.systems.attach.bodies import (
    AttachedBody,
    ChainBody,
    SurfaceBody,
    build_bodies,
)
from animtool.systems.attach.settings import SimulateOptions
from animtool.systems.attach.take_pass import has_effect

ATTACH_METHOD = "xpbd"
# Step factors around the chosen setting, which is usually finer than needed.
MAX_STEP_RATIO = 8.0

# Maximum number of compared frames, evenly over the range.
MAX_COMPARED_FRAMES = 100


def has_simulation(scene: Scene) -> bool:
    """Return whether a scene has systems or a ``simulate`` pass."""
    return bool(scene.systems) or any(
        scene_pass.pass_.name == "simulate" for scene_pass in scene.passes
    )


def simulation_trials(
    scene: Scene, options: BakeOptions | None = None
) -> list[tuple[EntryLocation, Trial]]:
    """Return the trials of a scene's systems and passes, in order.

    Args:
        scene: A scene with systems, or with passes that simulate or solve IK.
        options: Bake options: for systems, the frames.
    """
    trials: list[tuple[EntryLocation, Trial]] = []
    if scene.sources:
        trials += _pass_trials(scene)
    if scene.systems:
        times, character = _compared_times(scene, options or BakeOptions())
        compared_times = times[_compared_frame_indices(len(times))]
        for members, trial in system_trials(scene.systems, compared_times, character):
            write = partial(_write_systems, scene, members, trial)
            trials.append((members[0].location, replace(trial, write=write)))
    return trials


def _compared_frame_indices(count: int) -> IntArray:
    """Return indices of up to `MAX_COMPARED_FRAMES` frames, evenly over all frames."""
    indices = np.linspace(0, count - 1, min(count, MAX_COMPARED_FRAMES))
    return indices.astype(np.int64)


def _write_systems(
    scene: Scene,
    members: Sequence[SceneSystem],
    trial: Trial,
    setting: Setting,
    output: Path,
) -> None:
    """Write a scene in which some of its systems use another setting."""
    assert trial.changed_keys is not None
    changes = dict(trial.changed_keys(setting))
    systems = list(scene.systems)
    for i, system in enumerate(systems):
        if system in members:
            spec = system.setup.spec.model_copy(update=changes)
            systems[i] = replace(system, setup=replace(system.setup, spec=spec))
    _write(replace(scene, systems=tuple(systems)), output)


def _write_pass(
    scene: Scene, pass_index: int, setting: Setting, output: Path, name: str
) -> None:
    """Write a scene in which one pass uses another setting."""
    passes = list(scene.passes)
    options = replace(passes[pass_index].options, **{name: setting[name]})
    passes[pass_index] = replace(passes[pass_index], options=options)
    _write(replace(scene, passes=tuple(passes)), output)


def _write(scene: Scene, output: Path) -> None:
    run_stage(_plan(scene, output, BakeOptions(overwrite=True)))


def _plan(scene: Scene, output: Path, options: BakeOptions) -> BakePlan:
    """Return the plan of a scene's first output without chunks, which need files."""
    first_output = scene.outputs[0]
    output_without_chunks = replace(
        first_output, bake=replace(first_output.bake, chunk=None)
    )
    return plan_stage(replace(scene, outputs=(output_without_chunks,)), output, options)


def _compared_times(
    scene: Scene, options: BakeOptions
) -> tuple[FloatArray, CharacterMotion | None]:
    """Return the times at which systems are compared [s], and the scene's character."""
    plan = _plan(scene, STDOUT, options)
    if plan.takes:
        character = motion_from_take(scene.path, plan.takes[0].stream.collect())
        return _times_in_range(character.times, plan), character
    (systems,) = plan.prims
    assert isinstance(systems, SystemPrims)
    return np.array([systems.seconds(code) for code in systems.codes]), None


def _times_in_range(times: FloatArray, plan: BakePlan) -> FloatArray:
    """Return the times of a take that are in the range of an output [s]."""
    frame_range = plan.options.frame_range
    if frame_range is None:
        return times
    codes = float(plan.start) + times * float(plan.fps)
    is_inside = (codes >= frame_range.first) & (codes <= frame_range.last)
    return times[is_inside] if is_inside.any() else times


def _pass_trials(scene: Scene) -> list[tuple[EntryLocation, Trial]]:
    """Return the trials of the spring and IK passes of a scene, with their entries."""
    full_scene, folder = scene, scene.path.resolve().parent
    measured_pass_indices = [
        i
        for i, scene_pass in enumerate(scene.passes)
        if _is_ik_pass(scene_pass) or _is_spring_pass(scene_pass)
    ]
    scene = replace(
        scene, passes=scene.passes[: max(measured_pass_indices, default=-1) + 1]
    )
    trials = []
    steps = zip(scene.passes, scene.steps(), strict=False)
    for pass_index, (scene_pass, (take, _)) in enumerate(steps):
        if _is_ik_pass(scene_pass):
            with scene_pass.location.located():
                tracks = rig_and_tracks(take, scene_pass.options, folder)
                trial = pass_trial(*tracks, solve_options(scene_pass.options))
                trials.append((scene_pass.location, trial))
        if not _is_spring_pass(scene_pass):
            continue
        with scene_pass.location.located():
            bodies = build_bodies(take.rig, scene_pass.options.what)
        for body in bodies:
            options = replace(scene_pass.options, what=(body.name,))
            trial = _attach_trial(
                scene, replace(scene_pass, options=options), take, body
            )
            write = partial(_write_pass, full_scene, pass_index, name="rate")
            trials.append((scene_pass.location, replace(trial, write=write)))
    return trials


def _is_ik_pass(scene_pass: ScenePass) -> bool:
    return isinstance(scene_pass.options, IkPassOptions)


def _is_spring_pass(scene_pass: ScenePass) -> bool:
    return isinstance(scene_pass.options, SimulateOptions) and has_effect(
        scene_pass.options
    )


def _attach_trial(
    scene: Scene, scene_pass: ScenePass, take: Take, body: AttachedBody
) -> Trial:
    """Return the trial of a spring attachment with larger and smaller steps."""
    clock = take.clock
    frame_indices = np.unique(_compared_frame_indices(clock.count))

    def run_pass(motion: Motion, **options: float) -> tuple[Motion, dict[str, Any]]:
        """Apply the pass to a motion; return the resulting motion and its report."""
        stream = replace(TakeStream.of(take), blocks=iter([motion]))
        changed_pass = replace(
            scene_pass, options=replace(scene_pass.options, **options)
        )
        passed_stream = scene.apply_scene_pass(stream, changed_pass)
        changed_motion = Motion.concatenate(list(passed_stream.blocks))
        (report,) = passed_stream.simulated
        return changed_motion, report

    _, report = run_pass(take.motion.select(slice(0, 1)))
    frame_rate = float(clock.rate)
    rate = frame_rate * report["steps"]

    def settings(step_ratios: Sequence[float]) -> list[Setting]:
        # A frame has a whole number of steps.
        step_counts = [
            math.ceil(rate / ratio / frame_rate - 1e-9) for ratio in step_ratios
        ]
        rates = (count * frame_rate for count in dict.fromkeys(step_counts))
        return [Setting.of(ATTACH_METHOD, rate=step_rate) for step_rate in rates]

    def run(setting: Setting) -> TrialOutcome:
        start_time = time.perf_counter()
        motion, report = run_pass(take.motion, rate=setting["rate"])
        seconds = time.perf_counter() - start_time
        points = _attachment_points(take.rig, body, motion.select(frame_indices))
        snapshots = list(map(Snapshot, points))
        is_valid = bool(np.isfinite(points).all())
        return TrialOutcome(
            seconds,
            report["steps"] * motion.frames,
            snapshots,
            Status.OK if is_valid else Status.UNSTABLE,
            "" if is_valid else "its state is not finite",
            figures=_error_figures(report),
        )

    return Trial(
        body.name,
        str(body.kind),
        float(clock.duration),
        Setting.of(ATTACH_METHOD, rate=rate),
        lambda: settings((MAX_STEP_RATIO, *STEP_FACTORS)),
        lambda: [settings(REFERENCE_FACTORS)],
        run,
        request_lines=lambda setting: [f"simulate: {{rate: {setting['rate']:g}}}"],
    )


def _error_figures(report: Mapping[str, Any]) -> dict[Figure, float]:
    """Return the strain of an attachment, and its penetration depth if reported."""
    figures = {Figure.STRETCH: float(report["stretch"])}
    if report["kind"] == AttachKind.CLOTH:
        figures[Figure.DEPTH] = float(report["depth"]["value"])
        figures[Figure.PIERCED] = float(report["pierced"]["value"])
    return figures


def _attachment_points(rig: Rig, body: AttachedBody, motion: Motion) -> FloatArray:
    """Return the points of an attachment that are compared ``(F, N, 3)`` [m]."""
    if isinstance(body, SurfaceBody):
        return motion.points[body.mesh.name].dense()
    assert isinstance(body, ChainBody)
    world = motion.world(rig)
    offsets = attached_points(rig, SHELL_DISTANCE)[body.joints, :, None]
    rotated_offsets = world.linear[:, body.joints, None] * offsets
    points = world.positions[:, body.joints, None] + rotated_offsets.sum(axis=-1)
    all_points: FloatArray = points.reshape(motion.frames, -1, 3)
    return all_points
