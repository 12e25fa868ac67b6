"""Reads URDF links: masses, collision shapes and visuals."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from animtool.core.errors import Severity, excerpt
from animtool.formats.robots.notes import XmlNotes, element_label
from animtool.formats.robots.parts import LinkMass, SimpleShape
from animtool.formats.robots.solids import find_mass_problem
from animtool.formats.robots.xml import XmlElement
from animtool.formats.urdf.elements import (
    UrdfLink,
    Visual,
    find_single_child,
    read_pose,
    require_text,
)
from animtool.maths import so3


def add_link(element: XmlElement, links: dict[str, UrdfLink], notes: XmlNotes) -> None:
    """Add a link to the file's links; record faults."""
    name = require_text(element, "name", None, notes)
    if not name:
        return
    where = element_label("link", name)
    if name in links:
        first_line = links[name].element.line
        message = f"two links are named {excerpt(name)}"
        notes.add("URD009", element, message, f"the first is in line {first_line}")
        return
    link = links[name] = UrdfLink(element, name)
    inertial = find_single_child(element, "inertial", where, notes)
    if inertial is not None:
        link.weight = _read_mass(inertial, where, notes)
    link.meshes += [
        mesh
        for visual_element in (*element.all("visual"), *element.all("collision"))
        for geometry in visual_element.all("geometry")
        for mesh in geometry.all("mesh")
        if mesh.attributes.get("filename")
    ]
    for shape_element in element.all("collision"):
        solid = _read_shape(shape_element, where, notes)
        if solid is not None:
            link.solids.append(solid)
    for shape_element in element.all("visual"):
        link.visuals += _read_visual(shape_element, where, notes)


def _read_visual(element: XmlElement, where: str, notes: XmlNotes) -> Iterator[Visual]:
    """Yield a link's visual; skip an invalid one with a notice."""
    visual_notes = XmlNotes(notes.path, notes.number_code)
    meshes = [m for g in element.all("geometry") for m in g.all("mesh")]
    visual: Visual | None = None
    if meshes and meshes[0].attributes.get("filename"):
        position, rotation = read_pose(element, where, visual_notes)
        x, y, z = visual_notes.numbers(meshes[0], "scale", 3, (1.0, 1.0, 1.0), where)
        visual = Visual(
            meshes[0], SimpleShape("mesh", (), position, rotation), (x, y, z)
        )
    elif not meshes:
        solid = _read_shape(element, where, visual_notes)
        visual = None if solid is None else Visual(None, solid)
    if visual_notes.faults:
        notes.leave_out(["visuals with faults"])
    elif visual is not None:
        yield visual
    else:
        notes.leave_out(["visuals without a shape"])


def _read_mass(inertial: XmlElement, where: str, notes: XmlNotes) -> LinkMass | None:
    """Return a link's mass; warn and return None if impossible."""
    position, rotation = read_pose(inertial, where, notes)
    fault_count = len(notes.faults)
    mass_element = find_single_child(inertial, "mass", where, notes)
    tensor = find_single_child(inertial, "inertia", where, notes)
    mass = 0.0
    if mass_element is not None:
        mass = notes.number(mass_element, "value", 0.0, where)
    inertia = np.zeros((3, 3))
    if tensor is not None:
        for i, row_axis in enumerate("xyz"):
            for j, column_axis in enumerate("xyz"[i:], i):
                value = notes.number(tensor, f"i{row_axis}{column_axis}", 0.0, where)
                inertia[i, j] = inertia[j, i] = value
    if len(notes.faults) > fault_count:
        return None
    if not mass and not inertia.any():
        return None  # a frame without mass
    problem = find_mass_problem(mass, inertia)
    if problem:
        message = f"no body can have this mass: {problem}; it is ignored"
        hint = "bodies of a ragdoll then weigh what the density of colliders gives"
        notes.add(
            "URD107", inertial, message, hint, where=where, severity=Severity.WARNING
        )
        return None
    matrix = so3.to_matrix(np.array(rotation))
    return LinkMass(mass, position, matrix @ inertia @ matrix.T)


def _read_shape(element: XmlElement, where: str, notes: XmlNotes) -> SimpleShape | None:
    """Return a collision shape; None, with a notice, for meshes."""
    geometry = find_single_child(element, "geometry", where, notes)
    shape = next(iter(geometry.children), None) if geometry is not None else None
    if shape is None or shape.tag not in _SHAPE_ATTRIBUTES:
        tag = "of no shape" if shape is None else f"of <{shape.tag[:40]}>"
        notes.leave_out(
            ["collision meshes" if tag == "of <mesh>" else f"collisions {tag}"]
        )
        return None
    position, rotation = read_pose(element, where, notes)
    size: list[float] = []
    fault_count = len(notes.faults)
    for name, count in _SHAPE_ATTRIBUTES[shape.tag]:
        if require_text(shape, name, where, notes):
            size += notes.numbers(shape, name, count, (1.0,) * count, where)
    if len(notes.faults) > fault_count:
        return None
    if min(size) <= 0:
        notes.leave_out(["collisions without size"])
        return None
    return SimpleShape(shape.tag, tuple(size), position, rotation)


# Shapes and their attributes.
_SHAPE_ATTRIBUTES: dict[str, tuple[tuple[str, int], ...]] = {
    "box": (("size", 3),),
    "sphere": (("radius", 1),),
    "cylinder": (("radius", 1), ("length", 1)),
    "capsule": (("radius", 1), ("length", 1)),
}
