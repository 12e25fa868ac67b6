"""Checks that arguments of public functions are loaded objects and not their paths."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from os import PathLike
from pathlib import Path

# How each class is loaded from a file.
_LOADERS = {
    "BatchSpec": "load_batch({})",
    "Clip": "Clip.load({})",
    "Rig": "Rig.load({})",
    "TargetTracks": "load_targets({}, rig)",
    "Take": "open_source({}).collect()",
}
# How a value of another class, named {0}, becomes one of a class.
_CONVERSIONS = {
    ("Problem", "Rig"): "build({0}, goals)",
    ("Targets", "list"): "Targets(positions={0})",
    ("Targets", "ndarray"): "Targets(positions={0})",
    ("Targets", "TargetTracks"): "solve_take(take, {0})",
    ("TargetTracks", "Targets"): "solve(problem, None, {0})",
    ("IkResult", "Problem"): "solve({0}, None, targets)",
}


def check_loaded(value: object, expected_class: type, name: str) -> None:
    """Raise `TypeError` if an argument is not of a class; name what loads it.

    >>> from animtool.rig.skeleton import Rig
    >>> check_loaded("biped.rig.yaml", Rig, "rig")
    Traceback (most recent call last):
    TypeError: rig is a path, not a Rig; write Rig.load('biped.rig.yaml')
    """
    if isinstance(value, expected_class):
        return
    class_name, type_name = expected_class.__name__, type(value).__name__
    value_text, remedy = _with_article(type_name), ""
    loader = _LOADERS.get(class_name, "")
    if value is None:
        value_text = "None"
    if isinstance(value, str) and class_name == "Goal":
        remedy = f"Goal({value!r})"
        value_text = "text"
    elif isinstance(value, str | Path):
        value_text = "a path"
        remedy = loader.format(repr(str(value)))
    elif conversion := _CONVERSIONS.get((class_name, type_name)):
        remedy = conversion.format(name)
    elif class_name == "Take" and hasattr(value, "collect"):
        remedy = f"{name}.collect()"
    elif class_name == "Take" and type_name == "Clip":
        remedy = f"{name}.sample(rig)"
    elif class_name.endswith("Options") and isinstance(value, Mapping):
        remedy = f"{class_name}(**{name})"
    elif isinstance(getattr(value, class_name.lower(), None), expected_class):
        remedy = f"{name}.{class_name.lower()}"
    hint = f"; write {remedy}" if remedy else ""
    expected_text = _with_article(class_name)
    raise TypeError(f"{name} is {value_text}, not {expected_text}{hint}")


def path_list(paths: object, name: str) -> list[Path]:
    """Return one path or several as a list; raise `TypeError` for other values.

    >>> [path.name for path in path_list("walk.bvh", "files")]
    ['walk.bvh']
    """
    if isinstance(paths, str | PathLike):
        return [Path(paths)]
    if not isinstance(paths, Iterable):
        text = _with_article(type(paths).__name__)
        raise TypeError(f"{name} is {text}, not a path of a file")
    path_entries: list[Path] = []
    for entry in paths:
        if not isinstance(entry, str | PathLike):
            text = _with_article(type(entry).__name__)
            raise TypeError(f"{name} contains {text}, not only paths of files")
        path_entries.append(Path(entry))
    return path_entries


def _with_article(noun: str) -> str:
    return f"{'an' if noun[:1] in 'AEIOUaeiou' else 'a'} {noun}"
