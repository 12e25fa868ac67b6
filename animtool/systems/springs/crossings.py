"""Warnings about surfaces and ropes that pass through themselves or thin colliders."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, Severity, counted, warning
from animtool.core.quantities import length_text, plain_number
from animtool.core.record import dataclass
from animtool.maths.faces import directed_edges
from animtool.sim.colliders import Collider
from animtool.sim.colliders.shapes import Box, Capsule, Sphere
from animtool.systems.springs.drawing import CurveShape, Shape
from animtool.systems.springs.shapes import face_diagonals

# Intersection checks per motion; each costs as much as several steps.
CHECKS_PER_MOTION = 12
# Most colliders named in a warning.
MAX_NAMED = 3


@dataclass(slots=True)
class SelfCrossings:
    """Counts edges that pass through faces of a surface without self-contact.

    Attributes:
        triangles: Corners ``(T, 3)``.
        begin: The first time [s].
        last: The last time [s].
        max_crossings: Largest number of edges through faces, minus the initial number.
        time_of_max: Time of the largest number [s].
    """

    triangles: IntArray
    begin: float
    last: float
    max_crossings: int = 0
    time_of_max: float = 0.0
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
        if count - self._initial_count > self.max_crossings:
            self.max_crossings, self.time_of_max = count - self._initial_count, t

    def notices(self, name: str) -> list[Fault]:
        """Return a note if a surface passed through itself (SIM194)."""
        if not self.max_crossings:
            return []
        pairs = counted(self.max_crossings, "pair")
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
