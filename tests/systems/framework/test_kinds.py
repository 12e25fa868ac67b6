"""The table of kinds says of each what others may do with it."""

from __future__ import annotations

import pytest

from animtool.core.plugins import load_object
from animtool.systems.framework.fields import COLLISION_KEYS
from animtool.systems.framework.kinds import SYSTEM_KINDS, SystemKind


def test_rigid_bodies_have_surfaces() -> None:
    assert SystemKind("a:B", "a:c", "Bodies.", {}, rigid=True).surface
    assert not SystemKind("a:B", "a:c", "Points.", {}).surface


@pytest.mark.parametrize("name", SYSTEM_KINDS)
def test_what_a_kind_runs_into_is_declared_alike(name: str) -> None:
    """Each of these keys has the words of all kinds, but for rigid bodies of crowds."""
    fields = load_object(SYSTEM_KINDS[name].spec).model_fields
    others = load_object(SYSTEM_KINDS["particles"].spec).model_fields
    keys = [key for key in COLLISION_KEYS if key in fields]
    for key in keys:
        if (name, key) != ("crowds", "systems"):
            assert fields[key].description == others[key].description
        assert fields[key].default == []


@pytest.mark.parametrize("name", SYSTEM_KINDS)
def test_a_kind_is_built_from_its_spec_and_a_context(name: str) -> None:
    assert callable(load_object(SYSTEM_KINDS[name].build))
