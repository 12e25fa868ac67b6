"""Checks that arguments of public functions are loaded objects and not their paths."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

# How each class is loaded from a file.
_LOADERS = {
    "Clip": "Clip.load({})",
    "Rig": "Rig.load({})",
    "Take": "open_source({}).collect()",
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
    article = "an" if type_name[:1] in "AEIOUaeiou" else "a"
    value_text, remedy = f"{article} {type_name}", ""
    loader = _LOADERS.get(class_name, "")
    if value is None:
        value_text = "None"
    if isinstance(value, str | Path):
        value_text = "a path"
        remedy = loader.format(repr(str(value)))
    elif class_name == "Take" and hasattr(value, "collect"):
        remedy = f"{name}.collect()"
    elif class_name == "Take" and type_name == "Clip":
        remedy = f"{name}.sample(rig)"
    elif class_name.endswith("Options") and isinstance(value, Mapping):
        remedy = f"{class_name}(**{name})"
    elif isinstance(getattr(value, class_name.lower(), None), expected_class):
        remedy = f"{name}.{class_name.lower()}"
    hint = f"; write {remedy}" if remedy else ""
    raise TypeError(f"{name} is {value_text}, not a {class_name}{hint}")
