"""Every hard BVH behaves as its ``expected.json`` says, from the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from pxr import Usd, UsdSkel
from support.cli import animtool
from support.data import data_files

from animtool.core.rates import parse_rate

FILES = data_files("bvh_hard", "*.bvh")


def expected(path: Path) -> dict[str, Any]:
    cases = json.loads(path.with_name("expected.json").read_text("utf-8"))
    if path.name not in cases:
        pytest.skip(f"expected.json says nothing of {path.name}")
    return dict(cases[path.name])


@pytest.mark.parametrize("path", FILES)
def test_outcome(path: Path, tmp_path: Path) -> None:
    want = expected(path)
    output = tmp_path / "out.usda"
    done = animtool("bake", path, "-o", output, "--format", "json")
    strict = animtool("bake", path, "-o", tmp_path / "strict.usda", "--strict")
    assert "Traceback" not in done.stderr + strict.stderr
    for line in want.get("lines", ()):
        named = f"{path}:{line}:" in done.stderr
        assert named or f" {line}" in done.stderr, done.stderr
    if want["outcome"] == "error":
        assert (done.code, strict.code) == (3, 3), done.stderr
        assert len(done.stderr.strip().splitlines()) == 1
        assert list(tmp_path.iterdir()) == []
        return
    assert done.code == 0, done.stderr
    report = json.loads(done.stdout)
    warned = [n for n in report["notices"] if n["severity"] == "warning"]
    assert bool(warned) == (want["outcome"] == "warn"), warned
    assert strict.code == (1 if warned else 0)
    assert (tmp_path / "strict.usda").exists() != bool(warned)
    if "frames" in want:
        assert report["source_frames"] == want["frames"]
    if "joints" in want:
        assert report["joints"] == want["joints"]
    if "fps" in want:
        assert report["rate"] == str(parse_rate(want["fps"]))
    stage = Usd.Stage.Open(str(output))
    prim = next(p for p in stage.Traverse() if p.IsA(UsdSkel.Skeleton))
    joints = UsdSkel.Skeleton(prim).GetJointsAttr().Get()
    assert len(joints) == len(set(joints)) == report["joints"]


@pytest.mark.parametrize("path", FILES)
def test_info_never_fails_otherwise(path: Path) -> None:
    want = expected(path)
    done = animtool("info", path, "--format", "json")
    assert done.code == (3 if want["outcome"] == "error" else 0)
    assert len(json.loads(done.stdout)["files"]) == (want["outcome"] != "error")
