"""The bake: a source to a USD animation, planned and then run."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault, Severity, refuse_warnings
from animtool.maths.curves import Curves
from animtool.motion import Motion
from animtool.output import size_of, together
from animtool.prefetch import prefetch
from animtool.rig.kinematics import rest_size
from animtool.rig.skeleton import Rig
from animtool.scene.frames import TimedTake, moving_joints, timed_blocks
from animtool.scene.options import BakeOptions
from animtool.scene.plan import BakePlan, plan_bake, rig_paths
from animtool.scene.progress import Progress, share_of
from animtool.scene.reading import Source
from animtool.scene.report import BakeReport, TakeReport
from animtool.scene.sources import (
    Opener,
    motion_bytes,
    open_source,
    source_stem,
)
from animtool.scene.take_plan import TakePlan
from animtool.usd.animation import WrittenBlock, round_blocks
from animtool.usd.author import author, write_usd
from animtool.usd.forms import Form
from animtool.usd.jobs import UsdJob, UsdTake, WrittenTake
from animtool.usd.names import UsdNames, joint_names
from animtool.usd.paths import RigPaths

if TYPE_CHECKING:
    from animtool.edit.thin import Thinned
    from animtool.scene.systems.character_watch import CharacterWatch
    from animtool.scene.systems.with_take import WrittenSystems

TimedBlocks = Iterator[tuple[FloatArray, Motion]]


def bake(
    source: Source | Sequence[Source],
    output: Path | str | None,
    options: BakeOptions | None = None,
    *,
    progress: Progress = None,
    opener: Opener = open_source,
) -> BakeReport:
    """Bake a BVH, USD file, clip or scene to a USD animation, or several to a library.

    Args:
        source: The file to read, or a scene that is loaded already; or several, each to
            be a take of a clip library.
        output: The file to write, ``.usda``, ``.usdc`` or ``.usd``; None writes
            usda to stdout.
        options: How.
        progress: Called with the share done, 0 to 1.
        opener: What opens the sources, called as `animtool.open_source`.

    Raises:
        FormatError: A source is malformed, or the takes of a library have other
            joints.
        OptionError: An option makes no sense, or the output exists.
        OutputError: The output cannot be written.
        StrictError: There were warnings, and ``strict`` is on.
    """
    # Passes may keep states as soon as a source is opened.
    with together():
        plan = plan_bake(source, output, options, progress=progress, opener=opener)
        return run_bake(plan, progress=progress)


def run_bake(plan: BakePlan, *, progress: Progress = None) -> BakeReport:
    """Run a planned bake: read, author, write.

    Args:
        plan: Sources that are open tell their progress themselves.
        progress: Called with the share of systems done, 0 to 1.

    Raises:
        FormatError: The rows of a source are malformed.
        OptionError: The range has no frame of the take.
        OutputError: The output cannot be written.
        StrictError: There were warnings, and ``strict`` is on.
    """
    with together():
        return _run_bake(plan, progress)


def _run_bake(plan: BakePlan, progress: Progress) -> BakeReport:
    if plan.systems is not None:
        from animtool.scene.systems.bake import run_system_bake

        return run_system_bake(plan.systems, progress=progress)
    if plan.character is not None:
        from animtool.scene.point_bake import run_point_bake

        return run_point_bake(plan, plan.character, progress=progress)
    began = time.perf_counter()
    watch = None if plan.with_take is None else plan.with_take.watch
    runs = [_TakeRun(take, watch) for take in plan.takes]
    rest = runs[0].open()
    job = _job(plan, rest)
    with closing(_usd_takes(runs, job)) as takes:
        authored, result = author(job, takes)
    if plan.form is Form.LIBRARY and plan.target is not None:
        from animtool.usd.library_merge import merged_library

        authored.animation = merged_library(
            plan.target.path, authored.animation, job.paths, plan.takes[0].name
        )
    read = sum(run.seconds for run in runs)
    seconds = {"read": read, "author": time.perf_counter() - began}
    notices = [notice for take in plan.takes for notice in take.stream.notices]
    notices += plan.notices + job.names.notices + result.notices
    refuse_warnings(notices, strict=plan.options.strict)
    systems = plan.finish(
        authored.animation,
        lambda save: write_usd(job, authored, result, save),
        share_of(progress, 1, 2),
    )
    if systems is not None:
        notices += systems.notices
        result.outputs[:0] = systems.files
        result.bytes += sum(map(size_of, systems.files))
    seconds["total"] = time.perf_counter() - began
    seconds["save"] = seconds["total"] - seconds["author"]
    return BakeReport(
        [
            run.report(job, written, systems)
            for run, written in zip(runs, result.takes, strict=True)
        ],
        result,
        f"{plan.form} ({plan.reason})",
        len(plan.takes[0].stream.rig.joints),
        job.meters_per_unit,
        job.rig.up.value,
        rest_size(rest),
        notices,
        seconds,
        plan.options.shot,
    )


def _job(plan: BakePlan, rest: Rig) -> UsdJob:
    """Return what the writer is to do with every take."""
    mapping = plan.takes[0].mapping
    rig = rest if mapping is None else mapping.rig
    meters = rig.meters_per_unit
    if mapping is None and plan.options.to_units is not None:
        meters = plan.options.to_units.meters
    names, joints, paths = _usd_places(plan, rig)
    return UsdJob(
        form=_form(plan),
        output=plan.output,
        rig=rig,
        names=names,
        joints=joints,
        paths=paths,
        fps=plan.fps,
        meters_per_unit=meters,
        target=plan.target,
        bones=plan.options.bones,
        shot=None if plan.form is Form.LIBRARY else plan.options.shot,
    )


def _form(plan: BakePlan) -> Form:
    """Return what is authored: of a library that is there, a layer over it."""
    if plan.form is not Form.LIBRARY:
        return plan.form
    return Form.STAGE if plan.target is None else Form.LAYER


def _usd_takes(runs: Sequence[_TakeRun], job: UsdJob) -> Generator[UsdTake]:
    """Yield every take, made ready when the writer comes to it."""
    for run in runs:
        take, timed = run.prepare(job.rig)
        rounded = prefetch(
            run.time(
                round_blocks(
                    timed,
                    job.rig,
                    job.meters_per_unit,
                    root_motion=run.plan.options.root_motion,
                )
            )
        )
        try:
            yield replace(take, blocks=rounded)
        finally:
            rounded.close()


class _TakeRun:
    """One take on its way from its source to the writer.

    Attributes:
        plan: Of the take.
        frames: Frames of the source that were read.
        seconds: How long making blocks took.
        thinned: Which samples were left out, where that was asked for.
    """

    def __init__(self, plan: TakePlan, watch: CharacterWatch | None = None) -> None:
        self.plan = plan
        self._watch = watch
        self.frames = 0
        self.seconds = 0.0
        self.thinned: Thinned | None = None
        self._opened: TimedTake | None = None

    def open(self) -> Rig:
        """Return the rig at rest, with the source's frames at the output's times."""
        stream = self.plan.stream
        counted = replace(stream, blocks=self._counted(stream.blocks))
        if self._watch is None:
            self._opened = timed_blocks(self.plan, counted)
        else:
            opened = timed_blocks(self.plan, self._watch.read(counted))
            watched = self._watch.written(opened.blocks)
            self._opened = replace(opened, blocks=watched)
        return self._opened.rig

    def prepare(self, rig: Rig) -> tuple[UsdTake, TimedBlocks]:
        """Return what the writer is told of the take, and its frames.

        Args:
            rig: As it is written: of the rig layer, or of the first take.
        """
        if self._opened is None:
            self.open()
        assert self._opened is not None
        timed, frames = self._opened.blocks, self._opened.frames
        plan, options, mapping = self.plan, self.plan.options, self.plan.mapping
        chosen, props = None, None
        if plan.stream.tracks:
            from animtool.usd.author_props import PropSamples

            props = PropSamples(plan.stream.tracks)
            timed = props.watched(timed)
        if mapping is not None:
            mapped = mapping
            timed = ((codes, mapped.apply(motion)) for codes, motion in timed)
            if (mapping.source < 0).any():
                chosen = mapping.source >= 0
        if options.sparse:
            held = list(timed)
            moving = moving_joints(plan, rig, [motion for _, motion in held])
            kept = moving if chosen is None else moving & chosen
            chosen, timed = kept if kept.any() else chosen, iter(held)
        step = plan.stream.step * plan.fps / plan.stream.fps
        if options.reduce is not None:
            timed, self.thinned, frames = _thinned(plan, timed, frames, rig, step)
        take = UsdTake(
            (),
            plan.start,
            step,
            frames=frames,
            chosen=chosen,
            shapes=_shape_names(plan),
            curves=_kept_curves(plan) if options.keep_curves else {},
            name=plan.name,
            source_name=source_stem(plan.source),
            props=props,
        )
        return take, timed

    def report(
        self, job: UsdJob, written: WrittenTake, systems: WrittenSystems | None
    ) -> TakeReport:
        """Return what became of the take, and of what is simulated beside it."""
        plan, stream, thinned = self.plan, self.plan.stream, self.thinned
        times = None if self._opened is None else self._opened.times
        return TakeReport(
            plan.source,
            written,
            stream.count or self.frames,
            stream.fps / stream.step,
            job.names.names[written.rounding.joint] if job.names.names else "",
            plan.options.source.unit is None and "units" not in stream.details,
            motion_bytes(plan.source),
            stream.details,
            thinned,
            job.rig.names[thinned.joint] if thinned and job.rig.names else "",
            meshes=[] if systems is None else systems.reports,
            simulated=stream.simulated + ([] if systems is None else systems.simulated),
            between=0 if times is None else times.between,
        )

    def time(self, blocks: Iterator[WrittenBlock]) -> Iterator[WrittenBlock]:
        """Count the seconds that making blocks takes."""
        while True:
            began = time.perf_counter()
            block = next(blocks, None)
            self.seconds += time.perf_counter() - began
            if block is None:
                return
            yield block

    def _counted(self, blocks: Iterator[Motion]) -> Iterator[Motion]:
        for block in blocks:
            self.frames += block.frames
            yield block


def _thinned(
    plan: TakePlan,
    timed: TimedBlocks,
    frames: tuple[Fraction, Fraction] | None,
    rig: Rig,
    step: Fraction,
) -> tuple[TimedBlocks, Thinned, tuple[Fraction, Fraction]]:
    """Return the samples that are needed, what that does, first and last frame."""
    from animtool.edit.thin import thin_samples

    held = list(timed)
    codes = np.concatenate([codes for codes, _ in held])
    motion = Motion.concatenate([motion for _, motion in held])
    tolerance = plan.options.reduce
    assert tolerance is not None
    found = thin_samples(
        rig, codes, motion, tolerance, joint_tolerances=dict(plan.options.reduce_at)
    )
    if frames is None:
        frames = plan.start, plan.start + step * (len(codes) - 1)
    kept = iter([(codes[found.kept], motion.select(found.kept))])
    return kept, found, frames


def _shape_names(plan: TakePlan) -> tuple[str, ...]:
    """Return the take's shapes as the output has them."""
    if plan.mapping is not None:
        return plan.mapping.shapes
    return tuple(shape.name for shape in plan.stream.rig.shapes)


def _kept_curves(plan: TakePlan) -> dict[str, Curves]:
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


def _usd_places(plan: BakePlan, rig: Rig) -> tuple[UsdNames, list[str], RigPaths]:
    """Return USD names of the joints, their paths, and the character's prims."""
    called = [take.stream.rig.name for take in plan.takes]
    paths = rig_paths(called, plan.target, plan.options, plan.output)
    if plan.target is not None:
        return plan.target.names, plan.target.skeleton.tokens, paths
    names = joint_names(rig.joints, plan.options.strip_namespace)
    where = str(plan.takes[0].source)
    names = replace(
        names, notices=[replace(fault, path=where) for fault in names.notices]
    )
    return names, rig.paths(names.names), paths
