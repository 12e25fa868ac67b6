"""Weights of one face as weights of a face with other shapes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from animtool.capture.face.model import FaceModel
from animtool.capture.face.solve import FaceFit, fit_face
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError, Severity, naming
from animtool.core.record import dataclass
from animtool.rig.remap import RemapFile, ShapeLinks, link_shapes

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, slots=True)
class TransferredWeights:
    """Weights on another face.

    Attributes:
        weights: Of the target's shapes ``(F, S)``.
        links: Source shapes of each target shape, by name.
        fit: Fit of its landmarks, if they were used; else None.
        notices: Shapes without a counterpart.
    """

    weights: FloatArray
    links: ShapeLinks
    fit: FaceFit | None = None
    notices: tuple[Fault, ...] = ()


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
    """Return a face's weights as weights of another face.

    By name, in any of ARKit's spellings, and a remap file; or by landmarks that both
    faces have: the target weights whose landmarks move as the source's do, scaled by
    the sizes of the faces.

    Args:
        weights: Of the source's shapes ``(F, S)``.
        source: Names of the source's shapes.
        target: Names of the target's shapes.
        remap: Names of one as those of the other.
        faces: Source and target with landmarks, for a fit; None goes by name.
        fps: Frames a second, for a fit.
        smooth: As `fit_face` takes it.

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
        if not links.links:
            message = "no shape of the source has its name in the target"
            hint = "pair them in a remap file"
            raise OptionError(Fault("FAC009", message, hint=hint))
        moves = np.abs(weights).max(axis=0, initial=0) > 0
        kept = {name for name, m in zip(source, moves.tolist(), strict=True) if m}
        lost = [name for name in links.lost if name in kept]
        notices = []
        if lost:
            message = f"{len(lost)} shapes that move are not in the target: "
            notices.append(naming("FAC108", message, lost, severity=Severity.WARNING))
        linked = links.apply(weights, len(target))
        return TransferredWeights(linked, links, None, tuple(notices))
    ours, theirs = faces
    shared = [name for name in theirs.names if name in set(ours.names)]
    if len(shared) < 4:
        message = f"the faces share {len(shared)} landmarks; 4 are needed"
        raise OptionError(Fault("FAC004", message))
    columns = {name: i for i, name in enumerate(source)}
    offsets = np.stack(
        [
            weights[:, columns[name]] if name in columns else np.zeros(len(weights))
            for name in ours.shapes
        ],
        axis=-1,
    )
    indices = [ours.names.index(name) for name in shared]
    linked = (ours.points(offsets) - ours.neutral)[:, indices]
    at = [theirs.names.index(name) for name in shared]
    size = FaceModel(tuple(shared), (), theirs.neutral[at], np.zeros((0, len(at), 3)))
    scale = size.size / max(_size(ours.neutral[indices]), 1e-300)
    points = np.full((len(weights), len(theirs.names), 3), np.nan)
    points[:, at] = theirs.neutral[at] + scale * linked
    fit = fit_face(theirs, points, fps, smooth=smooth)
    solved = np.zeros((len(weights), len(target)))
    for i, name in enumerate(theirs.shapes):
        if name in set(target):
            solved[:, list(target).index(name)] = fit.weights[:, i]
    return TransferredWeights(solved, links, fit, fit.notices)


def _size(points: FloatArray) -> float:
    away = points - points.mean(axis=0)
    return float(np.sqrt((away * away).sum(axis=1).mean()))
