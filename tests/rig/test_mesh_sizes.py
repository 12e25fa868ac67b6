"""Meshes in another unit than their skeleton."""

from __future__ import annotations

from dataclasses import replace

import pytest
from support.attached import sheet_rig, simulated, take_of

from animtool.rig.mesh_sizes import mesh_size_texts, mesh_size_warnings
from animtool.rig.skeleton import Joint
from animtool.rig.surfaces import surfaces_of


@pytest.mark.parametrize(
    ("size", "hint"),
    [
        (94.0, "divide its points by 100"),
        (940.0, "divide its points by 1000"),
        (0.01, "write points"),
        (60.0, None),
        (0.09, None),
    ],
)
def test_the_unit_of_a_mesh(size: float, hint: str | None) -> None:
    texts = mesh_size_texts({"eye": 0.001, "skirt": size}, 2.4)
    assert (None if texts is None else texts[2][: len(hint or "")]) == hint


def test_a_cloth_in_centimetres_is_named_instead_of_what_comes_of_it() -> None:
    post = Joint("post", -1)
    arms = tuple(Joint(f"arm_{k}", 0, translation=(0.5, k, 0.0)) for k in (0, 1))
    rig = replace(sheet_rig(side=100.0), joints=(post, *arms))
    assert [f.code for f in mesh_size_warnings(rig, surfaces_of(rig))] == ["RIG218"]
    _, codes = simulated(take_of(rig, 24, 0.2))
    assert codes == ["RIG218", "SIM130"]
    small = replace(sheet_rig(side=1.0), joints=(post, *arms))
    assert "RIG218" not in simulated(take_of(small, 24, 0.2))[1]
