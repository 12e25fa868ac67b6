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
from animtool.systems.springs.drawing import CurveShape, FaceShape, Shape

# Number of intersection checks in a motion: each costs as much as several steps.
LOOKS = 12
# Most colliders named in a warning.
MAX_NAMED = 3


@dataclass(slots=True)
class SelfCrossings:
    """Counts edges that pass through faces of a surface without self-contact.

    Attributes:
        triangles: Corners ``(T, 3)``.
        begin: The first time [s].
        last: The last time [s].
        most: Largest number of edges through faces, minus the initial number.
        when: Time of the largest number [s].
    """

    triangles: IntArray
    begin: float
    last: float
    most: int = 0
    when: float = 0.0
    _first: int | None = None
    _next: float = -np.inf

    def look(self, t: float, points: FloatArray) -> None:
        """Count intersections of points ``(N, 3)`` [m] at a time [s], if due."""
        if t < self._next or not len(self.triangles):
            return
        interval = (self.last - self.begin) / LOOKS
        self._next = min(t + interval, self.last) if t < self.last else np.inf
        corners = np.ascontiguousarray(self.triangles, np.int64)
        count = _kernels.pierced_edges(np.ascontiguousarray(points), corners)
        if self._first is None:
            self._first = count
        if count - self._first > self.most:
            self.most, self.when = count - self._first, t

    def notices(self, name: str) -> list[Fault]:
        """Return a note if a surface passed through itself (SIM194)."""
        if not self.most:
            return []
        message = f"{name} passed through itself: {counted(self.most, 'pair')} of an "
        message += (
            f"edge and a face, at {plain_number(self.when)} s, as its self_contact is "
        )
        message += "off"
        hint = "set self_contact with a thickness, such as half an edge"
        return [Fault("SIM194", message, hint=hint, severity=Severity.NOTE)]


def widest_gap(shape: Shape, points: FloatArray) -> float:
    """Return the largest distance between neighbouring particles [m].

    Rest positions are ``(N, 3)`` [m]. For faces it is the longest side or diagonal:
    thinner colliders pass between the corners.
    """
    if isinstance(shape, CurveShape):
        first = np.arange(len(points) - 1)
        inner = np.ones(len(first), bool)
        inner[np.cumsum(shape.counts)[:-1] - 1] = False
        pairs = np.stack([first, first + 1], axis=1)[inner]
    else:
        pairs = _side_and_diagonal_pairs(shape)
    if not len(pairs):
        return 0.0
    gaps = points[pairs[:, 1]] - points[pairs[:, 0]]
    return float(np.linalg.norm(gaps, axis=1).max())


def _side_and_diagonal_pairs(shape: FaceShape) -> IntArray:
    """Return the corner pairs of face sides and diagonals ``(P, 2)``."""
    pairs = [directed_edges(shape.counts, shape.indices)]
    starts = np.cumsum(shape.counts) - shape.counts
    for skip in range(2, int(shape.counts.max(initial=0)) // 2 + 1):
        has_diagonal = shape.counts >= 2 * skip
        face_numbers = np.repeat(np.arange(len(starts)), shape.counts)
        corner_numbers = np.arange(len(shape.indices))
        opposite = (
            starts[face_numbers]
            + (corner_numbers - starts[face_numbers] + skip)
            % shape.counts[face_numbers]
        )
        skip_pairs = np.stack(
            [shape.indices[corner_numbers], shape.indices[opposite]], axis=1
        )
        pairs.append(skip_pairs[has_diagonal[face_numbers]])
    return np.concatenate(pairs)


def thickness(collider: Collider) -> float:
    """Return the thickness of a collider across its length [m]; infinite if unknown.

    For a box it is its second-longest side: plates are hit on their face.
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
    stretch: float,
    *,
    faces: bool = False,
    edges: bool = False,
) -> list[Fault]:
    """Return a warning about colliders thinner than the particle gap (SIM195).

    Particles keep a radius from colliders [m]. The rest gap [m] grows by the stretch
    [1]. Faces are stopped by colliders, but faces that passed through each other may
    have done so around the collider. Edges alone are stopped by all but balls.
    """
    stretched_gap = gap * (1 + max(stretch, 0.0))
    thin = [
        (thickness(collider), collider.name or f"colliders[{i}]")
        for i, collider in enumerate(colliders)
        if thickness(collider) + 2 * radius < stretched_gap
        and (faces or not edges or isinstance(collider.shape, Sphere))
    ]
    if not thin:
        return []
    thinnest = min(thin)[0]
    names = ", ".join(label for _, label in thin[:MAX_NAMED])
    more = len(thin) - MAX_NAMED
    names += f" and {more} more" if more > 0 else ""
    message = (
        f"{names}: a collider {length_text(thinnest)} thick is thinner than the gap "
    )
    message += (
        f"between particles of {name}, up to {length_text(stretched_gap)} when "
        "stretched:"
    )
    if faces:
        message += (
            " its faces are stopped, and what is attached on either side of them may "
        )
        message += "have passed through itself, as its self_contact is off"
        return [warning("SIM195", message, "set self_contact with a thickness")]
    message += " it may pass through between them"
    hint = "use more particles, a thicker collider, or a larger radius"
    return [warning("SIM195", message, hint)]
