"""Reading ropes, strands, cloth and volumes of a scene file, all faults noted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from animtool.documents.document import Document, Location
from animtool.errors import Fault, OptionError
from animtool.scene.springs.bodies import SpringBody, families_of, mass_of
from animtool.scene.springs.pins import read_pins
from animtool.scene.springs.setup import (
    SpringSetup,
    contact_of,
    options_of,
    wind_of,
)
from animtool.scene.springs.shaped_bodies import (
    cloth_body,
    rope_body,
    strands_body,
    volume_body,
)
from animtool.scene.systems.entries import EntryReader
from animtool.scene.systems.surroundings import Surroundings
from animtool.systems.springs.options import check_keeping_apart, check_options
from animtool.systems.springs.spec import (
    ClothModel,
    RopeModel,
    SpringsModel,
    StrandsModel,
    VolumeModel,
)
from animtool.systems.springs.spec_parts import WindModel

_BODIES: dict[type[SpringsModel], Callable[..., SpringBody | None]] = {
    ClothModel: cloth_body,
    RopeModel: rope_body,
    StrandsModel: strands_body,
    VolumeModel: volume_body,
}


def read_springs(
    document: Document, at: Location, spec: SpringsModel, roots: Sequence[Path]
) -> SpringSetup | None:
    """Return what an entry is made of; None where faults leave nothing."""
    reader = EntryReader(document, roots)
    body = _body(reader, at, spec)
    colliders = reader.colliders((*at, "colliders"), spec.colliders)
    characters = reader.characters((*at, "characters"), spec.characters)
    meshes = reader.meshes((*at, "meshes"), spec.meshes)
    _check_wind(reader, (*at, "wind"), wind_of(spec))
    _check_options(reader, at, spec)
    reader.note_ranges(at, spec)
    if body is None:
        return None
    pins, joins = read_pins(reader, (*at, "pins"), spec.pins, body)
    followed = tuple(reader.files)
    around = Surroundings(tuple(colliders), characters, (), meshes, followed)
    return SpringSetup(spec, body, pins, joins, around, at)


def _body(reader: EntryReader, at: Location, spec: Any) -> SpringBody | None:
    families = families_of(reader, (*at, "springs"), spec.springs)
    mass = mass_of(reader, (*at, "mass"), spec.mass)
    return _BODIES[type(spec)](reader, at, spec, families, mass)


def _check_options(reader: EntryReader, at: Location, spec: SpringsModel) -> None:
    try:
        solver = check_options(options_of(spec))
        if contact_of(spec) is not None:
            check_keeping_apart(solver)
    except OptionError as error:
        for fault in error.faults:
            reader.note((*at, fault.where or ""), fault)


def _check_wind(reader: EntryReader, at: Location, model: WindModel | None) -> None:
    if model is None:
        return
    if any(after[0] <= before[0] for before, after in pairwise(model.gusts)):
        reader.note((*at, "gusts"), Fault("SIM044", "its times must ascend"))
    reader.note_ranges(at, model)
