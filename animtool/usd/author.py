"""A take as USD: a stage, a stage split in three layers, or a layer over a rig."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from enum import StrEnum
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pxr import Sdf

from animtool._types import BoolArray
from animtool.errors import Fault
from animtool.maths.curves import Curves
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import surfaces_of
from animtool.usd.animation import AnimationWriter, Rounding, WrittenBlock
from animtool.usd.extents import author_extents
from animtool.usd.layers import (
    StageMetadata,
    author_metadata,
    new_layer,
    prim,
    save_layer,
)
from animtool.usd.names import UsdNames
from animtool.usd.skeleton import RigPaths, author_binding, author_rig
from animtool.usd.stderr import without_spline_warnings

if TYPE_CHECKING:
    from animtool.usd.curves import CurveReport
    from animtool.usd.target import RigTarget

__all__ = [
    "Authored",
    "Form",
    "UsdJob",
    "UsdResult",
    "UsdTake",
    "WrittenTake",
    "author",
    "output_paths",
    "write_usd",
]


class Form(StrEnum):
    """What to write.

    ``stage`` is one file with skeleton and animation; ``split`` the same in three
    layers; ``layer`` only the animation, over a rig that lives elsewhere.
    """

    STAGE = "stage"
    SPLIT = "split"
    LAYER = "layer"


@dataclass(frozen=True, slots=True)
class UsdJob:
    """What `write_usd` needs beside the blocks.

    Attributes:
        form: Stage, split or layer.
        output: The file; None writes usda to stdout.
        rig: The joints, as the blocks have them.
        names: Their USD names.
        joints: Their paths as the Skeleton has them.
        paths: The character's prims.
        fps: Time codes a second.
        meters_per_unit: Unit of the layer [m].
        target: The rig of a layer.
        bones: Add geometry that shows the joints.
    """

    form: Form
    output: Path | None
    rig: Rig
    names: UsdNames
    joints: list[str]
    paths: RigPaths
    fps: Fraction
    meters_per_unit: float
    target: RigTarget | None = None
    bones: bool = False


@dataclass(frozen=True, slots=True)
class UsdTake:
    """One animation of a job.

    Attributes:
        blocks: Its frames, as the layer will hold them.
        start: Time code of the first sample.
        step: Time codes from one sample to the next.
        frames: First and last time code; None takes those of the samples.
        chosen: Joints to write ``(J,)``; None is all.
        shapes: Names of the rig's shapes, as the blocks have their weights.
        curves: Curves of controls, by their names, over time codes of the layer.
        name: Of a library's take, legal and distinct; empty where it is the only
            animation, which needs no variant.
        source_name: What the source of a library's take is called.
    """

    blocks: Iterable[WrittenBlock]
    start: Fraction
    step: Fraction
    frames: tuple[Fraction, Fraction] | None = None
    chosen: BoolArray | None = None
    shapes: tuple[str, ...] = ()
    curves: Mapping[str, Curves] = field(default_factory=dict)
    name: str = ""
    source_name: str = ""


@dataclass(slots=True)
class WrittenTake:
    """What was written of one take.

    Attributes:
        name: Of a library's take; empty where it is the only one.
        samples: Number of time samples.
        first: Time code of the first frame.
        last: Time code of the last frame.
        sampled: Attributes of the SkelAnimation that change.
        joints: Joints in the SkelAnimation.
        rounding: What rounding to float32 moved.
        curves: What became of the curves of controls.
    """

    name: str = ""
    samples: int = 0
    first: Fraction = Fraction(0)
    last: Fraction = Fraction(0)
    sampled: list[str] = field(default_factory=list)
    joints: int = 0
    rounding: Rounding = field(default_factory=Rounding)
    curves: list[CurveReport] = field(default_factory=list)


@dataclass(slots=True)
class UsdResult:
    """What was written.

    Attributes:
        outputs: The files.
        bytes: Their size.
        takes: Each animation, at least one.
        notices: Warnings and notes of `animtool.usd.write`.
    """

    outputs: list[Path] = field(default_factory=list)
    bytes: int = 0
    takes: list[WrittenTake] = field(default_factory=list)
    notices: list[Fault] = field(default_factory=list)

    @property
    def samples(self) -> int:
        """Number of time samples of all takes."""
        return sum(take.samples for take in self.takes)

    @property
    def first(self) -> Fraction:
        """Time code of the first frame of any take."""
        return min(take.first for take in self.takes)

    @property
    def last(self) -> Fraction:
        """Time code of the last frame of any take."""
        return max(take.last for take in self.takes)

    @property
    def sampled(self) -> list[str]:
        """Attributes of a SkelAnimation that change in some take."""
        return list(dict.fromkeys(name for take in self.takes for name in take.sampled))

    @property
    def joints(self) -> int:
        """Joints in the SkelAnimation that has most."""
        return max(take.joints for take in self.takes)

    @property
    def rounding(self) -> Rounding:
        """What rounding to float32 moved most in any take."""
        return max((take.rounding for take in self.takes), key=lambda r: r.error)

    @property
    def curves(self) -> list[CurveReport]:
        """What became of the curves of controls of all takes."""
        return [curve for take in self.takes for curve in take.curves]


def output_paths(output: Path, form: Form) -> list[Path]:
    """Return the files that a form writes, in the order written, ``output`` last."""
    if form is not Form.SPLIT:
        return [output]
    return [
        output.with_name(f"{output.stem}.rig.usda"),
        output.with_name(f"{output.stem}.anim.usdc"),
        output,
    ]


def author(job: UsdJob, takes: Iterable[UsdTake]) -> tuple[Authored, UsdResult]:
    """Author the layers of a job in memory; nothing is written yet.

    The takes are drawn one after the other: one that is authored need not be kept.

    Raises:
        OutputError: UsdSkel would not resolve what was authored (USD011, USD032).
    """
    suffix = job.output or Path("stdout.usda")
    outputs = output_paths(suffix, job.form)
    animation = new_layer(outputs[1 if job.form is Form.SPLIT else 0])
    authored = Authored(animation)
    result = UsdResult()
    if job.form is not Form.LAYER:
        authored.rig = new_layer(outputs[0]) if job.form is Form.SPLIT else animation
    writers: list[tuple[str, AnimationWriter]] = []
    with Sdf.ChangeBlock():
        if authored.rig is not None:
            author_rig(authored.rig, job.rig, job.names, job.paths, job.meters_per_unit)
            if job.rig.meshes:
                from animtool.usd.meshes import author_meshes

                tokens = dict(zip(job.rig.names, job.joints, strict=True))
                surfaces = surfaces_of(job.rig)
                _, notices = author_meshes(
                    authored.rig, surfaces, job.paths, tokens, job.meters_per_unit
                )
                result.notices += notices
                authored.visible = True
            if job.bones:
                from animtool.usd.bones import author_bones

                authored.visible |= author_bones(
                    authored.rig, job.rig, job.paths, job.meters_per_unit
                )
        curves = []
        for take in takes:
            writer, written = _author_take(job, authored, take, not writers)
            writers.append((take.name, writer))
            result.takes.append(written)
            curves.append(take.curves)
        _author_metadata(job, authored, result)
    for (_, writer), written, kept in zip(writers, result.takes, curves, strict=True):
        if kept:
            from animtool.usd.curves import author_controls

            written.curves = author_controls(animation, writer.paths.animation, kept)
    author_extents(job, authored, writers)
    for (_, writer), written in zip(writers, result.takes, strict=True):
        written.sampled = writer.sampled
    return authored, result


def _author_take(
    job: UsdJob, authored: Authored, take: UsdTake, first: bool
) -> tuple[AnimationWriter, WrittenTake]:
    """Author a SkelAnimation and what binds it; extents and curves come later."""
    layer, paths = authored.animation, job.paths
    binds_skeleton = job.form is not Form.LAYER
    if take.name:
        from animtool.usd.library import take_paths

        paths = take_paths(job.paths, take.name)
    writer = AnimationWriter(layer, paths, job.joints, take.chosen, take.shapes)
    if take.name:
        prim(layer, paths.root, over=True)
        if first:
            _begin_library(job, authored, take.name)
        binds_skeleton = False
    elif authored.rig is not layer:
        prim(layer, paths.root, over=True)
    author_binding(layer, paths, skeleton=binds_skeleton)
    for block in take.blocks:
        writer.add(block)
    if job.target is None:
        writer.finish([], replaces_motion=False)
    else:
        writer.finish(job.target.operations, replaces_motion=job.target.moves)
    samples = sum(map(len, writer.codes))
    begin, end = take.frames or (take.start, take.start + take.step * (samples - 1))
    if take.name:
        from animtool.usd.library import author_range

        author_range(layer, paths.animation, take.source_name, begin, end)
    joints = len(job.joints) if take.chosen is None else int(take.chosen.sum())
    written = WrittenTake(
        take.name, samples, begin, end, joints=joints, rounding=writer.rounding
    )
    return writer, written


def _begin_library(job: UsdJob, authored: Authored, name: str) -> None:
    """Select the first take, and bind the skeleton outside of the variants."""
    from animtool.usd.library import author_selection

    author_selection(authored.animation, job.paths, name)
    if job.form is not Form.LAYER:
        author_binding(authored.animation, job.paths, skeleton=True, animation=False)


@dataclass(slots=True)
class Authored:
    """Layers in memory.

    Attributes:
        animation: Holds the SkelAnimation.
        rig: Holds the skeleton; the same layer in a stage, None in a layer.
        visible: Whether there are bones or meshes to see.
    """

    animation: Any
    rig: Any = None
    visible: bool = False


def write_usd(job: UsdJob, authored: Authored, result: UsdResult) -> None:
    """Write the layers of a job, that which refers to the others last.

    Raises:
        OutputError: One cannot be written.
    """
    if job.output is None:
        with _quietly(result):
            result.bytes = save_layer(authored.animation, None)
        return
    result.outputs = output_paths(job.output, job.form)
    layers = [authored.animation]
    if job.form is Form.SPLIT:
        root = new_layer(job.output)
        root.subLayerPaths = [f"./{path.name}" for path in result.outputs[1::-1]]
        author_metadata(root, _metadata(job, result))
        layers = [authored.rig, authored.animation, root]
    with _quietly(result):
        for layer, path in zip(layers, result.outputs, strict=True):
            result.bytes += save_layer(layer, path)


def _quietly(result: UsdResult) -> AbstractContextManager[None]:
    return without_spline_warnings() if result.curves else nullcontext()


def _metadata(job: UsdJob, result: UsdResult) -> StageMetadata:
    default = Sdf.Path(job.paths.model).GetPrefixes()[0].name
    unit, up = job.meters_per_unit, job.rig.up
    if job.target is not None:
        unit, up = job.target.unit, job.target.up
    return StageMetadata(default, job.fps, result.first, result.last, unit, up)


def _author_metadata(job: UsdJob, authored: Authored, result: UsdResult) -> None:
    metadata = _metadata(job, result)
    author_metadata(authored.animation, metadata)
    if authored.rig is not None and authored.rig is not authored.animation:
        author_metadata(authored.rig, metadata)
