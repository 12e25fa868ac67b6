"""Work-precision trials of IK: tolerances and methods."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.ik.on_take import solve_take
from animtool.ik.options import IkMethod, TakeOptions
from animtool.ik.result import IkStatus
from animtool.ik.take_run import TakeIk
from animtool.ik.tracks import TargetTracks
from animtool.motion.take import Take
from animtool.scene.solves.ik import IkJob, open_ik
from animtool.sim.trials.trial import (
    ErrorMeasure,
    Figure,
    Setting,
    Snapshot,
    Trial,
    TrialOutcome,
)

# Tolerances to try, relative to the chains' length and in radians.
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
# Tolerances of the reference solution, each a tenth of the one before.
REFERENCE_TOLERANCES = (1e-8, 1e-9, 1e-10)
# For goals with an orientation, points at this distance are compared too [m].
ORIENTATION_POINT_DISTANCE = 0.1


def job_trial(job: IkJob) -> Trial:
    """Return the trial of an IK job; nothing is written."""
    inputs = open_ik(job)

    def solve(options: TakeOptions) -> TakeIk:
        return solve_take(
            inputs.take,
            inputs.tracks,
            options,
            static=inputs.is_at_rest,
            only=inputs.only_index,
        )

    def scene_text(options: TakeOptions) -> list[str]:
        method, tolerance = argument("method"), argument("tolerance")
        value = f"{options.tolerance * 1000:.3g}mm"
        return [f"animtool ik {method} {options.method} {tolerance} {value}"]

    trial = solve_trial(job.targets.name, job.options, solve, scene_text)
    return replace(trial, notices=tuple(inputs.notices))


def pass_trial(take: Take, tracks: TargetTracks, options: TakeOptions) -> Trial:
    """Return the trial of a scene's IK pass on the take before it."""

    def scene_text(options: TakeOptions) -> list[str]:
        tolerance = f"{options.tolerance * 1000:.3g}mm"
        return [f"ik: {{method: {options.method}, tolerance: {tolerance}}}"]

    def solve(options: TakeOptions) -> TakeIk:
        return solve_take(take, tracks, options)

    return solve_trial(tracks.path.name, options, solve, scene_text)


def solve_trial(
    name: str,
    options: TakeOptions,
    solve: Callable[[TakeOptions], TakeIk],
    scene_text: Callable[[TakeOptions], list[str]],
) -> Trial:
    """Return the trial of targets: several tolerances of one method, and all methods.

    Points of the effectors at the frames with targets are compared with the finest
    solution. Figures are distances from the targets.
    """
    chosen_result = solve(options)
    length = chosen_result.problem.length
    frame_count = len(chosen_result.statuses)
    clock = chosen_result.take.clock

    def new_setting(method: IkMethod, tolerance: float, angle: float) -> Setting:
        return Setting.of(method, tolerance=tolerance, angle_tolerance=angle)

    def options_for(setting: Setting) -> TakeOptions:
        return replace(
            options,
            method=IkMethod(setting.method),
            tolerance=setting["tolerance"],
            angle_tolerance=setting["angle_tolerance"],
        )

    def run(setting: Setting) -> TrialOutcome:
        return _outcome(solve(options_for(setting)))

    method, tolerances = options.method, (options.tolerance, options.angle_tolerance)
    settings = [new_setting(method, t * length, t) for t in TOLERANCES]
    settings += [new_setting(other_method, *tolerances) for other_method in IkMethod]
    references = [new_setting(method, t * length, t) for t in REFERENCE_TOLERANCES]
    return Trial(
        name,
        f"ik, {chosen_result.problem.degrees} degrees of freedom, {frame_count} frames",
        float(clock.duration),
        new_setting(method, *tolerances),
        lambda: settings,
        lambda: [references],
        run,
        ErrorMeasure.LARGEST,
        unit="iterations",
        point_label=lambda snapshot, point: _point_label(
            chosen_result, snapshot, point
        ),
        request_lines=lambda setting: scene_text(options_for(setting)),
    )


def _point_label(solution: TakeIk, snapshot: int, point: int) -> str:
    """Return the goal of a compared point and the frame of a snapshot, as text."""
    goal, _, _ = _effectors(solution)[point]
    frame = float(solution.take.clock.times[snapshot])
    return f"{solution.tracks.goals[goal].name} at frame {frame:g}"


def _effectors(solution: TakeIk) -> list[tuple[int, int, FloatArray]]:
    """Return the goal, joint and offset of each point that is compared."""
    points = []
    for i, track in enumerate(solution.tracks.goals):
        goal, joint = track.goal, solution.take.rig.index(track.goal.joint)
        offset = np.asarray(goal.offset, np.float64)
        arm_offsets = (
            ORIENTATION_POINT_DISTANCE * np.eye(3)[: 2 if goal.orientation else 0]
        )
        points += [
            (i, joint, offset + axis_offset)
            for axis_offset in (np.zeros(3), *arm_offsets)
        ]
    return points


def _outcome(solution: TakeIk) -> TrialOutcome:
    """Return the effector positions of a solution and their errors."""
    take, effectors = solution.take, _effectors(solution)
    joints = [joint for _, joint, _ in effectors]
    offsets = np.array([offset for _, _, offset in effectors])
    world = take.world()
    rotated_offsets = np.einsum("fpab,pb->fpa", world.linear[:, joints], offsets)
    points = world.positions[:, joints] + rotated_offsets
    snapshots = list(map(Snapshot, points))
    goal_errors = np.where(solution.active, solution.misses, 0.0)
    has_converged = [status is IkStatus.CONVERGED for status in solution.statuses]
    figures = {
        Figure.MISS: float(goal_errors[..., 0].max(initial=0.0)),
        Figure.MISS_ANGLE: float(goal_errors[..., 1:].max(initial=0.0)),
        Figure.REACHED: float(np.mean(has_converged)),
    }
    iteration_count = int(solution.iterations.sum())
    return TrialOutcome(solution.seconds, iteration_count, snapshots, figures=figures)
