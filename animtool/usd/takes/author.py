"""Writes a take as a stage, a stage in three layers, or a layer over a rig."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from pxr import Sdf

from animtool.core.array_types import FloatArray
from animtool.core.clock import FrameSpan
from animtool.core.errors import Fault, OptionError
from animtool.core.files.output import STDOUT, atomic_outputs, check_outputs
from animtool.core.loaded import check_loaded
from animtool.core.rates import rate_warning
from animtool.core.record import dataclass
from animtool.core.units import LengthUnit
from animtool.maths.curves import Curves
from animtool.motion.motion import Motion
from animtool.motion.quaternion_order import python_order_warning
from animtool.motion.reorient import reorient
from animtool.motion.take import Take, TakeStream
from animtool.rig.surfaces import surfaces_of
from animtool.usd.layers.jobs import (
    LayerForm,
    UsdJob,
    UsdResult,
    UsdTake,
    WrittenTake,
    check_suffix,
    output_paths,
)
from animtool.usd.layers.names import (
    TAKE_SET,
    RigPaths,
    joint_names,
    legal_name,
    valid_text,
)
from animtool.usd.layers.sdf import (
    StageMetadata,
    author_metadata,
    check_prim_path,
    layer_span,
    new_layer,
    prim_spec,
    save_layer,
)
from animtool.usd.layers.stderr import VERSION_WARNINGS, without_usd_warnings
from animtool.usd.rigs.skeleton import (
    PLACEMENT_KEY,
    author_rig,
    bind_animation,
    build_rest_metadata,
)
from animtool.usd.takes.extents import author_extents
from animtool.usd.takes.joint_writer import AnimationWriter, round_blocks

BLOCK_FRAMES = 512  # frames per block of a take written by `write`


def author(job: UsdJob, takes: Iterable[UsdTake]) -> tuple[AuthoredLayers, UsdResult]:
    """Author the layers of a job in memory; nothing is saved yet.

    Takes are requested one by one, so that only one is in memory.
    """
    outputs = output_paths(job.output, job.form)
    animation_layer = new_layer(outputs[1 if job.form is LayerForm.SPLIT else 0])
    authored_layers = AuthoredLayers(animation_layer)
    notices: list[Fault] = []
    if job.form is not LayerForm.LAYER:
        authored_layers.rig = (
            new_layer(outputs[0]) if job.form is LayerForm.SPLIT else animation_layer
        )
    with Sdf.ChangeBlock():
        if authored_layers.rig is not None:
            notices += _author_rig_and_geometry(job, authored_layers)
        authored_takes = [
            _author_take(job, authored_layers, take, is_first=not i)
            for i, take in enumerate(takes)
        ]
        written_takes = [authored_take.report for authored_take in authored_takes]
        for layer in authored_layers.layers:
            author_metadata(layer, _stage_metadata(job, written_takes))
    notices += [notice for take in written_takes for notice in take.notices]
    result = UsdResult(
        layer_span(animation_layer), takes=written_takes, notices=notices
    )
    for authored_take in authored_takes:
        if authored_take.curves:
            from animtool.usd.takes.splines import author_controls

            authored_take.report.curves = author_controls(
                animation_layer, authored_take.report.animation, authored_take.curves
            )
    author_extents(
        job,
        authored_layers.has_visible_geometry,
        authored_layers.layers,
        [
            (authored_take.report.name, authored_take.writer)
            for authored_take in authored_takes
        ],
    )
    for authored_take in authored_takes:
        authored_take.report.sampled = authored_take.writer.sampled_names
    return authored_layers, result


def _author_rig_and_geometry(
    job: UsdJob, authored_layers: AuthoredLayers
) -> list[Fault]:
    """Author the rig, its meshes and bones; return notices about the meshes."""
    layer, rig, paths = authored_layers.rig, job.rig, job.paths
    author_rig(layer, rig, job.names, paths, job.meters_per_unit)
    has_strands = any(entry.points is not None for entry in rig.attach)
    authored_layers.has_visible_geometry = has_strands or bool(rig.meshes)
    notices: list[Fault] = []
    if rig.meshes:
        from animtool.usd.rigs.meshes import author_meshes

        tokens = dict(zip(rig.names, job.joints, strict=True))
        _, notices = author_meshes(
            layer, surfaces_of(rig), paths, tokens, job.meters_per_unit
        )
    if job.show_bones:
        from animtool.usd.rigs.meshes import author_bones

        authored_layers.has_visible_geometry |= author_bones(
            layer, rig, paths, job.meters_per_unit
        )
    return notices


@dataclass(frozen=True, slots=True)
class _AuthoredTake:
    """A take whose samples are authored, with its writer, report and curves."""

    writer: AnimationWriter
    report: WrittenTake
    curves: Mapping[str, Curves]


def _author_take(
    job: UsdJob, authored_layers: AuthoredLayers, take: UsdTake, *, is_first: bool
) -> _AuthoredTake:
    """Author a SkelAnimation with its binding; extents and curves follow later."""
    layer, paths = authored_layers.animation, job.paths
    if take.name:
        from animtool.usd.takes.library import take_paths

        paths = take_paths(job.paths, take.name)
    writer = AnimationWriter(layer, paths, job.joints, take.joint_mask, take.shapes)
    if take.name or authored_layers.rig is not layer:
        prim_spec(layer, paths.root, is_over=True)
    if take.name and is_first:
        _start_library(job, authored_layers, take.name)
    binds_skeleton = job.form is not LayerForm.LAYER and not take.name
    bind_animation(layer, paths, binds_skeleton=binds_skeleton)
    for block in take.blocks:
        writer.add(block)
    if job.target is None:
        writer.finish([], disables_root_motion=False)
    else:
        writer.finish(
            job.target.placing_ops, disables_root_motion=job.target.has_root_motion
        )
    report = _take_report(job, take, writer)
    if take.props is not None:
        _author_take_props(job, authored_layers, take, report)
    animation = layer.GetPrimAtPath(paths.animation)
    if take.name:
        from animtool.usd.takes.library import author_take_metadata

        author_take_metadata(
            layer,
            paths.animation,
            valid_text(take.source_name),
            report.span.first,
            report.span.last,
        )
    if job.form is LayerForm.LAYER and job.names.sources_by_legal_name:
        # Source names of joints, for readers that do not have the rig.
        _author_data(animation, "names", job.names.sources_by_legal_name)
    if take.is_reduced:
        _author_data(animation, "reduced", value=True)
    if take.rest_metadata:
        _author_data(animation, PLACEMENT_KEY, take.rest_metadata)
    return _AuthoredTake(writer, report, take.curves)


def _author_take_props(
    job: UsdJob, authored_layers: AuthoredLayers, take: UsdTake, report: WrittenTake
) -> None:
    """Author the props of a take; add them and their notices to its report."""
    from animtool.usd.props.placement import build_prop_placements
    from animtool.usd.props.writer import author_props

    assert take.props is not None
    rig_layer = (
        None
        if authored_layers.rig is authored_layers.animation
        else authored_layers.rig
    )
    placements = build_prop_placements(
        job.paths,
        job.target,
        rig_layer,
        job.meters_per_unit,
        job.rig.up,
        take.name,
        take.rig_from_take,
    )
    report.props, report.notices = author_props(
        authored_layers.animation, take.props, placements, job.output
    )


def _author_data(animation: Any, key: str, value: Mapping[str, Any] | bool) -> None:
    """Author SkelAnimation data that USD cannot express, as customData."""
    custom_data = dict(animation.GetInfo("customData") or {})
    stored_value = value if isinstance(value, bool) else dict(value)
    animtool_data = {**custom_data.get("animtool", {}), key: stored_value}
    animation.SetInfo("customData", {**custom_data, "animtool": animtool_data})


def _take_report(job: UsdJob, take: UsdTake, writer: AnimationWriter) -> WrittenTake:
    """Return the report of a take after its samples are written."""
    sample_count = sum(map(len, writer.codes))
    first_code, last_code = take.frames or (
        take.start,
        take.start + take.step * (sample_count - 1),
    )
    return WrittenTake(
        writer.paths.animation,
        FrameSpan(first_code, last_code, job.fps),
        take.name,
        sample_count,
        joints=len(job.joints)
        if take.joint_mask is None
        else int(take.joint_mask.sum()),
        rounding=writer.rounding,
    )


def _start_library(job: UsdJob, authored_layers: AuthoredLayers, name: str) -> None:
    """Select the first take of a library; bind the skeleton outside the variants."""
    model = authored_layers.animation.GetPrimAtPath(job.paths.model)
    model.variantSelections[TAKE_SET] = name
    if job.form is not LayerForm.LAYER:
        bind_animation(
            authored_layers.animation,
            job.paths,
            binds_skeleton=True,
            binds_source=False,
        )


@dataclass(slots=True)
class AuthoredLayers:
    """Authored layers in memory, not saved yet."""

    animation: Any  # layer with the SkelAnimation
    rig: Any = None  # layer with the skeleton; the same for a stage, None for a layer
    has_visible_geometry: bool = False  # whether there are visible bones or meshes

    @property
    def layers(self) -> list[Any]:
        """The animation layer, and the rig layer if separate."""
        has_rig_layer = self.rig is not None and self.rig is not self.animation
        return [self.animation, self.rig] if has_rig_layer else [self.animation]


def write_usd(
    job: UsdJob,
    authored_layers: AuthoredLayers,
    result: UsdResult,
    save: Callable[[Any, Path], int] = save_layer,
) -> None:
    """Save the layers of a job, the referencing layer last."""
    if job.output == STDOUT:
        with _without_usd_messages(result):
            result.bytes = save(authored_layers.animation, STDOUT)
        return
    result.outputs = output_paths(job.output, job.form)
    layers = [authored_layers.animation]
    if job.form is LayerForm.SPLIT:
        root = new_layer(job.output)
        root.subLayerPaths = [f"./{path.name}" for path in result.outputs[1::-1]]
        author_metadata(root, _stage_metadata(job, result.takes))
        layers = [authored_layers.rig, authored_layers.animation, root]
    with _without_usd_messages(result), atomic_outputs():
        for layer, path in zip(layers, result.outputs, strict=True):
            save_function = save if layer is authored_layers.animation else save_layer
            result.bytes += save_function(layer, path)


def _without_usd_messages(result: UsdResult) -> AbstractContextManager[None]:
    """Return a context that drops USD's messages about splines and time codes."""
    has_new_features = any(take.curves or take.name for take in result.takes)
    return without_usd_warnings(VERSION_WARNINGS) if has_new_features else nullcontext()


def _stage_metadata(job: UsdJob, takes: Sequence[WrittenTake]) -> StageMetadata:
    """Return the metadata of a stage that spans all takes."""
    default_prim = Sdf.Path(job.paths.model).GetPrefixes()[0].name
    unit, up = job.meters_per_unit, job.rig.up
    if job.target is not None:
        unit, up = job.target.unit, job.target.up
    spans = [take.span for take in takes]
    first_code = min(take_span.first for take_span in spans)
    last_code = max(take_span.last for take_span in spans)
    span = FrameSpan(first_code, last_code, job.fps)
    return StageMetadata(default_prim, span, unit, up, job.shot)


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

    Every frame is a sample at its own time code. A layer adopts units, up axis and rate
    of its rig layer; with another rate, samples keep their times.

    Args:
        take: The take.
        path: ``.usda``, ``.usdc`` or ``.usd``.
        rig_layer: The rig of a layer, or a shot that contains it; None writes a stage
            with skeleton and animation.
        prim_path: Prim path of the character; None is ``/{name of the rig}``, or its
            path in the rig layer.
        force_fit: Write a layer even if the take does not fit the rig.
        split: Write the stage in three files, ``path`` the last.
        bones: Add geometry that shows the joints.
        unit: Length unit of the stage; None is the rig's.
        overwrite: Replace existing files.

    Returns:
        The written files and takes, with the rounding error [m].

    Raises:
        FormatError: The rig layer is malformed, or the take does not fit it (RIG040).
        OptionError: An option does not apply to the output (CLI002), or a file exists.
        OutputError: A file cannot be written.
    """
    check_loaded(take, Take, "take")
    path = Path(path)
    layer = None if rig_layer is None else Path(rig_layer)
    form = (
        LayerForm.LAYER
        if layer is not None
        else LayerForm.SPLIT
        if split
        else LayerForm.STAGE
    )
    if layer is not None and (split or bones or unit is not None):
        message = "split, bones and unit need a stage, but rig_layer writes a layer"
        raise OptionError(Fault("CLI002", message))
    check_suffix(path)
    inputs = [] if layer is None else [layer]
    check_outputs(output_paths(path, form), inputs, overwrite=overwrite)
    job, usd_take, notices = (
        _stage_job(take, path, form, prim_path, unit, bones)
        if layer is None
        else _layer_job(take, path, layer, prim_path, force_fit=force_fit)
    )
    layers, result = author(job, [usd_take])
    write_usd(job, layers, result)
    result.notices += notices
    result.notices += python_order_warning(take.rig, take.motion, str(path))
    if all(notice.code != "TAKE009" for notice in take.notices):
        result.notices += rate_warning(take.clock.rate)
    return result


def _stage_job(
    take: Take,
    path: Path,
    form: LayerForm,
    prim_path: str | None,
    unit: LengthUnit | str | None,
    show_bones: bool,
) -> tuple[UsdJob, UsdTake, list[Fault]]:
    """Return settings, take and notices to write a take with its rig."""
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
        paths=RigPaths.from_model(prim_path or f"/{legal_name(rig.name)}"),
        fps=clock.fps,
        meters_per_unit=rig.meters_per_unit
        if unit is None
        else _length_unit(unit).meters,
        show_bones=show_bones,
    )
    usd_take = UsdTake(
        round_blocks(_take_blocks(take), rig, job.meters_per_unit),
        clock.start,
        clock.step,
        shapes=tuple(shape.name for shape in rig.shapes),
        rest_metadata=build_rest_metadata(rig),
    )
    return job, usd_take, [replace(notice, path=str(path)) for notice in names.notices]


def _length_unit(name: LengthUnit | str) -> LengthUnit:
    try:
        return LengthUnit(name)
    except ValueError as error:
        message = f"unit is {name!r}; allowed: {', '.join(LengthUnit)}"
        raise OptionError(Fault("CLI003", message)) from error


def _layer_job(
    take: Take, path: Path, layer: Path, prim_path: str | None, *, force_fit: bool
) -> tuple[UsdJob, UsdTake, list[Fault]]:
    """Return settings, converted take and notices to write a take over a rig layer."""
    from animtool.usd.rigs.joint_map import map_joints
    from animtool.usd.rigs.target import open_target
    from animtool.usd.takes.rig_space import convert_to_rig_space

    target = open_target(layer, prim_path)
    stream = reorient(TakeStream.of(take), target.skeleton.rig.up)
    converted_take = convert_to_rig_space(
        stream, target.placement, None, str(layer), target.skeleton.rig
    )
    take = converted_take.stream.collect()
    joint_map = map_joints(
        take.rig, target, 0, force_fit=force_fit, converted_take=converted_take
    )
    clock = replace(
        take.clock, fps=target.fps, step=take.clock.step * target.fps / take.clock.fps
    )
    job = UsdJob(
        form=LayerForm.LAYER,
        output=path,
        rig=joint_map.rig,
        names=target.names,
        joints=target.skeleton.tokens,
        paths=target.paths,
        fps=clock.fps,
        meters_per_unit=joint_map.rig.meters_per_unit,
        target=target,
    )
    blocks = (
        (codes, joint_map.map_placed_motion(codes, motion))
        for codes, motion in _take_blocks(replace(take, clock=clock))
    )
    usd_take = UsdTake(
        round_blocks(blocks, joint_map.rig, job.meters_per_unit),
        clock.start,
        clock.step,
        joint_mask=joint_map.source_joints >= 0
        if (joint_map.source_joints < 0).any()
        else None,
        shapes=joint_map.shapes,
    )
    notices = target.notices + converted_take.notices + joint_map.notices
    return job, usd_take, notices


def _take_blocks(take: Take) -> Iterator[tuple[FloatArray, Motion]]:
    codes = take.clock.times
    for begin in range(0, len(codes), BLOCK_FRAMES):
        frames = slice(begin, begin + BLOCK_FRAMES)
        yield codes[frames], take.motion.select(frames)
