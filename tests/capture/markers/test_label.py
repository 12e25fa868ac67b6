"""Labelling of made clouds: every point its own name, and doubts said."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest
from support.clouds import MARKER_SETS, cloud
from support.faults import raises
from support.figures import check_figures
from support.named import scores_of
from support.suite import is_full

from animtool.capture.markers.geometry import MarkerDistances
from animtool.capture.markers.label import (
    MAX_RIGID_SPREAD,
    SEED_PARTNERS,
    _find_first_span,
    _match_markers,
    _merge_seeds,
    _rigid_groups,
    _shape_error,
    _swap_where_better,
    label_points,
)
from animtool.capture.markers.runs import TrackletLabels
from animtool.capture.markers.tracklets import Tracklets
from animtool.capture.markers.twins import distinguish_twins, is_swapped
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


@pytest.mark.slow
@pytest.mark.parametrize("seed", MADE)
def test_points_of_made_people_get_their_names(seed: int) -> None:
    made = cloud(seed)
    points = made.markers("unlabelled_mm")
    named, report = label_points(points, made.markers("static_mm"))
    assert min(scores_of(named, points, made.truth["perm"])) >= NAMED
    if seed == SEEDS[0]:
        check_figures(
            __file__,
            "label",
            {"at": named.positions, "names": named.names, "report": asdict(report)},
        )


@pytest.mark.slow
@pytest.mark.parametrize("markers", MARKER_SETS)
def test_short_takes_get_their_names(markers: str) -> None:
    made = cloud(200, "rom", markers, 300)
    points = made.markers("unlabelled_mm")
    named, report = label_points(points, made.markers("static_mm"))
    assert min(scores_of(named, points, made.truth["perm"])) >= NAMED
    assert report.labelled + report.rejected == report.points


def test_another_subject_is_refused() -> None:
    made = cloud(200, "rom", "body41", 300)
    static = made.markers("static_mm")
    giant = replace(static, positions=3.7 * static.positions)
    with raises(OptionError, "MKR021", match="any segment of trial.c3d"):
        label_points(made.markers("unlabelled_mm"), giant, "trial.c3d")


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
    names, doubts, _ = distinguish_twins(positions, shape)
    assert names.tolist() == [0, 1, 2, 3, 4]
    assert (3, 4) in {doubt.markers for doubt in doubts}
    assert all(doubt.score <= 0.0 for doubt in doubts)


@pytest.mark.parametrize(("apart", "told"), [(0.0002, False), (0.001, True)])
def test_twins_are_told_apart_by_shapes_that_are_off_by_more_than_noise(
    apart: float, told: bool
) -> None:
    """Beside a line half a turn swaps them, but for how far along it they are.

    Swapped they are off by 0.7 of that each; of a fifth of a millimetre that says
    10 log(1 + 0.14), and of one millimetre 10 log(1 + 0.7), where 2 are wanted.
    """
    line = np.zeros((5, 3))
    line[:, 2] = [-2.0, -1.5, 1.5, 2.0, 2.5]
    twins = np.array([[0.1, 0.0, apart / 2], [-0.1, 0.0, -apart / 2]])
    shape = np.concatenate([twins, line])
    rng = np.random.default_rng(2)
    turns = so3.exp(rng.standard_normal((40, 3)))
    seen = so3.rotate(turns[:, None], shape) + rng.standard_normal((40, 1, 3))
    assert not is_swapped(seen, shape, (0, 1))
    wrong = seen[:, [1, 0, 2, 3, 4, 5, 6]]
    assert is_swapped(wrong, shape, (0, 1)) == told


def test_swapped_twins_are_put_right() -> None:
    made = cloud(201, "walk", "body41", 400)
    true = made.truth["markers_mm"].astype(float) / 1000.0
    rest = np.median(made.markers("static_mm").positions, axis=0)
    names = [str(name) for name in made.arrays["marker_names"]]
    wrong = np.arange(len(names))
    a, b = names.index("LWRA"), names.index("LWRB")
    wrong[[a, b]] = b, a
    told, _, _ = distinguish_twins(true[:, wrong], rest)
    assert told[a] == b
    assert told[b] == a
    assert (np.delete(told, [a, b]) == np.delete(np.arange(len(names)), [a, b])).all()


def test_groups_of_four_are_of_the_most_rigid_company() -> None:
    """In a row each goes with the seven nearest, of equals the first."""
    count = SEED_PARTNERS + 2
    spread = 1e-4 * np.abs(np.arange(count)[:, None] - np.arange(count)) * 1.0
    spread[3, 5] = spread[5, 3] = MAX_RIGID_SPREAD
    spread[6, 7] = spread[7, 6] = np.nan
    found = _rigid_groups(MarkerDistances(spread, spread))
    worst = [max(spread[a, b] for a in g for b in g) for g in map(list, found)]
    assert worst == sorted(worst)
    assert found[0] == (0, 1, 2, 3)  # the worst 3e-4, as of others that come later
    assert (0, 1, 2, SEED_PARTNERS) in found
    assert (0, 1, 2, SEED_PARTNERS + 1) not in found
    assert not any({3, 5} <= set(group) or {6, 7} <= set(group) for group in found)


def test_groups_are_matched_by_all_their_distances() -> None:
    shape = np.array(
        [[0.0, 0, 0], [0.1, 0, 0], [0.3, 0.1, 0], [0, 0.2, 0.4], [1, 1, 1]]
    )
    rest = np.linalg.norm(shape[:, None] - shape, axis=-1)
    order = [3, 0, 4, 1, 2]  # the marker of each run
    apart = rest[np.ix_(order, order)]
    assert _match_markers((0, 1, 3, 4), apart, rest, 1e-6) == [(3, 0, 1, 2)]
    assert _match_markers((2, 4), apart, rest, 1e-6) == [(2, 4), (4, 2)]
    assert _match_markers((0, 1, 3, 4), 1.1 * apart, rest, 1e-6) == []


def test_a_shape_is_off_by_the_median_of_what_frames_leave() -> None:
    """Nothing where it is turned; of a pair half of what it is longer."""
    shape = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.3]])
    turned = so3.rotate(so3.exp(np.array([0.3, -1.0, 0.5])), shape)
    turned += np.array([1.0, 2, 3])
    assert _shape_error(np.stack([turned] * 9), shape) < 1e-9
    pair = np.array([[0.0, 0, 0], [1.0, 0, 0]])
    # Each end of a longer pair is off by half of what it is longer.
    points = np.stack([1.2 * pair] * 17)
    assert _shape_error(points, pair) == pytest.approx(0.1)
    points[8:] = 1.4 * pair
    assert _shape_error(points, pair) == pytest.approx(0.2)
    assert _shape_error(np.full((9, 2, 3), np.nan), pair) == np.inf


def test_groups_that_contradict_a_better_one_are_left_out() -> None:
    together = np.ones((5, 5), bool)
    together[1, 4] = together[4, 1] = False
    seeds = [{0: 7, 1: 8}, {1: 9, 2: 6}, {2: 7}, {3: 5}, {4: 8}]
    assert _merge_seeds(seeds, together) == {0: 7, 1: 8, 3: 5, 4: 8}
    assert _merge_seeds([], together) == {}


def test_the_ten_seconds_with_most_of_longer_runs_are_named_first() -> None:
    """Windows begin a quarter apart; runs of 30 frames in it do not count in a sum."""
    first = np.array([0, 50, 115, 270, 120])
    last = np.array([54, 180, 144, 299, 219])
    tracklets = Tracklets(np.zeros((300, 1), int), first, last)
    # From 0 on 55 + 50, from 25 on 75 (30 of the first), from 50 on 100, 75 to 174:
    # 100 + 55, from 100 on 81 + 100, from 125 on 56 + 95.
    window, runs = _find_first_span(tracklets, 300, 10.0)
    assert (window, runs.tolist()) == (slice(100, 200), [1, 2, 4])
    short, runs = _find_first_span(tracklets, 20, 10.0)
    assert (short, runs.tolist()) == (slice(0, 20), [0])
    # Of 40 frames 31 of a run count, and two of 30 do not; one of 30 is named too.
    first, last = np.array([0, 20, 20, 0]), np.array([30, 49, 49, 29])
    window, runs = _find_first_span(
        Tracklets(np.zeros((60, 1), int), first, last), 60, 4.0
    )
    assert (window, runs.tolist()) == (slice(0, 40), [0, 3])
    # The last frame of a window counts: 31 to the end of the first, before 31 later.
    first, last = np.array([9, 21]), np.array([39, 51])
    window, runs = _find_first_span(
        Tracklets(np.zeros((60, 1), int), first, last), 60, 4.0
    )
    assert (window, runs.tolist()) == (slice(0, 40), [0])


@pytest.mark.parametrize("said", [[False, True], [True, False], [True, True]])
def test_names_are_swapped_in_parts(
    said: list[bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames 0 to 3 and 5 to 7, of which both runs of each go on; the third stays."""
    ids = np.array([[0, 1, 4]] * 4 + [[-1, -1, 4]] + [[2, 3, 4]] * 3)
    tracklets = Tracklets(ids, np.array([0, 0, 5, 5, 0]), np.array([3, 3, 7, 7, 7]))
    work = TrackletLabels(
        np.arange(72.0).reshape(8, 3, 3),
        tracklets, 10.0, np.array([0, 2, 0, 2, 1]), np.zeros((3, 3)),
    )  # fmt: skip
    seen = []

    def swapped(points: np.ndarray, _: np.ndarray, pair: tuple[int, int]) -> bool:
        seen.append((len(points), points[0, 0, 0], pair))
        return said[len(seen) - 1]

    monkeypatch.setattr("animtool.capture.markers.label.is_swapped", swapped)
    _swap_where_better(work, np.zeros((3, 3)), (0, 2))
    assert seen == [(4, 0.0, (0, 2)), (3, 45.0, (0, 2))]
    swapped = [[0, 2], [2, 0]]
    wanted = [*swapped[said[0]], *swapped[said[1]], 1]
    assert work.run_markers.tolist() == wanted
    # A single part has nothing to be swapped with.
    alone = Tracklets(ids, np.array([0, 0, 3, 5, 0]), np.array([3, 3, 7, 7, 7]))
    work = TrackletLabels(
        work.positions, alone, 10.0, np.array([0, 2, 0, 2, 1]), np.zeros((3, 3))
    )
    _swap_where_better(work, np.zeros((3, 3)), (0, 2))
    assert len(seen) == 2
