"""A velocity field: particles go with it, whatever their mass."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.options import Checked, inherits_docs
from animtool.core.record import dataclass
from animtool.rig.expressions import Expression, parse_expression
from animtool.systems.particles.records import Velocity
from animtool.systems.particles.state import ParticleState

# What expressions of fields may name: place [m], velocity [m/s], time and age [s].
VARIABLES = ("x", "y", "z", "vx", "vy", "vz", "t", "age", "mass", "charge")
_OF_PLACE = ("x", "y", "z", "t", "age")


class Expressions:
    """What has three expressions, one along each axis."""

    x: str
    y: str
    z: str

    @cached_property
    def expressions(self) -> tuple[Expression, ...]:
        """The three, ready to be evaluated."""
        return tuple(parse_expression(text) for text in (self.x, self.y, self.z))


@inherits_docs
@dataclass(frozen=True)
class VelocityField(Velocity, Expressions, Checked):
    """Velocities by place and time, as expressions of x, y, z [m], t and age [s]."""

    code: ClassVar[str] = "SIM022"

    def velocity(
        self, t: float | FloatArray, x: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return velocities at places ``(N, 3)`` [m/s]."""
        return evaluated(self.expressions, t, x, np.zeros_like(x), particles)

    def problems(self) -> list[tuple[str, str]]:
        """Return which of the three makes no sense, and why."""
        faults = expression_faults(self, _OF_PLACE)
        return [(axis, f"its {axis} {why}") for axis, why in faults]


def evaluated(
    expressions: tuple[Expression, ...],
    t: float | FloatArray,
    x: FloatArray,
    v: FloatArray,
    particles: ParticleState,
) -> FloatArray:
    """Return three expressions at particles ``(N, 3)``."""
    times = np.broadcast_to(np.asarray(t, np.float64), len(x))
    columns = [
        *x.T,
        *v.T,
        times,
        times - particles.births,
        particles.masses,
        particles.charges,
    ]
    values = dict(zip(VARIABLES, columns, strict=True))
    found = [np.broadcast_to(one.evaluate(values), len(x)) for one in expressions]
    return np.stack(found, axis=1)


def expression_faults(given: object, names: tuple[str, ...]) -> list[tuple[str, str]]:
    """Return which of the expressions x, y and z makes no sense, and why."""
    from animtool.core.names import nearest

    found = []
    for axis in "xyz":
        try:
            expression = parse_expression(getattr(given, axis))
        except ValueError as error:
            found.append((axis, str(error)))
            continue
        found += [
            (axis, f"unknown variable {name!r}: {nearest(name, list(names))}")
            for name in expression.names
            if name not in names
        ]
    return found
