"""Keys of an FBX as a clip: what a clip says is what the file's curves say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.fbx import TICKS, Tree, array, as_binary, small_fbx

from animtool.clip.clip import Clip
from animtool.clip.keyed_curve import KeyedCurve
from animtool.clip.sample import sample_channels
from animtool.formats.fbx.read import read_fbx
from animtool.formats.gltf.sampler_keys import convert_clip_keys
from animtool.maths.curves import Interp
from animtool.motion.take import TakeStream
from animtool.rig.kinematics import forward_kinematics

USER = 0x408


def objects(trees: list[Tree]) -> list[Tree]:
    """Return the objects of a file."""
    return next(tree[2] for tree in trees if tree[0] == "Objects")


def curve(own: int, seconds: list[float], values: list[float], **how: Any) -> Tree:
    """Return a curve whose keys are alike."""
    flags, slopes = how.get("flags", USER), how.get("slopes", (30.0, -20.0))
    weights = how.get("weights", (3333, 3333))
    packed = np.array([weights[0] | weights[1] << 16], "<u4").view("<i4")
    stated = np.array([*slopes, 0.0, 0.0], "<f4").view("<i4").copy()
    stated[2] = packed[0]
    return (
        "AnimationCurve",
        [own, "\x00\x01AnimCurve", ""],
        [
            ("KeyTime", [array([round(s * TICKS) for s in seconds], "<i8")], []),
            ("KeyValueFloat", [array(values, "<f4")], []),
            ("KeyAttrFlags", [array([flags], "<i4")], []),
            ("KeyAttrDataFloat", [stated], []),
            ("KeyAttrRefCount", [array([len(seconds)], "<i4")], []),
        ],
    )


def arm(*curves: tuple[str, Tree], layered: bool = False) -> list[Tree]:
    """Return an arm whose fore bone turns by curves alone, by axis."""
    trees = small_fbx()
    found = objects(trees)
    kept = [one for one in found if one[0] != "AnimationCurve"]
    if not layered:
        kept = [one for one in kept if one[1][0] != 13]
    found[:] = [*kept, *(own for _, own in curves)]
    links = next(tree[2] for tree in trees if tree[0] == "Connections")
    links += [("C", ["OP", own[1][0], 14, axis], []) for axis, own in curves]
    return trees


def opened(folder: Path, trees: list[Tree]) -> tuple[TakeStream, Clip]:
    """Return a file as a stream, and as a clip."""
    path = folder / "arm.fbx"
    path.write_bytes(as_binary(trees))
    stream = read_fbx(path)
    assert isinstance(stream.curve, KeyedCurve)
    return stream, stream.curve.get_clip()


def off(stream: TakeStream, clip: Clip) -> float:
    """Return how far a clip is from the curves, at many times between frames."""
    times = np.linspace(float(clip.first), float(clip.last), 173)
    assert stream.curve is not None
    exact = forward_kinematics(stream.rig, *stream.curve(times).dense())
    ours = sample_channels(clip.channels, stream.rig, times).motion
    return float(
        np.abs(
            forward_kinematics(stream.rig, *ours.dense()).linear - exact.linear
        ).max()
    )


WEIGHTED = USER | 0x3000000
TURNS: dict[str, list[tuple[str, Tree]]] = {
    "cubic": [("d|Z", curve(31, [0.0, 0.3, 1.0], [0, 50, 10]))],
    "weighted": [
        ("d|Z", curve(31, [0.0, 1.0], [0, 50], flags=WEIGHTED, weights=(900, 7000)))
    ],
    "other times": [
        ("d|X", curve(31, [0.0, 0.37, 1.0], [0, 50, 10])),
        ("d|Y", curve(32, [0.2, 0.9], [-10, 30])),
        ("d|Z", curve(33, [0.1, 0.7], [5, 25], flags=4)),
    ],
    "steps": [("d|Z", curve(31, [0.0, 0.5, 1.0], [0, 50, 10], flags=2))],
    "bias": [("d|Z", curve(31, [0.0, 0.5, 1.0], [0, 50, 10], flags=8, slopes=(80, 9)))],
}


@pytest.mark.parametrize("name", TURNS)
def test_a_clip_has_the_keys_of_the_file(tmp_path: Path, name: str) -> None:
    stream, clip = opened(tmp_path, arm(*TURNS[name]))
    assert not clip.notices
    (turning,) = [c for c in clip.channels if c.target == "joint/fore.rotation"]
    assert turning.euler
    seconds = {t for _, own in TURNS[name] for t in own[2][0][1][0] / TICKS * 24}
    np.testing.assert_allclose(turning.times, sorted(seconds), atol=1e-6)
    assert off(stream, clip) < 1e-9


def test_keys_come_after_the_rotation_before_them(tmp_path: Path) -> None:
    trees = arm(*TURNS["cubic"])
    (fore,) = [o for o in objects(trees) if o[0] == "Model" and o[1][0] == 2]
    fore[2][0][2].extend(
        [
            ("P", ["RotationActive", "bool", "", "", 1], []),
            ("P", ["PreRotation", "Vector3D", "", "", 40.0, -20.0, 70.0], []),
        ]
    )
    stream, clip = opened(tmp_path, trees)
    assert not clip.notices
    assert off(stream, clip) < 1e-9


@pytest.mark.parametrize("way", "KRAM")
def test_curves_go_on_as_those_of_the_file(tmp_path: Path, way: str) -> None:
    own = curve(31, [0.25, 0.4, 0.5], [0, 50, 0 if way == "R" else 20])
    for side in ("Pre", "Post"):
        rows = [("Type", [ord(way)], []), ("Repetition", [-1], [])]
        own[2].append((f"{side}-Extrapolation", [], rows))
    stream, clip = opened(tmp_path, arm(("d|Z", own)))
    assert not clip.notices
    assert off(stream, clip) < 1e-9


def test_what_a_clip_cannot_say_is_sampled_and_named(tmp_path: Path) -> None:
    # At a jump from period to period.
    repeated = curve(31, [0.25, 0.5], [0, 50])
    rows = [("Type", [ord("R")], []), ("Repetition", [-1], [])]
    repeated[2].append(("Post-Extrapolation", [], rows))
    for trees in (
        arm(
            ("d|X", curve(31, [0.0, 0.5, 1.0], [0, 50, 10], flags=2)),
            ("d|Z", curve(32, [0.0, 1.0], [0, 50])),
        ),
        arm(
            ("d|X", curve(31, [0.0, 1.0], [0, 50], flags=WEIGHTED, weights=(9, 9))),
            ("d|Z", curve(32, [0.0, 1.0], [0, 50])),
        ),
        arm(("d|X", curve(31, [0.0, 0.5, 1.0], [0, 50, 10], flags=0x102))),
        arm(("d|X", repeated)),
    ):
        stream, clip = opened(tmp_path, trees)
        assert [fault.code for fault in clip.notices] == ["FBX121"]
        (turning,) = [c for c in clip.channels if c.target.startswith("joint/fore.")]
        assert set(turning.interps) == {Interp.SLERP}
        at = np.arange(float(clip.first), float(clip.last) + 1)
        assert stream.curve is not None
        exact = forward_kinematics(stream.rig, *stream.curve(at).dense()).linear
        ours = sample_channels(clip.channels, stream.rig, at).motion
        found = forward_kinematics(stream.rig, *ours.dense()).linear
        np.testing.assert_allclose(found, exact, atol=1e-9)


def test_a_rotation_that_keys_add_to_is_no_key_of_gltf(tmp_path: Path) -> None:
    trees = arm(*TURNS["cubic"])
    (fore,) = [o for o in objects(trees) if o[0] == "Model" and o[1][0] == 2]
    row = ("P", ["PreRotation", "Vector3D", "", "", 40.0, -20.0, 70.0], [])
    fore[2][0][2].extend([("P", ["RotationActive", "bool", "", "", 1], []), row])
    stream, clip = opened(tmp_path, trees)
    names = {c.target for c in clip.channels}
    still = "joint/fore.local_rotation"
    assert {"joint/fore.rotation", still} <= names or still not in names
    assert (1, "rotation") not in convert_clip_keys(clip, stream.collect(), clip.first)
