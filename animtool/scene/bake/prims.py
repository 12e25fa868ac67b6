"""The prims of a bake and its report."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import field
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeAlias

from animtool.core.clock import FrameSpan
from animtool.core.errors import Fault, ToleranceError
from animtool.core.files.output import STDOUT
from animtool.core.record import dataclass
from animtool.core.shot import Shot
from animtool.core.units import UpAxis, unit_name
from animtool.documents.ignore import without_accepted
from animtool.motion.scores import PassScores
from animtool.rig.skeleton import Rig
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.progress import OutputCost, Progress
from animtool.scene.sources.open import motion_bytes
from animtool.usd.layers.jobs import LayerForm, UsdResult, WrittenTake

if TYPE_CHECKING:
    from animtool.edit.thin import ThinnedSamples
    from animtool.scene.bake.frames import BakedTake, TakePlan
    from animtool.scene.systems.character_motion import CharacterRecorder
    from animtool.usd.caches.writer import CachedMesh
    from animtool.usd.layers.names import RigPaths
    from animtool.usd.rigs.target import RigTarget


@dataclass(frozen=True, slots=True)
class MeshReport:
    """Report of a mesh, strand set or system: its prim, its time and its origin."""

    name: str  # name in the rig
    written: CachedMesh  # the written prim
    seconds: float  # time spent on deforming and rounding it [s]
    frames: int  # number of frames
    kind: str  # ``mesh`` or ``strands`` of a character, or a kind of system
    is_simulated: bool = False  # whether it is a system rather than a deformed mesh
    of: str = ""  # origin of the character's meshes, or file name of the scene
    json_keys: ClassVar[str] = (
        "mesh=name kind prim=written.path of vertices=written.vertices "
        "characters=written.characters? samples=written.samples "
        "animated=written.sampled bytes=written.bytes milliseconds_per_frame~ "
        "error=.{meters=written.error vertex=written.error_vertex "
        "frame=written.error_code}"
    )

    @property
    def milliseconds_per_frame(self) -> float:
        """Mean time to deform and round a frame [ms]."""
        return self.seconds * 1e3 / max(self.frames, 1)


# Keys of the rounding errors of a take.
_ERROR = (
    "{take=written.name+ meters=written.rounding.error relative=relative_error "
    "joint=error_joint frame=written.rounding.code "
    "half_scales=written.rounding.has_rounded_scales "
    "scales=written.rounding.scale_error}"
)


@dataclass(slots=True)
class TakeReport:
    """Report of one baked take: its source, what was written, and the errors."""

    source: Path  # file of the take
    written: WrittenTake  # the take as written
    source_frames: int  # frames of the source
    source_fps: Fraction  # its frame rate
    error_joint: str  # joint with the largest rounding displacement
    is_unit_assumed: bool = False  # whether the source states no unit
    source_bytes: int = 0  # size of the source; 0 for a scene, which contains no motion
    # Properties that the source states.
    details: dict[str, object] = field(default_factory=dict)
    # Result of reducing samples, if requested.
    thinned: ThinnedSamples | None = None
    thinned_joint: str = ""  # joint that reduction moved most
    # Written meshes, if they were deformed.
    meshes: list[MeshReport] = field(default_factory=list)
    # Results of the simulations, as plain values.
    simulated: list[dict[str, object]] = field(default_factory=list)
    scores: list[PassScores] = field(default_factory=list)  # of its passes
    between_frames: int = 0  # number of source samples between the written frames
    size: float = 0.0  # extent of the skeleton at rest [m]
    fps: Fraction = Fraction(0)  # time codes a second of the output
    json_keys: ClassVar[str] = (
        "take=written.name+ source source_frames source_rate=source_fps# "
        "between_frames animation=written.animation "
        "props=written.props+ "
        "fit=details.fit? *in_library{samples=written.samples start=written.span.first "
        "end=written.span.last joints_written=written.joints animated=written.sampled "
        f"error=.{_ERROR}}} meshes+ simulated+ scores+ "
        "reduction=if_thinned?{samples=thinned.samples kept=thinned.count "
        "error=.{meters=thinned.error joint=thinned_joint frame=thinned.code} "
        "weight_error=thinned.weight_error} "
        "curves=written.curves+{control=name knots split difference seam}"
    )

    @property
    def has_joints(self) -> bool:
        """Whether joints were written."""
        return not self.meshes or bool(self.written.animation)

    @property
    def resampled(self) -> bool:
        """Whether the rate or the number of samples differs from the source's."""
        counts = self.source_frames, self.written.samples
        return self.source_fps != self.fps or counts[0] != counts[1]

    @property
    def relative_error(self) -> float:
        """Largest joint displacement by rounding, relative to the rig's size [1]."""
        return self.written.rounding.error / (self.size or math.inf)

    @property
    def in_library(self) -> TakeReport | None:
        """This report if the take is in a library, else None."""
        return self if self.written.name else None

    @property
    def if_thinned(self) -> TakeReport | None:
        """This report if samples were reduced, else None."""
        return None if self.thinned is None else self


def take_report(
    baked_take: BakedTake,
    written_take: WrittenTake,
    joint: str = "",
    meshes: Sequence[MeshReport] = (),
) -> TakeReport:
    """Return the report of a take: rounding errors and meshes."""
    plan = baked_take.plan
    stream = baked_take.plan.stream
    sample_times = baked_take.open().times
    return TakeReport(
        plan.source,
        written_take,
        stream.count or baked_take.frame_count,
        stream.fps / stream.step,
        joint,
        plan.options.source.unit is None and "units" not in stream.details,
        motion_bytes(plan.source),
        stream.details,
        meshes=list(meshes),
        simulated=list(stream.simulated),
        scores=list(stream.scores),
        between_frames=0 if sample_times is None else sample_times.dropped_sample_count,
    )


@dataclass(slots=True)
class BakeReport:
    """Report of a bake to USD: its takes, layers, errors and times."""

    takes: list[TakeReport]  # reports of the takes, at least one
    result: UsdResult  # content of the written layers
    form: str  # form (stage, split or layer), and the reason
    joints: int  # joints of the first source
    meters_per_unit: float  # unit of the output [m]
    up: str  # its up axis
    size: float  # extent of the skeleton at rest [m]
    notices: list[Fault]  # warnings and notes
    # Wall time by stage; ``read`` overlaps with ``author``.
    seconds: dict[str, float] = field(default_factory=dict)
    shot: Shot | None = None  # written shot; None if there is none
    # Why a system stopped before the last frame, if frames before it are kept.
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
        """Report of the take, if there is exactly one."""
        return self.takes[0] if len(self.takes) == 1 else None

    @property
    def library(self) -> list[TakeReport]:
        """Reports of the takes, if there are several."""
        return [] if len(self.takes) == 1 else self.takes

    @property
    def has_joints(self) -> bool:
        """Whether joints were written."""
        return self.only is None or self.only.has_joints

    @property
    def is_unit_assumed(self) -> bool:
        """Whether the length unit of any source is assumed, not stated."""
        return any(take.is_unit_assumed for take in self.takes)

    @property
    def props(self) -> list[str]:
        """Prim paths of the written props."""
        return [path for take in self.takes for path in take.written.props]

    @property
    def named(self) -> list[Path]:
        """Written files that the report of a solve lists; empty for stdout."""
        return self.files

    @property
    def channels(self) -> None:
        """None, because a USD layer stores samples and no keys."""
        return None

    @property
    def cost(self) -> OutputCost:
        """Cost of the output, with the largest rounding error."""
        name = str(self.files[-1]) if self.files else "stdout"
        rounding_error = self.worst.written.rounding.error
        return OutputCost(name, self.seconds["total"], rounding_error)

    @property
    def units(self) -> str:
        """Name of the output's length unit, such as ``cm``."""
        return unit_name(self.meters_per_unit)

    @property
    def megabytes_per_second(self) -> float | None:
        """Read rate of the sources [MB/s]; None if there are no motion files."""
        if not self.source_bytes:
            return None
        return round(self.source_bytes / 1e6 / self.seconds["total"], 3)

    @property
    def span(self) -> FrameSpan:
        """First frame, last frame and rate of the written layer."""
        return self.result.span

    @property
    def fps(self) -> Fraction:
        """Time codes a second of the output."""
        return self.span.fps

    @property
    def worst(self) -> TakeReport:
        """Report of the take with the largest rounding displacement."""
        return max(self.takes, key=lambda take: take.written.rounding.error)

    @property
    def scores(self) -> list[PassScores]:
        """Scores that the passes gave to the take of every source."""
        return [score for take in self.takes for score in take.scores]

    @property
    def files(self) -> list[Path]:
        """Every written file, with the requested file last."""
        return self.result.outputs

    @property
    def source_bytes(self) -> int:
        """Total size of the motion files that were read [byte]."""
        return sum(take.source_bytes for take in self.takes)


def raise_stopped(reports: Sequence[object]) -> None:
    """Raise the error of a system that stopped early, after its frames were written."""
    for report in reports:
        if isinstance(report, BakeReport) and report.stopped is not None:
            raise report.stopped


# Writes a layer to a file, or as text to stdout; returns the number of bytes.
SaveLayer: TypeAlias = Callable[[Any, Path], int]


@dataclass(frozen=True, slots=True)
class BakePlan:
    """A bake that is ready to run."""

    takes: tuple[TakePlan, ...]  # one, several of a library, or none for systems alone
    output: Path  # the file to write, or `STDOUT`
    options: BakeOptions
    form: LayerForm
    form_reason: str  # reason for the form
    target: RigTarget | None  # rig of a layer
    fps: Fraction  # time codes a second of the output
    start: Fraction  # time code of the first frame
    notices: list[Fault]  # warnings collected so far
    prims: tuple[OutputPrims, ...]  # prims to write, in order
    recorder: CharacterRecorder | None = None  # records the take for systems

    @property
    def rig(self) -> Rig:
        """Rig of the rig layer, else of the first take."""
        if self.target is not None:
            return self.target.skeleton.rig
        return self.takes[0].stream.rig

    @property
    def meters_per_unit(self) -> float:
        """Length of a unit below the character's model prim [m]."""
        unit = self.options.to_units
        if self.target is not None or unit is None:
            return self.rig.meters_per_unit
        return unit.meters

    @property
    def paths(self) -> RigPaths:
        """Paths of the character's prims."""
        from animtool.usd.layers.names import RigPaths
        from animtool.usd.layers.sdf import model_path

        if self.target is not None:
            return self.target.paths
        name, *other_names = {take.stream.rig.name: None for take in self.takes}
        if other_names and self.output != STDOUT:
            name = self.output.stem
        return RigPaths.from_model(model_path(self.options.prim_path, name))

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
        form_name: str = "",
    ) -> BakeReport:
        """Return the report of written takes; ``form_name`` names the form."""
        for take in takes:
            take.size, take.fps = size, result.span.fps
        return BakeReport(
            takes,
            result,
            f"{form_name}{self.form} ({self.form_reason})",
            joints,
            meters_per_unit,
            up.value,
            size,
            without_accepted(notices) if notices else [],
            shot=self.options.shot,
        )


def write_single_file(
    layer: Any, output: Path, result: UsdResult, save: SaveLayer
) -> None:
    """Write a layer that is the only file of a bake; the output may be `STDOUT`."""
    result.bytes = save(layer, output)
    result.outputs += [] if output == STDOUT else [output]


class DeferredFrames(Protocol):
    """Frames that are computed while their layer is being written."""

    def save(self, layer: Any, path: Path) -> int:
        """Write a layer with its computed frames; return the number of bytes."""

    def complete(self, state: BakeState) -> None:
        """Add samples, errors and notices of the computed frames to the report."""


@dataclass(slots=True)
class BakeState:
    """State of a running bake: the layer in memory and the report so far."""

    plan: BakePlan
    progress: Progress  # progress after the takes are read
    baked_takes: list[BakedTake]
    # None until the first prims create it.
    layer: Any = None
    # Writes the authored files; the argument writes the animation layer.
    write_files: Callable[[SaveLayer], None] | None = None
    report: BakeReport | None = None
    deferred_frames: DeferredFrames | None = None  # frames of systems
    read_seconds: list[float] = field(
        default_factory=list
    )  # time to compute frames [s]


class OutputPrims(Protocol):
    """Prims of one kind in a bake: joints, point caches or systems."""

    def author(self, state: BakeState) -> None:
        """Author the prims into a bake; the first kind creates the layer."""
