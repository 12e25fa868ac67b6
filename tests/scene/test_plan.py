from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from support.bvh import random_rows, small_bvh

from animtool.edit.frame_range import FrameRange
from animtool.errors import AnimtoolError, OptionError
from animtool.scene.bake import run_bake
from animtool.scene.options import (
    BakeOptions,
    check_options,
    parse_frame_range,
    parse_offsets,
)
from animtool.scene.plan import plan_bake
from animtool.scene.sources import SourceOptions, open_source


@pytest.fixture
def take(tmp_path: Path) -> Path:
    path = tmp_path / "take.bvh"
    path.write_text(small_bvh(random_rows(6)))
    return path


def test_a_plan_writes_nothing_and_runs(take: Path, tmp_path: Path) -> None:
    output = tmp_path / "o.usda"
    plan = plan_bake(take, output)
    assert (plan.form, plan.fps, plan.start) == ("stage", 30, 1)
    assert not output.exists()
    report = run_bake(plan)
    assert output.exists()
    assert report.result.outputs == [output]
    assert report.seconds["total"] >= report.seconds["author"]


def test_a_plan_finds_what_is_wrong_before_the_rows(take: Path, tmp_path: Path) -> None:
    take.write_text(take.read_text() + "not a row\n")
    (tmp_path / "o.usda").write_text("mine")
    with pytest.raises(AnimtoolError) as caught:
        plan_bake(take, tmp_path / "o.usda")
    assert caught.value.code == "OUT001"
    plan_bake(take, tmp_path / "new.usda")


@pytest.mark.parametrize("name", ["take.usda", "other.usda"])
def test_what_a_scene_reads_is_not_replaced(
    take: Path, name: str, tmp_path: Path
) -> None:
    for stem in ("take", "other"):
        run_bake(plan_bake(take, tmp_path / f"{stem}.usda"))
    scene = tmp_path / "shot.scene.yaml"
    text = "scene: animtool/1\nsource: {file: take.usda}\n"
    scene.write_text(f"{text}passes:\n- blend: {{take: other.usda}}\n", "utf-8")
    with pytest.raises(OptionError) as caught:
        plan_bake(scene, tmp_path / name, BakeOptions(overwrite=True))
    assert caught.value.code == "OUT003"


def test_every_clash_of_options_is_said_at_once() -> None:
    options = BakeOptions(form="layer", bones=True, rest_frame=3)
    with pytest.raises(AnimtoolError) as caught:
        check_options(options, to_stdout=False)
    assert len(caught.value.faults) == 3


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("12", FrameRange(12, 12)),
        ("-10--1", FrameRange(-10, -1)),
        (" 1-9x3 ", FrameRange(1, 9, 3)),
    ],
)
def test_ranges(text: str, found: FrameRange) -> None:
    assert parse_frame_range(text) == found


@pytest.mark.parametrize("text", ["", "a-b", "1-", "1-2x0", "1-2-3", "1.5", "1e3"])
def test_what_is_no_range(text: str) -> None:
    with pytest.raises(ValueError, match=r"range|frame"):
        parse_frame_range(text)


def test_offsets_are_sorted_and_stay_within_a_frame() -> None:
    assert parse_offsets("0,1/4,-.25") == (Fraction(-1, 4), Fraction(0), Fraction(1, 4))
    for text in ("", "0,0", "-.5,.5", "2", "a"):
        with pytest.raises(ValueError, match="offset"):
            parse_offsets(text)


@pytest.mark.parametrize(
    ("name", "code"), [("none.bvh", "IO001"), ("none", "IO001"), ("take.txt", "IO002")]
)
def test_sources_that_are_none(take: Path, name: str, code: str) -> None:
    (take.parent / "take.txt").write_text("")
    with pytest.raises(AnimtoolError) as caught:
        open_source(take.parent / name)
    assert caught.value.code == code


def test_no_source_is_an_option_error(tmp_path: Path) -> None:
    with pytest.raises(AnimtoolError) as caught:
        plan_bake([], tmp_path / "o.usda")
    assert caught.value.code == "CLI002"


@pytest.mark.parametrize("record", [BakeOptions, SourceOptions])
def test_rates_are_taken_as_they_are_written(record: Any) -> None:
    for fps in (23.976, "23.976", "24000/1001", Fraction(24000, 1001)):
        assert record(fps=fps).fps == Fraction(24000, 1001)
    for fps in (0, Fraction(0), -24, "none", True, [24]):
        with pytest.raises(OptionError) as caught:
            record(fps=fps)
        assert caught.value.faults[0].code == "CLI006"
