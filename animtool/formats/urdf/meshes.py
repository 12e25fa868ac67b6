"""Finds and reads the meshes of a URDF: OBJ and STL files inside the project."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import FormatError, Severity, counted, excerpt, listed
from animtool.core.files.reading import read_input
from animtool.formats.robots.diagnostics import XmlDiagnostics, element_label
from animtool.formats.robots.packages import (
    OutsideError,
    PackageFolders,
    package_of,
)
from animtool.formats.robots.parts import Triangles
from animtool.formats.robots.triangles import triangulate_shape
from animtool.formats.robots.xml import XmlElement
from animtool.formats.urdf.elements import XML_CODES, UrdfFile, Visual
from animtool.maths import so3

MAX_LISTED_FILES = 8
# Maximum triangles of a robot; the others are omitted.
MAX_ROBOT_TRIANGLES = 1_000_000
MAX_MESH_BYTES = 100_000_000
MAX_MESH_TRIANGLES = 300_000
MAX_COORDINATE = 1e9
MESH_SUFFIXES = (".obj", ".stl")
_STL_HEADER_BYTES, _STL_TRIANGLE_BYTES = 84, 50
_STL_TRIANGLE = np.dtype(
    [("normal", "<f4", 3), ("points", "<f4", (3, 3)), ("more", "<u2")]
)


def find_mesh_files(
    file: UrdfFile, path: Path, diagnostics: XmlDiagnostics
) -> dict[str, Path]:
    """Return mesh files by their names in the URDF; record files outside the project.

    Missing files are only noted, since motion does not need them.
    """
    meshes = [(link, mesh) for link in file.links.values() for mesh in link.meshes]
    if not meshes:
        return {}
    folders = PackageFolders.from_file(path, XML_CODES)
    files: dict[str, Path] = {}
    missing_files: dict[str, XmlElement] = {}
    outside_files: set[tuple[str, str]] = set()
    for link, mesh in meshes:
        name = mesh.attributes["filename"]
        if name in files or name in missing_files or (link.name, name) in outside_files:
            continue
        try:
            file_path = folders.find(name)
        except OutsideError as error:
            outside_files.add((link.name, name))
            message = f"its mesh {excerpt(name, 100)} is not read: {error}"
            suggestion = folders.suggest(name)
            hint = error.hint(path) if suggestion is None else f"write {suggestion}"
            location = element_label("link", link.name)
            diagnostics.add("URD016", mesh, message, hint, location=location)
            continue
        if file_path is None:
            missing_files[name] = mesh
        else:
            files[name] = file_path
    _record_missing_files(missing_files, folders, diagnostics)
    return files


def _record_missing_files(
    missing_files: Mapping[str, XmlElement],
    folders: PackageFolders,
    diagnostics: XmlDiagnostics,
) -> None:
    """Record meshes that are not found, and those found under another name.

    ``missing_files`` are the first elements of each name.
    """
    suggestions = {name: folders.suggest(name) for name in missing_files}
    for name, element in missing_files.items():
        suggestion = suggestions[name]
        if suggestion is not None:
            message = f"the mesh {excerpt(name, 100)} is not found and is left out"
            hint, package = f"write {suggestion}", package_of(suggestion)
            if package != package_of(name):
                hint = f"it is in the package {package!r}: {hint}"
            diagnostics.add("URD113", element, message, hint, severity=Severity.WARNING)
    absent_files = [name for name in missing_files if suggestions[name] is None]
    if not absent_files:
        return
    message = f"{counted(len(absent_files), 'mesh', 'meshes')} not found: "
    message += listed([excerpt(n, 80) for n in absent_files], MAX_LISTED_FILES)
    packages = dict.fromkeys(filter(None, map(package_of, absent_files)))
    names = " and ".join(map(repr, list(packages)[:2]))
    noun = "package" if len(packages) == 1 else "packages"
    hint = f"put {f'the {noun} {names}' if packages else 'them'} in the project "
    hint += "if the meshes should be seen; motion does not need them"
    element = missing_files[absent_files[0]]
    diagnostics.add("URD103", element, message, hint, severity=Severity.NOTE)


def read_surfaces(
    file: UrdfFile, files: dict[str, Path], diagnostics: XmlDiagnostics
) -> dict[str, list[Triangles]]:
    """Return visible surfaces by link name; record meshes that cannot be read."""
    meshes_by_path: dict[Path, Triangles | None] = {}
    unreadable_files: dict[str, None] = {}
    surfaces: dict[str, list[Triangles]] = {}
    triangle_count = 0
    for link in file.links.values():
        for visual in link.visuals:
            surface = _read_surface(
                visual, files, meshes_by_path, unreadable_files, diagnostics
            )
            if surface is None:
                continue
            triangle_count += len(surface.faces)
            if triangle_count > MAX_ROBOT_TRIANGLES:
                diagnostics.record_ignored(
                    [f"more than {MAX_ROBOT_TRIANGLES:,} triangles of visuals"]
                )
                return surfaces
            surfaces.setdefault(link.name, []).append(surface)
    if unreadable_files:
        message = f"{counted(len(unreadable_files), 'mesh', 'meshes')} not shown: "
        message += listed(list(unreadable_files), MAX_LISTED_FILES)
        hint = "export it as STL or OBJ again"
        diagnostics.add("URD110", None, message, hint, severity=Severity.WARNING)
    return surfaces


def _read_surface(
    visual: Visual,
    files: dict[str, Path],
    meshes_by_path: dict[Path, Triangles | None],
    unreadable_files: dict[str, None],
    diagnostics: XmlDiagnostics,
) -> Triangles | None:
    """Return a visual's surface in its link frame; None if it cannot be read."""
    if visual.mesh is None:
        return triangulate_shape(visual.solid)
    name = visual.mesh.attributes["filename"]
    path = files.get(name)
    if path is None:
        return None
    if path.suffix.lower() not in MESH_SUFFIXES:
        diagnostics.record_ignored(
            [f"meshes in {path.suffix.lower()[:20] or 'other'} files"]
        )
        return None
    if path not in meshes_by_path:
        try:
            meshes_by_path[path] = read_mesh(path)
        except ValueError as error:
            meshes_by_path[path] = None
            unreadable_files[f"{excerpt(name, 60)}: {error}"] = None
    mesh = meshes_by_path[path]
    if mesh is None:
        return None
    position = np.array(visual.solid.position)
    rotation = np.array(visual.solid.rotation)
    scale = np.array(visual.scale)
    points = so3.rotate(rotation, mesh.points * scale) + position
    # Mirroring reverses the orientation of faces.
    faces = mesh.faces[:, ::-1] if np.prod(scale) < 0 else mesh.faces
    return Triangles(points, faces)


def read_mesh(path: Path) -> Triangles:
    """Return the triangles of an OBJ or STL, in file units."""
    try:
        content = read_input(path, MAX_MESH_BYTES)
    except FormatError as error:
        raise ValueError(error.faults[0].message) from error
    is_obj = path.suffix.lower() == ".obj"
    mesh = _parse_obj(content) if is_obj else _parse_stl(content)
    if not len(mesh.faces):
        raise ValueError("it holds no faces")
    if len(mesh.faces) > MAX_MESH_TRIANGLES:
        raise ValueError(f"it has more than {MAX_MESH_TRIANGLES:,} triangles")
    if not np.isfinite(mesh.points).all() or np.abs(mesh.points).max() > MAX_COORDINATE:
        raise ValueError("it has points that are not finite, or too far")
    return mesh


def _parse_stl(content: bytes) -> Triangles:
    if len(content) >= _STL_HEADER_BYTES:
        triangle_count = int.from_bytes(content[80:84], "little")
        if len(content) == _STL_HEADER_BYTES + _STL_TRIANGLE_BYTES * triangle_count:
            rows = np.frombuffer(content, _STL_TRIANGLE, offset=_STL_HEADER_BYTES)
            return _separate_triangles(rows["points"].reshape(-1, 3).astype(np.float64))
    if content[:5].lower() != b"solid":
        raise ValueError("it is not an STL, or is truncated")
    words = content.split()
    vertex_indices = [i for i, word in enumerate(words) if word == b"vertex"]
    try:
        points = np.array([words[i + 1 : i + 4] for i in vertex_indices], np.float64)
    except ValueError as error:
        raise ValueError(f"it has an invalid vertex: {error}") from error
    if len(points) % 3 or points.shape[1:] != (3,):
        raise ValueError("it is not an STL, or is truncated")
    return _separate_triangles(points)


def _separate_triangles(points: FloatArray) -> Triangles:
    """Return triangles without common points, so that they are shaded flat."""
    return Triangles(points, np.arange(len(points), dtype=np.int64).reshape(-1, 3))


def _parse_obj(content: bytes) -> Triangles:
    points: list[list[float]] = []
    faces: list[list[int]] = []
    for line in content.splitlines():
        words = line.split()
        if not words:
            continue
        try:
            if words[0] == b"v":
                points.append([float(word) for word in words[1:4]])
            elif words[0] == b"f":
                faces += _fan_triangles(
                    [int(word.split(b"/")[0]) for word in words[1:]], points
                )
        except ValueError as error:
            raise ValueError(f"a line of it is malformed: {error}") from error
        if len(faces) > MAX_MESH_TRIANGLES:
            break
    if any(len(point) != 3 for point in points):
        raise ValueError("it has a point without three numbers")
    triangles: IntArray = np.array(faces, np.int64).reshape(-1, 3)
    if len(triangles) and not 0 <= triangles.min() <= triangles.max() < len(points):
        raise ValueError("it has a face of a point that it lacks")
    return Triangles(np.array(points, np.float64).reshape(-1, 3), triangles)


def _fan_triangles(corners: list[int], points: list[list[float]]) -> list[list[int]]:
    """Return the triangles of a face; negative corners count from the last point."""
    indices = [i - 1 if i > 0 else len(points) + i for i in corners]
    return [
        [indices[0], indices[k], indices[k + 1]] for k in range(1, len(indices) - 1)
    ]
