"""``animtool bake``: scenes, takes and shots to USD and other formats."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn

import click

from animtool.cli.bake_options import (
    bake_options,
    default_bake_output,
    load_sources,
    read_bake_options,
    replace_timeline,
    single_scene,
    stop_after_pass,
)
from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import INPUT, OUTPUT, output_option, strict_option
from animtool.cli.outputs import (
    atomic_command,
    check_plot,
    goes_to_stdout,
    is_missing_input,
    plot_option,
    print_tradeoffs,
    refuse_plot_without_table,
    refuse_swapped,
    skip_existing_outputs,
    writing_options,
)
from animtool.core.record import dataclass
from animtool.core.values import VERSION
from animtool.core.writers import file_suffixes, writer_of

if TYPE_CHECKING:
    from animtool.scene.bake.files import ConvertReport
    from animtool.scene.bake.prims import BakeReport
    from animtool.scene.bake.progress import BakeStats
    from animtool.scene.bake.request import BakeRequest
    from animtool.scene.scene import Scene


USD_SUFFIXES = {".usd", ".usda", ".usdc", ".usdz"}
# Passes that simulate, which may take minutes.
SIMULATING_PASSES = {"simulate", "ragdoll"}


def _refuse_patterns(sources: Sequence[Path]) -> None:
    """Refuse a glob pattern that the shell did not expand."""
    for path in sources:
        if set("*?[") & {*str(path)} and not path.exists():
            text = f"{path} is a pattern: animtool batch '{path}' -o out/ bakes the "
            raise click.UsageError(f"{text}files that match it.")


@command(
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
@click.argument("sources", metavar="SOURCE...", nargs=-1, required=True, type=INPUT)
@output_option(
    "File to write: USD (.usda, .usdc, .usd, .usdz), or another motion format "
    f"({', '.join(file_suffixes())}); - writes usda to stdout.  [default: "
    "SOURCE with .usdc, or the shot's name; a library has none]",
    kind=OUTPUT,
)
@bake_options
@click.option(
    "--table",
    is_flag=True,
    help="Write nothing; measure time and size against error, over sample rates and "
    "tolerances; for a simulated scene, time against error over integrators and "
    "steps, with the current setting and the best ones marked.",
)
@plot_option
@click.option(
    "--plan",
    is_flag=True,
    help="Write nothing; print every step, what it reads and makes, and what is "
    "skipped and why.",
)
@click.option(
    "--until",
    metavar="PASS",
    help="Stop a scene after this pass, by name or number; 0 runs none.",
)
@click.option(
    "--stats",
    is_flag=True,
    help="Report the seconds, memory and error of each stage of a scene and each "
    "output.",
)
@strict_option
@writing_options
def bake(
    console: Console, /, sources: Sequence[Path], output: Path | None, **params: Any
) -> None:
    """Bake SOURCE, a scene, clip, BVH, glTF, FBX or USD file, to a USD animation.

    Several sources make a clip library, named by -o: one skeleton, an animation for
    each, and a variant set `take` that binds one of them.

    For a timeline (.otio and others), --shot names the clip: its shot is baked from
    the media it shows. animtool batch bakes all shots.

    The summary reports what was written and the error: the largest distance between
    a joint's position in float64 and in the float32 values of the file.
    """
    is_stdout = goes_to_stdout(output, params)
    _refuse_conflicting_options(params)
    _refuse_patterns(sources)
    if not params["overwrite"] and output is not None:
        if len(sources) == 1:
            refuse_swapped(sources[0], output, "SOURCE and -o")
        if not params["skip_existing"]:
            _refuse_capture(sources[0], output)
    if output is None and len(sources) == 2:
        _refuse_swapped_pair(*sources)
    sources, output = replace_timeline(console, sources, output, params)
    if output is None and len(sources) > 1 and not params["table"]:
        _refuse_unnamed_library(sources)
    loaded_sources = load_sources(sources, dict(params["variables"]))
    loaded_sources = stop_after_pass(loaded_sources, params["until"])
    if params["table"]:
        _measure_tradeoffs(console, loaded_sources, output, params)
        return
    scene = single_scene(loaded_sources)
    if scene is not None and output is not None and len(scene.outputs) > 1:
        raise click.UsageError("The scene names its outputs: remove -o.")
    if output is None and (scene is None or scene.output is None):
        output = default_bake_output(loaded_sources[0])
    from animtool.scene.bake.request import create_request

    request = create_request(loaded_sources, output, read_bake_options(params))
    if params["plan"]:
        _print_plan(console, request, params)
        return
    if scene is not None:
        _refuse_skipped_library(scene, params)
        if params["stats"]:
            scene.meter.start()
    _bake_outputs(console, request, params, is_stdout=is_stdout)


def _refuse_swapped_pair(first: Path, second: Path) -> None:
    """Refuse two swapped arguments: a missing output, then a source that exists."""
    is_output = writer_of(first) is not None and is_missing_input(first)
    if is_output and not is_missing_input(second):
        names = shlex.quote(str(second)), shlex.quote(str(first))
        text = f"{first} does not exist, but {second} does; to write {first}, use "
        raise click.UsageError(f"{text}animtool bake {names[0]} -o {names[1]}")


def _refuse_unnamed_library(sources: Sequence[Path]) -> NoReturn:
    """Refuse several sources without an output; the last may be meant as the output."""
    *first_sources, last_source = sources
    name = shlex.quote(str(last_source))
    is_missing = is_missing_input(last_source)
    if is_missing and all(source.exists() for source in first_sources):
        text = f"{last_source} does not exist; to write it, use -o {name}"
        raise click.UsageError(text)
    text = "Several sources make one library: name it with -o"
    if not is_missing and writer_of(last_source) is not None:
        text += f"; if {last_source} is the output, write -o {name}"
    raise click.UsageError(f"{text}.")


def _refuse_capture(source: Path, output: Path) -> None:
    """Refuse to overwrite a capture with its bake; the hint shows both commands."""
    is_existing_stage = source.suffix in USD_SUFFIXES and source.exists()
    if is_existing_stage and output.suffix == ".bvh" and output.is_file():
        text = f"{output} already exists: to bake it, write animtool bake {output} -o "
        text += f"{source} --overwrite; to replace it, add --overwrite"
        raise click.UsageError(text)


def _refuse_conflicting_options(params: dict[str, Any]) -> None:
    """Raise `UsageError` if `--split`, `--plan`, `--table` or `--stats` conflict."""
    if params["split"] and params["form"] == "layer":
        raise click.UsageError("--split writes a stage in three files, not --as layer.")
    if params["plan"] and params["table"]:
        raise click.UsageError("--plan and --table write nothing: use one of them.")
    refuse_plot_without_table(params)
    if params["stats"] and (params["plan"] or params["table"]):
        raise click.UsageError("--stats measures a bake: remove --plan or --table.")


def _refuse_skipped_library(scene: Scene, params: dict[str, Any]) -> None:
    """Refuse `--skip-existing` if a take is added to a clip library."""
    has_library = any(output.bake.form == "library" for output in scene.outputs)
    if params["skip_existing"] and has_library:
        message = "--skip-existing works on whole files, but the scene adds a take to "
        raise click.UsageError(f"{message}one.")


def _print_plan(console: Console, request: BakeRequest, params: dict[str, Any]) -> None:
    """Print the steps that a bake would run (``--plan``)."""
    from animtool.cli.summary import PLAN_TEMPLATE
    from animtool.scene.bake.steps import PlanSteps, bake_steps

    steps = PlanSteps(bake_steps(request))
    console.report(params["report_format"], steps, PLAN_TEMPLATE, request.notices)


def _bake_outputs(
    console: Console, request: BakeRequest, params: dict[str, Any], *, is_stdout: bool
) -> None:
    """Bake all outputs of a request, unless existing ones are skipped, and report."""
    from animtool.scene.bake.bake import run_request

    scene, files = request.scene, request.source_set.files
    first_output = request.outputs[0]
    has_several = any(entry.location is not None for entry in request.outputs) and (
        len(request.outputs) > 1 or not first_output.is_stage
    )
    shown_path = files[0] if has_several else first_output.path
    all_files = request.files
    if skip_existing_outputs(console, "bake", params, shown_path, lambda: all_files):
        return
    pass_names = set() if scene is None else {use.pass_.name for use in scene.passes}
    if scene is not None and (scene.systems or SIMULATING_PASSES & pass_names):
        console.warn_early(request.notices)
    label = files[0].name if len(files) == 1 else f"{len(files)} takes"
    progress_bar = console.progress(f"bake {label}", is_stdout=is_stdout)
    with atomic_command(), progress_bar as progress:
        reports = run_request(request, progress=progress)
    _print_reports(console, reports, scene, params, has_several=has_several)


@dataclass(frozen=True, slots=True)
class BakeResult:
    """Reports of all outputs; a single output is reported without a list."""

    reports: Sequence[BakeReport | ConvertReport]
    has_several: bool
    costs: BakeStats | None  # where measured
    json_keys: ClassVar[str] = "*head written+ *single_report *costs"

    @property
    def head(self) -> dict[str, str]:
        """Command and version; empty for a single report, which states them itself."""
        return {"bake": VERSION} if self.has_several else {}

    @property
    def written(self) -> Sequence[BakeReport | ConvertReport]:
        """Reports of the outputs, if there are several."""
        return self.reports if self.has_several else ()

    @property
    def single_report(self) -> BakeReport | ConvertReport | None:
        """Report of the output, if there is exactly one."""
        return None if self.has_several else self.reports[0]


def _print_reports(
    console: Console,
    reports: Sequence[BakeReport | ConvertReport],
    scene: Scene | None,
    params: Mapping[str, Any],
    *,
    has_several: bool,
) -> None:
    """Print the reports of all outputs, as JSON or as text.

    Without a scene, the costs of stages are omitted.
    """
    from animtool.cli.summary import STATS_TEMPLATE, template_of
    from animtool.scene.bake.prims import raise_stopped
    from animtool.scene.bake.progress import BakeStats

    notices = [notice for report in reports for notice in report.notices]
    # Notices of sources and passes are in every report.
    console.faults(dict.fromkeys(notices) if has_several else notices)
    stages = [] if scene is None else scene.meter.stages
    costs = BakeStats([*stages, *(report.cost for report in reports)])
    if params["report_format"] == "json":
        stats = costs if params["stats"] else None
        console.result_json(BakeResult(reports, has_several, stats))
        raise_stopped(reports)
        return
    for report in reports:
        template = template_of(report)
        console.lines(template.text(report))
        if not has_several and console.verbosity > 0:
            console.details(template.detail_lines(report))
    if params["stats"]:
        console.lines(STATS_TEMPLATE.text(costs))
    raise_stopped(reports)


def _measure_tradeoffs(
    console: Console,
    sources: Sequence[Path | Scene],
    output: Path | None,
    params: Mapping[str, Any],
) -> None:
    """Measure time against error; print the table and, if requested, plot it."""
    if output is not None:
        raise click.UsageError("--table writes no file: remove -o.")
    if len(sources) > 1:
        raise click.UsageError("--table measures one SOURCE.")
    plot, source = params["plot"], sources[0]
    inputs = [source] if isinstance(source, Path) else source.inputs
    check_plot(plot, inputs, overwrite=params["overwrite"])
    from animtool.scene.tables.simulation import has_simulation
    from animtool.scene.tables.tradeoffs import simulation_tradeoffs, take_tradeoffs

    options, scene = read_bake_options(params), single_scene(sources)
    name = source.name if isinstance(source, Path) else source.path.name
    with console.progress(f"measure {name}") as progress:
        if scene is not None and has_simulation(scene):
            report = simulation_tradeoffs(scene, options, progress=progress)
        elif options.deform:
            raise click.UsageError("--table measures joints, not --deform.")
        else:
            report = take_tradeoffs(source, options, progress=progress)
    print_tradeoffs(console, report, params["report_format"], plot)
