"""Meshes that systems show copies of: of USD files, or of characters in motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.frames import MeshFrame
from animtool.units import UpAxis


@dataclass(frozen=True, slots=True)
class Prototype:
    """A mesh, and the phases of its cycle."""

    path: Path
    prim: str | None  # of a USD file
    mesh: str | None  # of a rig
    samples: int  # phases of what moves

    def __call__(self) -> tuple[MeshFrame, ...]:
        """Return its mesh at each phase; of what does not move there is one.

        Raises:
            OptionError: There is no such mesh (SIM051, SIM053).
            FormatError: The file cannot be read.
        """
        at, span = self._of_rig() if self.prim is None else self._of_stage()
        shares = [0.0] if span is None else np.arange(self.samples) / self.samples
        first, last = span or (0.0, 0.0)
        return tuple(at(first + (last - first) * float(share)) for share in shares)

    def _of_stage(self) -> _Moving:
        from animtool.usd.prims import open_mesh

        assert self.prim is not None
        source = open_mesh(self.path, self.prim, UpAxis.Y)

        def at(code: float) -> MeshFrame:
            found = source.at(None if source.span is None else code)
            return _frame(found.points, found.counts, found.indices)

        return at, source.span

    def _of_rig(self) -> _Moving:
        from animtool.scene.systems.character_motion import CharacterMotions, SkinMotion

        assert self.mesh is not None
        character = CharacterMotions().of(self.path)
        motion = SkinMotion(character, self.mesh)
        counts, indices = motion.faces

        def at(t: float) -> MeshFrame:
            return _frame(motion.points(t), counts, indices)

        first, last = character.times[[0, -1]].tolist()
        return at, (first, last) if last > first else None


_Moving = tuple[Callable[[float], MeshFrame], tuple[float, float] | None]


def _frame(points: FloatArray, counts: IntArray, indices: IntArray) -> MeshFrame:
    return MeshFrame(
        points, np.zeros_like(points), counts.astype(np.int64), indices.astype(np.int64)
    )
