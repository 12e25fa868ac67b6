"""Characters of a crowd: agents grouped by rig, and the poses they show."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.frames import Cast, CharactersFrame
from animtool.rig.kinematics import WorldTransforms, forward_kinematics
from animtool.rig.skeleton import Rig
from animtool.sim.colliders.on_joints import JointCapsules
from animtool.systems.crowds.agents import AgentMotion, Agents
from animtool.systems.crowds.bodies import AgentBodies
from animtool.systems.crowds.footing import BodyState
from animtool.systems.crowds.gaits import Gaits
from animtool.systems.crowds.ground import (
    GroundFrame,
    GroundSampler,
    Terrain,
    rotations_about_y,
    sample_ground,
)
from animtool.systems.crowds.poses import body_poses

# Sample rate of the idle clip, which moves slowly [1/s].
IDLE_RATE = 24.0
# Phases of a swing before and after which soles are close to the ground.
LIFT_PHASE, LANDING_PHASE = 0.08, 0.78


@dataclass(frozen=True)
class CastGroup:
    """Agents that share a rig, with their bodies and character."""

    agents: IntArray  # indices of agents (n,)
    bodies: AgentBodies
    cast: Cast


@dataclass(frozen=True)
class AgentCast:
    """The bodies and characters of N agents, grouped by rig."""

    groups: Sequence[CastGroup]
    order: IntArray  # agent order, rig by rig (N,)

    @staticmethod
    def from_sources(
        agents: Agents,
        sources: Sequence[Callable[[], Gaits]],
        ground: GroundSampler,
        *,
        can_fall: bool,
    ) -> AgentCast:
        """Return the bodies of agents, from the gaits of their populations."""
        distinct_sources = list(dict.fromkeys(sources))
        source_indices = [distinct_sources.index(source) for source in sources]
        sources_of_agents = np.array(source_indices)[agents.entry_indices]
        groups = []
        for k, source in enumerate(distinct_sources):
            agent_indices = np.flatnonzero(sources_of_agents == k)
            bodies = AgentBodies(source(), agents.sizes[agent_indices], ground)
            cast = _build_cast(bodies, can_fall=can_fall)
            groups.append(CastGroup(agent_indices, bodies, cast))
        order = np.concatenate([group.agents for group in groups])
        return AgentCast(groups, order)

    def initial_state(
        self, motion: AgentMotion, random_phases: FloatArray
    ) -> BodyState:
        """Return the initial bodies of all agents, with random phases ``(N,)``."""
        return self._in_agent_order(
            [
                group.bodies.initial_state(
                    motion.select(group.agents), random_phases[group.agents]
                )
                for group in self.groups
            ]
        )

    def advance(
        self,
        state: BodyState,
        before: AgentMotion,
        after: AgentMotion,
        dt: float,
        is_hit: BoolArray,
    ) -> BodyState:
        """Return the bodies of all agents after a step [s]."""
        return self._in_agent_order(
            [
                group.bodies.advance(
                    state.select(group.agents),
                    before.select(group.agents),
                    after.select(group.agents),
                    dt,
                    is_hit[group.agents],
                )
                for group in self.groups
            ]
        )

    def _in_agent_order(self, states: Sequence[BodyState]) -> BodyState:
        """Return the states of all groups in one record, in agent order."""
        return BodyState.concatenate(states).select(np.argsort(self.order))

    @property
    def rigs(self) -> list[Rig]:
        """The rig of each agent, in agent order."""
        rigs = [self.groups[0].cast.rig] * len(self.order)
        for group in self.groups:
            for i in group.agents.tolist():
                rigs[i] = group.cast.rig
        return rigs

    def joint_transforms(
        self,
        state: BodyState,
        motion: AgentMotion,
        ground_frame: GroundFrame,
        ground: GroundSampler,
        agent: int,
    ) -> WorldTransforms:
        """Return the world transforms of an agent's joints, as one frame."""
        group = next(group for group in self.groups if agent in group.agents)
        agent_indices, rig = np.array([agent]), group.cast.rig
        scales = group.bodies.scales[np.searchsorted(group.agents, agent_indices)]
        bodies = replace(group.bodies, scales=scales)
        poses = body_poses(
            bodies, state.select(agent_indices), motion.select(agent_indices)
        )
        positions = np.repeat(rig.rest_translations[None], 1, axis=0)
        positions[:, 0] = poses.roots
        world = forward_kinematics(rig, positions, poses.rotations)
        heading = rotations_about_y(motion.headings[agent_indices])
        rotation = so3.multiply(ground_frame.rotation, heading)
        heights, _ = sample_ground(ground, motion.points[agent_indices])
        origin = np.insert(motion.points[agent_indices], 1, heights, axis=1)
        matrix = so3.to_matrix(rotation)
        positions = so3.rotate(rotation, scales[:, None, None] * world.positions)
        positions = positions + ground_frame.to_world(origin)[:, None]
        return WorldTransforms(positions, matrix[:, None] @ world.linear)

    def frame(
        self,
        state: BodyState,
        motion: AgentMotion,
        heights: FloatArray,
        placement: tuple[GroundFrame, FloatArray],
        is_visible: BoolArray,
        primvars: Mapping[str, Any],
        fallen_poses: Mapping[int, tuple[FloatArray, FloatArray]],
    ) -> CharactersFrame:
        """Return the characters of all agents as a frame.

        ``heights`` are those of the ground below the agents ``(N,)`` [m]; ``placement``
        is the frame of the ground, and world velocities of agents ``(N, 3)`` [m/s].
        Visibility and primvars have a value for each agent. Local translations and
        rotations of fallen agents are by index; those of the root are in world space.
        """
        ground_frame, velocities = placement
        rotations, roots = [], []
        points = np.column_stack([motion.points[:, 0], heights, motion.points[:, 1]])
        for group in self.groups:
            bodies, agents = group.bodies, group.agents
            poses = body_poses(bodies, state.select(agents), motion.select(agents))
            for i, (positions, fallen_rotations) in fallen_poses.items():
                for row in np.flatnonzero(agents == i).tolist():
                    heading = rotations_about_y(motion.headings[i])
                    to_ground = so3.conjugate(
                        so3.multiply(ground_frame.rotation, heading)
                    )
                    root_rotation = so3.multiply(to_ground, fallen_rotations[0])
                    poses.rotations[row] = fallen_rotations
                    poses.rotations[row, 0] = root_rotation
                    offset = positions[0] - ground_frame.to_world(points[i])
                    root = so3.rotate(to_ground, offset)
                    poses.roots[row] = root / bodies.scales[row]
            rotations.append(poses.rotations[:, group.cast.animated])
            roots.append(poses.roots)
        order = self.order
        is_idle = (state.still >= 1) & ~motion.velocities.any(axis=1)
        is_idle &= (state.reacts < 0) & (state.shoulders == 0)
        is_idle[list(fallen_poses)] = False
        # Feet that are about to land or just lifted are also close to the ground.
        is_near_ground = (state.swings < LIFT_PHASE) | (state.swings > LANDING_PHASE)
        is_near_ground[list(fallen_poses)] = False
        is_planted = is_near_ground & (state.swings < 0)
        return CharactersFrame(
            order,
            ground_frame.to_world(points)[order],
            velocities[order],
            ground_frame.rotation,
            motion.headings[order],
            np.concatenate([group.bodies.scales for group in self.groups]),
            tuple(group.cast for group in self.groups),
            np.array([len(group.agents) for group in self.groups]),
            tuple(rotations),
            np.concatenate(roots),
            is_planted[order],
            is_near_ground[order],
            np.where(is_idle, state.clocks, np.nan)[order],
            is_visible[order],
            {name: values[order] for name, values in primvars.items()},
        )


def _build_cast(bodies: AgentBodies, *, can_fall: bool) -> Cast:
    """Return the character of a group, with the idle pose that agents share."""
    gaits = bodies.gaits
    period = 2 * gaits.idle.period if len(gaits.idle.rotations) > 1 else 0.0
    count = max(round(period * IDLE_RATE), 1)
    clocks: FloatArray = np.arange(count, dtype=np.float64) * (period / count)
    motion = AgentMotion(np.zeros((count, 2)), np.zeros((count, 2)), np.zeros(count))
    level_bodies = replace(bodies, scales=np.ones(count), ground=Terrain())
    standing_state = level_bodies.initial_state(motion, np.zeros(count))
    poses = body_poses(level_bodies, replace(standing_state, clocks=clocks), motion)
    animated_joints = bodies.animated_joints
    if can_fall:
        capsules = JointCapsules.from_rig(gaits.walker.rig)
        animated_joints = np.union1d(animated_joints, capsules.joints)
    left, right = (leg[3] if leg[3] >= 0 else leg[2] for leg in gaits.walker.legs)
    return Cast(
        gaits.walker.rig,
        animated_joints,
        (left, right),
        poses.rotations[:, animated_joints],
        poses.roots,
        period,
    )
