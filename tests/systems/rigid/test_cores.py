"""Volumes, centres and moments of shapes, against integrals and the parallel axes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad

from animtool.maths import so3
from animtool.sim.colliders import Box, Capsule, Mesh, Sphere
from animtool.systems.rigid.cores import (
    SolidProperties,
    combine_solids,
    core_of,
    core_solid,
    enclosed_solid,
)


@pytest.mark.parametrize(("radius", "length"), [(0.3, 1.0), (0.5, 0.2), (0.2, 0.0)])
def test_a_capsule_is_the_sum_of_its_discs(radius: float, length: float) -> None:
    shape = Capsule(radius, length, axis=(0.0, 0.0, 2.0))
    found = core_solid(shape, core_of(shape))

    def square(z: float) -> float:
        return radius**2 - max(abs(z) - length / 2, 0.0) ** 2

    end = length / 2 + radius
    breaks = [-length / 2, length / 2]

    def whole(function: object) -> float:
        return float(quad(function, -end, end, points=breaks, epsabs=1e-13)[0])

    assert found.volume == pytest.approx(whole(lambda z: np.pi * square(z)))
    along = whole(lambda z: np.pi / 2 * square(z) ** 2)
    across = whole(lambda z: np.pi / 4 * square(z) ** 2 + np.pi * square(z) * z * z)
    assert_allclose(found.inertia, np.diag([across, across, along]), atol=1e-12)


def test_boxes_and_balls_and_filled_meshes() -> None:
    box = Box((0.2, 0.4, 0.6))
    found = core_solid(box, core_of(box))
    moments = 0.048 / 12 * np.array([0.16 + 0.36, 0.04 + 0.36, 0.04 + 0.16])
    assert found.volume == pytest.approx(0.048)
    assert_allclose(found.inertia, np.diag(moments), atol=1e-15)
    ball = Sphere(0.5, centre=(1.0, 2.0, 3.0))
    found = core_solid(ball, core_of(ball))
    volume = np.pi / 6
    assert_allclose(found.inertia, 0.4 * volume * 0.25 * np.eye(3))
    assert_allclose(found.centre, [1, 2, 3])
    # A corner of a cube, off the origin: its centre is a quarter in.
    corner = np.array([[5.0, -2, 1], [6, -2, 1], [5, -1, 1], [5, -2, 2]])
    sides = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    found = enclosed_solid(corner[sides])
    assert found.volume == pytest.approx(1 / 6)
    assert_allclose(found.centre, [5.25, -1.75, 1.25])
    # By its integrals: x² is 1/60, x y is 1/120 about the corner.
    second = np.full((3, 3), 1 / 120) + np.eye(3) / 120 - np.full((3, 3), 1 / 96)
    assert_allclose(found.inertia, np.trace(second) * np.eye(3) - second, atol=1e-15)
    mesh = Mesh(corner, sides, closed=True)
    hull = core_solid(mesh, core_of(mesh))
    assert_allclose(hull.inertia, found.inertia, atol=1e-12)


def test_several_are_about_their_centre_of_mass() -> None:
    """Balls of 1 and 3 kg, 4 m apart: it is a metre from the heavy one."""
    light = SolidProperties(0.5, np.array([0.0, 0.0, 0.0]), 0.1 * np.eye(3))
    heavy = SolidProperties(1.0, np.array([0.0, 4.0, 0.0]), 0.2 * np.eye(3))
    found = combine_solids([light, heavy], [2.0, 3.0])
    assert found.volume == pytest.approx(4.0)
    assert_allclose(found.centre, [0, 3, 0])
    own = 2 * 0.1 + 3 * 0.2
    apart = 1 * 9.0 + 3 * 1.0
    assert_allclose(found.inertia, np.diag([own + apart, own, own + apart]))
    # Off the axes: products of inertia have the other sign.
    aslant = SolidProperties(1.0, np.array([2.0, 4.0, 0.0]), 0.2 * np.eye(3))
    found = combine_solids([light, aslant], [2.0, 1.0])
    assert found.inertia[0, 1] == pytest.approx(-0.5 * 2 * 4)


def test_a_solid_is_turned_about_its_frame() -> None:
    solid = SolidProperties(2.0, np.array([1.0, 0.0, 0.0]), np.diag([1.0, 2.0, 3.0]))
    turn = so3.from_axis_angle(np.array([0.0, 0.0, 1.0]), np.pi / 2)
    found = solid.transformed(np.array([0.0, 0.0, 5.0]), turn)
    assert_allclose(found.centre, [0, 1, 5], atol=1e-15)
    assert_allclose(found.inertia, np.diag([2.0, 1.0, 3.0]), atol=1e-12)
