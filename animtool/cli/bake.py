"""``animtool bake``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.cli.console import Console
from animtool.cli.options import (
    INPUT,
    LENGTH,
    OUTPUT,
    RATE,
    Parsed,
    common_options,
    format_option,
    reduce_at_option,
    rig_layer_options,
    set_option,
    source_options,
    source_options_record,
    source_prim_option,
    strict_option,
    take_option,
)
from animtool.cli.outputs import existing_options, goes_to_stdout, skipped

if TYPE_CHECKING:
    from animtool.preview.work_precision import Panel
    from animtool.scene.report import BakeReport
    from animtool.scene.scene import Scene

__all__ = ["bake"]


def _parsed(name: str) -> Parsed:
    def parse(text: str) -> Any:
        from animtool.scene import options

        return getattr(options, f"parse_{name}")(text)

    return Parsed(name, parse)


@click.command(
    epilog="""\b
Examples:
  animtool bake walk.bvh -o walk.usdc
  animtool bake walk.bvh -o hero.usda --split
  animtool bake wave.clip.yaml --rig hero.rig.yaml -o wave.usdc --fps 60
  animtool bake shot.scene.yaml
  animtool bake shot.scene.yaml --set shot=sh020
  animtool bake shot.scene.yaml --plan
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
    help="USD file to write (.usda, .usdc, .usd), or - for usda on stdout.  "
    "[default: SOURCE with .usdc; a library has none]",
)
@click.option(
    "--as",
    "form",
    type=click.Choice(["stage", "layer"]),
    help="One file with skeleton and animation, or only the animation, over a rig "
    "layer.  [default: layer where there is --rig-layer, else stage]",
)
@click.option(
    "--split", is_flag=True, help="A stage in three files: X.rig.usda, X.anim.usdc, X."
)
@rig_layer_options
@click.option("--bones", is_flag=True, help="Add light geometry that shows the joints.")
@click.option(
    "--strip-namespace",
    type=click.IntRange(0),
    default=0,
    metavar="N",
    show_default=True,
    help="Drop the first N 'ns:' parts of joint names.",
)
@click.option(
    "--rest",
    "rest_frame",
    type=_parsed("rest"),
    metavar="offsets|frame:N",
    help="Where the rest pose comes from.  [default: offsets]",
)
@click.option(
    "--rig",
    type=INPUT,
    metavar="FILE",
    help="Rig of a clip, in place of the one that it names.",
)
@click.option(
    "--clamp",
    is_flag=True,
    help="Bring a clip's controls into their ranges and joints into their limits.",
)
@set_option
@source_options
@source_prim_option
@take_option
@click.option(
    "--to-units", type=click.Choice(["m", "cm", "mm", "in"]), help="Unit of the output."
)
@click.option(
    "--to-up",
    type=click.Choice(["Y", "Z"], case_sensitive=False),
    help="Up axis of the output.",
)
@click.option("--fps", type=RATE, metavar="RATE", help="Frames a second of the output.")
@click.option(
    "--range",
    "frame_range",
    type=_parsed("frame_range"),
    metavar="A-B[xN]",
    help="Frames to write, such as 1-240, 1-240x2 or 12, as the output numbers them.",
)
@click.option(
    "--start",
    type=_parsed("frame"),
    metavar="FRAME",
    help="Time code of the first frame.  [default: the rig layer's, the project's, 1]",
)
@click.option(
    "--samples",
    type=_parsed("offsets"),
    metavar="OFFSETS",
    default=(),
    help="Samples around each frame, such as -.25,0,.25.",
)
@click.option("--keep-samples", is_flag=True, help="Keep the source's own samples.")
@click.option(
    "--root-motion",
    type=click.Choice(["joint", "skelroot"]),
    default="joint",
    show_default=True,
    help="What carries the root's motion.",
)
@click.option(
    "--sparse", is_flag=True, help="Write only the joints that leave their rest."
)
@click.option(
    "--keep-curves",
    is_flag=True,
    help="Write the curves of a clip's controls too, as splines that stay editable.",
)
@click.option(
    "--reduce",
    type=LENGTH,
    metavar="LENGTH",
    help="Leave out samples that the others give back within so much, such as 0.5mm.",
)
@reduce_at_option
@click.option(
    "--deform",
    is_flag=True,
    help="Write the meshes and strands of the rig deformed, as point caches, in place "
    "of a skinned character: points, extent, and normals of meshes that have them.",
)
@click.option(
    "--velocities",
    is_flag=True,
    help="With --deform, how fast points move too, per second, for motion blur.",
)
@click.option(
    "--normals/--no-normals",
    default=None,
    help="With --deform, whether meshes keep normals, which are half of the file.  "
    "[default: normals]",
)
@click.option(
    "--chunk",
    type=click.IntRange(1),
    metavar="N",
    help="Of --deform and of a scene's systems, for long takes, a file for every N "
    "samples, joined as value clips; memory holds two or three of them.",
)
@click.option(
    "--table",
    is_flag=True,
    help="Write nothing; measure time and size against error, over sample rates and "
    "tolerances; of what a scene simulates, time against error over integrators and "
    "steps, with its own setting and the best ones marked.",
)
@click.option(
    "--plot",
    type=OUTPUT,
    metavar="FILE",
    help="With --table, draw it too: error against time (.png, .svg, .pdf; needs the "
    "extra preview).",
)
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
@existing_options
@format_option
@common_options
@click.pass_obj
def bake(
    console: Console, /, sources: tuple[Path, ...], output: Path | None, **given: Any
) -> None:
    """Bake SOURCE, a scene, clip, BVH or USD file, to a USD animation that plays.

    Several make a clip library: one skeleton, an animation for each, and a variant
    set `take` that binds one of them. Then -o names the file.

    The summary says what was written and the error made: the largest distance
    between a joint's position in float64 and in the float32 values of the file.
    """
    as_json = given["report_format"] == "json"
    to_stdout = goes_to_stdout(output, given)
    _check_usage(given)
    if output is None and len(sources) > 1 and not given["table"]:
        raise click.UsageError("Several sources make one library: name it with -o.")
    opened = _until(_opened(sources, dict(given["variables"])), given["until"])
    scene = _only_scene(opened)
    if given["plan"]:
        path = None if to_stdout else output
        _plan(console, opened, path, _options(given), as_json=as_json)
        return
    if given["table"]:
        _table(console, opened, output, given, as_json=as_json)
        return
    if scene is not None:
        _check_library(scene, given)
        from animtool.scene.outputs import is_several

        if given["stats"]:
            scene.meter.start()
        if is_several(scene):
            _several(console, scene, output, given, as_json=as_json)
            return
    path = None if to_stdout else output or _output_beside(opened[0])
    if path is not None and skipped(
        console, "bake", given, path, lambda: _outputs(opened, path, given)
    ):
        return

    from animtool.scene.bake import bake as run_bake

    label = sources[0].name if len(sources) == 1 else f"{len(sources)} takes"
    with console.progress(f"bake {label}", stdout=to_stdout) as progress:
        report = run_bake(opened, path, _options(given), progress=progress)
    console.faults(report.notices)
    _say(console, report, scene if given["stats"] else None, given, as_json=as_json)


def _say(
    console: Console,
    report: BakeReport,
    scene: Scene | None,
    given: dict[str, Any],
    *,
    as_json: bool,
) -> None:
    """Print the summary of a bake."""
    from animtool.cli.plan_summary import stats_json, stats_text
    from animtool.cli.summary import bake_details, bake_json, bake_text

    stages = [] if scene is None else scene.meter.stages
    if as_json:
        costs = {"stats": stats_json(stages, [report])} if given["stats"] else {}
        console.result_json({**bake_json(report), **costs})
        return
    for line in bake_text(report):
        console.say(line)
    for line in bake_details(report):
        console.detail(line)
    for line in stats_text(stages, [report]) if given["stats"] else ():
        console.say(line)


def _until(opened: list[Path | Scene], stop: str | None) -> list[Path | Scene]:
    """Return sources, the one scene among them without the passes behind one."""
    if stop is None:
        return opened
    scene = _only_scene(opened)
    if scene is None:
        raise click.UsageError("--until is for a SOURCE that is one scene.")
    return [scene.until(stop)]


def _check_usage(given: dict[str, Any]) -> None:
    """Refuse options that exclude each other."""
    if given["split"] and given["form"] == "layer":
        raise click.UsageError("--split is a stage in three files, not --as layer.")
    if given["plan"] and given["table"]:
        raise click.UsageError("--plan and --table write nothing: give one.")
    if given["plot"] is not None and not given["table"]:
        raise click.UsageError("--plot draws what --table measures: give both.")
    if given["stats"] and (given["plan"] or given["table"]):
        raise click.UsageError("--stats measures a bake: no --plan or --table.")


def _check_library(scene: Scene, given: dict[str, Any]) -> None:
    """Refuse to skip a library, to which a take is added."""
    if given["skip_existing"] and any(
        output.bake.form == "library" for output in scene.outputs
    ):
        message = (
            "--skip-existing is for whole files, and the scene adds a take to one."
        )
        raise click.UsageError(message)


def _only_scene(opened: Sequence[Path | Scene]) -> Scene | None:
    """Return the one source where it is a scene."""
    if len(opened) > 1 or isinstance(opened[0], Path):
        return None
    return opened[0]


def _plan(
    console: Console,
    opened: Sequence[Path | Scene],
    output: Path | None,
    options: Any,
    *,
    as_json: bool,
) -> None:
    """Print what a bake would do."""
    from animtool.cli.plan_summary import steps_json, steps_text
    from animtool.scene.steps import bake_steps

    scene = _only_scene(opened)
    if output is None and (scene is None or scene.output is None):
        output = _output_beside(opened[0])
    steps = bake_steps(opened, output, options)
    if as_json:
        console.result_json(steps_json(steps))
        return
    console.result("\n".join(steps_text(steps)))


def _opened(sources: Sequence[Path], variables: dict[str, str]) -> list[Path | Scene]:
    """Return sources, those loaded that are scenes.

    Raises:
        OptionError: No scene uses a variable that is given.
    """
    from animtool.scene.sources import is_scene

    opened: list[Path | Scene] = []
    used: set[str] = set()
    for source in sources:
        if not is_scene(source):
            opened.append(source)
            continue
        from animtool.scene.file import load_scene

        scene = load_scene(source, variables)
        used |= scene.variables
        opened.append(scene)
    if variables:
        from animtool.documents.names import check_given

        check_given(variables, used)
    return opened


def _several(
    console: Console,
    scene: Scene,
    output: Path | None,
    given: dict[str, Any],
    *,
    as_json: bool,
) -> None:
    """Bake a scene to the outputs that it names."""
    from animtool.scene.outputs import bake_scene, scene_files

    if output is not None:
        raise click.UsageError("The scene names its outputs: no -o.")
    options = _options(given)
    if skipped(console, "bake", given, scene.path, lambda: scene_files(scene, options)):
        return
    reports = bake_scene(scene, options)
    stages = scene.meter.stages
    # What the sources and passes say stands in every report.
    notices = [notice for report in reports for notice in report.notices]
    console.faults(dict.fromkeys(notices))
    from animtool.cli.plan_summary import stats_json, stats_text
    from animtool.cli.summary import output_json, output_text

    if as_json:
        written = [output_json(report) for report in reports]
        costs = {"stats": stats_json(stages, reports)} if given["stats"] else {}
        console.result_json({"bake": "animtool/1", "written": written, **costs})
        return
    for report in reports:
        for line in output_text(report):
            console.say(line)
    for line in stats_text(stages, reports) if given["stats"] else ():
        console.say(line)


def _outputs(
    sources: Sequence[Path | Scene], path: Path, given: dict[str, Any]
) -> Sequence[Path]:
    from animtool.scene.files import bake_outputs

    return bake_outputs(sources, path, _options(given))


def _table(
    console: Console,
    sources: Sequence[Path | Scene],
    output: Path | None,
    given: dict[str, Any],
    *,
    as_json: bool,
) -> None:
    """Measure time against error, print it, and draw it where that is asked for."""
    if output is not None:
        raise click.UsageError("--table writes no file: no -o.")
    if len(sources) > 1:
        raise click.UsageError("--table measures one SOURCE.")
    plot = given["plot"]
    if plot is not None:
        _check_plot(plot, sources[0], overwrite=given["overwrite"])
    scene = _only_scene(sources)
    if scene is not None:
        from animtool.scene.simulation_table import simulates

        if simulates(scene):
            panels = _simulation_table(console, scene, given, as_json=as_json)
            _draw(console, panels, plot)
            return
    _draw(console, _bake_table(console, sources[0], given, as_json=as_json), plot)


def _check_plot(plot: Path, source: Path | Scene, *, overwrite: bool) -> None:
    from animtool.output import check_outputs
    from animtool.preview.work_precision import check_drawable

    inputs = [source] if isinstance(source, Path) else source.inputs
    check_outputs([plot], inputs, overwrite=overwrite)
    check_drawable(plot)


def _draw(
    console: Console, panels: Callable[[], list[Panel]], plot: Path | None
) -> None:
    if plot is None:
        return
    from animtool.preview.work_precision import draw_panels

    draw_panels(panels(), plot)
    console.say(f"{plot}: drawn")


def _simulation_table(
    console: Console, scene: Scene, given: dict[str, Any], *, as_json: bool
) -> Callable[[], list[Panel]]:
    """Measure what a scene simulates, print it, and return what draws it."""
    from animtool.cli.simulation_summary import (
        simulation_table_json,
        simulation_table_text,
    )
    from animtool.preview.tables import simulation_panels
    from animtool.scene.simulation_table import simulation_table

    with console.progress(f"measure {scene.path.name}") as progress:
        table = simulation_table(scene, _options(given), progress=progress)
    console.faults(table.notices)
    if as_json:
        console.result_json(simulation_table_json(table))
    else:
        console.result("\n".join(simulation_table_text(table)))
    return lambda: simulation_panels(table)


def _bake_table(
    console: Console, source: Path | Scene, given: dict[str, Any], *, as_json: bool
) -> Callable[[], list[Panel]]:
    """Measure rates and tolerances, print it, and return what draws it."""
    from animtool.cli.summary import table_json, table_text
    from animtool.preview.tables import bake_panels
    from animtool.scene.table import bake_table

    options = _options(given)
    if options.deform:
        raise click.UsageError("--table measures joints, not --deform.")
    name = source.name if isinstance(source, Path) else source.path.name
    with console.progress(f"measure {name}") as progress:
        table = bake_table(source, options, progress=progress)
    if as_json:
        console.result_json(table_json(table))
    else:
        console.result("\n".join(table_text(table)))
    return lambda: bake_panels(table)


def _output_beside(source: Path | Scene) -> Path:
    """Return the file that a scene names, else the source's own name as usdc."""
    from animtool.scene.sources import source_stem

    if not isinstance(source, Path):
        if source.output is not None:
            return source.output
        source = source.path
    return source.with_name(f"{source_stem(source)}.usdc")


def _options(given: dict[str, Any]) -> Any:
    from animtool.scene.options import BakeOptions
    from animtool.units import LengthUnit, UpAxis

    to_units, to_up = given["to_units"], given["to_up"]
    return BakeOptions(
        source=source_options_record(
            given,
            given["source_prim"],
            given["rig"],
            clamp=given["clamp"],
            take=given["take"],
        ),
        form="split" if given["split"] else given["form"],
        rig_layer=given["rig_layer"],
        prim_path=given["prim_path"],
        bones=given["bones"],
        strip_namespace=given["strip_namespace"],
        rest_frame=given["rest_frame"],
        fps=given["fps"],
        frame_range=given["frame_range"],
        start=given["start"],
        samples=given["samples"],
        keep_samples=given["keep_samples"],
        to_units=None if to_units is None else LengthUnit(to_units),
        to_up=None if to_up is None else UpAxis(to_up.upper()),
        root_motion=given["root_motion"] == "skelroot",
        sparse=given["sparse"],
        keep_curves=given["keep_curves"],
        reduce=given["reduce"],
        reduce_at=given["reduce_at"],
        deform=given["deform"],
        velocities=given["velocities"],
        normals=given["normals"],
        chunk=given["chunk"],
        strict=given["strict"],
        overwrite=given["overwrite"],
    )
