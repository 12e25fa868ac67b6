"""Captures with known cycles and known noise: what is found, and what is left."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.data import data_files

from animtool import open_source
from animtool.capture.clean import CleanOptions, clean_take
from animtool.core.array_types import FloatArray
from animtool.edit import find_cycle
from animtool.maths import so3


@pytest.mark.parametrize("path", data_files("mocap", "warp_*.truth.npz"))
def test_the_cycle_is_found_within_a_frame(path: Path) -> None:
    source = path.with_name(path.name.replace(".truth.npz", ".a.bvh"))
    take = open_source(source).collect()
    truth = float(np.load(path)["cycle_s"]) * float(take.clock.rate)
    cycle = find_cycle(take)
    assert abs(cycle.last - cycle.first - truth) <= 1


@pytest.mark.parametrize("path", data_files("mocap", "*.degraded.bvh"))
def test_jitter_is_lessened(path: Path) -> None:
    """What the joints turn from frame to frame beyond the source is nearer to it."""
    source = path.with_name(path.name.replace(".degraded.", ".source."))
    truth = open_source(source).collect().motion.rotations.dense()
    dirty = open_source(path).collect()
    cleaned, signals = clean_take(dirty, CleanOptions())
    assert not any(signal.spikes for signal in signals)
    before, after = (
        _steps_off(take.motion.rotations.dense(), truth) for take in (dirty, cleaned)
    )
    assert after < 0.7 * before


def _steps_off(turns: FloatArray, truth: FloatArray) -> float:
    """Return how far the turns from frame to frame are off, root mean square [rad]."""
    steps = [so3.multiply(so3.conjugate(q[:-1]), q[1:]) for q in (turns, truth)]
    return float(np.sqrt(np.mean(so3.angle_between(*steps) ** 2)))
