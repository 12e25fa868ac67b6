"""Names of items and outputs, and folders that stand for others elsewhere.

References:
    Open Job Description, "pathmapping-1.0",
    https://github.com/OpenJobDescription/openjd-specifications/wiki
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath, PurePosixPath, PureWindowsPath
from string import Formatter
from typing import Any

from animtool.batch.checked import (
    RecordError,
    json_of_file,
    list_in,
    object_of,
    text_in,
)
from animtool.batch.spec import BatchSpec
from animtool.documents.names import nearest
from animtool.errors import Fault, FormatError, excerpt
from animtool.files import FoundFile
from animtool.output_names import inside, name_problem
from animtool.scene.sources import source_stem

INPUT_NAMES = ("input", "folder", "name", "parent", "stem")
# These are paths that a pattern begins with, to write where the inputs are.
_PLACES = frozenset({"input", "folder"})


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


@dataclass(slots=True)
class NamedOutputs:
    """The outputs of a pattern, none of which leaves the folder that it states.

    Attributes:
        pattern: The files to write.
        folder: Where a relative one starts.
        paths: Names whose values may lead into folders, as ``a/b`` does.
    """

    pattern: str
    folder: Path
    paths: frozenset[str]
    _inside: dict[tuple[Path, Path], bool] = field(default_factory=dict)

    def path(self, values: Mapping[str, str]) -> Path:
        """Return the output that the pattern is for some values.

        Args:
            values: Of its names.

        Raises:
            UnsafeNameError: The output would leave the folder, or has no legal name.
        """
        root, path = self.folder, self.folder
        below = False
        for part in PurePath(self.pattern).parts:
            names = [name for _, name, *_ in Formatter().parse(part) if name]
            text = part.format(**values)
            if set(names) - _PLACES:
                below = True
                self._check(text, names, values)
            path /= text
            root = root if below else path
        if below and not self._stays(path.parent, root):
            message = f"a link in {str(root)!r} leads out of it: {str(path.parent)!r}"
            raise UnsafeNameError("", message)
        return path

    def _check(self, text: str, names: list[str], values: Mapping[str, str]) -> None:
        """Refuse a part of a path that is not one name, or some in folders."""
        for name in names:
            value = values[name]
            wrong = re.search(r"[\x00-\x1f\x7f\\]", value)
            if name not in self.paths:
                wrong = wrong or re.search("/", value)
            if wrong is not None:
                message = f"{{{name}}} is {excerpt(value)}, which has {wrong[0]!r}"
                raise UnsafeNameError(name, message)
        for piece in text.split("/"):
            problem = None if piece == "." else name_problem(piece)
            if problem is not None:
                value = excerpt(values[names[-1]])
                message = f"{{{names[-1]}}} is {value}: the name {excerpt(piece)} "
                raise UnsafeNameError(names[-1], message + problem)

    def _stays(self, folder: Path, root: Path) -> bool:
        key = folder, root
        if key not in self._inside:
            try:
                self._inside[key] = inside(folder, root)
            except OSError:
                self._inside[key] = False
        return self._inside[key]


class UnsafeNameError(ValueError):
    """A name of an output leaves its folder, or is not legal everywhere.

    Attributes:
        name: That of the pattern whose value it is; empty is none.
    """

    def __init__(self, name: str, message: str) -> None:
        super().__init__(message)
        self.name = name


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
