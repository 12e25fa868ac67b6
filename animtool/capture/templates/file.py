"""Marker template files, ``*.markers.yaml``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Len
from pydantic import Field

from animtool.capture.templates.template import MarkerTemplate, TemplateMarker
from animtool.core.errors import counted, listed
from animtool.core.options import key
from animtool.core.quantities import length_text
from animtool.core.units import LengthUnit, likely_unit
from animtool.documents.check import FileModel, validate_file
from animtool.documents.document import Document, Location, read_document
from animtool.documents.fields import IgnoreModel, Name, Real, Vector
from animtool.documents.references import resolve_named_rig
from animtool.rig.sides import pair_sides

# Largest distance of a marker from its joint [m]; larger numbers mean another unit.
MAX_OFFSET = 10.0
# If so many markers are off their joints, but none farther than this, the unit is
# another, too [m].
MIN_OFFSET, MIN_OFFSET_MARKERS = 0.001, 4
# Largest offset on a body [m].
TYPICAL_OFFSET = 0.3


class MarkerUnitsModel(FileModel):
    """Key ``units`` of a marker template: the unit of its offsets."""

    length: Literal["m", "cm", "mm", "in"] = key("Of offsets.", "mm", default="m")


class MarkerModel(FileModel):
    """An entry of ``marker_set``: a marker, and the joint that carries it."""

    name: Name = key("Name in captures, without the name of the subject.", "LFHD")
    joint: Name = key("The joint it is attached to.", "head")
    offset: Vector = key("Its position in the joint's frame.", [0.07, 0.1, 0.08])
    weight: Annotated[Real, Field(ge=0)] = key(
        "Its weight in a solve, relative to 1 for the others; 0 ignores it.",
        0.5,
        default=1.0,
    )
    fixed: bool = key(
        "Whether calibration keeps the offset, as for a marker on a measured landmark.",
        True,
        default=False,
    )
    aliases: list[Name] = key("Other names in captures.", ["LeftFrontHead"], default=[])


class MarkersModel(FileModel):
    """Schema of a marker template file, ``*.markers.yaml``."""

    markers: Literal["animtool/1"] = key("File type and format version.", "animtool/1")
    rig: str | None = key(
        "The rig of the markers. Default: the command line or the scene names it.",
        "hero.rig.yaml",
        default=None,
    )
    units: MarkerUnitsModel = key(
        "Units of the numbers in the file.",
        {"length": "mm"},
        default=MarkerUnitsModel(),
    )
    marker_set: Annotated[list[MarkerModel], Len(1)] = key(
        "The markers.", [{"name": "LFHD", "joint": "head", "offset": [0.07, 0.1, 0.08]}]
    )
    ignore: list[IgnoreModel] = key(
        "Findings of `animtool validate` that are accepted.",
        [{"code": "MKT003", "why": "the prop is this large"}],
        default=[],
    )


def load_template(path: Path | str, rig: Path | None = None) -> MarkerTemplate:
    """Read a marker template; its joints are checked by `MarkerTemplate.joints`.

    Args:
        path: The file.
        rig: Rig file to use in place of the one it names, which may then be missing.

    Raises:
        FormatError: The file cannot be read or is malformed; lists every fault.
    """
    document = read_document(Path(path), "markers")
    return parse_template(document, has_other_rig=rig is not None)


def _check_names(document: Document, model: MarkersModel) -> None:
    """Record a fault for each name or alias that another marker has (MKT002)."""
    index_by_name: dict[str, int] = {}
    for i, marker in enumerate(model.marker_set):
        if marker.name in index_by_name:
            other_location = f"marker_set[{index_by_name[marker.name]}]"
            message = f"two markers are called {marker.name!r}"
            hint = f"rename it here, or in {other_location}"
            document.add("MKT002", ("marker_set", i, "name"), message, hint)
        index_by_name.setdefault(marker.name, i)
    index_by_alias: dict[str, int] = {}
    for i, marker in enumerate(model.marker_set):
        for k, alias in enumerate(marker.aliases):
            location: Location = ("marker_set", i, "aliases", k)
            message, hint = "", "remove the alias"
            if alias in index_by_name:
                other_location = f"marker_set[{index_by_name[alias]}]"
                message = f"the alias {alias!r} is the name of {other_location}"
                if index_by_name[alias] == i:
                    message = f"the alias {alias!r} is the name of the marker itself"
            elif index_by_alias.get(alias) == i:
                message = f"the alias {alias!r} is listed twice"
                hint = "remove one of them"
            elif alias in index_by_alias:
                other_location = f"marker_set[{index_by_alias[alias]}]"
                message = f"the alias {alias!r} is an alias of {other_location} too"
                hint = "remove one of them"
            if message:
                document.add("MKT002", location, message, hint)
            index_by_alias.setdefault(alias, i)


def parse_template(
    document: Document, *, has_other_rig: bool = False
) -> MarkerTemplate:
    """Convert a template document to a template with offsets in metres; check it."""
    model = validate_file(document, "markers", MarkersModel)
    meters_per_unit = LengthUnit(model.units.length).meters
    _check_names(document, model)
    markers = []
    for marker in model.marker_set:
        x, y, z = (value * meters_per_unit for value in marker.offset)
        markers.append(
            TemplateMarker(
                marker.name,
                marker.joint,
                (x, y, z),
                marker.weight,
                marker.fixed,
                tuple(marker.aliases),
            )
        )
    if all(marker.weight == 0 for marker in model.marker_set):
        message = "every marker has weight 0"
        document.add("MKT004", ("marker_set",), message, "leave out some weights")
    rig = resolve_named_rig(document, model.rig, is_replaced=has_other_rig)
    document.check()
    _warn_of_offsets(document, markers, LengthUnit(model.units.length))
    _warn_of_swapped_sides(document, markers)
    return MarkerTemplate(tuple(markers), rig, document)


def _warn_of_offsets(
    document: Document, markers: Sequence[TemplateMarker], unit: LengthUnit
) -> None:
    """Warn if an offset is above `MAX_OFFSET`, or all are tiny (MKT003)."""
    sizes = [max(map(abs, marker.offset)) for marker in markers]
    farthest = max(range(len(sizes)), key=sizes.__getitem__)
    max_size = sizes[farthest]
    if not max_size:
        return
    nearest_unit, converted_size = likely_unit(max_size, unit, TYPICAL_OFFSET)
    hint = f"write units: {{length: {nearest_unit}}} in the template: then it is "
    hint += length_text(converted_size)
    if max_size > MAX_OFFSET:
        message = f"{markers[farthest].name!r} is {length_text(max_size)} off its joint"
        count = sum(size > MAX_OFFSET for size in sizes)
        if count > 1:
            message += f"; {count} markers are more than {MAX_OFFSET:g} m off theirs"
        if nearest_unit is unit:
            hint = f"are the offsets in {unit}?"
    elif max_size < MIN_OFFSET and sum(map(bool, sizes)) >= MIN_OFFSET_MARKERS:
        message = f"all markers are within {length_text(max_size)} of their joints"
        if nearest_unit is unit:
            hint = f"offsets are in {unit}: were they divided by 1000 twice?"
    else:
        return
    document.warn("MKT003", ("marker_set", farthest, "offset"), message, hint)


def _warn_of_swapped_sides(
    document: Document, markers: Sequence[TemplateMarker]
) -> None:
    """Warn of left and right markers that are on the other side's joints (MKT005)."""
    joints = list(dict.fromkeys(marker.joint for marker in markers))
    joint_pairs = pair_sides(joints)
    marker_pairs = pair_sides([marker.name for marker in markers])
    left_joints = {joints[j] for j in joint_pairs.left}
    partner_by_joint = {
        joints[j]: joints[p] for j, p in enumerate(joint_pairs.partners)
    }
    swaps: list[int] = []
    for left in marker_pairs.left:
        right = int(marker_pairs.partners[left])
        joint = markers[left].joint
        is_on_partner = partner_by_joint[joint] == markers[right].joint != joint
        if is_on_partner and joint not in left_joints:
            swaps += [left, right]
    if not swaps:
        return
    first = min(swaps)
    marker = markers[first]
    other_joint = partner_by_joint[marker.joint]
    names = [f"{markers[i].name} on {markers[i].joint}" for i in sorted(swaps)]
    message = f"{len(swaps)} of {counted(len(markers), 'marker')} are on joints of "
    message += f"the other side: {listed(names, 4)}"
    hint = f"for {marker.name} write joint: {other_joint}"
    document.warn("MKT005", ("marker_set", first, "joint"), message, hint)
