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
    CycleShift,
    LocalPose,
    extrapolated,
    onward,
    pose_at,
    seam_weights,
    travel_between,
)
from animtool.systems.attach.settings import Lead, SimulateOptions, settings_for
from animtool.systems.attach.skins import SkinSurface, skins_of
from animtool.systems.attach.strands import chain_rotations
from animtool.systems.framework.meter import ContactMeter
from animtool.systems.framework.run import Reached
from animtool.systems.framework.saved import Clocked
from animtool.systems.framework.simulation import growing
from animtool.systems.springs.contacts import LOOK_BACK

# Most point values in a block: more points mean fewer frames.
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


def saved_state(body: AttachedBody, frame: float) -> tuple[str, Clocked]:
    """Return the name of a saved state in a file, and its clock."""
    return f"{frame!r}/{body.name}", Clocked(body.kind, frame, 1.0)


@dataclass(frozen=True, slots=True)
class Closing:
    """Result of closing a cycle."""

    repeats: int  # number of repeats
    residual: float  # last distance between end and begin [m]
    tolerance: float  # requested [m]


@dataclass(slots=True)
class _Rows:
    """Simulated and animated frames of one attachment."""

    moved: list[FloatArray]
    targets: list[FloatArray]
    # Of a cycle, which is measured once its seam is blended.
    surroundings: list[AttachedSurroundings] = field(default_factory=list)


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
        the take hold its first frame; a cycle has none. The take starts at 0 s of world
        time.
        """
        self._world = Colliders(()) if world is None else world
        self.rig, self.bodies, self.options = rig, bodies, options
        self.actors: list[Actor] = []  # one for each body, from the first frame on
        # Requested states, with the steps per frame.
        self.saved: dict[str, tuple[Clocked, Reached[AttachState]]] = {}
        self.codes: list[float] = []  # visited time codes
        self.resumed = resumed  # states to resume from
        self.closing: Closing | None = None  # result of a cycle
        self._skins: list[SkinSurface] = []  # collision meshes of the character
        if any(self._meets_skins(body) for body in bodies):
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

    def _meets_skins(self, body: AttachedBody) -> bool:
        """Return whether an attachment collides with the skins of the rig."""
        if self.options.skin is None:
            return body.kind == AttachKind.CLOTH
        return self.options.skin

    def _skins_of(self, body: AttachedBody) -> Sequence[SkinSurface]:
        """Return the collision meshes of an attachment.

        Those of a chain have no faces that it moves.
        """
        if not self._meets_skins(body):
            return ()
        if not isinstance(body, ChainBody):
            return self._skins
        moving = set(body.joints.tolist())
        for number, joint in enumerate(self.rig.joints):
            if joint.parent in moving:
                moving.add(number)
        return skins_of(self.rig, sorted(moving))

    def blocks(self, motions: Iterator[Motion]) -> Iterator[Motion]:
        """Yield motions with simulated attachments."""
        if self.options.loop:
            motion, early = Motion.concatenate(list(motions)), self._early
            cycle = self._cycle(motion.select(slice(early, None)))
            yield cycle.select(np.maximum(np.arange(-early, cycle.frames), 0))
            return
        values = 3 * sum(body.network.count for body in self.bodies)
        most = max(BLOCK_VALUES // max(values, 1), 2)
        for block in _begun(motions):
            self._crossed, self._to_cross = 0, block.frames
            for begin in range(0, block.frames, most):
                yield self._block(block.select(slice(begin, begin + most)))

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
                around = actor.surroundings()
                actor.measure(float(codes[i]), actor.positions, around)
                row.moved.append(actor.positions)
                row.targets.append(actor.target)
        self._done += block.frames
        self.codes += codes.tolist()
        return self._moved(block, codes, rows)

    def _codes(self, first: int, count: int) -> FloatArray:
        return time_codes(self._start + first * self._step, self._step, count)

    def _begin(self, pose: LocalPose, following: LocalPose) -> None:
        """Create the actors, settle them and advance to the first frame."""
        options, rate = self.options, float(self._rate)
        leading = math.ceil(options.preroll * rate)
        travels = Lead(options.lead) is Lead.EXTRAPOLATE
        begin = pose
        if travels:
            begin = extrapolated(self.rig, pose, following, leading)
        self.actors = []
        for body in self.bodies:
            # Skinned points collide with cloth that is named before them.
            skinned = isinstance(body, SurfaceBody)
            sheets = [one.sheet for one in self.actors if one.sheet is not None]
            actor = Actor(
                self.rig,
                body,
                settings_for(options, body.kind),
                1 / rate,
                begin,
                self._skins_of(body),
                self._world,
                sheets if skinned else (),
            )
            self.actors.append(actor)
        if self.resumed is not None:
            return
        static = self._paths(begin, begin)
        settling = math.ceil(options.settle * rate)
        self._frame -= settling + leading
        self._to_cross += settling + leading
        for _ in range(settling):
            self._cross(static)
        root = self.rig.roots[0]
        step = following.translations[root] - pose.translations[root]
        for i in range(leading):
            earlier, later = pose, pose
            if travels:
                earlier, later = (
                    extrapolated(self.rig, pose, following, leading - i - k)
                    for k in (0, 1)
                )
            if travels and not i:
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

    def _cross(self, paths: PosePaths, *, jumps: bool = False) -> None:
        most = self.options.teleport_speed
        for actor in self.actors:
            if jumps or (most and actor.speed(paths) > most):
                actor.jump(paths)
            else:
                actor.cross(paths, self._frame)
            if self._progress is not None:
                self._crossed += 1
                total = self._to_cross * len(self.actors)
                self._progress(min(self._crossed / total, 1.0))
        self._frame += 1
        if not self.options.loop:
            # The next frame samples surfaces a little before its begin.
            since = self._frame / float(self._rate) - LOOK_BACK
            for bodies in self._world.bodies:
                bodies.forget(since)
            for sheet in self._world.sheets:
                sheet.motion.forget(since)

    def _note(self, code: float) -> None:
        """Load the resumed states at their frame; save requested ones."""
        if self.resumed is not None and code == self.resumed.frame:
            for actor in self.actors:
                saved = self.resumed.states[actor.body.name]
                motion = np.stack([saved.positions, saved.velocities])
                actor.move(motion, saved.passages)
        if code in self.options.save_at:
            for actor in self.actors:
                name, clocked = saved_state(actor.body, code)
                now = actor.grid.state
                state = AttachState(now.motion[0], now.motion[1], now.passages)
                self.saved[name] = clocked, Reached(actor.steps, state)

    def _cycle(self, motion: Motion) -> Motion:
        """Return a cycle whose attachments end as they start."""
        count = motion.frames
        poses = [pose_at(motion, i) for i in range(count)]
        if count == 1:
            travel = CycleShift(np.zeros(3), so3.IDENTITY)
        else:
            four = (poses[0], poses[1], poses[-2], poses[-1])
            travel = travel_between(self.rig, upwards(self.rig), four)
        poses.append(onward(self.rig, poses[0], travel))
        self._crossed, self._to_cross = 0, count * self.options.loop_repeats
        self._begin(poses[0], poses[1])
        tolerance = parse_length(self.options.loop_tolerance)
        for repeat in range(1, self.options.loop_repeats + 1):
            firsts = [actor.positions for actor in self.actors]
            rows = self._round(poses)
            back = [_back(actor.grid.state.motion, travel) for actor in self.actors]
            left = [first - end[0] for first, end in zip(firsts, back, strict=True)]
            residual = max(float(np.abs(one).max(initial=0.0)) for one in left)
            self.closing = Closing(repeat, residual, tolerance)
            if residual <= tolerance:
                break
            for actor, end in zip(self.actors, back, strict=True):
                actor.move(end)
        weights = seam_weights(count)
        for row, one, actor in zip(rows, left, self.actors, strict=True):
            off = so3.rotate(travel.rotation, one)
            row.moved = [
                moved + weight * off
                for moved, weight in zip(row.moved, weights.tolist(), strict=True)
            ]
            actor.meter = ContactMeter()
            looks = zip(self.codes, row.moved, row.surroundings, strict=True)
            for code, points, around in looks:
                actor.measure(code, points, around)
        return self._moved(motion, self._codes(self._early, count), rows)

    def _round(self, poses: list[LocalPose]) -> list[_Rows]:
        """Simulate a cycle once; return its frames except the last."""
        rows = [_Rows([], []) for _ in self.bodies]
        codes = self._codes(self._early, len(poses)).tolist()
        self.codes = codes[:-1]
        self._frame = 0
        for actor in self.actors:
            actor.set_target(poses[0])
        for i, (before, after) in enumerate(pairwise(poses)):
            for row, actor in zip(rows, self.actors, strict=True):
                row.surroundings.append(actor.surroundings())
                row.moved.append(actor.positions)
                row.targets.append(actor.target)
            jumps = codes[i + 1] in self.options.teleports
            self._cross(self._paths(before, after), jumps=jumps)
        return rows

    def _moved(self, block: Motion, codes: FloatArray, rows: list[_Rows]) -> Motion:
        """Return a motion with simulated values blended over animated ones."""
        options = self.options
        weights = weights_at(options.weight, codes, options.interpolation)
        if self.resumed is not None:
            weights = np.where(codes < self.resumed.frame, 0.0, weights)
        rotations = block.rotations.dense()
        for body, row in zip(self.bodies, rows, strict=True):
            moved, targets = np.stack(row.moved), np.stack(row.targets)
            if isinstance(body, ChainBody):
                turned = self._turned(rotations, body, moved, targets, weights)
                put = block.rotations.put(body.joints, turned)
                block = replace(block, rotations=put)
            elif isinstance(body, SurfaceBody):
                block = _pointed(block, body.mesh.name, moved, targets, weights)
        return block

    def _turned(
        self,
        rotations: FloatArray,
        body: ChainBody,
        moved: FloatArray,
        targets: FloatArray,
        weights: FloatArray,
    ) -> FloatArray:
        """Return chain rotations that match simulated points ``(F, C, 4)``."""
        animated = rotations[:, body.joints]
        turned = chain_rotations(self.rig, body.joints, rotations, targets, moved)
        mixed = so3.slerp(animated, turned, weights[:, None])
        blended = np.where((weights == 1)[:, None, None], turned, mixed)
        first = int(body.joints[0])
        before = self._signs.get(first, animated[0])
        aligned = so3.align_signs(blended, before)
        self._signs[first] = aligned[-1]
        last = so3.angle_between(animated[:, -1], aligned[:, -1]) * (weights != 0)
        most = max(self.swung.get(body.name, 0.0), float(last.max(initial=0.0)))
        self.swung[body.name] = most
        # With weight 0 keep the animation bit for bit.
        return np.where((weights == 0)[:, None, None], animated, aligned)


def _begun(blocks: Iterator[Motion]) -> Iterator[Motion]:
    """Yield blocks, merging so that the first has two frames if possible."""
    early: list[Motion] = []
    for block in blocks:
        early.append(block)
        if sum(one.frames for one in early) < 2:
            continue
        yield Motion.concatenate(early) if len(early) > 1 else early[0]
        yield from blocks
        return
    if early:
        yield Motion.concatenate(early)


def _back(motion: FloatArray, travel: CycleShift) -> FloatArray:
    """Return the end state of a cycle moved back to its begin."""
    rotation = so3.conjugate(travel.rotation)
    return rigidly_moved(motion, -so3.rotate(rotation, travel.shift), rotation)


def _pointed(
    block: Motion,
    name: str,
    moved: FloatArray,
    targets: FloatArray,
    weights: FloatArray,
) -> Motion:
    """Return a motion with simulated points blended over animated ones."""
    values = moved
    if (weights != 1).any():
        weight = weights[:, None, None]
        values = np.where(weight == 1, moved, targets + weight * (moved - targets))
        values = np.where(weight == 0, targets, values)
    channel = Channel(values[0].copy(), np.arange(values.shape[1]), values)
    return replace(block, points={**block.points, name: channel})
