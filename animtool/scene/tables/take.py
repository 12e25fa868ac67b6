"""Work-precision trials of a take's output: sample rates, reduction, keys."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool.clip.reduction.points import SHELL_DISTANCE, attached_points
from animtool.clip.reduction.reduce import reduce_motion
from animtool.clip.reduction.tolerance import KEY_TOLERANCE
from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError
from animtool.core.files.output import STDOUT
from animtool.core.names import has_kind_suffix
from animtool.core.record import dataclass
from animtool.core.units import parse_length
from animtool.edit.resample import missing_frames_fault, resampled
from animtool.edit.retiming import trim
from animtool.motion.motion import Motion
from animtool.motion.take import Take, TakeStream
from animtool.rig.kinematics import WorldTransforms, rest_size
from animtool.rig.skeleton import Rig
from animtool.scene.bake.bake import run_stage
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.plan import plan_stage
from animtool.scene.bake.prims import BakePlan
from animtool.scene.bake.reading import Source, source_file
from animtool.scene.sources.open import OpenTake, source_stem
from animtool.sim.trials.trial import (
    CostMeasure,
    ErrorMeasure,
    PointDistances,
    Setting,
    Snapshot,
    Trial,
    TrialOutcome,
    points_extent,
)
from animtool.usd.layers.jobs import UsdResult
from animtool.usd.rigs.skinned import usdskel_world

# Sample rates relative to the source's. A sampled source is exact at its own rate.
CURVE_RATES = (Fraction(1, 4), Fraction(1, 2), Fraction(1), Fraction(2), Fraction(4))
SAMPLE_RATES = (Fraction(1, 8), Fraction(1, 4), Fraction(1, 2), Fraction(1))
# Tolerances relative to the size of the skeleton, rounded down to a power of ten.
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5)
# Compared times per frame of a curve; at the highest rate, one is between two samples.
CURVE_TIMES_PER_FRAME = 8
# Maximum number of compared times, so that UsdSkel evaluates them in about a second;
# and of compared points.
MAX_COMPARED_TIMES, MAX_COMPARED_POINTS = 4000, 2_000_000

RATE, SAMPLES, KEYS = "rate", "samples", "keys"
SOURCE_SETTING = Setting("source", ())  # the take itself in float64


def take_trials(source: Source, options: BakeOptions | None = None) -> list[Trial]:
    """Return the trials of a take as USD samples and as keys.

    Stages are written to a temporary folder and evaluated by UsdSkel, including
    rounding and interpolation. A clip is also compared between frames, with its curves;
    a sampled source is compared at its samples.
    """
    options, path = options or BakeOptions(), source_file(source)
    plan = plan_stage(source, STDOUT, options)
    if plan.options.deform:
        message = argument("table")
        message += " measures joints, but the scene writes deformed points"
        raise OptionError(Fault("CLI002", message, str(path)))
    if not plan.takes:
        message = f"is simulated, but {argument('table')} measures joints"
        raise OptionError(Fault("SCN062", message, str(path)))
    stream = plan.takes[0].stream
    is_curved = stream.curve is not None and not stream.is_altered
    take = _in_range(stream.collect(), plan)
    rate = plan.options.fps or take.clock.rate
    reference = _ReferencePoints.of(take, rate, is_curved=is_curved)
    frames = plan.options.frame_range
    step = 1 if frames is None else frames.step
    rate /= step  # every second frame of the output is half its rate

    def reopen_source() -> Source:
        # Results of passes are computed once.
        stream = TakeStream.of(take)
        if is_curved:
            stream = replace(stream, is_altered=False, count=take.clock.count)
        return OpenTake(path, stream)

    sample_trial = _sample_trial(
        path, reopen_source, plan, take, reference, rate, is_curved=is_curved
    )
    notices = [n.in_file(path) for n in (*plan.notices, *take.notices)]
    output_take = take if step == 1 else resampled(take, rate)
    key_trial = _key_trial(path, output_take, dict(options.reduce_at))
    return [
        replace(sample_trial, notices=tuple(dict.fromkeys(notices))),
        key_trial,
    ]


def _in_range(take: Take, plan: BakePlan) -> Take:
    """Return the frames of a take that are inside the range of the output."""
    frames, clock = plan.options.frame_range, take.clock
    if frames is None:
        return take
    # Time codes of the take per frame of the output.
    codes_per_frame = clock.fps / plan.fps
    first, last = (
        float(clock.start + (frame - plan.start) * codes_per_frame)
        for frame in (frames.first, frames.last)
    )
    start, end = (clock.start + index * clock.step for index in (0, clock.count - 1))
    if first > end or last < start:
        fault = missing_frames_fault(
            frames,
            *(plan.start + (t - clock.start) / codes_per_frame for t in (start, end)),
        )
        raise OptionError(fault.in_file(plan.takes[0].source))
    return trim(take, max(first, float(clock.start)), last)


@dataclass(frozen=True, slots=True)
class _ReferencePoints:
    """Points attached to the joints of a take at some times, compared with trials."""

    rig: Rig
    seconds: FloatArray  # times since the first frame (T,) [s]
    snapshots: list[Snapshot]  # the points at each time

    @staticmethod
    def of(take: Take, rate: Fraction, *, is_curved: bool) -> _ReferencePoints:
        """Return the points of a take at the times that are compared.

        ``rate`` [frame/s] is the highest rate of samples to compare with.
        """
        clock = take.clock
        curve = take.curve if is_curved else None
        # For a curve there are also instants between two samples at the highest rate.
        times_per_frame = math.ceil(
            CURVE_TIMES_PER_FRAME * max(Fraction(1), rate / clock.rate)
        )
        compared_per_frame = times_per_frame if curve is not None else 1
        time_count = (clock.count - 1) * compared_per_frame + 1
        point_count = attached_points(take.rig, SHELL_DISTANCE)[..., 0].size
        compared_count = min(
            time_count,
            MAX_COMPARED_TIMES,
            max(2, MAX_COMPARED_POINTS // max(point_count, 1)),
        )
        frame_indices = np.unique(
            np.linspace(0, time_count - 1, compared_count).astype(np.int64)
        )
        frames = frame_indices / compared_per_frame
        motion: Motion
        if curve is None:
            motion = take.motion.select(frame_indices)
        else:
            motion = curve(float(clock.start) + frames * float(clock.step))
        snapshots = _attached_snapshots(take.rig, motion.world(take.rig))
        return _ReferencePoints(take.rig, frames / float(clock.rate), snapshots)

    def point_label(self, snapshot: int, point: int) -> str:
        """Return the joint of a point and the time of a snapshot, as text."""
        joint_count = max(1, len(self.rig.joints))
        points_per_joint = len(self.snapshots[snapshot].points) // joint_count
        joint_name = self.rig.names[point // points_per_joint]
        return f"{joint_name} at {self.seconds[snapshot]:.2f} s"


def _attached_snapshots(rig: Rig, world: WorldTransforms) -> list[Snapshot]:
    """Return, for each time, the points rigidly attached to the joints."""
    offsets = attached_points(rig, SHELL_DISTANCE)
    snapshots = []
    for positions, linear in zip(world.positions, world.linear, strict=True):
        points = positions[:, None] + np.einsum("jab,jpb->jpa", linear, offsets)
        snapshots.append(Snapshot(points.reshape(-1, 3)))
    return snapshots


def _tolerances(rig: Rig) -> list[float]:
    """Return tolerances for reduction that suit the rig's size [m]."""
    rig_size = rest_size(rig) or 1.0
    scale = 10.0 ** math.floor(math.log10(rig_size))
    return [float(f"{fraction * scale:.12g}") for fraction in TOLERANCES]


def _sample_trial(
    path: Path,
    reopen_source: Callable[[], Source],
    plan: BakePlan,
    take: Take,
    reference: _ReferencePoints,
    rate: Fraction,
    *,
    is_curved: bool,
) -> Trial:
    """Return the trial of a take as samples in USD, at several rates."""
    bake_options = plan.options
    trial_options = BakeOptions(source=bake_options.source, to_up=bake_options.to_up)
    fps = bake_options.fps if rate in {bake_options.fps, take.clock.rate} else rate
    fractions = CURVE_RATES if is_curved else SAMPLE_RATES
    rate_by_value = {float(rate * fraction): rate * fraction for fraction in fractions}

    def options_for(setting: Setting) -> BakeOptions:
        if setting.method == RATE:
            return replace(trial_options, fps=rate_by_value[setting["fps"]])
        return replace(trial_options, fps=fps, reduce=setting["reduce"])

    def run(setting: Setting) -> TrialOutcome:
        if setting == SOURCE_SETTING:
            return TrialOutcome(0.0, take.clock.count, reference.snapshots)
        with tempfile.TemporaryDirectory() as folder:
            output = Path(folder) / "take.usdc"
            start_time = time.perf_counter()
            plan, result = _write_stage(reopen_source(), output, options_for(setting))
            seconds = time.perf_counter() - start_time
            codes = float(plan.start) + reference.seconds * float(plan.fps)
            world = usdskel_world(output, codes)
        snapshots = _attached_snapshots(reference.rig, world)
        return TrialOutcome(seconds, result.samples, snapshots, bytes=result.bytes)

    def write(setting: Setting, output: Path) -> None:
        _write_stage(reopen_source(), output, options_for(setting))

    current_setting = (
        Setting.of(RATE, fps=float(rate))
        if bake_options.reduce is None
        else Setting.of(SAMPLES, reduce=bake_options.reduce)
    )
    settings = [Setting.of(RATE, fps=value) for value in rate_by_value]
    tolerances = {*_tolerances(take.rig), *filter(None, [bake_options.reduce])}
    settings += [Setting.of(SAMPLES, reduce=t) for t in sorted(tolerances)[::-1]]
    return Trial(
        path.name,
        "samples in USD",
        float(take.clock.duration),
        current_setting,
        lambda: settings,
        lambda: [[SOURCE_SETTING]],
        run,
        ErrorMeasure.LARGEST,
        CostMeasure.BYTES,
        "samples",
        point_label=reference.point_label,
        request_lines=lambda setting: [_scene_text(path, setting, rate_by_value)],
        write=write,
        size=points_extent(reference.snapshots[:1]),
    )


def _scene_text(
    path: Path, setting: Setting, rate_by_value: Mapping[float, Fraction]
) -> str:
    """Return the text that selects a setting in a scene's output or a command."""
    if setting.method == RATE:
        key, value = "fps", str(rate_by_value[setting["fps"]])
    else:
        key, value = "reduce", f"{setting['reduce'] * 1000:g}mm"
    writes_keys = setting.method == KEYS
    if has_kind_suffix(path, "scene"):
        file_text = f"file: {source_stem(path)}.clip.yaml, " if writes_keys else ""
        return f"output: {{{file_text}{key}: {value}}}"
    clip = f"{source_stem(path)}.reduced.clip.yaml"
    command = f"convert {path.name} {clip}" if writes_keys else f"bake {path.name}"
    return f"animtool {command} {argument(key)} {value}"


def _write_stage(
    source: Source, output: Path, options: BakeOptions
) -> tuple[BakePlan, UsdResult]:
    """Write the take of a source to a stage; return the plan and what was written."""
    plan = plan_stage(source, output, replace(options, overwrite=True))
    # Systems next to the take have no joints to measure.
    plan = replace(plan, prims=plan.prims[:1], recorder=None)
    return plan, run_stage(plan).result


def _key_trial(path: Path, take: Take, joint_tolerances: dict[str, float]) -> Trial:
    """Return the trial of a take as keys of a clip."""

    def run(setting: Setting) -> TrialOutcome:
        if setting == SOURCE_SETTING:
            return TrialOutcome(0.0, take.clock.count, [Snapshot(np.zeros((0, 3)))])
        start_time = time.perf_counter()
        tolerance = setting["reduce"]
        reduction = reduce_motion(take, tolerance, joint_tolerances=joint_tolerances)
        seconds = time.perf_counter() - start_time
        seconds_at_worst = reduction.frame / float(take.clock.rate)
        error = PointDistances(reduction.error, reduction.error, reduction.error)
        location = f"{reduction.joint} at {seconds_at_worst:.2f} s"
        return TrialOutcome(seconds, reduction.keys, [], error=error, worst=location)

    default = parse_length(KEY_TOLERANCE)
    tolerances = sorted({*_tolerances(take.rig), default}, reverse=True)
    return Trial(
        path.name,
        "keys of a clip",
        float(take.clock.duration),
        Setting.of(KEYS, reduce=default),
        lambda: [Setting.of(KEYS, reduce=tolerance) for tolerance in tolerances],
        lambda: [[SOURCE_SETTING]],
        run,
        ErrorMeasure.LARGEST,
        CostMeasure.STEPS,
        "keys",
        request_lines=lambda setting: [_scene_text(path, setting, {})],
    )
