"""Cases that simulations break on, named as the shared data name them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction

import numpy as np
from numpy.testing import assert_allclose
from support.attached import (
    moved,
    sheet_rig,
    simulated,
    strands_rig,
    tail_rig,
    take_of,
)

from animtool.maths import so3
from animtool.rig.parts import Attachment, Capsule, Collider, HeldArray
from animtool.rig.skeleton import Joint, JointType, Pose, Rig
from animtool.take import Channel, Motion, Take

Places = Callable[[np.ndarray], np.ndarray]


def still(t: np.ndarray) -> np.ndarray:
    return np.zeros((len(t), 3))


def with_walls(rig: Rig, *walls: tuple[str, tuple[float, float, float]]) -> Rig:
    """Return a rig with balls of 0.1 m on joints of their own, away from the root."""
    joints = [
        *rig.joints,
        *(Joint(name, 0, translation=place) for name, place in walls),
    ]
    balls = [Collider(name, Capsule(0.1, 0.0)) for name, _ in walls]
    return replace(rig, joints=tuple(joints), colliders=tuple(balls))


def going(rig: Rig, seconds: float, **places: Places) -> Take:
    """Return a take at 24 fps whose joints are where functions of time say."""
    take = take_of(rig, 24, seconds)
    t = np.arange(take.clock.count) / 24
    values = take.motion.translations.dense()
    for name, place in places.items():
        values[:, rig.index(name)] = place(t)
    translations = Channel.from_dense(values)
    return replace(take, motion=replace(take.motion, translations=translations))


def speeds(take: Take) -> np.ndarray:
    """Return how fast points are from frame to frame ``(F - 1, N)`` [m/s]."""
    return np.linalg.norm(np.diff(moved(take), axis=0), axis=-1) * 24


def test_coincident_particles() -> None:
    rig = tail_rig(3, 0.2)
    joints = list(rig.joints)
    joints[2] = replace(joints[2], translation=(0.0, 0.0, 0.0))
    found, _ = simulated(take_of(replace(rig, joints=tuple(joints)), 24, 1.0))
    assert np.isfinite(found.motion.rotations.dense()).all()
    assert_allclose(moved(found)[:, 1], moved(found)[:, 0], atol=1e-12)


def test_all_coincident() -> None:
    rig = sheet_rig()
    mesh = replace(rig.meshes[0], points=HeldArray(np.zeros((16, 3))))
    take = take_of(replace(rig, meshes=(mesh,)), 24, 0.5)
    one, other = (moved(simulated(take)[0]) for _ in range(2))
    assert np.isfinite(one).all()
    assert (one == other).all()


def test_both_ends_pinned() -> None:
    take = take_of(sheet_rig(pins=tuple(range(16))), 24, 0.5)
    found, codes = simulated(take)
    flat, _ = simulated(take, weight=((1, 1), (2, 0)))
    assert codes == ["SIM130"]
    assert_allclose(moved(found), np.broadcast_to(moved(flat)[-1], (13, 16, 3)))


def test_dt_spike() -> None:
    """A motion that goes straight is the same in few frames as in many."""

    def slide(t: np.ndarray) -> np.ndarray:
        return np.stack([0.5 * t, 0 * t, 0 * t], axis=1)

    many = take_of(strands_rig(), 24, 1.0, slide)
    few = many.motion.select(np.array([0, 12, 24]))
    clock = replace(many.clock, step=Fraction(12), count=3)
    options = {"rate": 480.0, "settle": 0.5}
    whole = moved(simulated(many, **options)[0])
    spiky = replace(many, clock=clock, motion=few)
    assert_allclose(moved(simulated(spiky, **options)[0]), whole[::12], atol=1e-9)


def test_collider_teleport() -> None:
    """A ball that jumps 100 m to where hair hangs pushes it, and flings nothing."""
    rig = with_walls(strands_rig(), ("ball", (0.1, -0.3, 0.0)))

    def jump(t: np.ndarray) -> np.ndarray:
        places = np.tile([0.12, -0.3, 0.02], (len(t), 1))
        places[t < 0.5, 0] += 100.0
        return places

    take = going(rig, 1.5, ball=jump)
    found, _ = simulated(take, settle=0.2)
    places = moved(found)
    assert np.isfinite(places).all()
    lengths = np.linalg.norm(np.diff(places.reshape(-1, 3, 5, 3), axis=2), axis=-1)
    assert (lengths[-1] < 0.1 * 1.05).all()
    assert speeds(found)[14:].max() < 10


def test_pin_teleport() -> None:
    def jump(t: np.ndarray) -> np.ndarray:
        return np.where(t[:, None] < 0.5, 0.0, [[100.0, 0.0, 0.0]])

    found, codes = simulated(take_of(strands_rig(), 24, 1.0, jump), settle=1.0)
    assert codes == ["SIM130"]
    own = moved(found) - found.world().positions[:, :1]
    assert_allclose(own, np.broadcast_to(own[0], own.shape), atol=1e-3)


def test_rest_contact() -> None:
    """A tail that lies on a wide capsule stays there, without a tremble."""
    rig = tail_rig(1, 0.5)
    floor = Collider("body", Capsule(0.3, 1.0, (0.0, 0.0, 1.0), (0.5, -0.35, 0.0)))
    take = take_of(replace(rig, colliders=(floor,)), 24, 4.0)
    found, _ = simulated(take, frequency=0.0, friction=0.6, settle=4.0)
    assert speeds(found)[-24:].max() < 1e-3
    end = moved(found)[:, 1]
    apart = np.linalg.norm(end[:, :2] - [0.5, -0.35], axis=1)
    assert (apart > 0.3 + 0.005 - 1e-4).all()


def test_deep_start_penetration() -> None:
    """Hair that begins inside a ball leaves it slowly."""
    rig = with_walls(strands_rig(), ("ball", (0.1, -0.3, 0.0)))
    take = going(rig, 1.0, ball=lambda t: np.tile([0.12, -0.2, 0.03], (len(t), 1)))
    # At bind, too, it would be let be.
    bind = {"ball": Pose((50.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))}
    take = replace(take, rig=replace(rig, bind=bind))
    found, _ = simulated(take, settle=0.0)
    assert np.isfinite(moved(found)).all()
    assert speeds(found).max() < 3.0


def test_pinched() -> None:
    """Hair between two balls that close in: finite, not flung, and named."""
    rig = with_walls(
        strands_rig(), ("left", (-5.0, -0.4, 0.0)), ("right", (5.0, -0.4, 0.0))
    )

    def closing(side: float) -> Places:
        def place(t: np.ndarray) -> np.ndarray:
            gap = np.maximum(0.4 * (1 - 2 * t), 0.01)
            return np.stack([0.2 + side * gap, 0 * t - 0.4, 0 * t], axis=1)

        return place

    take = going(rig, 1.0, left=closing(-1.0), right=closing(1.0))
    found, codes = simulated(take)
    assert np.isfinite(moved(found)).all()
    assert speeds(found).max() < 20
    assert "SIM132" in codes


def test_degenerate_faces() -> None:
    """A face without area, and an edge of three faces, are cloth like others."""
    points = np.array(
        [[0, 0, 0], [0.1, 0, 0], [0, -0.1, 0], [0.1, -0.1, 0], [0, 0, 0.1], [0.2, 0, 0]]
    )
    faces = np.array([[0, 1, 2], [1, 2, 3], [1, 2, 4], [0, 1, 5]], np.float64)
    rig = sheet_rig()
    mesh = replace(rig.meshes[0], points=HeldArray(points), faces=HeldArray(faces))
    skin = replace(
        mesh.skin,
        indices=HeldArray(np.zeros((6, 1))),
        weights=HeldArray(np.ones((6, 1))),
    )
    attach = Attachment("flag", "cloth", mesh="flag", pins=HeldArray(np.zeros(1)))
    rig = replace(rig, meshes=(replace(mesh, skin=skin),), attach=(attach,))
    found, _ = simulated(take_of(rig, 24, 0.5))
    assert np.isfinite(moved(found)).all()


def test_a_body_in_another_unit_or_size_moves_alike() -> None:
    """Lengths are metres inside: twice as large a character is only larger."""
    take = take_of(strands_rig(), 24, 0.5)
    scales = Channel.from_dense(np.full((take.clock.count, 1, 3), 2.0))
    large = replace(take, motion=replace(take.motion, scales=scales))
    options = {"gravity": 0.0, "frequency": 0.0}
    assert_allclose(
        moved(simulated(large, **options)[0]),
        2 * moved(simulated(take, **options)[0]),
        atol=1e-9,
    )


def test_a_joint_that_turns_on_a_pin_stays_on_it() -> None:
    rig = tail_rig(2, 0.2)
    joints = list(rig.joints)
    joints[1] = replace(joints[1], type=JointType.PIN, axis=(0.0, 1.0, 0.0))
    take = take_of(replace(rig, joints=tuple(joints)), 24, 1.0)
    found, _ = simulated(take)
    turns = found.motion.rotations.dense()[:, 1]
    assert_allclose(turns[:, [0, 2]], 0, atol=1e-12)
    assert_allclose(so3.angle_between(turns, so3.IDENTITY), 0, atol=1e-6)


def test_one_frame() -> None:
    take = take_of(strands_rig(), 24, 0.0)
    assert take.clock.count == 1
    for options in ({}, {"loop": True}, {"lead": "extrapolate", "preroll": 1.0}):
        found, _ = simulated(take, **options)
        assert moved(found).shape == (1, 15, 3)


def test_motions_share_nothing() -> None:
    take = take_of(strands_rig(), 24, 0.2)
    before = take.motion.translations.dense().copy()
    made, _ = simulated(take)
    assert isinstance(made.motion, Motion)
    assert (take.motion.translations.dense() == before).all()
