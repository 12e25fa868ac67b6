"""Faces: landmarks to blend-shape weights, and weights from one face to another."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.core.plugins import lazy_names

if TYPE_CHECKING:
    from animtool.mocap.face.file import load_landmarks as load_landmarks
    from animtool.mocap.face.model import FaceModel as FaceModel
    from animtool.mocap.face.solve import FaceFit as FaceFit
    from animtool.mocap.face.solve import fit_face as fit_face
    from animtool.mocap.face.transfer import transfer_weights as transfer_weights
    from animtool.mocap.options import FaceOptions as FaceOptions

_PUBLIC = {
    "FaceFit": "animtool.mocap.face.solve",
    "FaceModel": "animtool.mocap.face.model",
    "FaceOptions": "animtool.mocap.options",
    "fit_face": "animtool.mocap.face.solve",
    "load_landmarks": "animtool.mocap.face.file",
    "transfer_weights": "animtool.mocap.face.transfer",
}

__all__ = sorted(_PUBLIC)  # noqa: PLE0605 - the table above is the list

if not TYPE_CHECKING:  # type checkers know the names that are imported, and no others
    __getattr__, __dir__ = lazy_names(__name__, _PUBLIC)
