"""A bake, to one output or all of a scene: passes run once, all is written or none."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TypeAlias

from animtool.core.clock import Clock
from animtool.core.errors import AnimtoolError, Fault, OptionError, Severity, listed
from animtool.core.files.output import check_outputs, name_key, sparing_inputs, together
from animtool.core.files.placing import target
from animtool.core.names import is_named
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import PassthroughTracks
from animtool.motion.take import Take, TakeStream
from animtool.scene.bake.bake import (
    bake_file,
    check_output,
    plan_output,
    plan_simulated,
    run_bake,
    start_of,
    with_systems,
)
from animtool.scene.bake.frames import TakePlan, timed_blocks
from animtool.scene.bake.options import BakeOptions, merged
from animtool.scene.bake.prims import BakePlan, BakeReport
from animtool.scene.bake.progress import Progress, share_of
from animtool.scene.bake.reading import Source, output_files
from animtool.scene.convert.takes import ConvertReport, convert, convert_outputs
from animtool.scene.file.entries import OutputKind, SceneOutput, kind_of
from animtool.scene.scene import Scene
from animtool.scene.sources.open import Opener, open_source

MAX_NAMED = 6
# The output that is no file.
STDOUT = "-"

# What became of one output.
OutputReport: TypeAlias = BakeReport | ConvertReport


def is_several(scene: Scene) -> bool:
    """Return whether a scene writes several files, or one that is no USD."""
    return len(scene.outputs) > 1 or _kind(scene.outputs[0]) is not OutputKind.USD


def scene_files(scene: Scene, options: BakeOptions) -> list[Path]:
    """Return every file that the outputs of a scene are."""
    return [path for output in scene.outputs for path in _files(scene, output, options)]


def bake_scene(
    scene: Scene, options: BakeOptions | None = None, *, progress: Progress = None
) -> list[OutputReport]:
    """Bake a scene to all the outputs that it names.

    All are checked before anything is read, and none gets its name before all are
    written.

    Args:
        scene: Each of its outputs has a file.
        options: They come before those of the scene, for every output.
        progress: Called with the share done, 0 to 1.

    Raises:
        FormatError: A source is malformed, or a pass cannot be applied.
        OptionError: An option makes no sense, an output exists, or two are one file
            (OUT007).
        OutputError: An output cannot be written.
        StrictError: There were warnings, and ``strict`` is on.
        ToleranceError: A system stopped before the last frame. With ``keep_stopped``
            it is the reports' ``stopped``, and the frames before are in the outputs.
    """
    given = options or BakeOptions()
    _check(scene, given)
    opening = share_of(progress, 0, 2) if scene.sources else None
    writing = share_of(progress, 1, 2) if scene.sources else progress
    reports: list[OutputReport] = []
    with together():
        plans = _plans(scene, given, opening)
        for i, (plan, output) in enumerate(zip(plans, scene.outputs, strict=True)):
            shown = share_of(writing, i, len(plans))
            if isinstance(plan, BakePlan):
                reports.append(run_bake(plan, progress=shown))
            else:
                reports.append(_converted(plan, _path(output)))
            if shown is not None:
                shown(1.0)
    return reports


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
        output: The file to write, ``.usda``, ``.usdc`` or ``.usd``; ``-`` writes usda
            to stdout. None writes what a scene names, of which the report is that of
            the first USD file, and stdout where there is no such name.
        options: How.
        progress: Called with the share done, 0 to 1.
        opener: What opens the sources, called as `animtool.open_source`.

    Raises:
        FormatError: A source is malformed, or the takes of a library have other
            joints.
        OptionError: An option makes no sense, or the output exists.
        OutputError: The output cannot be written.
        StrictError: There were warnings, and ``strict`` is on.
        ToleranceError: A system stopped before the last frame. With ``keep_stopped``
            it is the report's ``stopped``, and the frames before are in the output.
    """
    if output is None:
        scene = _named_scene(source)
        if scene is not None:
            return _bake_named(scene, options, progress, opener)
    elif str(output) == STDOUT:
        output = None
    return bake_file(source, output, options, progress=progress, opener=opener)


def _named_scene(source: Source | Sequence[Source]) -> Scene | None:
    """Return the scene that a source is, where it names its output."""
    if isinstance(source, str | Path) and is_named(Path(source), "scene"):
        from animtool.scene.file.read import load_scene

        source = load_scene(source)
    return source if isinstance(source, Scene) and source.output is not None else None


def _bake_named(
    scene: Scene, options: BakeOptions | None, progress: Progress, opener: Opener
) -> BakeReport:
    """Bake a scene to all that it names; return the report of the first USD file."""
    if not is_several(scene):
        output = scene.output
        return bake_file(scene, output, options, progress=progress, opener=opener)
    if not any(_kind(one) is OutputKind.USD for one in scene.outputs):
        message = "the scene names no USD file"
        hint = "animtool.convert writes clips and BVH files"
        raise OptionError(scene.outputs[0].place.fault("SCN044", message, hint))
    reports = bake_scene(scene, options, progress=progress)
    return next(one for one in reports if isinstance(one, BakeReport))


def _plans(
    scene: Scene, options: BakeOptions, progress: Progress
) -> list[BakePlan | TakePlan]:
    """Return what is to become of each output; the sources are opened."""
    if not scene.sources:
        return [
            plan_simulated(
                scene.writing(output), _path(output), merged(options, output.bake), []
            )
            for output in scene.outputs
        ]
    forced = any(merged(options, output.bake).force_fit for output in scene.outputs)
    with sparing_inputs(scene_files(scene, options)):
        stream = scene.forced(force_fit=forced).open(progress=progress)
        streams = _shared(stream, len(scene.outputs))
    return [
        _planned(scene.writing(output), output, stream, options)
        for output, stream in zip(scene.outputs, streams, strict=True)
    ]


def _shared(stream: TakeStream, count: int) -> list[TakeStream]:
    """Return streams of one take for several readers.

    It is gathered once, when the first is read; one reader has the stream itself.
    """
    if count == 1:
        return [stream]
    held: list[Motion] = []

    def blocks() -> Iterator[Motion]:
        if not held:
            whole = Motion.concatenate(list(stream.blocks))
            held.append(whole.map(Channel.compact))
        yield held[0]

    return [replace(stream, blocks=blocks()) for _ in range(count)]


def _kind(output: SceneOutput) -> OutputKind:
    return OutputKind.USD if output.path is None else kind_of(output.path)


def _path(output: SceneOutput) -> Path:
    if output.path is None:
        message = "an output names no file"
        raise OptionError(output.place.fault("DOC021", message))
    return output.path


def _files(scene: Scene, output: SceneOutput, options: BakeOptions) -> list[Path]:
    path = _path(output)
    if _kind(output) is OutputKind.USD:
        bake = merged(options, output.bake)
        simulated = bool(scene.writing(output).systems)
        return output_files(path, bake, simulated=simulated)
    return convert_outputs(path)


def _check(scene: Scene, options: BakeOptions) -> None:
    """Refuse outputs that cannot be, all at once."""
    faults: list[Fault] = []
    errors: list[AnimtoolError] = []
    owners: dict[str, SceneOutput] = {}
    for output in scene.outputs:
        for path in _files(scene, output, options):
            first = owners.setdefault(name_key(target(path).final), output)
            if first is not output:
                message = f"{str(path)!r} is written by {first.place.where} too"
                faults.append(output.place.fault("OUT007", message, "name another"))
        try:
            _check_one(scene, output, options)
        except AnimtoolError as error:
            errors.append(error)
    try:
        replaces = merged(options, scene.bake).overwrite
        check_outputs(scene.kept, scene.inputs, overwrite=replaces)
    except AnimtoolError as error:
        errors.append(error)
    if errors:
        faults += [fault for error in errors for fault in error.faults]
        raise type(errors[0])(faults)
    if faults:
        raise OptionError(faults)


def _check_one(scene: Scene, output: SceneOutput, options: BakeOptions) -> None:
    own = merged(options, output.bake)
    if _kind(output) is OutputKind.USD:
        path, simulated = _path(output), bool(scene.writing(output).systems)
        check_output(path, own, scene.inputs, scene.path, simulated=simulated)
        return
    files = convert_outputs(_path(output))
    check_outputs(files, scene.inputs, overwrite=own.overwrite)


def _planned(
    scene: Scene, output: SceneOutput, stream: TakeStream, stated: BakeOptions
) -> BakePlan | TakePlan:
    options = merged(stated, output.bake)
    if _kind(output) is OutputKind.USD:
        with scene.located_props():
            plan = plan_output([scene.path], [stream], _path(output), options, [])
        return with_systems(plan, scene)
    notices = []
    if scene.systems:
        names = listed([system.name for system in scene.systems], MAX_NAMED)
        message = f"a {_kind(output)} file has no place for what is simulated: {names}"
        notices.append(output.place.fault("SCN112", message, None, Severity.NOTE))
    if stream.tracks:
        paths = listed([track.path for track in stream.tracks], MAX_NAMED)
        message = f"a {_kind(output)} file has no place for {paths}"
        notices.append(output.place.fault("SCN112", message, None, Severity.NOTE))
        stream = PassthroughTracks(stream).stream
    fps = options.fps or stream.fps
    if options.shot is not None:
        options = replace(options, shot=replace(options.shot, fps=fps))
    return TakePlan(
        scene.path,
        "",
        stream,
        None,
        options,
        fps,
        start_of(options, None, stream, scene.path),
        notices,
    )


def _converted(plan: TakePlan, path: Path) -> ConvertReport:
    """Write a take as keys or as a BVH, on the output's own clock."""
    options = plan.options
    take = _on_clock(plan)
    stream = replace(
        TakeStream.of(take),
        notices=[*plan.stream.notices, *plan.notices],
        details=plan.stream.details,
    )
    is_clip = kind_of(path) is OutputKind.CLIP
    report = convert(
        plan.source,
        path,
        overwrite=options.overwrite,
        strict=options.strict,
        reduce=options.reduce if is_clip else None,
        reduce_at=options.reduce_at if is_clip else (),
        opener=lambda *_, **__: stream,
    )
    scores = list(plan.stream.scores)
    return replace(report, shot=options.shot, scores=scores)


def _on_clock(plan: TakePlan) -> Take:
    """Return a take at the rate, in the range and at the time codes of an output."""
    options = plan.options
    plain = BakeOptions(
        fps=options.fps, frame_range=options.frame_range, shot=options.shot
    )
    timed = timed_blocks(replace(plan, options=plain), plan.stream)
    frames, rig = timed.frames, timed.rig
    motions: Sequence[Motion] = [motion for _, motion in timed.blocks]
    motion = Motion.concatenate(list(motions))
    step = plan.stream.step * plan.fps / plan.stream.fps
    if frames is not None:
        step = Fraction(1 if options.frame_range is None else options.frame_range.step)
    first = plan.start if frames is None else frames[0]
    return Take(rig, Clock(plan.fps, first, step, motion.frames), motion)
