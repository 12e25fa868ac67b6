"""Reads robot meshes (OBJ and STL) as triangles."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import FormatError
from animtool.core.files.reading import read_input
from animtool.formats.robots.parts import Triangles

MAX_BYTES = 100_000_000
MAX_TRIANGLES = 300_000
MAX_COORDINATE = 1e9
SUFFIXES = (".obj", ".stl")
_HEADER_BYTES, _TRIANGLE_BYTES = 84, 50
_TRIANGLE_RECORD = np.dtype(
    [("normal", "<f4", 3), ("points", "<f4", (3, 3)), ("more", "<u2")]
)


def read_mesh(path: Path) -> Triangles:
    """Return the triangles of an OBJ or STL, in file units."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"{suffix or 'a file without suffix'} is not read")
    try:
        content = read_input(path, MAX_BYTES)
    except FormatError as error:
        raise ValueError(error.faults[0].message) from error
    mesh = _parse_obj(content) if suffix == ".obj" else _parse_stl(content)
    if not len(mesh.faces):
        raise ValueError("it holds no faces")
    if len(mesh.faces) > MAX_TRIANGLES:
        raise ValueError(f"it has more than {MAX_TRIANGLES:,} triangles")
    if not np.isfinite(mesh.points).all() or np.abs(mesh.points).max() > MAX_COORDINATE:
        raise ValueError("it has points that are not finite, or too far")
    return mesh


def _parse_stl(content: bytes) -> Triangles:
    if len(content) >= _HEADER_BYTES:
        count = int.from_bytes(content[80:84], "little")
        if len(content) == _HEADER_BYTES + _TRIANGLE_BYTES * count:
            rows = np.frombuffer(content, _TRIANGLE_RECORD, offset=_HEADER_BYTES)
            return _separate_triangles(rows["points"].reshape(-1, 3).astype(np.float64))
    if content[:5].lower() != b"solid":
        raise ValueError("it is not an STL, or is truncated")
    words = content.split()
    vertices = [i for i, word in enumerate(words) if word == b"vertex"]
    try:
        points = np.array([words[i + 1 : i + 4] for i in vertices], np.float64)
    except ValueError as error:
        raise ValueError(f"it has an invalid vertex: {error}") from error
    if len(points) % 3 or points.shape[1:] != (3,):
        raise ValueError("it is not an STL, or is truncated")
    return _separate_triangles(points)


def _separate_triangles(points: FloatArray) -> Triangles:
    """Return triangles that share no points, so that they are shaded flat."""
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
        if len(faces) > MAX_TRIANGLES:
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
