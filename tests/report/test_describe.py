from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose
from support.bvh import random_rows, read_reference, small_bvh
from support.drifting import author_samples

from animtool.report import describe as module
from animtool.report.describe import describe


def test_numbers(tmp_path: Path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "take.bvh"
    rows = random_rows(30)
    rows[:, 6:] = 5.0
    path.write_text(small_bvh(rows, frame_time="0.0417083750417"))
    monkeypatch.setattr(module, "FRAMES_AT_ONCE", 7)
    found = describe(path)
    truth = read_reference(path).positions(np.arange(30))
    assert_allclose(found.bounds[0], truth.min(axis=(0, 1)), rtol=1e-12)
    assert_allclose(found.bounds[1], truth.max(axis=(0, 1)), rtol=1e-12)
    assert found.animated == {"translation": 1, "rotation": 1}
    values = found.as_dict()
    assert values["rate"] == "24000/1001"
    assert json.dumps(values)


def test_frames_between_time_codes(tmp_path: Path) -> None:
    """The rate is that of frames, and what lies between time codes its step."""
    times = [1 + 1.25 * i for i in range(9)]
    found = describe(author_samples(tmp_path / "in.usda", times, rate=30))
    assert (found.fps, found.step, found.frames) == (24, Fraction(5, 4), 9)
    assert (found.start, found.end, found.duration) == (1, 11, Fraction(1, 3))
