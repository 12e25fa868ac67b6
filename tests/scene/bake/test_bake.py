from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from support.bvh import random_rows, small_bvh

from animtool.core.errors import AnimtoolError, OptionError
from animtool.core.shot import Shot
from animtool.scene.bake.bake import run_stage
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.plan import output_start, plan_stage
from animtool.scene.bake.reading import check_options
from animtool.scene.sources.open import SourceOptions, open_source


@pytest.fixture
def take(tmp_path: Path) -> Path:
    path = tmp_path / "take.bvh"
    path.write_text(small_bvh(random_rows(6)))
    return path


def test_a_plan_writes_nothing_and_runs(take: Path, tmp_path: Path) -> None:
    output = tmp_path / "o.usda"
    plan = plan_stage(take, output)
    assert (plan.form, plan.fps, plan.start) == ("stage", 30, 1)
    assert not output.exists()
    report = run_stage(plan)
    assert output.exists()
    assert report.result.outputs == [output]
    assert report.seconds["total"] >= report.seconds["author"]


def test_a_plan_finds_what_is_wrong_before_the_rows(take: Path, tmp_path: Path) -> None:
    take.write_text(take.read_text() + "not a row\n")
    (tmp_path / "o.usda").write_text("mine")
    with pytest.raises(AnimtoolError) as caught:
        plan_stage(take, tmp_path / "o.usda")
    assert caught.value.code == "OUT001"
    plan_stage(take, tmp_path / "new.usda")


@pytest.mark.parametrize("name", ["take.usda", "other.usda"])
def test_what_a_scene_reads_is_not_replaced(
    take: Path, name: str, tmp_path: Path
) -> None:
    for stem in ("take", "other"):
        run_stage(plan_stage(take, tmp_path / f"{stem}.usda"))
    scene = tmp_path / "shot.scene.yaml"
    text = "scene: animtool/1\nsource: {file: take.usda}\n"
    scene.write_text(f"{text}passes:\n- blend: {{take: other.usda}}\n", "utf-8")
    with pytest.raises(OptionError) as caught:
        plan_stage(scene, tmp_path / name, BakeOptions(overwrite=True))
    assert caught.value.code == "OUT003"


def test_every_clash_of_options_is_said_at_once() -> None:
    options = BakeOptions(form="layer", bones=True, rest_frame=3)
    with pytest.raises(AnimtoolError) as caught:
        check_options(options, is_stdout=False)
    assert len(caught.value.faults) == 3


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
        plan_stage([], tmp_path / "o.usda")
    assert caught.value.code == "CLI002"


@pytest.mark.parametrize("record", [BakeOptions, SourceOptions])
def test_rates_are_taken_as_they_are_written(record: Any) -> None:
    for fps in (23.976, "23.976", "24000/1001", Fraction(24000, 1001)):
        assert record(fps=fps).fps == Fraction(24000, 1001)
    for fps in (0, Fraction(0), -24, "none", True, [24]):
        with pytest.raises(OptionError) as caught:
            record(fps=fps)
        assert caught.value.faults[0].code == "SCN022"


@pytest.mark.parametrize(
    ("asked", "rig", "source", "project", "start"),
    [
        (7, 5, 3, 1001, 7),
        (None, 5, 3, 1001, 5),
        (None, None, 3, 1001, 3),
        (None, None, None, 1001, 1001),
        (None, None, None, None, 1),
        (None, 0, 3, None, 0),
    ],
)
def test_the_first_frame_is_that_of_whoever_states_it_first(
    tmp_path: Path,
    asked: int | None,
    rig: int | None,
    source: int | None,
    project: int | None,
    start: int,
) -> None:
    """The option, the rig layer, the source, the project."""
    if project is not None:
        (tmp_path / "animtool.toml").write_text(f"start = {project}\n")

    def stated(frame: int | None) -> Any:
        first = Fraction(1 if frame is None else frame)
        start = None if frame is None else first
        return SimpleNamespace(start=start, first_frame=first)

    options = BakeOptions(start=stated(asked).start)
    found = output_start(options, stated(rig), stated(source), tmp_path / "a.bvh")
    assert found == start
    shot = Shot(1001, 1010, fps=Fraction(24), media_in=Fraction(0))
    placed = output_start(
        BakeOptions(shot=shot), stated(rig), stated(source), tmp_path / "a.bvh"
    )
    assert placed == (1 if source is None else source)
