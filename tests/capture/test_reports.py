"""What is said of cameras, faces, skeletons and signals, and what their files hold."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from animtool.capture.cameras.camera import Camera, Cameras
from animtool.capture.cameras.observations import (
    Observations,
    match_cameras,
    read_observations,
)
from animtool.capture.cameras.report import (
    CameraReport,
    ObservationCounts,
    camera_notices,
    gap_notices,
    lost_frame_notices,
)
from animtool.capture.cameras.stale import (
    CameraDisagreement as Disagreement,
)
from animtool.capture.cameras.stale import (
    PoseChange,
    PoseShift,
)
from animtool.capture.clean import (
    CleanedSignal,
    CleanOptions,
    _check_cutoff,
    _check_spikes,
    _find_spikes,
    _roughness,
    _run_deviations,
    bridge_gaps,
    cleaning_notices,
    noise_scores,
)
from animtool.capture.face.capture import FaceCapture, order_landmarks, read_capture
from animtool.capture.face.model import FaceModel
from animtool.capture.face.poses import interpolate_poses
from animtool.capture.face.solve import (
    _check_landmarks,
    _merge_shapes,
    _notices,
)
from animtool.capture.markers.skeleton import DRIFT_PER_SECOND, SkeletonMarkers
from animtool.capture.options import FillOptions, SolveOptions, TriangulateOptions
from animtool.capture.solve.run import check_units, positions_in_rig_axes
from animtool.core.clock import Clock
from animtool.core.errors import AnimtoolError, FormatError, OptionError
from animtool.core.units import LengthUnit, UpAxis
from animtool.maths import so3
from animtool.motion.markers import Markers

CLOCK = Clock(Fraction(30), Fraction(1), Fraction(1), 10)
PLAIN = Camera("a", (800.0, 700.0), (320.0, 240.0), np.eye(3), np.zeros(3), (640, 480))


@pytest.mark.parametrize(("size", "found"), [((480, 640), True), ((800, 600), False)])
def test_an_image_with_width_and_height_exchanged(
    size: tuple[int, int], found: bool
) -> None:
    made = CameraReport("a", 9, 9, 0.0, 1.0, 1.0, noise_px=1.0, outside=3)
    camera = replace(PLAIN, size=size)
    (fault,) = camera_notices(made, camera, CLOCK, "p", is_kept=False)
    assert fault.code == "CAM107"
    assert ("write 640 x 480" in (fault.hint or "")) == found


def test_what_captures_take_where_nothing_is_given() -> None:
    assert CleanOptions() == CleanOptions(3, False, None)
    own = TriangulateOptions()
    assert (own.noise, own.gate, own.keep_moved) == (None, 5, False)
    assert own.min_angle == pytest.approx(np.radians(2))
    assert FillOptions() == FillOptions(False, False, False, None)
    assert SolveOptions() == SolveOptions(0.0005, 100.0, None)


def test_tallies_become_errors() -> None:
    rows = np.zeros((2, 2, 8))
    rows[0, 0] = [10, 8, 9, 1, 2, 8.0, 0.32, 3]
    rows[1, 0] = [5, 2, 3, 1, 0, 32.0, 0.08, 1]
    own = ObservationCounts(rows)
    made = own.report(0, "a", 0.7, ())
    assert (made.observed, made.used, made.no_ray, made.outside) == (15, 10, 2, 4)
    assert (made.outliers, made.noise_px) == (pytest.approx(2 / 12), 0.7)
    assert (made.error_px, made.error_mm) == pytest.approx((2, 200))
    none = own.report(1, "b", 0.7, ())
    assert (none.observed, none.outliers) == (0, 0)
    assert np.isnan([none.error_px, none.error_mm]).all()
    assert own.reprojection_errors() == pytest.approx((2, 200))
    assert (own.used[1, 0], own.tested[0, 0], own.rejected[0, 0]) == (2, 9, 1)


@pytest.mark.parametrize(
    ("keys", "codes", "texts"),
    [
        ({}, [], []),
        ({"outliers": 0.1}, [], []),
        ({"outliers": 0.11}, ["CAM102"], ["11"]),
        ({"observed": 0}, ["CAM103"], ["sees nothing"]),
        ({"no_ray": 1}, ["CAM106"], ["1 pixel"]),
        ({"outside": 2}, ["CAM107"], ["2 pixels of camera 'a'", "image of 640 x 480"]),
        (
            {"shifts": (PoseShift(2, 5, 0.7),), "outliers": 0.5},
            ["CAM101"], ["frames 3 to 5", "it is excluded in these frames"],
        ),
        (
            {"shifts": (PoseShift(0, 10, 0.7, PoseChange(0.1, 0.2, 0.3)),)},
            ["CAM101"], ["in any frame", "5.73 deg"],
        ),
        (
            {"shifts": (PoseShift(0, 9, 0.7, None, True),)},
            ["CAM101"], ["frames 1 to 9", "it is kept: without it"],
        ),
        (
            {"disagrees": (Disagreement(3, 0.2, 1.0), Disagreement(6, 0.8, 1.0))},
            ["CAM111"], ["in 2 frames", "80", "outliers in 7"],
        ),
        ({"disagrees": (Disagreement(3, 0.0, 1.0),)}, ["CAM111"], ["in 1 frame: 4"]),
    ],
)  # fmt: skip
def test_what_is_said_of_a_camera(
    keys: Any, codes: list[str], texts: list[str]
) -> None:
    given = {
        "observed": 9,
        "used": 9,
        "outliers": 0.0,
        "error_px": 1.0,
        "error_mm": 1.0,
    }
    made = CameraReport("a", noise_px=1.0, **{**given, **keys})
    found = list(camera_notices(made, PLAIN, CLOCK, "p", is_kept=False))
    assert [fault.code for fault in found] == codes
    assert all(text in found[0].message for text in texts)
    unsized = replace(PLAIN, size=None)
    told = [f.code for f in camera_notices(made, unsized, CLOCK, "p", is_kept=False)]
    assert told == [code for code in codes if code != "CAM107"]
    kept = list(camera_notices(made, PLAIN, CLOCK, "p", is_kept=True))
    assert [f.code for f in kept] == codes
    if codes == ["CAM101"]:
        assert "it is kept" in kept[0].message


def test_frames_that_are_lost_and_points_that_are_gaps() -> None:
    places = np.zeros((10, 6, 3))
    seen = np.ones((10, 6), bool)
    places[2, :4] = np.nan
    places[4, :3] = np.nan
    places[6, :2] = np.nan
    seen[6, 2:5] = False
    (one,) = lost_frame_notices(places, seen, CLOCK, "p")
    assert (one.code, one.path) == ("CAM112", "p")
    assert "in 1 frame: 3;" in one.message
    assert not list(
        lost_frame_notices(places[2:3], seen[2:3], replace(CLOCK, count=1), "p")
    )
    places[:, 5] = np.nan
    first, second = gap_notices("abcdef", places, 57, "p")
    assert (first.code, second.code) == ("CAM104", "CAM105")
    assert "agree on f in" in first.message
    assert second.message.startswith("16 points")
    assert [f.code for f in gap_notices("abcdef", places, 41, "p")] == ["CAM104"]


def skeleton(joints: Any, parents: Any, free: Any) -> SkeletonMarkers:
    count = len(joints)
    rows = np.zeros((4, count, 3))
    rows[2, 1] = np.nan
    known = np.array([1, 1, 1, 0], bool)
    turns = np.zeros((4, count, 3, 3))
    return SkeletonMarkers(
        rows,
        turns,
        rows,
        turns,
        np.array(joints),
        np.array(parents),
        np.array(free),
        known,
        (),
    )


def test_a_skeleton_tells_where_markers_are_that_hold_its_joints() -> None:
    own = skeleton([0, 1, 1, 1, 2, 2, -1], [-1, 0, 1], [True, True, False])
    every = np.ones(7, bool)
    assert own.is_predicted(0, slice(0, 3))
    assert not own.is_predicted(1, slice(0, 3))
    assert not own.is_predicted(0, slice(2, 4))
    assert [own.has_parent(m) for m in (0, 1, 6)] == [False, True, False]
    assert own.markers_on_joint(1, every) == [2, 3]
    assert own.drift_speed(1, every) == 0
    for hidden, expected in (
        ([3], DRIFT_PER_SECOND[0]), ([3, 4, 5], DRIFT_PER_SECOND[1]),
        ([2, 3], DRIFT_PER_SECOND[1]),
        ([2, 3, 4], DRIFT_PER_SECOND[2]), ([2, 3, 4, 5], DRIFT_PER_SECOND[2]),
    ):  # fmt: skip
        seen = every.copy()
        seen[hidden] = False
        assert own.drift_speed(1, seen) == expected
    # A hinge is held by one more, on it or below.
    assert own.drift_speed(4, every) == 0
    every[5] = False
    assert own.drift_speed(4, every) == DRIFT_PER_SECOND[2]
    assert DRIFT_PER_SECOND == (0.004, 0.008, 0.02)


def test_spikes_of_a_signal_are_off_both_lines_and_both_ends() -> None:
    signal = np.zeros((30, 3))
    signal[:, 0] = 0.1 * np.arange(30)
    signal[10:12, 1] = 1.0
    signal[20, 2] = -0.5
    bad = _find_spikes(signal, 3, 0.2, is_rotation=False)
    assert np.flatnonzero(bad).tolist() == [10, 11, 20]
    assert np.flatnonzero(_find_spikes(signal, 1, 0.2, is_rotation=False)).tolist() == [
        20
    ]
    assert not _find_spikes(signal, 0, 0.2, is_rotation=False).any()
    assert np.flatnonzero(_find_spikes(signal, 3, 0.7, is_rotation=False)).tolist() == [
        10,
        11,
    ]
    sizes = dict(_run_deviations(signal, 2, is_rotation=False))
    assert sorted(sizes) == [1, 2]
    assert sizes[1][18] == pytest.approx(0.5)
    assert sizes[2][8] == pytest.approx(1.0)
    bent = np.zeros((9, 1))
    bent[4:, 0] = np.arange(5)
    assert _roughness(bent).tolist() == [0] * 9
    assert _roughness(bent[:2]).tolist() == [0, 0]
    across = bridge_gaps(signal[:15], ~bad[:15], is_rotation=False)
    assert np.abs(across[10:12, 1]).max() < 0.05
    assert_array_equal(across[~bad[:15]], signal[:15][~bad[:15]])
    turns = np.array([[0.0, 0, 0, 1], [0, 0, 0, -1]])
    assert so3.align_to(turns, turns[::-1]).tolist() == [[0, 0, 0, -1], [0, 0, 0, 1]]


def test_what_was_cleaned_is_counted() -> None:
    signals = [
        CleanedSignal("a", False, (1, 2), 0.002, 5.0),
        CleanedSignal("a", True, (2,), 0.01, None),
        CleanedSignal("b", True, (), 0.03, 3.0),
    ]
    assert [s.name for s in signals] == ["a translation", "a rotation", "b rotation"]
    assert signals[0].text(signals[0].noise).endswith("mm")
    assert "1.7" in signals[2].text(signals[2].noise)
    found = noise_scores(10, signals)
    values = [(s.value, s.usual) for s in found.scores]
    assert values == [(0.002, 1e-3), (0.03, np.radians(0.2)), (0.2, 0.01)]
    assert found.names["spikes"] == ("a translation in 2", "a rotation in 1")
    assert [n.split(",")[0] for n in found.names["filtered"]] == [
        "b rotation at 3 Hz", "a translation at 5 Hz"
    ]  # fmt: skip
    assert noise_scores(0, []).names == {}
    shaken = [CleanedSignal("a", False, (), 0.5, None), *signals]
    assert [s.value for s in noise_scores(10, shaken).scores[:2]] == [0.5, 0.03]
    turned = [CleanedSignal("a", True, (), 0.5, None), *signals]
    assert [s.value for s in noise_scores(10, turned).scores[:2]] == [0.002, 0.5]
    long: Any = SimpleNamespace(clock=SimpleNamespace(count=100, rate=30))
    (note,) = cleaning_notices(long, signals, CleanOptions())
    assert note.code == "CAP101"
    assert note.message.startswith("3 frames of spikes replaced (a); 2 of 3 signals")
    assert cleaning_notices(long, [], CleanOptions()) == []
    short: Any = SimpleNamespace(clock=SimpleNamespace(count=2, rate=30))
    assert [n.code for n in cleaning_notices(short, [], CleanOptions())] == ["CAP102"]
    assert cleaning_notices(short, [], CleanOptions(keep_noise=True)) == []
    assert cleaning_notices(short, [], CleanOptions(cutoff=3.0)) == []
    _check_spikes(0)
    _check_cutoff(None)
    _check_cutoff(1e-9)
    for check, wrong in (
        (_check_spikes, -1),
        (_check_spikes, 99),
        (_check_cutoff, 0.0),
        (_check_cutoff, np.inf),
    ):
        with pytest.raises(OptionError):
            check(wrong)


POINTS = np.random.default_rng(5).uniform(-0.1, 0.1, (6, 3))


def face(names: str = "abcdef", shapes: int = 3) -> FaceModel:
    deltas = np.zeros((shapes, 6, 3))
    deltas[0, 0, 0] = deltas[1, 0, 0] = 0.05
    deltas[2, 1, 1] = 0.05
    return FaceModel(tuple(names), tuple("XYZ"[:shapes]), POINTS, deltas)


def test_landmarks_go_by_their_names_or_their_number() -> None:
    own = face()
    rows = np.arange(2.0 * 6 * 3).reshape(2, 6, 3)
    plain = FaceCapture(Path("a"), None, CLOCK, rows)
    assert order_landmarks(plain, own) == (rows, [])
    assert not plain.is_in_pixels
    assert replace(plain, points=rows[..., :2]).is_in_pixels
    named = replace(plain, names=tuple("fexdcb"))
    made, told = order_landmarks(named, own)
    assert_array_equal(made[:, 5], rows[:, 0])
    assert_array_equal(made[:, 1], rows[:, 5])
    assert np.isnan(made[:, 0]).all()
    assert [t.code for t in told] == ["FAC107", "FAC107"]
    assert told[0].message.startswith(
        "1 landmarks of the face are not in the capture: "
    )
    assert order_landmarks(replace(plain, names=own.names), own) == (rows, [])
    for wrong in (
        replace(plain, points=rows[:, :5]),
        replace(plain, names=tuple("uvwxyz")),
    ):
        with pytest.raises(OptionError) as error:
            order_landmarks(wrong, own)
        assert error.value.code == "FAC004"


def test_faces_of_other_sizes_and_numbers_are_refused() -> None:
    own = face()
    seen = np.stack([POINTS] * 3)
    for observed, camera, code in (
        (2.99 * seen, None, None), (3.01 * seen, None, "FAC006"),
        (seen / 2.99, None, None), (seen / 3.01, None, "FAC006"),
        (100 * seen[..., :2], np.ones(4), None), (seen[:, :5], None, "FAC004"),
        (seen[:0], None, "FAC004"), (seen[0], None, "FAC004"),
        (seen, np.ones(4), "FAC004"),
    ):  # fmt: skip
        if code is None:
            _check_landmarks(own, observed, camera)
            continue
        with pytest.raises(OptionError) as error:
            _check_landmarks(own, observed, camera)
        assert error.value.code == code
    kept, share = _merge_shapes(own, own.shapes_with_motion())
    assert (kept.tolist(), share.tolist()) == ([True, False, True], [0, 0, 2])
    three = FaceModel(tuple("abc"), ("X",), POINTS[:3], np.ones((1, 3, 3)))
    with pytest.raises(OptionError):
        _check_landmarks(three, seen[:, :3], None)


def test_heads_between_frames_with_landmarks_are_between_their_poses() -> None:
    poses = np.zeros((6, 7))
    poses[:, :4] = so3.IDENTITY
    poses[1, :4] = -so3.exp(np.array([0.0, 0, 0.0]))
    poses[4, :4] = so3.exp(np.array([0.0, 0, 0.9]))
    poses[1, 4:], poses[4, 4:] = [1, 0, 0], [4, 3, 0]
    good = np.array([0, 1, 0, 0, 1, 0], bool)
    turns, shifts = interpolate_poses(poses, good)
    assert_allclose(shifts[:, 0], [1, 1, 2, 3, 4, 4])
    assert_allclose(shifts[:, 1], [0, 0, 1, 2, 3, 3])
    angles = 2 * np.arctan2(np.abs(turns[:, 2]), np.abs(turns[:, 3]))
    assert_allclose(angles, [0, 0, 0.3, 0.6, 0.9, 0.9], atol=1e-9)
    whole, ways = interpolate_poses(poses, np.ones(6, bool))
    assert_array_equal(ways, poses[:, 4:])
    assert (whole[1:] * whole[:-1]).sum(axis=1).min() > 0


def test_what_is_said_of_landmarks_that_do_not_fit() -> None:
    own, seen = face(), np.ones((10, 6), bool)
    usable, poor, shares = np.ones(10, bool), np.zeros(10, bool), np.ones((10, 6))
    assert _notices(own, seen, usable, poor, shares, None) == []
    usable[3], poor[[5, 6]] = False, True
    seen[:, 4] = False
    shares[:5, 0] = shares[:6, 1] = 0.49
    found = _notices(own, seen, usable, poor, shares, None)
    assert [f.code for f in found] == ["FAC103", "FAC104", "FAC105", "FAC105"]
    assert found[0].message.startswith("1 frame has fewer than 4 landmarks")
    assert found[1].message.startswith("2 frames")
    assert "1 landmark is never seen: e" in found[2].message
    assert "1 landmark does not match the face in most frames: b" in found[3].message


@pytest.mark.parametrize(
    ("keys", "unit", "scale"),
    [
        ("landmarks_mm", None, 1e-3), ("landmarks_cm", None, 1e-2),
        ("landmarks_m", None, 1.0), ("landmarks", None, 1e-3),
        ("landmarks_in", None, 0.0254), ("landmarks_cm", LengthUnit.M, 1.0),
    ],
)  # fmt: skip
def test_positions_are_in_the_unit_of_their_array(
    tmp_path: Path, keys: str, unit: Any, scale: float
) -> None:
    rows = np.arange(2.0 * 6 * 3).reshape(2, 6, 3)
    rows[1, 2, 0] = np.inf
    given = {
        keys: rows,
        "fs": 59.94,
        "neutral_cm": POINTS * 100,
        "delta_mm": np.ones((1, 6, 3)),
    }
    path = tmp_path / "a.npz"
    np.savez(path, shape_names=["X"], landmark_names=list("abcdef"), **given)
    found = read_capture(path, unit=unit)
    assert_allclose(found.points[0], rows[0] * scale)
    assert np.isnan(found.points[1, 2]).all()
    assert [n.code for n in found.notices] == ["FAC106"]
    assert (found.clock.count, found.clock.rate, found.up) == (
        2,
        Fraction(60000, 1001),
        UpAxis.Y,
    )
    assert found.names == tuple("abcdef")
    assert found.model is not None
    assert_allclose(found.model.neutral, POINTS if unit is None else POINTS * 100)
    assert_allclose(found.model.deltas, 1e-3 if unit is None else 1.0)
    again = read_capture(f"{path}#{keys}", fps=24, up=UpAxis.Z)
    assert (again.clock.rate, again.up) == (24, UpAxis.Z)


@pytest.mark.parametrize(
    "wrong",
    [
        {"uv": np.zeros((2, 3, 4))}, {"uv": np.zeros((2, 3, 0, 2))},
        {"xy": np.zeros((2, 3, 4, 2))},
        {"uv8": np.zeros((2, 3, 4, 2))}, {"uv": np.zeros((2, 3, 4, 2), int)},
        {"uv": np.full((2, 3, 4, 2), np.inf)}, {"fs": 0.09}, {"fs": 1.1e5},
        {"fs": [1.0, 2.0]},
        {"marker_names": ["a"]}, {"camera_names": ["a"]},
        {"confidence": np.zeros((2, 3, 3))},
        {"uv": np.zeros((1, 257, 1, 2))},
    ],
)  # fmt: skip
def test_arrays_that_are_no_observations(tmp_path: Path, wrong: Any) -> None:
    given = {"fs": 30.0} | wrong
    if not {"uv", "uv8", "xy"} & {*given}:
        given["uv"] = np.zeros((2, 3, 4, 2))
    np.savez(tmp_path / "a.npz", **given)
    with pytest.raises(FormatError) as error:
        read_observations(tmp_path / "a.npz")
    assert error.value.code == "CAM010"


def test_pixels_are_eighths_or_floats_and_cameras_by_name(tmp_path: Path) -> None:
    stored = np.full((2, 2, 3, 2), 80, np.uint16)
    stored[1, 0, 1, 0] = 65535
    np.savez(tmp_path / "a.npz", uv8=stored, fs=0.1, camera_names=["b", "a"])
    found = read_observations(tmp_path / "a.npz")
    assert found.names == ("*0", "*1", "*2")
    pixels = found.pixels(0, 2)
    assert (pixels[0] == 10).all()
    assert np.isnan(pixels[1, 0, 1]).all()
    assert found.pixels(0, 2, 2).shape == (1, 2, 3, 2)
    assert found.confidences_of(0, 2) is None
    assert found.clock.rate == Fraction(1, 10)
    sure = replace(found, confidences=np.arange(12.0).reshape(2, 2, 3))
    trust = sure.confidences_of(1, 2)
    assert trust is not None
    assert trust.ravel().tolist() == [6, 7, 8, 9, 10, 11]
    both = Cameras(tuple(replace(PLAIN, name=n) for n in "abc"))
    assert match_cameras(found, both).names == ("b", "a")
    for cameras, own, code in (
        (both, replace(found, cameras=()), "CAM011"),
        (both, replace(found, cameras=("a", "x")), "CAM011"),
        (
            replace(both, cameras=both.cameras[:1]),
            replace(found, cameras=("a",), stored=stored[:, :1]), "CAM012",
        ),
    ):  # fmt: skip
        with pytest.raises(OptionError) as error:
            match_cameras(own, cameras)
        assert error.value.code == code
    two = replace(both, cameras=both.cameras[:2])
    assert match_cameras(replace(found, cameras=()), two).names == ("a", "b")
    assert isinstance(found, Observations)


def test_markers_in_other_units_are_told_by_how_far_they_spread() -> None:
    rest = np.stack([POINTS])
    model: Any = SimpleNamespace(points=lambda _: rest, start_poses=lambda rows: rows)
    for times, refused in (
        (29.9, False),
        (30.1, True),
        (1 / 29.9, False),
        (1 / 30.1, True),
    ):
        sample = np.stack([times * POINTS + 5.0] * 2)
        sample[0, 0] = np.nan
        if not refused:
            check_units(model, sample)
            continue
        with pytest.raises(OptionError) as error:
            check_units(model, sample)
        assert error.value.code == "SOL005"
        assert ("larger" if times > 1 else "smaller") in error.value.faults[0].message
    markers = Markers(
        ("a",), replace(CLOCK, count=1), np.array([[[1.0, 2, 3]]]), UpAxis.Z
    )
    rig: Any = SimpleNamespace(up=UpAxis.Y)
    assert_allclose(positions_in_rig_axes(rig, markers), [[[1, 3, -2]]], atol=1e-12)
    rig.up = UpAxis.Z
    assert positions_in_rig_axes(rig, markers) is markers.positions
    assert issubclass(OptionError, AnimtoolError)
