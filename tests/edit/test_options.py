"""What of a pass need not be given, in scenes as in Python."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import pytest

from animtool.edit.layers import (
    BlendOptions,
    DifferenceOptions,
    LayerMode,
    LayerOptions,
    blend,
    difference,
    layer,
)
from animtool.edit.loop_options import LoopOptions
from animtool.edit.looping import loop
from animtool.edit.mirroring import Axis, MirrorOptions, mirror
from animtool.edit.resample import ResampleOptions, resampled
from animtool.edit.retiming import (
    TimeScaleOptions,
    TimeWarpOptions,
    TrimOptions,
    time_scale,
    time_warp,
    trim,
)
from animtool.edit.root_motion import RootMode, RootMotionOptions, extract_root
from animtool.edit.tree import HangOptions, hang
from animtool.motion.keyed import KeyInterpolation
from animtool.motion.passes import TakePart, find_pass


@pytest.mark.parametrize(
    ("options", "function"),
    [
        (BlendOptions(), blend),
        (DifferenceOptions(), difference),
        (LayerOptions(), layer),
        (LoopOptions(), loop),
        (MirrorOptions(), mirror),
        (ResampleOptions(), resampled),
        (RootMotionOptions(), extract_root),
        (TimeScaleOptions(), time_scale),
        (TimeWarpOptions(), time_warp),
        (TrimOptions(), trim),
        (HangOptions(), hang),
    ],
)
def test_scenes_and_python_leave_out_the_same(
    options: Any, function: Callable[..., Any]
) -> None:
    shared = {
        name: one.default
        for name, one in inspect.signature(function).parameters.items()
        if one.default is not inspect.Parameter.empty and hasattr(options, name)
    }
    assert shared or function in {hang}
    assert {name: getattr(options, name) for name in shared} == shared


def test_what_is_left_out_is() -> None:
    layered = LayerOptions()
    assert (layered.mode, layered.weight, layered.delay) == (LayerMode.OVERRIDE, 1, 0)
    assert (layered.joints, layered.children, layered.take) == ((), False, None)
    assert layered.interpolation is KeyInterpolation.LINEAR
    mixed = BlendOptions()
    assert (mixed.take, mixed.weight, mixed.delay) == (None, 0.5, 0)
    less = DifferenceOptions()
    assert (less.base, less.frame) == (None, None)
    cycle = LoopOptions()
    assert (cycle.first, cycle.last, cycle.find) == (None, None, False)
    assert (cycle.longest, cycle.repeats) == (10.0, 1)
    assert (MirrorOptions().axis, MirrorOptions().pairs) == (Axis.X, ())
    other = ResampleOptions()
    assert (other.fps, other.lowpass, other.smooth) == (None, False, False)
    root = RootMotionOptions()
    assert (root.mode, root.root, root.hips) == (RootMode.EXTRACT, "root", "")
    assert (root.axes, root.yaw, root.keep) == ("", True, False)
    assert (TimeScaleOptions().speed, TimeScaleOptions().pivot) == (1.0, None)
    warped = TimeWarpOptions()
    assert (warped.curve, warped.interpolation) == ((), KeyInterpolation.LINEAR)
    assert (TrimOptions().first, TrimOptions().last) == (None, None)
    hung = HangOptions()
    assert (hung.joint, hung.system, hung.particle, hung.axis) == ("", "", "end", None)


CLOCK, JOINTS, SHAPES = TakePart.CLOCK, TakePart.JOINTS, TakePart.SHAPES
CONTROLS, RIG = TakePart.CONTROLS, TakePart.RIG
MOVES = {JOINTS, SHAPES, CONTROLS}
TIMED = {*MOVES, CLOCK, TakePart.TRACKS, TakePart.POINTS}


@pytest.mark.parametrize(
    ("name", "reads", "changes"),
    [
        ("resample", TIMED, TIMED),
        ("time_scale", TIMED, TIMED),
        ("time_warp", TIMED, TIMED),
        ("trim", {CLOCK}, {CLOCK}),
        ("loop", set(TakePart), TIMED - {TakePart.POINTS}),
        ("blend", set(TakePart), MOVES),
        ("layer", set(TakePart), MOVES),
        ("difference", set(TakePart), MOVES),
        ("mirror", set(TakePart) - {CLOCK}, MOVES),
        ("root_motion", {CLOCK, JOINTS, RIG}, {JOINTS, RIG}),
        ("hang", {CLOCK, JOINTS, RIG}, {JOINTS}),
    ],
)
def test_passes_read_and_change_no_more_than_they_do(
    name: str, reads: set[TakePart], changes: set[TakePart]
) -> None:
    found = find_pass(name)
    assert (found.reads, found.changes) == (reads, changes)
