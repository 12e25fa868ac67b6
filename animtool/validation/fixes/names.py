"""Renames entries with names that are illegal or equal in USD, and their references."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from animtool.core.config import project_roots
from animtool.core.errors import AnimtoolError, Fault, FormatError, counted, listed
from animtool.core.files.reading import matching_files
from animtool.core.names import unused_name
from animtool.core.readers import READERS, RIG_AND_CLIP_FILES
from animtool.documents.document import (
    Location,
    parse_document,
    read_document,
    read_text,
)
from animtool.documents.edit import Edit, Rename, Replace
from animtool.rig.drivers import renamed_coordinates, split_coordinate
from animtool.rig.expressions import parse_expression
from animtool.rig.joints import DRIVEN_PARTS, split_part
from animtool.validation.fixes.draft import FixEdits, NotFixedError
from animtool.validation.fixes.texts import pointer_of
from animtool.validation.rules.rig_parts import group_names, legal_usd_name
from animtool.validation.subjects.open import DOCUMENT_SUFFIXES
from animtool.validation.subjects.rig import RigSubject
from animtool.validation.subjects.subject import CheckedFile


def files_using_names(rig: Path, names: Sequence[str]) -> Iterator[tuple[Path, str]]:
    """Yield the files that use a name of a rig, each with the first name found.

    A use is a key or value that is or contains the name, such as
    ``joint/NAME.rotation``, but not words in comments and texts. Rigs with separate
    joints, and files for these, are skipped.
    """
    rig_path = rig.resolve()
    for path in _other_documents(rig):
        if path.resolve() == rig_path:
            continue
        try:
            text = read_text(path)
        except FormatError:
            continue
        if not any(name in text for name in names):
            continue
        used_name = _used_name(path, text, rig_path, names)
        if used_name is not None:
            yield path, used_name


def _used_name(path: Path, text: str, rig: Path, names: Sequence[str]) -> str | None:
    """Return the first of a rig's names that a file uses; None if it uses none."""
    try:
        content = parse_document(text, path).value
    except AnimtoolError:
        # A file that cannot be parsed may use any name in it.
        return next(name for name in names if name in text)
    if not _may_refer_to(path, content, rig):
        return None
    texts = list(_keys_and_texts(content))
    return next((name for name in names if _is_used(name, texts)), None)


def _is_used(name: str, texts: Sequence[str]) -> bool:
    """Return whether a name occurs in a key or value, or as a part of one."""
    pattern = re.compile(rf"(?:^|[/\[#,]){re.escape(name)}(?:$|[/.\]#,])")
    return any(pattern.search(text) for text in texts)


def _keys_and_texts(value: Any) -> Iterator[str]:
    """Yield every key and every text value of a document."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for key, child in value.items():
            yield str(key)
            yield from _keys_and_texts(child)
    elif isinstance(value, list):
        for child in value:
            yield from _keys_and_texts(child)


def _other_documents(rig: Path) -> Iterator[Path]:
    for root in project_roots(rig):
        for file in matching_files(str(root), DOCUMENT_SUFFIXES):
            yield file.path


def _may_refer_to(path: Path, content: Mapping[str, Any], rig: Path) -> bool:
    """Return whether the names in a file may refer to a given rig."""
    rig_name = content.get("rig")
    if not isinstance(rig_name, str):
        return True
    if rig_name.startswith("animtool/"):
        return "from" in content
    return _is_same_rig((path.parent / rig_name).resolve(), rig)


def _is_same_rig(other_path: Path, rig: Path) -> bool:
    """Return whether a path is the rig file, or a sidecar file that may refer to it."""
    if other_path == rig:
        return True
    if READERS.get(other_path.suffix.lower()) is not RIG_AND_CLIP_FILES:
        return False
    try:
        return "from" in read_document(other_path).value
    except AnimtoolError:
        return True


# Locations of names in a rig file; * is every entry, {} every key.
NAME_PATHS = {
    "joints": (
        *("joints/*/name", "joints/*/parent", "joints/*/mirror"),
        *("joints/*/mimic/joint", "bind/{}", "meshes/*/skin/joints/*"),
        *("controls/*/drives/*/joint", "ik/*/root", "ik/*/tip", "attach/*/joints/*"),
        *("attach/*/joint", "colliders/*/joint", "masses/*/joint"),
        *("joints/*/driven/by", "shapes/*/driven/by", "controls/*/driven/by"),
    ),
    "meshes": ("meshes/*/name", "shapes/*/mesh", "attach/*/mesh"),
    "shapes": ("shapes/*/name", "shapes/*/combine/*", "controls/*/drives/*/shape"),
}
# Expressions that read joints.
EXPRESSION_PATHS = (
    "joints/*/driven/expr",
    "shapes/*/driven/expr",
    "controls/*/driven/expr",
)
# List names in the locations of `ignore`.
_LIST_NAMES = {
    "joints": ("joints", "colliders", "masses"),
    "meshes": ("meshes",),
    "shapes": ("shapes",),
}


def make_names_legal(checked_file: CheckedFile, fault: Fault) -> FixEdits:
    """Return edits that rename the illegal USD names of a list and all references."""
    rig = _complete_rig(checked_file)
    list_key = str(pointer_of(fault)[0])
    return _rename_entries(rig, list_key, _illegal_names(group_names(rig, list_key)))


def _illegal_names(names: Sequence[str]) -> list[str]:
    return [name for name in names if legal_usd_name(name) != name]


def make_name_unique(checked_file: CheckedFile, fault: Fault) -> FixEdits:
    """Return edits that rename one of two entries whose names are equal in USD.

    Renames the one that USD does not allow, or else the second.
    """
    rig = _complete_rig(checked_file)
    list_key, entry_index = pointer_of(fault)[:2]
    named_entry = rig.file_entries(str(list_key))[entry_index]
    names = group_names(rig, list_key)
    for name in (named_entry["name"], named_entry.get("mirror")):
        usd_name = legal_usd_name(name) if name else None
        equal_names = [
            other_name for other_name in names if legal_usd_name(other_name) == usd_name
        ]
        if len(equal_names) > 1:
            illegal_names = _illegal_names(equal_names)
            return _rename_entries(rig, str(list_key), illegal_names[-1:])
    raise NotFixedError(f"renames {named_entry['name']!r} to make it unique")


def _complete_rig(checked_file: CheckedFile) -> RigSubject:
    rig: RigSubject = checked_file.subject
    if "from" in rig.document.value:
        raise NotFixedError("the names are in another file")
    return rig


def _rename_entries(rig: RigSubject, list_key: str, old_names: list[str]) -> FixEdits:
    for path, name in files_using_names(rig.document.path, old_names):
        raise NotFixedError(f"{path.name} also uses {name!r}")
    new_names = _unused_names(old_names, group_names(rig, list_key))
    renamings = [f"{name!r} to {new_names[name]!r}" for name in old_names]
    count_text = counted(len(old_names), "name")
    remedy = f"renames {count_text} of {list_key}: {listed(renamings, 3)}"
    return FixEdits(
        remedy, tuple(rename_edits(rig.document.value, list_key, new_names))
    )


def _unused_names(old_names: list[str], existing_names: list[str]) -> dict[str, str]:
    """Return a unique, legal USD name for each old name."""
    new_names: dict[str, str] = {}
    legal_names = (
        legal_usd_name(name) for name in existing_names if name not in old_names
    )
    other_names = {*existing_names, *legal_names}
    for name in old_names:
        used_names = {*other_names, *new_names.values()}
        new_names[name] = unused_name(legal_usd_name(name), used_names)
    return new_names


def rename_edits(
    content: Mapping[str, Any], list_key: str, new_names: Mapping[str, str]
) -> Iterator[Edit]:
    """Yield the edits that rename list entries and all references to them in a rig."""
    for path_pattern in NAME_PATHS[list_key]:
        for value_path, name in _names_at(content, tuple(path_pattern.split("/")), ()):
            if path_pattern.endswith("{}"):
                if name in new_names:
                    yield Rename(value_path, new_names[name])
                continue
            joint, coordinate = name, ""
            if path_pattern.endswith("drives/*/joint"):
                joint, coordinate = split_part(name, DRIVEN_PARTS)
            elif path_pattern.endswith("driven/by"):
                joint, coordinate = split_coordinate(name)
            if joint in new_names:
                suffix = f".{coordinate}" if coordinate else ""
                yield Replace(value_path, f"{new_names[joint]}{suffix}")
    if list_key == "joints":
        yield from _expression_edits(content, new_names)
    for value_path, ignore_location in _names_at(content, ("ignore", "*", "where"), ()):
        location = ignore_location
        for old_name, new_name in new_names.items():
            list_pattern = "|".join(_LIST_NAMES[list_key])
            location = re.sub(
                rf"\b({list_pattern})\[{re.escape(old_name)}\]",
                rf"\1[{new_name}]",
                location,
            )
        if location != ignore_location:
            yield Replace(value_path, location)


def _expression_edits(
    content: Mapping[str, Any], new_names: Mapping[str, str]
) -> Iterator[Edit]:
    """Yield the edits that rename joints in driver expressions."""
    for path_pattern in EXPRESSION_PATHS:
        for location, text in _names_at(content, tuple(path_pattern.split("/")), ()):
            expression = parse_expression(text, allows_coordinates=True)
            new_inputs = renamed_coordinates(expression.names, new_names)
            new_expression = expression.with_renamed_inputs(new_inputs)
            if new_expression != expression:
                yield Replace(location, new_expression.text)


def _names_at(
    node: Any, path_steps: tuple[str, ...], location: Location
) -> Iterator[tuple[Location, str]]:
    """Yield the names at a path of `NAME_PATHS`, and their locations."""
    if not path_steps:
        if isinstance(node, str):
            yield location, node
        return
    step, *later_steps = path_steps
    if step == "{}":
        for key in node if isinstance(node, dict) else ():
            yield (*location, key), key
    elif step == "*":
        for i, entry in enumerate(node if isinstance(node, list) else ()):
            yield from _names_at(entry, tuple(later_steps), (*location, i))
    elif isinstance(node, dict) and step in node:
        yield from _names_at(node[step], tuple(later_steps), (*location, step))
