"""The walks and the run of the samples go as people do.

Ranges are those of gait laboratories: Perry and Burnfield, *Gait Analysis* (2010), and
Novacheck, *The biomechanics of running* (1998). A knee is at 0 where thigh and shank
are in line.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from support.stepping import Leg, legs

from animtool import Take, open_source

SAMPLES = Path(__file__).parents[2] / "samples"
# Their files, and frames of two steps.
WALKS = {
    "walk/walk.bvh": 32,
    "retarget/takes/walk.bvh": 33,
    "stride/stride.clip.yaml": 24,
}
RUN, RUN_CYCLE = "retarget/takes/run.bvh", 21
CYCLES = {**WALKS, RUN: RUN_CYCLE}
walks = pytest.mark.parametrize("name", WALKS)
gaits = pytest.mark.parametrize("name", CYCLES)


@cache
def take(name: str) -> Take:
    return open_source(SAMPLES / name).collect()


def cycles(name: str) -> list[tuple[Leg, np.ndarray, int]]:
    """Return each leg, the frames of a cycle from its strike on, and when it lifts.

    A cycle that the take cuts off goes on at its begin.
    """
    found = []
    for leg in legs(take(name)):
        length, count = CYCLES[name], len(leg.stands)
        before = np.roll(leg.stands[:length], 1)
        first = int(np.argmax(leg.stands[:length] & ~before))
        frames = first + np.arange(length)
        frames = np.where(frames < count, frames, frames - length)
        stood = leg.stands[frames]
        found.append((leg, frames, int(np.argmin(stood))))
    return found


@walks
def test_knees_of_a_walk(name: str) -> None:
    """Loading bends them to less than 20°, the swing to 60 to 70°."""
    for leg, frames, lifts in cycles(name):
        knee = leg.knee[frames]
        half = len(frames) // 2
        assert 0.55 < lifts / len(frames) < 0.7
        assert knee[0] < 12
        # Until the other foot strikes.
        assert knee[:half].min() > 5
        assert 15 < knee[:half].max() < 20
        # The knee gives way as the heel strikes, stretches, and bends to push off.
        loading = int(np.argmax(knee[: half // 2]))
        assert 2 <= loading < half // 2 - 1
        assert knee[half - 4 : half].min() < knee[loading] - 4
        assert 30 < knee[lifts - 1] < 45
        assert 60 < knee[lifts:].max() < 70


def test_knees_of_a_run() -> None:
    for leg, frames, lifts in cycles(RUN):
        knee = leg.knee[frames]
        assert 0.3 < lifts / len(frames) < 0.45
        assert 5 < knee[0] < 15
        assert 35 < knee[:lifts].max() < 45
        assert 15 < knee[lifts - 1] < 30
        assert 80 < knee[lifts:].max() < 130


def test_a_run_leaves_the_ground_and_a_walk_does_not() -> None:
    for name in CYCLES:
        left, right = legs(take(name))
        flies = ~(left.stands | right.stands)
        assert flies.any() == (name == RUN)
    assert flies.mean() > 0.1


@gaits
def test_hips_and_ankles_stay_within_the_range_of_people(name: str) -> None:
    for leg, frames, _ in cycles(name):
        hip, ankle = leg.hip[frames], leg.ankle[frames]
        assert -22 < hip.min() < -8
        assert 22 < hip.max() < 50
        assert -30 < ankle.min() < -10
        assert 8 < ankle.max() < (35 if name == RUN else 25)


@gaits
def test_feet_stand_and_clear_the_ground(name: str) -> None:
    for leg, frames, lifts in cycles(name):
        assert leg.slides.max() < 0.005
        heights = leg.sole[..., 1].min(axis=1)
        assert heights.min() > -0.0005
        swing = heights[frames][lifts:]
        middle = slice(len(swing) // 4, -len(swing) // 5)
        assert swing[middle].min() > 0.01
        assert swing.max() < (0.25 if name == RUN else 0.06)


@gaits
def test_hips_rise_twice_a_cycle(name: str) -> None:
    length = CYCLES[name]
    height = take(name).world().positions[:length, 0, 1]
    low, high = (0.06, 0.09) if name == RUN else (0.038, 0.05)
    assert low < np.ptp(height) < high
    rising = np.diff(np.append(height, height[0])) > 0
    assert (rising & ~np.roll(rising, 1)).sum() == 2


@gaits
def test_arms_go_with_the_leg_of_the_other_side(name: str) -> None:
    length, rig = CYCLES[name], take(name).rig
    places = take(name).world().positions[:length]
    known = {"Left": ("LeftHand", "LeftFoot"), "Right": ("RightHand", "RightFoot")}
    if "wrist_l" in rig.names:
        known = {"Left": ("wrist_l", "ankle_l"), "Right": ("wrist_r", "ankle_r")}
    ahead = {
        side: [places[:, rig.index(one), 2] - places[:, 0, 2] for one in names]
        for side, names in known.items()
    }
    for side, other in (("Left", "Right"), ("Right", "Left")):
        assert np.corrcoef(ahead[side][0], ahead[other][1])[0, 1] > 0.8


@gaits
def test_the_cycle_closes(name: str) -> None:
    length, motion = CYCLES[name], take(name).motion
    places, turns = motion.translations.dense(), motion.rotations.dense()
    if len(places) <= length:  # The clip cycles by its keys.
        pytest.skip("one cycle")
    dots = np.abs((turns[0] * turns[length]).sum(axis=-1))
    assert (1 - dots).max() < 1e-9
    moved = places[length] - places[0]
    moved[0, 2] = 0
    assert np.abs(moved).max() < 1e-6
