"""Crowd simulation: agents stepped over time, shown as points or meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from animtool import _kernels
from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault, ToleranceError, refuse
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.frames import (
    CharactersFrame,
    MeshFrame,
    PointsFrame,
    TransformsFrame,
)
from animtool.sim.colliders import Collider, Colliders
from animtool.systems.crowds.agents import ENOUGH, AgentMotion, agents_of
from animtool.systems.crowds.beginning import (
    along_ground,
    ground_of,
    outside,
    unreachable,
)
from animtool.systems.crowds.ground import about_up
from animtool.systems.crowds.obstacles import Obstacles, Walls, grids
from animtool.systems.crowds.shoulders import DEPTH, lines, turned_shoulders
from animtool.systems.crowds.spec import CrowdsModel
from animtool.systems.crowds.steering import GONE, Progress, Steering
from animtool.systems.framework.simulation import Diagnostics, SimContext

if TYPE_CHECKING:
    from animtool.rig.kinematics import WorldTransforms
    from animtool.systems.crowds.cast import Casting
    from animtool.systems.crowds.falls import Falls, FallSimulator
    from animtool.systems.crowds.footing import BodyState

# Passes that separate overlapping agents in a step.
SEPARATION_PASSES = 100
# Side to pass on, in the kernel's encoding.
WALKS, STAYS, OUT = np.uint8(0), np.uint8(1), np.uint8(2)
# Agents face their motion, and by this fraction their preferred velocity.
FACING = 0.5
# Discount of the next lane to the left against oncoming agents.
SIDES = {"right": -0.2, "left": 0.2, "none": 0.0}
# Below this fraction of the preferred speed, agents yaw proportionally slower.
SLOW = 0.6
# Time constant of yaw towards motion [s].
TURNING = 0.25
# Largest yaw rate [rad/s]: turning round takes most of a second.
MAX_YAW_RATE = 4.0


@dataclass(frozen=True, slots=True)
class CrowdState:
    """The state of N agents on the ground."""

    points: FloatArray  # x and z (N, 2) [m]
    velocities: FloatArray  # of these (N, 2) [m/s]
    headings: FloatArray  # about up, 0 is along z (N,) [rad]
    progress: Progress
    overlap: float  # largest overlap of two agents so far [m]
    bodies: BodyState | None  # None without bodies
    falls: Falls | None  # None if nobody can fall


class Crowd:
    """Walking agents, in steps.

    Attributes:
        checked: Its steps see to it that numbers stay finite.

    Raises:
        OptionError: Something of the spec makes no sense (SIM145).
    """

    checked = True

    def __init__(self, spec: CrowdsModel, context: SimContext) -> None:
        self._begin, self._spec = context.begin, spec
        self._frame, self._ground = ground_of(context)
        if context.colliders.sheets:
            message = "crowds avoid shapes, rigid bodies and the capsules of characters"
            hint = "use its colliders instead of the surface"
            refuse("SIM145", message, "systems", hint)
        self._agents, self._notices = agents_of(
            spec, context.parts["populations"], context.begin, self._frame
        )
        self._steering, self._obstacles = self._navigation(context)
        self._settling = self._agents.each(
            [one.acceleration for one in spec.populations]
        )
        self._start, moved = outside(
            self._agents, self._steering.grid, self._obstacles, context.begin
        )
        self._notices += moved
        self._notices += unreachable(spec, self._agents, self._steering, self._start)
        shows = [parts.get("shows") for parts in context.parts["populations"]]
        cycles = {show: show() for show in shows if show is not None}
        self._meshes: tuple[MeshFrame, ...] = tuple(c[0] for c in cycles.values())
        order = list(cycles)
        self._casting: Casting | None = None
        self._falling: FallSimulator | None = None
        self._cast(context)
        self._shown = np.array([order.index(s) if s else 0 for s in shows], np.int64)

    def _navigation(self, context: SimContext) -> tuple[Steering, Obstacles]:
        """Return the steering towards goals, and the obstacles."""
        spec, agents, frame = self._spec, self._agents, self._frame
        goals = self._on_ground([goal.at for goal in spec.goals])
        grid, edge = grids(
            spec,
            agents,
            frame,
            self._ground,
            context.colliders,
            goals,
            context.begin,
        )
        lines = [
            [0.0, 0.0]
            if goal.queue is None
            else along_ground(frame, goal.queue.direction) * goal.queue.spacing
            for goal in spec.goals
        ]
        steering = Steering(
            agents, spec.goals, goals, np.array(lines).reshape(-1, 2), grid
        )
        sides = [[d.begin for d in spec.doors], [d.end for d in spec.doors]]
        ends = np.stack([self._on_ground(one) for one in sides], axis=1)
        for door, (begin, end) in zip(spec.doors, ends, strict=True):
            if not ((end - begin) ** 2).sum() > 0:
                message = (
                    f"both ends of {door.name!r} are at the same position on the ground"
                )
                refuse("SIM145", message, "doors")
        obstacles = Obstacles(
            agents,
            frame,
            self._ground,
            context.colliders,
            spec.doors,
            edge,
            spec.avoidance.obstacles,
            ends,
        )
        return steering, obstacles

    def _cast(self, context: SimContext) -> None:
        """Return bodies for the agents, if populations have gaits."""
        sources = [parts.get("gaits") for parts in context.parts["populations"]]
        gaits = [source for source in sources if source is not None]
        if not gaits:
            return
        from animtool.systems.crowds.cast import Casting

        moving = [*context.colliders.bodies, *_moving(context.colliders)]
        self._casting = Casting.of(
            self._agents, gaits, self._ground, falls=bool(moving)
        )
        self._falling = self._fallers(context) if moving else None
        for group in self._casting.groups:
            self._notices += group.bodies.gaits.notices

    def _fallers(self, context: SimContext) -> FallSimulator | None:
        """Return the ragdolls of falling agents; None if a rig has no bodies."""
        from animtool.systems.crowds.falls import FallSimulator

        assert self._casting is not None
        casts = [group.cast.rig for group in self._casting.groups]
        if not all(FallSimulator.possible(rig) for rig in casts) or not len(
            self._agents
        ):
            return None
        return FallSimulator(
            self._casting.rigs,
            self._agents.sizes,
            self._frame,
            self._ground,
            context.colliders,
            self._spec.step,
        )

    def _on_ground(self, points: Sequence[Sequence[float]]) -> FloatArray:
        """Project world points on the ground: x and z ``(K, 2)``."""
        return self._frame.to_local(np.array(points, float).reshape(-1, 3))[:, [0, 2]]

    def initial(self) -> CrowdState:
        """Return the initial state, headings along the first directions."""
        x, progress = self._start, self._steering.first()
        at_rest = np.zeros_like(x)
        preferred = self._steering.preferred(np.inf, self._begin, progress, x)
        headings = np.arctan2(preferred[:, 0], preferred[:, 1])
        bodies = None
        if self._casting is not None:
            going = AgentMotion(x, at_rest, headings)
            bodies = self._casting.first(going, self._agents.chances)
        falls = None if self._falling is None else self._falling.none()
        return CrowdState(x, at_rest, headings, progress, 0.0, bodies, falls)

    def step(self, state: CrowdState, t: float, dt: float) -> CrowdState:
        """Return the state after a step [s].

        Raises:
            ToleranceError: Numbers do not stay finite (SIM102).
        """
        agents, rules = self._agents, self._spec.avoidance
        if not len(agents):
            return state
        x, v = state.points, state.velocities
        preferred = self._steering.preferred(t, self._begin, state.progress, x)
        relaxed = v + (preferred - v) * -np.expm1(-dt / self._settling)[:, None]
        walls = self._obstacles.walls(t, dt, x)
        down = np.zeros(len(x), np.bool_)
        if state.falls is not None:
            down[state.falls.agents] = True
        does = np.where(down, STAYS, WALKS)
        does[state.progress.stages == GONE] = OUT
        if not all(np.isfinite(each).all() for each in (x, v, relaxed, walls.rows)):
            message = f"agents blew up at {t:g} s"
            raise ToleranceError(Fault("SIM102", message, hint="use shorter steps"))
        shoulders = self._shoulders(state, down)
        points, velocities, overlap, pressed = _kernels.crowd_step(
            points=x, velocities=v, preferred=relaxed,
            radii=agents.radii, most=agents.most, gives=agents.gives,
            shoulders=lines(state.headings, shoulders), depth=DEPTH,
            groups=agents.groups, does=does, starts=walls.starts, walls=walls.rows,
            sight=rules.sight, nearest=rules.nearest, horizon=rules.horizon,
            space=rules.space, push=rules.push, headway=rules.headway,
            side=SIDES[rules.side], step=dt, rounds=SEPARATION_PASSES,
            enough=ENOUGH * float(agents.radii.min()),
        )  # fmt: skip
        progress = self._steering.advanced(state.progress, points, dt)
        headings = self._turned(state.headings, preferred, velocities, dt)
        bodies = state.bodies
        falls = state.falls
        if self._casting is not None and bodies is not None:
            before, after = _going(state), AgentMotion(points, velocities, headings)
            speeds = self._struck(walls, dt)
            hit = speeds > self._spec.impact.stagger
            bodies = self._casting.next(bodies, before, after, dt, hit)
            turned = turned_shoulders(shoulders, np.where(hit, 0.0, pressed), dt)
            bodies = replace(bodies, shoulders=turned)
            if self._falling is not None and falls is not None:
                fell = np.flatnonzero((speeds > self._spec.impact.fall) & ~down)
                if len(fell):
                    falls = self._begun(state, falls, fell, dt)
                falls = self._falling.step(falls, t, dt)
        if not (np.isfinite(points).all() and np.isfinite(headings).all()):
            message = f"agents blew up at {t + dt:g} s"
            raise ToleranceError(Fault("SIM102", message, hint="use shorter steps"))
        overlap = max(state.overlap, overlap)
        return CrowdState(
            points, velocities, headings, progress, overlap, bodies, falls
        )

    def _begun(
        self, state: CrowdState, falls: Falls, fell: IntArray, dt: float
    ) -> Falls:
        """Return falls with more agents ``(K,)``, from the start of a step.

        They were about to walk on: what hits them moves their bodies, not their legs.
        """
        assert self._casting is not None
        assert self._falling is not None
        assert state.bodies is not None
        here, v = _going(state), state.velocities
        next_motion = AgentMotion(here.points + v * dt, v, here.headings)
        unhit = np.zeros(len(v), np.bool_)
        walked = self._casting.next(state.bodies, here, next_motion, dt, unhit)
        now, soon = (
            [self._world(bodies, going, i) for i in fell.tolist()]
            for bodies, going in ((state.bodies, here), (walked, next_motion))
        )
        return self._falling.begun(falls, fell, now, soon, dt)

    def _shoulders(self, state: CrowdState, down: BoolArray) -> FloatArray:
        """Return shoulder yaws ``(N,)`` [rad].

        Agents shown as points or meshes have none; fallen ones keep their space.
        """
        if state.bodies is None:
            return np.zeros(len(self._agents))
        return np.where(down, 0.0, state.bodies.shoulders)

    def _struck(self, walls: Walls, dt: float) -> FloatArray:
        """Return the highest closing speed at each agent ``(N,)`` [m/s]."""
        closing = np.zeros(len(self._agents))
        touch = walls.gaps < np.maximum(walls.closing, 0.0) * dt
        np.maximum.at(closing, walls.whose[touch], walls.closing[touch])
        return closing

    def _world(
        self, bodies: BodyState | None, going: AgentMotion, i: int
    ) -> WorldTransforms:
        """Return an agent's joints in the world."""
        assert self._casting is not None
        assert bodies is not None
        return self._casting.world(bodies, going, self._frame, self._ground, i)

    def _turned(
        self, headings: FloatArray, preferred: FloatArray, v: FloatArray, dt: float
    ) -> FloatArray:
        """Return headings ``(N,)`` after agents turn towards their motion."""
        facing = v + FACING * preferred
        fast = np.linalg.norm(facing, axis=1) / (SLOW * self._agents.speeds)
        yaw = np.arctan2(facing[:, 0], facing[:, 1]) - headings
        yaw = (yaw + np.pi) % (2 * np.pi) - np.pi
        fraction = -np.expm1(-dt / TURNING * np.minimum(fast, 1.0))
        most = MAX_YAW_RATE * dt
        return np.asarray(headings + np.clip(yaw * fraction, -most, most))

    def frame(
        self,
        state: CrowdState,
        t: float,  # noqa: ARG002
    ) -> PointsFrame | TransformsFrame | CharactersFrame:
        """Return points, meshes and characters at a time."""
        agents = self._agents
        here = state.progress.stages != GONE
        ids = np.flatnonzero(here) if state.bodies is None else np.arange(len(here))
        x, v = state.points[ids], state.velocities[ids]
        heights, normals = self._ground(x)
        heights = np.where(np.isfinite(heights), heights, 0.0)
        # Along the ground.
        rise = -(normals[:, 0] * v[:, 0] + normals[:, 2] * v[:, 1]) / normals[:, 1]
        points = self._frame.to_world(np.column_stack([x[:, 0], heights, x[:, 1]]))
        velocities = self._frame.turned(np.column_stack([v[:, 0], rise, v[:, 1]]))
        kinds = agents.kinds[ids]
        primvars = {"population": kinds} if len(agents.populations) > 1 else {}
        if self._casting is not None and state.bodies is not None:
            placed = self._frame, velocities
            return self._casting.frame(
                state.bodies,
                _going(state),
                heights,
                placed,
                here,
                primvars,
                self._fallen(state.falls),
            )
        if not self._meshes:
            return PointsFrame(ids, points, velocities, agents.radii[ids], primvars)
        turned = about_up(state.headings[ids])
        return TransformsFrame(
            ids,
            points,
            velocities,
            so3.multiply(np.broadcast_to(self._frame.rotation, turned.shape), turned),
            np.zeros((len(ids), 3)),
            np.ones((len(ids), 3)),
            self._shown[kinds],
            self._meshes,
            primvars,
        )

    def _fallen(self, falls: Falls | None) -> dict[int, tuple[FloatArray, FloatArray]]:
        """Return local translations and rotations of fallen agents, by number."""
        if falls is None or self._falling is None:
            return {}
        return {
            agent: self._falling.poses(falls, k)
            for k, agent in enumerate(falls.agents.tolist())
        }

    def diagnostics(self, state: CrowdState, t: float) -> Diagnostics:  # noqa: ARG002
        """Return speeds, progress and distances of agents."""
        gone = state.progress.stages == GONE
        speeds = np.linalg.norm(state.velocities[~gone], axis=1)
        values = {"agents": float(len(speeds)), "overlap": state.overlap}
        if len(speeds):
            values["speed"] = float(speeds.mean())
        if state.falls is not None:
            values["fallen"] = float(len(state.falls.agents))
        values["goals reached"] = float(np.where(gone, 0, state.progress.stages).sum())
        return Diagnostics(values=values, notices=self._notices)


def _moving(colliders: Colliders) -> list[Collider]:
    """Return the colliders that move."""
    return [one for one in colliders if len(one.poses.sample_times) > 1]


def _going(state: CrowdState) -> AgentMotion:
    """Return the motion of agents at a state."""
    return AgentMotion(state.points, state.velocities, state.headings)
