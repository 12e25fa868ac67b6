"""A take of a character as a stream: its choice, its blocks and its keys."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np

from animtool.clip.clip import Clip
from animtool.clip.keyed_curve import KeyedCurve
from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import Fault, FormatError, Severity, counted, listed
from animtool.core.names import nearest
from animtool.core.record import dataclass
from animtool.core.units import unit_name
from animtool.motion.motion import Motion
from animtool.motion.take import TakeStream
from animtool.rig.skeleton import Rig

MAX_LISTED_TAKES = 8


@dataclass(frozen=True, slots=True)
class TakeMessages:
    """Words and codes of messages about the takes of a format.

    Attributes:
        noun: The format's word for a take.
        static: Message for a character without a take.
        unknown: Code of the error for an unknown take.
        none: Code of the note that there is no take.
        several: Code of the note that one of several is read.
    """

    noun: str
    static: str
    unknown: str
    none: str
    several: str


def choose_take(
    words: TakeMessages,
    path: str,
    names: list[str],
    take: str | None,
    candidates: Sequence[int],
    default: int,
) -> tuple[int, list[Fault]]:
    """Return the index of the take to read, -1 for none, and notes.

    Args:
        words: Words and codes of the format.
        path: The file.
        names: Names of its takes.
        take: Name of the requested take; None is the default.
        candidates: Indices of takes that can be read without a name.
        default: Index of the default; the first candidate if it is none of them.
    """
    if take is not None:
        if take in names:
            return names.index(take), []
        message = f"has no {words.noun} {take!r}"
        fault = Fault(words.unknown, message, path, (), nearest(take, names))
        raise FormatError(fault)
    if not candidates:
        return -1, [Fault(words.none, words.static, path, severity=Severity.NOTE)]
    index = default if default in candidates else candidates[0]
    if len(candidates) == 1:
        return index, []
    count = counted(len(candidates), words.noun)
    message = f"reading {words.noun} {names[index]!r} of {count}"
    listed_names = listed(names, MAX_LISTED_TAKES)
    hint = f"read another with {argument('source.take')}: {listed_names}"
    return index, [Fault(words.several, message, path, (), hint, Severity.NOTE)]


def sampled_stream(
    rig: Rig, clock: Clock, sample: Callable[[FloatArray], Motion], block: int
) -> TakeStream:
    """Return a take as a stream, sampled block by block.

    Args:
        rig: The rig.
        clock: Frames of the take.
        sample: Returns the motion at time codes ``(F,)``.
        block: Frames per block.
    """
    return TakeStream(
        rig,
        clock.fps,
        clock.start,
        Fraction(1),
        _blocks(clock, sample, block),
        curve=sample,
        count=clock.count,
    )


def _blocks(
    clock: Clock, sample: Callable[[FloatArray], Motion], block: int
) -> Iterator[Motion]:
    times, previous = clock.times, None
    for at in range(0, clock.count, block):
        motion = sample(times[at : at + block])
        rotations = motion.rotations
        if len(rotations.animated):
            if previous is not None:
                signs = np.einsum("jc,jc->j", rotations.values[0], previous)
                if (signs < 0).any():
                    rotations.values[:, signs < 0] *= -1.0
            previous = rotations.values[-1].copy()
        yield motion


def finish_stream(
    stream: TakeStream,
    format_name: str,
    names: list[str],
    index: int,
    clip: Callable[[str], tuple[Clip, list[Fault]]],
    native: object = None,
) -> TakeStream:
    """Return a stream with the keys of its take, and details about the file.

    Args:
        stream: The stream.
        format_name: Name of the file format.
        names: Names of the file's takes.
        index: Index of the take; -1 for none.
        clip: Returns the take's keys as a clip of a given name, and notices.
        native: Keys as stored in the file; see `KeyedCurve`.
    """
    name = names[index] if index >= 0 else None
    if name is not None:

        def keys() -> Clip:
            built, notices = clip(name)
            return replace(built, notices=tuple(notices))

        assert stream.curve is not None
        stream.curve = KeyedCurve(stream.curve, keys, foreign=True, native=native)
    stream.details = {
        "format": format_name,
        "units": unit_name(stream.rig.meters_per_unit),
        "take": name,
        "takes": names,
    }
    return stream
