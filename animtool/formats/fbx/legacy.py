"""FBX of versions 5000 to 5999 in the layout of 6100: objects and connections.

A model contains its children by name, its transform as default values of channels, and
its skin as links.
"""

from __future__ import annotations

from animtool.core.errors import excerpt
from animtool.formats.fbx.elements import Element, number
from animtool.formats.file_notices import FileNotices

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


def with_objects(root: Element, notes: FileNotices) -> Element:
    """Convert the elements of versions 5000 to 5999 to the 6100 layout."""
    objects = Element("Objects", [], root.where)
    links = Element("Connections", [], root.where)
    for model in root.all("Model"):
        _add_model(model, objects, links, notes)
    settings = Element("Version5", [], root.where, list(root.all("Settings")))
    takes = list(root.all("Takes"))
    return Element("", [], root.where, [objects, links, settings, *takes])


def _add_model(
    model: Element, objects: Element, links: Element, notes: FileNotices
) -> None:
    name = model.text(0)
    for child in model.children:
        if child.name in _UNSUPPORTED_PROPERTIES:
            message = f"{child.name} of {name!r} is not supported in files this old"
            notes.fail("FBX004", child.where, excerpt(message))
    kind = model.find("Type")
    subtype = "Mesh" if model.find("Vertices") else kind.text(0) if kind else ""
    geometry_elements = [c for c in model.children if c.name in _GEOMETRY_ELEMENTS]
    new_model = Element(
        "Model", [f"Model::{name}", subtype], model.where, geometry_elements
    )
    new_model.children.append(_property_elements(model, notes))
    objects.children.append(new_model)
    for children in model.all("Children"):
        for child in children.values:
            if isinstance(child, str):
                _add_connection(links, f"Model::{child}", f"Model::{name}")
    skin = f"Deformer::{name}"
    bones = list(model.all("Link"))
    if bones:
        objects.children.append(Element("Deformer", [skin, "Skin"], model.where))
        _add_connection(links, skin, f"Model::{name}")
    for bone in bones:
        cluster = f"SubDeformer::{name} {bone.text(0)}"
        values = [cluster, "Cluster"]
        objects.children.append(Element("Deformer", values, bone.where, bone.children))
        _add_connection(links, cluster, skin)
        _add_connection(links, f"Model::{bone.text(0)}", cluster)


def _property_elements(model: Element, notes: FileNotices) -> Element:
    properties = Element("Properties60", [], model.where)
    for channel in model.all("Channel"):
        if channel.text(0) != "Transform":
            default = channel.find("Default")
            if default is not None:
                start = [channel.text(0).removesuffix(SHAPE_SUFFIX), "", ""]
                row = [*start, number(default, 0, notes)]
                properties.children.append(Element("Property", row, channel.where))
            continue
        for channels in channel.all("Channel"):
            name = _PROPERTY_NAMES.get(channels.text(0))
            if name is None:
                continue
            values = [1.0 if channels.text(0) == "S" else 0.0] * 3
            for axis_channel in channels.all("Channel"):
                default = axis_channel.find("Default")
                axis = "XYZ".find(axis_channel.text(0)) if axis_channel.text(0) else -1
                if default is not None and axis >= 0:
                    values[axis] = number(default, 0, notes)
            row = [name, "", "", *values]
            properties.children.append(Element("Property", row, channels.where))
    return properties


def _add_connection(links: Element, child: str, parent: str) -> None:
    links.children.append(Element("Connect", ["OO", child, parent], links.where))
