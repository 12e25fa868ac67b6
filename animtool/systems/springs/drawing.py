"""What is drawn of particles and springs: curves, faces, and faces that part."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from animtool._types import FloatArray, IntArray
from animtool.frames import CurvesFrame, MeshFrame
from animtool.maths.faces import sides
from animtool.systems.springs.body import Springs
from animtool.systems.springs.tearing import Tearing, tear_surface

Flags: TypeAlias = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Curves:
    """Particles in rows.

    Where a spring between two neighbours tears, a curve becomes two; a particle alone
    is not drawn.
    """

    counts: IntArray  # particles of each ``(C,)``
    width: float  # [m]
    springs: Springs  # between them

    @property
    def tears(self) -> bool:
        """Whether it may be drawn otherwise than at the start."""
        return bool(np.isfinite(self.springs.limit).any())

    def row(
        self, points: FloatArray, velocities: FloatArray, torn: Flags
    ) -> CurvesFrame:
        """Return what is drawn of points and velocities ``(N, 3)`` [m, m/s].

        Springs that are torn are ``(S,)``.
        """
        if not torn.any():
            return CurvesFrame(points, velocities, self.counts, self.width, self.tears)
        last = np.zeros(len(points), np.bool_)
        last[np.cumsum(self.counts) - 1] = True
        gone = torn[self._next] & (self._next >= 0)
        last[:-1] |= gone
        piece = np.cumsum(np.append(0, last[:-1]))
        sizes = np.bincount(piece)
        drawn = sizes[piece] > 1
        counts = sizes[sizes > 1]
        return CurvesFrame(points[drawn], velocities[drawn], counts, self.width, True)

    @cached_property
    def _next(self) -> IntArray:
        """The spring from each particle to the next ``(N - 1,)``, -1 for none."""
        first = np.arange(int(self.counts.sum()) - 1)
        return _between(self.springs, np.stack([first, first + 1], axis=1))


@dataclass(frozen=True)
class Faces:
    """A surface of particles."""

    counts: IntArray  # corners of each face ``(M,)``
    indices: IntArray  # corners, face by face
    springs: Springs  # between the particles
    closed: bool = False  # whether only its outside is to be seen

    @property
    def tears(self) -> bool:
        """Whether it may part."""
        sides = self._sides[self._sides >= 0]
        return bool(np.isfinite(self.springs.limit[sides]).any())

    def row(self, points: FloatArray, velocities: FloatArray, torn: Flags) -> MeshFrame:  # noqa: ARG002
        """Return what is drawn of points and velocities ``(N, 3)`` [m, m/s].

        What is to part has a shape of its own.
        """
        return MeshFrame(points, velocities, self.counts, self.indices, self.closed)

    def parted(self, torn: Flags, places: FloatArray) -> TornMesh | Faces:
        """Return the surface that parts where springs of its sides ever tear ``(S,)``.

        Places are those of particles at rest ``(N, 3)`` [m].
        """
        if not (torn[self._sides] & (self._sides >= 0)).any():
            return self
        made = tear_surface(
            self.counts, self.indices, self._sides, self.springs, torn, places
        )
        return TornMesh(made)

    def whole(self, torn: Flags) -> tuple[IntArray, IntArray]:
        """Return corners a face, and corners, of faces without a torn side ``(S,)``."""
        open_sides = torn[self._sides] & (self._sides >= 0)
        starts = np.cumsum(self.counts) - self.counts
        kept = ~np.logical_or.reduceat(open_sides, starts)
        return self.counts[kept], self.indices[np.repeat(kept, self.counts)]

    @cached_property
    def _sides(self) -> IntArray:
        """The spring along each side, face by face; -1 for none."""
        return _between(self.springs, sides(self.counts, self.indices))


@dataclass(frozen=True)
class TornMesh:
    """A surface of particles that parts."""

    tearing: Tearing  # how

    def row(self, points: FloatArray, velocities: FloatArray, torn: Flags) -> MeshFrame:
        """Return what is drawn at a frame; see `Faces.row`."""
        made = self.tearing
        return MeshFrame(
            made.points(points, torn),
            made.velocities(points, velocities, torn),
            made.counts,
            made.indices,
        )


Shape: TypeAlias = Curves | Faces


def _between(springs: Springs, pairs: IntArray) -> IntArray:
    """Return the first spring between each of some pairs ``(P,)``, -1 for none."""
    if not len(springs.rest):
        return np.full(len(pairs), -1)
    size = int(max(springs.ends.max(), pairs.max(initial=0))) + 1
    ends = np.sort(springs.ends, axis=1) @ [size, 1]
    known, first = np.unique(ends, return_index=True)
    wanted = np.sort(pairs, axis=1) @ [size, 1]
    at = np.searchsorted(known, wanted).clip(max=len(known) - 1)
    return np.where(known[at] == wanted, first[at], -1)
