"""Figures of small irregular runs: bodies, joints and forces of each kind, rigs."""

from __future__ import annotations

from dataclasses import fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.figures import check_figures
from support.rigid import Rigid
from systems.rigid.test_physics import JOINTS as YARD_JOINTS
from systems.rigid.test_physics import YARD
from systems.rigid.test_ragdoll import GROUND, obstacle

from animtool.core.clock import Clock
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import PassContext
from animtool.motion.take import Take
from animtool.rig.kinematics import WorldTransforms, forward_kinematics
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.parts import Capsule, Collider
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.sim.colliders import Sphere
from animtool.sim.colliders.bodies import Wrenches
from animtool.systems.rigid.joints import Joints
from animtool.systems.rigid.locked import locked_joints
from animtool.systems.rigid.physics import (
    body_entries,
    stage_joints,
    static_colliders,
)
from animtool.systems.rigid.ragdoll import (
    RagdollOptions,
    build_ragdoll,
    build_ragdoll_joints,
)
from animtool.systems.rigid.ragdoll_motion import ragdoll_velocities
from animtool.systems.rigid.take_pass import apply_ragdoll
from animtool.systems.rigid.tone import passive_springs


def turned(*vector: float) -> list[float]:
    """Return a rotation vector [rad] as a quaternion w, x, y, z."""
    return [float(so3.exp(np.array(vector))[i]) for i in (3, 0, 1, 2)]


WEDGE = np.array(
    [[-0.2, -0.1, -0.15], [0.3, -0.1, -0.1], [0.1, 0.25, 0.0], [0.0, -0.1, 0.3]]
)
SIDES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
HAMMER = {
    "name": "hammer", "at": [0, 1.2, 0.1], "rotate": turned(0.3, 0.2, -0.4),
    "shapes": [
        {"shape": {"capsule": {"radius": 0.04, "length": 0.4}}, "density": 700},
        {"shape": {"box": {"size": [0.2, 0.08, 0.06]}}, "at": [0.01, 0.2, 0.02],
         "rotate": turned(0.2, 0, 0.8), "density": 2100},
    ],
    "velocity": [0.5, 0.3, 0.1], "spin": [100, 300, -80], "friction": 0.3,
    "restitution": 0.4,
}  # fmt: skip
BODIES: list[dict[str, Any]] = [
    HAMMER,
    {"name": "brick", "shape": {"box": {"size": [0.3, 0.15, 0.2]}}, "density": 300,
     "at": [-1, 0.3, 0.1], "rotate": turned(0, 0.5, 0),
     "grid": {"count": [2, 2, 1], "spacing": [0.31, 0.16, 0.05], "stagger": 0.4}},
    {"name": "lift", "shape": {"box": {"size": [0.6, 0.1, 0.5]}}, "kinematic": True,
     "at": [1.2, 0.5, 0], "moves": [[0, 0, 0, 0], [0.4, 0.2, 0.3, 0.1]],
     "release": 0.25},
    {"name": "cargo", "shape": {"sphere": {"radius": 0.12}}, "mass": 2.5,
     "inertia": [0.03, 0.02, 0.025], "inertia_axes": turned(0.1, 0.4, 0.2),
     "centre": [0.01, -0.03, 0.02], "at": [1.25, 0.7, 0.03], "friction": 0.7,
     "pushes": [{"force": [2, 0, 1], "at": [0, 0.1, 0.02], "torque": [0.1, 0, 0.2],
                 "start": 0.05, "end": 0.2},
                {"force": [0, 1, 3], "local": True, "torque": [0, 0.1, 0]}]},
    {"name": "post", "shape": {"box": {"size": [0.1, 1, 0.1]}}, "kinematic": True,
     "at": [0.6, 0.5, 0.9], "moves": [[0, 0, 0, 0], [0.5, -0.2, 0, -0.3]]},
    {"name": "wall", "shape": {"box": {"size": [0.1, 0.6, 2]}}, "kinematic": True,
     "at": [-1.6, 0.3, 0], "turns": [[0, 1, 0, 0, 0], [0.5, 0.97, 0, 0.24, 0]]},
    {"name": "wedge", "at": [-2, 0.6, 0.4], "rotate": turned(0.2, 0.9, 0.3),
     "spin": [30, 0, 200], "shape": {"mesh": {"points": WEDGE, "triangles": SIDES}}},
    {"name": "arm", "shape": {"box": {"size": [0.1, 0.5, 0.1]}}, "at": [3, 1.6, 0.2]},
    {"name": "bob", "shape": {"sphere": {"radius": 0.1}}, "at": [3, 1.0, 0.0],
     "mass": 0.7},
    {"name": "tray", "shape": {"box": {"size": [0.3, 0.1, 0.3]}}, "at": [4, 1, 0]},
    {"name": "flag", "shape": {"box": {"size": [0.3, 0.1, 0.2]}}, "at": [5, 1, 0.3],
     "spin": [0, 50, 20]},
    {"name": "wheel", "shape": {"capsule": {"radius": 0.1, "length": 0.1}},
     "at": [6, 1, 0]},
]  # fmt: skip
JOINTS: list[dict[str, Any]] = [
    {"name": "elbow", "type": "pin", "body": "bob", "to": "arm", "at": [3, 1.3, 0.1],
     "axis": [0, 1, 1], "limits": [-15, 20],
     "drive": {"stiffness": 9, "damping": 0.2, "target": 30, "most": 5}},
    {"name": "shoulder", "type": "ball", "body": "arm", "at": [3, 1.9, 0.2],
     "axis": [0, -1, 0.2], "swing": [20, 35], "twist": [-10, 15],
     "moves": [[0, 0, 0, 0], [0.3, 0.3, 0, 0.2]],
     "drive": {"stiffness": 20, "damping": 0.4, "rotation": turned(0.2, 0.3, 0.5)}},
    {"name": "rail", "type": "prismatic", "body": "tray", "at": [4, 1, 0],
     "axis": [1, 0.3, 1], "limits": [-0.2, 0.05],
     "drive": {"speed": 0.4, "most": 80}},
    {"name": "glue", "type": "fixed", "body": "flag", "at": [5.1, 1, 0.2],
     "breaks": {"force": 60, "torque": 3}, "rotate": turned(0, 0.3, 0.1)},
    {"name": "axle", "type": "pin", "body": "wheel", "axis": [0.1, 1, 0],
     "drive": {"speed": 200, "damping": 0.02}, "contacts": True},
]  # fmt: skip
WORLD: dict[str, Any] = {
    "step": 1 / 60, "substeps": 4,
    "forces": [{"gravity": {"acceleration": [0.4, -9, 0.3]}},
               {"drag": {"quadratic": 0.05, "linear": 0.1}},
               {"wind": {"velocity": [1.5, 0, -1], "drag": 0.2}}],
    "colliders": [
        {"shape": {"plane": {}}, "rotate": turned(0.05, 0, 0.03), "friction": 0.8},
        {"shape": {"box": {"size": [0.5, 0.4, 0.6]}}, "at": [0.2, 0.5, 0],
         "rotate": turned(0.2, 0.6, 0), "restitution": 0.2,
         "moves": [[0, 0, 0, 0], [0.5, -0.3, 0.1, 0.1]]},
        {"shape": {"sphere": {"radius": 0.3}}, "at": [-0.6, 0.1, 0.3]},
    ],
    "sleep": {"speed": 0.05, "time": 0.1},
}  # fmt: skip


def run(folder: Path, times: list[float], **keys: Any) -> dict[str, Any]:
    own = Rigid(folder, *BODIES, joints=JOINTS, **{**WORLD, **keys})
    frames = [own.run.at(t) for t in times]
    names = [one.name for one in fields(frames[0]) if one.name != "meshes"]
    seen = [
        {name: getattr(frame, name) for name in names if not name.startswith("proto")}
        for frame in frames
    ]
    simulation, state = own.simulation, own.state
    forces, motion = simulation._forces, state.motion
    x, v = motion[:, :3], motion[:, 7:10]
    pulls: list[Any] = [forces.potential(motion)]
    for t in (0.0, 0.04, 0.19, 0.3):
        pulls += [
            forces.step_wrenches(t, 1 / 60, motion),
            forces.push_wrenches(t, 1 / 60, motion),
            forces.oscillation_rates(t, 1 / 60, motion),
            forces.accelerations(t, x, v),
            forces.jacobians(t, x, v),
        ]
    return {
        "begun": simulation.initial_state(),
        "pulls": pulls,
        "seen": seen,
        "state": state,
        "energy": simulation.energy(state),
        "poses": simulation.poses(state, times[-1]),
        "codes": " ".join(own.codes()),
    }


def test_bodies_joints_and_forces_of_every_kind(tmp_path: Path) -> None:
    made = run(tmp_path, [0.0, 0.1, 0.2, 0.35, 0.6])
    check_figures(__file__, "yard", made)


@pytest.mark.parametrize("method", ["rk4", "symplectic_euler"])
def test_methods_of_turning(tmp_path: Path, method: str) -> None:
    made = run(tmp_path, [0.05], method=method, forces=[])
    check_figures(__file__, method, made)


def test_what_is_described_and_read_again(tmp_path: Path) -> None:
    keys = {key: value for key, value in YARD.items() if key not in ("name", "bodies")}
    joints = [dict(one) for one in YARD_JOINTS]
    joints[0]["breaks"] = {"force": 7, "torque": 3}
    joints.append(
        {"type": "pin", "body": "cargo", "to": "lift", "at": [4, 0.5, 0.1],
         "axis": [0, 1, 0.5], "limits": [-10, 40],
         "drive": {"speed": 30, "damping": 2, "most": 4}}
    )  # fmt: skip
    keys |= {"joints": joints, "prims": "xforms", "physics": True}
    wedge = next(one for one in BODIES if one["name"] == "wedge")
    own = Rigid(tmp_path, *YARD["bodies"], wedge, **keys).simulation
    physics = own._physics
    assert physics is not None
    check_figures(__file__, "described", physics)
    # What hangs on what only moves is turned round.
    last = physics.joints[-1]
    back = replace(last, bodies=last.bodies[::-1], frames=last.frames[::-1])
    physics = replace(physics, joints=[*physics.joints, back])
    models, parts = body_entries(physics, "bodies")
    read = Joints(stage_joints(physics, own.bodies, 0))
    still = static_colliders(physics)
    check_figures(
        __file__,
        "read",
        {
            "models": [one.model_dump() for one in models],
            "poses": [part["poses"].at(0.3) for part in parts],
            "rows": read.kinds_and_bodies,
            "numbers": read.parameters,
            "above": [one.parent_body for one in read.members],
            "pairs": np.array([one.excluded_pair for one in read.members]),
            "breaks": read.break_limits,
            "still": [(one.poses.at(0.0), one.friction) for one in still],
        },
    )


def test_pushes_of_others_are_felt_by_mass_and_inertia(tmp_path: Path) -> None:
    """What leads from a state to a pushed one is the push."""
    own = Rigid(tmp_path, *BODIES, joints=JOINTS, **WORLD)
    own.to(0.2)
    simulation, state = own.simulation, own.state
    count = len(state.motion)
    rng = np.random.default_rng(3)
    now = rng.normal(0, 0.3, (count, 6))
    moved = rng.normal(0, 1e-4, (count, 6))
    after = simulation.pushed(state, Wrenches(now, moved))
    back = simulation.push_to(state, after)
    np.testing.assert_allclose(back.impulses, now, atol=1e-9)
    # A turn of a hundredth is less than a millionth off what is added to it.
    np.testing.assert_allclose(back.time_weighted_impulses, moved, atol=1e-6)
    masses = simulation.bodies.masses[:, None]
    gained = masses * (after.motion[:, 7:10] - state.motion[:, 7:10])
    np.testing.assert_allclose(gained, now[:, :3], atol=1e-12)
    # 1/m and what the arm turns of the body, by the inertia in the world.
    owners = np.array([0, 2, 5])
    points = state.motion[owners, :3] + rng.normal(0, 0.2, (3, 3))
    ways = so3.rotate(so3.exp(rng.normal(size=(3, 3))), np.array([0.0, 0.0, 1.0]))
    centres, ease = simulation.inertias(state)
    arms = np.cross(points - centres[owners], ways)
    oscillation_rates = np.einsum("ki,kij,kj->k", arms, ease[owners], arms)
    found = simulation.inverse_masses(state, owners, points, ways)
    np.testing.assert_allclose(found, 1 / masses[owners, 0] + oscillation_rates)
    spins = np.einsum("kij,kj->ki", ease, state.motion[:, 10:13])
    speeds = simulation.body_velocities(state)
    np.testing.assert_allclose(speeds[:, 3:], spins, atol=1e-9)
    np.testing.assert_allclose(speeds[:, :3], state.motion[:, 7:10])


def limbs(up: UpAxis = UpAxis.Y) -> Rig:
    """Return a rig with joints of every kind, some of whose joints are no bodies."""
    ball, pin = JointType.BALL, JointType.PIN
    neck = BallLimit((0.4, 0.6), (-0.3, 0.2), (0.0, 0.6, 0.8))
    foot = BallLimit(None, (-0.1, 0.1), (1.0, 0.0, 0.0))
    bone = Capsule(0.05, 0.2, (0.2, 1.0, 0.0), (0.0, -0.15, 0.02))
    joints = (
        Joint("root", -1, JointType.FREE, translation=(0.0, 1.0, 0.0)),
        Joint("spine", 0, JointType.FIXED, translation=(0.0, 0.1, 0.02)),
        Joint("neck", 1, ball, translation=(0.0, 0.4, 0.0), limits=neck),
        Joint(
            "arm",
            1,
            pin,
            translation=(0.3, 0.2, 0.1),
            axis=(0.6, 0.0, 0.8),
            limits=RangeLimit(-0.1, 0.3),
        ),
        Joint("slide", 3, JointType.PRISMATIC, (0.0, -0.4, 0.0), axis=(0.0, 0.6, 0.8)),
        Joint("leg", 0, ball, translation=(-0.2, -0.3, 0.0), limits=foot),
        Joint("foot", 5, JointType.FIXED, translation=(0.0, -0.4, 0.1)),
        Joint("hook", 4, pin, translation=(0.0, -0.3, 0.1), axis=(-1.0, 0.0, 0.0)),
    )
    colliders = tuple(Collider(joints[k].name, bone) for k in (0, 2, 3, 4, 5, 7))
    return Rig("limbs", joints, colliders=colliders, up=up)


def moving(rig: Rig, frames: int) -> Take:
    places = np.repeat(rig.rest_translations[None], frames, axis=0)
    places[:, 0] += np.arange(frames)[:, None] * [0.02, 0.01, -0.015]
    turns = np.repeat(rig.rest_rotations[None], frames, axis=0)
    axes = {0: [0, 1, 0.3], 2: [1, 0.2, 0], 3: [0.6, 0, 0.8], 5: [0.3, 0.2, 1]}
    for j, axis in axes.items():
        angles = 0.03 * (j + 1) * np.sin(np.arange(frames) / (j + 2))
        turns[:, j] = so3.exp(angles[:, None] * np.array(axis, float))
    motion = Motion(Channel.from_dense(places), Channel.from_dense(turns))
    return Take(rig, Clock(Fraction(24), Fraction(1), Fraction(1), frames), motion)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("limp", {"start": 4.0, "tone": 0.0, "mass": 30.0, "gravity": 8.0}),
        ("tone", {"start": 3.0, "end": 11.0, "blend": 3.0, "tone": 2.0}),
        (
            "drawn",
            {"stiffness": 6.0, "damping": 0.2, "friction": 0.3, "density": 800.0},
        ),
    ],
)
def test_rigs_that_fall(name: str, options: dict[str, Any]) -> None:
    take = moving(limbs(UpAxis.Z if name == "drawn" else UpAxis.Y), 14)
    ball = obstacle(Sphere(0.4), 0.1, 0.1, 0.1, name="ball")
    context = PassContext(lambda _: take, Path())
    given = RagdollOptions(colliders=(GROUND, ball), step=0.01, **options)
    fallen = apply_ragdoll(take, given, context)
    made: Any = fallen.motion.dense()
    codes = " ".join(one.message for one in context.notices)
    check_figures(__file__, name, {"motion": list(made)[:2], "codes": codes})


def test_bodies_of_a_rig_and_their_speeds() -> None:
    take = moving(limbs(), 5)
    translations, rotations, scales = take.motion.dense()
    world = forward_kinematics(take.rig, translations, rotations, scales)
    pose = WorldTransforms(world.positions[2:3], world.linear[2:3])
    own = build_ragdoll(take.rig, pose, RagdollOptions())
    times = np.array([0.0, 0.1, 0.25, 0.3, 0.5])
    bodies = own.bodies
    joints = build_ragdoll_joints(
        own, RagdollOptions(tone=0.0), lambda _: np.zeros((0, 5))
    )
    check_figures(
        __file__,
        "bodies",
        {
            "above": own.parent_bodies,
            "frames": own.frames,
            "turns": own.axes,
            "rows": joints.kinds_and_bodies,
            "numbers": joints.parameters,
            "pairs": np.array([one.excluded_pair for one in joints.members]),
            "others": joints.other_pairs,
            "masses": bodies.masses,
            "moments": bodies.moments,
            "start": bodies.initial_states,
            "speeds": [ragdoll_velocities(own, world, times, k) for k in (0, 1, 3)],
        },
    )


def test_joints_that_keep_each_other_from_moving() -> None:
    """Two bodies in a loop of pins, some with axes that agree, and one on two more."""
    rows = np.array([[1, -1, 0], [1, 0, 1], [1, -1, 1], [1, -1, 2], [1, -1, 2]])
    frames = np.zeros((5, 7))
    frames[:, :3] = [[0, 0, 0], [1, 0, 0.1], [1, 1, 0], [5, 0, 0], [5, 1, 0]]
    turns = [[0, 0, 0], [0, 0, 0.0], [0, 0.3, 0], [0, 0, 0], [0, 0, 1.0]]
    frames[:, 3:] = so3.exp(np.array(turns))
    centres = np.array([[0.5, 0.1, 0], [1.1, 0.5, 0], [5, 0.5, 0.2]])
    found = locked_joints(rows, frames, centres)
    assert found
    assert any(one.blocking_joints for one in found)
    check_figures(__file__, "locked", found)


def test_tone_of_three_that_hang_on_each_other() -> None:
    """0.15 of the weight times its arm; damped at 0.35 of what would not swing."""
    masses = np.array([1.0, 2.0, 3.0])
    centres = np.array([[0.0, 0, 0], [1.0, 0, 0], [3.0, 0, 0]])
    pivots = np.array([[0.0, 0, 0], [0.5, 0, 0], [2.0, 0, 0]])
    before = masses.copy()
    found = passive_springs(np.array([-1, 0, 1]), masses, centres, pivots)
    arms = np.array([11 / 6, 11 / 5 - 0.5, 1.0])
    weights = np.array([6.0, 5.0, 3.0])
    stiffness = 0.15 * 9.81 * weights * arms
    np.testing.assert_allclose(found[:, 0], stiffness)
    damping = 0.7 * np.sqrt(stiffness * weights) * arms
    np.testing.assert_allclose(found[:, 1], damping)
    np.testing.assert_array_equal(masses, before)
