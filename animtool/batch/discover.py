"""The items of a batch: its inputs found, its outputs named, both checked."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from animtool.batch.limits import Limits
from animtool.batch.names import INPUT_NAMES, input_names, output_root, unknown_names
from animtool.batch.recipe import Item, Recipe
from animtool.batch.spec import BatchSpec
from animtool.documents.variables import check_given
from animtool.errors import Fault, NothingFoundError, OptionError, listed
from animtool.files import FoundFile, Places, files_meant
from animtool.readers import BVH, DOCUMENT, READERS
from animtool.scene.sources import is_scene, source_stem

if TYPE_CHECKING:
    from animtool.scene.reading import Source

__all__ = ["SUFFIXES", "Batch", "find_batch"]

# How names end of the files that a folder is searched for. USD is left out: outputs
# are of that kind, and would be inputs of the next run.
SUFFIXES = (
    *(suffix for suffix, reader in READERS.items() if reader is BVH),
    *(f".clip{suffix}" for suffix, reader in READERS.items() if reader is DOCUMENT),
)
SCENES = tuple(
    f".scene{suffix}" for suffix, reader in READERS.items() if reader is DOCUMENT
)
# Where records stand, below the folder of all outputs.
RECORDS = ".animtool"


@dataclass(frozen=True, slots=True)
class Batch:
    """A batch whose items are known.

    Attributes:
        name: What its records are called.
        items: In order.
        recipe: How each is made.
        limits: What each may take.
        jobs: How many processes; None is one for each processor.
        root: Folder of all outputs, absolute, from which records name files.
        given: Files that all items are made with, such as a scene.
        sample: What the first item is baked from, where all are of one scene.
    """

    name: str
    items: tuple[Item, ...]
    recipe: Recipe
    limits: Limits
    jobs: int | None
    root: Path
    given: tuple[Path, ...] = ()
    sample: Source | None = None

    @property
    def records(self) -> Path:
        """The folder of its records."""
        return self.root / RECORDS

    def outputs(self, item: Item) -> list[Path]:
        """Return the files that an item writes."""
        source = item.found.path if self.sample is None else self.sample
        if self.sample is None and is_scene(item.found.path):
            source = self.recipe.source(item)
        return self.recipe.outputs(item, source)


def find_batch(spec: BatchSpec) -> Batch:
    """Return the items of a batch, in the order of their names.

    Raises:
        FormatError: A scene is malformed.
        NothingFoundError: There is no input (BAT005).
        OptionError: The output has a name that there is none of (BAT004), or a
            variable that nothing uses is given (SCN031).
    """
    _check_pattern(spec)
    found = _found(spec)
    recipe = _recipe(spec, found)
    sample = None
    if spec.scene is not None:
        sample = recipe.source(Item(1, found[0], found[0].path))
    _check_variables(spec, recipe, sample)
    items = tuple(_items(spec, recipe, found, sample))
    given = [spec.scene, spec.options.rig_layer, spec.options.source.rig, spec.path]
    return Batch(
        spec.name,
        items,
        recipe,
        spec.limits,
        spec.jobs,
        Path(spec.folder, output_root(spec.output or "")).absolute(),
        tuple(path for path in given if path is not None),
        sample,
    )


def _check_pattern(spec: BatchSpec) -> None:
    place = None if spec.path is None else str(spec.path)
    faults = [
        Fault("BAT004", message, place, (), hint)
        for message, hint in unknown_names(spec.output or "", spec.variables)
    ]
    if faults:
        raise OptionError(faults)


def _recipe(spec: BatchSpec, found: Sequence[FoundFile]) -> Recipe:
    kinds = {
        (file.path.suffix.lower(), is_scene(file.path)): file.path for file in found
    }
    return Recipe(spec.scene, dict(spec.variables), spec.options, tuple(kinds.values()))


def _check_variables(spec: BatchSpec, recipe: Recipe, sample: Source | None) -> None:
    """Refuse variables that neither the scene nor the output uses."""
    used = {name for name in spec.variables if f"{{{name}}}" in (spec.output or "")}
    if sample is not None:
        used |= set(getattr(sample, "variables", ()))
    elif any(map(is_scene, recipe.kinds)):
        # Each has its own, and says what is wrong with them when it is made.
        used |= set(spec.variables)
    check_given(spec.variables, used - set(INPUT_NAMES))


def _items(
    spec: BatchSpec,
    recipe: Recipe,
    found: Sequence[FoundFile],
    sample: Source | None,
) -> Iterator[Item]:
    """Yield the items, each with its output: the pattern's, its scene's, or beside."""
    named_by_scene = getattr(sample, "output", None) is not None
    for number, file in enumerate(found, 1):
        if spec.output is not None:
            names = {**spec.variables, **input_names(file)}
            yield Item(number, file, spec.folder / spec.output.format(**names))
            continue
        beside = file.path.with_name(f"{source_stem(file.path)}.usdc")
        item = Item(number, file, beside)
        if named_by_scene or (spec.scene is None and is_scene(file.path)):
            own = getattr(recipe.source(item), "output", None)
            item = replace(item, output=own or beside)
        yield item


def _found(spec: BatchSpec) -> list[FoundFile]:
    """Return the inputs, each once, in order."""
    suffixes = SUFFIXES if spec.scene is not None else (*SUFFIXES, *SCENES)
    place = Places()
    left_out = {
        place(file.path) for file in _meant(spec.folder, spec.exclude, suffixes)
    }
    files: dict[Path, FoundFile] = {}
    for file in _meant(spec.folder, spec.inputs, suffixes):
        where = place(file.path)
        if where not in left_out:
            files.setdefault(where, file)
    if not files:
        message = f"no input in {listed(spec.inputs) or 'nothing'}"
        hint = f"folders are searched for {', '.join(suffixes)}"
        path = None if spec.path is None else str(spec.path)
        raise NothingFoundError(Fault("BAT005", message, path, (), hint))
    return [files[path] for path in sorted(files, key=os.fspath)]


def _meant(
    folder: Path, given: Sequence[str], suffixes: Sequence[str]
) -> Iterator[FoundFile]:
    for text in given:
        yield from files_meant(os.fspath(folder / text), suffixes)
