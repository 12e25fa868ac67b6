"""Opens takes of every format as streams, with options that files do not state."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

from animtool.core.arguments import ArgumentNamer, argument
from animtool.core.errors import AnimtoolError, Fault, OptionError
from animtool.core.files.reading import FileState, record_input
from animtool.core.loaded import check_loaded
from animtool.core.names import has_kind_suffix
from animtool.core.options import (
    Key,
    convert_option_values,
    inherits_docs,
    option,
    option_marker,
    options_of,
)
from animtool.core.rates import OptionalFraction, rate_option, rate_warning
from animtool.core.readers import READERS, RIG_AND_CLIP_FILES, USD, find_reader
from animtool.core.record import dataclass
from animtool.core.shot import Shot
from animtool.core.units import LengthUnit, UpAxis, unit_name
from animtool.scene.bake.progress import Progress

if TYPE_CHECKING:
    from animtool.motion.take import TakeStream

# Options that apply to every source.
ANY_SOURCE_OPTIONS = frozenset({"rig", "force_fit", "shot"})
# Options that are not passed to readers.
NON_READER_OPTIONS = frozenset({"force_fit", "shot"})
_DROPPED_FRAME_MODES = ("interpolate", "hold", "close")
_POSITION_MODES = ("channels", "offsets")
_ONLY_BVH_REASON = "sets what a BVH does not state; this file states it"
_UNIT_REASON = "sets the unit of a BVH, a glTF or an FBX; this file states its own"
_UP_REASON = "sets the up axis of a BVH, a glTF or an FBX; this file states its own"
_RATE_REASON = "sets the rate of a BVH, a glTF or an FBX; this file states its own"


@inherits_docs
@dataclass(frozen=True, slots=True)
class SourceOptions:
    """Properties of a source that its file does not state.

    Attributes:
        force_fit: Whether to take motion that does not fit the rig.
        placement: For USD: ``drop`` leaves out the character's placement; it is set
            from the output, see `animtool.scene.bake.options.BakeOptions`.
        shot: Shot that shows the source; time codes become its frames.

    Raises:
        OptionError: fps is not a rate (SCN022).
    """

    unit: LengthUnit | None = option(
        None,
        "unit",
        flag="units",
        reason=_UNIT_REASON,
        scene=Key(
            "Unit of the lengths of a BVH, glTF or FBX. Default: cm; m for a glTF; "
            "as stated in an FBX.",
            "cm",
            alias="units",
        ),
        batch=Key(
            "Unit of the lengths of BVH, glTF and FBX files. Default: cm; m for "
            "glTF; as stated in FBX.",
            "cm",
            alias="units",
        ),
        help="Unit of the source's lengths.  [default: as stated; cm for a BVH, m for "
        "a glTF, mm for markers]",
    )
    up: UpAxis | None = option(
        None,
        "axis",
        reason=_UP_REASON,
        scene=Key(
            "Up axis of a BVH, glTF or FBX. Default: Y; as stated in an FBX.", "Z"
        ),
        batch=Key(
            "Up axis of BVH, glTF and FBX files. Default: Y; as stated in FBX.", "Z"
        ),
        help="Up axis of the source.  [default: as stated; Y for a BVH or glTF]",
    )
    positions: str | None = option(
        None,
        "choice",
        reason=_ONLY_BVH_REASON,
        scene=Key(
            "For a BVH: use the position channels of joints below a root, or their "
            "OFFSETs. Default: `channels`.",
            "offsets",
            _POSITION_MODES,
        ),
        batch=Key(
            "For BVH files: use the position channels of joints below a root, or "
            "their OFFSETs. Default: `channels`.",
            "offsets",
            _POSITION_MODES,
        ),
        choices=_POSITION_MODES,
        help="For a BVH: use the position channels of joints below a root, or their "
        "OFFSETs, as when all these channels are 0.  [default: channels]",
    )
    fps: OptionalFraction = option(
        None,
        "rate",
        flag="source-fps",
        reason=_RATE_REASON,
        scene=Key(
            "For a BVH: its true frame rate; for a face recording: the rate of its "
            "time code; for a glTF or FBX: the rate to sample its keys at. Default: "
            "as found in the file.",
            120,
        ),
        batch=Key(
            "For BVH files: their true frame rate; for glTF and FBX files: the rate "
            "to sample them at. Default: as found in each file.",
            120,
            alias="source_fps",
        ),
        help="True frame rate of a BVH with a wrong Frame Time; rate of the time "
        "code of a face recording; rate to sample the keys of a glTF or FBX at.",
    )
    prim_path: str | None = option(
        None,
        "text",
        flag="source-prim",
        reason="is for USD, glTF and FBX files only",
        scene=Key(
            "For a USD, glTF or FBX file with several characters: the one to read.",
            "/World/hero",
            alias="prim",
        ),
        help="The character to read from a USD, glTF or FBX source with several.",
        metavar="PATH",
    )
    rig: Path | None = option(
        None,
        "file",
        batch=Key(
            "For clips: their rig. Default: the rig named in each.", "hero.rig.yaml"
        ),
        help="Rig of a clip, instead of the one it names; for a MOT, the rig of its "
        "coordinates.",
    )
    clamp: bool = option(
        False,
        "switch",
        reason="is for clips only",
        scene=Key(
            "For a clip: clamp controls to their ranges and joints to their limits.",
            True,
        ),
        batch=Key(
            "For clips: clamp controls to their ranges and joints to their limits.",
            True,
        ),
        help="Clamp a clip's controls to their ranges and joints to their limits.",
    )
    take: str | None = option(
        None,
        "text",
        reason="is for clip libraries in USD, glTF and FBX only",
        scene=Key(
            "For a clip library in USD, a glTF or an FBX: the take to read. Default: "
            "the selected one; the first of a glTF.",
            "walk",
        ),
        help="The take to read from a clip library in USD, a glTF or an FBX.  "
        "[default: the selected one; the first of a glTF]",
        metavar="NAME",
    )
    remap: Path | None = option(
        None,
        "file",
        reason="is for face recordings (.csv) only",
        scene=Key(
            "For a face recording: a remap file for the names of its shapes.",
            "hero.remap.yaml",
        ),
        help="Remap file (.remap.yaml) for the shapes of a face recording.",
    )
    dropped: str | None = option(
        None,
        "choice",
        reason="is for face recordings (.csv) only",
        scene=Key(
            "For a face recording: how to fill frames without a row. Default: "
            "`interpolate`.",
            "hold",
            _DROPPED_FRAME_MODES,
        ),
        choices=_DROPPED_FRAME_MODES,
        help="How to fill missing frames of a face recording: interpolate, hold the "
        "previous frame, or close the gap, which moves later frames up.  "
        "[default: interpolate]",
    )
    template: Path | None = option(
        None,
        "file",
        reason="is for files of markers only",
        scene=Key(
            "For a file of markers: the marker template that places them on a rig. "
            "They are solved on the rig of the scene, or on the template's.",
            "ann.markers.yaml",
        ),
        help="For a file of markers: the template that places them on the rig "
        "(.markers.yaml) for the solve.",
    )
    cameras: Path | None = option(
        None,
        "file",
        reason="is for camera observations, an npz of pixels, only",
        scene=Key(
            "For an npz of pixels, as cameras see markers: the calibrations. The "
            "markers are triangulated, then solved.",
            "stage.cameras.yaml",
        ),
        help="For an npz of pixels: the calibrations of the cameras, to triangulate "
        "the markers.",
    )
    placement: str | None = None
    force_fit: bool = False
    shot: Shot | None = None

    def __post_init__(self) -> None:
        """Convert the rate, the unit and the up axis from numbers or text."""
        convert_option_values(self)
        if self.fps is not None:
            object.__setattr__(self, "fps", rate_option(self.fps))


@dataclass(frozen=True, slots=True)
class OpenTake:
    """An opened take: a stream of blocks, and the file that it is read from."""

    path: Path  # file that messages and reports name
    stream: TakeStream  # its motion, which can be read once


def is_usd(path: Path) -> bool:
    """Return whether a path is a USD file."""
    return READERS.get(path.suffix.lower()) is USD


def motion_bytes(path: Path) -> int:
    """Return the size of a motion file [byte]; 0 for a scene."""
    # A file removed meanwhile is reported by the check of inputs.
    state = None if has_kind_suffix(path, "scene") else FileState.of(path)
    return 0 if state is None else state.size


def source_stem(path: Path) -> str:
    """Return a file's name without the suffixes of its format.

    >>> source_stem(Path("takes/walk.clip.yaml"))
    'walk'
    """
    return path.stem.removesuffix(".clip").removesuffix(".scene")


def supports_option(path: Path, name: str) -> bool:
    """Return whether a file format supports an option of `SourceOptions`.

    >>> [supports_option(Path("walk.bvh"), name) for name in ("unit", "rig")]
    [True, False]
    """
    try:
        return name in find_reader(path).options
    except AnimtoolError:
        return False


def fitting_options(
    options: SourceOptions, path: Path, all_paths: Sequence[Path]
) -> SourceOptions:
    """Return the options that apply to one of the files of a command.

    Options that the format of the file does not support are left out if another file
    supports them. The option ``rig`` applies to all files.

    >>> walk, idle = Path("walk.bvh"), Path("idle.usda")
    >>> options = SourceOptions(up=UpAxis.Z, clamp=True)
    >>> found = fitting_options(options, idle, [walk])
    >>> found.up, found.clamp
    (None, True)
    """
    defaults = SourceOptions()
    default_values = {
        field.name: getattr(defaults, field.name)
        for field in fields(SourceOptions)
        if field.name not in ANY_SOURCE_OPTIONS
        and not supports_option(path, field.name)
        and any(supports_option(other_path, field.name) for other_path in all_paths)
    }
    return replace(options, **default_values)


def open_source(
    path: Path | str, options: SourceOptions | None = None, *, progress: Progress = None
) -> TakeStream:
    """Open a BVH, a USD file or a clip as a stream of blocks.

    Args:
        path: A file of any format that animtool reads, except a scene.
        options: Options of reading; None is the defaults.
        progress: Called with the fraction done, 0 to 1.

    Raises:
        FormatError: It cannot be read or is malformed; the blocks may raise it too.
        OptionError: Its suffix is none that animtool reads, or an option does not
            apply to it.
    """
    if options is not None:
        check_loaded(options, SourceOptions, "options")
    path, options = Path(path), options or SourceOptions()
    if has_kind_suffix(path, "scene"):
        message = "is a scene, not a take"
        hint = "bake it with animtool bake, and read its source or output instead"
        raise OptionError(Fault("IO002", message, str(path), (), hint))
    if options.shot is not None:
        from animtool.scene.sources.retime import in_shot

        inner_options = replace(options, shot=None)
        stream = open_source(path, inner_options, progress=progress)
        return in_shot(stream, options.shot)
    reader = find_reader(path)
    if options.rig is not None and "rig" not in reader.options:
        inner_options = replace(options, rig=None, force_fit=False)
        stream = open_source(path, inner_options, progress=progress)
        from animtool.scene.sources.onto_rig import map_to_rig_file

        stream = map_to_rig_file(path, stream, options.rig, force_fit=options.force_fit)
        return _drive_tracks(stream)
    record_input(path)
    defaults = SourceOptions()
    arguments = {
        field.name: value
        for field in fields(SourceOptions)
        if field.name not in NON_READER_OPTIONS
        and (value := getattr(options, field.name)) != getattr(defaults, field.name)
    }
    if "placement" not in reader.options:
        # Only stages place a character.
        arguments.pop("placement", None)
    unsupported_names = [name for name in arguments if name not in reader.options]
    if unsupported_names:
        faults = [_unsupported_option_fault(name, path) for name in unsupported_names]
        raise OptionError(faults)
    if "progress" in reader.options:
        arguments["progress"] = progress
    stream = cast("TakeStream", reader.source_opener(path)(path, **arguments))
    if options.fps is not None:
        known_codes = {notice.code for notice in stream.notices}
        stream.notices.extend(
            notice.in_file(path)
            for notice in rate_warning(options.fps, "source.fps")
            if notice.code not in known_codes
        )
    if "unit" not in reader.options or "unit" in arguments:
        unit = unit_name(stream.rig.meters_per_unit)
        stream.details.setdefault("units", unit)
    # Keys of a clip are evaluated together with the tracks they drive.
    return stream if reader is RIG_AND_CLIP_FILES else _drive_tracks(stream)


def open_checked(
    path: Path,
    options: SourceOptions | None = None,
    *,
    namer: ArgumentNamer | None = None,
    reported_codes: Collection[str] = (),
    progress: Progress = None,
) -> TakeStream:
    """Open a source like `open_source`, with warnings about its rate, size and up axis.

    These are added to its notices, some of them when its first block is read. The
    notices name arguments by ``namer``. Warnings about the rate are left out if
    ``reported_codes`` contain one.
    """
    from animtool.retarget.standing import with_source_warnings

    options = options or SourceOptions()
    stream = open_source(path, options, progress=progress)
    return with_source_warnings(
        path,
        stream,
        options.up,
        options.unit,
        namer=namer,
        reported_codes=reported_codes,
    )


def open_characters(path: Path) -> dict[str, Callable[[], TakeStream]]:
    """Return a function per Skeleton, by its path, that opens the Skeleton's take."""
    from animtool.usd.takes.read import read_characters

    record_input(path)

    def driven_opener(read: Callable[[], TakeStream]) -> Callable[[], TakeStream]:
        return lambda: _drive_tracks(read())

    return {name: driven_opener(read) for name, read in read_characters(path).items()}


def _drive_tracks(stream: TakeStream) -> TakeStream:
    """Return a source with the tracks that the rig's controls drive evaluated."""
    if not stream.rig.is_driven:
        return stream
    from animtool.motion.driving import drive_stream

    return drive_stream(stream, reports_replaced=True)


def _unsupported_option_fault(name: str, path: Path) -> Fault:
    declaration = options_of(SourceOptions)[name]
    hint = None
    if name in {"unit", "up", "fps"}:
        hint = f"{argument('to_units')}, {argument('to_up')} and {argument('fps')} "
        hint += "convert"
    message = f"{option_marker(f'source.{name}', declaration)} {declaration.reason}"
    return Fault("CLI004", message, str(path), (), hint)
