"""``animtool loop``: the cycle of a take, and the take that repeats it."""

from __future__ import annotations

import json
from pathlib import Path

from support.cli import animtool

from animtool import open_source

WALK = "samples/walk/walk.bvh"  # a step of 32 frames, twice


def test_the_cycle_of_a_walk(root: Path, tmp_path: Path) -> None:
    done = animtool("loop", root / WALK, "--format", "json", cwd=tmp_path)
    assert done.code == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["last"] - found["first"] == 32
    assert found["share"] < 1e-6
    assert not list(tmp_path.iterdir())


def test_a_cycle_repeated(root: Path, tmp_path: Path) -> None:
    outputs = [tmp_path / f"{name}.bvh" for name in "ab"]
    for output in outputs:
        done = animtool("loop", root / WALK, "-o", output, "--repeats", "3")
        assert done.code == 0, done.stderr
    assert outputs[0].read_bytes() == outputs[1].read_bytes()
    assert open_source(outputs[0]).collect().clock.count == 96


def test_no_cycle_writes_nothing(root: Path, tmp_path: Path) -> None:
    output = tmp_path / "out.bvh"
    done = animtool("loop", root / WALK, "-o", output, "--shortest", "5")
    assert (done.code, "SCN018" in done.stderr) == (2, True)
    assert not list(tmp_path.iterdir())
