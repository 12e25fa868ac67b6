"""Cloth that hangs on a character and meets its skin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.attached import (
    moved,
    sheet_rig,
    simulated,
    strands_rig,
    tail_rig,
    take_of,
)

from animtool.maths import so3
from animtool.motion.motion import Channel
from animtool.motion.take import Take
from animtool.rig.parts import Capsule, Collider, LoadedArray, Mesh, Skin
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.systems.attach.skins import (
    build_skins,
    contact_offsets,
    skin_margin,
    triangulate_capped,
)
from animtool.systems.framework.meter import ClosedSurface, surface_depths

SIZE = 10
BOX = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
FACES = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
)
TRIANGLES = np.concatenate([FACES[:, [0, 1, 2]], FACES[:, [0, 2, 3]]])


def posted(
    faces: np.ndarray = FACES,
    size: int = SIZE,
    wide: tuple[float, float] = (0.6, 0.3),
    place: tuple[float, float] = (0.15, -0.2),
) -> Rig:
    """Return a post with a sheet, and a box of skin in front of it."""
    rig = sheet_rig(size)
    points = (BOX - [0.5, 0.5, 0]) * [*wide, 0.2] + [*place, -0.215]
    every = np.zeros((8, 1))
    skin = Skin("linear", ("post",), LoadedArray(every), LoadedArray(every + 1.0))
    box = Mesh("box", LoadedArray(points), LoadedArray(faces.astype(float)), skin=skin)
    return replace(rig, meshes=(*rig.meshes, box))


def blown(rig: Rig, **options: object) -> tuple[Take, list[str]]:
    """Return a sheet that the wind blows into the box, which goes up and down."""

    def place(t: np.ndarray) -> np.ndarray:
        return 0.1 * np.stack([np.sin(5 * t), np.sin(7 * t), 0 * t], axis=1)

    take = take_of(rig, 24, 0.5, place)
    return simulated(take, settle=0.3, wind=(0.0, 0.0, -12.0), **options)


def deepest(take: Take) -> float:
    """Return the deepest of the sheet in the box over all frames [m]."""
    points = take.rig.meshes[1].points.load()
    roots = take.world().positions[:, 0]
    frames = zip(moved(take), roots, strict=True)
    return max(
        float(surface_depths(ClosedSurface(points + root, TRIANGLES), x).max())
        for x, root in frames
    )


@pytest.mark.parametrize("faces", [FACES, FACES[:-1], FACES[:, ::-1]])
def test_cloth_stays_out_of_a_skin_closed_or_not(faces: np.ndarray) -> None:
    take, codes = blown(posted(faces))
    assert deepest(take) < 1e-4
    assert "SIM180" not in codes


@pytest.mark.parametrize("place", [(0.13, -0.17), (0.12, -0.19), (0.17, -0.21)])
@pytest.mark.parametrize("size", [4, 5])
def test_a_finger_between_the_points_of_coarse_cloth_does_not_pierce_it(
    size: int, place: tuple[float, float]
) -> None:
    _, codes = blown(posted(size=size, wide=(0.016, 0.016), place=place))
    assert not {"SIM180", "SIM181", "SIM182"} & set(codes)


def folded(size: int, middle: float) -> Take:
    """Return a take of a plate behind a sheet, which folds to a ridge towards it."""
    rig = sheet_rig(size)
    across = np.array([-0.12, -0.015, 0, 0.015, 0.12])
    loop = np.append(across, across[::-1]) + middle
    depths = np.repeat([-0.06, -0.08], len(across))
    levels, count = np.linspace(-0.28, -0.06, 12), len(loop)
    points = np.stack([np.tile(loop, 12), levels.repeat(count), np.tile(depths, 12)], 1)
    k = np.arange((len(levels) - 1) * count)
    following = k // count * count + (k + 1) % count
    faces = np.stack([k, following, following + count, k + count], axis=1)
    sides = np.tile([0.0, 0, 2, 1, 1, 1, 1, 2, 0, 0], len(levels))[:, None]
    every = LoadedArray(np.ones((len(points), 1)))
    skin = Skin("linear", ("left", "right", "post"), LoadedArray(sides), every)
    mesh = Mesh(
        "plate", LoadedArray(points), LoadedArray(faces.astype(float)), skin=skin
    )
    hinge = (middle, -0.15, -0.06)
    halves = [Joint(n, 0, JointType.BALL, translation=hinge) for n in skin.joints[:2]]
    joints, meshes = (*rig.joints, *halves), (*rig.meshes, mesh)
    take = take_of(replace(rig, joints=joints, meshes=meshes), 24, 1.0)
    rotations, t = take.motion.rotations.dense(), np.arange(take.clock.count) / 24
    angles = np.radians(75) * np.clip(t / 0.4, 0, 1)[:, None] * [0, 1.0, 0]
    rotations[:, 1], rotations[:, 2] = so3.exp(-angles), so3.exp(angles)
    channel = Channel.from_dense(rotations)
    return replace(take, motion=replace(take.motion, rotations=channel))


@pytest.mark.slow
@pytest.mark.parametrize(("size", "middle"), [(4, 0.14), (5, 0.11), (6, 0.14)])
def test_a_skin_that_folds_after_the_first_pose_does_not_pierce_coarse_cloth(
    size: int, middle: float
) -> None:
    found, codes = simulated(folded(size, middle), settle=0.3, wind=(0.0, 0.0, -8.0))
    assert codes == ["SIM130"]
    # It hangs down on both sides of the ridge.
    assert moved(found)[-1, :, 2].min() < -0.07


def test_without_it_cloth_goes_through() -> None:
    assert deepest(blown(posted(), skin=False)[0]) > 0.005


@pytest.mark.slow
def test_a_skin_stands_for_the_capsules_of_its_joints() -> None:
    ball = Collider("post", Capsule(0.08, 0.0, offset=(0.15, -0.2, -0.09)))
    rig = replace(posted(), colliders=(ball,))
    np.testing.assert_array_equal(moved(blown(rig)[0]), moved(blown(posted())[0]))
    apart = moved(blown(rig, skin=False)[0]) - moved(blown(posted(), skin=False)[0])
    assert np.abs(apart).max() > 1e-3


def test_borders_are_closed_outwards() -> None:
    triangles, points, borders = triangulate_capped(
        np.full(5, 4), FACES[:-1].ravel(), 8
    )
    assert sorted(points.tolist()) == [1, 3, 5, 7]
    assert borders.tolist() == [0, 0, 0, 0]
    places = np.concatenate([BOX, [[0.5, 0.5, 1.0]]])
    a, b, c = places[triangles].swapaxes(0, 1)
    assert (a * np.cross(b, c)).sum() / 6 == pytest.approx(1.0)


def test_cloth_is_no_skin() -> None:
    (skin,) = build_skins(posted())
    assert skin.mesh.name == "box"
    assert build_skins(sheet_rig(SIZE)) == []


def test_coarse_cloth_keeps_more() -> None:
    assert skin_margin(0.06, 0.005) == pytest.approx(0.01)
    assert skin_margin(0.006, 0.005) == 0


def test_points_keep_how_near_they_are_worn_but_not_what_a_limb_is_through() -> None:
    skin = ClosedSurface(BOX, TRIANGLES)
    heights = np.array([1.3, 1.04, 0.95, 0.7])
    points = np.stack([0 * heights + 0.5, 0 * heights + 0.5, heights], axis=1)
    offsets = contact_offsets(skin, points, 0.1)
    np.testing.assert_allclose(offsets, [0, -0.06, -0.1, 0], atol=1e-12)
    kept = contact_offsets(skin, points, 0.1, keeps_inside=True)
    np.testing.assert_allclose(kept, [0, -0.06, -0.15, -0.4], atol=1e-12)


def armed() -> Take:
    """Return a take whose first pose puts an arm of the post through the sheet."""
    rig = sheet_rig(SIZE)
    arm = Joint("arm", 0, JointType.BALL, translation=(0.15, -0.15, -0.1))
    points = (BOX - [0.5, 1, 0.5]) * [0.06, 0.15, 0.06] + arm.translation
    every = np.zeros((8, 1))
    skin = Skin("linear", ("arm",), LoadedArray(every), LoadedArray(every + 1.0))
    mesh = Mesh("arm", LoadedArray(points), LoadedArray(FACES.astype(float)), skin=skin)
    joints, meshes = (*rig.joints, arm), (*rig.meshes, mesh)
    raised = (-np.pi / 2, 0.0, 0.0)
    return take_of(replace(rig, joints=joints, meshes=meshes), 24, 0.3, arm=raised)


def test_cloth_that_a_limb_is_through_at_the_start_comes_clear(tmp_path: Path) -> None:
    path = tmp_path / "states.npz"
    whole, codes = simulated(armed(), save=str(path), save_at=(4.0,))
    assert codes == ["SIM130"]
    # The arm lifts it.
    assert moved(whole)[0, :, 2].max() > 0.05
    rest, _ = simulated(armed(), resume=path)
    np.testing.assert_array_equal(moved(rest)[3:], moved(whole)[3:])
    np.testing.assert_allclose(moved(rest)[0, :, 2], 0, atol=1e-12)


def test_in_blocks_it_moves_the_same() -> None:
    whole, _ = blown(posted())
    blocks, _ = blown(posted(), blocks=3)
    np.testing.assert_array_equal(moved(blocks), moved(whole))


def combed() -> Rig:
    """Return a head with strands that hang in front of a box of skin."""
    rig = strands_rig()
    points = (BOX - [0.5, 0.5, 0]) * [0.6, 0.3, 0.2] + [0.2, -0.3, -0.24]
    every = np.zeros((8, 1))
    skin = Skin("linear", ("head",), LoadedArray(every), LoadedArray(every + 1.0))
    box = Mesh("box", LoadedArray(points), LoadedArray(FACES.astype(float)), skin=skin)
    return replace(rig, meshes=(box,))


@pytest.mark.parametrize("skin", [True, False, None])
def test_strands_stay_out_of_a_skin_if_asked(skin: bool | None) -> None:
    take = take_of(combed(), 24, 0.5)
    blow = {"wind": (0.0, 0.0, -3.0), "drag": 2.0, "frequency": 0.2}
    strands, _ = simulated(take, settle=0.3, skin=skin, **blow)
    solid = ClosedSurface(take.rig.meshes[0].points.load(), TRIANGLES)
    depth = max(float(surface_depths(solid, x).max()) for x in moved(strands))
    assert depth < 1e-4 if skin else depth > 5e-3


# Of a tail that hangs down from the origin.
TAIL_BOX = (BOX - [0.5, 0.5, 0]) * [0.3, 0.3, 0.2] + [0.0, -0.35, -0.24]


def tailed(*corners: float) -> Rig:
    """Return a tail in front of a box of skin; some corners follow the tail alone."""
    rig = tail_rig(4, 0.12)
    tail = np.isin(np.arange(8), corners)[:, None].astype(float)
    weights = np.concatenate([1 - tail, tail], axis=1)
    indices = np.tile([0.0, 1.0], (8, 1))
    skin = Skin(
        "linear", ("body", "tail_4"), LoadedArray(indices), LoadedArray(weights)
    )
    faces = LoadedArray(FACES.astype(float))
    return replace(rig, meshes=(Mesh("box", LoadedArray(TAIL_BOX), faces, skin=skin),))


def wagged(rig: Rig, skin: bool | None) -> np.ndarray:
    down = {"tail_1": (0.0, 0.0, -np.pi / 2)}
    blow = {"wind": (0.0, 0.0, -3.0), "drag": 2.0, "frequency": 0.2}
    take = take_of(rig, 24, 0.5, **down)
    return moved(simulated(take, settle=0.3, skin=skin, **blow)[0])


@pytest.mark.parametrize("skin", [True, False, None])
def test_a_chain_stays_out_of_a_skin_if_asked(skin: bool | None) -> None:
    solid = ClosedSurface(TAIL_BOX, TRIANGLES)
    depth = max(float(surface_depths(solid, x).max()) for x in wagged(tailed(), skin))
    assert depth < 1e-4 if skin else depth > 5e-3


def test_a_chain_does_not_collide_with_what_it_moves() -> None:
    free = wagged(tail_rig(4, 0.12), True)
    np.testing.assert_array_equal(wagged(tailed(*range(8)), True), free)
    # The side towards the tail follows it; the hole is closed.
    (skin,) = build_skins(tailed(1, 3, 5, 7), [4])
    assert len(skin.triangles) == 6
    assert not skin.has_joint_weight[4]
