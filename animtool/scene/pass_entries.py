"""Reading the passes of a scene, all faults noted."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from animtool.documents.check import record_of_options
from animtool.documents.document import Location
from animtool.documents.references import referred
from animtool.errors import AnimtoolError, OptionError
from animtool.passes import Pass, find_pass
from animtool.plugins import load_object
from animtool.scene.entries import ScenePass, place_of_entry
from animtool.scene.output_fields import KeyReader
from animtool.systems.fields import SystemColliderModel

# It reads whole scenes, where they are characters.
COLLIDER_READER = "animtool.scene.systems.entries:EntryReader"


def read_passes(
    keys: KeyReader,
    entries: Sequence[Mapping[str, Any]],
    output_roots: Sequence[Path],
) -> Iterator[ScenePass]:
    """Yield the passes of entries; files that they write are in ``output_roots``."""
    for i, entry in enumerate(entries):
        for name, given in entry.items():
            at: Location = ("passes", i, name)
            pass_ = _read(keys, at, name, given or {}, output_roots)
            if pass_ is not None:
                yield pass_


def _read(
    keys: KeyReader,
    at: Location,
    name: str,
    values: dict[str, Any],
    output_roots: Sequence[Path],
) -> ScenePass | None:
    document = keys.document
    try:
        pass_ = find_pass(name)
    except AnimtoolError as error:
        fault = error.faults[0]
        document.add(fault.code, at, fault.message, fault.hint)
        return None
    options, faults = record_of_options(pass_.options, values, name)
    for place, fault in faults:
        document.add(fault.code, (*at, *place), fault.message, fault.hint)
    if options is None:
        return None
    options, files = _with_colliders(keys, at, options)
    _check(keys, at, pass_, options)
    for written in getattr(options, "writes", ()):
        referred(document, at, str(written), output_roots, written=True)
    if faults:
        return None
    return ScenePass(pass_, options, place_of_entry(document, at), files)


def _with_colliders(
    keys: KeyReader, at: Location, options: Any
) -> tuple[Any, tuple[Path, ...]]:
    """Return options with what they run into, and the files that this goes with."""
    entries = {
        field.name: value
        for field in fields(options)
        if isinstance(value := getattr(options, field.name), list)
        and any(isinstance(one, SystemColliderModel) for one in value)
    }
    if not entries:
        return options, ()
    kind: Any = load_object(COLLIDER_READER)
    reader = kind(keys.document, keys.roots)
    read = {
        name: tuple(reader.colliders((*at, name), models))
        for name, models in entries.items()
    }
    return replace(options, **read), tuple(reader.files)


def _check(keys: KeyReader, at: Location, pass_: Pass, options: Any) -> None:
    """Note what is wrong with options whatever the take is."""
    for option, check in pass_.checks(options).items():
        try:
            check()
        except OptionError as error:
            for fault in error.faults:
                keys.document.add(fault.code, (*at, option), fault.message, fault.hint)
    for field in fields(pass_.options):
        value = getattr(options, field.name)
        if isinstance(value, Path):
            keys.read_file((*at, field.name), str(value))
