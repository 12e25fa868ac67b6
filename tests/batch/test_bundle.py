"""Bundles of Open Job Description."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from support.batch import take_files, whole_outputs
from support.cli import animtool
from support.faults import raises

from animtool.batch import bundle
from animtool.batch.bundle import chunk_size, mean_item_seconds
from animtool.core.errors import FormatError

JOB = "batch: animtool/1\ninputs: [takes]\noutput: out/{stem}.usdc\n"


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    take_files(tmp_path / "takes", 5)
    (tmp_path / "a.batch.yaml").write_text(JOB)
    return tmp_path


@given(st.integers(1, 10**6), st.floats(1e-5, 1e5), st.floats(1e-3, 1e5))
def test_chunks_are_some_of_the_items(items: int, seconds: float, want: float) -> None:
    chunk = chunk_size(items, seconds, want)
    assert 1 <= chunk <= items
    if 1 < chunk < items:
        assert abs(chunk * seconds - want) <= seconds


def test_costs_are_those_of_a_report(takes: Path) -> None:
    (takes / "takes/take004.bvh").write_text("HIERARCHY\n")
    words = ("--executor", "serial", "--format", "json")
    done = animtool("batch", "a.batch.yaml", *words, cwd=takes)
    path = takes / "costs.json"
    path.write_text(done.stdout)
    made = json.loads(done.stdout)["items"][:4]
    assert mean_item_seconds(path) == sum(item["seconds"] for item in made) / 4


@pytest.mark.parametrize(
    "text",
    [
        *(None, "", "[]", '{"items": [{}]}', '{"items": []}', "[" * 100_000),
        *(
            f'{{"items": [{{"status": "done", "seconds": {seconds}}}]}}'
            for seconds in ("NaN", "Infinity", "-1", "true", '"1"', "1e999", "9" * 999)
        ),
    ],
)
def test_what_reports_no_costs(tmp_path: Path, text: str | None) -> None:
    path = tmp_path / "costs.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(FormatError) as error:
        mean_item_seconds(path)
    assert error.value.code == "BAT037"


def test_a_report_that_is_too_large_is_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bundle, "MAX_REPORT_BYTES", 1000)
    path = tmp_path / "costs.json"
    path.write_text('{"items": [' + " " * 1000 + "]}")
    with raises(FormatError, "BAT037", match=r"0\.001"):
        mean_item_seconds(path)


def test_a_bundle(takes: Path) -> None:
    words = ("a.batch.yaml", "-o", "a.job", "--chunk", 2)
    done = animtool("job", *words, "--format", "json", cwd=takes)
    assert done.code == 0, done.stderr
    report = json.loads(done.stdout)
    assert (report["items"], report["chunk"], report["tasks"]) == (5, 2, 3)
    values = yaml.safe_load((takes / "a.job/parameter_values.yaml").read_text())
    name = str(takes / "a.batch.yaml")
    assert values == {"parameterValues": [{"name": "BatchFile", "value": name}]}
    template = yaml.safe_load((takes / "a.job/template.yaml").read_text())
    assert [step["name"] for step in template["steps"]] == ["Bake", "Settle"]
    assert animtool("job", *words, cwd=takes).code == 2
    again = animtool("job", *words, "--overwrite", cwd=takes)
    assert "5 items, 2 a task, 3 tasks" in again.stderr


def test_chunks_by_costs(takes: Path) -> None:
    item = {"status": "done", "seconds": 60}
    (takes / "costs.json").write_text(json.dumps({"items": [item]}))
    words = ("a.batch.yaml", "-o", "a.job", "--costs", "costs.json")
    done = animtool("job", *words, "--format", "json", cwd=takes)
    assert json.loads(done.stdout)["chunk"] == 2
    more = ("--task-seconds", 180, "--overwrite", "--format", "json")
    assert json.loads(animtool("job", *words, *more, cwd=takes).stdout)["chunk"] == 3


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("takes/take000.bvh", "-o", "x"), 2, "batch file"),
        (("none.batch.yaml", "-o", "x"), 3, "IO001"),
        (("a.batch.yaml", "-o", "x", "--chunk", "0"), 2, "auto"),
        (("a.batch.yaml", "-o", "a.batch.yaml"), 2, "file"),
        (("a.batch.yaml", "-o", "job.yaml"), 2, "OUT004"),
        (("b.batch.yaml", "-o", "x"), 5, "BAT005"),
        (("c.batch.yaml", "-o", "x"), 2, "OUT007"),
    ],
)
def test_what_makes_no_job(
    takes: Path, words: tuple[str, ...], code: int, said: str
) -> None:
    (takes / "b.batch.yaml").write_text(JOB.replace("takes", "none*"))
    (takes / "c.batch.yaml").write_text(JOB.replace("{stem}", "one"))
    done = animtool("job", *words, cwd=takes)
    assert (done.code, said in done.stderr) == (code, True), done.stderr
    assert not (takes / "x/template.yaml").exists()


def openjd(*words: object) -> str:
    command = [sys.executable, "-m", "openjd", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def starter(path: Path, more: str = "") -> Path:
    """Make a command that starts animtool as it is here, with more options."""
    text = f'#!/bin/sh\nexec {sys.executable} -P -m animtool "$@" {more}\n'
    path.write_text(text)
    path.chmod(0o755)
    return path


@pytest.mark.slow
def test_openjd_runs_it_to_the_same_bytes(takes: Path, tmp_path: Path) -> None:
    pytest.importorskip("openjd.cli", reason="openjd-cli is not installed")
    animtool("job", "a.batch.yaml", "-o", "a.job", "--chunk", 3, cwd=takes)
    template = takes / "a.job/template.yaml"
    assert "passes" in openjd("check", template)
    # The farm has the folder elsewhere.
    rule = {
        "source_path_format": "POSIX",
        "source_path": "/show",
        "destination_path": takes.as_posix(),
    }
    rules = {"version": "pathmapping-1.0", "path_mapping_rules": [rule]}
    command = starter(tmp_path / "start")
    values = ["-p", "BatchFile=/show/a.batch.yaml", "-p", f"Command={command}"]
    words = ["--step", "Settle", "--run-dependencies", *values, "-p", "Jobs=1"]
    said = openjd("run", template, *words, "--path-mapping-rules", json.dumps(rules))
    assert said.count("openjd_progress: 100.0") == 3
    assert "5 of 5 are up to date" in said
    made = whole_outputs(takes / "out")
    words = ["-o", "alone/{stem}.usdc", "--executor", "serial"]
    assert animtool("batch", "takes", *words, cwd=takes).code == 0
    assert made == whole_outputs(takes / "alone")


# A job has no need of other processes to run once more.
SERIAL = "--executor serial"
CUT_JOB = """
batch: animtool/1
inputs: [takes]
scene: shot.scene.yaml
cut: edit.otio
handles: 2
output: out/{shot}.usda
"""
CUT_SCENE = """
scene: animtool/1
variables: {begin: 1, end: 4}
source: {file: "${input}"}
passes:
- trim:
    first: ${begin}
    last: ${end}
output:
  file: named/${shot}.usda
"""


@pytest.fixture
def edit(tmp_path: Path) -> Path:
    """Return a folder with a timeline of three shots of two takes."""
    pytest.importorskip("opentimelineio", reason="no OpenTimelineIO (extra: otio)")
    from support.timelines import clip, timeline

    first, second = take_files(tmp_path / "takes", 2, frames=40)
    clips = [
        clip(name, f"takes/{path.name}", (10 * i + 4, 4), (0, 40))
        for i, (name, path) in enumerate(
            zip("abc", (first, first, second), strict=True)
        )
    ]
    timeline(tmp_path / "edit.otio", *clips)
    (tmp_path / "shot.scene.yaml").write_text(CUT_SCENE)
    (tmp_path / "shots.batch.yaml").write_text(CUT_JOB)
    lines = CUT_JOB.replace("cut: edit.otio\nhandles: 2\n", "").splitlines()
    plain = "\n".join(line for line in lines if not line.startswith("output"))
    (tmp_path / "plain.batch.yaml").write_text(f"{plain}\n")
    return tmp_path


def test_a_batch_file_has_a_cut_list(edit: Path) -> None:
    done = animtool("batch", "shots.batch.yaml", "--executor", "serial", cwd=edit)
    assert done.code == 0, done.stderr
    assert set(whole_outputs(edit / "out")) == {"a.usda", "b.usda", "c.usda"}
    done = animtool("job", "shots.batch.yaml", "-o", "j", "--chunk", 2, cwd=edit)
    assert "3 items, 2 a task, 2 tasks" in done.stderr


def test_handles_of_the_command_line_go_into_the_job(edit: Path) -> None:
    words = ("shots.batch.yaml", "-o", "j", "--handles", 4, "--cut-start", 51)
    assert animtool("job", *words, cwd=edit).code == 0
    template = yaml.safe_load((edit / "j/template.yaml").read_text())
    for step in template["steps"]:
        args = step["script"]["actions"]["onRun"]["args"]
        assert args[args.index("--handles") + 1] == "4"
        assert args[args.index("--cut-start") + 1] == "51"
        assert "--cut" not in args


def test_the_output_of_a_batch_file_may_name_shots_of_the_command_line(
    edit: Path,
) -> None:
    text = CUT_JOB.replace("cut: edit.otio\nhandles: 2\n", "")
    (edit / "open.batch.yaml").write_text(text)
    words = ("open.batch.yaml", "--cut", "edit.otio")
    done = animtool("batch", *words, "-n", cwd=edit)
    assert "make out/b.usda (new)" in done.stdout + done.stderr
    assert animtool("job", *words, "-o", "j", cwd=edit).code == 0
    assert "BAT004" in animtool("batch", "open.batch.yaml", cwd=edit).stderr


@pytest.mark.slow
def test_a_job_of_a_cut_list_runs_to_the_same_bytes(edit: Path, tmp_path: Path) -> None:
    pytest.importorskip("openjd.cli", reason="openjd-cli is not installed")
    cut = ("plain.batch.yaml", "--cut", "edit.otio", "--handles", 2)
    done = animtool("job", *cut, "-o", "a.job", "--chunk", 2, cwd=edit)
    assert "3 items, 2 a task, 2 tasks" in done.stderr
    values = yaml.safe_load((edit / "a.job/parameter_values.yaml").read_text())
    assert values["parameterValues"][1] == {
        "name": "CutList",
        "value": str(edit / "edit.otio"),
    }
    command = starter(tmp_path / "start", SERIAL)
    given = [f"{entry['name']}={entry['value']}" for entry in values["parameterValues"]]
    words = [word for value in (*given, "Jobs=1", f"Command={command}")
             for word in ("-p", value)]  # fmt: skip
    template = edit / "a.job/template.yaml"
    said = openjd("run", template, "--step", "Settle", "--run-dependencies", *words)
    assert "3 of 3 are up to date" in said
    made = whole_outputs(edit / "named")
    assert set(made) == {"a.usda", "b.usda", "c.usda"}
    again = animtool("batch", *cut, "--executor", "serial", "--force", cwd=edit)
    assert again.code == 0, again.stderr
    assert whole_outputs(edit / "named") == made


@pytest.mark.slow
def test_a_job_of_shots_alone_is_the_batch_of_them(edit: Path, tmp_path: Path) -> None:
    """A timeline among the inputs, and no scene."""
    pytest.importorskip("openjd.cli", reason="openjd-cli is not installed")
    lines = "batch: animtool/1\ninputs: [edit.otio]\nhandles: 8\n"
    (edit / "own.batch.yaml").write_text(lines + 'output: "own/{shot}.usdc"\n')
    done = animtool("job", "own.batch.yaml", "-o", "a.job", "--chunk", 2, cwd=edit)
    assert "3 items, 2 a task, 2 tasks" in done.stderr
    values = ["-p", f"BatchFile={edit / 'own.batch.yaml'}", "-p", "Jobs=1"]
    values += ["-p", f"Command={starter(tmp_path / 'start', SERIAL)}"]
    words = ["--step", "Settle", "--run-dependencies", *values]
    assert "3 of 3 are up to date" in openjd(
        "run", edit / "a.job/template.yaml", *words
    )
    alone = ["edit.otio", "--handles", 8, "-o", "alone/{shot}.usdc"]
    done = animtool("batch", *alone, "--executor", "serial", cwd=edit)
    assert done.code == 0, done.stderr
    made = whole_outputs(edit / "own")
    assert set(made) == {"a.usdc", "b.usdc", "c.usdc"}
    assert made == whole_outputs(edit / "alone")
