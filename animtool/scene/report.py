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
    """What became of a mesh, of strands, or of a system."""

    name: str  # as the rig names it
    written: CachedMesh  # what was written of it
    seconds: float  # spent on deforming and rounding it [s]
    frames: int  # how many frames that was for
    kind: str  # ``mesh`` or ``strands`` of a character, or a kind of system
    simulated: bool = False  # whether it is a system, and not deformed


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
    meshes_of: str = ""  # whose meshes they are
    # What became of each thing that was simulated, as plain values.
    simulated: list[dict[str, object]] = field(default_factory=list)
    between: int = 0  # samples of the source that fall between the frames written


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
