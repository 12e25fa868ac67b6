"""What how-to guides print for farms, clusters and shells runs as it stands there."""

from __future__ import annotations

import ast
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from support.batch import take_files, whole_outputs
from support.cli import animtool
from support.cluster import local_cluster

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="blocks are of sh")

# What tells each block of sh apart: it is run by the test that asks for it.
BLOCKS = ("split", "openjd run", "--lines openjd", "#IFRAME#", "dask=", "--shot")
JOB = "batch: animtool/1\ninputs: [takes]\noutput: out/{stem}.usdc\n"


@pytest.fixture(scope="module")
def guide(root: Path) -> str:
    pages = [root / f"animtool/docs/howto/{name}.md" for name in ("farm", "shots")]
    return "\n".join(page.read_text("utf-8") for page in pages)


@pytest.fixture
def farm(tmp_path: Path) -> Path:
    """Return a folder with a batch file and 102 takes."""
    take_files(tmp_path / "takes", 102, frames=2)
    (tmp_path / "JOB.batch.yaml").write_text(JOB)
    return tmp_path


@pytest.fixture
def commands(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return an environment in which commands are found as they are here."""
    folder = tmp_path_factory.mktemp("bin")
    for name in ("animtool", "openjd"):
        path = folder / name
        path.write_text(f'#!/bin/sh\nexec {sys.executable} -P -m {name} "$@"\n')
        path.chmod(0o755)
    return {**os.environ, "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}"}


def blocks(guide: str) -> list[str]:
    return re.findall(r"^```sh\n(.*?)^```", guide, re.M | re.S)


def block(guide: str, word: str) -> str:
    """Return the one block of sh that has a word, without what installs packages."""
    (found,) = [text for text in blocks(guide) if word in text]
    lines = found.splitlines(keepends=True)
    return "".join(line for line in lines if not line.startswith("pip install"))


def shell(script: str, folder: Path, environment: dict[str, str]) -> str:
    done = subprocess.run(
        ["sh", "-ec", script],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env=environment,
    )
    assert done.returncode == 0, f"{script}\n{done.stdout}{done.stderr}"
    return done.stdout + done.stderr


def test_every_block_is_asked_for(guide: str) -> None:
    for text in blocks(guide):
        assert sum(word in text for word in BLOCKS) == 1, text


@pytest.mark.slow
def test_lists_of_their_own(
    guide: str, tmp_path: Path, commands: dict[str, str]
) -> None:
    takes = take_files(tmp_path / "takes", 2)
    (tmp_path / "takes.txt").write_text("".join(f"{path}\n" for path in takes))
    assert "2 done" in shell(block(guide, "split"), tmp_path, commands)


@pytest.mark.slow
def test_the_bundle_runs(guide: str, workplace: Path, commands: dict[str, str]) -> None:
    pytest.importorskip("openjd.cli", reason="openjd-cli is not installed")
    *_, made = re.findall(r"^\$ (animtool job .*)$", guide, re.M)
    shell(f"{made}\n{block(guide, 'openjd run')}", workplace, commands)
    assert len(whole_outputs(workplace / "samples/batch/waves")) == 12


@pytest.mark.slow
def test_a_task_of_any_farm(guide: str, farm: Path, commands: dict[str, str]) -> None:
    said = shell(block(guide, "--lines openjd"), farm, commands)
    assert "openjd_progress: 100.0" in said
    assert set(whole_outputs(farm / "out")) == {"take100.usdc", "take101.usdc"}


@pytest.mark.slow
def test_a_layer_of_opencue(guide: str, farm: Path, commands: dict[str, str]) -> None:
    script = block(guide, "#IFRAME#").replace("#IFRAME#", "101")
    shell(script.replace("/show", str(farm)), farm, commands)
    assert set(whole_outputs(farm / "out")) == {"take100.usdc", "take101.usdc"}
    (layer,) = re.findall(r"`(Shell\([^`]*\))`", guide)
    call = ast.parse(layer, mode="eval").body
    assert isinstance(call, ast.Call)
    (words,) = [k.value for k in call.keywords if k.arg == "command"]
    assert isinstance(words, ast.List)
    command = [ast.unparse(word).strip("'\"") for word in words.elts]
    line = [word.replace("#IFRAME#", "101") for word in command]
    line = ["JOB.batch.yaml" if word == "JOB" else word for word in line]
    assert animtool(*line[1:], "-n", cwd=farm).code == 0


@pytest.mark.slow
def test_an_array_of_slurm(guide: str, farm: Path, commands: dict[str, str]) -> None:
    (wrapped,) = re.findall(r"`(sbatch [^`]*)`", guide)
    words = shlex.split(wrapped)
    script = " ".join(words[words.index("--wrap") + 1].split())
    shell(script, farm, {**commands, "SLURM_ARRAY_TASK_ID": "1"})
    assert set(whole_outputs(farm / "out")) == {"take100.usdc", "take101.usdc"}


@pytest.mark.slow
def test_a_cluster(guide: str, tmp_path: Path) -> None:
    take_files(tmp_path / "takes", 3)
    (tmp_path / "JOB.batch.yaml").write_text(JOB)
    with local_cluster(workers=1) as address:
        (tmp_path / "scheduler.json").write_text(json.dumps({"address": address}))
        lines = block(guide, "dask=").splitlines()
        for line, said in zip(lines, ("3 done", "up to date"), strict=True):
            there = line.replace("tcp://scheduler:8786", address)
            words = there.replace("/shared", str(tmp_path)).split()
            done = animtool(*words[1:], cwd=tmp_path)
            assert (done.code, said in done.stderr) == (0, True), done.stderr


def test_a_cluster_of_slurm_is_python(guide: str) -> None:
    (text,) = re.findall(r"^```python\n(from dask_jobqueue.*?)^```", guide, re.M | re.S)
    ast.parse(text)


@pytest.mark.slow
def test_cut_lists(guide: str, tmp_path: Path, commands: dict[str, str]) -> None:
    pytest.importorskip("opentimelineio", reason="no OpenTimelineIO (extra: otio)")
    from support.timelines import clip, timeline

    (path,) = take_files(tmp_path / "takes", 1, frames=40)
    made = clip("sh010", f"takes/{path.name}", (10, 4), (0, 40))
    timeline(tmp_path / "edit.otio", made)
    part = guide.split("# Shots and cut lists")[1]
    (scene,) = re.findall(r"^```yaml\n(.*?)^```", part, re.M | re.S)
    (tmp_path / "shot.scene.yaml").write_text(scene)
    batch, bake, other = block(guide, "--shot").splitlines()
    assert "1 done" in shell(batch, tmp_path, commands)
    assert "shot sh010: cut 1001 to 1004" in shell(bake, tmp_path, commands)
    # Lists of edits need a package of their own: only the words are looked at here.
    other = other.replace("edit.edl", "edit.otio")
    assert "options changed" in shell(f"{other} -n", tmp_path, commands)
