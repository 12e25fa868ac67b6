"""Takes as SkelAnimation prims: jobs of the writer and reports of takes."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import closing
from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from animtool.core.errors import warning
from animtool.maths.curves import Curves
from animtool.motion.motion import Motion, TimedBlocks
from animtool.rig.kinematics import rest_size
from animtool.rig.skeleton import Rig
from animtool.scene.bake.frames import BakedTake, TakePlan, moving_joints
from animtool.scene.bake.prims import (
    BakePlan,
    BakeState,
    TakeReport,
    take_report,
)
from animtool.scene.bake.progress import prefetch, timed_items
from animtool.scene.sources.open import source_stem
from animtool.usd.layers.jobs import LayerForm, UsdJob, UsdTake, WrittenTake
from animtool.usd.layers.names import UsdNames, joint_names
from animtool.usd.rigs.skeleton import build_rest_metadata
from animtool.usd.takes.author import author, write_usd
from animtool.usd.takes.joint_writer import round_blocks

if TYPE_CHECKING:
    from animtool.edit.thin import ThinnedSamples


class JointPrims:
    """SkelAnimation prims of takes and, without a rig layer, their Skeleton."""

    def author(self, state: BakeState) -> None:
        """Author the layers of every take in memory, and set the report."""
        plan = state.plan
        rest_rig = state.baked_takes[0].rig
        job = _usd_job(plan, rest_rig)
        takes = [_JointTake(baked_take) for baked_take in state.baked_takes]
        with closing(_usd_takes(takes, job)) as usd_takes:
            authored_layers, result = author(job, usd_takes)
        if plan.form is LayerForm.LIBRARY and plan.target is not None:
            from animtool.usd.takes.library import merge_take

            authored_layers.animation = merge_take(
                plan.target.path,
                authored_layers.animation,
                job.paths,
                plan.takes[0].name,
            )
        notices = [notice for take in plan.takes for notice in take.stream.notices]
        notices += plan.notices + job.names.notices + result.notices
        state.layer = authored_layers.animation
        state.write_files = partial(write_usd, job, authored_layers, result)
        state.read_seconds += [take.seconds["read"] for take in takes]
        written_takes = zip(takes, result.takes, strict=True)
        state.report = plan.report(
            [take.report(job, written_take) for take, written_take in written_takes],
            result,
            notices,
            joints=len(plan.takes[0].stream.rig.joints),
            size=rest_size(rest_rig),
            meters_per_unit=job.meters_per_unit,
            up=job.rig.up,
        )


def _usd_job(plan: BakePlan, rest_rig: Rig) -> UsdJob:
    """Return the settings with which the USD writer authors every take."""
    joint_map = plan.takes[0].joint_map
    rig = rest_rig if joint_map is None else joint_map.rig
    names, joints = _usd_names(plan, rig)
    form = plan.form
    if form is LayerForm.LIBRARY:
        # A layer over an existing library adds takes to it.
        form = LayerForm.STAGE if plan.target is None else LayerForm.LAYER
    return UsdJob(
        form=form,
        output=plan.output,
        rig=rig,
        names=names,
        joints=joints,
        paths=plan.paths,
        fps=plan.fps,
        meters_per_unit=plan.meters_per_unit,
        target=plan.target,
        show_bones=plan.options.bones,
        shot=None if plan.form is LayerForm.LIBRARY else plan.options.shot,
    )


def _usd_names(plan: BakePlan, rig: Rig) -> tuple[UsdNames, list[str]]:
    """Return the USD names of the joints, and their paths as joint tokens."""
    if plan.target is not None:
        return plan.target.names, plan.target.skeleton.tokens
    names = joint_names(rig.joints, plan.options.strip_namespace)
    path = str(plan.takes[0].source)
    notices = [replace(fault, path=path) for fault in names.notices]
    return replace(names, notices=notices), rig.paths(names.names)


def _usd_takes(takes: list[_JointTake], job: UsdJob) -> Generator[UsdTake]:
    """Yield takes for the writer; each is prepared on demand."""
    for take in takes:
        usd_take, blocks = take.prepare(job.rig)
        joint_map = take.plan.joint_map
        rounded_blocks = round_blocks(
            blocks,
            job.rig,
            job.meters_per_unit,
            has_root_motion=take.plan.options.root_motion,
            rig_scale=1.0 if joint_map is None else joint_map.world_scale,
        )
        prefetched_blocks = prefetch(timed_items(rounded_blocks, take.seconds, "read"))
        try:
            yield replace(usd_take, blocks=prefetched_blocks)
        finally:
            prefetched_blocks.close()


class _JointTake:
    """A take that is written as a SkelAnimation, prepared when the writer needs it."""

    def __init__(self, baked_take: BakedTake) -> None:
        self.plan, self._baked_take = baked_take.plan, baked_take
        self.seconds = {"read": 0.0}  # time to compute blocks [s]
        self._thinned_samples: ThinnedSamples | None = None

    def prepare(self, rig: Rig) -> tuple[UsdTake, TimedBlocks]:
        """Return the writer's description of the take, and its frames.

        ``rig`` is the written rig: that of the rig layer, or of the first take.
        """
        sampled_take = self._baked_take.open()
        blocks, frames = sampled_take.blocks, sampled_take.first_and_last
        plan, options, joint_map = self.plan, self.plan.options, self.plan.joint_map
        joint_mask = None
        if joint_map is not None:
            map_motion = joint_map.map_placed_motion
            blocks = ((codes, map_motion(codes, motion)) for codes, motion in blocks)
            if (joint_map.source_joints < 0).any():
                joint_mask = joint_map.source_joints >= 0
        if options.sparse:
            all_blocks = list(blocks)
            blocks = iter(all_blocks)
            is_written = moving_joints(plan, rig, [motion for _, motion in all_blocks])
            if joint_mask is not None:
                is_written &= joint_mask
            if is_written.any():
                joint_mask = is_written
        step = plan.stream.step * plan.fps / plan.stream.fps
        if options.reduce is not None:
            blocks, self._thinned_samples, frames = _reduce_samples(
                plan, blocks, frames, rig, step
            )
        shapes = tuple(shape.name for shape in plan.stream.rig.shapes)
        if joint_map is not None:
            shapes = joint_map.shapes
        take = UsdTake(
            (),
            plan.start,
            step,
            frames=frames,
            joint_mask=joint_mask,
            shapes=shapes,
            curves=_kept_curves(plan) if options.keep_curves else {},
            name=plan.name,
            source_name=source_stem(plan.source),
            props=self._baked_take.props,
            rig_from_take=None if joint_map is None else joint_map.rig_from_take,
            is_reduced=self._thinned_samples is not None,
            rest_metadata=build_rest_metadata(plan.stream.rig, rig)
            if joint_map is None
            else {},
        )
        return take, blocks

    def report(self, job: UsdJob, written_take: WrittenTake) -> TakeReport:
        """Return the report of the written take, with the error of reduction."""
        thinned_samples = self._thinned_samples
        names, index = job.names.names, written_take.rounding.joint_index
        report = take_report(
            self._baked_take, written_take, names[index] if names else ""
        )
        report.thinned = thinned_samples
        if thinned_samples and job.rig.names:
            report.thinned_joint = job.rig.names[thinned_samples.joint_index]
        return report


def _reduce_samples(
    plan: TakePlan,
    blocks: TimedBlocks,
    frames: tuple[Fraction, Fraction] | None,
    rig: Rig,
    step: Fraction,
) -> tuple[TimedBlocks, ThinnedSamples, tuple[Fraction, Fraction]]:
    """Return the samples to keep, their error, and the first and last frame."""
    from animtool.edit.thin import thin_samples

    block_codes, motions = zip(*blocks, strict=True)
    codes, motion = np.concatenate(block_codes), Motion.concatenate(list(motions))
    tolerance = plan.options.reduce
    assert tolerance is not None
    # Tolerances are converted to the rig's numbers, which its stage may scale.
    scale = 1.0 if plan.joint_map is None else plan.joint_map.world_scale
    tolerances = {name: distance / scale for name, distance in plan.options.reduce_at}
    thinned_samples = thin_samples(
        rig, codes, motion, tolerance / scale, joint_tolerances=tolerances
    )
    thinned_samples = replace(thinned_samples, error=thinned_samples.error * scale)
    if frames is None:
        frames = plan.start, plan.start + step * (len(codes) - 1)
    kept_samples = thinned_samples.kept_samples
    return (
        iter([(codes[kept_samples], motion.select(kept_samples))]),
        thinned_samples,
        frames,
    )


def _kept_curves(plan: TakePlan) -> dict[str, Curves]:
    """Return the animation curves of controls at time codes of the output."""
    stream = plan.stream
    if not stream.control_curves:
        message = "there is no control whose curve could be kept"
        hint = "only clips have such curves; a pass that changes a control drops its "
        hint += "curve"
        notice = warning("SCN208", message, hint)
        plan.notices.append(notice.in_file(plan.source))
    first_code = float(stream.first_frame)
    ratio = float(plan.fps / stream.fps)
    return {
        name: curves.retimed(first_code, ratio, float(plan.start))
        for name, curves in stream.control_curves.items()
    }
