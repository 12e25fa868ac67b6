"""Characters of a crowd: agents grouped by rig, and the poses they show."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.frames import Cast, CharactersFrame
from animtool.rig.kinematics import WorldTransforms, forward
from animtool.rig.skeleton import Rig
from animtool.sim.colliders.on_joints import Capsules
from animtool.systems.crowds.agents import AgentMotion, Agents
from animtool.systems.crowds.bodies import AgentBodies
from animtool.systems.crowds.footing import BodyState, Heights
from animtool.systems.crowds.gaits import Gaits
from animtool.systems.crowds.ground import Frame, about_up
from animtool.systems.crowds.poses import poses_of

# Samples a second of the idle, which is slow.
STANDING_RATE = 24.0
# Phases of a swing at which soles are close to the ground.
LIFTED, LANDING = 0.08, 0.78


@dataclass(frozen=True)
class CastGroup:
    """Agents that share a rig, and their character."""

    agents: IntArray  # indices of agents (n,)
    bodies: AgentBodies
    cast: Cast


@dataclass(frozen=True)
class Casting:
    """The bodies of N agents, grouped by rig."""

    groups: Sequence[CastGroup]
    order: IntArray  # agent order, rig by rig (N,)

    @staticmethod
    def of(
        agents: Agents,
        sources: Sequence[Callable[[], Gaits]],
        ground: Heights,
        *,
        falls: bool,
    ) -> Casting:
        """Return bodies for agents, from their populations' gaits; some may fall."""
        distinct = list(dict.fromkeys(sources))
        which = np.array([distinct.index(one) for one in sources])[agents.kinds]
        groups = []
        for k, source in enumerate(distinct):
            rows = np.flatnonzero(which == k)
            bodies = AgentBodies(source(), agents.sizes[rows], ground)
            groups.append(CastGroup(rows, bodies, _cast(bodies, falls=falls)))
        order = np.concatenate([group.agents for group in groups])
        return Casting(groups, order)

    def first(self, going: AgentMotion, chances: FloatArray) -> BodyState:
        """Return the initial bodies of all agents."""
        return self._joined(
            [
                g.bodies.first(part(going, g.agents), chances[g.agents])
                for g in self.groups
            ]
        )

    def next(
        self,
        state: BodyState,
        before: AgentMotion,
        after: AgentMotion,
        dt: float,
        hit: BoolArray,
    ) -> BodyState:
        """Return the bodies after a step [s]; some were hit ``(N,)``."""
        return self._joined(
            [
                g.bodies.next(
                    part(state, g.agents),
                    part(before, g.agents),
                    part(after, g.agents),
                    dt,
                    hit[g.agents],
                )
                for g in self.groups
            ]
        )

    def _joined(self, states: Sequence[BodyState]) -> BodyState:
        """Return the states of all rigs joined, in agent order."""
        back = np.argsort(self.order)
        return BodyState(
            *(
                np.concatenate([getattr(state, one.name) for state in states])[back]
                for one in fields(BodyState)
            )
        )

    @property
    def rigs(self) -> list[Rig]:
        """Return each agent's rig."""
        rigs = [self.groups[0].cast.rig] * len(self.order)
        for group in self.groups:
            for i in group.agents.tolist():
                rigs[i] = group.cast.rig
        return rigs

    def world(
        self,
        state: BodyState,
        going: AgentMotion,
        frame: Frame,
        ground: Heights,
        i: int,
    ) -> WorldTransforms:
        """Return an agent's joints in the world, one frame."""
        group = next(one for one in self.groups if i in one.agents)
        row, rig = np.array([i]), group.cast.rig
        bodies = replace(
            group.bodies, scales=group.bodies.scales[np.searchsorted(group.agents, row)]
        )
        poses = poses_of(bodies, part(state, row), part(going, row))
        positions = np.repeat(rig.rest_translations[None], 1, axis=0)
        positions[:, 0] = poses.roots
        world = forward(rig, positions, poses.rotations)
        heading = about_up(going.headings[row])
        rotation = so3.multiply(frame.rotation, heading)
        heights = np.nan_to_num(ground(going.points[row])[0])
        origin = np.insert(going.points[row], 1, heights, axis=1)
        matrix = so3.to_matrix(rotation)
        positions = so3.rotate(rotation, bodies.scales[:, None, None] * world.positions)
        return WorldTransforms(
            positions + frame.to_world(origin)[:, None], matrix[:, None] @ world.linear
        )

    def frame(
        self,
        state: BodyState,
        going: AgentMotion,
        heights: FloatArray,
        placed: tuple[Frame, FloatArray],
        visible: BoolArray,
        primvars: Mapping[str, Any],
        fallen: Mapping[int, tuple[FloatArray, FloatArray]],
    ) -> CharactersFrame:
        """Return the characters at a time.

        Args:
            state: Of their bodies.
            going: How they go.
            heights: Of the ground below them ``(N,)`` [m].
            placed: Where the ground is, and the velocities of agents in the world
                ``(N, 3)`` [m/s].
            visible: Which agents are visible ``(N,)``.
            primvars: Values per agent.
            fallen: Local translations and rotations of fallen agents, by number; the
                root's are in the world.
        """
        frame, velocities = placed
        rotations, roots = [], []
        points = np.column_stack([going.points[:, 0], heights, going.points[:, 1]])
        for group in self.groups:
            some = part(state, group.agents), part(going, group.agents)
            poses = poses_of(group.bodies, *some)
            for i, (positions, fallen_rotations) in fallen.items():
                for row in np.flatnonzero(group.agents == i).tolist():
                    rotation = so3.multiply(frame.rotation, about_up(going.headings[i]))
                    back = so3.conjugate(rotation)
                    poses.rotations[row] = fallen_rotations
                    poses.rotations[row, 0] = so3.multiply(back, fallen_rotations[0])
                    off = positions[0] - frame.to_world(points[i])
                    poses.roots[row] = so3.rotate(back, off) / group.bodies.scales[row]
            rotations.append(poses.rotations[:, group.cast.animated])
            roots.append(poses.roots)
        order = self.order
        only = (state.still >= 1) & ~going.velocities.any(axis=1) & (state.reacts < 0)
        only &= state.shoulders == 0
        only[list(fallen)] = False
        # Feet about to land, or just lifted, are as close to the ground.
        near = (state.swings < LIFTED) | (state.swings > LANDING)
        near[list(fallen)] = False
        stands = near & (state.swings < 0)
        return CharactersFrame(
            order,
            frame.to_world(points)[order],
            velocities[order],
            frame.rotation,
            going.headings[order],
            np.concatenate([group.bodies.scales for group in self.groups]),
            tuple(group.cast for group in self.groups),
            np.array([len(group.agents) for group in self.groups]),
            tuple(rotations),
            np.concatenate(roots),
            stands[order],
            near[order],
            np.where(only, state.clocks, np.nan)[order],
            visible[order],
            {name: values[order] for name, values in primvars.items()},
        )


def part(record: Any, rows: IntArray) -> Any:
    """Return some rows of a record of arrays."""
    changes = {one.name: getattr(record, one.name)[rows] for one in fields(record)}
    return replace(record, **changes)


def _cast(bodies: AgentBodies, *, falls: bool) -> Cast:
    """Return the character of a group, with the pose that idle agents share."""
    gaits = bodies.gaits
    period = 2 * gaits.idle.period if len(gaits.idle.rotations) > 1 else 0.0
    count = max(round(period * STANDING_RATE), 1)
    clocks: FloatArray = np.arange(count, dtype=np.float64) * (period / count)
    here = AgentMotion(np.zeros((count, 2)), np.zeros((count, 2)), np.zeros(count))
    level = replace(bodies, scales=np.ones(count), ground=_level)
    first = level.first(here, np.zeros(count))
    poses = poses_of(level, replace(first, clocks=clocks), here)
    moves = bodies.moves
    if falls:
        moves = np.union1d(moves, Capsules.of(gaits.walker.rig).joints)
    left, right = (leg[3] if leg[3] >= 0 else leg[2] for leg in gaits.walker.legs)
    return Cast(
        gaits.walker.rig,
        moves,
        (left, right),
        poses.rotations[:, moves],
        poses.roots,
        period,
    )


def _level(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return flat ground."""
    return np.zeros(len(points)), np.tile([0.0, 1.0, 0.0], (len(points), 1))
