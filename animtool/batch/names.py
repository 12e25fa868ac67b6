"""Names of outputs, made of those of inputs: ``out/{parent}/{stem}.usdc``."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import PurePath
from string import Formatter

from animtool.documents.names import nearest
from animtool.files import FoundFile
from animtool.scene.sources import source_stem

__all__ = ["INPUT_NAMES", "file_pattern", "input_names", "output_root", "unknown_names"]

INPUT_NAMES = ("input", "folder", "name", "parent", "stem")


def input_names(found: FoundFile) -> dict[str, str]:
    """Return what the names stand for that every input has.

    ``input`` is its path and ``folder`` that of its folder, ``name`` its name, ``stem``
    that without what says its kind, and ``parent`` the folders between the one that
    was searched and it.

    >>> from pathlib import Path
    >>> names = input_names(FoundFile(Path("takes/a/walk.clip.yaml"), Path("takes")))
    >>> names["name"], names["parent"], names["stem"]
    ('walk.clip.yaml', 'a', 'walk')
    """
    path = found.path
    return {
        "input": path.absolute().as_posix(),
        "folder": path.parent.absolute().as_posix(),
        "name": path.name,
        "parent": path.parent.relative_to(found.base).as_posix(),
        "stem": source_stem(path),
    }


def file_pattern(pattern: str, name: str) -> str:
    """Return the pattern of files that a pattern stands for, which may name a folder.

    >>> file_pattern("out/", "{parent}/{stem}"), file_pattern("{stem}.usda", "{stem}")
    ('out/{parent}/{stem}.usdc', '{stem}.usda')
    """
    return f"{pattern}{name}.usdc" if pattern.endswith(("/", os.sep)) else pattern


def unknown_names(
    pattern: str, variables: Mapping[str, str]
) -> Iterator[tuple[str, str]]:
    """Yield what is wrong with a pattern, and what to do about it.

    >>> list(unknown_names("out/{stm}.usdc", {}))
    [("'out/{stm}.usdc' has no name {stm}", "did you mean 'stem'?")]
    """
    try:
        fields = [part[1:] for part in Formatter().parse(pattern)]
    except ValueError as error:
        yield f"{pattern!r} is no pattern: {error}", "write {{ for a brace itself"
        return
    names = [*INPUT_NAMES, *variables]
    for name, form, conversion in fields:
        if name is not None and (form or conversion or name not in names):
            shown = f"{{{name}}}" if name or not form else "{}"
            yield f"{pattern!r} has no name {shown}", nearest(name, names)


def output_root(pattern: str) -> PurePath:
    """Return the folder that all outputs of a pattern are in.

    >>> output_root("out/{parent}/{stem}.usdc").as_posix()
    'out'
    """
    parts = PurePath(pattern).parent.parts
    fixed = next((i for i, part in enumerate(parts) if "{" in part), len(parts))
    return PurePath(*parts[:fixed])
