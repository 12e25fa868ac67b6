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

# Shares of the chains' length, and radians.
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
# Of the solution that others are compared with, each a tenth of the one before.
FINER = (1e-8, 1e-9, 1e-10)
# Of a goal that asks for an orientation, points so far off it are compared too [m].
REACH = 0.1


def job_trial(job: IkJob) -> Trial:
    """Return the trial of an IK job; nothing is written.

    Raises:
        FormatError: A file is malformed.
        OptionError: The files do not fit each other, or an option makes no sense.
    """
    context = open_ik(job)

    def solve(options: TakeOptions) -> TakeIk:
        return solve_take(
            context.take,
            context.tracks,
            options,
            static=context.at_rest,
            only=context.only,
        )

    def scene_text(options: TakeOptions) -> list[str]:
        method, tolerance = argument("method"), argument("tolerance")
        value = f"{options.tolerance * 1000:.3g}mm"
        return [f"animtool ik {method} {options.method} {tolerance} {value}"]

    return solve_trial(job.targets.name, job.options, solve, scene_text)


def pass_trial(take: Take, tracks: TargetTracks, options: TakeOptions) -> Trial:
    """Return the trial of a scene's IK pass."""

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
    """Return the trial of targets: tolerances of one method, and each method.

    Points are those of the effectors, where the take asks for them; those of the finest
    solution are what others are compared with. Figures are misses of the targets.
    """
    first = solve(options)
    length = first.problem.length
    frames = len(first.statuses)
    clock = first.take.clock

    def setting_of(method: IkMethod, tolerance: float, angle: float) -> Setting:
        return Setting.of(method, tolerance=tolerance, angle_tolerance=angle)

    def options_of(setting: Setting) -> TakeOptions:
        return replace(
            options,
            method=IkMethod(setting.method),
            tolerance=setting["tolerance"],
            angle_tolerance=setting["angle_tolerance"],
        )

    def run(setting: Setting) -> TrialOutcome:
        return _outcome(solve(options_of(setting)))

    current = (options.tolerance, options.angle_tolerance)
    chosen = setting_of(options.method, *current)
    settings = [setting_of(options.method, t * length, t) for t in TOLERANCES]
    settings += [setting_of(method, *current) for method in IkMethod]
    finest = [setting_of(options.method, t * length, t) for t in FINER]
    return Trial(
        name,
        f"ik, {first.problem.degrees} degrees of freedom, {frames} frames",
        float(clock.duration),
        chosen,
        lambda: settings,
        lambda: [finest],
        run,
        ErrorMeasure.LARGEST,
        unit="iterations",
        where=lambda shot, point: _where(first, shot, point),
        lines=lambda setting: scene_text(options_of(setting)),
    )


def _where(solved: TakeIk, shot: int, point: int) -> str:
    goals = [goal for goal, _, _ in _compared(solved)]
    frame = float(solved.take.clock.times[shot])
    return f"{solved.tracks.goals[goals[point]].name} at frame {frame:g}"


def _compared(solved: TakeIk) -> list[tuple[int, int, FloatArray]]:
    """Return the compared points: goal, joint and offset of each."""
    points = []
    for i, track in enumerate(solved.tracks.goals):
        goal, joint = track.goal, solved.take.rig.index(track.goal.joint)
        offset = np.asarray(goal.offset, np.float64)
        arms = REACH * np.eye(3)[:2] if goal.orientation else np.zeros((0, 3))
        points += [(i, joint, offset + arm) for arm in (np.zeros(3), *arms)]
    return points


def _outcome(solved: TakeIk) -> TrialOutcome:
    """Return the positions of the effectors and their errors."""
    take, compared = solved.take, _compared(solved)
    joints = [joint for _, joint, _ in compared]
    offsets = np.array([offset for _, _, offset in compared])
    world = take.world()
    turned = np.einsum("fpab,pb->fpa", world.linear[:, joints], offsets)
    shots = [Snapshot(points) for points in world.positions[:, joints] + turned]
    misses = np.where(solved.active, solved.misses, 0.0)
    reached = [status is IkStatus.CONVERGED for status in solved.statuses]
    figures = {
        Figure.MISS: float(misses[..., 0].max(initial=0.0)),
        Figure.MISS_ANGLE: float(misses[..., 1:].max(initial=0.0)),
        Figure.REACHED: float(np.mean(reached)),
    }
    steps = int(solved.iterations.sum())
    return TrialOutcome(solved.seconds, steps, shots, figures=figures)
