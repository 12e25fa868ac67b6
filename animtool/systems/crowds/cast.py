"""Agents with bodies: which has which rig, and the characters that they show."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from animtool._types import BoolArray, FloatArray, IntArray
from animtool.frames import Cast, CharactersFrame
from animtool.systems.crowds.agents import Agents, Going
from animtool.systems.crowds.bodies import Bodies, BodyState, Heights
from animtool.systems.crowds.gaits import Gaits
from animtool.systems.crowds.ground import Frame

# Samples a second of what those do who stand: it is slow.
STANDING_RATE = 24.0


@dataclass(frozen=True)
class CastGroup:
    """Agents of one rig, and what they show."""

    own: IntArray  # which agents (n,)
    bodies: Bodies
    cast: Cast


@dataclass(frozen=True)
class Casting:
    """The bodies of N agents, by rig."""

    groups: Sequence[CastGroup]
    order: IntArray  # of the agents, those of one rig after those of another (N,)

    @staticmethod
    def of(
        agents: Agents, sources: Sequence[Callable[[], Gaits]], ground: Heights
    ) -> Casting:
        """Return bodies of agents, of the gaits of each population."""
        distinct = list(dict.fromkeys(sources))
        which = np.array([distinct.index(one) for one in sources])[agents.kinds]
        groups = []
        for k, source in enumerate(distinct):
            own = np.flatnonzero(which == k)
            bodies = Bodies(source(), agents.sizes[own], ground)
            groups.append(CastGroup(own, bodies, _cast(bodies)))
        order = np.concatenate([group.own for group in groups])
        return Casting(groups, order)

    def first(self, going: Going, chances: FloatArray) -> BodyState:
        """Return the bodies of agents at the beginning."""
        return self._joined(
            [g.bodies.first(part(going, g.own), chances[g.own]) for g in self.groups]
        )

    def next(
        self, state: BodyState, before: Going, after: Going, dt: float
    ) -> BodyState:
        """Return the bodies of agents a step [s] later."""
        return self._joined(
            [
                g.bodies.next(
                    part(state, g.own), part(before, g.own), part(after, g.own), dt
                )
                for g in self.groups
            ]
        )

    def _joined(self, states: Sequence[BodyState]) -> BodyState:
        """Return states of all rigs as one, in the order of the agents."""
        back = np.argsort(self.order)
        return BodyState(
            *(
                np.concatenate([getattr(state, one.name) for state in states])[back]
                for one in fields(BodyState)
            )
        )

    def frame(
        self,
        state: BodyState,
        going: Going,
        heights: FloatArray,
        placed: tuple[Frame, FloatArray],
        visible: BoolArray,
        primvars: Mapping[str, Any],
    ) -> CharactersFrame:
        """Return what agents show.

        Args:
            state: Of their bodies.
            going: How they go.
            heights: Of the ground below them ``(N,)`` [m].
            placed: Where the ground is, and the velocities of agents in the world
                ``(N, 3)`` [m/s].
            visible: Who is to be seen ``(N,)``.
            primvars: Of each.
        """
        frame, velocities = placed
        turns, roots = [], []
        for group in self.groups:
            made = group.bodies.poses(part(state, group.own), part(going, group.own))
            turns.append(made.turns[:, group.cast.moves])
            roots.append(made.roots)
        order = self.order
        points = np.column_stack([going.points[:, 0], heights, going.points[:, 1]])
        only = (state.still >= 1) & ~going.velocities.any(axis=1)
        return CharactersFrame(
            order,
            frame.to_world(points)[order],
            velocities[order],
            frame.rotation,
            going.headings[order],
            np.concatenate([group.bodies.scales for group in self.groups]),
            tuple(group.cast for group in self.groups),
            np.array([len(group.own) for group in self.groups]),
            tuple(turns),
            np.concatenate(roots),
            (state.swings < 0)[order],
            np.where(only, state.clocks, np.nan)[order],
            visible[order],
            {name: values[order] for name, values in primvars.items()},
        )


def part(record: Any, rows: IntArray) -> Any:
    """Return some rows of a record of arrays."""
    changes = {one.name: getattr(record, one.name)[rows] for one in fields(record)}
    return replace(record, **changes)


def _cast(bodies: Bodies) -> Cast:
    """Return the rig of bodies, and what those do alike who stand on level ground."""
    gaits = bodies.gaits
    period = 2 * gaits.idle.period if len(gaits.idle.turns) > 1 else 0.0
    count = max(round(period * STANDING_RATE), 1)
    clocks: FloatArray = np.arange(count, dtype=np.float64) * (period / count)
    here = Going(np.zeros((count, 2)), np.zeros((count, 2)), np.zeros(count))
    level = replace(bodies, scales=np.ones(count), ground=_level)
    first = level.first(here, np.zeros(count))
    made = level.poses(replace(first, clocks=clocks), here)
    moves = bodies.moves
    left, right = (leg[3] if leg[3] >= 0 else leg[2] for leg in gaits.walker.legs)
    return Cast(
        gaits.walker.rig,
        moves,
        (left, right),
        made.turns[:, moves],
        made.roots,
        period,
    )


def _level(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return level ground."""
    return np.zeros(len(points)), np.tile([0.0, 1.0, 0.0], (len(points), 1))
