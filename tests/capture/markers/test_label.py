"""Labelling of made clouds: every point its own name, and doubts said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.clouds import MARKER_SETS, cloud
from support.faults import raises
from support.named import scores_of
from support.suite import is_full

from animtool.capture.markers.label import label
from animtool.capture.markers.twins import exchanged_in, told_apart
from animtool.core.errors import OptionError
from animtool.maths import so3

NAMED = 0.995
SEEDS = range(1000, 1010)
# Nine in ten only in the full profile: a second each.
MADE = [
    pytest.param(
        seed,
        marks=pytest.mark.skipif(
            not is_full() and seed != SEEDS[0],
            reason="for --hypothesis-profile=full",
        ),
    )
    for seed in SEEDS
]


@pytest.mark.parametrize("seed", MADE)
def test_points_of_made_people_get_their_names(seed: int) -> None:
    made = cloud(seed)
    points = made.markers("unlabelled_mm")
    named, _ = label(points, made.markers("static_mm"))
    assert min(scores_of(named, points, made.truth["perm"])) >= NAMED


@pytest.mark.slow
@pytest.mark.parametrize("markers", MARKER_SETS)
def test_short_takes_get_their_names(markers: str) -> None:
    made = cloud(200, "rom", markers, 300)
    points = made.markers("unlabelled_mm")
    named, report = label(points, made.markers("static_mm"))
    assert min(scores_of(named, points, made.truth["perm"])) >= NAMED
    assert report.labelled + report.rejected == report.points


def test_another_subject_is_refused() -> None:
    made = cloud(200, "rom", "body41", 300)
    static = made.markers("static_mm")
    giant = replace(static, positions=3.7 * static.positions)
    with raises(OptionError, "MKR021"):
        label(made.markers("unlabelled_mm"), giant)


def test_markers_that_lie_alike_are_named_with_their_frames() -> None:
    """Two markers that turn about the line of all others could be each other."""
    rng = np.random.default_rng(3)
    shape = np.array(
        [(0, 0, 0), (0.3, 0, 0), (0.6, 0, 0), (0.45, 0.1, 0), (0.45, -0.1, 0)], float
    )
    frames = 200
    positions = np.tile(shape, (frames, 1, 1))
    angle = np.linspace(0.0, np.pi, frames)
    turned = 0.1 * np.stack([np.zeros(frames), np.cos(angle), np.sin(angle)], axis=1)
    positions[:, 3, 1:] = turned[:, 1:]
    positions[:, 4, 1:] = -turned[:, 1:]
    positions += rng.normal(0.0, 3e-4, positions.shape)
    names, doubts, _ = told_apart(positions, shape)
    assert names.tolist() == [0, 1, 2, 3, 4]
    assert (3, 4) in {doubt.markers for doubt in doubts}
    assert all(doubt.score <= 0.0 for doubt in doubts)


@pytest.mark.parametrize(("apart", "told"), [(0.0002, False), (0.001, True)])
def test_twins_are_told_apart_by_shapes_that_are_off_by_more_than_noise(
    apart: float, told: bool
) -> None:
    """Beside a line half a turn exchanges them, but for how far along it they are.

    Exchanged they are off by 0.7 of that each; of a fifth of a millimetre that says
    10 log(1 + 0.14), and of one millimetre 10 log(1 + 0.7), where 2 are wanted.
    """
    line = np.zeros((5, 3))
    line[:, 2] = [-2.0, -1.5, 1.5, 2.0, 2.5]
    twins = np.array([[0.1, 0.0, apart / 2], [-0.1, 0.0, -apart / 2]])
    shape = np.concatenate([twins, line])
    rng = np.random.default_rng(2)
    turns = so3.exp(rng.standard_normal((40, 3)))
    seen = so3.rotate(turns[:, None], shape) + rng.standard_normal((40, 1, 3))
    assert not exchanged_in(seen, shape, (0, 1))
    wrong = seen[:, [1, 0, 2, 3, 4, 5, 6]]
    assert exchanged_in(wrong, shape, (0, 1)) == told


def test_exchanged_twins_are_put_right() -> None:
    made = cloud(201, "walk", "body41", 400)
    true = made.truth["markers_mm"].astype(float) / 1000.0
    rest = np.median(made.markers("static_mm").positions, axis=0)
    names = [str(name) for name in made.arrays["marker_names"]]
    wrong = np.arange(len(names))
    a, b = names.index("LWRA"), names.index("LWRB")
    wrong[[a, b]] = b, a
    told, _, _ = told_apart(true[:, wrong], rest)
    assert told[a] == b
    assert told[b] == a
    assert (np.delete(told, [a, b]) == np.delete(np.arange(len(names)), [a, b])).all()
