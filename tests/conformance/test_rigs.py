"""Kinematics, blend shapes and skinning against UsdSkel's, for every rig."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.data import data_files
from support.rigs import OracleRig, read_oracle

from animtool.skin.deform import DeformedMesh, deform
from animtool.skin.shapes import blend_points, prepare_shapes
from animtool.skin.skinning import prepare_skin

# UsdSkel works from float32 values, as a share of the rig's size; along a long chain
# its roundings add up.
TOLERANCE = 1e-6
LONG_CHAIN_TOLERANCE = 1e-4
LONG_CHAIN = 100  # joints

every_rig = pytest.mark.parametrize("path", data_files("rigs", "*.json"))


def bound(rig: OracleRig) -> float:
    """Return how far a value may be off."""
    size = max(1.0, float(np.abs(rig.joint_skel).max()))
    long = rig.joint_skel.shape[1] > LONG_CHAIN
    return (LONG_CHAIN_TOLERANCE if long else TOLERANCE) * size


@every_rig
def test_joints_are_where_usdskel_puts_them(path: Path) -> None:
    rig = read_oracle(path)
    truth = rig.joint_skel
    assert np.abs(rig.world.positions - truth[..., :3, 3]).max() <= bound(rig)
    assert np.abs(rig.world.linear - truth[..., :3, :3]).max() <= bound(rig)


@every_rig
def test_shapes_move_points_as_usdskel_does(path: Path) -> None:
    rig = read_oracle(path)
    if not rig.blended.size:
        pytest.skip("no blended points")
    points = blend_points(prepare_shapes(rig.shapes, rig.points), rig.weights)
    assert np.abs(points - rig.blended).max() <= bound(rig)


@every_rig
def test_meshes_deform_as_in_usdskel(path: Path) -> None:
    rig = read_oracle(path)
    if not rig.skinned.size:
        pytest.skip("no skinned points")
    mesh = DeformedMesh(
        rig.points,
        prepare_shapes(rig.shapes, rig.points),
        prepare_skin(rig.binding, len(rig.points)),
    )
    made = deform(mesh, rig.weights, rig.world)
    assert np.abs(made.points - rig.skinned).max() <= bound(rig)
    low, high = rig.skinned.min(axis=1), rig.skinned.max(axis=1)
    assert np.abs(made.extents - np.stack([low, high], axis=1)).max() <= bound(rig)


@every_rig
def test_a_mesh_with_a_joint_order_of_its_own_is_the_same(path: Path) -> None:
    rig = read_oracle(path)
    binding = rig.binding
    order = np.arange(len(np.asarray(binding.bind)))[::-1]
    turned = len(order) - 1 - np.asarray(binding.indices)
    reordered = type(binding)(
        turned, binding.weights, binding.bind, order, binding.geom_bind, binding.method
    )
    same = [
        deform(
            DeformedMesh(rig.points, skin=prepare_skin(bound_to, len(rig.points))),
            None,
            rig.world,
        ).points
        for bound_to in (binding, reordered)
    ]
    assert np.abs(same[0] - same[1]).max() <= 1e-12 * bound(rig) / TOLERANCE
