"""Every convention of names that the data know, on a skeleton of a person."""

from __future__ import annotations

import re
from typing import Any

import pytest
import yaml
from conftest import data_folder
from support.people import CENTER, DIGIT_JOINTS, LIMBS, build

from animtool.retarget.anatomy import find_anatomy

FOLDER = data_folder("retarget")
# Points without hips are no tree of joints.
CONVENTIONS: dict[str, dict[str, Any]] = {
    name: entry
    for path in sorted(FOLDER.glob("*.yaml") if FOLDER else ())
    for name, entry in yaml.load(path.read_text("utf-8"), yaml.CSafeLoader)[
        "conventions"
    ].items()
    if "hips" in entry["joints"]
}
PARTS = {
    "Shoulder": "clavicle",
    "UpperArm": "upper_arm",
    "LowerArm": "forearm",
    "Hand": "hand",
    "UpperLeg": "thigh",
    "LowerLeg": "shin",
    "Foot": "foot",
    "Toes": "toe",
    "Eye": "eye",
}
PHALANGES = {"Metacarpal": 0, "Proximal": 1, "Intermediate": 2, "Distal": 3}
THUMB = {"Metacarpal": 1, "Proximal": 2, "Distal": 3}
SPINE = {"spine": "spine", "chest": "spine_2", "upperChest": "spine_3"}


def role_of(canonical: str) -> str:
    """Return the role that a canonical joint is, as `build` calls it."""
    side = re.match(r"(left|right)([A-Z]\w*)$", canonical)
    if not side:
        return SPINE.get(canonical, canonical)
    suffix, part = side[1][0], side[2]
    if part in PARTS:
        return f"{PARTS[part]}_{suffix}"
    digit, phalanx = re.fullmatch(r"([A-Z][a-z]+)([A-Z]\w+)", part).groups()
    digit = {"Little": "pinky"}.get(digit, digit.lower())
    number = (THUMB if digit == "thumb" else PHALANGES)[phalanx]
    return f"{digit}_{number}_{suffix}"


def skeleton_of(entry: dict[str, Any], variant: int) -> Any:
    """Return the rig of a convention, and the roles of its joints by name."""
    names: dict[str, str] = {}
    hips = entry["joints"]["hips"]
    for canonical, texts in entry["joints"].items():
        role = role_of(canonical)
        text = texts[min(variant, len(texts) - 1)]
        # Where two slots have one name, there is one joint.
        if text not in names.values() and (role != "root" or text not in hips):
            names[role] = text
    has_metacarpals = "index_0_l" in names
    limbs = {**LIMBS, **DIGIT_JOINTS[has_metacarpals]}
    limbs["eye"] = ("head", (0.03, 0.06, 0.08))
    tree = dict(CENTER)
    tree["jaw"] = ("head", (0.0, 0.02, 0.03))
    if "root" in names:
        tree = {"root": ("", (0.0, 0.0, 0.0)), **tree}
        tree["hips"] = ("root", tree["hips"][1])
    for side, sign in (("l", 1), ("r", -1)):
        for role, (parent, (x, y, z)) in limbs.items():
            above = parent if parent in tree else f"{parent}_{side}"
            tree[f"{role}_{side}"] = (above, (sign * x, y, z))
    return build(tree, lambda role: names.get(role, ""))


@pytest.mark.skipif(not CONVENTIONS, reason="ANIMTOOL_DATA has no names")
@pytest.mark.parametrize("variant", [0, 1])
@pytest.mark.parametrize("name", CONVENTIONS)
def test_a_convention_is_known(name: str, variant: int) -> None:
    rig, roles = skeleton_of(CONVENTIONS[name], variant)
    found = find_anatomy(rig)
    wrong = [
        (joint.name, role, roles[joint.name])
        for joint, role in zip(rig.joints, found.roles, strict=True)
        if role != roles[joint.name]
    ]
    assert wrong == []
