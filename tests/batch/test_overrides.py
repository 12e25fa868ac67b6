"""Variables of a batch that some of its inputs have values of their own for."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.batch import take_files
from support.cli import animtool

from animtool.batch.discover import find_batch
from animtool.batch.file import load_batch
from animtool.core.errors import FormatError, OptionError
from animtool.validation.run import validate

SCENE = (
    "scene: animtool/1\nsource: {file: ${input}}\n"
    "passes:\n- trim: {first: ${first}, last: ${last}}\n"
)
HEAD = (
    "batch: animtool/1\ninputs: [takes]\nscene: cut.scene.yaml\n"
    "variables: {first: '', last: 4}\noutput: 'out/{last}/{stem}.usdc'\noverrides:\n"
)


def batch_file(folder: Path, overrides: str) -> Path:
    """Return a batch of four takes of four frames each."""
    take_files(folder / "takes", 4)
    (folder / "cut.scene.yaml").write_text(SCENE, "utf-8")
    path = folder / "cut.batch.yaml"
    path.write_text(HEAD + overrides, "utf-8")
    return path


@pytest.mark.slow
def test_the_last_override_counts_and_the_command_line_before_it(
    tmp_path: Path,
) -> None:
    path = batch_file(
        tmp_path,
        "- {inputs: ['takes/*[12].bvh'], variables: {first: 2, last: 3}}\n"
        "- {inputs: [takes/take002.bvh], variables: {first: 3}}\n",
    )
    done = animtool("batch", path, "-j", "2", "--format", "json")
    assert done.code == 0, done.stderr
    found = json.loads(done.stdout)["items"]
    # Frames that trim leaves, first to last.
    assert [item["samples"] for item in found] == [4, 2, 1, 4]
    assert [item.get("variables") for item in found] == [
        None, {"first": "2", "last": "3"}, {"first": "3", "last": "3"}, None
    ]  # fmt: skip
    assert (tmp_path / "out/3/take002.usdc").exists()
    again = animtool("batch", path, "-n")
    assert [line.split()[0] for line in again.stdout.splitlines()] == ["skip"] * 4
    set_ = animtool("batch", path, "-n", "--set", "first=1", "--format", "json")
    planned = json.loads(set_.stdout)["items"]
    assert [item.get("variables") for item in planned] == [
        None, {"last": "3"}, {"last": "3"}, None
    ]  # fmt: skip
    assert [item["reason"] for item in planned] == ["options changed"] * 4


def test_names_that_have_another_meaning_are_refused(tmp_path: Path) -> None:
    path = batch_file(
        tmp_path,
        "- {inputs: [takes], variables: {first: 2, stem: x}}\n"
        "- {inputs: [takes], variables: {2nd: 1}}\n",
    )
    with pytest.raises(FormatError) as caught:
        load_batch(path)
    assert [(f.code, f.where, f.lines) for f in caught.value.faults] == [
        ("BAT063", "overrides[0].variables.stem", (7,)),
        ("BAT002", "overrides[1].variables.2nd", (8,)),
    ]
    assert caught.value.faults[1].message == "'2nd' is not a valid variable name"
    path.write_text(HEAD + "- {inputs: [takes], variables: {frist: 2}}\n", "utf-8")
    with pytest.raises(OptionError) as unused:
        find_batch(load_batch(path))
    (fault,) = unused.value.faults
    assert (fault.code, fault.where, fault.lines) == (
        ("SCN031", "overrides[0].variables.frist", (7,))
    )
    (finding,) = validate([path])
    assert (finding.code, finding.where) == ("SCN031", fault.where)


def test_an_override_for_no_input_is_named(tmp_path: Path) -> None:
    path = batch_file(tmp_path, "- {inputs: ['take/*'], variables: {first: 2}}\n")
    (notice,) = find_batch(load_batch(path)).notices
    assert (notice.code, notice.where) == ("BAT066", "overrides[0].inputs")
