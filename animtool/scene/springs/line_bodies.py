"""Ropes and strands of entries."""

from __future__ import annotations

import numpy as np

from animtool._types import FloatArray
from animtool.documents.document import Location
from animtool.errors import Fault
from animtool.scene.springs.bodies import MOST, Families, SpringBody, mass_of
from animtool.scene.springs.schema import RopeModel, StrandsModel
from animtool.scene.springs.shapes import Curves
from animtool.scene.systems.entries import EntryReader
from animtool.sim.springs import join, rope, strand


def rope_body(
    reader: EntryReader,
    at: Location,
    model: RopeModel,
    families: Families,
    mass: float,
) -> SpringBody | None:
    """Return a rope; None where what is noted leaves none."""
    if not 2 <= model.count <= MOST:
        message = f"a rope has 2 to {MOST} particles, not {model.count}"
        reader.note((*at, "count"), Fault("SIM050", message))
    if model.start == model.end:
        message = "it begins and ends at one place"
        reader.note((*at, "to"), Fault("SIM050", message))
    tip = model.tip_mass
    if tip is not None:
        tip = mass_of(reader, (*at, "tip_mass"), tip)
    if not reader.sound:
        return None
    count = model.count
    body = rope(
        model.start,
        model.end,
        count,
        families["structural"],
        mass=mass / count,
        tip_mass=tip,
        bend=families["bend"],
    )
    places = {"start": np.array([0]), "end": np.array([count - 1])}
    shape = Curves(np.array([count]), 2 * model.radius, body.springs)
    return SpringBody(body, places, shape)


def strands_body(
    reader: EntryReader,
    at: Location,
    model: StrandsModel,
    families: Families,
    mass: float,
) -> SpringBody | None:
    """Return strands; None where what is noted leaves none."""
    points = reader.array((*at, "points"), model.points, "points")
    if points is not None and not _are_strands(points):
        message = f"strands have the shape (strands, 2 or more, 3), not {points.shape}"
        reader.note((*at, "points"), Fault("SIM050", message))
    if points is None or not reader.sound:
        return None
    many, length = points.shape[:2]
    each = mass / (many * length)
    along, bend = families["structural"], families["bend"]
    body = join([strand(row, along, mass=each, bend=bend) for row in points])
    numbers = np.arange(many * length).reshape(many, length)
    places = {"roots": numbers[:, 0], "tips": numbers[:, -1]}
    shape = Curves(np.full(many, length), 2 * model.radius, body.springs)
    return SpringBody(body, places, shape)


def _are_strands(points: FloatArray) -> bool:
    return points.ndim == 3 and points.shape[1] >= 2 and points.shape[2] == 3
