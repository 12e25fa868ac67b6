"""Paths as another machine has them: the rules of a farm's session.

References:
    Open Job Description, "pathmapping-1.0",
    https://github.com/OpenJobDescription/openjd-specifications/wiki
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath, PurePosixPath, PureWindowsPath
from typing import Any

from animtool.batch.checked import (
    RecordError,
    json_of_file,
    list_in,
    object_of,
    text_in,
)
from animtool.batch.spec import BatchSpec
from animtool.errors import Fault, FormatError, excerpt

_KINDS: dict[str, type[PurePath]] = {
    "POSIX": PurePosixPath,
    "WINDOWS": PureWindowsPath,
}


# A rule takes some hundred bytes, and a farm has a few for each disk.
MAX_BYTES = 4_000_000


@dataclass(frozen=True, slots=True)
class PathRule:
    """Where a folder of one machine is on this one.

    Attributes:
        source: There.
        destination: Here.
    """

    source: PurePath
    destination: str


def read_rules(path: Path) -> list[PathRule]:
    """Return the rules of a file; none of one without any.

    Raises:
        FormatError: It cannot be read, or is malformed (BAT038).
    """
    try:
        found = json_of_file(path, MAX_BYTES)
        key = "path_mapping_rules"
        given = list_in(found, key) if key in found else ()
        return [_rule(object_of(rule)) for rule in given]
    except RecordError as error:
        message = f"is no file of path mapping rules: {error}"
        raise FormatError(Fault("BAT038", message, str(path))) from error


def _rule(plain: Mapping[str, Any]) -> PathRule:
    kind = text_in(plain, "source_path_format")
    if kind not in _KINDS:
        raise RecordError(f"{excerpt(kind)} is no 'source_path_format'")
    source = _KINDS[kind](text_in(plain, "source_path"))
    return PathRule(source, text_in(plain, "destination_path"))


def mapped_path(text: str, rules: Sequence[PathRule]) -> str:
    r"""Return a path as this machine has it, by the rule of the innermost folder.

    >>> rule = PathRule(PureWindowsPath("Z:/show"), "/mnt/show")
    >>> mapped_path("z:\\show\\a.bvh", [rule]), mapped_path("a.bvh", [rule])
    ('/mnt/show/a.bvh', 'a.bvh')
    """
    for rule in sorted(rules, key=lambda rule: -len(rule.source.parts)):
        path = type(rule.source)(text)
        if path.is_relative_to(rule.source):
            inner = path.relative_to(rule.source).parts
            return Path(rule.destination, *inner).as_posix()
    return text


def mapped_spec(spec: BatchSpec, rules: Sequence[PathRule]) -> BatchSpec:
    """Return a batch whose inputs and output are those of this machine.

    Names of files in scenes and options are not changed: they are found where they are
    relative.
    """
    if not rules:
        return spec
    output = spec.output
    mapped = None if output is None else mapped_path(output, rules)
    return replace(
        spec,
        # Who maps paths says where outputs go.
        roots=spec.roots if mapped == output else (),
        inputs=tuple(mapped_path(text, rules) for text in spec.inputs),
        exclude=tuple(mapped_path(text, rules) for text in spec.exclude),
        output=mapped,
    )
