"""Outputs that clash, are inputs, or are somebody else's."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.batch import take_files

from animtool.batch.discover import Batch, find_batch
from animtool.batch.plan import check_output_files, check_overwrites
from animtool.batch.spec import BatchSpec
from animtool.core.errors import AnimtoolError, OptionError, OutputError
from animtool.scene.bake.options import BakeOptions


def batch(folder: Path, output: str | None, form: str | None = None) -> Batch:
    options = BakeOptions(form=form)
    return find_batch(BatchSpec(("takes",), folder, output=output, options=options))


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    take_files(tmp_path / "takes/a", 2)
    take_files(tmp_path / "takes/b", 2)
    return tmp_path


def refused(found: Batch) -> AnimtoolError:
    with pytest.raises(AnimtoolError) as error:
        check_output_files(found)
    return error.value


def test_outputs_of_one_name(takes: Path) -> None:
    error = refused(batch(takes, "out/{stem}.usdc"))
    assert isinstance(error, OptionError)
    assert [fault.code for fault in error.faults] == ["OUT007", "OUT007"]
    assert "a/take000.bvh and" in error.faults[0].message
    check_output_files(batch(takes, "out/{parent}/{stem}.usdc"))


def test_names_that_differ_by_capital_letters(takes: Path) -> None:
    text = (takes / "takes/a/take000.bvh").read_text()
    (takes / "takes/a/TAKE000.bvh").write_text(text)
    error = refused(batch(takes, "out/{parent}/{stem}.usdc"))
    assert [fault.code for fault in error.faults] == ["OUT007"]


def test_a_folder_by_two_names(takes: Path) -> None:
    (takes / "out").mkdir()
    (takes / "out/a").mkdir()
    (takes / "out/b").symlink_to("a")
    assert refused(batch(takes, "out/{parent}/{stem}.usdc")).code == "OUT007"


def test_files_props_an_output_count(takes: Path) -> None:
    (takes / "takes/a/x.rig.bvh").write_text(
        (takes / "takes/a/take000.bvh").read_text()
    )
    (takes / "takes/a/x.bvh").write_text((takes / "takes/a/take000.bvh").read_text())
    check_output_files(batch(takes, "out/{parent}/{stem}.usda"))
    assert refused(batch(takes, "out/{parent}/{stem}.usda", "split")).code == "OUT007"


def test_an_output_that_is_an_input(takes: Path) -> None:
    error = refused(batch(takes, "takes/{parent}/{name}"))
    assert [fault.code for fault in error.faults] == ["OUT003"] * 4


def test_a_folder_that_is_a_file(takes: Path) -> None:
    (takes / "out").touch()
    error = refused(batch(takes, "out/{parent}/{stem}.usdc"))
    assert isinstance(error, OutputError)
    assert [fault.code for fault in error.faults] == ["OUT002"]


def test_an_output_of_many_is_one_fault(tmp_path: Path) -> None:
    take_files(tmp_path / "takes", 9)
    [fault] = refused(batch(tmp_path, "out/one.usdc")).faults
    assert fault.code == "OUT007"
    assert "7 more" in fault.message
    assert "{stem}" in str(fault.hint)


def test_many_faults_are_cut(tmp_path: Path) -> None:
    for folder in "ab":
        take_files(tmp_path / "takes" / folder, 60)
    error = refused(batch(tmp_path, "out/{stem}.usdc"))
    assert len(error.faults) == 51
    assert error.faults[-1].code == "DOC011"


def test_files_that_nobody_here_made(takes: Path) -> None:
    found = batch(takes, "out/{parent}/{stem}.usdc")
    for item in found.items[:2]:
        item.output.parent.mkdir(parents=True, exist_ok=True)
        item.output.touch()
    with pytest.raises(OptionError) as error:
        check_overwrites(found, found.items, lambda path: path == found.items[0].output)
    assert [fault.path for fault in error.value.faults] == [str(found.items[1].output)]
    check_overwrites(found, found.items[2:], lambda _: False)
