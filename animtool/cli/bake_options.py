"""Options of ``animtool bake``: sources, timeline shots, and outputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.cli.console import Console
from animtool.cli.options import (
    TIMECODE_OPTIONS,
    Command,
    Count,
    bake_option,
    read_source_options,
    read_values,
    source_option,
    source_options,
    stack_options,
    variables_option,
)
from animtool.core.errors import Fault, FormatError
from animtool.core.files.reading import exists
from animtool.core.names import check_unused_variables, has_kind_suffix
from animtool.core.options import options_of
from animtool.core.readers import is_timeline
from animtool.scene.bake.options import BakeOptions

if TYPE_CHECKING:
    from animtool.batch.cuts import Cut
    from animtool.scene.scene import Scene


def load_sources(
    sources: Sequence[Path], variables: dict[str, str]
) -> list[Path | Scene]:
    """Return the sources of a bake, with scene files loaded."""
    loaded_sources: list[Path | Scene] = []
    used_variables: set[str] = set()
    for source in sources:
        if exists(source) and source.is_dir():
            hint = "animtool batch FOLDER -o out/ bakes the files in it"
            message = "cannot be read: it is a folder"
            raise FormatError(Fault("IO001", message, str(source), (), hint))
        if not has_kind_suffix(source, "scene"):
            loaded_sources.append(source)
            continue
        from animtool.scene.file.read import load_scene

        scene = load_scene(source, variables)
        used_variables |= scene.variables
        loaded_sources.append(scene)
    if variables:
        single_source = sources[0] if len(sources) == 1 else None
        check_unused_variables(variables, used_variables, single_source)
    return loaded_sources


def stop_after_pass(
    sources: list[Path | Scene], last_pass: str | None
) -> list[Path | Scene]:
    """Return the sources, the scene without the passes after the named one."""
    if last_pass is None:
        return sources
    scene = single_scene(sources)
    if scene is None:
        raise click.UsageError("--until needs a SOURCE that is one scene.")
    return [scene.until(last_pass)]


def single_scene(sources: Sequence[Path | Scene]) -> Scene | None:
    """Return the scene if it is the only source, else None."""
    if len(sources) > 1 or isinstance(sources[0], Path):
        return None
    return sources[0]


def default_bake_output(source: Path | Scene) -> Path:
    """Return the output that the scene names, else the source with suffix ``.usdc``."""
    from animtool.scene.bake.reading import default_output

    if isinstance(source, Path):
        return default_output(source)
    return source.output or default_output(source.path)


SHOT_OPTIONS = (
    click.option(
        "--shot",
        metavar="NAME",
        help="The shot of a timeline; required if it has several.",
    ),
    click.option(
        "--handles",
        type=Count(0),
        metavar="N",
        help="Frames before and after the cut of a timeline, at its rate.  [default: "
        "as the timeline states, else 0]",
    ),
    *TIMECODE_OPTIONS,
)
# Order of the options in ``--help``; options of records that are missing here come
# last.
_OPTION_ORDER: tuple[str | Callable[[Command], Command], ...] = (
    "form",
    click.option(
        "--split",
        is_flag=True,
        help="Write a stage in three files: X.rig.usda, X.anim.usdc, X.",
    ),
    *("rig_layer", "prim_path", "force_fit", "bones", "strip_namespace", "rest_frame"),
    source_option("rig", "template", "cameras", "clamp"),
    variables_option,
    source_options,
    source_option("prim_path", "take", "remap", "dropped", "positions"),
    *("to_units", "to_up", "fps", "frame_range", "start"),
    *SHOT_OPTIONS,
)
# Source options in addition to `source_options`.
_SOURCE_OPTIONS = (
    *("prim_path", "rig", "template", "cameras", "clamp", "take", "remap", "dropped"),
    "positions",
)
# Options that commands declare with their own help; the written take has no flag.
_DECLARED_ELSEWHERE = {"strict", "overwrite", "take"}


def bake_options(command: Command) -> Command:
    """Add all options of `BakeOptions` to a command, and those of the source."""
    entries = dict.fromkeys((*_OPTION_ORDER, *options_of(BakeOptions)))
    decorators = [
        bake_option(entry) if isinstance(entry, str) else entry
        for entry in entries
        if entry not in _DECLARED_ELSEWHERE
    ]
    return stack_options(*decorators)(command)


def read_bake_options(params: Mapping[str, Any]) -> BakeOptions:
    """Return the `BakeOptions` that the parameters of a command state."""
    source = read_source_options(params, *_SOURCE_OPTIONS)
    # --take names the source's take, not the written one.
    values = read_values(BakeOptions, {n: v for n, v in params.items() if n != "take"})
    values["form"] = "split" if params["split"] else values["form"]
    return BakeOptions(source=source, shot=params["shot"], **values)


def timeline_shot(
    console: Console,
    path: Path | None,
    params: dict[str, Any],
    start: Fraction | None,
    fps: Fraction | None = None,
) -> Cut | None:
    """Return the shot of a timeline with its media; None for any other file."""
    if path is None or not is_timeline(path):
        for name in ("shot", "handles", "cut_start", "first_timecode"):
            if params[name] is not None:
                message = f"--{name.replace('_', '-')} needs a timeline, such as "
                raise click.UsageError(f"{message}edit.otio.")
        return None
    if params["table"]:
        message = "--table measures a take: pass the media, not the timeline."
        raise click.UsageError(message)
    if start is not None and start.denominator != 1:
        raise click.UsageError(f"--start {start}: a shot begins at a whole frame.")
    from animtool.batch.cut_frames import CutOptions
    from animtool.batch.cuts import read_cut

    options = CutOptions(
        None if start is None else int(start),
        params["cut_start"],
        params["handles"],
        params["first_timecode"],
        fps,
    )
    cuts = read_cut(path, params["shot"], options)
    console.faults(cuts.notices)
    if not cuts.shots:
        hint = f"animtool batch {path} TAKES finds media by the names of clips"
        raise FormatError(Fault("BAT042", "the shot has no media", str(path), (), hint))
    return cuts.shots[0]


def replace_timeline(
    console: Console,
    sources: Sequence[Path],
    output: Path | None,
    params: dict[str, Any],
) -> tuple[Sequence[Path], Path | None]:
    """Return the sources and the output, with a timeline replaced by its shot's media.

    The option ``shot`` becomes the shot's record, which includes ``start``.
    """
    path = next(filter(is_timeline, sources), None)
    if path is not None and len(sources) > 1:
        raise click.UsageError("A timeline is baked alone: pass one SOURCE.")
    cut = timeline_shot(console, path, params, params["start"], params["fps"])
    if cut is None:
        return sources, output
    params |= {"shot": cut.shot, "start": None}
    name = cut.shot_values["shot"]
    return [cut.media.path], output or sources[0].with_name(f"{name}.usdc")
