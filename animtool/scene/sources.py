"""Opening a source by what it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from animtool.errors import Fault, FormatError, OptionError, Severity
from animtool.rig.skeleton import Rig
from animtool.take import TakeStream
from animtool.units import LengthUnit, UpAxis

__all__ = ["READERS", "SourceOptions", "is_usd", "open_source"]

# A character spans between these at rest; the skeleton of a person between those.
LIKELY_METERS = (0.3, 6.0)
PERSON_METERS = (1.0, 2.6)
# Fewer joints are a prop as likely as a character.
FEWEST_JOINTS = 8

READERS: dict[str, str] = {
    ".bvh": "bvh",
    ".usd": "usd",
    ".usda": "usd",
    ".usdc": "usd",
    ".usdz": "usd",
    ".yaml": "clip",
    ".yml": "clip",
    ".json": "clip",
}


@dataclass(frozen=True, slots=True)
class SourceOptions:
    """What a source is, where the file does not say.

    Attributes:
        unit: Unit of its lengths; None is what the file says, centimetres for BVH.
        up: Its up axis; None is what the file says, Y for BVH.
        fps: Its real frame rate; None is what the file says.
        prim_path: The character, where a stage has several.
        rig: Rig of a clip, in place of the one that it names.
        clamp: Bring a clip's controls into their ranges, and joints into limits.
    """

    unit: LengthUnit | None = None
    up: UpAxis | None = None
    fps: Fraction | None = None
    prim_path: str | None = None
    rig: Path | None = None
    clamp: bool = False


def is_usd(path: Path) -> bool:
    """Return whether a path is that of a USD file."""
    return READERS.get(path.suffix.lower()) == "usd"


def open_source(
    path: Path | str,
    options: SourceOptions | None = None,
    *,
    progress: Callable[[float], None] | None = None,
) -> TakeStream:
    """Open a BVH, a USD file or a clip as a stream of blocks.

    Raises:
        FormatError: It cannot be read or is malformed; the blocks may raise it too.
        OptionError: Its suffix is none that animtool reads, or an option does not
            apply to it.
    """
    path, options = Path(path), options or SourceOptions()
    kind = READERS.get(path.suffix.lower())
    if kind is None:
        if not path.exists() or path.is_dir():
            reason = "is a folder" if path.is_dir() else "does not exist"
            raise FormatError(Fault("IO001", f"cannot be read: {reason}", str(path)))
        kind = f"suffix {path.suffix!r}" if path.suffix else "a name without suffix"
        message = f"{kind} is no format that animtool reads"
        allowed = f"allowed: {', '.join(READERS)}"
        raise OptionError(Fault("IO002", message, str(path), (), allowed))
    if kind != "clip" and (options.rig is not None or options.clamp):
        name = "--rig" if options.rig is not None else "--clamp"
        message = f"{name} is for clips, and this is no clip"
        raise OptionError(Fault("CLI004", message, str(path)))
    if kind == "bvh":
        from animtool.formats.bvh import read_bvh

        stream = read_bvh(
            path,
            unit=options.unit or LengthUnit.CM,
            up=options.up or UpAxis.Y,
            fps=options.fps,
            progress=progress,
        )
        if options.unit is None:
            stream.notices += _size_notice(stream.rig, str(path))
        return stream
    given = {"--units": options.unit, "--up": options.up, "--source-fps": options.fps}
    for name, value in given.items():
        if value is not None:
            hint = "--to-units, --to-up and --fps convert"
            message = f"{name} says what a BVH leaves open; this file states it"
            raise OptionError(Fault("CLI004", message, str(path), (), hint))
    if kind == "clip":
        from animtool.scene.clips import open_clip_source

        return open_clip_source(path, options.rig, clamp=options.clamp)
    from animtool.usd.read import read_usd

    return read_usd(path, prim_path=options.prim_path)


def _size_notice(rig: Rig, path: str) -> list[Fault]:
    """Point out a skeleton of a size that fits another unit better."""
    from animtool.rig.kinematics import rest_size

    size = rest_size(rig)
    low, high = LIKELY_METERS
    if len(rig.joints) < FEWEST_JOINTS or low <= size <= high:
        return []
    numbers = size / rig.meters_per_unit
    low, high = PERSON_METERS
    fitting = [unit for unit in LengthUnit if low <= numbers * unit.meters <= high]
    message = f"the skeleton spans {numbers:.4g}, which in centimetres is no character"
    hint = "--units says what it is in"
    if fitting:
        hint = f"--units {fitting[0]} would make it {numbers * fitting[0].meters:.2g} m"
    return [Fault("BVH109", message, path, (), hint, Severity.NOTE)]
