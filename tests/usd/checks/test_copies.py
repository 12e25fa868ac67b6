"""Copies whose samples are blocked."""

from __future__ import annotations

from pathlib import Path

from support.cli import animtool

BLOCKED = """\
#usda 1.0
def PointInstancer "birds" {
    rel prototypes = [</birds/bird>]
    int[] protoIndices.timeSamples = { 1: [0, 0], 2: None, 3: [5] }
    point3f[] positions.timeSamples = { 1: [(0, 0, 0), (1, 0, 0)], 2: None, 3: None }
    def Mesh "bird" {}
}
"""


def test_blocked_samples_are_no_copies(tmp_path: Path) -> None:
    path = tmp_path / "birds.usda"
    path.write_text(BLOCKED, "utf-8")
    done = animtool("validate", path)
    assert done.code == 1
    assert "5 names none of 1" in done.stdout
    assert "at time code 3" in done.stdout
