"""Opening a source by what it is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

from animtool.core.arguments import argument
from animtool.core.errors import AnimtoolError, Fault, OptionError
from animtool.core.files.reading import FileState, note_input
from animtool.core.names import is_named
from animtool.core.options import Key, called, described, option, options_of
from animtool.core.rates import OptionalFraction, rate_option
from animtool.core.readers import DOCUMENT, READERS, USD, find_reader
from animtool.core.record import dataclass
from animtool.core.shot import Shot
from animtool.core.units import LengthUnit, UpAxis, unit_name
from animtool.scene.bake.progress import Progress

if TYPE_CHECKING:
    from animtool.motion.take import TakeStream

# Options that apply to every source.
ANY_SOURCE = frozenset({"rig", "force_fit", "shot"})
# Those that no reader is given.
BEYOND_READERS = frozenset({"force_fit", "shot"})
_DROPPED = ("interpolate", "hold", "close")
_POSITIONS = ("channels", "offsets")
_OF_BVH = "says what a BVH leaves open; this file states it"
_UNITS = "says what a BVH, a glTF or an FBX is in; this file states it"


@described
@dataclass(frozen=True, slots=True)
class SourceOptions:
    """What a source is, where the file does not say.

    Attributes:
        force_fit: Take motion that does not fit the rig all the same.
        placement: Of USD: ``drop`` leaves out where the character stands; it is that of
            the output, see `animtool.scene.bake.options.BakeOptions`.
        shot: The shot that shows it, whose frames its time codes become; None is none.

    Raises:
        OptionError: fps is no rate (SCN022).
    """

    unit: LengthUnit | None = option(
        None,
        "unit",
        flag="units",
        reason=_UNITS,
        scene=Key(
            "Of a BVH, glTF or FBX: the unit of its lengths. Not given: cm, of a glTF "
            "m, of an FBX what it says.",
            "cm",
            alias="units",
        ),
        batch=Key(
            "Of BVH, glTF and FBX files: the unit of their lengths. Not given: cm, of "
            "glTF m, of FBX what each says.",
            "cm",
            alias="units",
        ),
        help="Unit of the lengths of a BVH, a glTF or an FBX.  [default: cm; of a glTF "
        "m; of an FBX what it says]",
    )
    up: UpAxis | None = option(
        None,
        "axis",
        reason=_UNITS,
        scene=Key(
            "Of a BVH, glTF or FBX: its up axis. Not given: Y, of an FBX what it says.",
            "Z",
        ),
        batch=Key(
            "Of BVH, glTF and FBX files: their up axis. Not given: Y, of FBX what "
            "each says.",
            "Z",
        ),
        help="Up axis of a BVH, a glTF or an FBX.  [default: Y; of an FBX what it "
        "says]",
    )
    positions: str | None = option(
        None,
        "choice",
        reason=_OF_BVH,
        scene=Key(
            "Of a BVH: whether position channels of joints below a root count, or "
            "their OFFSETs hold. Not given: `channels`.",
            "offsets",
            _POSITIONS,
        ),
        batch=Key(
            "Of BVH files: whether position channels of joints below a root count, or "
            "their OFFSETs hold. Not given: `channels`.",
            "offsets",
            _POSITIONS,
        ),
        choices=_POSITIONS,
        help="Of a BVH: whether position channels of joints below a root count, or "
        "their OFFSETs hold, as where these channels are all 0.  [default: channels]",
    )
    fps: OptionalFraction = option(
        None,
        "rate",
        flag="source-fps",
        reason=_UNITS,
        scene=Key(
            "Of a BVH: its true frame rate; of a face recording: what its time code "
            "counts; of a glTF or FBX: the rate that its keys are read at. Not given: "
            "what the file shows.",
            120,
        ),
        batch=Key(
            "Of BVH files: their true frame rate; of glTF and FBX files: the rate "
            "that they are read at. Not given: what each shows.",
            120,
            alias="source_fps",
        ),
        help="The real frame rate of a BVH whose Frame Time is wrong, or what the time "
        "code of a face recording counts; of a glTF, which states none, or an FBX the "
        "rate to read its keys at.",
    )
    prim_path: str | None = option(
        None,
        "text",
        flag="source-prim",
        reason="is for USD, glTF and FBX files, and this is none",
        scene=Key(
            "Of a USD, glTF or FBX file with several characters: the one to read.",
            "/World/hero",
            alias="prim",
        ),
        help="The character to read, where a USD, glTF or FBX source has several.",
        metavar="PATH",
    )
    rig: Path | None = option(
        None,
        "file",
        batch=Key(
            "Of clips: their rig. Not given: the one that each names.", "hero.rig.yaml"
        ),
        help="Rig of a clip, in place of the one that it names; of a MOT, whose "
        "coordinates its columns are.",
    )
    clamp: bool = option(
        False,
        "switch",
        reason="is for clips, and this is no clip",
        scene=Key(
            "Of a clip: bring controls into their ranges and joints into their limits.",
            True,
        ),
        batch=Key(
            "Of clips: bring controls into their ranges and joints into their limits.",
            True,
        ),
        help="Bring a clip's controls into their ranges and joints into their limits.",
    )
    take: str | None = option(
        None,
        "text",
        reason="is for clip libraries in USD, glTF and FBX, and this is none",
        scene=Key(
            "Of a clip library in USD, a glTF or an FBX: the take to read. Not given: "
            "the one that is selected, of a glTF the first.",
            "walk",
        ),
        help="The take to read of a clip library in USD, a glTF or an FBX.  [default: "
        "the one selected, of a glTF the first]",
        metavar="NAME",
    )
    remap: Path | None = option(
        None,
        "file",
        reason="is for face recordings (.csv), and this is none",
        scene=Key(
            "Of a face recording: a remap file for the names of its shapes.",
            "hero.remap.yaml",
        ),
        help="Remap file (.remap.yaml) for the shapes of a face recording.",
    )
    dropped: str | None = option(
        None,
        "choice",
        reason="is for face recordings (.csv), and this is none",
        scene=Key(
            "Of a face recording: what becomes of frames without a row. Not given: "
            "`interpolate`.",
            "hold",
            _DROPPED,
        ),
        choices=_DROPPED,
        help="Frames that a face recording lacks: values in between, those of the "
        "frame before, or none, so that later frames move up.  [default: interpolate]",
    )
    template: Path | None = option(
        None,
        "file",
        reason="is for files of markers, and this is none",
        scene=Key(
            "Of a file of markers: the marker template that says where they are. They "
            "are solved on the rig of the scene, or on the one that the template "
            "names.",
            "ann.markers.yaml",
        ),
        help="Of a file of markers: the template that says where they are "
        "(.markers.yaml); it is solved on the rig.",
    )
    cameras: Path | None = option(
        None,
        "file",
        reason="is for what cameras see, an npz of pixels, and this is none",
        scene=Key(
            "Of an npz of pixels, what cameras see of markers: their calibrations. The "
            "markers are triangulated, then solved.",
            "stage.cameras.yaml",
        ),
        help="Of an npz of pixels: the calibrations of the cameras, which triangulate "
        "the markers.",
    )
    placement: str | None = None
    force_fit: bool = False
    shot: Shot | None = None

    def __post_init__(self) -> None:
        """Take the rate as it is written."""
        if self.fps is not None:
            object.__setattr__(self, "fps", rate_option(self.fps))


@dataclass(frozen=True, slots=True)
class OpenTake:
    """A take that is open already, as a source."""

    path: Path  # the file that messages and reports name
    stream: TakeStream  # its motion, which can be read once


def is_usd(path: Path) -> bool:
    """Return whether a path is that of a USD file."""
    return READERS.get(path.suffix.lower()) is USD


def motion_bytes(path: Path) -> int:
    """Return the size of a file that holds motion; 0 of a scene, which names others."""
    # That it is gone since is said by those who look at what was read.
    state = None if is_named(path, "scene") else FileState.of(path)
    return 0 if state is None else state.size


def source_stem(path: Path) -> str:
    """Return a file's name without what says its kind.

    >>> source_stem(Path("takes/walk.clip.yaml"))
    'walk'
    """
    return path.stem.removesuffix(".clip").removesuffix(".scene")


def takes_option(path: Path, name: str) -> bool:
    """Return whether files of a path's suffix take an option of `SourceOptions`.

    >>> takes_option(Path("walk.bvh"), "unit"), takes_option(Path("walk.bvh"), "rig")
    (True, False)
    """
    try:
        return name in find_reader(path).options
    except AnimtoolError:
        return False


def fitting_options(
    options: SourceOptions, path: Path, others: Sequence[Path]
) -> SourceOptions:
    """Return options for one of several files that are opened alike.

    What files of its kind do not take is left out, where one of the others takes it.
    All take a rig.

    >>> walk, idle = Path("walk.bvh"), Path("idle.usda")
    >>> options = SourceOptions(up=UpAxis.Z, clamp=True)
    >>> found = fitting_options(options, idle, [walk])
    >>> found.up, found.clamp
    (None, True)
    """
    usual = SourceOptions()
    left_out = {
        field.name: getattr(usual, field.name)
        for field in fields(SourceOptions)
        if field.name not in ANY_SOURCE
        and not takes_option(path, field.name)
        and any(takes_option(other, field.name) for other in others)
    }
    return replace(options, **left_out)


def open_source(
    path: Path | str,
    options: SourceOptions | None = None,
    *,
    progress: Progress = None,
) -> TakeStream:
    """Open a BVH, a USD file or a clip as a stream of blocks.

    Args:
        path: A file of any format that animtool reads, but no scene.
        options: How to read it; None is the defaults.
        progress: Called with the share done, 0 to 1.

    Raises:
        FormatError: It cannot be read or is malformed; the blocks may raise it too.
        OptionError: Its suffix is none that animtool reads, or an option does not
            apply to it.
    """
    path, options = Path(path), options or SourceOptions()
    if is_named(path, "scene"):
        message = "is a scene, and no take is read from scenes"
        hint = "animtool bake bakes it; its source is a file that can be read"
        raise OptionError(Fault("IO002", message, str(path), (), hint))
    if options.shot is not None:
        from animtool.scene.sources.retime import in_shot

        own = replace(options, shot=None)
        return in_shot(open_source(path, own, progress=progress), options.shot)
    reader = find_reader(path)
    if options.rig is not None and "rig" not in reader.options:
        own = replace(options, rig=None, force_fit=False)
        stream = open_source(path, own, progress=progress)
        from animtool.scene.sources.onto_rig import on_rig_file

        mapped = on_rig_file(path, stream, options.rig, forced=options.force_fit)
        return _driven(mapped)
    note_input(path)
    usual = SourceOptions()
    given = {
        field.name: value
        for field in fields(SourceOptions)
        if field.name not in BEYOND_READERS
        and (value := getattr(options, field.name)) != getattr(usual, field.name)
    }
    if "placement" not in reader.options:
        # Only stages have a character stand somewhere.
        given.pop("placement", None)
    refused = [name for name in given if name not in reader.options]
    if refused:
        raise OptionError([_refusal(name, path) for name in refused])
    if "progress" in reader.options:
        given["progress"] = progress
    stream = cast("TakeStream", reader.source_opener(path)(path, **given))
    if "unit" not in reader.options:
        unit = unit_name(stream.rig.meters_per_unit)
        stream.details.setdefault("units", unit)
    # A clip's keys were evaluated with what they drive.
    return stream if reader is DOCUMENT else _driven(stream)


def open_characters(path: Path) -> dict[str, Callable[[], TakeStream]]:
    """Return what opens the take of each Skeleton of a USD file, by its path."""
    from animtool.usd.takes.stage_takes import read_characters

    note_input(path)

    def opener(read: Callable[[], TakeStream]) -> Callable[[], TakeStream]:
        return lambda: _driven(read())

    return {name: opener(read) for name, read in read_characters(path).items()}


def _driven(stream: TakeStream) -> TakeStream:
    """Return a source with what its rig drives in place of what it says of that."""
    if not stream.rig.is_driven:
        return stream
    from animtool.motion.driving import driven_stream

    return driven_stream(stream, replaced=True)


def _refusal(name: str, path: Path) -> Fault:
    refused = options_of(SourceOptions)[name]
    hint = None
    if name in {"unit", "up", "fps"}:
        hint = (
            f"{argument('to_units')}, {argument('to_up')} and {argument('fps')} convert"
        )
    return Fault(
        "CLI004",
        f"{called(f'source.{name}', refused)} {refused.reason}",
        str(path),
        (),
        hint,
    )
