"""Triangulation: the optimum, outliers, swaps, cameras that moved, and few cameras."""

from __future__ import annotations

import importlib
from dataclasses import replace

import numpy as np
import pytest
from support.stage import changed, look_at, observed, ring, walkers
from support.suite import some_quick

from animtool import _kernels
from animtool.capture.cameras import (
    TriangulateOptions,
    Triangulation,
    project,
    triangulate,
)
from animtool.capture.cameras.camera import Cameras, camera_parameters, pixel_rays
from animtool.capture.cameras.observations import Observations
from animtool.capture.cameras.stale import PoseShift
from animtool.capture.cameras.triangulate import _TriangulationRun
from animtool.core.array_types import FloatArray
from animtool.core.errors import AnimtoolError
from animtool.maths.so3 import exp, to_matrix

POINTS = walkers(90, 12)


def off(found: FloatArray, points: FloatArray = POINTS) -> FloatArray:
    """Return how far points are off [mm] ``(F, M)``."""
    return np.asarray(1000 * np.linalg.norm(found - points, axis=-1))


def test_without_noise_the_points_are_exact() -> None:
    cameras = ring(5)
    found = triangulate(observed(cameras, POINTS, noise=0.0), cameras)
    assert off(found.markers.positions).max() < 1e-6
    assert found.error_px < 1e-6
    assert (found.triangulated, found.visible) == (90 * 12, 90 * 12)
    assert not found.notices


def test_rays_lead_back_to_pixels() -> None:
    camera = ring(3).cameras[1]
    pixels = project(camera, POINTS)
    directions = np.concatenate(
        [pixel_rays(camera, pixels), np.ones((90, 12, 1))], axis=-1
    )
    there = camera.position + 3 * directions @ camera.rotation
    np.testing.assert_allclose(project(camera, there), pixels, atol=1e-8)


def test_the_answer_is_the_least_squares_one() -> None:
    from scipy.optimize import least_squares

    cameras = ring(4)
    seen = observed(cameras, POINTS[:2], noise=0.8)
    found = triangulate(seen, cameras, TriangulateOptions(noise=0.8, gate=100.0))
    for f, m in ((0, 0), (1, 7)):

        def residuals(point: FloatArray, f: int = f, m: int = m) -> FloatArray:
            shown = [project(camera, point) for camera in cameras.cameras]
            return np.ravel(shown - seen.stored[f, :, m])

        best = least_squares(
            residuals, POINTS[f, m], xtol=1e-15, ftol=1e-15, gtol=1e-15
        )
        np.testing.assert_allclose(found.markers.positions[f, m], best.x, atol=1e-8)


def test_the_standard_error_is_what_noise_makes() -> None:
    cameras = ring(6)
    points = walkers(400, 6)
    found = triangulate(observed(cameras, points, noise=0.5), cameras)
    error = np.linalg.norm(found.markers.positions - points, axis=-1)
    ratio = np.sqrt(np.mean((error / found.deviations) ** 2))
    assert ratio == pytest.approx(1, abs=0.05)
    assert [c.noise_px for c in found.cameras] == pytest.approx([0.5] * 6, rel=0.06)


def test_outliers_and_swaps_are_survived() -> None:
    cameras = ring(6)
    clean = observed(cameras, POINTS)
    rng = np.random.default_rng(5)
    pixels = clean.stored.copy()
    wrong = rng.random(pixels.shape[:3]) < 0.02
    pixels[wrong] += rng.uniform(10, 60, (int(wrong.sum()), 2))
    pixels[20:60, 2, [3, 8]] = pixels[20:60, 2, [8, 3]]
    wrong[20:60, 2, [3, 8]] = True
    found = triangulate(changed(clean, pixels), cameras)
    known = np.where(wrong[..., None], np.nan, clean.stored)
    best = triangulate(changed(clean, known), cameras)
    rms = [np.sqrt(np.mean(off(t.markers.positions) ** 2)) for t in (found, best)]
    assert rms[0] <= 1.005 * rms[1]
    assert off(found.markers.positions).max() < 5
    assert found.markers.cameras is not None
    assert (found.markers.cameras[20:60, 3] <= 5).all()


@pytest.mark.parametrize("count", [6, 8])
def test_swapped_cameras_are_named(count: int) -> None:
    cameras = ring(count)
    names = [camera.name for camera in cameras.cameras]
    swapped = list(cameras.cameras)
    swapped[1], swapped[4] = (
        replace(swapped[4], name=names[1]),
        replace(swapped[1], name=names[4]),
    )
    found = triangulate(observed(cameras, POINTS), Cameras(tuple(swapped)))
    matching = {
        camera.name: shift.change.matching
        for camera in found.cameras
        for shift in camera.shifts
        if shift.change is not None and shift.change.matching
    }
    assert matching == {names[1]: names[4], names[4]: names[1]}


@pytest.mark.parametrize("count", [4, 6])
def test_a_stale_camera_is_named_and_left_out(count: int) -> None:
    cameras = ring(count)
    seen = observed(cameras, POINTS)
    stale = cameras.cameras[1]
    turn = to_matrix(exp([0.004, 0.01, 0.0]))
    moved = replace(
        stale, rotation=turn @ stale.rotation, translation=turn @ stale.translation
    )
    given = list(cameras.cameras)
    given[1] = moved
    found = triangulate(seen, Cameras(tuple(given)))
    assert [f.code for f in found.notices if f.code != "CAM105"] == ["CAM101"]
    assert "'cam1'" in found.notices[0].message
    assert [bool(c.shifts) for c in found.cameras] == [i == 1 for i in range(count)]
    change = found.cameras[1].shifts[0].change
    assert change is not None
    assert change.angle == pytest.approx(np.hypot(0.004, 0.01), rel=0.1)
    assert np.isfinite(found.markers.positions).mean() > 0.97
    assert np.nanmedian(off(found.markers.positions)) < 3


def test_a_camera_that_moves_midway_is_named_with_its_frames() -> None:
    cameras = ring(6)
    points = walkers(240, 12)
    seen = observed(cameras, points)
    pixels = seen.stored.copy()
    pixels[100:180, 4] += [9.0, 6.0]
    found = triangulate(changed(seen, pixels), cameras)
    (moved,) = found.cameras[4].shifts
    assert abs(moved.first - 100) <= 2
    assert abs(moved.end - 180) <= 2
    assert off(found.markers.positions, points).max() < 6
    kept = triangulate(
        changed(seen, pixels), cameras, TriangulateOptions(keep_moved=True)
    )
    assert [bool(c.shifts) for c in kept.cameras] == [False] * 4 + [True, False]


@pytest.mark.parametrize("count", [3, 4, 6])
def test_a_view_that_disagrees_in_single_frames_is_named(count: int) -> None:
    cameras = ring(count)
    seen = observed(cameras, POINTS)
    assert not triangulate(seen, cameras).notices
    pixels = seen.stored.copy()
    bumped = [12, 40, 41, 77]
    pixels[bumped, 1] += [14.0, -9.0]
    found = triangulate(changed(seen, pixels), cameras)
    named = [[each.frame for each in c.disagrees] for c in found.cameras]
    assert named == [bumped if i == 1 else [] for i in range(count)]
    assert "CAM111" in [f.code for f in found.notices]
    assert not found.cameras[1].shifts
    assert np.nanmax(off(found.markers.positions)) < 8


def test_two_cameras_name_the_frames_in_which_they_disagree() -> None:
    cameras = ring(2, turn=0.5)
    seen = observed(cameras, POINTS)
    assert not triangulate(seen, cameras).notices
    pixels = seen.stored.copy()
    pixels[[12, 40], 1] += [-20.0, 40.0]
    found = triangulate(changed(seen, pixels), cameras)
    (fault,) = [f for f in found.notices if f.code == "CAM112"]
    assert "2 frames: 13, 41" in fault.message
    assert np.isnan(found.markers.positions[[12, 40]]).mean() > 0.5


@pytest.mark.parametrize("count", [3, 4, 6])
@pytest.mark.parametrize("first", some_quick([0, 60, 120, 180], 2))
def test_a_moved_camera_left_out_is_no_worse_than_kept(count: int, first: int) -> None:
    cameras = ring(count)
    points = walkers(240, 14)
    last = cameras.cameras[-1]
    turn = to_matrix(exp([0.004, 0.01, 0.0]))
    moved = replace(
        last,
        rotation=turn @ last.rotation,
        translation=turn @ last.translation + np.array([0.01, 0.0, 0.02]),
    )
    seen = observed(cameras, points)
    pixels = seen.stored.copy()
    there = observed(Cameras((*cameras.cameras[:-1], moved)), points)
    pixels[first:, -1] = there.stored[first:, -1]
    left_out, kept = (
        triangulate(changed(seen, pixels), cameras, TriangulateOptions(keep_moved=keep))
        for keep in (False, True)
    )

    def others(found: Triangulation) -> float:
        return float(np.sqrt(np.mean([c.error_px**2 for c in found.cameras[:-1]])))

    assert others(left_out) <= 1.005 * others(kept)
    assert left_out.triangulated >= kept.triangulated
    if count > 3:
        ranges = [(m.first, m.end, m.kept) for m in left_out.cameras[-1].shifts]
        assert ranges == [(first, 240, False)]


@pytest.mark.parametrize("count", [3, 4, 6])
@pytest.mark.parametrize("what", ["translation", "focal", "pixels"])
def test_a_camera_of_wrong_scale_is_left_out(count: int, what: str) -> None:
    cameras = ring(count)
    last = cameras.cameras[-1]
    seen = observed(cameras, POINTS)
    pixels = seen.stored.copy()
    if what == "translation":
        last = replace(last, translation=1000 * last.translation)
    elif what == "focal":
        last = replace(last, focal=(1.1 * last.focal[0], 1.1 * last.focal[1]))
    else:
        pixels[:, -1] *= 0.5
    given = Cameras((*cameras.cameras[:-1], last))
    found = triangulate(changed(seen, pixels), given)
    assert [[(m.first, m.end) for m in c.shifts] for c in found.cameras] == [
        *[[]] * (count - 1),
        [(0, len(POINTS))],
    ]
    assert np.nanmax(off(found.markers.positions)) < 9


def test_blocks_do_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    cameras = ring(4)
    seen = observed(cameras, POINTS)
    whole = triangulate(seen, cameras)
    module = importlib.import_module("animtool.capture.cameras.triangulate")
    monkeypatch.setattr(module, "BLOCK_VALUES", 7 * 4 * 12)
    parts = triangulate(seen, cameras)
    for name in ("positions", "residuals", "cameras"):
        one, other = (getattr(t.markers, name) for t in (whole, parts))
        assert one.tobytes() == other.tobytes()
    assert whole.cameras == parts.cameras


def test_what_one_camera_sees_is_a_gap() -> None:
    cameras = ring(4)
    seen = observed(cameras, POINTS)
    pixels = seen.stored.copy()
    pixels[10:20, 1:, 0] = np.nan
    pixels[:, :, 5] = np.nan
    found = triangulate(changed(seen, pixels), cameras)
    gaps = np.isnan(found.markers.positions[..., 0])
    assert gaps[10:20, 0].all()
    assert gaps[:, 5].all()
    assert gaps.sum() == 100
    assert [f.code for f in found.notices] == ["CAM104"]
    assert "M5" in found.notices[0].message


def test_flat_rays_have_no_depth() -> None:
    cameras = ring(2)
    near = replace(cameras.cameras[0], name="near")
    near = replace(near, translation=near.translation + np.array([0.02, 0, 0]))
    pair = Cameras((cameras.cameras[0], near))
    with pytest.raises(AnimtoolError) as caught:
        triangulate(observed(pair, POINTS), pair)
    assert caught.value.code == "CAM014"
    found = triangulate(observed(pair, POINTS), pair, TriangulateOptions(min_angle=0.0))
    assert np.isfinite(found.markers.positions).any()


def test_confidences_weight() -> None:
    cameras = ring(3)
    seen = observed(cameras, POINTS, noise=0.0)
    pixels = seen.stored.copy()
    pixels[:, 0] += 0.5
    trust = np.ones(pixels.shape[:3])
    errors = []
    for weight in (1.0, 0.01, 0.0):
        trust[:, 0] = weight
        given = replace(changed(seen, pixels), confidences=trust.copy())
        found = triangulate(given, cameras, TriangulateOptions(noise=1.0))
        errors.append(np.nanmean(off(found.markers.positions)))
    assert errors[0] > 5 * errors[1] > 0
    assert errors[2] < 1e-6


def test_faults() -> None:
    cameras = ring(3)
    seen = observed(cameras, POINTS)
    others = replace(seen, cameras=("cam0", "cam1", "cam7"))
    nothing = changed(seen, np.full_like(seen.stored, np.nan))
    alone = replace(seen, stored=seen.stored[:, :1], cameras=("cam0",))
    unnamed = replace(seen, stored=seen.stored[:, :2], cameras=())
    options = TriangulateOptions
    for given, stage, chosen, code in (
        (others, cameras, options(), "CAM011"),
        (unnamed, cameras, options(), "CAM011"),
        (alone, cameras, options(), "CAM012"),
        (nothing, cameras, options(), "CAM013"),
        (seen, cameras, options(gate=0.0), "CAP001"),
        (seen, cameras, options(noise=float("nan")), "CAP001"),
        (seen, cameras, options(min_angle=2.0), "CAP001"),
    ):
        with pytest.raises(AnimtoolError) as caught:
            triangulate(given, stage, chosen)
        assert caught.value.code == code


def test_cameras_that_disagree_are_named_and_nothing_is_empty() -> None:
    cameras = ring(3)
    seen = observed(cameras, POINTS)
    first, second, third = cameras.cameras
    swapped = (replace(second, name="cam0"), replace(first, name="cam1"), third)
    turn = to_matrix(exp([0.004, 0.01, 0.0]))
    turned = replace(
        second, rotation=turn @ second.rotation, translation=turn @ second.translation
    )
    for given in (swapped, (first, turned, third)):
        found = triangulate(seen, Cameras(given))
        assert "CAM108" in [f.code for f in found.notices]
        assert found.triangulated > 0.9 * found.visible
    tilted = replace(first, rotation=to_matrix(exp([0, 0, 1.2])) @ first.rotation)
    pair = replace(seen, stored=seen.stored[:, :2], cameras=("cam0", "cam1"))
    with pytest.raises(AnimtoolError) as caught:
        triangulate(pair, Cameras((tilted, second)))
    assert caught.value.code == "CAM014"


def test_odd_cameras_are_named() -> None:
    cameras = ring(5)
    seen = observed(cameras, POINTS)
    pixels = seen.stored.copy()
    pixels[:, 4] = np.nan
    small = list(cameras.cameras)
    small[0] = replace(small[0], size=(800, 600))
    found = triangulate(changed(seen, pixels), Cameras(tuple(small)))
    assert [f.code for f in found.notices] == ["CAM107", "CAM103"]
    assert found.cameras[0].outside > 0
    folded = list(cameras.cameras)
    folded[3] = replace(folded[3], distortion=(-15.0, *[0.0] * 7))
    found = triangulate(seen, Cameras(tuple(folded)))
    assert "CAM106" in [f.code for f in found.notices]


def test_the_kernel_checks_its_arguments() -> None:
    cameras = camera_parameters(ring(2).cameras)
    good = {
        "pixels": np.zeros((1, 2, 1, 2)), "confidences": None, "cameras": cameras,
        "is_active": np.ones((1, 2), bool), "noise": np.ones(2), "outlier_gate": 5.0,
        "max_condition": 100.0, "has_details": True,
    }  # fmt: skip
    points, *_, states = _kernels.triangulate_points(**good)
    assert np.isnan(points).all() or states.max() == 1
    broken = cameras.copy()
    broken[0, 0] = 0
    for name, value in (
        ("pixels", np.zeros((1, 3, 1, 2))),
        ("cameras", broken),
        ("cameras", cameras * np.nan),
        ("is_active", np.ones((2, 2), bool)),
        ("noise", np.zeros(2)),
        ("outlier_gate", -1.0),
        ("max_condition", np.nan),
        ("confidences", np.zeros((1, 2, 2))),
    ):
        with pytest.raises(
            ValueError, match=r"cameras|is_active|noise|outlier_gate|max_cond|conf"
        ):
            _kernels.triangulate_points(**{**good, name: value})


@pytest.mark.parametrize(("share", "known"), [(0.95, True), (1.05, False)])
@pytest.mark.parametrize("angle", [3.0, 20.0])
def test_the_least_angle_is_that_of_two_rays(
    angle: float, share: float, known: bool
) -> None:
    """Two cameras 5 m from a point, seen from it at an angle [degrees]."""
    half = np.radians(angle) / 2
    places = [5 * np.array([np.sin(a), 0.0, np.cos(a)]) for a in (half, -half)]
    pair = Cameras(
        tuple(look_at(p, np.zeros(3), f"c{i}") for i, p in enumerate(places))
    )
    point = np.zeros((3, 1, 3))
    # Of another all of it is known, so that something is found.
    far = np.tile([0.0, 0.0, 4.0], (3, 1, 1))
    seen = observed(pair, np.concatenate([point, far], axis=1), noise=0.0)
    options = TriangulateOptions(noise=1.0, min_angle=np.radians(angle) * share)
    found = triangulate(seen, pair, options).markers.positions
    assert np.isfinite(found[:, 0]).all() == known
    assert np.isfinite(found[:, 1]).all()


def test_a_long_range_is_judged_by_fifty_of_its_frames_and_their_confidences() -> None:
    """Of 20 to 220 each fourth; two of six cameras are wrong in these, and unsure."""
    cameras, points = ring(6), walkers(240, 12)
    seen = observed(cameras, points)
    pixels, sure = seen.stored.copy(), np.ones(seen.stored.shape[:3])
    judged = np.arange(20, 220, 4)
    assert len(judged) == 50
    pixels[20:220, 1] += [14.0, -9.0]
    pixels[judged, 4] += [-16.0, 12.0]
    sure[judged, 4] = 0.0
    asked: list[tuple[int, ...]] = []

    class Asked(Observations):
        def confidences_of(self, *frames: int) -> FloatArray | None:
            asked.append(frames)
            return super().confidences_of(*frames)

    given = Asked(seen.names, seen.clock, pixels, seen.cameras, confidences=sure)
    run = _TriangulationRun(given, cameras, TriangulateOptions(), None)
    run.noise[:] = 0.4
    assert run._is_better_without(1, PoseShift(20, 220, 1.0))
    assert asked == [(20, 220, 4)]


@pytest.mark.parametrize("delay", [-5, 0, 2, 7])
def test_a_late_camera_is_named_with_its_delay(delay: int) -> None:
    cameras = ring(5)
    seen = observed(cameras, POINTS, noise=0.3)
    shifted = seen.stored.copy()
    shifted[:, 2] = np.roll(shifted[:, 2], delay, axis=0)
    result = triangulate(replace(seen, stored=shifted), cameras)
    delayed = [notice for notice in result.notices if notice.code == "CAM115"]
    assert len(delayed) == bool(delay)
    for notice in delayed:
        name = cameras.cameras[2].name
        assert repr(name) in notice.message
        assert notice.hint is not None
        assert notice.hint.startswith(f"shift its frames by {-delay}")
        others = {one.code for one in result.notices if repr(name) in one.message}
        assert others == {"CAM115"}


@pytest.mark.parametrize("is_swapped", [True, False])
def test_pixels_in_another_convention_are_named(is_swapped: bool) -> None:
    cameras = ring(5)
    seen = observed(cameras, POINTS)
    stored = seen.stored[..., ::-1].copy()
    if not is_swapped:
        heights = [camera.size[1] for camera in cameras.cameras if camera.size]
        assert len(heights) == 5
        stored = seen.stored.copy()
        stored[..., 1] = np.array(heights)[:, None] - stored[..., 1]
    with pytest.raises(AnimtoolError) as caught:
        triangulate(replace(seen, stored=stored), cameras)
    (fault,) = caught.value.faults
    assert fault.code == "CAM014"
    assert ("[v, u]" in fault.message) is is_swapped


@pytest.mark.parametrize("factor", [2.0, 0.5, 4.0])
def test_pixels_of_another_image_size_are_named(factor: float) -> None:
    cameras = ring(5)
    seen = observed(cameras, POINTS)
    with pytest.raises(AnimtoolError) as caught:
        triangulate(replace(seen, stored=seen.stored / factor), cameras)
    (fault,) = caught.value.faults
    assert fault.code == "CAM014"
    assert f"if pixels are {factor:g} times as large" in fault.message
