"""Left and right in conventions of joint names (``$ANIMTOOL_DATA/retarget``)."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from conftest import data_folder

from animtool.rig.sides import pair_sides


def conventions() -> dict[str, dict[str, list[str]]]:
    """Return the joint names of each convention, by canonical joint."""
    folder = data_folder("retarget") or Path("nowhere")
    found = {}
    for path in sorted(folder.glob("*.yaml")):
        content = yaml.load(path.read_text("utf-8"), yaml.CSafeLoader)
        for name, convention in content.get("conventions", {}).items():
            found[f"{path.stem}:{name}"] = convention["joints"]
    return found


def test_every_left_joint_finds_its_right_one() -> None:
    known = conventions()
    if not known:
        pytest.skip("ANIMTOOL_DATA has no conventions of joint names")
    wrong = []
    for convention, joints in known.items():
        names = list(dict.fromkeys(name for entry in joints.values() for name in entry))
        pairs = pair_sides(names)
        found = {names[i]: names[int(p)] for i, p in enumerate(pairs.partners)}
        wanted = {name: name for name in names}
        for joint, left in joints.items():
            right = joints.get("right" + joint.removeprefix("left"), [])
            if joint.startswith("left") and len(left) == len(right):
                wanted |= dict(zip(left, right, strict=True))
                wanted |= dict(zip(right, left, strict=True))
        wrong += [
            f"{convention}: {name} is paired with {found[name]}, not {wanted[name]}"
            for name in names
            if found[name] != wanted[name]
        ]
        wrong += [
            f"{convention}: {names[i]} is a stray" for i in pairs.unpaired_indices
        ]
    assert not wrong
