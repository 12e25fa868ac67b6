"""Does it fit: captures and rigs over their own skeleton, and over others."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, data_folder
from support.fit import along_x, below, with_rest

from animtool import open_source
from animtool.maths import so3
from animtool.motion.take import Take
from animtool.rig.fit import MIN_FIT, RigFit, measure_fit
from animtool.rig.kinematics import forward_kinematics, rest_size
from animtool.rig.skeleton import Rig
from animtool.scene.sources.onto_rig import map_names

# Skeletons of fewer joints have no limb to bend.
FEWEST = 10
# A pose this far from rest, as root mean square, is another rest pose [rad].
OTHER_POSE = np.radians(20.0)
BVH = [
    path
    for name in ("bvh", "mocap")
    if (folder := data_folder(name))
    for path in sorted(folder.glob("*.bvh"))
]
RIGS = sorted((ROOT / "rigs").glob("*/*.rig.yaml"))
needs_data = pytest.mark.skipif(not BVH, reason="ANIMTOOL_DATA has no BVH")

Record = Callable[[str, object], None]


def fit(take: Rig, rig: Rig) -> RigFit:
    return measure_fit(take, rig, map_names(rig, take).joints)


def row(take: str, rig: str, found: RigFit) -> str:
    parts = " ".join(f"{value:.2f}" for value in found.components.values())
    verdict = "fits" if found.score >= MIN_FIT else "refused"
    return f"  {take:28} {rig:28} {found.score:.2f} {verdict:8} {parts}"


HEADING = (
    "Fit: take, rig, score, verdict, then joints, rotations, lengths, size, up axis"
)


@needs_data
@pytest.mark.parametrize("path", BVH, ids=lambda p: p.stem)
def test_a_capture_fits_its_own_skeleton_and_no_other_rest_pose(
    path: Path, record_property: Record
) -> None:
    take = open_source(path).collect()
    rig = take.rig
    assert fit(rig, rig).score == pytest.approx(1.0)
    if len(rig.joints) < FEWEST or rest_size(rig) == 0:
        return
    for name, other in {
        "a limb 45 degrees off": limb_off(rig),
        "frames along bones": along_x(rig),
        "another frame as rest": frame_as_rest(take),
    }.items():
        if other is None:
            continue
        found = fit(rig, other)
        record_property(HEADING, row(path.stem, name, found))
        assert found.score < MIN_FIT, name


def limb_off(rig: Rig) -> Rig | None:
    """Return a rig whose limbs rest 45 degrees off, across their bones."""
    lengths = np.linalg.norm(rig.rest_translations, axis=1)
    lengths[rig.parents < 0] = 0.0
    shares = [lengths[below(rig, j)].sum() / lengths.sum() for j in range(len(lengths))]
    limbs = [j for j, share in enumerate(shares) if 0.15 <= share <= 0.35]
    if not limbs:
        return None
    chosen = below(rig, max(limbs, key=lambda j: shares[j]))
    moved = rig.rest_translations.copy()
    spread = np.linalg.svd(moved[chosen])[2]
    # About the direction that its bones have least of.
    turn = so3.from_axis_angle(spread[-1], np.pi / 4)
    moved[chosen] = so3.rotate(turn, moved[chosen])
    return with_rest(rig, rig.rest_rotations, moved)


def frame_as_rest(take: Take) -> Rig | None:
    """Return the rig with its middle frame in its offsets; None where that is rest."""
    translations, rotations, _ = take.motion.dense()
    middle = slice(len(rotations) // 2, len(rotations) // 2 + 1)
    rig = take.rig
    world = forward_kinematics(rig, translations[middle], rotations[middle]).positions[
        0
    ]
    inner = rig.parents >= 0
    moved = rig.rest_translations.copy()
    moved[inner] = world[inner] - world[rig.parents[inner]]
    other = with_rest(rig, rig.rest_rotations, moved)
    return other if fit(rig, other).rms_angle > OTHER_POSE else None


def test_our_rigs_fit_themselves_and_no_other(record_property: Record) -> None:
    rigs = {path.parent.name: replace(Rig.load(path), meshes=()) for path in RIGS}
    assert len(rigs) > 3
    for name, rig in rigs.items():
        assert fit(rig, rig).score == pytest.approx(1.0), name
    for one, other in permutations(rigs, 2):
        found = fit(rigs[one], rigs[other])
        record_property(HEADING, row(one, other, found))
        assert found.score < MIN_FIT, (one, other)


@needs_data
def test_captures_over_the_biped(record_property: Record) -> None:
    biped = Rig.load(ROOT / "rigs/biped/biped.rig.yaml")
    for path in BVH:
        rig = Rig.load(path)
        if (map_names(biped, rig).joints < 0).all():
            continue
        found = fit(rig, biped)
        record_property(HEADING, row(path.stem, "biped", found))
        assert found.score < MIN_FIT, path.stem


PAIRS = sorted(folder.glob("*.pairs.json")) if (folder := data_folder("mocap")) else []


@pytest.mark.skipif(not PAIRS, reason="ANIMTOOL_DATA has no pairs to retarget")
@pytest.mark.parametrize("path", PAIRS, ids=lambda p: p.stem)
def test_what_is_to_be_retargeted_does_not_fit(
    path: Path, record_property: Record
) -> None:
    stem = path.name.removesuffix(".pairs.json")
    source = Rig.load(path.with_name(f"{stem}.source.bvh"))
    for name, pair in json.loads(path.read_text("utf-8"))["pairs"].items():
        target = Rig.load(path.with_name(pair["target"]))
        # Even with the true names of the joints.
        own = {theirs: mine for mine, theirs in pair["joint_map"].items()}
        renamed = tuple(replace(j, name=own.get(j.name, j.name)) for j in target.joints)
        found = fit(source, replace(target, joints=renamed))
        record_property(HEADING, row(stem, f"{name} ({pair['rest']})", found))
        assert found.score < MIN_FIT, name
