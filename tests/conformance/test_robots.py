"""Every robot of the data: links are where pinocchio and MuJoCo have them."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.data import data_files
from support.robots import rig_matrices

from animtool.core.errors import FormatError
from animtool.maths import so3
from animtool.rig.file import load_rig
from animtool.rig.skeleton import JointType, Rig
from animtool.scene.convert.rigs import convert_rig

# Of 1 and the largest position.
TOLERANCE = 1e-12
REFUSED = "refuses"


def entries() -> list[Any]:
    """Return a parameter for each robot that the data lists."""
    (listed,) = data_files("robots", "expected.json")
    path = listed.values[0]
    if path is None:
        return [pytest.param(None, None, marks=listed.marks, id="no-data")]
    return [
        pytest.param(path.parent / name, entry, id=name)
        for name, entry in json.loads(path.read_text("utf-8")).items()
    ]


def of_class(name: str) -> list[Any]:
    found = [one for one in entries() if one.values[0] is None or is_of(one, name)]
    return found or [
        pytest.param(None, None, marks=pytest.mark.skip("none"), id="none")
    ]


def is_of(parameter: Any, name: str) -> bool:
    return (parameter.values[1]["class"] == REFUSED) == (name == REFUSED)


def opened(path: Path) -> Rig:
    if path.suffix != ".urdf" and find_spec("mujoco") is None:
        pytest.skip("MuJoCo is not installed")
    return Rig.load(path)


def name_in_rig(rig: Rig, name: str) -> str:
    """Return what a rig calls a joint, whose name may be that of a link."""
    own = f"{name}_joint"
    fixed = name in rig.names and rig.joints[rig.index(name)].type is JointType.FIXED
    return own if fixed and own in rig.names else name


def planar(name: str) -> tuple[str, str, str]:
    return f"{name}_x", f"{name}_y", name


def values_of(rig: Rig, entry: dict[str, Any], q: dict[str, Any]) -> dict[str, Any]:
    """Return the values of a configuration as those of the joints of a rig."""
    kinds = {joint["name"]: joint["kind"] for joint in entry["joints"]}
    values: dict[str, Any] = {}
    for stated, value in q.items():
        if kinds.get(stated) == "planar":
            for own, part in zip(planar(stated), value, strict=True):
                values[own] = part
            continue
        name = name_in_rig(rig, stated)
        joint = rig.joints[rig.index(name)]
        if joint.type is JointType.BALL:
            values[name] = [*value[1:], value[0]]
        elif joint.type is not JointType.FREE:
            values[name] = value
        else:
            place, turn = np.array(value[:3]), np.array([*value[4:], value[3]])
            if kinds.get(stated) != "floating":
                # MuJoCo's is of the world, a rig's of where it is at rest.
                back = so3.conjugate(np.array(joint.rotation))
                place = so3.rotate(back, place - np.array(joint.translation))
                turn = so3.multiply(back, turn)
            values[name] = np.concatenate([place, turn])
    for joint in rig.joints:
        if joint.mimic is not None:
            # In place of the value that is stated: it is to follow.
            led = values[joint.mimic.joint]
            values[joint.name] = joint.mimic.gain * led + joint.mimic.offset
    return values


def largest_error(rig: Rig, entry: dict[str, Any]) -> float:
    worst = 0.0
    for configuration in entry["configurations"]:
        ours = rig_matrices(rig, values_of(rig, entry, configuration["q"]))
        links = configuration["links"]
        size = 1 + max(np.abs(link["position"]).max() for link in links.values())
        for name, link in links.items():
            theirs = np.array(link["matrix"]).reshape(3, 4)
            off = np.abs(ours[name][:3] - theirs)
            worst = max(worst, off[:, 3].max() / size, off[:, :3].max())
    return worst


@pytest.mark.parametrize(("path", "entry"), of_class("reads"))
def test_links_are_where_they_are_expected(path: Path, entry: dict[str, Any]) -> None:
    rig = opened(path)
    assert len(entry["configurations"]) > 1
    assert largest_error(rig, entry) <= TOLERANCE


@pytest.mark.parametrize(("path", "entry"), of_class("reads"))
def test_a_rig_file_of_it_says_the_same(
    path: Path, entry: dict[str, Any], tmp_path: Path
) -> None:
    rig = opened(path)
    written = tmp_path / "again.rig.yaml"
    convert_rig(path, written)
    again = load_rig(written)
    assert again.names == rig.names
    assert [joint.limits for joint in again.joints] == [
        one.limits for one in rig.joints
    ]
    assert largest_error(again, entry) <= TOLERANCE


@pytest.mark.parametrize(("path", "entry"), of_class("reads"))
def test_limits_and_mimics_are_those_of_the_file(
    path: Path, entry: dict[str, Any]
) -> None:
    rig = opened(path)
    for stated in entry["joints"]:
        limits = stated.get("limits") or stated.get("range")
        if stated["name"] is None or stated["kind"] in {"fixed", "ball", "free"}:
            continue
        own = rig.joints[rig.index(name_in_rig(rig, stated["name"]))]
        if limits is not None:
            assert own.limits is not None
            assert (own.limits.low, own.limits.high) == pytest.approx(limits, rel=1e-12)
        if stated.get("mimic"):
            assert own.mimic is not None


@pytest.mark.parametrize(("path", "entry"), of_class(REFUSED))
def test_what_is_broken_is_refused_by_name(path: Path, entry: dict[str, Any]) -> None:
    with pytest.raises(FormatError) as caught:
        opened(path)
    text = str(caught.value)
    assert not entry["names"] or any(name in text for name in entry["names"])
    assert caught.value.faults[0].code.startswith(("URD", "MJC"))
    assert caught.value.faults[0].lines
