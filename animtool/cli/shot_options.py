"""One shot of a timeline as the source of ``animtool bake`` and ``ik``."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.cli.console import Console

if TYPE_CHECKING:
    from animtool.batch.cuts import Cut

SHOT_OPTIONS = (
    click.option(
        "--shot",
        metavar="NAME",
        help="Of a timeline: the shot to take; needed where there are several.",
    ),
    click.option(
        "--handles",
        type=click.IntRange(0),
        metavar="N",
        help="Of a timeline: frames before and after the cut, at its rate.  [default: "
        "as the timeline says, else 0]",
    ),
)


def timeline_shot(
    console: Console,
    path: Path | None,
    given: dict[str, Any],
    start: Fraction | None,
    fps: Fraction | None = None,
) -> Cut | None:
    """Return the shot and its media where a path is that of a timeline, else None."""
    from animtool.scene.sources import is_timeline

    if path is None or not is_timeline(path):
        for name in ("shot", "handles"):
            if given[name] is not None:
                message = f"--{name} is for motion of a timeline, such as edit.otio."
                raise click.UsageError(message)
        return None
    if given["table"]:
        raise click.UsageError("--table measures a take: name the media, not the cut.")
    if start is not None and start.denominator != 1:
        raise click.UsageError(f"--start {start}: a shot begins at a whole frame.")
    from animtool.batch.cuts import CutOptions, read_cut

    options = CutOptions(given["handles"], None if start is None else int(start), fps)
    found = read_cut(path, given["shot"], options)
    console.faults(found.notices)
    if not found.shots:
        from animtool.errors import Fault, FormatError

        hint = f"animtool batch {path} TAKES finds media by the names of clips"
        raise FormatError(Fault("BAT042", "the shot has no media", str(path), (), hint))
    return found.shots[0]


def bake_shot(
    console: Console,
    sources: Sequence[Path],
    output: Path | None,
    given: dict[str, Any],
) -> tuple[Sequence[Path], Path | None]:
    """Return sources and output, those of the shot where the source is a timeline.

    ``shot`` of the given options becomes the shot's record; ``start`` is part of it.
    """
    from animtool.scene.sources import is_timeline

    path = next(filter(is_timeline, sources), None)
    if path is not None and len(sources) > 1:
        raise click.UsageError("A timeline is baked alone: give one SOURCE.")
    cut = timeline_shot(console, path, given, given["start"], given["fps"])
    if cut is None:
        return sources, output
    given |= {"shot": cut.shot, "start": None}
    name = cut.names["shot"]
    return [cut.found.path], output or sources[0].with_name(f"{name}.usdc")
