"""What a USD file without a character shows: point caches, particles, curves."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path

from animtool.errors import Fault
from animtool.inputs import note_input
from animtool.usd.simulated_read import ChunkSet, PointPrim, read_points


@dataclass(frozen=True, slots=True)
class PointsDescription:
    """A USD file of points in numbers."""

    path: str  # the file
    format: str  # USD
    frames: int  # most samples of any of its prims; 0 where nothing moves
    fps: Fraction  # time codes a second, exact
    start: Fraction  # time code of the first frame
    end: Fraction  # time code of the last frame
    duration: Fraction  # from the first to the last [s]
    types: dict[str, int]  # how many prims there are, by type
    prims: list[PointPrim]  # what there is of each
    chunks: list[ChunkSet]  # files that hold its samples in turn
    units: str  # unit of the file
    up: str  # up axis of the file
    notices: list[Fault]  # what is odd

    def as_dict(self) -> dict[str, object]:
        """Return plain values for a JSON report; rates also as exact text."""
        values = asdict(self)
        values.update(
            fps=float(self.fps),
            rate=str(self.fps),
            start=float(self.start),
            end=float(self.end),
            duration=float(self.duration),
            prims=[prim.as_dict() for prim in self.prims],
            notices=[notice.as_dict() for notice in self.notices],
        )
        return values


def describe_points(path: Path) -> PointsDescription | None:
    """Describe a USD file without a character; None of those that have one."""
    note_input(path)
    found = read_points(path)
    if found is None:
        return None
    types: dict[str, int] = {}
    for prim in found.prims:
        types[prim.type] = types.get(prim.type, 0) + 1
    return PointsDescription(
        str(path),
        "USD",
        max(prim.samples for prim in found.prims),
        found.fps,
        found.start,
        found.end,
        (found.end - found.start) / found.fps,
        types,
        found.prims,
        found.chunks,
        found.unit,
        found.up,
        found.notices,
    )
