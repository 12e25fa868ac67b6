"""Outputs that cannot or must not be written, all found before the work."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from animtool.batch.discover import Batch
from animtool.batch.recipe import Item
from animtool.errors import Fault, OptionError, OutputError
from animtool.files import Places
from animtool.output_names import name_key

MAX_FAULTS = 50


def check_places(batch: Batch) -> None:
    """Refuse outputs that are one file, or an input, or in no folder to write to.

    Raises:
        OptionError: Two items write one file, or files that are one on some disks, as
            their names differ only in case or in how accents are encoded (BAT006); or
            an output is an input (OUT003).
        OutputError: A folder cannot be made or written to (OUT002).
    """
    place = Places()
    inputs = {place(item.found.path) for item in batch.items}
    inputs |= {place(path) for path in batch.given}
    faults = list(_clashes(batch, place, inputs))
    _refuse(faults, OptionError)
    folders = dict.fromkeys(folder for item in batch.items for folder in item.folders)
    _refuse(list(_closed(folders)), OutputError)


def _clashes(
    batch: Batch, place: Callable[[Path], Path], inputs: set[Path]
) -> Iterator[Fault]:
    taken: dict[str, Item] = {}
    for item in batch.items:
        own: set[str] = set()
        for path in batch.outputs(item):
            where = place(path)
            if where in inputs:
                message = "is an input of this very batch"
                yield Fault("OUT003", message, str(path), (), "name another -o")
            name = name_key(where)
            other = taken.setdefault(name, item)
            if other is not item:
                message = f"would be written for both {other.label} and {item.label}"
                hint = _apart(item, other)
                yield Fault("BAT006", message, str(path), (), hint)
            elif name in own:
                message = f"would be written twice for {item.label}"
                yield Fault("BAT006", message, str(path))
            own.add(name)


def _apart(item: Item, other: Item) -> str:
    """Return what keeps the outputs of two items apart."""
    if item.shot is not None and item.shot != other.shot:
        return "{shot} in -o keeps the shots apart"
    if item.found != other.found:
        return "{parent} in -o keeps the folders of inputs apart"
    differing = [k for k, v in item.values.items() if other.values.get(k) != v]
    if not differing:
        return "these values are given twice: leave one out"
    name = differing[0]
    return f"{{{name}}} in -o, or ${{{name}}} in the scene's output, " + (
        "keeps the variants apart"
    )


def _closed(folders: Iterable[Path]) -> Iterator[Fault]:
    """Yield what is wrong with folders that are there, or with those around them."""
    seen: set[Path] = set()
    for folder in folders:
        there = next((f for f in (folder, *folder.parents) if f.exists()), Path())
        if there in seen:
            continue
        seen.add(there)
        if not there.is_dir():
            yield Fault("OUT002", "cannot be written to: it is no folder", str(there))
        elif not os.access(there, os.W_OK | os.X_OK):
            yield Fault("OUT002", "cannot be written to: no permission", str(there))


def check_overwrites(
    batch: Batch, items: Iterable[Item], known: Callable[[Path], bool]
) -> None:
    """Refuse to replace files that no run of the batch made.

    Args:
        batch: The batch.
        items: Those that are to be made.
        known: Whether a run of the batch made a file, or began to.

    Raises:
        OptionError: With a fault for each (OUT001).
    """
    faults = [
        Fault("OUT001", "already exists", str(path), (), "--overwrite replaces it")
        for item in items
        for path in batch.outputs(item)
        if path.exists() and not known(path)
    ]
    _refuse(faults, OptionError)


def _refuse(faults: list[Fault], kind: type[OptionError] | type[OutputError]) -> None:
    if len(faults) > MAX_FAULTS:
        rest = f"{len(faults) - MAX_FAULTS} more faults are not shown"
        faults = [*faults[:MAX_FAULTS], Fault("DOC011", rest)]
    if faults:
        raise kind(faults)
