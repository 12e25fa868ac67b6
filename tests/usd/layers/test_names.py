from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pxr import Sdf

from animtool.rig.skeleton import Joint
from animtool.usd.layers.names import joint_names, legal_name


@given(st.lists(st.text(min_size=1, max_size=8), min_size=1, max_size=8, unique=True))
def test_names_are_legal_distinct_and_reversible(texts: list[str]) -> None:
    found = joint_names([Joint(text, -1) for text in texts])
    assert all(Sdf.Path.IsValidIdentifier(name) for name in found.names)
    assert len(set(found.names)) == len(texts)
    assert [
        found.sources_by_legal_name.get(name, name) for name in found.names
    ] == texts


@pytest.mark.parametrize(
    ("strip", "names"),
    [
        (0, ["a_b_hip", "a_b_leg", "plain"]),
        (1, ["b_hip", "b_leg", "plain"]),
        (2, ["hip", "leg", "plain"]),
        (9, ["hip", "leg", "plain"]),
    ],
)
def test_namespaces(strip: int, names: list[str]) -> None:
    joints = [Joint(name, -1) for name in ("a:b:hip", "a:b:leg", "plain")]
    found = joint_names(joints, strip)
    assert found.names == names
    assert found.notices == []
    if strip:
        assert found.sources_by_legal_name[names[0]] == "a:b:hip"


def test_a_collision_names_both() -> None:
    found = joint_names([Joint("a.b", -1), Joint("a:b", 0), Joint("a b", 1)])
    assert found.names == ["a_b", "a_b_2", "a_b_3"]
    assert [n.code for n in found.notices] == ["USD101", "USD101"]
    assert "'a.b'" in found.notices[0].message
    assert "'a:b'" in found.notices[0].message


@pytest.mark.parametrize(
    ("name", "legal"),
    [("ok_1", "ok_1"), ("1", "_1"), ("é", "é"), ("-", "_"), (" x", "_x")],
)
def test_legal_name(name: str, legal: str) -> None:
    assert legal_name(name) == legal
