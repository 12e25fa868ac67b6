"""Reads an MJCF as a rig, or as a take of one frame."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.errors import Severity, counted, excerpt
from animtool.core.files.reading import exists, nearest_file
from animtool.core.files.signatures import expects_format
from animtool.formats.mjcf.compiled import HINGE, build_robot, compile_model
from animtool.formats.mjcf.reduced import reduce_model
from animtool.formats.robots.build import RobotCodes, build_rig, zero_pose_stream
from animtool.formats.robots.diagnostics import XmlDiagnostics
from animtool.formats.robots.packages import OutsideError, PackageFolders
from animtool.formats.robots.xml import MAX_ELEMENTS, XmlCodes, XmlElement, read_xml
from animtool.motion.take import TakeStream
from animtool.rig.skeleton import Rig
from animtool.rig.suspicions import (
    ANGLE_NAMES,
    OTHER_ANGLE_UNIT_AND_FACTOR,
    AngleLimit,
    limits_in_other_unit,
)

_XML_CODES = XmlCodes("MJC001", "MJC002", "MJC003")
ROOT_TAG = "mujoco"
MAX_INCLUDES = 1000
_ROBOT_CODES = RobotCodes("MJC102", "MJC106", "MJC101")


def read_mjcf_rig(path: Path | str) -> Rig:
    """Return the rig of an MJCF: metres, radians, Z up.

    Every body becomes a joint of its name, and so does every joint and site.
    Coordinates are MuJoCo's qpos, except that a free joint counts from the body's pose
    in the file. Colliding simple geoms become capsules, visible ones meshes, and
    inertias masses. MuJoCo compiles the model, but opens no file.

    Args:
        path: A .xml or .mjcf file.
    """
    path = Path(path)
    diagnostics = XmlDiagnostics(path, "MJC007")
    root, folders = _read_model(path, diagnostics)
    reduced_model = reduce_model(root, folders, diagnostics)
    diagnostics.raise_faults()
    model = compile_model(reduced_model, diagnostics)
    _warn_of_range_unit(root, model, diagnostics)
    robot = build_robot(model, reduced_model, diagnostics)
    if not robot.links:
        diagnostics.add(
            "MJC004", root, "the model has no body", "bodies are what moves"
        )
        diagnostics.raise_faults()
    if not root.attributes.get("model"):
        robot.name = path.stem
    return build_rig(robot, diagnostics, _ROBOT_CODES)


def read_mjcf(path: Path | str) -> TakeStream:
    """Open an MJCF as a take of one frame, joints at 0 or the nearest limit.

    Args:
        path: A .xml or .mjcf file.
    """
    return zero_pose_stream(read_mjcf_rig(path), "MJCF")


def _warn_of_range_unit(
    root: XmlElement, model: Any, diagnostics: XmlDiagnostics
) -> None:
    """Warn about hinge ranges that look like radians in degrees, or reverse (MJC110).

    Args:
        root: The file, with its includes.
        model: The compiled model, whose ranges are in radians.
        diagnostics: Collects the faults and warnings of the file.
    """
    angle_unit = "deg"
    for compiler in root.find_all("compiler"):
        if "angle" in compiler.attributes:
            angle_unit = "rad" if compiler.attributes["angle"] == "radian" else "deg"
    factor = math.degrees(1.0) if angle_unit == "deg" else 1.0
    # Without the rounding of the conversion.
    limits = [
        AngleLimit(
            (),
            model.joint(j).name,
            [round(float(end), 9) for end in np.array(model.jnt_range[j]) * factor],
        )
        for j in range(model.njnt)
        if model.jnt_limited[j] and model.jnt_type[j] == HINGE
    ]
    suspect_limits = limits_in_other_unit(limits, angle_unit)
    if not suspect_limits:
        return
    widest_limit = max(suspect_limits, key=lambda limit: limit.largest_value)
    element = next(
        (
            element
            for element in root.walk()
            if element.tag == "joint"
            and element.attributes.get("name") == widest_limit.joint
        ),
        None,
    )
    likely_unit, ratio = OTHER_ANGLE_UNIT_AND_FACTOR[angle_unit]
    lower, upper = widest_limit.values
    message = (
        f"the ranges of {counted(len(suspect_limits), 'joint')} look like "
        f"{ANGLE_NAMES[likely_unit]}, but the unit is {ANGLE_NAMES[angle_unit]}: "
        f"{widest_limit.joint!r} has {lower:.4g} to {upper:.4g}"
    )
    setting = '<compiler angle="radian"/>'
    hint = f"write {setting}" if likely_unit == "rad" else f"remove {setting}"
    hint += f', or write range="{lower * ratio:.4g} {upper * ratio:.4g}"'
    if likely_unit == "deg":
        hint = hint.replace(setting, 'angle="radian" of <compiler>')
    diagnostics.add("MJC110", element, message, hint, severity=Severity.WARNING)


@expects_format("MJC001", "an MJCF file")
def _read_model(
    path: Path, diagnostics: XmlDiagnostics
) -> tuple[XmlElement, PackageFolders]:
    """Return the root of a model with all includes replaced by their content."""
    root = read_xml(path, _XML_CODES)
    if root.tag != ROOT_TAG:
        hints = {
            "robot": "it is a URDF: name it .urdf",
            "mujocoinclude": "it is a part that a model includes: give the model",
            "sdf": "it is SDF: use the URDF or MJCF that it was made from",
        }
        hint = hints.get(root.tag, f"the root element of MJCF is <{ROOT_TAG}>")
        message = f"no MJCF: its root element is <{root.tag[:60]}>"
        diagnostics.add("MJC004", root, message, hint)
        diagnostics.raise_faults()
    folders = PackageFolders.from_file(path, _XML_CODES)
    _IncludeExpander(path, folders, diagnostics).expand_below(root)
    diagnostics.raise_faults()
    return root, folders


class _IncludeExpander:
    """Replaces include elements with the content of their files."""

    def __init__(
        self, path: Path, folders: PackageFolders, diagnostics: XmlDiagnostics
    ) -> None:
        self._path, self._folders, self._diagnostics = path, folders, diagnostics
        self._included_files = {path.resolve()}
        self._element_count = 0

    def expand_below(self, root: XmlElement) -> None:
        """Replace all includes below an element, including nested ones."""
        pending = [root]
        while pending and not self._diagnostics.faults:
            element = pending.pop()
            self._element_count += 1
            if self._element_count > MAX_ELEMENTS:
                message = f"more than {MAX_ELEMENTS:,} elements with all includes"
                self._diagnostics.add("MJC003", element, message)
                return
            children: list[XmlElement] = []
            remaining_children = list(reversed(element.children))
            while remaining_children and not self._diagnostics.faults:
                child = remaining_children.pop()
                if child.tag == "include":
                    remaining_children += reversed(self._expand_include(child))
                else:
                    children.append(child)
            element.children = children
            pending += reversed(children)

    def _expand_include(self, element: XmlElement) -> list[XmlElement]:
        """Return the elements of an included file, which replace its include."""
        name = element.attributes.get("file", "")
        path = self._find_include(element, name)
        if path is None:
            return []
        if path in self._included_files:
            message = f"{excerpt(name, 100)} is included already"
            if path == element.path.resolve():
                message = f"{excerpt(name, 100)} includes itself"
            hint = "a file may be included once; attach makes several copies"
            self._diagnostics.add("MJC006", element, message, hint)
            return []
        if len(self._included_files) > MAX_INCLUDES:
            message = f"more than {MAX_INCLUDES} files are included"
            self._diagnostics.add("MJC003", element, message)
            return []
        self._included_files.add(path)
        return read_xml(path, _XML_CODES).children

    def _find_include(self, element: XmlElement, name: str) -> Path | None:
        """Return the file of an include, named relative to the model or its file."""
        if not name:
            message = "an include without file"
            self._diagnostics.add(
                "MJC006", element, message, 'write file="parts/legs.xml"'
            )
            return None
        try:
            path = self._folders.find(name)
            if path is None:
                sibling_path = element.path.resolve().parent / name
                path = self._folders.find(str(sibling_path))
        except OutsideError as error:
            message = f"{excerpt(name, 100)} is not included: {error}"
            self._diagnostics.add("MJC006", element, message, error.hint(self._path))
            return None
        if path is None or not exists(path):
            message = f"{excerpt(name, 100)} does not exist"
            similar_file = nearest_file(Path(name), self._folders.folder)
            self._diagnostics.add("MJC006", element, message, similar_file)
            return None
        return path
