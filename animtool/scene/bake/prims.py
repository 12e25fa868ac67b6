"""What a bake writes: prims authored one after the other, and the report of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import field
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeAlias

from animtool.core.clock import FrameSpan
from animtool.core.errors import Fault, ToleranceError
from animtool.core.record import dataclass
from animtool.core.shot import Shot
from animtool.core.units import UpAxis, unit_name
from animtool.motion.scores import PassScores
from animtool.rig.skeleton import Rig
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.progress import OutputCost, Progress
from animtool.scene.sources.open import motion_bytes
from animtool.usd.layers.jobs import LayerForm, UsdResult, WrittenTake
from animtool.usd.layers.names import RigPaths
from animtool.usd.layers.sdf import model_path, save_layer

if TYPE_CHECKING:
    from animtool.edit.thin import Thinned
    from animtool.scene.bake.frames import TakePlan, TakeRun
    from animtool.scene.systems.character_motion import CharacterWatch
    from animtool.usd.caches.writer import CachedMesh
    from animtool.usd.rigs.target import RigTarget


@dataclass(frozen=True, slots=True)
class MeshReport:
    """What became of a mesh, of strands, or of a system."""

    name: str  # as the rig names it
    written: CachedMesh  # what was written of it
    seconds: float  # spent on deforming and rounding it [s]
    frames: int  # how many frames that was for
    kind: str  # ``mesh`` or ``strands`` of a character, or a kind of system
    simulated: bool = False  # whether it is a system, and not deformed
    of: str = ""  # whose it is: of a character or a scene
    json_keys: ClassVar[str] = (
        "mesh=name kind prim=written.path of vertices=written.vertices "
        "characters=written.characters? samples=written.samples "
        "animated=written.sampled bytes=written.bytes milliseconds_per_frame~ "
        "error=.{meters=written.error vertex=written.error_vertex "
        "frame=written.error_code}"
    )

    @property
    def milliseconds_per_frame(self) -> float:
        """How long a frame took [ms]."""
        return self.seconds * 1e3 / max(self.frames, 1)


# Keys of what rounding did to a take.
_ERROR = (
    "{take=written.name+ meters=written.rounding.error relative=relative_error "
    "joint=error_joint frame=written.rounding.code "
    "half_scales=written.rounding.scales}"
)


@dataclass(slots=True)
class TakeReport:
    """What became of one source."""

    source: Path  # the file read
    written: WrittenTake  # what was written of it
    source_frames: int  # frames of the source
    source_fps: Fraction  # its frame rate
    error_joint: str  # name of the joint that rounding moved most
    unit_assumed: bool = False  # whether nothing states the unit of the source
    source_bytes: int = 0  # size of the source; 0 of a scene, which holds no motion
    # What the source states of itself.
    details: dict[str, object] = field(default_factory=dict)
    # Which samples were left out, where that was asked for.
    thinned: Thinned | None = None
    thinned_joint: str = ""  # name of the joint that this moved most
    # What was written of each mesh, where it was deformed.
    meshes: list[MeshReport] = field(default_factory=list)
    # What became of each thing that was simulated, as plain values.
    simulated: list[dict[str, object]] = field(default_factory=list)
    scores: list[PassScores] = field(default_factory=list)  # of its passes
    between: int = 0  # samples of the source that fall between the frames written
    size: float = 0.0  # extent of the skeleton at rest [m]
    fps: Fraction = Fraction(0)  # time codes a second of the output
    json_keys: ClassVar[str] = (
        "take=written.name+ source source_frames source_rate=source_fps# "
        "between_frames=between animation=written.animation props=written.props+ "
        "fit=details.fit? *in_library{samples=written.samples start=written.span.first "
        "end=written.span.last joints_written=written.joints animated=written.sampled "
        f"error=.{_ERROR}}} meshes+ simulated+ scores+ "
        "reduction=if_thinned?{samples=thinned.samples kept=thinned.count "
        "error=.{meters=thinned.error joint=thinned_joint frame=thinned.code} "
        "weight_error=thinned.weight_error} "
        "curves=written.curves+{control=name knots split difference seam}"
    )

    @property
    def posed(self) -> bool:
        """Whether joints were written."""
        return not self.meshes or bool(self.written.animation)

    @property
    def resampled(self) -> bool:
        """Whether samples are not one of each frame of the source."""
        counts = self.source_frames, self.written.samples
        return self.source_fps != self.fps or counts[0] != counts[1]

    @property
    def relative_error(self) -> float:
        """The largest distance that rounding moved a joint, over the size [1]."""
        return self.written.rounding.error / (self.size or math.inf)

    @property
    def in_library(self) -> TakeReport | None:
        """The report, if the take is one of a library."""
        return self if self.written.name else None

    @property
    def if_thinned(self) -> TakeReport | None:
        """The report, if samples were left out."""
        return None if self.thinned is None else self


def take_report(
    run: TakeRun,
    written: WrittenTake,
    joint: str = "",
    meshes: Sequence[MeshReport] = (),
) -> TakeReport:
    """Return the result of a take: what rounding moved most, and its meshes."""
    plan, stream, times = run.plan, run.plan.stream, run.open().times
    return TakeReport(
        plan.source,
        written,
        stream.count or run.frames,
        stream.fps / stream.step,
        joint,
        plan.options.source.unit is None and "units" not in stream.details,
        motion_bytes(plan.source),
        stream.details,
        meshes=list(meshes),
        simulated=list(stream.simulated),
        scores=list(stream.scores),
        between=0 if times is None else times.between,
    )


@dataclass(slots=True)
class BakeReport:
    """What a bake did."""

    takes: list[TakeReport]  # what became of every source, at least one
    result: UsdResult  # what was written
    form: str  # stage, split or layer, and why
    joints: int  # joints of the first source
    meters_per_unit: float  # unit of the output [m]
    up: str  # its up axis
    size: float  # extent of the skeleton at rest [m]
    notices: list[Fault]  # warnings and notes
    # Wall time by stage; ``read`` runs beside ``author``.
    seconds: dict[str, float] = field(default_factory=dict)
    shot: Shot | None = None  # the shot that was written; None is no shot
    # Why a system ended before the last frame, where the frames before were to be kept.
    stopped: ToleranceError | None = None
    json_keys: ClassVar[str] = (
        "'bake' *only outputs=files form samples=result.samples start=span.first "
        "end=span.last fps rate=fps# joints joints_written=result.joints "
        "animated=result.sampled meters_per_unit units up bytes=result.bytes shot? "
        f"seconds~ megabytes_per_second error=worst{_ERROR} takes=library+ notices "
        "stopped=stopped.faults?"
    )

    @property
    def only(self) -> TakeReport | None:
        """The take, where it is the only one."""
        return self.takes[0] if len(self.takes) == 1 else None

    @property
    def library(self) -> list[TakeReport]:
        """The takes, where there are several."""
        return [] if len(self.takes) == 1 else self.takes

    @property
    def posed(self) -> bool:
        """Whether joints were written."""
        return self.only is None or self.only.posed

    @property
    def unit_assumed(self) -> bool:
        """Whether nothing states the unit of some source."""
        return any(take.unit_assumed for take in self.takes)

    @property
    def props(self) -> list[str]:
        """Paths of what is written beside the characters."""
        return [path for take in self.takes for path in take.written.props]

    @property
    def named(self) -> list[Path]:
        """The files that reports of solves name; none of stdout."""
        return self.files

    @property
    def channels(self) -> None:
        """Nothing: a layer has no channels of keys."""
        return None

    @property
    def cost(self) -> OutputCost:
        """What it took."""
        name = str(self.files[-1]) if self.files else "stdout"
        error = self.worst.written.rounding.error
        return OutputCost(name, self.seconds["total"], error)

    @property
    def units(self) -> str:
        """The unit of the output by its name."""
        return unit_name(self.meters_per_unit)

    @property
    def megabytes_per_second(self) -> float | None:
        """How fast sources were read [MB/s]; None where none is a file of motion."""
        if not self.source_bytes:
            return None
        return round(self.source_bytes / 1e6 / self.seconds["total"], 3)

    @property
    def span(self) -> FrameSpan:
        """First frame, last frame and rate that the written layer states."""
        return self.result.span

    @property
    def fps(self) -> Fraction:
        """Time codes a second of the output."""
        return self.span.fps

    @property
    def worst(self) -> TakeReport:
        """The take that rounding moved most."""
        return max(self.takes, key=lambda take: take.written.rounding.error)

    @property
    def scores(self) -> list[PassScores]:
        """How well the passes of every source did."""
        return [one for take in self.takes for one in take.scores]

    @property
    def files(self) -> list[Path]:
        """Every file written, the one that was asked for last."""
        return self.result.outputs

    @property
    def source_bytes(self) -> int:
        """Size of all sources."""
        return sum(take.source_bytes for take in self.takes)


def raise_stopped(reports: Sequence[object]) -> None:
    """Raise why a system stopped, where frames before that were kept."""
    for report in reports:
        if isinstance(report, BakeReport) and report.stopped is not None:
            raise report.stopped


# Writes a layer to a file, or as text to stdout; returns the bytes.
Save: TypeAlias = Callable[[Any, Path | None], int]


@dataclass(frozen=True, slots=True)
class BakePlan:
    """A bake that is ready to run."""

    takes: tuple[TakePlan, ...]  # one, those of a library, or none of systems alone
    output: Path | None  # the file to write; None is stdout
    options: BakeOptions
    form: LayerForm
    reason: str  # why that form
    target: RigTarget | None  # the rig of a layer
    fps: Fraction  # time codes a second of the output
    start: Fraction  # time code of the first frame
    notices: list[Fault]  # warnings collected so far
    prims: tuple[OutputPrims, ...]  # what is written, in order
    watch: CharacterWatch | None = None  # what systems see of the take

    @property
    def rig(self) -> Rig:
        """The rig of the first take, or of the layer that this goes over."""
        if self.target is not None:
            return self.target.skeleton.rig
        return self.takes[0].stream.rig

    @property
    def meters_per_unit(self) -> float:
        """Unit of what is below the character's model [m]."""
        unit = self.options.to_units
        if self.target is not None or unit is None:
            return self.rig.meters_per_unit
        return unit.meters

    @property
    def paths(self) -> RigPaths:
        """Where the character's prims are to be."""
        if self.target is not None:
            return self.target.paths
        name, *others = {take.stream.rig.name: None for take in self.takes}
        if others and self.output is not None:
            name = self.output.stem
        return RigPaths.below(model_path(self.options.prim_path, name))

    def report(
        self,
        takes: list[TakeReport],
        result: UsdResult,
        notices: list[Fault],
        *,
        joints: int = 0,
        size: float = 0.0,
        meters_per_unit: float,
        up: UpAxis,
        what: str = "",
    ) -> BakeReport:
        """Return the report of what was written of takes; ``what`` names its form."""
        for take in takes:
            take.size, take.fps = size, result.span.fps
        return BakeReport(
            takes,
            result,
            f"{what}{self.form} ({self.reason})",
            joints,
            meters_per_unit,
            up.value,
            size,
            notices,
            shot=self.options.shot,
        )


class OutputFiles(Protocol):
    """The files of a bake, authored and not written."""

    def write(self, save: Save) -> None:
        """Write them, the layer of the animation by ``save``."""


@dataclass(frozen=True, slots=True)
class OneFile:
    """A layer that is the only file of a bake."""

    layer: Any
    output: Path | None  # None is stdout
    result: UsdResult

    def write(self, save: Save) -> None:
        """Write the layer."""
        self.result.bytes = save(self.layer, self.output)
        self.result.outputs += [] if self.output is None else [self.output]


class Growth(Protocol):
    """Frames that are made while the layer that they go into is written."""

    def save(self, layer: Any, path: Path | None) -> int:
        """Write a layer and the frames; return the bytes."""

    def complete(self, draft: Draft) -> None:
        """Add what was made to the report."""


@dataclass(slots=True)
class Draft:
    """A bake under way: a layer in memory, and what will be reported of it."""

    plan: BakePlan
    progress: Progress  # share of what comes after the takes
    runs: list[TakeRun]
    # None until the first prims have authored them.
    layer: Any = None
    files: OutputFiles | None = None
    report: BakeReport | None = None
    growth: Growth | None = None  # of systems
    read: list[float] = field(default_factory=list)  # spent on making frames [s]

    def write(self) -> None:
        """Write all files, and complete the report."""
        assert self.files is not None
        if self.growth is None:
            self.files.write(save_layer)
            return
        self.files.write(self.growth.save)
        self.growth.complete(self)


class OutputPrims(Protocol):
    """Prims of one kind that a bake writes: joints, points, or systems."""

    def author(self, draft: Draft) -> None:
        """Put the prims into a draft, whose layer is made by the first.

        Raises:
            FormatError: Rows of a source, or a system, are malformed.
            OptionError: The range has no frame of the take.
            OutputError: USD would not show what is authored, or a file cannot be
                written.
            StrictError: There were warnings, and ``strict`` is on.
            ToleranceError: A system blew up.
        """
