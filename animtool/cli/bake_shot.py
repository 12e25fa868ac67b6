"""One shot of a timeline as the source of ``animtool bake``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from animtool.cli.console import Console

__all__ = ["shot_source"]


def shot_source(
    console: Console,
    sources: Sequence[Path],
    output: Path | None,
    given: dict[str, Any],
) -> tuple[Sequence[Path], Path | None]:
    """Return sources and output, those of the shot where the source is a timeline.

    ``shot`` of the given options becomes the shot's record; ``start`` is part of it.

    Raises:
        FormatError: The timeline is malformed, or media is missing.
        OptionError: It has no shot of that name, or several and none is named.
    """
    from animtool.scene.sources import is_timeline

    if not any(map(is_timeline, sources)):
        for name in ("shot", "handles"):
            if given[name] is not None:
                message = f"--{name} is for a SOURCE that is a timeline, such as .otio."
                raise click.UsageError(message)
        return sources, output
    if len(sources) > 1:
        raise click.UsageError("A timeline is baked alone: give one SOURCE.")
    if given["table"]:
        raise click.UsageError("--table measures a take: name the media, not the cut.")
    from animtool.batch.cuts import CutOptions, read_cut

    start = given["start"]
    if start is not None and start.denominator != 1:
        raise click.UsageError(f"--start {start}: a shot begins at a whole frame.")
    (path,) = sources
    options = CutOptions(
        given["handles"], None if start is None else int(start), given["fps"]
    )
    found = read_cut(path, given["shot"], options)
    console.faults(found.notices)
    if not found.shots:
        raise click.UsageError(f"{path}: the shot has no media.")
    (cut,) = found.shots
    given |= {"shot": cut.shot, "start": None}
    return [cut.found.path], output or path.with_name(f"{cut.names['shot']}.usdc")
