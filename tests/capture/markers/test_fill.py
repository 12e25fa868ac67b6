"""Spikes, swaps and gaps of made captures are found, and repaired."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from animtool.capture.markers.fill import fill_markers
from animtool.capture.markers.label import label_points
from animtool.capture.options import FillOptions
from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import OptionError
from animtool.maths import so3
from animtool.motion.markers import Markers

FRAMES, RATE = 300, 120
# Two rigid bodies of five markers, the second on a hinge of the first [m].
BODY = np.random.default_rng(6).uniform(-0.15, 0.15, (5, 3))
OTHER = np.random.default_rng(7).uniform(-0.15, 0.15, (5, 3))
OTHER += np.array([0.5, 0.0, 0.0])


def paths(noise: float = 2e-4) -> FloatArray:
    """Return positions of two bodies that turn and walk ``(F, 10, 3)``."""
    t = np.arange(FRAMES) / RATE
    rotation = so3.exp(np.stack([np.sin(t), 0.5 * t, np.cos(2 * t)], 1))
    hinge = so3.exp(np.stack([0 * t, 0 * t, np.sin(3 * t)], 1))
    first = so3.rotate(rotation[:, None], BODY[None])
    second = so3.rotate(rotation[:, None], so3.rotate(hinge[:, None], OTHER[None]))
    walk = np.stack([1.2 * t, 1.0 + 0.05 * np.sin(9 * t), 0 * t], 1)[:, None]
    both = np.concatenate([first, second], axis=1) + walk
    return np.asarray(both + np.random.default_rng(8).normal(0, noise, both.shape))


def made(positions: FloatArray) -> Markers:
    names = tuple(f"M{i}" for i in range(positions.shape[1]))
    return Markers(names, Clock(RATE, 1, 1, len(positions)), positions)


def test_nothing_is_changed_where_nothing_is_wrong() -> None:
    markers = made(paths())
    whole, report = fill_markers(markers)
    np.testing.assert_array_equal(whole.positions, markers.positions)
    assert whole.filled is None
    assert not [*report.gaps, *report.spikes, *report.swaps, *report.notices]


def test_a_short_and_a_long_gap() -> None:
    truth = paths(0.0)
    positions = paths()
    positions[100:105, 2] = positions[150:200, 7] = np.nan
    whole, report = fill_markers(made(positions))
    assert [(g.marker, g.first, g.last, g.method) for g in report.gaps] == [
        ("M2", 100, 104, "curve"),
        ("M7", 150, 199, "markers"),
    ]
    off = np.linalg.norm(whole.positions - truth, axis=-1)
    assert off[100:105, 2].max() < 1e-3
    assert off[150:200, 7].max() < 2e-3
    assert whole.filled is not None
    assert int(whole.filled.sum()) == report.filled == 55


def test_a_spike_and_a_swap() -> None:
    truth = paths(0.0)
    positions = paths()
    positions[50:52, 3] += (0.03, 0.0, 0.02)
    positions[120:170, [1, 8]] = positions[120:170, [8, 1]]
    whole, report = fill_markers(made(positions))
    assert [(s.marker, s.first, s.last) for s in report.spikes] == [("M3", 50, 51)]
    assert [(s.markers, s.first, s.last) for s in report.swaps] == [
        (("M1", "M8"), 120, 169)
    ]
    assert np.linalg.norm(whole.positions - truth, axis=-1).max() < 2e-3


def test_what_is_kept() -> None:
    positions = paths()
    positions[50:52, 3] += 0.05
    positions[100:103, 2] = np.nan
    options = FillOptions(keep_gaps=True, keep_spikes=True, keep_swaps=True)
    whole, report = fill_markers(made(positions), options)
    np.testing.assert_array_equal(whole.positions, positions)
    assert report.left == 3


def test_a_last_value_is_never_held() -> None:
    """A gap that nothing says anything about is left, and reported."""
    positions = paths()[:, :2]
    positions[100:, 0] = np.nan
    whole, report = fill_markers(made(positions))
    assert np.isnan(whole.positions[100:, 0]).all()
    assert [notice.code for notice in report.notices] == ["MKR111"]


@pytest.mark.parametrize(("longest", "codes"), [(0.25, []), (30.0, ["MKR112"])])
def test_a_limit_in_frames_is_reported(longest: float, codes: list[str]) -> None:
    positions = paths()[:, :2]
    positions[50:52, 0] = np.nan
    _, report = fill_markers(made(positions), FillOptions(longest=longest))
    assert [
        notice.code for notice in report.notices if notice.code != "MKR111"
    ] == codes


def test_the_rest_of_a_take_does_not_matter() -> None:
    """A curve over a gap is the same bytes in a part of the take."""
    positions = paths()
    positions[100:104, 2] = np.nan
    whole, _ = fill_markers(made(positions))
    part, _ = fill_markers(made(positions[60:160]))
    np.testing.assert_array_equal(whole.positions[100:104, 2], part.positions[40:44, 2])


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("seen", [0, 1, 5])
def test_hardly_anything_is_seen(count: int, seen: int) -> None:
    positions = np.full((5, count, 3), np.nan)
    positions[:seen] = paths()[:seen, :count]
    whole, report = fill_markers(made(positions))
    np.testing.assert_array_equal(whole.positions, positions)
    assert report.left == (5 - seen) * count


def test_points_get_names_whatever_their_order() -> None:
    rng = np.random.default_rng(9)
    truth = paths()
    shuffled = np.full((FRAMES, 12, 3), np.nan)
    for frame in range(FRAMES):
        shuffled[frame, rng.permutation(12)[:10]] = truth[frame]
    shuffled[50:90][np.isnan(shuffled[50:90])] = 3.0  # reflections
    cloud = made(shuffled)
    cloud = replace(cloud, names=tuple(f"*{i}" for i in range(12)))
    static = made(np.repeat(np.concatenate([BODY, OTHER])[None], 20, axis=0))
    named, report = label_points(cloud, static)
    assert named.names == static.names
    right = (named.positions == truth).all(axis=-1)
    assert right[named.visible].all()
    assert right.mean() > 0.995
    assert report.rejected >= 40


@pytest.mark.parametrize(("code", "count"), [("MKR020", 3), ("MKR021", 10)])
def test_what_cannot_be_named(code: str, count: int) -> None:
    static = made(np.random.default_rng(3).normal(size=(1, count, 3)).repeat(20, 0))
    with pytest.raises(OptionError) as caught:
        label_points(made(paths()), static)
    assert caught.value.code == code


@pytest.mark.parametrize("size", [1e6, 1e12, 1e18])
def test_a_wild_sample_that_is_kept_keeps_numbers_finite(size: float) -> None:
    wild = paths()
    wild[100, 2, 0] = size
    wild[120:150, 2] = np.nan
    wild[120:150, 7] = np.nan
    filled, report = fill_markers(made(wild), FillOptions(keep_spikes=True))
    assert report.left == 0
    others = np.delete(filled.positions, 2, axis=1)
    assert np.abs(others).max() < 5.0
    assert np.isfinite(filled.positions).all()


@pytest.mark.parametrize(("length", "left"), [(5, 0), (6, 0), (7, 7)])
def test_the_longest_gap_is_filled_and_no_longer_one(length: int, left: int) -> None:
    """At 120 frames a second 50 ms are 6 frames."""
    positions = paths()
    positions[100 : 100 + length, 2] = np.nan
    _, report = fill_markers(made(positions), FillOptions(longest=0.05))
    assert (report.left, bool(report.gaps[0].method)) == (left, left == 0)
