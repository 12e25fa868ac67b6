"""Meshes of USD files whose points move, as what particles run into."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from animtool._types import FloatArray, IntArray
from animtool.errors import Fault, OptionError
from animtool.maths.faces import triangulated
from animtool.sim.colliders import Sheet
from animtool.units import UpAxis

if TYPE_CHECKING:
    from animtool.usd.prims import MeshSource

# Times of which the points are kept: both ends of a step, and those of a look within.
KEPT = 4


@dataclass(frozen=True, slots=True)
class MovingMesh:
    """A mesh that goes, turns and changes shape as its file says."""

    file: Path  # the USD file
    prim: str  # path of the mesh
    frame: float | None = None  # time code that comes at 0 s; None is the first
    radius: float = 0.005  # half its thickness [m]
    closed: bool = False  # whether it is met from outside alone
    # Share of the speed into the surface that comes back [0, 1].
    restitution: float = 0.0
    friction: float = 0.0  # coulomb's coefficient [1]

    def sheet(self) -> Sheet:
        """Return it as what particles run into."""
        from animtool.usd.prims import open_mesh

        source = open_mesh(self.file, self.prim, UpAxis.Y)
        return Sheet(
            _Motion(source, self.frame),
            self.radius,
            self.closed,
            self.prim,
            self.restitution,
            self.friction,
        )


class _Motion:
    """Points of a mesh over time; before its first sample and after its last it stays.

    Args:
        source: The mesh.
        frame: Time code at 0 s.

    Raises:
        OptionError: It makes no sense at its first frame (SIM051).
    """

    def __init__(self, source: MeshSource, frame: float | None) -> None:
        self._source = source
        span = source.span or (0.0, 0.0)
        self._first, self._last = span
        self._start = self._first if frame is None else frame
        still = source.at(None if source.span is None else self._first)
        self._count = len(still.points)
        self._faces = triangulated(still.counts, still.indices)
        self._kept: OrderedDict[float, FloatArray] = OrderedDict()

    def points(self, t: float) -> FloatArray:
        """Return its points ``(N, 3)`` at a time [s] [m]."""
        code = self._start + t * self._source.fps
        code = min(max(code, self._first), self._last)
        if code not in self._kept:
            found = self._source.at(None if self._source.span is None else code).points
            if len(found) != self._count:
                message = (
                    f"it has {len(found)} points at {code:g}, and had {self._count}"
                )
                raise OptionError(Fault("SIM051", message))
            self._kept[code] = found
            while len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        return self._kept[code]

    def triangles(self, t: float) -> IntArray:  # noqa: ARG002
        """Return corners of its triangles ``(T, 3)``: always the same."""
        return self._faces

    def forget(self, t: float) -> None:
        """Take note that no time before one will be asked for [s]."""
