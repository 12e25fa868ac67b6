"""What goes through a surface or a rope where nothing stops it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from animtool import _kernels
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, Severity, counted, warning
from animtool.core.quantities import length_text, plain
from animtool.core.record import dataclass
from animtool.maths.faces import sides
from animtool.sim.colliders import Collider
from animtool.sim.colliders.shapes import Box, Capsule, Sphere
from animtool.systems.springs.drawing import CurveShape, FaceShape, Shape

# Looks at a surface over a whole motion: one takes as long as some steps do.
LOOKS = 12
# Of many colliders, those that are named.
MAX_NAMED = 3


@dataclass(slots=True)
class SelfCrossings:
    """Edges of a surface that go through its faces, where nothing keeps them apart.

    Attributes:
        triangles: Corners ``(T, 3)``.
        begin: The first time [s].
        last: The last time [s].
        most: Edges through faces beyond those at the first look, at most at a time.
        when: The time of that [s].
    """

    triangles: IntArray
    begin: float
    last: float
    most: int = 0
    when: float = 0.0
    _first: int | None = None
    _next: float = -np.inf

    def look(self, t: float, points: FloatArray) -> None:
        """Count at a time [s] where points are ``(N, 3)`` [m], now and then."""
        if t < self._next or not len(self.triangles):
            return
        wait = (self.last - self.begin) / LOOKS
        self._next = min(t + wait, self.last) if t < self.last else np.inf
        corners = np.ascontiguousarray(self.triangles, np.int64)
        count = _kernels.pierced_edges(np.ascontiguousarray(points), corners)
        if self._first is None:
            self._first = count
        if count - self._first > self.most:
            self.most, self.when = count - self._first, t

    def notices(self, name: str) -> list[Fault]:
        """Return a note where a surface went through itself (SIM194)."""
        if not self.most:
            return []
        message = f"{name} passed through itself: {counted(self.most, 'pair')} of an "
        message += f"edge and a face, at {plain(self.when)} s, as its self_contact is "
        message += "off"
        hint = "set self_contact with a thickness, such as half an edge"
        return [Fault("SIM194", message, hint=hint, severity=Severity.NOTE)]


def widest_gap(shape: Shape, points: FloatArray) -> float:
    """Return the farthest that particles of a face, or of a curve, are apart [m].

    Particles are at rest at ``(N, 3)`` [m]. Of a face it is the longest of its sides
    and diagonals: what is thinner passes between its corners.
    """
    if isinstance(shape, CurveShape):
        first = np.arange(len(points) - 1)
        inner = np.ones(len(first), bool)
        inner[np.cumsum(shape.counts)[:-1] - 1] = False
        pairs = np.stack([first, first + 1], axis=1)[inner]
    else:
        pairs = _across(shape)
    if not len(pairs):
        return 0.0
    gaps = points[pairs[:, 1]] - points[pairs[:, 0]]
    return float(np.linalg.norm(gaps, axis=1).max())


def _across(shape: FaceShape) -> IntArray:
    """Return pairs of corners of faces, sides and diagonals ``(P, 2)``."""
    pairs = [sides(shape.counts, shape.indices)]
    starts = np.cumsum(shape.counts) - shape.counts
    for skip in range(2, int(shape.counts.max(initial=0)) // 2 + 1):
        many = shape.counts >= 2 * skip
        face = np.repeat(np.arange(len(starts)), shape.counts)
        corner = np.arange(len(shape.indices))
        opposite = starts[face] + (corner - starts[face] + skip) % shape.counts[face]
        two = np.stack([shape.indices[corner], shape.indices[opposite]], axis=1)
        pairs.append(two[many[face]])
    return np.concatenate(pairs)


def thickness(collider: Collider) -> float:
    """Return how thick a collider is across its length [m]; infinite where unknown.

    Of a box it is the second of its sides by length: a plate is met by its face.
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
) -> list[Fault]:
    """Return a warning of colliders that pass between particles (SIM195).

    Particles keep a radius from colliders [m], and are a gap apart at rest [m], which
    becomes longer by the stretch [1]. Faces that meet colliders are stopped; where they
    went through each other they may have done so around the collider.
    """
    wide = gap * (1 + max(stretch, 0.0))
    thin = [
        (thickness(one), one.name or f"colliders[{i}]")
        for i, one in enumerate(colliders)
        if thickness(one) + 2 * radius < wide
    ]
    if not thin:
        return []
    least = min(thin)[0]
    names = ", ".join(which for _, which in thin[:MAX_NAMED])
    more = len(thin) - MAX_NAMED
    names += f" and {more} more" if more > 0 else ""
    message = f"{names}: a collider {length_text(least)} thick is thinner than the gap "
    message += f"between particles of {name}, up to {length_text(wide)} when stretched:"
    if faces:
        message += (
            " its faces are stopped, and what is attached on either side of them may "
        )
        message += "have passed through itself, as its self_contact is off"
        return [warning("SIM195", message, "set self_contact with a thickness")]
    message += " only particles collide, so that it may pass through between them"
    hint = "use more particles, a thicker collider, or a larger radius"
    return [warning("SIM195", message, hint)]
