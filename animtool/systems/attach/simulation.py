"""Simulation of attachments through a take, frame by frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from fractions import Fraction
from itertools import pairwise

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import time_codes
from animtool.core.record import dataclass
from animtool.core.units import parse_length
from animtool.maths import so3
from animtool.motion.keyed import weights_at
from animtool.motion.motion import Channel, Motion
from animtool.rig.parts import AttachKind
from animtool.rig.skeleton import Rig
from animtool.sim.colliders import Colliders
from animtool.systems.attach.actor import (
    Actor,
    AttachedSurroundings,
    PosePaths,
    rigidly_moved,
    upwards,
)
from animtool.systems.attach.bodies import AttachedBody, ChainBody, SurfaceBody
from animtool.systems.attach.poses import (
    STEERED,
    CycleShift,
    LocalPose,
    extrapolated,
    onward,
    pose_at,
    seam_weights,
    travel_between,
)
from animtool.systems.attach.settings import PreRoll, SimulateOptions, settings_for
from animtool.systems.attach.skins import SkinSurface, skins_of
from animtool.systems.attach.stepping import CycleSteering
from animtool.systems.attach.strands import chain_rotations
from animtool.systems.framework.meter import ContactMeter
from animtool.systems.framework.run import ReachedState
from animtool.systems.framework.saved import StateClock
from animtool.systems.framework.simulation import growing
from animtool.systems.springs.contacts import LOOKBACK_TIME

# Most repeats of a cycle in a row that close it no better than before, unsteered.
MAX_STALE = 3
# Largest number of point values in a block.
BLOCK_VALUES = 1 << 20


def _no_passages() -> IntArray:
    return np.zeros((0, 3), np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class AttachState:
    """Saved positions and velocities of N particles."""

    positions: FloatArray  # ``(N, 3)`` [m], world
    velocities: FloatArray  # ``(N, 3)`` [m/s]
    # Self-piercings of cloth ``(C, 3)``: particle, triangle, side.
    passages: IntArray = field(default_factory=_no_passages, metadata=growing())


@dataclass(frozen=True, slots=True, eq=False)
class SavedFrame:
    """Saved states of attachments at one frame."""

    frame: float  # its time code
    states: Mapping[str, AttachState]  # by the attachment's name


def saved_state(body: AttachedBody, frame: float) -> tuple[str, StateClock]:
    """Return the name of a saved state in a file, and its clock."""
    return f"{frame!r}/{body.name}", StateClock(body.kind, frame, 1.0)


@dataclass(frozen=True, slots=True)
class LoopClosure:
    """Result of closing a cycle."""

    repeats: int  # number of repeats
    residual: float  # last distance between end and begin [m]
    tolerance: float  # requested [m]
    steered: bool  # whether it had to be steered to the cycle before


@dataclass(slots=True)
class _Rows:
    """Simulated and animated frames of one attachment."""

    moved: list[FloatArray]
    targets: list[FloatArray]
    # Of a cycle, which is measured once its seam is blended.
    surroundings: list[AttachedSurroundings] = field(default_factory=list)
    # States of a cycle, to which the next one may be steered ``(2, N, 3)`` [m, m/s].
    motions: list[FloatArray] = field(default_factory=list)


class AttachSimulation:
    """Simulates attachments through a take."""

    def __init__(
        self,
        rig: Rig,
        bodies: Sequence[AttachedBody],
        options: SimulateOptions,
        rate: Fraction,
        start: Fraction,
        step: Fraction,
        resumed: SavedFrame | None = None,
        early: int = 0,
        progress: Callable[[float], None] | None = None,
        world: Colliders | None = None,
    ) -> None:
        """Set up the simulation without reading the take.

        Frames are ``step`` time codes apart from ``start`` on. ``early`` frames before
        the take hold its first frame; a cycle has none. The take starts at world time
        0.
        """
        self._world = Colliders(()) if world is None else world
        self.rig, self.bodies, self.options = rig, bodies, options
        self.actors: list[Actor] = []  # one for each body, from the first frame on
        # Requested states, with the steps per frame.
        self.saved: dict[str, tuple[StateClock, ReachedState[AttachState]]] = {}
        self.codes: list[float] = []  # visited time codes
        self.resumed = resumed  # states to resume from
        self.closing: LoopClosure | None = None  # result of a cycle
        self._skins: list[SkinSurface] = []  # collision meshes of the character
        if any(self._collides_with_skins(body) for body in bodies):
            self._skins = skins_of(rig)
        self.swung: dict[str, float] = {}  # largest rotation of last joints [rad]
        self._rate, self._start, self._step = rate, start, step
        self._early = early
        # Index of the next frame; 0 is the first of the take.
        self._frame = 0 if options.loop else -early
        self._progress = progress
        self._crossed, self._to_cross = 0, 1
        self._before: LocalPose | None = None
        self._done = 0
        self._signs: dict[int, FloatArray] = {}

    def _collides_with_skins(self, body: AttachedBody) -> bool:
        """Return whether an attachment collides with the skins of the rig."""
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
        chain_joints = set(body.joints.tolist())
        for number, joint in enumerate(self.rig.joints):
            if joint.parent in chain_joints:
                chain_joints.add(number)
        return skins_of(self.rig, sorted(chain_joints))

    def blocks(self, motions: Iterator[Motion]) -> Iterator[Motion]:
        """Yield motions with simulated attachments."""
        if self.options.loop:
            motion, early = Motion.concatenate(list(motions)), self._early
            cycle = self._cycle(motion.select(slice(early, None)))
            yield cycle.select(np.maximum(np.arange(-early, cycle.frames), 0))
            return
        values = 3 * sum(body.network.count for body in self.bodies)
        block_frames = max(BLOCK_VALUES // max(values, 1), 2)
        for block in _first_block_of_two(motions):
            self._crossed, self._to_cross = 0, block.frames
            for begin in range(0, block.frames, block_frames):
                yield self._block(block.select(slice(begin, begin + block_frames)))

    def _block(self, block: Motion) -> Motion:
        codes = self._codes(self._done, block.frames)
        rows = [_Rows([], []) for _ in self.bodies]
        for i in range(block.frames):
            pose = pose_at(block, i)
            if self._before is None:
                self._begin(pose, pose_at(block, min(1, block.frames - 1)))
            else:
                self._advance(pose, float(codes[i]))
            self._before = pose
            self._note(float(codes[i]))
            for row, actor in zip(rows, self.actors, strict=True):
                surroundings = actor.surroundings()
                actor.measure(float(codes[i]), actor.positions, surroundings)
                row.moved.append(actor.positions)
                row.targets.append(actor.target)
        self._done += block.frames
        self.codes += codes.tolist()
        return self._blended(block, codes, rows)

    def _codes(self, first: int, count: int) -> FloatArray:
        return time_codes(self._start + first * self._step, self._step, count)

    def _begin(self, pose: LocalPose, next_pose: LocalPose) -> None:
        """Create the actors, settle them and advance to the first frame."""
        options, rate = self.options, float(self._rate)
        preroll_frames = math.ceil(options.preroll * rate)
        extrapolates = PreRoll(options.lead) is PreRoll.EXTRAPOLATE
        begin = pose
        if extrapolates:
            begin = extrapolated(self.rig, pose, next_pose, preroll_frames)
        self.actors = []
        for body in self.bodies:
            # Skinned points collide with cloth that is named before them.
            is_skinned = isinstance(body, SurfaceBody)
            sheets = [
                previous.sheet for previous in self.actors if previous.sheet is not None
            ]
            actor = Actor(
                self.rig,
                body,
                settings_for(options, body.kind),
                1 / rate,
                begin,
                self._skins_of(body),
                self._world,
                sheets if is_skinned else (),
            )
            self.actors.append(actor)
        if self.resumed is not None:
            return
        static = self._paths(begin, begin)
        settle_frames = math.ceil(options.settle * rate)
        self._frame -= settle_frames + preroll_frames
        self._to_cross += settle_frames + preroll_frames
        for _ in range(settle_frames):
            self._cross(static)
        root = self.rig.roots[0]
        step = next_pose.translations[root] - pose.translations[root]
        for i in range(preroll_frames):
            earlier, later = pose, pose
            if extrapolates:
                earlier, later = (
                    extrapolated(self.rig, pose, next_pose, preroll_frames - i - k)
                    for k in (0, 1)
                )
            if extrapolates and not i:
                for actor in self.actors:
                    actor.rush(step * rate)
            self._cross(self._paths(earlier, later))

    def _advance(self, pose: LocalPose, code: float) -> None:
        """Advance to the next frame."""
        assert self._before is not None
        paths = self._paths(self._before, pose)
        if self.resumed is not None and code <= self.resumed.frame:
            for actor in self.actors:
                actor.follow(paths)
            self._frame += 1
            return
        self._cross(paths, jumps=code in self.options.teleports)

    def _paths(self, before: LocalPose, after: LocalPose) -> PosePaths:
        return PosePaths(self.rig, before, after)

    def _cross(
        self,
        paths: PosePaths,
        steering: Sequence[CycleSteering] = (),
        *,
        jumps: bool = False,
    ) -> None:
        max_speed = self.options.teleport_speed
        for number, actor in enumerate(self.actors):
            if jumps or (max_speed and actor.speed(paths) > max_speed):
                actor.jump(paths)
            else:
                steered = steering[number] if steering else None
                actor.cross(paths, self._frame, steered)
            if self._progress is not None:
                self._crossed += 1
                total = self._to_cross * len(self.actors)
                self._progress(min(self._crossed / total, 1.0))
        self._frame += 1
        if not self.options.loop:
            # The next frame samples surfaces a little before its start.
            since = self._frame / float(self._rate) - LOOKBACK_TIME
            for bodies in self._world.bodies:
                bodies.forget(since)
            for sheet in self._world.sheets:
                sheet.motion.forget(since)

    def _note(self, code: float) -> None:
        """Load the resumed states at their frame; save requested ones."""
        if self.resumed is not None and code == self.resumed.frame:
            for actor in self.actors:
                resumed_state = self.resumed.states[actor.body.name]
                motion = np.stack([resumed_state.positions, resumed_state.velocities])
                actor.move(motion, resumed_state.passages)
        if code in self.options.save_at:
            for actor in self.actors:
                name, clock = saved_state(actor.body, code)
                spring_state = actor.grid.state
                state = AttachState(
                    spring_state.motion[0],
                    spring_state.motion[1],
                    spring_state.passages,
                )
                self.saved[name] = clock, ReachedState(actor.steps, state)

    def _cycle(self, motion: Motion) -> Motion:
        """Return a cycle whose attachments end as they start."""
        count = motion.frames
        poses = [pose_at(motion, i) for i in range(count)]
        if count == 1:
            travel = CycleShift(np.zeros(3), so3.IDENTITY)
        else:
            end_poses = (poses[0], poses[1], poses[-2], poses[-1])
            travel = travel_between(self.rig, upwards(self.rig), end_poses)
        poses.append(onward(self.rig, poses[0], travel))
        self._crossed, self._to_cross = 0, count * self.options.loop_repeats
        self._begin(poses[0], poses[1])
        tolerance = parse_length(self.options.loop_tolerance)
        rows, best, stale, most = list[_Rows](), math.inf, 0, self.options.loop_repeats
        for repeat in range(1, most + 1):
            firsts = [actor.positions for actor in self.actors]
            steered = bool(rows) and (repeat == most or stale >= MAX_STALE)
            rows = self._round(poses, rows if steered else [])
            end_states = [
                _moved_to_begin(actor.grid.state.motion, travel)
                for actor in self.actors
            ]
            gaps = [
                first - end[0] for first, end in zip(firsts, end_states, strict=True)
            ]
            residual = max(float(np.abs(gap).max(initial=0.0)) for gap in gaps)
            self.closing = LoopClosure(repeat, residual, tolerance, steered)
            if residual <= tolerance or steered:
                break
            best, stale = min(best, residual), 0 if residual < best else stale + 1
            for actor, end in zip(self.actors, end_states, strict=True):
                actor.move(end)
        weights = seam_weights(count)
        for row, gap, actor in zip(rows, gaps, self.actors, strict=True):
            # Points of steered cloth are each a little off, in directions of their own:
            # blended, its edges would be strained by that.
            if not (steered and len(actor.body.network.triangles)):
                off = so3.rotate(travel.rotation, gap)
                row.moved = [
                    moved + weight * off
                    for moved, weight in zip(row.moved, weights.tolist(), strict=True)
                ]
            actor.meter = ContactMeter()
            looks = zip(self.codes, row.moved, row.surroundings, strict=True)
            for code, points, surroundings in looks:
                actor.measure(code, points, surroundings)
        return self._blended(motion, self._codes(self._early, count), rows)

    def _round(self, poses: list[LocalPose], before: list[_Rows]) -> list[_Rows]:
        """Simulate a cycle once; return its frames except the last.

        With a cycle ``before`` it is steered to that one, which ended where it starts.
        """
        rows = [_Rows([], []) for _ in self.bodies]
        codes = self._codes(self._early, len(poses)).tolist()
        self.codes = codes[:-1]
        self._frame = 0
        for actor in self.actors:
            actor.set_target(poses[0])
        weights = np.append(seam_weights(len(poses) - 1, STEERED), 1.0)
        for i, (first, second) in enumerate(pairwise(poses)):
            for row, actor in zip(rows, self.actors, strict=True):
                row.surroundings.append(actor.surroundings())
                row.moved.append(actor.positions)
                row.motions.append(actor.grid.state.motion)
                row.targets.append(actor.target)
            steering = [
                CycleSteering(np.stack(row.motions[i : i + 2]), weights[i + 1])
                for row in before
            ]
            jumps = codes[i + 1] in self.options.teleports
            self._cross(self._paths(first, second), steering, jumps=jumps)
        for row, actor in zip(rows, self.actors, strict=True):
            row.motions.append(actor.grid.state.motion)
        return rows

    def _blended(self, block: Motion, codes: FloatArray, rows: list[_Rows]) -> Motion:
        """Return a motion with simulated values blended over animated ones."""
        options = self.options
        weights = weights_at(options.weight, codes, options.interpolation)
        if self.resumed is not None:
            weights = np.where(codes < self.resumed.frame, 0.0, weights)
        rotations = block.rotations.dense()
        for body, row in zip(self.bodies, rows, strict=True):
            moved, targets = np.stack(row.moved), np.stack(row.targets)
            if isinstance(body, ChainBody):
                simulated = self._blended_rotations(
                    rotations, body, moved, targets, weights
                )
                channel = block.rotations.put(body.joints, simulated)
                block = replace(block, rotations=channel)
            elif isinstance(body, SurfaceBody):
                block = _with_points(block, body.mesh.name, moved, targets, weights)
        return block

    def _blended_rotations(
        self,
        rotations: FloatArray,
        body: ChainBody,
        moved: FloatArray,
        targets: FloatArray,
        weights: FloatArray,
    ) -> FloatArray:
        """Return chain rotations that match simulated points ``(F, C, 4)``."""
        animated = rotations[:, body.joints]
        simulated = chain_rotations(self.rig, body.joints, rotations, targets, moved)
        interpolated = so3.slerp(animated, simulated, weights[:, None])
        blended = np.where((weights == 1)[:, None, None], simulated, interpolated)
        first = int(body.joints[0])
        reference = self._signs.get(first, animated[0])
        aligned = so3.align_signs(blended, reference)
        self._signs[first] = aligned[-1]
        last_angles = so3.angle_between(animated[:, -1], aligned[:, -1]) * (
            weights != 0
        )
        largest = max(
            self.swung.get(body.name, 0.0), float(last_angles.max(initial=0.0))
        )
        self.swung[body.name] = largest
        # With weight 0 keep the animation bit for bit.
        return np.where((weights == 0)[:, None, None], animated, aligned)


def _first_block_of_two(blocks: Iterator[Motion]) -> Iterator[Motion]:
    """Yield blocks, merging so that the first has two frames if possible."""
    pending: list[Motion] = []
    for block in blocks:
        pending.append(block)
        if sum(motion.frames for motion in pending) < 2:
            continue
        yield Motion.concatenate(pending) if len(pending) > 1 else pending[0]
        yield from blocks
        return
    if pending:
        yield Motion.concatenate(pending)


def _moved_to_begin(motion: FloatArray, travel: CycleShift) -> FloatArray:
    """Return the end state of a cycle moved back to its start."""
    rotation = so3.conjugate(travel.rotation)
    return rigidly_moved(motion, -so3.rotate(rotation, travel.shift), rotation)


def _with_points(
    block: Motion,
    name: str,
    points: FloatArray,
    targets: FloatArray,
    weights: FloatArray,
) -> Motion:
    """Return a motion with simulated points blended over animated ones."""
    values = points
    if (weights != 1).any():
        weight = weights[:, None, None]
        values = np.where(weight == 1, points, targets + weight * (points - targets))
        values = np.where(weight == 0, targets, values)
    channel = Channel(values[0].copy(), np.arange(values.shape[1]), values)
    return replace(block, points={**block.points, name: channel})
