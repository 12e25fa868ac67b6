"""A small kind of system: a point on a circle, kept above a floor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Gt
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import Real
from animtool.maths import so3
from animtool.motion.frames import MeshFrame, PointsFrame, TransformsFrame
from animtool.sim.system import Energy
from animtool.systems.framework.fields import (
    ArrayEntry,
    EmitterShapeEntry,
    ForceEntry,
    PlacedModel,
    ShapeEntry,
    SystemColliderModel,
)
from animtool.systems.framework.simulation import Diagnostics, SimContext
from animtool.systems.framework.spec import SystemSpec

WING = MeshFrame(np.eye(3), np.zeros((3, 3)), np.array([3]), np.arange(3))


class FlockModel(FileModel):
    """Some of those that swing."""

    place: EmitterShapeEntry = Field(default={"point": None})
    wing: ShapeEntry | None = None


class Spec(SystemSpec):
    """What there is to say of it."""

    methods: ClassVar[tuple[str, ...]] = ("euler", "midpoint")
    method: Literal["euler", "midpoint"] = "midpoint"
    speed: Annotated[Real, Gt(0)] = Field(description="[rad/s].")
    colliders: list[SystemColliderModel] = Field(default=[])
    forces: list[ForceEntry] = Field(default=[])
    copies: bool = False
    masses: ArrayEntry | None = None
    goal: PlacedModel | None = None
    kill: list[SystemColliderModel] = Field(default=[])
    flocks: list[FlockModel] = Field(default=[])


@dataclass(frozen=True)
class Swing:
    spec: Spec
    context: SimContext

    def initial_state(self) -> np.ndarray:
        return np.array([1.0, 0.0])

    def step(self, state: np.ndarray, t: float, dt: float) -> np.ndarray:  # noqa: ARG002
        """Go on by its method."""
        rate = self.spec.speed * np.array([[0.0, -1.0], [1.0, 0.0]])
        middle = dt / 2 if self.spec.method == "midpoint" else 0.0
        return state + dt * rate @ (state + middle * rate @ state)

    def frame(self, state: np.ndarray, t: float) -> PointsFrame | TransformsFrame:
        """Show a point; as a copy it stays, and turns with the angle on the circle."""
        if self.spec.copies:
            turn = so3.exp(np.arctan2(*state[::-1]) * np.array([[0.0, 0.0, 1.0]]))
            none = np.zeros((1, 3))
            which = np.zeros(1, np.int64)
            return TransformsFrame(
                np.arange(1), none, none, turn, none, none + 1, which, (WING,)
            )
        point = np.array([[*state, 0.0]])
        if self.context.colliders:
            away = self.context.colliders.sample(point, t)
            point = point - np.minimum(away.distances[0], 0)[:, None] * [0, 1, 0]
        return PointsFrame(np.arange(1), point, np.zeros((1, 3)), np.ones(1))

    def diagnostics(self, state: np.ndarray, t: float) -> Diagnostics:  # noqa: ARG002
        radius = float(np.hypot(*state))
        return Diagnostics(Energy(radius**2, 0.0), {"radius": radius})


def build(spec: Spec, context: SimContext) -> Swing:
    return Swing(spec, context)
