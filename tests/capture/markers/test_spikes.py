"""Spikes are found beside gaps and ends of a take, and corners are none."""

from __future__ import annotations

import numpy as np
import pytest
from capture.markers.test_fill import FRAMES, made, paths
from support.suite import some_quick

from animtool.capture.markers.spikes import find_spikes

AWAY = np.array([0.02, -0.01, 0.015])


@pytest.mark.parametrize("length", [1, 2, 3, 4])
@pytest.mark.parametrize("before", some_quick([1, 2, 8], 3))
@pytest.mark.parametrize("gap", [3, 40])
def test_a_spike_before_a_gap(length: int, before: int, gap: int) -> None:
    """A spike some frames before a gap is those frames and no others."""
    positions = paths()
    first = 150 - length - before
    positions[first : first + length, 3] += AWAY
    positions[150 : 150 + gap, 3] = np.nan
    found = find_spikes(made(positions))
    assert [(s.marker, s.first, s.last) for s in found] == [
        ("M3", first, first + length - 1)
    ]


@pytest.mark.parametrize("first", [0, 2, 5, FRAMES - 6, FRAMES - 1])
def test_a_spike_at_an_end(first: int) -> None:
    positions = paths()
    positions[first, 7] += 2 * AWAY
    found = find_spikes(made(positions))
    assert [(s.first, s.last) for s in found] == [(first, first)]
    assert found[0].size == pytest.approx(2 * np.linalg.norm(AWAY), rel=0.2)


def test_two_spikes_near_each_other() -> None:
    positions = paths()
    positions[100, 2] += AWAY
    positions[104:106, 2] -= 3 * AWAY
    found = find_spikes(made(positions))
    assert [(s.first, s.last) for s in found] == [(100, 100), (104, 105)]


@pytest.mark.parametrize("noise", [1e-4, 5e-4, 1e-3])
def test_noise_is_no_spike(noise: float) -> None:
    assert find_spikes(made(paths(noise))) == []


def test_a_corner_is_no_spike() -> None:
    """A foot that lands stops within a frame."""
    positions = paths()
    steps = np.clip(np.arange(FRAMES) - 120, 0, None)[:, None] * (0.004, -0.003, 0.0)
    positions[:, 4] += steps
    assert find_spikes(made(positions)) == []
