"""The bake: a source to a USD animation, planned and then run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault, Severity, refuse_warnings
from animtool.maths.curves import Curves
from animtool.prefetch import prefetch
from animtool.rig.kinematics import rest_size
from animtool.rig.skeleton import Rig
from animtool.scene.frames import moving_joints, timed_blocks
from animtool.scene.options import BakeOptions
from animtool.scene.plan import BakePlan, plan_bake
from animtool.take import Motion
from animtool.usd.animation import WrittenBlock, round_blocks
from animtool.usd.author import UsdJob, UsdResult, author, write_usd
from animtool.usd.names import UsdNames, joint_names, legal_name
from animtool.usd.skeleton import RigPaths

if TYPE_CHECKING:
    from animtool.edit.thin import Thinned

__all__ = ["BakeReport", "bake", "run_bake"]

TimedBlocks = Iterator[tuple[FloatArray, Motion]]


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
        thinned: Which samples were left out, where that was asked for.
        thinned_joint: Name of the joint that this moved most.
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
    thinned: Thinned | None = None
    thinned_joint: str = ""


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


def run_bake(plan: BakePlan) -> BakeReport:
    """Run a planned bake: read, author, write.

    Raises:
        FormatError: The rows of the source are malformed.
        OptionError: The range has no frame of the take.
        OutputError: The output cannot be written.
        StrictError: There were warnings, and ``strict`` is on.
    """
    began = time.perf_counter()
    options, stream = plan.options, plan.stream
    counter = _Counter()
    counted = replace(stream, blocks=counter.count(stream.blocks))
    timed, frames, rest = timed_blocks(plan, counted)
    job, timed, thinned = _job(plan, timed, frames, rest)
    rounded = prefetch(
        counter.time(
            round_blocks(
                timed, job.rig, job.meters_per_unit, root_motion=options.root_motion
            )
        )
    )
    try:
        authored, result = author(job, rounded)
    finally:
        rounded.close()
    seconds = {"read": counter.seconds, "author": time.perf_counter() - began}
    notices = stream.notices + plan.notices + job.names.notices + result.notices
    refuse_warnings(notices, strict=options.strict)
    write_usd(job, authored, result)
    seconds["total"] = time.perf_counter() - began
    seconds["save"] = seconds["total"] - seconds["author"]
    return BakeReport(
        plan.source,
        result,
        f"{plan.form} ({plan.reason})",
        stream.count or counter.frames,
        stream.fps / stream.step,
        plan.fps,
        len(stream.rig.joints),
        job.meters_per_unit,
        job.rig.up.value,
        rest_size(rest),
        job.names.names[result.rounding.joint],
        notices,
        options.source.unit is None and "units" not in stream.details,
        seconds,
        plan.source.stat().st_size,
        stream.details,
        thinned,
        "" if thinned is None else job.rig.names[thinned.joint],
    )


def _job(
    plan: BakePlan,
    timed: TimedBlocks,
    frames: tuple[Fraction, Fraction] | None,
    rig: Rig,
) -> tuple[UsdJob, TimedBlocks, Thinned | None]:
    """Return what the writer is to do, the blocks for it, and what was left out."""
    options, mapping = plan.options, plan.mapping
    meters = rig.meters_per_unit
    chosen = None
    if mapping is not None:
        timed = ((codes, mapping.apply(motion)) for codes, motion in timed)
        rig = mapping.rig
        meters = rig.meters_per_unit
        if (mapping.source < 0).any():
            chosen = mapping.source >= 0
    elif options.to_units is not None:
        meters = options.to_units.meters
    if options.sparse:
        held = list(timed)
        moving = moving_joints(plan, rig, [motion for _, motion in held])
        kept = moving if chosen is None else moving & chosen
        chosen, timed = kept if kept.any() else chosen, iter(held)
    thinned = None
    if options.reduce is not None:
        timed, thinned, frames = _thinned(plan, timed, frames, rig, options.reduce)
    names, joints, paths = _usd_places(plan, rig)
    job = UsdJob(
        form=plan.form,
        output=plan.output,
        rig=rig,
        names=names,
        joints=joints,
        paths=paths,
        fps=plan.fps,
        frames=frames,
        start=plan.start,
        step=plan.stream.step * plan.fps / plan.stream.fps,
        meters_per_unit=meters,
        target=plan.target,
        chosen=chosen,
        bones=options.bones,
        shapes=tuple(shape.name for shape in plan.stream.rig.shapes),
        curves=_kept_curves(plan) if options.keep_curves else {},
    )
    return job, timed, thinned


def _thinned(
    plan: BakePlan,
    timed: TimedBlocks,
    frames: tuple[Fraction, Fraction] | None,
    rig: Rig,
    tolerance: float,
) -> tuple[TimedBlocks, Thinned, tuple[Fraction, Fraction]]:
    """Return the samples that are needed, what that does, first and last frame."""
    from animtool.edit.thin import thin_samples

    held = list(timed)
    codes = np.concatenate([codes for codes, _ in held])
    motion = Motion.concatenate([motion for _, motion in held])
    found = thin_samples(
        rig, codes, motion, tolerance, joint_tolerances=dict(plan.options.reduce_at)
    )
    if frames is None:
        step = plan.stream.step * plan.fps / plan.stream.fps
        frames = plan.start, plan.start + step * (len(codes) - 1)
    kept = iter([(codes[found.kept], motion.select(found.kept))])
    return kept, found, frames


def _kept_curves(plan: BakePlan) -> dict[str, Curves]:
    """Return the curves of controls over the output's time codes."""
    stream = plan.stream
    if not stream.control_curves:
        message = "there is no control whose curve could be kept"
        hint = "clips have such curves; a pass that changes a control drops its curve"
        plan.notices.append(
            Fault("CLI102", message, str(plan.source), (), hint, Severity.WARNING)
        )
    start = float(Fraction(1) if stream.start is None else stream.start)
    ratio = float(plan.fps / stream.fps)
    return {
        name: curves.retimed(start, ratio, float(plan.start))
        for name, curves in stream.control_curves.items()
    }


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


def _usd_places(plan: BakePlan, rig: Rig) -> tuple[UsdNames, list[str], RigPaths]:
    """Return USD names of the joints, their paths, and the character's prims."""
    if plan.target is not None:
        names = UsdNames(rig.names, {}, [])
        return names, plan.target.skeleton.tokens, plan.target.paths
    names = joint_names(rig.joints, plan.options.strip_namespace)
    notices = [replace(fault, path=str(plan.source)) for fault in names.notices]
    names = replace(names, notices=notices)
    model = plan.options.prim_path or f"/{legal_name(rig.name)}"
    return names, rig.paths(names.names), RigPaths.below(model)
