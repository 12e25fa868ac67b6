"""Figures of passes over one small take whose joints, shapes and tracks all move."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.figures import check_figures
from support.gaits import gait, swinging
from support.small_takes import small, with_tracks

from animtool.core.errors import OptionError
from animtool.edit.cycle import find_cycle, measure_cycle
from animtool.edit.layers import blend, difference, layer
from animtool.edit.looping import loop
from animtool.edit.mirroring import mirror
from animtool.edit.resample import resampled
from animtool.edit.retiming import time_scale, time_warp, trim
from animtool.edit.root_motion import extract_root, recompose_root
from animtool.edit.thin import thin_samples
from animtool.edit.tree import hang
from animtool.motion.motion import Channel
from animtool.motion.passes import PassContext, apply_pass, find_pass
from animtool.motion.take import Take, TakeStream
from animtool.rig.parts import Shape
from animtool.rig.skeleton import JointType


def lively(count: int = 23, fps: str = "25/2", *, tracks: bool = True) -> Take:
    """Return a take with scales, weights of two shapes, and tracks, from frame 7.5."""
    take, t = small(count), np.arange(count)
    scales = 1 + 0.2 * np.sin(t[:, None, None] / 3 + np.arange(9).reshape(3, 3))
    scales[:, :2] = scales[:, :2, :1]
    weights = 0.5 + 0.4 * np.cos(t[:, None, None] / [[2.0], [5.0]])
    shapes = tuple(
        Shape(name, "face", np.full((2, 3), 0.1)) for name in ("smile_l", "smile_r")
    )
    motion = replace(
        take.motion,
        scales=Channel.from_dense(scales),
        weights=Channel.from_dense(weights),
    )
    clock = replace(
        take.clock, fps=Fraction(fps), start=Fraction(15, 2), step=Fraction(4, 5)
    )
    rig = replace(take.rig, shapes=shapes)
    take = replace(take, rig=rig, motion=motion, clock=clock)
    return with_tracks(take) if tracks else take


def shown(take: Take) -> dict[str, Any]:
    """Return all that a take holds."""
    motion = take.motion
    times = take.clock.times
    return {
        "dense": list(motion.dense()),
        "weights": None if motion.weights is None else motion.weights.dense(),
        "track_times": None
        if motion.track_times is None
        else motion.track_times.dense(),
        "tracks": [track.at(times) for track in take.tracks],
        "names": take.rig.names,
        "clock": take.clock,
        "notices": [f"{one.code} {one.message}" for one in take.notices],
    }


CURVE = ((7.5, 0.2), (12.0, 0.9), (20.0, 0.4))
PASSES: dict[str, Callable[[Take, Take], Take]] = {
    "loop": lambda take, _: loop(take, repeats=3, blend=6),
    "loop part": lambda take, _: loop(take, 9.9, 20.3, repeats=2, blend=3),
    "mirror": lambda take, _: mirror(take, "Z"),
    "mirror pairs": lambda take, _: mirror(take, "X", [("arm_l", "arm_r")]),
    "blend": lambda take, other: blend(take, other, weight=CURVE, delay=3.3),
    "blend even": lambda take, other: blend(take, other, weight=0.3, delay=-2.0),
    "difference": difference,
    "difference frame": lambda take, other: difference(take, other, 9.9),
    "layer": lambda take, other: layer(
        take, other, weight=CURVE, joints="arm*", interpolation="smooth", delay=1.5
    ),
    "layer additive": lambda take, other: layer(
        take, difference(other), mode="additive", weight=1.4, children=True
    ),
    "time scale": lambda take, _: time_scale(take, 0.7, 10.7),
    "time back": lambda take, _: time_scale(take, -1.3),
    "time warp": lambda take, _: time_warp(
        take, [(5, 9), (12, 20.3), (22, 8)], "smooth"
    ),
    "trim": lambda take, _: trim(take, 9.9, 15.5),
    "resample": lambda take, _: resampled(take, "23.976", smooth=True),
    "resample low": lambda take, _: resampled(take, 5, lowpass=True),
}


@pytest.mark.parametrize("name", PASSES)
def test_passes(name: str) -> None:
    take = lively()
    other = lively(17, "11", tracks=False)
    check_figures(__file__, name, shown(PASSES[name](take, other)))


OTHER = Path("other.bvh")
OPTIONS: list[tuple[str, dict[str, Any]]] = [
    ("blend", {"take": OTHER, "weight": CURVE, "delay": 3.3}),
    ("blend", {"take": OTHER, "weight": CURVE, "interpolation": "smooth"}),
    ("difference", {"base": OTHER}),
    ("difference", {"base": OTHER, "frame": 9.9}),
    ("layer", {"take": OTHER, "weight": CURVE, "interpolation": "smooth"}),
    ("layer", {"take": OTHER, "weight": 0.4, "joints": ("hips",), "delay": 2.1}),
    ("layer", {"take": OTHER, "mode": "additive", "joints": ("hips",),
               "children": True}),
    ("loop", {"first": 9.9, "last": 20.3, "repeats": 2, "blend": 4}),
    ("loop", {"find": True, "shortest": 0.4, "longest": 1.2}),
    ("mirror", {"axis": "Y", "pairs": (("arm_l", "arm_r"),)}),
    ("resample", {"fps": 9, "lowpass": True}),
    ("resample", {"fps": "30", "smooth": True}),
    ("root_motion", {"root": "way", "axes": "xz", "yaw": False}),
    ("root_motion", {"root": "hips", "mode": "recompose", "keep": True}),
    ("time_scale", {"speed": 0.6, "pivot": 11.0}),
    ("time_warp", {"curve": ((5, 9), (22, 20)), "interpolation": "smooth"}),
    ("trim", {"first": 9.9, "last": 15.5}),
]  # fmt: skip


@pytest.mark.parametrize("k", range(len(OPTIONS)))
def test_options_of_passes(k: int) -> None:
    name, options = OPTIONS[k]
    take = lively()
    if name == "root_motion":
        take = replace(take, motion=replace(take.motion, scales=None))
    other = lively(17, "11", tracks=False)
    own, context = find_pass(name), PassContext(lambda _: other, Path())
    stream = apply_pass(TakeStream.of(take), own, own.options(**options), context)
    made = shown(stream.collect())
    noted = [[one.code for one in notes] for notes in (stream.notices, context.notices)]
    check_figures(__file__, f"{k} {name}", {**made, "noted": noted})


@pytest.mark.parametrize(
    ("keys", "wrong"),
    [
        ({}, set()),
        ({"blend": 0, "repeats": 1, "first": 3.0, "last": 4.0}, set()),
        ({"blend": -1}, {"blend"}),
        ({"repeats": 0}, {"repeats"}),
        ({"first": 4.0, "last": 3.0}, {"last"}),
    ],
)
def test_least_options_of_loops(keys: dict[str, Any], wrong: set[str]) -> None:
    own = find_pass("loop")
    refused = set()
    for name, check in own.checks(own.options(**keys)).items():
        try:
            check()
        except OptionError:
            refused.add(name)
    assert refused == wrong


@pytest.mark.parametrize("axes", ["", "xyz", "z"])
def test_roots(axes: str) -> None:
    take = lively()
    motion = replace(take.motion, scales=None)
    take = replace(take, motion=motion)
    made = extract_root(take, axes=axes, yaw=axes != "z")
    back = recompose_root(made)
    check_figures(__file__, f"root {axes}", [shown(made), shown(back)])


def test_what_hangs() -> None:
    take = lively(9)
    free = replace(take.rig.joints[2], type=JointType.FREE)
    rig = replace(take.rig, joints=(*take.rig.joints[:2], free))
    ends = np.random.default_rng(2).normal(size=(9, 2, 3))
    motion = replace(take.motion, scales=None)
    take = replace(take, rig=rig, motion=motion)
    found = [shown(hang(take, "arm_r", ends, axis)) for axis in (None, (0.3, -1, 0.2))]
    check_figures(__file__, "hang", found)


def test_samples_that_are_left_out() -> None:
    take = lively(60)
    codes = take.clock.times + 0.1 * np.sin(np.arange(60))
    found = [
        thin_samples(take.rig, codes, take.motion, 0.3),
        thin_samples(
            take.rig, codes, take.motion, 0.5, joint_tolerances={"arm_*": 0.2}
        ),
    ]
    check_figures(__file__, "thin", found)


def test_cycles() -> None:
    take = swinging(gait(90, 27.3) + np.random.default_rng(2).normal(0, 0.01, (90, 2)))
    fast = swinging(gait(230, 71.0), fps=96)
    found = [
        find_cycle(take),
        find_cycle(take, 110, 180, shortest=1.0, longest=2.0),
        find_cycle(fast, longest=1.2),
        measure_cycle(take, 104, 140),
    ]
    check_figures(__file__, "cycles", found)
