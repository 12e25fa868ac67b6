"""``animtool bake``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from animtool.cli.bake_options import (
    bake_options,
    bake_options_record,
    bake_shot,
    default_bake_output,
    only_scene,
    opened_sources,
    until_pass,
)
from animtool.cli.console import Console
from animtool.cli.options import (
    INPUT,
    OUTPUT,
    strict_option,
)
from animtool.cli.outputs import (
    all_named,
    check_plot,
    draw,
    goes_to_stdout,
    plot_option,
    refuse_alone,
    skipped,
    writing_options,
)

if TYPE_CHECKING:
    from animtool.preview.work_precision import Panel
    from animtool.scene.bake.prims import BakeReport
    from animtool.scene.convert.takes import ConvertReport
    from animtool.scene.scene import Scene


@click.command(
    epilog="""\b
Examples:
  animtool bake walk.bvh -o walk.usdc
  animtool bake walk.bvh -o hero.usda --split
  animtool bake wave.clip.yaml --rig hero.rig.yaml -o wave.usdc --fps 60
  animtool bake shot.scene.yaml
  animtool bake shot.scene.yaml --set shot=sh020
  animtool bake shot.scene.yaml --plan
  animtool bake edit.otio --shot sh010 --handles 8 -o sh010.usdc
  animtool bake walk.bvh run.bvh idle.clip.yaml -o library.usda
  animtool bake library.usda --take run -o run.usdc
  animtool bake walk.bvh -o walk_layer.usdc --rig-layer hero.rig.usda
  animtool bake walk.bvh -o walk.usda --fps 24 --range 1001-1048 --start 1001
  animtool bake wave.clip.yaml -o wave.usda --keep-curves --reduce 0.5mm
  animtool bake wave.clip.yaml -o cache.usdc --deform --velocities
  animtool bake wave.clip.yaml --table
  animtool bake embers.scene.yaml --table --plot embers.png"""
)
@click.argument(
    "sources",
    metavar="SOURCE...",
    nargs=-1,
    required=True,
    type=INPUT,
)
@click.option(
    "-o",
    "--output",
    type=OUTPUT,
    help="USD file to write (.usda, .usdc, .usd, .usdz), or - for usda on stdout.  "
    "[default: SOURCE with .usdc, the shot's name; a library has none]",
)
@bake_options
@click.option(
    "--table",
    is_flag=True,
    help="Write nothing; measure time and size against error, over sample rates and "
    "tolerances; of what a scene simulates, time against error over integrators and "
    "steps, with its own setting and the best ones marked.",
)
@plot_option
@click.option(
    "--plan",
    is_flag=True,
    help="Write nothing; print every step, what it reads and makes, and what is left "
    "out and why.",
)
@click.option(
    "--until",
    metavar="PASS",
    help="Of a scene, run no pass behind this one, by name or number; 0 is none.",
)
@click.option(
    "--stats",
    is_flag=True,
    help="Say what each stage of a scene and each output took: seconds, memory, error.",
)
@strict_option
@writing_options
def bake(
    console: Console, /, sources: Sequence[Path], output: Path | None, **params: Any
) -> None:
    """Bake SOURCE, a scene, clip, BVH or USD file, to a USD animation that plays.

    Several make a clip library: one skeleton, an animation for each, and a variant
    set `take` that binds one of them. Then -o names the file.

    Of a timeline (.otio and others), --shot names the clip: its shot is baked from the
    media that it shows. animtool batch bakes all of them.

    The summary says what was written and the error made: the largest distance
    between a joint's position in float64 and in the float32 values of the file.
    """
    to_stdout = goes_to_stdout(output, params)
    _check_usage(params)
    sources, output = bake_shot(console, sources, output, params)
    if output is None and len(sources) > 1 and not params["table"]:
        raise click.UsageError("Several sources make one library: name it with -o.")
    opened = opened_sources(sources, dict(params["variables"]))
    opened = until_pass(opened, params["until"])
    if params["plan"]:
        _plan(console, opened, None if to_stdout else output, params)
        return
    if params["table"]:
        _measure(console, opened, output, params)
        return
    scene = only_scene(opened)
    if scene is not None:
        _check_library(scene, params)
        from animtool.scene.bake.outputs import is_several

        if params["stats"]:
            scene.meter.start()
        if is_several(scene):
            _several(console, scene, output, params)
            return
    path = None if to_stdout else output or default_bake_output(opened[0])
    _one(console, opened, path, params)


def _check_usage(params: dict[str, Any]) -> None:
    """Refuse options that exclude each other."""
    if params["split"] and params["form"] == "layer":
        raise click.UsageError("--split is a stage in three files, not --as layer.")
    if params["plan"] and params["table"]:
        raise click.UsageError("--plan and --table write nothing: give one.")
    refuse_alone(params)
    if params["stats"] and (params["plan"] or params["table"]):
        raise click.UsageError("--stats measures a bake: no --plan or --table.")


def _check_library(scene: Scene, params: dict[str, Any]) -> None:
    """Refuse to skip a library, to which a take is added."""
    if params["skip_existing"] and any(
        output.bake.form == "library" for output in scene.outputs
    ):
        message = (
            "--skip-existing is for whole files, and the scene adds a take to one."
        )
        raise click.UsageError(message)


def _plan(
    console: Console,
    opened: Sequence[Path | Scene],
    output: Path | None,
    params: dict[str, Any],
) -> None:
    """Print what a bake would do."""
    from animtool.cli.plan_summary import steps_json, steps_text
    from animtool.scene.bake.plan_steps import bake_steps

    scene = only_scene(opened)
    if output is None and (scene is None or scene.output is None):
        output = default_bake_output(opened[0])
    steps = bake_steps(opened, output, bake_options_record(params))
    if params["report_format"] == "json":
        console.result_json(steps_json(steps))
        return
    console.result(*steps_text(steps))


def _one(
    console: Console,
    opened: Sequence[Path | Scene],
    path: Path | None,
    params: dict[str, Any],
) -> None:
    """Bake sources to one output; no path is stdout."""
    if path is not None and skipped(
        console, "bake", params, path, lambda: _outputs(opened, path, params)
    ):
        return
    from animtool.scene.bake.bake import bake_file

    options = bake_options_record(params)
    names = [s.name if isinstance(s, Path) else s.path.name for s in opened]
    label = names[0] if len(names) == 1 else f"{len(names)} takes"
    shown = console.progress(f"bake {label}", stdout=path is None)
    with all_named(), shown as progress:
        report = bake_file(opened, path, options, progress=progress)
    _say_reports(console, [report], only_scene(opened), params, several=False)


def _outputs(
    sources: Sequence[Path | Scene], path: Path, params: dict[str, Any]
) -> Sequence[Path]:
    from animtool.scene.bake.reading import bake_outputs

    return bake_outputs(sources, path, bake_options_record(params))


def _several(
    console: Console, scene: Scene, output: Path | None, params: dict[str, Any]
) -> None:
    """Bake a scene to the outputs that it names."""
    from animtool.scene.bake.outputs import bake_scene, scene_files

    if output is not None:
        raise click.UsageError("The scene names its outputs: no -o.")
    options = bake_options_record(params)
    if skipped(
        console, "bake", params, scene.path, lambda: scene_files(scene, options)
    ):
        return
    with all_named(), console.progress(f"bake {scene.path.name}") as progress:
        reports = bake_scene(scene, options, progress=progress)
    _say_reports(console, reports, scene, params, several=True)


def _say_reports(
    console: Console,
    reports: Sequence[BakeReport | ConvertReport],
    scene: Scene | None,
    params: Mapping[str, Any],
    *,
    several: bool,
) -> None:
    """Print the summaries of outputs: of one as it is, of several of a scene together.

    No scene has no stages.
    """
    from animtool.cli.plan_summary import stats_json, stats_text
    from animtool.cli.summary import bake_details, output_json, output_text
    from animtool.scene.bake.prims import raise_stopped

    notices = [notice for report in reports for notice in report.notices]
    # What the sources and passes say stands in every report.
    console.faults(dict.fromkeys(notices) if several else notices)
    stages = [] if scene is None else scene.meter.stages
    if params["report_format"] == "json":
        costs = {"stats": stats_json(stages, reports)} if params["stats"] else {}
        written = [output_json(report) for report in reports]
        whole = {"bake": "animtool/1", "written": written} if several else written[0]
        console.result_json({**whole, **costs})
        raise_stopped(reports)
        return
    for report in reports:
        _say(console, output_text(report))
    for report in () if several else reports:
        for line in bake_details(cast("BakeReport", report)):
            console.detail(line)
    if params["stats"]:
        _say(console, stats_text(stages, reports))
    raise_stopped(reports)


def _say(console: Console, lines: Iterable[str]) -> None:
    for line in lines:
        console.say(line)


def _measure(
    console: Console,
    sources: Sequence[Path | Scene],
    output: Path | None,
    params: Mapping[str, Any],
) -> None:
    """Measure time against error, print it, and draw it where that is asked for."""
    if output is not None:
        raise click.UsageError("--table writes no file: no -o.")
    if len(sources) > 1:
        raise click.UsageError("--table measures one SOURCE.")
    plot, source = params["plot"], sources[0]
    inputs = [source] if isinstance(source, Path) else source.inputs
    check_plot(plot, inputs, overwrite=params["overwrite"])
    scene = only_scene(sources)
    if scene is not None:
        from animtool.scene.tables.simulation import simulates

        if simulates(scene):
            panels = _simulation_table(console, scene, params)
            draw(console, panels, plot)
            return
    draw(console, _bake_table(console, source, params), plot)


def _simulation_table(
    console: Console, scene: Scene, params: Mapping[str, Any]
) -> Callable[[], list[Panel]]:
    """Measure what a scene simulates, print it, and return what draws it."""
    from animtool.cli.simulation_summary import (
        simulation_table_json,
        simulation_table_text,
    )
    from animtool.preview.work_precision import simulation_panels
    from animtool.scene.tables.simulation import simulation_table

    with console.progress(f"measure {scene.path.name}") as progress:
        table = simulation_table(scene, bake_options_record(params), progress=progress)
    console.faults(table.notices)
    if params["report_format"] == "json":
        console.result_json(simulation_table_json(table))
    else:
        console.result(*simulation_table_text(table))
    return lambda: simulation_panels(table)


def _bake_table(
    console: Console, source: Path | Scene, params: Mapping[str, Any]
) -> Callable[[], list[Panel]]:
    """Measure rates and tolerances, print it, and return what draws it."""
    from animtool.cli.summary import table_json, table_text
    from animtool.preview.work_precision import bake_panels
    from animtool.scene.tables.bake import bake_table

    options = bake_options_record(params)
    if options.deform:
        raise click.UsageError("--table measures joints, not --deform.")
    name = source.name if isinstance(source, Path) else source.path.name
    with console.progress(f"measure {name}") as progress:
        table = bake_table(source, options, progress=progress)
    if params["report_format"] == "json":
        console.result_json(table_json(table))
    else:
        console.result(*table_text(table))
    return lambda: bake_panels(table)
