from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from animtool.motion.motion import Channel, Motion
from animtool.scene.bake import deformed_character
from animtool.scene.bake.deformed_character import motion_chunks


def motion_of(codes: np.ndarray) -> Motion:
    moves = np.repeat(codes[:, None, None], 3, axis=2)
    turns = np.tile([0.0, 0, 0, 1], (len(codes), 1, 1))
    everything = np.arange(1)
    return Motion(
        Channel(moves[0], everything, moves), Channel(turns[0], everything, turns)
    )


def blocks(lengths: list[int]) -> Iterator[tuple[np.ndarray, Motion]]:
    begin = 0
    for length in lengths:
        codes = np.arange(begin, begin + length, dtype=np.float64)
        yield codes, motion_of(codes)
        begin += length


@given(
    st.lists(st.integers(1, 20), min_size=1, max_size=5),
    st.integers(1, 9),
    st.booleans(),
)
def test_pieces_are_the_motion_with_their_neighbours(
    lengths: list[int], most: int, neighbours: bool
) -> None:
    count = sum(lengths)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(deformed_character, "CHUNK_FRAMES", most)
        found = list(
            motion_chunks(blocks(lengths), includes_neighbour_frames=neighbours)
        )
    own = []
    for codes, motion, kept in found:
        assert_array_equal(motion.translations.dense()[:, 0, 0], codes)
        own += codes[kept].tolist()
        first, last = codes[kept][0], codes[kept][-1]
        assert kept.stop - kept.start <= most
        ends = [max(first - 1, 0), min(last + 1, count - 1)]
        assert codes[[0, -1]].tolist() == (ends if neighbours else [first, last])
    assert own == list(range(count))
