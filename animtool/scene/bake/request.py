"""The requested outputs of a bake, checked before any source is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

from animtool.core.arguments import argument
from animtool.core.errors import AnimtoolError, Fault, OptionError
from animtool.core.files.commit import output_target
from animtool.core.files.output import STDOUT, check_outputs, name_key
from animtool.core.loaded import check_loaded
from animtool.core.readers import USD_PACKAGE_SUFFIX
from animtool.core.record import dataclass
from animtool.core.writers import take_writer, writer_of, writes_stage
from animtool.scene.bake.options import BakeOptions, with_fallbacks
from animtool.scene.bake.reading import (
    Source,
    SourceSet,
    check_file_options,
    check_options,
    check_package,
    layer_form,
    output_files,
    source_set,
    split_takes,
)
from animtool.scene.sources.open import source_stem
from animtool.usd.layers.jobs import LayerForm, check_path

if TYPE_CHECKING:
    from animtool.scene.file.entries import EntryLocation
    from animtool.scene.scene import Scene


@dataclass(frozen=True, slots=True)
class OutputEntry:
    """A requested output of a bake: the file, its options and its systems."""

    path: Path  # the file to write, or `STDOUT`
    options: BakeOptions  # options of the bake, with those of the scene
    # The scene, with only the systems of this output; None if there is no scene.
    scene: Scene | None = None
    # Location of the output in the scene file, if the scene names it.
    location: EntryLocation | None = None
    # For a clip: the base take of an additive take, and the rig file.
    base: Path | None = None
    rig_file: Path | None = None

    @property
    def has_systems(self) -> bool:
        """Whether the output contains simulated systems."""
        return self.scene is not None and bool(self.scene.systems)

    def locate(self, fault: Fault) -> Fault:
        """Return a fault of the file, located where the scene names the file.

        A fault of an existing file keeps its own location.
        """
        if self.location is None or fault.code == "OUT001":
            return fault
        if fault.path == str(self.path):
            key = "file" if fault.code.startswith("OUT") else fault.where
            fault = replace(fault, path=None, where=key)
        return self.location.locate(fault)

    @property
    def is_stage(self) -> bool:
        """Whether the output is written as USD."""
        return self.path == STDOUT or writes_stage(self.path)

    @property
    def name(self) -> str:
        """Path of the file, or ``stdout``."""
        return "stdout" if self.path == STDOUT else str(self.path)

    @property
    def files(self) -> list[Path]:
        """Files to write, including existing chunk files that the bake may replace."""
        if self.path == STDOUT:
            return []
        if self.is_stage:
            return output_files(self.path, self.options, has_systems=self.has_systems)
        format_writer = writer_of(self.path)
        if format_writer is None or self.rig_file is not None:
            return [self.path]
        return format_writer.files(self.path)


@dataclass(frozen=True, slots=True)
class BakeRequest:
    """The sources and requested outputs of a bake, before anything is read."""

    source_set: SourceSet
    outputs: tuple[OutputEntry, ...]
    notices: list[Fault]  # of the scenes

    @property
    def scene(self) -> Scene | None:
        """The scene, if it is the only source."""
        files, scenes = self.source_set.files, self.source_set.scenes
        return scenes.get(files[0]) if len(files) == 1 else None

    @property
    def with_overwrite(self) -> BakeRequest:
        """A copy that overwrites existing files."""
        outputs = (
            replace(entry, options=replace(entry.options, overwrite=True))
            for entry in self.outputs
        )
        return replace(self, outputs=tuple(outputs))

    @property
    def files(self) -> list[Path]:
        """Every file that the outputs write, in their order."""
        return [path for entry in self.outputs for path in entry.files]


def create_request(
    sources: Source | Sequence[Source],
    output: Path | str | None,
    options: BakeOptions | None = None,
    *,
    base: Path | None = None,
    rig_file: Path | None = None,
) -> BakeRequest:
    """Return the request of a bake from sources and options, unchecked.

    Args:
        sources: Files, scenes or open takes to read.
        output: The file, or `STDOUT`; None is what a scene names, else stdout.
        options: Options that override those of a scene.
        base: For a clip: base take of an additive take.
        rig_file: For a clip: its rig file, to which it refers; None writes one.
    """
    if options is not None:
        check_loaded(options, BakeOptions, "options")
    is_single = isinstance(sources, str) or not isinstance(sources, Sequence)
    source_list = cast("Sequence[Source]", [sources] if is_single else sources)
    sources_to_read = source_set(source_list)
    options = options or BakeOptions()
    scenes = list(sources_to_read.scenes.values())
    notices = [notice for scene in scenes for notice in scene.notices]
    path = STDOUT if output is None else Path(output)
    if not scenes and path != STDOUT and _holds_all_takes(path, options):
        sources_to_read = split_takes(sources_to_read, options)
        is_library = layer_form(options) is LayerForm.LIBRARY
        if sources_to_read.names and is_library and not path.exists():
            # Several takes make a library by default.
            options = replace(options, form=None)
    if len(sources_to_read.files) != 1 or not scenes:
        entry = OutputEntry(path, options, base=base, rig_file=rig_file)
        return BakeRequest(sources_to_read, (entry,), notices)
    (scene,) = scenes
    entries = scene.outputs if output is None else scene.outputs[:1]
    outputs = tuple(
        OutputEntry(
            path if entry.path is None or output is not None else entry.path,
            with_fallbacks(options, entry.bake),
            scene.for_output(entry),
            entry.location if output is None else None,
        )
        for entry in entries
    )
    return BakeRequest(sources_to_read, outputs, notices)


def _holds_all_takes(path: Path, options: BakeOptions) -> bool:
    """Return whether an output contains all takes of a source."""
    if writes_stage(path):
        return layer_form(options) is LayerForm.LIBRARY
    writer = writer_of(path)
    return writer is not None and writer.several


def has_several_outputs(scene: Scene) -> bool:
    """Return whether a scene writes several files, or one that is not USD."""
    path = scene.outputs[0].path
    return len(scene.outputs) > 1 or (path is not None and not writes_stage(path))


def check_request(request: BakeRequest) -> None:
    """Check all outputs before anything is read; raise all faults together."""
    source_set, has_several = request.source_set, len(request.outputs) > 1
    _check_count(len(source_set.files), request.outputs[0].options)
    faults = duplicate_outputs(request)
    # Errors are not stored, since their tracebacks would keep layers open.
    error_types: list[type[AnimtoolError]] = []
    for entry in request.outputs:
        if has_several and entry.path == STDOUT:
            raise OptionError(entry.locate(Fault("DOC021", "an output has no file")))
        try:
            check_output_entry(entry, source_set.inputs, source_set.files[0])
        except AnimtoolError as error:
            faults += map(entry.locate, error.faults)
            error_types.append(type(error))
    try:
        scenes = source_set.scenes.values()
        extra_outputs = [path for scene in scenes for path in scene.extra_outputs]
        inputs = [*source_set.inputs, *request.files]
        overwrite = request.outputs[0].options.overwrite
        check_outputs(extra_outputs, inputs, overwrite=overwrite)
    except AnimtoolError as error:
        faults += error.faults
        error_types.append(type(error))
    if faults:
        raise (error_types or [OptionError])[0](faults)
    _check_systems(request)


def duplicate_outputs(request: BakeRequest) -> list[Fault]:
    """Return a fault for each scene output that repeats a file (OUT007)."""
    entry_by_file: dict[str, OutputEntry] = {}
    faults = []
    for entry in request.outputs:
        for path in entry.files if len(request.outputs) > 1 else ():
            first_entry = entry_by_file.setdefault(
                name_key(output_target(path).final_path), entry
            )
            if first_entry is not entry and entry.location and first_entry.location:
                message = f"{str(path)!r} is also written by "
                message += first_entry.location.where
                faults.append(entry.location.fault("OUT007", message, "name another"))
                break
    return faults


def check_output_entry(
    entry: OutputEntry, inputs: Sequence[Path], source: Path
) -> None:
    """Raise all faults in the options of an output before anything is read.

    ``inputs`` are the files that are read; the first, ``source``, names a take.
    """
    check_output_options(entry)
    path, options = entry.path, entry.options
    if path == STDOUT:
        return
    if not entry.is_stage:
        if entry.base is not None:
            inputs = [*inputs, entry.base]
        check_outputs(entry.files, inputs, overwrite=options.overwrite)
        return
    rig_layers = [options.rig_layer] if options.rig_layer else []
    is_library = layer_form(options) is LayerForm.LIBRARY
    # Baking extends an existing library, or replaces one of its takes.
    overwrite = options.overwrite or (is_library and path.exists())
    check_outputs(entry.files, [*inputs, *rig_layers], overwrite=overwrite)
    if is_library and path.exists():
        from animtool.usd.takes.library import check_can_add_take

        name = take_name(options, source)
        check_can_add_take(path, name, options.prim_path, overwrite=options.overwrite)


def check_output_options(entry: OutputEntry) -> None:
    """Raise an error for an unknown format or options that exclude each other."""
    path, options = entry.path, entry.options
    if not entry.is_stage:
        writer = take_writer(path)
        if entry.location is None:
            check_file_options(options, writer, path)
        return
    is_stdout = path == STDOUT
    check_options(options, is_stdout=is_stdout, has_systems=entry.has_systems)
    if is_stdout:
        return
    check_path(path)
    if path.suffix.lower() == USD_PACKAGE_SUFFIX:
        check_package(path, options)


def take_name(options: BakeOptions, source: Path) -> str:
    """Return the name that a source's take has in a clip library."""
    from animtool.usd.layers.names import legal_name

    return legal_name(options.take or source_stem(source))


def _check_count(count: int, options: BakeOptions) -> None:
    message = ""
    if not count:
        message = "there is no source to bake"
    elif options.shot is not None and count > 1:
        message = "a shot shows one take, but there are several"
    elif options.deform and count > 1:
        message = f"{argument('deform', True)} writes the points of one take, but "
        message += "there are several"
    if message:
        raise OptionError(Fault("CLI002", message))


def _check_systems(request: BakeRequest) -> None:
    """Raise an error if a scene in a clip library writes systems (SCN062)."""
    if len(request.source_set.files) == 1:
        return
    for scene in request.source_set.scenes.values():
        if scene.for_output(scene.outputs[0]).systems:
            message = "a simulation is not a take of a library"
            raise OptionError(Fault("SCN062", message, str(scene.path)))
