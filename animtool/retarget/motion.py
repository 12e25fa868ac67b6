"""Takes of one skeleton as takes of another.

A take is gone through twice, so that a long one is never held whole: where its feet
stand depends on all of it, and needs little of each frame; the joints follow then.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.errors import Fault
from animtool.core.files.spool import Spool
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.motion.driving import driven_take
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.retarget.feet import Foot, Placed, place_feet
from animtool.retarget.hands import ArmTracks, Floor, arm_of, place_hands
from animtool.retarget.legs import (
    LegTracks,
    ball_of_foot,
    leg_of,
    put_ankle,
    up_index,
)
from animtool.retarget.legs_in_limits import within_limits
from animtool.retarget.map import JointMap
from animtool.retarget.person import Person
from animtool.retarget.poses import (
    LocalTurns,
    about_hips,
    hinged,
    local_turns,
    root_places,
    share_twist,
    world_turns,
)
from animtool.retarget.props import Props
from animtool.retarget.report import FitMeter, RetargetReport, Standing
from animtool.retarget.transfer import Transfer
from animtool.retarget.verdict import Verdict
from animtool.rig.kinematics import WorldTransforms, forward
from animtool.rig.skeleton import Rig

# Frames of a block: its arrays stay in the processor's cache. Blocks begin at the first
# frame of a take, however it arrives.
BLOCK = 1024
# How often an ankle gives way at most, and what is left of it then, over the size of
# the skeleton: each time leaves about a tenth.
TRIES, GIVEN = 5, 1e-5
# What moves by less than this share of the skeleton, or turns by about its root, in
# radians, does not move [1].
STILL = 1e-6
# Numbers that differ by less are one but for rounding [1], [m].
ROUNDING = 1e-13


@dataclass(frozen=True, slots=True)
class _Posed:
    """Frames of the target before its feet are placed."""

    source: FloatArray  # the source's joints, in the target's axes (F, J, 3) [m]
    # Balls of its feet, or their ankles, in these axes (F, L, 3) [m].
    balls: FloatArray
    turns: LocalTurns
    bones: FloatArray  # local translations (F or 1, K, 3) [m]
    about: FloatArray  # joints about the middle of the hips (F, K, 3) [m]
    hips: FloatArray  # that middle (F, 3) [m]


class Retargeting:
    """A take on its way to another rig.

    Attributes:
        transfer: How the rig follows.
        standing: Which feet stand, and when.
        clamped: Joints that their limits held, in shares of the frames so far.
        moving: Joints of the source that move.
        longest: How far its joints get from their parents, at most ``(J,)`` [m].
        forced: Errors that are passed over on request.
    """

    def __init__(
        self,
        transfer: Transfer,
        found: JointMap,
        motions: Iterable[Motion],
        fps: float,
        *,
        lock: bool = True,
        same: bool = False,
        hands: bool = False,
        props: Props | None = None,
    ) -> None:
        """Go through a take for the first time.

        Args:
            transfer: How the rig follows.
            found: Which joints follow which.
            motions: Of the source, block by block.
            fps: Frames a second.
            lock: Whether feet stay where they stand.
            same: Whether they do so on legs like those of the source, too; else such
                legs move as the source's.
            hands: Whether hands keep their contacts.
            props: Tracks of the take that they may hold.
        """
        self.transfer, self._moves = transfer, False
        # Errors that were passed over on request.
        self.forced: list[Fault] = []
        self._start: tuple[FloatArray, FloatArray] | None = None
        # Joints of the source that move.
        self.moving: set[int] = set()
        # How far its joints get from their parents, at most (J,) [m].
        self.longest: FloatArray = np.zeros(len(transfer.source.rig.joints))
        self._spool = Spool()
        self._stopped: list[dict[int, BoolArray]] = []
        legs = "".join(
            side
            for side in "lr"
            if transfer.target.leg(side) and transfer.source.leg(side)
        )
        arms = "".join(
            side
            for side in "lr"
            if hands and arm_of(transfer.target, side) and arm_of(transfer.source, side)
        )
        tracks, reaches = self._tracks(motions, legs, arms)
        feet = [
            one.foot(transfer, side, fps)
            for one, side in zip(tracks, legs, strict=True)
        ]
        placed = None
        if legs and lock and (same or not transfer.alike):
            placed = self._place_feet(legs, tracks, feet, fps)
        floor = _floor(transfer, feet, placed=placed is not None)
        held = place_hands(
            transfer,
            arms,
            reaches,
            self._hips,
            floor,
            fps,
            props.motions(transfer) if props is not None and arms else (),
        )
        # How far props that hands hold are lifted (3,) [m].
        self.lift = Floor.lift(floor, transfer.scale, up_index(transfer.target.rig))
        contacts = tuple(foot.contacts for foot in feet)
        self.standing = Standing(legs, contacts, placed, held)
        self._meter = FitMeter(transfer, found, self.standing)
        self._held: dict[int, int] = {}
        self._frames = 0

    def _tracks(
        self, motions: Iterable[Motion], legs: str, arms: str
    ) -> tuple[list[LegTracks], list[ArmTracks]]:
        """Go through a take; return what is needed of the legs and arms of sides."""
        transfer = self.transfer
        tracks: list[list[LegTracks]] = []
        reaches: list[list[ArmTracks]] = []
        hips = []
        for motion in in_blocks(motions, BLOCK):
            moving = len(motion.rotations.animated) + len(motion.translations.animated)
            self._moves |= moving > 0
            self._note_moving(motion)
            posed = self._posed(motion, legs)
            turns = posed.turns
            parts = posed.source, turns.world, posed.about
            tracks.append(
                [
                    LegTracks.of(
                        transfer, side, parts[0], posed.balls[:, k], *parts[1:]
                    )
                    for k, side in enumerate(legs)
                ]
            )
            reaches.append([ArmTracks.of(transfer, side, *parts) for side in arms])
            hips.append(posed.hips)
            kept = [turns.local, turns.world, posed.bones, posed.about, posed.balls]
            self._spool.append([posed.source, *kept])
            self._stopped.append(turns.held)
        self._hips = np.concatenate(hips)
        return (
            [joined([each[k] for each in tracks]) for k in range(len(legs))],
            [joined([each[k] for each in reaches]) for k in range(len(arms))],
        )

    def _note_moving(self, motion: Motion) -> None:
        """Take the joints that leave where they are in the first frame."""
        values = motion.translations.dense(), motion.rotations.dense()
        if self._start is None:
            self._start = values[0][0].copy(), values[1][0].copy()
        longest = np.linalg.norm(values[0], axis=2).max(axis=0)
        self.longest = np.maximum(self.longest, longest)
        far = np.abs(values[0] - self._start[0]).max(axis=(0, 2))
        same = np.abs((values[1] * self._start[1]).sum(axis=2)).min(axis=0)
        moves = (far > STILL * self.transfer.source.size) | (same < 1 - STILL)
        self.moving.update(np.flatnonzero(moves).tolist())

    def _place_feet(
        self,
        legs: str,
        tracks: Sequence[LegTracks],
        feet: Sequence[Foot],
        fps: float,
    ) -> Placed:
        """Return feet that stay where they stand; hips and legs reach them."""
        transfer = self.transfer
        up = up_index(transfer.target.rig)
        # The ground of the source, scaled, is that of the target.
        off = [foot.height - transfer.scale * foot.contacts.ground for foot in feet]
        self._hips[:, up] += float(np.mean(off))
        placed = place_feet(self._hips, feet, fps, up)
        self._hips, self._swivels = within_limits(
            transfer.target, legs, tracks, placed, fps
        )
        return placed

    def _posed(self, motion: Motion, legs: str) -> _Posed:
        """Return frames of the target whose joints follow those of the source."""
        transfer = self.transfer
        source, target = transfer.source, transfer.target
        local = motion.translations.dense(), motion.rotations.dense()
        places = forward(source.rig, *local).positions
        world = world_turns(source.rig, local[1])
        turns = hinged(transfer, transfer.turns(world))
        made = local_turns(transfer, turns)
        bones = transfer.bones(world, local[0], made.world)
        about = about_hips(target, made.world, bones, limbs_of(target))
        hips = transfer.hips(places)
        balls = np.zeros((len(places), len(legs), 3))
        for k, side in enumerate(legs):
            balls[:, k] = ball_of_foot(source, side, places, world)
        parts = transfer.turned(places), transfer.turned(balls)
        return _Posed(*parts, made, bones, about, hips)

    @property
    def clamped(self) -> Mapping[int, float]:
        """Joints that their limits held, in shares of the frames so far."""
        return {j: count / self._frames for j, count in self._held.items()}

    def report(self) -> RetargetReport:
        """Return how well the frames so far fit."""
        return self._meter.report(self.clamped)

    def verdict(self) -> Verdict:
        """Return whether the frames so far can be used."""
        return self._meter.verdict(self.clamped, self.forced)

    def blocks(self) -> Iterator[Motion]:
        """Yield the motion of the target; to be called once."""
        rig = self.transfer.target.rig
        first: tuple[FloatArray, FloatArray] | None = None
        signs: FloatArray | None = None
        twists: FloatArray | None = None
        for held, arrays in zip(self._stopped, self._spool.drain(), strict=True):
            begin, count = self._frames, len(arrays[0])
            hips = self._hips[begin : begin + count]
            source, local, world, bones, about, balls = arrays
            turns = LocalTurns(local, world, held)
            turns = self._with_legs(turns, hips, about, begin)
            turns = self._with_arms(turns, begin)
            self._frames += count
            for j, many in turns.held.items():
                self._held[j] = self._held.get(j, 0) + int(many.sum())
            local = turns.local
            twists = share_twist(self.transfer, local, twists)
            root, way = root_places(
                self.transfer.target, hips, turns.world, bones, about
            )
            places = np.broadcast_to(bones, (count, *bones.shape[1:])).copy()
            places[:, root] = way
            local = so3.align_signs(local, signs)
            signs = local[-1]
            first = (places[0].copy(), local[0].copy()) if first is None else first
            # What moves by rounding alone does not move.
            for values, start in zip((places, local), first, strict=True):
                still = np.abs(values - start) < ROUNDING
                np.copyto(values, start, where=still)
            self._meter.add(begin, forward(rig, places, local), source, balls)
            yield Motion(
                self._channel(places, first[0]), self._channel(local, first[1])
            )

    def _channel(self, values: FloatArray, first: FloatArray) -> Channel:
        """Return a channel whose joints all move, if any joint of the source does."""
        if not self._moves:
            return Channel.static(first, len(values))
        return Channel(first, np.arange(values.shape[1]), values)

    def _with_legs(
        self, turns: LocalTurns, hips: FloatArray, about: FloatArray, begin: int
    ) -> LocalTurns:
        """Return turns with legs that bring the feet to where they are placed."""
        target, placed = self.transfer.target, self.standing.placed
        if placed is None:
            return turns
        legs = [leg_of(target, side) for side in self.standing.sides]
        goals = [ankle[begin : begin + len(hips)].copy() for ankle in placed.ankles]
        rows = np.arange(len(hips))
        made = self._solved(turns, hips, about, goals, rows + begin)
        for _ in range(TRIES - 1):
            # Where a limit stops the foot, the ankle gives way for the toe.
            most = np.zeros(len(rows))
            at = rows + begin
            for k, (_, _, foot, _) in enumerate(legs):
                ball = target.balls.get(self.standing.sides[k])
                if foot not in made.held or ball is None:
                    continue
                bone = ball.offset
                if ball.joint >= 0:
                    back = so3.conjugate(turns.world[rows, foot])
                    tip = about[rows, ball.joint] - about[rows, foot]
                    bone = so3.rotate(back, tip)
                wanted, actual = placed.turns[k][at], made.world[rows, foot]
                off = so3.rotate(wanted, bone) - so3.rotate(actual, bone)
                goal = placed.ankles[k][at] + placed.rolls[k][at, None] * off
                most = np.maximum(most, np.abs(goal - goals[k][rows]).max(axis=1))
                goals[k][rows] = goal
            rows = rows[most > GIVEN * target.size]
            if not len(rows):
                break
            nearer = [goal[rows] for goal in goals]
            again = self._solved(
                turns.rows(rows), hips[rows], about[rows], nearer, rows + begin
            )
            made.put(rows, again)
        return made

    def _solved(
        self,
        turns: LocalTurns,
        hips: FloatArray,
        about: FloatArray,
        goals: Sequence[FloatArray],
        frames: IntArray,
    ) -> LocalTurns:
        """Return turns with legs whose ankles are at goals, and feet as they stand."""
        target, placed = self.transfer.target, self.standing.placed
        assert placed is not None
        world = turns.world.copy()
        changed: set[int] = set()
        for k, side in enumerate(self.standing.sides):
            leg = leg_of(target, side)
            joints = hips[:, None] + about[:, leg[:3]]
            both = world[:, leg[0]], world[:, leg[1]]
            world[:, leg[0]], world[:, leg[1]] = put_ankle(
                target, side, joints, goals[k], both, self._swivels[k][frames]
            )
            world[:, leg[2]] = placed.turns[k][frames]
            changed.update(leg[:3])
        return local_turns(self.transfer, world, turns, changed)

    def _with_arms(self, turns: LocalTurns, begin: int) -> LocalTurns:
        """Return turns with arms that bring the hands to what they hold."""
        changed: set[int] = set()
        part, world = slice(begin, begin + len(turns.world)), turns.world.copy()
        for hand in self.standing.hands:
            arm = arm_of(self.transfer.target, hand.side)
            bends = hand.bends[part]
            if arm is None or not bends.any():
                continue
            world[:, arm[:2]] = so3.multiply(so3.exp(bends), world[:, arm[:2]])
            changed.update(arm[:2])
        if not changed:
            return turns
        return local_turns(self.transfer, world, turns, changed)


def _floor(transfer: Transfer, feet: Sequence[Foot], *, placed: bool) -> Floor | None:
    """Return how high ankles stand where feet are placed, or not; None without feet."""
    if not feet:
        return None
    ground = float(np.mean([foot.contacts.ground for foot in feet]))
    high = float(np.mean([foot.height for foot in feet]))
    return Floor(ground, high if placed else transfer.scale * ground)


Tracks = TypeVar("Tracks", LegTracks, ArmTracks)


def joined(parts: list[Tracks]) -> Tracks:
    """Return the tracks of consecutive frames as one."""
    names = parts[0].__dataclass_fields__
    arrays = (np.concatenate([getattr(one, name) for one in parts]) for name in names)
    return type(parts[0])(*arrays)


def in_blocks(motions: Iterable[Motion], size: int) -> Iterator[Motion]:
    """Yield a motion in blocks of a size [frames], the last of what is left."""
    held: list[Motion] = []
    count = 0
    for motion in motions:
        begin = 0
        while begin < motion.frames:
            end = min(begin + size - count, motion.frames)
            held.append(motion.select(slice(begin, end)))
            count += end - begin
            begin = end
            if count == size:
                yield Motion.concatenate(held)
                held, count = [], 0
    if held:
        yield Motion.concatenate(held)


@dataclass(frozen=True, slots=True)
class Retargeted:
    """A take on another rig, and what became of it."""

    take: Take
    transfer: Transfer
    standing: Standing
    report: RetargetReport

    @property
    def world(self) -> WorldTransforms:
        """Where the joints of the target are."""
        return self.take.world()


def limbs_of(person: Person) -> set[int]:
    """Return the joints that say where hips, legs and arms are."""
    found = {max(person.first("hips"), 0)}
    for side in "lr":
        found.update(person.leg(side) or (), arm_of(person, side) or ())
        found.add(person.first(f"thigh_{side}"))
    return {joint for joint in found if joint >= 0}


def transfer_of(
    source: Rig,
    target: Rig,
    found: JointMap,
    rest: FloatArray | None = None,
    *,
    as_rig: bool = False,
) -> Transfer:
    """Return how a rig follows another one.

    Args:
        source: The rig of the takes.
        target: The rig that they go onto.
        found: Which joints follow which.
        rest: Local turns of the source's joints in its rest pose ``(J, 4)``; None is
            that of its rig.
        as_rig: Whether the source rests as the target does, whatever its bones say.
    """
    ours = Person.of(source, found.source.roles, rest)
    theirs = Person.of(target, found.target.roles)
    return Transfer.of(ours, theirs, found, as_rig=as_rig)


def retarget_take(
    take: Take,
    rig: Rig,
    found: JointMap,
    *,
    rest: FloatArray | None = None,
    lock: bool = True,
    hands: bool = False,
) -> Retargeted:
    """Return a take on another rig.

    Args:
        take: The source.
        rig: The target.
        found: Which joints follow which.
        rest: Local turns of the source's joints in its rest pose ``(J, 4)``; None is
            that of its rig.
        lock: Whether feet stay where they stand.
        hands: Whether hands keep their contacts.
    """
    transfer = transfer_of(take.rig, rig, found, rest)
    fps = float(take.clock.rate)
    going = Retargeting(transfer, found, [take.motion], fps, lock=lock, hands=hands)
    motion = Motion.concatenate(list(going.blocks())).map(Channel.compact)
    after = driven_take(replace(take, rig=rig, motion=motion))
    return Retargeted(after, transfer, going.standing, going.report())
