from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from pxr import Gf, UsdSkel, Vt
from support.faults import raises
from support.skins import (
    Array,
    Case,
    affine,
    as_world,
    homogeneous,
    matrices,
    of_world,
    plain_linear,
    random_case,
    rigid,
)

from animtool import _kernels
from animtool.core.errors import FormatError
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms
from animtool.skin.skinning import (
    Binding,
    SkinMethod,
    prepare_skin,
    skin_normals,
    skin_points,
)

LINEAR, DUAL = SkinMethod.LINEAR, SkinMethod.DUAL_QUATERNION
USD_NAMES = {LINEAR: "classicLinear", DUAL: "dualQuaternion"}
# UsdSkel keeps points and weights in float32.
USD_TOLERANCE = 2e-6

seeds = st.integers(0, 2**32 - 1)
methods = pytest.mark.parametrize("method", list(SkinMethod))


def skinned(case: Case) -> Array:
    skin = prepare_skin(case.binding, len(case.points))
    return skin_points(skin, case.points[None], case.world)


@given(seeds, st.integers(1, 4), st.booleans())
def test_linear_is_the_sum_of_what_each_joint_does(
    seed: int, frames: int, scaled: bool
) -> None:
    case = random_case(seed, frames=frames, scaled=scaled)
    assert_allclose(skinned(case), plain_linear(case), atol=1e-12)


@given(seeds, st.integers(1, 4))
def test_dual_quaternions_written_out(seed: int, frames: int) -> None:
    case = random_case(seed, frames=frames).with_method(DUAL)
    binding = case.binding
    moved = of_world(case.world) @ np.linalg.inv(np.asarray(binding.bind))
    placed = homogeneous(case.points) @ np.asarray(binding.geom_bind).T
    real = so3.from_matrix(moved[..., :3, :3])
    pure = np.concatenate([moved[..., :3, 3], np.zeros((*real.shape[:-1], 1))], axis=-1)
    dual = 0.5 * so3.multiply(pure, real)
    expected = np.empty((frames, len(case.points), 3))
    weights, indices = np.asarray(binding.weights), np.asarray(binding.indices)
    for f, v in np.ndindex(expected.shape[:2]):
        own, strong = indices[v], indices[v][np.argmax(weights[v])]
        signs = np.where(real[f, own] @ real[f, strong] < 0, -1.0, 1.0)
        a = (weights[v] * signs) @ real[f, own]
        b = (weights[v] * signs) @ dual[f, own]
        length = np.linalg.norm(a)
        shift = 2 * so3.multiply(b / length, so3.conjugate(a / length))[:3]
        expected[f, v] = so3.rotate(a / length, placed[v, :3]) + shift
    assert_allclose(skinned(case), expected, atol=1e-12)


@methods
@given(seed=seeds)
def test_the_bind_pose_gives_points_back(method: SkinMethod, seed: int) -> None:
    case = random_case(seed, frames=1).with_method(method)
    world = as_world(np.asarray(case.binding.bind)[None])
    placed = homogeneous(case.points) @ np.asarray(case.binding.geom_bind).T
    assert_allclose(skinned(replace(case, world=world))[0], placed[:, :3], atol=1e-12)


@methods
@given(seed=seeds)
def test_moving_all_joints_rigidly_moves_all_points_so(
    method: SkinMethod, seed: int
) -> None:
    case = random_case(seed).with_method(method)
    motion = rigid(np.random.default_rng(seed + 1))
    moved = replace(case, world=as_world(motion @ of_world(case.world)))
    expected = homogeneous(skinned(case)) @ motion.T
    assert_allclose(skinned(moved), expected[..., :3], atol=1e-11)


@methods
@given(seed=seeds, scaled=st.booleans())
def test_one_joint_alone_is_its_transform(
    method: SkinMethod, seed: int, scaled: bool
) -> None:
    case = random_case(seed, influences=1, scaled=scaled).with_method(method)
    assert_allclose(skinned(case), plain_linear(case), atol=1e-11)


@methods
@given(seed=seeds, scaled=st.booleans())
def test_the_order_of_influences_does_not_matter(
    method: SkinMethod, seed: int, scaled: bool
) -> None:
    case = random_case(seed, scaled=scaled).with_method(method)
    turned = replace(
        case.binding,
        indices=np.asarray(case.binding.indices)[:, ::-1],
        weights=np.asarray(case.binding.weights)[:, ::-1],
    )
    assert_array_equal(skinned(case), skinned(replace(case, binding=turned)))


@methods
@given(seed=seeds)
def test_each_frame_alone_is_the_same(method: SkinMethod, seed: int) -> None:
    case = random_case(seed, frames=3).with_method(method)
    whole = skinned(case)
    for f in range(3):
        part = slice(f, f + 1)
        world = WorldTransforms(case.world.positions[part], case.world.linear[part])
        assert_array_equal(skinned(replace(case, world=world))[0], whole[f])


@methods
def test_points_of_each_frame(method: SkinMethod) -> None:
    case = random_case(3, scaled=True).with_method(method)
    skin = prepare_skin(case.binding, len(case.points))
    points = np.random.default_rng(3).normal(size=(3, len(case.points), 3))
    whole = skin_points(skin, points, case.world)
    for f in range(3):
        alone = skin_points(skin, points[f : f + 1], case.world)
        assert_allclose(whole[f], alone[f], atol=1e-14)


@methods
def test_a_result_is_filled_in(method: SkinMethod) -> None:
    case = random_case(3).with_method(method)
    skin = prepare_skin(case.binding, 17)
    out = np.full((3, 17, 3), np.nan)
    made = skin_points(skin, case.points[None], case.world, out=out)
    assert made is out
    assert_array_equal(out, skinned(case))
    with pytest.raises(ValueError, match="out must be float64"):
        skin_points(skin, case.points[None], case.world, out=out[:2])


def test_a_half_twist_keeps_its_radius_under_dual_quaternions() -> None:
    """Linear blending collapses it to the axis: the candy wrapper."""
    turn = so3.to_matrix(so3.from_axis_angle([1, 0, 0], np.pi * 0.999999))
    world = as_world(matrices(np.stack([np.eye(3), turn]), np.zeros((2, 3)))[None])
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.stack([np.zeros(12), np.cos(angles), np.sin(angles)], axis=-1)
    binding = Binding([[0, 1]], [[0.5, 0.5]], np.tile(np.eye(4), (2, 1, 1)))
    case = Case(ring, binding, world)
    assert np.linalg.norm(skinned(case)[0], axis=1).max() < 1e-5
    radii = np.linalg.norm(skinned(case.with_method(DUAL))[0], axis=1)
    assert_allclose(radii, 1, atol=1e-12)


@given(seed=seeds, share=st.floats(0.01, 0.99))
def test_dual_quaternions_move_what_shares_weights_rigidly(
    seed: int, share: float
) -> None:
    case = random_case(seed, joints=2, influences=2, vertices=6).with_method(DUAL)
    binding = replace(case.binding, indices=[[0, 1]], weights=[[share, 1 - share]])
    made = skinned(replace(case, binding=binding))

    def distances(points: Array) -> Array:
        gaps = points[..., :, None, :] - points[..., None, :, :]
        return np.asarray(np.linalg.norm(gaps, axis=-1))

    expected = np.broadcast_to(distances(case.points), (3, 6, 6))
    assert_allclose(distances(made), expected, atol=1e-9)


@methods
@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize("seed", range(8))
def test_points_are_those_of_usdskel(
    method: SkinMethod, scaled: bool, seed: int
) -> None:
    case = random_case(seed, vertices=40, scaled=scaled).with_method(method)
    made = skinned(case)
    for f, moved in enumerate(skinning_transforms(case)):
        points = Vt.Vec3fArray.FromNumpy(case.points.astype(np.float32))
        assert UsdSkel.SkinPoints(
            USD_NAMES[method],
            Gf.Matrix4d(np.asarray(case.binding.geom_bind).T.tolist()),
            moved,
            *usd_influences(case.binding),
            points,
        )
        size = max(1.0, float(np.abs(made[f]).max()))
        assert np.abs(np.array(points) - made[f]).max() <= USD_TOLERANCE * size


@methods
@pytest.mark.parametrize("scaled", [False, True])
def test_normals_are_those_of_usdskel(method: SkinMethod, scaled: bool) -> None:
    case = random_case(5, vertices=40, scaled=scaled).with_method(method)
    if scaled and method is DUAL:
        # UsdSkel splits sheared transforms of normals another way than of points.
        case = replace(case, world=uniformly_scaled(case))
    normals = np.random.default_rng(1).normal(size=(40, 3))
    made = skin_normals(prepare_skin(case.binding, 40), normals[None], case.world)
    assert_allclose(np.linalg.norm(made, axis=-1), 1, atol=1e-12)
    for f, moved in enumerate(skinning_transforms(case)):
        turns = [m.ExtractRotationMatrix().GetInverse().GetTranspose() for m in moved]
        geom = Gf.Matrix4d(np.asarray(case.binding.geom_bind).T.tolist())
        array = Vt.Vec3fArray.FromNumpy(normals.astype(np.float32))
        assert UsdSkel.SkinNormals(
            USD_NAMES[method],
            geom.ExtractRotationMatrix().GetInverse().GetTranspose(),
            Vt.Matrix3dArray(turns),
            *usd_influences(case.binding),
            array,
        )
        assert np.abs(np.array(array) - made[f]).max() <= 1e-5


def uniformly_scaled(case: Case) -> WorldTransforms:
    rng = np.random.default_rng(9)
    linear = rigid(rng, 3, 5)[..., :3, :3] * rng.uniform(0.5, 2, (3, 5, 1, 1))
    return WorldTransforms(case.world.positions, linear)


def skinning_transforms(case: Case) -> list[Vt.Matrix4dArray]:
    moved = of_world(case.world) @ np.linalg.inv(np.asarray(case.binding.bind))
    return [
        Vt.Matrix4dArray([Gf.Matrix4d(m.T.tolist()) for m in frame]) for frame in moved
    ]


def usd_influences(binding: Binding) -> tuple[Vt.IntArray, Vt.FloatArray, int]:
    indices = np.asarray(binding.indices, np.int32)
    weights = np.asarray(binding.weights, np.float32)
    return (
        Vt.IntArray.FromNumpy(indices.ravel()),
        Vt.FloatArray.FromNumpy(weights.ravel()),
        indices.shape[1],
    )


def test_a_vanishing_joint_leaves_the_dual_quaternion_blend_as_in_usdskel() -> None:
    case = random_case(2, vertices=30).with_method(DUAL)
    linear = case.world.linear.copy()
    linear[:, 1] *= 1e-6
    case = replace(case, world=WorldTransforms(case.world.positions, linear))
    made = skinned(case)
    assert np.isfinite(made).all()
    points = Vt.Vec3fArray.FromNumpy(case.points.astype(np.float32))
    moved = skinning_transforms(case)[0]
    geom = Gf.Matrix4d(np.asarray(case.binding.geom_bind).T.tolist())
    influences = usd_influences(case.binding)
    assert UsdSkel.SkinPoints("dualQuaternion", geom, moved, *influences, points)
    assert np.abs(np.array(points) - made[0]).max() <= USD_TOLERANCE * 10


@methods
def test_normals_stay_square_to_what_they_stand_on(method: SkinMethod) -> None:
    case = random_case(4, influences=1, scaled=True).with_method(method)
    rng = np.random.default_rng(0)
    along, across = rng.normal(size=(2, len(case.points), 3))
    normals = np.cross(along, across)
    skin = prepare_skin(case.binding, len(case.points))
    turned = skin_normals(skin, normals[None], case.world)
    ends = [case.points, case.points + along, case.points + across]
    start, *others = [skin_points(skin, end[None], case.world) for end in ends]
    for other in others:
        assert np.abs(((other - start) * turned).sum(axis=-1)).max() < 1e-11


def test_a_normal_on_a_joint_of_no_size_is_zero() -> None:
    case = random_case(1, influences=1)
    flat = WorldTransforms(case.world.positions, np.zeros_like(case.world.linear))
    skin = prepare_skin(case.binding, len(case.points))
    assert not skin_normals(skin, case.points[None], flat).any()


def test_only_the_joints_that_weigh_are_kept() -> None:
    binding = Binding([[4, 2]], [[0.5, 0.5]], np.tile(np.eye(4), (6, 1, 1)))
    assert_array_equal(prepare_skin(binding, 1).joints, [2, 4])
    reordered = replace(binding, indices=[[0, 1]], joints=[5, 1, 0])
    assert_array_equal(prepare_skin(reordered, 1).joints, [5, 1])


@given(seeds)
def test_a_linear_map_is_a_rotation_after_a_stretch(seed: int) -> None:
    linear = affine(np.random.default_rng(seed), 2, 3)[..., :3, :3].copy()
    turns, stretches = _kernels.split_stretch(linear)
    assert_allclose(so3.to_matrix(turns) @ stretches, linear, atol=1e-13)
    assert_allclose(stretches, stretches.swapaxes(-1, -2), atol=0)
    values = np.linalg.eigvalsh(stretches)
    signs = np.sign(np.linalg.det(linear))[..., None]
    assert (values * signs > 0).all()


@pytest.mark.parametrize(
    ("changed", "code"),
    [
        ({"bind": np.zeros((5, 3, 4))}, "SKIN001"),
        ({"geom_bind": np.eye(3)}, "SKIN001"),
        ({"joints": [[0, 1]]}, "SKIN001"),
        ({"joints": [0, 1, 2, 3, 9]}, "SKIN002"),
        ({"bind": np.full((5, 4, 4), np.nan)}, "SKIN003"),
        ({"geom_bind": np.full((4, 4), np.inf)}, "SKIN003"),
        ({"bind": np.zeros((5, 4, 4))}, "USD226"),
    ],
)
def test_a_fault_of_a_binding_is_named(changed: dict[str, object], code: str) -> None:
    binding = replace(random_case(0).binding, **changed)
    with pytest.raises(FormatError) as caught:
        prepare_skin(binding, 17)
    assert caught.value.code == code


def test_a_singular_bind_of_a_joint_that_nothing_follows_is_no_fault() -> None:
    bind = np.tile(np.eye(4), (2, 1, 1))
    bind[1] = 0
    assert prepare_skin(Binding([[0]], [[1.0]], bind), 3).vertex_count == 3


@methods
def test_a_joint_that_is_not_finite_is_named(method: SkinMethod) -> None:
    case = random_case(0).with_method(method)
    case.world.linear[2, 3, 0, 0] = np.nan
    with raises(FormatError, "SKIN003", match=r"joint 3.*frame 2"):
        skinned(case)
