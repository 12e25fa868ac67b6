from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from support.clips import channel_of, hero, loaded, write_clip

from animtool.clip.clip import Clip
from animtool.core.errors import AnimtoolError
from animtool.rig.skeleton import Joint, Rig
from animtool.scene.sources.open import open_source

CURL = """\
- {target: control/curl, keys: [{t: 1, v: 0}, {t: 9, v: 2}]}
"""


def test_a_clip_on_the_rig_that_it_names_or_another(tmp_path: Path) -> None:
    rig = hero(tmp_path)
    path = write_clip(tmp_path, CURL)
    for clip in (Clip.load(path), Clip.load(str(path), rig)):
        (channel,) = clip.channels
        assert channel.values.ravel().tolist() == [0, 2]
    path.write_text(path.read_text().replace("rig: hero.rig.yaml\n", ""))
    assert Clip.load(path, rig).fps == 24
    with pytest.raises(AnimtoolError) as caught:
        Clip.load(path)
    assert caught.value.code == "CLIP011"


def test_sampling_is_what_a_bake_samples(tmp_path: Path) -> None:
    clip, rig = loaded(tmp_path, CURL)
    take = clip.sample(rig)
    expected = open_source(tmp_path / "shot.clip.yaml").collect()
    assert take.clock == expected.clock
    assert_array_equal(take.motion.rotations.values, expected.motion.rotations.values)
    codes = [notice.code for notice in take.notices]
    assert codes == [notice.code for notice in expected.notices]
    assert "CLIP101" in codes
    clamped = [n for n in clip.sample(rig, clamp=True).notices if n.code == "CLIP101"]
    assert all(notice.message.endswith("clamped") for notice in clamped)


@given(
    st.fractions(-50, 50, max_denominator=8),
    st.fractions(0, 20, max_denominator=8),
    st.sampled_from(["24", "23.976", "30000/1001", "120"]),
    st.sampled_from([Fraction(1), Fraction(1, 4), Fraction(2)]),
)
def test_the_clock_is_exact(
    first: Fraction, length: Fraction, fps: str, step: Fraction
) -> None:
    rig = Rig("hero", (Joint("hips", -1),))
    clip = Clip("nod", Fraction(24), first, first + length, ())
    clock = clip.sample(rig, fps, step=step).clock
    assert (clock.start, clock.step) == (first, step)
    last = first + (clock.count - 1) * step * clip.fps / clock.fps
    assert last <= clip.last < last + step * clip.fps / clock.fps


def test_a_rate_keeps_the_motion_in_time(tmp_path: Path) -> None:
    clip, rig = loaded(tmp_path, CURL)
    whole, half = clip.sample(rig), clip.sample(rig, 48.0)
    assert_array_equal(half.motion.rotations.values[::2], whole.motion.rotations.values)
    assert half.clock.duration == whole.clock.duration


@pytest.mark.parametrize("fps", ["fast", 0, -24.0, float("nan")])
def test_a_rate_that_is_none(tmp_path: Path, fps: str | float) -> None:
    clip, rig = loaded(tmp_path, CURL)
    with pytest.raises(AnimtoolError) as caught:
        clip.sample(rig, fps)
    assert caught.value.code == "SCN022"


@pytest.mark.parametrize("step", [0, -1, float("inf"), float("nan")])
def test_a_step_that_is_none(tmp_path: Path, step: float) -> None:
    clip, rig = loaded(tmp_path, CURL)
    with pytest.raises(AnimtoolError) as caught:
        clip.sample(rig, step=step)
    assert caught.value.code == "CLIP021"


@pytest.mark.parametrize("last", [Fraction(0), Fraction(10**9)])
def test_a_range_without_frames_or_with_too_many(
    tmp_path: Path, last: Fraction
) -> None:
    clip, rig = loaded(tmp_path, CURL)
    with pytest.raises(AnimtoolError) as caught:
        replace(clip, last=last).sample(rig)
    assert caught.value.code == "CLIP006"


def test_every_target_that_another_rig_lacks_is_named(tmp_path: Path) -> None:
    clip, rig = loaded(tmp_path, CURL)
    elbow = replace(channel_of([1, 2], np.zeros((2, 1))), target="joint/elbow_l.angle")
    clip = replace(clip, channels=(*clip.channels, elbow))
    clip.sample(rig)
    with pytest.raises(AnimtoolError) as caught:
        clip.sample(Rig("other", (Joint("elbow_l", -1),)))
    assert [fault.code for fault in caught.value.faults] == ["CLIP002", "CLIP003"]


def test_a_short_repr(tmp_path: Path) -> None:
    clip, _ = loaded(tmp_path, CURL)
    assert repr(clip) == "<Clip 'shot': 1 channel, 2 keys, frames 1 to 9 at 24 fps>"
    assert repr(clip.channels[0]) == "<ClipChannel 'control/curl': 2 keys>"


def test_the_rig_may_be_a_path(tmp_path: Path) -> None:
    rig = hero(tmp_path)
    path = write_clip(tmp_path, CURL)
    (channel,) = Clip.load(path, tmp_path / "hero.rig.yaml").channels
    assert repr(channel) == repr(Clip.load(path, rig).channels[0])
    with pytest.raises(AnimtoolError) as caught:
        Clip.load(path, str(tmp_path / "none.rig.yaml"))
    assert caught.value.code == "IO001"


@pytest.mark.parametrize("fps", [0, -1, "none", [24], float("inf")])
def test_a_range_is_not_counted_at_a_rate_that_is_none(fps: Any) -> None:
    clip = Clip("nod", Fraction(24), Fraction(1), Fraction(5), ())
    with pytest.raises(AnimtoolError) as caught:
        clip.frame_count(fps)
    assert caught.value.code == "SCN022"


def test_a_clip_on_the_rig_of_another_is_one_fault(root: Path) -> None:
    clip = Clip.load(root / "samples/stride/stride.clip.yaml")
    arm = Rig.load(root / "rigs/arm/arm.rig.yaml")
    biped = root / "rigs/biped/biped.rig.yaml"
    assert clip.rig_path is not None
    assert clip.rig_path.samefile(biped)
    for path, said in ((clip.rig_path, "biped.rig.yaml"), (None, "right rig")):
        with pytest.raises(AnimtoolError) as caught:
            replace(clip, rig_path=path).sample(arm)
        (fault,) = caught.value.faults
        assert fault.code == "CLIP002"
        assert f"'arm' has none of the {len(clip.channels)} targets" in fault.message
        assert said in str(fault.hint)


def test_a_target_that_two_channels_have_is_one_fault(root: Path) -> None:
    clip = Clip.load(root / "samples/stride/stride.clip.yaml")
    channels = [
        replace(channel, target=channel.target.replace("hips", "hipz"))
        for channel in clip.channels
    ]
    with pytest.raises(AnimtoolError) as caught:
        replace(clip, channels=tuple(channels)).sample(Rig.load(clip.rig_path or ""))
    assert [(f.code, f.hint) for f in caught.value.faults] == [
        ("CLIP002", "did you mean 'hips'?")
    ]
