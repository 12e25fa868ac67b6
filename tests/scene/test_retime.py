"""Takes that begin before their first frame."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool.formats.bvh import read_bvh
from animtool.scene.retime import begun_early
from animtool.take import TakeStream


def test_the_first_frame_is_held_and_no_curve_tells_otherwise(walk: Path) -> None:
    take = read_bvh(walk).collect()
    stream = TakeStream.of(take)
    keyed = replace(stream, curve=lambda _: take.motion, count=take.motion.frames)
    early = begun_early(keyed, 3)
    assert early.curve is None
    found = early.collect()
    assert found.clock.start == take.clock.start - 3 * Fraction(take.clock.step)
    for name in ("translations", "rotations"):
        was = getattr(take.motion, name).dense()
        now = getattr(found.motion, name).dense()
        np.testing.assert_array_equal(now[3:], was)
        np.testing.assert_array_equal(now[:3], was[[0, 0, 0]])
