"""Versions of the file formats, and the migration steps between them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from animtool.core.arguments import flag
from animtool.core.errors import Fault, FormatError, OptionError, excerpt
from animtool.core.files.signatures import DOCUMENT_DESCRIPTION, format_mismatch
from animtool.core.names import FILE_KINDS, kind_of_name

if TYPE_CHECKING:
    from animtool.documents.document import Document, Location

# A step converts a file's values to the next version.
MigrationStep = Callable[[dict[str, Any]], dict[str, Any]]
MigrationSteps = Mapping[int, MigrationStep]

# Migration steps by kind and source version.
MIGRATION_STEPS: dict[str, dict[int, MigrationStep]] = {kind: {} for kind in FILE_KINDS}
# Models by kind of file, or functions that return one.
FILE_MODELS = {
    "batch": "animtool.batch.schema:BatchModel",
    "cameras": "animtool.capture.cameras.file:CamerasModel",
    "clip": "animtool.clip.schema:ClipModel",
    "landmarks": "animtool.capture.face.file:LandmarksModel",
    "map": "animtool.retarget.file:MapModel",
    "markers": "animtool.capture.templates.file:MarkersModel",
    "remap": "animtool.rig.remap:RemapModel",
    "rig": "animtool.rig.schema:RigModel",
    "scene": "animtool.scene.file.schema:full_model",
    "targets": "animtool.ik.schema:TargetsModel",
}
# Keys renamed within a version, by kind and location; None is any entry of a list. The
# old name is still read.
RENAMED_KEYS: dict[str, dict[tuple[str | None, ...], str]] = {
    "scene": {
        ("beside",): "props",
        ("passes", None, "simulate", "colliders"): "capsules",
        ("passes", None, "simulate", "damping"): "ratio",
        ("passes", None, "simulate", "shear"): "diagonals",
        ("systems", None, "particles", "most"): "max_particles",
    }
}
# Reused names: an old name only if its value has this type.
_OLD_KEY_TYPES: dict[tuple[str | None, ...], type] = {
    ("passes", None, "simulate", "colliders"): bool
}
# Hints for files passed instead of a clip, by their kind.
_WRONG_KIND_HINTS = {
    "batch": "animtool batch runs it",
    "cameras": f"animtool mocap triangulate takes it with {flag('cameras')}",
    "clip": "animtool bake bakes it, and Clip.load of Python reads it",
    "landmarks": f"animtool mocap face takes it with {flag('landmarks')}",
    "map": f"animtool retarget takes it with {flag('map')}",
    "markers": f"animtool mocap solve takes it with {flag('template')}",
    "remap": f"animtool mocap face takes it with {flag('remap')}",
    "rig": f"animtool bake CLIP takes it with {flag('rig')}, animtool validate "
    "checks it, animtool convert writes it as USD",
    "scene": "animtool bake bakes it",
    "targets": f"animtool ik takes it with {flag('targets')}",
}

_VERSION = re.compile(r"animtool/(0|[1-9][0-9]{0,8})")


def newest_version_of(steps: MigrationSteps) -> int:
    """Return the version that the last migration step of a format produces.

    >>> newest_version_of({}), newest_version_of({1: dict, 2: dict})
    (1, 3)
    """
    return max(steps, default=0) + 1


def renamed_key(kind: str, location: Location, value: object) -> str | None:
    """Return the new name of a renamed key; None if the key was not renamed.

    >>> renamed_key("scene", ("systems", 2, "particles", "most"), 100)
    'max_particles'
    """
    steps = tuple(step if isinstance(step, str) else None for step in location)
    if not isinstance(value, _OLD_KEY_TYPES.get(steps, object)):
        return None
    return RENAMED_KEYS.get(kind, {}).get(steps)


def renamed_keys(
    kind: str, value: Any, parent: Location = ()
) -> Iterator[tuple[Location, str]]:
    """Yield the location and the new name of each renamed key."""
    steps = enumerate(value) if isinstance(value, list) else ()
    for step, child in value.items() if isinstance(value, dict) else steps:
        location = (*parent, step)
        name = renamed_key(kind, location, child)
        if name is not None and name not in value:
            yield location, name
        yield from renamed_keys(kind, child, location)


def _wrong_kind_hint(kind: str | None, file_kind: str) -> str:
    """Return a hint for a file of one kind where another kind is expected."""
    if (kind, file_kind) == ("markers", "rig"):
        hint = f"it is a rig file: pass it with {flag('rig')}; "
        return f"{hint}a template ends in .markers.yaml"
    if (kind, file_kind) == ("targets", "clip"):
        hint = f"it is a clip file: animtool ik takes it with {flag('clip')}, and "
        return f"{hint}with {flag('match')} writes targets from it"
    description = "marker template" if file_kind == "markers" else f"{file_kind} file"
    hint = f"it looks like a {description}; {_WRONG_KIND_HINTS[file_kind]}"
    if kind == "cameras":
        hint += "; cameras end in .cameras.yaml"
    elif kind == "clip":
        hint += "; a take is a clip, BVH, glTF, FBX or USD file"
    return hint


@contextmanager
def file_of_kind(path: Path, kind: str, key: str) -> Iterator[None]:
    """Raise a fault about a key if the file that it names is of another kind (DOC009).

    >>> with file_of_kind(Path("a.targets.yaml"), "targets", "targets"):
    ...     pass
    """
    try:
        yield
    except FormatError as error:
        file_kind = kind_of_name(path, "")
        if error.code != "DOC009" or file_kind in {"", kind}:
            raise
        message = f"{path.name} is not a {kind} file, but a {file_kind} file"
        hint = f"name a file that ends in .{kind}.yaml"
        raise OptionError(Fault("DOC009", message, hint=hint, where=key)) from error


def kind_and_version(
    document: Document,
    table: Mapping[str, MigrationSteps] = MIGRATION_STEPS,
    kind: str | None = None,
) -> tuple[str, int]:
    """Return the kind of a document, such as ``rig``, and its version number.

    Args:
        document: A file.
        table: Migration steps between versions, by kind.
        kind: Expected kind; None allows every kind in the table.
    """
    kinds_in_file = [name for name in FILE_KINDS if name in document.value]
    path_kind = kind_of_name(document.path, "")
    if kind is None and path_kind in table and path_kind not in kinds_in_file:
        kind = path_kind
    named_kind = kind or next((name for name in kinds_in_file if name in table), "")
    if named_kind not in kinds_in_file or _is_other_kind(
        document, named_kind, kinds_in_file[0]
    ):
        format_fault = format_mismatch("DOC009", document.path, DOCUMENT_DESCRIPTION)
        if format_fault is not None:
            raise FormatError(format_fault)
        message = "the first line is missing"
        expected_kind = kind_of_name(document.path, kind or "rig")
        hint = f"write `{expected_kind}: animtool/1` above line 1"
        if kind is None and not path_kind and not kinds_in_file:
            message = "is not an animtool file: no key names its kind"
            hint = "such files end in .rig.yaml, .clip.yaml or .scene.yaml"
        # A clip and a scene name their rig.
        is_rig_named = kind == path_kind and kinds_in_file == ["rig"]
        if kinds_in_file and not is_rig_named:
            message = f"is not a {kind or ' or '.join(table)} file"
            hint = _wrong_kind_hint(kind, kinds_in_file[0])
            if kinds_in_file[0] == "scene" != path_kind:
                hint += "; end its name in .scene.yaml"
        document.add("DOC009", (), message, hint)
        document.check()
    newest_version = newest_version_of(table[named_kind])
    file_version = document.value[named_kind]
    version_match = (
        _VERSION.fullmatch(file_version) if isinstance(file_version, str) else None
    )
    version = int(version_match[1]) if version_match else newest_version + 1
    if version <= newest_version and all(
        step_version in table[named_kind]
        for step_version in range(version, newest_version)
    ):
        return named_kind, version
    if isinstance(file_version, str) and file_version.startswith("animtool/"):
        message = f"unknown version {file_version}"
        is_newer = version_match is not None and version > newest_version
        hint = (
            f"this version reads up to animtool/{newest_version}: update animtool"
            if is_newer
            else f"allowed: animtool/{newest_version}"
        )
        document.add("DOC012", (named_kind,), message, hint)
    else:
        message = f"{named_kind} is {excerpt(str(file_version))}"
        hint = f"write {named_kind}: animtool/{newest_version}"
        document.add("DOC009", (named_kind,), message, hint)
    document.check()
    raise AssertionError(file_version)


def _is_other_kind(document: Document, kind: str, first_kind: str) -> bool:
    """Return whether a document is of another kind and only refers to this kind."""
    version_text = document.value[kind]
    is_version = isinstance(version_text, str) and version_text.startswith("animtool/")
    return first_kind != kind and not is_version
