from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.clips import RIG, hero, loaded, write_clip, write_rig

from animtool.clip.file import load_clip, open_clip
from animtool.clip.sample import SampledMotion, sample_channels
from animtool.core.array_types import FloatArray
from animtool.core.errors import FormatError, Severity
from animtool.maths import so3
from animtool.rig.file import load_rig
from animtool.rig.parts import Shape
from animtool.rig.skeleton import Rig

FRAMES = np.arange(0.0, 5.0)
X, Y, Z = np.eye(3)


def sampled(
    folder: Path, channels: str, times: object = FRAMES, *, clamp: bool = False
) -> tuple[SampledMotion, Rig]:
    clip, rig = loaded(folder, channels)
    return sample_channels(
        clip.channels, rig, np.asarray(times, np.float64), clamp=clamp
    ), rig


def locals_of(
    made: SampledMotion, rig: Rig, name: str
) -> tuple[FloatArray, FloatArray]:
    """Return a joint's local translations ``(F, 3)`` and rotations ``(F, 4)``."""
    translations, rotations, _ = made.motion.dense()
    j = rig.index(name)
    return translations[:, j], rotations[:, j]


def assert_turns(found: FloatArray, expected: FloatArray) -> None:
    # The angle between two rotations is known to the root of the rounding.
    signs = np.sign(np.sum(found * expected, axis=-1, keepdims=True))
    whole = np.broadcast_to(expected, found.shape) * signs
    np.testing.assert_allclose(found, whole, rtol=0, atol=1e-12)


def ramp(target: str, first: object, last: object, more: str = "") -> str:
    return (
        f"- {{target: {target}, interp: linear, {more} "
        f"keys: [{{t: 0, v: {first}}}, {{t: 4, v: {last}}}]}}\n"
    )


def test_a_pin_turns_about_its_axis_in_the_rest_frame(tmp_path: Path) -> None:
    made, rig = sampled(tmp_path, ramp("joint/elbow_l.angle", 0, 80))
    translations, rotations = locals_of(made, rig, "elbow_l")
    np.testing.assert_allclose(translations, [[0.28, 0, 0]] * 5)
    rest = np.array([0, 0, 0.8, 0.6])
    turn = so3.from_axis_angle(Z, np.radians(20 * FRAMES))
    assert_turns(rotations, so3.multiply(rest, turn))


def test_a_slide_goes_along_its_axis_in_the_rest_frame(tmp_path: Path) -> None:
    made, rig = sampled(tmp_path, ramp("joint/piston.slide", 0, 4))
    translations, _ = locals_of(made, rig, "piston")
    # Rest (w .6, x .8) takes y to (0, -.28, .96).
    expected = [0.05, 0, 0] + 0.01 * FRAMES[:, None] * [0, -0.28, 0.96]
    np.testing.assert_allclose(translations, expected, atol=1e-15)


def test_a_free_joint_moves_relative_to_rest(tmp_path: Path) -> None:
    text = ramp("joint/hips.translation", [0, 0, 0], [0, 4, 0])
    text += ramp("joint/hips.rotation", [0, 0, 0], [0, 0, 80], "euler: XYZ,")
    made, rig = sampled(tmp_path, text)
    translations, rotations = locals_of(made, rig, "hips")
    expected = [0.07, 0.95, -0.03] + 0.01 * FRAMES[:, None] * [0, -0.28, 0.96]
    np.testing.assert_allclose(translations, expected, atol=1e-15)
    rest = np.array([0.8, 0, 0, 0.6])
    turn = so3.from_axis_angle(Z, np.radians(20 * FRAMES))
    assert_turns(rotations, so3.multiply(rest, turn))


def test_a_ball_turns_relative_to_rest(tmp_path: Path) -> None:
    text = ramp("joint/shoulder_l.rotation", [1, 0, 0, 0], [0, 1, 0, 0])
    made, rig = sampled(tmp_path, text.replace("linear", "slerp"))
    _, rotations = locals_of(made, rig, "shoulder_l")
    turn = so3.from_axis_angle(X, np.pi / 4 * FRAMES)
    assert_turns(rotations, so3.multiply([0, 0.6, 0, 0.8], turn))


def test_local_parts_take_the_place_of_rest(tmp_path: Path) -> None:
    text = ramp("joint/wrist_l.local_translation", [1, 2, 3], [5, 2, 3])
    text += ramp("joint/wrist_l.local_rotation", [0, 0, 0], [80, 0, 0], "euler: XYZ,")
    made, rig = sampled(tmp_path, text)
    translations, rotations = locals_of(made, rig, "wrist_l")
    expected = np.array([0.01, 0.02, 0.03]) + 0.01 * FRAMES[:, None] * X
    np.testing.assert_allclose(translations, expected)
    assert_turns(rotations, so3.from_axis_angle(X, np.radians(20 * FRAMES)))


def test_scale(tmp_path: Path) -> None:
    text = ramp("joint/chest.scale", 1, 3)
    text += "- {target: joint/hips.scale, keys: [{t: 0, v: [1, 2, 3]}]}\n"
    made, rig = sampled(tmp_path, text)
    assert made.motion.scales is not None
    found = made.motion.scales.dense()
    np.testing.assert_allclose(
        found[:, rig.index("chest")], 1 + FRAMES[:, None] / 2 * [1, 1, 1]
    )
    assert made.motion.scales.animated.tolist() == [rig.index("chest")]
    assert (found[:, rig.index("hips")] == [1, 2, 3]).all()
    unscaled, _ = sampled(tmp_path, ramp("joint/elbow_l.angle", 0, 8))
    assert unscaled.motion.scales is None


def test_a_mimic_follows(tmp_path: Path) -> None:
    text = ramp("joint/elbow_l.angle", 0, 40) + ramp("control/curl", 0, 0.4)
    made, rig = sampled(tmp_path, text)
    translations, _ = locals_of(made, rig, "rod")
    # One centimetre, and a tenth of one a degree: 10 + 9 degrees a frame.
    expected = 0.01 * (1 + 0.1 * 19 * FRAMES)
    np.testing.assert_allclose(translations[:, 0], expected, atol=1e-15)


def test_a_mimic_follows_a_leader_that_is_clamped(tmp_path: Path) -> None:
    made, rig = sampled(tmp_path, ramp("joint/elbow_l.angle", 0, 200), clamp=True)
    translations, _ = locals_of(made, rig, "rod")
    expected = 0.01 * (1 + 0.1 * np.minimum(50 * FRAMES, 150))
    np.testing.assert_allclose(translations[:, 0], expected, atol=1e-15)


def test_keys_take_the_place_of_a_mimic(tmp_path: Path) -> None:
    text = ramp("joint/elbow_l.angle", 0, 40) + ramp("joint/rod.slide", 0, 8)
    made, rig = sampled(tmp_path, text)
    translations, _ = locals_of(made, rig, "rod")
    np.testing.assert_allclose(translations[:, 0], 0.02 * FRAMES, atol=1e-15)
    (note,) = made.notices
    assert (note.code, note.severity) == ("CLIP103", Severity.NOTE)


@pytest.mark.parametrize("moving", [True, False])
def test_local_keys_take_the_place_of_what_controls_add(
    tmp_path: Path, *, moving: bool
) -> None:
    text = ramp("control/lean", 1, 2 if moving else 1)
    text += ramp(
        "joint/shoulder_r.local_rotation", [0, 0, 0], [0, 80, 0], "euler: XYZ,"
    )
    made, rig = sampled(tmp_path, text)
    _, rotations = locals_of(made, rig, "shoulder_r")
    assert_turns(rotations, so3.from_axis_angle(Y, np.radians(20 * FRAMES)))
    codes = [note.code for note in made.notices if note.severity is Severity.NOTE]
    assert codes == ["CLIP105"] * moving


def test_local_keys_take_the_place_of_a_mimic(tmp_path: Path) -> None:
    text = ramp("joint/elbow_l.angle", 0, 40)
    text += ramp("joint/rod.local_translation", [0, 0, 0], [8, 0, 0])
    made, rig = sampled(tmp_path, text)
    translations, _ = locals_of(made, rig, "rod")
    np.testing.assert_allclose(translations[:, 0], 0.02 * FRAMES, atol=1e-15)
    (note,) = made.notices
    assert (note.code, note.severity) == ("CLIP103", Severity.NOTE)


def test_controls_add_to_each_other_and_to_a_channel(tmp_path: Path) -> None:
    text = ramp("control/lean", 0, 1) + ramp("control/sway", 0, -2)
    made, rig = sampled(tmp_path, text)
    _, rotations = locals_of(made, rig, "shoulder_r")
    assert_turns(rotations, so3.from_axis_angle(X, np.radians(2.5 * FRAMES)))
    text += ramp("joint/shoulder_r.rotation", [0, 90, 0], [0, 90, 0], "euler: XYZ,")
    made, rig = sampled(tmp_path, text)
    _, rotations = locals_of(made, rig, "shoulder_r")
    driven = so3.from_axis_angle(X, np.radians(2.5 * FRAMES))
    keyed = so3.from_axis_angle(Y, np.pi / 2)
    assert_turns(rotations, so3.multiply(driven, keyed))


def test_control_values_are_kept(tmp_path: Path) -> None:
    made, rig = sampled(tmp_path, ramp("control/curl", 0, 1))
    controls = made.motion.controls
    assert controls is not None
    names = [control.name for control in rig.controls]
    assert controls.animated.tolist() == [names.index("curl")]
    assert controls.rest[names.index("grin"), 0] == 0.25
    np.testing.assert_allclose(controls.values[:, 0, 0], FRAMES / 4)
    without, _ = sampled(tmp_path, ramp("joint/elbow_l.angle", 0, 8))
    assert without.motion.controls is None


def test_only_what_moves_is_animated(tmp_path: Path) -> None:
    text = ramp("joint/elbow_l.angle", 0, 80)
    made, rig = sampled(tmp_path, text)
    assert made.motion.rotations.animated.tolist() == [rig.index("elbow_l")]
    assert made.motion.translations.animated.tolist() == [rig.index("rod")]
    others = [j for j, name in enumerate(rig.names) if name != "elbow_l"]
    np.testing.assert_array_equal(
        made.motion.rotations.rest[others], rig.rest_rotations[others]
    )


def test_a_static_channel_is_stored_once(tmp_path: Path) -> None:
    made, rig = sampled(tmp_path, ramp("joint/elbow_l.angle", 30, 30))
    motion = made.motion
    assert (motion.frames, len(motion.rotations.animated)) == (5, 0)
    rest = motion.rotations.rest[rig.index("elbow_l")]
    turn = so3.from_axis_angle(Z, np.radians(30))
    assert_turns(rest[None], so3.multiply([0, 0, 0.8, 0.6], turn)[None])


def test_equal_keys_with_handles_move(tmp_path: Path) -> None:
    keys = "{t: 0, v: 0, out: [1, 30]}, {t: 4, v: 0, in: [-1, 30]}"
    text = f"- {{target: joint/elbow_l.angle, keys: [{keys}]}}\n"
    made, rig = sampled(tmp_path, text)
    assert made.motion.rotations.animated.tolist() == [rig.index("elbow_l")]


def test_weights_and_combined_shapes(tmp_path: Path) -> None:
    rig = load_rig(write_rig(tmp_path))
    both = Shape("both", combine=("smile", "jaw"))
    rig = replace(rig, shapes=(both, Shape("smile"), Shape("jaw"), Shape("brow")))
    text = ramp("shape/smile", 0, 1) + ramp("shape/jaw", 0.5, 0.5)
    clip = load_clip(open_clip(write_clip(tmp_path, text)), rig)
    weights = sample_channels(clip.channels, rig, FRAMES).motion.weights
    assert weights is not None
    assert weights.animated.tolist() == [0, 1]
    found = weights.dense()[..., 0]
    half = np.full(5, 0.5)
    np.testing.assert_allclose(
        found.T, [FRAMES / 8, FRAMES / 4, half, np.zeros(5)], atol=1e-15
    )
    none = load_clip(
        open_clip(write_clip(tmp_path, ramp("joint/elbow_l.angle", 0, 8))), rig
    )
    assert sample_channels(none.channels, rig, FRAMES).motion.weights is None


@pytest.mark.parametrize(
    ("target", "last", "code", "words"),
    [
        ("control/curl", 2, "CLIP101", "is 2 at frame 4, outside 0 to 1"),
        ("joint/elbow_l.angle", 170, "CLIP102", "20° at frame 4"),
        ("joint/elbow_l.angle", -12, "CLIP102", "2° at frame 4"),
        ("joint/piston.slide", 12, "CLIP102", "0.02 m at frame 4"),
    ],
)
def test_what_leaves_its_range_is_said(
    tmp_path: Path, target: str, last: float, code: str, words: str
) -> None:
    made, _ = sampled(tmp_path, ramp(target, 0, last))
    note = next(n for n in made.notices if n.code == code)
    assert words in note.message
    assert "clamp=True" in (note.hint or "")
    made, _ = sampled(tmp_path, ramp(target, 0, last), clamp=True)
    assert all(n.hint is None for n in made.notices)


def test_a_ball_is_clamped_to_its_cone(tmp_path: Path) -> None:
    text = ramp("joint/chest.rotation", [0, 0, 0], [80, 0, 0], "euler: XYZ,")
    made, rig = sampled(tmp_path, text)
    (note,) = made.notices
    assert (note.code, "40° at frame 4" in note.message) == ("CLIP102", True)
    made, rig = sampled(tmp_path, text, clamp=True)
    _, rotations = locals_of(made, rig, "chest")
    turn = so3.from_axis_angle(X, np.radians(np.minimum(20 * FRAMES, 40)))
    assert_turns(rotations, turn)


def test_clamping(tmp_path: Path) -> None:
    made, rig = sampled(tmp_path, ramp("joint/elbow_l.angle", 0, 200), clamp=True)
    _, rotations = locals_of(made, rig, "elbow_l")
    turn = so3.from_axis_angle(Z, np.radians(np.minimum(50 * FRAMES, 150)))
    assert_turns(rotations, so3.multiply([0, 0, 0.8, 0.6], turn))
    made, _ = sampled(tmp_path, ramp("control/curl", 0, 2), clamp=True)
    assert made.motion.controls is not None
    values = made.motion.controls.values[:, 0, 0]
    np.testing.assert_allclose(values, np.minimum(FRAMES / 2, 1))


def test_a_control_driven_out_of_its_range_is_said_when_clamped(
    tmp_path: Path,
) -> None:
    drives = 'drives: [{control: curl, expr: "grin"}]}'
    text = RIG.replace("default: 0.25}", f"default: 0.25, {drives}")
    rig = load_rig(write_rig(tmp_path, text))
    keys = ramp("control/curl", 1, 1) + ramp("control/grin", 0, 1)
    clip = load_clip(open_clip(write_clip(tmp_path, keys)), rig)
    note = next(
        n
        for n in sample_channels(clip.channels, rig, FRAMES, clamp=True).notices
        if n.code == "CLIP101"
    )
    assert "would be 2 at frame 4" in note.message
    assert note.message.endswith("clamped")
    assert note.hint is None


def test_an_expression_without_a_value(tmp_path: Path) -> None:
    write_rig(tmp_path, RIG.replace("curl * 90", "1 / (curl - 0.5)"))
    rig = load_rig(tmp_path / "hero.rig.yaml")
    clip = load_clip(open_clip(write_clip(tmp_path, ramp("control/curl", 0, 1))), rig)
    with pytest.raises(FormatError) as caught:
        sample_channels(clip.channels, rig, FRAMES)
    assert caught.value.code == "CLIP015"
    assert "joint/elbow_l.angle has no value at frame 2" in str(caught.value)


def test_spins_of_many_turns_are_continuous(tmp_path: Path) -> None:
    times = np.linspace(0, 4, 401)
    text = ramp("joint/hips.rotation", [0, 0, 0], [0, 1440, 0], "euler: YXZ,")
    text = text.replace("[0, 1440, 0]", "[1440, 0, 0]")
    made, rig = sampled(tmp_path, text, times)
    _, rotations = locals_of(made, rig, "hips")
    turn = so3.from_axis_angle(Y, np.radians(360 * times))
    assert_turns(rotations, so3.multiply([0.8, 0, 0, 0.6], turn))
    assert (np.sum(rotations[1:] * rotations[:-1], axis=1) > 0.99).all()


def test_one_frame(tmp_path: Path) -> None:
    text = ramp("joint/elbow_l.angle", 0, 80) + ramp("control/curl", 0, 1)
    made, rig = sampled(tmp_path, text, [2.0])
    whole, _ = sampled(tmp_path, text)
    assert made.motion.frames == 1
    for name in ("elbow_l", "rod"):
        for one, many in zip(
            locals_of(made, rig, name), locals_of(whole, rig, name), strict=True
        ):
            np.testing.assert_allclose(one[0], many[2], atol=1e-15)


@pytest.mark.parametrize(
    ("mode", "early", "late"),
    [
        ("hold", 0, 8),
        ("linear", -2, 10),
        ("cycle", 6, 2),
        ("cycle_offset", -2, 10),
        ("oscillate", 2, 6),
    ],
)
def test_times_outside_the_keys(
    tmp_path: Path, mode: str, early: float, late: float
) -> None:
    text = ramp("joint/piston.slide", 0, 8, f"pre: {mode}, post: {mode},")
    text += ramp(
        "joint/hips.rotation", [1, 0, 0, 0], [0.6, 0, 0.8, 0], f"pre: {mode},"
    ).replace("interp: linear", f"interp: slerp, post: {mode}")
    made, rig = sampled(tmp_path, text, [-1, 2, 5])
    translations, _ = locals_of(made, rig, "piston")
    moved = np.linalg.norm(translations - [0.05, 0, 0], axis=1)
    np.testing.assert_allclose(moved, 0.01 * np.abs([early, 4, late]), atol=1e-15)
    _, rotations = locals_of(made, rig, "hips")
    whole = 2 * np.arccos(0.6)
    turn = so3.from_axis_angle(Y, whole / 8 * np.array([early, 4, late]))
    assert_turns(rotations, so3.multiply([0.8, 0, 0, 0.6], turn))


def test_times_in_any_order(tmp_path: Path) -> None:
    text = ramp("joint/elbow_l.angle", 0, 80) + ramp("control/lean", 0, 1)
    made, rig = sampled(tmp_path, text, FRAMES[::-1])
    ascending, _ = sampled(tmp_path, text)
    for name in ("elbow_l", "shoulder_r"):
        _, back = locals_of(made, rig, name)
        _, there = locals_of(ascending, rig, name)
        assert_turns(back[::-1], there)


def test_clamping_reaches_controls_that_others_drive(tmp_path: Path) -> None:
    drives = 'drives: [{control: curl, expr: "grin * 3"}]}'
    text = RIG.replace("default: 0.25}", f"default: 0.25, {drives}")
    rig = load_rig(write_rig(tmp_path, text))
    keys = ramp("control/grin", 0, 1)
    clip = load_clip(open_clip(write_clip(tmp_path, keys)), rig)
    made = sample_channels(clip.channels, rig, FRAMES, clamp=True)
    assert made.motion.controls is not None
    curl = made.motion.controls.dense()[:, 1, 0]
    np.testing.assert_allclose(curl, np.minimum(3 * FRAMES / 4, 1))
    _, rotations = locals_of(made, rig, "elbow_l")
    turn = so3.from_axis_angle(Z, np.radians(90 * np.minimum(3 * FRAMES / 4, 1)))
    assert_turns(rotations, so3.multiply([0, 0, 0.8, 0.6], turn))
    assert [note.message for note in made.notices] == [
        "control 'curl' would be 3 at frame 4, outside 0 to 1: clamped"
    ]


def test_clamping_says_what_it_did_to_keys(tmp_path: Path) -> None:
    made, _ = sampled(tmp_path, ramp("control/curl", 0, 2), clamp=True)
    assert [note.message for note in made.notices] == [
        "control 'curl' would be 2 at frame 4, outside 0 to 1: clamped"
    ]


@pytest.mark.parametrize("order", list(itertools.permutations(range(4))))
def test_shapes_of_combined_shapes_in_any_order(
    tmp_path: Path, order: tuple[int, ...]
) -> None:
    shapes = [
        Shape("a"),
        Shape("b"),
        Shape("ab", combine=("a", "b")),
        Shape("aab", combine=("a", "ab")),
    ]
    rig = replace(hero(tmp_path), shapes=tuple(shapes[i] for i in order))
    keys = ramp("shape/a", 0.5, 0.5) + ramp("shape/b", 0, 1)
    clip = load_clip(open_clip(write_clip(tmp_path, keys)), rig)
    weights = sample_channels(clip.channels, rig, FRAMES).motion.weights
    assert weights is not None
    found = weights.dense()[:, order.index(3), 0]
    np.testing.assert_allclose(found, 0.25 * np.clip(FRAMES / 4, 0, 1))


def test_a_control_out_of_range_names_the_frames_of_all_its_keys(
    tmp_path: Path,
) -> None:
    keys = ", ".join(f"{{t: {t}, v: {2 if t % 2 else 0.5}}}" for t in range(5))
    rig = load_rig(write_rig(tmp_path))
    text = f"- {{target: control/curl, keys: [{keys}]}}\n"
    clip = load_clip(open_clip(write_clip(tmp_path, text)), rig)
    for clamp in (False, True):
        notices = sample_channels(clip.channels, rig, FRAMES, clamp=clamp).notices
        (note,) = [one for one in notices if one.code == "CLIP101"]
        assert "2 keys are outside, at frames 1, 3" in note.message
        assert note.message.endswith("clamped") is clamp
    few = sample_channels(clip.channels, rig, FRAMES[:3]).notices
    assert [n.message.count("outside") for n in few if n.code == "CLIP101"] == [1]
