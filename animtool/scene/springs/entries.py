"""Reading ropes, strands, cloth and volumes of a scene file, all faults noted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from animtool.documents.document import Document, Location
from animtool.errors import Fault, OptionError
from animtool.scene.springs.bodies import SpringBody
from animtool.scene.springs.cloth_bodies import cloth_body
from animtool.scene.springs.contact_schema import SelfContactModel
from animtool.scene.springs.line_bodies import rope_body, strands_body
from animtool.scene.springs.pins import read_pins
from animtool.scene.springs.schema import (
    ClothModel,
    RopeModel,
    SpringsModel,
    StrandsModel,
    VolumeModel,
)
from animtool.scene.springs.setup import SpringSetup, Wind
from animtool.scene.springs.volume_bodies import volume_body
from animtool.scene.springs.wind_schema import FaceWindModel, WindModel
from animtool.scene.systems.entries import EntryReader
from animtool.sim.springs import SelfContact, SpringOptions
from animtool.sim.springs.options import check_options

__all__ = ["read_cloth", "read_rope", "read_strands", "read_volume"]


def read_rope(
    document: Document, at: Location, model: RopeModel, roots: Sequence[Path]
) -> SpringSetup | None:
    """Return the rope of an entry; None where what is noted leaves none."""
    return _read(document, at, model, roots, rope_body)


def read_strands(
    document: Document, at: Location, model: StrandsModel, roots: Sequence[Path]
) -> SpringSetup | None:
    """Return the strands of an entry; None where what is noted leaves none."""
    return _read(document, at, model, roots, strands_body)


def read_cloth(
    document: Document, at: Location, model: ClothModel, roots: Sequence[Path]
) -> SpringSetup | None:
    """Return the cloth of an entry; None where what is noted leaves none."""
    return _read(document, at, model, roots, cloth_body)


def read_volume(
    document: Document, at: Location, model: VolumeModel, roots: Sequence[Path]
) -> SpringSetup | None:
    """Return the volume of an entry; None where what is noted leaves none."""
    return _read(document, at, model, roots, volume_body)


def _read(
    document: Document,
    at: Location,
    model: SpringsModel,
    roots: Sequence[Path],
    make: Callable[[EntryReader, Location, Any], SpringBody | None],
) -> SpringSetup | None:
    reader = EntryReader(document, roots)
    body = make(reader, at, model)
    colliders = reader.colliders((*at, "colliders"), model.colliders)
    characters = reader.characters((*at, "characters"), model.characters)
    wind = getattr(model, "wind", None)
    winds = None if wind is None else _wind(reader, (*at, "wind"), wind)
    contact = _self_contact(getattr(model, "self_contact", None))
    options = _options(reader, at, model)
    for name in ("drag", "radius"):
        value = getattr(model, name)
        if value < 0:
            message = f"its {name} must be 0 or more, not {value:g}"
            reader.note((*at, name), Fault("SIM050", message))
    if not model.speed_limit > 0:
        message = f"its speed_limit must be above 0, not {model.speed_limit:g}"
        reader.note((*at, "speed_limit"), Fault("SIM050", message))
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
        tuple(reader.files),
    )


def _self_contact(model: SelfContactModel | None) -> SelfContact | None:
    if model is None:
        return None
    return SelfContact(model.thickness, model.friction, model.speed)


def _options(reader: EntryReader, at: Location, model: SpringsModel) -> SpringOptions:
    options = SpringOptions(
        model.solver, model.step, stretch=model.stretch, error=model.error
    )
    try:
        check_options(options)
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
    for name in ("density", "drag", "lift"):
        value = getattr(model, name)
        if value < 0:
            message = f"its {name} must be 0 or more, not {value:g}"
            reader.note((*at, name), Fault("SIM050", message))
    return Wind(made.velocity, gusts, (model.density, model.drag, model.lift))
