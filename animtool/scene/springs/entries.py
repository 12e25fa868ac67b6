"""Reading ropes, strands, cloth and volumes of a scene file, all faults noted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from animtool.documents.document import Document, Location
from animtool.errors import Fault, OptionError
from animtool.scene.springs.bodies import SpringBody, families_of, mass_of
from animtool.scene.springs.parts_schema import (
    FaceWindModel,
    SelfContactModel,
    WindModel,
)
from animtool.scene.springs.pins import read_pins
from animtool.scene.springs.schema import (
    ClothModel,
    RopeModel,
    SpringsModel,
    StrandsModel,
    VolumeModel,
)
from animtool.scene.springs.setup import SpringSetup, Wind
from animtool.scene.springs.shaped_bodies import (
    cloth_body,
    rope_body,
    strands_body,
    volume_body,
)
from animtool.scene.systems.entries import EntryReader
from animtool.systems.springs import SelfContact, SpringOptions
from animtool.systems.springs.options import check_keeping_apart, check_options

_BODIES: dict[type[SpringsModel], Callable[..., SpringBody | None]] = {
    ClothModel: cloth_body,
    RopeModel: rope_body,
    StrandsModel: strands_body,
    VolumeModel: volume_body,
}


def read_springs(
    document: Document, at: Location, model: SpringsModel, roots: Sequence[Path]
) -> SpringSetup | None:
    """Return what an entry is made of; None where what is noted leaves nothing.

    Args:
        document: Where faults are noted.
        at: Place of the entry.
        model: What it says.
        roots: Folders that files may be in.
    """
    reader = EntryReader(document, roots)
    body = _body(reader, at, model)
    colliders = reader.colliders((*at, "colliders"), model.colliders)
    characters = reader.characters((*at, "characters"), model.characters)
    meshes = reader.meshes((*at, "meshes"), model.meshes)
    wind = getattr(model, "wind", None)
    winds = None if wind is None else _wind(reader, (*at, "wind"), wind)
    contact = _self_contact(model)
    options = _options(reader, at, model)
    reader.note_ranges(at, model)
    if body is None:
        return None
    pins, joins = read_pins(reader, (*at, "pins"), model.pins, body)
    return SpringSetup(
        body,
        pins,
        joins,
        np.array(model.gravity),
        model.drag,
        model.radius,
        model.speed_limit,
        winds,
        contact,
        tuple(colliders),
        characters,
        options,
        model.preroll,
        model.settle,
        frozenset(model.model_fields_set),
        at,
        meshes,
        tuple(reader.files),
    )


def _body(reader: EntryReader, at: Location, model: Any) -> SpringBody | None:
    families = families_of(reader, (*at, "springs"), model.springs)
    mass = mass_of(reader, (*at, "mass"), model.mass)
    return _BODIES[type(model)](reader, at, model, families, mass)


def _self_contact(model: SpringsModel) -> SelfContact | None:
    given: SelfContactModel | None = getattr(model, "self_contact", None)
    if given is None:
        return None
    return SelfContact(given.thickness, given.friction, given.speed)


def _options(reader: EntryReader, at: Location, model: SpringsModel) -> SpringOptions:
    options = SpringOptions(
        model.solver, model.step, stretch=model.stretch, error=model.error
    )
    try:
        solver = check_options(options)
        if _self_contact(model) is not None:
            check_keeping_apart(solver)
    except OptionError as error:
        for fault in error.faults:
            reader.note((*at, fault.where or ""), fault)
    return options


def _wind(reader: EntryReader, at: Location, model: WindModel) -> Wind:
    gusts = np.array(model.gusts).reshape(-1, 4)
    if (np.diff(gusts[:, 0]) <= 0).any():
        reader.note((*at, "gusts"), Fault("SIM044", "its times must ascend"))
    made = Wind(np.array(model.velocity), gusts)
    if not isinstance(model, FaceWindModel):
        return made
    reader.note_ranges(at, model)
    return Wind(made.velocity, gusts, (model.density, model.drag, model.lift))
