"""What a pass is, where passes are found, and how one is applied.

A pass changes a take: a plain function, a record of its options and a `Pass` that
names both. The table holds the passes by name; they are imported when used.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from enum import StrEnum
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar, TypeAlias, cast

from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import Fault, OptionError, excerpt, listed
from animtool.core.plugins import load_object, load_plugin, plugin_points
from animtool.core.record import dataclass
from animtool.core.similar import similar
from animtool.maths.curves import Curves
from animtool.motion.driving import driven_stream, driven_take
from animtool.motion.motion import Channel, Motion
from animtool.motion.scores import PassScores
from animtool.motion.take import Take, TakeStream
from animtool.motion.transforms import Track
from animtool.rig.skeleton import Rig

MAX_NAMED = 6


class PassthroughTracks:
    """Takes the tracks out of a take, and puts them back frame by frame."""

    def __init__(self, stream: TakeStream) -> None:
        self._tracks, curve = stream.tracks, stream.curve
        self._waiting: deque[Channel] = deque()
        self.stream = replace(stream, tracks=(), blocks=self._without(stream.blocks))
        if curve is not None:
            self.stream.curve = lambda times: replace(curve(times), track_times=None)

    def _without(self, blocks: Iterator[Motion]) -> Iterator[Motion]:
        for block in blocks:
            assert block.track_times is not None
            self._waiting.append(block.track_times)
            yield replace(block, track_times=None)

    def restore(self, stream: TakeStream) -> TakeStream:
        """Return what a pass made of the take, of as many frames, with its tracks."""
        blocks = self._with(stream.blocks)
        return replace(stream, tracks=self._tracks, blocks=blocks)

    def _with(self, blocks: Iterator[Motion]) -> Iterator[Motion]:
        for block in blocks:
            yield replace(block, track_times=self._next(block.frames))

    def _next(self, frames: int) -> Channel:
        """Return the times of the frames that come next."""
        taken: list[Channel] = []
        while frames:
            first = self._waiting.popleft()
            if len(first.values) > frames:
                self._waiting.appendleft(first.select(slice(frames, None)))
                first = first.select(slice(frames))
            taken.append(first)
            frames -= len(first.values)
        return Channel.concatenate(taken)


def checked_tracks(
    stream: TakeStream, before: Sequence[Track], name: str
) -> TakeStream:
    """Return what a pass made of a take, refused where it has lost the tracks."""
    if not before:
        return stream
    paths = listed([track.path for track in before], MAX_NAMED)
    message = f"the pass {name} changes the clock, and loses {paths}"
    hint = "it must treat track_times as the other channels of a motion"
    lost = OptionError(Fault("SCN045", message, hint=hint))
    if not stream.tracks:
        raise lost

    def checked(blocks: Iterator[Motion]) -> Iterator[Motion]:
        for block in blocks:
            if block.track_times is None:
                raise lost
            yield block

    return replace(stream, blocks=checked(stream.blocks))


PLUGIN_GROUP = "animtool.passes"

PASSES: dict[str, str] = {
    "blend": "animtool.edit.layers:BLEND",
    "clean": "animtool.capture.clean:PASS",
    "difference": "animtool.edit.layers:DIFFERENCE",
    "feet": "animtool.retarget.take_pass:FEET",
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


class Scope(StrEnum):
    """How much of a take a pass must see at once."""

    FRAME = "frame"
    WINDOW = "window"
    CLIP = "clip"


class TakePart(StrEnum):
    """A part of a take that a pass looks at or changes."""

    RIG = "rig"
    JOINTS = "joints"
    SHAPES = "shapes"
    CONTROLS = "controls"
    CLOCK = "clock"
    TRACKS = "tracks"
    POINTS = "points"


EVERY_PART = frozenset(TakePart)
# What moves.
MOTION_PARTS = frozenset({TakePart.JOINTS, TakePart.SHAPES, TakePart.CONTROLS})
# What is other than it was where frames lie between those of before.
RETIMED_PARTS = MOTION_PARTS | {TakePart.CLOCK, TakePart.TRACKS, TakePart.POINTS}


def named_take(path: Path | None, option: str = "take") -> Path:
    """Return the file of another take that an option names."""
    if path is None:
        message = f"{option} must name a file with another take"
        raise OptionError(Fault("SCN024", message))
    return path


# A take, the name of a system and of a particle, and what is told the share done.
Segments: TypeAlias = Callable[
    [Take, str, str, Callable[[float], None] | None], FloatArray
]

# From a take, options with keys such as ``colliders``, and how long the first frame is
# held [s], to the take, of which frames may have been read, and its `Colliders`. Shapes
# are in the axes of the rig, and the first frame is at 0 s.
Around: TypeAlias = Callable[[TakeStream, Any, float], tuple[TakeStream, Any]]


@dataclass(frozen=True, slots=True)
class PassContext:
    """What a pass may use beside its take and options."""

    open: Callable[[Path], Take]  # opens another take on the same rig
    folder: Path  # where relative paths in options start
    # Gathers what a pass has to say about its work.
    notices: list[Fault] = field(default_factory=list)
    # Gathers the largest distance in the world by which a pass that solves something
    # missed it [m].
    errors: list[float] = field(default_factory=list)
    # Gathers how well it did, when its last frame is made.
    scores: list[PassScores] = field(default_factory=list)
    # How many frames stand before the take's own and hold its first, for a pass that
    # settles.
    early: int = 0
    # Whether a pass writes files beside the take, which its options name as ``writes``:
    # a bake does, what only looks at a take does not.
    keeps: bool = True
    # Codes of notes that are said once, however many passes find them.
    said: set[str] = field(default_factory=set)
    # Whether time codes of the take are shot frames, which its samples need not be on.
    in_shot: bool = False
    # Told the share done of the frames in hand, 0 to 1, by passes that say that they
    # tell it; None where nobody looks.
    progress: Callable[[float], None] | None = None
    # Simulates a rope or strands of the scene by their name; returns a particle of it,
    # by name or number, and the one before it at every frame of a take, the latter
    # first ``(F, 2, 3)`` [m]. None where there is no scene.
    segments: Segments | None = None
    # Builds what the options of a pass name that is run into: see `Around`. None where
    # there is no scene.
    around: Around | None = None

    def note_once(self, notices: Iterable[Fault]) -> None:
        """Add notices whose code is not said yet."""
        for notice in notices:
            if notice.code not in self.said:
                self.said.add(notice.code)
                self.notices.append(notice)

    def take(self, path: Path | None, option: str = "take") -> Take:
        """Return the take that an option names.

        Raises:
            OptionError: It names none (SCN024).
        """
        return self.open(self.folder / named_take(path, option))


# By option, what raises `OptionError` where its value makes no sense for any take.
OptionChecks: TypeAlias = Mapping[str, Callable[[], object]]
# A pass fills its own options record, which the caller need not know.
ClipRun: TypeAlias = Callable[[Take, Any, PassContext], Take]
StreamRun: TypeAlias = Callable[[TakeStream, Any, PassContext], TakeStream]


def _no_checks(_: object) -> OptionChecks:
    return {}


@dataclass(frozen=True, slots=True)
class EvenTime:
    """Time t of a take comes at ``first + (t - start) · ratio`` of another."""

    start: float  # [time code]
    ratio: float  # above 0
    first: float  # [time code]


def _not_even(_: object, __: Clock) -> EvenTime | None:
    return None


@dataclass(frozen=True, slots=True)
class Pass:
    """One entry of the table of passes."""

    name: str  # as a scene writes it
    summary: str  # what it does, one line
    options: type[Any]  # frozen dataclass of its options, each with a default
    # FRAME and WINDOW passes run on streams and carry their state from block to block;
    # CLIP passes run on whole takes.
    scope: Scope
    # Takes a `TakeStream` (FRAME, WINDOW) or a `Take` (CLIP), the options and the
    # context, and returns the same kind.
    run: ClipRun | StreamRun
    # Takes the options and returns what can be checked of them before there is a take.
    checks: Callable[[Any], OptionChecks] = _no_checks
    # Parts of the take that decide what it does; nothing else shows in it.
    reads: frozenset[TakePart] = EVERY_PART
    # Parts that it may change; all else stays as it is. What stays does so at the time
    # codes that are left, where the clock is among them. A pass that changes neither
    # clock nor tracks does not see what is beside the rig.
    changes: frozenset[TakePart] = EVERY_PART
    # It begins from a state of its own and needs the pre-roll of a shot to come to the
    # take; it keeps the frames that it is given.
    settles: bool = False
    tells: bool = False  # it takes its time, and tells the context its progress
    # Of options and the clock of a take, how its times run evenly in the result, see
    # `EvenTime`: curves of controls stay curves. None changes time otherwise, or more.
    even: Callable[[Any, Clock], EvenTime | None] = _not_even


def find_pass(name: str) -> Pass:
    """Return a pass by its name, those of plug-ins included (unknown: SCN010).

    >>> find_pass("trim").scope
    <Scope.FRAME: 'frame'>
    """
    if name in PASSES:
        return cast(Pass, load_object(PASSES[name]))
    points = plugin_points(PLUGIN_GROUP)
    if name in points:
        return load_plugin(points[name], Pass)
    allowed = sorted({*PASSES, *points})
    near = similar(name, allowed)
    hint = f"did you mean {near}?" if near else None
    message = f"no pass is named {excerpt(name)}; there are {', '.join(allowed)}"
    raise OptionError(Fault("SCN010", message, hint=hint))


@dataclass(frozen=True, slots=True)
class ListedPass:
    """A pass as `animtool plugins` lists it."""

    name: str  # as a scene writes it
    source: str  # ``animtool``, or the object that an entry point names
    scope: Scope | None  # none where it cannot be loaded
    about: str  # what it does, or why it cannot be loaded
    json_keys: ClassVar[str] = "pass=name source scope about"


def listed_passes() -> list[ListedPass]:
    """Return every pass, animtool's own first, each loaded to see whether it can be.

    >>> listed_passes()[0].name
    'blend'
    """
    sources = {name: "animtool" for name in sorted(PASSES)}
    for name, point in sorted(plugin_points(PLUGIN_GROUP).items()):
        sources.setdefault(name, point.value)
    passes = []
    for name, source in sources.items():
        try:
            loaded = find_pass(name)
            passes.append(ListedPass(name, source, loaded.scope, loaded.summary))
        except OptionError as error:
            passes.append(ListedPass(name, source, None, error.faults[0].message))
    return passes


def sees_tracks(pass_: Pass) -> bool:
    """Return whether a pass is given what is beside the rig.

    >>> sees_tracks(find_pass("mirror")), sees_tracks(find_pass("trim"))
    (False, True)
    """
    return bool(pass_.changes & {TakePart.CLOCK, TakePart.TRACKS})


def apply_pass(
    stream: TakeStream, pass_: Pass, options: object, context: PassContext
) -> TakeStream:
    """Return a take with a pass applied; a CLIP pass reads the whole at once.

    Notices and details of the source stay with the stream, and the curves of the
    controls whose frames and values a CLIP pass leaves alone, or whose time it changes
    evenly. A take whose source
    states no first frame still states none, unless the pass moves the frame.
    """
    _check_points(stream, pass_)
    if stream.tracks and not sees_tracks(pass_):
        passthrough = PassthroughTracks(stream)
        done = apply_pass(passthrough.stream, pass_, options, context)
        return passthrough.restore(done)
    if pass_.scope is not Scope.CLIP:
        done = driven_stream(cast(StreamRun, pass_.run)(stream, options, context))
        stays = not pass_.changes & {TakePart.CONTROLS, TakePart.CLOCK}
        curves = stream.control_curves if stays else {}
        curve = stream.curve if _same_rows(stream.rig, done.rig) else None
        done = replace(done, control_curves=curves, curve=curve, altered=True, count=0)
        return checked_tracks(done, stream.tracks, pass_.name)
    before = stream.collect()
    made = cast(ClipRun, pass_.run)(before, options, context)
    take = driven_take(made)
    context.notices.extend(take.notices[len(made.notices) :])
    kept = _kept_curves(stream, before, take, pass_.even(options, before.clock))
    if not _same_rows(before.rig, take.rig):
        take = replace(take, curve=None)
    result = checked_tracks(TakeStream.of(take), before.tracks, pass_.name)
    unstated = stream.start is None and take.clock.start == Fraction(1)
    return replace(
        result,
        start=None if unstated else result.start,
        notices=stream.notices,
        details=stream.details,
        simulated=stream.simulated,
        scores=stream.scores,
        control_curves=kept,
    )


def _kept_curves(
    stream: TakeStream, before: Take, after: Take, even: EvenTime | None
) -> dict[str, Curves]:
    """Return the curves of controls that still hold, at the times of the result."""
    curves = stream.control_curves
    if not curves:
        return {}
    if even is None or before.clock == after.clock:
        kept = _untouched(before, after)
        return {name: curve for name, curve in curves.items() if name in kept}
    return {
        name: curve.retimed(even.start, even.ratio, even.first)
        for name, curve in curves.items()
    }


def _same_rows(rig: Rig, other: Rig) -> bool:
    """Return whether motions of two rigs have the same joints, shapes and controls."""
    return (
        rig.names == other.names
        and [shape.name for shape in rig.shapes] == [s.name for s in other.shapes]
        and [one.name for one in rig.controls] == [c.name for c in other.controls]
    )


def _check_points(stream: TakeStream, pass_: Pass) -> None:
    """Refuse to move joints whose points do not follow them any more."""
    changes = pass_.changes
    if (
        not stream.points
        or TakePart.JOINTS not in changes
        or TakePart.POINTS in changes
    ):
        return
    names = ", ".join(sorted(stream.points))
    message = f"{pass_.name} would move joints away from what is simulated: {names}"
    raise OptionError(Fault("SIM034", message, hint="put simulate behind it"))


def _untouched(before: Take, after: Take) -> set[str]:
    """Return the controls that are in every frame what they were."""
    old, new = before.motion.controls, after.motion.controls
    same = before.clock == after.clock and before.rig.controls == after.rig.controls
    if not same or old is None or new is None:
        return set()
    alike = (old.dense() == new.dense()).all(axis=(0, 2))
    return {before.rig.controls[i].name for i in alike.nonzero()[0].tolist()}
