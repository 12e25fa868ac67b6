"""Figures of small spoiled captures: cameras, markers, skeletons, faces and takes."""

from __future__ import annotations

from dataclasses import asdict, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from capture.cameras.test_openpose import CAMERAS, POINTS, RATE, images
from capture.face.test_face import made_face, made_weights, placed, spoiled
from capture.markers.test_fill import made, paths
from capture.test_clean import spiked
from support.figures import check_figures
from support.marked import FIGURE, TEMPLATE, captured, column, moving
from support.small_takes import small
from support.stage import changed, observed, ring, walkers

from animtool.capture.cameras import Observations, TriangulateOptions, triangulate
from animtool.capture.cameras.openpose import track_people
from animtool.capture.clean import CleanOptions, clean, clean_take, noise_scores
from animtool.capture.face import fit_face, transfer_weights
from animtool.capture.face.model import FaceModel, NonlinearShapes
from animtool.capture.markers import spikes, swaps
from animtool.capture.markers.chains import chain_likelihoods, chain_runs, rest_evidence
from animtool.capture.markers.fill import fill_markers
from animtool.capture.markers.geometry import MarkerDistances, marker_distances
from animtool.capture.markers.naming import (
    PointNaming,
    compute_pair_evidence,
    search_names,
)
from animtool.capture.markers.predict import (
    MarkerGap,
    predict_from_markers,
    predict_from_parent_joint,
)
from animtool.capture.markers.predict import predict_from_skeleton as by_skeleton
from animtool.capture.markers.runs import TrackletLabels
from animtool.capture.markers.skeleton import MarkerSubject
from animtool.capture.markers.tracklets import track_points
from animtool.capture.markers.twins import distinguish_twins
from animtool.capture.options import FillOptions
from animtool.capture.solve import solve_markers
from animtool.maths import so3
from animtool.motion.motion import Channel
from animtool.rig.parts import Shape
from animtool.rig.surfaces import SurfaceInbetween, SurfaceShape
from animtool.skin.shapes import prepare_shapes

FPS = 100.0


def texts(notices: Any) -> list[str]:
    return [f"{one.code} {one.message}" for one in notices]


def seen_by_cameras(count: int, frames: int = 70) -> tuple[Any, Observations]:
    """Return a ring of cameras, and pixels with outliers, gaps and confidences."""
    cameras = ring(count)
    clean_ = observed(cameras, walkers(frames, 6))
    rng = np.random.default_rng(11)
    pixels = clean_.stored.copy()
    wrong = rng.random(pixels.shape[:3]) < 0.03
    pixels[wrong] += rng.uniform(6, 40, (int(wrong.sum()), 2))
    pixels[rng.random(pixels.shape[:3]) < 0.05] = np.nan
    pixels[:20, 1] += [4.0, -3.0]
    pixels[33, 2] += [0.0, 6.0]
    return cameras, changed(clean_, pixels)


@pytest.mark.parametrize("count", [3, 5])
def test_points_of_pixels(count: int) -> None:
    cameras, seen = seen_by_cameras(count)
    options = TriangulateOptions(gate=3.5, min_angle=0.1)
    found = triangulate(seen, cameras, options)
    check_figures(
        __file__,
        f"cameras {count}",
        {
            "positions": found.markers.positions,
            "views": found.markers.cameras,
            "deviations": found.deviations,
            "error": found.error_px,
            "found": [found.triangulated, found.visible],
            "cameras": found.cameras,
            "notices": texts(found.notices),
        },
    )


def test_people_of_keypoints() -> None:
    hidden = {(4, 0): {1}, (5, 1): {0}, (9, 2): {0, 1}, (10, 0): {0}, (10, 2): {0}}
    rows = images((1, 0), hidden)
    rng = np.random.default_rng(4)
    for frame in rows:
        for people in frame:
            for one in people:
                one[:, :2] += rng.normal(0, 0.5, (POINTS, 2))
                one[:, 2] = rng.uniform(0.3, 1, POINTS)
                one[rng.integers(POINTS)] = [np.nan, np.nan, 0.0]
    check_figures(__file__, "people", track_people(rows, CAMERAS, RATE, POINTS, None))


@pytest.mark.parametrize("options", [{}, {"keep_spikes": True, "longest": 0.15}])
def test_gaps_spikes_and_swaps(options: dict[str, Any]) -> None:
    positions = paths(3e-4)[:160]
    positions[40:45, 2] = positions[100:130, 7] = positions[:4, 0] = np.nan
    positions[156:, 9] = positions[60:90, 5:9] = np.nan
    positions[20:22, 4] += [0.03, -0.05, 0.02]
    positions[80, 1] += 0.04
    positions[135:150, [3, 8]] = positions[135:150, [8, 3]]
    whole, report = fill_markers(made(positions), options=FillOptions(**options))
    keys = asdict(report)
    keys["notices"] = texts(report.notices)
    check_figures(
        __file__, f"fill {len(options)}", {"at": whole.positions, "report": keys}
    )


@pytest.mark.slow
def test_gaps_by_a_skeleton_and_a_solve() -> None:
    truth = captured(moving(90, FPS, 4), FPS)
    positions = truth.markers.positions.copy()
    rng = np.random.default_rng(3)
    positions[30:55, [column("LWRA"), column("LELB"), column("RUPA")]] = np.nan
    positions[rng.random(positions.shape[:2]) < 0.02] += 0.03
    a, b = column("RWRA"), column("RWRB")
    positions[60:75, [a, b]] = positions[60:75, [b, a]]
    given = replace(truth.markers, positions=positions)
    whole, report = fill_markers(given, subject=MarkerSubject(FIGURE, TEMPLATE))
    keys = asdict(report)
    keys["notices"] = texts(report.notices)
    check_figures(__file__, "skeleton", {"at": whole.positions, "report": keys})
    solve = solve_markers(given, FIGURE, TEMPLATE)
    take = solve.take()
    check_figures(
        __file__,
        "solve",
        {
            "motion": list(take.motion.dense()),
            "score": asdict(solve.score),
            "notices": texts(solve.notices),
        },
    )


def test_weights_of_landmarks() -> None:
    model = made_face(3)
    seen = spoiled(placed(model.points(made_weights(50))), 4e-4)
    seen[20:23] = np.nan
    seen[:, 7] += 0.02
    fit = fit_face(model, seen, 60, smooth=0.5)
    other = made_face(4)
    moved = transfer_weights(
        fit.weights, model.shapes, other.shapes, faces=(model, other)
    )
    actor = model.with_proportions(seen[2])
    camera = np.array([900.0, 880.0, 640.0, 360.0])
    predict_in_parent = so3.rotate(
        np.array([1.0, 0, 0, 0]), model.points(made_weights(14))
    )
    away = predict_in_parent + np.array([0.01, 0.02, 0.35])
    pixels = away[..., :2] / away[..., 2:] * camera[:2] + camera[2:]
    flat = fit_face(model, pixels, 60, camera=camera)
    check_figures(
        __file__,
        "face",
        {
            **{
                f"fit {i}": {
                    "weights": one.weights,
                    "rotations": one.rotations,
                    "translations": one.translations,
                    "residuals": one.residuals,
                    "shares": one.shares,
                    "noise": one.noise,
                    "rms": one.rms,
                    "status": " ".join(one.status),
                    "notices": texts(one.notices),
                }
                for i, one in enumerate((fit, flat))
            },
            "moved": moved.weights,
            "actor": [actor.neutral, actor.deltas],
        },
    )


def test_takes_are_cleaned() -> None:
    take = small(110)
    t = np.arange(110)[:, None, None] / 30
    rng = np.random.default_rng(5)
    swing = 0.4 * np.sin(t * [2.0, 3.0, 0.7]) * np.ones((1, 3, 1))
    slides = np.array([0.1, 0.2, 0.3]) * np.cos(1.3 * t) + np.zeros((1, 3, 1))
    noise = rng.normal(0, [0.02, 0.01, 0.004], (2, 110, 3, 3))
    motion = replace(
        take.motion,
        rotations=Channel.from_dense(so3.align_signs(so3.exp(swing + noise[0]))),
        translations=Channel.from_dense(slides + 0.1 * noise[1]),
    )
    dirty, _ = spiked(replace(take, motion=motion), 4)
    made_, signals = clean_take(dirty, CleanOptions())
    kept, spikes = clean_take(dirty, CleanOptions(keep_noise=True))
    check_figures(
        __file__,
        "clean",
        {
            "motion": list(made_.motion.dense()),
            "kept": list(kept.motion.dense()),
            "signals": signals,
            "spikes": spikes,
            "scores": noise_scores(110, signals),
            "notices": texts(clean(dirty).notices),
        },
    )


SHAPE = np.random.default_rng(6).uniform(-0.15, 0.15, (9, 3))
REST = np.linalg.norm(SHAPE[:, None] - SHAPE, axis=-1)


def blurred(seed: int) -> MarkerDistances:
    """Return distances of runs that are these markers, some loose, some not seen."""
    rng = np.random.default_rng(seed)
    spread = np.exp(rng.uniform(-9, -3, REST.shape))
    spread = (spread + spread.T) / 2
    mean = REST + spread * rng.normal(size=REST.shape) / 3
    mean = (mean + mean.T) / 2
    lost = rng.random(REST.shape) < 0.1
    mean[lost | lost.T] = spread[lost | lost.T] = np.nan
    np.fill_diagonal(mean, np.nan)
    return MarkerDistances(mean, spread)


def test_what_distances_say_of_names() -> None:
    moving = blurred(4)
    seen = np.random.default_rng(5).uniform(0, 200, REST.shape)
    seen = np.floor((seen + seen.T) / 2)
    own = PointNaming(moving, seen, REST)
    found: list[Any] = [own.total_evidence()]
    for point in range(6):
        own.assign(point, [1, 0, 2, 4, 3, 5][point])
        found.append(own.total_evidence())
    grown = own.copy()
    grown.assign_greedily()
    found += [grown.point_markers, grown.total_evidence(), grown.scarce_markers()]
    grown.improve()
    found += [
        grown.point_markers,
        grown.total_evidence(),
        grown.most_doubtful_point(set()) or (),
    ]
    grown.force_name(2, 5, np.arange(9) % 2 == 0)
    found += [grown.point_markers, grown.total_evidence()]
    best = search_names(grown, REST, [{0: 0, 1: 1, 2: 2}, {3: 4, 4: 3, 7: 7}])
    found += [best.point_markers, best.total_evidence()]
    a, b = np.array([0.3, 0.2, np.nan]), np.array([0.001, 0.02, 0.01])
    found += [
        rest_evidence(a, b, REST[0, 1:5]),
        chain_likelihoods(moving, seen),
        chain_runs(moving, np.where(REST > 0.2, 0.0, seen)),
        compute_pair_evidence(moving, np.minimum(seen / 60, 1.0), REST),
    ]
    check_figures(__file__, "names", found)


def test_what_shapes_say_of_twins() -> None:
    rng = np.random.default_rng(8)
    shape = SHAPE.copy()
    shape[3] = shape[2] * [1, 1, -1] + [0, 0, 0.002]
    turns = so3.exp(np.cumsum(rng.normal(0, 0.2, (60, 3)), axis=0))
    seen = so3.rotate(turns[:, None], shape[[0, 1, 3, 2, 4, 5, 6, 7, 8]])
    seen = seen + rng.normal(0, 8e-4, seen.shape)
    seen[10:25, 4] = np.nan
    names, doubts, gains = distinguish_twins(seen, shape)
    check_figures(
        __file__, "twins", [names, [asdict(doubt) for doubt in doubts], gains]
    )


def test_runs_of_points_and_their_costs() -> None:
    truth = paths(3e-4)[:120]
    rng = np.random.default_rng(9)
    points = np.full((120, 13, 3), np.nan)
    order = np.arange(13)
    for frame in range(120):
        if frame in (30, 75):
            order = rng.permutation(13)
        points[frame, order[:10]] = truth[frame]
    points[40:60, order[11]] = truth[40:60, 2] + 0.05
    points[rng.random(points.shape[:2]) < 0.02] = np.nan
    runs = track_points(points, 120.0)
    rest = np.linalg.norm(truth[0][:, None] - truth[0], axis=-1)
    given = np.full(len(runs.first), -1)
    given[:10] = np.arange(10)
    labels = TrackletLabels(points, runs, 120.0, given, rest)
    labels._update_distances()
    some = range(0, len(runs.first), 3)
    costs = [labels._marker_costs(run) for run in some]
    jumps = [labels._gap_costs(*_path(labels, run)) for run in some]
    labels.name_runs()
    check_figures(
        __file__,
        "runs",
        [runs.ids, runs.first, runs.last, costs, jumps, labels.run_markers,
         labels.marker_paths()],
    )  # fmt: skip


def _path(labels: TrackletLabels, run: int) -> tuple[Any, int, int]:
    begin, end, path = labels._run_positions(run)
    return path, begin, end


def test_weights_of_a_bent_face() -> None:
    """Two shapes, of which one bends at a quarter, and what both add together."""
    plain = made_face(5)
    rng = np.random.default_rng(6)
    deltas = rng.normal(size=(3, *plain.neutral.shape)) * 0.01
    shapes = (
        Shape("a", "face", deltas[0]),
        Shape("b", "face", deltas[1]),
        Shape("ab", "face", deltas[2], combine=("a", "b")),
    )
    middle = SurfaceInbetween(0.25, deltas[1] * 0.6 + 0.001)
    bent = [
        SurfaceShape("a", deltas[0]),
        SurfaceShape("b", deltas[1], inbetweens=(middle,)),
        SurfaceShape("ab", deltas[2]),
    ]
    prepared = prepare_shapes(bent, plain.neutral)
    model = FaceModel(
        plain.names, ("a", "b"), plain.neutral, deltas[:2],
        NonlinearShapes(shapes, prepared, (0, 1)),
    )  # fmt: skip
    weights = made_weights(16, 2)
    seen = spoiled(placed(model.points(weights)), 3e-4)
    fit = fit_face(model, seen, 60)
    check_figures(
        __file__,
        "bent",
        [model.points(weights), model.nonlinear_offsets(weights), fit.weights, fit.rms],
    )


def test_where_markers_are_in_gaps_by_what_moves_with_them() -> None:
    """By rigid ones about it, by the joint above, turned to a mate, by a skeleton."""
    frames, count = 150, 7
    rng = np.random.default_rng(12)
    t = np.arange(frames) / 100
    above = so3.exp(np.stack([np.sin(3 * t), 0.4 * t, np.cos(2 * t)], axis=1))
    hinge = so3.exp(np.stack([0 * t, 0.5 * np.sin(5 * t), 0.2 * t], axis=1))
    rotations = so3.multiply(above, hinge)
    origin = np.stack([t, 1 + 0.1 * np.sin(7 * t), 0.2 * t], axis=1)
    shape = rng.uniform(-0.15, 0.15, (count, 3))
    true = origin[:, None] + so3.rotate(rotations[:, None], shape)
    true[:, 4:] = origin[:, None] + so3.rotate(above[:, None], shape[4:])
    positions = true + rng.normal(0, 3e-4, true.shape)
    seen = np.ones((frames, count), np.bool_)
    gap = slice(70, 95)
    seen[gap, 0] = False
    seen[20:25, 2] = False
    spread = np.array([0.0, 1e-3, 2e-3, 1.5e-3, 5e-3, 6e-3, 4e-3])
    owners = (hinge if k < 4 else 0 * hinge + so3.IDENTITY for k in range(count))
    own = np.stack([so3.multiply(above, one) for one in owners], axis=1)
    known = {
        "origins": np.repeat(origin[:, None], count, axis=1),
        "parent_rotations": np.repeat(so3.to_matrix(above)[:, None], count, axis=1),
        "rotations": so3.to_matrix(own),
        "positions": true + 0.01 * np.sin(t)[:, None, None],
        "has_parent": lambda _: True,
    }
    open_gap = MarkerGap(positions, seen, 0, gap, spread, 100.0)
    far = np.where(np.arange(count) < 4, np.nan, spread)
    found = [predict_from_markers(open_gap)]
    for mates in ([], [1], [1, 3]):
        bones: Any = SimpleNamespace(**known, markers_on_joint=lambda *_, m=mates: m)
        found.append(predict_from_parent_joint(bones, open_gap))
        far_gap = replace(open_gap, distance_deviations=far)
        found.append(predict_from_parent_joint(bones, far_gap))
    found.append(by_skeleton(bones, open_gap))
    check_figures(__file__, "predicted", found)


def swapped() -> np.ndarray:
    """Return positions of which some are swapped, lost, off, and begin late."""
    positions = paths(4e-4)[:140]
    positions[:6, 5] = positions[60:72, 2] = positions[100:103, 8] = np.nan
    positions[30:55, [2, 6]] = positions[30:55, [6, 2]]
    positions[110:, [0, 9]] = positions[110:, [9, 0]]
    positions[20:22, 4] += [0.02, -0.03, 0.01]
    positions[57:60, 2] += [0.004, 0.006, -0.002]
    positions[80:95, 3] += np.linspace(0, 0.08, 15)[:, None]
    return positions


def test_what_says_that_names_are_swapped() -> None:
    positions, rate = swapped(), 120.0
    apart = marker_distances(positions)
    expected = swaps._expected_positions(positions, rate)
    found: list[Any] = [*expected, swaps._jump_pairs(positions, rate)]
    for a, b in ((2, 6), (0, 9), (3, 4), (5, 8)):
        crossed = swaps._find_crossed_frames(positions, a, b, rate, apart)
        both = positions[:, [a, b]]
        found += [crossed, swaps._typical_acceleration(both, rate)]
        found += [swaps._swap_spans(crossed[1], both)]
        spans = ((0, 30), (30, 55), (60, 61), (70, 140), (100, 118))
        found += [swaps._shape_gain(positions, a, b, *span, apart) for span in spans]
    past = [(3, [0.0, 0, 0]), (5, [0.1, 0, 0.1]), (9, [0.2, 0.1, 0.1])]
    found += [
        swaps._position_cost(past[:k], frame, [0.3, 0.12, 0.2], rate, acceleration)
        for k in range(4)
        for frame in (10, 13)
        for acceleration in (5.0, 80.0)
    ]
    check_figures(__file__, "swaps", found)


def test_what_says_that_frames_are_spikes() -> None:
    positions = swapped()
    found: list[Any] = []
    for marker in (2, 4, 5, 8):
        path = np.nan_to_num(positions[:, marker])
        seen = np.isfinite(positions[:, marker, 0])
        rough, noise = spikes._noise_model(path, seen)
        found += [rough, noise, spikes._clearest_spikes(path, seen, rough, noise)]
        found += [spikes._marker_spikes(positions[:, marker])]
        for length in (1, 3, 4):
            starts, *rest = spikes._span_deviations(path, seen, length, rough)
            found += [starts, *rest, spikes._is_one_sided(seen, starts, length)]
            found += [spikes._local_noise(starts, rest[1] * 1e6, len(path))]
        found += [
            spikes._is_gap_artifact(path, seen, first, length, rough, noise[0] ** 2)
            for first in range(52, 80, 3)
            for length in (2, 3)
        ]
    check_figures(__file__, "spikes", found)
