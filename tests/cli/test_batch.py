"""``animtool batch`` as people and programs use it."""

from __future__ import annotations

import contextlib
import io
import json
import os
import shlex
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from support.batch import take_files, whole_outputs
from support.cli import animtool

OUT = ("-o", "out/{stem}.usdc", "--executor", "serial")


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    take_files(tmp_path / "takes", 3)
    return tmp_path


def test_lines_and_a_summary(takes: Path) -> None:
    done = animtool("batch", "takes", *OUT, cwd=takes)
    assert (done.code, done.stdout) == (0, "")
    lines = done.stderr.splitlines()
    assert lines[0].startswith("[1/3] done out/take000.usdc (new) ")
    assert lines[3].startswith("3 items: 3 done in ")
    assert lines[4] == "  why: 3 new"
    again = animtool("batch", "takes", *OUT, cwd=takes)
    assert again.stderr.splitlines()[0] == "3 of 3 are up to date"


@pytest.mark.slow
def test_a_folder_that_holds_a_package_of_a_known_name(takes: Path) -> None:
    package = takes / "numpy"
    package.mkdir()
    (package / "__init__.py").write_text("raise SystemExit(1)\n", "utf-8")
    # As the installed command does it: Python itself is not told of the folder.
    start = "import sys; sys.path.pop(0); from animtool.__main__ import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", start, "batch", "takes", "-o", "out/{stem}.usdc"],
        capture_output=True,
        text=True,
        check=False,
        cwd=takes,
    )
    assert done.returncode == 0, done.stderr
    assert len(whole_outputs(takes / "out")) == 3


def test_a_dry_run(takes: Path) -> None:
    animtool("batch", "takes/take000.bvh", *OUT, cwd=takes)
    done = animtool("batch", "takes", *OUT, "-n", cwd=takes)
    assert done.stdout.splitlines() == [
        "skip out/take000.usdc (up to date)",
        "make out/take001.usdc (new)",
        "make out/take002.usdc (new)",
    ]
    assert "2 to build" in done.stderr
    assert done.code == 0


def test_failures_come_last_with_what_repeats_them(takes: Path) -> None:
    (takes / "takes/take001.bvh").write_text("HIERARCHY\n")
    options = ("--exclude", "takes/take 9.bvh", *OUT)
    done = animtool("batch", "takes", *options, cwd=takes)
    assert done.code == 1
    last = done.stderr.splitlines()[-1]
    again = shlex.split(last.partition("again: ")[2])
    assert again[-2:] == ["--items", "2"]
    failures = [line for line in done.stderr.splitlines() if "BVH005" in line]
    assert failures[-1].startswith("takes/take001.bvh:")
    (ended,) = [line for line in done.stderr.splitlines() if "] failed " in line]
    assert ended.partition("out/take001.usdc: ")[2].startswith("BVH005 the file ends")
    repeated = animtool(*again[1:], "--executor", "serial", cwd=takes)
    assert repeated.code == 1
    assert "1 item: 1 failed" in repeated.stderr
    (takes / "takes/take001.bvh").write_bytes(
        (takes / "takes/take000.bvh").read_bytes()
    )
    assert animtool(*again[1:], cwd=takes).code == 0


def test_a_list_on_stdin_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("a.bvh\n" + "\0" * 10**6))
    done = animtool("batch", "-", "-o", "{stem}.usdc")
    assert done.code == 3
    assert done.stderr.startswith(
        "-: IO001 cannot be read: line 2 has 1000000 characters"
    )


def test_a_list_on_stdin(takes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (takes / "takes/take002.bvh").write_text("HIERARCHY\n")
    listed = "takes/take000.bvh\n\ntakes/take002.bvh\n"
    monkeypatch.setattr("sys.stdin", io.StringIO(listed))
    done = animtool("batch", "-", *OUT, cwd=takes)
    assert done.code == 1
    again = shlex.split(done.stderr.splitlines()[-1].partition("again: ")[2])
    take_files(takes / "takes", 3)
    assert animtool(*again[1:], cwd=takes).code == 0
    assert set(whole_outputs(takes / "out")) == {"take000.usdc", "take002.usdc"}


def test_a_missing_file_of_a_list_has_its_line_and_nothing_repeats_it(
    takes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (takes / "takes/old").mkdir()
    (takes / "takes/take001.bvh").rename(takes / "takes/old/take001.bvh")
    listed = "takes/take000.bvh\n\ntakes/take001.bvh\n"
    monkeypatch.setattr("sys.stdin", io.StringIO(listed))
    done = animtool("batch", "-", *OUT, cwd=takes)
    assert done.code == 1
    lines = done.stderr.splitlines()
    (warning,) = (line for line in lines if "BAT067" in line)
    assert "BAT067 line 3 of stdin: 'takes/take001.bvh'" in warning
    assert warning.endswith("did you mean 'takes/old/take001.bvh'?")
    assert lines[-1].endswith("did you mean 'takes/old/take001.bvh'?")
    done = animtool("batch", "takes/take001.bvh", *OUT, "--format", "json", cwd=takes)
    (item,) = json.loads(done.stdout)["items"]
    assert (item["status"], item.get("again")) == ("failed", None)
    assert "BAT067 'takes/take001.bvh'" in done.stderr


def test_reports_for_programs(takes: Path) -> None:
    (takes / "takes/take001.bvh").write_text("HIERARCHY\n")
    lines = animtool(
        "batch", "takes", *OUT, "--format", "jsonl", "--junit", "r.xml", cwd=takes
    )
    found = [json.loads(line) for line in lines.stdout.splitlines()]
    assert [entry.get("status") for entry in found] == ["done", "failed", "done", None]
    assert (found[-1]["batch"], found[-1]["failed"]) == ("animtool/1", 1)
    assert len(ElementTree.parse(takes / "r.xml").findall(".//testcase")) == 3
    whole = animtool("batch", "takes", *OUT, "--format", "json", cwd=takes)
    report = json.loads(whole.stdout)
    assert [entry["status"] for entry in report["items"]] == [
        "skipped",
        "failed",
        "skipped",
    ]
    assert report["items"][1]["again"].endswith("--items 2")
    dry = animtool("batch", "takes", *OUT, "-n", "--format", "jsonl", cwd=takes)
    assert len(dry.stdout.splitlines()) == 4


def test_warnings_and_strict(takes: Path) -> None:
    path = takes / "takes/take001.bvh"
    path.write_text(path.read_text().replace("Frames: 4", "Frames: 5"))
    done = animtool("batch", "takes", *OUT, cwd=takes)
    assert done.code == 0, done.stderr
    assert "  warnings: from 1 item" in done.stderr.splitlines()
    assert "warning: BVH1" in done.stderr
    strict = animtool("batch", "takes", *OUT, "--strict", cwd=takes)
    assert strict.code == 1
    assert "2 done, 1 failed" in strict.stderr


def test_the_command_line_comes_before_the_file(takes: Path) -> None:
    folder = takes / "jobs"
    folder.mkdir()
    (folder / "a.batch.yaml").write_text(
        "batch: animtool/1\ninputs: [../takes]\noutput: out/{stem}.usdc\n"
        "exclude: [../takes/take000.bvh]\nlimits: {seconds: 600}\n"
    )
    done = animtool("batch", "jobs/a.batch.yaml", "-j", 1, cwd=takes)
    assert done.code == 0, done.stderr
    assert set(whole_outputs(folder / "out")) == {"take001.usdc", "take002.usdc"}
    options = ("-o", "here/{name}.usda", "--exclude", "takes/take001.bvh")
    done = animtool("batch", "jobs/a.batch.yaml", *options, "-j", 1, cwd=takes)
    assert done.code == 0, done.stderr
    assert set(whole_outputs(takes / "here")) == {"take002.bvh.usda"}


def test_a_scene_for_all(takes: Path) -> None:
    (takes / "cut.scene.yaml").write_text(
        "scene: animtool/1\nvariables: {last: 4}\nsource:\n  file: ${input}\n"
        "passes:\n- trim:\n    last: ${last}\n"
    )
    options = ("--scene", "cut.scene.yaml", "--set", "last=2", *OUT)
    done = animtool("batch", "takes", *options, "--format", "json", cwd=takes)
    assert done.code == 0, done.stderr
    report = json.loads(done.stdout)
    assert {entry["samples"] for entry in report["items"]} == {2}


def test_variables_of_the_command_line_come_before_those_of_files(takes: Path) -> None:
    """Those of the batch file come before those of its scene; the last one counts."""
    (takes / "cut.scene.yaml").write_text(
        "scene: animtool/1\nvariables: {first: 1, last: 2, end: a}\n"
        "source:\n  file: ${input}\n"
        'output: {file: "${stem}_${first}${last}${end}.usda"}\n'
    )
    (takes / "a.batch.yaml").write_text(
        "batch: animtool/1\ninputs: [takes/take000.bvh]\nscene: cut.scene.yaml\n"
        'variables: {last: "3", end: b}\n'
    )
    given = ("--set", "end=c", "--set", "end=d")
    done = animtool(
        "batch", "a.batch.yaml", *given, "-n", "--format", "json", cwd=takes
    )
    (item,) = json.loads(done.stdout)["items"]
    assert Path(item["output"]).name == "take000_13d.usda"


@pytest.mark.parametrize(
    ("arguments", "code", "word"),
    [
        (("none*.bvh",), 5, "BAT005"),
        (("takes", "a.batch.yaml"), 2, "is a batch file: pass it alone."),
        (("a.batch.yaml",), 3, "IO001"),
        (("takes", "-o", "one.usdc"), 2, "OUT007"),
        (("takes", "-o", "{stm}.usdc"), 2, "BAT004"),
        (("takes", "-j", "none"), 2, "auto"),
        (("takes", "--items", "2-9"), 2, "BAT033"),
        (("takes", "--name", "../x"), 2, "is not a valid name"),
        (("takes", "--items", "a"), 2, "1-20"),
        (("takes", "--executor", "farms"), 2, "BAT030"),
        (("takes", "--memory-limit", "2"), 2, "2GB"),
        (
            ("takes", "--fail-fast", "--max-failures", "3"),
            2,
            "use one of them",
        ),
        (("takes", "--scene", "none.scene.yaml"), 3, "IO001"),
        (("takes", "--set", "a=b"), 2, "SCN031"),
    ],
)
def test_what_makes_no_sense(
    takes: Path, arguments: tuple[str, ...], code: int, word: str
) -> None:
    done = animtool("batch", *arguments, cwd=takes)
    assert (done.code, done.stdout) == (code, ""), done.stderr
    assert word in done.stderr


@pytest.mark.slow
def test_the_same_bytes_from_any_number_of_processes(takes: Path) -> None:
    found = []
    for jobs in (1, 2, 3):
        out = ("-o", f"out{jobs}/{{stem}}.usdc", "-j", jobs)
        assert animtool("batch", "takes", *out, cwd=takes).code == 0
        found.append(whole_outputs(takes / f"out{jobs}"))
    assert found[0] == found[1] == found[2]
    alone = animtool("bake", "takes/take001.bvh", "-o", "one.usdc", cwd=takes)
    assert alone.code == 0
    assert (takes / "one.usdc").read_bytes() == found[0]["take001.usdc"]


def test_records_of_another_name(takes: Path) -> None:
    for name, path in (("one", "takes/take000.bvh"), ("two", "takes/take001.bvh")):
        assert animtool("batch", path, *OUT, "--name", name, cwd=takes).code == 0
    names = {path.name for path in (takes / "out/.animtool").glob("*.jsonl")}
    assert names == {"batch-one.jsonl", "batch-two.jsonl"}


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="POSIX terminals")
def test_a_terminal_shows_a_table(takes: Path) -> None:
    import pty

    ours, theirs = pty.openpty()
    done = subprocess.run(
        [sys.executable, "-P", "-m", "animtool", "batch", "takes", *OUT],
        stderr=theirs,
        stdout=subprocess.PIPE,
        check=True,
        cwd=takes,
        env={**os.environ, "TERM": "xterm"},
    )
    os.close(theirs)
    shown = b""
    with contextlib.suppress(OSError):
        while part := os.read(ours, 4096):
            shown += part
    os.close(ours)
    assert done.stdout == b""
    assert b"3 of 3" in shown
    assert b"3 items: 3 done in " in shown
    assert b"[1/3]" not in shown
