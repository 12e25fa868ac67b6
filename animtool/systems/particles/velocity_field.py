"""Velocity fields that advect particles regardless of mass."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.options import CheckedRecord, inherits_docs
from animtool.core.record import dataclass
from animtool.rig.expressions import Expression, parse_expression
from animtool.systems.particles.records import Velocity
from animtool.systems.particles.state import ParticleState

# Variables of field expressions: position [m], velocity [m/s], time and age [s], mass
# [kg] and charge [C].
VARIABLES = ("x", "y", "z", "vx", "vy", "vz", "t", "age", "mass", "charge")
_VELOCITY_VARIABLES = ("x", "y", "z", "t", "age")


class Expressions:
    """Base of records with three expressions, one per axis."""

    x: str
    y: str
    z: str

    @cached_property
    def expressions(self) -> tuple[Expression, ...]:
        """The parsed expressions of x, y and z."""
        return tuple(parse_expression(text) for text in (self.x, self.y, self.z))


@inherits_docs
@dataclass(frozen=True)
class VelocityField(Velocity, Expressions, CheckedRecord):
    """A velocity field as expressions of x, y, z [m], t and age [s]."""

    code: ClassVar[str] = "SIM022"

    def velocity(
        self, t: float | FloatArray, x: FloatArray, particles: ParticleState
    ) -> FloatArray:
        """Return velocities at points ``(N, 3)`` [m/s]."""
        return evaluate_expressions(self.expressions, t, x, np.zeros_like(x), particles)

    def problems(self) -> list[tuple[str, str]]:
        """Return invalid expressions by axis, each with a message."""
        faults = expression_faults(self, _VELOCITY_VARIABLES)
        return [(axis, f"its {axis} {reason}") for axis, reason in faults]


def evaluate_expressions(
    expressions: tuple[Expression, ...],
    t: float | FloatArray,
    x: FloatArray,
    v: FloatArray,
    particles: ParticleState,
) -> FloatArray:
    """Return the values of three expressions at particles ``(N, 3)``."""
    times = np.broadcast_to(np.asarray(t, np.float64), len(x))
    ages = times - particles.births
    variables = [*x.T, *v.T, times, ages, particles.masses, particles.charges]
    values_by_variable = dict(zip(VARIABLES, variables, strict=True))
    components = [expression.evaluate(values_by_variable) for expression in expressions]
    return np.stack([np.broadcast_to(value, len(x)) for value in components], axis=1)


def expression_faults(options: object, names: tuple[str, ...]) -> list[tuple[str, str]]:
    """Return the invalid expressions of x, y and z by axis, each with a reason."""
    from animtool.core.names import name_hint

    faults = []
    for axis in "xyz":
        try:
            expression = parse_expression(getattr(options, axis))
        except ValueError as error:
            faults.append((axis, str(error)))
            continue
        faults += [
            (axis, f"unknown variable {name!r}: {name_hint(name, list(names))}")
            for name in expression.names
            if name not in names
        ]
    return faults
