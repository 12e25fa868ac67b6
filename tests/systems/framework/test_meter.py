"""Depth, piercing and strain of surfaces."""

from __future__ import annotations

import numpy as np
import pytest

from animtool import _kernels
from animtool.systems.framework.meter import (
    ClosedSurface,
    ContactMeter,
    MeasuredSurface,
    count_pierced_pairs,
    surface_depths,
)

CORNERS = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1]]
QUADS += [[2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
FACES = np.array(QUADS)[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
ALONG = np.array([1.0, 0, 0])
CUBE = ClosedSurface(CORNERS, FACES)
# A sheet of one triangle, whose corner is 0.1 m inside the cube.
SHEET = np.array([[0.9, 0.4, 0.4], [1.5, 0.3, 0.4], [1.5, 0.5, 0.4]])
ENDS = np.array([[0, 1], [1, 2], [2, 0]])


def lengths(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points[ENDS[:, 0]] - points[ENDS[:, 1]], axis=1)


def sides(points: np.ndarray, free: tuple[int, ...] = (0, 1, 2)) -> MeasuredSurface:
    return MeasuredSurface(np.array(free), np.array([[0, 1, 2]]), ENDS, lengths(points))


def test_depth_is_the_way_out_of_the_nearest_face() -> None:
    points = np.array([[0.5, 0.5, 0.25], [0.9, 0.4, 0.4], [1.5, 0.5, 0.5]])
    np.testing.assert_allclose(
        surface_depths(CUBE, points), [0.25, 0.1, 0.0], atol=1e-12
    )


def test_a_surface_that_deforms_is_measured_where_it_is() -> None:
    """A kernel surface keeps its tree, and its boxes follow its points."""
    kernel = _kernels.MeshSurface(CORNERS, FACES.astype(np.int32))
    rng = np.random.default_rng(3)
    for _ in range(3):
        corners = 2 * CORNERS + rng.uniform(-0.2, 0.2, CORNERS.shape)
        points = rng.uniform(-0.5, 2.5, (200, 3))
        depths = surface_depths(ClosedSurface(corners, FACES, kernel), points)
        np.testing.assert_array_equal(
            depths, surface_depths(ClosedSurface(corners, FACES), points)
        )
        assert 20 < (depths > 0).sum() < 180


def test_the_deepest_is_kept_with_frame_point_and_place() -> None:
    meter = ContactMeter()
    meter.measure(3.0, SHEET, sides(SHEET), [CUBE])
    meter.measure(4.0, SHEET + 0.05 * ALONG, sides(SHEET), [CUBE])
    assert meter.depth.value == pytest.approx(0.1)
    assert (meter.depth.frame, meter.depth.point) == (3.0, 0)
    assert meter.depth.at == pytest.approx((0.9, 0.4, 0.4))
    codes = [notice.code for notice in meter.notices("the sheet")]
    assert codes == ["SIM180", "SIM181"]


def test_what_starts_inside_is_to_be_moved() -> None:
    for first, hint in ((0.0, "move it out"), (-1.0, "slower motion")):
        meter = ContactMeter(uses_seconds=True)
        if first:
            meter.measure(first, SHEET + 9 * ALONG, sides(SHEET), [CUBE])
        meter.measure(0.0, SHEET, sides(SHEET), [CUBE])
        notice = meter.notices("the sheet")[0]
        assert notice.message.startswith("the sheet is 100 mm inside a collider")
        assert hint in (notice.hint or "")


def test_what_is_held_may_be_inside() -> None:
    meter = ContactMeter()
    meter.measure(1.0, SHEET, sides(SHEET, (1, 2)), [CUBE])
    assert meter.depth.value == 0


def test_edges_through_a_solid_are_counted_and_its_own_are_not() -> None:
    triangle = np.array([[0, 1, 2]])
    # Two sides through its face, and the diagonal of that through the sheet.
    assert count_pierced_pairs(SHEET, triangle, [CUBE]) == 3
    assert count_pierced_pairs(SHEET + ALONG, triangle, [CUBE]) == 0
    # One side of a second cube is in the first: together they are one solid.
    both = ClosedSurface(
        np.concatenate([CORNERS, CORNERS + 0.5]), np.concatenate([FACES, FACES + 8])
    )
    away = SHEET + ALONG
    assert count_pierced_pairs(away, triangle, [both]) == 0


def test_strain_is_of_longer_and_shorter_sides() -> None:
    meter = ContactMeter()
    shrunk = sides(SHEET)
    meter.measure(2.0, SHEET * 0.8, shrunk)
    assert meter.strain.value == pytest.approx(0.2)
    assert meter.strain_99.value == pytest.approx(0.2)
    assert [notice.code for notice in meter.notices("it")] == ["SIM182"]
    assert ContactMeter().notices("it") == []
