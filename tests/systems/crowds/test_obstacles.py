"""What is in the way of agents: how far off it is, and which way that is."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from numpy.testing import assert_allclose

from animtool.maths import so3
from animtool.sim.colliders import Colliders
from animtool.systems.crowds.ground import GroundFrame, Terrain
from animtool.systems.crowds.obstacles import Obstacles
from animtool.systems.crowds.spec import DoorModel

RADII = np.array([0.1, 0.2, 0.3, 0.4])


def shut(*opens: list[float]) -> Obstacles:
    """Return a door from (0, 0) to (3, 4) among four agents."""
    agents = SimpleNamespace(radii=RADII, max_speeds=np.full(4, 2.0))
    ends = {"begin": [0, 0, 0], "end": [3, 0, 4]}
    door = DoorModel.model_validate({**ends, "opens": list(opens)})
    return Obstacles(
        agents,  # type: ignore[arg-type]
        GroundFrame(np.zeros(3), so3.IDENTITY),
        Terrain(),
        Colliders([]),
        [door],
        door_ends=np.array([[[0.0, 0], [3, 4]]]),
    )


def test_a_shut_door_is_as_far_as_the_nearest_point_of_it() -> None:
    """Beside its middle by 0.5, before its begin, behind its end, and upon it."""
    x = np.array([[1.5 + 0.4, 2 - 0.3], [-0.3, -0.4], [3.0, 6.0], [1.5, 2.0]])
    ((gaps, ways, speeds),) = shut()._door_gaps(0.0, x)
    assert_allclose(gaps, np.array([0.5, 0.5, 2.0, 0.0]) - RADII)
    assert_allclose(ways, [[0.8, -0.6], [-0.6, -0.8], [0, 1], [0, 0]], atol=1e-12)
    assert not speeds.any()


def test_a_door_is_open_from_the_first_of_its_times_until_the_last() -> None:
    own, x = shut([1, 2], [3, 4]), np.zeros((4, 2))
    found = [len(own._door_gaps(t, x)) for t in (0.9, 1.0, 1.9, 2.0, 2.5, 3.0, 4.0)]
    assert found == [1, 0, 0, 1, 1, 0, 1]


def test_walls_are_those_near_and_say_how_fast_one_may_come() -> None:
    """Within half a second of the fastest, 1 m; each may come as fast as it ends there.

    Who touches goes off by 0.8 of the fastest at most.
    """
    x = np.array([[1.5 + 0.4, 2 - 0.3], [-0.9, -1.2], [3.0, 4.1], [1.5, 2.0]])
    walls = shut().walls(0.0, 0.1, x)
    assert walls.agents_of_walls.tolist() == [0, 2, 3]
    assert walls.first_walls.tolist() == [0, 1, 1, 2, 3]
    assert_allclose(walls.gaps, [0.4, -0.2, -0.4])
    assert_allclose(walls.half_planes[:, 2], [-0.8, 0.4, 0.8])
    assert_allclose(walls.half_planes[:, :2], [[0.8, -0.6], [0, 1], [0, 0]], atol=1e-12)
    places = [1.9 * 0.8 - 1.7 * 0.6 - 0.4, 4.1 + 0.2, 0.4]
    assert_allclose(walls.half_planes[:, 3], places)
    none = shut([0, 9]).walls(1.0, 0.1, x)
    assert none.first_walls.tolist() == [0] * 5
    assert none.half_planes.shape == (0, 4)
