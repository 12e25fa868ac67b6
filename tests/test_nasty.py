"""The nasty character stays nasty: each of its properties is stated here once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdSkel
from support.bvh import HEADER
from support.nasty import (
    RATE,
    START,
    TINY,
    bind_world,
    nasty_rig,
    nasty_stage,
    nasty_take,
    nasty_track,
    with_track,
    write_nasty_clip,
)

from animtool.clip.file import load_clip, open_clip
from animtool.maths import so3
from animtool.rig.kinematics import rest_world
from animtool.usd.layers.names import legal_name

RIG = nasty_rig()


def turned(rotations: np.ndarray) -> bool:
    """Return whether every rotation is at least 5° from none."""
    return bool((so3.angle_between(rotations, so3.IDENTITY) > 0.09).all())


def test_roots_are_off_the_origin_on_every_axis() -> None:
    assert len(RIG.roots) == 2
    assert (RIG.rest_translations[RIG.roots] != 0).all()
    assert (RIG.meters_per_unit, str(RIG.up)) == (0.01, "Z")


def test_rest_and_bind_are_turned_and_differ() -> None:
    assert turned(RIG.rest_rotations)
    bind, rest = bind_world(RIG), rest_world(RIG)
    for name in RIG.bind:
        j = RIG.index(name)
        turn = rest.linear[0, j].T @ bind[j, :3, :3]
        assert turned(so3.from_matrix(turn)[None])
        assert np.linalg.norm(bind[j, :3, 3] - rest.positions[0, j]) > 0.01


def test_controls_are_not_named_as_the_shapes_that_they_drive() -> None:
    shapes = {shape.name for shape in RIG.shapes}
    assert shapes.isdisjoint(control.name for control in RIG.controls)
    driven = {d.target for c in RIG.controls for d in c.drives}
    assert {f"shape/{name}" for name in shapes} <= driven


def test_mirrored_pairs_are_not_symmetric() -> None:
    for left, right in (("arm.L", "arm.R"), ("hand.L", "hand.R")):
        one, other = RIG.index(left), RIG.index(right)
        across = RIG.rest_translations[one] * [-1, 1, 1]
        assert np.linalg.norm(across - RIG.rest_translations[other]) > 0.01
        turns = RIG.rest_rotations[[one, other]]
        assert so3.angle_between(turns[0] * [1, -1, -1, 1], turns[1]) > 0.1


def test_names_need_escaping() -> None:
    parts = [RIG.name, *RIG.names, *(part.name for part in (*RIG.meshes, *RIG.shapes))]
    assert sum(legal_name(name) != name for name in parts) >= 8


def test_the_take_moves_a_lot_a_little_and_not_at_all() -> None:
    take = nasty_take(40)
    motion = take.motion
    moved = np.ptp(motion.translations.dense(), axis=0).max(axis=-1)
    assert moved[RIG.index("stand")] == 0
    assert 0 < moved[RIG.index("hand.R")] <= 2 * TINY
    assert motion.weights is not None
    assert 0 < np.ptp(motion.weights.dense()[:, 1]) <= 2 * TINY
    assert (np.diff(motion.translations.dense()[:, 0, 1:], axis=0) > 0).all()
    hips = motion.rotations.dense()[:, 0]
    assert hips[:, 3].min() < 0 < hips[:, 3].max()
    assert motion.scales is not None
    arm = motion.scales.dense()[:, RIG.index("arm.L")]
    assert (np.abs(np.diff(arm[1:], axis=1)) > 1e-3).all()


def test_frames_are_off_the_grid() -> None:
    clock = nasty_take().clock
    assert clock.fps == RATE
    assert clock.start == START
    assert START.denominator == 7


def test_a_track_has_a_token_and_an_integer_that_are_held() -> None:
    take = with_track(nasty_take())
    assert take.motion.track_times is not None
    found = nasty_track().at(take.motion.track_times.dense()[:, 0, 0])
    choices = [a for a in nasty_track().attributes if not a.width]
    assert [a.type_name for a in choices] == ["token", "int"]
    assert all(len(set(values.tolist())) > 1 for values in found.values[1:])


def test_the_clip_has_keys_between_frames_and_drives_controls(tmp_path: Path) -> None:
    path = write_nasty_clip(tmp_path)
    clip = load_clip(open_clip(path), RIG)
    assert any((channel.times % 1 != 0).any() for channel in clip.channels)
    assert {c.target.split("/")[0] for c in clip.channels} == {
        "joint",
        "control",
        "shape",
    }


def test_the_header_of_a_bvh_is_off_the_origin() -> None:
    offsets = [
        [float(x) for x in line.split()[1:]]
        for line in HEADER.splitlines()
        if "OFFSET" in line
    ]
    assert all(all(offset) for offset in offsets)
    orders = [line.split()[-3:] for line in HEADER.splitlines() if "CHANNELS" in line]
    assert orders[0] != orders[1]


def test_the_stage_has_two_turned_skeletons_in_one_root(tmp_path: Path) -> None:
    stage = Usd.Stage.Open(str(nasty_stage(tmp_path / "pair.usda")))
    skeletons = [UsdSkel.Skeleton(p) for p in stage.Traverse() if p.IsA("Skeleton")]
    roots = {UsdSkel.Root.Find(one.GetPrim()).GetPath() for one in skeletons}
    assert (len(skeletons), len(roots)) == (2, 1)
    cache = UsdGeom.XformCache(stage.GetStartTimeCode())
    world = [np.array(cache.GetLocalToWorldTransform(s.GetPrim())) for s in skeletons]
    assert (world[0][3, :3] != 0).all()
    sizes = np.linalg.norm(world[1][:3, :3], axis=1)
    assert np.ptp(sizes) > 0.1
    for skeleton in skeletons:
        rest = np.array(skeleton.GetRestTransformsAttr().Get())
        bind = np.array(skeleton.GetBindTransformsAttr().Get())
        assert np.abs(rest[0, :3, :3] - bind[0, :3, :3]).max() > 0.1
        assert np.abs(rest[0, :3, :3] - np.eye(3)).max() > 0.1
    anim = next(p for p in stage.Traverse() if p.IsA(UsdSkel.Animation))
    times = np.array(anim.GetAttribute("rotations").GetTimeSamples())
    assert pytest.approx(times[1] - times[0]) == 6 / 7
    assert times[0] % 1 != 0
