"""Copies whose samples are blocked, and copies of copies."""

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

# Each holds the other.
LOOP = """\
#usda 1.0
def PointInstancer "a" {
    rel prototypes = [</b>]
    int[] protoIndices = [0]
    point3f[] positions = [(0, 0, 0)]
    float3[] extent = [(5, 5, 5), (6, 6, 6)]
}
def PointInstancer "b" {
    rel prototypes = [</a>]
    int[] protoIndices = [0]
    point3f[] positions = [(0, 0, 0)]
    float3[] extent = [(5, 5, 5), (6, 6, 6)]
    def Mesh "mesh" {
        point3f[] points = [(0, 0, 0), (1, 1, 1)]
        float3[] extent = [(0, 0, 0), (1, 1, 1)]
    }
}
"""


def test_blocked_samples_are_no_copies(tmp_path: Path) -> None:
    path = tmp_path / "birds.usda"
    path.write_text(BLOCKED, "utf-8")
    done = animtool("validate", path)
    assert done.code == 1
    assert "5 is outside the 1" in done.stdout
    assert "at time code 3" in done.stdout


def test_no_extent_is_asked_of_copies_that_hold_themselves(tmp_path: Path) -> None:
    # USD would go on until its stack is full.
    path = tmp_path / "birds.usda"
    path.write_text(LOOP, "utf-8")
    done = animtool("validate", path)
    assert (done.code, "USD251" in done.stdout) == (0, False)
    path.write_text(LOOP.replace("[</a>]", "[</b/mesh>]"), "utf-8")
    assert "USD251 /b.extent" in animtool("validate", path).stdout
