"""Options of a bake: put together, and what excludes each other."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from support.faults import raises

from animtool.cli.bake import bake
from animtool.cli.console import FlagNamer
from animtool.core.errors import OptionError
from animtool.core.rates import FractionLike
from animtool.core.shot import FrameRange, Shot
from animtool.core.units import LengthUnit, UpAxis
from animtool.scene.bake.options import BakeOptions, with_fallbacks
from animtool.scene.bake.reading import check_options

RIG = Path("rig.usda")


@pytest.mark.parametrize(
    ("given", "word"),
    [
        ({"form": "layer"}, "needs --rig-layer"),
        ({"rig_layer": RIG, "form": "stage"}, "needs --as layer"),
        ({"rig_layer": RIG, "bones": True}, "--bones"),
        ({"rig_layer": RIG, "rest_frame": 3}, "--rest"),
        ({"rig_layer": RIG, "to_units": LengthUnit.M}, "--to-units"),
        ({"rig_layer": RIG, "to_up": UpAxis.Z}, "--to-up"),
        ({"form": "library", "deform": True}, "cannot use --deform"),
        ({"form": "library", "bones": True}, "cannot use --bones"),
        ({"form": "library", "rest_frame": 3}, "cannot use --rest"),
        ({"form": "library", "to_units": LengthUnit.M}, "cannot use --to-units"),
        ({"form": "library", "to_up": UpAxis.Z}, "cannot use --to-up"),
        ({"keep_samples": True, "samples": (Fraction(0),)}, "--samples exclude"),
        ({"reduce": 0.1, "samples": (Fraction(0),)}, "--reduce and --samples"),
        ({"reduce": 0.1, "root_motion": True}, "remove --root-motion"),
        ({"reduce_at": (("a", 0.1),)}, "needs --reduce"),
        ({"chunk": 3}, "needs --deform"),
        ({"chunk": 0, "deform": True}, "needs at least 1 sample per file, not"),
        ({"velocities": True}, "--velocities needs --deform"),
        ({"normals": False}, "--no-normals needs --deform"),
        ({"deform": True, "form": "split"}, "no --split"),
        ({"deform": True, "bones": True}, "no --bones"),
        ({"deform": True, "sparse": True}, "no --sparse"),
        ({"deform": True, "reduce": 0.1}, "no --reduce"),
        ({"deform": True, "root_motion": True}, "no --root-motion"),
        ({"deform": True, "keep_curves": True}, "no --keep-curves"),
        ({"deform": True, "rest_frame": 3}, "no --rest"),
    ],
)
def test_what_excludes_each_other(given: dict[str, Any], word: str) -> None:
    with pytest.raises(OptionError) as caught:
        check_options(BakeOptions(**given), is_stdout=False)
    told = [fault.with_argument_names(FlagNamer(bake)) for fault in caught.value.faults]
    assert any(word in fault.message for fault in told)
    assert {fault.code for fault in caught.value.faults} == {"CLI002"}
    assert "--" not in str(caught.value)


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"rig_layer": RIG, "sparse": True, "root_motion": True},
        {"deform": True, "velocities": True, "normals": False, "chunk": 1},
        {"reduce": 0.1, "reduce_at": (("a", 0.1),), "keep_samples": True},
        {"form": "split", "bones": True, "rest_frame": 3, "to_up": UpAxis.Z},
    ],
)
def test_what_goes_together(given: dict[str, Any]) -> None:
    check_options(BakeOptions(**given), is_stdout=False)


@pytest.mark.parametrize(
    "given", [{"form": "split"}, {"form": "library"}, {"deform": True, "chunk": 3}]
)
def test_what_stdout_cannot_hold(given: dict[str, Any]) -> None:
    check_options(BakeOptions(**given), is_stdout=False)
    with raises(OptionError, "CLI002"):
        check_options(BakeOptions(**given), is_stdout=True)


def test_options_come_before_those_of_an_output() -> None:
    own = BakeOptions(fps=Fraction(30), sparse=True, reduce=0.1)
    others = BakeOptions(fps=Fraction(24), bones=True, reduce=0.2, prim_path="/a")
    found = with_fallbacks(own, others)
    assert (found.fps, found.reduce, found.sparse) == (30, 0.1, True)
    assert (found.bones, found.prim_path) == (True, "/a")


def test_a_shot_gives_its_frames_and_rate_where_none_are_stated() -> None:
    shot = Shot(1009, 1020, 8, 4, fps=Fraction(25))
    found = BakeOptions(shot=shot)
    assert (found.frame_range, found.fps) == (FrameRange(1001, 1024), 25)
    stated = BakeOptions(
        shot=shot, frame_range=FrameRange(1010, 1012), fps=Fraction(50)
    )
    assert (stated.frame_range, stated.fps) == (FrameRange(1010, 1012), 50)


@pytest.mark.parametrize("start", [1000.5, "1000.5", "2001/2", Fraction(2001, 2)])
def test_a_start_becomes_a_fraction(start: FractionLike) -> None:
    options = BakeOptions(start=start)
    assert (options.start, type(options.start)) == (Fraction(2001, 2), Fraction)
    assert BakeOptions(start=1001).start == Fraction(1001)


@pytest.mark.parametrize("start", ["first", float("nan"), float("inf"), True, 1e12])
def test_a_start_that_is_no_frame(start: FractionLike) -> None:
    with pytest.raises(OptionError) as caught:
        BakeOptions(start=start)
    assert caught.value.code == "SCN033"


@pytest.mark.parametrize("given", [(1, 40), [1, 40], (1, 40, 1), "1-40"])
def test_a_range_becomes_a_frame_range(given: Any) -> None:
    assert BakeOptions(frame_range=given).frame_range == FrameRange(1, 40)
    assert BakeOptions(frame_range=(1, 9, 2)).frame_range == FrameRange(1, 9, 2)


@pytest.mark.parametrize("given", [(1,), (5, 1), (1, 9, 0), (1.5, 2), 7, "x", (1, "b")])
def test_a_range_that_is_none(given: Any) -> None:
    with pytest.raises(OptionError) as caught:
        BakeOptions(frame_range=given)
    assert caught.value.code == "SCN003"
