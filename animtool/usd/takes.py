"""A whole take to a USD file, in one call."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from animtool._types import FloatArray
from animtool.errors import Fault, OptionError
from animtool.motion import Motion
from animtool.output import check_outputs
from animtool.reorient import reorient
from animtool.take import Take, TakeStream
from animtool.units import LengthUnit
from animtool.usd.animation import round_blocks
from animtool.usd.author import author, write_usd
from animtool.usd.forms import Form, check_suffix, output_paths
from animtool.usd.jobs import UsdJob, UsdResult, UsdTake
from animtool.usd.layers import check_prim_path
from animtool.usd.names import RigPaths, joint_names, legal_name

BLOCK_FRAMES = 512


def write(
    take: Take,
    path: Path | str,
    *,
    rig_layer: Path | str | None = None,
    prim_path: str | None = None,
    force_fit: bool = False,
    split: bool = False,
    bones: bool = False,
    unit: LengthUnit | str | None = None,
    overwrite: bool = False,
) -> UsdResult:
    """Write a take as a USD stage, or as an animation layer over a rig.

    Every frame is a sample, at its own time code. A layer adopts the units, the up
    axis and the rate of its rig layer; where that has another rate, the samples
    stay where they are in time.

    Args:
        take: What to write.
        path: ``.usda``, ``.usdc`` or ``.usd``.
        rig_layer: The rig that a layer is for, or a shot that holds it; None writes
            a stage with skeleton and animation.
        prim_path: Where the character stands; None is ``/{name of the rig}``, or
            where the rig layer has it.
        force_fit: Write a layer of a take that does not fit the rig all the same.
        split: Write the stage in three files, ``path`` the last.
        bones: Add geometry that shows the joints.
        unit: Length unit of the stage; None is the rig's.
        overwrite: Replace files that exist.

    Returns:
        What was written, with the error that rounding made [m].

    Raises:
        FormatError: The rig layer is malformed, or the take does not fit it (RIG040).
        OptionError: An option makes no sense, or a file exists.
        OutputError: A file cannot be written.
    """
    path = Path(path)
    layer = None if rig_layer is None else Path(rig_layer)
    form = Form.LAYER if layer is not None else Form.SPLIT if split else Form.STAGE
    if layer is not None and (split or bones or unit is not None):
        message = "split, bones and unit are for stages, and rig_layer makes a layer"
        raise OptionError(Fault("CLI002", message))
    check_suffix(path)
    inputs = [] if layer is None else [layer]
    check_outputs(output_paths(path, form), inputs, overwrite=overwrite)
    job, written, notices = (
        _stage_job(take, path, form, prim_path, unit, bones)
        if layer is None
        else _layer_job(take, path, layer, prim_path, force_fit=force_fit)
    )
    authored, result = author(job, [written])
    write_usd(job, authored, result)
    result.notices += notices
    return result


_Blocks = Iterator[tuple[FloatArray, Motion]]


def _stage_job(
    take: Take,
    path: Path,
    form: Form,
    prim_path: str | None,
    unit: LengthUnit | str | None,
    bones: bool,
) -> tuple[UsdJob, UsdTake, list[Fault]]:
    rig, clock = take.rig, take.clock
    if prim_path is not None:
        check_prim_path(prim_path)
    names = joint_names(rig.joints, 0)
    job = UsdJob(
        form=form,
        output=path,
        rig=rig,
        names=names,
        joints=rig.paths(names.names),
        paths=RigPaths.below(prim_path or f"/{legal_name(rig.name)}"),
        fps=clock.fps,
        meters_per_unit=rig.meters_per_unit if unit is None else _unit(unit).meters,
        bones=bones,
    )
    written = UsdTake(
        round_blocks(_blocks(take), rig, job.meters_per_unit),
        clock.start,
        clock.step,
        shapes=tuple(shape.name for shape in rig.shapes),
    )
    return job, written, [replace(n, path=str(path)) for n in names.notices]


def _unit(name: LengthUnit | str) -> LengthUnit:
    try:
        return LengthUnit(name)
    except ValueError as error:
        message = f"unit is {name!r}; allowed: {', '.join(LengthUnit)}"
        raise OptionError(Fault("CLI003", message)) from error


def _layer_job(
    take: Take, path: Path, layer: Path, prim_path: str | None, *, force_fit: bool
) -> tuple[UsdJob, UsdTake, list[Fault]]:
    from animtool.usd.target import map_joints, open_target

    target = open_target(layer, prim_path)
    take = reorient(TakeStream.of(take), target.skeleton.rig.up).collect()
    mapping = map_joints(take.rig, target, 0, force_fit=force_fit)
    clock = replace(
        take.clock, fps=target.fps, step=take.clock.step * target.fps / take.clock.fps
    )
    job = UsdJob(
        form=Form.LAYER,
        output=path,
        rig=mapping.rig,
        names=target.names,
        joints=target.skeleton.tokens,
        paths=target.paths,
        fps=clock.fps,
        meters_per_unit=mapping.rig.meters_per_unit,
        target=target,
    )
    blocks = (
        (codes, mapping.apply(motion))
        for codes, motion in _blocks(replace(take, clock=clock))
    )
    written = UsdTake(
        round_blocks(blocks, mapping.rig, job.meters_per_unit),
        clock.start,
        clock.step,
        chosen=mapping.source >= 0 if (mapping.source < 0).any() else None,
        shapes=mapping.shapes,
    )
    notices = target.notices + mapping.notices
    return job, written, notices


def _blocks(take: Take) -> _Blocks:
    codes = take.clock.times
    for begin in range(0, len(codes), BLOCK_FRAMES):
        part = slice(begin, begin + BLOCK_FRAMES)
        yield codes[part], take.motion.select(part)
