from __future__ import annotations

import pytest

from animtool.rig.skeleton import Joint, Rig


def test_paths_and_roots() -> None:
    rig = Rig("two", (Joint("a", -1), Joint("b", 0), Joint("c", 1), Joint("prop", -1)))
    assert rig.paths() == ["a", "a/b", "a/b/c", "prop"]
    assert rig.paths(["w", "x", "y", "z"])[2] == "w/x/y"
    assert rig.roots == [0, 3]
    assert rig.parents.tolist() == [-1, 0, 1, -1]
    assert rig.index("c") == 2


def test_a_name_stands_once() -> None:
    with pytest.raises(ValueError, match="'a'"):
        Rig("twice", (Joint("a", -1), Joint("a", 0)))


@pytest.mark.parametrize("parent", [1, 2, -2])
def test_parents_come_first(parent: int) -> None:
    with pytest.raises(ValueError, match="precede"):
        Rig("late", (Joint("a", -1), Joint("b", parent)))
