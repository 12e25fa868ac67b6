"""Joints of one skeleton onto those of another."""

from __future__ import annotations

import pytest
from support.people import named, person

from animtool.errors import OptionError
from animtool.mocap.retarget import JointMap, map_joints
from animtool.rig.skeleton import Joint, Rig


def pairs(found: JointMap, source: Rig, target: Rig) -> dict[str, str]:
    """Return the names of source joints by those of the target."""
    return {target.names[p.target]: source.names[p.source] for p in found.pairs}


def test_mixamo_goes_onto_an_unreal_rig() -> None:
    source, ours = person(named("mixamo"))
    target, theirs = person(named("ue5_manny"), metacarpals=True)
    found = map_joints(source, target)
    assert (found.source.preset, found.target.preset) == ("mixamo", "ue5_manny")
    by_target = pairs(found, source, target)
    assert by_target["clavicle_l"] == "mixamorig:LeftShoulder"
    assert by_target["index_01_r"] == "mixamorig:RightHandIndex1"
    for name, role in theirs.items():
        if "_0_" in role:
            assert name in [target.names[j] for j in found.unmapped_target]
        else:
            assert ours[by_target[name]] == role
    assert found.unmapped_source == ()


def test_nothing_in_common_is_refused() -> None:
    source, _ = person()
    crane = Rig("crane", (Joint("base", -1), Joint("jib", 0, translation=(1, 0, 0))))
    with pytest.raises(OptionError) as caught:
        map_joints(source, crane)
    assert caught.value.code == "MAP004"
