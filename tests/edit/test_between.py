"""Takes between their frames: curves of clips, whatever passes ran before."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.clips import hero, write_clip

from animtool.clip.clip import Clip
from animtool.clip.sample import sample_channels
from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.edit.between import TakeSampler
from animtool.edit.layers import blend, layer
from animtool.edit.looping import loop
from animtool.edit.resample import resampled
from animtool.edit.retiming import time_scale, time_warp, trim
from animtool.edit.travel import frame_positions
from animtool.maths import so3
from animtool.maths.curves import evaluate
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import PassContext, apply_pass, find_pass
from animtool.motion.take import Take
from animtool.rig.skeleton import Joint, Rig
from animtool.scene.sources.clips import open_clip_source

# As close as curves are promised to be; they come closer.
EXACT = 1e-9
PARTS = ("translations", "rotations", "scales", "weights", "controls")
CHANNELS = {
    "ease": "target: joint/hips.translation, keys: [{t: 1, v: [0, 0, 0], out: flat}, "
    "{t: 13, v: [100, 20, 5], in: flat}]",
    "steep": "target: joint/hips.translation, keys: [{t: 1, v: [0, 0, 0], "
    "out: [11.9, [0, 0, 0]]}, {t: 13, v: [100, 0, 0], in: [-11.9, [0, 0, 0]]}]",
    "pin": "target: joint/elbow_l.angle, keys: [{t: 1, v: 0}, {t: 4.3, v: 130}, "
    "{t: 13, v: 20}]",
    "slide": "target: joint/piston.slide, interp: hermite, keys: [{t: 1, v: 0, "
    "out: [1, 3]}, {t: 13, v: 9}]",
    "slerp": "target: joint/chest.rotation, interp: slerp, keys: [{t: 1, v: "
    "[1, 0, 0, 0]}, {t: 6.5, v: [0.8, 0.6, 0, 0]}, {t: 13, v: [1, 0, 0, 0]}]",
    "squad": "target: joint/shoulder_l.rotation, interp: squad, keys: [{t: 1, v: "
    "[1, 0, 0, 0]}, {t: 5, v: [0.6, 0.8, 0, 0]}, {t: 13, v: [0.6, 0, 0.8, 0]}]",
    "spline": "target: joint/shoulder_l.rotation, keys: [{t: 1, v: [1, 0, 0, 0]}, "
    "{t: 5, v: [0, 1, 0, 0]}, {t: 13, v: [0.6, 0, 0.8, 0]}]",
    "euler": "target: joint/shoulder_l.rotation, euler: ZXY, keys: [{t: 1, v: "
    "[0, 0, 0]}, {t: 13, v: [900, 40, -70]}]",
    "scale": "target: joint/hips.scale, keys: [{t: 1, v: 1}, {t: 13, v: 2}]",
    "control": "target: control/curl, keys: [{t: 1, v: 0}, {t: 7, v: 1}, "
    "{t: 13, v: 0}]",
    "step": "target: control/grin, interp: step, keys: [{t: 1, v: 0}, {t: 6.3, v: 1}]",
    "cycle": "target: joint/elbow_l.angle, pre: oscillate, post: cycle_offset, "
    "keys: [{t: 5, v: 0}, {t: 8, v: 30}]",
    "between": "target: joint/elbow_l.angle, keys: [{t: 4.1, v: 0}, {t: 4.5, v: 40}, "
    "{t: 4.9, v: 0}]",
    "one key": "target: joint/elbow_l.angle, keys: [{t: 5, v: 40}]",
    "local": "target: joint/chest.local_rotation, keys: [{t: 1, v: [1, 0, 0, 0]}, "
    "{t: 13, v: [0.6, 0.8, 0, 0]}]",
}


def keyed(folder: Path, *names: str, head: str = "fps: 24\nrange: [1, 13]") -> Clip:
    hero(folder)
    rows = "".join(f"- {{{CHANNELS[name]}}}\n" for name in names)
    return Clip.load(write_clip(folder, rows, head))


def sampled(folder: Path, *names: str, head: str = "fps: 24\nrange: [1, 13]") -> Take:
    return keyed(folder, *names, head=head).sample(hero(folder))


def assert_motion(
    found: Motion, expected: Motion, tolerance: float = EXACT, joints: object = ...
) -> None:
    for name in PARTS:
        one: Channel | None = getattr(found, name)
        other: Channel | None = getattr(expected, name)
        assert (one is None) == (other is None), name
        if one is None or other is None:
            continue
        a, b = one.dense(), other.dense()
        if name == "rotations":
            b = so3.align_to(b, a)
            assert (np.sum(a[1:] * a[:-1], axis=-1) > -1e-9).all()
        if name in {"translations", "rotations", "scales"} and joints is not ...:
            a, b = a[:, joints], b[:, joints]
        assert_allclose(a, b, atol=tolerance, rtol=0)


Retime = Callable[[Take], Take]
WARP = [(1, 1), (9, 12.5), (17, 2), (25, 2), (30, 13)]
RETIMES: dict[str, tuple[Retime, Callable[[FloatArray], FloatArray]]] = {
    "slow": (lambda take: time_scale(take, 0.1), lambda t: 1 + (t - 1) * 0.1),
    "fast": (lambda take: time_scale(take, 1.7), lambda t: 1 + (t - 1) * 1.7),
    "backwards": (
        lambda take: time_scale(take, -0.3, 13),
        lambda t: 13 - (t - 13) * 0.3,
    ),
    "warp": (
        lambda take: time_warp(take, WARP),
        lambda t: np.interp(t, *np.transpose(WARP)),
    ),
    "30": (lambda take: resampled(take, 30), lambda t: 1 + (t - 1) * 0.8),
    "25": (
        lambda take: resampled(take, 25, smooth=True),
        lambda t: 1 + (t - 1) * 24 / 25,
    ),
    "60000/1001": (
        lambda take: resampled(take, "60000/1001"),
        lambda t: 1 + (t - 1) * 24 * 1001 / 60000,
    ),
    "slow, then 30": (
        lambda take: resampled(time_scale(take, 0.3), 30),
        lambda t: 1 + (t - 1) * 0.8 * 0.3,
    ),
    "warp, trimmed, then slow": (
        lambda take: time_scale(trim(time_warp(take, WARP), 3, 20), 0.5, 10),
        lambda t: np.interp(10 + (t - 10) * 0.5, *np.transpose(WARP)),
    ),
}


# Clips that have each of these channels.
CLIPS = [
    ("ease", "pin", "slide", "slerp", "squad", "step"),
    ("steep", "cycle", "spline", "scale", "control"),
    ("euler", "between"),
    ("one key", "local"),
]


@pytest.mark.parametrize("how", RETIMES)
@pytest.mark.parametrize("names", CLIPS)
def test_retiming_evaluates_the_curves(
    tmp_path: Path, how: str, names: tuple[str, ...]
) -> None:
    clip, rig = keyed(tmp_path, *names), hero(tmp_path)
    run, shown = RETIMES[how]
    found = run(clip.sample(rig))
    # A step is on its own side of its key where rounding is not.
    times = np.round(shown(found.clock.times), 10)
    expected = sample_channels(clip.channels, rig, times).motion
    assert_motion(found.motion, expected)
    assert not [n for n in found.notices if n.code == "TAKE007"]


def test_an_ease_in_slow_motion_is_its_polynomial(tmp_path: Path) -> None:
    slow = time_scale(sampled(tmp_path, "ease"), 0.1)
    u = np.arange(121) / 120
    moved = slow.motion.translations.gather(np.array([0]))[:, 0]
    ease = 3 * u**2 - 2 * u**3
    # Motion is in the rest frame of the joint.
    rest = slow.rig.joints[0]
    along = so3.rotate(np.array(rest.rotation), np.array([1.0, 0.2, 0.05]))
    assert_allclose(moved - rest.translation, ease[:, None] * along, atol=EXACT)


def test_frames_of_the_take_stay_as_they_are_to_the_last_bit(tmp_path: Path) -> None:
    take = sampled(tmp_path, *(n for n in CHANNELS if n in {"ease", "spline", "pin"}))
    slow = time_scale(take, 0.25)
    for name in ("translations", "rotations"):
        own, found = (getattr(t.motion, name).dense() for t in (take, slow))
        assert_array_equal(np.abs(found[::4]), np.abs(own))


def test_what_a_pass_changed_goes_straight_and_the_rest_does_not(
    tmp_path: Path,
) -> None:
    names = ("ease", "spline", "control")
    clip, rig = keyed(tmp_path, *names), hero(tmp_path)
    take = clip.sample(rig)
    other = sampled(tmp_path, "cycle", "slerp")
    changed = layer(take, other, weight=0.5, joints=["chest"])
    j = rig.index("chest")
    for shown in (time_scale(changed, 0.5), resampled(changed, 48)):
        times = 1 + (shown.clock.times - 1) * 0.5
        expected = sample_channels(clip.channels, rig, times).motion
        joints = [i for i in range(len(rig.joints)) if i != j]
        assert_motion(shown.motion, expected, joints=joints)
        turns = shown.motion.rotations.gather(np.array([j]))[:, 0]
        own = changed.motion.rotations.gather(np.array([j]))[:, 0]
        halves = so3.slerp(own[:-1], own[1:], np.full((12, 1), 0.5))
        assert_allclose(so3.align_to(turns[1::2], halves), halves, atol=1e-12)
    curved = TakeSampler.from_take(changed).rows_on_curve
    assert np.flatnonzero(~curved["rotations"]).tolist() == [j]


def test_the_other_take_of_a_layer_is_evaluated_too(tmp_path: Path) -> None:
    rig, clip = hero(tmp_path), keyed(tmp_path, "spline", "ease", "pin")
    base = replace(sampled(tmp_path, "one key"), curve=None)
    base = resampled(base, 60)
    other = clip.sample(rig)
    times = 1 + (base.clock.times - 1) * 24 / 60
    expected = sample_channels(clip.channels, rig, times).motion
    assert_motion(layer(base, other).motion, replace(expected, controls=None))
    assert_motion(
        blend(base, other, weight=1.0).motion, replace(expected, controls=None)
    )


def test_a_loop_is_not_its_curve_any_more(tmp_path: Path) -> None:
    take = sampled(tmp_path, "ease", "cycle")
    looped = loop(take, repeats=2, blend=4)
    curved = TakeSampler.from_take(looped).rows_on_curve
    assert not curved["translations"][0]
    assert not curved["rotations"][take.rig.index("elbow_l")]
    straight = time_scale(replace(looped, curve=None), 0.5)
    assert_motion(time_scale(looped, 0.5).motion, straight.motion)


def test_the_ends_are_held_and_one_frame_stays(tmp_path: Path) -> None:
    take = sampled(tmp_path, "cycle", head="fps: 24\nrange: [4, 4]")
    for shown in (
        time_scale(take, 0.1),
        resampled(take, 30),
        time_warp(take, [(1, 4), (3, 4)]),
    ):
        angles = shown.motion.rotations.dense()
        assert_array_equal(angles, np.repeat(angles[:1], len(angles), axis=0))
    assert len(time_scale(take, 0.1)) == len(resampled(take, 30)) == 1


def test_a_curve_that_the_samples_are_not_of_is_left_alone(tmp_path: Path) -> None:
    take = sampled(tmp_path, "ease", "pin")
    shifted = replace(take, clock=replace(take.clock, start=Fraction(3)))
    assert not TakeSampler.from_take(shifted).rows_on_curve["translations"][0]
    other = replace(take.motion, translations=Channel.static(np.zeros((2, 3)), 13))
    strange = replace(take, curve=lambda _: other)
    assert "translations" not in TakeSampler.from_take(strange).rows_on_curve


@pytest.mark.parametrize(
    ("name", "options", "kept"),
    [
        ("time_scale", {"speed": 0.3}, True),
        ("time_scale", {"speed": 2, "pivot": 7}, True),
        ("time_scale", {"speed": -1}, False),
        ("resample", {"fps": "30000/1001"}, True),
        ("resample", {"fps": 12, "lowpass": True}, False),
        ("time_warp", {"curve": ((1, 1), (9, 12))}, False),
    ],
)
def test_curves_of_controls_stay_curves_where_time_runs_evenly(
    tmp_path: Path, name: str, options: dict[str, Any], kept: bool
) -> None:
    keyed(tmp_path, "control", "ease")
    stream = open_clip_source(tmp_path / "shot.clip.yaml")
    pass_ = find_pass(name)
    context = PassContext(lambda _: stream.collect(), tmp_path)
    done = apply_pass(stream, pass_, pass_.options(**options), context)
    curves, take = done.control_curves, done.collect()
    assert ("curl" in curves) is kept
    if kept:
        assert take.motion.controls is not None
        i = [control.name for control in take.rig.controls].index("curl")
        own = take.motion.controls.gather(np.array([i]))[:, 0, 0]
        assert_allclose(evaluate(curves["curl"], take.clock.times)[0], own, atol=EXACT)


def test_curves_between_frames_are_on_the_side_of_their_quaternions() -> None:
    """Whatever sign the curve gives: all are near the frames about them."""
    rig = Rig("one", (Joint("a", -1),))
    angles = np.linspace(0, 3, 5)[:, None]
    turns = so3.from_axis_angle(np.array([0.0, 1, 0]), angles)
    places = np.zeros((5, 1, 3))
    motion = Motion(Channel.from_dense(places), Channel.from_dense(turns))

    def curve(times: np.ndarray) -> Motion:
        on = np.isclose(times, np.round(times))
        values = so3.from_axis_angle(np.array([0.0, 1, 0]), 0.75 * (times[:, None] - 1))
        values[~on] *= -1
        still = np.zeros((len(times), 1, 3))
        return Motion(Channel.from_dense(still), Channel.from_dense(values))

    clock = Clock(Fraction(24), Fraction(1), Fraction(1), 5)
    take = Take(rig, clock, motion, curve=curve)
    between = TakeSampler.from_take(take)
    assert between.rows_on_curve
    found = between.sample(frame_positions(np.arange(9) / 2, 5)).rotations.dense()[:, 0]
    assert ((found[1:] * found[:-1]).sum(axis=1) > 0.9).all()
    wanted = so3.from_axis_angle(np.array([0.0, 1, 0]), 0.375 * np.arange(9))
    np.testing.assert_allclose(found, wanted, atol=1e-12)
