"""What particles run into."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, TypeAlias

import numpy as np

from animtool._types import BoolArray, FloatArray
from animtool.errors import Fault
from animtool.ranges import OF_ENTRY, Range, above, or_more, range_faults
from animtool.sim.colliders.poses import Poses
from animtool.sim.colliders.shapes import Shape

Restitution: TypeAlias = Annotated[float, Range("0 to 1", "SIM020", 0, 1)]
Friction: TypeAlias = Annotated[float, or_more(0, "SIM020", finite=True)]
Depenetration: TypeAlias = Annotated[float, above(0, "SIM020")]

# No body of a shot is as fast as this [m/s]: what is has been put elsewhere.
SPEED_LIMIT = 200.0


def range_problems(record: Any) -> list[tuple[str, str]]:
    """Return numbers of a record that are out of their ranges: a field, and why."""
    faults = range_faults(record, OF_ENTRY)
    return [(str(fault.where), fault.message) for fault in faults]


@dataclass(frozen=True)
class Collider:
    """A shape, where it is over time, and what touching it does.

    Attributes:
        shape: In its own frame.
        poses: Of that frame in the world.
        name: For messages.
        container: Whether particles are to stay inside it.
        restitution: Share of the speed into the surface that comes back [0, 1].
        friction: Coulomb's coefficient [1].
        margin: Distance that particles keep [m].
        depenetration: How fast particles that start inside are moved out [m/s].
        speed_limit: A collider that goes faster was put elsewhere: it has no velocity
            then, and hits nothing on the way [m/s].
    """

    shape: Shape
    poses: Poses = field(default_factory=Poses)
    name: str = ""
    container: bool = False
    restitution: Restitution = 0.0
    friction: Friction = 0.0
    margin: Annotated[float, or_more(0, "SIM020", finite=True)] = 0.0
    depenetration: Depenetration = 1.0
    speed_limit: Annotated[float, above(0, "SIM020")] = SPEED_LIMIT

    @property
    def material(self) -> tuple[float, float, float, float]:
        """Restitution, friction, margin and depenetration."""
        return self.restitution, self.friction, self.margin, self.depenetration

    @cached_property
    def jumps(self) -> BoolArray:
        """Between which of its times it is put elsewhere ``(T - 1,)``."""
        return self.poses.jumps(self.shape.anchors(), self.speed_limit)

    @property
    def speed(self) -> float:
        """How fast it goes at most, jumps apart [m/s]."""
        places = self.poses.to_world(self.shape.anchors())
        ways = np.linalg.norm(np.diff(places, axis=0), axis=2).max(axis=1, initial=0.0)
        speeds = ways / np.diff(self.poses.moments)
        return float(speeds[~self.jumps].max(initial=0.0))

    def pose(self, t: float) -> FloatArray:
        """Return its pose ``(7,)`` at a time [s]; on a jump, the one before."""
        moments = self.poses.moments
        i = int(np.searchsorted(moments, t, side="right")) - 1
        if 0 <= i < len(self.jumps) and self.jumps[i]:
            row: FloatArray = self.poses.rows[i]
            return row
        return self.poses.at(t)

    def ends(self, t0: float, t1: float) -> FloatArray:
        """Return its poses ``(2, 7)`` at both ends of a step."""
        if self.jumps.any() and self._jumped(t0, t1):
            return np.stack([self.pose(t1)] * 2)
        return np.stack([self.pose(t0), self.pose(t1)])

    def _jumped(self, t0: float, t1: float) -> bool:
        arrivals = self.poses.moments[1:][self.jumps]
        return bool(((arrivals > t0) & (arrivals <= t1)).any())

    def problems(self) -> list[tuple[str, str]]:
        """Return what of it makes no sense: an option, and why."""
        found = [("shape", message) for message in self.shape.faults()]
        found += [("poses", message) for message in self.poses.faults()]
        return found + range_problems(self)

    def faults(self, where: str) -> list[Fault]:
        """Return what of it makes no sense (SIM020)."""
        return [Fault("SIM020", why, where=where) for _, why in self.problems()]
