"""Planning of a bake: opens the sources and prepares each output."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from animtool.clip.reduction.suspicions import tolerance_notices
from animtool.core.arguments import argument
from animtool.core.config import find_config
from animtool.core.errors import (
    AnimtoolError,
    Fault,
    OptionError,
    Severity,
    counted,
    listed,
    warning,
)
from animtool.core.files.output import STDOUT, protect_inputs
from animtool.core.names import numbered_names
from animtool.core.rates import rate_label
from animtool.core.writers import take_writer
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import PassthroughTracks
from animtool.motion.reorient import placement_notice, remove_placement, reorient
from animtool.motion.take import Take, TakeStream
from animtool.scene.bake.first_frame import start_frame_at_rate
from animtool.scene.bake.frames import TakePlan
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.prims import BakePlan, OutputPrims
from animtool.scene.bake.progress import Progress, part_progress
from animtool.scene.bake.reading import Source, layer_form
from animtool.scene.bake.request import (
    BakeRequest,
    OutputEntry,
    check_output_options,
    check_request,
    create_request,
    duplicate_outputs,
    take_name,
)
from animtool.scene.sources.open import is_usd, source_stem
from animtool.usd.layers.jobs import LayerForm

if TYPE_CHECKING:
    from animtool.scene.bake.files import FilePlan
    from animtool.scene.scene import Scene
    from animtool.usd.rigs.joint_map import RigJointMap
    from animtool.usd.rigs.target import RigTarget
    from animtool.usd.takes.rig_space import RigSpaceTake

# An output that is ready to be written.
OutputPlan: TypeAlias = "BakePlan | FilePlan"
MAX_LISTED_NAMES = 6


def plan_stage(
    source: Source | Sequence[Source],
    output: Path | str,
    options: BakeOptions | None = None,
) -> BakePlan:
    """Return the plan of a bake to one USD file, or `STDOUT`."""
    request = create_request(source, output, options)
    (plan,) = plan_outputs(request)
    if isinstance(plan, BakePlan):
        return plan
    raise OptionError(Fault("OUT004", "is not a USD file", str(output)))


def plan_outputs(
    request: BakeRequest, *, progress: Progress = None
) -> list[OutputPlan]:
    """Open the sources, check everything possible, and return a plan per output."""
    check_request(request)
    source_set, entries = request.source_set, request.outputs
    if request.scene is not None and not request.scene.sources:
        return [plan_simulation(entry, request.notices) for entry in entries]
    options = entries[0].options
    if len(entries) > 1:
        is_any_forced = any(entry.options.force_fit for entry in entries)
        options = BakeOptions(force_fit=is_any_forced)
    # Systems are planned after the take that they accompany.
    has_systems = any(entry.has_systems for entry in entries)
    has_more_work = has_systems or len(entries) > 1
    source_progress = part_progress(progress, 0, 2) if has_more_work else progress
    with protect_inputs(request.files):
        streams = source_set.open(options, source_progress)
    notices = [*request.notices, *source_set.unused_option_warnings]
    if len(entries) == 1:
        names = source_set.names
        return [_plan_output(source_set.files, streams, entries[0], notices, names)]
    shared_streams = zip(
        entries, _shared_streams(streams[0], len(entries)), strict=True
    )
    return [
        _plan_output(source_set.files, [stream], entry, list(notices))
        for entry, stream in shared_streams
    ]


def planning_faults(request: BakeRequest, take: Take | None) -> list[Fault]:
    """Return the faults that prevent a scene's outputs from being planned.

    ``take`` is the result of its sources after all passes; None for a scene without
    sources.
    """
    faults = duplicate_outputs(request)
    inputs = {path.resolve() for path in request.source_set.inputs}
    for entry in request.outputs:
        layer = entry.options.rig_layer
        entry_inputs = inputs | ({layer.resolve()} if layer else set())
        if not entry_inputs.isdisjoint(path.resolve() for path in entry.files):
            continue  # never read (OUT003)
        try:
            check_output_options(entry)
            if take is None:
                plan_simulation(entry, [])
            else:
                _plan_output(request.source_set.files, [TakeStream.of(take)], entry, [])
        except AnimtoolError as error:
            faults += map(entry.locate, error.faults)
    return faults


def _shared_streams(stream: TakeStream, count: int) -> list[TakeStream]:
    """Return copies of a stream that share one read of the source."""
    motions: list[Motion] = []

    def blocks() -> Iterator[Motion]:
        if not motions:
            motion = Motion.concatenate(list(stream.blocks))
            motions.append(motion.map(Channel.compact))
        yield motions[0]

    return [replace(stream, blocks=blocks()) for _ in range(count)]


def _plan_output(
    sources: Sequence[Path],
    streams: list[TakeStream],
    entry: OutputEntry,
    notices: list[Fault],
    names: tuple[str, ...] = (),
) -> OutputPlan:
    """Return the plan of one output: USD, or a file of another format."""
    scene = entry.scene
    if not entry.is_stage:
        file_plan = _planned_file(sources[0], streams[0], entry, notices)
        if len(streams) == 1:
            return file_plan
        return _with_other_takes(file_plan, sources, streams, entry, notices, names)
    with nullcontext() if scene is None else scene.located_props():
        plan = plan_takes(sources, streams, entry.path, entry.options, notices, names)
    return plan if scene is None else _with_systems(plan, scene)


def _planned_file(
    source: Path, stream: TakeStream, entry: OutputEntry, notices: list[Fault]
) -> FilePlan:
    """Return the plan of one take in a format other than USD."""
    from animtool.scene.bake.files import FilePlan

    options, omitted_parts = entry.options, []
    if options.reduce is not None:
        notices += tolerance_notices(options.reduce, stream.rig, str(source))
    if entry.scene is not None and entry.scene.systems:
        system_names = [system.name for system in entry.scene.systems]
        omitted_parts.append(
            f"simulated systems: {listed(system_names, MAX_LISTED_NAMES)}"
        )
    if stream.tracks:
        paths = [track.path for track in stream.tracks]
        omitted_parts.append(listed(paths, MAX_LISTED_NAMES))
        stream = PassthroughTracks(stream).stream
    for text in omitted_parts:
        message = f"a {take_writer(entry.path).name} file cannot hold {text}"
        note = Fault("SCN112", message, severity=Severity.NOTE)
        notices.append(entry.locate(note))
    fps = options.fps or stream.fps
    if options.shot is not None:
        options = replace(options, shot=replace(options.shot, fps=fps))
    start = output_start(options, None, stream, source)
    take = TakePlan(source, "", stream, None, options, fps, start, notices)
    name = stream.details.get("take") or stream.details.get("name")
    names: tuple[str, ...] = (str(name),) if name else ()
    return FilePlan(take, entry.path, entry.base, entry.rig_file, names=names)


def _with_other_takes(
    plan: FilePlan,
    sources: Sequence[Path],
    streams: list[TakeStream],
    entry: OutputEntry,
    notices: list[Fault],
    names: tuple[str, ...],
) -> FilePlan:
    """Return the plan of a file that stores several named takes of one rig."""
    from animtool.scene.bake.library import in_joint_order

    writer = take_writer(plan.path)
    if not writer.several:
        message = f"a {writer.name} file holds one take, but there are {len(streams)}"
        hint = "write .usdc or .glb, or pass one source"
        raise OptionError(Fault("OUT004", message, str(plan.path), (), hint))
    streams = in_joint_order(sources, streams, entry.options, notices)
    other_plans = [
        _planned_file(source, stream, entry, notices)
        for source, stream in zip(sources[1:], streams[1:], strict=True)
    ]
    default_names = [
        file_plan.names[0] if file_plan.names else source_stem(source)
        for source, file_plan in zip(sources, (plan, *other_plans), strict=True)
    ]
    names = names or tuple(numbered_names(default_names))
    other_takes = tuple(file_plan.take for file_plan in other_plans)
    return replace(plan, other_takes=other_takes, names=names)


def plan_simulation(entry: OutputEntry, notices: list[Fault]) -> BakePlan:
    """Return the plan of an output with systems only, for a scene without a source."""
    from animtool.scene.systems.bake import plan_systems, unmoved_frames_warning

    assert entry.scene is not None
    if not entry.is_stage:
        format_name = take_writer(entry.path).name
        message = f"a {format_name} file cannot hold simulated systems"
        fault = Fault("OUT004", message, hint="write .usdc")
        raise OptionError(entry.locate(fault))
    systems = plan_systems(entry.scene, entry.options)
    span = systems.job.metadata.span
    return BakePlan(
        (),
        entry.path,
        entry.options,
        LayerForm.STAGE,
        "it is simulated",
        None,
        span.fps,
        span.first,
        [*notices, *unmoved_frames_warning(entry.scene, entry.options)],
        (systems,),
    )


def _with_systems(plan: BakePlan, scene: Scene) -> BakePlan:
    """Return the plan of a take with the systems of its scene added."""
    if not scene.systems:
        return plan
    if plan.form is LayerForm.LIBRARY:
        message = "a clip library cannot hold simulated systems"
        hint = "bake the systems in a separate scene, or as: stage"
        raise OptionError(Fault("SCN067", message, str(scene.path), (), hint))
    from animtool.scene.systems.bake import plan_with_take

    systems = plan_with_take(scene, plan)
    return replace(plan, prims=(*plan.prims, systems), recorder=systems.recorder)


def plan_takes(
    sources: Sequence[Path],
    streams: list[TakeStream],
    output: Path,
    options: BakeOptions,
    notices: list[Fault],
    stated_names: tuple[str, ...] = (),
) -> BakePlan:
    """Return the plan of takes in one USD file, or `STDOUT`.

    stated_names: names of the takes; empty uses the file names.
    """
    form = layer_form(options)
    is_library = form is LayerForm.LIBRARY
    extends_library = is_library and output != STDOUT and output.exists()
    target = _open_rig_layer(
        output if extends_library else options.rig_layer, options.prim_path
    )
    joint_maps: Sequence[RigJointMap | None]
    if target is None:
        streams = _reorient_to_stage(sources, streams, options, notices)
        joint_maps = [None] * len(streams)
    else:
        streams, joint_maps = _map_to_rig_layer(streams, target, options, notices)
    if options.root_motion and not streams[0].rig.joints:
        message = f"{argument('root_motion', True)} carries the motion of a joint, but "
        message += "there is none"
        raise OptionError(Fault("CLI002", message, str(sources[0])))
    names = [take_name(options, sources[0]) if is_library else ""]
    if len(sources) > 1:
        from animtool.scene.bake.library import in_joint_order, rate_notice, take_names

        names = take_names(sources, notices, stated_names)
        if target is None:
            streams = in_joint_order(sources, streams, options, notices)
    fps = options.fps or (target.fps if target else streams[0].fps)
    if len(sources) > 1:
        notices += rate_notice(names, streams, fps)
    if options.shot is not None:
        options = replace(options, shot=replace(options.shot, fps=fps))
    notices += _rate_warning(target, fps)
    notices += _unwritten_points_warning(streams, options)
    if target is None:
        notices += _unwritten_meshes_note(sources, streams, options)
    if options.reduce is not None:
        rig = streams[0].rig
        notices += tolerance_notices(options.reduce, rig, str(sources[0]))
    notices += _namespace_warning(streams, options)
    start = output_start(options, target, streams[0], sources[0])
    # Only the first take of a library sets the rest pose.
    take_options = [options] + [replace(options, rest_frame=None)] * (len(streams) - 1)
    take_values = zip(sources, names, streams, joint_maps, take_options, strict=True)
    takes = tuple(TakePlan(*values, fps, start, notices) for values in take_values)
    reason = f"{'no' if target is None else 'a'} rig layer was set"
    if options.form is not None:
        reason = "asked for"
    plan = BakePlan(
        takes, output, options, form, reason, target, fps, start, notices, ()
    )
    _check_props(plan)
    return replace(plan, prims=(_take_prims(takes[0], target),))


def _open_rig_layer(rig_layer: Path | None, prim_path: str | None) -> RigTarget | None:
    """Return the rig of an opened rig layer; None if there is no rig layer."""
    if rig_layer is not None:
        from animtool.usd.rigs.target import open_target

        return open_target(rig_layer, prim_path)
    if prim_path is not None:
        from animtool.usd.layers.sdf import check_prim_path

        check_prim_path(prim_path)
    return None


def _check_props(plan: BakePlan) -> None:
    """Raise an error for props that the output format cannot store."""
    tracks = [take.stream.tracks for take in plan.takes]
    if not any(tracks):
        return
    from animtool.usd.props.writer import check_props

    stage = None if plan.target is None else plan.target.stage
    for take_tracks in tracks:
        check_props(take_tracks, plan.paths, stage, is_library=bool(plan.takes[0].name))


def _take_prims(take: TakePlan, target: RigTarget | None) -> OutputPrims:
    """Return the prims of a take: joints, or points if it is deformed."""
    if not take.options.deform:
        from animtool.scene.bake.joint_prims import JointPrims

        return JointPrims()
    from animtool.scene.bake.deformed_character import open_character
    from animtool.scene.bake.point_prims import PointPrims

    return PointPrims(open_character(take, target))


def _reorient_to_stage(
    sources: Sequence[Path],
    streams: list[TakeStream],
    options: BakeOptions,
    notices: list[Fault],
) -> list[TakeStream]:
    """Return takes rotated to one up axis, with their placement kept or dropped."""
    keeps_placement = options.placement != "drop"
    for source, stream in zip(sources, streams, strict=True):
        rig = stream.rig
        if rig.placement is not None or rig.has_animated_parents:
            notices += placement_notice(rig, str(source), is_kept=keeps_placement)
    if not keeps_placement:
        streams = [remove_placement(stream) for stream in streams]
    up = options.to_up or streams[0].rig.up
    return [
        stream if stream.rig.up is up else reorient(stream, up) for stream in streams
    ]


def _map_to_rig_layer(
    streams: list[TakeStream],
    target: RigTarget,
    options: BakeOptions,
    notices: list[Fault],
) -> tuple[list[TakeStream], list[RigJointMap]]:
    """Return the takes in the space of a rig layer, and the joint map of each."""
    from animtool.usd.takes.rig_space import convert_to_rig_space

    notices += target.notices
    rig, layer = target.skeleton.rig, str(target.path)
    rig_space_takes = [
        convert_to_rig_space(
            reorient(stream, rig.up), target.placement, options.placement, layer, rig
        )
        for stream in streams
    ]
    joint_maps = [
        _joint_map(take, target, options, notices) for take in rig_space_takes
    ]
    return [take.stream for take in rig_space_takes], joint_maps


def _joint_map(
    rig_space_take: RigSpaceTake,
    target: RigTarget,
    options: BakeOptions,
    notices: list[Fault],
) -> RigJointMap:
    """Return the map from a take to the joints of a rig layer; add its notices."""
    from animtool.usd.rigs.joint_map import map_joints

    joint_map = map_joints(
        rig_space_take.stream.rig,
        target,
        options.strip_namespace,
        force_fit=options.force_fit,
        converted_take=rig_space_take,
    )
    if joint_map.fit is not None:
        rig_space_take.stream.details["fit"] = round(joint_map.fit.score, 4)
    notices += [*rig_space_take.notices, *joint_map.notices]
    return joint_map


def _unwritten_points_warning(
    streams: list[TakeStream], options: BakeOptions
) -> list[Fault]:
    """Warn about simulated points that the output does not contain (SIM134)."""
    point_names = sorted({name for stream in streams for name in stream.points})
    if not point_names or options.deform:
        return []
    message = f"points of {listed(point_names)} are simulated, but not written"
    return [warning("SIM134", message, "an output with deform: true includes them")]


def _unwritten_meshes_note(
    sources: Sequence[Path], streams: list[TakeStream], options: BakeOptions
) -> list[Fault]:
    """Note the meshes of USD sources that a stage will not contain (USD127)."""
    if options.deform:
        return []
    return [
        Fault(
            "USD127",
            f"the stage contains the joints, but not "
            f"{counted(len(meshes), 'mesh', 'meshes')} that they deform: "
            f"{listed(meshes, MAX_LISTED_NAMES)}",
            str(path),
            (),
            f"{argument('source.rig', path if is_usd(path) else None)} includes them"
            + ("" if is_usd(path) else " if it names the file of the source"),
            Severity.NOTE,
        )
        for path, stream in zip(sources, streams, strict=True)
        if stream.unread_meshes is not None and (meshes := stream.unread_meshes())
    ]


def _namespace_warning(streams: list[TakeStream], options: BakeOptions) -> list[Fault]:
    """Warn if more namespaces should be dropped than any joint has (USD125)."""
    names = [name for stream in streams for name in stream.rig.names]
    name = max(names, key=lambda name: name.count(":"), default="")
    count, requested_count = name.count(":"), options.strip_namespace
    if not names or count >= requested_count:
        return []
    message = argument("strip_namespace", requested_count)
    message += f" drops nothing: no joint has a namespace, such as {name!r}"
    hint = "namespaces end in a colon, such as hero:Hips; remove the option"
    if count:
        message = f"{argument('strip_namespace', requested_count)} drops no more than "
        message += f"{count}: no joint has more namespaces than {name!r}"
        hint = f"write {argument('strip_namespace', count)}"
    return [warning("USD125", message, hint)]


def _rate_warning(target: RigTarget | None, fps: Fraction) -> list[Fault]:
    """Return a warning if the output and its rig layer differ in rate (USD106)."""
    if target is None or fps == target.fps:
        return []
    rig_layer_rate = rate_label(target.fps)
    message = f"the output has {rate_label(fps)}, but the rig layer {rig_layer_rate}"
    hint = "USD scales time if a sublayer's rate differs from its stage's"
    return [warning("USD106", message, hint).in_file(target.path)]


def output_start(
    options: BakeOptions, target: RigTarget | None, stream: TakeStream, source: Path
) -> Fraction:
    """Return the first frame from options, shot, source or project; the default is 1.

    A source that starts between the frames of its stage starts at the frame of the same
    time: time code 960.96 at 24 fps is frame 1001 at 25 fps.
    """
    if options.start is not None:
        return options.start
    if options.shot is not None and options.shot.places_media:
        return stream.first_frame
    if target is not None and target.start is not None:
        return target.start
    if stream.start is not None:
        if stream.start.denominator == 1:
            return stream.start
        fps = options.fps or (target.fps if target else stream.fps)
        is_rounded = not options.keep_samples
        return start_frame_at_rate(stream.start, stream.fps, fps, is_rounded=is_rounded)
    configured_start = find_config(source).start
    return Fraction(1) if configured_start is None else configured_start
