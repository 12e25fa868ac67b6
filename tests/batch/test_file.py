"""Batch files: what they ask for, and every fault with its place."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import pytest
from support.batch import take_files

from animtool.batch.discover import find_batch
from animtool.batch.file import load_batch
from animtool.batch.spec import Limits, parse_bytes, parse_seconds
from animtool.core.errors import FormatError, OptionError
from animtool.core.units import LengthUnit, UpAxis
from animtool.validation.run import validate

HEAD = "batch: animtool/1\ninputs: [takes]\n"


def written(folder: Path, text: str) -> Path:
    path = folder / "night.batch.yaml"
    path.write_text(HEAD + text, "utf-8")
    return path


def test_what_it_asks_for(tmp_path: Path) -> None:
    (tmp_path / "hero.rig.yaml").touch()
    text = (
        "exclude: [takes/old]\n"
        "options: {rig: hero.rig.yaml, units: m, up: Z, source_fps: 23.976, fps: 24,\n"
        "  range: [1, 9], start: 1001.5, to_units: cm, to_up: Y, strict: true,\n"
        "  reduce: 1mm, reduce_at: {hand: 0.1mm}, prim_path: /World/hero}\n"
        "output: out/{stem}.usdc\n"
        "limits: {seconds: 2.5, memory: 1.5GB}\n"
        "jobs: 3\n"
    )
    spec = load_batch(written(tmp_path, text))
    assert (spec.name, spec.folder) == ("night", tmp_path)
    assert (spec.inputs, spec.exclude) == (("takes",), ("takes/old",))
    assert (spec.output, spec.jobs) == ("out/{stem}.usdc", 3)
    assert spec.limits == Limits(2.5, 1_500_000_000)
    options = spec.options
    assert options.source.rig == (tmp_path / "hero.rig.yaml").resolve()
    assert (options.source.unit, options.source.up) == (LengthUnit.M, UpAxis.Z)
    assert options.source.fps == Fraction(24000, 1001)
    assert (options.fps, options.start) == (24, Fraction(2003, 2))
    assert (options.to_units, options.to_up) == (LengthUnit.CM, UpAxis.Y)
    assert (options.reduce, options.reduce_at) == (0.001, (("hand", 0.0001),))
    assert options.strict
    assert load_batch(written(tmp_path, "jobs: auto\n")).jobs is None


@pytest.mark.parametrize(
    ("text", "code", "where"),
    [
        ("scene: a.scene.yaml\noptions: {}\n", "BAT001", "options"),
        ("options: {fps: fast}\n", "SCN022", "options.fps"),
        ("options: {range: [9, 1]}\n", "BAT002", "options.range"),
        ("options: {reduce: 1}\n", "DOC022", "options.reduce"),
        ("options: {reduce: one}\n", "BAT002", "options.reduce"),
        ("options: {reduce_at: {hand: 1}}\n", "DOC022", "options.reduce_at.hand"),
        ("options: {reduce_at: {hand: one}}\n", "BAT002", "options.reduce_at.hand"),
        ("limits: {memory: lots}\n", "BAT002", "limits.memory"),
        ("limits: {memory: 0GB}\n", "BAT002", "limits.memory"),
        ("limits: {seconds: 0}\n", "DOC022", "limits.seconds"),
        ("variables: {1st: a}\n", "BAT002", "variables.1st"),
        ("scene: none.scene.yaml\n", "DOC015", "scene"),
        ("scene: ../../a.scene.yaml\n", "DOC014", "scene"),
        ("options: {rig_layer: none.usda}\n", "DOC015", "options.rig_layer"),
        ("output: '{stm}.usdc'\n", "BAT004", "output"),
        ("output: '{stem:3}.usdc'\n", "BAT004", "output"),
        ("output: '{}.usdc'\n", "BAT004", "output"),
        ("output: '{stem.usdc'\n", "BAT004", "output"),
        ("jobs: 0\n", "DOC022", "jobs"),
        ("job: 2\n", "DOC020", "job"),
    ],
)
def test_faults(tmp_path: Path, text: str, code: str, where: str) -> None:
    (tmp_path / "a.scene.yaml").touch()
    with pytest.raises(FormatError) as error:
        load_batch(written(tmp_path, text))
    assert (code, where) in [(f.code, f.where) for f in error.value.faults]
    assert all(fault.lines and fault.column for fault in error.value.faults)


def test_all_faults_come_at_once(tmp_path: Path) -> None:
    text = "scene: none.scene.yaml\nlimits: {memory: lots}\noutput: '{stm}'\n"
    with pytest.raises(FormatError) as error:
        load_batch(written(tmp_path, text))
    assert [f.code for f in error.value.faults] == ["DOC015", "BAT002", "BAT004"]


@pytest.mark.parametrize("inputs", ["input: ['*.bvh']", "inputs: '*.bvh'"])
def test_faulty_inputs_are_not_missing_too(tmp_path: Path, inputs: str) -> None:
    path = written(tmp_path, f"output: o/\n{inputs}\n")
    with pytest.raises(FormatError) as caught:
        load_batch(path)
    assert len(caught.value.faults) == 1
    assert caught.value.code != "DOC021"


def test_a_batch_is_no_scene(tmp_path: Path) -> None:
    path = tmp_path / "a.batch.yaml"
    path.write_text("scene: animtool/1\nsource: {file: a.bvh}\n", "utf-8")
    with pytest.raises(FormatError) as error:
        load_batch(path)
    assert error.value.code == "DOC009"


@pytest.mark.parametrize("text", ["inf", "nan", "1e300", "0", "-1", "", "a", "9" * 99])
def test_what_is_no_time(text: str) -> None:
    with pytest.raises(ValueError, match="is not a number of seconds above 0"):
        parse_seconds(text)


@pytest.mark.parametrize("number", [0.5, 1e9])
def test_a_time_as_long_as_one_may_ask_for(number: float) -> None:
    assert parse_seconds(f"{number:g}") == number


def test_a_size_may_have_spaces_about_it() -> None:
    assert parse_bytes(" 2 GB ") == 2 * 10**9


LARGE = ["9" * 400 + "TB", "9999999999999GB"]


@pytest.mark.parametrize(
    "text", ["", "2", "2 gigs", "-1GB", "1.GB", "GB", "nanGB", "0.1B", *LARGE]
)
def test_what_is_no_size(text: str) -> None:
    with pytest.raises(ValueError, match="is not a size such as 2GB or 512MiB"):
        parse_bytes(text)


def test_one_output_of_several_inputs_is_found_by_validate(tmp_path: Path) -> None:
    take_files(tmp_path / "takes", 3)
    path = tmp_path / "b.batch.yaml"
    for output, found in (
        ("out/one.usdc", [("OUT007", (3,))]),
        ("out/{stem}.usdc", []),
        ("out/", []),
    ):
        path.write_text(f"batch: animtool/1\ninputs: [takes]\noutput: '{output}'\n")
        report = validate([path])
        assert [(f.code, f.lines) for f in report] == found
        if found:
            with pytest.raises(OptionError) as refused:
                find_batch(load_batch(path))
            assert [fault.code for fault in refused.value.faults] == ["OUT007"]


def test_the_hint_on_one_output_fits_the_inputs(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        take_files(tmp_path / f"takes/{folder}", 1)
    path = tmp_path / "b.batch.yaml"
    head = "batch: animtool/1\ninputs: [takes]\noutput: out/one.usdc\n"
    path.write_text(head)
    (fault,) = validate([path])
    assert (fault.code, fault.lines) == ("OUT007", (3,))
    assert "one_{parent}_{stem}.usdc" in str(fault.hint)
    # Variants of an input are told apart by another name.
    path.write_text(f"{head}variants: speeds.csv\n")
    (tmp_path / "speeds.csv").write_text("speed\n1\n2\n")
    assert "OUT007" not in [fault.code for fault in validate([path])]
