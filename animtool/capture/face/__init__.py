"""Faces: landmarks to blend-shape weights, and weights between faces."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.core.plugins import lazy_names

if TYPE_CHECKING:
    from animtool.capture.face.file import load_landmarks as load_landmarks
    from animtool.capture.face.fit import FaceFit as FaceFit
    from animtool.capture.face.model import FaceModel as FaceModel
    from animtool.capture.face.solve import fit_face as fit_face
    from animtool.capture.face.transfer import transfer_weights as transfer_weights
    from animtool.capture.options import FaceOptions as FaceOptions

_PUBLIC = {
    "FaceFit": "animtool.capture.face.fit",
    "FaceModel": "animtool.capture.face.model",
    "FaceOptions": "animtool.capture.options",
    "fit_face": "animtool.capture.face.solve",
    "load_landmarks": "animtool.capture.face.file",
    "transfer_weights": "animtool.capture.face.transfer",
}

__all__ = sorted(_PUBLIC)  # noqa: PLE0605 - the table above is the list

if not TYPE_CHECKING:  # type checkers know the names that are imported, and no others
    __getattr__, __dir__ = lazy_names(__name__, _PUBLIC)
