"""Cut lists on the command line: what ``animtool batch`` and ``job`` share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from animtool.cli.options import FILE, Command

if TYPE_CHECKING:
    from animtool.batch.spec import BatchSpec


def cut_options(command: Command) -> Command:
    """Give a command ``--cut`` and ``--handles``."""
    command = click.option(
        "--handles",
        type=click.IntRange(0),
        metavar="N",
        help="Of a timeline: frames before and after each cut, at its rate.  [default: "
        "as the batch file or the timeline says, else 0]",
    )(command)
    return click.option(
        "--cut",
        "cuts",
        type=FILE,
        metavar="FILE",
        help="A timeline that OpenTimelineIO reads: each clip is an item. A timeline "
        "among the inputs is the same; the others are where media is looked for.",
    )(command)


def with_cuts(spec: BatchSpec, given: Mapping[str, Any]) -> BatchSpec:
    """Return a batch with the cut list that a command line names, if it names one."""
    if given["cuts"] is not None:
        spec = replace(spec, cuts=given["cuts"])
    if given["handles"] is not None:
        spec = replace(spec, handles=given["handles"])
    return spec
