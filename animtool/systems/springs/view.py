"""Frames, surfaces and diagnostics of one spring entry."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import field
from typing import Any, cast

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, Severity, counted, percent_text, warning
from animtool.core.quantities import length_text, plain_number
from animtool.core.record import dataclass
from animtool.maths.faces import directed_edges
from animtool.motion.frames import Frame, MeshFrame
from animtool.sim.colliders import Collider
from animtool.sim.colliders.shapes import Box, Capsule, Sphere
from animtool.systems.framework.meter import (
    ContactMeter,
    MeasuredSurface,
    closed_surfaces,
    collider_depths,
    surface_depths,
)
from animtool.systems.framework.simulation import Diagnostics
from animtool.systems.framework.spec import JoinedEntry
from animtool.systems.springs.drawing import CurveShape, FaceShape, Shape, Tearing
from animtool.systems.springs.motion import SpringState
from animtool.systems.springs.shapes import face_diagonals
from animtool.systems.springs.simulation import SpringSimulation

# Intersection checks per motion; each costs as much as several steps.
CHECKS_PER_MOTION = 12
# Lifts that are tried to bring a start out of colliders, in its depth [1].
LIFT_STEP, MAX_LIFT_STEPS = 0.125, 40
# Warnings that result from a start inside colliders.
START_DEPTH_CODES = frozenset(
    {"SIM123", "SIM131", "SIM144", "SIM161", "SIM165", "SIM167"}
)
# Most colliders named in a warning.
MAX_NAMED = 3


@dataclass(slots=True)
class SelfCrossings:
    """Counts edges that pass through faces of a surface without self-contact."""

    triangles: IntArray  # corners ``(T, 3)``
    begin: float  # the first time [s]
    last: float  # the last time [s]
    max_crossing_count: int = 0  # most edges through faces, minus the initial number
    time_of_max: float = 0.0  # time of the largest number [s]
    _initial_count: int | None = None
    _next_time: float = -np.inf

    def count_if_due(self, t: float, points: FloatArray) -> None:
        """Count self-intersections of points ``(N, 3)`` [m] at a time [s], if due."""
        if t < self._next_time or not len(self.triangles):
            return
        interval = (self.last - self.begin) / CHECKS_PER_MOTION
        self._next_time = min(t + interval, self.last) if t < self.last else np.inf
        corners = np.ascontiguousarray(self.triangles, np.int64)
        count = _kernels.pierced_edges(np.ascontiguousarray(points), corners)
        if self._initial_count is None:
            self._initial_count = count
        if count - self._initial_count > self.max_crossing_count:
            self.max_crossing_count, self.time_of_max = count - self._initial_count, t

    def notices(self, name: str) -> list[Fault]:
        """Return a note if a surface passed through itself (SIM194)."""
        if not self.max_crossing_count:
            return []
        pairs = counted(self.max_crossing_count, "pair")
        message = f"{name} passed through itself: {pairs} of an edge and a face, at "
        message += f"{plain_number(self.time_of_max)} s, as its self_contact is off"
        hint = "set self_contact with a thickness, such as half an edge"
        return [Fault("SIM194", message, hint=hint, severity=Severity.NOTE)]


def widest_gap(shape: Shape, points: FloatArray) -> float:
    """Return the largest distance between neighbouring particles [m].

    Rest positions are ``(N, 3)`` [m]. For faces it is the longest side or diagonal:
    thinner colliders pass between the corners.
    """
    if isinstance(shape, CurveShape):
        first = np.arange(len(points) - 1)
        is_same_curve = np.ones(len(first), bool)
        is_same_curve[np.cumsum(shape.counts)[:-1] - 1] = False
        pairs = np.stack([first, first + 1], axis=1)[is_same_curve]
    else:
        sides = directed_edges(shape.counts, shape.indices)
        diagonals = face_diagonals(shape.counts, shape.indices)
        pairs = np.concatenate([sides, diagonals])
    if not len(pairs):
        return 0.0
    gaps = points[pairs[:, 1]] - points[pairs[:, 0]]
    return float(np.linalg.norm(gaps, axis=1).max())


def collider_thickness(collider: Collider) -> float:
    """Return the thickness of a collider across its length [m]; else infinity.

    For a box, this is the second-longest side: plates are hit on a face.
    """
    shape = collider.shape
    if isinstance(shape, Sphere | Capsule):
        return 2 * shape.radius
    if isinstance(shape, Box):
        return float(np.sort(np.asarray(shape.size, np.float64))[1])
    return np.inf


def thin_notices(
    name: str,
    colliders: Sequence[Collider],
    radius: float,
    gap: float,
    strain: float,
    *,
    has_faces: bool = False,
    has_edges: bool = False,
) -> list[Fault]:
    """Return a warning about colliders thinner than the particle gap (SIM195).

    Particles keep a radius [m] from colliders. The rest gap [m] grows by a strain [1].
    Colliders stop faces, but faces that passed through each other may have done so
    around a collider. All colliders except spheres stop edges.
    """
    stretched_gap = gap * (1 + max(strain, 0.0))
    thin = [
        (collider_thickness(collider), collider.name or f"colliders[{i}]")
        for i, collider in enumerate(colliders)
        if collider_thickness(collider) + 2 * radius < stretched_gap
        and (has_faces or not has_edges or isinstance(collider.shape, Sphere))
    ]
    if not thin:
        return []
    thinnest = min(thin)[0]
    names = ", ".join(label for _, label in thin[:MAX_NAMED])
    extra_count = len(thin) - MAX_NAMED
    names += f" and {extra_count} more" if extra_count > 0 else ""
    message = f"{names}: a collider {length_text(thinnest)} thick is thinner than the "
    message += f"gap between particles of {name}, up to {length_text(stretched_gap)} "
    message += "when stretched:"
    if has_faces:
        message += " its faces are stopped, and what is attached on either side of "
        message += "them may have passed through itself, as its self_contact is off"
        return [warning("SIM195", message, "set self_contact with a thickness")]
    message += " it may pass through between them"
    hint = "use more particles, a thicker collider, or a larger radius"
    return [warning("SIM195", message, hint)]


@dataclass
class SpringView:
    """Frames and diagnostics of one entry of a spring simulation."""

    simulation: SpringSimulation
    member: JoinedEntry  # the scene entry
    rows: IntArray  # particle indices in the simulation ``(N,)``
    springs: slice  # spring indices in the simulation
    member_notices: Sequence[Fault]  # warnings about this entry alone
    is_first: bool  # whether this entry reports for all joined entries
    _torn_mesh: Tearing | FaceShape | None = None
    # Cache: number of torn springs, and the faces intact at that number.
    _intact: tuple[int, IntArray, IntArray] | None = None
    _self_crossings: SelfCrossings | None = None
    # Measured sides and peaks of a surface in contact.
    _measured_surface: MeasuredSurface | None = None
    _meter: ContactMeter = field(
        default_factory=lambda: ContactMeter(uses_seconds=True)
    )

    def __post_init__(self) -> None:
        """Count self-intersections of a surface without self-contact."""
        simulation, body = self.simulation, self.body
        has_self_contact = simulation.system.self_contact is not None
        if isinstance(body.shape, FaceShape) and not has_self_contact:
            self._self_crossings = SelfCrossings(
                body.body.triangles, simulation.begin, simulation.last
            )

    @property
    def is_intact(self) -> bool:
        """Whether its surface was measured, and nothing intersected it in any frame."""
        if not isinstance(self.body.shape, FaceShape):
            return True
        return self._measured_surface is not None and not self._meter.pierced.value

    @property
    def body(self) -> Any:
        """Particles, springs and display shape of the entry."""
        return self.member.record.body

    @property
    def can_tear(self) -> bool:
        """Whether the entry is a surface whose springs can tear."""
        return isinstance(self.body.shape, FaceShape) and self.body.shape.can_tear

    def torn(self, state: SpringState) -> BoolArray:
        """Return the torn flags of the entry's springs ``(S,)``."""
        return self.simulation.system.torn(state.torn)[self.springs]

    def prepare_tears(self, last: SpringState) -> None:
        """Split the surface along the springs that are torn in the final state."""
        shape = cast(FaceShape, self.body.shape)
        self._torn_mesh = shape.torn_shape(self.torn(last), self.body.body.positions)

    def frame(self, state: SpringState, t: float) -> Frame:
        """Return the curves or the mesh of the entry at a state."""
        self.simulation.measure(state, t)
        points, velocities = state.motion[:, self.rows]
        if self._self_crossings is not None:
            self._self_crossings.count_if_due(t, points)
        self._measure(points, t, state)
        shape = self._torn_mesh or self.body.shape
        frame: Frame = shape.frame(points, velocities, self.torn(state))
        return frame

    def _measure(self, points: FloatArray, t: float, state: SpringState) -> None:
        """Measure depth, piercing and strain of a surface in contact."""
        system, body, shape = self.simulation.system, self.body.body, self.body.shape
        colliders, has_self_contact = system.colliders, system.self_contact is not None
        has_contact = colliders.has_any or has_self_contact
        if not isinstance(shape, FaceShape) or not has_contact:
            return
        torn = self.torn(state)
        if self._measured_surface is None or torn.any():
            # Triangles are measured only with self-contact, and torn springs never.
            springs = body.springs.select(shape.side_springs[~torn[shape.side_springs]])
            triangles = body.triangles if has_self_contact else body.triangles[:0]
            self._measured_surface = MeasuredSurface.of_edges(
                springs.ends, springs.rest, system.is_pinned[self.rows], triangles
            )
        solids = closed_surfaces(colliders, t)
        depths = collider_depths(colliders, points, t)
        is_start = self._meter.start is None
        self._meter.measure(t, points, self._measured_surface, solids, depths)
        if is_start and self._meter.starts_inside:
            free_points = points[self._measured_surface.free_particles]
            self._meter.start_lift = self._lift_from_colliders(free_points, t)

    def _lift_from_colliders(self, points: FloatArray, t: float) -> float:
        """Return the smallest lift that brings points out of colliders [m]; else 0."""
        system, depth = self.simulation.system, self._meter.start_depth
        gravity = float(np.linalg.norm(system.gravity))
        if not gravity:
            return 0.0
        solids = closed_surfaces(system.colliders, t)
        for lift in depth * LIFT_STEP * np.arange(1, MAX_LIFT_STEPS + 1):
            lifted = points - system.gravity * (lift / gravity)
            depths = [collider_depths(system.colliders, lifted, t)]
            depths += [surface_depths(solid, lifted) for solid in solids]
            if float(np.max(depths)) <= 0.0:
                return float(lift + system.radius)
        return 0.0

    def _crossing_notices(self) -> list[Fault]:
        """Return warnings of self-intersection and thin colliders (SIM194, SIM195)."""
        simulation, body, name = self.simulation, self.body, self.member.name
        crossings = self._self_crossings
        notices = [] if crossings is None else crossings.notices(name)
        # Whether any of its particles is a corner of a colliding face.
        triangles = simulation.system.body.triangles
        has_faces = bool(np.isin(triangles, self.rows).any())
        if has_faces and not notices:
            return notices
        # Edges of ropes and strands collide too, but not with balls.
        has_edges = not len(triangles)
        gap = widest_gap(body.shape, body.body.positions)
        colliders, radius = list(simulation.system.colliders), simulation.system.radius
        return notices + thin_notices(
            name,
            colliders,
            radius,
            gap,
            simulation.max_strain,
            has_faces=has_faces,
            has_edges=has_edges,
        )

    @property
    def radius(self) -> float:
        """Collision radius: half the thickness of the entry [m]."""
        radius: float = self.member.spec.radius
        return radius

    @property
    def closed(self) -> bool:
        """Whether the surface is closed: others collide only with its outside."""
        return getattr(self.body.shape, "closed", False)

    def surface(self, state: SpringState, t: float) -> MeshFrame:
        """Return the intact faces of the entry, as a collider for other systems."""
        self.simulation.measure(state, t)
        shape, torn = cast(FaceShape, self.body.shape), self.torn(state)
        torn_count = int(torn.sum())
        if self._intact is None or torn_count != self._intact[0]:
            intact = (
                shape.intact_faces(torn)
                if torn_count
                else (shape.counts, shape.indices)
            )
            self._intact = torn_count, *intact
        points, velocities = state.motion[:, self.rows]
        return MeshFrame(points, velocities, *self._intact[1:], self.closed)

    def diagnostics(self, state: SpringState, t: float) -> Diagnostics:  # noqa: ARG002
        """Return result values and warnings collected so far."""
        simulation, body, name = self.simulation, self.body.body, self.member.name
        values: dict[str, Any] = {
            "kind": self.member.kind,
            "particles": len(body.positions),
            "springs": len(body.springs.rest),
            "solver": str(simulation.choice.solver),
            "reason": simulation.choice.reason,
            "step": simulation.shortest_step,
            "steps": simulation.grid.step_count,
            "stretch": simulation.max_strain,
            "torn": int(self.torn(state).sum()),
            "unresolved": simulation.grid.unresolved_count,
        }
        error = simulation.plan.error
        if error is not None:
            values["error"] = error if math.isfinite(error) else None
        if self._measured_surface is not None:
            values |= self._meter.values
        notices = [
            *self.member_notices,
            *self._crossing_notices(),
            *self._meter.notices(name),
        ]
        if self.is_first:
            if any(view._meter.starts_inside for view in simulation.views):
                notices += [
                    notice
                    for notice in simulation.notices
                    if notice.code not in START_DEPTH_CODES
                ]
            else:
                notices += simulation.notices
                notices += simulation.strain_notices(name)
            notices.append(self._note(int(state.torn.sum())))
        return Diagnostics(values=values, notices=notices)

    def _note(self, torn_count: int) -> Fault:
        """Return a note about the solver, strain and contact (SIM130)."""
        simulation = self.simulation
        phrases = [
            f"the shortest step is {plain_number(simulation.shortest_step)} s",
            f"springs stretch by up to {percent_text(simulation.max_strain)}",
        ]
        error = simulation.plan.error
        if error is not None and math.isfinite(error):
            phrases.append(f"the error is {length_text(error)}")
        if torn_count:
            verb = "is" if torn_count == 1 else "are"
            phrases.append(f"{counted(torn_count, 'spring')} {verb} torn")
        if self._meter.text:
            phrases.append(self._meter.text)
        message = f"{self.member.name} uses {simulation.choice.solver} "
        message += f"({simulation.choice.reason}); {'; '.join(phrases)}"
        return Fault("SIM130", message, severity=Severity.NOTE)
