"""``migrate``: what it says, how it ends, what it writes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from support.cli import animtool

from animtool.documents.versions import MIGRATION_STEPS

CLIP = "clip: animtool/0  # old\nrate: 24\n"


def with_fps(value: dict[str, Any]) -> dict[str, Any]:
    """Version 1 calls a rate fps."""
    return {("fps" if key == "rate" else key): v for key, v in value.items()}


@pytest.fixture
def old(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a clip of a version that there never was."""
    monkeypatch.setitem(MIGRATION_STEPS["clip"], 0, with_fps)
    path = tmp_path / "a.clip.yaml"
    path.write_text(CLIP)
    return path


def test_in_place(old: Path) -> None:
    done = animtool("migrate", old, "--overwrite")
    assert (done.code, done.stdout) == (0, "")
    assert "from animtool/0 is now animtool/1" in done.stderr
    assert "warning: DOC101" in done.stderr
    assert old.read_text() == "clip: animtool/1\nfps: 24\n"
    assert [path.name for path in old.parent.iterdir()] == ["a.clip.yaml"]


def test_unasked_it_replaces_nothing(old: Path) -> None:
    done = animtool("migrate", old)
    assert done.code == 2
    assert "OUT001" in done.stderr
    assert old.read_text() == CLIP


def test_a_check(old: Path) -> None:
    done = animtool("migrate", old, "--check")
    assert done.code == 1
    assert "-rate: 24\n+clip: animtool/1\n+fps: 24\n" in done.stdout
    assert old.read_text() == CLIP


def test_strict(old: Path) -> None:
    done = animtool("migrate", old, "--overwrite", "--strict")
    assert done.code == 1
    assert old.read_text() == CLIP


def test_json(old: Path) -> None:
    done = animtool("migrate", old, "--overwrite", "--format", "json")
    (entry,) = json.loads(done.stdout)["files"]
    assert (entry["kind"], entry["from"], entry["to"]) == ("clip", 0, 1)
    assert (entry["needed"], entry["written"]) == (True, True)
    assert entry["difference"][-1] == "+fps: 24"
    assert entry["notices"][0]["code"] == "DOC101"
    assert done.code == 0


def test_what_is_new_is_said_to_be_so(root: Path) -> None:
    files = sorted((root / "rigs").glob("*/*.rig.yaml"))
    done = animtool("migrate", *files)
    assert done.code == 0
    assert done.stderr.count("is the newest") == len(files)
    done = animtool("migrate", *files, "--check", "--format", "json")
    assert done.code == 0
    assert not any(entry["needed"] for entry in json.loads(done.stdout)["files"])


def test_a_version_of_the_future(old: Path) -> None:
    future = old.with_name("b.rig.yaml")
    future.write_text("name: x\nrig: animtool/2\n")
    done = animtool("migrate", old, future, "--overwrite")
    assert done.code == 3
    assert f"{future}:2:6: DOC012" in done.stderr
    assert old.read_text() == CLIP


def test_a_folder_that_may_not_be_written(old: Path) -> None:
    old.chmod(0o400)
    done = animtool("migrate", old, "--overwrite")
    assert done.code in {0, 3}  # Whoever is root may write it.
    assert old.read_text() == (CLIP if done.code else "clip: animtool/1\nfps: 24\n")
