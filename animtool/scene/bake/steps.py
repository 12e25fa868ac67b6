"""The steps of a bake, each with its input, its result and the data it drops."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields, replace
from enum import StrEnum
from fractions import Fraction
from pathlib import Path
from typing import ClassVar

from animtool.core.clock import Clock
from animtool.core.errors import counted, listed
from animtool.core.rates import rate_label
from animtool.core.record import dataclass
from animtool.core.writers import CLIP, take_writer
from animtool.motion.motion import Motion
from animtool.motion.passes import TakePart, handles_tracks
from animtool.motion.take import TakeStream
from animtool.motion.transforms import Track
from animtool.rig.skeleton import Rig
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.plan import plan_simulation
from animtool.scene.bake.reading import layer_form
from animtool.scene.bake.request import BakeRequest, OutputEntry, check_request
from animtool.scene.file.entries import ScenePass, SceneProp, SceneSystem
from animtool.scene.scene import Scene
from animtool.scene.sources.open import fitting_options, open_source
from animtool.usd.layers.jobs import LayerForm


class StepKind(StrEnum):
    """Kind of a step of a bake; the value is its name in reports."""

    SOURCE = "source"
    PROP = "beside"
    PASS = "pass"
    SYSTEM = "system"
    OUTPUT = "output"


@dataclass(frozen=True, slots=True)
class PlanStep:
    """A step of a bake: what it reads, what it produces and what it drops."""

    kind: StepKind  # kind of step
    name: str  # name of a file or a pass
    where: str  # key of its entry in the scene; empty if it has none
    reads: tuple[str, ...]  # its inputs: files, and parts of the take
    makes: tuple[str, ...]  # its results
    left_out: tuple[str, ...] = ()  # omitted parts, each with the reason


@dataclass(frozen=True, slots=True)
class PlanSteps:
    """The steps of a bake in order, as ``bake --plan`` prints them."""

    steps: list[PlanStep]
    json_keys: ClassVar[str] = "'plan' steps"


def bake_steps(request: BakeRequest) -> list[PlanStep]:
    """Return the steps of a bake in order; sources are read, passes do not run."""
    check_request(request.with_overwrite)
    source_set, scene, outputs = request.source_set, request.scene, request.outputs
    if scene is not None and not scene.sources:
        return _simulated_steps(scene, outputs)
    steps: list[PlanStep] = []
    take_state: _TakeState | None = None
    options = outputs[0].options.source
    for path in source_set.files:
        if path in source_set.scenes:
            take_state = _scene_steps(source_set.scenes[path], steps)
            continue
        source_options = fitting_options(options, path, source_set.files)
        take_state = _TakeState.of(open_source(path, source_options))
        steps.append(_source_step(path, "", take_state))
    assert take_state is not None
    steps += [] if scene is None else _system_steps(scene, outputs)
    for entry in outputs:
        system_count = len(_system_names(entry))
        steps.append(
            _output_step(entry, replace(take_state, system_count=system_count))
        )
    return steps


@dataclass(frozen=True, slots=True)
class _TakeState:
    """State of a take before or after a step, as far as it is known."""

    rig: Rig  # joints, shapes and controls
    valued_parts: frozenset[TakePart]  # parts with values
    curves: tuple[str, ...]  # controls with a curve
    curve_dropping_pass: str  # pass that removed the curves; empty if none did
    summary: tuple[str, ...]  # number of frames and tracks
    static_texts: tuple[str, ...]  # static tracks
    tracks: tuple[Track, ...] = ()  # props and other tracks
    system_count: int = 0  # number of systems simulated with it

    @staticmethod
    def of(stream: TakeStream) -> _TakeState:
        """Return the state of an opened take, which is read completely."""
        take = stream.collect()
        motion, rig = take.motion, take.rig
        frames = counted(take.clock.count, "frame")
        parts = {TakePart.RIG, TakePart.CLOCK, TakePart.JOINTS}
        summary_texts = [f"{frames} at {rate_label(take.clock.rate)}"]
        summary_texts.append(counted(len(rig.joints), "joint"))
        if motion.weights is not None:
            parts.add(TakePart.SHAPES)
            summary_texts.append(counted(len(rig.shapes), "shape"))
        if motion.controls is not None:
            parts.add(TakePart.CONTROLS)
            summary_texts.append(counted(len(rig.controls), "control"))
        if take.tracks:
            parts.add(TakePart.TRACKS)
        return _TakeState(
            rig,
            frozenset(parts),
            tuple(stream.control_curves),
            "",
            tuple(summary_texts),
            tuple(_static_tracks(motion)),
            take.tracks,
        )


def _static_tracks(motion: Motion) -> Iterator[str]:
    """Yield a text for each channel that is static for all or some of its entries."""
    for name, noun in (
        ("translations", "translation"),
        ("rotations", "rotation"),
        ("scales", "scale"),
        ("weights", "shape weight"),
        ("controls", "control"),
    ):
        channel = getattr(motion, name)
        if channel is None:
            if name == "scales":
                yield "scales: nothing is scaled"
            continue
        static_count = len(channel.rest) - len(channel.animated)
        if static_count:
            phrase = (
                "never moves: it is" if static_count == 1 else "never move: they are"
            )
            yield f"samples of {counted(static_count, noun)} that {phrase} stored once"


def _source_step(path: Path, key: str, state: _TakeState) -> PlanStep:
    return PlanStep(
        StepKind.SOURCE, str(path), key, (str(path),), state.summary, state.static_texts
    )


def _scene_steps(scene: Scene, steps: list[PlanStep]) -> _TakeState:
    """Append the steps of a scene's sources and passes; return the resulting state."""
    if len(scene.sources) > 1:
        for source in scene.sources:
            state = _TakeState.of(open_source(source.path, source.options))
            steps.append(_source_step(source.path, source.location.where, state))
    state = _TakeState.of(replace(scene, passes=()).open())
    if len(scene.sources) == 1:
        source = scene.sources[0]
        steps.append(_source_step(source.path, source.location.where, state))
    tracks = {track.path: track for track in state.tracks}
    for prop in scene.props:
        steps.append(_prop_step(prop, tracks[prop.path]))
    for scene_pass in scene.passes:
        steps.append(_pass_step(scene, scene_pass, state))
        if state.curves and not state.curve_dropping_pass and _drops_curves(scene_pass):
            state = replace(state, curve_dropping_pass=scene_pass.pass_.name)
        if TakePart.CLOCK in scene_pass.pass_.changes:
            state = replace(state, summary=())
        state = replace(
            state, valued_parts=state.valued_parts | _added_parts(scene_pass)
        )
    return state


def _system_names(entry: OutputEntry) -> list[str]:
    """Return the names of the systems that an output contains."""
    systems = () if entry.scene is None else entry.scene.systems
    return [system.name for system in systems if system.is_written]


def _system_steps(scene: Scene, outputs: Sequence[OutputEntry]) -> list[PlanStep]:
    """Return the steps of an output's systems and of the systems they depend on."""
    scenes = (entry.scene for entry in outputs if entry.scene is not None)
    names = {system.name for output_scene in scenes for system in output_scene.systems}
    return [
        _system_step(scene, system) for system in scene.systems if system.name in names
    ]


def _system_step(scene: Scene, system: SceneSystem) -> PlanStep:
    setup, key = system.setup, system.location.where
    # The scene's own character is in the scene's file.
    reads = tuple(name for name in setup.reads if name != scene.path.name)
    reads += ("the character",) if scene.path in setup.files else ()
    return PlanStep(StepKind.SYSTEM, system.name, key, reads, (setup.summary,))


def _simulated_steps(scene: Scene, outputs: Sequence[OutputEntry]) -> list[PlanStep]:
    """Return the steps of a scene without a source."""
    steps = _system_steps(scene, outputs)
    for entry in outputs:
        plan_simulation(entry, [])
        prims = listed(_system_names(entry))
        result_text = f"{LayerForm.STAGE} with {prims}, their points and velocities"
        steps.append(_written_step(entry, ["systems"], result_text, []))
    return steps


def _written_step(
    entry: OutputEntry, reads: list[str], result_text: str, left_out: Iterable[str]
) -> PlanStep:
    """Return the step of an output, with its files added to the result."""
    key = "" if entry.scene is None else entry.scene.outputs[0].location.where
    # Existing files are marked; an output that has no file is stdout.
    files = [f"{file} (exists)" if file.exists() else str(file) for file in entry.files]
    results = (result_text, *(files or ["stdout"]))
    return PlanStep(
        StepKind.OUTPUT, entry.name, key, tuple(reads), results, tuple(left_out)
    )


def _prop_step(prop: SceneProp, track: Track) -> PlanStep:
    results = [f"{track.type_name or 'what is referred to'} at {prop.path}"]
    if track.attributes:
        results.append(", ".join(attribute.name for attribute in track.attributes))
    omitted_parts = []
    if not track.is_animated:
        omitted_parts.append("samples: it never moves, and is stored once")
    if not prop.is_retimed:
        omitted_parts.append("changes of time by passes: it is not retimed")
    if track.reference is None and track.type_name == "Xform":
        omitted_parts.append("geometry: not requested (reference)")
    return PlanStep(
        StepKind.PROP,
        f"{prop.prim} of {prop.file}",
        prop.location.where,
        (str(prop.file),),
        tuple(results),
        tuple(omitted_parts),
    )


def _drops_curves(scene_pass: ScenePass) -> bool:
    """Return whether a pass may remove the curves of controls."""
    # Whether its time steps are even does not depend on the frames.
    example_clock = Clock(Fraction(24), Fraction(1), Fraction(1), 1)
    if scene_pass.pass_.linear_time(scene_pass.options, example_clock) is not None:
        return False
    return bool(scene_pass.pass_.changes & {TakePart.CONTROLS, TakePart.CLOCK})


def _added_parts(scene_pass: ScenePass) -> frozenset[TakePart]:
    """Return the parts that a take has only after a pass."""
    return (scene_pass.pass_.changes - scene_pass.pass_.reads) & {TakePart.POINTS}


def _pass_step(scene: Scene, scene_pass: ScenePass, state: _TakeState) -> PlanStep:
    options = scene_pass.options
    files = [
        str(value)
        for field in fields(options)
        if isinstance(value := getattr(options, field.name), Path)
    ]
    available_parts = state.valued_parts | {TakePart.RIG, TakePart.CLOCK}
    if not handles_tracks(scene_pass.pass_):
        available_parts -= {TakePart.TRACKS}
    omitted_parts = []
    if scene.preroll is not None and not scene_pass.pass_.needs_preroll:
        omitted_parts.append("pre-roll: it has no state that would settle")
    missing_parts = sorted(
        (scene_pass.pass_.reads & scene_pass.pass_.changes) - available_parts
    )
    omitted_parts += [f"{take_part}: the take has none" for take_part in missing_parts]
    if state.curves and not state.curve_dropping_pass and _drops_curves(scene_pass):
        omitted_parts.append("curves of controls: invalid where it changes these")
    read_parts = _part_names(scene_pass.pass_.reads & available_parts)
    changed_parts = (scene_pass.pass_.changes & available_parts) | _added_parts(
        scene_pass
    )
    return PlanStep(
        StepKind.PASS,
        scene_pass.pass_.name,
        scene_pass.location.where,
        (*files, *map(str, scene_pass.files), *read_parts),
        tuple(_part_names(changed_parts)),
        tuple(omitted_parts),
    )


def _part_names(parts: frozenset[TakePart]) -> list[str]:
    return [str(part) for part in TakePart if part in parts]


def _output_step(entry: OutputEntry, state: _TakeState) -> PlanStep:
    if not entry.is_stage:
        return _file_step(entry, state)
    options = entry.options
    form = layer_form(options)
    reads = ["take"]
    if options.rig_layer is not None:
        reads.insert(0, str(options.rig_layer))
    result_text = (
        "deformed points" if options.deform else "an animation of the skeleton"
    )
    if form is LayerForm.LIBRARY:
        result_text += " as a take, next to the existing ones,"
    if state.tracks:
        result_text += f" and {counted(len(state.tracks), 'prop')} with it"
    if state.system_count:
        result_text += f" and {counted(state.system_count, 'system')}"
    omitted_parts = _omitted_parts(options, form, state)
    return _written_step(entry, reads, f"{form} with {result_text}", omitted_parts)


def _file_step(entry: OutputEntry, state: _TakeState) -> PlanStep:
    """Return the step of an output that is not USD."""
    writer = take_writer(entry.path)
    noun = "keys have" if writer is CLIP else f"a {writer.name.upper()} has"
    omitted_parts = []
    if state.tracks:
        track_text = counted(len(state.tracks), "thing")
        omitted_parts.append(f"{track_text} with it: {noun} no place")
    if state.system_count:
        omitted_parts.append(
            f"{counted(state.system_count, 'system')}: they are points"
        )
    contents = {
        "shapes": TakePart.SHAPES in state.valued_parts,
        "meshes": bool(state.rig.meshes),
    }
    omitted_parts += [
        f"{content}: {noun} no place for them"
        for content, is_present in contents.items()
        if is_present and content not in writer.holds
    ]
    if state.curves and writer is CLIP:
        omitted_parts.append("curves of controls: keys are fitted to the samples again")
    return _written_step(entry, ["take"], writer.samples, omitted_parts)


def _omitted_parts(
    options: BakeOptions, form: LayerForm, state: _TakeState
) -> Iterator[str]:
    """Yield the parts of a take that USD does not store, each with the reason."""
    yield from _omitted_rig_parts(options, form, state.rig)
    if state.curves and not options.deform:
        if not options.keep_curves:
            yield "curves of controls: not requested (keep_curves)"
        elif name := state.curve_dropping_pass:
            yield f"curves of controls: the pass {name} may change these"
    if TakePart.SHAPES not in state.valued_parts and state.rig.shapes:
        yield "shape weights: the take has none"
    if TakePart.POINTS in state.valued_parts and not options.deform:
        yield "simulated points: not requested (deform)"
    frame_range = options.frame_range
    if frame_range is not None:
        first, last = frame_range.first, frame_range.last
        yield f"frames outside {first} to {last}: not requested"
    if options.sparse:
        yield "joints that stay at rest: sparse"
    if options.reduce is not None:
        yield f"samples that interpolation restores within {options.reduce * 1000:g} mm"


def _omitted_rig_parts(
    options: BakeOptions, form: LayerForm, rig: Rig
) -> Iterator[str]:
    """Yield the parts of a rig that USD does not store, each with the reason."""
    if options.deform:
        yield "skeleton and its animation: points are written instead"
        if not options.velocities:
            yield "velocities: not requested (velocities)"
    elif form is LayerForm.LAYER:
        yield "skeleton and meshes: the rig layer has them"
    elif rig.meshes:
        yield "deformed points: not requested (deform)"
    else:
        yield "meshes: the rig has none"
