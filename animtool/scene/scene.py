"""A scene: sources, passes over them, systems and outputs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import field, fields, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, cast

from animtool.core.arguments import argument, file_key
from animtool.core.array_types import FloatArray
from animtool.core.errors import AnimtoolError, Fault, FormatError, OptionError
from animtool.core.plugins import load_object
from animtool.core.record import dataclass
from animtool.core.shot import Shot
from animtool.motion.driving import drive_stream, drop_repeated_notices
from animtool.motion.motion import Motion
from animtool.motion.passes import PassContext, apply_pass
from animtool.motion.take import Take, TakeStream
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.progress import BlockProgress, Meter, Progress, with_progress
from animtool.scene.file.entries import (
    EntryLocation,
    SceneOutput,
    ScenePass,
    SceneProp,
    SceneSource,
    SceneSystem,
)
from animtool.scene.file.pass_order import with_order_hints
from animtool.scene.sources.open import SourceOptions, open_checked, open_source
from animtool.scene.sources.retime import (
    Preroll,
    drop_first_frames,
    in_shot,
    with_preroll,
)

if TYPE_CHECKING:
    from animtool.rig.placement import Placement
    from animtool.scene.sources.props import OpenProp


# Rate of a scene without a source that states none.
DEFAULT_FPS = Fraction(24)


@dataclass(frozen=True, slots=True)
class Scene:
    """The content of a scene file: what is read, changed, simulated and written."""

    path: Path
    # Sources, at least one; the first has the rig and the frames.
    sources: tuple[SceneSource, ...]
    passes: tuple[ScenePass, ...]  # in order
    outputs: tuple[SceneOutput, ...]  # at least one
    rig: Path | None = None  # rig of all sources; None uses the first source's rig
    props: tuple[SceneProp, ...] = ()
    # Frame of the shot at the first frame of the sources; None is as they state.
    first_frame: Fraction | None = None
    # Number of frames before the take at which passes with a state begin; None is none.
    preroll: Preroll | None = None
    # Names of the variables that it uses or sets.
    variables: frozenset[str] = frozenset()
    unused_variables: frozenset[str] = frozenset()  # variables that no text uses
    # Variables that affect more than the outputs.
    effective_variables: frozenset[str] = frozenset()
    notices: tuple[Fault, ...] = ()  # warnings of the file itself
    # Measures the stages whenever it is opened.
    meter: Meter = field(default_factory=Meter, compare=False, repr=False)
    # Systems, simulated with the source or without one.
    systems: tuple[SceneSystem, ...] = ()

    @property
    def output(self) -> Path | None:
        """File of the first output; None if the scene names no output."""
        return self.outputs[0].path

    @property
    def bake(self) -> BakeOptions:
        """Options of the first output."""
        return self.outputs[0].bake

    @property
    def inputs(self) -> list[Path]:
        """Every input file that the scene names, including the scene file."""
        folder = self.path.resolve().parent
        paths = [self.path, *(source.path for source in self.sources)]
        paths += [self.rig] if self.rig is not None else []
        for prop in self.props:
            paths += [prop.file, *filter(None, [prop.reference])]
        for system in self.systems:
            paths += system.setup.files
        for scene_pass in self.passes:
            values = (
                getattr(scene_pass.options, f.name) for f in fields(scene_pass.options)
            )
            paths += [folder / path for path in values if isinstance(path, Path)]
            paths += scene_pass.files
        return paths

    @property
    def extra_outputs(self) -> list[Path]:
        """Files that passes and systems write in addition to the outputs."""
        folder = self.path.resolve().parent
        names: list[str] = []
        for scene_pass in self.passes:
            names += getattr(scene_pass.options, "writes", ())
        for system in self.systems:
            names += system.setup.writes
        return [folder / name for name in names]

    def for_output(self, output: SceneOutput) -> Scene:
        """Return the scene with one output, and the systems that this output needs."""
        if output.systems is None or not self.systems:
            return replace(self, outputs=(output,))
        from animtool.scene.systems.links import with_dependencies

        written_indices = [
            i for i, system in enumerate(self.systems) if system.name in output.systems
        ]
        systems = tuple(
            replace(self.systems[i], is_written=i in written_indices)
            for i in with_dependencies(self.systems, written_indices)
        )
        return replace(self, outputs=(output,), systems=systems)

    def with_source_options(
        self, *, force_fit: bool, placement: str | None = None
    ) -> Scene:
        """Return a copy with options of `SourceOptions` set on all its sources.

        Options that are False or None keep the values of the sources.
        """
        if not force_fit and placement is None:
            return self
        sources = []
        for source in self.sources:
            is_forced = force_fit or source.options.force_fit
            options = replace(source.options, force_fit=is_forced, placement=placement)
            sources.append(replace(source, options=options))
        return replace(self, sources=tuple(sources))

    def with_shot(self, shot: Shot) -> Scene:
        """Return a copy whose take is placed in time by a shot of a timeline.

        Time codes of the take become frames of the shot. The scene may override the
        cut, the handles or the range.
        """
        faults: list[Fault] = []
        outputs: list[SceneOutput] = []
        for output in self.outputs:
            bake, placed_shot = output.bake, shot
            if bake.start is not None:
                message = "the timeline already places the start of the take"
                hint = "remove start; start_frame in metadata.animtool of the clip "
                hint += f"moves the shot, which begins at {shot.start}"
                faults.append(output.location.fault("SCN073", message, hint))
            if bake.fps not in {None, shot.fps}:
                message = f"fps is {bake.fps}, but the shot has {shot.fps}"
                faults.append(output.location.fault("SCN073", message, "write ${fps}"))
            if (cut := bake.shot) is not None:
                placed_shot = shot.recut(cut.cut_in, cut.cut_out, cut.head, cut.tail)
            bake = replace(bake, shot=placed_shot, fps=shot.fps)
            outputs.append(replace(output, bake=bake))
        if faults:
            raise OptionError(list(dict.fromkeys(faults)))
        preroll = self.preroll and replace(self.preroll, start=None, fps=shot.fps)
        return replace(self, outputs=tuple(outputs), preroll=preroll)

    def open(
        self, *, writes_files: bool = True, progress: Progress = None
    ) -> TakeStream:
        """Return the joined sources as a stream, with all passes applied.

        Args:
            writes_files: Whether passes write files of their own, as in a bake.
            progress: Called with the fraction done, 0 to 1, until the blocks are read.
        """
        slow_pass_count = sum(
            scene_pass.pass_.reports_progress for scene_pass in self.passes
        )
        block_progress = progress and BlockProgress(progress, slow_pass_count)
        stream = self._metered_source(
            None if block_progress is None else block_progress.read
        )
        context = self._context(writes_files=writes_files)
        props = self._open_props(stream)
        dropped_placement = stream.dropped
        stream = self._with_props(stream, props, dropped_placement, is_retimed=True)
        pass_index = 0
        for scene_pass in self.passes:
            pass_context = context
            if block_progress is not None and scene_pass.pass_.reports_progress:
                pass_progress = block_progress.of_pass(pass_index)
                pass_context = replace(context, progress=pass_progress)
                pass_index += 1
            stream = self._apply_pass(stream, scene_pass, pass_context)
        stream = self._with_props(stream, props, dropped_placement, is_retimed=False)
        if block_progress is not None:
            stream.blocks = block_progress.blocks(stream.blocks)
        return stream

    def steps(self) -> Iterator[tuple[Take, TakeStream]]:
        """Yield the source and the result of each pass, as takes and as streams.

        Props that no pass retimes are not included. Passes write no files.
        """
        source = self._metered_source()
        props = self._open_props(source)
        source_with_props = self._with_props(
            source, props, source.dropped, is_retimed=True
        )
        take, stream = _collect_stream(source_with_props)
        yield take, stream
        context = self._context(writes_files=False)
        for scene_pass in self.passes:
            take, stream = _collect_stream(
                self._apply_pass(stream, scene_pass, context)
            )
            yield take, stream

    def apply_scene_pass(self, stream: TakeStream, scene_pass: ScenePass) -> TakeStream:
        """Return the result of a pass on a take; the pass writes no files."""
        return self._apply_pass(stream, scene_pass, self._context(writes_files=False))

    def _context(self, *, writes_files: bool) -> PassContext:
        shot = self.bake.shot
        return PassContext(
            self._read_take,
            self.path.resolve().parent,
            writes_files=writes_files,
            in_shot=shot is not None and shot.places_media,
            simulate_segments=self._simulate_segments,
            build_colliders=self._add_colliders,
        )

    def _add_colliders(
        self, stream: TakeStream, options: object, lead_seconds: float
    ) -> tuple[TakeStream, object]:
        # Loaded by name, like all systems.
        with_colliders = load_object("animtool.scene.systems.attached:with_colliders")
        add_colliders = cast("Callable[..., tuple[TakeStream, object]]", with_colliders)
        return add_colliders(self.systems, self.path, stream, options, lead_seconds)

    def _simulate_segments(
        self, take: Take, system: str, particle: str, progress: Progress
    ) -> FloatArray:
        # Loaded by name, since systems open scenes themselves.
        loaded_function = load_object("animtool.scene.systems.segments:segments_of")
        segments_of = cast("Callable[..., FloatArray]", loaded_function)
        shot, lead_seconds = self.bake.shot, 0.0
        if shot is not None and shot.places_media:
            # If a shot begins before its take, the take's first pose is held.
            lead_time = take.clock.start - shot.start
            lead_seconds = max(0.0, float(lead_time / take.clock.fps))
        return segments_of(
            self.systems, self.path, take, system, particle, progress, lead_seconds
        )

    def _metered_source(self, progress: Progress = None) -> TakeStream:
        """Return the joined sources in frames of the shot, and meter their cost."""
        self.meter.stages.clear()
        if not self.sources:
            message = "is simulated, and has no source with joints"
            hint = "bake it without options for characters"
            raise OptionError(Fault("SCN062", message, str(self.path), (), hint))
        first_source = self.sources[0]
        source_cost = self.meter.stage(
            first_source.path.name, first_source.location.where
        )
        with self.meter.running(source_cost):
            stream = in_shot(self._joined_sources(progress), self.bake.shot)
        stream.curve = self.meter.curve(source_cost, stream.curve)
        stream.blocks = self.meter.blocks(source_cost, stream.blocks)
        return stream

    def _open_props(self, stream: TakeStream) -> Sequence[OpenProp]:
        """Open all props, or raise the faults of all props together."""
        if not self.props:
            return ()
        from animtool.scene.sources.props import open_props

        file, up = self.sources[0].path, stream.rig.up
        return open_props(self.props, file, up, self.meter, stream.notices)

    def _with_props(
        self,
        stream: TakeStream,
        props: Sequence[OpenProp],
        dropped_placement: Callable[[FloatArray], Placement] | None,
        *,
        is_retimed: bool,
    ) -> TakeStream:
        """Return a take with the props added that passes retime, or all other props."""
        matching_props = [prop for prop in props if prop.entry.is_retimed is is_retimed]
        if not matching_props:
            return stream
        from animtool.scene.sources.props import with_props

        return with_props(
            stream, matching_props, self.first_frame, self.bake.fps, dropped_placement
        )

    @contextmanager
    def located_props(self) -> Iterator[None]:
        """Locate faults of props that a block raises at their entries in the file."""
        locations = {prop.path: prop.location for prop in self.props}
        try:
            yield
        except OptionError as error:
            if not all(fault.where in locations for fault in error.faults):
                raise
            faults = [
                locations[str(fault.where)].locate(fault) for fault in error.faults
            ]
            raise FormatError(faults) from error

    def _apply_pass(
        self, stream: TakeStream, scene_pass: ScenePass, context: PassContext
    ) -> TakeStream:
        """Return the result of a pass on a take, charged to the meter.

        All notices of the pass are located at its entry, including those that appear
        while blocks are read.
        """
        pass_notices: list[Fault] = []
        notices, details, scores = stream.notices, stream.details, stream.scores
        context = replace(context, scores=[])
        pass_cost = self.meter.stage(scene_pass.pass_.name, scene_pass.location.where)
        context.errors.clear()
        with (
            self.meter.running(pass_cost),
            with_order_hints(self.passes, scene_pass, context.folder),
            scene_pass.location.located(),
        ):
            stream = self._apply_with_preroll(
                scene_pass, replace(stream, notices=pass_notices), context
            )
        pass_notices += context.notices
        context.notices.clear()

        def collect_results() -> None:
            new_notices = drop_repeated_notices(pass_notices, notices)
            notices.extend(map(scene_pass.location.locate, new_notices))
            pass_notices.clear()
            name, key = scene_pass.pass_.name, scene_pass.location.where
            scores.extend(score.with_pass(name, key) for score in context.scores)
            context.scores.clear()

        collect_results()
        pass_cost.error = max(context.errors, default=None)
        blocks = _located_blocks(scene_pass.location, stream.blocks, collect_results)
        stream = replace(stream, blocks=self.meter.blocks(pass_cost, blocks))
        return replace(stream, notices=notices, details=details, scores=scores)

    def until(self, last_pass: str) -> Scene:
        """Return a copy with only the passes up to ``last_pass``.

        This is the last pass to run, by name or number from 1; 0 runs none.
        """
        names = [scene_pass.pass_.name for scene_pass in self.passes]
        matching_numbers = [i for i, name in enumerate(names, 1) if name == last_pass]
        if last_pass.isdecimal() and int(last_pass) <= len(names):
            matching_numbers = [int(last_pass)]
        if len(matching_numbers) == 1:
            return replace(self, passes=self.passes[: matching_numbers[0]])
        numbered_names = ", ".join(f"{i} {name}" for i, name in enumerate(names, 1))
        message = f"the scene has no pass {last_pass!r}"
        hint = f"its passes are {numbered_names}"
        if last_pass.isdecimal():
            message = f"the scene has no pass number {last_pass}"
        if matching_numbers:
            message = f"several passes of the scene are called {last_pass!r}"
            hint = f"use a number: {numbered_names}"
        elif len(names) == 1:
            hint = f"its only pass is {numbered_names}"
        elif not names:
            message = "the scene has no passes"
            hint = f"remove {argument('command.until')}"
        raise OptionError(Fault("SCN043", message, str(self.path), (), hint))

    def _apply_with_preroll(
        self, scene_pass: ScenePass, stream: TakeStream, context: PassContext
    ) -> TakeStream:
        """Return a take with a pass applied, including the preroll the pass needs."""
        lead_frames = 0
        if scene_pass.pass_.needs_preroll and self.preroll is not None:
            lead_frames = self.preroll.missing_frame_count(stream)
        if not lead_frames:
            return apply_pass(stream, scene_pass.pass_, scene_pass.options, context)
        stream_with_lead = with_preroll(stream, lead_frames)
        context = replace(context, prepended_frames=lead_frames)
        passed_stream = apply_pass(
            stream_with_lead, scene_pass.pass_, scene_pass.options, context
        )
        return drop_first_frames(passed_stream, lead_frames, stream.start)

    def _joined_sources(self, progress: Progress) -> TakeStream:
        """Open all sources and join them; raise the faults of all together."""
        if len(self.sources) == 1:
            (source,) = self.sources
            stream = self._open_source(source, progress)
            if progress is not None and stream.count:
                stream.blocks = with_progress(stream.blocks, stream.count, progress)
            return stream
        from animtool.scene.sources.joining import JoinedSource, join_sources

        joined_sources: list[JoinedSource] = []
        faults: list[Fault] = []
        for source in self.sources:
            try:
                stream = self._open_source(source)
            except AnimtoolError as error:
                faults += map(source.location.locate, error.faults)
                continue
            joined_sources.append(JoinedSource(stream, source))
        if faults:
            raise FormatError(faults)
        location = self.sources[0].location
        with location.located():
            stream = join_sources(joined_sources[0], joined_sources[1:])
            stream = drive_stream(stream, reports_replaced=True)
        return replace(stream, blocks=_located_blocks(location, stream.blocks))

    def _open_source(
        self, source: SceneSource, progress: Progress = None
    ) -> TakeStream:
        reported_codes = {notice.code for notice in self.notices}
        return open_checked(
            source.path,
            source.options,
            namer=file_key,
            reported_codes=reported_codes,
            progress=progress,
        )

    def _read_take(self, path: Path) -> Take:
        return open_source(path, SourceOptions(rig=self.rig)).collect()


def _located_blocks(
    location: EntryLocation,
    blocks: Iterator[Motion],
    on_end: Callable[[], None] | None = None,
) -> Iterator[Motion]:
    """Yield blocks with their faults located at an entry; then call ``on_end``."""
    with location.located():
        yield from blocks
    if on_end is not None:
        on_end()


def _collect_stream(stream: TakeStream) -> tuple[Take, TakeStream]:
    """Read a stream; return its take, and a stream of that take in one block."""
    take = stream.collect()
    return take, replace(stream, blocks=iter([take.motion]))
