"""The biped's cape and hair: clear of the body, mirrored, made by their scripts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.made_arrays import check_made
from support.manifold import boundary_edges, check_manifold, euler_characteristic
from support.suite import nightly

from animtool.rig.file import load_rig
from animtool.rig.parts import Attachment, Mesh

BIPED = Path(__file__).parents[2] / "rigs/biped"
ACROSS, DOWN = 25, 31
# Between the body's mesh and the field that it is made of [m].
OFF = 0.002


def cape() -> Mesh:
    return next(
        m for m in load_rig(BIPED / "biped.rig.yaml").meshes if m.name == "cape"
    )


def attached(kind: str) -> Attachment:
    (found,) = [a for a in load_rig(BIPED / "biped.rig.yaml").attach if a.kind == kind]
    return found


def strands() -> np.ndarray:
    points = attached("strands").points
    assert points is not None
    return points.load()


def away_from_the_body(points: np.ndarray) -> np.ndarray:
    """Return the distance to the body's nearest point along its normal."""
    spatial = pytest.importorskip("scipy.spatial")
    body = load_rig(BIPED / "biped.rig.yaml").meshes[0]
    assert body.normals is not None
    places, normals = body.points.load(), body.normals.load()
    # Of several near points, the one most in front counts: the body is round.
    _, near = spatial.cKDTree(places).query(points, 4)
    apart = points[:, None] - places[near]
    return np.einsum("nkj,nkj->nk", apart, normals[near]).max(axis=1)


def test_the_cape_is_one_sheet_that_faces_back() -> None:
    mesh = cape()
    faces, points = mesh.faces.load().astype(int), mesh.points.load()
    check_manifold(faces)
    assert len(points) == ACROSS * DOWN
    assert boundary_edges(faces) == 2 * (ACROSS - 1 + DOWN - 1)
    assert euler_characteristic(faces) == 1
    assert mesh.normals is not None
    assert mesh.normals.load()[:, 2].mean() < -0.9
    grid = points.reshape(DOWN, ACROSS, 3)
    assert np.array_equal(grid[:, ::-1] * [-1, 1, 1], grid)
    down = np.linalg.norm(np.diff(grid, axis=0), axis=-1)
    assert down.min() > 0.6 * down.max()


def test_the_cape_is_clear_of_the_body() -> None:
    mesh = cape()
    points, faces = mesh.points.load(), mesh.faces.load().astype(int)
    assert away_from_the_body(points).min() > 0.01
    assert away_from_the_body(points[faces].mean(axis=1)).min() > OFF


def test_the_cape_follows_the_back_smoothly() -> None:
    skin = cape().skin
    assert skin is not None
    weights, indices = skin.weights.load(), skin.indices.load().astype(int)
    assert np.array_equal(weights.sum(axis=1), np.ones(len(weights)))
    dense = np.zeros((ACROSS * DOWN, len(skin.joints)))
    np.add.at(dense, (np.arange(len(dense))[:, None], indices), weights)
    assert dense.any(axis=0).all()
    grid = dense.reshape(DOWN, ACROSS, -1)
    assert np.abs(np.diff(grid, axis=0)).max() < 0.4
    assert np.abs(np.diff(grid, axis=1)).max() < 0.2


def test_the_upper_edge_is_pinned() -> None:
    entry = attached("cloth")
    assert (entry.mesh, entry.joints) == ("cape", ())
    assert entry.pins is not None
    pins = entry.pins.load().astype(int)
    assert np.array_equal(pins, np.arange(ACROSS))


def test_hair_grows_on_the_head_and_hangs_clear_of_it() -> None:
    points = strands()
    assert points.shape == (60, 12, 3)
    assert np.abs(away_from_the_body(points[:, 0])).max() < OFF
    assert away_from_the_body(points[:, 2:].reshape(-1, 3)).min() > 0
    assert (points[:, -1, 1] < points[:, 0, 1] - 0.1).all()
    steps = np.linalg.norm(np.diff(points, axis=1), axis=-1)
    assert steps.min() > 0.01
    assert len(np.unique(points[:, 0], axis=0)) == len(points)


@nightly
@pytest.mark.parametrize("name", ["cape", "hair"])
def test_the_scripts_make_the_arrays(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = BIPED / f"{name}.npz"
    check_made(BIPED / f"make_{name}.py", kept, tmp_path, monkeypatch)
    assert kept.stat().st_size < 100_000


def test_hair_clears_the_cape() -> None:
    spatial: Any = pytest.importorskip("scipy.spatial")
    sheet = cape().points.load()
    apart, _ = spatial.cKDTree(sheet).query(strands().reshape(-1, 3))
    assert apart.min() > 0.01
