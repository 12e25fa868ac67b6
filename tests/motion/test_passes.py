"""Tracks kept aside while a pass runs that has no use for them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from support.faults import raises
from support.small_takes import small, with_tracks

from animtool.core.errors import OptionError
from animtool.motion.motion import Motion
from animtool.motion.passes import FrameScope, Pass, PassContext, TakePart, apply_pass
from animtool.motion.take import Take, TakeStream

CONTEXT = PassContext(lambda _: small(), None)  # type: ignore[arg-type]


@dataclass(frozen=True)
class NoOptions:
    """Nothing to choose."""


def reblocked(stream: TakeStream, size: int) -> Iterator[Motion]:
    """Yield the frames of a take in blocks of a size, built anew without tracks."""
    motion = Motion.concatenate(list(stream.blocks))
    for first in range(0, motion.frames, size):
        part = motion.select(slice(first, first + size))
        yield Motion(part.translations, part.rotations)


@given(st.integers(1, 20), st.lists(st.integers(1, 19), max_size=5))
def test_blocks_get_the_tracks_of_their_frames(size: int, cuts: list[int]) -> None:
    take = with_tracks(small())
    stream = TakeStream.of(take)
    parts = np.split(np.arange(take.clock.count), sorted(set(cuts)))
    stream.blocks = iter([take.motion.select(part) for part in parts if len(part)])
    plain = Pass(
        "plain",
        "Builds motions anew",
        NoOptions,
        FrameScope.FRAME,
        lambda s, *_: replace(s, blocks=reblocked(s, size)),
        changes=frozenset({TakePart.JOINTS}),
    )
    found = apply_pass(stream, plain, NoOptions(), CONTEXT).collect()
    assert found.tracks == take.tracks
    assert_array_equal(
        found.motion.track_times.dense(), take.motion.track_times.dense()
    )


def forgetting(take: Take) -> Take:
    """Return a take of every other frame whose motion is built anew."""
    motion = take.motion.select(slice(None, None, 2))
    motion = Motion(motion.translations, motion.rotations)
    clock = replace(take.clock, count=motion.frames)
    return Take(take.rig, clock, motion)


@pytest.mark.parametrize("scope", [FrameScope.CLIP, FrameScope.FRAME])
def test_a_pass_that_loses_tracks_is_refused(scope: FrameScope) -> None:
    def run(given: object, *_: object) -> object:
        if isinstance(given, Take):
            return forgetting(given)
        return replace(given, blocks=reblocked(given, 4))

    loser = Pass("loser", "Loses tracks", NoOptions, scope, run)
    stream = TakeStream.of(with_tracks(small()))
    with raises(OptionError, "SCN045"):
        apply_pass(stream, loser, NoOptions(), CONTEXT).collect()
