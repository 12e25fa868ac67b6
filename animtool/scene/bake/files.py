"""Takes written to formats other than USD, through the table of writers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, cast

import numpy as np

from animtool.core.clock import Clock, FrameSpan
from animtool.core.errors import Fault, refuse_warnings
from animtool.core.files.output import check_outputs, write_arrays, write_parts
from animtool.core.plugins import load_object
from animtool.core.record import dataclass
from animtool.core.shot import Shot
from animtool.core.units import up_from_up
from animtool.core.values import VERSION
from animtool.core.writers import Writer, take_writer
from animtool.documents.ignore import without_accepted
from animtool.motion.driving import combine_missing_weights
from animtool.motion.motion import Channel
from animtool.motion.reorient import rotate_rig
from animtool.motion.scores import PassScores
from animtool.motion.take import Take
from animtool.motion.take_files import TakeFiles, WriteOptions
from animtool.rig.parts import Shape
from animtool.rig.skeleton import Pose, Rig
from animtool.scene.bake.frames import TakePlan, resample_for_output
from animtool.scene.bake.progress import OutputCost
from animtool.scene.sources.open import SourceOptions, is_usd, open_source

if TYPE_CHECKING:
    from animtool.clip.key_report import ChannelDeviation
    from animtool.clip.keyed_take import KeyedTake
    from animtool.clip.reduction.keys import Reduction
    from animtool.formats.take_text import TakeText


@dataclass(frozen=True, slots=True)
class ConvertReport:
    """Report of a take that was written to a format other than USD."""

    output: Path  # the file written
    span: FrameSpan  # first frame, last frame and rate, as the file has them
    frames: int
    joints: int
    notices: list[Fault]  # warnings and notes
    # Keys of a written clip and their errors; None for other formats.
    keyed_take: KeyedTake | None = None
    # Every file written, ``output`` last.
    files: list[Path] = field(default_factory=list)
    shot: Shot | None = None  # written shot; None if there is none
    # Scores of the source's passes.
    scores: list[PassScores] = field(default_factory=list)
    command: str = "convert"  # kind of the report
    json_keys: ClassVar[str] = (
        "*head output frames start=span.first end=span.last fps=span.fps "
        "rate=span.fps# joints shot? scores+ reduction?{samples keys "
        "error=.{meters=error joint} weight_error held} channels? notices"
    )

    @property
    def head(self) -> dict[str, str]:
        """First key of the JSON report: the command, with the version of its format."""
        return {self.command: VERSION}

    @property
    def named(self) -> list[Path]:
        """Written files that the report of a solve lists: only the main file."""
        return [self.output]

    @property
    def channels(self) -> Sequence[ChannelDeviation] | None:
        """Approximation errors of the channels of a written clip."""
        return None if self.keyed_take is None else self.keyed_take.errors

    @property
    def cost(self) -> OutputCost:
        """Measured cost of the conversion."""
        key_error = None if self.reduction is None else self.reduction.error
        return OutputCost(str(self.output), None, key_error)

    @property
    def reduction(self) -> Reduction | None:
        """Number of keys of a written clip and their approximation error."""
        return None if self.keyed_take is None else self.keyed_take.reduction


@dataclass(frozen=True, slots=True)
class FilePlan:
    """A take that is ready to be written to a format other than USD."""

    take: TakePlan
    path: Path
    base: Path | None = None  # base take of an additive take
    rig_file: Path | None = None  # rig file of a clip; None writes one
    other_takes: tuple[TakePlan, ...] = ()  # further takes in the same file
    names: tuple[str, ...] = ()  # names of all takes; empty uses the file name

    @property
    def notices(self) -> list[Fault]:
        """Warnings collected before writing."""
        return self.take.notices

    def run(self) -> ConvertReport:
        """Resample the take to the output's frames, write it and return the report."""
        path, plan = self.path, self.take
        options, base = plan.options, self.base
        stream = resample_for_output(plan)
        take = stream.collect()
        base_take = None
        if base is not None:
            has_same_suffix = base.suffix.lower() == plan.source.suffix.lower()
            base_take = _base_take(
                take, base, options.source if has_same_suffix else None
            )
        other_streams = list(map(resample_for_output, self.other_takes))
        write_options = WriteOptions(
            options.reduce,
            dict(options.reduce_at),
            base_take,
            self.rig_file,
            others=tuple(other_stream.collect() for other_stream in other_streams),
            names=self.names,
        )
        writer = take_writer(path)
        mesh_notices: list[Fault] = []
        if "meshes" in writer.holds:
            take, mesh_notices = _with_meshes(take, plan)
        outputs = _take_files(writer, take, path, write_options)
        notices = [
            n for take_stream in (stream, *other_streams) for n in take_stream.notices
        ]
        notices += [*plan.notices, *mesh_notices, *outputs.notices]
        notices = without_accepted(list(dict.fromkeys(notices)))
        refuse_warnings(notices, strict=options.strict)
        files, inputs = list(outputs.contents), [plan.source, *([base] if base else [])]
        check_outputs(files, inputs, overwrite=options.overwrite)
        for file, contents in outputs.contents.items():
            if isinstance(contents, Mapping):
                write_arrays(file, contents)
            else:
                write_parts(file, contents)
        return ConvertReport(
            path,
            outputs.span,
            take.clock.count,
            outputs.joints,
            notices,
            outputs.keyed,
            files,
            options.shot,
            list(plan.stream.scores),
        )


def _with_meshes(take: Take, plan: TakePlan) -> tuple[Take, list[Fault]]:
    """Return a take with the meshes of its USD file, and notices about them.

    Takes that have meshes, or are from other files, are returned unchanged.
    """
    if take.rig.meshes or not is_usd(plan.source):
        return take, []
    from animtool.usd.rigs.stored import read_rig_with_data

    options = plan.options
    full_rig, notices = read_rig_with_data(
        plan.source, options.source.prim_path, options.placement
    )
    if full_rig.names != take.rig.names:
        return take, []  # passes have put another rig there
    rotation = up_from_up(take.rig.up, full_rig.up)
    if rotation is not None:
        full_rig = rotate_rig(full_rig, np.array(rotation), take.rig.up)
    names = {shape.name for shape in full_rig.shapes}
    shapes = full_rig.shapes
    shapes += tuple(shape for shape in take.rig.shapes if shape.name not in names)
    rig = replace(
        take.rig,
        meters_per_unit=full_rig.meters_per_unit,
        meshes=full_rig.meshes,
        shapes=shapes,
        bind=_bind_poses(take.rig, full_rig),
    )
    motion = replace(take.motion, weights=_shape_weights(take, shapes))
    return replace(take, rig=rig, motion=motion), notices


def _shape_weights(take: Take, shapes: Sequence[Shape]) -> Channel | None:
    """Return the weights of a take for a list of shapes, in the list's order.

    Combination shapes that the take lacks get the weight that follows from its shapes;
    other missing shapes get 0.
    """
    weights, all_names = take.motion.weights, [shape.name for shape in shapes]
    names = [shape.name for shape in take.rig.shapes]
    if weights is None or names == all_names:
        return weights
    indices = np.array([all_names.index(name) for name in names], np.int64)
    order = np.argsort(indices)
    zero_weights = Channel.static(np.zeros((len(shapes), 1)), take.clock.count)
    weights = zero_weights.put(indices[order], weights.gather(order))
    missing_indices = np.setdiff1d(np.arange(len(shapes)), indices)
    return combine_missing_weights(weights, shapes, missing_indices).compact()


def _bind_poses(rig: Rig, full_rig: Rig) -> dict[str, Pose]:
    """Return the bind poses of a full rig that differ from the rest pose of a rig."""
    poses = dict(full_rig.bind)
    for joint, full_joint in zip(rig.joints, full_rig.joints, strict=True):
        rest_pose = full_joint.translation, full_joint.rotation
        if (joint.translation, joint.rotation) != rest_pose:
            poses.setdefault(full_joint.name, Pose(*rest_pose))
    return poses


def _take_files(
    writer: Writer, take: Take, path: Path, options: WriteOptions
) -> TakeFiles:
    """Return the files that a writer creates for a take, not yet written."""
    if writer.take:
        write = cast(Callable[..., TakeFiles], load_object(writer.take))
        return write(take, path, options)
    if take.clock.step > 1:
        from animtool.edit.resample import resampled

        take = resampled(take, take.clock.fps)
    text = cast("Callable[[Take], TakeText]", load_object(writer.text))(take)
    clock, start = take.clock, Fraction(1)
    if writer.numbered:
        start += (clock.start - 1) / clock.step
    # Most of these formats do not number frames; readers start with the first.
    span = Clock(clock.rate, start, Fraction(1), clock.count).span
    return TakeFiles({path: text.parts}, span, len(take.rig.joints), text.notices)


def _base_take(take: Take, path: Path, options: SourceOptions | None) -> Take:
    """Return the base take of an additive take, sampled at the additive frames."""
    from animtool.edit.combine import match_rig, sample_other_take

    base_take = match_rig(take.rig, open_source(path, options).collect())
    motion = sample_other_take(base_take, take.clock.rate, 0, take.clock.count)
    return replace(take, motion=motion)
