"""What ``animtool preview`` does with a picture: write it, and say what it is."""

from __future__ import annotations

from pathlib import Path

from animtool.cli.console import Console
from animtool.core.errors import counted
from animtool.core.quantities import size_text
from animtool.preview.options import PictureOptions, PreviewOptions
from animtool.preview.pictures.build import PictureReport, write_pictures


def write(
    console: Console,
    files: tuple[Path, ...],
    output: Path,
    options: PreviewOptions,
    pictures: PictureOptions,
    *,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Write a still, a sheet or a film."""
    with console.progress(f"preview {files[0].name}") as progress:
        report = write_pictures(
            files, output, options, pictures, overwrite=overwrite, progress=progress
        )
    console.faults(report.page.notices)
    if as_json:
        console.result_json(report.as_dict())
        return
    for notice in report.page.manifest["notices"]:
        console.say(f"  {notice}")
    console.say(_told(report))


def _told(report: PictureReport) -> str:
    """Return what was written, in a line."""
    wide, high = report.pixels
    frames = counted(len(report.frames), "frame")
    if report.rate:
        frames += f" at {float(report.rate):.6g} per second"
        step = report.page.manifest["time"]["step"]
        if len(set(report.frames)) > 1:
            every = round((report.frames[1] - report.frames[0]) / step)
            frames += f", every {every}. of the motion" if every > 1 else ""
    size = size_text(report.size)
    return f"{report.path}: {frames}, {wide}x{high} pixels, {report.about}, {size}"
