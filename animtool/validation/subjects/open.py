"""Opening a file as what rules look at, by its kind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import cast

from animtool.batch.file import batch_of_document
from animtool.documents.document import Document, read_document
from animtool.documents.versions import STEPS, version_of
from animtool.errors import AnimtoolError, Fault, OptionError
from animtool.files import unreadable
from animtool.plugins import load_object
from animtool.readers import BVH, DOCUMENT, LIVELINK, READERS, USD
from animtool.rules import Kind
from animtool.validation.subjects.subject import Opened


def open_batch(document: Document) -> Opened:
    """Return what a batch file asks for."""
    return Opened(Kind.BATCH, [], batch_of_document(document))


def open_map(document: Document) -> Opened:
    """Return a map file; which skeletons it is for, it does not say."""
    from animtool.mocap.retarget.file import map_of_document  # loads the kernels

    return Opened(Kind.MAP, [], map_of_document(document))


def open_landmarks(document: Document) -> Opened:
    """Return a landmarks file, on its rig where it names one."""
    from animtool.mocap.face.file import face_model, landmarks_of_document
    from animtool.rig.skeleton import Rig

    file = landmarks_of_document(document)
    if file.rig is not None:
        face_model(file, Rig.load(file.rig))
    return Opened(Kind.LANDMARKS, [], file)


def open_remap(document: Document) -> Opened:
    """Return a remap file; which faces it is for, it does not say."""
    from animtool.rig.remap import remap_of_document

    return Opened(Kind.REMAP, [], remap_of_document(document))


def open_cameras(document: Document) -> Opened:
    """Return a camera file."""
    from animtool.mocap.cameras.file import cameras_of_document

    return Opened(Kind.CAMERAS, [], cameras_of_document(document))


_DOCUMENTS = {kind for kind in Kind if kind in STEPS}
# How names end of the files that a folder is searched for.
DOCUMENT_SUFFIXES = tuple(
    f".{kind}{suffix}"
    for kind in sorted(_DOCUMENTS)
    for suffix, reader in READERS.items()
    if reader is DOCUMENT
)
SUFFIXES = (
    *(suffix for suffix, reader in READERS.items() if reader in (BVH, USD)),
    *DOCUMENT_SUFFIXES,
)
_OPENERS = {
    Kind.BATCH: "animtool.validation.subjects.open:open_batch",
    Kind.RIG: "animtool.validation.subjects.rig:open_rig",
    Kind.CLIP: "animtool.validation.subjects.clip:open_clip_document",
    Kind.SCENE: "animtool.validation.subjects.scene:open_scene",
    Kind.TARGETS: "animtool.validation.subjects.targets:open_targets",
    Kind.MAP: "animtool.validation.subjects.open:open_map",
    Kind.LANDMARKS: "animtool.validation.subjects.open:open_landmarks",
    Kind.REMAP: "animtool.validation.subjects.open:open_remap",
    Kind.LIVELINK: "animtool.validation.subjects.capture:open_livelink",
    Kind.CAMERAS: "animtool.validation.subjects.open:open_cameras",
    Kind.BVH: "animtool.validation.subjects.capture:open_bvh",
    Kind.USD: "animtool.validation.subjects.capture:open_usd",
}


def open_file(path: Path) -> Opened:
    """Return a file as rules look at it, with every fault of its reader."""
    reader = READERS.get(path.suffix.lower())
    if reader is BVH or reader is USD:
        return _open(Kind.BVH if reader is BVH else Kind.USD, path)
    if reader is LIVELINK:
        return _open(Kind.LIVELINK, path)
    if reader is None and not path.exists():
        raise unreadable(path, "does not exist")
    if reader is not DOCUMENT:
        hint = f"checked are {', '.join(READERS)}"
        message = "is of no kind that is checked"
        raise OptionError(Fault("IO002", message, str(path), (), hint))
    return open_document(read_document(path))


def open_document(document: Document) -> Opened:
    """Return a file that a person wrote as rules look at it, as `open_file` does."""
    kind = Kind(version_of(document, STEPS)[0])
    opened = _open(kind, document)
    opened.document = document
    return opened


def _open(kind: Kind, what: object) -> Opened:
    opener = cast(Callable[[object], Opened], load_object(_OPENERS[kind]))
    try:
        return opener(what)
    except AnimtoolError as error:
        return Opened(kind, list(error.faults))
