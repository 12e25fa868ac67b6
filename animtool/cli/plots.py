"""``--plot`` of commands that have a ``--table``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.cli.console import Console
from animtool.cli.options import OUTPUT

if TYPE_CHECKING:
    from animtool.preview.work_precision import Panel


def plot_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--plot``."""
    return click.option(
        "--plot",
        type=OUTPUT,
        metavar="FILE",
        help="With --table, draw it too: error against time (.png, .svg, .pdf; needs "
        "the extra preview).",
    )(command)


def refuse_alone(given: dict[str, Any]) -> None:
    """Refuse ``--plot`` without a table.

    Raises:
        UsageError: There is none.
    """
    if given["plot"] is not None and not given["table"]:
        raise click.UsageError("--plot draws what --table measures: give both.")


def check_plot(plot: Path | None, inputs: Sequence[Path], *, overwrite: bool) -> None:
    """Raise where the picture that is asked for cannot be drawn.

    Args:
        plot: Its file; None is not asked for.
        inputs: What is read, which it may not replace.
        overwrite: Whether it may replace a file.

    Raises:
        OptionError: It is no picture, or there is no matplotlib, or it exists.
        OutputError: It cannot be written.
    """
    if plot is None:
        return
    from animtool.output import check_outputs
    from animtool.preview.work_precision import check_drawable

    check_outputs([plot], list(inputs), overwrite=overwrite)
    check_drawable(plot)


def draw(
    console: Console, panels: Callable[[], list[Panel]], plot: Path | None
) -> None:
    """Draw panels and say so, where a picture is asked for.

    Raises:
        OutputError: It cannot be written.
    """
    if plot is None:
        return
    from animtool.preview.work_precision import draw_panels

    draw_panels(panels(), plot)
    console.say(f"{plot}: drawn")
