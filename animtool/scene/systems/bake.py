"""The bake of a scene that is simulated: systems without a source."""

from __future__ import annotations

import time
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from animtool.clock import MAX_FRAMES
from animtool.edit.frame_range import FrameRange
from animtool.errors import Fault, FormatError, OptionError
from animtool.output import size_of
from animtool.scene.entries import SceneSystem
from animtool.scene.options import BakeOptions
from animtool.scene.progress import Progress
from animtool.scene.report import BakeReport, TakeReport
from animtool.scene.scene import Scene
from animtool.scene.sources import source_stem
from animtool.scene.systems.job import system_job
from animtool.scene.systems.run import SystemRun, write_systems
from animtool.units import UpAxis
from animtool.usd.animation import Rounding
from animtool.usd.forms import Form
from animtool.usd.jobs import UsdResult, WrittenTake, layer_span
from animtool.usd.layers import StageMetadata, check_prim_path
from animtool.usd.names import legal_name
from animtool.usd.simulated import SimulatedJob, simulated_layer

FPS = Fraction(24)


@dataclass(frozen=True, slots=True)
class SystemPlan:
    """Systems that are ready to run.

    Attributes:
        scene: The file.
        systems: What is simulated.
        output: The file to write; None is stdout.
        job: What is written.
        codes: Time codes to write, ascending.
        first: Time code at 0 s.
        options: As given.
    """

    scene: Path
    systems: tuple[SceneSystem, ...]
    output: Path | None
    job: SimulatedJob
    codes: tuple[Fraction, ...]
    first: Fraction
    options: BakeOptions

    def seconds(self, code: Fraction) -> float:
        """Return when a time code is, on the clock of the systems [s]."""
        return float((code - self.first) / self.job.metadata.fps)


def plan_systems(scene: Scene, output: Path | None, options: BakeOptions) -> SystemPlan:
    """Return what is to become of the systems of a scene.

    Args:
        scene: It has systems, and no source.
        output: The file to write; None is stdout.
        options: Those of the scene among them.

    Raises:
        OptionError: It says no range (SCN061), or an option is for characters (SCN062).
    """
    _check(scene, options)
    fps = options.fps or FPS
    frames, own = options.frame_range, scene.bake.frame_range
    if frames is None:
        message = "what is simulated has no end of its own"
        hint = "say which frames to write: range: [1, 120]"
        raise OptionError(Fault("SCN061", message, str(scene.path), (), hint))
    # Where only a part is asked for, the simulation still begins with the whole.
    first = Fraction((own or frames).first) if options.start is None else options.start
    codes = _codes(frames, options.samples)
    if options.prim_path is not None:
        check_prim_path(options.prim_path)
    model = options.prim_path or f"/{legal_name(source_stem(scene.path))}"
    unit = 1.0 if options.to_units is None else options.to_units.meters
    up = options.to_up or UpAxis.Y
    span = Fraction(frames.first), Fraction(frames.last)
    metadata = StageMetadata(model.split("/")[1], fps, *span, unit, up, options.shot)
    job = system_job(scene.systems, model, metadata, unit, up)
    return SystemPlan(scene.path, scene.systems, output, job, codes, first, options)


def _codes(frames: FrameRange, offsets: tuple[Fraction, ...]) -> tuple[Fraction, ...]:
    whole = range(frames.first, frames.last + 1, frames.step)
    count = len(whole) * max(1, len(offsets))
    if count > MAX_FRAMES:
        message = f"the range has {count} samples; at most {MAX_FRAMES} are written"
        raise FormatError(Fault("SCN091", message, where="range"))
    return tuple(
        frame + offset for frame in whole for offset in offsets or (Fraction(),)
    )


def _check(scene: Scene, options: BakeOptions) -> None:
    """Refuse what only characters have."""
    asked = {
        "a rig layer": options.rig_layer is not None,
        "as: split": options.form == Form.SPLIT,
        "as: layer": options.form == Form.LAYER,
        "as: library": options.form == Form.LIBRARY,
        "bones": options.bones,
        "sparse": options.sparse,
        "keep_curves": options.keep_curves,
        "reduce": options.reduce is not None,
        "deform": options.deform,
        "keep_samples": options.keep_samples,
        "root_motion": options.root_motion,
        "rest": options.rest_frame is not None,
    }
    path = str(scene.path)
    faults = [
        Fault("SCN062", f"{name} is for characters, and there is none", path)
        for name, given in asked.items()
        if given
    ]
    if faults:
        raise OptionError(faults)


def run_system_bake(plan: SystemPlan, *, progress: Progress = None) -> BakeReport:
    """Run systems and write what comes of them, frame by frame.

    Args:
        plan: What is to become of them.
        progress: Called with the share done, 0 to 1.

    Raises:
        OutputError: The output cannot be written.
        StrictError: There were warnings, and ``strict`` is on.
        ToleranceError: A system blew up.
    """
    began = time.perf_counter()
    job, options = plan.job, plan.options
    last = plan.seconds(plan.codes[-1])
    run = SystemRun(plan.systems, last, progress=progress)
    rows = run.rows(plan.codes, plan.first, job.metadata.fps)
    layer = simulated_layer(job, plan.output)
    sizes: list[int] = []
    made = write_systems(
        job,
        run,
        rows,
        layer,
        plan.output,
        options.chunk,
        lambda save: sizes.append(save(layer, plan.output)),
        strict=options.strict,
    )
    total = time.perf_counter() - began
    written = made.prims
    worst = max(written, key=lambda found: found.error)
    metadata = job.metadata
    take = WrittenTake(
        "",
        samples=len(plan.codes),
        first=metadata.first,
        last=metadata.last,
        sampled=list(worst.sampled),
        rounding=Rounding(worst.error, worst.error_code),
    )
    report = TakeReport(
        plan.scene,
        take,
        len(plan.codes),
        metadata.fps,
        plan.systems[run.written[written.index(worst)]].name,
        meshes=run.reports(written),
        meshes_of=plan.scene.name,
        simulated=run.simulated,
    )
    outputs = [*made.files, *([] if plan.output is None else [plan.output])]
    size = sum(sizes) + sum(map(size_of, made.files))
    spent = sum(run.seconds)
    return BakeReport(
        [report],
        UsdResult(layer_span(layer), outputs, size, [take]),
        f"{Form.STAGE} (it is simulated)",
        0,
        metadata.meters_per_unit,
        metadata.up.value,
        0.0,
        run.notices,
        {"read": spent, "author": total - spent, "save": 0.0, "total": total},
        options.shot,
    )
