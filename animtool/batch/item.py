"""Items of a batch: values of their patterns, their outputs, and their bake.

References:
    Open Job Description, "pathmapping-1.0",
    https://github.com/OpenJobDescription/openjd-specifications/wiki
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field, fields, is_dataclass, replace
from itertools import takewhile
from pathlib import Path, PurePath, PurePosixPath, PureWindowsPath
from string import Formatter
from typing import TYPE_CHECKING, Any, cast

from animtool.batch.manifest import digest_of
from animtool.batch.records import (
    RecordError,
    checked_object,
    list_in,
    read_json,
    text_in,
)
from animtool.batch.spec import BatchSpec, relative_name
from animtool.core.arguments import argument
from animtool.core.errors import Fault, FormatError, OptionError, excerpt
from animtool.core.files.output import is_inside, name_problem
from animtool.core.files.reading import MatchedFile
from animtool.core.names import has_kind_suffix, name_hint
from animtool.core.record import dataclass
from animtool.core.shot import Shot
from animtool.core.values import plain_value
from animtool.scene.bake.options import BakeOptions
from animtool.scene.sources.open import OpenTake, fitting_options, source_stem

if TYPE_CHECKING:
    from animtool.scene.bake.bake import OutputReport
    from animtool.scene.bake.reading import Source
    from animtool.scene.bake.request import BakeRequest
    from animtool.scene.scene import Scene


# Other programs' names of a file's name without its ending, and of its folder.
OTHER_NAMES = {
    **dict.fromkeys(("base", "basename", "file", "filename", "take"), "stem"),
    **dict.fromkeys(("dir", "dirname", "directory", "path"), "folder"),
}
INPUT_NAMES = ("input", "folder", "name", "parent", "stem")
# Names whose values are folders, with which a pattern may begin to write next to the
# inputs.
_INPUT_FOLDERS = frozenset({"input", "folder"})


def input_values(input_file: MatchedFile) -> dict[str, str]:
    """Return the names that every input defines, with their values.

    ``input`` is the path of the input, ``folder`` that of its folder, ``name`` its
    name, ``stem`` the name without its type suffix, and ``parent`` the folders between
    the searched folder and the input.

    >>> from pathlib import Path
    >>> names = input_values(MatchedFile(Path("takes/a/walk.clip.yaml"), Path("takes")))
    >>> names["name"], names["parent"], names["stem"]
    ('walk.clip.yaml', 'a', 'walk')
    """
    path = input_file.path
    return {
        "input": path.absolute().as_posix(),
        "folder": path.parent.absolute().as_posix(),
        "name": path.name,
        "parent": path.parent.relative_to(input_file.search_folder).as_posix(),
        "stem": source_stem(path),
    }


def complete_pattern(pattern: str, name: str) -> str:
    """Return an output pattern, completed by ``name`` if it ends in a slash.

    >>> complete_pattern("out/", "{stem}"), complete_pattern("{stem}.usda", "{stem}")
    ('out/{stem}.usdc', '{stem}.usda')
    """
    return f"{pattern}{name}.usdc" if pattern.endswith(("/", os.sep)) else pattern


def pattern_problems(
    pattern: str, variables: Mapping[str, str]
) -> Iterator[tuple[str, str]]:
    """Yield a message and a hint for each fault in an output pattern.

    >>> list(pattern_problems("out/{stm}.usdc", {}))
    [("unknown name in 'out/{stm}.usdc': {stm}", "did you mean 'stem'?")]
    """
    try:
        name_fields = [part[1:] for part in Formatter().parse(pattern)]
    except ValueError as error:
        message = f"{pattern!r} is not a valid pattern: {error}"
        yield message, "write {{ for a literal brace"
        return
    known_names = [*INPUT_NAMES, *variables]
    for name, format_spec, conversion in name_fields:
        if name is not None and (format_spec or conversion or name not in known_names):
            quoted_name = f"{{{name}}}" if name or not format_spec else "{}"
            hint = name_hint(name, known_names)
            if name in OTHER_NAMES:
                hint = f"write {{{OTHER_NAMES[name]}}}; names: {', '.join(known_names)}"
            yield f"unknown name in {pattern!r}: {quoted_name}", hint


def output_root(pattern: str) -> PurePath:
    """Return the folder that contains all outputs of a pattern.

    >>> output_root("out/{parent}/{stem}.usdc").as_posix()
    'out'
    """
    parts = PurePath(pattern).parent.parts
    return PurePath(*takewhile(lambda part: "{" not in part, parts))


@dataclass(slots=True)
class OutputPattern:
    """A pattern of output paths; values of names cannot lead out of its folder."""

    pattern: str  # pattern of the files to write
    folder: Path  # base folder of relative patterns
    folder_names: frozenset[
        str
    ]  # names whose values may contain folders, as in ``a/b``
    _inside_by_folders: dict[tuple[Path, Path], bool] = field(default_factory=dict)

    def path(self, values: Mapping[str, str]) -> Path:
        """Return the output path for the values of the names in the pattern."""
        root, path = self.folder, self.folder
        is_below_root = False
        for component in PurePath(self.pattern).parts:
            names = [name for _, name, *_ in Formatter().parse(component) if name]
            component_text = component.format(**values)
            if set(names) - _INPUT_FOLDERS:
                is_below_root = True
                self._check_component(component_text, names, values)
            path /= component_text
            root = root if is_below_root else path
        if is_below_root and not self._stays_inside(path.parent, root):
            message = f"a link in {str(root)!r} leads outside it: {str(path.parent)!r}"
            raise UnsafeNameError("", message)
        return path

    def _check_component(
        self, component: str, names: list[str], values: Mapping[str, str]
    ) -> None:
        """Raise an error for path parts that are not single legal names."""
        for name in names:
            value = values[name]
            bad_match = re.search(r"[\x00-\x1f\x7f\\]", value)
            if name not in self.folder_names:
                bad_match = bad_match or re.search("/", value)
            if bad_match is not None:
                message = f"{{{name}}} is {excerpt(value)}, which has "
                raise UnsafeNameError(name, f"{message}{bad_match[0]!r}")
        for part in component.split("/"):
            problem = None if part == "." else name_problem(part)
            if problem is not None:
                value = excerpt(values[names[-1]])
                message = f"{{{names[-1]}}} is {value}: the name {excerpt(part)} "
                raise UnsafeNameError(names[-1], message + problem)

    def _stays_inside(self, folder: Path, root: Path) -> bool:
        folder_pair = folder, root
        if folder_pair not in self._inside_by_folders:
            try:
                self._inside_by_folders[folder_pair] = is_inside(folder, root)
            except OSError:
                self._inside_by_folders[folder_pair] = False
        return self._inside_by_folders[folder_pair]


class UnsafeNameError(ValueError):
    """An output name leaves its folder or is illegal on some system.

    Attributes:
        name: Name in the pattern with the unsafe value; empty for none.
    """

    def __init__(self, name: str, message: str) -> None:
        super().__init__(message)
        self.name = name


_PATH_CLASSES: dict[str, type[PurePath]] = {
    "POSIX": PurePosixPath,
    "WINDOWS": PureWindowsPath,
}


# A rule has some hundred bytes, and a farm has a few per disk.
MAX_RULES_BYTES = 4_000_000


@dataclass(frozen=True, slots=True)
class PathRule:
    """A rule that maps a folder of another machine to a local folder."""

    source: PurePath  # on the other machine
    destination: str  # on this machine


def read_path_rules(path: Path) -> list[PathRule]:
    """Return the path rules of a file; empty if the file has none."""
    try:
        data = read_json(path, MAX_RULES_BYTES)
        key = "path_mapping_rules"
        rules = list_in(data, key) if key in data else ()
        return [_parse_rule(checked_object(rule)) for rule in rules]
    except RecordError as error:
        message = f"is not a file of path mapping rules: {error}"
        raise FormatError(Fault("BAT038", message, str(path))) from error


def _parse_rule(data: Mapping[str, Any]) -> PathRule:
    path_format = text_in(data, "source_path_format")
    if path_format not in _PATH_CLASSES:
        raise RecordError(f"unknown 'source_path_format' {excerpt(path_format)}")
    source = _PATH_CLASSES[path_format](text_in(data, "source_path"))
    return PathRule(source, text_in(data, "destination_path"))


def map_path(text: str, rules: Sequence[PathRule]) -> str:
    r"""Return the local path of a path of another machine.

    Of several rules that match, that of the innermost folder applies.

    >>> rule = PathRule(PureWindowsPath("Z:/show"), "/mnt/show")
    >>> map_path("z:\\show\\a.bvh", [rule]), map_path("a.bvh", [rule])
    ('/mnt/show/a.bvh', 'a.bvh')
    """
    for rule in sorted(rules, key=lambda rule: -len(rule.source.parts)):
        path = type(rule.source)(text)
        if path.is_relative_to(rule.source):
            relative_parts = path.relative_to(rule.source).parts
            return Path(rule.destination, *relative_parts).as_posix()
    return text


def map_batch_paths(spec: BatchSpec, rules: Sequence[PathRule]) -> BatchSpec:
    """Return a batch with its inputs and outputs mapped to local paths.

    Paths in scenes and options are not changed: they work if they are relative.
    """
    if not rules:
        return spec

    def mapped(texts: Iterable[str]) -> tuple[str, ...]:
        return tuple(map_path(text, rules) for text in texts)

    output = spec.output
    mapped_output = None if output is None else map_path(output, rules)
    return replace(
        spec,
        # The path mapping determines where outputs go.
        roots=spec.roots if mapped_output == output else (),
        inputs=mapped(spec.inputs),
        exclude=mapped(spec.exclude),
        overrides=tuple(
            replace(override, inputs=mapped(override.inputs))
            for override in spec.overrides
        ),
        output=mapped_output,
    )


def variant_text(values: Mapping[str, str]) -> str:
    """Return the values of a variant as a suffix for the name of its input.

    >>> variant_text({"k": "2", "s": "0.5"})
    ' (k=2, s=0.5)'
    """
    pairs_text = ", ".join(f"{name}={value}" for name, value in values.items())
    return f" ({pairs_text})" if pairs_text else ""


@dataclass(frozen=True, slots=True)
class Item:
    """One input of a batch and its output."""

    number: int  # its number in the batch, from 1
    file: MatchedFile  # its input
    output: Path  # the file to write; the first of several
    # Values of names in its scene, in addition to those of its input.
    scene_values: Mapping[str, str] = field(default_factory=dict)
    # Every file to write, if its scene names several outputs or one that is not USD;
    # empty if they follow from ``output``.
    files: tuple[Path, ...] = ()
    # Values of ``names`` that distinguish it from other variants.
    variant_values: Mapping[str, str] = field(default_factory=dict)
    # Values from overrides of the batch, replacing common variables.
    variables: Mapping[str, str] = field(default_factory=dict)
    shot: Shot | None = None  # shot of a timeline clip; None for a plain file

    @property
    def label(self) -> str:
        """Input, shot and variant as text for messages, such as ``a.bvh (k=2)``."""
        shot = {} if self.shot is None else {"shot": self.shot.name}
        return f"{self.file.path}{variant_text({**shot, **self.variant_values})}"

    @property
    def folders(self) -> list[Path]:
        """Distinct folders of the item's outputs."""
        return [*dict.fromkeys(path.parent for path in (self.output, *self.files))]


@dataclass(frozen=True, slots=True)
class ItemTask:
    """How items are built: a scene or bake options, and values of variables."""

    # Scene to apply to each input; None bakes the input itself.
    scene: Path | None = None
    # Values of names in scenes, in addition to those of each input.
    variables: Mapping[str, str] = field(default_factory=dict)
    # Bake options without a scene.
    options: BakeOptions = field(default_factory=BakeOptions)
    example_paths: tuple[Path, ...] = ()  # one input of each kind
    # Options and their digest by suffix, on which alone they depend.
    _options_by_suffix: dict[str, BakeOptions] = field(
        default_factory=dict, compare=False, repr=False
    )
    _digest_by_suffix: dict[str, str] = field(
        default_factory=dict, compare=False, repr=False
    )

    def variable_values(self, item: Item) -> dict[str, str]:
        """Return the values of ``${name}`` in the scene of an item."""
        values = input_values(item.file)
        if self.scene is None:
            # A scene used as an input takes no input.
            del values["input"]
        return {**values, **item.scene_values, **self.variables, **item.variables}

    def source(self, item: Item) -> Source:
        """Return the loaded scene of an item, or its input file if it has no scene."""
        path = item.file.path if self.scene is None else self.scene
        if not has_kind_suffix(path, "scene"):
            return path
        from animtool.scene.file.read import load_scene

        scene = load_scene(
            path, self.variable_values(item), parts=item.scene_values.keys()
        )
        if item.shot is not None:
            scene = scene.with_shot(item.shot)
        for output in scene.outputs:
            if output.bake.form == "library":
                message = "items of a batch cannot share a library"
                hint = "bake each first, then combine them: "
                hint += "animtool bake *.usdc -o FILE"
                raise OptionError(output.location.fault("SCN052", message, hint))
        return scene

    def with_scene_outputs(self, item: Item) -> Item:
        """Return an item with the outputs that its scene names."""
        scene = self.source(item)
        output = getattr(scene, "output", None)
        files: Sequence[Path] = ()
        if self._names_outputs(scene):
            files = self._bake_request(scene, None, item).files
        return replace(item, output=output or item.output, files=tuple(files))

    def refuse_two_outputs(self, source: Source) -> None:
        """Raise an error if both a scene and a pattern name outputs."""
        if self._names_outputs(source):
            message = "the scene names its outputs, but the batch names one too"
            hint = f"remove the batch's output ({argument('output')}), and use "
            hint += "${stem} in the scene's"
            location = cast("Scene", source).outputs[-1].location
            raise OptionError(location.fault("SCN044", message, hint))

    @staticmethod
    def _names_outputs(source: Source) -> bool:
        if isinstance(source, Path | str | OpenTake):
            return False
        from animtool.scene.bake.request import has_several_outputs

        return has_several_outputs(source)

    def bake(self, item: Item) -> list[OutputReport]:
        """Bake an item, replace existing outputs, and return a report of each."""
        source, options = self.source(item), self._options(item.file.path)
        from animtool.scene.bake.bake import bake_outputs

        if item.files:
            return bake_outputs(source, None, options)
        self.refuse_two_outputs(source)
        if item.shot is not None and isinstance(source, Path):
            options = replace(options, shot=item.shot, start=None)
        return bake_outputs(source, item.output, options)

    def outputs(self, item: Item, source: Source) -> list[Path]:
        """Return the files that the bake of an item writes."""
        return self._bake_request(source, item.output, item).files

    def _bake_request(
        self, source: Source, output: Path | None, item: Item
    ) -> BakeRequest:
        from animtool.scene.bake.request import create_request

        return create_request(source, output, self._options(item.file.path))

    def _options(self, path: Path) -> BakeOptions:
        """Return the options that apply to a file's format."""
        suffix = path.suffix.lower()
        if suffix not in self._options_by_suffix:
            source_options = fitting_options(
                self.options.source, path, self.example_paths
            )
            options = replace(self.options, source=source_options, overwrite=True)
            self._options_by_suffix[suffix] = options
        return self._options_by_suffix[suffix]

    def settings(self, item: Item, root: Path) -> dict[str, object]:
        """Return all settings, except files, that affect the result of an item."""
        settings: dict[str, object] = {"input": relative_name(item.file.path, root)}
        if self.scene is not None or has_kind_suffix(item.file.path, "scene"):
            names = self.variable_values(item)
            for key in names.keys() & {"input", "folder"}:
                names[key] = relative_name(Path(names[key]), root)
            settings["variables"] = names
        if item.shot is not None:
            shot = plain_value(item.shot)
            settings["shot"] = {name: str(value) for name, value in shot.items()}
        if self.scene is not None:
            settings["scene"] = relative_name(self.scene, root)
            settings["strict"] = self.options.strict
        else:
            settings["options"] = self._digest(item.file.path, root)
        return settings

    def _digest(self, path: Path, root: Path) -> str:
        suffix = path.suffix.lower()
        if suffix not in self._digest_by_suffix:
            values = _to_json(self._options(path), root)
            self._digest_by_suffix[suffix] = digest_of(values)
        return self._digest_by_suffix[suffix]


def _to_json(value: object, root: Path) -> object:
    """Return options as JSON values; paths are relative to ``root`` where possible."""
    if is_dataclass(value):
        names = [entry.name for entry in fields(value)]
        return {name: _to_json(getattr(value, name), root) for name in names}
    if isinstance(value, tuple):
        return [_to_json(element, root) for element in value]
    if isinstance(value, Path):
        return relative_name(value, root)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return str(value)
