"""FBX objects, their properties and connections."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import Any

from animtool.core.errors import Fault, FormatError, excerpt
from animtool.core.files.reading import read_input
from animtool.core.files.signatures import expects_format
from animtool.core.record import dataclass
from animtool.formats import FLOAT32_MAX
from animtool.formats.fbx.binary import BINARY_MAGIC, read_binary
from animtool.formats.fbx.elements import Element
from animtool.formats.fbx.legacy import convert_to_objects
from animtool.formats.fbx.text import looks_like_text, read_text
from animtool.formats.file_diagnostics import FileDiagnostics

# Supported versions; the layout of others is unknown.
MIN_VERSION, MAX_VERSION = 5000, 7999
# First version with objects; in older ones models contain their children and skins.
FIRST_OBJECT_VERSION = 6000
# First version in which objects have numeric ids, and curves are objects.
FIRST_NUMBERED_VERSION = 7000

ObjectId = int | str
# By object id: the id of each connected object, and the name of the property.
Connections = dict[ObjectId, list[tuple[ObjectId, str]]]
ROOT_IDS = (0, "Model::Scene", "Model::RootNode")


@dataclass(slots=True, eq=False)
class FbxObject:
    """An object of a file, such as a model, a geometry, a deformer or a curve."""

    id: ObjectId  # number, or kind and name in files before 7000
    kind: str  # name of the element, such as ``Model``
    name: str  # name without the kind, namespace kept
    subtype: str  # subtype such as ``LimbNode``
    element: Element  # element of the object
    properties: dict[str, list[Any]]  # values by name, without defaults
    defaults: dict[str, list[Any]]  # default values of this kind of object

    def values(self, name: str) -> list[Any]:
        """Return the values of a property; empty if it is missing."""
        return self.properties.get(name, self.defaults.get(name, []))


@dataclass(slots=True, eq=False)
class FbxFile:
    """The objects of a file and the connections between them."""

    path: Path  # path of the file
    version: int  # version such as 7400
    root: Element  # the root element
    objects: dict[ObjectId, FbxObject]  # objects by id, in file order
    settings: FbxObject  # global properties
    diagnostics: FileDiagnostics  # collects warnings and notes
    incoming_connections: Connections = field(default_factory=dict)  # from sources
    outgoing_connections: Connections = field(default_factory=dict)  # to targets

    def sources(
        self, object_id: ObjectId, kind: str, subtype: str | None = None
    ) -> list[FbxObject]:
        """Return the objects of a kind that are connected to an object as sources."""
        connections = self.incoming_connections.get(object_id, ())
        objects = [self.objects.get(source_id) for source_id, _ in connections]
        return [c for c in objects if c is not None and _is_of_kind(c, kind, subtype)]

    def targets(self, object_id: ObjectId, kind: str) -> list[FbxObject]:
        """Return the objects of a kind that an object is connected to as a source."""
        connections = self.outgoing_connections.get(object_id, ())
        objects = [self.objects.get(target_id) for target_id, _ in connections]
        return [c for c in objects if c is not None and c.kind == kind]

    def objects_of_kind(self, kind: str, subtype: str | None = None) -> list[FbxObject]:
        """Return all objects of a kind, in file order."""
        return [c for c in self.objects.values() if _is_of_kind(c, kind, subtype)]


def _is_of_kind(candidate: FbxObject, kind: str, subtype: str | None) -> bool:
    return candidate.kind == kind and (subtype is None or candidate.subtype == subtype)


def read_vector(
    owner: FbxObject,
    name: str,
    default: tuple[float, ...],
    diagnostics: FileDiagnostics,
) -> tuple[float, ...]:
    """Return as many numbers of a property as the default has, else the default."""
    values = owner.values(name)[: len(default)]
    if len(values) < len(default):
        return default
    if not all(isinstance(v, int | float) and abs(v) <= FLOAT32_MAX for v in values):
        message = f"{name} of {owner.name!r} must be numbers, not "
        message += excerpt(str(values))
        diagnostics.fail("FBX005", owner.element.location, message)
    return tuple(float(value) for value in values)


def read_scalar(
    owner: FbxObject, name: str, default: float, diagnostics: FileDiagnostics
) -> float:
    """Return a scalar property, or the default if it is missing."""
    return read_vector(owner, name, (default,), diagnostics)[0]


@expects_format("FBX001", "an FBX file")
def open_objects(path: Path | str) -> FbxFile:
    """Read the objects and connections of an FBX file."""
    path = Path(path)
    diagnostics = FileDiagnostics(str(path))
    content = read_input(path)
    is_text = not content.startswith(BINARY_MAGIC)
    if is_text and not looks_like_text(content):
        message = "does not start like an FBX, binary or ASCII; export it again"
        raise FormatError(Fault("FBX001", message, str(path), where="byte 0"))
    version, root = (read_text if is_text else read_binary)(content, diagnostics)
    version = _find_version(root, version)
    if not MIN_VERSION <= version <= MAX_VERSION:
        message = f"version {version} is not supported, only {MIN_VERSION} to "
        message += f"{MAX_VERSION}"
        hint = "save it as FBX 2020 with Autodesk's FBX Converter or any tool that "
        hint += "imports it"
        diagnostics.fail("FBX003", root.location, message, hint)
    if version < FIRST_OBJECT_VERSION:
        root = convert_to_objects(root, diagnostics)
    default_properties = _default_properties(root)
    objects: dict[ObjectId, FbxObject] = {}
    settings = FbxObject(-1, "GlobalSettings", "", "", root, {}, {})
    elements = [child for e in root.find_all("Objects") for child in e.children]
    for element in [*elements, *root.find_all("GlobalSettings")]:
        if element.name == "GlobalSettings":
            settings.properties |= _read_properties(element)
            continue
        fbx_object = _read_object(element, version, default_properties)
        if fbx_object is None:
            continue
        if fbx_object.id in objects:
            message = f"two objects have the ID {excerpt(str(fbx_object.id))}: using "
            message += "the first"
            diagnostics.warn("FBX106", element.location, message)
            continue
        objects[fbx_object.id] = fbx_object
    file = FbxFile(path, version, root, objects, settings, diagnostics)
    _connect_objects(file)
    return file


def _find_version(root: Element, version: int) -> int:
    """Return the version of a file; old files state it in an element."""
    header = root.find("FBXHeaderExtension")
    element = None if header is None else header.find("FBXVersion")
    stated_version = element.values[0] if element and element.values else None
    is_old = version < FIRST_OBJECT_VERSION
    return stated_version if isinstance(stated_version, int) and is_old else version


def split_name(text: str) -> tuple[str, str]:
    r"""Split an object name into kind and name.

    >>> split_name("Model::hero:hips"), split_name("hips\x00\x01Model")
    (('Model', 'hero:hips'), ('Model', 'hips'))
    """
    if "\x00\x01" in text:
        name, _, kind = text.partition("\x00\x01")
        return kind, name
    kind, colons, name = text.partition("::")
    return (kind, name) if colons else ("", text)


def _read_object(
    element: Element, version: int, default_properties: dict[str, dict[str, list[Any]]]
) -> FbxObject | None:
    values = element.values
    name_index = 1 if version >= FIRST_NUMBERED_VERSION else 0
    kind, name = split_name(element.text(name_index))
    object_id: ObjectId = f"{kind or element.name}::{name}"
    if name_index:
        if not values or not isinstance(values[0], int):
            return None
        object_id = values[0]
    elif not values:
        return None
    subtype = element.text(name_index + 1)
    properties = _read_properties(element)
    defaults = default_properties.get(element.name, {})
    return FbxObject(
        object_id, element.name, name, subtype, element, properties, defaults
    )


def _read_properties(element: Element) -> dict[str, list[Any]]:
    """Return the properties of an object, of either layout."""
    values_by_name: dict[str, list[Any]] = {}
    for group, element_name, value_index in (
        ("Properties70", "P", 4),
        ("Properties60", "Property", 3),
    ):
        for properties in element.find_all(group):
            for values in (child.values for child in properties.find_all(element_name)):
                if values and isinstance(values[0], str):
                    values_by_name[values[0]] = values[value_index:]
    return values_by_name


def _default_properties(root: Element) -> dict[str, dict[str, list[Any]]]:
    """Return the default properties of each kind of object."""
    default_properties: dict[str, dict[str, list[Any]]] = {}
    for definitions in root.find_all("Definitions"):
        for object_type in definitions.find_all("ObjectType"):
            for template in object_type.find_all("PropertyTemplate"):
                # Node attributes have a template per class; none affects motion.
                if object_type.text(0) != "NodeAttribute":
                    default_properties.setdefault(
                        object_type.text(0), _read_properties(template)
                    )
    return default_properties


def _connect_objects(file: FbxFile) -> None:
    for connections in file.root.find_all("Connections"):
        for connection in connections.children:
            if connection.name not in {"C", "Connect"} or len(connection.values) < 3:
                continue
            source, target = (_object_id(value) for value in connection.values[1:3])
            if source is None or target is None:
                continue
            name = connection.text(3)
            file.incoming_connections.setdefault(target, []).append((source, name))
            file.outgoing_connections.setdefault(source, []).append((target, name))


def _object_id(value: Any) -> ObjectId | None:
    if isinstance(value, str):
        kind, name = split_name(value)
        return f"{kind}::{name}"
    return value if isinstance(value, int) else None
