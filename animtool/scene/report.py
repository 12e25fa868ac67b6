"""What a bake did, as records."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

from animtool.clock import FrameSpan
from animtool.errors import Fault
from animtool.shot import Shot
from animtool.usd.jobs import UsdResult, WrittenTake

if TYPE_CHECKING:
    from animtool.edit.thin import Thinned
    from animtool.usd.point_based import CachedMesh


@dataclass(frozen=True, slots=True)
class MeshReport:
    """What became of a mesh, of strands, or of a system.

    Attributes:
        name: As the rig names it.
        written: What was written of it.
        seconds: Spent on deforming and rounding it [s].
        frames: How many frames that was for.
        kind: ``mesh`` or ``strands`` of a character, or a kind of system.
        simulated: Whether it is a system, and not deformed.
    """

    name: str
    written: CachedMesh
    seconds: float
    frames: int
    kind: str
    simulated: bool = False


@dataclass(slots=True)
class TakeReport:
    """What became of one source.

    Attributes:
        source: The file read.
        written: What was written of it.
        source_frames: Frames of the source.
        source_fps: Its frame rate.
        error_joint: Name of the joint that rounding moved most.
        unit_assumed: Whether nothing states the unit of the source.
        source_bytes: Size of the source; 0 of a scene, which holds no motion.
        details: What the source states of itself.
        thinned: Which samples were left out, where that was asked for.
        thinned_joint: Name of the joint that this moved most.
        meshes: What was written of each mesh, where it was deformed.
        meshes_of: Whose meshes they are.
        simulated: What became of each thing that was simulated, as plain values.
        between: Samples of the source that fall between the frames written.
    """

    source: Path
    written: WrittenTake
    source_frames: int
    source_fps: Fraction
    error_joint: str
    unit_assumed: bool = False
    source_bytes: int = 0
    details: dict[str, object] = field(default_factory=dict)
    thinned: Thinned | None = None
    thinned_joint: str = ""
    meshes: list[MeshReport] = field(default_factory=list)
    meshes_of: str = ""
    simulated: list[dict[str, object]] = field(default_factory=list)
    between: int = 0


@dataclass(slots=True)
class BakeReport:
    """What a bake did.

    Attributes:
        takes: What became of every source, at least one.
        result: What was written.
        form: Stage, split or layer, and why.
        joints: Joints of the first source.
        meters_per_unit: Unit of the output [m].
        up: Its up axis.
        size: Extent of the skeleton at rest [m].
        notices: Warnings and notes.
        seconds: Wall time by stage; ``read`` runs beside ``author``.
        shot: The shot that was written; None is no shot.
    """

    takes: list[TakeReport]
    result: UsdResult
    form: str
    joints: int
    meters_per_unit: float
    up: str
    size: float
    notices: list[Fault]
    seconds: dict[str, float] = field(default_factory=dict)
    shot: Shot | None = None

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
    def files(self) -> list[Path]:
        """Every file written, the one that was asked for last."""
        return self.result.outputs

    @property
    def source_bytes(self) -> int:
        """Size of all sources."""
        return sum(take.source_bytes for take in self.takes)
