"""Converts FBX 5000 to 5999 to the layout of 6100, with objects and connections.

A model contains its children by name, its transform as default values of channels, and
its skin as links.
"""

from __future__ import annotations

from animtool.core.errors import excerpt
from animtool.formats.fbx.elements import Element, read_number
from animtool.formats.file_diagnostics import FileDiagnostics

_PROPERTY_NAMES = {"T": "Lcl Translation", "R": "Lcl Rotation", "S": "Lcl Scaling"}
# Suffix of a shape's channel name.
SHAPE_SUFFIX = " (Shape)"
_GEOMETRY_ELEMENTS = ("Vertices", "PolygonVertexIndex", "Shape")
# Elements that change the pose, but are not supported in such files.
_UNSUPPORTED_PROPERTIES = (
    *("PreRotation", "PostRotation", "RotationOrder", "RotationPivot", "ScalingPivot"),
    *("RotationOffset", "ScalingOffset", "GeometricTranslation", "GeometricRotation"),
    *("GeometricScaling", "InheritType"),
)


def convert_to_objects(root: Element, diagnostics: FileDiagnostics) -> Element:
    """Convert the elements of versions 5000 to 5999 to the 6100 layout."""
    objects = Element("Objects", [], root.location)
    connections = Element("Connections", [], root.location)
    for model in root.find_all("Model"):
        _add_model(model, objects, connections, diagnostics)
    settings = Element("Version5", [], root.location, list(root.find_all("Settings")))
    takes = list(root.find_all("Takes"))
    return Element("", [], root.location, [objects, connections, settings, *takes])


def _add_model(
    model: Element, objects: Element, connections: Element, diagnostics: FileDiagnostics
) -> None:
    name = model.text(0)
    for child in model.children:
        if child.name in _UNSUPPORTED_PROPERTIES:
            message = f"{child.name} of {name!r} is not supported in files this old"
            diagnostics.fail("FBX004", child.location, excerpt(message))
    type_element = model.find("Type")
    subtype = type_element.text(0) if type_element else ""
    if model.find("Vertices"):
        subtype = "Mesh"
    geometry_elements = [c for c in model.children if c.name in _GEOMETRY_ELEMENTS]
    new_model = Element(
        "Model", [f"Model::{name}", subtype], model.location, geometry_elements
    )
    new_model.children.append(_property_elements(model, diagnostics))
    objects.children.append(new_model)
    for children in model.find_all("Children"):
        for child in children.values:
            if isinstance(child, str):
                _add_connection(connections, f"Model::{child}", f"Model::{name}")
    skin_name = f"Deformer::{name}"
    bones = list(model.find_all("Link"))
    if bones:
        objects.children.append(
            Element("Deformer", [skin_name, "Skin"], model.location)
        )
        _add_connection(connections, skin_name, f"Model::{name}")
    for bone in bones:
        cluster_name = f"SubDeformer::{name} {bone.text(0)}"
        values = [cluster_name, "Cluster"]
        objects.children.append(
            Element("Deformer", values, bone.location, bone.children)
        )
        _add_connection(connections, cluster_name, skin_name)
        _add_connection(connections, f"Model::{bone.text(0)}", cluster_name)


def _property_elements(model: Element, diagnostics: FileDiagnostics) -> Element:
    properties = Element("Properties60", [], model.location)
    for channel in model.find_all("Channel"):
        if channel.text(0) != "Transform":
            default = channel.find("Default")
            if default is not None:
                label_values = [channel.text(0).removesuffix(SHAPE_SUFFIX), "", ""]
                property_values = [*label_values, read_number(default, 0, diagnostics)]
                properties.children.append(
                    Element("Property", property_values, channel.location)
                )
            continue
        for property_channel in channel.find_all("Channel"):
            name = _PROPERTY_NAMES.get(property_channel.text(0))
            if name is None:
                continue
            values = [1.0 if property_channel.text(0) == "S" else 0.0] * 3
            for axis_channel in property_channel.find_all("Channel"):
                default = axis_channel.find("Default")
                axis = "XYZ".find(axis_channel.text(0)) if axis_channel.text(0) else -1
                if default is not None and axis >= 0:
                    values[axis] = read_number(default, 0, diagnostics)
            property_values = [name, "", "", *values]
            properties.children.append(
                Element("Property", property_values, property_channel.location)
            )
    return properties


def _add_connection(connections: Element, child: str, parent: str) -> None:
    connections.children.append(
        Element("Connect", ["OO", child, parent], connections.location)
    )
