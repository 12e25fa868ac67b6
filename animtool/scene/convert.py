"""A take from one file format to another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from animtool.errors import Fault, OptionError, refuse_warnings
from animtool.output import check_outputs, output_error, replacing
from animtool.scene.sources import SourceOptions, is_usd, open_source

__all__ = ["ConvertReport", "convert"]

_WRITES = ".bvh, .usd, .usda, .usdc"


@dataclass(frozen=True, slots=True)
class ConvertReport:
    """What a conversion did.

    Attributes:
        output: The file written.
        frames: Frames written.
        joints: Joints written.
        notices: Warnings and notes.
    """

    output: Path
    frames: int
    joints: int
    notices: list[Fault]


def convert(
    source: Path | str,
    output: Path | str,
    options: SourceOptions | None = None,
    *,
    overwrite: bool = False,
    strict: bool = False,
    progress: Callable[[float], None] | None = None,
) -> ConvertReport:
    """Convert a BVH or USD file to a BVH, or to a USD stage as a bake would.

    Raises:
        FormatError: The source is malformed.
        OptionError: The output's suffix is unknown, or it exists.
        OutputError: The output cannot be written.
        StrictError: There were warnings, and ``strict`` is on.
    """
    source, output = Path(source), Path(output)
    if is_usd(output):
        return _to_usd(source, output, options, overwrite, strict, progress)
    if output.suffix.lower() != ".bvh":
        kind = f"suffix {output.suffix!r}" if output.suffix else "a name without suffix"
        message = f"{kind} is no format that animtool writes"
        raise OptionError(
            Fault("OUT004", message, str(output), (), f"allowed: {_WRITES}")
        )
    check_outputs([output], [source], overwrite=overwrite)
    from animtool.edit.resample import resampled
    from animtool.formats.bvh import write_bvh

    stream = open_source(source, options, progress=progress)
    take = stream.collect()
    if take.clock.step > 1:
        take = resampled(take, take.clock.fps)
    text = write_bvh(take)
    notices = stream.notices + text.notices
    refuse_warnings(notices, strict=strict)
    with replacing(output) as temporary:
        try:
            with temporary.open("wb") as file:
                for part in text.parts:
                    file.write(part)
        except OSError as error:
            raise output_error(output, error) from error
    return ConvertReport(output, take.clock.count, len(take.rig.joints), notices)


def _to_usd(
    source: Path,
    output: Path,
    options: SourceOptions | None,
    overwrite: bool,
    strict: bool,
    progress: Callable[[float], None] | None,
) -> ConvertReport:
    from animtool.scene.bake import bake
    from animtool.scene.options import BakeOptions

    settings = BakeOptions(
        source=options or SourceOptions(), overwrite=overwrite, strict=strict
    )
    report = bake(source, output, settings, progress=progress)
    return ConvertReport(output, report.result.samples, report.joints, report.notices)
