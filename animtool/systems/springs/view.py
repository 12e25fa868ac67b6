"""What a rope, strands, cloth or a volume shows of springs in steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import field
from typing import Any, cast

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, Severity, counted, percent, warning
from animtool.core.quantities import length_text, plain
from animtool.core.record import dataclass
from animtool.motion.frames import Frame, MeshFrame
from animtool.systems.framework.meter import (
    ContactMeter,
    Sides,
    closed_surfaces,
    depths_of,
)
from animtool.systems.framework.simulation import Diagnostics
from animtool.systems.framework.spec import Member
from animtool.systems.springs.body import Body
from animtool.systems.springs.crossings import SelfCrossings, thin_notices, widest_gap
from animtool.systems.springs.drawing import FaceShape, Tearing
from animtool.systems.springs.motion import SpringState
from animtool.systems.springs.simulation import SpringSimulation


@dataclass
class SpringView:
    """What a rope, strands, cloth or a volume shows."""

    simulation: SpringSimulation
    member: Member  # its entry
    rows: IntArray  # its particles in the simulation ``(N,)``
    springs: slice  # its springs there
    member_notices: Sequence[Fault]  # what is odd about it alone
    first: bool  # whether it speaks for all that it is joined to
    _torn_mesh: Tearing | FaceShape | None = None
    # How many springs are torn, and the faces that are whole then.
    _intact: tuple[int, IntArray, IntArray] | None = None
    _crossings: SelfCrossings | None = None
    # What of a surface is measured where it touches anything, and the worst of it.
    _sides: Sides | None = None
    _meter: ContactMeter = field(default_factory=lambda: ContactMeter(seconds=True))

    @property
    def body(self) -> Any:
        """Its particles and springs, and what is drawn of them."""
        return self.member.record.body

    @property
    def tears(self) -> bool:
        """Whether it is a surface that may part."""
        return isinstance(self.body.shape, FaceShape) and self.body.shape.tears

    def torn(self, state: SpringState) -> BoolArray:
        """Return which of its springs are torn ``(S,)``."""
        return self.simulation.system.torn(state.torn)[self.springs]

    def part(self, last: SpringState) -> None:
        """Draw it so that it can part where springs are torn in a later state."""
        shape = cast(FaceShape, self.body.shape)
        self._torn_mesh = shape.torn_shape(self.torn(last), self.body.body.positions)

    def frame(self, state: SpringState, t: float) -> Frame:
        """Return what is drawn of it."""
        self.simulation.measure(state, t)
        points, velocities = state.motion[:, self.rows]
        self._look(points, t)
        self._measure(points, t, state)
        shape = self._torn_mesh or self.body.shape
        frame: Frame = shape.row(points, velocities, self.torn(state))
        return frame

    def _look(self, points: FloatArray, t: float) -> None:
        """Count what of a surface goes through it, where nothing keeps it apart."""
        simulation, shape = self.simulation, self.body.shape
        if simulation.system.self_contact is not None or not isinstance(
            shape, FaceShape
        ):
            return
        if self._crossings is None:
            corners = self.body.body.triangles
            self._crossings = SelfCrossings(corners, simulation.begin, simulation.last)
        self._crossings.look(t, points)

    def _measure(self, points: FloatArray, t: float, state: SpringState) -> None:
        """Note how deep a surface is in what it touches, through it, and strained."""
        system, body, shape = self.simulation.system, self.body.body, self.body.shape
        colliders, touches = system.colliders, system.self_contact is not None
        if not isinstance(shape, FaceShape) or not (colliders.active or touches):
            return
        if self._sides is None:
            self._sides = _sides_of(shape, system.fixed[self.rows], body, touches)
        solids, depths = closed_surfaces(colliders, t), depths_of(colliders, points, t)
        sides, torn = self._sides, self.torn(state)
        if torn.any():
            sides = _sides_of(shape, system.fixed[self.rows], body, touches, torn)
        self._meter.look(t, points, sides, solids, depths)

    def _crossing_notices(self) -> list[Fault]:
        """Return warnings of what went through it, or may have (SIM194, SIM195)."""
        simulation, body, name = self.simulation, self.body, self.member.name
        notices = self._crossings.notices(name) if self._crossings is not None else []
        met = simulation.system.faces_of(self.rows)
        if met and not notices:
            return notices
        gap = widest_gap(body.shape, body.body.positions)
        colliders, radius = list(simulation.system.colliders), simulation.system.radius
        return notices + thin_notices(
            name, colliders, radius, gap, simulation.stretch, faces=met
        )

    @property
    def radius(self) -> float:
        """Half its thickness [m]."""
        radius: float = self.member.spec.radius
        return radius

    @property
    def closed(self) -> bool:
        """Whether only its outside is run into."""
        return getattr(self.body.shape, "closed", False)

    def surface(self, state: SpringState, t: float) -> MeshFrame:
        """Return those of its faces that are not torn."""
        self.simulation.measure(state, t)
        shape, torn = cast(FaceShape, self.body.shape), self.torn(state)
        gone = int(torn.sum())
        if self._intact is None or gone != self._intact[0]:
            intact = shape.intact_faces(torn) if gone else (shape.counts, shape.indices)
            self._intact = gone, *intact
        points, velocities = state.motion[:, self.rows]
        return MeshFrame(points, velocities, *self._intact[1:], self.closed)

    def diagnostics(self, state: SpringState, t: float) -> Diagnostics:  # noqa: ARG002
        """Return what became of it, and what is odd so far."""
        simulation, body, name = self.simulation, self.body.body, self.member.name
        values: dict[str, Any] = {
            "kind": self.member.kind,
            "particles": len(body.positions),
            "springs": len(body.springs.rest),
            "solver": str(simulation.choice.solver),
            "reason": simulation.reason,
            "step": simulation.shortest,
            "steps": simulation.taken,
            "stretch": simulation.stretch,
            "torn": int(self.torn(state).sum()),
            "unresolved": simulation.unresolved,
        }
        if simulation.error is not None:
            values["error"] = (
                simulation.error if math.isfinite(simulation.error) else None
            )
        if self._sides is not None:
            values |= self._meter.values
        notices = [
            *self.member_notices,
            *self._crossing_notices(),
            *self._meter.notices(name),
        ]
        if self.first:
            notices += simulation.notices
            if simulation.long:
                strain = percent(simulation.stretch)
                message = f"{name}: springs stretch {strain} beyond their length "
                hint = "raise the stiffness [N/m] of each spring, or "
                hint += "lower the mass [kg]"
                notices.append(warning("SIM187", f"{message}at rest", hint))
            notices.append(self._note(int(state.torn.sum())))
        return Diagnostics(values=values, notices=notices)

    def _note(self, torn: int) -> Fault:
        simulation = self.simulation
        parts = [
            f"{simulation.choice.solver} ({simulation.reason})",
            f"steps of {plain(simulation.shortest)} s and more",
            f"springs strained by up to {percent(simulation.stretch)}",
        ]
        if simulation.error is not None and math.isfinite(simulation.error):
            parts.append(f"error {length_text(simulation.error)}")
        if torn:
            parts.append(f"{counted(torn, 'spring')} torn")
        if self._meter.text:
            parts.append(self._meter.text)
        message = f"{self.member.name}: {', '.join(parts)}"
        return Fault("SIM130", message, severity=Severity.NOTE)


def _sides_of(
    shape: FaceShape,
    fixed: BoolArray,
    body: Body,
    touches: bool,
    torn: BoolArray | None = None,
) -> Sides:
    """Return what of a surface is measured, without springs that are torn ``(S,)``.

    Its triangles where they keep apart from each other.
    """
    side_springs = shape.side_springs
    kept = (body.springs.rest[side_springs] > 0) & ~fixed[
        body.springs.ends[side_springs]
    ].all(axis=1)
    kept &= True if torn is None else ~torn[side_springs]
    triangles = body.triangles if touches else body.triangles[:0]
    springs = body.springs.select(side_springs[kept])
    return Sides(np.flatnonzero(~fixed), triangles, springs.ends, springs.rest)
