"""The pass that lets a rig fall: where it begins, what it keeps, what it refuses."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp
from support.faults import raises
from support.rigid import GRAVITY

from animtool.core.clock import Clock
from animtool.core.errors import FormatError, OptionError
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import PassContext
from animtool.motion.take import Take
from animtool.rig.joints import LocalTransforms, project_to_coordinates
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.limits import RangeLimit
from animtool.rig.parts import Capsule, Collider, Mass
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.scene.file.read import load_scene
from animtool.sim.colliders import Box, Plane, Poses, Shape
from animtool.sim.colliders import Capsule as Shaft
from animtool.sim.colliders import Collider as Obstacle
from animtool.systems.rigid.cores import core_of, core_solid
from animtool.systems.rigid.ragdoll import RagdollOptions, _rest_frames, build_ragdoll
from animtool.systems.rigid.shared import RigidState
from animtool.systems.rigid.simulation import RigidSimulation
from animtool.systems.rigid.take_pass import apply_ragdoll

LENGTH = 0.5
SIDES = {"left": -0.2, "right": 0.2}


def obstacle(shape: Shape, *at: float, **options: Any) -> Obstacle:
    return Obstacle(shape, Poses.fixed(at), friction=0.6, **options)


GROUND = obstacle(Plane(), 0.0, -2.0, 0.0)


def chain(links: int = 3, limits: Any = None) -> Rig:
    """Return a hip and links on pins that hang down from it, with a stiff end."""
    pin = {"type": JointType.PIN, "axis": (0.0, 0.0, 1.0), "limits": limits}
    joints = [Joint("hip", -1, translation=(0.0, 1.0, 0.0))]
    for k in range(links):
        joints.append(
            Joint(f"link {k}", k, translation=(0.0, -LENGTH * (k > 0), 0.0), **pin)
        )
    joints.append(Joint("end", links, JointType.FIXED, (0.0, -LENGTH, 0.0)))
    bone = Capsule(0.03, LENGTH - 0.1, (0.0, 1.0, 0.0), (0.0, -LENGTH / 2, 0.0))
    colliders = [Collider("hip", Capsule(0.1, 0.2))]
    colliders += [Collider(f"link {k}", bone) for k in range(links)]
    return Rig("chain", tuple(joints), colliders=tuple(colliders))


def still(rig: Rig, frames: int = 25, fps: int = 24, speed: float = 0.0) -> Take:
    """Return a take of a rig at rest that slides along x [m/s]."""
    places = np.repeat(rig.rest_translations[None], frames, axis=0)
    places[:, 0, 0] += speed * np.arange(frames) / fps
    turns = np.repeat(rig.rest_rotations[None], frames, axis=0)
    motion = Motion(Channel.from_dense(places), Channel.from_dense(turns))
    return Take(rig, Clock(Fraction(fps), Fraction(1), Fraction(1), frames), motion)


def fallen(take: Take, **options: Any) -> Take:
    context = PassContext(lambda _: take, Path())
    made = apply_ragdoll(
        take, RagdollOptions(**{"blend": 0.0, "tone": 0.0, **options}), context
    )
    return replace(made, notices=tuple(context.notices))


def hips(take: Take) -> np.ndarray:
    return take.motion.translations.dense()[:, 0]


def test_what_nothing_holds_falls_as_a_whole() -> None:
    take = fallen(still(chain(), speed=2.0), start=7.0)
    times = np.arange(25) / 24
    late = np.maximum(times - 6 / 24, 0)
    expected = [2 * times, 1 - GRAVITY / 2 * late**2, 0 * times]
    assert_allclose(hips(take), np.stack(expected, axis=1), atol=1e-3)
    turns = take.motion.rotations.dense()
    assert so3.angle_between(turns, chain().rest_rotations).max() < 1e-3
    assert [notice.code for notice in take.notices] == ["SIM128"]


@pytest.mark.parametrize(
    ("height", "count"), [(-2.0, 0), (-0.4, 0), (0.05, 1), (0.3, 1), (0.6, 2), (3, 4)]
)
def test_bodies_inside_a_collider_at_the_start(height: float, count: int) -> None:
    take = fallen(still(chain(), 3), colliders=[obstacle(Plane(), 0.0, height, 0.0)])
    said = [one for one in take.notices if one.code == "SIM126"]
    assert len(said) == bool(count)
    assert not said or said[0].message.startswith(f"{count} of 4 bodies")


def test_a_mass_in_grams() -> None:
    for mass, codes in ((9.0, ["SIM128"]), (90_000.0, ["SIM200", "SIM128"])):
        take = fallen(still(chain(), 3), mass=mass)
        assert [one.code for one in take.notices] == codes
        assert "e+" not in take.notices[-1].message


def test_a_fall_without_ground() -> None:
    """Past 2 m below the lowest joint, at -0.5 m or so, after a second."""
    for frames, options, codes in (
        (37, {}, ["SIM201", "SIM128"]),
        (13, {}, ["SIM128"]),
        (37, {"colliders": [GROUND]}, ["SIM128"]),
        (37, {"end": 30.0}, ["SIM128"]),
    ):
        take = fallen(still(chain(), frames), **options)
        assert [one.code for one in take.notices] == codes
        if "SIM201" in codes:
            low = hips(take)[-1, 1]
            assert f"to y = {low:.3g} m at frame 37" in take.notices[0].message


def test_before_it_begins_all_stays() -> None:
    before = still(chain(), speed=1.0)
    after = fallen(before, start=12.0)
    for name in ("translations", "rotations"):
        was, now = (getattr(t.motion, name).dense()[:12] for t in (before, after))
        assert_array_equal(was, now)


@pytest.mark.slow(0.5)
def test_it_comes_to_rest_on_the_ground_and_bones_keep_their_length() -> None:
    begun = still(chain(), 145)
    turns = begun.motion.rotations.dense()
    turns[:, 0] = so3.exp(np.array([0.0, 0.0, 0.4]))
    motion = replace(begun.motion, rotations=Channel.from_dense(turns))
    take = fallen(replace(begun, motion=motion), colliders=(GROUND,), mass=12.0)
    world = forward_kinematics(take.rig, *take.motion.dense()[:2])
    lengths = np.linalg.norm(np.diff(world.positions[:, 1:], axis=1), axis=2)
    assert_allclose(lengths, LENGTH, atol=1e-12)
    assert world.positions[-1, :, 1].max() < -1.5
    assert world.positions[..., 1].min() > -2.05
    assert np.abs(np.diff(world.positions[-10:], axis=0)).max() < 2e-3


@pytest.mark.parametrize("side", [-1, 1])
def test_limits_are_kept(side: int) -> None:
    limits = RangeLimit(-0.2, 0.3)
    take = still(chain(2, limits), 73)
    turns = take.motion.rotations.dense()
    lying = so3.exp(np.array([0.0, 0.0, side * math.pi / 2]))
    turns[:, 0] = lying
    take = replace(
        take, motion=replace(take.motion, rotations=Channel.from_dense(turns))
    )
    post = obstacle(Box((0.2, 1.0, 1.0)), 0.0, 0.35, 0.0)
    found = fallen(take, colliders=(post, GROUND))
    angles = project_to_coordinates(
        found.rig, LocalTransforms(*found.motion.dense()[:2])
    )[:, 7:]
    assert np.abs(angles).max() > 0.1
    assert angles.min() > -0.2 - math.radians(1)
    assert angles.max() < 0.3 + math.radians(1)


def test_the_rate_of_frames_changes_nothing() -> None:
    rig = chain()
    slow = fallen(still(rig, 25, 24), colliders=(GROUND,))
    fast = fallen(still(rig, 61, 60), colliders=(GROUND,))
    for name in ("translations", "rotations"):
        one, other = (getattr(t.motion, name).dense() for t in (slow, fast))
        assert_allclose(one[::2], other[::5], atol=1e-12)


@pytest.mark.slow
def test_a_stiff_one_keeps_the_pose_of_the_take() -> None:
    take = still(chain(), 49)
    wave = 0.4 * np.sin(np.arange(49) / 6)
    turns = take.motion.rotations.dense()
    turns[:, 2] = so3.exp(wave[:, None] * [0.0, 0, 1])
    take = replace(
        take, motion=replace(take.motion, rotations=Channel.from_dense(turns))
    )

    def off(**options: Any) -> float:
        found = fallen(take, gravity=0.0, start=5.0, **options)
        angle = so3.angle_between(found.motion.rotations.dense()[5:, 2], turns[5:, 2])
        return float(angle.max())

    assert off(stiffness=200.0, damping=5.0) < 0.15
    assert off() > 0.3


def test_it_blends_in_and_the_take_comes_back() -> None:
    before = still(chain(), 49)
    hard = fallen(before, start=5.0)
    soft = fallen(before, start=5.0, end=25.0, blend=8.0)
    heights = [hips(take)[:, 1] for take in (before, hard, soft)]
    assert_allclose(heights[2][12:24], heights[1][12:24], atol=1e-12)
    assert (heights[2][5:12] > heights[1][5:12]).all()
    assert_allclose(heights[2][32:], heights[0][32:], atol=1e-12)


def test_joints_below_the_last_body_go_on() -> None:
    take = still(chain(), 25)
    turns = take.motion.rotations.dense()
    turns[:, 4] = so3.exp(np.arange(25)[:, None] * [0.05, 0.0, 0.0])
    take = replace(
        take, motion=replace(take.motion, rotations=Channel.from_dense(turns))
    )
    found = fallen(take).motion.rotations.dense()
    assert_allclose(found[:, 4], turns[:, 4], atol=1e-15)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"start": 99.0}, "start is 99, but the take has frames 1 to 25"),
        ({"start": 25.0}, "start is 25, the last frame, so nothing falls"),
        ({"start": 3.5}, "start"),
        ({"start": 9.0, "end": 9.0}, "which is not after start"),
        ({"mass": 0.0}, "mass"),
        ({"density": -1.0}, "density"),
        ({"mass": 70.0, "density": 985.0}, "both a mass and a density"),
        ({"step": 0.0}, "step must be more than 0 and at most 1, not 0"),
        ({"substeps": 1001}, "substeps must be 1 or more and at most 1000, not 1001"),
    ],
)
def test_what_makes_no_sense_is_refused(options: dict[str, Any], words: str) -> None:
    with raises(OptionError, "SIM062", match=words):
        fallen(still(chain()), **options)


SCENE = """\
scene: animtool/1
source: {file: a.clip.yaml}
passes:
- ragdoll:
    colliders:
    - {shape: {plane: null}}
    - {%s}
"""


@pytest.mark.parametrize(
    ("keys", "code", "where"),
    [
        ("shape: {cone: null}", "SIM020", ".shape.cone"),
        ("shape: {box: {size: x}}", "SCN002", ".shape.box.size"),
        ("shape: {box: {size: [1, 0, 1]}}", "SIM020", ".shape"),
        ("shape: {plane: null}, rotate: [0, 0, 0, 0]", "SIM020", ""),
        ("shape: {plane: null}, friction: -1", "SIM020", ".friction"),
        ("shape: {plane: null}, frction: 1", "SCN002", ".frction"),
        ("at: [0, 0, 0]", "SCN002", ""),
        (
            "shape: {mesh: {points: a.npz, triangles: b.npz#t}}",
            "DOC015",
            ".shape.mesh.triangles",
        ),
    ],
)
def test_what_is_wrong_with_a_collider_is_told_at_its_place(
    tmp_path: Path, keys: str, code: str, where: str
) -> None:
    (tmp_path / "a.clip.yaml").touch()
    np.savez(tmp_path / "a.npz", points=np.zeros((3, 3)))
    (tmp_path / "a.scene.yaml").write_text(SCENE % keys, "utf-8")
    with pytest.raises(FormatError) as error:
        load_scene(tmp_path / "a.scene.yaml")
    (fault,) = error.value.faults
    assert fault.code == code
    assert fault.where == f"passes[0].ragdoll.colliders[1]{where}"
    assert ("unknown key 'frction'" in fault.message) is ("frction" in keys)


def test_meshes_of_files_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.clip.yaml").touch()
    points, triangles = [[0.0, 0, 0], [0, 0, 1], [1, 0, 0]], [[0, 1, 2]]
    np.savez(tmp_path / "a.npz", points=points, triangles=triangles, heights=np.eye(3))
    mesh = "shape: {mesh: {points: a.npz, triangles: a.npz}}}\n"
    field = "    - {shape: {height_field: {heights: a.npz, size: [1, 1]}}"
    (tmp_path / "a.scene.yaml").write_text(SCENE % (mesh + field), "utf-8")
    (entry,) = load_scene(tmp_path / "a.scene.yaml").passes
    _, read, heights = entry.options.colliders
    assert_array_equal(read.shape.points, points)
    assert len(heights.shape.triangles) == 8


def test_what_moves_does_so_by_the_time_of_the_take() -> None:
    """A lift that rises all the time has come half of its way where the fall begins."""
    rises = Poses([0.0, 1.0], [[0, -0.9, 0], [0, 0.1, 0]], [[0, 0, 0, 1]] * 2)
    lift = Obstacle(Plane(), rises)
    take = fallen(still(chain(1)), start=13.0, colliders=(lift,))
    world = forward_kinematics(take.rig, *take.motion.dense()[:2]).positions
    lows = world[:, :, 1].min(axis=1)
    assert_allclose(lows[12], 0.5, atol=1e-12)
    assert 0.05 < lows[-1] < 0.2


def hung() -> Rig:
    """Return two links on pins beside a heavy hip with feet on both sides."""
    rig = chain(2)
    joints = list(rig.joints)
    joints[1] = replace(joints[1], translation=(0.0, 0.0, 1.6))
    feet = [Capsule(0.5, 1.0, (1.0, 0.0, 0.0), (0.0, 0.0, z)) for z in (-0.6, 0.6)]
    colliders = [Collider("hip", foot) for foot in feet]
    return replace(
        rig, joints=tuple(joints), colliders=(*colliders, *rig.colliders[1:])
    )


SHELF = Obstacle(Box((4, 1, 2.2)), friction=1.0)


def test_bodies_weigh_what_the_rig_says() -> None:
    rig = chain(2)
    turn = tuple(so3.exp(np.array([0.0, 0.0, 0.5])).tolist())
    masses = (
        Mass("hip", 3.0),
        Mass("link 0", 2.0, (0.0, -0.1, 0.0), (0.2, 0.1, 0.2), turn),
        # Stiff with the last link, half a length below its joint.
        Mass("link 1", 1.0, (0.0, 0.0, 0.0), (0.3, 0.1, 0.3)),
        Mass("end", 1.0, (0.0, 0.0, 0.0), (0.2, 0.1, 0.2)),
    )
    world = forward_kinematics(
        rig, rig.rest_translations[None], rig.rest_rotations[None]
    )
    plain = build_ragdoll(rig, world, RagdollOptions()).bodies.kinds
    hip, first, last = build_ragdoll(
        replace(rig, masses=masses), world, RagdollOptions()
    ).bodies.kinds
    assert [hip.mass, first.mass, last.mass] == [3.0, 2.0, 2.0]
    assert_allclose(hip.moments / plain[0].moments, 3.0 / plain[0].mass)
    assert_allclose(first.centre, [0.0, -0.1, 0.0])
    matrix = so3.to_matrix(first.axes)
    own = so3.to_matrix(np.array(turn))
    assert_allclose(
        matrix @ np.diag(first.moments) @ matrix.T,
        own @ np.diag([0.2, 0.1, 0.2]) @ own.T,
        atol=1e-12,
    )
    assert_allclose(last.centre, [0.0, -LENGTH / 2, 0.0])
    # Steiner: two masses of 1 kg, a quarter of a metre to each side.
    assert_allclose(sorted(last.moments), [0.2, 0.625, 0.625])
    heavy = RagdollOptions(mass=14.0)
    kinds = build_ragdoll(replace(rig, masses=masses), world, heavy).bodies.kinds
    assert_allclose([kind.mass for kind in kinds], [6.0, 4.0, 4.0])


def test_limp_pins_fall_as_a_double_pendulum_of_the_same_masses() -> None:
    rig = hung()
    take = still(rig, 25)
    turns = take.motion.rotations.dense()
    turns[:, 1] = so3.exp(np.array([0.0, 0.0, math.pi / 2]))
    take = replace(
        take, motion=replace(take.motion, rotations=Channel.from_dense(turns))
    )
    found = fallen(take, colliders=(SHELF,), damping=0.0)
    angles = project_to_coordinates(rig, LocalTransforms(*found.motion.dense()[:2]))
    bone = Shaft(0.03, LENGTH - 0.1)
    solid = core_solid(bone, core_of(bone))
    mass, inertia = 1000 * solid.volume, 1000 * solid.inertia[2, 2]
    arm = LENGTH / 2

    def slopes(_: float, y: np.ndarray) -> np.ndarray:
        one, two, first, second = y
        tie = mass * LENGTH * arm
        mixed = tie * math.cos(one - two)
        upper = inertia + mass * (arm**2 + LENGTH**2)
        masses = np.array([[upper, mixed], [mixed, inertia + mass * arm**2]])
        twist = tie * math.sin(one - two)
        weight = mass * GRAVITY
        pull = [
            twist * second**2 + weight * (arm + LENGTH) * math.sin(one),
            -twist * first**2 + weight * arm * math.sin(two),
        ]
        return np.concatenate([y[2:], np.linalg.solve(masses, -np.array(pull))])

    begin, times = [math.pi / 2, math.pi / 2, 0.0, 0.0], np.arange(25) / 24
    exact = solve_ivp(slopes, (0, 1), begin, t_eval=times, rtol=1e-8, atol=1e-8).y[:2]
    swung = np.unwrap(np.cumsum(angles[:, 7:9], axis=1), axis=0)
    assert_allclose(swung, exact.T, atol=1e-3)


def test_energy_never_rises_in_a_limp_one() -> None:
    take = still(chain(2), 44, 60, speed=1.0)
    turns = take.motion.rotations.dense()
    turns[:, 0] = so3.exp(np.array([0.3, 0.0, 0.9]))
    take = replace(
        take, motion=replace(take.motion, rotations=Channel.from_dense(turns))
    )
    energies = []

    class Watched(RigidSimulation):
        def step(self, state: RigidState, t: float, dt: float) -> RigidState:
            energies.append(self.energy(state).total)
            return super().step(state, t, dt)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("animtool.systems.rigid.ragdoll_motion.RigidSimulation", Watched)
        fallen(take, colliders=(GROUND,))
    assert len(energies) > 130
    size = energies[0] - min(energies)
    assert size > 1
    assert np.diff(energies).max() < 1e-9 * size


def test_it_falls_the_same_way_every_time() -> None:
    take = still(chain(2), 13, speed=1.0)
    one, other = (fallen(take, colliders=(GROUND,), stiffness=3.0) for _ in range(2))
    for name in ("translations", "rotations"):
        was, now = (getattr(t.motion, name).dense() for t in (one, other))
        assert_array_equal(was, now)


def test_branches_below_a_joint_that_is_no_body_stay_together() -> None:
    pin = {"type": JointType.PIN, "axis": (0.0, 0.0, 1.0)}
    bone = Capsule(0.03, 0.4, (0.0, 1.0, 0.0), (0.0, -0.25, 0.0))
    joints = [Joint("root", -1), Joint("waist", 0, JointType.FIXED)]
    joints += [Joint(n, 1, translation=(x, 0, 0), **pin) for n, x in SIDES.items()]
    rig = Rig("fork", tuple(joints), colliders=tuple(Collider(n, bone) for n in SIDES))
    under_left = obstacle(Box((0.5, 1, 1)), -0.4, -1.1, 0.0)
    take = fallen(still(rig, 37), colliders=(under_left,))
    world = forward_kinematics(rig, *take.motion.dense()[:2]).positions
    assert world[-1, 2, 1] < -0.5
    assert_allclose(np.linalg.norm(world[:, 2] - world[:, 3], axis=1), 0.4, atol=1e-9)
    # Joints on the way from body to body only turn, the root alone travels.
    still_there = take.motion.translations.dense()[:, 1:] - rig.rest_translations[1:]
    assert_allclose(still_there, 0, atol=1e-12)


def test_the_largest_break_of_a_limit_is_told() -> None:
    take = still(chain(2, RangeLimit(0.1, 0.3)), 9)
    found = fallen(take)
    note, warning = found.notices
    assert (note.code, warning.code) == ("SIM128", "SIM129")
    assert "'link 0' exceeds its limits by 5.7°" in note.message


def test_a_collider_without_a_size_is_refused() -> None:
    flat = Collider("link 0", Capsule(0.0, 0.2))
    with raises(OptionError, "SIM062", match="'link 0'"):
        fallen(still(replace(chain(), colliders=(flat,))))


def test_a_rig_without_colliders_is_refused() -> None:
    with raises(OptionError, "SIM062"):
        fallen(still(replace(chain(), colliders=())))


@pytest.mark.parametrize("rooted", [True, False])
def test_a_slide_is_measured_from_where_it_is_at_rest(rooted: bool) -> None:
    """Of a root and of a child alike: its frame is not where it slid to.

    Others turn about where they are.
    """
    slide = Joint(
        "slide", -1 if rooted else 0, JointType.PRISMATIC, translation=(1.0, 2.0, 3.0)
    )
    joints = (slide,) if rooted else (Joint("base", -1, JointType.FREE), slide)
    rig = Rig("one", (*joints, Joint("ball", len(joints) - 1, JointType.BALL)))
    turn = so3.exp(np.array([0.0, np.pi / 2, 0.0]))
    positions = np.array([[5.0, 0, 0], [9, 9, 9], [7, 8, 6]])[-len(rig.joints) :]
    turns = np.tile(turn, (len(rig.joints), 1))
    which = np.arange(len(rig.joints))[-2:]
    frames, _ = _rest_frames(rig, positions, turns, which)
    expected = [1, 2, 3] if rooted else [5 + 3, 2, -1]
    assert_allclose(frames[0, :3], expected, atol=1e-12)
    assert_allclose(frames[1, :3], [7, 8, 6])


def test_what_falls_where_nothing_is_given() -> None:
    own = RagdollOptions()
    assert (own.start, own.end, own.blend) == (None, None, 4)
    assert (own.mass, own.density) == (None, 1000)
    assert (own.stiffness, own.damping, own.tone) == (0, 0.5, 1)
    assert (own.fingers, own.gravity, own.friction) == (True, 9.81, 0.6)
    assert (own.colliders, own.step, own.substeps) == ((), 0.005, 8)
