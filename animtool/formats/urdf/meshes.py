"""Reads URDF meshes: OBJ and STL files inside the project."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from animtool.core.errors import Severity, counted, excerpt, listed
from animtool.formats.robots.mesh_files import SUFFIXES, read_mesh
from animtool.formats.robots.notes import XmlNotes, element_label
from animtool.formats.robots.packages import OutsideError, PackageFolders
from animtool.formats.robots.parts import Triangles
from animtool.formats.robots.triangles import triangulate_shape
from animtool.formats.urdf.elements import CODES, UrdfFile, Visual
from animtool.maths import so3

MAX_LISTED_FILES = 8
# Maximum triangles of a robot; the others are omitted.
MAX_TRIANGLES = 1_000_000


def find_mesh_paths(file: UrdfFile, path: Path, notes: XmlNotes) -> dict[str, Path]:
    """Return mesh paths by name; raise for files outside the project.

    Missing files are only noted, since motion does not need them.
    """
    meshes = [(link, mesh) for link in file.links.values() for mesh in link.meshes]
    if not meshes:
        return {}
    folders = PackageFolders.of(path, CODES)
    files: dict[str, Path] = {}
    missing_files: dict[str, None] = {}
    outside_files: set[tuple[str, str]] = set()
    for link, mesh in meshes:
        name = mesh.attributes["filename"]
        if name in files or name in missing_files or (link.name, name) in outside_files:
            continue
        try:
            file_path = folders.find(name)
        except OutsideError as error:
            outside_files.add((link.name, name))
            message = f"its mesh {excerpt(name, 100)} is refused: {error}"
            hint = "copy it into the project, or name its folder in animtool.toml: "
            hint += "roots = [...]"
            notes.add(
                "URD016", mesh, message, hint, where=element_label("link", link.name)
            )
            continue
        if file_path is None:
            missing_files[name] = None
        else:
            files[name] = file_path
    if missing_files:
        message = f"{counted(len(missing_files), 'mesh', 'meshes')} not found: "
        message += listed([excerpt(n, 80) for n in missing_files], MAX_LISTED_FILES)
        hint = "motion needs none of them; package:// means a folder of that name in "
        hint += "the project, or the package that the file is in"
        notes.add("URD103", None, message, hint, severity=Severity.NOTE)
    return files


def read_visible_surfaces(
    file: UrdfFile, files: dict[str, Path], notes: XmlNotes
) -> dict[str, list[Triangles]]:
    """Return visible surfaces by link name; record what is not shown."""
    cache: dict[Path, Triangles | None] = {}
    unreadable_files: dict[str, None] = {}
    surfaces: dict[str, list[Triangles]] = {}
    total = 0
    for link in file.links.values():
        for visual in link.visuals:
            surface = _read_visible_surface(
                visual, files, cache, unreadable_files, notes
            )
            if surface is None:
                continue
            total += len(surface.faces)
            if total > MAX_TRIANGLES:
                notes.leave_out([f"more than {MAX_TRIANGLES:,} triangles of visuals"])
                return surfaces
            surfaces.setdefault(link.name, []).append(surface)
    if unreadable_files:
        message = f"{counted(len(unreadable_files), 'mesh', 'meshes')} not shown: "
        message += listed(list(unreadable_files), MAX_LISTED_FILES)
        hint = "export it as STL or OBJ again"
        notes.add("URD110", None, message, hint, severity=Severity.WARNING)
    return surfaces


def _read_visible_surface(
    visual: Visual,
    files: dict[str, Path],
    cache: dict[Path, Triangles | None],
    unreadable_files: dict[str, None],
    notes: XmlNotes,
) -> Triangles | None:
    """Return a visual's surface in its link frame; None if not shown."""
    if visual.mesh is None:
        return triangulate_shape(visual.solid)
    name = visual.mesh.attributes["filename"]
    path = files.get(name)
    if path is None:
        return None
    if path.suffix.lower() not in SUFFIXES:
        notes.leave_out([f"meshes in {path.suffix.lower()[:20] or 'other'} files"])
        return None
    if path not in cache:
        try:
            cache[path] = read_mesh(path)
        except ValueError as error:
            cache[path] = None
            unreadable_files[f"{excerpt(name, 60)}: {error}"] = None
    mesh = cache[path]
    if mesh is None:
        return None
    position = np.array(visual.solid.position)
    rotation = np.array(visual.solid.rotation)
    scale = np.array(visual.scale)
    points = so3.rotate(rotation, mesh.points * scale) + position
    # Mirroring reverses the orientation of faces.
    faces = mesh.faces[:, ::-1] if np.prod(scale) < 0 else mesh.faces
    return Triangles(points, faces)
