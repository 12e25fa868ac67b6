"""Cloth over other cloth of the same pass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from support.attached import sheet_rig, simulate, take_of

from animtool.motion.take import TakeStream
from animtool.rig.parts import LoadedArray
from animtool.rig.skeleton import Rig
from animtool.systems.attach.colliders import ClothMotion
from animtool.systems.attach.settings import SimulateOptions
from animtool.systems.framework.meter import ClosedSurface, count_pierced_pairs

SIZE = 10
# Distance between both sheets at rest, beyond what they keep from each other [m].
GAP = 0.03


def layered() -> Rig:
    """Return a post with a taut sheet, and one in front of it that hangs freely."""
    last = SIZE * (SIZE - 1)
    taut = sheet_rig(SIZE, (*range(SIZE), *range(last, SIZE * SIZE)))
    loose = sheet_rig(SIZE)
    points = loose.meshes[0].points.load() + np.array([0.0, 0.0, GAP])
    cape = replace(loose.meshes[0], name="cape", points=LoadedArray(points))
    hung = replace(loose.attach[0], name="cape", mesh="cape")
    return replace(taut, meshes=(taut.meshes[0], cape), attach=(taut.attach[0], hung))


def crossings(what: Sequence[str], **options: object) -> tuple[int, list[float]]:
    """Return most pairs of both sheets through each other, and what is reported."""
    take = take_of(layered(), 24, 0.75)
    wind = {"wind": (0.0, 0.0, -6.0), "settle": 0.0, "what": tuple(what), **options}
    stream = simulate(TakeStream.of(take), SimulateOptions(**wind))
    moved = stream.collect().motion.points
    flag, cape = (moved[name].dense() for name in ("flag", "cape"))
    faces = np.array(take.rig.meshes[0].faces.load(), np.int64)
    triangles = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    pairs = [
        count_pierced_pairs(outer, triangles, [ClosedSurface(inner, triangles)])
        - count_pierced_pairs(outer, triangles)
        for inner, outer in zip(flag, cape, strict=True)
    ]
    return max(pairs), [one["pierced"]["value"] for one in stream.simulated]


def test_cloth_collides_with_cloth_that_is_named_before() -> None:
    pairs, reported = crossings(["flag", "cape"])
    assert pairs == 0
    assert reported == [0, 0]


def test_without_self_contact_cloth_passes_through_other_cloth() -> None:
    assert crossings(["flag", "cape"], self_contact=False)[0] > 0


def test_cloth_does_not_feel_what_is_named_after_it() -> None:
    take = take_of(layered(), 24, 0.5)
    alone, both = (
        simulate(
            TakeStream.of(take),
            SimulateOptions(what=what, wind=(0.0, 0.0, -6.0), settle=0.0),
        ).collect()
        for what in (("flag",), ("flag", "cape"))
    )
    np.testing.assert_array_equal(
        both.motion.points["flag"].dense(), alone.motion.points["flag"].dense()
    )


@pytest.mark.parametrize(
    ("t", "x"), [(0.0, 1.0), (1.0, 1.0), (1.5, 2.0), (2.0, 3.0), (9.0, 3.0)]
)
def test_points_are_linear_within_the_frame_alone(t: float, x: float) -> None:
    path = np.array([1.0, 2.0]), np.stack([np.full((4, 3), 1.0), np.full((4, 3), 3.0)])
    motion = ClothMotion(np.array([[0, 1, 2]]), path)
    np.testing.assert_array_equal(motion.points(t), np.full((4, 3), x))
