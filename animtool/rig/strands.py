"""The strands of a rig with their numbers, read when asked for."""

from __future__ import annotations

from dataclasses import dataclass

from animtool._types import FloatArray
from animtool.errors import Fault, FormatError
from animtool.rig.skeleton import Rig


@dataclass(frozen=True, slots=True, eq=False)
class Strands:
    """Strands in memory.

    Attributes:
        name: As the rig names them.
        joint: Name of the joint that carries them as a whole.
        points: ``(S, K, 3)`` [m], where they are in the world at bind time, each from
            root to tip.
    """

    name: str
    joint: str
    points: FloatArray


def strands_of(rig: Rig) -> tuple[Strands, ...]:
    """Return the strands of a rig, their arrays read.

    Raises:
        FormatError: An array cannot be read any more (RIG018).
    """
    made = []
    for entry in rig.attach:
        if entry.points is None:
            continue
        try:
            points = entry.points.load() * rig.meters_per_unit
        except ValueError as error:
            raise FormatError(Fault("RIG018", f"{entry.name!r}: {error}")) from error
        made.append(Strands(entry.name, entry.joints[0], points))
    return tuple(made)
