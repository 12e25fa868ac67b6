"""The bake: a source to a USD animation, planned and then run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from animtool._types import BoolArray, FloatArray
from animtool.config import find_config
from animtool.edit.reorient import reorient
from animtool.edit.resample import FrameRange, SampleTimes, plan_samples, sample
from animtool.errors import Fault, OptionError, Severity, StrictError
from animtool.output import check_outputs
from animtool.prefetch import prefetch
from animtool.rates import rate_label
from animtool.rig.kinematics import rest_size
from animtool.rig.skeleton import Rig
from animtool.scene.options import BakeOptions, check_options
from animtool.scene.sources import open_source
from animtool.take import Motion, Take, TakeStream, time_codes
from animtool.usd.animation import WrittenBlock, round_blocks
from animtool.usd.layers import check_prim_path, check_suffix
from animtool.usd.names import UsdNames, joint_names, legal_name
from animtool.usd.skeleton import RigPaths
from animtool.usd.write import Form, UsdJob, UsdResult, author, output_paths, write_usd

if TYPE_CHECKING:
    from animtool.usd.target import JointMap, RigTarget

__all__ = ["BakePlan", "BakeReport", "bake", "plan_bake", "run_bake"]


@dataclass(frozen=True, slots=True)
class BakePlan:
    """A bake that is ready to run.

    Attributes:
        source: The file.
        output: The file to write; None is stdout.
        options: As given.
        stream: The source, opened.
        form: Stage, split or layer.
        reason: Why that form.
        target: The rig of a layer.
        mapping: How the take's joints stand in it.
        fps: Time codes a second of the output.
        start: Time code of the first frame.
        notices: What is odd so far.
    """

    source: Path
    output: Path | None
    options: BakeOptions
    stream: TakeStream
    form: Form
    reason: str
    target: RigTarget | None
    mapping: JointMap | None
    fps: Fraction
    start: Fraction
    notices: list[Fault]


@dataclass(slots=True)
class BakeReport:
    """What a bake did.

    Attributes:
        source: The file read.
        result: What was written.
        form: Stage, split or layer, and why.
        source_frames: Frames of the source.
        source_fps: Its frame rate.
        fps: Time codes a second of the output.
        joints: Joints of the source.
        meters_per_unit: Unit of the output [m].
        up: Its up axis.
        size: Extent of the skeleton at rest [m].
        error_joint: Name of the joint that rounding moved most.
        notices: Warnings and notes.
        unit_assumed: Whether nothing states the unit of the source.
        seconds: Wall time by stage; ``read`` runs beside ``author``.
        source_bytes: Size of the source.
        details: What the source states of itself.
    """

    source: Path
    result: UsdResult
    form: str
    source_frames: int
    source_fps: Fraction
    fps: Fraction
    joints: int
    meters_per_unit: float
    up: str
    size: float
    error_joint: str
    notices: list[Fault]
    unit_assumed: bool = False
    seconds: dict[str, float] = field(default_factory=dict)
    source_bytes: int = 0
    details: dict[str, object] = field(default_factory=dict)


def bake(
    source: Path | str,
    output: Path | str | None,
    options: BakeOptions | None = None,
    *,
    progress: Callable[[float], None] | None = None,
) -> BakeReport:
    """Bake a BVH or USD file to a USD animation.

    Args:
        source: The file to read.
        output: The file to write, ``.usda``, ``.usdc`` or ``.usd``; None writes
            usda to stdout.
        options: How.
        progress: Called with the share done, 0 to 1.

    Raises:
        FormatError: The source is malformed.
        OptionError: An option makes no sense, or the output exists.
        OutputError: The output cannot be written.
        StrictError: There were warnings, and ``strict`` is on.
    """
    plan = plan_bake(source, output, options, progress=progress)
    return run_bake(plan)


def plan_bake(
    source: Path | str,
    output: Path | str | None,
    options: BakeOptions | None = None,
    *,
    progress: Callable[[float], None] | None = None,
) -> BakePlan:
    """Check everything that can be checked before the work, and open the source.

    Raises:
        FormatError: The header of the source, or the rig layer, is malformed.
        OptionError: An option makes no sense, or the output exists.
        OutputError: The output cannot be written.
    """
    options = options or BakeOptions()
    source = Path(source)
    path = None if output is None else Path(output)
    check_options(options, to_stdout=path is None)
    form = Form(options.form or (Form.LAYER if options.rig_layer else Form.STAGE))
    if path is not None:
        check_suffix(path)
        inputs = [source] + ([options.rig_layer] if options.rig_layer else [])
        check_outputs(output_paths(path, form), inputs, overwrite=options.overwrite)
    stream = open_source(source, options.source, progress=progress)
    target = mapping = None
    notices: list[Fault] = []
    reason = "a rig layer was named" if options.form is None else "asked for"
    if options.rig_layer is not None:
        from animtool.usd.target import map_joints, open_target

        target = open_target(options.rig_layer, options.prim_path)
        stream = reorient(stream, target.skeleton.rig.up)
        mapping = map_joints(stream.rig, target, options.strip_namespace)
        notices += target.notices + mapping.notices
    else:
        if options.prim_path is not None:
            check_prim_path(options.prim_path)
        if options.form is None:
            reason = "no rig layer was named"
        stream = reorient(stream, options.to_up or stream.rig.up)
    fps = options.fps or (target.fps if target else stream.fps)
    if target is not None and fps != target.fps:
        theirs = rate_label(target.fps)
        message = f"--fps {float(fps):g} is not the rig layer's rate, {theirs}"
        hint = "USD stretches time where a sublayer's rate is not its stage's"
        notices.append(
            Fault("USD106", message, str(target.path), (), hint, Severity.WARNING)
        )
    start = _start(options, target, stream, source)
    return BakePlan(
        source,
        path,
        options,
        stream,
        form,
        reason,
        target,
        mapping,
        fps,
        start,
        notices,
    )


def _start(
    options: BakeOptions, target: RigTarget | None, stream: TakeStream, source: Path
) -> Fraction:
    """Return the first frame: asked for, the shot's, the source's, the project's, 1."""
    if options.start is not None:
        return options.start
    if target is not None and target.start is not None:
        return target.start
    if stream.start is not None:
        return stream.start
    configured = find_config(source).start
    return Fraction(1) if configured is None else configured


def run_bake(plan: BakePlan) -> BakeReport:
    """Run a planned bake: read, author, write.

    Raises:
        FormatError: The rows of the source are malformed.
        OptionError: The range has no frame of the take.
        OutputError: The output cannot be written.
        StrictError: There were warnings, and ``strict`` is on.
    """
    began = time.perf_counter()
    options, stream, target = plan.options, plan.stream, plan.target
    counter = _Counter()
    counted = replace(stream, blocks=counter.count(stream.blocks))
    timed, frames, rig = _timed_blocks(plan, counted)
    size = rest_size(rig)

    meters = rig.meters_per_unit
    if plan.mapping is not None and target is not None:
        mapping = plan.mapping
        timed = ((codes, mapping.apply(motion)) for codes, motion in timed)
        rig = mapping.rig
        meters = rig.meters_per_unit
    elif options.to_units is not None:
        meters = options.to_units.meters
    chosen = None
    if plan.mapping is not None and (plan.mapping.source < 0).any():
        chosen = plan.mapping.source >= 0
    if options.sparse:
        held = list(timed)
        moving = _moving(plan, rig, [motion for _, motion in held])
        chosen, timed = moving if chosen is None else moving & chosen, iter(held)

    names, joints, paths = _usd_places(plan, rig)
    step = stream.step * plan.fps / stream.fps
    job = UsdJob(
        plan.form,
        plan.output,
        rig,
        names,
        joints,
        paths,
        plan.fps,
        frames,
        plan.start,
        step,
        meters,
        target,
        chosen,
        options.bones,
    )
    rounded = prefetch(
        counter.time(round_blocks(timed, rig, meters, root_motion=options.root_motion))
    )
    try:
        authored, result = author(job, rounded)
    finally:
        rounded.close()
    author_seconds = time.perf_counter() - began
    notices = stream.notices + plan.notices + names.notices + result.notices
    if options.strict:
        warnings = [n for n in notices if n.severity is Severity.WARNING]
        if warnings:
            raise StrictError(warnings)
    write_usd(job, authored, result)
    total = time.perf_counter() - began
    return BakeReport(
        plan.source,
        result,
        f"{plan.form} ({plan.reason})",
        counter.frames,
        stream.fps / stream.step,
        plan.fps,
        len(stream.rig.joints),
        meters,
        rig.up.value,
        size,
        names.names[result.rounding.joint],
        notices,
        options.source.unit is None and "units" not in stream.details,
        {
            "read": counter.seconds,
            "author": author_seconds,
            "save": total - author_seconds,
            "total": total,
        },
        plan.source.stat().st_size,
        stream.details,
    )


class _Counter:
    """Counts the frames of the source, and the seconds that making blocks takes."""

    def __init__(self) -> None:
        self.frames = 0
        self.seconds = 0.0

    def count(self, blocks: Iterator[Motion]) -> Iterator[Motion]:
        for block in blocks:
            self.frames += block.frames
            yield block

    def time(self, blocks: Iterator[WrittenBlock]) -> Iterator[WrittenBlock]:
        while True:
            began = time.perf_counter()
            block = next(blocks, None)
            self.seconds += time.perf_counter() - began
            if block is None:
                return
            yield block


def _timed_blocks(
    plan: BakePlan, stream: TakeStream
) -> tuple[Iterator[tuple[FloatArray, Motion]], tuple[Fraction, Fraction] | None, Rig]:
    """Return time codes with motions, first and last frame, and the rig at rest.

    The blocks stream through where each sample of the source is a sample of the
    output; otherwise the take is gathered and sampled anew.
    """
    options = plan.options
    as_is = (
        plan.fps == stream.fps
        and not options.samples
        and options.frame_range is None
        and options.rest_frame is None
    )
    if as_is:
        return _streamed(plan, stream), None, stream.rig
    take = stream.collect()
    times = _sample_times(plan, take, options.frame_range)
    plan.notices.extend(_cut_notice(plan, times))
    rig = take.rig
    if options.rest_frame is not None:
        rig = _with_rest(plan, take, options.rest_frame)
    return sample(take, times), (times.first, times.last), rig


def _streamed(
    plan: BakePlan, stream: TakeStream
) -> Iterator[tuple[FloatArray, Motion]]:
    done = 0
    for block in stream.blocks:
        first = plan.start + done * stream.step
        yield time_codes(first, stream.step, block.frames), block
        done += block.frames


def _sample_times(
    plan: BakePlan, take: Take, frame_range: FrameRange | None
) -> SampleTimes:
    options = plan.options
    try:
        return plan_samples(
            take.clock,
            plan.fps,
            plan.start,
            frame_range=frame_range,
            offsets=options.samples,
            keep_samples=options.keep_samples,
        )
    except ValueError as error:
        raise OptionError(Fault("CLI005", str(error), str(plan.source))) from error


def _cut_notice(plan: BakePlan, times: SampleTimes) -> list[Fault]:
    """Say so where a range reaches beyond the take."""
    wanted = plan.options.frame_range
    if wanted is None or plan.options.keep_samples:
        return []
    last = wanted.last - (wanted.last - wanted.first) % wanted.step
    if times.first == wanted.first and times.last == last:
        return []
    message = (
        f"--range {wanted.first}-{wanted.last} reaches beyond the take; "
        f"{float(times.first):g} to {float(times.last):g} are written"
    )
    return [Fault("CLI101", message, str(plan.source), severity=Severity.WARNING)]


def _with_rest(plan: BakePlan, take: Take, frame: int) -> Rig:
    """Return the rig with a frame of the take as its rest pose."""
    try:
        times = plan_samples(
            take.clock, plan.fps, plan.start, frame_range=FrameRange(frame, frame)
        )
    except ValueError as error:
        message = str(error).replace("--range", "--rest frame:N")
        raise OptionError(Fault("CLI005", message, str(plan.source))) from error
    ((_, pose),) = sample(take, times)
    translations = pose.translations.dense()[0].tolist()
    rotations = pose.rotations.dense()[0].tolist()
    joints = tuple(
        replace(joint, translation=tuple(t), rotation=tuple(r))
        for joint, t, r in zip(take.rig.joints, translations, rotations, strict=True)
    )
    return replace(take.rig, joints=joints)


def _moving(plan: BakePlan, rig: Rig, motions: list[Motion]) -> BoolArray:
    """Return which joints are not at the rig's rest in every frame ``(J,)``."""
    moving = np.zeros(len(rig.joints), bool)
    ones = np.ones((len(rig.joints), 3))
    if plan.mapping is not None:
        ones = plan.mapping.rest_scales
    for motion in motions:
        channels = [
            (motion.translations, rig.rest_translations),
            (motion.rotations, rig.rest_rotations),
        ]
        if motion.scales is not None:
            channels.append((motion.scales, ones))
        for channel, rest in channels:
            moving |= (channel.rest != rest).any(axis=-1)
            moving[channel.animated] |= (channel.values != rest[channel.animated]).any(
                axis=(0, 2)
            )
    if plan.options.root_motion:
        # The SkelRoot carries it; with several roots the others are relative to it.
        moving[rig.roots[0]] = False
        moving[rig.roots[1:]] = True
    if not moving.any():
        moving[rig.roots[0]] = True
    return moving


def _usd_places(plan: BakePlan, rig: Rig) -> tuple[UsdNames, list[str], RigPaths]:
    """Return USD names of the joints, their paths, and the character's prims."""
    if plan.target is not None:
        names = UsdNames(rig.names, {}, [])
        return names, plan.target.skeleton.tokens, plan.target.paths
    names = joint_names(rig.joints, plan.options.strip_namespace)
    model = plan.options.prim_path or f"/{legal_name(rig.name)}"
    for fault in names.notices:
        placed = replace(fault, path=str(plan.source))
        names.notices[names.notices.index(fault)] = placed
    return names, rig.paths(names.names), RigPaths.below(model)
