"""Hard cases of the pass that moves what a rig attaches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction

import numpy as np
from adapters.hard.subsystem import Subsystem
from numpy.testing import assert_allclose
from support.attached import (
    moved,
    sheet_rig,
    simulated,
    strands_rig,
    tail_rig,
    take_of,
)

from animtool.motion.motion import Channel
from animtool.motion.take import Take
from animtool.rig.parts import Capsule, Collider, LoadedArray, Shape
from animtool.rig.skeleton import Joint, Pose, Rig
from animtool.systems.attach.colliders import DEPENETRATION_SPEED

__all__ = ["ATTACHED"]

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


def speeds(take: Take, fps: int = 24) -> np.ndarray:
    """Return how fast points are from frame to frame ``(F - 1, N)`` [m/s]."""
    return np.linalg.norm(np.diff(moved(take), axis=0), axis=-1) * fps


def _coincident_particles(way: str) -> None:  # noqa: ARG001 - there is one
    rig = tail_rig(3, 0.2)
    joints = list(rig.joints)
    joints[2] = replace(joints[2], translation=(0.0, 0.0, 0.0))
    found, _ = simulated(take_of(replace(rig, joints=tuple(joints)), 24, 1.0))
    assert np.isfinite(found.motion.rotations.dense()).all()
    assert_allclose(moved(found)[:, 1], moved(found)[:, 0], atol=1e-12)


def _all_coincident(way: str) -> None:  # noqa: ARG001 - there is one
    flat = sheet_rig()
    at_one = replace(flat.meshes[0], points=LoadedArray(np.zeros((16, 3))))
    # Either at bind, or by a shape in the first pose alone.
    falls = LoadedArray(-flat.meshes[0].points.load())
    shape = Shape("gone", "flag", falls)
    whole = Channel.from_dense(np.ones((13, 1, 1)))
    for rig, weights in (
        (replace(flat, meshes=(at_one,)), None),
        (replace(flat, shapes=(shape,)), whole),
    ):
        take = take_of(rig, 24, 0.5)
        take = replace(take, motion=replace(take.motion, weights=weights))
        found = [simulated(take) for _ in range(2)]
        one, other = (moved(made) for made, _ in found)
        assert np.isfinite(one).all()
        assert (one == other).all()
        assert "SIM140" in found[0][1]


def _both_ends_pinned(way: str) -> None:  # noqa: ARG001 - there is one
    take = take_of(sheet_rig(pins=tuple(range(16))), 24, 0.5)
    found, codes = simulated(take)
    flat, _ = simulated(take, weight=((1, 1), (2, 0)))
    assert codes == ["SIM130"]
    assert_allclose(moved(found), np.broadcast_to(moved(flat)[-1], (13, 16, 3)))


def _dt_spike(way: str) -> None:  # noqa: ARG001 - there is one
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


def _collider_teleport() -> None:
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


def _pin_teleport() -> None:
    def jump(t: np.ndarray) -> np.ndarray:
        return np.where(t[:, None] < 0.5, 0.0, [[100.0, 0.0, 0.0]])

    found, codes = simulated(take_of(strands_rig(), 24, 1.0, jump), settle=1.0)
    assert codes == ["SIM130"]
    own = moved(found) - found.world().positions[:, :1]
    assert_allclose(own, np.broadcast_to(own[0], own.shape), atol=1e-3)


def _teleports(way: str) -> None:  # noqa: ARG001 - there is one
    _collider_teleport()
    _pin_teleport()


def _rest_contact(way: str) -> None:  # noqa: ARG001 - there is one
    """A tail that lies over a wide capsule stays there, without a tremble."""
    for friction in (0.2, 0.6):
        rig = tail_rig(3, 0.3)
        log = Collider("body", Capsule(0.3, 4.0, (0.0, 0.0, 1.0), (0.35, -0.55, 0.0)))
        take = take_of(replace(rig, colliders=(log,)), 4, 60.0)
        found, codes = simulated(take, frequency=0.0, friction=friction, settle=4.0)
        assert codes == ["SIM130"]
        assert speeds(found, 4).max() < 1e-6
        apart = np.linalg.norm(moved(found)[:, 1:, :2] - [0.35, -0.55], axis=2)
        assert (apart > 0.3 + 0.005 - 1e-3).all()
        assert np.ptp(apart, axis=0).max() < 1e-6


def _deep_start_penetration(way: str) -> None:  # noqa: ARG001 - there is one
    """A tail whose end begins half a metre inside a ball leaves it slowly."""
    rig = with_walls(tail_rig(3, 0.4), ("ball", (0.0, 0.0, 0.0)))
    rig = replace(rig, colliders=(Collider("ball", Capsule(0.7, 0.0)),))
    middle = np.array([1.2, -0.2, 0.0])
    take = going(rig, 2.0, ball=lambda t: np.tile(middle, (len(t), 1)))
    # At bind, too, it would be let be.
    bind = {"ball": Pose((50.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))}
    take = replace(take, rig=replace(take.rig, bind=bind))
    for more in ({}, {"gravity": 0.0, "frequency": 0.0}):
        found, codes = simulated(take, settle=0.0, **more)
        world, last = found.world(), rig.index("tail_3")
        end = world.positions[:, last] + world.linear[:, last] @ [0.4, 0, 0]
        outside = np.linalg.norm(end - middle, axis=1) - 0.7
        assert outside[0] < -0.499
        speed = np.diff(outside[outside < 0]) * 24
        # At first the bones that are pushed pull the others along.
        assert speed.max() < 2 * DEPENETRATION_SPEED
        assert speed[-3:].max() <= DEPENETRATION_SPEED * 1.05
        assert "SIM132" in codes


def _pinched(way: str) -> None:  # noqa: ARG001 - there is one
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


ATTACHED = Subsystem(
    "what rigs attach",
    ["simulate"],
    {
        "coincident_particles": _coincident_particles,
        "all_coincident": _all_coincident,
        "zero_rest_length": _coincident_particles,
        "both_ends_pinned": _both_ends_pinned,
        "dt_spike": _dt_spike,
        "collider_teleport": _teleports,
        "rest_contact": _rest_contact,
        "deep_start_penetration": _deep_start_penetration,
        "pinched": _pinched,
    },
    {
        "zero_mass_unpinned": "masses follow from areas, and nobody gives them",
        "dt_zero": "frames of a take are one step apart, which is above 0",
        "dt_negative": "frames of a take ascend",
        "stiff_and_heavy": "springs do not give, and particles of a body weigh alike",
    },
)
