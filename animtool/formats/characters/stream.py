"""Chooses a character's take, and builds its stream from samples and keys."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np

from animtool.clip.clip import Clip
from animtool.clip.keyed_curve import KeyedCurve
from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import Fault, FormatError, Severity, counted, listed
from animtool.core.names import name_hint
from animtool.core.record import dataclass
from animtool.core.units import unit_name
from animtool.motion.motion import Motion
from animtool.motion.take import TakeStream
from animtool.rig.skeleton import Rig

MAX_LISTED_TAKES = 8
# A take that animates a smaller fraction of the joints than another, such as only a
# control above the skeleton, is not read by default.
MIN_JOINT_FRACTION = 0.2


@dataclass(frozen=True, slots=True)
class TakeMessages:
    """Wording and codes of messages about the takes of a format."""

    noun: str  # the format's word for a take
    static_message: str  # message for a character without a take
    unknown_code: str  # code of the error for an unknown take
    no_take_code: str  # code of the note about a file without takes
    skipped_code: str  # code of the note about takes that are not read


def choose_take(
    messages: TakeMessages,
    path: str,
    names: list[str],
    take: str | None,
    candidates: Sequence[int],
    default_index: int,
) -> tuple[int, list[Fault]]:
    """Return the index of the take to read, or -1 if there is none, and notes.

    Args:
        messages: Wording and codes of the format.
        path: The file.
        names: Names of the takes in the file.
        take: Name of the requested take; None is the default.
        candidates: Indices of takes that can be read without a name.
        default_index: Index of the default; if not a candidate, the first candidate is.
    """
    if take is not None:
        if take in names:
            return names.index(take), []
        message = f"has no {messages.noun} {take!r}"
        fault = Fault(messages.unknown_code, message, path, (), name_hint(take, names))
        raise FormatError(fault)
    if not candidates:
        code, message = messages.no_take_code, messages.static_message
        return -1, [Fault(code, message, path, severity=Severity.NOTE)]
    index = default_index if default_index in candidates else candidates[0]
    if len(candidates) == 1:
        return index, []
    message = f"reading {messages.noun} {names[index]!r} of "
    message += counted(len(candidates), messages.noun)
    hint = f"read another with {argument('source.take')}: "
    hint += listed(names, MAX_LISTED_TAKES)
    return index, [Fault(messages.skipped_code, message, path, (), hint, Severity.NOTE)]


def default_take(joint_counts: Mapping[int, int], preferred: int) -> int:
    """Return the index of the take to read if none is requested.

    It is the preferred one, unless that animates far fewer joints than another take;
    then it is the first of those that do not.

    Args:
        joint_counts: Numbers of animated joints of takes by index, in file order.
        preferred: Index of the take that the file states or lists first.
    """
    min_count = MIN_JOINT_FRACTION * max(joint_counts.values(), default=0)
    if joint_counts.get(preferred, -1) >= min_count:
        return preferred
    indices = (i for i, count in joint_counts.items() if count >= min_count)
    return next(indices, preferred)


def build_sampled_stream(
    rig: Rig, clock: Clock, sample: Callable[[FloatArray], Motion], block_frames: int
) -> TakeStream:
    """Return a stream that samples a take block by block, with rotations aligned.

    Args:
        rig: The rig.
        clock: Frames of the take.
        sample: Returns the motion at time codes ``(F,)``.
        block_frames: Frames per block.
    """
    return TakeStream(
        rig,
        clock.fps,
        clock.start,
        Fraction(1),
        _sample_blocks(clock, sample, block_frames),
        curve=sample,
        count=clock.count,
    )


def _sample_blocks(
    clock: Clock, sample: Callable[[FloatArray], Motion], block_frames: int
) -> Iterator[Motion]:
    times, last_rotations = clock.times, None
    for start in range(0, clock.count, block_frames):
        motion = sample(times[start : start + block_frames])
        rotations = motion.rotations
        if len(rotations.animated):
            if last_rotations is not None:
                sign_products = np.einsum(
                    "jc,jc->j", rotations.values[0], last_rotations
                )
                if (sign_products < 0).any():
                    rotations.values[:, sign_products < 0] *= -1.0
            last_rotations = rotations.values[-1].copy()
        yield motion


def finish_stream(
    stream: TakeStream,
    format_name: str,
    names: list[str],
    index: int,
    build_clip: Callable[[str], tuple[Clip, list[Fault]]],
    native_keys: object = None,
) -> TakeStream:
    """Add the keys of the take, and details about the file, to a stream.

    Args:
        stream: The stream.
        format_name: Name of the file format.
        names: Names of the file's takes.
        index: Index of the take; -1 for none.
        build_clip: Returns the take's keys as a named clip, and notices.
        native_keys: Keys as stored in the file; see `KeyedCurve`.
    """
    name = names[index] if index >= 0 else None
    if name is not None:

        def build_keys() -> Clip:
            clip, notices = build_clip(name)
            return replace(clip, notices=tuple(notices))

        assert stream.curve is not None
        stream.curve = KeyedCurve(
            stream.curve, build_keys, is_foreign=True, native_keys=native_keys
        )
    stream.details = {
        "format": format_name,
        "units": unit_name(stream.rig.meters_per_unit),
        "take": name,
        "takes": names,
    }
    return stream
