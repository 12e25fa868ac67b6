"""FBX objects, their properties and connections."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import Any

from animtool.core.errors import Fault, FormatError, excerpt
from animtool.core.files.reading import read_input
from animtool.core.files.signatures import expects
from animtool.core.record import dataclass
from animtool.formats.fbx.binary import MAGIC, read_binary
from animtool.formats.fbx.elements import FLOAT32_LIMIT, Element
from animtool.formats.fbx.legacy import with_objects
from animtool.formats.fbx.text import looks_like_text, read_text
from animtool.formats.file_notices import FileNotices

# Below, nothing is known of the layout, and neither is it above.
OLDEST, NEWEST = 5000, 7999
# Before, models hold their children and skins.
WITH_OBJECTS = 6000
# From here on objects have numbers, and curves are objects.
NUMBERED = 7000

Id = int | str
ROOTS = (0, "Model::Scene", "Model::RootNode")


@dataclass(slots=True, eq=False)
class Object:
    """An object: a model, a geometry, a deformer, a curve.

    Attributes:
        id: Number, or kind and name in files before 7000.
        kind: Of element, as ``Model``.
        name: Without its kind, namespace kept.
        subtype: As ``LimbNode``.
        element: What is in it.
        properties: Values by name, without defaults.
        defaults: Those of its kind.
    """

    id: Id
    kind: str
    name: str
    subtype: str
    element: Element
    properties: dict[str, list[Any]]
    defaults: dict[str, list[Any]]

    def values(self, name: str) -> list[Any]:
        """Return the values of a property; empty where it has none."""
        stated = self.properties.get(name)
        return stated if stated is not None else self.defaults.get(name, [])


@dataclass(slots=True, eq=False)
class FbxFile:
    """The objects and connections of a file.

    Attributes:
        path: The file.
        version: As 7400.
        is_text: Whether it is ASCII.
        root: Its elements.
        objects: By number or name, in the order of the file.
        settings: Global properties.
        below: Of each object, what is connected to it: its id and the property.
        above: Of each object, what it is connected to, likewise.
        notes: What was put right.
    """

    path: Path
    version: int
    is_text: bool
    root: Element
    objects: dict[Id, Object]
    settings: Object
    notes: FileNotices
    below: dict[Id, list[tuple[Id, str]]] = field(default_factory=dict)
    above: dict[Id, list[tuple[Id, str]]] = field(default_factory=dict)

    def sources(self, of: Id, kind: str, subtype: str | None = None) -> list[Object]:
        """Return objects of a kind connected to an object as sources."""
        objects = [self.objects.get(one) for one, _ in self.below.get(of, ())]
        return [one for one in objects if one is not None and _is(one, kind, subtype)]

    def targets(self, of: Id, kind: str) -> list[Object]:
        """Return objects of a kind that an object is connected to."""
        objects = [self.objects.get(one) for one, _ in self.above.get(of, ())]
        return [one for one in objects if one is not None and one.kind == kind]

    def of_kind(self, kind: str, subtype: str | None = None) -> list[Object]:
        """Return all objects of a kind."""
        return [one for one in self.objects.values() if _is(one, kind, subtype)]


def _is(one: Object, kind: str, subtype: str | None) -> bool:
    return one.kind == kind and (subtype is None or one.subtype == subtype)


def vector(
    of: Object, name: str, default: tuple[float, ...], notes: FileNotices
) -> tuple[float, ...]:
    """Return a vector property with as many numbers as its default."""
    values = of.values(name)[: len(default)]
    if len(values) < len(default):
        return default
    if not all(isinstance(v, int | float) and abs(v) <= FLOAT32_LIMIT for v in values):
        message = f"{name} of {of.name!r} must be numbers, not {excerpt(str(values))}"
        notes.fail("FBX005", of.element.where, message)
    return tuple(float(value) for value in values)


def scalar(of: Object, name: str, default: float, notes: FileNotices) -> float:
    """Return a scalar property."""
    return vector(of, name, (default,), notes)[0]


@expects("FBX001", "an FBX file")
def open_objects(path: Path | str) -> FbxFile:
    """Open an FBX; return its objects.

    Raises:
        FormatError: It is none (FBX001), is broken (FBX001, FBX002), of a version that
            is not read (FBX003), or too large (FBX013).
    """
    path = Path(path)
    notes = FileNotices(str(path))
    content = read_input(path)
    is_text = not content.startswith(MAGIC)
    if is_text and not looks_like_text(content):
        message = "does not start like an FBX, binary or ASCII"
        raise FormatError(Fault("FBX001", message, str(path), where="byte 0"))
    version, root = (read_text if is_text else read_binary)(content, notes)
    version = _stated_version(root, version)
    if not OLDEST <= version <= NEWEST:
        message = f"version {version} is not supported, only {OLDEST} to {NEWEST}"
        hint = (
            "save it as FBX 2020 with Autodesk's FBX Converter or any tool that "
            "imports it"
        )
        notes.fail("FBX003", root.where, message, hint)
    if version < WITH_OBJECTS:
        root = with_objects(root, notes)
    templates = _templates(root)
    objects: dict[Id, Object] = {}
    settings = Object(-1, "GlobalSettings", "", "", root, {}, {})
    parts = [one for file in root.all("Objects") for one in file.children]
    for element in [*parts, *root.all("GlobalSettings")]:
        if element.name == "GlobalSettings":
            settings.properties |= _properties(element)
            continue
        one = _object(element, version, templates)
        if one is None:
            continue
        if one.id in objects:
            message = f"two objects have the ID {excerpt(str(one.id))}: using the first"
            notes.warn("FBX106", element.where, message)
            continue
        objects[one.id] = one
    file = FbxFile(path, version, is_text, root, objects, settings, notes)
    _connect(file)
    return file


def _stated_version(root: Element, version: int) -> int:
    """Return the version in the header element, which old files state there."""
    header = root.find("FBXHeaderExtension")
    stated = None if header is None else header.find("FBXVersion")
    if stated is not None and stated.values and isinstance(stated.values[0], int):
        return stated.values[0] if version < WITH_OBJECTS else version
    return version


def plain_name(text: str) -> tuple[str, str]:
    r"""Split an object name into kind and name.

    >>> plain_name("Model::hero:hips"), plain_name("hips\x00\x01Model")
    (('Model', 'hero:hips'), ('Model', 'hips'))
    """
    if "\x00\x01" in text:
        name, _, kind = text.partition("\x00\x01")
        return kind, name
    kind, colons, name = text.partition("::")
    return (kind, name) if colons else ("", text)


def _object(
    element: Element, version: int, templates: dict[str, dict[str, list[Any]]]
) -> Object | None:
    values = element.values
    first = 1 if version >= NUMBERED else 0
    kind, name = plain_name(element.text(first))
    id_: Id = f"{kind or element.name}::{name}"
    if first:
        if not values or not isinstance(values[0], int):
            return None
        id_ = values[0]
    elif not values:
        return None
    subtype = element.text(first + 1)
    properties = _properties(element)
    defaults = templates.get(element.name, {})
    return Object(id_, element.name, name, subtype, element, properties, defaults)


def _properties(element: Element) -> dict[str, list[Any]]:
    """Return the properties of an object, of either layout."""
    entries: dict[str, list[Any]] = {}
    for group, name, first in (
        ("Properties70", "P", 4),
        ("Properties60", "Property", 3),
    ):
        for properties in element.all(group):
            for one in properties.all(name):
                if one.values and isinstance(one.values[0], str):
                    entries[one.values[0]] = one.values[first:]
    return entries


def _templates(root: Element) -> dict[str, dict[str, list[Any]]]:
    """Return the default properties of each kind of object."""
    templates: dict[str, dict[str, list[Any]]] = {}
    for definitions in root.all("Definitions"):
        for kind in definitions.all("ObjectType"):
            for template in kind.all("PropertyTemplate"):
                # Attributes have one for each class; none of those moves anything.
                if kind.text(0) != "NodeAttribute":
                    templates.setdefault(kind.text(0), _properties(template))
    return templates


def _connect(file: FbxFile) -> None:
    for connections in file.root.all("Connections"):
        for one in connections.children:
            if one.name not in {"C", "Connect"} or len(one.values) < 3:
                continue
            below, above = (_id(value) for value in one.values[1:3])
            if below is None or above is None:
                continue
            name = one.text(3)
            file.below.setdefault(above, []).append((below, name))
            file.above.setdefault(below, []).append((above, name))


def _id(value: Any) -> Id | None:
    if isinstance(value, str):
        kind, name = plain_name(value)
        return f"{kind}::{name}"
    return value if isinstance(value, int) else None
