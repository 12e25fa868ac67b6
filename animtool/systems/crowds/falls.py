"""Falling agents, which become ragdolls when hit, and the limits of their joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.rows import Rows
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.limits import MIN_CONE, BallLimit, RangeLimit, swing_twist
from animtool.rig.placed import transform_rig
from animtool.rig.placement import Placement
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.sim.colliders import Collider, Colliders, Mesh, Plane, Poses
from animtool.systems.crowds.ground import GroundFrame, Terrain
from animtool.systems.framework.simulation import growing_field
from animtool.systems.rigid.ragdoll import (
    Ragdoll,
    RagdollOptions,
    build_ragdoll,
    build_ragdoll_joints,
)
from animtool.systems.rigid.ragdoll_motion import (
    ragdoll_simulation,
    ragdoll_transforms,
    ragdoll_velocities,
)
from animtool.systems.rigid.simulation import RigidSimulation

# Substep of falling bodies [s].
FALL_STEP = 0.0025
# Speed below which a body is at rest [m/s], and for how long it must be slower [s].
REST_SPEED, REST_TIME = 0.15, 0.3
# Largest speed of a falling body [m/s]; steps with faster ones are repeated in this
# many substeps.
MAX_FALL_SPEED, FAST_SUBSTEPS = 60.0, 8
GRAVITY = 9.81  # [m/s²]


@dataclass(frozen=True, slots=True)
class Falls(Rows):
    """Agents that have fallen, in the order of their falls."""

    agents: IntArray = field(metadata=growing_field())  # indices of the agents (K,)
    # World positions of joints when the fall began (K, J, 3) [m].
    positions: FloatArray = field(metadata=growing_field())
    # World rotations of joints when the fall began (K, J, 4).
    turns: FloatArray = field(metadata=growing_field())
    # States of the B bodies of each agent, as in `RigidState` (K, B, 14).
    motion: FloatArray = field(metadata=growing_field())
    # Time for which each agent has moved slowly (K,) [s].
    slow: FloatArray = field(metadata=growing_field())


_LocalPose = tuple[FloatArray, FloatArray]


class FallSimulator:
    """Simulates agents that fall as ragdolls, among colliders and on the ground.

    Args:
        rigs: Rig of each agent.
        sizes: Size of each body relative to its rig ``(N,)``.
        frame: Frame of the ground.
        ground: Terrain that the agents fall onto.
        colliders: Other colliders.
        step: Step of the crowd [s].
    """

    def __init__(
        self,
        rigs: Sequence[Rig],
        sizes: FloatArray,
        ground_frame: GroundFrame,
        ground: Terrain,
        colliders: Colliders,
        step: float,
    ) -> None:
        self._rigs, self._sizes = rigs, sizes
        self._up = ground_frame.vector_to_world(np.array([0.0, 1.0, 0.0]))
        shape: Plane | Mesh = Plane()
        if not ground.is_plane:
            upward_triangles = ground.triangles
            a, b, c = upward_triangles.swapaxes(0, 1)
            is_facing_down = np.cross(b - a, c - a)[:, 1] < 0
            is_flipped = is_facing_down[:, None, None]
            corners = np.where(
                is_flipped, upward_triangles[:, ::-1], upward_triangles
            ).reshape(-1, 3)
            faces = np.arange(len(corners)).reshape(-1, 3)
            shape = Mesh(corners, faces, closed=True)
        poses = Poses.fixed(ground_frame.origin, ground_frame.rotation)
        floor = Collider(shape, poses, name="ground", friction=0.8)
        self._colliders = Colliders([*colliders, floor], (), colliders.bodies)
        self._gravity = (-GRAVITY * self._up).tolist()
        self._step = step
        self._ragdolls: dict[tuple[int, bytes], tuple[Ragdoll, RigidSimulation]] = {}
        self._cached_poses: dict[int, tuple[tuple[bytes, ...], _LocalPose]] = {}

    def empty_falls(self) -> Falls:
        """Return a record without falls, for the rigs with most joints and bodies."""
        rigs = {id(rig): rig for rig in self._rigs}.values()
        joint_count = max(len(rig.joints) for rig in rigs)
        body_count = max(
            len({collider.joint for collider in rig.colliders}) for rig in rigs
        )
        return Falls(
            np.zeros(0, np.int64),
            np.zeros((0, joint_count, 3)),
            np.zeros((0, joint_count, 4)),
            np.zeros((0, body_count, 14)),
            np.zeros(0),
        )

    def add_falls(
        self,
        falls: Falls,
        agents: IntArray,
        poses: Sequence[WorldTransforms],
        next_poses: Sequence[WorldTransforms],
        dt: float,
    ) -> Falls:
        """Return the falls with agents added.

        ``next_poses`` are the poses of the agents after a step [s], to estimate
        velocities.
        """
        for agent, pose, next_pose in zip(
            agents.tolist(), poses, next_poses, strict=True
        ):
            rig = self._rigs[agent]
            positions = np.zeros((1, *falls.positions.shape[1:]))
            rotations = np.tile(so3.IDENTITY, (1, falls.turns.shape[1], 1))
            positions[0, : len(rig.joints)] = pose.positions[0]
            rotations[0, : len(rig.joints)] = pose.rotations[0]
            ragdoll, simulation = self._ragdoll(agent, positions[0], rotations[0])
            # Velocities of a pose pair belong to the later one.
            pair_positions = np.concatenate([next_pose.positions, pose.positions])
            pair_linear = np.concatenate([next_pose.linear, pose.linear])
            pose_pair = WorldTransforms(pair_positions, pair_linear)
            times = np.array([dt, 0.0])
            motion = simulation.initial_state().motion.copy()
            motion[:, 7:13] = ragdoll_velocities(ragdoll, pose_pair, times, 1)
            states = np.zeros((1, *falls.motion.shape[1:]))
            states[0, : len(motion)] = motion
            fall = Falls(np.array([agent]), positions, rotations, states, np.zeros(1))
            falls = Falls.concatenate([falls, fall])
        return falls

    def step(self, falls: Falls, t: float, dt: float) -> Falls:
        """Return the falls after a step [s]; bodies at rest are not simulated."""
        motion, slow = falls.motion.copy(), falls.slow.copy()
        for k, agent in enumerate(falls.agents.tolist()):
            if slow[k] >= REST_TIME:
                continue
            _, simulation = self._ragdoll(agent, falls.positions[k], falls.turns[k])
            count = len(simulation.bodies.dynamic_indices)
            next_motion = _step_ragdoll(simulation, motion[k, :count], t, dt)
            speeds = np.linalg.norm(next_motion[:, 7:10], axis=1)
            motion[k, :count] = next_motion
            slow[k] = slow[k] + dt if speeds.max() < REST_SPEED else 0.0
        return replace(falls, motion=motion, slow=slow)

    def poses(self, falls: Falls, row: int) -> _LocalPose:
        """Return local translations and rotations of a fallen agent, cached.

        Transforms of the first joint are in world space. The pose of agents at rest is
        reused.
        """
        agent = int(falls.agents[row])
        key = falls.positions[row].tobytes(), falls.motion[row].tobytes()
        if agent not in self._cached_poses or self._cached_poses[agent][0] != key:
            self._cached_poses[agent] = key, self._compute_pose(falls, row)
        return self._cached_poses[agent][1]

    def _compute_pose(self, falls: Falls, row: int) -> _LocalPose:
        """Compute the local translations and rotations of a fallen agent."""
        agent = int(falls.agents[row])
        ragdoll, simulation = self._ragdoll(
            agent, falls.positions[row], falls.turns[row]
        )
        rig, motion = ragdoll.rig, falls.motion[row, : len(ragdoll.joints)]
        state = replace(simulation.initial_state(), motion=np.ascontiguousarray(motion))
        frame = simulation.frame(state, 0.0)
        count = len(rig.joints)
        initial_rotations = _local_rotations(rig, falls.turns[row, :count])
        has_parent = rig.parents >= 0
        translations = rig.rest_translations.copy()
        translations[~has_parent] = falls.positions[row, :count][~has_parent]
        local_translations, local_rotations = ragdoll_transforms(
            ragdoll,
            frame.points[None],
            frame.rotations[None],
            translations[None],
            initial_rotations[None],
        )
        return local_translations[0], clamp_to_limits(rig, local_rotations[0])

    def _ragdoll(
        self, agent: int, positions: FloatArray, rotations: FloatArray
    ) -> tuple[Ragdoll, RigidSimulation]:
        """Return the ragdoll of an agent that fell from a world pose, cached.

        Its rig has the size of the agent, and limits widened to the pose.
        """
        key = agent, positions.tobytes()
        if key not in self._ragdolls:
            scale, identity = self._sizes[[agent]], so3.IDENTITY[None]
            placement = Placement(np.zeros((1, 3)), identity, scale)
            rig = transform_rig(self._rigs[agent], placement)
            count = len(rig.joints)
            rig = widen_limits(rig, _local_rotations(rig, rotations[:count]))
            matrices = so3.to_matrix(rotations[None, :count])
            pose = WorldTransforms(positions[None, :count], matrices)
            options = RagdollOptions(mass=None, damping=2.0, tone=0.0, fingers=False)
            ragdoll = build_ragdoll(rig, pose, options)
            joints = build_ragdoll_joints(ragdoll, options, lambda _: np.zeros((0, 5)))
            simulation = ragdoll_simulation(
                ragdoll,
                joints,
                self._colliders,
                self._gravity,
                "falls",
                step=self._step,
                substeps=max(1, round(self._step / FALL_STEP)),
                iterations=10,
            )
            self._ragdolls[key] = ragdoll, simulation
        return self._ragdolls[key]


def _step_ragdoll(
    simulation: RigidSimulation, body_states: FloatArray, t: float, dt: float
) -> FloatArray:
    """Return body states ``(B, 14)`` after a step [s]; fast bodies take substeps."""
    initial = simulation.initial_state()
    for substep_count in (1, FAST_SUBSTEPS):
        states, substep = body_states, dt / substep_count
        for i in range(substep_count):
            state = replace(initial, motion=np.ascontiguousarray(states))
            states = simulation.step(state, t + i * substep, substep).motion
            if not np.linalg.norm(states[:, 7:10], axis=1).max() < MAX_FALL_SPEED:
                break
        else:
            return states
    # Squeezed between immovable bodies: it continues from rest.
    states = body_states.copy()
    states[:, 7:13] = 0.0
    return states


def _local_rotations(rig: Rig, rotations: FloatArray) -> FloatArray:
    """Return local rotations ``(J, 4)`` from world rotations."""
    local_rotations: FloatArray = rotations.copy()
    has_parent = rig.parents >= 0
    to_parents = so3.conjugate(rotations[rig.parents[has_parent]])
    local_rotations[has_parent] = so3.multiply(to_parents, rotations[has_parent])
    return local_rotations


def widen_limits(rig: Rig, rotations: FloatArray) -> Rig:
    """Return a rig with limits widened to contain local rotations ``(J, 4)``.

    A walking pose may exceed the limits of its rig, and would snap back to them.
    """
    joints = zip(rig.joints, _rotations_from_rest(rig, rotations), strict=True)
    return replace(rig, joints=tuple(_widen_joint_limits(*args) for args in joints))


def clamp_to_limits(rig: Rig, rotations: FloatArray) -> FloatArray:
    """Return local rotations ``(J, 4)`` clamped to the limits of a rig.

    Squeezed bodies may have arbitrary joint rotations for some frames.
    """
    rest_rotations = _rotations_from_rest(rig, rotations)
    for j, joint in enumerate(rig.joints):
        if joint.type is JointType.PIN:
            angle = _pin_angle(joint, rest_rotations[j])
            if isinstance(joint.limits, RangeLimit):
                angle = float(joint.limits.clamped(np.array(angle)))
            rest_rotations[j] = so3.from_axis_angle(joint.axis, np.array(angle))
        elif joint.type is JointType.BALL and isinstance(joint.limits, BallLimit):
            rest_rotations[j] = joint.limits.clamped(rest_rotations[j][None])[0]
    return so3.multiply(rig.rest_rotations, rest_rotations)


def _rotations_from_rest(rig: Rig, rotations: FloatArray) -> FloatArray:
    """Return joint rotations relative to the rest pose ``(J, 4)``."""
    return so3.multiply(so3.conjugate(rig.rest_rotations), rotations)


def _pin_angle(joint: Joint, rotation: FloatArray) -> float:
    """Return the angle of a pin joint, unwrapped to the middle of its limits [rad]."""
    angle = 2 * float(np.arctan2(rotation[:3] @ np.array(joint.axis), rotation[3]))
    limits = joint.limits
    middle = (limits.low + limits.high) / 2 if isinstance(limits, RangeLimit) else 0.0
    return angle - 2 * np.pi * round((angle - middle) / (2 * np.pi))


def _widen_joint_limits(joint: Joint, rotation: FloatArray) -> Joint:
    """Return a joint with limits widened to a rotation from rest ``(4,)``."""
    limits = joint.limits
    if joint.type is JointType.PIN and isinstance(limits, RangeLimit):
        angle = _pin_angle(joint, rotation)
        widened_limits = RangeLimit(min(limits.low, angle), max(limits.high, angle))
        return replace(joint, limits=widened_limits)
    if joint.type is not JointType.BALL or not isinstance(limits, BallLimit):
        return joint
    swings, twists = swing_twist(rotation[None], limits.twist_axis)
    twist, swing = limits.twist, limits.swing
    if twist is not None:
        twist = min(twist[0], float(twists[0])), max(twist[1], float(twists[0]))
    if swing is not None:
        min_swing = np.maximum(swing, MIN_CONE)
        ratio = np.linalg.norm(so3.log(swings[0]) @ limits.axes[1:].T / min_swing)
        first, second = (min_swing * max(1.0, float(ratio))).tolist()
        swing = first, second
    return replace(joint, limits=replace(limits, swing=swing, twist=twist))
