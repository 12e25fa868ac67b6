"""What a bake reads and writes: sources, options that go together, files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from animtool.core.arguments import argument
from animtool.core.errors import (
    AnimtoolError,
    Fault,
    FormatError,
    OptionError,
    Severity,
)
from animtool.core.names import is_named
from animtool.core.options import called, clashes, given_options, refused_options
from animtool.core.rates import rate_label
from animtool.core.readers import reader_of
from animtool.core.record import dataclass
from animtool.core.writers import Writer
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.progress import Progress, share_of
from animtool.scene.sources.open import (
    OpenTake,
    fitting_options,
    open_source,
    source_stem,
)
from animtool.usd.layers.jobs import LayerForm, output_paths

if TYPE_CHECKING:
    from animtool.motion.take import TakeStream
    from animtool.scene.scene import Scene

Source: TypeAlias = "Path | str | Scene | OpenTake"


def source_file(source: Source) -> Path:
    """Return the file that a source is read from."""
    return Path(source) if isinstance(source, Path | str) else source.path


@dataclass(frozen=True, slots=True)
class Reading:
    """What is to be read."""

    files: list[Path]  # of the sources, in order
    scenes: dict[Path, Scene]  # what those say that are scenes
    # Of each file the take, where that is open already.
    takes: tuple[TakeStream | None, ...] = ()
    # Of each file the name of the take to read; empty where each is read as it is.
    names: tuple[str, ...] = ()

    @property
    def inputs(self) -> list[Path]:
        """Every file that is named to be read."""
        named = [path for scene in self.scenes.values() for path in scene.inputs]
        return [*self.files, *named]

    @property
    def unused(self) -> list[Fault]:
        """Scenes that state how to bake them, where they are takes of a library."""
        return [] if len(self.files) == 1 else _unused(self.scenes)

    def open(self, options: BakeOptions, progress: Progress = None) -> list[TakeStream]:
        """Return every source, opened; what is wrong with them is said at once."""
        streams: list[TakeStream] = []
        errors: list[AnimtoolError] = []
        for i, (path, take) in enumerate(zip(self.files, self.takes, strict=True)):
            try:
                shown = share_of(progress, i, len(self.files))
                own = options
                if self.names:
                    read = replace(options.source, take=self.names[i])
                    own = replace(options, source=read)
                streams.append(take or self._open_one(path, own, shown))
            except AnimtoolError as error:
                errors.append(error)
        if len(errors) == 1:
            raise errors[0]
        if errors:
            raise type(errors[0])([fault for e in errors for fault in e.faults])
        return streams

    def _open_one(
        self, path: Path, options: BakeOptions, shown: Progress
    ) -> TakeStream:
        """Return a source, opened; over a rig, without what joints cannot hold."""
        try:
            return self._opened(path, options, shown)
        except FormatError as error:
            uneven = any(fault.code == "USD035" for fault in error.faults)
            if not uneven or options.rig_layer is None or options.placement is not None:
                raise
            # The rig may have the same transform: a layer then lacks nothing.
            left = replace(options, placement="drop")
            return self._opened(path, left, shown)

    def _opened(self, path: Path, options: BakeOptions, shown: Progress) -> TakeStream:
        if path in self.scenes:
            scene = self.scenes[path].forced(
                force_fit=options.force_fit, placement=options.placement
            )
            return scene.open(progress=shown)
        own = fitting_options(options.source, path, self.files)
        own = replace(
            own,
            force_fit=options.force_fit,
            shot=options.shot or own.shot,
            placement=options.placement,
        )
        stream = open_source(path, own, progress=shown)
        if stream.details.get("format") == "BVH" and own.up is None:
            from animtool.retarget.standing import with_lying_notice

            stream = with_lying_notice(path, stream)
        return stream


def with_takes(reading: Reading, options: BakeOptions) -> Reading:
    """Return what is to be read with every take of a file that holds several.

    That is a file alone, without a choice of one of its takes.
    """
    if len(reading.files) != 1 or reading.scenes or reading.takes[0] is not None:
        return reading
    (path,) = reading.files
    reader = reader_of(path)
    if reader is None or not reader.takes or options.source.take is not None:
        return reading
    names = reader.take_names(path)
    if len(names) < 2:
        return reading
    many = len(names)
    return Reading([path] * many, {}, (None,) * many, tuple(names))


def found_sources(sources: Sequence[Source]) -> Reading:
    """Return the files of sources, those loaded that are scenes."""
    files = [source_file(source) for source in sources]
    scenes: dict[Path, Scene] = {}
    takes = [one.stream if isinstance(one, OpenTake) else None for one in sources]
    for path, source in zip(files, sources, strict=True):
        if not isinstance(source, Path | str | OpenTake):
            scenes[path] = source
        elif is_named(path, "scene") and not isinstance(source, OpenTake):
            from animtool.scene.file.read import load_scene

            scenes[path] = load_scene(path)
    return Reading(files, scenes, tuple(takes))


def _unused(scenes: dict[Path, Scene]) -> list[Fault]:
    """Say so where a take of a library is a scene that states how to bake it."""
    message = "the scene's fps, range and output are ignored here"
    hint = "set them once for the whole library, on the command"
    return [
        Fault("CLI103", message, str(path), (), hint, Severity.WARNING)
        for path, scene in scenes.items()
        if scene.bake != BakeOptions()
    ]


def check_options(
    options: BakeOptions, *, to_stdout: bool, simulated: bool = False
) -> None:
    """Raise `OptionError` where options exclude each other.

    Args:
        options: Of the bake.
        to_stdout: Whether the output is no file.
        simulated: Whether systems are written.
    """
    form = options.form or ("layer" if options.rig_layer else "stage")
    wrong = _layer_clashes(options, form)
    if form == "library":
        wrong += _library_clashes(options, to_stdout=to_stdout)
    wrong.append(
        (
            form == "split" and to_stdout,
            f"{argument('form', 'split')} writes three files, not stdout",
        )
    )
    wrong += [(True, message) for message in clashes(options)]
    wrong += _shot_clashes(options, form)
    wrong += _deform_clashes(options, form)
    wrong += _chunk_clashes(options, to_stdout=to_stdout, simulated=simulated)
    lonely = options.keep_stopped and not simulated
    wrong.append(
        (lonely, f"{argument('keep_stopped', True)} needs a scene with systems")
    )
    faults = [Fault("CLI002", message) for holds, message in wrong if holds]
    if faults:
        raise OptionError(faults)


def _layer_clashes(options: BakeOptions, form: str) -> list[tuple[bool, str]]:
    """Return what animation over a rig layer does not go with, and whether it is so."""
    refused = (given.over_layer for given in given_options(options).values())
    return [
        (
            form == "layer" and options.rig_layer is None,
            f"{argument('form', 'layer')} needs {argument('rig_layer')}",
        ),
        (
            form != "layer" and options.rig_layer is not None,
            f"{argument('rig_layer')} needs {argument('form', 'layer')}",
        ),
        *((form == "layer", reason) for reason in dict.fromkeys(filter(None, refused))),
    ]


def _library_clashes(
    options: BakeOptions, *, to_stdout: bool
) -> list[tuple[bool, str]]:
    """Return what a take of a library does not go with, and whether it is asked for."""
    flags = [argument("output", "-")] if to_stdout else []
    flags += refused_options(options, "library")
    return [(True, f"a take of a library cannot use {flag}") for flag in flags]


def _shot_clashes(options: BakeOptions, form: str) -> list[tuple[bool, str]]:
    """Return what excludes a shot that places its media, and whether it is so."""
    shot = options.shot
    if shot is None or not shot.places_media or shot.fps is None:
        return []
    named = f"shot {shot.name}" if shot.name else "the shot"
    return [
        (
            options.fps != shot.fps,
            f"{argument('fps', options.fps)} differs from the rate of {named}, "
            f"{rate_label(shot.fps)}",
        ),
        (
            options.start is not None,
            f"{argument('start')}: {named} begins at {shot.start}, as its timeline "
            "states",
        ),
        (form == "library", f"{named} is not a take of a library"),
    ]


def _chunk_clashes(
    options: BakeOptions, *, to_stdout: bool, simulated: bool
) -> list[tuple[bool, str]]:
    """Return what chunks do not go with, and whether it is asked for."""
    if options.chunk is None:
        return []
    if not (options.deform or simulated):
        return [
            (
                True,
                f"{argument('chunk')} needs {argument('deform', True)}, or a scene "
                "with systems",
            )
        ]
    message = (
        f"{argument('chunk')} needs at least 1 sample per file, not {options.chunk}"
    )
    return [
        (to_stdout, f"{argument('chunk')} writes several files, not stdout"),
        (options.chunk < 1, message),
    ]


def _deform_clashes(options: BakeOptions, form: str) -> list[tuple[bool, str]]:
    """Return what does not go with point caches, and whether it is asked for."""
    if not options.deform:
        return []
    joints = f"{argument('deform', True)} writes points, not joints"
    flags = [argument("form", "split")] if form == "split" else []
    flags += refused_options(options, "deform")
    return [(True, f"{joints}: no {flag}") for flag in flags]


def check_file_options(options: BakeOptions, writer: Writer, path: Path) -> None:
    """Raise `OptionError` where options are for USD or for keys, and the output not."""
    faults = []
    for name, given in given_options(options).items():
        if name in writer.options or "file" not in given.not_for:
            continue
        if name == "reduce":
            faults.append(of_keys(called(name, given), path))
            continue
        message = f"{called(name, given)} applies to USD, not to {path}"
        faults.append(Fault("CLI002", message))
    if not faults:
        faults = [Fault("CLI002", message) for message in clashes(options)]
    if faults:
        raise OptionError(faults)


def of_keys(name: str, path: Path) -> Fault:
    """Return the fault of an option of keys, where a file holds samples (CLI004)."""
    message = f"{name} applies to keys, but this output holds samples"
    hint = f"write a .clip.yaml, or bake to USD with {argument('reduce')}"
    return Fault("CLI004", message, str(path), (), hint)


def default_output(source: Path) -> Path:
    """Return the file that a source is written to where none is named.

    >>> default_output(Path("takes/wave.scene.yaml")).name
    'wave.usdc'
    """
    return source.with_name(f"{source_stem(source)}.usdc")


def form_of(options: BakeOptions) -> LayerForm:
    """Return what is written."""
    return LayerForm(
        options.form or (LayerForm.LAYER if options.rig_layer else LayerForm.STAGE)
    )


def check_package(path: Path, options: BakeOptions) -> None:
    """Refuse a package of several files that are written beside it (OUT004)."""
    form = form_of(options)
    refused = {
        LayerForm.SPLIT: argument("form", "split"),
        LayerForm.LIBRARY: argument("form", "library"),
    }.get(form)
    if options.chunk is not None:
        refused = argument("chunk")
    if refused is not None:
        message = f"a package is one file, but {refused} writes several or adds to one"
        hint = "write .usdc"
        raise OptionError(Fault("OUT004", message, str(path), (), hint))


def output_files(
    path: Path, options: BakeOptions, *, simulated: bool = False
) -> list[Path]:
    """Return the files to write; of chunks, those that they may replace.

    simulated: whether systems are written.
    """
    files = output_paths(path, form_of(options))
    if options.chunk is None:
        return files
    from animtool.usd.layers.chunks import point_files, system_files

    sets = [point_files(path)] if options.deform else []
    sets += [system_files(path)] if simulated else []
    chunks = [file for one in sets for file in (one.manifest, *one.existing_chunks())]
    return [*files, *chunks]
