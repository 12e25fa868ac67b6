"""A take as USD: a stage, a stage split in three layers, or a layer over a rig."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from enum import StrEnum
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pxr import Sdf

from animtool._types import BoolArray, Float32Array
from animtool.errors import Fault, OutputError
from animtool.maths.curves import Curves
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import surfaces_of
from animtool.usd.animation import AnimationWriter, Rounding, WrittenBlock
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
        frames: First and last time code; None takes those of the samples.
        start: Time code of the first sample.
        step: Time codes from one sample to the next.
        meters_per_unit: Unit of the layer [m].
        target: The rig of a layer.
        chosen: Joints to write ``(J,)``; None is all.
        bones: Add geometry that shows the joints.
        shapes: Names of the rig's shapes, as the blocks have their weights.
        curves: Curves of controls, by their names, over time codes of the layer.
    """

    form: Form
    output: Path | None
    rig: Rig
    names: UsdNames
    joints: list[str]
    paths: RigPaths
    fps: Fraction
    frames: tuple[Fraction, Fraction] | None
    start: Fraction
    step: Fraction
    meters_per_unit: float
    target: RigTarget | None = None
    chosen: BoolArray | None = None
    bones: bool = False
    shapes: tuple[str, ...] = ()
    curves: Mapping[str, Curves] = field(default_factory=dict)


@dataclass(slots=True)
class UsdResult:
    """What was written.

    Attributes:
        outputs: The files.
        bytes: Their size.
        samples: Number of time samples.
        first: Time code of the first frame.
        last: Time code of the last frame.
        sampled: Attributes of the SkelAnimation that change.
        joints: Joints in the SkelAnimation.
        rounding: What rounding to float32 moved.
        curves: What became of the curves of controls.
        notices: Warnings and notes of `animtool.usd.write`.
    """

    outputs: list[Path] = field(default_factory=list)
    bytes: int = 0
    samples: int = 0
    first: Fraction = Fraction(0)
    last: Fraction = Fraction(0)
    sampled: list[str] = field(default_factory=list)
    joints: int = 0
    rounding: Rounding = field(default_factory=Rounding)
    curves: list[CurveReport] = field(default_factory=list)
    notices: list[Fault] = field(default_factory=list)


def output_paths(output: Path, form: Form) -> list[Path]:
    """Return the files that a form writes, in the order written, ``output`` last."""
    if form is not Form.SPLIT:
        return [output]
    return [
        output.with_name(f"{output.stem}.rig.usda"),
        output.with_name(f"{output.stem}.anim.usdc"),
        output,
    ]


def author(job: UsdJob, blocks: Iterator[WrittenBlock]) -> tuple[Authored, UsdResult]:
    """Author the layers of a job in memory; nothing is written yet."""
    suffix = job.output or Path("stdout.usda")
    outputs = output_paths(suffix, job.form)
    animation = new_layer(outputs[1 if job.form is Form.SPLIT else 0])
    authored = Authored(animation)
    result = UsdResult()
    if job.form is not Form.LAYER:
        authored.rig = new_layer(outputs[0]) if job.form is Form.SPLIT else animation
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
        writer = AnimationWriter(
            animation, job.paths, job.joints, job.chosen, job.shapes
        )
        if authored.rig is not animation:
            prim(animation, job.paths.root, over=True)
        author_binding(animation, job.paths, skeleton=job.form is not Form.LAYER)
        for block in blocks:
            writer.add(block)
        if job.target is None:
            writer.finish([], replaces_motion=False)
        else:
            writer.finish(job.target.operations, replaces_motion=job.target.moves)
        result.samples = sum(map(len, writer.codes))
        result.first, result.last = job.frames or (
            job.start,
            job.start + job.step * (result.samples - 1),
        )
        _author_metadata(job, authored, result)
    if job.curves:
        from animtool.usd.curves import author_controls

        result.curves = author_controls(animation, job.paths.animation, job.curves)
    _author_extents(job, authored, writer)
    result.sampled = writer.sampled
    result.joints = len(job.joints) if job.chosen is None else int(job.chosen.sum())
    result.rounding = writer.rounding
    return authored, result


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
        with _quietly(job):
            result.bytes = save_layer(authored.animation, None)
        return
    result.outputs = output_paths(job.output, job.form)
    layers = [authored.animation]
    if job.form is Form.SPLIT:
        root = new_layer(job.output)
        root.subLayerPaths = [f"./{path.name}" for path in result.outputs[1::-1]]
        author_metadata(root, _metadata(job, result))
        layers = [authored.rig, authored.animation, root]
    with _quietly(job):
        for layer, path in zip(layers, result.outputs, strict=True):
            result.bytes += save_layer(layer, path)


def _quietly(job: UsdJob) -> AbstractContextManager[None]:
    return without_spline_warnings() if job.curves else nullcontext()


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


def _author_extents(job: UsdJob, authored: Authored, writer: AnimationWriter) -> None:
    """Write the SkelRoot's extent as UsdSkel would compute it.

    That is the bounds of the joints and a padding which depends on the meshes at
    rest alone, so one frame tells it; where the SkelRoot holds several skeletons
    or moves its own within, UsdSkel computes every frame.
    """
    if job.target is None and not authored.visible:
        with Sdf.ChangeBlock():
            writer.author_extents(0.0)
        return
    from pxr import Usd, UsdGeom

    if job.target is not None:
        from animtool.usd.target import compose_check, resolved_animation

        stage = compose_check(job.target, authored.animation)
        _check_resolved(job, stage, resolved_animation(stage, job.paths.skeleton))
    else:
        top = Sdf.Layer.CreateAnonymous(".usda")
        layers = [authored.animation]
        if authored.rig is not authored.animation:
            layers.append(authored.rig)
        top.subLayerPaths = [layer.identifier for layer in layers]
        stage = Usd.Stage.Open(top)
        stage.SetTimeCodesPerSecond(float(job.fps))
    root = UsdGeom.Boundable(stage.GetPrimAtPath(job.paths.root))
    skeleton = UsdGeom.Xformable(stage.GetPrimAtPath(job.paths.skeleton))
    within = skeleton.GetPrim().GetParent() == root.GetPrim()
    simple = (
        within
        and (job.target is None or job.target.skeletons == 1)
        and not skeleton.GetXformOpOrderAttr().Get()
    )

    def computed(code: float) -> Float32Array:
        extent = UsdGeom.Boundable.ComputeExtentFromPlugins(root, Usd.TimeCode(code))
        return np.array(extent, np.float32).reshape(-1, 3)

    if simple:
        pad = float(np.abs(computed(writer.codes[0][0]) - writer.first_extent).max())
        reach = float(np.abs(writer.first_extent).max())
        # Two roundings to float32 apart is no padding.
        pad = pad if pad > 2.5e-7 * reach else 0.0
        with Sdf.ChangeBlock():
            writer.author_extents(pad)
        return
    bounds = [np.stack([computed(c) for c in codes]) for codes in writer.codes]
    with Sdf.ChangeBlock():
        writer.author_bounds(bounds)


def _check_resolved(job: UsdJob, stage: Any, found: str) -> None:
    if found != job.paths.animation:
        path = None if job.output is None else str(job.output)
        message = (
            f"UsdSkel resolves {found or 'no animation'} for {job.paths.skeleton}, "
            f"not {job.paths.animation}"
        )
        hint = "a binding in the rig is stronger than the layer"
        if stage.GetPrimAtPath(job.paths.skeleton).IsInstanceProxy():
            hint = "the rig is instanced there, and a layer cannot reach into instances"
        raise OutputError(Fault("USD011", message, path, (), hint))
