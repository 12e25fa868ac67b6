"""Writes preview pictures and prints a summary."""

from __future__ import annotations

from pathlib import Path

from animtool.cli.console import Console
from animtool.preview.options import PictureOptions, PreviewOptions
from animtool.preview.pictures.build import write_pictures
from animtool.report.text import Each, Template

PICTURE = Template(
    "animtool.preview.pictures.build:PictureReport",
    (
        Each("page.manifest.notices", ("  {self}",)),
        "{path}: {frames:n frame}[{?rate} at {rate:g} a second"
        "[, every {every}. of the motion]], {width}x{height} pixels, {about}, "
        "{size:size}",
    ),
)


def write_picture(
    console: Console,
    files: tuple[Path, ...],
    output: Path,
    options: PreviewOptions,
    pictures: PictureOptions,
    report_format: str,
    *,
    overwrite: bool,
) -> None:
    """Write a still picture, a contact sheet or a film."""
    with console.progress(f"preview {files[0].name}") as progress:
        report = write_pictures(
            files, output, options, pictures, overwrite=overwrite, progress=progress
        )
    console.faults(report.page.notices)
    console.report(report_format, report, PICTURE)
