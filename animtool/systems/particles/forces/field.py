"""A force that expressions give."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from animtool._types import FloatArray
from animtool.rig.expressions import Expression, parse_expression
from animtool.systems.particles.forces.force import Force, Time
from animtool.systems.particles.state import ParticleState
from animtool.systems.particles.velocity_field import (
    VARIABLES,
    evaluated,
    expression_faults,
)


@dataclass(frozen=True)
class Field(Force):
    """Forces as expressions of x, y, z, vx, vy, vz, t, age, mass and charge."""

    x: str = "0"  # [N]
    y: str = "0"  # [N]
    z: str = "0"  # [N]

    @cached_property
    def expressions(self) -> tuple[Expression, ...]:
        """The three, ready to be evaluated."""
        return tuple(parse_expression(text) for text in (self.x, self.y, self.z))

    def force(
        self, t: Time, x: FloatArray, v: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return forces ``(N, 3)`` [N]."""
        return evaluated(self.expressions, t, x, v, particles)

    def faults(self) -> list[tuple[str, str]]:
        """Return which options make no sense, and why."""
        return expression_faults(self, VARIABLES)
