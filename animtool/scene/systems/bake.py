"""Systems as prims of a bake: alone, or with a take."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import field, replace
from fractions import Fraction
from functools import partial
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.clock import MAX_FRAME_COUNT, FrameSpan, frame_label
from animtool.core.errors import (
    Fault,
    FormatError,
    OptionError,
    refuse_warnings,
    warning,
)
from animtool.core.files.output import written_size
from animtool.core.options import changed_options, option_marker, refused_options
from animtool.core.record import dataclass
from animtool.core.shot import FrameRange
from animtool.core.units import UpAxis
from animtool.documents.ignore import without_accepted
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.prims import (
    BakePlan,
    BakeState,
    TakeReport,
    write_single_file,
)
from animtool.scene.scene import DEFAULT_FPS, Scene
from animtool.scene.sources.open import source_stem
from animtool.scene.systems.character_motion import CharacterRecorder
from animtool.scene.systems.run import SystemRun, system_job
from animtool.scene.systems.simulation import check_resumed_states
from animtool.usd.caches.writer import CachedMesh
from animtool.usd.layers.chunks import open_growing_layer, system_clip_files
from animtool.usd.layers.jobs import LayerForm, RoundingError, UsdResult, WrittenTake
from animtool.usd.layers.sdf import (
    StageMetadata,
    author_metadata,
    layer_span,
    model_path,
    save_layer,
)
from animtool.usd.props.simulated import (
    SimulatedJob,
    new_simulated_layer,
    write_simulated,
    write_simulated_chunks,
)
from animtool.usd.props.writer import paths_overlap, prop_paths

if TYPE_CHECKING:
    from animtool.usd.rigs.target import RigTarget

# Maps the world of a take to that of a layer's systems, at time codes.
PlacementAt: TypeAlias = Callable[[FloatArray], FloatArray | None]


@dataclass(frozen=True, slots=True)
class SystemPrims:
    """Prims of simulated points, curves and meshes in a bake."""

    scene: Scene
    job: SimulatedJob
    start: Fraction  # time code at 0 s; with a take, its first frame
    # Time codes to write, ascending; empty uses the take's.
    codes: tuple[Fraction, ...] = ()
    recorder: CharacterRecorder | None = None  # records the take
    # Placement of a layer at time codes; None is the identity.
    placement_at: PlacementAt | None = None

    def seconds(self, time_code: Fraction) -> float:
        """Return the simulation time of a time code [s]."""
        return float((time_code - self.start) / self.job.metadata.span.fps)

    def author(self, state: BakeState) -> None:
        """Set up the simulation; without chunks it runs when the layer is saved."""
        plan = state.plan
        prims = self if self.recorder is None else self._with_take_codes(self.recorder)
        codes, job = prims.codes, prims.job
        recorder = self.recorder
        if recorder is not None:
            prims.check_resumed(codes[0], codes[-1])
        character = None if recorder is None else recorder.motion(self.scene.path)
        if character is not None and prims.start < self.start:
            delay = float((self.start - prims.start) / job.metadata.span.fps)
            character = replace(character, times=character.times + delay)
        systems = self.scene.systems
        main_rig = None if recorder is None else plan.takes[0].stream.rig
        last_seconds = prims.seconds(codes[-1])
        run = SystemRun(systems, last_seconds, character, state.progress, main_rig)
        clock = (codes, prims.start, job.metadata.span.fps)
        coded_frames = run.coded_frames(*clock, keep_stopped=plan.options.keep_stopped)
        if state.report is None:
            self._begin(state)
        frames = SystemFrames(self, job, run, coded_frames, plan.options.strict)
        if plan.options.chunk is not None:
            frames.write_chunks(state.layer, plan.output, plan.options.chunk)
        state.deferred_frames = frames

    def check_resumed(self, first: Fraction, last: Fraction | None) -> None:
        """Refuse saved states that frames cannot continue (SIM035)."""
        fps = self.job.metadata.span.fps
        check_resumed_states(self.scene.systems, first, last, self.start, fps)

    def _with_take_codes(self, recorder: CharacterRecorder) -> SystemPrims:
        """Return a copy with the time codes and placement of the recorded take."""
        codes = [Fraction(code) for code in recorder.codes.tolist()]
        span = FrameSpan(codes[0], codes[-1], self.job.metadata.span.fps)
        metadata = replace(self.job.metadata, span=span)
        job = replace(self.job, metadata=metadata, codes=recorder.codes)
        if self.placement_at is not None:
            job = replace(job, placement_matrices=self.placement_at(recorder.codes))
        # If a shot begins before its take, the take's first pose is held.
        start = min(self.start, Fraction(ceil(codes[0])))
        return replace(self, job=job, start=start, codes=tuple(codes))

    def _begin(self, state: BakeState) -> None:
        """Create a layer that contains only systems, and its report."""
        plan, metadata = state.plan, self.job.metadata
        layer = new_simulated_layer(self.job, plan.output)
        sample_count = len(self.codes)
        take = WrittenTake("", metadata.span, samples=sample_count)
        result = UsdResult(layer_span(layer), takes=[take])
        state.layer = layer
        state.write_files = partial(write_single_file, layer, plan.output, result)
        report = TakeReport(self.scene.path, take, sample_count, metadata.span.fps, "")
        state.report = plan.report(
            [report],
            result,
            list(plan.notices),
            meters_per_unit=metadata.meters_per_unit,
            up=metadata.up,
        )


@dataclass(slots=True)
class SystemFrames:
    """`DeferredFrames` of systems, which are simulated while they are written."""

    prims: SystemPrims
    job: SimulatedJob
    run: SystemRun
    coded_frames: Iterator[Any]  # rows of all systems, frame by frame
    is_strict: bool
    # Set after simulating: chunk files, results of the meshes, and the layer of a run
    # that stopped early.
    chunk_files: list[Path] = field(default_factory=list)
    written_meshes: list[CachedMesh] = field(default_factory=list)
    stopped_layer: Any = None
    notices: list[Fault] = field(default_factory=list)  # of the simulation

    def write_chunks(self, layer: Any, output: Path, size: int) -> None:
        """Simulate into files of ``size`` samples each, joined by a layer."""
        clips = system_clip_files(output)
        self.chunk_files, self.written_meshes = write_simulated_chunks(
            self.job, self.coded_frames, layer, clips, size
        )
        self._finish(layer)

    def save(self, layer: Any, path: Path) -> int:
        """Write a layer, and simulate the frames that are not in chunks into it."""
        if self.chunk_files:
            return save_layer(layer, path)
        with open_growing_layer(layer, path) as growing_file:
            self.written_meshes = list(
                write_simulated(self.job, self.coded_frames, growing_file)
            )
            self._finish(growing_file.layer)
        return growing_file.size

    def _finish(self, layer: Any) -> None:
        """Set the last simulated frame; save requested states."""
        run, prims = self.run, self.prims
        if run.stop_error is not None and prims.recorder is None:
            metadata = prims.job.metadata
            span = replace(metadata.span, last=prims.codes[run.frames_done - 1])
            author_metadata(layer, replace(metadata, span=span))
            self.stopped_layer = layer
        run.add_notices(self.written_meshes)
        self.notices = without_accepted(run.notices)
        refuse_warnings(self.notices, strict=self.is_strict)
        run.save_states(prims.scene.path.resolve().parent)

    def complete(self, state: BakeState) -> None:
        """Add the simulated frames to the report."""
        report, run, written_meshes = state.report, self.run, self.written_meshes
        assert report is not None
        report.notices += self.notices
        report.stopped = run.stop_error
        report.result.outputs[:0] = self.chunk_files
        report.result.bytes += sum(map(written_size, self.chunk_files))
        for take in report.takes:
            take.meshes += run.reports(written_meshes, take.source.name)
            take.simulated += run.simulated
        if self.prims.recorder is not None:
            return
        if run.stop_error is not None:
            report.result.span = layer_span(self.stopped_layer)
            stopped_take = report.takes[0]
            stopped_take.source_frames = stopped_take.written.samples = run.frames_done
            stopped_take.written.span = report.result.span
        worst_mesh = max(written_meshes, key=lambda prim: prim.error)
        (take,) = report.takes
        take.written.sampled = list(worst_mesh.sampled)
        take.written.rounding = RoundingError(worst_mesh.error, worst_mesh.error_code)
        worst_index = run.written_indices[written_meshes.index(worst_mesh)]
        take.error_joint = self.prims.scene.systems[worst_index].name
        state.read_seconds += run.seconds


def plan_systems(scene: Scene, options: BakeOptions) -> SystemPrims:
    """Return the prims of systems in a scene without a source (SCN061, SCN062)."""
    _refuse_character_options(scene, options)
    fps = options.fps or DEFAULT_FPS
    frames = options.frame_range
    if frames is None:
        message = "a simulation has no natural end"
        hint = "set the frames to write: range: [1, 120]"
        raise OptionError(Fault("SCN061", message, str(scene.path), (), hint))
    start = _start_code(scene, options, frames)
    codes = _time_codes(frames, options.samples)
    model = model_path(options.prim_path, source_stem(scene.path))
    unit = 1.0 if options.to_units is None else options.to_units.meters
    up_axis = options.to_up or UpAxis.Y
    span = FrameSpan(Fraction(frames.first), Fraction(frames.last), fps)
    metadata = StageMetadata(model.split("/")[1], span, unit, up_axis, options.shot)
    job = system_job(scene.systems, model, metadata, unit, up_axis)
    prims = SystemPrims(scene, job, start, codes)
    prims.check_resumed(codes[0], codes[-1])
    return prims


def _start_code(scene: Scene, options: BakeOptions, frames: FrameRange) -> Fraction:
    """Return the time code of 0 s.

    The simulation starts at the beginning even if only a part is requested.
    """
    if options.start is not None:
        return options.start
    return Fraction((scene.bake.frame_range or frames).first)


def unmoved_frames_warning(scene: Scene, options: BakeOptions) -> list[Fault]:
    """Return a warning if no frame is after the simulation starts (SIM203)."""
    frames = options.frame_range
    if frames is None:
        return []
    start, fps = _start_code(scene, options, frames), options.fps or DEFAULT_FPS
    prerolls = [float(system.setup.spec.preroll) for system in scene.systems]
    seconds = float((frames.last - start) / fps) + max(prerolls, default=0.0)
    is_single = scene.bake.frame_range is not None and frames.first == frames.last
    is_start = seconds == 0 and is_single and scene.bake.frame_range == frames
    if seconds >= 0 and not is_start:
        return []
    frame_count = frames.last - frames.first + 1
    frames_text = f"frame {frames.first} is"
    if frame_count > 1:
        frames_text = f"all frames, {frames.first} to {frames.last}, are"
    message = f"{frames_text} before the simulation starts, at frame "
    message += f"{frame_label(start)}: nothing moves"
    if is_start:
        message = f"{frames_text} the only frame, at which the simulation starts: "
        message += "nothing has moved yet"
        frame_count = ceil(fps)
    first = ceil(start)
    hint = argument("frame_range", f"{first}-{first + frame_count - 1}")
    location = next(
        (output.location for output in scene.outputs if output.bake is options), None
    )
    fault = warning("SIM203", message, f"use {hint}", "start")
    if location is not None:
        return [location.locate(fault)]
    return [replace(fault, where=None, path=str(scene.path))]


def _time_codes(
    frames: FrameRange, offsets: tuple[Fraction, ...]
) -> tuple[Fraction, ...]:
    frame_numbers = range(frames.first, frames.last + 1, frames.step)
    count = len(frame_numbers) * max(1, len(offsets))
    if count > MAX_FRAME_COUNT:
        message = f"the range has {count} samples; the limit is {MAX_FRAME_COUNT}"
        raise FormatError(Fault("SCN091", message, where="range"))
    return tuple(
        frame + offset for frame in frame_numbers for offset in offsets or (Fraction(),)
    )


def _refuse_character_options(scene: Scene, options: BakeOptions) -> None:
    """Refuse options that need a character (SCN062)."""
    refused_by_name = refused_options(options, "systems")
    option_names = list(refused_by_name)
    if options.form in {LayerForm.SPLIT, LayerForm.LAYER, LayerForm.LIBRARY}:
        option_names.insert(options.rig_layer is not None, f"as: {options.form}")
    path = str(scene.path)
    faults = [
        Fault("SCN062", f"{name} is for characters, but there is none", path)
        for name in option_names
    ]
    hint = f"lengths are metres and Y is up; {argument('to_units')}, "
    hint += f"{argument('to_up')} and {argument('fps')} convert the result"
    faults += [
        Fault(
            "SCN062",
            f"{option_marker(f'source.{name}', option)} is for sources, but the scene "
            "has none",
            path,
            hint=hint if name in {"unit", "up", "fps"} else None,
        )
        for name, option in changed_options(options.source).items()
    ]
    if faults:
        raise OptionError(faults)


def plan_with_take(scene: Scene, plan: BakePlan) -> SystemPrims:
    """Return the plan of systems that are written in the same layer as a take.

    The prims of the systems are below the character's model, so they share its
    placement, unit and up axis.
    """
    unit, up, target = plan.meters_per_unit, plan.rig.up, plan.target
    unit_and_up = (unit, up) if target is None else (target.unit, target.up)
    model = plan.paths.model
    placeholder_span = FrameSpan(Fraction(0), Fraction(0), plan.fps)
    metadata = StageMetadata(model.split("/")[1], placeholder_span, *unit_and_up)
    job = system_job(scene.systems, model, metadata, unit, up)
    _check_prim_paths(scene, job, plan)
    recorder = CharacterRecorder(
        records_motion=any(scene.path in system.setup.files for system in scene.systems)
    )
    placement_at: PlacementAt | None = None
    if target is not None:
        from animtool.usd.props.placement import parent_from_take

        joint_map, path = plan.takes[0].joint_map, f"{model}/system"
        rig_from_take = None if joint_map is None else joint_map.rig_from_take
        placement_at = partial(parent_from_take, target, rig_from_take, path)
    prims = SystemPrims(
        scene, job, plan.start, recorder=recorder, placement_at=placement_at
    )
    frames = plan.options.frame_range
    if frames is not None:
        prims.check_resumed(Fraction(frames.first), Fraction(frames.last))
    elif plan.options.shot is None:
        prims.check_resumed(plan.start, None)
    return prims


def _check_prim_paths(scene: Scene, job: SimulatedJob, plan: BakePlan) -> None:
    """Refuse systems whose prim path belongs to a character, prop or rig (SCN068)."""
    paths, target = plan.paths, plan.target
    tracks = plan.takes[0].stream.tracks
    owner_by_path = {paths.root: "the character"}
    owner_by_path |= {path: "a prop" for path in prop_paths(tracks, paths.model)}
    faults = []
    written_systems = [system for system in scene.systems if system.is_written]
    for system, path in zip(written_systems, job.paths, strict=True):
        paths_in_use = owner_by_path.items()
        owners = [owner for prim, owner in paths_in_use if paths_overlap(path, prim)]
        if not owners and target is not None and _is_foreign_prim(target, path):
            owners = ["the rig layer"]
        if owners:
            message, hint = f"{path} belongs to {owners[0]}", "give it another name"
            faults.append(system.location.fault("SCN068", message, hint))
    if faults:
        raise FormatError(faults)


def _is_foreign_prim(target: RigTarget, path: str) -> bool:
    """Return whether a prim at a path was not written by an earlier bake."""
    prim = target.stage.GetPrimAtPath(target.to_stage_path(path))
    if not prim or any(map(prim.IsA, ("PointBased", "PointInstancer"))):
        return False
    # Instanced copies are Xforms with names, whose prototypes are classes.
    prototypes = prim.GetChild("Prototypes")
    return not (prototypes and prototypes.IsAbstract())
