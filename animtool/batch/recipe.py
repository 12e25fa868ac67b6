"""How the items of a batch are made, and one of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

from animtool.batch.manifest import digest_of
from animtool.batch.names import input_names
from animtool.batch.spec import named_from
from animtool.errors import OptionError
from animtool.files import FoundFile
from animtool.scene.options import BakeOptions
from animtool.scene.sources import fitting_options, is_scene
from animtool.shot import Shot

if TYPE_CHECKING:
    from animtool.scene.outputs import OutputReport
    from animtool.scene.reading import Source
    from animtool.scene.scene import Scene


def values_text(values: Mapping[str, str]) -> str:
    """Return the values of a variant behind the name of its input.

    >>> values_text({"k": "2", "s": "0.5"})
    ' (k=2, s=0.5)'
    """
    shown = ", ".join(f"{name}={value}" for name, value in values.items())
    return f" ({shown})" if shown else ""


@dataclass(frozen=True, slots=True)
class Item:
    """What is made of one file.

    Attributes:
        number: Its place among those of the batch, from 1.
        found: What it is made of.
        output: The file to write; of several the first.
        names: What names stand for in its scene, beside those of its input.
        files: Every file to write, where its scene names several outputs, or one that
            is no USD; empty where they follow from ``output``.
        values: Those of ``names`` that tell it from other variants.
        shot: Of a clip of a timeline; None is a file as it is.
    """

    number: int
    found: FoundFile
    output: Path
    names: Mapping[str, str] = field(default_factory=dict)
    files: tuple[Path, ...] = ()
    values: Mapping[str, str] = field(default_factory=dict)
    shot: Shot | None = None

    @property
    def label(self) -> str:
        """The input, and its shot and the values of a variant."""
        shot = {} if self.shot is None else {"shot": self.shot.name}
        return f"{self.found.path}{values_text({**shot, **self.values})}"

    @property
    def folders(self) -> list[Path]:
        """The folders that it writes to."""
        return [*dict.fromkeys(path.parent for path in (self.output, *self.files))]


@dataclass(frozen=True, slots=True)
class Recipe:
    """How every item is made.

    Attributes:
        scene: A scene that says what is done to each; None bakes each as it is.
        variables: What names in scenes stand for, beside those of each input.
        options: How to bake, where there is no scene.
        kinds: An input of each kind that there is.
    """

    scene: Path | None = None
    variables: Mapping[str, str] = field(default_factory=dict)
    options: BakeOptions = field(default_factory=BakeOptions)
    kinds: tuple[Path, ...] = ()
    # By suffix, on which alone they depend: options, and the digest of them.
    _fitting: dict[str, BakeOptions] = field(
        default_factory=dict, compare=False, repr=False
    )
    _digests: dict[str, str] = field(default_factory=dict, compare=False, repr=False)

    def names(self, item: Item) -> dict[str, str]:
        """Return what names in a scene stand for."""
        names = input_names(item.found)
        if self.scene is None:
            # A scene that is an input is no input of its own.
            del names["input"]
        return {**names, **item.names, **self.variables}

    def source(self, item: Item) -> Source:
        """Return what is baked: a scene, loaded, or a file.

        Raises:
            FormatError: The scene is malformed.
            OptionError: It adds a take to a library (SCN052), or says itself where the
                take of a shot begins (SCN073).
        """
        path = item.found.path if self.scene is None else self.scene
        if not is_scene(path):
            return path
        from animtool.scene.file import load_scene

        scene = load_scene(path, self.names(item), parts=item.names.keys())
        if item.shot is not None:
            scene = scene.of_shot(item.shot)
        for output in scene.outputs:
            if output.bake.form == "library":
                message = "items of a batch do not share a library"
                hint = (
                    "bake them apart, and then together: animtool bake *.usdc -o FILE"
                )
                raise OptionError(output.place.fault("SCN052", message, hint))
        return scene

    def named(self, item: Item) -> Item:
        """Return an item with the outputs that its scene names, if it names some.

        Raises:
            FormatError: The scene is malformed.
            OptionError: One of several outputs names no file (DOC021).
        """
        scene = self.source(item)
        own = getattr(scene, "output", None)
        files: Sequence[Path] = ()
        if self._is_several(scene):
            from animtool.scene.outputs import scene_files

            files = scene_files(cast("Scene", scene), self._options(item.found.path))
        return replace(item, output=own or item.output, files=tuple(files))

    def refuse_several(self, source: Source) -> None:
        """Refuse a scene that names its outputs, where a pattern names them too.

        Raises:
            OptionError: It has other outputs than one USD file (SCN044).
        """
        if self._is_several(source):
            message = "the scene names its outputs, and the batch names one"
            hint = "leave out the batch's output (-o), and use ${stem} in the scene's"
            place = cast("Scene", source).outputs[-1].place
            raise OptionError(place.fault("SCN044", message, hint))

    @staticmethod
    def _is_several(source: Source) -> bool:
        if isinstance(source, Path | str):
            return False
        from animtool.scene.outputs import is_several

        return is_several(source)

    def bake(self, item: Item) -> list[OutputReport]:
        """Make an item, and return what became of each of its outputs.

        What they were before is replaced.

        Raises:
            AnimtoolError: As `animtool.bake`.
        """
        source, options = self.source(item), self._options(item.found.path)
        if item.files:
            from animtool.scene.outputs import bake_scene

            return bake_scene(cast("Scene", source), options)
        self.refuse_several(source)
        if item.shot is not None and isinstance(source, Path):
            options = replace(options, shot=item.shot, start=None)
        from animtool.scene.bake import bake

        return [bake(source, item.output, options)]

    def outputs(self, item: Item, source: Source) -> list[Path]:
        """Return the files that a bake writes.

        Args:
            item: What is made.
            source: What it, or one like it, is baked from.
        """
        if item.files:
            return list(item.files)
        from animtool.scene.files import bake_outputs

        return bake_outputs([source], item.output, self._options(item.found.path))

    def _options(self, path: Path) -> BakeOptions:
        """Return the options for a file: those that are for its kind."""
        kind = path.suffix.lower()
        if kind not in self._fitting:
            own = fitting_options(self.options.source, path, self.kinds)
            options = replace(self.options, source=own, overwrite=True)
            self._fitting[kind] = options
        return self._fitting[kind]

    def described(self, item: Item, root: Path) -> dict[str, object]:
        """Return everything that decides how an item is made, but its files.

        Args:
            item: What is made.
            root: Folder from which files below it are named.
        """
        plain: dict[str, object] = {"input": named_from(item.found.path, root)}
        if self.scene is not None or is_scene(item.found.path):
            names = self.names(item)
            for key in names.keys() & {"input", "folder"}:
                names[key] = named_from(Path(names[key]), root)
            plain["variables"] = names
        if item.shot is not None:
            plain["shot"] = {k: str(v) for k, v in item.shot.as_dict().items()}
        if self.scene is not None:
            plain["scene"] = named_from(self.scene, root)
            plain["strict"] = self.options.strict
        else:
            plain["options"] = self._digest(item.found.path, root)
        return plain

    def _digest(self, path: Path, root: Path) -> str:
        kind = path.suffix.lower()
        if kind not in self._digests:
            self._digests[kind] = digest_of(_plain(self._options(path), root))
        return self._digests[kind]


def _plain(value: object, root: Path) -> object:
    """Return options as what JSON can hold."""
    if is_dataclass(value):
        return {
            entry.name: _plain(getattr(value, entry.name), root)
            for entry in fields(value)
        }
    if isinstance(value, tuple):
        return [_plain(part, root) for part in value]
    if isinstance(value, Path):
        return named_from(value, root)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return str(value)
