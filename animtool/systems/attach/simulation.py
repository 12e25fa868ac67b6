"""Simulation of attachments through a take, frame by frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from itertools import pairwise

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import time_codes
from animtool.core.record import dataclass
from animtool.core.units import parse_length
from animtool.maths import so3
from animtool.motion.keyed import weights_at
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import TakeStream
from animtool.rig.parts import AttachKind
from animtool.sim.colliders import Colliders
from animtool.systems.attach.actor import AttachmentActor, CycleSteering
from animtool.systems.attach.bodies import AttachedBody, ChainBody, SurfaceBody
from animtool.systems.attach.chains import chain_rotations
from animtool.systems.attach.colliders import CollisionSurroundings
from animtool.systems.attach.poses import (
    STEERED_FRACTION,
    CycleGap,
    CycleShift,
    LocalPose,
    advance_cycle,
    bind_around,
    cycle_gap,
    cycle_travel,
    ease_rotations,
    extrapolate_roots,
    pose_at,
    seam_weights,
)
from animtool.systems.attach.settings import PreRoll, SimulateOptions
from animtool.systems.attach.skins import FramePoses, SkinSurface, build_skins
from animtool.systems.framework.meter import (
    ClosedSurface,
    ContactMeter,
    count_pierced_pairs,
)
from animtool.systems.framework.run import ReachedState
from animtool.systems.framework.saved import StateClock
from animtool.systems.framework.simulation import growing_field
from animtool.systems.springs.motion import move_rigidly
from animtool.systems.springs.solvers import LOOKBACK_TIME

# Most unsteered repeats of a cycle in a row that do not close it better.
MAX_STALE_REPEATS = 3
# Time from the bind pose to the first pose of cloth that the first pose pierces [s].
UNPIERCING_TIME = 0.5
# Largest number of point values in a block.
BLOCK_VALUES = 1 << 20


@dataclass(frozen=True, slots=True, eq=False)
class AttachState:
    """Positions and velocities of N particles, as saved in a file."""

    positions: FloatArray  # ``(N, 3)`` [m], world
    velocities: FloatArray  # ``(N, 3)`` [m/s]
    # Particles that pierced the cloth ``(C, 3)``: particle, triangle, side.
    passages: IntArray = field(
        default_factory=lambda: np.zeros((0, 3), np.int64), metadata=growing_field()
    )


@dataclass(frozen=True, slots=True, eq=False)
class SavedFrame:
    """Saved states of attachments at one frame."""

    frame: float  # time code of the frame
    states: Mapping[str, AttachState]  # states by attachment name


def state_name_and_clock(body: AttachedBody, frame: float) -> tuple[str, StateClock]:
    """Return the name and the clock of an attachment's saved state."""
    return f"{frame!r}/{body.name}", StateClock(body.kind, frame, 1.0)


@dataclass(frozen=True, slots=True)
class LoopClosure:
    """Result of closing a simulated cycle."""

    repeat_count: int  # number of repeats
    residual: float  # distance between end and start of the last repeat [m]
    tolerance: float  # requested tolerance [m]
    is_steered: bool  # whether the cycle was steered towards the cycle before


@dataclass(slots=True)
class _AttachmentFrames:
    """Simulated and animated points of one attachment, by frame."""

    simulated_points: list[FloatArray] = field(default_factory=list)
    animated_points: list[FloatArray] = field(default_factory=list)
    # Surroundings in a cycle, for contact measurement after the seam is blended.
    surroundings: list[CollisionSurroundings] = field(default_factory=list)
    # States in a cycle, to which the next one may be steered ``(2, N, 3)`` [m, m/s].
    motions: list[FloatArray] = field(default_factory=list)

    def add_points(self, actor: AttachmentActor) -> None:
        """Add the points of a frame."""
        self.simulated_points.append(actor.positions)
        self.animated_points.append(actor.animated_positions)


class AttachSimulation:
    """Simulates the attachments of a rig through a take."""

    def __init__(
        self,
        stream: TakeStream,
        bodies: Sequence[AttachedBody],
        options: SimulateOptions,
        resumed: SavedFrame | None = None,
        prepended_frames: int = 0,
        progress: Callable[[float], None] | None = None,
        world: Colliders | None = None,
    ) -> None:
        """Set up the simulation without reading the take.

        There are ``prepended_frames`` before the take, with the pose of its first
        frame; a cycle ignores them. The take starts at world time 0.
        """
        self._world_colliders = Colliders(()) if world is None else world
        self.rig, self.bodies, self.options = stream.rig, bodies, options
        # One for each body, from the first frame on.
        self.actors: list[AttachmentActor] = []
        # Requested states, with the steps per frame.
        self.saved_states: dict[str, tuple[StateClock, ReachedState[AttachState]]] = {}
        self.visited_codes: list[float] = []  # time codes of the frames so far
        self.resumed = resumed  # states to resume from
        self.loop_closure: LoopClosure | None = None  # result of a cycle
        self.cycle_gap: CycleGap | None = None  # gap of a take that is no cycle
        self._skins: list[SkinSurface] = []  # collision meshes of the character
        if any(self._collides_with_skins(body) for body in bodies):
            self._skins = build_skins(self.rig)
        # Largest rotations of last joints by name of the chain [rad].
        self.last_joint_angles: dict[str, float] = {}
        self._rate, self._step = float(stream.fps / stream.step), stream.step
        self._start, self._prepended_frame_count = stream.first_frame, prepended_frames
        # Index of the next frame; 0 is the first of the take.
        self._frame = 0 if options.loop else -prepended_frames
        self._progress = progress
        self._advanced_frame_count, self._total_frame_count = 0, 1
        self._previous_pose: LocalPose | None = None
        self._last_rotations: dict[int, FloatArray] = {}

    def _collides_with_skins(self, body: AttachedBody) -> bool:
        """Return whether an attachment collides with skins of the rig."""
        if self.options.skin is None:
            return body.kind == AttachKind.CLOTH
        return self.options.skin

    def _skins_of(self, body: AttachedBody) -> Sequence[SkinSurface]:
        """Return the collision meshes of an attachment.

        A chain ignores faces that it moves itself.
        """
        if not self._collides_with_skins(body):
            return ()
        if not isinstance(body, ChainBody):
            return self._skins
        joints = range(len(self.rig.joints))
        return build_skins(
            self.rig,
            [j for j in joints if np.isin(self.rig.upwards(j), body.joints).any()],
        )

    def blocks(self, motions: Iterator[Motion]) -> Iterator[Motion]:
        """Yield blocks of the motion with simulated attachments."""
        if self.options.loop:
            motion = Motion.concatenate(list(motions))
            first = self._prepended_frame_count
            cycle = self._close_cycle(motion.select(slice(first, None)))
            yield cycle.select(np.maximum(np.arange(-first, cycle.frames), 0))
            return
        values = 3 * sum(body.network.count for body in self.bodies)
        block_frames = max(BLOCK_VALUES // max(values, 1), 2)
        for block in _first_block_of_two(motions):
            self._advanced_frame_count, self._total_frame_count = 0, block.frames
            for begin in range(0, block.frames, block_frames):
                yield self._block(block.select(slice(begin, begin + block_frames)))

    def _block(self, block: Motion) -> Motion:
        """Return a block of the motion with simulated attachments."""
        codes = self._codes(len(self.visited_codes), block.frames)
        rows = [_AttachmentFrames() for _ in self.bodies]
        for i, time_code in enumerate(codes.tolist()):
            pose = pose_at(block, i)
            if self._previous_pose is None:
                self._begin(pose, pose_at(block, min(1, block.frames - 1)))
            else:
                frame_poses = FramePoses(self.rig, self._previous_pose, pose)
                self._advance(frame_poses, time_code)
            self._previous_pose = pose
            self._save_and_resume(time_code)
            for row, actor in zip(rows, self.actors, strict=True):
                actor.measure(time_code, actor.positions, actor.surroundings())
                row.add_points(actor)
        self.visited_codes += codes.tolist()
        return self._blend(block, codes, rows)

    def _codes(self, first: int, count: int) -> FloatArray:
        return time_codes(self._start + first * self._step, self._step, count)

    def _begin(self, pose: LocalPose, next_pose: LocalPose) -> None:
        """Create the actors, let them settle, and advance them to the first frame."""
        options, rate = self.options, self._rate
        preroll_frames = math.ceil(options.preroll * rate)
        extrapolates = PreRoll(options.lead) is PreRoll.EXTRAPOLATE
        poses = [pose] * (preroll_frames + 1)
        if extrapolates:
            frames = range(preroll_frames, -1, -1)
            poses = [extrapolate_roots(self.rig, pose, next_pose, n) for n in frames]
        start_pose, world = poses[0], self._world_colliders
        static_poses = FramePoses(self.rig, start_pose, start_pose)
        settle_frames = math.ceil(options.settle * rate)
        first_frame = self._frame - settle_frames - preroll_frames
        self.actors = []
        for body in self.bodies:
            # Skinned points collide with cloth that is named before them.
            sheets = [actor.sheet for actor in self.actors if actor.sheet is not None]
            layers = sheets if isinstance(body, SurfaceBody) else ()
            skins = self._skins_of(body)
            clear_pose = self._clear_pose(body, skins, start_pose)
            actor = AttachmentActor(
                self.rig, body, options, 1 / rate, clear_pose, skins, world, layers
            )
            self.actors.append(actor)
            if clear_pose is start_pose:
                continue
            if self.resumed is not None:
                actor.follow_animation(static_poses)
                continue
            step_count = math.ceil(UNPIERCING_TIME * rate)
            clear_poses = ease_rotations(clear_pose, start_pose, step_count)
            for frame, (earlier, later) in enumerate(pairwise(clear_poses)):
                frame_poses = FramePoses(self.rig, earlier, later)
                actor.advance_frame(frame_poses, first_frame - step_count + frame)
        if self.resumed is not None:
            return
        self._frame = first_frame
        self._total_frame_count += settle_frames + preroll_frames
        for _ in range(settle_frames):
            self._advance_actors(static_poses)
        if extrapolates and preroll_frames:
            root = self.rig.roots[0]
            step = next_pose.translations[root] - pose.translations[root]
            for actor in self.actors:
                positions, velocities = actor.grid.state.motion
                actor.set_motion(np.stack([positions, velocities + step * rate]))
        for earlier, later in pairwise(poses):
            self._advance_actors(FramePoses(self.rig, earlier, later))

    def _clear_pose(
        self, body: AttachedBody, skins: Sequence[SkinSurface], pose: LocalPose
    ) -> LocalPose:
        """Return a pose to start in; the bind pose if a given one pierces more cloth.

        The joint that carries the cloth stays where it is.
        """
        triangles = body.network.triangles
        if not (skins and len(triangles)):
            return pose

        def pierced_count(pose: LocalPose) -> int:
            poses = FramePoses(self.rig, pose, pose)
            points = body.targets(poses.sample(1))[0]
            solids = [
                ClosedSurface(poses.skin_points(skin, 1)[0], skin.triangles)
                for skin in skins
            ]
            return count_pierced_pairs(points, triangles, solids)

        count, bind_pose = (
            pierced_count(pose),
            bind_around(self.rig, pose, body.carrier),
        )
        return bind_pose if count and pierced_count(bind_pose) < count else pose

    def _advance(self, frame_poses: FramePoses, time_code: float) -> None:
        """Advance all actors to the next frame, or follow the animation."""
        if self.resumed is None or time_code > self.resumed.frame:
            has_teleport = time_code in self.options.teleports
            self._advance_actors(frame_poses, has_teleport=has_teleport)
            return
        for actor in self.actors:
            actor.follow_animation(frame_poses)
        self._frame += 1

    def _advance_actors(
        self,
        frame_poses: FramePoses,
        steering: Sequence[CycleSteering] = (),
        *,
        has_teleport: bool = False,
    ) -> None:
        """Advance all actors by a frame, or teleport them."""
        max_speed = self.options.teleport_speed
        for number, actor in enumerate(self.actors):
            if has_teleport or (max_speed and actor.speed(frame_poses) > max_speed):
                actor.teleport(frame_poses)
            else:
                actor_steering = steering[number] if steering else None
                actor.advance_frame(frame_poses, self._frame, actor_steering)
            if self._progress is not None:
                self._advanced_frame_count += 1
                total = self._total_frame_count * len(self.actors)
                self._progress(min(self._advanced_frame_count / total, 1.0))
        self._frame += 1
        if not self.options.loop:
            # The next frame samples surfaces a little before its start.
            earliest_time = self._frame / self._rate - LOOKBACK_TIME
            for bodies in self._world_colliders.bodies:
                bodies.forget(earliest_time)
            for sheet in self._world_colliders.sheets:
                sheet.motion.forget(earliest_time)

    def _save_and_resume(self, time_code: float) -> None:
        """Save requested states, and load resumed states at their frame."""
        if self.resumed is not None and time_code == self.resumed.frame:
            for actor in self.actors:
                resumed_state = self.resumed.states[actor.body.name]
                motion = np.stack([resumed_state.positions, resumed_state.velocities])
                actor.set_motion(motion, resumed_state.passages)
        if time_code in self.options.save_at:
            for actor in self.actors:
                name, clock = state_name_and_clock(actor.body, time_code)
                positions, velocities = actor.grid.state.motion
                passages = actor.grid.state.passages
                state = AttachState(positions, velocities, passages)
                reached_state = ReachedState(actor.steps_per_frame, state)
                self.saved_states[name] = clock, reached_state

    def _close_cycle(self, motion: Motion) -> Motion:
        """Return a cycle in which all attachments end in the state they start in."""
        count = motion.frames
        poses = [pose_at(motion, i) for i in range(count)]
        travel = cycle_travel(self.rig, poses)
        poses.append(advance_cycle(self.rig, poses[0], travel))
        self.cycle_gap = cycle_gap(self.rig, poses)
        tolerance = parse_length(self.options.loop_tolerance)
        max_repeats = self.options.loop_repeats
        self._advanced_frame_count, self._total_frame_count = 0, count * max_repeats
        self._begin(poses[0], poses[1])
        stale_repeats, best_residual = 0, math.inf
        rows: list[_AttachmentFrames] = []
        for repeat in range(1, max_repeats + 1):
            is_last_try = repeat == max_repeats or stale_repeats >= MAX_STALE_REPEATS
            is_steered = bool(rows) and is_last_try
            rows = self._simulate_cycle(poses, rows if is_steered else [])
            end_states = [_moved_to_start(row.motions[-1], travel) for row in rows]
            pairs = zip(rows, end_states, strict=True)
            gaps = [row.simulated_points[0] - end[0] for row, end in pairs]
            residual = max(float(np.abs(gap).max(initial=0.0)) for gap in gaps)
            self.loop_closure = LoopClosure(repeat, residual, tolerance, is_steered)
            if residual <= tolerance or is_steered:
                break
            stale_repeats = 0 if residual < best_residual else stale_repeats + 1
            best_residual = min(best_residual, residual)
            for actor, end in zip(self.actors, end_states, strict=True):
                actor.set_motion(end)
        weights = seam_weights(count)
        for row, gap, actor in zip(rows, gaps, self.actors, strict=True):
            # Points of steered cloth are each a little off, in directions of their own:
            # blended, its edges would be strained by that.
            if not (is_steered and len(actor.body.network.triangles)):
                offset = so3.rotate(travel.rotation, gap)
                frames = zip(row.simulated_points, weights.tolist(), strict=True)
                row.simulated_points = [
                    points + weight * offset for points, weight in frames
                ]
            actor.meter = ContactMeter()
            for time_code, points, surroundings in zip(
                self.visited_codes, row.simulated_points, row.surroundings, strict=True
            ):
                actor.measure(time_code, points, surroundings)
        return self._blend(
            motion, self._codes(self._prepended_frame_count, count), rows
        )

    def _simulate_cycle(
        self, poses: list[LocalPose], last_frames: list[_AttachmentFrames]
    ) -> list[_AttachmentFrames]:
        """Simulate one cycle, and return all of its frames except the last.

        With ``last_frames``, this cycle is steered towards the last cycle, which ended
        at the start of this one.
        """
        rows = [_AttachmentFrames() for _ in self.bodies]
        codes = self._codes(self._prepended_frame_count, len(poses)).tolist()
        self.visited_codes = codes[:-1]
        self._frame = 0
        for actor in self.actors:
            actor.set_target(poses[0])
        weights = np.append(seam_weights(len(poses) - 1, STEERED_FRACTION), 1.0)
        for i, (pose, next_pose) in enumerate(pairwise(poses)):
            for row, actor in zip(rows, self.actors, strict=True):
                row.surroundings.append(actor.surroundings())
                row.motions.append(actor.grid.state.motion)
                row.add_points(actor)
            steering = [
                CycleSteering(np.stack(row.motions[i : i + 2]), weights[i + 1])
                for row in last_frames
            ]
            has_teleport = codes[i + 1] in self.options.teleports
            frame_poses = FramePoses(self.rig, pose, next_pose)
            self._advance_actors(frame_poses, steering, has_teleport=has_teleport)
        for row, actor in zip(rows, self.actors, strict=True):
            row.motions.append(actor.grid.state.motion)
        return rows

    def _blend(
        self, block: Motion, codes: FloatArray, rows: list[_AttachmentFrames]
    ) -> Motion:
        """Return a motion with simulated values blended over animated values."""
        options = self.options
        weights = weights_at(options.weight, codes, options.interpolation)
        if self.resumed is not None:
            weights = np.where(codes < self.resumed.frame, 0.0, weights)
        rotations = block.rotations.dense()
        for body, row in zip(self.bodies, rows, strict=True):
            points = np.stack(row.simulated_points)
            targets = np.stack(row.animated_points)
            if isinstance(body, ChainBody):
                simulated = self._blend_rotations(
                    rotations, body, points, targets, weights
                )
                channel = block.rotations.put(body.joints, simulated)
                block = replace(block, rotations=channel)
            elif isinstance(body, SurfaceBody):
                block = _blend_points(block, body.mesh.name, points, targets, weights)
        return block

    def _blend_rotations(
        self,
        rotations: FloatArray,
        body: ChainBody,
        points: FloatArray,
        targets: FloatArray,
        weights: FloatArray,
    ) -> FloatArray:
        """Return chain rotations that aim bones at simulated points ``(F, C, 4)``."""
        joints, first = body.joints, int(body.joints[0])
        before = rotations[:, joints]
        simulated = chain_rotations(self.rig, joints, rotations, targets, points)
        after = so3.slerp(before, simulated, weights[:, None])
        after = np.where((weights == 1)[:, None, None], simulated, after)
        after = so3.align_signs(after, self._last_rotations.get(first, before[0]))
        self._last_rotations[first] = after[-1]
        angles = so3.angle_between(before[:, -1], after[:, -1])
        largest = float((angles * (weights != 0)).max(initial=0.0))
        earlier = self.last_joint_angles.get(body.name, 0.0)
        self.last_joint_angles[body.name] = max(earlier, largest)
        # With weight 0 keep the animation bit for bit.
        return np.where((weights == 0)[:, None, None], before, after)


def _first_block_of_two(blocks: Iterator[Motion]) -> Iterator[Motion]:
    """Yield blocks of frames, merged so that the first has two frames or more."""
    first_blocks: list[Motion] = []
    for block in blocks:
        first_blocks.append(block)
        if sum(motion.frames for motion in first_blocks) >= 2:
            break
    if first_blocks:
        yield Motion.concatenate(first_blocks)
    yield from blocks


def _moved_to_start(motion: FloatArray, travel: CycleShift) -> FloatArray:
    """Return the end state of a cycle, transformed back by the travel of the cycle."""
    rotation = so3.conjugate(travel.rotation)
    return move_rigidly(motion, -so3.rotate(rotation, travel.shift), rotation)


def _blend_points(
    block: Motion,
    name: str,
    points: FloatArray,
    targets: FloatArray,
    weights: FloatArray,
) -> Motion:
    """Return a motion with simulated points blended over animated points."""
    values = points
    if (weights != 1).any():
        weight = weights[:, None, None]
        values = np.where(weight == 1, points, targets + weight * (points - targets))
        values = np.where(weight == 0, targets, values)
    channel = Channel(values[0].copy(), np.arange(values.shape[1]), values)
    return replace(block, points={**block.points, name: channel})
