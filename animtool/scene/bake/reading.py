"""The sources, options and output files of a bake."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from animtool.core.arguments import argument
from animtool.core.errors import AnimtoolError, Fault, FormatError, OptionError, warning
from animtool.core.names import has_kind_suffix
from animtool.core.options import (
    changed_options,
    clash_messages,
    option_marker,
    refused_options,
)
from animtool.core.rates import rate_label
from animtool.core.readers import reader_of
from animtool.core.record import dataclass
from animtool.core.writers import Writer
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.progress import Progress, part_progress
from animtool.scene.sources.open import (
    OpenTake,
    fitting_options,
    open_checked,
    source_stem,
)
from animtool.usd.layers.jobs import LayerForm, output_paths

if TYPE_CHECKING:
    from animtool.motion.take import TakeStream
    from animtool.scene.scene import Scene

Source: TypeAlias = "Path | str | Scene | OpenTake"


def source_file(source: Source) -> Path:
    """Return the path of a source, which is a file or a loaded scene."""
    return Path(source) if isinstance(source, Path | str) else source.path


@dataclass(frozen=True, slots=True)
class SourceSet:
    """The sources of a bake: files, loaded scenes and open takes."""

    files: list[Path]  # files of the sources, in order
    scenes: dict[Path, Scene]  # loaded scenes that are sources, by file
    # The take of each file, if it is open already.
    takes: tuple[TakeStream | None, ...] = ()
    # Name of the take to read from each file; empty to read each file as a whole.
    names: tuple[str, ...] = ()

    @property
    def inputs(self) -> list[Path]:
        """Every input file: the sources and the files that scenes refer to."""
        paths = [path for scene in self.scenes.values() for path in scene.inputs]
        return [*self.files, *paths]

    @property
    def unused_option_warnings(self) -> list[Fault]:
        """Warnings about bake options of scenes that are ignored in a library."""
        message = "the scene's fps, range and output are ignored here"
        hint = "set them once for the whole library, on the command"
        return [
            warning("CLI103", message, hint).in_file(path)
            for path, scene in self.scenes.items()
            if len(self.files) > 1 and scene.bake != BakeOptions()
        ]

    def open(self, options: BakeOptions, progress: Progress = None) -> list[TakeStream]:
        """Open every source, or raise the faults of all sources together."""
        from animtool.motion.quaternion_order import with_order_warning

        streams: list[TakeStream] = []
        errors: list[AnimtoolError] = []
        for i, (path, take) in enumerate(zip(self.files, self.takes, strict=True)):
            try:
                source_progress = part_progress(progress, i, len(self.files))
                if self.names:
                    take_options = replace(options.source, take=self.names[i])
                    options = replace(options, source=take_options)
                if take is None:
                    streams.append(self._open_source(path, options, source_progress))
                else:
                    streams.append(with_order_warning(take, str(path)))
            except AnimtoolError as error:
                errors.append(error)
        if len(errors) == 1:
            raise errors[0]
        if errors:
            raise type(errors[0])([fault for error in errors for fault in error.faults])
        return streams

    def _open_source(
        self, path: Path, options: BakeOptions, source_progress: Progress
    ) -> TakeStream:
        """Open a source, without a placement that the joints of a rig cannot store."""
        try:
            return self._open_path(path, options, source_progress)
        except FormatError as error:
            is_unstorable = any(fault.code == "USD035" for fault in error.faults)
            keeps_placement = options.rig_layer is None or options.placement is not None
            if keeps_placement or not is_unstorable:
                raise
            # If the rig has the same transform, the layer loses nothing.
            without_placement = replace(options, placement="drop")
            return self._open_path(path, without_placement, source_progress)

    def _open_path(
        self, path: Path, options: BakeOptions, source_progress: Progress
    ) -> TakeStream:
        if path in self.scenes:
            scene = self.scenes[path].with_source_options(
                force_fit=options.force_fit, placement=options.placement
            )
            return scene.open(progress=source_progress)
        source_options = fitting_options(options.source, path, self.files)
        source_options = replace(
            source_options,
            force_fit=options.force_fit,
            shot=options.shot or source_options.shot,
            placement=options.placement,
        )
        return open_checked(path, source_options, progress=source_progress)


def split_takes(sources: SourceSet, options: BakeOptions) -> SourceSet:
    """Return one source per take of a file, if it is the only file and has several.

    Otherwise, or if the options choose a take, the sources are unchanged.
    """
    if len(sources.files) != 1 or sources.scenes or sources.takes[0] is not None:
        return sources
    (path,) = sources.files
    reader = reader_of(path)
    if reader is None or not reader.takes or options.source.take is not None:
        return sources
    names = reader.take_names(path)
    if len(names) < 2:
        return sources
    return SourceSet([path] * len(names), {}, (None,) * len(names), tuple(names))


def source_set(sources: Sequence[Source]) -> SourceSet:
    """Return the sources and their files; scenes are loaded."""
    files = [source_file(source) for source in sources]
    scenes: dict[Path, Scene] = {}
    takes = [
        source.stream if isinstance(source, OpenTake) else None for source in sources
    ]
    for path, source in zip(files, sources, strict=True):
        if not isinstance(source, Path | str | OpenTake):
            scenes[path] = source
        elif has_kind_suffix(path, "scene") and not isinstance(source, OpenTake):
            from animtool.scene.file.read import load_scene

            scenes[path] = load_scene(path)
    return SourceSet(files, scenes, tuple(takes))


def check_options(
    options: BakeOptions, *, is_stdout: bool, has_systems: bool = False
) -> None:
    """Raise an error with every pair of options that exclude each other (CLI002).

    Some exclude output to stdout, or need an output with systems.
    """
    form = options.form or ("layer" if options.rig_layer else "stage")
    clashes = [
        *_layer_clashes(options, form),
        *(_library_clashes(options, is_stdout=is_stdout) if form == "library" else ()),
    ]
    if form == "split" and is_stdout:
        clashes.append(f"{argument('form', 'split')} writes three files, not stdout")
    clashes += clash_messages(options)
    clashes += _shot_clashes(options, form)
    clashes += _deform_clashes(options, form)
    clashes += _chunk_clashes(options, is_stdout=is_stdout, has_systems=has_systems)
    if options.keep_stopped and not has_systems:
        clashes.append(f"{argument('keep_stopped', True)} needs a scene with systems")
    if clashes:
        raise OptionError([Fault("CLI002", message) for message in clashes])


def _layer_clashes(options: BakeOptions, form: str) -> Iterator[str]:
    """Yield messages about options that clash with a rig layer."""
    if form == "layer" and options.rig_layer is None:
        yield f"{argument('form', 'layer')} needs {argument('rig_layer')}"
    if form != "layer" and options.rig_layer is not None:
        yield f"{argument('rig_layer')} needs {argument('form', 'layer')}"
    if form == "layer":
        reasons = (option.layer_refusal for option in changed_options(options).values())
        yield from dict.fromkeys(filter(None, reasons))


def _library_clashes(options: BakeOptions, *, is_stdout: bool) -> Iterator[str]:
    """Yield messages about options that a take of a library cannot use."""
    flags = [argument("output", "-")] if is_stdout else []
    for flag in (*flags, *refused_options(options, "library")):
        yield f"a take of a library cannot use {flag}"


def _shot_clashes(options: BakeOptions, form: str) -> Iterator[str]:
    """Yield messages about options that clash with a placed shot."""
    shot = options.shot
    if shot is None or not shot.places_media or shot.fps is None:
        return
    shot_name = f"shot {shot.name}" if shot.name else "the shot"
    if options.fps != shot.fps:
        fps = argument("fps", options.fps)
        yield f"{fps} differs from the rate of {shot_name}, {rate_label(shot.fps)}"
    if options.start is not None:
        start = argument("start")
        yield f"{start}: {shot_name} begins at {shot.start}, as its timeline states"
    if form == "library":
        yield f"{shot_name} is not a take of a library"


def _chunk_clashes(
    options: BakeOptions, *, is_stdout: bool, has_systems: bool
) -> Iterator[str]:
    """Yield messages about options that clash with chunks."""
    chunk = argument("chunk")
    if options.chunk is None:
        return
    if not (options.deform or has_systems):
        yield f"{chunk} needs {argument('deform', True)}, or a scene with systems"
        return
    if is_stdout:
        yield f"{chunk} writes several files, not stdout"
    if options.chunk < 1:
        yield f"{chunk} needs at least 1 sample per file, not {options.chunk}"


def _deform_clashes(options: BakeOptions, form: str) -> Iterator[str]:
    """Yield messages about options that clash with point caches."""
    if not options.deform:
        return
    flags = [argument("form", "split")] if form == "split" else []
    for flag in (*flags, *refused_options(options, "deform")):
        yield f"{argument('deform', True)} writes points, not joints: no {flag}"


def check_file_options(options: BakeOptions, writer: Writer, path: Path) -> None:
    """Raise `OptionError` for USD or key options that the output cannot use."""
    faults = []
    for name, option in changed_options(options).items():
        if name in writer.options or "file" not in option.not_for:
            continue
        if name == "reduce":
            faults.append(key_option_fault(option_marker(name, option), path))
            continue
        message = f"{option_marker(name, option)} applies to USD, not to {path}"
        faults.append(Fault("CLI002", message))
    if not faults:
        faults = [Fault("CLI002", message) for message in clash_messages(options)]
    if faults:
        raise OptionError(faults)


def key_option_fault(name: str, path: Path) -> Fault:
    """Return a fault for an option of keys with a file that holds samples (CLI004)."""
    message = f"{name} applies to keys, but this output holds samples"
    hint = f"write a .clip.yaml, or bake to USD with {argument('reduce')}"
    return Fault("CLI004", message, str(path), (), hint)


def default_output(source: Path) -> Path:
    """Return the default output of a source.

    >>> default_output(Path("takes/wave.scene.yaml")).name
    'wave.usdc'
    """
    return source.with_name(f"{source_stem(source)}.usdc")


def layer_form(options: BakeOptions) -> LayerForm:
    """Return the form of the output layer that the options request."""
    return LayerForm(
        options.form or (LayerForm.LAYER if options.rig_layer else LayerForm.STAGE)
    )


def check_package(path: Path, options: BakeOptions) -> None:
    """Raise OUT004 for a package if the options write several files or add to one."""
    form = layer_form(options)
    refused_form = {
        LayerForm.SPLIT: argument("form", "split"),
        LayerForm.LIBRARY: argument("form", "library"),
    }.get(form)
    if options.chunk is not None:
        refused_form = argument("chunk")
    if refused_form is not None:
        message = f"a package is one file, but {refused_form} writes several or adds "
        message += "to one"
        raise OptionError(Fault("OUT004", message, str(path), (), "write .usdc"))


def output_files(
    path: Path, options: BakeOptions, *, has_systems: bool = False
) -> list[Path]:
    """Return the files to write, including existing chunk files that may be replaced.

    With ``simulated``, these include chunks of systems.
    """
    files = output_paths(path, layer_form(options))
    if options.chunk is None:
        return files
    from animtool.usd.layers.chunks import point_clip_files, system_clip_files

    file_sets = [point_clip_files(path)] if options.deform else []
    file_sets += [system_clip_files(path)] if has_systems else []
    for file_set in file_sets:
        files += [file_set.manifest, *file_set.existing_chunks()]
    return files
