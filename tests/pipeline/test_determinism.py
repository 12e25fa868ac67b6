from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from support.cli import animtool, animtool_process


@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_the_same_bytes_in_every_process(
    walk: Path, tmp_path: Path, suffix: str
) -> None:
    digests = set()
    for seed in ("0", "1"):
        output = tmp_path / f"seed_{seed}{suffix}"
        # Names of files stand nowhere in them.
        done = animtool_process(
            "bake", walk, "-o", output, "--bones", PYTHONHASHSEED=seed
        )
        assert done.code == 0, done.stderr
        digests.add(hashlib.sha256(output.read_bytes()).hexdigest())
    # In this process, which has made other files before.
    again = tmp_path / f"seed_0{suffix}"
    animtool("bake", walk, "-o", again, "--bones", "--overwrite")
    digests.add(hashlib.sha256(again.read_bytes()).hexdigest())
    assert len(digests) == 1


def test_split_files_are_the_same(walk: Path, tmp_path: Path) -> None:
    found = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        made = animtool if folder == "a" else animtool_process
        made("bake", walk, "-o", tmp_path / folder / "o.usdc", "--split")
        found.append({p.name: p.read_bytes() for p in (tmp_path / folder).iterdir()})
    assert len(found[0]) == 3
    assert found[0] == found[1]


@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_libraries_are_the_same_and_usd_says_nothing(
    walk: Path, tmp_path: Path, suffix: str
) -> None:
    found = set()
    takes = [walk, tmp_path / "other.usda"]
    animtool("bake", walk, "-o", takes[1], "--fps", "12")
    for seed in ("0", "1"):
        output = tmp_path / f"{seed}{suffix}"
        options = ("--prim-path", "/hero", "-q")
        done = animtool_process(
            "bake", *takes, "-o", output, *options, PYTHONHASHSEED=seed
        )
        assert (done.code, done.stderr) == (0, "")
        found.add(output.read_bytes())
    assert len(found) == 1
