"""Passes: their definition, the table of all passes, and their application.

A pass changes a take: a function, a record of its options and a `Pass` with both. The
table lists the passes by name; they are imported when used.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from enum import StrEnum
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeAlias, cast

from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import Fault, OptionError, excerpt, listed, refuse
from animtool.core.names import name_hint
from animtool.core.old_names import old_objects, rename_attributes, renamed_arguments
from animtool.core.plugins import (
    ListedEntry,
    describe_entries,
    load_object,
    load_plugin,
    plugin_entry_points,
)
from animtool.core.record import dataclass
from animtool.maths.curves import Curves
from animtool.motion.driving import drive_stream, drive_take
from animtool.motion.motion import Channel, Motion
from animtool.motion.scores import PassScores
from animtool.motion.take import Take, TakeStream
from animtool.motion.transforms import Track
from animtool.rig.skeleton import Rig

MAX_LISTED_TRACKS = 6


class PassthroughTracks:
    """Removes the tracks of a take for a pass, and restores them frame by frame."""

    def __init__(self, stream: TakeStream) -> None:
        self._tracks, curve = stream.tracks, stream.curve
        self._pending_times: deque[Channel] = deque()
        blocks = self._remove_track_times(stream.blocks)
        self.stream = replace(stream, tracks=(), blocks=blocks)
        if curve is not None:
            self.stream.curve = lambda times: replace(curve(times), track_times=None)

    def _remove_track_times(self, blocks: Iterator[Motion]) -> Iterator[Motion]:
        """Yield blocks without their track times, which are stored for `restore`."""
        for block in blocks:
            assert block.track_times is not None
            self._pending_times.append(block.track_times)
            yield replace(block, track_times=None)

    def restore(self, stream: TakeStream) -> TakeStream:
        """Restore the tracks in a pass's result, which must have as many frames."""
        blocks = (
            replace(block, track_times=self._pop_track_times(block.frames))
            for block in stream.blocks
        )
        return replace(stream, tracks=self._tracks, blocks=blocks)

    def _pop_track_times(self, frames: int) -> Channel:
        """Return the track times of the next frames."""
        time_channels: list[Channel] = []
        while frames:
            next_times = self._pending_times.popleft()
            if len(next_times.values) > frames:
                self._pending_times.appendleft(next_times.select(slice(frames, None)))
                next_times = next_times.select(slice(frames))
            time_channels.append(next_times)
            frames -= len(next_times.values)
        return Channel.concatenate(time_channels)


def check_tracks(
    stream: TakeStream, source_tracks: Sequence[Track], name: str
) -> TakeStream:
    """Return a pass's result; reading it raises an error if the pass lost tracks."""
    if not source_tracks:
        return stream
    paths = listed([track.path for track in source_tracks], MAX_LISTED_TRACKS)
    message = f"the pass {name} changes the clock and loses {paths}"
    hint = "it must treat track_times as the other channels of a motion"
    lost_tracks_error = OptionError(Fault("SCN045", message, hint=hint))
    if not stream.tracks:
        raise lost_tracks_error

    def checked_blocks(blocks: Iterator[Motion]) -> Iterator[Motion]:
        """Yield the blocks; raise if their track times are missing."""
        for block in blocks:
            if block.track_times is None:
                raise lost_tracks_error
            yield block

    return replace(stream, blocks=checked_blocks(stream.blocks))


PLUGIN_GROUP = "animtool.passes"

PASSES: dict[str, str] = {
    "blend": "animtool.edit.layers:BLEND",
    "clean": "animtool.capture.clean:PASS",
    "difference": "animtool.edit.layers:DIFFERENCE",
    "feet": "animtool.retarget.feet_pass:FEET",
    "hang": "animtool.edit.tree:PASS",
    "ik": "animtool.ik.take_pass:PASS",
    "layer": "animtool.edit.layers:LAYER",
    "loop": "animtool.edit.looping:PASS",
    "mirror": "animtool.edit.mirroring:PASS",
    "ragdoll": "animtool.systems.rigid.take_pass:PASS",
    "resample": "animtool.edit.resample:PASS",
    "retarget": "animtool.retarget.take_pass:PASS",
    "root_drift": "animtool.retarget.drift:PASS",
    "root_motion": "animtool.edit.root_motion:PASS",
    "simulate": "animtool.systems.attach.take_pass:PASS",
    "time_scale": "animtool.edit.retiming:TIME_SCALE",
    "time_warp": "animtool.edit.retiming:TIME_WARP",
    "trim": "animtool.edit.retiming:TRIM",
}


class FrameScope(StrEnum):
    """Number of frames a pass needs at once: one, a window, or the complete clip."""

    FRAME = "frame"
    WINDOW = "window"
    CLIP = "clip"


class TakePart(StrEnum):
    """Kinds of content of a take that a pass reads or changes."""

    RIG = "rig"
    JOINTS = "joints"
    SHAPES = "shapes"
    CONTROLS = "controls"
    CLOCK = "clock"
    TRACKS = "tracks"
    POINTS = "points"


EVERY_PART = frozenset(TakePart)
# Parts with motion.
MOTION_PARTS = frozenset({TakePart.JOINTS, TakePart.SHAPES, TakePart.CONTROLS})
# Parts that change when frames are resampled.
RETIMED_PARTS = MOTION_PARTS | {TakePart.CLOCK, TakePart.TRACKS, TakePart.POINTS}


def required_take_path(path: Path | None, option: str = "take") -> Path:
    """Return the path of another take from an option; raises if it is missing."""
    if path is None:
        refuse("SCN024", f"{option} must name a file with another take")
    return path


# Function of a take, the names of a system and of a particle, and a progress callback.
SegmentSimulator: TypeAlias = Callable[
    [Take, str, str, Callable[[float], None] | None], FloatArray
]

# Function of a take, options with keys such as ``colliders``, and the time for which
# the first frame is held [s]; returns the take, which may have been read ahead, and its
# `Colliders`. Shapes are in the axes of the rig, and the first frame is at 0 s.
ColliderBuilder: TypeAlias = Callable[[TakeStream, Any, float], tuple[TakeStream, Any]]


@dataclass(frozen=True, slots=True)
class PlacedJoint:
    """A joint that a pass has moved to a target."""

    joint: str  # name of the joint
    effector: str  # name of the effector in the targets file
    times: FloatArray  # time codes of the frames in which the joint is at its target


@dataclass(frozen=True, slots=True)
class PassContext:
    """Services for a pass: other takes, notices, scores, progress and the scene."""

    open: Callable[[Path], Take]  # opens another take on the same rig
    folder: Path  # base folder of relative paths in options
    # Collects the warnings and notes of the pass.
    notices: list[Fault] = field(default_factory=list)
    # Collects the largest residual of passes that solve IK [m].
    errors: list[float] = field(default_factory=list)
    # Collects scores after the last frame.
    scores: list[PassScores] = field(default_factory=list)
    # Number of copies of the first frame before it, for a pass that settles.
    prepended_frames: int = 0
    # Whether a pass writes the files that its options name as ``writes``: true for a
    # bake, false for commands that only inspect a take.
    writes_files: bool = True
    # Codes of notes that are reported once over all passes.
    reported_codes: set[str] = field(default_factory=set)
    # Whether time codes of the take are shot frames, which may lie between samples.
    in_shot: bool = False
    # Receives the fraction done, 0 to 1, of passes with ``tells``; None if progress is
    # not shown.
    progress: Callable[[float], None] | None = None
    # Simulates a rope or strands of the scene by name; returns a particle, by name or
    # number, and the one before it at every frame of a take, the latter first
    # ``(F, 2, 3)`` [m]. None if there is no scene.
    simulate_segments: SegmentSimulator | None = None
    # Builds the colliders named by options of a pass, see `ColliderBuilder`; None
    # without a scene.
    build_colliders: ColliderBuilder | None = None
    # Joints that passes so far have moved to targets; cleared by passes that change
    # times.
    placed_joints: list[PlacedJoint] = field(default_factory=list)

    def add_notices_once(self, notices: Iterable[Fault]) -> None:
        """Add the notices whose codes were not yet reported by any pass."""
        for notice in notices:
            if notice.code not in self.reported_codes:
                self.reported_codes.add(notice.code)
                self.notices.append(notice)

    def take(self, path: Path | None, option: str = "take") -> Take:
        """Return the take that an option names."""
        return self.open(self.folder / required_take_path(path, option))


rename_attributes(
    PassContext,
    early="prepended_frames",
    keeps="writes_files",
    said="reported_codes",
    segments="simulate_segments",
    around="build_colliders",
)


# By option: a function that raises `OptionError` if its value is invalid for every
# take.
OptionChecks: TypeAlias = Mapping[str, Callable[[], object]]
# Each pass has its own options record, unknown to the caller.
ClipRun: TypeAlias = Callable[[Take, Any, PassContext], Take]
StreamRun: TypeAlias = Callable[[TakeStream, Any, PassContext], TakeStream]


@dataclass(frozen=True, slots=True)
class LinearTime:
    """Linear time map: t of the source becomes ``first + (t - start) · ratio``."""

    start: float  # [time code]
    ratio: float  # time ratio above 0
    first: float  # [time code]


@dataclass(frozen=True, slots=True)
class Pass:
    """An entry of the table of passes."""

    name: str  # name of the pass in scenes
    summary: str  # one-line description of the pass
    options: type[Any]  # frozen dataclass of the options, each with a default
    # FRAME and WINDOW passes run on streams and carry their state from block to block;
    # CLIP passes run on complete takes.
    scope: FrameScope
    # Takes a `TakeStream` (FRAME, WINDOW) or a `Take` (CLIP), the options and the
    # context, and returns the same kind.
    run: ClipRun | StreamRun
    # Returns checks of the options that need no take.
    checks: Callable[[Any], OptionChecks] = lambda _: {}
    # Parts of the take that the result depends on.
    reads: frozenset[TakePart] = EVERY_PART
    # Parts that it may change. If the clock is among them, the parts not listed keep
    # their values at the remaining time codes. A pass that changes neither clock nor
    # tracks runs on a take without tracks.
    changes: frozenset[TakePart] = EVERY_PART
    # Whether it needs pre-roll to settle from its initial state; it must keep the
    # number of frames.
    needs_preroll: bool = False
    # Whether it is slow, and reports its progress to the context.
    reports_progress: bool = False
    # Returns the linear time mapping of the pass, from its options and a take's clock,
    # so that curves of controls stay curves; None if time changes otherwise.
    linear_time: Callable[[Any, Clock], LinearTime | None] = lambda *_: None


_OLD_FIELDS = {
    "settles": "needs_preroll",
    "tells": "reports_progress",
    "even": "linear_time",
}
rename_attributes(Pass, **_OLD_FIELDS)
setattr(Pass, "__init__", renamed_arguments(**_OLD_FIELDS)(Pass.__init__))  # noqa: B010


# Plug-ins may import `FrameScope` by its old name.
__getattr__ = old_objects(__name__, Scope=FrameScope)


def find_pass(name: str) -> Pass:
    """Return a pass by name, including passes of plug-ins (unknown: SCN010).

    >>> find_pass("trim").scope
    <FrameScope.FRAME: 'frame'>
    """
    if name in PASSES:
        return cast(Pass, load_object(PASSES[name]))
    entry_points = plugin_entry_points(PLUGIN_GROUP)
    if name in entry_points:
        return load_plugin(entry_points[name], Pass)
    message = f"unknown pass {excerpt(name)}"
    raise OptionError(Fault("SCN010", message, hint=name_hint(name, pass_names())))


def pass_names() -> list[str]:
    """Return the names of all passes, including those of plug-ins.

    >>> pass_names()[:3]
    ['blend', 'clean', 'difference']
    """
    return sorted({*PASSES, *plugin_entry_points(PLUGIN_GROUP)})


def listed_passes() -> list[ListedEntry]:
    """Return every pass and its scope, built-in ones first.

    Each is loaded to check that it works.

    >>> listed_passes()[0].name
    'blend'
    """
    entry_points = plugin_entry_points(PLUGIN_GROUP)
    return describe_entries(
        sorted(PASSES), entry_points, find_pass, lambda p: (p.scope, p.summary), None
    )


def handles_tracks(pass_: Pass) -> bool:
    """Return whether a pass receives the tracks of a take.

    >>> handles_tracks(find_pass("mirror")), handles_tracks(find_pass("trim"))
    (False, True)
    """
    return bool(pass_.changes & {TakePart.CLOCK, TakePart.TRACKS})


def apply_pass(
    stream: TakeStream, pass_: Pass, options: object, context: PassContext
) -> TakeStream:
    """Return a take with a pass applied; a CLIP pass reads all frames at once.

    The result keeps the notices and details of the source, and the curves of controls
    whose values a CLIP pass keeps or whose time it changes linearly. If the source has
    no first frame, neither has the result, unless the pass moves the start.
    """
    _check_points(stream, pass_)
    if TakePart.CLOCK in pass_.changes:
        context.placed_joints.clear()
    if stream.tracks and not handles_tracks(pass_):
        passthrough = PassthroughTracks(stream)
        result = apply_pass(passthrough.stream, pass_, options, context)
        return passthrough.restore(result)
    if pass_.scope is not FrameScope.CLIP:
        result = drive_stream(cast(StreamRun, pass_.run)(stream, options, context))
        keeps_curves = not pass_.changes & {TakePart.CONTROLS, TakePart.CLOCK}
        curves = stream.control_curves if keeps_curves else {}
        curve = stream.curve if _have_same_channels(stream.rig, result.rig) else None
        result = replace(
            result, control_curves=curves, curve=curve, is_altered=True, count=0
        )
        return check_tracks(result, stream.tracks, pass_.name)
    source_take = stream.collect()
    changed_take = cast(ClipRun, pass_.run)(source_take, options, context)
    take = drive_take(changed_take)
    context.notices.extend(take.notices[len(changed_take.notices) :])
    linear_time = pass_.linear_time(options, source_take.clock)
    kept_curves = _valid_curves(stream, source_take, take, linear_time)
    if not _have_same_channels(source_take.rig, take.rig):
        take = replace(take, curve=None)
    clock = take.clock
    has_no_start = stream.start is None and clock.start == Fraction(1)
    result = replace(
        stream,
        rig=take.rig,
        fps=clock.fps,
        start=None if has_no_start else clock.start,
        step=clock.step,
        blocks=iter([take.motion]),
        curve=take.curve,
        is_altered=True,
        count=0,
        control_curves=kept_curves,
        tracks=take.tracks,
        points=frozenset(take.motion.points),
    )
    return check_tracks(result, source_take.tracks, pass_.name)


def _valid_curves(
    stream: TakeStream,
    source_take: Take,
    result_take: Take,
    linear_time: LinearTime | None,
) -> dict[str, Curves]:
    """Return the control curves that are still valid, mapped to the result's times."""
    curves = stream.control_curves
    if not curves:
        return {}
    if linear_time is None or source_take.clock == result_take.clock:
        kept_controls = _unchanged_controls(source_take, result_take)
        return {name: curve for name, curve in curves.items() if name in kept_controls}
    time_mapping = linear_time.start, linear_time.ratio, linear_time.first
    return {name: curve.retimed(*time_mapping) for name, curve in curves.items()}


def _have_same_channels(rig: Rig, other_rig: Rig) -> bool:
    """Return whether motions of two rigs have the same joints, shapes and controls."""
    part_names, other_part_names = (
        [[part.name for part in parts] for parts in (r.joints, r.shapes, r.controls)]
        for r in (rig, other_rig)
    )
    return part_names == other_part_names


def _check_points(stream: TakeStream, pass_: Pass) -> None:
    """Raise if a pass moves joints away from simulated points (SIM034)."""
    changes_points = TakePart.POINTS in pass_.changes
    if not stream.points or TakePart.JOINTS not in pass_.changes or changes_points:
        return
    names = ", ".join(sorted(stream.points))
    message = f"{pass_.name} would move joints away from what is simulated: {names}"
    raise OptionError(Fault("SIM034", message, hint="put simulate after it"))


def _unchanged_controls(source_take: Take, result_take: Take) -> set[str]:
    """Return the controls with equal values in every frame."""
    before_controls = source_take.motion.controls
    after_controls = result_take.motion.controls
    has_same_controls = (
        source_take.clock == result_take.clock
        and source_take.rig.controls == result_take.rig.controls
    )
    if not has_same_controls or before_controls is None or after_controls is None:
        return set()
    is_equal = (before_controls.dense() == after_controls.dense()).all(axis=(0, 2))
    return {source_take.rig.controls[i].name for i in is_equal.nonzero()[0].tolist()}
