"""Crowd simulation: agents stepped over time, shown as points or meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, ToleranceError
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.frames import (
    CharactersFrame,
    MeshFrame,
    PointsFrame,
    TransformsFrame,
)
from animtool.systems.crowds.agents import OVERLAP_TOLERANCE, AgentMotion, Agents
from animtool.systems.crowds.ground import (
    GroundFrame,
    Terrain,
    rotations_about_y,
    sample_ground,
    wrap_angles,
)
from animtool.systems.crowds.obstacles import Obstacles, Walls
from animtool.systems.crowds.shoulders import (
    DEPTH_RATIO,
    shoulder_vectors,
    step_shoulders,
)
from animtool.systems.crowds.spec import CrowdsModel
from animtool.systems.crowds.steering import DEPARTED_STAGE, Progress, Steering
from animtool.systems.framework.simulation import Diagnostics

if TYPE_CHECKING:
    from animtool.rig.kinematics import WorldTransforms
    from animtool.systems.crowds.cast import AgentCast
    from animtool.systems.crowds.falls import Falls, FallSimulator
    from animtool.systems.crowds.footing import BodyState

# Passes that separate overlapping agents in a step.
SEPARATION_PASSES = 100
# Modes of agents, in the encoding of the kernel.
WALKING, STAYING, LEFT_SCENE = np.uint8(0), np.uint8(1), np.uint8(2)
# Weight of the preferred velocity in the direction that agents face [1].
FACING_PREFERRED = 0.5
# Preference for passing on the left of oncoming agents.
SIDE_PREFERENCES = {"right": -0.2, "left": 0.2, "none": 0.0}
# Below this fraction of the preferred speed, agents yaw proportionally slower.
SLOW_YAW_SPEED = 0.6
# Time constant of yaw towards motion [s].
YAW_TIME = 0.25
# Largest yaw rate [rad/s]: a U-turn takes almost a second.
MAX_YAW_RATE = 4.0


@dataclass(frozen=True, slots=True)
class CrowdState:
    """State of N agents on the ground."""

    points: FloatArray  # (x, z) positions (N, 2) [m]
    velocities: FloatArray  # along x and z (N, 2) [m/s]
    headings: FloatArray  # angles about up; 0 is along z (N,) [rad]
    progress: Progress
    overlap: float  # largest overlap of two agents so far [m]
    bodies: BodyState | None  # body states; None if agents have no bodies
    falls: Falls | None  # falls so far; None if no agent can fall


@dataclass(frozen=True, eq=False)
class Crowd:
    """Simulates the agents of a crowd.

    Attributes:
        checked: Whether steps raise if a number is not finite.
    """

    checked = True

    spec: CrowdsModel
    begin: float  # start time [s]
    ground_frame: GroundFrame
    ground: Terrain
    agents: Agents
    steering: Steering
    obstacles: Obstacles
    start_points: FloatArray  # (x, z) at the start (N, 2) [m]
    notices: Sequence[Fault]
    cast: AgentCast | None  # bodies of the agents; None if they are points or meshes
    # Ragdolls of falling agents; None if nobody can fall.
    fall_simulator: FallSimulator | None
    meshes: tuple[MeshFrame, ...]  # distinct meshes by which populations are displayed
    mesh_of_population: IntArray  # index of the mesh of each population

    @cached_property
    def _relaxation_times(self) -> FloatArray:
        """Relaxation time of each agent to its preferred velocity ``(N,)`` [s]."""
        return self.agents.repeat_per_individual(
            [population.acceleration for population in self.agents.entries]
        )

    def initial_state(self) -> CrowdState:
        """Return the initial state, with headings along the preferred velocities."""
        x, progress = self.start_points, self.steering.initial_state()
        zero_velocities = np.zeros_like(x)
        preferred_velocities = self.steering.preferred_velocities(
            np.inf, self.begin, progress, x
        )
        headings = np.arctan2(preferred_velocities[:, 0], preferred_velocities[:, 1])
        bodies = None
        if self.cast is not None:
            motion = AgentMotion(x, zero_velocities, headings)
            bodies = self.cast.initial_state(motion, self.agents.clip_phases)
        falls = (
            None if self.fall_simulator is None else self.fall_simulator.empty_falls()
        )
        return CrowdState(x, zero_velocities, headings, progress, 0.0, bodies, falls)

    def step(self, state: CrowdState, t: float, dt: float) -> CrowdState:
        """Return the state after a step [s]."""
        agents, avoidance = self.agents, self.spec.avoidance
        if not len(agents):
            return state
        x, v = state.points, state.velocities
        preferred_velocities = self.steering.preferred_velocities(
            t, self.begin, state.progress, x
        )
        relaxation_fractions = -np.expm1(-dt / self._relaxation_times)[:, None]
        relaxed_velocities = v + (preferred_velocities - v) * relaxation_fractions
        walls = self.obstacles.walls(t, dt, x)
        has_fallen = np.zeros(len(x), np.bool_)
        if state.falls is not None:
            has_fallen[state.falls.agents] = True
        modes = np.where(has_fallen, STAYING, WALKING)
        modes[state.progress.stages == DEPARTED_STAGE] = LEFT_SCENE
        _check_finite(t, x, v, relaxed_velocities, walls.half_planes)
        shoulders = self._shoulder_yaws(state, has_fallen)
        points, velocities, overlap, shoulder_targets = _kernels.crowd_step(
            points=x, velocities=v, preferred=relaxed_velocities,
            radii=agents.radii, max_speeds=agents.max_speeds,
            yielding=agents.yield_weights, depth=DEPTH_RATIO,
            shoulders=shoulder_vectors(state.headings, shoulders),
            groups=agents.groups, modes=modes, starts=walls.first_walls,
            walls=walls.half_planes, sight=avoidance.sight, nearest=avoidance.nearest,
            horizon=avoidance.horizon, space=avoidance.space, push=avoidance.push,
            headway=avoidance.headway, side=SIDE_PREFERENCES[avoidance.side], step=dt,
            max_passes=SEPARATION_PASSES,
            tolerance=OVERLAP_TOLERANCE * float(agents.radii.min()),
        )  # fmt: skip
        progress = self.steering.advance(state.progress, points, dt)
        headings = self._rotate_headings(
            state.headings, preferred_velocities, velocities, dt
        )
        bodies, falls = state.bodies, state.falls
        if self.cast is not None and bodies is not None:
            before, after = (
                agent_motion(state),
                AgentMotion(points, velocities, headings),
            )
            impact_speeds = self._impact_speeds(walls, dt)
            is_hit = impact_speeds > self.spec.impact.stagger
            bodies = self.cast.advance(bodies, before, after, dt, is_hit)
            shoulder_targets = np.where(is_hit, 0.0, shoulder_targets)
            shoulders = step_shoulders(shoulders, shoulder_targets, dt)
            bodies = replace(bodies, shoulders=shoulders)
            if self.fall_simulator is not None and falls is not None:
                is_falling = (impact_speeds > self.spec.impact.fall) & ~has_fallen
                falling_agents = np.flatnonzero(is_falling)
                if len(falling_agents):
                    falls = self._add_falls(state, falls, falling_agents, dt)
                falls = self.fall_simulator.step(falls, t, dt)
        _check_finite(t + dt, points, headings)
        overlap = max(state.overlap, overlap)
        return CrowdState(
            points, velocities, headings, progress, overlap, bodies, falls
        )

    def _add_falls(
        self, state: CrowdState, falls: Falls, falling_agents: IntArray, dt: float
    ) -> Falls:
        """Return the falls with agents ``(K,)`` added, which fall from a step's start.

        The bodies start with walking velocities, and are moved by colliders.
        """
        assert self.cast is not None
        assert self.fall_simulator is not None
        assert state.bodies is not None
        motion, v = agent_motion(state), state.velocities
        next_motion = AgentMotion(motion.points + v * dt, v, motion.headings)
        no_hits = np.zeros(len(v), np.bool_)
        next_bodies = self.cast.advance(state.bodies, motion, next_motion, dt, no_hits)
        indices = falling_agents.tolist()
        poses = [self._world(state.bodies, motion, i) for i in indices]
        next_poses = [self._world(next_bodies, next_motion, i) for i in indices]
        return self.fall_simulator.add_falls(
            falls, falling_agents, poses, next_poses, dt
        )

    def _shoulder_yaws(self, state: CrowdState, has_fallen: BoolArray) -> FloatArray:
        """Return the shoulder yaws of agents ``(N,)`` [rad].

        Agents shown as points or meshes have yaw 0; fallen agents keep their space.
        """
        if state.bodies is None:
            return np.zeros(len(self.agents))
        return np.where(has_fallen, 0.0, state.bodies.shoulders)

    def _impact_speeds(self, walls: Walls, dt: float) -> FloatArray:
        """Return the largest speed of an impact on each agent ``(N,)`` [m/s]."""
        speeds = np.zeros(len(self.agents))
        is_touching = walls.gaps < np.maximum(walls.closing_speeds, 0.0) * dt
        agents = walls.agents_of_walls[is_touching]
        np.maximum.at(speeds, agents, walls.closing_speeds[is_touching])
        return speeds

    def _world(self, bodies: BodyState, motion: AgentMotion, i: int) -> WorldTransforms:
        """Return the world transforms of an agent's joints."""
        assert self.cast is not None
        return self.cast.joint_transforms(
            bodies, motion, self.ground_frame, self.ground, i
        )

    def _rotate_headings(
        self,
        headings: FloatArray,
        preferred_velocities: FloatArray,
        v: FloatArray,
        dt: float,
    ) -> FloatArray:
        """Return headings ``(N,)`` [rad], rotated towards the direction of motion."""
        directions = v + FACING_PREFERRED * preferred_velocities
        slow_speeds = SLOW_YAW_SPEED * self.agents.speeds
        speed_ratio = np.linalg.norm(directions, axis=1) / slow_speeds
        yaw = wrap_angles(np.arctan2(directions[:, 0], directions[:, 1]) - headings)
        fraction = -np.expm1(-dt / YAW_TIME * np.minimum(speed_ratio, 1.0))
        max_yaw = MAX_YAW_RATE * dt
        return np.asarray(headings + np.clip(yaw * fraction, -max_yaw, max_yaw))

    def frame(
        self,
        state: CrowdState,
        t: float,  # noqa: ARG002
    ) -> PointsFrame | TransformsFrame | CharactersFrame:
        """Return agents as points, meshes or characters."""
        agents = self.agents
        is_visible = state.progress.stages != DEPARTED_STAGE
        if state.bodies is None:
            ids = np.flatnonzero(is_visible)
        else:
            ids = np.arange(len(is_visible))
        x, v = state.points[ids], state.velocities[ids]
        heights, normals = sample_ground(self.ground, x)
        # Velocities are along the ground.
        vertical_speeds = (
            -(normals[:, 0] * v[:, 0] + normals[:, 2] * v[:, 1]) / normals[:, 1]
        )
        ground_frame = self.ground_frame
        points = ground_frame.to_world(np.column_stack([x[:, 0], heights, x[:, 1]]))
        velocities = ground_frame.vector_to_world(
            np.column_stack([v[:, 0], vertical_speeds, v[:, 1]])
        )
        entry_indices = agents.entry_indices[ids]
        primvars = {"population": entry_indices} if len(agents.entries) > 1 else {}
        if self.cast is not None and state.bodies is not None:
            placement = ground_frame, velocities
            return self.cast.frame(
                state.bodies,
                agent_motion(state),
                heights,
                placement,
                is_visible,
                primvars,
                self._fallen_poses(state.falls),
            )
        if not self.meshes:
            return PointsFrame(ids, points, velocities, agents.radii[ids], primvars)
        yaw_rotations = rotations_about_y(state.headings[ids])
        return TransformsFrame(
            ids,
            points,
            velocities,
            so3.multiply(
                np.broadcast_to(ground_frame.rotation, yaw_rotations.shape),
                yaw_rotations,
            ),
            np.zeros((len(ids), 3)),
            np.ones((len(ids), 3)),
            self.mesh_of_population[entry_indices],
            self.meshes,
            primvars,
        )

    def _fallen_poses(
        self, falls: Falls | None
    ) -> dict[int, tuple[FloatArray, FloatArray]]:
        """Return local translations and rotations of fallen agents, by agent index."""
        if falls is None or self.fall_simulator is None:
            return {}
        return {
            agent: self.fall_simulator.poses(falls, k)
            for k, agent in enumerate(falls.agents.tolist())
        }

    def diagnostics(self, state: CrowdState, t: float) -> Diagnostics:  # noqa: ARG002
        """Return the number, speed, progress and overlap of agents."""
        has_left = state.progress.stages == DEPARTED_STAGE
        speeds = np.linalg.norm(state.velocities[~has_left], axis=1)
        values = {"agents": float(len(speeds)), "overlap": state.overlap}
        if len(speeds):
            values["speed"] = float(speeds.mean())
        if state.falls is not None:
            values["fallen"] = float(len(state.falls.agents))
        passed_goals = np.where(has_left, 0, state.progress.stages)
        values["goals reached"] = float(passed_goals.sum())
        return Diagnostics(values=values, notices=self.notices)


def _check_finite(t: float, *arrays: FloatArray) -> None:
    """Raise SIM102 if a number is not finite."""
    if not all(np.isfinite(array).all() for array in arrays):
        message = f"agents blew up at {t:g} s"
        raise ToleranceError(Fault("SIM102", message, hint="use shorter steps"))


def agent_motion(state: CrowdState) -> AgentMotion:
    """Return positions, velocities and headings of a state."""
    return AgentMotion(state.points, state.velocities, state.headings)
