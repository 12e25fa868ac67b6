"""What goes through cloth: itself, and colliders that are thinner than its faces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from animtool import BakeOptions, bake
from animtool.core.errors import StrictError
from animtool.scene.file.read import load_scene
from animtool.sim.colliders import Collider
from animtool.sim.colliders.shapes import Box, Capsule, Plane, Sphere
from animtool.systems.springs import Family, rope, sheet
from animtool.systems.springs.drawing import CurveShape, FaceShape
from animtool.systems.springs.view import (
    CHECKS_PER_MOTION,
    SelfCrossings,
    collider_thickness,
    thin_notices,
    widest_gap,
)

CLOTH = """\
scene: animtool/1
fps: 24
range: [1, 25]
systems:
- cloth:
    name: towel
    corner: [-0.5, 1, 0.5]
    across: [1, 0, 0]
    up: [0, 0, -1]
    resolution: [11, 11]
    mass: 0.2
    springs: {structural: {stiffness: 200, ratio: 0.2}}
    pins: [{particles: [top_left]}, {particles: [top_right]}]
"""
OUTPUT = "output: {file: shot.usdc}\n"
ROD = (
    "    colliders: [{{shape: {{capsule: {{radius: {radius}, length: 0.4, "
    "axis: [1, 0, 0]}}}}, at: [0, 0.8, 0]}}]\n"
)


def notices(folder: Path, more: str) -> dict[str, str]:
    """Return what baking cloth says, by code."""
    path = folder / "shot.scene.yaml"
    path.write_text(CLOTH + more + OUTPUT, "utf-8")
    report = bake(load_scene(path), folder / "shot.usdc", BakeOptions(overwrite=True))
    return {n.code: n.message for n in report.notices}


def faces(columns: int, rows: int) -> FaceShape:
    grid = np.arange(rows * columns).reshape(rows, columns)
    quads = [grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]]
    indices = np.stack(quads, axis=-1).reshape(-1)
    body = sheet(columns, rows, mass=1, structural=Family(1.0))
    return FaceShape(np.full((rows - 1) * (columns - 1), 4), indices, body.springs)


def test_pairs_beyond_those_at_the_start_are_counted() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, 2], [0.2, 0.2, 3]])
    points = np.append(points, [[3, 0.2, 2.5]], axis=0)
    seen = SelfCrossings(np.array([[0, 1, 2], [3, 4, 5]]), 0.0, 1.0)
    through = points.copy()
    through[3:, 2] -= 2.5
    for t, now in [(0, points), (0.5, through), (1, points)]:
        seen.count_if_due(t, now)
    assert (seen.max_crossing_count, seen.time_of_max) == (2, 0.5)
    (notice,) = seen.notices("sail")
    assert notice.code == "SIM194"
    assert "2 pairs" in notice.message
    tangled = SelfCrossings(seen.triangles, 0.0, 1.0)
    for t in (0, 1):
        tangled.count_if_due(t, through)
    assert tangled.notices("sail") == []


def test_looks_are_as_many_however_many_frames() -> None:
    seen = SelfCrossings(np.zeros((1, 3), np.int64), 0.0, 2.0)
    points = np.zeros((3, 3))
    waits = []
    for t in np.linspace(0, 2, 1001):
        before = seen._next_time
        seen.count_if_due(float(t), points)
        waits.append(seen._next_time != before)
    assert sum(waits) <= CHECKS_PER_MOTION + 2
    assert waits[-1]


def test_cloth_that_fell_through_itself_says_so(tmp_path: Path) -> None:
    folded = "    drag: 0.1\n"
    found = notices(tmp_path, folded)
    assert "SIM195" not in found
    assert "pairs of an edge and a face" in found["SIM194"]
    contact = "    self_contact: {thickness: 0.02}\n    drag: 0.1\n"
    assert "SIM194" not in notices(tmp_path, contact)


@pytest.mark.parametrize(("radius", "thin"), [(0.02, True), (0.3, False)])
def test_a_thin_rod_under_cloth_that_went_through_itself_is_named_with_numbers(
    tmp_path: Path, radius: float, thin: bool
) -> None:
    found = notices(tmp_path, ROD.format(radius=radius))
    assert ("SIM195" in found) is thin
    if thin:
        assert "SIM194" in found
        assert "4 cm" in found["SIM195"] or "40 mm" in found["SIM195"]
        assert "self_contact" in found["SIM195"]


def test_faces_meet_a_thin_rod_without_a_word(tmp_path: Path) -> None:
    contact = "    self_contact: {thickness: 0.02}\n"
    assert "SIM195" not in notices(tmp_path, ROD.format(radius=0.02) + contact)


def test_gaps_are_diagonals_of_faces_and_lengths_of_segments() -> None:
    body = sheet(3, 4, mass=1, structural=Family(1.0), across=[2, 0, 0], up=[0, 3, 0])
    assert widest_gap(faces(3, 4), body.positions) == pytest.approx(np.sqrt(2))
    line = rope([0, 0, 0], [4, 0, 0], 5, Family(1.0), mass=1)
    curves = CurveShape(np.array([3, 2]), 0.01, line.springs)
    points = line.positions.copy()
    points[3:] += 9.0
    assert widest_gap(curves, points) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("shape", "thick"),
    [
        (Sphere(0.1), 0.2),
        (Capsule(0.03, 1.0), 0.06),
        (Box((2.0, 0.01, 0.3)), 0.3),
        (Plane(), np.inf),
    ],
)
def test_how_thick_colliders_are(shape: object, thick: float) -> None:
    assert collider_thickness(Collider(shape)) == pytest.approx(thick)


def test_radius_and_stretch_count() -> None:
    rod = [Collider(Capsule(0.01, 1.0))]
    assert thin_notices("sail", rod, 0.0, 0.019, 0.0) == []
    (notice,) = thin_notices("sail", rod, 0.0, 0.019, 0.1)
    assert notice.code == "SIM195"
    assert thin_notices("sail", rod, 0.001, 0.019, 0.1) == []


@pytest.mark.parametrize(("gap", "count"), [(0.027, 0), (0.029, 1)])
def test_particles_keep_their_radius_on_either_side(gap: float, count: int) -> None:
    """A rod of 20 mm is kept off by 4 mm twice: gaps of 28 mm are wide enough."""
    rod = [Collider(Capsule(0.01, 1.0))]
    assert len(thin_notices("sail", rod, 0.004, gap, 0.0)) == count


@pytest.mark.parametrize(
    ("more", "measured"),
    [
        ("    self_contact: {thickness: 0.02}\n", True),
        (ROD.format(radius=0.15), True),
        ("", False),
    ],
    ids=["itself", "rod", "nothing"],
)
def test_cloth_in_contact_is_measured(
    tmp_path: Path, more: str, *, measured: bool
) -> None:
    """Soft springs are strained by the weight: SIM182 names a time, point and place."""
    path = tmp_path / "shot.scene.yaml"
    path.write_text(CLOTH.replace("200, ratio", "40, ratio") + more + OUTPUT, "utf-8")
    done = bake(load_scene(path), tmp_path / "shot.usdc", BakeOptions(overwrite=True))
    (said,) = done.takes[0].simulated
    assert ("strain" in said) is measured
    codes = {notice.code for notice in done.notices}
    assert ("SIM182" in codes) is measured
    if measured:
        strain = said["strain"]
        assert strain["value"] > 0.15
        assert 0 < strain["time"] <= 1
        assert strain["frame"] is None
        assert len(strain["at"]) == 3
        # Held points alone may be inside of what is met, and none is here.
        assert said["depth"]["value"] < 2e-3
        with pytest.raises(StrictError):
            bake(
                load_scene(path),
                tmp_path / "shot.usdc",
                BakeOptions(overwrite=True, strict=True),
            )
