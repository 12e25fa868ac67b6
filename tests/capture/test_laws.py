"""Numbers of cameras, markers and faces, each function by itself."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from animtool.capture.cameras.camera import (
    Camera,
    camera_parameters,
    distort,
    nearest_rotation,
    pixel_rays,
    project,
)
from animtool.capture.cameras.noise import (
    _camera_noise,
    _pooled_noise,
    initial_noise,
    measure_noise,
)
from animtool.capture.cameras.observations import Observations
from animtool.capture.cameras.openpose import (
    _continue_tracks,
    _keypoint_rays,
    _person_size,
    _PersonTrack,
    _ray_distance,
    _solve_person,
    track_people,
)
from animtool.capture.cameras.stale import (
    PoseChange,
    PoseShift,
    _exact_ranges,
    _window_sums,
    find_disagreements,
    find_shifted_ranges,
    find_stale_ranges,
    fit_pose_change,
    truncated_error,
)
from animtool.capture.cameras.triangulate import _check_options, _TriangulationRun
from animtool.capture.face.model import FaceModel, rms_spread
from animtool.capture.face.poses import (
    estimate_camera_pose,
    estimate_head_poses,
    last_good_poses,
)
from animtool.capture.markers.fill import (
    _most_accurate_prediction,
    _polynomial_positions,
    _sorted_gaps,
    _visible_frames_near,
)
from animtool.capture.markers.geometry import (
    MarkerDistances,
    _column_quantiles,
    marker_distances,
)
from animtool.capture.markers.predict import (
    MarkerGap,
    Prediction,
    _covariance,
    _predict_gap,
    _rotate_towards,
    _validation_spans,
)
from animtool.capture.markers.runs import TrackletLabels, _merge_known_distances
from animtool.capture.markers.spikes import (
    _is_one_sided,
    _local_noise,
    _noise_model,
    _span_deviations,
)
from animtool.capture.markers.tracklets import (
    Tracklets,
    _expected_positions,
    _mutual_nearest,
    _second_smallest,
    track_points,
)
from animtool.capture.options import TriangulateOptions
from animtool.capture.solve.sampling import fullest_frames, residual_noise
from animtool.capture.templates.match import match_markers
from animtool.capture.templates.template import (
    MarkerTemplate,
    TemplateMarker,
    template_text,
)
from animtool.core.clock import Clock
from animtool.core.errors import OptionError
from animtool.maths import so3
from animtool.rig.skeleton import Joint, Rig

LENS = (0.1, -0.02, 0.003, -0.004, 0.01, 0.05, 0.02, 0.003)
TURN = so3.to_matrix(so3.exp(np.array([0.2, -0.4, 0.1])))


def camera(turn: Any = None, shift: Any = (0.1, -0.2, 3.0), **keys: Any) -> Camera:
    own = np.eye(3) if turn is None else turn
    return Camera("a", (800.0, 700.0), (320.0, 240.0), own, np.array(shift), **keys)


def test_pixels_are_those_of_the_lens_as_opencv_has_it() -> None:
    """Every number of it counts: radial over rational, tangential, skew and focal."""
    own = camera(TURN, skew=5.0, distortion=LENS)
    point = np.array([0.3, 0.4, 0.5])
    x, y, z = TURN @ point + [0.1, -0.2, 3.0]
    x, y = x / z, y / z
    k1, k2, p1, p2, k3, k4, k5, k6 = LENS
    r = x**2 + y**2
    radial = (1 + k1 * r + k2 * r**2 + k3 * r**3) / (1 + k4 * r + k5 * r**2 + k6 * r**3)
    u = x * radial + 2 * p1 * x * y + p2 * (r + 2 * x**2)
    v = y * radial + p1 * (r + 2 * y**2) + 2 * p2 * x * y
    found = project(own, point)
    assert_allclose(found, [800 * u + 5 * v + 320, 700 * v + 240])
    assert_allclose(distort(own, np.array([x, y])), [u, v])
    # And back: to the place at depth 1.
    assert_allclose(pixel_rays(own, found), [x, y], atol=1e-9)
    assert_allclose(pixel_rays(own, np.array([[900.0, 700.0]])) @ [0, 0], 0)
    assert_allclose(own.position, -TURN.T @ [0.1, -0.2, 3.0])
    behind = project(own, own.position - TURN[2])
    assert np.isnan(behind).all()
    row = [800, 700, 320, 240, 5, *LENS, *TURN.ravel(), 0.1, -0.2, 3.0, 0, 0]
    assert_allclose(own.kernel_parameters, row)
    sized = camera(size=(640, 480))
    assert camera_parameters([own, sized])[:, 25:].tolist() == [[0, 0], [640, 480]]
    assert camera_parameters([]).shape == (0, 27)


@pytest.mark.parametrize(
    ("matrix", "is_one"),
    [
        (TURN, True),
        (TURN + 0.0049 * np.eye(3) * 0, True),
        (1.004 * TURN, True),
        (1.02 * TURN, False),
        (TURN * [1, 1, -1], False),
        (np.full((3, 3), np.nan), False),
        (3 * TURN, False),
    ],
)
def test_matrices_that_are_nearly_rotations(matrix: Any, is_one: bool) -> None:
    found = nearest_rotation(np.asarray(matrix))
    assert (found is not None) is is_one
    if found is not None:
        assert_allclose(found, TURN, atol=1e-9)


def test_sums_around_frames_are_cut_at_the_ends() -> None:
    values = np.array([1.0, 2, 4, 8, 16, 32])
    assert _window_sums(values, 3).tolist() == [7, 7, 14, 28, 56, 56]
    assert _window_sums(values, 1).tolist() == values.tolist()
    assert _window_sums(values, 6).tolist() == [63] * 6


def test_runs_of_frames_are_closed_and_last() -> None:
    off = np.zeros(30, bool)
    off[[3, 4, 5, 8, 9]] = True  # a gap of two in a window of four
    off[15] = True
    off[22:26] = True
    none = np.zeros((30, 1))
    spans = [
        [
            (shift.first, shift.end)
            for shift in _exact_ranges(none, none, 0, off, window)
        ]
        for window in (4, 2)
    ]
    assert spans[0] == [(3, 10), (22, 26)]
    assert spans[1] == [(3, 6), (8, 10), (15, 16), (22, 26)]


def tallies(frames: int, bad: slice, share: float = 1.0) -> tuple[Any, Any]:
    judged = np.full((frames, 3), 10.0)
    rejected = np.zeros((frames, 3))
    rejected[bad, 1] = 10 * share
    return judged, rejected


@pytest.mark.parametrize(
    ("bad", "share", "found"),
    [
        (slice(20, 40), 1.0, (20, 40)),
        (slice(20, 40), 0.51, (20, 40)),
        (slice(20, 40), 0.5, None),
        (slice(0, 15), 1.0, (0, 15)),
        (slice(45, 60), 1.0, (45, 60)),
        (slice(20, 22), 1.0, None),
        (slice(0, 60), 1.0, (0, 60)),
    ],
)
def test_a_camera_that_moved_is_found_to_the_frame(
    bad: slice, share: float, found: Any
) -> None:
    """More than half of what it sees is off, for a quarter of a second at least."""
    judged, rejected = tallies(60, bad, share)
    active = np.ones((60, 3), bool)
    result = find_shifted_ranges(judged, rejected, active, 30.0)
    if found is None:
        assert result is None
        return
    assert result is not None
    number, (one,) = result
    assert (number, one.first, one.end) == (1, *found)
    assert one.outliers == pytest.approx(share)
    # Who would leave fewer than two is not taken.
    assert (
        find_shifted_ranges(judged, rejected, active & [True, True, False], 30.0)
        is None
    )
    (stale,) = find_stale_ranges(judged, rejected, 1, 30.0)
    assert (stale.first, stale.end) == found
    (whole,) = find_stale_ranges(judged, 0 * rejected, 1, 30.0)
    assert (whole.first, whole.end) == (0, 60)
    assert find_shifted_ranges(judged / 10, rejected / 10, active, 30.0) is None


def test_the_worst_camera_goes_first() -> None:
    judged, rejected = tallies(60, slice(20, 40))
    rejected[10:45, 2] = 10
    result = find_shifted_ranges(judged, rejected, np.ones((60, 3), bool), 30.0)
    assert result is not None
    assert (result[0], result[1][0].first, result[1][0].end) == (2, 10, 45)
    (one,) = _exact_ranges(judged, rejected, 2, np.arange(60) > 20, 8)
    assert (one.first, one.end) == (10, 60) or (one.first, one.end) == (10, 45)


def test_a_run_begins_where_a_camera_was_off_from_the_first_frame_on() -> None:
    judged, rejected = tallies(60, slice(0, 40))
    (one,) = _exact_ranges(
        judged, rejected, 1, (np.arange(60) > 8) & (np.arange(60) < 30), 8
    )
    assert (one.first, one.end) == (0, 40)
    rejected[3, 1] = 0
    (one,) = _exact_ranges(
        judged, rejected, 1, (np.arange(60) > 8) & (np.arange(60) < 30), 8
    )
    assert (one.first, one.end) == (4, 40)


def test_frames_in_which_a_camera_disagrees() -> None:
    """Rejected for more than half, or loud: twice its noise, and more than chance."""
    rows = np.zeros((6, 1, 8))
    # used, judged, rejected and sum of squares of pixels, at a noise of half a pixel.
    for f, (used, judged, rejected, pixels) in enumerate(
        [(4, 10, 5, 2.0), (4, 10, 6, 2.0), (100, 100, 0, 100 * 0.5 * 3.99),
         (100, 100, 0, 100 * 0.5 * 4.01), (3, 3, 0, 3 * 0.5 * 4.4), (0, 2, 2, 0.0)]
    ):  # fmt: skip
        rows[f, 0, [1, 2, 3, 5]] = used, judged, rejected, pixels
    found = find_disagreements(rows, 0, 0.5, np.ones(6, bool))
    assert [one.frame for one in found] == [1, 3]
    assert (found[0].outliers, found[0].error_px) == (0.6, pytest.approx(0.5**0.5))
    loud = rows.copy()
    loud[4, 0, 5] = 3 * 0.5 * 4.5
    assert [d.frame for d in find_disagreements(loud, 0, 0.5, np.ones(6, bool))] == [
        1,
        3,
        4,
    ]
    assert not find_disagreements(loud, 0, 0.5, np.zeros(6, bool))


def test_errors_are_truncated_at_the_gate_and_by_what_is_expected() -> None:
    """Of two cameras that see one point a residual of four is free."""
    residuals = np.array([[[[1.0, 0]], [[0, 2]], [[np.nan, 0]]]])
    seen = np.array([[[True], [True], [False]]])
    noise = np.array([1.0, 0.5, 1.0])
    assert truncated_error(residuals, seen, noise, 5.0) == pytest.approx(17 / 1)
    assert truncated_error(residuals, seen, noise, 3.0) == pytest.approx(10 / 1)
    assert truncated_error(residuals, seen, noise, 5.0, True) == pytest.approx(17 / 2)
    every = np.ones_like(seen)
    assert truncated_error(residuals, every, noise, 3.0) == pytest.approx(19 / 3)


def test_how_a_camera_went_is_found_from_what_it_sees() -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(-1, 1, (4, 10, 3))
    was = camera(TURN, distortion=LENS)
    turn = so3.to_matrix(so3.exp(np.array([0.0, 0.03, 0.01])))
    shift = turn @ was.translation + [0.02, 0.01, -0.05]
    moved = camera(turn @ TURN, shift, distortion=LENS)
    pixels = project(moved, points)
    found = fit_pose_change(was, points, pixels)
    assert found is not None
    assert found.angle == pytest.approx(np.hypot(0.03, 0.01), rel=1e-3)
    far = np.linalg.norm(moved.position - was.position)
    assert found.distance == pytest.approx(far, rel=1e-3)
    assert found.error_px < 1e-3
    assert (
        fit_pose_change(
            was, points, project(was, points) + rng.normal(0, 3, (4, 10, 2))
        )
        is None
    )
    few = pixels.copy()
    few.reshape(-1, 2)[:21] = np.nan
    assert fit_pose_change(was, points, few) is None
    few.reshape(-1, 2)[20] = pixels.reshape(-1, 2)[20]
    assert fit_pose_change(was, points, few) is not None
    text = str(PoseChange(np.radians(1.5), 0.0123, 0.5))
    assert text.startswith("a rotation of 1.50 degrees and a shift of 12.3 mm")


def test_noise_is_told_by_the_sums_of_squares_of_points() -> None:
    """Of three cameras three are free; the median of chi-square is theirs."""
    lengths = np.array([[[2.0], [1.0], [2.0]], [[9.0], [9], [9]]])
    used = np.array([[[True]] * 3, [[True], [False], [False]]])
    middle = 3 * (1 - 2 / 27) ** 3
    assert _pooled_noise(lengths, used) == pytest.approx(np.sqrt(9 / middle))
    assert _pooled_noise(lengths, used & False) is None


def test_each_camera_has_the_noise_of_its_own_median() -> None:
    lengths = np.full((20, 3, 1), 2.0)
    lengths[:, 1] = 5.0
    states = np.full((20, 3, 1), 1, np.uint8)
    states[:, 1] = 2
    found = _camera_noise(lengths, states)
    # Two are used: of four residuals three are taken; who is rejected keeps all.
    assert_allclose(found[1], 5 / 1.1774100225)
    assert np.isnan(_camera_noise(lengths[:19], states[:19])).all()
    states[:] = 1
    free = 1 - 1.5 / 3
    assert_allclose(
        _camera_noise(lengths, states),
        np.array([2, 5, 2]) / np.sqrt(free) / 1.17741,
        rtol=1e-5,
    )


def test_noise_that_nothing_shows_is_a_pixel() -> None:
    numbers = camera_parameters([camera(), camera()])
    assert initial_noise(np.full((3, 2, 4, 2), np.nan), numbers) == 1
    assert initial_noise(np.zeros((3, 2, 4, 2)) + 320.0, numbers) >= 0.05


@pytest.mark.parametrize(
    ("keys", "where"),
    [
        ({"gate": 0.0}, "gate"), ({"gate": np.inf}, "gate"), ({"noise": 0.0}, "noise"),
        ({"noise": 0.1}, None), ({"min_angle": 0.0}, None),
        ({"min_angle": -1e-9}, "min_angle"),
        ({"min_angle": np.pi / 2}, "min_angle"), ({"min_angle": 1.57}, None),
    ],
)  # fmt: skip
def test_ends_of_what_may_be_triangulated(keys: Any, where: str | None) -> None:
    options = TriangulateOptions(**keys)
    if where is None:
        _check_options(options)
        return
    with pytest.raises(OptionError) as error:
        _check_options(options)
    assert (error.value.code, error.value.faults[0].where) == ("CAP001", where)


def test_the_condition_is_that_of_two_rays_at_an_angle() -> None:
    for angle, expected in ((np.pi / 3, 8.0), (0.0, 2e12)):
        run: Any = SimpleNamespace(options=TriangulateOptions(min_angle=angle))
        assert _TriangulationRun._max_condition.fget(run) == pytest.approx(expected)  # type: ignore[attr-defined]


BODY = np.random.default_rng(4).uniform(-0.4, 0.4, (6, 3))


def ring(count: int) -> list[Camera]:
    """Return cameras around the origin, 3 m off."""
    made = []
    for k in range(count):
        turn = so3.to_matrix(so3.exp(np.array([0.0, 2 * np.pi * k / 7, 0])))
        made.append(camera(turn, (0.0, 0, 3.0)))
    return made


def seen_by(cameras: list[Camera], points: Any, trust: float = 0.9) -> list[np.ndarray]:
    return [
        np.concatenate(
            [project(each, points), np.full((len(points), 1), trust)], axis=1
        )
        for each in cameras
    ]


def test_people_are_told_by_their_rays() -> None:
    cameras = ring(3)
    person = seen_by(cameras, BODY)
    wide = person[0]
    spans = np.ptp(wide[:, :2], axis=0)
    assert _person_size(wide) == pytest.approx(np.linalg.norm(spans))
    assert _person_size(wide[:1]) == 1
    lines = [
        _keypoint_rays(each, one) for each, one in zip(cameras, person, strict=True)
    ]
    ways = BODY - cameras[0].position
    assert_allclose(np.cross(lines[0], ways), 0, atol=1e-9)
    args = cameras[0], lines[0], cameras[1], lines[1]
    assert _ray_distance(*args, 100.0, 100.0) < 1e-9
    few = lines[1].copy()
    few[2:] = np.nan
    assert _ray_distance(cameras[0], lines[0], cameras[1], few, 1.0, 1.0) == np.inf
    # Raised by an angle of 0.01 in one image: of 800 px and 100 px of size 0.08.
    up = person[1].copy()
    up[:, 1] += 7.0
    off = _ray_distance(
        cameras[0], lines[0], cameras[1], _keypoint_rays(cameras[1], up), 100.0, 100.0
    )
    assert off == pytest.approx(0.08, rel=0.25)
    points = _solve_person({0: 0, 1: 0}, [[one] for one in person], cameras, 6)
    assert_allclose(points, BODY, atol=1e-6)
    assert _solve_person({1: 0}, [[one] for one in person], cameras, 6) is None
    shown = [[one] for one in person]
    track = _PersonTrack(BODY, 0)
    free = {(c, 0) for c in range(3)}
    ((again, group),) = _continue_tracks([track], shown, cameras, free)
    assert (again, group, free) == (track, {0: 0, 1: 0, 2: 0}, set())
    away = _PersonTrack(BODY + np.array([0.5, 0, 0]), 0)
    ((_, group),) = _continue_tracks([away], shown, cameras, {(c, 0) for c in range(3)})
    assert 0 not in group


def test_people_are_followed_out_of_sight_and_mistakes_left_out() -> None:
    """At 20 a second one may be gone for 10 frames; who is seen for 4 is no mistake."""
    cameras = ring(3)
    for gone, people in ((9, 1), (11, 2)):
        frames: list[Any] = []
        for f in range(12 + gone):
            visible = f < 6 or f >= 6 + gone
            frames.append([[one] if visible else [] for one in seen_by(cameras, BODY)])
        found = track_people(frames, cameras, 20.0, 6, None)
        assert found.shape == (12 + gone, 3, 6 * people, 3)
    frames = [[[one] for one in seen_by(cameras, BODY)] for _ in range(10)]
    other = seen_by(cameras, BODY + np.array([0.0, 1.5, 0]))
    for f in range(4):
        for c in range(3):
            frames[f][c].append(other[c])
    assert track_people(frames, cameras, 20.0, 6, None).shape[2] == 6
    assert track_people(frames, cameras, 12.0, 6, None).shape[2] == 12
    one = track_people(frames, cameras, 12.0, 6, 1)
    assert_allclose(one[:, 0, :, :2], np.stack([frames[0][0][0][:, :2]] * 10))
    frames[1][0] = []
    made = track_people(frames, cameras, 20.0, 6, 1)
    assert np.isnan(made[1, 0, :, :2]).all()
    assert not made[1, 0, :, 2].any()
    assert_array_equal(made[1, 2], frames[1][2][0])
    assert track_people([[[]] * 3] * 10, cameras, 20.0, 6, None).shape == (10, 3, 6, 3)


def test_quantiles_and_distances_of_what_is_seen() -> None:
    column = np.array([[4.0], [np.nan], [1.0], [3.0], [2.0], [np.nan]])
    found = _column_quantiles(column)
    assert_allclose(found[:, 0], [1 + 3 * 0.1587, 2.5, 1 + 3 * 0.8413])
    path = np.zeros((3000, 2, 3))
    path[:, 1, 0] = np.arange(3000) % 2  # every other frame is looked at
    assert marker_distances(path).mean[0, 1] == 0
    short = np.zeros((5, 2, 3))
    short[:, 1, 1] = 2.0
    assert marker_distances(short).mean[1, 0] == 2
    few = np.zeros((20, 2, 3))
    few[12:, 1] = np.nan
    assert np.isfinite(marker_distances(few).mean[0, 1])
    few[11:, 1] = np.nan
    assert np.isnan(marker_distances(few).mean[0, 1])
    nan = np.nan
    moving = MarkerDistances(
        np.array([[nan, 3.0], [nan, nan]]), np.array([[nan, 0.5], [7, 7]])
    )
    learnt = _merge_known_distances(np.array([[nan, 1.0], [1, nan]]), moving)
    assert_array_equal(learnt.mean, [[nan, 3], [1, nan]])
    assert_array_equal(learnt.spread, [[nan, 0.5], [0.25, nan]])


def test_where_runs_go_next_and_who_is_whose_nearest() -> None:
    past = np.zeros((3, 3, 3))
    past[:, :, 0] = [[9.0, 4, 1]] * 3
    expected, radius = _expected_positions(past, np.array([1, 2, 3]), 0.5, 2.0)
    assert_allclose(expected[:, 0], [9, 14, 15])
    assert radius.tolist() == [2, 0.5, 0.5]
    near = np.array([[0.4, 0.9, 3.0], [0.9, 0.3, 3.0], [9.0, 9, 1.01]])
    run, point = _mutual_nearest(near)
    assert (run.tolist(), point.tolist()) == ([0, 1], [0, 1])
    near[2, 2] = 1.0
    assert _mutual_nearest(near)[0].tolist() == [0, 1, 2]
    near[0, 1] = 0.79
    assert _mutual_nearest(near)[0].tolist() == [1, 2]
    # As good as the same where both are within a twentieth.
    assert not len(_mutual_nearest(np.array([[0.01, 0.1]]))[0])
    assert len(_mutual_nearest(np.array([[0.01, 0.101]]))[0]) == 1
    assert _second_smallest(np.array([[3.0, 1, 2], [5, 5, 9]])).tolist() == [2, 5]
    assert _second_smallest(np.ones((2, 1))).tolist() == [np.inf] * 2
    assert not len(_mutual_nearest(np.zeros((0, 3)))[0])


def test_points_are_followed_as_far_as_a_marker_goes() -> None:
    """At 100 a second: 0.124 m without a past, and 0.104 m from where it would be."""
    cloud = np.full((4, 2, 3), np.nan)
    cloud[:, 0] = [[0.0, 0, 0], [0.12, 0, 0], [0.24, 0, 0], [0.36, 0.1, 0]]
    cloud[1:, 1] = [5.0, 0, 0]
    found = track_points(cloud, 100.0)
    assert found.ids.tolist() == [[0, -1], [0, 1], [0, 1], [0, 1]]
    assert (found.first.tolist(), found.last.tolist()) == ([0, 1], [3, 3])
    assert_array_equal(found.trajectory(cloud, 1), cloud[1:, 1])
    cloud[1, 0, 0] = 0.13
    assert track_points(cloud, 100.0).ids[:2, 0].tolist() == [0, 1]


def labels(positions: Any, given: Any) -> TrackletLabels:
    frames, count = positions.shape[:2]
    ids = np.tile(np.arange(count), (frames, 1))
    runs = Tracklets(ids, np.zeros(count, int), np.full(count, frames - 1))
    rest = np.linalg.norm(positions[0][:, None] - positions[0][None], axis=-1)
    return TrackletLabels(positions, runs, 100.0, np.array(given), rest)


def test_a_run_costs_what_it_jumps_and_where_it_is_off() -> None:
    positions = np.zeros((30, 3, 3))
    positions[:, 1, 0] = 0.3
    positions[:, 2, 1] = 0.4
    own = labels(positions, [0, 1, -1])
    assert np.isnan(own.marker_positions[:, 2]).all()
    assert_array_equal(own.marker_positions[:, 1], positions[:, 1])
    own._update_distances()
    costs = own._shape_costs(positions[:, 2], 0, 30)
    assert costs[2] == pytest.approx(0, abs=1e-12)
    assert costs[0] > 1
    assert not own._is_free(2, 0)
    assert own._is_free(2, 2)
    assert own._marker_costs(2)[:2].tolist() == [np.inf] * 2
    # It stood, and two frames later is 5 mm off what noise and pull allow.
    own.marker_positions[:10, 2] = positions[:10, 2]
    path = positions[11:, 2] + [0.006, 0, 0]
    allowed = 0.004 + 0.5 * 60 * 0.02**2 + 0.3 * 0.02
    assert own._gap_costs(path, 11, 30)[2] == pytest.approx((0.006 / allowed) ** 2)
    assert own._gap_costs(path + np.array([1.0, 0, 0]), 11, 30)[2] == 2


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ([0, 1, 2, 3, 4, 5, -1], [0, 1, 2, 3, 4, 5, -1]),
        ([0, 1, 2, -1, -1, -1, -1], [0, 1, 2, 3, 4, 5, -1]),
    ],
)
def test_runs_are_named_by_distances_and_ghosts_are_not(
    given: list[int], wanted: list[int]
) -> None:
    """Six on one rigid body that turns, and a seventh that goes its own way."""
    shape = np.random.default_rng(8).uniform(-0.2, 0.2, (6, 3))
    turns = so3.exp(np.linspace([0.0, 0, 0], [0.5, 1.0, -0.3], 40))
    body = so3.rotate(turns[:, None], shape[None])
    ghost = np.linspace([0.5, 0.4, 0.1], [-0.4, 0.6, 0.7], 40)[:, None]
    ids = np.tile(np.arange(7), (40, 1))
    ids[20:, 5] = 7  # it is lost for a moment: the second half is a run of its own
    runs = Tracklets(ids, np.array([0] * 7 + [20]), np.array([39] * 5 + [19, 39, 39]))
    rest = np.linalg.norm(shape[:, None] - shape[None], axis=-1)
    positions = np.concatenate([body, ghost], axis=1)
    own = TrackletLabels(positions, runs, 100.0, np.array([*given, -1]), rest)
    own.name_runs()
    assert own.run_markers.tolist() == [*wanted, 5]
    assert_array_equal(own.marker_paths()[:, :6], body)


def test_frames_to_learn_from_are_all_near_and_some_far() -> None:
    seen = np.ones((400, 3), bool)
    seen[50:60, 1] = False
    spread = np.array([np.nan, 0.3, 0.1])
    gap = MarkerGap(np.zeros((400, 3, 3)), seen, 0, slice(200, 210), spread, 20.0)
    found = gap.training_frames(np.array([1, 2]))
    assert not np.isin(found, np.arange(200, 210)).any()
    assert not np.isin(found, np.arange(50, 60)).any()
    assert (found[0], found[-1]) == (80, 329)
    assert np.isin(np.arange(184, 200), found).all()
    assert np.isin(np.arange(210, 226), found).all()
    assert len(found) == 180
    assert_array_equal(found, np.sort(found))
    assert gap.nearest_markers().tolist() == [2, 1]
    assert replace(gap, marker=2).nearest_markers().tolist() == [1]
    assert replace(gap, frames=slice(55, 57)).nearest_markers().tolist() == [2]
    begins = _validation_spans(np.arange(100, 300), slice(200, 205))
    assert begins == [193, 207, 186, 214, 179, 221]
    assert _validation_spans(np.arange(199, 209), slice(200, 205)) == [207]


def test_a_process_over_time_joins_what_it_knows() -> None:
    times = np.array([0.0, 0.1, 0.3, 0.2])
    local = np.array([[1.0, 0, 0], [2.0, 0, 0], [3, 0, 0]])
    pose = np.array([[-1.0], [0], [1], [0.5]])
    lag = np.sqrt(5) * np.abs(times[:, None] - times[:3]) / 0.5
    over = 0.02**2 * (1 + lag + lag**2 / 3) * np.exp(-lag)
    features = pose / np.sqrt(2 / 3)
    variance = ((local - local.mean(axis=0)) ** 2).mean()
    for reach in (0.0, 2.0):
        alike = features @ features[:3].T
        if reach:
            apart = (features - features[:3].T) ** 2
            alike = alike + np.exp(-0.5 * apart / reach**2)
        found = _covariance(pose, times, reach, 0.02, 0.5, local)
        assert_allclose(found, variance * alike + over, rtol=1e-6)
    frames = np.array([*range(20), *range(24, 44), 20, 21, 22, 23])
    path = np.stack([frames[:40] * 0.001] * 3, axis=1)
    kernel = _covariance(np.zeros((44, 0)), frames / 100.0, 0.0, 0.03, 1.0, path)
    off, made = _predict_gap(path, kernel, frames, slice(20, 24))
    assert_allclose(made, np.stack([frames[40:] * 0.001] * 3, axis=1), atol=5e-4)
    assert 0 < off < 1e-3
    noise = 0.0005**2 * np.eye(40)
    exact = kernel[40:] @ np.linalg.solve(kernel[:40] + noise, path - path.mean(axis=0))
    assert_allclose(made, exact + path.mean(axis=0), atol=1e-9)


def test_frames_are_turned_the_shortest_way_to_a_point() -> None:
    above = np.stack([np.eye(3)] * 2)
    arms = np.array([[0.5, 0.1, 0], [0.5, -0.1, 0]])
    found = _rotate_towards(above, arms)
    angle = np.arctan2(0.1, 0.5)
    expected = so3.to_matrix(so3.exp(np.array([[0, 0, angle], [0, 0, -angle]])))
    assert_allclose(found, expected, atol=1e-9)


def test_gaps_are_curves_through_frames_around_them() -> None:
    t = np.arange(20.0)
    path = np.stack([t**2, t**3 / 50, 7 - t], axis=1)
    seen = np.ones(20, bool)
    seen[8:11] = False
    found = _polynomial_positions(path, seen, slice(8, 11))
    assert_allclose(found, path[8:11], atol=1e-8)
    assert _visible_frames_near(seen, 7, -1) == [7, 6, 5, 4, 3, 2]
    assert _visible_frames_near(seen, 11, 1) == [11, 12, 13, 14, 15, 16]
    seen[13] = False
    assert _polynomial_positions(path, seen, slice(8, 11)) is None
    seen[13], seen[14] = True, False
    assert_allclose(
        _polynomial_positions(path, seen, slice(8, 11)), path[8:11], atol=1e-6
    )
    names: Any = SimpleNamespace(names=("a", "*0", "b", "c"))
    rows = np.ones((9, 4), bool)
    rows[2:5, 0] = rows[7:, 0] = rows[3, 2] = rows[:, 1] = rows[:, 3] = False
    assert _sorted_gaps(names, rows) == [(1, 3, 2), (2, 7, 0), (3, 2, 0)]
    first, second = Prediction(np.zeros((1, 3)), 1.6), Prediction(np.ones((1, 3)), 1.01)
    assert (
        _most_accurate_prediction((first, "skeleton"), (second, "markers"))[1]
        == "skeleton"
    )
    second = Prediction(np.ones((1, 3)), 0.99)
    assert (
        _most_accurate_prediction(
            (first, "skeleton"), (None, "x"), (second, "markers")
        )[1]
        == "markers"
    )


def test_what_is_off_the_curve_of_frames_around() -> None:
    """Of a parabola nothing; what is off is so by what it is off."""
    t = np.arange(40.0)
    path = np.stack([t**2, 3 * t, 0 * t], axis=1) / 1000
    seen = np.ones(40, bool)
    for length in (1, 2):
        starts, off, gain, rest = _span_deviations(
            path, seen, length, 0.01, is_complete=True
        )
        assert starts.tolist() == list(range(7, 40 - 7 - length + 1))
        assert np.abs(off).max() < 1e-9
        assert max(gain.max(), rest.max()) < 1e-15
    path[20] += [0.03, 0, 0.04]
    starts, off, gain, _ = _span_deviations(path, seen, 1, 0.01)
    assert off[starts == 20] == pytest.approx(0.05)
    assert gain.argmax() == np.flatnonzero(starts == 20)[0]
    seen[10:20] = False
    found = _is_one_sided(seen, np.array([0, 5, 20, 22, 33, 39]), 1).tolist()
    assert found == [True, False, True, False, False, True]
    level = _local_noise(np.arange(100), np.where(np.arange(100) < 50, 0.1, 6.3), 100)
    assert (level[0], level[99]) == (1, pytest.approx(10))
    assert level.min() == 1


@pytest.mark.parametrize("sigma", [0.0005, 0.004])
def test_noise_of_a_path_is_told_by_what_is_off_its_curve(sigma: float) -> None:
    """White, about a slow curve: within a quarter; spans are no less noisy longer."""
    rng = np.random.default_rng(4)
    t = np.arange(600) / 100
    path = np.stack([np.sin(t), 0.3 * t, np.cos(0.7 * t)], axis=1)
    path += rng.normal(0, sigma, path.shape)
    _, noise = _noise_model(path, np.ones(600, bool))
    assert noise[0] == pytest.approx(sigma, rel=0.25)
    assert (np.diff(noise) >= 0).all()
    assert noise[-1] < 3 * sigma


def test_heads_are_posed_by_weighted_landmarks() -> None:
    turn = so3.exp(np.array([0.3, -0.2, 0.5]))
    seen = so3.rotate(turn, BODY) + np.array([1.0, 2, 3])
    frames = np.stack(
        [seen, seen, np.full_like(seen, np.nan), seen + np.array([0, 0, 1])]
    )
    frames[1, 4] += [0.0, 0.3, 0]
    frames[3, :4] = np.nan
    found = estimate_head_poses(BODY, frames)
    assert so3.angle_between(found[0, :4], turn) < 1e-7
    assert_allclose(found[0, 4:], [1, 2, 3], atol=1e-9)
    assert so3.angle_between(found[1, :4], turn) < 0.05
    assert_array_equal(found[2], found[1])
    assert_array_equal(found[3], found[1])
    rows = np.arange(4.0)[:, None]
    assert last_good_poses(rows, np.array([0, 1, 0, 1], bool))[:, 0].tolist() == [
        1,
        1,
        1,
        3,
    ]
    assert last_good_poses(rows, np.zeros(4, bool)) is rows
    placed = so3.rotate(turn, BODY) + np.array([0.1, -0.2, 4.0])
    pixels = placed[:, :2] / placed[:, 2:] * [800, 700] + [320, 240]
    lens = np.array([800.0, 700, 320, 240])
    pose = estimate_camera_pose(BODY, pixels, lens)
    assert pose is not None
    assert so3.angle_between(pose[:4], turn) < 1e-4
    assert_allclose(pose[4:], [0.1, -0.2, 4.0], atol=1e-3)
    pixels[3:] = np.nan
    assert estimate_camera_pose(BODY, pixels, lens) is None


def test_faces_know_which_shapes_move_and_which_are_alike() -> None:
    deltas = np.zeros((5, 6, 3))
    deltas[0, 1, 1] = 0.2
    deltas[1] = 3 * deltas[0]
    deltas[2] = -deltas[0]
    deltas[3, 2, 0] = 0.1
    deltas[4, 0, 0] = 0.9e-6 * rms_spread(BODY)
    face = FaceModel(tuple("abcdef"), ("A", "B", "C", "D", "E"), BODY, deltas)
    assert face.shapes_with_motion().tolist() == [True, True, True, True, False]
    assert face.similar_shapes() == [(0, 1)]
    codes = [notice.code for notice in face.notices()]
    assert codes == ["FAC101", "FAC102"]
    away = BODY - BODY.mean(axis=0)
    assert face.size == pytest.approx(np.sqrt((away**2).sum() / 6))
    assert rms_spread(BODY[:0]) == 0
    weights = np.array([[1.0, 0.5, 0, 2, 0]])
    expected = BODY + deltas[0] + 0.5 * deltas[1] + 2 * deltas[3]
    assert_allclose(face.points(weights), [expected])
    assert not face.nonlinear_offsets(weights).any()
    some = face.select(np.array([0, 0, 1, 1, 0], bool))
    assert some.shapes == ("C", "D")
    assert_array_equal(some.deltas, deltas[2:4])
    turn = so3.exp(np.array([0.1, 0.2, 0.3]))
    captured = so3.rotate(turn, 2 * BODY) + np.array([1.0, 0, 0])
    captured[5] = np.nan
    actor = face.with_proportions(captured)
    assert_allclose(actor.neutral, 2 * BODY, atol=1e-6)
    assert_allclose(actor.deltas, 2 * deltas)
    for keys in (
        {"neutral": BODY[:5]}, {"deltas": deltas[:4]}, {"neutral": BODY * np.nan},
        {"names": tuple("abcdea")}, {"shapes": ("A", "B", "C", "D", "A")},
    ):  # fmt: skip
        given = {
            "names": tuple("abcdef"),
            "shapes": face.shapes,
            "neutral": BODY,
            "deltas": deltas,
        }
        with pytest.raises(OptionError) as error:
            FaceModel(**{**given, **keys})  # type: ignore[arg-type]
        assert error.value.code == "FAC003"


def test_frames_that_are_sampled_have_most_markers() -> None:
    positions = np.zeros((12, 4, 3))
    positions[0:2, :2] = np.nan
    positions[4:8] = np.nan
    positions[5, :3] = 0.0
    positions[9, 0] = np.nan
    found = fullest_frames(positions, 3).tolist()
    assert found == [2, 5, 8]
    positions[5, 1] = np.nan
    assert fullest_frames(positions, 3).tolist() == [2, 8]
    assert len(fullest_frames(positions[:3], 9)) <= 3
    misses = np.full((10, 3), 1.538)
    misses[:, 1] = 3 * 1.538
    misses[:, 2] = 0.1
    misses[4:, 1] = np.nan
    assert_allclose(residual_noise(misses, 0.01), [1, 1, 0.5])
    misses[4, 1] = 3 * 1.538
    assert_allclose(residual_noise(misses, 0.01), [1, 3, 0.5])
    assert_allclose(residual_noise(misses, 2.0), [2, 3, 2])
    assert_allclose(residual_noise(misses * np.nan, 0.01), 0.01)


MARKERS = (
    TemplateMarker("LFHD", "head", (0.1, 0.2, 0.3), aliases=("Brow",)),
    TemplateMarker("RFHD", "head", weight=2.0, fixed=True),
    TemplateMarker("CLAV", "chest", (0.1234567, 0.0, -1.0)),
)
TEMPLATE = MarkerTemplate(MARKERS)


@pytest.mark.parametrize(
    ("names", "subject", "columns", "unused"),
    [
        (["RFHD", "LFHD", "CLAV"], None, [1, 0, 2], ()),
        (["Ann:RFHD", "*3", "Ann: brow", "X"], None, [2, 0, -1], ("X",)),
        (["lfhd", "LFHD", "RFHD"], None, [1, 2, -1], ("lfhd",)),
        (["A:LFHD", "B:LFHD", "B:RFHD"], "B", [1, 2, -1], ("A:LFHD",)),
    ],
)
def test_markers_of_a_template_are_found(
    names: list[str], subject: str | None, columns: list[int], unused: Any
) -> None:
    found = match_markers(TEMPLATE, names, subject)
    assert found.columns.tolist() == columns
    missing = [n for n, c in zip(TEMPLATE.names, columns, strict=True) if c < 0]
    assert (found.missing, found.unused) == (tuple(missing), unused)


@pytest.mark.parametrize(
    ("names", "subject", "code", "hint"),
    [
        (["A:LFHD", "B:LFHD"], None, "SOL002", "subject"),
        (["A:LFHD"], "B", "SOL001", ""),
        (["*0", "*1"], None, "SOL001", "label"),
        (["LFHF"], None, "SOL001", "'LFHD' is near 'LFHF'"),
        (["nothing like"], None, "SOL001", "add them to aliases"),
    ],
)
def test_markers_that_fit_nobody(
    names: Any, subject: Any, code: str, hint: str
) -> None:
    with pytest.raises(OptionError) as error:
        match_markers(TEMPLATE, names, subject)
    assert error.value.code == code
    assert hint in (error.value.faults[0].hint or "")


def test_a_template_writes_what_it_is() -> None:
    lines = template_text(TEMPLATE, "Of a person", "a.rig.yaml").splitlines()
    assert lines[:4] == [
        "# Of a person", "markers: animtool/1", "rig: a.rig.yaml", "marker_set:"
    ]  # fmt: skip
    assert lines[4] == (
        "- {name: LFHD, joint: head, offset: [0.1, 0.2, 0.3], aliases: [Brow]}"
    )
    assert "weight: 2" in lines[5]
    assert "fixed: true" in lines[5]
    assert "0.123457" in lines[6]
    assert "weight" not in lines[6]
    assert "rig:" not in template_text(TEMPLATE, "Of a person")
    assert TEMPLATE.weights.tolist() == [1, 2, 1]
    assert_allclose(TEMPLATE.offsets[2], [0.1234567, 0, -1])
    rig = Rig("a", (Joint("chest", -1), Joint("head", 0)))
    assert TEMPLATE.joints(rig).tolist() == [1, 1, 0]
    with pytest.raises(OptionError) as error:
        TEMPLATE.joints(Rig("a", (Joint("chest", -1), Joint("hand", 0))))
    assert [fault.where for fault in error.value.faults] == [
        "marker_set[0].joint", "marker_set[1].joint"
    ]  # fmt: skip


def test_a_camera_that_turned_is_stale_and_the_others_have_their_noise() -> None:
    """Of five that see by half a pixel one turned by three degrees."""
    rng = np.random.default_rng(6)
    cameras = ring(5)
    points = rng.uniform(-0.5, 0.5, (40, 8, 3))
    pixels = np.stack([project(each, points) for each in cameras], axis=1)
    turned = so3.to_matrix(so3.exp(np.array([0.0, 0.05, 0]))) @ cameras[2].rotation
    moved = camera(turned, (0.0, 0, 3.0))
    pixels[:, 2] = project(moved, points)
    pixels += rng.normal(0, 0.5, pixels.shape)
    clock = Clock(Fraction(30), Fraction(1), Fraction(1), 40)
    seen = Observations(tuple("abcdefgh"), clock, pixels)
    found = measure_noise(seen, cameras, 5.0, 6600.0)
    assert found.do_cameras_agree
    assert list(found.pose_changes) == [2]
    assert found.pose_changes[2].angle == pytest.approx(0.05, rel=0.1)
    assert_allclose(found.deviations_px, 0.5, rtol=0.2)
    good = pixels.copy()
    good[:, 2] = project(cameras[2], points) + rng.normal(0, 0.5, (40, 8, 2))
    found = measure_noise(replace(seen, stored=good), cameras, 5.0, 6600.0)
    assert (found.do_cameras_agree, found.pose_changes) == (True, {})
    assert_allclose(found.deviations_px, 0.5, rtol=0.2)
    # All alike, they have one noise; one that is twice as noisy has its own.
    assert np.ptp(found.deviations_px) == 0
    loud = good.copy()
    loud[:, 1] += rng.normal(0, 1.0, (40, 8, 2))
    found = measure_noise(replace(seen, stored=loud), cameras, 5.0, 6600.0)
    assert found.deviations_px[1] > 1.5 * found.deviations_px[0]
    assert np.ptp(np.delete(found.deviations_px, 1)) == 0


@pytest.mark.parametrize("keep", [False, True])
def test_a_camera_is_kept_where_the_others_are_no_better_excluded(keep: bool) -> None:
    ranges = [PoseShift(0, 5, 0.9), PoseShift(9, 12, 0.8)]
    run: Any = SimpleNamespace(
        options=TriangulateOptions(keep_moved=keep),
        _is_better_without=lambda camera, moved: (camera, moved.first) == (3, 9),
    )
    found = _TriangulationRun._mark_kept_ranges(run, 3, ranges)
    assert [one.kept for one in found] == ([False, False] if keep else [True, False])
    assert [(one.first, one.end) for one in found] == [(0, 5), (9, 12)]


@pytest.mark.parametrize("keep", [False, True])
def test_cameras_are_left_out_where_they_moved_the_worst_first(
    keep: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A third one stays, as the others are no better without it."""
    found = [
        (1, [PoseShift(2, 4, 0.9)]),
        (0, [PoseShift(0, 3, 0.8), PoseShift(5, 6, 0.7)]),
    ]
    found += [(2, [replace(PoseShift(1, 2, 0.6), kept=True)])]
    seen: list[Any] = []

    def worst(*given: Any) -> Any:
        *_, checked, rate = given
        seen.append((checked.copy(), rate))
        return found.pop(0) if found else None

    monkeypatch.setitem(
        _TriangulationRun._exclude_shifted_cameras.__globals__,
        "find_shifted_ranges",
        worst,
    )
    solved: list[tuple[int, int]] = []
    run: Any = SimpleNamespace(
        observations=SimpleNamespace(clock=SimpleNamespace(rate=Fraction(25))),
        is_active=np.ones((6, 3), bool),
        shifts=[[], [], [PoseShift(4, 6, 0.5)]],
        view_count=9,
        counts=SimpleNamespace(tested=0, rejected=0),
        options=TriangulateOptions(keep_moved=keep),
        _mark_kept_ranges=lambda _, ranges: ranges,
        _with_pose_change=lambda _, each: each,
        _solve_frames=lambda first, end: solved.append((first, end)),
    )
    _TriangulationRun._exclude_shifted_cameras(run)
    active = np.ones((6, 3), bool)
    if not keep:
        active[2:4, 1] = active[:3, 0] = active[5, 0] = False
    assert_array_equal(run.is_active, active)
    assert solved == ([] if keep else [(2, 4), (0, 3), (5, 6)])
    checked = np.ones((6, 3), bool)
    checked[4:, 2] = False
    assert_array_equal(seen[0][0], checked)
    checked[2:4, 1] = checked[:3, 0] = checked[5, 0] = checked[1, 2] = False
    assert_array_equal(seen[-1][0], checked)
    assert {rate for _, rate in seen} == {25.0}
    assert [len(each) for each in run.shifts] == [2, 1, 2]
