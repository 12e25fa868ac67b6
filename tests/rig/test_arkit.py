"""Names of face shapes."""

from __future__ import annotations

import pytest

from animtool.rig.shapes import ARKIT_SHAPES, arkit_name
from animtool.rig.sides import pair_sides


def test_there_are_52() -> None:
    assert len(set(ARKIT_SHAPES)) == 52


def test_spellings() -> None:
    for name in ARKIT_SHAPES:
        snake = "".join(f"_{c.lower()}" if c.isupper() else c for c in name)
        short = name.removesuffix("Left").removesuffix("Right")
        upper = name[0].upper() + name[1:]
        spellings = [name, name.lower(), upper, snake, f"face.{name}"]
        if short != name:
            side = name[len(short)]
            spellings += [f"{short}_{side}", f"ns:{short}{side}"]
        for spelling in spellings:
            assert arkit_name(spelling) == name, spelling


@pytest.mark.parametrize("name", ["", "jaw", "eyeBlink", "smile", "mouthSmileMiddle"])
def test_others(name: str) -> None:
    assert arkit_name(name) is None


def test_sides_are_each_others_mirror() -> None:
    partners = pair_sides(ARKIT_SHAPES).partners
    for i, j in enumerate(partners.tolist()):
        left = ARKIT_SHAPES[i].replace("Right", "Left")
        assert ARKIT_SHAPES[j].replace("Right", "Left") == left
        assert (i == j) is ("Left" not in left)
