"""The bake: a source to a USD animation, checked and planned, and then run."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, cast

from animtool.core.arguments import argument
from animtool.core.config import find_config
from animtool.core.errors import Fault, OptionError, Severity, listed, refuse_warnings
from animtool.core.files.output import check_outputs, sparing_inputs, together
from animtool.core.rates import rate_label
from animtool.core.readers import PACKAGE
from animtool.motion.reorient import off_its_place, reorient
from animtool.motion.take import TakeStream
from animtool.rig.placed import standing_notice
from animtool.scene.bake.first_frame import frame_start
from animtool.scene.bake.frames import TakePlan, TakeRun
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.prims import (
    BakePlan,
    BakeReport,
    Draft,
    OutputPrims,
)
from animtool.scene.bake.progress import Progress, share_of
from animtool.scene.bake.reading import (
    Source,
    check_options,
    check_package,
    form_of,
    found_sources,
    output_files,
)
from animtool.scene.sources.open import Opener, open_source, source_stem
from animtool.usd.layers.jobs import Form, check_suffix
from animtool.usd.layers.names import legal_name
from animtool.usd.layers.sdf import check_prim_path

if TYPE_CHECKING:
    from animtool.scene.scene import Scene
    from animtool.usd.rigs.target import JointMap, RigTarget
    from animtool.usd.takes.over_rig import OverRig


def plan_bake(
    source: Source | Sequence[Source],
    output: Path | str | None,
    options: BakeOptions | None = None,
    *,
    progress: Progress = None,
    opener: Opener = open_source,
) -> BakePlan:
    """Check everything that can be checked before the work, and open the sources."""
    alone = isinstance(source, str) or not isinstance(source, Sequence)
    given = cast("Sequence[Source]", [source] if alone else source)
    _check_count(len(given), options or BakeOptions())
    path = None if output is None else Path(output)
    reading = found_sources(given)
    options, notices = reading.options(options or BakeOptions())
    written = [scene.writing(scene.outputs[0]) for scene in reading.scenes.values()]
    simulated = [scene for scene in written if scene.systems]
    inputs, first = reading.inputs, reading.files[0]
    outputs = check_output(path, options, inputs, first, simulated=bool(simulated))
    kept = [path for scene in written for path in scene.kept]
    check_outputs(kept, [*inputs, *outputs], overwrite=options.overwrite)
    if simulated and len(given) > 1:
        message = "what is simulated is no take of a library"
        raise OptionError(Fault("SCN062", message, str(simulated[0].path)))
    if simulated and not simulated[0].sources:
        return plan_simulated(simulated[0], path, options, notices)
    with sparing_inputs(outputs):
        # Systems come after the take that they go along with.
        shown = share_of(progress, 0, 2) if simulated else progress
        streams = reading.open(options, shown, opener)
    with ExitStack() as located:
        for scene in reading.scenes.values():
            located.enter_context(scene.located_props())
        plan = plan_output(reading.files, streams, path, options, notices)
    return with_systems(plan, simulated[0]) if simulated else plan


def plan_simulated(
    scene: Scene, path: Path | None, options: BakeOptions, notices: list[Fault]
) -> BakePlan:
    """Return what is to become of a scene that has no source.

    path: the file to write; None is stdout.
    """
    from animtool.scene.systems.bake import plan_systems

    systems = plan_systems(scene, options)
    return BakePlan(
        (),
        path,
        options,
        Form.STAGE,
        "it is simulated",
        None,
        systems.job.metadata.fps,
        systems.job.metadata.first,
        notices,
        (systems,),
    )


def with_systems(plan: BakePlan, scene: Scene) -> BakePlan:
    """Return the plan of a take with the systems of its scene."""
    if not scene.systems:
        return plan
    if plan.form is Form.LIBRARY:
        message = "a clip library has no place for what is simulated"
        hint = "bake the systems in a scene of their own, or as: stage"
        raise OptionError(Fault("SCN067", message, str(scene.path), (), hint))
    from animtool.scene.systems.bake import plan_with_take

    systems = plan_with_take(scene, plan)
    return replace(plan, prims=(*plan.prims, systems), watch=systems.watch)


def check_output(
    path: Path | None,
    options: BakeOptions,
    inputs: list[Path],
    source: Path,
    *,
    simulated: bool = False,
) -> list[Path]:
    """Return the files of an output that can be, before anything is read.

    path: the file; None is stdout; simulated: whether systems are written.
    """
    check_options(options, to_stdout=path is None, simulated=simulated)
    if path is None:
        return []
    check_suffix(path, source, packages=True)
    if path.suffix.lower() == PACKAGE:
        check_package(path, options)
    layer = [options.rig_layer] if options.rig_layer else []
    outputs = output_files(path, options, simulated=simulated)
    library = form_of(options) is Form.LIBRARY
    # A library is added to; what may be replaced is one of its takes.
    overwrite = options.overwrite or (library and path.exists())
    check_outputs(outputs, inputs + layer, overwrite=overwrite)
    if library and path.exists():
        from animtool.usd.takes.library import check_library

        name = take_name(options, source)
        check_library(path, name, options.prim_path, overwrite=options.overwrite)
    return outputs


def take_name(options: BakeOptions, source: Path) -> str:
    """Return what a source is called in a clip library."""
    return legal_name(options.take or source_stem(source))


def plan_output(
    sources: Sequence[Path],
    streams: list[TakeStream],
    path: Path | None,
    options: BakeOptions,
    notices: list[Fault],
) -> BakePlan:
    """Return what is to become of sources that are open.

    path: the file to write; None is stdout.
    """
    form = form_of(options)
    library = form is Form.LIBRARY
    added = library and path is not None and path.exists()
    target = _target(path if added else options.rig_layer, options.prim_path)
    mappings: list[JointMap | None] = [None] * len(streams)
    if target is not None:
        from animtool.usd.takes.over_rig import over_rig

        notices += target.notices
        up = target.skeleton.rig.up
        layer = str(target.path)
        ways = [
            over_rig(
                reorient(one, up),
                target.placement,
                options.placement,
                layer,
                target.skeleton.rig,
            )
            for one in streams
        ]
        streams = [way.stream for way in ways]
        mappings = [_mapped(way, target, options, notices) for way in ways]
    else:
        kept = options.placement != "drop"
        for source, one in zip(sources, streams, strict=True):
            notices += standing_notice(one.rig, str(source), kept=kept)
        if not kept:
            streams = [off_its_place(stream) for stream in streams]
        up = options.to_up or streams[0].rig.up
        streams = [reorient(stream, up) for stream in streams]
    if options.root_motion and not streams[0].rig.joints:
        message = (
            f"{argument('root_motion', True)} carries a joint's motion, and there "
            "is none"
        )
        raise OptionError(Fault("CLI002", message, str(sources[0])))
    names = [take_name(options, sources[0]) if library else ""]
    if len(sources) > 1:
        from animtool.scene.bake.library import alike, rate_notice, take_names

        names = take_names(sources, notices)
        if target is None:
            streams = alike(sources, streams, options, notices)
    fps = options.fps or (target.fps if target else streams[0].fps)
    if len(sources) > 1:
        notices += rate_notice(names, streams, fps)
    if options.shot is not None:
        options = replace(options, shot=replace(options.shot, fps=fps))
    notices += _rate_apart(target, fps)
    notices += _left_points(streams, options)
    start = start_of(options, target, streams[0], sources[0])
    takes = tuple(
        TakePlan(
            source,
            name,
            stream,
            mapping,
            options if i == 0 else replace(options, rest_frame=None),
            fps,
            start,
            notices,
        )
        for i, (source, name, stream, mapping) in enumerate(
            zip(sources, names, streams, mappings, strict=True)
        )
    )
    reason = f"{'no' if target is None else 'a'} rig layer was named"
    if options.form is not None:
        reason = "asked for"
    plan = BakePlan(takes, path, options, form, reason, target, fps, start, notices, ())
    _check_props(plan)
    return replace(plan, prims=(_take_prims(takes[0], target),))


def _target(rig_layer: Path | None, prim_path: str | None) -> RigTarget | None:
    """Return the rig of a layer, opened; None where there is none."""
    if rig_layer is not None:
        from animtool.usd.rigs.target import open_target

        return open_target(rig_layer, prim_path)
    if prim_path is not None:
        check_prim_path(prim_path)
    return None


def _check_props(plan: BakePlan) -> None:
    """Refuse things beside characters that have no place in the output."""
    tracks = [take.stream.tracks for take in plan.takes]
    if not any(tracks):
        return
    from animtool.usd.props.writer import check_props

    stage = None if plan.target is None else plan.target.stage
    for some in tracks:
        check_props(some, plan.paths, stage, library=bool(plan.takes[0].name))


def _check_count(count: int, options: BakeOptions) -> None:
    message = ""
    if not count:
        message = "there is no source to bake"
    elif options.shot is not None and count > 1:
        message = "a shot shows one take, and there are several"
    elif options.deform and count > 1:
        message = (
            f"{argument('deform', True)} writes the points of one take, and there "
            "are several"
        )
    if message:
        raise OptionError(Fault("CLI002", message))


def _take_prims(take: TakePlan, target: RigTarget | None) -> OutputPrims:
    if not take.options.deform:
        from animtool.scene.bake.joint_prims import JointPrims

        return JointPrims()
    from animtool.scene.bake.point_prims import PointPrims, open_character

    return PointPrims(open_character(take, target))


def _mapped(
    way: OverRig, target: RigTarget, options: BakeOptions, notices: list[Fault]
) -> JointMap:
    from animtool.usd.rigs.target import map_joints

    mapping = map_joints(
        way.stream.rig,
        target,
        options.strip_namespace,
        force_fit=options.force_fit,
        over=way,
    )
    if mapping.fit is not None:
        way.stream.details["fit"] = round(mapping.fit.score, 4)
    notices += [*way.notices, *mapping.notices]
    return mapping


def _left_points(streams: list[TakeStream], options: BakeOptions) -> list[Fault]:
    """Name what is simulated, and not written."""
    names = sorted({name for stream in streams for name in stream.points})
    if not names or options.deform:
        return []
    message = f"points of {listed(names)} are simulated, and not written"
    hint = "an output with deform: true has them"
    return [Fault("SIM134", message, hint=hint, severity=Severity.WARNING)]


def _rate_apart(target: RigTarget | None, fps: Fraction) -> list[Fault]:
    if target is None or fps == target.fps:
        return []
    theirs = rate_label(target.fps)
    message = f"the output has {rate_label(fps)}, and the rig layer {theirs}"
    hint = "USD stretches time where a sublayer's rate is not its stage's"
    return [Fault("USD106", message, str(target.path), (), hint, Severity.WARNING)]


def start_of(
    options: BakeOptions, target: RigTarget | None, stream: TakeStream, source: Path
) -> Fraction:
    """Return the first frame: asked for, the shot's, the source's, the project's, 1.

    At another rate, a source that starts between the frames of its stage starts at the
    frame of the same time: 960.96 of 24 a second is 1001 of 25.
    """
    if options.start is not None:
        return options.start
    if options.shot is not None and options.shot.places_media:
        return Fraction(1) if stream.start is None else stream.start
    if target is not None and target.start is not None:
        return target.start
    if stream.start is not None:
        if stream.start.denominator == 1:
            return stream.start
        fps = options.fps or (target.fps if target else stream.fps)
        whole = not options.keep_samples
        return frame_start(stream.start, stream.fps, fps, whole=whole)
    configured = find_config(source).start
    return Fraction(1) if configured is None else configured


def bake_file(
    source: Source | Sequence[Source],
    output: Path | str | None,
    options: BakeOptions | None = None,
    *,
    progress: Progress = None,
    opener: Opener = open_source,
) -> BakeReport:
    """Bake to one USD file, None for stdout; see `animtool.bake`."""
    # Passes may keep states as soon as a source is opened.
    with together():
        plan = plan_bake(source, output, options, progress=progress, opener=opener)
        return run_bake(plan, progress=progress)


def run_bake(plan: BakePlan, *, progress: Progress = None) -> BakeReport:
    """Run a planned bake: read, author, write."""
    with together():
        return _run(plan, share_of(progress, 1, 2) if plan.takes else progress)


def _run(plan: BakePlan, progress: Progress) -> BakeReport:
    began = time.perf_counter()
    draft = Draft(plan, progress, [TakeRun(take, plan.watch) for take in plan.takes])
    completions = []
    for prims in plan.prims:
        completions.append(prims.author(draft))
        assert draft.report is not None
        refuse_warnings(draft.report.notices, strict=plan.options.strict)
    assert draft.write is not None
    assert draft.report is not None
    authored = time.perf_counter()
    draft.write(draft.save)
    for complete in completions:
        complete()
    total = time.perf_counter() - began
    read = sum(draft.read)
    # Frames of systems alone are made while they are written.
    author = authored - began if plan.takes else total - read
    draft.report.seconds |= {
        "read": read,
        "author": author,
        "save": total - author if plan.takes else 0.0,
        "total": total,
    }
    return draft.report
