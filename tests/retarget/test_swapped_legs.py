"""Legs with the names of the other side."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.cli import animtool

from animtool.retarget.swapped_legs import swapped_legs_warning
from animtool.scene.sources.open import open_source

SAMPLES = Path(__file__).parents[2] / "samples"
RIG = SAMPLES.parent / "rigs/biped/biped.rig.yaml"


@pytest.fixture
def swapped(tmp_path: Path) -> Path:
    """Return a walk whose legs have swapped names."""
    text = (SAMPLES / "walk/walk.bvh").read_text()
    for part in ("UpLeg", "Leg", "Foot", "Toe"):
        text = text.replace(f"JOINT Left{part}\n", f"JOINT Other{part}\n")
        text = text.replace(f"JOINT Right{part}\n", f"JOINT Left{part}\n")
        text = text.replace(f"JOINT Other{part}\n", f"JOINT Right{part}\n")
    path = tmp_path / "walk.bvh"
    path.write_text(text)
    return path


def test_legs_that_are_swapped(swapped: Path) -> None:
    for path, code in ((swapped, "MOT210"), (SAMPLES / "walk/walk.bvh", None)):
        take = open_source(path).collect()
        found = swapped_legs_warning(take.rig, take.motion)
        assert (None if found is None else found.code) == code
        in_bvh = swapped_legs_warning(take.rig, take.motion, "BVH")
        for file_format, fault in (("", found), ("BVH", in_bvh)):
            hint = "" if fault is None else str(fault.hint)
            assert ("CHANNELS" in hint) == (code is not None and file_format == "BVH")
        # A pose may be anything.
        pose = take.motion.select(slice(0, 1))
        assert swapped_legs_warning(take.rig, pose) is None


def test_commands_report_it_once(swapped: Path, tmp_path: Path) -> None:
    for command in (
        ("bake", swapped, "-o", tmp_path / "walk.usdc"),
        ("validate", swapped),
        ("retarget", swapped, "--to", RIG, "-o", tmp_path / "biped.usdc"),
    ):
        done = animtool(*command)
        assert (done.stdout + done.stderr).count("MOT210") == 1


def test_the_verdict_of_retarget(swapped: Path) -> None:
    for path, status in (
        (swapped, "check these frames"),
        (SAMPLES / "walk/walk.bvh", "good"),
    ):
        done = animtool("retarget", path, "--to", RIG, "--format", "json")
        assert json.loads(done.stdout)["verdict"] == status
