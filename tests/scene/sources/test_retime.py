"""Takes that begin before their first frame."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.formats.bvh.read import read_bvh
from animtool.motion.motion import Motion
from animtool.motion.take import TakeStream
from animtool.scene.sources.retime import with_preroll


def test_the_first_frame_is_held_by_the_frames_and_by_the_curve(walk: Path) -> None:
    take = read_bvh(walk).collect()
    asked: list[float] = []

    def curve(times: FloatArray) -> Motion:
        asked.extend(times.tolist())
        return take.motion

    keyed = replace(TakeStream.of(take), curve=curve, count=take.motion.frames)
    early = with_preroll(keyed, 3)
    assert early.altered
    assert early.curve is not None
    first = float(take.clock.start)
    early.curve(np.array([first - 2.5, first + 0.5]))
    assert asked == [first, first + 0.5]
    found = early.collect()
    assert found.clock.start == take.clock.start - 3 * Fraction(take.clock.step)
    for name in ("translations", "rotations"):
        was = getattr(take.motion, name).dense()
        now = getattr(found.motion, name).dense()
        np.testing.assert_array_equal(now[3:], was)
        np.testing.assert_array_equal(now[:3], was[[0, 0, 0]])
