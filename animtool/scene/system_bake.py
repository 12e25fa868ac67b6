"""The bake of a scene that is simulated: systems without a source."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

from animtool.edit.frame_range import FrameRange
from animtool.errors import Fault, OptionError, refuse_warnings
from animtool.plugins import load_object
from animtool.scene.entries import SceneSystem
from animtool.scene.options import BakeOptions
from animtool.scene.report import BakeReport, MeshReport, TakeReport
from animtool.scene.scene import Scene
from animtool.scene.simulation import open_systems
from animtool.scene.sources import source_stem
from animtool.scene.system_kinds import SYSTEM_KINDS
from animtool.units import UpAxis
from animtool.usd.animation import Rounding
from animtool.usd.forms import Form
from animtool.usd.jobs import UsdResult, WrittenTake
from animtool.usd.layers import check_prim_path
from animtool.usd.names import distinct_names, legal_name
from animtool.usd.prim_writer import PrimWriter
from animtool.usd.simulated import SimulatedJob, write_simulated

__all__ = ["SystemPlan", "plan_systems", "run_system_bake"]

FPS = Fraction(24)


@dataclass(frozen=True, slots=True)
class SystemPlan:
    """Systems that are ready to run.

    Attributes:
        scene: The file.
        systems: What is simulated.
        job: What is written.
        codes: Time codes to write, ascending.
        first: Time code at 0 s.
        options: As given.
    """

    scene: Path
    systems: tuple[SceneSystem, ...]
    job: SimulatedJob
    codes: tuple[Fraction, ...]
    first: Fraction
    options: BakeOptions


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
    names = [system.name for system in scene.systems]
    if options.prim_path is not None:
        check_prim_path(options.prim_path)
    model = options.prim_path or f"/{legal_name(source_stem(scene.path))}"
    unit = 1.0 if options.to_units is None else options.to_units.meters
    job = SimulatedJob(
        output,
        model,
        distinct_names(names, names, names).names,
        tuple(_writer(system) for system in scene.systems),
        fps,
        (Fraction(frames.first), Fraction(frames.last)),
        unit,
        options.to_up or UpAxis.Y,
    )
    return SystemPlan(scene.path, scene.systems, job, codes, first, options)


def _writer(system: SceneSystem) -> type[PrimWriter]:
    return cast(type[PrimWriter], load_object(SYSTEM_KINDS[system.kind].writer))


def _codes(frames: FrameRange, offsets: tuple[Fraction, ...]) -> tuple[Fraction, ...]:
    whole = range(frames.first, frames.last + 1, frames.step)
    return tuple(
        frame + offset for frame in whole for offset in offsets or (Fraction(),)
    )


def _check(scene: Scene, options: BakeOptions) -> None:
    """Refuse what only characters have."""
    asked = {
        "a rig layer": options.rig_layer is not None,
        "as: split": options.form == Form.SPLIT,
        "as: layer": options.form == Form.LAYER,
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


def run_system_bake(plan: SystemPlan) -> BakeReport:
    """Run systems and write what comes of them, frame by frame.

    Raises:
        OutputError: The output cannot be written.
        StrictError: There were warnings, and ``strict`` is on.
        ToleranceError: A system blew up.
    """
    began = time.perf_counter()
    job = plan.job
    running = _Running(plan)
    written, size = write_simulated(
        job,
        running.rows(),
        lambda: refuse_warnings(running.notices, strict=plan.options.strict),
    )
    total = time.perf_counter() - began
    meshes = [
        MeshReport(system.name, found, spent, len(plan.codes), system.kind, True)
        for system, found, spent in zip(
            plan.systems, written, running.seconds, strict=True
        )
    ]
    worst = max(written, key=lambda found: found.error)
    first, last = job.frames
    take = WrittenTake(
        "",
        samples=len(plan.codes),
        first=first,
        last=last,
        sampled=list(worst.sampled),
        rounding=Rounding(worst.error, worst.error_code),
    )
    report = TakeReport(
        plan.scene,
        take,
        len(plan.codes),
        job.fps,
        plan.systems[written.index(worst)].name,
        source_bytes=plan.scene.stat().st_size,
        meshes=meshes,
        meshes_of=plan.scene.name,
        simulated=running.reports,
    )
    outputs = [] if job.output is None else [job.output]
    spent = sum(running.seconds)
    return BakeReport(
        [report],
        UsdResult(outputs, size, [take]),
        f"{Form.STAGE} (it is simulated)",
        job.fps,
        0,
        job.meters_per_unit,
        job.up.value,
        0.0,
        running.notices,
        {"read": spent, "author": total - spent, "save": 0.0, "total": total},
    )


class _Running:
    """Systems under way.

    Attributes:
        seconds: How long each took [s].
        notices: What is odd, each at the place of its system.
    """

    def __init__(self, plan: SystemPlan) -> None:
        self._plan = plan
        self.seconds = [0.0] * len(plan.systems)
        last = float((plan.codes[-1] - plan.first) / plan.job.fps)
        self._open = open_systems(plan.systems, last)

    @property
    def notices(self) -> list[Fault]:
        """What is odd so far."""
        return [
            system.place.put(notice)
            for system, opened in zip(self._plan.systems, self._open, strict=True)
            for notice in opened.notices
        ]

    @property
    def reports(self) -> list[dict[str, object]]:
        """What became of each that has something to say."""
        return [said for opened in self._open if (said := opened.report())]

    def rows(self) -> Iterator[tuple[float, list[Any]]]:
        """Yield every time code with what each system is then."""
        plan = self._plan
        for code in plan.codes:
            t = float((code - plan.first) / plan.job.fps)
            yield float(code), [self._row(i, t) for i in range(len(self._open))]

    def _row(self, i: int, t: float) -> Any:
        began = time.perf_counter()
        with self._plan.systems[i].place.blamed():
            row = self._open[i].at(t)
        self.seconds[i] += time.perf_counter() - began
        return row
