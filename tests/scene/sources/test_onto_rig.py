"""Motion mapped to another rig by names."""

from __future__ import annotations

import pytest

from animtool.rig.skeleton import Joint, Rig
from animtool.scene.sources.onto_rig import map_names


def arms(first: str, second: str) -> Rig:
    """Return two arms with a hand each, of one name, as BVH and USD files have them."""
    return Rig(
        "arms",
        (
            Joint("hips", -1),
            Joint(first, 0),
            Joint("hand", 1),
            Joint(second, 0),
            Joint("hand_2", 3, source_name="hand"),
        ),
    )


@pytest.mark.parametrize("order", [("l", "r"), ("r", "l")])
def test_of_joints_with_one_name_the_one_below_the_same_parent(
    order: tuple[str, str],
) -> None:
    rig, other = arms("l", "r"), arms(*order)
    names = map_names(rig, other)
    parents = [other.names[other.joints[j].parent] for j in names.joints[[2, 4]]]
    assert parents == ["l", "r"]
    assert names.unmatched_joints == ()


def test_a_name_below_another_parent_is_still_found() -> None:
    rig = Rig("a", (Joint("hips", -1), Joint("hand", 0)))
    names = map_names(rig, arms("l", "r"))
    assert names.joints.tolist() == [0, 2]
