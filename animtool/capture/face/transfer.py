"""Transfer of weights between faces with different shapes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from animtool.capture.face.fit import FaceFit
from animtool.capture.face.model import FaceModel, rms_spread
from animtool.capture.face.solve import fit_face
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError, Severity, names_fault, refuse
from animtool.core.record import dataclass
from animtool.rig.remap import RemapFile, ShapeLinks, link_shapes

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, slots=True)
class TransferredWeights:
    """Weights transferred to another face, and how their shapes were matched."""

    weights: FloatArray  # weights of the target's shapes ``(F, S)``
    links: ShapeLinks  # source shapes of each target shape, by name
    # Fit to the target's landmarks, if they were used; else None.
    fit: FaceFit | None = None
    notices: tuple[Fault, ...] = ()  # shapes without a counterpart


def transfer_weights(
    weights: FloatArray,
    source: Sequence[str],
    target: Sequence[str],
    *,
    remap: RemapFile | None = None,
    faces: tuple[FaceModel, FaceModel] | None = None,
    fps: float = 60.0,
    smooth: float = 0.0,
) -> TransferredWeights:
    """Transfer a face's weights to a face with different shapes.

    Shapes are matched by name, in any of ARKit's spellings, and by a remap file; or by
    landmarks that both faces have: the target weights whose landmarks move like the
    source's, scaled by the sizes of the faces.

    Args:
        weights: Weights of the source's shapes ``(F, S)``.
        source: Names of the source's shapes.
        target: Names of the target's shapes.
        remap: Shape names of one face by those of the other.
        faces: Source and target face with landmarks, for a fit; None matches by name.
        fps: Frames a second, for a fit.
        smooth: Smoothness, as in `fit_face`.

    Raises:
        FormatError: The remap file names an unknown shape (FAC001).
        OptionError: No shape has a counterpart (FAC009), or the faces have fewer than
            four landmarks in common (FAC004).

    >>> made = transfer_weights(np.array([[0.5]]), ["EyeBlink_L"], ["eyeBlinkLeft"])
    >>> made.weights.tolist()
    [[0.5]]
    """
    links = link_shapes(source, target, remap)
    if faces is None:
        return _transfer_by_name(weights, links, source, len(target))
    points = _target_landmarks(weights, source, *faces)
    fit = fit_face(faces[1], points, fps, smooth=smooth)
    target_weights = np.zeros((len(weights), len(target)))
    for i, name in enumerate(faces[1].shapes):
        if name in set(target):
            target_weights[:, list(target).index(name)] = fit.weights[:, i]
    return TransferredWeights(target_weights, links, fit, fit.notices)


def _transfer_by_name(
    weights: FloatArray, links: ShapeLinks, source: Sequence[str], target_count: int
) -> TransferredWeights:
    """Copy weights to linked shapes; warn about unlinked moving shapes (FAC108)."""
    if not links.links:
        message = "no shape of the source has its name in the target"
        hint = "pair them in a remap file"
        raise OptionError(Fault("FAC009", message, hint=hint))
    has_motion = np.abs(weights).max(axis=0, initial=0) > 0
    is_moving = dict(zip(source, has_motion.tolist(), strict=True))
    unlinked_names = [name for name in links.unlinked if is_moving[name]]
    notices = []
    if unlinked_names:
        message = f"{len(unlinked_names)} shapes that move are not in the target: "
        warning = Severity.WARNING
        notices.append(names_fault("FAC108", message, unlinked_names, severity=warning))
    linked_weights = links.apply(weights, target_count)
    return TransferredWeights(linked_weights, links, None, tuple(notices))


def _target_landmarks(
    weights: FloatArray,
    source: Sequence[str],
    source_face: FaceModel,
    target_face: FaceModel,
) -> FloatArray:
    """Return the target's landmarks, displaced like the source's ``(F, N, 3)``.

    Displacements are scaled by the sizes of the faces; landmarks that the source lacks
    are NaN.
    """
    shared_names = [
        name for name in target_face.names if name in set(source_face.names)
    ]
    if len(shared_names) < 4:
        refuse("FAC004", f"the faces share {len(shared_names)} landmarks; 4 are needed")
    column_by_shape = {name: i for i, name in enumerate(source)}
    source_weights = np.stack(
        [
            weights[:, column_by_shape[name]]
            if name in column_by_shape
            else np.zeros(len(weights))
            for name in source_face.shapes
        ],
        axis=-1,
    )
    source_indices = [source_face.names.index(name) for name in shared_names]
    displacements = source_face.points(source_weights) - source_face.neutral
    target_indices = [target_face.names.index(name) for name in shared_names]
    neutral = target_face.neutral[target_indices]
    scale = rms_spread(neutral) / max(
        rms_spread(source_face.neutral[source_indices]), 1e-300
    )
    points = np.full((len(weights), len(target_face.names), 3), np.nan)
    points[:, target_indices] = neutral + scale * displacements[:, source_indices]
    return points
