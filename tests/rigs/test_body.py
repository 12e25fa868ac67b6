"""The biped's body: closed, mirrored, held by few joints, made by its script."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.made_arrays import check_made
from support.manifold import boundary_edges, check_manifold, euler_characteristic
from support.suite import nightly

from animtool.documents.arrays import load_array
from animtool.rig.file import load_rig
from animtool.rig.kinematics import rest_world

BIPED = Path(__file__).parents[2] / "rigs/biped"


def array(name: str) -> np.ndarray:
    return load_array(BIPED / "body.npz", name)


@pytest.mark.slow
def test_it_is_a_trunk_and_two_hands_each_closed_and_without_a_hole() -> None:
    faces, points = array("faces").astype(int), array("points")
    check_manifold(faces)
    assert boundary_edges(faces) == 0
    assert euler_characteristic(faces) == 3 * 2
    assert len(np.unique(faces)) == len(points)


def test_no_face_is_degenerate() -> None:
    corners = array("points")[array("faces").astype(int)]
    across = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    assert np.linalg.norm(across, axis=1).min() > 1e-6
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    assert sides.min() > 1e-3


def test_it_stands_on_the_floor_in_its_own_mirror() -> None:
    points, twin = array("points"), array("mirror").astype(int)
    assert points[:, 1].min() == pytest.approx(0, abs=0.002)
    assert points[:, 1].max() == pytest.approx(1.75, abs=0.01)
    assert np.array_equal(points[twin] * [-1, 1, 1], points)


def test_weights_are_few_and_mirror() -> None:
    rig = load_rig(BIPED / "biped.rig.yaml")
    skin = rig.meshes[0].skin
    assert skin is not None
    weights, indices = array("weights"), array("indices").astype(int)
    assert weights.shape[1] == 4
    assert np.array_equal(weights.sum(1), np.ones(len(weights)))
    dense = np.zeros((len(weights), len(skin.joints)))
    rows = np.arange(len(weights))[:, None]
    np.add.at(dense, (rows, indices), weights)
    swap = {"_l": "_r", "_r": "_l"}
    twins = [
        skin.joints.index(name[:-2] + swap.get(name[-2:], name[-2:]))
        for name in skin.joints
    ]
    mirror = array("mirror").astype(int)
    assert np.abs(dense[mirror][:, twins] - dense).max() < 0.01
    still = {"jaw", "eye_l", "eye_r"}
    assert {skin.joints[j] for j in range(59) if not dense[:, j].any()} == still


def test_a_point_follows_joints_near_it() -> None:
    rig = load_rig(BIPED / "biped.rig.yaml")
    skin = rig.meshes[0].skin
    assert skin is not None
    places = rest_world(rig).positions[0]
    order = [rig.index(name) for name in skin.joints]
    joints = places[order][array("indices").astype(int)]
    away = np.linalg.norm(joints - array("points")[:, None], axis=-1)
    assert (away * (array("weights") > 0.2)).max() < 0.6


@nightly
def test_the_script_makes_the_arrays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("scipy")
    check_made(BIPED / "make_body.py", BIPED / "body.npz", tmp_path, monkeypatch)
