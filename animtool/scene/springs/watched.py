"""A surface of springs under way, as what particles run into."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from animtool._types import FloatArray, IntArray
from animtool.maths.faces import triangulated
from animtool.scene.springs.run import Keeping, SpringRun
from animtool.scene.springs.shapes import Faces


class Watched:
    """A surface that is looked at on the way from frame to frame.

    Args:
        run: What takes it through time.
        shape: Its faces.
        rows: Its particles in the run ``(N,)``.
        springs: Its springs there.
        grid: First of the times that it is looked at, and what lies between two [s].
    """

    def __init__(
        self,
        run: SpringRun,
        shape: Faces,
        rows: IntArray,
        springs: slice,
        grid: tuple[float, float],
    ) -> None:
        self._run, self._shape, self._rows, self._springs = run, shape, rows, springs
        self._keeping: Keeping = run.keep(*grid)
        self._faces = triangulated(shape.counts, shape.indices)
        self._gone = 0

    def points(self, t: float) -> FloatArray:
        """Return its points ``(N, 3)`` at a time [s] [m]."""
        found: FloatArray = self._run.look(t).points[self._rows]
        return found

    def triangles(self, t: float) -> IntArray:
        """Return corners of those of its triangles ``(T, 3)`` that are not torn."""
        torn: npt.NDArray[np.bool_] = self._run.look(t).torn[self._springs]
        gone = int(torn.sum())
        if gone != self._gone:
            self._gone, self._faces = gone, triangulated(*self._shape.whole(torn))
        return self._faces

    def forget(self, t: float) -> None:
        """Take note that no time before one will be asked for [s]."""
        self._keeping.since = max(self._keeping.since, t)
