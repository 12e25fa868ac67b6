"""Landmark positions of a face for weights of its shapes."""

from __future__ import annotations

from dataclasses import field, replace
from itertools import compress

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.errors import Fault, OptionError, Severity, names_fault
from animtool.core.record import dataclass
from animtool.maths.faces import rigid_motion
from animtool.maths.so3 import conjugate, rotate
from animtool.rig.parts import Shape
from animtool.rig.shapes import add_combinations
from animtool.skin.shapes import PreparedShapes, blend_points

# Shapes that move landmarks by less than this fraction of the face's size count as
# static.
MIN_LANDMARK_MOTION = 1e-6
# Shapes whose displacements have a cosine above this cannot be distinguished.
MIN_SAME_SHAPE_COSINE = 1 - 1e-9


@dataclass(frozen=True, slots=True)
class FaceModel:
    """Landmarks of a face at rest, and how each blend shape displaces them.

    Attributes:
        names: Names of the landmarks; ``0``, ``1``, … where they have none.
        is_kept: Names of the shapes that have their own weight.
        neutral: Landmarks at rest [m] ``(N, 3)``.
        deltas: Added at weight 1 [m] ``(S, N, 3)``.
        nonlinear_shapes: Shapes whose in-betweens or correctives add to the sum of
            deltas; None if all are linear.

    Raises:
        OptionError: Arrays do not fit together or are not finite (FAC003).
    """

    names: tuple[str, ...]
    shapes: tuple[str, ...]
    neutral: FloatArray
    deltas: FloatArray
    nonlinear_shapes: NonlinearShapes | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        """Check array shapes, finite numbers and unique names (FAC003)."""
        landmark_count, shape_count = len(self.names), len(self.shapes)
        faults = []
        for name, shape in (
            ("neutral", (landmark_count, 3)),
            ("deltas", (shape_count, landmark_count, 3)),
        ):
            values: FloatArray = getattr(self, name)
            if values.shape != shape:
                message = f"{name} must have shape {shape}, not {values.shape}"
                faults.append(Fault("FAC003", message))
            elif not np.isfinite(values).all():
                message = f"{name} contains a value that is not finite"
                faults.append(Fault("FAC003", message))
        for label, names in (("landmarks", self.names), ("shapes", self.shapes)):
            if len(set(names)) < len(names):
                duplicate = next(n for n in names if names.count(n) > 1)
                faults.append(Fault("FAC003", f"two {label} are called {duplicate!r}"))
        if faults:
            raise OptionError(faults)

    @property
    def size(self) -> float:
        """Root mean square distance of landmarks from their mean [m]."""
        return rms_spread(self.neutral)

    def nonlinear_offsets(self, weights: FloatArray) -> FloatArray:
        """Return the offsets due to in-betweens and correctives only ``(F, N, 3)`` [m].

        They are the total displacement minus the linear sum of deltas.
        """
        if self.nonlinear_shapes is None:
            return np.zeros((len(weights), *self.neutral.shape))
        nonlinear_points = self.nonlinear_shapes.points(weights)
        return nonlinear_points - self.neutral - np.tensordot(weights, self.deltas, 1)

    def points(self, weights: FloatArray) -> FloatArray:
        """Return landmarks ``(F, N, 3)`` [m] in head space for weights ``(F, S)``."""
        if self.nonlinear_shapes is not None:
            return self.nonlinear_shapes.points(weights)
        return self.neutral + np.tensordot(weights, self.deltas, 1)

    def shapes_with_motion(self) -> BoolArray:
        """Return a mask of the shapes that move a landmark ``(S,)``."""
        lengths = np.linalg.norm(self.deltas, axis=-1)
        return np.asarray(
            lengths.max(axis=1, initial=0) > MIN_LANDMARK_MOTION * self.size
        )

    def select(self, is_kept: BoolArray) -> FaceModel:
        """Return the model with only the shapes in a mask ``(S,)``."""
        names = tuple(compress(self.shapes, is_kept))
        nonlinear = self.nonlinear_shapes
        if nonlinear is not None:
            nonlinear = nonlinear.select(is_kept)
        return replace(
            self, shapes=names, deltas=self.deltas[is_kept], nonlinear_shapes=nonlinear
        )

    def similar_shapes(self) -> list[tuple[int, int]]:
        """Return index pairs of shapes that move landmarks in the same directions."""
        moving_shapes = np.flatnonzero(self.shapes_with_motion())
        directions = self.deltas[moving_shapes].reshape(len(moving_shapes), -1)
        directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        pairs = np.argwhere(
            np.triu(directions @ directions.T > MIN_SAME_SHAPE_COSINE, 1)
        )
        return [
            (int(moving_shapes[a]), int(moving_shapes[b])) for a, b in pairs.tolist()
        ]

    def notices(self) -> list[Fault]:
        """Return warnings about shapes that landmarks do not show or tell apart."""
        notices = []
        has_motion = self.shapes_with_motion()
        static_names = list(compress(self.shapes, ~has_motion))
        if static_names:
            message = f"{len(static_names)} shapes move no landmark, and stay at 0: "
            notices.append(
                names_fault("FAC101", message, static_names, severity=Severity.WARNING)
            )
        pairs = self.similar_shapes()
        if len(pairs):
            names = [f"{self.shapes[a]} = {self.shapes[b]}" for a, b in pairs]
            message = f"{len(pairs)} pairs of shapes move landmarks in the same "
            message += "direction, and are solved together: "
            notices.append(
                names_fault("FAC102", message, names, severity=Severity.WARNING)
            )
        return notices

    def with_proportions(self, captured_landmarks: FloatArray) -> FaceModel:
        """Return the model with the proportions of a captured neutral face.

        The captured landmarks ``(N, 3)`` [m] are NaN where not visible and keep their
        model position there. Deltas scale with the sizes of the two faces.
        """
        is_visible = np.isfinite(captured_landmarks).all(axis=1)
        scale = rms_spread(captured_landmarks[is_visible]) / rms_spread(
            self.neutral[is_visible]
        )
        rotation, shift = rigid_motion(
            self.neutral[is_visible] * scale, captured_landmarks[is_visible]
        )
        neutral = self.neutral * scale
        neutral[is_visible] = rotate(
            conjugate(rotation), captured_landmarks[is_visible] - shift
        )
        return replace(
            self, neutral=neutral, deltas=self.deltas * scale, nonlinear_shapes=None
        )


@dataclass(frozen=True, slots=True)
class NonlinearShapes:
    """All blend shapes evaluated at landmarks, with in-betweens and correctives."""

    shapes: tuple[Shape, ...]  # of the rig: those that move landmarks or are combined
    prepared_shapes: PreparedShapes  # the shapes that have deltas
    solved_indices: tuple[int, ...]  # index of each solved shape in ``is_kept``

    def points(self, weights: FloatArray) -> FloatArray:
        """Return landmarks ``(F, N, 3)`` [m] for solved shapes' weights ``(F, S)``."""
        weights_by_name = {shape.name: np.zeros(len(weights)) for shape in self.shapes}
        for i, column in zip(self.solved_indices, weights.T, strict=True):
            weights_by_name[self.shapes[i].name] = column
        all_weights = add_combinations(self.shapes, weights_by_name)
        return blend_points(
            self.prepared_shapes,
            np.stack([all_weights[n] for n in self.prepared_shapes.names], axis=-1),
        )

    def select(self, is_kept: BoolArray) -> NonlinearShapes:
        """Return a copy in which only shapes in a mask ``(S,)`` are solved for."""
        return replace(
            self, solved_indices=tuple(compress(self.solved_indices, is_kept))
        )


def rms_spread(points: FloatArray) -> float:
    """Return the root mean square distance of points from their mean."""
    if not len(points):
        return 0.0
    offsets = points - points.mean(axis=0)
    return float(np.sqrt((offsets * offsets).sum(axis=1).mean()))
