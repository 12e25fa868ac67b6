"""Takes of files cleaned into files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from animtool.mocap.clean import PASS, CleanOptions
from animtool.passes import PassContext, apply_pass
from animtool.scene.convert import ConvertReport, convert
from animtool.scene.progress import Progress
from animtool.scene.sources import SourceOptions, open_source
from animtool.take import TakeStream


def clean_source(
    source: Path,
    output: Path,
    options: CleanOptions,
    reading: SourceOptions | None = None,
    *,
    overwrite: bool = False,
    strict: bool = False,
    progress: Progress = None,
) -> ConvertReport:
    """Convert a take as `animtool.scene.convert.convert` does, cleaned."""

    def opened(path: Path, reading: Any = None, *, progress: Progress) -> TakeStream:
        stream = open_source(path, reading, progress=progress)
        context = PassContext(lambda path: open_source(path).collect(), path.parent)
        cleaned = apply_pass(stream, PASS, options, context)
        cleaned.notices = [*cleaned.notices, *context.notices]
        return cleaned

    for check in PASS.checks(options).values():
        check()
    return convert(
        source,
        output,
        reading,
        overwrite=overwrite,
        strict=strict,
        progress=progress,
        opener=opened,
    )
