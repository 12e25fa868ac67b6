"""The joints of real captures and rigs: known by their names, and without them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from conftest import ROOT, data_folder

from animtool import open_source
from animtool.core.array_types import FloatArray
from animtool.retarget import map_joints
from animtool.retarget.anatomy import find_anatomy
from animtool.retarget.roles import ROLES
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.skeleton import Rig

# By the name of the convention: the joints of each role, and those without one.
TRUTH: dict[str, dict[str, str | list[str]]] = yaml.safe_load(
    Path(__file__).with_name("joint_roles.yaml").read_text("utf-8")
)
FILES = [
    path
    for name in ("bvh", "mocap")
    if (folder := data_folder(name))
    for path in sorted(folder.glob("*.bvh"))
]
RIGS = sorted((ROOT / "rigs").glob("*/*.rig.yaml"))
# Of a body without a face, structure has to know so many: of all, and of each.
SCRAMBLED, LEAST = 0.95, 0.9
Record = Callable[[str, object], None]


def roles_of(entry: dict[str, str | list[str]]) -> dict[str, str]:
    """Return the role of each joint by its name; empty for none."""
    return {
        name: "" if role == "none" else role
        for role, names in entry.items()
        for name in ([names] if isinstance(names, str) else names)
    }


KNOWN = {frozenset(roles_of(entry)): (key, entry) for key, entry in TRUTH.items()}


def source_names(rig: Rig) -> list[str]:
    """Return the names as the file has them."""
    return [joint.source_name or joint.name for joint in rig.joints]


def known_roles(rig: Rig) -> list[str] | None:
    """Return the true role of each joint; None where the skeleton is not known."""
    entry = KNOWN.get(frozenset(source_names(rig)))
    if entry is None:
        return None
    roles = roles_of(entry[1])
    return [roles[name] for name in source_names(rig)]


def own_roles(roles: tuple[str, ...]) -> list[str]:
    """Return roles without what is only said of joints that have none."""
    return [role if role in ROLES else "" for role in roles]


@cache
def rig_at(path: Path) -> Rig:
    """Return the skeleton of a file."""
    rig = Rig.load(path)
    return replace(rig, meshes=(), attach=(), shapes=(), controls=())


@cache
def pose_at(path: Path) -> FloatArray:
    """Return where the joints of a file are in its first frame ``(J, 3)`` [m]."""
    if path.suffix == ".bvh":
        translations, rotations, _ = open_source(path).collect().motion.dense()
        world = forward_kinematics(rig_at(path), translations[:1], rotations[:1])
    else:
        rig = rig_at(path)
        world = forward_kinematics(
            rig, rig.rest_translations[None], rig.rest_rotations[None]
        )
    return world.positions[0]


def bodies() -> Iterator[Path]:
    """Yield a file of each skeleton that is known and has limbs."""
    seen: set[frozenset[str]] = set()
    for path in [*FILES, *RIGS]:
        names = frozenset(source_names(rig_at(path)))
        if names in KNOWN and names not in seen and "thigh_l" in KNOWN[names][1]:
            seen.add(names)
            yield path


BODIES = list(bodies())


@pytest.mark.skipif(not FILES, reason="ANIMTOOL_DATA has no BVH")
@pytest.mark.parametrize("path", [*FILES, *RIGS], ids=lambda path: path.stem)
def test_every_joint_is_known_by_its_name(path: Path, record_property: Record) -> None:
    rig = rig_at(path)
    truth = known_roles(rig)
    roles = own_roles(find_anatomy(rig).roles)
    if truth is None:
        sides = {role[:-2] for role in roles if role.endswith("_l")}
        assert sides == {role[:-2] for role in roles if role.endswith("_r")}
        return
    wrong = [
        (name, role, right)
        for name, role, right in zip(source_names(rig), roles, truth, strict=True)
        if role != right
    ]
    record_property("Roles", f"  {path.stem:28} {len(truth) - len(wrong)}/{len(truth)}")
    assert wrong == []


@cache
def scrambled(path: Path) -> list[tuple[str, str, str]]:
    """Return name, role and true role of joints whose names were taken from them."""
    rig = rig_at(path)
    order = np.random.default_rng(7).permutation(len(rig.joints))
    joints = [
        replace(joint, name=f"n{i}", source_name="", mirror="", mimic=None)
        for i, joint in zip(order, rig.joints, strict=True)
    ]
    nameless = Rig(rig.name, tuple(joints), up=rig.up)
    found = own_roles(find_anatomy(nameless, positions=pose_at(path)).roles)
    truth = known_roles(rig)
    assert truth is not None
    return [
        (name, role, right)
        for name, role, right in zip(source_names(rig), found, truth, strict=True)
        if right and right.split("_")[0] not in {"jaw", "eye"}
    ]


def share(scored: list[tuple[str, str, str]]) -> float:
    """Return the share of joints that are known."""
    return float(np.mean([role == right for _, role, right in scored]))


@pytest.mark.parametrize("path", BODIES, ids=lambda path: path.stem)
def test_scrambled_names_leave_the_structure(
    path: Path, record_property: Record
) -> None:
    scored = scrambled(path)
    line = f"  {path.stem:28} {share(scored):6.1%} of {len(scored)}"
    record_property("Roles with scrambled names: share of joints", line)
    assert share(scored) >= LEAST, [each for each in scored if each[1] != each[2]]


def test_structure_alone_knows_nearly_all_joints() -> None:
    assert share([each for path in BODIES for each in scrambled(path)]) >= SCRAMBLED


@pytest.mark.skipif(not BODIES, reason="ANIMTOOL_DATA has no known skeleton")
@pytest.mark.parametrize("path", BODIES, ids=lambda path: path.stem)
def test_every_capture_maps_onto_the_shipped_biped(path: Path) -> None:
    rig, biped = rig_at(path), rig_at(ROOT / "rigs/biped/biped.rig.yaml")
    found = map_joints(rig, biped)
    truth = known_roles(rig)
    assert truth is not None
    theirs = known_roles(biped)
    assert theirs is not None
    mapped = {(truth[pair.source], theirs[pair.target]) for pair in found.pairs}
    # A hand whose fingers are one moves each of them.
    mitten = {pair for pair in mapped if pair[0].startswith("fingers")}
    assert {role[:-4] for _, role in mitten} <= {"index", "middle", "ring", "pinky"}
    mapped -= mitten
    assert {role for role, _ in mapped} == set(truth) & set(theirs) - {""}
    assert all(role == other for role, other in mapped)
