"""What particles run into."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from animtool._types import BoolArray, FloatArray
from animtool.errors import Fault
from animtool.sim.colliders.poses import Poses
from animtool.sim.colliders.shapes import Shape

# No body of a shot is as fast as this [m/s]: what is has been put elsewhere.
SPEED_LIMIT = 200.0


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
    restitution: float = 0.0
    friction: float = 0.0
    margin: float = 0.0
    depenetration: float = 1.0
    speed_limit: float = SPEED_LIMIT

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
        if not 0 <= self.restitution <= 1:
            message = f"its restitution must be 0 to 1, not {self.restitution:g}"
            found.append(("restitution", message))
        for name in ("friction", "margin"):
            value = getattr(self, name)
            if not 0 <= value < np.inf:
                message = f"its {name} must be finite and 0 or more, not {value:g}"
                found.append((name, message))
        for name in ("depenetration", "speed_limit"):
            value = getattr(self, name)
            if not value > 0:
                found.append((name, f"its {name} must be above 0, not {value:g}"))
        return found

    def faults(self, where: str) -> list[Fault]:
        """Return what of it makes no sense (SIM020)."""
        return [Fault("SIM020", why, where=where) for _, why in self.problems()]
