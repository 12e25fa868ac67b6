"""The same inputs are the same bytes: in every process, and in one that made others."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.cli import TIMEOUT, animtool
from support.skinned_rig import write_pair

# Runs each line of its input as a command.
SEVERAL = """
import json, sys
from animtool.cli.main import run

for line in sys.stdin:
    if code := run(json.loads(line)):
        sys.exit(code)
"""
LIBRARY = ("bake", "walk.bvh", "other.usda", "--prim-path", "/hero")
DEFORM = ("bake", "pair.clip.yaml", "--deform", "--velocities")
# Names of files stand nowhere in them: but for a split stage, each has another.
FORMS = {
    "stage.usda": ("bake", "walk.bvh", "--bones", "-o", "{seed}.usda"),
    "stage.usdc": ("bake", "walk.bvh", "--bones", "-o", "{seed}.usdc"),
    "split": ("bake", "walk.bvh", "--split", "-o", "split.usdc"),
    "library.usda": (*LIBRARY, "-o", "{seed}_library.usda"),
    "library.usdc": (*LIBRARY, "-o", "{seed}_library.usdc"),
    "deform.usda": (*DEFORM, "-o", "{seed}_deform.usda"),
    "deform.usdc": (*DEFORM, "-o", "{seed}_deform.usdc"),
}


def commands(seed: str) -> list[list[str]]:
    return [
        [*(word.format(seed=seed) for word in words), "-q"] for words in FORMS.values()
    ]


@pytest.fixture(scope="module")
def folders(
    walk: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, tuple[Path, str]]:
    """Return where each form was made, and what was said, by who made it."""
    found = {}
    for seed in ("0", "1", "here"):
        folder = tmp_path_factory.mktemp("made")
        write_pair(folder)
        (folder / "walk.bvh").write_bytes(walk.read_bytes())
        animtool("bake", walk, "-o", folder / "other.usda", "--fps", "12")
        said = ""
        if seed == "here":
            for words in commands(seed):
                done = animtool(*words, cwd=folder)
                assert done.code == 0, done.stderr
                said += done.stderr
        else:
            ended = subprocess.run(
                [sys.executable, "-P", "-c", SEVERAL],
                input="\n".join(map(json.dumps, commands(seed))),
                capture_output=True,
                text=True,
                check=False,
                timeout=TIMEOUT,
                cwd=folder,
                env={**os.environ, "PYTHONHASHSEED": seed},
            )
            assert ended.returncode == 0, ended.stderr
            said = ended.stderr
        found[seed] = (folder, said)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
def test_the_same_bytes_in_every_process(
    folders: dict[str, tuple[Path, str]], form: str
) -> None:
    contents = []
    for seed, (folder, _) in folders.items():
        name = FORMS[form][-1].format(seed=seed)
        pattern = "split*" if form == "split" else name
        files = {
            path.name.replace(seed, ""): path.read_bytes()
            for path in folder.glob(pattern)
        }
        assert len(files) == (3 if form == "split" else 1)
        contents.append(files)
    assert contents[0] == contents[1] == contents[2]


@pytest.mark.slow
def test_usd_says_nothing(folders: dict[str, tuple[Path, str]]) -> None:
    assert [said for _, said in folders.values()] == ["", "", ""]
