"""Surfaces that move through a step, as bodies run into them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.testing import assert_allclose

from animtool.maths import so3
from animtool.sim.colliders import Collider, Colliders, Plane, Poses, Sheet
from animtool.systems.rigid.surroundings import StepColliders, _rigid_collider

SQUARE = np.array([[1.0, 2, 3], [2, 2, 3], [2, 2, 5], [1, 2, 5]])
TURN = np.array([0.3, -0.2, 0.5])
SHIFT = np.array([0.1, -0.4, 0.2])


@dataclass
class Moved:
    """A square that turns and goes by so much in a second, and is stretched by more."""

    stretched: float = 0.0
    forgotten: float = -np.inf

    def points(self, t: float) -> np.ndarray:
        own = SQUARE + self.stretched * t * (SQUARE - SQUARE.mean(axis=0))
        return np.asarray(so3.rotate(so3.exp(t * TURN), own) + t * SHIFT)

    def triangles(self, _t: float) -> np.ndarray:
        return np.array([[0, 2, 1], [0, 3, 2]])

    def forget(self, t: float) -> None:
        self.forgotten = t


def test_a_surface_goes_through_a_step_as_it_turned_and_moved() -> None:
    """Where it keeps its shape exactly; else as its middle does, and its mean turn."""
    for stretched in (0.0, 0.3):
        motion = Moved(stretched)
        found = _rigid_collider(Sheet(motion, radius=0.01), 0.5, 1.0)
        assert motion.forgotten == 0.5
        begin, after = motion.points(0.5), motion.points(1.0)
        (first, last) = (found.poses.at(t) for t in (0.5, 1.0))
        assert_allclose(first, [0, 0, 0, 0, 0, 0, 1], atol=1e-12)
        made = so3.rotate(last[3:], begin) + last[:3]
        assert_allclose(made.mean(axis=0), after.mean(axis=0), atol=1e-12)
        assert_allclose(so3.angle_between(last[3:], so3.exp(0.5 * TURN)), 0, atol=1e-6)
        if not stretched:
            assert_allclose(made, after, atol=1e-12)


def test_a_surface_that_rests_is_a_collider_that_rests() -> None:
    rests = _rigid_collider(Sheet(Moved(), radius=0.01), 0.5, 0.5)
    assert_allclose(rests.poses.at(0.0), rests.poses.at(9.0))


def test_bodies_run_into_surfaces_and_into_what_is_there_without_any() -> None:
    """As into the surface as it goes, behind the other colliders."""
    floor = Collider(Plane(), Poses.fixed())
    alone = StepColliders(Colliders([floor]))
    for found, wanted in zip(
        alone.kernel_arrays(0.5, 1.0),
        Colliders([floor]).kernel_arrays(0.5, 1.0),
        strict=True,
    ):
        assert_allclose(found, wanted)
    sheet = Sheet(Moved(), radius=0.01)
    both = StepColliders(Colliders([floor], [sheet]))
    wanted = Colliders([floor, _rigid_collider(sheet, 0.5, 1.0)]).kernel_arrays(
        0.5, 1.0
    )
    for _ in range(2):  # what was made is known the second time
        for found, own in zip(both.kernel_arrays(0.5, 1.0), wanted, strict=True):
            assert_allclose(found, own)
    # A step later it is elsewhere.
    later = both.kernel_arrays(1.0, 1.5)
    assert any(
        np.shape(a) == np.shape(b)
        and np.size(a)
        and np.abs(np.subtract(a, b)).max() > 0
        for a, b in zip(later, wanted, strict=True)
    )
