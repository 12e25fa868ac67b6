"""Legs and arms with the names of the other side."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.cli import animtool

from animtool.retarget.swapped_sides import swapped_sides_warning
from animtool.scene.sources.open import open_source

SAMPLES = Path(__file__).parents[2] / "samples"
RIG = SAMPLES.parent / "rigs/biped/biped.rig.yaml"


@pytest.fixture
def swapped(tmp_path: Path) -> Path:
    """Return a walk whose legs have swapped names."""
    return with_swapped(tmp_path / "walk.bvh", "UpLeg", "Leg", "Foot", "Toe")


def with_swapped(path: Path, *parts: str) -> Path:
    text = (SAMPLES / "walk/walk.bvh").read_text()
    for part in parts:
        text = text.replace(f"JOINT Left{part}\n", f"JOINT Other{part}\n")
        text = text.replace(f"JOINT Right{part}\n", f"JOINT Left{part}\n")
        text = text.replace(f"JOINT Other{part}\n", f"JOINT Right{part}\n")
    path.write_text(text)
    return path


def test_legs_that_are_swapped(swapped: Path) -> None:
    for path, code in ((swapped, "MOT210"), (SAMPLES / "walk/walk.bvh", None)):
        take = open_source(path).collect()
        found = swapped_sides_warning(take.rig, take.motion)
        assert (None if found is None else found.code) == code
        in_bvh = swapped_sides_warning(take.rig, take.motion, "BVH")
        for file_format, fault in (("", found), ("BVH", in_bvh)):
            hint = "" if fault is None else str(fault.hint)
            assert ("CHANNELS" in hint) == (code is not None and file_format == "BVH")
        # A pose may be anything.
        pose = take.motion.select(slice(0, 1))
        assert swapped_sides_warning(take.rig, pose) is None


@pytest.mark.parametrize(
    "parts",
    [("Shoulder", "Arm", "ForeArm", "Hand"), ("Arm", "ForeArm", "Hand"), ("Hand",)],
)
def test_arms_that_are_swapped(tmp_path: Path, parts: tuple[str, ...]) -> None:
    path = with_swapped(tmp_path / "walk.bvh", *parts)
    take = open_source(path).collect()
    found = swapped_sides_warning(take.rig, take.motion)
    assert found is not None
    assert found.code == "MOT210"
    assert f"'Left{parts[0]}' is on the right" in found.message
    done = animtool("validate", path)
    assert (done.stdout + done.stderr).count("MOT210") == 1


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
