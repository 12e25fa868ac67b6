"""Spikes and noise out of takes."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from support.small_takes import content, small

from animtool.capture import clean as clean_module
from animtool.capture.clean import (
    CleanedSignal,
    CleanOptions,
    _noise_displacement,
    _roughness,
    clean,
    clean_take,
    noise_scores,
)
from animtool.core.clock import Clock
from animtool.core.errors import OptionError
from animtool.formats.bvh.read import read_bvh
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.skeleton import Joint, Rig


def spiked(take: Take, seed: int) -> tuple[Take, set[tuple[int, int]]]:
    """Return a take with spikes of 1 to 3 frames, and the frames and joints of them."""
    rng = np.random.default_rng(seed)
    turns, truth = take.motion.rotations.dense(), set()
    for joint in take.motion.rotations.animated.tolist():
        first = int(rng.integers(4, take.clock.count - 8))
        for frame in range(first, first + int(rng.integers(1, 4))):
            axis = rng.standard_normal(3)
            turn = so3.exp(axis / np.linalg.norm(axis) * rng.uniform(0.4, 3.0))
            turns[frame, joint] = so3.multiply(turns[frame, joint], turn)
            truth.add((frame, joint))
    turns = so3.align_signs(turns)
    motion = replace(take.motion, rotations=Channel.from_dense(turns))
    return replace(take, motion=motion), truth


def removed(take: Take) -> tuple[Take, set[tuple[int, int]]]:
    cleaned, signals = clean_take(take, CleanOptions(keep_noise=True))
    index = take.rig.names.index
    return cleaned, {(f, index(s.joint)) for s in signals for f in s.spikes}


def test_spikes_are_found_and_nothing_else(walk: Path) -> None:
    take = read_bvh(walk).collect()
    assert not removed(take)[1]
    hits = wrong = missed = 0
    for seed in range(3):
        dirty, truth = spiked(take, seed)
        cleaned, found = removed(dirty)
        hits += len(found & truth)
        wrong += len(found - truth)
        missed += len(truth - found)
        there = so3.angle_between(
            cleaned.motion.rotations.dense(), take.motion.rotations.dense()
        )
        assert np.percentile(there, 99.5) < 0.05
    assert hits / (hits + wrong) > 0.95
    assert hits / (hits + missed) > 0.95


def noisy(take: Take, turn: float, shift: float) -> Take:
    rng = np.random.default_rng(8)
    turns, shifts = take.motion.rotations.dense(), take.motion.translations.dense()
    shake = so3.exp(turn * rng.standard_normal(shifts.shape))
    motion = replace(
        take.motion,
        rotations=Channel.from_dense(so3.multiply(turns, shake)),
        translations=Channel.from_dense(
            shifts + shift * rng.standard_normal(shifts.shape)
        ),
    )
    return replace(take, motion=motion)


def test_noise_is_lessened_and_said(walk: Path) -> None:
    take = read_bvh(walk).collect()
    dirty = noisy(take, 0.02, 0.002)
    cleaned = clean(dirty)
    truth = take.motion.rotations.dense()
    before, after = (
        so3.angle_between(one.motion.rotations.dense(), truth)
        for one in (dirty, cleaned)
    )
    assert np.sqrt(np.mean(after**2)) < 0.7 * np.sqrt(np.mean(before**2))
    note = cleaned.notices[-1]
    assert note.code == "CAP101"
    assert "Hz" in note.message


def test_what_was_filtered_is_told_from_the_lowest_cut_off_on() -> None:
    """Of a slow joint, a fast one and one between, in this order; noise is 2 mm."""
    count = 480
    rig = small().rig
    rng = np.random.default_rng(3)
    time = np.arange(count) / 60
    shifts = 0.002 * rng.standard_normal((count, 3, 3))
    for joint, frequency in enumerate((1.0, 6.0, 0.1)):
        shifts[:, joint] += 0.1 * np.sin(2 * np.pi * frequency * time)[:, None]
    take = small(count)
    motion = replace(
        take.motion,
        translations=Channel.from_dense(shifts),
        rotations=Channel.static(take.motion.rotations.rest, count),
    )
    clock = replace(take.clock, fps=Fraction(60))
    dirty = replace(take, motion=motion, clock=clock)
    _, signals = clean_take(dirty, CleanOptions())
    names = [one.joint for one in sorted(signals, key=lambda one: one.cutoff or 0)]
    assert names == [rig.names[2], rig.names[0], rig.names[1]]
    cutoffs = sorted(one.cutoff or 0 for one in signals)
    message = clean(dirty).notices[-1].message
    assert message.startswith(
        f"3 of 3 signals filtered, at {cutoffs[0]:.3g} Hz ({rig.names[2]}) to "
        f"{cutoffs[2]:.3g} Hz ({rig.names[1]}); noise up to 2."
    )
    # The report has the lowest first, too, which was filtered most.
    scores = noise_scores(count, signals)
    assert [text.split()[0] for text in scores.names["filtered"]] == names


def test_a_take_without_noise_stays() -> None:
    rig, count = small().rig, 60
    turns = np.zeros((count, len(rig.joints), 3))
    turns[:, 0, 1] = np.sin(np.arange(count) / 15)
    take = small(count)
    motion = replace(
        take.motion,
        rotations=Channel.from_dense(so3.exp(turns)),
        translations=Channel.static(take.motion.translations.rest, count),
    )
    take = replace(take, motion=motion)
    assert content(clean(take)) == content(take)


def test_steps_and_corners_stay() -> None:
    take = small(60)
    shifts = np.zeros((60, 3, 3))
    shifts[20:, 0, 0] = 0.5  # a step
    shifts[40:, 0, 2] = np.arange(20) * 0.05  # a corner
    motion = replace(take.motion, translations=Channel.from_dense(shifts))
    cleaned, _ = removed(replace(take, motion=motion))
    assert_array_equal(cleaned.motion.translations.dense(), shifts)


def test_a_short_take_is_left_and_named() -> None:
    assert [fault.code for fault in clean(small(5)).notices] == ["CAP102"]
    assert content(clean(small(5))) == content(small(5))


@pytest.mark.parametrize("options", [{"spikes": -1}, {"spikes": 9}, {"cutoff": 0.0}])
def test_options_that_make_no_sense(options: dict[str, float]) -> None:
    with pytest.raises(OptionError) as error:
        clean(small(), **options)  # type: ignore[arg-type]
    assert error.value.code == "CAP001"


@pytest.mark.parametrize("cutoff", [0.1, 0.5, 15.0, 40.0])
def test_cutoffs_that_remove_motion_or_nothing_are_reported(
    walk: Path, cutoff: float
) -> None:
    (warning,) = (
        notice
        for notice in clean(read_bvh(walk).collect(), cutoff=cutoff).notices
        if notice.code == "CAP106"
    )
    assert f"{cutoff:g} Hz" in warning.message
    assert ("RightLeg" in warning.message) == (cutoff < 1)


@pytest.mark.parametrize("cutoff", [1.0, 3.0, 6.0, 14.0, None])
def test_cutoffs_that_keep_the_motion_are_silent(
    walk: Path, cutoff: float | None
) -> None:
    take = read_bvh(walk).collect()
    for dirty in (take, noisy(take, 0.1, 0.002)):
        cleaned = clean(dirty, cutoff=cutoff)
        assert {"CAP101"} >= {n.code for n in cleaned.notices[len(dirty.notices) :]}


def test_a_low_cutoff_on_a_still_and_noisy_take_is_silent() -> None:
    take = noisy(small(240), 0.02, 0.002)
    codes = {notice.code for notice in clean(take, cutoff=0.2).notices}
    assert "CAP106" not in codes


def test_what_would_be_most_of_a_channel_is_no_spike() -> None:
    """Large spikes in four frames of fourteen hide small ones in as many others.

    Both together are more than half of the frames: the small ones stay.
    """
    phase = (np.arange(87) + 3) % 14
    large = np.isin(phase, [6, 7, 8, 9])
    shifts = np.zeros((87, 3, 3))
    shifts[large, 0, 0] = 1.0
    shifts[phase > 12, 0, 1] = shifts[phase < 3, 0, 1] = 0.05
    take = small(87)
    motion = replace(take.motion, translations=Channel.from_dense(shifts))
    options = CleanOptions(spikes=4, keep_noise=True)
    _, signals = clean_take(replace(take, motion=motion), options)
    (found,) = [one.spikes for one in signals if one.spikes and not one.is_rotation]
    assert found == tuple(np.flatnonzero(large).tolist())


@pytest.mark.parametrize("rate", [24, 60, 240])
def test_the_noise_of_a_rotation_is_an_angle(rate: int) -> None:
    """Of 20 mrad about each axis, and of 3 mm, over ten seconds of a slow swing."""
    count = 10 * rate
    still = small(count)
    swing = np.zeros((count, 3, 3))
    swing[..., 0] = np.sin(2 * np.pi * 0.3 * np.arange(count) / rate)[:, None]
    motion = replace(
        still.motion,
        rotations=Channel.from_dense(so3.exp(swing)),
        translations=Channel.from_dense(swing),
    )
    clock = replace(still.clock, fps=Fraction(rate))
    dirty = noisy(replace(still, motion=motion, clock=clock), 0.02, 0.003)
    _, signals = clean_take(dirty, CleanOptions(keep_noise=True))
    for rotation, expected in ((True, 0.02), (False, 0.003)):
        found = [one.noise for one in signals if one.is_rotation == rotation]
        assert np.mean(found) == pytest.approx(expected, rel=0.05)


def test_how_rough_a_motion_is_is_told_by_as_many_frames_before_as_behind() -> None:
    """Of 17 frames 9 bend from frame 51 on, where bends begin; ends go by the last."""
    bends = np.zeros(100)
    bends[51:] = 1.0  # the second difference about a frame
    path = np.zeros((100, 3))
    path[1:, 0] = np.cumsum(np.cumsum(bends))[:-1]
    assert_array_equal(_roughness(path), (np.arange(100) >= 51).astype(float))
    assert_array_equal(_roughness(path[:2]), [0.0, 0.0])
    assert_array_equal(_roughness(path[60:64]), np.ones(4))


def test_a_cutoff_filters_a_take_without_noise() -> None:
    angles = 0.5 * np.sin(np.arange(240) / 20)
    rotations = np.stack(
        [np.sin(angles / 2), 0 * angles, 0 * angles, np.cos(angles / 2)], axis=-1
    )
    rig = Rig("arm", (Joint("upper", -1), Joint("lower", 0, translation=(0, 1.0, 0))))
    dense = np.tile([0.0, 0, 0, 1], (240, 2, 1))
    dense[:, 1] = rotations
    translations = np.tile(rig.rest_translations, (240, 1, 1))
    motion = Motion(Channel.from_dense(translations), Channel.from_dense(dense))
    take = Take(rig, Clock(60, 1, 1, 240), motion)
    assert_array_equal(clean(take).motion.rotations.dense(), dense)
    filtered = clean(take, cutoff=0.1)
    assert "CAP106" in [notice.code for notice in filtered.notices]
    change = so3.angle_between(filtered.motion.rotations.dense(), dense)
    assert change.max() > 0.2


@pytest.mark.parametrize(
    ("cutoff", "found"), [(0.25, True), (3.0, False), (6.0, False)]
)
def test_cutoffs_that_move_joints_far_are_warned_of(
    root: Path, cutoff: float, found: bool
) -> None:
    take = read_bvh(root / "samples/retarget/takes/turn.bvh").collect()
    notices = [n for n in clean(take, cutoff=cutoff).notices if n.code == "CAP106"]
    assert len(notices) == found
    for notice in notices:
        assert "'LeftToeBase' by 456 mm" in notice.message
        assert "0.25 of the highest frequency, 15 Hz, would be 3.75 Hz" in str(
            notice.hint
        )


def test_noise_displaces_the_end_of_a_chain_by_that_of_all_joints() -> None:
    """Of 3 mm an axis at the root, and of 20 and 10 mrad at 2 m and 1 m."""
    bone = (0, 1.0, 0)
    joints = (
        Joint("a", -1),
        Joint("b", 0, translation=bone),
        Joint("c", 1, translation=bone),
    )
    signals = [
        CleanedSignal("a", False, (), 0.003, 1.0),
        CleanedSignal("a", True, (), 0.02, 1.0),
        CleanedSignal("b", True, (), 0.01, 1.0),
    ]
    expected = np.sqrt(3 * 0.003**2 + 2 * (2 * 0.02) ** 2 + 2 * 0.01**2)
    assert _noise_displacement(Rig("arm", joints), signals) == pytest.approx(expected)
    assert _noise_displacement(Rig("none", ()), []) == 0.0


def test_a_cutoff_is_judged_without_cleaning_again(
    walk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    takes = []

    def count(take: Take, options: CleanOptions) -> tuple[Take, list[CleanedSignal]]:
        takes.append(take)
        return clean_take(take, options)

    monkeypatch.setattr(clean_module, "clean_take", count)
    clean(read_bvh(walk).collect(), cutoff=6.0)
    assert len(takes) == 1


def test_spikes_are_not_what_a_cutoff_moves(walk: Path) -> None:
    dirty, _ = spiked(read_bvh(walk).collect(), 0)
    notices = clean(dirty, cutoff=6.0).notices
    assert "CAP106" not in [notice.code for notice in notices]
