"""Simple shapes as triangles, and meshes of files."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from animtool.formats.robots.parts import SimpleShape, Triangles
from animtool.formats.robots.solids import build_capsule
from animtool.formats.robots.triangles import triangulate_shape
from animtool.formats.urdf.meshes import read_mesh

TURN = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0]], "<f4")


def volume(mesh: Triangles) -> float:
    """Return what is inside, positive where faces look outwards."""
    a, b, c = (mesh.points[mesh.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


@pytest.mark.parametrize(
    ("kind", "size", "whole"),
    [
        ("box", (1.0, 2.0, 3.0), 6.0),
        ("sphere", (1.0,), 4 / 3 * math.pi),
        ("cylinder", (1.0, 2.0), 2 * math.pi),
        ("capsule", (1.0, 2.0), 2 * math.pi + 4 / 3 * math.pi),
    ],
)
def test_shapes_have_their_volume_and_place(
    kind: str, size: tuple[float, ...], whole: float
) -> None:
    mesh = triangulate_shape(SimpleShape(kind, size, (5.0, 6.0, 7.0), TURN))
    centred = Triangles(mesh.points - (5.0, 6.0, 7.0), mesh.faces)
    assert whole * 0.95 <= volume(centred) <= whole * (1 + 1e-9)
    assert_allclose(centred.points.max(axis=0), -centred.points.min(axis=0), atol=1e-9)


@pytest.mark.parametrize(
    ("kind", "size"),
    [
        ("box", (0.1, 0.2, 0.5)),
        ("box", (0.4, 0.4, 0.4)),
        ("cylinder", (0.1, 0.5)),
        ("cylinder", (0.5, 0.1)),
        ("sphere", (0.3,)),
        ("capsule", (0.1, 0.4)),
    ],
)
def test_capsules_are_no_farther_off_than_is_said(
    kind: str, size: tuple[float, ...]
) -> None:
    solid = SimpleShape(kind, size, (0.1, 0.2, 0.3), TURN)
    capsule, off = build_capsule(solid, (0.0, 0.0, 1.0))
    # The surface of the shape, with the middle of each side.
    mesh = triangulate_shape(solid)
    points = np.concatenate([mesh.points, mesh.points[mesh.faces].mean(axis=1)])
    points = points + np.array([0.0, 0.0, 1.0]) - np.array(capsule.offset)
    half = capsule.length / 2
    along = np.clip(points @ np.array(capsule.axis), -half, half)
    near = np.linalg.norm(points - along[:, None] * np.array(capsule.axis), axis=1)
    # A ball and the ends of a capsule are flat between their corners.
    assert np.abs(near - capsule.radius).max() <= off + 0.02 * capsule.radius


def test_files_hold_what_their_formats_say(tmp_path: Path) -> None:
    obj = tmp_path / "a.OBJ"
    obj.write_bytes(
        b"# x\nv 0 0 0\nv 1 0 0\nv 0 2 0\nv 1 2 0\nf 1/1/1 2//2 4 -2\nf 1 2 3\n"
    )
    mesh = read_mesh(obj)
    assert mesh.faces.tolist() == [[0, 1, 3], [0, 3, 2], [0, 1, 2]]
    binary = tmp_path / "a.stl"
    row = bytes(12) + CORNERS.tobytes() + bytes(2)
    binary.write_bytes(b"solid".ljust(80) + (1).to_bytes(4, "little") + row)
    text = tmp_path / "b.stl"
    text.write_text(
        "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n"
        "vertex 0 2 0\nendloop\nendfacet\nendsolid x\n"
    )
    for path in (binary, text):
        assert read_mesh(path).points.tolist() == CORNERS.tolist()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.dae", b""),
        ("a.obj", b"v 0 0 0\n"),
        ("a.obj", b"v 0 0 0\nf 1 2 3\n"),
        ("a.obj", b"v 0 0\nv 0 0 0\nv 1 0 0\nf 1 2 3\n"),
        ("a.obj", b"v a b c\n"),
        ("a.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        ("a.stl", b"text"),
        ("a.stl", bytes(80) + (9).to_bytes(4, "little")),
        ("a.stl", b"solid x vertex 1 2"),
        ("none.stl", None),
    ],
)
def test_what_is_broken_is_refused(
    tmp_path: Path, name: str, content: bytes | None
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ValueError, match=r"."):
        read_mesh(path)
