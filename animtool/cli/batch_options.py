"""Timelines and variants on the command line of ``animtool batch`` and ``job``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from animtool.cli.options import FILE, RATE, TIMECODE_OPTIONS, Count, stack_options

if TYPE_CHECKING:
    from animtool.batch.spec import BatchSpec

# Shot options by their names in `BatchSpec`.
CUT_OPTIONS = ("handles", "fps", "cut_start", "first_timecode")

cut_options = stack_options(
    click.option(
        "--cut",
        "cuts",
        type=FILE,
        metavar="FILE",
        help="A timeline that OpenTimelineIO reads: each clip becomes an item. A "
        "timeline among the inputs does the same; the others are searched for media.",
    ),
    click.option(
        "--handles",
        type=Count(0),
        metavar="N",
        help="Frames before and after each cut of a timeline, at its rate.  "
        "[default: as the batch file or the timeline states, else 0]",
    ),
    click.option(
        "--fps",
        type=RATE,
        metavar="RATE",
        help="Frames per second of the outputs; for a timeline without a rate, such "
        "as an EDL, the rate of its time codes and shots: 24, 25, 30000/1001.",
    ),
    *TIMECODE_OPTIONS,
)
variant_options = stack_options(
    click.option(
        "--variants",
        "table",
        type=FILE,
        metavar="FILE",
        help="A CSV file of values: names in the first line, then one item per line.",
    ),
    click.option(
        "--vary",
        "columns",
        multiple=True,
        metavar="NAME=VALUES",
        help="Build an item for each value of ${NAME} in the scene: values with "
        "commas, or ranges such as 1..20 or 0..1/0.25. Repeat it for every "
        "combination.",
    ),
)


def with_cuts(spec: BatchSpec, params: Mapping[str, Any]) -> BatchSpec:
    """Return a batch with the timeline of the command line, if there is one."""
    names = [name for name in ("cuts", *CUT_OPTIONS) if params[name] is not None]
    return replace(spec, **{name: params[name] for name in names})


def cut_arguments(params: Mapping[str, Any]) -> list[str]:
    """Return the words of a command line that repeat the given shot options."""
    words = []
    for name in CUT_OPTIONS:
        if params[name] is not None:
            words += [f"--{name.replace('_', '-')}", str(params[name])]
    return words


def variant_arguments(params: Mapping[str, Any]) -> list[str]:
    """Return the words ``--variants`` and ``--vary`` that repeat the given variants."""
    words = [] if params["table"] is None else ["--variants", str(params["table"])]
    for text in params["columns"]:
        words += ["--vary", text]
    return words


def with_variants(spec: BatchSpec, params: Mapping[str, Any]) -> BatchSpec:
    """Return a batch with the variants of the command line, if there are any."""
    if params["table"] is not None and params["columns"]:
        message = "--variants and --vary both set values: use one of them."
        raise click.UsageError(message)
    if params["table"] is not None:
        from animtool.batch.variants import read_variants

        return replace(spec, variants=read_variants(params["table"]))
    if params["columns"]:
        from animtool.batch.variants import variants_of_texts

        return replace(spec, variants=variants_of_texts(params["columns"]))
    return spec
