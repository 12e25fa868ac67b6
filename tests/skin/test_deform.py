from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.skins import Array, random_case

from animtool.core.errors import FormatError
from animtool.motion.motion import Channel
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.parts import Subdivision
from animtool.rig.surfaces import Surface, SurfaceShape
from animtool.skin.deform import (
    DeformedFrames,
    DeformedMesh,
    deform,
    deform_blocks,
    extents,
    replace_points,
    vertex_normals,
)
from animtool.skin.shapes import blend_points, prepare_shapes
from animtool.skin.skinning import prepare_skin, skin_normals, skin_points

FRAMES = 11
SECONDS = np.arange(FRAMES) / 24


def mesh_and_motion() -> tuple[DeformedMesh, Array, WorldTransforms]:
    case = random_case(8, frames=FRAMES, scaled=True)
    rng = np.random.default_rng(8)
    normals = rng.normal(size=case.points.shape)
    shapes = [
        SurfaceShape("a", rng.normal(size=(3, 3)), [1, 5, 6], rng.normal(size=(3, 3))),
        SurfaceShape("b", rng.normal(size=case.points.shape)),
    ]
    mesh = DeformedMesh(
        case.points,
        prepare_shapes(shapes, case.points, normals),
        prepare_skin(case.binding, len(case.points)),
        normals,
    )
    return mesh, rng.uniform(0, 1, (FRAMES, 2)), case.world


def test_shapes_come_before_the_skin() -> None:
    mesh, weights, world = mesh_and_motion()
    assert mesh.shapes is not None
    assert mesh.skin is not None
    shaped = blend_points(mesh.shapes, weights)
    made = deform(mesh, weights, world)
    assert_array_equal(made.points, skin_points(mesh.skin, shaped, world))
    assert_array_equal(made.extents[:, 0], made.points.min(axis=1))
    assert_array_equal(made.extents[:, 1], made.points.max(axis=1))
    assert made.normals is None
    assert made.velocities is None


@pytest.mark.parametrize("block", [1, 2, 4, 5, 100, None])
def test_blocks_are_the_whole_in_pieces(
    block: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    if block is not None:
        monkeypatch.setattr("animtool.skin.deform.block_frames", lambda _: block)
    mesh, weights, world = mesh_and_motion()
    whole = deform(mesh, weights, world, normals=True, times=SECONDS)
    names = ("points", "extents", "normals", "velocities")
    parts = [
        {name: getattr(part, name).copy() for name in names}
        for part in deform_blocks(mesh, weights, world, normals=True, times=SECONDS)
    ]
    for name in names:
        joined = np.concatenate([part[name] for part in parts])
        assert_allclose(joined, getattr(whole, name), atol=1e-12)


def test_velocities_of_a_steady_motion_are_exact() -> None:
    case = random_case(1, frames=1)
    shift = np.arange(5.0)[:, None, None] * [[[0.5, 0.0, -1.0]]]
    world = WorldTransforms(
        case.world.positions + shift, np.repeat(case.world.linear, 5, axis=0)
    )
    mesh = DeformedMesh(case.points, skin=prepare_skin(case.binding, 17))
    made = deform(mesh, None, world, times=np.arange(5) / 30.0).velocities
    expected = np.broadcast_to([15.0, 0, -30.0], (5, 17, 3))
    assert made is not None
    assert_allclose(made, expected, atol=1e-12)


def test_velocities_between_uneven_frames_are_of_second_order() -> None:
    case = random_case(1, frames=1)
    times = np.array([0.0, 0.1, 0.15, 0.4, 0.5])
    shift = (times**2)[:, None, None] * [[[1.0, 0.0, -2.0]]]
    world = WorldTransforms(
        case.world.positions + shift, np.repeat(case.world.linear, 5, axis=0)
    )
    mesh = DeformedMesh(case.points, skin=prepare_skin(case.binding, 17))
    made = deform(mesh, None, world, times=times).velocities
    assert made is not None
    expected = (2 * times)[1:-1, None, None] * [[[1.0, 0.0, -2.0]]]
    assert_allclose(made[1:-1], np.broadcast_to(expected, (3, 17, 3)), atol=1e-12)


def test_one_frame_does_not_move() -> None:
    mesh = DeformedMesh(np.eye(3))
    made = deform(mesh, np.zeros((1, 0)), times=[0.0])
    assert made.velocities is not None
    assert not made.velocities.any()


def test_without_weights_the_shapes_are_off() -> None:
    mesh, weights, world = mesh_and_motion()
    off = deform(mesh, 0 * weights, world, normals=True)
    none = deform(mesh, None, world, normals=True)
    assert_array_equal(off.points, none.points)
    assert_array_equal(off.normals, none.normals)
    assert mesh.skin is not None
    assert_array_equal(none.normals, skin_normals(mesh.skin, [mesh.normals], world))


def test_without_a_skin_points_stay_in_their_own_space() -> None:
    mesh, weights, world = mesh_and_motion()
    alone = DeformedMesh(mesh.points, mesh.shapes, None, mesh.normals)
    made = deform(alone, weights, world, normals=True)
    assert mesh.shapes is not None
    assert made.normals is not None
    assert_array_equal(made.points, blend_points(mesh.shapes, weights))
    assert_allclose(np.linalg.norm(made.normals, axis=-1), 1)


def test_results_may_be_written_to() -> None:
    made = deform(DeformedMesh(np.eye(3)), np.zeros((2, 0)))
    made.points[0] += 1
    assert_array_equal(made.points[1], np.eye(3))


def test_extents_of_no_points_are_empty() -> None:
    low, high = extents(np.zeros((1, 0, 3)))[0]
    assert (low > high).all()


def test_another_number_of_frames_is_refused() -> None:
    mesh, weights, world = mesh_and_motion()
    with pytest.raises(ValueError, match="number of frames"):
        deform(mesh, weights[:3], world)
    with pytest.raises(ValueError, match="number of frames"):
        deform(mesh)


def test_normals_of_a_mesh_without_any_are_refused() -> None:
    with pytest.raises(ValueError, match="no normals"):
        deform(DeformedMesh(np.eye(3)), np.zeros((1, 0)), normals=True)


def test_parts_that_do_not_fit_are_refused() -> None:
    mesh, _, _ = mesh_and_motion()
    with pytest.raises(FormatError) as caught:
        DeformedMesh(
            np.full((3, 3), np.nan), mesh.shapes, mesh.skin, normals=np.zeros((2, 3))
        )
    codes = [fault.code for fault in caught.value.faults]
    assert codes == ["SKIN001", "SKIN001", "SKIN003", "SKIN001"]


def square() -> Surface:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]])
    counts, indices = np.array([4, 3]), np.array([0, 1, 2, 3, 1, 4, 2])
    normals = np.tile([0.0, 0.0, 1.0], (5, 1))
    return Surface(
        "s", points, counts, indices, normals, np.eye(4), None, (), Subdivision.NONE
    )


def test_normals_are_those_of_the_faces() -> None:
    surface = square()
    flat = surface.points[None]
    tilted = flat @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    assert_allclose(vertex_normals(surface, flat)[0], surface.normals)
    assert_allclose(
        vertex_normals(surface, tilted)[0], np.tile([0.0, -1.0, 0.0], (5, 1))
    )


def test_only_frames_that_differ_get_other_normals() -> None:
    surface = square()
    kept = np.tile([0.6, 0.0, 0.8], (3, 5, 1))
    still = np.repeat(surface.points[None], 3, axis=0)
    made = DeformedFrames(still, extents(still), kept)
    values = still.copy()
    values[1, :, 2] += 1.0
    moved = Channel(values[0], np.arange(5), values)
    found = replace_points(made, moved, slice(0, 3), surface, None)
    assert found.normals is not None
    assert_array_equal(found.normals[[0, 2]], kept[[0, 2]])
    assert_allclose(found.normals[1], surface.normals)
    assert_array_equal(found.points, values)


def test_velocities_look_beyond_the_block() -> None:
    times = np.arange(6) / 24
    values = np.sin(3 * times)[:, None, None] * np.ones((1, 2, 3))
    moved = Channel(values[0], np.arange(2), values)
    whole = np.gradient(values, times, axis=0)
    zero = np.zeros((2, 2, 3))
    made = DeformedFrames(zero, extents(zero), None, zero)
    found = replace_points(made, moved, slice(2, 4), None, times)
    assert_allclose(found.velocities, whole[2:4])
