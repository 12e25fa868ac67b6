from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.clips import RIG, hero, write_clip

from animtool.clip import blocks
from animtool.clip.blocks import sample_blocks
from animtool.clip.clip import Clip
from animtool.clip.file import load_clip_of
from animtool.clip.sample import sample_channels
from animtool.motion.motion import Channel, Motion
from animtool.rig.file import load_rig

PARTS = ("translations", "rotations", "scales", "weights", "controls")
# Angles of a joint, by key; the other one turns half a revolution at once.
ANGLES = [0, 40, 90, 20, 160, -40, 0, 70, 10, 30, 5, 80]
TURNS = ["[1, 0, 0, 0]", "[0, 1, 0, 0]", "[0, 0, 0, 1]", "[0, 1, 0, 0]"]


def key(t: float, v: object) -> str:
    return f"{{t: {t}, v: {v}}}"


def channel(target: str, keys: list[str], more: str = "") -> str:
    return f"- {{target: {target}, {more} keys: [{', '.join(keys)}]}}\n"


# Part of it moves in some blocks only, and some in none.
KEYED = (
    channel("joint/elbow_l.angle", [key(2 * i, a) for i, a in enumerate(ANGLES)])
    + channel(
        "joint/shoulder_l.rotation",
        [key(5 * i, turn) for i, turn in enumerate(TURNS)],
        "interp: step,",
    )
    + channel(
        "joint/chest.rotation",
        [key(i, f"[1, {i % 5 - 2}, {i % 3}, 0.5]") for i in range(24)],
        "interp: squad,",
    )
    + channel(
        "joint/hips.translation",
        [key(0, [0, 0, 0]), key(3, [0, 9, 1]), key(7, [1, 0, 0])],
        "interp: catmull_rom, parametrization: chordal, post: linear,",
    )
    + channel("joint/wrist_l.scale", [key(30, [1, 1, 1]), key(40, [2, 2, 2])])
)
CONTROLLED = KEYED + channel(
    "control/curl", [key(0, 0), key(4, 1.5), key(9, 0), key(15, 0)]
)
CYCLED = channel(
    "joint/chest.rotation",
    [key(i / 2, f"[1, {i % 5}, 0, 0.5]") for i in range(9)],
    "interp: spline, post: cycle_offset,",
) + channel(
    "joint/elbow_l.angle",
    [key(i / 2, 3 * i) for i in range(5)],
    "interp: linear, post: oscillate,",
)
RIGS = {
    "controls": RIG,
    "plain": RIG.partition("controls:")[0].replace(
        "   mimic: {joint: elbow_l, gain: 0.1, offset: 1}}", "   limits: [0, 1]}"
    ),
    "driven": RIG.replace(
        "axis: [1, 0, 0],\n   mimic: {joint: elbow_l, gain: 0.1, offset: 1}}",
        "axis: [1, 0, 0],\n   driven: {expr: elbow_l.angle / 90}}",
    ),
}


def clip_on(folder: Path, rig: str, channels: str) -> Clip:
    (folder / "hero.rig.yaml").write_text(RIGS[rig])
    return load_clip_of(write_clip(folder, channels))


@pytest.mark.slow
@pytest.mark.parametrize("clamp", [False, True])
@pytest.mark.parametrize(
    ("rig", "channels"),
    [
        ("plain", KEYED),
        ("controls", CONTROLLED),
        ("driven", CONTROLLED),
        ("plain", CYCLED),
    ],
)
@pytest.mark.parametrize("size", [1, 4, 9])
def test_blocks_are_the_whole(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    rig: str,
    channels: str,
    size: int,
    *,
    clamp: bool,
) -> None:
    clip = clip_on(tmp_path, rig, channels)
    built = load_rig(tmp_path / "hero.rig.yaml")
    times = np.arange(0.0, 26.5, 0.5)
    whole = sample_channels(clip.channels, built, times, clamp=clamp)
    rows = len(built.joints) + len(built.controls)
    monkeypatch.setattr(blocks, "BLOCK_ROWS", size * rows)
    monkeypatch.setattr(blocks, "MANY_KEYS", 2)
    parts = list(sample_blocks(clip.channels, built, times, clamp=clamp))
    assert [part.motion.frames for part in parts[:-1]] == [size] * (len(parts) - 1)
    joined = Motion.concatenate([part.motion for part in parts])
    for name in PARTS:
        one: Channel | None = getattr(joined, name)
        other: Channel | None = getattr(whole.motion, name)
        assert (one is None) == (other is None), name
        if one is not None and other is not None:
            np.testing.assert_array_equal(one.animated, other.animated, name)
            np.testing.assert_array_equal(one.dense(), other.dense(), name)
    assert not any(part.clip_notices for part in parts[:-1])
    found = [(n.fault, n.frame) for n in parts[-1].clip_notices]
    expected = [(n.fault, n.frame) for n in whole.clip_notices]
    assert sorted(found, key=str) == sorted(expected, key=str)


def test_a_short_clip_is_one_block(tmp_path: Path) -> None:
    rig = hero(tmp_path)
    clip = load_clip_of(write_clip(tmp_path, CONTROLLED))
    times = np.arange(0.0, 20.0)
    (part,) = sample_blocks(clip.channels, rig, times)
    assert part.clip_notices == sample_channels(clip.channels, rig, times).clip_notices
