"""What a targets file asks for over the frames of a take, and the way there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.clock import MAX_FRAMES, Clock
from animtool.core.errors import Fault, OptionError, counted
from animtool.core.rates import rate_label
from animtool.core.record import dataclass
from animtool.ik.goals import KINDS, Goal, GoalKind, Targets, TargetValue
from animtool.ik.limbs import limb_joints
from animtool.ik.two_bone import bend
from animtool.ik.values import (
    Frames,
    Keyed,
    Rows,
    Span,
    Value,
    between,
    held,
    hold_shares,
    smoothstep,
)
from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.parts import IkChain
from animtool.rig.skeleton import JointType, Rig

# Shorter than this share of what it points along, a direction is unknown.
UNKNOWN = 1e-6
# Limbs that bend by less than the first of these are straight, and those that bend by
# more than the second are not [rad].
STRAIGHT, BENT = np.radians([5.0, 20.0])
# Frames a second where nothing says.
USUAL_RATE = Fraction(24)


@dataclass(frozen=True, slots=True)
class FreeEffector:
    """Where an effector is without its goal."""

    rig: Rig  # J joints
    goal: Goal  # the effector, its point and axis
    world: WorldTransforms  # of the joints without the goal, F frames

    def place(self) -> FloatArray:
        """Return where its point is ``(F, 3)`` [m]."""
        j = self.rig.index(self.goal.joint)
        offset = self.world.linear[:, j] @ np.array(self.goal.offset)
        return np.asarray(self.world.positions[:, j] + offset)

    def turn(self) -> FloatArray:
        """Return how its joint is turned ``(F, 4)``."""
        linear = self.world.linear[:, self.rig.index(self.goal.joint)]
        return so3.align_signs(so3.split_scale(linear)[0])

    def towards(
        self, kind: GoalKind, values: FloatArray, shares: FloatArray
    ) -> FloatArray:
        """Return targets on the way from where it is to where they are to be.

        Points go straight, rotations by the shortest arc; points that an axis or a
        limb's middle is to point at go about the effector or the limb's root. Points at
        the end of a straight limb go about its root too, as far off as a limb is that
        bends evenly: on the straight way its first degrees would take no time.

        ``values``: the targets, points ``(F, 3)`` or rotations ``(F, 4)``; ``shares``
        ``(F,)``.
        """
        out = values.copy()
        rows = (shares > 0) & (shares < 1)
        share = shares[rows]
        if not len(share):
            return out
        if kind.value is TargetValue.ROTATION:
            out[rows] = so3.slerp(self.turn()[rows], values[rows], share)
            return so3.align_signs(out)
        if not kind.directed:
            out[rows] = self._reaching(values, rows, share)
            return out
        origins, directions = self._axis() if kind.turning else self._bend(values)
        away = values[rows] - origins[rows]
        out[rows] = origins[rows] + swung(directions[rows], away, share)
        return out

    def _reaching(
        self, values: FloatArray, rows: BoolArray, share: FloatArray
    ) -> FloatArray:
        """Return positions on the way in some rows ``(N, 3)``."""
        here, there = self.place()[rows], values[rows]
        straight = here + share[:, None] * (there - here)
        limb = self._limb()
        if limb is None or not self._is_whole(limb[0]):
            return np.asarray(straight)
        root, middle = (self.world.positions[rows, j] for j in limb)
        a, b, reach, rotation = (
            np.linalg.norm(way, axis=1)
            for way in (middle - root, here - middle, here - root, there - root)
        )
        bends = bend(a, b, reach), bend(a, b, rotation)
        angle = bends[0] + share * (bends[1] - bends[0])
        away = np.sqrt(np.maximum(a**2 + b**2 + 2 * a * b * np.cos(angle), 0.0))
        away += share * np.maximum(rotation - (a + b), 0.0)
        known = (rotation > UNKNOWN * (a + b))[:, None]
        ends = np.where(known, there - root, here - root)
        way = swung(here - root, ends, share)
        size = np.maximum(np.linalg.norm(way, axis=1), 1e-300)
        bent = smoothstep((bends[0] - STRAIGHT) / (BENT - STRAIGHT))
        about = root + way * (away / size)[:, None]
        return np.asarray(about + bent[:, None] * (straight - about))

    def _limb(self) -> tuple[int, int] | None:
        """Return the joints at the root and in the middle of the limb."""
        moving = {
            j
            for j, joint in enumerate(self.rig.joints)
            if joint.type is not JointType.FIXED
        }
        origins, point = self.world.positions[0], self.place()[0]
        return limb_joints(self.rig, self.goal, moving, origins, point)

    def _is_whole(self, root: int) -> bool:
        """Whether no joint above a limb's root moves for its goal."""
        if self.goal.root is not None:
            return True
        above = self.rig.joints[root].parent
        while above >= 0 and self.rig.joints[above].type is JointType.FIXED:
            above = self.rig.joints[above].parent
        return above < 0

    def _axis(self) -> tuple[FloatArray, FloatArray]:
        """Return where the aiming axis begins and points ``(F, 3)``."""
        return self.place(), so3.rotate(self.turn(), np.array(self.goal.aim_axis))

    def _bend(self, poles: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the limb's root, and how its middle stands off ``(F, 3)``.

        A straight limb has no such direction; it is taken to bend towards its poles.
        """
        point = self.place()
        limb = self._limb()
        if limb is None:
            return point, poles - point
        root, middle = (self.world.positions[:, j] for j in limb)
        along, bone = point - root, middle - root
        square = np.maximum((along**2).sum(axis=1, keepdims=True), 1e-300)
        off = bone - (bone * along).sum(axis=1, keepdims=True) / square * along
        bent = np.linalg.norm(off, axis=1) > UNKNOWN * np.linalg.norm(bone, axis=1)
        return root, np.where(bent[:, None], off, poles - root)


def swung(start: FloatArray, end: FloatArray, share: FloatArray) -> FloatArray:
    """Return vectors ``(F, 3)`` as long as the end, turned from the start towards it.

    ``start`` ``(F, 3)``, not 0, ``end`` ``(F, 3)``, ``share`` of the angle ``(F,)``.

    >>> swung(np.eye(3)[:1], 2 * np.eye(3)[1:2], np.array([0.5])).round(6).tolist()
    [[1.414214, 1.414214, 0.0]]
    """
    length = np.linalg.norm(end, axis=1, keepdims=True)
    unit = start / np.maximum(np.linalg.norm(start, axis=1, keepdims=True), 1e-300)
    axis = np.cross(unit, end)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine[:, 0], (unit * end).sum(axis=1))
    # Directions that are opposite turn about any axis across them.
    spare = np.cross(unit, np.eye(3)[np.abs(unit).argmin(axis=1)])
    axis = np.where(sine > UNKNOWN * length, axis, spare)
    axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    turn = so3.from_axis_angle(axis, share * angle)
    return np.asarray(length * so3.rotate(turn, unit))


@dataclass(frozen=True)
class GoalTrack:
    """A goal, and where it is over frames."""

    name: str  # the effector, as the file has it
    goal: Goal  # what is asked at most
    chain: IkChain | None  # the chain of the rig whose tip it is; None of a plain joint
    # By part; None for what is not asked, or only held.
    values: Mapping[str, Value | None]
    weights: Mapping[str, Value]  # by part; 1 for those that are left out
    spans: tuple[Span, ...]  # held frames, ascending
    ease: float  # [frame] before and behind each span, held or asked
    held: frozenset[str]  # the parts that the spans hold
    # Line and column in the file; its first where none has it.
    place: tuple[int, int] = (1, 1)
    # Frames in which anything is asked, ascending; none is all.
    during: tuple[Span, ...] = ()

    @property
    def parts(self) -> list[str]:
        """What has a value."""
        return [part for part, value in self.values.items() if value is not None]


@dataclass(frozen=True)
class TargetTracks:
    """The goals of a targets file.

    Attributes:
        path: The file.
        fps: Frames a second; None where it does not say.
        first: First frame; None where it does not say.
        last: Last frame, likewise.
        goals: E of them.
        notices: What is odd about the file.
        rate_place: Line and column of its frames a second.
    """

    path: Path
    fps: Fraction | None
    first: Fraction | None
    last: Fraction | None
    goals: tuple[GoalTrack, ...]
    notices: tuple[Fault, ...] = ()
    rate_place: tuple[int, int] = (1, 1)

    @property
    def clock(self) -> Clock:
        """The frames that the file is about: its range, else all that it mentions.

        Raises:
            OptionError: There are more than 10 million (CLIP006).
        """
        first, last = self.first, self.last
        if first is None or last is None:
            ends = [end for goal in self.goals for end in _ends(goal)] or [1.0]
            first, last = Fraction(min(ends)), Fraction(max(ends))
        count = int((last - first) // 1) + 1
        if count > MAX_FRAMES:
            message = f"the range has {count} frames; the limit is {MAX_FRAMES}"
            raise OptionError(Fault("CLIP006", message, str(self.path)))
        return Clock(self.fps or USUAL_RATE, first, Fraction(1), count)

    def placed(self, clock: Clock) -> TargetTracks:
        """Return the tracks with arrays that no range places beginning with a clock.

        Raises:
            OptionError: Its frames are of another rate (TGT014), or an array has rows
                for another number of frames (TGT015).
        """
        faults = []
        if self.fps is not None and self.fps != clock.fps:
            message = f"the targets are at {rate_label(self.fps)}, the take at "
            hint = f"remove fps, or write fps: {clock.fps} and frames at that rate"
            message += rate_label(clock.fps)
            line, column = self.rate_place
            place = str(self.path), (line,)
            faults.append(Fault("TGT014", message, *place, hint, column=column))
        count = int((clock.count - 1) * clock.step // 1) + 1
        for track in self.goals:
            for value in track.values.values():
                if isinstance(value, Rows) and value.first is None:
                    rows = len(value.values)
                    if rows == count:
                        continue
                    message = (
                        f"{value.name!r} has {counted(rows, 'row')}, but the take has "
                    )
                    message += f" {counted(count, 'frame')}"
                    hint = "write range to tell which frames the rows are for"
                    faults.append(value.fault(message, hint, str(self.path)))
        if faults:
            raise OptionError(faults)
        goals = tuple(
            replace(
                track,
                values={
                    part: replace(value, first=clock.start)
                    if isinstance(value, Rows) and value.first is None
                    else value
                    for part, value in track.values.items()
                },
            )
            for track in self.goals
        )
        return replace(self, goals=goals)

    def sample(
        self,
        rig: Rig,
        clock: Clock,
        world: WorldTransforms,
        free: Sequence[WorldTransforms] = (),
    ) -> Targets:
        """Return where the goals are in every frame.

        Args:
            rig: Whose joints the effectors are.
            clock: F frames, of the rate of the file.
            world: Where the joints are in them without the goals: what is held
                without a value of its own stays where that has it.
            free: By goal, where joints are if all other goals are met: what is asked
                ``during`` spans alone comes from there and goes there. None is
                ``world``.

        Raises:
            OptionError: A frame has no row in an array (TGT015).
            FormatError: A prim's transform is not finite.
        """
        times = clock.times
        frames = Frames(times, clock.fps)
        shape = (len(times), len(self.goals))
        parts = {kind.targets: np.zeros((*shape, kind.value.value)) for kind in KINDS}
        for kind in KINDS:
            if kind.value is TargetValue.ROTATION:
                parts[kind.targets][..., 3] = 1.0
        weights = np.ones((*shape, len(KINDS)))
        for e, track in enumerate(self.goals):
            still = FreeEffector(rig, track.goal, world)
            away = FreeEffector(rig, track.goal, free[e]) if free else still
            asked = np.ones(len(times))
            if track.during:
                asked = hold_shares(times, track.during, track.ease).max(axis=0)
            for i, kind in enumerate(KINDS):
                if not track.goal.weights[i]:
                    continue
                value, weight = _part(track, kind, frames, still)
                parts[kind.targets][:, e] = away.towards(kind, value, asked)
                weights[:, e, i] = weight * (asked > 0)
        return Targets(**parts, weights=weights)


def _part(
    track: GoalTrack, kind: GoalKind, frames: Frames, pose: FreeEffector
) -> tuple[FloatArray, FloatArray]:
    """Return where a part of a goal is ``(F, W)``, and how much it counts ``(F,)``."""
    part = kind.name
    weight = np.ones(len(frames.times))
    if part in track.weights:
        # A curve of keys above 0 may dip below between them.
        weight = np.maximum(track.weights[part].at(frames)[:, 0], 0.0)
    value = track.values[part]
    if value is not None:
        free = value.at(frames)
    else:
        free = pose.turn() if kind.value is TargetValue.ROTATION else pose.place()
    if not track.spans or part not in track.held:
        return free, weight
    shares = hold_shares(frames.times, track.spans, track.ease)
    starts = np.array([first for first, _ in track.spans])
    if value is None:
        places = np.interp(starts, frames.times, np.arange(len(frames.times)))
        stills = between(free, places)
        weight = weight * shares.max(axis=0)
    else:
        stills = value.at(replace(frames, times=starts))
    return held(free, shares, stills), weight


def _ends(track: GoalTrack) -> list[float]:
    """Return the first and last frames of what a goal mentions."""
    ends = [end for span in (*track.spans, *track.during) for end in span]
    for value in (*track.values.values(), *track.weights.values()):
        if isinstance(value, Keyed):
            ends += [value.channel.times[0], value.channel.times[-1]]
        elif isinstance(value, Rows):
            first = 1.0 if value.first is None else float(value.first)
            ends += [first, first + len(value.values) - 1]
    return ends
