"""What flows through animtool: a clock, and the motion of a rig.

A take arrives as a `TakeStream` of blocks of frames, so that a long one is never
held whole, or is gathered into one `Take` where an operation needs all of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import pairwise
from numbers import Rational

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.errors import Fault, OptionError, counted
from animtool.maths.curves import Curves
from animtool.rates import rate_label
from animtool.rig.kinematics import WorldTransforms, forward
from animtool.rig.skeleton import Rig
from animtool.transforms import Track

__all__ = [
    "MOST_FRAMES",
    "Channel",
    "Clock",
    "Motion",
    "Take",
    "TakeStream",
    "time_codes",
]

# Half precision, the coarsest that USD keeps rotations in, is off by 5e-4.
UNIT_TOLERANCE = 1e-3

# Days of animation: rather a number that is mistyped.
MOST_FRAMES = 10_000_000


def time_codes(start: Fraction, step: Fraction, count: int) -> FloatArray:
    """Return start + i·step for i < count ``(count,)``, each rounded once.

    >>> time_codes(Fraction(1001), Fraction(1, 5), 3).tolist()
    [1001.0, 1001.2, 1001.4]
    """
    common = start.denominator * step.denominator
    first = start.numerator * step.denominator
    each = step.numerator * start.denominator
    # Integers this size are exact in float64, so one division rounds correctly.
    if max(abs(first), abs(first + each * count), common) < 2**53:
        return (first + each * np.arange(count, dtype=np.int64)) / float(common)
    return np.array([float(start + i * step) for i in range(count)])


@dataclass(frozen=True, slots=True)
class Clock:
    """When the frames of a take are.

    Attributes:
        fps: Time codes a second.
        start: Time code of the first frame.
        step: Time codes from one frame to the next.
        count: Number of frames.

    Raises:
        OptionError: One is a float, or fps or step are not positive (TAKE003).

    >>> Clock(Fraction(30000, 1001), Fraction(1), Fraction(1), 5).rate
    Fraction(30000, 1001)
    """

    fps: Fraction
    start: Fraction
    step: Fraction
    count: int

    def __post_init__(self) -> None:
        """Check that times are exact; whole numbers become fractions."""
        faults = []
        for name in ("fps", "start", "step"):
            value = getattr(self, name)
            if not isinstance(value, Rational):
                message = f"{name} is {value!r}, which is not exact"
                faults.append(Fault("TAKE003", message, hint="write a Fraction"))
                continue
            object.__setattr__(self, name, Fraction(value))
            if value <= 0 and name != "start":
                message = f"{name} is {value}; it must be positive"
                faults.append(Fault("TAKE003", message))
        if faults:
            raise OptionError(faults)

    @property
    def times(self) -> FloatArray:
        """Time code of every frame ``(F,)``."""
        return time_codes(self.start, self.step, self.count)

    @property
    def rate(self) -> Fraction:
        """Frames a second."""
        return self.fps / self.step

    @property
    def duration(self) -> Fraction:
        """From the first frame to the last [s]."""
        return self.step * max(0, self.count - 1) / self.fps


@dataclass(frozen=True, slots=True)
class Channel:
    """One kind of value for every joint; what does not move is stored once.

    Attributes:
        rest: The value of each joint while it does not move ``(J, K)``.
        animated: Indices of the joints that move ``(A,)``, ascending.
        values: Their values ``(F, A, K)``.
    """

    rest: FloatArray
    animated: IntArray
    values: FloatArray

    def __repr__(self) -> str:
        """Return how much there is of what.

        >>> Channel.from_dense(np.zeros((5, 2, 3)))
        <Channel: 5 frames, 0 of 2 move, 3 components>
        """
        frames, _, width = self.values.shape
        moving = f"{len(self.animated)} of {len(self.rest)} move"
        return f"<Channel: {frames} frames, {moving}, {width} components>"

    def dense(self) -> FloatArray:
        """Return the value of every joint in every frame ``(F, J, K)``.

        >>> Channel.from_dense(np.ones((2, 1, 3))).dense().tolist()
        [[[1.0, 1.0, 1.0]], [[1.0, 1.0, 1.0]]]
        """
        whole = np.repeat(self.rest[None], len(self.values), axis=0)
        whole[:, self.animated] = self.values
        return whole

    def gather(self, joints: IntArray) -> FloatArray:
        """Return the values of some joints, moving or not ``(F, len(joints), K)``."""
        values = np.repeat(self.rest[joints][None], len(self.values), axis=0)
        places = np.full(len(self.rest), -1)
        places[self.animated] = np.arange(len(self.animated))
        moving = places[joints] >= 0
        if moving.any():
            values[:, moving] = self.values[:, places[joints[moving]]]
        return values

    def put(self, joints: IntArray, values: FloatArray) -> Channel:
        """Return the channel with other values of some joints, ascending."""
        moves = np.zeros(len(self.rest), np.bool_)
        moves[self.animated] = moves[joints] = True
        animated = np.flatnonzero(moves)
        whole = self.gather(animated)
        whole[:, np.searchsorted(animated, joints)] = values
        return Channel(self.rest, animated, whole)

    def compact(self) -> Channel:
        """Return the channel with the joints that never move made static."""
        if not len(self.values):
            return self
        moves = (self.values != self.values[:1]).any(axis=(0, 2))
        rest = self.rest.copy()
        rest[self.animated[~moves]] = self.values[0, ~moves]
        if moves.all():
            return self
        return Channel(rest, self.animated[moves], self.values[:, moves])

    def select(self, frames: slice | IntArray) -> Channel:
        """Return the channel at some of its frames."""
        return replace(self, values=self.values[frames])

    @staticmethod
    def from_dense(values: FloatArray) -> Channel:
        """Return the channel of values ``(F, J, K)``, static joints stored once.

        Raises:
            OptionError: They have another shape, or no frame (TAKE001).

        >>> Channel.from_dense(np.arange(12.0).reshape(2, 2, 3)).animated.tolist()
        [0, 1]
        """
        if values.ndim != 3 or not len(values):
            message = f"values must have shape (F, J, K), not {values.shape}"
            raise OptionError(Fault("TAKE001", message))
        return Channel(values[0].copy(), np.arange(values.shape[1]), values).compact()

    @staticmethod
    def concatenate(channels: list[Channel]) -> Channel:
        """Return one channel of blocks that share their rest and animated joints."""
        first = channels[0]
        return replace(first, values=np.concatenate([c.values for c in channels]))


@dataclass(frozen=True, slots=True)
class Motion:
    """What a rig does over frames: its joints, its shapes, its controls.

    Attributes:
        translations: Local, parent space, in place of rest [m], K = 3.
        rotations: Unit quaternions (x, y, z, w), signs continuous along time, K = 4.
        scales: [1], K = 3; None where nothing is scaled.
        weights: Of the rig's shapes, in its order [1], K = 1; None where the take has
            none.
        controls: Values of the rig's controls, in its order, K = 1; None where the
            take has none. Joints and shapes already hold what they drive.
        track_times: Which time of its own each of the take's tracks shows, K = 1; None
            where the take has no tracks.
        points: Where points of meshes and strands are in the world that do not follow
            joints any more, by their name [m], K = 3.
    """

    translations: Channel
    rotations: Channel
    scales: Channel | None = None
    weights: Channel | None = None
    controls: Channel | None = None
    track_times: Channel | None = None
    points: Mapping[str, Channel] = field(default_factory=dict)

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.rotations.values)

    def __repr__(self) -> str:
        """Return how much there is of what."""
        parts = [f"{self.frames} frames", f"{len(self.rotations.rest)} joints"]
        for name in ("weights", "controls"):
            channel: Channel | None = getattr(self, name)
            if channel is not None:
                parts.append(f"{len(channel.rest)} {name}")
        return f"<Motion: {', '.join(parts)}>"

    def dense(self) -> tuple[FloatArray, FloatArray, FloatArray | None]:
        """Return translations, rotations and scales of every joint in every frame."""
        return (
            self.translations.dense(),
            self.rotations.dense(),
            None if self.scales is None else self.scales.dense(),
        )

    def select(self, frames: slice | IntArray) -> Motion:
        """Return the motion at some of its frames."""
        return self.map(lambda channel: channel.select(frames))

    def map(self, function: Callable[[Channel], Channel]) -> Motion:
        """Return the motion with a function applied to each channel it has."""

        def mapped(channel: Channel | None) -> Channel | None:
            return None if channel is None else function(channel)

        return Motion(
            function(self.translations),
            function(self.rotations),
            mapped(self.scales),
            mapped(self.weights),
            mapped(self.controls),
            mapped(self.track_times),
            {name: function(one) for name, one in self.points.items()},
        )

    @staticmethod
    def concatenate(blocks: list[Motion]) -> Motion:
        """Return one motion of blocks that follow each other."""

        def joined(name: str) -> Channel | None:
            parts = [getattr(block, name) for block in blocks]
            return None if parts[0] is None else Channel.concatenate(parts)

        return Motion(
            Channel.concatenate([block.translations for block in blocks]),
            Channel.concatenate([block.rotations for block in blocks]),
            joined("scales"),
            joined("weights"),
            joined("controls"),
            joined("track_times"),
            {
                name: Channel.concatenate([block.points[name] for block in blocks])
                for name in blocks[0].points
            },
        )


@dataclass(frozen=True, slots=True)
class Take:
    """The motion of one rig, whole.

    Attributes:
        rig: J joints.
        clock: When its F frames are.
        motion: What they hold.
        notices: Warnings and notes about where it comes from.
        tracks: Things beside the rig; most takes have none.

    Raises:
        OptionError: The motion's arrays are not of the rig's joints, shapes and
            controls, of the tracks, or not of the clock's frames (TAKE001), or a
            channel's joints do not ascend (TAKE002), with every such fault; else a
            value is not finite (TAKE004) or a rotation no unit quaternion (TAKE005).
    """

    rig: Rig
    clock: Clock
    motion: Motion
    notices: tuple[Fault, ...] = ()
    tracks: tuple[Track, ...] = ()

    def __post_init__(self) -> None:
        """Check that rig, clock and motion fit together."""
        faults = _misfits(self) or _no_motion(self)
        if faults:
            raise OptionError(faults)

    def world(self) -> WorldTransforms:
        """Return where every joint is in every frame, world space.

        >>> from animtool.rig.skeleton import Joint
        >>> rig = Rig("arm", (Joint("a", -1), Joint("b", 0, translation=(0, 2, 0))))
        >>> still = Motion(
        ...     Channel.from_dense(rig.rest_translations[None]),
        ...     Channel.from_dense(rig.rest_rotations[None]),
        ... )
        >>> clock = Clock(Fraction(24), Fraction(1), Fraction(1), 1)
        >>> Take(rig, clock, still).world().positions[0].tolist()
        [[0.0, 0.0, 0.0], [0.0, 2.0, 0.0]]
        """
        return forward(self.rig, *self.motion.dense())

    def __repr__(self) -> str:
        """Return the rig's name, the frames and the joints."""
        clock, joints = self.clock, counted(len(self.rig.joints), "joint")
        last = clock.start + clock.step * (clock.count - 1)
        every = "" if clock.step == 1 else f" every {float(clock.step):g}"
        frames = counted(clock.count, "frame")
        return (
            f"<Take of {self.rig.name!r}: {frames} from "
            f"{float(clock.start):g} to {float(last):g}{every} "
            f"at {rate_label(clock.fps)}, {joints}>"
        )


def _misfits(take: Take) -> list[Fault]:
    """Return what of a take is not of the same frames, joints, shapes and controls."""
    rig, motion, frames = take.rig, take.motion, take.clock.count
    expected = [
        ("translations", motion.translations, len(rig.joints), 3),
        ("rotations", motion.rotations, len(rig.joints), 4),
        ("scales", motion.scales, len(rig.joints), 3),
        ("weights", motion.weights, len(rig.shapes), 1),
        ("controls", motion.controls, len(rig.controls), 1),
        ("track_times", motion.track_times, len(take.tracks), 1),
    ]
    faults = []
    if take.tracks and motion.track_times is None:
        message = f"track_times are missing of {counted(len(take.tracks), 'track')}"
        faults.append(Fault("TAKE001", message))
    for name, channel, many, width in expected:
        if channel is None:
            continue
        moving = len(channel.animated)
        for part, wanted, found in (
            ("rest", (many, width), channel.rest.shape),
            ("animated", (moving,), channel.animated.shape),
            ("values", (frames, moving, width), channel.values.shape),
        ):
            if wanted != found:
                message = f"{name}.{part} must have shape {wanted}, not {found}"
                faults.append(Fault("TAKE001", message))
        order = [-1, *channel.animated.ravel().tolist(), many]
        if not all(a < b for a, b in pairwise(order)):
            message = f"{name}.animated must ascend from 0 to below {many}"
            faults.append(Fault("TAKE002", message))
    return faults


_CHANNELS = (
    "translations",
    "rotations",
    "scales",
    "weights",
    "controls",
    "track_times",
)


def _no_motion(take: Take) -> list[Fault]:
    """Return what of a take is no number, or no rotation: the first of each channel."""
    motion, faults = take.motion, []
    for name in _CHANNELS:
        channel: Channel | None = getattr(motion, name)
        if channel is None:
            continue
        for still, values in ((True, channel.rest), (False, channel.values)):
            wrong = _first_infinite(values)
            code, what = "TAKE004", "not finite"
            if wrong is None and name == "rotations":
                wrong = _first_unequal(values)
                code, what = "TAKE005", "no unit quaternion (x, y, z, w)"
            if wrong is not None:
                place = _spot(take, name, channel, wrong, still)
                message = f"{place} is {values[wrong].tolist()}, {what}"
                faults.append(Fault(code, message))
    return faults


def _first_infinite(values: FloatArray) -> tuple[int, ...] | None:
    # A sum that is finite has no part that is not, and makes no copy.
    if np.isfinite(np.sum(values)):
        return None
    bad = np.argwhere(~np.isfinite(values).all(axis=-1))
    return tuple(bad[0].tolist()) if len(bad) else None


def _first_unequal(values: FloatArray) -> tuple[int, ...] | None:
    squares = np.einsum("...k,...k->...", values, values)
    # Twice, as the length is squared.
    off = np.abs(squares - 1.0) > 2 * UNIT_TOLERANCE
    return tuple(np.argwhere(off)[0].tolist()) if off.any() else None


def _spot(
    take: Take, name: str, channel: Channel, at: tuple[int, ...], still: bool
) -> str:
    """Return which value of a take stands at a place of an array."""
    index = at[0] if still else int(channel.animated[at[1]])
    if name == "track_times":
        kind, owner = "tracks", take.tracks[index].path
    else:
        kind = {"weights": "shapes", "controls": "controls"}.get(name, "joints")
        owner = getattr(take.rig, kind)[index].name
    when = "" if still else f" at frame {float(take.clock.times[at[0]]):g}"
    return f"{name}: {kind[:-1]} {owner!r}{when}"


@dataclass(slots=True)
class TakeStream:
    """A take that arrives block by block, once.

    Attributes:
        rig: J joints.
        fps: Time codes a second.
        start: Time code of the first frame; None where the source states none.
        step: Time codes from one frame to the next.
        blocks: Motions of consecutive frames that share their rest and animated
            joints. Reading them may raise `animtool.errors.FormatError`.
        notices: Warnings and notes about the source; complete once the blocks are
            read.
        details: What the source states beyond this, for reports.
        curve: Where the source is a function of time, gives its motion at any times
            ``(F,)`` [time codes of the source]; None where it has samples only.
        count: Number of frames, where ``curve`` is given.
        control_curves: The curves that controls were keyed with, by name, one each,
            over time codes of the source; those that still hold.
        tracks: Things beside the rig, whose times are in the blocks; most takes have
            none.
        points: Names of the meshes and strands whose points the motions hold.
        simulated: What became of each thing that was simulated, as plain values;
            complete once the blocks are read.
    """

    rig: Rig
    fps: Fraction
    start: Fraction | None
    step: Fraction
    blocks: Iterator[Motion]
    notices: list[Fault] = field(default_factory=list)
    details: dict[str, object] = field(default_factory=dict)
    curve: Callable[[FloatArray], Motion] | None = None
    count: int = 0
    control_curves: dict[str, Curves] = field(default_factory=dict)
    tracks: tuple[Track, ...] = ()
    points: frozenset[str] = frozenset()
    simulated: list[dict[str, object]] = field(default_factory=list)

    def collect(self) -> Take:
        """Return the whole take, static joints stored once."""
        motion = Motion.concatenate(list(self.blocks)).map(Channel.compact)
        start = Fraction(1) if self.start is None else self.start
        clock = Clock(self.fps, start, self.step, motion.frames)
        return Take(self.rig, clock, motion, tuple(self.notices), self.tracks)

    @staticmethod
    def of(take: Take) -> TakeStream:
        """Return a stream of one block."""
        clock = take.clock
        return TakeStream(
            take.rig,
            clock.fps,
            clock.start,
            clock.step,
            iter([take.motion]),
            list(take.notices),
            tracks=take.tracks,
            points=frozenset(take.motion.points),
        )
