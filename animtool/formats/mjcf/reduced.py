"""Reduces an MJCF to bodies, joints and shapes, so that it compiles without files."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import field
from xml.sax.saxutils import quoteattr

from animtool.core.errors import Severity, counted, excerpt, listed
from animtool.core.record import dataclass
from animtool.formats.robots.diagnostics import XmlDiagnostics, element_label, to_number
from animtool.formats.robots.packages import OutsideError, PackageFolders
from animtool.formats.robots.xml import XmlElement

MAX_LISTED_FILES = 8

# Sections that a rig cannot store, and their labels.
_SECTION_LABELS = {
    "actuator": "actuators",
    "asset": "assets",
    "contact": "contacts",
    "custom": "custom data",
    "deformable": "deformables",
    "extension": "extensions",
    "keyframe": "keyframes",
    "option": "options",
    "sensor": "sensors",
    "size": "",
    "statistic": "",
    "tendon": "tendons",
    "visual": "visuals",
}
_BODY_CONTENT_LABELS = {"camera": "cameras", "light": "lights", "plugin": "plugins"}
_DEFAULT_TAGS = frozenset({"default", "equality", "joint", "geom", "site"})
# Elements that MuJoCo expands from other files or by plug-ins.
_GENERATOR_TAGS = frozenset({"attach", "composite", "flexcomp"})
# Attributes that refer to removed elements, or change the set of bodies.
_DROPPED_ATTRIBUTES = {
    "geom": ("material", "mesh", "hfield", "user"),
    "site": ("material", "user"),
    "body": ("user", "fuse"),
    "joint": ("user", "align"),
    "freejoint": ("align",),
    "compiler": (
        *("assetdir", "meshdir", "texturedir", "strippath", "fusestatic"),
        *("discardvisual", "exactmeshinertia", "alignfree"),
    ),
}
# Attributes that rotate bodies with a free joint to their axes of inertia, which depend
# on meshes.
_ALIGNMENTS = frozenset({"align", "alignfree"})
_MESH_TYPES = frozenset({"mesh", "hfield", "sdf"})
# Text attributes, which may be "nan", unlike numbers.
_TEXT_ATTRIBUTES = frozenset(
    {
        *("name", "class", "childclass", "joint", "joint1", "joint2", "site", "type"),
        *("angle", "eulerseq", "model", "prefix"),
    }
)
# Smaller masses and inertias count as zero [kg], [kg m²].
MIN_MASS, MIN_INERTIA = 1e-9, 1e-13


@dataclass(frozen=True, slots=True, eq=False)
class ReducedModel:
    """A model of only bodies, joints and simple shapes."""

    text: str  # the XML
    elements: list[XmlElement]  # source element of each line
    bodies: list[str]  # body of each line; empty outside bodies
    # Bodies whose mass depends on meshes, which are not read.
    bodies_of_unknown_mass: frozenset[str]
    # Whether there are actuators, and each acts on a joint.
    has_only_joint_actuators: bool
    actuated_joints: frozenset[str]  # joints with actuators


def reduce_model(
    root: XmlElement, packages: PackageFolders, diagnostics: XmlDiagnostics
) -> ReducedModel:
    """Return a model's moving parts; record omissions and faults."""
    _check_files(root, packages, diagnostics)
    _name_bodies(root)
    reduced_lines = _ReducedLines(_MeshDefaults(root), diagnostics)
    model = root.attributes.get("model")
    attribute = "" if model is None else f" model={quoteattr(model)}"
    reduced_lines.add_line(root, f"<mujoco{attribute}>")
    # Written before the file's defaults, which may override these.
    reduced_lines.add_line(
        XmlElement("compiler", {}, root.path, root.line, root.column),
        f'<compiler boundmass="{MIN_MASS}" boundinertia="{MIN_INERTIA}"/>',
    )
    for section in root.children:
        if section.tag in _SECTION_LABELS:
            diagnostics.record_ignored(filter(None, [_SECTION_LABELS[section.tag]]))
        else:
            reduced_lines.add_element(section, section.tag, "", "")
    reduced_lines.add_line(root, "</mujoco>")
    bodies_with_inertia = {
        body.attributes.get("name", "")
        for body in root.walk()
        if body.tag == "body" and body.find_all("inertial")
    }
    actuated_joints = frozenset(
        actuator.attributes.get("joint", "")
        for section in root.find_all("actuator")
        for actuator in section.children
        if actuator.tag != "plugin"
    )
    return ReducedModel(
        "\n".join(reduced_lines.lines),
        reduced_lines.elements,
        reduced_lines.bodies,
        frozenset(reduced_lines.bodies_of_unknown_mass - bodies_with_inertia),
        bool(actuated_joints) and "" not in actuated_joints,
        actuated_joints,
    )


@dataclass(frozen=True, slots=True)
class _ReducedLines:
    """Lines of a reduced model, each with its source element."""

    mesh_defaults: _MeshDefaults
    diagnostics: XmlDiagnostics
    lines: list[str] = field(default_factory=list)
    elements: list[XmlElement] = field(default_factory=list)
    bodies: list[str] = field(default_factory=list)
    bodies_of_unknown_mass: set[str] = field(default_factory=set)

    def add_line(self, element: XmlElement, text: str, body: str = "") -> None:
        """Add a line of XML with its source element and body."""
        self.lines.append(text)
        self.elements.append(element)
        self.bodies.append(body)

    def add_element(
        self, element: XmlElement, section: str, childclass: str, body: str
    ) -> None:
        """Add an element with its supported children; geoms of meshes are ignored."""
        tag = element.tag
        supported_children = [
            child
            for child in element.children
            if _is_supported(element, child, section, self.diagnostics)
        ]
        is_body_geom = tag == "geom" and section == "worldbody"
        if is_body_geom and self.mesh_defaults.is_mesh(element, childclass):
            self.diagnostics.record_ignored(["geoms of meshes"])
            self.bodies_of_unknown_mass.add(body)
            return
        if tag in {"body", "frame", "replicate"}:
            childclass = element.attributes.get("childclass", childclass)
        if tag == "body":
            body = element.attributes.get("name", "")
        attributes = _attribute_text(element, section, self.diagnostics)
        self.add_line(element, f"<{tag}{attributes}>", body)
        for child in supported_children:
            self.add_element(child, section or child.tag, childclass, body)
        self.add_line(element, f"</{tag}>", body)


def _is_supported(
    parent: XmlElement, child: XmlElement, section: str, diagnostics: XmlDiagnostics
) -> bool:
    """Return whether a child of a section is supported; record omitted children."""
    tag = child.tag
    match section:
        case "worldbody":
            return _is_supported_in_body(parent, child, diagnostics)
        case "equality":
            if tag != "joint":
                diagnostics.record_ignored([f"equality of <{tag[:40]}>"])
            return tag == "joint"
        case "default":
            return tag in _DEFAULT_TAGS
    return section != "compiler"


def _is_supported_in_body(
    parent: XmlElement, child: XmlElement, diagnostics: XmlDiagnostics
) -> bool:
    """Return whether a child of a body is supported; record omitted children."""
    tag, label = child.tag, _BODY_CONTENT_LABELS.get(child.tag)
    if tag in _GENERATOR_TAGS:
        message = f"<{tag}> makes bodies from other parts, which is not read"
        hint = "compile the model, and save it by mujoco.mj_saveLastXML"
        diagnostics.add("MJC009", child, message, hint)
        return False
    if parent.tag == "worldbody" and tag in {"geom", "site"}:
        label = "geoms and sites of the world"
    if label is not None:
        diagnostics.record_ignored([label])
        return False
    return parent.tag not in {"geom", "joint", "site", "inertial"}


def _attribute_text(
    element: XmlElement, section: str, diagnostics: XmlDiagnostics
) -> str:
    """Return the supported attributes of an element as XML."""
    removed_names: tuple[str, ...] = _DROPPED_ATTRIBUTES.get(element.tag, ())
    if section == "default" and element.attributes.get("type") in _MESH_TYPES:
        removed_names = (*removed_names, "type")
    attribute_texts = []
    for name, value in element.attributes.items():
        if name in removed_names:
            is_aligned = name in _ALIGNMENTS and value == "true"
            diagnostics.record_ignored(["alignment of free joints"] * is_aligned)
            continue
        if name not in _TEXT_ATTRIBUTES:
            _check_numbers(element, name, value, diagnostics)
        if name == "range" and element.tag == "joint":
            _check_range(element, value, diagnostics)
        attribute_texts.append(f" {name}={quoteattr(value)}")
    return "".join(attribute_texts)


def _check_numbers(
    element: XmlElement, name: str, value: str, diagnostics: XmlDiagnostics
) -> None:
    """Record numbers that are not finite, which MuJoCo would accept."""
    for text in value.split():
        number = to_number(text)
        if number is not None and not math.isfinite(number):
            message = f"{name} of <{element.tag}> is {excerpt(value)}: "
            message += f"{excerpt(text)} is not finite"
            diagnostics.add(
                "MJC007", element, message, location=named_element_label(element)
            )
            return


def _check_range(element: XmlElement, value: str, diagnostics: XmlDiagnostics) -> None:
    """Record reversed ranges, which MuJoCo would drop without ``limited``."""
    limits = [to_number(text) for text in value.split()]
    lower, upper = (*limits, None, None)[:2]
    if lower is None or upper is None or not lower > upper:
        return
    if element.attributes.get("limited") != "false":
        message = f"range {excerpt(value)} is reversed: {lower:g} is above {upper:g}"
        hint = f'write range="{upper:g} {lower:g}" if they are swapped'
        diagnostics.add(
            "MJC011", element, message, hint, location=named_element_label(element)
        )


def named_element_label(element: XmlElement) -> str | None:
    """Return the label of a named element for messages; None if it has no name."""
    name = element.attributes.get("name")
    return None if name is None else element_label(element.tag, name)


def _name_bodies(root: XmlElement) -> None:
    """Give unique names to bodies without a name."""
    bodies = [
        e for s in root.find_all("worldbody") for e in s.walk() if e.tag == "body"
    ]
    used_names = {body.attributes.get("name") for body in bodies}
    names = (f"body_{number}" for number in itertools.count(1))
    unused_names = (name for name in names if name not in used_names)
    for body in bodies:
        if not body.attributes.get("name"):
            body.attributes["name"] = next(unused_names)


class _MeshDefaults:
    """Finds which geoms are meshes, directly or by their default class."""

    def __init__(self, root: XmlElement) -> None:
        self._is_mesh_by_class = {"main": False}
        for default in root.find_all("default"):
            name = default.attributes.get("class", "main")
            pending = [(default, name, self._is_mesh_by_class["main"])]
            while pending:
                element, name, is_mesh = pending.pop()
                for geom in element.find_all("geom"):
                    is_mesh = _is_mesh(geom, is_mesh)
                self._is_mesh_by_class[name] = is_mesh
                pending += [
                    (child, child.attributes.get("class", ""), is_mesh)
                    for child in element.find_all("default")
                ]

    def is_mesh(self, geom: XmlElement, childclass: str) -> bool:
        """Return whether a body's geom is a mesh."""
        name = geom.attributes.get("class", childclass)
        is_mesh_by_class = self._is_mesh_by_class
        return _is_mesh(geom, is_mesh_by_class.get(name, is_mesh_by_class["main"]))


def _is_mesh(geom: XmlElement, is_mesh_by_default: bool) -> bool:
    """Return whether a geom is a mesh; its defaults decide if it states no type."""
    if geom.attributes.get("type") in _MESH_TYPES or "mesh" in geom.attributes:
        return True
    return is_mesh_by_default and "type" not in geom.attributes


def _check_files(
    root: XmlElement, packages: PackageFolders, diagnostics: XmlDiagnostics
) -> None:
    """Record file names outside the project; no file is opened."""
    folders = {
        name: value
        for compiler in root.find_all("compiler")
        for name, value in compiler.attributes.items()
        if name in {"assetdir", "meshdir", "texturedir"}
    }
    missing_files: dict[str, XmlElement] = {}
    outside_files: dict[str, XmlElement] = {}
    for element, name in _file_attributes(root):
        setting = "texturedir" if element.tag == "texture" else "meshdir"
        folder = folders.get(setting, folders.get("assetdir", ""))
        try:
            if packages.find(f"{folder}/{name}" if folder else name) is None:
                missing_files.setdefault(name, element)
        except OutsideError:
            outside_files.setdefault(name, element)
    for code, files, predicate in (
        ("MJC103", missing_files, "not found"),
        ("MJC016", outside_files, "outside the project, and not opened"),
    ):
        if files:
            message = f"{counted(len(files), 'file')} of its assets {predicate}: "
            message += listed([excerpt(n, 80) for n in files], MAX_LISTED_FILES)
            hint = "motion needs none of them"
            element = next(iter(files.values()))
            diagnostics.add(code, element, message, hint, severity=Severity.NOTE)


def _file_attributes(root: XmlElement) -> Iterator[tuple[XmlElement, str]]:
    for element in root.walk():
        for name, value in element.attributes.items():
            if name.startswith("file") and value and element.tag != "include":
                yield element, value
