"""The items of a batch: its inputs found, its outputs named, both checked."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
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
    from animtool.scene.plan import Source

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
    place = None if spec.path is None else str(spec.path)
    faults = [
        Fault("BAT004", message, place, (), hint)
        for message, hint in unknown_names(spec.output or "", spec.variables)
    ]
    if faults:
        raise OptionError(faults)
    found = _found(spec)
    kinds = {
        (file.path.suffix.lower(), is_scene(file.path)): file.path for file in found
    }
    options = spec.options
    recipe = Recipe(spec.scene, dict(spec.variables), options, tuple(kinds.values()))
    items = tuple(
        Item(number, file, _output(spec, recipe, number, file))
        for number, file in enumerate(found, 1)
    )
    given = [spec.scene, options.rig_layer, options.source.rig, spec.path]
    batch = Batch(
        spec.name,
        items,
        recipe,
        spec.limits,
        spec.jobs,
        Path(spec.folder, output_root(spec.output or "")).absolute(),
        tuple(path for path in given if path is not None),
    )
    used = _used_in_output(spec)
    if spec.scene is not None:
        sample = recipe.source(items[0])
        batch = replace(batch, sample=sample)
        used |= set(getattr(sample, "variables", ()))
    elif any(is_scene(path) for path in kinds.values()):
        # Each of them has variables of its own, which it checks when it is made.
        used |= set(spec.variables)
    check_given(spec.variables, used - set(INPUT_NAMES))
    return batch


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


def _output(spec: BatchSpec, recipe: Recipe, number: int, file: FoundFile) -> Path:
    if spec.output is None:
        beside = file.path.with_name(f"{source_stem(file.path)}.usdc")
        if spec.scene is not None or not is_scene(file.path):
            return beside
        scene = recipe.source(Item(number, file, beside))
        return getattr(scene, "output", None) or beside
    names = {**spec.variables, **input_names(file)}
    return spec.folder / spec.output.format(**names)


def _used_in_output(spec: BatchSpec) -> set[str]:
    wanted: Iterable[str] = spec.variables if spec.output is not None else ()
    return {name for name in wanted if f"{{{name}}}" in (spec.output or "")}
