"""``animtool bake --table`` and ``--plot``: time against error, printed and drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.cli.bake_options import bake_options_record, only_scene
from animtool.cli.console import Console
from animtool.cli.options import OUTPUT

if TYPE_CHECKING:
    from animtool.preview.work_precision import Panel
    from animtool.scene.scene import Scene


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
    """Refuse ``--plot`` without a table."""
    if given["plot"] is not None and not given["table"]:
        raise click.UsageError("--plot draws what --table measures: give both.")


def check_plot(plot: Path | None, inputs: Sequence[Path], *, overwrite: bool) -> None:
    """Raise where the picture that is asked for cannot be drawn."""
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


def measure_bake(
    console: Console,
    sources: Sequence[Path | Scene],
    output: Path | None,
    given: Mapping[str, Any],
) -> None:
    """Measure time against error, print it, and draw it where that is asked for."""
    if output is not None:
        raise click.UsageError("--table writes no file: no -o.")
    if len(sources) > 1:
        raise click.UsageError("--table measures one SOURCE.")
    plot, source = given["plot"], sources[0]
    inputs = [source] if isinstance(source, Path) else source.inputs
    check_plot(plot, inputs, overwrite=given["overwrite"])
    scene = only_scene(sources)
    if scene is not None:
        from animtool.scene.simulation_table import simulates

        if simulates(scene):
            panels = _simulation_table(console, scene, given)
            draw(console, panels, plot)
            return
    draw(console, _bake_table(console, source, given), plot)


def _simulation_table(
    console: Console, scene: Scene, given: Mapping[str, Any]
) -> Callable[[], list[Panel]]:
    """Measure what a scene simulates, print it, and return what draws it."""
    from animtool.cli.simulation_summary import (
        simulation_table_json,
        simulation_table_text,
    )
    from animtool.preview.tables import simulation_panels
    from animtool.scene.simulation_table import simulation_table

    with console.progress(f"measure {scene.path.name}") as progress:
        table = simulation_table(scene, bake_options_record(given), progress=progress)
    console.faults(table.notices)
    if given["report_format"] == "json":
        console.result_json(simulation_table_json(table))
    else:
        console.result(*simulation_table_text(table))
    return lambda: simulation_panels(table)


def _bake_table(
    console: Console, source: Path | Scene, given: Mapping[str, Any]
) -> Callable[[], list[Panel]]:
    """Measure rates and tolerances, print it, and return what draws it."""
    from animtool.cli.summary import table_json, table_text
    from animtool.preview.tables import bake_panels
    from animtool.scene.table import bake_table

    options = bake_options_record(given)
    if options.deform:
        raise click.UsageError("--table measures joints, not --deform.")
    name = source.name if isinstance(source, Path) else source.path.name
    with console.progress(f"measure {name}") as progress:
        table = bake_table(source, options, progress=progress)
    if given["report_format"] == "json":
        console.result_json(table_json(table))
    else:
        console.result(*table_text(table))
    return lambda: bake_panels(table)
