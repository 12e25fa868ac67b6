"""Samples left out, measured again by plain interpolation."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from support.suite import examples

from animtool.clip.reduction.points import SHELL_DISTANCE, attached_points
from animtool.core.errors import OptionError
from animtool.edit.thin import ThinnedSamples, thin_samples
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.skeleton import Joint, Rig

ARM = Rig("arm", (Joint("a", -1), Joint("b", 0, translation=(0.0, 0.4, 0.0))))
Floats = npt.NDArray[np.float64]


def moved(turns: Floats, slides: Floats | None = None, **others: Channel) -> Motion:
    """Return a motion of rotation vectors ``(F, J, 3)`` and translations of joint a."""
    places = np.tile(ARM.rest_translations, (len(turns), 1, 1))
    if slides is not None:
        places[:, 0] = slides
    rotations = so3.align_signs(so3.exp(turns))
    channels = Channel.from_dense(places), Channel.from_dense(rotations)
    return Motion(*channels, **others)


def errors(codes: Floats, motion: Motion, found: ThinnedSamples) -> Floats:
    """Return the error of every joint at every sample, one sample at a time."""
    places, turns, _ = motion.dense()
    points = attached_points(ARM, SHELL_DISTANCE)
    result = np.zeros((len(codes), len(ARM.joints)))
    kept = found.kept_samples.tolist()
    for low, high in pairwise(kept):
        for i in range(low, high + 1):
            share = (codes[i] - codes[low]) / (codes[high] - codes[low])
            place = places[low] + share * (places[high] - places[low])
            turn = so3.slerp(turns[low], turns[high], np.full(2, share))
            here = forward_kinematics(ARM, place[None], turn[None])
            true = forward_kinematics(ARM, places[i : i + 1], turns[i : i + 1])
            off = np.einsum("jrc,jpc->jpr", here.linear[0], points)
            off += here.positions[0][:, None]
            off -= np.einsum("jrc,jpc->jpr", true.linear[0], points)
            off -= true.positions[0][:, None]
            result[i] = np.linalg.norm(off, axis=-1).max(axis=-1)
    return result


@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 60),
    tolerance=st.floats(1e-4, 0.1),
)
@settings(max_examples=examples(60), deadline=None)
def test_every_sample_is_within_the_tolerance(
    seed: int, count: int, tolerance: float
) -> None:
    rng = np.random.default_rng(seed)
    turns = np.cumsum(rng.normal(0, 0.05, (count, 2, 3)), axis=0)
    slides = np.cumsum(rng.normal(0, 0.01, (count, 3)), axis=0)
    codes = np.cumsum(rng.uniform(0.2, 3.0, count))
    motion = moved(turns, slides)
    found = thin_samples(ARM, codes, motion, tolerance)
    assert found.samples == count
    assert {0, count - 1} <= set(found.kept_samples.tolist())
    assert (np.diff(found.kept_samples) > 0).all()
    assert found.error <= tolerance
    if count > 1:
        measured = errors(codes, motion, found)
        assert measured.max() == pytest.approx(found.error, abs=1e-12)


def test_what_moves_evenly_needs_its_ends() -> None:
    codes = np.arange(200.0)
    turns = np.zeros((200, 2, 3))
    turns[:, 0, 2] = codes * 0.01
    slides = codes[:, None] * np.array([0.01, 0.0, 0.002])
    found = thin_samples(ARM, codes, moved(turns, slides), 1e-6)
    assert_array_equal(found.kept_samples, [0, 199])


def test_what_bends_needs_about_the_samples_of_theory() -> None:
    # A chord of x(t) of length h is off by h² max|x''| / 8.
    count, tolerance = 4001, 1e-3
    codes = np.arange(count) / 24
    slides = np.zeros((count, 3))
    slides[:, 0] = np.sin(codes)
    found = thin_samples(ARM, codes, moved(np.zeros((count, 2, 3)), slides), tolerance)
    # The mean of sqrt(|x''|) over a period is 0.763.
    wanted = codes[-1] * 0.763 / np.sqrt(8 * tolerance)
    assert wanted <= len(found.kept_samples) <= 1.6 * wanted


def test_a_joint_of_its_own_tolerance() -> None:
    codes = np.arange(120.0)
    turns = np.zeros((120, 2, 3))
    turns[:, 1, 2] = np.sin(codes / 9)
    loose = thin_samples(ARM, codes, moved(turns), 0.01)
    tight = thin_samples(
        ARM, codes, moved(turns), 0.01, joint_tolerances={"[b-z]": 1e-4}
    )
    assert tight.error <= 1e-4 < loose.error
    assert len(tight.kept_samples) > len(loose.kept_samples)
    assert tight.joint_index == 1


def test_weights_count_too() -> None:
    count = 50
    weights = Channel.from_dense(np.linspace(0, 1, count)[:, None, None] ** 2)
    motion = moved(np.zeros((count, 2, 3)), weights=weights)
    found = thin_samples(ARM, np.arange(float(count)), motion, 0.1)
    assert 2 < len(found.kept_samples) < count
    assert 0 < found.weight_error <= 1e-3
    assert found.error == 0


def test_a_jump_keeps_both_sides() -> None:
    slides = np.zeros((40, 3))
    slides[17:] = 1.0
    found = thin_samples(
        ARM, np.arange(40.0), moved(np.zeros((40, 2, 3)), slides), 1e-3
    )
    assert_array_equal(found.kept_samples, [0, 16, 17, 39])


@pytest.mark.parametrize("tolerance", [0.0, -1.0, np.nan, np.inf])
def test_a_tolerance_is_above_nothing(tolerance: float) -> None:
    with pytest.raises(OptionError) as caught:
        thin_samples(ARM, np.arange(2.0), moved(np.zeros((2, 2, 3))), tolerance)
    assert caught.value.faults[0].code == "CLIP020"


def test_an_unknown_joint_is_named_with_the_nearest() -> None:
    rig = Rig("r", (Joint("elbow_l", -1),))
    still = Motion(
        Channel.from_dense(rig.rest_translations[None]),
        Channel.from_dense(rig.rest_rotations[None]),
    )
    with pytest.raises(OptionError) as caught:
        thin_samples(rig, np.zeros(1), still, 1.0, joint_tolerances={"elbow": 1.0})
    fault = caught.value.faults[0]
    assert fault.code == "CLIP020"
    assert fault.hint == "did you mean 'elbow_l'?"
