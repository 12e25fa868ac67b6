"""Resolves MJCF includes to one tree, so that MuJoCo opens no files."""

from __future__ import annotations

from pathlib import Path

from animtool.core.errors import excerpt
from animtool.core.files.reading import exists, nearest_file
from animtool.core.files.signatures import expects_format
from animtool.formats.robots.notes import XmlNotes
from animtool.formats.robots.packages import OutsideError, PackageFolders
from animtool.formats.robots.xml import MAX_ELEMENTS, XmlCodes, XmlElement, read_xml

CODES = XmlCodes("MJC001", "MJC002", "MJC003")
ROOT = "mujoco"
MAX_INCLUDES = 1000


@expects_format("MJC001", "an MJCF file")
def read_model(path: Path, notes: XmlNotes) -> tuple[XmlElement, PackageFolders]:
    """Return the root of a model with all includes replaced by their content."""
    root = read_xml(path, CODES)
    if root.tag != ROOT:
        hints = {
            "robot": "it is a URDF: name it .urdf",
            "mujocoinclude": "it is a part that a model includes: give the model",
            "sdf": "it is SDF: use the URDF or MJCF that it was made from",
        }
        hint = hints.get(root.tag, f"the root element of MJCF is <{ROOT}>")
        message = f"no MJCF: its root element is <{root.tag[:60]}>"
        notes.add("MJC004", root, message, hint)
        notes.check()
    folders = PackageFolders.of(path, CODES)
    _IncludeResolver(path, folders, notes).run(root)
    notes.check()
    return root, folders


class _IncludeResolver:
    """Replaces include elements with the content of their files."""

    def __init__(self, path: Path, folders: PackageFolders, notes: XmlNotes) -> None:
        self._folders, self._notes = folders, notes
        self._included_files = {path.resolve()}
        self._count = 0

    def run(self, root: XmlElement) -> None:
        """Resolve all includes below an element."""
        pending = [root]
        while pending and not self._notes.faults:
            element = pending.pop()
            self._count += 1
            if self._count > MAX_ELEMENTS:
                message = f"more than {MAX_ELEMENTS:,} elements with all includes"
                self._notes.add("MJC003", element, message)
                return
            children: list[XmlElement] = []
            remaining = list(reversed(element.children))
            while remaining and not self._notes.faults:
                child = remaining.pop()
                if child.tag == "include":
                    remaining += reversed(self._included(child))
                else:
                    children.append(child)
            element.children = children
            pending += reversed(children)

    def _included(self, element: XmlElement) -> list[XmlElement]:
        """Return the elements that replace an include."""
        name = element.attributes.get("file", "")
        path = self._path_of(element, name)
        if path is None:
            return []
        if path in self._included_files:
            message = f"{excerpt(name, 100)} is included already"
            if path == element.path.resolve():
                message = f"{excerpt(name, 100)} includes itself"
            hint = "a file may be included once; attach makes several copies"
            self._notes.add("MJC006", element, message, hint)
            return []
        if len(self._included_files) > MAX_INCLUDES:
            message = f"more than {MAX_INCLUDES} files are included"
            self._notes.add("MJC003", element, message)
            return []
        self._included_files.add(path)
        return read_xml(path, CODES).children

    def _path_of(self, element: XmlElement, name: str) -> Path | None:
        """Return the path of an include, relative to the model, else to its file."""
        if not name:
            message = "an include without file"
            self._notes.add("MJC006", element, message, 'write file="parts/legs.xml"')
            return None
        try:
            path = self._folders.find(name)
            if path is None:
                by_including_file = element.path.resolve().parent / name
                path = self._folders.find(str(by_including_file))
        except OutsideError as error:
            message = f"{excerpt(name, 100)} is not included: {error}"
            hint = "copy it into the project, or name its folder in animtool.toml: "
            self._notes.add("MJC006", element, message, f"{hint}roots = [...]")
            return None
        if path is None or not exists(path):
            message = f"{excerpt(name, 100)} does not exist"
            similar_file = nearest_file(Path(name), self._folders.folder)
            self._notes.add("MJC006", element, message, similar_file)
            return None
        return path
