"""Takes: a clock and the motion of a rig.

A `TakeStream` yields blocks of frames, so that a long take is never in memory at once;
a `Take` has all frames, for operations that need them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import field
from fractions import Fraction
from itertools import pairwise
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import Fault, OptionError, counted
from animtool.core.loaded import check_loaded
from animtool.core.old_names import rename_attributes
from animtool.core.rates import rate_label
from animtool.core.record import dataclass
from animtool.maths.curves import Curves
from animtool.motion.motion import CHANNELS, Channel, Motion, MotionCurve
from animtool.motion.scores import PassScores
from animtool.motion.transforms import Track
from animtool.rig.kinematics import WorldTransforms
from animtool.rig.placement import Placement
from animtool.rig.skeleton import Rig

# Half precision, the coarsest type of USD rotations, has errors up to 5e-4.
UNIT_LENGTH_TOLERANCE = 1e-3


def find_shape_faults(
    rig: Rig, clock: Clock, motion: Motion, tracks: Sequence[Track]
) -> list[Fault]:
    """Return faults for channels whose shape does not match clock, rig and tracks."""
    frames = clock.count
    joint_count = len(rig.joints)
    row_counts = *[joint_count] * 3, len(rig.shapes), len(rig.controls), len(tracks)
    faults = []
    if tracks and motion.track_times is None:
        message = f"track_times are missing of {counted(len(tracks), 'track')}"
        faults.append(Fault("TAKE001", message))
    widths = 3, 4, 3, 1, 1, 1
    for name, count, width in zip(CHANNELS, row_counts, widths, strict=True):
        channel: Channel | None = getattr(motion, name)
        if channel is None:
            continue
        moving_count = len(channel.animated)
        for part, expected_shape, shape in (
            ("rest", (count, width), channel.rest.shape),
            ("animated", (moving_count,), channel.animated.shape),
            ("values", (frames, moving_count, width), channel.values.shape),
        ):
            if expected_shape != shape:
                message = f"{name}.{part} must have shape {expected_shape}, not {shape}"
                hint = None
                if part == "rest" and width > 1 and shape[1:] == (width,):
                    hint = f"the motion is that of a rig with {shape[0]} joints, and "
                    hint += (
                        f"{rig.name!r} has {count}; animtool.retarget.retarget_take "
                    )
                    hint += "moves a take to another rig"
                elif part == "values" and shape[1:] == expected_shape[1:]:
                    hint = f"the clock has {counted(frames, 'frame')}, and the motion "
                    hint += f"{shape[0]}: write count={shape[0]} in the clock"
                faults.append(Fault("TAKE001", message, hint=hint))
        bounded_indices = [-1, *channel.animated.ravel().tolist(), count]
        if not all(a < b for a, b in pairwise(bounded_indices)):
            message = f"{name}.animated must ascend from 0 to below {count}"
            faults.append(Fault("TAKE002", message))
    return faults


def find_value_faults(
    rig: Rig, clock: Clock, motion: Motion, tracks: Sequence[Track]
) -> list[Fault]:
    """Return faults for non-finite values and invalid rotations, one per channel."""
    faults = []
    for name in CHANNELS:
        channel: Channel | None = getattr(motion, name)
        if channel is None:
            continue
        for is_static, values in ((True, channel.rest), (False, channel.values)):
            fault_index = _first_non_finite(values)
            code, problem = "TAKE004", "not finite"
            if fault_index is None and name == "rotations":
                fault_index = _first_non_unit(values)
                code, problem = "TAKE005", "not a unit quaternion (x, y, z, w)"
            if fault_index is not None:
                channel_row = (
                    fault_index[0]
                    if is_static
                    else int(channel.animated[fault_index[1]])
                )
                owner = _row_owner(rig, tracks, name, channel_row)
                if not is_static:
                    owner += f" at frame {float(clock.times[fault_index[0]]):g}"
                message = (
                    f"{name}: {owner} is {values[fault_index].tolist()}, {problem}"
                )
                faults.append(Fault(code, message))
    return faults


def _first_non_finite(values: FloatArray) -> tuple[int, ...] | None:
    """Return the index of the first row with a value that is not finite."""
    # A finite sum has only finite terms, and needs no copy.
    if np.isfinite(np.sum(values)):
        return None
    rows = np.argwhere(~np.isfinite(values).all(axis=-1))
    return tuple(rows[0].tolist()) if len(rows) else None


def _first_non_unit(values: FloatArray) -> tuple[int, ...] | None:
    """Return the index of the first quaternion that is not of unit length."""
    squares = np.einsum("...k,...k->...", values, values)
    # Twice the tolerance, as the length is squared.
    is_non_unit = np.abs(squares - 1.0) > 2 * UNIT_LENGTH_TOLERANCE
    return tuple(np.argwhere(is_non_unit)[0].tolist()) if is_non_unit.any() else None


def _row_owner(rig: Rig, tracks: Sequence[Track], name: str, index: int) -> str:
    """Return the joint, shape, control or track of a channel's row, for messages."""
    if name == "track_times":
        return f"track {tracks[index].path!r}"
    rig_field = {"weights": "shapes", "controls": "controls"}.get(name, "joints")
    return f"{rig_field[:-1]} {getattr(rig, rig_field)[index].name!r}"


@dataclass(frozen=True, slots=True)
class Take:
    """All frames of the motion of one rig.

    Attributes:
        rig: J joints.
        clock: Times of its F frames.
        motion: Values of the frames.
        notices: Warnings and notes about its source.
        tracks: Props and cameras; most takes have none.
        curve: Source of the samples as a function of time codes ``(F,)``; None if there
            are samples only. It is valid for samples that passes have not changed, see
            `animtool.edit.between.TakeSampler`.

    Raises:
        OptionError: The motion's arrays do not match the rig, the tracks or the clock
            (TAKE001), or a channel's joints do not ascend (TAKE002); if there is no
            such fault, a value is not finite (TAKE004) or a rotation is not a unit
            quaternion (TAKE005). It lists every fault.
    """

    rig: Rig
    clock: Clock
    motion: Motion
    notices: tuple[Fault, ...] = ()
    tracks: tuple[Track, ...] = ()
    curve: MotionCurve | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Raise if rig, clock, motion and tracks do not match."""
        check_loaded(self.rig, Rig, "rig")
        parts = self.rig, self.clock, self.motion, self.tracks
        faults = find_shape_faults(*parts) or find_value_faults(*parts)
        if faults:
            raise OptionError(faults)

    @property
    def fps(self) -> Fraction:
        """Time codes per second; `Clock.rate` is the frame rate."""
        return self.clock.fps

    def __len__(self) -> int:
        """Return the number of frames."""
        return self.clock.count

    def __bool__(self) -> bool:
        """Return True: a take is true even if it has no frames."""
        return True

    def world(self) -> WorldTransforms:
        """Return the world transforms of every joint in every frame.

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
        return self.motion.world(self.rig)

    def __repr__(self) -> str:
        """Return the rig's name, the frames and the joints."""
        clock, joints = self.clock, counted(len(self.rig.joints), "joint")
        step_text = "" if clock.step == 1 else f" every {float(clock.step):g}"
        frames = counted(clock.count, "frame")
        return (
            f"<Take of {self.rig.name!r}: {frames} from {float(clock.start):g} to "
            f"{float(clock.last):g}{step_text} at {rate_label(clock.fps)}, {joints}>"
        )


@dataclass(slots=True)
class TakeStream:
    """A take that is read block by block, once.

    Attributes:
        rig: J joints.
        fps: Time codes per second.
        start: Time code of the first frame; None if the source has none.
        step: Time codes from one frame to the next.
        blocks: Motions of consecutive frames that share their rest and animated
            joints. Reading them may raise `animtool.core.errors.FormatError`.
        notices: Warnings and notes about the source; complete once the blocks are read.
        details: Further information about the source, for reports.
        curve: The source's motion as a function of its time codes ``(F,)``; None if it
            has samples only.
        is_altered: Whether passes may have changed the blocks relative to ``curve``.
        count: Number of frames, if ``curve`` is set and not altered.
        control_curves: Valid key curves of controls by name, over time codes of the
            source.
        tracks: Props and cameras, whose times are in the blocks; most takes have none.
        points: Names of the meshes and strands with simulated points.
        unread_meshes: Returns the names of the skinned meshes of the source that the
            rig lacks; None if there are none.
        simulated: Reports of simulations as plain values; complete once the blocks are
            read.
        scores: Scores of passes; complete once the blocks are read.
        dropped: The placement on the stage as a function of time codes ``(F,)``, if the
            take was read without it; None otherwise.
    """

    rig: Rig
    fps: Fraction
    start: Fraction | None
    step: Fraction
    blocks: Iterator[Motion]
    notices: list[Fault] = field(default_factory=list)
    details: dict[str, object] = field(default_factory=dict)
    curve: MotionCurve | None = None
    is_altered: bool = False
    count: int = 0
    control_curves: dict[str, Curves] = field(default_factory=dict)
    tracks: tuple[Track, ...] = ()
    points: frozenset[str] = frozenset()
    unread_meshes: Callable[[], tuple[str, ...]] | None = None
    simulated: list[dict[str, object]] = field(default_factory=list)
    scores: list[PassScores] = field(default_factory=list)
    dropped: Callable[[FloatArray], Placement] | None = None

    def __repr__(self) -> str:
        """Return the rig's name, the rate and the joints."""
        joints = counted(len(self.rig.joints), "joint")
        return f"<TakeStream of {self.rig.name!r} at {rate_label(self.fps)}, {joints}>"

    if not TYPE_CHECKING:  # type checkers know the attributes, and no others

        def __getattr__(self, name: str) -> NoReturn:
            """Raise `AttributeError`; attributes of `Take` need all frames."""
            message = f"{type(self).__name__!r} object has no attribute {name!r}"
            if not name.startswith("_") and hasattr(Take, name):
                message += "; it is read block by block: call collect() first, which "
                message += f"returns a Take with {name!r}"
            raise AttributeError(message, name=name, obj=self)

    @property
    def first_frame(self) -> Fraction:
        """Time code of the first frame; 1 if the source states none."""
        return Fraction(1) if self.start is None else self.start

    def collect(self) -> Take:
        """Return the complete take, with static joints stored once."""
        motion = Motion.concatenate(list(self.blocks)).map(Channel.compact)
        clock = Clock(self.fps, self.first_frame, self.step, motion.frames)
        notices = tuple(self.notices)
        return Take(self.rig, clock, motion, notices, self.tracks, self.curve)

    @staticmethod
    def of(take: Take) -> TakeStream:
        """Return a take as a stream of one block."""
        clock = take.clock
        return TakeStream(
            take.rig,
            clock.fps,
            clock.start,
            clock.step,
            iter([take.motion]),
            list(take.notices),
            curve=take.curve,
            is_altered=True,
            tracks=take.tracks,
            points=frozenset(take.motion.points),
        )


rename_attributes(TakeStream, altered="is_altered")
