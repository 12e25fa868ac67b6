"""Falling agents: rigs that become ragdolls when hit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.placed import placed_rig
from animtool.rig.placement import Placement
from animtool.rig.skeleton import Rig
from animtool.sim.colliders import Collider, Colliders, Mesh, Plane, Poses
from animtool.sim.colliders.on_joints import Capsules
from animtool.systems.crowds.ground import Frame, Terrain
from animtool.systems.crowds.limits import kept, open_to
from animtool.systems.framework.simulation import growing
from animtool.systems.rigid.ragdoll import (
    Ragdoll,
    RagdollOptions,
    bodies_of_rig,
    joints_of_rig,
)
from animtool.systems.rigid.ragdoll_motion import (
    ragdoll_simulation,
    ragdoll_speeds,
    ragdoll_transforms,
)
from animtool.systems.rigid.simulation import RigidSimulation

# Substep of falling bodies [s].
SMALL_STEP = 0.0025
# Slower than this for this long is at rest [m/s], [s].
REST_SPEED, REST_TIME = 0.15, 0.3
# Largest speed of a fall [m/s]; faster bodies divide the step into this many.
FASTEST, PARTS = 60.0, 8
GRAVITY = 9.81  # [m/s²]


@dataclass(frozen=True, slots=True)
class Falls:
    """K fallen agents, in the order of their falls.

    Attributes:
        agents: Which ``(K,)``.
        positions: Joints as each began to fall, in the world ``(K, J, 3)`` [m].
        turns: How they were turned ``(K, J, 4)``.
        motion: Of B bodies of each, as rigid bodies have it ``(K, B, 14)``.
        slow: For how long each has moved slowly ``(K,)`` [s].
    """

    agents: IntArray = field(metadata=growing())
    positions: FloatArray = field(metadata=growing())
    turns: FloatArray = field(metadata=growing())
    motion: FloatArray = field(metadata=growing())
    slow: FloatArray = field(metadata=growing())

    @staticmethod
    def none(joints: int, bodies: int) -> Falls:
        """Return an empty record, for rigs with up to so many joints and bodies."""
        return Falls(
            np.zeros(0, np.int64),
            np.zeros((0, joints, 3)),
            np.zeros((0, joints, 4)),
            np.zeros((0, bodies, 14)),
            np.zeros(0),
        )


_Pose = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class FallingRagdoll:
    """The ragdoll of a falling agent."""

    rig: Rig  # of the agent's size, with limits widened to its pose at the fall
    ragdoll: Ragdoll
    simulation: RigidSimulation


class FallSimulator:
    """Steps the ragdolls of falling agents, among colliders and on the ground.

    Args:
        rigs: Of each agent.
        sizes: Of the body of each, over its rig ``(N,)``.
        frame: Where the ground is.
        ground: That they fall onto.
        colliders: What else is there.
        step: Of the crowd [s].
    """

    def __init__(
        self,
        rigs: Sequence[Rig],
        sizes: FloatArray,
        frame: Frame,
        ground: Terrain,
        colliders: Colliders,
        step: float,
    ) -> None:
        self._rigs, self._sizes = rigs, sizes
        self._up = frame.turned(np.array([0.0, 1.0, 0.0]))
        shape: Plane | Mesh = Plane()
        if not ground.flat:
            facing_up = ground.triangles
            a, b, c = facing_up.swapaxes(0, 1)
            over = np.cross(b - a, c - a)[:, 1] < 0
            facing_up = np.where(over[:, None, None], facing_up[:, ::-1], facing_up)
            corners = facing_up.reshape(-1, 3)
            faces = np.arange(len(corners)).reshape(-1, 3)
            shape = Mesh(corners, faces, closed=True)
        poses = Poses.fixed(frame.origin, frame.rotation)
        floor = Collider(shape, poses, name="ground", friction=0.8)
        self._colliders = Colliders([*colliders, floor], (), colliders.bodies)
        self._gravity = (-GRAVITY * self._up).tolist()
        self._step = step
        self._known: dict[tuple[int, bytes], FallingRagdoll] = {}
        self._posed: dict[int, tuple[tuple[bytes, ...], _Pose]] = {}

    @staticmethod
    def possible(rig: Rig) -> bool:
        """Return whether a rig has bodies for a ragdoll."""
        return bool(len(Capsules.of(rig)))

    def none(self) -> Falls:
        """Return an empty record of falls."""
        rigs = {id(rig): rig for rig in self._rigs}.values()
        joints = max(len(rig.joints) for rig in rigs)
        return Falls.none(
            joints, max(len(np.unique(Capsules.of(rig).joints)) for rig in rigs)
        )

    def begun(
        self,
        falls: Falls,
        agents: IntArray,
        now: Sequence[WorldTransforms],
        soon: Sequence[WorldTransforms],
        dt: float,
    ) -> Falls:
        """Return falls with more agents; ``soon`` is their pose after a step [s]."""
        for agent, first, last in zip(agents.tolist(), now, soon, strict=True):
            rig = self._rigs[agent]
            positions = np.zeros((1, *falls.positions.shape[1:]))
            rotations = np.tile(so3.IDENTITY, (1, falls.turns.shape[1], 1))
            positions[0, : len(rig.joints)] = first.positions[0]
            rotations[0, : len(rig.joints)] = first.rotations[0]
            falling = self._falling(agent, positions[0], rotations[0])
            # Velocities of a pose pair belong to the later one.
            pair = WorldTransforms(
                np.concatenate([last.positions, first.positions]),
                np.concatenate([last.linear, first.linear]),
            )
            motion = falling.simulation.initial().motion.copy()
            motion[:, 7:13] = ragdoll_speeds(
                falling.ragdoll, pair, np.array([dt, 0.0]), 1
            )
            padded = np.zeros((1, *falls.motion.shape[1:]))
            padded[0, : len(motion)] = motion
            falls = Falls(
                np.append(falls.agents, agent),
                np.concatenate([falls.positions, positions]),
                np.concatenate([falls.turns, rotations]),
                np.concatenate([falls.motion, padded]),
                np.append(falls.slow, 0.0),
            )
        return falls

    def step(self, falls: Falls, t: float, dt: float) -> Falls:
        """Return falls after a step [s]; resting bodies stay."""
        motion, slow = falls.motion.copy(), falls.slow.copy()
        for k, agent in enumerate(falls.agents.tolist()):
            if slow[k] >= REST_TIME:
                continue
            falling = self._falling(agent, falls.positions[k], falls.turns[k])
            count = len(falling.simulation.initial().motion)
            moved = _moved(falling.simulation, motion[k, :count], t, dt)
            speeds = np.linalg.norm(moved[:, 7:10], axis=1)
            motion[k, :count] = moved
            slow[k] = slow[k] + dt if speeds.max() < REST_SPEED else 0.0
        return replace(falls, motion=motion, slow=slow)

    def poses(self, falls: Falls, k: int) -> _Pose:
        """Return a fallen agent's local translations and rotations (cached).

        Those of the first joint are in the world. Who rests has the pose before.
        """
        agent = int(falls.agents[k])
        key = falls.positions[k].tobytes(), falls.motion[k].tobytes()
        if agent not in self._posed or self._posed[agent][0] != key:
            self._posed[agent] = key, self._pose(falls, k)
        return self._posed[agent][1]

    def _pose(self, falls: Falls, k: int) -> _Pose:
        """Compute `poses` from the ragdoll."""
        agent = int(falls.agents[k])
        falling = self._falling(agent, falls.positions[k], falls.turns[k])
        rig, bodies = falling.rig, falling.ragdoll.bodies
        frame = falling.simulation.frame(
            replace(
                falling.simulation.initial(),
                motion=np.ascontiguousarray(falls.motion[k, : len(bodies.of)]),
            ),
            0.0,
        )
        count = len(rig.joints)
        local = _local(rig, falls.turns[k, :count])
        below = rig.parents >= 0
        translations = rig.rest_translations.copy()
        translations[~below] = falls.positions[k, :count][~below]
        moved, turned = ragdoll_transforms(
            falling.ragdoll,
            frame.points[None],
            frame.rotations[None],
            translations[None],
            local[None],
        )
        return moved[0], kept(rig, turned[0])

    def _falling(
        self, agent: int, positions: FloatArray, rotations: FloatArray
    ) -> FallingRagdoll:
        """Return the ragdoll of a fallen agent in a pose."""
        key = agent, positions.tobytes()
        if key not in self._known:
            size = Placement(np.zeros((1, 3)), so3.IDENTITY[None], self._sizes[[agent]])
            rig = placed_rig(self._rigs[agent], size)
            count = len(rig.joints)
            rig = open_to(rig, _local(rig, rotations[:count]))
            pose = WorldTransforms(
                positions[None, :count], so3.to_matrix(rotations[None, :count])
            )
            options = RagdollOptions(mass=None, damping=2.0, tone=0.0, fingers=False)
            ragdoll = bodies_of_rig(rig, pose, options)
            joints = joints_of_rig(ragdoll, options, lambda _: np.zeros((0, 5)))
            simulation = ragdoll_simulation(
                ragdoll,
                joints,
                self._colliders,
                self._gravity,
                "falls",
                step=self._step,
                substeps=max(1, round(self._step / SMALL_STEP)),
                iterations=10,
            )
            self._known[key] = FallingRagdoll(rig, ragdoll, simulation)
        return self._known[key]


def _moved(
    simulation: RigidSimulation, motion: FloatArray, t: float, dt: float
) -> FloatArray:
    """Return body states ``(B, 14)`` after a step [s], in substeps if needed."""
    begun = simulation.initial()
    for parts in (1, PARTS):
        moved, each = motion, dt / parts
        for part in range(parts):
            state = replace(begun, motion=np.ascontiguousarray(moved))
            moved = simulation.step(state, t + part * each, each).motion
            if not np.linalg.norm(moved[:, 7:10], axis=1).max() < FASTEST:
                break
        else:
            return moved
    # Squeezed between immovable bodies: it continues from rest.
    moved = motion.copy()
    moved[:, 7:13] = 0.0
    return moved


def _local(rig: Rig, rotations: FloatArray) -> FloatArray:
    """Return local rotations ``(J, 4)`` from world rotations."""
    local: FloatArray = rotations.copy()
    below = rig.parents >= 0
    above = rotations[rig.parents[below]]
    local[below] = so3.multiply(so3.conjugate(above), rotations[below])
    return local


def resting(falls: Falls) -> BoolArray:
    """Return which falls have come to rest ``(K,)``."""
    return np.asarray(falls.slow >= REST_TIME)
