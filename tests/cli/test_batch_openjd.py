"""Lines that a session of Open Job Description reads."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.batch import take_files
from support.cli import animtool

WORDS = ("-o", "out/{stem}.usdc", "--executor", "serial", "--lines", "openjd")


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    take_files(tmp_path / "takes", 3)
    return tmp_path


def test_progress_status_and_failures(takes: Path) -> None:
    (takes / "takes/take001.bvh").write_text("HIERARCHY\n")
    done = animtool("batch", "takes", *WORDS, cwd=takes)
    assert done.code == 1
    lines = done.stdout.splitlines()
    assert lines[:2] == ["openjd_progress: 0.0", "openjd_status: 3 of 3 to build"]
    shares = [line for line in lines if line.startswith("openjd_progress: ")]
    assert shares[-1] == "openjd_progress: 100.0"
    assert [line for line in lines if line.startswith("openjd_fail: 1 failed")]
    again = animtool("batch", "takes/take000.bvh", *WORDS, cwd=takes)
    assert again.stdout.splitlines()[0] == "openjd_progress: 100.0"


def test_what_ends_the_whole(takes: Path) -> None:
    done = animtool("batch", "none*.bvh", *WORDS, cwd=takes)
    assert done.code == 5
    assert done.stdout.startswith("openjd_fail: BAT005 ")
    done = animtool("batch", "takes", *WORDS, "--items", "9+2", cwd=takes)
    assert (done.code, "BAT033" in done.stdout) == (2, True)
    done = animtool("batch", "takes", *WORDS, "--format", "json", cwd=takes)
    assert done.code == 2


def test_as_many_items_as_there_are(takes: Path) -> None:
    done = animtool("batch", "takes", *WORDS, "--items", "2+20", cwd=takes)
    assert done.code == 0, done.stderr
    assert "2 of 2 to build" in done.stdout
    assert sorted(p.name for p in (takes / "out").glob("*.usdc")) == [
        "take001.usdc",
        "take002.usdc",
    ]
