"""Output options of commands: existing files, stdout and plots."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.cli.console import Console
from animtool.cli.options import (
    OUTPUT,
    bake_option,
    common_options,
    format_option,
    output_option,
    rig_layer_options,
    stack_options,
    strict_option,
)
from animtool.core.files.output import STDOUT, after_commit, atomic_outputs
from animtool.core.process.signals import ignore_signals
from animtool.scene.bake.options import BakeOptions

if TYPE_CHECKING:
    from animtool.scene.tables.tradeoffs import Tradeoffs


# Options of every command that writes files, applied last, with the console.
writing_options = stack_options(
    bake_option("overwrite"),
    click.option(
        "--skip-existing", is_flag=True, help="Do nothing if all outputs exist."
    ),
    format_option,
    common_options,
    click.pass_obj,
)
take_output_option = output_option(
    "File to write: USD (.usda, .usdc, .usd), .clip.yaml or .bvh, or - for usda "
    "on stdout.  [default: nothing]",
    kind=OUTPUT,
)
split_option = click.option(
    "--split", is_flag=True, help="Write USD in three files, as bake does."
)
# Output options of commands that write a take.
take_output_options = stack_options(
    split_option,
    rig_layer_options,
    bake_option(
        "reduce",
        help_text="Largest error of joints from leaving out keys of a clip or samples "
        "of USD.",
    ),
    strict_option,
)


def read_output_options(
    params: Mapping[str, Any], *more_options: str, **values: Any
) -> BakeOptions:
    """Return the `BakeOptions` of a command that writes a take.

    more_options: Additional options of this command.
    """
    names = ("rig_layer", "force_fit", "prim_path", "reduce", "overwrite")
    values |= {name: params[name] for name in (*names, *more_options)}
    return BakeOptions(form="split" if params["split"] else None, **values)


@contextmanager
def atomic_command() -> Iterator[None]:
    """Commit the outputs that the block of a command writes, at its end.

    The command may only print after that: if it ends with 130 or 143, it has written
    nothing.
    """
    with atomic_outputs():
        after_commit(ignore_signals)
        yield


def skip_existing_outputs(
    console: Console,
    command: str,
    params: Mapping[str, Any],
    output: Path | None,
    outputs: Callable[[], Sequence[Path]],
) -> bool:
    """Return whether ``--skip-existing`` skips the output, and print it if so."""
    if output in {None, STDOUT} or not params["skip_existing"]:
        return False
    if params["overwrite"]:
        message = "--overwrite replaces outputs, but --skip-existing keeps them: use "
        raise click.UsageError(f"{message}one of them.")
    if not all(path.exists() for path in outputs()):
        return False
    console.say(f"{output} exists: skipped")
    if params["report_format"] == "json":
        console.result_json({command: "animtool/1", "skipped": str(output)})
    return True


def goes_to_stdout(output: Path | None, params: Mapping[str, Any]) -> bool:
    """Return whether the output is ``-``, which is stdout."""
    if output != STDOUT:
        return False
    if params["report_format"] == "json":
        raise click.UsageError("-o - and --format json both write to stdout.")
    return True


plot_option = click.option(
    "--plot",
    type=OUTPUT,
    metavar="FILE",
    help="With --table, also draw a plot: error against time (.png, .svg, .pdf; "
    "needs the extra preview).",
)


def refuse_plot_without_table(params: dict[str, Any]) -> None:
    """Refuse ``--plot`` if no table is requested."""
    if params["plot"] is not None and not params["table"]:
        raise click.UsageError("--plot draws what --table measures: pass both.")


def check_plot(plot: Path | None, inputs: Sequence[Path], *, overwrite: bool) -> None:
    """Raise an error if the requested plot cannot be drawn or written."""
    if plot is None:
        return
    from animtool.core.files.output import check_outputs
    from animtool.preview.work_precision import check_drawable

    check_outputs([plot], list(inputs), overwrite=overwrite)
    check_drawable(plot)


def print_tradeoffs(
    console: Console, report: Tradeoffs, report_format: str, plot: Path | None = None
) -> None:
    """Print tables of time against error and, if requested, plot them."""
    from animtool.report.tradeoffs import TABLES

    console.report(report_format, report, TABLES, report.notices)
    if plot is None:
        return
    from animtool.preview.work_precision import draw_panels, panels_of

    draw_panels(panels_of(report.tables), plot)
    console.say(f"{plot}: drawn")


def is_missing_input(path: Path) -> bool:
    """Return whether an input does not exist; `-` is standard input."""
    # The name of an array may follow the file name: take.npz#markers.
    file = Path(str(path).partition("#")[0])
    return str(path) != "-" and not path.exists() and not file.exists()


def refuse_swapped(source: Path, output: Path, arguments: str) -> None:
    """Refuse a missing source if the output exists: they were likely swapped."""
    if output.is_file() and is_missing_input(source):
        text = f"{source} does not exist, but {output} does: did you swap {arguments}?"
        raise click.UsageError(text)
