"""Opens files of every kind as subjects."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, cast

from animtool.core.errors import AnimtoolError, Fault, OptionError
from animtool.core.files.reading import unreadable_error
from animtool.core.names import has_kind_suffix
from animtool.core.plugins import load_object
from animtool.core.readers import (
    BVH,
    C3D,
    EXPORT_HINTS,
    FBX,
    GLTF,
    LIVELINK,
    MARKER_ARRAYS,
    MJCF,
    MOT,
    READERS,
    RIG_AND_CLIP_FILES,
    STO,
    TRC,
    URDF,
    USD,
    export_fault,
    readable_suffixes,
    reader_of,
)
from animtool.core.rules import Kind
from animtool.documents.versions import MIGRATION_STEPS, kind_and_version
from animtool.rig.skeleton import Rig
from animtool.validation.subjects.subject import CheckedFile

if TYPE_CHECKING:
    from animtool.documents.document import Document
    from animtool.documents.variables import SceneValues


def open_batch(document: Document) -> CheckedFile:
    """Read a batch file; report inputs that match no file."""
    from animtool.batch.discover import unused_variable_faults
    from animtool.batch.file import parse_batch
    from animtool.batch.inputs import input_faults

    batch = parse_batch(document)
    faults = [*input_faults(batch, document), *unused_variable_faults(batch)]
    return CheckedFile(Kind.BATCH, faults, batch)


def values_of_batches(paths: Iterable[Path]) -> dict[Path, SceneValues]:
    """Return the variables that batch files set in scenes, by scene path.

    Faults of a batch are reported only for the batch.
    """
    values_by_scene: dict[Path, SceneValues] = {}
    for path in paths:
        if not has_kind_suffix(path, "batch"):
            continue
        from animtool.batch.discover import scene_values
        from animtool.batch.file import load_batch

        try:
            batch_values = scene_values(load_batch(path))
        except AnimtoolError:
            continue
        for scene, values in batch_values.items():
            values_by_scene.setdefault(scene.resolve(), values)
    return values_by_scene


def open_map(document: Document) -> CheckedFile:
    """Read a retarget map; joint names are not checked, as it names no skeletons."""
    from animtool.retarget.file import parse_map_document  # loads the kernels

    return CheckedFile(Kind.MAP, [], parse_map_document(document))


def open_markers(document: Document) -> CheckedFile:
    """Read a marker template; check its joints if it names a rig."""
    from animtool.capture.templates.file import parse_template

    template = parse_template(document)
    faults = list(document.notices)
    if template.rig is not None:
        try:
            template.joints(Rig.load(template.rig))
        except AnimtoolError as error:
            faults += error.faults
    return CheckedFile(Kind.MARKERS, faults, template)


def open_landmarks(document: Document) -> CheckedFile:
    """Read a landmarks file; check meshes and vertices if it names a rig."""
    from animtool.capture.face.file import face_model, parse_landmarks

    file = parse_landmarks(document)
    if file.rig is not None:
        face_model(file, Rig.load(file.rig))
    return CheckedFile(Kind.LANDMARKS, [], file)


def open_remap(document: Document) -> CheckedFile:
    """Read a remap file; shape names are not checked, as it names no faces."""
    from animtool.rig.remap import parse_remap

    return CheckedFile(Kind.REMAP, [], parse_remap(document))


def open_cameras(document: Document) -> CheckedFile:
    """Read cameras of animtool, or a calibration of another program."""
    from animtool.capture.cameras.calibrations import parse_calibration
    from animtool.capture.cameras.file import parse_cameras

    if isinstance(document.value.get("cameras"), str):
        cameras = parse_cameras(document)
    else:
        cameras = parse_calibration(document, None, None)
    return CheckedFile(Kind.CAMERAS, list(document.notices), cameras)


_DOCUMENT_KINDS = {kind for kind in Kind if kind in MIGRATION_STEPS}
# Suffixes of the documents that are found in a folder.
DOCUMENT_SUFFIXES = tuple(
    f".{kind}{suffix}"
    for kind in sorted(_DOCUMENT_KINDS)
    for suffix, reader in READERS.items()
    if reader is RIG_AND_CLIP_FILES
)
_SEARCHED_READERS = (BVH, USD, GLTF, FBX, URDF, C3D, TRC)
INPUT_SUFFIXES = (
    # An npz, a CSV or an XML file may contain anything.
    *(suffix for suffix, reader in READERS.items() if reader in _SEARCHED_READERS),
    *DOCUMENT_SUFFIXES,
)
_OPENER_BY_KIND = {
    Kind.BATCH: "animtool.validation.subjects.open:open_batch",
    Kind.RIG: "animtool.validation.subjects.rig:open_rig",
    Kind.CLIP: "animtool.validation.subjects.clip:open_clip_document",
    Kind.SCENE: "animtool.validation.subjects.scene:open_scene",
    Kind.TARGETS: "animtool.validation.rules.targets:open_targets",
    Kind.MAP: "animtool.validation.subjects.open:open_map",
    Kind.MARKERS: "animtool.validation.subjects.open:open_markers",
    Kind.LANDMARKS: "animtool.validation.subjects.open:open_landmarks",
    Kind.REMAP: "animtool.validation.subjects.open:open_remap",
    Kind.LIVELINK: "animtool.validation.subjects.capture:open_livelink",
    Kind.TAKE: "animtool.validation.subjects.capture:open_take",
    Kind.CAMERAS: "animtool.validation.subjects.open:open_cameras",
    Kind.BVH: "animtool.validation.subjects.capture:open_bvh",
    Kind.USD: "animtool.validation.subjects.capture:open_usd",
    Kind.GLTF: "animtool.validation.subjects.gltf:open_gltf",
    Kind.FBX: "animtool.validation.subjects.fbx:open_fbx",
    Kind.URDF: "animtool.validation.subjects.capture:open_urdf",
    Kind.MJCF: "animtool.validation.subjects.capture:open_mjcf",
    Kind.TRAJECTORIES: "animtool.validation.rules.trajectories:open_trajectories",
    Kind.COORDINATES: "animtool.validation.rules.trajectories:open_coordinates",
}
# Kinds of files that are not written by hand.
_KINDS_BY_READER = {
    BVH: Kind.BVH,
    USD: Kind.USD,
    GLTF: Kind.GLTF,
    FBX: Kind.FBX,
    URDF: Kind.URDF,
    MJCF: Kind.MJCF,
    LIVELINK: Kind.LIVELINK,
    C3D: Kind.TRAJECTORIES,
    TRC: Kind.TRAJECTORIES,
    MARKER_ARRAYS: Kind.TRAJECTORIES,
    MOT: Kind.COORDINATES,
    STO: Kind.COORDINATES,
}


def open_file(path: Path, values: SceneValues | None = None) -> CheckedFile:
    """Read a file of any kind for validation; reader errors become faults.

    ``values``: batch values of the variables of a scene.
    """
    reader = reader_of(path)
    if reader is RIG_AND_CLIP_FILES:
        from animtool.documents.document import read_document

        document = read_document(path)
        if has_kind_suffix(path, "cameras") and not isinstance(
            document.value.get("cameras", ""), str
        ):
            # A list of cameras, as other tools write it.
            return _call_opener(Kind.CAMERAS, document)
        return open_document(document, values)
    if reader is not None:
        return _call_opener(_KINDS_BY_READER.get(reader, Kind.TAKE), path)
    if not path.exists():
        raise unreadable_error(path, "does not exist")
    if path.suffix.lower() in EXPORT_HINTS:
        raise OptionError(export_fault(path))
    hint = f"supported: {', '.join(readable_suffixes())}"
    message = "is not a kind of file that is checked"
    raise OptionError(Fault("IO002", message, str(path), (), hint))


def open_document(document: Document, values: SceneValues | None = None) -> CheckedFile:
    """Read a document of the kind that its version line states; see `open_file`."""
    kind = Kind(kind_and_version(document, MIGRATION_STEPS)[0])
    scene_values = (values,) if kind is Kind.SCENE else ()
    checked_file = _call_opener(kind, document, *scene_values)
    checked_file.document = document
    return checked_file


def _call_opener(kind: Kind, *arguments: object) -> CheckedFile:
    opener = cast(Callable[..., CheckedFile], load_object(_OPENER_BY_KIND[kind]))
    try:
        return opener(*arguments)
    except AnimtoolError as error:
        return CheckedFile(kind, list(error.faults))
