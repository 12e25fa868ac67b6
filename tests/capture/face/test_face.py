"""Landmarks to weights: exact, robust, smooth, without the head; and what is wrong."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.faults import raises

from animtool.capture.face import FaceModel, fit_face, transfer_weights
from animtool.capture.face import solve as solving
from animtool.capture.face.capture import FaceCapture, order_landmarks, read_capture
from animtool.capture.face.file import face_model, load_landmarks
from animtool.capture.face.poses import interpolate_poses
from animtool.core.array_types import FloatArray
from animtool.core.errors import FormatError, OptionError
from animtool.maths.so3 import from_axis_angle, rotate
from animtool.rig.parts import Shape
from animtool.rig.remap import link_shapes, load_remap
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import SurfaceInbetween, SurfaceShape

ROOT = Path(__file__).parents[3]
FRAMES, LANDMARKS, SHAPES = 90, 40, 12


def made_face(seed: int = 0) -> FaceModel:
    rng = np.random.default_rng(seed)
    neutral = rng.normal(size=(LANDMARKS, 3)) * [0.06, 0.08, 0.03]
    deltas = rng.normal(size=(SHAPES, LANDMARKS, 3)) * 0.006
    names = tuple(f"m{i}" for i in range(LANDMARKS))
    return FaceModel(names, tuple(f"s{i}" for i in range(SHAPES)), neutral, deltas)


def made_weights(frames: int = FRAMES, shapes: int = SHAPES) -> FloatArray:
    t = np.arange(frames)[:, None] / 60
    phases = np.random.default_rng(5).uniform(0, 6, (2, shapes))
    wave = 0.4 + 0.7 * np.sin(2.5 * t * (1 + phases[0] / 6) + phases[1])
    return np.clip(wave, 0, 1)


def placed(points: FloatArray) -> FloatArray:
    t = np.arange(len(points))[:, None] / 60
    turns = from_axis_angle(np.array([0.36, 0.48, 0.8]), 0.6 * np.sin(3 * t[:, 0]) + 2)
    moved = rotate(turns[:, None], points) + (t * [0.1, 0, 0.05])[:, None]
    return np.asarray(moved + np.array([0.3, 1.6, -2]))


def test_exact_landmarks_give_exact_weights() -> None:
    model, weights = made_face(), made_weights()
    fit = fit_face(model, placed(model.points(weights)), 60)
    assert np.abs(fit.weights - weights).max() < 1e-3
    assert fit.rms < 1e-5
    assert set(fit.status) == {"solved"}
    at = rotate(fit.rotations[:, None], model.points(fit.weights))
    at = at + fit.translations[:, None]
    assert np.abs(at - placed(model.points(weights))).max() < 1e-4


def spoiled(points: FloatArray, noise: float = 2e-4) -> FloatArray:
    rng = np.random.default_rng(2)
    seen = points + rng.normal(0, noise, points.shape)
    off = rng.random(points.shape[:2]) < 0.01
    seen[off] += rng.normal(0, 0.01, (int(off.sum()), 3))
    seen[rng.random(points.shape[:2]) < 0.02] = np.nan
    return np.asarray(seen)


def test_noise_outliers_and_gaps() -> None:
    model, weights = made_face(), made_weights()
    seen = spoiled(placed(model.points(weights)))
    seen[30:33] = np.nan
    fit = fit_face(model, seen, 60)
    assert fit.noise == pytest.approx(2e-4, rel=0.1)
    off = fit.weights - weights
    assert np.sqrt((off**2).mean()) < 0.01
    assert np.abs(off).max() < 0.1
    assert [i for i, s in enumerate(fit.status) if s == "gap"] == [30, 31, 32]
    assert [notice.code for notice in fit.notices] == ["FAC103"]
    # Of noise alone, smoothing takes some away.
    rough = fit_face(model, seen, 60, smooth=0.0)
    jumps = [np.abs(np.diff(f.weights, 2, axis=0)).mean() for f in (fit, rough)]
    assert jumps[0] < jumps[1]


def test_the_same_bytes_whatever_is_read_at_a_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model = made_face()
    seen = spoiled(placed(model.points(made_weights(150))))
    whole = fit_face(model, seen, 60)
    again = fit_face(model, seen.copy(), 60)
    assert_array_equal(again.weights, whole.weights)
    # Where a window ends does not show: a change is felt for less than the overlap.
    monkeypatch.setattr(solving, "WINDOW_FRAMES", 40)
    cut = fit_face(model, seen, 60)
    assert np.abs(cut.weights - whole.weights).max() < 1e-3


def test_one_camera_that_goes_with_the_head() -> None:
    model, weights = made_face(), made_weights(30)
    camera = np.array([900.0, 880.0, 640.0, 360.0])
    half = np.array([1.0, 0, 0, 0])
    seen = rotate(half, model.points(weights)) + np.array([0.01, 0.02, 0.35])
    pixels = seen[..., :2] / seen[..., 2:] * camera[:2] + camera[2:]
    fit = fit_face(model, pixels, 60, camera=camera)
    assert np.abs(fit.weights - weights).max() < 0.02
    assert fit.rms < 0.05
    with raises(OptionError, "FAC010"):
        fit_face(model, np.full_like(pixels, 5.0), 60, camera=camera)


def test_shapes_that_show_little() -> None:
    model = made_face()
    deltas = model.deltas.copy()
    deltas[3] = 0
    deltas[5] = deltas[4]
    model = replace(model, deltas=deltas)
    weights = made_weights()
    fit = fit_face(model, placed(model.points(weights)), 60)
    assert [n.code for n in fit.notices] == ["FAC101", "FAC102"]
    assert not fit.weights[:, 3].any()
    assert_allclose(fit.weights[:, 4], fit.weights[:, 5], atol=2e-3)


def test_landmarks_that_do_not_fit() -> None:
    model, seen = made_face(), made_face().neutral[None].repeat(20, 0)
    for wrong, code in (
        (seen[:, :-1], "FAC004"),
        (np.full_like(seen, np.nan), "FAC005"),
        (seen * 1000, "FAC006"),
        (seen / 1000, "FAC006"),
    ):
        with raises(OptionError, code):
            fit_face(model, wrong, 60)
    with raises(OptionError, "FAC006", match="as with mm that are read as cm"):
        fit_face(model, seen * 10.3, 60)
    still = replace(model, deltas=model.deltas * 0)
    with raises(OptionError, "FAC007"):
        fit_face(still, seen, 60)
    one = FaceModel(("a",), ("s",), np.zeros((1, 3)), np.ones((1, 1, 3)))
    with raises(OptionError, "FAC004"):
        fit_face(one, np.zeros((5, 1, 3)), 60)
    with raises(OptionError, "FAC003"):
        replace(model, neutral=model.neutral[:4])
    with raises(OptionError, "FAC003"):
        replace(model, deltas=model.deltas * np.nan)
    # A landmark somewhere else counts for little, and is named.
    astray = placed(model.points(made_weights()))
    astray[:, 7] += 0.05
    fit = fit_face(model, astray, 60)
    assert [n.code for n in fit.notices] == ["FAC105"]
    assert "m7" in fit.notices[0].message
    assert fit.notices[0].hint is None
    # Two in each other's place are named as a pair.
    swapped = placed(model.points(made_weights()))
    swapped[:, [3, 11]] = swapped[:, [11, 3]]
    assert [n.hint for n in fit_face(model, swapped, 60).notices] == [
        "exchange 'm3' and 'm11'"
    ]
    # Frames of other things are named too.
    astray[50] = np.random.default_rng(1).normal(0, 0.08, (LANDMARKS, 3))
    codes = {n.code for n in fit_face(model, astray, 60).notices}
    assert "FAC104" in codes


def test_the_proportions_of_an_actor() -> None:
    model, weights = made_face(), made_weights()
    weights[0] = 0
    rng = np.random.default_rng(8)
    actor = replace(
        model,
        neutral=model.neutral * 1.1 + rng.normal(0, 0.002, model.neutral.shape),
        deltas=model.deltas * 1.1,
    )
    seen = placed(actor.points(weights))
    off = [
        np.abs(fit_face(m, seen, 60).weights - weights).max()
        for m in (model, model.with_proportions(seen[0]))
    ]
    assert off[1] < 0.02 < off[0]


def test_files_of_landmarks(tmp_path: Path) -> None:
    path = tmp_path / "take.npz"

    def saved(**arrays: object) -> Path:
        np.savez(path, **arrays)  # type: ignore[arg-type]
        return path

    points = np.zeros((5, 4, 3))
    points[0, 0] = np.inf
    capture = read_capture(saved(landmarks_mm=points + 1, fs=30))
    assert (capture.clock.rate, capture.names, capture.model) == (30, None, None)
    assert np.isnan(capture.points[0, 0]).all()
    assert capture.points[1, 1].tolist() == [0.001] * 3
    assert [n.code for n in capture.notices] == ["FAC106"]
    for fs, rate in (
        (59.94, Fraction(60000, 1001)),
        (30000 / 1001, Fraction(30000, 1001)),
        (23.976, Fraction(24000, 1001)),
        (12.5, Fraction(25, 2)),
    ):
        clock = read_capture(saved(landmarks_mm=points + 1, fs=fs)).clock
        assert (clock.rate, clock.start, clock.step) == (rate, 1, 1)
    for arrays in (
        {"fs": 30},
        {"landmarks_mm": points},
        {"landmarks_mm": points, "fs": 0},
        {"landmarks_mm": points, "fs": np.nan},
        {"landmarks_mm": points, "fs": 1e-4},
        {"landmarks_mm": points, "fs": 2e5},
        {"landmarks_mm": points[0], "fs": 30},
        {"landmarks_px": points, "fs": 30},
        {"landmarks_mm": points, "fs": 30, "landmark_names": np.array(["a", "b"])},
        {
            **{"landmarks_mm": points, "fs": 30, "neutral_mm": np.zeros((3, 3))},
            **{"delta_mm": np.zeros((2, 4, 3)), "shape_names": np.array(["a", "b"])},
        },
    ):
        with raises(FormatError, "FAC003"):
            read_capture(saved(**arrays))
    path.write_bytes(b"no archive")
    with raises(FormatError, "FAC003"):
        read_capture(path)


def test_landmarks_are_found_by_name() -> None:
    model = made_face()
    clock = read_clock()
    names = (*reversed(model.names[1:]), "spare")
    points = np.arange(LANDMARKS * 3.0).reshape(1, LANDMARKS, 3)
    found, notices = order_landmarks(
        FaceCapture(Path("x"), names, clock, points), model
    )
    assert np.isnan(found[0, 0]).all()
    assert found[0, 1].tolist() == points[0, LANDMARKS - 2].tolist()
    assert [n.code for n in notices] == ["FAC107", "FAC107"]
    with raises(OptionError, "FAC004"):
        order_landmarks(FaceCapture(Path("x"), ("q",), clock, points[:, :1]), model)
    with raises(OptionError, "FAC004"):
        order_landmarks(FaceCapture(Path("x"), None, clock, points[:, :3]), model)


def read_clock():  # type: ignore[no-untyped-def]
    from fractions import Fraction

    from animtool.core.clock import Clock

    return Clock(Fraction(60), Fraction(1), Fraction(1), 1)


@pytest.mark.parametrize(
    "points",
    [
        "[{name: a, vertex: 1}, {name: a, vertex: 2}]",
        "[{name: a}]",
        "[{name: a, vertex: 1, vertices: [1, 2]}]",
        "[{name: a, vertices: [1, 2], weights: [1]}]",
        "[{name: a, vertices: [1, 2], weights: [1, 1]}]",
        "[{name: a, vertex: 99999999}]",
        "[{name: a, vertex: 1, mesh: nose}]",
    ],
)
def test_landmarks_files_that_do_not_fit(tmp_path: Path, points: str) -> None:
    path = tmp_path / "x.landmarks.yaml"
    path.write_text(f"landmarks: animtool/1\npoints: {points}\n", "utf-8")
    rig = Rig.load(ROOT / "rigs/head/head.rig.yaml")
    with raises(FormatError, "FAC008"):
        face_model(load_landmarks(path), rig)


def test_an_unknown_mesh_is_reported_once(tmp_path: Path) -> None:
    path = tmp_path / "x.landmarks.yaml"
    points = "[{name: a, vertex: 1}, {name: b, vertex: 2}]"
    path.write_text(f"landmarks: animtool/1\nmesh: nose\npoints: {points}\n", "utf-8")
    rig = Rig.load(ROOT / "rigs/head/head.rig.yaml")
    with raises(FormatError, "FAC008") as caught:
        face_model(load_landmarks(path), rig)
    assert len(caught.value.faults) == 1


def test_landmarks_of_a_mesh_go_where_its_shapes_take_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At a vertex, between two by weights and evenly, and on a mesh without shapes.

    One shape has a bend at 0.25, one follows the product of both.
    """
    rng = np.random.default_rng(3)
    points, smile, both = rng.normal(size=(3, 4, 3))
    wide, quarter = rng.normal(size=(2, 2, 3))
    shapes = [
        SurfaceShape("smile", smile),
        SurfaceShape(
            "open", wide, np.array([1, 3]),
            inbetweens=(SurfaceInbetween(0.25, quarter, None),),
        ),
        SurfaceShape("both", both),
    ]  # fmt: skip
    surfaces = [
        SimpleNamespace(name="face", points=points, shapes=tuple(shapes)),
        SimpleNamespace(name="teeth", points=points + 9, shapes=()),
    ]
    monkeypatch.setattr("animtool.capture.face.file.surfaces_of", lambda _: surfaces)
    rig = Rig(
        "head",
        (),
        shapes=(
            Shape("smile", "face"),
            Shape("gone", "no mesh"),
            Shape("both", "face", combine=("smile", "open")),
            Shape("open", "face"),
        ),
    )
    path = tmp_path / "x.landmarks.yaml"
    landmarks = (
        "[{name: a, vertex: 1}, {name: b, vertices: [0, 3], weights: [0.25, 0.75]}, "
        "{name: c, vertices: [1, 2]}, {name: d, vertex: 2, mesh: teeth}]"
    )
    path.write_text(f"landmarks: animtool/1\npoints: {landmarks}\n", "utf-8")
    model = face_model(load_landmarks(path), rig)
    assert (model.names, model.shapes) == (("a", "b", "c", "d"), ("smile", "open"))

    def seen(values: FloatArray) -> FloatArray:
        a, b, c = values[1], values[0] / 4 + values[3] * 0.75, values[1:3].mean(axis=0)
        return np.array([a, b, c, np.zeros(3)])

    def whole(values: FloatArray) -> FloatArray:
        made = np.zeros((4, 3))
        made[[1, 3]] = values
        return made

    neutral = seen(points)
    neutral[3] = points[2] + 9
    assert_allclose(model.neutral, neutral)
    assert_allclose(model.deltas, [seen(smile), seen(whole(wide))])
    weights = np.array([[0.5, 1.0], [0.8, 0.125], [0.0, 0.625]])
    opened = [wide, quarter / 2, (quarter + wide) / 2]
    wanted = [
        neutral + w * seen(smile) + seen(whole(o)) + w * k * seen(both)
        for (w, k), o in zip(weights.tolist(), opened, strict=True)
    ]
    assert_allclose(model.points(weights), wanted)
    flat = model.neutral + np.tensordot(weights, model.deltas, 1)
    assert_allclose(
        model.nonlinear_offsets(weights), np.array(wanted) - flat, atol=1e-12
    )
    alone = model.select(np.array([False, True]))
    assert_allclose(alone.points(weights[:, 1:]), model.points(weights * [0, 1]))
    surfaces[1].shapes = (SurfaceShape("grin", smile),)
    with raises(FormatError, *["FAC008"] * 3):
        face_model(load_landmarks(path), rig)


def test_remap_files(tmp_path: Path) -> None:
    path = tmp_path / "x.remap.yaml"

    def written(shapes: str) -> Path:
        path.write_text(f"remap: animtool/1\nshapes: {shapes}\n", "utf-8")
        return path

    links = link_shapes(
        ["Smile_L", "brow", "JawOpen"],
        ["mouthSmileLeft", "jaw_open"],
        load_remap(written("[{source: Smile_L, target: mouthSmile_L, gain: 0.5}]")),
    )
    assert [(k.source, k.target, k.gain) for k in links.links] == [
        (0, 0, 0.5),
        (2, 1, 1.0),
    ]
    assert links.unlinked == ("brow",)
    with raises(FormatError, "FAC001"):
        link_shapes(["a"], ["b"], load_remap(written("[{source: a, target: c}]")))
    for wrong in (
        "[{source: a, target: b}, {source: a, target: b}]",
        "[{source: a, target: b, clamp: [1, 0]}]",
    ):
        with raises(FormatError, "FAC002"):
            load_remap(written(wrong))


def test_weights_from_one_face_to_another() -> None:
    source = made_face()
    # The same face twice as large, its shapes mixed: the motion is the same.
    mixed = np.eye(SHAPES)
    mixed[0, 1] = 0.5
    deltas = 2 * np.tensordot(mixed, source.deltas, 1)
    target = replace(
        source,
        shapes=tuple(f"t{i}" for i in range(SHAPES)),
        neutral=source.neutral * 2,
        deltas=deltas,
    )
    weights = made_weights() * 0.5
    made = transfer_weights(
        weights, source.shapes, target.shapes, faces=(source, target)
    )
    moved = target.points(made.weights) - 2 * source.points(weights)
    assert np.sqrt((moved**2).mean()) < 0.002
    assert made.fit is not None
    assert_array_equal(made.weights, made.fit.weights)
    assert made.links.links == ()
    assert set(made.links.unlinked) == set(source.shapes)
    with raises(OptionError, "FAC009"):
        transfer_weights(weights, source.shapes, target.shapes)
    named = transfer_weights(weights[:, :2], ["JawOpen", "q"], ["jaw_open"])
    assert_array_equal(named.weights[:, 0], weights[:, 0])
    assert [n.code for n in named.notices] == ["FAC108"]
    still = transfer_weights(weights[:, :2] * [1, 0], ["JawOpen", "q"], ["jaw_open"])
    assert still.notices == ()
    with pytest.raises(ValueError, match="zip"):
        transfer_weights(weights[:, :3], ["JawOpen", "q"], ["jaw_open"])


def test_landmarks_that_count_little_say_nothing_of_the_fit() -> None:
    model, weights = made_face(), made_weights(6)
    fit = fit_face(model, placed(model.points(weights)), 60)
    assert replace(fit, shares=np.zeros_like(fit.shares)).rms == 0


def test_a_head_stays_where_it_is_before_and_behind_what_is_seen() -> None:
    """Within a gap it goes evenly from one pose to the other, by 30 degrees a frame."""
    usable = np.array([0, 0, 1, 0, 0, 1, 1, 0, 0], np.bool_)
    angles = np.array([7.0, 7, 10, 7, 7, 100, 110, 7, 7])
    poses = np.zeros((9, 7))
    poses[:, :4] = from_axis_angle(np.array([0.0, 1.0, 0.0]), np.radians(angles))
    poses[:, 4] = [9, 9, 1, 9, 9, 2.5, 2.75, 9, 9]
    turns, shifts = interpolate_poses(poses, usable)
    assert_allclose(shifts[:, 0], [1, 1, 1, 1.5, 2, 2.5, 2.75, 2.75, 2.75])
    expected = np.array([10.0, 10, 10, 40, 70, 100, 110, 110, 110])
    assert_allclose(np.degrees(2 * np.arctan2(turns[:, 1], turns[:, 3])), expected)


def test_every_frame_is_that_of_one_window_with_frames_on_either_side(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Windows of 40 frames, and 32 more before and behind that the take has."""
    model, spans = made_face(), []

    def window(_: object, frames: slice) -> tuple[FloatArray | int | float, ...]:
        spans.append((frames.start, frames.stop))
        numbers = np.arange(frames.start, frames.stop, dtype=float)[:, None]
        blank = np.ones((1, LANDMARKS))
        poses = numbers * np.array([0, 0, 0, 0, 1.0, 1, 1])
        poses[:, 3] = 1.0
        weights = numbers * np.ones((1, SHAPES))
        return weights, poses, numbers * blank, numbers * blank, 3, 0.1

    monkeypatch.setattr(solving, "WINDOW_FRAMES", 40)
    monkeypatch.setattr(solving._FaceSolver, "_solve_window", window)
    fit = fit_face(model, placed(model.points(made_weights(90))), 60)
    assert spans == [(0, 72), (8, 90), (48, 90)]
    for found in (fit.weights, fit.translations, fit.residuals, fit.shares):
        assert_array_equal(found[:, 0], np.arange(90.0))
